"""Angular velocities from angles, smoothed as in the paper, and how much slow noise that leaves in them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.polynomial import hermite_e
from numpy.typing import NDArray

from fitting.case_data import SPEED_BLOCKS
from fitting.compression import CASING_DEGREE
from fitting.record import Record, Samples
from fitting.smoothing import median_width, speeds

Array = NDArray[np.float64]

_TERMS = 21


def as_velocities(record: Record) -> Record:
    """Return the record with the paper's velocities in place of angles: median, gradient, median, ends dropped.

    Their sigma is that of independent samples which would leave as much slow noise (`median_noise`): neighbours share
    most of theirs, and the fit sees only what is slow.
    """
    if record.quantity == "omega":
        return record
    runs = [_velocities(record.casing, SPEED_BLOCKS), *(_velocities(s, 1) for s in record.rotor)]
    return replace(record, casing=runs[0], rotor=tuple(runs[1:]), quantity="omega", gradients=True, digest="")


def _velocities(samples: Samples, blocks: int) -> Samples:
    time, omega = speeds(samples, "angle")
    width = median_width(len(samples))
    step = np.gradient(samples.time)
    noise = np.hypot(*(np.roll(samples.sigma, k) for k in (-1, 1))) / (2 * step)
    noise = np.interp(time, samples.time, noise)
    rise = np.abs(np.gradient(np.convolve(omega, np.full(width, 1 / width), mode="same"), time))
    # the mean runs into nothing at both ends
    rise[: width // 2 + 1], rise[-width // 2 :] = rise[width // 2 + 1], rise[-width // 2 - 1]
    reach = 0.5 * width * float(np.median(step)) * rise / noise
    # a block of gradients e_(i+1) - e_(i-1) keeps the e of both its ends: on the Legendre polynomials of degree k, as
    # large there as (2 k + 1) / samples, mean (degree + 1) / samples
    ends = 2 * (CASING_DEGREE + 1) * blocks / len(samples)
    return Samples(time, omega, noise * np.sqrt(median_noise(reach) + ends))


def median_noise(reach: Array) -> Array:
    """Return the slow noise of a running median of gradients, as a variance over that of one gradient.

    Where the speed rises, sample j beside the middle counts as long as its noise does not lift it over the slope: in
    sums over many medians every gradient v counts as psi(v), cut off at c = slope x half the width. So the spectral
    density at frequency nothing is that of Huber's estimate,

        S = sum over lags of cov[psi(v_0), psi(v_k)] / P(|v| < c)^2,

    and gradients (e_(i+1) - e_(i-1)) / 2h of independent e correlate by -1/2 at lag 2 and at no other. By Hermite
    polynomials (Mehler's formula) cov = sum_k (2 phi(c) He_(k-2)(c))^2 (-1/2)^k / k! over odd k, the first term being
    P^2 / 2.

    Parameters
    ----------
    reach : ndarray
        c, in standard deviations of the noise of one gradient.
    """
    c = np.clip(reach, 0.02, 5.0)
    density = np.exp(-0.5 * c**2) / np.sqrt(2 * np.pi)
    inside = np.vectorize(math.erf, otypes=[float])(c / np.sqrt(2))
    variance = inside - 2 * c * density + c**2 * (1 - inside)
    opposed, factorial = 0.5 * inside**2, 1.0
    for k in range(3, _TERMS, 2):
        factorial *= (k - 1) * k
        polynomial = hermite_e.hermeval(c, np.eye(k - 1)[k - 2])
        opposed = opposed + (2 * density * polynomial) ** 2 * 0.5**k / factorial
    return np.asarray(np.maximum(variance - 2 * opposed, 0.0) / inside**2)
