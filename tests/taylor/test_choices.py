"""Which commands of a table a policy may choose: never one too few, and hardly one too many."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from numpy.typing import NDArray
from onnx import helper, numpy_helper

import viatool
from viatool.policy import Policy, load_policy
from viatool.policy.specification import PolicySpecification
from viatool.taylor import choices, mixtures

Floats = NDArray[np.float64]


def table(inputs: int, commands: int) -> PolicySpecification:
    """Return the specification of a choice among so many commands."""
    channel = {"name": "turn", "kind": "choice", "axes": ["linear", "angular"]}
    channel["commands"] = [[0.1, 0.3 * number - 0.5] for number in range(commands)]  # type: ignore[assignment]
    return PolicySpecification.model_validate(
        {"schema_version": 2, "observation": [{"name": "seen", "size": inputs}], "action": [channel]}
    )


def write_values(
    path: Path,
    sizes: tuple[int, ...],
    seed: int,
    operator: str = "Relu",
    bias: Floats | None = None,
    gain: float = 1.0,
) -> Path:
    """Write a random network of values, one for each command."""
    generator = np.random.default_rng(seed)
    nodes, tensors, value = [], [], "seen"
    for layer, (rows, columns) in enumerate(pairwise(sizes)):
        weight = generator.normal(size=(columns, rows)) * gain * np.sqrt(2.0 / rows)
        offset = 0.1 * generator.normal(size=columns)
        last = layer == len(sizes) - 2
        if last and bias is not None:
            offset = bias
        for name, array in ((f"w{layer}", weight), (f"b{layer}", offset)):
            tensors.append(numpy_helper.from_array(array.astype(np.float32), name))
        made = "values" if last else f"sum{layer}"
        nodes.append(helper.make_node("Gemm", [value, f"w{layer}", f"b{layer}"], [made], transB=1))
        if not last:
            value = f"unit{layer}"
            nodes.append(helper.make_node(operator, [made], [value]))
    ends = [
        helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["batch", size])
        for name, size in (("seen", sizes[0]), ("values", sizes[-1]))
    ]
    graph = helper.make_graph(nodes, "values", ends[:1], ends[1:], tensors)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8), path)
    return path


def attack(policy: Policy, observations: Floats, eps: float, rounds: int) -> NDArray[Any]:
    """Return which commands onnxruntime chooses at random points and corners of the boxes, (B, K)."""
    generator, found = np.random.default_rng(5), np.zeros((len(observations), policy.output_size), dtype=bool)
    for number in range(rounds):
        shift = generator.uniform(-1.0, 1.0, (len(observations), 200, observations.shape[1]))
        shift = np.sign(shift) if number % 2 else shift
        points = (observations[:, None] + eps * shift).reshape(-1, observations.shape[1])
        chosen = policy.run(points).argmax(axis=1).reshape(len(observations), -1)
        for command in range(policy.output_size):
            found[:, command] |= (chosen == command).any(axis=1)
    return found


def boxes(count: int, size: int) -> Floats:
    """Return middles of boxes."""
    return np.random.default_rng(3).uniform(-1.0, 1.0, (count, size))


def test_the_possible_commands_are_those_of_an_exhaustive_attack(tmp_path: Path) -> None:
    """In at least 95 of 100 states, and never one fewer; a table of five commands."""
    policy = load_policy(write_values(tmp_path / "values.onnx", (24, 64, 64, 5), 1), table(24, 5))
    observations, eps = boxes(100, 24), 0.025
    sets = viatool.reach(policy, observations, eps)
    assert sets.possible is not None
    assert sets.attained is not None
    found = attack(policy, observations, eps, rounds=20)
    assert not (found & ~sets.possible).any()
    assert not (sets.attained & ~sets.possible).any()
    assert ((found | sets.attained) == sets.possible).all(axis=1).mean() >= 0.95
    assert (sets.possible.sum(axis=1) > 1).sum() >= 20  # or else nothing was to be decided


def test_of_curved_values_too_little_stays_open_in_wide_boxes(tmp_path: Path) -> None:
    """Splitting neurons one by one does not help there."""
    policy = load_policy(write_values(tmp_path / "values.onnx", (8, 24, 24, 5), 1, "Tanh"), table(8, 5))
    observations, eps = boxes(60, 8), 0.12
    sets = viatool.reach(policy, observations, eps)
    assert sets.possible is not None
    assert sets.attained is not None
    found = attack(policy, observations, eps, rounds=20)
    assert not (found & ~sets.possible).any()
    assert ((found | sets.attained) == sets.possible).all(axis=1).mean() >= 0.95
    assert (sets.possible.sum(axis=1) > 1).sum() >= 20


def test_half_of_a_box_that_is_forgotten_excludes_what_is_chosen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mutant that looks at the lower half of what it cuts alone; commands that are attained early hide nothing."""
    halves = mixtures._Parts.halves
    monkeypatch.setattr(
        mixtures._Parts, "halves", lambda parts, axis: halves(parts, axis).rows(np.arange(len(parts.owner)))
    )
    monkeypatch.setattr(choices, "climb", lambda network, box, seed, start: (box.centre, start))
    with pytest.raises(AssertionError):
        test_no_command_that_is_chosen_is_missing(tmp_path, "Tanh", "monotone")


