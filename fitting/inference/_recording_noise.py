"""Noise of a recording beyond the white noise of its frames, estimated once and used for every fit.

Neither a model nor a moment of inertia enters: the motion is described by polynomials in each of a few stretches of
time, with the camera's nuisance functions free, and the restricted likelihood of what is orthogonal to them (H.
Patterson, R. Thompson, Biometrika 58, 545 (1971)) decides. A slow torque, fitted or missing, is part of the
polynomials.

Correlated angle noise. Tracking errors are not white: a hub that is estimated from neighbouring frames, a hand-held
camera or a codec move the measured angle for a time. The angle noise of a run has the covariance

    cov[n(t), n(t')] = a^2 exp(-|t - t'| / T),

an Ornstein-Uhlenbeck process of standard deviation a and correlation time T. Projected rows with unit white noise have

    C = 1 + a^2 (P R P' - f 1) + s^2 K,

P the projection, f the mean of P R P' in the band in which the white noise is measured (it is not counted twice), K the
response to a random acceleration of rms s. a maximises the likelihood with process noise of any level and correlation
time integrated out; angle noise is included if twice the log-likelihood ratio exceeds `Criteria.correlated_noise`. Rows
that are slower than T see only a^2 T, faster ones only a^2 / T, so that T is known much less well than the noise of
either: the covariance that every fit uses is the mean over the posterior of a and T, with priors uniform in ln a and ln
T, which adds their uncertainty to that of all parameters.

In a short record the two may fit equally well. Then process noise is accepted as long as its torque is smaller than the
mean torque on the body; a random torque larger than the one that slows the body is not credible, and the deviations are
angle noise.

Where a block holds few turns, what repeats with the turn is seen in its rows: a hub that is displaced or a tilted
camera (nuisance functions of every fit), and, if the camera or the hub moves slowly, harmonics whose amplitude wanders,

    cov[n(t), n(t')] = b^2 cos(psi - psi') exp(-|t - t'| / T).

It is included, instead of the noise above or with it, by the same likelihood. In longer blocks it is orthogonal to the
polynomials.

The windows of the rotor are estimated together, (a, T) of one camera, given the process noise of the casing.

Process noise. A random acceleration of the casing, an Ornstein-Uhlenbeck process of rms s [rad/s2] and correlation time
T. Level and time are the posterior means of s and ln T; no test decides whether there is process noise. The prior of s
at a given T is the positive half of a Student distribution with three degrees of freedom; its scale is the camera's
resolution, the spectral density 2 s^2 T of an acceleration that is white for the rows and as large as their noise in
half of them. So the level is never zero, and where the data contain no process noise it is a small part of that
resolution. A random torque is not expected to exceed the mean torque that slows the body: the scale is at most the mean
acceleration, which matters in records of a second or two. The prior of T is uniform in ln T from a thirty-second of a
block, within which the noise is white for the rows, to three blocks, a twentieth of a long record. A stretch with a
kink or a jump is far noisier than the others: the likelihood of a stretch is a mixture, with a share of a twentieth for
a level of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import DEFAULT
from fitting.inference._compression import NOISE_ROWS, Compressed

Array = NDArray[np.float64]

# standard deviation of the prior of what is free, far beyond any angle [rad] or speed [rad/s]
FREE = 1e6

_SIGNIFICANT = DEFAULT.correlated_noise
_STRETCHES = 6
_BINS = 128
# correlation times in lengths of a block, levels in units of the white noise of the rows
_TIMES = (1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0, 2.0)
_LEVELS = np.geomspace(0.3, 300.0, 13)
# half width of the parabola at the most likely level, in its logarithm
_NEAR = 0.3
_SCREENED = (2, 5, 8)
_TORQUES = np.concatenate([[0.0], np.geomspace(0.1, 1e5, 31)])
_TORQUE_TIMES = (0.1, 0.3, 1.0)
_CELLS_PER_ROW = 2.5

_DEGREE = 11
# of a window of one block; what a smooth torque adds falls by an order of magnitude or two with each degree
_DEGREE_OF_WINDOW = 5
# blocks of a stretch, and degree, where a stretch holds several periods of an oscillation
_SHORT, _MANY = 4, 14
# rows of the longest stretch
_LONGEST = 170
# twice the logarithm of a likelihood ratio that is no contradiction
_ALLOWED = 6.0
# stretches up to which none may have a level of its own
_FEW = 2
# of a window: groups of samples a block, fewest samples in one, fewest groups; correlation times, up to a third of a
# block, as slower noise is a part of the polynomial
_GROUPS, _LEAST_IN_GROUP, _FEWEST_GROUPS = 128, 4, 40
_WINDOW_TIMES, _SHORTEST, _LONGEST_TIME = 15, 64.0, 3.0
# variance of angle noise over that of the white noise of a group
_RATIOS = np.geomspace(1e-3, 1e6, 91)
_NEGLIGIBLE_SHARE = 1e-4
_RANK = 1e-7
_MEDIAN_CHI2, _THIRD_DIFFERENCE, _TINY = 0.4549, 20.0, 1e-300
# of the level of angle noise: standard deviation of its logarithm beyond which the data hardly determine it
_WIDEST = 0.7
# noise that repeats with the turn: turns a block that rows resolve, correlation times, bins of all blocks
_TURNS_PER_BLOCK, _TURN_TIMES, _FEWEST_BINS, _ALL_BINS = 3.0, 5, 24, 1500
# two kinds of angle noise at once: levels over the most likely ones of each kind alone
_LOWER_LEVELS, _NEAR_LEVELS = (0.1, 0.2, 0.4, 0.8), (0.5, 0.7, 1.0, 1.4, 2.0)
_PROCESS_TIMES = (1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0, 2.0, 3.0)
_PROCESS_LEVELS = np.geomspace(1e-4, 1e6, 121)
_FINER = 16
_OWN_LEVEL = 0.05
_FREEDOM = 3
_NEGLIGIBLE = 1e-25
_LEAST = 1e-3
_WEIGHTY = 1e-4
_BINNED = 60


@dataclass(frozen=True)
class AngleNoise:
    """Correlated angle noise of the casing, or of the rotor's windows.

    Attributes
    ----------
    sigma, sigma_u : float
        Standard deviation a and its standard uncertainty [rad]; 0 if it is not significant.
    time, time_u : float
        Correlation time T and its standard uncertainty [s].
    turn_sigma, turn_sigma_u : float
        Standard deviation b of what repeats with the turn, and its standard uncertainty [rad]; 0 if not significant.
    turn_time : float
        Time in which it changes [s].
    gain : float
        Twice the logarithm of the likelihood ratio of this noise against white noise.
    root, inverse : ndarray, shape (rows, rows)
        C^(1/2) and C^(-1/2) of the polynomial rows, or empty for white noise.
    """

    sigma: float = 0.0
    sigma_u: float = 0.0
    time: float = 0.0
    time_u: float = 0.0
    turn_sigma: float = 0.0
    turn_sigma_u: float = 0.0
    turn_time: float = 0.0
    gain: float = 0.0
    root: Array = field(default_factory=lambda: np.zeros((0, 0)), repr=False)
    inverse: Array = field(default_factory=lambda: np.zeros((0, 0)), repr=False)

    @property
    def is_white(self) -> bool:
        """Whether no correlated noise is significant."""
        return self.sigma == 0 and self.turn_sigma == 0


def estimate_angle_noise(run: Compressed, nuisance: Array) -> AngleNoise:
    """Estimate the correlated angle noise of a run.

    Parameters
    ----------
    run : Compressed
        Projected angles.
    nuisance : ndarray, shape (rows, columns)
        Polynomial rows of the nuisance functions, at one standard deviation of their prior.

    Returns
    -------
    AngleNoise
        White (`sigma` = 0) if no correlated noise is significant.
    """
    stretches = stretches_of(run, nuisance)
    block = float(np.ptp(run.samples.time)) / len(run.lift)
    torque_times = [block * t for t in _TORQUE_TIMES]
    if not all(len(s.seen) for s in stretches):
        return AngleNoise()  # the nuisance parameters describe all of a short recording
    white = sum(s.likelihood(None, ())[0] for s in stretches)
    process = _with_process_noise(stretches, None, torque_times)
    largest = max(s.likelihood(None, [s.torque(t) for t in torque_times])[1] for s in stretches)
    credible = largest < mean_acceleration(run)
    reference = process if credible else white

    def gain(covariance: Array) -> float:
        if credible:
            return 2 * (_with_process_noise(stretches, covariance, torque_times) - reference)
        return 2 * (sum(s.likelihood(covariance, ())[0] for s in stretches) - reference)

    times = block * np.array(_TIMES)
    covariances = [_covariance(run, t) for t in times]
    units = [_unit(k) for k in covariances]
    turning = abs(float(np.ptp(run.samples.value))) / (2 * np.pi * len(run.lift)) < _TURNS_PER_BLOCK
    screened = [
        [gain((u * _LEVELS[j]) ** 2 * k) for j in _SCREENED] for u, k in zip(units, covariances, strict=True)
    ]
    if np.max(screened) < 0.25 * _SIGNIFICANT and not turning:
        return AngleNoise(gain=float(np.max(screened)))
    peaks = [
        _peak(lambda x, u=u, k=k: gain((u * x) ** 2 * k))  # type: ignore[misc]
        for u, k in zip(units, covariances, strict=True)
    ]
    least = max(_SIGNIFICANT, 0.0 if credible else 2 * (process - white) - _SIGNIFICANT)
    steady = _Component(times, covariances, units, peaks)
    if turning:
        span = float(np.ptp(run.samples.time))
        slow = np.geomspace(block, 2 * span, _TURN_TIMES)
        repeating = _turn_covariances(run, slow)
        own = [_unit(k) for k in repeating]
        turn = _Component(
            slow,
            repeating,
            own,
            [
                _peak(lambda x, u=u, k=k: gain((u * x) ** 2 * k))  # type: ignore[misc]
                for u, k in zip(own, repeating, strict=True)
            ],
        )
        found = _with_turn(steady, turn, gain)
        if found is not None:
            return found if found.gain >= least else AngleNoise(gain=found.gain)
    if steady.best < least:
        return AngleNoise(gain=steady.best)
    fine, levels, spreads, weights = _fine_posterior(times, units, peaks)
    # mean of the square of a log-normal level
    squares = levels**2 * np.exp(2 * np.minimum(spreads, _WIDEST) ** 2)
    shares = np.stack([np.interp(np.log(fine), np.log(times), row) for row in np.eye(len(times))])
    total = np.eye(len(covariances[0]))
    for share, covariance in zip(shares @ (weights * squares), covariances, strict=True):
        total += share * covariance
    return _angle_noise(
        np.tile(fine, 2), _both_sides(levels, spreads), np.tile(weights / 2, 2), steady.best, [total]
    )


class _Component(NamedTuple):
    """Angle noise of one kind: correlation times [s], covariances of rows, units of the levels [rad], best levels."""

    times: Array
    covariances: list[Array]
    units: list[float]
    peaks: list[_Peak]

    @property
    def best(self) -> float:
        """The largest gain."""
        return max(p.gain for p in self.peaks)

    def points(self, factors: Sequence[float], least: float = math.inf) -> list[tuple[float, float, Array]]:
        """Return time, level and covariance at factors of the most likely level of each time."""
        return [
            (float(t), f * p.level * unit, k)
            for t, k, unit, p in zip(self.times, self.covariances, self.units, self.peaks, strict=True)
            for f in factors
            if p.gain > self.best - least
        ]


def _with_turn(steady: _Component, turn: _Component, gain: Callable[[Array], float]) -> AngleNoise | None:
    """Return the angle noise with a part that repeats with the turn; None where the other kind alone is as likely.

    A second kind needs a likelihood ratio of its own.
    """
    alone = [
        (steady.times[0], 0.0, steady.covariances[0], s, b, r)
        for s, b, r in turn.points(_NEAR_LEVELS, _ALLOWED)
    ]
    both = [
        (t, a, k, s, b, r)
        for t, a, k in steady.points(_LOWER_LEVELS)
        for s, b, r in turn.points(_NEAR_LEVELS, _ALLOWED)
    ]
    points = alone + both
    log = 0.5 * np.array([gain(a**2 * k + b**2 * r) for _, a, k, _, b, r in points])
    best = 2 * float(log.max())
    if best - _SIGNIFICANT * (int(np.argmax(log)) >= len(alone)) <= steady.best:
        return None
    # the second kind is as probable as none, before the data
    weights = np.exp(log - log.max()) / np.repeat([len(alone), len(both)], [len(alone), len(both)])
    weights /= weights.sum()
    total = np.eye(len(points[0][2]))
    for w, (_, a, k, _, b, r) in zip(weights, points, strict=True):
        total += w * (a**2 * k + b**2 * r)
    times, levels, _, slow, turns, _ = (list(c) for c in zip(*points, strict=True))
    found = _angle_noise(np.array(times), np.array(levels), weights, best, [total])
    amplitudes = np.array(turns)
    return replace(
        found,
        turn_sigma=float(np.sqrt(weights @ amplitudes**2)),
        turn_sigma_u=float(np.sqrt(weights @ (amplitudes - weights @ amplitudes) ** 2)),
        turn_time=float(np.exp(weights @ np.log(slow))),
    )


def _unit(covariance: Array) -> float:
    """Return the level at which half of the rows have as much of a noise as white noise."""
    return 1 / float(np.sqrt(np.median(np.diag(covariance)) + 1e-300))


def _fine_posterior(
    times: Array, units: Sequence[float], peaks: Sequence[_Peak]
) -> tuple[Array, Array, Array, Array]:
    """Return correlation times [s], levels [rad] and relative uncertainties at each, and the probability of each time.

    The prior is uniform in the logarithms of time and level; the integral over the level is that of a normal
    distribution in its logarithm. Between the times of the grid gain and level are interpolated by cubic splines.
    """
    from scipy.interpolate import CubicSpline

    x = np.log(times)
    fine = np.linspace(x[0], x[-1], _FINER * (len(x) - 1) + 1)
    gain = CubicSpline(x, [p.gain for p in peaks])(fine)
    level = CubicSpline(x, np.log([p.level * u for p, u in zip(peaks, units, strict=True)]))(fine)
    spread = np.interp(fine, x, [p.relative_u for p in peaks])
    weights = np.exp(0.5 * (gain - gain.max())) * spread
    return np.exp(fine), np.exp(level), spread, weights / weights.sum()


def _both_sides(levels: Array, spreads: Array) -> Array:
    """Return two levels for each, one standard deviation below and above."""
    change = np.exp(np.minimum(spreads, _WIDEST))
    return np.concatenate([levels / change, levels * change])


def _angle_noise(
    times: Array, levels: Array, weights: Array, gain: float, covariances: Sequence[Array]
) -> AngleNoise:
    """Return the angle noise of a posterior distribution, with the covariances of rows averaged over it.

    The mean covariance contains the uncertainty of level and time (law of total variance).
    """
    time = float(weights @ np.log(times))
    time_u = float(np.sqrt(weights @ (np.log(times) - time) ** 2))
    sigma = float(np.sqrt(weights @ levels**2))
    sigma_u = float(np.sqrt(weights @ (levels - weights @ levels) ** 2))
    root, inverse = (np.zeros((sum(len(c) for c in covariances),) * 2) for _ in range(2))
    first = 0
    for c in covariances:
        own = slice(first, first + len(c))
        root[own, own], inverse[own, own] = _roots(c)
        first += len(c)
    return AngleNoise(
        sigma, sigma_u, math.exp(time), math.exp(time) * time_u, gain=gain, root=root, inverse=inverse
    )


class _Peak(NamedTuple):
    """The most likely level of a noise of one correlation time: level, relative standard uncertainty, gain there."""

    level: float
    relative_u: float
    gain: float


def _peak(gain: Callable[[float], float]) -> _Peak:
    """Return the level of the largest gain, from a grid and from parabolas in the logarithm of the level."""
    x = np.log(_LEVELS[::2])
    y = [gain(float(np.exp(v))) for v in x]
    top = int(np.clip(np.argmax(y), 1, len(x) - 2))
    at, value, bend = x[top], y[top], 0.0
    for half in (x[1] - x[0], _NEAR, _NEAR):
        low, high = gain(float(np.exp(at - half))), gain(float(np.exp(at + half)))
        bend = (low - 2 * value + high) / half**2
        slope = (high - low) / (2 * half)
        step = -slope / bend if bend < 0 else math.copysign(half, slope)
        at += float(np.clip(step, -half, half))
        value = gain(float(np.exp(at)))
    return _Peak(float(np.exp(at)), math.sqrt(-2 / bend) if bend < 0 else 1.0, float(value))


def _roots(covariance: Array) -> tuple[Array, Array]:
    """Return C^(1/2) and C^(-1/2)."""
    values, vectors = np.linalg.eigh(covariance)
    return (vectors * np.sqrt(values)) @ vectors.T, (vectors / np.sqrt(values)) @ vectors.T


def estimate_window_noise(
    windows: Sequence[Compressed], nuisance: Sequence[Array], level: float, time: float
) -> AngleNoise:
    """Estimate the correlated angle noise that all windows of the rotor have in common.

    The few rows that a model sees hardly determine a correlation time. So the means of groups of samples are compared,
    many in each window, beyond a polynomial and the nuisance functions: white noise of variance s^2 sigma^2 and angle
    noise of variance rho s^2 and time T. s is integrated out with the prior 1 / s,

        log L = -1/2 [log det V + n log(r'V^-1 r)],   V = 1 + rho R_T + process noise,

    and the covariance of the rows is the mean over the posterior of s, rho and T, with priors uniform in ln rho and
    ln T. A window is too short to separate angle noise from process noise, whose level is that of the casing.

    Parameters
    ----------
    windows : sequence of Compressed
        Projected angles of each window.
    nuisance : sequence of ndarray, shape (samples, columns)
        Functions that the camera adds, at the samples of each window.
    level : float
        Rms of the random acceleration of the rotor [rad/s2].
    time : float
        Its correlation time [s].

    Returns
    -------
    AngleNoise
        Of the rows of all windows; white (`sigma` = 0) if no correlated noise is significant.
    """
    groups = [_WindowGroups(w, n, level, time) for w, n in zip(windows, nuisance, strict=True)]
    count = sum(len(g.seen) for g in groups)
    if count < _FEWEST_GROUPS:
        return AngleNoise()
    block = float(np.median([np.ptp(w.samples.time) / len(w.lift) for w in windows]))
    shortest = max(2 * float(np.median([g.width for g in groups])), block / _SHORTEST)
    times = np.geomspace(shortest, block / _LONGEST_TIME, _WINDOW_TIMES)
    unit = float(np.median(np.concatenate([g.white for g in groups])))
    ratios = unit * _RATIOS
    logs, squares = [], []
    for t in times:
        determinant, square = np.zeros(len(ratios)), np.zeros(len(ratios))
        for g in groups:
            own = g.likelihood_terms(t, ratios)
            determinant, square = determinant + own[0], square + own[1]
        logs.append(-0.5 * (determinant + count * np.log(square)))
        squares.append(square)
    found, scales = np.array(logs), np.array(squares) / (count - 2)
    white = -0.5 * count * math.log(sum(float(g.seen @ g.seen) for g in groups))
    best = 2 * float(found.max() - white)
    if best < _SIGNIFICANT:
        return AngleNoise(gain=best)
    density = np.exp(found - found.max())
    density /= density.sum()
    levels = np.sqrt(ratios * scales)
    per_time = np.sum(density * levels**2, axis=1)
    scale = float(np.sum(density * scales))
    kept = per_time > _NEGLIGIBLE_SHARE * per_time.sum()
    covariances = [
        scale / w.scale**2 * np.eye(len(w.z))
        + sum(s * _row_covariance(w, t) for t, s in zip(times[kept], per_time[kept], strict=True))
        for w in windows
    ]
    return _angle_noise(np.repeat(times, len(ratios)), levels.ravel(), density.ravel(), best, covariances)


class _WindowGroups:
    """Means of groups of samples of one window, beyond what is free, in units of the stated uncertainty."""

    def __init__(self, window: Compressed, nuisance: Array, level: float, time: float) -> None:
        samples, blocks = window.samples, len(window.lift)
        n = len(samples)
        count = min(n // _LEAST_IN_GROUP, _GROUPS * blocks)
        first = np.linspace(0, n, count + 1).astype(int)[:-1]
        weight = 1 / samples.sigma**2
        total = np.add.reduceat(weight, first)
        self._time, value = (
            np.add.reduceat(v * weight, first) / total for v in (samples.time, samples.value)
        )
        self.width = float(np.ptp(samples.time)) / count
        self.white = 1 / total
        waves = np.add.reduceat(nuisance * weight[:, None], first, axis=0) / total[:, None]
        x = 2 * (self._time - samples.time[0]) / np.ptp(samples.time) - 1
        powers = np.polynomial.legendre.legvander(x, _DEGREE_OF_WINDOW + 2 * (blocks - 1))
        free = np.concatenate([powers, waves], axis=1) / np.sqrt(self.white)[:, None]
        size = np.linalg.norm(free, axis=0)
        u, s, _ = np.linalg.svd(free[:, size > 0] / size[size > 0], full_matrices=True)
        self._outside = u[:, int((s > _RANK * s[0]).sum()) :] / np.sqrt(self.white)[:, None]
        since = np.maximum(self._time[:, None] - self._time, 0.0) * self.width
        torque = self._outside.T @ since * level
        apart = np.abs(self._time[:, None] - self._time)
        random = torque @ np.exp(-apart / time) @ torque.T
        third = np.diff(samples.value / samples.sigma, 3)
        frames = float(np.median(third**2)) / _MEDIAN_CHI2 / _THIRD_DIFFERENCE
        self._root = np.linalg.inv(np.linalg.cholesky(np.eye(len(random)) + random / max(frames, _TINY)))
        self._apart = apart
        self.seen = self._root @ (self._outside.T @ value)

    def likelihood_terms(self, time: float, ratios: Array) -> tuple[Array, Array]:
        """Return log det V and r'V^-1 r for each ratio rho."""
        h = self.width / time
        kernel = np.exp(-self._apart / time) * (2 * math.sinh(0.5 * h) / h) ** 2
        np.fill_diagonal(kernel, 2 / h * (1 - (1 - math.exp(-h)) / h))
        inner = self._root @ (self._outside.T @ kernel @ self._outside) @ self._root.T
        values, vectors = np.linalg.eigh(inner)
        variance = 1 + ratios[:, None] * np.maximum(values, 0.0)
        seen = vectors.T @ self.seen
        return np.log(variance).sum(axis=1), (seen**2 / variance).sum(axis=1)


def _row_covariance(run: Compressed, time: float) -> Array:
    """Return P R P' of the polynomial rows of a run."""
    k, operators = run.lift.shape[1], binned_operators(run)
    middle = np.concatenate([m for m, _ in operators])
    kernel = np.exp(-np.abs(middle[:, None] - middle) / time)
    rows = np.zeros((k * len(operators), len(middle)))
    first = 0
    for i, (m, p) in enumerate(operators):
        rows[i * k : (i + 1) * k, first : first + len(m)] = p
        first += len(m)
    return np.asarray(rows @ kernel @ rows.T)


def _with_process_noise(stretches: Sequence[Stretch], angle: Array | None, times: Sequence[float]) -> float:
    """Return the log-likelihood of an angle covariance, with process noise of any level and these times integrated out.

    A level of its own in each stretch, at its most likely value, would stand for the slow part of angle noise.
    """
    description = _Description(stretches, angle)
    resolution = 2 * times[0] * description.unit(times[0]) ** 2
    found, total = -np.inf, -np.inf
    for time in times:
        levels = description.unit(time) * _PROCESS_LEVELS
        prior = _log_prior(levels, time, resolution)
        found = np.logaddexp(found, np.logaddexp.reduce(description.likelihood(time, levels) + prior))
        total = np.logaddexp(total, np.logaddexp.reduce(prior))
    return float(found - total) + description.log_determinant


def _log_prior(levels: Array, time: float, resolution: float, typical: float = math.inf) -> Array:
    """Return the logarithm of the prior density of process noise in the logarithm of its level."""
    scale = min(math.sqrt(resolution / (2 * time)), typical)
    return np.asarray(
        np.log(levels) - np.log(scale) - 0.5 * (_FREEDOM + 1) * np.log1p((levels / scale) ** 2 / _FREEDOM)
    )


def mean_acceleration(run: Compressed) -> float:
    """Return the mean absolute acceleration of a run, from the mean speeds in its parts [rad/s2]."""
    t, y = run.samples.time, run.samples.value
    edges = np.linspace(0, len(t) - 1, int(np.clip(len(run.lift), 4, 12)) + 1).astype(int)
    speed = np.diff(y[edges]) / np.diff(t[edges])
    return float(np.abs(np.diff(speed)).sum() / np.ptp(t))


def binned_operators(run: Compressed, bins: int = _BINS) -> list[tuple[Array, Array]]:
    """Return for each block the mean times of groups of samples, and the polynomial rows of a constant in each."""
    k, found = run.lift.shape[1], []
    for where, operator in run.operators:
        t = run.samples.time[where]
        edges = np.unique(np.linspace(0, len(t), bins + 1).astype(int))[:-1]
        middle = np.add.reduceat(t, edges) / np.diff(np.append(edges, len(t)))
        found.append((middle, np.add.reduceat(operator[:k], edges, axis=1)))
    return found


def _turn_covariances(run: Compressed, times: Sequence[float] | Array) -> list[Array]:
    """Return P R P' of the rows for R = cos(psi - psi') exp(-|t - t'| / T), for each T [s]."""
    k = run.lift.shape[1]
    operators = binned_operators(run, max(_FEWEST_BINS, _ALL_BINS // len(run.lift)))
    middle = np.concatenate([m for m, _ in operators])
    angle = np.interp(middle, run.samples.time, run.samples.value)
    rows, first = np.zeros((k * len(operators), len(middle))), 0
    for i, (m, p) in enumerate(operators):
        rows[i * k : (i + 1) * k, first : first + len(m)] = p
        first += len(m)
    apart, waves = np.abs(middle[:, None] - middle), np.cos(angle[:, None] - angle)
    return [np.asarray(rows @ (waves * np.exp(-apart / t)) @ rows.T) for t in times]


def _covariance(run: Compressed, time: float) -> Array:
    """Return P R P' - f 1 of a run, without negative eigenvalues."""
    blocks, k, _ = run.lift.shape
    forward, backward, first, last, diagonal = [], [], [], [], []
    for (where, _), (middle, p) in zip(run.operators, binned_operators(run), strict=True):
        t = run.samples.time[where]
        diagonal.append(p @ np.exp(-np.abs(middle[:, None] - middle) / time) @ p.T)
        forward.append(p @ np.exp((middle - t[-1]) / time))
        backward.append(p @ np.exp((t[0] - middle) / time))
        first.append(t[0])
        last.append(t[-1])
    between = np.exp(-np.maximum(np.array(first) - np.array(last)[:, None], 0.0) / time)
    upper = np.einsum("bc,bi,cj->bicj", np.triu(between, 1), np.array(forward), np.array(backward))
    total = upper.reshape(blocks * k, blocks * k)
    total = total + total.T
    for b, d in enumerate(diagonal):
        total[b * k : (b + 1) * k, b * k : (b + 1) * k] += d
    # rows of degree n have frequencies about n / (2 block lengths)
    length = float(np.ptp(run.samples.time)) / blocks
    band, highest = np.arange(k, k + NOISE_ROWS) / (2 * length), np.array((k - 1) / (2 * length))
    share = float(np.mean(_spectrum(band, time)) / _spectrum(highest, time))
    values, vectors = np.linalg.eigh(
        total - share * float(np.median([d[-1, -1] for d in diagonal])) * np.eye(len(total))
    )
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _spectrum(frequency: Array, time: float) -> Array:
    return np.asarray(1 / (1 + (2 * np.pi * frequency * time) ** 2))


@dataclass(frozen=True)
class ProcessNoise:
    """Random acceleration of the casing, without a fit.

    Attributes
    ----------
    level, level_u : float
        Rms s and its standard uncertainty [rad/s2].
    time : float
        Correlation time T [s].
    least : float
        The quantile 0.001 of the posterior distribution of s [rad/s2].
    ratios, weights : ndarray, shape (n,)
        Posterior distribution of s^2 T, on which the variance of slow rows depends, in units of `level`^2 `time`.
    """

    level: float
    level_u: float
    time: float
    least: float
    ratios: Array = field(repr=False)
    weights: Array = field(repr=False)


def estimate_process_noise(
    run: Compressed, nuisance: Array, angle_noise: AngleNoise, *, angle: bool, typical: float = math.inf
) -> ProcessNoise:
    """Estimate the process noise of a run.

    Parameters
    ----------
    run : Compressed
        Projected angles or speeds.
    nuisance : ndarray, shape (rows, columns)
        Polynomial rows of the nuisance functions, at one standard deviation of their prior.
    angle_noise : AngleNoise
        Correlated angle noise of the run.
    angle : bool
        Whether angles were measured (and not speeds).
    typical : float
        Mean acceleration of the body [rad/s2], which the scale of the prior does not exceed.

    Returns
    -------
    ProcessNoise
    """
    blocks, k, _ = run.lift.shape
    times = float(np.ptp(run.samples.time)) / blocks * np.array(_PROCESS_TIMES)
    angles = None
    if len(angle_noise.root):
        angles = angle_noise.root @ angle_noise.root - np.eye(len(angle_noise.root))

    def stretch(part: NDArray[np.intp], degree: int) -> Stretch:
        degree = min(degree - (not angle), len(part) * k // 3)
        found = Stretch(run, part, nuisance, degree, angle=angle)
        return found if len(found.seen) else Stretch(run, part, nuisance[:, :0], 2, angle=angle)

    def description(count: int, degree: int) -> _Description:
        parts = np.array_split(np.arange(blocks), max(1, count))
        return _Description([stretch(p, degree) for p in parts], angles)

    found = description(min(_STRETCHES, blocks // _SHORT), _DEGREE)
    if blocks // _SHORT > _STRETCHES:
        fine = description(blocks // _SHORT, _MANY)
        if not found.allowed_by(fine, times):
            found = fine
    # where longer stretches do as well, they determine slower noise
    while len(found.stretches) > 1:
        pairs = list(zip(found.stretches[::2], found.stretches[1::2], strict=False))
        longer: list[Stretch] = []
        for pair in pairs:
            blocks_of = np.concatenate([p.blocks for p in pair])
            one = (
                _Description([stretch(blocks_of, _DEGREE)], angles)
                if len(blocks_of) * k <= _LONGEST
                else None
            )
            longer += one.stretches if one is not None and one.allowed_by(found, times) else pair
        longer += found.stretches[2 * len(pairs) :]
        if len(longer) == len(found.stretches):
            break
        found = _Description(longer, angles)
    return _process_noise(found, times, typical)


class _Description:
    """Stretches in which the motion is a polynomial, and their restricted likelihood of process noise."""

    def __init__(self, stretches: Sequence[Stretch], angles: Array | None) -> None:
        self.stretches = list(stretches)
        self._roots = [s.root(angles) for s in stretches]

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of what whitens the angle noise."""
        return float(sum(np.log(np.diag(root)).sum() for root in self._roots))

    def unit(self, time: float) -> float:
        """Return the rms acceleration that is as large as the noise in half of the rows [rad/s2]."""
        return float(np.median([s.torque(time)[1] for s in self.stretches]))

    def likelihood(self, time: float, levels: Array) -> Array:
        """Return the log-likelihood of each level [rad/s2] at a correlation time."""
        total = np.zeros(len(levels))
        for stretch, root in zip(self.stretches, self._roots, strict=True):
            covariance, unit = stretch.torque(time)
            values, vectors = np.linalg.eigh(root @ covariance @ root.T)
            values, seen = np.maximum(values, 0.0), vectors.T @ (root @ stretch.seen)
            found = _gaussian(seen, values, levels / unit)
            if len(self.stretches) > _FEW:
                own = _gaussian(seen, values, _PROCESS_LEVELS)
                average = float(np.logaddexp.reduce(own)) - np.log(len(own))
                found = np.logaddexp(np.log1p(-_OWN_LEVEL) + found, np.log(_OWN_LEVEL) + average)
            total += found
        return total

    def allowed_by(self, other: _Description, times: Array) -> bool:
        """Return whether the noise that these stretches need is one that a finer description allows.

        Polynomials that do not follow the motion need more.
        """
        levels = [other.unit(t) * _PROCESS_LEVELS for t in times]
        own = np.array([self.likelihood(t, x) for t, x in zip(times, levels, strict=True)])
        finer = np.array([other.likelihood(t, x) for t, x in zip(times, levels, strict=True)])
        allowed = 2 * (finer.max() - finer) < _ALLOWED
        return bool(2 * (own.max() - own[allowed].max()) < _ALLOWED)


def _gaussian(seen: Array, values: Array, levels: Array) -> Array:
    """Return the log-likelihood of independent rows of variance 1 + level^2 value, for each level."""
    variance = 1 + levels[:, None] ** 2 * values
    return np.asarray(-0.5 * (np.log(variance) + seen**2 / variance).sum(axis=1))


def _process_noise(description: _Description, times: Array, typical: float) -> ProcessNoise:
    """Return the posterior of level and correlation time on a grid of times, refined where its weight is."""
    resolution = 2 * times[0] * description.unit(times[0]) ** 2
    levels, density = _posterior(description, times, resolution, typical)
    total = density.sum(axis=1)
    weighty = np.flatnonzero(total > _WEIGHTY * total.max())
    if len(weighty) < len(times) // 2:
        first, last = max(weighty[0] - 1, 0), min(weighty[-1] + 1, len(times) - 1)
        times = np.geomspace(times[first], times[last], len(times))
        levels, density = _posterior(description, times, resolution, typical)
    weight = density.sum(axis=1)
    time = float(np.exp(weight @ np.log(times)))
    level = float(np.sum(density * levels))
    level_u = float(np.sqrt(np.sum(density * (levels - level) ** 2)))
    flat, order = density.ravel(), np.argsort(levels.ravel())
    least = float(levels.ravel()[order][np.searchsorted(np.cumsum(flat[order]), _LEAST)])
    ratios, weights = _binned((levels**2 * times[:, None]).ravel() / (level**2 * time), flat)
    return ProcessNoise(level, level_u, time, least, ratios, weights)


def _posterior(
    description: _Description, times: Array, resolution: float, typical: float
) -> tuple[Array, Array]:
    """Return levels [rad/s2] and their probabilities, (times, levels): equally spaced in both logarithms."""
    from scipy.interpolate import CubicSpline

    levels, found = [], []
    for time in times:
        own = description.unit(time) * _PROCESS_LEVELS
        fine = np.geomspace(own[0], own[-1], _FINER * len(own))
        likelihood = CubicSpline(np.log(own), description.likelihood(time, own))(np.log(fine))
        levels.append(fine)
        found.append(likelihood + _log_prior(fine, time, resolution, typical))
    density = np.array(found)
    density = np.exp(density - density.max())
    return np.array(levels), density / density.sum()


def _binned(values: Array, weights: Array) -> tuple[Array, Array]:
    """Return the means and the weights of bins that are equally spaced in the logarithm of the values."""
    kept = weights > _NEGLIGIBLE
    values, weights = values[kept], weights[kept]
    edges = np.geomspace(values.min(), values.max() * (1 + 1e-9), _BINNED + 1)
    place = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, _BINNED - 1)
    total = np.bincount(place, weights, _BINNED)
    mean = np.bincount(place, weights * values, _BINNED)
    return mean[total > 0] / total[total > 0], total[total > 0] / total.sum()


class Stretch:
    """Rows of some neighbouring blocks, without what is free in them."""

    def __init__(
        self, run: Compressed, blocks: NDArray[np.intp], nuisance: Array, degree: int, *, angle: bool = True
    ) -> None:
        k = run.lift.shape[1]
        self.blocks = blocks
        self._angle = angle
        self._torques: dict[float, tuple[Array, float]] = {}
        self.rows = (blocks[:, None] * k + np.arange(k)).ravel()
        self._nodes = run.node_times.reshape(-1, k)[blocks]
        self._lift = run.lift[blocks]
        x = 2 * (self._nodes - self._nodes.min()) / np.ptp(self._nodes) - 1
        powers = np.polynomial.legendre.legvander(x.ravel(), degree).reshape(*x.shape, -1)
        own = nuisance[self.rows]
        free = np.block(
            [
                [self._seen(powers), own],
                [np.zeros((own.shape[1], degree + 1)), np.eye(own.shape[1])],
            ]
        )
        u, s, _ = np.linalg.svd(free / np.linalg.norm(free, axis=0), full_matrices=True)
        # the rows of the prior measure zero
        self._outside = u[: len(own), int((s > 1e-7 * s[0]).sum()) :]
        self.seen = self.beyond(run.z[self.rows])

    def beyond(self, rows: Array) -> Array:
        """Return what rows of this stretch have orthogonal to all that is free."""
        return np.asarray(self._outside.T @ rows)

    def own_whiteners(self, times: Sequence[float], shares: Sequence[float]) -> list[tuple[Array, float]]:
        """Return what whitens `seen` at shares of the process noise most likely in this stretch, and deviances."""
        best, found = -np.inf, (np.eye(len(self.seen)), np.zeros(len(self.seen)), 0.0)
        for covariance in (self.torque(t)[0] for t in times):
            values, vectors = np.linalg.eigh(covariance)
            values = np.maximum(values, 0.0)
            likelihood = _gaussian(vectors.T @ self.seen, values, _TORQUES)
            i = int(np.argmax(likelihood))
            if likelihood[i] > best:
                best, found = float(likelihood[i]), (vectors.T, values, float(_TORQUES[i]))
        vectors, values, level = found
        variances = [1 + (share * level) ** 2 * values for share in shares]
        seen = vectors @ self.seen
        return [(vectors / np.sqrt(v)[:, None], float(np.sum(np.log(v) + seen**2 / v))) for v in variances]

    def _seen(self, values: Array) -> Array:
        return np.asarray((self._lift @ values).reshape(len(self.rows), -1))

    def torque(self, time: float) -> tuple[Array, float]:
        """Return the covariance by a random acceleration, with a median variance of 1, and its rms [rad/s2]."""
        if time not in self._torques:
            self._torques[time] = self._torque(time)
        return self._torques[time]

    def _torque(self, time: float) -> tuple[Array, float]:
        cells = np.linspace(self._nodes.min(), self._nodes.max(), int(_CELLS_PER_ROW * len(self.rows)))
        width = float(cells[1] - cells[0])
        since = np.maximum(self._nodes[..., None] - cells, 0.0)
        if not self._angle:
            # a speed, which grows while a cell lasts
            since = np.minimum(since / width, 1.0)
        answer = self._outside.T @ self._seen(since) * width
        total = answer @ np.exp(-np.abs(cells[:, None] - cells) / time) @ answer.T
        size = float(np.median(np.diag(total)))
        return np.asarray(total / size), 1 / float(np.sqrt(size))

    def root(self, angle: Array | None) -> Array:
        """Return what whitens the rows if they have this covariance plus unit white noise."""
        m = len(self.seen)
        if angle is None:
            return np.eye(m)
        inner = self._outside.T @ angle[np.ix_(self.rows, self.rows)] @ self._outside
        return np.asarray(np.linalg.inv(np.linalg.cholesky(np.eye(m) + inner)))

    def likelihood(self, angle: Array | None, torques: Sequence[tuple[Array, float]]) -> tuple[float, float]:
        """Return the largest restricted log-likelihood over the levels of process noise, and that level [rad/s2]."""
        if not len(self.seen):
            return 0.0, 0.0
        root = self.root(angle)
        constant = float(np.log(np.diag(root)).sum())
        white = root @ self.seen
        best = (-0.5 * float(white @ white), 0.0)
        for k, unit in torques:
            values, vectors = np.linalg.eigh(root @ k @ root.T)
            seen = vectors.T @ white
            likelihood = _gaussian(seen, np.maximum(values, 0.0), _TORQUES)
            i = int(np.argmax(likelihood))
            best = max(best, (float(likelihood[i]), float(_TORQUES[i]) * unit))
        return constant + best[0], best[1]


def stretches_of(run: Compressed, nuisance: Array) -> list[Stretch]:
    """Return stretches of a run, with a polynomial and the nuisance functions free in each."""
    blocks = len(run.lift)
    parts = np.array_split(np.arange(blocks), max(1, min(_STRETCHES, blocks // 4)))
    return [Stretch(run, part, nuisance, 3 if len(part) < 8 else len(part) + 1) for part in parts]
