"""Policies, maps and error models that come with viatool, found by name.

They stand in ``policies/``, ``maps/`` and ``errors/`` of a checkout, and inside this package in an installed wheel.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

_HERE = Path(__file__).resolve().parent


@dataclass(frozen=True)
class Shelf:
    """Samples of one kind.

    Parameters
    ----------
    kind : str
        Name of the folder.
    suffix : str
        Of the files; a sample's name is its file name without it.
    """

    kind: str
    suffix: str

    @property
    def folder(self) -> Path:
        """Return where the samples are."""
        packed = _HERE / self.kind
        return packed if packed.is_dir() else _HERE.parents[1] / self.kind

    def names(self) -> tuple[str, ...]:
        """Return the names, sorted."""
        found = self.folder.glob(f"*{self.suffix}")
        return tuple(sorted(path.name.removesuffix(self.suffix) for path in found))

    def find(self, path: str | os.PathLike[str]) -> Path:
        """Return the file that a path or a name means: an existing path wins, then a sample's name.

        Parameters
        ----------
        path : path
            What a user gave.

        Returns
        -------
        Path
            The sample's file, or the path as it is.
        """
        name = os.fspath(path)
        if name in self.names() and not os.path.lexists(name):
            return self.folder / f"{name}{self.suffix}"
        return Path(path)

    def hint(self) -> str:
        """Return what to do when a path does not exist."""
        names = ", ".join(self.names())
        return f"check the path, or name one of the {self.kind} that come with viatool: {names}"


POLICIES = Shelf("policies", ".onnx")
MAPS = Shelf("maps", ".yaml")
ERRORS = Shelf("errors", ".yaml")
