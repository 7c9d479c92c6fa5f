"""Specifications proposed for policies that have none, with everything that was guessed said."""

from __future__ import annotations

from viatool.proposals.by_size import propose_by_size
from viatool.proposals.parameters import with_limits
from viatool.proposals.proposal import FILL_IN, Guess, PolicyFacts, Proposal
from viatool.proposals.propose import propose, specification_text
from viatool.proposals.remembered import describe_with_memory
from viatool.proposals.scanner import Scanner, with_kinds, with_scanner

__all__ = [
    "FILL_IN",
    "Guess",
    "PolicyFacts",
    "Proposal",
    "Scanner",
    "describe_with_memory",
    "propose",
    "propose_by_size",
    "specification_text",
    "with_kinds",
    "with_limits",
    "with_scanner",
]
