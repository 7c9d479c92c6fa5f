"""Carrying out one function over many pieces of work: here, in several processes, or on a cluster.

The room knows nothing of what is computed. A piece is pure: its answer depends on its content alone, so that neither
the number of workers nor the order in which pieces finish can change anything.
"""

from __future__ import annotations

from viatool.schedule.checkpoint import Checkpoint
from viatool.schedule.choice import open_scheduler
from viatool.schedule.cluster import Cluster
from viatool.schedule.digest import digest_of
from viatool.schedule.folder import run_in_folder
from viatool.schedule.lock import locked
from viatool.schedule.pieces import Piece, Scheduler, Span, cut
from viatool.schedule.processes import Processes
from viatool.schedule.progress import Message, Progress, Reporter, reporter
from viatool.schedule.serial import Serial

__all__ = [
    "Checkpoint",
    "Cluster",
    "Message",
    "Piece",
    "Processes",
    "Progress",
    "Reporter",
    "Scheduler",
    "Serial",
    "Span",
    "cut",
    "digest_of",
    "locked",
    "open_scheduler",
    "reporter",
    "run_in_folder",
]
