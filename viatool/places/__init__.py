"""Certified places: proofs for every pose of a map, not only for visited states."""

from __future__ import annotations

from viatool.places.campaign import SearchBudget
from viatool.places.certificate import SECTOR_NAMES, SECTORS, Certificate
from viatool.places.findings import STATUSES, CellFindings
from viatool.places.job import Resolution, certify
from viatool.places.lasting import LastingCells, Lookahead
from viatool.places.raster import Raster
from viatool.schedule import Campaign

__all__ = [
    "SECTORS",
    "SECTOR_NAMES",
    "STATUSES",
    "Campaign",
    "CellFindings",
    "Certificate",
    "LastingCells",
    "Lookahead",
    "Raster",
    "Resolution",
    "SearchBudget",
    "certify",
]
