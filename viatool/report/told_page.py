"""A page of what a report tells in words and figures, of any kind of run: all that can be made of its JSON alone."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from viatool.report.document import Document, Explained
from viatool.report.html.plain import inert, plain_page
from viatool.report.numbers import seconds
from viatool.report.sections import Breakdown, Check, Facts, Rates, Section, Table

_OWN = """
td { font-variant-numeric: tabular-nums; }
th, td { white-space: normal; text-align: left; vertical-align: top; }
th[scope="row"] { font-weight: normal; }
.failed { color: var(--unsafe); } .passed { color: var(--safe); }
"""


def told_page(document: Document, checks: Sequence[Check], remark: str = "") -> str:
    """Return a page with the headline, the gate, every section, and what the figures rest on.

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
        f"<section><h1>{inert(head[0])}</h1>{''.join(f'<p>{inert(text)}</p>' for text in head[1:])}</section>",
        _gate(checks),
        *map(_section, document.sections),
        _section(document.failing) if isinstance(document, Explained) and document.failing.rows else "",
        _table("In effect", (), [(one.name, one.value, one.source) for one in record.premises]),
        _table("Assumed", (), [*document.assumptions.items(), *_files(document)]),
    ]
    footer = f"Made by viatool {record.versions.get('viatool', '')}."
    return plain_page(f"viatool: {head[0]}", "\n".join(filter(None, parts)), footer, _OWN)


def _files(document: Document) -> Iterable[tuple[str, str]]:
    record = document.record
    yield "policy sha256", record.policy.sha256
    yield "map sha256", record.map.sha256


def _gate(checks: Sequence[Check]) -> str:
    rows = "".join(
        f'<tr><td class="{"passed" if one.passed else "failed"}">{inert(one.word)}</td>'
        f"<td>{inert(one.condition)}</td><td>{inert(one.figures)}</td></tr>"
        for one in checks
    )
    told = "".join(f"<li>{inert(text)}</li>" for one in checks for text in one.some_evidence(_EVIDENCE))
    return (
        f"<section><h2>Gate</h2>{_scrolled(rows)}{f'<ul>{told}</ul>' if told else ''}</section>"
        if rows
        else ""
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
    return f"<section>{above}{_scrolled(body, f'<thead><tr>{names}</tr></thead>' if names else '')}</section>"


def _cells(row: Sequence[str]) -> str:
    first, *others = row
    return f'<th scope="row">{inert(first)}</th>' + "".join(f"<td>{inert(text)}</td>" for text in others)


def _scrolled(body: str, head: str = "") -> str:
    return f'<div class="scroll"><table>{head}<tbody>{body}</tbody></table></div>'
