"""Open a film file safely, and read its packets.

Colours are read from the planes of the decoder, because conversion to RGB takes longer than tracking. The arrays are
views of the decoder's buffer, whose rows may be padded.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np

from gyrotrack._arrays import Bools, Integers, Plane
from gyrotrack._errors import VideoError
from gyrotrack.io.readers._format_names import FILMS
from gyrotrack.video._frame_stream import FrameStream
from gyrotrack.video._photron import SUFFIX as PHOTRON
from gyrotrack.video._photron import GreyFrames, raw_file, read_header
from gyrotrack.video._tiff import SUFFIXES as TIFF
from gyrotrack.video._tiff import TiffFrames, TiffStack, read_stack

_PLANAR_420 = ("yuv420p", "yuvj420p")


@dataclass(frozen=True)
class Frame:
    """One frame of a film."""

    index: int  # index among the decoded frames, from 0
    pts: int | None  # timestamp of the stream in units of its time base
    # luma (height, width) and chroma (ceil(height / 2), ceil(width / 2)); grey chroma is 128
    y: Plane
    u: Plane
    v: Plane
    corrupt: bool = False  # whether the decoder marks the frame as damaged
    interlaced: bool = False  # whether the stream declares the frame as two fields

    def copy(self) -> Frame:
        """Return a copy of the frame that is independent of the decoder."""
        return Frame(
            self.index, self.pts, self.y.copy(), self.u.copy(), self.v.copy(), self.corrupt, self.interlaced
        )


@dataclass(frozen=True)
class Orientation:
    """Conversion of a coded picture for display: to square pixels, then mirrored, then rotated (`numpy.rot90`)."""

    quarters: int = 0
    mirrored: bool = False
    aspect: float = 1.0  # width of a coded pixel divided by its height

    def size(self, width: int, height: int) -> tuple[int, int]:
        """Return the size of a picture after conversion to square pixels, before rotation; one side is enlarged."""
        return round(width * max(self.aspect, 1.0)), round(height * max(1.0 / self.aspect, 1.0))

    def apply(self, plane: Plane) -> Plane:
        """Rotate a plane; without a rotation the plane itself is returned."""
        if self.mirrored:
            plane = plane[:, ::-1]
        if self.quarters:
            plane = np.rot90(plane, self.quarters)
        return np.ascontiguousarray(plane) if self.mirrored or self.quarters else plane


def planes_of(frame: Any, index: int, orientation: Orientation) -> Frame:
    """Convert a decoded PyAV frame to a `Frame`; formats other than 8 bit 4:2:0 are converted to this format first."""
    pts = None if frame.pts is None else int(frame.pts)
    if frame.format.name not in _PLANAR_420:
        frame = frame.reformat(format="yuv420p")
    y, u, v = map(_view, frame.planes)
    if orientation.aspect != 1.0:
        width, height = orientation.size(frame.width, frame.height)
        y = _resized(y, width, height)
        u, v = (_resized(plane, -(-width // 2), -(-height // 2)) for plane in (u, v))
    if orientation.quarters or orientation.mirrored:
        y, u, v = map(orientation.apply, (y, u, v))
    damaged, interlaced = (bool(getattr(frame, name, False)) for name in ("is_corrupt", "interlaced_frame"))
    return Frame(index, pts, y, u, v, damaged, interlaced)


def orientation_of(frame: Any, stream: Any) -> Orientation:
    """Read the display matrix of a frame and the shape of the pixels of its stream.

    Only rotations by multiples of 90 degrees and mirrors are applied; other matrices are ignored.
    """
    data, aspect = frame.side_data.get("DISPLAYMATRIX"), _pixel_aspect(stream)
    if data is None:
        return Orientation(aspect=aspect)
    a, b, _, c, d, *_ = struct.unpack("<9i", bytes(data)[:36])
    signs = tuple(int(np.sign(round(entry / 65536))) for entry in (a, b, c, d))
    return replace(_ORIENTATIONS.get(signs, Orientation()), aspect=aspect)


_WIDEST_PIXEL = 4.0
"""Largest ratio of width to height of a pixel, or of height to width; if the header states a larger ratio, pixels are
taken as square [1]. Chosen: anamorphic films have 4:3; a larger value accepts damaged headers, a smaller one distorts
films."""


def _pixel_aspect(stream: Any) -> float:
    """Return the ratio of width to height of a pixel; 1 without a plausible value in the film."""
    stated = float(stream.sample_aspect_ratio or stream.codec_context.sample_aspect_ratio or 1)
    return stated if 1 / _WIDEST_PIXEL <= stated <= _WIDEST_PIXEL else 1.0


# (a, b, c, d) maps coded (x, y) to shown (a x + c y, b x + d y), y downwards.
_ORIENTATIONS: dict[tuple[int, ...], Orientation] = {
    (1, 0, 0, 1): Orientation(),
    (0, 1, -1, 0): Orientation(quarters=3),
    (-1, 0, 0, -1): Orientation(quarters=2),
    (0, -1, 1, 0): Orientation(quarters=1),
    (-1, 0, 0, 1): Orientation(mirrored=True),
    (1, 0, 0, -1): Orientation(quarters=2, mirrored=True),
    (0, -1, -1, 0): Orientation(quarters=3, mirrored=True),
    (0, 1, 1, 0): Orientation(quarters=1, mirrored=True),
}


def _resized(plane: Plane, width: int, height: int) -> Plane:
    return np.asarray(cv2.resize(plane, (width, height), interpolation=cv2.INTER_CUBIC), dtype=np.uint8)


def _view(plane: Any) -> Plane:
    return np.ndarray((plane.height, plane.width), np.uint8, plane, 0, (plane.line_size, 1))


MAX_PIXELS = 64_000_000
"""Largest picture that is decoded [pixels]. Chosen: to limit memory, because a small file can declare a picture larger
than the memory."""
MIN_SIDE = 32
"""Smallest side of a picture in which markers can be distinguished [px]. Chosen: a smaller value accepts icons, a
larger one refuses cropped films."""

# Without these lists a text file named .mp4 can make the library open other files or the network.
_CONTAINER_OPTIONS = {
    "format_whitelist": "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,gif,mpeg,mpegts,asf,flv,ogg,image2,"
    "h264,hevc,mpegvideo,mjpeg,rawvideo",
    "protocol_whitelist": "file",
}
# streams without a container have no timestamps, and numbered pictures have no rate
_WITHOUT_RATE = {"h264", "hevc", "mpegvideo", "mjpeg", "image2"}
_PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
_FILM_SUFFIXES = {suffix for suffixes in FILMS.values() for suffix in suffixes}
_RATE_TAGS = ("com.android.capture.fps", "capture_fps", "CAPTURE_FPS")

# The locks of the library's logging can deadlock with decoding threads.
av.logging.set_level(None)


@dataclass(frozen=True)
class ClipInfo:
    """Metadata of a film file; the number of frames is never taken from the metadata."""

    path: Path  # the file
    # size of the picture with square pixels, before any rotation
    width: int
    height: int
    container_fps: float  # frames per second of the container; NaN if it declares none
    frames_declared: int  # number of frames in the header; 0 if it declares none
    tag_fps: float | None  # capture rate from a tag of the camera (slow motion); None without a tag
    # names of the codec and of the pixel format
    codec: str
    pixel_format: str
    time_base: Fraction  # unit of the timestamps in s
    # duration in a header that has no number of frames [s]; otherwise NaN
    duration_declared: float = float("nan")


@contextlib.contextmanager
def opened(path: Path, threads: int = 1) -> Iterator[tuple[Any, Any]]:
    """Open a film and yield (container, video stream); raise `VideoError` if it cannot be read."""
    source: str | FrameStream = str(path.resolve())
    form, own_options = None, dict[str, str]()
    if path.is_dir():
        source, own_options = _numbered_pictures(path)
        form = "image2"
    else:
        _check_file(path)
    if _is_photron(path) or _is_stack(path):
        source, own_options = _raw_frames(path)
        form = "rawvideo"
    try:
        container = av.open(
            source,
            format=form,
            options={**_CONTAINER_OPTIONS, **own_options},
            metadata_errors="replace",
            timeout=(10.0, 60.0),
        )
    except (av.error.FFmpegError, ValueError, OSError) as error:
        raise VideoError(
            f"{path} is not a film that can be read ({_reason(error)}).",
            f"Films: {', '.join(FILMS)}. A truncated copy has no index; copy it again.",
        ) from error
    frames = contextlib.closing(source) if isinstance(source, FrameStream) else contextlib.nullcontext()
    with frames, container:
        if not container.streams.video:
            raise VideoError(f"{path} contains no video stream.", "Give the film itself.")
        stream = container.streams.video[0]
        if stream.codec_context is None:
            what = f"There is no decoder for the codec of {path}."
            raise VideoError(what, "Copy the film again, or convert it to H.264.")
        _check_sides(path, int(stream.codec_context.width), int(stream.codec_context.height))
        stream.codec_context.options = {"max_pixels": str(MAX_PIXELS)}
        stream.codec_context.thread_type = "FRAME" if threads > 1 else "NONE"
        stream.codec_context.thread_count = threads
        yield container, stream


def probe(path: Path) -> ClipInfo:
    """Read the metadata of a film: size, rates, frame count, tags."""
    with opened(path) as (container, stream):
        context = stream.codec_context
        without = _WITHOUT_RATE & set(str(container.format.name).split(","))
        rate = None if without else _nominal_rate(stream)
        width, height = Orientation(aspect=_pixel_aspect(stream)).size(context.width, context.height)
        header = read_header(path) if _is_photron(path) else read_stack(path) if _is_stack(path) else None
        if isinstance(header, TiffStack) and header.fps is None:
            rate = None  # the rate of a stream of raw pixels is arbitrary
        return ClipInfo(
            path=path,
            width=width,
            height=height,
            container_fps=float(rate) if rate else float("nan"),
            frames_declared=header.frames if header else int(stream.frames),
            tag_fps=header.fps if header else _stated_rate(path, container, stream),
            codec=str(context.name),
            pixel_format=str(context.pix_fmt),
            time_base=Fraction(stream.time_base),
            duration_declared=_declared_duration(container, stream),
        )


def _declared_duration(container: Any, stream: Any) -> float:
    """Return the declared duration of a film whose header has no number of frames [s]; otherwise NaN."""
    if stream.frames or not container.duration or len(container.streams) != 1:
        return float("nan")  # a sound track may be longer than the video
    return float(container.duration / av.time_base)


_MISSING = 1.2
"""Largest ratio of the nominal rate to the average rate that missing frames explain [1]. Chosen: a smaller value uses
an average rate biased by missing frames, a larger one uses a nominal rate that is only the inverse of an unusual time
base."""


def _nominal_rate(stream: Any) -> Any:
    """Return the nominal rate of a stream if missing frames may explain its excess over the average, else the average.

    Missing frames bias the average rate. Unusual time bases bias the nominal rate.
    """
    average, nominal = stream.average_rate, stream.base_rate
    if average and nominal and 1.0 <= float(nominal / average) < _MISSING:
        return nominal
    return average or stream.guessed_rate


def is_film(path: Path) -> bool:
    """Return whether a path has the suffix of a film, or is a folder of numbered pictures."""
    return path.suffix.lower() in _FILM_SUFFIXES or (path.is_dir() and bool(_pictures_in(path)))


def _pictures_in(folder: Path) -> list[Path]:
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in _PICTURES and re.search(r"\d+$", p.stem))


def _numbered_pictures(folder: Path) -> tuple[str, dict[str, str]]:
    """Return the pattern of the names of the pictures in a folder, and the number of the first picture."""
    pictures = _pictures_in(folder)
    if not pictures:
        raise VideoError(
            f"{folder} contains no numbered pictures.", "Give a film, or pictures like img_0001.png."
        )
    parts = {(m[1], len(m[2]) if m[2].startswith("0") else 0, p.suffix) for p in pictures
             if (m := re.fullmatch(r"(.*?)(\d+)", p.stem))}  # fmt: skip
    heads = {(head, suffix) for head, _, suffix in parts}
    widths = {width for _, width, _ in parts} - {0}
    if len(heads) > 1 or len(widths) > 1:
        what = f"{folder} contains pictures of several series, for example {pictures[0].name} and {pictures[-1].name}."
        raise VideoError(what, "Put each series into a separate folder.")
    ((head, suffix),) = heads
    numbers = sorted(int(p.stem[len(head) :]) for p in pictures)
    lost = numbers[-1] - numbers[0] + 1 - len(numbers)
    if lost:
        first = next(a + 1 for a, b in pairwise(numbers) if b != a + 1)
        raise VideoError(
            f"{folder}: {lost} pictures are missing; the first missing number is {first}.",
            "The times follow from the numbers of the pictures: add the missing pictures.",
        )
    digits = f"%0{widths.pop()}d" if widths else "%d"
    # `head` is empty if a name is only a number; joining a path with an empty name would add no separator
    escaped = f"{folder.resolve()}{os.sep}{head}".replace("%", "%%")
    return f"{escaped}{digits}{suffix}", {"start_number": str(numbers[0])}


def _is_photron(path: Path) -> bool:
    return path.suffix.lower() == PHOTRON and path.is_file()


def _is_stack(path: Path) -> bool:
    return path.suffix.lower() in TIFF and path.is_file()


def _raw_frames(path: Path) -> tuple[FrameStream, dict[str, str]]:
    """Return the frames of a Photron camera or of a TIFF stack, and the options for their demultiplexer."""
    header = read_header(path) if _is_photron(path) else read_stack(path)
    _check_sides(path, header.width, header.height)
    frames: FrameStream
    if isinstance(header, TiffStack):
        frames, pixels, finest = TiffFrames(header), "rgb24" if header.colour else "gray", 100_000
    else:
        frames, pixels, finest = GreyFrames(header), "gray", 1000
    size, rate = f"{header.width}x{header.height}", Fraction(header.fps or 1.0).limit_denominator(finest)
    return frames, {"video_size": size, "pixel_format": pixels, "framerate": str(rate)}


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file's bytes in hexadecimal.

    For a film in several files (pictures in a folder, frames beside a header), the result is the SHA-256 of the digests
    of all files.
    """
    if path.is_dir():
        return hashlib.sha256("".join(map(file_sha256, _pictures_in(path))).encode()).hexdigest()
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if _is_photron(path) and (frames := raw_file(path)).is_file():
        return hashlib.sha256((digest + file_sha256(frames)).encode()).hexdigest()
    return digest


