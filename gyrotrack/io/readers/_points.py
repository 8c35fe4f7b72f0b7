"""Points tracked by another program, and the angle of one point about a centre."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gyrotrack._errors import DatasetError, UsageError
from gyrotrack.io._records import Floats
from gyrotrack.io.readers._clock import MIN_SAMPLES
from gyrotrack.io.readers._motion_table import ReadOptions, frame_rate
from gyrotrack.io.readers._reading import Taken

CENTRES = ("centre", "center", "axis", "axle", "hub", "origin", "middle", "pivot")
ORBIT = "orbit"
# largest rms deviation of a path from a circle about its fitted centre, relative to the radius; a circle seen at 45
# degrees has 0.12
_LARGEST_DEVIATION = 0.15
# smallest distance between given and fitted centre that causes a warning, in standard uncertainties and in radii
_SIGNIFICANT, _LEAST_OFFSET = 3.0, 0.05
_UNCERTAIN = 0.01  # smallest uncertainty of the centre of an arc that triggers a warning [radius]
_MOST_STEPS = 50  # largest number of steps of a fit; a fit to an arc converges in 10 steps
_CONVERGED = 1e-9  # a fit ends with a step below this value [radius]


@dataclass(frozen=True)
class Points:
    """Named points in every frame."""

    path: Path  # the file
    time: Floats  # shape (n,); times [s], or frame numbers if `counted`
    # shape (n, 2); x and y of each point; NaN in frames without the point
    places: Mapping[str, Floats]
    # shape (n,); likelihood from the other program, 0 to 1; empty if not available
    likelihood: Mapping[str, Floats]
    y_down: bool  # whether y points downwards, as in images
    counted: bool  # whether `time` contains frame numbers
    notes: tuple[str, ...] = ()  # repairs made while reading
    sha256: str = ""  # hash of the file
    # shape (n,); standard uncertainty of x and of y from the other program; empty if not available
    errors: Mapping[str, Floats] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()  # columns that are not used


@dataclass(frozen=True)
class PointAngle:
    """Angle of a point about a centre [rad], counter-clockwise, wrapped; NaN where it is unknown."""

    time: Floats
    angle: Floats
    notes: tuple[str, ...]
    taken: tuple[Taken, ...]
    used: frozenset[str]  # names of the points that were used, in words
    sigma: Floats | None = None  # standard uncertainty of the angle, if the uncertainty of the point is known
    doubts: tuple[str, ...] = ()
    # mean distance of the point from the centre, and covariance of the centre, if it was fitted to the path
    radius: float = 0.0
    centre_covariance: Floats | None = None  # shape (2, 2); of x and of y upwards


def changes_by_centre(angle: Floats, radius: float, covariance: Floats) -> Floats:
    """Return the changes (n, 2) of angles if the centre is displaced by one standard deviation along each axis."""
    size, axes = np.linalg.eigh(covariance)
    displacements = np.sqrt(np.maximum(size, 0.0)) * axes
    return np.asarray(np.column_stack([np.sin(angle), -np.cos(angle)]) / radius @ displacements)


def angle_of(points: Points, options: ReadOptions) -> PointAngle:
    """Return the angle of the marker about the centre: atan2(y - y0, x - x0), with y upwards."""
    time = points.time.astype(float)
    if points.counted:
        time = time / frame_rate(points.path, options)
    named_centre = _centre_name(points, options)
    name = _marker_name(points, options, named_centre)
    place = np.where(_is_likely(points, name, options), points.places[name].T, np.nan).T
    _require_samples(points, name, place)
    centre, where = _centre(points, options, named_centre, place)
    arm = place - centre
    _require_samples(points, name, arm)
    length = np.hypot(*arm.T)
    if np.nanmin(length) < 0.2 * np.nanmedian(length):
        raise DatasetError(
            f"{points.path}: '{name[:40]}' is too close to {where} in some frames, where its angle is undefined.",
            "Give the centre with --centre, as a point or as coordinates: --centre 320,240.",
        )
    for axis, values in zip("xy", place.T, strict=True):
        if np.nanmin(values) == np.nanmax(values):
            what = f"{points.path}: {axis} of '{name[:40]}' is {np.nanmin(values):g} in all frames."
            raise DatasetError(what, "Check the columns.")
    up = -arm[:, 1] if points.y_down else arm[:, 1]
    sigma = points.errors[name] / length if name in points.errors else None
    doubts = () if options.centre == ORBIT else _doubt_of_centre(points.path.name, name, where, arm)
    notes: tuple[str, ...] = (f"{points.path.name}: angle of '{name}' about {where}", *doubts)
    clock = f"frames at {options.fps:g} 1/s" if points.counted else "times of the file"
    chosen = (
        "by --marker" if options.marker else "the only point" if len(points.places) < 3 else "by its name"
    )
    why = "by --centre" if options.centre else "by its name" if named_centre else "fitted to the path"
    taken: tuple[Taken, ...] = (
        Taken(clock, "time", "s", "of the format"),
        Taken(f"x, y of '{name}' about {where}", "angle", "", f"point {chosen}, centre {why}"),
    )
    if sigma is not None:
        taken += (Taken("the uncertainty of x, y", "uncertainty", "", "divided by the radius"),)
    used = frozenset({name} if named_centre is None else {name, named_centre})
    fitted = named_centre is None and _coordinates(options.centre or "") is None
    arm = np.column_stack([arm[:, 0], up])
    known = arm[np.isfinite(arm).all(axis=1)]
    covariance = _centre_covariance(known) if fitted else None
    if covariance is not None:
        notes += _uncertain_centre(points.path.name, np.arctan2(known[:, 1], known[:, 0]), length, covariance)
    return PointAngle(
        time + options.start, np.arctan2(up, arm[:, 0]), notes, taken, used, sigma, doubts,
        float(np.nanmean(length)), covariance,
    )  # fmt: skip


def _doubt_of_centre(file: str, name: str, where: str, arm: Floats) -> tuple[str, ...]:
    """Return a warning if the path is a circle about a centre other than the given centre.

    The path of a point of a rigid body is a circle about the centre of rotation.
    """
    known = arm[np.isfinite(arm).all(axis=1)]
    found = circle_centre(known)
    radius = np.hypot(*(known - found).T)
    rest = radius - radius.mean()
    offset, mean = float(np.hypot(*found)), float(radius.mean())
    u = float(np.sqrt(np.trace(_centre_covariance(known - found))))
    length = np.hypot(*known.T)
    if not (offset > _SIGNIFICANT * u and offset > _LEAST_OFFSET * mean and rest.std() < 0.5 * length.std()):
        return ()
    given, fitted = (np.ptp(np.unwrap(np.arctan2(a[:, 1], a[:, 0]))) for a in (known, known - found))
    doubt = (
        f"{file}: the distance of '{name}' from {where} varies from {length.min():.3g} to {length.max():.3g}; its path "
        f"is a circle about a centre that is {offset:.2g} +- {u:.2g} away. The angle ranges over {given:.3g} rad about "
        f"{where} and {fitted:.3g} rad about the centre of the path; --centre orbit uses the centre of the path."
    )
    return (doubt,)


def _uncertain_centre(file: str, angle: Floats, length: Floats, covariance: Floats) -> tuple[str, ...]:
    """Return a warning if the arc of a point does not determine the distance of its centre well."""
    share = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]) / np.nanmean(length))
    if share < _UNCERTAIN or np.ptp(np.unwrap(angle)) > np.pi:
        return ()
    doubt = (
        f"{file}: the arc of the path leaves its centre uncertain: all angles share a relative uncertainty of "
        f"{100 * share:.2g} %. --centre gives the centre."
    )
    return (doubt,)


def _centre_covariance(arm: Floats) -> Floats:
    """Return the covariance (2, 2) of the centre of a circle fitted to points (n, 2), given relative to this centre.

    It is the covariance of the least-squares fit, increased to include the correlation of the residuals.
    """
    radius = np.hypot(*arm.T)
    rest = radius - radius.mean()
    ray = arm / radius[:, None]
    spread = np.linalg.pinv((ray - ray.mean(axis=0)).T @ (ray - ray.mean(axis=0)))
    correlation = float(np.clip(np.corrcoef(rest[1:], rest[:-1])[0, 1], 0.0, 0.99)) if rest.any() else 0.0
    return np.asarray((1 + correlation) / (1 - correlation) * np.mean(rest**2) * spread)


def _require_samples(points: Points, name: str, place: Floats) -> None:
    count = int(np.isfinite(place).all(axis=1).sum())
    if count < MIN_SAMPLES:
        raise DatasetError(
            f"{points.path}: '{name[:40]}' is tracked in {count} frames; at least {MIN_SAMPLES} are needed.",
            "Check the name of the point and --likelihood.",
        )


def _centre_name(points: Points, options: ReadOptions) -> str | None:
    if options.centre is None:
        return next((n for n in points.places if n.casefold() in CENTRES), None)
    if options.centre == ORBIT or _coordinates(options.centre) is not None:
        return None
    return _existing(points, options.centre)


def _marker_name(points: Points, options: ReadOptions, centre: str | None) -> str:
    if options.marker is not None:
        return _existing(points, options.marker)
    if options.body in points.places:
        return options.body
    # the origin of a project is not a point of the body, even if another centre is used
    others = [n for n in points.places if n != centre and n.casefold() not in CENTRES]
    if len(others) != 1:
        raise UsageError(f"{points.path} contains the points {_list(others)}.", "Choose one with --marker.")
    return others[0]


def _existing(points: Points, name: str) -> str:
    if name not in points.places:
        what = f"{points.path} has no point '{name[:40]}'."
        raise UsageError(what, f"Points: {_list(list(points.places))}.")
    return name


def _is_likely(
    points: Points, name: str, options: ReadOptions
) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    if name not in points.likelihood:
        return np.ones(len(points.time), dtype=bool)
    return np.asarray(points.likelihood[name] >= options.likelihood)


def _centre(points: Points, options: ReadOptions, name: str | None, place: Floats) -> tuple[Floats, str]:
    if name is not None:
        return np.where(_is_likely(points, name, options), points.places[name].T, np.nan).T, f"'{name}'"
    fixed = _coordinates(options.centre or "")
    if fixed is not None:
        return fixed, f"({fixed[0]:g}, {fixed[1]:g})"
    found = circle_centre(place)
    radius = np.hypot(*(place - found).T)
    deviation = float(np.nanstd(radius) / np.nanmean(radius))
    if deviation > _LARGEST_DEVIATION:
        raise DatasetError(
            f"{points.path}: the path of the point is not a circle about its fitted centre, ({found[0]:.4g}, "
            f"{found[1]:.4g}): rms deviation {100 * deviation:.0f} % of the radius.",
            "Give the centre of rotation with --centre, as a point or as coordinates: --centre 320,240.",
        )
    return found, f"the centre of its path, ({found[0]:.4g}, {found[1]:.4g})"


def circle_centre(place: Floats) -> Floats:
    """Return the centre of the circle from which points (n, 2) have the least rms distance.

    The start is the linear fit x^2 + y^2 = 2 a x + 2 b y + c (I. Kasa, IEEE Trans. Instrum. Meas. 25, 8 (1976)). Over
    whole turns the bias of this fit is of the order noise^2 / radius. For a short arc the fitted radius is too small:
    by 17 % if the noise is 6 % of the height of the arc. Gauss-Newton steps remove this bias.
    """
    known = place[np.isfinite(place).all(axis=1)]
    if len(known) < 3:
        return np.full(2, np.nan)
    middle = known.mean(axis=0)
    x = known - middle
    design = np.column_stack([2 * x, np.ones(len(x))])
    solution, *_ = np.linalg.lstsq(design, (x**2).sum(axis=1), rcond=None)
    return np.asarray(middle + _least_distance(x, solution[:2]))


def _least_distance(place: Floats, start: Floats) -> Floats:
    """Return the centre of least rms distance by Gauss-Newton steps from a start; the start if they do not converge."""
    centre = start
    for _ in range(_MOST_STEPS):
        arm = place - centre
        radius = np.hypot(*arm.T)
        if not radius.min() > 0:
            return start
        ray = arm / radius[:, None]
        step, *_ = np.linalg.lstsq(ray - ray.mean(axis=0), radius - radius.mean(), rcond=None)
        centre = centre + step
        if np.hypot(*step) < _CONVERGED * radius.mean():
            return np.asarray(centre)
    return start


def _coordinates(text: str) -> Floats | None:
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        return None
    return np.array([x, y]) if np.isfinite(x) and np.isfinite(y) else None


def _list(names: list[str]) -> str:
    return ", ".join(f"'{n[:40]}'" for n in names[:12]) or "none"
