"""Writes frames into an H.264 film, one by one: memory does not grow with the length."""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrotrack.errors import OutputError
from gyrotrack.synthetic.chroma import to_planes

Frame = NDArray[np.uint8]

BT709, LIMITED = 1, 1  # codes of the matrix, the primaries and the transfer curve, and of the range, in H.264


@dataclass(frozen=True)
class Film:
    """How frames are stored.

    Attributes
    ----------
    crf : int
        Constant rate factor of x264: 0 is lossless, 18 very good, 23 usual, 28 poor.
    preset : str
        Speed of x264, "ultrafast" to "veryslow".
    keyframe : int
        Frames between key frames at most.
    bframes : int
        B-frames in a row at most; most cameras write none.
    tag_capture_fps : bool
        Write the capture rate into the file as some phones do (``com.android.capture.fps``).
    threads : int
        Threads of the encoder.
    """

    crf: int = 20
    preset: str = "veryfast"
    keyframe: int = 250
    bframes: int = 0
    tag_capture_fps: bool = False
    threads: int = 1


def write_film(
    path: Path,
    frames: Iterable[Frame],
    *,
    width: int,
    height: int,
    fps: float,
    container_fps: float | None = None,
    film: Film | None = None,
    force: bool = False,
) -> int:
    """Encode frames (height, width, 3) red, green, blue, and return how many there were.

    Parameters
    ----------
    path : Path
        The mp4 file; it appears only when it is complete.
    frames : iterable of arrays
        Drawn while they are encoded; none is kept.
    fps, container_fps : float
        Rate at which the frames were captured, and rate written into the file (None: the same).
    force : bool
        Replace an existing file.

    Raises
    ------
    OutputError
        If the file exists, or cannot be written.
    """
    film = film or Film()
    path = Path(path)
    if path.exists() and not force:
        raise OutputError(f"{path} exists already.", "Give another name, or ask for it to be replaced.")
    part = path.with_name(path.name + ".part")
    try:
        count = _encode(part, frames, (width, height), fps, Fraction(container_fps or fps), film)
        with part.open("rb+") as handle:
            os.fsync(handle.fileno())
        part.replace(path)
    except OSError as error:
        hint = "Check the folder and the free space."
        raise OutputError(f"{path} cannot be written: {error}.", hint) from error
    finally:
        with suppress(FileNotFoundError):
            part.unlink()
    return count


def _encode(
    part: Path, frames: Iterable[Frame], size: tuple[int, int], fps: float, stored: Fraction, film: Film
) -> int:
    """Encode the frames into an mp4 file and return how many there were."""
    import av

    rate = stored.limit_denominator(1001)
    options = {"movflags": "use_metadata_tags"} if film.tag_capture_fps else {}
    count = 0
    with av.open(str(part), "w", format="mp4", options=options) as container:
        if film.tag_capture_fps:
            container.metadata["com.android.capture.fps"] = f"{fps:f}"
        stream = container.add_stream("libx264", rate=rate)
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        stream.options = {
            "crf": str(film.crf),
            "preset": film.preset,
            "g": str(film.keyframe),
            "bf": str(film.bframes),
        }
        context = stream.codec_context
        context.thread_count, context.time_base = film.threads, 1 / rate
        context.colorspace = context.color_primaries = context.color_trc = BT709
        context.color_range = LIMITED
        for picture in frames:
            frame = av.VideoFrame(*size, "yuv420p")
            for plane, values in zip(frame.planes, to_planes(picture), strict=True):
                rows = np.frombuffer(memoryview(plane), np.uint8).reshape(-1, plane.line_size)
                rows[: values.shape[0], : values.shape[1]] = values
            frame.pts = count
            container.mux(stream.encode(frame))
            count += 1
        container.mux(stream.encode(None))
    return count
