"""Every rule that widens a bound is needed: with the rule taken away, a containment check of the tests fails.

A mutant is the source of one function of the engine with one piece of text replaced. When a rule is rewritten,
its mutant has to be rewritten with it.
"""

from __future__ import annotations

import importlib
import inspect
import sys
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.strategies import ACTIVATIONS
from tests.taylor.containment import escape_of_exact_values, escape_of_gradients, escape_of_programs
from tests.taylor.softmax_program import escape_of_softmax
from tests.taylor.squash_program import escape_of_squash
from tests.taylor.test_backwards import wrong_lines, wrong_shifts, wrong_sums, wrong_underflow
from tests.taylor.test_curve import wrong_approximations, wrong_ranges
from tests.taylor.test_interval import wrong_functions, wrong_operations
from tests.taylor.test_wide import wrong_foldings
from tests.taylor.worst_program import escape_of_worst_program
from viatool.errors import BoundsError, EnclosureError
from viatool.policy.activations import ActivationFunction, activation
from viatool.policy.network import (
    Activation,
    Affine,
    Cast,
    Input,
    Maximum,
    Minimum,
    Network,
    Node,
    Product,
)
from viatool.taylor.curve import curve_of
from viatool.taylor.interval import ENCLOSED_FUNCTIONS

Floats = NDArray[np.float64]
Check = Callable[[], float]


@dataclass(frozen=True)
class Mutant:
    """A function with the rule `old` replaced by `new`; `check` answers how much is wrong."""

    check: Check
    function: str  # module.function or module.Class.method
    old: str
    new: str

    def __str__(self) -> str:
        return f"{self.function}: {' '.join(self.old.split())[:60]}"


@contextmanager
def mutated(mutant: Mutant) -> Iterator[None]:
    """Put the mutant in the place of its function, wherever the engine has imported it."""
    module_name, *path = mutant.function.split(".")
    room = "policy" if module_name == "kernel_error" else "taylor"
    module = importlib.import_module(f"viatool.{room}.{module_name}")
    owner: Any = module
    for name in path[:-1]:
        owner = getattr(owner, name)
    original = getattr(owner, path[-1])
    source = textwrap.dedent(inspect.getsource(original))
    assert source.count(mutant.old) == 1, f"{mutant}: the rule is no longer there; rewrite its mutant"
    source = "from __future__ import annotations\n" + source.replace(mutant.old, mutant.new)
    scratch: dict[str, Any] = {}
    exec(source, vars(module), scratch)
    with pytest.MonkeyPatch.context() as patch:
        for place in [owner] if path[:-1] else _importers(original, path[-1]):
            patch.setattr(place, path[-1], scratch[path[-1]])
        for name, function in ENCLOSED_FUNCTIONS.items():
            if function is original:
                patch.setitem(ENCLOSED_FUNCTIONS, name, scratch[path[-1]])
        curve_of.cache_clear()
        yield
    curve_of.cache_clear()


def _importers(original: Any, name: str) -> list[Any]:
    modules = [module for key, module in sys.modules.items() if key.startswith("viatool.taylor")]
    return [module for module in modules if getattr(module, name, None) is original]


# --- checks, the same as in the other tests --------------------------------------------------------------


def real(network: Network, centre: Any, eps: Any, **options: Any) -> Check:
    """Check exact values against bounds for real arithmetic; a refusal is no escape."""
    states = np.atleast_2d(np.array(centre, dtype=np.float64))
    radii = np.broadcast_to(np.asarray(eps, dtype=np.float64), states.shape)

    def check() -> float:
        try:
            return escape_of_exact_values(network, states, radii, **{"refine": "none", **options})
        except EnclosureError:
            return 0.0

    return check


def deployed(network: Network, centre: Any, eps: float = 0.0) -> Check:
    """Check float32 programs against bounds for float32 arithmetic."""
    states = np.atleast_2d(np.array(centre, dtype=np.float64))
    radii = np.full(states.shape, eps)
    return lambda: escape_of_programs(network, states, radii, samples=8, refine="none")


