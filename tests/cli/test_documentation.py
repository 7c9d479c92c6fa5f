"""What the documents say is what the program does."""

from __future__ import annotations

import json
import re
import runpy
import shlex
from pathlib import Path

import click
import jsonschema
import pytest
import yaml

import viatool
from viatool.cli import main
from viatool.cli.group import COMMANDS
from viatool.policy import load_specification

ROOT = Path(__file__).resolve().parents[2]
NOT_PARSED = ("cli.md", "messages.md")  # usage lines, and commands that are wrong on purpose
PAGES = [
    page
    for page in (*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), ROOT / "policies" / "README.md")
    if page.name not in NOT_PARSED
]


def command_named(name: str) -> click.Command:
    command = main.get_command(click.Context(main), name)
    assert command is not None
    return command


def documented_lines(path: Path) -> list[str]:
    """Return the viatool command lines of a page, continued lines joined."""
    text = path.read_text(encoding="utf-8").replace("\\\n", " ")
    lines = re.findall(r"^(?:    |\$ |.*&& \.venv/bin/)(viatool [a-z].*)$", text, flags=re.MULTILINE)
    return [line.split(" #")[0] for line in lines]


def test_the_reference_is_current() -> None:
    written = runpy.run_path(str(ROOT / "docs" / "write_reference.py"))
    for name, text in written["pages"]().items():
        assert (ROOT / "docs" / name).read_text(encoding="utf-8") == text, name


def test_the_schemas_accept_what_the_repository_ships() -> None:
    for schema, file in (("map", "maps/lab.yaml"), ("training", "policies/via.yaml")):
        content = json.loads((ROOT / "docs" / f"{schema}.schema.json").read_text(encoding="utf-8"))
        jsonschema.Draft202012Validator.check_schema(content)
        jsonschema.validate(yaml.safe_load((ROOT / file).read_text(encoding="utf-8")), content)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_and_option_is_in_the_reference(name: str) -> None:
    page = (ROOT / "docs" / "cli.md").read_text(encoding="utf-8")
    section = page.partition(f"## viatool {name}\n")[2].partition("\n## ")[0]
    for parameter in command_named(name).params:
        if isinstance(parameter, click.Option) and "--help" not in parameter.opts:
            assert all(spelling in section for spelling in parameter.opts), (name, parameter.opts)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_commands_of_a_page_parse(page: Path) -> None:
    for line in documented_lines(page):
        _, name, *arguments = shlex.split(line.replace("...", ""))
        assert name in COMMANDS, line
        command_named(name).make_context(name, arguments, resilient_parsing="..." in line)


def test_every_public_name_is_in_the_python_reference() -> None:
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    documented = set(re.findall(r"^\.\. auto(?:function|class):: (\w+)$", page, re.MULTILINE))
    assert set(viatool.__all__) - {"__version__"} <= documented


def test_the_readme_has_two_commands_for_a_fresh_machine() -> None:
    commands = re.findall(
        r"^python3 -m venv .*$", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert len(commands) == 2
    assert "viatool verify policies/via.onnx --map maps/lab.yaml --eps 0.01" in commands[0]
    assert "-m pytest" in commands[1]


def test_every_exit_code_of_the_reference_is_in_the_readme() -> None:
    pages = [(ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "docs/cli.md")]
    tables = [re.findall(r"^\| (\d+) \| (.*) \|$", page, re.MULTILINE) for page in pages]
    assert tables[0] == tables[1]
    assert [code for code, _ in tables[0]] == ["0", "1", "2", "3", "5", "130", "141"]


def test_every_page_that_a_message_or_a_page_names_exists() -> None:
    sources = [*(ROOT / "viatool").rglob("*.py"), *(ROOT / "docs").glob("*.md"), *ROOT.glob("*.md")]
    for source in sources:
        text = source.read_text(encoding="utf-8")
        for name in re.findall(r"\bdocs/[a-z_-]+\.(?:md|json)", text):
            assert (ROOT / name).is_file(), f"{source} names {name}"
        if source.suffix == ".md":
            for name in re.findall(r"\]\(([^)#:]+)\)", text):
                assert (source.parent / name).exists(), f"{source} links to {name}"


def test_the_example_specification_is_one(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "specification.md").read_text(encoding="utf-8")
    (tmp_path / "robot.yaml").write_text(text.partition("```yaml\n")[2].partition("```")[0], encoding="utf-8")
    assert load_specification(tmp_path / "robot.yaml").observation_size == 26
