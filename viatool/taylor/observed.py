"""Reachable sets over sets of observations that are no boxes: common errors, and a few entries that are elsewhere.

*Common errors* are symbols of the input model, so that they cancel where the network subtracts what it observes; the
box around the set holds as well, with all that refines it, and the tighter bound counts.

*A few entries elsewhere.* Where there are not too many choices of entries, each is bounded by itself. Else entries are
cut into blocks, and over each choice of blocks one pass gives every action as a linear form of the entries, ``y = y_0 +
sum_i L_i x_i + rest``, over the box that holds an entry wherever it may be. Of that, an entry adds at most b_i where it
should be and at most m_i elsewhere; of up to k elsewhere the sum is at most ``sum_i b_i`` and the k largest
``m_i - b_i`` that are positive.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from viatool.arrays import Floats, Hull
from viatool.policy.network import Network
from viatool.rounding import SLIGHTLY, SLIGHTLY_MORE
from viatool.sets.observations import ObservationSets
from viatool.taylor.choices import chosen_by, differences, excluded_by, require_not_excluded
from viatool.taylor.correlated import CorrelatedReach, input_model, reach_correlated
from viatool.taylor.elsewhere import FewSymbols
from viatool.taylor.propagation import Enclosure
from viatool.taylor.reach import Arithmetic, HasNetwork, ReachableSet, is_choice, networks_of, reach
from viatool.taylor.watch import require_program_within

MOST_CHOICES = 64
"""Choices of entries, or of blocks of them, that are bounded one by one for each state."""


def reach_observed(
    policy: HasNetwork,
    sets: ObservationSets,
    *,
    thorough: bool = True,
    **engine: Any,
) -> ReachableSet:
    """Enclose the actions of a policy over sets of observations.

    Parameters
    ----------
    policy : Policy
        n inputs, A outputs.
    sets : ObservationSets
        B of them.
    thorough : bool
        Whether choices of entries that are elsewhere are bounded one by one, up to `MOST_CHOICES` for each state.
    **engine
        Settings of `reach`.

    Returns
    -------
    ReachableSet
        Bounds (B, A); of what is attained nothing is said.

    Raises
    ------
    ConfigurationError, EnclosureError, BoundsError, SelfCheckError
        As `reach`.

    Notes
    -----
    **Sound:** yes. Cost: of `reach`, and of a pass of order 1 for each choice of entries that may be elsewhere.
    """
    nominal = replace(sets, few=())
    found = _over(policy, nominal, engine)
    if any(few.count for few in sets.few):
        for chosen in sets.choices(MOST_CHOICES if thorough else 1):
            found = _either(found, _over(policy, chosen, engine))
    return found


def reach_sets(
    network: Network, sets: ObservationSets, most: int, *, arithmetic: Arithmetic
) -> CorrelatedReach:
    """Enclose the actions over sets of observations by what their entries have in common alone.

    Parameters
    ----------
    network : Network
        n inputs, A outputs.
    sets : ObservationSets
        B of them, whose bounds are those of their forms.
    most : int
        So many choices of entries that are elsewhere are bounded one by one; 1 for all of them in one pass.
    arithmetic : str
        As in `viatool.reach`.

    Returns
    -------
    CorrelatedReach
        Bounds (B, A).

    Notes
    -----
    **Sound:** yes. Cost: a pass of order 1, and one for each choice.
    """
    one = most == 1 or not any(few.count for few in sets.few)
    chosen = (sets,) if one else sets.choices(most)
    found: list[CorrelatedReach] = []
    for some in chosen:
        inputs, few = model_of(some)
        found = [
            CorrelatedReach.hull([*found, reach_correlated(network, inputs, arithmetic=arithmetic, few=few)])
        ]
    return found[0]


def _either(found: ReachableSet, other: ReachableSet) -> ReachableSet:
    """Return what holds for observations of one set or the other."""
    joined = ReachableSet.hull([found, other])
    if found.possible is None or other.possible is None:
        return joined
    assert found.attained is not None
    return replace(joined, possible=found.possible | other.possible, attained=found.attained)


def _over(policy: HasNetwork, sets: ObservationSets, engine: Mapping[str, Any]) -> ReachableSet:
    """Bound the actions over sets, by the boxes around them and by what their entries have in common."""
    lower, upper = sets.hull
    middle = 0.5 * (lower + upper)
    radius = np.maximum(upper - middle, middle - lower)
    wide = {**engine, "refine": "none", "order": 1} if sets.few else engine
    found = reach(policy, middle, np.nextafter(radius, np.inf) * (radius > 0.0), **wide)
    if not (sets.shares or sets.few):
        return found
    unknown = np.full_like(found.attained_lower, np.nan)
    found = replace(found, attained_lower=unknown, attained_upper=unknown)
    centre = np.clip(sets.forms.centre, sets.lower, sets.upper)
    arithmetic: Arithmetic = engine.get("arithmetic", "float32")
    inputs, few = model_of(sets)
    networks = networks_of(policy, arithmetic)
    if is_choice(policy):
        found = _excluding(found, policy, centre, inputs, few, arithmetic)
    each = [
        reach_correlated(network, inputs, arithmetic=arithmetic, thorough=not sets.few, few=few)
        for network in networks
    ]
    least, most = (np.min([one.lower for one in each], axis=0), np.max([one.upper for one in each], axis=0))
    if arithmetic == "float32":
        require_program_within(policy, centre[None], least, most)
    return replace(found, lower=np.fmax(found.lower, least), upper=np.fmin(found.upper, most))


def _excluding(
    found: ReachableSet,
    policy: HasNetwork,
    centre: Floats,
    inputs: Enclosure,
    few: tuple[FewSymbols, ...],
    arithmetic: Arithmetic,
) -> ReachableSet:
    """Exclude what the differences of what is compared exclude in every network that may run."""
    assert found.possible is not None
    size = policy.network.output_size
    between = [
        reach_correlated(differences(network), inputs, arithmetic=arithmetic, few=few)
        for network in networks_of(policy, arithmetic)
    ]
    excluded = np.logical_and.reduce([excluded_by(one.lower, one.upper, size) for one in between])
    attained = np.zeros_like(excluded)
    program = getattr(policy, "run", None)
    if program is not None and arithmetic == "float32":
        attained = chosen_by(program, centre, size)
        require_not_excluded(attained, excluded)
    return replace(found, possible=found.possible & ~excluded, attained=attained)


def model_of(sets: ObservationSets) -> tuple[Enclosure, tuple[FewSymbols, ...]]:
    """Return the input model that holds sets of observations, and which of its symbols may lie elsewhere."""
    forms = sets.forms
    centre, rest = forms.centre.copy(), forms.rest.copy()
    common = np.abs(forms.slope).sum(axis=1)
    few = []
    for some in sets.few:
        if not (some.count and len(some.columns)):
            continue
        columns = some.columns
        usual = centre[:, columns] - rest[:, columns], centre[:, columns] + rest[:, columns]
        other = some.lower - common[:, columns], some.upper + common[:, columns]
        least, most = np.minimum(usual[0], other[0]), np.maximum(usual[1], other[1])
        middle = 0.5 * (least + most)
        size = np.abs(least) + np.abs(most)
        half = np.maximum(most - middle, middle - least) * SLIGHTLY_MORE + SLIGHTLY * size + 1e-300
        centre[:, columns], rest[:, columns] = middle, half
        few.append(
            FewSymbols(
                some.count,
                forms.slope.shape[1] + columns,
                _scaled(usual, middle, half, size),
                _scaled(other, middle, half, size),
            )
        )
    return input_model(centre, forms.slope, rest), tuple(few)


def _scaled(ends: Hull, middle: Floats, half: Floats, size: Floats) -> Hull:
    """Return ends in half-widths around a middle, rounded outward."""
    spare = SLIGHTLY * size / half
    return (
        np.clip((ends[0] - middle) / half - spare, -1.0, 1.0),
        np.clip((ends[1] - middle) / half + spare, -1.0, 1.0),
    )
