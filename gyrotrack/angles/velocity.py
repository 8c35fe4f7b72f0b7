"""From a series of angles to angular velocities, smoothed as in the paper.

The paper takes the median over 51 points of the angles, differentiates, takes the median over 51 points of
the velocities, and drops the first and last 50.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

WIDTH = 51


def median_smooth(x: npt.ArrayLike, width: int = WIDTH) -> Floats:
    """Return the running median of a series.

    Parameters
    ----------
    x : array_like, shape (n,)
        The series; NaN are passed over and stay NaN.
    width : int
        Points of the median, odd.

    Returns
    -------
    ndarray, shape (n,)
        The median of the `width` points around each point; beyond an end the end point is repeated.

    Raises
    ------
    ValueError
        `width` is even or not positive.
    """
    if width < 1 or width % 2 == 0:
        raise ValueError(f"the width of a median must be odd and positive, not {width}")
    from scipy.ndimage import median_filter

    series = np.asarray(x, dtype=float)
    smooth = np.full_like(series, np.nan)
    known = np.isfinite(series)
    if known.any():
        smooth[known] = median_filter(series[known], size=width, mode="nearest")
    return smooth


def angular_velocity(
    time: npt.ArrayLike, angle: npt.ArrayLike, sigma: npt.ArrayLike, width: int = WIDTH
) -> tuple[Floats, Floats]:
    """Return the paper's angular velocity of one piece without large gaps, and its uncertainty.

    The uncertainty is that of a running median of central differences d_i = (x_{i+1} - x_{i-1}) / 2 dt with a
    trend from one to the next: var = N / D^2, with D the sum of the densities of d_i at the median and N the
    sum of the covariances of the events d_i < median; d_i and d_{i+2} share one angle and have the
    correlation -1/2. Without trend this is (pi / 6 n) var(d). The noise of the angles must be independent.

    Parameters
    ----------
    time, angle, sigma : array_like, shape (n,)
        Times [s], increasing; unwrapped angles [rad]; their uncertainties [rad].
    width : int
        Points of the medians, odd.

    Returns
    -------
    omega, omega_sigma : ndarray, shape (n,)
        Angular velocity and uncertainty [rad s-1]; NaN in the first and last ``width - 1`` points.
    """
    t, x, s = (np.asarray(a, dtype=float) for a in (time, angle, sigma))
    omega, omega_sigma = np.full_like(t, np.nan), np.full_like(t, np.nan)
    margin = width - 1
    if len(t) <= 2 * margin:
        return omega, omega_sigma
    smooth = median_smooth(x, width)
    raw = np.full_like(t, np.nan)
    span = t[2:] - t[:-2]
    raw[1:-1] = (smooth[2:] - smooth[:-2]) / span
    raw_sigma = np.full_like(t, np.nan)
    raw_sigma[1:-1] = np.hypot(s[2:], s[:-2]) / span
    inner = slice(margin, len(t) - margin)
    omega[inner] = median_smooth(raw, width)[inner]
    trend = np.gradient(omega[inner]) if len(omega[inner]) > 1 else np.zeros(1)
    omega_sigma[inner] = _median_sigma(
        median_smooth(raw_sigma, width)[inner], median_smooth(trend, width), width
    )
    return omega, omega_sigma


def _median_sigma(sigma: Floats, trend: Floats, width: int) -> Floats:
    """Return the uncertainty of a median of `width` central differences with a linear trend."""
    from scipy.special import ndtr

    half = width // 2
    out = np.full_like(sigma, np.nan)
    for start in range(0, len(sigma), 512):  # 512 x 51 values at a time
        part = slice(start, start + 512)
        u = np.outer(trend[part] / sigma[part], np.arange(-half, half + 1))
        p, density = ndtr(u), np.exp(-(u**2) / 2) / np.sqrt(2 * np.pi)
        a, b = u[:, 2:], u[:, :-2]
        series = -1 / 2 + a * b / 8 - (a**2 - 1) * (b**2 - 1) / 48  # tetrachoric, at the correlation -1/2
        shared = 2 * np.sum(series * density[:, 2:] * density[:, :-2], axis=1)
        variance = np.sum(p * (1 - p), axis=1) + shared
        out[part] = sigma[part] * np.sqrt(variance) / np.sum(density, axis=1)
    return out
