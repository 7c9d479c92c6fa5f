"""The one driver of long work: cut into pieces, carried out by a scheduler until a deadline, kept in a checkpoint.

Units of work stand in an order. What is found covers the first of them up to some unit, and nothing beyond: so where
the order is random, what was done when the time was up is a fair sample, whoever worked on it. Two things would make
it unfair, for a unit that takes longer is likelier to be cut off.

- A piece is begun only while there is time, and a piece that is begun is finished and counts. The number of units is
  then a stopping time of their order: it depends on those that are counted, never on how long the next one would have
  taken, and sums over them are unbiased (Wald's identity).
- Pieces get smaller towards the deadline, so that the last ones end near it. One that is still at work a tenth of the
  budget later is cut off, and no unit from it on counts. That alone favours units that take little time, and it happens
  where a few units take a tenth of the budget.
"""

from __future__ import annotations

import logging
import math
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from numpy.typing import NDArray

from viatool.errors import ConfigurationError
from viatool.schedule.checkpoint import Checkpoint
from viatool.schedule.deadline import NEVER, Deadline, TimeUp, within
from viatool.schedule.pieces import Content, Piece, Scheduler, Span, cut
from viatool.schedule.progress import Progress, ignore
from viatool.schedule.serial import Serial

_log = logging.getLogger(__name__)

Part = TypeVar("Part")

_GRACE = 0.1
"""Of the budget, after which what was begun is cut off."""
_HORIZON = 0.5
"""Of the time left, in which a piece has to be expected to be done, with what its worker does before."""
_FIRST = 4
"""Units of a piece as long as none has shown how long one takes."""


class Work(ABC, Generic[Content, Part]):
    """N units of work, any consecutive ones of which a worker can be given.

    Its function is pure. What it finds in a unit may depend on the units of the same piece if `whole` says of which
    ones; then only such pieces are kept in a checkpoint.
    """

    @property
    @abstractmethod
    def stage(self) -> str:
        """Return what progress calls the units."""

    @abstractmethod
    def __len__(self) -> int:
        """Return N."""

    @property
    @abstractmethod
    def function(self) -> Callable[[Content], Part]:
        """Return what is done with the content of a piece: picklable, pure, and calls `check_time` now and then."""

    @abstractmethod
    def content(self, span: Span) -> Content:
        """Return what the function is called with for some units."""

    @abstractmethod
    def at_once(self, workers: int) -> int:
        """Return the units of a piece, where there is time enough."""

    @abstractmethod
    def describe(self) -> Mapping[str, Any]:
        """Return everything that the findings depend on, as plain data for the manifest of a checkpoint."""

    @abstractmethod
    def to_arrays(self, part: Part) -> Mapping[str, NDArray[Any]]:
        """Return what was found as arrays by name."""

    @abstractmethod
    def from_arrays(self, arrays: Mapping[str, NDArray[Any]]) -> Part:
        """Return what `to_arrays` was called on."""

    @abstractmethod
    def join(self, parts: Sequence[Part]) -> Part:
        """Return what was found in consecutive units as one."""

    def name(self, span: Span) -> str:
        """Return how messages call a piece."""
        return f"{self.stage} {span.first:,} to {span.last - 1:,}"

    def size(self, span: Span) -> int:
        """Return how much of `total` some units are, as progress counts."""
        return len(span)

    @property
    def total(self) -> int:
        """Return the size of all units."""
        return self.size(Span(0, len(self)))

    def whole(self, span: Span) -> bool:
        """Tell whether what is found in these units together is the same in every run, and may be kept."""
        return True


class EvenWork(Work[Content, Part]):
    """Work that is always cut into the same pieces, as what is found in a unit depends on the others of its piece."""

    piece: ClassVar[int]
    """Units of a piece."""

    def at_once(self, workers: int) -> int:
        """Return the units of a piece, always the same."""
        return self.piece

    def whole(self, span: Span) -> bool:
        """Tell whether some units are one of the pieces into which all are always cut."""
        return span.first % self.piece == 0 and span.last == min(span.first + self.piece, len(self))


@dataclass(frozen=True)
class Found(Generic[Part]):
    """What was found in the first units.

    Parameters
    ----------
    part : object
        It, joined.
    units : int
        How many.
    """

    part: Part
    units: int


class CutShort(KeyboardInterrupt):  # an event, not an error
    """Somebody interrupts work; `found` is what was found until then."""

    def __init__(self, found: Found[Any]) -> None:
        super().__init__()
        self.found = found


