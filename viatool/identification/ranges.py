"""How a LiDAR errs: recorded ranges against those that the map shows from where the robot stood.

A ray that leaves the sensor at p in the direction d (a unit vector, d' is it turned by a quarter to the left) and
meets something flat after the range E has ``dE/dp = -d + (g / E) d'``, where g is the change of E per radian. So the
residual of a reading is, to first order,

    reading - E  =  b + g a + (dE/dp) q + noise,

with b the bias that all readings of a scan have in common, a the turn of the scan, and q the error of the pose. These
four numbers are fitted to every scan, twice, the second time around the pose that was found first. What is left is the
error of each reading by itself. Rays near an edge of what the map shows, where that is not flat, are left out, and so
are readings that are off by more than `_GROSS`: they saw something that is not on the map.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from viatool.arrays import Booleans, Floats
from viatool.identification.findings import Bounding, Finding, MeasuredTerm, UnmeasuredTerm, spread_of
from viatool.trajectory.placing import Mount, Placing
from viatool.trajectory.scans import Scans
from viatool.world import Lidar, Scenes, WorldMap

_SCANS = 256  # of each part of a bag, evenly spread; a part has some thousand
_MOST_SCANS = 1024
_ASIDE = 0.03  # rad to both sides of a ray within which the map has to be flat
_FLAT = 0.03  # m by which it may differ from flat there
_GROSS = 0.3  # m from which on a reading saw something else
_SHORT = 0.3  # m before the largest range; beyond, a range may or may not return
_LEAST_RAYS = 20
_PRIOR = np.array([0.1, 0.05, 0.2, 0.2])  # of bias, turn, x and y: what is not seen stays 0
_SEEN = 0.05  # of the prior's spread, up to which a number counts as seen
_TOLD = 4.0  # standard errors beyond which 99 % of scans lie where there is nothing but noise
_MOST_MISSING = 16


@dataclass
class RangeErrors:
    """What the scans of a recording tell, gathered part by part."""

    world_map: WorldMap
    placing: Placing
    parts: list[_Fitted] = field(default_factory=list)
    lost: int = 0
    mounted: Mount | None = None

    def add(self, scans: Scans) -> None:
        """Fit some scans of one part of a bag."""
        self.mounted = self.mounted or self.placing.mount(scans.frame)
        shapes = np.column_stack([scans.geometry, [len(ranges) for ranges in scans.ranges]])
        kinds, kind = np.unique(shapes, axis=0, return_inverse=True)
        for index, (first, step, least, most, rays) in enumerate(kinds):
            rows = np.flatnonzero(kind.reshape(-1) == index)
            rows = rows[np.unique(np.linspace(0, len(rows) - 1, _SCANS).astype(int))]
            poses, known = self.placing.locate(scans.stamps[rows])
            self.lost += int((~known).sum())
            rows, poses = rows[known], poses[known]
            if not len(rows) or rays < _LEAST_RAYS:
                continue
            ranges = np.stack([scans.ranges[row] for row in rows.tolist()]).astype(np.float64)
            angles = self.mounted.side * (first + step * np.arange(int(rays)))
            self.parts.append(
                _fit(self.world_map, _sensor(poses, self.mounted), angles, ranges, (least, most))
            )

    def findings(self, name: str, bounding: Bounding) -> Iterator[Finding]:
        """Yield what the scans of the channel of a name tell."""
        parts = [part for part in self.parts if len(part.fitted)]
        place = f"sensor.{name}"
        if not parts or sum(part.used.sum() for part in parts) < 100:
            reason = "too few readings of flat surfaces of the map at known poses"
            yield UnmeasuredTerm(f"{place}, pose", reason)
            return
        parts = [part.thinned(len(parts)) for part in parts]
        fitted, spread, missing = (
            np.concatenate([getattr(part, what) for part in parts])
            for what in ("fitted", "spread", "missing")
        )
        seen = spread < _SEEN * _PRIOR
        told = [
            _told(fitted[seen[:, number], number], spread[seen[:, number], number]) for number in range(4)
        ]
        bias = fitted[:, 0] if told[0] else np.zeros(len(fitted))
        errors, sizes = (
            np.concatenate(rows) for rows in zip(*(part.own(told[0]) for part in parts), strict=True)
        )
        yield from _each_reading(place, sizes, errors, bounding)
        if told[0]:
            bias = bias[seen[:, 0]]
            yield MeasuredTerm(
                f"{place}.bias", bounding.largest(bias), len(bias), f"{spread_of(bias, 'm')}, one a scan"
            )
        else:
            yield UnmeasuredTerm(f"{place}.bias", "none is larger than what noise alone makes of a scan")
        yield from _turned(place, fitted[seen[:, 1], 1], told[1], bounding)
        for number, axis in ((2, "x"), (3, "y")):
            yield _moved(axis, fitted[seen[:, number], number], told[number], bounding)
        yield _returns(place, missing, bounding)
        yield UnmeasuredTerm(f"{place}.thin", "a recording does not show what its rays did not meet")

    def notes(self) -> Iterator[str]:
        """Yield what was left out."""
        gross, total = sum(part.gross for part in self.parts), sum(part.met for part in self.parts)
        if self.lost:
            yield f"{self.lost:,} scans have no pose at their time and were left out"
        if total:
            share = 100.0 * gross / total
            yield (
                f"{gross:,} of {total:,} readings of flat surfaces ({share:.2g} %) are off by more than {_GROSS:g} m: "
                "something that is not on the map; left out"
            )
            if share > 5.0:
                yield "so many that the map, its frame or the LiDAR's mount may not be those of the recording"


@dataclass(frozen=True, eq=False)
class _Fitted:
    """K scans of R rays: bias, turn and shift (K, 4) with their standard errors, and what is left of each reading."""

    fitted: Floats
    spread: Floats
    expected: Floats
    residual: Floats
    used: Booleans
    missing: Floats
    gross: int
    met: int

    def own(self, biased: bool) -> tuple[Floats, Floats]:
        """Return the errors of readings by themselves and the ranges, (U,) each; with the bias, unless there is one."""
        left = self.residual if biased else self.residual + self.fitted[:, :1]
        return left[self.used], self.expected[self.used]

    def thinned(self, parts: int) -> _Fitted:
        """Return fewer scans, if there are many parts."""
        every = max(1, parts * len(self.fitted) // _MOST_SCANS)
        names = ("fitted", "spread", "expected", "residual", "used", "missing")
        return replace(self, **{name: getattr(self, name)[::every] for name in names})


def _fit(
    world_map: WorldMap, poses: Floats, angles: Floats, ranges: Floats, limits: tuple[float, float]
) -> _Fitted:
    """Fit scans (K, R) of a sensor at poses (K, 3)."""
    least, most = limits
    with np.errstate(invalid="ignore"):
        returned = np.isfinite(ranges) & (ranges >= least) & (ranges > 0.0) & (ranges < most)
    lidar = Lidar(field_of_view=None, listed=tuple(angles.tolist()), rays=len(angles), bins=len(angles),
                  minimum_range=0.0, maximum_range=most)  # fmt: skip
    scenes = Scenes.of(world_map, [None])
    total, spread = np.zeros((len(poses), 4)), np.zeros((len(poses), 4))
    for _ in range(2):
        now = poses + total[:, [2, 3, 1]]
        expected, change, flat = _shown(scenes, now, lidar)
        flat &= (expected > least + 0.05) & (expected < most - _SHORT)
        residual = np.where(returned, ranges, 0.0) - expected - total[:, :1]
        used = flat & returned & (np.abs(residual) <= _GROSS)
        step, spread = _solve(residual, _columns(now, angles, expected, change), used)
        total += step
    expected, _, _ = _shown(scenes, poses + total[:, [2, 3, 1]], lidar)
    residual = np.where(used, ranges, 0.0) - expected - total[:, :1]
    met = flat & returned
    return _Fitted(
        total, spread, expected, residual, used, (flat & ~returned).sum(axis=1).astype(float),
        int((met & ~used).sum()), int(met.sum()),
    )  # fmt: skip


def _shown(scenes: Scenes, poses: Floats, lidar: Lidar) -> tuple[Floats, Floats, Booleans]:
    """Return ranges (K, R), their change per radian, and where the map is flat around a ray."""
    scene = np.zeros(len(poses), np.int64)

    def cast(turn: float) -> Floats:
        seen = scenes.cast(poses + np.array([0.0, 0.0, turn]), scene, lidar)
        return np.maximum(seen.astype(np.float64), 1e-6)

    here, left, right = cast(0.0), cast(_ASIDE), cast(-_ASIDE)
    straight = (
        2.0 * np.cos(_ASIDE) / (1.0 / left + 1.0 / right)
    )  # what a line through both ends has in between
    change = here * here * (1.0 / right - 1.0 / left) / (2.0 * np.sin(_ASIDE))
    return here, change, np.abs(here - straight) < _FLAT


def _columns(poses: Floats, angles: Floats, expected: Floats, change: Floats) -> Floats:
    """Return by how much bias, turn and shift change each reading, (K, R, 4)."""
    ray = np.exp(1j * (poses[:, 2:] + angles))
    by_place = -ray + (change / expected) * 1j * ray
    return np.stack([np.ones_like(change), change, by_place.real, by_place.imag], axis=2)


def _solve(residual: Floats, columns: Floats, used: Booleans) -> tuple[Floats, Floats]:
    """Return the least-squares fit of each scan (K, 4), and its standard errors."""
    weight = used.astype(np.float64)
    left = residual[used]
    scale = max(1.4826 * float(np.median(np.abs(left - np.median(left)))), 1e-4) if left.size else 1.0
    normal = np.einsum("kr,kri,krj->kij", weight, columns, columns) + np.diag(np.square(scale / _PRIOR))
    right = np.einsum("kr,kri->ki", weight * residual, columns)
    inverse = np.linalg.inv(normal)
    found = np.asarray(np.einsum("kij,kj->ki", inverse, right))
    return found, np.asarray(scale * np.sqrt(np.einsum("kii->ki", inverse)))


def _told(values: Floats, spread: Floats) -> bool:
    """Tell whether numbers are more than what noise makes of them."""
    return len(values) >= 10 and bool(np.quantile(np.abs(values) / spread, 0.99) > _TOLD)


def _sensor(poses: Floats, mount: Mount) -> Floats:
    """Return the poses of the LiDAR, (K, 3)."""
    shift = np.exp(1j * poses[:, 2]) * (mount.x + 1j * mount.y)
    return np.asarray(poses + np.column_stack([shift.real, shift.imag, np.full(len(poses), mount.yaw)]))


def _each_reading(place: str, sizes: Floats, errors: Floats, bounding: Bounding) -> Iterator[Finding]:
    absolute, relative = bounding.envelope(sizes, errors)
    yield MeasuredTerm(f"{place}.absolute", absolute, len(errors), spread_of(errors, "m"))
    if relative > 0.0:
        told = f"ranges of {sizes.min():.2g} to {sizes.max():.2g} m"
        yield MeasuredTerm(f"{place}.relative", relative, len(errors), told)
    else:
        yield UnmeasuredTerm(
            f"{place}.relative", "errors do not grow with the range; all of them are in `absolute`"
        )


def _turned(place: str, turns: Floats, told: bool, bounding: Bounding) -> Iterator[Finding]:
    if not told:
        yield UnmeasuredTerm(
            f"{place}.angle, pose.theta", "none is larger than what noise alone makes of a scan"
        )
        return
    middle = float(np.median(turns))
    constant = f"{len(turns):,} scans, turned by {middle:.3g} rad in the middle of them"
    error = abs(middle) * (1.0 + bounding.margin)
    yield MeasuredTerm(
        f"{place}.angle", error, len(turns), f"{constant}, by the LiDAR or by the pose's heading"
    )
    yield MeasuredTerm(
        "pose.theta", bounding.largest(turns - middle), len(turns), spread_of(turns - middle, "rad")
    )


def _moved(axis: str, shifts: Floats, told: bool, bounding: Bounding) -> Finding:
    if not told:
        reason = (
            "no shift is larger than what noise alone makes of a scan" if len(shifts) else "no scan shows it"
        )
        return UnmeasuredTerm(f"pose.{axis}", reason)
    return MeasuredTerm(
        f"pose.{axis}",
        bounding.largest(shifts),
        len(shifts),
        f"{spread_of(shifts, 'm')}, by fitting scans to the map",
    )


def _returns(place: str, missing: Floats, bounding: Bounding) -> Finding:
    most = int(np.quantile(missing, bounding.quantile, method="higher"))
    if most > _MOST_MISSING:
        reason = f"up to {most} rays of a scan return nothing, more than any model allows ({_MOST_MISSING})"
        return UnmeasuredTerm(f"{place}.missing", reason)
    return MeasuredTerm(f"{place}.missing", most, len(missing), spread_of(missing, "rays a scan"))
