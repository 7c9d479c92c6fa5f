"""What is known of missions: a verdict for each, bounds, the tube, and the runs that were driven against it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats, Indices
from viatool.loop.destination import Destination
from viatool.loop.horizon import Crashes
from viatool.missions.arrival import destination_of
from viatool.missions.attack import MissionRuns
from viatool.missions.follow import MissionLimits, MissionProof, MissionTube
from viatool.policy import Policy
from viatool.setting.asked import Asked
from viatool.setting.setting import Setting
from viatool.world import Scenario

SCHEMA_VERSION = 1
MISSION_VERDICTS = ("proved", "refuted", "unknown")
_NOT_BEGUN = "the time was up before it was done"


@dataclass(frozen=True)
class MissionNeeds:
    """Which errors a mission takes that is not proved.

    Parameters
    ----------
    without_errors : str
        Its verdict without any error.
    alone : tuple of str
        Errors without each of which it is proved, all others in place.
    others : tuple of str
        Errors without each of which it is not proved; those about which there was no time to ask are in neither.
    """

    without_errors: str
    alone: tuple[str, ...]
    others: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Return plain data."""
        return {"without_errors": self.without_errors, "alone": list(self.alone), "others": list(self.others)}


@dataclass(frozen=True, eq=False)
class Mission:
    """One mission.

    Parameters
    ----------
    scenario : Scenario
        Start, goal and obstacles.
    interval : float
        Seconds of a control interval.
    proof : MissionProof
        What following every run found.
    paths : ndarray
        (R, K + 1, 2) places of the runs that were driven against it, where intervals begin; NaN after they arrived.
    arrived : ndarray
        (R,) intervals after which each of them arrives; K + 1 for one that does not.
    crashes : Crashes
        At most one run that collides.
    late : Crashes
        At most one run that is still on its way at the end; its last interval stands for the closest one.
    seconds : float
        Of processor time.
    task : str
        Where its runs arrive, and when, in words.
    arrival : tuple of float
        Seconds after which runs may have arrived, and all of them have if it is proved.
    driven_arrival : tuple of float or None
        Seconds after which the first and the last of the driven runs arrives that do; None if none does.
    near : str
        What the run comes near to that collides, in words; empty without one.
    flawless : tuple of float or None
        Of the run from the middle of the starts without any error: seconds after which it arrives, infinite if it does
        not, and the least clearance; None where motors and timing err in every run.
    needs : MissionNeeds, optional
        Which errors it takes, if that was asked of one that is not proved.
    """

    scenario: Scenario
    interval: float
    proof: MissionProof
    paths: Floats
    arrived: Indices
    crashes: Crashes
    late: Crashes
    seconds: float
    task: str = ""
    arrival: tuple[float, float] = (0.0, 0.0)
    driven_arrival: tuple[float, float] | None = None
    near: str = ""
    flawless: tuple[float, float] | None = None
    needs: MissionNeeds | None = None

    @property
    def verdict(self) -> str:
        """Return proved, refuted or unknown; a run that refutes it counts, whatever was found beside it."""
        if len(self.crashes) or len(self.late):
            return "refuted"
        return "proved" if self.proof.proved else "unknown"

    @property
    def steps(self) -> int:
        """Return the control intervals that were followed: of a proved mission, those after which all have arrived."""
        return self.proof.steps

    @property
    def clearance(self) -> float:
        """Return the metres that every run keeps; of a refuted mission, those that the run keeps which collides."""
        return float(self.crashes.clearance[0]) if len(self.crashes) else self.proof.clearance

    @property
    def reason(self) -> str:
        """Return why it is not proved; empty for a proved mission."""
        if len(self.crashes):
            x, y, _ = self.crashes.place[0]
            after = int(self.crashes.step[0]) * self.interval + float(self.crashes.seconds[0])
            near = f"{self.crashes.clearance[0]:.3f} m of {self.near or 'something'}"
            return f"a run comes within {near}, at ({x:.2f}, {y:.2f}) after {after:.2f} s"
        if len(self.late):
            x, y, _ = self.late.place[0]
            limit = self.late.poses.shape[1] * self.interval
            return f"a run is still on its way after {limit:g} s, at ({x:.2f}, {y:.2f})"
        return self.proof.reason

    def to_json(self) -> dict[str, Any]:
        """Return the mission as plain data."""
        proof = self.proof
        return {
            "scenario": self.scenario.name,
            "start": list(self.scenario.start),
            "goal": list(self.scenario.goal),
            "starts": self.scenario.starts.words() if self.scenario.starts else "",
            "task": self.task,
            "deadline": self.scenario.deadline,
            "verdict": self.verdict,
            "steps": self.steps,
            "arrival": list(self.arrival) if self.verdict == "proved" else None,
            "driven_arrival": None if self.driven_arrival is None else list(self.driven_arrival),
            "driven": len(self.arrived),
            "seconds": round(self.seconds, 3),
            "clearance": None if np.isinf(self.clearance) else self.clearance,
            "parts": proof.most_parts,
            "start_parts": proof.start_parts,
            "reason": self.reason,
            "flawless_run": self._flawless,
            "needs": None if self.needs is None else self.needs.to_json(),
        }

    @property
    def _flawless(self) -> dict[str, float | None] | None:
        """Return what is known of the run without any error."""
        if self.flawless is None:
            return None
        seconds, clearance = (None if np.isinf(value) else value for value in self.flawless)
        return {"arrives": seconds, "clearance": clearance}

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return what was found as arrays; the scenario is not in them."""
        proof, tube = self.proof, self.proof.tube
        numbers = [
            proof.proved,
            proof.steps,
            proof.earliest,
            proof.clearance,
            proof.most_parts,
            proof.start_parts,
        ]
        return {
            "numbers": np.array([*numbers, self.interval, self.seconds, *self.arrival], dtype=np.float64),
            "driven_arrival": np.array(self.driven_arrival or [], dtype=np.float64),
            "near": np.array(self.near),
            "flawless": np.array(self.flawless or [], dtype=np.float64),
            "reason": np.array(proof.reason),
            "task": np.array(self.task),
            **{f"tube_{each.name}": getattr(tube, each.name) for each in fields(MissionTube)},
            "paths": self.paths,
            "arrived": self.arrived,
            **{f"crash_{each.name}": getattr(self.crashes, each.name) for each in fields(Crashes)},
            **{f"late_{each.name}": getattr(self.late, each.name) for each in fields(Crashes)},
        }

    @classmethod
    def from_arrays(cls, scenario: Scenario, arrays: Mapping[str, NDArray[Any]]) -> Mission:
        """Return what `to_arrays` was called on."""
        numbers = arrays["numbers"].tolist()
        proved, steps, earliest, clearance, most, start, interval, seconds, *arrival = numbers
        tube = MissionTube(*(arrays[f"tube_{each.name}"] for each in fields(MissionTube)))
        reason = str(arrays["reason"])
        proof = MissionProof(
            bool(proved), int(steps), int(earliest), clearance, int(most), int(start), reason, tube
        )
        crashes, late = (
            Crashes(*(arrays[f"{kind}_{each.name}"] for each in fields(Crashes)))
            for kind in ("crash", "late")
        )
        driven, task = (arrays["paths"], arrays["arrived"], crashes, late), str(arrays["task"])
        times, flawless = (arrays[name].tolist() for name in ("driven_arrival", "flawless"))
        ends = (arrival[0], arrival[1]), (times[0], times[1]) if times else None
        known = str(arrays["near"]), (flawless[0], flawless[1]) if flawless else None
        return cls(scenario, interval, proof, *driven, seconds, task, *ends, *known)

    @classmethod
    def not_begun(
        cls, scenario: Scenario, setting: Setting, task: str = "", reason: str = _NOT_BEGUN
    ) -> Mission:
        """Return a mission for which there was no time, or another reason not to do it."""
        rules, size = setting.rules, len(setting.radii)
        interval, axes, state = rules.interval, len(rules.lower), len(rules.kinematics.state)
        none = np.zeros((0, 3 + len(rules.carried)))
        tube = MissionTube(np.zeros(0, np.int64), none, none)
        proof = MissionProof(False, 0, 0, np.inf, 0, 0, reason, tube)
        crashes = Crashes.none(1, size, axes, state)
        driven = np.zeros((0, 1, 2)), np.zeros(0, np.int64), crashes, crashes
        return cls(scenario, interval, proof, *driven, 0.0, task)


@dataclass(frozen=True, eq=False)
class Missions(Asked):
    """The missions of one policy on a map.

    Parameters
    ----------
    policy : Policy
        What drives.
    setting : Setting
        What was asked, as it took effect.
    missions : tuple of Mission
        In the order of the scenarios.
    start_error : tuple of float
        Metres in x and y, and radians, by which starts may be off.
    limits : MissionLimits
        Within how many intervals every run has to arrive, and in how many parts.
    goal_radius : float
        Metres.
    arithmetic : str
        Contract of the bounds.
    seed : int
        Of the runs that were driven against the missions.
    seconds, versions : mapping
        Time by stage, and what a repetition would need.
    interrupted : bool
        Whether somebody interrupted the work, so that the last missions are not known.
    unjudged : tuple of Scenario
        Those behind, of which nobody judged a mission, as it was enough: they count into nothing.
    """

    policy: Policy
    setting: Setting
    missions: tuple[Mission, ...]
    start_error: tuple[float, float, float]
    limits: MissionLimits
    goal_radius: float
    arithmetic: str
    seed: int
    seconds: Mapping[str, float]
    versions: Mapping[str, str]
    interrupted: bool = False
    unjudged: tuple[Scenario, ...] = ()

    def __iter__(self) -> Iterator[Mission]:
        """Go through the missions."""
        return iter(self.missions)

    def __len__(self) -> int:
        """Return the number of missions."""
        return len(self.missions)

    def destination(self, scenario: Scenario) -> Destination:
        """Return where runs of a scenario arrive."""
        return destination_of(scenario, self.setting, self.goal_radius)

    @cached_property
    def counts(self) -> dict[str, int]:
        """Return how many missions have each verdict."""
        return count_verdicts(self.missions)

    def to_json(self) -> dict[str, Any]:
        """Return the report as plain data."""
        proved, total = self.counts["proved"], len(self.missions)
        return {
            "schema_version": SCHEMA_VERSION,
            "policy": {"path": str(self.policy.path), "sha256": self.policy.sha256},
            "map": {"path": str(self.world_map.path), "sha256": self.world_map.sha256},
            "eps": self.eps,
            "criterion": self.rules.criterion,
            "collision_distance": self.rules.clearance.collision,
            "arithmetic": self.arithmetic,
            "start_error": list(self.start_error),
            "time_limit": self.rules.seconds_after(self.limits.steps)[1],
            "goal_radius": self.goal_radius,
            "limits": {
                "parts": self.limits.parts,
                "position": self.limits.position,
                "heading": self.limits.heading,
                "finer": self.limits.finer,
            },
            "mission_verdicts": self.counts,
            "mission_rate": {"safe": proved, "total": total, "rate": proved / total if total else None},
            **self._not_judged,
            "missions": [mission.to_json() for mission in self.missions],
            "seed": self.seed,
            "seconds": dict(self.seconds),
            "versions": dict(self.versions),
            "premises": [premise.to_json() for premise in self.premises],
        }

    @property
    def _not_judged(self) -> dict[str, Any]:
        """Return which missions were left out; nothing if none was."""
        names = [scenario.name for scenario in self.unjudged]
        return {"not_judged": {"overall": len(names), "scenarios": names}} if names else {}

    def tube_table(self) -> dict[str, NDArray[Any]]:
        """Return the parts of all tubes: scenario and interval (P,), ends (P, 3 + A)."""
        tubes = [mission.proof.tube for mission in self.missions]
        axes = 3 + len(self.rules.carried)
        return {
            "scenario": np.concatenate(
                [
                    np.zeros(0, dtype="U1"),
                    *(
                        np.full(len(tube.step), m.scenario.name)
                        for m, tube in zip(self.missions, tubes, strict=True)
                    ),
                ]
            ),
            "step": _joined([tube.step for tube in tubes], np.zeros(0, np.int64)),
            "lower": _joined([tube.lower.reshape(-1, axes) for tube in tubes], np.zeros((0, axes))),
            "upper": _joined([tube.upper.reshape(-1, axes) for tube in tubes], np.zeros((0, axes))),
        }


def count_verdicts(missions: Sequence[Mission]) -> dict[str, int]:
    """Return how many missions have each verdict."""
    found = [mission.verdict for mission in missions]
    return {verdict: found.count(verdict) for verdict in MISSION_VERDICTS}


def late_run(found: MissionRuns) -> Crashes:
    """Return one run that is still on its way at the end, in the form of a run that collides; none if all arrive."""
    runs = found.runs
    _, steps, size = runs.observations.shape
    if not len(found.late):
        return Crashes.none(steps, size, runs.actions.shape[2], runs.motions.shape[2])
    row = found.late[:1]
    return Crashes(
        np.zeros(1, np.int64), runs.poses[row], runs.observations[row], runs.actions[row], runs.motions[row],
        np.array([steps - 1]), np.zeros(1), runs.ends[row, -1], runs.clearance[row].min(axis=1),
    )  # fmt: skip


def _joined(rows: Sequence[NDArray[Any]], none: NDArray[Any]) -> NDArray[Any]:
    return np.concatenate([none, *rows])
