"""The one document: what every format says of a run, whatever the run was over.

A kind of run (states, places, a simulation, ...) is one adapter: a `Document` of its stored JSON, which suffices for
the texts for people, for the gate and for comparisons, and below it a document of the live run, which can do more.
What more is said by the abstract classes at the end: a format names the one that it needs, and serves every kind of
run whose document derives from it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from pydantic import ValidationError

from viatool.errors import ConfigurationError
from viatool.report.records import SCHEMA_VERSION, RunRecord
from viatool.report.sections import Count, Headline, Section, Share, Survivor, Table, Tally

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from viatool.report.files import Content
    from viatool.report.playback.messages import RosMessage
    from viatool.report.sections import Annotation, Case, Check, Finding, Key, Rules


class Document(ABC):
    """A run as data.

    Parameters
    ----------
    content : mapping
        The report JSON: a contract with other programs, and the only place where figures are kept.
    path : Path, optional
        Where it is stored.

    Raises
    ------
    ConfigurationError
        If the content is not a report of this kind; names the field.
    """

    RECORD: ClassVar[type[RunRecord]]
    """The typed form of the JSON."""
    SIGN: ClassVar[str]
    """The field of the JSON that tells this kind from all others."""
    WHAT: ClassVar[str]
    """A noun with its article for one such document."""
    SUBJECTS: ClassVar[str]
    """What the size counts."""
    EMPTY: ClassVar[str]
    """Says that there is nothing to decide on."""
    COMMAND: ClassVar[str]
    """The command that writes it."""
    RATES: ClassVar[Mapping[str, str]]
    """What a gate may ask of it: names of rates and what they are the rates of; ``overall`` needs no name."""

    PLAIN: ClassVar[str] = ""
    """What a page of the stored JSON says that it lacks."""
    INDEPENDENT: ClassVar[bool] = False
    """Whether subjects are drawn independently of each other, so that chance makes intervals of their rates."""
    RADII: ClassVar[Mapping[str, str]] = {}
    """What else a gate may ask of it: names of errors and what is to survive them, everything."""

    record: RunRecord

    def __init__(self, content: Mapping[str, Any], path: Path | None = None) -> None:
        self.content, self.path = dict(content), path
        version = self.content.get("schema_version", SCHEMA_VERSION)
        if isinstance(version, int) and version != SCHEMA_VERSION:
            raise ConfigurationError(
                f"'{path}' is a report of schema version {version}, and this viatool reads version {SCHEMA_VERSION}",
                f"write it again with viatool {self.COMMAND} ... --output json:PATH",
            )
        try:
            self.record = self.RECORD.model_validate(self.content)
        except ValidationError as error:
            first = error.errors()[0]
            field = ".".join(str(part) for part in first["loc"]) or "the document"
            raise ConfigurationError(
                f"'{path}' is not a viatool report: {field}: {first['msg']}",
                f"write one with viatool {self.COMMAND} ... --output json:PATH",
            ) from error

    @property
    @abstractmethod
    def headline(self) -> Headline:
        """Return the one figure that counts most."""

    @property
    @abstractmethod
    def terms(self) -> Mapping[str, str]:
        """Return what was asked, by name: what CI dashboards list beside the files."""

    @property
    @abstractmethod
    def subject(self) -> Sequence[str]:
        """Return in a few phrases under which conditions the policy was examined on the map."""

    @property
    @abstractmethod
    def sections(self) -> Sequence[Section]:
        """Return the figures for people, in their order."""

    @property
    @abstractmethod
    def assumptions(self) -> Mapping[str, str]:
        """Return what the figures rest on, by name."""

    @property
    def settings(self) -> Mapping[str, str]:
        """Return what a comparison has to agree in: documents with other settings answer other questions."""
        asked = {"map": self.record.map.sha256[:12], **self.terms}
        return {**asked, **{name: text for name, text in self.assumptions.items() if name not in asked}}

    @property
    @abstractmethod
    def rates(self) -> Mapping[str, Share]:
        """Return the rates that exist by their names in `RATES`."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Return how many of the `SUBJECTS` there are."""

    @property
    @abstractmethod
    def tallies(self) -> Sequence[Tally]:
        """Return the figures that a comparison shows, with what is the better side."""

    @property
    def outcomes(self) -> Mapping[str, float]:
        """Return a figure of each subject, by what makes it the same one in another run; {} where the JSON tells none.

        More is better; 1 and 0 where a subject holds or not.
        """
        return {}

    @property
    def groups(self) -> Mapping[str, str]:
        """Return by the names of `outcomes` which subjects go together, so that chance does not act on each alone.

        {} where each is by itself.
        """
        return {}

    @property
    def survived(self) -> Mapping[str, Sequence[Survivor]]:
        """Return which error each subject survives, by the names in `RADII`; the weakest first."""
        return {}

    @property
    def limited(self) -> Mapping[str, Count]:
        """Return what ``--max-unsafe``, ``--max-unknown`` and ``--min-contested`` count, by the word after the dash."""
        return {}

    @property
    def costs(self) -> Mapping[str, float]:
        """Return figures whose ratio a comparison shows."""
        return {}

    @property
    def incomplete(self) -> str:
        """Say what was left out, so that no condition can hold; empty if nothing was."""
        return ""

    @property
    def left_out(self) -> Mapping[str, LeftOut]:
        """Return what may be added to each of `rates` and of `limited`, where a run was stopped early; else {}."""
        return {}

    def nothing(self, rate: str) -> str:
        """Say why one of `rates` is of nothing, so that it cannot be decided on."""
        return self.EMPTY

    def counted(self, name: str) -> Iterable[Finding]:
        """Return what one of `rates` misses, or one of `limited` counts, as far as it is known; the gravest first."""
        return ()

    def new_failures(self, baseline: Any) -> Sequence[Check]:
        """Decide what an older document of the same kind says about single failures."""
        return ()