def strayed(network: Network, lower: float, upper: float, with_symbols: bool) -> Check:
    """Check the worst program over a box against the deviation that is carried with or without symbols."""
    return lambda: escape_of_worst_program(network, lower, upper, with_symbols=with_symbols)


def gradients(network: Network, centre: Any, eps: float) -> Check:
    """Check true gradients against bounds of gradients."""
    states = np.atleast_2d(np.array(centre, dtype=np.float64))
    return lambda: escape_of_gradients(network, states - eps, states + eps)


def ranges(name: str, order: int) -> Check:
    """Check ranges of a derivative of an activation."""
    return lambda: float(len(wrong_ranges(_function(name), order)))


def approximations(name: str, rule: str, degree: int) -> Check:
    """Check the error of approximations of an activation."""
    return lambda: float(len(wrong_approximations(_function(name), rule, degree)))


def operations(name: str) -> Check:
    """Check interval arithmetic against fractions."""
    return lambda: float(len(wrong_operations(name)))


def functions(name: str) -> Check:
    """Check the functions of interval arithmetic against high precision."""
    return lambda: float(len(wrong_functions(name, share=1.0)))


def _function(name: str) -> ActivationFunction:
    return next(function for function in ACTIVATIONS if function.name == name)


# --- networks, each built so that one rule decides -------------------------------------------------------

RELU, TANH = activation("Relu"), activation("Tanh")
SQUARE, CUBE = activation("Pow", exponent=2.0), activation("Pow", exponent=3.0)
BOTH = [[1.0], [-1.0]]
"""A last layer that is no increasing function of one action, so that the squash before it is approximated."""
RANDOM = np.random.default_rng(17)


def normal(*shape: int) -> Floats:
    return RANDOM.normal(size=shape).astype(np.float32).astype(np.float64)


def affine(source: int, weight: Any, bias: Any = None) -> Affine:
    matrix = np.array(weight, dtype=np.float64)
    offset = np.zeros(matrix.shape[0]) if bias is None else np.array(bias, dtype=np.float64)
    return Affine((source,), (matrix,), offset)


def chain(inputs: int, *layers: Any) -> Network:
    """Stack activations, weights, and pairs of weights and biases."""
    nodes: list[Node] = [Input(inputs)]
    for layer in layers:
        last = len(nodes) - 1
        if isinstance(layer, ActivationFunction):
            nodes.append(Activation(last, layer, nodes[last].size))
        else:
            nodes.append(affine(last, *layer) if isinstance(layer, tuple) else affine(last, layer))
    return Network(tuple(nodes))


def cancelling(rows: int) -> Floats:
    """Return weights of 1e8 that cancel to 1e-7, (rows, 64)."""
    half = 1e8 * RANDOM.normal(size=(rows, 32))
    return np.concatenate([half, -half * (1 + 1e-15 * RANDOM.normal(size=half.shape))], axis=1)


def scaled_by(factors: list[float]) -> Network:
    """Multiply the input by constants, one after the other."""
    nodes: list[Node] = [Input(1)]
    last = 0
    for factor in np.float32(factors).astype(np.float64):
        nodes += [Affine((), (), factor[None]), Product(last, len(nodes), 1)]
        last = len(nodes) - 1
    return Network(tuple(nodes))


def repeated_squares(times: int) -> Network:
    return Network((Input(1), *(Product(k, k, 1) for k in range(times)), affine(times, BOTH)))


def extremum(kind: type[Maximum] | type[Minimum]) -> Network:
    return Network((Input(2), affine(0, [[1.0, 0.0]]), affine(0, [[-1.0, 1.0]]), kind(1, 2, 1)))


