"""Correlated angle noise of a recording, estimated once and used for every fit.

Tracking errors are not white. The measured angle is shifted temporarily by the codec, by a hand-held camera, or if the
hub is estimated from neighbouring frames. The angle noise of a run has the covariance

    cov[n(t), n(t')] = a^2 exp(-|t - t'| / T),

an Ornstein-Uhlenbeck process of standard deviation a and correlation time T. The estimate does not depend on a model or
a moment of inertia: as for the process noise (`fitting.inference._process_noise`), the motion is assumed to be a
polynomial in each of a few stretches of time. Projected rows with unit white noise have the covariance

    C = 1 + a^2 (P R P' - f 1) + s^2 K,

where P is the projection, and R is the correlation matrix of the samples. f is the mean of P R P' in the band in which
the white noise is measured. It is subtracted, because this part of the noise is already contained in the white noise. K
is the covariance of the response to a random acceleration of rms 1, and s is the rms of this acceleration. a maximises
the likelihood after integration over level and correlation time of the process noise; angle noise is included if twice
the log-likelihood ratio exceeds `Criteria.correlated_noise`. The noise of rows that are slower than T depends only on
a^2 T, and the noise of faster rows only on a^2 / T. Therefore T is known much less precisely than the noise of the
rows. Every fit uses the mean covariance over the posterior of a and T, with priors uniform in ln a and ln T; this adds
the uncertainty of a and T to the uncertainties of all parameters.

In a short record, angle noise and process noise may describe the deviations equally well. The deviations then count as
process noise if its torque is smaller than the mean torque on the body. A random torque larger than the torque that
slows the body is not credible; the deviations then count as angle noise.

If a block contains few turns, errors that are periodic in the angle affect its rows. A displaced hub and a tilted
camera cause harmonics of constant amplitude, which are nuisance functions of every fit. If the camera or the hub moves
slowly, the amplitude of the harmonics varies,

    cov[n(t), n(t')] = b^2 cos(psi - psi') exp(-|t - t'| / T).

The same likelihood decides whether these harmonics are included: not at all, instead of the noise above, or in addition
to it. In blocks of many turns, harmonics are orthogonal to the polynomials.

The noise of all windows of the rotor is estimated together, with a single pair (a, T) and with the process noise of the
casing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from fitting._criteria import DEFAULT, Criteria
from fitting.inference._compression import NOISE_ROWS, Compressed
from fitting.inference._linear_algebra import block_diagonal, cubic_spline
from fitting.inference._process_noise import (
    CONSISTENT,
    StretchLikelihood,
    mean_acceleration,
    split_into_stretches,
)

Array = NDArray[np.float64]

_UNLIKELY = 0.25
"""A finer search follows if the gain in likelihood of a coarse search exceeds this share of
`Criteria.correlated_noise`; for two kinds of noise, the sum of their gains counts [1]. Chosen: a smaller value costs
time, a larger one may omit noise that the fine search would find."""
_TIMES = (1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0, 2.0)
"""Trial correlation times [lengths of a block]. Chosen: noise with a shorter time is white for the rows, noise with a
longer time is absorbed by the polynomials."""
_LEVELS = np.geomspace(0.3, 300.0, 13)
"""Trial levels, in units of the white noise of the rows [1]. Chosen: lower levels change nothing, higher levels do not
occur; a coarser grid rounds the most likely level."""
_FIRST_LEVELS = (2, 5, 8)
"""Indices in `_LEVELS` of the levels of a first, coarse search [1]. Chosen: with fewer levels, noise may be overlooked;
with more, the search takes longer."""
_HALF_WIDTH = 0.3
"""Half width of the parabola through the likelihood at its maximum, in the logarithm of the level [1]. Chosen: a
smaller value is sensitive to rounding errors, a larger one to the asymmetry of the likelihood."""
_FEWEST_BLOCKS = 4
"""Smallest number of blocks of a stretch; in a stretch the motion is described by a cubic [1]. Chosen: a smaller number
gives too few rows to separate motion and noise, a larger one refuses short records."""
_TORQUE_TIMES = (0.1, 0.3, 1.0)
"""Trial correlation times of the process noise [lengths of a block]. Chosen: a smaller number takes process noise for
angle noise, a larger one costs time."""
_FINER = 16
"""Number of points of the finer grid per interval of the coarse grid [1]. Chosen: a smaller number makes the posterior
mean coarse, a larger one costs time."""
_NEGLIGIBLE = 0.01
"""A stated error is neglected if its variance, in units of the variance of the white noise of a row, is below this
value [1]. Chosen: 1 % of the variance; a smaller value costs time, a larger one understates uncertainties."""
_LARGEST_RELATIVE_U = 0.7
"""Upper limit of the standard deviation of the logarithm of a level; it applies if the data hardly determine the level
[1]. Chosen: a factor of two; a smaller value understates the uncertainty, a larger one lets improbable high levels
dominate the mean."""
TURNS_PER_BLOCK = 3.0
"""Noise periodic in the angle affects the rows of a block if the block contains at most this number of turns [1].
Chosen: in blocks with more turns this noise is orthogonal to the polynomials; a smaller value neglects it, a larger one
costs time."""
_PERIODIC_TIMES = 5
"""Number of trial correlation times of noise periodic in the angle [1]. Chosen: a smaller number passes over the
maximum of the likelihood, a larger one costs time."""
_FEWEST_BINS = 24
"""Smallest number of groups of samples in a block for noise periodic in the angle [1]. Chosen: a smaller number blurs a
turn, a larger one costs time and memory."""
_ALL_BINS = 1500
"""Number of groups of samples in all blocks together, for noise periodic in the angle [1]. Chosen: a smaller number
blurs a turn in few blocks, a larger one costs time and memory."""
_LOWER_LEVELS = (0.1, 0.2, 0.4, 0.8)
"""Trial levels of the noise with an exponential correlation if periodic noise is included as well, divided by the most
likely level without periodic noise [1]. Chosen: two kinds of noise share the variance, so each level is lower; a
smaller number passes over the maximum, a larger one costs time."""
_NEAR_LEVELS = (0.5, 0.7, 1.0, 1.4, 2.0)
"""Trial levels of the periodic noise if noise with an exponential correlation is included as well, divided by the most
likely level of the periodic noise alone [1]. Chosen: a smaller number passes over the maximum, a larger one costs
time."""


@dataclass(frozen=True)
class AngleNoise:
    """Correlated angle noise of the casing, or of the rotor's windows."""

    # standard deviation a and its standard uncertainty [rad]; 0 if it is not significant
    sigma: float = 0.0
    sigma_u: float = 0.0
    time: float = 0.0  # correlation time T [s]
    # standard deviation b of the noise that is periodic in the angle, and its standard uncertainty [rad]; 0 if it is
    # not significant
    turn_sigma: float = 0.0
    turn_sigma_u: float = 0.0
    turn_time: float = 0.0  # correlation time of the amplitude of the periodic noise [s]
    gain: float = 0.0  # twice the logarithm of the likelihood ratio of correlated noise against white noise
    needed: float = DEFAULT.correlated_noise  # smallest significant gain
    # shape (rows, rows); C^(1/2) and C^(-1/2) of the polynomial rows, or empty for white noise
    root: Array = field(default_factory=lambda: np.zeros((0, 0)), repr=False)
    inverse: Array = field(default_factory=lambda: np.zeros((0, 0)), repr=False)

    @property
    def is_significant(self) -> bool:
        """Whether the data show correlated noise; noise that they merely do not exclude does not count."""
        return self.gain >= self.needed and not self.is_white

    @property
    def is_white(self) -> bool:
        """Whether no correlated noise is significant."""
        return self.sigma == 0 and self.turn_sigma == 0

    def with_stated(self, rows: Array) -> Self:
        """Return the noise with an additional error that the instrument states: the covariance `rows` `rows`'."""
        if not rows.size:
            return self
        own = self.root @ self.root if len(self.root) else np.eye(len(rows))
        root, inverse = _roots(own + rows @ rows.T)
        return replace(self, root=root, inverse=inverse)

    @classmethod
    def of_posterior(
        cls, times: Array, levels: Array, weights: Array, gain: float, covariances: Sequence[Array]
    ) -> Self:
        """Return the angle noise of a posterior distribution, with the covariances of rows averaged over it.

        The mean covariance contains the uncertainty of level and time (law of total variance).
        """
        roots, inverses = zip(*map(_roots, covariances), strict=True)
        sigma = float(np.sqrt(weights @ levels**2))
        return cls(
            sigma,
            _moments(levels, weights)[1],
            math.exp(weights @ np.log(times)),
            gain=gain,
            root=block_diagonal(roots),
            inverse=block_diagonal(inverses),
        )


