"""The page in a real browser: what it draws for each state, what its controls change, and what it refuses to do."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

from tests.browser import Browser, running_browser
from tests.report.page.conftest import HOSTILE
from viatool.report.foreign import one_line
from viatool.safety import JudgedStates, ScenePoses
from viatool.simulate import Places
from viatool.verification.result import Result

Show = Callable[..., Browser]
Verified = Callable[..., Result]
SHARES = np.array([(v, omega) for v in (0.0, 0.5, 1.0) for omega in (0.0, 0.5, 1.0)])


RESET = """
for (const box of document.querySelectorAll('[data-filter]')) box.checked = true;
const list = document.getElementById('episode');
list.value = '';
list.dispatchEvent(new Event('change'));
const slider = document.getElementById('slider');
slider.value = 0;
slider.dispatchEvent(new Event('input'));
"""


@pytest.fixture(scope="module")
def opened(write: Callable[..., Path], plain: Result) -> Iterator[Browser]:
    """Open the page of the hall once, for the tests that only use its controls."""
    with running_browser() as browser:
        browser.open(write(plain))
        yield browser


@pytest.fixture
def page(opened: Browser) -> Browser:
    opened.run(RESET)
    return opened


def click(browser: Browser, selector: str) -> None:
    browser.driver.find_element(By.CSS_SELECTOR, selector).click()


def select_state(browser: Browser, place: int) -> None:
    browser.run(
        "const slider = document.getElementById('slider'); slider.value = arguments[0];"
        "slider.dispatchEvent(new Event('input'));",
        place,
    )


def drawn_states(browser: Browser, verdict: str) -> int:
    """Count the stretches of paths that are drawn for a verdict."""
    return sum(len(line) - 1 for line in browser.source(f"path-{verdict}")["x"])


def place_of(result: Result, verdict: str) -> int:
    return int(np.flatnonzero(result.verdict == verdict)[0])


def case_of(result: Result) -> JudgedStates:
    trajectory = result.trajectory
    placed = ScenePoses.of(result.world_map, trajectory.scenarios, trajectory.poses, trajectory.episode)
    return JudgedStates(result.rules, placed, result.under_way)


def test_it_opens_without_a_complaint_and_without_a_network(page: Browser) -> None:
    assert page.complaints() == []
    assert [url for url in page.requests() if not url.startswith(("file:", "data:", "blob:"))] == []
    assert len([url for url in page.requests() if url.startswith("file:")]) <= 1


def test_every_figure_has_been_painted(page: Browser) -> None:
    colours = page.run(
        "return Bokeh.documents.map((d) => { const view = Bokeh.index.get_one(d.roots()[0]);"
        " const { canvas } = view.export('png', false);"
        " const pixels = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;"
        " return new Set(new Uint32Array(pixels.buffer)).size; })"
    )
    assert len(colours) == 8
    assert min(colours) > 10


def test_every_stretch_of_every_path_is_drawn_in_the_colour_of_its_verdict(
    page: Browser, plain: Result
) -> None:
    joined = plain.episode[:-1] == plain.episode[1:]
    for verdict in ("safe", "unsafe", "unknown"):
        expected = int((plain.verdict[:-1][joined] == verdict).sum())
        assert drawn_states(page, verdict) == expected
    unsafe = plain.poses[plain.verdict == "unsafe", :2]
    drawn = page.source("dots-unsafe")
    np.testing.assert_allclose(np.column_stack([drawn["x"], drawn["y"]]), unsafe, atol=1e-5)


def test_filters_of_verdicts_change_what_is_drawn(page: Browser, plain: Result) -> None:
    click(page, "[data-filter=verdict][value=safe]")
    assert drawn_states(page, "safe") == 0
    assert len(page.source("dots-unsafe")["x"]) == int((plain.verdict == "unsafe").sum())
    assert page.text("shown").startswith(f"{int((plain.verdict != 'safe').sum())} of ")
    click(page, "[data-filter=verdict][value=safe]")
    assert drawn_states(page, "safe") > 0


def test_filters_of_outcomes_and_episodes_change_what_is_drawn(page: Browser, plain: Result) -> None:
    outcomes = plain.outcomes[plain.episode]
    for outcome in set(plain.outcomes.tolist()):
        click(page, f"[data-filter=outcome][value={outcome}]")
        left = int((outcomes != outcome).sum())
        assert page.text("shown").startswith(f"{left:,} of ")
        click(page, f"[data-filter=outcome][value={outcome}]")
    page.run(
        "const list = document.getElementById('episode'); list.value = '1';"
        "list.dispatchEvent(new Event('change'));"
    )
    first = page.source("path-safe")
    second = plain.poses[plain.episode == 1, :2]
    drawn = np.column_stack([np.concatenate(first["x"]), np.concatenate(first["y"])])
    np.testing.assert_allclose(drawn, second, atol=1e-5)


def test_an_episode_is_picked_in_its_table(page: Browser, plain: Result) -> None:
    click(page, "[data-episode='1']")
    assert page.text("shown").startswith(f"{int((plain.episode == 1).sum())} of ")
    assert page.run("return document.activeElement.id") == "slider"


def test_nothing_shown_draws_no_state(page: Browser) -> None:
    for verdict in ("safe", "unsafe", "unknown"):
        click(page, f"[data-filter=verdict][value={verdict}]")
    assert page.text("where") == "no state passes the filters"
    assert page.source("fan")["x"] == page.source("box")["left"] == page.source("arcs")["x"] == []
    assert page.complaints() == []


@pytest.mark.parametrize("state", [0, 30, 70])
def test_the_slider_shows_pose_scan_and_commands_of_a_state(page: Browser, plain: Result, state: int) -> None:
    select_state(page, state)
    here = page.source("here")
    np.testing.assert_allclose([here["x"][0], here["y"][0]], plain.poses[state, :2], atol=1e-5)
    fan = page.source("fan")
    np.testing.assert_allclose(fan["radius"], plain.observations[state, :20], atol=2e-4)
    middle = (np.array(fan["start"]) + np.array(fan["end"]))[9:11].mean() / 2
    assert middle == pytest.approx(plain.poses[state, 2], abs=1e-5)
    box, (lower, upper) = page.source("box"), plain.commands
    expected = [lower[state, 0], upper[state, 0], lower[state, 1], upper[state, 1]]
    drawn = [box[side][0] for side in ("left", "right", "bottom", "top")]
    np.testing.assert_allclose(drawn, expected, atol=1e-6)
    nine = page.source("nine")
    np.testing.assert_allclose(
        np.column_stack([nine["v"], nine["omega"]]),
        lower[state] + SHARES * (upper[state] - lower[state]),
        atol=1e-6,
    )
    assert f"state {state}, " in page.text("where")


def test_the_widths_are_those_of_the_episode(page: Browser, plain: Result) -> None:
    select_state(page, len(plain.verdict) - 1)
    curve, states = page.source("width-line-1"), plain.episode == 1
    np.testing.assert_allclose(curve["x"], plain.trajectory.time[states], atol=1e-5)
    np.testing.assert_allclose(curve["y"], plain.reachable.width[states, 1], atol=1e-6)


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"criterion": "braking"},
        {"criterion": "braking", "footprint": [[-0.1, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.1, 0.1]]},
        {"delay": 0.2, "footprint": 0.1},
    ],
    ids=["swept", "braking", "braking polygon", "delayed disc"],
)
def test_arcs_and_tubes_are_where_the_criteria_judge(
    show: Show, verified: Verified, settings: dict[str, Any]
) -> None:
    result = verified(eps=0.1, **settings)
    browser, state = show(result), 40
    select_state(browser, state)
    lower, upper = result.commands
    commands = lower[state] + SHARES * (upper[state] - lower[state])
    here = case_of(result).select(np.array([state]))
    paths = here.paths(commands[None], np.linspace(0.0, 1.0, 13))[0]
    acting = paths[:, -13:, :2]
    arcs = browser.source("arcs")
    np.testing.assert_allclose(np.stack([arcs["x"], arcs["y"]], axis=2), acting, atol=1e-5)
    corners = result.rules.footprint.polygon if result.rules.footprint.kind == "polygon" else np.zeros((1, 2))
    cosine, sine = np.cos(paths[..., 2, None]), np.sin(paths[..., 2, None])
    places = np.stack(
        [
            paths[..., 0, None] + cosine * corners[:, 0] - sine * corners[:, 1],
            paths[..., 1, None] + sine * corners[:, 0] + cosine * corners[:, 1],
        ],
        axis=-1,
    ).reshape(-1, 2)
    away = result.rules.clearance.collision + (
        result.rules.footprint.radius if result.rules.footprint.kind == "circle" else 0.0
    )
    check_tube(browser.source("collision-tube"), places, away)


def check_tube(tube: dict[str, list[float]], places: np.ndarray, distance: float) -> None:
    """The tube's border is as far from the hull of the places as it says."""
    import shapely

    hull = shapely.convex_hull(shapely.multipoints(places))
    border = shapely.points(np.column_stack([tube["x"], tube["y"]]))
    np.testing.assert_allclose(shapely.distance(hull, border), distance, rtol=0.003)


