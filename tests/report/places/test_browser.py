"""The page of a certificate in a real browser: what it paints of each slice, and what a click on a place shows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.browser import Browser
from tests.report.places.conftest import FAILED
from viatool.places import Certificate
from viatool.report.gate import Gate, evaluate, parse_threshold
from viatool.report.places.html.data import fitting_raster, kept_witnesses
from viatool.report.places.html.page import render_page
from viatool.report.places.run import PlacesRun
from viatool.report.places.tiles import TILE, is_free
from viatool.report.sections import Check

PICTURE = """
const { image: [picture] } = Figures.model('places-source').data;
return [Array.from(picture), picture.shape];
"""


@pytest.fixture(scope="module")
def checks(certificate: Certificate) -> Sequence[Check]:
    return evaluate(Gate((parse_threshold("1", PlacesRun),), max_unsafe=0), PlacesRun(certificate))


@pytest.fixture(scope="module")
def opened(
    browser: Browser,
    certificate: Certificate,
    checks: Sequence[Check],
    tmp_path_factory: pytest.TempPathFactory,
) -> Browser:
    page = tmp_path_factory.mktemp("page") / "certificate.html"
    page.write_text(render_page(PlacesRun(certificate), checks), encoding="utf-8")
    browser.open(page)
    return browser


@pytest.fixture
def page(opened: Browser) -> Browser:
    turn_to(opened, 0)
    opened.run(
        "document.getElementById('by-share').click(); document.querySelector('[data-worst=\"0\"]').click();"
    )
    return opened


def turn_to(browser: Browser, place: int) -> None:
    browser.run(
        "const slider = document.getElementById('heading'); slider.value = arguments[0];"
        "slider.dispatchEvent(new Event('input'));",
        place,
    )


def tap(browser: Browser, x: float, y: float) -> None:
    browser.run(
        "Figures.model('map').trigger_event({event_name: 'tap', x: arguments[0], y: arguments[1]})", x, y
    )


def painted(browser: Browser) -> np.ndarray:
    """The pixels, (X, Y), 0 where nothing is painted."""
    pixels, shape = browser.run(PICTURE)
    return np.array(pixels, dtype=np.int64).reshape(shape).T


def test_it_opens_without_a_complaint_and_without_a_network(page: Browser) -> None:
    assert page.complaints() == []
    assert [url for url in page.requests() if not url.startswith(("file:", "data:", "blob:"))] == []
    colours = page.run(
        "return Bokeh.documents.map((d) => { const view = Bokeh.index.get_one(d.roots()[0]);"
        " const { canvas } = view.export('png', false);"
        " const pixels = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;"
        " return new Set(new Uint32Array(pixels.buffer)).size; })"
    )
    assert len(colours) == 2
    assert min(colours) > 5


def test_the_share_that_is_proved_gives_the_colour(page: Browser, certificate: Certificate) -> None:
    raster, _ = fitting_raster(certificate)
    share = np.where(is_free(certificate, raster), raster.safe_share(), np.nan)
    pixels = painted(page)
    assert ((pixels == 0) == np.isnan(share)).all()
    scale = page.run("return Places.data.scale")
    for safe, place in ((1.0, 255), (0.0, 0)):
        shades = set(pixels[share == safe].tolist())
        red, green, blue = (scale[place] >> shift & 255 for shift in (16, 8, 0))
        assert shades <= {255 << 24 | blue << 16 | green << 8 | red}
    assert len(set(pixels[share == 1.0].tolist())) == 1


def test_every_slice_paints_its_own_shares(page: Browser, certificate: Certificate) -> None:
    raster, _ = fitting_raster(certificate)
    slices = raster.volumes.shape[1]
    for at in (0, slices // 2, slices - 1):
        turn_to(page, at + 1)
        free, safe = raster.volumes[1:, at].sum(axis=0), raster.volumes[1:3, at].sum(axis=0)
        seen = (painted(page) != 0) & is_free(certificate, raster)
        assert (seen == (is_free(certificate, raster) & (free > 1e-12))).all()
        square = int(np.argmax(free - safe))
        x, y = raster.middles.reshape(-1, 2)[square]
        tap(page, x, y)
        refuted, unknown = (raster.volumes[k, at].reshape(-1)[square] for k in (3, 4))
        whole = 2 * np.pi * raster.size.prod() / slices
        shares = page.run("return Places.shares(arguments[0], arguments[1])", square, at)
        np.testing.assert_allclose(shares[3:], np.array([refuted, unknown]) / whole, atol=1 / 250)
    assert page.text("slice") == f"headings from {180 - 360 / slices:g}° to 180°"
    page.run("document.getElementById('forward').click()")
    assert page.text("slice") == "all headings"


def test_a_click_shows_the_worst_counterexample_of_the_place(page: Browser, certificate: Certificate) -> None:
    found = certificate.findings
    x, y = found.pose[int(found.clearance.argmax()), :2]
    tap(page, x, y)
    here = page.source("here")
    raster, _ = fitting_raster(certificate)
    near = np.hypot(*(found.pose[:, :2] - [x, y]).T) <= max(0.25, raster.size.max())
    near &= np.isin(np.arange(len(near)), kept_witnesses(certificate, raster))
    assert np.hypot(here["x"][0] - x, here["y"][0] - y) <= 0.3
    least = found.clearance[near].min()
    assert f"comes within {least:.4f} m" in page.text("where")
    row = int(np.flatnonzero(near & (found.clearance == least))[0])
    end = page.source("witness-pose")
    np.testing.assert_allclose([end["x"][0], end["y"][0]], found.closest[row, :2], atol=1e-4)
    np.testing.assert_allclose(page.source("fan")["radius"], found.observation[row, :20], atol=1e-3)
    assert page.run("return document.querySelectorAll('#nearby tr').length") >= 1


def test_the_table_of_worst_places_leads_to_them(page: Browser, certificate: Certificate) -> None:
    worst = certificate.worst()
    for place in (1, 0):
        page.run("document.querySelector(`[data-worst='${arguments[0]}']`).click()", place)
        here = page.source("here")
        np.testing.assert_allclose(
            [here["x"][0], here["y"][0]], certificate.findings.pose[worst[place], :2], atol=1e-5
        )


def test_statuses_have_the_colours_of_the_theme(page: Browser, certificate: Certificate) -> None:
    page.run("document.getElementById('by-status').click()")
    raster, _ = fitting_raster(certificate)
    total = raster.volumes.sum(axis=1)
    pure = (total > 0.0).sum(axis=0) == 1
    pictures = []
    for _ in range(2):
        pixels = painted(page)
        for status in range(5):
            assert len(set(pixels[pure & (total[status] > 0.0)].tolist())) <= 1
        pictures.append(pixels)
        page.run("document.getElementById('theme').click()")
    assert (pictures[0] != pictures[1]).any()


def test_a_condition_lists_its_squares_and_outlines_them(page: Browser, checks: Sequence[Check]) -> None:
    words = page.run("return document.querySelector('main').innerText")
    assert words.index("Gate failed") < words.index("of the contested volume is certified")
    listed = page.run(
        "return [...document.querySelectorAll('.conditions > li')].map((e) =>"
        " [...e.querySelectorAll('details > ul a')].map((a) => a.getAttribute('href')))"
    )
    for number, check in enumerate(checks):
        assert len(listed[number]) == len(check.failing) > 1
        page.follow(f"#fails={number}")
        drawn, squares = page.source("failing"), {one.key[1] for one in check.failing}
        assert len(drawn["left"]) == len(squares)
        assert {
            (round(x / TILE), round(y / TILE)) for x, y in zip(drawn["left"], drawn["bottom"], strict=True)
        } == squares
    page.run("document.getElementById('condition').value = ''")
    page.follow(listed[1][0])
    x, y = map(float, listed[1][0].removeprefix("#place=").split(","))
    assert page.text("where").startswith(f"place {x:.2f}, {y:.2f}, from ")


def test_keys_turn_the_slices_and_go_to_what_fails(page: Browser, checks: Sequence[Check]) -> None:
    page.press("n")
    assert page.text("slice").startswith("headings from -180° to ")
    page.press("p")
    assert page.text("slice") == "all headings"
    page.follow("#fails=1")
    seen = []
    for _ in range(2):
        page.press("j")
        seen.append(page.run("return document.querySelector('#where a').getAttribute('href')"))
    middles = ([TILE * (number + 0.5) for number in one.key[1]] for one in checks[1].failing[:2])
    assert seen == [f"#place={x:g},{y:g}" for x, y in middles]
    assert page.too_wide(360) == []
    assert page.on_paper("button:not(.link), input, select, nav, .keys, .stepper") == 0


def test_every_control_has_a_name_and_hostile_names_are_text(
    opened: Browser, hostile: Certificate, tmp_path: Path
) -> None:
    (tmp_path / "hostile.html").write_text(render_page(PlacesRun(hostile), (FAILED,)), encoding="utf-8")
    opened.open(tmp_path / "hostile.html")
    assert opened.complaints() == []
    assert opened.run("return [typeof owned, document.querySelectorAll('main img').length]") == [
        "undefined",
        0,
    ]
    nameless = opened.run(
        "return [...document.querySelectorAll('button, input, select, [role=img]')].filter((e) =>"
        " !(e.getAttribute('aria-label') || e.textContent.trim() || e.labels?.length)).map((e) => e.outerHTML)"
    )
    assert nameless == []
    assert len(opened.run("return document.getElementById('observation').textContent")) > 100
