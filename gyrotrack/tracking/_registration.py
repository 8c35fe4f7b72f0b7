"""Angle of a body without markers: its polar picture is registered against a template averaged from this film.

A ring about the hub is unwrapped into a polar picture I_t(r, phi) for each frame t. The model is

    I_t(r, phi) = L(r, phi) + (1 + g_t) B(r, phi - theta_t) + o_t + displacement of the hub + noise,

where B is the rotating picture of the body, L the part that is fixed in the image (glare, background, superimposed
text), and g_t and o_t are changes of illumination. B, L, the angles and the noise variances of every pixel of the body
and of the image are estimated alternately. Pixels are weighted by the inverse of these variances, so parts that do not
turn with the body have little weight. The angle is fitted by Gauss-Newton steps; its uncertainty is the Cramer-Rao
bound for the template, scaled by the measured scatter of the angles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from gyrotrack._arrays import Bools, Floats, Integers, Picture, Singles

Area = tuple[int, int, int, int]

TURN = 2 * np.pi
"""A full turn [rad]. Derived: 2 pi."""
_PHASES = 8
"""Number of copies of the template, shifted by fractions of a column [1]. Chosen: a linear step is then at most 1/16 of
a column; a smaller number needs more iterations, a larger one takes memory."""
_ITERATIONS = 6
"""Largest number of Gauss-Newton steps of a frame [iterations]. Chosen: a smaller number stops early, a larger one
costs time."""
_ROUNDS = 2
"""Number of alternating estimates of the body and of the fixed picture [iterations]. Chosen: a smaller number leaves
parts of the body in the fixed picture or the reverse, a larger one costs time."""
_CLOSE = 1e-3
"""Gauss-Newton step that ends the registration of a frame [columns]. Chosen: a larger value stops early, a smaller one
costs time."""
ALL = slice(None)


@dataclass(frozen=True)
class Ring:
    """A ring about the hub, or an arc of it, and its polar sampling."""

    hub: tuple[float, float]  # centre (x, y) [px]; it may be outside the picture
    inner: float  # radii [px]
    outer: float
    rows: int  # samples in radius and in angle
    columns: int
    # first angle and length of the arc [rad]; the span is 2 pi for a whole ring. Angles increase from x to y
    start: float = 0.0
    span: float = TURN
    # (p, q) of the ellipse in the image, due to a tilted camera or pixels that are not square: a point (x, y) of the
    # body is at ((1 + p) x + q y, q x + (1 - p) y)
    stretch: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def about(
        cls,
        hub: tuple[float, float],
        inner: float,
        outer: float,
        *,
        finest: float = 200.0,
        start: float = 0.0,
        span: float = TURN,
        stretch: tuple[float, float] = (0.0, 0.0),
    ) -> Ring:
        """Sample a ring once per pixel, or in coarser steps so that a radius has at most `finest` samples."""
        step = max(1.0, outer / finest) if span >= TURN else max(1.0, (outer - inner) / finest)
        rows = max(4, round((outer - inner) / step))
        columns = cv2.getOptimalDFTSize(max(64, round(outer * span / step)))
        return cls(hub, inner, outer, rows, columns, start, span, stretch)

    def trimmed(self, share: Floats, *, finest: float) -> Ring:
        """Keep rows whose `share` is at least 0.3 of the largest share, with at most `finest` samples per radius."""
        good = np.flatnonzero(np.convolve(share, np.ones(3) / 3, mode="same") > 0.3 * share.max())
        if len(good) < 4:
            return self
        step = (self.outer - self.inner) / self.rows
        inner = max(self.inner + step * (good[0] - 1), 2.0)
        outer = self.inner + step * (good[-1] + 2)
        return Ring.about(
            self.hub, inner, outer, finest=finest, start=self.start, span=self.span, stretch=self.stretch
        )

    def scaled(self, factor: float) -> Ring:
        """Return the ring about a body that is larger in the picture by a factor, with the same number of samples."""
        return self if factor == 1.0 else replace(self, inner=factor * self.inner, outer=factor * self.outer)

    @property
    def tilt(self) -> tuple[float, float] | None:
        """Tilt of the axis from the stretch, and angle of the short axis, counter-clockwise [rad]; None for an arc."""
        size = math.hypot(*self.stretch)
        if self.span < TURN or size >= 1.0:
            return None
        short = 0.5 * math.atan2(self.stretch[1], self.stretch[0]) + 0.5 * math.pi
        return math.acos((1.0 - size) / (1.0 + size)), -short % math.pi

    @property
    def radius(self) -> Floats:
        """Radii of the rows [px], shape (rows,)."""
        step = (self.outer - self.inner) / self.rows
        return np.asarray(self.inner + step * (np.arange(self.rows) + 0.5), dtype=np.float64)

    @property
    def angle(self) -> Floats:
        """Angles of the columns [rad], shape (columns,)."""
        return np.asarray(self.start + self.step * np.arange(self.columns), dtype=np.float64)

    @property
    def step(self) -> float:
        """Angle from one column to the next [rad]."""
        return self.span / self.columns

    @property
    def area(self) -> Floats:
        """Area of a sample in each row [px2], to which its information is proportional, shape (rows, 1)."""
        return ((self.outer - self.inner) / self.rows * self.radius * self.step)[:, None]

    def grid(self, shift: Sequence[float] = (0.0, 0.0)) -> tuple[Picture, Picture]:
        """Return the positions (x, y) of the samples [px] for a hub displaced by `shift`."""
        cos, sin, (p, q) = np.cos(self.angle), np.sin(self.angle), self.stretch
        x = self.hub[0] + shift[0] + self.radius[:, None] * ((1 + p) * cos + q * sin)
        y = self.hub[1] + shift[1] + self.radius[:, None] * (q * cos + (1 - p) * sin)
        return x.astype(np.float32), y.astype(np.float32)

    @cached_property
    def _places(self) -> tuple[Picture, Picture]:
        return self.grid()

    def inside(self, area: Area) -> Bools:
        """Return a mask of the samples that are within the area (left, top, right, bottom) of the picture [px]."""
        x, y = self._places
        left, top, right, bottom = area
        return np.asarray((x >= left + 1) & (y >= top + 1) & (x <= right - 2) & (y <= bottom - 2))

    def unwrap(self, picture: npt.NDArray[np.uint8], shift: Sequence[float] = (0.0, 0.0)) -> Picture:
        """Return the polar picture, (rows, columns)."""
        x, y = self.grid(shift) if any(shift) else self._places
        height, width = picture.shape
        step = (self.outer - self.inner) / self.rows
        if step > 1.5:  # average over the area of a sample
            picture = cv2.blur(picture, (2 * round((step - 1) / 2) + 1,) * 2).astype(np.uint8)
        # the part of the picture that is needed, with the margin of the interpolation
        left, top = (int(np.clip(v.min() - 4, 0, n - 1)) for v, n in ((x, width), (y, height)))
        right, bottom = (int(np.clip(v.max() + 5, 1, n)) for v, n in ((x, width), (y, height)))
        part = picture[top : max(bottom, top + 1), left : max(right, left + 1)].astype(np.float32)
        found = cv2.remap(part, x - left, y - top, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(found, dtype=np.float32)


def rolled(picture: Picture, columns: float) -> Picture:
    """Rotate a polar picture by a number of columns by Fourier interpolation."""
    return _rotated(np.fft.rfft(picture, axis=1), picture.shape[1], columns)


def _rotated(spectrum: npt.NDArray[Any], size: int, columns: float) -> Picture:
    """Return the polar picture of a spectrum, rotated by a number of columns."""
    return np.asarray(np.fft.irfft(spectrum * _phase(size, columns), size, axis=1), dtype=np.float32)


def _phase(size: int, columns: float) -> npt.NDArray[np.complex64]:
    """Return the factors of a spectrum that rotate `size` columns by a number of columns."""
    return np.asarray(np.exp(-2j * np.pi * np.fft.rfftfreq(size) * columns), dtype=np.complex64)


def _slope(picture: Picture) -> Picture:
    """Return the derivative with respect to the number of the column."""
    size = picture.shape[1]
    factor = 2j * np.pi * np.fft.rfftfreq(size)
    if size % 2 == 0:
        factor[-1] = 0.0
    found = np.fft.irfft(np.fft.rfft(picture, axis=1) * factor, size, axis=1)
    return np.asarray(found, dtype=np.float32)


@dataclass(frozen=True)
class Template:
    """The estimated picture of a body, and the fixed part of the image."""

    ring: Ring  # ring in which the template was estimated
    body: Picture  # B and L, in grey levels, (rows, columns)
    fixed: Picture
    body_variance: Picture  # variances of a sample of the body and of the image, (rows, columns)
    fixed_variance: Picture
    noise: float  # variance of the noise that is common to both
    allowed: Bools  # samples within the picture, (rows, columns)
    rows: slice = field(default_factory=lambda: ALL)  # rows of the ring that are used
    # standard deviation of the hub's displacement from frame to frame [px]; 0 for a fixed hub
    hub_sigma: float = 0.0
    _phases: list[tuple[Picture, Picture]] = field(default_factory=list, repr=False)
    _shifts: list[Picture] = field(default_factory=list, repr=False)

    def phases(self) -> list[tuple[Picture, Picture]]:
        """Return the body's picture and its slope, shifted by -1/2 ... +3/8 of a column."""
        if not self._phases:
            for k in range(_PHASES):
                body = rolled(self.body, (k - _PHASES // 2) / _PHASES)
                self._phases.append((body, _slope(body)))
        return self._phases

    def shifts(self) -> list[Picture]:
        """Return the change of the body's picture per px of the hub's displacement, in the body's frame."""
        if not self._shifts:
            ring = self.ring
            radial = np.gradient(self.body, (ring.outer - ring.inner) / ring.rows, axis=0)
            across = _slope(self.body) / (ring.radius[:, None] * ring.step)
            cos, sin = np.cos(ring.angle), np.sin(ring.angle)
            self._shifts.append(np.asarray(-(radial * cos - across * sin), dtype=np.float32))
            self._shifts.append(np.asarray(-(radial * sin + across * cos), dtype=np.float32))
        return self._shifts

    def whole(self) -> Template:
        """Return the same template for the whole ring."""
        return replace(self, rows=ALL)

    def information(self) -> Floats:
        """Return the information of each row about the angle, in arbitrary units, shape (rows,)."""
        each = self.ring.area * _slope(self.body) ** 2 / self.body_variance
        known: Floats = each.sum(axis=1, dtype=np.float64)
        used: Floats = np.zeros(len(known))
        used[self.rows] = known[self.rows]
        return used

    def halves(self) -> tuple[Template, Template]:
        """Return this template for the inner and for the outer half of the ring; both halves have equal information."""
        known = np.cumsum(self.information())
        row = int(np.clip(np.searchsorted(known, 0.5 * known[-1]), 1, len(known) - 1))
        return replace(self, rows=slice(0, row)), replace(self, rows=slice(row, None))


@dataclass(frozen=True)
class Pose:
    """The registration of one frame."""

    angle: float  # theta [rad], in the picture from x to y
    formal: float  # uncertainty of the angle [rad] for independent noise with the estimated variances
    shift: tuple[float, float]  # displacement of the hub (x, y) [px]
    shift_sigma: float  # formal uncertainty of the displacement [px]; infinite if it was not fitted
    gain: float  # relative change of contrast
    misfit: float  # weighted mean square residual; 1 for a typical frame


def register(polar: Picture, template: Template, start: float, *, move: bool = False) -> Pose:
    """Find the angle of a body in a polar picture by Gauss-Newton steps from an initial value [rad].

    The initial value must be accurate to the width of the details. With `move` the hub's displacement is fitted.
    """
    ring = template.ring
    rows = template.rows
    held = (polar - template.fixed)[rows]
    turned = start / ring.step
    area = ring.area[rows].astype(np.float32)
    shift, gain = np.zeros(2), 0.0
    usable = template.allowed[rows].astype(np.float32)
    body_variance, fixed_variance = template.body_variance[rows], template.fixed_variance[rows]
    for _ in range(_ITERATIONS):
        whole = int(np.rint(turned))
        k = int(np.clip(np.rint((turned - whole) * _PHASES), -_PHASES // 2, _PHASES // 2 - 1))
        body, slope = (picture[rows] for picture in template.phases()[k + _PHASES // 2])
        here = whole + k / _PHASES
        seen = np.roll(held, -whole, axis=1)
        variance = body_variance + np.roll(fixed_variance, -whole, axis=1) - template.noise
        weight = area * np.roll(usable, -whole, axis=1) / np.maximum(variance, template.noise)
        if not float(weight.sum()) > 0:  # the whole ring is outside the picture
            return Pose(start, float("inf"), (0.0, 0.0), float("inf"), 0.0, float("inf"))
        level = float(np.sum(weight * body) / np.sum(weight))
        columns = [-slope, np.ones_like(body), body - level]
        if move or template.hub_sigma:
            columns += [moved_by[rows] for moved_by in template.shifts()]
        residual = seen - body
        clipped = 1.0 / np.maximum(1.0, residual**2 / np.maximum(9.0 * variance, 1e-6)) ** 0.5
        robust = weight * clipped
        basis = [c.ravel() for c in columns]
        weighted = [c * robust.ravel() for c in basis]
        normal = np.array([[np.dot(v, c) for c in basis] for v in weighted], dtype=np.float64)
        right = np.array([np.dot(v, residual.ravel()) for v in weighted], dtype=np.float64)
        if len(columns) > 3 and template.hub_sigma:
            normal[3:, 3:] += np.eye(2) / template.hub_sigma**2
        normal += np.eye(len(normal)) * (1e-9 * np.trace(normal) / len(normal) + 1e-12)
        solved = np.linalg.solve(normal, right)
        moved = float(np.clip(solved[0], -1.5, 1.5))
        step = here + moved - turned
        turned = here + moved
        gain = float(solved[2])
        if len(columns) > 3:
            cos, sin = np.cos(turned * ring.step), np.sin(turned * ring.step)
            shift = np.array([cos * solved[3] - sin * solved[4], sin * solved[3] + cos * solved[4]])
        if abs(step) < _CLOSE:
            break
    for known, column in zip(solved, columns, strict=True):
        residual -= np.float32(known) * column
    misfit = float(np.sum(robust * residual**2, dtype=np.float64) / np.sum(area))
    covariance = np.linalg.inv(normal)
    formal = float(np.sqrt(covariance[0, 0])) * ring.step
    about = float(np.sqrt(max(covariance[3, 3], covariance[4, 4]))) if len(covariance) > 3 else float("inf")
    return Pose(turned * ring.step, formal, (float(shift[0]), float(shift[1])), about, gain, misfit)


def learn(
    polars: Sequence[Picture],
    angles: Floats,
    allowed: Bools,
    ring: Ring,
    *,
    separate: bool,
    counted: Floats | None = None,
    plain: bool = False,
) -> Template:
    """Estimate the picture of the body, the fixed part of the image, and the variances of both.

    The `polars` are read several times; `allowed` are samples within the picture. `separate`: the motion is large
    enough (a turn and more) to distinguish the fixed picture from the picture of the body. `counted` are weights of the
    frames. `plain`: all samples have one variance; individual variances are too large at details while angles or hub
    are wrong.
    """
    counted = np.ones(len(polars)) if counted is None else counted
    turns = np.asarray(angles, dtype=np.float64) / ring.step
    usable = allowed.astype(np.float32)
    complete = bool(allowed.all())
    mean = np.zeros(usable.shape, dtype=np.float32)
    # sums over the frames of the spectra and of the phase factors, turned back by the angles
    turned_back = np.zeros((usable.shape[0], ring.columns // 2 + 1), dtype=np.complex64)
    phases = np.zeros(ring.columns // 2 + 1, dtype=np.complex64)
    for polar, turn, count in zip(polars, turns, counted, strict=True):  # one by one, to limit memory
        mean += np.float32(count / counted.sum()) * polar
        phase = np.complex64(count) * _phase(ring.columns, -turn)
        phases += phase
        if complete:
            turned_back += np.fft.rfft(polar, axis=1) * phase
    fixed = mean - mean.mean(axis=1, keepdims=True) if separate else np.zeros_like(mean)
    body = np.zeros_like(mean)
    for _ in range(_ROUNDS if separate else 1):  # alternating updates of body and fixed picture
        if complete:
            sum_of = turned_back - np.fft.rfft(fixed, axis=1) * phases
            body = np.fft.irfft(sum_of / np.float32(counted.sum()), ring.columns, axis=1).astype(np.float32)
        else:
            body = _mean_body(polars, turns, counted, fixed, usable)
        spectrum = np.fft.rfft(body, axis=1)
        if separate:
            # the sum over the frames of the contribution of the body: spectrum times the sum of the phase factors
            added = np.fft.irfft(spectrum * np.conj(phases), ring.columns, axis=1)
            fixed = np.asarray(mean - added / np.float32(counted.sum()), dtype=np.float32)
            fixed -= fixed.mean(axis=1, keepdims=True)
    by_body: Any = np.zeros_like(fixed)
    by_image: Any = np.zeros_like(fixed)
    number = np.full_like(fixed, 1e-6 + (counted.sum() if complete else 0.0))
    for polar, turn, count in zip(polars, turns, counted, strict=True):
        square = (polar - fixed - _rotated(spectrum, ring.columns, turn)) ** 2
        whole, _ = _split(turn)
        by_image += np.float32(count) * square
        by_body += np.float32(count) * np.roll(square if complete else square * usable, -whole, axis=1)
        if not complete:
            number += np.float32(count) * np.roll(usable, -whole, axis=1)
    by_body = cv2.blur(np.where(number < 0.5, by_body.sum() / number.sum(), by_body / number), (3, 3))
    by_image = cv2.blur(by_image / np.float32(counted.sum()), (3, 3))
    noise = max(float(np.quantile(by_body[number > 0.5 * number.max()], 0.2)), 0.05)
    if plain:
        by_body[:] = by_image[:] = float(np.mean(by_body))
    return Template(
        ring,
        body,
        fixed,
        np.maximum(by_body, noise).astype(np.float32),
        np.maximum(by_image, noise).astype(np.float32),
        noise,
        allowed,
    )


def _mean_body(
    polars: Sequence[Picture], turns: Floats, counted: Floats, fixed: Picture, usable: Picture
) -> Picture:
    """Return the mean picture of a body; a ring partly outside the picture shows a part of the body per frame."""
    total, number = np.zeros_like(fixed), np.full_like(fixed, 1e-6)
    for polar, turn, count in zip(polars, turns, counted, strict=True):
        whole, part = _split(turn)
        seen = np.float32(count) * np.roll(usable, -whole, axis=1)
        total += seen * np.roll(rolled(polar - fixed, -part), -whole, axis=1)
        number += seen
    body = np.asarray(total / number, dtype=np.float32)
    unseen = number < 0.5
    level = np.sum(np.where(unseen, 0, body), axis=1) / np.maximum((~unseen).sum(axis=1), 1)
    return np.where(unseen, level[:, None], body).astype(np.float32)


def _split(turned: float) -> tuple[int, float]:
    whole = int(np.rint(turned))
    return whole, turned - whole


def _band(size: int, band: str) -> Singles:
    """Return the weights of the orders of a polar picture with `size` columns, up to the last order that is used.

    `band` selects details by their order k (cycles per turn): "low", "middle" or "high". High orders make the maximum
    of a correlation narrow. Low orders avoid secondary maxima for periodic details, for example spokes. Middle orders
    are insensitive to a small displacement of the hub.
    """
    k = np.fft.rfftfreq(size)
    order = k * size
    if band == "low":
        factor = np.exp(-((order / 10.0) ** 2))
    elif band == "middle":
        factor = order**4 * np.exp(-((order / 8.0) ** 2))
    else:
        factor = k * np.exp(-((k / 0.2) ** 2))
    factor[0] = 0.0
    last = int(np.flatnonzero(factor > np.finfo(np.float32).eps * factor.max())[-1])
    return np.asarray(factor[: last + 1], dtype=np.float32)


def _energy(spectrum: npt.NDArray[np.complex64], factor: Singles) -> float:
    return float((spectrum.real**2 + spectrum.imag**2).sum(axis=0) @ factor)


_STEADY = 2
"""Number of steps after which changes of the step are tested [steps]. Chosen: with fewer, a noisy step is tested; with
more, the next spoke may be followed at the start."""
_JUMP = 1.5
"""Relative change of the step beyond which a higher correlation is required [1]. Chosen: equal parts of a body, for
example spokes, are indistinguishable by correlation; a smaller value refuses reversals; with a larger one, the next
spoke may be followed."""
_LEAST_JUMP = 6.0
"""Change of the step beyond which a higher correlation is required [columns]. Chosen: a smaller value refuses changes
of slow bodies; with a larger one, the next spoke may be followed."""
_UNLIKELY = 0.3
"""Required increase of the correlation for a change of the step, relative to the maximum [1]. Chosen: with a smaller
value the next spoke may be followed, a larger one refuses true jumps."""


def follow(polars: Sequence[Picture], weight: Picture, fixed: Picture, ring: Ring, *, band: str) -> Floats:
    """Return angles (n,) [rad] from weighted correlations of each frame with the mean of earlier frames.

    `fixed` is subtracted from all frames.
    """
    size = ring.columns
    centred = (np.arange(size) + size // 2) % size - size // 2
    root = np.sqrt(weight)
    factor = _band(size, band)
    orders = np.arange(len(factor))
    mean = np.zeros((0, 0), dtype=np.complex64)
    angle = np.zeros(len(polars))
    speed, known, taken = 0.0, 0, 0
    usual = 1.0
    whole = np.zeros(size // 2 + 1, dtype=np.complex128)
    for t, polar in enumerate(polars):
        shown = polar - fixed
        shown = (shown - shown.mean(axis=1, keepdims=True)) * root
        spectrum = np.fft.rfft(shown, axis=1)[:, : len(factor)].astype(np.complex64, copy=False)
        if t == 0:
            mean, taken = spectrum, 1
            continue
        expected = angle[t - 1] + speed
        whole[: len(factor)] = (np.conj(mean) * spectrum).sum(axis=0) * factor
        scale = math.sqrt(_energy(mean, factor) * _energy(spectrum, factor))
        found = np.fft.irfft(whole, size) / max(2 * scale / size, 1e-12)
        away = (centred - expected + size / 2) % size - size / 2
        trust = min(known, 8) / 8
        judged = found - (0.05 + 0.45 * trust) * found.max() * (away / (size / 2)) ** 2 * (
            4 if trust > 0.9 else 1
        )
        if known >= _STEADY:
            far = np.abs(away) > max(_JUMP * abs(speed), _LEAST_JUMP)
            judged = judged - _UNLIKELY * found.max() * far
        best = int(np.argmax(judged))
        before, at, after = found[(best - 1) % size], found[best], found[(best + 1) % size]
        bend = before - 2 * at + after
        place = away[best] + (0.5 * (before - after) / bend if bend < 0 else 0.0)
        if at < 0.4 * usual and known > 4:  # occluded, or another scene: extrapolate
            angle[t] = expected
            continue
        usual += (at - usual) / min(known + 2, 20)
        angle[t] = expected + place
        now = angle[t] - angle[t - 1]
        speed = now if known == 0 else speed + 0.5 * (now - speed)
        known += 1
        taken = min(taken + 1, 40)
        turned_back = np.exp(2j * np.pi / size * np.rint(angle[t]) * orders).astype(np.complex64)
        mean = mean + (spectrum * turned_back - mean) / np.float32(taken)
    return angle * ring.step


_RETURNS = 2.0
"""An angle is tested for a slip if its deviation from the line through its neighbours, relative to the typical step, is
at least this value [1]. Chosen: a smaller value tests frames of impacts, a larger one keeps slips if there are many
equal parts."""
_AS_WELL = 1.2
"""The expected angle is used if its misfit, divided by the misfit at the measured angle, is at most this value [1].
Chosen: equal parts fit equally well within noise; a smaller value keeps slips, a larger one removes true jumps."""


def without_slips(polars: Sequence[Picture], angle: Floats, at: Integers, template: Template) -> Floats:
    """Correct angles (n,) [rad] that slip in single frames by the angle between equal parts, for example spokes.

    In such a frame the angle deviates from the motion, and in the next frame it returns. The angle is replaced by the
    angle predicted from the neighbours if the picture fits equally well there. `at` (n,) are the numbers of the frames.
    """
    angle = angle.copy()
    if len(angle) < 4:
        return angle
    typical = float(np.median(np.abs(np.diff(angle))))
    limit = max(_RETURNS * typical, _LEAST_JUMP * template.ring.step)
    off = np.abs([_off_line(angle, at, k) for k in range(len(angle))])
    # the largest deviation is first, because it belongs to the slip itself; the ends, which have one neighbour, are
    # last
    inner = 1 + np.argsort(-off[1:-1])
    for k in (k for k in [*inner.tolist(), 0, len(angle) - 1] if off[k] > limit):
        expected = angle[k] - _off_line(angle, at, k)
        if abs(expected - angle[k]) < limit:  # the neighbour was wrong
            continue
        there, here = (register(polars[k], template, a) for a in (expected, angle[k]))
        if there.misfit <= _AS_WELL * here.misfit and abs(there.angle - expected) < 0.5 * limit:
            angle[k] = there.angle
    return angle


def _off_line(angle: Floats, at: Integers, k: int) -> float:
    """Return the deviation of an angle from the line through its neighbours (at the ends, the next two angles)."""
    last = len(angle) - 1
    a, b = (k - 1, k + 1) if 0 < k < last else (1, 2) if k == 0 else (last - 2, last - 1)
    return float(angle[k] - angle[a] - (angle[b] - angle[a]) * (at[k] - at[a]) / (at[b] - at[a]))


_COMPARED = 100
"""Largest number of frames from which a template for a comparison is estimated, and which are compared with it
[frames]. Chosen: a larger number costs time; with a smaller one, noise decides."""


def every(count: int) -> int:
    """Return the spacing that selects at most `_COMPARED` of `count` frames."""
    return max(1, -(-count // _COMPARED))


def explained(polars: Sequence[Picture], angles: Floats, template: Template) -> tuple[float, Floats]:
    """Return the share of the change of brightness, beyond noise, that the rotation explains, in total and per row.

    Frames are compared at the shortest lag at which the change is at least half of its maximum, so that slow changes of
    the scene are not taken for motion. The shares are at most 1, and 0 if the change does not exceed the noise.
    """
    usable = (template.allowed * template.ring.area).astype(np.float32)
    lags = [lag for lag in (1, 2, 4, 8, 16, 32) if lag < len(polars) // 2]
    some = range(0, len(polars) - lags[-1], max(1, len(polars) // 40))
    change = [
        float(np.mean([np.sum(usable * (polars[i + lag] - polars[i]) ** 2) for i in some])) for lag in lags
    ]
    lag = next(lag for lag, size in zip(lags, change, strict=True) if size >= 0.5 * max(change))
    rest = np.zeros(len(usable))
    pairs = range(0, len(polars) - lag, every(len(polars)))
    spectrum, size, step = np.fft.rfft(template.body, axis=1), template.ring.columns, template.ring.step
    squares = np.zeros(usable.shape, dtype=np.float32)
    for i in pairs:
        seen = polars[i + lag] - polars[i]
        turning = spectrum * (_phase(size, angles[i + lag] / step) - _phase(size, angles[i] / step))
        squares += seen**2
        rest += (usable * (seen - np.fft.irfft(turning, size, axis=1)) ** 2).sum(axis=1)
    total = (usable * squares).sum(axis=1, dtype=np.float64)
    # the estimated noise contains slow changes of the illumination, which are absent at a short lag
    still = squares[usable > 0] / np.float32(len(pairs))
    least = min(template.noise, 0.5 * float(np.quantile(still, 0.2))) if still.size else template.noise
    noise = 2 * least * len(pairs) * usable.sum(axis=1)
    rows = np.where(total > 1.1 * noise, 1.0 - (rest - noise).clip(0) / np.maximum(total - noise, 1e-9), 0.0)
    whole = float(total.sum() - noise.sum())
    if whole <= 0.1 * noise.sum():
        return 0.0, rows
    return 1.0 - max(float(rest.sum() - noise.sum()), 0.0) / whole, rows
