"""A real Chromium without a window, for the tests of the report as a page."""

from __future__ import annotations

import json
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from selenium.webdriver import Chrome
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service

BROWSERS, DRIVERS = ("chromium", "chromium-browser", "google-chrome"), ("chromedriver",)
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
PATIENCE = 120.0  # seconds for a page to open on a busy machine


def program(names: tuple[str, ...]) -> str:
    """Find a program; say what to install if there is none."""
    for name in names:
        if path := shutil.which(name):
            return path
    raise RuntimeError(
        f"the tests of the HTML report need a browser, and none of {', '.join(names)} is on the path: "
        "install it with 'apt-get install chromium chromium-driver', or see docs/report.md"
    )


class Browser:
    """A browser that opens pages from files and tells what they did."""

    def __init__(self, driver: Chrome) -> None:
        self.driver = driver

    def open(self, page: Path) -> None:
        """Open a page and wait until its figures are drawn."""
        self.driver.get_log("browser"), self.driver.get_log("performance")  # forget older pages
        self.driver.get(page.as_uri())
        limit = time.monotonic() + PATIENCE
        while self.run("return document.documentElement.dataset.whole") is None:
            if time.monotonic() > limit:
                raise TimeoutError(f"{page} did not open: {self.complaints()}")
            time.sleep(0.02)

    def run(self, script: str, *arguments: Any) -> Any:
        """Run a script in the page and return what it returns."""
        return self.driver.execute_script(script, *arguments)

    def complaints(self) -> list[str]:
        """Return what the page wrote to its console as a warning or an error."""
        return [e["message"] for e in self.driver.get_log("browser") if e["level"] in ("WARNING", "SEVERE")]

    def requests(self) -> list[str]:
        """Return the addresses that the page asked for."""
        events = [json.loads(entry["message"])["message"] for entry in self.driver.get_log("performance")]
        return [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]

    def source(self, name: str) -> dict[str, list[Any]]:
        """Return the columns that a figure draws."""
        return self.run(
            "const source = Figures.model(`${arguments[0]}-source`);"
            "return Object.fromEntries(Object.entries(source.data).map(([k, v]) => [k, Array.from(v)]));",
            name,
        )

    def text(self, identifier: str) -> str:
        """Return the text of an element."""
        return self.run("return document.getElementById(arguments[0]).textContent", identifier)

    def too_wide(self, width: int) -> list[str]:
        """Return what is wider than a window of so many pixels, but for what scrolls by itself."""
        size = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": True}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        try:
            return self.run(
                "const { clientWidth: width, scrollWidth } = document.documentElement;"
                "const free = (e) => e.closest('.scroll *, nav *, svg *, .hidden, .skip');"
                "const wide = [...document.querySelectorAll('body *')].filter((e) =>"
                " !free(e) && e.getBoundingClientRect().right > width + 1);"
                "const page = scrollWidth > width;"
                "return [...wide.map((e) => e.outerHTML.slice(0, 120)), ...(page ? ['the page'] : [])]"
            )
        finally:
            self.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})

    def on_paper(self, selector: str) -> int:
        """Return how many of some elements would be printed."""
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
        try:
            return self.run(
                "return [...document.querySelectorAll(arguments[0])].filter((e) => e.getClientRects().length).length",
                selector,
            )
        finally:
            self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})

    def follow(self, address: str) -> None:
        """Go to an address on the page, such as #state=12."""
        self.run(
            "location.hash = ''; location.hash = arguments[0]; dispatchEvent(new Event('hashchange'))",
            address,
        )

    def press(self, key: str) -> None:
        """Press a key wherever the focus is."""
        from selenium.webdriver.common.action_chains import ActionChains

        ActionChains(self.driver).send_keys(key).perform()

    def pdf(self) -> bytes:
        """Print the page."""
        from base64 import b64decode

        return b64decode(self.driver.execute_cdp_cmd("Page.printToPDF", {"printBackground": False})["data"])


@contextmanager
def running_browser(width: int = 1280, height: int = 1000) -> Iterator[Browser]:
    """Start a browser with a fresh profile, and end it."""
    options = Options()
    options.binary_location = program(BROWSERS)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        for flag in (*FLAGS, f"--user-data-dir={profile}"):
            options.add_argument(flag)
        driver = Chrome(options=options, service=Service(program(DRIVERS)))
        try:
            driver.set_window_size(width, height)
            yield Browser(driver)
        finally:
            driver.quit()