def test_means_without_the_rounding_of_the_program_miss_what_it_chooses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mutant that leaves it out of the means of curved networks alone."""
    means = choices.excluded_by_means
    monkeypatch.setattr(
        choices,
        "excluded_by_means",
        lambda net, box, k, stray, **more: means(net, box, k, 0.0 * stray, **more),
    )
    with pytest.raises(AssertionError):
        test_outputs_that_rounding_may_make_equal_are_both_possible(tmp_path, "Tanh")


@pytest.mark.parametrize("operator", ["Relu", "Tanh", "Sigmoid", "Elu"])
@pytest.mark.parametrize("refine", ["none", "monotone"])
def test_no_command_that_is_chosen_is_missing(tmp_path: Path, operator: str, refine: Any) -> None:
    """Of wide boxes, of which much is possible."""
    policy = load_policy(
        write_values(tmp_path / "v.onnx", (4, 16, 16, 6), 2, operator, gain=1.5), table(4, 6)
    )
    observations, eps = boxes(3, 4), 0.4
    sets = viatool.reach(policy, observations, eps, refine=refine)
    assert sets.possible is not None
    assert not (attack(policy, observations, eps, rounds=20) & ~sets.possible).any()


def test_a_box_in_which_different_commands_are_better_excludes_what_none_excludes_alone(
    tmp_path: Path,
) -> None:
    """Values x, -x and 0.4 |x| - 0.1: the last is never the largest, though each of the others loses somewhere."""
    weights = {
        "w0": [[1.0], [-1.0]], "b0": [0.0, 0.0],
        "w1": [[1.0, -1.0], [-1.0, 1.0], [0.4, 0.4]], "b1": [0.0, 0.0, -0.1],
    }  # fmt: skip
    nodes = [
        helper.make_node("Gemm", ["seen", "w0", "b0"], ["sum"], transB=1),
        helper.make_node("Relu", ["sum"], ["unit"]),
        helper.make_node("Gemm", ["unit", "w1", "b1"], ["values"], transB=1),
    ]
    tensors = [numpy_helper.from_array(np.array(v, np.float32), name) for name, v in weights.items()]
    ends = [
        helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["batch", size])
        for name, size in (("seen", 1), ("values", 3))
    ]
    graph = helper.make_graph(nodes, "values", ends[:1], ends[1:], tensors)
    path = tmp_path / "three.onnx"
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8), path)
    sets = viatool.reach(load_policy(path, table(1, 3)), [[0.0]], 1.0)
    assert sets.possible is not None
    assert sets.possible.tolist() == [[True, True, False]]


@pytest.mark.parametrize("operator", ["Relu", "Tanh"])
def test_outputs_that_rounding_may_make_equal_are_both_possible(tmp_path: Path, operator: str) -> None:
    """The same row twice, the second a hair below: the program may see them the other way round, or as equal."""
    path = write_values(tmp_path / "v.onnx", (3, 8, 3), 4, operator, bias=np.zeros(3))
    model = onnx.load(path)
    for tensor in model.graph.initializer:
        if tensor.name == "w1":
            rows = numpy_helper.to_array(tensor).copy()
            rows[1], rows[2] = rows[0], rows[0]
            tensor.CopyFrom(numpy_helper.from_array(rows, "w1"))
        if tensor.name == "b1":
            tensor.CopyFrom(numpy_helper.from_array(np.array([0.0, -1e-9, -1.0], np.float32), "b1"))
    onnx.save(model, path)
    sets = viatool.reach(load_policy(path, table(3, 3)), [[0.3, -0.2, 0.9]], 0.01)
    assert sets.possible is not None
    assert sets.possible.tolist() == [[True, True, False]]
    exact = viatool.reach(load_policy(path, table(3, 3)), [[0.3, -0.2, 0.9]], 0.01, arithmetic="real")
    assert exact.possible is not None
    assert not exact.possible[0, 2]


@pytest.mark.parametrize("operator", ["Relu", "Tanh"])
def test_without_the_rounding_of_the_program_what_it_chooses_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, operator: str
) -> None:
    """The mutant whose difference does not stray excludes a command that a program of another order chooses."""
    test_outputs_that_rounding_may_make_equal_are_both_possible(tmp_path, operator)
    monkeypatch.setattr(choices, "runtime_deviation", lambda network, hulls: np.zeros_like(hulls[-1][0]))
    with pytest.raises(AssertionError):
        test_outputs_that_rounding_may_make_equal_are_both_possible(tmp_path, operator)


def test_no_boxes_have_no_commands(tmp_path: Path) -> None:
    """An empty batch keeps its shape."""
    policy = load_policy(write_values(tmp_path / "v.onnx", (3, 8, 4), 4), table(3, 4))
    sets = viatool.reach(policy, np.zeros((0, 3)), 0.1)
    assert sets.possible is not None
    assert sets.possible.shape == (0, 4)


def test_a_policy_without_a_choice_has_no_possible_commands(tmp_path: Path) -> None:
    """Its bounds are those of actions."""
    policy = load_policy(write_values(tmp_path / "v.onnx", (3, 8, 2), 4))
    sets = viatool.reach(policy, np.zeros((1, 3)), 0.1)
    assert sets.possible is None
