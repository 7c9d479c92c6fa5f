"""Driven episodes played back: as a film, or in a window. Any engine's, since only poses are needed."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pybullet
from PIL import Image, ImageDraw

from viatool.arrays import Floats
from viatool.errors import ConfigurationError
from viatool.schedule import Progress
from viatool.simulate.bullet.world import BulletWorld
from viatool.simulate.models import model_of
from viatool.simulate.simulation import Simulation
from viatool.simulate.task import NavigationTask
from viatool.world import Obstacles, Scenario

FILMS = (".gif", ".mp4")
_WIDTH, _HEIGHT = 640, 480  # multiples of 16, as films want
_VIEW = 50.0  # degrees
_TILT = 62.0  # degrees of the camera's sight below the horizon
_STRIDE = 2  # states between two pictures
_FRAMES_PER_SECOND = 10
_TRAIL = (0, 114, 178)
_NO_TURN = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Take:
    """One episode of a film.

    Parameters
    ----------
    caption : str
        Scenario and outcome.
    scenario : Scenario or None
        What it added to the map.
    poses : ndarray
        (T, 3) its states and its end.
    """

    caption: str
    scenario: Scenario | None
    poses: Floats


def check_film(path: Path) -> None:
    """Refuse a film of an unknown kind, or of one whose writer is not installed."""
    if path.suffix.lower() not in FILMS:
        raise ConfigurationError(
            f"the film '{path}' ends in '{path.suffix}'", f"end it in {' or '.join(FILMS)}"
        )
    if path.suffix.lower() == ".mp4":
        import imageio_ffmpeg  # noqa: F401  # fails before anything is driven


def check_window() -> None:
    """Refuse to open a window where there is no screen: the engine would end the whole process."""
    if sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        raise ConfigurationError(
            "there is no display to open a window on (DISPLAY is not set)",
            "write a film with --record instead",
        )


def write_film(simulation: Simulation, path: Path, episodes: int, progress: Progress) -> None:
    """Write a film of the first episodes, at twice their speed.

    Parameters
    ----------
    simulation : Simulation
        What was driven.
    path : Path
        Ends in .gif or .mp4.
    episodes : int
        How many are shown.
    progress : Progress
        Told the pictures that are done and all of them.
    """
    takes = _takes(simulation, episodes)
    total = sum(len(take.poses[::_STRIDE]) for take in takes)
    pictures = _counted(_film(simulation, takes), total, progress)
    if path.suffix.lower() == ".gif":
        _write_gif(path, pictures)
    else:
        _write_mp4(path, pictures)


def play_in_window(simulation: Simulation, episodes: int) -> None:
    """Play the first episodes back in a window, in real time, until they end or the window is closed."""
    check_window()
    stage = _Stage(simulation, window=True)
    interval = simulation.world_map.robot.control_interval
    try:
        for take in _takes(simulation, episodes):
            stage.set(take.scenario)
            for pose in take.poses:
                stage.world.move_to(pose)
                time.sleep(interval)
    except pybullet.error:  # the window was closed
        return
    finally:
        stage.world.close()


def _takes(simulation: Simulation, episodes: int) -> list[Take]:
    trajectory = simulation.drive.trajectory
    takes = []
    for episode in range(min(episodes, trajectory.episodes)):
        poses = trajectory.poses[trajectory.episode == episode]
        scenario = trajectory.scenarios[episode]
        name = f"episode {episode}" if scenario is None else scenario.name
        caption = f"{name}: {trajectory.outcomes[episode]}"
        takes.append(Take(caption, scenario, np.vstack([poses, simulation.drive.ends[episode]])))
    return takes


class _Stage:
    """A world to look at: obstacles, the robot, and a disc around the goal."""

    def __init__(self, simulation: Simulation, *, window: bool = False) -> None:
        world_map = simulation.world_map
        model = model_of(world_map.robot)
        self.world = BulletWorld(world_map, model, model.acceleration, 0.01, visible=True, window=window)
        disc = pybullet.createVisualShape(
            pybullet.GEOM_CYLINDER,
            radius=NavigationTask().goal_radius,
            length=0.01,
            rgbaColor=(0.25, 0.70, 0.35, 1.0),
            physicsClientId=self.world.client,
        )
        self._goal = pybullet.createMultiBody(0.0, -1, disc, physicsClientId=self.world.client)

    def set(self, scenario: Scenario | None) -> None:
        """Set the obstacles and the goal of an episode."""
        self.world.arrange(Obstacles() if scenario is None else scenario.obstacles)
        place = (0.0, 0.0, -100.0) if scenario is None else (*scenario.goal, 0.006)
        pybullet.resetBasePositionAndOrientation(
            self._goal, place, _NO_TURN, physicsClientId=self.world.client
        )


class _Camera:
    """Looks at a whole map from the south, obliquely from above."""

    def __init__(self, bounds: tuple[float, float, float, float]) -> None:
        x_min, y_min, x_max, y_max = bounds
        middle = np.array([0.5 * (x_min + x_max), 0.5 * (y_min + y_max), 0.0])
        tilt = math.radians(_TILT)
        opening = math.tan(0.5 * math.radians(_VIEW))
        needed = max((x_max - x_min) * _HEIGHT / _WIDTH, (y_max - y_min) * math.sin(tilt))
        distance = 0.56 * needed / opening + 0.5 * (y_max - y_min) * math.cos(tilt)
        eye = middle + distance * np.array([0.0, -math.cos(tilt), math.sin(tilt)])
        self.view = pybullet.computeViewMatrix(eye.tolist(), middle.tolist(), (0.0, 0.0, 1.0))
        self.projection = pybullet.computeProjectionMatrixFOV(_VIEW, _WIDTH / _HEIGHT, 0.1, 4.0 * distance)
        view, projection = (np.reshape(matrix, (4, 4)).T for matrix in (self.view, self.projection))
        self._matrix = projection @ view

    def pixels(self, points: Floats) -> Floats:
        """Return where points (T, 2) of the floor are in the picture, (T, 2)."""
        flat = np.column_stack([points, np.full(len(points), 0.01), np.ones(len(points))])
        x, y, _, w = self._matrix @ flat.T
        return np.column_stack([0.5 * (x / w + 1.0) * _WIDTH, 0.5 * (1.0 - y / w) * _HEIGHT])

    def shoot(self, client: int) -> Image.Image:
        """Return a picture, drawn without a screen."""
        pixels = pybullet.getCameraImage(
            _WIDTH,
            _HEIGHT,
            self.view,
            self.projection,
            lightDirection=(2.0, -3.0, 6.0),
            shadow=0,
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=client,
        )[2]
        return Image.fromarray(np.reshape(pixels, (_HEIGHT, _WIDTH, 4)).astype(np.uint8)[:, :, :3])


def _film(simulation: Simulation, takes: Sequence[Take]) -> Iterator[Image.Image]:
    stage, camera = _Stage(simulation), _Camera(simulation.world_map.bounds)
    interval = simulation.world_map.robot.control_interval
    try:
        for take in takes:
            stage.set(take.scenario)
            for state in range(0, len(take.poses), _STRIDE):
                stage.world.move_to(take.poses[state])
                picture = camera.shoot(stage.world.client)
                draw = ImageDraw.Draw(picture)
                trail = camera.pixels(take.poses[: state + 1, :2])
                draw.line([tuple(point) for point in trail.tolist()], fill=_TRAIL, width=2)
                draw.text(
                    (12, 10), f"{take.caption}, {state * interval:.1f} s", fill=(20, 20, 20), font_size=16
                )
                yield picture
    finally:
        stage.world.close()


def _counted(pictures: Iterator[Image.Image], total: int, progress: Progress) -> Iterator[Image.Image]:
    for number, picture in enumerate(pictures, start=1):
        yield picture
        progress("film", number, total)


def _write_gif(path: Path, pictures: Iterator[Image.Image]) -> None:
    reduced = [picture.quantize(64, dither=Image.Dither.NONE) for picture in pictures]
    reduced[0].save(
        path,
        format="GIF",
        save_all=True,
        append_images=reduced[1:],
        duration=1000 // _FRAMES_PER_SECOND,
        loop=0,
        optimize=True,
    )


def _write_mp4(path: Path, pictures: Iterator[Image.Image]) -> None:
    import imageio_ffmpeg

    writer = imageio_ffmpeg.write_frames(
        str(path), (_WIDTH, _HEIGHT), fps=_FRAMES_PER_SECOND, ffmpeg_log_level="error"
    )
    writer.send(None)
    for picture in pictures:
        writer.send(np.ascontiguousarray(picture))
    writer.close()
