"""Specifications proposed for policies that have none, with everything that was guessed said."""

from __future__ import annotations

from viatool.proposals.by_size import propose_by_size
from viatool.proposals.proposal import FILL_IN, Guess, PolicyFacts, Proposal
from viatool.proposals.propose import propose, specification_text
from viatool.proposals.remembered import describe_with_memory

__all__ = [
    "FILL_IN",
    "Guess",
    "PolicyFacts",
    "Proposal",
    "describe_with_memory",
    "propose",
    "propose_by_size",
    "specification_text",
]
