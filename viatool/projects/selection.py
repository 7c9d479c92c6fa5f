"""Which cells are meant: an expression on their names, as pytest has it, and those that have not passed."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from viatool.errors import ConfigurationError

_TOKEN = re.compile(r"\s*(\(|\)|[^\s()]+)")

Test = Callable[[str], bool]


@dataclass(frozen=True)
class Selection:
    """An expression such as ``lab and not (td3 or braking)``: words are parts of names, in any case.

    Parameters
    ----------
    expression : str
        Empty for all.

    Raises
    ------
    ConfigurationError
        If it is no expression.
    """

    expression: str = ""

    def __post_init__(self) -> None:
        self._test()

    def __call__(self, name: str) -> bool:
        """Tell whether a name is meant."""
        return self._test()(name.casefold())

    def _test(self) -> Test:
        tokens = _TOKEN.findall(self.expression)
        if not tokens:
            return lambda name: True
        test, rest = self._either(tokens)
        if rest:
            raise self._wrong(f"'{rest[0]}' is one word too many")
        return test

    def _either(self, tokens: Sequence[str]) -> tuple[Test, Sequence[str]]:
        left, rest = self._both(tokens)
        if rest and rest[0] == "or":
            right, rest = self._either(rest[1:])
            return (lambda name: left(name) or right(name)), rest
        return left, rest

    def _both(self, tokens: Sequence[str]) -> tuple[Test, Sequence[str]]:
        left, rest = self._one(tokens)
        if rest and rest[0] == "and":
            right, rest = self._both(rest[1:])
            return (lambda name: left(name) and right(name)), rest
        return left, rest

    def _one(self, tokens: Sequence[str]) -> tuple[Test, Sequence[str]]:
        if not tokens or tokens[0] in ("and", "or", ")"):
            raise self._wrong("a word is missing")
        first, rest = tokens[0], tokens[1:]
        if first == "not":
            test, rest = self._one(rest)
            return (lambda name: not test(name)), rest
        if first == "(":
            test, rest = self._either(rest)
            if not rest or rest[0] != ")":
                raise self._wrong("a ')' is missing")
            return test, rest[1:]
        word = first.casefold()
        return (lambda name: word in name), rest

    def _wrong(self, what: str) -> ConfigurationError:
        return ConfigurationError(
            f"'{self.expression}' selects nothing: {what}", "write words with and, or, not and parentheses"
        )
