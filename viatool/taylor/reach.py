"""Reachable sets: guaranteed bounds of the actions of a policy over boxes of observations."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import ArrayLike

from viatool.arrays import Booleans, Floats, Hull, Indices
from viatool.errors import ConfigurationError, EnclosureError
from viatool.policy.given import numbers
from viatool.policy.network import Network
from viatool.policy.summing import without_other_orders
from viatool.taylor.approximation import Approximation
from viatool.taylor.choices import Choices, Program, enclose_choices
from viatool.taylor.deviation import enclose_program
from viatool.taylor.first_order import Effort, enclose_first_order
from viatool.taylor.head import hulls_through, split_head, values_through
from viatool.taylor.higher_order import higher_hulls
from viatool.taylor.memory import (
    CACHED_FLOATS,
    affordable_parts,
    affords_passes,
    blocks_of_states,
    refines_at_once,
)
from viatool.taylor.propagation import Box
from viatool.taylor.refinement import extrema_of, refine_by_order, unfold
from viatool.taylor.rounding import widen
from viatool.taylor.splitting import SplittingEffort, refine_by_splitting
from viatool.taylor.watch import require_program_within

Refinement = Literal["none", "monotone", "split"]
Arithmetic = Literal["float32", "real"]

_LIGHT_EFFORT = SplittingEffort(tolerance=0.03, parts=3, exact=False)
"""After a monotone collapse the few bounds that stay loose are split once."""


@dataclass(frozen=True)
class _Settings:
    order: int
    rule: Approximation
    refine: Refinement
    arithmetic: Arithmetic
    effort: SplittingEffort

    def refines_one_by_one(self, network: Network) -> bool:
        """Tell whether each extremum of an action gets passes of its own; by default not where these take too long."""
        affordable = affords_passes(network, 2 * network.output_size)
        return self.refine == "split" or (self.refine == "monotone" and affordable)

    def parts_of_a_choice(self, network: Network) -> int:
        """Return how many parts of a box are examined for a command that is neither excluded nor attained."""
        return max(affordable_parts(network), self.effort.parts)

    def __post_init__(self) -> None:
        if self.order < 1:
            raise ConfigurationError(f"order is {self.order}, expected 1 or more", "order 1 is the fastest")
        for name, value, allowed in (
            ("approximation", self.rule, get_args(Approximation)),
            ("refine", self.refine, get_args(Refinement)),
            ("arithmetic", self.arithmetic, get_args(Arithmetic)),
        ):
            if value not in allowed:
                raise ConfigurationError(
                    f"{name} is '{value}', expected one of {', '.join(allowed)}", f"choose one for {name}"
                )


class HasNetwork(Protocol):
    """What `reach` needs of a policy. One that is `rewritten` by its runtime names those networks too."""

    @property
    def network(self) -> Network:
        """The network to enclose."""
        ...

    @property
    def spec(self) -> Any:
        """The specification, or None."""
        ...


def networks_of(policy: HasNetwork, arithmetic: Arithmetic) -> tuple[Network, ...]:
    """Return the networks for which a bound has to hold.

    Parameters
    ----------
    policy : Policy
        With its network, and in `rewritten` those that its runtime runs in that one's place.
    arithmetic : str
        ``real`` is about what the file says alone, ``float32`` about every program that may run.

    Returns
    -------
    tuple of Network
        **Sound:** bounds hold for the deployed program if they hold for each of them. The file's own is first, unless
        its program adds up in one of the orders in which that of another one may (`summing`).
    """
    rewritten = getattr(policy, "rewritten", ()) if arithmetic == "float32" else ()
    return without_other_orders((policy.network, *rewritten))


@dataclass(frozen=True, eq=False)
class ReachableSet:
    """Guaranteed bounds of the outputs over B boxes of observations, and how much of them is really attained.

    The outputs are the actions, or of a policy that chooses among K commands the K numbers that it compares.

    Parameters
    ----------
    lower, upper : ndarray
        ``(B, A)`` float64: no observation in the box leads to an action outside.
    attained_lower, attained_upper : ndarray
        ``(B, A)``: the smallest and the largest action found in the box, so that the distance to `lower` and `upper`
        certifies how tight these are.
    deviation : ndarray
        ``(B, A)``: by how much either bound lies further out to cover the rounding of the deployed program; 0 for real
        arithmetic.
    possible, attained : ndarray, optional
        ``(B, K)`` bool, where the specification has a choice among K commands: those that some observation in the box
        may select, as nothing excludes them; and those of which an observation was found that does select them.
    """

    lower: Floats
    upper: Floats
    attained_lower: Floats
    attained_upper: Floats
    deviation: Floats
    possible: Booleans | None = None
    attained: Booleans | None = None

    @property
    def width(self) -> Floats:
        """Return the widths of the bounds, (B, A)."""
        return self.upper - self.lower

    @property
    def attained_width(self) -> Floats:
        """Return the widths that are attained, (B, A)."""
        return self.attained_upper - self.attained_lower

    @classmethod
    def hull(cls, sets: Sequence[ReachableSet]) -> ReachableSet:
        """Return what holds for every one of several programs over the same B boxes."""
        if len(sets) == 1:
            return sets[0]
        return cls(
            np.minimum.reduce([one.lower for one in sets]),
            np.maximum.reduce([one.upper for one in sets]),
            np.minimum.reduce([one.attained_lower for one in sets]),
            np.maximum.reduce([one.attained_upper for one in sets]),
            np.maximum.reduce([one.deviation for one in sets]),
        )

    @classmethod
    def join(cls, parts: Sequence[ReachableSet]) -> ReachableSet:
        """Return sets over boxes that follow each other as one."""
        if len(parts) == 1:
            return parts[0]
        columns = {each.name: [getattr(part, each.name) for part in parts] for each in fields(cls)}
        known: dict[str, Any] = {
            name: np.concatenate(column) for name, column in columns.items() if column[0] is not None
        }
        return cls(**known)

    def rows(self, which: Indices) -> ReachableSet:
        """Return some of the sets."""
        parts: dict[str, Any] = {each.name: getattr(self, each.name) for each in fields(self)}
        return replace(self, **{name: part[which] for name, part in parts.items() if part is not None})

    def where(self, these: Booleans, others: ReachableSet) -> ReachableSet:
        """Return the sets of some of the B boxes, (B,), and for the others those of another reachable set."""
        chosen: dict[str, Any] = {}
        for each in fields(self):
            mine, theirs = getattr(self, each.name), getattr(others, each.name)
            chosen[each.name] = None if mine is None else np.where(these[:, None], mine, theirs)
        return ReachableSet(**chosen)

    def attained_alone(self) -> ReachableSet:
        """Return what is attained as if no more were reachable: every bound, however tight, holds that."""
        lower = np.minimum(self.attained_lower, self.attained_upper)
        upper = np.maximum(self.attained_lower, self.attained_upper)
        return replace(self, lower=lower, upper=upper, possible=self.attained)

    def spread(self, known: Booleans) -> ReachableSet:
        """Return B sets of which some are known, (B,); the others have NaN bounds, and all is possible."""
        spread: dict[str, Any] = {}
        for each in fields(self):
            values = getattr(self, each.name)
            if values is not None:
                nothing = (each.name == "possible") if values.dtype == bool else np.nan
                spread[each.name] = np.full((len(known), values.shape[1]), nothing, dtype=values.dtype)
                spread[each.name][known] = values
        return ReachableSet(**spread)


def reach(
    policy: HasNetwork,
    observations: ArrayLike,
    eps: ArrayLike,
    *,
    order: int = 1,
    approximation: Approximation = "chebyshev",
    refine: Refinement = "monotone",
    arithmetic: Arithmetic = "float32",
    tolerance: float = 2.5e-4,
    most_parts: int = 400,
    progress: Callable[[int], None] | None = None,
) -> ReachableSet:
    """Enclose the actions of a policy for every observation within eps of the given ones.

    Parameters
    ----------
    policy : Policy
        n observation channels, A actions.
    observations : array_like
        ``(B, n)``, in the units of the observation.
    eps : array_like
        Half-widths: one number for every channel (those that the specification fixes keep 0), ``(n,)`` or ``(B, n)``.
    order : int
        Highest order of the Taylor models, at least 1. Bounds are at least as tight as those of every lower order. A
        piecewise linear network is done at order 1, which is all that it has; where the polynomials of a state with
        many free inputs would take more than some hundred megabytes, the highest order that fits is the last.
    approximation : str
        ``chebyshev``, ``bernstein`` or ``taylor`` polynomials for the activations.
    refine : str
        ``none``: one pass; ``monotone``: inputs in which an action is monotone are fixed at their ends, repeatedly, and
        bounds that stay loose are split once; ``split``: they are split until tight or until the effort is spent. Of a
        policy that chooses among commands, ``monotone`` refines what is possible, and not the bounds of its outputs.
    arithmetic : str
        ``real``: bounds of the exact network; ``float32``: also of the deployed program in its own precision, whatever
        its order of summation.
    tolerance : float
        With ``split``: an action is done when each bound is within this fraction of the attained width.
    most_parts : int
        With ``split``: parts that are examined for one bound before the best bound so far is returned.
    progress : callable, optional
        Called with the number of states done since the last call.

    Returns
    -------
    ReachableSet
        Bounds (B, A); of a policy that chooses among commands also which are possible.

    Raises
    ------
    ConfigurationError
        If shapes do not fit, eps is negative or not finite, or an option is unknown.
    EnclosureError
        If no finite enclosure exists.
    BoundsError
        If bounds come out the wrong way round, which is a fault of viatool.
    SelfCheckError
        If the deployed program leaves the bounds in the middle of a box or at a corner where extreme actions were
        found.

    Notes
    -----
    **Sound:** yes. Memory does not depend on B beyond the result.
    """
    network, box = policy.network, observation_box(policy, observations, eps)
    settings = _Settings(
        order,
        approximation,
        refine,
        arithmetic,
        _LIGHT_EFFORT
        if refine != "split"
        else SplittingEffort(tolerance, most_parts).at_least(_LIGHT_EFFORT),
    )
    networks = networks_of(policy, arithmetic)
    # what is compared, no one commands: its bounds are refined where that was asked for
    for_outputs = replace(settings, refine="none") if is_choice(policy) and refine == "monotone" else settings
    parts = []
    for rows in blocks_of_states(network, box.lower.shape[0]):
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # unbounded slopes, overflows
            found = [_reach_chunk(each, box.rows(rows), for_outputs) for each in networks]
            chosen = _choices(policy, networks, box.rows(rows), settings)
        reached = ReachableSet.hull([each for each, _ in found])
        if chosen is not None:
            reached = replace(reached, possible=chosen.possible, attained=chosen.attained)
        parts.append(reached)
        if arithmetic == "float32":
            for _, points in found:
                require_program_within(policy, points, parts[-1].lower, parts[-1].upper)
        if progress is not None:
            progress(parts[-1].lower.shape[0])
    if not parts:
        empty = np.empty((0, network.output_size))
        none = empty.astype(bool) if is_choice(policy) else None
        return ReachableSet(empty, empty, empty, empty, empty, none, none)
    return ReachableSet.join(parts)


def efforts_of(policy: HasNetwork, settings: Mapping[str, Any]) -> tuple[Mapping[str, Any], ...]:
    """Return the settings of `reach` to try in turn while something is open: first one pass, where that takes long."""
    single = {**settings, "refine": "none"}
    return (settings,) if settings == single or refines_at_once(policy.network) else (single, settings)


def is_choice(policy: HasNetwork) -> bool:
    """Tell whether the largest output of a policy says which command of a table is sent."""
    return getattr(policy.spec, "choice", None) is not None


def observation_box(policy: HasNetwork, observations: ArrayLike, eps: ArrayLike) -> Box:
    """Return the boxes of observations (B, n), their ends rounded outward."""
    centre = numbers("observations", observations)
    size = policy.network.input_size
    if centre.ndim != 2 or centre.shape[1] != size:
        raise ConfigurationError(
            f"observations have shape {centre.shape}, expected (B, {size})", "give one row for each state"
        )
    if not np.isfinite(centre).all():
        raise ConfigurationError("observations contain NaN or infinity", "drop or repair these states first")
    radius = numbers("eps", eps)
    if not (np.isfinite(radius).all() and (radius >= 0).all()):
        raise ConfigurationError(
            f"eps is {radius}, expected finite numbers >= 0", "give the half-width of the error"
        )
    if radius.ndim == 0 and policy.spec is not None:
        radius = policy.spec.radii(float(radius))
    try:
        radius = np.broadcast_to(radius, centre.shape)
    except ValueError:
        raise ConfigurationError(
            f"eps has shape {radius.shape}, expected a number, ({size},) or {centre.shape}",
            "give one eps, one for each channel, or one for each state and channel",
        ) from None
    lower, upper = centre - radius, centre + radius
    moved = radius > 0
    return Box(
        np.where(moved, np.nextafter(lower, -np.inf), centre),
        np.where(moved, np.nextafter(upper, np.inf), centre),
    )


def _choices(
    policy: HasNetwork, networks: Sequence[Network], box: Box, settings: _Settings
) -> Choices | None:
    """Return which commands are possible over some boxes, for every network that may run; None without a choice."""
    if not is_choice(policy):
        return None
    program: Program | None = getattr(policy, "run", None)
    found = []
    for network in networks:
        parts = settings.parts_of_a_choice(network) if settings.refines_one_by_one(network) else 0
        found.append(
            enclose_choices(
                network,
                box,
                program or network,
                rule=settings.rule,
                arithmetic=settings.arithmetic,
                parts=parts,
            )
        )
    return Choices.hull(found)


def _reach_chunk(network: Network, box: Box, settings: _Settings) -> tuple[ReachableSet, Floats]:
    """Return the reachable sets of some boxes, and observations (K, B, n) in them: the middle, and extreme ones."""
    trunk, head = split_head(network)
    one_by_one = settings.refines_one_by_one(trunk)
    effort = Effort(settings.rule, settings.refine != "none", one_by_one, settings.effort)
    first = enclose_first_order(network, trunk, box, effort)
    hulls, extrema, points, found = first.hulls, first.extrema, first.points, first.found
    if one_by_one:
        extrema, found = refine_by_splitting(
            trunk, extrema, found, rule=settings.rule, effort=settings.effort, settled=first.settled
        )
    if settings.order > 1:
        hulls = higher_hulls(trunk, box, hulls, order=settings.order, rule=settings.rule)
        extrema = extrema.met(extrema_of(box, *hulls[-1]).bound)
    if settings.order > 1 and one_by_one:
        loose = np.flatnonzero(extrema.bound > found)
        extrema = refine_by_order(trunk, extrema, loose, order=settings.order, rule=settings.rule)
    actions = network.output_size
    bounds = hulls_through(head, [*hulls[:-1], unfold(extrema.bound, actions)])
    smallest, largest = (values_through(head, value) for value in unfold(found, actions))
    lower, upper = program = widen(*bounds[-1], np.zeros_like(smallest))
    if settings.arithmetic == "float32":
        finer = None if settings.refine == "none" else partial(_finer_hulls, network, box, bounds, settings)
        program = enclose_program(network, bounds, finer=finer).around(lower, upper)
    if not np.isfinite(upper - lower).all():
        raise EnclosureError(
            "an action has no finite bounds on some box",
            "make eps smaller, or check the weights and the units of the observation",
        )
    deviation = np.maximum(lower - program[0], program[1] - upper)
    reached = ReachableSet(*program, smallest, largest, deviation)
    return reached, np.concatenate([box.centre[None], points.reshape(-1, *box.lower.shape)])


def _finer_hulls(
    network: Network, box: Box, hulls: Sequence[Hull], settings: _Settings, rows: Indices
) -> list[Hull]:
    """Return hulls of every node over some boxes with those of a pass of the next order met."""
    trunk, head = split_head(network)
    known = [(lower[rows], upper[rows]) for lower, upper in hulls[: len(trunk.nodes)]]
    finer = higher_hulls(
        trunk, box.rows(rows), known, order=settings.order + 1, rule=settings.rule, largest=CACHED_FLOATS
    )
    return hulls_through(head, finer)
