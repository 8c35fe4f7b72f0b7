"""Angle of a body from the texture of a whole ring about its hub, zone by zone.

A marker covers a few hundred pixels; the bar, the rim and the screws of a body cover about ten thousand. These pixels
are sampled in polar coordinates that turn with the body, in `ZONES` zones of radius. In these coordinates the picture
of the body is constant. In each batch of frames a zone has a template T(r, theta), the mean of the frames, and a
variance v(r, theta) of each sample. The variance is large where the body is not visible: another body below, the table,
a reflection. The rotation d of a frame follows from least squares, with weight 1 / v, for

    I(r, theta) = b + (1 + g) T(r, theta - d) + noise,

with gain g and offset b of the illumination. Templates and rotations are estimated in alternation.

Errors that are common to all samples of a zone do not appear in v: markers of the rotor that pass below the bar, the
shadow of the bar, the blocks of the encoder. These errors appear in the differences between zones. The zones are
combined by the best linear unbiased mean, with non-negative weights w = C^-1 1 / (1' C^-1 1); C is the covariance of
the angles of the zones about a smooth motion. The motion is common to all zones. It adds a multiple of 1 1' to C and
does not change w.

The zero of a template is arbitrary. The zero of each batch is related to the zero of the previous batch by registering
the templates of both batches.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from numpy.polynomial.legendre import legvander

from gyrotrack._arrays import Bools, Complexes, Floats, Integers, Singles
from gyrotrack._column_store import WithBuffer
from gyrotrack._native import _kernels as kernels
from gyrotrack._smoothing import median_of, spread
from gyrotrack.tracking._marker_tracker import FrameColumns
from gyrotrack.tracking._ring_view import (
    LEAST_ARC,
    TURN,
    VIEW_SIZE,
    WHOLE_TURN,
    View,
    ViewResponse,
    columns_of,
    slope,
    static_light,
    without_light,
)
from gyrotrack.video._container import Frame

ZONES = 8
"""Number of zones in radius [1]. Chosen: with more zones, errors are separated more finely, but each zone determines
the angle less well."""
ROWS = 4
"""Number of rows of a zone [rows]. Chosen: a bar or a rim extends over many pixels in radius; a smaller number loses
texture, a larger one costs time."""
COLUMNS = 360
"""Number of columns of the ring [columns per turn]. Chosen: motion blur and the lens smooth details below a degree; a
smaller number loses detail, a larger one costs time."""
MARGIN = 6
"""Number of additional columns beyond a turn on both sides, for rotations before the registration [columns]. Chosen: a
smaller number loses frames with a poor prediction, a larger one costs time."""
STEP = TURN / COLUMNS
"""Angle of a column [rad]. Derived: `COLUMNS` of a turn."""
REACH = (MARGIN - 1) * STEP
"""Largest rotation before the registration [rad]. Derived: `MARGIN` less one column for the interpolation."""
INNERMOST = 0.15
"""Radius of the first zone relative to the outer end of the markers [1]. Chosen: nearer to the hub, pixels hardly move;
a larger value loses texture."""
OUTERMOST = 1.35
"""Radius of the last zone relative to the outer end of the markers [1]. Chosen: the rim of the body is beyond the
markers; a larger value includes the background."""
FEWEST = 48
"""Smallest number of frames for the first templates [frames]. Chosen: a smaller number gives noisy templates, a larger
one leaves short films without texture."""
LEARNT = 256
"""Smallest number of frames for later templates [frames]. Chosen: a smaller number gives noisy templates, a larger one
keeps an old template."""
LEAST_REACH = 0.7
"""A body is used if the picture contains its ring up to at least this radius, relative to the outer end of the markers
[1]. Chosen: a smaller value uses a small part of the body, a larger one omits bodies near the border."""
LEAST_VARIANCE = 0.25
"""Lower limit of the variance of a sample [grey levels squared]. Chosen: rounding contributes 1 / 12, noise the rest;
a smaller value gives saturated samples too much weight, a larger one ignores the noise."""
LEAST_RESIDUAL = 0.01
"""Lower limit of the typical residual of a zone [grey levels]. Chosen: below the rounding of grey levels, 0.29, and
above the rounding errors of sums in single precision, which are all that remains in a picture without noise."""
FINENESS = 32
"""Number of steps per column to which rotations are rounded [1]. Source: OpenCV interpolates to 1/32 of a pixel."""
UNUSUAL = 4.0
"""A frame enters the template of a zone if its mean square residual in the zone, relative to the typical residual, is
at most this value [1]. Chosen: a smaller value discards good frames, a larger one admits a hand."""
LARGEST_MISFIT = 25.0
"""Largest mean square residual of a zone with an angle, relative to the typical residual [1]. Chosen: a second body
below a zone that rests for some frames changes the zone less than a hand does; a smaller value omits such frames."""
LARGEST_TURN = 0.02
"""Largest error of the approximate angles [rad]. Derived: two pixels at a radius of a hundred; beyond this error the
picture is not linear in the angle."""
LEAST_CONTRAST = 0.5
"""Smallest contrast of a zone that is not covered, relative to its template [1]. Chosen: a smaller value fits a hand
of one brightness, a larger one omits zones in shadow."""
LEAST_KNOWN = 0.9
"""A zone is used if the number of frames with an angle of this zone, divided by the number for the best zone, is at
least this value [1]. Chosen: a zone has no angle in frames in which it does not match its template, so its other angles
seem too good; a smaller value admits such zones, a larger one omits zones that a cable covers."""
LEAST_ZONES = 2
"""Smallest number of informative zones for which the errors of their angles are estimated [1]. Derived: the differences
of three angles determine three variances; the difference of two angles gives an upper limit of both variances."""
TOGETHER = 16
"""Number of frames that are averaged to find slow errors of a zone [frames]. Chosen: slow errors act as a torque and do
not average out; with fewer frames, these errors remain hidden in noise; with more, there are few averages."""
MANY_TURNS = 3.0
"""Smallest number of turns in which errors that repeat with the turn are distinguishable from a motion [turns]. Chosen:
a smaller number removes motion, a larger one leaves such errors in the weights."""
CENTRE_ERROR = 0.3
"""Standard uncertainty of the centre of a ring in the luma [px]. Derived: the centre is measured in the chroma, whose
conventions differ by up to half a pixel in each direction; a uniform distribution has 0.29 px."""
SHADOW_ERROR = 0.6
"""Standard uncertainty per coordinate of the displacement of a ring, without the uncertainty of its measured view [px].
Measured: a shadow that a bar casts beside itself displaces its edges; on ten films by two other renderers, the largest
error is 1.04, 0.82 and 0.98 mrad with 0.3, 0.6 and 1.2 px, and the median hardly changes."""
_TEMPLATE_FRAMES = 256
"""Largest number of frames of a batch from which the templates of a fast body are learnt [frames]. Derived: the noise
of a template is the noise of a frame divided by 16; a larger number costs time."""
_BLOCK = 16
"""Number of frames that are turned and measured together [frames]. Derived: their samples, 0.7 MB, remain in the cache
of a processor; the result does not depend on it."""
_LIGHT_FRAMES = 128
"""Number of frames of a batch for the estimate of static light [frames]. Chosen: a smaller number leaves noise in the
light, a larger one costs time."""
FAST_TURNS = 10.0
"""Smallest number of turns of a batch for the subtraction of static light [turns]. Chosen: over more turns, errors
once and twice per turn are determined from the angles; over fewer turns, a motion that is not uniform leaves light in
the templates."""
LOWEST_LIGHT_ORDER = 3
"""Lowest order of the static light that is subtracted [periods per turn]. Derived: orders 1 and 2 are caused by a
displaced centre and an oblique view, which are measured with the markers."""
_SLOPE_EVERY = 8
"""Distance between the frames in which the derivative with respect to the radius is measured [frames]. Chosen: a
smaller distance costs time, a larger one leaves noise in the derivative."""
_FEWEST_SLOPES = 4
"""Smallest number of frames from which the derivative with respect to the radius is measured [frames]. Chosen: with
fewer frames, the difference between the rows of the mean picture is less noisy."""
_ALIGNMENTS = 3
"""Number of passes of templates and angles of a slow body [iterations]. Measured: on a path-traced film, passes 1 to 4
leave errors of 1.5, 1.2, 1.1 and 1.1 mrad."""
_ROUNDS = 2
"""Number of passes of the template [iterations]. Chosen: the second pass uses the angles of the first pass; a larger
number costs time."""
_LEAST_SHARE = 0.1
"""Smallest variance of a zone relative to the variance of its differences [1]. Chosen: a smaller value gives one zone
all the weight, a larger one makes the zones equal."""
DEGREES = (3, 6, 12)
"""Degrees of the polynomial that describes the motion in a batch [1]. Chosen: the smallest sufficient degree is used,
over many turns the largest one; a remaining motion would seem correlated with the errors of some zones."""
FAR = 5.0
"""Residual to which outliers are limited, in robust standard deviations [1]. Chosen: a smaller value discards good
frames, a larger one keeps disturbed frames."""
FINEST = 1e-7
"""Lower limit of the scatter of a zone [rad]. Derived: the rounding error of sums in single precision, which is all
that remains of a body at rest in a picture without noise."""
SHRINKAGE = 0.1
"""Relative increase of variances estimated from a few hundred frames [1]. Chosen: a smaller value gives random weights,
a larger one makes the zones equal."""


@dataclass(frozen=True)
class TextureObservations(FrameColumns):
    """The angle of a body from its texture in consecutive frames; NaN where the angle is not known."""

    angle: Floats  # shape (n,); as seen, about the zero of the first template, unwrapped [rad]
    sigma: Floats  # shape (n,); standard uncertainty of the angle from the differences between zones [rad]
    slow: Floats  # shape (n,); part of `sigma` that is common to neighbouring frames [rad]
    misfit: Floats  # shape (n,); mean square residual relative to the typical value
    centre: Floats  # shape (n, 2); centre of the polar coordinates [px]
    # shape (n, 2); mean of exp(-i theta) / r [1/px] and of exp(-2 i theta) over the samples, weighted by their
    # information about the angle, as (real, imaginary): response to a displaced centre, and to an oblique view
    first: Floats
    second: Floats
    # shape (n,); number of the batch, from 1, where centre and flattening are determined from the ring itself, else 0
    own_view: Floats

    @classmethod
    def unknown(cls, centre: Floats) -> TextureObservations:
        """Return observations about the centres (n, 2) [px] without angles."""
        angle, sigma, slow, misfit = np.full((4, len(centre)), np.nan)
        first, second = np.zeros((2, len(centre), 2))
        return cls(angle, sigma, slow, misfit, centre.copy(), first, second, np.zeros(len(centre)))

    def set(self, use: Integers, zones: _Zones, angle: Floats, turned: Floats, misfit: Floats) -> None:
        """Set the frames `use` from rotations of the zones relative to an angle [rad], and the misfits of the zones."""
        mean, total = zones.mean(turned)
        self.angle[use] = angle + mean
        self.sigma[use], self.slow[use] = zones.sigma / total, zones.slow / total
        self.misfit[use] = np.sum(zones.share[:, None] * np.isfinite(turned) * misfit, axis=0) / total
        for found, each in ((self.first, zones.first), (self.second, zones.second)):
            found[:] = (zones.share @ each).real, (zones.share @ each).imag

    @property
    def template(self) -> Integers:
        """Number of the template of each frame, (n,), from 0: frames of one template have the same moments."""
        known = np.flatnonzero(np.isfinite(self.angle))
        number = np.zeros(len(self.angle), dtype=np.int64)
        moments = np.concatenate([self.first[known], self.second[known]], axis=1)
        number[known[1:]] = np.any(np.diff(moments, axis=0) != 0.0, axis=1)
        return np.cumsum(number)

    def levelled(self, centre: Floats, p: float, q: float) -> Floats:
        """Return the angles about the centres (n, 2) [px], corrected for the flattening (p, q) of an oblique view.

        A centre displaced by z = x + i y (y up) and the flattening turn the picture of a sample at the angle a by
        Im(z exp(-i a)) / r and Im((p + i q) exp(-2 i a)). With a = theta + psi, the mean over the samples is
        Im(z m_1 exp(-i psi)) + Im((p + i q) m_2 exp(-2 i psi)), with `first` m_1 and `second` m_2.
        """
        off = centre - self.centre
        own = self.own_view > 0.0
        placed = own & np.isfinite(off).all(axis=1)
        for key in np.unique(np.stack([self.template, self.own_view], axis=1)[placed], axis=0):
            some = placed & (self.template == key[0]) & (self.own_view == key[1])
            off[some] -= off[some].mean(axis=0)  # the view includes the mean position of a moving centre
        z = off[:, 0] - 1j * off[:, 1]
        turn = np.exp(-1j * self.angle)
        m1, m2 = (m[:, 0] + 1j * m[:, 1] for m in (self.first, self.second))
        flat = np.where(own, 0.0, p + 1j * q)
        return np.asarray(self.angle - (z * m1 * turn).imag - (flat * m2 * turn**2).imag)


@dataclass(frozen=True)
class _Zones:
    """Templates of all zones, from one batch of frames."""

    # shape (ZONES, ROWS * COLUMNS); the mean picture, the variance of a sample, the weight of a sample in a fit
    picture: Singles
    variance: Singles
    weight: Singles
    # shape (ZONES, ROWS * COLUMNS, 3); changes of the picture per rad, with the offset and with the gain
    basis: Singles
    usual: Floats  # shape (ZONES,); typical weighted mean square residual of a frame
    # shape (ZONES,); moments of the information about the angle of each zone (see `TextureObservations`)
    first: Complexes
    second: Complexes
    share: Floats  # shape (ZONES,); weight of each zone, 0 for a zone that does not turn with the body
    # standard uncertainty of the mean [rad], and the part of it that is common to neighbouring frames
    sigma: float = math.nan
    slow: float = math.nan

    def fit(self, strips: Singles) -> tuple[Floats, Floats]:
        """Return the rotation [rad] and the relative misfit of each zone in each frame, both (ZONES, n)."""
        return self.fit_blocks([strips])

    def fit_blocks(self, blocks: Iterable[Singles]) -> tuple[Floats, Floats]:
        """Return the results of `fit` for consecutive blocks of frames."""
        fits = [_Fit.of(z, self.picture[z], self.basis[z], self.weight[z]) for z in range(ZONES)]
        sums = [[fit.sums(strips) for fit in fits] for strips in blocks]
        both = [
            fit.solved(np.concatenate(own)) for fit, own in zip(fits, zip(*sums, strict=True), strict=True)
        ]
        parts, square = (np.stack(each) for each in zip(*both, strict=True))
        turned, misfit = parts[:, :, 0], square / self.usual[:, None]
        # a hand of uniform brightness fits a template without contrast
        similar = (misfit < LARGEST_MISFIT) & (1.0 + parts[:, :, 2] > LEAST_CONTRAST)
        # At larger angles the picture is not linear in the angle. A blurred picture is noisier, but it is linear up to
        # larger angles. A zone with a larger scatter does not turn with the body.
        farthest = FAR * np.array([[spread(one)] for one in turned])
        wide = (farthest > LARGEST_TURN) & (farthest < REACH)
        similar &= np.abs(turned) < np.where(wide, farthest, LARGEST_TURN)
        return np.where(similar, turned, np.nan), misfit

    def residuals(self, strips: Singles) -> list[Singles]:
        """Return the residuals of the zones after a fit of rotation, offset and gain of each frame, each (n, P)."""
        found = []
        for z in range(ZONES):
            parts, _ = _fitted(strips, z, self.picture[z], self.basis[z], self.weight[z])
            off = strips[:, ROWS * z : ROWS * (z + 1)].reshape(len(strips), -1) - self.picture[z]
            found.append(off - parts.astype(np.float32) @ self.basis[z].T)
        return found

    def response(self, radial: Singles, radius: Floats) -> ViewResponse:
        """Return the response to a view, with the derivative of the picture with respect to the radius."""
        return ViewResponse.of(self.picture, radial, self.basis, self.weight, radius)

    def weighted(self, angle: Floats, turned: Floats, shift: float) -> _Zones:
        """Return the zones with weights by their angles and their rotations, both (ZONES, n) [rad].

        `shift` is the standard uncertainty of the centre in each coordinate [px].
        """
        share, sigma = zone_weights(angle, self.first, shift)
        apart = _zone_variances(_means(turned))
        known = np.isfinite(apart)
        apart = np.where(known, apart, np.max(apart[known]) if known.any() else sigma**2)
        slow = math.sqrt(float(share**2 @ apart))
        return replace(self, share=share, sigma=sigma, slow=slow)

    def mean(self, turned: Floats) -> tuple[Floats, Floats]:
        """Return the mean rotation (n,) [rad] of the zones, and the sum of the weights of known zones; NaN if unknown.

        The mean is unknown in frames without the zones that usually determine the angle.
        """
        weight = self.share[:, None] * np.isfinite(turned)
        total = weight.sum(axis=0)
        total = np.where(total > 0.5, total, np.nan)
        return np.sum(weight * np.nan_to_num(turned), axis=0) / total, total

    def ahead_of(self, other: _Zones) -> float:
        """Return the rotation of the pictures of the body relative to the pictures of another batch [rad]."""
        each, share = np.zeros(ZONES), np.sqrt(self.share * other.share)
        for z in np.flatnonzero(share):
            variance = self.variance[z] + other.variance[z]
            mean = 0.5 * (self.picture[z] + other.picture[z])
            basis = _basis(mean, self.weight[z])
            own = self.picture[z].reshape(1, ROWS, COLUMNS)
            each[z] = _fitted(own, 0, other.picture[z], basis, 1.0 / variance)[0][0, 0]
        return float(share @ each / share.sum()) if share.any() else 0.0


def _basis(picture: Singles, weight: Singles) -> Singles:
    """Return the changes of a zone's picture per rad of rotation, with an offset and with the gain, (P, 3)."""
    across = slope(picture.reshape(ROWS, COLUMNS)).ravel()
    level = float(weight @ picture / weight.sum())
    return np.stack([-across, np.ones_like(across), picture - level], axis=1)


