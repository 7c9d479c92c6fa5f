"""A hall of two missions, and a policy that dodges what stands there."""

from __future__ import annotations

import pytest

import viatool
from tests.hall import MAP
from tests.missions.dodging import write_dodging_policy
from viatool.missions import branching


@pytest.fixture(autouse=True)
def fewer_branches(monkeypatch):
    monkeypatch.setattr(branching, "RUNS", 50)


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    path = tmp_path_factory.mktemp("hall") / "hall.yaml"
    path.write_text(MAP, encoding="utf-8")
    return viatool.load_map(path)


@pytest.fixture(scope="module")
def dodging(tmp_path_factory):
    return viatool.load_policy(write_dodging_policy(tmp_path_factory.mktemp("policies") / "dodging.onnx"))