def _moments(values: Array, weights: Array) -> tuple[float, float]:
    """Return mean and standard deviation."""
    mean = float(weights @ values)
    return mean, float(np.sqrt(weights @ (values - mean) ** 2))


def _roots(covariance: Array) -> tuple[Array, Array]:
    """Return C^(1/2) and C^(-1/2)."""
    values, vectors = np.linalg.eigh(covariance)
    return (vectors * np.sqrt(values)) @ vectors.T, (vectors / np.sqrt(values)) @ vectors.T


def estimate_angle_noise(run: Compressed, nuisance: Array, criteria: Criteria = DEFAULT) -> AngleNoise:
    """Estimate the correlated angle noise of a run; white (`sigma` = 0) if none is significant.

    `nuisance` (rows, columns) are the polynomial rows of the nuisance functions at one standard deviation of their
    prior.
    """
    needed = criteria.correlated_noise
    if len(run.lift) < _FEWEST_BLOCKS:
        # a cubic does not describe the motion of a whole record, so the deviations would count as noise
        return AngleNoise()
    stretches = split_into_stretches(run, nuisance)
    span = float(np.ptp(run.samples.time))
    block = span / len(run.lift)
    torque_times = [block * t for t in _TORQUE_TIMES]
    if not all(len(s.projected) for s in stretches):
        return AngleNoise()  # in a short recording, the nuisance parameters describe all rows
    white = sum(s.likelihood(None) for s in stretches)
    with_torque = StretchLikelihood.of(stretches, None).marginal(torque_times)
    credible = max(s.most_likely_level(torque_times) for s in stretches) < mean_acceleration(run)

    def gain(covariance: Array) -> float:
        if credible:
            return 2 * (StretchLikelihood.of(stretches, covariance).marginal(torque_times) - with_torque)
        return 2 * (sum(s.likelihood(covariance) for s in stretches) - white)

    times = block * np.array(_TIMES)
    covariances = [_row_covariance_beyond_white(run, t) for t in times]
    first = max(gain((_unit(k) * _LEVELS[j]) ** 2 * k) for k in covariances for j in _FIRST_LEVELS)
    few_turns = abs(float(np.ptp(run.samples.value))) / (2 * np.pi * len(run.lift)) < TURNS_PER_BLOCK
    if first < _UNLIKELY * needed and not few_turns:
        return AngleNoise(gain=float(first))
    least = max(needed, 0.0 if credible else 2 * (with_torque - white) - needed)
    exponential = _Kind.of(times, covariances, gain)
    if few_turns:
        slow = np.geomspace(block, 2 * span, _PERIODIC_TIMES)
        periodic = _Kind.of(slow, _periodic_covariances(run, slow), gain)
        if max(exponential.gain, 0) + max(periodic.gain, 0) < _UNLIKELY * needed:
            return AngleNoise(gain=max(exponential.gain, periodic.gain))
        found = _with_periodic_part(exponential, periodic, gain, needed)
        if found is not None:
            return found if found.gain >= least else AngleNoise(gain=found.gain)
    if exponential.gain < least:
        return AngleNoise(gain=exponential.gain)
    fine, levels, relative_u, weights = _fine_posterior(exponential)
    # the square of the level is averaged over a log-normal distribution
    squares = levels**2 * np.exp(2 * relative_u**2)
    shares = np.stack([np.interp(np.log(fine), np.log(times), row) for row in np.eye(len(times))])
    total = np.eye(len(covariances[0]))
    for share, covariance in zip(shares @ (weights * squares), covariances, strict=True):
        total += share * covariance
    # two levels for each time, one standard deviation below and above the most likely level
    change = np.exp(relative_u)
    both = np.concatenate([levels / change, levels * change])
    found = AngleNoise.of_posterior(
        np.tile(fine, 2), both, np.tile(weights / 2, 2), exponential.gain, [total]
    )
    return replace(found, needed=needed)


