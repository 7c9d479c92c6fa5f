"""How far a program may stray from the exact network: the errors of its nodes, carried to the actions.

Each node errs by itself (`rounding.own_error`) and passes on the errors that reach it. The difference of program and
network at a node is a linear form of the errors before it, up to what the slopes vary over the box. It is bounded in
two ways by the same rules: cheaply by norms alone, which multiply as ``|W|`` layer by layer, and, where that says too
little beside the width of the actions, with one symbol for each error, so that errors cancel as the network cancels
them and shrink as it contracts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from viatool.arrays import Booleans, Floats, Hull, Indices
from viatool.errors import EnclosureError
from viatool.policy.activations import ActivationFunction
from viatool.policy.network import (
    Activation,
    Affine,
    Cast,
    Input,
    Maximum,
    Minimum,
    Network,
    Node,
    Precision,
    Product,
)
from viatool.rounding import ENGINE_ROUNDOFF, LARGEST, SLIGHTLY_MORE, UNIT_ROUNDOFF
from viatool.taylor.curve import curve_of
from viatool.taylor.forms import Diagonal, Form, fold_symbols, join_forms
from viatool.taylor.head import split_head
from viatool.taylor.interval import step_down, step_up
from viatool.taylor.kernel import kernel_of
from viatool.taylor.propagation import interval_image
from viatool.taylor.rounding import affine_size, floors_of, gamma, magnitude, own_error

_WORTH = 2.0**-5
"""Share of an action's width up to which a deviation is not worth symbols."""

_ROUNDINGS_WORTH = 32.0
"""Roundings of an action, or of 1, up to which a deviation is not worth symbols: two millionths in float32."""

_FRESH = 0.9
"""Share of a deviation that is no error carried on, from which symbols for those that are are not worth it."""

_UNKNOWN = (
    "nothing is known of what the program's rounding does to an action",
    "make eps smaller, or check the weights and the units of the observation",
)

_FLOATS_TOGETHER = 2**22
"""Floats in the symbols of one node, over the states that are looked at together."""

_LEAST_STATES, _MOST_FLOATS = 8, 2**24
"""States that are looked at together in any case, so that weights are read once for all; and floats up to which."""


@dataclass(frozen=True, eq=False)
class Deviation:
    """What a program has at a node of N neurons less what the exact network has there, at the same observation.

    Parameters
    ----------
    symbols : mapping
        Node to the forms in the errors that arose at it, each error in [-1, 1].
    rest : ndarray
        ``(B, N)``, not negative: half-width of what no symbol stands for.
    bound : ndarray
        ``(B, N)``: of the absolute value of all of it.
    """

    symbols: Mapping[int, Form]
    rest: Floats
    bound: Floats = field(init=False)

    def __post_init__(self) -> None:
        bound = self.rest
        for form in self.symbols.values():
            bound = bound + form.norms()
        if self.symbols:
            bound = bound * SLIGHTLY_MORE
        object.__setattr__(self, "bound", np.where(np.isnan(bound), np.inf, bound))

    def scaled(self, factor: Floats) -> dict[int, Form]:
        """Return the symbols' forms times a factor for each neuron, (B, N)."""
        return {key: form.scaled(factor) for key, form in self.symbols.items()}


Finer = Callable[[Indices], Sequence[Hull]]
"""Gives tighter hulls of every node for some of the states."""


@dataclass(frozen=True, eq=False)
class ProgramEnclosure:
    """What a floating-point evaluation may make of A actions over B boxes.

    Parameters
    ----------
    lower, upper : ndarray
        ``(B, A)``: bounds of what it has.
    deviation : ndarray
        ``(B, A)``: ``|program(x) - network(x)| <= deviation`` for every x of the box.
    """

    lower: Floats
    upper: Floats
    deviation: Floats

    def around(self, lower: Floats, upper: Floats) -> Hull:
        """Return bounds of both the program and the network, which has these, (B, A) each."""
        return np.minimum(self.lower, lower), np.maximum(self.upper, upper)

    def meet(self, rows: Indices, other: ProgramEnclosure) -> None:
        """Tighten some of the states by what else is known of them."""
        self.lower[rows] = np.fmax(self.lower[rows], other.lower)
        self.upper[rows] = np.fmin(self.upper[rows], other.upper)
        self.deviation[rows] = np.fmin(self.deviation[rows], other.deviation)


