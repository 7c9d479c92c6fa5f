"""Why a place is not certified, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

from viatool.report.places.record import PlacesRecord, WorstPlace


def away(place: WorstPlace, asked: Sequence[float]) -> tuple[float, float]:
    """Return how far a counterexample is from a place, in metres and radians."""
    (x, y, theta), (at_x, at_y, heading) = place.pose, asked
    return math.hypot(x - at_x, y - at_y), abs(math.remainder(theta - heading, math.tau))


def explain_place(record: PlacesRecord, asked: Sequence[float], command: str) -> str:
    """Return what is known of the counterexample nearest to a place, of the worst that a certificate names.

    Parameters
    ----------
    record : PlacesRecord
        The certificate, which names one at least.
    asked : sequence of float
        x, y, theta.
    command : str
        That of the counterexample, in words.
    """
    place = nearest(record, asked)
    x, y, theta = place.pose
    metres, turn = away(place, asked)
    near = place.obstacle or "something"
    told = [
        f"An observation within the errors makes the program command {command}, which comes within "
        f"{place.clearance:.4g} m of {near} after {place.seconds:.2f} s; more than {record.clearance:g} m has to be "
        "kept",
    ]
    if place.saved_by:
        told.append(f"Its cell is certified without {' or without '.join(place.saved_by)}")
    elif place.saved_by is not None:
        told.append("Its cell is not certified without any single error")
    else:
        told.append("Which error it takes was not asked: --explain-errors of viatool certify does")
    head = (
        f"The nearest of the {len(record.worst)} worst counterexamples is {metres:.3g} m and {turn:.3g} rad away, "
        f"at x {x:.3f} m, y {y:.3f} m, heading {theta:.3f} rad."
    )
    rest = "Of other places the report has volumes alone: --output cells:FILE has every cell."
    return "\n\n".join([head, " ".join(f"{one}." for one in told), rest])


def nearest(record: PlacesRecord, asked: Sequence[float]) -> WorstPlace:
    """Return the counterexample nearest to a place; a radian counts as a metre."""
    return min(record.worst, key=lambda place: math.hypot(*away(place, asked)))
