"""Local polynomials, robust scatter, smooth motion on uniform and non-uniform time bases, angular velocities.

Angular velocities are computed as in the paper (V. Tanrıverdi and A. Erbasan, arXiv:2605.06700). The angles are
smoothed by a running median over 51 points, and their central differences by a second running median. The first and
last 50 points are omitted.

On a non-uniform time base, the path of a body is a fit of local parabolas in time to the coarse angles. The residuals
of a marker from this path are small, so each residual is assigned to the nearest point of a uniform grid and smoothed
there together with the path.
"""

from __future__ import annotations

from functools import cache, cached_property
from math import erfc, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from gyrotrack._column_store import row_blocks
from gyrotrack._native import _kernels as kernels

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

WIDTH = 51  # points of the paper's running medians
# half width of the window in which a parabola approximates the motion of a body [frames]
HALF_WINDOW = 20
FAR = 6.0  # largest deviation of an inlier [standard deviations]
FEWEST = 8  # smallest number of residuals for an estimate of their scatter
_MIN_PATH = 6  # smallest number of known angles for a path
_SIGNIFICANT = 3.5  # smallest significant correlation [standard deviations]
_MIN_NU, _MAX_NU = 5.0, 1e3
# degrees of freedom of an uncertainty that was taken from other bodies (relative uncertainty about 1/3)
BORROWED_NU = 4.0
_BLOCK = 1024
_MANY = 200_000  # number of points above which a faster running quantile saves time despite its slow import
_MIN_JITTER_SHARE = 0.5
_MAX_SHARE_SIGMA = 0.2


def local_fit(
    value: Floats, weight: Floats, half: int, degree: int = 2, hole: int = -1
) -> tuple[Floats, Floats]:
    """Fit a polynomial about every point of a uniformly sampled series, over `half` points to both sides.

    The weights are 1 - (x/(half + 1))^2 times the weights of the points. A missing value, which may be NaN, has the
    weight 0. Points up to the distance `hole` from a point are excluded, so that points farther away predict it. The
    results are the fitted values and, for each point, its weight in its own fitted value. Both are NaN if the window
    contains too few points.
    """
    n = len(value)
    smooth, leverage = np.empty(n), np.empty(n)
    for part in row_blocks(n):  # in blocks, because a fit stores dozens of numbers per point
        around = slice(max(part.start - half, 0), min(part.stop + half, n))
        beyond = (half - (part.start - around.start), half - (around.stop - part.stop))
        padded = np.pad(value[around], beyond), np.pad(weight[around], beyond)
        kernels.local_polynomials(*padded, half, degree, hole, smooth[part], leverage[part])
    return smooth, leverage


def spread(residual: Floats) -> float:
    """Return the robust standard deviation of a sample about zero, 1.4826 times its median absolute value."""
    known = residual[np.isfinite(residual)]
    return 1.4826 * median_of(np.abs(known)) if len(known) else float("nan")


def median_of(values: Floats) -> float:
    """Return the median of numbers without NaN; faster than `np.median` for short arrays."""
    ranks = (values.size - 1) // 2, values.size // 2
    ordered = np.partition(values, ranks, axis=None)
    return float(0.5 * (ordered[ranks[0]] + ordered[ranks[1]]))


def core_scatter(off: Floats, otherwise: float) -> float:
    """Return the robust standard deviation of residuals; `otherwise` for too few residuals."""
    return max(spread(off), 1e-5) if np.isfinite(off).sum() >= FEWEST else otherwise


def excess(off: Floats) -> float:
    """Return the rms of normalised residuals clipped at `FAR`, limited to 0.5 to 3; 1 for too few residuals."""
    known = off[np.isfinite(off)]
    if len(known) < FEWEST:
        return 1.0
    limit = FAR * core_scatter(known, 1.0)
    return float(np.clip(np.sqrt(np.mean(np.minimum(known**2, limit**2))), 0.5, 3.0))


