"""The width that the penalty uses: never less than what actions attain, about what the engine proves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

import viatool
from viatool.train.export import export_actor
from viatool.train.networks import HiddenActivation, Weights
from viatool.train.observation import make_scaling, make_specification
from viatool.train.reachability import action_width
from viatool.world import load_map

EPS = 0.01


@pytest.fixture(params=["relu", "tanh"])
def actor(request: pytest.FixtureRequest) -> Weights:
    activation: HiddenActivation = request.param
    return Weights((26, 26, 26, 2), 3, activation).draw(torch.Generator().manual_seed(1), 2.0)


def boxes() -> tuple[torch.Tensor, torch.Tensor, np.ndarray]:
    """Return normalised observations of 3 seeds, the radius, and the physical observations."""
    scaling = make_scaling(load_map("maps/lab.yaml").robot, 10.0)
    rows = np.random.default_rng(0).uniform(-1.0, 1.0, (40, 26)) / scaling.factor + scaling.offset
    rows[:, -1] = 0.0
    radius = EPS * scaling.factor
    radius[-1] = 0.0
    observation = scaling.normalise(rows[:, :-1], rows[:, -1])
    return observation.expand(3, -1, -1), torch.from_numpy(radius.astype(np.float32)), rows


def test_no_action_spreads_farther_than_the_bound(actor: Weights) -> None:
    observation, radius, _ = boxes()
    width = action_width(actor, observation, radius)
    rng = torch.Generator().manual_seed(2)
    corners = torch.randint(0, 2, (400, 1, 40, 26), generator=rng) * 2.0 - 1.0
    with torch.no_grad():
        actions = torch.stack([actor(observation + radius * corner).tanh() for corner in corners])
    attained = actions.amax(0) - actions.amin(0)
    assert (attained <= width + 1e-5).all()
    assert (attained > 0.2 * width).float().mean() > 0.9  # random corners come near


def test_the_bound_is_not_far_from_the_one_of_the_engine(actor: Weights, tmp_path: Path) -> None:
    observation, radius, rows = boxes()
    robot = load_map("maps/lab.yaml").robot
    scaling = make_scaling(robot, 10.0)
    policy = export_actor(actor.one(0), scaling, make_specification(robot, 0.0, {}), tmp_path / "actor.onnx")
    eps = np.full(26, EPS)
    eps[-1] = 0.0
    proved = viatool.reach(policy, rows, eps=eps, arithmetic="real")
    width = action_width(actor, observation, radius)[0].detach().numpy() * scaling.action_factor
    ratio = width / (proved.upper - proved.lower)
    assert ratio.min() > 1 - 1e-5
    assert ratio.mean() < 1.3


def test_the_width_shrinks_along_its_gradient(actor: Weights) -> None:
    observation, radius, _ = boxes()
    before = action_width(actor, observation, radius).mean()
    gradients = torch.autograd.grad(before, actor.layers)
    with torch.no_grad():
        for layer, gradient in zip(actor.layers, gradients, strict=True):
            layer -= 1e-2 * gradient / (gradient.norm() + 1e-9)
    assert action_width(actor, observation, radius).mean() < before


def test_without_error_there_is_no_width(actor: Weights) -> None:
    observation, radius, _ = boxes()
    assert action_width(actor, observation, torch.zeros_like(radius)).abs().max() == 0.0
