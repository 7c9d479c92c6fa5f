"""The page of a certificate: what its template speaks of, filled in one place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from viatool.places import SECTOR_NAMES
from viatool.report.certificates.console import (
    MEANING,
    rows_of_rates,
    rows_of_volumes,
    rows_of_worst,
    what_is_certified,
)
from viatool.report.certificates.document import CertificateDocument, read_certificate
from viatool.report.certificates.html.data import fitting_raster, page_data
from viatool.report.certificates.html.figures import places_figure, surroundings_figure
from viatool.report.foreign import one_line
from viatool.report.html.shell import assemble
from viatool.report.numbers import percentage, significant
from viatool.report.wording import ARITHMETIC, CRITERION, describe_eps, identities

if TYPE_CHECKING:
    from viatool.places import Certificate
    from viatool.report.gate import Check

SCRIPTS = ("geometry.js", "arrays.js", "figures.js", "theme.js", "scene.js", "places.js", "certificate.js")
CLASSES = {"uncontested": "settled", "certified": "safe", "refuted": "unsafe", "unknown": "unknown"}
"""How the style sheet calls the colour of each status."""


def render_page(certificate: Certificate, checks: Sequence[Check]) -> str:
    """Return the page of a certificate."""
    document = read_certificate(certificate)
    raster, _ = fitting_raster(certificate)
    return assemble(
        __package__,
        "certificate.html",
        SCRIPTS,
        title=f"{document.policy.path} on {document.map.path}: viatool certificate",
        version=document.versions.get("viatool", ""),
        data=page_data(certificate),
        figures=[places_figure(certificate, raster), surroundings_figure(certificate)],
        checks=checks,
        headline=_headline(document),
        volumes=_volumes(document),
        rates=rows_of_rates(document),
        worst=rows_of_worst(document),
        slices=_slices(certificate),
        square=f"{100.0 * raster.size[0]:.3g} cm x {100.0 * raster.size[1]:.3g} cm",
        assumptions={**_assumptions(document), **identities(document)},
    )


def _headline(document: CertificateDocument) -> dict[str, str]:
    rate, roots = document.contested_rate, document.roots
    examined = "" if roots.examined == roots.total else percentage(roots.examined, roots.total)
    goal = ", ".join(f"{number:g}" for number in document.scenario.goal)
    stop = "" if document.deceleration is None else f" at {document.deceleration:g} m/s²"
    return {
        "rate": percentage(rate.part, rate.total) if rate.total else "",
        "rest": what_is_certified(document),
        "policy": one_line(document.policy.path),
        "map": one_line(document.map.path),
        "scenario": one_line(document.scenario.name),
        "goal": goal,
        "eps": one_line(describe_eps(document.eps)),
        "criterion": one_line(f"{document.criterion}{stop}"),
        "arithmetic": one_line(document.arithmetic),
        "examined": examined,
    }


def _assumptions(document: CertificateDocument) -> dict[str, str]:
    before, size = document.previous_command, document.smallest_cell
    return {
        "criterion": CRITERION.get(document.criterion, document.criterion),
        "arithmetic": ARITHMETIC.get(document.arithmetic, document.arithmetic),
        "distance": f"the footprint keeps more than {document.clearance:g} m",
        "map": "right, and nothing on it moves",
        "sensors": f"read what is there, each number within eps {describe_eps(document.eps)}",
        "motion": "exact arcs without slip",
        "timing": f"commands act after {document.delay:g} s, until then the one before goes on",
        "command before": f"any from {before.lower[0]:g} to {before.upper[0]:g} m/s and "
        f"{before.lower[1]:g} to {before.upper[1]:g} rad/s",
        "scope": "the next command from every pose, not those after it",
        "smallest cells": ", ".join(f"{name} {significant(side)}" for name, side in size.items()),
    }


def _volumes(document: CertificateDocument) -> list[dict[str, Any]]:
    return [
        {
            "name": name,
            "kind": CLASSES[name],
            "cells": cells,
            "volume": volume,
            "size": getattr(document.volume, name),
            "meaning": MEANING[name],
        }
        for name, cells, volume in rows_of_volumes(document)
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
