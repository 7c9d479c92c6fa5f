"""The engines by name."""

from __future__ import annotations

from typing import Any

from viatool.errors import ConfigurationError
from viatool.simulate.kinematic import NavigationSimulator
from viatool.simulate.simulator import Simulator
from viatool.world import WorldMap

ENGINES = ("kinematic", "bullet")
"""Names that `make_simulator` knows."""


def make_simulator(
    engine: str,
    world_map: WorldMap,
    robots: int,
    *,
    workers: int = 1,
    lidar: str | None = None,
    **settings: Any,
) -> Simulator:
    """Return a simulator.

    Parameters
    ----------
    engine : str
        "kinematic" or "bullet".
    world_map : WorldMap
        Arena, obstacles, robot and clearances.
    robots : int
        E.
    workers : int
        Processes of the physics engine; the kinematic one needs none.
    lidar : str, optional
        How the physics engine casts rays, "rays" (default) or "analytic"; the kinematic engine knows only the
        latter.
    **settings
        As for `Simulator`.

    Raises
    ------
    ConfigurationError
        If the engine is not known or does not have that LiDAR.
    """
    check_engine(engine, lidar)
    if engine == "kinematic":
        return NavigationSimulator(world_map, robots, **settings)
    from viatool.simulate.bullet import BulletSimulator

    return BulletSimulator(world_map, robots, workers=workers, lidar=lidar or "rays", **settings)  # type: ignore[arg-type]


def job_of(engine: str, lidar: str | None = None) -> str:
    """Return what simulating with an engine is called where error models are refused."""
    if engine == "kinematic":
        return "simulate"
    return f"simulate with {engine}" + (" and an analytic LiDAR" if lidar == "analytic" else "")


def check_engine(engine: str, lidar: str | None = None) -> None:
    """Refuse an engine that does not exist, or a LiDAR that it does not have."""
    if engine not in ENGINES:
        raise ConfigurationError(f"unknown engine '{engine}'", f"choose {' or '.join(ENGINES)}")
    if engine == "kinematic" and lidar == "rays":
        raise ConfigurationError(
            "the kinematic engine has no ray tests of its own", "leave --lidar out, or choose --engine bullet"
        )


def largest_batch(engine: str) -> int:
    """Return how many robots a simulator of that engine should have at most at once."""
    check_engine(engine)
    if engine == "kinematic":
        return NavigationSimulator.largest
    from viatool.simulate.bullet import BulletSimulator

    return BulletSimulator.largest
