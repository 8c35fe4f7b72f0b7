"""Measured minus modelled angle of a fit, with its standard uncertainty.

The rows of a block are the projections of the measured angles on polynomials, minus the projections of the modelled
angles. Nuisance parameters are the zero of the angle in each series of samples, the errors of the starts of the
windows, and camera effects. Generalised least squares removes their contributions from the rows. The remaining rows are
the coefficients of a polynomial, which is the residual of the angle within the block. It does not contain the noise
that is orthogonal to the polynomials. Its uncertainty follows from the covariance of the rows, as for the residual
speeds (`_speed_residuals`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from fitting._errors import EstimationError
from fitting.inference._compression import Compressed
from fitting.inference._speed_residuals import Fitted, SpeedMap, spread_of_rows

Array = NDArray[np.float64]

_POINTS_PER_ROW = 2
"""Number of points in a block, divided by the number of its rows [1]. Chosen: a smaller number does not show the
polynomial, a larger one makes larger files."""


@dataclass(frozen=True)
class AngleResidual:
    """Measured minus modelled angle of one series of samples: the samples of the casing, or of one rotor window.

    All arrays have shape (n,).

    Attributes
    ----------
    time : ndarray
        Times on the clock of the case, increasing [s].
    value, sigma : ndarray
        The residual, and the standard deviation that noise alone would cause [rad].
    """

    time: Array
    value: Array
    sigma: Array

    def at(self, time: Array) -> tuple[Array, Array]:
        """Return residual and standard deviation at these times [rad]; NaN outside of the series."""
        inside = (time >= self.time[0]) & (time <= self.time[-1])
        value, sigma = (np.interp(time, self.time, y) for y in (self.value, self.sigma))
        return np.where(inside, value, np.nan), np.where(inside, sigma, np.nan)


def angle_residuals(fit: Fitted, case: int) -> tuple[AngleResidual, ...]:
    """Return the residual angle of the casing, or of the single body, and of the rotor in each of its windows.

    Parameters
    ----------
    fit : Fit
        The fit. Its estimates of clock errors, zeros of the angle and camera effects are part of the modelled angle.
    case : int
        Index of the case.

    Raises
    ------
    EstimationError
        If speeds were fitted, not angles.
    """
    data, noise = fit.problem.data[case], fit.noise[case]
    if not data.is_angle:
        raise EstimationError(f"{data.record.label} was fitted by its speeds", "fit its angles")
    to_rows = SpeedMap(fit.problem, noise, case)
    rows = to_rows.without_nuisance(data.z - fit.predictions[case].rows)
    spread = spread_of_rows(fit, case)
    found, first = [], 0
    for run in (data.casing, *data.rotor):
        where = slice(first, first + len(run.z))
        first = where.stop
        time, operator = _values(run)
        found.append(
            AngleResidual(time, operator @ rows[where], np.linalg.norm(operator @ spread[where], axis=1))
        )
    return tuple(found)


def _values(run: Compressed) -> tuple[Array, Array]:
    """Return times in the blocks of a series, and the operator from its rows to angles at these times (times, rows)."""
    blocks, k, _ = run.lift.shape
    nodes, times = run.node_times.reshape(blocks, k), run.samples.time
    points = _POINTS_PER_ROW * k
    operator, found = np.zeros((blocks * points, blocks * k)), np.zeros(blocks * points)
    for i, (where, _) in enumerate(run.operators):
        inside = times[where]
        centre, half = 0.5 * (inside[0] + inside[-1]), 0.5 * (inside[-1] - inside[0])
        to_coefficients = np.linalg.inv(run.lift[i] @ legendre.legvander((nodes[i] - centre) / half, k - 1))
        part = slice(i * points, (i + 1) * points)
        found[part] = np.linspace(inside[0], inside[-1], points)
        operator[part, i * k : (i + 1) * k] = (
            legendre.legvander((found[part] - centre) / half, k - 1) @ to_coefficients
        )
    return found, operator
