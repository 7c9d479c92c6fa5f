"""The job: a policy, a map and a goal give a certificate for every pose."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from viatool.certify.certificate import Certificate
from viatool.certify.findings import Findings
from viatool.certify.judging import Question
from viatool.certify.search import search
from viatool.certify.tree import Lattice
from viatool.errors import ConfigurationError, EmptyEvaluationError
from viatool.policy import Policy
from viatool.safety import Layout, Rules
from viatool.taylor import Arithmetic
from viatool.versions import result_versions
from viatool.world import Footprint, Scenario, Scenes, WorldMap

_ROOTS_AT_ONCE = 1024
_MOST_ROOTS = 20_000_000
Tell = Callable[[str, int, int], None]


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


@dataclass(frozen=True)
class Budget:
    """When to stop; what was not examined then is counted apart.

    Parameters
    ----------
    seconds : float
        Wall-clock time.
    cells : int
        Leaves.
    share : float
        Of the roots, drawn at random: an unbiased estimate of the whole.
    """

    seconds: float = math.inf
    cells: int = 2**62
    share: float = 1.0


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
    footprint: Footprint | str | float | None = None,
    arithmetic: Arithmetic = "float32",
    resolution: Resolution | None = None,
    budget: Budget | None = None,
    seed: int = 0,
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
    arithmetic : str
        As in `viatool.reach`.
    resolution : Resolution, optional
        Of the smallest cells.
    budget : Budget, optional
        When to stop.
    seed : int
        Of the order of the roots, and of the search for counterexamples.
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
    criterion holds.
    """
    resolution, budget = resolution or Resolution(), budget or Budget()
    if criterion not in ("swept", "braking"):
        raise ConfigurationError(f"criterion '{criterion}' proves nothing", "choose swept or braking")
    world_map = world_map.with_clearance(clearance, None)
    if deceleration is not None:
        world_map = world_map.with_robot(replace(world_map.robot, deceleration=deceleration))
    rules = Rules.of(world_map, criterion, interval=interval, footprint=footprint)
    layout = Layout.of(policy, eps)
    if Scenes.of(world_map, [scenario]).blocked(np.array([scenario.goal]), np.zeros(1, np.int64))[0]:
        x, y = scenario.goal
        raise ConfigurationError(f"the goal ({x:g}, {y:g}) lies in an obstacle or off the map", "move it")
    question = Question.of(policy, world_map, scenario, layout, rules, arithmetic)
    smallest = (resolution.side, resolution.side, resolution.halvings)
    lattice = Lattice.over(world_map.bounds, (rules.lower, rules.upper), smallest)
    start = time.perf_counter()
    findings, examined = _examine(question, lattice, budget, seed, tell)
    if not (findings.status > 0).any():
        raise EmptyEvaluationError("no free place was examined", "lower the clearance or raise the budget")
    seconds = {"search": time.perf_counter() - start}
    return Certificate(
        policy, world_map, scenario, rules, layout, eps, arithmetic, lattice, findings, examined,
        int(np.prod(lattice.count)), seconds, result_versions(),
    )  # fmt: skip


def _examine(
    question: Question, lattice: Lattice, budget: Budget, seed: int, tell: Tell | None
) -> tuple[Findings, int]:
    """Examine roots in random order, so that what is done when the budget ends is a fair sample."""
    count = int(np.prod(lattice.count))
    if count > _MOST_ROOTS:
        raise ConfigurationError(f"{count:,} roots are too many", "make the smallest cells larger")
    order = np.random.default_rng(seed).permutation(count)
    order = order[: max(1, math.ceil(budget.share * count))]
    roots, found, leaves, start = lattice.roots(), [], 0, time.perf_counter()
    done = 0
    for first in range(0, len(order), _ROOTS_AT_ONCE):
        if leaves >= budget.cells or time.perf_counter() - start > budget.seconds:
            break
        some = np.sort(order[first : first + _ROOTS_AT_ONCE])
        found.append(search(question, lattice, roots.select(some), seed=seed))
        leaves, done = leaves + len(found[-1]), done + len(some)
        if tell is not None:
            tell("roots", done, len(order))
    return Findings.join(found), done
