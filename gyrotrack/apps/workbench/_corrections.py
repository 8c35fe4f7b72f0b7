"""Manual corrections of markers: each correction applies to one frame, is listed, and can be deleted completely.

The angle of the body in a corrected frame is the angle of the clicked marker alone, with the uncertainty of a click.
The recording documents the corrections: ``corrections`` in its ``extra`` attribute contains for each correction the
marker, frame, position, angle before and after, date and version. It also contains the previous content of the frame,
so that the content can be restored.
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

CLICK_SIGMA = 1.5  # standard uncertainty of a clicked position [px]
# deviation from the neighbouring frames above which a click needs confirmation [standard uncertainties]
JUMP = 5.0
_SAME = 1e-9  # times that differ by less than this value count as equal [s]
# smallest distance of a clicked position from the centre at which its angle is defined [px]
_MIN_RADIUS = 5.0
_TURN = 2 * np.pi
_NORMAL = 0.6745  # median of the absolute value of a standard normal variable
_MEASURED = (
    "corner", "delta", "rho", "beta", "angle", "sigma", "u_r", "u_1", "u_2",
    "angle_fine", "sigma_calibrated", "status",
)  # fmt: skip
_BODY = ("time", "angle", "sigma", "sigma_paper", "n_markers")


def corrected(recording: Recording, marker: str, frame: int, place: Sequence[float] | None) -> Recording:
    """Return a recording with the centre of a marker at `place` [px] in one frame; None marks it as lost there."""
    track = _track(recording, marker, frame)
    before = float(track.angle_fine[frame])
    angle = sigma = float("nan")
    if place is not None:
        angle, sigma = _clicked(recording, frame, place)
    earlier = corrections(recording)
    known = next((c for c in earlier if (c["marker"], c["frame"]) == (marker, frame)), None)
    note: dict[str, Any] = {
        "marker": marker,
        "frame": frame,
        "place_px": None if place is None else [float(v) for v in place],
        "angle_rad": None if place is None else angle,
        "sigma_rad": None if place is None else sigma,
        "previous_angle_rad": before if np.isfinite(before) else None,
        "previous": known.get("previous") if known is not None else _content(recording, track, frame),
        "by": "hand",
        "at": datetime.now(UTC).isoformat(timespec="seconds"),
        "software_version": __version__,
    }
    body = recording.bodies.get(track.body)
    bodies = dict(recording.bodies)
    if body is not None:
        row = (float(recording.time[frame]), angle - track.mount_angle, sigma, np.nan, 1)
        bodies[track.body] = _with_row(body, *row)
    return _documented(
        replace(
            recording,
            markers={**recording.markers, marker: _with_angle(track, frame, angle, sigma)},
            bodies=bodies,
        ),
        [*(c for c in earlier if c is not known), note],
    )


def without_correction(recording: Recording, marker: str, frame: int) -> Recording:
    """Return a recording with the content of one frame before its correction; raise an error without a correction."""
    track = _track(recording, marker, frame)
    listed = corrections(recording)
    note = next((c for c in listed if (c["marker"], c["frame"]) == (marker, frame)), None)
    if note is None:
        raise UsageError("There is no such correction.", "Reload the page.")
    previous = note.get("previous")
    if previous is None:
        what = "This correction was made by an earlier version, which did not keep the replaced values."
        raise UsageError(what, "Track the film again.")
    changed = {n: getattr(track, n).copy() for n in _MEASURED}
    for name, value in previous["marker"].items():
        changed[name][frame] = np.array(value, dtype=np.float64)  # null becomes nan
    rest = [c for c in listed if c is not note]
    bodies = dict(recording.bodies)
    if (body := bodies.get(track.body)) is not None:
        time = float(recording.time[frame])
        others = [
            c for c in rest if c["frame"] == frame and recording.markers[c["marker"]].body == track.body
        ]
        if others:  # if the body has other corrections in this frame, the latest of them determines the angle
            last = others[-1]
            mount = recording.markers[last["marker"]].mount_angle
            angle, sigma = (np.nan if last[k] is None else last[k] for k in ("angle_rad", "sigma_rad"))
            bodies[track.body] = _with_row(body, time, angle - mount, sigma, np.nan, 1)
        else:
            row = previous["body"] or [None] * 4
            angle, sigma, paper, count = (np.nan if v is None else v for v in row)
            bodies[track.body] = _with_row(body, time, angle, sigma, paper, count)
    markers = {**recording.markers, marker: replace(track, **changed)}
    return _documented(replace(recording, markers=markers, bodies=bodies), rest)


def corrections(recording: Recording) -> list[dict[str, Any]]:
    """Return the corrections of a recording, in the order in which they were made."""
    return list(recording.extra.get("corrections", []))


def jump(recording: Recording, marker: str, frame: int, place: Sequence[float]) -> float | None:
    """Return the deviation of a clicked position from the neighbouring frames [rad]; None if it is not significant.

    The expected angle is interpolated between the neighbouring frames. The deviation is compared with the uncertainty
    of the click and the typical deviation of all frames from their neighbours.
    """
    track = _track(recording, marker, frame)
    angle, sigma = _clicked(recording, frame, place)
    body = recording.bodies.get(track.body)
    if body is None or len(body.time) < _FEWEST:
        return None
    time = float(recording.time[frame])
    others = np.abs(body.time - time) > _SAME
    expected = float(np.interp(time, body.time[others], body.angle[others]))
    apart = angle - track.mount_angle - expected
    apart -= _TURN * np.rint(apart / _TURN)
    t, a = body.time, body.angle
    middle = a[:-2] + (a[2:] - a[:-2]) * (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    typical = float(np.median(np.abs(a[1:-1] - middle))) / _NORMAL
    return float(apart) if abs(apart) > JUMP * np.hypot(sigma, typical) else None


_FEWEST = 5  # smallest number of samples for the typical deviation


def _track(recording: Recording, marker: str, frame: int) -> MarkerTrack:
    track = recording.markers.get(marker)
    if track is None or not 0 <= frame < len(recording.time):
        raise UsageError("There is no such marker in this frame.", "Choose a marker and a frame of the film.")
    return track


def _clicked(recording: Recording, frame: int, place: Sequence[float]) -> tuple[float, float]:
    """Return the angle of a clicked position, and its standard uncertainty [rad]."""
    x, y = np.asarray(place, dtype=np.float64) - recording.centre[frame]
    radius = float(np.hypot(x, y))
    if not radius > _MIN_RADIUS:  # this condition is also true for an unknown centre (NaN)
        what = "No angle can be determined from this position: the centre is unknown or too close."
        raise UsageError(what, "Click on the marker itself.")
    # counter-clockwise in the image; y points down
    return recording.sense * float(np.arctan2(-y, x)), CLICK_SIGMA / radius


def _content(recording: Recording, track: MarkerTrack, frame: int) -> dict[str, Any]:
    """Return the values of a marker and of its body in a frame, with null for unknown numbers."""
    for c in corrections(recording):
        if c["frame"] == frame and recording.markers[c["marker"]].body == track.body and c.get("previous"):
            row = c["previous"]["body"]
            break
    else:
        row = None
        body = recording.bodies.get(track.body)
        if body is not None:
            at = np.flatnonzero(np.abs(body.time - recording.time[frame]) <= _SAME)
            row = [_plain(getattr(body, n)[at[0]]) for n in _BODY[1:]] if len(at) else None
    return {"marker": {n: _plain(getattr(track, n)[frame]) for n in _MEASURED}, "body": row}


def _plain(value: Any) -> Any:
    """Return a number or an array for JSON, with null for unknown numbers."""
    if np.ndim(value):
        return [_plain(v) for v in value]
    number = float(value)
    return number if np.isfinite(number) else None


def _documented(recording: Recording, listed: list[dict[str, Any]]) -> Recording:
    """Return a recording with a list of corrections, and with a warning that states their number."""
    notes = [w for w in recording.warnings if "by hand" not in w]
    if listed:
        notes.append(f"{len(listed)} frame{'s are' if len(listed) > 1 else ' is'} corrected by hand.")
    extra = {k: v for k, v in recording.extra.items() if k != "corrections"}
    return replace(
        recording, warnings=tuple(notes), extra=extra | ({"corrections": listed} if listed else {})
    )


def _with_angle(track: MarkerTrack, frame: int, angle: float, sigma: float) -> MarkerTrack:
    """Return a marker with a new angle [rad] in one frame, without corners in this frame."""
    values: dict[str, Any] = dict.fromkeys(_MEASURED, np.nan)
    values |= {"angle_fine": angle, "sigma_calibrated": sigma}
    values["status"] = STATUS["blurred" if np.isfinite(angle) else "lost"]
    changed = {name: getattr(track, name).copy() for name in values}
    for name, value in values.items():
        changed[name][frame] = value
    return replace(track, **changed)


def _with_row(
    body: BodyTrack, time: float, angle: float, sigma: float, paper: float, count: float
) -> BodyTrack:
    """Return a body with a new angle [rad] at one time (NaN removes the sample); the speed is recomputed."""
    others = np.abs(body.time - time) > _SAME
    kept: dict[str, Any] = {n: getattr(body, n)[others] for n in _BODY}
    if np.isfinite(angle):
        at = int(np.searchsorted(kept["time"], time))
        expected = np.interp(time, kept["time"], kept["angle"])
        angle += _TURN * np.rint((expected - angle) / _TURN)
        for name, value in zip(_BODY, (time, angle, sigma, paper, count), strict=True):
            kept[name] = np.insert(kept[name], at, value)
    omega, omega_sigma = angular_velocity(kept["time"], kept["angle"], kept["sigma"], body.smoothing_width)
    return replace(body, **kept, omega=omega, omega_sigma=omega_sigma)