def _check_file(path: Path) -> None:
    if not path.exists():
        raise VideoError(f"There is no file {path}.", "Check the path.")
    if not path.is_file():
        raise VideoError(f"{path} is not a regular file.", "Give one film file.")
    try:
        size = path.stat().st_size
        with path.open("rb"):
            pass
    except OSError as error:
        raise VideoError(f"{path} cannot be opened: {error.strerror}.", "Check its permissions.") from error
    if size == 0:
        raise VideoError(f"{path} is empty (0 bytes).", "Copy the film from the camera again.")


def _check_sides(path: Path, width: int, height: int) -> None:
    if width * height > MAX_PIXELS:
        what = f"{path} declares frames of {width}x{height} px, too large to decode."
        raise VideoError(what, "Scale the film down.")
    if min(width, height) < MIN_SIDE:
        what = f"{path} has frames of {width}x{height} px, too small to show markers."
        raise VideoError(what, f"Give a film with at least {MIN_SIDE} px on each side.")


def _stated_rate(path: Path, container: Any, stream: Any) -> float | None:
    return _tagged_rate(container.metadata) or _tagged_rate(stream.metadata) or _sony_rate(path)


_SLOWEST = 1.0
"""Smallest plausible capture rate in a tag [1/s]. Chosen: a smaller value accepts empty tags, a larger one ignores time
lapses."""
_FASTEST = 1.0e6
"""Largest plausible capture rate in a tag [1/s]. Chosen: a larger value accepts damaged tags, a smaller one ignores
fast cameras."""


