"""The torque that a fitted model lacks against the angle of the casing: once and twice a turn.

With the whitened response S of the rows to torques sin(n psi), cos(n psi) of 1 N m, n = 1, 2, and what is left of
it beside all that is free (parameters, phases, a centre offset, a tilt, a rolling shutter) and beside slow torques of
any shape, because what a model misses elsewhere leaks into the few turns in which the casing is slow,

    gamma = (S'S)^-1 S'r,   cov(gamma) = (S'S)^-1,   torque(psi) = sum_n gamma_2n-1 sin(n psi) + gamma_2n cos(n psi).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting.effects import LIBRARY
from fitting.estimation import Fit
from fitting.estimation.lack import orthonormal, slow_responses

Array = NDArray[np.float64]

_LAWS = ("casing.unbalance", "casing.asymmetry")
_POINTS = 73
_RANK = 1e-6


@dataclass(frozen=True)
class Ripple:
    """What follows the angle of the casing of one case.

    Attributes
    ----------
    label : str
        Case.
    gamma : ndarray, shape (4,)
        Amplitudes of sin psi, -cos psi, sin 2 psi, -cos 2 psi [N m].
    covariance : ndarray, shape (4, 4)
        Their covariance [N2 m2].
    """

    label: str
    gamma: Array
    covariance: Array

    @property
    def angle(self) -> Array:
        """Angles of one turn [rad]."""
        return np.linspace(0.0, 2 * np.pi, _POINTS)

    def _waves(self) -> Array:
        psi = self.angle
        return np.stack([np.sin(psi), -np.cos(psi), np.sin(2 * psi), -np.cos(2 * psi)], axis=1)

    @property
    def torque(self) -> Array:
        """Torque at `angle` [N m]."""
        return np.asarray(self._waves() @ self.gamma)

    @property
    def sigma(self) -> Array:
        """Its standard deviation [N m]."""
        waves = self._waves()
        return np.asarray(np.sqrt(np.einsum("ai,ij,aj->a", waves, self.covariance, waves)))

    def size(self, n: int) -> tuple[float, float]:
        """Return the amplitude [N m] of the n-th harmonic and its distance from zero in standard deviations."""
        part = slice(2 * n - 2, 2 * n)
        gamma = self.gamma[part]
        square = float(gamma @ np.linalg.solve(self.covariance[part, part], gamma))
        return float(np.hypot(*gamma)), float(np.sqrt(square))


def ripples(fit: Fit) -> list[Ripple]:
    """Return the ripple of each case of a fit; none where speeds were measured and not angles."""
    found = []
    cases = zip(fit.problem.cases, fit.problem.projections, fit.predictions, strict=True)
    for index, (case, project, p) in enumerate(cases):
        if not case.data.is_angle:
            continue
        numbers = fit.problem.layout.numbers(fit.theta, index)
        columns = [
            column
            for name in _LAWS
            for column in case.unit_columns(LIBRARY[name], p.path, p.sensitivity, numbers)
        ]
        both = project(np.concatenate([np.stack(columns, axis=1), (case.data.z - p.rows)[:, None]], axis=1))
        slow = slow_responses(case.data, p)
        basis = orthonormal(project(np.concatenate([p.jacobian, slow], axis=1)), _RANK)
        both = both - basis @ (basis.T @ both)
        seen, residual = both[:, :-1], both[:, -1]
        covariance = np.linalg.pinv(seen.T @ seen, hermitian=True)
        gamma = covariance @ (seen.T @ residual)
        found.append(Ripple(case.data.record.label, np.asarray(gamma), np.asarray(covariance)))
    return found
