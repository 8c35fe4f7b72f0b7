"""Motion of the camera, measured by the background at rest.

Features of a reference frame are tracked into every other frame (B. Lucas, T. Kanade, IJCAI 1981, pyramidal). The
features of the background move as one rigid picture in all frames, independent of the bodies in front. Displacement and
roll of the background are compensated before any other measurement.

A background without features that can be tracked, for example the grain of wood, is registered as a whole by the
enhanced correlation coefficient (G. Evangelidis, E. Psarakis, IEEE Trans. PAMI 30, 1858, 2008). This registration
determines the roll. The displacement is taken from the disc of the hub, because a grain poorly determines the
displacement along its direction.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from gyrotrack._arrays import Bools, Floats, Plane, Singles
from gyrotrack._column_store import release_pages

_MOST = 400
"""Largest number of features of a frame [features]. Chosen: a larger number costs time, a smaller one leaves few
features in the background."""
_FEWEST = 6
"""Smallest number of inliers [features]. Chosen: with fewer, the inliers may belong to a small body; with more, plain
backgrounds are refused."""
_ALIKE = 0.7
"""Largest residual of a feature of the background from the motion of the picture [px]. Chosen: a smaller value rejects
features blurred by the codec, a larger one accepts slow bodies."""
_STILL = 0.35
"""Largest displacement of a feature of the background for a camera at rest [px]. Chosen: a smaller value measures a
motion that is noise, a larger one ignores a shaking camera."""
_OFTEN = 0.8
"""Smallest share of frames in which a feature of the background is an inlier [1]. Chosen: a hand or the body may
occlude the feature; a smaller value accepts a body that is sometimes at rest."""
_MOST_ROLL = 0.05
"""Largest roll of the camera [rad]. Chosen: a body that turns farther is not the background; a smaller value refuses
cameras that roll."""
_APART = 0.15
"""Smallest distance of two features that determine the roll, relative to the size of the picture [1]. Chosen: a smaller
value gives a noisy roll, a larger one leaves few pairs."""
_TRIES = 300
"""Number of random pairs of features [1]. Derived: with nine outliers in ten, the probability of a pair without
outliers is 1 - 0.99^300 = 95 %."""
_WIDEST_BODY = 0.05
"""Smallest area enclosed by the features of the background, divided by the area of the picture [1]. Chosen: the ball of
a pendulum in front of a blank wall covers a smaller share; a larger value refuses narrow backgrounds."""
_CLEAR = 5.0
"""Smallest significant motion of the camera in standard uncertainties [1]. Chosen: a smaller value corrects noise, a
larger one leaves a shake."""
_LEAST = 0.15
"""Smallest displacement (rms) of a moving camera [px]. Chosen: the size of tracking errors; a smaller value resamples
frames needlessly, a larger one leaves a shake."""


@dataclass(frozen=True)
class Shake:
    """Displacement and roll of the picture in each frame."""

    shift: Floats  # displacement (x, y) of the picture at `centre` from the reference frame [px], (n, 2)
    roll: Floats  # rotation of the picture, clockwise in the picture [rad]
    centre: tuple[float, float]  # centroid of the features (x, y) [px]
    features: int  # number of inliers of the background
    shift_sigma: float  # standard uncertainty of the displacement [px] and of the roll [rad] in one frame
    roll_sigma: float

    @property
    def rms(self) -> float:
        """Rms displacement of the picture [px]."""
        return float(np.sqrt(np.mean(np.sum((self.shift - self.shift.mean(axis=0)) ** 2, axis=1))))

    def margin(self, shape: tuple[int, ...]) -> int:
        """Return the width of the incomplete margin [px] of a stabilised picture of this shape (height, width)."""
        turned = 0.5 * max(shape) * float(np.abs(self.roll).max())
        return int(np.ceil(float(np.abs(self.shift).max()) + turned)) + 1

    @property
    def significant(self) -> bool:
        """Whether the motion of the camera is significant."""
        return self.rms > max(_LEAST, _CLEAR * self.shift_sigma)

    def still(self, place: Floats) -> Floats:
        """Convert one point of each frame, (n, 2) [px], to the reference frame."""
        x, y = (place - self.centre - self.shift).T
        cos, sin = np.cos(self.roll), np.sin(self.roll)
        return np.stack([cos * x + sin * y, cos * y - sin * x], axis=1) + self.centre

    def seen(self, place: Floats) -> Floats:
        """Convert one point of the reference frame for each frame, (n, 2) [px], to this frame."""
        x, y = (place - self.centre).T
        cos, sin = np.cos(self.roll), np.sin(self.roll)
        return np.stack([cos * x - sin * y, sin * x + cos * y], axis=1) + self.centre + self.shift

    def stabilised(self, frame: Plane, index: int) -> Plane:
        """Return a frame resampled to the position of the camera in the reference frame."""
        cos, sin = np.cos(self.roll[index]), np.sin(self.roll[index])
        x, y = self.centre
        dx, dy = self.shift[index]
        # from the reference to this frame: p -> R (p - c) + c + d
        back = np.array([[cos, -sin, x + dx - cos * x + sin * y], [sin, cos, y + dy - sin * x - cos * y]])
        return np.asarray(
            cv2.warpAffine(
                frame,
                back,
                frame.shape[::-1],
                flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
                borderMode=cv2.BORDER_REPLICATE,
            ),
            dtype=np.uint8,
        )


def features_of(frame: Plane) -> Singles:
    """Return the corners of a frame that can be tracked, shape (n, 2) [px]."""
    found = cv2.goodFeaturesToTrack(frame, _MOST, 0.01, 8, blockSize=7)
    return np.zeros((0, 2), dtype=np.float32) if found is None else found.reshape(-1, 2).astype(np.float32)


def tracked(reference: Plane, places: Singles, frame: Plane) -> Floats:
    """Return the displacements of features (n, 2) [px] from the reference to a frame; NaN where they are lost."""
    found, status, error = cv2.calcOpticalFlowPyrLK(
        reference,
        frame,
        places[:, None],
        None,  # type: ignore[call-overload]
        winSize=(21, 21),
        maxLevel=3,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.003),
    )
    moved: Floats = np.asarray(found[:, 0] - places, dtype=np.float64)
    moved[(status.ravel() == 0) | (error.ravel() > _DISSIMILAR)] = np.nan
    return moved


_DISSIMILAR = 20.0
"""Largest difference of the surroundings of a tracked feature in two frames [grey levels]. Chosen: a smaller value
loses features in flicker, a larger one keeps occluded features."""


def background(places: Singles, moved: Floats, shape: tuple[int, ...]) -> Bools:
    """Return a mask of the features of the background, at `places` (features, 2) [px] in the reference frame.

    `moved` (frames, features, 2) are the displacements of the features [px], NaN where a feature is lost; `shape` is
    height and width. Features at rest in the picture are the background. If these are too few, the background is the
    largest set of features that moves as a rigid picture with little roll, determined by two features in each frame
    (random sample consensus, M. Fischler and R. Bolles, Comm. ACM 24, 381, 1981). The mask is empty if the background
    is not visible.
    """
    with np.errstate(invalid="ignore"):
        # a hand or the body may occlude a feature at times
        still = (np.hypot(*np.moveaxis(moved, 2, 0)) < _STILL).mean(axis=0) > _OFTEN
    if _wide(places[still], shape):
        return np.asarray(still)
    rng = np.random.default_rng(0)
    place = places[:, 0].astype(np.complex128) + 1j * places[:, 1]
    motion = moved[..., 0] + 1j * moved[..., 1]
    best = np.zeros(len(places), dtype=np.bool_)
    for _ in range(_TRIES):
        a, b = rng.choice(len(places), 2, replace=False)
        if abs(place[b] - place[a]) < _APART * max(shape):
            continue
        roll = np.angle(1.0 + (motion[:, b] - motion[:, a]) / (place[b] - place[a]))
        expected = motion[:, [a]] + (np.exp(1j * roll[:, None]) - 1.0) * (place - place[a])
        with np.errstate(invalid="ignore"):
            alike = (np.abs(motion - expected) < _ALIKE) & (np.abs(roll) < _MOST_ROLL)[:, None]
        together = alike.mean(axis=0) > _OFTEN
        if together.sum() > best.sum():
            best = together
    return best if _wide(places[best], shape) else np.zeros(len(places), dtype=np.bool_)


def _wide(places: Singles, shape: tuple[int, ...]) -> bool:
    """Return whether features enclose enough of the picture to be its background."""
    if len(places) < _FEWEST:
        return False
    return bool(cv2.contourArea(cv2.convexHull(places)) > _WIDEST_BODY * shape[0] * shape[1])


def camera_shake(
    samples: Sequence[Plane], frames: Iterable[Plane], body: tuple[float, float, float] | None = None
) -> Shake | None:
    """Measure the motion of the camera; None if it is at rest, or no background is visible.

    `samples` are frames from the whole film; the first sample is the reference frame, in which a hub is given. All
    `frames` are used only if the samples show a motion. `body` is centre (x, y) and radius [px] of the bodies, which
    are not background.
    """
    reference = samples[0]
    places = features_of(reference)
    if body is not None:
        places = places[np.hypot(places[:, 0] - body[0], places[:, 1] - body[1]) > body[2]]
    if len(places) < _FEWEST:
        return None
    few = np.unique(np.linspace(0, len(samples) - 1, 40).astype(int))
    found = []
    for i in few:
        found.append(tracked(reference, places, samples[i]))
        release_pages()
    moved = np.stack(found)
    use = background(places, moved, reference.shape)
    if not use.any():
        return None
    places = places[use]
    shake = _rigid(places, moved[:, use])
    if shake is None or not shake.significant:
        return None
    return _rigid(places, (tracked(reference, places, frame) for frame in frames))


_MEASURED = 0.9
"""Smallest share of the frames in which the motion of the camera is measured [1]. Chosen: a smaller value interpolates
over long gaps, a larger one leaves a shake uncorrected."""


def _rigid(places: Singles, moved: Iterable[Floats]) -> Shake | None:
    """Fit displacement and roll of the picture in each frame by least squares without outliers."""
    centre = places.mean(axis=0).astype(np.float64)
    own = places - centre
    shifts, turns, errors, rolls = [], [], [], []
    for one in moved:
        shift, turn = np.full(2, np.nan), np.nan
        use = np.isfinite(one).all(axis=1)
        for _ in range(3):
            if use.sum() < _FEWEST // 2:
                break
            x = own[use]
            middle = x.mean(axis=0)
            d = one[use].mean(axis=0)
            across = np.stack([-(x - middle)[:, 1], (x - middle)[:, 0]], axis=1)
            inertia = float(np.sum(across**2))
            turn = float(np.sum(across * (one[use] - d))) / max(inertia, 1e-9)
            shift = d - turn * np.array([-middle[1], middle[0]])
            rest = one - shift - turn * np.stack([-own[:, 1], own[:, 0]], axis=1)
            size = np.hypot(*np.nan_to_num(rest, nan=1e9).T)
            spread = float(np.median(size[use])) + 1e-3
            errors.append(spread / np.sqrt(use.sum()))
            rolls.append(spread / np.sqrt(max(inertia, 1e-9)))
            use = size < 3.0 * spread
        shifts.append(shift)
        turns.append(turn)
    shift, roll = np.array(shifts), np.array(turns)
    known = np.isfinite(roll)
    if known.mean() < _MEASURED:
        return None
    at = np.arange(len(roll))
    roll = np.interp(at, at[known], roll[known])
    shift = np.stack([np.interp(at, at[known], shift[known, i]) for i in (0, 1)], axis=1)
    roll_sigma = float(np.median(rolls))
    roll, roll_sigma = _significant_roll(roll, roll_sigma)
    return Shake(
        shift, roll, (float(centre[0]), float(centre[1])), len(places), float(np.median(errors)), roll_sigma
    )


def _significant_roll(roll: Floats, sigma: float) -> tuple[Floats, float]:
    """Return a roll (n,) [rad] and its standard uncertainty; zero if it is not significant, as on a tripod."""
    if roll.std() >= _CLEAR * sigma:
        return roll, sigma
    return np.zeros(len(roll)), float(np.sqrt(max(roll.var() - sigma**2, 0.0)))


_WIDTH = 640
"""Largest width of a picture whose background is registered as a whole [px]. Chosen: a smaller value loses fine grain,
a larger one costs time."""
_ITERATIONS = 50
"""Largest number of steps of a registration [1]. Chosen: a smaller number ends before convergence, a larger one costs
time."""
_CONVERGED = 1e-3
"""Change of the correlation coefficient at which a registration ends [1]. Chosen: a larger value leaves errors of the
roll, a smaller one costs time."""
_KERNEL = 5
"""Width of the Gaussian filter before a registration [px]. Chosen: a smaller value leaves noise, a larger one removes
grain."""
_PATCH = 70
"""Width of the patches of the background that are assigned in turn to its two halves [px]. Measured: in a path-traced
film the halves give 0.11 mrad for an error of 0.10 mrad, in a drawn film 0.14 mrad for 0.06 mrad; patches of 40 px give
several times the error, patches of 126 px half of the error."""
_HALVES_EVERY = 16
"""Distance between the frames in which the halves of the background are compared [frames]. Chosen: a smaller distance
costs time, a larger one leaves few differences."""


def background_roll(frames: Iterable[Plane], body: tuple[float, float, float]) -> Shake | None:
    """Measure the roll of the camera by the whole background; None if it cannot be measured.

    `body` is centre (x, y) and radius [px] of the bodies in the first frame. The displacement of the result is zero at
    this centre. The standard uncertainty of the roll follows from the differences between two halves of the background.
    A roll that is not significant is replaced by zero; its standard uncertainty is then its rms without the part due to
    noise.
    """
    roll, apart, masks = [], [], []
    warp = [np.eye(2, 3, dtype=np.float32) for _ in range(3)]
    ends = cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _ITERATIONS, _CONVERGED
    reference = np.zeros((0, 0), dtype=np.uint8)
    for count, frame in enumerate(frames):
        factor = -(-frame.shape[1] // _WIDTH)
        small = cv2.resize(frame, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
        if count == 0:
            reference = np.asarray(small, dtype=np.uint8)
            masks = _halves(reference.shape, tuple(part / factor for part in body))
            if cv2.countNonZero(masks[0]) < _WIDEST_BODY * reference.size:
                return None
        turns = [np.nan, np.nan, np.nan]
        for k, mask in enumerate(masks if count % _HALVES_EVERY == 0 else masks[:1]):
            try:
                found = cv2.findTransformECC(
                    reference, small, warp[k], cv2.MOTION_EUCLIDEAN, ends, mask, _KERNEL
                )[1]
                warp[k] = np.asarray(found, dtype=np.float32)
                turns[k] = float(np.arctan2(warp[k][1, 0], warp[k][0, 0]))
            except cv2.error:  # no correlation, for example behind a hand
                warp[k] = np.eye(2, 3, dtype=np.float32)
        roll.append(turns[0])
        apart.append(0.5 * (turns[1] - turns[2]))
    turned, halves = np.array(roll), np.array(apart)
    known = np.isfinite(turned) & (np.abs(turned) < _MOST_ROLL)
    if known.mean() < _MEASURED or np.isfinite(halves).sum() < _FEWEST:
        return None
    sigma = 1.4826 * float(np.nanmedian(np.abs(halves - np.nanmedian(halves))))
    at = np.arange(len(turned))
    turned = np.interp(at, at[known], turned[known])
    turned, sigma = _significant_roll(turned, sigma)
    return Shake(np.zeros((len(turned), 2)), turned, body[:2], 0, 0.0, sigma)


def _halves(shape: tuple[int, ...], body: tuple[float, ...]) -> list[Plane]:
    """Return masks of the background outside a body (x, y, radius) [px]: the whole, and two halves in patches."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    outside = np.hypot(x - body[0], y - body[1]) > body[2]
    odd = (x // _PATCH + y // _PATCH) % 2 == 1
    return [mask.astype(np.uint8) for mask in (outside, outside & odd, outside & ~odd)]
