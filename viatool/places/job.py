"""The job: a policy, a map and a goal give a certificate for every pose."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from viatool.errors import ConfigurationError, EmptyEvaluationError
from viatool.loop.question import Question
from viatool.places.campaign import Budget, Campaign, Inspection, Tell, describe
from viatool.places.certificate import Certificate
from viatool.places.over_time import Outlook, look_ahead
from viatool.places.tree import Lattice
from viatool.policy import Policy
from viatool.setting.layout import Layout
from viatool.setting.rules import Rules
from viatool.taylor import Arithmetic
from viatool.versions import result_versions
from viatool.world import Footprint, Scenario, Scenes, WorldMap


@dataclass(frozen=True)
class Resolution:
    """How fine the cells are at most.

    Parameters
    ----------
    side : float
        Of the smallest cells, in metres along x and y; their heading opens as many radians as that.
    halvings : int
        How often the range of v, and of omega, of the step before may be halved.
    """

    side: float = 0.02
    halvings: int = 1

    def __post_init__(self) -> None:
        if not 1e-4 <= self.side < math.inf:
            raise ConfigurationError(f"the smallest side is {self.side} m", "give at least 0.0001 m")
        if not 0 <= self.halvings <= 8:
            raise ConfigurationError(
                f"commands are halved {self.halvings} times", "give a number from 0 to 8"
            )


def certify(
    policy: Policy,
    world_map: WorldMap,
    scenario: Scenario,
    *,
    eps: float | Mapping[str, float],
    criterion: str = "braking",
    clearance: float | None = None,
    deceleration: float | None = None,
    interval: float | None = None,
    delay: float = 0.0,
    footprint: Footprint | str | float | None = None,
    arithmetic: Arithmetic = "float32",
    resolution: Resolution | None = None,
    budget: Budget | None = None,
    outlook: Outlook | None = None,
    seed: int = 0,
    campaign: Campaign | None = None,
    tell: Tell | None = None,
) -> Certificate:
    """Decide for every pose of a map, and every command before it, whether the next action is safe.

    Parameters
    ----------
    policy : Policy
        With a specification of channels that can be simulated.
    world_map, scenario
        Where, among which obstacles and towards which goal.
    eps : float or mapping
        Sensor error, as in `viatool.verify`.
    criterion : str
        "swept" or "braking".
    clearance, deceleration, interval, footprint
        Instead of the map's and the robot's.
    delay : float
        Dead time in seconds, for which the command before goes on.
    arithmetic : str
        As in `viatool.reach`.
    resolution : Resolution, optional
        Of the smallest cells.
    budget : Budget, optional
        When to stop.
    outlook : Outlook, optional
        What is asked beyond the next action.
    seed : int
        Of the order of the roots, and of the search for counterexamples.
    campaign : Campaign, optional
        Who does the work, and where it is kept; by default this process.
    tell : callable, optional
        Called with the stage, the roots done and the roots in all.

    Returns
    -------
    Certificate
        What is certified, refuted and unknown.

    Raises
    ------
    ConfigurationError
        If an option is out of its range, or the goal lies in an obstacle.
    PolicyError
        If the policy has no specification, or observes what cannot be simulated.
    EmptyEvaluationError
        If no free place was examined.

    Notes
    -----
    Sound: yes. From every pose of a certified or uncontested cell that keeps the collision distance, for every
    observation within eps of what perfect sensors read there and every command before it within the cell, the
    criterion holds. What the outlook adds is as sound: see `viatool.places.over_time`.
    """
    resolution, budget = resolution or Resolution(), budget or Budget()
    if criterion not in ("swept", "braking"):
        raise ConfigurationError(f"criterion '{criterion}' proves nothing", "choose swept or braking")
    world_map = world_map.with_clearance(clearance, None)
    if deceleration is not None:
        world_map = world_map.with_robot(replace(world_map.robot, deceleration=deceleration))
    rules = Rules.of(world_map, criterion, interval=interval, footprint=footprint, delay=delay)
    layout = Layout.of(policy, eps)
    if Scenes.of(world_map, [scenario]).blocked(np.array([scenario.goal]), np.zeros(1, np.int64))[0]:
        x, y = scenario.goal
        raise ConfigurationError(f"the goal ({x:g}, {y:g}) lies in an obstacle or off the map", "move it")
    question = Question.of(policy, world_map, scenario, layout, rules, arithmetic)
    smallest = (resolution.side, resolution.side, resolution.halvings)
    outlook = outlook or Outlook()
    grain = max(1, outlook.coarser)
    lattice = Lattice.over(world_map.bounds, (rules.lower, rules.upper), smallest, grain)
    start = time.perf_counter()
    inspection = Inspection(question, lattice, seed)
    about = describe(inspection, world_map, scenario)
    campaign = campaign or Campaign()
    findings, examined = campaign.carry_out(inspection, budget, about, tell)
    if not (findings.status > 0).any():
        raise EmptyEvaluationError("no free place was examined", "lower the clearance or raise the budget")
    seconds = {"search": time.perf_counter() - start}
    prospect = None
    if outlook.asked:
        start = time.perf_counter()
        prospect = look_ahead(question, lattice, findings, scenario.goal, outlook, campaign.scheduler, tell)
        seconds["over_time"] = time.perf_counter() - start
    return Certificate(
        policy, world_map, scenario, rules, layout, eps, arithmetic, lattice, findings, examined,
        int(np.prod(lattice.count)), seconds, result_versions(), prospect,
    )  # fmt: skip
