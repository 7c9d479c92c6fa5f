"""Functions that stay finite though an exponential inside them does not, against onnxruntime and high precision."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest

from tests.oracles import MP
from tests.policy.models import model_of, node, save
from viatool.errors import EnclosureError
from viatool.policy import load_policy
from viatool.policy.network import Activation
from viatool.taylor import reach
from viatool.taylor.reach import ReachableSet

ONE = {"one": np.float32(1)}

LOGISTICS: dict[str, list[onnx.NodeProto]] = {
    "quotient": [
        node("Neg", ["x"], ["m"]),
        node("Exp", ["m"], ["e"]),
        node("Add", ["one", "e"], ["d"]),
        node("Div", ["one", "d"], ["y"]),
    ],
    "reciprocal": [
        node("Neg", ["x"], ["m"]),
        node("Exp", ["m"], ["e"]),
        node("Add", ["e", "one"], ["d"]),
        node("Reciprocal", ["d"], ["y"]),
    ],
    "power": [
        node("Sub", ["zero", "x"], ["m"]),
        node("Exp", ["m"], ["e"]),
        node("Add", ["e", "one"], ["d"]),
        node("Pow", ["d", "minus"], ["y"]),
    ],
}

CENTRES = (-1e29, -1e4, -104.0, -89.0, -88.5, -30.0, -3.0, 0.0, 3.0, 16.7, 30.0, 88.7, 1e4, 1e29)


def run(model: onnx.ModelProto, points: Any) -> Any:
    """Run every point by itself, as it is optimised and as it stands: (2 P, A) of float64."""
    rows = []
    for level in (
        onnxruntime.GraphOptimizationLevel.ORT_ENABLE_ALL,
        onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL,
    ):
        options = onnxruntime.SessionOptions()
        options.graph_optimization_level, options.intra_op_num_threads = level, 1
        session = onnxruntime.InferenceSession(
            model.SerializeToString(), options, providers=["CPUExecutionProvider"]
        )
        rows += [session.run(None, {"x": point[None]})[0][0].astype(np.float64) for point in points]
    return np.array(rows)


def points_of(centre: Any, eps: float, count: int = 60) -> Any:
    """Random points, corners and neighbours of the centre, float32 numbers of the box."""
    generator = np.random.default_rng(7)
    size = len(centre)
    moves = np.concatenate(
        [
            generator.uniform(-1, 1, (count, size)),
            np.where(generator.random((count, size)) < 0.5, -1.0, 1.0),
            np.zeros((1, size)),
        ]
    )
    points = (centre + eps * moves).astype(np.float32)
    points = np.concatenate([points, np.nextafter(points[-1:], np.float32(np.inf))])
    return points[((points >= centre - eps) & (points <= centre + eps)).all(axis=1)]


def bounds(
    model: onnx.ModelProto, folder: Path, centre: Sequence[float], eps: float, **options: Any
) -> ReachableSet:
    return reach(load_policy(save(model, folder)), [list(centre)], eps, **options)


def contains(sets: ReachableSet, values: Any) -> bool:
    return bool(((sets.lower[0] <= values) & (values <= sets.upper[0])).all())


@pytest.mark.parametrize("form", LOGISTICS)
def test_a_logistic_from_its_parts_keeps_to_its_range_wherever_its_exponential_goes(
    form: str, tmp_path: Path
) -> None:
    constants = {**ONE, "zero": np.float32(0), "minus": np.float32(-1)}
    model = model_of(LOGISTICS[form], constants, shape=(1, 1))
    policy = load_policy(save(model, tmp_path))
    for centre in CENTRES:
        eps = max(0.3, 1e-5 * abs(centre))
        sets = reach(policy, [[centre]], eps)
        assert contains(sets, run(model, points_of(np.array([centre]), eps)))
        assert sets.lower[0, 0] >= -1e-6
        assert sets.upper[0, 0] <= 1 + 1e-5


def test_a_logistic_of_real_numbers_contains_its_exact_values(tmp_path: Path) -> None:
    model = model_of(LOGISTICS["quotient"], ONE, shape=(1, 1))
    policy = load_policy(save(model, tmp_path))
    for centre in CENTRES[1:-1]:
        sets = reach(policy, [[centre]], 0.25, arithmetic="real")
        for x in (centre - 0.25, centre, centre + 0.25):
            exact = 1 / (1 + MP.exp(-MP.mpf(x)))
            assert MP.mpf(float(sets.lower[0, 0])) <= exact <= MP.mpf(float(sets.upper[0, 0]))


@pytest.mark.parametrize("arithmetic", ["float32", "real"])
def test_bounds_of_a_logistic_from_its_parts_are_nearly_attained(arithmetic: str, tmp_path: Path) -> None:
    model = model_of(LOGISTICS["quotient"], ONE, shape=(1, 1))
    policy = load_policy(save(model, tmp_path))
    sets = reach(
        policy, [[0.0], [0.0], [20.0], [-29.0]], [[30.0], [1.0], [10.0], [1.0]], arithmetic=arithmetic
    )
    rounding = 0.0 if arithmetic == "real" else 2e-6
    assert (sets.width <= 1.05 * sets.attained_width + rounding).all()


def test_an_exponential_that_overflows_in_numerator_and_divisor_is_refused(tmp_path: Path) -> None:
    nodes = [
        node("Exp", ["x"], ["e"]),
        node("Add", ["e", "one"], ["d"]),
        node("Div", ["e", "d"], ["y"]),
    ]
    model = model_of(nodes, ONE, shape=(1, 1))
    assert np.isnan(run(model, np.array([[90.0]], dtype=np.float32))).all()
    with pytest.raises(EnclosureError, match=r"\((Exp|Div)\)"):
        bounds(model, tmp_path, [88.0], 2.0)
    assert contains(bounds(model, tmp_path, [3.0], 0.5), run(model, points_of(np.array([3.0]), 0.5)))


@pytest.mark.parametrize("slope", [1.0, 1.702, 10.0])
@pytest.mark.parametrize("spelled", [False, True])
def test_a_swish_is_one_function_of_its_argument(slope: float, spelled: bool, tmp_path: Path) -> None:
    constants = {**ONE, "s": np.float32(-slope if spelled else slope)}
    nodes = [node("Mul", ["x", "s"], ["m"])]
    if spelled:
        nodes += [node("Exp", ["m"], ["e"]), node("Add", ["e", "one"], ["d"]), node("Div", ["x", "d"], ["y"])]
    else:
        nodes += [node("Sigmoid", ["m"], ["g"]), node("Mul", ["x", "g"], ["y"])]
    model = model_of(nodes, constants, shape=(1, 1))
    policy = load_policy(save(model, tmp_path))
    assert [n.function.name for n in policy.network.nodes if isinstance(n, Activation)] in (
        ["Swish"],
        ["Silu"],
    )
    for centre in (-200.0, -30.0, -1.0, 0.0, 2.0, 90.0):
        sets = reach(policy, [[centre]], 0.3)
        assert contains(sets, run(model, points_of(np.array([centre]), 0.3)))
        assert (
            sets.width[0, 0] <= 1.05 * sets.attained_width[0, 0] + 64 * 2.0**-23 * (abs(centre) + 1) * slope
        )


SOFTMAXES = ("Softmax", "LogSoftmax")


@pytest.mark.parametrize("operator", SOFTMAXES)
@pytest.mark.parametrize(
    "logits",
    [
        (90.0, 0.0, -90.0),
        (100.0, 100.3, 10.0),
        (-200.0, -200.5),
        (0.0, 0.0, 0.0, 0.0, 0.0),
        (1e29, -1e29, 3e28),
        (3.0, -30.0, 2.0, 1.0, -8.0, 3.5, 30.0),
        tuple(np.linspace(-40, 40, 33)),
        (7.0,),
    ],
    ids=len,
)
def test_a_softmax_keeps_to_its_range_whatever_its_logits(
    operator: str, logits: tuple[float, ...], tmp_path: Path
) -> None:
    model = model_of([node(operator, ["x"], ["y"], axis=1)], {}, shape=(1, len(logits)))
    centre = np.array(logits)
    if len(logits) == 1:  # which leaves a constant
        model = model_of(
            [node(operator, ["x"], ["z"], axis=1), node("Add", ["x", "z"], ["y"])], {}, shape=(1, 1)
        )
    eps = max(0.1, 1e-5 * float(np.abs(centre).max()))
    sets = bounds(model, tmp_path, logits, eps)
    assert contains(sets, run(model, points_of(centre, eps)))
    if operator == "Softmax" and len(logits) > 1:
        assert (sets.lower >= -1e-6).all()
        assert (sets.upper <= 1 + 1e-4).all()
    elif len(logits) > 1:
        assert (sets.upper <= 1e-4).all()


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6, 7, 9, 16])
def test_a_softmax_of_real_numbers_contains_its_exact_values(count: int, tmp_path: Path) -> None:
    generator = np.random.default_rng(count)
    model = model_of([node("Softmax", ["x"], ["y"], axis=1)], {}, shape=(1, count))
    policy = load_policy(save(model, tmp_path))
    centre = generator.normal(size=count) * 10
    sets = reach(policy, centre[None], 0.2, arithmetic="real")
    for _ in range(30):
        x = centre + 0.2 * np.clip(generator.normal(size=count) * 2, -1, 1) * (1 - 1e-9)
        powers = [MP.exp(MP.mpf(float(value))) for value in x]
        exact = [power / sum(powers) for power in powers]
        for lower, value, upper in zip(sets.lower[0], exact, sets.upper[0], strict=True):
            assert MP.mpf(float(lower)) <= value <= MP.mpf(float(upper))


def test_bounds_of_a_softmax_of_logits_thirty_apart_are_nearly_attained(tmp_path: Path) -> None:
    model = model_of([node("Softmax", ["x"], ["y"], axis=1)], {}, shape=(1, 3))
    policy = load_policy(save(model, tmp_path))
    centres = [[30.0, 0.0, -30.0], [1.0, 0.0, -30.0], [30.0, 29.5, 29.0], [0.5, 0.1, 0.0]]
    real = reach(policy, centres, 0.1, arithmetic="real")
    assert (real.width <= 1.05 * real.attained_width + 3e-14).all()
    deployed = reach(policy, centres, 0.1)
    assert (deployed.width[2:] <= 1.05 * deployed.attained_width[2:]).all()


def test_a_softmax_of_mixed_inputs_contains_what_onnxruntime_computes(tmp_path: Path) -> None:
    weight = np.random.default_rng(2).normal(size=(4, 6)).astype(np.float32) * 4
    nodes = [node("MatMul", ["x", "w"], ["t"]), node("Softmax", ["t"], ["y"], axis=1)]
    model = model_of(nodes, {"w": weight}, shape=(1, 4))
    centre = np.array([0.3, -0.2, 0.5, 0.1])
    for refine in ("none", "monotone"):
        sets = bounds(model, tmp_path, centre.tolist(), 0.1, refine=refine)
        assert contains(sets, run(model, points_of(centre, 0.1)))
        assert (sets.lower >= -1e-5).all()
        assert (sets.upper <= 1 + 1e-5).all()
