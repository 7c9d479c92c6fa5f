"""Reading observations for ``viatool bounds``."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

from viatool.errors import ConfigurationError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

SUFFIXES = (".npy", ".npz", ".csv", ".txt")


def load_observations(path: Path, size: int, remembered: int = 0) -> NDArray[np.float64]:
    """Read B observations from a file.

    Parameters
    ----------
    path : Path
        .npy, .npz (array ``observation``), or numbers in .csv or .txt, one observation on each line.
    size : int
        Length that every observation must have.
    remembered : int
        How many numbers at its end are the policy's memory, for the message.

    Returns
    -------
    ndarray
        (B, size), finite.

    Raises
    ------
    ConfigurationError
        If the file cannot be read or holds something else.
    """
    import numpy as np

    if path.suffix.lower() not in SUFFIXES:
        raise ConfigurationError(f"'{path}' ends in '{path.suffix}'", f"end it in {', '.join(SUFFIXES)}")
    try:
        observations = np.atleast_2d(np.asarray(_read(path), dtype=np.float64))
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        reason = getattr(error, "strerror", None) or str(error)
        hint = "give one observation per line, or an array 'observation'"
        raise ConfigurationError(f"cannot read observations from '{path}': {reason}", hint) from error
    if observations.ndim != 2 or observations.shape[1] != size:
        raise ConfigurationError(
            f"'{path}' holds an array of shape {observations.shape}, the policy takes (B, {size})"
            + (f", of which the last {remembered} are its memory" if remembered else ""),
            "give one observation per line",
        )
    if not np.isfinite(observations).all():
        raise ConfigurationError(f"'{path}' holds a number that is not finite", "replace or remove it")
    return observations


def _read(path: Path) -> NDArray[np.float64]:
    import numpy as np

    array: NDArray[np.float64]
    if path.suffix.lower() == ".npz":
        with np.load(path, allow_pickle=False) as archive:
            array = archive["observation"]
        return array
    if path.suffix.lower() == ".npy":
        array = np.load(path, allow_pickle=False)
        return array
    text = path.read_text(encoding="utf-8").replace(",", " ").replace(";", " ")
    rows = [line.split() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    return np.array([[float(word) for word in row] for row in rows])
