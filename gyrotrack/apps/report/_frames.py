"""Contact sheets of the clips for a report."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gyrotrack.plotting._tracking import on_clock

if TYPE_CHECKING:
    from gyrotrack.io._records import Case, Placement, Recording


_FRAMES = 6
_MAX_CLIPS = 12
_WIDTH = 320
_QUALITY = 78


@dataclass(frozen=True)
class Tile:
    """One frame as JPEG, with a description."""

    jpeg: bytes
    text: str

    @property
    def url(self) -> str:
        """The picture as a data URL."""
        return "data:image/jpeg;base64," + base64.b64encode(self.jpeg).decode("ascii")


@dataclass(frozen=True)
class Sheet:
    """Frames of one clip."""

    clip: str
    tiles: tuple[Tile, ...]


def contact_sheets(
    case: Case, folders: Sequence[Path], intervals: Iterable[tuple[float, float]] = ()
) -> list[Sheet]:
    """Return frames of the clips of a case whose films are found.

    Parameters
    ----------
    case : Case
        The case with its recordings.
    folders : sequence of Path
        Folders that may contain the films.
    intervals : iterable of (float, float)
        Intervals of interest on the clock of the case [s], such as those with lack of fit; the frame at the middle of
        each is included.
    """
    wanted = list(intervals)
    sheets = []
    for key, r in list(case.recordings.items())[:_MAX_CLIPS]:
        tiles = _tiles(r, case.placements.get(key), folders, wanted)
        if tiles:
            sheets.append(Sheet(r.source, tuple(tiles)))
    return sheets


def _tiles(
    r: Recording,
    placement: Placement | None,
    folders: Sequence[Path],
    intervals: Sequence[tuple[float, float]],
) -> list[Tile]:
    from gyrotrack._errors import GyrotrackError
    from gyrotrack.plotting._frames import Film, find_film

    path = find_film(r, list(folders))
    if path is None:
        return []
    tiles = []
    try:
        with Film(path, r) as film:
            for index in _selected_frames(r, placement, intervals):
                picture = film.picture(index)
                if picture is not None:
                    tiles.append(Tile(jpeg(picture, _WIDTH), _description(r, placement, index)))
    except GyrotrackError:  # an unreadable film must not prevent the report
        return tiles
    return tiles


def jpeg(
    picture: np.ndarray[tuple[int, ...], np.dtype[np.uint8]], width: int, quality: int = _QUALITY
) -> bytes:
    """Return a picture (BGR) as JPEG, downscaled to `width` if it is wider."""
    import cv2

    if picture.shape[1] > width:
        height = max(1, round(picture.shape[0] * width / picture.shape[1]))
        picture = np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes())


def _selected_frames(
    r: Recording, placement: Placement | None, intervals: Sequence[tuple[float, float]]
) -> list[int]:
    """Return frames evenly distributed over the clip, some of them moved to the middle of intervals of interest."""
    spread = [int(i) for i in np.linspace(0, len(r.time) - 1, min(_FRAMES, len(r.time)))]
    if placement is None or not spread:
        return spread
    time = on_clock(placement, r.time)
    middles = [0.5 * (a + b) for a, b in intervals]
    inside = [int(np.argmin(np.abs(time - m))) for m in middles if time[0] <= m <= time[-1]]
    for index in inside[: _FRAMES // 2]:
        nearest = min(range(1, len(spread) - 1), key=lambda k: abs(spread[k] - index), default=0)
        spread[nearest] = index
    return sorted(set(spread))


def _description(r: Recording, placement: Placement | None, index: int) -> str:
    from gyrotrack.io._schema import STATUS

    names = {code: word.replace("_", " ") for word, code in STATUS.items()}
    time = r.time[index] if placement is None else on_clock(placement, r.time)[index]
    markers = ", ".join(f"{m.name} {names.get(int(m.status[index]), 'unknown')}" for m in r.markers.values())
    return f"frame {index}, {time:.3f} s: {markers}"
