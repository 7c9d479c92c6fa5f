"""The rules of a verdict as plain data, in a file that stands by itself, and back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from viatool.motion.actuation import IDEAL_MOTORS, Actuation, Response
from viatool.motion.kinematics import DIFFERENTIAL, motion_with
from viatool.motion.law import Kinematics
from viatool.motion.timing import Timing
from viatool.setting.criteria import criterion_of
from viatool.setting.rules import Rules
from viatool.world import Clearance, Footprint

_PARTS = ("linear", "lateral", "angular")


def rules_document(rules: Rules) -> dict[str, Any]:
    """Return the rules as plain data."""
    footprint = rules.footprint
    return {
        "criterion": rules.criterion,
        "collision": rules.clearance.collision,
        "danger": rules.clearance.danger,
        "interval": rules.interval,
        "deceleration": rules.deceleration,
        "delay": rules.delay,
        "kinematics": rules.kinematics.name,
        **_motion_document(rules.kinematics),
        "lower": rules.lower.tolist(),
        "upper": rules.upper.tolist(),
        **({} if rules.actuation.is_ideal else {"motors": _motors_document(rules.actuation)}),
        **({} if rules.timing is None else {"timing": asdict(rules.timing)}),
        "footprint": {
            "kind": footprint.kind,
            "radius": footprint.radius,
            "polygon": footprint.polygon.tolist(),
        },
    }


def _motion_document(kinematics: Kinematics) -> dict[str, Any]:
    """Return what a kinematics knows of its robot, limits that are none left out."""
    known = {name: value for name, value in kinematics.parameters.items() if math.isfinite(value)}
    return {"motion": known} if known else {}


def read_rules(document: Mapping[str, Any]) -> Rules:
    """Return the rules of plain data."""
    outline = document["footprint"]
    return Rules(
        criterion=criterion_of(document["criterion"]).name,
        clearance=Clearance(float(document["collision"]), float(document["danger"])),
        footprint=Footprint(
            outline["kind"],
            float(outline["radius"]),
            np.array(outline["polygon"], dtype=float).reshape(-1, 2),
        ),
        lower=np.array(document["lower"], dtype=np.float64),
        upper=np.array(document["upper"], dtype=np.float64),
        interval=float(document["interval"]),
        deceleration=float(document["deceleration"]),
        delay=float(document["delay"]),
        kinematics=motion_with(
            str(document.get("kinematics", DIFFERENTIAL.name)), document.get("motion", {})
        ),
        actuation=_read_motors(document.get("motors")),
        timing=_read_timing(document.get("timing")),
    )


def _motors_document(motors: Actuation) -> dict[str, Any]:
    """Return motors as plain data; what is endless is null."""
    parts = asdict(motors)
    for name in _PARTS:
        parts[name] = {
            term: [None if end == math.inf else end for end in value] if isinstance(value, tuple) else value
            for term, value in parts[name].items()
        }
    return parts


def _read_motors(document: Mapping[str, Any] | None) -> Actuation:
    if document is None:
        return IDEAL_MOTORS
    responses = {name: Response(**_read_response(document[name])) for name in _PARTS}
    return Actuation(**responses, slip=float(document["slip"]))


def _read_response(document: Mapping[str, Any]) -> dict[str, Any]:
    return {
        term: tuple(math.inf if end is None else float(end) for end in value)
        if isinstance(value, list)
        else float(value)
        for term, value in document.items()
    }


def _read_timing(document: Mapping[str, Any] | None) -> Timing | None:
    if document is None:
        return None
    interval, delay = (tuple(map(float, document[name])) for name in ("interval", "delay"))
    return Timing((interval[0], interval[1]), (delay[0], delay[1]), float(document["age"]))
