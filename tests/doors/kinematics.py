"""A robot that slides instead of turning, in a file of its own."""

from __future__ import annotations

from pathlib import Path

from tests.motion import test_door
from viatool.motion.kinematics import KINEMATICS

NAME = "crab"
FILES = {
    "viatool/motion/NAME.py": '''\
"""A robot that slides."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from viatool.arrays import Floats
from viatool.motion.law import Axis, Limited
from viatool.motion.twists import HeldTwist, Part


class Crab(HeldTwist):
    """It never turns: what a policy commands as a turn slides it to its left, a metre for each radian."""

    name: ClassVar[str] = "crab"
    description: ClassVar[str] = "a robot that slides"
    axes: ClassVar[tuple[Axis, ...]] = (Axis("v", "m/s", "linear"), Axis("side", "m/s", "angular"))
    velocity: ClassVar[tuple[Part, ...]] = ("ahead", "left")

    def limits(self, robot: Limited) -> tuple[Floats, Floats]:
        """See `Kinematics.limits`."""
        return (
            np.array([robot.min_linear, -robot.max_angular]),
            np.array([robot.max_linear, robot.max_angular]),
        )
''',
    "viatool/motion/kinematics.py": {
        "from viatool.motion.differential": "from viatool.motion.crab import Crab\nfrom viatool.motion.differential",
        "(DIFFERENTIAL, ": "(DIFFERENTIAL, Crab(), ",
    },
}


def check(folder: Path) -> None:
    assert type(KINEMATICS["crab"]).__module__ == "viatool.motion.crab"
    test_door.test_it_is_simulated()
    test_door.test_states_are_verified_and_none_that_is_safe_comes_too_near()
    test_door.test_cells_are_certified_and_their_states_keep_their_clearance()
    test_door.test_a_map_says_how_its_robot_moves(folder)