@dataclass(frozen=True)
class _Fit:
    """Weighted least-squares fit of the changes of the picture of a zone."""

    zone: int
    picture: Singles  # shape (P,)
    weights: Singles  # shape (4, P); weights of the sums (see `sums`)
    normal: Floats  # shape (3, 3); B' W B, with the changes B and the weights W

    @classmethod
    def of(cls, zone: int, picture: Singles, basis: Singles, weight: Singles) -> _Fit:
        """Return the fit of changes `basis` (P, 3) of a picture with weights, both (P,)."""
        weighted = basis * weight[:, None]
        normal = (weighted.T @ basis).astype(np.float64)
        return cls(zone, picture, np.array([*weighted.T, weight]), normal)

    def sums(self, strips: Singles) -> Floats:
        """Return B' W d and d' W d, (n, 4), for the differences d of strips (n, rows, COLUMNS) from the picture."""
        return kernels.sample_sums(strips, ROWS * self.zone, self.picture, self.weights)

    def solved(self, sums: Floats) -> tuple[Floats, Floats]:
        """Return the changes f (n, 3) and the weighted sums of the squared residuals (n,)."""
        # the second term is for a zone without details
        regular = self.normal + np.diag(1e-9 * np.trace(self.normal) * np.ones(3) + 1e-12)
        found = np.asarray(np.linalg.solve(regular, sums[:, :3].T).T, dtype=np.float64)
        # |d - B f|^2 = |d|^2 - f . (2 B' d - B' B f)
        explained = np.sum(found * (2.0 * sums[:, :3] - found @ self.normal), axis=1)
        return found, np.maximum(sums[:, 3] - explained, 0.0)


