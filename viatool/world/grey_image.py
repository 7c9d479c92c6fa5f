"""Images as levels of grey."""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans
from viatool.errors import MapError

if TYPE_CHECKING:
    from PIL.Image import Image


@dataclass(frozen=True, eq=False)
class GreyImage:
    """An image without colour.

    Parameters
    ----------
    levels : ndarray
        (H, W) unsigned integers from 0, black, to `white`; row 0 is the top.
    white : int
        The brightest level.
    transparent : ndarray, optional
        (H, W) which pixels are not fully opaque; None if all are.
    """

    levels: NDArray[Any]
    white: int
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
        Colours become the mean of red, green and blue, as a level of 0 to 765.

    Raises
    ------
    MapError
        If it is not a whole image, or too large.
    """
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
    except (OSError, ValueError, SyntaxError, EOFError, IndexError) as error:
        raise MapError(f"is not a whole image: {error}", "write the image anew") from error


def _grey(image: Image) -> GreyImage:
    """Return a loaded image in grey."""
    if image.mode == "P" or "transparency" in image.info:
        image = image.convert("RGBA")
    if image.mode in ("1", "L"):
        return GreyImage(np.asarray(image.convert("L")), 255)
    if image.mode == "LA":
        grey, alpha = np.moveaxis(np.asarray(image), -1, 0)
        return GreyImage(grey.copy(), 255, _below_opaque(alpha))
    if image.mode in ("RGB", "RGBA"):
        pixels = np.asarray(image)
        levels = pixels[..., :3].sum(axis=-1, dtype=np.uint16)
        return GreyImage(levels, 765, _below_opaque(pixels[..., 3]) if pixels.shape[2] == 4 else None)
    if image.mode in ("I", "I;16", "I;16B", "I;16L"):  # 16 bits, which Pillow scales to 65535
        return GreyImage(np.clip(np.asarray(image), 0, 65535).astype(np.uint16), 65535)
    raise MapError(f"has pixels of mode {image.mode}", "save it in grey, RGB or RGBA")


def _below_opaque(alpha: NDArray[np.uint8]) -> Booleans | None:
    transparent = alpha < 255
    return transparent if transparent.any() else None
