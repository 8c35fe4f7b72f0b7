"""Fusion of the markers of a body into its angle.

The coarse angle of the body gives the number of turns; the fine angle of each marker is a small residual about it. The
markers are combined with their mount angles, weighted by the inverse variance of their scatter about the smooth motion;
outliers are rejected.

Systematic errors that are functions of an angle are removed first. Reflections of lamps in the metal displace a marker
in the same way each time it passes a place. The edge and the shadow of the casing's bar displace a marker each time the
marker passes the bar. These errors are estimated from the residuals of the marker about the smooth motion of its body,
as a smooth closed curve c that minimises

    sum w (r - B c)^2 / s^2  +  |D2 c|^2 / bend^2  +  |c|^2 / size^2

where r are the residuals with weights w, B are linear hat functions on equally spaced knots, s is the scatter, D2 are
cyclic second differences, and bend and size are prior standard deviations.

Curves and smooth motion are estimated in alternation until the curves settle (backfitting: A. Buja, T. Hastie and R.
Tibshirani, Annals of Statistics 17 (1989) 453). An error in step with the frames varies as slowly as the motion. It is
known from frames in which it varies faster, and needs many passes.

Real motion of a body must not be removed. An unbalance or a tilted table changes the motion once or twice per turn of
the body, equally for all its markers. This is negligible for a fast body: an amplitude A of its acceleration causes an
amplitude A / omega^2 of its angle. If there are fast frames, the curves are estimated from these frames and used for
all frames. Otherwise the harmonics of orders 1 and 2 in the angle of the body that all markers have in common are not
removed (`without_common_motion`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from gyrotrack._arrays import Bools, Floats, Integers
from gyrotrack._column_store import in_file, new_columns, release_pages, row_blocks
from gyrotrack._smoothing import (
    FAR,
    HALF_WINDOW,
    TimeBase,
    core_scatter,
    correlation_factor,
    excess,
    learning_window,
    line_through,
    local_fit,
    median_of,
    median_smooth,
    share_of_floor,
    smooth_path,
    spread,
    tail_factor,
    whole_turns,
)
from gyrotrack.tracking._marker_tracker import Candidate, spread_out, variance_inflation
from gyrotrack.tracking._orbit import CELL

Scatter = dict[str, tuple[float, float]]  # of open and of partly occluded observations by marker [rad]

TURN = 2.0 * np.pi
"""A full turn [rad]. Derived: 2 pi."""
ALL = slice(None)
FAST = 70.0
"""Smallest angular rate at which real motion is not confused with position-dependent errors [rad/s]. Derived: a large
unbalance, an acceleration of amplitude 10 rad/s2, causes an amplitude of 10 / 70^2 = 2 mrad."""
_LEFT = 0.2
"""Smallest share of the scatter of a marker that is independent of the other markers [1]. Chosen: a smaller value gives
a marker too much weight; a larger one counts twice the timing error that all markers have in common."""


@dataclass(frozen=True)
class Weights:
    """Scatter and outliers of the observations of each marker."""

    scatter: Scatter
    weak: dict[str, Floats]  # factor on the scatter (n,) [1]
    use: dict[str, Bools]  # observations that are not outliers (n,)


@dataclass(frozen=True)
class LearntErrors:
    """Repeatable errors of each marker: values (n,) [rad], and leverages of the residuals in their curve (n,) [1]."""

    error: dict[str, Floats]
    leverage: dict[str, Floats]


@dataclass(frozen=True)
class PlaceErrors(LearntErrors):
    """Position-dependent errors of each marker, the sizes of their curves, and the displacement of the axis."""

    size: dict[str, float] = field(default_factory=dict)  # [rad]
    common_kept: bool = True  # whether common harmonics are motion (see `without_common_motion`)
    axis_off: dict[str, complex] = field(default_factory=dict)  # of a fast body, (x + i y) / radius


@dataclass(frozen=True)
class ViewErrors:
    """Errors of the view: errors of each marker due to a wrong centre of its orbit and a tilt of the camera.

    `error` contains the errors (n,) [rad], and `sigma` the resulting uncertainty of the angle of the body (n,) [rad].
    """

    error: dict[str, Floats]
    sigma: Floats


@dataclass(frozen=True)
class Residuals:
    """Residuals of markers about the coarse path of their body (n,) [rad], and their errors.

    Residuals are NaN where the body was lost. The arrays of a record are never modified: each step of `join` estimates
    one field anew and returns a new record that contains it.
    """

    fps: float  # [1/s]
    time_base: TimeBase | None
    path: Floats  # smooth coarse path (n,) [rad]
    bend: Floats  # path on a uniform grid of times, minus a straight line [rad]
    fast: Bools  # frames faster than `FAST` (n,)
    candidates: dict[str, Candidate]
    mounts: dict[str, float]  # mount angles [rad]
    turning: Bools  # frames within whole turns (n,), see `turning_frames`
    weights: Weights
    place: PlaceErrors
    neighbour: LearntErrors
    view: ViewErrors | None = None  # if known, its errors replace the errors in `place`

    @classmethod
    def of(
        cls, coarse: Floats, candidates: dict[str, Candidate], fps: float, time_base: TimeBase | None = None
    ) -> Residuals:
        """Return the residuals about a coarse path (n,) [rad] before anything is estimated."""
        path, even = (smooth_path(coarse),) * 2 if time_base is None else time_base.path(coarse)
        with np.errstate(invalid="ignore"):
            fast = speed(path, fps, time_base) > FAST
        path, fast = in_file({"path": path, "fast": fast}).values()
        (bend,) = in_file({"bend": even - line_through(even)}).values()
        use = _columns(candidates, len(path), np.bool_)
        for name, c in candidates.items():
            use[name][:] = c.good & np.isfinite(path) & np.isfinite(c.angle)
            release_pages()
        weak = {name: c.weak for name, c in candidates.items()}
        nothing = dict.fromkeys(candidates, np.broadcast_to(0.0, len(path)))
        return cls(
            fps, time_base, path, bend, fast, candidates,
            mounts={name: c.mount for name, c in candidates.items()},
            turning=np.broadcast_to(np.False_, len(path)),
            weights=Weights(dict.fromkeys(candidates, (0.01, 0.03)), weak, use),
            place=PlaceErrors(nothing, nothing),
            neighbour=LearntErrors(nothing, nothing),
        )  # fmt: skip

    def time_sigma(self) -> Floats | float:
        """Return the uncertainty of the angle due to the uncertainty of the time of a frame, (n,) [rad]."""
        if self.time_base is None or self.time_base.sigma == 0.0:
            return 0.0
        return np.abs(self.time_base.speed(self.path)) * self.time_base.sigma

    def residual(self, name: str, part: slice = ALL) -> Floats:
        """Return the angle of the body according to one marker, minus the path, (n,) [rad].

        The mount angle and the bias of the marker are subtracted.
        """
        off = self.candidates[name].angle[part] - self.path[part]
        off -= self.mounts[name]
        off -= self.bias(name, part)
        return wrapped(off)

    def by_place(self, name: str) -> Floats:
        """Return the estimated position-dependent error of a marker, or its error of the view if known, (n,) [rad]."""
        return (self.view or self.place).error[name]

    def bias(self, name: str, part: slice = ALL) -> Floats:
        """Return the estimated repeatable error of a marker in each frame, (n,) [rad]."""
        return np.asarray(self.by_place(name)[part] + self.neighbour.error[name][part])

    def absorbed(self, name: str, part: slice | Bools = ALL) -> Floats:
        """Return the share of each residual of a marker that its curves absorb, (n,) [1]."""
        return np.asarray(self.place.leverage[name][part] + self.neighbour.leverage[name][part])

    def sigma(self, name: str, part: slice = ALL) -> Floats:
        """Return the uncertainty of each observation (n,) [rad]: its scatter times `weak`."""
        scatter = np.where(self.candidates[name].open[part], *self.weights.scatter[name])
        return np.asarray(scatter * self.weights.weak[name][part])

    def mean(self) -> tuple[Floats, Floats, Integers]:
        """Return the weighted mean residual, its uncertainty [rad], and the number of markers in it, (n,) each."""
        mean, sigma = np.zeros((2, len(self.path)))
        count = np.zeros(len(self.path), dtype=np.int64)
        for part in row_blocks(len(self.path)):
            weight = np.zeros(len(mean[part]))
            for name in self.candidates:
                w = np.where(self.weights.use[name][part], 1.0 / self.sigma(name, part) ** 2, 0.0)
                mean[part] += np.where(w > 0, w * self.residual(name, part), 0.0)
                weight += w
                count[part] += w > 0
            seen = weight > 0
            safe = np.where(seen, weight, 1.0)
            nothing = np.where(seen, 0.0, np.nan)
            mean[part] = mean[part] / safe + nothing
            sigma[part] = 1.0 / np.sqrt(safe) + nothing
        return mean, sigma, count

    def smooth(self, half: int, degree: int = 2) -> tuple[Floats, Floats]:
        """Fit a smooth curve to the angle of the body; return its difference from the path [rad] and leverages, (n,).

        `half` is the half width of the window [frames], and `degree` is the degree of the local polynomials.
        """
        mean, sigma, _ = self.mean()
        if self.time_base is not None:
            return self.time_base.smooth(mean, _weight(sigma), self.bend, half, degree)
        mean += self.bend
        fitted, leverage = local_fit(mean, _weight(sigma), half, degree)
        fitted -= self.bend
        return fitted, leverage

    def standardised(self, name: str, smooth: Floats, leverage: Floats, weak: Floats) -> Floats:
        """Return the residuals of a marker about a smooth curve, (n,) [rad], scaled to equal variance.

        They are divided by `weak` and by the square root of the share that the curves do not absorb.
        """
        off = np.empty(len(self.path))
        for part in row_blocks(len(off)):
            absorbed = leverage[part] / max(len(self.candidates), 1) + self.absorbed(name, part)
            share = np.clip(1.0 - absorbed, 0.1, 1.0)
            off[part] = self.residual(name, part) - smooth[part]
            off[part] /= weak[part]
            off[part] /= np.sqrt(share)
        return off


def _columns(names: Iterable[str], rows: int, kind: npt.DTypeLike = np.float64) -> dict[str, Any]:
    """Return a new column with undefined values for each marker."""
    return new_columns(rows, dict.fromkeys(names, ((), kind)))


def speed(path: Floats, fps: float, time_base: TimeBase | None = None) -> Floats:
    """Return the magnitude (n,) [rad/s] of the angular rate of a path (n,) [rad]; `fps` is the frame rate [1/s]."""
    step = np.gradient(path) if time_base is None else time_base.speed(path)
    return np.asarray(np.abs(step) * fps)


def mount_angles(state: Residuals, smooth: Floats) -> dict[str, float]:
    """Return the mount angles of the markers [rad] from residuals about a curve (n,) [rad]; the first is fixed."""
    shift = {}
    for name in state.candidates:
        off = state.residual(name)
        off -= smooth
        off = off[state.weights.use[name] & np.isfinite(off)]
        release_pages()
        shift[name] = median_of(off) if len(off) else 0.0
    zero = next(iter(shift.values()))
    return {name: mount + (shift[name] - zero) for name, mount in state.mounts.items()}


def weights_about(state: Residuals, smooth: Floats, leverage: Floats) -> Weights:
    """Measure the scatter of each marker about a smooth curve (n,) [rad] with its leverages (n,); reject outliers.

    The variance increases with the misfit (see `variance_inflation`).
    """
    scatter, n = {}, len(state.path)
    weak, use = _columns(state.candidates, n), _columns(state.candidates, n, np.bool_)
    for name, c in state.candidates.items():
        used = state.weights.use[name]
        off = state.standardised(name, smooth, leverage, c.weak)
        for part in (c.open, ~c.open):
            some = used & part
            share = variance_inflation(off[some], c.misfit_excess[some])
            weak[name][part] = c.weak[part] * np.sqrt(1.0 + share * c.misfit_excess[part])
        off = state.standardised(name, smooth, leverage, weak[name])
        clear = core_scatter(off[used & c.open], state.weights.scatter[name][0])
        partly = max(core_scatter(off[used & ~c.open], 3.0 * clear), clear)
        scatter[name] = (clear, partly)
        limit = FAR * np.where(c.open, clear, min(partly, 5.0 * clear)) + 5e-4
        use[name][:] = used & ~(np.abs(off) > limit)
        release_pages()
    return Weights(scatter, weak, use)


def scatter_over_turns(state: Residuals, smooth: Floats, leverage: Floats) -> Scatter:
    """Return the scatter of each marker [rad] about a curve (n,) [rad] that is smooth over whole turns.

    The scatter then contains errors that repeat in each turn, except those removed by the curves. It is limited to 2.5
    times the scatter about the curve of the short window, because a larger scatter is due to real motion.
    """
    scatter = {}
    for name, c in state.candidates.items():
        off = state.standardised(name, smooth, leverage, state.weights.weak[name])
        seen = state.weights.use[name] & state.turning
        clear, partly = (
            float(np.clip(core_scatter(off[seen & part], s), s, 2.5 * s))
            for part, s in zip((c.open, ~c.open), state.weights.scatter[name], strict=True)
        )
        scatter[name] = (clear, partly)
    return scatter


def without_time_scatter(scatter: Scatter, from_time: Floats) -> Scatter:
    """Subtract `from_time` (n,) [rad] from the scatter [rad].

    This part of the scatter is due to the uncertainty of the times of frames and is equal for all markers.
    """
    shared = float(np.nanmean(from_time**2))
    left = {}
    for name, both in scatter.items():
        clear, partly = (float(np.sqrt(max(s**2 - shared, (_LEFT * s) ** 2))) for s in both)
        left[name] = (clear, partly)
    return left


def turning_frames(state: Residuals, short: Floats, smooth: Floats, half: int) -> Bools:
    """Return the frames (n,) in which errors that repeat with the turn can be distinguished from motion.

    In these frames, the long window (`half` frames on each side) contains a whole turn, and its curve `smooth` agrees
    with the curve `short` (n,) [rad]. At a sudden start, the curves differ.
    """
    usual = min(clear for clear, _ in state.weights.scatter.values())
    with np.errstate(invalid="ignore"):
        turning = whole_turns(state.path, half) & (np.abs(smooth - short) < 12.0 * usual)
    return in_file({"turning": turning})["turning"]


def wrapped(angle: Floats) -> Floats:
    """Return angles in [-pi, pi]."""
    return np.asarray(angle - TURN * np.rint(angle / TURN))


def _weight(sigma: Floats) -> Floats:
    """Return the weights of the mean residuals in the fit of a smooth curve, 1 for the median uncertainty."""
    known = np.isfinite(sigma)
    if not known.any():
        return np.zeros(len(sigma))
    return np.where(known, (median_of(sigma[known]) / np.where(known, sigma, 1.0)) ** 2, 0.0)


KNOTS = 72
"""Number of knots of a closed curve [1]. Chosen: every 5 degrees; with fewer, the edge of the bar of the casing is
smoothed; with more, the curve is noisy."""
_BEND = 4e-3
"""Standard deviation of the second differences of a closed curve [rad]. Chosen: a smaller value smooths the edge of the
bar of the casing, a larger one fits noise."""
_SIZE = 3e-2
"""Standard deviation of a closed curve [rad]. Chosen: a smaller value leaves large errors, with a larger one the curve
is arbitrary at unseen angles."""


@dataclass(frozen=True)
class ClosedCurve:
    """A fitted closed curve: values at the knots (KNOTS,) [rad], their covariance, and the observed `size` [rad]."""

    values: Floats
    covariance: Floats
    size: float

    def leverage(self, angle: Floats, weight: Floats) -> Floats:
        """Return the weight of each fitted residual in the curve at its own angle, (n,)."""
        low, high, part = _between_knots(angle)
        c = self.covariance
        variance = (
            (1 - part) ** 2 * c[low, low] + part**2 * c[high, high] + 2 * part * (1 - part) * c[low, high]
        )
        return np.asarray(weight * variance)


def closed_curve(angle: Floats, residual: Floats, weight: Floats) -> ClosedCurve:
    """Fit a smooth closed curve to residuals as a function of an angle [rad]; `weight` is 1 / variance."""
    low_low, high_high, both = np.zeros((3, KNOTS))
    right = np.zeros(KNOTS)
    for some in row_blocks(len(angle)):
        use = (weight[some] > 0) & np.isfinite(residual[some])
        low, high, part = _between_knots(angle[some][use])
        w, r = weight[some][use], residual[some][use]
        low_low += np.bincount(low, w * (1 - part) ** 2, KNOTS)
        high_high += np.bincount(high, w * part**2, KNOTS)
        both += np.bincount(low, w * part * (1 - part), KNOTS)
        right += np.bincount(low, w * (1 - part) * r, KNOTS) + np.bincount(high, w * part * r, KNOTS)
    adjacent = np.roll(np.diag(both), 1, axis=1)
    normal = np.diag(low_low + high_high) + adjacent + adjacent.T
    covariance = np.asarray(np.linalg.inv(normal + _precision(_SIZE)), dtype=np.float64)
    values = covariance @ right
    waves = np.arange(KNOTS) * TURN / KNOTS
    low = np.array([f(k * waves) for k in range(1, 5) for f in (np.cos, np.sin)]) * np.sqrt(2.0 / KNOTS)
    power = (low @ values) ** 2 + np.einsum("ki,ij,kj->k", low, covariance, low)
    return ClosedCurve(values, covariance, min(float(np.sqrt(power.mean())), _SIZE))


def _precision(size: float) -> Floats:
    """Return the inverse of the covariance of a closed curve (see the module docstring), (KNOTS, KNOTS)."""
    eye = np.eye(KNOTS)
    second = np.roll(eye, 1, axis=1) + np.roll(eye, -1, axis=1) - 2.0 * eye
    return np.asarray(second.T @ second / _BEND**2 + eye / size**2)


def _between_knots(angle: Floats) -> tuple[Integers, Integers, Floats]:
    """Return the knots on both sides of angles, and the weight of the second knot."""
    place = np.mod(angle, TURN) * KNOTS / TURN
    low = np.floor(place)
    return low.astype(np.int64) % KNOTS, (low.astype(np.int64) + 1) % KNOTS, place - low


def curve_at(curve: Floats, angle: Floats) -> Floats:
    """Evaluate a closed curve given at the knots."""
    place = np.mod(angle, 2.0 * np.pi) * KNOTS / (2.0 * np.pi)
    return np.asarray(np.interp(place, np.arange(KNOTS + 1), np.append(curve, curve[0])))


def without_common_motion(curves: dict[str, Floats], mounts: dict[str, float]) -> dict[str, Floats]:
    """Remove from the curves the harmonics of orders 1 and 2 that all markers have in common."""
    knots = np.arange(KNOTS) * 2.0 * np.pi / KNOTS
    together = np.mean([curve_at(curve, knots + mounts[name]) for name, curve in curves.items()], axis=0)
    spectrum = np.fft.rfft(together)
    spectrum[3:] = 0.0
    common = np.fft.irfft(spectrum, KNOTS)
    return {name: curve - curve_at(common, knots - mounts[name]) for name, curve in curves.items()}


def once_a_turn(curve: Floats) -> complex:
    """Return the displacement of the axis that corresponds to a curve, (x + i y) / radius.

    About an axis at 0, a marker at v = e + r (cos a, sin a), y up, has the angle a + (e_y cos a - e_x sin a) / r.
    """
    first = complex(np.fft.rfft(curve)[1]) * 2.0 / KNOTS
    return complex(first.imag, first.real)


LEAST_TURNING = 0.5
"""Position-dependent errors are known if at least this share of the frames is within whole turns [1]. Chosen: a smaller
value gives errors from few turns, a larger one gives none for short films."""
MOST_FRAMES = 2000
"""Number of frames from which errors of the view are estimated [frames]. Chosen: a larger number costs time, a smaller
one gives noisier estimates."""
LEAST_FAST = 0.2
"""Smallest share of fast frames for which curves are estimated from the fast frames alone [1]. Chosen: a smaller value
uses few frames, a larger one uses slow frames, in which motion resembles errors."""


def errors_by_place(state: Residuals, smooth: Floats) -> PlaceErrors:
    """Estimate the error of each marker as a function of its place in the picture (see the module docstring).

    `smooth` is the curve of the motion (n,) [rad].
    """
    fast = state.turning & state.fast
    geometry_only = bool(fast.sum() > LEAST_FAST * state.turning.sum())
    when = fast if geometry_only else state.turning
    curves, size, n = {}, {}, len(state.path)
    error, leverage = _columns(state.candidates, n), _columns(state.candidates, n)
    for name, c in state.candidates.items():
        fit = state.weights.use[name] & c.open & when
        found = _curve(state, name, c.angle, state.neighbour.error[name], smooth, fit)
        curves[name], size[name] = found.values, found.size
        for part in row_blocks(n):
            weight = np.where(fit[part], 1.0 / state.sigma(name, part) ** 2, 0.0)
            leverage[name][part] = found.leverage(np.nan_to_num(c.angle[part]), weight)
    axis_off = state.place.axis_off
    if geometry_only:
        axis_off = {name: once_a_turn(curve) for name, curve in curves.items()}
    else:
        curves = without_common_motion(curves, state.mounts)
    for name, curve in curves.items():
        for part in row_blocks(n):
            place = np.nan_to_num(state.candidates[name].angle[part])
            error[name][part] = curve_at(curve - curve.mean(), place)
    return PlaceErrors(error, leverage, size, not geometry_only, axis_off)


def errors_by_neighbour(
    state: Residuals, smooth: Floats, other: Floats, window: tuple[int, int], *, above: bool, last: bool
) -> LearntErrors:
    """Estimate the error of each marker as a function of its angle to the other body (see the module docstring).

    `smooth` is the curve of the motion, `other` the angle of the other body, (n,) [rad]. Markers below the other body
    have errors where they are partly occluded, in its shadow, and at its blurred edge. Markers above the other body
    (`above`) have errors where markers of the other body pass next to them. Errors of unoccluded markers are estimated
    only if there are enough frames in which the bodies pass each other so fast that no real motion resembles these
    errors. If the time between passages is nearly a multiple of the time between frames, the recorded error varies as
    slowly as a motion. Therefore, for markers above, the part of the error that a local polynomial fits counts as
    motion and is not removed (`window`: half width and degree of the polynomial).
    """
    with np.errstate(invalid="ignore"):
        passing = state.turning & (speed(other - state.path, state.fps, state.time_base) > FAST)
    fast = bool(passing.sum() > LEAST_FAST * state.turning.sum())
    n = len(state.path)
    if above and not fast:
        return replace(state.neighbour, leverage=dict.fromkeys(state.candidates, np.broadcast_to(0.0, n)))
    error, leverage = _columns(state.candidates, n), _columns(state.candidates, n)
    for name, c in state.candidates.items():
        difference = np.nan_to_num(c.angle - other)
        near = state.weights.use[name] & np.isfinite(other)
        when = near & (passing if above else state.turning)
        found = _curve(state, name, difference, state.by_place(name), smooth, when)
        clear = float(fast)
        if last and fast:
            clear = _shown_share(found, difference, when & c.open)
        # the mean error of unoccluded frames is a part of the mount angle
        seen = near & c.open
        level = clear * float(curve_at(found.values, difference[seen]).mean()) if seen.any() else 0.0
        for part in row_blocks(n):
            share = np.where(c.open[part], clear, 1.0) * near[part]
            weight = np.where(when[part], share / state.sigma(name, part) ** 2, 0.0)
            leverage[name][part] = found.leverage(difference[part], weight)
            error[name][part] = share * curve_at(found.values, difference[part]) - level * near[part]
        if above:
            slow, _ = local_fit(error[name], near.astype(np.float64), *window)
            error[name] -= np.where(near, np.nan_to_num(slow), 0.0)
    return LearntErrors(error, leverage)


def _shown_share(curve: ClosedCurve, angle: Floats, use: Bools) -> float:
    """Return the share of a curve's mean square at some angles that its own uncertainty does not explain, 0 to 1.

    Multiplied by this factor (James-Stein), a curve that is hardly significant adds less error than it removes.
    """
    if not use.any():
        return 0.0
    size = float(np.mean(curve_at(curve.values, angle[use]) ** 2))
    noise = float(np.mean(curve.leverage(angle[use], np.ones(int(use.sum())))))
    return max(1.0 - noise / max(size, 1e-12), 0.0)


VIEW_ORDERS = range(1, 3)
"""Orders of the harmonics of errors of the view [periods per turn]. Derived: an offset of the axis causes order 1, a
tilt of the camera order 2."""
_VIEW_SIZES = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Trial standard deviations of errors of the view, relative to the standard deviation of one harmonic in `floor` [1].
Chosen: factors of two; finer steps cost time, a smaller range limits the errors."""


