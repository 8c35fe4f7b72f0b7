"""One pass through a film: every frame unrolled, every batch measured, checkpoints written.

The allocator of glibc keeps what is freed for later, and frames of some size that came and went leave it with a heap
full of holes. At the few places where much is done with, it is asked to give back what it can; elsewhere nothing is
done.

An object is rebuilt from the film and the profile in the same way every time; its memento holds what has changed
in it since. Only numbers, arrays, and a few frozen records are taken and put back, each by the path of attributes
that leads to it (``bodies.casing._motion``); nothing in a memento is ever run.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, is_dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gyrotrack._column_store import new_columns, set_down
from gyrotrack._errors import VideoError
from gyrotrack.io._checkpoint import CheckpointFile
from gyrotrack.tracking._association import LEAST_SCATTER, Motion
from gyrotrack.tracking._body_tracker import BodyTracker
from gyrotrack.tracking._hub import DiscWindow
from gyrotrack.tracking._observations import MarkerObservations
from gyrotrack.tracking._polar import Ring
from gyrotrack.tracking._scene import Samples, Scene
from gyrotrack.video._container import Frame, read_packets
from gyrotrack.video._decoder import Mark, Reader
from gyrotrack.video._frames import RepeatDetector
from gyrotrack.video._time_base import FrameTimes, Timing


def release_memory() -> None:
    """Give back to the system what was freed."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # another libc than glibc
            ctypes.CDLL(None).malloc_trim(0)


_RECORDS = {kind.__name__: kind for kind in (Motion, Ring)}
BUFFERS = frozenset({
    "windows", "starts", "held", "steps", "again", "_grid", "_score", "_under", "_coarse", "_pixels"
})  # fmt: skip
"""Attributes that hold the batch at hand, which means nothing between batches, or follow from others."""


@dataclass(frozen=True)
class Checkpoint:
    """Values by path, as JSON holds them, and arrays by path."""

    values: dict[str, Any]
    arrays: dict[str, npt.NDArray[Any]]

    def since(self, start: Checkpoint) -> Checkpoint:
        """Return only what differs from an earlier memento."""
        same = {k for k, a in self.arrays.items() if k in start.arrays and _equal(a, start.arrays[k])}
        values = {k: v for k, v in self.values.items() if k not in start.values or start.values[k] != v}
        return Checkpoint(values, {k: a for k, a in self.arrays.items() if k not in same})


def take(thing: Any) -> Checkpoint:
    """Take the memento of an object and of all that belongs to it.

    Raises
    ------
    TypeError
        An attribute is of a kind that cannot be put back.
    """
    memento = Checkpoint({}, {})
    for path, _, _, value in _leaves(thing):
        if isinstance(value, np.ndarray):
            memento.arrays[path] = value.copy()
        else:
            memento.values[path] = _as_json(path, value)
    return memento


def restore(thing: Any, memento: Checkpoint) -> None:
    """Give an object, new from the same film and profile, the state that a memento holds.

    Raises
    ------
    TypeError
        The memento holds something that the object has no place for.
    """
    left = {*memento.arrays, *memento.values}
    for path, owner, name, _ in list(_leaves(thing)):
        if path in memento.arrays:
            _set(owner, name, memento.arrays[path].copy())
        elif path in memento.values:
            _set(owner, name, _from_json(memento.values[path]))
        left.discard(path)
    if left:
        raise TypeError(f"there is no place for {min(left)}")


def _leaves(thing: Any) -> Iterator[tuple[str, Any, Any, Any]]:
    """Yield (path, owner, name, value) of all numbers, arrays and records below an object, each once."""
    seen: set[int] = set()
    waiting = [("", thing)]
    while waiting:
        path, owner = waiting.pop()
        if id(owner) in seen:
            continue
        seen.add(id(owner))
        for name, value in _members(owner):
            below = f"{path}.{name}" if path else str(name)
            if _is_leaf(value):
                yield below, owner, name, value
            else:
                waiting.append((below, value))


def _members(owner: Any) -> list[tuple[Any, Any]]:
    if isinstance(owner, Mapping):
        return list(owner.items())
    if isinstance(owner, list | tuple):
        return list(enumerate(owner))
    if is_dataclass(owner):
        return []  # all of these are frozen: made once, never changed
    return [(name, value) for name, value in vars(owner).items() if not _passing(owner, name)]


