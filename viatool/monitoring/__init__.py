"""A monitor between a policy and its robot: what passes is proved, for everything else the robot brakes."""

from __future__ import annotations

from viatool.monitoring.guard import Guard
from viatool.monitoring.monitor import Decision, Monitor

__all__ = ["Decision", "Guard", "Monitor"]
