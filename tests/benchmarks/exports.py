"""Every export that the tests make, and more: does it load, and do its bounds contain what onnxruntime computes?

    python tests/benchmarks/exports.py [--samples 100000] [--folder FOLDER] [--only TEXT]

Torch modules by the legacy and the dynamo exporter, models of Stable-Baselines3 by the recipe of the
documentation and as they are, CleanRL's recipe, and graphs as Keras, MATLAB, ML-Agents and Isaac Lab write them.
Each is loaded, which compares it with onnxruntime, and bounded around 20 observations; then onnxruntime runs
observations of the boxes (uniform, corners, faces), and the actions outside of the bounds are counted.
The exit code is 1 if one does not load or one action escapes. `--folder` keeps the models.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2]))

import torch

from tests.policy import test_exports_sb3 as sb3
from tests.policy import test_exports_shapes as shapes
from tests.policy import test_exports_torch as modules
from tests.policy.enclosure import escapes
from tests.policy.models import save
from viatool.errors import ViatoolError
from viatool.policy import describe, load_policy

STATES = 20
Maker = Callable[[Path], Any]
OLDER_OPSETS = (9, 11, 13, 17)


def exports() -> Iterator[tuple[str, str, Maker, str | None]]:
    """Yield a name, the exporter, a function that writes the model, and which output is the action."""
    for name, module in (modules.MODULES | modules.WRITTEN_OUT).items():
        for dynamo in (False, True):
            exporter = "torch dynamo" if dynamo else "torch legacy"
            yield name, exporter, partial(_write_module, module, dynamo=dynamo), None
    for name in ("Normalised", "LayerNorm", "GELU", "Chunked", "Hardswish", "Mish"):
        for opset in OLDER_OPSETS:
            writer = partial(_write_module, modules.MODULES[name], dynamo=False, opset_version=opset)
            yield name, f"torch legacy, opset {opset}", writer, None
    names = ["action", "value", "log_probability"]
    writer = partial(_write_module, modules.ActorCritic, dynamo=False, output_names=names)
    yield "ActorCritic", "torch legacy", writer, "action"
    for algorithm in ("TD3", "DDPG", "SAC", "PPO", "A2C"):
        for normalise in (False, True):
            name = f"{algorithm}{', VecNormalize folded' if normalise else ''}"
            yield name, "Stable-Baselines3, recipe", partial(_write_sb3, algorithm, normalise), None
    for algorithm in ("TD3", "DDPG", "SAC"):
        yield f"{algorithm}, bare actor", "Stable-Baselines3", partial(_write_bare, algorithm), None
    yield "CleanRL", "recipe, dynamo", _write_cleanrl, None
    for builder in (shapes.keras, shapes.matlab, shapes.isaac_lab):
        yield builder.__name__, "by hand", partial(_write_graph, builder), None
    chosen = "deterministic_continuous_actions"
    yield "ml_agents", "by hand", partial(_write_graph, shapes.ml_agents), chosen


def _write_module(module: Callable[[], Any], path: Path, *, dynamo: bool, **options: Any) -> None:
    torch.manual_seed(1)
    modules.export(module(), path, dynamo=dynamo, **options)


def _write_sb3(algorithm: str, normalise: bool, path: Path) -> None:
    torch.manual_seed(0)
    model, normaliser = sb3.trained(algorithm, normalise)
    sb3.documented_recipes()["export_sb3"](model, str(path), normaliser)


def _write_bare(algorithm: str, path: Path) -> None:
    model, _ = sb3.trained(algorithm, False)
    module = sb3.Deterministic(model.policy.actor) if algorithm == "SAC" else model.policy
    modules.export(module, path, dynamo=False)


def _write_cleanrl(path: Path) -> None:
    torch.manual_seed(0)
    linear = torch.nn.Linear
    actor = torch.nn.Sequential(linear(sb3.SIZE, 16), torch.nn.Tanh(), linear(16, 2))
    statistics = torch.linspace(-1, 1, sb3.SIZE), torch.linspace(0.5, 2, sb3.SIZE)
    modules.export(sb3.documented_recipes()["CleanRLActor"](actor, *statistics), path, dynamo=True)


def _write_graph(builder: Callable[[], Any], path: Path) -> None:
    save(builder(), path.parent, path.name)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=100_000)
    parser.add_argument("--folder", type=Path, help="keep the models there")
    parser.add_argument("--only", default="", help="exports whose name holds this text")
    options = parser.parse_args()
    began, failed, count = time.perf_counter(), 0, 0
    print("| export | written by | operators | states | samples | escapes |")
    print("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for name, exporter, write, output in exports():
            if options.only not in name:
                continue
            path = folder / f"{count:03d}.onnx"
            count += 1
            cells, passed = _tried(path, write, output, options.samples)
            failed += not passed
            print(f"| {name} | {exporter} | {cells} |", flush=True)
    print(f"\n{count} exports, {count - failed} load and contain every sample, {failed} do not; ", end="")
    print(f"{options.samples} samples each, {time.perf_counter() - began:.0f} s")
    return 1 if failed else 0


def _tried(path: Path, write: Maker, output: str | None, samples: int) -> tuple[str, bool]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        write(path)
    try:
        policy = load_policy(path, output_name=output)
    except ViatoolError as error:
        return f"{error.message.splitlines()[-1]} | 0 | 0 | refused", False
    operators = Counter(describe(path, output_name=output).operators)
    listed = " ".join(f"{name}" + (f" x{n}" if n > 1 else "") for name, n in operators.items())
    outside = escapes(policy, samples=samples, states=STATES)
    return f"{listed} | {STATES} | {samples} | {outside} |".rstrip(" |"), outside == 0


if __name__ == "__main__":
    sys.exit(main())
