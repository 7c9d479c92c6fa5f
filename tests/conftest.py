"""What holds for all tests: drawing examples may take as long as a loaded machine needs.

Workers begin with one half of the tests each and take tests from one another at the end, so that tests of one module
mostly meet in one worker and what they share is made once.
"""

from __future__ import annotations

from hypothesis import HealthCheck, settings
from xdist.scheduler import WorkStealingScheduling

settings.register_profile("viatool", suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("viatool")


def pytest_xdist_make_scheduler(config, log):
    return WorkStealingScheduling(config, log) if config.getoption("dist") == "load" else None
