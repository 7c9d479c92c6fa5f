"""Close places beside the states of a result: examined like these, as a result of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from viatool.schedule import Campaign, Progress, Serial
from viatool.verification.campaign import CloseWork
from viatool.verification.close import joined, places_beside
from viatool.verification.findings import StateFindings
from viatool.verification.reasoning import find_reasons
from viatool.verification.rejudging import Rejudging
from viatool.verification.result import Result
from viatool.verification.states import states_of

_JUDGED = 16
"""Places that are not safe of which is found out which errors they take."""


def examine_beside(
    result: Result, again: Rejudging, count: int, campaign: Campaign, tell: Progress
) -> Result:
    """Return a result with the examination of close places, or with the reason why there are none.

    Parameters
    ----------
    result : Result
        Of driven states.
    again : Rejudging
        What was asked of all of them, judged or not, and now is of the places; the seed of the examination is that of
        the places, too.
    count : int
        How many places; 0 for none.
    campaign, tell : Campaign, Progress
        Who does it, and is told.

    Notes
    -----
    Sound: yes; a place is examined as a driven state is.
    """
    if not count:
        return result
    examination = replace(again.examination, horizon=None)
    places, reason = places_beside(result.setting, again.trajectory, count, seed=examination.seed)
    if places is None:
        return replace(result, no_close=reason)
    asked = states_of(result.setting, places)
    work = CloseWork(examination, asked, result.versions)
    campaign = campaign.within("close")
    if len(work) == 1:  # of which others would do no part
        campaign = replace(campaign, scheduler=Serial())
    found = campaign.carry_out(work, tell).part
    again = replace(again, trajectory=places, examination=examination)
    beside = replace(
        result,
        trajectory=places,
        under_way=asked.under_way,
        velocity=asked.velocity,
        begun=asked.begun,
        reachable=found.reachable,
        contested=found.contested,
        judgement=found.judgement,
        witnesses=found.witnesses,
        horizon=None,
        recording=(),
        error_costs=None,
        unjudged={},
        reasons=find_reasons(again, asked, found, most_judged=_JUDGED),
    )
    return replace(result, close=beside)


def together(result: Result) -> Result:
    """Return the states of a result and behind them its close places, in episodes of their own, as one result."""
    close = result.close
    if close is None:
        return result
    count = len(result.trajectory)
    moved = replace(close.witnesses, state=close.witnesses.state + count)
    found = StateFindings.join([
        StateFindings(one.reachable, one.contested, one.judgement, witnesses, {})
        for one, witnesses in ((result, result.witnesses), (close, moved))
    ])  # fmt: skip
    velocity = None
    if result.velocity is not None and close.velocity is not None:
        velocity = np.concatenate([result.velocity, close.velocity])
    return replace(
        result,
        trajectory=joined(result.trajectory, close.trajectory),
        under_way=np.concatenate([result.under_way, close.under_way]),
        begun=np.concatenate([result.begun, close.begun]),
        velocity=velocity,
        reachable=found.reachable,
        contested=found.contested,
        judgement=found.judgement,
        witnesses=found.witnesses,
        horizon=None,
        error_costs=None,
        reasons=result.reasons.then(close.reasons, count),
        close=None,
    )
