"""What is around a robot some intervals after the start, among things that have moved since.

What moves by `obstacles.speed` or `named` is where the map shows it at the start, and t seconds later anywhere within
speed times t of there, however it got there. So at an observation it roams within that distance: readings lie between
those of a map on which all of that is solid and those of one without the thing. Until the robot would have received
another command, and has stopped if that is asked, things move on: distances are kept from all that they may have
reached by then. They are kept by a robot that stands as well, which is more than passive safety asks.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from viatool.channels import Quantities
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.vicinity import Vicinity, check_roaming
from viatool.motion.carried import unknown_motion
from viatool.rounding import SLIGHTLY_MORE
from viatool.setting.rules import Rules
from viatool.setting.setting import Setting
from viatool.sight.shapes import Shapes
from viatool.uncertainty.error_model import ErrorModel, ObstacleTerms
from viatool.world import Obstacles, Scenario, WorldMap


def loop_after(loop: ClosedLoop, intervals: int) -> ClosedLoop:
    """Return the closed loop as it is after some intervals: itself, unless things move.

    Notes
    -----
    Sound: yes, for an interval that begins with the observation that so many others have preceded.
    """
    setting = loop.setting
    if not setting.uncertainty.obstacles.moves_on:
        return loop
    seconds = setting.rules.seconds_after(intervals)[1]
    seen = _roaming(setting, loop.scenario, seconds)
    met = _roaming(setting, loop.scenario, seconds + _until_it_stands(setting.rules))
    shapes = Shapes.of(*seen[:2], seen[2].obstacles.roams, measured=setting.reading_errors.passes)
    sensors = replace(loop.sensors, shapes=shapes, loose=Vicinity.of(*seen).loose)
    return replace(loop, sensors=sensors, around=Vicinity.of(*met))


def check_moving_on(setting: Setting, observed: Quantities) -> None:
    """Refuse LiDARs of which it is not known what they read among things that move on.

    Raises
    ------
    ConfigurationError
        Names the channel.
    """
    if setting.uncertainty.obstacles.moves_on:
        somewhere = ErrorModel(obstacles=ObstacleTerms(roams={"": 1.0}), source=setting.uncertainty.source)
        seeing = (lidar for lidar, _ in observed.lidars)
        check_roaming(seeing, somewhere, "obstacles.speed and named, over time")


def _roaming(setting: Setting, scenario: Scenario, seconds: float) -> tuple[WorldMap, Scenario, ErrorModel]:
    """Return a map on which everything roams that has moved for some seconds, with the obstacles of the scenario."""
    world_map, terms = setting.world_map, setting.uncertainty.obstacles
    own = Obstacles() if scenario is None else scenario.obstacles
    alike = ObstacleTerms(speed=terms.speed)
    free = [
        [by.freedom(name if by is terms else "") for name in some.names]
        for by, some in ((terms, world_map.obstacles), (alike, own))
    ]
    counts = len(world_map.obstacles.circles), len(own.circles)
    order = [part[:count] for part, count in zip(free, counts, strict=True)]
    order += [part[count:] for part, count in zip(free, counts, strict=True)]
    reach = [roams + speed * seconds * SLIGHTLY_MORE for part in order for roams, speed in part]
    names = tuple(f"{number}" if far > 0.0 else "" for number, far in enumerate(reach))
    every = Obstacles.together([world_map.obstacles, own])
    every = replace(every, grid=world_map.obstacles.grid, names=names)
    roams = {name: far for name, far in zip(names, reach, strict=True) if name}
    errors = ErrorModel(obstacles=ObstacleTerms(roams=roams), source=setting.uncertainty.source)
    return replace(world_map, obstacles=every), replace(scenario, obstacles=Obstacles()), errors


def _until_it_stands(rules: Rules) -> float:
    """Return until how many seconds after an observation things count at most."""
    if rules.over_time is not None:
        return float(unknown_motion(rules.over_time).stands[0])
    ends, once = (rules.lower[None], rules.upper[None]), np.ones(1)
    always = replace(rules.manoeuvre, passive=False)
    return float(always.counted_between(ends[1], *ends, 0.0 * once, once)[1][0])
