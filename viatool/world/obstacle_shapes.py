"""The shapes of obstacles that a native map may hold: what the file says of each, and what the geometry makes of it.

To add a shape, add one class and its name in `Obstacle`; reading, messages and the JSON Schema follow. The geometry
knows circles and simple polygons: a shape that is neither is circumscribed, never inscribed.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Annotated, ClassVar, Literal, get_args

import numpy as np
from pydantic import Field

from viatool.arrays import Floats
from viatool.world.fields import Number, Point, Positive, Size, Strict
from viatool.world.rings import simple_polygon
from viatool.world.shapes import Obstacles, box_polygon, wall_polygons


class ObstacleShape(Strict, ABC):
    """One obstacle of a map file."""

    shape: str
    name: str = ""

    compact: ClassVar[bool] = True
    """Random places keep their separations from its centre; else they keep their clearance from it alone."""

    @abstractmethod
    def solid(self) -> Obstacles:
        """Return circles and polygons that together hold every point of the shape.

        Raises
        ------
        MapError
            If the shape is not valid, such as an outline that crosses itself.
        """


class Outlined(ObstacleShape):
    """The inside of one closed outline."""

    @abstractmethod
    def ring(self) -> Floats:
        """Return the checked outline, (n, 2), counter-clockwise."""

    def solid(self) -> Obstacles:
        """See `ObstacleShape.solid`."""
        return Obstacles(polygons=(self.ring(),))


class Circle(ObstacleShape):
    """A disc."""

    shape: Literal["circle"]
    center: Point
    radius: Positive

    def solid(self) -> Obstacles:
        """See `ObstacleShape.solid`."""
        return Obstacles(np.array([(*self.center, self.radius)]))


class Rectangle(Outlined):
    """A rectangle: lengths along its own x and y, turned by yaw."""

    shape: Literal["box"]
    center: Point
    size: Size
    yaw: Number = 0.0

    def ring(self) -> Floats:
        """See `Outlined.ring`."""
        return simple_polygon(box_polygon(self.center, self.size, self.yaw), self.name or "box")


class Polygon(Outlined):
    """The inside of a simple outline, corners in either direction."""

    shape: Literal["polygon"]
    points: list[Point] = Field(min_length=3)

    def ring(self) -> Floats:
        """See `Outlined.ring`."""
        return simple_polygon(self.points, self.name or "polygon")


class Wall(ObstacleShape):
    """A thick polyline; every segment is longer by half of the thickness at both ends."""

    shape: Literal["wall"]
    points: list[Point] = Field(min_length=2)
    thickness: Positive = 0.1

    compact: ClassVar[bool] = False

    def solid(self) -> Obstacles:
        """See `ObstacleShape.solid`."""
        boxes = wall_polygons(self.points, self.thickness)
        return Obstacles(polygons=tuple(simple_polygon(box, self.name or "wall") for box in boxes))


Obstacle = Annotated[Circle | Rectangle | Polygon | Wall, Field(discriminator="shape")]
"""What `obstacles` of a map may hold."""
Arena = Annotated[Rectangle | Polygon, Field(discriminator="shape")]

SHAPES: tuple[str, ...] = tuple(
    get_args(kind.model_fields["shape"].annotation)[0] for kind in get_args(get_args(Obstacle)[0])
)
"""Their names in a file."""
