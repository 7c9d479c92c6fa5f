"""Why a mission is not proved, in words."""

from __future__ import annotations

from viatool.report.missions.record import MissionRecord, MissionsRecord
from viatool.report.numbers import count, counted
from viatool.report.wording import describe_eps


def explain_mission(mission: MissionRecord, record: MissionsRecord) -> str:
    """Return what became of a mission, and why it is not proved, in sentences."""
    head = f"Mission {mission.scenario} is {mission.verdict}"
    if mission.verdict == "proved":
        return f"{head}: nothing to explain."
    told = [mission.reason, *_flawless(mission, record)]
    if mission.verdict == "refuted":
        told.append(
            "viatool mission with --output witnesses:FILE writes the run, and viatool replay drives it again"
        )
    else:
        told += _followed(mission, record)
    told += _needed(mission)
    return "\n\n".join([f"{head}.", " ".join(f"{one[0].upper()}{one[1:]}." for one in told)])


def _needed(mission: MissionRecord) -> list[str]:
    """Return which errors it takes, and what follows from that."""
    needs = mission.needs
    if needs is None:
        return ["Which of the errors it takes was not asked: --explain-errors of viatool mission does"]
    if needs.without_errors == "refuted":
        return ["It fails without any error as well: the policy has to act otherwise"]
    if needs.without_errors == "unknown":
        return [
            "It is not proved without any error either, so that the bounds are what is too wide, and no better sensor "
            "helps the proof"
        ]
    if needs.alone:
        return [
            f"It is proved without {' or without '.join(needs.alone)}, each alone, and all other errors in place"
        ]
    if not needs.others:
        return ["It is proved without any error; about single ones there was no time to ask"]
    return [f"It is proved without any error, and not without one alone of {', '.join(needs.others)}"]


def _flawless(mission: MissionRecord, record: MissionsRecord) -> list[str]:
    """Return what the run without any error did."""
    run = mission.flawless_run
    if run is None:
        return []
    near = run.clearance is not None and run.clearance <= record.collision_distance
    if near:
        return ["The run without any error comes too near as well: no better sensor helps"]
    if run.arrives is None:
        return ["The run without any error does not arrive either: no better sensor helps"]
    kept = "" if run.clearance is None else f" and keeps {run.clearance:.3f} m"
    return [
        f"The run without any error arrives after {run.arrives:.2f} s{kept} ({record.collision_distance:g} m to be "
        f"exceeded): it takes errors, within eps {describe_eps(record.eps)}, to make it fail"
        if mission.verdict == "refuted"
        else f"The run without any error arrives after {run.arrives:.2f} s{kept}, and no run was found that fails"
    ]


def _followed(mission: MissionRecord, record: MissionsRecord) -> list[str]:
    """Return how far runs were followed, and what follows them farther."""
    limits = record.limits
    followed = f"All runs were followed for {counted(mission.steps, 'interval')}"
    held = f"in {count(mission.parts)} parts at most, where {count(limits.parts)} are allowed"
    kept = "" if mission.clearance is None else f", and keep {mission.clearance:.3f} m until then"
    more = "More --parts, smaller --cell or a smaller --start-error may follow them farther"
    return [f"{followed}, {held}{kept}", more]
