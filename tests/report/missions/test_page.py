"""The page of missions: what it draws holds every part, and in a real browser it can be played."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.browser import Browser
from tests.hall import MAP, write_policy
from tests.missions.dodging import write_dodging_policy
from viatool import load_map
from viatool.missions import Missions, mission
from viatool.report.gate import Gate, evaluate, parse_threshold
from viatool.report.missions.html.data import drawn_parts, goal_outlines, kept_by_tube, page_data
from viatool.report.missions.html.page import render_page
from viatool.report.missions.run import MissionsRun
from viatool.world import Scenes

HOSTILE = "</script><img src=x onerror=owned=1>"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("missions")
    text = MAP.replace("name: past", f"name: {json.dumps(HOSTILE)}")
    (folder / "hall.yaml").write_text(text, encoding="utf-8")
    write_dodging_policy(folder / "dodging.onnx")
    write_policy(folder / "straight.onnx")
    return folder


@pytest.fixture(scope="module")
def proved(folder: Path) -> Missions:
    return mission(
        folder / "dodging.onnx", folder / "hall.yaml", eps=0.01, start_error=(0.02, 0.02), time_limit=9.0
    )


@pytest.fixture(scope="module")
def opened(browser: Browser, proved: Missions, tmp_path_factory: pytest.TempPathFactory) -> Browser:
    page = tmp_path_factory.mktemp("page") / "missions.html"
    page.write_text(render_page(MissionsRun(proved), ()), encoding="utf-8")
    assert page.stat().st_size < 10_000_000
    browser.open(page)
    return browser


def turn_to(browser: Browser, step: int) -> None:
    browser.run(
        "const slider = document.getElementById('slider'); slider.value = arguments[0];"
        "slider.dispatchEvent(new Event('input'));",
        step,
    )


@pytest.mark.parametrize("room", [30, 500, 100_000])
def test_what_is_drawn_holds_every_part(room: int) -> None:
    generator = np.random.default_rng(0)
    steps = np.sort(generator.integers(1, 10, 3000))
    lower = generator.uniform(-2.0, 2.0, (3000, 5))
    upper = lower + generator.uniform(0.0, 0.1, (3000, 5))
    step, low, high = drawn_parts(steps, lower, upper, room)
    assert len(step) <= max(room, 9 * 8)
    for number in range(1, 10):
        mine, drawn = steps == number, step == number
        held = (low[drawn] <= lower[mine, None, :3]) & (high[drawn] >= upper[mine, None, :3])
        assert held.all(axis=2).any(axis=1).all()


def test_distances_are_below_those_of_every_place_of_a_part(proved: Missions) -> None:
    one = proved.missions[0]
    scenes, tube = Scenes.of(proved.world_map, [one.scenario]), one.proof.tube
    kept = kept_by_tube(tube.step, tube.lower, tube.upper, scenes, 0)
    share = np.random.default_rng(1).random((len(tube.step), 2))
    places = tube.lower[:, :2] + share * (tube.upper - tube.lower)[:, :2]
    away = scenes.clearance(places, np.zeros(len(places), np.int64))
    assert (away >= kept[tube.step] - 1e-9).all()
    assert np.nanmin(kept) > 0.35


def test_goals_are_outlined(proved: Missions) -> None:
    (ring,) = goal_outlines(proved.missions[0], proved)
    away = np.hypot(*(np.array(ring) - proved.missions[0].scenario.goal).T)
    np.testing.assert_allclose(away, 0.5)


def test_a_refuted_mission_shows_where_its_run_ends(folder: Path) -> None:
    found = mission(folder / "straight.onnx", load_map(folder / "hall.yaml"), eps=0.01, time_limit=9.0)
    data = page_data(found)
    refuted = data["missions"][0]
    assert refuted["verdict"] == "refuted"
    assert refuted["end"] == found.missions[0].crashes.place[0, :2].tolist()
    json.dumps(data, allow_nan=False)


def test_it_opens_without_a_complaint_and_without_a_network(opened: Browser) -> None:
    assert opened.complaints() == []
    assert [url for url in opened.requests() if not url.startswith(("file:", "data:", "blob:"))] == []
    assert opened.run("return window.owned") is None
    assert opened.run("return document.getElementById('mission').options.length") == 2


def test_the_slider_shows_the_parts_and_the_runs_of_each_interval(opened: Browser, proved: Missions) -> None:
    one = proved.missions[0]
    turn_to(opened, 20)
    tube, drawn = one.proof.tube, opened.source("tube")
    rows = tube.step == 20
    np.testing.assert_allclose(np.sort(drawn["left"]), np.sort(tube.lower[rows, 0]), atol=1e-6)
    np.testing.assert_allclose(np.sort(drawn["top"]), np.sort(tube.upper[rows, 1]), atol=1e-6)
    robots = opened.source("robots")
    np.testing.assert_allclose(np.array(robots["x"]), one.paths[:, 20, 0], atol=1e-6)
    assert len(opened.source("ways")["x"][0]) == 21
    words = opened.run("return document.getElementById('where').textContent")
    assert f", after 2.00 s: {rows.sum()} parts" in words
    turn_to(opened, 0)
    assert opened.source("tube")["left"] == []


def test_it_plays_until_every_run_has_arrived(opened: Browser, proved: Missions) -> None:
    last = int(opened.run("return document.getElementById('slider').max"))
    assert last >= proved.missions[0].steps - 1
    turn_to(opened, last)
    opened.run("document.getElementById('back').click()")
    assert int(opened.run("return document.getElementById('slider').value")) == last - 1
    opened.run("document.getElementById('play').click()")
    assert opened.run("return document.getElementById('play').textContent") == "Pause"
    opened.run("document.getElementById('play').click()")


def test_another_mission_is_shown_when_it_is_chosen(opened: Browser) -> None:
    opened.run("document.querySelector('tbody a[href=\"#mission=1\"]').click()")
    assert opened.run("return document.getElementById('mission').value") == "1"
    opened.run("document.getElementById('wide').click(); document.getElementById('theme').click()")
    goal = opened.source("goal")
    np.testing.assert_allclose(np.mean(goal["y"][0][:-1]), -2.0, atol=1e-6)
    assert opened.complaints() == []


def test_missions_that_are_not_proved_come_first_and_can_be_seen_alone(
    opened: Browser, folder: Path, tmp_path: Path
) -> None:
    document = MissionsRun(mission(folder / "straight.onnx", folder / "hall.yaml", eps=0.01, time_limit=9.0))
    verdicts = [one.verdict for one in document.record.missions]
    checks = evaluate(Gate((parse_threshold("1", MissionsRun),)), document)
    failing = [one.key[1] for one in checks[0].failing]
    assert 0 < len(failing) < len(verdicts)
    (tmp_path / "missions.html").write_text(render_page(document, checks), encoding="utf-8")
    opened.open(tmp_path / "missions.html")
    assert opened.complaints() == []
    words = opened.run("return document.querySelector('main').innerText")
    assert words.index("Gate failed") < words.index("of 2 missions are proved")
    assert int(opened.run("return document.getElementById('mission').value")) == failing[0]
    listed = opened.run(
        "return [...document.querySelectorAll('.conditions details > ul a')].map((e) => e.getAttribute('href'))"
    )
    assert listed == [f"#mission={number}" for number in failing]
    opened.follow(f"#mission={verdicts.index('proved')}")
    opened.press("j")
    assert int(opened.run("return document.getElementById('mission').value")) == failing[0]
    opened.follow("#fails=0")
    rows = opened.run("return [...document.querySelectorAll('tr[data-fails]:not([hidden]) a')].length")
    assert rows == len(failing) == opened.run("return document.getElementById('mission').options.length")
    opened.press("p")
    last = int(opened.run("return document.getElementById('slider').max"))
    assert int(opened.run("return document.getElementById('slider').value")) == last - 1
    assert opened.too_wide(360) == []
    assert opened.on_paper("button, input, select, nav, .keys, .stepper") == 0
