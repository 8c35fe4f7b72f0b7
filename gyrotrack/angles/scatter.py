"""How widely residuals scatter, and for how long they stay alike; what one that lies far out says of itself."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack.geometry.local import spread

Floats = npt.NDArray[np.float64]

FAR = 6.0
"""Standard deviations beyond which a sighting is taken for a fault."""
FEWEST = 8
STANDS_OUT = 3.5
"""Standard deviations beyond which a correlation is not taken for chance."""
_LIGHTEST, _HEAVIEST = 1e3, 5.0
_BORROWED = 4.0
"""Independent departures that a borrowed uncertainty is worth: it holds to about a third."""


def core_scatter(off: Floats, otherwise: float) -> float:
    """Return the standard deviation of the core of residuals; `otherwise`, if there are too few of them."""
    return max(spread(off), 1e-5) if np.isfinite(off).sum() >= FEWEST else otherwise


def excess(off: Floats) -> float:
    """Return by how much normalised residuals scatter more than they should: their root mean square.

    A fault counts as no more than `FAR`; the result is between 0.5 and 3, and 1 if there are too few residuals.
    """
    known = off[np.isfinite(off)]
    if len(known) < FEWEST:
        return 1.0
    limit = FAR * core_scatter(known, 1.0)
    return float(np.clip(np.sqrt(np.mean(np.minimum(known**2, limit**2))), 0.5, 3.0))


def tail_factor(off: Floats) -> Floats:
    """Return by how much each residual raises its own uncertainty where large ones are too frequent, (n,).

    The noise is taken as normal with a variance of its own in each frame, inverse-gamma distributed: residuals
    then follow Student's t with nu degrees of freedom, their excess kurtosis is 6 / (nu - 4), and a residual of r
    standard deviations says that its variance was (nu - 2 + r^2) / (nu - 1) of the mean one. Where nothing is
    known (NaN) the factor is 1.

    Parameters
    ----------
    off : ndarray, shape (n,)
        Residuals of unit root mean square.

    Examples
    --------
    >>> tail_factor(np.array([-1.0, 1.0] * 50)).round(3).max()
    np.float64(1.0)
    """
    known = np.minimum(np.abs(off[np.isfinite(off)]), FAR)
    if len(known) < FEWEST:
        return np.ones(len(off))
    kurtosis = float(np.mean(known**4) / max(np.mean(known**2), 1e-12) ** 2 - 3.0)
    nu = float(np.clip(4.0 + 6.0 / max(kurtosis, 1e-6), _HEAVIEST, _LIGHTEST))
    return np.asarray(np.where(np.isfinite(off), np.sqrt((nu - 2.0 + off**2) / (nu - 1.0)), 1.0))


def correlation_factor(residual: Floats) -> float:
    """Return by how much correlation raises the variance of averages: 1 + 2 sum of autocorrelations.

    The sum ends where a pair of neighbouring lags is no longer positive (Geyer's initial sequence); what is
    within 3.5 sigma of independent samples counts as independent.
    """
    size = len(residual)
    power = np.abs(np.fft.rfft(residual - residual.mean(), 2 * size))
    power **= 2
    autocovariance = np.fft.irfft(power)[:size].copy()
    if autocovariance[0] <= 0:
        return 1.0
    rho = autocovariance[1:] / autocovariance[0]
    pairs = rho[: len(rho) // 2 * 2].reshape(-1, 2).sum(axis=1)
    positive = int(np.argmax(pairs <= 0)) if (pairs <= 0).any() else len(pairs)
    factor = 1 + 2 * float(pairs[:positive].sum())
    return factor if factor > 1 + 2 * STANDS_OUT / np.sqrt(size) else 1.0


def share_of_floor(off: Floats, sigma: Floats, floor: float, places: float) -> float:
    """Return the share, 0 to 1, of a borrowed uncertainty that a body's own departures leave to it.

    A body that passes an arc passes places too, and departs from its smooth motion where it errs by them. These
    departures and the borrowed value are two estimates of one variance, each with its degrees of freedom; departures
    that are larger may be motion, and raise nothing.

    Parameters
    ----------
    off, sigma : ndarray, shape (n,)
        Departures from the smooth motion, NaN where there is none, and their uncertainty without errors by place [rad].
    floor : float
        The borrowed uncertainty of errors by place [rad].
    places : float
        Places with errors of their own that were passed, less those to which the smooth motion could be fitted.
    """
    known = np.isfinite(off) & np.isfinite(sigma)
    if known.sum() < FEWEST or floor <= 0.0 or places <= 0.0:
        return 1.0
    own = np.minimum(np.abs(off[known]), FAR * np.hypot(sigma[known], floor))
    seen = max(float(np.mean(own**2) - np.mean(sigma[known] ** 2)), 0.0)
    return float(np.sqrt(min((_BORROWED + places * seen / floor**2) / (_BORROWED + places), 1.0)))