class _Peak(NamedTuple):
    """For one correlation time: the most likely level [rad], its relative uncertainty, and the gain at this level."""

    level: float
    relative_u: float
    gain: float


class _Kind(NamedTuple):
    """Angle noise of one kind: correlation times [s]; at each time, covariance of the rows and likeliest level."""

    times: Array
    covariances: list[Array]
    peaks: list[_Peak]

    @classmethod
    def of(cls, times: Array, covariances: list[Array], gain: Callable[[Array], float]) -> Self:
        return cls(times, covariances, [_peak(k, gain) for k in covariances])

    @property
    def gain(self) -> float:
        """The largest gain."""
        return max(p.gain for p in self.peaks)

    def points(self, factors: Sequence[float], least: float = math.inf) -> list[tuple[float, float, Array]]:
        """Return time, level and covariance at multiples of the most likely level of each time."""
        return [
            (float(t), f * p.level, k)
            for t, k, p in zip(self.times, self.covariances, self.peaks, strict=True)
            for f in factors
            if p.gain > self.gain - least
        ]


def _peak(covariance: Array, gain: Callable[[Array], float]) -> _Peak:
    """Return the level of the largest gain, from a grid and from parabolas in the logarithm of the level."""
    unit = _unit(covariance)

    def gain_at(log_level: float) -> float:
        return gain((unit * float(np.exp(log_level))) ** 2 * covariance)

    x = np.log(_LEVELS[::2])
    y = [gain_at(v) for v in x]
    top = int(np.clip(np.argmax(y), 1, len(x) - 2))
    at, value, curvature = x[top], y[top], 0.0
    for half in (x[1] - x[0], _HALF_WIDTH, _HALF_WIDTH):
        low, high = gain_at(at - half), gain_at(at + half)
        curvature = (low - 2 * value + high) / half**2
        slope = (high - low) / (2 * half)
        step = -slope / curvature if curvature < 0 else math.copysign(half, slope)
        at += float(np.clip(step, -half, half))
        value = gain_at(at)
    relative_u = math.sqrt(-2 / curvature) if curvature < 0 else 1.0
    return _Peak(float(np.exp(at)) * unit, relative_u, float(value))


