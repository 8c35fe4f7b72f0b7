"""One frame in colour, with corners, rays, centre and status drawn over it."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from gyrotrack.dataset.records import STATUS, MarkerTrack, Recording
from gyrotrack.video import Frame

Picture = npt.NDArray[np.uint8]

_FOUND, _PARTLY, _CENTRE = (60, 255, 60), (0, 200, 255), (255, 255, 255)
_WORDS = {code: word for word, code in STATUS.items()}


def drawn(frame: Frame, k: int, recording: Recording) -> Picture:
    """Return a frame in colour (BGR) with everything that the recording knows of it, as frame `k`."""
    picture = colour_picture(frame)
    centre = recording.centre[k]
    for marker in recording.markers.values():
        _draw_marker(picture, marker, k, centre, recording.sense)
    if np.isfinite(centre).all():
        cv2.drawMarker(picture, _point(centre), _CENTRE, cv2.MARKER_CROSS, 13, 1, cv2.LINE_AA)
    text = f"{k}  {1e3 * recording.time[k]:.1f} ms"
    cv2.rectangle(picture, (0, 0), (9 * len(text), 20), (0, 0, 0), cv2.FILLED)
    cv2.putText(picture, text, (6, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.45, _CENTRE, 1, cv2.LINE_AA)
    return picture


def colour_picture(frame: Frame) -> Picture:
    """Return a frame in colour, (height, width, 3) blue, green, red."""
    size = (frame.y.shape[1], frame.y.shape[0])
    planes = [
        frame.y,
        *(cv2.resize(plane, size, interpolation=cv2.INTER_LINEAR) for plane in (frame.v, frame.u)),
    ]
    return np.asarray(cv2.cvtColor(cv2.merge(planes), cv2.COLOR_YCrCb2BGR), dtype=np.uint8)


def _draw_marker(
    picture: Picture, marker: MarkerTrack, k: int, centre: npt.NDArray[np.float64], sense: int
) -> None:
    """Draw a marker's ray and near corners (green), or its ray alone where it is partly hidden (orange)."""
    radius = float(np.nanmedian(marker.rho)) if np.isfinite(marker.rho).any() else float("nan")
    angle = sense * marker.angle_fine[k]
    if not np.isfinite([radius, angle, *centre]).all():
        return
    whole = marker.status[k] == STATUS["ok"]
    direction = np.array([np.cos(angle), -np.sin(angle)])
    start, stop = centre + 0.9 * radius * direction, centre + 1.15 * radius * direction
    colour = _FOUND if whole else _PARTLY
    cv2.line(picture, _point(start), _point(stop), colour, 1, cv2.LINE_AA)
    if whole:
        first, second = marker.corner[k]
        cv2.line(picture, _point(first), _point(second), colour, 1, cv2.LINE_AA)
        for corner in (first, second):
            cv2.circle(picture, _point(corner), 3, colour, 1, cv2.LINE_AA)
    label = marker.name if whole else f"{marker.name} {_WORDS[int(marker.status[k])]}"
    place = _point(centre + 1.3 * radius * direction)
    cv2.putText(picture, label, place, cv2.FONT_HERSHEY_SIMPLEX, 0.35, colour, 1, cv2.LINE_AA)


def _point(place: npt.NDArray[np.float64]) -> tuple[int, int]:
    return round(float(place[0])), round(float(place[1]))
