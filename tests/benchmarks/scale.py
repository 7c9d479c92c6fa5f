"""Time and memory of long runs, beside the targets: growth with the states, workers, a Dask cluster.

    python tests/benchmarks/scale.py [--most 1000000] [--compared 100000] [--plot docs/images/scale.svg]
                                     [--json docs/results/data/scale.json] [--memory]

Runs `viatool verify` as a user does, on random poses of the lab with the swept criterion, and prints for each run
the seconds on the wall, the seconds of CPU of all processes, and the largest memory of every process, the one that was
started first. Takes about ten minutes on two quiet cores; with --memory only the largest run is done, which may be on a
busy machine.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import psutil

from tests.schedule.local_cluster import LocalCluster

PROGRAM = "from viatool.cli import main; main()"


@dataclass(frozen=True)
class Run:
    """What one run took."""

    states: int
    options: str
    wall: float
    cpu: float
    megabytes: float
    processes: tuple[float, ...]

    def __str__(self) -> str:
        each = 1e3 * self.cpu / self.states
        return (
            f"{self.states:>9,} states {self.options:<22} {self.wall:8.1f} s wall {self.cpu:8.1f} s CPU "
            f"({each:.3f} ms each) {self.megabytes:7.0f} MB of {', '.join(f'{each:.0f}' for each in self.processes)}"
        )


class Watch:
    """Looks at a process and its descendants (and at others) now and then: seconds of CPU, largest memory."""

    def __init__(self, process: psutil.Process, others: Iterable[int]) -> None:
        self.process, self.others = process, [psutil.Process(pid) for pid in others]
        self.before = sum(_cpu(other) for other in self.others)
        self.seconds: dict[int, float] = {}
        self.bytes: dict[int, int] = {}
        self.over = threading.Event()
        self.thread = threading.Thread(target=self._look, daemon=True)
        self.thread.start()

    def _look(self) -> None:
        while not self.over.wait(0.2):
            with suppress(psutil.Error):
                for seen in [self.process, *self.process.children(recursive=True), *self.others]:
                    with suppress(psutil.Error):
                        self.seconds[seen.pid] = _cpu(seen)
                        self.bytes[seen.pid] = max(self.bytes.get(seen.pid, 0), seen.memory_info().rss)

    def end(self) -> tuple[float, float, tuple[float, ...]]:
        """Return the seconds of CPU, the largest memory of any process in MB, and that of each that took 50 MB."""
        self.over.set()
        self.thread.join()
        peaks = [value / 1e6 for value in self.bytes.values()]
        cpu = sum(self.seconds.values()) - self.before
        return cpu, max(peaks), tuple(round(peak, 1) for peak in peaks if peak > 50.0)


def _cpu(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def verify(policy: str, states: int, *options: str, others: Iterable[int] = ()) -> Run:
    """Run viatool and measure it with all its processes, and with the `others` that work for it."""
    command = [
        "verify",
        policy,
        "--map",
        "maps/lab.yaml",
        "--eps",
        "0.01",
        "--poses",
        f"random:{states}",
        "-q",
    ]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    start = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-c", PROGRAM, *command, *options], cwd=ROOT, env=environment)
    watch = Watch(psutil.Process(process.pid), others)
    if process.wait():
        raise SystemExit(f"viatool failed with {process.returncode}")
    wall = time.perf_counter() - start
    shown = " ".join(options if "--scheduler" not in options else ["--scheduler", "(1 worker)"])
    run = Run(states, shown, wall, *watch.end())
    print(run, flush=True)
    return run


def judge(name: str, value: float, limit: float, unit: str, *, at_least: bool = False) -> None:
    met = value >= limit if at_least else value <= limit
    wanted = "at least" if at_least else "at most"
    print(
        f"{'met   ' if met else 'MISSED'} {name}: {value:.2f} {unit}, wanted {wanted} {limit:g} {unit}",
        flush=True,
    )


def plot(runs: list[Run], path: Path) -> None:
    """Draw time against states on logarithmic axes, beside a line of slope 1 through the largest run."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.2, 3.4), layout="constrained")
    axes = figure.subplots()
    states, wall = [run.states for run in runs], [run.wall for run in runs]
    axes.loglog(states, [wall[-1] * count / states[-1] for count in states], color="#C9CED4", label="linear")
    axes.loglog(states, wall, "o-", color="#0072B2", label="2 workers, seconds on the wall")
    axes.loglog(states, [run.cpu for run in runs], "s--", color="#D55E00", ms=4, label="seconds of CPU")
    axes.set(xlabel="states", ylabel="seconds")
    axes.grid(color="#EEEEEE")
    axes.legend(frameon=False, fontsize=8)
    figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--policy", default="policies/via.onnx")
    parser.add_argument("--most", type=int, default=1_000_000)
    parser.add_argument("--compared", type=int, default=100_000, help="states of the comparisons")
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--memory", action="store_true", help="do the largest run alone, for its memory")
    given = parser.parse_args()
    if given.memory:
        largest = verify(given.policy, given.most, "--workers", "2")
        judge(f"{given.most:,} states, memory of any process", largest.megabytes, 1500.0, "MB")
        return

    print(f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} at the start")
    verify(given.policy, 1_000, "--workers", "2")  # warm the file cache
    with tempfile.TemporaryDirectory() as folder, LocalCluster(Path(folder), workers=1) as cluster:
        verify(given.policy, 1_000, "--scheduler", cluster.address)  # let the worker import
        pids = [process.pid for process in cluster.processes]
        dask = verify(given.policy, given.compared, "--scheduler", cluster.address, others=pids)
    one = verify(given.policy, given.compared, "--workers", "1")
    two = verify(given.policy, given.compared, "--workers", "2")
    sizes = [10**power for power in range(3, 10) if 10**power <= given.most]
    runs = [verify(given.policy, count, "--workers", "2") for count in sizes]

    judge("two workers against one", one.wall / two.wall, 1.7, "times", at_least=True)
    judge("overhead of one Dask worker", 100.0 * (dask.wall / one.wall - 1.0), 15.0, "%")
    print(f"       the same in CPU: {100.0 * (dask.cpu / one.cpu - 1.0):.2f} %")
    judge(f"{runs[-1].states:,} states, wall", runs[-1].wall, 360.0 * runs[-1].states / 1e6, "s")
    judge(f"{runs[-1].states:,} states, memory of any process", runs[-1].megabytes, 1500.0, "MB")
    slope = (runs[-1].wall / runs[-2].wall) / (runs[-1].states / runs[-2].states)
    judge("growth from the last size but one, against linear", slope, 1.1, "times")
    if given.plot:
        plot(runs, given.plot)
    if given.json:
        given.json.write_text(
            json.dumps([asdict(run) for run in (dask, one, two, *runs)], indent=1) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main()
