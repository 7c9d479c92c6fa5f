"""Reachable sets over inputs that move together: linear forms of shared symbols instead of a box.

Where an observation depends on the robot's pose, its entries are not free of each other. With the pose as symbols of
the input model, what the network subtracts cancels, as symbolic remainders do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from viatool.arrays import Booleans, Floats, Hull, Indices
from viatool.policy.network import Network
from viatool.rounding import ENGINE_ROUNDOFF, SLIGHTLY_MORE
from viatool.taylor.deviation import enclose_program, runtime_deviation
from viatool.taylor.elsewhere import FewSymbols, few_hull
from viatool.taylor.forms import Dense, Diagonal, Stacked
from viatool.taylor.head import hulls_through, split_head
from viatool.taylor.kernel import kernel_of
from viatool.taylor.model import TaylorModel
from viatool.taylor.propagation import Box, Enclosure, propagate
from viatool.taylor.refinement import extrema_of, refine_by_pieces, unfold
from viatool.taylor.rounding import widen


@dataclass(frozen=True, eq=False)
class CorrelatedReach:
    """Bounds of the actions over B sets of correlated inputs.

    Parameters
    ----------
    lower, upper : ndarray
        ``(B, A)``, guaranteed; infinite where nothing is known.
    influence : ndarray
        ``(B, V + n, A)``: how much each symbol moves an action before its squash, to first order; no bound.
    """

    lower: Floats
    upper: Floats
    influence: Floats

    def select(self, which: Indices) -> CorrelatedReach:
        """Return what is known over some of the sets."""
        return CorrelatedReach(self.lower[which], self.upper[which], self.influence[which])

    @classmethod
    def hull(cls, sets: Sequence[CorrelatedReach]) -> CorrelatedReach:
        """Return what holds for every one of several programs over the same B sets of inputs."""
        return cls(
            np.minimum.reduce([one.lower for one in sets]),
            np.maximum.reduce([one.upper for one in sets]),
            np.maximum.reduce([one.influence for one in sets]),
        )


@dataclass(frozen=True, eq=False)
class LinearReach:
    """Actions over B sets of correlated inputs as ``centre + slope . z + [-rest, rest]``, z the V common symbols.

    Parameters
    ----------
    lower, upper : ndarray
        ``(B, A)``, guaranteed; often tighter than what the forms say, infinite where nothing is known.
    centre, rest : ndarray
        ``(B, A)``; rest is at least 0, and infinite where the form says nothing.
    slope : ndarray
        ``(B, V, A)``.
    """

    lower: Floats
    upper: Floats
    centre: Floats
    slope: Floats
    rest: Floats

    @classmethod
    def hull(cls, sets: Sequence[LinearReach]) -> LinearReach:
        """Return what holds for every one of several programs over the same B sets of inputs.

        Notes
        -----
        **Sound:** yes. The form is the first one's; by how much another differs from it is in the rest, rounded up.
        """
        first = sets[0]
        rest = first.rest
        for other in sets[1:]:
            apart = np.abs(other.centre - first.centre) + np.abs(other.slope - first.slope).sum(axis=1)
            rest = np.maximum(rest, (apart + other.rest) * SLIGHTLY_MORE)
        return cls(
            np.minimum.reduce([one.lower for one in sets]),
            np.maximum.reduce([one.upper for one in sets]),
            first.centre,
            first.slope,
            np.where(np.isnan(rest), np.inf, rest),
        )

    @classmethod
    def constant(cls, lower: Floats, upper: Floats, common: int) -> LinearReach:
        """Return actions between two ends (B, A) that no common symbol changes."""
        middle = 0.5 * (lower + upper)
        rest = np.where(lower < upper, np.nextafter(np.maximum(upper - middle, middle - lower), np.inf), 0.0)
        return cls(lower, upper, middle, np.zeros((len(middle), common, middle.shape[1])), rest)

    def select(self, which: Indices) -> LinearReach:
        """Return what is known over some of the sets."""
        return LinearReach(*(getattr(self, each.name)[which] for each in fields(self)))

    @classmethod
    def choose(cls, holds: Booleans, found: LinearReach, other: LinearReach) -> LinearReach:
        """Return one or the other for each set, by what holds for it, (B,)."""
        pairs = ((getattr(found, each.name), getattr(other, each.name)) for each in fields(cls))
        return cls(*(np.where(holds.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in pairs))

    def joined(self, cell: Indices, count: int) -> LinearReach:
        """Return what holds for C sets of which the B are parts: part b of set ``cell[b]``, (B,); the first C of each.

        Notes
        -----
        **Sound:** yes, if every point of a set lies in one of its parts; as in `hull`, the form is the first part's.
        """
        if len(cell) == count:
            return self
        which = cell[count:]
        lower, upper, rest = (part[:count].copy() for part in (self.lower, self.upper, self.rest))
        np.minimum.at(lower, which, self.lower[count:])
        np.maximum.at(upper, which, self.upper[count:])
        apart = np.abs(self.centre[count:] - self.centre[which])
        apart = apart + np.abs(self.slope[count:] - self.slope[which]).sum(axis=1)
        np.maximum.at(rest, which, (apart + self.rest[count:]) * SLIGHTLY_MORE)
        rest = np.where(np.isnan(rest), np.inf, rest)
        return LinearReach(lower, upper, self.centre[:count], self.slope[:count], rest)


def input_model(centre: Floats, shared: Floats, own: Floats) -> Enclosure:
    """Return inputs ``centre + shared . z + own e`` with z of all entries and e of each entry in [-1, 1].

    Parameters
    ----------
    centre : ndarray
        ``(B, n)``.
    shared : ndarray
        ``(B, V, n)``: what the V common symbols add to each entry.
    own : ndarray
        ``(B, n)``, not negative: what each entry has to itself.

    Returns
    -------
    Enclosure
        Of the input node; order 1.

    Notes
    -----
    **Sound:** yes; the norms are rounded up.
    """
    size = centre.shape[1]
    each = Diagonal(np.broadcast_to(np.arange(size), centre.shape), own, size)
    radius = (np.abs(shared).sum(axis=1) + own) * SLIGHTLY_MORE
    remainder = 8 * ENGINE_ROUNDOFF * (np.abs(centre) + radius)
    model = TaylorModel(centre, Stacked(Dense(shared), each), None, {}, remainder, radius)
    return Enclosure(model, *model.hull())


def reach_correlated(
    network: Network,
    inputs: Enclosure,
    *,
    arithmetic: Literal["float32", "real"] = "float32",
    thorough: bool = False,
    few: tuple[FewSymbols, ...] = (),
) -> CorrelatedReach:
    """Enclose the actions of a policy over correlated inputs.

    Parameters
    ----------
    network : Network
        n inputs, A outputs.
    inputs : Enclosure
        B sets of observations, from `input_model`.
    arithmetic : str
        As in `viatool.reach`.
    thorough : bool
        Add the dual bounds of `duality`, for about three times the cost.
    few : tuple of FewSymbols
        Inputs of which a few alone lie where they widen the model.

    Returns
    -------
    CorrelatedReach
        Bounds (B, A).

    Notes
    -----
    **Sound:** yes, as `viatool.reach`.
    """
    trunk, head = split_head(network)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        if thorough or few:
            hulls, influence = _refined(trunk, network.output_size, inputs, few, thorough=thorough)
        else:
            hulls, influence = _passed(network, trunk, inputs)
        hulls = hulls_through(head, hulls)
        exact = widen(*hulls[-1], np.zeros_like(hulls[-1][0]))
        program = enclose_program(network, hulls).around(*exact) if arithmetic == "float32" else exact
    return CorrelatedReach(*program, influence)


def _passed(network: Network, trunk: Network, inputs: Enclosure) -> tuple[list[Hull], Floats]:
    """Return the hulls of the trunk's nodes by one pass of the engine that covers it, and the symbols' influence."""
    kernel = kernel_of(network, len(trunk.nodes))
    if kernel is None:
        return _refined(trunk, network.output_size, inputs, (), thorough=False)
    model = inputs.model
    every = model.linear.dense()
    none_own = np.zeros_like(model.constant)
    found = kernel.linear(model.constant, every, none_own, model.remainder, model.radius, inputs.hull)
    hulls, influence = kernel.hulls(found.lower, found.upper), np.abs(found.slope)
    left = np.flatnonzero(~found.done)
    if left.size:
        rows, influence[left] = _refined(trunk, network.output_size, inputs.rows(left), (), thorough=False)
        _put(hulls, left, rows)
    return hulls, influence


def _refined(
    trunk: Network, actions: int, inputs: Enclosure, few: tuple[FewSymbols, ...], *, thorough: bool
) -> tuple[list[Hull], Floats]:
    """Return the hulls of the trunk's nodes, and how much each symbol moves the actions, (B, V + n, A)."""
    box = Box(inputs.lower, inputs.upper)
    passes = propagate(
        trunk, box, inputs=inputs, range_of=(lambda model: few_hull(model, few)) if few else None
    )
    hulls = [enclosure.hull for enclosure in passes]
    if thorough:
        extrema = refine_by_pieces(trunk, extrema_of(box, *hulls[-1]), passes)
        hulls[-1] = unfold(extrema.bound, actions)
    if few:
        hulls[-1] = passes[-1].met(few_hull(passes[-1].model, few)).hull
    return hulls, np.abs(passes[-1].model.linear.dense())


