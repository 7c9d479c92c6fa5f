"""One line of text, for each kind of run and each stored report."""

from __future__ import annotations

from pathlib import Path

from click.testing import CliRunner

from tests.hall import MAP, write_policy
from viatool.cli import main

NAME = "toy"
FILES = {
    "viatool/report/formats/NAME.py": Path(__file__)
    .parents[1]
    .joinpath("report/toy_format.py")
    .read_text("utf-8"),
    "viatool/report/outputs.py": {
        '    "github": "viatool.report.formats.github",\n': '    "github": "viatool.report.formats.github",\n'
        '    "toy": "viatool.report.formats.toy",\n'
    },
}

CELLS = ("--smallest", "0.5", "--halvings", "0", "--sample", "0.05")


def check(folder: Path) -> None:
    (folder / "map.yaml").write_text(MAP, encoding="utf-8")
    asked = [str(write_policy(folder / "policy.onnx")), "--map", str(folder / "map.yaml"), "--eps", "0.01"]
    stored, text = folder / "report.json", folder / "line.toy"
    for command in (["verify", *asked], ["certify", *asked, *CELLS], ["simulate", *asked[:3]]):
        arguments = [*command, "--output", f"json:{stored}", "--output", f"toy:{text}"]
        done = CliRunner().invoke(main, arguments)
        assert done.exit_code == 0, done.output
        line = text.read_text(encoding="utf-8")
        assert line.endswith("sections, 0 conditions\n")
        done = CliRunner().invoke(main, ["report", str(stored), "--output", f"toy:{text}"])
        assert done.exit_code == 0, done.output
        assert text.read_text(encoding="utf-8").split(",")[0] == line.split(",")[0]
    refused = CliRunner().invoke(main, ["verify", *asked, "--output", "toy:line.txt"])
    assert refused.exit_code == 2
