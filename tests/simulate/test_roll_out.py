from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from viatool.errors import ConfigurationError, PolicyError
from viatool.motion.kinematics import DIFFERENTIAL
from viatool.policy.specification import ActionChannel, ObservationChannel, PolicySpecification
from viatool.simulate import navigation_channels, roll_out
from viatool.trajectory import Trajectory
from viatool.world import Scenario, Scenes, WorldMap, load_map

ACTIONS = [
    ActionChannel(name="omega", lower=-1.0, upper=1.0, kind="angular"),
    ActionChannel(name="v", lower=0.0, upper=0.5, kind="linear"),
]


@dataclass
class GoalSeeker:
    """Turns to the goal and drives: action columns (omega, v), an observation with the budget first."""

    spec: PolicySpecification | None
    runs: int = 0

    def run(self, observations: NDArray[np.float64]) -> NDArray[np.float64]:
        self.runs += 1
        return np.column_stack([2.0 * observations[:, 23], np.full(len(observations), 0.45)])


@pytest.fixture(scope="module")
def lab() -> WorldMap:
    return load_map("maps/lab.yaml")


@pytest.fixture
def seeker(lab: WorldMap) -> GoalSeeker:
    channels = [ObservationChannel(name="u", kind="budget", value=0.3), *navigation_channels(lab.robot.lidar)]
    return GoalSeeker(PolicySpecification(observation=channels, action=ACTIONS))


@pytest.fixture
def trajectory(seeker: GoalSeeker, lab: WorldMap) -> Trajectory:
    return roll_out(seeker, lab, seed=3)


def test_every_scenario_is_one_episode(trajectory: Trajectory, lab: WorldMap, seeker: GoalSeeker) -> None:
    assert trajectory.scenarios == lab.scenarios
    assert trajectory.observations.shape == (len(trajectory), 26)
    assert set(trajectory.outcomes) == {"success", "collision"}
    assert np.unique(trajectory.episode).tolist() == list(range(10))
    assert (np.diff(trajectory.episode) >= 0).all()
    assert seeker.runs == np.bincount(trajectory.episode).max()  # all scenarios in parallel


def test_states_follow_from_each_other(trajectory: Trajectory, lab: WorldMap) -> None:
    for episode, scenario in enumerate(lab.scenarios):
        mine = trajectory.episode == episode
        poses, actions = trajectory.poses[mine], trajectory.actions[mine]
        assert tuple(poses[0]) == scenario.start
        assert trajectory.time[mine] == pytest.approx(0.1 * np.arange(mine.sum()))
        moved = DIFFERENTIAL.advance(poses, DIFFERENTIAL.clip(actions[:, ::-1], lab.robot), 0.1)
        assert moved[:-1] == pytest.approx(poses[1:])
        end = moved[-1:, :2]
        clearance = Scenes.of(lab, [scenario]).clearance(end, np.zeros(1, int))[0]
        if trajectory.outcomes[episode] == "success":
            assert np.linalg.norm(end[0] - scenario.goal) < 0.5
        else:
            assert clearance < 0.4


def test_observations_and_costs_are_those_of_the_states(trajectory: Trajectory, lab: WorldMap) -> None:
    scenes = Scenes.of(lab, lab.scenarios)
    goals = np.array([scenario.goal for scenario in lab.scenarios])[trajectory.episode]
    distance = np.linalg.norm(goals - trajectory.poses[:, :2], axis=1)
    assert trajectory.observations[:, 21] == pytest.approx(distance, abs=1e-6)
    assert (trajectory.observations[:, 0] == np.float32(0.3)).all()
    ranges = scenes.cast(trajectory.poses, trajectory.episode, lab.robot.lidar).reshape(-1, 20, 9).min(axis=2)
    assert np.abs(trajectory.observations[:, 1:21] - ranges).max() < 0.06  # six standard deviations
    clearance = scenes.clearance(trajectory.poses[:, :2], trajectory.episode)
    inside = np.bincount(trajectory.episode, (clearance < 0.5) & (trajectory.time > 0), minlength=10)
    last = np.isin(trajectory.outcomes, ["collision"])  # the step that ends an episode is paid for as well
    assert trajectory.costs == pytest.approx(inside + last)


def test_the_same_seed_gives_the_same_trajectory(
    seeker: GoalSeeker, lab: WorldMap, trajectory: Trajectory
) -> None:
    again, other = roll_out(seeker, lab, seed=3), roll_out(seeker, lab, seed=4)
    assert (again.observations == trajectory.observations).all()
    assert (again.poses == trajectory.poses).all()
    assert (other.observations[:10] != trajectory.observations[:10]).any()


def test_a_robot_that_never_arrives_times_out(seeker: GoalSeeker, lab: WorldMap) -> None:
    lost = Scenario("lost", (0.0, 0.0, 0.0), (0.0, 0.0))
    far = replace(lost, goal=(4.5, 0.0))
    result = roll_out(seeker, lab, [far, lost], horizon=7, noise=0.0)
    assert result.outcomes.tolist() == ["timeout", "success"]
    assert np.bincount(result.episode).tolist() == [7, 1]
    assert result.costs.tolist() == [0.0, 0.0]


def test_what_does_not_fit_is_refused(seeker: GoalSeeker, lab: WorldMap) -> None:
    assert seeker.spec is not None
    with pytest.raises(PolicyError, match="has no specification"):
        roll_out(GoalSeeker(None), lab)
    with pytest.raises(ConfigurationError, match="gives no scenario"):
        roll_out(seeker, replace(lab, scenarios=()))
    slow = seeker.spec.model_copy(update={"control_interval": 0.2})
    with pytest.raises(ConfigurationError, match=r"acts every 0.2 s.*every 0.1 s"):
        roll_out(GoalSeeker(slow), lab)
    headless = seeker.spec.model_copy(update={"action": ACTIONS[:1]})
    with pytest.raises(PolicyError, match="no action of the policy is of kind 'linear'"):
        roll_out(GoalSeeker(headless), lab)
