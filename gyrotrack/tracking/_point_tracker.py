"""Tracking of one point of a body through a film: a ball, a bob, a dot, or any patch with detail.

First the patch is followed by template matching, which finds the patch again after an occlusion; its rotation is
determined by Gauss-Newton steps. Then the picture of the patch is averaged and registered in every frame. If the patch
is at the position p and rotated by theta, the picture at the point u of the patch is

    I(p + R(theta) u) = s(u) B(p + R(theta) u) + q(u)

with the background B, the transparency s of the patch (0 on the body, 1 beside it), and q its brightness times (1 - s).
The pictures are linear in s and q, which follow from a regression of the pictures on B. p is determined by Gauss-Newton
steps (S. Baker, I. Matthews, IJCV 56, 221, 2004). Pixels are weighted by their inverse variances, so that a string or a
shadow has little weight. Places are (x, y) in px, x to the right, y down; the centre of the first pixel is (0, 0).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from gyrotrack._arrays import Bools, Floats, Integers, Picture, Plane
from gyrotrack._errors import TrackingError, UsageError
from gyrotrack.tracking._diagnosis import FOLLOW_LINKS, RefusedFilmError, frames_of_one_shot
from gyrotrack.tracking._film import FEWEST_FRAMES, Film, FrameSource, Progress, frames_of, reduced
from gyrotrack.tracking._hub_search import spatial_noise
from gyrotrack.tracking._links import move_as_links, one_rests, paths_of
from gyrotrack.tracking._pivot import fit_arc
from gyrotrack.tracking._silhouettes import (
    ALIKE,
    AS_LARGE,
    Foreground,
    Spot,
    depth_of,
    differs,
    parts_of,
    spot_of,
    spots_in,
)

_CORE = 0.7
"""The middle of a part is the mean of the pixels whose distance from its edge, divided by the largest such distance,
exceeds this value [1]. Chosen: a smaller value includes joined rods, a larger one averages few pixels."""
_LATE = 0.1
"""Largest share of the frames that may precede the first frame that shows a spot [1]. Chosen: a smaller value refuses
films with a hand at the start, a larger one skips motion."""
_REACH = 12.0
"""Largest distance of a spot from the given point [px]. Chosen: the accuracy of a click; a smaller value
misses the spot, a larger one takes another body."""
_PATCHES = (6.0, 8.0, 11.0, 15.0, 20.0, 28.0)
"""Radii of a patch without an outline that are tried, the smallest first [px]. Chosen: by factors of about 1.4; larger
patches include the background, smaller patches lack detail."""
_SHARP = 0.05
"""Largest standard uncertainty of the position of a patch [px]. Chosen: a smaller value selects large patches, a
larger one follows patches without detail."""
_MATCHED = 0.35
"""Largest mean square difference of a match, divided by the contrast of the patch [1]. Chosen: a smaller value loses a
patch that turns, a larger one matches other objects."""
_ANCHORED = 0.5
"""The template is not renewed if the mean square difference of a match, divided by its limit, is at most this value
[1]. Chosen: a smaller value lets the template drift, a larger one loses a patch that turns."""
_PRESENT = 0.4
"""A match shows the patch if its mean square difference from the background, divided by the mean square difference of
the patch from the background in the first frame, is at least this value [1]. Chosen: a smaller value matches the
background, a larger one loses a patch in shadow."""
_TEMPLATE = 12.0
"""The picture of a large patch is reduced, by an integer factor, to about this radius [px]. Chosen: a larger radius
costs time, a smaller one loses precision."""
_COARSE = 5.0
"""Radius of a spot in the reduced picture that is searched as a whole [px]. Chosen: a larger radius costs time, a
smaller one does not distinguish the spot from similar spots."""
_FOLLOWED = 90
"""Number of frames in which the paths of two bodies are tested for links [frames]. Chosen: a larger number costs time,
a smaller one shows little motion."""
_FOUND = 0.6
"""Smallest share of the frames in which a patch is found [1]. Chosen: a smaller value measures few frames, a larger one
refuses films with occlusions."""
_LEARNT = 200
"""Largest number of frames for the average picture of the patch [frames]. Chosen: a smaller number gives a noisier
picture, a larger one costs time."""
_ROUNDS = 4
"""Number of iterations, each of which averages a patch and then measures its positions [iterations]. Chosen: a smaller
number stops before patch and positions agree, a larger one costs time."""
_TURN_ROUNDS = 3
"""Number of iterations, each of which measures the path of a patch and then its rotation [iterations]. Chosen: a
smaller number stops before path and rotation agree, a larger one costs time."""
_STEPS = 8
"""Largest number of Gauss-Newton steps of a patch [iterations]. Chosen: a smaller number stops early, a larger one
costs time."""
_SMALL_STEP = 0.005
"""Gauss-Newton step that ends the registration of a patch [px]. Chosen: a larger value stops early, a smaller one costs
time."""
_LARGEST = 0.5
"""Largest displacement by Gauss-Newton steps [radii]. Chosen: a smaller value omits frames with a rough start, a larger
one accepts other objects."""
_BLUR = 2.7
"""Standard deviation of the coefficients of the second derivatives [px2]. Derived: L^2 / 24 for a motion blur of L = 8
px."""
_BLUR_PRIOR = np.diag([0.0, 0.0, *[_BLUR**-2] * 3])
"""Prior precision of the parameters of a step: displacement (x, y) and second derivatives [1/px4]. Derived: `_BLUR`^-2;
displacements are free."""
_ROBUST = 4.0
"""Residual above which the weight of a pixel is reduced, in standard deviations [1]. Source: weights of P. Huber, Ann.
Math. Statist. 35, 73 (1964); a smaller limit costs precision, a larger one admits disturbed pixels."""
_TURNS_WITH = 0.95
"""A patch is taken to rotate about the hub if the residual with this rotation, divided by the residual without
rotation, is at most this value [1]. Chosen: a smaller value keeps the orientation of a bob on a rod; with a larger one,
noise makes round bobs rotate."""
_UNSEEN = 1e9
"""Variance of a pixel that is visible in no frame [grey levels squared]. Chosen: large against any other variance, so
that the pixel has no weight."""
_ROUGH = 0.5
"""Standard uncertainty of a position by template matching [px]. Chosen: a smaller value refuses inaccurate paths, a
larger one accepts other motions."""
_ROUGHLY_ROUND = 0.06
"""Largest radial scatter of a path by template matching, divided by its extent [1]. Chosen: twice
`_point_motion._ROUND`; a smaller value refuses blurred bobs, a larger one costs time on other paths."""
HIDDEN = 6.0
"""Largest mean square residual of a frame that shows the patch, divided by the median of all frames [1]. Chosen: a
smaller value omits frames of uneven light, a larger one keeps frames with a hand."""
_SILHOUETTE = 15.0
"""Largest radius of a patch whose radius is taken from the silhouette about it [px]. Chosen: a smaller value discards
the edge of a large bob, a larger one includes the background."""
_TURN_SEEN = 0.05
"""The rotation of a patch is followed if its standard uncertainty in one frame is at most this value, which is also the
prior standard deviation of a followed rotation [rad]. Chosen: a smaller value keeps the orientation of faint patches, a
larger one follows noise."""
_TURN_STEPS = 6
"""Number of steps of the rotation of a patch [iterations]. Chosen: a smaller number stops early, a larger one costs
time."""
_ROUND = 0.7
"""Smallest area of a round patch, divided by the area of the circle about it [1]. Chosen: a smaller value takes a rod
for a bob, a larger one refuses blurred bobs."""
_LEAST_ROUND = 8
"""Smallest radius of a patch that has an interior [px]. Chosen: a smaller patch has an edge only; a larger value
ignores the detail of small bobs."""
_TURNED = 0.3
"""A patch has a visible orientation if a rotation by this angle increases the residual [rad]. Chosen: the effect of a
smaller value is below the noise; a larger one may reach the next period of a periodic patch."""
_TURN_STARTS = 5
"""Number of additional initial angles of a rotation on each side, tried if the residual is unusual [1]. Chosen: a
smaller number loses a fast rotation, a larger one costs time."""
_TURN_STEP = 1.5
"""Distance between the additional initial angles of a rotation, multiplied by the radius of the patch [px]. Chosen: the
width of an edge; a larger distance misses the minimum, a smaller one costs time."""
_UNUSUAL = 1.5
"""Additional initial angles of a rotation are tried if the residual, divided by its running mean, is at least this
value [1]. Chosen: a smaller value costs time, a larger one keeps a lost rotation."""
_UPDATE = 0.1
"""Weight of a frame in the running mean of the residual [1]. Chosen: with a smaller value, the mean follows changes of
light late; with a larger one, it adapts to a lost rotation."""
_NECK = 0.7
"""The depth of a point is its distance from the edge of the body. Only rods join a part to the body if the depth at the
distance `_NECK_AT` from the middle of the part, divided by the depth at the middle, is at most this value [1]. Chosen:
a smaller value joins the rod to the part, a larger one divides a compact body."""
_NECK_AT = 1.5
"""Distance from the middle of a part at which the depth is compared [depth of the part]. Chosen: just outside of a
circle; a larger distance reaches other parts."""
_SLENDER = 1.6
"""Radius of the circle of the same area, divided by the radius of the inscribed circle, above which a body is not
compact [1]. Derived: sqrt(8 / pi) = 1.6 for a rectangle twice as long as wide."""


@dataclass(frozen=True)
class PointPath:
    """The path of a point."""

    frame: Integers  # shape (m,); frames in which the point was measured
    place: Floats  # shape (m, 2); position (x, y) of the point [px]
    # shape (m, 2, 2); the Cramer-Rao bound of the position, enlarged where the patch does not match its picture [px2]
    covariance: Floats
    radius: float  # radius of the patch [px]
    searched: int  # number of frames in which the point was searched for
    turns: bool  # whether the patch rotates with the line from the hub to the patch
    picture: Picture  # the learnt picture of the patch, in grey levels
    keeps: bool = False  # whether the picture certainly does not rotate with this line


Turn = Callable[[Integers, Floats], Floats | None]
"""Returns the rotation (n,) [rad] of a body for frames (n,) and positions (n, 2), or None if it is undetermined."""


def track_point(
    film: Film,
    start: tuple[float, float] | None,
    turn_of: Turn,
    progress: Progress | None = None,
    seen: Foreground | None = None,
) -> PointPath:
    """Follow the point at `start` in the first frame; without `start`, follow the only compact body that moves.

    `turn_of` returns the rotation of the patch for approximate positions; `seen` is the foreground of the film, if it
    is known. A TrackingError is raised if the given place has no detail to follow, if several bodies move and none is
    selected, or if the patch is lost in most frames.
    """
    usable = frames_of_one_shot(film)
    seen = seen or Foreground.of(film, usable)
    if start is None:
        skipped, spot = _only_spot(film, usable, seen)
        return _track_spot(film, usable[skipped:], spot, seen, turn_of, progress, start)
    first = film.some(usable[:1])[0]
    height, width = first.shape
    if not (0 <= start[0] < width and 0 <= start[1] < height):
        what = f"The point ({start[0]:g}, {start[1]:g}) px is outside the picture of {width} x {height} px."
        raise UsageError(what, "Give its position in the first frame with --point X,Y in px.")
    error: TrackingError | None = None
    # the silhouette at the place may belong to two links, and then changes its shape
    for spot in _clicked(first, seen, start):
        try:
            return _track_spot(film, usable, spot, seen, turn_of, progress, start)
        except TrackingError as lost:
            error = error or lost
    assert error is not None  # noqa: S101 - there is a spot
    raise error


def _track_spot(
    film: Film,
    usable: Integers,
    spot: Spot,
    seen: Foreground,
    turn_of: Turn,
    progress: Progress | None,
    start: tuple[float, float] | None,
) -> PointPath:
    """Follow a spot of the first usable frame."""
    factor = max(round(spot.radius / _TEMPLATE), 1)
    where, unselected = spot.place, start is None
    noise, background = seen.noise, seen.background
    if factor == 1:
        return _tracked(
            film, usable, spot, background, noise, turn_of, progress, where=where, unselected=unselected
        )
    # averaged pixels have independent noise: the reduced picture determines the position equally well
    small = _Reduced(film, factor)
    path = _tracked(
        small,
        usable,
        small.spot(spot),
        reduced(background, factor),
        noise / factor,
        lambda frame, place: turn_of(frame, small.seen(place)),
        progress,
        where=where,
        unselected=unselected,
    )
    return replace(
        path,
        place=small.seen(path.place),
        covariance=factor**2 * path.covariance,
        radius=factor * path.radius,
    )


@dataclass(frozen=True)
class _Reduced:
    """A film with the means of squares of `factor` px as pixels."""

    film: Film
    factor: int

    @property
    def path(self) -> Path:
        return self.film.path

    def frames(self, first: int = 0, stop: int | None = None) -> Iterator[Plane]:
        for frame in self.film.frames(first, stop):
            yield reduced(frame, self.factor)

    def some(self, index: Integers) -> Sequence[Plane]:
        return [reduced(frame, self.factor) for frame in self.film.some(index)]

    def seen(self, place: Floats) -> Floats:
        """Convert places (n, 2) of the reduced picture to places in the film [px]."""
        return (place + 0.5) * self.factor - 0.5

    def spot(self, spot: Spot) -> Spot:
        """Return a spot of the film in the reduced picture."""
        x, y = (np.array(spot.place) + 0.5) / self.factor - 0.5
        middle = spot.mask.shape[0] // 2
        half = math.ceil(middle / self.factor)
        there = middle + self.factor * np.arange(-half, half + 1)
        inside = np.flatnonzero((there >= 0) & (there < len(spot.mask)))
        mask = np.zeros((len(there), len(there)), dtype=np.uint8)
        mask[np.ix_(inside, inside)] = spot.mask[np.ix_(there[inside], there[inside])]
        return Spot((float(x), float(y)), spot.radius / self.factor, mask)


def _tracked(
    film: FrameSource,
    usable: Integers,
    spot: Spot,
    background: Picture,
    noise: float,
    turn_of: Turn,
    progress: Progress | None,
    *,
    where: tuple[float, float],
    unselected: bool,
) -> PointPath:
    rough, turns, found = _follow(film, usable, spot, background)
    if unselected and found.mean() >= _FOUND:
        _retraced(rough[found], film.path.name)
    if found.mean() < _FOUND or found.sum() < FEWEST_FRAMES:
        raise TrackingError(
            f"The point at ({where[0]:.0f}, {where[1]:.0f}) px in {film.path.name} is followed through "
            f"{found.sum()} of {len(found)} frames only.",
            "Give a more distinct point with --point X,Y, or cut the film to the motion.",
        )
    frame, followed = usable[found], turns[found]

    def learnt(place: Floats, turn: Floats | None, turn_sigma: float = 0.0) -> _Learnt:
        return _learnt(film, frame, place, turn, turn_sigma, background, noise, spot.radius)

    best = learnt(rough[found], None)
    if np.ptp(followed) * spot.radius > 1.0:
        other = learnt(rough[found], followed, _TURN_SEEN)
        best = other if other.residual < _TURNS_WITH * best.residual else best
    # iterate, because the rotation of the patch depends on its path, and the path on the rotation
    keeps = False
    for _ in range(_TURN_ROUNDS):
        about = turn_of(frame, best.place)
        if about is None:
            break
        other = learnt(best.place, about)
        # a followed rotation contains noise
        if other.residual > best.residual * (_TURNS_WITH if best.turn is None else 1.0 / _TURNS_WITH):
            keeps = best.turn is None and best.residual < _TURNS_WITH * other.residual
            break
        best = other
    return replace(_measured(film, frame, best, len(usable), progress), keeps=keeps)


def _retraced(place: Floats, name: str) -> None:
    """Raise a TrackingError unless the approximate positions of an automatically selected point are near a circle."""
    arc = fit_arc(place, np.full(len(place), _ROUGH))
    extent = float(np.hypot(*np.ptp(place, axis=0)))
    if math.hypot(arc.noise, arc.by_place) > max(_ROUGHLY_ROUND * extent, 2.0 * _ROUGH):
        raise TrackingError(
            f"No point that moves about a pivot is found in {name}: the path of the largest compact body deviates from "
            f"a circle by {math.hypot(arc.noise, arc.by_place):.1f} px rms over {extent:.0f} px.",
            "Give a point to follow with --point X,Y, and its pivot with --hub X,Y.",
        )


def _clicked(frame: Plane, seen: Foreground, place: tuple[float, float]) -> Iterator[Spot]:
    """Return candidates for a place: the compact moving body, a patch with detail, or a body of any shape.

    A TrackingError is raised without candidates.
    """
    # a codec preserves more noise in key frames
    background, noise = seen.background, max(seen.noise, spatial_noise([frame]))
    spot = _spot_at(frame, background, noise, place)
    if spot is not None:
        yield spot
    try:
        yield _patch_at(frame, background, noise, place)
    except TrackingError:
        if spot is not None:
            return
        if (spot := _spot_at(frame, background, noise, place, compact=False)) is None:
            raise
        yield spot


def _spot_at(
    frame: Plane, background: Picture, noise: float, place: tuple[float, float], *, compact: bool = True
) -> Spot | None:
    """Return the moving body at a place of a frame, or None; with `compact`, also None for a long body."""
    region = differs(frame, background, noise)
    y, x = np.nonzero(region)
    if not len(x):
        return None
    away = np.hypot(x - place[0], y - place[1])
    nearest = int(np.argmin(away))
    if away[nearest] > _REACH:
        return None
    depth = depth_of(region)
    at = (int(x[nearest]), int(y[nearest]))
    while True:  # move to the middle of the selected part
        reach = max(2, math.ceil(0.5 * float(depth[at[1], at[0]])))
        top, left = max(at[1] - reach, 0), max(at[0] - reach, 0)
        near = depth[top : at[1] + reach + 1, left : at[0] + reach + 1]
        row, column = np.unravel_index(int(np.argmax(near)), near.shape)
        best = (left + int(column), top + int(row))
        if depth[best[1], best[0]] <= depth[at[1], at[0]]:
            break
        at = best
    spot, inner = spot_of(parts_of(region), at), float(depth[at[1], at[0]])
    if spot is None:
        return None
    slender = spot.radius > _SLENDER * inner
    if math.dist(spot.place, place) <= max(inner, _REACH) and not (compact and slender):
        return spot
    v, u = np.ogrid[0 : depth.shape[0], 0 : depth.shape[1]]
    away = np.hypot(u - at[0], v - at[1])
    if compact and float(depth[np.abs(away - _NECK_AT * inner) < 1.0].max(initial=0.0)) > _NECK * inner:
        return None  # the place is on a long or large body
    # rods join the selected part to other parts: use the inscribed disc about the middle of the selected part
    core = (depth > _CORE * inner) & (away < inner)
    y, x = np.nonzero(core)
    weight = depth[core] - _CORE * inner
    half = math.ceil(inner)
    v, u = np.ogrid[-half : half + 1, -half : half + 1]
    middle = (float(np.average(x, weights=weight)), float(np.average(y, weights=weight)))
    return Spot(middle, inner, (np.hypot(u, v) <= inner).astype(np.uint8))


def _only_spot(film: Film, usable: Integers, seen: Foreground) -> tuple[int, Spot]:
    """Return the compact moving body, and the number of frames before the first frame that shows it.

    The body has the size of the largest compact body in most frames of a sample. A hand or a shadow that is visible in
    a few frames, for example at the start, is therefore ignored. A TrackingError is raised if there is no such body,
    or a second body of similar size.
    """
    body, background, noise = seen.body, seen.background, seen.noise
    for skipped, frame in enumerate(film.some(usable[: max(int(_LATE * len(usable)), 1)])):
        spots = spots_in(differs(frame, background, noise), AS_LARGE, 2 if body is None else 5)
        if body is not None:
            spots = [s for s in spots if 1.0 / ALIKE < s.radius / body.radius < ALIKE]
        if len(spots) > 1:
            raise _several(film, usable[skipped:], seen, frame, spots)
        if spots:
            return skipped, spots[0]
        if body is None:
            break
    raise TrackingError(
        f"No compact body moves in the first frame of {film.path.name}.",
        "Give a point to follow with --point X,Y.",
    )


def _several(
    film: Film, usable: Integers, seen: Foreground, frame: Plane, spots: Sequence[Spot]
) -> TrackingError:
    """Return the error for a film of several bodies: two links if a rod joins them and they move as links.

    A part of the picture that appears or vanishes is not a body: if one of the two parts is at rest, the error has no
    `kind`.
    """
    one, other = spots[:2]
    (x, y), (u, v) = one.place, other.place
    linked = _linked(differs(frame, seen.background, seen.noise), one, other)
    paths = paths_of(film.some(usable[: _FOLLOWED if linked else _FOLLOWED // 2]), seen, (one, other))
    if one_rests(paths):
        return TrackingError(
            f"Of the two largest compact parts that differ from the background of {film.path.name} in the first frame, "
            f"at ({x:.0f}, {y:.0f}) px and at ({u:.0f}, {v:.0f}) px, at least one is at rest.",
            "Give a point on the moving body with --point X,Y.",
        )
    links = linked and move_as_links(paths, max(one.radius, other.radius))
    return RefusedFilmError(
        f"Several bodies move in {film.path.name}, at ({x:.0f}, {y:.0f}) px and at ({u:.0f}, {v:.0f}) px in the first "
        f"frame{', which are joined and move as two links' if links else ''}.",
        FOLLOW_LINKS if links else f"Select one with --point {x:.0f},{y:.0f} or --point {u:.0f},{v:.0f}.",
        kind="two links" if links else "two bodies",
        evidence={"radius_px": one.radius, "other_radius_px": other.radius},
        frames=(frame,),
    )


def _linked(region: Plane, one: Spot, other: Spot) -> bool:
    """Return whether a thin part (a rod or a string) joins two compact parts of a region.

    A morphological opening with a disc of half the size of the smallest body removes the thin part.
    """
    size = max(round(0.5 * AS_LARGE * min(one.radius, other.radius)), 1)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * size + 1, 2 * size + 1))
    places = [(round(s.place[1]), round(s.place[0])) for s in (one, other)]
    labels = [cv2.connectedComponents(r)[1] for r in (region, cv2.morphologyEx(region, cv2.MORPH_OPEN, disc))]
    (a, b), (c, d) = ([int(label[p]) for p in places] for label in labels)
    return a == b != 0 and c != d


def _moving(frame: Plane, background: Picture, noise: float) -> Spot | None:
    """Return the largest compact body that moves."""
    region = differs(frame, background, noise)
    depth = depth_of(region)
    row, column = np.unravel_index(int(np.argmax(depth)), depth.shape)
    return spot_of(parts_of(region), (int(column), int(row)))


def _patch_at(frame: Plane, background: Picture, noise: float, place: tuple[float, float]) -> Spot:
    """Return the smallest patch about a place whose detail determines its position in both directions.

    On a silhouette the patch is as large as the silhouette permits, because errors of the codec affect few pixels.
    """
    smooth = cv2.GaussianBlur(frame.astype(np.float32), (0, 0), 1.0)
    by_x, by_y = (
        cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=0.125),
        cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=0.125),
    )
    y, x = np.ogrid[0 : frame.shape[0], 0 : frame.shape[1]]
    away = np.hypot(x - place[0], y - place[1])
    depth = float(depth_of(differs(frame, background, noise))[round(place[1]), round(place[0])])
    largest = max([r for r in _PATCHES if r <= depth], default=_PATCHES[0])
    for radius in (r for r in _PATCHES if r >= min(largest, _SILHOUETTE)):
        inside = away <= radius
        g = np.stack([by_x[inside], by_y[inside]])
        least = float(np.linalg.eigvalsh(g @ g.T)[0])
        # gradients of noise: after smoothing, the variance of each is noise^2 / (8 pi) (0.04 noise^2)
        least -= 0.04 * noise**2 * int(inside.sum())
        if least > 0 and noise / math.sqrt(least) < _SHARP:
            half = math.ceil(radius)
            v, u = np.ogrid[-half : half + 1, -half : half + 1]
            return Spot(place, radius, (np.hypot(u, v) <= radius).astype(np.uint8))
    hint = "Give a point on a corner, a dot or an edge of the moving body with --point X,Y."
    if (moving := _moving(frame, background, noise)) is not None:
        right, down = moving.place
        hint = f"In the first frame, a body that moves is at --point {right:.0f},{down:.0f}."
    raise TrackingError(
        f"The picture about the point ({place[0]:g}, {place[1]:g}) px of the first frame has no detail to follow.",
        hint,
    )


def _matched(
    picture: Picture, changed: Picture, template: Picture, mask: Picture, change: float
) -> tuple[tuple[float, float], float]:
    """Return the place of the best match in a picture, (x, y) of its centre, and its mean square difference.

    `changed` is the squared difference from the background. Where its average over the mask is below `change`, the
    place shows the background, and the missing difference is added to the difference of the match.
    """
    square = cv2.matchTemplate(picture, template, cv2.TM_SQDIFF, mask=mask)
    present = cv2.matchTemplate(changed, mask, cv2.TM_CCORR)
    square = square + np.maximum(change * float(mask.sum()) - present, 0.0)
    square = np.where(np.isfinite(square), square, np.inf)
    row, column = np.unravel_index(int(np.argmin(square)), square.shape)
    place = []
    for line, at in ((square[row], int(column)), (square[:, column], int(row))):
        shift = 0.0
        if 0 < at < len(line) - 1:
            before, here, after = (float(v) for v in line[at - 1 : at + 2])
            bend = before - 2.0 * here + after
            shift = 0.5 * (before - after) / bend if bend > 0 else 0.0
        place.append(at + shift)
    half = template.shape[0] // 2
    return (place[0] + half, place[1] + half), max(float(square[row, column]), 0.0) / float(mask.sum())


def _follow(
    film: FrameSource, usable: Integers, spot: Spot, background: Picture
) -> tuple[Floats, Floats, Bools]:
    """Follow a patch by template matching; return positions (n, 2), rotations (n,) and a mask of found patches (n,).

    The patch is searched for at the position predicted by its last steps, then in a reduced picture of the whole frame.
    The rotation is relative to the first frame, clockwise as seen [rad]; if the patch does not show its rotation, the
    last value is kept.
    """
    size = spot.mask.shape[0]
    half = size // 2
    mask = spot.mask.astype(np.float32)
    shrink = max(spot.radius / _COARSE, 1.0)
    place, found = np.full((len(usable), 2), np.nan), np.zeros(len(usable), dtype=np.bool_)
    turns, spin, usual = np.zeros(len(usable)), 0.0, 0.0
    anchor: Picture | None = None
    recent: Picture | None = None
    limit, change, last, steps = 0.0, 0.0, np.array(spot.place), list[Floats]()
    behind = cv2.copyMakeBorder(background, half, half, half, half, cv2.BORDER_REPLICATE)
    for k, frame in enumerate(frames_of(film, usable)):
        picture = cv2.copyMakeBorder(frame, half, half, half, half, cv2.BORDER_REPLICATE).astype(np.float32)
        changed = (picture - behind) ** 2
        if anchor is None or recent is None:
            anchor = recent = _cut(picture, last + half, size)
            ring = cv2.dilate(spot.mask, np.ones((5, 5), np.uint8)) > spot.mask
            inside = anchor[spot.mask > 0]
            level = float(np.median(anchor[ring])) if ring.any() else float(inside.mean())
            limit = _MATCHED * max(float(np.mean((inside - level) ** 2)), float(inside.var()))
            change = _PRESENT * float(np.mean(_cut(changed, last + half, size)[spot.mask > 0]))
            place[k], found[k] = last, True
            continue
        expected = last + _next_step(steps) if found[k - 1] else last
        turn = turns[k] = turns[k - 1] + spin
        reach = max(1.2 * spot.radius, 6.0) + (
            1.0 * float(np.hypot(*steps[-1])) if steps else 2.0 * spot.radius
        )
        shown, first, later = (_turned(p, turn) for p in (mask, anchor, recent))
        template = anchor
        best, miss = _in_window(picture, changed, expected + half, reach, first, shown, change)
        if miss > _ANCHORED * limit and recent is not anchor:
            again, other = _in_window(picture, changed, expected + half, reach, later, shown, change)
            best, miss, template = (again, other, recent) if other < miss else (best, miss, anchor)
        if miss > limit:
            template = recent
            best, miss = _in_whole(picture, changed, shrink, later, shown, change, limit)
        if miss > limit:
            steps.clear()
            spin, turns[k] = 0.0, turns[k - 1]
            continue
        aligned = _best_turn(picture, np.array(best), turn, template, mask, usual)
        if aligned is None:
            now, spin = np.array(best) - half, 0.0
        else:
            now, spin = aligned.place - half, aligned.turn - turns[k - 1]
            turns[k] = aligned.turn
            usual = aligned.residual if usual == 0.0 else usual + _UPDATE * (aligned.residual - usual)
        if found[k - 1]:
            steps = [*steps[-1:], now - last]
        last, place[k], found[k] = now, now, True
        if miss > _ANCHORED * limit:
            recent = _cut(picture, now + half, size, turns[k])
    return place, turns, found


def _cut(picture: Picture, place: Floats, size: int, turn: float = 0.0) -> Picture:
    """Return the square of `size` px about a place, in the coordinates of a patch turned by an angle."""
    c, s, half = math.cos(turn), math.sin(turn), size // 2
    to_frame = np.array(
        [[c, -s, place[0] - half * (c - s)], [s, c, place[1] - half * (s + c)]], dtype=np.float64
    )
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    found = cv2.warpAffine(picture, to_frame, (size, size), flags=how, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, dtype=np.float32)


def _turned(picture: Picture, turn: float) -> Picture:
    """Return a square picture turned about its centre, clockwise as seen."""
    if turn == 0.0:
        return picture
    size = picture.shape[0]
    return _cut(picture, np.full(2, size // 2), size, -turn)


@dataclass(frozen=True)
class _Aligned:
    """Place and rotation of a template in a picture, and the mean square residual [grey levels squared].

    `sigma` is the standard uncertainty of the rotation for independent residuals [rad].
    """

    place: Floats
    turn: float
    residual: float
    sigma: float

    @classmethod
    def of(cls, picture: Picture, place: Floats, turn: float, template: Picture, mask: Picture) -> _Aligned:
        """Align a template by Gauss-Newton steps with the gradients of the template, from initial values."""
        inside = _interior(mask)
        size, half = mask.shape[0], mask.shape[0] // 2
        v, u = (x[inside] for x in np.mgrid[-half : half + 1, -half : half + 1].astype(np.float32))
        by_v, by_u = (np.asarray(g)[inside] for g in np.gradient(template))
        slope = np.stack([by_u, by_v, u * by_v - v * by_u, np.ones_like(u)]).astype(np.float64)
        square = slope @ slope.T + 1e-6 * np.eye(4)
        covariance = np.linalg.inv(square)
        there, residual = place, math.inf
        for _ in range(_TURN_STEPS):
            rest = (template - _cut(picture, there, size, turn))[inside].astype(np.float64)
            step = covariance @ (slope @ rest)
            before, residual = residual, float(np.mean((rest - step[3]) ** 2))
            if residual >= before or (np.abs(step[:2]).max() < 0.05 and abs(step[2]) * half < 0.05):
                break
            c, s = math.cos(turn), math.sin(turn)
            there = there + np.array([c * step[0] - s * step[1], s * step[0] + c * step[1]])
            turn += float(step[2])
        # add the variance of rounding to whole grey levels
        return cls(there, turn, residual, math.sqrt((residual + 1.0) * float(covariance[2, 2])))


def _interior(mask: Picture) -> Bools:
    """Return the pixels of a patch that show its rotation: the edge of a round body is excluded."""
    inside = mask > 0.5
    half = mask.shape[0] // 2
    if inside.sum() < _ROUND * math.pi * half**2 or half < _LEAST_ROUND:
        return inside
    return cv2.erode(inside.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0


def _best_turn(
    picture: Picture, place: Floats, turn: float, template: Picture, mask: Picture, usual: float
) -> _Aligned | None:
    """Align a template from the expected rotation, and from other rotations if the residual is unusually large.

    The result is None if the picture does not show the rotation.
    """
    radius = math.sqrt(float(mask.sum()) / math.pi)
    best = _Aligned.of(picture, place, turn, template, mask)
    if best.sigma < _TURN_SEEN and best.residual > _UNUSUAL * usual:
        starts = [
            turn + sign * k * _TURN_STEP / radius for k in range(1, _TURN_STARTS + 1) for sign in (1, -1)
        ]
        others = [_Aligned.of(picture, place, start, template, mask) for start in starts]
        best = min([best, *others], key=lambda found: found.residual)
    near = float(np.hypot(*(best.place - place))) < _LARGEST * max(radius, 4.0)
    if best.sigma > _TURN_SEEN or not near:
        return None
    inside = _interior(mask)
    turned = [_cut(picture, best.place, mask.shape[0], best.turn + angle) for angle in (-_TURNED, _TURNED)]
    away = min(float(np.var((template - p)[inside])) for p in turned)
    return best if away > _UNUSUAL * (best.residual + 1.0) else None


def _next_step(steps: Sequence[Floats]) -> Floats:
    """Extrapolate the steps of a point on a circle: the direction of each step changes by the same angle."""
    if not steps:
        return np.zeros(2)
    if len(steps) < 2 or np.hypot(*steps[0]) < 2.0:
        return np.asarray(steps[-1])
    before, now = (complex(*s) for s in steps[-2:])
    after = now * now / before / max(abs(now / before), 1e-9)
    return np.array([after.real, after.imag])


def _in_window(
    picture: Picture,
    changed: Picture,
    place: Floats,
    reach: float,
    template: Picture,
    mask: Picture,
    change: float,
) -> tuple[tuple[float, float], float]:
    half, span = template.shape[0] // 2, math.ceil(reach)
    height, width = picture.shape
    x, y = round(float(place[0])), round(float(place[1]))
    left, top = max(x - span - half, 0), max(y - span - half, 0)
    right, bottom = min(x + span + half + 1, width), min(y + span + half + 1, height)
    if right - left < template.shape[1] or bottom - top < template.shape[0]:
        return (0.0, 0.0), math.inf
    (u, v), miss = _matched(
        picture[top:bottom, left:right], changed[top:bottom, left:right], template, mask, change
    )
    return (u + left, v + top), miss


def _in_whole(
    picture: Picture,
    changed: Picture,
    shrink: float,
    template: Picture,
    mask: Picture,
    change: float,
    limit: float,
) -> tuple[tuple[float, float], float]:
    """Search the whole frame, reduced by a factor, and refine the position in full resolution."""
    small, few, one, inside = (
        np.asarray(
            cv2.resize(p, None, fx=1.0 / shrink, fy=1.0 / shrink, interpolation=cv2.INTER_AREA), np.float32
        )
        for p in (picture, changed, template, mask)
    )
    odd = (one.shape[0] - 1) | 1
    one, inside = one[:odd, :odd], inside[:odd, :odd]
    (u, v), miss = _matched(small, few, np.ascontiguousarray(one), np.ascontiguousarray(inside), change)
    if miss > 2.0 * limit:
        return (0.0, 0.0), math.inf
    return _in_window(picture, changed, np.array([u, v]) * shrink, 2.0 * shrink + 2.0, template, mask, change)


@dataclass(frozen=True)
class _Layers:
    """The average picture of a patch in front of its background."""

    grid: Floats  # (2, h, w); u, the position in the patch [px]
    transparency: Picture  # s
    brightness: Picture  # q [grey levels]
    variance: Picture  # of the residuals [grey levels squared]
    background: Picture  # B, of the whole frame [grey levels]
    # prior standard uncertainty of the rotation [rad]; 0 for a known rotation
    turn_sigma: float = 0.0

    def sampled(
        self, frame: Plane | Picture, place: Floats, turn: float, how: int = cv2.INTER_CUBIC
    ) -> Picture:
        """Return the picture about a place, turned by an angle (clockwise as seen); NaN outside the frame."""
        x, y, outside = self._pixels(frame.shape, place, turn)
        found = cv2.remap(np.asarray(frame, dtype=np.float32), x, y, how, borderMode=cv2.BORDER_REPLICATE)
        return np.where(outside, np.float32(np.nan), found)

    def _pixels(self, shape: tuple[int, ...], place: Floats, turn: float) -> tuple[Picture, Picture, Bools]:
        """Return the pixels x, y of the patch about a place, and a mask of the pixels outside the frame."""
        c, s = math.cos(turn), math.sin(turn)
        x = (place[0] + c * self.grid[0] - s * self.grid[1]).astype(np.float32)
        y = (place[1] + s * self.grid[0] + c * self.grid[1]).astype(np.float32)
        return x, y, (x < 0) | (y < 0) | (x > shape[1] - 1) | (y > shape[0] - 1)

    @cached_property
    def _slopes(self) -> tuple[Picture, Picture]:
        by_s, by_q = (_derivatives(p) for p in (self.transparency, self.brightness))
        if self.turn_sigma == 0.0:
            return by_s, by_q
        u, v = self.grid.astype(np.float32)
        of_s, of_q = (np.concatenate([d, (v * d[0] - u * d[1])[None]]) for d in (by_s, by_q))
        return of_s, of_q

    @cached_property
    def _prior(self) -> Floats:
        """Prior inverse covariance of the other fitted parameters: blur and, if it is followed, rotation."""
        if self.turn_sigma == 0.0:
            return _BLUR_PRIOR
        return np.asarray(np.pad(_BLUR_PRIOR, (0, 1)) + np.diag([0.0] * 5 + [self.turn_sigma**-2]))

    def register(self, frame: Plane, place: Floats, turn: float) -> tuple[Floats, Floats, float, float]:
        """Return the place of the patch in a frame, its covariance (2, 2), the misfit, and the rotation [rad].

        The misfit is the mean square normalised residual.

        Because of motion and focus, the blur of a frame differs from the blur of the average picture. To second order,
        the difference is a combination of the second derivatives, which is fitted together with the displacement.
        """
        around = _crop(frame, place, self.grid)
        lost = place, np.full((2, 2), np.nan), math.inf, turn
        if around is None:
            return lost
        start = turn
        (left, top), part = around
        behind = self.background[top : top + part.shape[0], left : left + part.shape[1]]
        shown, behind = (np.asarray(p, dtype=np.float32) for p in (part, behind))
        here = place - np.array([left, top])
        begin = here
        by_s, by_q = self._slopes
        for _ in range(_STEPS):
            rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
            x, y, outside = self._pixels(part.shape, here, turn)
            back = cv2.remap(behind, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            seen = cv2.remap(shown, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
            rest = seen - self.transparency * back - self.brightness
            use = np.isfinite(rest) & ~outside
            slope = (by_s * back + by_q)[:, use]
            slope[:2] *= -1.0
            size = np.abs(rest[use]) / np.sqrt(self.variance[use])
            weight = np.minimum(1.0, _ROBUST / np.maximum(size, 1e-9)) / self.variance[use]
            left_side = (slope * weight) @ slope.T + self._prior
            if not use.any() or np.linalg.eigvalsh(left_side[:2, :2])[0] < 1e-9:
                return lost
            right = (slope * weight) @ rest[use]
            if self.turn_sigma:
                right[5] += (start - turn) / self.turn_sigma**2
            found = np.linalg.solve(left_side, right)
            step = rotation @ found[:2]
            here = here + step
            if self.turn_sigma:
                turn += float(found[5])
            if np.abs(step).max() < _SMALL_STEP:
                break
        covariance = rotation @ np.linalg.inv(left_side)[:2, :2] @ rotation.T
        misfit = float(np.mean(size**2))
        reach = _LARGEST * float(np.abs(self.grid).max())
        if np.hypot(*(here - begin)) > reach:
            misfit = math.inf
        return here + np.array([left, top]), covariance, misfit, turn


def _derivatives(picture: Picture) -> Picture:
    """Return the derivatives of a picture with respect to x, y, xx, xy and yy, (5, h, w)."""
    by_y, by_x = np.gradient(picture)
    by_yx, by_xx = np.gradient(by_x)
    by_yy, _ = np.gradient(by_y)
    return np.stack([by_x, by_y, by_xx, by_yx, by_yy])


def _crop(frame: Plane, place: Floats, grid: Floats) -> tuple[tuple[int, int], Plane] | None:
    """Return the part of a frame about a place that a patch may cover, and the first pixel (x, y) of this part."""
    reach = math.ceil(1.5 * float(np.abs(grid).max())) + 3
    x, y = round(float(place[0])), round(float(place[1]))
    left, top = max(x - reach, 0), max(y - reach, 0)
    part = frame[top : max(y + reach + 1, 0), left : max(x + reach + 1, 0)]
    return ((left, top), part) if min(part.shape) > 4 else None


@dataclass(frozen=True)
class _Learnt:
    """The average picture of a patch, and its positions (n, 2) and rotations (n,) in the frames.

    The rotations are None if the patch does not rotate.
    """

    layers: _Layers
    place: Floats
    turn: Floats | None
    residual: float  # mean variance of the pixels [grey levels squared]


def _learnt(
    film: FrameSource,
    frame: Integers,
    place: Floats,
    turn: Floats | None,
    turn_sigma: float,
    background: Picture,
    noise: float,
    radius: float,
) -> _Learnt:
    """Average the picture of the patch over some frames with given rotations, and refine the positions in them."""
    use = np.unique(np.linspace(0, len(frame) - 1, _LEARNT).astype(int))
    pictures = film.some(frame[use])
    half = math.ceil(1.35 * radius) + 4
    v, u = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float64)
    empty = np.zeros(u.shape, dtype=np.float32)
    layers = _Layers(np.stack([u, v]), empty, empty, empty, background, turn_sigma)
    angles = np.zeros(len(use)) if turn is None else turn[use].copy()
    there = place[use].copy()
    kept = np.ones(len(use), dtype=np.bool_)
    for again in range(_ROUNDS):
        layers = _regressed(layers, pictures, there, angles, kept, noise)
        poses = [layers.register(p, x, a) for p, x, a in zip(pictures, there, angles, strict=True)]
        misfit = np.array([p[2] for p in poses])
        kept = misfit < HIDDEN * np.median(misfit)
        there[kept] = np.array([p[0] for p in poses])[kept]
        angles[kept] = np.array([p[3] for p in poses])[kept]
        if again == 0:
            layers = replace(layers, background=_uncovered(layers, pictures, there, kept))
    # the centre of the average picture may differ from the centre of the template
    moved = place + np.median(there - place[use], axis=0)
    moved[use] = there
    residual = float(np.mean(layers.variance[layers.variance < _UNSEEN]))
    return _Learnt(layers, moved, turn, residual)


def _regressed(
    layers: _Layers, pictures: Sequence[Plane], place: Floats, turn: Floats, kept: Bools, noise: float
) -> _Layers:
    """Return the layers by a regression of the pictures at given places on the background at these places."""
    chosen = np.flatnonzero(kept).tolist()
    shown = np.stack([layers.sampled(pictures[i], place[i], turn[i]) for i in chosen])
    behind = np.stack(
        [layers.sampled(layers.background, place[i], turn[i], cv2.INTER_LINEAR) for i in chosen]
    )
    known = np.isfinite(shown)
    count = np.maximum(known.sum(axis=0), 1)
    shown, behind = np.where(known, shown, 0.0), np.where(known, behind, 0.0)
    mean, mean_behind = shown.sum(axis=0) / count, behind.sum(axis=0) / count
    off, off_behind = (shown - mean) * known, (behind - mean_behind) * known
    # prior of the transparency with a standard deviation of 1, needed for a background that hardly varies
    slope = (off * off_behind).sum(axis=0) / ((off_behind**2).sum(axis=0) + noise**2)
    slope = np.clip(slope, 0.0, 1.0)
    brightness = mean - slope * mean_behind
    rest = (shown - slope * behind - brightness) * known
    variance = cv2.blur(((rest**2).sum(axis=0) / count).astype(np.float32), (3, 3))
    seen = known.sum(axis=0) > 0.2 * len(chosen)
    # interpolation averages the noise of neighbours, but not the effect of the smooth displacements
    variance = np.where(seen, np.maximum(variance, noise**2), np.float32(_UNSEEN))
    return replace(
        layers,
        transparency=slope.astype(np.float32),
        brightness=brightness.astype(np.float32),
        variance=variance.astype(np.float32),
    )


def _uncovered(layers: _Layers, pictures: Sequence[Plane], place: Floats, kept: Bools) -> Picture:
    """Return the background of each pixel: the mean of the frames in which the patch does not cover the pixel.

    Without such a frame, the pixel keeps the previous value.
    """
    reach = float(np.abs(layers.grid).max())
    total = np.zeros(layers.background.shape, dtype=np.float64)
    count = np.zeros(layers.background.shape, dtype=np.int32)
    height, width = layers.background.shape
    y, x = np.ogrid[0:height, 0:width]
    for i in np.flatnonzero(kept).tolist():
        clear = (x - place[i, 0]) ** 2 + (y - place[i, 1]) ** 2 > reach**2
        total += np.where(clear, pictures[i], 0.0)
        count += clear
    seen = count > max(0.1 * kept.sum(), 3)
    return np.where(seen, total / np.maximum(count, 1), layers.background).astype(np.float32)


def _measured(
    film: FrameSource, frame: Integers, learnt: _Learnt, searched: int, progress: Progress | None
) -> PointPath:
    """Register every frame with the average picture."""
    layers, place, turn = learnt.layers, learnt.place, learnt.turn
    found = place.copy()
    covariance = np.full((len(frame), 2, 2), np.nan)
    misfit = np.full(len(frame), np.inf)
    for k, picture in enumerate(frames_of(film, frame)):
        angle = 0.0 if turn is None else float(turn[k])
        found[k], covariance[k], misfit[k], _ = layers.register(picture, place[k], angle)
        if progress is not None:
            progress(k + 1, len(frame))
    usual = float(np.median(misfit))
    kept = (misfit < HIDDEN * usual) & np.isfinite(covariance).all(axis=(1, 2))
    if kept.sum() < FEWEST_FRAMES:
        raise TrackingError(
            f"The point in {film.path.name} matches its average picture in only {int(kept.sum())} frames.",
            "Give a more distinct point with --point X,Y.",
        )
    enlarged = covariance * np.maximum(misfit / usual, 1.0)[:, None, None]
    return PointPath(
        frame[kept],
        found[kept],
        enlarged[kept],
        float(np.abs(layers.grid).max()),
        searched,
        turn is not None,
        (layers.brightness + layers.transparency * float(np.median(layers.background))).astype(np.float32),
    )
