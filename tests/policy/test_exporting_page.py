"""The recipes and sidecars of docs/exporting.md: each block is run or read, and fits an actor of its size."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from onnx import TensorProto, helper

from tests.policy.models import node, save, two_layers
from tests.policy.test_exports_shapes import keras, matlab, ml_agents
from viatool.policy import load_policy, load_specification

PAGES = [Path(__file__).parents[2] / "docs" / name for name in ("exporting.md", "specification.md")]


def blocks(page: Path, language: str) -> dict[str, str]:
    """The code blocks of a page by the heading above them; later ones of the same heading are numbered."""
    found: dict[str, str] = {}
    for section in re.split(r"^#+ ", page.read_text(encoding="utf-8"), flags=re.MULTILINE):
        title = section.partition("\n")[0]
        for index, text in enumerate(re.findall(rf"```{language}\n(.*?)```", section, re.DOTALL)):
            found[f"{title} {index}" if index else title] = text
    return found


SIDECARS = {
    f"{page.stem}: {title}": text
    for page in PAGES
    for title, text in blocks(page, "yaml").items()
    if "observation:" in text  # a whole one, not some of its keys
}


@pytest.mark.parametrize("title", SIDECARS)
def test_a_sidecar_describes_a_policy(title: str, tmp_path: Path) -> None:
    sidecar = tmp_path / "robot.yaml"
    sidecar.write_text(SIDECARS[title], encoding="utf-8")
    spec = load_specification(sidecar)
    model = two_layers(size=spec.observation_size, actions=spec.action_size)
    if isinstance(spec.input, str):
        model.graph.input[0].name = model.graph.node[0].input[0] = spec.input
    if isinstance(spec.input, list):
        sizes = [spec.observation_size - 2 * (len(spec.input) - 1), *[2] * (len(spec.input) - 1)]
        del model.graph.input[:]
        for name, size in zip(spec.input, sizes, strict=True):
            model.graph.input.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, size]))
        model.graph.node.insert(0, node("Concat", spec.input, ["x"], axis=1))
    for source, made in spec.memory.items():
        model.graph.input.append(helper.make_tensor_value_info(source, TensorProto.FLOAT, [1, 3]))
        model.graph.output.append(helper.make_tensor_value_info(made, TensorProto.FLOAT, None))
        model.graph.node.append(node("Tanh", [source], [made]))
    if spec.output is not None:
        model.graph.output[0].name = model.graph.node[-1].output[0] = spec.output
    policy = load_policy(save(model, tmp_path), sidecar)
    assert {channel.kind for channel in policy.spec.action} == {"linear", "angular"}  # type: ignore[union-attr]
    maps_outputs = spec.action_map is not None or spec.schema_version == 2
    assert ("by the specification" in policy.maps.after) == maps_outputs


@pytest.mark.parametrize(
    ("section", "model"),
    [("Keras", keras), ("MATLAB", matlab), ("ML-Agents", ml_agents)],
    ids=["Keras", "MATLAB", "ML-Agents"],
)
def test_the_sidecar_of_a_framework_fits_its_graph(section: str, model: Any, tmp_path: Path) -> None:
    sidecar = tmp_path / "robot.yaml"
    sidecar.write_text(blocks(PAGES[0], "yaml")[section], encoding="utf-8")
    policy = load_policy(save(model(), tmp_path), sidecar)
    observations = np.random.default_rng(0).normal(size=(20, 6))
    np.testing.assert_allclose(policy(observations), policy.run(observations), atol=1e-4)


def test_the_sections_are_those_of_the_frameworks() -> None:
    assert {
        "Stable-Baselines3 (TD3, DDPG, SAC, PPO, A2C)",
        "CleanRL",
        "RSL-RL and Isaac Lab",
        "rl_games",
    } <= set(blocks(PAGES[0], "python"))
