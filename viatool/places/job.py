"""The job: a policy, a map and a goal give a certificate for every pose."""

from __future__ import annotations

import logging
import math
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats
from viatool.errors import ConfigurationError, EmptyEvaluationError
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.told import told_of_time
from viatool.places.campaign import RootExamination, RootWork, SearchBudget, describe
from viatool.places.certificate import Certificate
from viatool.places.explaining import cost_of_cells
from viatool.places.forecast import foretell
from viatool.places.lasting import Lookahead
from viatool.places.over_time import check_lookahead, look_ahead
from viatool.places.so_far import CellCount, Enough
from viatool.places.tree import Lattice
from viatool.policy import Policy, PolicySpecification, as_policy
from viatool.schedule import Campaign, Deadline, Progress, ignore
from viatool.setting.criteria import PROVING
from viatool.setting.error_costs import drop_each
from viatool.setting.rules import Rules
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate import NavigationTask
from viatool.taylor import Arithmetic
from viatool.uncertainty import ErrorModel, as_error_model
from viatool.versions import result_versions
from viatool.world import Footprint, Scenario, WorldMap, as_map

_log = logging.getLogger(__name__)

StrPath = str | os.PathLike[str]

_AFTERWARDS = 0.2
"""Of a budget in seconds, that is left after the search for judging cells again and following them where asked."""


