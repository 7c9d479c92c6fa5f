"""How long ``viatool --help`` takes: run it with ``python tests/benchmarks/startup.py``."""

from __future__ import annotations

import subprocess
import sys
import time

RUNS = 20


def main() -> None:
    program = "from viatool.cli import main; main(['--help'])"
    seconds = []
    for _ in range(RUNS):
        started = time.perf_counter()
        subprocess.run([sys.executable, "-c", program], check=True, stdout=subprocess.DEVNULL)
        seconds.append(time.perf_counter() - started)
    seconds.sort()
    print(f"viatool --help: median {seconds[RUNS // 2]:.3f} s, best {seconds[0]:.3f} s, asked for 0.3 s")


if __name__ == "__main__":
    main()
