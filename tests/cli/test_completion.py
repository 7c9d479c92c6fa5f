"""Shells complete commands, options, choices, samples and files; versions are shown without heavy imports."""

from __future__ import annotations

import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner

import viatool
from viatool.cli import main


def complete(*words: str) -> list[tuple[str, str]]:
    completion = ShellComplete(main, {}, "viatool", "_VIATOOL_COMPLETE")
    return [(item.type, item.value) for item in completion.get_completions(list(words[:-1]), words[-1])]


def test_commands_options_and_choices_are_completed() -> None:
    assert complete("ver") == [("plain", "verify")]
    assert ("plain", "--max-unsafe") in complete("verify", "via", "--max")
    assert complete("verify", "via", "--criterion", "b") == [("plain", "braking")]


def test_names_come_last_where_no_file_begins_like_that(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert complete("verify", "via-t") == [("file", "via-t"), ("plain", "via-tanh")]
    assert complete("verify", "via", "--map", "off")[1] == ("plain", "office")
    (tmp_path / "via-mine.onnx").touch()
    assert complete("verify", "via-")[-1] == ("file", "via-")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_of_a_shell_asks_viatool(shell: str) -> None:
    result = CliRunner().invoke(main, ["completion", shell])
    assert result.exit_code == 0
    assert "_VIATOOL_COMPLETE" in result.stdout


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not on this system")
def test_bash_runs_the_script(tmp_path: Path) -> None:
    program = (
        'eval "$(viatool completion bash)"; COMP_WORDS=(viatool verify via-t); COMP_CWORD=2; '
        '_viatool_completion viatool 2>/dev/null; echo "${COMPREPLY[@]}"'
    )
    path = f"{Path(sys.executable).parent}:/usr/bin:/bin"
    run = subprocess.run(
        ["bash", "-c", program], cwd=tmp_path, env={"PATH": path}, capture_output=True, text=True, check=True
    )
    assert run.stdout.split() == ["via-tanh"]


def test_versions_are_those_that_are_installed() -> None:
    result = CliRunner().invoke(main, ["--version"])
    lines = result.stdout.splitlines()
    assert lines[0] == f"viatool {viatool.__version__}"
    assert f"onnxruntime {version('onnxruntime')}" in lines
    assert [line.split()[0] for line in lines] == [
        *("viatool", "engine", "python", "numpy", "onnx", "onnxruntime"),
        *("torch", "pybullet", "gymnasium", "rosbags"),
    ]


def test_versions_import_nothing_that_is_optional() -> None:
    program = "import sys; from viatool.versions import installed_versions; installed_versions(); print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert not {"torch", "pybullet", "numpy", "onnxruntime"} & set(run.stdout.split())
