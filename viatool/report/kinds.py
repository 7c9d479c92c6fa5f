"""The kinds of run that reports show, and the document of a stored report of any of them."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn, cast

from viatool.errors import ConfigurationError
from viatool.report.archives import is_archive, load_archive
from viatool.report.diagnoses.document import DiagnosisDocument
from viatool.report.document import Document
from viatool.report.margins.document import MarginsDocument
from viatool.report.missions.document import MissionsDocument
from viatool.report.places.document import PlacesDocument
from viatool.report.simulations.document import SimulationDocument
from viatool.report.states.document import StatesDocument

_log = logging.getLogger(__name__)

KINDS: dict[type[Document], tuple[str, str]] = {
    StatesDocument: ("viatool.report.states.run", "StatesRun"),
    PlacesDocument: ("viatool.report.places.run", "PlacesRun"),
    SimulationDocument: ("viatool.report.simulations.run", "SimulationRun"),
    MissionsDocument: ("viatool.report.missions.run", "MissionsRun"),
    MarginsDocument: ("viatool.report.margins.run", "MarginsRun"),
    DiagnosisDocument: ("viatool.report.diagnoses.run", "DiagnosisRun"),
}
"""The document of a stored report of each kind, with module and name of that of a live run, which derives from it."""

STORED: dict[type[Document], tuple[str, str]] = {
    StatesDocument: ("viatool.report.states.stored", "StoredStates"),
    PlacesDocument: ("viatool.report.places.stored", "StoredPlaces"),
}
"""Module and name of the document of an archive that holds all of a run; a class of it, for the kinds that have one."""


def live_of(kind: type[Document]) -> type[Document]:
    """Return the class of the documents of live runs of a kind; that of a live run is its own."""
    if kind not in KINDS:
        return kind
    module, name = KINDS[kind]
    return cast(type[Document], getattr(import_module(module), name))


def load_document(path: Path) -> Document:
    """Read a stored report of any kind: in JSON, or in an archive of arrays (npz) that holds it.

    Raises
    ------
    ConfigurationError
        If the file is missing, is damaged, holds neither or is not a report; names the field.
    """
    if is_archive(path):
        return _kind_of(load_archive(path).report, path)
    return _read_json(path)


def load_shown(path: Path, map_path: Path | None = None) -> Document:
    """Read a stored report with all that its file holds; an archive of states makes every format.

    Parameters
    ----------
    path : Path
        As for `load_document`.
    map_path : Path, optional
        Where the map is now, which pictures and pages of an archive need.
    """
    if not is_archive(path):
        return load_document(path)
    archive = load_archive(path)
    document = _kind_of(archive.report, path)
    if type(document) not in STORED:
        return document
    module, name = STORED[type(document)]
    return cast(Document, getattr(import_module(module), name)(archive, map_path))


def _read_json(path: Path) -> Document:
    try:
        content = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse)
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not a text file"
        raise ConfigurationError(f"cannot read the report '{path}': {reason}", "check the path") from error
    except (ValueError, RecursionError) as error:
        raise _no_report(path, f"it is not JSON: {error}") from error
    if not isinstance(content, dict):
        raise _no_report(path, "it is not an object")
    return _kind_of(content, path)


def _kind_of(content: Mapping[str, Any], path: Path) -> Document:
    for kind in KINDS:
        if kind.SIGN in content:
            _log.info("report %s read: %s", path, kind.WHAT)
            return kind(content, path)
    signs = " nor ".join(f"'{kind.SIGN}'" for kind in KINDS)
    raise _no_report(path, f"it has neither {signs}")


def _no_report(path: Path, reason: str) -> ConfigurationError:
    commands = " or ".join(dict.fromkeys(kind.COMMAND for kind in KINDS))
    return ConfigurationError(
        f"'{path}' is not a viatool report: {reason}",
        f"write one with viatool {commands} and --output json:PATH",
    )


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not a number of JSON")
