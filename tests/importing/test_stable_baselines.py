"""The written ONNX is the model: the six algorithms, with VecNormalize, against predict(deterministic=True)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

import torch  # only where it is installed

from tests.importing.saved import HIGH, LOW, SIZE, Wander, observations, rewritten, saved
from viatool.errors import PolicyError
from viatool.importing import ImportRequest, import_policy
from viatool.policy import PolicySpecification, load_policy

CASES = [
    ("TD3", {}, {}),
    ("DDPG", {"activation_fn": torch.nn.ELU}, {}),
    ("SAC", {}, {}),
    ("SAC", {"clip_mean": 3.0}, {"use_sde": True}),
    ("PPO", {}, {}),
    ("PPO", {"squash_output": True}, {"use_sde": True}),
    ("PPO", {"net_arch": {"pi": [], "vf": [8]}}, {}),
    ("A2C", {"activation_fn": torch.nn.LeakyReLU}, {}),
]


@pytest.mark.parametrize("normalise", [False, True], ids=["raw", "VecNormalize"])
@pytest.mark.parametrize(("algorithm", "settings", "more"), CASES)
def test_the_file_gives_the_action_of_predict(
    algorithm: str, settings: dict[str, Any], more: dict[str, Any], normalise: bool, tmp_path: Path
) -> None:
    model, normaliser = saved(tmp_path, algorithm, settings=settings, normalise=normalise, **more)
    request = ImportRequest(tmp_path / "model.zip", tmp_path / "vec_normalize.pkl" if normalise else None)
    imported = import_policy(request, tmp_path / "policy.onnx")

    raw = observations()
    seen = raw if normaliser is None else normaliser.normalize_obs(raw)
    expected, _ = model.predict(seen, deterministic=True)
    np.testing.assert_allclose(imported.policy.run(raw), expected, atol=2e-5)
    np.testing.assert_allclose(imported.policy(raw), expected, atol=2e-5)
    assert (expected.std(axis=0) > 1e-3).all()
    if normaliser is not None:  # the clip of the normaliser is reached
        assert (np.abs(seen) == 1.5).any()
    assert load_policy(tmp_path / "policy.onnx").spec is None


@pytest.mark.parametrize(("algorithm", "normalise"), [("DQN", True), ("PPO", False), ("A2C", True)])
def test_the_largest_score_is_the_choice_of_predict(algorithm: str, normalise: bool, tmp_path: Path) -> None:
    model, normaliser = saved(tmp_path, algorithm, choices=5, normalise=normalise)
    request = ImportRequest(tmp_path / "model.zip", tmp_path / "vec_normalize.pkl" if normalise else None)
    imported = import_policy(request, tmp_path / "policy.onnx")

    raw = observations()
    seen = raw if normaliser is None else normaliser.normalize_obs(raw)
    chosen, _ = model.predict(seen, deterministic=True)
    assert imported.policy.output_size == 5
    np.testing.assert_array_equal(imported.policy.run(raw).argmax(axis=1), chosen)
    assert len(set(chosen.tolist())) > 1
    assert imported.proposal is not None
    assert not imported.proposal.is_complete
    assert imported.proposal.action[0]["kind"] == "choice"
    assert "fill in all 5" in imported.proposal.to_yaml()


def test_what_was_put_inside_is_said(tmp_path: Path) -> None:
    saved(tmp_path, "TD3", normalise=True)
    with_both = import_policy(
        ImportRequest(tmp_path / "model.zip", tmp_path / "vec_normalize.pkl"), tmp_path / "policy.onnx"
    )
    words = " ".join(with_both.inside)
    assert "vec_normalize.pkl, clipped to 1.5 deviations" in words
    assert "scaled to [0, 0.5], [-1, 1]" in words
    alone = import_policy(ImportRequest(tmp_path / "model.zip"), tmp_path / "alone.onnx")
    assert "vec_normalize.pkl is beside it, add --vecnormalize" in " ".join(alone.inside)


def test_the_proposal_has_the_limits_and_ranges_of_the_spaces(tmp_path: Path) -> None:
    saved(tmp_path, "TD3", size=24)
    imported = import_policy(ImportRequest(tmp_path / "model.zip"), tmp_path / "policy.onnx")
    proposal = imported.proposal
    assert proposal is not None
    spec = PolicySpecification.model_validate(proposal.document)
    assert (spec.observation_size, spec.action_size, spec.schema_version) == (24, 2, 2)
    assert [(c.kind, c.lower, c.upper, c.scale) for c in spec.action] == [
        ("linear", 0.0, 0.5, 1.0),
        ("angular", -1.0, 1.0, 1.0),
    ]
    assert spec.observation[0].lidar is not None
    assert spec.observation[0].lidar.maximum_range == 20.0
    assert "the LiDAR reaches 20 m, as the observation's limits say" in proposal.to_yaml()


def test_a_specification_that_is_given_goes_inside(tmp_path: Path) -> None:
    saved(tmp_path, "TD3", size=24)
    first = import_policy(ImportRequest(tmp_path / "model.zip"), tmp_path / "policy.onnx")
    assert first.proposal is not None
    (tmp_path / "robot.yaml").write_text(first.proposal.to_yaml(), encoding="utf-8")
    request = ImportRequest(tmp_path / "model.zip", specification=tmp_path / "robot.yaml")
    assert import_policy(request, tmp_path / "second.onnx").proposal is None
    spec = load_policy(tmp_path / "second.onnx").spec
    assert spec is not None
    assert spec.observation[0].kind == "lidar"

    saved(tmp_path, "TD3")
    with pytest.raises(PolicyError, match="the model takes 6"):
        import_policy(request, tmp_path / "third.onnx")
    assert not (tmp_path / "third.onnx").exists()


def test_an_activation_that_cannot_be_read_is_asked_for(tmp_path: Path) -> None:
    saved(tmp_path, "TD3", settings={"activation_fn": Bend})
    with pytest.raises(PolicyError, match=r"activation_fn is '.*Bend', where a class of torch.nn") as refusal:
        import_policy(ImportRequest(tmp_path / "model.zip"), tmp_path / "policy.onnx")
    assert "--activation" in refusal.value.hint
    request = ImportRequest(tmp_path / "model.zip", activation="Tanh")
    assert import_policy(request, tmp_path / "policy.onnx").policy.output_size == 2
    with pytest.raises(PolicyError, match="'Sine'"):
        import_policy(ImportRequest(tmp_path / "model.zip", activation="Sine"), tmp_path / "policy.onnx")


class Bend(torch.nn.Tanh):
    """A class of one's own."""


