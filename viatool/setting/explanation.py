"""The check of a single observation: errors within an error model that make it of what was recorded, or really is.

It shares no code with the bounds. It goes entry by entry through what the error model says: between which biases the
entry is explained, and whether it is by rays that return nothing; then it looks for a bias that leaves no more entries
unexplained than rays may be missing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from viatool.arrays import Booleans, Floats
from viatool.channels.missing import Missing
from viatool.channels.reading_errors import ReadingErrors
from viatool.rounding import AS_RECEIVED
from viatool.setting.admissible import KnownReadings

_Between = tuple[float, float]
_Rays = Callable[[float], float]
"""How many rays have to return nothing to explain an entry with a bias; infinitely many if it is not explained so."""


def explain(
    errors: ReadingErrors, recorded: Floats, observed: Floats, drifted: Floats | None = None
) -> dict[str, Any] | None:
    """Find errors within their bounds that make an observation of what was recorded.

    Parameters
    ----------
    errors : ReadingErrors
        Of n inputs.
    recorded, observed : ndarray
        (n,) each.
    drifted : ndarray, optional
        (n,) by how much readings differ because the robot believes another pose.

    Returns
    -------
    dict or None
        By channel: its ``bias``, and the entries whose rays are ``missing``; None if there are no such errors.

    Notes
    -----
    Sound: yes, under rounding to float64 only.
    """
    off = np.zeros(len(recorded)) if drifted is None else drifted

    def biases(column: int) -> _Between:
        first, last = _decoded(errors, column, float(recorded[column]))
        own = float(errors.absolute[column])
        limits = (
            min(float(errors.limits[0][column]), first - own),
            max(float(errors.limits[1][column]), last + own),
        )
        moved = first + float(off[column]), last + float(off[column])
        return _biases(errors, column, moved, limits, float(observed[column]))

    def rays(column: int, missing: Missing) -> _Rays:
        lost = _is_lost(errors, missing, column, float(recorded[column]), float(observed[column]))
        return lambda bias: 1.0 if lost else math.inf

    return _explain(errors, biases, rays)


def explain_known(
    errors: ReadingErrors, known: KnownReadings, row: int, observed: Floats
) -> dict[str, Any] | None:
    """Find errors within their bounds that make an observation of what perfect sensors read in one of B states.

    Parameters
    ----------
    errors : ReadingErrors
        Of n inputs.
    known : KnownReadings
        Of B states.
    row : int
        Which state.
    observed : ndarray
        (n,).

    Returns
    -------
    dict or None
        As `explain`.

    Notes
    -----
    Sound: yes, under rounding to float64 only.
    """

    def between(column: int, reading: float) -> _Between:
        limits = (
            min(float(errors.limits[0][column]), reading),
            max(float(errors.limits[1][column]), reading),
        )
        return _biases(errors, column, (reading, reading), limits, float(observed[column]))

    def rays(column: int, missing: Missing) -> _Rays:
        entry = int(np.flatnonzero(missing.columns == column)[0])
        number = next(one for one, scan in enumerate(errors.missing) if scan is missing)
        left = [float(part[row, entry]) for part in known.losing[number]]
        low, high = _decoded(errors, column, float(observed[column]))
        near = AS_RECEIVED * (1.0 + abs(missing.reading))

        def needed(bias: float) -> float:
            for count, reading in enumerate(left, start=1):
                silent = reading >= missing.lidar.maximum_range or reading == missing.reading
                if silent and low - near <= reading <= high + near:
                    return float(count)
                ends = between(column, reading)
                if not silent and math.isfinite(reading) and ends[0] <= bias <= ends[1]:
                    return float(count)
            return math.inf

        return needed

    return _explain(errors, lambda column: between(column, float(known.readings[row, column])), rays)


def with_scans(
    told: Mapping[str, Mapping[str, Any]], errors: ReadingErrors, turn: Floats, passed: Booleans
) -> dict[str, Any]:
    """Add to the errors of an observation how its scans are turned, (T,), and whose rays pass what is thin, (n,)."""
    found: dict[str, Any] = dict(told)
    for number, scan in enumerate(errors.scans):
        name = errors.inputs.channels[int(errors.inputs.channel[scan.columns[0]])].name
        angle, bins = float(turn[number]), np.flatnonzero(passed[scan.columns])
        of_scan = ({"angle": angle} if angle else {}) | ({"passed": bins.tolist()} if bins.size else {})
        if of_scan:
            found[name] = {**found.get(name, {}), **of_scan}
    return found


def _explain(
    errors: ReadingErrors, biases: Callable[[int], _Between], rays: Callable[[int, Missing], _Rays]
) -> dict[str, Any] | None:
    """Find a bias of each scan that explains all entries but those that so many lost rays do."""
    found: dict[str, Any] = {}
    for scan in np.unique(errors.scan).tolist():
        columns = np.flatnonzero(errors.scan == scan).tolist()
        ends = [biases(column) for column in columns]
        missing = next((one for one in errors.missing if int(one.columns[0]) in columns), None)
        needed: Sequence[_Rays] = [] if missing is None else [rays(column, missing) for column in columns]
        allowed = float(errors.bias[columns[0]])
        tried = [0.0, allowed, -allowed, *(end for pair in ends for end in pair if abs(end) <= allowed)]
        for bias in tried:
            left = [row for row, (low, high) in enumerate(ends) if not low <= bias <= high]
            if left and (missing is None or sum(needed[row](bias) for row in left) > missing.count):
                continue
            told = ({"bias": bias} if bias else {}) | ({"missing": left} if left else {})
            if told:
                at = int(errors.inputs.age[columns[0]])
                name = errors.inputs.channels[int(errors.inputs.channel[columns[0]])].name
                found[name if at == 0 else f"{name}, {at} steps ago"] = told
            break
        else:
            return None
    return found


def _decoded(errors: ReadingErrors, column: int, value: float) -> tuple[float, float]:
    """Return the readings, between two ends, that the robot's software makes into an input."""
    channel = errors.inputs.channels[int(errors.inputs.channel[column])]
    ends = [(value - channel.offset) / channel.scale] * 2
    if channel.clip is not None:
        low, high = (float(np.float32(end)) for end in channel.clip)
        beyond = [value <= low, value >= high]
        if channel.scale < 0.0:
            beyond.reverse()
        ends = [-np.inf if beyond[0] else ends[0], np.inf if beyond[1] else ends[1]]
    if channel.reciprocal:
        if ends[0] <= 0.0 <= ends[1] or not (np.isfinite(ends[0]) or np.isfinite(ends[1])):
            return -np.inf, np.inf
        return 1.0 / ends[1], 1.0 / ends[0]
    return ends[0], ends[1]