CANCELLING = cancelling(1)
ONES = np.ones((4, 64)) * 2.0 ** np.arange(4)[:, None]
LEANING = np.concatenate([[[1.0]], CANCELLING], axis=1)
LEANING_STATES = np.concatenate([np.zeros((4, 1)), ONES], axis=1)
CURVED = chain(2, normal(3, 2), TANH, (normal(2, 3), normal(2)), TANH, normal(1, 2))
SQUARES = chain(2, (normal(2, 2), [0.25, -0.5]), SQUARE, (normal(2, 2), [0.5, 0.125]), SQUARE, normal(1, 2))
SADDLE = chain(2, ([[1.0, 1.0], [1.0, -1.0]], [0.1, 0.2]), SQUARE, [[-1.0, 0.5], [0.5, 1.0]])
CUBIC = chain(2, ([[1.0, 1.0], [1.0, -1.0]], [0.1, 0.2]), CUBE, [[-1.0, 0.5], [0.5, 1.0]])
CUBED_SQUARED = chain(1, CUBE, ([[1.0]], [0.5]), SQUARE, BOTH)
CUBED_GATE = Network(
    (
        Input(2),
        Activation(0, CUBE, 2),
        affine(1, [[1.0, 0.0]], [0.5]),
        affine(0, [[0.0, 1.0]], [0.5]),
        Product(2, 3, 1),
        affine(4, BOTH),
    )
)
ABSORBED = np.full((1, 64), 2.0**-25)
ABSORBED[0, 0] = 1.0
TRIPLE = Network(
    (Input(2), affine(0, [[1.0, 0.5]]), affine(0, [[0.5, -1.0]]), Product(1, 2, 1), Product(3, 1, 1))
)
GATE = Network(
    (Input(2), affine(0, [[1.0, 0.0]]), affine(0, [[0.0, 1.0]]), Product(1, 2, 1), affine(3, BOTH))
)
SOFTPLUS_CLIFF = Network(
    (
        Input(2),
        affine(0, [[1.0, -1.0]]),
        Activation(1, activation("SoftplusThreshold", threshold=20.0), 1),
        Affine((2, 0), (np.ones((1, 1)), np.array([[1.0, 2.0]])), np.zeros(1)),
    )
)


def in_halves(*nodes: Node) -> Network:
    return Network(tuple(replace(node, precision="float16") for node in nodes))


def half_chain(*layers: Any) -> Network:
    return in_halves(*chain(40, *layers).nodes)


