"""Process noise of a recording: a random acceleration of the casing, estimated once and used for every fit.

The estimate depends neither on a model nor on a moment of inertia. The motion is described by a polynomial in each of a
few stretches of time, with the camera's nuisance functions free. The estimate uses the restricted likelihood of the
rows orthogonal to these functions (H. Patterson, R. Thompson, Biometrika 58, 545 (1971)). The polynomials absorb slow
torques, whether a model contains them or not.

The acceleration is an Ornstein-Uhlenbeck process of rms s [rad/s2] and correlation time T. The estimated level and time
are the posterior means of s and ln T; no test decides whether there is process noise. The prior of s at a given T is
the positive half of a Student distribution with three degrees of freedom. Its scale is the resolution of the camera:
the rms s of an acceleration whose effect in half of the rows is as large as the noise. For this comparison, the
acceleration is white noise of the spectral density 2 s^2 T. The estimated level is never zero; if the data contain no
process noise, it is a small fraction of this resolution. A random torque is not expected to exceed the mean torque that
slows the body, so the scale is at most the mean acceleration; this limit matters for records of a second or two. The
prior of T is uniform in ln T from 1/32 of a block to three blocks. Below the lower limit the noise is white for the
rows; three blocks are a twentieth of a long record. A stretch with a kink or a jump is far noisier than the other
stretches. Therefore the likelihood of a stretch is a mixture: with a prior probability of 1/20, the stretch has a
separate level.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from fitting.inference._compression import Compressed
from fitting.inference._linear_algebra import cubic_spline

Array = NDArray[np.float64]

FLAT_PRIOR_SIGMA = 1e6
"""Standard deviation of a prior without information [rad or rad/s]. Derived: far beyond any angle and speed."""
CONSISTENT = 6.0
"""Two descriptions of the data are consistent if twice their log-likelihood ratio is at most this value [1]. Chosen:
chi-square with two degrees of freedom exceeds this value in 5 % of the cases; a smaller value refuses the right
description, a larger one accepts wrong descriptions."""

_MOST_STRETCHES = 6
"""Largest number of stretches of a record, each with a level [1]. Chosen: with fewer, a kink distorts the level; with
more, each stretch has few rows."""
_GRID = np.concatenate([[0.0], np.geomspace(0.1, 1e5, 31)])
"""Trial levels in one stretch, in units of the noise of the rows [1]. Chosen: lower levels change nothing, higher
levels do not occur; a coarser grid rounds the level."""
_CELLS_PER_ROW = 2.5
"""Number of cells of the random torque per row [1]. Chosen: a smaller number blurs the response of the highest row, a
larger one costs time."""
_DEGREE = 11
"""Degree of the polynomial of a stretch [1]. Chosen: a smaller value takes motion for noise, a larger one absorbs slow
noise."""
_SHORT_BLOCKS = 4
"""Number of blocks of a stretch that contains several periods of an oscillation [1]. Chosen: a smaller number leaves no
rows for the noise, a larger one contains too many periods for a polynomial."""
_SHORT_DEGREE = 14
"""Degree of the polynomial of a stretch that contains several periods of an oscillation [1]. Chosen: a smaller value
takes the oscillation for noise, a larger one absorbs noise."""
_MOST_ROWS = 170
"""Largest number of rows of two stretches together [rows]. Chosen: the cost increases with the cube of this number; a
larger number costs time, a smaller one neglects the correlation between stretches."""
_FEW_STRETCHES = 2
"""A stretch can have a separate level only if there are more stretches than this number [1]. Derived: with two
stretches of different levels, it is unknown which stretch is the exception."""
_OWN_LEVEL_SHARE = 0.05
"""Prior probability of a separate level of a stretch [1]. Chosen: one kink in twenty stretches; with a smaller value, a
kink raises the level of all stretches; a larger one discards noisy stretches."""
_TIMES = (1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0, 2.0, 3.0)
"""Trial correlation times [lengths of a block]. Chosen: noise with a shorter time is white for the rows; three blocks
are a twentieth of a long record; slower noise is absorbed by the polynomials."""
_LEVELS = np.geomspace(1e-4, 1e6, 121)
"""Trial levels, in units of the noise of the rows [1]. Chosen: twelve per decade; lower levels change nothing, higher
levels do not occur, a coarser grid rounds the posterior mean."""
_FINER = 16
"""Number of levels of the finer grid per level of the coarse grid [1]. Chosen: a smaller number makes the posterior
mean coarse, a larger one costs time."""
_REFINED_SHARE = 1e-4
"""The grid of times is refined about each time whose probability, relative to the largest probability, exceeds this
value [1]. Chosen: a smaller value costs time, a larger one rounds the posterior."""
_STUDENT_DOF = 3
"""Degrees of freedom of the prior of a level [1]. Derived: the smallest number with a finite variance; its tails are
heavy."""
_LEAST_QUANTILE = 1e-3
"""Probability of the quantile of the posterior distribution that counts as the lowest level allowed by the recording
[1]. Chosen: with a smaller value, any level of a fit counts as raised; a larger value excludes levels that the
recording allows."""
_NEGLIGIBLE = 1e-25
"""Probability below which a level is omitted [1]. Chosen: a smaller value costs time, a larger one changes integrals
over far tails."""
_BINS = 60
"""Number of bins of the marginal distribution of the level [1]. Chosen: a smaller number rounds the quantiles of the
level; with a larger one, each bin contains few levels."""


@dataclass(frozen=True)
class ProcessNoise:
    """Random acceleration of the casing, estimated without a fit."""

    # rms s and its standard uncertainty [rad/s2]
    level: float
    level_u: float
    time: float  # correlation time T [s]
    least: float  # the quantile 0.001 of the posterior distribution of s [rad/s2]
    # shape (n,); posterior distribution of s^2 T, which determines the variance of slow rows, in units of `level`^2
    # `time`
    ratios: Array = field(repr=False)
    weights: Array = field(repr=False)


def estimate_process_noise(
    run: Compressed, nuisance: Array, angle_root: Array, *, angle: bool, typical: float = math.inf
) -> ProcessNoise:
    """Estimate the process noise of a run of angles, or of speeds.

    `nuisance` (rows, columns) are the polynomial rows of the nuisance functions at one standard deviation of their
    prior. `angle_root` (rows, rows) is C^(1/2) of correlated angle noise, empty if the noise is white. `typical` is the
    mean acceleration of the body [rad/s2], the upper limit of the scale of the prior.
    """
    blocks, k, _ = run.lift.shape
    times = float(np.ptp(run.samples.time)) / blocks * np.array(_TIMES)
    angle_covariance = angle_root @ angle_root - np.eye(len(angle_root)) if len(angle_root) else None

    def stretch(part: NDArray[np.intp], degree: int) -> Stretch:
        degree = min(degree - (not angle), len(part) * k // 3)
        found = Stretch(run, part, nuisance, degree, angle=angle)
        return found if len(found.projected) else Stretch(run, part, nuisance[:, :0], 2, angle=angle)

    def divided(count: int, degree: int) -> StretchLikelihood:
        parts = np.array_split(np.arange(blocks), max(1, count))
        return StretchLikelihood.of([stretch(p, degree) for p in parts], angle_covariance)

    found = divided(min(_MOST_STRETCHES, blocks // _SHORT_BLOCKS), _DEGREE)
    if blocks // _SHORT_BLOCKS > _MOST_STRETCHES:
        fine = divided(blocks // _SHORT_BLOCKS, _SHORT_DEGREE)
        if not found.is_consistent_with(fine, times):
            found = fine
    # longer stretches determine slower noise; they are used if their polynomials also describe the motion
    while len(found.parts) > 1:
        pairs = list(zip(found.parts[::2], found.parts[1::2], strict=False))
        merged: list[WhitenedStretch] = []
        for pair in pairs:
            both = np.concatenate([p.stretch.blocks for p in pair])
            joint = (
                StretchLikelihood.of([stretch(both, _DEGREE)], angle_covariance)
                if len(both) * k <= _MOST_ROWS
                else None
            )
            merged += joint.parts if joint is not None and joint.is_consistent_with(found, times) else pair
        merged += found.parts[2 * len(pairs) :]
        if len(merged) == len(found.parts):
            break
        found = StretchLikelihood(merged)
    return _process_noise(found, times, typical)


def _process_noise(likelihood: StretchLikelihood, times: Array, typical: float) -> ProcessNoise:
    """Return the posterior of level and correlation time on a grid of times, refined at probable times."""
    resolution = 2 * times[0] * likelihood.unit(times[0]) ** 2
    levels, density = _posterior(likelihood, times, resolution, typical)
    total = density.sum(axis=1)
    probable = np.flatnonzero(total > _REFINED_SHARE * total.max())
    if len(probable) < len(times) // 2:
        first, last = max(probable[0] - 1, 0), min(probable[-1] + 1, len(times) - 1)
        times = np.geomspace(times[first], times[last], len(times))
        levels, density = _posterior(likelihood, times, resolution, typical)
    weight = density.sum(axis=1)
    time = float(np.exp(weight @ np.log(times)))
    level = float(np.sum(density * levels))
    level_u = float(np.sqrt(np.sum(density * (levels - level) ** 2)))
    flat, order = density.ravel(), np.argsort(levels.ravel())
    least = float(levels.ravel()[order][np.searchsorted(np.cumsum(flat[order]), _LEAST_QUANTILE)])
    ratios, weights = _binned((levels**2 * times[:, None]).ravel() / (level**2 * time), flat)
    return ProcessNoise(level, level_u, time, least, ratios, weights)


def _posterior(
    likelihood: StretchLikelihood, times: Array, resolution: float, typical: float
) -> tuple[Array, Array]:
    """Return levels [rad/s2] and their probabilities, (times, levels), on a grid with equal steps in logarithms."""
    levels, logs = [], []
    for time in times:
        coarse = likelihood.unit(time) * _LEVELS
        fine = np.geomspace(coarse[0], coarse[-1], _FINER * len(coarse))
        levels.append(fine)
        likelihoods = cubic_spline(np.log(coarse), likelihood(time, coarse), np.log(fine))
        logs.append(likelihoods + _log_prior(fine, time, resolution, typical))
    density = np.array(logs)
    density = np.exp(density - density.max())
    return np.array(levels), density / density.sum()


def _log_prior(levels: Array, time: float, resolution: float, typical: float = math.inf) -> Array:
    """Return the logarithm of the prior density of the logarithm of the level."""
    scale = min(math.sqrt(resolution / (2 * time)), typical)
    return np.asarray(
        np.log(levels)
        - np.log(scale)
        - 0.5 * (_STUDENT_DOF + 1) * np.log1p((levels / scale) ** 2 / _STUDENT_DOF)
    )


def _binned(values: Array, weights: Array) -> tuple[Array, Array]:
    """Return the mean and the weight of the values in bins that are equally spaced in the logarithm."""
    kept = weights > _NEGLIGIBLE
    values, weights = values[kept], weights[kept]
    edges = np.geomspace(values.min(), values.max() * (1 + 1e-9), _BINS + 1)
    index = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, _BINS - 1)
    total = np.bincount(index, weights, _BINS)
    mean = np.bincount(index, weights * values, _BINS)
    return mean[total > 0] / total[total > 0], total[total > 0] / total.sum()


def mean_acceleration(run: Compressed) -> float:
    """Return the mean absolute acceleration of a run, from the mean speeds in its parts [rad/s2].

    It is at least the standard uncertainty of the change of speed over the run divided by the duration, because angles
    without noise may have no acceleration at all.
    """
    t, y = run.samples.time, run.samples.value
    edges = np.linspace(0, len(t) - 1, int(np.clip(len(run.lift), 4, 12)) + 1).astype(int)
    step = np.diff(t[edges])
    speed = np.diff(y[edges]) / step
    least = 2 * float(np.median(run.samples.sigma)) / float(np.median(step))
    return max(float(np.abs(np.diff(speed)).sum()), least) / float(np.ptp(t))


class WhitenedStretch:
    """A stretch whose rows are whitened by the angle noise.

    The covariance due to process noise is diagonalised once for each correlation time.

    `angle_covariance` is the covariance of the rows due to correlated angle noise, without the white noise of variance
    1.
    """

    def __init__(self, stretch: Stretch, angle_covariance: Array | None) -> None:
        self.stretch = stretch
        self.whitening = stretch.whitening(angle_covariance)
        self._spectra: dict[float, tuple[Array, Array, float]] = {}

    def spectrum(self, time: float) -> tuple[Array, Array, float]:
        """Return independent rows, and the variance of each row due to process noise.

        Also return the rms of the process noise [rad/s2].
        """
        if time not in self._spectra:
            covariance, unit = self.stretch.torque_covariance(time)
            values, vectors = np.linalg.eigh(self.whitening @ covariance @ self.whitening.T)
            rows = vectors.T @ (self.whitening @ self.stretch.projected)
            self._spectra[time] = rows, np.maximum(values, 0.0), unit
        return self._spectra[time]


class StretchLikelihood:
    """The restricted likelihood of process noise of a run whose motion is a polynomial in each stretch."""

    def __init__(self, parts: Sequence[WhitenedStretch]) -> None:
        self.parts = list(parts)
        self._known: dict[tuple[float, ...], tuple[list[Array], Array]] = {}

    @classmethod
    def of(cls, stretches: Sequence[Stretch], angle_covariance: Array | None) -> Self:
        """Return the likelihood of stretches whose rows have this covariance due to correlated angle noise."""
        return cls([WhitenedStretch(s, angle_covariance) for s in stretches])

    def unit(self, time: float) -> float:
        """Return the rms acceleration whose effect exceeds the noise in half of the rows [rad/s2]."""
        return float(np.median([p.stretch.torque_covariance(time)[1] for p in self.parts]))

    def __call__(self, time: float, levels: Array) -> Array:
        """Return the log-likelihood of each level [rad/s2] at a correlation time."""
        total = np.zeros(len(levels))
        for part in self.parts:
            rows, values, unit = part.spectrum(time)
            found = _log_likelihood(rows, values, levels / unit)
            if len(self.parts) > _FEW_STRETCHES:
                any_level = _log_likelihood(rows, values, _LEVELS)
                average = float(np.logaddexp.reduce(any_level)) - np.log(len(any_level))
                found = np.logaddexp(np.log1p(-_OWN_LEVEL_SHARE) + found, np.log(_OWN_LEVEL_SHARE) + average)
            total += found
        return total

    def marginal(self, times: Sequence[float]) -> float:
        """Return the log-likelihood with the level, and correlation times of equal prior probability, integrated out.

        All stretches have the same level, because separate levels would absorb the slow part of angle noise.
        """
        resolution = 2 * times[0] * self.unit(times[0]) ** 2
        found, total = -np.inf, -np.inf
        for time in times:
            levels = self.unit(time) * _LEVELS
            prior = _log_prior(levels, time, resolution)
            found = np.logaddexp(found, np.logaddexp.reduce(self(time, levels) + prior))
            total = np.logaddexp(total, np.logaddexp.reduce(prior))
        log_determinant = float(sum(np.log(np.diag(p.whitening)).sum() for p in self.parts))
        return float(found - total) + log_determinant

    def is_consistent_with(self, finer: StretchLikelihood, times: Array) -> bool:
        """Return whether shorter stretches allow the process noise that these stretches need.

        Stretches whose polynomials do not follow the motion need more process noise.
        """
        levels, there = finer._on_levels(times)
        here = np.array([self(t, x) for t, x in zip(times, levels, strict=True)])
        allowed = 2 * (there.max() - there) < CONSISTENT
        return bool(2 * (here.max() - here[allowed].max()) < CONSISTENT)

    def _on_levels(self, times: Array) -> tuple[list[Array], Array]:
        """Return levels [rad/s2] for each time, and their log-likelihoods; cached for several comparisons."""
        key = tuple(times.tolist())
        if key not in self._known:
            levels = [self.unit(t) * _LEVELS for t in times]
            likelihoods = np.array([self(t, x) for t, x in zip(times, levels, strict=True)])
            self._known[key] = levels, likelihoods
        return self._known[key]


def _log_likelihood(rows: Array, values: Array, levels: Array) -> Array:
    """Return the log-likelihood of independent rows of variance 1 + level^2 value, for each level."""
    variance = 1 + levels[:, None] ** 2 * values
    return np.asarray(-0.5 * (np.log(variance) + rows**2 / variance).sum(axis=1))


class Stretch:
    """Rows of some neighbouring blocks, orthogonal to a polynomial in time and to the nuisance functions."""

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
        nuisance = nuisance[self.rows]
        if nuisance.shape[1] > len(nuisance):
            # Use only as many orthogonal combinations of the functions as there are rows, because this stretch contains
            # no information about further combinations. Principal combinations are used: they separate functions with a
            # flat prior, whose columns are very large, from the other functions.
            directions, sizes, _ = np.linalg.svd(nuisance, full_matrices=False)
            nuisance = directions * sizes
        # the last rows belong to the prior of the nuisance functions; their measured value is zero
        free = np.block(
            [
                [self._rows_of(powers), nuisance],
                [np.zeros((nuisance.shape[1], degree + 1)), np.eye(nuisance.shape[1])],
            ]
        )
        u, s, _ = np.linalg.svd(free / np.linalg.norm(free, axis=0), full_matrices=True)
        self._complement = u[: len(nuisance), int((s > 1e-7 * s[0]).sum()) :]
        self.projected = self.project(run.z[self.rows])

    def project(self, rows: Array) -> Array:
        """Return the coordinates of rows of this stretch in the space orthogonal to the free functions."""
        return np.asarray(self._complement.T @ rows)

    def _rows_of(self, values: Array) -> Array:
        return np.asarray((self._lift @ values).reshape(len(self.rows), -1))

    def torque_covariance(self, time: float) -> tuple[Array, float]:
        """Return the covariance due to a random acceleration, with a median variance of 1.

        Also return the rms of this acceleration [rad/s2].
        """
        if time not in self._torques:
            self._torques[time] = self._torque_covariance(time)
        return self._torques[time]

    @cached_property
    def _response(self) -> tuple[Array, Array]:
        """Times of cells, and the response of the projected rows to a unit acceleration in each cell."""
        cells = np.linspace(self._nodes.min(), self._nodes.max(), int(_CELLS_PER_ROW * len(self.rows)))
        width = float(cells[1] - cells[0])
        since = np.maximum(self._nodes[..., None] - cells, 0.0)
        if not self._angle:
            # the speed changes only while the torque of the cell acts
            since = np.minimum(since / width, 1.0)
        return cells, self._complement.T @ self._rows_of(since) * width

    def _torque_covariance(self, time: float) -> tuple[Array, float]:
        cells, response = self._response
        total = response @ np.exp(-np.abs(cells[:, None] - cells) / time) @ response.T
        size = float(np.median(np.diag(total)))
        return np.asarray(total / size), 1 / float(np.sqrt(size))

    def whitening(self, angle_covariance: Array | None) -> Array:
        """Return the matrix that whitens the projected rows, without process noise."""
        m = len(self.projected)
        if angle_covariance is None:
            return np.eye(m)
        inner = self._complement.T @ angle_covariance[np.ix_(self.rows, self.rows)] @ self._complement
        return np.asarray(np.linalg.inv(np.linalg.cholesky(np.eye(m) + inner)))

    def whitenings_at(self, times: Sequence[float], shares: Sequence[float]) -> list[tuple[Array, float]]:
        """Return whitening matrix and deviance at `shares` of the level that is most likely in this stretch alone."""
        best, found = -np.inf, (np.eye(len(self.projected)), np.zeros(len(self.projected)), 0.0)
        for covariance in (self.torque_covariance(t)[0] for t in times):
            values, vectors = np.linalg.eigh(covariance)
            values = np.maximum(values, 0.0)
            likelihood = _log_likelihood(vectors.T @ self.projected, values, _GRID)
            i = int(np.argmax(likelihood))
            if likelihood[i] > best:
                best, found = float(likelihood[i]), (vectors.T, values, float(_GRID[i]))
        vectors, values, level = found
        variances = [1 + (share * level) ** 2 * values for share in shares]
        rows = vectors @ self.projected
        return [(vectors / np.sqrt(v)[:, None], float(np.sum(np.log(v) + rows**2 / v))) for v in variances]

    def likelihood(self, angle_covariance: Array | None) -> float:
        """Return the restricted log-likelihood without process noise."""
        whitening = self.whitening(angle_covariance)
        white = whitening @ self.projected
        return float(np.log(np.diag(whitening)).sum()) - 0.5 * float(white @ white)

    def most_likely_level(self, times: Sequence[float]) -> float:
        """Return the most likely level of process noise for white angle noise, over some correlation times [rad/s2]."""
        best = (-0.5 * float(self.projected @ self.projected), 0.0)
        for covariance, unit in map(self.torque_covariance, times):
            values, vectors = np.linalg.eigh(covariance)
            likelihood = _log_likelihood(vectors.T @ self.projected, np.maximum(values, 0.0), _GRID)
            i = int(np.argmax(likelihood))
            best = max(best, (float(likelihood[i]), float(_GRID[i]) * unit))
        return best[1]


def split_into_stretches(run: Compressed, nuisance: Array) -> list[Stretch]:
    """Return at most six stretches of a run, with a polynomial and the nuisance functions free in each."""
    blocks = len(run.lift)
    parts = np.array_split(np.arange(blocks), max(1, min(_MOST_STRETCHES, blocks // 4)))
    return [Stretch(run, part, nuisance, 3 if len(part) < 8 else len(part) + 1) for part in parts]