def test_classes_of_ones_own_need_trust(tmp_path: Path) -> None:
    settings = {"features_extractor_class": Doubled, "features_extractor_kwargs": {"features_dim": SIZE}}
    model, _ = saved(tmp_path, "TD3", settings=settings)
    with pytest.raises(PolicyError, match=r"features_extractor_class is '.*Doubled'") as refusal:
        import_policy(ImportRequest(tmp_path / "model.zip"), tmp_path / "policy.onnx")
    assert "--trust" in refusal.value.hint
    assert not (tmp_path / "policy.onnx").exists()

    trusted = import_policy(ImportRequest(tmp_path / "model.zip", trust=True), tmp_path / "policy.onnx")
    expected, _ = model.predict(observations(), deterministic=True)
    np.testing.assert_allclose(trusted.policy.run(observations()), expected, atol=2e-5)


@pytest.mark.parametrize(("algorithm", "choices"), [("DQN", 4), ("PPO", 4), ("SAC", 0)])
def test_a_trusted_model_is_the_same(algorithm: str, choices: int, tmp_path: Path) -> None:
    saved(tmp_path, algorithm, choices=choices)
    read = import_policy(ImportRequest(tmp_path / "model.zip"), tmp_path / "read.onnx").policy
    run = import_policy(ImportRequest(tmp_path / "model.zip", trust=True), tmp_path / "run.onnx").policy
    raw = observations()
    np.testing.assert_allclose(read.run(raw), run.run(raw), atol=2e-5)


