"""Pages of text and tables in the style of the reports: no script, no extra, nothing that is fetched."""

from __future__ import annotations

import re
from html import escape
from importlib.resources import files

from viatool.report.foreign import one_line
from viatool.report.palette import COLOUR

_POLICY = "default-src 'none'; style-src 'unsafe-inline'"


def plain_page(title: str, main: str, footer: str, style: str = "") -> str:
    """Return a page.

    Parameters
    ----------
    title, footer : str
        Text.
    main : str
        HTML, in which whatever others wrote is `inert`.
    style : str
        CSS, on top of that of the reports.
    """
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{_POLICY}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{inert(title)}</title>
<style>{_style()}{style}</style>
</head>
<body>
<main>
{main}
</main>
<footer>{inert(footer)}</footer>
</body>
</html>
"""


def scrolling(name: str, table: str) -> str:
    """Return a table in a frame that scrolls by itself, on phones and with the keys."""
    return f'<div class="scroll" tabindex="0" role="region" aria-label="{inert(name)}">{table}</div>'


def inert(text: str) -> str:
    """Return a text that others wrote as HTML without effect, on one line."""
    return escape(one_line(text))


def _style() -> str:
    """Return the style of the reports; without a script, the system alone chooses between light and dark."""
    style = files("viatool.report.html").joinpath("style.css").read_text(encoding="utf-8")
    colours = " ".join(f"--{name}: {value};" for name, value in COLOUR.items())
    dark = re.search(r':root\[data-theme="dark"\]\s*(\{[^}]*\})', style)
    at_night = f"@media screen and (prefers-color-scheme: dark) {{ :root {dark[1]} }}" if dark else ""
    return f":root {{ {colours} }}\n{style}\n{at_night}\n"