def _fitted(
    strips: Singles, zone: int, picture: Singles, basis: Singles, weight: Singles
) -> tuple[Floats, Floats]:
    """Fit the changes of the picture of a zone to strips (n, rows, COLUMNS).

    Return the changes (n, 3) and the weighted sums of the squared residuals (n,).
    """
    fit = _Fit.of(zone, picture, basis, weight)
    return fit.solved(fit.sums(strips))


def _mean_residual(
    strips: Singles, zone: int, picture: Singles, basis: Singles, parts: Floats, used: Bools
) -> tuple[Singles, Singles]:
    """Return mean and mean square (P,) of the residuals of a fit, with changes `parts` (n, 3), in the `used` frames."""
    share = np.where(used, 1.0 / used.sum(), 0.0)[:, None]
    weights = (share * np.concatenate([np.ones((len(parts), 1)), parts], axis=1)).astype(
        np.float32, order="C"
    )
    mean, square, *along = kernels.frame_sums(strips, ROWS * zone, picture, weights)
    changed = (parts.T @ (share * parts)).astype(np.float32)
    square += np.sum(basis * (basis @ changed - 2.0 * np.stack(along, axis=1)), axis=1)
    return mean - basis @ weights[:, 1:].sum(axis=0), np.maximum(square, 0.0)


