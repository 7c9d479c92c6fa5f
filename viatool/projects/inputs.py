"""What the answer of a cell depends on, as one digest: with the same one, a finished cell need not be run again."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Iterator, Sequence
from datetime import date
from pathlib import Path
from typing import BinaryIO

from viatool.errors import MapWarning, ViatoolError
from viatool.policy.model_file import open_model
from viatool.projects.matrix import ProjectCell
from viatool.report import accepted_text
from viatool.samples import ERRORS, MAPS, POLICIES
from viatool.schedule import digest_of
from viatool.versions import result_versions
from viatool.world import load_map


def digest_of_inputs(cell: ProjectCell, words: Sequence[str], reports: Sequence[str], today: date) -> str:
    """Return the digest of all that a cell depends on; relative paths begin in the current folder.

    Parameters
    ----------
    cell : ProjectCell
        What is run.
    words : sequence of str
        Its command line.
    reports : sequence of str
        The formats that it writes.
    today : date
        Decides which accepted findings have expired.

    Notes
    -----
    Every word that names a file, a folder or a sample counts with its content, whichever option it belongs to.
    """
    return digest_of(
        {
            "kind": cell.kind,
            "words": list(words),
            "contents": {word: _contents(word.partition("=")[2] or word) for word in words},
            "policy": list(_weights(cell.policy_file)),
            "map": _map(cell.map_file),
            "accepted": accepted_text(cell.accepted),
            "expired": [today > one.expires for one in cell.accepted],
            "reports": list(reports),
            "versions": result_versions(),
        }
    )


def _contents(text: str) -> list[str]:
    """Return the digests of the files that a text may mean."""
    candidates = dict.fromkeys([Path(text), *(shelf.find(text) for shelf in (POLICIES, MAPS, ERRORS))])
    return [digest for path in candidates for digest in _files(path)]


def _files(path: Path) -> Iterator[str]:
    """Yield the digest of a file, or of each file in a folder."""
    try:
        found = sorted(path.rglob("*")) if path.is_dir() else [path] if path.is_file() else []
        for file in found:
            if file.is_file():
                with file.open("rb") as stream:
                    yield f"{file.name} {_digest(stream)}"
    except (OSError, ValueError):  # what cannot be read, the command will tell
        yield "unreadable"


def _digest(stream: BinaryIO) -> str:
    found = hashlib.sha256()
    while block := stream.read(1 << 20):
        found.update(block)
    return found.hexdigest()


def _weights(policy: str) -> Iterator[str]:
    """Yield the digests of the files beside a policy in which its weights are."""
    try:
        model = open_model(policy)
    except ViatoolError:
        return
    places = {
        entry.value
        for tensor in model.proto.graph.initializer
        for entry in tensor.external_data
        if entry.key == "location"
    }
    for place in sorted(places):
        yield from _files(model.folder / place)


def _map(path: str) -> str:
    """Return the digest of a map with the pictures that it names."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MapWarning)
            return load_map(path).sha256
    except ViatoolError:
        return "unreadable"
