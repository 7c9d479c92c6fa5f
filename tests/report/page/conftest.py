"""Results of the hall as pages, and a browser that opens them."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

import viatool
from tests.browser import Browser
from tests.hall import MAP, write_policy
from viatool.report import Check
from viatool.report.html.page import render_page
from viatool.report.states.run import StatesRun
from viatool.verification.result import Result

HOSTILE = "</script><img src=x onerror=owned=1>\"'`{{1}}|**b**\r\n::error::x\x1b[31m%0A=1]]>&amp; $x$ <!--"
FAILED = Check("safety rate >= 100.00 %", passed=False, figures="99.00 %")


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pages")
    write_policy(folder / "policy.onnx")
    (folder / "plain.yaml").write_text(MAP, encoding="utf-8")
    named = MAP.replace("name: past", f"name: {json.dumps(HOSTILE)}")
    (folder / "hostile.yaml").write_text(
        named.replace("name: hall", f"name: {json.dumps(HOSTILE)}"), encoding="utf-8"
    )
    return folder


@pytest.fixture(scope="session")
def verified(folder: Path) -> Callable[..., Result]:
    """Verify the policy of the hall on a map, with any setting."""

    def verified(name: str = "plain", **settings: object) -> Result:
        arguments = {"eps": 0.01, "close": 0, **settings}
        return viatool.verify(folder / "policy.onnx", folder / f"{name}.yaml", **arguments)

    return verified


@pytest.fixture(scope="session")
def plain(verified: Callable[..., Result]) -> Result:
    return verified()


@pytest.fixture(scope="session")
def write(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Write the page of a result."""

    def write(result: Result, most: int | None = None, checks: Sequence[Check] = (FAILED,)) -> Path:
        page = tmp_path_factory.mktemp("page") / "report.html"
        page.write_text(render_page(StatesRun(result), checks, most), encoding="utf-8")
        return page

    return write


@pytest.fixture
def show(browser: Browser, write: Callable[..., Path]) -> Callable[..., Browser]:
    """Open the page of a result."""

    def show(result: Result, most: int | None = None) -> Browser:
        browser.open(write(result, most))
        return browser

    return show
