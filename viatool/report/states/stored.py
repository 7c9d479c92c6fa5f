"""The report on states as an archive holds it: every format of the live run, but for evidence, of a file alone."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from viatool.errors import ConfigurationError, ViatoolError
from viatool.report.archives import Archive
from viatool.report.document import StateTable
from viatool.report.paired import apart
from viatool.report.states.run import StatesShown
from viatool.verification.result import Result

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from viatool.world import WorldMap


class StoredStates(StatesShown):
    """A report on states with its arrays, in one archive.

    Parameters
    ----------
    archive : Archive
        A state table that verify wrote.
    map_path : Path, optional
        Where the map is now; by default where the report says, from here or from beside the archive.
    """

    WHAT = "a state table"

    def __init__(self, archive: Archive, map_path: Path | None = None) -> None:
        super().__init__(archive.report, archive.path)
        self.archive, self._map_path = archive, map_path

    @cached_property
    def result(self) -> Result:  # type: ignore[override]  # read when it is asked for
        """Return the result as it was.

        Raises
        ------
        ConfigurationError
            If the map is gone or another one, or an array is missing or of another form.
        """
        from viatool.verification.stored import read_result

        table, more = self.archive.arrays()
        world_map = self._world_map()
        try:
            return read_result(self.archive.report, self.archive.asked, table, more, world_map)
        except (KeyError, ValueError, TypeError, AttributeError, IndexError, ViatoolError) as error:
            missing = f"it lacks {error}" if isinstance(error, KeyError) else str(error)
            raise ConfigurationError(
                f"'{self.archive.path}' cannot be shown: {missing}",
                "write it again with viatool verify ... --output states:PATH.npz",
            ) from error

    def _world_map(self) -> WorldMap:
        """Return the map; ConfigurationError if it is not the one of the report."""
        import warnings
        from dataclasses import replace

        from viatool.errors import MapWarning
        from viatool.world import load_map

        named = Path(self.record.map.path)
        beside = self.archive.path.parent / named
        path = self._map_path or (beside if beside.is_file() and not named.is_file() else named)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MapWarning)  # which the run has told
            try:
                world_map = load_map(path, unknown=self.archive.asked.get("unknown"))
            except ViatoolError as error:
                raise ConfigurationError(
                    f"the map of '{self.archive.path}' is needed, and cannot be read: {error.message}",
                    "give it with --map FILE",
                ) from error
        if world_map.sha256 != self.record.map.sha256:
            raise ConfigurationError(
                f"the map '{path}' is not the one of '{self.archive.path}': its sha256 is "
                f"{world_map.sha256[:12]}..., and was {self.record.map.sha256[:12]}...",
                "give that one with --map FILE",
            )
        return replace(world_map, path=named)

    @cached_property
    def outcomes(self) -> Mapping[str, float]:
        """Return which driven states are safe, by scenario, time and pose."""
        table, _ = self.archive.arrays()
        safe = (table["verdict"] == "safe").astype(float).tolist()
        return dict(zip(apart(self._places), safe, strict=True))

    @cached_property
    def groups(self) -> Mapping[str, str]:
        """Return the episode of each state of a path; poses that were picked are by themselves."""
        if not self.archive.asked["trajectory"]["connected"]:
            return {}
        table, _ = self.archive.arrays()
        return dict(zip(apart(self._places), map(str, table["episode"].tolist()), strict=True))

    @cached_property
    def _places(self) -> Sequence[str]:
        """Return where and when each state is, in words that are the same in another run."""
        table, more = self.archive.arrays()
        names = [json.loads(text)["name"] if text else "" for text in more["scenario"].tolist()]
        rows = zip(table["episode"].tolist(), more["time"].tolist(), table["pose"].tolist(), strict=True)
        return [f"{names[episode]} {time:.6f} {x:.6f},{y:.6f},{t:.6f}" for episode, time, (x, y, t) in rows]

    def state_tables(self) -> Mapping[str, StateTable]:
        """Return the tables as the archive holds them, without what a gate added."""
        every, _ = self.archive.arrays()
        prefixes = ["", *(["close_"] if "close_pose" in every else [])]
        return {prefix: _table(every, prefix) for prefix in prefixes}

    def kept_beside(self) -> Mapping[str, NDArray[Any]]:
        """Return what the archive held beside its tables."""
        from viatool.report.archives import as_array

        return {"asked": as_array(self.archive.asked), **self.archive.arrays()[1]}


def _table(every: Mapping[str, NDArray[Any]], prefix: str) -> StateTable:
    """Return the table of which the names of arrays begin so."""
    names = [name for name in every if name.startswith(prefix) and (prefix or not name.startswith("close_"))]
    table = {name.removeprefix(prefix): every[name] for name in names}
    episodes = Result.EPISODE_COLUMNS
    own = {name: array for name, array in table.items() if name not in _OF_A_GATE}

    def rows(chosen: slice) -> Mapping[str, NDArray[Any]]:
        return {name: array if name in episodes else array[chosen] for name, array in own.items()}

    return StateTable(len(table["pose"]), episodes, rows, lambda row: (prefix, row))


_OF_A_GATE = ("fails", "conditions")
