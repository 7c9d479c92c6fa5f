"""The report on places: a certificate, volumes of poses and commands before by what became of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar

import numpy as np

from viatool.report.document import Annotated, Explained, LeftOut
from viatool.report.error_costs import cells_table
from viatool.report.numbers import count, counted, percentage, significant
from viatool.report.places.explained import explain_place, nearest
from viatool.report.places.record import OverTime, PlacesRecord, WorstPlace
from viatool.report.sections import (
    Annotation,
    Breakdown,
    Count,
    Finding,
    Headline,
    Key,
    Part,
    Section,
    Share,
    Table,
    Tally,
)
from viatool.report.stopped import behind, not_judged, stopped
from viatool.report.verified import Verified
from viatool.report.wording import describe_eps

TONES = {"uncontested": "", "certified": "safe", "refuted": "unsafe", "unknown": "unknown"}
"""The verdict whose colour each status of free volume has."""
MEANING = {
    "uncontested": "no admissible command endangers a pose",
    "certified": "proved for every pose, observation and previous command",
    "refuted": "holds a replayable counterexample",
    "unknown": "neither, at the smallest size",
}


_UNITS = ("m/s", "rad/s", "m/s to the left")


def _of(place: WorstPlace) -> str:
    """Return what a counterexample comes near to, behind how near."""
    return "" if place.obstacle is None else f" of {place.obstacle}"


class PlacesDocument(Verified, Annotated, Explained):
    """A certificate."""

    RECORD = PlacesRecord
    SIGN = "volume"
    WHAT = "a certificate"
    SUBJECTS = "roots"
    EMPTY = "no volume to decide on"
    COMMAND = "certify"
    PLAIN = (
        "A report in JSON holds words and figures alone: --output html of viatool certify shows every place."
    )
    RATES: ClassVar[Mapping[str, str]] = {
        "contested": "certified share of the contested volume",
        "overall": "safe share of the free volume",
        "arrive": "share of the free volume that reaches the goal for certain",
        "forever": "share of the free volume that is left only towards the goal",
    }

    ASKED = ("place",)

    record: PlacesRecord

    @property
    def headline(self) -> Headline:
        """Return the certified share of the contested volume, or say that nothing is contested."""
        rate, roots = self.record.contested_rate.share, self.record.roots
        text = "of the contested volume is certified" if rate.total else "no pose is contested"
        if roots.examined < roots.total:
            text += f", in a random {percentage(roots.examined, roots.total)} of the map"
        stake = behind(self.incomplete, f"{rate.percentage()} of the contested volume certified")
        return Headline(
            rate.percentage() if rate.total else "", text, stake=stake if self.record.not_judged else ""
        )

    @property
    def subject(self) -> Sequence[str]:
        """Return the scenario, its goal, the sensor error, the criterion and the delay."""
        record = self.record
        goal = ", ".join(f"{number:g}" for number in record.scenario.goal)
        return [
            record.scenario.name,
            f"goal ({goal})",
            f"eps {describe_eps(record.eps)}",
            f"criterion {self.criterion}",
            *([f"delay {record.delay:g} s"] if record.delay else []),
        ]

    @property
    def criterion(self) -> str:
        """Return the criterion, with the deceleration if there is one."""
        stop = "" if self.record.deceleration is None else f" at {self.record.deceleration:g} m/s²"
        return f"{self.record.criterion}{stop}"

    @property
    def sections(self) -> Sequence[Section]:
        """Return what was left out, volumes by status, shares, what holds later, what errors cost, and worst places."""
        left = self.record.not_judged
        told = (
            "" if left is None else f"{count(left.overall)}, of {count(left.smallest_cells)} smallest cells"
        )
        tables = (self.shares, self.lasting, self.error_costs, self.worst)
        return [
            *stopped("roots", told, " in random order"),
            self.volumes,
            *(table for table in tables if table is not None and table.rows),
        ]

    @property
    def volumes(self) -> Breakdown:
        """Return cells and volume of what is free, by status."""
        head = ("status", "cells", "volume, m² rad", "meaning")
        return Breakdown(head, tuple(self._part(name) for name in MEANING))

    def _part(self, name: str) -> Part:
        cells, volume = getattr(self.record.cells, name), getattr(self.record.volume, name)
        return Part(name, (count(cells), significant(volume)), MEANING[name], volume, TONES[name])

    @property
    def shares(self) -> Table:
        """Return the shares in words."""
        shares = {
            "contested volume that is certified": self.record.contested_rate,
            "contested volume that is decided": self.record.decided_rate,
            "free volume that is safe": self.record.free_rate,
        }
        return Table(
            ("share of", ""), tuple((name, rate.share.percentage()) for name, rate in shares.items())
        )

    @property
    def lasting(self) -> Table:
        """Return what holds beyond the next action: the condition, its volume and its share; few of many steps."""
        later = self.record.over_time
        head = ("left only towards the goal", "m² rad", "of the free volume")
        if later is None:
            return Table(head, ())
        unit = later.volume.free / max(later.forever.total if later.forever else later.steps[0].total, 1)
        few = {1, 2, 5} if len(later.steps) > 3 else {1, 2, 3}
        shares = [
            (f"certified for {counted(step.steps, 'step')}", step.share)
            for step in later.steps
            if step.steps in few or step.steps % 10 == 0 or step.steps == len(later.steps)
        ]
        if later.forever is not None:
            shares.append(("for ever, or until the goal is reached", later.forever.share))
        shares += self._kinds(later)
        rows = ((name, significant(share.part * unit), share.percentage()) for name, share in shares)
        return Table(head, tuple(rows))

    @staticmethod
    def _kinds(later: OverTime) -> list[tuple[str, Share]]:
        """Return how much of what is safe for ever arrives, moves or may stand, and how much is not proved safe."""
        if later.arrive is None or later.moving is None or later.standing is None or later.forever is None:
            return []
        held = later.forever.share
        return [
            (
                f"reaches the goal for certain, within {counted(later.arrive_within or 0, 'step')}",
                later.arrive.share,
            ),
            ("safe for ever and never stands still, but may not arrive", later.moving.share),
            ("safe for ever, but may come to stand", later.standing.share),
            ("neither is known", Share(held.total - held.part, held.total)),
        ]

    @property
    def error_costs(self) -> Table | None:
        """Return what each error costs in cells, if that was asked."""
        costs, contested = self.record.error_costs, self.record.contested_rate.total
        return None if costs is None else cells_table(costs, contested)

    @property
    def worst(self) -> Table:
        """Return the worst places: pose, command before, command, clearance."""
        state = self.record.state
        rows = tuple(
            (
                f"({place.pose[0]:.2f}, {place.pose[1]:.2f}, {place.pose[2]:.2f} rad)",
                self._told(place.previous, None if state is None else state.axes, 2),
                self._told(place.action, None if state is None else state.command, 3),
                f"{place.clearance:.3f} m{_of(place)} after {place.seconds:.2f} s",
            )
            for place in self.record.worst
        )
        before = "motion" if self.record.state else "previous command"
        return Table(("worst place", before, "command", "clearance"), rows, texts=3)

    @property
    def failing(self) -> Table:
        """Return the worst counterexamples."""
        return self.worst

    def explain(self, option: str, subject: Sequence[float]) -> str:
        """Return what is known of the worst counterexample nearest to a place x, y, theta."""
        if not self.record.worst:
            return "No place is refuted: the report names no counterexample, and of what is unknown volumes alone."
        state, found = self.record.state, nearest(self.record, subject)
        command = self._told(found.action, None if state is None else state.command, 3)
        return explain_place(self.record, subject, command)

    @staticmethod
    def _told(numbers: Sequence[float], names: Sequence[str] | None, digits: int) -> str:
        """Return numbers with their units, or with names and units where these are not the usual ones."""
        if names is None:
            first, second, *_ = numbers
            return f"{first:.{digits}f} m/s {second:+.{digits}f} rad/s"
        told = (name.split(" ") for name in names)
        return ", ".join(
            f"{name} {number:.{digits}f} {unit}" for (name, unit), number in zip(told, numbers, strict=True)
        )

    @property
    def _before(self) -> Mapping[str, str]:
        """Return what the command before, or the motion, may be."""
        before, state = self.record.previous_command, self.record.state
        if state is not None:
            ends = zip(state.axes, state.lower, state.upper, strict=True)
            told = (f"{name.split()[0]} {low:g} to {high:g} {name.split()[1]}" for name, low, high in ends)
            return {"state of the motion": "any of " + " and ".join(told)}
        ends_of = zip(before.lower, before.upper, _UNITS, strict=False)
        told = (f"{low:g} to {high:g} {unit}" for low, high, unit in ends_of)
        return {"command before": "any from " + " and ".join(told)}

    @property
    def _robot(self) -> Mapping[str, str]:
        """Return what is taken to be so of map, sensors and robot: ideal, but for what the error model states."""
        record = self.record
        moving, pose = self.stated("obstacles"), self.stated("pose")
        sensors, driven, timing = self.stated("sensor"), self.stated("actuation"), self.stated("timing")
        slip = "" if "actuation.slip " in driven else " without slip"
        ideal = f"exact arcs{slip}" if record.state is None else f"exact,{slip}"
        late = f"commands act after {record.delay:g} s, until then the one before goes on"
        return {
            "map": f"correct; {moving} may move as that says, unless it roams from where the map shows it when the "
            "policy observes, and nothing else does"
            if moving
            else "correct, and nothing on it moves",
            "sensors": f"read what is there, each number within eps {describe_eps(record.eps)}"
            + (f", but for {sensors}" if sensors else ""),
            **({"pose": f"as localised, but for {pose}"} if pose else {}),
            "motion": f"arcs{slip}, followed within {driven}, anew at every instant" if driven else ideal,
            "timing": "; ".join(
                ([] if "timing.delay " in timing else [late])
                + ([f"within {timing}, anew for every command"] if timing else [])
            ),
        }

    @property
    def assumptions(self) -> Mapping[str, str]:
        """Return what the certificate rests on."""
        record = self.record
        size = record.smallest_cell
        return {
            **super().assumptions,
            "distance": f"the footprint keeps more than {record.clearance:g} m",
            **self._robot,
            **self._before,
            "scope": "the next command from every pose, not those after it",
            "smallest cells": ", ".join(f"{name} {significant(side)}" for name, side in size.items()),
        }

    @property
    def settings(self) -> Mapping[str, str]:
        """Return what was asked, with the place and the deceleration."""
        scenario = self.record.scenario
        goal = ", ".join(f"{number:g}" for number in scenario.goal)
        return {**super().settings, "scenario": scenario.name, "goal": f"({goal})", "braking": self.criterion}

    @property
    def rates(self) -> Mapping[str, Share]:
        """Return the certified share of what is contested, and what is safe, arrives and lasts of what is free."""
        record, later = self.record, self.record.over_time
        shares = {"contested": record.contested_rate, "overall": record.free_rate}
        beyond = {} if later is None else {"arrive": later.arrive, "forever": later.forever}
        asked = {name: share for name, share in beyond.items() if share is not None}
        return {name: share.share for name, share in {**shares, **asked}.items()}

    @property
    def size(self) -> int:
        """Return how many roots were examined."""
        return self.record.roots.examined

    @property
    def limited(self) -> Mapping[str, Count]:
        """Return how many cells are refuted and unknown."""
        cells = self.record.cells
        return {
            "unsafe": Count(cells.refuted, "refuted cells"),
            "unknown": Count(cells.unknown, "unknown cells"),
        }

    @property
    def tallies(self) -> Sequence[Tally]:
        """Return the volume of each status."""
        better = {"uncontested": 0, "certified": 1, "refuted": -1, "unknown": -1}
        volumes = {name: float(getattr(self.record.volume, name)) for name in better}
        return [
            Tally(name, volume, f"{significant(volume)} m² rad", better[name])
            for name, volume in volumes.items()
        ]

    @property
    def incomplete(self) -> str:
        """Say how many roots were examined if not all were, or not judged where a run was stopped early."""
        roots, left = self.record.roots, self.record.not_judged
        if left is not None:
            return not_judged(left.overall, roots.examined, "root")
        if roots.examined == roots.total:
            return ""
        return f"only {count(roots.examined)} of {count(roots.total)} roots were examined"

    @property
    def left_out(self) -> Mapping[str, LeftOut]:
        """Return what volume each rate, and how many cells each limit may yet count."""
        left = self.record.not_judged
        return {} if left is None else left_out_of(left.smallest_cells)

    def annotations(self) -> Sequence[Annotation]:
        """Return a warning for each of the worst places."""
        return [
            Annotation(
                "warning",
                f"refuted place {pose}",
                f"after {previous}: {action} comes within {near}",
                (_square(place),),
            )
            for (pose, previous, action, near), place in zip(self.worst.rows, self.record.worst, strict=True)
        ]

    def counted(self, name: str) -> Iterator[Finding]:
        """Return the worst places, as far as the JSON knows them."""
        if name in ("contested", "overall", "unsafe"):
            for (pose, previous, action, near), place in zip(self.worst.rows, self.record.worst, strict=True):
                text = f"At {pose} after {previous}: {action} comes within {near}."
                yield Finding("refuted-place", text, pose, pose, "unsafe", subject=_square(place))


def left_out_of(unjudged: int) -> Mapping[str, LeftOut]:
    """Return what of so many smallest cells that were not judged each rate and limit may yet count: any part."""
    names = ("contested", "overall", "unsafe", "unknown")
    return {name: LeftOut(unjudged, count=False) for name in names} if unjudged else {}


def _square(place: WorstPlace) -> Key:
    """Return in which half metre square a counterexample is."""
    from viatool.report.places.tiles import tile_of

    return "refuted-place", tuple(tile_of(np.array(place.pose[:2])).tolist())
