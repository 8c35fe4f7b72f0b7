"""The films of the workbench: frames of the clips of a case, marker positions in frames, and previews of tracking.

The preview runs in a separate process, ``python -m gyrotrack.apps.workbench._films``, with a JSON request as its only
argument. An excerpt of the film is copied without decoding to a temporary folder. The functions that track films then
track the excerpt.
"""

from __future__ import annotations

import json
import signal
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

import av
import numpy as np
from numpy.typing import NDArray

from gyrotrack._errors import GyrotrackError, TrackingError, VideoError
from gyrotrack.io._records import Recording
from gyrotrack.io._schema import STATUS, STATUS_WORDS
from gyrotrack.io._scratch import scratch_folder
from gyrotrack.plotting._frames import Film, Picture, find_film
from gyrotrack.plotting._tracking import jpeg, on_clock
from gyrotrack.tracking._profile import PAPER, colour_name, load, parse, to_toml
from gyrotrack.video._container import opened, orientation_of, packets_of

if TYPE_CHECKING:
    from gyrotrack.io._records import Case
    from gyrotrack.tracking._tracked import Tracked

SHOWN_WIDTH = 720
QUALITY = 80
_HALF_PATCH = 3


@dataclass
class _Clip:
    recording: Recording
    path: Path | None
    film: Film | None = None
    middles: dict[str, float] | None = None


class Clips:
    """The clips of a case; a film in one of the folders is opened when its first frame is requested."""

    def __init__(self, case: Case | None, folders: Sequence[Path]) -> None:
        self._lock = Lock()
        self._case = case
        found = case.recordings if case is not None else {}
        self._clips = {k: _Clip(r, find_film(r, list(folders))) for k, r in found.items()}

    @property
    def folder(self) -> Path | None:
        """The folder of the first film that was found."""
        return next((c.path.resolve().parent for c in self._clips.values() if c.path is not None), None)

    def document(self) -> list[dict[str, Any]]:
        """Return the data of the clips for the page."""
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
        """Return a frame as JPEG; a VideoError is raised if the clip, film or frame does not exist."""
        return jpeg(self._picture(key, index, overlay=overlay), SHOWN_WIDTH, QUALITY)

    def marks(self, key: str, index: int) -> dict[str, Any]:
        """Return the centre and the markers in a frame [px], and the frame size, for the overlay of the page."""
        clip = self._clips.get(key)
        if clip is None or not 0 <= index < len(clip.recording.time):
            raise VideoError("There is no such frame.", "Reload the page.")
        if clip.middles is None:
            clip.middles = marker_middles(clip.recording, lambda k: self._picture(key, k, overlay=False))
        r, frame = clip.recording, slice(index, index + 1)
        return {
            "size": [int(r.width), int(r.height)],
            "centre": positions(r.centre[frame])[0],
            "markers": [
                m | {k: m[k][0] for k in ("place", "whole", "status", "corners")}
                for m in marker_positions(r, frame, clip.middles)
            ],
        }

    def colour(self, key: str, index: int, x: float, y: float) -> dict[str, Any]:
        """Return the colour at a position in a frame; see `colour_at`."""
        return colour_at(self._picture(key, index, overlay=False), x, y)

    def _picture(self, key: str, index: int, *, overlay: bool) -> Picture:
        clip = self._clips.get(key)
        if clip is None or clip.path is None:
            raise VideoError("The film of this clip was not found.", "Give its folder with --films.")
        with self._lock:
            if clip.film is None:
                clip.film = Film(clip.path, clip.recording).__enter__()
            picture = clip.film.picture(index, overlay=overlay)
        if picture is None:
            raise VideoError(f"Frame {index} of {clip.recording.source} cannot be decoded.")
        return picture

    def close(self) -> None:
        """Close all films."""
        with self._lock:
            for clip in self._clips.values():
                if clip.film is not None:
                    clip.film.__exit__(None, None, None)
                    clip.film = None


def colour_at(picture: Picture, x: float, y: float) -> dict[str, Any]:
    """Return name and RGB of the median colour around a position (x to the right, y down, each 0 to 1)."""
    height, width = picture.shape[:2]
    row, column = int(np.clip(y, 0, 1) * (height - 1)), int(np.clip(x, 0, 1) * (width - 1))
    rows, columns = (slice(max(0, k - _HALF_PATCH), k + _HALF_PATCH + 1) for k in (row, column))
    blue, green, red = (int(v) for v in np.median(picture[rows, columns].reshape(-1, 3), axis=0))
    return {"colour": colour_name(red, green, blue), "rgb": [red, green, blue]}


