"""The engines of the tests of the engine."""

from __future__ import annotations

import pytest

from viatool import engine

collect_ignore = [] if engine.library() else ["test_kernel.py"]  # without a compiler there is nothing to test


@pytest.fixture
def numpy_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the numpy engine, whose rules a test changes."""
    monkeypatch.setenv(engine.VARIABLE, "numpy")
