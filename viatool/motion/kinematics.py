"""The kinematics that are known by name: what a map's robot may be."""

from __future__ import annotations

import difflib

from viatool.errors import ConfigurationError
from viatool.motion.ackermann import AckermannDrive
from viatool.motion.differential import DifferentialDrive
from viatool.motion.holonomic import HolonomicDrive
from viatool.motion.law import Kinematics

DIFFERENTIAL = DifferentialDrive()
KINEMATICS: dict[str, Kinematics] = {
    kinematics.name: kinematics for kinematics in (DIFFERENTIAL, HolonomicDrive(), AckermannDrive())
}


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
