"""The report on margins while they are at hand: arrays, and counterexamples to be run again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from viatool.errors import ConfigurationError
from viatool.margins.result import document_of
from viatool.report.document import Replayable, StateTable, StateTabled
from viatool.report.margins.document import MarginsDocument, state_key
from viatool.report.sections import Key

if TYPE_CHECKING:
    from viatool.margins.result import Margins


class MarginsRun(MarginsDocument, Replayable, StateTabled):
    """The report of the margins of one or several policies."""

    def __init__(self, *margins: Margins) -> None:
        super().__init__(document_of(margins))
        self.margins = margins

    @property
    def only(self) -> Margins:
        """Return the margins of the one policy; ConfigurationError if there are several."""
        if len(self.margins) > 1:
            raise ConfigurationError(
                f"counterexamples and state tables are of one policy, and {len(self.margins)} were given",
                "give one policy for the formats states and witnesses",
            )
        return self.margins[0]

    def state_tables(self) -> Mapping[str, StateTable]:
        """Return the arrays of the contested states."""
        only = self.only
        table = only.state_table(slice(None))
        numbers, close = table["state"].tolist(), table["close"].tolist()

        def key(row: int) -> Key:
            return state_key(self.names[0], numbers[row], close=close[row])

        return {"": StateTable(self.size, only.EPISODE_COLUMNS, only.state_table, key)}

    def witness_file(self) -> Mapping[str, Any]:
        """Return the counterexamples, each within the smallest error that has one."""
        return self.only.witness_document()
