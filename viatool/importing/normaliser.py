"""The running mean and deviation of a VecNormalize."""

from __future__ import annotations

import os
import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from viatool.arrays import Floats
from viatool.errors import PolicyError
from viatool.importing.inert import field_of, kind_of, numbers_of, origin_of, read_inert
from viatool.importing.spaces import is_space

_SAVED = "give the file that VecNormalize.save wrote"
_ADMITTED = ("vec_env.vec_normalize.VecNormalize", "common.running_mean_std.RunningMeanStd")


@dataclass(frozen=True, eq=False)
class Normaliser:
    """``clip((observation - mean) / deviation, -clip, clip)``, each (n,)."""

    mean: Floats
    deviation: Floats
    clip: float


def load_normaliser(path: str | os.PathLike[str], size: int, *, trust: bool = False) -> Normaliser | None:
    """Read what VecNormalize.save wrote.

    Parameters
    ----------
    path : path
        The pickle. Without `trust` it may name arrays, spaces, VecNormalize and its statistics, and none is run.
    size : int
        Length of the observation.
    trust : bool
        Unpickle it as Python does, which runs whatever it says.

    Returns
    -------
    Normaliser or None
        None if it does not normalise observations.

    Raises
    ------
    PolicyError
        If it cannot be read, is of something else, or normalises observations of another size.
    """
    path = Path(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise PolicyError(f"cannot read the normaliser {path}: {error.strerror}", _SAVED) from error
    saved = _unpickled(content, path) if trust else read_inert(content, str(path), _is_admitted)
    if kind_of(saved) != "VecNormalize" and not trust:
        raise PolicyError(f"{path} holds {_named(saved)}, where a VecNormalize is expected", _SAVED)
    if not field_of(saved, "norm_obs"):
        return None
    statistics = field_of(saved, "obs_rms")
    mean, variance = (numbers_of(field_of(statistics, name)) for name in ("mean", "var"))
    if mean is None or variance is None:
        raise PolicyError(
            f"{path}: obs_rms is {_named(statistics)}, where the mean and the variance of one vector are expected",
            "train with one vector observation",
        )
    if mean.size != size or variance.size != size:
        raise PolicyError(
            f"{path}: obs_rms.mean has {mean.size} numbers, but the model observes {size}",
            "give the VecNormalize that the model was trained in",
        )
    epsilon, clip = (numbers_of(field_of(saved, name)) for name in ("epsilon", "clip_obs"))
    if epsilon is None or clip is None or not clip > 0.0:
        raise PolicyError(f"{path}: epsilon is {epsilon} and clip_obs {clip}, not two numbers", _SAVED)
    spread = np.sqrt(variance.ravel() + epsilon)
    if not (np.isfinite(mean).all() and np.isfinite(spread).all() and (spread > 0.0).all()):
        raise PolicyError(f"{path}: obs_rms holds numbers that are not finite, or no deviation", _SAVED)
    return Normaliser(mean.ravel(), spread, float(clip))


def _is_admitted(origin: str) -> bool:
    return is_space(origin) or (origin.startswith("stable_baselines3.") and origin.endswith(_ADMITTED))


def _unpickled(content: bytes, path: Path) -> Any:
    try:
        return pickle.loads(content)
    except Exception as error:  # a pickle runs anything
        raise PolicyError(
            f"{path} cannot be unpickled: {error}",
            "install what it was saved with, such as stable-baselines3",
        ) from error


def _named(value: Any) -> str:
    return f"a {origin_of(value) or type(value).__name__}"
