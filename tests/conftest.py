"""What holds for all tests: drawing examples may take as long as a loaded machine needs."""

from __future__ import annotations

from hypothesis import HealthCheck, settings

settings.register_profile("viatool", suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("viatool")
