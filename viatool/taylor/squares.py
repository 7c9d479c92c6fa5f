"""Bounds that see curvature at the cost of order 1: what curved activations add is a sum of squares of linear forms.

At order 1 the error of a curved activation is one free symbol. But on its range the activation is nearly a parabola of
its argument, and the argument is a linear form of the symbols. So each error symbol may be traded for the square of a
form, with a far smaller error and without a monomial: for C neurons in V inputs that takes C V numbers, not C V^2 / 2.

What is left is the maximum of a quadratic over a cube, ``g.y + y^T Q y`` with ``Q = sum_c w_c f_c f_c^T``. For a
diagonal D with ``D - Q`` positive semidefinite, ``y^T D y <= trace D`` makes it concave (Shor's relaxation), and a
concave function lies below each of its tangents: for every z

    g.y + y^T Q y  <=  trace D + |g + 2 (Q - D) z|_1 + z^T (D - Q) z,      y in [-1, 1]^S.

Forms of many neurons in many inputs are nearly at right angles, so that D is far smaller than the sum of the squares'
ranges, which is what bounds neuron by neuron pay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.policy.network import Activation, Network
from viatool.rounding import ENGINE_ROUNDOFF, SLIGHTLY_MORE
from viatool.taylor.approximation import Approximation, approximate
from viatool.taylor.curve import curve_of
from viatool.taylor.duality import SymbolLayout
from viatool.taylor.propagation import Enclosure
from viatool.taylor.rounding import gamma

_STEPS = 6
_SQUARINGS = 3
_TINY = 1e-200


@dataclass(frozen=True, eq=False)
class SquareProblem:
    """Q maxima in each of K states of ``constant + linear . y + sum_c weights_c (forms_c . y)^2``, y in [-1, 1]^S.

    Parameters
    ----------
    constant : ndarray
        ``(K, Q)``.
    linear : ndarray
        ``(K, Q, S)``.
    weights : ndarray
        ``(K, Q, C)``.
    forms : ndarray
        ``(K, C, S)``, common to the questions of a state.
    size : ndarray
        ``(K, Q)``: the sum of the absolute values of all that was added up, by which roundings count.
    """

    constant: Floats
    linear: Floats
    weights: Floats
    forms: Floats
    size: Floats

    @classmethod
    def of(
        cls, network: Network, passes: Sequence[Enclosure], seed: Floats, *, neurons: int, rule: Approximation
    ) -> SquareProblem:
        """Ask for the largest ``seed . actions``.

        Parameters
        ----------
        network : Network
            A outputs.
        passes : sequence of Enclosure
            Of order 1, over K boxes.
        seed : ndarray
            ``(K, Q, A)``.
        neurons : int
            C at most: in every layer those whose error symbols weigh most are traded for squares.
        rule : str
            How activations are approximated.

        Notes
        -----
        **Sound:** yes. Where ``p(x)`` is within delta of an activation y, ``mu (p(x) - y)`` is at most ``|mu| delta``
        from 0 for any mu, so it may be added to the question; mu is what cancels the error symbol of y.
        """
        model = passes[-1].model
        layout = SymbolLayout.of(model)
        everyone = np.broadcast_to(np.arange(network.output_size), model.constant.shape)
        form, constant, spare = layout.columns(model, everyone)
        problem = cls(
            _dot(seed, constant) + _dot(np.abs(seed), spare),
            seed @ form,
            np.zeros((*seed.shape[:2], 0)),
            np.zeros((seed.shape[0], 0, layout.size)),
            _dot(np.abs(seed), np.abs(constant) + np.abs(form).sum(axis=2) + spare),
        )
        curved = [key for key in layout.slices if key and _is_curved(network, key)]
        for key in reversed(curved):
            place, symbol = layout.slices[key], passes[key].model.symbols[key]
            weight = np.abs(problem.linear[:, :, place]).sum(axis=1)
            slots = np.argsort(-weight, axis=1)[:, : max(1, neurons // len(curved))]
            moved = np.take_along_axis(symbol.moved_neurons(), slots, axis=1)
            problem = problem._traded(network, passes, key, moved, place.start + slots, layout, rule)
        return problem

    def _traded(
        self,
        network: Network,
        passes: Sequence[Enclosure],
        key: int,
        neurons: Indices,
        symbols: Indices,
        layout: SymbolLayout,
        rule: Approximation,
    ) -> SquareProblem:
        """Trade the error symbols (K, C') of some neurons (K, C') of an activation node for squares."""
        node = network.nodes[key]
        assert isinstance(node, Activation)
        argument, result = passes[node.source], passes[key]
        lower, upper = (np.take_along_axis(side, neurons, axis=1) for side in argument.hull)
        form, centre, spare = layout.columns(argument.model, neurons)
        result_form, result_centre, result_spare = layout.columns(result.model, neurons)
        polynomial = approximate(
            curve_of(node.function), lower.ravel(), upper.ravel(), 2, rule, centre.ravel()
        )
        offset, slope, bend = polynomial.coefficients.reshape(3, *lower.shape)
        norm, result_norm = np.abs(form).sum(axis=2), np.abs(result_form).sum(axis=2)
        error = polynomial.error.reshape(lower.shape) + result_spare
        error = error + np.abs(slope) * spare + np.abs(bend) * spare * (2 * norm + spare)
        size = np.abs(offset) + np.abs(result_centre) + np.abs(slope) * norm + result_norm
        size = size + np.abs(bend) * (norm + spare) ** 2 + error
        places = np.broadcast_to(symbols[:, None], (*self.constant.shape, symbols.shape[1]))
        share = np.take_along_axis(self.linear, places, axis=2)
        radius = np.take_along_axis(result_form, symbols[:, :, None], axis=2)[:, :, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            factor = np.where(radius[:, None] > 0, share / radius[:, None], 0.0)  # (K, Q, C')
        return SquareProblem(
            self.constant
            + _dot(factor, offset - result_centre)
            + _dot(np.abs(factor), error * SLIGHTLY_MORE),
            self.linear + factor @ (slope[:, :, None] * form - result_form),
            np.concatenate([self.weights, factor * bend[:, None]], axis=2),
            np.concatenate([self.forms, form], axis=1),
            self.size + _dot(np.abs(factor), size),
        )

    def upper(self) -> Floats:
        """Return upper bounds (K, Q): the lowest tangent on an accelerated ascent of the concave relaxation.

        **Sound:** yes, from whatever point the tangent is taken; roundings counted.
        """
        scale = np.maximum(self.weights, 0.0) @ self.forms**2 + _TINY
        norms = self._norms(scale)
        diagonal = scale * norms[:, :, None] * SLIGHTLY_MORE  # D
        bend = diagonal + norms.max(axis=1)[:, None, None] * (np.maximum(-self.weights, 0.0) @ self.forms**2)
        top = self.constant + diagonal.sum(axis=2)
        bound = top + np.abs(self.linear).sum(axis=2)
        point = ahead = np.clip(self.linear / (2 * bend), -1.0, 1.0)
        momentum = 1.0
        for _ in range(_STEPS):
            squares = (self.weights * (ahead @ np.swapaxes(self.forms, 1, 2))) @ self.forms  # Q z
            slope = self.linear + 2 * (squares - diagonal * ahead)
            tangent = top + np.abs(slope).sum(axis=2) + (ahead * (diagonal * ahead - squares)).sum(axis=2)
            bound = np.fmin(bound, tangent)
            reached = np.clip(ahead + slope / (2 * bend), -1.0, 1.0)
            longer = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
            ahead = np.clip(reached + (momentum - 1) / longer * (reached - point), -1.0, 1.0)
            point, momentum = reached, longer
        size = self.size + np.abs(self.constant) + np.abs(self.linear).sum(axis=2) + 4 * diagonal.sum(axis=2)
        size = size + 4 * _dot(np.abs(self.weights), np.abs(self.forms).sum(axis=2) ** 2)
        terms = 8 * (self.forms.shape[1] + self.forms.shape[2]) + 64
        return np.asarray(bound + gamma(terms, ENGINE_ROUNDOFF) * size * SLIGHTLY_MORE + _TINY)

    def _norms(self, scale: Floats) -> Floats:
        """Return factors (K, Q) with which the diagonal `scale` (K, Q, S) of the positive part of Q lies above it.

        **Sound:** yes. With ``B = sqrt(w) F / sqrt(scale)`` that part is at most ``|B B^T|_2 scale`` as a form; the
        rounding of B B^T is at most ``gamma |B|_F^2``, and ``|B|_F^2`` at most S.
        """
        positive = np.maximum(self.weights, 0.0)
        terms = self.forms.shape[2] + 16
        rounding = terms * gamma(terms, ENGINE_ROUNDOFF)
        norms = np.empty_like(self.constant)
        for question in range(self.constant.shape[1]):
            weights = positive[:, question]
            most = int((weights > 0).sum(axis=1).max(initial=0))
            rows = np.argsort(-weights, axis=1)[:, :most]  # squares of other weights have no part in it
            forms = self.forms[np.arange(len(rows))[:, None], rows]
            forms *= np.sqrt(np.take_along_axis(weights, rows, axis=1))[:, :, None]
            forms /= np.sqrt(scale[:, question, None])
            norms[:, question] = spectral_norm(forms @ np.swapaxes(forms, 1, 2)) + rounding
        return norms


def spectral_norm(matrices: Floats, squarings: int = _SQUARINGS) -> Floats:
    """Bound the spectral norms of matrices (..., C, C) from above, to within a small power of their rank.

    Notes
    -----
    **Sound:** yes. ``|M|^2 = |M^T M|``, repeated, and at last the Frobenius norm, which is at least the spectral one;
    each product of matrices of Frobenius norm 1 is off by at most gamma_C.
    """
    count = matrices.shape[-1]
    size = np.sqrt((matrices**2).sum(axis=(-2, -1))) * (1 + gamma(count**2 + 8, ENGINE_ROUNDOFF))
    if not squarings:
        return np.asarray(size)
    unit = matrices / np.where(size > 0, size, 1.0)[..., None, None]
    rounding = gamma(count + 8, ENGINE_ROUNDOFF)
    square = spectral_norm(np.swapaxes(unit, -1, -2) @ unit, squarings - 1)
    return np.asarray(size * np.sqrt(square + rounding) * SLIGHTLY_MORE)


def _is_curved(network: Network, key: int) -> bool:
    node = network.nodes[key]
    return isinstance(node, Activation) and not curve_of(node.function).cells(1).is_stepwise


def _dot(left: Floats, right: Floats) -> Floats:
    """Multiply ``(K, Q, N)`` with vectors ``(K, N)``: (K, Q)."""
    return np.asarray((left @ right[:, :, None])[:, :, 0])
