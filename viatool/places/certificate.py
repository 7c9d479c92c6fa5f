"""What a certification found: volumes by status, a raster of places, and the worst counterexamples."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Indices
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.deceived import Deceptions, errors_of
from viatool.loop.vicinity import Vicinity
from viatool.places.findings import REFUTED, SETTLED, STATUSES, UNKNOWN, CellFindings
from viatool.places.lasting import LastingCells
from viatool.places.raster import Raster, rasterise
from viatool.places.so_far import CellsKnown, volume_of
from viatool.places.tree import AXES, Lattice
from viatool.policy import Policy
from viatool.safety import JudgedStates, Witnesses
from viatool.setting.asked import Asked
from viatool.setting.error_costs import ErrorCosts
from viatool.setting.setting import Setting
from viatool.simulate import NavigationTask
from viatool.world import Scenario

SCHEMA_VERSION = 1
SECTORS = 8
"""Parts of a turn that have names."""
SECTOR_NAMES = ("W-SW", "SW-S", "S-SE", "SE-E", "E-NE", "NE-N", "N-NW", "NW-W")
"""From theta = -pi on, with north along y."""
_SLICES = 12
_SPACING = 0.5
"""Metres between the worst places."""
_MOST_VOLUMES = 8_000_000
"""Of places times slices, so that the volumes of five statuses take some 300 MB at most."""


@dataclass(frozen=True, eq=False)
class Certificate(Asked):
    """The outcome of one certification.

    Parameters
    ----------
    policy : Policy
        What was certified.
    setting : Setting
        What was asked, as it took effect.
    scenario : Scenario
        Among which obstacles and towards which goal.
    arithmetic : str
        "float32" or "real", the contract of the bounds.
    lattice : Lattice
        The cells.
    findings : CellFindings
        The leaves that were examined.
    examined, roots : int
        Roots of the tree that were examined, and all.
    seconds, versions : dict
        Time by stage, and what a repetition would need.
    lasting : LastingCells, optional
        What holds beyond the next action, if it was asked.
    error_costs : ErrorCosts, optional
        What each error costs, in leaves, if it was asked.
    unjudged : int
        The volume in smallest cells of roots that nobody examined, as it was enough: it counts into nothing.
    """

    policy: Policy
    setting: Setting
    scenario: Scenario
    arithmetic: str
    lattice: Lattice
    findings: CellFindings
    examined: int
    roots: int
    seconds: Mapping[str, float]
    versions: Mapping[str, str]
    lasting: LastingCells | None = None
    error_costs: ErrorCosts | None = None
    unjudged: int = 0

    @cached_property
    def units(self) -> dict[str, int]:
        """Return the volume of each status in smallest cells, as integers."""
        return dict(zip(STATUSES, volume_of(self.lattice, self.findings).tolist(), strict=True))

    @property
    def _known(self) -> CellsKnown:
        """Return the volumes of what was examined."""
        cells = np.bincount(self.findings.status, minlength=len(STATUSES)).tolist()
        return CellsKnown(self.units, cells[REFUTED], cells[UNKNOWN], self.unjudged)

    @property
    def unit(self) -> float:
        """Return the volume of a smallest cell in m^2 rad, times its share of the commands' range."""
        return float(np.prod(self.lattice.size[:3]) * np.exp2(-float(self.lattice.deepest.sum())))

    @property
    def contested(self) -> tuple[int, int]:
        """Return the certified and all of the contested volume; what was not examined is not in it."""
        return self._known.contested

    @property
    def free(self) -> tuple[int, int]:
        """Return the safe and all of the free volume: uncontested or certified, and these with the rest."""
        return self._known.free

    @property
    def decided(self) -> tuple[int, int]:
        """Return the certified or refuted, and all of the contested volume."""
        units, (_, contested) = self.units, self.contested
        return units["certified"] + units["refuted"], contested

    @cached_property
    def raster(self) -> Raster:
        """Return the volume of each status in each place and slice of headings."""
        return self.raster_within(_MOST_VOLUMES)

    @cached_property
    def sectors(self) -> Raster:
        """Return the volume of each status in each place and eighth of a turn."""
        return self.raster.gathered(SECTORS)

    def raster_within(self, most: int) -> Raster:
        """Return the volumes in places that are cells of the grain, or larger ones where there were too many."""
        return rasterise(self.lattice, self.findings, _SLICES, most)

    def nearest_of(self, groups: Indices) -> Indices:
        """Return the counterexample of each group (R,) that comes nearest to something, the nearest one first."""
        order = np.argsort(self.findings.clearance, kind="stable")
        _, first = np.unique(groups[order], return_index=True)
        return np.asarray(order[np.sort(first)])

    def witnesses(self, rows: Indices) -> Witnesses:
        """Return some of the counterexamples, (W,), with what has moved in them."""
        found, rules = self.findings, self.rules
        pose, action = found.pose[rows], found.action[rows]
        seen = Witnesses.among_what_stands(
            rows, found.observation[rows].astype(np.float64), action, found.seconds[rows], found.closest[rows],
            found.clearance[rows], pose, found.believed[rows],
        )  # fmt: skip
        seen = replace(seen, turn=found.turn[rows], passed=found.passed[rows])
        around = Vicinity.of(self.world_map, self.scenario, self.setting.uncertainty).everything
        if not around.movers or not len(rows):
            return seen
        judged = JudgedStates(rules, around.throughout(pose), rules.queue(found.previous[rows]))
        return seen.among(judged.nearest_movers(action))

    def errors_of(self, rows: Indices) -> list[dict[str, Any]]:
        """Return which errors make the observations of some counterexamples, as witness files say them."""
        found, episode = self.findings, NavigationTask().horizon
        loop = ClosedLoop.of(self.policy, self.setting, self.scenario, episode=episode)
        deceived = Deceptions(found.believed[rows], found.turn[rows], found.passed[rows])
        seen = found.observation[rows].astype(np.float64)
        return errors_of(loop, found.pose[rows], found.previous[rows], deceived, seen)

    def worst(self, most: int = 10) -> Indices:
        """Return the counterexamples that come nearest to something, in places at least half a metre apart."""
        order = np.argsort(self.findings.clearance, kind="stable")
        places = self.findings.pose[:, :2]
        chosen: list[int] = []
        while len(order) and len(chosen) < most:
            chosen.append(int(order[0]))
            apart = np.abs(places[order] - places[order[0]]).max(axis=1) >= _SPACING
            order = order[apart]
        return np.array(chosen, dtype=np.int64)

    def to_json(self) -> dict[str, Any]:
        """Return the certificate as plain data."""
        status, unit = self.findings.status, self.unit
        lower, upper = self.rules.lower, self.rules.upper
        certified, contested = self.contested
        safe, free = self.free
        decided, _ = self.decided
        size = self.lattice.size * np.exp2(-self.lattice.deepest.astype(np.float64))
        return {
            "schema_version": SCHEMA_VERSION,
            "policy": {"path": str(self.policy.path), "sha256": self.policy.sha256},
            "map": {"path": str(self.world_map.path), "sha256": self.world_map.sha256},
            "scenario": {"name": self.scenario.name, "goal": list(self.scenario.goal)},
            "eps": self.eps,
            "criterion": self.rules.criterion,
            "clearance": self.rules.clearance.collision,
            "deceleration": self.rules.manoeuvre.deceleration,
            "delay": self.rules.delay,
            "arithmetic": self.arithmetic,
            "previous_command": {"lower": lower.tolist(), "upper": upper.tolist()},
            **self._state,
            "smallest_cell": dict(zip(self._names, size.tolist(), strict=False)),
            "roots": {"examined": self.examined, "total": self.roots},
            **self._not_judged,
            "cells": {name: int((status == kind).sum()) for kind, name in enumerate(STATUSES)},
            "volume": {name: units * unit for name, units in self.units.items()},
            "contested_rate": _rate(certified, contested),
            "free_rate": _rate(safe, free),
            "decided_rate": _rate(decided, contested),
            "over_time": None if self.lasting is None else self.lasting.to_json(),
            "worst": self._worst_json(),
            **({} if self.error_costs is None else {"error_costs": self._costs(self.error_costs)}),
            "seconds": dict(self.seconds),
            "versions": dict(self.versions),
            "premises": [premise.to_json() for premise in self.premises],
        }

    @property
    def _not_judged(self) -> dict[str, Any]:
        """Return how many roots were left out, and their volume; nothing if none was."""
        left = {"overall": self.roots - self.examined, "smallest_cells": self.unjudged}
        return {"not_judged": left} if self.unjudged else {}

    @property
    def _names(self) -> tuple[str, ...]:
        """Return what the axes of cells are called; of two that are not cut along a second number, four."""
        state = self.rules.kinematics.state
        return ("x", "y", "theta", *(axis.name for axis in state)) if state else AXES

    @property
    def _state(self) -> dict[str, Any]:
        """Return what the cells hold behind the pose, of a robot whose motion has a state."""
        kinematics = self.rules.kinematics
        if not kinematics.state:
            return {}
        lower, upper = kinematics.state_range
        return {
            "state": {
                "command": [f"{axis.name} {axis.unit}" for axis in kinematics.axes],
                "axes": [f"{axis.name} {axis.unit}" for axis in kinematics.state],
                "lower": lower.tolist(),
                "upper": upper.tolist(),
            }
        }

    def _costs(self, costs: ErrorCosts) -> dict[str, Any]:
        """Return what errors cost, with the share of the contested volume: what is not certified is of one size."""
        told = costs.to_json("cells")
        whole = len(costs.rows) * self.contested[1]
        for one in told["terms"]:
            one["share"] = one["cells"] * costs.not_proved / whole if whole else 0.0
        return told

    def _worst_json(self) -> list[dict[str, Any]]:
        """Return the worst counterexamples, with what they come near to and which error each would save."""
        rows = self.worst()
        seen, footprint, costs = self.witnesses(rows), self.rules.footprint, self.error_costs
        told = [self._witness(row) for row in rows.tolist()]
        for place, one in enumerate(told):
            closest = seen.violation(place, self.world_map, self.scenario, footprint)["closest"]
            one["obstacle"] = closest["obstacle"]
        if costs is not None:
            leaves = np.flatnonzero(self.findings.status == REFUTED)[rows]
            names = costs.column(len(self.findings))
            for leaf, one in zip(leaves.tolist(), told, strict=True):
                if leaf in costs.rows:
                    one["saved_by"] = [name for name in str(names[leaf]).split(",") if name]
        return told

    def _witness(self, row: int) -> dict[str, Any]:
        found = self.findings
        return {
            "pose": found.pose[row].tolist(),
            "previous": found.previous[row].tolist(),
            "action": found.action[row].tolist(),
            "clearance": float(found.clearance[row]),
            "seconds": float(found.seconds[row]),
        }

    def cell_table(self) -> dict[str, NDArray[Any]]:
        """Return all leaves with their bounds, for other programs."""
        keep = self.findings.status >= SETTLED
        lower, upper = self.lattice.bounds(self.findings.nodes.select(keep))
        names = np.array(STATUSES)
        later = {} if self.lasting is None else self.lasting.cell_table()
        costs = self.error_costs
        return {
            **later,
            **({} if costs is None else {"fails_by": costs.column(len(keep))[keep]}),
            "lower": lower,
            "upper": upper,
            "status": names[self.findings.status[keep]],
            "witness_pose": self.findings.pose,
            "witness_previous": self.findings.previous,
            "witness_observation": self.findings.observation,
            "witness_believed": self.findings.believed,
        }


def _rate(part: int, total: int) -> dict[str, int | float | None]:
    return {"part": part, "total": total, "rate": part / total if total else None}
