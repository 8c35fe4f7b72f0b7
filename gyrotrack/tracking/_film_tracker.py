"""The tracker of a film: every frame is unrolled, every batch of frames is measured.

The allocator of glibc retains freed memory, and its heap becomes fragmented by frames that are allocated and freed.
`release_memory` returns it to the system after many frames.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from gyrotrack.tracking._association import LEAST_SCATTER
from gyrotrack.tracking._body_tracker import BodyTracker
from gyrotrack.tracking._hub import DiscWindow
from gyrotrack.tracking._marker_window import AngleMap
from gyrotrack.tracking._observations import MarkerObservations
from gyrotrack.tracking._scene import Samples, Scene
from gyrotrack.video._container import Frame
from gyrotrack.video._decoder import RepeatDetector
from gyrotrack.video._time_base import FrameTimes


def release_memory() -> None:
    """Return freed memory to the system."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # another libc than glibc
            ctypes.CDLL(None).malloc_trim(0)


Rows = dict[str, npt.NDArray[Any]]

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Progress = Callable[[int, int | None], None]

BATCH = 512
HOLD = 64
"""Frames in memory at a time, in which a body that is not found at its prediction is searched."""
HELD_BYTES = 64_000_000
SLOW = 3.0 * LEAST_SCATTER
"""Smallest step of the fastest body [rad] for which equal frames count as repeated."""
_MOVE = 0.6
"""Distance of the disc from the centre of the rings [px] beyond which the rings are moved."""


@dataclass(frozen=True)
class BodyObservations:
    """One body in all frames: unwrapped coarse angle as seen [rad], NaN where the body is lost; its markers."""

    coarse: Floats
    markers: dict[str, MarkerObservations]


@dataclass(frozen=True)
class FilmObservations:
    """Observations of one pass through a film.

    Attributes
    ----------
    bodies : dict of BodyObservations
        By name.
    disc : ndarray, shape (n, 2), or None
        The disc's centre in every frame [px].
    pts_time : ndarray, shape (n,)
        The stream's own timestamps [s].
    times : FrameTimes
        Times of the frames.
    again : ndarray of bool, shape (n,)
        Frames that seem to repeat the previous one.
    warnings : tuple of str
        Warnings of the reader.
    size : tuple of int
        Width and height of the picture in px.
    """

    bodies: dict[str, BodyObservations]
    disc: Floats | None
    pts_time: Floats
    times: FrameTimes
    warnings: tuple[str, ...]
    size: tuple[int, int]
    again: Mask


class FilmTracker:
    """Tracker of all bodies in a film.

    A new tracker depends on the scene alone; copies of it track parts of the film in parallel processes.
    """

    def __init__(self, scene: Scene, samples: Samples) -> None:
        keep_out = 1.25 * scene.disc.radius + 1.0 if scene.disc else 0.0
        self.bodies = {
            b: BodyTracker(
                b,
                scene.of(b),
                samples,
                scene.axis(b),
                keep_out + float(np.hypot(*scene.offsets.get(b, (0.0, 0.0)))),
                BATCH,
                scene.offsets.get(b, (0.0, 0.0)),
            )
            for b in scene.bodies
        }
        self.disc = DiscWindow(scene.disc, BATCH) if scene.disc else None
        self.centre = scene.centre
        self._offsets = {b: scene.offsets.get(b, (0.0, 0.0)) for b in scene.bodies}
        self.size = samples.size
        self.filled = 0
        self._new = True
        self.held: list[Frame] = []
        self.steps: list[float] = []
        self.again = np.zeros(BATCH, dtype=np.bool_)
        self.repeats: RepeatDetector | None = None
        self.pending_step = 0.0
        self.hold = int(np.clip(HELD_BYTES // (1.5 * samples.frames[0].y.size), 8, HOLD))

    @property
    def maps(self) -> list[AngleMap]:
        """Learnt maps of illumination and occlusion, which are common to the whole film."""
        return [angle_map for body in self.bodies.values() for angle_map in body.maps]

    @property
    def full(self) -> bool:
        """Whether enough frames are held to be tracked."""
        return len(self.held) == min(self.hold, BATCH - self.filled)

    def keep(self, frame: Frame, step: float, *, stamped: bool) -> None:
        """Hold the next frame of the film until enough of them are held.

        `step` is the time from the previous frame in periods of the camera. A frame that repeats the previous one shows
        the same moment; its step is added to that of the next frame, because it replaces a missing frame, unless
        repeated frames are regular in a film that is not timed by its stamps (`stamped`). Frames are not compared while
        hardly anything turns.
        """
        again = self.repeats is not None and self.repeats.same(frame)
        again = again and max(body.step for body in self.bodies.values()) > SLOW
        inserted = self.repeats is not None and self.repeats.regular and not stamped
        self.again[self.filled + len(self.held)] = again
        self.held.append(frame)
        self.steps.append(0.0 if again else step + self.pending_step)
        self.pending_step = self.pending_step + step if again and not inserted else 0.0

    def take(self) -> None:
        """Track the bodies in the held frames, and store the windows of their markers."""
        advance = np.array(self.steps)
        if self.filled == 0 and self.disc is not None:
            self.disc.centre_on(self.centre, self.held[0])
            if self._new:  # the hub may have moved since the samples of the scene
                self.disc.take(self.held, 0)
                self._move(self.disc.centres(len(self.held)))
        self._new = False
        for body in self.bodies.values():
            body.take(self.held, self.filled, advance)
        if self.disc is not None:
            self.disc.take(self.held, self.filled)
        self.filled += len(self.held)
        self.held.clear()
        self.steps.clear()

    def measure_batch(self) -> Rows:
        """Measure the frames stored since the last call; one row per frame of every quantity."""
        rows: Rows = {"again": self.again[: self.filled].copy()}
        if self.repeats is not None:
            self.repeats.copy_last()
        casing: Floats | None = None
        for name, body in self.bodies.items():
            coarse, markers = body.measure_batch(self.filled, casing)
            rows[f"{name}/coarse"] = coarse
            for marker, seen in markers.items():
                rows |= {
                    f"{name}/{marker}/{f.name}": getattr(seen, f.name) for f in fields(MarkerObservations)
                }
            if name == "casing":
                casing = coarse
        if self.disc is not None:
            rows["disc"] = self.disc.centres(self.filled)
            self._move(rows["disc"])
        self.filled = 0
        return rows

    def _move(self, centres: Floats) -> None:
        recent = centres[np.isfinite(centres).all(axis=1)][-32:]
        if len(recent) < 8:
            return
        x, y = np.median(recent, axis=0)
        if np.hypot(x - self.centre[0], y - self.centre[1]) > _MOVE:
            self.centre = (float(x), float(y))
            for name, body in self.bodies.items():
                dx, dy = self._offsets[name]
                body.centre_on((self.centre[0] + dx, self.centre[1] + dy))
