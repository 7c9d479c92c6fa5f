"""The report on places while the certificate is at hand: slices by heading, findings by place, tables, pictures."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from viatool.places import SECTOR_NAMES, STATUSES
from viatool.report.document import Cased, CellTabled, Drawn, Explorable, Located, Replayable, Tabled
from viatool.report.numbers import counted, significant
from viatool.report.places.document import PlacesDocument
from viatool.report.places.tiles import TILE, tile_of
from viatool.report.sections import Case, Check, Finding, Key, Rules

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from viatool.arrays import Floats
    from viatool.motion.law import Axis
    from viatool.places import Certificate, Raster
    from viatool.places.lasting import LastingCells

COLUMNS = ("x", "y", *STATUSES[1:], "safe", *(f"safe_{name}" for name in SECTOR_NAMES))
_MOST_WITNESSES = 1000
_COUNTED = {
    "unsafe": ("refuted-place",),
    "unknown": ("unknown-place",),
    **dict.fromkeys(("contested", "overall"), ("refuted-place", "unknown-place")),
}
"""The rules of the findings that each rate misses, and each limit counts."""


class PlacesRun(PlacesDocument, Cased, Located, Tabled, Drawn, Explorable, Replayable, CellTabled):
    """The report of a certificate."""

    STYLE: ClassVar[Mapping[Any, Any]] = {"svg.fonttype": "none", "font.size": 8}
    FINDING_RULES: ClassVar[Rules] = {
        "refuted-place": (
            "warning",
            "From a pose there, a sensor error within eps makes the policy violate the criterion.",
        ),
        "unknown-place": (
            "note",
            "For some poses there the criterion could be neither proved nor refuted.",
        ),
        "lost-place": ("note", "From some poses there it is not proved what the gate asks for."),
    }

    def __init__(self, certificate: Certificate) -> None:
        super().__init__(certificate.to_json())
        self.certificate = certificate

    def cases(self) -> Sequence[Case]:
        """Return every slice by heading, with the half metre squares in which it is not safe."""
        raster = self.certificate.sectors
        volumes = np.moveaxis(raster.volumes, 0, 1)  # (sectors, statuses, X, Y)
        every = [
            _slice(name, part.sum(axis=(1, 2)).tolist(), [*_squares(raster, part)])
            for name, part in zip(SECTOR_NAMES, volumes, strict=True)
        ]
        if not self.left_out:
            return every
        partly: Mapping[str, Any] = {"outcome": "skipped", "message": "not all of it was judged"}
        return [replace(case, **partly) if case.outcome == "passed" else case for case in every]

    def findings(self) -> tuple[Iterable[Finding], int]:
        """Return each half metre square with a counterexample, the worst first, then those with unknown volume."""
        found = [*self._refuted(), *self._unknown()]
        return found, len(found)

    def _refuted(self) -> Iterator[Finding]:
        found, tiles = self.certificate.findings, tile_of(self.certificate.findings.pose[:, :2])
        group = np.unique(tiles, axis=0, return_inverse=True)[1].reshape(-1)
        cells = np.bincount(group)
        plain = not self.certificate.setting.uncertainty
        errors = "a sensor error within eps makes" if plain else "errors within the model make"
        for row in self.certificate.nearest_of(group):
            x, y, theta = found.pose[row]
            kinematics = self.certificate.rules.kinematics
            before = _told(kinematics.before, found.previous[row], 2)
            sent = _told(kinematics.axes, found.action[row], 3)
            text = (
                f"{_name(tiles[row])}: {counted(int(cells[group[row]]), 'cell')} refuted. At x {x:.3f} m, "
                f"y {y:.3f} m, heading {theta:.3f} rad, {'with' if kinematics.state else 'after'} {before}, "
                f"{errors} the policy command {sent}, which comes within "
                f"{found.clearance[row]:.3f} m of something after {found.seconds[row]:.2f} s."
            )
            yield self._finding("refuted-place", text, tiles[row], int(cells[group[row]]))

    def _unknown(self) -> Iterator[Finding]:
        raster = self.certificate.raster
        volumes = raster.volumes[STATUSES.index("unknown")].sum(axis=0).reshape(-1)
        tiles, group = np.unique(tile_of(raster.middles.reshape(-1, 2)), axis=0, return_inverse=True)
        unknown = np.bincount(group.reshape(-1), weights=volumes)
        for place in np.argsort(-unknown, kind="stable"):
            if unknown[place] > 0.0:
                volume = significant(unknown[place])
                text = f"{_name(tiles[place])}: {volume} m² rad are neither proved nor refuted."
                yield self._finding("unknown-place", text, tiles[place])

    def counted(self, name: str) -> Iterator[Finding]:
        """Return the half metre squares that a rate misses some of, or a limit counts."""
        if name in _COUNTED:
            yield from (found for found in self.findings()[0] if found.rule in _COUNTED[name])
        elif self.certificate.lasting is not None:
            yield from self._lost(self.certificate.lasting, name)

    def _lost(self, cells: LastingCells, name: str) -> Iterator[Finding]:
        """Return each half metre square with free cells that do not last, or arrive; the largest part first."""
        lasts = cells.arriving if name == "arrive" else cells.for_ever
        lower, upper = cells.mesh.bounds(np.flatnonzero(cells.free & ~lasts))
        lost, number = np.unique(tile_of(0.5 * (lower + upper)[:, :2]), axis=0, return_counts=True)
        for place in np.argsort(-number, kind="stable"):
            text = f"{_name(lost[place])}: {counted(int(number[place]), 'cell')} without it."
            yield self._finding("lost-place", text, lost[place])

    def _finding(self, rule: str, text: str, tile: NDArray[np.int64], cells: int = 0) -> Finding:
        """Return a finding of so many refuted cells; of unknown volume, that no limit counts cell by cell."""
        scenario = self.certificate.scenario.name
        place = f"{scenario}/{_name(tile)}"
        verdict, takes = ("unsafe", {"unsafe": cells}) if cells else ("unknown", {})
        return Finding(
            rule, text, place, place, verdict, scenario, None, takes, cells or 1, (rule, tuple(tile.tolist()))
        )

    def columns(self) -> Sequence[str]:
        """Return the middle of a place in m, volumes in m^2 rad, and safe shares."""
        return COLUMNS

    def rows(self) -> Iterator[Sequence[object]]:
        """Yield a row for each place with free volume."""
        raster = self.certificate.sectors
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

    def row_keys(self) -> Iterator[Collection[Key]]:
        """Yield the findings that are in the half metre square of each row."""
        raster = self.certificate.sectors
        there = np.argwhere(raster.volumes[1:].sum(axis=(0, 1)) > 0.0)
        for tile in tile_of(raster.origin + raster.size * (there + 0.5)).tolist():
            yield [(rule, tuple(tile)) for rule in self.FINDING_RULES]

    def draw(self) -> Figure:
        """Return how much of each place is proved, slices by heading, and the worst places."""
        from viatool.report.places.figure import draw_certificate

        return draw_certificate(self.certificate, self.headline)

    def page(self, checks: Sequence[Check]) -> str:
        """Return the page with what is proved of each place and heading, and why not."""
        from viatool.report.places.html.page import render_page

        return render_page(self, checks)

    def cell_table(self) -> Mapping[str, NDArray[Any]]:
        """Return bounds of x, y, theta, v and omega, and the counterexamples."""
        return self.certificate.cell_table()

    def witness_file(self) -> Mapping[str, Any]:
        """Return the worst places first, then others spread over the refuted cells, a thousand in all."""
        from viatool.verification.witness_file import compose_witnesses

        certificate = self.certificate
        return compose_witnesses(
            certificate.policy.path, certificate.policy.sha256, certificate.world_map,
            certificate.setting.command_map, certificate.rules, list(self._witnesses()),
        )  # fmt: skip

    def _witnesses(self) -> Iterator[dict[str, Any]]:
        from viatool.trajectory import write_scenario
        from viatool.verification.witness_file import commands_before

        certificate, scenario = self.certificate, self.certificate.scenario
        found, worst = certificate.findings, certificate.worst(100)
        others = np.setdiff1d(np.arange(len(found.clearance)), worst)
        step = max(1, -(-len(others) // (_MOST_WITNESSES - len(worst))))
        rows = np.concatenate([worst, others[::step]])
        seen, errors = certificate.witnesses(rows), certificate.errors_of(rows)
        about = json.loads(write_scenario(scenario) or "null")
        kinematics = certificate.rules.kinematics
        under_way = certificate.rules.queue(found.previous)
        for place, row in enumerate(rows.tolist()):
            motion = {"motion": [found.previous[row].tolist()] * 2} if kinematics.state else {}
            yield {
                "state": row,
                "episode": 0,
                "time": 0.0,
                "pose": found.pose[row].tolist(),
                **commands_before(under_way[row]),
                "previous": found.previous[row].tolist(),
                **motion,
                **errors[place],
                **seen.violation(place, certificate.world_map, scenario, certificate.rules.footprint),
                "scenario": about,
            }


def _told(axes: Sequence[Axis], numbers: Floats, digits: int) -> str:
    """Return numbers with their units."""
    told = [f"{number:.{digits}f} {axis.unit}" for axis, number in zip(axes, numbers, strict=True)]
    return " and ".join(told)


def _squares(raster: Raster, volumes: Floats) -> Iterator[Key]:
    """Yield the half metre squares with volume (statuses, X, Y) that is refuted or unknown."""
    for status in ("refuted", "unknown"):
        there = np.argwhere(volumes[STATUSES.index(status)] > 0.0)
        for tile in np.unique(tile_of(raster.origin + raster.size * (there + 0.5)), axis=0).tolist():
            yield f"{status}-place", tuple(tile)


def _slice(name: str, volumes: Sequence[float], squares: Sequence[Key]) -> Case:
    by_status = dict(zip(STATUSES, volumes, strict=True))
    figures = ", ".join(f"{significant(volume)} m^2 rad {status}" for status, volume in by_status.items())
    for status in ("refuted", "unknown"):
        if by_status[status] > 0.0:
            message = f"{significant(by_status[status])} m^2 rad {status}"
            return Case("viatool.heading", name, "warning", message, figures, subjects=squares)
    return Case("viatool.heading", name)


def _name(tile: NDArray[np.int64]) -> str:
    (x, y), (far_x, far_y) = TILE * tile, TILE * (tile + 1)
    return f"x {x:g} to {far_x:g} m, y {y:g} to {far_y:g} m"
