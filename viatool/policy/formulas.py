"""What sympy made of the declared activations, as Python source: their branches, each with its derivatives.

The formulas of the activations that come with viatool are stored beside this file, so that no command waits for sympy.
`python -m viatool.policy.derivation` writes them anew; a test compares them with what sympy makes of the declarations.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

STORED = Path(__file__).with_name("formulas.json")

DERIVATIVES = 6
"""How often a stored branch is derived, as tables of the compiled engine and models up to order 5 ask for it."""

LONG, LONG_DERIVATIVES = 400, 4
"""A third derivative with more operations is long, and its branch is derived less often."""


@dataclass(frozen=True)
class Form:
    """The form that an expression takes: it is the same for all values of its free parameters.

    Parameters
    ----------
    name : str
        Of the activation.
    given : tuple of (str, float)
        Parameters whose value decides the form.
    free : tuple of str
        The others.
    """

    name: str
    given: tuple[tuple[str, float], ...]
    free: tuple[str, ...]

    @property
    def key(self) -> str:
        """Return under what its formulas are stored, if they are."""
        return " ".join([self.name, *(f"{name}={value!r}" for name, value in self.given)])


@dataclass(frozen=True)
class Branch:
    """One smooth branch of a function of ``x`` and of the free parameters of its form; all of it is Python source.

    Parameters
    ----------
    condition : str
        Where the branch holds, unless one before it does.
    thresholds : list of str
        Where its condition turns: rational expressions of the parameters.
    is_straight : bool
        Whether it is a straight line.
    derivatives : list of list of str
        For the value and each derivative, what is computed line by line; the last line is the result.
    operations : list of int
        How many operations each of them has.
    """

    condition: str
    thresholds: list[str]
    is_straight: bool
    derivatives: list[list[str]]
    operations: list[int]


@lru_cache(maxsize=1)
def _all_stored() -> dict[str, list[dict[str, Any]]]:
    return json.loads(STORED.read_text(encoding="utf-8"))  # type: ignore[no-any-return]


def stored(form: Form) -> tuple[Branch, ...] | None:
    """Read the formulas of a form; None if they do not come with viatool."""
    entries = _all_stored().get(form.key)
    return None if entries is None else tuple(Branch(**entry) for entry in entries)


def written(formulas: dict[str, tuple[Branch, ...]]) -> str:
    """Return formulas of forms, by their keys, as they are stored."""
    entries = {key: [asdict(branch) for branch in branches] for key, branches in formulas.items()}
    return json.dumps(entries, indent=1) + "\n"


class Formulas:
    """The branches of one function, whose free parameters have values.

    Parameters
    ----------
    branches : tuple of Branch
        As stored, or derived.
    values : dict
        The free parameters.
    derive : callable
        Gives the branches with as many derivatives as it is asked for.
    """

    def __init__(
        self,
        branches: tuple[Branch, ...],
        values: dict[str, float],
        derive: Callable[[int], tuple[Branch, ...]],
    ) -> None:
        self.branches = branches
        self._values = values
        self._derive = derive

    def derivative(
        self, branch: int, order: int, functions: Mapping[str, Any], of: Callable[[float], Any] = np.float64
    ) -> Callable[[Any], Any]:
        """Return what computes a derivative of a branch, with these functions; `of` makes numbers of parameters."""
        if order >= len(self.branches[branch].derivatives):
            self.branches = self._derive(order)
        return self._compiled(self.branches[branch].derivatives[order], functions, of)

    def condition(self, branch: int) -> Callable[[Any], Any]:
        """Return what tells of points whether the condition of a branch holds."""
        return self._compiled([self.branches[branch].condition], {}, np.float64)

    def thresholds(self) -> set[float]:
        """Return where conditions turn: of each such place the nearest float64."""
        sources = {source for branch in self.branches for source in branch.thresholds}
        return {float(self._exactly([source], 0.0)) for source in sources}

    def branch_at(self, x: float) -> int:
        """Return the branch that holds at a point."""
        held = (self._exactly([branch.condition], x) for branch in self.branches)
        return next(index for index, holds in enumerate(held) if holds)

    def _exactly(self, lines: list[str], x: float) -> Any:
        """Compute with fractions; with floats where something is divided by 0."""
        try:
            return self._compiled(lines, {}, Fraction)(Fraction(x))
        except ZeroDivisionError:
            with np.errstate(all="ignore"):
                return self._compiled(lines, {}, np.float64)(np.float64(x))

    def _compiled(
        self, lines: list[str], functions: Mapping[str, Any], of: Callable[[float], Any]
    ) -> Callable[[Any], Any]:
        body = "".join(f"    {line}\n" for line in (*lines[:-1], f"return {lines[-1]}"))
        source = f"def formula({', '.join(('x', *self._values))}):\n{body}"
        namespace = dict(functions)
        exec(compile(source, "<formula>", "exec"), namespace)
        formula, values = namespace["formula"], tuple(map(of, self._values.values()))
        return lambda x: formula(x, *values)
