"""How fast the HTML report opens and follows its slider, in headless Chromium without a GPU.

    python -m tests.benchmarks.html_page [STATES ...]

Prints the size of the page, the seconds until the map can be used and until every figure is there, the processor time
of the page's main thread until then, and the time from one state of the slider to the next one drawn.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

import viatool
from tests.browser import PATIENCE, Browser, running_browser
from tests.enlarged import enlarged
from viatool.report.html.page import render_page
from viatool.report.states.run import StatesRun

MOVES = 20
RUNS = 3
MOVE = """
const [moves, done] = arguments;
const slider = document.getElementById('slider');
let move = 0;
const start = performance.now();
const next = () => {
  if (move === moves) return done((performance.now() - start) / moves);
  slider.value = ++move;
  slider.dispatchEvent(new Event('input'));
  requestAnimationFrame(() => setTimeout(next));
};
next();
"""


def thread_seconds(driver: int) -> float:
    """Return what the main thread of the page has used so far: its process is the renderer that worked most."""
    most, waiting = 0.0, [driver]
    while waiting:
        each = waiting.pop()
        try:
            for task in Path(f"/proc/{each}/task").iterdir():
                waiting += map(int, (task / "children").read_text().split())
            if b"--type=renderer" not in Path(f"/proc/{each}/cmdline").read_bytes():
                continue
            fields = Path(f"/proc/{each}/task/{each}/stat").read_text().rpartition(")")[2].split()
        except OSError:  # it has ended
            continue
        most = max(most, (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK"))
    return most


def measure(page: Path) -> tuple[float, float, float, float]:
    """Return seconds until usable, until whole, of the page's main thread, and milliseconds for a move."""
    with running_browser() as browser:
        browser.open(page)
        used = thread_seconds(browser.driver.service.process.pid)
        usable = browser.run("return Number(document.documentElement.dataset.usable)") / 1000
        whole = browser.run("return Number(document.documentElement.dataset.whole)") / 1000
        return usable, whole, used, move(browser)


def move(browser: Browser) -> float:
    browser.driver.set_script_timeout(PATIENCE)
    return float(browser.driver.execute_async_script(MOVE, MOVES))


def main(sizes: list[int]) -> None:
    result = viatool.verify("policies/via.onnx", "maps/lab.yaml", eps=0.05, only_contested=True)
    print(f"load of the machine before: {os.getloadavg()[0]:.1f}")
    print(
        "| states | page [MB] | made in [s] | usable after [s] | whole after [s] | main thread [s] | one move [ms] |"
    )
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for states in sizes:
            large = enlarged(result, states)
            start = time.process_time()
            content = render_page(StatesRun(large), ())
            made = time.process_time() - start
            page = Path(folder) / "report.html"
            page.write_text(content, encoding="utf-8")
            best = [min(figures) for figures in zip(*(measure(page) for _ in range(RUNS)), strict=True)]
            cells = [f"{states:,}", f"{len(content) / 1e6:.2f}", f"{made:.2f}", *(f"{x:.2f}" for x in best)]
            print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main([int(text) for text in sys.argv[1:]] or [1_252, 20_000, 100_000])