def errors_of_view(state: Residuals, floor: float, arcs: dict[str, Floats]) -> ViewErrors | None:
    """Estimate errors of the view from differences between markers.

    Within less than two turns, position-dependent errors look like motion. Motion, however, is common to all markers of
    a body in each frame, while errors due to the centres of the orbits and to the tilt of the camera depend on the
    place of each marker. The coefficients of the harmonics `VIEW_ORDERS` of each marker's angle have a common part and
    a separate part. They are fitted, together with the mount angles, to the residuals minus their mean in each frame.
    Position-dependent errors of standard deviation `floor` [rad] have one independent value per `CELL`. Each part has a
    standard deviation. The trial values are `_VIEW_SIZES` times floor / sqrt(number of `PLACE_ORDERS`), and the pair
    with the largest likelihood is used. For each marker that covers only an arc, `arcs` contains the covariance (2, 2)
    [rad^2] of the offset of its orbit; it is added to the prior covariance of the coefficients of order 1. The result
    is None for a single marker, or if position-dependent errors are estimated from whole turns.
    """
    names, n = list(state.candidates), len(state.path)
    known = np.isfinite(state.path)
    if len(names) < 2 or floor <= 0.0 or state.turning.any() or not known.any():
        return None
    count, orders = len(names), 2 * len(VIEW_ORDERS)
    size = count * orders
    alike = known.sum() / max(float(np.ptp(state.path[known])) / CELL, 1.0)
    few = np.arange(0, n, max(n // MOST_FRAMES, 1))
    alike *= len(few) / n
    normal, right = np.zeros((size + count, size + count)), np.zeros(size + count)
    # prior of 1 rad, because a mount angle common to all markers has no effect
    normal[size:, size:] = np.eye(count)
    total, summed, seen = np.zeros(len(few)), np.zeros((len(few), size + count)), np.zeros(len(few))
    for k, name in enumerate(names):
        own, residual, weight = _view_rows(state, name, few, alike * floor**2)
        rows = np.zeros((len(few), size + count))
        rows[:, k * orders : (k + 1) * orders], rows[:, size + k] = own, 1.0
        weighted = weight[:, None] * rows
        normal += weighted.T @ rows
        right += weighted.T @ residual
        total, summed, seen = total + weight, summed + weighted, seen + weight * residual
    safe = np.where(total > 0.0, total, 1.0)
    normal -= (summed / safe[:, None]).T @ summed
    right -= summed.T @ (seen / safe)
    usual, offsets = floor / math.sqrt(len(PLACE_ORDERS)), np.zeros((size, size))
    # an offset e displaces a marker at the angle a by e_y cos a - e_x sin a
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
    for k, name in enumerate(names):
        if name in arcs:
            offsets[k * orders : k * orders + 2, k * orders : k * orders + 2] = turn @ arcs[name] @ turn.T
    best = (-math.inf, normal)
    for common, each in product(_VIEW_SIZES, _VIEW_SIZES):
        sizes = (each * usual) ** 2 * np.eye(count) + (common * usual) ** 2
        prior = np.linalg.inv(np.kron(sizes, np.eye(orders)) + offsets)
        full = normal.copy()
        full[:size, :size] += prior
        fit = float(right @ np.linalg.solve(full, right))
        evidence = 0.5 * (fit + np.linalg.slogdet(prior)[1] - np.linalg.slogdet(full)[1])
        best = max(best, (evidence, full), key=lambda one: one[0])
    normal = best[1]
    covariance = np.linalg.inv(normal)
    solution = (covariance @ right)[:size].reshape(count, orders)
    error, effect, total = _columns(names, n), np.zeros((n, size)), np.zeros(n)
    for k, name in enumerate(names):
        own, _, weight = _view_rows(state, name, np.arange(n), 0.0)
        error[name][:] = own @ solution[k]
        effect[:, k * orders : (k + 1) * orders] = weight[:, None] * own
        total += weight
    effect /= np.where(total > 0.0, total, 1.0)[:, None]
    effect -= effect[total > 0.0].mean(axis=0) if (total > 0.0).any() else 0.0
    sigma = np.sqrt(np.einsum("ni,ij,nj->n", effect, covariance[:size, :size], effect))
    return ViewErrors(error, in_file({"sigma": sigma})["sigma"])


def _view_rows(state: Residuals, name: str, frames: Integers, more: float) -> tuple[Floats, Floats, Floats]:
    """Return harmonics (k, orders), residuals and weights (k,) of a marker; `more` is added to the variances."""
    c = state.candidates[name]
    angle = np.nan_to_num(c.angle[frames])
    own = np.stack([f(k * angle) for k in VIEW_ORDERS for f in (np.cos, np.sin)], axis=1)
    residual = wrapped(
        np.nan_to_num(
            c.angle[frames] - state.path[frames] - state.mounts[name] - state.neighbour.error[name][frames]
        )
    )
    weight = np.where(state.weights.use[name][frames], 1.0 / (state.sigma(name)[frames] ** 2 + more), 0.0)
    return own, residual, weight


def places_passed(state: Residuals) -> float:
    """Return the number of places with independent errors that the body passes.

    Only frames that are not within whole turns count.
    """
    path = state.path[~state.turning & np.isfinite(state.path)]
    return float(np.ptp(path)) / CELL if len(path) else 0.0


PLACE_ORDERS = range(1, 7)
"""Orders of the harmonics of position-dependent errors [periods per turn]. Chosen: all have equal variances; a larger
number shortens the correlation length `CELL`, a smaller one lengthens it."""


def variance_left(angle: Floats, orders: range, frames: int | None = None) -> float:
    """Return the share of the variance of an angle-dependent error that remains if its mean over the film is removed.

    The zero of an angle is arbitrary, so an error that hardly changes along a short arc has no effect. The harmonics of
    the error, of the given orders, have random phases. A phase is constant over `frames` frames (by default over the
    whole film).
    """
    pieces = np.array_split(angle, max(round(len(angle) / (frames or len(angle))), 1))
    known = max(int(np.isfinite(angle).sum()), 1)
    mean = [abs(np.nansum(np.exp(1j * k * piece))) ** 2 for k in orders for piece in pieces]
    return 1.0 - float(np.sum(mean)) / known**2 / len(orders)


def place_error(state: Residuals) -> float:
    """Return the rms of the estimated position-dependent errors, for the marker with the smallest rms [rad].

    Faint or blurred markers have larger errors for other reasons. A marker next to a slow bar has larger errors at some
    places only; therefore a robust standard deviation is used if it is smaller. The noise of the estimated errors is
    subtracted. NaN if no error could be estimated, or if the markers are seen at only a few angles.
    """
    if state.turning.mean() < LEAST_TURNING:
        return float("nan")
    learnt = []
    for name, c in state.candidates.items():
        seen = state.weights.use[name] & c.open & state.turning
        if len(np.unique(np.rint(c.angle[seen] * KNOTS / TURN))) >= KNOTS / 2:
            error = state.by_place(name)[seen]
            noise = float(np.mean(state.absorbed(name, seen) * state.sigma(name)[seen] ** 2))
            learnt.append(float(np.sqrt(max(min(float(np.mean(error**2)), spread(error) ** 2) - noise, 0.0))))
        release_pages()
    return min(learnt, default=float("nan"))


def _curve(
    state: Residuals, name: str, over: Floats, known: Floats, smooth: Floats, use: Bools
) -> ClosedCurve:
    """Fit a closed curve, as a function of the angle `over`, to the residuals of a marker about the smooth motion."""
    off, weight = np.empty((2, len(over)))
    for part in row_blocks(len(over)):
        ahead = state.candidates[name].angle[part] - state.path[part] - state.mounts[name] - known[part]
        off[part] = wrapped(ahead) - smooth[part]
        weight[part] = np.where(use[part], 1.0 / state.sigma(name, part) ** 2, 0.0)
    return closed_curve(over, off, weight)


MOST_TURNS = 30.0
"""Number of turns above which the uncertainty of the curves is neglected [turns]. Chosen: the uncertainty decreases
with the number of turns; a lower limit understates the uncertainty, a higher one costs time."""


def _variance_shares(state: Residuals, motion: int) -> tuple[Floats, Floats]:
    """Return the variances of the angle of the body and of its residual, divided by the variance of the noise, (n,).

    Within a few turns, a motion and a curve over the angle can hardly be distinguished, least of all at the ends of the
    film. The mean residual is r = a x + e. Here x are the parameters of the motion (cubic B-splines, `motion` >= 4) and
    of the curves, a are their coefficients in a frame, and e is noise. The estimate of x has the error dx with the
    covariance C, in which the observed size of the curves is a prior. Then cov(e, dx) = C a. Let b be a with zeros for
    the motion. The angle after subtraction of the curves has the error e - b dx. The residual from motion and curves is
    e - a dx.
    """
    names, n = list(state.candidates), len(state.path)
    if not state.turning.any() or np.nanmax(state.path) - np.nanmin(state.path) > MOST_TURNS * TURN:
        return np.ones(n), np.ones(n)
    size = motion + KNOTS * len(names)
    normal, rows, total = np.zeros((size, size)), np.zeros((n, size)), np.zeros(n)
    spline = _cubic_splines(n, motion)
    for k, name in enumerate(names):
        weight = np.where(state.weights.use[name], 1.0 / state.sigma(name) ** 2, 0.0)
        low, high, part = _between_knots(np.nan_to_num(state.candidates[name].angle))
        row, own = np.zeros((n, size)), motion + k * KNOTS
        row[:, :motion] = spline
        row[np.arange(n), own + low], row[np.arange(n), own + high] = 1.0 - part, part
        weighted = weight[:, None] * row
        normal += row.T @ weighted
        normal[own : own + KNOTS, own : own + KNOTS] += _precision(state.place.size[name])
        rows, total = rows + weighted, total + weight
    seen = total > 0
    rows, noise = rows[seen] / total[seen, None], 1.0 / total[seen]
    covariance = np.linalg.inv(normal + 1e-9 * np.trace(normal) / size * np.eye(size))
    both = rows @ covariance
    curves = rows.copy()
    curves[:, :motion] = 0.0
    if state.place.common_kept:
        curves[:, motion:] = curves[:, motion:] @ _without_common(state.mounts)
    for _ in range(2):  # the zero of the angle is arbitrary; well-known frames determine it
        variance = noise + np.einsum("ni,ni->n", curves @ covariance - 2.0 * both, curves)
        curves -= np.average(curves, axis=0, weights=1.0 / np.maximum(variance, 0.1 * noise))
    variance = noise + np.einsum("ni,ni->n", curves @ covariance - 2.0 * both, curves)
    error, left = np.ones((2, n))
    error[seen] = np.maximum(variance / noise, 0.1)
    left[seen] = np.clip(1.0 - np.einsum("ni,ni->n", both, rows) / noise, 0.1, 1.0)
    return error, left


def _cubic_splines(n: int, count: int) -> Floats:
    """Return `count` uniform cubic B-splines over n frames, (n, count)."""
    place = np.linspace(0.0, count - 3.0, n)
    u = np.abs(place[:, None] - (np.arange(count) - 1.0))
    return np.asarray(np.where(u < 1, (4 - 6 * u**2 + 3 * u**3) / 6, np.clip(2 - u, 0, None) ** 3 / 6))


def _without_common(mounts: dict[str, float]) -> Floats:
    """Return the matrix of `without_common_motion` for the curves of all markers."""
    units = np.eye(KNOTS * len(mounts)).reshape(-1, len(mounts), KNOTS)
    kept = [without_common_motion(dict(zip(mounts, unit, strict=True)), mounts) for unit in units]
    return np.stack([np.concatenate(list(curves.values())) for curves in kept], axis=1)


FEWEST_ROUNDS = 5
"""Smallest number of passes of the fusion, and number of passes that estimate mount angles, outliers and weights
[iterations]. Chosen: a smaller number ends before they settle; with a larger one, the mean of a short film follows a
single marker, whose scatter becomes 0."""
MOST_ROUNDS = 60
"""Largest number of passes of the fusion [iterations]. Measured: in films whose frames are in step with eight periods
per turn, 5, 30 and 60 passes leave errors of 0.34, 0.13 and 0.12 mrad of this order; a larger number costs time."""
SETTLED = 2e-3
"""The fusion ends if the rms change of the errors of each marker, divided by its scatter, is below this value [1].
Chosen: a hundred such changes add 0.2 standard deviations; a smaller value costs time, a larger one ends before curves
and motion agree."""


def change_of_bias(before: Residuals, after: Residuals) -> float:
    """Return the largest rms change of the estimated errors of a marker, divided by its scatter [1]."""
    largest = 0.0
    for name in after.candidates:
        total, count = 0.0, 0
        for part in row_blocks(len(after.path)):
            used = after.weights.use[name][part]
            change = (after.bias(name, part) - before.bias(name, part))[used]
            total, count = total + float(change @ change), count + len(change)
        largest = max(largest, math.sqrt(total / max(count, 1)) / after.weights.scatter[name][0])
    return largest


@dataclass(frozen=True)
class MarkerAngles:
    """One marker: wrapped apparent angle, its uncertainty, mount angle [rad]; NaN where not used."""

    angle: Floats
    sigma: Floats
    mount: float


@dataclass(frozen=True)
class BodyAngles:
    """A body: unwrapped apparent angle, uncertainty [rad], number of markers; NaN without markers.

    `place_error` is the size of the position-dependent errors that were removed [rad] (see `place_error`). `axis_off`
    is the displacement of the axis from the assumed axis for each marker of a fast body, (x + i y) / radius, y up.
    """

    angle: Floats
    sigma: Floats
    count: Integers
    markers: dict[str, MarkerAngles]
    place_error: float = float("nan")
    # `slow`: standard uncertainty [rad] and correlation time [frames] of a slowly varying error. `periodic`: standard
    # deviation of the amplitudes of an error with one and two periods per turn [rad]. `harmonic`: standard deviation of
    # the amplitudes of an error of more periods per turn [rad]
    slow: tuple[float, float] = (0.0, 0.0)
    # middle [frames] of each part of the film and the uncertainty of the slowly varying error in it [rad], (parts, 2)
    slow_parts: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    periodic: float = 0.0
    harmonic: float = 0.0
    axis_off: dict[str, complex] = field(default_factory=dict)

    def spread_out(self, index: Integers, count: int) -> BodyAngles:
        """Place the frames at `index` of `count` frames; the other frames have no angle."""
        return self._changed(lambda values: spread_out(values, index, count))

    def at(self, index: Integers) -> BodyAngles:
        """Return the frames `index`."""
        return self._changed(lambda values: values[index])

    def _changed(self, change: Callable[[Any], Any]) -> BodyAngles:
        markers = {
            name: MarkerAngles(change(m.angle), change(m.sigma), m.mount) for name, m in self.markers.items()
        }
        own = {key: change(getattr(self, key)) for key in ("angle", "sigma", "count")}
        return replace(self, **own, markers=markers)


def join(
    coarse: Floats,
    candidates: dict[str, Candidate],
    fps: float,
    other: Floats | None = None,
    floor: float = 0.0,
    axis: float | Floats = 0.0,
    orbit: float | Floats = 0.0,
    *,
    arcs: dict[str, Floats] | None = None,
    above: bool = False,
    time_base: TimeBase | None = None,
) -> BodyAngles:
    """Combine the markers of one body; the first marker determines the zero of the angle.

    `coarse` (n,) is the unwrapped coarse apparent angle [rad], NaN where the body was lost. `other` is the coarse angle
    of the body that sometimes occludes the markers, or passes beneath them (`above`). `floor`, `axis` and `orbit` are
    uncertainties [rad]: of position-dependent errors, of the axis, and of the orbits relative to the axis. They are
    added in frames that are not within whole turns, because they do not appear as scatter there. If `errors_of_view`
    finds errors from differences between the markers, the uncertainty of these errors replaces `orbit`. `arcs` is
    explained there.
    """
    state, arcs = Residuals.of(coarse, candidates, fps, time_base), arcs or {}
    half, degree = learning_window(state.path)
    settled = False
    for number in range(MOST_ROUNDS):
        last, before = number == MOST_ROUNDS - 1 or (settled and number >= FEWEST_ROUNDS - 1), state
        if number < FEWEST_ROUNDS:
            short, leverage = state.smooth(HALF_WINDOW)
            state = replace(state, mounts=mount_angles(state, short))
            state = replace(state, weights=weights_about(state, short, leverage))
        smooth, _ = state.smooth(half, degree)
        if number < FEWEST_ROUNDS:
            state = replace(state, turning=turning_frames(state, short, smooth, half))
        state = replace(state, place=errors_by_place(state, smooth))
        state = replace(state, view=errors_of_view(state, floor, arcs))
        if other is not None:
            found = errors_by_neighbour(state, smooth, other, (half, degree), above=above, last=last)
            state = replace(state, neighbour=found)
        if last:
            break
        settled = change_of_bias(before, state) < SETTLED
    short, leverage = state.smooth(HALF_WINDOW)
    state = replace(state, weights=weights_about(state, short, leverage))
    state = replace(state, view=errors_of_view(state, floor, arcs))
    axis = np.hypot(axis, orbit if state.view is None else state.view.sigma)
    return _result(state, half, degree, floor, axis, ~(leverage <= UNCONFIRMED))


WEAKEST_BODY = 10.0
"""Uncertainty, relative to the median of neighbouring frames, above which the angle of a frame is discarded [1].
Chosen: such a frame shows a small part of one marker and has 1/100 of the information; errors at the occluding edge are
not normally distributed; a larger value admits such errors, a smaller one omits angles."""
_NEIGHBOURS = 101
"""Width of the running median of the uncertainty [frames]. Chosen: with a smaller number, the median rises while a hand
hides the markers; with a larger one, it does not follow a change of light."""
UNCONFIRMED = 0.9
"""A frame needs two markers if its leverage in the curve of the short window exceeds this value, because neighbouring
frames then do not confirm its angle [1]. Chosen: a smaller value omits frames next to gaps, a larger one admits wrong
matches."""


def _mostly_hidden(sigma: Floats) -> Bools:
    """Return a mask of the frames whose uncertainty exceeds `WEAKEST_BODY` times the median of neighbouring frames."""
    reach = min(_NEIGHBOURS // 2, len(sigma))
    # reflected at the ends, where a hand may hide the markers
    usual = median_smooth(np.pad(sigma, reach, mode="symmetric"), _NEIGHBOURS)[reach : reach + len(sigma)]
    with np.errstate(invalid="ignore"):
        return np.asarray(sigma > WEAKEST_BODY * usual)


def _result(
    state: Residuals,
    half: int,
    degree: int,
    floor: float,
    axis: float | Floats,
    alone: Bools,
) -> BodyAngles:
    smooth, leverage = state.smooth(half, degree)
    scatter, from_time = scatter_over_turns(state, smooth, leverage), state.time_sigma()
    if isinstance(from_time, np.ndarray):
        scatter = without_time_scatter(scatter, from_time)
    state = replace(state, weights=replace(state.weights, scatter=scatter))
    residual, sigma, count = state.mean()
    off = np.where(state.turning, np.nan, residual - smooth)
    absorbed = float(np.nansum(np.where(count > 0, np.minimum(leverage, 1.0), 0.0)))
    floor *= share_of_floor(off, sigma, floor, places_passed(state) - absorbed)
    # A video codec may keep a marker fixed in the picture although it moves a little. The share of variance is
    # therefore at least the share for a marker that moves over one `CELL`.
    least = variance_left(np.linspace(0.0, CELL, KNOTS), PLACE_ORDERS)
    floor *= float(np.sqrt(max(variance_left(state.path, PLACE_ORDERS), least)))
    unlearnt = np.where(state.turning, 0.0, np.hypot(floor, axis))
    of_error, of_residual = _variance_shares(state, max(4, round(absorbed)))

    def calibrated(residual: Floats, sigma: Floats, markers: int) -> Floats:
        """Scale uncertainties to the residuals about the smooth motion.

        The smooth motion absorbs a part of correlated errors. This part is the leverage times the correlation factor of
        the errors.
        """
        beside = np.hypot(unlearnt, from_time)
        off = np.where(state.turning, (residual - smooth) / np.hypot(sigma, beside), np.nan)
        alike = correlation_factor(np.nan_to_num(off))
        share = of_residual - (alike - 1.0) * leverage / markers
        off = off / np.sqrt(np.clip(share, 0.3, 1.0))
        scale = excess(off)
        return np.asarray(np.hypot(sigma * np.sqrt(of_error), beside) * scale * tail_factor(off / scale))

    hidden = _mostly_hidden(sigma) | (alone & (count == 1))
    angle, sigma = state.path + residual, calibrated(residual, sigma, 1)
    angle[hidden], sigma[hidden], count[hidden] = np.nan, np.nan, 0
    own = {"angle": angle, "sigma": sigma, "count": count}
    del residual
    angle, sigma, count = in_file(own).values()
    markers = {}
    for name, c in state.candidates.items():
        use = state.weights.use[name]
        own = {"angle": np.where(use, wrapped(c.angle - state.bias(name)), np.nan)}
        own["sigma"] = calibrated(
            np.where(use, state.residual(name), np.nan),
            np.where(use, state.sigma(name), np.nan),
            len(state.candidates),
        )
        markers[name] = MarkerAngles(mount=state.mounts[name], **in_file(own))
    return BodyAngles(
        angle, sigma, count, markers, place_error=place_error(state), axis_off=state.place.axis_off
    )
