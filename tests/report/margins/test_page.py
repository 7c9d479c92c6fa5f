"""The page of margins in a real browser: it runs nothing that it does not carry, and shows every state."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

import viatool
from tests.browser import Browser
from viatool.report.gate import Gate, evaluate, parse_threshold
from viatool.report.margins.html.page import render_page
from viatool.report.margins.run import MarginsRun
from viatool.report.sections import Check
from viatool.simulate import Places


@pytest.fixture(scope="module")
def document() -> MarginsRun:
    places = Places(count=400)
    return MarginsRun(
        *(viatool.margin(name, "lab", places=places, resolution=0.1) for name in ("via", "td3"))
    )


@pytest.fixture(scope="module")
def checks(document: MarginsRun) -> Sequence[Check]:
    return evaluate(Gate((parse_threshold("margin=0.3", MarginsRun),)), document)


@pytest.fixture(scope="module")
def opened(
    browser: Browser, document: MarginsRun, checks: Sequence[Check], tmp_path_factory: pytest.TempPathFactory
) -> Browser:
    page = tmp_path_factory.mktemp("page") / "margins.html"
    page.write_text(render_page(document, checks), encoding="utf-8")
    browser.open(page)
    return browser


def shown_rows(browser: Browser) -> list[str]:
    return browser.run(
        "return [...document.querySelectorAll('tr[data-address]:not([hidden])')].map((e) => e.dataset.address)"
    )


def test_the_page_shows_the_gate_the_curve_and_the_states(opened: Browser, document: MarginsRun) -> None:
    assert opened.complaints() == []
    words = opened.run("return document.querySelector('main').innerText")
    assert words.index("Gate failed") < words.index("put to the test in via: ")
    curves = opened.run(
        "return [...document.querySelectorAll('.chart .proved, .chart .withstood')].map((e) => e.getTotalLength())"
    )
    assert len(curves) == 4
    assert min(curves) > 400
    assert len(shown_rows(opened)) == document.size
    opened.run("document.getElementById('theme').click()")
    assert opened.run("return document.documentElement.dataset.theme") in ("dark", "light")


def test_a_condition_lists_its_states_and_shows_them_alone(opened: Browser, checks: Sequence[Check]) -> None:
    listed = opened.run(
        "return [...document.querySelectorAll('.conditions details > ul a')].map((e) => e.getAttribute('href'))"
    )
    assert len(listed) == len(checks[0].failing) > 1
    opened.follow("#fails=0")
    assert sorted(shown_rows(opened)) == sorted(listed)
    opened.follow(listed[-1])
    opened.run("document.getElementById('condition').value = ''")
    assert opened.run("return document.querySelector('tr.current').dataset.address") == listed[-1]


def test_keys_go_from_state_to_state(opened: Browser, document: MarginsRun) -> None:
    opened.follow("#state=no-such")
    assert opened.text("where") == "state=no-such is none of the weakest states on this page"
    first = shown_rows(opened)[0]
    opened.follow(first)
    opened.press("n")
    assert opened.run("return document.querySelector('tr.current').dataset.address") == shown_rows(opened)[1]
    opened.press("p")
    assert opened.run("return document.querySelector('tr.current').dataset.address") == first


def test_a_phone_scrolls_tables_and_nothing_else(opened: Browser) -> None:
    assert opened.too_wide(360) == []
    assert opened.on_paper("button, input, select, nav, .keys") == 0