MEAN = np.full((1, 40), 2.0**-5)
LEVEL = MEAN * ([1.0] * 20 + [-1.0] * 20)
"""Weights that cancel where all inputs are equal, with a large error."""
SUMS = half_chain((normal(3, 40), normal(3)), normal(1, 3))
STEEP = half_chain(MEAN, TANH, [[1.0]])
TURNED = half_chain(MEAN, [[-1.0]], TANH, [[1.0]])
SCALED = in_halves(*chain(1, ([[0.75]], [0.125])).nodes)
SHRUNK = half_chain(MEAN, [[0.75]])
MEASURED = half_chain(MEAN, activation("Abs"))
CROSSING = half_chain(LEVEL, TANH, [[1.0]])
STEPS = half_chain(LEVEL, activation("Sign"), [[1.0]])
ASLEEP = half_chain((LEVEL, [-0.01]), RELU, [[1.0]])
SQUARED = in_halves(Input(40), affine(0, MEAN), affine(0, MEAN), Product(1, 2, 1))
SQUARED_LEVEL = in_halves(Input(40), affine(0, LEVEL), affine(0, LEVEL), Product(1, 2, 1))
EITHER = in_halves(Input(40), affine(0, MEAN), affine(0, [[1.25] + [0.0] * 39]), Maximum(1, 2, 1))
CARRYING = [
    Mutant(strayed(network, *box, with_symbols), f"deviation._Carried.{method}", old, new)
    for network, box, with_symbols, method, old, new in (
        (SUMS, (1.0, 1.0), False, "_through_affine", "rest + spare @ absolute.T", "rest"),
        (
            SUMS,
            (1.0, 1.0),
            True,
            "_through_affine",
            "form.mapped(weight, absolute)",
            "form.mapped(0 * weight, 0 * absolute)",
        ),
        (SUMS, (1.0, 1.0), True, "_with_own", "(rest + own) * SLIGHTLY_MORE", "rest * 1.0"),
        (STEEP, (0.5, 0.5), False, "_through_activation", "np.abs(middle) * rest + varied", "0 * middle"),
        (TURNED, (0.5, 0.5), True, "_through_activation", "form.scaled(middle)", "form.scaled(0 * middle)"),
        (STEEP, (0.5, 0.5), True, "_without_private", "deviation.rest + own.norms()", "deviation.rest"),
        (CROSSING, (0.5, 4.0), True, "_through_activation", "(half + 8 *", "(0 * half + 8 *"),
        (STEPS, (0.5, 1.0), True, "_through_activation", "np.where(jumps, span, varied)", "0 * span"),
        (
            ASLEEP,
            (1.0, 1.0),
            True,
            "_program_at",
            "step_down(lower - bound), self._floors[index]), step_up(upper + bound)",
            "lower, self._floors[index]), upper",
        ),
        (SCALED, (1.0, 1.0), True, "_program_at", "step_up(image[1] + own)", "image[1]"),
        (SCALED, (1.0, 1.0), False, "_program_at", "step_down(image[0] - own)", "image[0]"),
        (SHRUNK, (1.0, 1.0), True, "_image", "[self._programs[node.sources[0]]]", "[self._hulls[1]]"),
        (
            MEASURED,
            (1.0, 1.0),
            True,
            "_image",
            "(*self._programs[node.source])",
            "(*self._hulls[node.source])",
        ),
        (SQUARED, (1.0, 1.0), True, "_through_product", "moved.scaled(middle)", "moved.scaled(0 * middle)"),
        (SQUARED, (1.0, 1.0), False, "_through_product", "np.abs(middle) * moved.rest", "0 * middle"),
        (SQUARED, (0.25, 4.0), True, "_through_product", "(half + 8 *", "(0 * half + 8 *"),
        (
            SQUARED_LEVEL,
            (1.0, 1.0),
            True,
            "_through_product",
            "rest = left.bound * right.bound",
            "rest = 0 * left.bound",
        ),
        (EITHER, (1.0, 1.0), True, "_through_maximum", "(left.bound + right.bound) / 2", "0 * left.bound"),
        (EITHER, (1.0, 1.0), True, "_through_maximum", "side.scaled(part)", "side.scaled(0 * part)"),
        (EITHER, (1.0, 1.0), False, "_through_maximum", "np.maximum(left", "np.minimum(left"),
    )
]

