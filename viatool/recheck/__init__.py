"""Recheck an evidence folder with nothing of the engine: hashes, sums, counterexamples, where safe states may drive.

This package imports nothing else of viatool (import-linter holds that): numpy, shapely, onnxruntime and PyYAML are all
it needs. What it does not recheck it names.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from viatool.recheck.evidence import REQUIRED, MissingField, StoredEvidence
from viatool.recheck.files import check_claims, check_files, check_inputs
from viatool.recheck.geometry import check_geometry
from viatool.recheck.observations import check_observations
from viatool.recheck.outcome import Outcome, UnreadableFolder
from viatool.recheck.runs import check_network, check_witnesses
from viatool.recheck.sums import check_sums

__all__ = ["Outcome", "UnreadableFolder", "recheck"]

_STEPS: tuple[Callable[[StoredEvidence, Outcome], None], ...] = (
    check_inputs,
    check_claims,
    check_sums,
    check_observations,
    check_witnesses,
    check_network,
    check_geometry,
)


def recheck(folder: Path) -> Outcome:
    """Recheck an evidence folder.

    Parameters
    ----------
    folder : Path
        What ``viatool verify --output evidence:DIR`` wrote.

    Returns
    -------
    Outcome
        What is confirmed, contradicted, not confirmed and not rechecked.

    Raises
    ------
    UnreadableFolder
        If there is no manifest of a known version.

    Notes
    -----
    Sound: what is confirmed is so without trust in what wrote the folder; what raises is no confirmation.
    """
    found = Outcome()
    check_files(folder, found)
    if any(not (folder / name).is_file() for name in REQUIRED):
        return found
    try:
        evidence = StoredEvidence.load(folder)
    except Exception as error:  # whatever a damaged file raises
        found.contradicted.append(f"a file cannot be read: {error!r}")
        return found
    for step in _STEPS:
        try:
            step(evidence, found)
        except Exception as error:  # whatever damaged content raises is no confirmation
            name = step.__name__.removeprefix("check_")
            why = str(error) if isinstance(error, MissingField) else repr(error)
            found.contradicted.append(f"{name}: could not be rechecked, for something is malformed: {why}")
    return found
