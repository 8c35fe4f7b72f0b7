"""One pass through a film, part by part, in several processes.

A film is split at key frames into parts that depend on the film alone. Maps of illumination and occlusion are common to
the whole film. Maps from one part alone would be based on fewer passages of the markers, and the angles would be less
precise. The maps are learnt from the first frames of some parts. The windows about the markers in these frames are
stored in a temporary file. They are later measured with the maps of all these parts, and the frames are not decoded
again. Each part is tracked by a copy of the tracker with these maps. Templates and motion are learnt within the part,
so that the result does not depend on the number of processes.

A part extends by `OVERLAP` frames into the next part. These frames determine the number of turns between the unwrapped
angles of the two parts. The measurements of these frames are taken from the earlier part, which already has templates.
"""

from __future__ import annotations

import os
import pickle
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, fields, replace
from multiprocessing import get_context
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from threading import Lock
from types import TracebackType
from typing import Any, Self, TypeVar

import numpy as np

from fitting._workers import WorkerPool, available_cores
from gyrotrack._arrays import Bools, Floats, Integers
from gyrotrack._column_store import large_blocks_returned, new_columns, release_memory, release_pages
from gyrotrack._errors import VideoError
from gyrotrack._smoothing import median_of
from gyrotrack.io._atomic import CheckpointFile, Record
from gyrotrack.io._scratch import scratch_folder
from gyrotrack.tracking import _film_tracker
from gyrotrack.tracking._film_tracker import (
    BodyObservations,
    FilmObservations,
    FilmTracker,
    Progress,
    Rows,
)
from gyrotrack.tracking._live_angles import Sink, current_sink, report_angles, set_sink
from gyrotrack.tracking._marker_tracker import MarkerObservations
from gyrotrack.tracking._marker_window import AngleMap
from gyrotrack.tracking._profile import single_threaded
from gyrotrack.tracking._scene import Scene
from gyrotrack.tracking._texture import TextureObservations
from gyrotrack.video._container import ClipInfo, Frame, Packets, probe, read_packets
from gyrotrack.video._decoder import Part, Reader, RepeatDetector, film_warnings, pts_seconds
from gyrotrack.video._time_base import Timing

T = TypeVar("T")

PART = 2500
"""Largest number of frames of a part; a part may be longer by the distance between two key frames [frames]. Chosen: a
larger number leaves few parts for processes; a smaller one learns templates from less data."""
LEAST_PART = 400
"""Smallest number of frames of a part [frames]. Chosen: enough for illumination and templates; a smaller number gives
noisy templates, a larger one leaves few parts."""
OVERLAP = 64
"""Number of frames that two neighbouring parts share [frames]. Chosen: a smaller number leaves the turns between parts
uncertain, a larger one costs time because these frames are tracked twice."""
LEARNT = 256
"""The maps of illumination and occlusion need at least this number of frames at the beginning of a part [frames].
Chosen: a smaller number gives noisy maps, a larger one delays the start."""
MOST_LEARNT = 8
"""The maps of illumination and occlusion use the beginnings of at most this number of parts [1]. Chosen: the cost does
not grow with the film; a larger number costs time, a smaller one gives noisier maps."""
_RATE = 24
"""Number of frames on either side of a gap between parts; their mean speed extrapolates the angle over the gap
[frames]. Chosen: a smaller number gives a noisy speed, a larger one includes a change of the speed."""
_STAMPS = "stamps"


