"""The packets of a film: their time stamps, what decodes from them, and where decoding can begin."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import numpy as np
import numpy.typing as npt

from gyrotrack.video.container import opened
from gyrotrack.video.planes import Frame, Orientation, orientation_of, planes_of


def packets_of(packets: Any) -> Iterator[Any]:
    """Give the packets of a demultiplexer up to its end, or to where the file is broken."""
    while True:
        try:
            packet = next(packets, None)
        except av.error.FFmpegError:
            return
        if packet is None or packet.size == 0:
            return
        yield packet


def decode_past_damage(packets: Any, most_bad: int) -> Iterator[tuple[Any, int]]:
    """Decode packets in order, the damaged ones left out, up to the end or to `most_bad` of them beyond the frames.

    Yields
    ------
    frame, bad
        A decoded frame, and how many packets before it could not be decoded; at the end None and all of these.
    """
    bad = good = 0
    while bad <= most_bad + 2 * good:
        try:
            packet = next(packets, None)
            if packet is None:
                break
            frames = packet.decode()
        except av.error.FFmpegError:
            bad += 1
            continue
        for frame in frames:
            good += 1
            yield frame, bad
    yield None, bad


@dataclass(frozen=True)
class Packets:
    """The packets of a film that have a time stamp, in the order of these.

    Attributes
    ----------
    stamps, size : ndarray of int, shape (n,)
        Time stamps in units of the time base, and sizes in bytes.
    key : ndarray of bool, shape (n,)
        Which ones hold a picture by itself.
    complete : bool
        Whether all of the film's packets are among them.
    """

    stamps: npt.NDArray[np.int64]
    size: npt.NDArray[np.int64]
    key: npt.NDArray[np.bool_]
    complete: bool


def read_packets(path: Path) -> Packets:
    """Read what a film's packets say of themselves, without decoding anything."""
    with opened(path) as (container, stream):
        found = [(p.pts, p.size, p.is_keyframe) for p in packets_of(container.demux(stream))]
    stamped = sorted(p for p in found if p[0] is not None)
    stamps, size, key = zip(*stamped, strict=True) if stamped else ((), (), ())
    return Packets(
        np.array(stamps, dtype=np.int64),
        np.array(size, dtype=np.int64),
        np.array(key, dtype=np.bool_),
        len(stamped) == len(found),
    )


def read_raw_stamps(path: Path) -> npt.NDArray[np.int64]:
    """Return the time stamps of a film's packets in units of the time base, sorted, without decoding anything."""
    return read_packets(path).stamps


def key_before(path: Path, pts: int | None) -> int:
    """Return the number of the last key packet that is shown at or before a time stamp; 0 if unknown."""
    found = 0
    if pts is None:
        return found
    with opened(path) as (container, stream):
        for n, packet in enumerate(packets_of(container.demux(stream))):
            if packet.is_keyframe and packet.pts is not None and packet.pts <= pts:
                found = n
    return found


def keyframes(path: Path, count: int) -> list[Frame]:
    """Decode up to `count` key frames spread evenly over a film, without the frames between them.

    Their indices are not known and are given as -1: they show what the scene looks like in the course of the
    film, before it is read in order.
    """
    with opened(path) as (container, stream):
        keys = [n for n, packet in enumerate(packets_of(container.demux(stream))) if packet.is_keyframe]
    wanted = {keys[int(i)] for i in np.linspace(0, len(keys) - 1, min(count, len(keys)))} if keys else set()
    found: list[Frame] = []
    with opened(path) as (container, stream):
        orientation: Orientation | None = None
        for n, packet in enumerate(packets_of(container.demux(stream))):
            if n in wanted:
                for raw in _decode_alone(packet, stream):
                    orientation = orientation or orientation_of(raw)
                    found.append(planes_of(raw, -1, orientation).copy())
    return found


def _decode_alone(packet: Any, stream: Any) -> list[Any]:
    """Decode one key packet by itself; the decoder is emptied and made ready for the next."""
    try:
        frames = [*packet.decode(), *stream.codec_context.decode(None)]
    except av.error.FFmpegError:
        frames = []
    stream.codec_context.flush_buffers()
    return frames[:1]
