"""What the user asks for beyond what policy and map say: the options of the command line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args

from viatool.errors import ConfigurationError
from viatool.uncertainty import ErrorModel
from viatool.world import Footprint

Party = Literal["policy", "map"]
Matter = Literal["interval", "limits", "lidar"]
PARTIES: tuple[Party, ...] = get_args(Party)
MATTERS: tuple[Matter, ...] = get_args(Matter)


@dataclass(frozen=True, eq=False)
class Wishes:
    """What counts instead of what policy and map say; None leaves it to them.

    Parameters
    ----------
    criterion : str
        "sampled", "swept" or "braking".
    clearance, danger : float, optional
        d_col and d_danger, in metres.
    interval : float, optional
        Control interval, in seconds.
    footprint : optional
        A footprint, "point", a radius in metres, or the corners of a polygon.
    delay : float
        Dead time until a command acts, in seconds.
    deceleration : float, optional
        Of braking, in m/s^2.
    robot : str, optional
        A robot that is known by name, whose limits count.
    prefer : mapping
        Which party counts where policy and map contradict each other, by matter; the key ``""`` holds the answer for
        all other matters.
    errors : ErrorModel
        What is bounded about the robot beside eps and delay; by default nothing.
    """

    criterion: str = "swept"
    clearance: float | None = None
    danger: float | None = None
    interval: float | None = None
    footprint: Footprint | str | float | Sequence[Sequence[float]] | None = None
    delay: float = 0.0
    deceleration: float | None = None
    robot: str | None = None
    prefer: Mapping[str, str] = field(default_factory=dict)
    errors: ErrorModel = field(default_factory=ErrorModel)

    def __post_init__(self) -> None:
        for matter, party in self.prefer.items():
            if matter not in ("", *MATTERS):
                raise ConfigurationError(
                    f"policy and map cannot contradict each other in '{matter}'",
                    f"choose one of {', '.join(MATTERS)}",
                )
            if party not in PARTIES:
                raise ConfigurationError(f"'{party}' cannot be preferred", f"choose {' or '.join(PARTIES)}")

    def preferred(self, matter: Matter) -> str | None:
        """Return which party counts in a matter; None where the user did not say."""
        return self.prefer.get(matter, self.prefer.get(""))
