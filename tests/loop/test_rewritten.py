"""The closed loop over sets holds for what the runtime runs in the file's place, too."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from viatool import load_map, load_policy
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.successor import states_of, step
from viatool.policy import Affine, Network, Policy
from viatool.sets.forms import PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.setting.setting import Setting

ROOM, POLICY = load_map(Path("maps/room.yaml")), load_policy(Path("policies/via.onnx"))
SCENARIO = ROOM.scenarios[0]


def other_program() -> Network:
    """The policy with all of its last affine map's constants moved."""
    *nodes, last = POLICY.network.nodes
    assert isinstance(last, Affine)
    return Network((*nodes, replace(last, bias=last.bias + 0.03, merged_bias=None)))


OTHER = other_program()
REWRITTEN = replace(POLICY, rewritten=(OTHER,))


def closed_loop(policy: Policy) -> ClosedLoop:
    """Ask of a policy; of the other program alone, which no runtime here runs, in exact arithmetic."""
    arithmetic = "real" if policy.network is OTHER else "float32"
    return ClosedLoop.of(policy, Setting.of(policy, ROOM, 0.01), SCENARIO, arithmetic)


def cells() -> StateBoxes:
    generator = np.random.default_rng(0)
    centre = generator.uniform((-1.4, -1.4, -3.0), (1.4, 1.4, 3.0), (60, 3))
    previous = generator.uniform((0.0, -0.5), (0.4, 0.5), (60, 2))
    return StateBoxes(PoseBoxes(centre, np.full((60, 3), 0.005)), previous, previous + 0.01)


def commands_beyond(policy: Policy) -> float:
    """By how much bounds of the other program's commands leave the policy's."""
    found, other = (closed_loop(one).commands(cells()) for one in (policy, replace(POLICY, network=OTHER)))
    return float(np.maximum(other.upper - found.upper, found.lower - other.lower).max())


def successors_beyond(policy: Policy) -> float:
    """By how much forms of the other program's commands leave the policy's where no symbol moves either."""
    found, other = (
        step(closed_loop(one), states_of(cells())).states for one in (policy, replace(POLICY, network=OTHER))
    )
    apart = np.abs(other.centre - found.centre)[:, 3:]
    spread = np.abs(found.slope).sum(axis=1)[:, 3:] + found.rest[:, 3:]
    return float((apart - spread).max())


def test_commands_hold_for_every_program() -> None:
    assert commands_beyond(REWRITTEN) <= 0.0
    assert commands_beyond(POLICY) > 0.02


def test_successors_hold_for_every_program() -> None:
    assert successors_beyond(REWRITTEN) <= 0.0
    found, alone = (step(closed_loop(one), states_of(cells())) for one in (REWRITTEN, POLICY))
    assert (found.lower <= alone.lower).all()
    assert (found.upper >= alone.upper).all()
    assert float((found.upper - alone.upper).max()) > 0.02
