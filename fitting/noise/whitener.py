"""Rows whitened: the random torques of a case, and the symmetric root of their covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Whitener:
    """Turns rows with covariance C = 1 + s^2 K into rows with covariance 1 by the symmetric root of C^-1.

    Attributes
    ----------
    vectors, values : ndarray
        Eigenvectors (m, m) and eigenvalues (m,) of K for the first m rows; the others are white.
    level : float
        s [N m].
    """

    vectors: Array
    values: Array
    level: float = 0.0

    def __call__(self, rows: Array) -> Array:
        """Return C^(-1/2) rows."""
        m = len(self.values)
        if self.level == 0 or m == 0:
            return rows
        gain = 1 / np.sqrt(1 + self.level**2 * self.values)
        inner = self.vectors.T @ rows[:m]
        inner = inner * (gain if rows.ndim == 1 else gain[:, None])
        return np.concatenate([self.vectors @ inner, rows[m:]])

    @property
    def log_determinant(self) -> float:
        """Return log det C."""
        return float(np.log1p(self.level**2 * self.values).sum())

    def at(self, level: float) -> Whitener:
        """Return the whitener for another level of the random torque."""
        return Whitener(self.vectors, self.values, level)


WHITE = Whitener(np.zeros((0, 0)), np.zeros(0))


@dataclass(frozen=True)
class TorqueNoise:
    """A random torque: rms [N m] on the casing and between the bodies, each, and correlation time [s]."""

    rms: float
    time: float
