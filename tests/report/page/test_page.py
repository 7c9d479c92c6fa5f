"""The page as a file: whole, small, closed to the network, and with every string in its place."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from html.parser import HTMLParser

import numpy as np
import pytest

from tests.enlarged import enlarged
from tests.report.page.conftest import FAILED
from viatool.report.html.page import render_page
from viatool.report.html.states import MOST_BYTES, keep_states, pack_coarsely, page_data
from viatool.report.states.run import StatesRun
from viatool.verification.result import Result


class Outline(HTMLParser):
    """The elements of a page, their attributes, and the text of its scripts."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))


def test_the_page_refers_to_nothing_outside_of_itself(plain: Result) -> None:
    elements = Outline(render_page(StatesRun(plain), (FAILED,))).elements
    references = [a[name] for _, a in elements for name in ("src", "href", "srcset", "action") if name in a]
    assert {reference[0] for reference in references} == {"#"}
    assert not {tag for tag, _ in elements} & {"link", "iframe", "object", "embed", "base", "img"}
    (policy,) = [a["content"] for _, a in elements if a.get("http-equiv") == "Content-Security-Policy"]
    assert policy is not None
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert "unsafe-eval" not in policy
    assert "http" not in policy


def test_names_neither_add_an_element_nor_end_one(plain: Result, verified: Callable[..., Result]) -> None:
    hostile = render_page(StatesRun(verified("hostile")), (FAILED,))
    tags = [
        [tag for tag, _ in Outline(page).elements]
        for page in (hostile, render_page(StatesRun(plain), (FAILED,)))
    ]
    assert tags[0] == tags[1]
    assert "<img" not in hostile
    assert not re.search("[\x00-\x08\x0b-\x1f]", hostile)


def test_the_page_says_what_the_report_says(plain: Result) -> None:
    page, document = render_page(StatesRun(plain), (FAILED,)), StatesRun(plain).record
    overall = document.safety_rate.overall
    for text in (
        f"{overall.safe} of {overall.total}",
        document.policy.sha256,
        document.map.sha256,
        *document.versions.values(),
        FAILED.condition.replace(">", "&gt;"),
        "differential drive without slip",
        "Gate failed",
    ):
        assert text in page


def test_twenty_thousand_states_stay_below_ten_megabytes(plain: Result) -> None:
    large = enlarged(plain, 20_000)
    assert len(keep_states(large)) == 20_000
    assert len(render_page(StatesRun(large), ()).encode()) < 10_000_000


def test_a_larger_run_keeps_the_states_that_are_not_safe_and_says_so(plain: Result) -> None:
    doubtful = np.flatnonzero(plain.verdict != "safe")
    most = len(doubtful) + 5
    kept = keep_states(plain, most)
    assert len(kept) == most < len(plain.verdict)
    assert set(doubtful) <= set(kept)
    assert (np.diff(kept) > 0).all()
    page = render_page(StatesRun(plain), (), most)
    assert f"The map and the slider hold {most} of {len(plain.verdict)} states" in page
    assert "The map and the slider hold" not in render_page(StatesRun(plain), ())


def test_of_too_many_unsafe_states_some_of_everywhere_are_kept(plain: Result) -> None:
    large = enlarged(plain, 2000)
    unsafe = np.flatnonzero(large.verdict == "unsafe")
    kept = keep_states(large, 3)
    assert len(kept) == 3 < len(unsafe)
    assert set(kept) <= set(unsafe)
    assert {unsafe[0], unsafe[-1]} <= set(kept)


def test_long_observations_are_thinned_by_their_size(plain: Result) -> None:
    large = enlarged(plain, 20_000, entries=1000)
    assert len(keep_states(large)) * 2000 < MOST_BYTES


def test_numbers_are_packed_to_a_hair(plain: Result) -> None:
    packed = pack_coarsely(plain.observations)
    assert len(packed["lower"]) == plain.observations.shape[1]
    span = np.ptp(plain.observations, axis=0)
    assert np.allclose(np.array(packed["step"]) * 65535, span)


@pytest.mark.parametrize("settings", [{"only_contested": True}, {"delay": 0.05}, {"criterion": "braking"}])
def test_what_the_script_reads_is_json(verified: Callable[..., Result], settings: dict[str, object]) -> None:
    result = verified(**settings)
    assert json.dumps(page_data(result, keep_states(result)), allow_nan=False)
