"""What holds for all tests: they run the compiled engine of these sources where there is a compiler; drawing
examples may take as long as a loaded machine needs.

Workers begin with one half of the tests each and take tests from one another at the end, so that tests of one module
mostly meet in one worker and what they share is made once.
"""

from __future__ import annotations

from pathlib import Path

from hypothesis import HealthCheck, settings
from xdist.scheduler import WorkStealingScheduling

import hatch_build
from viatool import engine

if engine.library() is None and hatch_build.compile_kernel(Path(__file__).parents[1]):
    engine.library.cache_clear()  # of these sources now

settings.register_profile("viatool", suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("viatool")


def pytest_xdist_make_scheduler(config, log):
    return WorkStealingScheduling(config, log) if config.getoption("dist") == "load" else None
