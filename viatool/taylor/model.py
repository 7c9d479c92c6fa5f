"""Batched Taylor models: a polynomial in the inputs, symbolic remainders, and an interval remainder.

For B states and N neurons a model stands for the set

    constant + linear(z) + higher(z) + sum_k symbols[k](e_k) + remainder * [-1, 1],   z, e_k in [-1, 1]^...

where z are the scaled input errors and every e_k belongs to the approximation error of one activation node, so that
these errors cancel where the network subtracts them (POLAR's symbolic remainders). Arrays put the monomials before the
neurons, ``(B, M, N)``, so that an affine map is one matrix product.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.policy.network import Affine
from viatool.rounding import ENGINE_ROUNDOFF, SLIGHTLY_MORE
from viatool.taylor.basis import Basis
from viatool.taylor.forms import Dense, Diagonal, Form, fold_symbols, join_forms
from viatool.taylor.rounding import gamma


@dataclass(frozen=True, eq=False)
class TaylorModel:
    """A batch of Taylor models.

    Parameters
    ----------
    constant : ndarray
        ``(B, N)``.
    linear : Form
        In the V scaled inputs.
    higher : ndarray or None
        ``(B, M, N)``: coefficients of degree 2 to k, on `basis`; None at order 1.
    symbols : mapping
        Node index to the forms in its symbolic remainders.
    remainder : ndarray
        ``(B, N)``, not negative: half-width of the interval remainder.
    radius : ndarray
        ``(B, N)``: a bound on the L1 norm of everything but the constant and the remainder.
    basis : Basis or None
        The monomials of `higher`.
    """

    constant: Floats
    linear: Form
    higher: Floats | None
    symbols: Mapping[int, Form]
    remainder: Floats
    radius: Floats
    basis: Basis | None = None

    @property
    def magnitude(self) -> Floats:
        """Return a bound (B, N) on the absolute value of the model and of every partial sum of it."""
        return np.abs(self.constant) + self.radius + self.remainder

    def rows(self, which: Indices) -> TaylorModel:
        """Return some of the states."""
        return TaylorModel(
            self.constant[which],
            self.linear.rows(which),
            None if self.higher is None else self.higher[which],
            {key: form.rows(which) for key, form in self.symbols.items()},
            self.remainder[which],
            self.radius[which],
            self.basis,
        )

    def hull(self) -> tuple[Floats, Floats]:
        """Enclose the range from the L1 norms: lower and upper bounds (B, N). **Sound:** yes."""
        reach = (self.radius + self.remainder) * SLIGHTLY_MORE + 2 * ENGINE_ROUNDOFF * np.abs(self.constant)
        return self.constant - reach, self.constant + reach


def affine_image(models: Sequence[TaylorModel], node: Affine) -> TaylorModel:
    """Map the models of its sources through an affine node.

    Notes
    -----
    **Sound:** yes; the float64 rounding of all products joins the remainder through the L1 norm of the coefficients:
    ``gamma_n (|W| magnitude + |b|)``. Weights that are themselves rounded add their `roundings` to n, and what was
    merged counts as large as it was before it cancelled.
    """
    first = models[0]
    constant, size, remainder = node.bias, node.bias_magnitude, np.zeros(node.size)
    linear: Form | None = None
    higher: Floats | None = None
    symbols: dict[int, Form] = {}
    terms = 2 + len(models) + node.roundings
    for model, weight, absolute, merged in zip(
        models, node.weights, node.absolute_weights, node.magnitudes, strict=True
    ):
        kept, spare = fold_symbols(model.symbols, model.remainder)
        terms += weight.shape[1]
        constant = constant + model.constant @ weight.T
        size = size + model.magnitude @ merged.T
        remainder = remainder + spare @ absolute.T
        linear = join_forms(linear, model.linear.mapped(weight, absolute))
        for key, form in kept.items():
            symbols[key] = join_forms(symbols.get(key), form.mapped(weight, absolute))
        if model.higher is not None:
            mapped = Dense(model.higher).mapped(weight).coefficients
            higher = mapped if higher is None else higher + mapped
    assert linear is not None
    rounding = gamma(terms, ENGINE_ROUNDOFF) * size + 1e-300
    radius = linear.norms()
    for form in symbols.values():
        radius = radius + form.norms()
    if higher is not None:
        radius = radius + np.abs(higher).sum(axis=1)
    return TaylorModel(
        constant,
        linear,
        higher,
        symbols,
        (remainder + rounding) * SLIGHTLY_MORE,
        radius * SLIGHTLY_MORE,
        first.basis,
    )


def polynomial_image(model: TaylorModel, coefficients: Floats, error: Floats, node: int) -> TaylorModel:
    """Substitute a model into polynomials ``sum_j coefficients[j] (x - model.constant)^j``, neuron by neuron.

    Parameters
    ----------
    model : TaylorModel
        The argument x.
    coefficients : ndarray
        ``(k+1, B, N)``.
    error : ndarray
        ``(B, N)``: error of the polynomial; with what is truncated it becomes the symbolic remainder of `node`.

    Notes
    -----
    **Sound:** yes. With ``x - c = q + s``, q the polynomial and s symbols and remainder, ``|s| <= S``, ``|q| <= Q``:
    powers of q are kept up to degree k, what overflows is bounded by the norms of its factors by degree, and
    ``|(q+s)^j - q^j| <= (Q+S)^j - Q^j``.
    """
    slope = coefficients[1]
    linear = model.linear.scaled(slope)
    symbols = {key: form.scaled(slope) for key, form in model.symbols.items()}
    size = np.abs(slope) * model.magnitude + np.abs(coefficients[0])
    higher: Floats | None = None
    terms = 4
    if model.basis is not None:
        assert model.higher is not None
        higher, truncated, extra = _higher_powers(model, coefficients)
        error = error + truncated
        size = size + extra
        terms += 4 * model.basis.order * model.basis.size
    remainder = (
        np.abs(slope) * model.remainder + gamma(terms, ENGINE_ROUNDOFF) * size
    ) * SLIGHTLY_MORE + 1e-300
    fresh, remainder = _fresh_symbols(error * SLIGHTLY_MORE, np.abs(slope) * model.radius, remainder)
    radius = np.abs(slope) * model.radius
    if fresh is not None:
        symbols[node] = fresh
    if higher is not None:
        radius = linear.norms() + np.abs(higher).sum(axis=1)
        radius = radius + sum((form.norms() for form in symbols.values()), np.zeros_like(radius))
    elif fresh is not None:
        radius = radius + fresh.norms()
    return TaylorModel(
        coefficients[0], linear, higher, symbols, remainder, radius * SLIGHTLY_MORE, model.basis
    )


def product_image(left: TaylorModel, right: TaylorModel, node: int) -> TaylorModel:
    """Multiply two models neuron by neuron.

    Notes
    -----
    **Sound:** yes. ``x y = a b + a dy + b dx + dx dy`` with constants a, b; of ``dx dy`` the polynomial part is kept up
    to degree k, and the rest, bounded by norms, becomes the symbolic remainder of `node`.
    """
    constant = left.constant * right.constant
    sides = ((left, right.constant), (right, left.constant))
    linear: Form | None = None
    symbols: dict[int, Form] = {}
    for model, factor in sides:
        linear = join_forms(linear, model.linear.scaled(factor))
        for key, form in model.symbols.items():
            symbols[key] = join_forms(symbols.get(key), form.scaled(factor))
    assert linear is not None
    spread_left, spread_right = left.radius + left.remainder, right.radius + right.remainder
    error = spread_left * spread_right
    higher: Floats | None = None
    terms = 8
    if left.basis is not None:
        higher, error = _higher_product(left, right)
        terms += 4 * left.basis.size
    size = left.magnitude * right.magnitude
    remainder = np.abs(left.constant) * right.remainder + np.abs(right.constant) * left.remainder
    remainder = (remainder + gamma(terms, ENGINE_ROUNDOFF) * size) * SLIGHTLY_MORE + 1e-300
    fresh, remainder = _fresh_symbols(error * SLIGHTLY_MORE, left.radius + right.radius, remainder)
    if fresh is not None:
        symbols[node] = fresh
    radius = linear.norms() + sum((form.norms() for form in symbols.values()), np.zeros_like(constant))
    if higher is not None:
        radius = radius + np.abs(higher).sum(axis=1)
    return TaylorModel(constant, linear, higher, symbols, remainder, radius * SLIGHTLY_MORE, left.basis)


def _higher_product(left: TaylorModel, right: TaylorModel) -> tuple[Floats, Floats]:
    """Return the kept terms of degree 2 to k of a product, and a bound on what is dropped."""
    basis = left.basis
    assert basis is not None
    assert left.higher is not None
    assert right.higher is not None
    bases = [
        np.concatenate([left.linear.dense(), left.higher], axis=1),
        np.concatenate([right.linear.dense(), right.higher], axis=1),
    ]
    norms = [basis.degree_norms(polynomial) for polynomial in bases]
    totals = [sum(norm[1:], norm[0]) for norm in norms]
    kept = left.constant[:, None] * right.higher + right.constant[:, None] * left.higher
    kept = kept + basis.truncated_product(*bases)[:, basis.variables :]
    overflow = sum(
        (
            norms[0][i] * norms[1][j]
            for i in range(basis.order)
            for j in range(basis.order)
            if i + j + 2 > basis.order
        ),
        np.zeros_like(totals[0]),
    )
    spreads = [model.radius + model.remainder for model in (left, right)]
    mixed = np.maximum(spreads[0] * spreads[1] - totals[0] * totals[1], 0)
    return kept, (overflow + mixed) * SLIGHTLY_MORE


def _higher_powers(model: TaylorModel, coefficients: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the kept terms of degree 2 to k, a bound on all that is dropped, and the size for the rounding."""
    basis, higher = model.basis, model.higher
    assert basis is not None
    assert higher is not None
    base = np.concatenate([model.linear.dense(), higher], axis=1)
    norms = basis.degree_norms(base)
    polynomial_norm = sum(norms[1:], norms[0])
    rest = (
        (model.radius - polynomial_norm).clip(min=0) + model.remainder + ENGINE_ROUNDOFF * 64 * model.radius
    )
    variables = basis.variables
    kept = coefficients[1][:, None] * higher
    dropped = np.zeros_like(rest)
    size = np.zeros_like(rest)
    power, power_overflow = base, np.zeros_like(rest)
    for degree in range(2, coefficients.shape[0]):
        power_norms = basis.degree_norms(power)
        overflow = sum(
            (
                power_norms[i] * norms[j]
                for i in range(basis.order)
                for j in range(basis.order)
                if i + j + 2 > basis.order
            ),
            np.zeros_like(rest),
        )
        power_overflow = power_overflow * polynomial_norm + overflow
        power = basis.truncated_product(power, base)
        weight = np.abs(coefficients[degree])
        kept = kept + coefficients[degree][:, None] * power[:, variables:]
        whole = (polynomial_norm + rest) ** degree
        dropped = dropped + weight * (power_overflow + np.maximum(whole - polynomial_norm**degree, 0))
        size = size + weight * whole
    return kept, dropped * SLIGHTLY_MORE, size


def _fresh_symbols(error: Floats, radius: Floats, remainder: Floats) -> tuple[Diagonal | None, Floats]:
    """Give each error that matters a symbol; the others join the remainder."""
    matters = error > 1e-9 * radius + 1e-14
    count = int(matters.sum(axis=1).max(initial=0))
    remainder = np.where(matters, remainder, (remainder + error) * SLIGHTLY_MORE)
    if count == 0:
        return None, remainder
    size = error.shape[1]
    if 4 * count > 3 * size:
        index = np.broadcast_to(np.arange(size), error.shape)
        return Diagonal(index, np.where(matters, error, 0.0), size), remainder
    index = np.argsort(~matters, axis=1, kind="stable")[:, :count]
    kept = np.take_along_axis(np.where(matters, error, 0.0), index, axis=1)
    return Diagonal(index, kept, size), remainder
