"""The boxes of observations: that they are as wide as the sensor error that the report states."""

from __future__ import annotations

import numpy as np

from viatool.recheck.evidence import StoredEvidence, TablePart
from viatool.recheck.outcome import Outcome, numbered

_ROUNDING = 1e-12  # of the numbers themselves, by which ends of a box may be rounded
_UNASKED = ("fixed to ", "memory of the policy")


def check_observations(evidence: StoredEvidence, found: Outcome) -> None:
    """Compare the radii of the state table with those that took effect, and the boxes with the radii."""
    found.not_rechecked.append("that observations are what sensors read at their poses")
    before = len(found.contradicted)
    channels = evidence.setting["channels"]
    _check_stated(evidence, found)
    for part in evidence.parts:
        _check_radii(evidence, part, found)
    encoded = [channel["name"] for channel in channels if channel["encoded"]]
    setting = evidence.setting
    if not setting["is_box"] or any(setting["pose_radii"]) or setting["moving"]:
        found.not_rechecked.append("boxes of observations, whose errors are more than a radius")
        return
    if encoded:
        found.not_rechecked.append(f"boxes of {', '.join(encoded)}, which the network does not take as read")
    columns = [column for channel in channels if not channel["encoded"] for column in channel["columns"]]
    for part in evidence.parts:
        _check_boxes(part, columns, found)
    if len(found.contradicted) == before:
        boxes = sum(len(part.table["eps"]) for part in evidence.parts)
        found.confirmed.append(f"{boxes:,} boxes of observations are as wide as eps")


def _check_radii(evidence: StoredEvidence, part: TablePart, found: Outcome) -> None:
    """Compare the radii of the state table, channel by channel, with those that took effect."""
    channels, eps = evidence.setting["channels"], part.table["eps"]
    premises = {one["name"]: one["value"].partition(" ")[0] for one in evidence.report["premises"]}
    taken = sorted(column for channel in channels for column in channel["columns"])
    complete = taken == list(range(eps.shape[1]))
    found.expect(complete, f"setting.json: its channels are not the entries of each {part.name}")
    for channel in channels:
        name, radii = channel["name"], {f"{radius:g}" for radius in np.unique(eps[:, channel["columns"]])}
        stated, held = premises.get(f"eps of {name}"), ", ".join(sorted(radii))
        message = f"states.npz: eps of {name} is {held}, report.json says {stated} (of each {part.name})"
        found.expect(radii <= {stated}, message)


def _check_stated(evidence: StoredEvidence, found: Outcome) -> None:
    """Compare the sensor error that was asked for with what took effect."""
    given = evidence.report["eps"]
    asked = given if isinstance(given, dict) else {"": given}
    for one in evidence.report["premises"]:
        name = one["name"].removeprefix("eps of ")
        radius = asked.get(name, asked.get(""))
        if name == one["name"] or radius is None or one["source"].startswith(_UNASKED):
            continue
        same = one["value"].partition(" ")[0] == f"{radius:g}"
        found.expect(same, f"report.json: eps of {name} is {radius:g}, and took effect as {one['value']}")


def _check_boxes(part: TablePart, columns: list[int], found: Outcome) -> None:
    """Look for a box that leaves out a reading within its radius."""
    names = ("observation", "eps", "observation_lower", "observation_upper")
    seen, radius, low, high = (part.table[name][:, columns] for name in names)
    spare = _ROUNDING * (1.0 + np.abs(seen) + radius)
    held = ((low <= seen - radius + spare) & (high >= seen + radius - spare)).all(axis=1)
    narrow = np.flatnonzero(~held)
    message = f"states.npz: boxes of observations narrower than eps, of {part.name} {numbered(narrow)}"
    found.expect(not len(narrow), message)
