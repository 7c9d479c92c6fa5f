"""The job of ``viatool simulate``: drive a policy, and keep everything that a report of it needs."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats, Indices
from viatool.policy import Policy
from viatool.schedule import Progress
from viatool.setting.asked import Asked
from viatool.setting.premises import Premise
from viatool.setting.setting import Setting
from viatool.simulate.conditions import Conditions
from viatool.simulate.roll_out import Drive, drive
from viatool.simulate.statistics import Statistics, summarise_drive


@dataclass(frozen=True, eq=False)
class MonitoredDrive:
    """What came of the same scenarios when a monitor stood between policy and robot.

    Parameters
    ----------
    statistics : Statistics
        Of this drive.
    outcomes : ndarray
        (N,) of its episodes.
    least_clearance : ndarray
        (N,) the smallest of each episode, in metres.
    interventions : ndarray
        (N,) intervals of each episode in which the policy's command did not pass.
    unproved : ndarray
        (N,) intervals of each episode in which nothing was proved, as it began too near to something.
    intervals : int
        Of all episodes.
    seconds : float
        Wall time.
    """

    statistics: Statistics
    outcomes: NDArray[np.str_]
    least_clearance: Floats
    interventions: Indices
    unproved: Indices
    intervals: int
    seconds: float


@dataclass(frozen=True, eq=False)
class Simulation(Asked):
    """A policy that was driven, how, and what came of it.

    Parameters
    ----------
    policy : Policy
        That decided.
    setting : Setting
        Where it drove, with the robot that did.
    engine : str
        "kinematic" or "bullet".
    lidar : str
        "rays" or "analytic".
    conditions : Conditions
        Of the robot.
    seed : int
        Of scenarios and noise.
    drive : Drive
        The states.
    statistics : Statistics
        Their figures.
    seconds : float
        Wall time.
    adversary : bool
        Whether an adversary chose the errors of the model.
    monitored : MonitoredDrive, optional
        The same scenarios under the monitor.
    """

    policy: Policy
    setting: Setting
    engine: str
    lidar: str
    conditions: Conditions
    seed: int
    drive: Drive
    statistics: Statistics
    seconds: float
    adversary: bool = False
    monitored: MonitoredDrive | None = None

    @property
    def premises(self) -> tuple[Premise, ...]:
        """Return what took effect, and who said so."""
        return self.setting.driving_premises

    def beyond_limits(self) -> list[str]:
        """Return in words which commands of the policy the robot cannot follow."""
        rules, robot = self.setting.rules, self.setting.robot
        able = {
            axis.kind: (low, high, axis.unit)
            for axis, low, high in zip(rules.kinematics.axes, rules.lower, rules.upper, strict=True)
        }
        told = []
        for asked in self.setting.spec.axes:
            low, high, unit = able.get(asked.kind, (-np.inf, np.inf, ""))
            if asked.lower < low - 1e-9 or asked.upper > high + 1e-9:
                told.append(
                    f"{asked.name} {asked.lower:g} to {asked.upper:g} {unit}, {robot.name} does {low:g} to {high:g}"
                )
        return told


def simulate(
    policy: Policy,
    setting: Setting,
    *,
    engine: str = "kinematic",
    conditions: Conditions | None = None,
    horizon: int | None = None,
    seed: int = 0,
    workers: int = 1,
    lidar: str | None = None,
    adversary: bool = False,
    progress: Progress | None = None,
) -> Simulation:
    """Drive a policy through scenarios and sum up what happened; everything is as for `drive`."""
    started = time.perf_counter()
    driven = drive(
        policy,
        setting,
        engine=engine,
        conditions=conditions,
        horizon=horizon,
        seed=seed,
        workers=workers,
        lidar=lidar,
        errors=setting.uncertainty,
        adversary=adversary,
        progress=progress,
    )
    return Simulation(
        policy=policy,
        setting=setting,
        engine=engine,
        lidar=lidar or ("rays" if engine == "bullet" else "analytic"),
        conditions=conditions or Conditions(),
        seed=seed,
        drive=driven,
        statistics=summarise_drive(driven, setting),
        seconds=time.perf_counter() - started,
        adversary=adversary,
    )
