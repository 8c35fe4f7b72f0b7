"""Lossless compression: samples of an interval projected on polynomials.

The samples of a block are projected on polynomials in time, and on the first two harmonics of the measured
angle, by a weighted QR decomposition at their actual times. A smooth model is a polynomial within a block,
so its chi-square changes only through these projections; what is orthogonal to them is noise. The next
higher polynomials hold no model either: they measure the noise at the slow end of the spectrum, where it
counts, and with it any correlation between neighbouring samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from fitting.inference._record import Samples

Array = NDArray[np.float64]

HARMONICS = 4
_MIN_INDEPENDENCE = 0.2


def independent_harmonics(y: Array, polynomials: Array) -> Array:
    """Return cos y, sin y, cos 2y, sin 2y, with zeros for those that are nearly polynomials here.

    In less than a turn a harmonic has no information of its own; its part orthogonal to the polynomials would
    be the noise of y itself, which must not be taken for a signal. Of a casing at rest nothing else is left.
    """
    waves = np.stack([np.cos(y), np.sin(y), np.cos(2 * y), np.sin(2 * y)], axis=1)
    r = np.abs(np.diag(np.linalg.qr(np.concatenate([polynomials, waves], axis=1), mode="r")))
    keep = r[polynomials.shape[1] :] > _MIN_INDEPENDENCE * np.sqrt(len(y) / 2)
    return np.asarray(np.where(keep, waves, 0.0))


def harmonic_scatter(rows: Array) -> Array:
    """Return by how much harmonics change from block to block beyond the noise, at least 1.

    An artefact of tracking that wanders (a centre that is smoothed, a marker cut by the codec) does so from
    block to block; what physics does to the harmonics is smooth in time and passes the second difference.
    """
    if len(rows) < 12:
        return np.ones(rows.shape[1])
    second = np.abs(rows[2:] - 2 * rows[1:-1] + rows[:-2]) / np.sqrt(6.0)
    size = np.median(second, axis=0) / 0.6745
    pairs = np.sqrt(0.5 * (size[0::2] ** 2 + size[1::2] ** 2))
    return np.asarray(np.maximum(1.0, np.repeat(pairs, 2)))


CASING_DEGREE = 7
ROTOR_DEGREE = 7
NOISE_ROWS = 14
BLOCKS = 60
_MIN_SAMPLES = 60
_SPEED_RATIO = 1.6
_AT_REST = 0.5  # rad/s
_MOST_CUTS = 12
# groups of samples of a block
_BINS = 128
_CLIP = 3.0
_CLIPPED_VARIANCE = 0.9733  # of a standard normal variable cut off at 3


@dataclass(frozen=True)
class Compressed:
    """The samples of one series, projected.

    Attributes
    ----------
    node_times : ndarray, shape (blocks * (degree + 1),)
        Where a smooth model is evaluated [s].
    lift : ndarray, shape (blocks, degree + 1, degree + 1)
        From values at the nodes to projected values.
    z : ndarray
        Projected samples, in units of the noise: polynomial rows of all blocks.
    harmonic : ndarray
        Projections on the harmonics, in units of the noise.
    operators : tuple of (slice, ndarray)
        For each block its samples and the rows that project them, polynomial rows first.
    scale : float
        Noise over the sigma that came with the data.
    rest, rest_dof : float, int
        Chi-square of what no model reaches, in units of the calibrated noise, and its degrees of freedom.
    n_effective : float
        Number of samples, reduced by their correlation.
    """

    node_times: Array
    lift: Array
    z: Array
    harmonic: Array
    operators: tuple[tuple[slice, Array], ...]
    scale: float
    rest: float
    rest_dof: int
    n_effective: float
    samples: Samples

    def at_nodes(self, values: Array) -> Array:
        """Return the polynomial rows of a smooth function given at the nodes (nodes, ...)."""
        blocks, k, _ = self.lift.shape
        flat = values.reshape(blocks, k, -1)
        return np.asarray((self.lift @ flat).reshape(values.shape))

    def at_samples(self, values: Array) -> tuple[Array, Array]:
        """Return polynomial and harmonic rows of any function given at the samples (samples, columns)."""
        k = self.lift.shape[1]
        parts = [rows @ values[where] for where, rows in self.operators]
        polynomial = np.concatenate([p[:k] for p in parts])
        harmonic = np.concatenate([p[k:] for p in parts])
        return polynomial, harmonic

    def binned_operators(self, bins: int = _BINS) -> list[tuple[Array, Array]]:
        """Return for each block the mean times of groups of samples, and the polynomial rows of a constant in each."""
        k, found = self.lift.shape[1], []
        for where, operator in self.operators:
            t = self.samples.time[where]
            edges = np.unique(np.linspace(0, len(t), bins + 1).astype(int))[:-1]
            middle = np.add.reduceat(t, edges) / np.diff(np.append(edges, len(t)))
            found.append((middle, np.add.reduceat(operator[:k], edges, axis=1)))
        return found


def compress(
    samples: Samples,
    *,
    degree: int,
    harmonics: bool,
    blocks: int = BLOCKS,
    noisy: bool = True,
    noise_rows: int = NOISE_ROWS,
    samples_per_block: int = _MIN_SAMPLES,
    first_noise_row: int | None = None,
) -> Compressed:
    """Project the samples of a series block by block.

    Parameters
    ----------
    samples : Samples
        One run; for harmonics its values must be angles.
    degree : int
        Highest power of the polynomials.
    harmonics : bool
        Whether to keep the first two harmonics of the measured angle as rows of their own.
    blocks : int
        At most so many blocks.
    noisy : bool
        Whether the samples have a noise that can be measured; otherwise their sigma is taken as it is.
    noise_rows : int
        Polynomials of each block, beyond those of a model, that measure the noise: more of them where there are few
        blocks and neighbouring samples share their noise.
    samples_per_block : int
        At least so many samples in a block.
    first_noise_row : int, optional
        Lowest power of the polynomials that measure the noise; the next after `degree` if not given.

    Returns
    -------
    Compressed
        With the noise calibrated on what the model cannot reach.
    """
    count = max(1, min(blocks, len(samples) // samples_per_block))
    edges = np.linspace(0, len(samples), count + 1).astype(int)
    if harmonics:
        edges = _cut_where_slow(samples, edges)
    parts = [
        _block(
            samples,
            slice(a, b),
            degree,
            noise_rows,
            max(0, (first_noise_row or 0) - degree - 1),
            harmonics=harmonics,
        )
        for a, b in pairwise(edges)
    ]
    slow = np.concatenate([p.noise for p in parts])
    rest, dof = sum(p.rest for p in parts), sum(p.rest_dof for p in parts)
    fast = rest / dof if dof > 0 else 1.0
    variance = _robust_variance(slow) if len(slow) >= 20 else fast
    scale = float(np.sqrt(variance)) if variance > 0 else 1.0
    correlation = max(1.0, variance / fast) if fast > 0 else 1.0
    if not noisy:
        scale, correlation, fast = 1.0, 1.0, 1.0
    k = degree + 1
    spread = np.full(parts[0].rows.shape[0], scale)
    if harmonics:
        spread[k:] *= harmonic_scatter(np.stack([p.rows[k:] @ samples.value[p.where] for p in parts]) / scale)
    operators = tuple((p.where, p.rows / spread[:, None]) for p in parts)
    projected = [rows @ samples.value[where] for where, rows in operators]
    return Compressed(
        node_times=np.concatenate([p.node_times for p in parts]),
        lift=np.stack([p.lift for p in parts]) / scale,
        z=np.concatenate([p[:k] for p in projected]),
        harmonic=np.concatenate([p[k:] for p in projected]),
        operators=operators,
        scale=scale,
        rest=rest / fast / correlation if fast > 0 else 0.0,
        rest_dof=int(dof / correlation),
        n_effective=len(samples) / correlation,
        samples=samples,
    )


def _cut_where_slow(samples: Samples, edges: NDArray[np.int_]) -> NDArray[np.int_]:
    """Cut blocks in which the speed grows or falls many times over.

    A torque that follows the angle moves it by an amplitude that falls as 1 / speed^2: nearly all that can be
    learned about it stands in the few turns in which the casing is slowest, a small part of a block. A record in
    which the casing comes to rest keeps its blocks: there the speed falls without end, and no turn is left.
    """
    pieces = np.arange(0, len(samples) - _MIN_SAMPLES + 1, _MIN_SAMPLES)
    last = pieces + _MIN_SAMPLES - 1
    turned = samples.value[last] - samples.value[pieces]
    speed = np.abs(turned / (samples.time[last] - samples.time[pieces]))
    if len(pieces) == 0 or speed.min() < _AT_REST:
        return edges
    cuts = list(edges)
    for begin, end in pairwise(edges):
        inside = np.flatnonzero((pieces >= begin) & (last < end))
        first = inside[0] if len(inside) else 0
        for i in inside[1:]:
            ratio = speed[i] / speed[first]
            if max(ratio, 1 / ratio) > _SPEED_RATIO and pieces[i] - begin >= _MIN_SAMPLES:
                cuts.append(pieces[i])
                first = i
    worth = sorted(set(cuts) - set(edges), key=lambda i: speed[i // _MIN_SAMPLES])[:_MOST_CUTS]
    return np.array(sorted({*edges, *worth}))


@dataclass(frozen=True)
class _Block:
    where: slice
    node_times: Array
    lift: Array
    rows: Array
    noise: Array
    rest: float
    rest_dof: int


def _block(
    samples: Samples, where: slice, degree: int, noise_rows: int, passed: int = 0, *, harmonics: bool
) -> _Block:
    t, y, sigma = samples.time[where], samples.value[where], samples.sigma[where]
    k = degree + 1
    middle, half = 0.5 * (t[0] + t[-1]), max(0.5 * (t[-1] - t[0]), 1e-9)
    extra = min(passed + noise_rows, max(0, len(t) - k - HARMONICS - 6))
    passed = min(passed, extra)
    powers = chebyshev.chebvander((t - middle) / half, degree + extra)
    waves = independent_harmonics(y, powers[:, :k]) if harmonics else np.zeros((len(t), 0))
    chosen = np.flatnonzero(np.any(waves != 0, axis=0))
    design = np.concatenate([powers[:, :k], waves[:, chosen], powers[:, k:]], axis=1) / sigma[:, None]
    q, r = np.linalg.qr(design)
    # one sign in all blocks, so that a steady harmonic gives steady rows
    sign = np.where(np.diag(r) < 0, -1.0, 1.0)
    q, r = q * sign, r * sign[:, None]
    kept = k + len(chosen)
    rows = np.zeros((k + HARMONICS * harmonics, len(t)))
    rows[np.concatenate([np.arange(k), k + chosen])] = q[:, :kept].T / sigma
    x = np.cos(np.pi * (np.arange(k) + 0.5) / k)
    lift = r[:k, :k] @ np.linalg.inv(chebyshev.chebvander(x, degree))
    projected = q.T @ (y / sigma)
    noise = projected[kept + passed :]
    fixed = kept + passed
    rest = float(np.sum((y / sigma) ** 2) - np.sum(projected[:fixed] ** 2))
    if rest < 1e-6 * np.sum((y / sigma) ** 2):  # large angles: subtract before squaring
        rest = float(np.sum((y / sigma - q[:, :fixed] @ projected[:fixed]) ** 2))
    return _Block(where, middle + half * x, lift, rows, noise, rest, max(0, len(t) - fixed))


def _robust_variance(values: Array) -> float:
    variance = float(np.median(values**2)) / 0.4549
    for _ in range(20):
        clipped = values[np.abs(values) < _CLIP * np.sqrt(variance)]
        updated = float(np.mean(clipped**2)) / _CLIPPED_VARIANCE if len(clipped) else variance
        if abs(updated - variance) < 1e-4 * variance:
            break
        variance = updated
    return variance
