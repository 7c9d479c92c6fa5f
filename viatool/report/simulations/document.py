"""The report on a simulation: what was driven, never mixed with what is proved."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import ClassVar

from viatool.report.document import Annotated, Cased, Located, Tabled
from viatool.report.numbers import MISSING, count, counted, percentage, significant
from viatool.report.paired import apart
from viatool.report.sections import (
    Annotation,
    Breakdown,
    Case,
    Count,
    Facts,
    Finding,
    Headline,
    Part,
    Rules,
    Section,
    Share,
    Table,
    Tally,
)
from viatool.report.simulations.record import (
    EpisodeCount,
    EpisodeRecord,
    MonitoredRecord,
    SimulationRecord,
    SpreadRecord,
)
from viatool.report.wording import describe_value

TONES = {"success": "safe", "collision": "unsafe", "timeout": "unknown"}
"""The verdict whose colour each outcome has."""
MEANING = {
    "success": "reached the goal",
    "collision": "came nearer to something than the collision distance",
    "timeout": "neither, within the time limit",
}
COLUMNS = ("episode", "scenario", "outcome", "cost", "seconds", "least_clearance", "path_length_ratio")
_BAR = 40
_COUNTED_BY = {"collision": ("overall", "clear", "unsafe"), "timeout": ("overall",)}
"""What counts an episode with that outcome as failing."""


class SimulationDocument(Cased, Annotated, Located, Tabled):
    """A simulation; its JSON tells all that the formats of text need."""

    RECORD = SimulationRecord
    SIGN = "episodes"
    WHAT = "a simulation"
    INDEPENDENT = True
    SUBJECTS = "episodes"
    EMPTY = "no episodes to decide on"
    COMMAND = "simulate"
    RATES: ClassVar[Mapping[str, str]] = {
        "overall": "share of episodes that reach the goal",
        "clear": "share of episodes without a collision",
    }
    FINDING_RULES: ClassVar[Rules] = {
        "collision-episode": ("warning", "The robot came nearer to something than the collision distance."),
        "timeout-episode": ("note", "The robot did not reach its goal in time."),
    }

    record: SimulationRecord

    @property
    def headline(self) -> Headline:
        """Return the share of the episodes that reach the goal."""
        success = self.record.success.share
        what = f"of {counted(success.total, 'episode')} reach the goal, driven and not proved"
        return Headline(success.percentage(), what, success.of())

    @property
    def terms(self) -> Mapping[str, str]:
        """Return engine, LiDAR, robot and what is out of the ordinary about it."""
        record = self.record
        return {
            "engine": record.engine,
            "lidar": record.lidar,
            "robot": record.robot.name,
            "conditions": ", ".join(self._conditions()) or "ideal",
            "seed": str(record.seed),
        }

    def _conditions(self) -> list[str]:
        from viatool.simulate.conditions import Conditions

        known = Conditions.__dataclass_fields__
        told = Conditions(**{n: v for n, v in self.record.conditions.items() if n in known}).words()
        errors = self.record.errors
        drawn = [] if errors is None else [f"errors of {errors.source}, chosen by {errors.chosen_by}"]
        return [*told, *drawn]

    @property
    def subject(self) -> Sequence[str]:
        """Return engine, LiDAR, robot and conditions."""
        record = self.record
        lidar = ["LiDAR by ray tests" if record.lidar == "rays" else "analytic LiDAR"]
        return [
            f"engine {record.engine}",
            record.robot.name,
            *(lidar if record.engine == "bullet" else []),
            *self._conditions(),
        ]

    @property
    def sections(self) -> Sequence[Section]:
        """Return outcomes, what the episodes were like, and the clearances."""
        record = self.record
        facts = [
            ("average cost", f"{significant(record.average_cost)} steps in danger"),
            ("time to goal", _spread(record.time_to_goal, "s")),
            ("path length ratio", f"{_spread(record.path_length_ratio, '')} (1 is straight)"),
            ("least clearance", _spread(record.clearance.least_of_an_episode, "m")),
        ]
        if record.beyond_limits:
            facts += [
                ("beyond the robot", f"the policy asks for {'; '.join(record.beyond_limits)}"),
                ("", f"clipped {record.clipped_commands.share.percentage()} of its commands"),
            ]
        head = ("outcome", "episodes", "meaning")
        return [
            Breakdown(head, tuple(self._part(name) for name in TONES)),
            Facts("Episodes", tuple(facts)),
            *([] if record.monitor is None else [self._monitored(record.monitor)]),
            self._clearances(),
        ]

    def _outcome(self, name: str) -> EpisodeCount:
        found: EpisodeCount = getattr(self.record, name)
        return found

    def _part(self, name: str) -> Part:
        found = self._outcome(name)
        low, high = (f"{100.0 * end:.1f}" for end in found.interval)
        figures = f"{count(found.count)} ({found.share.percentage()}; 95 % interval {low} to {high} %)"
        return Part(name, (figures,), MEANING[name], found.count, TONES[name])

    def _monitored(self, monitor: MonitoredRecord) -> Facts:
        """Return what the monitor did, and what came of it."""
        what = (
            f"{count(monitor.interventions)} of {count(monitor.intervals)} commands did not pass, in "
            f"{count(monitor.intervened_episodes)} of {counted(monitor.success.total, 'episode')}"
        )
        collisions = (
            f"{count(monitor.collision.count)}, without it {count(self.record.collision.count)} "
            f"({count(monitor.prevented_collisions)} prevented)"
        )
        goals = (
            f"{count(monitor.success.count)}, without it {count(self.record.success.count)} "
            f"({count(monitor.lost_success)} lost, {count(monitor.gained_success)} gained)"
        )
        facts = [
            ("interventions", what),
            ("collisions", collisions),
            ("reach the goal", goals),
            ("time to goal", _spread(monitor.time_to_goal, "s")),
            ("least clearance", f"{significant(monitor.least_clearance)} m"),
        ]
        if monitor.unproved:
            words = "intervals in which nothing was proved, as the robot stood too near to something"
            facts.append(("unproved", f"{count(monitor.unproved)} {words}"))
        return Facts("Under the monitor", tuple(facts))

    def _clearances(self) -> Table:
        """Return the clearances with bars, in steps of half a metre and finer near obstacles."""
        clearance = self.record.clearance
        edges, counts = clearance.histogram.edges, clearance.histogram.counts
        firsts = [*range(min(10, len(edges))), *range(10, len(edges), 5)]
        lasts = [*firsts[1:], None] if firsts else []
        merged = [sum(counts[first:last]) for first, last in zip(firsts, lasts, strict=True)]
        rows = []
        for first, following, number in zip(firsts, lasts, merged, strict=True):
            if number:
                low = edges[first]
                mark = (
                    "collision"
                    if low + 1e-9 < clearance.collision
                    else "danger"
                    if low + 1e-9 < clearance.danger
                    else ""
                )
                high = "m and more" if following is None else f"to {edges[following]:.1f} m"
                bar = "█" * max(1, round(_BAR * number / max(merged)))
                rows.append((f"{low:.1f} {high}", percentage(number, max(sum(counts), 1)), bar, mark))
        return Table(("clearance after each step", "share", "", ""), tuple(rows), texts=2)

    @property
    def assumptions(self) -> Mapping[str, str]:
        """Return what was simulated, with the robot's limits."""
        robot, clearance, errors = self.record.robot, self.record.clearance, self.record.errors
        drawn = (
            ""
            if errors is None
            else f"within {errors.source}, by {errors.chosen_by}; no other but by the conditions"
        )
        return {
            **self.terms,
            **({"errors": drawn} if drawn else {}),
            "commands": robot.speeds
            or f"v {robot.min_linear:g} to {robot.max_linear:g} m/s, |omega| up to {robot.max_angular:g} rad/s",
            "clearance": f"collision {clearance.collision:g} m, danger {clearance.danger:g} m",
            "conditions": describe_value(self.record.conditions),
        }

    @property
    def rates(self) -> Mapping[str, Share]:
        """Return the shares of the episodes that reach the goal, and that do not collide."""
        collision = self.record.collision.share
        clear = Share(collision.total - collision.part, collision.total)
        return {"overall": self.record.success.share, "clear": clear}

    @property
    def outcomes(self) -> Mapping[str, float]:
        """Return which episodes reach the goal."""
        episodes = self.record.episodes
        reached = (float(episode.outcome == "success") for episode in episodes)
        return dict(zip(apart(episode.scenario for episode in episodes), reached, strict=True))

    @property
    def size(self) -> int:
        """Return how many episodes were driven."""
        return len(self.record.episodes)

    @property
    def limited(self) -> Mapping[str, Count]:
        """Return how many episodes collide."""
        return {"unsafe": Count(self.record.collision.count, "collisions")}

    @property
    def tallies(self) -> Sequence[Tally]:
        """Return how many episodes have each outcome."""
        numbers = {name: self._outcome(name).count for name in TONES}
        return [
            Tally(name, number, count(number), 1 if name == "success" else -1)
            for name, number in numbers.items()
        ]

    @property
    def costs(self) -> Mapping[str, float]:
        """Return the mean time to the goal and the mean length of the paths."""
        means = {
            "mean time to goal [s]": self.record.time_to_goal.mean,
            "mean path length ratio": self.record.path_length_ratio.mean,
        }
        return {name: mean for name, mean in means.items() if mean is not None}

    def cases(self) -> Sequence[Case]:
        """Return every episode."""
        return [
            Case(
                "viatool.episode",
                f"{index}: {episode.scenario}",
                "passed" if episode.outcome == "success" else "warning",
                f"{episode.outcome} after {episode.seconds:.2f} s",
                _tell(episode),
                subjects=(("", index),),
            )
            for index, episode in enumerate(self.record.episodes)
        ]

    def annotations(self) -> Sequence[Annotation]:
        """Return a remark on each collision, and on each timeout."""
        return [
            Annotation("warning", f"{episode.outcome} in {episode.scenario}", _tell(episode), (("", index),))
            for index, episode in self._failures()
        ]

    def findings(self) -> tuple[Iterable[Finding], int]:
        """Return the collisions, the nearest first, then the timeouts."""
        found = [
            Finding(
                f"{episode.outcome}-episode",
                f"Episode {index}, scenario {episode.scenario}: {_tell(episode)}.",
                f"{episode.scenario}/{episode.seconds:.3f}",
                f"{index}/{episode.scenario}",
                takes=dict.fromkeys(_COUNTED_BY[episode.outcome], 1),
                subject=("", index),
            )
            for index, episode in self._failures()
        ]
        return found, len(found)

    def _failures(self) -> Iterator[tuple[int, EpisodeRecord]]:
        for outcome in _COUNTED_BY:
            there = [(i, e) for i, e in enumerate(self.record.episodes) if e.outcome == outcome]
            yield from sorted(there, key=lambda one: one[1].least_clearance)

    def columns(self) -> Sequence[str]:
        """Return what a row tells of its episode, in seconds and metres."""
        return COLUMNS

    def rows(self) -> Iterator[Sequence[object]]:
        """Yield a row for each episode."""
        for index, episode in enumerate(self.record.episodes):
            yield [index, *(getattr(episode, name) for name in COLUMNS[1:])]


def _tell(episode: EpisodeRecord) -> str:
    return (
        f"the episode ended in {episode.outcome} after {episode.seconds:.2f} s, "
        f"{episode.least_clearance:.3f} m from something at the nearest"
    )


def _spread(spread: SpreadRecord, unit: str) -> str:
    if spread.mean is None or spread.median is None or spread.least is None or spread.largest is None:
        return MISSING
    space = f" {unit}" if unit else ""
    return (
        f"{significant(spread.mean)}{space} on average, {significant(spread.median)} in the median, "
        f"{significant(spread.least)} to {significant(spread.largest)}"
    )
