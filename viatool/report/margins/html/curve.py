"""The curves of margins as a page draws them: outlines that follow its width and theme, beside words of one size."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from viatool.report.margins.curves import between, proved_curve, withstood_curve
from viatool.report.margins.record import PolicyMarginsRecord, VariedRecord
from viatool.report.numbers import counted, significant

if TYPE_CHECKING:
    from viatool.arrays import Floats

WIDE, HIGH = 1000.0, 400.0
"""The drawing in its own units; the page stretches it."""
_TICKS = 5
_COLOURS = 6
"""How many policies the style sheet tells apart."""


def curve_view(varied: VariedRecord, parts: Mapping[str, PolicyMarginsRecord]) -> Mapping[str, Any]:
    """Return the proved and the not refuted share of the contested states of each policy, against the error."""
    shares = [i / _TICKS for i in range(_TICKS + 1)]
    return {
        "box": f"0 0 {WIDE:g} {HIGH:g}",
        "rules": [f"M0 {HIGH * share:g}H{WIDE:g}M{WIDE * share:g} 0V{HIGH:g}" for share in shares],
        "up": [(f"{100.0 * share:g}%", f"{100.0 * share:g} %") for share in shares],
        "across": [(f"{100.0 * share:g}%", significant(varied.most * share)) for share in shares],
        "unit": f"error [{varied.unit}]" if varied.unit else "error, in the unit of each channel",
        "policies": [
            {
                "name": name,
                "line": f"line-{number % _COLOURS}",
                "size": _size(part),
                **_paths(part, varied.most),
            }
            for number, (name, part) in enumerate(parts.items())
        ],
    }


def _size(part: PolicyMarginsRecord) -> str:
    kinds = ((part.contested, "contested state"), (part.close.contested, "close place"))
    return " and ".join(counted(number, kind) for number, kind in kinds if number) or "none is contested"


def _paths(part: PolicyMarginsRecord, most: float) -> Mapping[str, str]:
    """Return both curves of a policy, and what lies between them; nothing where nothing is contested."""
    if not part.contested_states or not most > 0.0:
        return {"area": "", "proved": "", "withstood": ""}
    kept, withstood = proved_curve(part, most), withstood_curve(part, most)
    at, low, high = between(kept, withstood)
    back = reversed(_corners(at, high, most))
    return {
        "area": f"{_path(at, low, most)}L{'L'.join(back)}Z",
        "proved": _path(*kept, most),
        "withstood": _path(*withstood, most),
    }


def _path(errors: Floats, shares: Floats, most: float) -> str:
    return "M" + "L".join(_corners(errors, shares, most))


def _corners(errors: Floats, shares: Floats, most: float) -> list[str]:
    """Return the corners of steps that keep their share until the next one."""
    across, up = WIDE * errors / most, HIGH * (1.0 - shares)
    corners = np.stack([np.repeat(across, 2)[1:], np.repeat(up, 2)[:-1]], axis=1)
    return [f"{x:.1f} {y:.1f}" for x, y in corners.tolist()]
