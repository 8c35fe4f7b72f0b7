"""Decoding a film in order, frame by frame, past damage, with a count of its own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import av
import numpy as np
import numpy.typing as npt

from gyrotrack.video.clock import stamp_warnings
from gyrotrack.video.container import ClipInfo, opened, probe
from gyrotrack.video.planes import Frame, Orientation, orientation_of, planes_of


class Reader:
    """All frames of a film, once, in order of presentation.

    Parameters
    ----------
    path : Path
        The film.
    threads : int
        Threads of the decoder (whole frames side by side).

    Notes
    -----
    A packet that cannot be decoded is skipped and counted; what stands before and after it is given. After
    the iteration `decoded`, `pts` and `warnings` tell what was found.
    """

    def __init__(self, path: Path, threads: int = 1) -> None:
        self.info: ClipInfo = probe(path)
        self.orientation = Orientation()
        self.decoded = 0
        self.pts: list[int | None] = []
        self._bad_packets = 0
        self._corrupt = 0
        self._manager = opened(path, threads)

    def __enter__(self) -> Self:
        self._container, self._stream = self._manager.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._manager.__exit__(kind, value, trace)

    def __iter__(self) -> Iterator[Frame]:
        for raw in self._decode():
            if self.decoded == 0:
                self.orientation = orientation_of(raw)
            frame = planes_of(raw, self.decoded, self.orientation)
            self.decoded += 1
            self.pts.append(frame.pts)
            self._corrupt += frame.corrupt
            yield frame

    def _decode(self) -> Iterator[Any]:
        packets = self._container.demux(self._stream)
        size: tuple[int, int] | None = None
        while True:
            try:
                packet = next(packets, None)
                if packet is None:
                    return
                frames = packet.decode()
            except av.error.FFmpegError:
                self._bad_packets += 1
                if self._bad_packets > 100 + 2 * max(self.info.frames_declared, self.decoded):
                    return
                continue
            for frame in frames:
                size = size or (frame.width, frame.height)
                if (frame.width, frame.height) == size:
                    yield frame
                else:
                    self._bad_packets += 1

    def pts_seconds(self) -> npt.NDArray[np.float64]:
        """Return the time stamps of the frames so far in s, NaN where a frame has none."""
        base = float(self.info.time_base)
        return np.array([np.nan if p is None else p * base for p in self.pts], dtype=np.float64)

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
        if self._bad_packets:
            found.append(f"{self._bad_packets} damaged packets were skipped")
        if self._corrupt:
            found.append(f"{self._corrupt} frames are marked as damaged by the decoder")
        return (*found, *stamp_warnings(self.pts_seconds()))


def read_stamps(path: Path) -> npt.NDArray[np.float64]:
    """Return the time stamps of a film's packets in s, sorted, without decoding anything."""
    with opened(path) as (container, stream):
        stamps = [packet.pts for packet in _packets(container, stream) if packet.pts is not None]
        return np.sort(np.array(stamps, dtype=np.float64)) * float(stream.time_base)


def keyframes(path: Path, count: int) -> list[Frame]:
    """Decode up to `count` key frames spread evenly over a film, without the frames between them.

    Their indices are not known and are given as -1: they show what the scene looks like in the course of the
    film, before it is read in order.
    """
    with opened(path) as (container, stream):
        keys = [n for n, packet in enumerate(_packets(container, stream)) if packet.is_keyframe]
    wanted = {keys[int(i)] for i in np.linspace(0, len(keys) - 1, min(count, len(keys)))} if keys else set()
    found: list[Frame] = []
    with opened(path) as (container, stream):
        orientation: Orientation | None = None
        for n, packet in enumerate(_packets(container, stream)):
            if n in wanted:
                for raw in _decode_alone(packet, stream):
                    orientation = orientation or orientation_of(raw)
                    found.append(planes_of(raw, -1, orientation).copy())
    return found


def _packets(container: Any, stream: Any) -> Iterator[Any]:
    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets, None)
        except av.error.FFmpegError:
            return
        if packet is None or packet.size == 0:
            return
        yield packet


def _decode_alone(packet: Any, stream: Any) -> list[Any]:
    """Decode one key packet by itself; the decoder is emptied and made ready for the next."""
    try:
        frames = [*packet.decode(), *stream.codec_context.decode(None)]
    except av.error.FFmpegError:
        frames = []
    stream.codec_context.flush_buffers()
    return frames[:1]
