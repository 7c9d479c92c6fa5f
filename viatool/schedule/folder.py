"""Work that keeps files: in its folder where the worker sees it, else in a copy whose files come back as values."""

from __future__ import annotations

import tempfile
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Generic

from viatool.errors import ConfigurationError
from viatool.schedule.pieces import Answer, Content, Piece, Scheduler, Source, Told
from viatool.schedule.progress import ignore
from viatool.whole_file import whole_file

Files = Mapping[str, bytes]

MARK = ".here"


def run_in_folder(
    scheduler: Scheduler,
    folder: Path,
    work: Callable[[Path, Content], Answer],
    pieces: Source[Content],
    *,
    reads: Callable[[Content], Iterable[Path]],
    told: Told = ignore,
) -> Iterator[tuple[Piece[Content], Answer]]:
    """Carry out work that reads and writes files below a folder.

    Parameters
    ----------
    scheduler : Scheduler
        Who does the work. Its workers need not see the folder.
    folder : Path
        An existing folder of this machine.
    work : callable
        Called with the folder, or with a copy of what it reads there, and with the content of a piece. It must cope
        with what an interrupted attempt left in the folder.
    pieces, told
        As for `Scheduler.run`.
    reads : callable
        The files and folders below the folder, relative to it, that the work on a content looks at.

    Yields
    ------
    tuple of (Piece, answer)
        As `Scheduler.run` does, when the files are in the folder.
    """
    folder = folder.absolute()

    def errand(piece: Piece[Content]) -> Piece[_Errand[Content]]:
        files = _pack(folder, reads(piece.content)) if scheduler.remote else {}
        return Piece(piece.span, piece.name, _Errand(piece.content, files))

    def back(piece: Piece[_Errand[Content]]) -> Piece[Content]:
        return Piece(piece.span, piece.name, piece.content.content)

    errands = (None if piece is None else errand(piece) for piece in pieces)
    there = _InFolder(work, str(folder), _mark(folder))
    for piece, done in scheduler.run(there, errands, lambda piece, message: told(back(piece), message)):
        _unpack(folder, done.files, done.gone, piece.name)
        yield back(piece), done.answer


@dataclass(frozen=True)
class _Errand(Generic[Content]):
    """The content of a piece, and the files that it reads."""

    content: Content
    files: Files


@dataclass(frozen=True)
class _Done(Generic[Answer]):
    """An answer, the files that were written for it, and the names of those that were removed."""

    answer: Answer
    files: Files
    gone: tuple[str, ...] = ()


@dataclass(frozen=True)
class _InFolder(Generic[Content, Answer]):
    """The work as workers carry it out; the folder as a text, for one system's paths are not another's."""

    work: Callable[[Path, Content], Answer]
    folder: str
    mark: str

    def __call__(self, errand: _Errand[Content]) -> _Done[Answer]:
        if _sees(Path(self.folder), self.mark):
            return _Done(self.work(Path(self.folder), errand.content), {})
        with tempfile.TemporaryDirectory(prefix="viatool-") as name:
            copy = Path(name)
            _unpack(copy, errand.files, (), "the files of a piece")
            answer = self.work(copy, errand.content)
            found = _pack(copy, [Path()])
        changed = {path: content for path, content in found.items() if errand.files.get(path) != content}
        return _Done(answer, changed, tuple(path for path in errand.files if path not in found))


def _pack(folder: Path, paths: Iterable[Path]) -> dict[str, bytes]:
    """Return the content of files, and of all files below folders that are not hidden, by their names with slashes."""
    found = {}
    for path in paths:
        place = folder / path
        for file in sorted(place.rglob("*")) if place.is_dir() else [place]:
            if file.is_file() and not file.name.startswith("."):
                found[file.relative_to(folder).as_posix()] = file.read_bytes()
    return found


def _unpack(folder: Path, files: Files, gone: Iterable[str], name: str) -> None:
    """Write files, each whole or not at all, and remove others."""
    try:
        for path, content in files.items():
            with whole_file(folder / path) as draft:
                draft.write_bytes(content)
        for path in gone:
            (folder / path).unlink(missing_ok=True)
    except OSError as error:
        raise ConfigurationError(
            f"{name}: cannot be stored in '{folder}': {error.strerror or error}",
            "make room and run the same command again; what was stored before is kept",
        ) from error


def _mark(folder: Path) -> str:
    """Write down, in a file of a folder, by what workers tell whether they see that folder; return it."""
    mark = uuid.uuid4().hex
    _unpack(folder, {MARK: mark.encode()}, (), "the mark of this run")
    return mark


def _sees(folder: Path, mark: str) -> bool:
    try:
        return (folder / MARK).read_text(encoding="utf-8") == mark
    except OSError:
        return False
