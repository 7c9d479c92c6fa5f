"""What some tests need and not every Python can have."""

from __future__ import annotations

import sys
from importlib.util import find_spec

import pytest

WITHOUT_PYBULLET = sys.version_info >= (3, 12) and find_spec("pybullet") is None
"""There are no wheels of pybullet for these versions, and its source builds for many minutes."""

needs_pybullet = pytest.mark.skipif(WITHOUT_PYBULLET, reason="pybullet has no wheel for this Python")
