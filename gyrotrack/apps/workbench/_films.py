"""The clips of a case and their frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np

from gyrotrack._errors import VideoError
from gyrotrack.apps.report._frames import jpeg
from gyrotrack.plotting._frames import Film, Picture, find_film
from gyrotrack.plotting._tracking import on_clock
from gyrotrack.tracking._colour import colour_name
from gyrotrack.tracking._profile import parse, to_toml

if TYPE_CHECKING:
    from gyrotrack.io._records import Case, Recording


SHOWN_WIDTH = 720
QUALITY = 80
_AROUND = 3


@dataclass
class _Clip:
    recording: Recording
    path: Path | None
    film: Film | None = None


class Clips:
    """The clips of a case; films are opened when a frame is first asked for.

    Parameters
    ----------
    case : Case or None
        The case with its recordings.
    folders : sequence of Path
        Where films may lie.
    """

    def __init__(self, case: Case | None, folders: Sequence[Path]) -> None:
        self._lock = Lock()
        self._case = case
        found = case.recordings if case is not None else {}
        self._clips = {k: _Clip(r, find_film(r, list(folders))) for k, r in found.items()}

    def document(self) -> list[dict[str, Any]]:
        """Return what the page needs to know of each clip."""
        rows = []
        for key, clip in self._clips.items():
            r = clip.recording
            placement = self._case.placements.get(key) if self._case is not None else None
            time = r.time if placement is None else on_clock(placement, r.time)
            if not len(time):
                continue
            rows.append(
                {
                    "key": key,
                    "source": r.source,
                    "body": r.body,
                    "frames": len(time),
                    "start": float(time[0]),
                    "stop": float(time[-1]),
                    "rate": float(r.capture_fps),
                    "width": int(r.width),
                    "height": int(r.height),
                    "found": clip.path is not None,
                    "markers": [{"name": m.name, "body": m.body} for m in r.markers.values()],
                }
            )
        return rows

    def frame(self, key: str, index: int, *, overlay: bool) -> bytes:
        """Return a frame as JPEG.

        Raises
        ------
        VideoError
            If there is no such clip, film, or frame.
        """
        with self._lock:
            picture = self._film(key).picture(index, overlay=overlay)
        if picture is None:
            raise VideoError(f"frame {index} of {self._clips[key].recording.source} cannot be shown")
        return jpeg(picture, SHOWN_WIDTH, QUALITY)

    def colour(self, key: str, index: int, x: float, y: float) -> dict[str, Any]:
        """Return the colour at a place of a frame (0 to 1 across and down): its name, and red, green, blue."""
        with self._lock:
            picture = self._film(key).picture(index, overlay=False)
        if picture is None:
            raise VideoError(f"frame {index} of {self._clips[key].recording.source} cannot be shown")
        return colour_at(picture, x, y)

    def _film(self, key: str) -> Film:
        clip = self._clips.get(key)
        if clip is None or clip.path is None:
            raise VideoError("the film of this clip was not found", "name its folder with --films")
        if clip.film is None:
            clip.film = Film(clip.path, clip.recording).__enter__()
        return clip.film

    def close(self) -> None:
        """Close all films."""
        with self._lock:
            for clip in self._clips.values():
                if clip.film is not None:
                    clip.film.__exit__(None, None, None)
                    clip.film = None


def colour_at(picture: Picture, x: float, y: float) -> dict[str, Any]:
    """Return the median colour about a place (0 to 1 across and down): its name, and red, green, blue."""
    height, width = picture.shape[:2]
    row, column = int(np.clip(y, 0, 1) * (height - 1)), int(np.clip(x, 0, 1) * (width - 1))
    patch = picture[
        max(0, row - _AROUND) : row + _AROUND + 1, max(0, column - _AROUND) : column + _AROUND + 1
    ]
    blue, green, red = (int(v) for v in np.median(patch.reshape(-1, 3), axis=0))
    return {"colour": colour_name(red, green, blue), "rgb": [red, green, blue]}


class SourceFrames:
    """The frames of films that are not tracked yet; the film that was used last stays open."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._path: Path | None = None
        self._film: Film | None = None

    def picture(self, path: Path, index: int) -> Picture:
        """Return a frame in colour (BGR).

        Raises
        ------
        VideoError
            If there is no such film or frame.
        """
        with self._lock:
            if path != self._path or self._film is None:
                self._end()
                self._film, self._path = Film(path).__enter__(), path
            picture = self._film.picture(index)
        if picture is None:
            raise VideoError(f"frame {index} of {path.name} cannot be shown")
        return picture

    def _end(self) -> None:
        if self._film is not None:
            self._film.__exit__(None, None, None)
        self._film = None

    def close(self) -> None:
        """Close the film."""
        with self._lock:
            self._end()


def profile_text(wanted: Any) -> str:
    """Return a profile as TOML from what was picked on a frame.

    Raises
    ------
    ProfileError
        Naming everything that is wrong.
    """
    data = wanted if isinstance(wanted, dict) else {}
    allowed = {k: data[k] for k in ("name", "centre", "circle_colour", "marker") if k in data}
    return to_toml(parse(allowed, "profile"))
