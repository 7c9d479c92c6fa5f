"""Files of reachable sets, for other programs, and queries about them, for other verifiers."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from viatool.errors import ConfigurationError
from viatool.report.files import check_folder, check_writable, replacing, write_folder

if TYPE_CHECKING:
    from viatool.policy import Policy
    from viatool.taylor import ReachableSet

SUFFIXES = (".npz", ".csv")


QUERIES = "vnnlib"


@dataclass(frozen=True)
class BoundsOutput:
    """Where bounds go: a file with their numbers, or a folder with queries about them.

    Parameters
    ----------
    path : Path
        The file or the folder.
    queries : bool
        Whether it is a folder with queries.
    """

    path: Path
    queries: bool

    def require_serving(self, policy: Policy) -> None:
        """Refuse a policy of which other verifiers cannot be asked."""
        if self.queries:
            from viatool.report.vnnlib import require_plain

            require_plain(policy)

    def write(
        self, policy: Policy, observations: NDArray[np.float64], eps: ArrayLike, reachable: ReachableSet
    ) -> None:
        """Write the bounds of B observations (B, n)."""
        if not self.queries:
            write_bounds(self.path, observations, eps, reachable)
            return
        from viatool.report.vnnlib import query_folder

        radii = np.broadcast_to(np.asarray(eps, dtype=np.float64), observations.shape)
        bounds = reachable.lower, reachable.upper
        write_folder(self.path, QUERIES, query_folder(policy, observations, radii, bounds))


def parse_bounds_output(text: str) -> BoundsOutput:
    """Read FILE or vnnlib:DIR, and refuse what cannot be written.

    Raises
    ------
    ConfigurationError
        If a file ends in a suffix that is not known, or the path cannot be written.
    """
    name, colon, folder = text.partition(":")
    if colon and name == QUERIES:
        if not folder:
            raise ConfigurationError(f"'{text}' names no folder", f"write {QUERIES}:DIRECTORY")
        check_folder(Path(folder), QUERIES)
        return BoundsOutput(Path(folder), queries=True)
    path = Path(text)
    if path.suffix.lower() not in SUFFIXES:
        raise ConfigurationError(
            f"'{path}' ends in '{path.suffix}'",
            f"end it in {' or '.join(SUFFIXES)}, or write {QUERIES}:DIRECTORY",
        )
    check_writable(path)
    return BoundsOutput(path, queries=False)


def write_bounds(
    path: Path, observations: NDArray[np.float64], eps: ArrayLike, reachable: ReachableSet
) -> None:
    """Write B observations (B, n), their radii, and the bounds (B, A) of their actions; of a choice what is possible.

    Notes
    -----
    Numbers in a csv are written with 17 significant digits, so that they are read back as the same float64.
    """
    radii = np.broadcast_to(np.asarray(eps, dtype=np.float64), observations.shape)
    arrays: dict[str, NDArray[Any]] = {
        "observation": observations,
        "eps": radii,
        "lower": reachable.lower,
        "upper": reachable.upper,
    }
    if reachable.possible is not None:
        arrays["possible"] = reachable.possible
    with replacing(path) as draft:
        if path.suffix.lower() == ".npz":
            np.savez_compressed(draft, allow_pickle=False, **arrays)
            return
        with draft.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(f"{name}_{i}" for name, array in arrays.items() for i in range(array.shape[1]))
            writer.writerows([f"{x:.17g}" for x in row] for row in np.hstack(list(arrays.values())))
