"""What commands show of their progress, in a pipe and on a terminal."""

from __future__ import annotations

from io import StringIO

import pytest
from rich.console import Console

from viatool.cli import terminal
from viatool.cli.terminal import show_progress


@pytest.fixture
def shown(monkeypatch):
    """Return what is shown of some work: its calls of the progress, on which kind of console."""

    def show(*calls, on_terminal, **options):
        file = StringIO()
        console = Console(file=file, force_terminal=on_terminal, width=100, highlight=False)
        monkeypatch.setattr(terminal, "open_console", lambda stderr: console)
        with show_progress(**options) as progress:
            for call in calls:
                progress(*call)
        return file.getvalue()

    return show


def test_a_pipe_gets_a_line_when_a_stage_ends(shown):
    calls = [("drive", 5, 10), ("drive", 10, 10), ("states", 2000, 2000)]
    assert shown(*calls, on_terminal=False) == "drive: 10 of 10\nstates: 2,000 of 2,000\n"


def test_a_pipe_gets_of_a_whole_run_the_lines_that_it_gives_and_no_others(shown):
    line = "epoch 1  " + "loss 0.1 " * 20
    calls = [("epoch 1/2", 0.5, 2), ("epoch 1/2", 1.0, 2, line), ("testing", 1, 1)]
    assert shown(*calls, on_terminal=False, whole="training") == line + "\n"


def test_a_terminal_gets_a_bar_for_each_stage_or_one_for_the_whole_run(shown):
    calls = [("drive", 5, 10), ("states", 1, 2, "a line")]
    apart = shown(*calls, on_terminal=True)
    assert "5/10" in apart
    assert "1/2" in apart
    whole = shown(*calls, on_terminal=True, whole="training")
    assert "50%" in whole
    assert "5/10" not in whole
    assert "a line" in whole


@pytest.mark.parametrize("on_terminal", [False, True])
def test_who_wants_quiet_is_shown_nothing(shown, on_terminal):
    assert not shown(("drive", 10, 10, "a line"), on_terminal=on_terminal, quiet=True)


def test_a_stage_that_takes_long_says_once_how_long(shown, monkeypatch):
    clock = iter([0.0, 0.0, 0.0, 2.0, 2.0, 4.0, 4.0, 6.0, 6.0])
    monkeypatch.setattr(terminal.time, "monotonic", lambda: next(clock))
    calls = [("missions", done, 100) for done in range(4)]
    told = shown(*calls, on_terminal=False)
    assert told == "missions: about 3 min more for 100, judging by the first 1 in 2 s\n"


def test_a_stage_that_is_soon_done_or_foretells_itself_says_nothing_more(shown, monkeypatch):
    clock = iter(float(second) for second in range(100))
    monkeypatch.setattr(terminal.time, "monotonic", lambda: next(clock))
    short = shown(("states", 0, 4), ("states", 2, 4), ("states", 3, 4), on_terminal=False)
    assert "about" not in short
    itself = shown(("roots", 0, 1000, "roots: about 9 h"), ("roots", 1, 1000), on_terminal=False)
    assert itself == "roots: about 9 h\n"
