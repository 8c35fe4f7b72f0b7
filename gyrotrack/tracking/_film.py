"""The luma of a film's frames, for trackers that need several passes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Protocol, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from gyrotrack._arrays import Floats, Integers, Plane, Singles
from gyrotrack._column_store import StoredPictures, new_columns, release_memory, release_pages
from gyrotrack._smoothing import running_quantile
from gyrotrack.tracking._camera_motion import Shake
from gyrotrack.tracking._profile import chroma_direction
from gyrotrack.video._container import Frame
from gyrotrack.video._decoder import Reader
from gyrotrack.video._fields import field, first_field

Real = TypeVar("Real", npt.NDArray[np.uint8], Singles)


@dataclass(frozen=True)
class Tilt:
    """The direction from which a distant camera views a plane of motion."""

    # angle between the axis of rotation and the line of sight [rad]: a circle appears as an ellipse with the axis ratio
    # cos(angle)
    angle: float
    azimuth: float = (
        math.pi / 2
    )  # direction of the short axis, counter-clockwise from the right of the picture [rad]

    def matrix(self, width: int, height: int) -> Floats:
        """Return the map (2, 3) of the picture onto the plane; the long axis is shortened, so that no part is lost."""
        short = np.array([math.cos(self.azimuth), -math.sin(self.azimuth)])
        along = np.outer(short, short)
        linear = along + math.cos(self.angle) * (np.eye(2) - along)
        centre = 0.5 * np.array([width - 1.0, height - 1.0])
        return np.column_stack([linear, centre - linear @ centre])


_HELD = 600_000_000
"""Largest size of the decoded pictures that are kept in temporary files [bytes]. Chosen: a larger value needs more disk
space; with a smaller one, more films are decoded again in each pass."""
_FILE = 32_000_000
"""Size of one temporary file [bytes]. Chosen: a larger file occupies more memory, a smaller size opens more files."""
_RELEASES = 2
"""Number of parts of a temporary file; after each part its pages are released [1]. Chosen: a smaller number occupies
more memory, a larger one costs time."""


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
        before: Singles | None = None
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
        """Compensate the motion of the camera in all frames that are read from now on; None: no compensation."""
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
        """Replace rate and timestamps of the frames by the rate and timestamps of the fields."""
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
        """Convert a place (x, y) [px] of the picture to the place in the frames that are corrected for the tilt."""
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

    def some(self, index: Sequence[int] | Integers) -> StoredPictures:
        """Return the frames with the numbers `index`, in ascending order."""
        wanted = {int(i) for i in index}
        first, stop = min(wanted), max(wanted) + 1
        chosen = (f for i, f in enumerate(self.frames(first, stop), first) if i in wanted)
        return StoredPictures.of(len(wanted), chosen)


Progress = Callable[[int, int | None], None]
"""Called with the number of measured frames, and the number of all frames if it is known."""


class FrameSource(Protocol):
    """A film, or a film with reduced frames."""

    @property
    def path(self) -> Path: ...

    def frames(self, first: int = 0, stop: int | None = None) -> Iterator[Plane]: ...

    def some(self, index: Integers) -> Sequence[Plane]: ...


def frames_of(film: FrameSource, index: Integers) -> Iterator[Plane]:
    """Yield the frames with the numbers `index`, in ascending order, in one pass through a film."""
    wanted = set(index.tolist())
    return (frame for i, frame in enumerate(film.frames()) if i in wanted)


def reduced(frame: Real, factor: int) -> Real:
    """Return the means over squares of `factor` px of a frame, without the pixels beyond the last whole square."""
    height, width = (n // factor for n in frame.shape)
    whole = frame[: height * factor, : width * factor]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), dtype=frame.dtype)


_EXAMINED = 12
"""Number of frames from which interlacing is detected [frames]. Chosen: a smaller number may show no motion, a larger
one costs time."""


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
value includes pixels of the black level, a larger one leaves few pixels."""
_BRIGHT = 235
"""Largest grey level at which brightness is proportional to a power of the light [grey levels]. Source: white of
limited range in ITU-R BT.601; brighter pixels are saturated."""
_FEWEST_PIXELS = 50
"""Smallest number of pixels for the gain of a frame [pixels]. Chosen: a smaller number gives a noisy gain, a larger one
leaves dark films uncorrected."""
_SAMPLED = 8000
"""Typical number of pixels for the gain of a frame [pixels]. Chosen: a larger number costs time, a smaller one gives a
noisier gain."""
_FLICKERS = 1.5
"""Smallest factor by which a gain must reduce the standard deviation in time of the typical pixel [1]. Chosen: the
flicker then exceeds all other changes; a smaller value amplifies noise, a larger one leaves flicker."""


class _Flicker:
    """Gain of each frame relative to the first one: the common ratio of most pixels, robust against moving bodies.

    Brightness is measured from black, which is 0, or 16 in films of limited range (ITU-R BT.601). Of these two levels,
    the one for which the typical pixel varies less is used.
    """

    def __init__(self) -> None:
        self._first: Singles | None = None
        self._gain: dict[float, list[float]] = {0.0: [], 16.0: []}
        self._sums: dict[float | None, Floats] = {}

    def add(self, picture: Singles) -> None:
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


def _change(before: Singles, after: Singles) -> float:
    """Return the mean absolute difference of two pictures, apart from flicker of the illumination.

    Without this correction, frames taken at the same flicker phase differ so little that they seem to be repeated.
    """
    gain = float(after.mean()) / max(float(before.mean()), 1.0)
    return float(np.mean(np.abs(after - np.float32(gain) * before)))


_NEIGHBOURS = 9
"""Number of frames of the running quantile about a frame [frames]. Chosen: a larger number follows changes of the speed
late, a smaller one is dominated by repeats."""
_MOVING = 7
"""Rank of the typical change among the changes of `_NEIGHBOURS` frames [1]. Chosen: a lower rank selects a repeat if
few frames are new, a higher one selects an outlier."""
_REPEATED = 0.1
"""Largest change of a repeated frame, relative to the typical change [1]. Chosen: a smaller value keeps repeats that
were encoded again, a larger one drops frames of slow motion."""
_FEWEST_RUNS = 8
"""Smallest number of runs of identical frames that show a raised frame rate [1]. Chosen: a smaller number takes rests
of a drawn body for repeats, a larger one leaves repeats in short films."""


FEWEST_FRAMES = 10
"""Smallest number of different frames for the measurement of a motion [frames]. Chosen: a quadratic in time has 3
parameters; a smaller number leaves few residuals, a larger one refuses short films."""


def fresh_frames(film: Film) -> Integers:
    """Return the numbers of the selected frames that do not repeat the previous frame.

    The change of a frame is compared with the changes of its neighbours and of the frames in its run, because all
    changes are small where an oscillation reverses. If a film repeats each frame many times, most frames have only
    identical neighbours. Such repeats are recognised because all runs of identical frames have the same length.
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
    new = np.flatnonzero(change[1:] > 0.0)
    lengths = np.diff(new)
    if len(lengths) >= _FEWEST_RUNS and lengths.min() > 1 and np.ptp(lengths) <= 1:
        fresh[1:] &= change[1:] > 0.0
    return np.flatnonzero(fresh & film.selected).astype(np.int64)
