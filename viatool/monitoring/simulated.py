"""The monitor in simulation: the same scenarios with and without it, and what it costs."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from viatool.arrays import Booleans, Floats
from viatool.errors import ConfigurationError
from viatool.monitoring.guard import POLICY, Guard, Watch
from viatool.policy import Policy
from viatool.setting.setting import Setting
from viatool.simulate import Simulation, simulate
from viatool.simulate.conditions import Conditions
from viatool.simulate.roll_out import drive
from viatool.simulate.simulation import MonitoredDrive
from viatool.simulate.simulator import Simulator
from viatool.simulate.statistics import summarise_drive


class Supervision:
    """The monitor of the robots of a simulator, and what it did in each episode.

    Parameters
    ----------
    guard : Guard
        Of the scenarios of the simulation, in their order.
    """

    def __init__(self, guard: Guard) -> None:
        self.guard = guard
        self.interventions, self.unproved = np.zeros((2, len(guard.scenarios)), np.int64)
        self.intervals = 0
        self._watch: Watch | None = None

    def __call__(self, simulator: Simulator, observations: Floats, commands: Floats) -> Floats:
        """Decide what robots are told; see `Supervisor`."""
        if self._watch is None:
            self._watch = Watch(self.guard, len(simulator))
        found = self._watch.decide(simulator.believed, simulator.scene, commands)
        self.intervals += len(simulator)
        np.add.at(self.interventions, simulator.scene, found.source != POLICY)
        np.add.at(self.unproved, simulator.scene, ~found.proved)
        return found.commands

    def begin(self, which: Booleans) -> None:
        """See `Supervisor`."""
        assert self._watch is not None
        self._watch.begin(np.flatnonzero(which))

    def keep(self, which: Booleans) -> None:
        """See `Supervisor`."""
        assert self._watch is not None
        self._watch.keep(which)


def simulate_monitored(
    policy: Policy,
    setting: Setting,
    monitor: Setting,
    *,
    engine: str = "kinematic",
    conditions: Conditions | None = None,
    **settings: Any,
) -> Simulation:
    """Simulate as `simulate` does, and once more with the same seed under the monitor.

    Parameters
    ----------
    policy : Policy
        That decides.
    setting, monitor : Setting
        What is asked of the simulation, and of the monitor (job ``monitor``, criterion ``braking``).
    engine, conditions, **settings
        As for `simulate`.

    Raises
    ------
    ConfigurationError
        If the simulated robot does what the monitor does not count with.
    """
    conditions = conditions or Conditions()
    _check(engine, conditions)
    found = simulate(policy, setting, engine=engine, conditions=conditions, **settings)
    started = time.perf_counter()
    supervision = Supervision(Guard(monitor, setting.scenarios))
    driven = drive(
        policy,
        setting,
        engine=engine,
        conditions=conditions,
        errors=setting.uncertainty,
        supervisor=supervision,
        **settings,
    )
    return replace(
        found,
        monitored=MonitoredDrive(
            statistics=summarise_drive(driven, setting),
            outcomes=driven.trajectory.outcomes,
            least_clearance=driven.least_clearance,
            interventions=supervision.interventions,
            unproved=supervision.unproved,
            intervals=supervision.intervals,
            seconds=time.perf_counter() - started,
        ),
    )


def _check(engine: str, conditions: Conditions) -> None:
    """Refuse what the monitor does not count with."""
    beyond = {
        f"engine {engine}": engine != "kinematic",
        f"odometry drift {conditions.drift:g}": conditions.drift > 0.0,
        f"wheel acceleration {conditions.acceleration} m/s^2": conditions.acceleration is not None,
        f"{conditions.people} people": conditions.people > 0,
    }
    for what, is_so in beyond.items():
        if is_so:
            raise ConfigurationError(
                f"the monitor does not count with {what}",
                "leave that out, or leave out --monitor; docs/monitor.md says what the monitor assumes",
            )
