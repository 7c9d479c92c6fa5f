"""The weakest states as rows of a page: in words, and as a bar of the errors that are proved and refuted."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from viatool.report.margins.record import ContestedStateRecord, PolicyMarginsRecord, VariedRecord
from viatool.report.margins.tables import HEAD, weakest_row, weakest_states

Address = Callable[[ContestedStateRecord], str]


def weakest_view(
    varied: VariedRecord,
    part: PolicyMarginsRecord,
    most: int,
    address: Address,
    fails: Callable[[ContestedStateRecord], Collection[int]],
) -> Mapping[str, Any]:
    """Return the rows of a table of the weakest states.

    Parameters
    ----------
    varied : VariedRecord
        What varies.
    part : PolicyMarginsRecord
        The margins of a policy.
    most : int
        How many rows, at most.
    address : callable
        Returns where the page shows a state.
    fails : callable
        Returns which of the conditions that do not hold count a state.
    """
    states, remark = weakest_states(part, most)
    return {
        "head": HEAD,
        "remark": remark,
        "rows": [
            {
                "cells": weakest_row(state, varied),
                "address": address(state),
                "fails": " ".join(map(str, fails(state))),
                "doubtful": state.certified is None,
                "bar": _bar(state, varied.most),
            }
            for state in states
        ],
    }


def _bar(state: ContestedStateRecord, most: float) -> Sequence[str]:
    """Return up to which percentage of the errors that were tried a state is proved, and from which it is refuted."""
    ends = (state.certified or 0.0, most if state.refuted is None else state.refuted)
    return [f"{100.0 * min(end / most, 1.0) if most > 0.0 else 0.0:.1f}%" for end in ends]