def _put(hulls: Sequence[Hull], which: Indices, others: Sequence[Hull]) -> None:
    """Replace the hulls of some of the sets."""
    for hull, other in zip(hulls, others, strict=True):
        hull[0][which], hull[1][which] = other


def reach_linear(
    network: Network, inputs: Enclosure, common: int, *, arithmetic: Literal["float32", "real"] = "float32"
) -> LinearReach:
    """Enclose the actions of a policy as linear forms of what its inputs have in common.

    Parameters
    ----------
    network : Network
        n inputs, A outputs.
    inputs : Enclosure
        B sets of observations, from `input_model`.
    common : int
        V, the common symbols, which are the first of the inputs'.
    arithmetic : str
        As in `viatool.reach`.

    Returns
    -------
    LinearReach
        For every z, the action for any observation of that z lies within rest of its form.

    Notes
    -----
    **Sound:** yes, as `viatool.reach`; what symbols other than z add is in the rest, as are all approximations.
    """
    trunk, head = split_head(network)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        hulls, model = _linear_models(network, inputs, common)
        lower, upper = hulls_through(head, hulls[: len(trunk.nodes)])[-1]
        deviation = runtime_deviation(network, hulls) if arithmetic == "float32" else np.zeros_like(lower)
    rest = (model.others + deviation) * SLIGHTLY_MORE + 4 * model.symbols * ENGINE_ROUNDOFF * model.size
    rest = np.where(np.isnan(rest), np.inf, rest)
    return LinearReach(*widen(lower, upper, deviation), model.centre, model.slope, rest)


