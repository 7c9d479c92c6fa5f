"""Bins of which rays return nothing while others err where they meet nothing, against bins put together ray by ray."""

from __future__ import annotations

import numpy as np
import pytest

from viatool.channels.erring import Erring
from viatool.channels.missing import Missing
from viatool.sets.forms import Forms
from viatool.world import Lidar

ERROR, SHARE, LOST = 0.05, 0.02, 2
KINDS = [("mean", 0.0), ("mean", -1.0), ("mean", 9.0), ("mean", None), ("minimum", 9.0), ("minimum", 0.0)]


@pytest.mark.parametrize(("reduce", "no_return"), KINDS)
def test_what_is_left_of_a_bin_errs_where_it_meets_nothing(reduce, no_return):
    """Two of five rays surely meet something, and are lost; what the others meet or not is open."""
    lidar = Lidar(3.0, 5, 1, 0.6, 1.5, reduce=reduce, no_return=no_return)
    nothing = lidar.maximum_range if no_return is None else no_return
    generator = np.random.default_rng(0)
    rays = np.where(generator.random((4000, 5)) < 0.5, nothing, generator.uniform(0.6, 1.5, (4000, 5)))
    rays[:50] = nothing
    rays[:, :LOST] = generator.uniform(0.6, 1.5, (4000, LOST))
    taken = {"mean": np.mean, "minimum": np.min}[reduce]
    sign = np.where(generator.random((4000, 1)) < 0.5, -1.0, 1.0)
    erring = rays * (1.0 + SHARE * sign) + ERROR * sign
    usual = taken(erring, axis=1)
    erring[:, :LOST] = nothing
    seen = taken(erring, axis=1)
    errors = Erring(
        np.array([ERROR]), np.array([SHARE]), np.zeros((0, 1)), np.zeros(3), (),
        (Missing(LOST, np.array([0]), lidar),),
    )  # fmt: skip
    ends = np.array([[usual.min()]]), np.array([[usual.max()]])
    most = np.array([[max(lidar.maximum_range, nothing)]])
    found = errors.lost(Forms.between(*ends), slice(0, 1), most)[0]
    assert (found.lower[0, 0] - 1e-12 <= seen).all()
    assert (seen <= found.upper[0, 0] + 1e-12).all()