@dataclass(frozen=True)
class Resolution:
    """How fine the cells are at most.

    Parameters
    ----------
    side : float
        Of the smallest cells, in metres along x and y; their heading opens as many radians as that.
    halvings : int
        How often the range of v, and of omega, of the step before may be halved: never where nothing depends on it.
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
    policy: Policy | StrPath,
    world_map: WorldMap | StrPath,
    scenario: Scenario | str | int = 0,
    *,
    eps: float | Mapping[str, float] | None = None,
    errors: ErrorModel | str | os.PathLike[str] | None = None,
    spec: PolicySpecification | StrPath | None = None,
    criterion: str = "braking",
    clearance: float | None = None,
    deceleration: float | None = None,
    interval: float | None = None,
    delay: float = 0.0,
    robot: str | None = None,
    prefer: Mapping[str, str] | None = None,
    footprint: Footprint | str | float | Sequence[Sequence[float]] | None = None,
    arithmetic: Arithmetic = "float32",
    resolution: Resolution | None = None,
    budget: SearchBudget | None = None,
    lookahead: Lookahead | None = None,
    explain_errors: bool = False,
    seed: int = 0,
    campaign: Campaign | None = None,
    tell: Progress = ignore,
    enough: Enough | None = None,
) -> Certificate:
    """Decide for every pose of a map, and every command before it, whether the next action is safe.

    Parameters
    ----------
    policy : Policy or path
        With a specification of channels that can be simulated.
    world_map : WorldMap or path
        Where.
    scenario : Scenario, str or int
        Among which obstacles and towards which goal; a number is that of one of the map's.
    errors : ErrorModel or path, optional
        What else is bounded about the robot; terms that are not taken into account are refused by name.
    eps : float or mapping, optional
        Sensor error, as in `viatool.verify`.
    spec : PolicySpecification or path, optional
        Specification of a policy that carries none.
    criterion : str
        "swept" or "braking".
    clearance, deceleration, interval, footprint
        Instead of the map's and the robot's.
    delay : float
        Dead time in seconds, for which the commands before go on.
    robot, prefer
        As in `viatool.verify`.
    arithmetic : str
        As in `viatool.reach`.
    resolution : Resolution, optional
        Of the smallest cells.
    budget : SearchBudget, optional
        When to stop.
    lookahead : Lookahead, optional
        What is asked beyond the next action.
    explain_errors : bool
        Also find out what each error costs: judge the cells that are not certified again without it.
    seed : int
        Of the order of the roots, and of the search for counterexamples.
    campaign : Campaign, optional
        Who does the work, and where it is kept; by default this process.
    tell : Progress
        Told the stage, the roots done and the roots in all.
    enough : callable, optional
        Called after each piece of the roots with what is known, a `viatool.places.so_far.CellsKnown`; once it is true
        the roots behind are not examined, see `Certificate.unjudged`.

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
        If no free place was examined, or no root at all within the budget.

    Notes
    -----
    Sound: yes. From every pose of a certified or uncontested cell that keeps the collision distance, for every
    observation within eps of what perfect sensors read there and every command before it within the cell, the
    criterion holds. What looking ahead adds is as sound: see `viatool.places.over_time`.
    """
    resolution, budget = resolution or Resolution(), budget or SearchBudget()
    if criterion not in PROVING:
        raise ConfigurationError(f"criterion '{criterion}' proves nothing", f"choose {' or '.join(PROVING)}")
    policy = as_policy(policy, spec)
    world_map = as_map(world_map)
    scenario = scenario if isinstance(scenario, Scenario) else world_map.scenario(scenario)
    wishes = Wishes(
        criterion,
        clearance,
        None,
        interval,
        footprint,
        delay,
        deceleration,
        robot,
        prefer or {},
        as_error_model(errors),
    )
    setting = Setting.of(policy, world_map, eps, wishes, [scenario], job="certify")
    episode = NavigationTask().horizon
    setting = told_of_time(setting, f"any number up to the {episode} of an episode")
    rules = setting.rules
    loop = ClosedLoop.of(policy, setting, scenario, arithmetic, episode=episode)
    smallest = (resolution.side, resolution.side, _halvings(resolution, setting))
    lookahead = lookahead or Lookahead()
    grain = max(1, lookahead.coarser)
    lattice = Lattice.over(setting.world_map.bounds, _before(rules), smallest, grain)
    if lookahead.asked and enough is not None:
        raise ConfigurationError(
            "what holds beyond the next action is found of all cells, and some are to be left out",
            "leave out --steps, --forever and --arrive, or --stop-early",
        )
    if lookahead.asked:
        check_lookahead(lookahead, rules, lattice, moving=loop.around.moving is not None)
    _log.info(
        "cells: %d roots of %s, halved down to sides of %g m, their ranges of commands %d times",
        int(np.prod(lattice.count)),
        " x ".join(map(str, lattice.count)),
        resolution.side,
        smallest[2],
    )
    start = time.perf_counter()
    examination = RootExamination(loop, lattice, seed)
    work = RootWork(examination, budget.share, describe(examination, scenario))
    campaign = campaign or Campaign()
    search_until = budget.until.moved(-_AFTERWARDS) if lookahead.asked or explain_errors else budget.until
    left = search_until.left
    if tell is not ignore and math.isinf(left) and not campaign.resume:
        foretell(work, campaign.scheduler.workers, tell)
    watch = None if enough is None else CellCount(lattice, enough)
    found = campaign.carry_out(
        work,
        tell,
        until=search_until,
        enough=lambda parts: (watch is not None and watch(parts)) or sum(map(len, parts)) >= budget.cells,
    )
    if not found.units:
        raise _too_short(search_until, left, campaign.scheduler.workers)
    if not (found.part.status > 0).any():
        raise EmptyEvaluationError("no free place was examined", "lower the clearance or raise the budget")
    seconds = {"search": time.perf_counter() - start}
    _log.info("search: took %.3f s, %d roots, %d cells", seconds["search"], found.units, len(found.part))
    costs, lasting = None, None
    if explain_errors:

        def ask(wished: Wishes, radii: Mapping[str, float]) -> Setting:
            return Setting.of(policy, world_map, radii, wished, [scenario], job="certify")

        def loop_of(other: Setting) -> ClosedLoop:
            return ClosedLoop.of(policy, other, scenario, arithmetic, episode=episode)

        start = time.perf_counter()
        explain_until = budget.until.moved(-0.5 * _AFTERWARDS) if lookahead.asked else budget.until
        costs = cost_of_cells(
            found.part, lattice, drop_each(setting, wishes, ask), loop_of, campaign, tell, seed=seed,
            until=explain_until,
        )  # fmt: skip
        seconds["explain"] = time.perf_counter() - start
    if lookahead.asked:
        start = time.perf_counter()
        lasting = look_ahead(
            loop, lattice, found.part, scenario.goal, lookahead, campaign, tell, until=budget.until
        )
        seconds["over_time"] = time.perf_counter() - start
    return Certificate(
        policy, setting, scenario, arithmetic, lattice, found.part, found.units,
        int(np.prod(lattice.count)), seconds, result_versions(), lasting, costs,
        watch.known.unjudged if watch is not None and watch.satisfied else 0,
    )  # fmt: skip


def _before(rules: Rules) -> tuple[Floats, Floats]:
    """Return the ends (K,) of what stands behind the pose of cells.

    Raises
    ------
    ConfigurationError
        If nothing limits the state of the motion.
    """
    kinematics = rules.kinematics
    if not kinematics.state:
        return rules.lower, rules.upper
    lower, upper = kinematics.state_range
    if not (np.isfinite(lower).all() and np.isfinite(upper).all()):
        raise ConfigurationError(
            f"cells hold every state that the robot's motion may have, and its {kinematics.state_words}",
            "give the map's robot its largest speeds",
        )
    return lower, upper


def _halvings(resolution: Resolution, setting: Setting) -> int:
    """Return how often what stands behind the pose is halved: not at all where nothing depends on it."""
    rules = setting.rules
    acts = rules.varies or rules.delay > 0.0 or bool(rules.kinematics.state)
    return resolution.halvings if acts or setting.quantities.answer_to_before else 0


def _too_short(until: Deadline, left: float, workers: int) -> EmptyEvaluationError:
    """Return what to raise when the time was up before one root was examined, `left` seconds after the search began."""
    if left <= 0.0:
        return EmptyEvaluationError(
            f"the budget of {until.budget:g} s was used up before the search could begin", "raise the budget"
        )
    search = f"the budget of {until.budget:g} s left {left:.1f} s for the search"
    if workers > 1:
        return EmptyEvaluationError(
            f"{search}, in which none of {workers} workers had started and examined a root",
            "give 1 worker, which need not start, or raise the budget",
        )
    return EmptyEvaluationError(f"{search}, in which no root was examined to its end", "raise the budget")
