"""One pass through a film: every frame unrolled, every batch measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gyrotrack.angles.body_watch import BodyWatch
from gyrotrack.angles.sightings import Sightings
from gyrotrack.geometry.disc import DiscWindow
from gyrotrack.geometry.samples import Samples
from gyrotrack.geometry.scene import Scene
from gyrotrack.video import Reader, frame_numbers, read_stamps

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Progress = Callable[[int, int | None], None]

BATCH = 128
_MOVE = 0.6
"""Distance in px from the rings' centre to the disc's beyond which the rings are moved."""


@dataclass(frozen=True)
class BodySightings:
    """One body in all frames: unwrapped coarse angle as seen [rad], NaN where it was lost; its markers."""

    coarse: Floats
    markers: dict[str, Sightings]


@dataclass(frozen=True)
class Watched:
    """All that one pass gives.

    Attributes
    ----------
    bodies : dict of BodySightings
        By name.
    disc : ndarray, shape (n, 2), or None
        The disc's centre in every frame [px].
    pts_time : ndarray, shape (n,)
        The stream's own time stamps [s].
    warnings : tuple of str
        What the reader found.
    size : tuple of int
        Width and height of the picture in px.
    """

    bodies: dict[str, BodySightings]
    disc: Floats | None
    pts_time: Floats
    warnings: tuple[str, ...]
    size: tuple[int, int]


class _Pass:
    def __init__(self, scene: Scene, samples: Samples) -> None:
        keep_out = 1.25 * scene.disc.radius + 1.0 if scene.disc else 0.0
        self.bodies = {
            b: BodyWatch(b, scene.of(b), samples, scene.centre, keep_out, BATCH) for b in scene.bodies
        }
        self.disc = DiscWindow(scene.disc, BATCH) if scene.disc else None
        self.centre = scene.centre
        self.size = samples.size
        self.filled = 0
        self._parts: dict[str, list[tuple[Floats, dict[str, Sightings]]]] = {b: [] for b in self.bodies}
        self._centres: list[Floats] = []

    def digest(self, advance: Integers) -> None:
        if not self.filled:
            return
        casing: Floats | None = None
        for name, body in self.bodies.items():
            self._parts[name].append(body.digest(self.filled, advance, casing))
            if name == "casing":
                casing = self._parts[name][-1][0]
        if self.disc is not None:
            self._centres.append(self.disc.centres(self.filled))
            self._move(self._centres[-1])
        self.filled = 0

    def _move(self, centres: Floats) -> None:
        recent = centres[np.isfinite(centres).all(axis=1)][-32:]
        if len(recent) < 8:
            return
        x, y = np.median(recent, axis=0)
        if np.hypot(x - self.centre[0], y - self.centre[1]) > _MOVE:
            self.centre = (float(x), float(y))
            for body in self.bodies.values():
                body.aim(self.centre)

    def result(self, reader: Reader) -> Watched:
        bodies = {}
        for name, parts in self._parts.items():
            markers = {m: Sightings.joined([part[1][m] for part in parts]) for m in parts[0][1]}
            bodies[name] = BodySightings(np.concatenate([part[0] for part in parts]), markers)
        disc = np.concatenate(self._centres) if self._centres else None
        return Watched(bodies, disc, reader.pts_seconds(), reader.warnings, self.size)


class _Advance:
    """How many frames of the camera lie between frames of the film, by the stamps of the whole film."""

    def __init__(self, stamps: Floats) -> None:
        self._stamps = stamps
        numbers = frame_numbers(stamps)
        self._next = np.append(np.diff(numbers), 1) if len(numbers) else np.ones(1, dtype=np.int64)

    def steps(self, pts: Floats) -> Integers:
        """Return the step from each frame with these stamps to the next, (n,)."""
        if not len(self._stamps) or not np.isfinite(pts).all():
            return np.ones(len(pts), dtype=np.int64)
        place = np.searchsorted(self._stamps, pts - 1e-7)
        return np.asarray(self._next[np.clip(place, 0, len(self._next) - 1)], dtype=np.int64)


def watch(path: Path, scene: Scene, samples: Samples, threads: int, progress: Progress | None) -> Watched:
    """Read a film once, from its first frame to its last, and measure everything in it."""
    work = _Pass(scene, samples)
    clock = _Advance(read_stamps(path))
    with Reader(path, threads) as reader:
        total = reader.info.frames_declared or None
        for frame in reader:
            if work.filled == 0 and work.disc is not None:
                work.disc.aim(work.centre, frame)
            for body in work.bodies.values():
                body.take(frame, work.filled)
            if work.disc is not None:
                work.disc.take(frame, work.filled)
            work.filled += 1
            if work.filled == BATCH:
                work.digest(clock.steps(reader.pts_seconds()[-work.filled :]))
                if progress is not None:
                    progress(reader.decoded, total)
        work.digest(clock.steps(reader.pts_seconds()[-work.filled :]))
        if progress is not None:
            progress(reader.decoded, total)
        return work.result(reader)
