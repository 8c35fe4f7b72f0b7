"""The films of the workbench: frames of the clips of a case, manual corrections of markers, and previews of tracking.

The angle of the body in a corrected frame is that of the clicked marker alone, with the uncertainty of a click. The
recording documents the corrections: ``corrections`` in its ``extra`` attribute contains for each one marker, frame,
position, angle before and after, date and version.

The preview runs in a separate process, ``python -m gyrotrack.apps.workbench._films``, with a JSON request as its only
argument. An excerpt of the film is copied without decoding to a temporary folder and tracked by the same functions as
the film.
"""

from __future__ import annotations

import json
import signal
import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

import av
import numpy as np

from gyrotrack._errors import GyrotrackError, TrackingError, UsageError, VideoError
from gyrotrack._smoothing import angular_velocity
from gyrotrack._versions import __version__
from gyrotrack.io._records import BodyTrack, MarkerTrack, Recording
from gyrotrack.io._schema import STATUS
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
        """Return a frame as JPEG; a VideoError says that there is no such clip, film or frame."""
        return jpeg(self._picture(key, index, overlay=overlay), SHOWN_WIDTH, QUALITY)

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
        """Return a frame in colour (BGR); a VideoError says that there is no such film or frame."""
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
    """Return the markers that were picked in a frame as a profile in TOML."""
    data = wanted if isinstance(wanted, dict) else {}
    allowed = {k: data[k] for k in ("name", "centre", "circle_colour", "marker") if k in data}
    return to_toml(parse(allowed, "profile"))


CLICK_SIGMA = 1.5  # standard uncertainty of a clicked position [px]
_MIN_RADIUS = 5.0  # smallest distance from the centre of a clicked position [px]
_TURN = 2 * np.pi


def corrected(recording: Recording, marker: str, frame: int, place: Sequence[float] | None) -> Recording:
    """Return a recording with the centre of a marker at `place` [px] in one frame, or with it lost there (None)."""
    track = recording.markers.get(marker)
    if track is None or not 0 <= frame < len(recording.time):
        raise UsageError("There is no such marker in this frame.", "Choose a marker and a frame of the film.")
    before = float(track.angle_fine[frame])
    angle = sigma = float("nan")
    if place is not None:
        x, y = np.asarray(place, dtype=np.float64) - recording.centre[frame]
        radius = float(np.hypot(x, y))
        if not radius > _MIN_RADIUS:  # also true for an unknown centre (NaN)
            what = "This position determines no angle: the centre is unknown or too close."
            raise UsageError(what, "Click on the marker itself.")
        angle = recording.sense * float(np.arctan2(-y, x))  # counter-clockwise in the image; y points down
        sigma = CLICK_SIGMA / radius
    note: dict[str, Any] = {
        "marker": marker,
        "frame": frame,
        "place_px": None if place is None else [float(v) for v in place],
        "angle_rad": None if place is None else angle,
        "sigma_rad": None if place is None else sigma,
        "previous_angle_rad": before if np.isfinite(before) else None,
        "by": "hand",
        "at": datetime.now(UTC).isoformat(timespec="seconds"),
        "software_version": __version__,
    }
    body = recording.bodies.get(track.body)
    bodies = dict(recording.bodies)
    if body is not None:
        bodies[track.body] = _with_frame(body, float(recording.time[frame]), angle - track.mount_angle, sigma)
    earlier = recording.extra.get("corrections", [])
    corrections = [*(c for c in earlier if (c["marker"], c["frame"]) != (marker, frame)), note]
    notes = [w for w in recording.warnings if "by hand" not in w]
    count = len(corrections)
    notes.append(f"{count} frame{'s are' if count > 1 else ' is'} corrected by hand.")
    return replace(
        recording,
        markers={**recording.markers, marker: _with_angle(track, frame, angle, sigma)},
        bodies=bodies,
        warnings=tuple(notes),
        extra={**recording.extra, "corrections": corrections},
    )


def _with_angle(track: MarkerTrack, frame: int, angle: float, sigma: float) -> MarkerTrack:
    """Return a marker with a new angle in one frame, and without corners there."""
    removed = ("corner", "delta", "rho", "beta", "angle", "sigma", "u_r", "u_1", "u_2")
    values: dict[str, Any] = dict.fromkeys(removed, np.nan)
    values |= {"angle_fine": angle, "sigma_calibrated": sigma}
    values["status"] = STATUS["blurred" if np.isfinite(angle) else "lost"]
    changed = {name: getattr(track, name).copy() for name in values}
    for name, value in values.items():
        changed[name][frame] = value
    return replace(track, **changed)


