"""Single frames of a film by their number, in any order.

A frame is addressed by its time stamp, which the recording holds: the film is wound back to a key frame before it
and decoded up to it. Where stamps repeat or are missing, a frame is not found rather than another one shown.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import av
import numpy as np

from gyrotrack.dataset.records import Recording
from gyrotrack.errors import VideoError
from gyrotrack.pipeline.drawing import Picture, colour_picture, drawn
from gyrotrack.video import Frame, file_sha256, probe
from gyrotrack.video.container import opened
from gyrotrack.video.planes import orientation_of, planes_of

# so many frames ahead are reached by decoding on, without winding
_AHEAD = 24
_HASHED = 256 * 2**20


def find_film(recording: Recording, folders: list[Path]) -> Path | None:
    """Return the film that a recording was made from, if it lies in one of these folders.

    A film of up to 256 MiB is compared byte for byte by its SHA-256; of a larger one size and number of frames
    must agree.
    """
    name = Path(recording.source).name
    return next((f / name for f in folders if name and _is_it(f / name, recording)), None)


def _is_it(path: Path, recording: Recording) -> bool:
    try:
        if not path.is_file():
            return False
        if recording.source_sha256 and path.stat().st_size <= _HASHED:
            return file_sha256(path) == recording.source_sha256
        info = probe(path)
    except (OSError, ValueError, VideoError):  # a name from a file may be no name at all
        return False
    return {info.width, info.height} == {recording.width, recording.height} and (
        info.frames_declared == recording.frames_declared
    )


class Film:
    """The frames of a film, with what its recording knows drawn over them.

    Parameters
    ----------
    path : Path
        The film.
    recording : Recording
        Made from it.
    """

    def __init__(self, path: Path, recording: Recording) -> None:
        self.recording = recording
        self._manager = opened(path)  # after every winding more threads would have to fill up anew
        self._stamps = recording.pts_time

    def __enter__(self) -> Self:
        self._container, self._stream = self._manager.__enter__()
        self._base = float(self._stream.time_base)
        self._frames: Any = None
        self._at = -1
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._frames = None
        self._manager.__exit__(kind, value, trace)

    def picture(self, index: int, *, overlay: bool = True) -> Picture | None:
        """Return a frame in colour (BGR), None if it cannot be found."""
        if not 0 <= index < len(self._stamps) or not np.isfinite(self._stamps[index]):
            return None
        frame = self._frame(index)
        if frame is None:
            return None
        return drawn(frame, index, self.recording) if overlay else colour_picture(frame)

    def _frame(self, index: int) -> Frame | None:
        wanted = round(float(self._stamps[index]) / self._base)
        try:
            if self._frames is None or not self._at < index <= self._at + _AHEAD:
                self._container.seek(wanted, stream=self._stream, backward=True)
                self._frames = self._decoded(wanted)
            for raw in self._frames:
                if raw.pts is not None and raw.pts >= wanted:
                    self._at = index
                    # half a tick of rounding aside it is this one, or it is lost
                    return planes_of(raw, index, orientation_of(raw)) if raw.pts == wanted else None
        except av.error.FFmpegError:
            pass
        self._frames = None
        return None

    def _decoded(self, first: int) -> Iterator[Any]:
        """Decode from here on; of what lies before the time stamp `first` only what later frames are made from."""
        decoder = self._stream.codec_context
        # in other codecs what counts as no reference may still be one for layers above it
        sure = decoder.codec.name == "h264"
        for packet in self._container.demux(self._stream):
            needless = sure and packet.pts is not None and packet.pts < first
            decoder.skip_frame = "NONREF" if needless else "DEFAULT"
            yield from packet.decode()
