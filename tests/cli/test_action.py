"""The GitHub Action, the hooks and the page about CI name commands and options that exist."""

from __future__ import annotations

import re
from pathlib import Path

import yaml

from viatool.cli.group import COMMANDS
from viatool.report import REPORTERS
from viatool.report.gate import RATES

ROOT = Path(__file__).resolve().parents[2]


def test_the_action_passes_its_inputs_as_variables_only() -> None:
    action = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))
    (verify,) = [step for step in action["runs"]["steps"] if step.get("id") == "verify"]
    assert "${{" not in verify["run"]
    used = set(re.findall(r"inputs\.([a-z-]+)", " ".join(verify["env"].values())))
    assert used == action["inputs"].keys() - {"python-version"}


def test_the_action_and_the_page_name_known_formats() -> None:
    for page in ("action.yml", "docs/ci.md"):
        text = (ROOT / page).read_text(encoding="utf-8")
        formats = set(re.findall(r"(?:--output |\| `)\"?([a-z]+):[^/]", text))
        assert formats
        assert formats <= REPORTERS.keys()


def test_every_format_and_rate_is_explained() -> None:
    text = (ROOT / "docs" / "ci.md").read_text(encoding="utf-8")
    assert all(f"`{name}:" in text for name in REPORTERS)
    assert all(f"{name}=" in text for name in RATES if name != "overall")


def test_the_hooks_run_known_commands() -> None:
    for hook in yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text(encoding="utf-8")):
        program, command = hook["entry"].split()
        assert program == "viatool"
        assert command in COMMANDS
