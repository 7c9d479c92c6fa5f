"""The main job: policy, map, states and uncertainty give verdicts."""

from __future__ import annotations

from viatool.verification.job import verify

__all__ = ["verify"]
