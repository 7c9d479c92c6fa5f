"""How far the kernels of several versions of onnxruntime stray, in units of what the bounds allow them.

    python tests/benchmarks/kernels.py [--version 1.18.1 --version 1.32.0 ...] [--environments FOLDER]

Makes a virtual environment for each version (or takes those that are in the folder, named as the version), runs every
kernel of tests/kernels.py there on inputs that are hard for it, with default and with disabled optimisation, and
compares with 240-bit arithmetic. Prints the largest share of the allowed error that each uses up (1 would be all of
it), and fails if it is 1 or more; a raised 1 marks kernels that err by more than a variance in two passes explains.
"""

from __future__ import annotations

import argparse
import datetime
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.kernels import KERNELS, SIZES, Question, question

VERSIONS = ("1.18.1", "1.20.1", "1.22.1", "1.24.4", "1.26.0", "1.28.0", "1.30.0", "1.32.0")
LEVELS = ("default", "disabled")
OLD_NUMPY = ("1.18",)
"""Versions that were built for numpy 1."""


def environment(version: str, folder: Path) -> Path:
    """Return the Python of a virtual environment with one version of onnxruntime, made if there is none."""
    python = folder / version / "bin" / "python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", folder / version], check=True)
    numpy = "numpy<2" if version.startswith(OLD_NUMPY) else "numpy"
    install = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check"]
    subprocess.run([*install, f"onnxruntime=={version}", numpy], check=True)
    return python


def asked(folder: Path) -> dict[str, Question]:
    """Return every question by the name of its model, which is stored in the folder with its inputs."""
    questions = {}
    for number, (name, kernel) in enumerate(KERNELS.items()):
        for size in SIZES:
            if size > kernel.largest:
                continue
            key = f"{number}-{size}"
            questions[key] = question(kernel, size, folder / "scratch")
            (folder / f"{key}.onnx").write_bytes(questions[key].model.SerializeToString())
            points = questions[key].points.reshape(-1, *kernel.shape(size)).astype(kernel.dtype)
            np.save(folder / f"{key}.npy", points)
        print(f"asked {name}", file=sys.stderr, flush=True)
    return questions


def answers(python: Path, folder: Path) -> Mapping[str, Any]:
    """Return what one version gives."""
    target = folder / "answers.npz"
    subprocess.run([python, Path(__file__).with_name("run_models.py"), folder, target], check=True)
    return dict(np.load(target))


def cell(number: int, questions: Mapping[str, Question], found: Mapping[str, Any]) -> tuple[str, float]:
    """Return what is printed of one kernel in one version, and the largest share of what is allowed."""
    keys = [key for key in questions if key.startswith(f"{number}-")]
    shares, words = [0.0], []
    for level in LEVELS:
        given = [(questions[key], found[f"{key}/{level}"]) for key in keys if f"{key}/{level}" in found]
        if not given:
            words.append("-")
            continue
        shares.append(max(asked.used(actions) for asked, actions in given))
        one_pass = any(asked.takes_one_pass(actions) for asked, actions in given)
        words.append(f"{shares[-1]:.2f}" + ("¹" if one_pass else ""))
    return " / ".join(words), max(shares)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--version", action="append", help="of onnxruntime; may be repeated")
    parser.add_argument("--environments", type=Path, help="where virtual environments are, or shall be kept")
    arguments = parser.parse_args()
    versions = arguments.version or VERSIONS
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        (folder / "scratch").mkdir()
        questions = asked(folder)
        columns = {}
        for version in versions:
            python = environment(version, arguments.environments or folder / "environments")
            columns[version] = answers(python, folder)
    print(
        f"{datetime.date.today()}, {platform.machine()} ({processor()}), Python {platform.python_version()}\n"
    )
    print("| kernel | " + " | ".join(versions) + " | refused |")
    print("|---|" + "---|" * (len(versions) + 1))
    worst = 0.0
    for number, name in enumerate(KERNELS):
        cells = [cell(number, questions, columns[version]) for version in versions]
        worst = max(worst, *(share for _, share in cells))
        own = [q for key, q in questions.items() if key.startswith(f"{number}-")]
        refused = sum(int(np.isinf(q.allowed).any(axis=1).sum()) for q in own)
        total = sum(len(q.points) for q in own)
        print(f"| {name} | " + " | ".join(words for words, _ in cells) + f" | {refused} of {total} |")
    print(f"\nLargest share of what the bounds allow: {worst:.3f}")
    if not worst < 1:
        sys.exit("a kernel strays farther than the bounds allow")


def processor() -> str:
    """Return the name of the processor, as far as the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), "unknown")


if __name__ == "__main__":
    main()
