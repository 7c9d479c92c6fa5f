"""What is claimed, in words, each with the figure of the report that says how much of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from viatool.report.numbers import count, counted
from viatool.setting.rules import Rules


@dataclass(frozen=True)
class Claim:
    """One sentence and its figure.

    Parameters
    ----------
    text : str
        The sentence.
    figure : str
        Where in the report its figure stands: names with dots between.
    value : object
        The figure, as the report has it.
    """

    text: str
    figure: str
    value: Any

    def to_json(self) -> dict[str, Any]:
        """Return the form in the folder."""
        return asdict(self)


def claims_of(report: Mapping[str, Any], rules: Rules) -> list[Claim]:
    """Return the claims of a report on states."""
    figures = {figure: value for figure in _TEXTS if (value := _at(report, figure)) is not None}
    if not figures.get("close_rate.overall", {}).get("total"):  # nobody looked there
        figures.pop("close_rate.overall", None)
    return [Claim(_TEXTS[figure](value, rules), figure, value) for figure, value in figures.items()]


def _at(report: Mapping[str, Any], figure: str) -> Any:
    value: Any = report
    for part in figure.split("."):
        if not isinstance(value, Mapping) or part not in value:
            return None
        value = value[part]
    return value


def _share(rate: Mapping[str, Any]) -> str:
    return f"{count(rate['safe'])} of {count(rate['total'])}"


def _keeps(rate: Mapping[str, Any], rules: Rules, distance: float, which: str) -> str:
    over = {
        "swept": "at every instant of the control interval",
        "braking": "at every instant of the control interval and of a full stop after it",
    }.get(rules.criterion)
    if over is None:
        return f"In {_share(rate)} {which} the sampled commands keep more than {distance:g} m; nothing is proved."
    return (
        f"In {_share(rate)} {which} every command that the policy can give within the sensor error keeps more than "
        f"{distance:g} m between footprint and obstacles {over}."
    )


_TEXTS: dict[str, Any] = {
    "safety_rate.overall": lambda v, r: _keeps(v, r, r.clearance.collision, "states"),
    "danger_rate.overall": lambda v, r: _keeps(v, r, r.clearance.danger, "states"),
    "contested_rate.overall": lambda v, r: (
        f"Some command of the robot would come too near in {count(v['total'])} states; of these {count(v['safe'])} are "
        "safe by what the policy does."
    ),
    "close_rate.overall": lambda v, r: _keeps(v, r, r.clearance.collision, "places close to the drive"),
    "stake": lambda v, r: (
        f"The verdict depended on the policy in {count(v['contested'])} of {count(v['states'])} states."
    ),
    "verdicts.unsafe": lambda v, r: (
        f"{counted(v, 'state has', 'states have')} a counterexample: "
        "a sensor error within the bounds after which the deployed program comes too near."
    ),
    "verdicts.unknown": lambda v, r: (
        f"Of {count(v)} states nothing is claimed." if v else "Every state is safe or has a counterexample."
    ),
    "horizon.verdicts": lambda v, r: (
        f"Followed over the horizon, {count(v['safe'])} states stay safe, {count(v['unsafe'])} do not, and "
        f"{count(v['unknown'])} are unknown."
    ),
}
"""The sentence about each figure."""
