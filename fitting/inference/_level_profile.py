"""The deviance of residuals as a function of the level of a random torque, with other columns free.

With the covariance C(s) = 1 + s^2 K of the rows (`fitting.inference._noise`), the residuals r and the free columns J,
the deviance is

    D(s) = log det C + min over x of (r - J x)' C^-1 (r - J x).

D follows from the likelihood, not from the restricted likelihood: only then can fits with different numbers of free
columns be compared.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fitting.inference._noise import Whitener

Array = NDArray[np.float64]

_PRECISION = 0.05
"""Precision of the logarithms of time and level at the maximum of the likelihood [1]. Chosen: a smaller value costs
time, a larger one ends above the smallest deviance."""
_EVALUATIONS = 8
"""Largest number of evaluations of a one-dimensional search for the maximum [1]. Chosen: a smaller number stops before
`_PRECISION` is reached, a larger one costs time."""


class LevelProfile:
    """The deviance of a residual at a level of random torque. The residual is the last column.

    The other columns are free.
    """

    def __init__(self, whitener: Whitener, both: Array) -> None:
        self._whitener, self._rotated = whitener, whitener.rotated(both)

    def __call__(self, level: float) -> float:
        whitener = self._whitener.at(level)
        rows = self._rotated.copy()
        n = len(whitener.values)
        rows[:n] /= np.sqrt(1 + level**2 * whitener.values)[:, None]
        r = np.abs(np.diag(np.linalg.qr(rows, mode="r")))
        return whitener.log_determinant + float(r[-1] ** 2)

    def least(self, levels: Array) -> tuple[float, float]:
        """Return the most likely level within the range of `levels`, and its deviance."""
        deviances = [self(float(s)) for s in levels]
        k = int(np.argmin(deviances))
        bounds = levels[max(k - 1, 0)], levels[min(k + 1, len(levels) - 1)]
        log_level, deviance = least_between(lambda x: self(float(np.exp(x))), *np.log(bounds))
        return (
            (float(np.exp(log_level)), deviance)
            if deviance < deviances[k]
            else (float(levels[k]), deviances[k])
        )


def least_between(f: Callable[[float], float], low: float, high: float) -> tuple[float, float]:
    """Return the position of the minimum of a function between two bounds, and its value."""
    from scipy.optimize import minimize_scalar

    found = minimize_scalar(
        f, bounds=(low, high), method="bounded", options={"xatol": _PRECISION, "maxiter": _EVALUATIONS}
    )
    return float(found.x), float(found.fun)


def scaled_columns(columns: Array, residual: Array) -> Array:
    """Return the columns that are not zero, scaled to unit norm, followed by the residual as the last column."""
    size = np.linalg.norm(columns, axis=0)
    return np.concatenate([columns[:, size > 0] / size[size > 0], residual[:, None]], axis=1)
