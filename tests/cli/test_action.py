"""The GitHub Action, the hooks and the page about CI name commands and options that exist."""

from __future__ import annotations

import re
import shlex
from importlib import import_module
from pathlib import Path

import yaml

from viatool.cli.group import COMMANDS
from viatool.report import FORMATS, formats_of
from viatool.report.states.run import StatesRun

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
        assert formats <= FORMATS.keys()


def test_every_format_and_rate_is_explained() -> None:
    text = (ROOT / "docs" / "ci.md").read_text(encoding="utf-8")
    assert all(f"`{name}:" in text for name in formats_of(StatesRun))
    assert all(f"{name}=" in text for name in StatesRun.RATES if name != "overall")


def test_the_hooks_run_known_commands() -> None:
    for hook in yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text(encoding="utf-8")):
        program, command = hook["entry"].split()
        assert program == "viatool"
        assert command in COMMANDS


def test_the_examples_of_the_page_about_ci_are_yaml_that_runs_known_commands() -> None:
    text = (ROOT / "docs" / "ci.md").read_text(encoding="utf-8")
    whole, github, gitlab, hooks = (
        yaml.safe_load(block) for block in re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    )
    action = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))
    assert "viatool run --workers auto --resume" in [step.get("run") for step in whole["steps"]]
    (step,) = [step for step in github["steps"] if "viatool@" in step["uses"]]
    assert step["with"].keys() <= action["inputs"].keys()
    assert {name for name, given in action["inputs"].items() if given.get("required")} <= step["with"].keys()
    assert f"steps.{step['id']}.outputs.sarif" in text
    assert "sarif" in action["outputs"]
    _, command, *arguments = shlex.split(gitlab["verify"]["script"][-1])
    module = import_module(f"viatool.cli.{command}")
    module.command.make_context(command, [*arguments], resilient_parsing=False)
    reports = [argument.partition(":")[2] for argument in arguments if argument.startswith("junit:")]
    assert gitlab["verify"]["artifacts"]["reports"]["junit"] == reports[0]
    known = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text(encoding="utf-8"))
    assert {hook["id"] for hook in hooks["repos"][0]["hooks"]} <= {hook["id"] for hook in known}
