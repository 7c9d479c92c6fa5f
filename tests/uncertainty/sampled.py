"""Observations with errors, drawn by themselves: an oracle that shares no code with the bounds."""

from __future__ import annotations

import numpy as np

from tests.safety.hand_made_policy import BINS, specification, write_policy
from viatool.policy import LidarSpecification

MAXIMUM = 7.0
MINIMUM = 0.2
ENCODINGS = {
    "plain": {},
    "scaled": {"scale": 0.5, "offset": -0.25},
    "clipped": {"scale": 0.5, "offset": -0.25, "clip": [0.0, 1.5]},
    "reciprocal": {"reciprocal": True, "clip": [0.0, 4.0]},
}
NO_RETURN = {"maximum": MAXIMUM, "zero": 0.0}


def layout(encoding="plain", no_return="maximum", rays=BINS):
    """The hand-made policy's layout with a LiDAR that is encoded and says in its own way that nothing returned."""
    asked = "maximum" if no_return == "maximum" else 0.0
    lidar = LidarSpecification(
        field_of_view=np.pi,
        rays=rays,
        bins=BINS,
        minimum_range=MINIMUM,
        maximum_range=MAXIMUM,
        no_return=asked,
    )
    told = specification().model_dump(mode="json", exclude_none=True)
    told["schema_version"] = 2
    first = told["observation"][0]
    first.update(ENCODINGS[encoding], lidar=lidar.model_dump(mode="json", exclude_none=True))
    return specification().model_validate(told)


def policy_of(folder, *args, **kwargs):
    """Write the policy of a layout; returns its path."""
    return write_policy(folder / "policy.onnx", layout(*args, **kwargs), caution=0.05)


def readings_at(generator, count):
    """Scans of walls and gaps, each bin a reading, some of them at the ends of what the LiDAR reads."""
    readings = generator.uniform(0.25, 2.5, (count, BINS))
    far = generator.random(readings.shape)
    return (
        np.where(far < 0.1, MAXIMUM, np.where(far < 0.15, MINIMUM, readings)).astype(np.float32).astype(float)
    )


def encoded(readings, encoding):
    told = ENCODINGS[encoding]
    with np.errstate(divide="ignore"):
        values = 1.0 / readings if told.get("reciprocal") else readings
    values = told.get("scale", 1.0) * values + told.get("offset", 0.0)
    return np.clip(values, *told["clip"]) if "clip" in told else values


def observed(generator, readings, encoding="plain"):
    """Observations (B, 26) of scans (B, 20), the rest of them plausible."""
    rest = generator.uniform([0.5, -1, -1, 0.0, -1.0], [5.0, 1, 1, 0.5, 1.0], (len(readings), 5))
    rows = np.concatenate([encoded(readings, encoding), rest, np.full((len(rest), 1), 7.3)], axis=1)
    return rows.astype(np.float32).astype(float)


def erred(generator, readings, terms, *, no_return="maximum", one_ray=True, ends=0.7):
    """Draw scans that errors of the terms make of readings (B, 20)."""

    def unit(*shape):
        drawn = generator.uniform(-1, 1, shape)
        return np.where(generator.random(shape) < ends, np.sign(drawn), drawn)

    count = len(readings)
    absolute = terms.get("absolute", 0.0)
    found = readings * (1.0 + terms.get("relative", 0.0) * unit(*readings.shape))
    found = found + absolute * unit(*readings.shape) + terms.get("bias", 0.0) * unit(count, 1)
    if set(terms) - {"absolute"}:
        found = np.clip(
            found, np.minimum(MINIMUM, readings - absolute), np.maximum(MAXIMUM, readings + absolute)
        )
    for row in range(count):
        lost = generator.choice(BINS, size=generator.integers(0, terms.get("missing", 0) + 1), replace=False)
        nothing = NO_RETURN[no_return]
        found[row, lost] = (
            nothing if one_ray else generator.uniform(np.minimum(found[row, lost], nothing), MAXIMUM)
        )
    return found