HARMONICS = range(3, 13)
"""Orders of the errors that are periodic in the angle and that the nuisance functions of the camera do not describe
[1]. Derived: the nuisance functions describe the first two orders; tracking states errors of up to 12 periods per
turn."""
_NEGLIGIBLE_ROWS = 0.1
"""A column is neglected if its norm is below this value [1]. Derived: it adds less than 0.1^2, 1 %, to the variance of
a row."""


def stated_error_rows(
    run: Compressed,
    sigma: float,
    time: float,
    periodic: float = 0.0,
    harmonic: float = 0.0,
    profile: Sequence[tuple[float, float]] = (),
) -> Array:
    """Return B, (rows, columns); B B' is the covariance of the polynomial rows due to stated errors of the angle.

    One error is an Ornstein-Uhlenbeck process of standard deviation `sigma` [rad] and correlation time `time` [s]. Its
    mean is not an error, because the zero of the angle is free. With a `profile` of times [s] and standard deviations
    [rad], the standard deviation of this error varies in time (see `profile_at`).

    The other errors are harmonics of the angle. Harmonics of orders 1 and 2 have amplitudes of standard deviation
    `periodic` [rad], independent in each block of few turns. In blocks of more turns, they are orthogonal to the
    polynomials (see `stated_harmonic_scale`). Harmonics of orders 3 to 12 have amplitudes of standard deviation
    `harmonic` [rad], independent in each block. They matter because sampling by frames aliases them to slow errors if
    the order times the rate of rotation is close to a multiple of the frame rate.
    """
    found = [np.zeros((len(run.z), 0))]
    if sigma > 0 and time > 0:
        values, vectors = np.linalg.eigh(
            _row_covariance(run, time, lambda times: profile_at(times, sigma, profile))
        )
        known = values > _NEGLIGIBLE
        found.append(vectors[:, known] * np.sqrt(values[known]))
    k = run.lift.shape[1]
    for i, (where, operator) in enumerate(run.operators if periodic > 0 else ()):
        psi = run.samples.value[where]
        if np.ptp(psi) < TURNS_PER_BLOCK * 2 * np.pi:
            rows = np.zeros((len(run.z), 4))
            waves = np.stack([f(order * psi) for order in (1, 2) for f in (np.cos, np.sin)], axis=1)
            rows[i * k : (i + 1) * k] = periodic * operator[:k] @ waves
            found.append(rows)
    for i, (where, operator) in enumerate(run.operators if harmonic > 0 else ()):
        psi = run.samples.value[where]
        waves = np.stack([f(order * psi) for order in HARMONICS for f in (np.cos, np.sin)], axis=1)
        part = harmonic * operator[:k] @ waves
        part = part[:, np.linalg.norm(part, axis=0) > _NEGLIGIBLE_ROWS]
        rows = np.zeros((len(run.z), part.shape[1]))
        rows[i * k : (i + 1) * k] = part
        found.append(rows)
    return np.concatenate(found, axis=1)


