"""The criteria that are known by name: which path of a state is judged, and whether the verdict is a proof.

To add a criterion, add one class and its line in `CRITERIA`; the verdicts, the command line, the reports and the
places that accept it follow. Light on purpose: the command line lists the names before anything else is imported.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar

from viatool.errors import ConfigurationError

if TYPE_CHECKING:
    from viatool.motion.manoeuvre import Manoeuvre
    from viatool.world import Footprint, Robot


class Criterion(ABC):
    """What a state has to fulfil to be safe: on which path, by which commands, and at which instants."""

    name: ClassVar[str]
    """As the command line and the reports write it."""
    meaning: ClassVar[str]
    """What it says, in the words of a report."""
    proves: ClassVar[bool] = True
    """Every command of the reachable box and every instant is judged; else the samples below."""
    levels: ClassVar[tuple[float, ...]] = (0.0, 0.5, 1.0)
    """Fractions of the range of each axis at which commands are sampled; the paper's: nine commands of two axes."""
    instants: ClassVar[tuple[float, ...]] = tuple(0.1 * step for step in range(11))
    """Fractions of a sampled path at which it is judged; the paper says "into multiple time steps"."""

    @abstractmethod
    def path(self, held: Manoeuvre, deceleration: float, footprint: Footprint) -> Manoeuvre:
        """Return the path on which the clearance counts.

        Parameters
        ----------
        held : Manoeuvre
            The command held for one control interval, which the path has to begin with.
        deceleration : float
            The robot's largest braking, in m/s^2.
        footprint : Footprint
            Outline in the robot's frame.
        """

    def check(self, robot: Robot) -> None:  # noqa: B027  # most criteria suit every robot
        """Refuse a robot of which the criterion cannot be asked.

        Raises
        ------
        ConfigurationError
            With what the robot lacks.
        """


class Swept(Criterion):
    """Every command and every instant of the control interval."""

    name = "swept"
    meaning = "every action of the reachable box and every instant of the control interval"

    def path(self, held: Manoeuvre, deceleration: float, footprint: Footprint) -> Manoeuvre:
        """Return the control interval alone."""
        return held


class Sampled(Swept):
    """The paper's criterion: nine commands at some instants of the control interval."""

    name = "sampled"
    meaning = "nine actions and sampled instants, as in the paper; not a proof"
    proves = False


class Braking(Criterion):
    """Swept, and after it a full stop (passive safety)."""

    name = "braking"
    meaning = "swept, and a full stop at the robot's deceleration afterwards stays clear"

    def path(self, held: Manoeuvre, deceleration: float, footprint: Footprint) -> Manoeuvre:
        """Return the control interval and the stop after it; of a polygon its outermost corner counts."""
        rim = footprint.reach if footprint.kind == "polygon" else 0.0
        return replace(held, deceleration=deceleration, rim=rim, passive=True)

    def check(self, robot: Robot) -> None:
        """Refuse a robot that never stops."""
        if not 0.0 < robot.deceleration < math.inf:
            raise ConfigurationError(
                f"the robot's deceleration is {robot.deceleration} m/s^2, so it never stops",
                "give the map's robot a positive deceleration",
            )


SAMPLED = Sampled()
"""Reported beside every verdict."""
CRITERIA: dict[str, Criterion] = {criterion.name: criterion for criterion in (Swept(), SAMPLED, Braking())}
PROVING: tuple[str, ...] = tuple(name for name, criterion in CRITERIA.items() if criterion.proves)


def criterion_of(name: str) -> Criterion:
    """Return the criterion of a name.

    Raises
    ------
    ConfigurationError
        If there is none.
    """
    if name not in CRITERIA:
        raise ConfigurationError(f"criterion '{name}' is not known", f"choose one of {', '.join(CRITERIA)}")
    return CRITERIA[name]


def described(name: str) -> str:
    """Return a criterion and what it means; of a foreign report's criterion its name alone."""
    return f"{name}: {CRITERIA[name].meaning}" if name in CRITERIA else name
