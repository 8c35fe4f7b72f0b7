"""One pass through a film: every frame unrolled, every batch measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gyrotrack.angles.body_watch import BodyWatch
from gyrotrack.angles.prediction import LEAST_SCATTER
from gyrotrack.angles.sightings import Sightings
from gyrotrack.geometry.disc import DiscWindow
from gyrotrack.geometry.samples import Samples
from gyrotrack.geometry.scene import Scene
from gyrotrack.pipeline.notes import Notes, Rows
from gyrotrack.pipeline.timing import FrameTimes, Timing
from gyrotrack.video import Frame, Reader, Repeats, read_packets

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Progress = Callable[[int, int | None], None]

BATCH = 512
HOLD = 64
"""Frames that are kept at a time, so that a body that is not where it was predicted can be searched in them."""
HELD_BYTES = 64_000_000
SLOW = 3.0 * LEAST_SCATTER
"""Step in rad of the fastest body up to which frames that look alike are not taken for repeated ones."""
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
    times : FrameTimes
        When the frames were taken.
    again : ndarray of bool, shape (n,)
        Which frames seem to repeat the one before them.
    warnings : tuple of str
        What the reader found.
    size : tuple of int
        Width and height of the picture in px.
    """

    bodies: dict[str, BodySightings]
    disc: Floats | None
    pts_time: Floats
    times: FrameTimes
    warnings: tuple[str, ...]
    size: tuple[int, int]
    again: Mask


class Tracker:
    """Everything that is watched; its attributes are all that a later process needs to go on."""

    def __init__(self, scene: Scene, samples: Samples) -> None:
        keep_out = 1.25 * scene.disc.radius + 1.0 if scene.disc else 0.0
        self.bodies = {
            b: BodyWatch(b, scene.of(b), samples, scene.centre, keep_out, BATCH) for b in scene.bodies
        }
        self.disc = DiscWindow(scene.disc, BATCH) if scene.disc else None
        self.centre = scene.centre
        self.size = samples.size
        self.filled = 0

        self.held: list[Frame] = []
        self.steps: list[float] = []
        self.again = np.zeros(BATCH, dtype=np.bool_)
        self.repeats: Repeats | None = None
        self.owed = 0.0
        self.hold = int(np.clip(HELD_BYTES // (1.5 * samples.frames[0].y.size), 8, HOLD))

    @property
    def full(self) -> bool:
        """Whether enough frames are held to take them in."""
        return len(self.held) == min(self.hold, BATCH - self.filled)

    def keep(self, frame: Frame, step: float, *, stamped: bool) -> None:
        """Keep the next frame of the film until enough of them are held.

        `step` counts the camera's frames from the one before. A frame that repeats that one shows the same moment, and
        its step is owed by the next one: it stands in the place of a missing frame, unless such frames come regularly
        in a film that is not timed by its stamps (`stamped`). Where hardly anything turns all pictures are alike.
        """
        again = self.repeats is not None and self.repeats.same(frame)
        again = again and max(body.step for body in self.bodies.values()) > SLOW
        inserted = self.repeats is not None and self.repeats.regular and not stamped
        self.again[self.filled + len(self.held)] = again
        self.held.append(frame)
        self.steps.append(0.0 if again else step + self.owed)
        self.owed = self.owed + step if again and not inserted else 0.0

    def take(self) -> None:
        """Take in the frames that are held."""
        advance = np.array(self.steps)
        if self.filled == 0 and self.disc is not None:
            self.disc.aim(self.centre, self.held[0])
        for body in self.bodies.values():
            body.take(self.held, self.filled, advance)
        if self.disc is not None:
            self.disc.take(self.held, self.filled)
        self.filled += len(self.held)
        self.held.clear()
        self.steps.clear()

    def digest(self) -> Rows:
        """Measure the frames taken since the last time; one row a frame of every quantity."""
        rows: Rows = {"again": self.again[: self.filled].copy()}
        if self.repeats is not None:
            self.repeats.settle()
        casing: Floats | None = None
        for name, body in self.bodies.items():
            coarse, markers = body.digest(self.filled, casing)
            rows[f"{name}/coarse"] = coarse
            for marker, seen in markers.items():
                rows |= {f"{name}/{marker}/{f.name}": getattr(seen, f.name) for f in fields(Sightings)}
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
            for body in self.bodies.values():
                body.aim(self.centre)


class _Advance:
    """How many usual periods lie between frames of the film, by the stamps of the whole film."""

    def __init__(self, stamps: npt.NDArray[np.int64], time_base: float, timing: Timing) -> None:
        times = timing.of(np.asarray(stamps * time_base, dtype=np.float64), time_base)
        self.stamped = times.place is not None
        steps = np.diff(times.places)
        steps /= np.median(steps) if len(steps) else 1.0
        odd = np.flatnonzero(steps != 1.0)
        self._odd: dict[int | None, float] = dict(
            zip(stamps[odd + 1].tolist(), steps[odd].tolist(), strict=True)
        )

    def step(self, frame: Frame) -> float:
        """Return the step to a frame from the one before it; 0 to the first one of the film."""
        return self._odd.get(frame.pts, 1.0) if frame.index else 0.0


def watch(
    path: Path,
    scene: Scene,
    work: Tracker,
    threads: int,
    progress: Progress | None,
    timing: Timing,
    notes: Notes | None = None,
) -> Watched:
    """Read a film once, from its first frame to its last, and measure everything in it.

    Parameters
    ----------
    work : Tracker
        New, of this scene.
    timing : Timing
        Where the times of the frames are from.
    notes : Notes, optional
        Keeps what was measured, and goes on with what an earlier process has put there; memory, if not given.
    """
    notes = notes or Notes()
    packets = read_packets(path)
    work.repeats = Repeats(packets)
    with Reader(path, threads) as reader:
        tick = float(reader.info.time_base)
        clock = _Advance(packets.stamps, tick, timing)
        total = max(reader.info.frames_declared, len(packets.stamps)) or None
        frames = notes.take_up(work, reader)
        if progress is not None and reader.decoded:
            progress(reader.decoded, total)
        for frame in frames:
            work.keep(frame, clock.step(frame), stamped=clock.stamped)
            if work.full:
                work.take()
            if work.filled == BATCH:
                notes.add(work.digest(), work, reader, frame)
                if progress is not None:
                    progress(reader.decoded, total)
        if work.held:
            work.take()
        if work.filled:
            notes.add(work.digest(), work, reader, frame, end=True)
        if progress is not None:
            progress(reader.decoded, total)
        times = timing.of(reader.pts_seconds(), tick)
        return _watched(scene, work.size, reader, times, notes.rows(reader.decoded))


def _watched(scene: Scene, size: tuple[int, int], reader: Reader, times: FrameTimes, rows: Rows) -> Watched:
    bodies = {}
    for name in scene.bodies:
        markers = {
            paper.name: Sightings(
                **{f.name: rows.pop(f"{name}/{paper.name}/{f.name}") for f in fields(Sightings)}
            )
            for paper in scene.of(name)
        }
        bodies[name] = BodySightings(rows.pop(f"{name}/coarse"), markers)
    return Watched(
        bodies,
        rows.get("disc"),
        reader.pts_seconds(),
        times,
        reader.warnings,
        size,
        rows["again"],
    )
