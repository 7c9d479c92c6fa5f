"""The monomials of degree 2 to k in V variables, and how products of them are collected."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from itertools import combinations_with_replacement

import numpy as np

from viatool.arrays import Floats, Indices


@dataclass(frozen=True, eq=False)
class Basis:
    """Monomials ``z^exponents[m]`` of degree 1 to `order`, by degree.

    Parameters
    ----------
    variables, order : int
        V variables, highest degree k.
    """

    variables: int
    order: int
    factors: tuple[Indices, ...] = field(repr=False)
    exponents: Indices = field(repr=False)
    starts: tuple[int, ...]
    products: tuple[tuple[Indices, ...], ...] = field(repr=False)

    def of_degree(self, degree: int) -> slice:
        """Return where the monomials of one degree stand on the axis of degrees 1 to k."""
        return slice(self.starts[degree - 1], self.starts[degree])

    @property
    def size(self) -> int:
        """Return the number of monomials of degree 1 to k."""
        return self.starts[-1]

    def truncated_product(self, left: Floats, right: Floats) -> Floats:
        """Multiply two polynomials without constant term, ``(B, M, N)`` each, keeping degrees up to k."""
        if self.order == 2:
            first, second = self.factors[1].T
            pairs = left[:, first] * right[:, second]
            pairs += left[:, second] * right[:, first]
            pairs[:, first == second] *= 0.5
            return np.concatenate([np.zeros_like(left[:, : self.variables]), pairs], axis=1)
        result = np.zeros_like(left)
        for low in range(1, self.order):
            targets = self.products[low - 1]
            count = self.of_degree(low).stop - self.of_degree(low).start
            for position in range(count):
                target = targets[position]
                factor = left[:, self.of_degree(low).start + position, None, :]
                result[:, target, :] += factor * right[:, : target.size, :]
        return result

    def degree_norms(self, polynomial: Floats) -> list[Floats]:
        """Return the L1 norm ``(B, N)`` of the coefficients of each degree 1 to k."""
        return [np.abs(polynomial[:, self.of_degree(d)]).sum(axis=1) for d in range(1, self.order + 1)]


@lru_cache(maxsize=32)
def monomial_basis(variables: int, order: int) -> Basis:
    """Return the monomials of degree 1 to `order` in some variables, with the tables of their products."""
    factors, exponents, starts = [], [], [0]
    for degree in range(1, order + 1):
        chosen = np.array(list(combinations_with_replacement(range(variables), degree)), dtype=np.intp)
        chosen = chosen.reshape(-1, degree)
        factors.append(chosen)
        power = np.zeros((chosen.shape[0], variables), dtype=np.intp)
        for column in chosen.T:
            power[np.arange(chosen.shape[0]), column] += 1
        exponents.append(power)
        starts.append(starts[-1] + chosen.shape[0])
    table = np.concatenate(exponents)
    index = {tuple(row): position for position, row in enumerate(table.tolist())} if order > 2 else {}
    products = []
    for low in range(1, order) if order > 2 else ():  # at order 2 the factors are all that a product needs
        partners = starts[order - low]  # monomials of degree 1 .. k - low
        rows = [
            np.array([index[tuple(row)] for row in (table[:partners] + table[m]).tolist()], dtype=np.intp)
            for m in range(starts[low - 1], starts[low])
        ]
        products.append(tuple(rows))
    return Basis(variables, order, tuple(factors), table, tuple(starts), tuple(products))