def test_an_unsafe_state_shows_its_counterexample(page: Browser, plain: Result) -> None:
    state = place_of(plain, "unsafe")
    select_state(page, state)
    (row,) = np.flatnonzero(plain.witnesses.state == state)
    command = page.source("witness-command")
    np.testing.assert_allclose([command["v"][0], command["omega"][0]], plain.witnesses.action[row], atol=1e-6)
    closest = page.source("witness-pose")
    np.testing.assert_allclose([closest["x"][0], closest["y"][0]], plain.witnesses.pose[row, :2], atol=1e-5)
    assert f"{plain.witnesses.clearance[row]:.6f} m are left" in page.text("facts")
    select_state(page, 0)
    assert page.source("witness-path")["x"] == []


def test_a_click_on_the_map_selects_the_nearest_state(page: Browser, plain: Result) -> None:
    x, y = plain.poses[30, :2] + [0.001, 0.001]
    page.run(
        "Figures.model('map').trigger_event({event_name: 'tap', x: arguments[0], y: arguments[1]})", x, y
    )
    assert "state 30, " in page.text("where")


def test_the_keyboard_reaches_and_moves_everything(page: Browser, plain: Result) -> None:
    driver = page.driver
    seen = []
    page.run("document.querySelector('.skip').focus()")
    driver.switch_to.active_element.send_keys(Keys.TAB)
    for _ in range(40):
        seen.append(page.run("return document.activeElement.id || document.activeElement.value"))
        if seen[-1] == "doubtful":
            break
        driver.switch_to.active_element.send_keys(Keys.TAB)
    for stop in ("theme", "safe", "unsafe", "episode", "slider", "play", "doubtful"):
        assert stop in seen
    driver.switch_to.active_element.send_keys(Keys.ENTER)
    assert ": unsafe" in page.text("where") or ": unknown" in page.text("where")
    slider = driver.find_element(By.ID, "slider")
    slider.send_keys(Keys.HOME)
    assert "state 0, " in page.text("where")
    slider.send_keys(Keys.ARROW_RIGHT)
    assert "state 1, " in page.text("where")
    slider.send_keys(Keys.END)
    assert f"state {len(plain.verdict) - 1}, " in page.text("where")
    assert slider.get_attribute("aria-valuetext") == page.text("where")
    box = driver.find_element(By.CSS_SELECTOR, "[data-filter=verdict][value=safe]")
    box.send_keys(Keys.SPACE)
    assert drawn_states(page, "safe") == 0


