"""The result does not depend on who does the work, in how large chunks, or how often it was cut short."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.schedule.local_cluster import LocalCluster, wait_for
from viatool.errors import ConfigurationError, WorkError
from viatool.policy import load_policy
from viatool.schedule import Serial
from viatool.simulate import roll_out
from viatool.verification import states, verify
from viatool.world import load_map

ROOT = Path(__file__).resolve().parents[2]
LAB = "maps/lab.yaml"
POLICY = "policies/via.onnx"
SWEPT = {"eps": 0.05, "clearance": 0.7, "danger": 0.8}
BLOCK, STATES = 512, 1050
BRAKING = {**SWEPT, "criterion": "braking", "delay": 0.05, "only_contested": True, "seed": 7}


@pytest.fixture(scope="module", autouse=True)
def small_blocks():
    """Cut the states of this process into three blocks, whoever examines them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(states, "_MOST_STATES", BLOCK)
        yield


@pytest.fixture(scope="module")
def policy():
    return load_policy(POLICY)


@pytest.fixture(scope="module")
def driven(policy):
    world_map = load_map(LAB)
    trajectory = roll_out(policy, world_map, world_map.generator.draw(30, 3))
    assert len(trajectory) > STATES
    return trajectory.select(np.arange(len(trajectory)) < STATES)


@pytest.fixture(scope="module")
def results(policy, driven):
    return {
        "swept": verify(policy, LAB, trajectory=driven, **SWEPT),
        "braking": verify(policy, LAB, trajectory=driven, **BRAKING),
    }


def assert_same(result, expected):
    """Compare everything that was found, bit for bit."""
    for name, array in expected.state_table().items():
        np.testing.assert_array_equal(result.state_table()[name], array, err_msg=name)
    for part in ("reachable", "contested", "judgement", "witnesses"):
        for name, array in vars(getattr(expected, part)).items():
            np.testing.assert_array_equal(getattr(getattr(result, part), name), array, err_msg=name)
    assert facts(result) == facts(expected)


def facts(result):
    report = result.to_json()
    assert set(report.pop("seconds")) >= {"geometry", "reach", "judge", "search"}
    return report


def test_the_runs_have_something_to_tell_apart(results):
    for result in results.values():
        assert {"safe", "unsafe"} <= set(result.verdict)
        assert len(result.witnesses) > 100


@pytest.mark.parametrize("work", [{"chunk": 1}, {"workers": 2, "chunk": 1}], ids=str)
def test_workers_and_chunks_change_nothing(policy, driven, results, work):
    assert_same(verify(policy, LAB, trajectory=driven, **SWEPT, **work), results["swept"])


def test_workers_change_nothing_with_braking_and_a_delay(policy, driven, results):
    assert_same(verify(policy, LAB, trajectory=driven, **BRAKING, workers=2, chunk=1), results["braking"])


def test_a_cluster_that_loses_a_worker_and_then_its_scheduler_changes_nothing(
    policy, driven, results, tmp_path
):
    with LocalCluster(tmp_path, workers=2) as cluster:
        work = {"scheduler": cluster.address, "chunk": 1}
        assert_same(verify(policy, LAB, trajectory=driven, **BRAKING, **work), results["braking"])
        killed = []

        def kill(stage, done, total):
            if not killed and 0 < done < total:
                cluster.workers[0].kill()
                killed.append(done)

        result = verify(policy, LAB, trajectory=driven, **SWEPT, **work, progress=kill)
        assert killed
        assert_same(result, results["swept"])

        def kill_scheduler(stage, done, total):
            if done:
                cluster.scheduler.kill()

        kept = {"checkpoint": tmp_path / "run"}
        with pytest.raises(WorkError, match=r"the connection to the scheduler .* was lost"):
            verify(policy, LAB, trajectory=driven, **SWEPT, **work, **kept, progress=kill_scheduler)
    assert 1 <= len(list((tmp_path / "run").glob("units-*"))) < 3
    assert_same(verify(policy, LAB, trajectory=driven, **SWEPT, **kept, resume=True), results["swept"])


def test_what_is_found_in_a_block_depends_on_that_block_alone(policy, driven, results):
    alone = verify(policy, LAB, trajectory=driven.select(np.arange(len(driven)) < BLOCK), **SWEPT)
    for name in ("lower", "upper", "verdict", "witness"):
        np.testing.assert_array_equal(getattr(alone, name), getattr(results["swept"], name)[:BLOCK])


