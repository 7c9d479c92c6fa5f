"""Why a state is not safe, in numbers and in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from viatool.arrays import Floats
from viatool.setting.error_costs import EPS

CAUSES = {
    "pose": "it stands too near already, whatever is commanded",
    "policy": "a counterexample that no smaller error would mend: it fails without any error as well",
    "errors": "a counterexample, or no proof, and safe without some of the errors",
    "bounds": "no proof, but what was found attained is safe: tighter bounds may prove it",
    "commands": "no proof, and what was found attained fails, taken together: tighter bounds cannot prove it",
    "open": "no proof; neither are the commands that were found attained shown to fail, nor shown to be safe",
    "unobserved": "no proof, as it is not known what was commanded before",
}
"""What a state is not safe for, by name."""


@dataclass(frozen=True)
class Reason:
    """Why one state is not safe.

    Parameters
    ----------
    state : int
        Its number.
    verdict : str
        "unsafe" or "unknown".
    scenario : str
        Name of its scenario.
    time : float
        Seconds since the start of that.
    pose : tuple of float
        x, y, theta when the policy observes.
    criterion : str
        What had to hold, by its name.
    distance : float
        The clearance to be exceeded, in metres.
    cause : str
        One of `CAUSES`.
    obstacle : str
        What the command comes nearest to, in words; empty where none is known.
    command : ndarray
        (A,) as the robot carries it out: that of the counterexample, or of what cannot be excluded that at an end or in
        the middle of every axis that comes nearest; NaN where nothing is known.
    clearance, seconds : float
        Metres that are left where it comes nearest, and how long after the observation.
    at : tuple of float
        Pose there.
    bound, attained : ndarray
        (2, A) ends of what cannot be excluded, and of what was found attained; NaN where nothing is known.
    standing : float
        Metres that are left where it stands.
    attained_clearance : float
        As `clearance`, of the commands that were found attained.
    without_errors : str
        The verdict without any error; empty where that was not asked.
    needs : tuple of tuple
        Names and values of the least set of errors without which it is safe.
    alternatives : tuple of tuple
        Of other errors that suffice, each by itself.
    share : float
        The largest share of eps, in sixteenths, up to which it is safe; 0 where that is less than one, NaN where it was
        not asked.
    eps : float or mapping
        What that is, as a report tells it.
    refined : bool or None
        Whether ``--refine split`` proves it; None where that was not asked.
    of_sensors : bool
        Whether all errors are those of sensors.
    actions : sequence of tuple
        Names and units of the A entries.
    """

    state: int
    verdict: str
    scenario: str
    time: float
    pose: tuple[float, ...]
    criterion: str
    distance: float
    cause: str
    obstacle: str
    command: Floats
    clearance: float
    seconds: float
    at: tuple[float, ...]
    bound: Floats
    attained: Floats
    standing: float
    attained_clearance: float
    without_errors: str
    needs: tuple[tuple[str, str], ...]
    alternatives: tuple[tuple[str, str], ...]
    share: float
    eps: Any
    refined: bool | None
    of_sensors: bool
    actions: Sequence[tuple[str, str]] = field(repr=False)

    @property
    def gap(self) -> Floats:
        """Return how far the bounds reach beyond what was attained, the farther side of each entry, (A,)."""
        lower, upper = self.attained[0] - self.bound[0], self.bound[1] - self.attained[1]
        return np.asarray(np.maximum(np.maximum(lower, upper), 0.0))

    @property
    def brief(self) -> str:
        """Return in one line what it comes near to, and for want of what."""
        if np.isnan(self.clearance):
            return "what was commanded before is not known"
        if self.verdict == "unsafe":
            found = f"comes within {_metres(self.clearance)} of {self.obstacle}"
        elif self.clearance <= self.distance:
            found = f"cannot exclude {_metres(self.clearance)} from {self.obstacle}"
        else:
            found = f"not proved beside {self.obstacle}"
        loose = f"bounds {'are' if self.refined else 'may be'} too loose" if self.cause == "bounds" else ""
        return "; ".join(part for part in (found, loose, self._errors) if part)

    @property
    def words(self) -> str:
        """Return all of it in sentences."""
        errors = f"It {self._errors}" if self._errors else ""
        told = (self._comes_near, self._reaches, errors, self._others, *self._then)
        return " ".join(f"{sentence}." for sentence in told if sentence)

    @property
    def _comes_near(self) -> str:
        """Return which command comes near to what."""
        keeps = f"more than {self.distance:g} m has to be kept"
        if np.isnan(self.clearance):
            return f"It is not known which commands may act, and {keeps}"
        each = zip(self.actions, self.command.tolist(), strict=True)
        command = _listed([f"{name} {_short(value)} {unit}".rstrip() for (name, unit), value in each])
        near = f"within {_metres(self.clearance)} of {self.obstacle} after {self.seconds:.2f} s; {keeps}"
        if self.verdict == "unsafe":
            return f"An observation within the errors makes the program command {command}, which comes {near}"
        if self.clearance <= self.distance:
            return (
                f"It cannot be excluded that the program commands {command}, which would come {near}, "
                "and no observation was found that fails"
            )
        return (
            "Of the commands that cannot be excluded, those at the ends of their bounds keep "
            f"{_metres(self.clearance)} from {self.obstacle}, {command} coming nearest; {keeps}, "
            "and that all between keep it was not proved"
        )

    @property
    def _reaches(self) -> str:
        """Return how far the bounds are from what was attained."""
        if np.isnan(self.bound).any():
            return ""
        bounds = f"Commands are bounded by {_ends(self.actions, self.bound)}"
        if np.isnan(self.attained).any():
            return f"{bounds}; what of that is attained is not known"
        each = zip(self.actions, self.gap.tolist(), strict=True)
        beyond = _listed([f"{_short(gap)} {unit}".rstrip() for (_, unit), gap in each])
        return (
            f"{bounds}; what was attained is {_ends(self.actions, self.attained)}, so that the bounds reach "
            f"{beyond} beyond that"
        )

    @property
    def _errors(self) -> str:
        """Return which errors it needs, as it is told behind a subject."""
        nothing = "with perfect sensors" if self.of_sensors else "without any error"
        match self.without_errors:
            case "unsafe":
                return f"fails even {nothing}"
            case "unknown":
                return f"is not proved {nothing} either"
            case "safe":
                together = " together" if len(self.needs) > 1 else ""
                return f"is safe without {_listed([f'{name} ({value})' for name, value in self.needs])}{together}"
        return ""

    @property
    def _others(self) -> str:
        """Return which other errors would do as well."""
        if not self.alternatives:
            return ""
        return f"Without {_listed([name for name, _ in self.alternatives], 'or')} instead it is safe as well"

    @property
    def _then(self) -> Sequence[str]:
        """Return what to do about it."""
        match self.cause:
            case "pose":
                stands = f"It stands {_metres(self.standing)} from something"
                return [f"{stands}, so that no command helps: what led there has to change"]
            case "policy":
                change, known = "the policy has to act otherwise here", self.without_errors == "unsafe"
                exact = f"What was observed, taken as exact, makes it fail: {change}"
                return [change.capitalize() if known else exact]
            case "unobserved":
                return ["Record the commands before the state: without them nothing is proved"]
            case "bounds" if self.refined:
                told = [
                    "What was found attained is safe and the bounds are too loose: --refine split proves it"
                ]
            case "bounds":
                tried = "those of --refine split do not" if self.refined is False else "try --refine split"
                told = [f"What was found attained is safe, so that tighter bounds may prove it; {tried}"]
            case "commands":
                told = [
                    "What was found attained fails, taken together, so that tighter bounds cannot prove it"
                ]
            case _:
                told = []
        if self.share > 0.0:
            return [*told, f"It is safe up to {self._up_to}"]
        little = self.share == 0.0 and any(name.startswith(EPS) for name, _ in self.needs)
        return [*told, "Up to a sixteenth of eps it is not proved"] if little else told

    @property
    def _up_to(self) -> str:
        """Return the errors of readings up to which it is safe."""
        if not isinstance(self.eps, Mapping):
            return f"eps {self.eps:g}"
        radii = ", ".join(f"{name} {value:g}" for name, value in self.eps.items() if value)
        return f"{self.share:g} of eps ({radii})"

    def to_json(self) -> dict[str, Any]:
        """Return the reason as plain data, with None where a number is not known."""
        return {
            "state": self.state,
            "verdict": self.verdict,
            "scenario": self.scenario,
            "time": round(self.time, 6),
            "pose": [round(value, 6) for value in self.pose],
            "criterion": self.criterion,
            "distance": self.distance,
            "cause": self.cause,
            "obstacle": self.obstacle or None,
            "command": _plain(self.command),
            "clearance": _number(self.clearance),
            "seconds": _number(self.seconds),
            "at": _plain(np.array(self.at)),
            "bound": _box(self.bound),
            "attained": _box(self.attained),
            "standing": _number(self.standing),
            "attained_clearance": _number(self.attained_clearance),
            "gap": _plain(self.gap),
            "without_errors": self.without_errors or None,
            "needs": [name for name, _ in self.needs],
            "alternatives": [name for name, _ in self.alternatives],
            "safe_up_to": {"share": self.share, "eps": self.eps} if self.share > 0.0 else None,
            "refined": self.refined,
            "brief": self.brief,
            "words": self.words,
        }


@dataclass(frozen=True)
class Reasons:
    """Why states are not safe.

    Parameters
    ----------
    each : tuple of Reason
        Of some states: unsafe ones before unknown ones, and of each those that come nearest to something first.
    total : int
        How many states are not safe.
    """

    each: tuple[Reason, ...] = ()
    total: int = 0

    @property
    def left_out(self) -> int:
        """Return of how many states that are not safe nothing is told."""
        return self.total - len(self.each)

    def then(self, others: Reasons, count: int) -> Reasons:
        """Return these of so many states, and behind them those of others."""
        moved = (replace(one, state=one.state + count) for one in others.each)
        return Reasons((*self.each, *moved), self.total + others.total)

    def to_json(self) -> dict[str, Any]:
        """Return the part of a report that tells of them."""
        return {"reasons": [one.to_json() for one in self.each], "reasons_left_out": self.left_out}


def _ends(actions: Sequence[tuple[str, str]], box: Floats) -> str:
    return _listed(
        [
            f"{name} {_short(low)} to {_short(high)} {unit}".rstrip()
            for (name, unit), low, high in zip(actions, *box.tolist(), strict=True)
        ]
    )


def _listed(parts: Sequence[str], word: str = "and") -> str:
    """Write parts one after the other, a word before the last."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} {word} {parts[-1]}"


def _metres(value: float) -> str:
    return f"{value:.4g} m"


def _short(value: float) -> str:
    return f"{value:.4g}"


def _number(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def _plain(numbers: Floats) -> list[float] | None:
    return None if np.isnan(numbers).any() else [float(value) for value in numbers]


def _box(ends: Floats) -> dict[str, list[float]] | None:
    lower, upper = _plain(ends[0]), _plain(ends[1])
    return None if lower is None or upper is None else {"lower": lower, "upper": upper}
