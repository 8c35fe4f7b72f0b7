"""Angles of the bodies from the observations of their markers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrotrack._arrays import Bools, Floats, Integers
from gyrotrack._column_store import release_pages
from gyrotrack._smoothing import BORROWED_NU, TimeBase, jitter_is_real, median_of, spread
from gyrotrack.tracking._aliasing import doubtful, slowing
from gyrotrack.tracking._association import SENSE_TURN, find_rotation_sense, net_turn, unfold
from gyrotrack.tracking._film_tracker import BATCH, BodyObservations, FilmObservations
from gyrotrack.tracking._frame_repeats import seen_angle, turning_most
from gyrotrack.tracking._fusion import (
    FAST,
    PLACE_ORDERS,
    VIEW_ORDERS,
    BodyAngles,
    MarkerAngles,
    join,
    variance_left,
    wrapped,
)
from gyrotrack.tracking._harmonics import change_with_speed, harmonic_error
from gyrotrack.tracking._hub import (
    LEAST_RADIUS_SCATTER,
    LEAST_SIGMA,
    CentrePath,
    Radii,
    fast_motion,
    marked_paths,
    refine_centre,
    wandering_centre,
)
from gyrotrack.tracking._marker_tracker import (
    Candidate,
    MarkerObservations,
    candidate,
    excess_misfit,
    plausible,
    spread_out,
)
from gyrotrack.tracking._orbit import (
    CELL,
    LEAST_OBSERVATIONS,
    MOST_OBSERVATIONS,
    NO_FLATTENING,
    Flattening,
    fit_common_offset,
    fit_flattening,
    flattening_of_arc,
    higher_harmonics,
    mixture,
)
from gyrotrack.tracking._profile import Profile
from gyrotrack.tracking._scene import Marker, Scene
from gyrotrack.tracking._template_zeros import (
    TemplateZeros,
    change_of_harmonics,
    scatter_of_templates,
    template_zeros,
)
from gyrotrack.tracking._texture import CENTRE_ERROR, TextureObservations
from gyrotrack.video._time_base import FrameTimes

_CORNER = 0.7
"""Half width of a marker without motion blur, relative to its blurred half width [1]. Chosen: used only to decide
whether a marker is inside the picture; a larger value rejects frames near the border."""


@dataclass(frozen=True)
class BodyView:
    """The observations of a body's markers."""

    markers: tuple[Marker, ...]
    observations: dict[str, MarkerObservations]  # by name
    inside: dict[str, Bools]  # frames in which a marker is within the picture
    whole: dict[str, Bools]  # frames of `inside` in which the marker is unoccluded and plausible

    @property
    def radius(self) -> float:
        """Mean radius of the markers in px."""
        return float(np.mean([p.radius for p in self.markers]))

    @property
    def coloured(self) -> tuple[str, ...]:
        """The markers that, like the disc, are measured in the chroma planes.

        They are preferred, because luma may be displaced from chroma by half a px.
        """
        return tuple(p.name for p in self.markers if p.colour != "white")

    def place(self, name: str, centre: Floats) -> Floats:
        """Return the position of a marker relative to the centre, (n, 2) in px, y up."""
        away = self.observations[name].position(self.whole[name])
        away -= centre
        away[:, 1] *= -1.0
        release_pages()
        return away

    def flattening(self, centre: Floats) -> Flattening:
        """Fit tilt and offsets to the orbits of the markers.

        The coloured markers share one offset if each of them covers only a part of its orbit.
        """
        orbits = self._orbits(centre)
        found = fit_flattening(orbits)
        if any(name in found.offset for name in self.coloured):
            return found
        common = fit_common_offset({name: orbits[name] for name in self.coloured})
        return replace(common, offset=found.offset | common.offset) if common.offset else found

    def reference(self, flat: Flattening) -> list[str]:
        """Return the markers with a known offset: the coloured markers (see `coloured`), or all if none is coloured."""
        return [name for name in self.coloured if name in flat.offset] or list(flat.offset)

    def with_arcs(self, flat: Flattening, centre: Floats) -> Flattening:
        """Add the offsets of markers that cover only an arc; their prior mean is the mean offset of other markers."""
        absent = [name for name in self.observations if name not in flat.offset]
        if not absent:
            return flat
        size = float(np.hypot(HEIGHT * flat.tilt * self.radius, LUMA_SHIFT))
        arcs = {name: self._trusted(name, centre) for name in absent}
        arc = flattening_of_arc(
            flat, arcs, flat.shift(self.reference(flat)), size, usual_error_by_place(self)
        )
        return replace(flat, offset=flat.offset | arc.offset, offset_covariance=arc.offset_covariance)

    def flattening_of_arc(
        self, centre: Floats, reference: Flattening, shift: Floats, size: float
    ) -> Flattening:
        """Take the tilt from another body, and fit offsets to the arcs (see the function `flattening_of_arc`)."""
        usual = usual_error_by_place(self)
        return flattening_of_arc(reference, self._orbits(centre), shift, size, usual)

    def _orbits(self, centre: Floats) -> dict[str, Floats]:
        return {p.name: self._trusted(p.name, centre) for p in self.markers}

    def _trusted(self, name: str, centre: Floats) -> Floats:
        v = self.place(name, centre)
        return v[self.whole[name] & np.isfinite(v).all(axis=1)]

    def radii(self, centre: Floats, flat: Flattening) -> Iterator[Radii]:
        """Yield the residual of the radius of each marker in each frame."""
        for marker in self.markers:
            v = flat.level(marker.name, self.place(marker.name, centre))
            radius = np.where(self.whole[marker.name], np.hypot(v[:, 0], v[:, 1]), np.nan)
            usual = float(np.nanmedian(radius)) if np.isfinite(radius).any() else np.nan
            yield Radii(np.arctan2(v[:, 1], v[:, 0]), radius - usual)

    def candidates(self, centre: CentrePath, flat: Flattening) -> dict[str, Candidate]:
        """Return the angles of the markers corrected for the oblique view, with their quality."""
        found = {}
        for marker in self.markers:
            v = flat.level(marker.name, self.place(marker.name, centre.centre))
            angle = np.asarray(np.arctan2(v[:, 1], v[:, 0]))
            good = plausible(self.observations[marker.name]) & self.inside[marker.name]
            found[marker.name] = candidate(self.observations[marker.name], angle, good, marker.mount)
        return found


