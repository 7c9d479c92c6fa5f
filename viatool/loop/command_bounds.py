"""What may be commanded in cells, and in sets of states."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from numpy.typing import NDArray

from viatool.arrays import Floats, Indices
from viatool.safety.pieces import CommandPieces
from viatool.taylor.correlated import LinearReach


@dataclass(frozen=True, eq=False)
class CommandBounds:
    """What the policy can command in C cells.

    Parameters
    ----------
    pieces : CommandPieces
        Boxes of commands (A,), of a differential drive v in m/s and omega in rad/s, as the robot carries them out: one
        of what the policy gives, and one for each command that it may choose, or that a rule may send.
    influence : ndarray
        (C, 1 + A) shares of their width that come from the pose, and from each entry of the command before.
    """

    pieces: CommandPieces
    influence: Floats

    @cached_property
    def ends(self) -> tuple[Floats, Floats]:
        """The ends of the box around all pieces of each cell, (C, A) each."""
        return self.pieces.hull()

    @property
    def lower(self) -> Floats:
        """Return the least numbers of a command, (C, A)."""
        return self.ends[0]

    @property
    def upper(self) -> Floats:
        """Return the largest numbers of a command, (C, A)."""
        return self.ends[1]

    def select(self, which: NDArray[Any]) -> CommandBounds:
        """Return those of some cells."""
        return CommandBounds(self.pieces.select(which), self.influence[which])


@dataclass(frozen=True, eq=False)
class SentReach:
    """What is sent in C sets of states: P pieces, each a form of the sets' symbols.

    Parameters
    ----------
    cell : ndarray
        (P,) the set of each piece, ascending; every set has one at least.
    reach : LinearReach
        P of them.
    """

    cell: Indices
    reach: LinearReach
