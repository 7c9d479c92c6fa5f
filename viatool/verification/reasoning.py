"""Finds out why states are not safe: what they come near to, by which command, for want of what, and by which error.

Only states that are not safe are looked at, the worst of them if they are many, so that a run in which few are not safe
takes no longer than without.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices
from viatool.safety import Contested
from viatool.safety.nearest import describe_mover
from viatool.safety.reasons import Reason, Reasons
from viatool.safety.worst import ClosestCommands, name_obstacles
from viatool.setting.needed import NeededErrors, needed_errors
from viatool.taylor import bounds_in_passing
from viatool.taylor.memory import refines_at_once
from viatool.verification.examination import judge_attained
from viatool.verification.findings import StateFindings
from viatool.verification.rejudging import Rejudging
from viatool.verification.states import States

_log = logging.getLogger(__name__)

MOST = 1000
"""States of which a run tells why they are not safe."""
JUDGED, _OF_LARGE = 256, 8
"""Those of them that are judged again without errors; of a large network, of which each verdict takes long."""
_SPLIT = 4
"""Those of which bounds are split, to tell whether they were too loose; of a large network none."""
_HALVINGS = 4
"""How often the share of eps that a state survives is halved."""


def find_reasons(
    again: Rejudging, states: States, findings: StateFindings, *, most_judged: int = JUDGED
) -> Reasons:
    """Find out why states are not safe.

    Parameters
    ----------
    again : Rejudging
        What was asked of N states.
    states : States
        These states.
    findings : StateFindings
        What is known of them.
    most_judged : int
        Of how many is found out which errors they take; of a large network of fewer.

    Returns
    -------
    Reasons
        Of `MOST` states at most, the worst first.

    Notes
    -----
    Which errors a state needs and how small they have to be is found by the proof that gives verdicts, for as many of
    them as time allows. Sound: what is said to be safe is proved, what is said to fail was found to.
    """
    rows, standing, total = _worst(again, states, findings)
    if not rows.size:
        return Reasons((), total)
    some, found = states.select(rows), findings.rows(rows)
    seen = _Seen.join([
        _look(again, block, found.rows(np.arange(block.first, block.first + len(block))))
        for block in some.each_block()
    ])  # fmt: skip
    asked = rows[: min(most_judged, _affordable(again))]
    _log.info(
        "reasons: of %d that are not safe %d are told of, %d judged again", total, len(rows), len(asked)
    )
    judged = _judge_again(again, some.select(np.arange(len(asked))), asked, found, seen)
    return Reasons(tuple(_told(again, rows, standing, found, seen, judged)), total)


def _worst(again: Rejudging, states: States, findings: StateFindings) -> tuple[Indices, Floats, int]:
    """Return the states to tell of, (R,), unsafe ones first, and the nearest of each before the others.

    With them the clearance where they stand, (R,) metres, and how many states are not safe.
    """
    lost = np.flatnonzero(~findings.judgement.safe)
    if not lost.size:
        return lost, np.zeros(0), 0
    placed = again.examination.placed(states.select(lost))
    standing = placed.still.footprint_clearance(placed.poses, again.setting.rules.footprint, placed.scene)
    clearance, unsafe = standing.copy(), np.isin(lost, findings.witnesses.state)
    clearance[unsafe] = findings.witnesses.clearance
    worst = np.lexsort([lost, clearance, ~unsafe])[:MOST]
    return lost[worst], standing[worst], len(lost)


def _affordable(again: Rejudging) -> int:
    network = again.examination.policy.network
    if not bounds_in_passing(network):
        return 0
    return JUDGED if refines_at_once(network) else _OF_LARGE


@dataclass(frozen=True, eq=False)
class _Seen:
    """What geometry and bounds tell of R states."""

    known: Booleans
    command: Floats
    clearance: Floats
    seconds: Floats
    pose: Floats
    obstacle: NDArray[np.object_]
    bound: Floats
    attained: Floats
    attained_clearance: Floats
    attained_holds: Booleans

    @classmethod
    def join(cls, parts: list[_Seen]) -> _Seen:
        """Return what is known of all blocks."""
        return cls(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(cls)))


def _look(again: Rejudging, block: States, found: StateFindings) -> _Seen:
    """Look at what a block of states comes near to, by which command."""
    examination, setting = again.examination, again.setting
    sensors = examination.sensors(block, examination.placed(block))
    judged, policy = sensors.judged, setting.driven(examination.policy)
    every = np.ones(len(block), dtype=bool)
    reachable = found.reachable
    if not policy.is_plain:  # of which commands are known alone, and not what they come from
        reachable = sensors.reach(examination.policy, examination.efforts[-1], every, every)
    pieces = sensors.pieces(policy, reachable)
    attained = judge_attained(policy, reachable, judged, Contested(every, ~every), sensors)
    worst = ClosestCommands.of(judged, pieces)
    inner = ClosestCommands.of(judged, attained.pieces)
    failing = worst.met(found.witnesses)
    obstacle = np.array(name_obstacles(setting.world_map, block.scenarios, judged, failing), dtype=object)
    moved = found.witnesses
    for row in np.flatnonzero(moved.mover != "").tolist():
        obstacle[moved.state[row]] = describe_mover(moved.mover[row], moved.origin[row], moved.velocity[row])
    clip = setting.rules.clip
    return _Seen(
        judged.provable, failing.command, failing.clearance, failing.seconds, failing.pose, obstacle,
        np.stack([clip(end) for end in pieces.hull()], axis=1),
        np.stack([clip(end) for end in attained.pieces.hull()], axis=1),
        inner.clearance, attained.known & attained.judgement.safe,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Judged:
    """What judging D states again tells.

    Parameters
    ----------
    without : ndarray
        (D,) the verdict without any error; empty where that could not be asked.
    needed : NeededErrors
        By which errors they fail.
    share : ndarray
        (D,) the largest share of eps up to which they are proved; NaN where that was not asked.
    refined : ndarray
        (D,) 1 where ``refine="split"`` proves them, 0 where it does not, -1 where that was not asked.
    """

    without: NDArray[np.str_]
    needed: NeededErrors
    share: Floats
    refined: Indices


def _judge_again(
    again: Rejudging, states: States, rows: Indices, found: StateFindings, seen: _Seen
) -> _Judged:
    """Judge the first D states again, ``rows`` of all: without errors, within smaller ones, with more effort."""
    count, terms = len(rows), len(again.without.terms)
    verdict = np.where(np.isin(np.arange(count), found.witnesses.state), "unsafe", "unknown")
    without, ideal = verdict, np.zeros(count, dtype=bool)
    if count and (bare := again.without.bare) is not None:
        flawless = again.searched(bare, rows)
        ideal = flawless.judgement.safe
        without = np.where(ideal, "safe", "unknown")
        without[flawless.witnesses.state] = "unsafe"
    elif terms:
        without = np.full(count, "")
    return _Judged(
        without,
        needed_errors(ideal, terms, lambda some, gone: again.proved_without(rows[some], gone)),
        _survived(again, states, ideal),
        _refined(again, states, (verdict == "unknown") & seen.attained_holds[:count]),
    )


def _survived(again: Rejudging, states: States, ideal: Booleans) -> Floats:
    """Return up to which share of eps states are proved that are so without any error, (D,); NaN for the others."""
    share, radii = np.where(ideal, 0.0, np.nan), again.setting.radii
    rows = np.flatnonzero(ideal)
    if not radii.any():
        return np.full(len(states), np.nan)
    for halving in range(_HALVINGS if rows.size else 0):
        tried = share[rows] + 0.5 ** (halving + 1)
        holds = again.proved_within(states.select(rows), tried[:, None] * radii)
        share[rows[holds]] = tried[holds]
    return share


def _refined(again: Rejudging, states: States, loose: Booleans) -> Indices:
    """Tell of which of the first few states whose bounds are loose splitting proves that they are, (D,)."""
    refined = np.full(len(states), -1)
    rows = np.flatnonzero(loose)[:_SPLIT]
    small = refines_at_once(again.examination.policy.network)
    if rows.size and small and again.examination.efforts[-1]["refine"] != "split":
        refined[rows] = again.proved_by(states.select(rows), {"refine": "split"})
    return refined


def _told(
    again: Rejudging, rows: Indices, standing: Floats, found: StateFindings, seen: _Seen, judged: _Judged
) -> Iterator[Reason]:
    """Yield the reason of each of R states, of which the first D were judged again."""
    setting, trajectory, without = again.setting, again.trajectory, again.without
    refuted, distance = set(found.witnesses.state.tolist()), setting.rules.clearance.collision
    radii, nothing = setting.errors.to_json(), np.zeros(len(without.terms), dtype=bool)
    for row, state in enumerate(rows.tolist()):
        asked, unsafe = row < len(judged.without), row in refuted
        ideal = str(judged.without[row]) if asked else ""
        share = float(judged.share[row]) if asked else np.nan
        least = judged.needed.least[row] if asked else nothing
        others = judged.needed.alone[row] & ~least if asked else nothing
        yield Reason(
            state=state,
            verdict="unsafe" if unsafe else "unknown",
            scenario=trajectory.name_of(int(trajectory.episode[state])),
            time=float(trajectory.time[state]),
            pose=tuple(trajectory.poses[state].tolist()),
            criterion=setting.rules.criterion,
            distance=distance,
            cause="pose" if standing[row] <= distance else _cause(unsafe, ideal, seen, row, distance),
            standing=float(standing[row]),
            obstacle=str(seen.obstacle[row]),
            command=seen.command[row],
            clearance=float(seen.clearance[row]),
            seconds=float(seen.seconds[row]),
            at=tuple(seen.pose[row].tolist()),
            bound=seen.bound[row],
            attained=seen.attained[row],
            attained_clearance=float(seen.attained_clearance[row]),
            without_errors=ideal,
            needs=without.picked(least),
            alternatives=without.picked(others),
            share=share,
            eps=_scaled(radii, share),
            refined=None if not asked or judged.refined[row] < 0 else bool(judged.refined[row]),
            of_sensors=without.of_sensors,
            actions=tuple((action.name, action.unit) for action in setting.commands),
        )


def _cause(unsafe: bool, without: str, seen: _Seen, row: int, distance: float) -> str:
    """Return why a state is not safe, as `CAUSES` names it."""
    if without == "unsafe":
        return "policy"
    if unsafe:
        return "errors"
    if not seen.known[row]:
        return "unobserved"
    if seen.attained_holds[row]:
        return "bounds"
    return "commands" if seen.attained_clearance[row] <= distance else "open"


def _scaled(radii: float | Mapping[str, float], share: float) -> float | dict[str, float]:
    if isinstance(radii, Mapping):
        return {name: share * radius for name, radius in radii.items()}
    return share * radii
