"""The geometry of safe states: that every command of their boxes keeps its distance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.recheck.evidence import StoredEvidence, TablePart
from viatool.recheck.motion import Motion
from viatool.recheck.outcome import Outcome, numbered
from viatool.recheck.scene import EpisodeScenes

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]


def check_geometry(evidence: StoredEvidence, found: Outcome) -> None:
    """Confirm that safe states keep their distance under every command of their boxes, uncontested ones under any."""
    reasons = evidence.beyond()
    if reasons:
        found.not_rechecked.append(f"geometry of safe states: {', '.join(reasons)}")
        return
    found.not_rechecked.append("that states are contested which are said to be")
    scenes = EpisodeScenes(evidence)
    for part in evidence.parts:
        _Rows(evidence, part, scenes).check(found)


@dataclass
class _Rows:
    """The states of one part.

    Parameters
    ----------
    evidence : StoredEvidence
        The folder.
    part : TablePart
        N states.
    scenes : EpisodeScenes
        Where they are.
    """

    evidence: StoredEvidence
    part: TablePart
    scenes: EpisodeScenes

    def check(self, found: Outcome) -> None:
        """Confirm what is said of them."""
        rules, table = self.evidence.rules, self.part.table
        safe, contested = table["verdict"] == "safe", table["contested"]
        near, far = rules["collision"], rules["danger"]
        found.verdicts += self._confirm(
            found, ~contested, near, f"keep {near:g} m under any command", any_command=True
        )
        found.verdicts += self._confirm(found, safe & contested, near, f"are safe at {near:g} m")
        self._confirm(found, table["danger"], far, f"are safe at {far:g} m")

    def _confirm(
        self, found: Outcome, asked: Booleans, distance: float, what: str, *, any_command: bool = False
    ) -> int:
        """Confirm that states keep a distance, and return of how many that is so."""
        rows = np.flatnonzero(asked)
        whose, lower, upper = self._any(rows) if any_command else self._commands(rows)
        radii = np.array(self.evidence.setting["pose_radii"], dtype=float)
        poses = self.part.table["pose"][whose]
        kept = Motion(self.evidence.rules).keeps(
            self.scenes,
            self.part.table["episode"][whose],
            np.column_stack([lower, poses - radii]),
            np.column_stack([upper, poses + radii]),
            distance,
        )
        failed = np.unique(whose[~kept])
        if len(failed):
            message = f"{len(failed):,} of {len(rows):,} {self.part.name}s that {what}: {numbered(failed)}"
            found.unconfirmed.append(message)
        elif len(rows):
            found.confirmed.append(f"{len(rows):,} {self.part.name}s {what}")
        return len(rows) - len(failed)

    def _any(self, rows: NDArray[Any]) -> tuple[NDArray[Any], Floats, Floats]:
        """Return the whole range of the robot's commands for each row."""
        low, high = (np.array(self.evidence.rules[end], dtype=float) for end in ("lower", "upper"))
        return rows, np.tile(low, (len(rows), 1)), np.tile(high, (len(rows), 1))

    def _commands(self, rows: NDArray[Any]) -> tuple[NDArray[Any], Floats, Floats]:
        """Return whose each box of commands is, and its ends; of a choice every command that is possible is one."""
        limits = self.evidence.rules["lower"], self.evidence.rules["upper"]
        ends = [np.clip(self.part.table[end][rows], *limits) for end in ("lower", "upper")]
        known = np.isfinite(ends[0] + ends[1]).all(axis=1)[:, None]
        low, high = (
            np.where(known, end, whole) for end, whole in zip(ends, self._any(rows)[1:], strict=True)
        )
        commands, possible = self.evidence.setting["commands"], self.part.table.get("possible")
        if commands is None or commands["choice"] is None or possible is None:
            return rows, low, high
        row, number = np.nonzero(possible[rows] & known)
        sent = np.clip(np.array(commands["choice"], dtype=float)[number], *limits)
        other = ~(possible[rows].any(axis=1) & known[:, 0])  # of which nothing is told
        return (
            np.concatenate([rows[row], rows[other]]),
            np.concatenate([sent, low[other]]),
            np.concatenate([sent, high[other]]),
        )
