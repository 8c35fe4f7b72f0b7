"""Candidates for the hub of a rotating body, from the film alone.

Three independent methods suit different kinds of bodies. A body that turns many times is blurred into circles, and the
gradients of its mean picture converge at the hub. The features of a textured body move from frame to frame by a
similarity transformation, whose fixed point is the hub. A compact spot moves on a circle about the hub. Registration
selects one of the candidates.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares

from gyrotrack._arrays import Bools, Complexes, Floats, Integers, Picture, Plane
from gyrotrack.tracking._registration import TURN, Ring

_PAIRS = 40
"""Number of pairs of frames for each lag [1]. Chosen: a smaller number gives an uncertain hub, a larger one costs
time."""
_LAGS = (1, 4, 16)
"""Distances of the frames of a pair [frames]. Chosen: for fast and slow bodies; over longer distances features are
lost, shorter distances show no rotation."""
_FIRST = 5
"""Every pair at a multiple of this number is examined first, to decide whether the other pairs are needed [pairs].
Chosen: with a larger value, few pairs decide; a smaller one costs time."""
_NO_COMMON_HUB = 0.8
"""Pairs of frames have no common hub if the median residual of the displacements about one hub, divided by the median
displacement, exceeds this value [1]. Measured: 0.07 to 0.5 for bodies whose features determine the hub; 1 without any
rotation."""
_FEWEST_PAIRS = 4
"""Smallest number of pairs with a rotation that determine a hub [pairs]. Chosen: with fewer, pairs agree by chance;
with more, some hubs are not found."""
_FEATURES = 400
"""Largest number of features of a frame [features]. Chosen: a larger number costs time, a smaller one leaves few
features on the body."""
_STRAY = 8.0
"""Largest residual of a feature that is used for the similarity [px]. Chosen: a smaller value discards features of a
soft body, a larger one keeps features of the background."""
_NEAR = 640.0
"""Ratio of the width of the picture to the largest residual of an inlier [1]. Chosen: 2 px in 1280 px; a larger value
rejects blurred features, a smaller one joins two motions."""
_FEWEST = 12
"""Smallest number of features that determine a similarity [features]. Chosen: with fewer, features agree by chance;
with more, small bodies are omitted."""
_UNIFORM = 1.5
"""Largest variation of a bar at the side of a picture [grey levels]. Chosen: a smaller value keeps bars with coding
noise, a larger one cuts off a blank wall."""
FARTHEST = 6.0
"""Largest distance of the hub [picture sizes]. Chosen: the curvature is not measurable beyond it; a larger value
accepts translation, a smaller one refuses long pendulums."""


@dataclass(frozen=True)
class Motion:
    """The moving part of a film."""

    # shape (height, width); mean brightness and its standard deviation in time, in grey levels
    mean: Picture
    deviation: Picture
    noise: float  # standard deviation where nothing moves
    moving: Bools  # shape (height, width); where the brightness changes by more than noise
    # the part (left, top, right, bottom) of the frame that contains the picture, without uniform bars at the sides
    area: tuple[int, int, int, int]

    @classmethod
    def of(cls, frames: Sequence[Plane], margin: int = 0) -> Motion:
        """Compare frames from the whole film; `margin` px are excluded at every edge."""
        # sums of integers are exact and take little memory
        total = np.zeros(frames[0].shape, np.uint32)
        square = np.zeros(frames[0].shape, np.uint32)
        for frame in frames:
            total += frame
            square += np.square(frame, dtype=np.uint16)
        mean = np.divide(total, len(frames), dtype=np.float32)
        deviation = np.empty_like(mean)
        for row, (one, two) in enumerate(zip(total, square, strict=True)):
            deviation[row] = np.sqrt(len(frames) * two.astype(np.float64) - one.astype(np.float64) ** 2)
        deviation /= len(frames)
        noise = max(min(float(np.quantile(deviation, 0.3)), spatial_noise(frames)), 0.5)
        smooth = cv2.blur(deviation, (3, 3))
        moving = cv2.morphologyEx(
            (smooth > 4.0 * noise).astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8)
        ).astype(bool)
        left, right = _without_bars(mean, deviation)
        top, bottom = _without_bars(mean.T, deviation.T)
        left, top, right, bottom = left + margin, top + margin, right - margin, bottom - margin
        inside = np.zeros_like(moving)
        inside[top:bottom, left:right] = True
        return cls(mean, deviation, noise, moving & inside, (left, top, right, bottom))


def _without_bars(mean: Picture, deviation: Picture) -> tuple[int, int]:
    """Return the first column, and the last column plus one, of a picture without constant uniform bars."""
    uniform = (mean.std(axis=0) < _UNIFORM) & (deviation.mean(axis=0) < _UNIFORM)
    ends = []
    for flat, level in ((uniform, mean.mean(axis=0)), (uniform[::-1], mean.mean(axis=0)[::-1])):
        bar = flat & (np.abs(level - level[0]) < _UNIFORM)
        ends.append(int(np.argmin(bar)) if not bar.all() else 0)
    return ends[0], len(uniform) - ends[1]


def spatial_noise(frames: Sequence[Plane]) -> float:
    """Return the noise of single frames from the difference of two Laplacians (Immerkaer 1996)."""
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
    found = [
        cv2.norm(cv2.filter2D(f, cv2.CV_32F, kernel), cv2.NORM_L1) / f.size
        for f in frames[:: max(1, len(frames) // 8)]
    ]
    return math.sqrt(math.pi / 2) / 6 * float(np.median(found))


@dataclass(frozen=True)
class Proposal:
    """A hub (x, y) [px] and the method by which it was found."""

    hub: tuple[float, float]
    way: str
    stretch: tuple[float, float] = (0.0, 0.0)  # of the circles due to a tilted axis (see `Ring`)


def ring_for(
    hub: tuple[float, float], motion: Motion, finest: float, stretch: tuple[float, float] = (0.0, 0.0)
) -> Ring | None:
    """Return the ring of the moving part of the picture about a hub; an arc if the hub is outside the picture."""
    height, width = motion.mean.shape
    distance = distance_from(hub, motion.moving.shape, stretch)
    bins = distance.astype(np.int32)
    count = np.bincount(bins.ravel())
    share = np.bincount(bins[motion.moving], minlength=len(count)) / np.maximum(count, 1)
    share = np.convolve(share, np.ones(3) / 3, mode="same")
    enough = count >= 20
    if not enough.any():
        return None
    level = 0.2 * float(np.quantile(share[enough], 0.9))
    good = np.flatnonzero(enough & (share > max(level, 0.01)))
    if len(good) < 4:
        return None
    outer = float(good[-1]) + 2.0
    inside = 0 <= hub[0] < width and 0 <= hub[1] < height
    if inside:
        inner = max(3.0, 0.06 * outer, float(good[0]) - 2.0)
        return Ring.about(hub, inner, outer, finest=finest, stretch=stretch) if outer > inner + 5 else None
    inner = max(float(good[0]) - 2.0, float(distance.min()))
    towards = math.atan2(height / 2 - hub[1], width / 2 - hub[0])
    y, x = np.nonzero(motion.moving & (distance > inner) & (distance < outer))
    angle = (np.arctan2(y - hub[1], x - hub[0]) - towards + np.pi) % TURN - np.pi
    low, high = float(np.quantile(angle, 0.002)), float(np.quantile(angle, 0.998))
    margin = 0.6 * (high - low)
    span = min(high - low + 2 * margin, TURN)
    return Ring.about(hub, inner, outer, finest=finest, start=towards + low - margin, span=span)


def distance_from(
    place: tuple[float, float], shape: tuple[int, ...], stretch: tuple[float, float] = (0.0, 0.0)
) -> Picture:
    """Return, for every pixel of a picture, the radius [px] of the circle about a place (x, y) through this pixel.

    With a `stretch` (see `Ring`) the circles are seen as ellipses.
    """
    y, x = np.ogrid[0 : shape[0], 0 : shape[1]]
    right, down = (x - place[0]).astype(np.float32), (y - place[1]).astype(np.float32)
    p, q = stretch
    if p == q == 0.0:
        return np.hypot(right, down)
    size = np.float32(1.0 - p * p - q * q)
    return np.asarray(
        np.hypot((1.0 - p) * right - q * down, (1.0 + p) * down - q * right) / size, dtype=np.float32
    )


_ROUND = 0.95
"""Smallest ratio of the axes of a moving area that is taken for a circle [1]. Chosen: a smaller value leaves tilts
uncorrected, a larger one tries tilts for circles."""
_FLATTEST = 0.25
"""Smallest ratio of the axes for which a tilt is tried [1]. Derived: the cosine of a tilt of 75.5 degrees."""


def tilted_outline(motion: Motion, hub: tuple[float, float] | None = None) -> Proposal | None:
    """Return hub and stretch of the largest moving part of the picture, from the ellipse with its second moments.

    A body that turns at least half a turn about a tilted axis sweeps an ellipse. The result is None for a circle or a
    flat area. A given `hub` replaces the centroid.
    """
    closed = cv2.morphologyEx(motion.moving.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    _, label, stats, middle = cv2.connectedComponentsWithStats(closed)
    if len(stats) < 2:
        return None
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    y, x = np.nonzero(label == largest)
    if len(x) < 50:
        return None
    values, axes = np.linalg.eigh(np.cov(x, y))
    ratio = math.sqrt(max(float(values[0]), 0.0) / max(float(values[1]), 1e-9))
    if not _FLATTEST < ratio < _ROUND:
        return None
    size, twice = (1.0 - ratio) / (1.0 + ratio), 2.0 * math.atan2(axes[1, 1], axes[0, 1])
    place = hub or (float(middle[largest][0]), float(middle[largest][1]))
    way = "outline of the moving area" if hub is None else "given"
    return Proposal(place, way, (size * math.cos(twice), size * math.sin(twice)))


def propose_hubs(frames: Sequence[Plane], motion: Motion) -> list[Proposal]:
    """Return candidates for the hub, at least 0.4 % of the picture apart, from consecutive frames."""
    height, width = motion.mean.shape
    found: list[Proposal] = []
    near_hub, far_hub = similarity_hubs(frames, motion)
    for way, place in (
        ("features", near_hub),
        ("features of a distant body", far_hub),
        ("edges", edge_hub(motion)),
        ("orbit", orbit_hub(frames, motion)),
        ("middle of the moving area", _middle(motion)),
    ):
        if place is None or not np.all(np.isfinite(place)):
            continue
        if np.hypot(place[0] - width / 2, place[1] - height / 2) > FARTHEST * max(width, height):
            continue
        near = 0.004 * max(width, height)
        if all(np.hypot(place[0] - p.hub[0], place[1] - p.hub[1]) > near for p in found):
            found.append(Proposal(place, way))
    return found


def edge_hub(motion: Motion) -> tuple[float, float] | None:
    """Return the point of convergence of the gradients of the mean picture in the moving area."""
    grad_x = cv2.Sobel(motion.mean, cv2.CV_32F, 1, 0, scale=1 / 8)
    grad_y = cv2.Sobel(motion.mean, cv2.CV_32F, 0, 1, scale=1 / 8)
    size = np.hypot(grad_x, grad_y)
    near = cv2.dilate(motion.moving.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    y, x = np.nonzero(near & (size > 0.5))
    if len(x) < 50:
        return None
    normal = np.stack([-grad_y[y, x], grad_x[y, x]], axis=1) / size[y, x][:, None]
    offset = normal[:, 0] * x + normal[:, 1] * y
    base = np.minimum(size[y, x], 20.0)
    scale = 0.25 * float(max(motion.mean.shape))
    hub: Any = np.array([np.median(x), np.median(y)], dtype=np.float64)
    for _ in range(40):
        miss = normal @ hub - offset
        weight = base / (1.0 + (miss / scale) ** 2) ** 2
        left = (normal * weight[:, None]).T @ normal
        hub = np.linalg.solve(left + 1e-9 * np.eye(2), (normal * weight[:, None]).T @ offset)
        scale = max(0.8 * scale, 1.5)
    return float(hub[0]), float(hub[1])


def orbit_hub(frames: Sequence[Plane], motion: Motion) -> tuple[float, float] | None:
    """Return the centre of the circular path of the largest spot that differs from the mean picture, or None."""
    x, y = [], []
    limit = max(6.0 * motion.noise, 0.35 * float(np.quantile(motion.deviation, 0.999)))
    for frame in frames[:: max(1, len(frames) // 200)]:
        away = cv2.absdiff(frame.astype(np.float32), motion.mean)
        count, _, stats, middle = cv2.connectedComponentsWithStats((away > 1.5 * limit).astype(np.uint8))
        if count < 2:
            continue
        best = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
        if stats[best, cv2.CC_STAT_AREA] >= 6:
            x.append(middle[best][0])
            y.append(middle[best][1])
    return fit_circle(np.array(x), np.array(y))


def fit_circle(x: Floats, y: Floats) -> tuple[float, float] | None:
    """Return the centre of the circle through points, robust against outliers; None without enough inliers."""
    from skimage.measure import CircleModel, ransac

    if len(x) < 8 or np.hypot(np.ptp(x), np.ptp(y)) < 4:
        return None
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "No inliers found", UserWarning)
        found, inside = ransac(np.column_stack([x, y]), CircleModel, 3, 1.5, max_trials=200, rng=0)
    if found is None or inside.sum() < max(8, 0.4 * len(x)):
        return None
    return float(found.center[0]), float(found.center[1])


def similarity_hubs(
    frames: Sequence[Plane], motion: Motion
) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
    """Return two estimates of the hub (x, y) [px], the fixed point of similarities between frames a few steps apart.

    A similarity z -> a z + b of moving features about the hub h has b = (1 - a) h. The first estimate is a
    least-squares fit to b, for a body that surrounds its hub. The second estimate is for a small body far from the hub,
    for example the ball of a pendulum. The displacement d = (1 - a)(h - c) of its centroid c is precise, but its
    rotation is not precise, and errors of the rotation bias the hub towards the body. Therefore h is fitted to a = 1 -
    d / (h - c).
    """
    mask = cv2.dilate(motion.moving.astype(np.uint8), np.ones((9, 9), np.uint8)).astype(np.uint8)
    if mask.sum() < 50:
        return None, None
    pairs = [
        (lag, int(i))
        for lag in _LAGS
        if lag < len(frames)
        for i in np.unique(np.linspace(0, len(frames) - 1 - lag, _PAIRS).astype(int))
    ]
    few = pairs[::_FIRST]
    found = {(lag, i): similarity(frames[i], frames[i + lag], mask) for lag, i in few}
    rough = _CommonHub.of(found.values())
    if rough is None or rough.unexplained < _NO_COMMON_HUB:
        for lag, i in pairs:
            if (lag, i) not in found:
                found[lag, i] = similarity(frames[i], frames[i + lag], mask)
        rough = _CommonHub.of([found[pair] for pair in pairs])
    if rough is None:
        return None, None
    return (rough.hub.real, rough.hub.imag), distant_hub(rough.hub, rough.left, rough.shift, rough.centroid)


@dataclass(frozen=True)
class _CommonHub:
    """The hub, x + i y [px], common to the similarities of all pairs of frames."""

    hub: complex
    # for each pair: 1 - a, displacement and centroid of the features [px]
    left: Complexes
    shift: Complexes
    centroid: Complexes
    unexplained: float  # median residual of the displacements divided by the median displacement

    @classmethod
    def of(cls, found: Iterable[tuple[complex, complex, complex] | None]) -> _CommonHub | None:
        """Fit the hub by robust least squares; None for fewer than `_FEWEST_PAIRS` pairs with a similarity."""
        known = [pair for pair in found if pair is not None]
        if len(known) < _FEWEST_PAIRS:
            return None
        turn, moved, centroid = (np.array(column, dtype=np.complex128) for column in zip(*known, strict=True))
        left = 1.0 - turn
        weight = (np.abs(left) > np.median(np.abs(left)) * 0.5).astype(np.float64)
        robust = weight
        for _ in range(21):
            power = max(float(np.sum(np.abs(left) ** 2 * robust)), 1e-12)
            hub = complex(np.sum(np.conj(left) * moved * robust) / power)
            miss = np.abs(moved - left * hub)
            scale = max(1.4826 * float(np.median(miss)), 1e-3)
            robust = weight / (1.0 + (miss / (2 * scale)) ** 2)
        shift = moved - left * centroid
        rest = float(np.median(np.abs(moved - left * hub)))
        return cls(hub, left, shift, centroid, rest / max(float(np.median(np.abs(shift))), 1e-12))


def distant_hub(
    start: complex,
    left: Complexes,
    shift: Complexes,
    centroid: Complexes,
) -> tuple[float, float] | None:
    """Fit the hub h to 1 - a = d / (h - c) for all pairs of frames; None for a body that surrounds its hub."""
    middle, spread = complex(np.median(centroid.real), np.median(centroid.imag)), float(np.abs(shift).max())
    if abs(start - middle) < spread:
        return None
    scale = max(1.4826 * float(np.median(np.abs(left - shift / (start - centroid)))), 1e-5)

    def residual(place: Floats) -> Floats:
        away = complex(*place) - centroid
        off = (left - shift / np.where(np.abs(away) < 1.0, 1.0, away)) / scale
        return np.concatenate([off.real, off.imag])

    fits = []
    for factor in (1.0, 2.0, 4.0):
        place = middle + factor * (start - middle)
        size = abs(place - middle)
        fits.append(least_squares(residual, [place.real, place.imag], loss="soft_l1", x_scale=size))
    best = min(fits, key=lambda fit: float(fit.cost))
    return float(best.x[0]), float(best.x[1])


def similarity(first: Plane, second: Plane, mask: Plane) -> tuple[complex, complex, complex] | None:
    """Return a, b of z -> a z + b, |a| = 1, from one frame to the other, and the centroid of the features; or None."""
    points = cv2.goodFeaturesToTrack(first, _FEATURES, 0.01, 5, mask=mask)
    if points is None or len(points) < 6:
        return None
    there, tracked = _there_and_back(first, second, points, levels=4, nearest=0.5)
    start, end = points[tracked, 0], there[tracked, 0]
    moves = np.hypot(*(end - start).T) > 0.3
    if moves.sum() < 6:
        return None
    found, inside = cv2.estimateAffinePartial2D(
        start[moves], end[moves], method=cv2.RANSAC, ransacReprojThreshold=1.0
    )
    if found is None or inside.sum() < max(6, 0.4 * moves.sum()):
        return None
    a = complex(found[0, 0], found[1, 0])
    if not 0.97 < abs(a) < 1.03 or abs(np.angle(a)) < 1e-3:
        return None
    a /= abs(a)
    use = inside[:, 0] == 1
    z0 = start[moves][use] @ np.array([1, 1j])
    z1 = end[moves][use] @ np.array([1, 1j])
    return a, complex(np.mean(z1) - a * np.mean(z0)), complex(np.mean(z0))


def _there_and_back(
    first: Plane, second: Plane, points: Any, *, levels: int, nearest: float
) -> tuple[Any, Bools]:
    """Track points to a second frame by optical flow.

    Return the points in the second frame, and a mask of the reliable points: tracked back to the first frame, they are
    within `nearest` px of their origin.
    """
    flow: Any = cv2.calcOpticalFlowPyrLK
    options: dict[str, Any] = {"winSize": (21, 21), "maxLevel": levels}
    there, status, _ = flow(first, second, points, None, **options)
    back, again, _ = flow(second, first, there, None, **options)
    known = (status[:, 0] == 1) & (again[:, 0] == 1)
    return there, known & (np.abs(points - back).max(axis=(1, 2)) < nearest)


def follow_features(
    frames: Iterable[Plane], motion: Motion, widest: float
) -> tuple[Complexes, Complexes, Integers] | None:
    """Track the features of a body by optical flow from frame to frame.

    Return None if there are too few inliers, or if the range of the angles exceeds `widest` [rad].

    Otherwise return a, b (n,) of z -> a z + b, |a| = 1, from the first frame to each frame. Also return, for each
    frame, the frame in which its features were selected. Features selected later inherit the error of the previous
    features.
    """
    smooth = cv2.blur(motion.deviation, (5, 5))
    strong = motion.moving & (smooth > float(np.median(smooth[motion.moving])))
    mask = cv2.dilate(strong.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(np.uint8)
    turn, moved, since = [], [], []
    chosen = 0
    before: Plane | None = None
    start: Any = None
    now: Any = None
    base_a, base_b = 1.0 + 0.0j, 0.0 + 0.0j
    angle = least = most = 0.0
    near = 1.5
    for frame in frames:
        if before is None:
            near = max(frame.shape[1] / _NEAR, 1.5)
            start = now = cv2.goodFeaturesToTrack(frame, _FEATURES, 0.01, 7, mask=mask)
            if start is None or len(start) < _FEWEST:
                return None
            before = frame.copy()
            turn.append(1.0 + 0.0j)
            moved.append(0.0 + 0.0j)
            since.append(chosen)
            continue
        there, tracked = _there_and_back(before, frame, now, levels=3, nearest=0.3)
        start, now = start[tracked], there[tracked]
        before = frame.copy()
        if len(start) < _FEWEST:
            return None
        found, inside = cv2.estimateAffinePartial2D(
            start[:, 0], now[:, 0], method=cv2.RANSAC, ransacReprojThreshold=near, maxIters=2000
        )
        use = inside[:, 0] == 1 if found is not None else np.zeros(len(start), dtype=bool)
        if use.sum() < max(_FEWEST, 0.2 * len(start)):
            return None
        z0, z1 = (points[use, 0] @ np.array([1, 1j]) for points in (start, now))
        weight = np.ones(len(z0))
        for _ in range(
            8
        ):  # Tukey's weights reject features that are biased by the background in their windows
            middle_0, middle_1 = np.average(z0, weights=weight), np.average(z1, weights=weight)
            a = complex(np.vdot((z0 - middle_0) * weight, z1 - middle_1))
            a /= max(abs(a), 1e-12)
            b = complex(middle_1 - a * middle_0)
            rest = np.abs(z1 - a * z0 - b)
            scale = max(3.0 * float(np.median(rest)), 1e-3)
            weight = np.maximum(1.0 - (rest / scale) ** 2, 1e-6) ** 2
        far = np.abs(
            (now[:, 0] - start[:, 0]) @ np.array([1, 1j]) - (a - 1) * (start[:, 0] @ np.array([1, 1j])) - b
        )
        start, now = start[far < _STRAY], now[far < _STRAY]
        turn.append(a * base_a)
        moved.append(a * base_b + b)
        angle += float(np.angle(turn[-1] * np.conj(turn[-2])))
        least, most = min(least, angle), max(most, angle)
        if most - least >= widest:
            return None
        since.append(chosen)
        if (use.sum() < 0.5 * _FEATURES and use.sum() < 60) or len(start) < 2 * _FEWEST:
            fresh = cv2.goodFeaturesToTrack(frame, _FEATURES, 0.01, 7, mask=mask)
            if fresh is not None and len(fresh) > len(start):
                start = now = fresh
                base_a, base_b = turn[-1], moved[-1]
                chosen = len(turn)
    return np.array(turn), np.array(moved), np.array(since, dtype=np.int64)


def still_point(turn: Complexes, moved: Complexes) -> tuple[float, float]:
    """Return the position in the first frame of the point of the body that moves least."""
    left = turn - turn.mean()
    right = -(moved - moved.mean())
    place = complex(np.vdot(left, right) / max(float(np.sum(np.abs(left) ** 2)), 1e-12))
    return place.real, place.imag


def _middle(motion: Motion) -> tuple[float, float] | None:
    y, x = np.nonzero(motion.moving)
    return (float(np.median(x)), float(np.median(y))) if len(x) > 50 else None
