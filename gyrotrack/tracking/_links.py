"""Evidence of two links: a point on a circle about a pivot, and another one at a fixed distance from it.

The paths of two compact bodies show it, as do the motions of the features of two bodies: both move the joint alike.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from gyrotrack.tracking._pivot import fit_arc
from gyrotrack.tracking._silhouettes import AS_LARGE, Foreground, Spot, differs, spots_in

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
Plane = npt.NDArray[np.uint8]

# relative standard deviation of a distance up to which it is constant: a rod seen within 18 degrees of its plane of
# motion is shorter by up to 5 %
_RIGID = 0.05
_MOVES = 2.0  # smallest extent of a path, in radii of the body
_ROUGH = 0.5  # standard uncertainty of the centre of a silhouette [px]
_REACH = 2.0  # largest distance of a body from where its last step leads, in radii
_LOST = 2  # frames in a row that may miss a body, which another one occludes
_FEWEST = 20  # positions that show the motion
_PARTS = 6  # compact parts of a frame that are considered


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


def move_as_links(paths: Floats, radius: float) -> bool:
    """Return whether the paths (n, 2, 2) of two bodies, of a radius [px], are those of a joint and a point beyond it.

    The joint, which may be either of them, keeps its distance from a pivot, and the other one its distance from the
    joint, but not from the pivot.
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
    """Return whether two motions z -> a z + b (n, 2), between pairs of frames, move a joint about the hub alike [px].

    The point that both move alike is the joint of two links, at a constant distance from the hub of the first.
    """
    turn = first[:, 0] - second[:, 0]
    joint = (second[:, 1] - first[:, 1]) / np.where(np.abs(turn) < 1e-9, 1e-9, turn)
    distance = np.abs(joint - hub)
    middle = float(np.median(distance))
    # the median deviation of normal noise is 0.67 standard deviations
    return 1.4826 * float(np.median(np.abs(distance - middle))) < _RIGID * middle


def _constant(distance: Floats) -> bool:
    return float(np.std(distance)) < _RIGID * float(np.mean(distance))