def _with_frame(body: BodyTrack, time: float, angle: float, sigma: float) -> BodyTrack:
    """Return a body with a new angle [rad] at one time, or without one if it is NaN; its speed is recomputed."""
    names = ("time", "angle", "sigma", "sigma_paper", "n_markers")
    others = np.abs(body.time - time) > 1e-9
    kept: dict[str, Any] = {n: getattr(body, n)[others] for n in names}
    if np.isfinite(angle):
        at = int(np.searchsorted(kept["time"], time))
        expected = np.interp(time, kept["time"], kept["angle"])
        angle += _TURN * np.rint((expected - angle) / _TURN)
        for name, value in zip(names, (time, angle, sigma, np.nan, 1), strict=True):
            kept[name] = np.insert(kept[name], at, value)
    omega, omega_sigma = angular_velocity(kept["time"], kept["angle"], kept["sigma"], body.smoothing_width)
    return replace(body, **kept, omega=omega, omega_sigma=omega_sigma)


FRAMES = 500  # number of frames: 0.5 s at 1000 fps, 2 s at 250 fps, 8 s at 60 fps


def copy_excerpt(film: Path, target: Path, frames: int) -> None:
    """Copy the first packets of a film to a file of the same format; a TrackingError if the format forbids it."""
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
    single: bool,
    points: Sequence[tuple[float, float]],
    frames: int = FRAMES,
) -> dict[str, Any]:
    """Track the start of a film with the markers of a profile, by default that of the paper.

    A film of a `single` body is registered instead; `points` (x, y) [px] of the first frame are rotated with it.
    Returned are ``frames``; ``centre``, position [px] or null in each frame; ``markers``: name, body, and for each
    frame the position [px] or null, and whether the marker is complete; ``kept``, fraction of frames with an angle, by
    body; ``warnings``.
    """
    from gyrotrack.apps._spindown import SpindownOptions, film_recording
    from gyrotrack.tracking import _film
    from gyrotrack.tracking._extract import extract

    with scratch_folder() as folder:
        excerpt = folder / f"excerpt{film.suffix.lower()}"
        copy_excerpt(film, excerpt, frames)
        if single:
            recording, tracked = film_recording(_film.Film(excerpt), SpindownOptions(hub, capture_fps=1.0))
            markers = _rotated_points(recording, tracked, points)
        else:
            chosen = PAPER if profile is None else load(profile)
            recording = extract(excerpt, chosen, capture_fps=1.0)
            markers = marker_positions(recording)
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


def marker_positions(recording: Recording, frames: slice = slice(None)) -> list[dict[str, Any]]:
    """Return name, body, position [px] or None, and completeness of each marker in some frames."""
    found = []
    for m in recording.markers.values():
        known = np.isfinite(m.rho)
        radius = float(np.median(m.rho[known])) if known.any() else float("nan")
        angle = recording.sense * m.angle_fine[frames]
        place = recording.centre[frames] + 1.15 * radius * np.stack([np.cos(angle), -np.sin(angle)], axis=1)
        whole = (m.status[frames] == STATUS["ok"]).tolist()
        found.append({"name": m.name, "body": m.body, "place": positions(place), "whole": whole})
    return found


def _rotated_points(
    recording: Recording, tracked: Tracked, points: Sequence[tuple[float, float]]
) -> list[dict[str, Any]]:
    """Rotate points of the first frame about the hub by the measured angle."""
    hub = complex(*tracked.ring.hub)
    if not points:  # by default a point on the ring
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
    """Answer one request."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # removes the temporary folder
    warnings.simplefilter("ignore")
    request = json.loads(sys.argv[1])
    try:
        answer = preview(
            Path(request["film"]),
            profile=Path(request["profile"]) if request["profile"] else None,
            hub=tuple(request["hub"]) if request["hub"] else None,
            single=request["single"],
            points=[tuple(p) for p in request["points"]],
        )
    except GyrotrackError as error:
        answer = {"error": {"code": error.code, "message": error.message, "hint": error.hint}}
    sys.stdout.write(json.dumps(answer))


if __name__ == "__main__":
    main()
