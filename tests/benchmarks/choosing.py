"""What a set for each command is worth over sets of poses, against one box around all possible commands; the same run.

    python tests/benchmarks/choosing.py maps/lab.yaml --sample 0.003 --steps 5

Certifies, looks ahead and follows tubes of policies/via.onnx with a table of commands, of which it chooses the one that
is nearest to its own command, and of the zoo's DQN layout, whose weights are random.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from viatool import load_map, load_policy, verify
from viatool.places import Lookahead, Resolution, SearchBudget, certify
from viatool.safety.pieces import CommandPieces

TABLE = [[0.5, 0.0], [0.4, 0.5], [0.4, -0.5], [0.1, 1.0], [0.1, -1.0]]
WEIGHT = np.array([4.0, 1.0])
DQN = Path("examples/zoo/robotis_dqn")


def write_choosing(source: Path, target: Path) -> Path:
    """Write a policy of two commands as one that chooses the row of the table which is nearest to its command."""
    model, policy = onnx.load(source), load_policy(source)
    table = np.array(TABLE)
    weight, offset = 2.0 * table * WEIGHT, -(table**2 * WEIGHT).sum(axis=1)
    name, graph = model.graph.output[0].name, model.graph
    for array, called in ((weight, "of_rows"), (offset, "of_table")):
        graph.initializer.append(numpy_helper.from_array(array.astype(np.float32), called))
    graph.node.append(helper.make_node("Gemm", [name, "of_rows", "of_table"], ["values"], transB=1))
    del graph.output[:]
    graph.output.append(helper.make_tensor_value_info("values", TensorProto.FLOAT, ["batch", len(TABLE)]))
    told = policy.spec.model_dump(mode="json", exclude_none=True)
    told["schema_version"] = 2
    told["action"] = [{"name": "move", "kind": "choice", "axes": ["linear", "angular"], "commands": TABLE}]
    helper.set_model_props(model, {"viatool.spec": type(policy.spec).model_validate(told).to_json()})
    onnx.save(model, target)
    return target


@contextmanager
def one_box() -> Iterator[None]:
    """Take one box around all pieces of a state, as it was before."""
    apart = CommandPieces.of_parts.__func__

    def together(cls, *given):
        pieces = apart(cls, *given)
        return cls(np.arange(pieces.count), *pieces.hull(), pieces.count)

    CommandPieces.of_parts = classmethod(together)
    try:
        yield
    finally:
        CommandPieces.of_parts = classmethod(apart)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("map", type=Path)
    options.add_argument("--sample", type=float, default=0.003)
    options.add_argument("--smallest", type=float, default=0.04)
    options.add_argument("--steps", type=int, default=5)
    options.add_argument("--whole", type=float, default=0.08, help="smallest side for --steps")
    options.add_argument("--states", type=int, default=100)
    options.add_argument("--eps", type=float, default=0.01)
    given = options.parse_args()
    with TemporaryDirectory() as folder:
        chosen = write_choosing(Path("policies/via.onnx"), Path(folder) / "choosing.onnx")
        for name, policy, world in (
            ("via.onnx, five commands", load_policy(chosen), load_map(given.map)),
            (
                "robotis_dqn",
                load_policy(DQN / "policy.onnx", DQN / "specification.yaml"),
                load_map(DQN.parent / "room.yaml"),
            ),
        ):
            print(name)
            compare(policy, world, given)


def compare(policy, world, given):
    """Print what is found with one box, and with a set for each command."""
    for words, around in (("one box", one_box), ("each command", None)):
        start = time.process_time()
        if around is None:
            lines = measured(policy, world, given)
        else:
            with around():
                lines = measured(policy, world, given)
        print(f"  {words:13s} {lines}  CPU {time.process_time() - start:.0f} s", flush=True)


def measured(policy, world, given):
    """Return the shares of one way."""
    scenario = world.scenarios[0]
    found = certify(
        policy, world, scenario, eps=given.eps, resolution=Resolution(given.smallest, 1),
        budget=SearchBudget(share=given.sample),
    )  # fmt: skip
    words = [f"certified {shares(found.contested)}, decided {shares(found.decided)} of contested"]
    if given.steps:
        lasting = certify(
            policy, world, scenario, eps=given.eps, resolution=Resolution(given.whole, 0),
            lookahead=Lookahead(given.steps, for_ever=True),
        ).lasting  # fmt: skip
        free, held = int(lasting.free.sum()), int(lasting.for_ever.sum())
        words.append(
            f"{given.steps} steps {shares((lasting.by_steps()[-1][1], free))}, for ever {shares((held, free))}"
        )
    if given.states:
        result = verify(
            policy, world, eps=given.eps, scenarios=[scenario], horizon=10, refine="none",
        )  # fmt: skip
        tubes = result.horizon.tubes
        ends = tubes.upper[:, 4, :2] - tubes.lower[:, 4, :2]
        width = np.median(np.hypot(*ends.T)[np.isfinite(ends[:, 0])])
        words.append(
            f"10 steps safe from {int(tubes.safe.sum())}/{len(tubes)} states, 5th end {100 * width:.1f} cm wide"
        )
    return "; ".join(words)


def shares(parts):
    """Return a share in words."""
    return f"{100.0 * parts[0] / max(parts[1], 1):.2f} %"


if __name__ == "__main__":
    main()
