"""Evaluate the policies of this folder; write NAME.yaml, NAME.json and the table of README.md.

    OMP_NUM_THREADS=1 python policies/evaluate.py [NAME ...]

Every policy drives the ten fixed scenarios of the lab and 500 random ones that its training used for nothing; the
states of the fixed ones are verified with a sensor error of 0.01 in every channel. NAME.yaml is the training
configuration that the file's own specification tells, ready for ``viatool train --config``.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import viatool
from viatool.policy import Activation, Policy, load_policy
from viatool.train import TrainingMaps, load_configuration
from viatool.train.selection import evaluate_policy

HERE = Path(__file__).parent
MAP = HERE.parent / "maps" / "lab.yaml"
EPS = 0.01
# What older policies were trained with before these options existed.
FORMERLY = {
    "mirror": False,
    "steering_penalty": 0.0,
    "standing_penalty": 0.0,
    "shaping_form": "potential",
    "shaping_path": "straight",
    "shaping_narrow": 0.0,
    "shaping_capped": False,
    "budget_rule": "recursive",
}
HEAD = (
    "| file | actor | success | collisions | timeouts | cost | fixed scenarios | proved safe | sampled | "
    "width of v | width of omega |\n|---|---|---|---|---|---|---|---|---|---|---|\n"
)


def record_of(policy: Policy) -> dict[str, Any]:
    """Return what the policy does, as plain numbers."""
    assert policy.spec is not None
    world_map = viatool.load_map(MAP)
    driven = evaluate_policy(
        policy, TrainingMaps((world_map,)), load_configuration(policy.path.with_suffix(".yaml"))
    ).metrics
    result = viatool.verify(policy, world_map, eps=EPS)
    width = np.mean(result.upper - result.lower, axis=0)
    training = {name: policy.spec.training.get(name) for name in ("method", "seed", "epoch")}
    return {
        "sha256": policy.sha256,
        "actor": actor_of(policy),
        "training": training,
        "map": {"path": "maps/lab.yaml", "sha256": world_map.sha256},
        **driven,
        "verification": {
            "eps": EPS,
            "states": result.safety_rate.overall.total,
            "safety_rate": result.safety_rate.to_json(),
            "sampled_safety_rate": result.sampled_safety_rate.to_json(),
            "danger_rate": result.danger_rate.to_json(),
            "reachable_width": {"v": float(width[0]), "omega": float(width[1])},
        },
        "specification": policy.spec.model_dump(mode="json", exclude={"training"}),
    }


def actor_of(policy: Policy) -> str:
    """Return the shape of the actor, without the affine maps around it."""
    activations = [node for node in policy.network.nodes if isinstance(node, Activation)]
    hidden = [node for node in activations if node.function.name != "Clip"][:-1]
    sizes = " x ".join(str(node.size) for node in hidden)
    return f"{sizes} {hidden[0].function.name}, tanh output"


def row_of(name: str, record: dict[str, Any]) -> str:
    """Return the line of the table."""
    held_out, proved = record["held_out"], record["verification"]
    reached = round(record["fixed"]["success_rate"] * record["fixed"]["episodes"])
    cells = [
        f"`{name}.onnx`",
        record["actor"],
        *(
            f"{held_out[rate]:.1%}".replace("%", " %")
            for rate in ("success_rate", "collision_rate", "timeout_rate")
        ),
        f"{held_out['average_cost']:.2f}",
        f"{reached} of {record['fixed']['episodes']:.0f}",
        *(
            "{safe} of {total}".format(**proved[rate]["overall"])
            for rate in ("safety_rate", "sampled_safety_rate")
        ),
        f"{proved['reachable_width']['v']:.4f} m/s",
        f"{proved['reachable_width']['omega']:.3f} rad/s",
    ]
    return f"| {' | '.join(cells)} |\n"


def main() -> None:
    """Evaluate the named policies, or all; rewrite the table from all records."""
    names = sys.argv[1:] or sorted(path.stem for path in HERE.glob("*.onnx"))
    for name in names:
        policy = load_policy(HERE / f"{name}.onnx")
        assert policy.spec is not None
        text = yaml.safe_dump(FORMERLY | policy.spec.training["configuration"], sort_keys=False)
        (HERE / f"{name}.yaml").write_text(text, encoding="utf-8")
        record = record_of(policy)
        (HERE / f"{name}.json").write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
        sys.stdout.write(row_of(name, record))
    records = {
        path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted(HERE.glob("*.json"))
    }
    table = HEAD + "".join(row_of(name, record) for name, record in records.items())
    page = HERE / "README.md"
    before, _, rest = page.read_text(encoding="utf-8").partition("| file |")
    after = rest.partition("\n\n")[2]
    page.write_text(f"{before}{table}\n{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
