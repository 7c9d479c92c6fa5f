"""Observations as laser scans, whatever the order, the encoding and the frames of their LiDAR."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from viatool.channels import Channel, Frames, Quantities
from viatool.policy import ObservationChannel
from viatool.report.playback.scans import scan_views

QUARTERS = {"start": 0.0, "step": np.pi / 2, "rays": 4, "minimum_range": 0.1, "maximum_range": 4.0}


def channel(lidar: dict[str, Any], name: str = "lidar", **encoding: Any) -> Channel:
    return ObservationChannel.model_validate({"name": name, "kind": "lidar", "lidar": lidar, **encoding})


def shown(observation: list[float], *channels: Channel, frames: Frames | None = None) -> list[dict[str, Any]]:
    """Return the fields of the scan of each LiDAR."""
    views = scan_views(Quantities.of(channels, frames=frames))
    given = np.array(observation, np.float32).astype(np.float64)
    return [dict(view.message(5, "/nominal", given).fields) for view in views]


def told(fields: dict[str, Any]) -> list[tuple[float, float]]:
    """Return where each ray looks, in degrees, and what it reads."""
    angles = fields["angle_min"] + fields["angle_increment"] * np.arange(len(fields["ranges"]))
    return [
        (round(float(np.degrees(a)), 3), round(float(r), 5))
        for a, r in zip(angles, fields["ranges"], strict=True)
    ]


def test_rays_ascend_whichever_way_they_are_observed() -> None:
    (fields,) = shown([1.0, 2.0, 3.0, 3.5], channel(QUARTERS))
    assert told(fields) == [(0.0, 1.0), (90.0, 2.0), (180.0, 3.0), (270.0, 3.5)]
    (fields,) = shown([1.0, 2.0, 3.0, 3.5], channel({**QUARTERS, "order": "clockwise"}))
    assert told(fields) == [(-270.0, 3.5), (-180.0, 3.0), (-90.0, 2.0), (0.0, 1.0)]
    listed = {"angles": [2.0, 3.0, -2.0 * np.pi + 4.0], "minimum_range": 0.1, "maximum_range": 4.0}
    (fields,) = shown([1.0, 2.0, 3.0], channel(listed))
    assert [degrees for degrees, _ in told(fields)] == pytest.approx(np.degrees([2.0, 3.0, 4.0]), abs=1e-3)


def test_bins_look_where_the_ray_points_that_counts() -> None:
    lidar = {**QUARTERS, "step": np.pi / 8, "rays": 4, "bins": 2}
    (fields,) = shown([1.0, 2.0], channel(lidar))
    assert told(fields) == [(11.25, 1.0), (56.25, 2.0)]
    (fields,) = shown([1.0, 2.0], channel({**lidar, "reduce": "first"}))
    assert told(fields) == [(0.0, 1.0), (45.0, 2.0)]


@pytest.mark.parametrize(
    ("encoding", "inputs"),
    [
        ({"scale": 0.25}, [0.125, 0.5, 0.75, 1.0]),
        ({"scale": -0.5, "offset": 1.0}, [0.75, 0.0, -0.5, -1.0]),
        ({"scale": 0.5, "clip": (0.0, 2.0)}, [0.25, 1.0, 1.5, 2.0]),
        ({"reciprocal": True, "clip": (0.25, 10.0)}, [2.0, 0.5, 1.0 / 3.0, 0.25]),
    ],
)
def test_readings_are_told_in_metres(encoding: dict[str, Any], inputs: list[float]) -> None:
    (fields,) = shown(inputs, channel(QUARTERS, **encoding))
    assert [reading for _, reading in told(fields)] == pytest.approx([0.5, 2.0, 3.0, np.inf], abs=1e-5)


def test_a_clip_is_shown_as_its_end() -> None:
    (fields,) = shown([0.2, 0.3, 0.5, 0.4], channel(QUARTERS, scale=0.2, clip=(0.2, 0.5)))
    assert [reading for _, reading in told(fields)] == pytest.approx([1.0, 1.5, 2.5, 2.0], abs=1e-5)


def test_what_meets_nothing_is_infinitely_far() -> None:
    (fields,) = shown([0.0, 4.0, 4.1, 3.99], channel({**QUARTERS, "no_return": 0.0}))
    assert [reading for _, reading in told(fields)] == [np.inf, np.inf, np.inf, 3.99]
    assert (fields["range_min"], fields["range_max"]) == (0.0, 4.0)
    assert fields["ranges"].dtype == np.float32


def test_only_the_newest_frame_is_shown() -> None:
    first, second = [1.0, 2.0, 3.0, 3.5], [1.1, 2.1, 3.1, 3.6]
    (fields,) = shown([*first, *second], channel(QUARTERS), frames=Frames(count=2))
    assert [reading for _, reading in told(fields)] == second
    newest = Frames(count=2, order="newest_first")
    (fields,) = shown([*first, *second], channel(QUARTERS), frames=newest)
    assert [reading for _, reading in told(fields)] == first


def test_lidars_have_topics_of_their_own_and_uneven_ones_none() -> None:
    uneven = {"angles": [0.0, 1.0, 1.5], "minimum_range": 0.1, "maximum_range": 4.0}
    views = scan_views(
        Quantities.of([channel(uneven, "uneven"), channel(QUARTERS, "low"), channel(QUARTERS, "high")])
    )
    given = np.arange(1.0, 12.0) / 4.0
    messages = [view.message(0, "/witness", given) for view in views]
    assert [message.topic for message in messages] == ["/witness/scan", "/witness/scan_2"]
    assert [message.fields["ranges"].tolist() for message in messages] == [
        [1.0, 1.25, 1.5, 1.75],
        [2.0, 2.25, 2.5, 2.75],
    ]
    nothing = views[0].message(0, "/witness", None)
    assert np.isnan(nothing.fields["ranges"]).all()
