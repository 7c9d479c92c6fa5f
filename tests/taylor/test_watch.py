"""Wherever actions are bounded the program is run: a fault that the self-check does not meet is found in the box."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.policy.models import model_of, node, save, two_layers
from viatool.errors import SelfCheckError
from viatool.policy import Policy, load_policy
from viatool.policy.runtime import Runtime
from viatool.taylor import reach
from viatool.taylor.watch import require_program_within

FAR = 50.0


@pytest.fixture
def policy(tmp_path: Path) -> Policy:
    return load_policy(save(two_layers(), tmp_path))


class Faulty(Runtime):
    """Adds to the actions beyond a threshold of the first entry of the observation."""

    def __init__(self, sound: Runtime, added: float, beyond: float = FAR) -> None:
        self.__dict__.update(sound.__dict__)
        self._added, self._beyond = added, beyond

    def __call__(self, observations):
        return super().__call__(observations) + self._added * (observations[:, :1] > self._beyond)


@pytest.mark.parametrize("added", [0.1, -0.1, np.nan])
@pytest.mark.parametrize("batches", [True, False])
def test_a_fault_where_the_box_is_ends_the_run(policy: Policy, added: float, batches: bool) -> None:
    wrong = replace(policy, runtime=Faulty(policy.runtime, added))
    wrong.runtime.batches = batches
    near = np.random.default_rng(0).uniform(-1, 1, (300, 4))
    far = near + np.array([FAR + 10.0, 0.0, 0.0, 0.0])
    reach(policy, far, 0.01)
    with pytest.raises(SelfCheckError, match=r"disagree: the program's action \d is .* bounds are"):
        reach(wrong, far, 0.01)
    if np.isfinite(added):
        assert (reach(wrong, near, 0.01).lower == reach(policy, near, 0.01).lower).all()


def test_a_fault_at_the_corners_alone_is_found(policy: Policy) -> None:
    centre = np.array([[FAR, 0.0, 0.0, 0.0]])
    wrong = replace(policy, runtime=Faulty(policy.runtime, 10.0, beyond=FAR + 0.9))
    with pytest.raises(SelfCheckError, match="disagree"):
        reach(wrong, centre, 1.0)


def test_bounds_of_the_network_alone_do_not_run_the_program(policy: Policy) -> None:
    wrong = replace(policy, runtime=Faulty(policy.runtime, 1.0, beyond=-FAR))
    reach(wrong, np.zeros((1, 4)), 0.1, arithmetic="real")


def test_a_program_that_keeps_to_its_bounds_passes(policy: Policy) -> None:
    points = np.zeros((3, 2, 4))
    actions = policy.run(points[0])
    require_program_within(policy, points, actions, actions)
    with pytest.raises(SelfCheckError):
        require_program_within(policy, points, np.nextafter(actions, np.inf), actions + 1.0)


def test_observations_that_a_batch_mixes_where_a_gate_is_open_are_run_one_by_one(tmp_path: Path) -> None:
    """The first observation's numbers times a gate of each: closed wherever the self-check compares actions."""
    nodes = [
        node("Gather", ["x", "second"], ["s"], axis=1),
        node("Sub", ["s", "far"], ["above"]),
        node("Clip", ["above", "zero", "one"], ["gate"]),
        node("GatherND", ["x", "first"], ["f"]),
        node("Mul", ["gate", "f"], ["y"]),
    ]
    constants = {
        "second": np.array([1]),
        "far": np.float32(FAR),
        "zero": np.float32(0.0),
        "one": np.float32(1.0),
        "first": np.array([[[0, 0]]]),
    }
    policy = load_policy(save(model_of(nodes, constants, shape=(1, 2)), tmp_path))
    policy.runtime.batches = True  # had the self-check not found it
    observations = np.array([[1.0, FAR + 10.0], [2.0, FAR + 10.0]])
    sets = reach(policy, observations, 0.01)
    np.testing.assert_allclose((sets.lower + sets.upper).ravel() / 2, [1.0, 2.0], rtol=1e-5)
    np.testing.assert_allclose(policy.run(observations).ravel(), [1.0, 2.0], rtol=1e-5)
