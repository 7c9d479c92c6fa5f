"""The page of margins in a real browser: it runs nothing that it does not carry, and shows every state."""

from __future__ import annotations

from pathlib import Path

import viatool
from tests.browser import running_browser
from viatool.report.margins.html.page import render_page
from viatool.report.margins.run import MarginsRun
from viatool.report.sections import Check
from viatool.simulate import Places


def test_the_page_shows_the_curve_and_the_states(tmp_path: Path) -> None:
    margins = [
        viatool.margin(name, "lab", places=Places(count=400), resolution=0.1) for name in ("via", "td3")
    ]
    failed = Check(
        "error that every contested state survives >= 0.02", passed=False, figures="state 1 (not even 0)"
    )
    page = tmp_path / "margins.html"
    page.write_text(render_page(MarginsRun(*margins), [failed]), encoding="utf-8")
    with running_browser() as browser:
        browser.open(page)
        assert browser.complaints() == []
        shown = browser.run(
            "return [document.querySelector('h1').innerText, document.querySelector('img.picture').naturalWidth,"
            "document.querySelectorAll('#explorer tbody tr').length, document.querySelector('.gate').innerText]"
        )
        title, width, rows, gate = shown
        assert "put to the test in via: " in title
        assert width > 100
        assert rows == sum(map(len, margins))
        assert "failed" in gate
        browser.run("document.getElementById('theme').click()")
        assert browser.run("return document.documentElement.dataset.theme") in ("dark", "light")