@dataclass(frozen=True)
class LeftOut:
    """Subjects that nobody judged.

    Parameters
    ----------
    number : int
        How many.
    count : bool
        Whether a rate is of all of them, or of as many as turn out to belong to it.
    """

    number: int
    count: bool


class Explained(Document):
    """A document that says of each subject that is not safe why."""

    ASKED: ClassVar[Sequence[str]]
    """The options of ``viatool explain`` that name a subject."""

    @property
    @abstractmethod
    def failing(self) -> Table:
        """Return a row for each subject that is not safe, the worst first."""

    @abstractmethod
    def explain(self, option: str, subject: Any) -> str:
        """Return in words what a subject is, as one of the options names it, and why it is not safe.

        Raises
        ------
        ConfigurationError
            If there is no such subject, or the report does not say why.
        """


class Cased(Document):
    """A document with cases: parts of the run that passed, failed or stayed open, one by one."""

    @abstractmethod
    def cases(self) -> Sequence[Case]:
        """Return every case."""


class Annotated(Document):
    """A document with remarks for a log that people look through."""

    @abstractmethod
    def annotations(self) -> Sequence[Annotation]:
        """Return the remarks, the gravest first within each level."""


class Located(Document):
    """A document with findings: places that are not safe, each the same in the next run."""

    FINDING_RULES: ClassVar[Rules]
    """Level and description of the rules that findings are of."""

    @abstractmethod
    def findings(self) -> tuple[Iterable[Finding], int]:
        """Return the findings, the gravest first, and how many there are."""

    def counted(self, name: str) -> Iterable[Finding]:
        """Return what one of `rates` misses, or one of `limited` counts; the gravest first."""
        return (finding for finding in self.findings()[0] if name in finding.takes)


class Tabled(Document):
    """A document with a row for each part of the run, for spreadsheets."""

    @abstractmethod
    def columns(self) -> Sequence[str]:
        """Return the names of the columns."""

    @abstractmethod
    def rows(self) -> Iterator[Sequence[object]]:
        """Yield the rows, which may be many."""

    def row_keys(self) -> Iterator[Collection[Key]]:
        """Yield of which parts of the run each row is."""
        return ((("", row),) for row in count())

    def row_of(self, finding: Finding) -> Sequence[object] | None:
        """Return a row for a finding that none of `rows` is about; None if one is."""
        return None


class Drawn(Document):
    """A document that can be drawn."""

    STYLE: ClassVar[Mapping[Any, Any]] = {}
    """Settings of matplotlib that its pictures need."""

    @abstractmethod
    def draw(self) -> Figure:
        """Return a picture."""


class Explorable(Document):
    """A document that can be a page to explore."""

    @abstractmethod
    def page(self, checks: Sequence[Check]) -> str:
        """Return the page."""


class Replayable(Document):
    """A document with counterexamples that can be run again."""

    @abstractmethod
    def witness_file(self) -> Mapping[str, Any]:
        """Return what ``viatool replay`` reads."""


class Playable(Document):
    """A document that can be played over time, beside a recording."""

    @abstractmethod
    def play(self) -> Iterator[RosMessage]:
        """Yield ROS messages in the order of their stamps."""


@dataclass(frozen=True)
class StateTable:
    """Arrays of one row for each state, which may be many.

    Parameters
    ----------
    size : int
        How many states there are.
    episode_columns : sequence of str
        The names of the arrays with one row for each episode instead.
    rows : callable
        Returns the arrays of some states.
    keys : callable
        Returns which part of the run a row is.
    """

    size: int
    episode_columns: Sequence[str]
    rows: Callable[[slice], Mapping[str, NDArray[Any]]]
    keys: Callable[[int], Key]


class StateTabled(Document):
    """A document with tables of states."""

    @abstractmethod
    def state_tables(self) -> Mapping[str, StateTable]:
        """Return the tables by what stands before the names of their arrays."""

    def kept_beside(self) -> Mapping[str, NDArray[Any]]:
        """Return what else an archive has to hold so that every format can be made of it; {} if there is no way."""
        return {}


class CellTabled(Document):
    """A document with arrays of one row for each cell of space."""

    @abstractmethod
    def cell_table(self) -> Mapping[str, NDArray[np.generic]]:
        """Return the arrays."""


class TubeTabled(Document):
    """A document with arrays of one row for each part of a tube."""

    @abstractmethod
    def tube_table(self) -> Mapping[str, NDArray[Any]]:
        """Return the arrays."""


class Evidenced(Document):
    """A document whose claims others can recheck from a folder."""

    @abstractmethod
    def evidence_files(self, checks: Sequence[Check]) -> Mapping[str, Content]:
        """Return the content of every file of the folder, by its name."""


class Recorded(Document):
    """A document with driven states that ``viatool verify --trajectory`` reads."""

    @abstractmethod
    def write_trajectory(self, path: Path) -> None:
        """Write them in the format of the suffix."""
