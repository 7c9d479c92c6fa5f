"""Drive the field's benchmarks NAV and Unicycle against their proofs, each run against the set of its own start.

    python tests/benchmarks/arch_comp_runs.py nav nn-nav-point.onnx
    python tests/benchmarks/arch_comp_runs.py unicycle controllerB.onnx [--runs 10000] [--seed 0] [--halve]

The networks are those of github.com/verivital/ARCH-COMP2024, or what examples/arch-comp/train.py writes. Half of the
runs begin at corners of the box of starts; disturbances are at corners, held or drawn anew. They are driven by
Runge-Kutta and onnxruntime, of which the proof knows nothing. Each run is compared with the linear form of the part of
the start in which it begins, at the symbols of its own start, after each interval, and with the goal at the deadline.
`--halve` halves what the forms hold beside these symbols: a fault, which runs of NAV find.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.missions.test_arch_comp import runs as drive
from viatool import load_map, load_policy
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.successor import fold_apart, name_rests, step
from viatool.missions import mission
from viatool.missions.carried import CarriedFollower
from viatool.missions.starts import Starts
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.uncertainty import as_error_model

FOLDER = Path(__file__).parents[2] / "examples" / "arch-comp"
ROUNDING = 1e-6


def proof(policy, world, model):
    """Return the mission, and the parts of its start that were followed to the end."""
    kept, honest = [], CarriedFollower._carry

    def carry(self, starts):
        found = honest(self, starts)
        done = found.failed == 0
        kept.append((starts.lower[done], starts.upper[done]))
        return found

    CarriedFollower._carry = carry
    (one,) = mission(policy, world, errors=model)
    CarriedFollower._carry = honest
    return one, Starts(*(np.concatenate(part) for part in zip(*kept, strict=True)))


def beyond(loop, parts, states, share):
    """How far runs (R, K + 1, 4) are beyond the forms of their own starts, in all of the intervals; and which do."""
    starts = states[:, 0]
    inside = ((starts[:, None] >= parts.lower) & (starts[:, None] <= parts.upper)).all(axis=2)
    assert inside.any(axis=1).all(), "a start lies in no part"
    part, forms = inside.argmax(axis=1), parts.forms
    radius = np.abs(forms.slope).sum(axis=1)
    z = (starts - forms.centre[part]) / np.where(radius > 0.0, radius, 1.0)[part]
    over = np.full(len(starts), -np.inf)
    for k in range(1, states.shape[1]):
        forms = fold_apart(name_rests(step(loop, forms).states), 4, 60)
        middle = forms.centre[part] + np.einsum("rs,rsq->rq", z, forms.slope[part, :4])
        own = np.abs(forms.slope[:, 4:]).sum(axis=1) + forms.rest
        over = np.maximum(over, (np.abs(states[:, k] - middle) - share * own[part]).max(axis=1))
    return over


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("task", choices=["nav", "unicycle"])
    parser.add_argument("policy", type=Path)
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--halve", action="store_true")
    asked = parser.parse_args()
    world = load_map(FOLDER / f"{asked.task}-map.yaml")
    policy = load_policy(asked.policy, FOLDER / f"{asked.task}.yaml")
    model = as_error_model(FOLDER / "unicycle-errors.yaml" if asked.task == "unicycle" else None)
    one, parts = proof(policy, world, model)
    print(f"{asked.policy.name}: {one.verdict}, {len(parts)} parts of the start, {one.seconds:.2f} s of CPU")
    setting = Setting.of(policy, world, None, Wishes(errors=model), job="mission")
    loop = ClosedLoop.of(setting.commanding(policy), setting, setting.scenarios[0], episode=one.steps)
    begun, box = time.process_time(), world.scenarios[0]
    lower, upper = (end[:4] for end in box.starts.ends(("x", "y", "theta", "v")))
    share = np.random.default_rng(asked.seed).uniform(0.0, 1.0, (asked.runs, 4))
    share[::2] = np.round(share[::2])
    driven = drive(asked.task, policy.outputs, lower + share * (upper - lower), asked.seed)
    states = np.concatenate([driven[:, :1, 0], driven[:, :, -1]], axis=1)
    over = beyond(loop, parts, states, 0.5 if asked.halve else 1.0)
    low, high = box.region.ends(("x", "y", "theta", "v"))
    arrive = ((states[:, -1] >= low) & (states[:, -1] <= high)).all(axis=1)
    blocked = world.obstacles.polygons[0] if len(world.obstacles.polygons) else None
    hit = 0
    if blocked is not None:
        least, most = blocked.min(axis=0), blocked.max(axis=0)
        hit = int(((driven[..., :2] > least) & (driven[..., :2] < most)).all(axis=-1).any(axis=(1, 2)).sum())
    print(
        f"{asked.runs:,} runs: {(over > ROUNDING).sum():,} leave the form of their own start (by at most "
        f"{max(over.max(), 0.0):.1e}), {(~arrive).sum():,} do not arrive, {hit:,} collide; "
        f"{time.process_time() - begun:.0f} s of CPU"
    )


if __name__ == "__main__":
    main()