def _tagged_rate(metadata: Any) -> float | None:
    for tag in _RATE_TAGS:
        with contextlib.suppress(KeyError, ValueError, TypeError):
            value = float(metadata[tag])
            if _SLOWEST <= value <= _FASTEST:
                return value
    return None


_SONY_RATE = re.compile(rb'<VideoFrame\b[^>]*\bcaptureFps="([0-9.]+)[pi]"')
_LONGEST_XML = 2**20
"""Largest part of an XML description that is read [bytes]. Chosen: to limit memory; the capture rate is not found if it
is beyond this part."""


def _sony_rate(path: Path) -> float | None:
    """Return the capture rate in the XML of a Sony camera: in the film (box ``meta``), or beside it (``C0001M01.XML``).

    The XML is searched for one attribute and not parsed.
    """
    beside = [path.with_name(f"{path.stem}M01{suffix}") for suffix in (".XML", ".xml")]
    texts = [b.read_bytes()[:_LONGEST_XML] for b in beside if b.is_file()] if path.is_file() else []
    if path.suffix.lower() in {".mp4", ".mov", ".m4v"} and path.is_file():
        texts += _meta_boxes(path)
    rates = (float(m[1]) for m in map(_SONY_RATE.search, texts) if m)
    return next((rate for rate in rates if _SLOWEST <= rate <= _FASTEST), None)


