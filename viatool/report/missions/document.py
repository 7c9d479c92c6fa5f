"""The report on missions: which whole runs are proved, which are refuted, and why the others are not known."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import ClassVar

from viatool.errors import ConfigurationError
from viatool.report.document import Annotated, Cased, Document, Explained, LeftOut, Located, Tabled
from viatool.report.missions.explained import explain_mission
from viatool.report.missions.record import MissionRecord, MissionsRecord
from viatool.report.numbers import MISSING, count, counted
from viatool.report.paired import apart
from viatool.report.sections import (
    Annotation,
    Breakdown,
    Case,
    Check,
    Count,
    Finding,
    Headline,
    Part,
    Rules,
    Section,
    Share,
    Table,
    Tally,
)
from viatool.report.stopped import CERTAIN, behind, not_judged, stopped
from viatool.report.verified import Verified
from viatool.report.wording import describe_eps

TONES = {"proved": "safe", "refuted": "unsafe", "unknown": "unknown"}
MEANING = {
    "proved": "every run arrives and keeps its clearance",
    "refuted": "a run collides, or is still on its way at the end",
    "unknown": "neither",
}
COLUMNS = ("scenario", "verdict", "steps", "seconds", "clearance", "parts", "start_parts", "reason")


class MissionsDocument(Verified, Explained, Cased, Annotated, Located, Tabled):
    """Missions; their JSON tells all that the formats of text need."""

    RECORD = MissionsRecord
    SIGN = "missions"
    WHAT = "a report of missions"
    INDEPENDENT = True
    SUBJECTS = "missions"
    EMPTY = "no missions to decide on"
    COMMAND = "mission"
    PLAIN = "A report in JSON holds words and figures alone: --output html of viatool mission plays tubes on the map."
    RATES: ClassVar[Mapping[str, str]] = {
        "overall": "share of missions that are proved",
        "mission": "share of missions that are proved",
    }
    FINDING_RULES: ClassVar[Rules] = {
        "refuted-mission": (
            "warning",
            "A run within the errors collides, or is still on its way at the time limit.",
        ),
        "unknown-mission": ("note", "The mission could be neither proved nor refuted."),
    }

    ASKED = ("scenario",)

    record: MissionsRecord

    @property
    def headline(self) -> Headline:
        """Return how many missions are proved, behind what was left out."""
        share, left = self.record.mission_rate.share, self.incomplete
        of = f"of {counted(share.total, 'mission')}{' judged' if left else ''} are proved"
        return Headline(
            share.percentage(), of, share.of(), behind(left, f"{share.of()} proved") if left else ""
        )

    @property
    def incomplete(self) -> str:
        """Say how many missions were not judged, because the outcome of the gate was certain before."""
        return not_judged(len(self._left), self.size, "mission")

    @property
    def left_out(self) -> Mapping[str, LeftOut]:
        """Return how many missions that were not judged each rate and limit may yet count."""
        return left_out_of(len(self._left))

    @property
    def _left(self) -> Sequence[str]:
        """Return the scenarios of the missions that were not judged."""
        return [] if self.record.not_judged is None else self.record.not_judged.scenarios

    @property
    def subject(self) -> Sequence[str]:
        """Return the sensor error, the starts, the criterion and the time limit."""
        record = self.record
        return [
            f"eps {describe_eps(record.eps)}",
            f"starts {self._starts}",
            f"criterion {record.criterion}",
            f"arrival {self._arrival}",
        ]

    @property
    def _starts(self) -> str:
        """Return where runs begin: near poses, in boxes of states, or both."""
        (x, y, theta), missions = self.record.start_error, self.record.missions
        boxes = dict.fromkeys(mission.starts for mission in missions)
        near = f"within {x:g} m, {y:g} m and {theta:g} rad"
        return "; ".join(box or near for box in boxes) or near

    @property
    def _arrival(self) -> str:
        """Return where and when runs have to arrive."""
        return "; ".join(dict.fromkeys(mission.task for mission in self.record.missions))

    @property
    def sections(self) -> Sequence[Section]:
        """Return what was left out, the missions by verdict, and each of them."""
        head, left = ("verdict", "missions", "meaning"), self._left
        told = f"{count(len(left))}: {', '.join(left)}" if left else ""
        return [
            *stopped("missions", told),
            Breakdown(head, tuple(self._part(name) for name in TONES)),
            self.missions_table,
        ]

    @property
    def missions_table(self) -> Table:
        """Return a row for each mission."""
        rows = tuple(self._row(mission) for mission in self.record.missions)
        names = ("mission", "verdict", "arrives after [s]", "clearance [m]", "parts", "CPU [s]", "")
        return Table(names, rows, "Missions", texts=1)

    def _part(self, name: str) -> Part:
        number = getattr(self.record.mission_verdicts, name)
        return Part(name, (count(number),), MEANING[name], number, TONES[name])

    def _row(self, mission: MissionRecord) -> tuple[str, ...]:
        times = mission.arrival
        arrival = MISSING if times is None else f"{times[0]:.1f} to {times[1]:.1f}"
        clearance = MISSING if mission.clearance is None else f"{mission.clearance:.3f}"
        return (
            mission.scenario,
            mission.verdict,
            arrival,
            clearance,
            count(mission.parts),
            f"{mission.seconds:.1f}",
            mission.reason,
        )

    @property
    def assumptions(self) -> Mapping[str, str]:
        """Return what the verdicts rest on."""
        record, beyond = self.record, self.stated("sensor", "pose")
        return {
            **super().assumptions,
            "distance": f"the footprint keeps more than {record.collision_distance:g} m",
            "starts": f"{self._starts}, at rest in what is not named",
            "arrival": "; ".join(dict.fromkeys(mission.task for mission in record.missions)),
            "map": self._map,
            "sensors": f"read what is there, each number within eps {describe_eps(record.eps)}"
            + (f", but for {beyond}" if beyond else "")
            + ", anew in each interval",
            "motion": self._motion,
        }

    @property
    def _map(self) -> str:
        """Return what is where."""
        moving = self.stated("obstacles")
        if not moving:
            return "correct, and nothing on it moves"
        return f"correct at the start; what {moving} names may move on or roam as far as that says, and nothing else"

    @property
    def _motion(self) -> str:
        """Return how the robot carries commands out, and when."""
        driven, timing = self.stated("actuation"), self.stated("timing")
        slip = "" if "actuation.slip " in driven else ", without slip"
        acts = f"commands are given and act within {timing}" if timing else "commands act at once"
        return f"exact{slip}; {acts}" + (f", but for {driven}" if driven else "")

    @property
    def settings(self) -> Mapping[str, str]:
        """Return what was asked, with the missions and where they start."""
        asked = [*(mission.scenario for mission in self.record.missions), *self._left]
        return {**super().settings, "missions": ", ".join(asked)}

    @property
    def rates(self) -> Mapping[str, Share]:
        """Return the share of the missions that are proved."""
        share = self.record.mission_rate.share
        return {"overall": share, "mission": share}

    @property
    def outcomes(self) -> Mapping[str, float]:
        """Return which missions are proved."""
        missions = self.record.missions
        proved = (float(mission.verdict == "proved") for mission in missions)
        return dict(zip(apart(mission.scenario for mission in missions), proved, strict=True))

    @property
    def size(self) -> int:
        """Return the number of missions."""
        return len(self.record.missions)

    @property
    def limited(self) -> Mapping[str, Count]:
        """Return how many missions are refuted and unknown."""
        verdicts = self.record.mission_verdicts
        return {
            "unsafe": Count(verdicts.refuted, "refuted missions"),
            "unknown": Count(verdicts.unknown, "unknown missions"),
        }

    @property
    def tallies(self) -> Sequence[Tally]:
        """Return how many missions have each verdict."""
        better = {"proved": 1, "refuted": -1, "unknown": -1}
        numbers = {name: int(getattr(self.record.mission_verdicts, name)) for name in better}
        return [Tally(name, number, count(number), better[name]) for name, number in numbers.items()]

    def new_failures(self, baseline: Document) -> Sequence[Check]:
        """Decide whether every mission that was proved still is."""
        if not isinstance(baseline, MissionsDocument):
            return ()
        proved = {one.scenario for one in baseline.record.missions if one.verdict == "proved"}
        lost = [
            _finding(row, one)
            for row, one in enumerate(self.record.missions)
            if one.scenario in proved and one.verdict != "proved"
        ]
        figures = f"no longer: {', '.join(one.scenario for one in lost)}" if lost else "all are"
        return (Check("missions that were proved still are", not lost, figures, failing=tuple(lost)),)

    @property
    def failing(self) -> Table:
        """Return the missions that are not proved, refuted ones first."""
        rows = tuple((mission.scenario, mission.verdict, mission.reason) for _, mission in self._failures())
        return Table(("mission", "verdict", "why"), rows, texts=2)

    def explain(self, option: str, subject: str) -> str:
        """Return why a mission is not proved, by the name of its scenario."""
        missions = {mission.scenario: mission for mission in self.record.missions}
        if subject not in missions and subject in self._left:
            raise ConfigurationError(
                f"mission '{subject}' was not judged: {CERTAIN}", "run viatool mission without --stop-early"
            )
        if subject not in missions:
            raise ConfigurationError(
                f"there is no mission '{subject}': the report is on {', '.join(missions)}",
                "give one of these names",
            )
        return explain_mission(missions[subject], self.record)

    def cases(self) -> Sequence[Case]:
        """Return every mission, those that were not judged as skipped."""
        group = "viatool.mission"
        judged = [
            Case(
                group,
                mission.scenario,
                "passed" if mission.verdict == "proved" else "warning",
                f"{mission.verdict}: {mission.reason}",
                mission.reason,
                subjects=(("", row),),
            )
            for row, mission in enumerate(self.record.missions)
        ]
        return [*judged, *(Case(group, name, "skipped", f"not judged: {CERTAIN}") for name in self._left)]

    def annotations(self) -> Sequence[Annotation]:
        """Return a remark on each mission that is not proved, the refuted ones first."""
        return [
            Annotation(
                "warning", f"mission {mission.scenario} is {mission.verdict}", mission.reason, (("", row),)
            )
            for row, mission in self._failures()
        ]

    def findings(self) -> tuple[Iterable[Finding], int]:
        """Return the refuted missions, then the unknown ones."""
        found = [_finding(row, mission) for row, mission in self._failures()]
        return found, len(found)

    def _failures(self) -> Iterator[tuple[int, MissionRecord]]:
        for verdict in ("refuted", "unknown"):
            for row, mission in enumerate(self.record.missions):
                if mission.verdict == verdict:
                    yield row, mission

    def columns(self) -> Sequence[str]:
        """Return what a row tells of its mission, in seconds and metres."""
        return COLUMNS

    def rows(self) -> Iterator[Sequence[object]]:
        """Yield a row for each mission."""
        for mission in self.record.missions:
            yield [getattr(mission, name) for name in COLUMNS]


def left_out_of(unjudged: int) -> Mapping[str, LeftOut]:
    """Return how many of the missions that were not judged each rate and limit may yet count."""
    if not unjudged:
        return {}
    return {
        **{name: LeftOut(unjudged, count=True) for name in MissionsDocument.RATES},
        **{name: LeftOut(unjudged, count=False) for name in ("unsafe", "unknown")},
    }


def _finding(row: int, mission: MissionRecord) -> Finding:
    """Return a mission that is not proved."""
    verdict = TONES[mission.verdict]
    return Finding(
        f"{mission.verdict}-mission",
        f"Mission {mission.scenario} is {mission.verdict}: {mission.reason}.",
        mission.scenario,
        mission.scenario,
        verdict,
        mission.scenario,
        takes=dict.fromkeys(("overall", "mission", verdict), 1),
        subject=("", row),
    )
