"""Decoding of a film: all frames in sequence, single frames by their timestamps, and the detection of repeated frames.

Damaged packets are skipped. To detect repetitions, some rows of each frame are compared with the same rows of the
previous frame. A repeated frame also repeats the sensor noise, so its difference from the previous frame is much
smaller than the difference between other frames.
"""

from __future__ import annotations

import itertools
from array import array
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import av
import cv2
import numpy as np
import numpy.typing as npt

from gyrotrack._arrays import Floats, Integers
from gyrotrack._smoothing import running_quantile
from gyrotrack.video._container import (
    ClipInfo,
    Frame,
    Orientation,
    Packets,
    decode_past_damage,
    opened,
    orientation_of,
    packets_of,
    planes_of,
    probe,
    read_packets,
)
from gyrotrack.video._time_base import stamp_warnings

T = TypeVar("T")

CHUNK = 8
"""Number of frames that are transferred at a time [frames]. Chosen: waking a thread for each frame would take longer
than decoding the frame; a larger number takes memory."""
_CHUNK_BYTES = 5_000_000
"""Largest size of the frames that are transferred at a time [bytes]. Chosen: to limit memory, because several chunks
exist at a time."""
WAITING = 2
"""Largest number of waiting chunks [1]. Chosen: a larger number takes memory, a smaller one lets the decoder wait."""


def read_ahead(source: Iterator[T], chunk: int = CHUNK) -> Generator[T, None, None]:
    """Yield the items of a source that runs in its own thread, at most `WAITING` + 1 chunks ahead.

    An exception of the source is raised after all items that precede it.
    """
    pool = ThreadPoolExecutor(1, "decoding")
    try:
        waiting = deque(pool.submit(_next_items, source, chunk) for _ in range(WAITING + 1))
        while True:
            items, error = waiting.popleft().result()
            yield from items
            if error is not None:
                raise error
            if len(items) < chunk:
                return
            waiting.append(pool.submit(_next_items, source, chunk))
    finally:
        pool.shutdown(cancel_futures=True)


def _next_items(source: Iterator[T], most: int) -> tuple[list[T], BaseException | None]:
    items: list[T] = []
    try:
        items.extend(itertools.islice(source, most))
    except BaseException as error:
        return items, error
    return items, None


_STAMP_S = 2e-3
"""Largest difference between the declared duration and the end of the last frame that is attributed to rounding errors
of timestamps [s]. Derived: twice the resolution of timestamps in whole ms."""
_NO_STAMP = -(1 << 63)
"""Value for a missing timestamp [ticks]. Source: AV_NOPTS_VALUE of FFmpeg."""


@dataclass(frozen=True)
class Part:
    """A part of a film that begins with a key frame and can be decoded separately."""

    first: int = 0  # index in the film of the first frame of the part
    # timestamps of the key frame and of the first frame after the part, in units of the time base; None: start or end
    # of the film
    start: int | None = None
    stop: int | None = None


