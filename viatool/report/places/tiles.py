"""Places of a certificate: which of them are free, and the half-metre squares that findings are told by."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.world import Scenes

if TYPE_CHECKING:
    from viatool.places import Certificate, Raster


TILE = 0.5
"""Metres; tiles start at the origin of the map, so that they stay the same when the cells do not."""


def is_free(certificate: Certificate, raster: Raster) -> Booleans:
    """Tell in which squares (X, Y) of a raster the middle keeps the collision distance, in some heading."""
    places = raster.middles.reshape(-1, 2)
    scenes = Scenes.of(certificate.world_map, [certificate.scenario])
    left = scenes.clearance(places, np.zeros(len(places), np.int64)) - certificate.rules.footprint.radius
    return np.asarray((left > certificate.rules.clearance.collision).reshape(raster.volumes.shape[2:]))


def tile_of(places: Floats) -> Indices:
    """Return the tile (N, 2) of places (N, 2)."""
    return np.floor(places / TILE).astype(np.int64)
