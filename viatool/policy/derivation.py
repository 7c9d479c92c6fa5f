"""Derive the formulas of activations from their declarations by sympy.

Run as a script, it stores those of all activations that are declared: ``python -m viatool.policy.derivation``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache
from itertools import count, product

import sympy
from sympy.printing.lambdarepr import LambdaPrinter

from viatool.policy.activations import activation, declared_activations
from viatool.policy.algebra import Expression
from viatool.policy.formulas import DERIVATIVES, LONG, LONG_DERIVATIVES, STORED, Branch, Form, written
from viatool.policy.symbols import X, exact

_EXPONENTS = (2.0, 3.0, 4.0)
"""Of the powers that are stored: those that networks have."""


class _Printer(LambdaPrinter):  # type: ignore[misc]  # sympy carries no types
    """Print conditions so that they hold for arrays as well."""

    def _print_And(self, expr: Expression) -> str:  # noqa: N802  # sympy calls it so
        return " & ".join(f"({self._print(part)})" for part in expr.args)

    def _print_Or(self, expr: Expression) -> str:  # noqa: N802
        return " | ".join(f"({self._print(part)})" for part in expr.args)

    def _print_Not(self, expr: Expression) -> str:  # noqa: N802
        return f"~({self._print(expr.args[0])})"


@lru_cache(maxsize=256)
def derived(
    form: Form, declared: Callable[..., Expression], derivatives: int | None = None
) -> tuple[Branch, ...]:
    """Derive the branches of a form, left open what its free parameters are.

    Parameters
    ----------
    form : Form
        The form.
    declared : callable
        Makes the expression of x and the parameters.
    derivatives : int or None
        How often each branch is derived; None for as often as branches are stored.
    """
    free = {name: sympy.Symbol(name, real=True) for name in form.free}
    given = {name: exact(value) for name, value in form.given}
    expression = sympy.piecewise_fold(sympy.sympify(declared(X, **given, **free)))
    pairs = expression.args if expression.is_Piecewise else [(expression, sympy.true)]
    found = [(_derivatives(branch, 3), condition) for branch, condition in pairs]
    if derivatives is None:
        long = max(_operations(parts[3]) for parts, _ in found) > LONG
        derivatives = LONG_DERIVATIVES if long else DERIVATIVES
    return tuple(_branch(_derivatives(parts[0], derivatives), condition) for parts, condition in found)


def _derivatives(expression: Expression, most: int) -> list[Expression]:
    """Return a function and its derivatives, each from the one before: simplification takes seconds."""
    found = [expression]
    while len(found) <= most:
        found.append(found[-1].diff(X, simplify=False))
    return found


def _operations(expression: Expression) -> int:
    return int(sympy.count_ops(expression))


def _branch(derivatives: list[Expression], condition: Expression) -> Branch:
    relations = sorted(condition.atoms(sympy.core.relational.Relational), key=sympy.default_sort_key)
    return Branch(
        condition=_printed(condition),
        thresholds=[_printed(_threshold(relation)) for relation in relations],
        is_straight=derivatives[2] == 0,
        derivatives=list(map(_lines, derivatives)),
        operations=list(map(_operations, derivatives)),
    )


def _threshold(relation: Expression) -> Expression:
    """Return where a relation that is linear in x turns; sympy turns sides about as it likes."""
    apart = relation.lhs - relation.rhs
    slope = apart.diff(X)
    if slope.has(X):
        raise NotImplementedError(f"the condition {relation} is not linear in x")
    return sympy.simplify(-apart.subs(X, 0) / slope)


def _lines(expression: Expression) -> list[str]:
    """Return what computes an expression, what stands in it several times once."""
    names = (sympy.Symbol(f"x{index}") for index in count())
    parts, result = sympy.cse(expression, symbols=names, list=False)
    return [*(f"{name} = {_printed(part)}" for name, part in parts), _printed(result)]


def _printed(expression: Expression) -> str:
    settings = {"fully_qualified_modules": False, "inline": True, "allow_unknown_functions": True}
    return str(_Printer(settings).doprint(expression))


def stored_forms() -> Iterator[tuple[Form, Callable[..., Expression]]]:
    """Go through the forms of all declared activations: with their limits and without, the powers that occur."""
    for name in declared_activations():
        function = activation(name)
        choices = [
            _EXPONENTS
            if parameter == "exponent"
            else (0.0, value)
            if abs(value) == float("inf")
            else (value,)
            for parameter, value in function.parameters
        ]
        for values in product(*choices):
            parameters = dict(zip(function.named, values, strict=True))
            chosen = activation(name, **parameters)
            yield chosen.form, chosen.declaration.expression


if __name__ == "__main__":
    found = {form.key: derived(form, declared) for form, declared in stored_forms()}
    STORED.write_text(written(found), encoding="utf-8")
