"""A kinematics that nobody sells goes through every room, by its class and one line of the registry."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.loop.plant import Plant
from tests.motion.toys import Crab, integrated, registered
from viatool import load_map, load_policy, verify
from viatool.errors import ConfigurationError
from viatool.loop.horizon import Horizon
from viatool.motion.kinematics import KINEMATICS, kinematics_of
from viatool.motion.law import Axis
from viatool.places import Resolution, SearchBudget, certify
from viatool.places.findings import CERTIFIED, SETTLED
from viatool.setting.rules import Rules
from viatool.simulate import NavigationSimulator, roll_out
from viatool.world import WorldMap

LAB, ROOM, POLICY = load_map("maps/lab.yaml"), load_map("maps/room.yaml"), load_policy("policies/via.onnx")
EPS = 0.01


def crab(world: WorldMap) -> WorldMap:
    return world.with_robot(replace(world.robot, kinematics="crab"))


class CrabPlant(Plant):
    """The robot by school formulas, which slides instead of turning."""

    def paths(self, states, commands):
        seconds = self.world.robot.control_interval
        speed = np.hypot(*commands.T)
        whole = seconds + 0.5 * speed / self.world.robot.deceleration
        ends = [
            integrated("crab", states[:, :3], commands, share * whole, 1) for share in np.linspace(0, 1, 12)
        ]
        return np.stack(ends, axis=1)


@pytest.fixture(autouse=True)
def known():
    with registered(Crab()):
        yield


def test_it_is_simulated():
    simulator = NavigationSimulator(crab(LAB), 40, scenarios=LAB.scenarios[:1] * 40, noise=0.0)
    simulator.reset()
    generator = np.random.default_rng(0)
    for _ in range(5):
        before, commands = simulator.poses.copy(), generator.uniform((0.0, -1.0), (0.5, 1.0), (40, 2))
        simulator.step(commands)
        expected = integrated("crab", before, commands, np.full(40, 0.1), 1)
        np.testing.assert_allclose(simulator.poses[:, :2], expected[:, :2], atol=1e-12)
        np.testing.assert_allclose(simulator.poses[:, 2], before[:, 2], atol=1e-12)


def test_states_are_verified_and_none_that_is_safe_comes_too_near():
    world = crab(LAB)
    driven = roll_out(POLICY, world, LAB.scenarios[:4], seed=0)
    result = verify(POLICY, world, eps=EPS, trajectory=driven, criterion="braking")
    other = verify(POLICY, LAB, eps=EPS, trajectory=driven, criterion="braking")
    assert (result.verdict != other.verdict).any()  # a robot that turns is another question
    generator, safe = np.random.default_rng(0), np.flatnonzero(result.verdict == "safe")
    assert len(safe) > 30
    for episode, scenario in enumerate(LAB.scenarios[:4]):
        rows = safe[driven.episode[safe] == episode]
        robot, seen = CrabPlant(POLICY, world, scenario, EPS), driven.observations[rows]
        for _ in range(20):
            error = np.sign(generator.uniform(-1.0, 1.0, seen.shape)) * robot.radii()
            ways = robot.paths(driven.poses[rows], robot.command(seen + error))
            assert (robot.away(ways) > world.clearance.collision - 1e-9).all()


def test_tubes_hold_its_runs():
    world, scenario = crab(LAB), LAB.scenarios[0]
    driven = roll_out(POLICY, world, [scenario], seed=0)
    few = driven.select(np.arange(8))
    result = verify(POLICY, world, eps=EPS, trajectory=few, horizon=Horizon(4))
    tubes, robot = result.horizon.tubes, CrabPlant(POLICY, world, scenario, EPS)
    followed = np.flatnonzero(np.isfinite(tubes.lower[:, 0, 0]))
    assert len(followed)
    generator = np.random.default_rng(1)
    for _ in range(40):
        commands = few.observations[followed][:, 23:25]
        poses = few.poses[followed]
        for k in range(4):
            commands = robot.noisy_command(np.hstack([poses, commands]), generator)
            poses = integrated("crab", poses, commands, np.full(len(poses), 0.1), 1)
            inside = (poses >= tubes.lower[followed, k] - 1e-7) & (poses <= tubes.upper[followed, k] + 1e-7)
            assert (inside | ~np.isfinite(tubes.lower[followed, k])).all()


def test_cells_are_certified_and_their_states_keep_their_clearance():
    world, scenario = crab(ROOM), ROOM.scenarios[0]
    found = certify(
        POLICY, world, scenario, eps=EPS, criterion="braking", resolution=Resolution(0.1, 0),
        budget=SearchBudget(share=0.02), seed=1,
    )  # fmt: skip
    robot, findings = CrabPlant(POLICY, world, scenario, EPS), found.findings
    some = np.flatnonzero((findings.status == CERTIFIED) | (findings.status == SETTLED))
    assert (findings.status == CERTIFIED).sum() > 5
    lower, upper = found.lattice.bounds(findings.nodes.select(some))
    margins = robot.margins(lower, upper, np.random.default_rng(2), 4000)
    assert len(margins) > 500
    assert margins.min() > -1e-9


def test_it_is_gone_when_it_is_taken_out():
    del KINEMATICS["crab"]
    with pytest.raises(ConfigurationError, match="kinematics 'crab' is not known") as refused:
        Rules.of(crab(LAB))
    assert "differential" in refused.value.hint
    KINEMATICS["crab"] = Crab()  # the fixture takes it out


def test_a_name_that_is_nearly_right_is_told():
    with pytest.raises(ConfigurationError, match="kinematics 'diferential' is not known") as refused:
        kinematics_of("diferential")
    assert refused.value.hint == "choose one of differential"


def test_a_map_says_how_its_robot_moves(tmp_path: Path):
    text = Path("maps/room.yaml").read_text(encoding="utf-8")
    assert load_map("maps/room.yaml").robot.kinematics == "differential"
    (tmp_path / "room.yaml").write_text(
        text.replace("\nrobot:\n", "\nrobot:\n  kinematics: crab\n"), encoding="utf-8"
    )
    assert Rules.of(load_map(tmp_path / "room.yaml")).kinematics.name == "crab"


def test_a_state_of_its_own_is_refused_as_long_as_no_proof_follows_it():
    class Sluggish(Crab):
        name = "sluggish"
        state = (Axis("speed", "m/s", "linear"),)

    with registered(Sluggish()), pytest.raises(ConfigurationError, match="state of its own \\(speed\\)"):
        Rules.of(LAB.with_robot(replace(LAB.robot, kinematics="sluggish")))


@pytest.mark.parametrize("conditions", [{"drift": 0.01}, {"acceleration": 1.0}])
def test_what_only_wheels_have_is_refused(conditions):
    from viatool.simulate.conditions import Conditions

    with pytest.raises(ConfigurationError, match="moves as 'crab'"):
        NavigationSimulator(crab(LAB), 1, conditions=Conditions(**conditions))
