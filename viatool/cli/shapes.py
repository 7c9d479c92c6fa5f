"""Types of options that are shapes: a footprint, a point on the map, and how far a pose may be off."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click

from viatool.cli.numbers import finite

Corners = list[list[float]]


class FootprintType(click.ParamType):  # type: ignore[type-arg]  # generic only in newer click
    """``point``, a radius in metres, corners ``x,y x,y x,y``, or a YAML file with such a list."""

    name = "footprint"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        """Show what may be written."""
        return "point|RADIUS|CORNERS|FILE"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> str | float | Corners:
        """Read a footprint; its numbers are checked where it is used."""
        if not isinstance(value, str) or value == "point":
            return value  # type: ignore[no-any-return]  # already converted
        radius = finite(value)
        if radius is not None:
            if radius <= 0.0:
                self.fail(f"'{value}' is not a radius above 0", param, ctx)
            return radius
        if Path(value).is_file():
            return self._from_file(Path(value), param, ctx)
        corners = [[finite(number) for number in corner.split(",")] for corner in value.split()]
        if len(corners) < 3 or any(len(corner) != 2 or None in corner for corner in corners):
            self.fail(
                f"'{value}' is neither 'point', a radius, corners 'x,y x,y x,y' in metres, nor a file",
                param,
                ctx,
            )
        return [[number for number in corner if number is not None] for corner in corners]

    def _from_file(self, path: Path, param: click.Parameter | None, ctx: click.Context | None) -> Corners:
        """Read a list of corners, alone or under the key ``footprint``, where nav2 writes it as a text."""
        import yaml

        try:
            content = yaml.safe_load(path.read_text(encoding="utf-8"))
            if isinstance(content, dict):
                content = content["footprint"]
            if isinstance(content, str):
                content = yaml.safe_load(content)
            return [[float(x), float(y)] for x, y in content]
        except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError, ValueError):
            self.fail(f"'{path}' holds no list of corners [x, y] in metres", param, ctx)


class _NumbersType(click.ParamType):  # type: ignore[type-arg]  # generic only in newer click
    """Finite numbers with commas between, two unless said otherwise."""

    meant: str
    """What a wrong text is not."""
    count = 2
    least = -math.inf

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        """Read `count` finite numbers of at least `least`."""
        if isinstance(value, tuple):
            return value
        texts = str(value).split(",")
        numbers = [number for text in texts if (number := finite(text)) is not None]
        if not len(texts) == len(numbers) == self.count or min(numbers) < self.least:
            self.fail(f"'{value}' is not {self.meant}", param, ctx)
        return tuple(numbers)


class PoseType(_NumbersType):
    """``x,y,theta`` in metres and radians in the map frame."""

    name = "pose"
    meant = "x,y,theta in metres and radians"
    count = 3

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        """Show what may be written."""
        return "X,Y,THETA"


class PointType(_NumbersType):
    """``x,y`` in metres in the map frame."""

    name = "point"
    meant = "x,y in metres"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        """Show what may be written."""
        return "X,Y"


class PoseErrorType(_NumbersType):
    """``METRES,RADIANS``, neither of them negative."""

    name = "pose error"
    meant = "metres,radians of at least 0, such as 0.01,0.01"
    least = 0.0

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        """Show what may be written."""
        return "M,RAD"