def test_every_control_has_a_name(page: Browser) -> None:
    nameless = page.run(
        "return [...document.querySelectorAll('button, input, select, [role=img]')].filter((e) =>"
        " !(e.getAttribute('aria-label') || e.textContent.trim() || e.labels?.length)).map((e) => e.outerHTML)"
    )
    assert nameless == []


def test_dark_and_light_are_two_themes(page: Browser) -> None:
    colours = []
    for _ in range(2):
        colours.append(
            page.run(
                "return [getComputedStyle(document.body).backgroundColor,"
                " Figures.model('map').background_fill_color,"
                " Figures.model('commands').below[0].axis_label_text_color]"
            )
        )
        click(page, "#theme")
    assert all(light != dark for light, dark in zip(*colours, strict=True))


def test_a_sheet_of_paper_gets_pictures_of_the_figures(page: Browser) -> None:
    sizes = page.run(
        "dispatchEvent(new Event('beforeprint'));"
        "const pictures = [...document.querySelectorAll('.snapshot')].map((i) => i.src.length);"
        "dispatchEvent(new Event('afterprint'));"
        "return [pictures, document.querySelectorAll('.snapshot').length]"
    )
    assert len(sizes[0]) == 8
    assert min(sizes[0]) > 1000
    assert sizes[1] == 0
    assert page.pdf().startswith(b"%PDF")
    assert page.complaints() == []


