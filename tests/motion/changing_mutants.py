"""Faults of sets of states of robots whose velocity changes, to be planted where runs have to catch them."""

from __future__ import annotations

from viatool.motion import straight
from viatool.motion.signals import IntegratedSignal


def velocity_that_is_not_carried(patch):
    right = IntegratedSignal.form

    def wrong(self, held, ends, time):
        return right(self, held, ends, 0.0)

    patch.setattr(IntegratedSignal, "form", wrong)


def heading_that_is_frozen(patch):
    right = straight._Centre.gradient

    def wrong(self, *given):
        found = right(self, *given)
        found[:, 0] = 0.0
        return found

    patch.setattr(straight._Centre, "gradient", wrong)
