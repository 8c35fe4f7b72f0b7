"""Opening a film file so that it can do no harm, and reading what it declares about itself."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av

from gyrotrack.errors import VideoError

MAX_PIXELS = 64_000_000
"""Largest picture that is decoded: 8000 x 8000; a small file can declare far more than memory holds."""
MIN_SIDE = 32
"""Smallest side of a picture in which markers can be told apart."""

# Without these lists a text file named .mp4 can make the library open other files or the network.
_CONTAINER_OPTIONS = {
    "format_whitelist": "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi",
    "protocol_whitelist": "file",
}
_RATE_TAGS = ("com.android.capture.fps", "capture_fps", "CAPTURE_FPS")

# The library's logging takes locks of its own, which deadlock with decoding threads.
av.logging.set_level(None)


@dataclass(frozen=True)
class ClipInfo:
    """What a film file says about itself; nothing of it is trusted for counting frames.

    Attributes
    ----------
    path : Path
        The file.
    width, height : int
        Size of the coded picture in px, before any rotation.
    container_fps : float
        Frames per second of the container; NaN when it names none.
    frames_declared : int
        Frames that the header promises; 0 when it does not say.
    tag_fps : float or None
        Capture rate from the camera's own tag (slow motion), if there is one.
    codec, pixel_format : str
        Names of both.
    time_base : Fraction
        Unit of the time stamps in s.
    duration_declared : float
        How long the film lasts by a header that counts no frames [s]; NaN where there is none, or another one.
    """

    path: Path
    width: int
    height: int
    container_fps: float
    frames_declared: int
    tag_fps: float | None
    codec: str
    pixel_format: str
    time_base: Fraction
    duration_declared: float = float("nan")


@contextlib.contextmanager
def opened(path: Path, threads: int = 1) -> Iterator[tuple[Any, Any]]:
    """Open a film and give (container, video stream); raise `VideoError` in one sentence otherwise."""
    _check_file(path)
    try:
        container = av.open(
            str(path.resolve()), options=_CONTAINER_OPTIONS, metadata_errors="replace", timeout=(10.0, 60.0)
        )
    except (av.error.FFmpegError, ValueError, OSError) as error:
        raise VideoError(
            f"{path} is not a film that can be read ({_reason(error)})",
            "give an MP4, MOV, MKV, WebM or AVI file; a copy that was cut off while writing has no index",
        ) from error
    with container:
        if not container.streams.video:
            raise VideoError(f"{path} holds no video, only other streams", "give the film itself")
        stream = container.streams.video[0]
        if stream.codec_context is None:
            raise VideoError(
                f"{path} is packed in a way that no decoder knows", "copy it again, or convert it to H.264"
            )
        _check_size(path, stream)
        stream.codec_context.options = {"max_pixels": str(MAX_PIXELS)}
        stream.codec_context.thread_type = "FRAME" if threads > 1 else "NONE"
        stream.codec_context.thread_count = threads
        yield container, stream


def probe(path: Path) -> ClipInfo:
    """Read what a film declares: size, rates, frame count, tags."""
    with opened(path) as (container, stream):
        context = stream.codec_context
        rate = _nominal_rate(stream)
        return ClipInfo(
            path=path,
            width=int(context.width),
            height=int(context.height),
            container_fps=float(rate) if rate else float("nan"),
            frames_declared=int(stream.frames),
            tag_fps=_tagged_rate(container.metadata) or _tagged_rate(stream.metadata),
            codec=str(context.name),
            pixel_format=str(context.pix_fmt),
            time_base=Fraction(stream.time_base),
            duration_declared=_declared_duration(container, stream),
        )


def _declared_duration(container: Any, stream: Any) -> float:
    """Return how long the pictures of a file last that does not count them [s], NaN where it is not told."""
    if stream.frames or not container.duration or len(container.streams) != 1:
        return float("nan")  # beside a sound the whole may be longer than its pictures
    return float(container.duration / av.time_base)


def _nominal_rate(stream: Any) -> Any:
    """Return the rate of a stream; the average is misled by missing frames, the nominal one by odd time bases."""
    average, nominal = stream.average_rate, stream.base_rate
    if average and nominal and 1.0 <= float(nominal / average) < 1.2:
        return nominal
    return average or stream.guessed_rate


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _check_file(path: Path) -> None:
    if not path.exists():
        raise VideoError(f"there is no file {path}", "check the path")
    if not path.is_file():
        raise VideoError(f"{path} is not a regular file", "give one film file")
    try:
        size = path.stat().st_size
        with path.open("rb"):
            pass
    except OSError as error:
        raise VideoError(f"{path} cannot be opened: {error.strerror}", "check its permissions") from error
    if size == 0:
        raise VideoError(f"{path} is empty (0 bytes)", "copy it from the camera again")


def _check_size(path: Path, stream: Any) -> None:
    width, height = int(stream.codec_context.width), int(stream.codec_context.height)
    if width * height > MAX_PIXELS:
        raise VideoError(
            f"{path} declares frames of {width}x{height} px, too large to decode", "scale it down"
        )
    if min(width, height) < MIN_SIDE:
        raise VideoError(
            f"{path} has frames of {width}x{height} px, too small to hold markers",
            f"give a film with at least {MIN_SIDE} px on each side",
        )


def _tagged_rate(metadata: Any) -> float | None:
    for tag in _RATE_TAGS:
        with contextlib.suppress(KeyError, ValueError, TypeError):
            value = float(metadata[tag])
            if 1.0 <= value <= 1.0e6:
                return value
    return None


def _reason(error: Exception) -> str:
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return str(text).strip().rstrip(".").lower()
