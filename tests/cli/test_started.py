"""The time of a report begins with the process."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path


def test_the_time_of_a_report_is_nearly_that_on_the_wall(tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    began = time.perf_counter()
    subprocess.run(
        [
            sys.executable,
            "-m",
            "viatool",
            "verify",
            "via",
            "--map",
            "lab",
            "--eps",
            "0.01",
            "-q",
            "-o",
            f"json:{report}",
        ],
        check=True,
    )
    wall = time.perf_counter() - began
    seconds = json.loads(report.read_text())["seconds"]
    assert next(iter(seconds)) == "start"
    assert 0.3 * wall < sum(seconds.values()) <= wall + 0.05


def test_a_command_that_is_not_the_first_of_its_process_counts_its_own_time(tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    program = (
        "import time\nfrom click.testing import CliRunner\nfrom viatool.cli import main\n"
        "CliRunner().invoke(main, ['--version'])\ntime.sleep(3.0)\n"
        f"CliRunner().invoke(main, 'verify via --map lab --eps 0.01 -q -o json:{report.as_posix()}'.split())"
    )
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", program], check=True)
    wall = time.perf_counter() - began
    assert sum(json.loads(report.read_text())["seconds"].values()) < wall - 3.0


def test_what_a_shell_did_before_in_the_same_process_does_not_count(tmp_path: Path) -> None:
    """A shell may become its last command, as in README's line, which installs before."""
    report = tmp_path / "report.json"
    command = (
        f"sleep 3 && exec {sys.executable} -m viatool verify via --map lab --eps 0.01 -q -o json:{report}"
    )
    began = time.perf_counter()
    subprocess.run(["sh", "-c", command], check=True)
    wall = time.perf_counter() - began
    assert sum(json.loads(report.read_text())["seconds"].values()) < wall - 3.0
