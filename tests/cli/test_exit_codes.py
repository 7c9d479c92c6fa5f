"""Every command with every kind of failure: one exit code of the contract, one message, no traceback."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import click
import pytest
from click.testing import CliRunner, Result

from tests.report.conftest import content
from viatool import errors
from viatool.cli import main
from viatool.cli.group import COMMANDS

FAILURES: dict[str, tuple[BaseException, int]] = {
    "gate failed": (click.exceptions.Exit(1), 1),
    "policy": (errors.PolicyError("no policy", "export one"), 2),
    "map": (errors.MapError("no map", "draw one"), 2),
    "trajectory": (errors.TrajectoryError("no states", "drive"), 2),
    "configuration": (errors.ConfigurationError("no eps", "give one"), 2),
    "enclosure": (errors.EnclosureError("no bound", "shrink eps"), 2),
    "usage": (click.UsageError("no such thing"), 2),
    "missing extra": (ModuleNotFoundError("No module named 'bokeh'", name="bokeh"), 2),
    "disk full": (OSError(28, "No space left on device", "report.json"), 2),
    "self-check": (errors.SelfCheckError("differs", "report it"), 3),
    "work": (errors.WorkError("states 0 to 9: out of memory", "use fewer workers"), 3),
    "defect": (ZeroDivisionError("division by zero"), 3),
    "out of memory": (MemoryError(), 3),
    "recursion": (RecursionError("too deep"), 3),
    "nothing evaluated": (errors.EmptyEvaluationError("no states", "drive"), 5),
    "interrupted": (KeyboardInterrupt(), 130),
    "aborted": (click.Abort(), 130),
}


def command_named(name: str) -> click.Command:
    command = main.get_command(click.Context(main), name)
    assert command is not None
    return command


@pytest.mark.parametrize("failure", FAILURES)
@pytest.mark.parametrize("name", COMMANDS)
def test_each_failure_of_each_command_has_its_code(
    name: str, failure: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    error, code = FAILURES[failure]
    command = command_named(name)

    def fail(ctx: click.Context) -> NoReturn:
        raise error

    monkeypatch.setattr(command, "invoke", fail)
    monkeypatch.setattr(
        command, "make_context", lambda *_args, **_more: click.Context(command, info_name=name)
    )
    result = CliRunner().invoke(main, [name])
    assert result.exit_code == code
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
    if code not in (1, 130):
        assert result.stderr.startswith("error: ")
        assert result.stderr.count("\nhint: ") == 1


@pytest.mark.parametrize("name", COMMANDS)
def test_each_command_explains_itself_and_refuses_what_it_does_not_know(name: str) -> None:
    assert CliRunner().invoke(main, [name, "--help"]).exit_code == 0
    result = CliRunner().invoke(main, [name, "--no-such-option"])
    assert result.exit_code == 2
    assert "--no-such-option" in result.stderr


@pytest.mark.parametrize("name", COMMANDS)
def test_each_command_names_a_file_that_is_missing(name: str, tmp_path: Path) -> None:
    arguments: list[str] = []
    for parameter in command_named(name).params:
        if parameter.required:
            value = "0.1" if parameter.name == "eps" else str(tmp_path / f"missing-{parameter.name}")
            arguments += [value] if isinstance(parameter, click.Argument) else [parameter.opts[0], value]
    if not any("missing-" in argument for argument in arguments):
        return  # a command that needs no file to begin with
    result = CliRunner().invoke(main, [name, *arguments])
    assert result.exit_code == 2, result.output
    assert "missing-" in result.stderr


def stored(path: Path, *counts: int, **changes: Any) -> Path:
    path.write_text(json.dumps({**content(*counts), **changes}), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("conditions", "counts", "code"),
    [
        ((), (97, 1, 2), 0),
        (("--fail-under", "0.97"), (97, 1, 2), 0),
        (("--fail-under", "0.9700001"), (97, 1, 2), 1),
        (("--fail-under", "danger=0.48"), (97, 1, 2), 0),
        (("--fail-under", "danger=0.49"), (97, 1, 2), 1),
        (("--fail-under", "97%", "--fail-under", "danger=1"), (97, 1, 2), 1),
        (("--max-unsafe", "1", "--max-unknown", "2"), (97, 1, 2), 0),
        (("--max-unsafe", "0"), (97, 1, 2), 1),
        (("--max-unknown", "1"), (97, 1, 2), 1),
        (("--max-unknown", "1", "--exit-zero"), (97, 1, 2), 0),
        (("--baseline", "same.json"), (97, 1, 2), 0),
        (("--baseline", "better.json"), (97, 1, 2), 1),
        (("--baseline", "better.json", "--exit-zero"), (97, 1, 2), 0),
        (("--baseline", "missing.json"), (97, 1, 2), 2),
        (("--fail-under", "nearly"), (97, 1, 2), 2),
        (("--max-unsafe", "-1"), (97, 1, 2), 2),
        ((), (0, 0, 0), 0),
        (("--fail-under", "0"), (0, 0, 0), 5),
        (("--max-unsafe", "0"), (0, 0, 0), 5),
        (("--max-unsafe", "0", "--exit-zero"), (0, 0, 0), 5),
        (("--baseline", "same.json"), (0, 0, 0), 5),
        (("--fail-under", "timeout=0"), (97, 1, 2), 5),
        (("--fail-under", "contested=0.5"), (97, 1, 2), 1),
        (("--fail-under", "contested=0"), (97, 0, 0), 5),
        (("--min-contested", "3"), (97, 1, 2), 0),
        (("--min-contested", "4"), (97, 1, 2), 5),
        (("--min-contested", "4", "--exit-zero", "--max-unsafe", "0"), (97, 1, 2), 5),
    ],
    ids=str,
)
def test_the_gate_on_a_stored_report(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    conditions: tuple[str, ...],
    counts: tuple[int, ...],
    code: int,
) -> None:
    monkeypatch.chdir(tmp_path)
    report = stored(tmp_path / "report.json", *counts)
    stored(tmp_path / "same.json", 97, 1, 2)
    stored(tmp_path / "better.json", 99, 0, 1)
    run: Callable[..., Result] = CliRunner().invoke
    assert run(main, ["gate", str(report), *conditions]).exit_code == code
