"""The document as Markdown, for pull requests and job summaries."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence

from viatool.report.document import Document
from viatool.report.foreign import shown
from viatool.report.numbers import seconds
from viatool.report.sections import Breakdown, Check, Facts, Rates, Section, Table

SUFFIXES = ()
NEEDS = Document
LIBRARIES = ()
MOST_EVIDENCE = 200  # sentences of a condition that failed
_SPECIAL = str.maketrans({character: f"\\{character}" for character in "\\`*_{}[]()#+!|~@"})


def render(document: Document, checks: Sequence[Check], suffix: str) -> str:
    """Return a document as Markdown."""
    return markdown(document, checks)


def markdown(document: Document, checks: Sequence[Check] = ()) -> str:
    """Return a document as Markdown."""
    record, found = document.record, document.headline
    conditions = [
        *document.subject,
        *([document.terms["arithmetic"]] if "arithmetic" in document.terms else []),
    ]
    figures = f" ({_escape(found.figures)})" if found.figures else ""
    lines = [
        f"## viatool: {_escape(found.stake or str(found))}",
        "",
        *([_escape(str(found)) + figures, ""] if found.stake else []),
        f"{_escape(record.policy.path)} on {_escape(record.map.path)}, "
        f"{_escape(', '.join(conditions))}, {seconds(record.total_seconds)}",
        "",
    ]
    if checks:
        rows = [("passed" if c.passed else f"**{c.word}**", *cells((c.condition, c.figures))) for c in checks]
        lines += table(("gate", "condition", "found"), rows)
        for check in checks:
            lines += _evidence(check)
    for section in document.sections:
        lines += _section(section)
    if record.premises:
        rows = [cells((p.name, p.value, p.source)) for p in record.premises]
        lines += table(("in effect", "value", "from"), rows)
    lines += ["<details><summary>Assumed</summary>", ""]
    facts = [cells(fact) for fact in document.assumptions.items()]
    facts += [("policy sha256", record.policy.sha256), ("map sha256", record.map.sha256)]
    lines += [*table(("", ""), facts), "</details>", ""]
    return "\n".join(lines)


def _evidence(check: Check) -> list[str]:
    told = [f"- {_escape(sentence)}" for sentence in check.some_evidence(MOST_EVIDENCE)]
    if not told:
        return []
    return [
        f"<details><summary>Not safe: {_escape(check.condition)}</summary>",
        "",
        *told,
        "",
        "</details>",
        "",
    ]


def _section(section: Section) -> list[str]:
    match section:
        case Breakdown():
            rows = [cells((part.name, *part.figures, part.meaning)) for part in section.parts]
            return table(section.head, rows)
        case Rates():
            rows = [
                (_escape(name), *(f"{share.percentage()} ({share.of('/')})" for share in shares))
                for name, shares in section.rows.items()
            ]
            return table((section.title, *section.groups), rows)
        case Table():
            told = ": ".join(text for text in (section.title, section.remark) if text)
            above = [f"{_escape(told)}.", ""] if section.remark else [f"{_escape(told)}", ""] if told else []
            return [*above, *table(section.head, [cells(row) for row in section.rows])]
        case Facts():
            return _facts(section)


def _facts(section: Facts) -> list[str]:
    if len(section.pairs) == 1:
        name, value = section.pairs[0]
        told = ": ".join(text for text in (section.title, name, value) if text)
        return [f"{_escape(told)}.", ""]
    return table((section.title, ""), [cells(pair) for pair in section.pairs])


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table of cells that are Markdown already; none without rows."""
    if not rows:
        return []
    lines = [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)]
    return [*lines, ""]


def cells(texts: Iterable[str]) -> tuple[str, ...]:
    """Return texts that others wrote as cells of a table."""
    return tuple(map(_escape, texts))


def _escape(text: str) -> str:
    """Make a foreign string inert: one line, no markup, no HTML, no mention, no command in a log."""
    return html.escape(shown(text).translate(_SPECIAL), quote=False)