def test_hostile_names_are_text_and_nothing_else(show: Show, verified: Verified) -> None:
    browser = show(verified("hostile"))
    assert browser.complaints() == []
    assert browser.run("return [typeof owned, document.querySelectorAll('main img').length]") == [
        "undefined",
        0,
    ]
    option = browser.run("return document.getElementById('episode').options[1].text")
    assert " ".join(one_line(HOSTILE).split()) in option
    assert browser.run("return document.querySelectorAll('script').length") == browser.run(
        "return document.querySelectorAll('body > script').length"
    )


def test_the_browser_refuses_a_script_that_was_slipped_in(page: Browser) -> None:
    page.run(
        "const script = document.createElement('script'); script.textContent = 'owned = 1';"
        "document.body.append(script);"
    )
    assert page.run("return typeof owned") == "undefined"
    assert any("Content Security Policy" in text for text in page.complaints())


def test_sampled_poses_are_points(show: Show, verified: Verified) -> None:
    result = verified(places=Places(spacing=0.5))
    browser = show(result)
    assert browser.complaints() == []
    assert len(browser.source("dots-safe")["x"]) == int((result.verdict == "safe").sum())
    assert browser.source("path-safe")["x"] == []


def test_states_without_bounds_say_so(show: Show, verified: Verified) -> None:
    result = verified(only_contested=True)
    browser = show(result)
    select_state(browser, int(np.flatnonzero(~result.contested.either)[0]))
    assert "geometry alone settles" in browser.text("facts")
    assert browser.source("box")["left"] == []
    assert browser.complaints() == []


def test_a_thinned_page_still_steps_through_its_states(show: Show, plain: Result) -> None:
    browser = show(plain, 20)
    assert "hold 20 of" in browser.text("thinned")
    assert browser.text("shown") == "20 of 20 states shown"
    click(browser, "#forward")
    assert browser.complaints() == []


def test_close_places_are_drawn_told_apart_and_filtered(show: Show, verified: Verified) -> None:
    result = verified(close=40)
    assert result.close is not None
    browser = show(result)
    assert browser.complaints() == []
    for verdict in ("safe", "unsafe", "unknown"):
        drawn, some = browser.source(f"close-{verdict}"), result.close.verdict == verdict
        np.testing.assert_allclose(
            np.column_stack([drawn["x"], drawn["y"]]).reshape(-1, 2), result.close.poses[some, :2], atol=1e-5
        )
    driven = result.poses[result.verdict == "unsafe", :2]
    drawn = browser.source("dots-unsafe")
    np.testing.assert_allclose(np.column_stack([drawn["x"], drawn["y"]]).reshape(-1, 2), driven, atol=1e-5)
    total = len(result.verdict) + 40
    assert browser.text("shown") == f"{total} of {total} states and close places shown"
    select_state(browser, total - 1)
    assert browser.text("where").startswith("close place 39, beside ")
    browser.run("document.querySelector('[data-filter=place][value=\"1\"]').click()")
    assert browser.text("shown") == f"{total - 40} of {total} states and close places shown"
    assert browser.source("close-safe")["x"] == []
