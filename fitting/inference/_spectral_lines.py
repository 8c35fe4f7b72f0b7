"""Spectral lines of a recording: sinusoidal torques of a single frequency, which do not count as noise.

A fan, a vibrating table or mains hum drives the casing at one frequency. Process noise has a continuous spectrum. A
spectral line is therefore a torque that an effect has to explain, and it counts neither as process noise nor as
correlated angle noise. The angle then contains

    a cos(w t) + b sin(w t)

over the whole record. In each stretch of the record, the rows orthogonal to the polynomials
(`fitting.inference._process_noise`) are whitened by the process noise of the stretch. The columns of cosine and sine
are fitted to these rows at every frequency with at least ten periods in the record. The deviance with and without the
columns is minimised over the level of the process noise. The probability that noise alone reaches a chi-square of 2 z,
with two degrees of freedom, anywhere in a band of width f is

    p = W sqrt(z) exp(-z),   W = f sqrt(4 pi var t)

(R. Baluev, Mon. Not. R. Astron. Soc. 385, 1279 (2008), eq. 6). A kink or a jump has a broad spectrum in one stretch.
Therefore a line has to remain significant if any one stretch is left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from fitting._criteria import DEFAULT, Criteria
from fitting.inference._compression import Compressed
from fitting.inference._linear_algebra import orthogonal_to, orthonormal
from fitting.inference._process_noise import FLAT_PRIOR_SIGMA, Stretch, split_into_stretches

Array = NDArray[np.float64]

_FEWEST_PERIODS = 10
"""Smallest number of periods of a line in a record [1]. Chosen: with fewer, a line is a slow torque; with a larger
value, slow lines count as process noise."""
_PER_PEAK = 2
"""Number of trial frequencies per width of a peak; the width is 2 pi divided by the length of the record [1]. Chosen: a
smaller number passes over peaks, a larger one costs time; the finer search follows."""
_FINER = 16
"""Number of trial frequencies of the finer search about the highest peak, per coarse step [1]. Chosen: with fewer, the
height of the peak is underestimated; with more, the search takes longer."""
_FASTEST = 2.5
"""Highest frequency [rad per row]. Chosen: below the Nyquist limit, pi; with a larger value, lines are not resolved by
the rows; a smaller one overlooks fast lines."""
_MOST = 4
"""Largest number of lines in a record [1]. Chosen: with a smaller number, some lines count as process noise; a larger
one divides a broad spectrum into lines."""
_RETAINED = 0.05
"""A line is tested only if at least this share of the norm of its rows is orthogonal to the polynomials [1]. Chosen: a
smaller value finds lines in the motion, a larger one overlooks slow lines."""
_TINY = 1e-6
"""The phase is not determined if the determinant of the normal matrix of cosine and sine, divided by the product of its
diagonal, is below this value [1]. Chosen: a smaller value inverts rounding errors, a larger one drops lines in short
stretches."""
_ROUNDING = 1e-7
"""Relative singular value below which a direction is rounding error [1]. Chosen: a smaller value projects out rounding
errors; with a larger one, some nuisance columns are not projected out."""
_SHARES = (1.0, 0.5, 0.25, 0.12, 0.06)
"""Trial levels, divided by the most likely process noise without a line [1]. Chosen: the process noise without a line
is an upper bound; with fewer levels, the minimum of the deviance is overlooked; with more, the search takes longer."""


def false_alarm_probability(chi2: float, band: float, span: float) -> float:
    """Return the probability that noise reaches a `chi2` of two degrees of freedom anywhere in a `band` [Hz].

    The record of length `span` [s] is evenly covered.
    """
    z = 0.5 * chi2
    independent = band * span * math.sqrt(4 * math.pi / 12)
    return min(1.0, math.exp(-z) * (1 + independent * math.sqrt(z)))


class SpectralLine(NamedTuple):
    """Angular frequency [rad/s] and amplitude of a line, in units of the samples (rad, or rad/s)."""

    rate: float
    amplitude: float


def spectral_lines(
    run: Compressed, nuisance: Array, criteria: Criteria = DEFAULT
) -> tuple[SpectralLine, ...]:
    """Return the lines of a run with a p-value below `Criteria.spectral_line`, the strongest first.

    `nuisance` (rows, columns) are the polynomial rows of the nuisance functions at one standard deviation of their
    prior.
    """
    found: list[SpectralLine] = []
    while len(found) < _MOST:
        free = np.concatenate(
            [nuisance, FLAT_PRIOR_SIGMA * line_rows(run, [line.rate for line in found])], axis=1
        )
        line = _strongest(run, split_into_stretches(run, free), criteria)
        if line is None:
            break
        found.append(line)
    return tuple(found)


def line_rows(run: Compressed, rates: Sequence[float] | Array) -> Array:
    """Return the polynomial rows of the cosine and the sine of each line, shape (rows, 2 lines)."""
    if not len(rates):
        return np.zeros((len(run.z), 0))
    start, rates = run.samples.time[0], np.asarray(rates)
    parts = []
    for middle, operator in run.binned_operators:
        phase = np.outer(middle - start, rates)
        parts.append(operator @ np.concatenate([np.cos(phase), np.sin(phase)], axis=1))
    return np.concatenate(parts)


def p_value_of_response(run: Compressed, nuisance: Array, camera: Array, responses: Array) -> float:
    """Return the p-value of the fall of the deviance if responses of the angle to a torque are added.

    Parameters
    ----------
    run : Compressed
        Projected angles.
    nuisance : ndarray, shape (rows, columns)
        Polynomial rows of the nuisance functions, at one standard deviation of their prior.
    camera : ndarray, shape (rows, columns)
        Rows of harmonics of the same functions.
    responses : ndarray, shape (samples, columns)
        The responses at the samples.
    """
    smooth, waves = run.at_samples(responses)
    size = np.linalg.norm(np.concatenate([smooth, waves]), axis=0)
    smooth, waves = smooth[:, size > 0] / size[size > 0], waves[:, size > 0] / size[size > 0]
    basis = orthonormal(camera, _ROUNDING)
    data, waves = orthogonal_to(basis, run.harmonic), orthogonal_to(basis, waves)
    # if camera errors vary from block to block, the noise of the harmonics exceeds the noise of the samples
    left = orthogonal_to(orthonormal(waves, _ROUNDING), data)
    free = int(run.harmonic_exists.sum()) - basis.shape[1] - waves.shape[1]
    scale = math.sqrt(max(1.0, float(left @ left) / max(free, 1)))
    stretches = split_into_stretches(run, nuisance)
    noises = [s.whitenings_at(_noise_times(run), _SHARES) for s in stretches]
    deviances = np.sum([[d for _, d in noise] for noise in noises], axis=0)
    falls = [0.0]
    for i, deviance in enumerate(deviances - deviances.min()):
        whitened = [(noise[i][0], s) for s, noise in zip(stretches, noises, strict=True)]
        columns = np.concatenate([*(w @ s.project(smooth[s.rows]) for w, s in whitened), waves / scale])
        rows = np.concatenate([*(w @ s.projected for w, s in whitened), data / scale])
        falls.append(float(np.sum((orthonormal(columns, _ROUNDING).T @ rows) ** 2) - deviance))
    return float(chdtrc(max(1, smooth.shape[1]), max(falls)))


def _noise_times(run: Compressed) -> tuple[float, ...]:
    """Return correlation times of the process noise of stretches [s]."""
    block = float(np.ptp(run.samples.time)) / len(run.lift)
    return 0.03 * block, 0.3 * block, block


def _strongest(run: Compressed, stretches: Sequence[Stretch], criteria: Criteria) -> SpectralLine | None:
    """Return the most significant line; None if there is none."""
    span = float(np.ptp(run.samples.time))
    lowest, highest = 2 * np.pi * _FEWEST_PERIODS / span, _FASTEST * len(run.z) / span
    step = 2 * np.pi / span / _PER_PEAK
    if highest <= lowest:
        return None
    noises = [s.whitenings_at(_noise_times(run), _SHARES) for s in stretches]

    def left_out(parts: Array) -> Array:
        """Return, for each stretch, the sum over all other stretches."""
        return parts if len(parts) == 1 else parts.sum(axis=0) - parts

    deviance = left_out(np.array([[d for _, d in noise] for noise in noises]))
    deviance -= deviance.min(axis=1, keepdims=True)

    def gain(rates: Array) -> Array:
        """Return the smallest fall of the deviance at each frequency if any one stretch is omitted."""
        rows = line_rows(run, rates)
        sums: list[list[list[Array]]] = [[[] for _ in _SHARES] for _ in range(5)]
        for s, noise in zip(stretches, noises, strict=True):
            projected = s.project(rows[s.rows])
            projected *= np.linalg.norm(projected, axis=0) > _RETAINED * np.linalg.norm(rows[s.rows], axis=0)
            for i, (w, _) in enumerate(noise):
                c, d = np.split(w @ projected, 2, axis=1)
                data = w @ s.projected
                products = (np.sum(c * c, 0), np.sum(d * d, 0), np.sum(c * d, 0), c.T @ data, d.T @ data)
                for total, product in zip(sums, products, strict=True):
                    total[i].append(product)
        # (stretches, shares, frequencies)
        cc, dd, cd, cr, dr = (left_out(np.swapaxes(np.array(total), 0, 1)) for total in sums)
        determinant = cc * dd - cd**2
        determined = determinant > _TINY * cc * dd
        chi2 = (dd * cr**2 - 2 * cd * cr * dr + cc * dr**2) / np.where(determined, determinant, 1.0)
        falls = np.where(determined, chi2, 0.0) - deviance[:, :, None]
        return np.asarray(falls.max(axis=1).min(axis=0))

    coarse = np.arange(lowest, highest, step)
    peak = float(coarse[int(np.argmax(gain(coarse)))])
    fine = np.linspace(peak - step, peak + step, 2 * _FINER + 1)
    least = gain(fine)
    top = int(np.argmax(least))
    p_value = false_alarm_probability(float(least[top]), (highest - lowest) / (2 * np.pi), span)
    if p_value >= criteria.spectral_line:
        return None
    rows = line_rows(run, fine[[top]])
    white = np.concatenate(
        [n[0][0] @ s.project(rows[s.rows]) for s, n in zip(stretches, noises, strict=True)]
    )
    data = np.concatenate([n[0][0] @ s.projected for s, n in zip(stretches, noises, strict=True)])
    return SpectralLine(float(fine[top]), float(np.hypot(*np.linalg.lstsq(white, data, rcond=None)[0])))
