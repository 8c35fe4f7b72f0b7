"""The motion of a point about a pivot: path of the point, pivot with uncertainty, and angles about the pivot."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gyrotrack._arrays import Floats, Integers
from gyrotrack._errors import TrackingError
from gyrotrack.tracking._coaxial import second_rotation
from gyrotrack.tracking._film import Film, Progress, fresh_frames
from gyrotrack.tracking._hub_search import FARTHEST, Motion
from gyrotrack.tracking._orbit import covered_angle
from gyrotrack.tracking._pivot import Arc, Orbit, angles_about, fit_arc, fit_orbit
from gyrotrack.tracking._point_tracker import PointPath, Turn, track_point
from gyrotrack.tracking._registration import TURN
from gyrotrack.tracking._silhouettes import Foreground
from gyrotrack.tracking._tracked import correlated_variance, white_noise

HUB_U = 1.0
"""Standard uncertainty of a given hub, per axis [px]. Chosen: the accuracy of a click; a smaller value
overrules the arc, a larger one ignores the given hub."""
HUB_SHARE = 0.02
"""Standard uncertainty of a given hub, divided by its distance from the point [1]. Chosen: for a hub outside the
picture, which is extrapolated from the thread; `apps._motion.VIEW` uses this value as the prior of a displaced hub."""
TILT = 0.35
"""Standard deviation of the tilt of a camera held by hand [rad]. Chosen: 20 degrees; a smaller value understates the
error of the angles of short arcs, a larger one overstates it."""
_VIEW_OF_ANGLE = math.sqrt(3.0) / 2.0 * TILT**2
"""Relative error of all angles due to the tilt [1]. Derived: the rms of phi^2 / 2 for normal phi; seen at a tilt phi, a
circle is an ellipse with the axes a and a cos(phi)."""
_VIEW_OF_RADIUS = math.sqrt(3.0) * TILT**2
"""Relative error, due to the tilt, of the radius divided by the distance of the hub [1]. Derived: the rms of phi^2 for
normal phi; a short arc of the ellipse has the radius a / cos(phi) or a cos(phi)^2."""
_TILT_U = 0.05
"""Standard uncertainty of a given tilt [rad]. Chosen: 3 degrees; a smaller value understates the error of the
angles, a larger one overstates it."""
_WIDE = 0.5 * TURN
"""Smallest range of the angle in which an ellipse differs from a circle [rad]. Chosen: half a turn; a smaller value
drops the error of the tilt too early, a larger one drops it too late."""
_OFF = 8.0
"""Largest distance of a correct match from the arc, in standard deviations of the residuals [1]. Chosen: a smaller
value discards good frames, a larger one keeps wrong matches."""
_OFF_LEAST = 0.5
"""Lower limit of the largest distance of a correct match from the arc [px]. Chosen: a smaller value discards good
frames of sharp films, a larger one keeps wrong matches."""
_ON = 0.8
"""Smallest share of frames on the arc [1]. Chosen: a smaller value accepts other paths, a larger one refuses films with
occlusions."""
_COMPARED = 300
"""Number of frames in which another rotation about the pivot is searched for [frames]. Chosen: a larger number costs
time, a smaller one shows little motion."""
_STILL = 1.0
"""Smallest extent of a path [px]. Chosen: a smaller value measures a body at rest, a larger one refuses small
oscillations."""
_STILL_NOISE = 12.0
"""Smallest extent of a path in standard deviations of its noise [1]. Chosen: a smaller value measures noise, a larger
one refuses small oscillations."""
_BY_PLACE = 0.005
"""Smallest position-dependent error of a learnt picture and background, due to interpolation and blur [px]. Measured:
0.003 to 0.005 px for rendered bobs."""
_LEARNT = 0.4
"""Smallest position-dependent error of a learnt picture and background divided by the noise of a position [1].
Measured: 0.3 to 0.8 for rendered bobs."""
_CONTRADICTS = 3.0
"""Largest distance of the hub of the arc from the given hub without a warning, in standard deviations [1]. Chosen: a
smaller value warns of accurate hubs, a larger one accepts biased angles."""
_ALWAYS = 0.9
"""Smallest share of the frames with an automatically selected point [1]. Chosen: a smaller value accepts
other objects, a larger one refuses films with occlusions."""
_ROUND = 0.03
"""Largest radial scatter of an automatically selected point, divided by the extent of its path [1]. Chosen: a smaller
value refuses blurred bobs, a larger one accepts other paths."""
_REVERSALS = 2
"""Number of passages above which the path of an automatically selected, oscillating point is accepted [1]. Chosen: a
thrown ball does not retrace its path; a larger value refuses short films."""
_TURNS = 1.2
"""Smallest number of turns of an automatically selected point about a pivot [turns]. Chosen: a thrown ball does not
retrace its path; a smaller value accepts such a ball, a larger one refuses short films."""
_JUMP = 5.0
"""A step of the angle from frame to frame counts as a jump, for example to the next throw of a ball, if the step
divided by the median step is at least this value [1]. Chosen: a pendulum passes its middle at 1.4 times the median
step; a larger value follows jumps."""


@dataclass(frozen=True)
class TrackedPoint:
    """The motion of a point about a pivot."""

    frame: Integers  # shape (m,); frames in which the point was measured
    # shape (m, 2); position (x, y) and its standard uncertainty [px]
    place: Floats
    place_sigma: Floats
    # shape (m,); unwrapped angle about the hub, counter-clockwise as seen, and its uncertainty from the position [rad]
    angle: Floats
    sigma: Floats
    hub: Floats  # shape (2,); pivot (x, y) [px]
    # shape (2, 2); covariance of the pivot [px2]: an error common to all angles, in addition to `sigma`
    hub_covariance: Floats
    view: float  # relative standard uncertainty of all angles due to the unknown tilt of the camera
    way: str
    path: PointPath
    arc: Arc
    warnings: tuple[str, ...]
    ambiguous: bool = False
    orbit: Orbit | None = None  # orbit about a tilted axis; the angles are then in the plane of the body

    def error_by_place(self, width: float) -> float:
        """Return the standard deviation [rad] of position-dependent errors of the angles on part of an orbit.

        In addition to the residuals of the circle, the result contains the third order of the perspective of a camera
        at a distance of about one `width` of the picture [px]: a^3 phi^2 / width^2 for a path of half length a and a
        tilt phi. This error resembles a nonlinear restoring torque. The first order is the scale, which `view`
        includes.
        """
        if self.view == 0.0:
            return 0.0
        half = 0.5 * float(np.hypot(*np.ptp(self.place, axis=0)))
        perspective = half**3 * TILT**2 / width**2
        return math.hypot(perspective, self.arc.by_place) / float(
            np.median(np.hypot(*(self.place - self.hub).T))
        )

    @property
    def whole_sigma(self) -> Floats:
        """Standard uncertainty (m,) of the angles, including common errors: pivot and place on the arc [rad]."""
        shared = math.hypot(self.arc.by_place, math.sqrt(0.5 * float(np.trace(self.hub_covariance))))
        return np.asarray(np.hypot(self.sigma, shared / np.hypot(*(self.place - self.hub).T)))

    def displaced(self) -> list[Floats]:
        """Return the angles (m,) about two hubs, displaced by one standard deviation along each principal axis.

        For a tilted axis, return the angles for orbits displaced along each of the five axes of the covariance.
        """
        if self.orbit is not None:
            size, axes = np.linalg.eigh(self.orbit.covariance)
            moved = [
                replace(self.orbit, value=self.orbit.value + math.sqrt(max(float(v), 0.0)) * a)
                for v, a in zip(size, axes.T, strict=True)
            ]
            return [angles_about(np.zeros(2), o.plane(self.place)) for o in moved]
        values, axes = np.linalg.eigh(self.hub_covariance)
        shifts = [math.sqrt(max(float(v), 0.0)) * a for v, a in zip(values, axes.T, strict=True)]
        return [angles_about(self.hub + s, self.place) for s in shifts]


def follow_point(
    film: Film,
    start: tuple[float, float] | None,
    hub: tuple[float, float] | None = None,
    progress: Progress | None = None,
    seen: Foreground | None = None,
) -> TrackedPoint:
    """Follow a point of a film and measure its angle about a pivot.

    `start` is the position (x, y) in the first frame [px]; without `start`, the only compact body that moves is
    followed. `hub` is the pivot (x, y) [px], which may be outside the picture; without `hub`, the pivot is the centre
    of the path. `progress` is called with the number of measured frames and the number of all frames. `seen` is the
    foreground of the film, if it is known. A TrackingError is raised if the film has no point to follow, or if the path
    does not determine the pivot.
    """
    path = track_point(film, start, _turn_about(hub), progress, seen)
    return _of_path(film, path, start, hub)


def follow_path(
    film: Film,
    start: tuple[float, float] | None,
    hub: tuple[float, float] | None = None,
    progress: Progress | None = None,
) -> TrackedPoint | PointPath:
    """Follow a point like `follow_point`; if the path does not determine the pivot, return the path alone."""
    path = track_point(film, start, _turn_about(hub), progress)
    try:
        return _of_path(film, path, start, hub)
    except TrackingError:
        if start is None:  # an automatically selected point must move about a pivot
            raise
        return replace(path, covariance=_white_scale(path) ** 2 * path.covariance)


def _white_scale(path: PointPath) -> float:
    """Return the white noise of the positions of a path, divided by their formal standard uncertainty, at least 1."""
    formal = np.sqrt(np.stack([path.covariance[:, i, i] for i in (0, 1)], axis=1))
    noise = [white_noise(path.place[:, i], path.frame) / float(np.median(formal[:, i])) for i in (0, 1)]
    return max(*noise, 1.0)


@dataclass(frozen=True)
class SecondLink:
    """The direction of the second link of a double pendulum, from the joint to a point of the link."""

    frame: Integers  # shape (m,); frames in which both points are measured
    # shape (m,); unwrapped direction, counter-clockwise from the right of the picture, and its standard uncertainty
    # [rad], which contains `off_axis`
    angle: Floats
    sigma: Floats
    # shape (m,); standard uncertainty of the direction [rad] because the points are not exactly on the axis of the
    # joint and not exactly fixed to the link
    off_axis: Floats
    path: PointPath  # path of the point


_FEWEST_COMMON = 7
"""Smallest number of frames with both points of a link [frames]. Derived: the white noise of an angle is estimated from
more than three differences of order 2, six values."""
_RIGID = 0.05
"""Largest relative scatter of the distance of two points of one rigid link [1]. Chosen: as `_links._RIGID`; a smaller
value refuses views beside the axis, a larger one joins two bodies."""
OFF_AXIS = 1.0
"""Standard deviation of the displacement of a followed point from the axis of the joint, per axis [px].
Measured: 0.2 to 1.6 px for markers of drawn links."""
_ON_LINK = 0.05
"""Standard uncertainty per axis of the position of a point on a link, due to other rods in its patch that turn relative
to the link [px]. Measured: 0.07 px at the joint and 0.03 px at the end, for 15 drawn double pendulums with marks of 6
to 10 px."""
_LINEAR_STEPS = 3
"""Number of linear fits of the displacement of a point from the joint [iterations]. Chosen: the displacement is not
small compared with the first link, so the model is not linear; a smaller number stops before the fits agree, a larger
one costs time."""


def follow_links(
    film: Film,
    starts: tuple[tuple[float, float], tuple[float, float]],
    hub: tuple[float, float] | None = None,
    progress: Progress | None = None,
) -> tuple[TrackedPoint, SecondLink]:
    """Follow the joint of two links and a point of the second link, given their positions in the first frame [px].

    A TrackingError is raised if the distance between the points varies, which indicates a tilted axis or other bodies.
    """
    joint = follow_point(film, starts[0], hub, progress)

    def turn_of(frame: Integers, place: Floats) -> Floats:
        at = np.stack([np.interp(frame, joint.frame, joint.place[:, i]) for i in (0, 1)], axis=1)
        away = place - at
        turn = np.unwrap(np.arctan2(away[:, 1], away[:, 0]))
        return np.asarray(turn - turn[0])

    path = track_point(film, starts[1], turn_of, progress)
    # the centre of the followed patch may differ from the clicked place in the first frame
    beside = math.dist(starts[0], joint.place[0]) if joint.frame[0] == fresh_frames(film)[0] else 0.0
    off = math.hypot(OFF_AXIS, beside)
    second = second_link(joint, path, film.path.name, off)
    if (found := _on_second_link(joint, second, off)) is not None:
        moved, shared = found
        joint = _of_path(film, moved, starts[0], hub)
        # on the second link, the error of the displacement is constant: an error of the zero of its angle
        second = second_link(joint, path, film.path.name, off)
        joint = _with_error(joint, shared[np.isin(moved.frame, joint.frame)])
    return _with_error(joint, np.tile(_ON_LINK**2 * np.eye(2), (len(joint.frame), 1, 1))), second


def _with_error(joint: TrackedPoint, shared: Floats) -> TrackedPoint:
    """Return a point whose uncertainties include an additional error of position, with covariance (m, 2, 2) [px2]."""
    away = joint.place - joint.hub
    radius = np.hypot(*away.T)
    across = np.stack([-away[:, 1], away[:, 0]], axis=1) / radius[:, None]
    of_angle = np.sqrt(np.einsum("ni,nij,nj->n", across, shared, across)) / radius
    of_place = np.sqrt(np.stack([shared[:, i, i] for i in (0, 1)], axis=1))
    return replace(
        joint,
        sigma=np.hypot(joint.sigma, of_angle),
        place_sigma=np.hypot(joint.place_sigma, of_place),
        path=replace(joint.path, covariance=joint.path.covariance + shared),
    )


def second_link(joint: TrackedPoint, path: PointPath, name: str, off: float = OFF_AXIS) -> SecondLink:
    """Return the direction from the joint to a point of the second link.

    `off` is the standard deviation of the displacement of the joint's point from its axis, per axis [px].
    """
    frame, one, two = np.intersect1d(joint.frame, path.frame, return_indices=True)
    if len(frame) < _FEWEST_COMMON:
        raise TrackingError(
            f"Joint and second link of {name} are seen together in only {len(frame)} frames.",
            "Give more distinct points.",
        )
    away = path.place[two] - joint.place[one]
    length = np.hypot(*away.T)
    if float(np.std(length)) > _RIGID * float(np.mean(length)):
        raise TrackingError(
            f"The points of the second link in {name} are {np.mean(length):.0f} +- {np.std(length):.1f} px "
            "apart: they do not belong to a rigid body that is seen along its axis.",
            "Give the joint and a point of the second link, in this order.",
        )
    angle = -np.unwrap(np.arctan2(away[:, 1], away[:, 0]))
    shift, off_axis, rest = _beside_joint(length, angle - joint.angle[one], off)
    along = away / length[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    of_joint, of_end = (
        (
            np.sum((axis * joint.place_sigma[one]) ** 2, axis=1),
            np.einsum("ni,nij,nj->n", axis, path.covariance[two], axis),
        )
        for axis in (along, across)
    )
    # the distance is constant: its scatter in excess of the error of the joint is the error of the point
    by_joint, by_point = (float(np.mean(v)) for v in of_joint)
    scale = max(math.sqrt(max(rest**2 - by_joint, 0.0) / by_point), _white_scale(path))
    sigma: Floats = np.sqrt(of_end[0] + scale**2 * of_end[1]) / length
    sigma = sigma * max(white_noise(angle, frame) / float(np.median(sigma)), 1.0)
    off_axis = np.hypot(off_axis, math.sqrt(2.0) * _ON_LINK) / length  # error of both ends
    path = replace(path, covariance=scale**2 * path.covariance)
    return SecondLink(frame, angle + shift / length, np.hypot(sigma, off_axis), off_axis, path)


def _on_second_link(
    joint: TrackedPoint, second: SecondLink, off: float = OFF_AXIS
) -> tuple[PointPath, Floats] | None:
    """Return the path of the joint, corrected for a followed point beside its axis on the second link, or None.

    The second result is the covariance of the correction (m, 2, 2) [px2], whose error is constant on the second link.

    The displacement d of the followed point from the axis is constant on the second link. The distance of the point
    from the pivot is a constant radius plus the radial part of d. A linear fit with a normal prior of mean 0
    determines d. The result is None for a displacement within three standard uncertainties.
    """
    path = joint.path
    direction = np.interp(path.frame, second.frame, second.angle)
    cos, sin = np.cos(direction), np.sin(direction)
    axes = np.stack([np.stack([cos, -sin], axis=1), np.stack([sin, cos], axis=1)], axis=2)  # (m, xy, axis)
    formal = np.sqrt(0.5 * np.trace(path.covariance, axis1=1, axis2=2))
    d, u = np.zeros(2), np.eye(2)
    for _ in range(_LINEAR_STEPS):
        place = path.place - axes @ d
        arc = fit_arc(place, formal)
        away = place - arc.hub
        radius = np.hypot(*away.T)
        outward = away / radius[:, None]
        radial = np.einsum("ni,nik->nk", outward, axes)
        rows = np.concatenate([radial, outward, np.ones((len(radius), 1))], axis=1)
        found, covariance, _ = _with_prior(rows, radius - arc.radius + radial @ d, off)
        d, u = found[:2], covariance[:2, :2]
    if float(d @ np.linalg.solve(u, d)) < _CONTRADICTS**2:
        return None
    return replace(path, place=path.place - axes @ d), np.einsum("nik,kl,njl->nij", axes, u, axes)


def _with_prior(rows: Floats, value: Floats, off: float) -> tuple[Floats, Floats, float]:
    """Fit a linear model to values (n,); the first two parameters have a normal prior of standard deviation `off`.

    The results are the parameters, their covariance for correlated residuals, and the rms residual.
    """
    prior = np.diag([off**-2, off**-2, *[0.0] * (rows.shape[1] - 2)])
    covariance, found, rest = np.eye(len(prior)), np.zeros(len(prior)), value
    variance = float(np.var(value)) + 1e-12
    for _ in range(3):
        covariance = np.asarray(np.linalg.pinv(rows.T @ rows / variance + prior))
        found = covariance @ (rows.T @ value) / variance
        rest = value - rows @ found
        variance = correlated_variance(rest, 1e-12)
    return found, covariance, float(np.std(rest))


def _beside_joint(length: Floats, between: Floats, off: float = OFF_AXIS) -> tuple[Floats, Floats, float]:
    """Return the correction across the second link for a point beside the joint, with its standard uncertainty [px].

    Let d be the displacement of the point from the joint, which is constant on the first link, phi the angle `between`
    the links, and L the length of the second link. The distance is then L - Re(d exp(-i phi)). The end appears
    displaced by -Im(d exp(-i phi)) across the link [px]. A linear fit of the distances (n,) with a normal prior of mean
    0 determines d. The third result is the rms residual [px].
    """
    cos, sin = np.cos(between), np.sin(between)
    found, covariance, rest = _with_prior(np.stack([-cos, -sin, np.ones_like(cos)], axis=1), length, off)
    across = np.stack([-sin, cos], axis=1)
    # a constant displacement changes the zero of the angle only
    varying = across - across.mean(axis=0)
    sigma = np.sqrt(np.einsum("ni,ij,nj->n", varying, covariance[:2, :2], varying))
    return across @ found[:2], sigma, rest


def _turn_about(hub: tuple[float, float] | None) -> Turn:
    """Return a function for the rotation of a patch, clockwise as seen, about a hub or the hub of its path."""

    def turn_of(_: Integers, place: Floats) -> Floats | None:
        centre = np.array(hub) if hub is not None else None
        if centre is None:
            rough = fit_arc(place, np.full(len(place), 0.5))
            centre = rough.hub if rough.determined else None
        if centre is None:
            return None
        turn = -angles_about(centre, place)
        return np.asarray(turn - turn[0])

    return turn_of


def _of_path(
    film: Film, path: PointPath, start: tuple[float, float] | None, hub: tuple[float, float] | None
) -> TrackedPoint:
    found = about_pivot(path, film.path.name, hub, None if film.tilt is None else film.tilt.angle)
    warnings = list(film.warnings)
    path = found.path
    lost = path.searched - len(path.frame)
    if lost:
        warnings.append(
            f"The point is occluded, lost or outside the picture in {lost} of {path.searched} frames."
        )
    if path.keeps and np.ptp(found.angle) > _WIDE:
        warnings.append(
            "The picture of the body keeps its orientation while it moves about the pivot (a cabin of a Ferris wheel, "
            "a ball in the light of a lamp): the angle is the direction from the pivot to the body, not "
            "the orientation of the body."
        )
    if start is None:
        _check_unselected(found, film.path.name)
        x, y = path.place[0]
        warnings.append(
            f"The compact body that moves, at ({x:.0f}, {y:.0f}) px in the first frame, is followed as a point; "
            "--point X,Y selects another one."
        )
        if (second := _second_rotation(film, found)) is not None:  # the file keeps the last warning
            found = replace(found, warnings=(*found.warnings, second), ambiguous=True)
    return replace(found, warnings=(*warnings, *found.warnings))


def _second_rotation(film: Film, found: TrackedPoint) -> str | None:
    """Return a warning if another body turns about the pivot of the followed body, for a view along the axis."""
    if found.orbit is not None:
        return None
    usable = found.frame[:_COMPARED]
    frames, angle = film.some(usable), -found.angle[:_COMPARED]
    second = second_rotation(frames, Motion.of(frames), (float(found.hub[0]), float(found.hub[1])), angle)
    return None if second is None else second.warning(angle)


def about_pivot(
    path: PointPath, name: str, hub: tuple[float, float] | None = None, tilt: float | None = None
) -> TrackedPoint:
    """Return the motion of a path about the given pivot [px], or about the centre of its arc.

    `tilt` is the camera tilt for which the path is corrected [rad]; None if unknown.
    """
    # relative errors due to the tilt: of all angles, and of the ratio of the radius of curvature to the distance of
    # the hub
    of_angle, of_radius = _VIEW_OF_ANGLE, _VIEW_OF_RADIUS
    if tilt is not None:
        of_angle = 0.5 * math.tan(tilt) * _TILT_U
        of_radius = 2.0 * of_angle
    formal = np.sqrt(0.5 * np.trace(path.covariance, axis1=1, axis2=2))
    least = math.hypot(_BY_PLACE, _LEARNT * float(np.median(formal)))
    orbit = None if tilt is not None else _tilted_orbit(path.place, formal, least)
    if orbit is not None:
        return _about_tilted_axis(path, orbit, formal, least, hub)
    arc = fit_arc(path.place, formal, least)
    if arc.determined:  # remove frames in which another object was matched
        off = np.abs(np.hypot(*(path.place - arc.hub).T) - arc.radius)
        on = off < max(_OFF * math.hypot(arc.noise, arc.by_place), _OFF_LEAST)
        if hub is None and on.mean() < _ON:
            raise TrackingError(
                f"The path of the point in {name} is not an arc of a circle: {100 * (1 - on.mean()):.0f} % of its "
                "positions are not on the best arc.",
                "Give a point at a fixed distance from its pivot with --point X,Y, or the pivot with --hub X,Y.",
            )
        if on.mean() >= _ON:
            path = replace(path, frame=path.frame[on], place=path.place[on], covariance=path.covariance[on])
            formal = formal[on]
    # the noise of the position, from the radial residuals; not below the Cramer-Rao bound
    scale = max(arc.noise / float(np.sqrt(np.mean(formal**2))), 1.0)
    extent = float(np.hypot(*np.ptp(path.place, axis=0)))
    if extent < max(_STILL, _STILL_NOISE * arc.noise):
        raise TrackingError(
            f"The point in {name} does not move: its positions differ by {extent:.2g} px.",
            "Give a point on the moving body with --point X,Y.",
        )
    warnings = []
    ambiguous = extent < path.radius
    centre, covariance, way = arc.hub, arc.covariance, "arc of a point"
    if hub is None:
        far = arc.radius > FARTHEST * max(float(np.abs(path.place).max()), 1.0)
        if not arc.determined or far:
            raise TrackingError(
                f"The path of the point in {name} is straight within its uncertainty: the pivot is not determined.",
                "Give the pivot with --hub X,Y; it may be outside the picture.",
            )
        wide = float(np.ptp(angles_about(centre, path.place))) > _WIDE
        view = 0.0 if wide else of_angle
        if not wide:
            x, y = arc.hub
            u = math.hypot(arc.curvature_u / arc.curvature, view)
            warnings.append(
                f"The arc of the path gives the pivot ({x:.0f}, {y:.0f}) px, at a distance of {arc.radius:.0f} px; all "
                f"angles share a relative uncertainty of {100 * u:.2g} %, of which {100 * view:.2g} % is due "
                "to a possible tilt of the camera. Give the pivot with --hub X,Y, or the tilt with --tilt."
            )
    else:
        given = np.array(hub, dtype=np.float64)
        way = "given, for a point"
        distance = float(np.median(np.hypot(*(path.place - given).T)))
        prior = (HUB_U**2 + (HUB_SHARE * distance) ** 2) * np.eye(2)
        centre, covariance = given, prior
        wide = float(np.ptp(angles_about(given, path.place))) > _WIDE
        view = 0.0 if wide else of_angle
        if arc.determined:
            towards = (arc.hub - path.place.mean(axis=0)) / max(
                float(np.hypot(*(arc.hub - path.place.mean(axis=0)))), 1e-9
            )
            spread = arc.covariance + prior
            if not wide:
                spread = spread + (of_radius * max(arc.radius, distance)) ** 2 * np.outer(towards, towards)
            off = arc.hub - given
            ratio = arc.radius / max(distance, 1e-9)
            if float(off @ np.linalg.solve(spread, off)) > _CONTRADICTS**2:
                ambiguous = True
                warnings.append(_two_hubs(arc, given, path.place))
            elif wide:  # both measure the same position
                centre, covariance = _combined(given, prior, arc.hub, arc.covariance)
                way = "given and arc of a point"
            else:
                # with a tilt phi, the distance of the hub is a cos(phi) and the radius of curvature a / cos(phi), or
                # vice versa
                view = abs(math.log(ratio)) / 2.0 if ratio > 0 else view
                view = math.hypot(view, arc.curvature_u / arc.curvature / 2.0)
                if abs(math.log(ratio)) > 3.0 * arc.curvature_u / arc.curvature:
                    warnings.append(_tilted(ratio, arc, view))
    if extent < path.radius:
        warnings.append(
            f"The body moves by {extent:.0f} px only, less than its size: the background behind it is hidden, and the "
            "amplitude may be wrong. Select a smaller detail with --point X,Y."
        )
    angle = angles_about(centre, path.place)
    away = path.place - centre
    radius = np.hypot(*away.T)
    outward = away / radius[:, None]
    across = np.stack([-outward[:, 1], outward[:, 0]], axis=1)
    radial, along = (np.sqrt(np.einsum("ni,nij,nj->n", v, path.covariance, v)) for v in (outward, across))
    # Along the path, motion blur and jitter of the clock add to the noise. Errors that neighbouring frames have in
    # common, for example due to a codec, are measured only across the path.
    scatter = white_noise(angle, path.frame) * float(np.median(radius))
    along = along * max(scatter / float(np.median(along)), scale)
    place_sigma = np.hypot(scale * radial[:, None] * outward, along[:, None] * across)
    return TrackedPoint(
        frame=path.frame,
        place=path.place,
        place_sigma=place_sigma,
        angle=angle,
        sigma=along / radius,
        hub=centre,
        hub_covariance=covariance,
        view=view,
        way=way,
        path=path,
        arc=arc,
        warnings=tuple(warnings),
        ambiguous=ambiguous,
    )


_GAP = 0.25 * TURN
"""Largest gap of an orbit that shows a tilt [rad]. Chosen: a quarter of a turn; a larger gap leaves the ellipse
undetermined, a smaller one refuses orbits of few positions."""
_ELLIPSE = 0.03
"""Largest deviation (rms) of the points of an orbit from the ellipse, divided by its radius [1]. Chosen: a smaller
value refuses blurred points, a larger one accepts other paths."""
_BETTER = 0.5
"""Largest deviation of the points of a tilted orbit from the ellipse, divided by their deviation from a circle [1].
Chosen: a smaller value leaves small tilts uncorrected, a larger one fits noise."""


def _tilted_orbit(place: Floats, sigma: Floats, least: float) -> Orbit | None:
    """Return the ellipse of a path that covers most of an ellipse and is not a circle; None for any other path."""
    if len(place) < 4 * _FEWEST_ORBIT:
        return None
    try:
        orbit = fit_orbit(place, sigma, least)
    except (ValueError, np.linalg.LinAlgError):
        return None
    if not (np.isfinite(orbit.value).all() and math.hypot(*orbit.value[3:]) < _FLATTEST):
        return None
    away = orbit.plane(place)
    gap = TURN - covered_angle(np.arctan2(away[:, 1], away[:, 0]))
    off = float(np.std(np.hypot(*away.T))) / orbit.value[2]
    circle = fit_arc(place, sigma, least)
    of_circle = float(np.std(np.hypot(*(place - circle.hub).T))) / circle.radius
    if gap > _GAP or off > _ELLIPSE or off > _BETTER * of_circle or not orbit.flattened:
        return None
    return orbit


_FEWEST_ORBIT = 6
"""Smallest number of positions per quarter of an orbit [1]. Chosen: a smaller number leaves no redundancy, a larger one
refuses short films."""
_FLATTEST = 0.6
"""Largest stretch of an orbit, (a - b) / (a + b) [1]. Derived: a tilt of 75 degrees."""


def _about_tilted_axis(
    path: PointPath, orbit: Orbit, formal: Floats, least: float, hub: tuple[float, float] | None
) -> TrackedPoint:
    """Return the motion of a path about a tilted axis: its angles in the plane of the body."""
    arc = fit_arc(path.place, formal, least)
    away = orbit.plane(path.place)
    radius = np.hypot(*away.T)
    rest = radius - np.median(radius)
    on = np.abs(rest) < max(_OFF * 1.4826 * float(np.median(np.abs(rest))), _OFF_LEAST)
    path = replace(path, frame=path.frame[on], place=path.place[on], covariance=path.covariance[on])
    away, radius = away[on], radius[on]
    angle = angles_about(np.zeros(2), away)
    p, q = orbit.value[3:]
    back = np.array([[1.0 - p, -q], [-q, 1.0 + p]]) / (1.0 - p * p - q * q)
    across = np.stack([-away[:, 1], away[:, 0]], axis=1) / radius[:, None]
    plane = np.einsum("ij,njk,lk->nil", back, path.covariance, back)
    along = np.sqrt(np.einsum("ni,nij,nj->n", across, plane, across)) / radius
    along = along * max(white_noise(angle, path.frame) / float(np.median(along)), 1.0)
    centre, covariance = orbit.value[:2], orbit.covariance[:2, :2]
    tilt, short = (math.degrees(v) for v in orbit.tilt)
    text = (
        f"The axis of rotation is tilted by {tilt:.1f} +- {math.degrees(orbit.tilt_u):.1g} degrees relative to the "
        f"line of sight (the orbit is an ellipse, its short axis at {short:.0f} degrees): the angles are measured in "
        "the plane of the body. The film does not show which side is nearer; the sense of rotation is stated as seen."
    )
    warnings = [text]
    ambiguous = False
    if hub is not None:
        off = np.array(hub) - centre
        if float(off @ np.linalg.solve(covariance + HUB_U**2 * np.eye(2), off)) > _CONTRADICTS**2:
            ambiguous = True
            warnings.append(
                f"The centre of the orbit, ({centre[0]:.1f}, {centre[1]:.1f}) px, is used; the given hub is "
                f"{math.hypot(*off):.1f} px away from it."
            )
    scale = max(float(np.std(rest[on])) / float(np.sqrt(np.mean(formal**2))), 1.0)
    sigma = scale * np.sqrt(np.stack([path.covariance[:, i, i] for i in (0, 1)], axis=1))
    return TrackedPoint(
        frame=path.frame,
        place=path.place,
        place_sigma=sigma,
        angle=angle,
        sigma=along,
        hub=centre,
        hub_covariance=covariance,
        view=0.0,
        way="ellipse of a point",
        path=path,
        arc=arc,
        warnings=tuple(warnings),
        ambiguous=ambiguous,
        orbit=orbit,
    )


def _combined(a: Floats, a_cov: Floats, b: Floats, b_cov: Floats) -> tuple[Floats, Floats]:
    """Return the weighted mean of two estimates and its covariance."""
    covariance = np.linalg.inv(np.linalg.inv(a_cov) + np.linalg.inv(b_cov))
    mean = covariance @ (np.linalg.solve(a_cov, a) + np.linalg.solve(b_cov, b))
    return np.asarray(mean), np.asarray(covariance)


def _range(hub: Floats, place: Floats) -> float:
    return float(np.ptp(angles_about(hub, place)))


def _two_hubs(arc: Arc, given: Floats, place: Floats) -> str:
    (x, y), (u, v) = given, arc.hub
    return (
        f"Two pivots: about the given hub ({x:.0f}, {y:.0f}) px the angle ranges over {_range(given, place):.3g} rad, "
        f"about the centre of the path, ({u:.0f}, {v:.0f}) +- "
        f"{math.sqrt(float(np.trace(arc.covariance))):.2g} px, over {_range(arc.hub, place):.3g} rad. One of them is "
        "wrong, or the camera is tilted by more than 45 degrees."
    )


def _tilted(ratio: float, arc: Arc, view: float) -> str:
    tilt = math.degrees(math.acos(min(ratio, 1.0 / ratio) ** 0.5))
    return (
        f"The curvature of the path corresponds to a pivot at {arc.radius:.0f} px, {100 * abs(ratio - 1):.0f} % "
        f"{'farther' if ratio > 1 else 'nearer'} than the given hub: a camera tilted by {tilt:.0f} degrees explains "
        f"both. The angles about the given hub share a relative uncertainty of {100 * view:.2g} % due to this; "
        f"--tilt {tilt:.0f} corrects them if the axis of the tilt is horizontal."
    )


def _check_unselected(found: TrackedPoint, name: str) -> None:
    """Raise a TrackingError unless an automatically selected point certainly moves about a pivot."""
    path, angle = found.path, found.angle
    extent = float(np.hypot(*np.ptp(path.place, axis=0)))
    middle = 0.5 * float(angle.min() + angle.max())
    side = (angle > middle).astype(np.int64)
    step = np.diff(angle)
    pace = np.abs(step / np.diff(path.frame))
    # ignore a point at rest, whose speed is unknown
    moves = pace > 0.1 * np.quantile(pace, 0.9)
    steady = pace < _JUMP * np.median(pace[moves])
    passes = np.diff(side)[steady]
    both_ways = bool((passes > 0).any() and (passes < 0).any())
    gap = TURN - covered_angle(angle)
    turned = float(np.ptp(np.cumsum(step * steady)))
    turns = turned > _TURNS * TURN and gap < 0.5 * TURN
    retraced = turns or (both_ways and np.count_nonzero(passes) > _REVERSALS)
    scatter = math.hypot(found.arc.noise, found.arc.by_place)
    if len(path.frame) < _ALWAYS * path.searched or scatter > _ROUND * extent or not retraced:
        raise TrackingError(
            f"No point that moves about a pivot is found in {name}.",
            "Give a point to follow with --point X,Y, and its pivot with --hub X,Y.",
        )


def point_details(found: TrackedPoint) -> dict[str, Any]:
    """Return the details of tracking for the file of a point, serialisable as JSON."""
    return {
        "method": "registration of a patch",
        "hub_px": [float(v) for v in found.hub],
        "hub_covariance_px2": found.hub_covariance.tolist(),
        "view_relative_u": found.view,
        "arc_px": {
            "hub": [float(v) for v in found.arc.hub],
            "radius": found.arc.radius,
            "noise": found.arc.noise,
            "by_place": found.arc.by_place,
        },
        "tilt_rad": None if found.orbit is None else [*found.orbit.tilt, found.orbit.tilt_u],
        "patch_px": found.path.radius,
        "patch_turns": found.path.turns,
    }