def runtime_deviation(network: Network, hulls: Sequence[Hull], *, engine: bool = False) -> Floats:
    """Bound how far a floating-point evaluation strays from the exact network, (B, A), see `enclose_program`."""
    return enclose_program(network, hulls, engine=engine).deviation


def enclose_program(
    network: Network, hulls: Sequence[Hull], *, engine: bool = False, finer: Finer | None = None
) -> ProgramEnclosure:
    """Bound what a floating-point evaluation makes of any observation of a box, which it first rounds to its input.

    Parameters
    ----------
    network : Network
        N nodes, A actions.
    hulls : sequence of (lower, upper)
        For each node, bounds ``(B, size)`` of its exact value over the box.
    engine : bool
        Account for `Network.__call__` in float64 on exact inputs, in place of the deployed program.
    finer : callable, optional
        Is asked for tighter hulls of the states whose deviation still is large, since errors grow with what the slopes
        vary over the hulls.

    Returns
    -------
    ProgramEnclosure
        Bounds within `deviation` of the hulls of the actions.

    Raises
    ------
    EnclosureError
        If the program may overflow or divide by zero somewhere in the box.

    Notes
    -----
    **Sound:** yes, given the activation errors of `rounding.activation_error`. With program values ``x + d`` a node of
    slope s between x and x + d passes on ``s d``, s within the slopes of the box widened by the bound of d (mean value
    theorem); its middle scales the forms of d, its half-width times the bound of d joins the node's own error. What is
    done to each value alone, such as a squash at the end, is bounded by its range as well: where it is flat the program
    cannot stray far.
    """
    found, may_cancel, problem = _by_norms(network, hulls, engine=engine)
    for given, gains in (
        (lambda rows: [(lower[rows], upper[rows]) for lower, upper in hulls], may_cancel),
        (finer, True),
    ):
        if given is None:
            continue
        worth = _is_worth_more(network, hulls[-1], found.deviation) & gains
        for rows in _blocks(network, np.flatnonzero(worth)) if worth.any() else ():
            by_symbols = _Carried(network, given(rows), engine=engine, with_symbols=True)
            found.meet(rows, by_symbols.to_actions())
            problem = by_symbols.problem or problem
    if not np.isfinite(found.deviation).all():
        raise EnclosureError(*(problem or _UNKNOWN))
    return found


def _by_norms(
    network: Network, hulls: Sequence[Hull], *, engine: bool
) -> tuple[ProgramEnclosure, Booleans, tuple[str, str] | None]:
    """Return what norms alone say, in which states symbols may say more, and why nothing is known of some."""
    kernel = None if engine else kernel_of(network, len(split_head(network)[0].nodes))
    last = _last_sum(network)
    known = kernel.deviation(hulls, last) if kernel else None
    if known is not None:
        lower, upper, deviation, own, bound = known
        return ProgramEnclosure(lower, upper, deviation), _may_cancel(last, own, bound), None
    by_norms = _Carried(network, hulls, engine=engine, with_symbols=False)
    return by_norms.to_actions(), by_norms.may_cancel(), by_norms.problem


def _may_cancel(last: int | None, own: Floats, bound: Floats) -> Booleans:
    """Tell in which states symbols may make a deviation less by more than a tenth, (B,).

    They do not where nearly all of it is what the last sum errs by itself: no error before it matters then.
    """
    if last is None:
        return np.ones(len(bound), dtype=bool)
    return np.asarray(~(own >= _FRESH * bound).all(axis=1))


def _is_worth_more(network: Network, actions: Hull, deviation: Floats) -> Booleans:
    unit = UNIT_ROUNDOFF[network.nodes[-1].precision]
    roundings = _ROUNDINGS_WORTH * unit * np.maximum(1.0, magnitude(actions))
    negligible = _WORTH * (actions[1] - actions[0]) + roundings
    return np.asarray(~(deviation <= negligible).all(axis=1))