def profile_at(times: Array, sigma: float, profile: Sequence[tuple[float, float]]) -> Array:
    """Return the standard deviation of the slowly varying error at times (n,) [rad], linearly interpolated."""
    if not profile:
        return np.full(len(times), sigma)
    at, size = np.transpose(profile)
    return np.asarray(np.interp(times, at, size))


def stated_harmonic_scale(run: Compressed, harmonic: float) -> Array:
    """Return the standard deviation of the rows of harmonics, (rows,), in units of their white noise.

    An error of the angle that repeats every turn changes with speed, blur and light. Its constant part is a nuisance
    parameter. In addition, orders 1 and 2 have random amplitudes in each block. Their standard deviation is `harmonic`
    [rad], as for higher orders.
    """
    k, found = run.lift.shape[1], [np.zeros(0)]
    for where, operator in run.operators:
        psi = run.samples.value[where]
        waves = np.stack([f(order * psi) for order in (1, 2) for f in (np.cos, np.sin)], axis=1)
        found.append(np.hypot(1.0, harmonic * np.linalg.norm(operator[k:] @ waves, axis=1)))
    return np.concatenate(found)


def _unit(covariance: Array) -> float:
    """Return the level at which the noise is at least as large as the white noise in half of the rows."""
    return 1 / float(np.sqrt(np.median(np.diag(covariance)) + 1e-300))


def _with_periodic_part(
    exponential: _Kind, periodic: _Kind, gain: Callable[[Array], float], needed: float
) -> AngleNoise | None:
    """Return the angle noise with a part periodic in the angle; None if exponential noise alone is as likely.

    A second kind must raise the gain by at least `needed`.
    """
    near = periodic.points(_NEAR_LEVELS, CONSISTENT)
    alone = [(exponential.times[0], 0.0, exponential.covariances[0], *p) for p in near]
    both = [(*e, *p) for e in exponential.points(_LOWER_LEVELS) for p in near]
    points = alone + both
    log = 0.5 * np.array([gain(a**2 * k + b**2 * r) for _, a, k, _, b, r in points])
    best = 2 * float(log.max())
    if best - needed * (int(np.argmax(log)) >= len(alone)) <= exponential.gain:
        return None
    # the combination of both kinds has the same prior probability as each single kind
    weights = np.exp(log - log.max()) / np.repeat([len(alone), len(both)], [len(alone), len(both)])
    weights /= weights.sum()
    total = np.eye(len(points[0][2]))
    for w, (_, a, k, _, b, r) in zip(weights, points, strict=True):
        total += w * (a**2 * k + b**2 * r)
    times, levels, _, slow, turns, _ = (list(c) for c in zip(*points, strict=True))
    found = AngleNoise.of_posterior(np.array(times), np.array(levels), weights, best, [total])
    amplitudes = np.array(turns)
    return replace(
        found,
        needed=needed,
        turn_sigma=float(np.sqrt(weights @ amplitudes**2)),
        turn_sigma_u=_moments(amplitudes, weights)[1],
        turn_time=float(np.exp(weights @ np.log(slow))),
    )


