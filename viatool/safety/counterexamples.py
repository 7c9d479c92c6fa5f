"""Counterexamples: what was observed, what the deployed program did, and what it came near to."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices
from viatool.safety.nearest import describe_mover, describe_nearest
from viatool.world import Footprint, Nearest, Scenario, WorldMap


@dataclass(frozen=True, eq=False)
class Witnesses:
    """W counterexamples.

    Parameters
    ----------
    state : ndarray
        (W,) index of the state.
    observation : ndarray
        (W, n) float32 numbers within the box of the state.
    action : ndarray
        (W, A) commands as onnxruntime computed them, clipped by the robot.
    seconds : ndarray
        (W,) time from the observation to the closest approach.
    pose : ndarray
        (W, 3) where the robot is then.
    clearance : ndarray
        (W,) metres that are left then.
    start, believed : ndarray
        (W, 3) where the robot is when it observes, and where it believes to be.
    mover : ndarray
        (W,) what has moved there, in words; empty where nothing that moves is nearest.
    origin, velocity : ndarray
        (W, 2) where the point of it was that comes nearest, when it was observed, and how it went on from there, in m
        and m/s; NaN where nothing has moved.
    turn : ndarray
        (W, T) by how much each scan that errs as a whole is turned, in radians; T is 0 where none does.
    passed : ndarray
        (W, n) bool: bins whose rays pass thin obstacles; or (W, 0).
    """

    state: Indices
    observation: Floats
    action: Floats
    seconds: Floats
    pose: Floats
    clearance: Floats
    start: Floats
    believed: Floats
    mover: NDArray[np.str_]
    origin: Floats
    velocity: Floats
    turn: Floats
    passed: Booleans

    def __len__(self) -> int:
        """Return the number of counterexamples."""
        return len(self.state)

    def select(self, which: Indices) -> Witnesses:
        """Return some of the counterexamples."""
        return Witnesses(*(getattr(self, each.name)[which] for each in fields(self)))

    def violation(
        self, row: int, world_map: WorldMap, scenario: Scenario | None, footprint: Footprint
    ) -> dict[str, Any]:
        """Return one counterexample as plain data: what is observed, what follows, and what it comes near to."""
        closest = {
            "seconds": float(self.seconds[row]),
            "pose": self.pose[row].tolist(),
            "clearance": float(self.clearance[row]),
        }
        if not self.mover[row]:
            closest["obstacle"] = describe_nearest(world_map, scenario, self.pose[row], footprint)
        else:
            closest["obstacle"] = describe_mover(self.mover[row], self.origin[row], self.velocity[row])
            closest["moved"] = {
                "what": str(self.mover[row]),
                "from": self.origin[row].tolist(),
                "velocity": self.velocity[row].tolist(),
            }
        return {
            "observation": self.observation[row].tolist(),
            "action": self.action[row].tolist(),
            "closest": closest,
        }

    @classmethod
    def among_what_stands(cls, *found: Any) -> Witnesses:
        """Return counterexamples, of their first eight arrays, in which nothing has moved."""
        nothing = np.full((len(found[0]), 2), np.nan)
        state, observation, action, seconds, pose, clearance, start, believed = found
        nobody = np.full(len(state), "", dtype=np.str_)
        return cls(
            state,
            observation,
            action,
            seconds,
            pose,
            clearance,
            start,
            believed,
            nobody,
            nothing,
            nothing.copy(),
            np.zeros((len(state), 0)),
            np.zeros((len(state), 0), dtype=bool),
        )

    def among(self, moved: Nearest) -> Witnesses:
        """Return the same counterexamples with what has moved in them."""
        origin, velocity = (
            np.column_stack([part.real, part.imag]) for part in (moved.origin, moved.velocity)
        )
        return replace(self, mover=moved.labels, origin=origin, velocity=velocity)

    @classmethod
    @lru_cache(maxsize=64)
    def none(cls, size: int, axes: int) -> Witnesses:
        """Return no counterexample, of `size` numbers in an observation and `axes` in a command."""
        shapes = ((0, size), (0, axes), (0,), (0, 3), (0,), (0, 3), (0, 3))
        return cls.among_what_stands(np.zeros(0, dtype=np.int64), *map(np.zeros, shapes))

    @classmethod
    def join(cls, parts: list[Witnesses], size: int, axes: int) -> Witnesses:
        """Return all parts as one, ordered by state; sizes as for `none`."""
        if not parts:
            return cls.none(size, axes)
        every = [cls.none(size, axes), *parts]
        names = tuple(cls.__dataclass_fields__)
        joined = {name: _joined([getattr(part, name) for part in every]) for name in names}
        order = np.argsort(joined["state"], kind="stable")
        return cls(**{name: array[order] for name, array in joined.items()})


def _joined(parts: list[NDArray[Any]]) -> NDArray[Any]:
    """Return arrays one after the other; those without a row do not say how many columns there are."""
    return np.concatenate([part for part in parts if len(part)] or parts[:1])
