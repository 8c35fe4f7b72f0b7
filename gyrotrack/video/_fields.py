"""Interlaced film: each frame contains two fields, the even and the odd lines, captured half a frame period apart.

A field is a picture at its own time, interpolated to the size of the frame. The lines of the odd field are one line of
the frame lower than the lines of the even field. The interpolation takes this into account.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import cv2
import numpy as np

from gyrotrack._arrays import Plane

_MOVES = 8.0
"""Smallest change between frames of a moving pixel [grey levels]. Chosen: a smaller value includes noise, a
larger one leaves few pixels."""
_FEWEST_MOVING = 50
"""Smallest number of moving pixels that determine the order of the fields [pixels]. Chosen: with fewer, noise decides;
with more, slow films remain undecided."""


def field(plane: Plane, *, odd: bool) -> Plane:
    """Return the even or the odd lines of a frame as a picture of its size, by linear interpolation."""
    lines = plane[int(odd) :: 2]
    height, width = plane.shape
    # line y of the frame is line (y - odd) / 2 of the field
    matrix = np.array([[1.0, 0.0, 0.0], [0.0, 0.5, -0.5 * odd]])
    shown = cv2.warpAffine(
        np.ascontiguousarray(lines),
        matrix,
        (width, height),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.asarray(shown, dtype=np.uint8)


def first_field(frames: Sequence[Plane]) -> int | None:
    """Return the earlier field of successive frames: 0 (even lines), 1 (odd lines), None if they are not interlaced.

    In a moving part of an interlaced frame, a line differs more from the neighbouring lines, which belong to the other
    field, than from the next lines of its own field. A film that is only declared as interlaced has one picture in both
    fields. The order follows from the smallest change: the later field of a frame and the earlier field of the next
    frame are more similar than any other pair of fields.
    """
    if len(frames) < 3:
        return None
    comb = own = 0.0
    change = np.zeros(2)
    for before, after in itertools.pairwise(frames):
        a, b = before.astype(np.float32), after.astype(np.float32)
        moving = cv2.blur(np.abs(b - a), (5, 5)) > _MOVES
        if moving.sum() < _FEWEST_MOVING:
            continue
        inside = moving[2:-2]
        comb += float(np.abs(a[2:-2] - 0.5 * (a[1:-3] + a[3:-1]))[inside].sum())
        own += float(np.abs(a[2:-2] - 0.5 * (a[:-4] + a[4:]))[inside].sum())
        for first in (0, 1):
            later, next_one = (
                field(before, odd=not first).astype(np.float32),
                field(after, odd=bool(first)).astype(np.float32),
            )
            change[first] += float(np.abs(later - next_one)[moving].sum())
    return int(np.argmin(change)) if comb > own else None