class Interrupted(Serial):
    """A scheduler that stops after some pieces."""

    def __init__(self, pieces):
        self.pieces = pieces

    def run(self, work, pieces):
        for number, answer in enumerate(super().run(work, pieces)):
            if number == self.pieces:
                raise KeyboardInterrupt
            yield answer


def test_a_run_continues_where_it_was_cut_short(policy, driven, results, tmp_path):
    folder, told = tmp_path / "run", []
    with pytest.raises(KeyboardInterrupt):
        verify(
            policy, LAB, trajectory=driven, **SWEPT, checkpoint=folder, scheduler=Interrupted(2), chunk=1,
            progress=lambda *_: told.append(_),
        )  # fmt: skip
    assert told == [("states", done, STATES) for done in (0, BLOCK, 2 * BLOCK)]
    told.clear()
    result = verify(
        policy, LAB, trajectory=driven, **SWEPT, checkpoint=folder, resume=True,
        progress=lambda *_: told.append(_),
    )  # fmt: skip
    assert told[:3] == [("states", done, STATES) for done in (2 * BLOCK, 2 * BLOCK, STATES)]
    assert told[3:] == [("close places", done, 300) for done in (0, 300)]
    assert_same(result, results["swept"])
    again = verify(policy, LAB, trajectory=driven, **SWEPT, checkpoint=folder, resume=True, workers=2)
    assert_same(again, results["swept"])


def test_a_checkpoint_belongs_to_its_run(policy, driven, tmp_path):
    few = driven.select(np.arange(len(driven)) < 20)
    run = {"trajectory": few, "checkpoint": tmp_path, "resume": True, "only_contested": True}
    verify(policy, LAB, **SWEPT, **run)
    with pytest.raises(ConfigurationError, match=r"another run: radii was .*; seed was 0, is 1"):
        verify(policy, LAB, **{**SWEPT, "eps": 0.02}, **run, seed=1)
    with pytest.raises(ConfigurationError, match="another run: states was"):
        verify(policy, LAB, **SWEPT, **{**run, "trajectory": driven.select(np.arange(len(driven)) < 21)})
    with pytest.raises(ConfigurationError, match="another run: map was"):
        verify(policy, "maps/office.yaml", **SWEPT, **run)
    with pytest.raises(ConfigurationError, match="another run: policy was"):
        verify("policies/td3.onnx", LAB, **SWEPT, **run)
    with pytest.raises(ConfigurationError, match="resume from"):
        verify(policy, LAB, **SWEPT, resume=True)


VERIFY = ("verify", POLICY, "--map", LAB, "--eps", "0.01", "--poses", "random:3500", "--only-contested")


def start(*arguments, **options):
    """Start viatool in a process group of its own."""
    heard = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"  # shells ignore it for jobs
    )
    program = [sys.executable, "-c", f"{heard}; from viatool.cli import main; main()", *map(str, arguments)]
    return subprocess.Popen(
        program, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True,
        **options,
    )  # fmt: skip


def limit_file_size():
    import resource

    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))


def test_a_run_that_is_killed_or_interrupted_ends_in_the_same_report(tmp_path):
    folder, reports = tmp_path / "run", [tmp_path / "whole.json", tmp_path / "pieces.json"]
    begun = (*VERIFY, "--checkpoint", folder, "--workers", "2")
    finished = lambda: len(list(folder.glob("units-*.npz")))  # noqa: E731

    full = start(*VERIFY, "--checkpoint", folder, preexec_fn=limit_file_size)
    assert "error: states 0 to 1,023: cannot be stored" in full.communicate()[1]
    assert (full.returncode, finished()) == (2, 0)

    killed = start(*begun, "--resume")
    wait_for(lambda: finished() >= 1)
    killed.kill()
    killed.communicate()
    wait_for(lambda: not group_exists(killed.pid))

    interrupted = start(*begun, "--resume")
    before = finished()
    wait_for(lambda: finished() > before or interrupted.poll() is not None)
    os.killpg(interrupted.pid, signal.SIGINT)
    _, said = interrupted.communicate(timeout=120)
    if interrupted.returncode != 0:  # it may have been done before
        assert interrupted.returncode == 130
        assert "continue with --resume" in said
        assert "Traceback" not in said

    for report, more in zip(reports, ((), ("--checkpoint", folder, "--resume")), strict=True):
        done = start(*VERIFY, *more, "--output", f"json:{report}")
        assert done.wait() == 0
        done.communicate()
    whole, pieces = (json.loads(report.read_text()) for report in reports)
    assert whole.pop("seconds").keys() == pieces.pop("seconds").keys()
    assert whole == pieces


def group_exists(group):
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True
