"""What was found: the errors that contested states survive, and those that they do not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices
from viatool.margins.findings import MarginFindings
from viatool.margins.question import Varied
from viatool.margins.varying import Varying
from viatool.setting.asked import Asked
from viatool.setting.premises import Premise
from viatool.setting.setting import Setting
from viatool.trajectory import Trajectory
from viatool.verification.witness_file import compose_witnesses, state_entries

SCHEMA_VERSION = 1
SHARES = {"p10": 0.1, "p25": 0.25, "median": 0.5, "p75": 0.75, "p90": 0.9}
"""Quantiles that are told."""
_POINTS = 51
"""Of the curve."""
_NAMED = 6
_LEAST_WEIGHT = 0.05
"""Entries of an observation that are named for a state: the weightiest, down to this part of the whole."""


@dataclass(frozen=True, eq=False)
class Margins(Asked):
    """How much error each of C contested states survives.

    Parameters
    ----------
    policy_path, policy_sha256 : Path, str
        The policy.
    setting : Setting
        What was asked without the error that varies.
    trajectory : Trajectory
        All N states, and close places behind them.
    driven : int
        How many of them were driven, recorded or picked; the others are close places.
    varied : Varied
        What varies, and how far.
    varying : Varying
        What is asked at each error.
    under_way, begun, velocity : ndarray
        What a setting needs to know of the N states, see `Result`.
    arithmetic : str
        "float32" or "real", the contract of the bounds.
    engine : mapping
        Settings of the engine.
    findings : MarginFindings
        Of the contested states.
    effect : tuple of Premise
        Everything that took effect.
    seconds : mapping
        Time for each stage.
    versions : mapping
        Of the libraries that took part.
    origin, no_close : str
        Where the states come from, and why there are no close places, in words.
    """

    policy_path: Path
    policy_sha256: str
    setting: Setting
    trajectory: Trajectory
    driven: int
    varied: Varied
    varying: Varying
    under_way: Floats
    begun: Floats
    velocity: Floats | None
    arithmetic: str
    engine: Mapping[str, Any]
    findings: MarginFindings
    effect: tuple[Premise, ...]
    seconds: Mapping[str, float]
    versions: Mapping[str, str]
    origin: str = ""
    no_close: str = ""

    EPISODE_COLUMNS: ClassVar = ("entry",)
    """Arrays of the state table that do not have a row for each state."""

    def __len__(self) -> int:
        """Return C."""
        return len(self.states)

    def __repr__(self) -> str:
        """Return how many states are contested, and what the weakest survives."""
        return (
            f"<margins of {len(self)} contested states of {len(self.trajectory)}, the least {self.least:g}>"
        )

    @property
    def states(self) -> Indices:
        """Return which states are contested, (C,): rows of the trajectory, in which close places stand last."""
        return self.findings.state

    @property
    def close(self) -> Booleans:
        """Tell which of the contested states are close places, (C,)."""
        return self.states >= self.driven

    @property
    def certified(self) -> Floats:
        """Return the largest error that is proved safe, (C,); minus infinity where not even 0 is."""
        return self.findings.certified

    @property
    def refuted(self) -> Floats:
        """Return the smallest error with a counterexample, (C,); infinite where none was found."""
        return self.findings.refuted

    @property
    def witness(self) -> Floats:
        """Return the counterexamples within `refuted`, (C, n); NaN where there is none."""
        found = self.findings.witnesses
        witness = np.full((len(self), self.trajectory.observations.shape[1]), np.nan)
        witness[np.searchsorted(self.states, found.state)] = found.observation
        return witness

    @property
    def least(self) -> float:
        """Return the error that every contested state survives; NaN if there is none."""
        return float(self.certified.min()) if len(self) else float("nan")

    @property
    def premises(self) -> tuple[Premise, ...]:
        """Return everything that took effect, and who said so."""
        return self.effect

    @cached_property
    def weakest_first(self) -> Indices:
        """Which contested states survive least, (C,): by what is proved, then by what is refuted."""
        return np.lexsort([self.states, self.refuted, self.certified])

    def decides(self, row: int) -> list[dict[str, Any]]:
        """Return the entries of an observation whose errors decide about the row-th contested state, weightiest first.

        Each with its weight, the part of what all errors together do to the clearance, to first order. None where the
        state fails without an error.
        """
        weight, names = self.findings.weight[row], self.setting.inputs.names
        chosen = [
            i for i in np.argsort(-weight, kind="stable")[:_NAMED].tolist() if weight[i] >= _LEAST_WEIGHT
        ]
        return [{"entry": names[i], "weight": round(float(weight[i]), 4)} for i in chosen]

    def deciding(self) -> list[dict[str, Any]]:
        """Return the mean weight of every entry over the states that an error decides about, weightiest first."""
        weight = self.findings.weight[self.findings.weight.any(axis=1)]
        if not len(weight):
            return []
        mean, names = weight.mean(axis=0), self.setting.inputs.names
        order = [i for i in np.argsort(-mean, kind="stable").tolist() if mean[i] > 0.0]
        return [{"entry": names[i], "weight": round(float(mean[i]), 4)} for i in order]

    def deciding_channels(self) -> dict[str, float]:
        """Return the same for every channel as a whole."""
        inputs, weight = self.setting.inputs, self.findings.weight
        weight = weight[weight.any(axis=1)]
        mean = weight.mean(axis=0) if len(weight) else np.zeros(inputs.size)
        totals = {
            one.name: round(float(mean[inputs.channel == number].sum()), 4)
            for number, one in enumerate(inputs.channels)
        }
        return {
            name: total for name, total in sorted(totals.items(), key=lambda item: -item[1]) if total > 0.0
        }

    def curve(self) -> dict[str, list[float] | list[int]]:
        """Return how many contested states are proved, and how many refuted, at each of some errors."""
        errors = np.linspace(0.0, self.varied.most, _POINTS)
        return {
            "error": errors.round(12).tolist(),
            "proved": (self.certified >= errors[:, None]).sum(axis=1).tolist(),
            "refuted": (self.refuted <= errors[:, None]).sum(axis=1).tolist(),
        }

    def contested_states(self) -> list[dict[str, Any]]:
        """Return every contested state, the weakest first: where it is, what it survives, and what decides."""
        driven, found = self.trajectory, self.findings
        return [
            {
                "state": self._number(state := int(self.states[row])),
                "close": bool(self.close[row]),
                "scenario": driven.name_of(int(driven.episode[state])),
                "time": round(float(driven.time[state]), 6),
                "pose": driven.poses[state].round(6).tolist(),
                "distance": round(float(found.distance[row]), 6),
                "certified": _finite(self.certified[row]),
                "refuted": _finite(self.refuted[row]),
                "decides": self.decides(row),
            }
            for row in self.weakest_first.tolist()
        ]

    def part(self) -> dict[str, Any]:
        """Return what a report says of this policy."""
        return {
            "policy": {"path": str(self.policy_path), "sha256": self.policy_sha256},
            "states": self.driven,
            "contested": int((~self.close).sum()),
            "close": {
                "states": len(self.trajectory) - self.driven,
                "contested": int(self.close.sum()),
                "reason": self.no_close,
            },
            "certified": _quantiles(self.certified, "lower"),
            "refuted": _quantiles(self.refuted, "higher"),
            "curve": self.curve(),
            "deciding": {"channels": self.deciding_channels(), "entries": self.deciding()},
            "contested_states": self.contested_states(),
            "origin": "; ".join([self.origin, *self.trajectory.notes]),
        }

    def to_json(self) -> dict[str, Any]:
        """Return the report as plain data for `json.dumps`, with None where a value does not exist."""
        return document_of([self])

    def _number(self, state: int) -> int:
        """Return the number of a state, or of a close place, among its own kind."""
        return state if state < self.driven else state - self.driven

    def witness_document(self) -> dict[str, Any]:
        """Return the counterexamples as `viatool replay` reads them, each within the smallest error that has one."""
        found, refuted = self.findings.witnesses, dict(zip(self.states.tolist(), self.refuted, strict=True))
        entries = []
        for row, state in enumerate(found.state.tolist()):
            failing = replace(self, setting=self.varying.setting(float(refuted[state])))
            entries += state_entries(failing, found.select(np.array([row])))
        command_map = self.setting.command_map
        return compose_witnesses(
            self.policy_path, self.policy_sha256, self.world_map, command_map, self.rules, entries
        )

    def state_table(self, rows: slice = slice(None)) -> dict[str, NDArray[Any]]:
        """Return arrays with a row for each contested state, in the order of the states, and the names of entries."""
        found, states = self.findings, self.states[rows]
        return {
            "state": np.where(self.close[rows], states - self.driven, states),
            "close": self.close[rows],
            "pose": self.trajectory.poses[states],
            "observation": self.trajectory.observations[states],
            "episode": self.trajectory.episode[states],
            "distance": found.distance[rows],
            "certified": self.certified[rows],
            "refuted": self.refuted[rows],
            "witness": self.witness[rows],
            "weight": found.weight[rows],
            "entry": np.array(self.setting.inputs.names, dtype=np.str_),
        }

    def assumptions(self) -> dict[str, str]:
        """Return what the margins rest on, by name."""
        rules = self.rules
        smaller = "a proof holds for every smaller error, a counterexample for every larger one"
        return {
            "error": f"{self.varied.words}; {smaller}",
            "readings": self.setting.reading_errors.words,
            "footprint": rules.footprint.words,
            "clearance": f"more than {rules.clearance.collision:g} m",
            "motion": rules.moves_as,
            "horizon": f"one command, held for {rules.interval:g} s; each state by itself, not the whole run",
            "decides": "to first order, by the Taylor model at the error at which the proof ends; no proof",
        }


def document_of(margins: Sequence[Margins]) -> dict[str, Any]:
    """Return the report on the margins of one or several policies that were asked the same."""
    first = margins[0]
    stages = dict.fromkeys(stage for each in margins for stage in each.seconds)
    return {
        "schema_version": SCHEMA_VERSION,
        "policy": {"path": str(first.policy_path), "sha256": first.policy_sha256},
        "map": {"path": str(first.world_map.path), "sha256": first.world_map.sha256},
        "eps": first.eps,
        "varied": first.varied.to_json(),
        "criterion": first.rules.criterion,
        "arithmetic": first.arithmetic,
        "engine": dict(first.engine),
        "margins": [each.part() for each in margins],
        "seconds": {stage: round(sum(e.seconds.get(stage, 0.0) for e in margins), 6) for stage in stages},
        "versions": dict(first.versions),
        "assumptions": first.assumptions(),
        "premises": [premise.to_json() for premise in first.premises],
    }


def _finite(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def _quantiles(values: Floats, method: Any) -> dict[str, float | None]:
    """Return the least, the largest and some quantiles, each a value that occurs; None where there is none."""
    if not len(values):
        return dict.fromkeys(("least", *SHARES, "largest"))
    some = {name: np.quantile(values, share, method=method) for name, share in SHARES.items()}
    found = {"least": values.min(), **some, "largest": values.max()}
    return {name: _finite(value) for name, value in found.items()}
