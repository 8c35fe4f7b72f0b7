"""Sequential decoding of a film; damaged packets are skipped."""

from __future__ import annotations

import itertools
import threading
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, Full, Queue
from types import TracebackType
from typing import Any, Generic, Self, TypeVar

import av
import numpy as np
import numpy.typing as npt

from gyrotrack.video._container import (
    ClipInfo,
    Frame,
    Orientation,
    decode_past_damage,
    opened,
    orientation_of,
    packets_of,
    planes_of,
    probe,
)
from gyrotrack.video._time_base import stamp_warnings

T = TypeVar("T")

CHUNK = 8
"""Frames transferred at a time; waking a thread for each one would take longer than its decoding."""
WAITING = 2
"""Largest number of waiting chunks."""
_PATIENCE = 0.05


class ReadAhead(Generic[T]):
    """An iterator that runs in a separate thread, a few items ahead of the consumer.

    Parameters
    ----------
    source : iterator
        Used by that thread only until `close`; its exceptions are raised in the consumer.
    chunk : int
        Items transferred at a time.

    Examples
    --------
    >>> list(ReadAhead(iter(range(20))))[-1]
    19
    """

    def __init__(self, source: Iterator[T], chunk: int = CHUNK) -> None:
        self._source = source
        self._chunk = chunk
        self._queue: Queue[tuple[list[T], bool, BaseException | None]] = Queue(WAITING)
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._work, name="decoding", daemon=True)
        self._thread.start()

    def __iter__(self) -> Iterator[T]:
        last = False
        while not last:
            try:
                items, last, error = self._queue.get(timeout=_PATIENCE)
            except Empty:
                continue
            yield from items
            if error is not None:
                raise error

    def close(self) -> None:
        """End the thread and discard its items."""
        self._closed.set()
        while self._thread.is_alive():
            try:
                self._queue.get(timeout=_PATIENCE)
            except Empty:
                continue

    def _work(self) -> None:
        items: list[T] = []
        error: BaseException | None = None
        try:
            for item in self._source:
                items.append(item)
                if len(items) == self._chunk:
                    self._hand_over(items, last=False)
                    items = []
                if self._closed.is_set():
                    return
        except BaseException as raised:
            error = raised
        self._hand_over(items, last=True, error=error)

    def _hand_over(self, items: list[T], *, last: bool, error: BaseException | None = None) -> None:
        while not self._closed.is_set():
            try:
                self._queue.put((items, last, error), timeout=_PATIENCE)
            except Full:
                continue
            return


_STAMP_S = 2e-3  # resolution of timestamps in whole ms
_NO_STAMP = -(1 << 63)


@dataclass(frozen=True)
class Part:
    """A part of a film that begins with a key frame and can be decoded by itself.

    Attributes
    ----------
    first : int
        Index of its first frame in the film.
    start, stop : int or None
        Timestamps of its key frame and of the first frame beyond it, in units of the time base; None: ends of the film.
    """

    first: int = 0
    start: int | None = None
    stop: int | None = None