def _biases(
    errors: ReadingErrors, column: int, reading: _Between, limits: _Between, observed: float
) -> _Between:
    """Return between which biases an entry is a reading between two ends with an error of its own."""
    (first, last), (floor, ceiling) = reading, limits
    low, high = _decoded(errors, column, observed)
    own = float(errors.absolute[column])
    if errors.angles[column] and math.isfinite(first) and math.isfinite(low):
        turns = 2.0 * math.pi * round((low - first) / (2.0 * math.pi))
        first, last = first + turns, last + turns
    share = float(errors.relative[column])
    least = first - (share * abs(first) if share else 0.0) - own
    most = last + (share * abs(last) if share else 0.0) + own
    near = [AS_RECEIVED * (1.0 + abs(end)) if math.isfinite(end) else 0.0 for end in (floor, ceiling)]
    if high < floor - near[0] or low > ceiling + near[1]:
        return np.inf, -np.inf
    below = -np.inf if low <= floor + near[0] else low - most
    above = np.inf if high >= ceiling - near[1] else high - least
    return below, above


def _is_lost(errors: ReadingErrors, missing: Missing, column: int, recorded: float, observed: float) -> bool:
    """Tell whether an entry may be what is read of rays of which one returns nothing."""
    first, last = _decoded(errors, column, recorded)
    low, high = _decoded(errors, column, observed)
    lidar = missing.lidar
    nothing = lidar.maximum_range if lidar.no_return is None else lidar.no_return
    near = AS_RECEIVED * (1.0 + abs(nothing))
    if missing.is_one:
        return low - near <= nothing <= high + near
    if lidar.reduce == "minimum":
        least, most = min(first, nothing), max(last, lidar.maximum_range, nothing)
    else:
        each = min(missing.count, lidar.each) / lidar.each
        least = first + each * min(nothing - lidar.maximum_range, 0.0)
        most = last + each * max(nothing - lidar.minimum_range, 0.0)
    return high >= least - near and low <= most + near
