"""The film with all that was found drawn over it."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from gyrotrack.dataset.columns import set_down
from gyrotrack.dataset.records import Recording
from gyrotrack.dataset.writing import new_file, refuse_existing
from gyrotrack.errors import UsageError
from gyrotrack.pipeline.contact_sheet import write_contact_sheet
from gyrotrack.pipeline.drawing import Picture, drawn
from gyrotrack.pipeline.watch import Progress
from gyrotrack.video import Reader


def check_overlay(path: Path, *, force: bool) -> None:
    """Refuse, before any work is done, an overlay that could not be written.

    Raises
    ------
    UsageError
        If the name says neither a film (.mp4) nor a sheet (.png).
    OutputError
        If the file exists and `force` is not set.
    """
    if path.suffix.lower() not in (".mp4", ".png"):
        raise UsageError(
            f"an overlay is a film (.mp4) or a sheet (.png), not {path.name}", "change its ending"
        )
    refuse_existing(path, force=force)


def write_overlay(
    path: Path, video: Path, recording: Recording, *, force: bool = False, progress: Progress | None = None
) -> None:
    """Draw what a recording holds over its film.

    Parameters
    ----------
    path : Path
        ``.png``: a sheet of twelve frames from the whole film. ``.mp4``: the film, at its own rate.
    video : Path
        The film that the recording was made from.
    """
    check_overlay(path, force=force)
    if path.suffix.lower() == ".png":
        write_contact_sheet(path, video, recording, force=force)
    else:
        _write_film(path, video, recording, force=force, progress=progress)


def _write_film(
    path: Path, video: Path, recording: Recording, *, force: bool, progress: Progress | None
) -> None:
    rate = recording.container_fps if np.isfinite(recording.container_fps) else 30.0
    with new_file(path, force=force) as file, av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=Fraction(rate).limit_denominator(1001))
        stream.width, stream.height = recording.width // 2 * 2, recording.height // 2 * 2
        stream.pix_fmt, stream.options = "yuv420p", {"crf": "20", "preset": "veryfast"}
        for index, picture in enumerate(_pictures(video, recording)):
            even = np.ascontiguousarray(picture[: stream.height, : stream.width])
            frame = av.VideoFrame.from_ndarray(even, format="bgr24")
            frame.pts = index
            container.mux(stream.encode(frame))
            if index % 100 == 0:
                set_down()
                if progress is not None:
                    progress(index, recording.frames_decoded)
        container.mux(stream.encode(None))


def _pictures(video: Path, recording: Recording) -> Iterator[Picture]:
    with Reader(video) as reader:
        for frame in reader:
            if frame.index < recording.frames_decoded:
                yield drawn(frame, frame.index, recording)
