"""Carrying out one function over many pieces of work: here, in several processes, or on a cluster.

The room knows nothing of what is computed. A piece is pure: its answer depends on its content alone, so that neither
the number of workers nor the order in which pieces finish can change anything.
"""

from __future__ import annotations

from viatool.schedule.campaign import Campaign, CutShort, EvenWork, Found, Work
from viatool.schedule.checkpoint import Checkpoint
from viatool.schedule.choice import open_scheduler
from viatool.schedule.cluster import Cluster
from viatool.schedule.deadline import NEVER, Deadline, TimeUp, check_time, time_is_up, within
from viatool.schedule.digest import digest_of
from viatool.schedule.folder import run_in_folder
from viatool.schedule.lock import locked
from viatool.schedule.pieces import Piece, Scheduler, Span, cut
from viatool.schedule.processes import Processes
from viatool.schedule.progress import Message, Progress, Reporter, ignore, reporter
from viatool.schedule.serial import Serial

__all__ = [
    "NEVER",
    "Campaign",
    "Checkpoint",
    "Cluster",
    "CutShort",
    "Deadline",
    "EvenWork",
    "Found",
    "Message",
    "Piece",
    "Processes",
    "Progress",
    "Reporter",
    "Scheduler",
    "Serial",
    "Span",
    "TimeUp",
    "Work",
    "check_time",
    "cut",
    "digest_of",
    "ignore",
    "locked",
    "open_scheduler",
    "reporter",
    "run_in_folder",
    "time_is_up",
    "within",
]
