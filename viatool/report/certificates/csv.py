"""Places as a table for spreadsheets: what became of the free volume of each, and its safe share by heading."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from viatool.places import SECTOR_NAMES, STATUSES
from viatool.report.csv_table import table

if TYPE_CHECKING:
    from viatool.places import Certificate, Raster
    from viatool.report.gate import Check

SUFFIXES = (".csv",)
COLUMNS = ("x", "y", *STATUSES[1:], "safe", *(f"safe_{name}" for name in SECTOR_NAMES))


def render(certificate: Certificate, checks: Sequence[Check], suffix: str) -> Iterator[str]:
    """Yield a row for each place with free volume: its middle in m, volumes in m^2 rad, and safe shares."""
    return table(COLUMNS, _rows(certificate.sectors))


def _rows(raster: Raster) -> Iterator[Sequence[str]]:
    free, safe = raster.volumes[1:].sum(axis=0), raster.volumes[1:3].sum(axis=0)  # (S, X, Y)
    overall = raster.safe_share()
    by_heading = np.where(free > 0.0, safe / np.where(free > 0.0, free, 1.0), np.nan)
    for x, y in np.argwhere(free.sum(axis=0) > 0.0).tolist():
        volumes = raster.volumes[1:, :, x, y].sum(axis=1)
        middle = raster.origin + raster.size * (x + 0.5, y + 0.5)
        shares = (overall[x, y], *by_heading[:, x, y])
        yield [
            *(f"{number:.9g}" for number in (*middle, *volumes)),
            *("" if np.isnan(share) else f"{share:.6g}" for share in shares),
        ]
