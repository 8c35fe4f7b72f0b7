"""Single samples that are inconsistent with a smooth motion: a lost point, a mistaken marker, a transmission error.

A sample is compared with the parabola through the three samples before it, and with the parabola through the three
samples after it. An outlier deviates from both parabolas in the same direction. A sample at a step or a kink of the
motion deviates from one parabola only. In a motion with few samples per period, samples deviate from both parabolas in
opposite directions.
"""

from __future__ import annotations

import numpy as np

from gyrotrack.io._records import Floats, Integers
from gyrotrack.io.readers._motion_table import MotionTable, scatter

# smallest deviation of an outlier from either prediction [standard errors of the prediction]; one standard error is 4.5
# standard uncertainties of a sample. The largest of a million normal deviates is five, and the noise of real records
# has longer tails
_FAR = 10.0
_ALIKE = 0.5  # largest difference between the two deviations [share of the smaller deviation]
_RARE = 0.02  # largest share of outliers; a larger share counts as noise of the record


def without_outliers(
    table: MotionTable, value: Floats, notes: list[str], *, keep_all: bool = False
) -> tuple[MotionTable, Floats]:
    """Return a table and its unwrapped values without outliers; `notes` then states the excluded outliers."""
    if keep_all or table.counted or len(value) < 15:
        return table, value
    sigma = scatter(table.time, value) if table.sigma is None else table.sigma
    rows = outliers(table.time, value, np.maximum(sigma, table.least_sigma))
    if not 0 < len(rows) <= max(_RARE * len(value), 1):
        return table, value
    notes.append(
        f"{table.path.name}: {len(rows)} outlier{'s' * (len(rows) > 1)} (first: line {table.line[rows[0]]}) far from "
        "the samples before and after were excluded (--keep-all keeps them)"
    )
    keep = np.ones(len(value), dtype=np.bool_)
    keep[rows] = False
    return table.only(keep), value[keep]


def outliers(time: Floats, value: Floats, sigma: Floats) -> Integers:
    """Return the samples that deviate from the parabolas of both sides equally, and by at least 10 standard errors.

    Parameters
    ----------
    time, value, sigma : ndarray, shape (n,)
        Increasing times [s], values, and the standard uncertainty of each.
    """
    off, error = np.empty((2, 2, len(value) - 6))
    middle = np.arange(3, len(value) - 3)
    for side, step in enumerate((-1, 1)):
        near = middle[:, None] + step * np.arange(1, 4)
        apart = time[near] - time[middle, None]
        # Lagrange's weights of three points, for extrapolation to the sample
        weights = np.stack(
            [
                np.prod([-apart[:, k] / (apart[:, j] - apart[:, k]) for k in range(3) if k != j], axis=0)
                for j in range(3)
            ],
            axis=1,
        )
        off[side] = value[middle] - np.einsum("ij,ij->i", weights, value[near])
        error[side] = np.sqrt(sigma[middle] ** 2 + np.einsum("ij,ij->i", weights**2, sigma[near] ** 2))
    size = np.abs(off)
    far = (size > _FAR * error).all(axis=0)
    alike = np.abs(off[0] - off[1]) < _ALIKE * size.min(axis=0)  # this condition implies equal signs
    return np.asarray(middle[far & alike])
