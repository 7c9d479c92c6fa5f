"""A page of what a report tells in words and figures, of any kind of run: all that can be made of its JSON alone."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from viatool.errors import ConfigurationError
from viatool.report.document import Document, Explained
from viatool.report.html.plain import inert, plain_page, scrolling
from viatool.report.numbers import count, seconds
from viatool.report.sections import Breakdown, Check, Facts, Rates, Section, Table

_OWN = """
td { font-variant-numeric: tabular-nums; }
.scroll th, .scroll td { white-space: normal; text-align: left; vertical-align: top; min-width: 5em; }
th[scope="row"] { font-weight: normal; }
"""


def told_page(document: Document, checks: Sequence[Check], remark: str = "") -> str:
    """Return a page with the gate, the headline, every section, and what the figures rest on.

    Parameters
    ----------
    document : Document
        What was found.
    checks : sequence of Check
        The decided conditions of the gate.
    remark : str
        What the page has not, below its headline.
    """
    record, found = document.record, document.headline
    conditions = ", ".join(document.subject)
    about = f"{record.policy.path} on {record.map.path}, {conditions}, {seconds(record.total_seconds)}"
    figures = f"{found} ({found.figures})" if found.figures else str(found)
    head = [found.stake or figures, *([figures] if found.stake else []), about, *([remark] if remark else [])]
    parts = [
        _gate(checks),
        f"<section><h1>{inert(head[0])}</h1>{''.join(f'<p>{inert(text)}</p>' for text in head[1:])}</section>",
        *map(_section, document.sections),
        _failing(document),
        _table("In effect", (), [(one.name, one.value, one.source) for one in record.premises]),
        _table("Assumed", (), [*document.assumptions.items(), *_files(document)]),
    ]
    footer = f"Made by viatool {record.versions.get('viatool', '')}."
    return plain_page(f"viatool: {head[0]}", "\n".join(filter(None, parts)), footer, _OWN)


def _failing(document: Document) -> str:
    """Return why its subjects are not safe; nothing where all are, or an older viatool did not say."""
    if not isinstance(document, Explained):
        return ""
    try:
        return _section(document.failing)
    except ConfigurationError:
        return ""


def _files(document: Document) -> Iterable[tuple[str, str]]:
    record = document.record
    yield "policy sha256", record.policy.sha256
    yield "map sha256", record.map.sha256


def _gate(checks: Sequence[Check]) -> str:
    """Return the conditions, with what fails each; nothing without a gate."""
    if not checks:
        return ""
    outcome = "passed" if all(one.passed for one in checks) else "failed"
    return (
        f'<section class="gate {outcome}"><h2 class="gate {outcome}">Gate {outcome}</h2>'
        f'<ul class="conditions">{"".join(map(_condition, checks))}</ul></section>'
    )


def _condition(check: Check) -> str:
    told = "".join(f"<li>{inert(text)}</li>" for text in check.some_evidence(_EVIDENCE))
    listed = f"what fails it: {count(len(check.failing))}"
    return (
        f'<li class="{"passed" if check.passed else "failed"}"><b>{inert(check.word)}</b> '
        f'<span>{inert(check.condition)}</span> <span class="quiet">{inert(check.figures)}</span>'
        + (f"<details><summary>{listed}</summary><ul>{told}</ul></details>" if told else "")
        + "</li>"
    )


_EVIDENCE = 200  # sentences of a condition that failed


def _section(section: Section) -> str:
    match section:
        case Breakdown():
            return _table("", section.head, [(one.name, *one.figures, one.meaning) for one in section.parts])
        case Rates():
            rows = [
                (name, *(f"{one.percentage()} ({one.of('/')})" for one in shares))
                for name, shares in section.rows.items()
            ]
            return _table("", (section.title, *section.groups), rows)
        case Table():
            return _table(section.title, section.head, section.rows, section.remark)
        case Facts():
            return _table(section.title, (), section.pairs)


def _table(title: str, head: Sequence[str], rows: Iterable[Sequence[str]], remark: str = "") -> str:
    """Return a table below its title; nothing without rows."""
    body = "".join(f"<tr>{_cells(row)}</tr>" for row in rows)
    if not body:
        return ""
    names = "".join(f'<th scope="col">{inert(name)}</th>' for name in head)
    above = f"<h2>{inert(title)}</h2>" if title else ""
    above += f"<p>{inert(remark[0].upper() + remark[1:])}.</p>" if remark else ""
    table = f"<table>{f'<thead><tr>{names}</tr></thead>' if names else ''}<tbody>{body}</tbody></table>"
    return f"<section>{above}{scrolling(title or ', '.join(head), table)}</section>"


def _cells(row: Sequence[str]) -> str:
    first, *others = row
    return f'<th scope="row">{inert(first)}</th>' + "".join(f"<td>{inert(text)}</td>" for text in others)
