"""The luma of a film's frames, for trackers that need several passes, and the motion of the camera.

The motion of the camera is measured by the background at rest. Features of a reference frame are tracked into every
other frame (B. Lucas, T. Kanade, IJCAI 1981, pyramidal). The features of the background move as one rigid picture in
all frames, independent of the bodies in front. Displacement and roll of the background are compensated by resampling
the frames before any other measurement.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from gyrotrack._column_store import StoredPictures, new_columns, release_memory, release_pages
from gyrotrack._smoothing import running_quantile
from gyrotrack.tracking._profile import chroma_direction
from gyrotrack.video._container import Frame
from gyrotrack.video._decoder import Reader
from gyrotrack.video._fields import field, first_field

Floats = npt.NDArray[np.float64]
Plane = npt.NDArray[np.uint8]

_MOST = 400
"""Largest number of features of a frame [features]. Chosen: more cost time, fewer leave few in the background."""
_FEWEST = 6
"""Smallest number of inliers [features]. Chosen: fewer may belong to a small body, more refuse plain backgrounds."""
_ALIKE = 0.7
"""Largest residual of a feature of the background from the motion of the picture [px]. Chosen: a smaller value rejects
features blurred by the codec, a larger one accepts slow bodies."""
_STILL = 0.35
"""Largest displacement of a feature of the background for a camera at rest [px]. Chosen: a smaller value measures a
motion that is noise, a larger one ignores a shaking camera."""
_OFTEN = 0.8
"""Smallest share of frames in which a feature of the background is an inlier [1]. Chosen: a hand or the body may
occlude it; a smaller value accepts a body at rest at times."""
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
"""Smallest share of the picture within the features of its background [1]. Chosen: the ball of a pendulum before a
blank wall covers less; a larger value refuses narrow backgrounds."""
_CLEAR = 5.0
"""Smallest significant motion of the camera in standard uncertainties [1]. Chosen: a smaller value corrects noise, a
larger one leaves a shake."""
_LEAST = 0.15
"""Smallest displacement (rms) of a moving camera [px]. Chosen: the size of tracking errors; a smaller value resamples
frames needlessly, a larger one leaves a shake."""


@dataclass(frozen=True)
class Shake:
    """Displacement of the picture in each frame."""

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


def features_of(frame: Plane) -> npt.NDArray[np.float32]:
    """Return the corners of a frame that can be tracked, shape (n, 2) [px]."""
    found = cv2.goodFeaturesToTrack(frame, _MOST, 0.01, 8, blockSize=7)
    return np.zeros((0, 2), dtype=np.float32) if found is None else found.reshape(-1, 2).astype(np.float32)


def tracked(reference: Plane, places: npt.NDArray[np.float32], frame: Plane) -> Floats:
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
"""Largest difference of the surroundings of a tracked feature in two frames [grey levels]. Chosen: a smaller
value loses features in flicker, a larger one keeps occluded ones."""


def background(
    places: npt.NDArray[np.float32], moved: Floats, shape: tuple[int, ...]
) -> npt.NDArray[np.bool_]:
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


def _wide(places: npt.NDArray[np.float32], shape: tuple[int, ...]) -> bool:
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


def _rigid(places: npt.NDArray[np.float32], moved: Iterable[Floats]) -> Shake | None:
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
    if roll.std() < _CLEAR * roll_sigma:  # no significant roll, for example of a tripod on a shaking table
        roll_sigma = float(np.sqrt(max(roll.var() - roll_sigma**2, 0.0)))
        roll = np.zeros(len(roll))
    return Shake(
        shift, roll, (float(centre[0]), float(centre[1])), len(places), float(np.median(errors)), roll_sigma
    )


@dataclass(frozen=True)
class Tilt:
    """The direction from which a distant camera views a plane of motion.

    Attributes
    ----------
    angle : float
        Angle between the axis of rotation and the line of sight [rad]: a circle is an ellipse with the ratio
        cos(angle) of its axes.
    azimuth : float
        Direction of the short axis of the ellipse in the picture, counter-clockwise from the right [rad].
    """

    angle: float
    azimuth: float = math.pi / 2

    def matrix(self, width: int, height: int) -> Floats:
        """Return the map (2, 3) of the picture onto the plane; the long axis is shortened, so that no part is lost."""
        short = np.array([math.cos(self.azimuth), -math.sin(self.azimuth)])
        along = np.outer(short, short)
        linear = along + math.cos(self.angle) * (np.eye(2) - along)
        centre = 0.5 * np.array([width - 1.0, height - 1.0])
        return np.column_stack([linear, centre - linear @ centre])


_HELD = 600_000_000
"""Largest size of the decoded pictures that are kept in temporary files [bytes]. Chosen: disk; longer films are decoded
for each pass."""
_FILE = 32_000_000
"""Size of one temporary file [bytes]. Chosen: memory; a larger file occupies more pages, a smaller one opens more
files."""
_RELEASES = 2
"""Number of parts of a temporary file after which its pages are released [1]. Chosen: memory; more release earlier and
cost time."""


class Film:
    """The luma of at most `most` frames of a film: stored in temporary files if small, else decoded in each pass."""

    def __init__(
        self,
        path: Path,
        threads: int = 2,
        most: int | None = None,
        colour: str | None = None,
        tilt: Tilt | None = None,
    ) -> None:
        self.path = path
        self._threads = threads
        self.tilt = tilt
        self._direction = None if colour is None else chroma_direction(colour)
        self._shake: Shake | None = None
        flicker = _Flicker()
        self._files: list[npt.NDArray[np.uint8]] = []
        before: npt.NDArray[np.float32] | None = None
        changes = []
        kept = True
        self._first_field = _interlacing(path)
        with Reader(path, threads) as reader:
            for count, (plane, _) in enumerate(islice(self._pictures(reader), most)):
                small = plane[::4, ::4].astype(np.float32)
                changes.append(255.0 if before is None else _change(before, small))
                before = small
                every = 1 + int(math.sqrt(small.size / _SAMPLED))
                flicker.add(small[::every, ::every])
                rows = max(_FILE // plane.nbytes, 1)
                kept &= (count + 1) * plane.nbytes <= _HELD
                if not kept:
                    self._files.clear()
                    continue
                if count % rows == 0:
                    self._files.append(new_columns(rows, {"plane": (plane.shape, np.uint8)})["plane"])
                    release_pages()
                self._files[-1][count % rows] = plane
            self.info = reader.info
            self.stamps = reader.pts_seconds()
            self.warnings = reader.warnings
        if self._first_field is not None:
            self._count_fields(len(changes))
        self._gain = flicker.gain
        if self._gain is not None:
            text = (
                f"The illumination flickers by {100 * self._gain[1].std():.2g} % rms, which is compensated."
            )
            self.warnings = (*self.warnings, text)
        if tilt is not None:
            text = (
                f"The film is corrected for a tilt of {math.degrees(tilt.angle):.3g} degrees; positions in messages "
                "refer to the corrected picture."
            )
            self.warnings = (*self.warnings, text)
        release_pages()
        release_memory()
        self.changes = np.array(changes)
        self.count = len(changes)
        self.selected = np.ones(self.count, dtype=np.bool_)  # frames that are tracked

    def __len__(self) -> int:
        return self.count

    def stabilise(self, shake: Shake | None) -> None:
        """Compensate the motion of the camera in all frames from now on; None: no compensation."""
        self._shake = shake

    @property
    def stabilised(self) -> bool:
        """Whether the motion of the camera is compensated."""
        return self._shake is not None

    def frames(self, first: int = 0, stop: int | None = None) -> Iterator[Plane]:
        """Yield the luma of the frames from `first` to `stop` - 1."""
        stop = self.count if stop is None else min(stop, self.count)
        release_pages()
        if self._files:
            rows = len(self._files[0])
            for index in range(first, stop):
                if index % max(rows // _RELEASES, 1) == 0:
                    release_pages()
                yield self._still(self._files[index // rows][index % rows], index)
            return
        try:
            with Reader(self.path, self._threads) as reader:
                for plane, index in self._pictures(reader):
                    if index >= stop:
                        return
                    if index >= first:
                        yield self._still(plane, index)
        finally:  # also if the consumer stops early
            release_memory()

    def _pictures(self, frames: Iterable[Frame]) -> Iterator[tuple[Plane, int]]:
        """Yield the pictures of the frames and their numbers; an interlaced frame gives two pictures."""
        for frame in frames:
            plane = self._plane(frame)
            if self._first_field is None:
                yield plane, frame.index
                continue
            for later in (False, True):
                yield field(plane, odd=bool(self._first_field) != later), 2 * frame.index + later

    @property
    def interlaced(self) -> bool:
        """Whether each frame contains two fields, which are measured as two pictures."""
        return self._first_field is not None

    def _count_fields(self, count: int) -> None:
        """Replace rate and timestamps of the frames by those of the fields."""
        step = np.diff(self.stamps)
        period = float(np.median(step)) if len(step) else float("nan")
        self.stamps = np.stack([self.stamps, self.stamps + 0.5 * period], axis=1).ravel()[:count]
        self.info = replace(
            self.info,
            container_fps=2.0 * self.info.container_fps,
            frames_declared=2 * self.info.frames_declared,
            time_base=self.info.time_base / 2,
        )
        text = f"The film is interlaced: its {count} fields are measured, at twice the frame rate."
        self.warnings = (*self.warnings, text)

    def _plane(self, frame: Frame) -> Plane:
        """Return the luma of a frame, or its chroma along a colour: 128 for grey, more for this colour.

        A chroma sample is between the luma samples of its block, as JPEG and MPEG-1 define it. MPEG-2 and H.264 place
        the sample 0.5 px to the left, which displaces all points equally.
        """
        if self._direction is None or self._direction == (0.0, 0.0):
            return self._level(np.ascontiguousarray(frame.y))
        u, v = self._direction
        score = u * (frame.u.astype(np.float32) - 128.0) + v * (frame.v.astype(np.float32) - 128.0)
        height, width = frame.y.shape
        large = cv2.resize(score, (2 * score.shape[1], 2 * score.shape[0]), interpolation=cv2.INTER_LINEAR)
        return self._level(
            np.asarray(np.clip(128.0 + large[:height, :width], 0.0, 255.0).round(), dtype=np.uint8)
        )

    def _level(self, plane: Plane) -> Plane:
        if self.tilt is None:
            return plane
        height, width = plane.shape
        shown = cv2.warpAffine(
            plane, self.tilt.matrix(width, height), (width, height), flags=cv2.INTER_CUBIC,
            borderMode=cv2.BORDER_REPLICATE,
        )  # fmt: skip
        return np.asarray(shown, dtype=np.uint8)

    def levelled(self, place: tuple[float, float]) -> tuple[float, float]:
        """Convert a place (x, y) of the picture to the frames, which are corrected for the tilt [px]."""
        if self.tilt is None:
            return place
        x, y = self.tilt.matrix(self.info.width, self.info.height) @ np.array([*place, 1.0])
        return float(x), float(y)

    def seen(self, places: Floats) -> Floats:
        """Convert places (n, 2) of the corrected frames to the picture [px]."""
        if self.tilt is None:
            return places
        matrix = self.tilt.matrix(self.info.width, self.info.height)
        return np.asarray((places - matrix[:, 2]) @ np.linalg.inv(matrix[:, :2]).T)

    def _still(self, plane: Plane, index: int) -> Plane:
        if self._gain is not None:
            black, scale = self._gain[0], 1.0 / self._gain[1][index]
            even = cv2.convertScaleAbs(plane, alpha=scale, beta=black * (1.0 - scale))
            plane = np.asarray(even, dtype=np.uint8)
        return plane if self._shake is None else self._shake.stabilised(plane, index)

    def some(self, index: Sequence[int] | npt.NDArray[np.int64]) -> StoredPictures:
        """Return chosen frames, in the order of their numbers."""
        wanted = {int(i) for i in index}
        first, stop = min(wanted), max(wanted) + 1
        chosen = (f for i, f in enumerate(self.frames(first, stop), first) if i in wanted)
        return StoredPictures.of(len(wanted), chosen)


def reduced(frame: Plane, factor: int) -> Plane:
    """Return the means over squares of `factor` px of a frame, without the pixels beyond the last whole square."""
    height, width = (n // factor for n in frame.shape)
    whole = frame[: height * factor, : width * factor]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


_EXAMINED = 12
"""Frames that show whether a film is interlaced [frames]. Chosen: fewer may show no motion, more cost time."""


def _interlacing(path: Path) -> int | None:
    """Return the index of the field that is first in time, 0 or 1; None for a film that is not interlaced."""
    with Reader(path) as reader:
        frames = []
        for frame in islice(reader, _EXAMINED):
            if not frame.interlaced:
                return None
            frames.append(frame.y.copy())
    return first_field(frames)


_COLOUR = 24.0
"""Smallest chroma of a coloured pixel [grey levels]. Chosen: a smaller value finds colour in tinted light, a larger one
overlooks faint markers."""
_FEWEST_COLOURED = 12
"""Smallest number of coloured pixels in a frame of a coloured film [pixels]. Chosen: a smaller value finds colour in
noise, a larger one overlooks small markers."""


def is_coloured(path: Path, frames: int = 12) -> bool:
    """Return whether one of the first frames of a film has coloured pixels."""
    with Reader(path) as reader:
        for frame in islice(reader, frames):
            chroma = np.hypot(frame.u.astype(np.float32) - 128.0, frame.v.astype(np.float32) - 128.0)
            if np.count_nonzero(chroma > _COLOUR) >= _FEWEST_COLOURED:
                return True
    return False


_DARK = 32
"""Smallest grey level at which brightness is proportional to a power of the light [grey levels]. Chosen: a smaller
value includes pixels of the black level, a larger one leaves few."""
_BRIGHT = 235
"""Largest grey level at which brightness is proportional to a power of the light [grey levels]. Source: white of
limited range in ITU-R BT.601; brighter pixels are saturated."""
_FEWEST_PIXELS = 50
"""Smallest number of pixels for the gain of a frame [pixels]. Chosen: fewer give a noisy gain, more leave dark films
uncorrected."""
_SAMPLED = 8000
"""Typical number of pixels for the gain of a frame [pixels]. Chosen: more cost time, fewer give a noisier gain."""
_FLICKERS = 1.5
"""Smallest factor by which a gain must reduce the standard deviation in time of the typical pixel [1]. Chosen: the
flicker then exceeds all other changes; a smaller value amplifies noise, a larger one leaves flicker."""


class _Flicker:
    """Gain of each frame relative to the first one: the common ratio of most pixels, robust against moving bodies.

    Brightness is measured from black, which is 0, or 16 in films of limited range (ITU-R BT.601). The level for which
    the typical pixel varies less is used.
    """

    def __init__(self) -> None:
        self._first: npt.NDArray[np.float32] | None = None
        self._gain: dict[float, list[float]] = {0.0: [], 16.0: []}
        self._sums: dict[float | None, Floats] = {}

    def add(self, picture: npt.NDArray[np.float32]) -> None:
        """Measure the gain of the next frame, (height, width) in grey levels."""
        if self._first is None:
            self._first = picture.copy()
            self._sums = {black: np.zeros((2, *picture.shape)) for black in (None, *self._gain)}
        first = self._first
        use = (np.minimum(first, picture) > _DARK) & (np.maximum(first, picture) < _BRIGHT)
        self._sums[None] += np.stack([picture, picture**2])
        for black, gains in self._gain.items():
            gain = 1.0
            if use.sum() > _FEWEST_PIXELS:
                now, then = picture[use] - np.float32(black), first[use] - np.float32(black)
                ratio = now / then
                off = np.abs(ratio - np.median(ratio))
                near = off <= 3.0 * 1.4826 * np.median(off)
                gain = float(now[near].sum() / then[near].sum())
            gains.append(gain)
            even = black + (picture - np.float32(black)) / np.float32(gain)
            self._sums[black] += np.stack([even, even**2])

    @property
    def gain(self) -> tuple[float, Floats] | None:
        """Black level and gains (n,) of mean 1; None if the typical pixel does not flicker."""
        variance = {}
        for black, sums in self._sums.items():
            mean, square = sums / max(len(self._gain[0.0]), 1)
            variance[black] = max(float(np.median(square - mean**2)), _ROUNDING)
        if not variance:
            return None
        best = min(self._gain, key=lambda black: variance[black])
        gain = np.array(self._gain[best])
        return (best, gain / gain.mean()) if variance[None] > _FLICKERS**2 * variance[best] else None


_ROUNDING = 1.0 / 12.0
"""Variance of a brightness in whole grey levels [grey levels squared]. Derived: a uniform distribution of width 1 has
the variance 1 / 12."""


def _change(before: npt.NDArray[np.float32], after: npt.NDArray[np.float32]) -> float:
    """Return the mean absolute difference of two pictures, apart from flicker of the illumination.

    Without this correction, frames taken at the same flicker phase differ less than others, as if they were repeated.
    """
    gain = float(after.mean()) / max(float(before.mean()), 1.0)
    return float(np.mean(np.abs(after - np.float32(gain) * before)))


_NEIGHBOURS = 9
"""Frames of the running quantile about a frame [frames]. Chosen: more follow changes of the speed late, fewer are
dominated by repeats."""
_MOVING = 7
"""Rank of the typical change among `_NEIGHBOURS` frames [1]. Chosen: a lower rank is a repeat where few
frames are new, a higher one is an outlier."""
_REPEATED = 0.1
"""Largest change of a repeated frame, relative to the typical one [1]. Chosen: a smaller value keeps repeats that were
encoded again, a larger one drops frames of slow motion."""


FEWEST_FRAMES = 10
"""Smallest number of different frames for the measurement of a motion [frames]. Chosen: a quadratic in time has 3
parameters; fewer leave few residuals, more refuse short films."""


def fresh_frames(film: Film) -> npt.NDArray[np.int64]:
    """Return the numbers of the selected frames that do not repeat the previous frame.

    The change of a frame is compared with the changes of its neighbours and of the frames in its run, because all
    changes are small where an oscillation reverses.
    """
    change = film.changes
    fresh = np.ones(len(change), dtype=np.bool_)
    if len(change) < 2:
        return np.flatnonzero(film.selected).astype(np.int64)
    usual = running_quantile(change[1:], _NEIGHBOURS, _MOVING)
    alike = 1 + np.flatnonzero(change[1:] < _REPEATED * usual)
    for run in np.split(alike, np.flatnonzero(np.diff(alike) > 1) + 1) if len(alike) else ():
        around = [change[k] for k in (run[0] - 1, run[-1] + 1) if 0 < k < len(change)]
        fresh[run] = change[run].max() >= _REPEATED * max(around, default=0.0)
    return np.flatnonzero(fresh & film.selected).astype(np.int64)
