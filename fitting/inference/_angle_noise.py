"""Correlated measurement noise of the angles of a recording, estimated once and used for every fit.

Tracking errors are not white: a hub that is estimated from neighbouring frames, a hand-held camera or a codec move the
measured angle for a time. Beside the white noise of the frames the angle noise of a run has the covariance

    cov[n(t), n(t')] = a^2 exp(-|t - t'| / T),

an Ornstein-Uhlenbeck process of standard deviation a and correlation time T. Projected rows with unit white noise have

    C = 1 + a^2 (P R P' - f 1) + s^2 K,

P the projection, f the mean of P R P' in the band in which the white noise is measured (it is not counted twice), K the
response to a random acceleration. (a, T) maximise the restricted likelihood (H. Patterson, R. Thompson,
Biometrika 58, 545 (1971)) against the most flexible motion: in each of up to six stretches a polynomial with about one
coefficient per block and the camera's nuisance functions are free, and the acceleration noise s has a level and a
correlation time of its own, so that neither a missing effect nor process noise counts as angle noise. No fitted model
enters. Angle noise is included if twice the log-likelihood ratio exceeds 8 beside process noise.

In a short record the two may fit equally well. Then process noise is accepted as long as its torque is smaller than the
mean torque on the body; a random torque larger than the one that slows the body is not credible, and the deviations are
angle noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fitting.inference._compression import NOISE_ROWS, Compressed

Array = NDArray[np.float64]

# twice the logarithm of a likelihood ratio that white noise hardly ever reaches
_SIGNIFICANT = 8.0
_STRETCHES = 6
_BINS = 128
# correlation times in lengths of a block, levels in units of the white noise of the rows
_TIMES = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0, 2.0)
_LEVELS = np.geomspace(0.3, 300.0, 13)
_SCREENED = (2, 5, 8)
_TORQUES = np.concatenate([[0.0], np.geomspace(0.1, 1e5, 31)])
_TORQUE_TIMES = (0.1, 1.0)
_CELLS_PER_ROW = 2.5


@dataclass(frozen=True)
class AngleNoise:
    """Correlated angle noise of the casing.

    Attributes
    ----------
    sigma, sigma_u : float
        Standard deviation a and its standard uncertainty [rad]; 0 if it is not significant.
    time : float
        Correlation time T [s].
    gain : float
        Twice the logarithm of the likelihood ratio of this noise against white noise.
    root, inverse : ndarray, shape (rows, rows)
        C^(1/2) and C^(-1/2) of the polynomial rows, or empty for white noise.
    """

    sigma: float = 0.0
    sigma_u: float = 0.0
    time: float = 0.0
    gain: float = 0.0
    root: Array = field(default_factory=lambda: np.zeros((0, 0)), repr=False)
    inverse: Array = field(default_factory=lambda: np.zeros((0, 0)), repr=False)


def estimate_angle_noise(run: Compressed, nuisance: Array) -> AngleNoise:
    """Estimate the correlated angle noise of a run.

    Parameters
    ----------
    run : Compressed
        Projected angles.
    nuisance : ndarray, shape (rows, columns)
        Polynomial rows of the functions that are free in every fit.

    Returns
    -------
    AngleNoise
        White (`sigma` = 0) if no correlated noise is significant.
    """
    stretches = _stretches(run, nuisance)
    block = float(np.ptp(run.samples.time)) / len(run.lift)
    torques = [[s.torque(block * t) for t in _TORQUE_TIMES] for s in stretches]
    white = sum(s.likelihood(None, ())[0] for s in stretches)
    alone = [s.likelihood(None, t) for s, t in zip(stretches, torques, strict=True)]
    process = sum(found for found, _ in alone)
    credible = max(level for _, level in alone) < _mean_acceleration(run)
    reference = process if credible else white

    def gain(covariance: Array) -> float:
        both = zip(stretches, torques, strict=True)
        found = sum(s.likelihood(covariance, t if credible else ())[0] for s, t in both)
        return 2 * (found - reference)

    covariances = [_covariance(run, block * share) for share in _TIMES]
    units = [1 / np.sqrt(np.median(np.diag(k)) + 1e-300) for k in covariances]
    grid = [(u * _LEVELS[:, None, None]) ** 2 for u in units]
    screened = [[gain(g[j] * k) for j in _SCREENED] for g, k in zip(grid, covariances, strict=True)]
    if np.max(screened) < 0.25 * _SIGNIFICANT:
        return AngleNoise(gain=float(np.max(screened)))
    gains = np.array([[gain(level * k) for level in g] for g, k in zip(grid, covariances, strict=True)])
    i, j = np.unravel_index(int(np.argmax(gains)), gains.shape)
    best = float(gains[i, j])
    if best < _SIGNIFICANT or (not credible and best < 2 * (process - white) - _SIGNIFICANT):
        return AngleNoise(gain=best)
    level, relative_u = _level(gains[i], int(j))
    sigma = level * float(units[i])
    values, vectors = np.linalg.eigh(np.eye(len(covariances[i])) + sigma**2 * covariances[i])
    root = (vectors * np.sqrt(values)) @ vectors.T
    inverse = (vectors / np.sqrt(values)) @ vectors.T
    return AngleNoise(sigma, relative_u * sigma, block * _TIMES[i], best, root, inverse)


def _mean_acceleration(run: Compressed) -> float:
    """Return the mean absolute acceleration of a run, from the mean speeds in its parts [rad/s2]."""
    t, y = run.samples.time, run.samples.value
    edges = np.linspace(0, len(t) - 1, int(np.clip(len(run.lift), 4, 12)) + 1).astype(int)
    speed = np.diff(y[edges]) / np.diff(t[edges])
    return float(np.abs(np.diff(speed)).sum() / np.ptp(t))


def _level(gains: Array, j: int) -> tuple[float, float]:
    """Return the level at the top of a parabola in its logarithm, and its relative standard uncertainty."""
    x = np.log(_LEVELS)
    j = int(np.clip(j, 1, len(x) - 2))
    bend, slope, _ = np.polyfit(x[j - 1 : j + 2] - x[j], gains[j - 1 : j + 2], 2)
    if bend >= 0:
        return float(_LEVELS[j]), 1.0
    step = float(np.clip(-slope / (2 * bend), x[0] - x[1], x[1] - x[0]))
    return float(np.exp(x[j] + step)), float(np.sqrt(-1 / bend))


def _covariance(run: Compressed, time: float) -> Array:
    """Return P R P' - f 1 of a run, without negative eigenvalues."""
    blocks, k, _ = run.lift.shape
    forward, backward, first, last, diagonal = [], [], [], [], []
    for where, operator in run.operators:
        t = run.samples.time[where]
        edges = np.unique(np.linspace(0, len(t), _BINS + 1).astype(int))[:-1]
        p = np.add.reduceat(operator[:k], edges, axis=1)
        middle = np.add.reduceat(t, edges) / np.diff(np.append(edges, len(t)))
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


