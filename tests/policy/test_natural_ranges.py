"""Ratios of exponentials, softmaxes from their parts and normalisations keep to their natural range, and are refused
where the program gives no number."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnxruntime as ort
import pytest
from numpy.typing import NDArray
from onnx import NodeProto, TensorProto, helper

from tests.policy.models import model_of, node, save
from viatool.errors import EnclosureError
from viatool.policy import Policy, load_policy
from viatool.policy.network import Activation
from viatool.taylor import reach

Floats = NDArray[np.float64]
ONE = {"one": np.float32(1.0)}
LEVELS = (ort.GraphOptimizationLevel.ORT_ENABLE_ALL, ort.GraphOptimizationLevel.ORT_DISABLE_ALL)

RATIO = [node("Exp", ["x"], ["e"]), node("Add", ["e", "one"], ["p"]), node("Div", ["e", "p"], ["y"])]
MIRRORED = [
    node("Neg", ["x"], ["n"]),
    node("Exp", ["n"], ["e"]),
    node("Sub", ["one", "e"], ["a"]),
    node("Add", ["e", "one"], ["p"]),
    node("Div", ["a", "p"], ["y"]),
]
TANH = [
    node("Neg", ["x"], ["n"]),
    node("Exp", ["x"], ["e"]),
    node("Exp", ["n"], ["f"]),
    node("Sub", ["e", "f"], ["a"]),
    node("Add", ["e", "f"], ["b"]),
    node("Div", ["a", "b"], ["y"]),
]
SHIFTED = [
    node("ReduceMax", ["x"], ["m"], axes=[1], keepdims=1),
    node("Sub", ["x", "m"], ["z"]),
    node("Exp", ["z"], ["e"]),
    node("ReduceSum", ["e", "axis"], ["s"], keepdims=1),
]
SOFTMAX = [*SHIFTED, node("Div", ["e", "s"], ["y"])]
LOG_SOFTMAX = [*SHIFTED, node("Log", ["s"], ["l"]), node("Sub", ["z", "l"], ["y"])]
RAW_SOFTMAX = [
    node("Exp", ["x"], ["e"]),
    node("ReduceSum", ["e", "axis"], ["s"], keepdims=1),
    node("Div", ["e", "s"], ["y"]),
]
AXIS = {"axis": np.array([1])}
RMS = [
    node("Mul", ["x", "x"], ["q"]),
    node("ReduceMean", ["q"], ["m"], axes=[1], keepdims=1),
    node("Add", ["m", "tiny"], ["v"]),
    node("Sqrt", ["v"], ["r"]),
    node("Div", ["x", "r"], ["y"]),
]
LAYER = [node("LayerNormalization", ["x", "scale", "shift"], ["y"], axis=-1)]


def load(folder: Path, nodes: Sequence[NodeProto], constants: dict[str, object], size: int = 4) -> Policy:
    return load_policy(save(model_of(nodes, constants, shape=("N", size)), folder))


def program(path: Path, points: Floats) -> list[Floats]:
    """Run both levels of optimisation on float32 observations."""
    found = []
    for level in LEVELS:
        options = ort.SessionOptions()
        options.graph_optimization_level = level
        session = ort.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        found.append(np.asarray(session.run(None, {"x": points.astype(np.float32)})[0], dtype=np.float64))
    return found


def attacked(centre: Floats, eps: float, seed: int = 0) -> Floats:
    """Return float32 observations of a box: corners, random ones, and neighbours in the last place."""
    rng = np.random.default_rng(seed)
    offset = rng.uniform(-1, 1, (400, centre.size))
    offset[::2] = np.sign(offset[::2])
    points = (centre + eps * offset).astype(np.float32)
    points = np.concatenate(
        [points, np.nextafter(points, np.float32(np.inf)), np.nextafter(points, np.float32(-np.inf))]
    )
    inside = (np.abs(points.astype(np.float64) - centre) <= eps).all(axis=1)
    return points[inside].astype(np.float64)


@pytest.mark.parametrize("eps", [0.0, 0.01, 0.5, 3.0])
@pytest.mark.parametrize("scale", [0.5, 8.0, 60.0])
@pytest.mark.parametrize(
    ("nodes", "constants", "lowest", "highest"),
    [
        (RATIO, ONE, 0.0, 1.0),
        (MIRRORED, ONE, -1.0, 1.0),
        (TANH, {}, -1.0, 1.0),
        (SOFTMAX, AXIS, 0.0, 1.0),
        (RAW_SOFTMAX, AXIS, 0.0, 1.0),
        (LOG_SOFTMAX, AXIS, -np.inf, 0.0),
    ],
    ids=["ratio", "mirrored", "tanh", "softmax", "raw softmax", "log softmax"],
)
def test_quotients_of_exponentials_hold_the_program_and_keep_to_their_range(
    nodes: Sequence[NodeProto], constants: dict[str, object], lowest: float, highest: float, scale: float,
    eps: float, tmp_path: Path,
) -> None:  # fmt: skip
    policy = load(tmp_path, nodes, constants)
    centre = scale * np.random.default_rng(1).uniform(-1, 1, 4)
    bounds = reach(policy, centre[None], eps)
    spare = 1e-4 if np.isfinite(lowest) else 1e-4 * (1 + 4 * scale)
    assert bounds.lower.min() >= lowest - spare
    assert bounds.upper.max() <= highest + spare
    points = attacked(centre, eps)
    for actions in program(
        policy.path, points if eps else centre.astype(np.float32)[None].astype(np.float64)
    ):
        assert (actions >= bounds.lower - (0 if eps else 1e-5)).all()
        assert (actions <= bounds.upper + (0 if eps else 1e-5)).all()


@pytest.mark.parametrize(
    ("nodes", "constants", "centre"),
    [
        (RATIO, ONE, 95.0),
        (MIRRORED, ONE, -95.0),
        (TANH, {}, 95.0),
        (TANH, {}, -95.0),
        (RAW_SOFTMAX, AXIS, 95.0),
        (RAW_SOFTMAX, AXIS, -110.0),
    ],
)
def test_where_the_program_gives_no_number_the_box_is_refused_by_name(
    nodes: Sequence[NodeProto], constants: dict[str, object], centre: float, tmp_path: Path
) -> None:
    policy = load(tmp_path, nodes, constants)
    observation = np.full((1, 4), centre)
    assert np.isnan(program(policy.path, observation)[1]).any()
    with pytest.raises(EnclosureError, match=r"node '\w+' \((Div|Exp)\)"):
        reach(policy, observation, 0.1)
    reach(policy, observation, 0.1, arithmetic="real")


def test_a_softmax_from_parts_is_as_tight_as_the_operator(tmp_path: Path) -> None:
    parts = load(tmp_path, SOFTMAX, AXIS)
    whole = load(tmp_path, [node("Softmax", ["x"], ["y"], axis=1)], {})
    centre = np.random.default_rng(2).uniform(-10, 10, (5, 4))
    found, expected = (reach(policy, centre, 0.1, arithmetic="real") for policy in (parts, whole))
    assert found.width == pytest.approx(expected.width, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("eps", [0.1, 10.0, 1000.0])
@pytest.mark.parametrize(
    ("nodes", "constants"),
    [
        (RMS, {"tiny": np.float32(1e-5)}),
        (LAYER, {"scale": np.ones(4, np.float32), "shift": np.zeros(4, np.float32)}),
    ],
    ids=["rms from parts", "layer"],
)
def test_a_normalisation_is_at_most_the_root_of_how_many_it_normalises(
    nodes: Sequence[NodeProto], constants: dict[str, object], eps: float, tmp_path: Path
) -> None:
    policy = load(tmp_path, nodes, constants)
    centre = np.array([0.5, -1.0, 2.0, 0.25])
    bounds = reach(policy, centre[None], eps, arithmetic="real")
    assert bounds.upper.max() <= 2.0 + 1e-5
    assert bounds.lower.min() >= -2.0 - 1e-5
    exact = policy.network(attacked(centre, eps))
    assert (exact >= bounds.lower - 1e-12).all()
    assert (exact <= bounds.upper + 1e-12).all()


def test_what_is_known_of_a_value_does_not_cut_the_rounding_of_the_program(tmp_path: Path) -> None:
    """One value alone is 1 after its normalisation, but a program may give a little more."""
    policy = load(tmp_path, RMS, {"tiny": np.float32(1e-12)}, size=1)
    assert any(isinstance(n, Activation) and n.function.name == "Known" for n in policy.network.nodes)
    bounds = reach(policy, np.array([[3.0]]), 0.5)
    assert bounds.upper[0, 0] > 1.0 + 2.0**-20 + 2.0**-24


def test_the_logarithm_of_a_large_sum_rounds_as_such(tmp_path: Path) -> None:
    twice = [
        node("Concat", ["x", "x"], ["z"], axis=1),
        node("Exp", ["z"], ["e"]),
        node("ReduceSum", ["e", "axis"], ["s"], keepdims=1),
        node("Log", ["s"], ["l"]),
        node("Sub", ["z", "l"], ["y"]),
    ]
    policy = load(tmp_path, twice, AXIS, size=1)
    points = np.linspace(80.0, 86.0, 2001)[:, None].astype(np.float32).astype(np.float64)
    reached = reach(policy, points, 0.0)
    for actions in program(policy.path, points):
        assert (actions >= reached.lower).all()
        assert (actions <= reached.upper).all()


@pytest.mark.parametrize(("shift", "lowest", "highest"), [(3e38, 80.0, 87.5), (1e-40, -103.0, -80.0)])
def test_a_quotient_of_exponentials_counts_overflow_and_small_numbers(
    tmp_path: Path, shift: float, lowest: float, highest: float
) -> None:
    nodes = [node("Exp", ["x"], ["e"]), node("Add", ["e", "b"], ["p"]), node("Div", ["e", "p"], ["y"])]
    policy = load_policy(
        save(model_of(nodes, {"b": np.float32(shift)}, shape=("N", 1)), tmp_path), self_check=False
    )
    points = np.linspace(lowest, highest, 101)[:, None].astype(np.float32).astype(np.float64)
    for point in points:
        try:
            reached = reach(policy, point[None], 0.0)
        except EnclosureError:
            continue
        for actions in program(policy.path, point[None]):
            assert reached.lower[0, 0] <= actions[0, 0] <= reached.upper[0, 0]


def test_observations_at_which_a_guarded_exponential_overflows_are_left_out_of_the_self_check(
    tmp_path: Path,
) -> None:
    nodes = [node("Mul", ["x", "steep"], ["z"]), *RATIO]
    nodes[1] = node("Exp", ["z"], ["e"])
    policy = load(tmp_path, nodes, {**ONE, "steep": np.float32(60.0)}, size=2)
    assert policy.self_check is not None
    assert policy.self_check.points > 0


def test_a_shifted_ratio_allows_for_an_exponential_as_bad_as_its_margin(tmp_path: Path) -> None:
    """Half-way up ``e / (1e7 + e)`` z is 16; the exponential may err by 16 times as many roundings."""
    nodes = [node("Exp", ["x"], ["e"]), node("Add", ["e", "many"], ["p"]), node("Div", ["e", "p"], ["y"])]
    policy = load(tmp_path, nodes, {"many": np.float32(1e7)}, size=1)
    exponent = float(np.float32(np.log(1e7)))
    exact = np.exp(exponent)
    bad = exact * (1 + 16 * 2.0**-24 * exponent)
    strayed = bad / (1e7 + bad) - exact / (1e7 + exact)
    assert reach(policy, np.array([[exponent]]), 0.0).deviation[0, 0] >= strayed


MOVED = {
    "by a constant": [node("Sub", ["x", "m"], ["d"]), node("Add", ["d", "b"], ["z"])],
    "by a temperature": [node("Sub", ["x", "m"], ["d"]), node("Div", ["d", "t"], ["z"])],
    "by both": [
        node("Sub", ["x", "m"], ["d"]),
        node("Mul", ["d", "t"], ["s"]),
        node("Add", ["s", "b"], ["z"]),
    ],
}


def moved(kind: str, *, logarithm: bool = False) -> list[NodeProto]:
    """Return a softmax from its parts, or its logarithm, whose exponents are moved after the largest is subtracted."""
    total = [node("Exp", ["z"], ["e"]), node("ReduceSum", ["e", "axis"], ["q"], keepdims=1)]
    end = (
        [node("Log", ["q"], ["l"]), node("Sub", ["z", "l"], ["y"])]
        if logarithm
        else [node("Div", ["e", "q"], ["y"])]
    )
    return [SHIFTED[0], *MOVED[kind], *total, *end]


@pytest.mark.parametrize("logarithm", [False, True], ids=["softmax", "logarithm"])
@pytest.mark.parametrize("kind", MOVED)
@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_exponents_that_are_moved_from_the_largest_need_no_guard(
    dtype: type[np.floating], kind: str, logarithm: bool, tmp_path: Path
) -> None:
    """Without one, float16 is not refused where some exponentials vanish."""
    constants = {"b": np.array([0.5, -1.0, 0.25, 2.0], dtype), "t": np.array([0.75], dtype), **AXIS}
    nodes = moved(kind, logarithm=logarithm)
    read = {name for call in nodes for name in call.input}
    element = helper.np_dtype_to_tensor_dtype(np.dtype(dtype))
    model = model_of(nodes, {k: v for k, v in constants.items() if k in read}, shape=("N", 4), dtype=element)
    policy = load_policy(save(model, tmp_path))
    centre = np.array([30.0, 2.0, -1.0, 29.0])
    bounds = reach(policy, centre[None], 0.5)
    points = attacked(centre, 0.5).astype(dtype).astype(np.float64)
    points = points[(np.abs(points - centre) <= 0.5).all(axis=1)]
    for level in ("none", "default"):
        actions = policy.runtime.at(level).rows(points)
        assert (actions >= bounds.lower).all()
        assert (actions <= bounds.upper).all()


@pytest.mark.parametrize("logarithm", [False, True], ids=["softmax", "logarithm"])
def test_a_moved_softmax_allows_for_exponentials_as_bad_as_their_margin(
    logarithm: bool, tmp_path: Path
) -> None:
    """Moved by 4.75, exponentials may err by 76 roundings, one up and the other down."""
    shift = np.full(2, 4.75, np.float32)
    policy = load(tmp_path, moved("by a constant", logarithm=logarithm), {"b": shift, **AXIS}, size=2)
    error = 76 * 2.0**-24
    program = np.log(0.5 / (1 - error)) if logarithm else (1 + error) / ((1 + error) + (1 - error))
    strayed = abs(program - (np.log(0.5) if logarithm else 0.5))
    assert reach(policy, np.zeros((1, 2)), 0.0).deviation[0, 0] >= strayed


def test_a_moved_softmax_allows_for_exponentials_that_are_flushed_to_zero(tmp_path: Path) -> None:
    count = 48
    constants = {"b": np.full(count, -4.0, np.float16), **AXIS}
    model = model_of(moved("by a constant"), constants, shape=("N", count), dtype=TensorProto.FLOAT16)
    policy = load_policy(save(model, tmp_path))
    observation = np.array([[0.0] + [-5.7109375] * (count - 1)])
    assert np.exp(-9.7109375) < 2.0**-14  # the smallest normal number of float16
    exact = 1 / (1 + (count - 1) * np.exp(-5.7109375))
    assert reach(policy, observation, 0.0).deviation[0, 0] >= 1 - exact


def cast(source: str, target: str, to: int) -> NodeProto:
    return node("Cast", [source], [target], to=to)


HALF, SINGLE = TensorProto.FLOAT16, TensorProto.FLOAT
CAST_SUM = [
    cast("e", "e32", SINGLE),
    node("ReduceSum", ["e32", "axis"], ["s32"], keepdims=1),
    cast("s32", "s", HALF),
]
CAST_LARGEST = [
    cast("x", "x32", SINGLE),
    node("ReduceMax", ["x32"], ["m32"], axes=[1], keepdims=1),
    cast("m32", "m", HALF),
]
IN_PARTS = {
    "softmax": [node("Exp", ["z"], ["e"]), *CAST_SUM, node("Div", ["e", "s"], ["y"])],
    "logarithm": [
        node("Exp", ["z"], ["e"]),
        *CAST_SUM,
        node("Log", ["s"], ["l"]),
        node("Sub", ["z", "l"], ["y"]),
    ],
}


@pytest.mark.parametrize("end", IN_PARTS.values(), ids=IN_PARTS)
def test_a_softmax_in_float16_that_adds_up_in_float32_is_read_as_one(
    end: list[NodeProto], tmp_path: Path
) -> None:
    """As torch exports it; the largest and the sum are cast to and fro."""
    nodes = [*CAST_LARGEST, node("Sub", ["x", "m"], ["z"]), *end]
    policy = load_policy(save(model_of(nodes, AXIS, shape=("N", 4), dtype=HALF), tmp_path))
    assert not any(isinstance(n, Activation) and n.function.name == "Guard" for n in policy.network.nodes)
    centre = np.array([12.0, 2.0, -1.0, 11.5])
    bounds = reach(policy, centre[None], 1.0)
    points = attacked(centre, 1.0).astype(np.float16).astype(np.float64)
    points = points[(np.abs(points - centre) <= 1.0).all(axis=1)]
    for level in ("none", "default"):
        actions = policy.runtime.at(level).rows(points)
        assert (actions >= bounds.lower).all()
        assert (actions <= bounds.upper).all()


def test_a_largest_that_was_rounded_is_none(tmp_path: Path) -> None:
    """Less a largest number in float16, those of float32 may be above 0, and their exponentials above 1."""
    rounded = [SHIFTED[0], cast("m", "m16", HALF), cast("m16", "c", SINGLE), node("Sub", ["x", "c"], ["z"])]
    policy = load(tmp_path, [*rounded, *SOFTMAX[2:]], AXIS)
    assert any(isinstance(n, Activation) and n.function.name == "Guard" for n in policy.network.nodes)
