"""Outputs appear whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from viatool.errors import ConfigurationError
from viatool.report.files import check_writable, replacing, write_whole


def test_a_failed_write_leaves_nothing_and_keeps_the_older_file(tmp_path: Path) -> None:
    target = tmp_path / "report.json"
    target.write_text("older")

    def write_half() -> None:
        with replacing(target) as draft:
            draft.write_text("half")
            raise RuntimeError("half way")

    with pytest.raises(RuntimeError, match="half way"):
        write_half()
    assert [path.name for path in tmp_path.iterdir()] == ["report.json"]
    assert target.read_text() == "older"


def test_an_operating_system_error_names_the_file_that_was_asked_for(tmp_path: Path) -> None:
    with (
        pytest.raises(ConfigurationError, match=r"report\.json.*No space"),
        replacing(tmp_path / "report.json"),
    ):
        raise OSError(28, "No space left on device")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("below", ["", "report.json"])
def test_paths_that_cannot_become_files_are_refused_before_the_work(tmp_path: Path, below: str) -> None:
    obstacle = tmp_path / "file"
    obstacle.write_text("")
    with pytest.raises(ConfigurationError, match="cannot write"):
        check_writable(obstacle / below if below else tmp_path)


def test_content_is_written_as_it_is(tmp_path: Path) -> None:
    write_whole(tmp_path / "new" / "report.md", b"one\ntwo\n")
    assert (tmp_path / "new" / "report.md").read_bytes() == b"one\ntwo\n"
