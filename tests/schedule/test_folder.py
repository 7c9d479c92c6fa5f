"""Work that keeps files, where workers see its folder and where they do not."""

from __future__ import annotations

import pytest

from tests.schedule.work import add_up
from viatool.errors import ConfigurationError
from viatool.schedule import Piece, Serial, Span, locked, run_in_folder


class Elsewhere(Serial):
    """A scheduler whose workers may be on other machines."""

    remote = True


@pytest.fixture
def folder(tmp_path):
    for name in ("a", "b", "secret"):
        (tmp_path / name).write_text("1")
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "total").write_text("40")
    return tmp_path


def run(scheduler, folder):
    pieces = [Piece(Span(0, 1), "the sum", ["a", "b"])]
    reads = lambda names: [*names, "deep"]  # noqa: E731
    return [answer for _, answer in run_in_folder(scheduler, folder, add_up, pieces, reads=reads)]


@pytest.mark.parametrize(
    ("scheduler", "seen"),
    [(Serial(), True), (Elsewhere(), True), (Elsewhere(), False)],
    ids=["here", "elsewhere and seen", "elsewhere and unseen"],
)
def test_the_folder_ends_the_same_whether_workers_see_it_or_not(folder, scheduler, seen, monkeypatch):
    if not seen:
        monkeypatch.setattr("viatool.schedule.folder._sees", lambda *_: False)
    assert run(scheduler, folder) == [42]
    assert (folder / "deep" / "total").read_text() == "42"
    assert sorted(path.name for path in folder.iterdir() if path.name[0] != ".") == ["b", "deep", "secret"]


def test_a_folder_of_the_same_name_elsewhere_is_not_mistaken_for_it(folder, monkeypatch):
    """Another machine may have a folder there, with the mark of an earlier run."""
    from viatool.schedule.folder import _InFolder, _pack, _sees

    run(Serial(), folder)
    assert not _sees(folder, "another mark")
    errand = type("Errand", (), {"content": ["b"], "files": {"b": b"5"}})()
    done = _InFolder(add_up, str(folder), "another mark")(errand)
    assert (done.answer, done.files, done.gone) == (5, {"deep/total": b"5"}, ("b",))
    assert _pack(folder, ["deep", "missing"]) == {"deep/total": b"42"}


def test_a_folder_is_locked_for_others(folder):
    with (
        locked(folder),
        pytest.raises(ConfigurationError, match="another viatool is working in"),
        locked(folder),
    ):
        pass
    with locked(folder):
        pass
