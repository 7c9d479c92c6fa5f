"""All cells of a map: cut into pieces, carried out by a scheduler within a budget, kept in a checkpoint."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from viatool.arrays import Indices
from viatool.errors import ConfigurationError
from viatool.loop.question import Question
from viatool.places.findings import Findings
from viatool.places.search import search
from viatool.places.tree import Lattice
from viatool.schedule import Checkpoint, Piece, Scheduler, Serial, cut, digest_of
from viatool.versions import result_versions
from viatool.world import Scenario

Tell = Callable[[str, int, int], None]

_ROOTS_AT_ONCE = 512
"""Of a piece; always the same, as the search for counterexamples draws for many cells at once."""
_MOST_ROOTS = 20_000_000


@dataclass(frozen=True)
class Budget:
    """When to stop; what was not examined then is counted apart.

    Parameters
    ----------
    seconds : float
        Wall-clock time.
    cells : int
        Leaves.
    share : float
        Of the roots, drawn at random: an unbiased estimate of the whole.
    """

    seconds: float = math.inf
    cells: int = 2**62
    share: float = 1.0


@dataclass(frozen=True, eq=False)
class Inspection:
    """What happens to a piece of the roots; a pure function that workers can be sent.

    Parameters
    ----------
    question, lattice, seed
        As in `search`.
    """

    question: Question
    lattice: Lattice
    seed: int

    def __call__(self, roots: Indices) -> Findings:
        """Judge the cells of roots, (R,) by number."""
        return search(self.question, self.lattice, self.lattice.roots().select(roots), seed=self.seed)


@dataclass(frozen=True)
class Campaign:
    """Who does the work, and where it is kept.

    Parameters
    ----------
    scheduler : Scheduler
        Here, in processes or on a cluster.
    checkpoint : path, optional
        Folder that keeps what is finished.
    resume : bool
        Whether to continue from it.
    """

    scheduler: Scheduler = field(default_factory=Serial)
    checkpoint: str | os.PathLike[str] | None = None
    resume: bool = False

    def carry_out(
        self, inspection: Inspection, budget: Budget, about: Mapping[str, Any], tell: Tell | None
    ) -> tuple[Findings, int]:
        """Examine roots in random order, so that what is done when the budget ends is a fair sample.

        Returns
        -------
        tuple
            The findings, the same for every scheduler, and the number of roots that were examined.
        """
        count = int(np.prod(inspection.lattice.count))
        if count > _MOST_ROOTS:
            raise ConfigurationError(f"{count:,} roots are too many", "make the smallest cells larger")
        order = np.random.default_rng(inspection.seed).permutation(count)
        order = order[: max(1, math.ceil(budget.share * count))]
        store = None
        if self.checkpoint is not None:
            store = Checkpoint(self.checkpoint, about, resume=self.resume)
        stored = [] if store is None else [kept for kept in store.finished() if kept[0].last <= len(order)]
        found = {span: Findings.from_arrays(arrays) for span, arrays in stored}
        spans = cut(len(order), found, _ROOTS_AT_ONCE)
        pieces = (
            Piece(s, f"roots {s.first:,} to {s.last - 1:,}", np.sort(order[s.first : s.last])) for s in spans
        )
        start = time.perf_counter()
        for piece, part in self.scheduler.run(inspection, pieces):
            if store is not None:
                store.write(piece.span, part.to_arrays(), piece.name)
            found[piece.span] = part
            if tell is not None:
                tell("roots", sum(map(len, found)), len(order))
            leaves = sum(map(len, found.values()))
            if leaves >= budget.cells or time.perf_counter() - start > budget.seconds:
                break
        return Findings.join([found[span] for span in sorted(found)]), sum(map(len, found))


def describe(inspection: Inspection, scenario: Scenario) -> dict[str, Any]:
    """Return everything that the findings depend on, as plain data for the manifest of a checkpoint."""
    question = inspection.question
    policy, setting = question.policy, question.setting
    world_map, meaning = setting.world_map, setting.spec.model_dump_json()
    return {
        "policy": policy.sha256,
        "network": digest_of((policy.network, meaning)),
        "map": digest_of((world_map.arena, world_map.obstacles, scenario.obstacles)),
        "goal": list(scenario.goal),
        "rules": json.loads(json.dumps(asdict(setting.rules), default=lambda array: array.tolist())),
        "radii": setting.radii.tolist(),
        "arithmetic": question.arithmetic,
        "cells": {name: part.tolist() for name, part in vars(inspection.lattice).items()},
        "seed": inspection.seed,
        **{f"version of {name}": text for name, text in result_versions().items()},
    }
