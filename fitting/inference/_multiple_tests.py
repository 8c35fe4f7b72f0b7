"""P-values of many tests of the same data (Sidak).

Of N independent tests, the smallest p-value is below p with the probability 1 - (1 - p)^N (Z. Sidak, J. Am. Stat.
Assoc. 62, 626 (1967)). For correlated tests, N is the number of independent tests whose smallest p-value has the same
lower tail as the smallest p-value of the correlated tests in data without an effect.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def number_of_trials(single: float, share: float) -> float:
    """Return the number N of independent tests with share = 1 - (1 - single)^N."""
    return float(np.log1p(-share) / np.log1p(-min(max(single, 1e-12), 1 - 1e-12)))


def over_many_tests(p: float, smallest: Array) -> float:
    """Return the family-wise p-value of the smallest p of many correlated tests of the same data.

    `smallest` contains the smallest p-value in each of many null data sets.
    """
    return float(any_of(independent_tests(smallest), np.array(p)))


def independent_tests(smallest: Array) -> float:
    """Return the number of independent tests whose smallest p has the same lower tail as `smallest`."""
    return max(1.0, number_of_trials(float(np.quantile(smallest, 0.1)), 0.1))


def any_of(tests: float, p: Array) -> Array:
    """Return the probability 1 - (1 - p)^N that one of N independent tests has a p-value below p."""
    return np.asarray(-np.expm1(tests * np.log1p(-np.minimum(p, 1 - 1e-12))))
