"""Writing of rendered films: colour planes, sensor noise, encoding.

A chroma sample (i, j) is centred at the luma position x = 2 i, y = 2 j + 1/2, the default of H.264. The conversion is
implemented here because common scalers differ by half a luma pixel.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gyrotrack.io._atomic import new_path

Frame = NDArray[np.uint8]

KR, KB = 0.2126, 0.0722
_Y = np.array([KR, 1.0 - KR - KB, KB])
_CB = (np.array([0.0, 0.0, 1.0]) - _Y) / (2.0 * (1.0 - KB))
_CR = (np.array([1.0, 0.0, 0.0]) - _Y) / (2.0 * (1.0 - KR))
TO_LUMA = np.append(_Y * 219.0 / 255.0, 16.0)[None]
TO_CHROMA = np.stack([np.append(_CB * 224.0 / 255.0, 128.0), np.append(_CR * 224.0 / 255.0, 128.0)])


def to_planes(picture: Frame) -> tuple[Frame, Frame, Frame]:
    """Convert (height, width, 3) red, green, blue to Y (height, width), and Cb and Cr of half the size."""
    height, width = picture.shape[:2]
    luma = cv2.transform(picture, TO_LUMA)
    half = (width // 2, height // 2)
    right = cv2.resize(picture, half, interpolation=cv2.INTER_AREA)  # columns 2 i and 2 i + 1
    shifted = np.empty_like(picture)
    shifted[:, 1:], shifted[:, 0] = picture[:, :-1], picture[:, 0]
    left = cv2.resize(shifted, half, interpolation=cv2.INTER_AREA)  # columns 2 i - 1 and 2 i
    chroma = cv2.transform(cv2.addWeighted(left, 0.5, right, 0.5, 0.0), TO_CHROMA)
    blue, red = cv2.split(chroma)
    return luma, blue, red  # type: ignore[return-value]


BANKS = 4
MARGIN = 96  # margin of a bank [px], for 9216 different crops


class Noise:
    """Gaussian noise in grey levels, rounded to integers, independent in every pixel and colour.

    Parameters
    ----------
    height, width : int
        Size of the frames in px.
    deviation : float
        Standard deviation in grey levels; rounding adds a variance of 1/12.
    rng : numpy.random.Generator
        Random generator.
    """

    def __init__(self, height: int, width: int, deviation: float, rng: np.random.Generator) -> None:
        self._rng, self._size = rng, (height, width)
        shape = (height + MARGIN, width + MARGIN, 3)
        self._banks = []
        for _ in range(BANKS if deviation > 0.0 else 0):
            grain = np.rint(rng.standard_normal(shape, dtype=np.float32) * np.float32(deviation))
            self._banks.append(np.clip(grain, -127, 127).astype(np.int8))

    def on(self, picture: Frame) -> Frame:
        """Return the picture with independent noise."""
        if not self._banks:
            return picture
        bank = self._banks[int(self._rng.integers(BANKS))]
        top, left = (int(n) for n in self._rng.integers(MARGIN, size=2))
        grain = bank[top : top + self._size[0], left : left + self._size[1]]
        return cv2.add(picture, grain, dtype=cv2.CV_8U)  # type: ignore[return-value]


BT709, LIMITED = 1, 1  # codes in H.264: matrix, primaries and transfer function; range


@dataclass(frozen=True)
class Film:
    """Options of the encoder.

    Attributes
    ----------
    crf : int
        Constant rate factor of x264: 0 lossless, 18 very good, 23 default, 28 poor.
    preset : str
        Preset of x264, "ultrafast" to "veryslow".
    keyframe : int
        Largest number of frames between key frames.
    bframes : int
        Largest number of consecutive B-frames; most cameras write none.
    tag_capture_fps : bool
        Write the capture rate to the metadata, as some phones do (``com.android.capture.fps``).
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
    """Encode frames (height, width, 3) red, green, blue, and return their number.

    Parameters
    ----------
    path : Path
        The mp4 file, which is written atomically.
    frames : iterable of arrays
        The frames.
    fps, container_fps : float
        Capture rate, and rate in the container (None: the same) [1/s].
    force : bool
        Replace an existing file.

    Raises
    ------
    OutputError
        The file exists or cannot be written.
    """
    film = film or Film()
    path = Path(path)
    with new_path(path, force=force) as part:
        return _encode(part, frames, (width, height), fps, Fraction(container_fps or fps), film)


def _encode(
    part: Path, frames: Iterable[Frame], size: tuple[int, int], fps: float, stored: Fraction, film: Film
) -> int:
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