@dataclass(frozen=True, eq=False)
class _LinearModel:
    """Actions (B, A) as forms of common symbols, what all else adds at most, and what bounds every partial sum."""

    centre: Floats
    slope: Floats
    others: Floats
    size: Floats
    symbols: int


def _linear_models(network: Network, inputs: Enclosure, common: int) -> tuple[list[Hull], _LinearModel]:
    """Return the hulls of all nodes over sets of inputs, and the actions' models, by the engine that covers them."""
    kernel = kernel_of(network, len(network.nodes))
    parts = _shared_and_own(inputs)
    if kernel is None or parts is None:
        return _by_numpy(network, inputs, common)
    model = inputs.model
    found = kernel.linear(model.constant, *parts, model.remainder, model.radius, inputs.hull)
    hulls = kernel.hulls(found.lower, found.upper)
    others = found.others + np.abs(found.slope[:, common:]).sum(axis=1)
    known = _LinearModel(found.centre, found.slope[:, :common], others, found.size, model.linear.symbols)
    left = np.flatnonzero(~found.done)
    if left.size:
        rows, of_rows = _by_numpy(network, inputs.rows(left), common)
        _put(hulls, left, rows)
        for name in ("centre", "slope", "others", "size"):
            getattr(known, name)[left] = getattr(of_rows, name)
    return hulls, known


def _shared_and_own(inputs: Enclosure) -> tuple[Floats, Floats] | None:
    """Return what common symbols (B, V, n) and each input's own one (B, n) add, where inputs are from `input_model`."""
    match inputs.model.linear:
        case Stacked(Dense(shared), Diagonal(index, own)) if (index == np.arange(shared.shape[2])).all():
            return shared, own
    return None


def _by_numpy(network: Network, inputs: Enclosure, common: int) -> tuple[list[Hull], _LinearModel]:
    passes = propagate(network, Box(inputs.lower, inputs.upper), inputs=inputs)
    model = passes[-1].model
    linear = model.linear.dense()
    others = np.abs(linear[:, common:]).sum(axis=1) + model.remainder
    others = others + sum(form.norms() for form in model.symbols.values())
    found = _LinearModel(model.constant, linear[:, :common], others, model.magnitude, linear.shape[1])
    return [enclosure.hull for enclosure in passes], found
