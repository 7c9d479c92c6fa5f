"""Whatever is changed in a folder of evidence, the checker names it, also where the manifest was made to fit."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.recheck.conftest import edited, hashed_again
from viatool.recheck import UnreadableFolder, recheck


def test_an_untouched_folder_is_confirmed_state_by_state(whole: Path) -> None:
    found = recheck(whole)
    table = np.load(whole / "states.npz")
    assert (found.code, found.contradicted, found.unconfirmed) == (0, [], [])
    decided = np.isin(table["verdict"], ["safe", "unsafe"])
    assert found.verdicts == decided.sum() > (table["verdict"] == "unsafe").sum() > 0
    assert found.digest == hashlib.sha256((whole / "manifest.json").read_bytes()).hexdigest()
    for open_question in ("every command of the network", "what sensors read at their poses", "in words"):
        assert any(open_question in line for line in found.not_rechecked)


def _table(folder: Path, change: Callable[[dict[str, np.ndarray]], None]) -> None:
    with np.load(folder / "states.npz") as stored:
        table = dict(stored)
    change(table)
    np.savez(folder / "states.npz", **table)


def _unsafe(table: dict[str, np.ndarray]) -> int:
    return int(np.flatnonzero(table["verdict"] == "unsafe")[0])


def _call_unsafe_safe(table: dict[str, np.ndarray]) -> None:
    table["verdict"][_unsafe(table)] = "safe"


def _widen_commands(table: dict[str, np.ndarray]) -> None:
    row = int(np.flatnonzero((table["verdict"] == "safe") & table["contested"])[0])
    table["lower"][row], table["upper"][row] = [0.0, -1.0], [0.5, 1.0]


def _narrow_commands(table: dict[str, np.ndarray]) -> None:
    table["upper"][:, 0] = table["lower"][:, 0]


def _call_contested_settled(table: dict[str, np.ndarray]) -> None:
    table["contested"][_unsafe(table)] = False


def _call_dangerous_fine(table: dict[str, np.ndarray]) -> None:
    table["danger"] |= table["verdict"] == "safe"


def _narrow_boxes(table: dict[str, np.ndarray]) -> None:
    for end in ("observation_lower", "observation_upper"):
        table[end] = table["observation"].copy()


def _narrow_all(table: dict[str, np.ndarray]) -> None:
    _narrow_boxes(table)
    table["eps"] = np.zeros_like(table["eps"])


def _state_more_eps(folder: Path) -> None:
    edited(folder / "report.json", lambda content: content.__setitem__("eps", 0.05))


def _state_more_eps_everywhere(folder: Path) -> None:
    def change(report: dict) -> None:
        report["eps"] = 0.05
        for one in report["premises"]:
            if one["name"].startswith("eps of "):
                one["value"] = one["value"].replace("0.01", "0.05")

    edited(folder / "report.json", change)


def _byte(name: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        content = bytearray((folder / name).read_bytes())
        content[len(content) // 2] ^= 1
        (folder / name).write_bytes(bytes(content))

    return change


def _set(name: str, *keys: str | int, to: object) -> Callable[[Path], None]:
    def change(content: dict) -> None:
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = to

    return lambda folder: edited(folder / name, change)


def _remove_obstacle(folder: Path) -> None:
    path = next((folder / "inputs" / "map").iterdir())
    kept = [
        line for line in path.read_text().splitlines() if "circle" not in line and "obstacles" not in line
    ]
    path.write_text("\n".join(kept))


def _move_witness(folder: Path) -> None:
    edited(folder / "witnesses.json", lambda content: content["witnesses"][0]["pose"].__setitem__(1, -2.0))


def _drop_witness(folder: Path) -> None:
    edited(folder / "witnesses.json", lambda content: content["witnesses"].pop())


def _change_observation(folder: Path) -> None:
    edited(
        folder / "witnesses.json", lambda content: content["witnesses"][0]["observation"].__setitem__(0, 9.0)
    )


TAMPERED = {
    "a verdict": (lambda f: _table(f, _call_unsafe_safe), "verdicts is"),
    "a witness of a state": (
        lambda f: _table(f, lambda t: t["witness"].fill(np.nan)),
        "`witness` is not of the unsafe",
    ),
    "the commands of a safe state": (lambda f: _table(f, _widen_commands), "that are safe at 0.4 m"),
    "narrower commands": (lambda f: _table(f, _narrow_commands), "outside its commands"),
    "boxes of observations": (lambda f: _table(f, _narrow_boxes), "boxes of observations narrower than eps"),
    "boxes and eps": (lambda f: _table(f, _narrow_all), "is 0, report.json says 0.01"),
    "the eps": (_state_more_eps, "is 0.05, and took effect as 0.01"),
    "the eps, wherever it stands": (_state_more_eps_everywhere, "is 0.01, report.json says 0.05"),
    "the channels": (_set("setting.json", "channels", to=[]), "its channels are not the entries"),
    "what is contested": (lambda f: _table(f, _call_contested_settled), "contested_rate is"),
    "what is dangerous": (lambda f: _table(f, _call_dangerous_fine), "danger_rate is"),
    "a column": (lambda f: _table(f, lambda t: t.pop("contested")), "sums: could not be rechecked"),
    "a rate": (_set("report.json", "safety_rate", "overall", "rate", to=1.0), "safety_rate is"),
    "a count": (_set("report.json", "danger_rate", "overall", "safe", to=10**6), "danger_rate is"),
    "an outcome": (_set("report.json", "task", "success_rate", to=0.123), "task is"),
    "a claim": (
        _set("claims.json", "claims", 0, "value", to={"safe": 1, "total": 1, "rate": 1.0}),
        "claims.json",
    ),
    "a rule": (_set("setting.json", "rules", "collision", to=0.01), "rules are not those of witnesses.json"),
    "a pose error": (_set("setting.json", "pose_radii", to=[0.5, 0.5, 0.5]), "pose.x is 0.5"),
    "the policy": (
        _byte("inputs/policy/policy.onnx"),
        "the copy of the policy is not the policy of report.json",
    ),
    "an obstacle": (_remove_obstacle, "the copy of the map is not the map of report.json"),
    "the scenarios": (_set("scenarios.json", 0, "circles", to=[[9.0, 9.0, 0.1]]), "are not those of the map"),
    "a witness's pose": (_move_witness, "the pose is not that of states.npz"),
    "a witness's observation": (_change_observation, "the observation is outside of its box"),
    "a witness's command": (
        _set("witnesses.json", "witnesses", 0, "action", to=[0.0, 0.0]),
        "the program commands",
    ),
    "a missing witness": (_drop_witness, "unsafe are"),
}


@pytest.mark.parametrize("kind", TAMPERED)
@pytest.mark.parametrize("covered", [False, True], ids=["as it is", "manifest made to fit"])
def test_what_is_changed_is_named(folder: Path, kind: str, covered: bool) -> None:
    change, named = TAMPERED[kind]
    change(folder)
    if covered:
        hashed_again(folder)
    found = recheck(folder)
    told = "\n".join([*found.contradicted, *found.unconfirmed])
    assert found.code == 1
    assert named in told
    assert ("was changed" in told) is not covered


def _edit_digests(folder: Path) -> None:
    """Make report and setting say of the changed map what its digest is now."""
    path = next((folder / "inputs" / "map").iterdir())
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    edited(folder / "report.json", lambda content: content["map"].__setitem__("sha256", digest))
    edited(folder / "setting.json", lambda content: content["inputs"][1].__setitem__("sha256", digest))


def test_an_obstacle_that_is_removed_with_all_its_digests_leaves_counterexamples_of_nothing(
    driven: Path,
) -> None:
    _remove_obstacle(driven)
    _edit_digests(driven)
    hashed_again(driven)
    found = recheck(driven)
    assert found.code == 1
    assert any("so it is no counterexample" in line for line in found.contradicted)


def test_a_safe_state_that_was_none_is_not_confirmed_though_every_sum_fits(folder: Path) -> None:
    """An unsafe state is called safe, its counterexample dropped, and every figure made to fit."""

    def call_safe(table: dict[str, np.ndarray]) -> None:
        row = _unsafe(table)
        table["verdict"][row], table["witness"][row] = "safe", np.nan

    _table(folder, call_safe)
    edited(folder / "witnesses.json", lambda content: content["witnesses"].pop(0))
    with np.load(folder / "states.npz") as stored:
        table = dict(stored)
    safe, outcome = table["verdict"] == "safe", table["outcome"][table["episode"]]

    def fit(report: dict) -> None:
        report["unsafe_states"].pop(0)
        report["verdicts"]["safe"] += 1
        report["verdicts"]["unsafe"] -= 1
        for name, counted in (("safety_rate", np.ones_like(safe)), ("contested_rate", table["contested"])):
            for group, rate in report[name].items():
                rows = counted & (outcome == group if group != "overall" else True)
                part, total = int((safe & rows).sum()), int(rows.sum())
                rate.update(safe=part, total=total, rate=part / total if total else None)

    edited(folder / "report.json", fit)
    report = json.loads((folder / "report.json").read_text())

    def follow(claims: dict) -> None:
        for claim in claims["claims"]:
            value = report
            for part in claim["figure"].split("."):
                value = value[part]
            claim["value"] = value

    edited(folder / "claims.json", follow)
    hashed_again(folder)
    found = recheck(folder)
    assert (found.code, found.contradicted) == (1, [])
    assert any("1 of" in line and "are safe at" in line for line in found.unconfirmed)


def test_files_that_are_added_or_removed_are_named(folder: Path) -> None:
    (folder / "extra.txt").write_text("more")
    (folder / "questions.json").unlink()
    told = recheck(folder).contradicted
    assert "extra.txt: was added, it is not in the manifest" in told
    assert "questions.json: is in the manifest, but missing" in told


def test_a_needed_file_that_is_gone_from_the_manifest_as_well_is_named(folder: Path) -> None:
    (folder / "states.npz").unlink()
    hashed_again(folder)
    found = recheck(folder)
    assert found.code == 1
    assert "states.npz: is missing, in the manifest as well" in found.contradicted


def test_a_changed_manifest_is_named_by_the_file_that_it_speaks_of_and_has_another_digest(
    folder: Path, whole: Path
) -> None:
    edited(folder / "manifest.json", lambda content: content["files"]["report.json"].__setitem__("bytes", 1))
    found = recheck(folder)
    assert any(line.startswith("report.json: was changed") for line in found.contradicted)
    assert found.digest != recheck(whole).digest


@pytest.mark.parametrize(
    "content", ["", "{}", "[]", '{"schema_version": 1, "what": "evidence", "files": []}']
)
def test_a_folder_without_a_readable_manifest_is_refused(folder: Path, content: str) -> None:
    (folder / "manifest.json").write_text(content)
    with pytest.raises(UnreadableFolder, match="is not an evidence folder"):
        recheck(folder)


@pytest.mark.parametrize(("key", "value"), [("schema_version", 99), ("what", "vnnlib")])
def test_a_folder_of_another_version_or_kind_is_refused(folder: Path, key: str, value: object) -> None:
    edited(folder / "manifest.json", lambda content: content.__setitem__(key, value))
    with pytest.raises(UnreadableFolder, match=str(value)):
        recheck(folder)


def test_a_link_to_the_same_content_is_no_copy(folder: Path, whole: Path) -> None:
    (folder / "report.json").unlink()
    (folder / "report.json").symlink_to(whole / "report.json")
    assert any("report.json: was changed" in line for line in recheck(folder).contradicted)


@pytest.fixture
def beside(folder: Path) -> Path:
    """Return evidence that has its contested states as close places, too."""
    with np.load(folder / "states.npz") as stored:
        table = dict(stored)
    rows = np.flatnonzero(table["contested"])
    place = {int(row): index for index, row in enumerate(rows)}
    close = {name: array if name == "outcome" else array[rows] for name, array in table.items()}
    np.savez(folder / "states.npz", **table, **{f"close_{name}": array for name, array in close.items()})
    verdict = close["verdict"]

    def tell(report: dict) -> None:
        report["close_rate"] = report["contested_rate"]
        report["close"] = {
            "states": len(rows),
            "verdicts": {name: int((verdict == name).sum()) for name in ("safe", "unsafe", "unknown")},
            "unsafe_states": [{"state": index} for index in np.flatnonzero(verdict == "unsafe").tolist()],
        }

    def add(content: dict) -> None:
        copies = [{**one, "close": True, "state": place[one["state"]]} for one in content["witnesses"]]
        content["witnesses"] += copies

    edited(folder / "report.json", tell)
    edited(folder / "witnesses.json", add)
    hashed_again(folder)
    return folder


def test_close_places_are_rechecked_as_states_are(beside: Path, whole: Path) -> None:
    found = recheck(beside)
    assert (found.code, found.contradicted) == (0, [])
    assert found.verdicts > recheck(whole).verdicts
    assert any("close places are safe at" in line for line in found.confirmed)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (
            lambda f: _table(f, lambda t: t["close_verdict"].__setitem__(slice(None), "safe")),
            "close.verdicts is",
        ),
        (
            lambda f: _table(
                f, lambda t: (t["close_lower"].__imul__(0.0), t["close_upper"].__imul__(0.0).__iadd__(0.5))
            ),
            "close places that are safe at",
        ),
        (
            lambda f: _table(f, lambda t: [t.pop(name) for name in list(t) if name.startswith("close_")]),
            "could not be",
        ),
        (_set("report.json", "close_rate", "overall", "safe", to=0), "close_rate is"),
        (
            _set("witnesses.json", "witnesses", -1, "pose", to=[0.0, 0.0, 0.0]),
            ": the pose is not that of states.npz",
        ),
    ],
    ids=["verdicts", "commands", "arrays", "rate", "witness"],
)
def test_what_is_changed_of_close_places_is_named(
    beside: Path, change: Callable[[Path], None], named: str
) -> None:
    change(beside)
    hashed_again(beside)
    found = recheck(beside)
    assert found.code == 1
    assert named in "\n".join([*found.contradicted, *found.unconfirmed])


def test_a_missing_field_is_named_with_its_file(folder: Path) -> None:
    edited(folder / "report.json", lambda report: report["verdicts"].pop("unsafe"))
    hashed_again(folder)
    lines = recheck(folder).contradicted
    assert any("report.json has no field 'unsafe'" in line for line in lines), lines
    assert not any("KeyError" in line for line in lines)


def test_what_is_no_folder_of_evidence_is_said_in_words(tmp_path: Path) -> None:
    file = tmp_path / "states.npz"
    file.touch()
    for path, words in (
        (file, "a file, not a folder"),
        (tmp_path / "no", "not there"),
        (tmp_path, "it has no"),
    ):
        with pytest.raises(UnreadableFolder, match=words):
            recheck(path)
