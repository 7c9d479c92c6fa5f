"""Bounds that use conditions: weak duality over the symbols of a Taylor model.

A condition is a linear form of the symbols that is known to be at least 0. For every choice of ``beta >= 0``

    max { action : conditions >= 0 }  <=  max { action + sum_d beta_d condition_d },

where the right side is a maximum over the whole box, hence an L1 norm. It is minimised one multiplier at a time, each
time exactly, by a weighted median. Two kinds of conditions are used: those that hold by construction of a part of a box
(see `parts`), and those that hold everywhere because a convex activation lies above its straight pieces, which is what
the freely chosen lower slopes of alpha-CROWN amount to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.policy.network import Activation, Network
from viatool.rounding import ENGINE_ROUNDOFF, SLIGHTLY_MORE
from viatool.taylor.curve import curve_of
from viatool.taylor.forms import Form
from viatool.taylor.model import TaylorModel
from viatool.taylor.propagation import Enclosure
from viatool.taylor.rounding import gamma


@dataclass(frozen=True)
class DualEffort:
    """How hard good multipliers are looked for.

    Parameters
    ----------
    sweeps : int
        How often each multiplier is improved.
    neurons : int
        Neurons of one layer whose straight pieces become conditions.
    """

    sweeps: int = 2
    neurons: int = 24


_THOROUGH = DualEffort()


@dataclass(frozen=True, eq=False)
class SymbolLayout:
    """How the symbols of a model are laid out on one axis of length S.

    Parameters
    ----------
    slices : dict
        Node whose approximation error the symbols stand for (0: the inputs) to their place.
    size : int
        S.
    """

    slices: dict[int, slice]
    size: int

    @classmethod
    def of(cls, model: TaylorModel) -> SymbolLayout:
        """Lay out the symbols of a model one node after the other."""
        slices, start = {}, 0
        for key, form in _forms(model).items():
            slices[key] = slice(start, start + form.symbols)
            start += form.symbols
        return cls(slices, start)

    def columns(self, model: TaylorModel, neurons: Indices) -> tuple[Floats, Floats, Floats]:
        """Return what a model says of C neurons in each of K states.

        Returns
        -------
        tuple of ndarray
            The forms (K, C, S), the constants (K, C), and the spare (K, C): remainder and symbols not laid out.
        """
        forms = np.zeros((*neurons.shape, self.size))
        spare = np.take_along_axis(model.remainder, neurons, axis=1)
        for key, form in _forms(model).items():
            part = form.columns(neurons)
            if key in self.slices:
                forms[:, :, self.slices[key]] = part
            else:
                spare = spare + np.abs(part).sum(axis=2) * SLIGHTLY_MORE
        return forms, np.take_along_axis(model.constant, neurons, axis=1), spare


def _forms(model: TaylorModel) -> dict[int, Form]:
    return {0: model.linear, **model.symbols}


@dataclass(frozen=True, eq=False)
class DualProblem:
    """K maxima of ``constant + objective . e`` over symbols e in [-1, 1]^S with ``conditions . e + slack >= 0``.

    Parameters
    ----------
    objective, constant : ndarray
        ``(K, S)`` and ``(K,)``.
    conditions, slack : ndarray
        ``(K, D, S)`` and ``(K, D)``, the slack with all that the condition may gain from remainders.
    """

    objective: Floats
    constant: Floats
    conditions: Floats
    slack: Floats

    @classmethod
    def of(
        cls,
        model: TaylorModel,
        seed: Floats,
        layout: SymbolLayout,
        conditions: Sequence[tuple[Floats, Floats]],
    ) -> DualProblem:
        """Ask for the largest ``seed . actions`` of a model (K, A) of order 1 under conditions.

        Parameters
        ----------
        model : TaylorModel
            Of the actions.
        seed : ndarray
            ``(K, A)``: +1 or -1 at one action.
        layout : SymbolLayout
            Of the symbols of the model.
        conditions : sequence of (forms, slack)
            Forms (K, D, S) with their largest constants (K, D).
        """
        action = np.abs(seed).argmax(axis=1)[:, None]
        sign = np.take_along_axis(seed, action, axis=1)
        forms, constant, spare = layout.columns(model, action)
        known = np.concatenate([forms for forms, _ in conditions], axis=1)
        slack = np.concatenate([slack for _, slack in conditions], axis=1)
        return cls(forms[:, 0] * sign, (constant * sign + spare)[:, 0], known, slack)

    def rows(self, which: Indices) -> DualProblem:
        """Return some of the problems."""
        return DualProblem(
            self.objective[which], self.constant[which], self.conditions[which], self.slack[which]
        )

    def value(self, beta: Floats) -> tuple[Floats, Floats]:
        """Return the tilted forms ``objective + beta . conditions`` (K, S) and the bounds (K,) of multipliers (K, D).

        **Sound:** yes, for any ``beta >= 0`` (weak duality); the rounding of the norm is counted.
        """
        tilted = self.objective + np.einsum("kd,kds->ks", beta, self.conditions)
        size = np.abs(self.objective).sum(axis=1) + np.einsum("kd,kds->k", beta, np.abs(self.conditions))
        size = size + np.abs(self.constant) + (beta * np.abs(self.slack)).sum(axis=1)
        terms = 2 * (self.objective.shape[1] + self.slack.shape[1]) + 8
        rounding = gamma(terms, ENGINE_ROUNDOFF) * size * SLIGHTLY_MORE
        return tilted, self.constant + (beta * self.slack).sum(axis=1) + np.abs(tilted).sum(axis=1) + rounding


def descend(problem: DualProblem, effort: DualEffort = _THOROUGH) -> Floats:
    """Find good multipliers (K, D), one after the other: each minimises the bound given the others."""
    beta, tilted = np.zeros(problem.slack.shape), problem.objective
    count = problem.slack.shape[1]
    for _ in range(effort.sweeps if count > 1 else 1):
        for d in range(count):
            direction = problem.conditions[:, d]
            without = tilted - beta[:, d, None] * direction
            beta[:, d] = _weighted_median(without, direction, problem.slack[:, d])
            tilted = without + beta[:, d, None] * direction
    return beta


def solve_exactly(problem: DualProblem) -> tuple[Floats, Floats]:
    """Find the best multipliers (K, D) and maximising symbols (K, S) by linear programming, one problem at a time.

    Where no symbols meet the conditions, the multipliers prove that by a bound far below every value of the problem.
    The solver's answer is only a proposal: `DualProblem.value` turns any multipliers into a proved bound.
    """
    beta, symbols = np.zeros(problem.slack.shape), np.sign(problem.objective)
    for k in range(problem.constant.size if problem.objective.shape[1] else 0):
        objective, conditions, slack = problem.objective[k], problem.conditions[k], problem.slack[k]
        best = _linear_program(objective, conditions, slack)
        if best is not None:
            beta[k], symbols[k] = best
            continue
        violation = np.append(
            np.zeros_like(objective), -1.0
        )  # add the same t to all conditions, make it small
        relaxed = np.column_stack([conditions, np.ones_like(slack)])
        least = _linear_program(
            violation, relaxed, slack, top=float(np.abs(slack).max() + np.abs(conditions).sum())
        )
        if least is not None and least[1][-1] > 0.0:
            size = np.abs(problem.constant[k]) + np.abs(objective).sum()
            beta[k] = least[0] * (4.0 * size / least[1][-1])
    return beta, symbols


def _linear_program(
    objective: Floats, conditions: Floats, slack: Floats, top: float = 1.0
) -> tuple[Floats, Floats] | None:
    """Return multipliers (D,) and symbols (S,) of one maximum, the last symbol up to `top`; None if there is none."""
    from scipy.optimize import linprog

    bounds = [(-1.0, 1.0)] * (objective.size - 1) + [(-1.0, top)]
    solved = linprog(-objective, A_ub=-conditions, b_ub=slack, bounds=bounds, method="highs")
    if not solved.success:
        return None
    return np.maximum(-np.asarray(solved.ineqlin.marginals), 0.0), np.asarray(solved.x)


def _weighted_median(form: Floats, direction: Floats, slope: Floats) -> Floats:
    """Return the ``beta >= 0`` (K,) that minimises ``slope beta + |form + beta direction|_1``."""
    if not form.shape[1]:  # no symbols: nothing is gained by a condition
        return np.zeros(len(form))
    weight = np.abs(direction)
    with np.errstate(divide="ignore", invalid="ignore"):
        breaks = np.where(weight > 1e-300, -form / direction, np.inf)
    order = np.argsort(breaks, axis=1)
    rising = slope - weight.sum(axis=1)
    after = rising[:, None] + 2 * np.cumsum(np.take_along_axis(weight, order, axis=1), axis=1)
    first = np.argmax(after >= 0, axis=1)
    best = np.take_along_axis(breaks, np.take_along_axis(order, first[:, None], axis=1), axis=1)[:, 0]
    best = np.where(
        (rising >= 0) | (after[:, -1] < 0), 0.0, best
    )  # falls for ever: no point meets the condition
    return np.where(np.isfinite(best), np.maximum(best, 0.0), 0.0)


def relaxation_conditions(
    network: Network,
    passes: Sequence[Enclosure],
    seed: Floats,
    layout: SymbolLayout,
    effort: DualEffort = _THOROUGH,
) -> tuple[Floats, Floats]:
    """Return conditions that hold everywhere: a convex piecewise linear activation lies above its pieces.

    For each layer the neurons whose symbols weigh most in the action are taken, and of each the pieces at both ends of
    its argument's range: ``sign (y - slope x - intercept) >= 0``, sign -1 where the activation is concave. A convex
    activation that raises the action is left out: its chord, which the symbol already attains, is the better bound.

    Returns
    -------
    tuple of ndarray
        Forms (K, D, S) and largest constants (K, D).
    """
    action = np.abs(seed).argmax(axis=1)[:, None]
    objective = layout.columns(passes[-1].model, action)[0][:, 0] * np.take_along_axis(seed, action, axis=1)
    forms, slack = [np.zeros((seed.shape[0], 0, layout.size))], [np.zeros((seed.shape[0], 0))]
    for key, place in layout.slices.items():
        node = network.nodes[key]
        if not isinstance(node, Activation) or not curve_of(node.function).cells(1).is_stepwise:
            continue
        fresh = passes[key].model.symbols[key]
        bend = curve_of(node.function).overall_bend
        weight = np.abs(objective[:, place]) if bend == 0 else np.maximum(-bend * objective[:, place], 0.0)
        count = min(effort.neurons, int((weight > 0).sum(axis=1).max(initial=0)))
        slots = np.argsort(-weight, axis=1)[:, :count]
        neurons = np.take_along_axis(fresh.moved_neurons(), slots, axis=1)
        for form, constant in _piece_conditions(node, passes, key, neurons, layout):
            forms.append(form)
            slack.append(constant)
    return np.concatenate(forms, axis=1), np.concatenate(slack, axis=1)


def _piece_conditions(
    node: Activation, passes: Sequence[Enclosure], key: int, neurons: Indices, layout: SymbolLayout
) -> list[tuple[Floats, Floats]]:
    argument = passes[node.source]
    lower, upper = (np.take_along_axis(side, neurons, axis=1) for side in argument.hull)
    curve = curve_of(node.function)
    slopes, shape = curve.end_slopes(lower, upper)
    result_form, result_constant, result_spare = layout.columns(passes[key].model, neurons)
    form, constant, spare = layout.columns(argument.model, neurons)
    conditions = []
    for slope, end in zip(slopes, (lower, upper), strict=True):
        intercept = curve.value(end) - slope * end
        tilt = shape[:, :, None] * (result_form - slope[:, :, None] * form)
        centre = shape * (result_constant - slope * constant - intercept)
        size = np.abs(result_constant) + np.abs(slope) * (np.abs(constant) + np.abs(end)) + np.abs(intercept)
        room = centre + result_spare + np.abs(slope) * spare + 1e-13 * size
        room = room + 1e-14 * np.abs(slope[:, :, None] * form).sum(axis=2)
        conditions.append((np.where(shape[:, :, None] == 0, 0.0, tilt), np.where(shape == 0, 0.0, room)))
    return conditions


def source_of(network: Network, node: int) -> int:
    """Return the node that an activation node reads."""
    activation = network.nodes[node]
    assert isinstance(activation, Activation)
    return activation.source