def _meta_boxes(path: Path) -> list[bytes]:
    """Return the boxes ``meta`` at the top level of an MP4 file."""
    found: list[bytes] = []
    at = 0
    with path.open("rb") as file:
        size = file.seek(0, 2)
        while at + 16 <= size and len(found) < 8:
            file.seek(at)
            head = file.read(16)
            length = int.from_bytes(head[:4], "big")
            length = int.from_bytes(head[8:], "big") if length == 1 else length or size - at
            if head[4:8] == b"meta":
                file.seek(at)
                found.append(file.read(min(length, _LONGEST_XML)))
            if length < 8:
                break
            at += length
    return found


def _reason(error: Exception) -> str:
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return str(text).strip().rstrip(".").lower()


def packets_of(packets: Any) -> Iterator[Any]:
    """Yield the packets of a demultiplexer up to the end of the file, or to its first damage."""
    while True:
        try:
            packet = next(packets, None)
        except av.error.FFmpegError:
            return
        if packet is None or packet.size == 0:
            return
        yield packet


def decode_past_damage(packets: Any, most_bad: int) -> Iterator[tuple[Any, int]]:
    """Decode packets in order, and skip damaged packets.

    Decoding stops if the number of damaged packets exceeds `most_bad` plus twice the number of decoded frames.

    The function yields (frame, number of damaged packets so far), and at the end (None, total number of damaged
    packets).
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
    """The packets of a film that have a timestamp, in the order of their timestamps."""

    # shape (n,); timestamps in units of the time base, and sizes in bytes
    stamps: Integers
    size: Integers
    key: Bools  # shape (n,); whether packets are key frames
    complete: bool  # whether all packets of the film have a timestamp
    # whether the container stores the timestamps of the frames; AVI and raw streams only count packets
    exact: bool = True


def read_packets(path: Path) -> Packets:
    """Read timestamps, sizes and key flags of a film's packets, without decoding."""
    with opened(path) as (container, stream):
        exact = any(name in str(container.format.name) for name in ("mp4", "matroska"))
        found = [(p.pts, p.size, p.is_keyframe) for p in packets_of(container.demux(stream))]
    stamped = sorted(p for p in found if p[0] is not None)
    stamps, size, key = zip(*stamped, strict=True) if stamped else ((), (), ())
    return Packets(
        np.array(stamps, dtype=np.int64),
        np.array(size, dtype=np.int64),
        np.array(key, dtype=np.bool_),
        len(stamped) == len(found),
        exact,
    )
