"""Everything about sight holds for both engines."""

from __future__ import annotations

import pytest


@pytest.fixture(params=["compiled", "numpy"], autouse=True)
def engine(request, monkeypatch):
    monkeypatch.setenv("VIATOOL_ENGINE", request.param)
    return request.param
