"""The files of an evidence folder, as far as they are rechecked."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

REQUIRED = ("claims.json", "report.json", "scenarios.json", "setting.json", "states.npz", "witnesses.json")


CLOSE = "close_"
"""How arrays begin that are of close places, beside the states."""


@dataclass(frozen=True)
class TablePart:
    """States of one kind: those that were driven or recorded, or the close places beside them.

    Parameters
    ----------
    name : str
        What one of them is.
    table : dict of ndarray
        Arrays of N rows, and `outcome` of the episodes.
    report : dict
        Their `states`, `verdicts` and `unsafe_states`.
    witnesses : list of dict
        Their counterexamples.
    """

    name: str
    table: dict[str, NDArray[Any]]
    report: dict[str, Any]
    witnesses: list[dict[str, Any]]

    def place(self, row: int) -> str:
        """Name one of them."""
        return f"{self.name} {row}"


@dataclass
class StoredEvidence:
    """A folder that was read.

    Parameters
    ----------
    folder : Path
        Where it stands.
    report, setting, claims, witnesses : dict
        The JSON files of these names.
    scenarios : list
        Start, goal and own obstacles of each episode; None for one on the bare map.
    table : dict of ndarray
        The state table.
    """

    folder: Path
    report: dict[str, Any]
    setting: dict[str, Any]
    claims: dict[str, Any]
    witnesses: dict[str, Any]
    scenarios: list[dict[str, Any] | None]
    table: dict[str, NDArray[Any]]

    @classmethod
    def load(cls, folder: Path) -> StoredEvidence:
        """Read the files of a folder."""
        names = ("report", "setting", "claims", "witnesses", "scenarios")
        parts = {name: read_json(folder / f"{name}.json") for name in names}
        with np.load(folder / "states.npz", allow_pickle=False) as table:
            return cls(folder, table={name: table[name] for name in table.files}, **parts)

    @property
    def rules(self) -> dict[str, Any]:
        """Return what every state has to fulfil."""
        rules: dict[str, Any] = self.setting["rules"]
        return rules

    @property
    def driven(self) -> TablePart:
        """Return the states."""
        table = {name: array for name, array in self.table.items() if not name.startswith(CLOSE)}
        entries = [entry for entry in self.witnesses["witnesses"] if not entry.get("close")]
        return TablePart("state", table, self.report, entries)

    @property
    def close(self) -> TablePart | None:
        """Return the close places, if the table has any."""
        table = {
            name.removeprefix(CLOSE): array for name, array in self.table.items() if name.startswith(CLOSE)
        }
        entries = [entry for entry in self.witnesses["witnesses"] if entry.get("close")]
        return TablePart("close place", table, self.report["close"], entries) if table or entries else None

    @property
    def parts(self) -> list[TablePart]:
        """Return the states, and behind them the close places."""
        return [part for part in (self.driven, self.close) if part is not None]

    def copies(self, *roles: str) -> list[Path]:
        """Return the copies of the inputs of some roles, in their order."""
        inputs = self.setting["inputs"]
        return [
            self.folder / one["file"]
            for role in roles
            for one in inputs
            if one["role"] == role and one["file"]
        ]

    def beyond(self) -> list[str]:
        """Return why paths are not rechecked; nothing where they are."""
        rules = self.rules
        reasons = [] if rules["criterion"] in ("swept", "braking") else [f"criterion {rules['criterion']}"]
        if rules["kinematics"] != "differential":
            reasons.append(f"kinematics {rules['kinematics']}")
        reasons += [f"error terms of {part}" for part in ("motors", "timing") if part in rules]
        if rules["delay"] > 0.0:
            reasons.append(f"a delay of {rules['delay']:g} s")
        if self.setting["moving"] or "people" in self.table:
            reasons.append("things that move")
        return reasons


class MissingField(KeyError):  # noqa: N818  # the name says what is wrong
    """A file lacks a field that is rechecked."""

    def __str__(self) -> str:
        """Return the words, without the quotes of a key."""
        return str(self.args[0])


class _Fields(dict[str, Any]):
    """A JSON object that knows of which file it is, for what is asked of it in vain."""

    def __init__(self, file: str, fields: dict[str, Any]) -> None:
        super().__init__(fields)
        self.file = file

    def __missing__(self, name: str) -> Any:
        """Name the file and the field."""
        raise MissingField(f"{self.file} has no field '{name}' where it belongs")


def read_json(path: Path) -> Any:
    """Read a JSON file."""
    return json.loads(path.read_text(encoding="utf-8"), object_hook=partial(_Fields, path.name))