class Doubled(__import__("stable_baselines3").common.torch_layers.BaseFeaturesExtractor):  # type: ignore[misc]
    """Features of one's own."""

    def forward(self, observed: torch.Tensor) -> torch.Tensor:
        return 2.0 * observed


def test_what_contradicts_the_spaces_is_refused_with_both_sizes(tmp_path: Path) -> None:
    saved(tmp_path, "TD3", size=7)
    import zipfile

    with zipfile.ZipFile(tmp_path / "model.zip") as archive:
        other = archive.read("policy.pth")
    saved(tmp_path, "TD3")
    path = rewritten(tmp_path / "model.zip", member_policy_pth=other)
    with pytest.raises(PolicyError, match=r"observation_space has 6 numbers, but the layers .* have 7"):
        import_policy(ImportRequest(path), tmp_path / "policy.onnx")


def test_another_normaliser_is_refused_with_both_sizes(tmp_path: Path) -> None:
    saved(tmp_path, "TD3", size=7, normalise=True)
    saved(tmp_path, "TD3")
    request = ImportRequest(tmp_path / "model.zip", tmp_path / "vec_normalize.pkl")
    with pytest.raises(PolicyError, match=r"obs_rms.mean has 7 numbers, but the model observes 6"):
        import_policy(request, tmp_path / "policy.onnx")


def test_a_normaliser_that_is_switched_off_is_none(tmp_path: Path) -> None:
    _, normaliser = saved(tmp_path, "TD3", normalise=True)
    normaliser.norm_obs = False
    normaliser.save(str(tmp_path / "vec_normalize.pkl"))
    request = ImportRequest(tmp_path / "model.zip", tmp_path / "vec_normalize.pkl")
    assert "norm_obs off" in " ".join(import_policy(request, tmp_path / "policy.onnx").inside)


def test_layers_that_are_not_known_are_named(tmp_path: Path) -> None:
    model, _ = saved(tmp_path, "TD3")
    import io

    weights = {**model.policy.state_dict(), "actor.extra.weight": torch.zeros(3, 3)}
    stream = io.BytesIO()
    torch.save(weights, stream)
    path = rewritten(tmp_path / "model.zip", member_policy_pth=stream.getvalue())
    with pytest.raises(PolicyError, match=r"policy.pth: 'actor.extra.weight' of shape \[3, 3\]"):
        import_policy(ImportRequest(path), tmp_path / "policy.onnx")


def test_a_zip_that_is_no_model_says_what_is_there(tmp_path: Path) -> None:
    import zipfile

    with zipfile.ZipFile(tmp_path / "other.zip", "w") as archive:
        archive.writestr("readme.txt", "hello")
    with pytest.raises(PolicyError, match=r"a zip of readme.txt, where `data` and `policy.pth`"):
        import_policy(ImportRequest(tmp_path / "other.zip"), tmp_path / "policy.onnx")
    (tmp_path / "text.zip").write_text("no zip")
    with pytest.raises(PolicyError, match="is no zip, where"):
        import_policy(ImportRequest(tmp_path / "text.zip"), tmp_path / "policy.onnx")
    with pytest.raises(PolicyError, match="cannot read the model"):
        import_policy(ImportRequest(tmp_path / "missing.zip"), tmp_path / "policy.onnx")
    saved(tmp_path, "TD3")
    for changes, message in (
        ({"policy_class": None}, "data has no policy_class"),
        ({"member_data": b"{"}, "data is not JSON"),
        ({"observation_space": {"shape": [6]}}, "observation_space is missing"),
        ({"observation_space": {":serialized:": "?"}}, "observation_space is not base64"),
        ({"member_policy_pth": b"nonsense"}, "policy.pth holds more than weights"),
    ):
        with pytest.raises(PolicyError, match=message):
            import_policy(ImportRequest(rewritten(tmp_path / "model.zip", **changes)), tmp_path / "p.onnx")


