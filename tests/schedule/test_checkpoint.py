"""The folder of finished pieces: what it keeps, what it refuses, and what it survives."""

from __future__ import annotations

import resource
from dataclasses import dataclass

import numpy as np
import pytest

from viatool.errors import ConfigurationError
from viatool.schedule import Checkpoint, Span, cut, digest_of

RUN = {"policy": "abc", "eps": 0.01, "radii": [0.0, 0.01]}


def arrays(value, size=10):
    return {"value": np.full(size, value), "none": np.zeros((0, 3))}


def stored(checkpoint):
    return {span: float(part["value"][0]) for span, part in checkpoint.finished()}


@pytest.fixture
def checkpoint(tmp_path):
    made = Checkpoint(tmp_path / "deep" / "run", RUN, resume=False)
    made.write(Span(4, 6), arrays(2.0), "second")
    made.write(Span(0, 4), arrays(1.0), "first")
    return made


def test_what_is_stored_comes_back_in_order(checkpoint):
    again = Checkpoint(checkpoint.folder, RUN, resume=True)
    assert stored(again) == {Span(0, 4): 1.0, Span(4, 6): 2.0}
    assert [span for span, _ in again.finished()] == [Span(0, 4), Span(4, 6)]
    (_, part), *_ = again.finished()
    assert part["none"].shape == (0, 3)


def test_an_empty_folder_can_be_resumed(tmp_path):
    assert stored(Checkpoint(tmp_path, RUN, resume=True)) == {}


def test_a_used_folder_is_refused_without_resume(checkpoint):
    with pytest.raises(ConfigurationError, match="holds a checkpoint of this run") as caught:
        Checkpoint(checkpoint.folder, RUN, resume=False)
    assert "--resume" in caught.value.hint


@pytest.mark.parametrize(
    ("run", "message"),
    [
        ({**RUN, "eps": 0.02}, r"eps was 0\.01, is 0\.02"),
        ({**RUN, "policy": "abd"}, 'policy was "abc", is "abd"'),
        ({**RUN, "new": 1}, "new was null, is 1"),
        ({"policy": "abc", "eps": 0.01}, r"radii was \[0\.0, 0\.01\], is null"),
    ],
)
def test_a_checkpoint_of_another_run_is_refused_and_says_what_differs(checkpoint, run, message):
    for resume in (True, False):
        with pytest.raises(ConfigurationError, match=f"belongs to another run: {message}\n"):
            Checkpoint(checkpoint.folder, run, resume=resume)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"schema_version": 1, "run": 3}'])
def test_a_damaged_manifest_is_refused(checkpoint, text):
    (checkpoint.folder / "manifest.json").write_text(text)
    with pytest.raises(ConfigurationError, match="not the manifest of a checkpoint"):
        Checkpoint(checkpoint.folder, RUN, resume=True)


def test_a_lost_manifest_is_refused(checkpoint):
    (checkpoint.folder / "manifest.json").unlink()
    with pytest.raises(ConfigurationError, match=r"lost its manifest\.json"):
        Checkpoint(checkpoint.folder, RUN, resume=True)


@pytest.mark.parametrize("damage", ["cut off", "empty", "changed", "garbage"])
def test_a_damaged_piece_counts_as_missing(checkpoint, damage):
    (path,) = checkpoint.folder.glob("units-00000000-*")
    content = bytearray(path.read_bytes())
    if damage == "cut off":
        content = content[: len(content) // 2]
    elif damage == "changed":
        content[content.index(np.float64(1.0).tobytes()) + 3] ^= 1
    else:
        content = bytearray(b"garbage" if damage == "garbage" else b"")
    path.write_bytes(content)
    assert stored(checkpoint) == {Span(4, 6): 2.0}
    checkpoint.write(Span(0, 4), arrays(3.0), "again")
    assert stored(checkpoint)[Span(0, 4)] == 3.0


def test_what_was_left_behind_by_a_kill_is_ignored(checkpoint):
    (checkpoint.folder / ".units-00000006-00000008-abc.npz").write_bytes(b"half")
    assert set(stored(checkpoint)) == {Span(0, 4), Span(4, 6)}


def test_no_unit_comes_back_twice(checkpoint):
    checkpoint.write(Span(2, 5), arrays(9.0), "overlap")
    assert set(stored(checkpoint)) == {Span(0, 4), Span(4, 6)}


def test_a_full_disk_names_the_piece_and_keeps_the_others(checkpoint):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
    try:
        with pytest.raises(ConfigurationError, match=r"states 6 to 8: cannot be stored in .*large") as caught:
            checkpoint.write(Span(6, 8), arrays(1.0, 10_000), "states 6 to 8")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert "--resume" in caught.value.hint
    assert set(stored(checkpoint)) == {Span(0, 4), Span(4, 6)}
    assert len(list(checkpoint.folder.iterdir())) == 3


def test_a_folder_that_cannot_be_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ConfigurationError, match="cannot use the folder"):
        Checkpoint(tmp_path / "file", RUN, resume=False)


@pytest.mark.parametrize(
    ("done", "most", "expected"),
    [
        ([], 4, [(0, 4), (4, 8), (8, 10)]),
        ([(0, 10)], 4, []),
        ([(4, 5)], 3, [(0, 3), (3, 4), (5, 8), (8, 10)]),
        ([(8, 10), (0, 1)], 100, [(1, 8)]),
    ],
)
def test_what_is_missing_is_cut_into_spans(done, most, expected):
    spans = cut(10, [Span(*edges) for edges in done], most)
    assert [(span.first, span.last) for span in spans] == expected


@dataclass(frozen=True)
class Thing:
    name: str
    values: np.ndarray


def test_a_digest_tells_values_apart_and_nothing_else():
    thing = Thing("a", np.arange(6.0))
    assert digest_of(thing) == digest_of(Thing("a", np.arange(12.0)[:6]))
    others = [
        Thing("b", np.arange(6.0)),
        Thing("a", np.arange(6.0) + 1e-16),
        Thing("a", np.arange(6.0).reshape(2, 3)),
        Thing("a", np.arange(6)),
        (thing,),
        (thing, None),
        {"thing": thing},
        None,
    ]
    others[1].values[0] = -0.0
    assert len({digest_of(thing), *map(digest_of, others)}) == 9
    with pytest.raises(TypeError, match="object has no digest"):
        digest_of(object())
