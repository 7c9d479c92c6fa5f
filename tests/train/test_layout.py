"""What the actor sees of an observation: the exported program sees the same, whatever the sensor gives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.train.test_run import TINY
from viatool import load_map, load_policy, reach
from viatool.errors import ConfigurationError
from viatool.policy import Activation
from viatool.policy.told_apart import ceilings
from viatool.train import make_configuration, train
from viatool.train.evaluation import actor_command
from viatool.train.export import export_actor, export_checkpoint
from viatool.train.networks import Weights
from viatool.train.observation import ActorLayout, UnitScaling, make_scaling, make_specification
from viatool.train.reachability import action_width

ROBOT = load_map("maps/lab.yaml").robot
NEAR = ActorLayout(1.5, previous=False)
SOFT = ActorLayout(1.5, previous=False, soft=True)


def drawn(layout: ActorLayout, scale: float = 2.0) -> tuple[Weights, UnitScaling]:
    scaling = make_scaling(ROBOT, 10.0, layout)
    return scaling.actor((12, 12), 2, "relu").draw(torch.Generator().manual_seed(0), scale), scaling


def observations(count: int = 200) -> np.ndarray:
    """Full physical observations, without the budget."""
    generator = np.random.default_rng(0)
    rows = generator.uniform([0.2] * 20 + [0.0, -1, -1, 0, -1], [7.0] * 20 + [9.0, 1, 1, 0.5, 1], (count, 25))
    return np.asarray(rows.astype(np.float32).astype(np.float64))


@pytest.mark.parametrize(
    ("layout", "size"),
    [
        (ActorLayout(1.5), 26),
        (ActorLayout(previous=False), 24),
        (NEAR, 24),
        (SOFT, 24),
        (ActorLayout(2.5, soft=True), 26),
    ],
)
def test_the_program_gives_what_the_actor_gives(layout: ActorLayout, size: int, tmp_path: Path) -> None:
    actor, scaling = drawn(layout)
    specification = make_specification(ROBOT, 0.3, {}, layout)
    policy = export_actor(actor.one(1), scaling, specification, tmp_path / "near.onnx")
    rows = observations()
    kept = rows if layout.previous else rows[:, :23]
    given = np.column_stack([kept, np.full(len(rows), np.float32(0.3))])
    assert given.shape[1] == size == policy.input_size
    sent = actor_command(actor.one(1), scaling, 0.3)(rows)
    np.testing.assert_allclose(policy.run(given), sent, atol=1e-5)
    names = [channel.name for channel in specification.observation]
    assert ("previous_angular" in names) == layout.previous
    assert specification.observation[0].lidar is not None
    assert specification.observation[0].lidar.maximum_range == ROBOT.lidar.maximum_range


@pytest.mark.parametrize("layout", [NEAR, SOFT])
def test_what_is_farther_than_the_range_makes_no_difference_and_what_is_nearer_does(
    layout: ActorLayout, tmp_path: Path
) -> None:
    actor, scaling = drawn(layout)
    policy = export_actor(
        actor.one(0), scaling, make_specification(ROBOT, 0.3, {}, layout), tmp_path / "a.onnx"
    )
    rows = np.column_stack([observations()[:, :23], np.full(200, 0.3)])
    nearer = np.column_stack([np.minimum(rows[:, :20], 1.5), rows[:, 20:]])
    assert (policy.run(rows) == policy.run(nearer)).all()
    nearer[:, :20] = np.minimum(nearer[:, :20], 1.4)
    assert (policy.run(rows) != policy.run(nearer)).any(axis=1).all()


def test_commands_before_make_no_difference_where_they_are_not_observed() -> None:
    for previous, same in ((True, False), (False, True)):
        actor, scaling = drawn(ActorLayout(previous=previous))
        rows = observations()
        other = rows.copy()
        other[:, 23:] = 0.0
        command = actor_command(actor.one(0), scaling, 0.0)
        assert np.array_equal(command(rows), command(other)) == same


def test_soft_readings_are_bent_and_everything_else_is_seen_as_it_is() -> None:
    actor, scaling = drawn(SOFT)
    assert actor.view is not None
    rows = observations()
    seen = actor.view(scaling.normalise(rows, np.zeros(200))).double().numpy()
    seen = seen / scaling.factor[scaling.seen] + scaling.offset[scaling.seen]
    bent = 0.75 * np.tanh(np.minimum(rows[:, :20], 1.5) / 0.75)
    np.testing.assert_allclose(seen[:, :20], bent, atol=1e-5)
    np.testing.assert_allclose(seen[:, 20:23], rows[:, 20:23], atol=1e-5)


def test_rays_are_followed_as_far_as_a_soft_actor_tells_them_apart(tmp_path: Path) -> None:
    actor, scaling = drawn(SOFT)
    policy = export_actor(
        actor.one(0), scaling, make_specification(ROBOT, 0.3, {}, SOFT), tmp_path / "a.onnx"
    )
    assert ceilings(policy.network).tolist() == [1.5] * 20 + [np.inf] * 4


def test_what_is_bounded_of_a_soft_actor_holds_and_is_narrower_near_the_range(tmp_path: Path) -> None:
    widths = {}
    for name, layout in (("clip", NEAR), ("soft", SOFT)):
        actor, scaling = drawn(layout)
        specification = make_specification(ROBOT, 0.3, {}, layout)
        policy = export_actor(actor.one(0), scaling, specification, tmp_path / f"{name}.onnx")
        rows = np.column_stack([observations(40)[:, :23], np.full(40, 0.3)])
        rows[:, :20] = np.random.default_rng(1).uniform(1.1, 1.4, (40, 20))
        eps = np.array([0.05] * 20 + [0.0] * 4)
        bounds = reach(policy, rows, eps=eps)
        for sign in np.random.default_rng(2).choice([-1.0, 1.0], (100, *rows.shape)):
            actions = policy.run(rows + sign * eps)
            assert ((bounds.lower <= actions) & (actions <= bounds.upper)).all()
        widths[name] = bounds.upper - bounds.lower
    assert widths["soft"].mean() < 0.5 * widths["clip"].mean()


@pytest.mark.parametrize("layout", [NEAR, SOFT])
def test_the_width_is_that_of_what_is_seen(layout: ActorLayout) -> None:
    actor, scaling = drawn(layout)
    rows = observations(60)
    rows[:20, :20] += 2.0  # beyond the range
    rows[20:40, :20] = 1.5  # at it
    inputs = scaling.normalise(rows, np.zeros(60)).expand(2, -1, -1)
    radius = scaling.radius(0.01)
    width = action_width(actor, inputs, radius)
    signs = torch.randint(0, 2, (300, 1, 60, 26), generator=torch.Generator().manual_seed(1)) * 2.0 - 1.0
    with torch.no_grad():
        actions = torch.stack([actor(inputs + radius * sign).tanh() for sign in signs])
    attained = actions.amax(0) - actions.amin(0)
    assert (attained <= width + 1e-5).all()
    assert (attained > 0.2 * width).float().mean() > 0.9
    goal = torch.where(torch.arange(26) >= 20, radius, 0.0)
    torch.testing.assert_close(width[:, :20], action_width(actor, inputs, goal)[:, :20])


@pytest.mark.parametrize(("method", "saturation"), [("via", "clip"), ("td7", "clip"), ("via", "soft")])
def test_a_run_exports_what_it_trained(method: str, saturation: str, tmp_path: Path) -> None:
    near = {"lidar_range": 1.5, "observe_previous": False, "jump_penalty": 0.1, "reachability_weight": 1.0}
    near["lidar_saturation"] = saturation
    result = train(make_configuration(method=method, **{**TINY, **near}), tmp_path / "run")  # type: ignore[arg-type]
    assert result.policy.input_size == 24
    assert load_policy(result.policy_path).spec == result.policy.spec
    again = export_checkpoint(
        tmp_path / "run" / "checkpoints" / "epoch_0003.pt", tmp_path / "again.onnx", seed=0
    )
    assert again.input_size == 24
    bent = [node for node in again.network.nodes if isinstance(node, Activation) and node.size == 20]
    assert [node.function.name for node in bent] == ["Clip", "Tanh"][: 1 + (saturation == "soft")]
    table = (tmp_path / "run" / "metrics.csv").read_text(encoding="utf-8")
    assert "action_jump" in table.splitlines()[0] or method == "td7"


@pytest.mark.parametrize("reach", [0.1, 7.0, 9.0])
def test_a_range_that_the_lidar_does_not_have_is_refused(reach: float, tmp_path: Path) -> None:
    options = make_configuration(**{**TINY, "lidar_range": reach})  # type: ignore[arg-type]
    with pytest.raises(ConfigurationError, match=r"lidar_range is .* 0.2 to 7 m"):
        train(options, tmp_path / "run")
    assert not (tmp_path / "run").exists()
