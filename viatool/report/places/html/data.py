"""Places and counterexamples as compact arrays for the page: shares of volume by square and slice of headings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from bokeh.palettes import Viridis256

from viatool.arrays import Floats, Indices
from viatool.places import SECTORS, STATUSES
from viatool.report.html.states import (
    channel_list,
    fans_of,
    pack,
    pack_coarsely,
    rules_of,
    shapes,
    world_of,
)
from viatool.report.places.tiles import is_free

if TYPE_CHECKING:
    from viatool.places import Certificate, Raster


MOST_BYTES = 4_000_000  # of the shares, before base64; the page stays below 10 MB with the plotting library
MOST_WITNESSES = 8_000
_UNEXAMINED, _MIXED = len(STATUSES), 255


def page_data(certificate: Certificate) -> dict[str, Any]:
    """Return all that the page's script needs to draw any slice, and the worst counterexamples of each place."""
    raster, mixed = fitting_raster(certificate)
    kept = kept_witnesses(certificate, raster)
    worst = np.searchsorted(kept, certificate.worst())
    setting = certificate.setting
    return {
        "statuses": list(STATUSES),
        "grid": {
            "shape": list(raster.volumes.shape[2:]),
            "slices": raster.volumes.shape[1],
            "origin": raster.origin.tolist(),
            "size": raster.size.tolist(),
        },
        "places": {
            "kind": pack(_kinds(raster, mixed), "uint8"),
            "free": pack(is_free(certificate, raster), "uint8"),
            "mixed": pack(mixed, "uint32"),
            "share": pack(_shares(raster, mixed), "uint8"),
        },
        "witnesses": _witnesses(certificate, kept),
        "worst": worst.tolist(),
        "goal": list(certificate.scenario.goal),
        "channels": channel_list(setting.spec, setting.radii),
        "fans": fans_of(setting.spec, certificate.world_map.robot),
        "rules": rules_of(certificate.rules),
        "world": _world(certificate),
        "scale": [int(colour[1:], 16) for colour in Viridis256],
    }


def _world(certificate: Certificate) -> dict[str, Any]:
    """Return what of the map and the scenario has corners or a radius."""
    fixed, own = world_of(certificate.world_map), shapes(certificate.scenario.obstacles)
    return {kind: [*fixed[kind], *own[kind]] for kind in fixed}


def fitting_raster(certificate: Certificate, most: int = MOST_BYTES) -> tuple[Raster, Indices]:
    """Return the finest raster that fits into a page, and its squares that are not of one status throughout."""
    raster = certificate.raster
    while True:
        whole = raster.volumes.sum(axis=1).reshape(len(STATUSES), -1)
        square = 2.0 * np.pi * float(np.prod(raster.size))
        pure = (np.abs(whole - square) < 1e-9 * square).any(axis=0) | (whole.sum(axis=0) <= 0.0)
        mixed = np.flatnonzero(~pure)
        fits = len(mixed) * raster.volumes[:, :, 0, 0].size <= most
        if fits or raster.volumes.shape[2:] == tuple(certificate.lattice.count[:2]):
            return raster, mixed
        raster = certificate.raster_within(int(np.prod(raster.volumes.shape[1:])) // 2)


def _kinds(raster: Raster, mixed: Indices) -> Indices:
    """Return the one status of each square, or that it is mixed or was not examined, (X Y,)."""
    volumes = raster.volumes.sum(axis=1).reshape(len(STATUSES), -1)
    kinds = np.where(volumes.sum(axis=0) > 0.0, volumes.argmax(axis=0), _UNEXAMINED)
    kinds[mixed] = _MIXED
    return np.asarray(kinds)


def _shares(raster: Raster, mixed: Indices) -> Floats:
    """Return the shares of the statuses in 255ths, rounded down, (M, S, 5); what is missing was not examined."""
    kinds, slices = raster.volumes.shape[:2]
    volumes = raster.volumes.reshape(kinds, slices, -1)[:, :, mixed]
    whole = 2.0 * np.pi * float(np.prod(raster.size)) / slices
    return np.asarray(np.floor(255.0 * np.minimum(volumes / whole, 1.0) + 1e-6).transpose(2, 1, 0))


def kept_witnesses(certificate: Certificate, raster: Raster, most: int = MOST_WITNESSES) -> Indices:
    """Choose the counterexamples that the page holds: the worst of each square and eighth of a turn.

    Squares are those of the raster, or larger ones where there were too many; the worst places are always among them.
    """
    poses = certificate.findings.pose
    turn = np.floor((poses[:, 2] + np.pi) / (2.0 * np.pi) * SECTORS).astype(np.int64) % SECTORS
    side = float(raster.size.max())
    while True:
        square = np.floor((poses[:, :2] - raster.origin) / side).astype(np.int64)
        groups = (square[:, 0] * 2**20 + square[:, 1]) * SECTORS + turn
        if len(np.unique(groups)) <= most:
            return np.unique(np.concatenate([certificate.nearest_of(groups), certificate.worst()]))
        side *= 2.0


def _witnesses(certificate: Certificate, kept: Indices) -> dict[str, Any]:
    found = certificate.findings
    return {
        "pose": pack(found.pose[kept], "float32"),
        "previous": pack(_as_command(certificate, found.previous[kept]), "float32"),
        "action": pack(found.action[kept], "float32"),
        "closest": pack(found.closest[kept], "float32"),
        "seconds": pack(found.seconds[kept], "float32"),
        "clearance": pack(found.clearance[kept], "float32"),
        "observation": pack_coarsely(found.observation[kept].astype(np.float64)),
    }


def _as_command(certificate: Certificate, before: Floats) -> Floats:
    """Return what stood before counterexamples in the columns of a command (W, A): speeds of the motion as speeds."""
    kinematics = certificate.rules.kinematics
    if not kinematics.state:
        return before
    told = np.zeros((len(before), len(kinematics.axes)))
    for number, axis in enumerate(kinematics.state):
        if axis.kind in ("linear", "angular"):
            told[:, ("linear", "angular").index(axis.kind)] = before[:, number]
    return told