def tail_factor(off: Floats) -> Floats:
    """Return the factor by which each residual increases its own uncertainty if the distribution has long tails, (n,).

    The noise is normal with an inverse-gamma distributed variance in each frame. Residuals, here of unit root mean
    square, then follow Student's t distribution with nu degrees of freedom, and their excess kurtosis is 6 / (nu - 4).
    Given a residual of r standard deviations, the expected variance divided by the mean variance is (nu - 2 + r^2) /
    (nu - 1). The factor is 1 where the residual is NaN.

    Examples
    --------
    >>> tail_factor(np.array([-1.0, 1.0] * 50)).round(3).max()
    np.float64(1.0)
    """
    known = np.minimum(np.abs(off[np.isfinite(off)]), FAR)
    if len(known) < FEWEST:
        return np.ones(len(off))
    kurtosis = float(np.mean(known**4) / max(np.mean(known**2), 1e-12) ** 2 - 3.0)
    nu = float(np.clip(4.0 + 6.0 / max(kurtosis, 1e-6), _MIN_NU, _MAX_NU))
    return np.asarray(np.where(np.isfinite(off), np.sqrt((nu - 2.0 + off**2) / (nu - 1.0)), 1.0))


def correlation_factor(residual: Floats) -> float:
    """Return the factor by which correlation increases the variance of a mean: 1 + 2 times the sum of autocorrelations.

    The sum is truncated at the first pair of lags with a sum that is not positive (Geyer's initial sequence). A factor
    within 3.5 sigma of 1, the value for independent samples, is replaced by 1.
    """
    size = len(residual)
    power = np.abs(np.fft.rfft(residual - residual.mean(), 2 * size))
    power **= 2
    autocovariance = np.fft.irfft(power)[:size].copy()
    if autocovariance[0] <= 0:
        return 1.0
    rho = autocovariance[1:] / autocovariance[0]
    pairs = rho[: len(rho) // 2 * 2].reshape(-1, 2).sum(axis=1)
    positive = int(np.argmax(pairs <= 0)) if (pairs <= 0).any() else len(pairs)
    factor = 1 + 2 * float(pairs[:positive].sum())
    return factor if factor > 1 + 2 * _SIGNIFICANT / np.sqrt(size) else 1.0


def share_of_floor(off: Floats, sigma: Floats, floor: float, places: float) -> float:
    """Return the fraction, 0 to 1, of the expected repeatable errors that the residuals of a body confirm.

    Errors that repeat with the angle appear in the residuals `off` from the smooth motion (NaN without a residual).
    `sigma` is the uncertainty of the residuals without such errors, and `floor` the expected standard deviation of
    these errors [rad]. The residuals and the expected value are two estimates of one variance, each with its degrees
    of freedom. `places` is the number of independent repeatable errors on the arc, less the number that the smooth
    motion can absorb. Larger residuals may be motion and do not increase the fraction above 1.
    """
    known = np.isfinite(off) & np.isfinite(sigma)
    if known.sum() < FEWEST or floor <= 0.0 or places <= 0.0:
        return 1.0
    own = np.minimum(np.abs(off[known]), FAR * np.hypot(sigma[known], floor))
    seen = max(float(np.mean(own**2) - np.mean(sigma[known] ** 2)), 0.0)
    return float(np.sqrt(min((BORROWED_NU + places * seen / floor**2) / (BORROWED_NU + places), 1.0)))


def smooth_path(coarse: Floats) -> Floats:
    """Smooth a coarse path by local parabolas; values more than 0.3 rad from the smooth path remain unchanged."""
    known = np.isfinite(coarse)
    if known.sum() < FEWEST:
        return coarse
    trend = line_through(coarse)
    smooth, _ = local_fit(coarse - trend, known.astype(float), HALF_WINDOW)
    near = np.abs(smooth + trend - coarse) < 0.3
    return np.where(known, np.where(near, smooth + trend, coarse), np.nan)


def learning_window(path: Floats) -> tuple[int, int]:
    """Return half width and degree of the local polynomials for the estimate of repeatable errors.

    The window extends 1.2 turns to each side, so that errors that repeat with the turn average out. The window has a
    minimum length, because such errors vary slowly if the ratio of rotation rate to frame rate is close to a rational
    number.
    """
    step = np.abs(np.diff(path))
    step = step[np.isfinite(step)]
    typical = float(np.median(step)) if len(step) else 0.0
    half = int(np.clip(1.2 * 2.0 * np.pi / max(typical, 1e-3), 3 * HALF_WINDOW, 6 * HALF_WINDOW))
    return half, 3


def whole_turns(path: Floats, half: int) -> Mask:
    """Return a mask of frames with a whole turn within `half` frames to both sides; all False below two turns."""
    known = path[np.isfinite(path)]
    if len(known) == 0 or np.ptp(known) < 4.0 * np.pi:
        return np.zeros(len(path), dtype=np.bool_)
    ahead, behind = np.roll(path, -half), np.roll(path, half)
    swept = np.abs(ahead - behind)
    swept[:half] = 2.0 * np.abs(ahead - path)[:half]
    swept[len(path) - half :] = 2.0 * np.abs(path - behind)[len(path) - half :]
    return np.asarray(np.nan_to_num(swept) > 2.0 * np.pi)


def line_through(path: Floats) -> Floats:
    """Return the values of a straight line fitted to a path."""
    known = np.isfinite(path)
    if known.sum() < 2:
        return np.zeros(len(path))
    index = np.arange(len(path), dtype=np.float64)
    return np.asarray(np.polyval(np.polyfit(index[known], path[known], 1), index))


def median_smooth(x: npt.ArrayLike, width: int = WIDTH) -> Floats:
    """Return the running median over an odd number of points; the end values are repeated, and NaN values stay NaN."""
    if width < 1 or width % 2 == 0:
        raise ValueError(f"the width of a median must be odd and positive, not {width}")
    series = np.asarray(x, dtype=float)
    smooth = np.full_like(series, np.nan)
    known = np.isfinite(series)
    if known.any():
        smooth[known] = running_quantile(series[known], width, width // 2)
    return smooth


def running_quantile(x: npt.NDArray[Any], width: int, rank: int) -> npt.NDArray[Any]:
    """Return the value of a `rank` (from 0) in a running window of `width` (odd) points; the ends are repeated."""
    if len(x) and x.min() == x.max():
        return x.copy()
    if len(x) > _MANY and np.isfinite(x).all():
        from scipy.ndimage import rank_filter  # four times as fast, but its import takes 0.2 s

        return np.asarray(rank_filter(x, rank, size=width, mode="nearest"))
    around = sliding_window_view(np.pad(x, width // 2, mode="edge"), width)
    out = np.empty_like(x)
    for part in row_blocks(len(x)):
        out[part] = np.partition(around[part], rank, axis=1)[:, rank]
    return out


def angular_velocity(
    time: npt.ArrayLike, angle: npt.ArrayLike, sigma: npt.ArrayLike, width: int = WIDTH
) -> tuple[Floats, Floats]:
    """Return the angular velocity of a record without large gaps, smoothed as in the paper, and its uncertainty.

    The uncertainty [rad s-1] is computed for a running median of n central differences d_i = (x_{i+1} - x_{i-1}) / 2 dt
    with a linear trend. The variance is N / D^2, where D is the sum of the densities of d_i at the median, and N is the
    sum of the covariances of the events d_i < median. d_i and d_{i+2} have one angle in common, and therefore the
    correlation -1/2. Without trend, the variance is (pi / 6 n) var(d). The noise of the unwrapped angles [rad] must be
    independent. The first and last ``width - 1`` points are NaN.
    """
    t, x, s = (np.asarray(a, dtype=float) for a in (time, angle, sigma))
    omega, omega_sigma = np.full_like(t, np.nan), np.full_like(t, np.nan)
    margin = width - 1
    if len(t) <= 2 * margin:
        return omega, omega_sigma
    smooth = median_smooth(x, width)
    raw = np.full_like(t, np.nan)
    span = t[2:] - t[:-2]
    raw[1:-1] = (smooth[2:] - smooth[:-2]) / span
    raw_sigma = np.full_like(t, np.nan)
    raw_sigma[1:-1] = np.hypot(s[2:], s[:-2]) / span
    inner = slice(margin, len(t) - margin)
    omega[inner] = median_smooth(raw, width)[inner]
    trend = np.gradient(omega[inner]) if len(omega[inner]) > 1 else np.zeros(1)
    omega_sigma[inner] = _median_sigma(
        median_smooth(raw_sigma, width)[inner], median_smooth(trend, width), width
    )
    return omega, omega_sigma


def smoothing_width(angle: npt.ArrayLike, sigma: npt.ArrayLike, most: int = WIDTH) -> int:
    """Return the width of running medians (odd, 3 to `most` points) that do not change the motion of a body.

    For a body that turns in one sense the result is `most`. For a body that turns back, for example a pendulum, a
    median over a large part of the period would remove the motion. The width is therefore halved until the smoothed
    angle differs by less than 2 % of the motion, rms, or less than two standard uncertainties.
    """
    x, s = np.asarray(angle, dtype=float), np.asarray(sigma, dtype=float)
    if len(x) <= 2 * most:
        return most
    noise, motion = float(np.nanmedian(s)), float(np.std(x))
    rough = median_smooth(x, 5)[::2]
    if motion < 5 * noise or abs(x[-1] - x[0]) > 0.6 * float(np.abs(np.diff(rough)).sum()):
        return most
    width = most
    while width > 3:
        removed = (median_smooth(x, width) - x)[width:-width]
        if float(np.sqrt(np.mean(removed**2))) < max(0.02 * motion, 2 * noise):
            break
        width = max(3, (width // 2) | 1)
    return width


def _median_sigma(sigma: Floats, trend: Floats, width: int) -> Floats:
    """Return the uncertainty of a median of `width` central differences with a linear trend."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.abs(trend / sigma)
    return sigma * np.where(np.isfinite(ratio), np.interp(ratio, *_median_table(width)), np.nan)


@cache
def _median_table(width: int) -> tuple[Floats, Floats]:
    """Return the sigma of a median as a function of the trend, both in units of the sigma of one difference.

    Linear interpolation has a relative error below 1e-5; for a trend above 8, only the middle difference has
    influence.
    """
    trend = 8.0 * np.linspace(0.0, 1.0, 8001) ** 2
    half = width // 2
    grid = np.linspace(-8.0, 8.0, 4001)
    table = np.array([0.5 * erfc(-x / sqrt(2.0)) for x in grid])
    made = np.empty_like(trend)
    for start in range(0, len(trend), 512):  # in blocks, to limit memory
        part = slice(start, start + 512)
        u = np.outer(trend[part], np.arange(-half, half + 1))
        p, density = np.interp(u, grid, table), np.exp(-(u**2) / 2) / np.sqrt(2 * np.pi)
        a, b = u[:, 2:], u[:, :-2]
        # tetrachoric series for the correlation -1/2
        series = -1 / 2 + a * b / 8 - (a**2 - 1) * (b**2 - 1) / 48
        shared = 2 * np.sum(series * density[:, 2:] * density[:, :-2], axis=1)
        variance = np.sum(p * (1 - p), axis=1) + shared
        made[part] = np.sqrt(variance) / np.sum(density, axis=1)
    return trend, made


class TimeBase:
    """Times `place` (n,) of frames, with independent errors of standard deviation `sigma`, both in frame periods."""

    def __init__(self, place: Floats, sigma: float = 0.0) -> None:
        self.place = place - place[0]
        self.sigma = sigma

    @cached_property
    def _slot(self) -> Integers:
        return np.asarray(np.rint(self.place), dtype=np.int64)

    def path(self, coarse: Floats) -> tuple[Floats, Floats]:
        """Return a smoothed coarse path [rad], at the frames (n,), NaN where unknown, and on the uniform grid."""
        known = np.isfinite(coarse)
        if known.sum() < _MIN_PATH:
            return coarse, np.zeros(int(self._slot[-1]) + 1)
        from scipy.interpolate import CubicHermiteSpline

        place = self.place[known]
        value, slope = local_parabola(place, coarse[known])
        near = np.abs(value - coarse[known]) < 0.3
        path = np.full(len(coarse), np.nan)
        path[known] = np.where(near, value, coarse[known])
        even = np.clip(np.arange(int(self._slot[-1]) + 1, dtype=np.float64), place[0], place[-1])
        return path, np.asarray(CubicHermiteSpline(place, value, slope)(even))

    def speed(self, path: Floats) -> Floats:
        """Return the change of a path per period, (n,); NaN where the path is unknown."""
        known = np.isfinite(path)
        out = np.full(len(path), np.nan)
        if known.sum() > 1:
            out[known] = np.gradient(path[known], self.place[known])
        return out

    def smooth(
        self, off: Floats, weight: Floats, bend: Floats, half: int, degree: int
    ) -> tuple[Floats, Floats]:
        """Fit polynomials in time to residuals about a path; return their values and leverages at the frames.

        `off` are residuals [rad], and `weight` are their weights, 0 for a missing residual. `bend` is the path on the
        uniform grid, less a straight line [rad]. `half` [periods] and `degree` have the same meaning as for
        `local_fit`.
        """
        total = np.bincount(self._slot, weight, len(bend)).astype(np.float64)
        clean = np.where(weight > 0.0, off, 0.0) * weight
        mean = np.bincount(self._slot, clean, len(bend)) / np.where(total > 0.0, total, 1.0)
        fitted, leverage = local_fit(mean + bend, total, half, degree)
        fitted = np.interp(self.place, np.arange(len(bend)), fitted - bend)
        return fitted, leverage[self._slot]


def local_parabola(place: Floats, value: Floats) -> tuple[Floats, Floats]:
    """Fit a parabola about every point of a non-uniform series; return the values and slopes at the points, (n,)."""
    half = HALF_WINDOW
    out = np.empty((2, len(place)))
    reach = np.arange(-half, half + 1)
    bell = 1.0 - (reach / (half + 1.0)) ** 2
    for start in range(0, len(place), _BLOCK):
        i = np.arange(start, min(start + _BLOCK, len(place)))
        j = i[:, None] + reach
        weight = np.where((j >= 0) & (j < len(place)), bell, 0.0)
        j = np.clip(j, 0, len(place) - 1)
        x, y = (place[j] - place[i, None]) / half, value[j] - value[i, None]
        powers = np.stack([np.ones_like(x), x, x * x], axis=1)
        matrix = (powers * weight[:, None]) @ powers.transpose(0, 2, 1) + 1e-9 * np.eye(3)
        right = (powers * (weight * y)[:, None]).sum(axis=2)
        found = np.linalg.solve(matrix, right[:, :, None])[:, :, 0]
        out[0, i], out[1, i] = value[i] + found[:, 0], found[:, 1] / half
    return out[0], out[1]


def jitter_is_real(place: Floats, smooth: Floats, angle: Floats) -> bool:
    """Return whether the jitter of the timestamps is real, which is the case if the angle [rad] follows the jitter.

    `smooth` are the times of the frames `place` without jitter. The residual of an angle from a parabola in the smooth
    times is b w (place - smooth), with w the angular rate. The least-squares estimate of b is close to 1 if the
    exposure was late, and close to 0 if only the timestamp was late. If the standard uncertainty of b exceeds 0.2, the
    timestamps are used.
    """
    known = np.isfinite(angle)
    if known.sum() < 2 * HALF_WINDOW:
        return True
    value, slope = local_parabola(smooth[known], angle[known])
    late = place[known] - smooth[known]
    late = slope * (late - local_parabola(smooth[known], late)[0])
    off = angle[known] - value
    core = np.abs(off) < FAR * 1.4826 * median_of(np.abs(off)) + 1e-9
    power = float(np.sum(late[core] ** 2))
    share = float(np.sum(late[core] * off[core])) / max(power, 1e-30)
    scatter = float(np.std(off[core] - share * late[core]))
    return scatter / np.sqrt(max(power, 1e-30)) > _MAX_SHARE_SIGMA or share > _MIN_JITTER_SHARE
