"""Films of Photron high-speed cameras: a text header (``.cih``) beside the raw frames (``.mraw``).

The header has one entry per line, ``Image Width : 1024``. The frames follow each other without gaps. A pixel has
``Color Bit`` bits. Pixels of 8, 10 and 12 bits are packed with the most significant bit first; pixels of 16 bits are
little-endian. ``EffectiveBit Depth`` is the number of bits that contain the measured value: either the lower or the
higher bits (``EffectiveBit Side``).

Sources: headers written by PFV and by the PDC library of Photron; the bits are packed as in pyMRAW.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gyrotrack._errors import VideoError
from gyrotrack.video._frame_stream import FrameStream

SUFFIX = ".cih"
_LONGEST_HEADER = 2**16
"""Largest size of a header [bytes]. Chosen: headers of cameras have 3 to 10 kB; a larger value reads files that are not
headers."""
_LARGEST_SIDE = 2**15
"""Largest side of a picture [px]. Chosen: sensors have at most 4096 px; a larger value accepts damaged headers."""
_FASTEST = 1e8
"""Largest capture rate [1/s]. Chosen: a larger value accepts damaged headers, a smaller one refuses fast cameras."""
_PACKED = (8, 10, 12)
"""Sizes of pixels that are packed [bits]. Source: headers written by PFV and by the PDC library of Photron."""
_WORDS = 16
"""Size of pixels that are words [bits]. Source: headers written by PFV and by the PDC library of Photron."""
_AGAIN = "Save the film again as MRAW, or as an uncompressed AVI."


@dataclass(frozen=True)
class PhotronHeader:
    """Content of a header, checked against the size of the file of frames."""

    path: Path  # the header
    fps: float  # capture rate [1/s]
    frames: int
    # size of a frame [px]
    width: int
    height: int
    bits: int  # bits of a pixel in the file
    first_bit: int  # first of the eight bits that are used, counted from the most significant bit
    mosaic: bool  # whether neighbouring pixels have filters of different colours

    @property
    def raw(self) -> Path:
        """The file of the frames."""
        return raw_file(self.path)

    @property
    def frame_bytes(self) -> int:
        """Size of a frame in the file."""
        return self.width * self.height * self.bits // 8


def raw_file(header: Path) -> Path:
    """Return the file of the frames beside a header."""
    beside = (header.with_suffix(suffix) for suffix in (".mraw", ".MRAW", ".Mraw"))
    return next((path for path in beside if path.is_file()), header.with_suffix(".mraw"))


def read_header(path: Path) -> PhotronHeader:
    """Read a header and compare it with the frames; raise a `VideoError` if they cannot be used."""
    with path.open("rb") as file:
        content = file.read(_LONGEST_HEADER + 1)
    if len(content) > _LONGEST_HEADER:
        what = f"{path} has more than {_LONGEST_HEADER // 1024} kB and is not a header of a Photron camera."
        raise VideoError(what, "Give the .cih file that the camera saved beside the .mraw file.")
    lines = (line.partition(":") for line in content.decode("latin-1").splitlines())
    entry = {key.strip().casefold(): value.strip() for key, colon, value in lines if colon}
    width, height = (_whole(path, entry, f"Image {side}", _LARGEST_SIDE) for side in ("Width", "Height"))
    frames, bits = _whole(path, entry, "Total Frame"), _whole(path, entry, "Color Bit")
    colour = entry.get("color type", "Mono").casefold()
    if colour not in ("mono", "bayer") or bits not in (*_PACKED, _WORDS):
        what = f"{path} declares {colour} pixels of {bits} bits; mono and Bayer of 8, 10, 12 and 16 bits are read."
        raise VideoError(what, _AGAIN)
    depth = _whole(path, entry, "EffectiveBit Depth", bits)
    lower = entry.get("effectivebit side", "Lower").casefold() != "higher"
    first_bit = bits - depth if lower else 0
    header = PhotronHeader(
        path, _rate(path, entry), frames, width, height, bits, min(first_bit, bits - 8), colour == "bayer"
    )
    _check_length(header)
    return header


def _check_length(header: PhotronHeader) -> None:
    if not header.raw.is_file():
        what = f"The frames are missing: there is no file {header.raw.name} beside {header.path}."
        raise VideoError(what, "Copy both files of the camera into one folder.")
    size, expected = header.raw.stat().st_size, header.frames * header.frame_bytes
    if header.width * header.height * header.bits % 8 or size != expected:
        what = (
            f"{header.raw} has {size} bytes, but {header.frames} frames of {header.width}x{header.height} px with "
            f"{header.bits} bits have {expected}."
        )
        raise VideoError(what, "Copy both files from the camera again.")


def _entry(path: Path, entry: dict[str, str], key: str) -> str:
    try:
        return entry[key.casefold()]
    except KeyError:
        what = f"{path} has no entry '{key}' and is not a header of a Photron camera."
        raise VideoError(what, "Give the .cih file that the camera saved beside the .mraw file.") from None


def _whole(path: Path, entry: dict[str, str], key: str, most: int = 2**40) -> int:
    text = _entry(path, entry, key)
    if not (text.isascii() and text.isdigit() and len(text) < 14 and 1 <= int(text) <= most):
        raise VideoError(f"{path}: '{key}' is {text[:40]!r}, not a whole number from 1 to {most}.", _AGAIN)
    return int(text)


def _rate(path: Path, entry: dict[str, str]) -> float:
    text = _entry(path, entry, "Record Rate(fps)")
    try:
        rate = float(text)
    except ValueError:
        rate = math.nan
    if not 1.0 <= rate <= _FASTEST:
        what = f"{path}: 'Record Rate(fps)' is {text[:40]!r}, not a rate from 1 to {_FASTEST:.0e} frames/s."
        raise VideoError(what, _AGAIN)
    return rate


class GreyFrames(FrameStream):
    """The frames as grey pixels of 8 bits."""

    def __init__(self, header: PhotronHeader) -> None:
        super().__init__(header.frames, header.width * header.height)
        self._header = header
        self._file = header.raw.open("rb")

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def frame(self, number: int) -> bytes:
        """Return the pixels of a frame."""
        h = self._header
        self._file.seek(number * h.frame_bytes)
        grey = grey_of(np.frombuffer(self._file.read(h.frame_bytes), np.uint8), h.bits, h.first_bit)
        if h.mosaic:
            grey = without_mosaic(grey.reshape(h.height, h.width))
        return grey.tobytes()


def grey_of(raw: npt.NDArray[np.uint8], bits: int, first_bit: int) -> npt.NDArray[np.uint8]:
    """Return eight bits of each pixel, from `first_bit`, counted from the most significant bit; discard the others."""
    if bits == 8:
        return raw
    if bits == _WORDS:
        return (raw.view("<u2") >> (_WORDS - 8 - first_bit)).astype(np.uint8)
    pixels = np.unpackbits(raw).reshape(-1, bits)
    return np.packbits(pixels[:, first_bit : first_bit + 8], axis=1).ravel()


def without_mosaic(grey: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Return the mean of the 3 x 3 pixels about each pixel, with the weights 1, 2, 1 along both axes.

    The header does not state which pixel has which filter. With these weights every pixel contains a quarter of red, a
    half of green and a quarter of blue, independent of the start of the pattern.
    """
    total = np.pad(grey, 1, mode="reflect").astype(np.uint16)
    total = total[:-2] + 2 * total[1:-1] + total[2:]
    total = total[:, :-2] + 2 * total[:, 1:-1] + total[:, 2:]
    return np.asarray((total + 8) >> 4, dtype=np.uint8)
