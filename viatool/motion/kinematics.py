"""The kinematics that are known by name: what a map's robot may be."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Protocol, cast

from viatool.errors import ConfigurationError
from viatool.motion.ackermann import AckermannDrive
from viatool.motion.differential import DifferentialDrive
from viatool.motion.holonomic import HolonomicDrive
from viatool.motion.law import Kinematics, Limited
from viatool.motion.second_order import SecondOrder, SecondOrderAngular, SecondOrderLinear
from viatool.motion.steered import SecondOrderCar

DIFFERENTIAL = DifferentialDrive()
KINEMATICS: dict[str, Kinematics] = {
    kinematics.name: kinematics
    for kinematics in (
        *(DIFFERENTIAL, HolonomicDrive(), AckermannDrive()),
        *(SecondOrderLinear(), SecondOrderAngular(), SecondOrder(), SecondOrderCar()),
    )
}


_UNLIMITED = {"min_linear": -math.inf, "max_linear": math.inf, "max_angular": math.inf}


class Moving(Limited, Protocol):
    """What says of a robot how it moves."""

    @property
    def kinematics(self) -> str:
        """The name of its kinematics."""


def motion_of(robot: Moving) -> Kinematics:
    """Return how a robot moves: its kinematics, with what that has to know of it."""
    return kinematics_of(robot.kinematics).fitted(robot)


def motion_with(name: str, parameters: Mapping[str, float]) -> Kinematics:
    """Return a kinematics with what it had to know of a robot, as `Kinematics.parameters` gave it."""
    known = kinematics_of(name)
    if not (parameters or known.state):
        return known
    return known.fitted(cast(Limited, SimpleNamespace(**{**_UNLIMITED, **parameters})))


def kinematics_of(name: str) -> Kinematics:
    """Return the kinematics of a name.

    Raises
    ------
    ConfigurationError
        If there is none.
    """
    if name not in KINEMATICS:
        near = difflib.get_close_matches(name, KINEMATICS, n=1) or sorted(KINEMATICS)
        raise ConfigurationError(f"kinematics '{name}' is not known", f"choose one of {', '.join(near)}")
    return KINEMATICS[name]
