"""One decoded frame as numpy views of its planes: luma at full, chroma at half resolution.

Colour is read from the decoder's own planes, because turning every frame into RGB costs more than tracking
it. The views keep the decoder's buffer alive; rows are cut at the line size, which may be padded.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Plane = npt.NDArray[np.uint8]

_PLANAR_420 = ("yuv420p", "yuvj420p")


@dataclass(frozen=True)
class Frame:
    """One frame of a film.

    Attributes
    ----------
    index : int
        Position among the decoded frames, counted here from 0.
    pts : int or None
        The stream's own time stamp in units of its time base.
    y, u, v : ndarray of uint8
        Luma (height, width) and chroma (ceil(height / 2), ceil(width / 2)); grey chroma is 128.
    corrupt : bool
        The decoder's own word that this frame is damaged.
    """

    index: int
    pts: int | None
    y: Plane
    u: Plane
    v: Plane
    corrupt: bool = False

    def copy(self) -> Frame:
        """Return the same frame in memory of its own."""
        return Frame(self.index, self.pts, self.y.copy(), self.u.copy(), self.v.copy(), self.corrupt)


@dataclass(frozen=True)
class Orientation:
    """How the coded picture is turned for display: first mirrored left to right, then quarter turns.

    `quarters` counts quarter turns counter-clockwise as `numpy.rot90` makes them.
    """

    quarters: int = 0
    mirrored: bool = False

    def apply(self, plane: Plane) -> Plane:
        """Turn a plane; without rotation the plane itself comes back."""
        if self.mirrored:
            plane = plane[:, ::-1]
        if self.quarters:
            plane = np.rot90(plane, self.quarters)
        return np.ascontiguousarray(plane) if self.mirrored or self.quarters else plane


def planes_of(frame: Any, index: int, orientation: Orientation) -> Frame:
    """Turn a decoded PyAV frame into a `Frame`; formats other than 8 bit 4:2:0 are converted first."""
    pts = None if frame.pts is None else int(frame.pts)
    if frame.format.name not in _PLANAR_420:
        frame = frame.reformat(format="yuv420p")
    y, u, v = map(_view, frame.planes)
    if orientation.quarters or orientation.mirrored:
        y, u, v = map(orientation.apply, (y, u, v))
    return Frame(index, pts, y, u, v, bool(getattr(frame, "is_corrupt", False)))


def orientation_of(frame: Any) -> Orientation:
    """Read the display matrix of a frame: multiples of 90 degrees and mirrors; anything else is upright."""
    data = frame.side_data.get("DISPLAYMATRIX")
    if data is None:
        return Orientation()
    a, b, _, c, d, *_ = struct.unpack("<9i", bytes(data)[:36])
    signs = tuple(int(np.sign(round(entry / 65536))) for entry in (a, b, c, d))
    return _ORIENTATIONS.get(signs, Orientation())


# (a, b, c, d) maps coded (x, y) to shown (a x + c y, b x + d y), y downwards.
_ORIENTATIONS: dict[tuple[int, ...], Orientation] = {
    (1, 0, 0, 1): Orientation(),
    (0, 1, -1, 0): Orientation(quarters=3),
    (-1, 0, 0, -1): Orientation(quarters=2),
    (0, -1, 1, 0): Orientation(quarters=1),
    (-1, 0, 0, 1): Orientation(mirrored=True),
    (1, 0, 0, -1): Orientation(quarters=2, mirrored=True),
    (0, -1, -1, 0): Orientation(quarters=3, mirrored=True),
    (0, 1, 1, 0): Orientation(quarters=1, mirrored=True),
}


def _view(plane: Any) -> Plane:
    return np.ndarray((plane.height, plane.width), np.uint8, plane, 0, (plane.line_size, 1))
