"""How noisy a camera is for slow quantities: the spread of its residuals, and how long they stay alike."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack.angles.scatter import STANDS_OUT
from gyrotrack.dataset.records import Floats

OUTLIER = 6.0
BLOCKS = 60


def inliers(residual: Floats) -> npt.NDArray[np.bool_]:
    """Return which residuals lie within six robust spreads."""
    spread = 1.4826 * float(np.median(np.abs(residual)))
    return np.asarray(np.abs(residual) < OUTLIER * max(spread, 1e-300))


def block_excess(residual: Floats, free: float) -> float:
    """Return the variance of block means against that of independent residuals of unit sigma.

    Parameters
    ----------
    residual : ndarray
        In units of sigma.
    free : float
        Part of the block means that the fitted parameters leave free.

    Returns
    -------
    float
        At least 1; more only if it stands out.
    """
    means, length = block_means(residual)
    excess = length * float(np.mean(means**2)) / free
    return excess if excess > 1 + STANDS_OUT * np.sqrt(2 / len(means)) else 1.0


def block_means(residual: Floats) -> tuple[Floats, int]:
    """Return the means of about 60 blocks, and the length of a block."""
    length = max(len(residual) // BLOCKS, 2)
    blocks = len(residual) // length
    return residual[: blocks * length].reshape(blocks, length).mean(axis=1), length
