"""Files of reachable sets, for other programs."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from viatool.errors import ConfigurationError
from viatool.report.files import check_writable, replacing

if TYPE_CHECKING:
    from viatool.taylor import ReachableSet

SUFFIXES = (".npz", ".csv")


def check_bounds_file(path: Path) -> None:
    """Refuse a path that is not of a known format or cannot be written."""
    if path.suffix.lower() not in SUFFIXES:
        raise ConfigurationError(f"'{path}' ends in '{path.suffix}'", f"end it in {' or '.join(SUFFIXES)}")
    check_writable(path)


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