def split(packets: Packets) -> tuple[Part, ...]:
    """Return the parts of a film in order: an even number, or one part if the film is short or has no timestamps.

    Each part ends `OVERLAP` frames after the first key frame of the next part.
    """
    stamps, count = packets.stamps, len(packets.stamps)
    number = 2 * -(-count // (2 * PART))
    if not (packets.complete and packets.exact) or count < 2 * LEAST_PART or (np.diff(stamps) <= 0).any():
        return (Part(),)
    keys = np.flatnonzero(packets.key)
    wanted = np.arange(1, number) * count / number
    near = [int(keys[np.argmin(np.abs(keys - at))]) for at in wanted] if len(keys) else []
    starts = [0]
    for key in near:
        if key - starts[-1] >= LEAST_PART and count - key >= LEAST_PART:
            starts.append(key)
    ends = [int(stamps[key + OVERLAP]) for key in starts[1:]]
    begins = [int(stamps[key]) for key in starts[1:]]
    return tuple(map(Part, starts, (None, *begins), (*ends, None)))


@dataclass(frozen=True)
class Film:
    """Data with which a process tracks a part of a film."""

    info: ClipInfo  # the film
    packets: Packets  # its packets
    timing: Timing  # time base of the film
    tracker: bytes  # pickled tracker of the scene, before the first frame
    folder: Path  # folder for the stored beginnings of parts
    learnt: tuple[int, ...] = ()  # first frames of the parts from which the maps are learnt
    maps: tuple[AngleMap, ...] = ()  # learnt maps of illumination and occlusion


@dataclass(frozen=True)
class PartRows:
    """Result of one part: rows and timestamps of its frames, numbers of damaged packets and of damaged frames."""

    rows: Rows
    stamps: Integers
    bad_packets: int
    corrupt: int


@dataclass(frozen=True)
class _Beginning:
    """A tracker that has stored the first frames of a part, up to a key frame, and learnt its maps from them."""

    tracker: FilmTracker
    # timestamps of these frames, numbers of damaged packets and of damaged frames
    stamps: Integers
    bad_packets: int = 0
    corrupt: int = 0


class _Advance:
    """Time between frames in units of its median, from the timestamps of the whole film."""

    def __init__(self, stamps: Integers, time_base: float, timing: Timing) -> None:
        times = timing.of(np.asarray(stamps * time_base, dtype=np.float64), time_base)
        self.stamped = times.place is not None
        steps = np.diff(times.places)
        steps /= np.median(steps) if len(steps) else 1.0
        odd = np.flatnonzero(steps != 1.0)
        self._odd: dict[int | None, float] = dict(
            zip(stamps[odd + 1].tolist(), steps[odd].tolist(), strict=True)
        )

    def step(self, frame: Frame) -> float:
        """Return the step from the previous frame to a frame; 0 for the first frame of the film."""
        return self._odd.get(frame.pts, 1.0) if frame.index else 0.0


def track_part(film: Film, part: Part, threads: int, count: Callable[[int], None]) -> PartRows:
    """Track one part of a film; `count` is called with the number of frames of each finished batch."""
    with single_threaded():
        new: FilmTracker = pickle.loads(film.tracker)  # noqa: S301 - made by this process or its parent
        begun, rest = _Beginning(new, np.zeros(0, dtype=np.int64)), part
        key = _second_start(film.packets, part)
        if part.first in film.learnt and key is not None:
            begun = _stored(film, part) or _begin(film, part, threads)
            rest = replace(part, first=key, start=int(film.packets.stamps[key]))
        work, batches = begun.tracker, []
        for own, common in zip(work.maps, film.maps, strict=False):
            own.replace(common)
        with Reader(film.info.path, threads, rest, film.info) as reader:
            for _ in _taken(work, film, reader, part.first):
                batches.append(work.measure_batch())
                count(len(batches[-1]["again"]))
            rows = {n: np.concatenate([b[n] for b in batches]) for n in batches[0]} if batches else {}
            stamps = np.concatenate([begun.stamps, reader.stamps])
            bad, corrupt = begun.bad_packets + reader.bad_packets, begun.corrupt + reader.corrupt
            return PartRows(rows, stamps, bad, corrupt)


def learn_part(film: Film, part: Part, threads: int, _count: Callable[[int], None]) -> list[AngleMap]:
    """Return the maps of illumination and occlusion from the first frames of a part; store its beginning."""
    with single_threaded():
        begun = _begin(film, part, threads)
        # if the folder has no space, these frames are decoded again later
        with suppress(OSError), (film.folder / str(part.first)).open("wb") as file:
            pickle.dump(begun, file, protocol=pickle.HIGHEST_PROTOCOL)
    return begun.tracker.maps


def _second_start(packets: Packets, part: Part) -> int | None:
    """Return the last key frame at which the first batch of a part can end; None without such a key frame."""
    stop = len(packets.stamps) if part.stop is None else int(np.searchsorted(packets.stamps, part.stop))
    end = min(part.first + _film_tracker.BATCH, stop - 1)
    keys = part.first + LEARNT + np.flatnonzero(packets.key[part.first + LEARNT : end + 1])
    return int(keys[-1]) if len(keys) else None


def _begin(film: Film, part: Part, threads: int) -> _Beginning:
    """Store the first frames of a part in a new tracker, which learns its maps from these frames."""
    work: FilmTracker = pickle.loads(film.tracker)  # noqa: S301 - made by this process or its parent
    stamps = film.packets.stamps
    stop = _second_start(film.packets, part) or min(part.first + LEARNT, len(stamps) - 1)
    with Reader(film.info.path, threads, replace(part, stop=int(stamps[stop])), film.info) as reader:
        for _ in _taken(work, film, reader, part.first):
            pass
        if work.filled:
            work.learn_batch()
        return _Beginning(work, reader.stamps, reader.bad_packets, reader.corrupt)


def _stored(film: Film, part: Part) -> _Beginning | None:
    """Return the beginning of a part from its file, and remove the file; None without a file."""
    path = film.folder / str(part.first)
    with suppress(OSError, EOFError, pickle.UnpicklingError):
        with path.open("rb") as file:
            begun: _Beginning = pickle.load(file)  # noqa: S301 - made by this process or its parent
        path.unlink()
        return begun
    return None


def _taken(work: FilmTracker, film: Film, reader: Reader, part: int) -> Iterator[None]:
    """Feed the frames of a reader to a tracker; yield after each full batch, and at the end.

    `part` is the first frame of the part, which identifies the part in reports of angles.
    """
    clock = _Advance(film.packets.stamps, float(reader.info.time_base), film.timing)
    if work.filled == _film_tracker.BATCH:
        yield
    for frame in reader:
        work.keep(frame, clock.step(frame), stamped=clock.stamped)
        if work.full:
            _take(work, part)
        if work.filled == _film_tracker.BATCH:
            yield
    if work.held:
        _take(work, part)
    if work.filled:
        yield


def _take(work: FilmTracker, part: int) -> None:
    """Track the frames that a tracker has stored, and report the coarse angles of its bodies."""
    frames, place = np.array([frame.index for frame in work.held]), work.filled
    work.take()
    for name, body in work.bodies.items():
        report_angles(name, part, frames, body.coarse(place, len(frames)))


_done: Synchronized[int] | None = None


def _start_worker(done: Synchronized[int], sink: Sink | None) -> None:
    global _done
    _done = done
    set_sink(sink)


def _count(frames: int) -> None:
    if _done is not None:
        with _done.get_lock():
            _done.value += frames


Task = Callable[[Film, Part, int, Callable[[int], None]], T]


def _run_in_worker(task: Task[T], film: Film, part: Part) -> T:
    with large_blocks_returned():
        return _run(task, film, part, 1, _count)


def _run(task: Task[T], film: Film, part: Part, threads: int, count: Callable[[int], None]) -> T:
    found = task(film, part, threads, count)
    release_memory()  # the tracker and the frames of the part
    return found


class PartWorkers:
    """The processes that track parts of a film: `workers`, including the caller (default: one per core).

    A single part is tracked without a further process.
    """

    def __init__(self, path: Path, workers: int | None = None) -> None:
        self.packets = read_packets(path)
        self.parts = split(self.packets)
        self.count = min(workers or available_cores(), len(self.parts))
        self._done: Synchronized[int] | None = None
        self._pool = WorkerPool(0)
        if self.count > 1:
            with suppress(OSError, ImportError):  # no semaphores, or no memory for a process
                self._done = get_context("spawn").Value("q", 0)
                self._pool = WorkerPool(self.count - 1, _start_worker, (self._done, current_sink()))

    def __enter__(self) -> Self:
        self._pool.__enter__()
        for _ in range(self._pool.processes - 1):
            self._pool.begin(int)  # the processes then import their modules during the acquisition
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pool.__exit__(kind, value, trace)

    def run(
        self,
        task: Task[T],
        film: Film,
        todo: list[int],
        threads: int,
        progress: Progress | None = None,
        done: int = 0,
        total: int | None = None,
    ) -> Iterator[tuple[int, T]]:
        """Run ``task(film, part, threads, count)`` for parts `todo`, and yield (index, result); tasks call `count`."""
        waiting, futures, lock = deque(todo), dict[int, Future[T]](), Lock()
        own = 0

        def submit_next(previous: Future[T] | None = None) -> None:
            if previous is not None and (previous.cancelled() or previous.exception() is not None):
                return
            with lock:
                begun = (
                    self._pool.begin(_run_in_worker, task, film, self.parts[waiting[0]]) if waiting else None
                )
                if begun is None:
                    return
                futures[waiting.popleft()] = begun
            begun.add_done_callback(submit_next)

        def count(frames: int) -> None:
            nonlocal own
            own += frames
            report()

        def report() -> None:
            if progress is not None:
                others = self._done.value if self._done is not None else 0
                whole = done + own + others
                progress(min(whole, total) if total else whole, total)

        for _ in range(self._pool.processes if len(todo) > 1 else 0):
            submit_next()
        while True:
            with lock:
                if not waiting:
                    break
                index = waiting.pop()
            yield index, _run(task, film, self.parts[index], 1 if futures else threads, count)
        while futures:
            ready = [i for i, f in list(futures.items()) if f.done()]
            for index in ready:
                yield index, self._result(task, film, index, futures.pop(index), count)
            if not ready:
                try:
                    next(iter(futures.values())).exception(timeout=0.1)
                except TimeoutError:
                    report()

    def _result(
        self, task: Task[T], film: Film, index: int, future: Future[T], count: Callable[[int], None]
    ) -> T:
        try:
            return future.result()
        except BrokenProcessPool:  # a worker was killed, for example for lack of memory
            return _run(task, film, self.parts[index], 1, count)


@contextmanager
def _folder() -> Iterator[Path]:
    """Yield a folder for the beginnings of parts, or a path without a folder if none can be made."""
    with ExitStack() as stack:
        try:
            folder = stack.enter_context(scratch_folder())
        except OSError:  # no space: the beginnings are decoded again
            folder = Path(os.devnull) / "absent"
        yield folder


def frames_done(journal: CheckpointFile) -> int:
    """Return the number of frames that an unfinished run has tracked, according to its journal."""
    frames = (record.facts.get("frames") for record in journal.records())
    return sum(n for n in frames if isinstance(n, int))


def track_film(
    workers: PartWorkers,
    path: Path,
    scene: Scene,
    work: FilmTracker,
    threads: int,
    progress: Progress | None,
    timing: Timing,
    journal: CheckpointFile | None = None,
) -> FilmObservations:
    """Track all bodies in a film with a new tracker `work`; parts in the `journal` are not tracked again."""
    info, packets = probe(path), workers.packets
    total = max(info.frames_declared, len(packets.stamps)) or None
    kept = _PartResults(workers.parts, packets, journal, _columns(scene, work))
    done, number = kept.frames, len(workers.parts)
    if progress is not None and done:
        progress(done, total)
    kept.report(scene)
    with _folder() as folder:
        work.repeats = RepeatDetector(packets)
        tracker = pickle.dumps(work, protocol=pickle.HIGHEST_PROTOCOL)
        film = Film(info, packets, timing, tracker, folder)
        if kept.todo and number > 1:
            some = np.unique(np.linspace(0, number - 1, min(number, MOST_LEARNT)).astype(int)).tolist()
            learnt = dict(workers.run(learn_part, film, some, threads))
            for index in some:  # sums of floats depend on their order
                for own, other in zip(work.maps, learnt[index], strict=True):
                    own.add(other)
            first = tuple(workers.parts[index].first for index in some)
            film = replace(film, learnt=first, maps=tuple(work.maps))
        for index, found in workers.run(track_part, film, kept.todo, threads, progress, done, total):
            kept.add(index, found)
    if progress is not None:
        progress(kept.frames, total)
    if not kept.frames:
        what = f"No frame of {path} could be decoded."
        raise VideoError(what, "Check the limits of threads and memory (`ulimit -u`, `ulimit -v`).")
    rows = kept.rows(scene)
    stamps = np.asarray(rows.pop(_STAMPS))
    tick = float(info.time_base)
    seconds = pts_seconds(stamps, tick)
    bodies = {}
    for name in scene.bodies:
        markers = {
            marker.name: MarkerObservations(
                **{f.name: rows.pop(f"{name}/{marker.name}/{f.name}") for f in fields(MarkerObservations)}
            )
            for marker in scene.of(name)
        }
        rings = [
            TextureObservations(
                **{f.name: rows.pop(f"{name}/{kind}/{f.name}") for f in fields(TextureObservations)}
            )
            for kind in _film_tracker.RINGS
            if f"{name}/{kind}/angle" in rows
        ]
        bodies[name] = BodyObservations(rows.pop(f"{name}/coarse"), markers, *rings)
    times, warnings = timing.of(seconds, tick), film_warnings(info, seconds, *kept.damage)
    return FilmObservations(bodies, rows.get("disc"), seconds, times, warnings, work.size, rows["again"])


def _columns(scene: Scene, work: FilmTracker) -> dict[str, tuple[tuple[int, ...], str]]:
    """Return shape and type of one row (frame) of every quantity that is measured in a part."""
    found: dict[str, tuple[tuple[int, ...], str]] = {"again": ((), "|b1"), _STAMPS: ((), "<i8")}
    pairs = {"corner_angle", "corner_radius", "centre"}
    for name in scene.bodies:
        found[f"{name}/coarse"] = (), "<f8"
        for marker in scene.of(name):
            for f in fields(MarkerObservations):
                shape = (2,) if f.name in pairs else ()
                found[f"{name}/{marker.name}/{f.name}"] = shape, "|b1" if f.name == "open" else "<f8"
        for f in fields(TextureObservations) if name in work.textures else ():
            pair = f.name in {"centre", "first", "second"}
            for kind in _film_tracker.RINGS:
                found[f"{name}/{kind}/{f.name}"] = (2,) if pair else (), "<f8"
    return found | ({"disc": ((2,), "<f8")} if work.disc is not None else {})


class _PartResults:
    """Results of finished parts, in memory or in a journal, which is cleared if it does not match the film."""

    def __init__(
        self,
        parts: tuple[Part, ...],
        packets: Packets,
        journal: CheckpointFile | None,
        columns: Mapping[str, tuple[tuple[int, ...], str]],
    ) -> None:
        self._parts, self._packets, self._journal, self._columns = parts, packets, journal, columns
        self._memory: dict[int, PartRows] = {}
        self._facts: dict[int, dict[str, Any]] = {}
        self._place: dict[int, int] = {}
        for place, record in enumerate(journal.records() if journal is not None else ()):
            if journal is not None and not self._belongs(record):
                journal.restart()
                self._facts, self._place = {}, {}
                break
            index = record.facts["part"]
            self._facts[index], self._place[index] = record.facts, place

    def _belongs(self, record: Record) -> bool:
        """Return whether a record has the form of a part of this film; the file may be the journal of another film."""
        numbers = [record.facts.get(key) for key in ("part", "parts", "frames", "bad_packets", "corrupt")]
        if (
            not all(isinstance(n, int) and n >= 0 for n in numbers)
            or {name: (array.shape[1:], array.dtype.str) for name, array in record.arrays.items()}
            != self._columns
        ):
            return False
        part, stamps = record.facts["part"], record.arrays[_STAMPS]
        if record.facts["parts"] != len(self._parts) or part >= len(self._parts):
            return False
        if stamps.ndim != 1 or {array.shape[:1] for array in record.arrays.values()} != {stamps.shape}:
            return False
        known = bool(np.isin(stamps, self._packets.stamps).all()) if self._packets.complete else True
        return known and record.facts["frames"] == int(self._own(part, stamps).sum())

    def add(self, index: int, found: PartRows) -> None:
        """Store the rows of a part."""
        frames = int(self._own(index, found.stamps).sum())
        facts = {"part": index, "parts": len(self._parts), "frames": frames}
        facts |= {"bad_packets": found.bad_packets, "corrupt": found.corrupt}
        self._facts[index] = facts
        if self._journal is None:
            self._memory[index] = found
        elif facts["frames"]:
            self._place[index] = len(self._journal)
            self._journal.append(facts, found.rows | {_STAMPS: found.stamps})

    def _own(self, index: int, stamps: Integers) -> Bools:
        """Return a mask of the frames of a part that do not belong to the previous part."""
        stop = self._parts[index - 1].stop if index else None
        return np.ones(len(stamps), dtype=np.bool_) if stop is None else stamps >= stop

    def report(self, scene: Scene) -> None:
        """Report the angles of the parts that an earlier run has finished."""
        for index in sorted(self._facts) if current_sink() is not None else ():
            rows, stamps = self._part(index)
            frames = np.searchsorted(self._packets.stamps, stamps)
            for name in scene.bodies:
                report_angles(name, self._parts[index].first, frames, rows[f"{name}/coarse"])

    @property
    def todo(self) -> list[int]:
        """Indices of unfinished parts."""
        return [i for i in range(len(self._parts)) if i not in self._facts]

    @property
    def frames(self) -> int:
        """Number of frames of finished parts."""
        return sum(int(facts["frames"]) for facts in self._facts.values())

    @property
    def damage(self) -> tuple[int, int]:
        """Numbers of damaged packets and damaged frames of all parts."""
        both = [(int(f["bad_packets"]), int(f["corrupt"])) for f in self._facts.values()]
        return sum(b for b, _ in both), sum(c for _, c in both)

    def rows(self, scene: Scene) -> Rows:
        """Return the rows of all frames, with the angles unwrapped across the parts."""
        out: Rows = {}
        place = 0
        last: dict[str, tuple[Floats, Floats]] = {}
        textures: dict[str, tuple[Floats, Floats]] = {}
        for index in range(len(self._parts)):
            rows, stamps = self._part(index)
            if not len(stamps):
                continue
            frame = np.searchsorted(self._packets.stamps, stamps).astype(np.float64)
            for name in scene.bodies:
                coarse = rows[f"{name}/coarse"]
                if name in last:
                    turns = turns_between(*last[name], frame, coarse)
                    coarse = coarse + turns
                    for marker in scene.of(name):
                        for column in ("angle", "corner_angle"):
                            key = f"{name}/{marker.name}/{column}"
                            rows[key] = rows[key] + (turns if rows[key].ndim == 1 else turns[:, None])
                    rows[f"{name}/coarse"] = coarse
                    for key in _ring_angles(name, rows):
                        rows[key] = rows[key] + turns
                        rows[key] = rows[key] + zero_between(*textures[key], frame, rows[key])
                if np.isfinite(coarse).any():
                    last[name] = frame, coarse
                textures |= {key: (frame, rows[key]) for key in _ring_angles(name, rows)}
            own = self._own(index, stamps)
            rows[_STAMPS] = stamps
            if not out:
                out = new_columns(self.frames, {name: (v.shape[1:], v.dtype) for name, v in rows.items()})
            size = int(own.sum())
            for name, values in rows.items():
                out[name][place : place + size] = values[own]
            place += size
            release_pages()
        return out

    def _part(self, index: int) -> tuple[Rows, Integers]:
        if self._journal is not None:
            if index not in self._place:
                return {}, np.zeros(0, dtype=np.int64)
            rows = dict(self._journal.record(self._place[index]).arrays)
            return rows, rows.pop(_STAMPS)
        found = self._memory.pop(index)
        return dict(found.rows), found.stamps


def _ring_angles(body: str, rows: Rows) -> list[str]:
    return [key for kind in _film_tracker.RINGS if (key := f"{body}/{kind}/angle") in rows]


def zero_between(frame: Floats, angle: Floats, next_frame: Floats, next_angle: Floats) -> float:
    """Return the zero of the angles of a part relative to the previous part [rad], from the common frames."""
    _, a, b = np.intersect1d(frame, next_frame, return_indices=True)
    apart = angle[a] - next_angle[b]
    known = apart[np.isfinite(apart)]
    return median_of(known) if len(known) else 0.0


def turns_between(frame: Floats, coarse: Floats, next_frame: Floats, next_coarse: Floats) -> Floats:
    """Return the correction of the unwrapped angles of a part that joins them to the previous part, (n,) [rad].

    The correction is a whole number of turns in common frames, plus a whole number of turns per frame if the two parts
    resolved the aliasing of the motion differently. Without common frames the angle is extrapolated with the mean of
    the rates before and after. Angles are NaN where the body is lost.
    """
    turn = 2.0 * np.pi
    _, a, b = np.intersect1d(frame, next_frame, return_indices=True)
    apart = coarse[a] - next_coarse[b]
    known = np.isfinite(apart)
    since = next_frame - next_frame[0]
    if known.sum() > 1:
        apart, at = apart[known], since[b][known]
        faster = round(float(np.median(np.diff(apart) / np.diff(at))) / turn)
        return np.asarray(
            turn * (round(float(np.median(apart - turn * faster * at)) / turn) + faster * since),
            dtype=np.float64,
        )
    before, after = np.flatnonzero(np.isfinite(coarse)), np.flatnonzero(np.isfinite(next_coarse))
    if not len(before) or not len(after):
        return np.zeros(len(next_frame))
    late, soon = before[-_RATE:], after[:_RATE]
    rates = [
        (c[k[-1]] - c[k[0]]) / (f[k[-1]] - f[k[0]])
        for c, f, k in ((coarse, frame, late), (next_coarse, next_frame, soon))
        if len(k) > 1
    ]
    rate = float(np.mean(rates)) if rates else 0.0
    ahead = coarse[late[-1]] + rate * (next_frame[soon[0]] - frame[late[-1]])
    return np.full(len(next_frame), turn * round((ahead - next_coarse[soon[0]]) / turn))
