"""Films in a TIFF file of many pictures (a stack), written by ImageJ, Micro-Manager and OME programs.

Grey pictures of 8 bits are not changed. Other grey pictures are scaled to 8 bits; the range is from the darkest to the
brightest pixel of some of the pictures. Colours of 8 bits are not changed. The time between two pictures is read from
the description of ImageJ (``finterval`` [s]) or of OME (``TimeIncrement``), if present.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import tifffile

from gyrotrack._errors import VideoError
from gyrotrack.video._frame_stream import FrameStream

SUFFIXES = (".tif", ".tiff")
_SAMPLED = 20
"""Number of pictures that determine the range of the brightness [pictures]. Chosen: a larger number costs time, a
smaller one may saturate a brighter picture."""
_INTERVAL = re.compile(r"finterval=([0-9.eE+-]+)")
_INCREMENT = re.compile(r'TimeIncrement="([0-9.eE+-]+)"')
_UNIT = re.compile(r'TimeIncrementUnit="([^"]+)"')
_SECONDS = {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "us": 1e-6, "min": 60.0}
"""Units of the time between two pictures [s]. Source: names of units in OME and ImageJ."""
_FASTEST = 1e8
"""Largest capture rate [1/s]. Chosen: a larger value accepts damaged descriptions, a smaller one refuses fast
cameras."""


@dataclass(frozen=True)
class TiffStack:
    """Content of a stack."""

    path: Path
    frames: int
    # size of a picture [px]
    width: int
    height: int
    colour: bool
    fps: float | None  # rate from the description [1/s]; None without one


def read_stack(path: Path) -> TiffStack:
    """Read the shape of a stack; raise a `VideoError` if it is not a film."""
    try:
        with tifffile.TiffFile(path) as file:
            pages = len(file.pages)
            shape, kind = tuple(file.pages[0].shape), np.dtype(file.pages[0].dtype or "V")
            text = " ".join(filter(None, (file.pages.first.description, file.ome_metadata)))
            alike = all(tuple(file.pages[k].shape) == shape for k in (pages // 2, pages - 1))
    except (tifffile.TiffFileError, OSError, ValueError, IndexError, KeyError) as error:
        what = f"{path} is not a TIFF file that can be read."
        raise VideoError(what, "Copy it again, or save it as an uncompressed AVI.") from error
    if pages < 2:
        what = f"{path} contains one picture, which is not a film."
        raise VideoError(what, "Give a stack of pictures, or the folder of numbered pictures.")
    colour = len(shape) == 3 and shape[2] in (3, 4) and kind == np.uint8
    if not alike or not (colour or (len(shape) == 2 and kind.kind in "uif")):
        size = "x".join(map(str, shape))
        what = f"{path} contains pictures of the shape {size} and the type {kind}, or pictures of different shapes."
        raise VideoError(
            what, "Save it as a stack of grey pictures of equal size, or of colour pictures with 8 bits."
        )
    return TiffStack(path, pages, shape[1], shape[0], colour, _rate(text))


def _rate(text: str) -> float | None:
    interval = 0.0
    if found := _INTERVAL.search(text):
        interval = _number(found[1])
    elif found := _INCREMENT.search(text):
        unit = _UNIT.search(text)
        interval = _number(found[1]) * _SECONDS.get(unit[1] if unit else "s", 0.0)
    return 1.0 / interval if interval > 1.0 / _FASTEST else None


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return 0.0


class TiffFrames(FrameStream):
    """The pictures of a stack as grey or RGB pixels of 8 bits."""

    def __init__(self, stack: TiffStack) -> None:
        super().__init__(stack.frames, stack.width * stack.height * (3 if stack.colour else 1))
        self._stack = stack
        self._file = tifffile.TiffFile(stack.path)
        self._low, self._high = (0.0, 255.0) if stack.colour else self._range()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def frame(self, number: int) -> bytes:
        """Return the pixels of a picture."""
        picture = self._picture(number)
        if self._stack.colour:
            return bytes(np.ascontiguousarray(picture[..., :3], dtype=np.uint8))
        if picture.dtype == np.uint8 and (self._low, self._high) == (0.0, 255.0):
            return bytes(picture)
        scaled = (picture.astype(np.float32) - self._low) * np.float32(255.0 / (self._high - self._low))
        return bytes(np.clip(scaled.round(), 0, 255).astype(np.uint8))

    def _picture(self, number: int) -> npt.NDArray[Any]:
        try:
            return np.asarray(self._file.pages[number].asarray())
        except (tifffile.TiffFileError, OSError, ValueError, IndexError) as error:
            what = f"Picture {number} of {self._stack.path} cannot be decoded ({type(error).__name__})."
            raise VideoError(what, "Save the stack without compression.") from error

    def _range(self) -> tuple[float, float]:
        """Return the smallest and the largest value of some pictures; 0 and 255 for 8 bits."""
        if np.dtype(self._file.pages[0].dtype or "V") == np.uint8:
            return 0.0, 255.0
        numbers = np.unique(np.linspace(0, self._stack.frames - 1, _SAMPLED).astype(int))
        ends = [(float(np.nanmin(p)), float(np.nanmax(p))) for p in map(self._picture, numbers.tolist())]
        low, high = min(e[0] for e in ends), max(e[1] for e in ends)
        return low, max(high, low + 1e-9)
