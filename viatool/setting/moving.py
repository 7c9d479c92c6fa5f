"""What a setting says of moving things is checked here: names, sensors, and terms that need one another."""

from __future__ import annotations

from viatool.channels import LidarReadings, Quantities
from viatool.errors import ConfigurationError
from viatool.policy import PolicySpecification
from viatool.uncertainty import ErrorModel
from viatool.world import Robot, WorldMap
from viatool.world.seen import Wedges


def scanners(spec: PolicySpecification, robot: Robot) -> list[LidarReadings]:
    """Return the LiDARs that a policy observes, without those whose readings are fixed."""
    observed = Quantities.of(spec.observation, robot, spec.frames)
    return [lidar for lidar, _ in observed.lidars if lidar.channel.value is None]


def check_moving(model: ErrorModel, spec: PolicySpecification, world_map: WorldMap) -> None:
    """Refuse terms of moving things that mean nothing on this map, or of this policy.

    Raises
    ------
    ConfigurationError
        Names the term and what is missing.
    """
    terms, source = model.obstacles, model.source
    known = {name for name in world_map.obstacles.names if name}
    for field in ("named", "roams"):
        for name in getattr(terms, field):
            if name not in known:
                told = f"its obstacles are {', '.join(sorted(known))}" if known else "it names none"
                raise ConfigurationError(
                    f"{source}: obstacles.{field}.{name}: map '{world_map.path}' has no such obstacle; {told}",
                    "correct the name, or give the obstacle of the map its `name`",
                )
    both = sorted(terms.named.keys() & terms.roams.keys())
    if both:
        raise ConfigurationError(
            f"{source}: obstacles.named.{both[0]} and obstacles.roams.{both[0]} speak of the same obstacle",
            "say how fast it is, or how far from its place it may be",
        )
    if terms.speed and world_map.obstacles.grid is not None:
        raise ConfigurationError(
            f"{source}: obstacles.speed: the cells of an occupancy map are not told apart as obstacles",
            "state obstacles.returns, so that what the LiDAR sees may move, and obstacles.named for what has a name",
        )
    if terms.behind is not None and terms.hidden is None:
        raise ConfigurationError(
            f"{source}: obstacles.behind says how near something hidden may be, but nothing is hidden",
            "state obstacles.hidden as well, how fast it comes out",
        )
    if terms.returns is None and terms.hidden is None:
        return
    what = "obstacles.returns" if terms.returns is not None else "obstacles.hidden"
    seeing = scanners(spec, world_map.robot)
    if not seeing:
        raise ConfigurationError(
            f"{source}: {what}: the policy observes no LiDAR", "leave the term out, or give obstacles by name"
        )
    for scanner in seeing:
        lidar, name = scanner.fan.lidar, scanner.channel.name
        if lidar.reduce == "mean" and lidar.each > 1:
            raise ConfigurationError(
                f"{source}: {what}: of the bins of '{name}' only the mean of several rays is known, not the nearest",
                "observe the least of them, or leave the term out",
            )
        if lidar.no_return is not None and lidar.no_return < lidar.maximum_range:
            raise ConfigurationError(
                f"{source}: {what}: '{name}' reads {lidar.no_return:g} m where nothing returns, or an obstacle",
                f"let it read {lidar.maximum_range:g} m or more there, or leave the term out",
            )
        if terms.hidden is not None and terms.behind is None and Wedges.of(lidar).blind.any():
            raise ConfigurationError(
                f"{source}: obstacles.hidden: '{name}' does not look all around, and anything may be there",
                "state obstacles.behind: the metres within which nothing is where it does not look",
            )
        bent = model.sensor.get(name)
        for field in ("missing", "thin"):
            if bent is not None and getattr(bent, field):
                raise ConfigurationError(
                    f"{source}: {what} and sensor.{name}.{field} together are not taken into account",
                    "leave one of them out; all other errors of sensors are counted",
                )
