"""The driven states as a trajectory file (npz, csv), for ``viatool verify --trajectory``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from viatool.trajectory import write_trajectory

if TYPE_CHECKING:
    from viatool.report.gate import Check
    from viatool.simulate import Simulation

SUFFIXES = (".npz", ".csv")


def render(simulation: Simulation, checks: Sequence[Check], suffix: str) -> bytes:
    """Return the file's content."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"trajectory{suffix}"
        write_trajectory(path, simulation.drive.trajectory, simulation.policy.spec)
        return path.read_bytes()
