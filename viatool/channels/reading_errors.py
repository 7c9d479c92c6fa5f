"""How the readings of an observation err, and the sets of observations that follow from a recorded one.

The reading of a channel goes through its errors in this order: its share of the value, its own error and what it has in
common with the others of its scan are added; a LiDAR keeps what comes out within its limits; and a ray that returns
nothing reads what it reads then, whatever the errors are. As with eps, the recorded reading takes the place of the true
one: an observation may be any that could have been made of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from viatool.arrays import Booleans, Floats, Hull, Indices
from viatool.channels.drift import Drift
from viatool.channels.erring import Erring, ScanErrors
from viatool.channels.inputs import Inputs
from viatool.channels.lidar import LidarReadings
from viatool.channels.missing import Missing
from viatool.channels.quantities import Quantities
from viatool.errors import ConfigurationError
from viatool.rounding import SLIGHTLY_MORE, UNIT_ROUNDOFF
from viatool.sets.forms import Forms
from viatool.sets.observations import Few, ObservationSets
from viatool.uncertainty.error_model import SensorTerms

_BEYOND = ("relative", "bias", "angle", "missing", "thin")
"""Terms of a sensor beside its absolute error."""


@dataclass(frozen=True, eq=False)
class ReadingErrors:
    """What bounds the errors of every reading that stands in an observation of n inputs.

    Parameters
    ----------
    inputs : Inputs
        Which reading stands in each input.
    absolute, relative, bias : ndarray
        (n,) own error, in the unit of the sensor; share of the value; and the error in common, in the sensor's unit.
        The own error may also be (B, n), of each of B observations.
    scan : ndarray
        (n,) which inputs have a bias in common: a number for each channel and instant.
    limits : tuple of ndarray
        (n,) least and largest range that a LiDAR gives; infinite for other sensors.
    missing : tuple of Missing
        Scans whose rays may return nothing.
    angles : ndarray
        (n,) bool: angles within a half turn.
    scans : tuple of ScanErrors
        Of the LiDARs that may be turned, or whose rays may pass thin obstacles; columns are readings.
    """

    inputs: Inputs
    absolute: Floats
    relative: Floats
    bias: Floats
    scan: Indices
    limits: tuple[Floats, Floats]
    missing: tuple[Missing, ...]
    angles: Booleans
    scans: tuple[ScanErrors, ...] = ()

    @classmethod
    def of(
        cls, quantities: Quantities, absolute: Floats, terms: Mapping[str, SensorTerms], source: str
    ) -> ReadingErrors:
        """Return the errors of what is observed.

        Parameters
        ----------
        quantities : Quantities
            What the n inputs hold.
        absolute : ndarray
            (n,) the radii that took effect.
        terms : mapping
            What else is bounded, by the name of the channel.
        source : str
            What messages call the file.

        Raises
        ------
        ConfigurationError
            If a channel does not have what a term is about.
        """
        inputs = quantities.inputs
        size = inputs.size
        relative, bias = np.zeros(size), np.zeros(size)
        limits = np.full(size, -np.inf), np.full(size, np.inf)
        scan = np.unique(np.stack([inputs.channel, inputs.age]), axis=1, return_inverse=True)[1].reshape(-1)
        missing: list[Missing] = []
        scans: list[ScanErrors] = []
        angles = np.array([quantity.wraps for quantity in quantities])[inputs.channel]
        for number, quantity in enumerate(quantities):
            channel = quantity.channel
            asked = terms.get(channel.name, SensorTerms())
            columns = np.flatnonzero(inputs.channel == number)
            beyond = {name: getattr(asked, name) or 0 for name in _BEYOND}
            if not any(beyond.values()):
                continue
            where = f"{source}: sensor.{channel.name}"
            if channel.value is not None:
                raise ConfigurationError(
                    f"{where}: the channel is fixed to {channel.value:g} by the specification, so nothing errs",
                    "leave the channel out of the error model",
                )
            relative[columns], bias[columns] = beyond["relative"], beyond["bias"]
            if isinstance(quantity, LidarReadings):
                lidar = quantity.sensor
                limits[0][columns], limits[1][columns] = lidar.minimum_range, lidar.maximum_range
            if beyond["missing"]:
                missing += _missing(quantity, inputs, columns, int(beyond["missing"]), where)
            scans += _scan(quantity, inputs, number, where, float(beyond["angle"]), float(beyond["thin"]))
        return cls(inputs, absolute, relative, bias, scan, limits, tuple(missing), angles, tuple(scans))

    def rows(self, which: Indices | int) -> ReadingErrors:
        """Return the errors of some of the observations, where each has its own."""
        return self if self.absolute.ndim == 1 else replace(self, absolute=self.absolute[which])

    @cached_property
    def is_box(self) -> bool:
        """Tell whether every reading errs by itself, by a number that does not depend on it."""
        return not (self.relative.any() or self.bias.any() or self.missing or self.scans)

    def over_sets(self, pose: Floats) -> Erring:
        """Return how readings err over sets of states, with the error (3,) of the believed pose."""
        return Erring(self.absolute, self.relative, self.common, pose, self.scans, self.missing)

    @property
    def passes(self) -> bool:
        """Tell whether rays may pass thin obstacles, so that the widths of obstacles count."""
        return any(scan.thin > 0.0 for scan in self.scans)

    @property
    def words(self) -> str:
        """Return in words what is bounded."""
        if self.is_box:
            return "any value within eps of each observation entry, independently"
        parts = ["any value within eps of each observation entry"]
        parts += ["and a share of it"] if self.relative.any() else []
        parts += ["a bias that all readings of a scan have in common"] if self.bias.any() else []
        if any(scan.angle > 0.0 for scan in self.scans):
            parts.append("a turn of the whole scan against the robot")
        if self.passes:
            parts.append("rays that pass thin obstacles of the map")
        if self.missing:
            counts = max(scan.count for scan in self.missing)
            parts.append(f"and up to {counts} of the rays of a scan return nothing, whichever they are")
        return ", ".join(parts)

    @cached_property
    def common(self) -> Floats:
        """What each common error, one for each scan with a bias, adds to every reading, (S, n)."""
        scans = np.unique(self.scan[self.bias > 0.0])
        return np.asarray((self.scan == scans[:, None]) * self.bias)

    def own(self, least: Floats, most: Floats) -> Hull:
        """Bound readings (B, n) with all that each of them errs by itself."""
        with np.errstate(invalid="ignore"):
            below, above = (
                np.where(self.relative > 0.0, self.relative * np.abs(end), 0.0) + self.absolute
                for end in (least, most)
            )
        return least - below, most + above

    def kept(self, least: Floats, most: Floats) -> Hull:
        """Return the limits (B, n) within which a sensor keeps its readings, and what was recorded beyond them."""
        return (
            np.minimum(self.limits[0], least - self.absolute),
            np.maximum(self.limits[1], most + self.absolute),
        )

    def sets(self, inputs: Floats, drift: Drift | None = None) -> ObservationSets:
        """Return everything that may be observed where inputs (B, n) were recorded. **Sound:** yes; rounding counts.

        Parameters
        ----------
        inputs : ndarray
            (B, n).
        drift : Drift, optional
            What other believed poses change.

        Raises
        ------
        EnclosureError
            If what a network takes of a reading has no bounds.
        """
        least, most = self.inputs.readings(inputs)
        limits = self.kept(least, most)
        with np.errstate(invalid="ignore"):  # what a clip hides has no middle, and is as free as its bounds
            here = Forms.between(least, most)
        shared = np.concatenate(
            [np.zeros((len(inputs), 0, self.inputs.size)), *self._shared(len(inputs), drift)], axis=1
        )
        if drift is not None:
            least, most = least + drift.forms.lower, most + drift.forms.upper
            over = drift.anything | (self.angles & ~((least >= -np.pi) & (most <= np.pi)))
            least, most = (
                np.where(over, np.fmin(here.lower, -np.pi), least),
                np.where(over, np.fmax(here.upper, np.pi), most),
            )
            here = Forms(here.centre + drift.forms.centre, here.slope, here.rest + drift.forms.rest)
            shared = np.where(over[:, None], 0.0, shared)
            with np.errstate(invalid="ignore"):
                here = Forms.where(over, Forms.between(least, most), here)
        ends = self.own(least, most)
        total = ends[0] - self.bias, ends[1] + self.bias
        bounds = np.clip(total[0], *limits), np.clip(total[1], *limits)
        changed = self._changed | shared.any(axis=(0, 1))
        lower, upper = self._encoded(*bounds, changed)
        with np.errstate(invalid="ignore"):
            own = np.maximum(least - ends[0], ends[1] - most)
            readings = Forms(
                here.centre, shared, (here.rest + own) * SLIGHTLY_MORE + 1e-15 * np.abs(here.centre)
            )
        forms = self._forms(readings, limits, (lower, upper))
        few = []
        for scan in self.missing:
            some = scan.bounds(bounds[0][:, scan.columns], bounds[1][:, scan.columns])
            whole = least.copy(), most.copy()
            whole[0][:, scan.columns], whole[1][:, scan.columns] = some
            low, high = self._encoded(*whole, changed)
            few.append(Few(scan.count, scan.columns, low[:, scan.columns], high[:, scan.columns]))
        return ObservationSets(forms, lower, upper, tuple(few))

    def _shared(self, count: int, drift: Drift | None) -> list[Floats]:
        """Return what symbols that readings have in common add to them, (B, S, n) each."""
        bias = np.broadcast_to(self.common, (count, *self.common.shape))
        return [bias] if drift is None else [drift.forms.slope, bias]

    @cached_property
    def _changed(self) -> Booleans:
        """Which inputs err by more than a box around what was recorded, (n,)."""
        changed = (self.relative > 0.0) | (self.bias > 0.0)
        for some in self.scans:
            changed |= np.isin(self.inputs.reading, some.columns)
        for scan in self.missing:
            changed[scan.columns] = True
        return changed

    def _encoded(self, least: Floats, most: Floats, changed: Booleans) -> Hull:
        """Bound what the network takes of readings between two ends, with its rounding to float32 where they err so."""
        lower, upper = self.inputs.enclosed(least.copy(), most.copy())
        spare = 2.0 * UNIT_ROUNDOFF["float32"] * np.maximum(np.abs(lower), np.abs(upper)) * changed
        return lower - spare, upper + spare

    def _forms(self, readings: Forms, limits: Hull, hull: Hull) -> Forms:
        """Return inputs as forms of what they have in common; those without it are as free as their bounds."""
        alone = Forms.between(*hull)
        free = Forms(alone.centre, np.zeros_like(readings.slope), alone.rest * SLIGHTLY_MORE)
        moved = readings.slope.any(axis=1) & np.isfinite(readings.centre) & np.isfinite(readings.rest)
        parts = [free.centre.copy(), free.slope.copy(), free.rest.copy()]
        for number, channel in enumerate(self.inputs.channels):
            columns = np.flatnonzero((self.inputs.channel == number) & moved.any(axis=0))
            if not columns.size:
                continue
            there = moved[:, columns]
            one, still = np.ones(there.shape), np.zeros((len(there), readings.slope.shape[1], len(columns)))
            some = Forms.where(there, _columns(readings, columns), Forms(one, still, 0.0 * one))
            kept = [np.where(there, end[:, columns], 1.0) for end in limits]
            with channel.named_in_errors():
                seen = channel.encoding.forms(some.clipped(*kept))
            size = np.maximum(np.abs(seen.lower), np.abs(seen.upper))
            seen = Forms(seen.centre, seen.slope, seen.rest + 2.0 * UNIT_ROUNDOFF["float32"] * size)
            chosen = Forms.where(there, seen, _columns(free, columns))
            parts[0][:, columns], parts[1][:, :, columns], parts[2][:, columns] = (
                chosen.centre,
                chosen.slope,
                chosen.rest,
            )
        return Forms(*parts).checked()


def _columns(forms: Forms, columns: Indices) -> Forms:
    return Forms(forms.centre[:, columns], forms.slope[:, :, columns], forms.rest[:, columns])


def _scan(
    quantity: object, inputs: Inputs, number: int, where: str, angle: float, thin: float
) -> list[ScanErrors]:
    """Return how the scan of a channel errs as a whole, if it does."""
    if not (angle or thin):
        return []
    term = "angle" if angle else "thin"
    if not isinstance(quantity, LidarReadings):
        raise ConfigurationError(
            f"{where}.{term}: the channel is no LiDAR, so it has no rays", "leave it out"
        )
    if inputs.memory:
        raise ConfigurationError(
            f"{where}.{term}: the policy observes earlier scans, and where those were taken is not known",
            "leave the term out, or verify a policy that observes the present alone",
        )
    place = inputs.places[number]
    return [ScanErrors(np.arange(place.start, place.stop), angle, thin)]


def _missing(quantity: object, inputs: Inputs, columns: Indices, count: int, where: str) -> Sequence[Missing]:
    """Return the scans of a channel whose rays may return nothing, one for each instant."""
    if not isinstance(quantity, LidarReadings):
        raise ConfigurationError(
            f"{where}.missing: the channel is no LiDAR, so it has no rays", "leave it out"
        )
    lidar = quantity.sensor
    found = []
    for age in np.unique(inputs.age[columns]):
        scan = columns[inputs.age[columns] == age]
        if len(np.unique(inputs.reading[scan])) < len(scan):
            raise ConfigurationError(
                f"{where}.missing: the network takes the same scan twice",
                "leave out frames that repeat a scan",
            )
        found.append(Missing(count, scan, lidar))
    return found
