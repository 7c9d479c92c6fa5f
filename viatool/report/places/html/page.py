"""The page of a certificate: what its template speaks of, filled in one place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from viatool.places import SECTOR_NAMES
from viatool.report.foreign import one_line
from viatool.report.html.shell import assemble
from viatool.report.numbers import percentage, significant
from viatool.report.places.document import PlacesDocument
from viatool.report.places.html.data import fitting_raster, page_data
from viatool.report.places.html.figures import places_figure, surroundings_figure
from viatool.report.places.tiles import TILE
from viatool.report.sections import Check, Key
from viatool.report.wording import describe_eps

if TYPE_CHECKING:
    from viatool.places import Certificate
    from viatool.report.places.run import PlacesRun

SCRIPTS = (
    "geometry.js",
    "gap.js",
    "arrays.js",
    "figures.js",
    "theme.js",
    "keys.js",
    "scene.js",
    "places.js",
    "certificate.js",
)
CLASSES = {"uncontested": "settled", "certified": "safe", "refuted": "unsafe", "unknown": "unknown"}
"""How the style sheet calls the colour of each status."""


def render_page(document: PlacesRun, checks: Sequence[Check]) -> str:
    """Return the page of a certificate."""
    certificate = document.certificate
    raster, _ = fitting_raster(certificate)
    return assemble(
        document,
        __package__,
        "certificate.html",
        SCRIPTS,
        title="viatool certificate",
        data={**page_data(certificate), "side": TILE, "fails": failing_squares(checks)},
        figures=[places_figure(certificate, raster), surroundings_figure(certificate)],
        checks=checks,
        address=_address,
        headline=_headline(document),
        volumes=_volumes(document),
        rates=document.shares.rows,
        lasting=document.lasting,
        error_costs=document.error_costs,
        worst=document.worst.rows,
        slices=_slices(certificate),
        slices_head=("heading", *(f"{name}, m² rad" for name in CLASSES), "certified of contested"),
        square=f"{100.0 * raster.size[0]:.3g} cm x {100.0 * raster.size[1]:.3g} cm",
    )


def failing_squares(checks: Sequence[Check]) -> list[list[Any]]:
    """Return the half metre squares that each condition counts that does not hold, the gravest first."""
    each = [[one.key[1] for one in check.failing] for check in checks if not check.passed]
    return [list(dict.fromkeys(squares)) for squares in each]


def _address(key: Key) -> str:
    """Return where the page shows a half metre square: by its middle, in metres."""
    square = key[1]
    assert isinstance(square, tuple)
    return "#place=" + ",".join(f"{TILE * (number + 0.5):g}" for number in square)


def _headline(document: PlacesDocument) -> dict[str, str]:
    record, found = document.record, document.headline
    roots = record.roots
    return {
        "stake": found.stake,
        "rate": found.rate,
        "rest": found.rest,
        "policy": one_line(record.policy.path),
        "map": one_line(record.map.path),
        "scenario": one_line(record.scenario.name),
        "goal": ", ".join(f"{number:g}" for number in record.scenario.goal),
        "eps": one_line(describe_eps(record.eps)),
        "criterion": one_line(document.criterion),
        "arithmetic": one_line(record.arithmetic),
        "examined": percentage(roots.examined, roots.total) if document.incomplete else "",
    }


def _volumes(document: PlacesDocument) -> list[dict[str, Any]]:
    return [
        {
            "name": part.name,
            "kind": CLASSES[part.name],
            "cells": part.figures[0],
            "volume": part.figures[1],
            "size": part.weight,
            "meaning": part.meaning,
        }
        for part in document.volumes.parts
    ]


def _slices(certificate: Certificate) -> list[tuple[str, ...]]:
    """Return heading, free volume, its shares by status, and the certified share of what is contested."""
    rows = []
    volumes = certificate.sectors.volumes.sum(axis=(2, 3)).T
    for name, (_, settled, certified, refuted, unknown) in zip(SECTOR_NAMES, volumes.tolist(), strict=True):
        contested = certified + refuted + unknown
        share = f"{100.0 * certified / contested:.2f} %" if contested > 0.0 else "none is contested"
        rows.append((name, *map(significant, (settled, certified, refuted, unknown)), share))
    return rows
