"""What help says: every command in full, options by what they are about, and names that are nearly right."""

from __future__ import annotations

import click
import pytest
from click.testing import CliRunner

from viatool.cli import main
from viatool.cli.group import COMMANDS
from viatool.cli.sections import FEW, SECTIONS


def helped(*arguments: str) -> str:
    return CliRunner().invoke(main, [*arguments, "--help"]).output


def test_summaries_of_commands_are_not_cut() -> None:
    text = helped()
    assert "..." not in text[text.index("Commands:") :]
    for name in COMMANDS:
        assert f"\n  {name} " in text


@pytest.mark.parametrize("name", ["verify", "certify", "mission", "margin"])
def test_many_options_stand_in_sections(name: str) -> None:
    text = helped(name)
    other = text[text.index("Other options:") :]
    assert other.split()[2:4] == ["-h,", "--help"]
    for title in ("What is looked at:", "What may err:", "The robot:", "The gate:"):
        assert f"\n{title}\n" in text


def test_every_name_of_a_section_is_an_option_of_some_command() -> None:
    group = main
    assert isinstance(group, click.Group)
    context = click.Context(group)
    commands = [group.get_command(context, name) for name in COMMANDS]
    known = {text for command in commands if command for param in command.params for text in param.opts}
    asked = {name for names in SECTIONS.values() for name in names}
    assert sorted(asked - known) == []


def test_few_options_stand_by_themselves() -> None:
    assert FEW > 8
    assert "\nOptions:\n" in helped("replay")


@pytest.mark.parametrize(
    ("written", "meant"), [("verfy", "'verify'"), ("simulat", "'simulate'"), ("comparee", "'compare'")]
)
def test_a_command_that_is_nearly_right_is_told(written: str, meant: str) -> None:
    found = CliRunner().invoke(main, [written])
    assert found.exit_code == 2
    assert f"there is no command '{written}'" in found.output
    assert meant in found.output


def test_a_command_like_no_other_is_refused() -> None:
    found = CliRunner().invoke(main, ["xyzzy"])
    assert found.exit_code == 2
    assert "did you mean" not in found.output


ANOTHER = {"--criterion": "what proves nothing is no criterion where a proof is meant"}
"""Options that take something else in one of the commands that verify, and why."""


def test_an_option_takes_the_same_in_every_command_that_verifies_or_drives() -> None:
    taken: dict[str, dict[str, tuple[str, str]]] = {}
    for name in ("verify", "certify", "mission", "margin", "simulate", "doctor"):
        command = main.get_command(click.Context(main), name)
        assert command is not None
        for option in command.params:
            if isinstance(option, click.Option):
                what = type(option.type).__name__, option.make_metavar(click.Context(command))
                taken.setdefault(option.opts[0], {})[name] = what
    differing = {option: each for option, each in taken.items() if len(set(each.values())) > 1}
    assert set(differing) == set(ANOTHER), differing
