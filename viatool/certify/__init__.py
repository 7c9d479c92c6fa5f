"""Certified places: proofs for every pose of a map, not only for visited states."""

from __future__ import annotations

from viatool.certify.campaign import Budget, Campaign
from viatool.certify.certificate import Certificate
from viatool.certify.findings import STATUSES, Findings
from viatool.certify.job import Resolution, certify

__all__ = ["STATUSES", "Budget", "Campaign", "Certificate", "Findings", "Resolution", "certify"]
