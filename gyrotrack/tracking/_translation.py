"""Distinguish rotation about a hub from translation across the picture (a cart, a piston).

Over a part of a turn, rotation about a hub resembles translation. The test compares both motions on the same pixels of
the body: a few frames are aligned to a reference frame, first by rotation about the hub, then by translation alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from gyrotrack._arrays import Bools, Floats, Picture, Plane

WIDEST = 3.0
"""Smallest range of the angle in which rotation does not resemble translation [rad]. Chosen: about half a turn; a
smaller value skips the test of carts, a larger one costs time."""
_FRAMES = 24
"""Number of frames that are compared [frames]. Chosen: with fewer, noise decides; with more, the comparison takes
longer."""
_FEWEST = 30
"""Smallest number of pixels that change [pixels]. Chosen: with fewer, noise decides; with more, the test of small
bodies is skipped."""
_SMOOTHED = 5
"""Width of the smoothing before an alignment [px]. Chosen: a smaller value fails for large displacements, a larger one
loses detail."""
_STEPS = 30
"""Largest number of iterations of an alignment [iterations]. Chosen: a smaller number stops early, a larger one costs
time."""
_SMALL_STEP = 1e-3
"""Change of the correlation that ends an alignment [1]. Chosen: a larger value stops early, a smaller one costs
time."""
_GAIN = 0.5
"""A body does not turn if the residual of translation, divided by the residual of rotation, is less than this value
[1]. Chosen: a larger value takes bodies that turn little for carts, a smaller one takes carts for rotating bodies."""


def translates(
    pictures: Sequence[Plane], moving: Bools, hub: tuple[float, float], reach: float, angle: Floats
) -> bool:
    """Return whether translation explains a selection of the frames clearly better than rotation about a hub.

    `moving` is the part of the picture that changes. `hub` is the position (x, y) of the hub [px], and `reach` is the
    outer radius of the ring [px]. `angle` (n,) is the rotation of each picture, clockwise as seen [rad].
    """
    if len(angle) < 2 or np.ptp(angle) > WIDEST:
        return False
    use = np.unique(np.linspace(0, len(angle) - 1, _FRAMES).astype(int))
    some, turn = [pictures[k] for k in use], angle[use]
    middle = int(np.argmin(np.abs(turn - 0.5 * (turn.min() + turn.max()))))
    near = np.zeros(moving.shape, dtype=np.uint8)
    cv2.circle(near, (round(hub[0]), round(hub[1])), round(reach), 1, -1)
    swept = near * moving
    if np.count_nonzero(swept) < _FEWEST:
        return False
    turned = [_rotation(hub, a - turn[middle]) for a in turn]
    # the middle of the body in the reference, from the pixels that differ from the mean picture
    y, x = np.nonzero(swept)
    weight = np.abs(some[middle].astype(np.float64) - np.mean(some, axis=0))[y, x] + 1e-9
    place = np.array([np.average(x, weights=weight), np.average(y, weights=weight), 1.0])
    moved = [
        _translation(f, some[middle], swept, m @ place - place[:2]) for f, m in zip(some, turned, strict=True)
    ]
    return residual(some, moved, swept) < _GAIN * residual(some, turned, swept)


def residual(pictures: Sequence[Plane], motions: Sequence[Picture], swept: Plane) -> float:
    """Return the variance between pictures that are transformed back by their motions, matrices (2, 3).

    The variance is averaged over the pixels of `swept`.
    """
    height, width = swept.shape
    back = [
        cv2.warpAffine(
            p.astype(np.float32),
            m,
            (width, height),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        )[swept > 0]
        for p, m in zip(pictures, motions, strict=True)
    ]
    return float(np.mean(np.var(back, axis=0)))


def _rotation(hub: tuple[float, float], turn: float) -> Picture:
    """Return the rotation about a hub by an angle, clockwise as seen, as a matrix (2, 3)."""
    cos, sin = np.cos(turn), np.sin(turn)
    x, y = hub
    return np.array([[cos, -sin, x - cos * x + sin * y], [sin, cos, y - sin * x - cos * y]], dtype=np.float32)


def _translation(picture: Plane, reference: Plane, swept: Plane, start: Floats) -> Picture:
    """Return the translation of a body from a reference to a picture, refined from a rough displacement.

    The translation maximises the correlation of the pictures (G. Evangelidis, E. Psarakis, IEEE PAMI 30, 1858, 2008).
    """
    move = np.eye(2, 3, dtype=np.float32)
    move[:, 2] = start
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _STEPS, _SMALL_STEP)
    try:
        _, found = cv2.findTransformECC(
            reference, picture, move.copy(), cv2.MOTION_TRANSLATION, criteria, swept, _SMOOTHED
        )
    except cv2.error:  # the alignment does not converge for unrelated pictures
        return move
    return np.asarray(found, dtype=np.float32)
