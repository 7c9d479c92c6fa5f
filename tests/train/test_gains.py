"""The limit of how strongly actions answer: the exported program keeps it, and what is bounded is never exceeded."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import torch

from tests.train.test_penalties import learner
from tests.train.test_run import tiny
from viatool import load_map
from viatool.policy import Activation, Affine, Policy
from viatool.policy.weights import dense
from viatool.train import train
from viatool.train.gains import action_gain, limit_gain
from viatool.train.networks import HiddenActivation, Weights
from viatool.train.observation import ActorLayout, UnitScaling, make_scaling

ROBOT = load_map("maps/lab.yaml").robot
LAYOUTS = {"all": ActorLayout(), "near": ActorLayout(1.5, previous=False)}


def drawn(layout: str, activation: HiddenActivation = "relu") -> tuple[Weights, UnitScaling]:
    scaling = make_scaling(ROBOT, 10.0, LAYOUTS[layout])
    actor = scaling.actor((12, 12), 3, activation)
    return actor.draw(torch.Generator().manual_seed(0), 2.0), scaling


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("activation", get_args(HiddenActivation))
def test_no_error_moves_an_action_by_more_than_the_gain_says(
    layout: str, activation: HiddenActivation
) -> None:
    actor, scaling = drawn(layout, activation)
    error, generator = scaling.radius(1.0), torch.Generator().manual_seed(1)
    gain = action_gain(actor, error)
    states = (0.3 * torch.randn(1, 400, 26, generator=generator)).expand(3, -1, -1).requires_grad_()
    for action in (0, 1):
        here = actor(states)[..., action]
        (steepest,) = torch.autograd.grad(here.sum(), states)
        for size in (1e-2, 0.3):
            with torch.no_grad():
                change = (actor(states + size * error * steepest.sign())[..., action] - here).abs().amax(1)
            assert (change <= size * gain[:, action] + 1e-5).all()
            assert (change > 0.005 * size * gain[:, action]).all()


def test_the_gain_of_one_layer_is_the_sum_of_its_weights() -> None:
    actor = Weights((3, 2), 1)
    with torch.no_grad():
        actor.layers[0].copy_(torch.tensor([[[1.0, 0.5], [-2.0, 0.0], [7.0, 7.0]]]))
    error = torch.tensor([1.0, 0.5, 0.0])
    assert action_gain(actor, error).tolist() == [[2.0, 0.5]]


def test_only_actions_beyond_the_limit_are_held_back() -> None:
    actor, scaling = drawn("all")
    error = scaling.radius(1.0)
    before, gain = actor.copy(), action_gain(actor, error)
    limit = 1.01 * float(gain.median())
    limit_gain(actor, error, limit)
    assert (action_gain(actor, error) <= limit).all()
    within = (gain <= limit).unsqueeze(1).expand_as(actor.layers[-2])
    assert within.any()
    assert not within.all()
    assert torch.equal((actor.layers[-2] == before.layers[-2]), within)
    for own, other in zip(
        actor.layers[:-2] + actor.layers[-1:], [*before.layers[:-2], before.layers[-1]], strict=True
    ):
        assert torch.equal(own, other)


def exported_gain(policy: Policy) -> float:
    """Bound the program's answer to an error of 1 in every channel but the budget, in actions of [-1, 1]."""
    last = max(index for index, node in enumerate(policy.network.nodes) if isinstance(node, Activation))
    moved: list[np.ndarray] = []
    for node in policy.network.nodes[: last + 1]:
        match node:
            case Affine():
                parts = [
                    np.abs(dense(w)) @ moved[source]
                    for source, w in zip(node.sources, node.weights, strict=True)
                ]
                moved.append(np.sum(parts, axis=0))
            case Activation():
                assert node.function.name in ("Relu", "Tanh", "Clip")
                moved.append(moved[node.source])
            case _:
                moved.append(np.append(np.ones(node.size - 1), 0.0))
    assert len(moved[last]) == 2
    return float(moved[last].max())


@pytest.mark.parametrize("method", ["via", "td7"])
def test_the_exported_program_keeps_the_limit(method: str, tmp_path: Path) -> None:
    near = {"method": method, "lidar_range": 1.5, "observe_previous": False, "tensorboard": False}
    free = train(tiny(**near), tmp_path / "free")
    assert exported_gain(free.policy) > 0.6
    held = train(tiny(**near, gain_limit=0.3), tmp_path / "held")
    assert 0.2 < exported_gain(held.policy) <= 0.3
    with (held.run_directory / "metrics.csv").open(newline="") as stream:
        gains = [float(row["action_gain"]) for row in csv.DictReader(stream) if row.get("action_gain")]
    assert all(gain <= 0.3 for gain in gains)


def test_the_mean_of_limited_networks_is_brought_back_as_well() -> None:
    """The target, which is exported, is such a mean: of two networks within the limit it is far beyond."""
    taught = learner(gain_limit=1.0)
    actor, error = taught.agent.actor, taught.unit_error
    for weights, ends in ((actor.weights, (4.0, 0.25)), (actor.target, (0.25, 4.0))):
        weights.draw(torch.Generator().manual_seed(5), 1.0)
        limit_gain(weights, error, 1.0)
        with torch.no_grad():
            weights.layers[0].mul_(ends[0])
            weights.layers[-2].mul_(ends[1])
        assert (action_gain(weights, error) <= 1.0).all()
    actor.follow(0.5)
    assert (action_gain(actor.target, error) > 2.0).any()
    found = taught.keep_limits()["action_gain"]
    assert (found == action_gain(actor.target, error).amax(1)).all()
    for weights in (actor.weights, actor.target):
        assert (action_gain(weights, error) <= 1.0).all()
