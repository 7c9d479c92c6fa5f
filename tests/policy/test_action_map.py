"""Foreign policies: what the robot's software does with the raw output is part of the policy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.policy.models import save, two_layers
from tests.policy.rewritten import layer_norm
from viatool.channels import Frames
from viatool.errors import PolicyError
from viatool.policy import ActionChannel, ActionMap, ObservationChannel, PolicySpecification, load_policy
from viatool.taylor import reach


def specification(clip: bool) -> PolicySpecification:
    return PolicySpecification(
        observation=[ObservationChannel(name="state", size=4)],
        action=[
            ActionChannel(name="v", unit="m/s", lower=0.0, upper=0.3, kind="linear"),
            ActionChannel(name="omega", unit="rad/s", lower=-0.9, upper=0.8, kind="angular"),
        ],
        action_map=ActionMap(scale=[0.25, 1.0], offset=[0.25, -0.125], clip=clip),
    )


OBSERVATIONS = np.random.default_rng(0).normal(size=(500, 4)).astype(np.float32).astype(np.float64)


@pytest.mark.parametrize("clip", [False, True])
def test_the_map_follows_the_network_and_the_program(clip: bool, tmp_path: Path) -> None:
    path = save(two_layers(), tmp_path)
    raw = load_policy(path)
    policy = load_policy(path, specification(clip))

    expected = raw.run(OBSERVATIONS) * [0.25, 1.0] + [0.25, -0.125]
    if clip:
        expected = np.clip(expected, [0.0, -0.9], [0.3, 0.8])
        assert (expected == [0.3, 0.8]).any(axis=0).all()
    np.testing.assert_array_equal(policy.run(OBSERVATIONS), expected)
    np.testing.assert_allclose(policy(OBSERVATIONS), expected, atol=1e-6)


@pytest.mark.parametrize("clip", [False, True])
def test_bounds_hold_for_the_mapped_actions(clip: bool, tmp_path: Path) -> None:
    policy = load_policy(save(two_layers(), tmp_path), specification(clip))
    centres = OBSERVATIONS[:20]
    sets = reach(policy, centres, 0.02)
    generator = np.random.default_rng(1)
    for _ in range(100):
        actions = policy.run((centres + generator.uniform(-0.0199, 0.0199, centres.shape)).astype(np.float32))
        assert (sets.lower <= actions).all()
        assert (actions <= sets.upper).all()
    if clip:
        assert (sets.lower >= np.array([0.0, -0.9]) - 1e-4).all()
        assert (sets.upper <= np.array([0.3, 0.8]) + 1e-4).all()


def test_what_runs_in_place_of_the_file_is_mapped_as_well(tmp_path: Path) -> None:
    path = save(layer_norm(4.0), tmp_path)
    channels = [ActionChannel(name=f"a{k}", unit="m/s", lower=-9.0, upper=9.0) for k in range(4)]
    mapped = ActionMap(scale=[0.25] * 4, offset=[0.5] * 4, clip=False)
    spec = specification(False).model_copy(update={"action": channels, "action_map": mapped})
    (raw,), policy = load_policy(path).rewritten, load_policy(path, spec)
    (network,) = policy.rewritten
    np.testing.assert_allclose(network(OBSERVATIONS), 0.25 * raw(OBSERVATIONS) + 0.5, rtol=1e-12)
    np.testing.assert_allclose(network(OBSERVATIONS), policy.run(OBSERVATIONS), rtol=1e-4, atol=1e-5)
    assert policy.network.label(1) == load_policy(path).network.label(1) != "node 1 of the network"


def test_a_sidecar_file_replaces_what_the_model_says(tmp_path: Path) -> None:
    sidecar = tmp_path / "robot.yaml"
    sidecar.write_text(specification(clip=True).to_yaml())
    policy = load_policy(save(two_layers(), tmp_path), sidecar)
    assert policy.spec == specification(clip=True)


def test_a_sidecar_of_another_policy_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="5 observations, its specification describes 4"):
        load_policy(save(two_layers(size=5), tmp_path), specification(clip=False))
    with pytest.raises(PolicyError, match="3 actions, its specification describes 2"):
        load_policy(save(two_layers(actions=3), tmp_path), specification(clip=False))


def test_sizes_that_do_not_add_up_are_said_channel_by_channel(tmp_path: Path) -> None:
    channels = [
        ObservationChannel(name="lidar", size=20, frames=Frames(count=3)),
        ObservationChannel(name="goal_distance", kind="goal_distance"),
    ]
    actions = specification(False).action
    spec = PolicySpecification(schema_version=2, observation=channels, action=actions)
    path = save(two_layers(size=64), tmp_path)
    with pytest.raises(
        PolicyError, match="lidar 20 x 3 frames = 60, goal_distance 1 = 61, but the model takes 64"
    ):
        load_policy(path, spec)
    whole = [ObservationChannel(name="lidar", size=20), channels[1]]
    spec = PolicySpecification(
        schema_version=2, observation=whole, action=actions, frames=Frames(count=3, stride=2)
    )
    with pytest.raises(PolicyError, match=r"\(lidar 20, goal_distance 1\) x 3 frames = 63, but the model"):
        load_policy(path, spec)


def test_a_sidecar_can_name_the_output(tmp_path: Path) -> None:
    model = two_layers()
    model.graph.output.add().name = "o"
    path = save(model, tmp_path)
    with pytest.raises(PolicyError, match="2 outputs"):
        load_policy(path)
    spec = specification(clip=False).model_copy(update={"output": "o"})
    assert load_policy(path, spec).output_size == 2