def view(
    markers: tuple[Marker, ...], observations: dict[str, MarkerObservations], size: tuple[int, int]
) -> BodyView:
    """Collect the observations of a body's markers in a picture of (width, height) px."""
    inside = {
        p.name: ~observations[p.name].outside(p.inner, p.outer, _CORNER * p.half_width, size) for p in markers
    }
    whole = {m: plausible(observations[m]) & observations[m].open & inside[m] for m in inside}
    return BodyView(markers, observations, inside, whole)


BLOCK_ERROR = 0.09
"""Systematic position-dependent error due to the blocks of the encoder, if no body turns enough to measure it [px].
Measured: rms over films of many kinds."""
LIGHT_ERROR = 0.8e-3
"""Systematic position-dependent error due to uneven illumination, if no body turns enough to measure it [rad].
Measured: rms over films of many kinds."""


_BETTER = 4.0
"""Another path of the hub is preferred if it reduces the mean squared residual of the radii by at least this number of
standard errors [1]. Chosen: a smaller value follows noise, a larger one keeps a smooth path of a shaking camera."""
_TOGETHER = 16
"""Number of frames over which the errors of radii are taken as correlated [frames]. Chosen: twice the
correlation length of the errors of a compressed film (`_hub.HOLE`); a smaller value overstates the significance, a
larger one leaves few groups."""


def followed_path(paths: list[CentrePath], views: dict[str, BodyView]) -> CentrePath:
    """Select the path of the hub about which the radii of the markers vary least.

    The first path is selected unless another one is better by `_BETTER` standard errors.

    An error n of the centre changes the radius of a marker in the direction of the unit vector r by -n . r. The radii
    can judge the paths, because their errors are independent of errors of the disc.
    """
    best = paths[0]
    flat = _flattening(best, views) if len(paths) > 1 else {}
    before = _squares(best, views, flat) if len(paths) > 1 else np.zeros(0)
    for path in paths[1:]:
        after = _squares(path, views, flat)
        if _is_better(before, after):
            best, before = path, after
    return best


LEAST_ARC = 1.0
"""The offset of the disc from the rotor's axis is determined if the casing turns by at least this angle [rad]. Chosen:
a smaller value mistakes drift for an offset, a larger one ignores short films."""
SIGNIFICANT = 3.0
"""Smallest offset of the disc that is corrected, in standard errors of a harmonic of the radii [1]. Chosen: three
standard deviations; a smaller value corrects noise, a larger one leaves offsets."""
_CLIP = 4.0
"""Smallest residual of a radius that is an outlier, in robust standard deviations [1]. Chosen: a smaller value rejects
good radii, a larger one keeps partly occluded markers."""


def about_rotor(path: CentrePath, views: dict[str, BodyView]) -> CentrePath:
    """Correct the path of a disc that is fixed to the casing at an offset from the axis of the rotor.

    The disc then moves on a circle about the axis, at the angle c of the casing. Its offset d is constant in the frame
    of the casing. With the unit vector r, d changes the radius of a rotor marker at the angle a by -d . r(a - c). It
    also displaces the marker along its orbit by up to |d|, depending on a - c. The markers of the casing are displaced
    equally in all frames. d is fitted to the radii together with the offset and the flattening of each orbit. It is
    subtracted if this reduces the scatter of the radii.
    """
    if "casing" not in views or "rotor" not in views:
        return path
    casing = views["casing"]
    name = max(casing.whole, key=lambda m: int(casing.whole[m].sum()))
    v = casing.place(name, path.centre)
    known = np.flatnonzero(casing.whole[name] & np.isfinite(v).all(axis=1) & np.isfinite(path.sigma))
    angle = np.unwrap(np.arctan2(v[known, 1], v[known, 0]))
    if len(known) < LEAST_OBSERVATIONS or np.ptp(angle) < LEAST_ARC:
        return path
    angle = np.interp(np.arange(len(v)), known, angle)
    flat = _flattening(path, views)
    normal, right = np.zeros((2, 2)), np.zeros(2)
    for one in views["rotor"].radii(path.centre, flat["rotor"]):
        own = _offset_on_casing(one, angle)
        normal, right = normal + own[0], right + own[1]
    offset = complex(*np.linalg.lstsq(normal, right, rcond=None)[0])
    if abs(offset) < SIGNIFICANT * _error_of_harmonic(path, views["rotor"], flat["rotor"]):
        return path
    circle = offset * np.exp(1j * angle)
    better = replace(path, centre=path.centre - np.stack([circle.real, -circle.imag], axis=1))
    before, after = _squares(path, views, flat), _squares(better, views, _flattening(better, views))
    return better if _is_better(before, after) else path


