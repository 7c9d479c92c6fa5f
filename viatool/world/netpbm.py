"""Netpbm images (PBM, PGM, PPM; plain and raw), whose headers say how many samples have to follow.

Other readers fill up or cut off what does not fit: a map whose header says another width than its pixels would come out
sheared. Here the sizes agree, or the file is refused.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.errors import MapError

_SPACE = rb"(?:\s|#[^\r\n]*[\r\n])"
_NUMBER = _SPACE + rb"+(\d{1,9})"
_MAGIC = re.compile(rb"P([1-6])(?=\s|#)")
_CHANNELS = {1: 1, 2: 1, 3: 3, 4: 1, 5: 1, 6: 3}
_BITS, _RAW = (1, 4), (4, 5, 6)
_MOST = 2**28  # samples


@dataclass(frozen=True)
class _Header:
    """Kind 1 to 6, size in pixels, largest sample, and where the samples begin."""

    kind: int
    width: int
    height: int
    largest: int
    end: int

    @property
    def samples(self) -> int:
        return self.width * self.height * _CHANNELS[self.kind]

    def __str__(self) -> str:
        return f"{self.width} x {self.height} pixels of P{self.kind}, largest sample {self.largest}"


def is_netpbm(content: bytes) -> bool:
    """Tell by its first bytes whether a file is a PBM, PGM or PPM image."""
    return _MAGIC.match(content) is not None


def read_netpbm(content: bytes) -> NDArray[np.uint8]:
    """Return the samples of a PBM, PGM or PPM image, scaled to 255 as GraphicsMagick does, by way of 16 bits.

    Parameters
    ----------
    content : bytes
        The file, for which `is_netpbm` holds.

    Returns
    -------
    ndarray
        (H, W, 1) grey or (H, W, 3) red, green, blue; row 0 is the top.

    Raises
    ------
    MapError
        If the header is cut off, or the samples after it are fewer or more than it says, or larger.
    """
    header = _read_header(content)
    samples = _raw(content, header) if header.kind in _RAW else _plain(content, header)
    if samples.size and int(samples.max()) > header.largest:
        raise MapError(
            f"is an image with a sample of {int(samples.max())} ({header})",
            "write the image again; its header does not fit",
        )
    if header.kind in _BITS:
        samples = 1 - samples  # 1 is black
    scale = np.floor(np.arange(header.largest + 1) * (65535.0 / header.largest) + 0.5) // 257.0
    scaled: NDArray[np.uint8] = scale.astype(np.uint8)[samples]
    return scaled.reshape(header.height, header.width, _CHANNELS[header.kind])


def _read_header(content: bytes) -> _Header:
    """Return what a file says of itself."""
    found = _MAGIC.match(content)
    assert found is not None  # the caller asked `is_netpbm`
    kind = int(found[1])
    numbers = 2 if kind in _BITS else 3
    rest = re.compile(numbers * _NUMBER + (rb"\s" if kind in _RAW else rb"")).match(content, 2)
    if rest is None:
        raise MapError(
            f"is an image whose P{kind} header does not give width, height"
            f"{'' if kind in _BITS else ' and largest sample'}",
            "write the image again",
        )
    width, height, *largest = map(int, rest.groups())
    header = _Header(kind, width, height, largest[0] if largest else 1, rest.end())
    if not (width and height and 0 < header.largest < 2**16):
        raise MapError(
            f"is an image with an impossible header: {header}",
            "write it again, with samples of at most 65535",
        )
    if header.samples > _MOST:
        raise MapError(f"is too large: {header}", "cut the map into parts")
    return header


def _raw(content: bytes, header: _Header) -> NDArray[Any]:
    """Return the samples of a raw image; space after them is not a sample."""
    row = -(-header.width // 8) if header.kind == 4 else 0
    size = row * header.height if row else header.samples * (1 if header.largest < 256 else 2)
    there = len(content) - header.end
    if there < size or content[header.end + size :].strip():
        raise MapError(
            f"is an image with {there} bytes of pixels, its header asks for {size} ({header})",
            "write the image again: it is cut off, or its header is another image's",
        )
    if row:
        packed = np.frombuffer(content, np.uint8, size, header.end).reshape(header.height, row)
        return np.unpackbits(packed, axis=1)[:, : header.width].ravel()
    return np.frombuffer(content, np.uint8 if header.largest < 256 else ">u2", header.samples, header.end)


def _plain(content: bytes, header: _Header) -> NDArray[Any]:
    """Return the samples of a plain image, which are written in decimal."""
    text = re.sub(rb"#[^\r\n]*", b" ", content[header.end :])
    words = list(text.translate(None, b" \t\r\n\v\f")) if header.kind == 1 else text.split()
    if len(words) != header.samples:
        raise MapError(
            f"is an image with {len(words)} samples, its header asks for {header.samples} ({header})",
            "write the image again: it is cut off, or its header is another image's",
        )
    try:
        samples = np.array(words, dtype=np.intp) - (ord("0") if header.kind == 1 else 0)
    except (ValueError, OverflowError) as error:
        raise MapError(
            f"is an image with a sample that is not a number ({header})", "write the image again"
        ) from error
    if samples.min() < 0:
        raise MapError(f"is an image with a sample below 0 ({header})", "write the image again")
    return samples
