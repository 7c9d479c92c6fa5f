"""How the tests are run when nothing is said about it."""

from __future__ import annotations

import pytest


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> None:
    """Run the whole suite in two processes; what is named, a room or a test, in one, which starts sooner."""
    everything = config.args_source is pytest.Config.ArgsSource.TESTPATHS
    if everything and not config.option.usepdb and getattr(config.option, "numprocesses", 0) is None:
        config.option.numprocesses = 2
