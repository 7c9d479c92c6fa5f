"""Margins of two trained policies at random poses of the lab."""

from __future__ import annotations

import pytest

import viatool
from viatool.margins.result import Margins
from viatool.simulate import Places

PLACES = Places(count=1200)


@pytest.fixture(scope="session")
def via() -> Margins:
    return viatool.margin("via", "lab", places=PLACES)


@pytest.fixture(scope="session")
def td3() -> Margins:
    return viatool.margin("td3", "lab", places=PLACES)
