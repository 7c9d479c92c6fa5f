"""Certified places: proofs for every pose of a map, not only for visited states."""

from __future__ import annotations

from viatool.certify.campaign import Budget, Campaign
from viatool.certify.certificate import SECTOR_NAMES, SECTORS, Certificate
from viatool.certify.findings import STATUSES, Findings
from viatool.certify.job import Resolution, certify
from viatool.certify.over_time import Outlook, Prospect
from viatool.certify.raster import Raster

__all__ = [
    "SECTORS",
    "SECTOR_NAMES",
    "STATUSES",
    "Budget",
    "Campaign",
    "Certificate",
    "Findings",
    "Outlook",
    "Prospect",
    "Raster",
    "Resolution",
    "certify",
]
