"""All cells of a map in random order, as work for the driver of long work, and when to stop."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Indices
from viatool.errors import ConfigurationError
from viatool.loop.closed_loop import ClosedLoop
from viatool.places.findings import CellFindings
from viatool.places.search import search
from viatool.places.tree import Lattice
from viatool.schedule import NEVER, Deadline, EvenWork, Span, digest_of
from viatool.versions import result_versions
from viatool.world import Scenario

_MOST_ROOTS = 20_000_000


@dataclass(frozen=True)
class SearchBudget:
    """When to stop; what was not examined then is counted apart.

    Parameters
    ----------
    until : Deadline
        When the time is up: ``Deadline.after(60.0)`` is a minute from now, for all that is asked.
    cells : int
        Leaves.
    share : float
        Of the roots, drawn at random: an unbiased estimate of the whole.
    """

    until: Deadline = NEVER
    cells: int = 2**62
    share: float = 1.0


@dataclass(frozen=True, eq=False)
class RootExamination:
    """What happens to a piece of the roots; a pure function that workers can be sent.

    Parameters
    ----------
    loop, lattice, seed
        As in `search`.
    """

    loop: ClosedLoop
    lattice: Lattice
    seed: int

    def __call__(self, roots: Indices) -> CellFindings:
        """Judge the cells of roots, (R,) by number."""
        return search(self.loop, self.lattice, self.lattice.roots().select(roots), seed=self.seed)


@dataclass(frozen=True, eq=False)
class RootWork(EvenWork[Indices, CellFindings]):
    """The examination of roots in random order, so that the first ones are a fair sample; a unit is a root.

    Parameters
    ----------
    examination : RootExamination
        What happens to a piece.
    share : float
        Of all roots.
    about : mapping
        What the findings depend on, see `describe`.

    Raises
    ------
    ConfigurationError
        If there are too many roots.
    """

    examination: RootExamination
    share: float
    about: Mapping[str, Any]
    stage = "roots"
    piece = 512  # the search for counterexamples draws for many cells at once

    @cached_property
    def order(self) -> Indices:
        """Return the numbers of the roots, (R,)."""
        count = int(np.prod(self.examination.lattice.count))
        if count > _MOST_ROOTS:
            raise ConfigurationError(f"{count:,} roots are too many", "make the smallest cells larger")
        order = np.random.default_rng(self.examination.seed).permutation(count)
        return order[: max(1, math.ceil(self.share * count))]

    def __len__(self) -> int:
        """Return R."""
        return len(self.order)

    @property
    def function(self) -> RootExamination:
        """Return what happens to a piece."""
        return self.examination

    def content(self, span: Span) -> Indices:
        """Return the numbers of some roots."""
        return np.sort(self.order[span.first : span.last])

    def describe(self) -> Mapping[str, Any]:
        """Return what the findings depend on."""
        return self.about

    def to_arrays(self, part: CellFindings) -> dict[str, NDArray[Any]]:
        """Return findings as arrays."""
        return part.to_arrays()

    def from_arrays(self, arrays: Mapping[str, NDArray[Any]]) -> CellFindings:
        """Return findings."""
        return CellFindings.from_arrays(arrays)

    def join(self, parts: Sequence[CellFindings]) -> CellFindings:
        """Return the findings of several pieces as one."""
        return CellFindings.join(parts)


def describe(examination: RootExamination, scenario: Scenario) -> dict[str, Any]:
    """Return everything that the findings depend on, as plain data for the manifest of a checkpoint."""
    loop = examination.loop
    policy, setting = loop.policy, loop.setting
    world_map, meaning = setting.world_map, setting.spec.model_dump_json()
    return {
        "policy": policy.sha256,
        "network": digest_of((policy.network, policy.rewritten, meaning)),
        "map": digest_of((world_map.arena, world_map.obstacles, scenario.obstacles)),
        "goal": list(scenario.goal),
        "rules": setting.rules.to_json(),
        "radii": setting.radii.tolist(),
        "errors": setting.uncertainty.exactly(),
        "arithmetic": loop.arithmetic,
        "cells": {name: np.asarray(part).tolist() for name, part in vars(examination.lattice).items()},
        "seed": examination.seed,
        **{f"version of {name}": text for name, text in result_versions().items()},
    }
