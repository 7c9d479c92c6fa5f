"""A Taylor model to read: the action near one observation as a sympy polynomial in the named sensor errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from viatool.arrays import Floats
from viatool.errors import ConfigurationError, EnclosureError
from viatool.policy.network import Network
from viatool.rounding import SLIGHTLY_MORE
from viatool.taylor.approximation import Approximation
from viatool.taylor.deviation import runtime_deviation
from viatool.taylor.model import TaylorModel
from viatool.taylor.propagation import Enclosure, propagate
from viatool.taylor.reach import Arithmetic, HasNetwork, networks_of, observation_box

if TYPE_CHECKING:
    import sympy


@dataclass(frozen=True, eq=False)
class SymbolicAction:
    """One action as ``polynomial(errors) +- remainder``.

    Parameters
    ----------
    name, unit : str
        Of the action.
    polynomial : sympy.Expr
        In one symbol for each uncertain observation entry: how far that entry is off, in its own unit.
    remainder : float
        In the unit of the action; covers what the polynomial leaves out and, for ``float32``, the rounding of the
        deployed program.
    effect : dict of str to float
        Entry to the largest change of the action that its linear term makes within eps.
    """

    name: str
    unit: str
    polynomial: sympy.Expr
    remainder: float
    effect: dict[str, float]


def symbolic_actions(
    policy: HasNetwork,
    observation: ArrayLike,
    eps: ArrayLike,
    *,
    order: int = 1,
    approximation: Approximation = "chebyshev",
    arithmetic: Arithmetic = "float32",
) -> list[SymbolicAction]:
    """Write the actions of a policy around one observation as polynomials of the sensor errors.

    Parameters
    ----------
    policy : Policy
        n observation channels.
    observation : array_like
        ``(n,)``.
    eps : array_like
        As for `reach`.
    order, approximation, arithmetic
        As for `reach`.

    Returns
    -------
    list of SymbolicAction
        One for each action; for every error within eps the action lies within the remainder of the polynomial.

    Raises
    ------
    EnclosureError
        If an action has no finite enclosure.

    Notes
    -----
    **Sound:** yes up to the printing of the coefficients, which are exact float64 numbers in the expression.
    """
    import sympy

    row = np.atleast_2d(np.asarray(observation, dtype=np.float64))
    if row.shape[0] != 1:
        raise ConfigurationError(
            f"{row.shape[0]} observations are given, expected one", "choose one row to write symbolically"
        )
    box = observation_box(policy, row, eps)
    passes = propagate(policy.network, box, order=order, rule=approximation)
    model = passes[-1].model
    spread = _spread(policy.network, passes, arithmetic)
    for other in networks_of(policy, arithmetic):
        if other is policy.network:
            continue
        rewritten = propagate(other, box, order=order, rule=approximation)
        apart = _difference(model, rewritten[-1].model) + _spread(other, rewritten, arithmetic)
        spread = np.maximum(spread, apart * SLIGHTLY_MORE)
    if not np.isfinite(spread).all():
        raise EnclosureError(
            "an action has no finite remainder", "make eps smaller, or check the weights of the policy"
        )
    entries = [sympy.Symbol(f"d_{name}", real=True) for name in entry_names(policy)]
    scaled = [
        entry / radius if radius > 0 else sympy.Integer(0)
        for entry, radius in zip(entries, box.radius[0], strict=True)
    ]
    actions = []
    for index, (name, unit) in enumerate(_action_names(policy)):
        polynomial, effect = _polynomial(model, index, scaled, passes[0].model, entries)
        actions.append(SymbolicAction(name, unit, polynomial, float(spread[index]), effect))
    return actions


def _spread(network: Network, passes: Sequence[Enclosure], arithmetic: Arithmetic) -> Floats:
    """Return how far the actions of one observation may be from the polynomials of their models, (A,)."""
    model = passes[-1].model
    spread = sum((form.norms() for form in model.symbols.values()), model.remainder)[0] * SLIGHTLY_MORE
    if arithmetic == "float32":
        spread = spread + runtime_deviation(network, [enclosure.hull for enclosure in passes])[0]
    return np.asarray(spread)


def _difference(model: TaylorModel, other: TaylorModel) -> Floats:
    """Bound how far the polynomials of two models over the same box are from each other, (A,)."""
    apart = np.abs(model.constant - other.constant)[0]
    apart = apart + np.abs(model.linear.dense() - other.linear.dense())[0].sum(axis=0)
    higher = [one.higher[0] for one in (model, other) if one.higher is not None]
    if len(higher) == 2:
        return np.asarray(apart + np.abs(higher[0] - higher[1]).sum(axis=0))
    return np.asarray(apart + sum(np.abs(one).sum(axis=0) for one in higher))


def entry_names(policy: HasNetwork) -> list[str]:
    """Return a name for every entry of the observation, see `Inputs.names`."""
    if policy.spec is None:
        return [f"x{i}" for i in range(policy.network.input_size)]
    names: list[str] = policy.spec.inputs.names
    return names


def _action_names(policy: HasNetwork) -> list[tuple[str, str]]:
    if policy.spec is None:
        return [(f"action {i}", "") for i in range(policy.network.output_size)]
    if policy.spec.choice is not None:
        return [(f"{policy.spec.choice.name} {i}", "") for i in range(policy.network.output_size)]
    return [(action.name, action.unit) for action in policy.spec.action]


def _polynomial(
    model: TaylorModel, action: int, scaled: list[sympy.Expr], first: TaylorModel, entries: list[sympy.Symbol]
) -> tuple[sympy.Expr, dict[str, float]]:
    import sympy

    order_of_entries = first.linear.moved_neurons()[0]
    variables = [scaled[entry] for entry in order_of_entries]
    linear = model.linear.dense()[0, :, action]
    polynomial = sympy.Float(float(model.constant[0, action]))
    polynomial += sum(float(c) * z for c, z in zip(linear, variables, strict=True))
    if model.higher is not None and model.basis is not None:
        exponents = model.basis.exponents[model.basis.variables :]
        for coefficient, powers in zip(model.higher[0, :, action], exponents, strict=True):
            if coefficient:
                polynomial += float(coefficient) * sympy.prod(
                    [z ** int(p) for z, p in zip(variables, powers, strict=True) if p]
                )
    effect = {
        str(entries[entry])[2:]: float(abs(c)) for entry, c in zip(order_of_entries, linear, strict=True) if c
    }
    return polynomial, dict(sorted(effect.items(), key=lambda item: -item[1]))
