"""Report documents for the tests of this room, and a browser that opens their pages."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.browser import Browser, running_browser
from viatool.report.states.document import StatesDocument


def rate(safe: int, total: int) -> dict[str, Any]:
    return {"safe": safe, "total": total, "rate": safe / total if total else None}


def rates(safe: int, total: int) -> dict[str, Any]:
    return {
        "overall": rate(safe, total),
        "success": rate(safe, total),
        "collision": rate(0, 0),
        "timeout": rate(0, 0),
    }


def content(safe: int = 97, unsafe: int = 1, unknown: int = 2) -> dict[str, Any]:
    total = safe + unsafe + unknown
    return {
        "schema_version": 1,
        "policy": {"path": "policies/via.onnx", "sha256": "a" * 64},
        "map": {"path": "maps/lab.yaml", "sha256": "b" * 64},
        "eps": 0.01,
        "criterion": "swept",
        "arithmetic": "float32",
        "engine": {"order": 1, "approximation": "chebyshev", "refine": "monotone", "passes": "numpy"},
        "states": total,
        "verdicts": {"safe": safe, "unsafe": unsafe, "unknown": unknown},
        "safety_rate": rates(safe, total),
        "sampled_safety_rate": rates(min(safe + 1, total), total),
        "danger_rate": rates(safe // 2, total),
        "contested_rate": rates(0, unsafe + unknown),
        "task": {
            "episodes": 10,
            "success_rate": 0.9,
            "collision_rate": 0.0,
            "timeout_rate": 0.1,
            "average_cost": 0.25,
        },
        "reachable_width": {"linear": {"mean": 0.004, "std": 0.001, "max": 0.02}},
        "seconds": {"load": 0.2, "reach": 0.5},
        "versions": {"viatool": "0.1.0"},
    }


@pytest.fixture
def document() -> Callable[..., StatesDocument]:
    """Build a report with the given numbers of safe, unsafe and unknown states, and with other fields."""
    return lambda *counts, **other: StatesDocument({**content(*counts), **other})


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    with running_browser() as browser:
        yield browser
