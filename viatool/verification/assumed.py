"""What the verdicts of states rest on, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from viatool.motion.actuated import STANDING

if TYPE_CHECKING:
    from viatool.verification.result import Result


def assumptions_of(result: Result) -> dict[str, Any]:
    """Return what the verdicts rest on, by name."""
    rules = result.rules
    grid = result.world_map.obstacles.grid
    stop = rules.manoeuvre.deceleration
    held = rules.interval if rules.timing is None else rules.timing.interval[1]
    reached = "reached at once" if rules.actuation.is_ideal else "followed as the error model says"
    taken = "free" if grid is not None and grid.unknown_is_free else "obstacles"
    unknown = "" if grid is None else f"; unknown cells count as {taken}"
    return {
        "states": "; ".join([result.origin or "of unknown origin", *result.trajectory.notes]),
        **({"recording": "; ".join(map(str, result.recording))} if result.recording else {}),
        **({"close_places": told} if (told := _close(result)) else {}),
        "before_the_network": result.maps.before,
        "after_the_network": result.maps.after,
        "footprint": rules.footprint.words,
        "clearance": f"more than {rules.clearance.collision:g} m (danger: {rules.clearance.danger:g} m)",
        "commands": (f"clipped to {rules.kinematics.range_words(rules.lower, rules.upper)}, {reached}"),
        "motion": f"{rules.moves_as}, from {_from(result)}{_begun(result)}",
        "horizon": f"one command, held for {held:g} s; each state by itself, not the whole run"
        + ("" if result.horizon is None else f". {result.horizon.meaning}"),
        "delay": (f"{rules.delay:g} s" if rules.delay else "none")
        if rules.timing is None
        else rules.timing.words,
        "braking": "not asked" if stop is None else f"{stop:g} m/s^2",
        "obstacles": f"{_moving(result)}; whatever lies outside the arena is an obstacle{unknown}",
        "sensor_error": _sensors(result),
        **({"memory": result.setting.memory_words} if result.setting.spec.memory else {}),
    }


def _from(result: Result) -> str:
    """Return in words from which poses a state is judged."""
    x, y, theta = result.setting.pose_radii
    if not result.setting.pose_radii.any():
        return "the exact pose of the state"
    return f"every pose within {x:g} m, {y:g} m and {theta:g} rad of that of the state"


def _begun(result: Result) -> str:
    """Return in words what the motion begins with, of a robot for which it matters."""
    kinematics = result.rules.kinematics
    if not kinematics.state:
        return ""
    names = " and ".join(axis.name for axis in kinematics.state)
    exact = bool((result.begun[:, 0] == result.begun[:, 1]).all())
    known = "as it was recorded" if exact else "within the error of what was measured"
    return f" and its {names} {known}; {kinematics.state_words}, where it stops changing"


def _moving(result: Result) -> str:
    """Return in words whether obstacles move."""
    places = [place for place, _ in result.setting.uncertainty.premises() if place.startswith("obstacles.")]
    if not places:
        return "do not move"
    machine = result.rules.machine
    slow = f" (is no faster than {STANDING:g} m/s)" if machine is not None and machine.lag else ""
    passive = f", and counts until the robot stands{slow}" if result.rules.manoeuvre.passive else ""
    told = ", ".join(places)
    return (
        f"what is bounded by {told} may move in any direction from where it was observed, or be anywhere within "
        f"its region where it roams, and nothing else does{passive}"
    )


def _close(result: Result) -> str:
    """Return in words where close places come from, or why there are none; empty if none were asked for."""
    if result.close is None:
        return f"none: {result.no_close}" if result.no_close else ""
    return f"{len(result.close.trajectory):,}, {'; '.join(result.close.trajectory.notes)}"


def _sensors(result: Result) -> str:
    """Return in words what sensors may err, and what a recorded scan says of one that errs as a whole."""
    errors = result.setting.reading_errors
    if not errors.scans:
        return errors.words
    return f"{errors.words}; a scan that errs as a whole is the recorded one, changed by as much as that of the map"
