"""Preview of the tracking in the first frames of a film, with the marked hub and markers.

Runs in a separate process, ``python -m gyrotrack.apps.workbench._preview``, with a JSON request as its only argument.
The excerpt is copied without decoding to a temporary folder and tracked by the same functions as the film.
"""

from __future__ import annotations

import json
import signal
import sys
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import av
import numpy as np

from gyrotrack._errors import GyrotrackError, TrackingError
from gyrotrack.apps._spindown import SpindownOptions, film_recording
from gyrotrack.io._records import Recording
from gyrotrack.io._schema import STATUS
from gyrotrack.tracking._extract import extract
from gyrotrack.tracking._film import Film
from gyrotrack.tracking._profile import PAPER, load
from gyrotrack.tracking._tracked import Tracked
from gyrotrack.video._container import opened, orientation_of, packets_of

FRAMES = 500
"""Number of frames: 0.5 s at 1000 fps, 2 s at 250 fps, 8 s at 60 fps."""


def copy_excerpt(film: Path, target: Path, frames: int) -> None:
    """Copy the first packets of a film, without decoding, to a file of the same format.

    A TrackingError says that the format cannot be copied, or the copy has another orientation.
    """
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
            raise TrackingError(
                f"An excerpt of {film.name} cannot be copied ({error}).", "Track the whole film."
            ) from error
    if _orientation(film) != _orientation(target):
        raise TrackingError(f"An excerpt of {film.name} loses its orientation.", "Track the whole film.")


def _orientation(path: Path) -> Any:
    with opened(path) as (container, stream):
        return orientation_of(next(container.decode(stream)))


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
    with tempfile.TemporaryDirectory() as folder:
        excerpt = Path(folder) / f"excerpt{film.suffix.lower()}"
        copy_excerpt(film, excerpt, frames)
        if single:
            recording, tracked = film_recording(Film(excerpt), SpindownOptions(hub, 1.0))
            markers = _rotated_points(recording, tracked, points)
        else:
            chosen = PAPER if profile is None else load(profile)
            recording = extract(excerpt, chosen, capture_fps=1.0)
            markers = _marker_positions(recording)
    count = recording.frames_decoded
    return {
        "frames": count,
        "centre": _positions(recording.centre),
        "markers": markers,
        "kept": {name: len(b.time) / count for name, b in recording.bodies.items()},
        "sigma_mrad": {
            name: 1e3 * float(np.median(b.sigma)) for name, b in recording.bodies.items() if len(b.sigma)
        },
        # rates and timestamps of an excerpt are not meaningful
        "warnings": [w for w in recording.warnings if "container" not in w and "timestamps" not in w],
    }


def _marker_positions(recording: Recording) -> list[dict[str, Any]]:
    found = []
    for m in recording.markers.values():
        known = np.isfinite(m.rho)
        radius = float(np.median(m.rho[known])) if known.any() else float("nan")
        angle = recording.sense * m.angle_fine
        place = recording.centre + 1.15 * radius * np.stack([np.cos(angle), -np.sin(angle)], axis=1)
        whole = (m.status == STATUS["ok"]).tolist()
        found.append({"name": m.name, "body": m.body, "place": _positions(place), "whole": whole})
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
        found.append({"name": f"point {n}", "body": "single", "place": _positions(place), "whole": whole})
    return found


def _positions(place: Any) -> list[list[float] | None]:
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
