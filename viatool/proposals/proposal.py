"""A specification that is proposed: what was found, what was guessed, and how to check it."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from typing import Any

FILL_IN = "FILL_IN"
"""Stands where nothing may be guessed; a specification that holds it is refused, by line and field."""

_WIDTH = 116


@dataclass(frozen=True)
class PolicyFacts:
    """What is known of a policy without a specification.

    Parameters
    ----------
    inputs, outputs : int
        Length of the observation, and how many numbers the network gives.
    squashed : bool
        Whether the last thing that the network does is a squash, so that its numbers are in [-1, 1].
    limits : tuple of (float, float), optional
        The least and the largest command of each output, where the file says or bounds them; outputs are commands
        then.
    chooses : bool or None
        Whether the largest output chooses a command; None where it is not known.
    ranges : tuple of (float, float), optional
        Of each input, where the file says them.
    ports : tuple of (str, int)
        The inputs of the graph and their sizes, in the order of the observation, where it has several.
    output : str, optional
        The output of the graph that is the action, where it has several.
    memory : tuple of (str, str)
        Further inputs of the graph and the outputs of the step before that they seem to take.
    """

    inputs: int
    outputs: int
    squashed: bool = False
    limits: tuple[tuple[float, float], ...] | None = None
    chooses: bool | None = None
    ranges: tuple[tuple[float, float], ...] | None = None
    ports: tuple[tuple[str, int], ...] = ()
    output: str | None = None
    memory: tuple[tuple[str, str], ...] = ()

    @property
    def names(self) -> dict[str, Any]:
        """Return the entries of a specification that name inputs and outputs of the graph."""
        ports = {"input": [name for name, _ in self.ports]} if self.ports else {}
        memory = {"memory": dict(self.memory)} if self.memory else {}
        return ports | ({} if self.output is None else {"output": self.output}) | memory

    @property
    def guesses(self) -> tuple[Guess, ...]:
        """Return what the names of inputs and outputs had to be trusted for."""
        return tuple(
            Guess(
                f"'{given}' is a memory that the input '{taken}' takes in the step after, zeros at first",
                "the loop that runs the policy",
            )
            for taken, given in self.memory
        )


@dataclass(frozen=True)
class Guess:
    """One thing that no file said.

    Parameters
    ----------
    what : str
        Was assumed.
    check : str
        Where to look.
    meaning : bool
        Whether it is about what the numbers of the observation are; then it goes with them, where somebody says better.
    """

    what: str
    check: str
    meaning: bool = False

    def __str__(self) -> str:
        """Return it as one line."""
        return f"{self.what} ({self.check})"


@dataclass(frozen=True)
class Proposal:
    """A specification of schema version 2, proposed.

    Parameters
    ----------
    observation, action : list of dict
        The channels, as they stand in a file.
    source : str
        What it was made of.
    guesses : tuple of Guess
        Everything that has to be checked.
    more : dict
        Further entries of the specification.
    """

    observation: list[dict[str, Any]]
    action: list[dict[str, Any]]
    source: str
    guesses: tuple[Guess, ...] = ()
    more: dict[str, Any] | None = None

    @property
    def document(self) -> dict[str, Any]:
        """Return the specification as it stands in a file."""
        head = {"schema_version": 2, "robot": "?", "control_interval": 0.1}
        more = dict(self.more or {})
        training = {"training": more.pop("training")} if "training" in more else {}
        return {**head, **more, "observation": self.observation, "action": self.action, **training}

    @property
    def is_complete(self) -> bool:
        """Tell whether nothing is left to fill in."""
        return FILL_IN not in str(self.document)

    def to_yaml(self) -> str:
        """Return a sidecar file; comments say what was guessed, and how to check it."""
        import yaml

        guesses = [
            *self.guesses,
            *(() if "robot" in (self.more or {}) else (Guess("robot is '?'", "a name for reports"),)),
            *(
                ()
                if "control_interval" in (self.more or {})
                else (Guess("control_interval is 0.1 s", "the step of the environment"),)
            ),
        ]
        lines = [
            f"Proposed by viatool from {self.source}.",
            "GUESSED, to be checked against the program that trained the policy:",
            *(f"- {guess}" for guess in guesses),
            "Then let `viatool doctor POLICY --spec THIS_FILE --map MAP` drive it, as specified and otherwise.",
        ]
        if not self.is_complete:
            lines.append(f"Replace every {FILL_IN}: the file is refused until then.")
        head = "".join(
            textwrap.fill(line, _WIDTH, initial_indent="# ", subsequent_indent="#   ") + "\n"
            for line in lines
        )
        body: str = yaml.safe_dump(
            self.document, sort_keys=False, allow_unicode=True, width=_WIDTH, default_flow_style=None
        )
        return head + body
