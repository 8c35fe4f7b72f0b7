"""Single frames of a film by their number."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import av

from gyrotrack.video._container import Frame, Orientation, opened, orientation_of, packets_of, planes_of


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
