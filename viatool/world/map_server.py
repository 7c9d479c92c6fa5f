"""Maps of the ROS 2 map_server: a YAML file and the image that it names, read as map_server reads them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from viatool.errors import MapError
from viatool.world.complaints import located, validated, wrong
from viatool.world.fields import Number, Pose, Positive
from viatool.world.grey_image import GreyImage, read_image
from viatool.world.map_file import Unknown
from viatool.world.occupancy import Cell, OccupancyGrid
from viatool.world.rings import simple_polygon
from viatool.world.yaml_text import YamlDocument

_GREY_UNKNOWN = 205  # what map_saver writes for unknown cells
_SIDE = 32_000  # cells along one side, at most


def _as_number(value: Any) -> Any:
    """Read true and false as 1 and 0, as older files write them."""
    return int(value) if isinstance(value, bool) else value


def _with_yaw(value: Any) -> Any:
    """Complete an origin without yaw."""
    return [*value, 0.0] if isinstance(value, list) and len(value) == 2 else value


Share = Annotated[Number, Field(ge=0.0, le=1.0)]


class MapServerFile(BaseModel):
    """The YAML file of a map_server map; keys that map_server does not know are told, and ignored."""

    model_config = ConfigDict(extra="allow", frozen=True)

    image: Annotated[str, Field(min_length=1)]
    resolution: Positive
    origin: Annotated[Pose, BeforeValidator(_with_yaw)]
    free_thresh: Share
    occupied_thresh: Share
    negate: Annotated[Literal[0, 1], BeforeValidator(_as_number)]
    mode: Literal["trinary", "scale", "raw"] = "trinary"


@dataclass(frozen=True, eq=False)
class ServedMap:
    """A map_server map as it was read.

    Parameters
    ----------
    grid : OccupancyGrid
        Its cells.
    image : Path
        Where the image lies.
    content : bytes
        What the image file holds.
    warnings : tuple of str
        What a user should know about it.
    """

    grid: OccupancyGrid
    image: Path
    content: bytes
    warnings: tuple[str, ...]


def is_map_server_file(document: YamlDocument) -> bool:
    """Tell by its keys whether a file belongs to map_server."""
    content = document.content
    if not isinstance(content, dict) or {"arena", "occupancy"} & content.keys():
        return False
    return bool({"image", "resolution", "occupied_thresh", "free_thresh"} & content.keys())


def read_map_server(document: YamlDocument, unknown: Unknown = "obstacle") -> ServedMap:
    """Read the image of a map_server file, and tell its cells apart.

    Parameters
    ----------
    document : YamlDocument
        The file; the path of the image counts from it.
    unknown : str
        What unknown cells are: "obstacle" or "free".

    Returns
    -------
    ServedMap
        Cells that are free, occupied or unknown. The modes `scale` and `raw` know values between free and
        occupied: such cells are not known to be free, and are unknown here.

    Raises
    ------
    MapError
        If a field or the image is missing, unreadable or out of its range.
    """
    given = validated(document, MapServerFile)
    if given.free_thresh > given.occupied_thresh:
        raise wrong(
            document,
            ("free_thresh",),
            f"{given.free_thresh} is above occupied_thresh {given.occupied_thresh}",
            "set free_thresh to a smaller share than occupied_thresh",
        )
    path = document.path.parent / given.image
    try:
        content = path.read_bytes()
        image = read_image(content)
    except OSError as error:
        raise wrong(
            document,
            ("image",),
            f"'{path}' cannot be read: {error.strerror or error}",
            "give the path of the image, relative to this file",
        ) from error
    except MapError as error:
        raise wrong(document, ("image",), f"'{path}' {error.message}", error.hint) from error
    if max(image.levels.shape) > _SIDE:
        size = f"{image.levels.shape[1]} x {image.levels.shape[0]}"
        raise wrong(document, ("image",), f"'{path}' has {size} cells", f"use at most {_SIDE} along a side")
    cells = np.ascontiguousarray(classify(image, given)[::-1])  # the image's top row is the grid's last

    def build() -> OccupancyGrid:
        made = OccupancyGrid(cells, given.resolution, given.origin, unknown_is_free=unknown == "free")
        simple_polygon(made.outline, f"outline of {cells.shape[1]} x {cells.shape[0]} cells")
        return made

    grid = located(document, ("resolution",), build)
    return ServedMap(grid, path, content, tuple(_warnings(document, given, image, grid)))


def classify(image: GreyImage, given: MapServerFile) -> NDArray[np.uint8]:
    """Return what the pixels of an image stand for.

    Parameters
    ----------
    image : GreyImage
        H x W pixels.
    given : MapServerFile
        Mode, thresholds and whether white is occupied.

    Returns
    -------
    ndarray
        (H, W) uint8 of `Cell`, row 0 at the top.
    """
    cells = classes(given)[image.levels]
    if image.transparent is not None and given.mode != "raw":
        cells[image.transparent] = Cell.UNKNOWN
    return cells


def classes(given: MapServerFile) -> NDArray[np.uint8]:
    """Return what each level of grey stands for, (256,) uint8 of `Cell`, computed in float32 as map_server does."""
    shade = np.arange(256, dtype=np.float32) / np.float32(255.0)
    if given.mode == "raw":
        percent = np.arange(256)
        occupied, free = percent >= 100.0 * given.occupied_thresh, percent <= 100.0 * given.free_thresh
        occupied &= percent <= 100
    else:
        share = shade if given.negate else np.float32(1.0) - shade
        occupied, free = share >= np.float32(given.occupied_thresh), share <= np.float32(given.free_thresh)
    kind = np.full(256, Cell.UNKNOWN, np.uint8)
    kind[occupied] = Cell.OCCUPIED
    kind[free] = Cell.FREE  # applied last, as map_server does
    return kind


def _warnings(
    document: YamlDocument, given: MapServerFile, image: GreyImage, grid: OccupancyGrid
) -> list[str]:
    """Return what a user should know about a map that is not wrong."""
    found = []
    if given.origin[2] != 0.0:
        found.append(
            f"{document.place(('origin',))}: origin: yaw {given.origin[2]:g} rad is honoured here, "
            "but nav2 ignores it: on such a robot the map lies elsewhere"
        )
    shade = _GREY_UNKNOWN / 255.0
    share = shade if given.negate else 1.0 - shade
    if given.mode != "raw" and share <= given.free_thresh and (image.levels == _GREY_UNKNOWN).any():
        found.append(
            f"{document.place(('free_thresh',))}: free_thresh: {given.free_thresh:g} makes grey {_GREY_UNKNOWN}, "
            f"which map_saver writes for unknown cells, free; a value below {share:.3f} keeps them unknown"
        )
    if image.mean is not None:
        differ = int(np.count_nonzero(classes(given)[image.levels] != classes(given)[image.mean]))
        if differ:
            found.append(
                f"{document.place(('image',))}: image: is coloured, and {differ:,} of its cells are others for a "
                "map_server that takes the mean of red, green and blue (ROS 1, and nav2 before luma); save it in grey"
            )
    for key in sorted(map(str, given.model_extra or {})):
        found.append(f"{document.place((key,))}: {key}: is not a field of map_server, and is ignored")
    if not (grid.cells == Cell.FREE).any():
        found.append(f"{document.path}: no cell is free; check negate and the thresholds")
    elif grid.share(Cell.UNKNOWN) > 0.9:
        found.append(
            f"{document.path}: {100.0 * grid.share(Cell.UNKNOWN):.0f} % of the cells are unknown; "
            "check the thresholds"
        )
    return found