class Reader:
    """All frames of a film, or of a part, once, in order of presentation.

    With one thread, frames are decoded on demand. With several threads, a separate thread decodes some frames ahead,
    and the decoder uses this number of threads. A packet that cannot be decoded is skipped and counted. After the
    iteration `decoded`, `stamps` and `warnings` describe the film.
    """

    def __init__(
        self, path: Path, threads: int = 1, part: Part = Part(), info: ClipInfo | None = None
    ) -> None:
        self.info: ClipInfo = info or probe(path)
        self._part = part
        self.orientation = Orientation()
        self.decoded = 0
        self._threads = threads
        self._pts = array("q")
        self.bad_packets = 0
        self.corrupt = 0
        self._size: tuple[int, int] | None = None
        self._open: Any = None
        self._stream: Any = None
        self._ahead: Generator[tuple[Any, int], None, None] | None = None

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
                continue  # the frame refers to frames before the key frame
            if part.stop is not None and raw.pts is not None and raw.pts >= part.stop:
                return
            if self._size is None:
                self._size = (raw.width, raw.height)
                self.orientation = orientation_of(raw, self._stream)
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
            self._stream = stream
            packets = _from_key(container, stream, self._part.start, seek=seek)
            if packets is not None:
                break
        decoded = decode_past_damage(packets or iter(()), 100 + 2 * self.info.frames_declared)
        if self._threads > 1:
            picture = max(self.info.width * self.info.height * 3 // 2, 1)
            self._ahead = read_ahead(decoded, int(np.clip(_CHUNK_BYTES // picture, 1, CHUNK)))
            return self._ahead
        return decoded

    @property
    def stamps(self) -> Integers:
        """Timestamps of the decoded frames in units of the time base; missing timestamps are the smallest integer."""
        return np.array(self._pts, dtype=np.int64)

    def pts_seconds(self) -> Floats:
        """Return the timestamps of the decoded frames [s]; NaN for frames without a timestamp."""
        return pts_seconds(self.stamps, float(self.info.time_base))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about missing or damaged frames and timestamps, as sentences."""
        return film_warnings(self.info, self.pts_seconds(), self.bad_packets, self.corrupt)


def pts_seconds(stamps: Integers, tick: float) -> Floats:
    """Return timestamps [s], NaN for frames without a timestamp; `tick` is the time base [s]."""
    return np.where(stamps == _NO_STAMP, np.nan, stamps * tick)


def film_warnings(info: ClipInfo, seconds: Floats, bad_packets: int, corrupt: int) -> tuple[str, ...]:
    """Return warnings about a decoded film; `seconds` (n,) is NaN without a timestamp; `corrupt` counts frames."""
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


def frames_at(
    path: Path, stamps: Iterable[int], keep: Callable[[Frame], Frame] = Frame.copy
) -> dict[int, Frame]:
    """Decode those frames that have one of the given timestamps (units of the time base).

    Frames between two key frames are decoded together, from the first key frame.
    """
    packets, info = read_packets(path), probe(path)
    keys, wanted = packets.stamps[packets.key], np.array(sorted(stamps), dtype=np.int64)
    key = np.searchsorted(keys, wanted, side="right") - 1
    found: dict[int, Frame] = {}
    for k in np.unique(key[key >= 0]):
        some = set(wanted[key == k].tolist())
        with Reader(path, 1, Part(0, int(keys[k]), max(some) + 1), info) as reader:
            found |= {f.pts: keep(f) for f in reader if f.pts is not None and f.pts in some}
    return found


SAME = 0.3
"""Largest difference of a repeated frame from the previous one, relative to the recent typical difference [1]. Chosen:
a smaller value keeps repeats that were encoded again, a larger one drops frames of slow motion."""
SMALL = 0.35
"""Smallest size of an informative packet, relative to its neighbours [1]. Chosen: a smaller value
overlooks repeats, a larger one reports predicted frames."""
_AROUND = 31
"""Length of a running quantile [packets or frames]. Chosen: a larger number follows changes of the film late, a smaller
one is dominated by repeats."""
_LARGE = 80
"""Quantile of the sizes that is typical of new frames [percent]. Chosen: if most frames are repeated, a lower quantile
is the size of repeats; a higher one is the size of scene changes."""
_ROWS = 12
"""Number of rows of a frame that are compared [rows]. Chosen: a smaller number overlooks a small motion, a larger one
costs time."""
_MOST = 0.8
"""Quantile of the differences that is typical of new frames [1]. Chosen: 3 in 4 frames may be repeated; a lower
quantile is the difference of repeats, a higher one the difference at a cut."""
_FEWEST = 5
"""Smallest number of repeats for a test of their spacing [1]. Chosen: with fewer, repeats are regular by chance; with
more, short films remain uncorrected."""

Rows = npt.NDArray[np.uint8]


class RepeatDetector:
    """Detects frames of a film that repeat the previous frame.

    `regular` states whether runs of repeated frames are periodic, as after a conversion to another rate. It is
    determined from the packets of the whole film, or from the frames so far.
    """

    def __init__(self, packets: Packets) -> None:
        self.regular = _regular(_starts(_uninformative(packets)))
        self._last: Rows | None = None
        self._recent: tuple[float, ...] = ()
        self._run_starts: tuple[int, ...] = ()
        self._run = False

    def same(self, frame: Frame) -> bool:
        """Return whether the next frame of the film repeats the previous frame."""
        rows, last, again = _rows(frame), self._last, False
        if last is not None:
            apart = _difference(rows, last)
            again = len(self._recent) > 1 and apart < SAME * _usual(self._recent)
            self._recent = (*self._recent[1 - _AROUND :], apart)
        if again and not self._run:
            self._run_starts = (*self._run_starts[-_FEWEST:], frame.index)
            self.regular = self.regular or _regular(np.array(self._run_starts))
        self._run, self._last = again, rows
        return again

    def copy_last(self) -> None:
        """Copy the required rows of the last frame, so that its memory can be released."""
        if self._last is not None:
            self._last = self._last.copy()


def _difference(rows: Rows, last: Rows) -> float:
    """Return the difference of two pictures, independent of flicker of the illumination.

    The difference is the sum of |a - g b|, with the gain g that makes the means equal. Without the gain, two frames at
    the same flicker phase would differ less than their neighbours, as if one repeated the other.
    """
    gain = cv2.sumElems(rows)[0] / max(cv2.sumElems(last)[0], 1.0)
    return cv2.norm(cv2.addWeighted(rows, 1.0, last, -gain, 0.0, dtype=cv2.CV_32F), cv2.NORM_L1)


def _usual(differences: tuple[float, ...]) -> float:
    """Return the typical difference of new frames: a high quantile, because 3 in 4 frames may be repeated."""
    return sorted(differences)[min(len(differences) - 2, int(_MOST * len(differences)))]


def _rows(frame: Frame) -> Rows:
    """Return some rows of the luma from the middle of a picture, as a view."""
    height = len(frame.y)
    return frame.y[height // 8 : height - height // 8 : max(height // _ROWS, 1)]


def _uninformative(packets: Packets) -> Integers:
    """Return the numbers of packets with little information: much smaller than, or as large as, their neighbours."""
    if len(packets.size) < _AROUND:
        return np.zeros(0, dtype=np.int64)
    if packets.key.all():
        return 1 + np.flatnonzero(np.diff(packets.size) == 0)
    size = np.where(packets.key, 0, packets.size)
    usual = running_quantile(size, _AROUND, _AROUND * _LARGE // 100)
    return np.flatnonzero(~packets.key & (size < SMALL * usual))


def _starts(place: Integers) -> Integers:
    """Return the positions at which runs of neighbours begin."""
    return place[np.diff(place, prepend=-2) > 1]


REGULAR = 0.8
"""Smallest share of equal distances between repeats for which the repeats are periodic [1]. Chosen: a smaller value
finds a period by chance, a larger one fails if a repeat is not detected."""


def _regular(start: Integers) -> bool:
    """Return whether runs are periodic up to a rounding error of one frame, as after a conversion."""
    apart = np.diff(start)
    return len(start) >= _FEWEST and bool((np.abs(apart - np.median(apart)) <= 1.0).mean() > REGULAR)
