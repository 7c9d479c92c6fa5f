"""Expressions on the names of cells mean what they mean in pytest."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from viatool.errors import ConfigurationError
from viatool.projects import Selection

NAMES = ("drive/via/lab", "drive/td3/lab", "drive/via/hall/criterion=braking", "whole/via/lab")


@pytest.mark.parametrize(
    ("expression", "meant"),
    [
        ("", (0, 1, 2, 3)),
        ("LAB", (0, 1, 3)),
        ("lab and via", (0, 3)),
        ("not via", (1,)),
        ("lab and not (td3 or whole)", (0,)),
        ("criterion=braking or td3", (1, 2)),
        ("not not td3", (1,)),
    ],
)
def test_words_are_parts_of_names(expression: str, meant: tuple[int, ...]) -> None:
    chosen = Selection(expression)
    assert tuple(k for k, name in enumerate(NAMES) if chosen(name)) == meant


@pytest.mark.parametrize("expression", ["and", "lab and", "(lab", "lab)", "not", "lab via", "()"])
def test_what_is_no_expression_is_refused(expression: str) -> None:
    with pytest.raises(ConfigurationError, match="selects nothing"):
        Selection(expression)


WORDS = st.sampled_from(["via", "td3", "lab", "hall", "whole"])
EXPRESSIONS = st.recursive(
    WORDS,
    lambda inner: st.one_of(
        inner.map(lambda text: f"not ({text})"),
        st.tuples(inner, st.sampled_from(["and", "or"]), inner).map(lambda t: f"({t[0]}) {t[1]} ({t[2]})"),
    ),
    max_leaves=8,
)


@given(EXPRESSIONS, st.sampled_from(NAMES))
def test_an_expression_means_what_python_makes_of_it(expression: str, name: str) -> None:
    truth = {word: word in name for word in ("via", "td3", "lab", "hall", "whole")}
    assert Selection(expression)(name) == eval(expression, {}, truth)
