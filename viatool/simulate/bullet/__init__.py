"""The physics engine: pybullet is imported in this package alone."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def muffled() -> Iterator[None]:
    """Swallow what compiled code writes to stderr; whether anything failed is told otherwise."""
    sys.stderr.flush()
    saved, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(nowhere)


with muffled():  # it announces its build time when it is imported
    import pybullet  # noqa: F401

from viatool.simulate.bullet.simulator import BulletSimulator  # noqa: E402  # needs the line above

__all__ = ["BulletSimulator"]
