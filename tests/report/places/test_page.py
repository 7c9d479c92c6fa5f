"""The page of a certificate as a file: closed to the network, small, and right about every place."""

from __future__ import annotations

import json
from base64 import b64decode

import numpy as np

from tests.report.page.test_page import Outline
from tests.report.places.conftest import FAILED
from viatool.places import Certificate
from viatool.report.places.html.data import fitting_raster, kept_witnesses, page_data
from viatool.report.places.html.page import render_page
from viatool.report.places.run import PlacesRun


def unpack(packed: dict[str, str]) -> np.ndarray:
    return np.frombuffer(b64decode(packed["bytes"]), packed["kind"])


def test_the_page_refers_to_nothing_outside_of_itself(certificate: Certificate) -> None:
    elements = Outline(render_page(PlacesRun(certificate), (FAILED,))).elements
    references = [a[name] for _, a in elements for name in ("src", "href", "srcset", "action") if name in a]
    assert {reference[0] for reference in references} == {"#"}
    (policy,) = [a["content"] for _, a in elements if a.get("http-equiv") == "Content-Security-Policy"]
    assert policy is not None
    assert policy.startswith("default-src 'none'; script-src 'sha256-")


def test_names_neither_add_an_element_nor_end_one(certificate: Certificate, hostile: Certificate) -> None:
    tags = [
        [tag for tag, _ in Outline(render_page(PlacesRun(c), (FAILED,))).elements]
        for c in (certificate, hostile)
    ]
    assert tags[0] == tags[1]


def test_the_page_says_what_the_certificate_says(certificate: Certificate) -> None:
    page, document = render_page(PlacesRun(certificate), (FAILED,)), PlacesRun(certificate).record
    for text in (
        document.policy.sha256,
        document.map.sha256,
        FAILED.condition.replace(">", "&gt;"),
        "the next command from every pose, not those after it",
        "Gate failed",
        f"{document.cells.certified:,} cells",
    ):
        assert text in page
    assert "was examined, drawn at random" not in page
    assert json.dumps(page_data(certificate), allow_nan=False)


def test_shares_are_those_of_the_volumes_rounded_down(certificate: Certificate) -> None:
    data, (raster, mixed) = page_data(certificate), fitting_raster(certificate)
    slices = raster.volumes.shape[1]
    shares = unpack(data["places"]["share"]).reshape(len(mixed), slices, 5)
    whole = 2.0 * np.pi * raster.size.prod() / slices
    exact = (raster.volumes.reshape(5, slices, -1)[:, :, mixed] / whole).transpose(2, 1, 0)
    assert (shares <= 255.0 * exact + 1e-3).all()
    assert (shares > 255.0 * exact - 1.01).all()
    kinds, total = unpack(data["places"]["kind"]), raster.volumes.sum(axis=1).reshape(5, -1)
    assert (np.flatnonzero(kinds == 255) == mixed).all()
    for status in range(5):
        assert (total[status, kinds == status] > 0.0).all()
        np.testing.assert_allclose(np.delete(total, status, axis=0)[:, kinds == status], 0.0, atol=1e-12)


def test_a_page_that_would_be_large_gets_larger_squares_and_keeps_the_worst(certificate: Certificate) -> None:
    fine, _ = fitting_raster(certificate)
    coarse, _ = fitting_raster(certificate, most=10)
    assert coarse.volumes.shape[2] < fine.volumes.shape[2]
    np.testing.assert_allclose(coarse.volumes.sum(axis=(2, 3)), fine.volumes.sum(axis=(2, 3)))
    kept = kept_witnesses(certificate, fine, most=20)
    assert len(kept) <= 20 + 10
    assert set(certificate.worst()) <= set(kept)
    assert len(kept_witnesses(certificate, fine)) > len(kept)
