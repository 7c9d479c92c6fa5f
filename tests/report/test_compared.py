"""Two reports side by side: what both have is paired, and intervals are those of the literature."""

from __future__ import annotations

import json
import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tests.hall import MAP, write_policy
from viatool.cli import main
from viatool.report.paired import PairedGroups, PairedSubjects, apart, interval_of
from viatool.report.sections import Share
from viatool.simulate.statistics import sign_test


def test_intervals_are_those_that_newcombe_prints() -> None:
    """Statistics in Medicine 17 (1998): 873-890, example (a), and 2635-2650, example (a), method 10 of both."""
    assert interval_of(Share(48, 80), Share(56, 70)) == pytest.approx((0.0524, 0.3339), abs=5e-5)
    assert PairedSubjects(36, 2, 12, 0, True).interval == pytest.approx((0.0569, 0.3404), abs=5e-5)


@pytest.mark.parametrize(("old", "new"), list(product((0.3, 0.8), (0.3, 0.5))))
def test_intervals_hold_the_difference_about_as_often_as_they_say(old: float, new: float) -> None:
    rng, held, tries = np.random.default_rng(3), 0, 1500
    for _ in range(tries):
        before, after = rng.random((2, 60)) < np.array([[old], [new]])
        low, high = PairedSubjects.of(
            *({str(k): float(v) for k, v in enumerate(run)} for run in (before, after))
        ).interval
        held += low <= new - old <= high
    assert 0.93 < held / tries < 0.98


def test_only_what_both_have_is_paired() -> None:
    paired = PairedSubjects.of(
        {"a": 1.0, "b": 0.0, "c": 1.0, "d": 0.0}, {"b": 1.0, "c": 1.0, "d": 0.0, "e": 0.0}
    )
    assert (paired.both, paired.before, paired.after, paired.neither) == (1, 0, 1, 1)
    margins = PairedSubjects.of({"a": 0.02, "b": -1.0, "c": 0.3}, {"a": 0.05, "b": -1.0, "c": 0.1})
    assert (margins.both, margins.before, margins.after, margins.holding) == (1, 1, 1, False)


def test_the_sign_test_is_the_binomial_one() -> None:
    from scipy.stats import binomtest

    for one, other in product(range(9), range(9)):
        expected = binomtest(one, one + other).pvalue if one + other else 1.0
        assert sign_test(one, other) == pytest.approx(expected)


def test_states_of_one_episode_do_not_count_as_if_each_were_by_itself() -> None:
    names = [f"{episode}/{state}" for episode in range(10) for state in range(20)]
    groups = {name: name.partition("/")[0] for name in names}
    before = dict.fromkeys(names, 1.0)
    after = {name: float(groups[name] != "3") for name in names}  # one episode is lost as a whole
    grouped, alone = PairedGroups.of(before, after, groups), PairedSubjects.of(before, after)
    assert grouped.gained.tolist() == [0.0] * 3 + [-20.0] + [0.0] * 6
    assert grouped.interval is not None
    low, high = grouped.interval
    assert low <= -0.2
    assert high == 0.0  # which episode is there is chance: it may be none
    assert grouped.chance == 1.0
    assert alone.interval[1] < 0.0
    assert alone.chance < 1e-5
    assert PairedGroups.of(before, before, groups).interval is None
    few = {name: group for name, group in groups.items() if int(group) < 4}
    assert PairedGroups.of(dict.fromkeys(few, 1.0), {n: after[n] for n in few}, few).interval is None


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """State tables of the same poses, of which the later one has ten safe states less and one more."""
    folder = tmp_path_factory.mktemp("tables")
    write_policy(folder / "policy.onnx")
    (folder / "map.yaml").write_text(MAP, encoding="utf-8")
    paths = {name: folder / f"{name}.npz" for name in ("before", "after")}
    asked = ["verify", folder / "policy.onnx", "--map", folder / "map.yaml", "--eps", "0.05", "-q"]
    done = CliRunner().invoke(main, [*map(str, asked), "--close", "0", "-o", f"states:{paths['before']}"])
    assert done.exit_code == 0, done.output
    with np.load(paths["before"]) as archive:
        arrays = dict(archive)
    arrays["verdict"] = arrays["verdict"].copy()
    safe, unsafe = (np.flatnonzero(arrays["verdict"] == verdict) for verdict in ("safe", "unsafe"))
    arrays["verdict"][safe[:10]], arrays["verdict"][unsafe[:1]] = "unknown", "safe"
    np.savez(paths["after"], **arrays)
    return paths


def test_state_tables_of_the_same_poses_are_paired_state_by_state(tables: dict[str, Path]) -> None:
    told = CliRunner().invoke(main, ["compare", str(tables["before"]), str(tables["after"])])
    assert told.exit_code == 0, told.output
    line = next(line for line in told.output.splitlines() if "better here" in line)
    assert "states of both" in line
    assert re.search(r"\b10 +1 +by chance: ", line)


def test_names_that_are_there_twice_are_told_apart() -> None:
    assert apart(["a", "b", "a", "a"]) == ["a", "b", "a (2)", "a (3)"]


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("drives")
    asked = {"td3": ("td3", "3"), "via": ("via", "3"), "other": ("via", "4")}
    for name, (policy, seed) in asked.items():
        arguments = ["simulate", policy, "--map", "lab", "--scenarios", "40", "--seed", seed, "-q"]
        found = CliRunner().invoke(main, [*arguments, "-o", f"json:{folder / name}.json"])
        assert found.exit_code == 0, found.output
    return {name: folder / f"{name}.json" for name in asked}


def outcomes(path: Path) -> dict[str, bool]:
    episodes = json.loads(path.read_text())["episodes"]
    return {episode["scenario"]: episode["outcome"] == "success" for episode in episodes}


def test_the_same_scenarios_are_paired_on_the_command_line(drives: dict[str, Path], tmp_path: Path) -> None:
    old, new = outcomes(drives["td3"]), outcomes(drives["via"])
    worse, better = (sum(a[name] and not b[name] for name in old) for a, b in ((old, new), (new, old)))
    files = {name: tmp_path / f"compared.{name}" for name in ("html", "markdown")}
    outputs = [part for name, path in files.items() for part in ("-o", f"{name}:{path}")]
    told = CliRunner().invoke(main, ["compare", str(drives["td3"]), str(drives["via"]), *outputs])
    assert told.exit_code == 0
    line = next(
        line for line in told.output.splitlines() if "better here, of the 40 episodes of both" in line
    )
    assert line.split()[8:10] == [str(worse), str(better)]
    low, high = PairedSubjects.of(*({k: float(v) for k, v in each.items()} for each in (old, new))).interval
    for text in (told.output, *(path.read_text() for path in files.values())):
        assert f"{100 * low:+.1f} to {100 * high:+.1f} points".lstrip("+") in text.replace("\\", "")


def test_scenarios_of_another_seed_are_not_the_same(drives: dict[str, Path]) -> None:
    told = CliRunner().invoke(main, ["compare", str(drives["td3"]), str(drives["other"])])
    assert "of both" not in told.output
    assert "share of episodes that reach the goal, 95 %" in told.output


def test_an_output_that_does_not_exist_is_refused(drives: dict[str, Path], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for text in ("pdf:x.pdf", "html", f"html:{tmp_path / 'file' / 'x.html'}"):
        told = CliRunner().invoke(main, ["compare", str(drives["td3"]), str(drives["via"]), "-o", text])
        assert told.exit_code == 2
        assert "error:" in told.output
