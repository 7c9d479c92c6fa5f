"""SARIF 2.1.0, for code-scanning dashboards: one result for each half metre square that holds a counterexample."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from viatool.places import STATUSES
from viatool.report.certificates.document import read_certificate
from viatool.report.certificates.places import TILE, tile_of
from viatool.report.numbers import counted, significant
from viatool.report.sarif_log import GATE, Finding, compose_log

if TYPE_CHECKING:
    from viatool.places import Certificate
    from viatool.report.gate import Check

SUFFIXES = (".sarif", ".json")
RULES = {
    "refuted-place": (
        "error",
        "From a pose there, a sensor error within eps makes the policy violate the criterion.",
    ),
    "unknown-place": ("warning", "For some poses there the criterion could be neither proved nor refuted."),
    **GATE,
}


def render(certificate: Certificate, checks: Sequence[Check], suffix: str) -> str:
    """Return the log; failed conditions of the gate, then refuted places, the worst first, then unknown ones."""
    refuted, unknown = list(_refuted(certificate)), list(_unknown(certificate))
    return compose_log(
        read_certificate(certificate), RULES, checks, [*refuted, *unknown], len(refuted) + len(unknown)
    )


def _refuted(certificate: Certificate) -> Iterator[Finding]:
    found, tiles = certificate.findings, tile_of(certificate.findings.pose[:, :2])
    group = np.unique(tiles, axis=0, return_inverse=True)[1].reshape(-1)
    cells = np.bincount(group)
    for row in certificate.nearest_of(group):
        (x, y, theta), (before, turning), (v, omega) = found.pose[row], found.previous[row], found.action[row]
        text = (
            f"{_name(tiles[row])}: {counted(int(cells[group[row]]), 'cell')} refuted. At x {x:.3f} m, y {y:.3f} m, "
            f"heading {theta:.3f} rad, after {before:.2f} m/s and {turning:.2f} rad/s, a sensor error within eps makes "
            f"the policy command {v:.3f} m/s and {omega:.3f} rad/s, which comes within {found.clearance[row]:.3f} m of "
            f"something after {found.seconds[row]:.2f} s."
        )
        yield _finding(certificate, "refuted-place", text, tiles[row])


def _unknown(certificate: Certificate) -> Iterator[Finding]:
    raster = certificate.raster
    volumes = raster.volumes[STATUSES.index("unknown")].sum(axis=0).reshape(-1)
    tiles, group = np.unique(tile_of(raster.middles.reshape(-1, 2)), axis=0, return_inverse=True)
    unknown = np.bincount(group.reshape(-1), weights=volumes)
    for place in np.argsort(-unknown, kind="stable"):
        if unknown[place] > 0.0:
            text = (
                f"{_name(tiles[place])}: {significant(unknown[place])} m² rad are neither proved nor refuted."
            )
            yield _finding(certificate, "unknown-place", text, tiles[place])


def _name(tile: NDArray[np.int64]) -> str:
    (x, y), (far_x, far_y) = TILE * tile, TILE * (tile + 1)
    return f"x {x:g} to {far_x:g} m, y {y:g} to {far_y:g} m"


def _finding(certificate: Certificate, rule: str, text: str, tile: NDArray[np.int64]) -> Finding:
    place = f"{certificate.scenario.name}/{_name(tile)}"
    return Finding(rule, text, place, place)
