"""What every page is built in: one self-contained file that runs its own scripts and reaches no network."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Sequence
from hashlib import sha256
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import bokeh
from bokeh.embed import json_item
from bokeh.plotting import figure
from bokeh.resources import Resources
from jinja2 import Environment, FunctionLoader, StrictUndefined

from viatool.report.foreign import one_line
from viatool.report.html.gate import Address, conditions_of, no_address
from viatool.report.numbers import count
from viatool.report.palette import COLOUR
from viatool.report.sections import Check
from viatool.report.wording import identities

if TYPE_CHECKING:
    from viatool.report.document import Document

_SHARED = "viatool.report.html"
_EVERY = ("contents.js", "announce.js", "links.js")
"""Scripts of every page, which run before its own."""


def assemble(
    document: Document,
    package: str,
    template: str,
    scripts: Sequence[str],
    *,
    title: str,
    data: Any,
    figures: Sequence[figure],
    checks: Sequence[Check],
    address: Address = no_address,
    **context: Any,
) -> str:
    """Return a page.

    Parameters
    ----------
    document : Document
        What it tells of; the facts that every page has are taken from it.
    package : str
        Where its template and scripts are, unless they are those of every page.
    template : str
        Name of the template, which extends ``base.html``.
    scripts : sequence of str
        Names of its scripts, in the order in which they run.
    title : str
        What the page is, after policy and map.
    data : Any
        Plain data that the scripts read.
    figures : sequence of figure
        Each is embedded in the element ``plot-NAME``; without any, the page carries no plotting library.
    checks : sequence of Check
        The decided conditions of the gate.
    address : callable
        Returns where the page shows a part of the run.
    **context : Any
        What else the template speaks of.
    """

    def asset(name: str) -> str:
        own = files(package).joinpath(name)
        return (own if own.is_file() else files(_SHARED).joinpath(name)).read_text(encoding="utf-8")

    record = document.record
    sources = [*(_library() if figures else ()), *map(asset, (*_EVERY, *scripts))]
    environment = Environment(
        loader=FunctionLoader(asset), autoescape=True, undefined=StrictUndefined, keep_trailing_newline=True
    )
    environment.filters["line"] = lambda text: one_line(str(text))
    return environment.get_template(template).render(
        content_policy=content_security_policy(sources),
        title=one_line(f"{record.policy.path} on {record.map.path}: {title}"),
        version=record.versions.get("viatool", ""),
        premises=[(p.name, p.value, p.source) for p in record.premises],
        assumptions={**document.assumptions, **identities(document)},
        colours=COLOUR,
        style=asset("style.css"),
        scripts=sources,
        data=as_script(data),
        figures=as_script([json_item(plot, f"plot-{plot.name}") for plot in figures]),
        bokeh_version=bokeh.__version__ if figures else "",
        conditions=conditions_of(checks, address),
        filtered=address is not no_address,
        told=_told(checks),
        gate_passed=all(check.passed for check in checks),
        **context,
    )


def _told(checks: Sequence[Check]) -> str:
    """Say how many of the conditions hold."""
    failed = sum(not check.passed for check in checks)
    return f"{count(failed or len(checks))} of {count(len(checks))} conditions {'do not hold' if failed else 'hold'}"


def content_security_policy(scripts: Sequence[str]) -> str:
    """Return a policy that runs these very scripts, and loads nothing from anywhere."""
    hashes = " ".join(f"'sha256-{b64encode(sha256(s.encode()).digest()).decode()}'" for s in scripts)
    # Bokeh styles its elements inline, and its pictures are data.
    return f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data: blob:"


def as_script(content: Any) -> str:
    """Return JSON that no string in it can end: it stands in a script element."""
    text = json.dumps(content, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _library() -> list[str]:
    """Return the scripts of the plotting library, without what would end their element."""
    resources = Resources(mode="inline", components=["bokeh"], log_level="error")
    return [script.replace("</script", "<\\/script") for script in resources.js_raw]