class SourceFrames:
    """Frames of films that are not tracked yet; the last film stays open."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._path: Path | None = None
        self._film: Film | None = None

    def picture(self, path: Path, index: int) -> Picture:
        """Return a frame in colour (BGR); a VideoError is raised if the film or frame does not exist."""
        with self._lock:
            if path != self._path or self._film is None:
                self._end()
                self._film, self._path = Film(path).__enter__(), path
            picture = self._film.picture(index)
        if picture is None:
            raise VideoError(f"Frame {index} of {path.name} cannot be decoded.")
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
    """Return the markers that the user clicked in a frame as a profile in TOML."""
    data = wanted if isinstance(wanted, dict) else {}
    allowed = {k: data[k] for k in ("name", "centre", "circle_colour", "marker") if k in data}
    return to_toml(parse(allowed, "profile"))


FRAMES = 500  # number of frames of a preview: 0.5 s at 1000 fps, 2 s at 250 fps, 8 s at 60 fps


def copy_excerpt(film: Path, target: Path, frames: int) -> None:
    """Copy the first packets of a film to a file of the same format; raise a TrackingError if this is impossible."""
    with opened(film) as (source, stream):
        try:
            with av.open(str(target), "w") as copy:
                out = copy.add_stream_from_template(stream)
                for n, packet in enumerate(packets_of(source.demux(stream))):
                    if n >= frames:
                        break
                    packet.stream = out
                    copy.mux(packet)
        except (av.error.FFmpegError, ValueError) as error:
            what = f"An excerpt of {film.name} cannot be copied ({error})."
            raise TrackingError(what, "Track the whole film.") from error
    if _orientation(film) != _orientation(target):
        what = f"An excerpt of {film.name} has another orientation than the film."
        raise TrackingError(what, "Track the whole film.")


def _orientation(path: Path) -> Any:
    with opened(path) as (container, stream):
        return orientation_of(next(container.decode(stream)), stream)


def preview(
    film: Path,
    *,
    profile: Path | None,
    hub: tuple[float, float] | None,
    makes: str = "recording",
    points: Sequence[tuple[float, float]],
    frames: int = FRAMES,
) -> dict[str, Any]:
    """Track the start of a film with the markers of a profile, by default the profile of the paper.

    If tracking `makes` a "case", the whole body is registered instead, and `points` (x, y) [px] of the first frame are
    rotated with the body. The result contains ``frames``; ``centre``, position [px] or null in each frame; ``markers``:
    name and body, and for each frame the position [px] or null and whether the marker is complete; ``kept``, fraction
    of frames with an angle, by body; ``warnings``.
    """
    with scratch_folder() as folder:
        excerpt = folder / f"excerpt{film.suffix.lower()}"
        copy_excerpt(film, excerpt, frames)
        recording, markers = _STARTS[makes](excerpt, profile, hub, points)
    count = recording.frames_decoded
    return {
        "frames": count,
        "centre": positions(recording.centre),
        "markers": markers,
        "kept": {name: len(b.time) / count for name, b in recording.bodies.items()},
        "sigma_mrad": {
            name: 1e3 * float(np.median(b.sigma)) for name, b in recording.bodies.items() if len(b.sigma)
        },
        # rates and timestamps of an excerpt are not meaningful
        "warnings": [w for w in recording.warnings if "container" not in w and "timestamps" not in w],
    }


def _of_markers(
    excerpt: Path,
    profile: Path | None,
    _hub: tuple[float, float] | None,
    _points: Sequence[tuple[float, float]],
) -> tuple[Recording, list[dict[str, Any]]]:
    from gyrotrack.tracking._extract import extract

    recording = extract(excerpt, PAPER if profile is None else load(profile), capture_fps=1.0)
    return recording, marker_positions(recording)


def _of_whole_body(
    excerpt: Path,
    _profile: Path | None,
    hub: tuple[float, float] | None,
    points: Sequence[tuple[float, float]],
) -> tuple[Recording, list[dict[str, Any]]]:
    from gyrotrack.apps._spindown import SpindownOptions, film_recording
    from gyrotrack.tracking import _film

    recording, tracked = film_recording(_film.Film(excerpt), SpindownOptions(hub, capture_fps=1.0))
    return recording, _rotated_points(recording, tracked, points)


# function that tracks the start of a film, by the kind of file that is made from the whole film
_STARTS = {"recording": _of_markers, "case": _of_whole_body}

# radius of the middle of a marker if the outer edge is not found [radius of the inner corners]
_MIDDLE = 1.15
# number and spacing of the frames in which the outer edge of a marker is searched for
_SAMPLED, _APART = 5, 8
_FARTHEST = 3.0  # largest radius of the search for the outer edge [radius of the inner corners]
_INSIDE = (1.04, 1.12)  # radii between which the colour of a marker is measured [radius of the inner corners]
_STEPS = 80


def marker_middles(recording: Recording, picture: Callable[[int], Picture]) -> dict[str, float]:
    """Return the radius of the middle of each marker, in radii of its inner corners, from frames of the film.

    A marker has uniform colour from its inner corners to its outer edge.
    """
    found, seen = {}, {}
    for m in recording.markers.values():
        known = np.flatnonzero((m.status == STATUS["ok"]) & np.isfinite(m.rho) & np.isfinite(m.angle_fine))
        edges = []
        for k in _spread(known):
            with suppress(GyrotrackError):
                if k not in seen:
                    seen[k] = picture(k)
                angle = float(recording.sense * m.angle_fine[k])
                edges.append(_outer_edge(seen[k], recording.centre[k], angle, float(m.rho[k])))
        edges = [e for e in edges if np.isfinite(e)]
        found[m.name] = 0.5 * (1.0 + float(np.median(edges))) if edges else _MIDDLE
    return found


def _spread(known: NDArray[np.intp]) -> list[int]:
    """Return a few of the first frames that show a marker; these frames can be decoded without seeking."""
    first = known[: _SAMPLED * _APART : _APART]
    return [int(k) for k in first]


def _outer_edge(picture: Picture, centre: NDArray[np.float64], angle: float, radius: float) -> float:
    """Return the radius of the outer edge of a marker, in radii of its inner corners; nan without an edge."""
    share = np.linspace(_INSIDE[0], _FARTHEST, _STEPS)
    place = centre + radius * share[:, None] * np.array([np.cos(angle), -np.sin(angle)])
    column, row = np.rint(place).astype(int).T
    seen = (row >= 0) & (row < picture.shape[0]) & (column >= 0) & (column < picture.shape[1])
    share, colours = share[seen], picture[row[seen], column[seen]].astype(np.float64)
    inside = share <= _INSIDE[1]
    if inside.sum() < 1 or len(share) == inside.sum():
        return float("nan")
    apart = np.linalg.norm(colours - np.median(colours[inside], axis=0), axis=1)
    outside = np.flatnonzero(apart > 0.5 * apart.max())
    return float(share[outside[0]]) if len(outside) else float("nan")


def marker_positions(
    recording: Recording, frames: slice = slice(None), middles: Mapping[str, float] | None = None
) -> list[dict[str, Any]]:
    """Return the markers in given frames: name, body, middle [px] or None, completeness, status and inner corners."""
    found = []
    for m in recording.markers.values():
        known = np.isfinite(m.rho)
        radius = float(np.median(m.rho[known])) if known.any() else float("nan")
        angle = recording.sense * m.angle_fine[frames]
        place = recording.centre[frames] + radius * (middles or {}).get(m.name, _MIDDLE) * np.stack(
            [np.cos(angle), -np.sin(angle)], axis=1
        )
        status = m.status[frames]
        corners = m.corner[frames]
        found.append(
            {
                "name": m.name,
                "body": m.body,
                "place": positions(place),
                "whole": (status == STATUS["ok"]).tolist(),
                "status": [STATUS_WORDS[int(s)] for s in status],
                "corners": [
                    np.round(c, 2).tolist() if np.isfinite(c).all() and s == STATUS["ok"] else None
                    for c, s in zip(corners, status, strict=True)
                ],
            }
        )
    return found


def _rotated_points(
    recording: Recording, tracked: Tracked, points: Sequence[tuple[float, float]]
) -> list[dict[str, Any]]:
    """Rotate points of the first frame about the hub by the measured angle."""
    hub = complex(*tracked.ring.hub)
    if not points:  # by default, a single point on the ring is shown
        points = [(hub.real + 0.5 * (tracked.ring.inner + tracked.ring.outer), hub.imag)]
    found = []
    for n, point in enumerate(points, 1):
        place = np.full((recording.frames_decoded, 2), np.nan)
        # angles are counter-clockwise in the image, y points down
        turned = (complex(*point) - hub) * np.exp(-1j * (tracked.angle - tracked.angle[0])) + hub
        place[tracked.frame] = np.stack([turned.real, turned.imag], axis=1) + tracked.hub_path
        whole = np.isfinite(place).all(axis=1).tolist()
        found.append({"name": f"point {n}", "body": "single", "place": positions(place), "whole": whole})
    return found


def positions(place: Any) -> list[list[float] | None]:
    """Return positions (n, 2) for the page, None where they are unknown."""
    known = np.isfinite(place).all(axis=1)
    return [p if k else None for p, k in zip(np.round(place, 2).tolist(), known.tolist(), strict=True)]


def main() -> None:
    """Answer the request in the argument of the process."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # SystemExit removes the temporary folder
    warnings.simplefilter("ignore")
    request = json.loads(sys.argv[1])
    try:
        answer = preview(
            Path(request["film"]),
            profile=Path(request["profile"]) if request["profile"] else None,
            hub=tuple(request["hub"]) if request["hub"] else None,
            makes=request["makes"],
            points=[tuple(p) for p in request["points"]],
        )
    except GyrotrackError as error:
        answer = {"error": {"code": error.code, "message": error.message, "hint": error.hint}}
    sys.stdout.write(json.dumps(answer))


if __name__ == "__main__":
    main()
