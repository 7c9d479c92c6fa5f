"""Each format says what the certificate says, and no foreign string gets out of its place."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pydantic_sarif.model import StaticAnalysisResultsFormatSarifVersion210JsonSchema as SarifLog

from tests.report.places.conftest import FAILED
from tests.report.test_golden import LINES, check, steady
from tests.report.test_hostile_names import read_github, read_json
from viatool.places import Certificate
from viatool.report import formats_of
from viatool.report.formats.figure import render as draw
from viatool.report.places.run import PlacesRun

Render = Callable[..., str]


@pytest.mark.parametrize("name", ["csv", "sarif", "markdown", "junit", "github"])
def test_the_whole_text(name: str, certificate: Certificate, render: Render) -> None:
    text = steady(render(certificate, name, FAILED), Path(certificate.policy.path).parent)
    check(f"certificate-{name}.txt", "\n".join(text.splitlines()[:LINES]))


def test_the_table_has_a_row_for_each_place_with_its_free_volume(
    certificate: Certificate, render: Render
) -> None:
    rows = list(csv.DictReader(io.StringIO(render(certificate, "csv"))))
    free = certificate.raster.volumes[1:].sum(axis=(0, 1))
    assert len(rows) == int((free > 0.0).sum())
    volume = certificate.to_json()["volume"]
    for status in ("uncontested", "certified", "refuted", "unknown"):
        np.testing.assert_allclose(sum(float(row[status]) for row in rows), volume[status], rtol=1e-6)
    for row in rows:
        safe, others = (
            sum(float(row[name]) for name in names)
            for names in (("uncontested", "certified"), ("refuted", "unknown"))
        )
        np.testing.assert_allclose(float(row["safe"]), safe / (safe + others), rtol=1e-4)
    spots = np.array([[float(row["x"]), float(row["y"])] for row in rows])
    found = certificate.findings.pose[:, None, :2] - spots
    assert np.abs(found).max(axis=2).min(axis=1).max() <= 0.5 * certificate.raster.size.max() + 1e-9


def test_sarif_keeps_to_the_standard_and_names_the_worst_of_each_square(
    certificate: Certificate, render: Render
) -> None:
    log = json.loads(render(certificate, "sarif", FAILED))
    SarifLog.model_validate(log)
    results = log["runs"][0]["results"]
    assert results[0]["ruleId"] == "gate"
    refuted = [found for found in results if found["ruleId"] == "refuted-place"]
    tiles = np.unique(np.floor(certificate.findings.pose[:, :2] / 0.5), axis=0)
    assert len(refuted) == len(tiles) > 3
    least = [float(re.search(r"comes within ([\d.]+) m", found["message"]["text"])[1]) for found in refuted]
    assert least == sorted(least)
    np.testing.assert_allclose(least[0], certificate.findings.clearance.min(), atol=6e-4)
    marks = [found["partialFingerprints"]["viatoolState/v1"] for found in results]
    assert len(set(marks)) == len(marks) == log["runs"][0]["properties"]["resultsFound"]


def test_fingerprints_outlast_other_counterexamples(certificate: Certificate, render: Render) -> None:
    from dataclasses import replace

    found = certificate.findings
    nearer = replace(certificate, findings=replace(found, clearance=0.5 * found.clearance))
    marks = [
        {
            result["partialFingerprints"]["viatoolState/v1"]
            for result in json.loads(render(c, "sarif"))["runs"][0]["results"]
        }
        for c in (certificate, nearer)
    ]
    assert marks[0] == marks[1]


@pytest.mark.parametrize("name", sorted(set(formats_of(PlacesRun)) - {"figure", "cells"}))
def test_a_name_stays_text(name: str, hostile: Certificate, render: Render) -> None:
    text = render(hostile, name, FAILED)
    assert not re.search("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]", text)
    if name == "html":
        text = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
    assert "<img src=x" not in text or name in ("json", "witnesses", "sarif", "github")
    if name != "github":
        assert not [line for line in text.splitlines() if line.lstrip().startswith(("::", "##["))]
    else:
        read_github(text, None)
    if name in ("json", "witnesses", "sarif"):
        read_json(text, None)


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_a_picture_is_drawn_whatever_the_names(hostile: Certificate, suffix: str) -> None:
    assert len(draw(PlacesRun(hostile), (), suffix)) > 10_000


def test_refuted_cells_can_be_accepted_by_their_place_and_unknown_volume_cannot(
    certificate: Certificate,
) -> None:
    document = PlacesRun(certificate)
    findings = list(document.findings()[0])
    refuted = [finding for finding in findings if finding.verdict == "unsafe"]
    assert sum(finding.size for finding in refuted) == document.record.cells.refuted > 0
    assert sum(finding.takes["unsafe"] for finding in refuted) == document.record.cells.refuted
    assert all(not finding.takes for finding in findings if finding.verdict == "unknown")