@lru_cache(maxsize=64)
def _last_sum(network: Network) -> int | None:
    """Return the node behind which each number goes on by itself, if that is a weighted sum."""
    index = len(network.nodes) - 1
    while True:
        match node := network.nodes[index]:
            case Activation() | Cast():
                index = node.source
            case Affine():
                if not node.is_elementwise:
                    return index if node.sources else None
                (index,) = node.sources
            case Input() | Product() | Maximum() | Minimum():
                return None


def _blocks(network: Network, rows: Indices) -> list[Indices]:
    """Cut states into blocks whose symbols fit the memory that is meant for them."""
    each = sum(node.size for node in network.nodes) * max(node.size for node in network.nodes)
    step = max(1, _FLOATS_TOGETHER // each, min(_LEAST_STATES, _MOST_FLOATS // each))
    return [rows[start : start + step] for start in range(0, rows.size, step)]


class _Carried:
    """One pass over a network that carries the errors of its nodes."""

    def __init__(self, network: Network, hulls: Sequence[Hull], *, engine: bool, with_symbols: bool) -> None:
        self._network = network
        self._hulls = hulls
        self._engine = engine
        self._with_symbols = with_symbols
        self._deviations: list[Deviation] = []
        self._own: list[Floats] = []
        self._floors = floors_of(network, "float64" if engine else None)
        self._images: list[Hull | None] = []
        self._programs: list[Hull] = []
        self._overflows = np.zeros(hulls[0][0].shape[0], dtype=bool)
        self.problem: tuple[str, str] | None = None
        self._readers = np.zeros(len(network.nodes), dtype=int)
        for node in network.nodes:
            np.add.at(self._readers, list(node.sources), 1)

    def to_actions(self) -> ProgramEnclosure:
        """Return what is known of the last node; nothing where norms alone leave the range of a precision."""
        with np.errstate(invalid="ignore", over="ignore"):  # what is not finite is infinite
            for index, node in enumerate(self._network.nodes):
                self._enter(index, node)
        unknown = np.where(self._overflows[:, None], np.inf, 0.0)
        (lower, upper), deviation = self._programs[-1], self._deviations[-1].bound
        return ProgramEnclosure(lower - unknown, upper + unknown, deviation + unknown)

    def may_cancel(self) -> Booleans:
        """Tell in which states symbols may make a deviation less by more than a tenth, (B,)."""
        last = _last_sum(self._network)
        place = -1 if last is None else last
        return _may_cancel(last, self._own[place], self._deviations[place].bound)

    def _enter(self, index: int, node: Node) -> None:
        self._images.append(self._image(node))
        symbols, rest = self._passed_on(index, node)
        own = self._own_error(index, node)
        self._own.append(own)
        self._deviations.append(self._with_own(index, symbols, rest, own))
        self._programs.append(self._program_at(index, own))

    def _with_own(self, index: int, symbols: dict[int, Form], rest: Floats, own: Floats) -> Deviation:
        """Add to what is passed on what a node errs by itself."""
        rest = (rest + own) * SLIGHTLY_MORE
        if self._with_symbols and rest.any():
            symbols, rest = {**symbols, index: _one_for_each(rest)}, np.zeros_like(rest)
        deviation = Deviation(symbols, rest)
        self._check_overflow(index, magnitude(self._hulls[index]) + deviation.bound)
        return deviation

    def _precision(self, node: Node) -> Precision:
        return "float64" if self._engine else node.precision

    def _passed_on(self, index: int, node: Node) -> tuple[dict[int, Form], Floats]:
        """Return what a node makes of the deviations of what it reads: forms and rest."""
        match node:
            case Input():
                return {}, np.zeros_like(self._hulls[0][0])
            case Affine():
                return self._through_affine(node)
            case Activation():
                return self._through_activation(index, node)
            case Product():
                return self._through_product(node)
            case Maximum() | Minimum():
                return self._through_maximum(node)
            case Cast():
                source = self._deviations[node.source]
                return dict(source.symbols), source.rest

    def _through_affine(self, node: Affine) -> tuple[dict[int, Form], Floats]:
        symbols: dict[int, Form] = {}
        rest = np.zeros((self._hulls[0][0].shape[0], node.size))
        carried = rest
        for source, weight, absolute in zip(node.sources, node.weights, node.absolute_weights, strict=True):
            kept, spare = fold_symbols(self._deviations[source].symbols, self._deviations[source].rest)
            rest = rest + spare @ absolute.T
            for key, form in kept.items():
                symbols[key] = join_forms(symbols.get(key), form.mapped(weight, absolute))
            if kept:
                carried = carried + self._deviations[source].bound @ absolute.T
        terms = 2 + sum(weight.shape[1] for weight in node.weights)
        return symbols, rest + gamma(terms, ENGINE_ROUNDOFF) * carried

    def _through_activation(self, index: int, node: Activation) -> tuple[dict[int, Form], Floats]:
        curve, source = curve_of(node.function), self._deviations[node.source]
        if node.function.passes_on:
            return dict(source.symbols), source.rest
        symbols, rest = self._without_private(node.source)
        lower, upper = self._programs[node.source]
        slope = curve.range(lower, upper, 1)
        middle, half = slope.lower / 2 + slope.upper / 2, slope.upper / 2 - slope.lower / 2
        unbounded = ~(np.isfinite(middle) & np.isfinite(half))
        middle, half = np.where(unbounded, 0.0, middle), np.where(unbounded, np.inf, half)
        varied = (half + 8 * ENGINE_ROUNDOFF * np.abs(middle)) * source.bound
        varied = np.where(source.bound == 0, 0.0, varied)
        image = self._images[index]
        assert image is not None
        span = image[1] - image[0]
        self._check_defined(index, node.function, (lower, upper), span)
        jumps = span < np.abs(middle) * source.bound + varied  # over a jump only the range helps
        middle, varied = np.where(jumps, 0.0, middle), np.where(jumps, span, varied)
        return {key: form.scaled(middle) for key, form in symbols.items()}, np.abs(middle) * rest + varied

    def _through_product(self, node: Product) -> tuple[dict[int, Form], Floats]:
        symbols: dict[int, Form] = {}
        left, right = self._deviations[node.left], self._deviations[node.right]
        rest = left.bound * right.bound
        for moved, factor in ((left, self._hulls[node.right]), (right, self._hulls[node.left])):
            middle, half = factor[0] / 2 + factor[1] / 2, factor[1] / 2 - factor[0] / 2
            rest = rest + np.abs(middle) * moved.rest
            rest = rest + (half + 8 * ENGINE_ROUNDOFF * magnitude(factor)) * moved.bound
            for key, form in moved.scaled(middle).items():
                symbols[key] = join_forms(symbols.get(key), form)
        return symbols, rest

    def _through_maximum(self, node: Maximum | Minimum) -> tuple[dict[int, Form], Floats]:
        """Pass on the deviation of the larger side, or one between those of both where either may be larger."""
        left, right = self._deviations[node.left], self._deviations[node.right]
        if not self._with_symbols:
            return {}, np.maximum(left.bound, right.bound)
        ours, theirs = self._programs[node.left], self._programs[node.right]
        larger, smaller = ours[0] >= theirs[1], theirs[0] >= ours[1]
        left_wins, right_wins = (larger, smaller) if isinstance(node, Maximum) else (smaller, larger)
        share = np.where(left_wins, 1.0, np.where(right_wins, 0.0, 0.5))
        symbols: dict[int, Form] = {}
        for side, part in ((left, share), (right, 1 - share)):
            for key, form in side.scaled(part).items():
                symbols[key] = join_forms(symbols.get(key), form)
        rest = share * left.rest + (1 - share) * right.rest
        rest = rest + 4 * ENGINE_ROUNDOFF * (left.bound + right.bound)  # of the joined forms
        undecided = np.where(share == 0.5, (left.bound + right.bound) / 2, 0.0)
        return symbols, rest + undecided

    def _without_private(self, source: int) -> tuple[Mapping[int, Form], Floats]:
        """Return a deviation with what arose at a node that nobody else reads taken for rest: one symbol fewer."""
        deviation = self._deviations[source]
        own = deviation.symbols.get(source)
        if own is None or self._readers[source] > 1:
            return deviation.symbols, deviation.rest
        others = {key: form for key, form in deviation.symbols.items() if key != source}
        return others, deviation.rest + own.norms()

    def _own_error(self, index: int, node: Node) -> Floats:
        precision = self._precision(node)
        if isinstance(node, Input) and self._engine:  # on exact inputs
            return np.zeros_like(self._hulls[0][0])
        if isinstance(node, Activation) and node.function.passes_on and self._engine:  # nor is it guarded
            return np.zeros_like(self._hulls[index][0])
        if isinstance(node, Cast) and (
            UNIT_ROUNDOFF[precision] <= UNIT_ROUNDOFF[self._precision(self._network.nodes[node.source])]
        ):
            return np.zeros_like(self._hulls[index][0])
        sources = [self._programs[source] for source in node.sources]
        value = self._exact_on_program(index, node, sources)
        self._check_overflow(index, value)
        return own_error(node, precision, sources, value)

    def _exact_on_program(self, index: int, node: Node, sources: Sequence[Hull]) -> Floats:
        """Bound the absolute value of a node that is evaluated exactly on what the program has before it.

        Of an affine node every partial sum is meant, which may be larger than the result.
        """
        match node:
            case Input():
                return magnitude(self._hulls[index])
            case Affine():
                return np.broadcast_to(affine_size(node, sources), self._hulls[index][0].shape)
            case Activation():
                image = self._images[index]
                assert image is not None
                return magnitude(image)
            case Product():
                return magnitude(sources[0]) * magnitude(sources[1])
            case Maximum() | Minimum():
                return np.maximum(magnitude(sources[0]), magnitude(sources[1]))
            case Cast():
                return magnitude(sources[0])

    def _image(self, node: Node) -> Hull | None:
        """Bound a node that is evaluated exactly on what the program has before it, if it acts on single values."""
        match node:
            case Activation() if node.function.passes_on:
                return self._programs[node.source]
            case Activation():
                value = curve_of(node.function).range(*self._programs[node.source])
                return value.lower, value.upper
            case Affine() if node.is_elementwise:
                return interval_image([self._programs[node.sources[0]]], node)
            case Input() | Affine() | Product() | Maximum() | Minimum() | Cast():
                return None

    def _program_at(self, index: int, own: Floats) -> Hull:
        """Bound what the program has at a node: near the network's value, and near what it makes of its sources."""
        (lower, upper), bound, image = self._hulls[index], self._deviations[index].bound, self._images[index]
        lower, upper = np.fmax(step_down(lower - bound), self._floors[index]), step_up(upper + bound)
        if image is None:
            return lower, upper
        return np.fmax(lower, step_down(image[0] - own)), np.fmin(upper, step_up(image[1] + own))

    def _check_overflow(self, index: int, size: Floats) -> None:
        precision = self._precision(self._network.nodes[index])
        fits = size < LARGEST[precision]
        if fits.all():
            return
        self._overflows |= ~fits.all(axis=1)
        self._note(
            index,
            f"an intermediate value may leave the range of {precision} (up to {float(np.max(size)):.3g})",
            "make eps smaller, or check the weights and the units of the observation",
        )

    def _check_defined(self, index: int, function: ActivationFunction, argument: Hull, span: Floats) -> None:
        """Note where rounding takes an argument out of the domain that the exact one keeps to."""
        left = ~np.isfinite(span) & np.isfinite(argument[0]) & np.isfinite(argument[1])
        if not left.any():
            return
        self._overflows |= left.any(axis=1)
        row, neuron = np.argwhere(left)[0]
        lower, upper = (float(end[row, neuron]) for end in argument)
        self._note(
            index,
            f"with the program's rounding the argument of {function.name} may be "
            f"anything in [{lower:.3g}, {upper:.3g}], where it is not defined or not finite",
            "make eps smaller; if it is a normalisation, let the model subtract a constant near the mean from what "
            "is normalised, which changes nothing but its rounding",
        )

    def _note(self, index: int, problem: str, hint: str) -> None:
        """Keep the first reason why nothing is known of some states."""
        narrow = any(node.precision in ("bfloat16", "float16") for node in self._network.nodes)
        remedy = f"export the policy in float32, or {hint}" if narrow else hint
        self.problem = self.problem or (f"{self._network.label(index)}: {problem}", remedy)


def _one_for_each(error: Floats) -> Diagonal:
    return Diagonal(np.broadcast_to(np.arange(error.shape[1]), error.shape), error, error.shape[1])
