"""Normalisations by statistics of the input, against programs that compute the variance in each of the known ways."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
from numpy.typing import NDArray

from tests.policy.models import model_of, node, save
from tests.taylor.containment import Bare
from viatool.errors import EnclosureError, SelfCheckError
from viatool.policy import Policy, load_policy
from viatool.policy.network import Activation
from viatool.policy.operators import normalisation, variance
from viatool.policy.self_check import check_network
from viatool.taylor import reach

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

EPSILON = np.float32(1e-5)
SCALE, SHIFT = np.float32(1.25), np.float32(-0.375)


# --- models ----------------------------------------------------------------------------------------------


def normalisation_of(operator: str, size: int, **attributes: Any) -> onnx.ModelProto:
    """One normalisation over all of x, with one scale and shift."""
    shape = {"LayerNormalization": [1, size], "InstanceNormalization": [1, 1, size]}.get(
        operator, [1, size, 1]
    )
    channels = 1 if operator == "InstanceNormalization" else size
    nodes = [
        node("Reshape", ["x", "to"], ["x3"]),
        node(operator, ["x3", "scale", "shift"], ["y3"], name="norm", epsilon=float(EPSILON), **attributes),
        node("Reshape", ["y3", "back"], ["y"]),
    ]
    constants = {
        "to": np.array(shape),
        "back": np.array([1, size]),
        "scale": np.full(channels, SCALE),
        "shift": np.full(channels, SHIFT),
    }
    return model_of(nodes, constants, shape=(1, size), opset=21)


def spelled_out(size: int, middle: list[onnx.NodeProto]) -> onnx.ModelProto:
    nodes = [
        node("ReduceMean", ["x"], ["mean"], axes=[1]),
        node("Sub", ["x", "mean"], ["centred"]),
        *middle,
        node("Add", ["variance", "epsilon"], ["raised"]),
        node("Sqrt", ["raised"], ["spread"], name="spread"),
        node("Div", ["centred", "spread"], ["z"]),
        node("Mul", ["z", "scale"], ["scaled"]),
        node("Add", ["scaled", "shift"], ["y"]),
    ]
    constants = {
        "epsilon": EPSILON,
        "two": np.float32(2),
        "scale": np.full(size, SCALE),
        "shift": np.full(size, SHIFT),
    }
    return model_of(nodes, constants, shape=(1, size), opset=13)


def two_passes_spelled_out(size: int) -> onnx.ModelProto:
    return spelled_out(
        size,
        [node("Pow", ["centred", "two"], ["s"]), node("ReduceMean", ["s"], ["variance"], axes=[1])],
    )


def one_pass_spelled_out(size: int) -> onnx.ModelProto:
    return spelled_out(
        size,
        [
            node("Mul", ["x", "x"], ["s"]),
            node("ReduceMean", ["s"], ["q"], axes=[1]),
            node("Mul", ["mean", "mean"], ["m"]),
            node("Sub", ["q", "m"], ["variance"]),
        ],
    )


MODELS: dict[str, Callable[[int], onnx.ModelProto]] = {
    "GroupNormalization": lambda size: normalisation_of("GroupNormalization", size, num_groups=1),
    "InstanceNormalization": lambda size: normalisation_of("InstanceNormalization", size),
    "LayerNormalization": lambda size: normalisation_of("LayerNormalization", size),
    "two passes": two_passes_spelled_out,
    "one pass": one_pass_spelled_out,
}


# --- programs, in float32 throughout ----------------------------------------------------------------------


def added(x: Singles) -> np.float32:
    """Sum one after the other."""
    total = np.float32(0)
    for value in x:
        total = np.float32(total + value)
    return total


def two_passes(x: Singles) -> tuple[np.float32, np.float32]:
    mean = np.float32(added(x) / np.float32(x.size))
    return mean, np.float32(added((x - mean) ** 2) / np.float32(x.size))


def one_pass(x: Singles) -> tuple[np.float32, np.float32]:
    share = np.float32(1) / np.float32(x.size)
    mean = np.float32(added(x) * share)
    return mean, np.float32(np.float32(added(x * x) * share) - mean * mean)


def pairwise_one_pass(x: Singles) -> tuple[np.float32, np.float32]:
    count = np.float32(x.size)
    total = x.sum(dtype=np.float32)
    return total / count, ((x * x).sum(dtype=np.float32) - total * total / count) / count


def updates(x: Singles) -> tuple[np.float32, np.float32]:
    mean, moment = np.float32(0), np.float32(0)
    for count, value in enumerate(x, start=1):
        difference = np.float32(value - mean)
        mean = np.float32(mean + difference / np.float32(count))
        moment = np.float32(moment + difference * np.float32(value - mean))
    return mean, np.float32(moment / np.float32(x.size))


def from_deviations(x: Singles, mean: np.float32, variance: np.float32) -> Singles:
    return (x - mean) / np.sqrt(variance + EPSILON) * SCALE + SHIFT


def with_the_mean_in_the_shift(x: Singles, mean: np.float32, variance: np.float32) -> Singles:
    factor = np.float32(np.float32(1) / np.sqrt(variance + EPSILON)) * SCALE
    return x * factor + (SHIFT - mean * factor)


STATISTICS = (two_passes, one_pass, pairwise_one_pass, updates)
FINISHES = (from_deviations, with_the_mean_in_the_shift)


# --- how far something leaves the bounds ------------------------------------------------------------------


def points_in(centre: Floats, eps: float, count: int = 60) -> Singles:
    generator = np.random.default_rng(1)
    low, high = centre - eps, centre + eps
    corners = np.where(generator.random((count, centre.size)) < 0.5, low, high)
    points = np.concatenate(
        [corners, generator.uniform(low, high, (count, centre.size)), [centre]], dtype=np.float64
    ).astype(np.float32)
    points = np.where(points < low, np.nextafter(points, np.float32(np.inf)), points)
    return np.where(points > high, np.nextafter(points, np.float32(-np.inf)), points)


def excess(actions: Floats, lower: Floats, upper: Floats) -> float:
    """Return how far actions leave bounds; what is not a number leaves them."""
    beyond = np.maximum(actions - upper, lower - actions)
    return float(np.where(np.isnan(beyond), np.inf, beyond).max())


def escape_of_algorithms(loaded: Policy, centre: Floats, eps: float) -> float:
    sets = reach(Bare(loaded.network), centre[None], eps)  # whatever onnxruntime gives
    worst = -np.inf
    for point in points_in(centre, eps):
        for statistics in STATISTICS:
            for finish in FINISHES:
                action = finish(point, *statistics(point)).astype(np.float64)
                worst = max(worst, excess(action, sets.lower[0], sets.upper[0]))
    return worst


def escape_of_onnxruntime(path: Path, centre: Floats, eps: float) -> float:
    sets = reach(load_policy(path), centre[None], eps)
    worst = -np.inf
    for level in ("ORT_DISABLE_ALL", "ORT_ENABLE_ALL"):
        options = onnxruntime.SessionOptions()
        options.graph_optimization_level = getattr(onnxruntime.GraphOptimizationLevel, level)
        session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        for point in points_in(centre, eps):
            action = session.run(None, {"x": point[None]})[0][0].astype(np.float64)
            worst = max(worst, excess(action, sets.lower[0], sets.upper[0]))
    return worst


def readings(size: int, mean: float) -> Floats:
    return mean + np.random.default_rng(size).normal(size=size)


# --- tests ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mean", [0.0, -30.0, 100.0])
@pytest.mark.parametrize("size", [2, 3, 8, 21])
@pytest.mark.parametrize("name", MODELS)
def test_every_way_to_a_variance_keeps_to_the_bounds(
    name: str, size: int, mean: float, tmp_path: Path
) -> None:
    path = save(MODELS[name](size), tmp_path)
    centre = readings(size, mean)
    assert escape_of_algorithms(load_policy(path), centre, 1e-4) <= 0
    assert escape_of_onnxruntime(path, centre, 1e-4) <= 0


@pytest.mark.parametrize("name", MODELS)
def test_without_the_squares_of_the_values_a_one_pass_program_escapes(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def of_deviations_alone(*given: Any, uncentred: Any) -> Any:
        return original(*given, uncentred=None)

    original = variance.variance
    for module in (variance, normalisation):
        monkeypatch.setattr(module, "variance", of_deviations_alone)
    loaded = load_policy(save(MODELS[name](8), tmp_path), self_check=False)
    assert escape_of_algorithms(loaded, readings(8, 100.0), 1e-4) > 0


@pytest.mark.parametrize("name", MODELS)
def test_around_mean_zero_the_bounds_are_tight(name: str, tmp_path: Path) -> None:
    loaded = load_policy(save(MODELS[name](8), tmp_path))
    sets = reach(loaded, readings(8, 0.0)[None], 1e-3)
    assert (sets.deviation < 2e-5).all()
    assert (sets.upper - sets.lower < 1.1 * (sets.attained_upper - sets.attained_lower) + 4e-5).all()


def test_both_ways_that_a_graph_can_spell_are_the_same_network(tmp_path: Path) -> None:
    centre = readings(8, 10.0)[None]
    sets = [reach(load_policy(save(MODELS[name](8), tmp_path)), centre, 0.05) for name in MODELS]
    for other in sets[1:]:
        np.testing.assert_allclose(other.lower, sets[0].lower, rtol=1e-9)
        np.testing.assert_allclose(other.deviation, sets[0].deviation, rtol=1e-6)


@pytest.mark.parametrize("name", MODELS)
def test_a_variance_that_may_cancel_altogether_is_refused_by_the_name_of_its_node(
    name: str, tmp_path: Path
) -> None:
    loaded = load_policy(save(MODELS[name](8), tmp_path))
    with pytest.raises(EnclosureError, match=r"node '(norm|spread)' \((\w+Normalization|Sqrt)\)") as caught:
        reach(loaded, readings(8, 1e4)[None], 1e-3)
    assert "subtract a constant near the mean" in caught.value.hint


def test_where_float16_is_the_trouble_the_hint_of_float32_helps(tmp_path: Path) -> None:
    def loaded(kind: str) -> Policy:
        dtype = onnx.helper.np_dtype_to_tensor_dtype(np.dtype(kind))
        nodes = [node("LayerNormalization", ["x", "s"], ["y"], name="norm", epsilon=1e-9)]
        model = model_of(nodes, {"s": np.ones(2, dtype=kind)}, shape=(1, 2), dtype=dtype)
        return load_policy(save(model, tmp_path, f"{kind}.onnx"))

    close = np.array([[1.0, 1.003]])
    with pytest.raises(EnclosureError, match="'norm'") as caught:
        reach(loaded("float16"), close, 1e-5)
    assert "float32" in caught.value.hint
    assert reach(loaded("float32"), close, 1e-5).width.max() < 2


def test_what_has_no_enclosure_is_refused_by_the_name_of_its_node(tmp_path: Path) -> None:
    model = model_of([node("Tanh", ["x"], ["t"]), node("Log", ["t"], ["y"], name="surprise")])
    loaded = Bare(load_policy(save(model, tmp_path), self_check=False).network)
    with pytest.raises(EnclosureError, match=r"node 'surprise' \(Log\): Log has no finite range"):
        reach(loaded, [[0.5, 0.01, 0.5, 0.5]], 0.1)


def test_the_hint_of_that_refusal_works(tmp_path: Path) -> None:
    model = normalisation_of("GroupNormalization", 8, num_groups=1)
    model.graph.initializer.append(onnx.numpy_helper.from_array(np.float32(1e4), "near"))
    model.graph.node.insert(0, node("Sub", ["x", "near"], ["small"]))
    model.graph.node[1].input[0] = "small"
    path = save(model, tmp_path)
    assert escape_of_onnxruntime(path, readings(8, 1e4), 1e-3) <= 0


def test_the_self_check_does_not_take_a_cancelled_variance_for_a_wrong_reader(tmp_path: Path) -> None:
    model = normalisation_of("GroupNormalization", 8, num_groups=1)
    model.graph.initializer.append(onnx.numpy_helper.from_array(np.float32(1e4), "far"))
    model.graph.node.insert(0, node("Add", ["x", "far"], ["large"]))
    model.graph.node[1].input[0] = "large"
    loaded = load_policy(save(model, tmp_path))
    assert np.isnan(loaded.run(points_in(readings(8, 0.0), 0.5))).any()


@pytest.mark.parametrize("name", MODELS)
def test_the_self_check_still_sees_a_wrong_epsilon(name: str, tmp_path: Path) -> None:
    loaded = load_policy(save(MODELS[name](8), tmp_path))
    wrong = load_policy(save(with_epsilon(MODELS[name](8), 1e-3), tmp_path))
    assert any(isinstance(n, Activation) and n.function.name == "Sqrt" for n in wrong.network.nodes)
    with pytest.raises(SelfCheckError, match="disagree"):
        check_network(wrong.network, loaded.runtime, None)


def with_epsilon(model: onnx.ModelProto, epsilon: float) -> onnx.ModelProto:
    for call in model.graph.node:
        for attribute in call.attribute:
            if attribute.name == "epsilon":
                attribute.f = epsilon
    for tensor in model.graph.initializer:
        if tensor.name == "epsilon":
            tensor.CopyFrom(onnx.numpy_helper.from_array(np.float32(epsilon), "epsilon"))
    return model


@pytest.mark.parametrize("stash", [onnx.TensorProto.FLOAT, onnx.TensorProto.FLOAT16])
@pytest.mark.parametrize("operator", ["LayerNormalization", "GroupNormalization"])
def test_statistics_are_taken_in_the_precision_of_their_stash_type(
    operator: str, stash: int, tmp_path: Path
) -> None:
    attributes = {"num_groups": 1} if operator == "GroupNormalization" else {}
    model = normalisation_of(operator, 8, stash_type=stash, **attributes)
    loaded = load_policy(save(model, tmp_path))
    roots = {n.precision for n in loaded.network.nodes if isinstance(n, Activation)}
    assert roots == {"float16" if stash == onnx.TensorProto.FLOAT16 else "float32"}
