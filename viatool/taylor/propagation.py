"""The forward pass: an input box through the nodes of a network, as Taylor models and as plain hulls."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from viatool.arrays import Floats, Hull, Indices
from viatool.errors import EnclosureError
from viatool.policy.activations import ActivationFunction, activation
from viatool.policy.network import Activation, Affine, Cast, Input, Maximum, Minimum, Network, Node, Product
from viatool.rounding import ENGINE_ROUNDOFF, SLIGHTLY_MORE
from viatool.sets.bounds import require_ordered
from viatool.sets.chance import RowChance
from viatool.taylor.approximation import Approximation, approximate
from viatool.taylor.basis import Basis, monomial_basis
from viatool.taylor.curve import curve_of
from viatool.taylor.forms import Diagonal
from viatool.taylor.interval import step_down, step_up
from viatool.taylor.model import TaylorModel, affine_image, polynomial_image, product_image
from viatool.taylor.polynomial_range import range_by_corners, range_by_terms
from viatool.taylor.rounding import gamma


@dataclass(frozen=True, eq=False)
class Box:
    """Input boxes ``[lower, upper]``, (B, n) each.

    Raises
    ------
    BoundsError
        If an end is not a number, or a lower one is above its upper one: of an empty box everything would hold.
    """

    lower: Floats
    upper: Floats

    def __post_init__(self) -> None:
        require_ordered("inputs", self.lower, self.upper)

    @property
    def centre(self) -> Floats:
        """Return the middle of each box, (B, n)."""
        return self.lower / 2 + self.upper / 2

    @property
    def radius(self) -> Floats:
        """Return half-widths (B, n), rounded up so that centre +- radius covers the box; 0 where an input is fixed."""
        centre = self.centre
        radius = step_up(np.maximum(self.upper - centre, centre - self.lower))
        return np.where(self.lower == self.upper, 0.0, radius)

    def rows(self, which: Indices | slice) -> Box:
        """Return some of the boxes."""
        return Box(self.lower[which], self.upper[which])

    def nearest(self, points: Floats) -> Floats:
        """Return the points of the boxes that are nearest to given ones, (B, n)."""
        return np.clip(points, self.lower, self.upper)

    def corner(self, slope: Floats, point: Floats) -> Floats:
        """Return where a linear function of a slope (B, n) is the largest, (B, n); where it is flat, as a point."""
        return np.where(slope > 0, self.upper, np.where(slope < 0, self.lower, point))

    def random_corner(self, chance: RowChance) -> Floats:
        """Return a random corner of each box, (B, n)."""
        high = chance.random(self.lower.shape[1]) < 0.5
        return np.where(high, self.upper, self.lower)


@dataclass(frozen=True, eq=False)
class Enclosure:
    """What is known of one node: its Taylor model and its hull, either of which may be the tighter."""

    model: TaylorModel
    lower: Floats
    upper: Floats

    @property
    def hull(self) -> Hull:
        """Return lower and upper bounds, (B, N)."""
        return self.lower, self.upper

    def rows(self, which: Indices) -> Enclosure:
        """Return some of the states."""
        return Enclosure(self.model.rows(which), self.lower[which], self.upper[which])

    def met(self, hull: Hull) -> Enclosure:
        """Meet the hull with another one that holds as well; a bound that is not a number says nothing."""
        return Enclosure(self.model, np.fmax(self.lower, hull[0]), np.fmin(self.upper, hull[1]))


def propagate(
    network: Network,
    box: Box,
    *,
    order: int = 1,
    rule: Approximation = "chebyshev",
    limits: Mapping[int, Hull] | None = None,
    inputs: Enclosure | None = None,
    known: Sequence[Hull] | None = None,
    range_of: Callable[[TaylorModel], Hull] | None = None,
) -> list[Enclosure]:
    """Enclose every node of a network over input boxes.

    Parameters
    ----------
    network : Network
        n inputs, A outputs.
    box : Box
        B boxes.
    order : int
        Order k of the Taylor models.
    rule : str
        How activations are approximated.
    limits : mapping, optional
        Activation node to bounds (B, N) of its argument: only points of the box that keep to them are enclosed.
    inputs : Enclosure, optional
        What is known of the inputs besides the box, if they move together; of the given order.
    known : sequence of (lower, upper), optional
        Bounds of every node over the boxes, from a pass of another order: each hull is met with them, so that none
        comes out wider, and every activation is approximated where both passes allow its argument.
    range_of : callable, optional
        Another bound of the range of a model, over the inputs that count; the hull of every affine node is met with it.

    Returns
    -------
    list of Enclosure
        One for each node; the last is that of the actions. Meaningless for a box in which no point keeps to the limits.

    Raises
    ------
    EnclosureError
        If an activation has no finite enclosure.
    BoundsError
        If a hull is crossed although there are no limits.

    Notes
    -----
    **Sound:** yes, for the exact network; float64 rounding of the engine is in the remainders.
    """
    enclosures: list[Enclosure] = [] if inputs is None else [inputs]
    read = list(enclosures) if limits else enclosures  # what nodes after them read
    for index, node in enumerate(network.nodes[len(enclosures) :], start=len(enclosures)):
        try:
            if limits and index in limits:
                assert isinstance(node, Activation)
                argument = _limited(read[node.source], limits[index])
                enclosures.append(_enclose_activation(argument, node.function, index, order, rule))
            else:
                enclosures.append(_enclose(node, index, read, box, order, rule))
        except EnclosureError as error:
            raise EnclosureError(f"{network.label(index)}: {error.message}", error.hint) from error
        if known is not None:
            enclosures[-1] = enclosures[-1].met(known[index])
        if range_of is not None and isinstance(node, Affine):
            enclosures[-1] = enclosures[-1].met(range_of(enclosures[-1].model))
        if limits:
            read.append(_in_order(enclosures[-1]))
    if order > 1:
        last = enclosures[-1]
        enclosures[-1] = last.met(model_range(last.model, thorough=True))
    if not limits:  # else crossed hulls are how a box without a point shows
        for enclosure in enclosures:
            _require_no_crossing(enclosure)
    return enclosures


def analyse(network: Network) -> None:
    """Analyse all activations of a network, which takes longer than a pass and is done once in a process."""
    for node in network.nodes:
        if isinstance(node, Activation):
            curve = curve_of(node.function)
            curve.cells(0), curve.cells(1)


@lru_cache(maxsize=64)
def is_curved(network: Network) -> bool:
    """Tell whether a network is not piecewise linear, so that a model of order 2 sees more than one of order 1."""
    return any(
        isinstance(node, Product)
        or (isinstance(node, Activation) and not curve_of(node.function).cells(1).is_stepwise)
        for node in network.nodes
    )


def _require_no_crossing(enclosure: Enclosure) -> None:
    """Refuse a hull that holds nothing; one that is not a number says nothing, and nothing is concluded from it."""
    crossed = enclosure.lower > enclosure.upper
    if crossed.any():
        require_ordered("values of a node", enclosure.lower[crossed], enclosure.upper[crossed])


def _in_order(enclosure: Enclosure) -> Enclosure:
    """Return the same with crossed ends, as of a box in which no point keeps to its limits, the right way round."""
    lower, upper = enclosure.lower, enclosure.upper
    return Enclosure(enclosure.model, np.minimum(lower, upper), np.maximum(lower, upper))


def _limited(argument: Enclosure, limit: Hull) -> Enclosure:
    lower, upper = np.maximum(argument.lower, limit[0]), np.minimum(argument.upper, limit[1])
    empty = lower > upper
    return Enclosure(
        argument.model, np.where(empty, argument.lower, lower), np.where(empty, argument.upper, upper)
    )


def _enclose(
    node: Node, index: int, known: list[Enclosure], box: Box, order: int, rule: Approximation
) -> Enclosure:
    match node:
        case Input():
            return _enclose_input(box, order)
        case Affine():
            return _enclose_affine(node, known)
        case Activation():
            return _enclose_activation(known[node.source], node.function, index, order, rule)
        case Product():
            return _enclose_product(known[node.left], known[node.right], index)
        case Maximum():
            return _enclose_maximum(known[node.left], known[node.right], index, order, rule)
        case Minimum():
            swapped = _enclose_maximum(
                _negated(known[node.left]), _negated(known[node.right]), index, order, rule
            )
            return _negated(swapped)
        case Cast():
            return known[node.source]


def _enclose_input(box: Box, order: int) -> Enclosure:
    """Scale the uncertain inputs to z; fixed ones are constants."""
    batch, size = box.lower.shape
    moving = box.upper > box.lower
    count = int(moving.sum(axis=1).max(initial=0))
    basis: Basis | None = None
    higher = None
    if count == size:
        index = np.broadcast_to(np.arange(size), (batch, size))
    else:
        index = np.argsort(~moving, axis=1, kind="stable")[:, :count]
    if order > 1 and count:
        basis = monomial_basis(count, order)
        higher = np.zeros((batch, basis.size - count, size))
    centre, radius = box.centre, box.radius
    linear = Diagonal(index, np.take_along_axis(radius, index, axis=1), size)
    model = TaylorModel(centre, linear, higher, {}, np.zeros_like(centre), radius, basis)
    return Enclosure(model, box.lower, box.upper)


def _enclose_affine(node: Affine, known: list[Enclosure]) -> Enclosure:
    if not node.sources:  # a constant
        batch = known[0].lower.shape[0]
        value = np.broadcast_to(node.bias, (batch, node.size))
        zero = np.zeros((batch, node.size))
        rest = zero + gamma(2 * node.roundings, ENGINE_ROUNDOFF) * node.bias_magnitude
        form = known[0].model.linear.mapped(np.zeros((node.size, known[0].lower.shape[1])))
        higher = known[0].model.higher
        higher = None if higher is None else np.zeros((batch, higher.shape[1], node.size))
        model = TaylorModel(value, form, higher, {}, rest, zero, known[0].model.basis)
        return Enclosure(model, value - rest, value + rest)
    sources = [known[source] for source in node.sources]
    model = affine_image([source.model for source in sources], node)
    return _intersected(model, interval_image([source.hull for source in sources], node))


def interval_image(sources: Sequence[Hull], node: Affine) -> Hull:
    """Enclose an affine node by interval arithmetic in centre-radius form. **Sound:** yes."""
    centre, size, reach = node.bias, node.bias_magnitude, np.zeros(node.size)
    for (lower, upper), weight, absolute, merged in zip(
        sources, node.weights, node.absolute_weights, node.magnitudes, strict=True
    ):
        middle = lower / 2 + upper / 2
        radius = np.maximum(upper - middle, middle - lower)
        centre = centre + middle @ weight.T
        spread = radius @ absolute.T
        reach = reach + spread
        size = size + np.abs(middle) @ merged.T + (spread if merged is absolute else radius @ merged.T)
    terms = 4 + node.roundings + sum(weight.shape[1] for weight in node.weights)
    reach = (reach + 2 * gamma(terms, ENGINE_ROUNDOFF) * size) * SLIGHTLY_MORE + 1e-300
    return centre - reach, centre + reach


def _intersected(model: TaylorModel, hull: Hull) -> Enclosure:
    lower, upper = model_range(model)
    return Enclosure(model, np.maximum(lower, hull[0]), np.minimum(upper, hull[1]))


def model_range(model: TaylorModel, *, thorough: bool = False) -> Hull:
    """Enclose the range of a Taylor model, thoroughly where it decides a bound. **Sound:** yes."""
    if model.higher is None or model.basis is None:
        return model.hull()
    linear = model.linear.dense()
    lower, upper = range_by_terms(linear, model.higher, model.basis)
    if thorough:
        corner_lower, corner_upper = range_by_corners(linear, model.higher, model.basis)
        lower, upper = np.maximum(lower, corner_lower), np.minimum(upper, corner_upper)
    reach = model.remainder + sum((form.norms() for form in model.symbols.values()), np.zeros_like(lower))
    reach = (reach + gamma(4 * model.basis.size + 8, ENGINE_ROUNDOFF) * model.magnitude) * SLIGHTLY_MORE
    return model.constant + lower - reach, model.constant + upper + reach


def _enclose_activation(
    argument: Enclosure, function: ActivationFunction, index: int, order: int, rule: Approximation
) -> Enclosure:
    curve = curve_of(function)
    shape = argument.lower.shape
    model = argument.model
    polynomial = approximate(
        curve, argument.lower.ravel(), argument.upper.ravel(), order, rule, model.constant.ravel()
    )
    coefficients = polynomial.coefficients.reshape(order + 1, *shape)
    image = polynomial_image(model, coefficients, polynomial.error.reshape(shape), index)
    value = curve.range(argument.lower, argument.upper)
    return _intersected(image, (value.lower, value.upper))


def _enclose_product(left: Enclosure, right: Enclosure, index: int) -> Enclosure:
    corners = [a * b for a in left.hull for b in right.hull]
    lower = step_down(np.minimum(np.minimum(corners[0], corners[1]), np.minimum(corners[2], corners[3])))
    upper = step_up(np.maximum(np.maximum(corners[0], corners[1]), np.maximum(corners[2], corners[3])))
    return _intersected(product_image(left.model, right.model, index), (lower, upper))


def _combined(left: Enclosure, right: Enclosure, sign: float) -> Enclosure:
    identity = np.eye(left.lower.shape[1])
    node = Affine((0, 1), (identity, sign * identity), np.zeros(left.lower.shape[1]))
    return _enclose_affine(node, [left, right])


def _enclose_maximum(
    left: Enclosure, right: Enclosure, index: int, order: int, rule: Approximation
) -> Enclosure:
    """Enclose ``max(x, y) = y + relu(x - y)``."""
    excess = _enclose_activation(_combined(left, right, -1.0), activation("Relu"), index, order, rule)
    both = _combined(right, excess, 1.0)
    lower = np.maximum(both.lower, np.maximum(left.lower, right.lower))
    upper = np.minimum(both.upper, np.maximum(left.upper, right.upper))
    return Enclosure(both.model, lower, upper)


def _negated(enclosure: Enclosure) -> Enclosure:
    size = enclosure.lower.shape[1]
    node = Affine((0,), (-np.eye(size),), np.zeros(size))
    return _enclose_affine(node, [enclosure])