MUTANTS = [
    # back-substitution
    Mutant(
        wrong_sums,
        "backwards._bound_from_above",
        "2 * gamma(_roundings(network), ENGINE_ROUNDOFF) * size",
        "0 * size",
    ),
    Mutant(wrong_underflow, "backwards._bound_from_above", "+ lost[:, None]", ""),
    Mutant(wrong_shifts, "backwards._bound_from_above", "total + _weighed(part, shift)", "total"),
    Mutant(
        wrong_lines,
        "backwards.lines_around",
        "(residual.upper, -residual.lower)",
        "(residual.upper, -residual.upper)",
    ),
    Mutant(
        wrong_foldings,
        "forms.fold_symbols",
        "(remainder + norms[key]) * SLIGHTLY_MORE",
        "remainder",
    ),
    # float64 rounding of the engine
    Mutant(
        real(chain(64, CANCELLING), ONES, 0.0),
        "model.affine_image",
        "gamma(terms, ENGINE_ROUNDOFF) * size",
        "0 * size",
    ),
    Mutant(
        real(chain(64, CANCELLING), ONES, 0.0),
        "propagation.interval_image",
        "2 * gamma(terms, ENGINE_ROUNDOFF) * size",
        "0 * size",
    ),
    Mutant(
        real(chain(65, LEANING), LEANING_STATES, [0.5] + [0.0] * 64, refine="monotone"),
        "refinement.bound_at_points",
        "(rounding * np.abs(seed)).sum(axis=1)",
        "0",
    ),
    Mutant(
        real(chain(64, CANCELLING, BOTH), ONES, 0.0),
        "model.affine_image",
        "remainder + spare @ absolute.T",
        "remainder",
    ),
    Mutant(
        real(chain(64, CANCELLING, TANH, BOTH), ONES, 0.0),
        "model.polynomial_image",
        "np.abs(slope) * model.remainder + gamma",
        "0 * model.remainder + gamma",
    ),
    Mutant(
        real(repeated_squares(9), 1 + 0.01 * normal(8, 1), 0.0),
        "model.product_image",
        "gamma(terms, ENGINE_ROUNDOFF) * size",
        "0 * size",
    ),
    # one pass of order 1
    Mutant(
        real(CURVED, normal(3, 2), 0.5),
        "propagation._enclose_activation",
        "polynomial.error.reshape(shape)",
        "0 * polynomial.error.reshape(shape)",
    ),
    Mutant(
        real(chain(1, RELU, [[0.01]], TANH, BOTH), [0.0], 1.0),
        "model.polynomial_image",
        "{key: form.scaled(slope) for key, form in model.symbols.items()}",
        "{}",
    ),
    Mutant(
        real(chain(1, RELU, BOTH), [500.0], 500.0000001),
        "model._fresh_symbols",
        "(remainder + error) * SLIGHTLY_MORE",
        "remainder",
    ),
    Mutant(
        real(CURVED, normal(3, 2), 0.5),
        "propagation.interval_image",
        "reach = reach + spread",
        "reach = reach",
    ),
    Mutant(
        real(GATE, [0.0, 0.0], 0.5),
        "model.product_image",
        "error = spread_left * spread_right",
        "error = 0 * spread_left",
    ),
    # orders above 1
    Mutant(
        real(SQUARES, normal(3, 2), 0.5, order=2),
        "model._higher_powers",
        "power_overflow * polynomial_norm + overflow",
        "0 * overflow",
    ),
    Mutant(
        real(CUBED_SQUARED, [0.0], 1.0, order=2),
        "model._higher_powers",
        "np.maximum(whole - polynomial_norm**degree, 0)",
        "0 * whole",
    ),
    Mutant(
        real(TRIPLE, [0.1, 0.2], 0.5, order=2),
        "model._higher_product",
        "(overflow + mixed)",
        "(0 * overflow + mixed)",
    ),
    Mutant(
        real(CUBED_GATE, [0.0, 0.0], 1.0, order=2),
        "model._higher_product",
        "(overflow + mixed)",
        "(overflow + 0 * mixed)",
    ),
    Mutant(
        real(SADDLE, 0.1 * normal(6, 2), 0.5, order=2),
        "polynomial_range.range_of_quadratics",
        "np.where(inside & (square > 0), vertex, ends_low)",
        "ends_low",
    ),
    Mutant(
        real(SADDLE, 0.1 * normal(6, 2), 0.5, order=2),
        "polynomial_range._corner_maximum",
        "np.abs(linear) >= spread * SLIGHTLY_MORE",
        "np.abs(linear) >= 0",
    ),
    Mutant(
        real(SADDLE, 0.1 * normal(6, 2), 0.5, order=2),
        "polynomial_range.range_by_terms",
        "np.abs(higher[:, ~even & ~pure]).sum(axis=1)",
        "0 * linear.sum(axis=1)",
    ),
    Mutant(
        real(CUBIC, 0.1 * normal(6, 2), 0.5, order=3),
        "polynomial_range.range_of_univariates",
        "upper + (np.abs(coefficient) if degree % 2 else np.maximum(coefficient, 0))",
        "upper",
    ),
    Mutant(
        real(CUBIC, 0.1 * normal(6, 2), 0.5, order=3),
        "polynomial_range.range_of_univariates",
        "control.min(axis=0)",
        "control.max(axis=0)",
    ),
    Mutant(
        real(CUBIC, 0.1 * normal(6, 2), 0.5, order=3),
        "basis.Basis.truncated_product",
        "factor * right[:, : target.size, :]",
        "factor * 0",
    ),
    # approximations of activations
    Mutant(
        approximations("Relu", "chebyshev", 1),
        "approximation._bent_lines",
        "step_up(radius) + rounding",
        "radius",
    ),
    Mutant(
        approximations("Relu", "chebyshev", 1),
        "approximation.residual_range",
        "*(np.clip(edge, lower, upper) for edge in curve.breaks)",
        "",
    ),
    Mutant(
        approximations("LeakyRelu", "chebyshev", 1),
        "approximation._straight_lines",
        "8 * LAST_PLACE",
        "0 * LAST_PLACE",
    ),
    Mutant(
        approximations("Softplus", "chebyshev", 1),
        "approximation._residual_on_cell",
        "low = np.minimum(low, _tangent_bound(curve, left, right, slope, 1))",
        "pass",
    ),
    Mutant(
        approximations("Relu", "chebyshev", 2),
        "approximation._grid_error",
        "step_up(between, 8)",
        "0 * between",
    ),
    Mutant(
        approximations("Sigmoid", "chebyshev", 2),
        "approximation._interpolation_error",
        "remainder + lebesgue",
        "0 * remainder + lebesgue",
    ),
    # curves
    Mutant(
        ranges("Selu", 1), "curve.Curve.enclose", "(x >= left) & (x <= right)", "(x >= left) & (x < right)"
    ),
    Mutant(ranges("Abs", 1), "curve.CurveCells.locate", "last += upper >= edge", "last += upper > edge"),
    Mutant(ranges("Abs", 0), "straight_lines.StraightLines.range", "self.breaks", "()"),
    Mutant(
        ranges("LeakyRelu", 0), "straight_lines.StraightLines.enclose", "step_down(lower, 2) - slack", "lower"
    ),
    Mutant(
        ranges("HardSwish", 1),
        "curve._hull_table",
        "low, high = min(low, nodes.lower[last - 1]), max(high, nodes.upper[last - 1])",
        "pass",
    ),
    Mutant(
        ranges("Relu", 1),
        "curve._hull_table",
        "kinds[last] in (UNKNOWN, CONSTANT)",
        "kinds[last] in (UNKNOWN,)",
    ),
    Mutant(
        ranges("HardSwish", 2), "curve._checked", "interval_of(float(result))", "Interval(result, result)"
    ),
    Mutant(
        real(SOFTPLUS_CLIFF, [9.99999999975, -9.99999999975], 1e-9, refine="monotone"),
        "curve.Curve._jumps",
        "(nodes == edge) & ~meet",
        "(nodes == edge) & False",
    ),
    # interval arithmetic
    Mutant(
        operations("*"), "interval._outward", "step_down(lower, ulps), step_up(upper, ulps)", "lower, upper"
    ),
    Mutant(operations("/"), "interval._outward", "step_up(upper, ulps)", "upper"),
    Mutant(functions("NormalCdf"), "interval._normal_cdf", "2 * np.clip(end, -40.0, 0.0) ** 2", "0"),
    # derivatives and collapse
    Mutant(
        gradients(chain(4, cancelling(4).T[:, :4], np.ones((1, 64))), normal(2, 4), 0.0),
        "derivatives._mapped",
        "ENGINE_ROUNDOFF) * (np.abs(centre) + radius)",
        "ENGINE_ROUNDOFF) * 0 * radius",
    ),
    Mutant(
        gradients(CURVED, normal(3, 2), 0.3),
        "derivatives._scaled",
        "half = np.maximum(upper - middle, middle - lower)",
        "half = 0 * middle",
    ),
    Mutant(
        gradients(CURVED, normal(3, 2), 0.3),
        "derivatives._mapped",
        "(radius + rounding) @ absolute",
        "rounding @ absolute",
    ),
    Mutant(
        real(CURVED, normal(6, 2), 0.6, refine="monotone"),
        "refinement.collapse_monotone",
        "low >= 0, (high <= 0) & (low < 0)",
        "low + high >= 0, low + high < 0",
    ),
    Mutant(
        real(extremum(Minimum), [0.0, 5.0], 0.1, refine="monotone"),
        "derivatives._bounds_pulled_back",
        "left, right = right, left",
        "pass",
    ),
    Mutant(
        real(extremum(Maximum), [0.0, 0.05], 0.1, refine="monotone"),
        "derivatives._bounds_pulled_back",
        "np.where(left[1] <= right[0], 0.0, 1.0)",
        "wins",
    ),
    # the deployed program
    Mutant(
        deployed(chain(1, [[1.0]]), [[0.1], [1 / 3]]),
        "rounding.own_error",
        "case Input():\n            return unit * value + tiny",
        "case Input():\n            return 0 * value",
    ),
    Mutant(
        deployed(chain(64, ABSORBED), np.ones((1, 64))),
        "rounding.own_error",
        "factor * value",
        "0 * value",
    ),
    Mutant(
        deployed(chain(1, ([[1.0]], [1e6])), [[0.5], [0.25 + 2.0**-20]]),
        "rounding.affine_size",
        "size = node.bias_magnitude",
        "size = 0 * node.bias",
    ),
    Mutant(
        deployed(chain(64, ABSORBED), np.ones((1, 64))),
        "rounding.affine_size",
        "size + magnitude(source) @ merged.T",
        "size",
    ),
    Mutant(
        deployed(chain(2, normal(3, 2) * 1e-20), normal(5, 2) * 2.0**-64),
        "rounding.own_error",
        "2 * terms * tiny",
        "0",
    ),
    Mutant(
        deployed(chain(1, TANH), [[2.0], [0.75], [4.0]]),
        "rounding.own_error",
        "activation_error(node.function, precision, sources[0], value)",
        "0 * value",
    ),
    Mutant(
        deployed(chain(1, [[1.0]], activation("Elu", alpha=1e5)), [[-3.3e-3]]),
        "kernel_error.KernelError.scale",
        "amplitude(parameters) *",
        "",
    ),
    Mutant(
        deployed(chain(1, [[1.0]], activation("Reciprocal")), [[1e3 + 1.0], [3e3 + 1.0]]),
        "rounding.activation_error",
        "own = units *",
        "own = 0 * units *",
    ),
    Mutant(
        deployed(scaled_by([1.1, 1.3, 1.7, 1.9]), normal(24, 1)),
        "rounding.own_error",
        "case Product():\n            return unit * value + tiny",
        "case Product():\n            return 0 * value",
    ),
    Mutant(
        deployed(Network((Input(1), Cast(0, 1, "float16"))), [[0.1], [1 / 3]]),
        "rounding.own_error",
        "case Cast():\n            return unit * value + tiny",
        "case Cast():\n            return 0 * value",
    ),
    *CARRYING,
    Mutant(
        partial(escape_of_squash, "Tanh"),
        "kernel_error.BoundedError.scale",
        "return np.maximum(1.0, value)",
        "return value",
    ),
    Mutant(
        lambda: escape_of_softmax("Softmax"),
        "kernel_error.SoftmaxError.scale",
        "+ 17.0 * np.minimum(value * argument, 0.4)",
        "",
    ),
    *(
        Mutant(
            partial(escape_of_softmax, name),
            "kernel_error.SoftmaxError.of_terms",
            rule,
            "",
        )
        for name, rule in (
            ("Softmax", "+ (EXPONENTIAL_UNITS + 1) * math.log(terms)"),
            ("LogSoftmax", "+ (EXPONENTIAL_UNITS + 1) * math.log(terms)"),
            ("LogSoftmax", "+ terms"),
        )
    ),
    Mutant(
        partial(escape_of_softmax, "LogSoftmax"),
        "kernel_error.LogSoftmaxError.scale",
        "+ 2 * value",
        "",
    ),
]


@pytest.mark.parametrize("mutant", MUTANTS, ids=str)
@pytest.mark.usefixtures("numpy_engine")
def test_the_check_passes_with_the_rule_and_fails_without(mutant: Mutant) -> None:
    assert mutant.check() <= 0
    with mutated(mutant), np.errstate(all="ignore"), suppress(BoundsError):  # which the engine itself notices
        assert mutant.check() > 0