def _templates(strips: Singles, radius: Floats) -> _Zones:
    """Learn the templates of the zones, without weights of the zones."""
    theta = np.arange(COLUMNS) * TURN / COLUMNS
    area = radius / radius.mean()
    picture, variance, weight = np.empty((3, ZONES, ROWS * COLUMNS), dtype=np.float32)
    basis = np.empty((ZONES, ROWS * COLUMNS, 3), dtype=np.float32)
    first, second = np.zeros((2, ZONES), dtype=np.complex128)
    usual = np.ones(ZONES)
    every = np.ones(len(strips), dtype=np.bool_)
    for z in range(ZONES):
        rows = radius[ROWS * z : ROWS * (z + 1)]
        size = np.repeat(area[ROWS * z : ROWS * (z + 1)], COLUMNS).astype(np.float32)
        mean = strips[0, ROWS * z : ROWS * (z + 1)].ravel()
        unchanged = np.zeros((len(strips), 3)), every
        shift, scatter = _mean_residual(strips, z, mean, np.zeros((len(mean), 3), np.float32), *unchanged)
        mean, scatter = mean + shift, scatter - shift**2
        for _ in range(_ROUNDS):
            least = np.float32(max(float(np.quantile(scatter, 0.1)), LEAST_VARIANCE))
            own = np.asarray(size / np.maximum(scatter, least), dtype=np.float32)
            changes = _basis(mean, own)
            parts, square = _fitted(strips, z, mean, changes, own)
            good = (square < UNUSUAL * median_of(square)) & (1.0 + parts[:, 2] > LEAST_CONTRAST)
            good |= not good.any()
            shift, scatter = _mean_residual(strips, z, mean, changes, parts, good)
            mean = mean + shift
        picture[z], variance[z], weight[z], basis[z] = mean, scatter, own, _basis(mean, own)
        usual[z] = max(median_of(square), LEAST_RESIDUAL**2 * float(own.sum()))
        information = (basis[z, :, 0] ** 2 * own).reshape(ROWS, COLUMNS).astype(np.float64)
        information /= max(float(information.sum()), 1e-12)
        first[z] = np.sum(information / rows[:, None] * np.exp(-1j * theta))
        second[z] = np.sum(information * np.exp(-2j * theta))
    return _Zones(picture, variance, weight, basis, usual, first, second, np.zeros(ZONES))


