"""The noise of a series, seen in how its neighbours scatter about a smooth curve."""

from __future__ import annotations

import numpy as np

from gyrotrack.dataset.records import Floats

BLOCK = 15
ORDER = 3
NEIGHBOURS = 41
FLOOR = 1e-6
_MEDIAN_OF_CHI2 = 11 * (1 - 2 / (9 * 11)) ** 3 / 11  # median of chi2 / dof for dof = BLOCK - ORDER - 1 = 11


def scatter(time: Floats, value: Floats) -> Floats:
    """Return the uncertainty of each sample, from the residuals of short cubics.

    In blocks of 15 samples a cubic is fitted; the running median over 41 blocks of the residual variance,
    divided by the median of chi2 / dof, is robust against blocks with an outlier and follows slow changes.
    What changes more slowly than a block (a centre that is off, a tilt) is not seen.

    Parameters
    ----------
    time, value : ndarray, shape (n,)
        The series, in pieces without 2 pi steps; n >= 8.

    Returns
    -------
    ndarray, shape (n,)
        One sigma, in the unit of `value`, never below 1e-6.
    """
    starts = np.arange(0, max(len(time) - BLOCK, 0) + 1, BLOCK)
    centre = np.array([float(np.mean(time[i : i + BLOCK])) for i in starts])
    variance = np.array([_residual_variance(time[i : i + BLOCK], value[i : i + BLOCK]) for i in starts])
    half = NEIGHBOURS // 2
    smooth = [np.median(variance[max(0, k - half) : k + half + 1]) for k in range(len(starts))]
    sigma = np.sqrt(np.interp(time, centre, np.asarray(smooth)) / _MEDIAN_OF_CHI2)
    floored: Floats = np.maximum(sigma, FLOOR)
    return floored


def _residual_variance(time: Floats, value: Floats) -> float:
    if len(time) <= ORDER + 1:
        return 0.0
    width = max(float(np.ptp(time)), 1e-300)
    basis = np.vander((time - time.mean()) / width, ORDER + 1)
    residual = value - basis @ np.linalg.lstsq(basis, value, rcond=None)[0]
    return float(residual @ residual) / (len(time) - ORDER - 1)
