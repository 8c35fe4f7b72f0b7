"""p-values from empty data sets that went through the very same search.

A candidate that tries many shapes amounts to N independent trials, p = 1 - (1 - p1)^N, with the N that reproduces the
tail of its largest scores in empty data; the whole list amounts to so many independent candidates in the same sense.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fitting.discovery.scoring import Score

Array = NDArray[np.float64]


class Chance:
    """Tail probability of a candidate's score in empty data."""

    def __init__(self, score: Score) -> None:
        self._columns = score.columns
        self.draws = score.null
        middle = float(np.median(self.draws))
        tail = float(np.quantile(self.draws, 0.9))
        self._trials = max(
            _trials(float(_beyond(middle, score.columns)), 0.5),
            _trials(float(_beyond(tail, score.columns)), 0.1),
        )

    def __call__(self, score: float) -> float:
        """Return the probability of a score at least as large in empty data."""
        return self.of(score, self._columns)

    def of(self, score: float, columns: int) -> float:
        """Return the probability of a score with fewer strengths, searched over as many shapes."""
        single = float(_beyond(score, max(columns, 1)))
        return float(-np.expm1(self._trials * np.log1p(-min(single, 1 - 1e-12))))

    def of_draws(self) -> Array:
        """Return the p-value of each empty data set."""
        single = np.minimum(_beyond(self.draws, self._columns), 1 - 1e-12)
        return np.asarray(-np.expm1(self._trials * np.log1p(-single)))


def _beyond(chi2: float | Array, columns: int) -> Array:
    """Return the probability of a larger chi-square."""
    from scipy.special import chdtrc

    return np.asarray(chdtrc(columns, np.maximum(chi2, 0.0)))


def _trials(single: float, share: float) -> float:
    # share = 1 - (1 - single)^N, solved for N
    return float(np.log1p(-share) / np.log1p(-min(max(single, 1e-12), 1 - 1e-12)))


def over_many(p: float, smallest: Array) -> float:
    """Return the probability of a p-value as small anywhere among many looks at the same data.

    Parameters
    ----------
    p : float
        The smallest.
    smallest : ndarray
        The smallest of each of many empty data sets.
    """
    looks = max(1.0, _trials(float(np.quantile(smallest, 0.1)), 0.1))
    return float(-np.expm1(looks * np.log1p(-min(p, 1 - 1e-12))))


class Family:
    """p-value over the whole list: calibrated on the smallest p of each empty data set."""

    def __init__(self, chances: Sequence[Chance]) -> None:
        self._smallest = np.min([c.of_draws() for c in chances], axis=0)

    def __call__(self, p: float) -> float:
        """Return the probability of a p as small anywhere in the list."""
        return over_many(p, self._smallest)
