"""The job of ``viatool margin``: policy, map and states give the largest error that each contested state survives."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence
from typing import Any, Literal

from viatool.errors import ConfigurationError
from viatool.margins.examination import CloseMarginWork, MarginExamination, MarginWork
from viatool.margins.examined import ExaminedStates
from viatool.margins.findings import MarginFindings
from viatool.margins.question import Inquiry
from viatool.margins.result import Margins
from viatool.policy import Policy, PolicySpecification, as_policy
from viatool.schedule import Campaign, Progress, Scheduler, ignore, open_scheduler
from viatool.setting.criteria import PROVING
from viatool.setting.wishes import Wishes
from viatool.simulate import Places
from viatool.taylor import Arithmetic, Refinement, engine_of
from viatool.taylor.approximation import Approximation
from viatool.trajectory import BagSettings, Trajectory
from viatool.uncertainty import ErrorModel, as_error_model
from viatool.verification.clock import Clock
from viatool.verification.close import CLOSE
from viatool.verification.examination import StateExamination
from viatool.verification.source import Source
from viatool.versions import result_versions
from viatool.world import Footprint, Scenario, WorldMap, as_map

_log = logging.getLogger(__name__)

StrPath = str | os.PathLike[str]
MOST = 0.5
STEPS = 256
"""The largest error that is tried, and by how much finer both ends are followed, where nothing else is asked."""


def margin(
    policy: Policy | StrPath,
    world_map: WorldMap | StrPath,
    *,
    eps: float | Mapping[str, float] | None = None,
    channels: Sequence[str] = (),
    term: str | None = None,
    most: float = MOST,
    resolution: float | None = None,
    also: Sequence[float] = (),
    errors: ErrorModel | StrPath | None = None,
    trajectory: Trajectory | StrPath | None = None,
    bag: BagSettings | None = None,
    places: Places | None = None,
    scenarios: Sequence[Scenario] | None = None,
    spec: PolicySpecification | StrPath | None = None,
    criterion: str = "swept",
    order: int = 1,
    approximation: Approximation = "chebyshev",
    refine: Refinement = "monotone",
    arithmetic: Arithmetic = "float32",
    clearance: float | None = None,
    danger: float | None = None,
    interval: float | None = None,
    footprint: Footprint | str | float | Sequence[Sequence[float]] | None = None,
    delay: float = 0.0,
    robot: str | None = None,
    prefer: Mapping[str, str] | None = None,
    noise: float | None = None,
    seed: int = 0,
    close: int = CLOSE,
    workers: int | Literal["auto"] = 1,
    scheduler: Scheduler | str | None = None,
    checkpoint: StrPath | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Margins:
    """Find how much error every contested state survives.

    Parameters
    ----------
    policy : Policy or path
        An ONNX policy; its network is checked against onnxruntime when it is loaded.
    world_map : WorldMap or path
        The map, its robot and clearances.
    eps : float or mapping, optional
        Without `channels` and `term` the proportions in which the channels err: all of them grow together, and the
        error is the radius of the one with the largest; by default, and of 0, all channels err by the same number, each
        in its own unit. Else what the channels stay at that do not vary; by default 0.
    channels : sequence of str
        Channels whose readings err, by the same number each, while the others stay as they are.
    term : str, optional
        Where a term of the error model stands that varies instead, such as ``pose.x``; all else stays as it is.
    most : float
        The largest error that is tried.
    resolution : float, optional
        How close both ends are followed; by default a 256th of `most`.
    also : sequence of float
        Errors of which it is to be known exactly whether they are survived, such as that of a gate.
    errors : ErrorModel or path, optional
        What else is bounded about the robot; terms that are not taken into account are refused by name.
    trajectory, bag, places, scenarios, spec
        As for `viatool.verify`.
    criterion : str
        "swept" or "braking".
    order, approximation, refine, arithmetic
        Settings of `viatool.reach`.
    clearance, danger, interval, footprint, delay, robot, prefer
        As for `viatool.verify`.
    noise, seed
        Of the simulated sensor; the seed is that of close places and of the search for counterexamples, too.
    close : int
        So many places beside the driven path are examined as well, as by `viatool.verify`; 0 for none.
    workers, scheduler, checkpoint, resume, progress
        As for `viatool.verify`.

    Returns
    -------
    Margins
        ``certified`` and ``refuted`` of the contested states ``states``, close places among them.

    Raises
    ------
    PolicyError, MapError, TrajectoryError, ConfigurationError, EmptyEvaluationError, WorkError
        As `viatool.verify`.
    ConfigurationError
        If nothing is left to vary, or what is named cannot.
    BoundsError
        If a state is proved safe within an error and refuted within a smaller one, which is a fault of viatool.

    Notes
    -----
    Sound: within `certified`, and within every smaller error, a state is safe under what the report lists as assumed;
    within `refuted`, and within every larger error, the deployed program fails, as onnxruntime was seen to do.
    """
    if criterion not in PROVING:
        raise ConfigurationError(f"criterion '{criterion}' proves nothing", f"choose {' or '.join(PROVING)}")
    wishes = Wishes(
        criterion,
        clearance,
        danger,
        interval,
        footprint,
        delay,
        robot=robot,
        prefer=prefer or {},
        errors=as_error_model(errors),
    )
    source, clock = Source(trajectory, bag, places, noise, seed), Clock()
    if scheduler is None or isinstance(scheduler, str):
        scheduler = open_scheduler(workers, scheduler)
    engine: dict[str, Any] = {
        "order": order, "approximation": approximation, "refine": refine, "arithmetic": arithmetic,
    }  # fmt: skip
    resolution = most / STEPS if resolution is None else resolution
    inquiry = Inquiry(eps, wishes, scenarios, tuple(channels), term, most, resolution, engine, seed)
    with clock.timed("load"):
        policy = as_policy(policy, spec)
        question = inquiry.of(policy, as_map(world_map))
    setting, widest = question.setting, question.widest
    with clock.timed("trajectory"):
        states = ExaminedStates.of(question, policy, source, close)
    commanding = widest.commanding(policy)
    examination = MarginExamination(
        StateExamination.of(commanding, widest, engine, only_contested=True, seed=seed),
        question.varying,
        most,
        resolution,
        _between(also, most),
    )
    _log.info("engine: %s, passes %s", inquiry.engine, engine_of(commanding.network))
    _log.info("states: %d from %s", len(states.driven), source.words(setting))
    campaign, versions = Campaign(scheduler, checkpoint, resume), result_versions()
    with clock.timed("examine"):
        found = campaign.carry_out(MarginWork(examination, states.states, versions), progress or ignore).part
        if states.close is not None:
            work = CloseMarginWork(examination, states.close, versions)
            beside = campaign.within("close").carry_out(work, progress or ignore).part
            found = MarginFindings.join([found, beside.moved(len(states.driven))])
    clock.share_out("examine", found.seconds)
    told = {name: value for name, value in engine.items() if name != "arithmetic"}
    return Margins(
        policy_path=policy.path,
        policy_sha256=policy.sha256,
        setting=setting,
        trajectory=states.trajectory,
        driven=len(states.driven),
        varied=question.varied,
        varying=question.varying,
        **states.known,
        arithmetic=arithmetic,
        engine={**told, "passes": engine_of(commanding.network)},
        findings=found,
        effect=question.premises,
        seconds=clock.seconds,
        versions=versions,
        origin=source.words(setting),
        no_close=states.reason,
    )


def _between(errors: Sequence[float], most: float) -> tuple[float, ...]:
    """Return the errors that are asked about; refuse those that are not tried."""
    for error in errors:
        if not 0.0 <= error <= most:
            raise ConfigurationError(
                f"an error of {error:g} is asked about, and errors from 0 to {most:g} are tried",
                f"try errors up to {error:g} with --most"
                if error > most
                else "ask about one that is not negative",
            )
    return tuple(float(error) for error in errors)
