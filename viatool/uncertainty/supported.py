"""Which terms of the error model each job takes into account; every other term it refuses by name."""

from __future__ import annotations

SUPPORTED: dict[str, frozenset[str]] = {
    "verify": frozenset({"sensor.absolute", "sensor.relative", "sensor.bias", "sensor.missing"}),
    "verify with a horizon": frozenset({"sensor.absolute"}),
    "certify": frozenset({"sensor.absolute"}),
    "simulate": frozenset(),
}
