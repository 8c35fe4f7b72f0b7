"""Decoding a film in order, frame by frame, past damage."""

from __future__ import annotations

import threading
import zlib
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, Full, Queue
from types import TracebackType
from typing import Any, Generic, Self, TypeVar

import numpy as np
import numpy.typing as npt

from gyrotrack.video._container import (
    ClipInfo,
    Frame,
    Orientation,
    decode_past_damage,
    key_before,
    opened,
    orientation_of,
    packets_of,
    planes_of,
    probe,
)
from gyrotrack.video._time_base import frame_numbers, stamp_warnings

T = TypeVar("T")

CHUNK = 8
"""Frames that are handed over at a time: waking a thread for each one would cost more than its decoding."""
WAITING = 2
"""Chunks that wait at most."""
_PATIENCE = 0.05


class ReadAhead(Generic[T]):
    """An iterator that is run in a thread of its own, a few items ahead of who uses it.

    Parameters
    ----------
    source : iterator
        Touched by that thread alone until `close`; an error in it is raised where the item would have come.
    chunk : int
        Items handed over at a time.

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
        """End the thread; what it has done ahead is dropped."""
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


_STAMP_S = 2e-3  # a file with timestamps in whole ms is no more exact
_NO_STAMP = -(1 << 63)


@dataclass(frozen=True)
class Mark:
    """A place in a film to which another reader can go: what was decoded up to it, and its last frame.

    Attributes
    ----------
    decoded : int
        Frames up to here.
    pts : int or None
        Timestamp of the last one.
    check : int
        CRC-32 of its luma, by which the place is known again.
    bad_packets, corrupt : int
        What was damaged up to here.
    """

    decoded: int
    pts: int | None
    check: int
    bad_packets: int
    corrupt: int


class Reader:
    """All frames of a film, once, in order of presentation.

    Parameters
    ----------
    path : Path
        The film.
    threads : int
        1: frames are decoded when they are asked for. More: a thread of its own decodes some frames ahead, and the
        decoder uses so many threads (whole frames side by side).

    Notes
    -----
    A packet that cannot be decoded is skipped and counted; what stands before and after it is given. After
    the iteration `decoded`, `pts` and `warnings` tell what was found.
    """

    def __init__(self, path: Path, threads: int = 1) -> None:
        self.info: ClipInfo = probe(path)
        self.orientation = Orientation()
        self.decoded = 0
        self._threads = threads
        self._pts = array("q")
        self._bad_packets = 0
        self._corrupt = 0
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
        return self._frames(0)

    def _frames(self, first_packet: int) -> Iterator[Frame]:
        counted = 0
        for raw, bad in self._decode(first_packet):
            self._bad_packets += bad - counted
            counted = bad
            if raw is None:
                return
            if self._size is None:
                self._size = (raw.width, raw.height)
                self.orientation = orientation_of(raw)
            if (raw.width, raw.height) != self._size:
                self._bad_packets += 1
                continue
            frame = planes_of(raw, self.decoded, self.orientation)
            self.decoded += 1
            self._pts.append(_NO_STAMP if frame.pts is None else frame.pts)
            self._corrupt += frame.corrupt
            yield frame

    def mark(self, last: Frame) -> Mark:
        """Return the place after the frame that was given last."""
        return Mark(self.decoded, last.pts, _check(last), self._bad_packets, self._corrupt)

    def after(self, mark: Mark, stamps: Sequence[int]) -> Iterator[Frame] | None:
        """Go to a mark and give the frames behind it; None if the film does not hold that place any more.

        Parameters
        ----------
        mark : Mark
            Made by another reader of the same film.
        stamps : sequence of int
            The timestamps of the frames up to there, as `stamps` gives them.

        Notes
        -----
        Frames are decoded anew from the last key frame before the mark. If its last frame does not come out of
        that as it was, they are decoded anew from the first one.
        """
        for first_packet in dict.fromkeys((key_before(self.info.path, mark.pts), 0)):
            self.rewind()
            frames = self._frames(first_packet)
            for frame in frames:
                here = frame.pts == mark.pts if first_packet else self.decoded == mark.decoded
                if not here:
                    continue
                if _check(frame) != mark.check or frame.pts != mark.pts:
                    break
                self.decoded, self._bad_packets, self._corrupt = mark.decoded, mark.bad_packets, mark.corrupt
                self._pts = array("q", stamps)
                return frames
        return None

    def rewind(self) -> None:
        """Go back to before the first frame."""
        self._close()
        self.decoded, self._bad_packets, self._corrupt, self._size = 0, 0, 0, None
        self._pts = array("q")

    def _decode(self, first_packet: int) -> Iterator[tuple[Any, int]]:
        self._open = opened(self.info.path, self._threads)
        container, stream = self._open.__enter__()
        packets = container.demux(stream)
        for _ in zip(range(first_packet), packets_of(packets), strict=False):
            pass
        decoded = decode_past_damage(packets, 100 + 2 * self.info.frames_declared)
        if self._threads > 1:
            self._ahead = ReadAhead(decoded)
            return iter(self._ahead)
        return decoded

    @property
    def stamps(self) -> npt.NDArray[np.int64]:
        """Timestamps of the frames so far in units of the time base, the least integer where there is none."""
        return np.array(self._pts, dtype=np.int64)

    def pts_seconds(self) -> npt.NDArray[np.float64]:
        """Return the timestamps of the frames so far in s, NaN where a frame has none."""
        stamps = self.stamps
        return np.where(stamps == _NO_STAMP, np.nan, stamps * float(self.info.time_base))

    def frame_numbers(self) -> npt.NDArray[np.int64]:
        """Return the numbers of the frames so far, those of missing frames left out."""
        return frame_numbers(self.pts_seconds(), float(self.info.time_base))

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was not as it should be, in plain sentences."""
        found = []
        declared = self.info.frames_declared
        if declared > self.decoded:
            found.append(
                f"the file declares {declared} frames and {self.decoded} could be decoded: "
                "it is cut off, damaged or edited; what was decoded is used"
            )
        seconds = self.pts_seconds()
        known = seconds[np.isfinite(seconds)]
        period = float(np.median(np.diff(known))) if len(known) > 1 else 0.0
        ends = float(known.max()) + period if len(known) else 0.0
        if self.info.duration_declared > ends + max(0.5 * period, _STAMP_S):
            found.append(
                f"the file declares {self.info.duration_declared:.3f} s and its last frame ends at {ends:.3f} s: "
                "it is cut off, damaged or edited; what was decoded is used"
            )
        if self._bad_packets:
            found.append(f"{self._bad_packets} damaged packets were skipped")
        if self._corrupt:
            found.append(f"{self._corrupt} frames are marked as damaged by the decoder")
        return (*found, *stamp_warnings(seconds))


def _check(frame: Frame) -> int:
    return zlib.crc32(frame.y.tobytes())
