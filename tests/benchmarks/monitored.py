"""Robots under the monitor, with errors and commands as bad as they may be, measured by an oracle.

    python tests/benchmarks/monitored.py [--intervals 100000] [--robots 200] [--seed 0] [--policies via untrained ...]

An adversary takes, in each control interval of each robot, the command of those that the policy could be made to
give, and the pose of those that localisation could report, that pass the monitor and lead nearest to an obstacle; now
and then it insists on what does not pass, so that the robot brakes. The oracle (`tests/monitoring/attack.py`)
integrates arcs and brakes by formulas of its own and measures with shapely; half of the robots follow the velocities
that they are told while they brake, the others have linear brakes of their own. A robot that has braked for 20
intervals is put somewhere else. Counted are intervals in which something was promised and a footprint came as near as
d_col.
"""

from __future__ import annotations

import argparse
import datetime
import platform
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

import viatool
from tests.monitoring.attack import Anything, Attack, Ram, Sources
from tests.safety.brute_force import FOOTPRINTS, random_world
from viatool.monitoring.monitor import setting_of_commands
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.uncertainty import ErrorModel

RADII = (0.03, 0.03, 0.04)
EPS = 0.05
POSE = ErrorModel.model_validate({"pose": dict(zip(("x", "y", "theta"), RADII, strict=True))})


def untrained(seed, inputs, limits):
    """A network of random weights, as wild as no training would leave it."""
    generator = np.random.default_rng(seed)
    first, second = generator.normal(size=(2, inputs, inputs)) * 0.6
    last, (lower, upper) = generator.normal(size=(inputs, 2)), limits

    def run(seen):
        hidden = np.maximum(np.maximum(seen @ first, 0.0) @ second, 0.0)
        return lower + (upper - lower) * 0.5 * (1.0 + np.tanh(hidden @ last))

    return run


def lab(given, name):
    """A policy that observes, in the lab: its readings err as they may."""
    policy, world = viatool.load_policy("via"), viatool.load_map("lab")
    setting = Setting.of(policy, world, 0.0, Wishes("braking", errors=POSE), world.scenarios, job="monitor")
    attack = Attack(world, world.scenarios, setting, RADII, given.seed, given.robots)
    limits = setting.rules.lower, setting.rules.upper
    run = policy.run if name == "via" else untrained(given.seed, policy.input_size, limits)
    goals = np.array([world.scenarios[number].goal for number in attack.scene])
    return attack, Sources(setting, run, goals, EPS, 6, attack.generator)


def commands(given, name):
    """Commands of nobody knows what, of a robot with a polygon for a footprint and of a late one."""
    kind, _, place = name.partition(", ")
    delay = 0.15 if place == "late" else 0.0
    if place == "square":
        world, scenarios = (
            random_world(given.seed + 3, FOOTPRINTS["square"], max_angular=1.0, max_linear=0.6),
            (None,),
        )
    else:
        world = viatool.load_map("lab")
        world, scenarios = (
            world.with_robot(replace(world.robot, footprint=FOOTPRINTS["circle"])),
            world.scenarios,
        )
    wishes = Wishes("braking", errors=POSE, delay=delay)
    believed = setting_of_commands(world, wishes)
    attack = Attack(world, scenarios, believed, RADII, given.seed, given.robots, delay)
    limits = believed.rules.lower, believed.rules.upper
    return attack, Ram(*limits, attack.distance) if kind == "ram" else Anything(*limits)


POLICIES = {
    "via": lab,
    "untrained": lab,
    "ram, lab": commands,
    "ram, square": commands,
    "anything, lab": commands,
    "anything, late": commands,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--intervals", type=int, default=100_000)
    parser.add_argument("--robots", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--policies", nargs="*", default=list(POLICIES), choices=list(POLICIES))
    given = parser.parse_args()
    print("python", " ".join(f'"{word}"' if " " in word else word for word in sys.argv))
    print(
        f"{datetime.date.today()}, {platform.machine()}, seed {given.seed}, pose within {RADII}, readings within {EPS}"
    )
    print("policy".ljust(18) + "  intervals   passed   braked   proved  collisions  nearest, m and s")
    collisions = 0
    for name in given.policies:
        started = time.perf_counter()
        attack, source = POLICIES[name](given, name)
        found = attack.run(source, -(-given.intervals // given.robots))
        own = attack.world.clearance.collision
        print(
            f"{name:18s}{found.intervals:11,}{found.passed:9,}{found.braked:9,}{found.proved:9,}{found.violations:12,}"
            f"{found.least:10.5f}{time.perf_counter() - started:7.0f}  d_col {own:g} m",
            flush=True,
        )
        collisions += found.violations
    sys.exit(collisions > 0)


if __name__ == "__main__":
    main()
