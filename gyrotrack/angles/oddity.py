"""How much more a sighting errs the less its profile fits the usual one.

Glints, shadows and blocks of the encoder leave their mark on a profile and shift it too. How far they shift it
depends on the film, and is learnt from the marker's own scatter: with x the squared misfit of a sighting relative
to the usual one, less 1, its variance is s^2 (1 + share x), and `share` is the most likely one.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack.compiled import loops

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

LARGEST = 24.0
"""Excess of a squared misfit beyond which it tells no more."""
FEWEST = 30
_SHARES = np.concatenate([[0.0], np.geomspace(0.01, 1.0, 21)])
_FAULT = 5.0


def excess_misfit(misfit: Floats, usual: float) -> Floats:
    """Return by how much squared misfits exceed the usual one, relative to it, (n,); 0 for usual ones."""
    ratio = np.nan_to_num(misfit, nan=0.0) / max(usual, 1e-9)
    return np.asarray(np.clip(ratio**2 - 1.0, 0.0, LARGEST))


def most_likely_share(off: Floats, excess: Floats) -> float:
    """Return the share of the excess with which normal residuals are most likely, between 0 and 1.

    Parameters
    ----------
    off : ndarray, shape (n,)
        Residuals of any one scale; faults beyond five standard deviations count as five.
    excess : ndarray, shape (n,)
        From `excess_misfit`.
    """
    known = np.isfinite(off)
    if known.sum() < FEWEST:
        return 0.0
    return float(_SHARES[int(np.argmin(_unlikely(off[known] ** 2, excess[known])))])


def _unlikely(squares: Floats, odd: Floats) -> Floats:
    """Return minus twice the mean log-likelihood of squared residuals for every share, but for a constant."""
    if loops is None:
        return np.array([_unlikely_as(squares, 1.0 + share * odd) for share in _SHARES])
    found = np.empty(len(_SHARES))
    loops.unlikely(squares, odd, _SHARES, found, _FAULT**2 / 0.4549)
    return found


def _unlikely_as(squares: Floats, variance: Floats) -> float:
    squares = squares / variance
    squares = np.minimum(squares, _FAULT**2 * np.median(squares) / 0.4549)
    return float(np.log(max(squares.mean(), 1e-30)) + np.log(variance).mean())
