"""Uncertainty of samples from their scatter, and splitting of records at gaps."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter

from gyrotrack.io._records import Floats

GAP = 20.0
BLOCK = 15
ORDER = 3
NEIGHBOURS = 41
FLOOR = 1e-6
_MEDIAN_OF_CHI2 = 11 * (1 - 2 / (9 * 11)) ** 3 / 11  # median of chi2 / dof for dof = BLOCK - ORDER - 1 = 11


def pieces(time: Floats) -> list[slice]:
    """Return the pieces between gaps, which are intervals longer than 20 times the local median of eleven.

    The median is local because intervals between pulses of a slowing body increase.
    """
    step = np.diff(time)
    if not len(step):
        return [slice(0, len(time))]
    usual = median_filter(step, 11, mode="nearest")
    cuts = np.flatnonzero(step > GAP * usual) + 1
    return [slice(int(a), int(b)) for a, b in zip([0, *cuts], [*cuts, len(time)], strict=True)]


def scatter(time: Floats, value: Floats, floor: float = FLOOR) -> Floats:
    """Return the uncertainty of each sample, from the residuals of local cubics.

    Cubics are fitted to blocks of 15 samples. The variance is the running median of their residual variances over 41
    blocks, divided by the median of chi2 / dof, which is robust against outliers and follows slow changes. Errors that
    vary more slowly than a block (centre offset, tilt) are not included.

    Parameters
    ----------
    time, value : ndarray, shape (n,)
        The series, unwrapped, n >= 8.
    floor : float
        Lower bound, in the unit of `value`.

    Returns
    -------
    ndarray, shape (n,)
        Standard uncertainty, in the unit of `value`.
    """
    starts = np.arange(0, max(len(time) - BLOCK, 0) + 1, BLOCK)
    centre = np.array([float(np.mean(time[i : i + BLOCK])) for i in starts])
    variance = np.array([_residual_variance(time[i : i + BLOCK], value[i : i + BLOCK]) for i in starts])
    half = NEIGHBOURS // 2
    smooth = [np.median(variance[max(0, k - half) : k + half + 1]) for k in range(len(starts))]
    sigma = np.sqrt(np.interp(time, centre, np.asarray(smooth)) / _MEDIAN_OF_CHI2)
    return np.asarray(np.maximum(sigma, floor))


def _residual_variance(time: Floats, value: Floats) -> float:
    if len(time) <= ORDER + 1:
        return 0.0
    width = max(float(np.ptp(time)), 1e-300)
    basis = np.vander((time - time.mean()) / width, ORDER + 1)
    residual = value - basis @ np.linalg.lstsq(basis, value, rcond=None)[0]
    return float(residual @ residual) / (len(time) - ORDER - 1)
