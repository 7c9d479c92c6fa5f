"""The report on states: verdicts of visited states, and of the horizon after each of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from pathlib import PurePath
from typing import ClassVar

from viatool.report.document import Explained, LeftOut
from viatool.report.error_costs import states_table
from viatool.report.margins.tables import margin_sections
from viatool.report.numbers import MISSING, count, counted, percent_of, percentage, significant
from viatool.report.palette import MEANING, VERDICTS
from viatool.report.reasons import Failing
from viatool.report.sections import (
    NOTHING,
    Breakdown,
    Check,
    Count,
    Facts,
    Finding,
    Headline,
    Part,
    Rates,
    Section,
    Share,
    Table,
    Tally,
)
from viatool.report.states.horizon_table import horizon_table
from viatool.report.states.known import new_states
from viatool.report.states.record import (
    OUTCOMES,
    ClosePlacesRecord,
    RateByOutcomeRecord,
    RecordingRecord,
    StatesRecord,
    UnsafeState,
    Verdicts,
)
from viatool.report.states.stopped import left_out_of, stopped_early
from viatool.report.stopped import behind, not_judged
from viatool.report.verified import Verified
from viatool.report.wording import describe_eps, describe_value
from viatool.setting.criteria import SAMPLED

TABLES = {"state": "", "close place": "close_"}
"""What stands before the names of the arrays of each."""
NAMED = 3  # new unsafe states that a message names


class StatesDocument(Verified, Explained):
    """A report on states."""

    RECORD = StatesRecord
    SIGN = "verdicts"
    WHAT = "a report on states"
    SUBJECTS = "states"
    EMPTY = "no states to decide on"
    COMMAND = "verify"
    PLAIN = (
        "A report in JSON holds words and figures alone; of a state table (--output states:FILE.npz) viatool report "
        "makes the page with the map and every state."
    )
    RATES: ClassVar[Mapping[str, str]] = {
        "overall": "safety rate",
        "danger": "danger rate",
        "contested": "contested rate",
        "close": "close rate",
        "sampled": "sampled safety rate",
        "success": "safety rate in successful episodes",
        "collision": "safety rate in colliding episodes",
        "timeout": "safety rate in episodes that ran out of time",
        "horizon": "safety rate over the horizon",
    }

    ASKED = ("state", "close")

    record: StatesRecord

    @property
    def headline(self) -> Headline:
        """Return the safety rate, behind what was at stake."""
        overall = self.record.safety_rate.overall.share
        what = (
            "of the states that were judged are proved safe"
            if self.incomplete
            else "of the states are proved safe"
        )
        return Headline(overall.percentage(), what, overall.of(), self.stake)

    @property
    def stake(self) -> str:
        """Return in words in how many states the verdict depended on the policy, and what these verdicts are."""
        return behind(self.incomplete, self._tested)

    @property
    def incomplete(self) -> str:
        """Say how many states were not judged, because the outcome of the gate was certain before."""
        left = self.record.not_judged
        return "" if left is None else not_judged(left.overall, self.record.states, "state")

    @property
    def left_out(self) -> Mapping[str, LeftOut]:
        """Return how many states that were not judged each rate and limit may yet count."""
        left = self.record.not_judged
        return {} if left is None else left_out_of(left.model_dump())

    @property
    def _tested(self) -> str:
        record, contested = self.record, self.record.contested_rate.overall.share
        tested = f"in {count(contested.total)} of {counted(record.states, 'state')}"
        each = [tested + _ended(contested, record.verdicts)]
        if record.close is not None and self.close.total:
            each.append(
                f"in {counted(self.close.total, 'close place')}{_ended(self.close, record.close.verdicts)}"
            )
        elif not contested.total:
            return "no verdict depended on the policy"
        return f"the policy was put to the test {'; '.join(each)}"

    @property
    def close(self) -> Share:
        """Return which share of the close places is safe."""
        return NOTHING if self.record.close_rate is None else self.record.close_rate.overall.share

    @property
    def subject(self) -> Sequence[str]:
        """Return the sensor error and the criterion."""
        return f"eps {describe_eps(self.record.eps)}", f"criterion {self.record.criterion}"

    @property
    def sections(self) -> Sequence[Section]:
        """Return verdicts, rates, the horizon if there is one, why states are not safe, how episodes end, widths."""
        horizon, errors = self.horizon, self.error_costs
        judged = f", of {count(self.record.states)} that were judged" if self.incomplete else ""
        return [
            *stopped_early(self.record),
            Breakdown(("verdict", "states", "share", "meaning"), tuple(map(self._part, VERDICTS))),
            Rates(
                f"rate of safe states{judged}",
                OUTCOMES,
                {name: by_outcome(r) for name, r in self.rate_rows.items()},
            ),
            *([] if horizon is None else [horizon]),
            *([] if errors is None else [errors]),
            *(part.worst for part in self.failing_parts.values() if part.reasons),
            *self.margins,
            Facts("Driven, not proved", (("", self.task),)),
            *([Facts("Recorded readings against the map", self.recording)] if self.recording else []),
            self.widths,
        ]

    def _part(self, verdict: str) -> Part:
        number, total = int(getattr(self.record.verdicts, verdict)), self.record.states
        return Part(verdict, (count(number), percentage(number, total)), MEANING[verdict], number, verdict)

    @property
    def failing_parts(self) -> Mapping[str, Failing]:
        """Return what is not safe and why, by the option that names it: states, and close places."""
        record, close = self.record, self.record.close
        proved = "sampled" if record.criterion == SAMPLED.name else "proved"
        return {
            "state": _failing("state", record.states, record, proved),
            **({} if close is None else {"close": _failing("close place", close.states, close, proved)}),
        }

    @property
    def failing(self) -> Table:
        """Return all states and close places of which it is told why they are not safe."""
        parts = self.failing_parts.values()
        left = sum(part.left_out for part in parts)
        rows = tuple(row for part in parts for row in part.rows())
        remark = f"{count(left)} more are not safe, which the report does not explain" if left else ""
        return Table(("what", "scenario", "time [s]", "verdict", "why"), rows, "", remark, texts=2)

    def explain(self, option: str, subject: int) -> str:
        """Return why a state or a close place is not safe, by its number."""
        parts = self.failing_parts
        part = parts.get(option, Failing("close place", 0, frozenset(), {}, 0, ""))
        told = part.explain(subject)
        later = " The report says of the intervals after states how many are safe."
        return told + later if self.record.horizon is not None and "nothing to explain" in told else told

    @property
    def rate_rows(self) -> Mapping[str, RateByOutcomeRecord]:
        """Return the rates of safe states by what they count, in the order in which they are shown."""
        record = self.record
        close = (
            {} if record.close_rate is None or not self.close.total else {"close places": record.close_rate}
        )
        return {
            f"{record.criterion}, collision distance": record.safety_rate,
            f"{record.criterion}, danger distance": record.danger_rate,
            "sampled (9 actions), not a proof": record.sampled_safety_rate,
            "contested states only": record.contested_rate,
            **close,
        }

    @property
    def horizon(self) -> Table | None:
        """Return what was found of the intervals after each state, if that was asked."""
        return None if self.record.horizon is None else horizon_table(self.record.horizon)

    @property
    def error_costs(self) -> Table | None:
        """Return what each error costs in verdicts, if that was asked."""
        return None if self.record.error_costs is None else states_table(self.record.error_costs)

    @property
    def margins(self) -> Sequence[Section]:
        """Return how much error the contested states survive, if that was asked."""
        found = self.record.margins
        if found is None:
            return []
        return margin_sections(found.varied, {PurePath(self.record.policy.path).name: found})

    @property
    def task(self) -> str:
        """Return in words how the episodes ended."""
        task = self.record.task
        shares = [f"{_rate(getattr(task, f'{outcome}_rate'))} {outcome}" for outcome in OUTCOMES[1:]]
        cost = "" if task.average_cost is None else f"; average cost {significant(task.average_cost)}"
        return f"{counted(task.episodes, 'episode')}: {', '.join(shares)}{cost}"

    @property
    def recording(self) -> tuple[tuple[str, str], ...]:
        """Return for each recorded LiDAR how its readings agree with the map."""
        return tuple((found.channel, _agreement(found)) for found in self.record.recording or ())

    @property
    def widths(self) -> Table:
        """Return the widths of the reachable actions."""
        rows = tuple(
            (name, *map(significant, (w.mean, w.std, w.max)), str((w.model_extra or {}).get("unit", "")))
            for name, w in self.record.reachable_width.items()
        )
        head = ("width of the reachable actions", "mean", "std", "max", "unit")
        return Table(head, rows, "Widths" if self.bounded else "", self.bounded, texts=1)

    @property
    def bounded(self) -> str:
        """Return in words of which states the actions were bounded, if not of all: widths are those of these."""
        engine = self.record.engine
        return str(engine.get("bounded", "")) if isinstance(engine, dict) else ""

    @property
    def assumptions(self) -> Mapping[str, str]:
        """Return what a verdict rests on."""
        record = self.record
        told = (record.model_extra or {}).get("assumptions", {})
        return {
            **super().assumptions,
            "engine": describe_value(record.engine),
            **{name.replace("_", " "): describe_value(value) for name, value in told.items()},
        }

    @property
    def settings(self) -> Mapping[str, str]:
        """Return what a comparison has to agree in, which of the two engines ran left out."""
        engine = self.record.engine
        asked = (
            {name: value for name, value in engine.items() if name != "passes"}
            if isinstance(engine, dict)
            else engine
        )
        return {**super().settings, "engine": describe_value(asked)}

    @property
    def rates(self) -> Mapping[str, Share]:
        """Return every rate; that over the horizon only if there is one."""
        record = self.record
        horizon = {} if record.horizon is None else {"horizon": record.horizon.safety_rate[-1].share}
        return {
            "overall": record.safety_rate.overall.share,
            "danger": record.danger_rate.overall.share,
            "contested": record.contested_rate.overall.share,
            "close": self.close,
            "sampled": record.sampled_safety_rate.overall.share,
            **dict(zip(OUTCOMES[1:], by_outcome(record.safety_rate)[1:], strict=True)),
            **horizon,
        }

    @property
    def size(self) -> int:
        """Return how many states there are."""
        return self.record.states

    def nothing(self, rate: str) -> str:
        """Say why a rate is of nothing: of close places, why there are none."""
        if rate != "close":
            return super().nothing(rate)
        record = self.record.close
        return "no close places" + (
            f": {record.reason}"
            if record is not None and record.reason
            else " were examined (--close N asks for them)"
        )

    def counted(self, name: str) -> Iterator[Finding]:
        """Return the states, or close places, that the JSON knows to be unsafe."""
        record = self.record
        if name == "close" and record.close is not None:
            yield from (_known("close place", state) for state in record.close.unsafe_states)
        elif name in ("overall", "contested", "danger", "unsafe"):
            yield from (_known("state", state) for state in record.unsafe_states or ())

    @property
    def limited(self) -> Mapping[str, Count]:
        """Return how many states are unsafe, unknown and contested."""
        verdicts, contested = self.record.verdicts, self.record.contested_rate.overall
        return {
            "unsafe": Count(verdicts.unsafe, "unsafe"),
            "unknown": Count(verdicts.unknown, "unknown"),
            "contested": Count(contested.total, "contested"),
        }

    @property
    def tallies(self) -> Sequence[Tally]:
        """Return how many states have each verdict."""
        numbers = {verdict: int(getattr(self.record.verdicts, verdict)) for verdict in VERDICTS}
        return [
            Tally(name, number, count(number), 1 if name == "safe" else -1)
            for name, number in numbers.items()
        ]

    @property
    def costs(self) -> Mapping[str, float]:
        """Return the mean widths."""
        of = f", of {self.bounded}" if self.bounded else ""
        return {
            f"mean width of {name}{of}": width.mean for name, width in self.record.reachable_width.items()
        }

    def new_failures(self, baseline: StatesDocument) -> Sequence[Check]:
        """Decide on the unsafe states themselves if both reports list them, and on their number otherwise."""
        old, found = baseline.record, self.record
        if old.unsafe_states is None or found.unsafe_states is None:
            before, now = old.verdicts.unsafe, found.verdicts.unsafe
            figures = f"{count(now)}, was {count(before)}"
            failing = () if now <= before else tuple(self.counted("unsafe"))
            return [Check("no more unsafe states than the baseline", now <= before, figures, failing=failing)]
        new = list(new_states(old.unsafe_states, found.unsafe_states))
        named = "; ".join(f"{state.scenario} at {state.time:.2f} s" for state in new[:NAMED])
        more = f": {named}{', ...' if len(new) > NAMED else ''}" if new else ""
        failing = tuple(_known("state", state) for state in new)
        figures = f"{count(len(new))} new{more}"
        return [Check("no unsafe state that the baseline lacks", not new, figures, failing=failing)]


def _known(what: str, found: UnsafeState) -> Finding:
    text = describe_state(what, found.state, "unsafe", found.scenario, found.time, found.pose)
    place, rule = f"{found.scenario}/{found.time:.3f}", f"unsafe-{what.replace(' ', '-')}"
    return Finding(rule, text, place, place, "unsafe", found.scenario, subject=(TABLES[what], found.state))


def describe_state(
    what: str, number: int, verdict: str, scenario: str, time: float, pose: Sequence[float]
) -> str:
    """Write in a sentence which state is meant; `what` tells a state from a close place."""
    x, y, heading = pose
    return (
        f"{what.capitalize()} {number} is {verdict}: scenario {scenario} at {time:.2f} s, "
        f"x {x:.3f} m, y {y:.3f} m, heading {heading:.3f} rad."
    )


def _failing(what: str, size: int, part: StatesRecord | ClosePlacesRecord, proved: str) -> Failing:
    """Return what a report says of states, or of close places, that are not safe."""
    reasons = None if part.reasons is None else {one.state: one for one in part.reasons}
    unsafe = frozenset(one.state for one in part.unsafe_states or ())
    return Failing(what, size, unsafe, reasons, part.reasons_left_out, proved)


def by_outcome(rates: RateByOutcomeRecord) -> tuple[Share, ...]:
    """Return the rates in the order of `OUTCOMES`."""
    return tuple(getattr(rates, outcome).share for outcome in OUTCOMES)


def _ended(contested: Share, verdicts: Verdicts) -> str:
    """Write the verdicts of contested states behind a colon; all that are not safe are contested."""
    numbers = {"proved": contested.part, "unsafe": verdicts.unsafe, "unknown": verdicts.unknown}
    told = ", ".join(f"{count(number)} {name}" for name, number in numbers.items() if number)
    return f": {told}" if told else ""


def _rate(share: float | None) -> str:
    return MISSING if share is None else percent_of(Fraction(share).limit_denominator(10**9), 1)


def _agreement(found: RecordingRecord) -> str:
    off = Share(found.off, found.readings).percentage()
    cause = f": {found.cause}" if found.doubtful and found.cause else ""
    return (
        f"{off} of {counted(found.readings, 'reading')} are farther than eps from what the map shows{cause}"
    )