class Reader:
    """All frames of a film, once, in order of presentation.

    Parameters
    ----------
    path : Path
        The film.
    threads : int
        1: frames are decoded on demand. More: a separate thread decodes some frames ahead, and the decoder uses this
        number of threads for frames in parallel.
    part : Part
        The frames to read; by default all.

    Notes
    -----
    A packet that cannot be decoded is skipped and counted. After the iteration `decoded`, `stamps` and `warnings`
    describe the film.
    """

    def __init__(self, path: Path, threads: int = 1, part: Part = Part()) -> None:
        self.info: ClipInfo = probe(path)
        self._part = part
        self.orientation = Orientation()
        self.decoded = 0
        self._threads = threads
        self._pts = array("q")
        self.bad_packets = 0
        self.corrupt = 0
        self._size: tuple[int, int] | None = None
        self._open: Any = None
        self._ahead: ReadAhead[tuple[Any, int]] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def _close(self) -> None:
        if self._ahead is not None:
            self._ahead.close()
            self._ahead = None
        if self._open is not None:
            self._open.__exit__(None, None, None)
            self._open = None

    def __iter__(self) -> Iterator[Frame]:
        part, counted = self._part, 0
        for raw, bad in self._decode():
            self.bad_packets += bad - counted
            counted = bad
            if raw is None:
                return
            if part.start is not None and (raw.pts is None or raw.pts < part.start):
                continue  # refers to frames before the key frame
            if part.stop is not None and raw.pts is not None and raw.pts >= part.stop:
                return
            if self._size is None:
                self._size = (raw.width, raw.height)
                self.orientation = orientation_of(raw)
            if (raw.width, raw.height) != self._size:
                self.bad_packets += 1
                continue
            frame = planes_of(raw, part.first + self.decoded, self.orientation)
            self.decoded += 1
            self._pts.append(_NO_STAMP if frame.pts is None else frame.pts)
            self.corrupt += frame.corrupt
            yield frame

    def _decode(self) -> Iterator[tuple[Any, int]]:
        packets: Iterator[Any] | None = None
        for seek in (True, False):  # not every container can seek by timestamp
            self._close()
            self._open = opened(self.info.path, self._threads)
            container, stream = self._open.__enter__()
            packets = _from_key(container, stream, self._part.start, seek=seek)
            if packets is not None:
                break
        decoded = decode_past_damage(packets or iter(()), 100 + 2 * self.info.frames_declared)
        if self._threads > 1:
            self._ahead = ReadAhead(decoded)
            return iter(self._ahead)
        return decoded

    @property
    def stamps(self) -> npt.NDArray[np.int64]:
        """Timestamps of the frames so far in units of the time base, the smallest integer where a frame has none."""
        return np.array(self._pts, dtype=np.int64)

    def pts_seconds(self) -> npt.NDArray[np.float64]:
        """Return the timestamps of the frames so far in s, NaN where a frame has none."""
        return pts_seconds(self.stamps, float(self.info.time_base))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about missing or damaged frames and timestamps, as sentences."""
        return film_warnings(self.info, self.pts_seconds(), self.bad_packets, self.corrupt)


def pts_seconds(stamps: npt.NDArray[np.int64], tick: float) -> npt.NDArray[np.float64]:
    """Return timestamps in s, NaN where a frame has none; `tick` is the time base [s]."""
    return np.where(stamps == _NO_STAMP, np.nan, stamps * tick)


def film_warnings(
    info: ClipInfo, seconds: npt.NDArray[np.float64], bad_packets: int, corrupt: int
) -> tuple[str, ...]:
    """Return warnings about a decoded film, as sentences.

    Parameters
    ----------
    info : ClipInfo
        Metadata of the film.
    seconds : ndarray, shape (n,)
        Timestamps of its frames [s], NaN where a frame has none.
    bad_packets, corrupt : int
        Packets that could not be decoded, and frames that the decoder marks as damaged.
    """
    found = []
    if info.frames_declared > len(seconds):
        found.append(
            f"The file declares {info.frames_declared} frames and {len(seconds)} could be decoded: "
            "it is truncated, damaged or edited. The decoded frames are used."
        )
    known = seconds[np.isfinite(seconds)]
    period = float(np.median(np.diff(known))) if len(known) > 1 else 0.0
    ends = float(known.max()) + period if len(known) else 0.0
    if info.duration_declared > ends + max(0.5 * period, _STAMP_S):
        found.append(
            f"The file declares {info.duration_declared:.3f} s and its last frame ends at {ends:.3f} s: "
            "it is truncated, damaged or edited. The decoded frames are used."
        )
    if bad_packets:
        found.append(f"{bad_packets} damaged packets were skipped.")
    if corrupt:
        found.append(f"The decoder marks {corrupt} frames as damaged.")
    return (*found, *stamp_warnings(seconds))


def _from_key(container: Any, stream: Any, stamp: int | None, *, seek: bool) -> Iterator[Any] | None:
    """Return the packets from the key frame with a timestamp; None if it is not found."""
    if stamp is None:
        packets: Iterator[Any] = container.demux(stream)
        return packets
    if seek:
        try:
            container.seek(stamp, stream=stream, backward=True)
        except av.error.FFmpegError:
            return None
    packets = container.demux(stream)
    for packet in packets_of(packets):
        if packet.is_keyframe and packet.pts == stamp:
            return itertools.chain((packet,), packets)
        if seek and packet.is_keyframe and packet.pts is not None and packet.pts > stamp:
            return None
    return None
