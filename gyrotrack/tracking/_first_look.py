"""Detection of a ball on a string, or of a long body with a tilted axis, in a few frames; angles of the long body."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gyrotrack._arrays import Floats
from gyrotrack._errors import TrackingError
from gyrotrack.tracking._film import FEWEST_FRAMES, Film, frames_of, fresh_frames
from gyrotrack.tracking._point_motion import TrackedPoint, about_pivot
from gyrotrack.tracking._point_tracker import PointPath
from gyrotrack.tracking._silhouettes import (
    CompactBody,
    Foreground,
    LongBody,
    long_tilted_body,
)

_SHOWN = 0.8
"""Smallest share of the frames in which a long body is seen [1]. Chosen: a smaller value accepts other objects, a
larger one refuses films with a hand."""
_EDGE = 0.3
"""Rough standard uncertainty of the end of a silhouette [px]. Chosen: about the standard deviation of a uniform
distribution of width 1 px, 0.29 px; the scatter replaces it if larger."""


@dataclass(frozen=True)
class FirstLook:
    """The moving bodies in front of the background."""

    shape: tuple[int, int]  # height and width of the picture [px]
    compact: CompactBody | None = None
    long: LongBody | None = None
    seen: Foreground | None = None

    @property
    def pendulum(self) -> bool:
        """Whether only a compact body (a bob) moves, on an open arc."""
        return self.compact is not None and self.compact.pivot is not None


def first_look(film: Film) -> FirstLook:
    """Compare a few frames with the background, which is their median."""
    usable = fresh_frames(film)
    if len(usable) < FEWEST_FRAMES:
        return FirstLook((0, 0))
    seen = Foreground.of(film, usable)
    height, width = seen.background.shape
    long = long_tilted_body(seen.few, seen.background, seen.noise)
    return FirstLook((height, width), seen.body, long, seen)


def follow_long_body(film: Film, body: LongBody) -> TrackedPoint:
    """Measure the angle of a long body about a tilted axis, in the plane of motion, from one of its ends.

    A TrackingError is raised if the body is not seen in most frames, or if its ends are not on one ellipse.
    """
    usable = fresh_frames(film)
    shown = zip(usable.tolist(), frames_of(film, usable), strict=True)
    rows = [(k, axis) for k, frame in shown if (axis := body.axis(frame)) is not None]
    if len(rows) < max(_SHOWN * len(usable), FEWEST_FRAMES):
        raise TrackingError(
            f"The long body in {film.path.name} is seen in {len(rows)} of {len(usable)} frames only.",
            "Give the centre of rotation with --hub X,Y, or a point to follow with --point X,Y.",
        )
    half = np.array([h for _, (_, h, _) in rows])
    # a line has no sense: assume that it turns by less than a quarter turn from frame to frame
    for k in range(1, len(half)):
        if half[k] @ half[k - 1] < 0:
            half[k] *= -1.0
    centroid = np.array([c for _, (c, _, _) in rows])
    path = PointPath(
        frame=np.array([k for k, _ in rows], dtype=np.int64),
        place=hub_of(centroid, half) + half,
        covariance=np.broadcast_to(_EDGE**2 * np.eye(2), (len(rows), 2, 2)),
        radius=float(np.median([w for _, (_, _, w) in rows])) / 2.0,
        searched=len(usable),
        turns=True,
        picture=np.zeros((1, 1), dtype=np.float32),
    )
    found = about_pivot(path, film.path.name)
    if found.orbit is None:
        raise TrackingError(
            f"The ends of the long body in {film.path.name} are not on one ellipse.",
            "Give the centre of rotation with --hub X,Y, or a point to follow with --point X,Y.",
        )
    text = (
        "The direction of the long body is taken from the axis of its silhouette; its ends are not distinguished. "
        "--point X,Y follows a point instead."
    )
    return replace(
        found, way="ellipse of the axis of a silhouette", warnings=(*film.warnings, *found.warnings, text)
    )


def hub_of(centroid: Floats, half: Floats) -> Floats:
    """Return the hub (x, y) of a body whose centroid is displaced from the hub by a fixed fraction of its axis."""
    away = half - half.mean(axis=0)
    share = float(np.sum(away * (centroid - centroid.mean(axis=0))) / max(float(np.sum(away**2)), 1e-12))
    return np.asarray(centroid.mean(axis=0) - share * half.mean(axis=0))
