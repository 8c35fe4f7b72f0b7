"""Silhouettes of bodies that move in front of a background at rest, in a few frames: compact bodies and long bodies.

The silhouettes identify a film of a ball on a string, whose pivot is outside the picture, or of a rod about a tilted
axis. Neither body is a texture that turns about a hub in the picture. Places are (x, y) [px].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from gyrotrack._arrays import Floats, Integers, Picture, Plane
from gyrotrack.tracking._film import Film
from gyrotrack.tracking._hub_search import Motion, spatial_noise
from gyrotrack.tracking._orbit import covered_angle
from gyrotrack.tracking._pivot import angles_about, fit_arc, fit_orbit
from gyrotrack.tracking._registration import TURN

_BACKGROUND = 60
"""Number of frames for the background, which is their median [frames]. Chosen: a larger number costs memory and time, a
smaller one keeps a slow body in the background."""
_COMPARED = 30
"""Number of frames that are compared with the background [frames]. Chosen: half of `_BACKGROUND`, to save time; a
smaller number gives uncertain shares."""
_BAND = 32
"""Number of rows of the picture for which the median is computed at a time [rows]. Chosen: to limit memory; a larger
number needs more."""
_CONTRAST = 6.0
"""Smallest difference of a body from the background in standard deviations of the noise [1]. Chosen: a smaller value
finds noise, a larger one loses faint bodies."""
_FAINTEST = 0.15
"""Smallest difference of a body from the background, relative to the strongest contrast of the frame [1]. Chosen: a
smaller value includes shadows, a larger one loses dark parts of the body."""
_SMALLEST = 1.5
"""Smallest radius of a spot [px]. Chosen: a smaller value finds noise, a larger one loses small bobs."""
_OPENED = 0.6
"""Radius of the opening that removes a string from a bob, divided by the radius of the bob [1]. Chosen: a smaller value
keeps a thick rod, a larger one removes bobs that are not round."""
AS_LARGE = 0.7
"""The choice between two spots is ambiguous if the radius of the inscribed circle of the second spot, divided by the
radius of the first, is at least this value [1]. Chosen: a smaller value refuses films with other objects, a larger one
may choose the wrong body."""
_PARTS = 50
"""Largest number of separate parts of a frame that are compared [1]. Chosen: a larger number costs time, a smaller one
loses bodies in noisy films."""
ALIKE = 1.4
"""Largest ratio of the radii of one body in two frames [1]. Chosen: a smaller value loses blurred bodies, a larger one
confuses bodies."""
_SEEN = 0.8
"""Smallest share of the frames in which a body is seen [1]. Chosen: a smaller value accepts other objects, a larger one
refuses films with a hand."""
_ALONE = 0.5
"""Smallest share of the body in the area that differs from the background [1]. Chosen: a smaller value accepts a
part of a larger body, a larger one refuses bobs with shadows."""
_LEAVES = 2.0
"""Smallest extent of the path of a moving body [radii]. Chosen: a smaller value accepts a wobble, a
larger one refuses small oscillations."""
_ROUND = 0.06
"""Largest scatter about the arc, divided by the extent of the path [1]. Chosen: a smaller value refuses blurred bobs, a
larger one accepts other paths."""
_OPEN = 0.5 * TURN
"""Largest range of the direction from the pivot on an open arc [rad]. Chosen: half a turn; a smaller value refuses wide
oscillations, a larger one accepts orbits, whose pivot is in the picture."""


@dataclass(frozen=True)
class Spot:
    """A patch of a frame: its centre (x, y), the radius, and the pixels of the body in a square about the centre."""

    place: tuple[float, float]
    radius: float  # [px]
    mask: Plane


def median_picture(sample: Sequence[Plane]) -> Picture:
    """Return the median of some frames."""
    last = len(sample) - 1
    return quantile_picture(sample, (last // 2, (last + 1) // 2))


def quantile_picture(sample: Sequence[Plane], ranks: Sequence[int]) -> Picture:
    """Return the mean of some order statistics (from 0) of each pixel in some frames."""
    bands = (np.stack([f[y : y + _BAND] for f in sample]) for y in range(0, len(sample[0]), _BAND))
    return np.concatenate([np.mean([_ranked(b, k) for k in ranks], axis=0, dtype=np.float32) for b in bands])


def _ranked(values: Plane, rank: int) -> Plane:
    """Return the value of a rank along the first axis; it is determined bit by bit, which is faster than sorting."""
    found = np.zeros(values.shape[1:], dtype=np.uint8)
    for bit in (128, 64, 32, 16, 8, 4, 2, 1):
        larger = found + np.uint8(bit)
        found = np.where((values < larger).sum(axis=0, dtype=np.uint16) <= rank, larger, found)
    return found


def differs(frame: Plane, background: Picture, noise: float) -> Plane:
    """Return 1 where a frame differs significantly from the background, else 0."""
    away = cv2.blur(np.abs(frame - background), (3, 3))
    limit = max(_CONTRAST * noise / 3.0, _FAINTEST * float(np.quantile(away, 0.999)))
    return np.asarray(away > limit, dtype=np.uint8)


Parts = tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]
"""The number of the connected part of each pixel, and the statistics of the parts."""


def parts_of(region: Plane) -> Parts:
    """Return the connected parts of a region."""
    _, label, stats, _ = cv2.connectedComponentsWithStats(region)
    return np.asarray(label, dtype=np.int32), np.asarray(stats, dtype=np.int32)


def spot_of(parts: Parts, top: tuple[int, int]) -> Spot | None:
    """Return the compact part about `top` (x, y), the pixel farthest from the edge; None if the part is small."""
    label, stats = parts
    number = label[top[1], top[0]]
    if number == 0:
        return None
    # a disc is within one component: only the box of this component is opened, with the pixels around the box
    left, above, width, height, _ = (int(v) for v in stats[number])
    left, above, right, below = max(left - 1, 0), max(above - 1, 0), left + width + 1, above + height + 1
    part = np.asarray(label[above:below, left:right] == number, dtype=np.uint8)
    at = top[1] - above, top[0] - left
    inner = float(depth_of(part)[at])
    if inner < _SMALLEST:
        return None
    opened = cv2.morphologyEx(part, cv2.MORPH_OPEN, _disc(max(int(_OPENED * inner), 1)))
    _, around = cv2.connectedComponents(opened)
    if around[at] == 0:
        return None
    y, x = np.nonzero(around == around[at])
    y, x = y + above, x + left
    centre = (float(x.mean()), float(y.mean()))
    radius = math.sqrt(len(x) / math.pi)
    half = math.ceil(float(np.hypot(x - centre[0], y - centre[1]).max())) + 1
    mask = np.zeros((2 * half + 1, 2 * half + 1), dtype=np.uint8)
    mask[y - round(centre[1]) + half, x - round(centre[0]) + half] = 1
    return Spot(centre, radius, mask)


def depth_of(region: Plane) -> Picture:
    """Return the distance of each pixel of a region from its edge [px]."""
    return np.asarray(cv2.distanceTransform(np.pad(region, 1), cv2.DIST_L2, 5)[1:-1, 1:-1])


def _disc(size: int) -> Plane:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * size + 1, 2 * size + 1)))


def spots_in(region: Plane, least: float, most: int) -> list[Spot]:
    """Return the compact parts of a region, the largest first, down to `least` times the largest inscribed radius.

    Two parts are merged if the centre of one is inside the other, as at the edge of a picture that moves as a whole.
    """
    depth = depth_of(region)
    # opening with a slightly smaller disc separates bodies that are joined by rods or strings
    opened = cv2.morphologyEx(region, cv2.MORPH_OPEN, _disc(max(int(least * float(depth.max())), 1)))
    count, label, stats, _ = cv2.connectedComponentsWithStats(opened)
    tops = []
    for number in range(1, min(count, _PARTS + 1)):
        left, top, width, height, _ = (int(v) for v in stats[number])
        part = slice(top, top + height), slice(left, left + width)
        inside = np.where(label[part] == number, depth[part], 0.0)
        row, column = np.unravel_index(int(np.argmax(inside)), inside.shape)
        tops.append((float(inside[row, column]), (left + int(column), top + int(row))))
    tops.sort(reverse=True)
    chosen = [top for inner, top in tops[:most] if inner > least * tops[0][0]]
    parts = parts_of(region)
    found: list[Spot] = []
    for spot in (spot_of(parts, top) for top in chosen):
        if spot is not None and all(
            math.dist(spot.place, s.place) > max(spot.radius, s.radius) for s in found
        ):
            found.append(spot)
    return found


@dataclass(frozen=True)
class CompactBody:
    """The compact body that is seen in most of the compared frames."""

    radius: float  # median radius of the body [px]
    place: Floats  # shape (n, 2); centroids in the frames that show the body [px]
    alone: float  # median share of the body in the pixels that differ from the background

    @property
    def pivot(self) -> Floats | None:
        """The centre (x, y) of the open arc on which the body moves [px]; None for any other path.

        For a straight path the centre is at infinity.
        """
        place = self.place
        extent = float(np.hypot(*np.ptp(place, axis=0)))
        if self.alone < _ALONE or extent < _LEAVES * self.radius:
            return None
        arc = fit_arc(place, np.full(len(place), 0.5))
        if math.hypot(arc.noise, arc.by_place) > max(_ROUND * extent, 1.0):
            return None
        if not arc.determined:
            return np.full(2, np.inf)
        away = place - arc.hub
        return arc.hub if covered_angle(np.arctan2(away[:, 1], away[:, 0])) < _OPEN else None


def compact_body(sample: Sequence[Plane], background: Picture, noise: float) -> CompactBody | None:
    """Return the compact body that is visible in most frames of a sample; None without such a body."""
    every = []
    for frame in sample:
        region = differs(frame, background, noise)
        every.append((spots_in(region, 0.5 * AS_LARGE, 3), int(region.sum())))
    largest = [spots[0].radius for spots, _ in every if spots]
    if len(largest) < _SEEN * len(sample):
        return None
    radius = float(np.median(largest))
    chosen = [(min(spots, key=lambda s: _unlike(s, radius)), total) for spots, total in every if spots]
    chosen = [(s, total) for s, total in chosen if _unlike(s, radius) < math.log(ALIKE)]
    if len(chosen) < _SEEN * len(sample):
        return None
    place = np.array([s.place for s, _ in chosen])
    return CompactBody(radius, place, float(np.median([s.mask.sum() / total for s, total in chosen])))


@dataclass(frozen=True)
class Foreground:
    """Equally spaced frames of a film, their median (the background), and the differences from this background."""

    sample: Sequence[Plane]
    background: Picture
    noise: float  # standard deviation of single frames [grey levels]

    @classmethod
    def of(cls, film: Film, usable: Integers) -> Foreground:
        """Compare some of the usable frames with their median."""
        sample = film.some(usable[np.unique(np.linspace(0, len(usable) - 1, _BACKGROUND).astype(int))])
        noise = max(spatial_noise(sample[:: max(1, len(sample) // 8)]), 0.5)
        return cls(sample, median_picture(sample), noise)

    @property
    def few(self) -> Sequence[Plane]:
        """Every second frame of a full sample, all frames of a shorter sample."""
        return self.sample[:: max(1, len(self.sample) // _COMPARED)]

    @cached_property
    def body(self) -> CompactBody | None:
        """The compact body that is visible in most of the frames."""
        return compact_body(self.few, self.background, self.noise)


def _unlike(spot: Spot, radius: float) -> float:
    return abs(math.log(max(spot.radius, 1e-9) / radius))


_LONG = 2.0
"""Smallest ratio of the moments of the axes of a long body [1]. Chosen: a smaller value accepts discs under an oblique
view, a larger one loses short rods."""
_FILLED = 1.4
"""Largest area of the ellipse of the same moments, divided by the area of a long body [1]. Chosen: a straight bar has
pi / 3 = 1.05; a larger value accepts bent bodies, a smaller one refuses interrupted bars."""
_PIECE = 0.2
"""Smallest part of a silhouette that is used, relative to the largest part [1]. Chosen: a bar over the middle divides
the silhouette; a smaller value includes noise, a larger one loses an end."""
_TILTED = 0.4
"""Smallest tilt of the axis of a long body [rad]. Chosen: a smaller value takes a disturbed circle for a tilt, a larger
one leaves a biased angle."""
_ELLIPSE = 0.06
"""Largest scatter about the ellipse, divided by the radius [1]. Chosen: a smaller value refuses blurred ends, a larger
one accepts other motions."""
_GAP = 0.25 * TURN
"""Largest gap of the orbit [rad]. Chosen: a quarter of a turn; a larger gap leaves the ellipse undetermined, a smaller
one refuses orbits of few positions."""
_SIDES = ("light", "dark")


@dataclass(frozen=True)
class LongBody:
    """A long body about a tilted axis: brighter or darker than the background, and the noise level."""

    side: str
    background: Picture
    limit: float  # grey levels

    def axis(self, frame: Plane) -> tuple[Floats, Floats, float] | None:
        """Return the centroid of the silhouette, half its axis as a vector (x, y), and its width [px]; or None."""
        away = cv2.blur(frame - self.background, (3, 3)) * (1.0 if self.side == "light" else -1.0)
        shown = np.clip(away, 0.0, 255.0).astype(np.uint8)
        strong = shown[shown > self.limit]
        if len(strong) < 20:
            return None
        level, _ = cv2.threshold(strong[:, None], 0, 255, cv2.THRESH_OTSU)
        # half the level of the body, because the edge of the silhouette is blurred
        level = max(0.5 * float(np.median(strong[strong >= level])), self.limit)
        _, label, stats, _ = cv2.connectedComponentsWithStats((shown > level).astype(np.uint8))
        area = stats[1:, cv2.CC_STAT_AREA]
        if not len(area):
            return None
        pieces = 1 + np.flatnonzero(area >= _PIECE * area.max())
        y, x = np.nonzero(np.isin(label, pieces))
        if len(x) < 20:
            return None
        values, axes = np.linalg.eigh(np.cov(x, y))
        long, short = math.sqrt(max(float(values[1]), 0.0)), math.sqrt(max(float(values[0]), 1e-9))
        if long < _LONG * short or 4.0 * math.pi * long * short > _FILLED * len(x):
            return None
        half = math.sqrt(3.0) * long * axes[:, 1]
        return np.array([x.mean(), y.mean()]), half, math.sqrt(12.0) * short


def long_tilted_body(sample: Sequence[Plane], background: Picture, noise: float) -> LongBody | None:
    """Return the long body in some frames if the ends of its axis are on an ellipse; None for any other film."""
    for side in _SIDES:
        body = LongBody(side, background, _CONTRAST * noise / 3.0)
        found = [f for frame in sample if (f := body.axis(frame)) is not None]
        if len(found) < _SEEN * len(sample):
            continue
        half = np.array([h for _, h, _ in found])
        ends = np.concatenate([half, -half])
        if TURN - covered_angle(angles_about(np.zeros(2), ends)) > _GAP:
            continue
        try:
            orbit = fit_orbit(ends, np.full(len(ends), 0.5))
        except ValueError:
            continue
        if not math.hypot(*orbit.value[3:]) < 1.0:
            continue
        off = float(np.std(np.hypot(*orbit.plane(ends).T))) / orbit.value[2]
        if orbit.tilt[0] > _TILTED and off < _ELLIPSE:
            return body
    return None


_AXES = 60
"""Number of frames in which the axes of a long body are compared [frames]. Chosen: a larger number costs time, a
smaller one gives an uncertain point."""
_FEWEST_AXES = 8
"""Smallest number of frames with an axis [frames]. Chosen: with fewer, axes meet by chance; with more, a rod that is at
rest for most of a film is refused."""
_MEET = 0.03
"""Largest distance of the axes from their common point, divided by their median length [1]. Chosen: a smaller value
refuses bent rods, a larger one accepts rods without a hub on their axis."""
_SPREAD = 0.01
"""Smallest spread of the directions of the axes: the mean squared sine of the angle from the main direction [1].
Chosen: an rms rotation of 0.1 rad; a smaller value accepts nearly parallel axes, a larger one refuses small
oscillations."""


def axes_meet(frames: Sequence[Plane], motion: Motion) -> tuple[float, float] | None:
    """Return the common point (x, y) [px] of the axes of a long body, which is the hub of a thin rod; or None.

    The rod may be visible in a few frames only: a rod that is at rest for most of a film is part of the mean picture.
    """
    few = frames[:: max(1, len(frames) // _AXES)]
    for side in _SIDES[::-1]:
        body = LongBody(side, motion.mean, _CONTRAST * motion.noise / 3.0)
        found = [f for frame in few if (f := body.axis(frame)) is not None]
        if len(found) < _FEWEST_AXES:
            continue
        centre, half = np.array([c for c, *_ in found]), np.array([h for _, h, _ in found])
        length = 2.0 * float(np.median(np.hypot(*half.T)))
        along = half / np.hypot(*half.T)[:, None]
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
        offset = np.sum(normal * centre, axis=1)
        weight, hub = np.ones(len(found)), np.zeros(2)
        for _ in range(10):
            left = (normal * weight[:, None]).T @ normal / weight.sum()
            if np.linalg.eigvalsh(left)[0] < _SPREAD:
                break
            hub = np.linalg.solve(left, (normal * (weight * offset)[:, None]).sum(axis=0) / weight.sum())
            off = np.abs(normal @ hub - offset)
            weight = 1.0 / (1.0 + (off / (_MEET * length)) ** 2) ** 2
        else:
            if np.median(off) < _MEET * length:
                return float(hub[0]), float(hub[1])
    return None
