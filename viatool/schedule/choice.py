"""Which scheduler a user asks for."""

from __future__ import annotations

from typing import Literal

from viatool.errors import ConfigurationError
from viatool.schedule.cluster import Cluster
from viatool.schedule.pieces import Scheduler
from viatool.schedule.processes import Processes, available_cores
from viatool.schedule.serial import Serial


def open_scheduler(workers: int | Literal["auto"] = 1, address: str | None = None) -> Scheduler:
    """Return the scheduler for a number of worker processes, or for the address of a Dask scheduler.

    Parameters
    ----------
    workers : int or "auto"
        Processes on this machine; 1 works in this process, "auto" takes one for each core that may be used.
    address : str, optional
        Such as ``tcp://host:8786``, or the scheduler file (JSON) of a cluster; goes before `workers`.

    Raises
    ------
    ConfigurationError
        If the number makes no sense, or no fitting cluster is there.
    """
    if address is not None:
        cluster = Cluster(address)
        cluster.connect()
        return cluster
    if workers == "auto":
        workers = available_cores()
    if not isinstance(workers, int) or workers < 1:
        raise ConfigurationError(f"{workers!r} is not a number of workers", "give 1 or more, or 'auto'")
    return Serial() if workers == 1 else Processes(workers)
