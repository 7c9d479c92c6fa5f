"""Images as levels of grey, as map_server greys them.

nav2 asks GraphicsMagick for the luma of a pixel in 8 bits: (306 red + 601 green + 117 blue) / 1024, rounded down. Until
2025 it took the mean of red, green and blue, as ROS 1 does; `GreyImage.mean` keeps that, so that a map on which they
differ can be told.
"""

from __future__ import annotations

import io
import struct
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans
from viatool.errors import MapError
from viatool.world.netpbm import is_netpbm, read_netpbm

if TYPE_CHECKING:
    from PIL.Image import Image


@dataclass(frozen=True, eq=False)
class GreyImage:
    """An image without colour.

    Parameters
    ----------
    levels : ndarray
        (H, W) uint8 from 0, black, to 255, white; row 0 is the top.
    mean : ndarray, optional
        (H, W) uint8, the mean of red, green and blue instead; None where no pixel has a colour.
    transparent : ndarray, optional
        (H, W) which pixels are not fully opaque; None if all are.
    """

    levels: NDArray[np.uint8]
    mean: NDArray[np.uint8] | None = None
    transparent: Booleans | None = None


def read_image(content: bytes) -> GreyImage:
    """Read a PGM, PNG or any other image that Pillow knows.

    Parameters
    ----------
    content : bytes
        The file.

    Returns
    -------
    GreyImage
        Colours become their luma, 16 bits the 8 upper ones.

    Raises
    ------
    MapError
        If it is not a complete image, or too large.
    """
    if is_netpbm(content):
        return _from_samples(read_netpbm(content))
    return _read_by_pillow(content)


def _read_by_pillow(content: bytes) -> GreyImage:
    """Read an image of another kind than Netpbm's."""
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(content)) as image:
                image.load()
                return _grey(image)
    except UnidentifiedImageError as error:
        raise MapError("is not an image that can be read", "give a PGM or PNG image") from error
    except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
        raise MapError(f"is too large: {error}", "cut the map into parts") from error
    except (OSError, ValueError, SyntaxError, EOFError, IndexError, struct.error) as error:
        raise MapError(f"is not a complete image: {error}", "write the image again") from error


def _grey(image: Image) -> GreyImage:
    """Return a loaded image in grey."""
    if image.mode in ("P", "PA") or "transparency" in image.info:
        image = image.convert("RGBA")
    if image.mode in ("I", "I;16", "I;16B", "I;16L"):  # 16 bits, which Pillow scales to 65535
        return _from_samples(np.clip(np.asarray(image), 0, 65535)[..., None] // 257)
    if image.mode == "1":
        image = image.convert("L")
    if image.mode not in ("L", "LA", "RGB", "RGBA"):
        raise MapError(f"has pixels of mode {image.mode}", "save it in grey, RGB or RGBA")
    pixels = np.asarray(image)
    pixels = pixels.reshape(*pixels.shape[:2], -1)
    channels = pixels.shape[2]
    if channels in (1, 3):
        return _from_samples(pixels)
    return _from_samples(pixels[..., :-1], pixels[..., -1])


def _from_samples(samples: NDArray[Any], alpha: NDArray[Any] | None = None) -> GreyImage:
    """Return samples from 0 to 255, (H, W, 1) or (H, W, 3), in grey; whatever is below full alpha is transparent."""
    transparent = None if alpha is None or (alpha == 255).all() else alpha < 255
    red, green, blue = np.moveaxis(np.broadcast_to(samples, (*samples.shape[:2], 3)), -1, 0)
    if samples.shape[2] == 1 or ((red == green) & (green == blue)).all():
        return GreyImage(red.astype(np.uint8), None, transparent)
    luma = samples.astype(np.uint32) @ np.array([306, 601, 117], dtype=np.uint32) >> 10
    mean = samples.sum(axis=-1, dtype=np.uint32) // 3
    return GreyImage(luma.astype(np.uint8), mean.astype(np.uint8), transparent)