def test_an_image_policy_is_refused_by_its_space(tmp_path: Path) -> None:
    import base64
    import pickle

    from gymnasium import spaces

    saved(tmp_path, "TD3")
    for space, message in (
        (
            spaces.Dict({"scan": spaces.Box(0.0, 1.0, (6,))}),
            "observation_space is a pickle that names 'collections",
        ),
        (spaces.Box(0, 255, (3, 4, 4), np.uint8), r"Box of shape \[3, 4, 4\], an image"),
        (spaces.Discrete(5), r"is a Discrete\(5\), where a Box is expected"),
        (spaces.MultiBinary(5), "is a MultiBinary, where a Box or a Discrete"),
    ):
        text = base64.b64encode(pickle.dumps(space)).decode()
        path = rewritten(tmp_path / "model.zip", observation_space={":serialized:": text})
        if isinstance(space, spaces.Dict):
            message = "observation_space is a Dict, where a Box or a Discrete"
        with pytest.raises(PolicyError, match=message):
            import_policy(ImportRequest(path), tmp_path / "policy.onnx")


def test_the_environment_of_these_tests_has_the_limits_of_the_actions() -> None:
    assert Wander().action_space.low.tolist() == LOW.tolist()
    assert Wander().action_space.high.tolist() == HIGH.tolist()


def test_older_versions_name_gym_and_numpy_otherwise(tmp_path: Path) -> None:
    import base64
    import json
    import pickle
    import zipfile

    model, normaliser = saved(tmp_path, "TD3", normalise=True)
    with zipfile.ZipFile(tmp_path / "model.zip") as archive:
        data = json.loads(archive.read("data"))
    changes: dict[str, Any] = {}
    for field in ("observation_space", "action_space"):
        space = pickle.loads(base64.b64decode(data[field][":serialized:"]))
        content = pickle.dumps(space, 2)  # names stand between line breaks, so that they can be changed
        content = content.replace(b"cgymnasium.spaces", b"cgym.spaces").replace(
            b"cnumpy._core", b"cnumpy.core"
        )
        assert b"cgym.spaces.box" in content
        changes[field] = {":serialized:": base64.b64encode(content).decode()}
    with (tmp_path / "vec_normalize.pkl").open("rb") as stream:
        old = pickle.load(stream)
    old.class_attributes = old.returns = None  # which saving leaves out
    content = pickle.dumps(old, 2).replace(b"cgymnasium.spaces", b"cgym.spaces")
    (tmp_path / "old.pkl").write_bytes(content.replace(b"cnumpy._core", b"cnumpy.core"))

    request = ImportRequest(rewritten(tmp_path / "model.zip", **changes), tmp_path / "old.pkl")
    policy = import_policy(request, tmp_path / "policy.onnx").policy
    raw = observations()
    expected, _ = model.predict(normaliser.normalize_obs(raw), deterministic=True)
    np.testing.assert_allclose(policy.run(raw), expected, atol=2e-5)


def test_inspect_points_to_import(tmp_path: Path) -> None:
    saved(tmp_path, "TD3")
    with pytest.raises(PolicyError, match="is not an ONNX model") as refusal:
        load_policy(tmp_path / "model.zip")
    assert "viatool import" in refusal.value.hint


def test_a_class_in_disguise_is_not_taken_for_that_of_a_library(tmp_path: Path) -> None:
    import base64

    import cloudpickle

    class ReLU(torch.nn.Tanh):
        """Not what its name says."""

    class FlattenExtractor(Doubled):
        """Not what its name says."""

    for kind, module in ((ReLU, "torch.nn.modules.activation"), (FlattenExtractor, "elsewhere")):
        kind.__module__ = module
    saved(tmp_path, "TD3")
    for settings, message in (
        ({"activation_fn": ReLU}, r"activation_fn is 'own class torch.nn.modules.activation.*ReLU'"),
        ({"features_extractor_class": FlattenExtractor}, r"features_extractor_class is '.*FlattenExtractor'"),
    ):
        text = base64.b64encode(cloudpickle.dumps({"net_arch": [16, 12], **settings})).decode()
        path = rewritten(tmp_path / "model.zip", policy_kwargs={":serialized:": text})
        with pytest.raises(PolicyError, match=message):
            import_policy(ImportRequest(path), tmp_path / "policy.onnx")
