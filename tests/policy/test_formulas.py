"""The formulas that are stored with viatool are what sympy makes of the declarations, and they do without sympy."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
from fractions import Fraction

import numpy as np
import pytest

from tests.oracles import MP
from viatool.policy import activation_function, formulas
from viatool.policy.activations import activation, declared_activations
from viatool.policy.algebra import exp, pieces
from viatool.policy.derivation import derived, stored_forms
from viatool.policy.formulas import STORED, stored, written
from viatool.taylor.curve import Curve

FORMS = dict(stored_forms())


def test_every_declared_activation_is_stored_and_nothing_else() -> None:
    assert {form.name for form in FORMS} == set(declared_activations())
    assert list(json.loads(STORED.read_text())) == [form.key for form in FORMS]


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.key)
def test_what_is_stored_is_what_sympy_gives(form: formulas.Form) -> None:
    found = derived(form, FORMS[form])
    assert stored(form) == found
    text = json.loads(STORED.read_text())[form.key]
    assert json.loads(written({"": found}))[""] == text, "run python -m viatool.policy.derivation"


BUNDLED = """
import sys
import numpy as np
from viatool.policy.activations import activation, declared_activations
from viatool.taylor.curve import curve_of

of_scipy = {"Erf", "Gelu", "ErfGate"}
for name in declared_activations():
    function = activation(name)
    if name in of_scipy:
        continue
    if {"min", "max"} & set(function.named):
        function = activation(name, min=-0.75, max=0.5)
    curve_of(function).enclose(np.array([0.1]))
    curve_of(function).value(np.array([0.1]), 6 if curve_of(function).operations(3) <= 400 else 4)
    function(np.array([0.3]))
assert not {"sympy", "scipy"} & set(sys.modules), sorted({"sympy", "scipy"} & set(sys.modules))
for name in of_scipy:
    curve_of(activation(name)).range(np.array([0.1]), np.array([0.2]))
assert "sympy" not in sys.modules
"""


def test_activations_that_come_with_viatool_do_without_sympy() -> None:
    subprocess.run([sys.executable, "-c", BUNDLED], check=True)


def test_what_is_declared_anew_is_derived_by_sympy(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bump ``height exp(-x^2)``, cut to 0 beyond a limit by a condition within a condition."""
    monkeypatch.setattr(activation_function, "_DECLARATIONS", dict(activation_function._DECLARATIONS))

    @activation_function.declare("Bump", height=1.0, limit=2.0)
    def _bump(x, height, limit):
        return pieces((0, x < -limit), (pieces((height * exp(-(x**2)), x <= limit), (0, True)), True))

    curve = Curve(activation("Bump", height=3.0, limit=0.5))
    assert curve.breaks.tolist() == [-0.5, 0.5]
    x = np.linspace(-0.75, 0.75, 61)
    inside = np.abs(x) < 0.5
    for derivative in range(8):  # beyond what is derived at once
        with MP.workdps(40):
            exact = [MP.diff(lambda t: 3 * MP.exp(-(t**2)), value, derivative) for value in x.tolist()]
        found = curve.enclose(x, derivative)
        for k in np.flatnonzero(inside):
            assert found.lower[k] - 1e-9 <= exact[k] <= found.upper[k] + 1e-9
        assert (curve.value(x, derivative)[np.abs(x) > 0.5] == 0).all()
    np.testing.assert_allclose(curve.function(x), np.where(np.abs(x) <= 0.5, 3 * np.exp(-(x**2)), 0.0))


@pytest.mark.parametrize(
    ("alpha", "beta"), [(1 / 6, 0.5), (float(np.float32(1 / 6)), 0.3), (0.1, 0.7), (-0.3, 0.2)]
)
def test_kinks_are_the_nearest_floats_to_what_the_parameters_say(alpha: float, beta: float) -> None:
    a, b = Fraction(alpha), Fraction(beta)
    expected = sorted(float(kink) for kink in (-b / a, (1 - b) / a))
    assert Curve(activation("HardSigmoid", alpha=alpha, beta=beta)).breaks.tolist() == expected


def test_parameters_count_exactly() -> None:
    """A slope is a float64: nothing is added to it."""
    slopes = Curve(activation("LeakyRelu", alpha=0.1)).range(np.array([-2.0]), np.array([-1.0]), 1)
    assert slopes.lower == slopes.upper == 0.1


def test_functions_that_were_evaluated_are_still_sent_to_other_processes() -> None:
    """And they are the same bytes as before, for work is told apart by its bytes."""
    function = activation("Elu", alpha=0.5)
    before = pickle.dumps(function)
    function(np.linspace(-1.0, 1.0, 5))
    Curve(function).value(np.zeros(1), 1)
    assert pickle.dumps(function) == before
    assert pickle.loads(before) == function
