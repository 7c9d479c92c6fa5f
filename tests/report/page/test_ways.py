"""How people come to a state: addresses, keys, the conditions of the gate; on a phone, on paper, read aloud."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.browser import Browser
from viatool.report.gate import Gate, evaluate, parse_threshold
from viatool.report.html.page import render_page
from viatool.report.sections import Check
from viatool.report.states.run import StatesRun
from viatool.verification.result import Result

CONTRAST = """
const parse = (text) => text.match(/[\\d.]+/g).map(Number);
const light = (rgb) => {
  const linear = (v) => (v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
  const [r, g, b] = rgb.slice(0, 3).map((v) => linear(v / 255));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const behind = (e) => {
  for (let at = e; at; at = at.parentElement) {
    const colour = parse(getComputedStyle(at).backgroundColor);
    if (colour.length < 4 || colour[3] > 0) return colour;
  }
  return [255, 255, 255];
};
const own = (e) => [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim());
const told = (e) => own(e) && e.getClientRects().length;
return [...document.querySelectorAll('body *:not(script, option)')].filter(told).filter((e) => {
  const [a, b] = [light(parse(getComputedStyle(e).color)), light(behind(e))].sort((x, y) => y - x);
  return (a + 0.05) / (b + 0.05) < 4.5;
}).map((e) => e.outerHTML.slice(0, 100));
"""
GATE = ("1", "close=1", "timeout=0", "sampled=0.1")


@pytest.fixture(scope="module")
def result(verified: Callable[..., Result]) -> Result:
    return verified(close=40)


@pytest.fixture(scope="module")
def checks(result: Result) -> Sequence[Check]:
    """The first two conditions fail, the third has nothing to decide on, the last one holds."""
    thresholds = tuple(parse_threshold(text, StatesRun) for text in GATE)
    return evaluate(Gate(thresholds), StatesRun(result))


@pytest.fixture(scope="module")
def page(write: Callable[..., Path], result: Result, checks: Sequence[Check]) -> Path:
    return write(result, None, checks)


@pytest.fixture(scope="module")
def opened(browser: Browser, page: Path) -> Browser:
    browser.open(page)
    return browser


@pytest.fixture
def shown(opened: Browser) -> Browser:
    """The page with all of its states, at the first one."""
    opened.run("document.activeElement.blur()")
    opened.follow("#places=close")
    opened.follow("#state=0")
    return opened


def eventually(browser: Browser, expression: str, wanted: object) -> None:
    """What comes to rest after a moment is what it should be."""
    limit = time.monotonic() + 5.0
    while (found := browser.run(f"return {expression}")) != wanted:
        assert time.monotonic() < limit, found
        time.sleep(0.02)


def test_the_gate_stands_before_every_percentage(opened: Browser, checks: Sequence[Check]) -> None:
    words = opened.run("return document.querySelector('main').innerText")
    gate, stake = words.index("Gate failed"), words.index("put to the test")
    assert gate < stake < words.index("of the states are proved safe")
    assert "3 of 4 conditions do not hold" in words
    assert [check.passed for check in checks] == [False, False, False, True]


def test_each_failed_condition_lists_what_fails_it_with_its_address(
    opened: Browser, checks: Sequence[Check]
) -> None:
    listed = opened.run(
        "return [...document.querySelectorAll('.conditions > li')].map((e) =>"
        " [...e.querySelectorAll('details > ul a')].map((a) => [a.textContent, a.getAttribute('href')]))"
    )
    for check, items in zip(checks, listed, strict=True):
        kinds = {"": "state", "close_": "close"}
        expected = [[one.text, f"#{kinds[one.key[0]]}={one.key[1]}"] for one in check.failing]
        assert items == expected
    assert listed[0]
    assert len(listed[1]) > 1


@pytest.mark.parametrize("kind", ["state", "close"])
def test_an_address_opens_its_state(browser: Browser, kind: str) -> None:
    browser.follow(f"#{kind}=33")
    name = "state" if kind == "state" else "close place"
    assert browser.text("where").startswith(f"{name} 33, ")
    assert browser.run("return document.querySelector('#where a').getAttribute('href')") == f"#{kind}=33"
    assert browser.run("return document.activeElement.id") == "slider"


def test_a_page_opened_by_an_address_shows_that_state(opened: Browser, page: Path) -> None:
    opened.driver.get("about:blank")
    opened.driver.get(f"{page.as_uri()}#state=41")
    eventually(opened, "document.documentElement.dataset.whole !== undefined", True)
    assert opened.text("where").startswith("state 41, ")


def test_an_address_is_not_hidden_by_filters(shown: Browser, result: Result) -> None:
    shown.run("document.querySelector('[data-filter=verdict][value=safe]').click()")
    safe = int(np.flatnonzero(result.verdict == "safe")[3])
    shown.follow(f"#state={safe}")
    assert shown.text("where").startswith(f"state {safe}, ")


@pytest.mark.parametrize("address", ["#state=99999", "#state=", "#state=%E0%A4%A", "#constructor=1", "#x"])
def test_an_address_of_nothing_shows_nothing_else(shown: Browser, address: str) -> None:
    shown.follow(address)
    assert shown.source("here")["x"]
    assert shown.complaints() == []
    if "99999" in address:
        assert shown.text("where") == "state 99999 is not on this page"


def test_a_condition_shows_its_states_alone(shown: Browser, checks: Sequence[Check]) -> None:
    for number in (0, 1):
        shown.follow(f"#fails={number}")
        assert shown.text("shown").startswith(f"{len(checks[number].failing)} of ")


def test_close_places_can_be_seen_alone(shown: Browser) -> None:
    shown.follow("#places=close")
    assert shown.text("shown").startswith("40 of ")
    assert "Close places" in shown.text("close")
    assert "40 close places" in shown.run(
        "return document.querySelector('[aria-labelledby=close]').innerText"
    )


def test_keys_step_jump_and_play(shown: Browser, result: Result) -> None:
    shown.press("n")
    shown.press("n")
    assert shown.text("where").startswith("state 2, ")
    shown.press("p")
    assert shown.text("where").startswith("state 1, ")
    shown.press("j")
    doubtful = np.flatnonzero(result.verdict != "safe")
    assert shown.text("where").startswith(f"state {doubtful[doubtful > 1][0]}, ")
    eventually(shown, "location.hash", f"#state={doubtful[doubtful > 1][0]}")
    shown.press(" ")
    assert shown.text("play") == "Pause"
    shown.press(" ")
    assert shown.text("play") == "Play"


def test_keys_are_named_and_can_be_switched_off(shown: Browser) -> None:
    assert shown.run("return [...document.querySelectorAll('kbd')].map((e) => e.textContent)") == [
        "n",
        "p",
        "j",
        "space",
    ]
    shown.run("document.getElementById('keys').click()")
    shown.press("n")
    assert shown.text("where").startswith("state 0, ")
    shown.run("document.getElementById('keys').click(); document.getElementById('episode').focus()")
    shown.press("n")
    assert shown.text("where").startswith("state 0, ")


def test_what_keys_choose_is_said_aloud(shown: Browser) -> None:
    shown.run("document.activeElement.blur()")
    shown.press("n")
    eventually(shown, "document.getElementById('said').textContent", shown.text("where"))
    assert shown.run("return document.getElementById('said').getAttribute('aria-live')") == "polite"


def test_episodes_that_are_not_safe_come_first(opened: Browser, result: Result) -> None:
    rows = opened.run(
        "return [...document.querySelectorAll('[aria-labelledby=episodes] tbody tr')].map((e) =>"
        " Number(e.cells[5].textContent))"
    )
    assert rows == sorted(rows, reverse=True)
    assert sum(rows) == int((result.verdict == "unsafe").sum())
    options = opened.run("return [...document.getElementById('episode').options].map((e) => e.textContent)")
    assert options[0] == "all"
    assert "unsafe" in options[1]
    assert "unsafe" not in options[-1]


def test_histograms_say_of_which_states_they_are(opened: Browser, result: Result) -> None:
    captions = opened.run("return [...document.querySelectorAll('figcaption')].map((e) => e.textContent)")
    states = len(result.verdict)
    for what in ("Width of v", "Width of ω", "Clearance at the pose"):
        assert f"{what}, all {states} driven states" in captions
    labels = opened.run(
        "return ['histogram-v', 'histogram-clearance', 'histogram-close'].map((n) =>"
        " [Figures.model(n).below[0].axis_label, Figures.model(n).left[0].axis_label])"
    )
    assert labels == [
        ["width of v [m/s]", "driven states"],
        ["clearance at the pose [m]", "driven states"],
        ["clearance at the place [m]", "close places"],
    ]


def test_the_nearest_obstacle_is_in_the_picture_of_a_close_call(shown: Browser, result: Result) -> None:
    row = int(np.argmin(result.witnesses.clearance))
    shown.follow(f"#state={result.witnesses.state[row]}")
    gap = shown.source("gap")
    (x, end_x), (y, end_y) = gap["x"], gap["y"]
    assert np.hypot(end_x - x, end_y - y) == pytest.approx(result.witnesses.clearance[row], abs=2e-3)
    ends = shown.run(
        "const { x_range: x, y_range: y } = Figures.model('situation'); return [x.start, x.end, y.start, y.end]"
    )
    assert ends[0] < end_x < ends[1]
    assert ends[2] < end_y < ends[3]


def test_a_phone_scrolls_tables_and_nothing_else(opened: Browser) -> None:
    assert opened.too_wide(360) == []
    scrollers = opened.run(
        "return [...document.querySelectorAll('.scroll')].map((e) => [e.tabIndex, e.getAttribute('role')])"
    )
    assert scrollers
    assert all(one == [0, "region"] for one in scrollers)


def test_paper_has_no_controls_and_says_what_fails(opened: Browser) -> None:
    assert opened.on_paper("button:not(.link), input, select, nav, .keys, .stepper") == 0
    assert opened.on_paper("#headline, h2.gate") == 2
    opened.run("document.getElementById('theme').click()")
    opened.run("dispatchEvent(new Event('beforeprint'))")
    try:
        assert opened.run("return document.documentElement.dataset.theme") == "light"
        assert opened.on_paper(".conditions details li") > 1
    finally:
        opened.run("dispatchEvent(new Event('afterprint')); document.getElementById('theme').click()")


def test_text_can_be_read_in_both_themes(opened: Browser) -> None:
    """Contrast of at least 4.5 (WCAG AA) between each text and what is behind it."""
    for _ in range(2):
        faint = opened.run(CONTRAST)
        assert faint == []
        opened.run("document.getElementById('theme').click()")


def test_without_a_gate_nothing_stands_before_the_headline(result: Result) -> None:
    page = render_page(StatesRun(result), ())
    assert "No gate was asked for." in page
    assert 'class="conditions"' not in page