@dataclass(frozen=True)
class Campaign:
    """How long work is carried out.

    Parameters
    ----------
    scheduler : Scheduler
        Who does it: here, in processes or on a cluster.
    checkpoint : path, optional
        Folder that keeps what is finished.
    resume : bool
        Whether to continue from it.
    chunk : int, optional
        Of what progress counts, how many a worker gets at once, if what is found does not depend on it; by default
        what fits the work.
    """

    scheduler: Scheduler = field(default_factory=Serial)
    checkpoint: str | os.PathLike[str] | None = None
    resume: bool = False
    chunk: int | None = None

    def __post_init__(self) -> None:
        if self.resume and self.checkpoint is None:
            raise ConfigurationError("nothing is there to resume from", "give the folder with --checkpoint")

    def within(self, folder: str) -> Campaign:
        """Return the campaign of a part of the work, kept in a folder of its own below this one's checkpoint."""
        if self.checkpoint is None:
            return self
        return Campaign(self.scheduler, Path(self.checkpoint) / folder, resume=True)

    def carry_out(
        self,
        work: Work[Content, Part],
        tell: Progress = ignore,
        *,
        until: Deadline = NEVER,
        enough: Callable[[Sequence[Part]], bool] | None = None,
    ) -> Found[Part]:
        """Do the work, or its first units.

        Parameters
        ----------
        work : Work
            N units.
        tell : Progress
            Told how much of the work is done.
        until : Deadline
            When to stop.
        enough : callable, optional
            Called with what was found in the first pieces; true when that will do.

        Returns
        -------
        Found
            Of all units, the same bit for bit for every scheduler and interruption; or of the first ones, if the
            time was up or it was enough.
        """
        front = _Front(work, tell, enough)
        store = None
        if self.checkpoint is not None:
            store = Checkpoint(self.checkpoint, work.describe(), resume=self.resume)
            kept = store.finished(lambda span: span.last <= len(work) and work.whole(span))
            front.put((span, work.from_arrays(arrays)) for span, arrays in kept)
        units = self._units_at_once(work)
        _log.info(
            "%s: %d in pieces of %d or less, %d worker(s)%s",
            work.stage,
            work.total,
            work.size(Span(0, min(units, len(work)))),
            self.scheduler.workers,
            "" if store is None else f", {front.done} of them kept in {self.checkpoint}",
        )
        if front.satisfied:
            return front.found()
        tell(work.stage, front.done, work.total)
        pace = _Pace(until, self.scheduler.workers)
        timed = _Timed(work.function, until.moved(_GRACE))
        pieces = _pieces(work, cut(len(work), front.parts, units), pace)
        try:
            for piece, (part, seconds) in self.scheduler.run(timed, pieces):
                pace.note(len(piece.span), seconds)
                if part is None:
                    continue
                if store is not None and work.whole(piece.span):
                    store.write(piece.span, work.to_arrays(part), piece.name)
                front.put([(piece.span, part)])
                if front.satisfied:
                    break
        except KeyboardInterrupt as error:
            raise CutShort(front.found()) from error
        return front.found()

    def _units_at_once(self, work: Work[Content, Part]) -> int:
        if self.chunk is not None:
            units = min(len(work), max(1, -(-self.chunk // work.size(Span(0, 1)))))
            if work.whole(Span(0, units)):
                return units
        return max(1, work.at_once(self.scheduler.workers))


class _Front(Generic[Part]):
    """What was found so far, and how far it reaches without a gap."""

    def __init__(
        self, work: Work[Any, Part], tell: Progress, enough: Callable[[Sequence[Part]], bool] | None
    ) -> None:
        self._work, self._tell, self._enough = work, tell, enough
        self.parts: dict[Span, Part] = {}
        self.satisfied = False
        self.done, self._reached = 0, 0
        self._first: list[Part] = []
        self._begins: dict[int, Span] = {}

    def put(self, found: Iterable[tuple[Span, Part]]) -> None:
        """Note what was found in some pieces, and tell of it."""
        before = self.done
        for span, part in found:
            self.parts[span] = part
            self._begins[span.first] = span
            self.done += self._work.size(span)
        if self.done > before:
            self._advance()
            self._tell(self._work.stage, self.done, self._work.total)

    def _advance(self) -> None:
        while not self.satisfied and (span := self._begins.get(self._reached)) is not None:
            self._first.append(self.parts[span])
            self._reached = span.last
            if self._enough is not None:
                self.satisfied = self._enough(self._first)

    def found(self) -> Found[Part]:
        """Return what was found in the first units, up to the first one in which nothing was."""
        return Found(self._work.join(self._first), self._reached)


class _Pace:
    """How many units a piece may have, so that it ends in time: few at first, then as many as have been seen to fit."""

    def __init__(self, until: Deadline, workers: int) -> None:
        self._until, self._workers = until, workers
        self._under_way = self._largest = self._units = 0
        self._seconds = 0.0

    def note(self, units: int, seconds: float) -> None:
        """Note how long a piece took its worker."""
        self._under_way -= units
        self._units, self._seconds = self._units + units, self._seconds + seconds
        self._largest = max(self._largest, units)

    def take(self, most: int) -> int | None:
        """Return the units of the next piece, up to `most`; 0 when the time is up, None while others are awaited."""
        size = self._fitting(most)
        if size is not None:
            self._under_way += size
        return size

    def _fitting(self, most: int) -> int | None:
        left = self._until.left
        if math.isinf(left):
            return most
        if left <= 0.0:
            return 0
        before = self._under_way / self._workers
        if not self._units:
            return min(most, _FIRST) if before < _FIRST else None
        fit = _HORIZON * left * self._units / max(self._seconds, 1e-9) - before
        if fit < 1.0 and self._under_way:
            return None
        return int(max(1, min(most, 2 * self._largest, fit)))


def _pieces(work: Work[Content, Any], spans: Iterable[Span], pace: _Pace) -> Iterator[Piece[Content] | None]:
    """Cut the pieces out of the work, each when it is asked for."""
    for span in spans:
        first = span.first
        while first < span.last:
            size = pace.take(span.last - first)
            if size is None:
                yield None
                continue
            if not size:
                return
            some = Span(first, first + size)
            yield Piece(some, work.name(some), work.content(some))
            first += size


@dataclass(frozen=True)
class _Timed(Generic[Content, Part]):
    """The function of a work as workers carry it out: what it found, None if it was cut off, and how long it took."""

    function: Callable[[Content], Part]
    until: Deadline

    def __call__(self, content: Content) -> tuple[Part | None, float]:
        start = self.until.clock()
        try:
            with within(self.until):
                found: Part | None = self.function(content)
        except TimeUp:
            found = None
        return found, self.until.clock() - start