def _offset_on_casing(radii: Radii, casing: Floats) -> tuple[Floats, Floats]:
    """Return the normal equations, (2, 2) and (2,), of the disc's offset on the casing from one marker's radii."""
    use = np.flatnonzero(np.isfinite(radii.excess) & np.isfinite(radii.direction))
    use = use[:: max(len(use) // MOST_OBSERVATIONS, 1)]
    a, excess = radii.direction[use], radii.excess[use]
    relative = a - casing[use]
    columns = [-np.cos(relative), -np.sin(relative), np.ones_like(a)]
    design = np.stack([*columns, *(f(k * a) for k in (1, 2) for f in (np.cos, np.sin))], axis=1)
    keep = np.ones(len(a), dtype=np.bool_)
    normal, right = np.zeros((2, 2)), np.zeros(2)
    for _ in range(3):
        if keep.sum() < LEAST_OBSERVATIONS:
            return np.zeros((2, 2)), np.zeros(2)
        apart = (
            design[keep, :2]
            - design[keep, 2:] @ np.linalg.lstsq(design[keep, 2:], design[keep, :2], rcond=None)[0]
        )
        normal, right = apart.T @ apart, apart.T @ excess[keep]
        residual = excess - design @ np.linalg.lstsq(design[keep], excess[keep], rcond=None)[0]
        scatter = max(spread(residual[keep]), LEAST_RADIUS_SCATTER)
        keep = np.abs(residual) < _CLIP * scatter
    return normal / scatter**2, right / scatter**2


def _squares(path: CentrePath, views: dict[str, BodyView], flat: dict[str, Flattening]) -> Floats:
    """Return the squared residuals of the radii of all markers about a path, (markers, n) [px^2]."""
    radii = [one for name, seen in views.items() for one in seen.radii(path.centre, flat[name])]
    return np.array([np.where(np.isfinite(path.sigma), one.excess, np.nan) ** 2 for one in radii])


_MOST_CHANGE = 50.0
"""Upper limit of the ratio of a squared residual to its typical value [1]. Chosen: a marker that is mistaken for
another one is an outlier; with a larger value such an outlier dominates the mean, a smaller one hides camera shake."""


def _is_better(before: Floats, after: Floats) -> bool:
    """Return whether squared residuals `after` are significantly smaller than `before`, averaged over the markers."""
    gain = []
    for one, other in zip(before, after, strict=True):
        use = np.isfinite(one) & np.isfinite(other)
        size = max(float(np.median(other[use])), 1e-4) if use.any() else 1.0
        # limit outliers, for example of a marker that is mistaken for another one
        change = np.clip(one / size, 0.0, _MOST_CHANGE) - np.clip(other / size, 0.0, _MOST_CHANGE)
        groups = np.nan_to_num(np.where(use, change, 0.0))[: len(use) // _TOGETHER * _TOGETHER]
        gain.append(groups.reshape(-1, _TOGETHER).mean(axis=1))
    mean = np.mean(gain, axis=0)
    return len(mean) > 2 and bool(mean.mean() > _BETTER * mean.std() / np.sqrt(len(mean) - 1))


def correct_view(
    centre: CentrePath, views: dict[str, BodyView], profile: Profile, *, marked: bool
) -> tuple[CentrePath, dict[str, Flattening]]:
    """Fit the flattening of each body's orbits; a marked centre is then corrected by the radii of the markers."""
    if not profile.tilt_correction:
        return centre, dict.fromkeys(views, NO_FLATTENING)
    flat = _flattening(centre, views)
    if not marked:
        return centre, flat
    better = refine_centre(
        centre, (r for name, body_view in views.items() for r in body_view.radii(centre.centre, flat[name]))
    )
    return better, _flattening(better, views)


def _flattening(centre: CentrePath, views: dict[str, BodyView]) -> dict[str, Flattening]:
    """Fit the flattening of each body's orbits; a body with arcs gets the flattening of a body with full orbits."""
    flat = {name: body_view.flattening(centre.centre) for name, body_view in views.items()}
    known = [name for name in views if flat[name].offset]
    if not known:
        return flat
    error = max(_error_of_harmonic(centre, views[name], flat[name]) / views[name].radius for name in known)
    tilt = _common_tilt({name: flat[name] for name in known}, views, error)
    for name in known:
        flat[name] = replace(flat[name], p=tilt.real, q=tilt.imag, error=error)
    body_view, reference = views[known[0]], flat[known[0]]
    shift = _shrunk(
        reference.shift(body_view.reference(reference)),
        usual_error_of_harmonic(body_view, len(body_view.coloured)),
    )
    found = {}
    for name, own in flat.items():
        radius = views[name].radius
        if own.offset:
            found[name] = views[name].with_arcs(own, centre.centre)
        elif name == "casing":
            expected, size = np.stack([np.zeros(2), shift]), _height_error(reference, body_view, radius)
            found[name] = views[name].flattening_of_arc(centre.centre, reference, expected, size)
        else:
            size = float(np.hypot(DEPTH * reference.tilt * radius, LEAST_SIGMA))
            found[name] = views[name].flattening_of_arc(centre.centre, reference, shift, size)
    return found


LEAST_PLACES = 14
"""Smallest number of sectors of half a `CELL` in which the radius of a marker is known [1]. Derived: one more than the
13 coefficients of `higher_harmonics`."""


def _error_of_harmonic(centre: CentrePath, body_view: BodyView, flat: Flattening) -> float:
    """Return the position-dependent error of the radii of a body in one component of one harmonic [px].

    It is determined from the harmonics of orders 3 to 6, which neither an offset nor a tilt causes. The mean over the
    markers is used, because a shadow displaces all of them equally at each place. The result combines this estimate
    with the typical error, as two estimates of one variance. A marker that turns in step with the frames is seen at
    only a few places and is not used.
    """
    usual = usual_error_of_harmonic(body_view)
    found = []
    for marker, one in zip(body_view.markers, body_view.radii(centre.centre, flat), strict=True):
        known = np.isfinite(one.excess) & np.isfinite(one.direction)
        places = np.unique(np.rint(one.direction[known] / (0.5 * CELL)))
        if marker.name in body_view.reference(flat) and len(places) >= LEAST_PLACES:
            found.append(higher_harmonics(one.direction[known], one.excess[known]))
    if not found:
        return usual
    seen = np.mean(found, axis=0)
    return float(np.sqrt((BORROWED_NU * usual**2 + seen @ seen) / (BORROWED_NU + len(seen))))


def _common_tilt(flat: dict[str, Flattening], views: dict[str, BodyView], error: float) -> complex:
    """Return the flattening p + i q of all bodies.

    One camera sees all bodies, so the ellipses of their orbits have the same shape. The component of p + i q across the
    direction of the tilt is an error. The component along the tilt cannot be negative. Its estimate is the posterior
    mean for a normally distributed `error` and a uniform prior from 0.
    """
    total, number = 0j, 0
    for name, one in flat.items():
        markers = sum(m in one.offset for m in views[name].observations)
        total, number = total + markers * complex(one.p, one.q), number + markers
    mean = total / number
    along = -np.exp(2j * _azimuth(mean, error, flat, views))
    ratio = max(float((mean * np.conj(along)).real) / error, -5.0)
    density = math.exp(-0.5 * ratio**2) / math.sqrt(2.0 * math.pi)
    return complex(along * error * (ratio + density / (0.5 * math.erfc(-ratio / math.sqrt(2.0)))))


def _azimuth(tilt: complex, error: float, flat: dict[str, Flattening], views: dict[str, BodyView]) -> float:
    """Return the azimuth of the tilt [rad], y up.

    Two quantities determine it: the ellipse of an orbit (p + i q = `tilt`, with its `error`), and the offset of an
    orbit below the hub. The angles are doubled because the ellipse does not determine the sense of the tilt; each angle
    has the weight 1 / variance.
    """
    total = -tilt * abs(tilt) / error**2
    for name, one in flat.items():
        if coloured := [m for m in views[name].coloured if m in one.offset]:
            shift = complex(*one.shift(coloured))
            total += 0.25 * shift**2 / usual_error_of_harmonic(views[name], len(coloured)) ** 2
    return 0.5 * float(np.angle(total))


HEIGHT = 0.03
"""Standard deviation of the height of the hub's disc above the casing's marker, in radii of the orbit of this marker
[1]. Derived: 1 mm divided by a radius of 35 mm."""
LUMA_SHIFT = 0.5
"""Distance by which the luma of a marker may be displaced from the chroma [px]. Derived: conventions for the place of
chroma samples differ by half a luma pixel."""
DEPTH = 0.5
"""Standard deviation of the depth of the rotor's markers below the disc, in radii of their orbit [1]. Chosen: the rotor
may be at any depth; a smaller value biases the offset to 0; with a larger one, arcs alone determine the
offset."""


def _height_error(flat: Flattening, body_view: BodyView, radius: float) -> float:
    """Return the uncertainty of the offset of the casing's orbit [px]; a height h and a tilt t cause an offset h sin t.

    The ellipses of the orbits determine a small tilt poorly. If the offset e of the orbit of the rotor (`body_view`) is
    due to the depth of the rotor, the tilt is e / depth.
    """
    offset = float(np.hypot(*flat.shift(body_view.reference(flat))))
    tilt = max(flat.tilt, offset / (DEPTH * body_view.radius))
    return float(np.hypot(HEIGHT * tilt * radius, LEAST_SIGMA))


def usual_error_by_place(body_view: BodyView, markers: int = 1) -> float:
    """Return the typical position-dependent error of the mean of markers [px].

    The part due to light is the same for all markers, so it does not average out.
    """
    return float(np.hypot(BLOCK_ERROR / np.sqrt(markers), LIGHT_ERROR * body_view.radius))


def usual_error_of_harmonic(body_view: BodyView, markers: int = 1) -> float:
    """Return the typical position-dependent error in one component of a harmonic [px].

    It is assumed that all components have equal variances.
    """
    return usual_error_by_place(body_view, markers) / math.sqrt(len(PLACE_ORDERS))


def _shrunk(found: Floats, error: float) -> Floats:
    """Return a vector, (2,), shrunk according to the standard uncertainty of its components (James-Stein)."""
    return np.asarray(found * max(1.0 - 2.0 * error**2 / float(found @ found + 1e-12), 0.0))


def error_by_place(body_view: BodyView, flat: Flattening, body: BodyAngles) -> float:
    """Return the position-dependent error of a body without the first harmonic [px].

    The lower limit of the result is the learnt error or the typical error, whichever is smaller.
    """
    learnt, perspective = body.place_error * body_view.radius, axis_offset(body_view, flat, body)
    left = float(np.sqrt(max(learnt**2 - 0.5 * float(perspective @ perspective), 0.0)))
    return max(left, min(learnt, usual_error_by_place(body_view)))


def axis_offset(body_view: BodyView, flat: Flattening, body: BodyAngles) -> Floats:
    """Return the position of a fast body's axis from its angles minus the position from its radii, (2,) [px], y up.

    The difference is shrunk according to its uncertainty.
    """
    off = _axis_by_angles(body_view, flat, body)
    known = max(len(body_view.reference(flat)), 1)
    return _shrunk(off, np.sqrt(2.0) * usual_error_of_harmonic(body_view, known))


def _axis_by_angles(body_view: BodyView, flat: Flattening, body: BodyAngles) -> Floats:
    """Return the position of the axis from angles minus the position from radii, (2,) [px], y up.

    The difference is averaged over the markers; it is 0 if it is unknown.
    """
    off = [body.axis_off[m] * body_view.radius for m in body_view.reference(flat) if m in body.axis_off]
    return np.mean([(z.real, z.imag) for z in off], axis=0) if off else np.zeros(2)


def separate_perspective(
    centre: CentrePath, views: dict[str, BodyView], flat: dict[str, Flattening], rotor: BodyAngles
) -> Flattening:
    """Return the flattening of the casing's orbit about a marked hub, with perspective separated from its offset.

    Let e be the centre of a circle relative to the hub. Perspective enlarges the near half of the circle. The radii of
    the circle then vary like the radii of a circle about e + a, where a is proportional to the square of the radius.
    The angles remain angles about e. The markers of the rotor turn fast, so their angles determine e, and their radii
    determine a + e.

    The radii of the casing give its offset plus the displacement a by perspective. The displacement is subtracted. Two
    values of the offset are expected. The offset is zero if the disc and the marker of the casing are on one body; the
    offset of the rotor is then due to the depth of the rotor. It is the offset of the rotor if the disc is above both
    bodies. Both expected values have the uncertainty `_height_error`. All measurements have position-dependent errors.
    """
    own, body_view, reference = flat["casing"], views["rotor"], flat["rotor"]
    if not own.offset or not reference.offset:
        return own
    error = usual_error_of_harmonic(body_view)
    # Perspective acts along the tilt. The component across the tilt is pure error; it is an estimate of the error with
    # one degree of freedom.
    azimuth = _azimuth(
        complex(reference.p, reference.q), error / body_view.radius, {"rotor": reference}, views
    )
    along = np.array([np.cos(azimuth), np.sin(azimuth)])
    off = _axis_by_angles(body_view, reference, rotor)
    if rotor.axis_off:
        across = float(along[0] * off[1] - along[1] * off[0])
        error = math.sqrt((BORROWED_NU * error**2 + across**2) / (BORROWED_NU + 1.0))
    offset = along * float(along @ _shrunk(off, np.sqrt(2.0) * error))
    axis = _shrunk(reference.shift(body_view.reference(reference)) + offset, error)
    more = (views["casing"].radius / body_view.radius) ** 2
    perspective = -more * offset
    size = _height_error(reference, body_view, views["casing"].radius)
    expected = np.stack([np.zeros(2), axis])
    if own.offset_covariance.keys() == own.offset.keys():
        tilted = replace(reference, p=own.p, q=own.q)
        arc = views["casing"].flattening_of_arc(centre.centre, tilted, expected + perspective, size)
        return arc.moved(-perspective)
    shift = own.shift(own.offset)
    measured, noise = shift - perspective, error**2 * (1.0 + more**2)
    if not rotor.axis_off:
        noise += (PERSPECTIVE * reference.tilt * views["casing"].radius) ** 2
    sure = size**2 / (size**2 + noise)
    means = [one + sure * (measured - one) for one in expected]
    evidence = [-0.5 * float(np.sum((measured - one) ** 2)) / (size**2 + noise) for one in expected]
    mean, covariance = mixture(means, [(1.0 - sure) * size**2 * np.eye(2)] * 2, evidence)
    return replace(own.moved(np.array(mean) - shift), offset_covariance=dict.fromkeys(own.offset, covariance))


PERSPECTIVE = 0.05
"""Radius of the casing's orbit divided by the distance of the camera, if no fast rotor determines it [1]. Derived: 35
mm at a distance of 70 cm."""


def offset_uncertainty(candidates: dict[str, Candidate], flat: Flattening) -> Floats:
    """Return the uncertainty of the positions of a body's markers along the orbit due to the offsets, (n,) in px."""
    own = [np.nan_to_num(flat.tangential_sigma(name, c.angle)) for name, c in candidates.items()]
    return np.asarray(np.sqrt(np.mean(np.square(own), axis=0)))


def _tilt_uncertainty(candidates: dict[str, Candidate], flat: Flattening) -> Floats:
    """Return the uncertainty of the angles of a body's markers due to the tilt of the camera, (n,) in rad."""
    own = [np.nan_to_num(flat.tilt_sigma(c.angle)) for c in candidates.values()]
    return np.asarray(np.sqrt(np.mean(np.square(own), axis=0)))


_FAR = 0.05
"""The motion of the centre is followed if the range of its positions, relative to the radius of the orbit, is at least
this value [1]. Chosen: a smaller value follows noise, a larger one uses the mean position of a moving hub."""


@dataclass(frozen=True)
class TrackedBodies:
    """All bodies of a clip."""

    centre: CentrePath  # the centre in every frame
    bodies: dict[str, BodyAngles]  # angles as they appear in the film, before they are multiplied by `sense`
    flattening: dict[str, Flattening]  # effect of the oblique view on each body's orbits
    sense: int  # factor that makes the angles increase
    warnings: tuple[str, ...]  # warnings for the user
    doubts: tuple[str, ...] = ()  # reasons why the angles may be wrong


def join_bodies(seen: FilmObservations, scene: Scene, profile: Profile, fps: float) -> TrackedBodies:
    """Find the path of the centre, and combine the markers of each body about it; repeated frames have no angle."""
    if seen.times.again is None:
        return _join_fresh(seen, scene, profile, fps)
    fresh, count = np.flatnonzero(~seen.times.again), len(seen.times.again)
    joint = _join_fresh(_picked(seen, fresh), scene, profile, fps)
    row = np.searchsorted(fresh, np.arange(count), side="right") - 1
    centre = CentrePath(joint.centre.centre[row], joint.centre.sigma[row], joint.centre.reach)
    bodies = {name: body.spread_out(fresh, count) for name, body in joint.bodies.items()}
    return replace(joint, centre=centre, bodies=bodies)


def _picked(seen: FilmObservations, index: Integers) -> FilmObservations:
    """Return the observations of the frames `index`."""
    bodies = {name: body.picked(index) for name, body in seen.bodies.items()}
    disc = None if seen.disc is None else seen.disc[index]
    return replace(seen, bodies=bodies, disc=disc, times=seen.times.at(index))


def _join_fresh(seen: FilmObservations, scene: Scene, profile: Profile, fps: float) -> TrackedBodies:
    index = seen.times.number
    joint = _join_even(_with_gaps(seen, index), scene, profile, fps, _time_base(seen.times))
    if len(index) == 0 or index[-1] + 1 == len(index):
        return joint
    centre = CentrePath(joint.centre.centre[index], joint.centre.sigma[index], joint.centre.reach)
    return replace(joint, centre=centre, bodies={name: body.at(index) for name, body in joint.bodies.items()})


def _time_base(times: FrameTimes) -> TimeBase | None:
    """Return the times of all frames, including missing frames; None if frames are counted."""
    if times.place is None:
        return None
    return TimeBase(np.interp(np.arange(times.number[-1] + 1), times.number, times.place), times.sigma)


def trusted_times(seen: FilmObservations, scene: Scene) -> FrameTimes:
    """Return the times of a film.

    They are smoothed, except if the motion of the body that turns most shows that their jitter is real.
    """
    times = seen.times
    if times.place is None or times.smooth is None or not seen.bodies:
        return times
    angle = seen_angle(seen, scene, turning_most(seen))
    return times if jitter_is_real(times.place, times.smooth, angle) else times.even()


def _with_gaps(seen: FilmObservations, index: Integers) -> FilmObservations:
    """Place the frames on the equally spaced grid of the camera; missing frames are NaN or False."""
    count = int(index[-1]) + 1 if len(index) else 0
    if count == len(index):
        return seen
    bodies = {name: body.spread_out(index, count) for name, body in seen.bodies.items()}
    disc = None if seen.disc is None else spread_out(seen.disc, index, count)
    return replace(seen, bodies=bodies, disc=disc)


def _join_even(
    seen: FilmObservations, scene: Scene, profile: Profile, fps: float, time_base: TimeBase | None = None
) -> TrackedBodies:
    views = {name: view(scene.of(name), body.markers, seen.size) for name, body in seen.bodies.items()}
    path = _centre(seen, views, scene, profile)
    axis = path if seen.disc is None else about_rotor(path, views)
    centre, flattening = correct_view(axis, views, profile, marked=seen.disc is not None)
    bodies, warnings = _followed(seen, views, centre, flattening, fps, time_base)
    if seen.disc is not None and (text := fast_motion(path, seen.disc)) is not None:
        warnings.append(text)
    doubts = _unalias(bodies, profile.sense)
    sense = find_rotation_sense({name: net_turn(body.angle) for name, body in bodies.items()}, profile.sense)
    for name, body in bodies.items():
        angle, changed = unfold(body.angle, sense)
        if changed:
            bodies[name] = replace(body, angle=angle)
            warnings.append(
                f"The {name} turns by more than half a turn between frames; its sense of rotation is assumed."
            )
    if profile.sense is None:
        doubts += _undecided(bodies)
    for name, body in bodies.items():
        bodies[name] = _zeroed(body, profile, sense)
    slants = {name: flattening[name] for name in bodies}
    return TrackedBodies(centre, bodies, slants, sense, tuple(warnings), tuple(doubts))


def _unalias(bodies: dict[str, BodyAngles], given: int | None) -> list[str]:
    """Replace a rotation of the rotor that speeds up by its alias that slows down, because nothing drives the rotor.

    A rotation whose sense the casing or the profile determines is kept. Return a warning if both rotations are
    possible.
    """
    casing = net_turn(bodies["casing"].angle) if "casing" in bodies else 0.0
    if given is not None or "rotor" not in bodies or abs(casing) > SENSE_TURN:
        return []
    body = bodies["rotor"]
    frame = np.flatnonzero(np.isfinite(body.angle))
    seen = body.angle[frame]
    other = slowing(seen, frame)
    if other is None:
        return []
    angle = np.full(len(body.angle), np.nan)
    angle[frame] = other
    bodies["rotor"] = replace(body, angle=angle)
    return [f"The rotor: {doubtful(other, seen, frame, chosen='that slows down')}"]


def _undecided(bodies: dict[str, BodyAngles]) -> list[str]:
    """Return a warning for each body that speeds up, but would slow down with one turn per frame less."""
    found = []
    for name, body in bodies.items():
        frame = np.flatnonzero(np.isfinite(body.angle))
        other = slowing(body.angle[frame], frame)
        if other is not None:
            found.append(f"The {name}: {doubtful(body.angle[frame], other, frame)}")
    return found


def _followed(
    seen: FilmObservations,
    views: dict[str, BodyView],
    centre: CentrePath,
    flattening: dict[str, Flattening],
    fps: float,
    time_base: TimeBase | None,
) -> tuple[dict[str, BodyAngles], list[str]]:
    """Combine the markers of each body.

    The markers of the casing are combined twice, the second time with the known angle of the rotor, because markers of
    the rotor pass beneath the marker of the casing.

    If a body turns too little to measure its position-dependent errors, the errors of the other body [px] are combined
    with typical errors. Illumination and encoder are the same for both bodies, but the surroundings of the markers
    differ.
    """
    candidates = {name: body_view.candidates(centre, flattening[name]) for name, body_view in views.items()}

    bodies: dict[str, BodyAngles] = {}

    def joined(name: str, other: Floats | None, *, above: bool = False) -> BodyAngles:
        radius = views[name].radius
        usual = usual_error_by_place(views[name])
        learnt = [
            error_by_place(views[n], flattening[n], b)
            for n, b in bodies.items()
            if n != name and b.place_error > 0.0
        ]
        # two estimates of one variance with about equally many degrees of freedom
        by_place = float(np.sqrt(np.mean(np.square([usual, *learnt]))))
        coarse = seen.bodies[name].coarse
        left = variance_left(coarse, range(1, 2), max(centre.reach, 1))
        off_axis = np.nan_to_num(centre.sigma) * np.sqrt(left)
        flat = flattening[name]
        return join(
            coarse,
            candidates[name],
            fps,
            other,
            by_place / radius,
            off_axis / radius,
            np.hypot(
                offset_uncertainty(candidates[name], flat) / radius, _tilt_uncertainty(candidates[name], flat)
            ),
            arcs={marker: c / radius**2 for marker, c in flat.offset_covariance.items()},
            above=above,
            time_base=time_base,
        )

    warnings: list[str] = []
    for name in views:
        found = joined(name, bodies["casing"].angle if "casing" in bodies else None)
        if name == "rotor" and "casing" in bodies and _at_rest(found, bodies["casing"]):
            warnings.append(
                "The markers of the rotor do not move while the casing turns: they are part of the background, and "
                "the rotor is omitted."
            )
        elif _credible(found):
            bodies[name] = found
        else:
            warnings.append(f"The markers of the {name} cannot be tracked; it is omitted.")
    if len(bodies) == 2 and seen.disc is not None:
        flattening["casing"] = separate_perspective(centre, views, flattening, bodies["rotor"])
        candidates["casing"] = views["casing"].candidates(centre, flattening["casing"])
    if len(bodies) == 2:
        better = joined("casing", bodies["rotor"].angle, above=True)
        bodies["casing"] = better if _credible(better) else bodies["casing"]
    for name, body in bodies.items():
        flat = flattening[name]
        texture = _best_ring(seen.bodies[name], math.hypot(flat.p, flat.q))
        if texture is None:
            continue
        # Where a body is blurred, its coarse angle is used. It is accurate enough to find when its markers pass markers
        # of the other body in step with the frames.
        others = [
            np.where(np.isfinite(b.angle), b.angle, seen.bodies[n].coarse)
            for n, b in bodies.items()
            if n != name
        ]
        bodies[name] = by_texture(
            body,
            texture,
            centre,
            flat,
            seen.bodies[name].coarse,
            fps,
            usual_error_by_place(views[name]),
            views[name].radius,
            time_base,
            others,
        )
    bodies = {name: replace(body, harmonic=harmonic_error(body.angle)) for name, body in bodies.items()}
    return bodies, warnings


MANY_TURNS = 10.0
"""Errors of the markers that repeat in each turn average out over at least this number of turns [turns]. Chosen: a
smaller number lets errors of the markers that have not averaged out shift the zeros of the templates, a larger one
ignores the markers."""


def by_texture(
    body: BodyAngles,
    texture: TextureObservations,
    centre: CentrePath,
    flat: Flattening,
    coarse: Floats,
    fps: float,
    usual: float,
    radius: float,
    time_base: TimeBase | None = None,
    others: Sequence[Floats] = (),
) -> BodyAngles:
    """Return a body with the angles of its texture if their averages are better than averages from its markers.

    The zeros of the templates follow from the markers (`template_zeros`). A marker has an error when it passes a marker
    of another body. `others` are the angles of the other bodies, (n,) [rad] each. If the body makes only a few turns,
    all templates have one zero. Errors that repeat with the angle are estimated and the uncertainty is calibrated as
    for a marker (`join`). If a body is at rest in a compressed film, the inner and the outer zones of its ring have the
    same error. Differences between zones do not show this error. If such position-dependent errors cannot be estimated,
    they are assumed to be at least `error_of_ring`. This error is computed from `usual` [px] and the mean `radius` of
    the markers [px].
    """
    angle = texture.levelled(centre.centre, flat.p, flat.q)
    # The correction `change` need not be subtracted first: an error that repeats in each turn averages out in the zero
    # of a batch.
    off = wrapped(body.angle - angle)
    if np.isfinite(off).sum() < LEAST_OBSERVATIONS:
        return body
    with np.errstate(invalid="ignore"):
        fast = np.abs(np.gradient(coarse)) * fps > FAST
    change = change_with_speed(angle, fps, fast)
    angle = angle - change.angle
    good = np.isfinite(angle)
    middle = median_of(off[np.isfinite(off)])
    off = middle + wrapped(off - middle)
    template = texture.template
    if abs(net_turn(body.angle)) > MANY_TURNS * 2.0 * np.pi:
        relative = [body.angle, *(a - body.angle for a in others)]
        zeros = template_zeros(off, template, relative)
        of_templates, harmonics_sigma = change_of_harmonics(wrapped(off - zeros.zero), template, relative)
        angle = angle + of_templates
    else:
        harmonics_sigma = 0.0
        scatter = scatter_of_templates(off - middle, template)
        zeros = TemplateZeros(np.full(len(off), middle), np.full(len(off), scatter))
    columns = {
        "angle": wrapped(np.nan_to_num(angle + zeros.zero)),
        "good": good,
        "open": good,
        "weak": np.where(good, texture.sigma / median_of(texture.sigma[good]), 1.0),
        "misfit_excess": excess_misfit(np.sqrt(texture.misfit), 1.0),
    }
    first, second = (np.hypot(m[:, 0], m[:, 1]) for m in (texture.first, texture.second))
    # if the ring determines its own view, the error of this view is already contained in `texture.slow`
    own = texture.own_view > 0.0
    of_view = np.hypot(
        np.hypot(centre.sigma, np.where(own, 0.0, CENTRE_ERROR)) * first,
        np.where(own, 0.0, flat.error) * second,
    )
    found = join(
        coarse,
        {"texture": Candidate(mount=0.0, **columns)},
        fps,
        # If the ring determines its own view, the error differs between batches. The rms is then used, because a median
        # would ignore batches with large errors.
        floor=max(
            float(np.sqrt(np.mean(texture.slow[good] ** 2))) if own.any() else median_of(texture.slow[good]),
            error_of_ring(texture, usual) / radius,
        ),
        axis=np.nan_to_num(of_view) * math.sqrt(variance_left(coarse, VIEW_ORDERS)),
        # all zones of a ring are visible, as are markers above the other body
        other=others[0] if len(others) else None,
        above=True,
        time_base=time_base,
    )
    new = np.isfinite(found.angle)
    if not _averages_better(found, body, fps):
        return body
    angle, sigma = (np.where(new, getattr(found, n), getattr(body, n)) for n in ("angle", "sigma"))
    learnt = fast & good if found.axis_off else np.zeros_like(good)
    periodic = periodic_error(texture, centre.sigma, flat.error, learnt) if zeros.uncertainty.any() else 0.0
    periodic = math.hypot(periodic, change.error, harmonics_sigma)
    slow = float(np.sqrt(np.mean(zeros.uncertainty[new] ** 2))), float(BATCH)
    changes = np.ptp(zeros.uncertainty) > 0
    first = np.flatnonzero(np.diff(template, prepend=-1)) if changes else np.zeros(0, dtype=np.int64)
    middle = 0.5 * (first + np.append(first[1:], len(template))[: len(first)] - 1)
    parts = np.stack([middle, zeros.uncertainty[first]], axis=1)
    return replace(body, angle=angle, sigma=sigma, slow=slow, slow_parts=parts, periodic=periodic)


RING_ERROR = 0.055
"""Position-dependent error (rms) of a slow ring if its oblique view is determined from the ring itself [px]. Measured:
in eleven films made with two renderers other than that of this program, means over 16 frames had errors of 0.01 to 0.11
px at the radius of the markers, 0.054 px rms. A ring that does not determine its own view is given the typical error of
a marker. The encoder copies the picture of a slow body from frame to frame, so this error does not average out."""
LEAST_PERIODIC = 0.3e-3
"""A slow casing has an error with one and two periods per turn. This is the standard deviation of its amplitudes,
without the part due to errors of centre and flattening [rad]. Measured: in the slow frames of five rendered films, the
amplitudes exceeded these errors by 0.2 to 0.4 mrad; a smaller value reports shading as an unbalance, a larger one hides
an unbalance."""
LEVEL = 0.005
"""Largest flattening for which a ring determines its own view; it corresponds to a tilt of 0.14 rad [1]. Measured: in
rendered films of a near camera with a tilt of 0.15 rad (flattening 0.0056), the rms error of the angles is 0.75 to 1.2
standard uncertainties if the body turns by more than 0.6 turns, and 1.1 to 1.6 standard uncertainties if the body makes
half a turn. At a tilt of 0.08 rad, the rms error is 0.9 to 1.1 standard uncertainties."""
_ALMOST_ALL = 0.95
"""The view that is determined from the ring itself is used if at least this share of the frames of the ring is measured
with it [1]. Chosen: the other frames have the angles of the markers; a smaller value mixes different errors, a larger
one fails for a few disturbed frames."""


def periodic_error(texture: TextureObservations, centre: Floats, flattening: float, learnt: Bools) -> float:
    """Return the standard deviation of the amplitudes of an error with one and two periods per turn [rad].

    The error differs between frames, and the largest value over all frames is returned. A template responds to an error
    of the `centre` (n,) [px] and of the `flattening`. The mean effect in the frames `learnt` (n,) is removed. What
    remains is proportional to the difference between the response of a template and the mean response in these frames.
    Shading also changes with motion blur; it causes at least `LEAST_PERIODIC`.
    """
    squares = np.zeros(len(centre))
    for moments, error in ((texture.first, np.hypot(centre, CENTRE_ERROR)), (texture.second, flattening)):
        usual = moments[learnt].mean(axis=0) if learnt.any() else np.zeros(2)
        squares += (error * np.hypot(*(moments - usual).T)) ** 2
    # if the ring determines its own view, the error of this view is already contained in `texture.slow`
    squares = squares[np.isfinite(texture.angle) & ~(texture.own_view > 0.0)]
    return math.hypot(
        math.sqrt(float(np.nanmax(squares, initial=0.0))), LEAST_PERIODIC if learnt.any() else 0.0
    )


def error_of_ring(ring: TextureObservations, usual: float) -> float:
    """Return the position-dependent error of a ring [px]: `RING_ERROR` with its own view, otherwise `usual` [px]."""
    known = np.isfinite(ring.angle)
    own = known & (ring.own_view > 0.0)
    return RING_ERROR if own.sum() > _ALMOST_ALL * known.sum() else usual


def _best_ring(body: BodyObservations, flattening: float) -> TextureObservations | None:
    """Return the ring measured with its own view if the body is always slow, otherwise with the view of the markers.

    Errors that repeat in each turn are estimated in the fast frames and subtracted in all frames. The view must
    therefore be the same in fast and slow frames, so the ring's own view is used only if the body is always slow. If
    the `flattening` is large, the view from the markers is used. Perspective then disturbs the view from one ring more
    than the view from the markers of all bodies.
    """
    if body.texture is None or body.aligned is None:
        return body.texture
    known, own = (np.isfinite(ring.angle).sum() for ring in (body.texture, body.aligned))
    return body.aligned if own > _ALMOST_ALL * known and flattening < LEVEL else body.texture


_AVERAGED = 0.1
"""Time over which angles are averaged before they are compared [s]. Chosen: a torque takes longer to act; a longer time
leaves few averages, a shorter one compares noise."""
_FEWEST_AVERAGED = 8
"""Smallest number of frames of an average [frames]. Chosen: a smaller number compares noise, a larger one smooths the
motion of films at low frame rate."""
_FEWEST_MEANS = 12
"""Smallest number of averages for a comparison [1]. Derived: the variance of 12 means is known within about 40 %,
sqrt(2 / 11)."""
_MOST_NOISE = 2.0
"""The noisier of two angles is not used if its standard uncertainty, divided by the other standard uncertainty, is at
least this value [1]. Chosen: a smaller value keeps angles with slow errors, a larger one accepts much noise."""


def _averages_better(found: BodyAngles, body: BodyAngles, fps: float) -> bool:
    """Return whether the averages of new angles over `_AVERAGED` have a smaller error than averages from the markers.

    The two angles differ by white errors and by an error that does not average out. This error occurs when a marker
    passes a marker of another body. It varies slowly if the passages are in step with the frames. V is the variance of
    the differences between the two averages over m frames, and sigma_1 and sigma_2 are the standard deviations of the
    white errors. Then the excess V - (sigma_1^2 + sigma_2^2) / m is attributed to the marker, because a ring averages
    over its circumference.
    """
    both = np.flatnonzero(np.isfinite(found.angle) & np.isfinite(body.angle))
    if not len(both):
        return False
    new, old = (median_of(b.sigma[both]) ** 2 for b in (found, body))
    m = max(round(_AVERAGED * fps), _FEWEST_AVERAGED)
    count = len(both) // m
    off = wrapped(found.angle[both] - body.angle[both])
    off = wrapped(off - median_of(off))
    means = off[: count * m].reshape(count, m).mean(axis=1)
    excess = max(float(np.var(means)) - (new + old) / m, 0.0) if count >= _FEWEST_MEANS else 0.0
    return bool(new < min(old + m * excess, _MOST_NOISE**2 * old))


def _centre(seen: FilmObservations, views: dict[str, BodyView], scene: Scene, profile: Profile) -> CentrePath:
    if seen.disc is not None:
        return followed_path(marked_paths(seen.disc), views)
    observations = [s for body in seen.bodies.values() for s in body.markers.values()]
    best = max(observations, key=lambda s: int(plausible(s).sum()))
    good = plausible(best) & best.open
    place, first = best.position(good), np.array(scene.centre)
    still = wandering_centre(place, good, first, still=True)
    if profile.wander is False:
        return still
    moving = wandering_centre(place, good, first)
    reach = float(np.ptp(moving.centre, axis=0).max())
    radius = float(np.nanmedian(np.hypot(*(place[good] - still.centre[good]).T)))
    return moving if profile.wander or reach > _FAR * radius else still


def _zeroed(body: BodyAngles, profile: Profile, sense: int) -> BodyAngles:
    """Shift the zero of the angle so that the markers have the mount angles of the profile, if it contains any."""
    named = {
        m.name: m.mount_angle for m in profile.marker if m.mount_angle is not None and m.name in body.markers
    }
    if not named:
        return body
    turn = [np.exp(1j * (sense * angle - body.markers[name].mount)) for name, angle in named.items()]
    shift = float(np.angle(np.sum(turn)))
    markers = {name: MarkerAngles(m.angle, m.sigma, m.mount + shift) for name, m in body.markers.items()}
    return replace(body, angle=body.angle - shift, markers=markers)


_REST = 0.05
"""Largest range of the angle of a body at rest [rad]. Chosen: a smaller value calls noise a motion, a larger one hides
a slow body."""
_TURNS = 1.0
"""The other body counts as rotating if the range of its angle is at least this value [rad]. Chosen: a smaller value
omits a body although the other body hardly turns, a larger one keeps angles of the background."""


def _at_rest(body: BodyAngles, other: BodyAngles) -> bool:
    """Return whether a body is at rest while the other body turns."""
    known = body.angle[np.isfinite(body.angle)]
    turns = bool(np.nanmax(other.angle) - np.nanmin(other.angle) > _TURNS)
    return turns and len(known) > 0 and bool(np.ptp(known) < _REST)


_LEAST_SHARE = 0.05
"""Smallest share of frames with an angle of a body that is reported [1]. Chosen: a smaller value reports other objects,
a larger one omits bodies that are rarely visible."""
_LEAST_SEEN = 3
"""Smallest number of frames with an angle of a body that is reported [frames]. Chosen: a smaller number does not show a
motion, a larger one omits bodies in short films."""
_MOST_SIGMA = 0.2
"""Largest median uncertainty of a body that is reported [rad]. Chosen: a smaller value omits bodies in poor films, a
larger one reports angles without information."""


def _credible(body: BodyAngles) -> bool:
    """Return whether a body has angles in enough frames, with a median uncertainty below `_MOST_SIGMA`."""
    used = np.isfinite(body.angle)
    return bool(
        used.sum() >= max(_LEAST_SEEN, _LEAST_SHARE * len(used)) and np.median(body.sigma[used]) < _MOST_SIGMA
    )
