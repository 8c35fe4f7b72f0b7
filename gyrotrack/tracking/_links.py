"""Evidence of two links: a joint on a circle about a pivot, and a point at a fixed distance from the joint.

There are three kinds of evidence. The paths of two compact bodies may show a joint. The features of two bodies may have
motions that both move the joint in the same way. Or the silhouettes of a tracked body have a part that extends beyond
the body and does not turn with the body.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from gyrotrack._arrays import Bools, Complexes, Floats, Plane
from gyrotrack.tracking._pivot import fit_arc
from gyrotrack.tracking._registration import Ring
from gyrotrack.tracking._silhouettes import (
    AS_LARGE,
    Foreground,
    Spot,
    differs,
    median_picture,
    parts_of,
    spots_in,
)

_RIGID = 0.05
"""Largest relative standard deviation of a constant distance [1]. Derived: a rod within 18 degrees of its
plane of motion is shorter by up to 1 - cos 18 degrees = 5 %."""
_MOVES = 2.0
"""Smallest extent of a path [radii]. Chosen: a smaller value takes noise for a motion, a larger one refuses small
oscillations."""
_ROUGH = 0.5
"""Standard uncertainty of the centre of a silhouette [px]. Chosen: a smaller value rejects the arc of a blurred body, a
larger one leaves the pivot undetermined."""
_REACH = 2.0
"""Largest distance of a body from the extrapolation of its last step [radii]. Chosen: a smaller value loses fast
bodies, a larger one confuses bodies."""
_LOST = 2
"""Number of frames in a row in which a body may be occluded by another body [frames]. Chosen: a smaller number ends the
paths early, a larger one confuses bodies."""
_FEWEST = 20
"""Smallest number of positions of a moving body [1]. Chosen: with fewer, positions agree by chance; with more, short
paths are refused."""
_PARTS = 6
"""Largest number of compact parts of a frame that are considered [1]. Chosen: a larger number costs time, a smaller one
loses bodies among shadows."""
_RIM = (0.8, 1.0)
"""Inner and outer radius between which the body itself is seen [radii]. Chosen: nearer to the hub all directions are
covered, farther out the body ends."""
_BEYOND = (1.3, 1.5)
"""Inner and outer radius between which a link beyond the body is seen [radii]. Chosen: nearer to the rim blur is seen,
farther out a short link ends."""
_DIRECTION = 0.14
"""Half width of the range of angles that counts as one direction [rad]. Chosen: 8 degrees; a smaller value separates a
part of the body from itself, a larger one joins a link to it."""
_SHOWN = 0.6
"""Smallest share of the frames in which a link is seen [1]. Chosen: a smaller value finds links in shadows, a larger
one overlooks links that cross the body."""
_TURNS_WITH = 0.75
"""Largest share of the frames with a visible link in which the link has one direction relative to the body [1].
Measured: 0.4 to 0.6 for links of drawn double pendulums, 1 for a part of the body."""
_SEEN = 4
"""Smallest number of positions that show a body at rest [1]. Chosen: a smaller number takes a shadow for a body, a
larger one overlooks a body that is sometimes occluded."""
_LEAVES = 3.0
"""Smallest extent of the path of a moving body [px]. Chosen: a smaller value takes noise for a motion, a larger one
overlooks small oscillations."""


def paths_of(frames: Sequence[Plane], seen: Foreground, spots: tuple[Spot, Spot]) -> Floats:
    """Return the paths (n, 2, 2) [px] of two compact bodies through consecutive frames, until one of them is lost."""
    last = np.array([s.place for s in spots])
    gate = _REACH * np.array([s.radius for s in spots])
    step = np.zeros((2, 2))
    found, missed = [last], 0
    for frame in frames[1:]:
        parts = spots_in(differs(frame, seen.background, seen.noise), 0.5 * AS_LARGE, _PARTS)
        place = np.array([s.place for s in parts]).reshape(-1, 2)
        expected = last + (1 + missed) * step
        away = np.hypot(*np.moveaxis(place[None] - expected[:, None], 2, 0))
        nearest = away.argmin(axis=1) if len(parts) > 1 else np.zeros(2, dtype=np.int64)
        if nearest[0] == nearest[1] or (away[[0, 1], nearest] > (1 + missed) * gate).any():
            missed += 1
            if missed > _LOST:
                break
            continue
        step = (place[nearest] - last) / (1 + missed)
        last, missed = place[nearest], 0
        found.append(last)
    return np.array(found)


def one_rests(paths: Floats) -> bool:
    """Return whether one of two bodies with the paths (n, 2, 2) [px] is seen long enough and is at rest."""
    return len(paths) >= _SEEN and float(np.hypot(*np.ptp(paths, axis=0).T).min()) < _LEAVES


def move_as_links(paths: Floats, radius: float) -> bool:
    """Return whether the paths (n, 2, 2) of two bodies of a `radius` [px] belong to a joint and a point beyond it.

    Either body may be the joint. The distance of the joint from a pivot is constant. The distance of the other body
    from the joint is constant, but its distance from the pivot is not.
    """
    if len(paths) < _FEWEST or np.hypot(*np.ptp(paths, axis=0).T).min() < _MOVES * radius:
        return False
    rod = np.hypot(*(paths[:, 1] - paths[:, 0]).T)
    if not _constant(rod):
        return False
    for joint, end in ((paths[:, 0], paths[:, 1]), (paths[:, 1], paths[:, 0])):
        arc = fit_arc(joint, np.full(len(joint), _ROUGH))
        if not arc.determined:
            continue
        of_joint, of_end = (np.hypot(*(p - arc.hub).T) for p in (joint, end))
        if _constant(of_joint) and not _constant(of_end):
            return True
    return False


def share_a_joint(hub: complex, first: Complexes, second: Complexes) -> bool:
    """Return whether two motions z -> a z + b (n, 2), between pairs of frames, share a joint that circles the hub.

    The joint of two links is the point that both motions displace equally [px]; its distance from the hub of the first
    motion is constant.
    """
    turn = first[:, 0] - second[:, 0]
    joint = (second[:, 1] - first[:, 1]) / np.where(np.abs(turn) < 1e-9, 1e-9, turn)
    distance = np.abs(joint - hub)
    middle = float(np.median(distance))
    # the median deviation of normal noise is 0.67 standard deviations
    return 1.4826 * float(np.median(np.abs(distance - middle))) < _RIGID * middle


def carries_a_link(ring: Ring, frames: Sequence[Plane], angle: Floats, noise: float) -> bool:
    """Return whether a link is joined to a tracked body, extends beyond the body, and does not turn with it.

    `angle` (n,) are the angles of the body in the frames, clockwise as seen [rad]; `noise` is the noise of single
    frames.
    """
    background = median_picture(frames)
    body, beyond = (
        Ring.about(ring.hub, low * ring.outer, high * ring.outer, stretch=ring.stretch)
        for low, high in (_RIM, _BEYOND)
    )
    # directions relative to the body: a part that turns with the body keeps its direction
    width = math.ceil(_DIRECTION / beyond.step)
    seen, joined = np.zeros(beyond.columns), 0
    for frame, turn in zip(frames, angle, strict=True):
        there = _joined(differs(frame, background, noise), body, beyond)
        if there.any():
            joined += 1
            wide = cv2.dilate(np.tile(there, 3)[None].astype(np.uint8), np.ones((1, 2 * width + 1), np.uint8))
            seen += np.roll(wide[0, len(there) : 2 * len(there)], -round(turn / beyond.step))
    return joined > _SHOWN * len(frames) and float(seen.max()) < _TURNS_WITH * joined


def _joined(region: Plane, body: Ring, beyond: Ring) -> Bools:
    """Return the columns of a ring that contain parts of a region which are connected to a ring farther inside."""
    closed = cv2.morphologyEx(region, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    label, _ = parts_of(np.asarray(closed, dtype=np.uint8))
    inside, outside = (_labels(label, ring) for ring in (body, beyond))
    shared = np.intersect1d(inside[inside > 0], outside)
    return np.asarray(np.isin(outside, shared).any(axis=0))


def _labels(label: npt.NDArray[np.int32], ring: Ring) -> npt.NDArray[np.int32]:
    """Return the labels of the pixels at the samples of a ring, 0 outside the picture."""
    x, y = (np.rint(v).astype(np.int64) for v in ring.grid())
    height, width = label.shape
    within = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    return np.where(within, label[y.clip(0, height - 1), x.clip(0, width - 1)], 0)


def _constant(distance: Floats) -> bool:
    return float(np.std(distance)) < _RIGID * float(np.mean(distance))
