"""Single frames of a film: by their number, and those that repeat the picture of the frame before.

To detect repetitions, some rows of each frame are compared with those of the previous one. A repeated frame repeats the
sensor noise, too, so that the difference is much smaller than between any other two frames.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import numpy.typing as npt

from gyrotrack.video._container import (
    Frame,
    Orientation,
    Packets,
    opened,
    orientation_of,
    packets_of,
    planes_of,
)


def frames_at(path: Path, stamps: Iterable[int]) -> dict[int, Frame]:
    """Decode the frames with the given timestamps (units of the time base), and only what they need.

    A frame that is not found, because a film is damaged there or its packets carry no stamps, is left out. The
    frames have the index -1.
    """
    wanted = set(stamps)
    ranges = _ranges(path, sorted(wanted))
    found: dict[int, Frame] = {}
    with opened(path) as (container, stream):
        orientation: Orientation | None = None
        packets = enumerate(packets_of(container.demux(stream)))
        for first, stop, start, end in ranges:
            last = max(stamp for stamp in wanted if start <= stamp < end)
            for raw in _decoded(packets, first, stop, stream):
                orientation = orientation or orientation_of(raw)
                if raw.pts in wanted:
                    found[int(raw.pts)] = planes_of(raw, -1, orientation).copy()
                if raw.pts is not None and raw.pts >= last:
                    break
    return found


def _ranges(path: Path, wanted: list[int]) -> list[tuple[int, int, int, int]]:
    """Return the runs of packets from a key packet to the next that hold the stamps: first, stop, their stamps."""
    keys: list[tuple[int, int]] = []
    count = 0
    with opened(path) as (container, stream):
        for packet in packets_of(container.demux(stream)):
            if packet.is_keyframe and packet.pts is not None:
                keys.append((int(packet.pts), count))
            count += 1
    found = []
    for (start, first), (end, stop) in zip(keys, [*keys[1:], (1 << 63, count)], strict=True):
        if any(start <= stamp < end for stamp in wanted):
            found.append((first, stop, start, end))
    return found


def _decoded(packets: Iterator[tuple[int, Any]], first: int, stop: int, stream: Any) -> Iterator[Any]:
    """Decode the packets from number `first` to before `stop`; the decoder is emptied at the end."""
    stream.codec_context.flush_buffers()
    for number, packet in packets:
        if number >= first:
            try:
                yield from packet.decode()
            except av.error.FFmpegError:
                continue
        if number == stop - 1:
            break
    try:
        yield from stream.codec_context.decode(None)
    except av.error.FFmpegError:
        return


SAME = 0.3
"""Largest difference of a repeated frame from the previous one, relative to the recent typical difference."""
SMALL = 0.35
"""Size of a packet, relative to its neighbours, below which it has little information."""
_AROUND = 31
_LARGE = 80
_ROWS = 12
_MOST = 0.8
_FEWEST = 5

Rows = npt.NDArray[np.uint8]


class RepeatDetector:
    """Detects frames of a film that repeat the previous one.

    Parameters
    ----------
    packets : Packets
        Of the whole film.

    Attributes
    ----------
    regular : bool
        Whether runs of repeated frames are periodic, as after a conversion to another rate, according to the packets or
        to the frames so far.
    """

    def __init__(self, packets: Packets) -> None:
        self.regular = _regular(_starts(_uninformative(packets)))
        self._last: Rows | None = None
        self._recent: tuple[float, ...] = ()
        self._run_starts: tuple[int, ...] = ()
        self._run = False

    def same(self, frame: Frame) -> bool:
        """Tell whether the next frame of the film repeats the previous one."""
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

    The sum of |a - g b|, with the gain g that makes their means equal. Without it, two frames of equal brightness
    differ so much less than their neighbours that one seems to repeat the other.
    """
    a, b = rows.astype(np.float32), last.astype(np.float32)
    gain = float(a.sum() / max(float(b.sum()), 1.0))
    return float(cv2.norm(a, b * np.float32(gain), cv2.NORM_L1))


def _usual(differences: tuple[float, ...]) -> float:
    """Return the typical difference between unrepeated frames: a high quantile, as three in four may be repeated.

    The largest of few values may be due to a cut.
    """
    return sorted(differences)[min(len(differences) - 2, int(_MOST * len(differences)))]


def _rows(frame: Frame) -> Rows:
    """Return some rows of the luma from the middle of a picture, as a view."""
    height = len(frame.y)
    return frame.y[height // 8 : height - height // 8 : max(height // _ROWS, 1)]


def _uninformative(packets: Packets) -> npt.NDArray[np.int64]:
    """Return which packets contain little information: much smaller than their neighbours, or equal in size."""
    from scipy.ndimage import percentile_filter

    if len(packets.size) < _AROUND:
        return np.zeros(0, dtype=np.int64)
    if packets.key.all():
        return 1 + np.flatnonzero(np.diff(packets.size) == 0)
    size = np.where(packets.key, 0, packets.size)
    usual = percentile_filter(size, _LARGE, size=_AROUND, mode="nearest")
    return np.flatnonzero(~packets.key & (size < SMALL * usual))


def _starts(place: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return where runs of neighbours begin."""
    return place[np.diff(place, prepend=-2) > 1]


def _regular(start: npt.NDArray[np.int64]) -> bool:
    """Tell whether runs are periodic up to one frame of rounding, as after a conversion."""
    apart = np.diff(start)
    return len(start) >= _FEWEST and bool((np.abs(apart - np.median(apart)) <= 1.0).mean() > 0.8)
