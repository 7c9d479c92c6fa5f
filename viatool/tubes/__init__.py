"""Trajectory tubes: where the closed loop may be, sensor errors included, several control intervals after a state."""

from __future__ import annotations

from viatool.tubes.following import Loop
from viatool.tubes.job import HorizonQuestion
from viatool.tubes.runs import Runs, drive, search_crashes

__all__ = ["HorizonQuestion", "Loop", "Runs", "drive", "search_crashes"]
