"""Correction of a marker by hand in single frames of a recording.

The angle of the body in such a frame is then that of the clicked marker alone, with the uncertainty of a click. What
was changed is kept in the recording: ``corrections`` of its ``extra`` attribute holds for each frame the marker, the
place, the angle before and after, and when and by which version it was made.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np

from gyrotrack._errors import UsageError
from gyrotrack._smoothing import angular_velocity
from gyrotrack._versions import __version__
from gyrotrack.io._records import BodyTrack, MarkerTrack, Recording
from gyrotrack.io._schema import STATUS

CLICK_SIGMA = 1.5
"""Standard uncertainty of a place that a person clicks [px]."""
_NEAREST = 5.0
"""Distance from the centre [px] below which a place determines no angle."""
_TURN = 2 * np.pi


def corrected(recording: Recording, marker: str, frame: int, place: Sequence[float] | None) -> Recording:
    """Return a recording in which a marker of one frame is where a person sees it, or is left out.

    Parameters
    ----------
    recording : Recording
        What `extract` wrote.
    marker : str
        Name of the marker.
    frame : int
        Index of the frame.
    place : sequence of two floats or None
        Middle of the marker (x, y) [px]; None marks it as lost, and the body has no angle in this frame.

    Raises
    ------
    UsageError
        There is no such marker or frame, or the place determines no angle.
    """
    track = recording.markers.get(marker)
    if track is None or not 0 <= frame < len(recording.time):
        raise UsageError("There is no such marker in this frame.", "Choose a marker and a frame of the film.")
    before = float(track.angle_fine[frame])
    angle = sigma = float("nan")
    if place is not None:
        x, y = np.asarray(place, dtype=np.float64) - recording.centre[frame]
        radius = float(np.hypot(x, y))
        if not radius > _NEAREST:  # also where the centre is unknown
            raise UsageError(
                "This place determines no angle: the centre is unknown or too near.",
                "Click on the marker itself.",
            )
        angle = recording.sense * float(np.arctan2(-y, x))  # counter-clockwise as seen; y points down
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
    earlier = [
        c for c in recording.extra.get("corrections", []) if (c["marker"], c["frame"]) != (marker, frame)
    ]
    corrections = [*earlier, note]
    told = [w for w in recording.warnings if "by hand" not in w]
    count = len(corrections)
    told.append(f"{count} frame{'s are' if count > 1 else ' is'} corrected by hand.")
    return replace(
        recording,
        markers={**recording.markers, marker: _with_angle(track, frame, angle, sigma)},
        bodies=bodies,
        warnings=tuple(told),
        extra={**recording.extra, "corrections": corrections},
    )


def _with_angle(track: MarkerTrack, frame: int, angle: float, sigma: float) -> MarkerTrack:
    """Return a marker with another angle in one frame; its corners, which nobody has measured there, are unknown."""
    changed: dict[str, Any] = {}
    for name in ("corner", "delta", "rho", "beta", "angle", "sigma", "u_r", "u_1", "u_2"):
        changed[name] = getattr(track, name).copy()
        changed[name][frame] = np.nan
    for name, value in (("angle_fine", angle), ("sigma_calibrated", sigma)):
        changed[name] = getattr(track, name).copy()
        changed[name][frame] = value
    changed["status"] = track.status.copy()
    changed["status"][frame] = STATUS["blurred" if np.isfinite(angle) else "lost"]
    return replace(track, **changed)


def _with_frame(body: BodyTrack, time: float, angle: float, sigma: float) -> BodyTrack:
    """Return a body with another angle [rad] at one time, or without one if it is NaN; its speed is smoothed anew."""
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
