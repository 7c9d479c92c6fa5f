"""The kinds of arrays, each named once. Axis letters: B states, N neurons, V variables, A actions, T steps."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
"""What sensors read and networks of a trainer take."""
Reals = NDArray[np.floating[Any]]
"""Floats or Singles."""
Booleans = NDArray[np.bool_]
Indices = NDArray[np.int64]
Plane = NDArray[np.complex128]
"""Points x + iy, or directions."""
Hull = tuple[Floats, Floats]
"""Lower and upper bounds, of one shape."""