class TextureTracker(WithBuffer):
    """Samples the ring of one body in each frame, and measures its rotation batch by batch."""

    _buffer = "_strips"

    def __init__(
        self, centre: tuple[float, float], outer: float, size: tuple[int, int], capacity: int
    ) -> None:
        x, y = centre
        inside = min(x, y, size[0] - 1 - x, size[1] - 1 - y) - 2.0  # keep the last zone within the picture
        self.centre = centre
        edges = np.linspace(INNERMOST * outer, min(OUTERMOST * outer, inside), ZONES * ROWS + 1)
        self._radius = 0.5 * (edges[1:] + edges[:-1])
        self._useful = inside > LEAST_REACH * outer
        theta = (np.arange(COLUMNS + 2 * MARGIN) - MARGIN) * TURN / COLUMNS
        self._direction = np.stack([np.cos(theta), np.sin(theta)]).astype(np.float32)
        self._strips = np.zeros((capacity, len(self._radius), len(theta)), dtype=np.uint8)
        self._slopes: dict[int, Singles] = {}  # derivative with respect to the radius in some frames [1/px]
        self._angle = np.full(capacity, np.nan)
        self._centre = np.zeros((capacity, 2))
        self._zero = self._own_zero = 0.0
        self._last: _Zones | None = None
        self._own: _OwnView | None = None  # view of the last slow batch
        self._light: Singles | None = None  # static light of the last fast batch
        self._slow, self._batch = False, 0

    def take(
        self, frames: list[Frame], place: int, coarse: Floats, displacement: Floats | None = None
    ) -> None:
        """Sample the ring at the coarse angles (n,) of the body [rad], NaN where it is lost.

        `displacement` (n, 2) is the displacement of the hub from `centre` in each frame [px]; None: at rest.
        """
        self._used = True
        self._angle[place : place + len(frames)] = coarse
        centre = self._centre[place : place + len(frames)]
        centre[:] = self.centre if displacement is None else self.centre + displacement
        if not self._useful:
            return
        turn = np.stack([np.cos(coarse), np.sin(coarse)], axis=1)
        known = np.flatnonzero(np.isfinite(coarse))
        self._strips[place + known] = self._sampled(frames, known, centre, turn, 0.0)
        some = known[(place + known) % _SLOPE_EVERY == 0]
        beyond, before = (self._sampled(frames, some, centre, turn, off) for off in (0.5, -0.5))
        slopes = np.subtract(beyond, before, dtype=np.float32)
        self._slopes |= {place + int(k): slope for k, slope in zip(some, slopes, strict=True)}

    def _sampled(
        self, frames: list[Frame], use: Integers, centre: Floats, turn: Floats, off: float
    ) -> npt.NDArray[np.uint8]:
        """Sample rings in the frames `use` about centres (n, 2) [px] at angles with cos and sin `turn` (n, 2).

        The radii of the rings are larger by `off` [px].
        """
        found = np.empty((len(use), *self._strips.shape[1:]), dtype=np.uint8)
        radius = (self._radius + off).astype(np.float32)
        planes = [frames[k].y for k in use]
        kernels.ring(planes, centre[use], turn[use], radius, self._direction, found)
        return found

    def centres(self, count: int) -> Floats:
        """Return the centres of the ring in the first `count` frames of the batch, (count, 2) [px]."""
        return self._centre[:count].copy()

    def measure(self, count: int, angle: Floats) -> tuple[TextureObservations, TextureObservations]:
        """Measure the first `count` frames, whose angles (count,) [rad] are known to a few mrad.

        The second observations are for a slow body, with the view determined from its ring.
        """
        seen, aligned = (TextureObservations.unknown(self._centre[:count]) for _ in range(2))
        ahead = np.rint((angle - self._angle[:count]) / STEP * FINENESS) / FINENESS
        use = np.flatnonzero(np.abs(ahead) * STEP < REACH)
        if not self._useful or len(use) < (FEWEST if self._last is None else 1):
            return seen, aligned
        rough = self._angle[use] + ahead[use] * STEP
        if learning := self._last is None or len(use) >= LEARNT:
            some = np.arange(0, len(use), max(len(use) // _LIGHT_FRAMES, 1))
            fast = np.ptp(rough) > FAST_TURNS * TURN
            lit = self._turned(use[some], ahead[use[some]]) if fast else None
            self._light = None if lit is None else static_light(lit, rough[some], LOWEST_LIGHT_ORDER)
        if learning or self._last is None:
            some = np.arange(0, len(use), math.ceil(len(use) / _TEMPLATE_FRAMES))
            zones = _templates(self._turned(use[some], ahead[use[some]], self._light), self._radius)
        else:  # too few frames for templates, for example at the end of a part of the film
            zones = self._last
        parts = (use[k : k + _BLOCK] for k in range(0, len(use), _BLOCK))
        turned, misfit = zones.fit_blocks(self._turned(part, ahead[part], self._light) for part in parts)
        if zones is not self._last:
            zones = zones.weighted(rough + turned, turned, CENTRE_ERROR)
            self._zero += zones.ahead_of(self._last) if self._last is not None else 0.0
            self._last = zones
        seen.set(use, zones, rough + self._zero, turned, misfit)
        self._batch += 1
        if learning:
            self._slow = bool(np.ptp(rough) <= MANY_TURNS * TURN)
        if self._slow:
            own, rough, turned, misfit = self._align(use, rough, None if learning else self._own)
            if learning:
                self._own_zero += own.zones.ahead_of(self._own.zones) if self._own is not None else 0.0
                self._own = own
            aligned.set(use, own.zones, rough + self._own_zero, turned, misfit)
            aligned.own_view[use] = float(self._batch) if own.known else 0.0
            aligned.slow[use] = np.hypot(aligned.slow[use], own.error)
        return seen, aligned

    def _align(
        self, use: Integers, angle: Floats, learnt: _OwnView | None
    ) -> tuple[_OwnView, Floats, Floats, Floats]:
        """Measure the frames `use` repeatedly, each time in pictures turned back by the last angles (n,) [rad].

        One pass is not enough if the error of the initial angles is as large as the details, because the template is
        then blurred. The results are the view, the angles of the last pictures, and the result of `_OwnView.fit`.
        """
        for _ in range(_ALIGNMENTS):
            ahead = np.rint((angle - self._angle[use]) / STEP * FINENESS) / FINENESS
            ahead = np.clip(ahead, 1 - MARGIN, MARGIN - 1)
            rough = self._angle[use] + ahead * STEP
            strips = self._turned(use, ahead)
            own = learnt or _OwnView.learn(strips, rough, self._radius, self._radial_slope(use, ahead))
            turned, misfit = own.fit(strips, rough)
            angle = rough + np.nan_to_num(own.zones.mean(turned)[0])
        return own, rough, turned, misfit

    def _radial_slope(self, use: Integers, ahead: Floats) -> Singles:
        """Return the mean derivative of the pictures with respect to the radius, (rows, COLUMNS) [1/px].

        The derivative is measured in the frames, because edges are narrower than the distance of the rows.
        """
        known = [k for k, at in enumerate(use) if int(at) in self._slopes]
        if len(known) < _FEWEST_SLOPES:
            return np.asarray(np.gradient(self._turned(use, ahead).mean(axis=0), self._radius, axis=0))
        slopes = [_columns_ahead(self._slopes[int(use[k])], ahead[k]) for k in known]
        return np.asarray(np.mean(slopes, axis=0))

    def _turned(self, use: Integers, ahead: Floats, light: Singles | None = None) -> Singles:
        """Return the samples of the frames `use`, turned by a further `ahead` columns, (n, rows, COLUMNS).

        Static light (rows, COLUMNS) is subtracted. The samples are floats: rounding to grey levels would lose subpixel
        displacements of faint edges.
        """
        if light is None:
            light = np.zeros((len(self._radius), COLUMNS), dtype=np.float32)
        place = columns_of(self._angle[use] + ahead * STEP, COLUMNS)
        return kernels.turned(self._strips, use, ahead, light, place)


def _columns_ahead(strip: Singles, ahead: float) -> Singles:
    """Return a strip (rows, COLUMNS + 2 MARGIN) without its margins, turned by a further `ahead` columns."""
    shift = np.array([[1.0, 0.0, -MARGIN - ahead], [0.0, 1.0, 0.0]])
    return np.asarray(cv2.warpAffine(strip, shift, (COLUMNS, len(strip)), flags=cv2.INTER_LINEAR))


@dataclass(frozen=True)
class _OwnView:
    """Templates of a slow body, with the view determined from its ring."""

    zones: _Zones
    response: ViewResponse
    light: Singles | None  # static light in the image; None if it is not distinguishable from the body
    view: View
    known: bool  # whether the arc determines the view

    @classmethod
    def learn(cls, strips: Singles, angle: Floats, radius: Floats, radial: Singles) -> _OwnView:
        """Learn templates, static light and view from strips (n, rows, COLUMNS) at the angles (n,) [rad].

        `radial` (rows, COLUMNS) is the derivative of the picture with respect to the radius [1/px].
        """
        arc = float(np.ptp(angle)) / TURN
        light = static_light(strips, angle) if arc > WHOLE_TURN else None
        lit = strips if light is None else without_light(strips, light, angle)
        zones = _templates(lit, radius)
        uneven = radial - radial.mean(axis=1, keepdims=True)
        # the static light includes the effect of a view on circular edges
        response = zones.response(radial if light is None else uneven, radius)
        turned, _ = zones.fit(lit)
        known = arc > LEAST_ARC
        view = View(np.zeros(VIEW_SIZE), np.zeros((VIEW_SIZE, VIEW_SIZE)))
        if known:
            left = zones.residuals(lit)
            view = View.of(response, left, zones.weight, angle, np.isfinite(turned), TOGETHER)
            if light is None:
                clear = response.explains(view.value, left, angle)
                response = zones.response(np.where(clear[:, None], radial, uneven), radius)
                view = View.of(response, left, zones.weight, angle, np.isfinite(turned), TOGETHER)
            turned = turned - response.seen(view.value, angle)
        zones = replace(zones, first=response.first, second=response.second)
        return cls(zones.weighted(angle + turned, turned, SHADOW_ERROR), response, light, view, known)

    def fit(self, strips: Singles, angle: Floats) -> tuple[Floats, Floats]:
        """Return the rotation [rad] and the relative misfit of each zone at the angles [rad], both (ZONES, n)."""
        lit = strips if self.light is None else without_light(strips, self.light, angle)
        turned, misfit = self.zones.fit(lit)
        return turned - self.response.seen(self.view.value, angle), misfit

    @property
    def error(self) -> float:
        """Standard uncertainty of the angles caused by the uncertainty of the view [rad]."""
        return self.view.error(self.zones.share @ self.response.rotation)


def zone_weights(angle: Floats, first: Complexes, shift: float) -> tuple[Floats, float]:
    """Return weights of zones with the angles (ZONES, n) [rad], of sum 1, and the error of the weighted mean [rad].

    See the module docstring. The smooth motion is a polynomial and, over many turns, harmonics of the angle, which
    include errors of the centre and of the view that are removed later. The covariance is the sum of three parts: the
    covariance of single frames, the covariance of means of `TOGETHER` frames times `TOGETHER`, and the covariance due
    to an error of the centre by `shift` [px] in each coordinate. An error z of the centre turns a zone at the angle psi
    by Im(z m_1 exp(-i psi)), where m_1 is `first` [1/px]. All weights are 0 if too few zones are known.
    """
    weights, seen = np.zeros(len(angle)), np.isfinite(angle).mean(axis=1)
    known = np.flatnonzero(seen > max(0.5, LEAST_KNOWN * seen.max()))
    if len(known) < LEAST_ZONES:
        known = np.flatnonzero(seen > 0.5)
    if len(known) < LEAST_ZONES:
        return weights, math.nan
    some = np.flatnonzero(np.isfinite(angle[known]).any(axis=0))
    off, place = angle[known][:, some], np.linspace(-1.0, 1.0, angle.shape[1])[some]
    for last in (False, True):
        middle = np.nanmedian(off, axis=0)
        off = np.where(np.isfinite(off), off, middle)
        apart = np.array([spread(one) for one in off - middle])
        basis = _smooth_motion(middle, place, 2.0 * float(apart.min()))
        rest = _residual(off.T, basis).T
        if not last:  # remove repeated or disturbed frames
            limit = FAR * np.array([[spread(one)] for one in rest])
            usual = (np.abs(rest) <= limit).all(axis=0)
            off, place = off[:, usual], place[usual]
    off = rest
    covariance = np.cov(off) + TOGETHER * np.cov(_means(off))
    covariance += shift**2 * np.outer(first[known], first[known].conj()).real
    covariance += SHRINKAGE * np.diag(np.maximum(apart, FINEST) ** 2)
    while True:
        found = np.linalg.solve(covariance, np.ones(len(known)))
        if (found > 0).all():
            break
        kept = np.arange(len(known)) != np.argmin(found)
        known, covariance = known[kept], covariance[np.ix_(kept, kept)]
    weights[known] = found / found.sum()
    return weights, 1.0 / math.sqrt(found.sum())


def _smooth_motion(angle: Floats, place: Floats, limit: float) -> Floats:
    """Return basis functions (n, columns) that fit a motion (n,) [rad] in one batch to within a `limit` [rad].

    `place` (n,) are the times of the frames, from -1 to 1.
    """
    largest = max(len(angle) // (2 * TOGETHER), 1)
    if np.ptp(angle) > MANY_TURNS * TURN:
        harmonics = [f(k * angle) for k in (1, 2) for f in (np.cos, np.sin)]
        smooth = legvander(place, min(DEGREES[-1], largest))
        return np.concatenate([smooth, np.stack(harmonics, axis=1)], axis=1)
    for degree in DEGREES:
        basis = legvander(place, min(degree, largest))
        if spread(_residual(angle, basis)) < limit:
            break
    return np.asarray(basis, dtype=np.float64)


def _residual(values: npt.NDArray[Any], basis: npt.NDArray[Any]) -> Floats:
    """Return the residuals of values (n, ...) after a least-squares fit of the columns of a basis (n, columns)."""
    return np.asarray(values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0])


def _means(turned: Floats) -> Floats:
    """Return the means of `TOGETHER` frames each."""
    whole = turned.shape[1] // TOGETHER * TOGETHER
    parts = turned[:, :whole].reshape(len(turned), -1, TOGETHER)
    known = np.isfinite(parts)
    total = np.where(known, parts, 0.0).sum(axis=2)
    return np.where(known.sum(axis=2) > TOGETHER // 2, total / np.maximum(known.sum(axis=2), 1), np.nan)


def _zone_variances(turned: Floats) -> Floats:
    """Return the variance of the error of each zone [rad^2], inf for a zone that is rarely known.

    The robust variances of the differences between the rotations `turned` (zones, n) [rad] of zones i and j that are
    not adjacent are fitted by s_i^2 + s_j^2, with equal relative errors: the three-cornered hat of frequency metrology
    (J. E. Gray and D. W. Allan 1974).
    """
    count = len(turned)
    known = np.isfinite(turned).mean(axis=1) > 0.5
    apart = np.full((count, count), np.nan)
    for i in range(count):
        for j in range(i + 2, count):
            if known[i] and known[j]:
                off = turned[i] - turned[j]
                apart[i, j] = apart[j, i] = max(spread(off - np.nanmedian(off)), FINEST) ** 2
    if (
        known.sum() > 1
    ):  # a zone with adjacent zones only: for independent errors, the difference gives an upper limit
        for k in np.flatnonzero(known & ~np.isfinite(apart).any(axis=1)):
            others = turned[k] - turned[known & (np.arange(count) != k)]
            limit = min(spread(off - np.nanmedian(off)) for off in others)
            apart[k, k] = 2.0 * max(limit, FINEST) ** 2
    pairs = np.isfinite(apart)
    variance = np.where(pairs.any(axis=1), 0.5 * np.nanmin(np.where(pairs, apart, np.inf), axis=1), np.inf)
    equations = []
    for k in np.flatnonzero(pairs.any(axis=1)):
        others = np.flatnonzero(pairs[k])
        d = apart[k, others]
        w = d**-2
        equations.append((k, others, d, w, w.sum(), _LEAST_SHARE * float(d.min())))
    for _ in range(100):
        for k, others, d, w, total, least in equations:
            variance[k] = max(float(w @ (d - variance[others]) / total), least)
    return variance
