"""Stored work is not gone on with under an error model that differs in the last digits alone."""

from __future__ import annotations

from dataclasses import replace

import pytest

import viatool
from viatool.errors import ConfigurationError
from viatool.places import Resolution, SearchBudget
from viatool.schedule import Campaign
from viatool.uncertainty import ErrorModel

ROOM = viatool.load_map("maps/room.yaml")
POLICY = viatool.load_policy("via")


def verify(errors, kept):
    viatool.verify(
        POLICY,
        ROOM,
        eps=0.01,
        errors=errors,
        scenarios=ROOM.scenarios[:1],
        checkpoint=kept.checkpoint,
        resume=kept.resume,
    )


def mission(errors, kept):
    viatool.mission(
        POLICY, ROOM, eps=0.01, errors=errors, scenarios=ROOM.scenarios[:1], time_limit=0.2, campaign=kept
    )


def certify(errors, kept):
    few, coarse = SearchBudget(cells=1), Resolution(1.0, 0)
    viatool.certify(
        POLICY, ROOM, ROOM.scenarios[0], eps=0.01, errors=errors, budget=few, resolution=coarse, campaign=kept
    )


@pytest.mark.parametrize("job", [verify, mission, certify])
def test_what_was_found_for_a_smaller_error_is_not_taken_for_a_larger_one(tmp_path, job):
    small, large = (
        ErrorModel.model_validate({"sensor": {"lidar": {"bias": bias}}}) for bias in (0.01, 0.010000001)
    )
    kept = Campaign(checkpoint=tmp_path / "kept")
    job(small, kept)
    job(small, replace(kept, resume=True))
    with pytest.raises(ConfigurationError, match="errors"):
        job(large, replace(kept, resume=True))
