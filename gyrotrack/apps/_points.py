"""Tracked points of a film: their record, the uncertainty of their motion caused by the pivot, and a picture."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from gyrotrack._errors import UsageError
from gyrotrack.apps._motion import BodyMotion, Value, motion_of
from gyrotrack.io._records import PointTrack, Recording, Series
from gyrotrack.plotting._frames import write_tiles
from gyrotrack.tracking._film import Film, Tilt
from gyrotrack.tracking._point_motion import TrackedPoint
from gyrotrack.tracking._point_tracker import PointPath

Floats = npt.NDArray[np.float64]

_STEEPEST = (
    # largest tilt that can be corrected [degrees]; at this tilt, a circle appears four times as long as wide
    75.0
)
_PATH, _HUB, _PATCH = (0, 200, 255), (0, 0, 255), (0, 255, 0)


def point_track(
    name: str,
    path: TrackedPoint | PointPath,
    time: Floats,
    number: npt.NDArray[np.int64],
    film: Film,
    scale: float | None,
) -> PointTrack:
    """Return the record of a point.

    `time` [s] belongs to the frames of the path, `number` to all tracked frames; `scale` is the length of a pixel [m].
    """
    if isinstance(path, TrackedPoint):
        sigma, radius = path.place_sigma, path.path.radius
    else:
        sigma, radius = np.sqrt(np.stack([path.covariance[:, i, i] for i in (0, 1)], axis=1)), path.radius
    place = path.place
    if film.tilt is not None:
        place = film.seen(place)
        back = np.linalg.inv(film.tilt.matrix(film.info.width, film.info.height)[:, :2])
        sigma = np.sqrt(sigma**2 @ (back**2).T)
    return PointTrack(
        name=name,
        time=time,
        frame_number=number[path.frame],
        x=place[:, 0],
        y=place[:, 1],
        sigma_x=sigma[:, 0],
        sigma_y=sigma[:, 1],
        radius=radius,
        m_per_px=math.nan if scale is None else scale,
    )


def with_pivot_errors(
    motion: BodyMotion, series: Series, recording: Recording, point: TrackedPoint
) -> BodyMotion:
    """Add the error of the pivot, which is common to all angles, to the uncertainties of a motion.

    The motion is recomputed about pivots that are displaced by one standard deviation along each principal axis of the
    covariance of the pivot. The changes of a quantity are the contributions of the pivot to its uncertainty. An error
    of the tilt of the camera scales all angles.
    """
    taken = np.isin(np.round(recording.bodies["casing"].time, 9), np.round(series.time, 9))
    others = [motion_of(series.time, recording.sense * a[taken], series.sigma) for a in point.displaced()]
    return with_differences(motion, others, point.view)


def with_differences(motion: BodyMotion, others: list[BodyMotion], view: float = 0.0) -> BodyMotion:
    """Add to the uncertainties of a motion its differences from `others`, motions with one erroneous quantity each.

    `view` is the relative uncertainty of all angles that the tilt of the camera causes.
    """

    def widened(name: str, *, scales: bool) -> Any:
        value: Value | None = getattr(motion, name)
        if value is None:
            return None
        shifts = [
            0.0 if (other := getattr(o, name)) is None else abs(abs(other.value) - abs(value.value))
            for o in others
        ]
        shared = view * abs(value.value) if scales else 0.0
        return replace(value, stderr=math.hypot(value.stderr, shared, *shifts))

    ends = {
        end: math.hypot(
            motion.omega_u[end],
            view * abs(motion.omega[end]),
            *(abs(o.omega[end] - motion.omega[end]) for o in others),
        )
        for end in motion.omega_u
    }
    return replace(
        motion,
        omega_u=ends,
        omega_mean=widened("omega_mean", scales=True),
        alpha=widened("alpha", scales=True),
        period=widened("period", scales=False),
        amplitude=widened("amplitude", scales=True),
        decay=widened("decay", scales=False),
    )


def write_point_picture(path: Path, film: Film, point: TrackedPoint, *, force: bool = False) -> None:
    """Write a PNG of four frames with the path of a point, its patch, and the line to the pivot."""
    index = np.linspace(0, len(point.frame) - 1, 4).astype(int)
    line = point.place.round().astype(np.int32)
    tiles = []
    for k, picture in zip(index, film.some(point.frame[index]), strict=True):
        tile = np.asarray(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
        cv2.polylines(tile, [line], isClosed=False, color=_PATH, thickness=1)
        hub = point.hub.clip(-30000, 30000).round().astype(int).tolist()
        cv2.line(tile, hub, line[k].tolist(), _HUB, 1)
        cv2.circle(tile, line[k].tolist(), max(round(point.path.radius / 1.35), 2), _PATCH, 1)
        tiles.append(tile)
    x, y = point.hub
    text = f"path of a point, the patch around it, and the line to the pivot ({x:.1f}, {y:.1f}) px ({point.way})."
    write_tiles(path, tiles, text, force=force)


def read_tilt(text: str) -> Tilt:
    """Read a tilt like "30" or "30,90": the tilt angle, and the direction of the ellipse's minor axis [degrees]."""
    try:
        angle, azimuth = (float(part) for part in (*text.split(","), "90")[:2])
    except ValueError as error:
        what = f"--tilt {text[:40]!r} is not a tilt."
        raise UsageError(what, "Give one or two angles in degrees, for example 30 or 30,90.") from error
    if text.count(",") > 1 or not (0.0 <= angle <= _STEEPEST and math.isfinite(azimuth)):
        what = f"--tilt {text[:40]!r} is not possible: the tilt is between 0 and {_STEEPEST:g} degrees."
        raise UsageError(what, "Give the tilt and the direction of the short axis of the ellipse in degrees.")
    return Tilt(math.radians(angle), math.radians(azimuth))


def read_point(text: str, option: str = "--point") -> tuple[float, float]:
    """Read a position like "320,240" [px]."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError as error:
        what = f"{option} {text[:40]!r} is not a position."
        raise UsageError(what, "Give two numbers in px, for example 320,240.") from error
    if not (math.isfinite(x) and math.isfinite(y)):
        raise UsageError(f"The coordinates of {option} are not finite numbers.", "Give two numbers in px.")
    return x, y