def _fine_posterior(kind: _Kind) -> tuple[Array, Array, Array, Array]:
    """Return correlation times [s], and for each its level [rad], the relative uncertainty and the probability.

    The prior is uniform in the logarithms of time and level. The integral over the level assumes a normal distribution
    of its logarithm. Between the times of the grid, gain and level are interpolated by cubic splines.
    """
    x = np.log(kind.times)
    fine = np.linspace(x[0], x[-1], _FINER * (len(x) - 1) + 1)
    gain = cubic_spline(x, np.array([p.gain for p in kind.peaks]), fine)
    level = cubic_spline(x, np.log([p.level for p in kind.peaks]), fine)
    relative_u = np.interp(fine, x, [p.relative_u for p in kind.peaks])
    weights = np.exp(0.5 * (gain - gain.max())) * relative_u
    limited = np.minimum(relative_u, _LARGEST_RELATIVE_U)
    return np.exp(fine), np.exp(level), limited, weights / weights.sum()


def _periodic_covariances(run: Compressed, times: Array) -> list[Array]:
    """Return P R P' of the rows for R = cos(psi - psi') exp(-|t - t'| / T), for each T [s]."""
    operators = run.operators_of_bins(max(_FEWEST_BINS, _ALL_BINS // len(run.lift)))
    t = np.concatenate([t for t, _ in operators])
    psi = np.interp(t, run.samples.time, run.samples.value)
    lag, cosine = np.abs(t[:, None] - t), np.cos(psi[:, None] - psi)
    ends = np.cumsum([0, *(p.shape[1] for _, p in operators)])
    parts = [(slice(i, j), p) for i, j, (_, p) in zip(ends[:-1], ends[1:], operators, strict=True)]

    def projected(kernel: Array) -> Array:
        # P is zero between different blocks
        half = np.concatenate([p @ kernel[own] for own, p in parts])
        return np.concatenate([half[:, own] @ p.T for own, p in parts], axis=1)

    return [projected(cosine * np.exp(-lag / time)) for time in times]


def _row_covariance(run: Compressed, time: float, size: Callable[[Array], Array] = np.ones_like) -> Array:
    """Return P R P' of the polynomial rows of a run, for a process with the standard deviation `size(time)`.

    For two different blocks the kernel is a product of two functions, each of a single time. The cost is therefore
    linear in the number of samples.
    """
    blocks, k, _ = run.lift.shape
    forward, backward, first, last, diagonal = [], [], [], [], []
    for (where, _), (middle, p) in zip(run.operators, run.binned_operators, strict=True):
        t = run.samples.time[where]
        p = p * size(middle)
        diagonal.append(p @ np.exp(-np.abs(middle[:, None] - middle) / time) @ p.T)
        forward.append(p @ np.exp((middle - t[-1]) / time))
        backward.append(p @ np.exp((t[0] - middle) / time))
        first.append(t[0])
        last.append(t[-1])
    between = np.exp(-np.maximum(np.array(first) - np.array(last)[:, None], 0.0) / time)
    upper = np.einsum("bc,bi,cj->bicj", np.triu(between, 1), np.array(forward), np.array(backward))
    total = upper.reshape(blocks * k, blocks * k)
    return np.asarray(total + total.T + block_diagonal(diagonal))


def _row_covariance_beyond_white(run: Compressed, time: float) -> Array:
    """Return P R P' - f 1 of a run, without negative eigenvalues."""
    blocks, k, _ = run.lift.shape
    total = _row_covariance(run, time)
    # rows of degree n have frequencies about n / (2 block lengths)
    length = float(np.ptp(run.samples.time)) / blocks
    band, highest = np.arange(k, k + NOISE_ROWS) / (2 * length), np.array((k - 1) / (2 * length))
    share = float(np.mean(_spectrum(band, time)) / _spectrum(highest, time))
    counted_twice = share * float(np.median(np.diag(total)[k - 1 :: k]))
    values, vectors = np.linalg.eigh(total - counted_twice * np.eye(len(total)))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _spectrum(frequency: Array, time: float) -> Array:
    return np.asarray(1 / (1 + (2 * np.pi * frequency * time) ** 2))


_WINDOW_DEGREE = 5
"""Degree of the polynomial of a window of one block [1]. Chosen: a smooth torque adds little to higher degrees; a
smaller value takes motion for noise, a larger one absorbs noise."""
_GROUPS = 128
"""Number of groups of samples per block [1]. Chosen: a smaller number averages short correlations, a larger one costs
time."""
_FEWEST_IN_GROUP = 4
"""Smallest number of samples in a group [samples]. Chosen: a smaller value makes larger matrices, a larger one averages
short correlations."""
_FEWEST_GROUPS = 40
"""Smallest number of groups in all windows together from which angle noise is estimated [1]. Chosen: a smaller number
does not determine a level; with a larger one, no level is estimated in short windows."""
_WINDOW_TIMES = 15
"""Number of trial correlation times in the windows [1]. Chosen: a smaller number makes the posterior mean coarse, a
larger one costs time."""
_SHORTEST = 64.0
"""Length of a block divided by the shortest correlation time in the windows [1]. Chosen: shorter correlations are white
for the rows; a larger value costs time, a smaller one overlooks fast noise."""
_LONGEST = 3.0
"""Length of a block divided by the longest correlation time in the windows [1]. Chosen: slower noise is absorbed by the
polynomial; a smaller value estimates noise that the rows do not contain, a larger one overlooks slow noise."""
_RATIOS = np.geomspace(1e-3, 1e6, 91)
"""Variances of angle noise divided by the variance of the white noise of a group [1]. Chosen: lower ratios change
nothing, higher ratios do not occur; a coarser grid rounds the posterior mean."""
_NEGLIGIBLE_SHARE = 1e-4
"""A correlation time is omitted if its share of the total posterior weight is below this value [1]. Derived: the
covariance keeps four correct digits."""
_RANK = 1e-7
"""Relative singular value below which a direction is rounding error [1]. Chosen: a smaller value counts rounding errors
as motion, a larger one takes motion for noise."""
_MEDIAN_CHI2 = 0.4549
"""Median of chi-square with one degree of freedom [1]. Derived: the square of quantile 0.75 of the standard normal
distribution."""
_THIRD_DIFFERENCE = 20.0
"""Variance of the third difference of white noise of variance 1 [1]. Derived: 1 + 9 + 9 + 1."""
_TINY = 1e-300
"""Smallest variance that is used as a divisor [rad2]. Derived: a division by zero is avoided, and any other variance is
larger."""


def estimate_window_noise(
    windows: Sequence[Compressed], nuisance: Sequence[Array], level: float | Array, time: float
) -> AngleNoise:
    """Estimate the correlated angle noise that all windows of the rotor have in common.

    As for the process noise, no test decides whether there is angle noise. In a few windows of a few seconds, a test
    would overlook noise that doubles the errors of the speeds. The posterior distribution includes levels far below the
    white noise, so the mean covariance adds little if the data show no angle noise.

    The few rows of a window hardly determine a correlation time. The data are therefore the means of many groups of
    samples in each window, orthogonal to a polynomial and the nuisance functions (samples, columns). They contain white
    noise of variance s^2 sigma^2 and angle noise of variance rho s^2 and correlation time T. s is integrated out with
    the prior 1 / s,

        log L = -1/2 [log det V + n log(r'V^-1 r)],   V = 1 + rho R_T + process noise,

    and the covariance of the rows is the mean over the posterior of s, rho and T, with priors uniform in ln rho and ln
    T. A window is too short to separate angle noise from process noise. The rms `level` [rad/s2] of the process noise
    (one for all windows, or one for each) and its correlation `time` [s] follow from the process noise of the casing.
    """
    levels = np.broadcast_to(level, len(windows))
    groups = [_WindowGroups(*one, time) for one in zip(windows, nuisance, levels, strict=True)]
    count = sum(len(g.projected) for g in groups)
    if count < _FEWEST_GROUPS:
        return AngleNoise()
    block = float(np.median([np.ptp(w.samples.time) / len(w.lift) for w in windows]))
    shortest = max(2 * float(np.median([g.width for g in groups])), block / _SHORTEST)
    times = np.geomspace(shortest, block / _LONGEST, _WINDOW_TIMES)
    unit = float(np.median(np.concatenate([g.white for g in groups])))
    ratios = unit * _RATIOS
    logs, squares = [], []
    for t in times:
        determinant, square = np.zeros(len(ratios)), np.zeros(len(ratios))
        for g in groups:
            terms = g.likelihood_terms(t, ratios)
            determinant, square = determinant + terms[0], square + terms[1]
        logs.append(-0.5 * (determinant + count * np.log(square)))
        squares.append(square)
    log_likelihood, scales = np.array(logs), np.array(squares) / (count - 2)
    white = -0.5 * count * math.log(sum(float(g.projected @ g.projected) for g in groups))
    best = 2 * float(log_likelihood.max() - white)
    density = np.exp(log_likelihood - log_likelihood.max())
    density /= density.sum()
    sizes = np.sqrt(ratios * scales)
    per_time = np.sum(density * sizes**2, axis=1)
    scale = float(np.sum(density * scales))
    kept = per_time > _NEGLIGIBLE_SHARE * per_time.sum()
    covariances = [
        scale / w.scale**2 * np.eye(len(w.z))
        + sum(s * _row_covariance(w, t) for t, s in zip(times[kept], per_time[kept], strict=True))
        for w in windows
    ]
    return AngleNoise.of_posterior(
        np.repeat(times, len(ratios)), sizes.ravel(), density.ravel(), best, covariances
    )


class _WindowGroups:
    """Means of groups of samples of one window, `width` [s] apart, in units of the stated uncertainty.

    `white` is the variance of each mean due to the stated uncertainties [rad2]. `projected` is the part of the means
    that is orthogonal to the free functions, whitened by the process noise.
    """

    def __init__(self, window: Compressed, nuisance: Array, level: float, time: float) -> None:
        samples, blocks = window.samples, len(window.lift)
        n = len(samples)
        count = min(n // _FEWEST_IN_GROUP, _GROUPS * blocks)
        first = np.linspace(0, n, count + 1).astype(int)[:-1]
        weight = 1 / samples.sigma**2
        total = np.add.reduceat(weight, first)
        self._time, value = (
            np.add.reduceat(v * weight, first) / total for v in (samples.time, samples.value)
        )
        self.width = float(np.ptp(samples.time)) / count
        self.white = 1 / total
        nuisance = np.add.reduceat(nuisance * weight[:, None], first, axis=0) / total[:, None]
        x = 2 * (self._time - samples.time[0]) / np.ptp(samples.time) - 1
        powers = np.polynomial.legendre.legvander(x, _WINDOW_DEGREE + 2 * (blocks - 1))
        free = np.concatenate([powers, nuisance], axis=1) / np.sqrt(self.white)[:, None]
        size = np.linalg.norm(free, axis=0)
        u, s, _ = np.linalg.svd(free[:, size > 0] / size[size > 0], full_matrices=True)
        self._complement = u[:, int((s > _RANK * s[0]).sum()) :] / np.sqrt(self.white)[:, None]
        since = np.maximum(self._time[:, None] - self._time, 0.0) * self.width
        response = self._complement.T @ since * level
        self._lag = np.abs(self._time[:, None] - self._time)
        random = response @ np.exp(-self._lag / time) @ response.T
        third = np.diff(samples.value / samples.sigma, 3)
        frames = float(np.median(third**2)) / _MEDIAN_CHI2 / _THIRD_DIFFERENCE
        self._whitening = np.linalg.inv(np.linalg.cholesky(np.eye(len(random)) + random / max(frames, _TINY)))
        self.projected = self._whitening @ (self._complement.T @ value)

    def likelihood_terms(self, time: float, ratios: Array) -> tuple[Array, Array]:
        """Return log det V and r'V^-1 r for each ratio rho."""
        h = self.width / time
        kernel = np.exp(-self._lag / time) * (2 * math.sinh(0.5 * h) / h) ** 2
        np.fill_diagonal(kernel, 2 / h * (1 - (1 - math.exp(-h)) / h))
        inner = self._whitening @ (self._complement.T @ kernel @ self._complement) @ self._whitening.T
        values, vectors = np.linalg.eigh(inner)
        variance = 1 + ratios[:, None] * np.maximum(values, 0.0)
        rows = vectors.T @ self.projected
        return np.log(variance).sum(axis=1), (rows**2 / variance).sum(axis=1)
