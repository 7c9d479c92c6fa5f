"""Every failure is one message and one exit code; no input ends in a traceback."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from viatool import errors
from viatool.cli import main
from viatool.cli.failures import explain

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (errors.MapError("no map", "draw one"), 2, "error: no map\nhint: draw one"),
        (errors.PolicyError("no policy"), 2, "error: no policy"),
        (errors.TrajectoryError("no states"), 2, "error: no states"),
        (errors.ConfigurationError("no eps"), 2, "error: no eps"),
        (errors.EnclosureError("no bound"), 2, "error: no bound"),
        (errors.EmptyEvaluationError("nothing", "more"), 5, "error: nothing\nhint: more"),
        (errors.SelfCheckError("differs"), 3, "error: differs"),
        (errors.WorkError("states 0 to 9: lost", "again"), 3, "error: states 0 to 9: lost\nhint: again"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (click.Abort(), 130, "interrupted"),
    ],
)
def test_each_error_has_its_exit_code(error: BaseException, code: int, message: str) -> None:
    assert explain(error) == (code, message)


def test_a_defect_is_an_internal_error_that_asks_for_a_report() -> None:
    code, message = explain(ZeroDivisionError("division by zero"))
    assert code == 3
    assert message.startswith("error: internal error: ZeroDivisionError: division by zero\nhint: ")


def test_a_missing_extra_is_named() -> None:
    code, message = explain(ModuleNotFoundError("No module named 'torch'", name="torch"))
    assert code == 2
    assert "viatool[train]" in message


@pytest.mark.parametrize(
    ("library", "extra", "output"), [("bokeh", "html", "html:r.html"), ("rosbags", "ros", "mcap:r.mcap")]
)
def test_a_format_without_its_library_is_refused_before_any_work(
    tmp_path: Path, library: str, extra: str, output: str
) -> None:
    program = f"import sys; sys.modules[{library!r}] = None; from viatool.cli import main; main()"
    arguments = ("verify", "missing.onnx", "--map", "m.yaml", "--eps", "0.1", "-o", output)
    for name in ("missing.onnx", "m.yaml"):
        (tmp_path / name).write_text("not read before the outputs are checked")
    run = subprocess.run(
        [sys.executable, "-c", program, *arguments],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert (run.returncode, run.stdout) == (2, "")
    assert f"'{library}'" in run.stderr
    assert f"pip install 'viatool[{extra}]'" in run.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["m.yaml", "missing.onnx"]


def test_a_missing_part_of_viatool_is_not_mistaken_for_an_extra() -> None:
    assert explain(ModuleNotFoundError("No module named 'numpy'", name="numpy"))[0] == 3


@pytest.mark.parametrize(
    "arguments",
    [
        ["nonsense"],
        ["verify"],
        ["--nonsense"],
        ["verify", "p.onnx", "--map", "m.yaml", "--eps", "-1"],
        ["verify", "p.onnx", "--map", "m.yaml", "--eps", "nan"],
        ["verify", "p.onnx", "--map", "m.yaml", "--eps", "inf"],
        ["verify", "p.onnx", "--map", "m.yaml", "--eps", "lidar="],
        ["verify", "p.onnx", "--map", "m.yaml", "--eps", "=0.1"],
        ["verify", "p.onnx", "--map", "m.yaml", "--eps", "0.1", "--eps", "0.2"],
        ["verify", "p.onnx", "--map", "m.yaml", "--eps", "0.1", "--clearance", "-1"],
        ["verify", "p.onnx", "--map", "m.yaml", "--eps", "0.1", "--fail-under", "1.5"],
        ["verify", "p.onnx", "--map", "m.yaml", "--eps", "0.1", "--fail-under", "nan"],
        ["verify", "p.onnx", "--map", "m.yaml", "--eps", "0.1", "--output", "report.json"],
        ["verify", "p.onnx", "--map", "m.yaml", "--eps", "0.1", "--output", "poem:out.txt"],
        ["verify", "p.onnx", "--map", "m.yaml", "--eps", "0.1", "--output", "states:out.txt"],
        ["verify", "p.onnx", "--map", "m.yaml", "--eps", "0.1", "--criterion", "hope"],
        ["verify", "p.onnx", "--map", "m.yaml", "--eps", "0.1", "--seed", "-1"],
        ["verify", "missing.onnx", "--map", "missing.yaml", "--eps", "0.1"],
        ["simulate", "missing.onnx", "--map", "missing.yaml"],
        ["bounds", "missing.onnx", "missing.csv", "--eps", "0.1"],
        ["inspect", "missing.onnx"],
        ["map", "missing.yaml"],
    ],
    ids=" ".join,
)
def test_wrong_usage_exits_2_with_one_message_and_no_traceback(arguments: list[str]) -> None:
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    first, *rest = result.stderr.strip().splitlines()
    assert first.startswith("error: ")
    assert len([line for line in rest if line.startswith("hint: ")]) == 1
    assert "Traceback" not in result.stderr


def test_no_arguments_show_the_help() -> None:
    result = CliRunner().invoke(main, [])
    assert (result.exit_code, "verify" in result.stdout) == (0, True)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (("--errors", "husky", "--errors", "jackal"), "--errors"),
        (("--pose-error", "0.1,0.1", "--pose-error", "0.01,0.01"), "--pose-error"),
        (("--delay", "0.1", "--delay=0.2"), "--delay"),
        (("-q", "-q", "--seed", "1", "--seed", "1"), "--seed"),
    ],
)
def test_an_option_that_takes_one_value_is_given_once(options: tuple[str, ...], named: str) -> None:
    run = CliRunner().invoke(main, ["verify", "via", "--map", "room", "--eps", "0.01", *options])
    assert run.exit_code == 2
    assert f"'{named}': it is given twice" in run.stderr


def test_a_heading_that_errs_by_half_a_turn_is_refused_before_any_work() -> None:
    run = CliRunner().invoke(
        main, ["verify", "via", "--map", "room", "--eps", "0.01", "--pose-error", "0.1,5.7"]
    )
    assert run.exit_code == 2
    assert "5.7 degrees are 0.09948 rad" in run.stderr
