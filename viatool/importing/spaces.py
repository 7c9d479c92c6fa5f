"""The observation and action spaces of gymnasium and gym, as far as a navigation policy has them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from viatool.arrays import Floats
from viatool.errors import PolicyError
from viatool.importing.inert import field_of, kind_of, numbers_of

_VECTOR = "train with one vector observation, or export the actor by hand as docs/exporting.md shows"


@dataclass(frozen=True, eq=False)
class BoxSpace:
    """A vector of numbers within limits.

    Parameters
    ----------
    lower, upper : ndarray
        (n,), flattened in C order; infinite where there is no limit.
    shape : tuple of int
        Before it was flattened.
    """

    lower: Floats
    upper: Floats
    shape: tuple[int, ...]

    @property
    def size(self) -> int:
        """Return n."""
        return len(self.lower)

    @property
    def is_bounded(self) -> bool:
        """Tell whether all limits are finite."""
        return bool(np.isfinite(self.lower).all() and np.isfinite(self.upper).all())


@dataclass(frozen=True)
class DiscreteSpace:
    """One of so many choices."""

    choices: int


def is_space(origin: str) -> bool:
    """Tell whether a name in a pickle belongs to a space: of gymnasium, gym, or the generator that it draws from."""
    return origin.startswith(("gymnasium.spaces.", "gym.spaces.", "numpy.random."))


def box_of(value: Any, where: str) -> BoxSpace:
    """Return a box.

    Raises
    ------
    PolicyError
        If it is another space.
    """
    space = space_of(value, where)
    if isinstance(space, BoxSpace):
        return space
    raise PolicyError(f"{where} is a Discrete({space.choices}), where a Box is expected", _VECTOR)


def space_of(value: Any, where: str) -> BoxSpace | DiscreteSpace:
    """Return a space, read from a pickle (see `read_inert`) or as gymnasium has it.

    Raises
    ------
    PolicyError
        If it is neither a Box of numbers nor a Discrete; names it.
    """
    kind = kind_of(value)
    if kind == "Box":
        lower, upper = (numbers_of(field_of(value, name)) for name in ("low", "high"))
        if lower is None or upper is None or lower.shape != upper.shape or not lower.size:
            raise PolicyError(f"{where} is a Box without limits that can be read", _VECTOR)
        if lower.ndim >= 3:
            raise PolicyError(
                f"{where} is a Box of shape {list(lower.shape)}, an image, where a vector is expected",
                _VECTOR,
            )
        return BoxSpace(lower.ravel(), upper.ravel(), lower.shape)
    if kind == "Discrete":
        choices = numbers_of(field_of(value, "n"))
        if choices is None or choices.size != 1 or not choices >= 2:
            raise PolicyError(f"{where} is a Discrete space without two choices", _VECTOR)
        return DiscreteSpace(int(choices))
    raise PolicyError(f"{where} is a {kind}, where a Box or a Discrete is expected", _VECTOR)
