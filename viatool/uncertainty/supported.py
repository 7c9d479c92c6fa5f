"""Which terms of the error model each job takes into account; every other term it refuses by name."""

from __future__ import annotations

_DRAWN = frozenset(
    f"{section}.{term}"
    for section, terms in (
        ("sensor", ("absolute", "relative", "bias", "missing")),
        ("pose", ("x", "y", "theta")),
        ("start", ("x", "y", "theta")),
    )
    for term in terms
)
_DRIVEN = frozenset(
    f"{section}.{term}"
    for section, terms in (
        ("actuation", ("acceleration", "deceleration", "lag", "relative", "absolute", "slip")),
        ("timing", ("interval", "delay", "sensing")),
        ("sensor", ("angle",)),
    )
    for term in terms
)

SUPPORTED: dict[str, frozenset[str]] = {
    "verify": frozenset({"sensor.absolute", "sensor.relative", "sensor.bias", "sensor.missing"}),
    "verify with a horizon": frozenset({"sensor.absolute"}),
    "certify": frozenset({"sensor.absolute"}),
    "simulate": _DRAWN | _DRIVEN,
    "simulate with bullet": _DRAWN,
}
