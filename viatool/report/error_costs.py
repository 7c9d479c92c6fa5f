"""What the errors cost, as every kind of report tells it: data, and the table that ranks them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from viatool.report.numbers import count, counted
from viatool.report.records import Count, Fraction, ReportPart
from viatool.report.sections import Share, Table


class TermCostRecord(ReportPart):
    """An error, and how many states would be proved without it."""

    term: str
    value: str
    states: Count


class CellTermCostRecord(ReportPart):
    """An error, how many cells would be certified without it, and which share of the contested volume that is."""

    term: str
    value: str
    cells: Count
    share: Fraction


class RejudgedRecord(ReportPart):
    """What was judged again: `judged` of what is `not_proved`; `together` of them are proved without any error."""

    not_proved: Count
    judged: Count
    together: Count
    left_out: list[str]


class ErrorCostsRecord(RejudgedRecord):
    """What errors cost: of the states that are not proved, how many would be without each error, the costliest first.

    `judged` of the states that are `not_proved` were judged again; `together` of them are proved without any error.
    """

    terms: list[TermCostRecord]


class CellErrorCostsRecord(RejudgedRecord):
    """What errors cost: of the cells that are not certified, how many would be without each, the costliest first.

    `judged` of the cells that are `not_proved` were judged again; `together` of them are certified without any error.
    """

    terms: list[CellTermCostRecord]


def states_table(costs: ErrorCostsRecord) -> Table:
    """Return the errors by the states that they cost."""
    rows = [(one.term, one.states, one.value) for one in costs.terms]
    return _table(costs, rows, "state", "evenly spread", ())


def cells_table(costs: CellErrorCostsRecord, contested: int) -> Table:
    """Return the errors by the cells that they cost, of so many contested ones of their size."""
    rows = [(one.term, one.cells, one.value) for one in costs.terms]

    def of_volume(saved: int) -> str:
        return Share(saved * costs.not_proved, costs.judged * contested).percentage()

    return _table(costs, rows, "cell", "drawn at random", (("of the contested volume", of_volume),))


def _table(
    costs: RejudgedRecord,
    terms: Sequence[tuple[str, int, str]],
    noun: str,
    drawn: str,
    more: Sequence[tuple[str, Callable[[int], str]]],
) -> Table:
    """Return errors (name, what would be proved without it, value), with further figures of what would be proved."""
    judged = costs.judged
    rows = [
        (term, count(saved), Share(saved, judged).percentage(), *(told(saved) for _, told in more), value)
        for term, saved, value in (*terms, ("all of them together", costs.together, ""))
    ]
    some = "" if judged == costs.not_proved else f"{count(judged)}, {drawn}, of "
    remark = (
        f"{some}{counted(costs.not_proved, noun)} not proved, judged again without each error in turn; several may "
        f"save the same {noun}"
    )
    left = "".join(f"; not dropped alone: {one}" for one in costs.left_out)
    head = ("error", "proved without it", "share", *(name for name, _ in more), "value")
    return Table(head, tuple(rows if judged else ()), "What the errors cost", remark + left, texts=1)
