"""Files against the manifest, inputs against the digests of the report, claims against its figures."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from viatool.recheck.evidence import REQUIRED, StoredEvidence, read_json
from viatool.recheck.outcome import Outcome, UnreadableFolder
from viatool.recheck.scene import read_map, solids

SCHEMA_VERSION = 1
MANIFEST = "manifest.json"


def check_files(folder: Path, found: Outcome) -> None:
    """Compare the files that are there with the manifest."""
    if not folder.is_dir():
        raise UnreadableFolder(f"'{folder}' is {'a file, not a folder' if folder.exists() else 'not there'}")
    if not (folder / MANIFEST).exists():
        raise UnreadableFolder(f"'{folder}' is not an evidence folder: it has no {MANIFEST}")
    try:
        manifest = read_json(folder / MANIFEST)
        version, what = manifest["schema_version"], manifest["what"]
        stated = {
            str(name): (str(one["sha256"]), int(one["bytes"])) for name, one in manifest["files"].items()
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UnreadableFolder(f"'{folder}' is not an evidence folder: {MANIFEST}: {error}") from error
    if what != "evidence":
        raise UnreadableFolder(f"'{folder}' is not an evidence folder: its manifest says that it is {what}")
    if version != SCHEMA_VERSION:
        raise UnreadableFolder(
            f"'{folder}' has schema_version {version}, this checker reads {SCHEMA_VERSION}"
        )
    found.digest = _sha256(folder / MANIFEST)
    there = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if not path.is_dir()}
    del there[MANIFEST]
    for name in sorted(stated.keys() - there.keys()):
        found.contradicted.append(f"{name}: is in the manifest, but missing")
    for name in sorted(there.keys() - stated.keys()):
        found.contradicted.append(f"{name}: was added, it is not in the manifest")
    for name in sorted(there.keys() & stated.keys()):
        path = there[name]
        same = not path.is_symlink() and (_sha256(path), path.stat().st_size) == stated[name]
        found.expect(same, f"{name}: was changed, its size or sha256 is not that of the manifest")
    for name in sorted(set(REQUIRED) - there.keys() - stated.keys()):
        found.contradicted.append(f"{name}: is missing, in the manifest as well")
    if not found.contradicted:
        found.confirmed.append(f"{len(stated)} files are as the manifest says, none missing, none added")


def check_inputs(evidence: StoredEvidence, found: Outcome) -> None:
    """Compare the copies of the inputs with the digests in setting and report."""
    before, report, folder = len(found.contradicted), evidence.report, evidence.folder
    for one in evidence.setting["inputs"]:
        if one["file"] is None:
            found.not_rechecked.append(f"{one['role']} '{one['name']}': named by its hash, not copied")
        else:
            same = _sha256(folder / one["file"]) == one["sha256"]
            found.expect(same, f"{one['file']}: is not the {one['role']} that setting.json names")
    for role, copies in (("policy", ("policy",)), ("map", ("map", "occupancy", "image"))):
        same = _joint(evidence.copies(*copies)) == report[role]["sha256"]
        found.expect(same, f"the copy of the {role} is not the {role} of report.json")
    same = _sha256(folder / "scenarios.json") == evidence.setting["scenarios"]
    found.expect(same, "scenarios.json: is not what setting.json names")
    _check_scenarios(evidence, found)
    if len(found.contradicted) == before:
        found.confirmed.append("policy, map and scenarios are those of the report")


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _joint(paths: list[Path]) -> str:
    """Return the digest of a file, or of the digests of several."""
    digests = [hashlib.sha256(path.read_bytes()) for path in paths]
    if len(digests) == 1:
        return digests[0].hexdigest()
    return hashlib.sha256(b"".join(digest.digest() for digest in digests)).hexdigest()


def _check_scenarios(evidence: StoredEvidence, found: Outcome) -> None:
    """Compare the scenarios that were driven with those of the map, as far as it lists them."""
    own = read_map(evidence).get("scenarios") or []
    listed = {one["name"]: one for one in own if one.get("name")}
    drawn = set()
    for driven in evidence.scenarios:
        if driven is None:
            continue
        if driven["name"] not in listed:
            drawn.add(driven["name"])
            continue
        circles, polygons = solids(listed[driven["name"]].get("obstacles") or [])
        stated = np.array(driven["circles"], dtype=float).reshape(-1, 3)
        shapes = shapely.union_all([shapely.Polygon(ring) for ring in driven["polygons"]])
        apart = shapely.symmetric_difference(shapes, shapely.union_all(polygons)).area
        same = np.array_equal(circles, stated) and apart <= 1e-9
        found.expect(same, f"scenarios.json: the obstacles of '{driven['name']}' are not those of the map")
    if drawn:
        found.not_rechecked.append(f"obstacles of {len(drawn)} scenarios that the map does not list")


def check_claims(evidence: StoredEvidence, found: Outcome) -> None:
    """Compare the figures of the claims with the report, and the rules in the folder with each other."""
    before, rules, claims = len(found.contradicted), evidence.rules, evidence.claims["claims"]
    for claim in claims:
        value: Any = evidence.report
        for part in claim["figure"].split("."):
            value = value[part]
        found.expect(value == claim["value"], f"claims.json: {claim['figure']} is not that of report.json")
    found.expect(
        rules == evidence.witnesses["rules"], "setting.json: its rules are not those of witnesses.json"
    )
    found.expect(rules == evidence.claims["rules"], "setting.json: its rules are not those of claims.json")
    same = rules["criterion"] == evidence.report["criterion"]
    found.expect(same, "setting.json: its criterion is not that of report.json")
    _check_premises(evidence, found)
    found.not_rechecked.append(
        "that index.html, and claims and assumptions in words, say what the figures do"
    )
    if len(found.contradicted) == before:
        found.confirmed.append(f"{len(claims)} claims have the figures of the report")


def _check_premises(evidence: StoredEvidence, found: Outcome) -> None:
    """Compare the numbers of the setting that widen a recheck with what took effect in the report."""
    stated = {one["name"]: one["value"].partition(" ")[0] for one in evidence.report["premises"]}
    rules, radii = evidence.rules, evidence.setting["pose_radii"]
    numbers = {"collision distance": rules["collision"], "danger distance": rules["danger"]}
    numbers |= dict(zip(("pose.x", "pose.y", "pose.theta"), radii, strict=True))
    for name, number in numbers.items():
        same = stated.get(name, "0") == f"{number:g}"
        found.expect(same, f"setting.json: {name} is {number:g}, report.json says {stated.get(name, '0')}")
    moving = any(name.startswith("obstacles.") for name in stated)
    found.expect(
        moving == evidence.setting["moving"], "setting.json: what moves is not what report.json says"
    )
