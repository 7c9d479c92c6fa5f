"""The roundings of folded constants against the worst that another runtime may do, in exact arithmetic.

Another runtime's constants are off by as many roundings as they carry, all in the worst directions, and it rounds its
own result once more, away. Fractions say how far that is from the constant that was folded here.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.policy.models import model_of, node, save
from viatool.policy import load_policy
from viatool.policy.assembly import Refusal
from viatool.policy.folded_rounding import cast_constant
from viatool.policy.folding import fold
from viatool.policy.graph import live, read_graph
from viatool.policy.network import Affine
from viatool.policy.tensors import Constant
from viatool.taylor.deviation import runtime_deviation

UNIT = Fraction(1, 2**24)
Exact = Callable[..., Fraction]

BINARY: dict[str, Exact] = {
    "Add": lambda a, b: a + b,
    "Sub": lambda a, b: a - b,
    "Mul": lambda a, b: a * b,
    "Div": lambda a, b: a / b,
    "PRelu": lambda a, b: a if a > 0 else a * b,
}


def folded(operator: str, *constants: Constant, inputs: int | None = None, **attributes: Any) -> Constant:
    names = [f"c{index}" for index in range(len(constants))]
    call = node(operator, names, ["y"], **attributes)
    arrays = {name: constant.array for name, constant in zip(names, constants, strict=True)}
    model = model_of([call], arrays, opset=18)
    del model.graph.input[:]
    (graph_node,) = live(read_graph(model, Path()), "y").nodes
    (found,) = fold(graph_node, list(constants), dict(graph_node.attributes))
    return found


def constant(value: float, roundings: int = 0) -> Constant:
    return Constant(np.array([value], dtype=np.float32), "float32", roundings)


def exactly(value: Constant) -> Fraction:
    return Fraction(float(value.array.ravel()[0]))


def allowed(found: Constant) -> float:
    """Return how many roundings of itself the first element may be off."""
    magnitude = np.abs(found.array) if found.magnitude is None else found.magnitude
    return float(found.roundings * magnitude.ravel()[0] / abs(found.array.ravel()[0]))


def strayed(value: Fraction, roundings: int, sign: int) -> Fraction:
    """Return what so many roundings make of a number, all in one direction."""
    return value * (1 + sign * UNIT) ** roundings


def worst(exact: Exact, constants: list[Constant], result: Fraction) -> Fraction:
    """Return how many roundings of itself the folded result is from that of another runtime, to first order."""
    most = Fraction(0)
    for signs in product((-1, 1), repeat=len(constants)):
        given = [strayed(exactly(c), c.roundings, s) for c, s in zip(constants, signs, strict=True)]
        for last in (-1, 1):
            other = strayed(exact(*given), 1, last)
            most = max(most, abs(other - exact(*map(exactly, constants))) / abs(result) / UNIT)
    return most


@pytest.mark.parametrize("roundings", [(3, 0), (0, 5), (3, 5), (64, 1), (1, 200)], ids=str)
@pytest.mark.parametrize(("a", "b"), [(1.5, 0.75), (-3.0, 0.4375), (1.0, -0.8125)])
@pytest.mark.parametrize("operator", BINARY)
def test_the_roundings_of_both_sides_and_one_more_are_counted(
    operator: str, a: float, b: float, roundings: tuple[int, int]
) -> None:
    constants = [constant(a, roundings[0]), constant(b, roundings[1])]
    found = folded(operator, *constants)
    needed = worst(BINARY[operator], constants, exactly(found))
    if operator == "PRelu" and a > 0:  # the slope is not used
        needed = min(needed, Fraction(roundings[0] + 1))
    assert allowed(found) >= needed * Fraction(1 - 2**-12), (allowed(found), float(needed))


@pytest.mark.parametrize("operator", ["LeakyRelu", "Sqrt"])
def test_the_roundings_of_the_argument_and_one_more_are_counted(operator: str) -> None:
    given = constant(-2.5 if operator == "LeakyRelu" else 2.25, 7)
    assert folded(operator, given).roundings >= 8


@pytest.mark.parametrize("roundings", [(2, 9), (9, 2)], ids=str)
@pytest.mark.parametrize("operator", ["Max", "Min", "Concat", "Where"])
def test_what_moves_values_keeps_the_larger_of_their_roundings(
    operator: str, roundings: tuple[int, int]
) -> None:
    pair = [constant(1.5, roundings[0]), constant(1.5, roundings[1])]
    if operator == "Where":
        pair.insert(0, Constant(np.array([True]), "bool"))
    attributes = {"axis": 0} if operator == "Concat" else {}
    assert folded(operator, *pair, **attributes).roundings == 9


@pytest.mark.parametrize("operator", ["Log", "Tan", "Acos", "Celu", "Hardmax", "Mod"])
def test_what_cannot_count_the_roundings_of_its_inputs_refuses_them(operator: str) -> None:
    given = Constant(np.full((2, 2), 0.5, dtype=np.float32), "float32", 1)
    others = [constant(0.3)] if operator == "Mod" else []
    attributes = {"fmod": 1} if operator == "Mod" else {}
    with pytest.raises(Refusal, match="no bound"):
        folded(operator, given, *others, **attributes)


SEVERAL: dict[str, Exact] = {
    "ReduceSum": lambda *a: sum(a, Fraction(0)),
    "ReduceMean": lambda *a: sum(a, Fraction(0)) / len(a),
    "ReduceL1": lambda *a: sum(map(abs, a), Fraction(0)),
    "ReduceSumSquare": lambda *a: sum((x * x for x in a), Fraction(0)),
    "ReduceProd": lambda *a: a[0] * a[1] * a[2],
    "ReduceMax": max,
    "ReduceMin": min,
}


@pytest.mark.parametrize("roundings", [1, 7, 300])
@pytest.mark.parametrize("operator", SEVERAL)
def test_a_reduction_counts_the_roundings_of_what_it_adds(operator: str, roundings: int) -> None:
    numbers = [1.5, -0.75, 1.4375]
    found = folded(operator, Constant(np.array(numbers, dtype=np.float32), "float32", roundings), keepdims=0)
    needed = worst(SEVERAL[operator], [constant(number, roundings) for number in numbers], exactly(found))
    assert allowed(found) >= (needed - 1) * Fraction(1 - 2**-12)


def test_a_matrix_product_counts_the_roundings_of_both_matrices() -> None:
    left = Constant(np.array([[1.0, 1.0]], dtype=np.float32), "float32", 5)
    right = Constant(np.array([[1.0], [-0.875]], dtype=np.float32), "float32", 9)
    assert allowed(folded("MatMul", left, right)) >= (5 + 9) * 1.875 / 0.125


@pytest.mark.parametrize("value", [-3.0, -0.2, 0.6, 4.0])
@pytest.mark.parametrize(
    ("operator", "exact"),
    [
        ("Exp", np.exp),
        ("Tanh", np.tanh),
        ("Sigmoid", lambda x: 1 / (1 + np.exp(-x))),
        ("Cos", np.cos),
        ("Reciprocal", lambda x: 1 / x),
    ],
)
def test_a_function_counts_how_far_it_moves_with_its_argument(
    operator: str, exact: Callable[[Any], Any], value: float
) -> None:
    roundings = 2**16
    moved = [exact(value * (1 + sign * roundings * 2.0**-24)) - exact(value) for sign in (-1, 1)]
    found = folded(operator, constant(value, roundings))
    assert allowed(found) * (1 + 2**-6) >= max(map(abs, moved)) / abs(exact(value)) * 2**24


@pytest.mark.parametrize(("value", "step"), [(2.5, True), (3.0, False)])
def test_steps_of_inexact_constants_are_taken_where_they_are_the_same(value: float, step: bool) -> None:
    given = constant(value, 4)
    if step:
        assert exactly(folded("Floor", given)) == 2
        assert cast_constant(given, "int64").array == 2
        assert not folded("Floor", given).roundings
    else:
        for make in (lambda: folded("Floor", given), lambda: cast_constant(given, "int64")):
            with pytest.raises(Refusal, match="no bound"):
                make()


def test_what_makes_truths_of_inexact_constants_refuses_them() -> None:
    with pytest.raises(Refusal, match="no bound"):
        folded("Greater", constant(1.0, 1), constant(2.0))


@pytest.mark.parametrize("value", [-8.0, -3.0, -0.01, 0.01, 0.7, 5.0])
@pytest.mark.parametrize(
    ("operator", "exact"),
    [
        ("Exp", np.exp),
        ("Tanh", np.tanh),
        ("Sigmoid", lambda x: 1 / (1 + np.exp(-x))),
        ("Softsign", lambda x: x / (1 + abs(x))),
        ("Sin", np.sin),
        ("Cos", np.cos),
        ("Atan", np.arctan),
        ("Softplus", lambda x: np.log1p(np.exp(x))),
    ],
)
def test_a_function_may_err_by_64_units_of_its_argument_and_its_value(
    operator: str, exact: Callable[[Any], Any], value: float
) -> None:
    result = abs(float(exact(np.float64(np.float32(value)))))
    size = max(1.0, abs(value)) * result if operator == "Exp" else max(1.0, abs(value), result)
    assert allowed(folded(operator, constant(value))) >= 63.9 * size / result


def test_an_element_that_is_not_finite_does_not_hide_the_errors_of_the_others() -> None:
    given = Constant(np.array([0.0, 3.0], dtype=np.float32), "float32")
    assert folded("Log", given).roundings >= 64


def absorbed(count: int) -> np.ndarray[Any, Any]:
    """Return numbers of which a program that adds one after the other keeps the first only."""
    return np.array([1.0] + [2.0**-24 * 0.99] * (count - 1), dtype=np.float32)


@pytest.mark.parametrize("count", [3, 40, 1000])
@pytest.mark.parametrize(
    "operator", ["ReduceSum", "ReduceMean", "ReduceL1", "ReduceSumSquare", "CumSum", "Sum"]
)
def test_a_sum_in_any_order_is_covered(operator: str, count: int) -> None:
    numbers = absorbed(count)
    if operator == "ReduceSumSquare":
        numbers = np.sqrt(numbers)
    given = Constant(numbers, "float32")
    if operator == "Sum":
        found = folded("Sum", *(Constant(number[None], "float32") for number in numbers[:40]))
        numbers = numbers[:40]
    elif operator == "CumSum":
        found = folded("CumSum", given, Constant(np.array(0, dtype=np.int64), "int64"))
    else:
        found = folded(operator, given, keepdims=0)
    terms = numbers**2 if operator == "ReduceSumSquare" else numbers
    total = np.float32(0.0)
    for number in terms:
        total = np.float32(total + number)
    exact = sum((Fraction(float(number)) for number in numbers), Fraction(0))
    if operator == "ReduceSumSquare":
        exact = sum((Fraction(float(number)) ** 2 for number in numbers), Fraction(0))
    lost = abs(exact - Fraction(float(total))) / exact / UNIT
    assert found.roundings >= lost + 1
    assert found.roundings >= len(numbers)


@pytest.mark.parametrize("inner", [3, 40, 1000])
def test_a_matrix_product_in_any_order_is_covered(inner: int) -> None:
    left = Constant(absorbed(inner)[None], "float32")
    right = Constant(np.ones((inner, 1), dtype=np.float32), "float32")
    assert folded("MatMul", left, right).roundings >= inner


def test_cancellation_in_a_sum_is_counted() -> None:
    given = Constant(np.array([1.0, 1.0, -1.9375], dtype=np.float32), "float32")
    assert allowed(folded("ReduceSum", given, keepdims=0)) >= 3 * 3.9375 / 0.0625


def test_a_softmax_counts_its_sum_as_well() -> None:
    given = Constant(np.zeros((1, 500), dtype=np.float32), "float32")
    single = Constant(np.zeros((1, 1), dtype=np.float32), "float32")
    value = np.log(500.0)
    assert folded("Softmax", given, axis=-1).roundings >= 64 * value + 500
    assert folded("Softmax", single, axis=-1).roundings >= 64 + 1


def test_a_cast_counts_in_the_roundings_of_its_type() -> None:
    given = constant(1.5, 4)
    assert 1 <= cast_constant(given, "float16").roundings <= 2
    assert cast_constant(given, "float32").roundings == 4
    assert cast_constant(given, "float64").roundings == 4 * 2**29
    assert cast_constant(constant(1.5), "float64").roundings == 0
    third = cast_constant(Constant(np.array([1 / 3]), "float64"), "float16")
    assert third.roundings == 1
    assert exactly(third) == Fraction(1 / 3), "a program may leave the cast out"


def test_a_sum_over_several_axes_has_as_many_terms_as_elements() -> None:
    given = Constant(np.ones((30, 20), dtype=np.float32), "float32")
    assert folded("ReduceSum", given, keepdims=0).roundings >= 600


@pytest.mark.parametrize(("operator", "value"), [("Cos", 1.0), ("Sigmoid", 0.5), ("Exp", 1.0)])
def test_a_function_may_err_at_zero_unless_its_value_is_zero(operator: str, value: float) -> None:
    assert allowed(folded(operator, constant(0.0))) >= 64 / value
    assert folded("Tanh", constant(0.0)).roundings == 0


FOLLOWED_BY = {
    "Mul": ([node("Mul", ["p", "c"], ["y"])], {"c": np.float32(1.7)}, 1),
    "Mul by a power": ([node("Exp", ["c"], ["e"]), node("Mul", ["p", "e"], ["y"])], {"c": np.float32(0.3)}, 65),
    "Div": ([node("Div", ["p", "c"], ["y"])], {"c": np.float32(1.7)}, 2),
    "BatchNormalization": (
        [node("BatchNormalization", ["p", "s", "b", "m", "v"], ["y"])],
        {name: np.full(3, value, dtype=np.float32) for name, value in zip("sbmv", (1.3, 0.2, 0.4, 0.7), strict=True)},
        1,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FOLLOWED_BY)
def test_a_matrix_product_counts_the_scaling_that_a_runtime_may_fold_into_its_weights(
    name: str, tmp_path: Path
) -> None:
    nodes, constants, roundings = FOLLOWED_BY[name]
    generator = np.random.default_rng(3)
    weight = generator.uniform(0.5, 1.0, (4, 3)).astype(np.float32)
    model = model_of([node("MatMul", ["x", "w"], ["p"]), *nodes], {"w": weight, **constants})
    policy = load_policy(save(model, tmp_path))
    products = [part for part in policy.network.nodes if isinstance(part, Affine)]
    assert products[0].roundings >= roundings
    # the program with the scaling folded, every rounding upwards: the bounds hold it
    observation = generator.uniform(0.5, 1.0, (1, 4)).astype(np.float32)
    (value,) = policy(observation)
    deviation = runtime_deviation(policy.network, [(v, v) for v in policy.network.values(observation)])
    folded_away = Fraction((1 + UNIT) ** (4 + roundings) - 1)
    assert (deviation[0] >= float(folded_away) * 0.9 * np.abs(value - _shift(name))).all()


def _shift(name: str) -> float:
    return 0.2 - 1.3 * 0.4 / np.sqrt(0.7 + 1e-5) if name == "BatchNormalization" else 0.0


@pytest.mark.parametrize(
    ("dtype", "large", "unit"), [("float16", 1024.0, 2.0**-11), ("bfloat16", 128.0, 2.0**-8)]
)
def test_what_is_left_of_a_sum_may_be_rounded_at_each_step_or_at_none(
    dtype: str, large: float, unit: float
) -> None:
    stored = np.float16 if dtype == "float16" else np.float32
    first, second = (Constant(np.array([value], dtype=stored), dtype) for value in (large, 0.25))
    rest = folded("Sub", folded("Add", first, second), first)
    assert rest.dtype == dtype
    assert rest.magnitude is not None
    assert exactly(rest) == Fraction(1, 4)
    assert rest.roundings * unit * rest.magnitude >= 0.25, "a program in half precision is left with nothing"


def test_a_product_below_the_normal_numbers_may_be_flushed_to_nothing() -> None:
    small = Constant(np.array([1.1e-4], dtype=np.float16), "float16")
    product = folded("Mul", small, small)
    assert product.magnitude is not None
    assert product.roundings * 2.0**-11 * product.magnitude >= product.array


def test_a_range_that_a_program_adds_up_step_by_step_counts_its_steps() -> None:
    start, limit, step = (
        Constant(np.array(value, dtype=np.float32), "float32") for value in (0.0, 10.0, 0.1)
    )
    found = folded("Range", start, limit, step)
    added = np.cumsum(np.full(found.array.size, np.float32(0.1)), dtype=np.float32) - np.float32(0.1)
    assert found.magnitude is not None
    assert (np.abs(added - found.array) <= found.roundings * 2.0**-24 * found.magnitude).all()
    assert folded("Range", start, limit, Constant(np.array(0.5, dtype=np.float32), "float32")).roundings == 0
