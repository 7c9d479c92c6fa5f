"""What every command costs on every layout of the zoo: a row each, run by itself in a process with one thread.

    python -m tests.benchmarks.zoo
    python -m tests.benchmarks.zoo --layout navrep --command verify

Processor seconds are those of the process, start-up included; memory is its peak. An exit code of 2 is a refusal: what
it says stands below the table. `--most` is how many processor seconds a command may take; the script fails where one
takes more.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ZOO = Path(__file__).parents[2] / "examples" / "zoo"
THREADS = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
COMMANDS = {
    "inspect": (),
    "simulate": ("--map", "MAP"),
    "verify": ("--map", "MAP", "--eps", "0.01"),
    "certify": ("--map", "MAP", "--eps", "0.01", "--scenario", "0", "--sample", "SHARE"),
}
"""Each command with its options; all others are as they are by default."""

SHARES = {"metadrive": 0.1, "navrep": 0.2, "ros_jackal": 0.1}
"""By how much less of a map certify examines: of an arena many times the room's, and where one cell takes long."""


@dataclass(frozen=True)
class Run:
    """One command that has ended.

    Parameters
    ----------
    processor, wall : float
        Seconds.
    memory : float
        The most it held, in MB.
    code : int
        Its exit code.
    said : str
        Its error, or what of its report says the most in one line.
    """

    processor: float
    wall: float
    memory: float
    code: int
    said: str


def main() -> int:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--layout", action="append", help="only this one; repeatable")
    options.add_argument("--command", action="append", choices=COMMANDS, help="only this one; repeatable")
    options.add_argument(
        "--sample", type=float, default=0.0001, help="share of the map that certify examines"
    )
    options.add_argument("--most", type=float, default=60.0)
    given = options.parse_args()
    refused: list[str] = []
    slow = 0
    print("| layout | command | CPU s | wall s | peak MB | exit | said |")
    print("|---|---|---|---|---|---|---|")
    for layout in given.layout or sorted(path.parent.name for path in ZOO.glob("*/specification.yaml")):
        for command in given.command or COMMANDS:
            run = measured(list(arguments(command, layout, given.sample)))
            slow += run.processor >= given.most
            if run.code:
                refused.append(f"- {layout}, {command}: {run.said}")
            spent = f"{run.processor:.1f} | {run.wall:.1f} | {run.memory:.0f}"
            said = "refused" if run.code else run.said
            print(f"| {layout} | {command} | {spent} | {run.code} | {said} |", flush=True)
    print("", *refused, sep="\n")
    print(f"\n{slow} took {given.most:g} s or more")
    return int(slow > 0)


def arguments(command: str, layout: str, share: float) -> Iterator[str]:
    """Yield the words of a command line."""
    folder = ZOO / layout
    own = folder / "map.yaml"
    chosen = {
        "MAP": str(own if own.exists() else ZOO / "room.yaml"),
        "SHARE": f"{share * SHARES.get(layout, 1.0):g}",
    }
    yield from (command, str(folder / "policy.onnx"), "--spec", str(folder / "specification.yaml"))
    yield from (chosen.get(word, word) for word in COMMANDS[command])


def measured(words: Sequence[str]) -> Run:
    """Run a command to its end."""
    with tempfile.TemporaryFile("w+") as output, tempfile.TemporaryFile("w+") as errors:
        begun = time.perf_counter()
        child = subprocess.Popen(
            [sys.executable, "-m", "viatool", *words], stdout=output, stderr=errors, env=os.environ | THREADS
        )
        _, status, used = os.wait4(child.pid, 0)
        wall = time.perf_counter() - begun
        child.returncode = os.waitstatus_to_exitcode(status)
        told = {}
        for name, stream in (("stdout", output), ("stderr", errors)):
            stream.seek(0)
            told[name] = [line.strip() for line in stream.read().splitlines() if line.strip()]
    return Run(*_spent(used), wall, _memory(used), child.returncode, _said(child.returncode, **told))


def _spent(used: resource.struct_rusage) -> tuple[float]:
    return (used.ru_utime + used.ru_stime,)


def _memory(used: resource.struct_rusage) -> float:
    return used.ru_maxrss / 1024.0


def _said(code: int, stdout: Sequence[str], stderr: Sequence[str]) -> str:
    """Return what a command said of its end, on one line."""
    told = [line for line in stdout if " % of " in line or line.startswith("onnxruntime")]
    lines = [line for line in stderr if line.startswith("error")] if code else told
    return (lines or [""])[0].replace("|", "/")


if __name__ == "__main__":
    sys.exit(main())
