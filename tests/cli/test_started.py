"""The time of a report begins with the process."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

from viatool.cli import started


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
    assert 0.5 * wall < sum(seconds.values()) <= wall + 0.05


def test_where_the_system_does_not_tell_time_begins_with_viatool(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setattr(started, "_STAT", tmp_path / "nothing")
    before = time.perf_counter() - started._IMPORTED
    assert before <= started.seconds_since_start() < before + 5.0
