"""The page of a folder of evidence: one file without scripts that opens offline and prints."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files
from string import Template
from typing import TYPE_CHECKING, Any

from viatool.report.evidence.assumptions import MEANING, Assumption
from viatool.report.evidence.claims import Claim
from viatool.report.evidence.questions import QUESTIONS
from viatool.report.foreign import one_line
from viatool.report.numbers import count
from viatool.report.sections import Check

if TYPE_CHECKING:
    from viatool.report.states.run import StatesRun

MOST_SHOWN = 50
"""Counterexamples on the page; the file holds all."""

_OPEN_FIRST = ("open", "measure-errors", "tool")


def render_page(
    document: StatesRun,
    checks: Sequence[Check],
    claims: Sequence[Claim],
    assumptions: Sequence[Assumption],
    setting: Mapping[str, Any],
    counterexamples: Sequence[Mapping[str, Any]],
) -> str:
    """Return the page: claims, gate, assumptions, premises, counterexamples, inputs, and what reviewers ask.

    Parameters
    ----------
    document : StatesRun
        What was found.
    checks : sequence of Check
        The decided conditions of the gate.
    claims, assumptions : sequence
        As the folder has them.
    setting : mapping
        The plain data of the folder.
    counterexamples : sequence of mapping
        The entries of the witness file.
    """
    record = document.record
    in_order = sorted(assumptions, key=lambda one: _OPEN_FIRST.index(one.status))
    template = Template(files(__package__).joinpath("page.html").read_text(encoding="utf-8"))
    return template.substitute(
        title=_text(f"Evidence: {record.policy.path} on {record.map.path}"),
        headline=_text(f"{document.headline}"),
        subject=_text(", ".join(document.subject)),
        figures=_text(document.headline.figures),
        stake=_text(document.headline.stake),
        claims=_rows((_text(claim.text), _text(claim.figure)) for claim in claims),
        gate=_rows((_text(one.condition), _outcome(one), _text(one.figures)) for one in checks)
        or _rows([(_text("no condition was asked for"), "", "")]),
        open=count(sum(one.status == "open" for one in assumptions)),
        assumptions=_rows(map(_assumption, in_order)),
        premises=_rows((_text(one.name), _text(one.value), _text(one.source)) for one in record.premises),
        counterexamples=_rows(map(_counterexample, counterexamples[:MOST_SHOWN])),
        more=_text(_told(len(counterexamples))),
        inputs=_rows(map(_input, setting["inputs"])),
        versions=_text(", ".join(f"{name} {version}" for name, version in record.versions.items())),
        questions=_rows(
            (
                _text(one.text),
                _text(one.asked_by),
                _link(one.answer, one.link) if one.link else _text(one.answer),
            )
            for one in QUESTIONS
        ),
    )


def _text(value: object) -> str:
    """Return foreign text as it may stand in a page."""
    return escape(one_line(str(value)))


def _link(text: str, place: str) -> str:
    return f'<a href="{escape(place)}">{_text(text)}</a>'


def _rows(rows: Iterable[Sequence[str]]) -> str:
    """Return rows of a table, of cells that are markup."""
    return "\n".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)


def _outcome(check: Check) -> str:
    return "passed" if check.passed else '<span class="failed">failed</span>'


def _assumption(one: Assumption) -> tuple[str, ...]:
    status = f'<span class="{one.status}">{_text(MEANING[one.status])}</span>'
    return _text(one.name), _text(one.value), status, _text(one.how)


def _counterexample(entry: Mapping[str, Any]) -> tuple[str, ...]:
    closest, scenario = entry["closest"], entry["scenario"] or {}
    command = ", ".join(f"{value:.4g}" for value in entry["action"])
    return (
        _text(entry["state"]),
        _text(scenario.get("name", "")),
        _text(f"{entry['time']:.2f} s"),
        _text(command),
        _text(f"{closest['clearance']:.4f} m"),
        _text(closest["obstacle"]),
    )


def _told(number: int) -> str:
    if not number:
        return "None was found, which alone proves nothing: what is proved stands in the claims."
    shown = "" if number <= MOST_SHOWN else f" The first {MOST_SHOWN} are shown."
    return f"{count(number)} in witnesses.json, for viatool replay.{shown}"


def _input(one: Mapping[str, Any]) -> tuple[str, ...]:
    place = _link(one["file"], one["file"]) if one["file"] else _text("not copied")
    return _text(one["role"]), _text(one["name"]), place, f"<code>{_text(one['sha256'])}</code>"