class _Stretch:
    """Rows of some neighbouring blocks, without what is free in them."""

    def __init__(self, run: Compressed, blocks: NDArray[np.intp], nuisance: Array) -> None:
        k = run.lift.shape[1]
        self.rows = (blocks[:, None] * k + np.arange(k)).ravel()
        self._nodes = run.node_times.reshape(-1, k)[blocks]
        self._lift = run.lift[blocks]
        x = 2 * (self._nodes - self._nodes.min()) / np.ptp(self._nodes) - 1
        degree = 3 if len(blocks) < 8 else len(blocks) + 1
        powers = np.polynomial.legendre.legvander(x.ravel(), degree).reshape(*x.shape, -1)
        free = np.concatenate([self._seen(powers), nuisance[self.rows]], axis=1)
        size = np.linalg.norm(free, axis=0)
        u, s, _ = np.linalg.svd(free[:, size > 0] / size[size > 0], full_matrices=True)
        self._outside = u[:, int((s > 1e-7 * s[0]).sum()) :]
        self.seen = self._outside.T @ run.z[self.rows]

    def _seen(self, values: Array) -> Array:
        return np.asarray((self._lift @ values).reshape(len(self.rows), -1))

    def torque(self, time: float) -> tuple[Array, float]:
        """Return the covariance by a random acceleration, with a median variance of 1, and its rms [rad/s2]."""
        cells = np.linspace(self._nodes.min(), self._nodes.max(), int(_CELLS_PER_ROW * len(self.rows)))
        width = float(cells[1] - cells[0])
        answer = self._outside.T @ self._seen(np.maximum(self._nodes[..., None] - cells, 0.0)) * width
        total = answer @ np.exp(-np.abs(cells[:, None] - cells) / time) @ answer.T
        size = float(np.median(np.diag(total)))
        return np.asarray(total / size), 1 / float(np.sqrt(size))

    def likelihood(self, angle: Array | None, torques: Sequence[tuple[Array, float]]) -> tuple[float, float]:
        """Return the largest restricted log-likelihood over the levels of process noise, and that level [rad/s2]."""
        m = len(self.seen)
        if not m:
            return 0.0, 0.0
        root = np.eye(m)
        constant = 0.0
        if angle is not None:
            inner = self._outside.T @ angle[np.ix_(self.rows, self.rows)] @ self._outside
            lower = np.linalg.cholesky(np.eye(m) + inner)
            root, constant = np.linalg.inv(lower), -float(np.log(np.diag(lower)).sum())
        white = root @ self.seen
        best = (-0.5 * float(white @ white), 0.0)
        for k, unit in torques:
            values, vectors = np.linalg.eigh(root @ k @ root.T)
            seen = vectors.T @ white
            variance = 1 + _TORQUES[:, None] ** 2 * np.maximum(values, 0.0)
            likelihood = -0.5 * (np.log(variance) + seen**2 / variance).sum(axis=1)
            i = int(np.argmax(likelihood))
            best = max(best, (float(likelihood[i]), float(_TORQUES[i]) * unit))
        return constant + best[0], best[1]


def _stretches(run: Compressed, nuisance: Array) -> list[_Stretch]:
    blocks = len(run.lift)
    parts = np.array_split(np.arange(blocks), max(1, min(_STRETCHES, blocks // 4)))
    return [_Stretch(run, part, nuisance) for part in parts]
