"""Lossless compression of samples by projection on polynomials.

The samples of a block are projected on polynomials in time and on the first two harmonics of the measured angle. A
weighted QR decomposition uses the actual times of the samples. A smooth model is a polynomial within a block, so the
chi-square of the model depends only on these projections; the orthogonal part of the samples is noise. The polynomials
of the next higher degrees contain no part of the model. Their rows measure the noise at the relevant low frequencies,
including any correlation between neighbouring samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.polynomial import chebyshev
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from fitting.dynamics._collocation import TOLERANCE
from fitting.dynamics._inputs import Input
from fitting.inference._linear_algebra import orthogonal_to
from fitting.inference._record import Samples

Array = NDArray[np.float64]

HARMONICS = 4
"""Number of rows for the harmonics of the angle [rows]. Derived: sine and cosine of the first two, which a displaced
centre and a tilt of the camera cause."""
_MIN_INDEPENDENCE = 0.2
"""A harmonic has rows if its part orthogonal to the polynomials has at least this share of its amplitude [1]. Chosen:
with a smaller value, the harmonic rows of slow blocks contain motion; a larger one drops information about
harmonics."""
_SMALL_CHANGE = 1e-3
"""Change of an angle below which the integrals of its harmonics are computed as series [rad]. Derived: the neglected
fourth power is 1e-12."""
_MIN_RESPONSE = 1e-6
"""A response to a harmonic torque has a part that is orthogonal to polynomials and harmonics. This part is rounding
error if its share of the response is below this value [1]. Chosen: a smaller value adds rows of rounding errors, a
larger one drops weak responses."""


def _harmonics(y: Array) -> Array:
    return np.stack([np.cos(y), np.sin(y), np.cos(2 * y), np.sin(2 * y)], axis=1)


def independent_harmonics(y: Array, polynomials: Array) -> Array:
    """Return cos y, sin y, cos 2y, sin 2y, with zeros for harmonics that are nearly polynomials.

    In less than a turn, a harmonic contains no information beyond the polynomials: its orthogonal part would be noise
    of y. For a casing at rest the whole harmonic is noise.
    """
    waves = _harmonics(y)
    r = np.abs(np.diag(np.linalg.qr(np.concatenate([polynomials, waves], axis=1), mode="r")))
    keep = r[polynomials.shape[1] :] > _MIN_INDEPENDENCE * np.sqrt(len(y) / 2)
    return np.asarray(np.where(keep, waves, 0.0))


def integrated(time: Array, values: Array) -> Array:
    """Return the integral of values over time by the trapezoidal rule, along the first axis."""
    steps = 0.5 * (values[1:] + values[:-1]).T * np.diff(time)
    return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(steps, axis=-1).T])


def responses_to_harmonics(time: Array, psi: Array) -> tuple[Array, Array]:
    """Return speeds and angles due to accelerations cos(m psi) and sin(m psi), m = 1 and 2, (samples, 4) each.

    Between samples, the angle is interpolated linearly. Over a step h in which m psi changes by x, the speed increases
    by h exp(i m psi) (exp(i x) - 1) / (i x), and the angle by h times the speed plus h^2 exp(i m psi) (1 + i x - exp(i
    x)) / x^2 (real and imaginary parts). The initial state is chosen so that there is no drift, up to an error of the
    order of amplitude / number of turns.
    """
    step = np.diff(time)[:, None]
    phase = psi[:, None] * [1, 2]
    x = np.diff(phase, axis=0)
    small = np.abs(x) < _SMALL_CHANGE
    safe = np.where(small, 1.0, x)
    turned = np.exp(1j * safe)
    series = 1 + 1j * x / 2 - x**2 / 6 - 1j * x**3 / 24, 1 / 2 + 1j * x / 6 - x**2 / 24 - 1j * x**3 / 120
    gain = np.where(small, series[0], (turned - 1) / (1j * safe))
    onward = np.where(small, series[1], (1 + 1j * safe - turned) / safe**2)
    wave, start = np.exp(1j * phase[:-1]), np.zeros((1, 2))
    speed = np.concatenate([start, np.cumsum(step * wave * gain, axis=0)])
    angle = np.concatenate([start, np.cumsum(step * speed[:-1] + step**2 * wave * onward, axis=0)])
    speeds, angles = (
        np.stack([y[:, 0].real, y[:, 0].imag, y[:, 1].real, y[:, 1].imag], axis=1) for y in (speed, angle)
    )
    drift = np.stack([np.ones_like(time), time - time.mean()], axis=1)
    return speeds - speeds.mean(axis=0), angles - drift @ np.linalg.lstsq(drift, angles, rcond=None)[0]


_TIME_CONSTANTS = 8
"""Number of time constants for the responses to an input [1]. Chosen: with fewer, responses with other time constants
count as noise; with more, more rows are needed."""
_SHORTEST = 2.0
"""Shortest time constant of a response to an input, relative to the sampling interval [1]. Chosen: a smaller value is
not resolved; with a larger one, fast responses count as noise."""


def responses_to_inputs(time: Array, inputs: Sequence[Input], *, angle: bool) -> Array:
    """Return the speeds, or angles, of first-order systems that inputs drive, (samples, columns).

    The systems d(y)/dt = (u - y) / tau have time constants tau from twice the sampling interval to the length of the
    record. Sums of their responses are close to the response for any time constant in between. The input u is averaged
    over each sampling interval.
    """
    from scipy.signal import lfilter

    step = float(np.median(np.diff(time)))
    even = np.linspace(time[0], time[-1], max(2, round(float(np.ptp(time)) / step) + 1))
    step = float(even[1] - even[0])
    columns = []
    for i in inputs:
        mean = i.means(even)
        mean = (mean - mean[0]) / float(np.abs(mean).max() or 1.0)
        for tau in np.geomspace(_SHORTEST * step, float(np.ptp(time)), _TIME_CONSTANTS):
            a = np.exp(-step / tau)
            response = np.concatenate([[0.0], np.asarray(lfilter([1 - a], [1.0, -a], mean))])
            columns.append(integrated(even, response) if angle else response)
    if not columns:
        return np.zeros((len(time), 0))
    return np.stack([np.interp(time, even, c) for c in columns], axis=1)


_ABRUPT = 0.1
"""Smallest size of an abrupt change, relative to the range of the input [1]. Chosen: with a smaller value, blocks are
cut at noise; with a larger one, blocks contain kinks of the motion."""
_MOST_STEPS = 12
"""Largest number of abrupt changes of an input that is a sequence of steps [1]. Chosen: with a larger number, some
blocks have too few samples; a smaller one refuses stepped inputs."""
_AFTER_STEP = (20, 40)
"""Number of samples of the first blocks after a step [samples]. Chosen: the response changes fastest there, and later
blocks have the usual length; with a smaller number, no samples remain for the noise; a larger one needs a higher
degree."""


def cuts_at_steps(time: Array, inputs: Sequence[Input]) -> NDArray[np.int_]:
    """Return the samples at which blocks begin because an input changes abruptly; blocks after a step are short.

    The motion has a kink at the step and changes fastest after it. An input that changes too often is not used.
    """
    cuts: list[int] = []
    for i in inputs:
        at, change = i.jumps()
        abrupt = at[np.abs(change) > _ABRUPT * float(np.ptp(i.value))]
        abrupt = abrupt[(abrupt > time[0]) & (abrupt < time[-1])]
        if len(abrupt) <= _MOST_STEPS:
            first = np.searchsorted(time, abrupt)
            cuts += [int(x) for k in np.cumsum([0, *_AFTER_STEP]) for x in first + k]
    return np.unique(np.array(cuts, dtype=int))


def _with_cuts(edges: NDArray[np.int_], cuts: NDArray[np.int_]) -> NDArray[np.int_]:
    """Return the edges of blocks with `cuts` added, without blocks shorter than the first block after a step."""
    least = _AFTER_STEP[0]
    kept = [int(edges[0])]
    for c in cuts:
        if c - kept[-1] >= least and edges[-1] - c >= least:
            kept.append(int(c))
    kept.append(int(edges[-1]))
    own = np.array(kept)
    far = [e for e in edges if np.abs(own - e).min() >= least]
    return np.array(sorted({*kept, *(int(e) for e in far)}))


def harmonic_scatter(rows: Array) -> Array:
    """Return the scatter of harmonics between blocks divided by the noise, at least 1.

    Tracking artefacts (a smoothed centre, a marker degraded by the codec) vary from block to block; harmonics of a
    torque are smooth in time, so their second difference is small.
    """
    if len(rows) < 12:
        return np.ones(rows.shape[1])
    second = np.abs(rows[2:] - 2 * rows[1:-1] + rows[:-2]) / np.sqrt(6.0)
    size = np.median(second, axis=0) / 0.6745
    pairs = np.sqrt(0.5 * (size[0::2] ** 2 + size[1::2] ** 2))
    return np.asarray(np.maximum(1.0, np.repeat(pairs, 2)))


CASING_DEGREE = 7
"""Degree of the polynomial of a block of the casing [1]. Chosen: a smaller value does not follow the motion, a larger
one costs rows."""
ROTOR_DEGREE = 7
"""Degree of the polynomial of a window of the rotor [1]. Chosen: equal to `CASING_DEGREE`; a smaller value does not
follow the motion, a larger one costs rows."""
NOISE_ROWS = 14
"""Number of further polynomials of a block, which measure the white noise [1]. Chosen: with fewer, the noise is known
less precisely; with more, it is measured at irrelevant frequencies."""
BLOCKS = 60
"""Number of blocks of a record of angles [1]. Chosen: a smaller number needs a higher degree; with a larger one, few
samples remain for the noise."""
_MIN_SAMPLES = 60
"""Smallest number of samples of a block [samples]. Chosen: with a smaller number, no samples remain for the noise; a
larger one blurs fast motion."""
_SPEED_RATIO = 1.6
"""Ratio of the largest to the smallest speed in a block above which the block is cut [1]. Chosen: a smaller value makes
short blocks, a larger one fits a single polynomial to an angle whose speed changes much."""
_AT_REST = 0.003
"""A body counts as at rest if its speed, as a share of the largest speed, is below this value [1]. Chosen: with a
smaller value, blocks are divided needlessly if the casing comes to rest; with a larger one, slow turns remain in long
blocks."""
_MOST_CUTS = 12
"""Largest number of edges that are added to blocks in which the speed changes by a large factor [1]. Chosen: with a
smaller number, blocks contain fast changes; with a larger one, few samples remain for the noise."""
_BINS = 128
"""Number of groups into which the samples of a block are divided for the covariance of correlated noise [1]. Chosen: a
smaller number blurs short correlations, a larger one costs time and memory."""
_SAME = 1e-7
"""Smallest range of a harmonic that is more than rounding error [1]. Chosen: a smaller value adds rows of rounding
errors, a larger one drops slowly turning bodies."""
_CLIP = 3.0
"""Values with a larger deviation are excluded from the estimate of the noise [standard deviations]. Chosen: a smaller
value loses efficiency, a larger one includes outliers."""
_CLIPPED_VARIANCE = 0.9733
"""Variance of a standard normal variable truncated at 3 [1]. Derived: 1 - 6 phi(3) / (2 Phi(3) - 1), at `_CLIP`."""


@dataclass(frozen=True)
class Compressed:
    """The samples of one series, projected."""

    node_times: Array  # (blocks * (degree + 1),): where a smooth model is evaluated [s]
    lift: Array  # (blocks, degree + 1, degree + 1): from values at the nodes to projected values
    z: Array  # polynomial rows of all blocks, in units of the noise
    harmonic: Array  # projections on the harmonics, in units of the noise
    operators: tuple[tuple[slice, Array], ...]  # samples of each block and the rows that project them
    scale: float  # noise, divided by the stated sigma
    rest: float  # chi-square of the samples orthogonal to all rows, in units of the calibrated noise
    rest_dof: int
    n_effective: float  # number of samples, reduced by their correlation
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

    @cached_property
    def harmonic_exists(self) -> NDArray[np.bool_]:
        """Mask of the rows of harmonics that polynomials of the block do not represent."""
        k = self.lift.shape[1]
        return np.concatenate([operator[k:].any(axis=1) for _, operator in self.operators])

    @cached_property
    def binned_operators(self) -> list[tuple[Array, Array]]:
        """For each block, the mean times of groups of samples, and the polynomial rows of a constant in each group."""
        return self.operators_of_bins(_BINS)

    def operators_of_bins(self, bins: int) -> list[tuple[Array, Array]]:
        """Return `binned_operators` for another number of groups in each block."""
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
    angle: Array | None = None,
    blocks: int = BLOCKS,
    noisy: bool = True,
    noise_rows: int = NOISE_ROWS,
    samples_per_block: int = _MIN_SAMPLES,
    first_noise_row: int | None = None,
    cuts: NDArray[np.int_] | None = None,
    driven: Array | None = None,
    modes: Array | None = None,
) -> Compressed:
    """Project the samples of a series block by block, with the noise calibrated on the rows that contain no model.

    `degree` is the highest power of the polynomials that describe the motion. The first two harmonics of `angle` [rad]
    (the values themselves, or the integral of measured speeds) have separate rows. `noise_rows` polynomials of each
    block measure the noise. Their powers begin with `first_noise_row` (by default the power after `degree`). More noise
    rows are needed if there are few blocks and the noise of neighbouring samples is correlated. Without `noisy`, the
    noise is not estimated, and the sigma of the samples is used. `blocks` is the largest number of blocks,
    `samples_per_block` the smallest number of samples in a block. Further blocks begin at the samples `cuts`. `driven`
    (samples, columns) are responses to recorded inputs, and `modes` (samples, columns) are errors with amplitudes of
    variance 1; neither counts as noise.
    """
    count = max(1, min(blocks, len(samples) // samples_per_block))
    edges = np.linspace(0, len(samples), count + 1).astype(int)
    if angle is not None:
        edges = _cut_where_slow(samples.time, angle, edges)
    if cuts is not None and len(cuts):
        edges = _with_cuts(edges, cuts)
    skipped = max(0, (first_noise_row or 0) - degree - 1)
    quiet = samples if modes is None or not modes.any() else _without_modes(samples, modes, edges, degree)
    parts = [
        _block(quiet, slice(a, b), degree, noise_rows, skipped, angle, driven) for a, b in pairwise(edges)
    ]
    # a body at rest, measured with a coarse resolution, has equal values, which contain no noise
    still = [not np.ptp(samples.value[p.where]) for p in parts]
    slow = np.concatenate([p.noise for p, rests in zip(parts, still, strict=True) if not rests or all(still)])
    rest, dof = sum(p.rest for p in parts), sum(p.rest_dof for p in parts)
    fast = rest / dof if dof > 0 else 1.0
    variance = _robust_variance(slow) if len(slow) >= 20 else fast
    # the scatter of values without noise, for example in a computed table, consists of rounding errors and errors of
    # the integration
    least = (TOLERANCE * float(np.abs(samples.value).max()) / float(np.median(samples.sigma))) ** 2
    variance, fast = max(variance, least), max(fast, least)
    scale = float(np.sqrt(variance)) if variance > 0 else 1.0
    correlation = max(1.0, variance / fast) if fast > 0 else 1.0
    if not noisy:
        scale, correlation, fast = 1.0, 1.0, 1.0
    k = degree + 1
    spread = np.full(parts[0].rows.shape[0], scale)
    if angle is samples.value:
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


def _without_modes(samples: Samples, modes: Array, edges: NDArray[np.int_], degree: int) -> Samples:
    """Return samples minus the posterior mean of the errors that are not polynomials within a block.

    Let F be the modes and r the values, both divided by sigma and without their polynomial in each block. The posterior
    mean of amplitudes of prior variance 1 is (F'F + 1)^-1 F'r. The fit itself estimates the errors that are slow within
    a block.
    """
    gram, moment = np.eye(modes.shape[1]), np.zeros(modes.shape[1])
    for a, b in pairwise(edges):
        t = samples.time[a:b]
        x = 2 * (t - t[0]) / max(float(t[-1] - t[0]), 1e-300) - 1
        weight = 1 / samples.sigma[a:b, None]
        powers = legvander(x, min(degree, b - a - 1)) * weight
        columns = np.concatenate([modes[a:b], samples.value[a:b, None]], axis=1) * weight
        left = orthogonal_to(np.linalg.qr(powers)[0], columns)
        gram += left[:, :-1].T @ left[:, :-1]
        moment += left[:, :-1].T @ left[:, -1]
    return replace(samples, value=samples.value - modes @ np.linalg.solve(gram, moment))


def _cut_where_slow(time: Array, angles: Array, edges: NDArray[np.int_]) -> NDArray[np.int_]:
    """Divide blocks in which the speed changes by a large factor.

    A torque periodic in the angle changes the angle by an amplitude proportional to 1 / speed^2: nearly all information
    about this torque is in the few turns in which the casing is slowest, a small part of a block. The blocks of a
    record in which the casing comes to rest are not divided: in such a block the ratio of speeds diverges within less
    than a turn.
    """
    pieces = np.arange(0, len(time) - _MIN_SAMPLES + 1, _MIN_SAMPLES)
    last = pieces + _MIN_SAMPLES - 1
    speed = np.abs((angles[last] - angles[pieces]) / (time[last] - time[pieces]))
    if len(pieces) == 0 or speed.min() < _AT_REST * speed.max():
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
    slowest = sorted(set(cuts) - set(edges), key=lambda i: speed[i // _MIN_SAMPLES])[:_MOST_CUTS]
    return np.array(sorted({*edges, *slowest}))


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
    samples: Samples,
    where: slice,
    degree: int,
    noise_rows: int,
    skipped: int,
    angle: Array | None,
    driven: Array | None,
) -> _Block:
    t, y, sigma = samples.time[where], samples.value[where], samples.sigma[where]
    k = degree + 1
    middle, half = 0.5 * (t[0] + t[-1]), max(0.5 * (t[-1] - t[0]), 1e-9)
    inputs = 0 if driven is None else driven.shape[1]
    extra = min(skipped + noise_rows, max(0, len(t) - k - HARMONICS - 6 - inputs))
    skipped = min(skipped, extra)
    powers = chebyshev.chebvander((t - middle) / half, degree + extra)
    periodic, responses = np.zeros((len(t), 0)), np.zeros((len(t), 0))
    if angle is not None:
        # The angle is smoothed. Otherwise its noise would also be in the harmonics. If the harmonics are nearly
        # polynomials, this noise would enter the rows that measure the noise.
        smooth = np.linalg.qr(powers[:, :k] / sigma[:, None])[0]
        smoothed = smooth @ (smooth.T @ (angle[where] / sigma)) * sigma
        psi = smoothed if angle is samples.value else angle[where]
        responses = responses_to_harmonics(t, smoothed)[int(angle is samples.value)]
        # If a sensor gives pulses at equal angles, a harmonic may be equal in all samples. With a smoothed angle, it
        # would seem to vary because of errors of the times of the pulses. Therefore the angle is not smoothed here.
        varies = np.ptp(_harmonics(angle[where]), axis=0) > _SAME
        periodic = independent_harmonics(psi, powers[:, :k]) * varies
        responses = responses * np.repeat(varies.reshape(2, 2).any(axis=1), 2)
    chosen = np.flatnonzero(np.any(periodic != 0, axis=0))
    # The response to a torque periodic in the angle is not noise. Where the speed changes, it is not a harmonic and
    # needs separate columns.
    model = np.concatenate([powers[:, :k], periodic[:, chosen]], axis=1) / sigma[:, None]
    responses = responses / sigma[:, None]
    rest_of = responses - model @ np.linalg.lstsq(model, responses, rcond=None)[0]
    independent = np.linalg.norm(rest_of, axis=0) > _MIN_RESPONSE * np.linalg.norm(responses, axis=0)
    responses = rest_of[:, independent & (extra > 0)]
    if driven is not None and extra > 0:
        responses = _with_driven(responses, driven[where] / sigma[:, None], model)
    higher = powers[:, k:] / sigma[:, None]
    responses, higher = _independent(model, responses, higher, skipped)
    design = np.concatenate([model, responses, higher], axis=1)
    q, r = np.linalg.qr(design)
    # the sign convention is the same in all blocks, so that a constant harmonic gives constant rows
    sign = np.where(np.diag(r) < 0, -1.0, 1.0)
    q, r = q * sign, r * sign[:, None]
    kept = k + len(chosen)
    rows = np.zeros((k + HARMONICS * (angle is not None), len(t)))
    rows[np.concatenate([np.arange(k), k + chosen])] = q[:, :kept].T / sigma
    x = np.cos(np.pi * (np.arange(k) + 0.5) / k)
    lift = r[:k, :k] @ np.linalg.inv(chebyshev.chebvander(x, degree))
    projected = q.T @ (y / sigma)
    fixed = kept + responses.shape[1] + skipped
    noise = projected[fixed:]
    rest = float(np.sum((y / sigma) ** 2) - np.sum(projected[:fixed] ** 2))
    # angles may be large, so the projection is subtracted before squaring
    if rest < 1e-6 * np.sum((y / sigma) ** 2):
        rest = float(np.sum((y / sigma - q[:, :fixed] @ projected[:fixed]) ** 2))
    return _Block(where, middle + half * x, lift, rows, noise, rest, max(0, len(t) - fixed))


_INDEPENDENT = 1e-4
"""Smallest relative singular value of independent responses and polynomials [1]. Chosen: with a smaller value, rounding
errors of the times enter the noise; a larger one loses noise rows."""
_TINY = 1e-300
"""Smallest norm by which a column is divided [1]. Derived: a column of zeros remains zero, without a division by
zero."""
_DEPENDENT = 1e-6
"""Smallest share of a response to an input that must be orthogonal to the other responses and to the model [1]. Chosen:
a smaller value keeps rounding errors; with a larger one, a part of the response counts as noise."""


def _independent(model: Array, responses: Array, higher: Array, skipped: int) -> tuple[Array, Array]:
    """Return responses and higher polynomials of a block as independent columns; the last columns measure the noise.

    In a few turns, a response is nearly a polynomial, and rounding errors would determine the directions of a QR
    decomposition. Such a response is replaced by the first `skipped` higher polynomials.
    """
    columns = np.concatenate([model, responses, higher], axis=1)
    values = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), _TINY), compute_uv=False)
    if not responses.shape[1] or values[-1] > _INDEPENDENT * values[0]:
        return responses, higher
    known = np.linalg.qr(np.concatenate([model, higher[:, :skipped]], axis=1))[0]
    rest = responses / np.maximum(np.linalg.norm(responses, axis=0), _TINY)
    u, s, _ = np.linalg.svd(rest - known @ (known.T @ rest), full_matrices=False)
    responses = u[:, s > _INDEPENDENT]
    known = np.concatenate([known, responses], axis=1)
    # the highest polynomials come first, because they contain the least motion
    noise = higher[:, skipped:][:, ::-1]
    noise = noise - known @ (known.T @ noise)
    r = np.abs(np.diag(np.linalg.qr(noise, mode="r")))
    kept = r > _INDEPENDENT * np.linalg.norm(higher[:, : noise.shape[1]], axis=0).max(initial=0.0)
    return responses, np.concatenate([higher[:, :skipped], noise[:, kept]], axis=1)


def _with_driven(responses: Array, driven: Array, model: Array) -> Array:
    """Return responses to harmonics and to inputs, all orthogonal to the model of a block, as independent columns."""
    rest = driven - model @ np.linalg.lstsq(model, driven, rcond=None)[0]
    size = np.linalg.norm(driven, axis=0)
    both = np.concatenate([responses, rest[:, size > 0] / size[size > 0]], axis=1)
    u, s, _ = np.linalg.svd(both, full_matrices=False)
    return np.asarray(u[:, s > _DEPENDENT])


def _robust_variance(values: Array) -> float:
    variance = float(np.median(values**2)) / 0.4549
    for _ in range(20):
        clipped = values[np.abs(values) < _CLIP * np.sqrt(variance)]
        updated = float(np.mean(clipped**2)) / _CLIPPED_VARIANCE if len(clipped) else variance
        if abs(updated - variance) < 1e-4 * variance:
            break
        variance = updated
    return variance