def _passing(owner: Any, name: str) -> bool:
    return name in BUFFERS or isinstance(getattr(type(owner), name, None), cached_property)


def _is_leaf(value: Any) -> bool:
    if value is None or isinstance(value, bool | int | float | str | np.ndarray | np.generic):
        return True
    if isinstance(value, tuple):
        return all(_is_leaf(v) and not isinstance(v, np.ndarray) for v in value)
    return type(value).__name__ in _RECORDS


def _as_json(path: str, value: Any) -> Any:
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, tuple):
        return {"tuple": [_as_json(path, v) for v in value]}
    kind = type(value).__name__
    if kind in _RECORDS:
        return {"record": kind, "fields": [_as_json(path, getattr(value, f.name)) for f in fields(value)]}
    raise TypeError(f"{path} is a {kind}, which a checkpoint cannot store")


def _from_json(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    if "tuple" in value:
        return tuple(_from_json(v) for v in value["tuple"])
    return _RECORDS[value["record"]](*(_from_json(v) for v in value["fields"]))


def _set(owner: Any, name: Any, value: Any) -> None:
    if isinstance(owner, dict | list):
        owner[name] = value
    elif not isinstance(owner, tuple):
        setattr(owner, name, value)


def _equal(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> bool:
    return a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes()


Rows = dict[str, npt.NDArray[Any]]

BATCHES = 2
"""Batches in a record of the journal: a kill costs at most the work on these."""
_STATE, _STAMPS = "state:", "stamps"


def frames_done(journal: CheckpointFile) -> int:
    """Return how many frames an unfinished run has done, as its journal says."""
    last = 0
    for record in journal.records():
        last = int(record.facts["mark"]["decoded"])
    return last


class ObservationLog:
    """Rows of a pass, batch by batch, and with a journal the state of the tracker now and then.

    Parameters
    ----------
    journal : Checkpoint, optional
        Where to keep them; without it they are kept in memory.
    """

    def __init__(self, journal: CheckpointFile | None = None) -> None:
        self._journal = journal
        self._waiting: list[Rows] = []
        self._start = Checkpoint({}, {})
        self._saved = 0

    def resume(self, work: Any, reader: Reader) -> Iterator[Frame]:
        """Bring a new tracker to where the journal ends, and return the frames that follow.

        A journal whose last frame the film does not show any more is started anew.
        """
        if self._journal is None:
            return iter(reader)
        self._start = take(work)
        stamps, last = [], None
        for last in self._journal.records():
            stamps += last.arrays[_STAMPS].tolist()
        if last is None:
            return iter(reader)
        mark = Mark(**last.facts["mark"])
        frames = reader.after(mark, stamps)
        if frames is None:
            self._journal.restart()
            reader.rewind()
            return iter(reader)
        state = {n.removeprefix(_STATE): a for n, a in last.arrays.items() if n.startswith(_STATE)}
        restore(work, Checkpoint(last.facts["values"], state))
        self._saved = mark.decoded
        return frames

    def add(self, rows: Rows, work: Any, reader: Reader, last: Frame, *, end: bool = False) -> None:
        """Keep the rows of a batch, which ends with the frame `last`; at the `end` of the film all at once."""
        self._waiting.append(rows)
        if self._journal is None or (len(self._waiting) < BATCHES and not end):
            return
        now = take(work).since(self._start)
        arrays = {name: np.concatenate([batch[name] for batch in self._waiting]) for name in rows}
        arrays |= {_STATE + name: value for name, value in now.arrays.items()}
        arrays[_STAMPS] = reader.stamps[self._saved :]
        self._journal.append({"mark": asdict(reader.mark(last)), "values": now.values}, arrays)
        self._waiting, self._saved = [], reader.decoded

    def rows(self, count: int) -> Rows:
        """Return all `count` rows of every quantity, as long columns that are out of the way."""
        out: Rows = {}
        place = 0
        for part in self._parts():
            if not out:
                out = new_columns(count, {name: (v.shape[1:], v.dtype) for name, v in part.items()})
            size = len(next(iter(part.values())))
            for name, values in part.items():
                out[name][place : place + size] = values
            place += size
            set_down()
        return out

    def _parts(self) -> Iterator[Rows]:
        if self._journal is not None:
            for record in self._journal.records():
                arrays = record.arrays
                yield {n: a for n, a in arrays.items() if n != _STAMPS and not n.startswith(_STATE)}
        yield from self._waiting


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
class BodyObservations:
    """One body in all frames: unwrapped coarse angle as seen [rad], NaN where it was lost; its markers."""

    coarse: Floats
    markers: dict[str, MarkerObservations]


@dataclass(frozen=True)
class FilmObservations:
    """All that one pass gives.

    Attributes
    ----------
    bodies : dict of BodyObservations
        By name.
    disc : ndarray, shape (n, 2), or None
        The disc's centre in every frame [px].
    pts_time : ndarray, shape (n,)
        The stream's own timestamps [s].
    times : FrameTimes
        When the frames were taken.
    again : ndarray of bool, shape (n,)
        Which frames seem to repeat the one before them.
    warnings : tuple of str
        What the reader found.
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
    """Everything that is watched; its attributes are all that a later process needs to go on."""

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

        self.held: list[Frame] = []
        self.steps: list[float] = []
        self.again = np.zeros(BATCH, dtype=np.bool_)
        self.repeats: RepeatDetector | None = None
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
                body.aim((self.centre[0] + dx, self.centre[1] + dy))


class _Advance:
    """How many usual periods lie between frames of the film, by the stamps of the whole film."""

    def __init__(self, stamps: npt.NDArray[np.int64], time_base: float, timing: Timing) -> None:
        times = timing.of(np.asarray(stamps * time_base, dtype=np.float64), time_base)
        self.stamped = times.place is not None
        steps = np.diff(times.places)
        steps /= np.median(steps) if len(steps) else 1.0
        misfit_excess = np.flatnonzero(steps != 1.0)
        self._odd: dict[int | None, float] = dict(
            zip(stamps[misfit_excess + 1].tolist(), steps[misfit_excess].tolist(), strict=True)
        )

    def step(self, frame: Frame) -> float:
        """Return the step to a frame from the one before it; 0 to the first one of the film."""
        return self._odd.get(frame.pts, 1.0) if frame.index else 0.0


def track_film(
    path: Path,
    scene: Scene,
    work: FilmTracker,
    threads: int,
    progress: Progress | None,
    timing: Timing,
    notes: ObservationLog | None = None,
) -> FilmObservations:
    """Read a film once, from its first frame to its last, and measure everything in it.

    Parameters
    ----------
    work : FilmTracker
        New, of this scene.
    timing : Timing
        Where the times of the frames are from.
    notes : ObservationLog, optional
        Keeps what was measured, and goes on with what an earlier process has put there; memory, if not given.
    """
    notes = notes or ObservationLog()
    packets = read_packets(path)
    work.repeats = RepeatDetector(packets)
    with Reader(path, threads) as reader:
        tick = float(reader.info.time_base)
        clock = _Advance(packets.stamps, tick, timing)
        total = max(reader.info.frames_declared, len(packets.stamps)) or None
        frames = notes.resume(work, reader)
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
        if not reader.decoded:
            raise VideoError(
                f"No frame of {path} could be decoded.",
                "Check the limits of threads and memory (`ulimit -u`, `ulimit -v`).",
            )
        times = timing.of(reader.pts_seconds(), tick)
        return _watched(scene, work.size, reader, times, notes.rows(reader.decoded))


def _watched(
    scene: Scene, size: tuple[int, int], reader: Reader, times: FrameTimes, rows: Rows
) -> FilmObservations:
    bodies = {}
    for name in scene.bodies:
        markers = {
            marker.name: MarkerObservations(
                **{f.name: rows.pop(f"{name}/{marker.name}/{f.name}") for f in fields(MarkerObservations)}
            )
            for marker in scene.of(name)
        }
        bodies[name] = BodyObservations(rows.pop(f"{name}/coarse"), markers)
    return FilmObservations(
        bodies,
        rows.get("disc"),
        reader.pts_seconds(),
        times,
        reader.warnings,
        size,
        rows["again"],
    )
