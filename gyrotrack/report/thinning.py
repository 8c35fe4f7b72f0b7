"""Long curves with few points and no peak lost: the smallest and the largest value of each bin are kept."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST = 2000


def thin(time: Array, value: Array, most: int = MOST) -> tuple[Array, Array]:
    """Return at most `most` of the points, in order.

    Parameters
    ----------
    time, value : ndarray, shape (n,)
        The curve; no value is made up, each point that is returned is one of these.
    most : int
        How many points may stay.
    """
    if len(time) <= most:
        return time, value
    edges = np.linspace(0, len(time), most // 2 + 1).astype(int)
    low = [a + int(np.argmin(value[a:b])) for a, b in pairwise(edges)]
    high = [a + int(np.argmax(value[a:b])) for a, b in pairwise(edges)]
    keep = np.unique([*low, *high])
    return time[keep], value[keep]
