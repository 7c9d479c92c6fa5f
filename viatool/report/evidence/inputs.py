"""What was read: copies of the inputs with their digests, and those that are named by their digests alone."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import onnx
import yaml

from viatool.errors import ConfigurationError
from viatool.samples import MAPS, POLICIES

LARGEST_RECORDING = 20 * 2**20
"""Bytes above which a recording is named by its digest alone."""

_OF_THE_MAP = ("map", "occupancy", "image")


@dataclass(frozen=True)
class InputFile:
    """One file that was read.

    Parameters
    ----------
    role : str
        ``policy``, ``weights``, ``map``, ``occupancy``, ``image``, ``specification``, ``errors`` or ``recording``.
    name : str
        As it was given.
    content : bytes
        What is in it.
    place : str
        Where its copy stands in the folder; empty where it is named alone.
    """

    role: str
    name: str
    content: bytes
    place: str

    def to_json(self) -> dict[str, str | int | None]:
        """Return the form in the folder."""
        return {
            "role": self.role,
            "name": self.name,
            "file": self.place or None,
            "sha256": hashlib.sha256(self.content).hexdigest(),
            "bytes": len(self.content),
        }


def read_inputs(
    policy: tuple[Path, str], world_map: tuple[Path, str], others: Mapping[str, Path]
) -> tuple[InputFile, ...]:
    """Read everything that a verification was given, and refuse what is not what was verified.

    Parameters
    ----------
    policy, world_map : tuple of (Path, str)
        Path, or name of a sample, and the digest of what was read then.
    others : mapping
        Further files by their role; a recording may be a folder.

    Raises
    ------
    ConfigurationError
        If policy or map have another digest now.
    """
    found = [*_policy_files(policy[0]), *_map_files(world_map[0])]
    _require_same("policy", policy, [one for one in found if one.role == "policy"])
    _require_same("map", world_map, [one for one in found if one.role in _OF_THE_MAP])
    for role, path in others.items():
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.is_file():
                kept = role != "recording" or file.stat().st_size <= LARGEST_RECORDING
                found.append(_input(role, str(file), file, f"inputs/{role}/{file.name}" if kept else ""))
    return tuple(found)


def _input(role: str, name: str, path: Path, place: str) -> InputFile:
    return InputFile(role, name, path.read_bytes(), place)


def _require_same(what: str, given: tuple[Path, str], files: Sequence[InputFile]) -> None:
    digests = [hashlib.sha256(file.content) for file in files]
    joint = digests[0] if len(digests) == 1 else hashlib.sha256(b"".join(one.digest() for one in digests))
    if joint.hexdigest() != given[1]:
        raise ConfigurationError(
            f"the {what} '{given[0]}' is no longer the one that was verified, so no evidence of it is written",
            "run the command again, and leave its inputs alone meanwhile",
        )


def _policy_files(given: Path) -> Iterator[InputFile]:
    """Yield the model, and the files beside it that hold its weights, where it has such."""
    path = POLICIES.find(given)
    yield _input("policy", str(given), path, f"inputs/policy/{path.name}")
    for location in sorted(_external(onnx.load(path, load_external_data=False))):
        yield _input("weights", location, path.parent / location, f"inputs/policy/{PurePosixPath(location)}")


def _external(model: onnx.ModelProto) -> set[str]:
    return {
        entry.value
        for tensor in model.graph.initializer
        if tensor.data_location == onnx.TensorProto.EXTERNAL
        for entry in tensor.external_data
        if entry.key == "location"
    }


def _map_files(given: Path) -> Iterator[InputFile]:
    """Yield the map, and the occupancy map and the image that it names, in the order of their joint digest."""
    path, role = MAPS.find(given), "map"
    taken: set[str] = set()
    name = str(given)
    while True:
        place = path.name if path.name not in taken else f"{role}-{path.name}"
        taken.add(place)
        file = _input(role, name, path, f"inputs/map/{place}")
        yield file
        content = {} if role == "image" else yaml.safe_load(file.content)
        if content.get("occupancy") is not None and role == "map":
            role, name = "occupancy", str(content["occupancy"])
        elif "image" in content and "arena" not in content:
            role, name = "image", str(content["image"])
        else:
            return
        path = path.parent / name
