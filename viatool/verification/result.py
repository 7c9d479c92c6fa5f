"""What a verification found: verdicts, rates, counterexamples, and on what they rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices
from viatool.policy import Maps, ObservationChannel
from viatool.safety.counterexamples import Witnesses
from viatool.safety.judgement import Contested, Judgement
from viatool.safety.reasons import Reasons
from viatool.setting.asked import Asked
from viatool.setting.error_costs import ErrorCosts
from viatool.setting.setting import ActionName, Setting
from viatool.simulate import Agreement
from viatool.taylor import ReachableSet
from viatool.trajectory import Trajectory
from viatool.verification.assumed import assumptions_of
from viatool.verification.horizon_result import HorizonResult
from viatool.verification.notebook import table_of
from viatool.verification.rates import RateByOutcome
from viatool.verification.so_far import Unjudged

SCHEMA_VERSION = 1
VERDICTS = ("safe", "unsafe", "unknown")


@dataclass(frozen=True, eq=False)
class Result(Asked):
    """The outcome of one verification over N states.

    Parameters
    ----------
    policy_path, policy_sha256 : Path, str
        The policy that was verified.
    setting : Setting
        What was asked, as it took effect.
    trajectory : Trajectory
        The states, their episodes and outcomes; observations as the policy received them.
    arithmetic : str
        "float32" or "real", the contract of the bounds.
    engine : dict
        Settings of the engine.
    under_way : ndarray
        (N, W, 2) commands that acted during the dead time, the oldest first; NaN where one is not known.
    begun : ndarray
        (N, 2, S) ends of the state of the motion that each state begins with; NaN where it is not known.
    reachable : ReachableSet
        (N, A) bounds of the commands, in the order of the axes of the kinematics and before the robot's limits; NaN for
        states that were settled without them.
    contested : Contested
        Which states some admissible command of the robot could make fail.
    judgement : Judgement
        Which states the criterion, and the paper's nine actions, find safe.
    witnesses : Witnesses
        The counterexamples.
    seconds : dict
        Time for each stage.
    versions : dict
        Of the libraries that took part.
    origin : str
        Where the states come from, in words.
    maps : Maps
        What is applied to the numbers before and after the network, in words.
    horizon : HorizonResult, optional
        What was found of the intervals that follow each state, if that was asked.
    recording : tuple of Agreement
        How recorded LiDAR readings agree with the map, one for each LiDAR; empty for states that were simulated.
    error_costs : ErrorCosts, optional
        What each error costs in verdicts, if that was asked.
    reasons : Reasons
        Why states are not safe.
    bounded_every : int
        Widths are those of every so manieth state; with 0 and 1 of all that are bounded.
    velocity : ndarray, optional
        (N, 2, 3) ends of the velocity that the robot was measured to have, NaN where it was not, as far as that counts.
    close : Result, optional
        Of the close places beside the states, in the same episodes: what was found there counts into nothing else.
    no_close : str
        Why there are none, where some were asked for.
    unjudged : mapping
        How many states more there were that nobody judged, as it was enough: `overall`, and of the episodes with each
        outcome. They count into nothing. Episodes are all of the drive.
    """

    policy_path: Path
    policy_sha256: str
    setting: Setting
    trajectory: Trajectory
    arithmetic: str
    engine: Mapping[str, Any]
    under_way: Floats
    begun: Floats
    reachable: ReachableSet
    contested: Contested
    judgement: Judgement
    witnesses: Witnesses
    seconds: Mapping[str, float]
    versions: Mapping[str, str]
    origin: str = ""
    maps: Maps = field(default_factory=Maps)
    horizon: HorizonResult | None = None
    recording: tuple[Agreement, ...] = ()
    error_costs: ErrorCosts | None = None
    reasons: Reasons = field(default_factory=Reasons)
    velocity: Floats | None = None
    bounded_every: int = 1
    close: Result | None = None
    no_close: str = ""
    unjudged: Unjudged = field(default_factory=dict)

    EPISODE_COLUMNS: ClassVar = ("outcome",)
    """Arrays of the state table with one row for each episode instead of one for each state."""

    @property
    def radii(self) -> Floats:
        """Return the uncertainty of every observation entry, (n,)."""
        return self.setting.radii

    @property
    def channels(self) -> tuple[ObservationChannel, ...]:
        """Return what the n entries of an observation are."""
        return tuple(self.setting.spec.observation)

    @property
    def actions(self) -> tuple[ActionName, ...]:
        """Return names and units of the A entries of a command."""
        return self.setting.commands

    @property
    def criterion(self) -> str:
        """Return the name of the criterion."""
        return self.rules.criterion

    @cached_property
    def verdict(self) -> NDArray[np.str_]:
        """Return the verdict of each state, (N,): safe, unsafe or unknown."""
        verdict = np.where(self.judgement.safe, "safe", "unknown")
        verdict[self.witnesses.state] = "unsafe"
        return verdict

    @property
    def poses(self) -> Floats:
        """Return the poses (N, 3)."""
        return self.trajectory.poses

    @property
    def observations(self) -> Floats:
        """Return the observations (N, n) as the policy received them."""
        return self.trajectory.observations

    @property
    def episode(self) -> Indices:
        """Return the episode of each state, (N,)."""
        return self.trajectory.episode

    @property
    def outcomes(self) -> NDArray[np.str_]:
        """Return the outcome of each episode, (E,)."""
        return self.trajectory.outcomes

    @property
    def lower(self) -> Floats:
        """Return the lower bounds of the commands, (N, A)."""
        return self.reachable.lower

    @property
    def upper(self) -> Floats:
        """Return the upper bounds of the commands, (N, A)."""
        return self.reachable.upper

    @cached_property
    def commands(self) -> tuple[Floats, Floats]:
        """Return the ends of the commands as the robot carries them out, two arrays (N, A)."""
        return self.rules.clip(self.lower), self.rules.clip(self.upper)

    @property
    def witness(self) -> Floats:
        """Return the counterexample of each state, (N, n), NaN where there is none."""
        return self._witness(slice(None))

    @property
    def safety_rate(self) -> RateByOutcome:
        """Return the share of states that are safe by the criterion at d_col."""
        return self._rate(self.judgement.safe)

    @property
    def sampled_safety_rate(self) -> RateByOutcome:
        """Return the share of states that pass the paper's nine actions at d_col; not a proof."""
        return self._rate(self.judgement.sampled)

    @property
    def danger_rate(self) -> RateByOutcome:
        """Return the share of states that are safe by the criterion at d_danger."""
        return self._rate(self.judgement.danger)

    @property
    def contested_rate(self) -> RateByOutcome:
        """Return the share of the contested states that are safe."""
        return self._rate(self.judgement.safe, self.contested.collision)

    @property
    def close_rate(self) -> RateByOutcome:
        """Return the share of the close places that are safe, by the outcomes of the episodes that they are beside."""
        if self.close is None:
            return RateByOutcome.of(np.zeros(0, dtype=bool), np.zeros(0, dtype=np.str_))
        return self.close.contested_rate

    @property
    def stake(self) -> dict[str, int]:
        """Return in how many states the verdict depended on the policy, as `contested`, of how many `states`."""
        return {"contested": int(self.contested.collision.sum()), "states": len(self.trajectory)}

    def _rate(self, safe: Booleans, counted: Booleans | None = None) -> RateByOutcome:
        return RateByOutcome.of(safe, self.outcomes[self.episode], counted)

    def _witness(self, rows: slice) -> Floats:
        first, last, _ = rows.indices(len(self.trajectory))
        witness = np.full((last - first, len(self.radii)), np.nan)
        there = slice(*np.searchsorted(self.witnesses.state, (first, last)).tolist())
        witness[self.witnesses.state[there] - first] = self.witnesses.observation[there]
        return witness

    def state_table(self, rows: slice = slice(None)) -> dict[str, NDArray[Any]]:
        """Return the arrays of the state table.

        Parameters
        ----------
        rows : slice
            Which states, without steps; all by default.

        Returns
        -------
        dict
            One row for each of the states, and `EPISODE_COLUMNS` with one for each episode.
        """
        observations = self.observations[rows]
        drift = self.setting.drift(self.poses[rows], self.trajectory.scenarios, self.episode[rows])
        lower, upper = self.setting.observed(observations, drift)
        return {
            "pose": self.poses[rows],
            "observation": observations,
            "eps": np.broadcast_to(self.radii, observations.shape),
            "observation_lower": lower,
            "observation_upper": upper,
            "lower": self.lower[rows],
            "upper": self.upper[rows],
            **({} if self.reachable.possible is None else {"possible": self.reachable.possible[rows]}),
            "verdict": self.verdict[rows],
            "danger": self.judgement.danger[rows],
            "sampled": self.judgement.sampled[rows],
            "contested": self.contested.collision[rows],
            "episode": self.episode[rows],
            "outcome": self.outcomes,
            **({} if not self.trajectory.people.shape[1] else {"people": self.trajectory.people[rows]}),
            "witness": self._witness(rows),
            **({} if self.horizon is None else self.horizon.state_table(rows)),
            **({} if self.error_costs is None else {"fails_by": self._fails_by[rows]}),
        }

    @cached_property
    def _fails_by(self) -> NDArray[np.str_]:
        assert self.error_costs is not None
        return self.error_costs.column(len(self.trajectory))

    def _repr_html_(self) -> str:
        """Return what a notebook shows: verdicts and rates."""
        return table_of(self)

    def to_json(self) -> dict[str, Any]:
        """Return the report as plain data for `json.dumps`, with None where a value does not exist."""
        return {
            "schema_version": SCHEMA_VERSION,
            "policy": {"path": str(self.policy_path), "sha256": self.policy_sha256},
            "map": {"path": str(self.world_map.path), "sha256": self.world_map.sha256},
            "eps": self.eps,
            "criterion": self.criterion,
            "arithmetic": self.arithmetic,
            "engine": dict(self.engine),
            "states": len(self.trajectory),
            "verdicts": self.verdicts(),
            **({"not_judged": dict(self.unjudged)} if self.unjudged else {}),
            "safety_rate": self.safety_rate.to_json(),
            "sampled_safety_rate": self.sampled_safety_rate.to_json(),
            "danger_rate": self.danger_rate.to_json(),
            "contested_rate": self.contested_rate.to_json(),
            "close_rate": self.close_rate.to_json(),
            "stake": self.stake,
            "task": self.task(),
            "reachable_width": self.reachable_width(),
            **({"possible": possible} if (possible := self.possible()) else {}),
            "seconds": {stage: round(seconds, 6) for stage, seconds in self.seconds.items()},
            "versions": dict(self.versions),
            "assumptions": self.assumptions(),
            "premises": [premise.to_json() for premise in self.premises],
            "unsafe_states": self.unsafe_states(),
            **self.reasons.to_json(),
            **({"close": self._close_json()} if self.close is not None or self.no_close else {}),
            **({} if self.horizon is None else {"horizon": self.horizon.to_json()}),
            **({"recording": [found.to_json() for found in self.recording]} if self.recording else {}),
            **({} if self.error_costs is None else {"error_costs": self.error_costs.to_json("states")}),
        }

    def verdicts(self) -> dict[str, int]:
        """Return how many states have each verdict."""
        return {name: int((self.verdict == name).sum()) for name in VERDICTS}

    def _close_json(self) -> dict[str, Any]:
        """Return what was found at close places, as plain data."""
        close = self.close
        if close is None:
            none = dict.fromkeys(VERDICTS, 0)
            return {"states": 0, "verdicts": none, "unsafe_states": [], "reason": self.no_close}
        return {
            "states": len(close.trajectory),
            "verdicts": close.verdicts(),
            "unsafe_states": close.unsafe_states(),
            **close.reasons.to_json(),
        }

    def unsafe_states(self) -> list[dict[str, Any]]:
        """Return where each unsafe state is: scenario, seconds since its start and pose, to be known again."""
        trajectory = self.trajectory
        return [
            {
                "state": int(state),
                "scenario": trajectory.name_of(int(trajectory.episode[state])),
                "time": round(float(trajectory.time[state]), 6),
                "pose": trajectory.poses[state].round(6).tolist(),
            }
            for state in self.witnesses.state
        ]

    def task(self) -> dict[str, int | float | None]:
        """Return how the episodes ended: simulated or recorded, never proved."""
        known = self.outcomes[self.outcomes != "unknown"]
        shares = {
            f"{outcome}_rate": float((known == outcome).mean()) if known.size else None
            for outcome in ("success", "collision", "timeout")
        }
        costs = self.trajectory.costs[np.isfinite(self.trajectory.costs)]
        cost = float(costs.mean()) if costs.size else None
        return {"episodes": self.trajectory.episodes, **shares, "average_cost": cost}

    def reachable_width(self) -> dict[str, dict[str, Any]]:
        """Return mean, standard deviation and maximum of the width of each action, where it was bounded."""
        widths = self.reachable.width[:: max(self.bounded_every, 1)]
        widths = widths[np.isfinite(widths).all(axis=1)]
        if not len(widths):
            return {}
        return {
            action.name: {
                "mean": float(width.mean()),
                "std": float(width.std()),
                "max": float(width.max()),
                "unit": action.unit,
            }
            for action, width in zip(self.actions, widths.T, strict=True)
        }

    @property
    def moving(self) -> tuple[Floats, Floats]:
        """Return the ends (N, A + S) of the commands, behind them those of the state in which they are given."""
        lower, upper = self.commands
        return self.rules.begun(lower, upper, self.begun) if self.rules.kinematics.state else (lower, upper)

    def possible(self) -> dict[str, Any]:
        """Return how many commands of its table a policy may choose in a state where that was asked; none else."""
        bounded = np.isfinite(self.lower).all(axis=1)
        if self.reachable.possible is None or not bounded.any():
            return {}
        counts = self.reachable.possible[bounded].sum(axis=1)
        return {
            "commands": self.reachable.possible.shape[1],
            "mean": float(counts.mean()),
            "most": int(counts.max()),
        }

    def assumptions(self) -> dict[str, Any]:
        """Return what the verdicts rest on, by name."""
        return assumptions_of(self)
