"""What a report says of states that were not judged, because the outcome of the gate was certain before."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from viatool.report.document import LeftOut
from viatool.report.numbers import count
from viatool.report.sections import Facts
from viatool.report.states.record import OUTCOMES, StatesRecord
from viatool.report.stopped import stopped


def stopped_early(record: StatesRecord) -> Sequence[Facts]:
    """Return what was left out, and of what figures are; nothing if all states were judged."""
    left, close = record.not_judged, record.close
    if left is None:
        return []
    numbers = {name: getattr(left, name) for name in OUTCOMES[1:]}
    by_outcome = ", ".join(f"{count(number)} in {name}" for name, number in numbers.items() if number)
    told = f"{count(left.overall)}{f' ({by_outcome})' if by_outcome else ''}"
    beside = [("close places", close.reason)] if close is not None and close.reason else []
    return stopped("states", told, "; how episodes ended is of all of them", beside)


def left_out_of(unjudged: Mapping[str, int]) -> Mapping[str, LeftOut]:
    """Return how many of the states that were not judged each rate and limit may yet count."""
    left = unjudged["overall"]
    if not left:
        return {}
    return {
        **{name: LeftOut(left, count=True) for name in ("overall", "danger", "sampled", "horizon")},
        **{name: LeftOut(left, count=False) for name in ("contested", "unsafe", "unknown")},
        **{name: LeftOut(unjudged[name], count=True) for name in OUTCOMES[1:]},
    }
