"""A certificate as a picture: how much of each place is proved, slices by heading, and the worst places."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from viatool.places import SECTOR_NAMES
from viatool.report.drawing import INK, WALL, draw_floor, draw_obstacles
from viatool.report.foreign import one_line
from viatool.report.palette import COLOUR
from viatool.report.places.tiles import is_free
from viatool.report.sections import Headline

if TYPE_CHECKING:
    from viatool.arrays import Floats
    from viatool.places import Certificate, LastingCells, Raster

_WIDTH = 13.0  # inches
_COLOURS = (WALL, "#E4E9EE", COLOUR["safe"], COLOUR["unsafe"], COLOUR["unknown"])
"""In the order of the statuses."""


def draw_certificate(certificate: Certificate, headline: Headline) -> Figure:
    """Draw a certificate below its headline."""
    raster = certificate.sectors
    x_min, y_min, x_max, y_max = certificate.world_map.bounds
    height = _WIDTH / 3.0 * float(np.clip((y_max - y_min) / (x_max - x_min), 0.3, 2.0))
    shown = _lasting_sets(certificate.lasting)
    more = 0.5 * height if shown else 0.0
    figure = Figure(figsize=(_WIDTH, height + more + 1.3), layout="constrained", facecolor="white")
    grid = figure.add_gridspec(3 if shown else 2, 6)
    _draw_places(figure, figure.add_subplot(grid[:2, :2]), certificate, raster)
    for column, (title, share) in enumerate(shown.items()):
        axes = figure.add_subplot(grid[2, 2 * column : 2 * column + 2])
        _draw_lasting(figure, axes, certificate, title, share)
    for sector, name in enumerate(SECTOR_NAMES):
        axes = figure.add_subplot(grid[sector // 4, 2 + sector % 4])
        _draw_slice(axes, certificate, raster, sector)
        axes.set_title(f"heading {name}", fontsize=8, color=INK, pad=2)
    title = one_line(certificate.scenario.name).replace("$", r"\$")
    figure.suptitle(f"{title}: {headline.stake or headline}", fontsize=10, color=INK)
    figure.legend(handles=_legend(), loc="outside lower center", ncols=6, fontsize=8, frameon=False)
    return figure


def _lasting_sets(lasting: LastingCells | None) -> dict[str, Floats]:
    """Return the shares of each place (X, Y) that hold beyond the next action, by title."""
    if lasting is None:
        return {}
    asked, sets = lasting.lookahead, {}
    if asked.arrive:
        sets["reaches the goal for certain"] = lasting.arriving
    if asked.lasts:
        sets["left only towards the goal"] = lasting.for_ever
    return {title: lasting.share_by_place(members) for title, members in sets.items()}


def _draw_lasting(figure: Figure, axes: Axes, certificate: Certificate, title: str, share: Floats) -> None:
    """Draw which share (X, Y) of the headings and previous commands of each place is in a set that lasts."""
    lasting = certificate.lasting
    assert lasting is not None
    _draw_floor(axes, certificate)
    mesh = lasting.mesh
    first, last = mesh.origin[:2], mesh.origin[:2] + mesh.size[:2] * mesh.count[:2]
    image = axes.imshow(
        share.T, origin="lower", extent=(first[0], last[0], first[1], last[1]),
        cmap=colormaps["viridis"], vmin=0.0, vmax=1.0, interpolation="nearest", zorder=1.5,
    )  # fmt: skip
    figure.colorbar(image, ax=axes, shrink=0.7, pad=0.01, label="share")
    axes.set_title(title, fontsize=9, color=INK, pad=3)


def _draw_places(figure: Figure, axes: Axes, certificate: Certificate, raster: Raster) -> None:
    """Draw which share of the headings and previous commands of each place is safe."""
    _draw_floor(axes, certificate)
    share = np.where(is_free(certificate, raster), raster.safe_share(), np.nan)
    image = axes.imshow(
        share.T, origin="lower", extent=raster.extent, cmap=colormaps["viridis"], vmin=0.0, vmax=1.0,
        interpolation="nearest", zorder=1.5,
    )  # fmt: skip
    figure.colorbar(
        image,
        ax=axes,
        location="bottom",
        shrink=0.8,
        pad=0.01,
        aspect=40,
        label="share of headings and previous commands",
    )
    worst = certificate.findings.pose[certificate.worst()]
    if len(worst):
        axes.quiver(
            worst[:, 0], worst[:, 1], np.cos(worst[:, 2]), np.sin(worst[:, 2]), color=COLOUR["unsafe"],
            angles="xy", scale=18.0, width=0.006, zorder=7,
        )  # fmt: skip
    axes.set_title("proved safe at each place", fontsize=9, color=INK, pad=3)


def _draw_slice(axes: Axes, certificate: Certificate, raster: Raster, sector: int) -> None:
    """Draw one slice: each place in the mean colour of its volume."""
    _draw_floor(axes, certificate)
    volumes = raster.volumes[:, sector]
    total = volumes.sum(axis=0)  # (X, Y)
    share = volumes / np.where(total > 0.0, total, 1.0)
    colours = np.einsum("sxy,sc->yxc", share, np.array([to_rgb(colour) for colour in _COLOURS]))
    alpha = (total.T > 0.0).astype(float)[:, :, None]
    axes.imshow(
        np.concatenate([np.clip(colours, 0.0, 1.0), alpha], axis=2), origin="lower",
        extent=raster.extent, interpolation="nearest", zorder=1.5,
    )  # fmt: skip
    axes.set(xticks=[], yticks=[])


def _draw_floor(axes: Axes, certificate: Certificate) -> None:
    draw_floor(axes, certificate.world_map)
    draw_obstacles(axes, certificate.scenario.obstacles, facecolor=WALL, edgecolor=INK)
    axes.plot(*certificate.scenario.goal, marker="*", ms=9, mfc="#F0E442", mec=INK, mew=0.7, ls="", zorder=6)


def _legend() -> Sequence[Patch | Line2D]:
    names = ("too near to something", "uncontested", "certified", "refuted", "unknown")
    return [
        *(Patch(facecolor=colour, label=name) for colour, name in zip(_COLOURS, names, strict=True)),
        Line2D([], [], marker="*", ms=9, mfc="#F0E442", mec=INK, ls="", label="goal"),
    ]
