"""Options of the commands as a project file writes them: which there are, and the command line that gives them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import click

from viatool.errors import ConfigurationError

OWN = {
    "output": "name formats in 'reports'",
    "quiet": "each cell keeps what it prints in its folder",
    "verbose": "each cell keeps what it prints in its folder",
    "checkpoint": "viatool run keeps what is not finished itself",
    "resume": "give --resume to viatool run",
    "accepted": "write [[accepted]] tables",
    "threads": "give --threads to viatool run",
    "map": "name maps in 'maps'",
    "help": "run viatool COMMAND --help",
}
"""Options that are not a cell's to give, with what there is instead."""


@dataclass(frozen=True)
class Catalogue:
    """What a check may be.

    Parameters
    ----------
    commands : mapping
        The commands by kind. Each takes a policy, and options.
    gate : frozenset of str
        Names of the options that make the gate.
    """

    commands: Mapping[str, click.Command]
    gate: frozenset[str]

    def command(self, kind: str) -> click.Command:
        """Return the command of a kind.

        Raises
        ------
        ConfigurationError
            If no check is of that kind.
        """
        if kind not in self.commands:
            raise ConfigurationError(
                f"'{kind}' is no kind of check", f"choose one of {', '.join(self.commands)}"
            )
        return self.commands[kind]

    def has(self, kind: str, name: str) -> bool:
        """Tell whether a kind of check has an option."""
        return spelled(name) in options_of(self.command(kind))

    def require(self, kinds: Sequence[str], names: Mapping[str, Any], *, gate: bool = False) -> None:
        """Refuse options that none of some kinds has, or in a gate what makes none.

        Raises
        ------
        ConfigurationError
            Names the option, and one that is meant perhaps.
        """
        known = dict.fromkeys(name for kind in kinds for name in options_of(self.command(kind)))
        if gate:
            known = {name: None for name in known if name in self.gate}
        for name in map(spelled, names):
            if name in OWN:
                raise ConfigurationError(f"'{name}' is not given to a cell", OWN[name])
            if name not in known:
                raise ConfigurationError(
                    f"'{name}' is not a known key{_of(kinds, gate)}", _meant(name, known)
                )


def _of(kinds: Sequence[str], gate: bool) -> str:
    return " of a gate" if gate else f", nor an option of viatool {' or '.join(dict.fromkeys(kinds))}"


def _meant(name: str, known: Mapping[str, Any]) -> str:
    near = get_close_matches(name, known, 1)
    return f"write '{near[0]}' if you mean that" if near else f"choose among {', '.join(known)}"


def spelled(name: str) -> str:
    """Return the name of an option as the command line has it, without dashes before it."""
    return name.replace("_", "-")


def options_of(command: click.Command) -> dict[str, click.Option]:
    """Return the options of a command that a cell may give, by their long names."""
    found: dict[str, click.Option] = {}
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            names = [name.removeprefix("--") for name in parameter.opts if name.startswith("--")]
            found.update({name: parameter for name in names if name not in OWN})
    return found


def arguments_of(command: click.Command, options: Mapping[str, Any]) -> list[str]:
    """Return options with their values as the words of a command line.

    Parameters
    ----------
    command : click.Command
        Which has the options.
    options : mapping
        Values as TOML has them: a list or a table for an option that may be repeated, true for a flag, a list for
        numbers between commas.

    Raises
    ------
    ConfigurationError
        If a value is not of a kind that its option takes.
    """
    known, words = options_of(command), []
    for name, value in options.items():
        option = known[spelled(name)]
        if option.is_flag != isinstance(value, bool):
            wanted = "true or false" if option.is_flag else "a value"
            raise ConfigurationError(f"'{name}' is {_shown(value)}", f"give it {wanted}")
        if option.is_flag:
            words += [f"--{spelled(name)}"] * bool(value)
            continue
        texts = list(_texts(value)) if option.multiple else [_text(value)]
        words += [f"--{spelled(name)}={text}" for text in texts]
    return words


def _texts(value: Any) -> Iterator[str]:
    """Yield what is given to an option that may be repeated."""
    if isinstance(value, Mapping):
        yield from (f"{name}={_text(part)}" for name, part in value.items())
    elif isinstance(value, list | tuple):
        yield from map(_text, value)
    else:
        yield _text(value)


def _text(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ",".join(map(_text, value))
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise ConfigurationError(f"{_shown(value)} cannot be given to an option", "write a text or a number")
    return value if isinstance(value, str) else repr(value)


def _shown(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value)


def read_overrides(words: Sequence[str], catalogue: Catalogue) -> dict[str, Any]:
    """Read options of commands from the words of a command line.

    Parameters
    ----------
    words : sequence of str
        Such as ``--eps 0.02 --only-contested``.
    catalogue : Catalogue
        What there is.

    Returns
    -------
    dict
        Values as a project file would have them; what is repeated is a list.

    Raises
    ------
    ConfigurationError
        If a word is no option, or lacks its value.
    """
    known = {
        name: option for found in catalogue.commands.values() for name, option in options_of(found).items()
    }
    given: dict[str, Any] = {}
    rest = list(words)
    while rest:
        name, equals, value = rest.pop(0).partition("=")
        option = known.get(name.removeprefix("--")) if name.startswith("--") else None
        if option is None:
            raise ConfigurationError(
                f"no option '{name}' of viatool run, nor of {', '.join(catalogue.commands)}",
                _meant(name.removeprefix("--"), known),
            )
        key = name.removeprefix("--")
        if option.is_flag:
            given[key] = True
            continue
        if not equals:
            if not rest:
                raise ConfigurationError(f"option '{name}' lacks its value", f"write {name} VALUE")
            value = rest.pop(0)
        if key in given and not option.multiple:
            raise ConfigurationError(f"option '{name}' is given twice, and takes one value", "leave one out")
        given[key] = [*given.get(key, ()), value] if option.multiple else value
    return given


def seen_from(root: Path, options: Mapping[str, Any], catalogue: Catalogue) -> dict[str, Any]:
    """Return options whose relative paths begin in the current folder, for cells whose paths begin in another."""
    if root == Path.cwd():
        return dict(options)
    takes_path = {
        name
        for found in catalogue.commands.values()
        for name, option in options_of(found).items()
        if isinstance(option.type, click.Path)
    }
    return {
        name: str(Path(value).absolute()) if name in takes_path and Path(value).exists() else value
        for name, value in options.items()
    }
