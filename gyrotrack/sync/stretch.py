"""The true motion of the casing around a clip, as the casing's camera knows it.

In a window about the clip the casing's true angle is a quintic spline psi(t), and the camera sees

    psi_A(t) = psi(t) + H_A,   H = sin, cos of one and two turns of the casing.

The window is chosen once and stays while a clip is moved over it: a window that moved along would let samples
in and out, and chi2 would jump with them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve

from gyrotrack.dataset.records import Floats
from gyrotrack.sync.curves import Curve, harmonics

DEGREE = 5
MARGIN = 2.0  # the window reaches beyond the clip by this many times half its length, on both sides
HARMONIC_SIGMA = 0.02  # rad; larger harmonics are not expected of any camera
LOOSE = 1.0  # rad; how far the spline may leave the quartic where nothing is seen
HARMONICS = 4


@dataclass(frozen=True)
class Stretch:
    """What the casing's samples in a window say about psi and H_A.

    Attributes
    ----------
    knots : ndarray
        Of the quintic spline, over the whole window.
    reference : Polynomial
        A quartic of time, from which the spline is measured.
    best : ndarray, shape (n + 4,)
        Coefficients of spline and harmonics from these samples alone.
    information : ndarray, shape (n + 4, n + 4)
        Inverse covariance of `best`.
    rows, residual : ndarray
        The design matrix of the samples, and what `best` leaves of them, in units of sigma.
    """

    knots: Floats
    reference: np.polynomial.Polynomial
    best: Floats
    information: Floats
    rows: Floats
    residual: Floats

    def design(self, time: Floats) -> Floats:
        """Return the values of the spline's basis, shape (len(time), n).

        Raises
        ------
        LinAlgError
            A time is outside the window.
        """
        if time[0] < self.knots[0] or time[-1] > self.knots[-1]:
            raise np.linalg.LinAlgError("the clip left the window")
        matrix: Floats = BSpline.design_matrix(time, self.knots, DEGREE).toarray()
        return matrix

    def speed(self, time: Floats) -> Floats:
        """Return the casing's true speed [rad s-1], from these samples alone."""
        spline = BSpline(self.knots, self.best[:-HARMONICS], DEGREE)
        return np.asarray(self.reference.deriv()(time) + spline.derivative()(time))


def window(first: float, last: float) -> tuple[float, float]:
    """Return the window about a clip that runs from `first` to `last` on the casing's clock [s]."""
    middle, reach = (first + last) / 2, (1 + MARGIN) * (last - first) / 2
    return middle - reach, middle + reach


def stretch(casing: Curve, edges: tuple[float, float], intervals: int) -> Stretch:
    """Fit spline and harmonics to the casing's samples in a window.

    Raises
    ------
    LinAlgError
        There are too few samples.
    """
    seen = casing.between(*edges)
    if len(seen.time) < 2 * DEGREE:
        raise np.linalg.LinAlgError("too few samples of the casing")
    knots = np.linspace(edges[0], edges[1], intervals + 1)
    knots = np.concatenate([np.repeat(knots[0], DEGREE), knots, np.repeat(knots[-1], DEGREE)])
    reference = np.polynomial.Polynomial.fit(seen.time, seen.angle, 4)
    spline = BSpline.design_matrix(seen.time, knots, DEGREE).toarray()
    rows = np.hstack([spline, harmonics(seen.angle)]) / seen.sigma[:, None]
    left = (seen.angle - reference(seen.time)) / seen.sigma
    size = spline.shape[1]
    information = rows.T @ rows + np.diag(np.repeat([LOOSE**-2, HARMONIC_SIGMA**-2], [size, HARMONICS]))
    best: Floats = cho_solve(cho_factor(information), rows.T @ left)
    return Stretch(knots, reference, best, information, rows, left - rows @ best)
