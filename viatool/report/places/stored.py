"""The report on places as an archive of cells holds it: every cell, not the worst places alone."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.errors import ConfigurationError
from viatool.report.archives import Archive
from viatool.report.numbers import count
from viatool.report.places.document import PlacesDocument

_STATUSES = ("uncontested", "certified", "refuted", "unknown")
_LISTED = 3
"""Cells of a status that are described one by one."""


class StoredPlaces(PlacesDocument):
    """A report on places with its cells, in one archive.

    Parameters
    ----------
    archive : Archive
        Cells that certify wrote.
    map_path : Path, optional
        As for other archives; nothing here is drawn.
    """

    WHAT = "an archive of cells"

    def __init__(self, archive: Archive, map_path: Path | None = None) -> None:
        super().__init__(archive.report, archive.path)
        self.archive = archive

    @cached_property
    def cells(self) -> Mapping[str, NDArray[Any]]:
        """Return the arrays; ConfigurationError if one is missing."""
        table, _ = self.archive.arrays()
        for name in ("lower", "upper", "status", "witness_pose"):
            if name not in table:
                raise ConfigurationError(
                    f"'{self.archive.path}' lacks the array '{name}'",
                    "write it again with viatool certify ... --output cells:PATH.npz",
                )
        return table

    def explain(self, option: str, subject: Sequence[float]) -> str:
        """Return what is known of every cell that holds a pose, whatever was commanded before."""
        x, y, theta = subject
        turned = math.remainder(theta, math.tau)
        cells, here = self.cells, np.array([x, y, turned])
        lower, upper = cells["lower"], cells["upper"]
        whole = np.array([0.0, 0.0, math.tau])
        inside = np.zeros(len(lower), dtype=bool)
        for pose in (here, here + whole, here - whole):  # slices of headings may reach beyond half a turn
            inside |= ((lower[:, :3] <= pose) & (pose <= upper[:, :3])).all(axis=1)
        rows = np.flatnonzero(inside)
        if not rows.size:
            raise ConfigurationError(
                f"no cell holds x {x:g} m, y {y:g} m, heading {theta:g} rad: it is blocked, off the map, or was not "
                "examined",
                "give a free place, or certify without --sample and --stop-early, and with a larger budget",
            )
        status = cells["status"][rows]
        numbers = [
            f"{count(int((status == name).sum()))} {name}" for name in _STATUSES if (status == name).any()
        ]
        behind = " of different commands before" if len(rows) > 1 else ""
        head = (
            f"At x {x:.3f} m, y {y:.3f} m, heading {theta:.3f} rad lie cells{behind}: {', '.join(numbers)}."
        )
        told = [
            self._cell(row)
            for name in ("refuted", "unknown")
            for row in rows[status == name][:_LISTED].tolist()
        ]
        if not told:
            told = ["Nothing to explain: from there the next command is safe."]
        return "\n\n".join([head, *told])

    def _cell(self, row: int) -> str:
        """Return why one cell is not certified, and what that means."""
        cells = self.cells
        each = zip(self._axes, cells["lower"][row], cells["upper"][row], strict=False)
        where = ", ".join(f"{name} {low:.4g} to {high:.4g}" for name, low, high in each)
        saved = str(cells["fails_by"][row]) if "fails_by" in cells else None
        if cells["status"][row] == "refuted":
            place = int((cells["status"][:row] == "refuted").sum())
            px, py, heading = cells["witness_pose"][place].tolist()
            told = (
                f"Refuted ({where}): from x {px:.3f} m, y {py:.3f} m, heading {heading:.3f} rad an observation "
                "within the errors makes the program fail (--output witnesses of viatool certify keeps it). "
                "No finer cell helps there"
            )
        else:
            told = (
                f"Unknown ({where}): it is a smallest cell, neither proved nor refuted; finer ones (--smallest, "
                "--halvings) may prove it, or find what fails"
            )
        if saved is None:
            return f"{told}. Which error it takes was not asked: --explain-errors of viatool certify does."
        if saved:
            return f"{told}. It is certified without {' or without '.join(saved.split(','))}."
        return f"{told}. It is not certified without any single error: the policy, or several at once, are the cause."

    @property
    def _axes(self) -> tuple[str, ...]:
        return ("x", "y", "heading", *(f"before {axis}" for axis in ("v", "omega", "lateral")))
