"""Two reports side by side, as files: Markdown for a pull request, and a page that shows both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from rich.text import Text

from viatool.errors import ConfigurationError
from viatool.report.comparison import TITLES, Row, compared
from viatool.report.document import Document
from viatool.report.files import check_writable, write_whole
from viatool.report.formats.markdown import cells, table
from viatool.report.html.plain import inert, plain_page, scrolling
from viatool.report.palette import STYLE

_OWN = """
td { text-align: right; font-variant-numeric: tabular-nums; }
th[scope="row"] { text-align: left; font-weight: normal; }
.scroll th, .scroll td { white-space: normal; }
tbody + tbody { border-top: 1px solid var(--rule); }
.better { color: var(--well); } .worse { color: var(--ill); }
@media (max-width: 560px) { th, td { padding-right: 10px; } td { font-size: 13px; } }
"""


def comparison_output(text: str) -> tuple[str, Path]:
    """Read FORMAT:PATH.

    Raises
    ------
    ConfigurationError
        If the format is none of a comparison's, or the path cannot be written.
    """
    name, colon, path = text.partition(":")
    if name not in FORMATS or not colon or not path:
        raise ConfigurationError(
            f"'{text}' is not FORMAT:PATH with a known format",
            f"write for example html:compared.html; formats are {', '.join(FORMATS)}",
        )
    check_writable(Path(path))
    return name, Path(path)


def write_comparison(before: Document, after: Document, outputs: Sequence[tuple[str, Path]]) -> None:
    """Write what two reports assumed and found.

    Raises
    ------
    ConfigurationError
        If they are of different kinds, or a file cannot be written.
    """
    for name, path in outputs:
        write_whole(path, FORMATS[name](before, after).encode("utf-8"))


def _markdown(before: Document, after: Document) -> str:
    rows = [
        cells((name, old, new, change.plain))
        for section in compared(before, after)
        for name, old, new, change in section
    ]
    named = [f"{title}: {name}" for title, name in _named(before, after).items()]
    return "\n".join([*(f"- {text}" for text in cells(named)), "", *table(cells(("", *TITLES)), rows)])


def _page(before: Document, after: Document) -> str:
    named = _named(before, after)
    head = "".join(f'<th scope="col">{text}</th>' for text in ("", *TITLES))
    body = "".join(f"<tbody>{''.join(map(_line, section))}</tbody>" for section in compared(before, after))
    headlines = "".join(
        f"<h3>{title}: {inert(named[title])}</h3><p>{inert(one.headline.stake or str(one.headline))}</p>"
        for title, one in zip(named, (before, after), strict=True)
    )
    main = (
        f"<section><h1>Two reports</h1>{headlines}</section>"
        f"<section>{scrolling('Both reports', f'<table><thead><tr>{head}</tr></thead>{body}</table>')}</section>"
    )
    version = after.record.versions.get("viatool", "")
    return plain_page(" and ".join(named.values()), main, f"Made by viatool {version}.", _OWN)


def _line(row: Row) -> str:
    name, old, new, change = row
    figures = "".join(f"<td>{inert(text)}</td>" for text in (old, new))
    return f'<tr><th scope="row">{inert(name)}</th>{figures}<td class="{_tone(change)}">{inert(change.plain)}</td></tr>'


def _tone(change: Text) -> str:
    return {STYLE["safe"]: "better", STYLE["unsafe"]: "worse"}.get(str(change.style), "")


def _named(before: Document, after: Document) -> dict[str, str]:
    """Return short names of both reports, of their policies and files, by the titles of their columns."""
    names = [
        Path(one.record.policy.path).name + ("" if one.path is None else f" ({one.path.name})")
        for one in (before, after)
    ]
    return dict(zip(TITLES, names, strict=False))


FORMATS: dict[str, Callable[[Document, Document], str]] = {"markdown": _markdown, "html": _page}
"""What a comparison can be written as."""
