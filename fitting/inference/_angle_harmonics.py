"""Harmonics of the unmodelled torque in the angle of the casing.

Let S be the whitened response of the rows to torques sin(n psi), cos(n psi) of 1 N m, n = 1, 2, and r the whitened
residual. Both are made orthogonal to the free columns (parameters, phases, the camera's centre offset, tilt, rolling
shutter and blur). They are also made orthogonal to slow torques of any shape, because such a torque also has harmonics
of the angle during the few turns in which the casing is slow. Then

    gamma = (S'S)^-1 S'r,   cov(gamma) = (S'S)^-1,   torque(psi) = sum_n gamma_2n-1 sin(n psi) + gamma_2n cos(n psi).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fitting.dynamics._model import Model
from fitting.effects._instances import law_of_main
from fitting.inference._case_model import Prediction
from fitting.inference._linear_algebra import orthogonal_to, orthonormal
from fitting.inference._metrics import slow_responses
from fitting.inference._problem import Problem, is_driven

Array = NDArray[np.float64]

_LAWS = ("casing.unbalance", "casing.asymmetry")
_ANGLE_POINTS = 73
"""Number of points of a curve over one turn [1]. Chosen: steps of 5 degrees; a smaller number shows corners, a larger
one makes larger files."""
_RANK = 1e-6
"""A free direction is rounding error if its singular value, divided by the largest, is below this value [1]. Chosen: a
smaller value projects out rounding errors; with a larger one, some free columns are not projected out."""


@dataclass(frozen=True, repr=False)
class AngleHarmonics:
    """Harmonics of the unmodelled torque in the angle of the casing of one case."""

    label: str  # label of the case
    gamma: Array  # shape (4,); amplitudes of sin psi, -cos psi, sin 2 psi, -cos 2 psi [N m]
    covariance: Array  # shape (4, 4); their covariance [N2 m2]
    turns: float = math.inf  # turns of the casing in the record

    def __repr__(self) -> str:
        sizes = (math.hypot(*self.gamma[:2]), math.hypot(*self.gamma[2:]))
        return f"AngleHarmonics of {self.label}: once a turn {sizes[0]:.3g}, twice a turn {sizes[1]:.3g}"

    @property
    def angle(self) -> Array:
        """Angles of one turn [rad]."""
        return np.linspace(0.0, 2 * np.pi, _ANGLE_POINTS)

    def _columns(self) -> Array:
        psi = self.angle
        return np.stack([np.sin(psi), -np.cos(psi), np.sin(2 * psi), -np.cos(2 * psi)], axis=1)

    @property
    def torque(self) -> Array:
        """Torque at `angle` [N m]."""
        return np.asarray(self._columns() @ self.gamma)

    @property
    def sigma(self) -> Array:
        """Standard deviation of `torque` [N m]."""
        columns = self._columns()
        return np.asarray(np.sqrt(np.einsum("ai,ij,aj->a", columns, self.covariance, columns)))

    def size(self, n: int) -> tuple[float, float]:
        """Return the amplitude [N m] of the n-th harmonic and its distance from zero in standard deviations."""
        part = slice(2 * n - 2, 2 * n)
        gamma = self.gamma[part]
        if not self.covariance[part, part].any():
            return 0.0, 0.0
        # a direction that the free parameters describe completely has zero variance
        square = float(gamma @ np.linalg.pinv(self.covariance[part, part], hermitian=True) @ gamma)
        return float(np.hypot(*gamma)), float(np.sqrt(square))


class Solved(Protocol):
    """The attributes of a `Fit` that determine the harmonics."""

    @property
    def model(self) -> Model: ...
    @property
    def problem(self) -> Problem: ...
    @property
    def predictions(self) -> tuple[Prediction, ...]: ...
    @property
    def theta(self) -> Array: ...


def angle_harmonics(fit: Solved) -> list[AngleHarmonics]:
    """Return the harmonics of each case of a fit.

    Cases are omitted if their speeds do not determine the angle, or if the body oscillates.
    """
    found = []
    cases = zip(fit.problem.cases, fit.problem.projections, fit.predictions, strict=True)
    for index, (case, project, p) in enumerate(cases):
        if case.data.measured_angle is None or not case.data.motion.is_smooth:
            continue
        if case.data.record.driving and not is_driven(fit.model, case.data):
            # if the model lacks the drive of the body, a harmonic of the residuals has no meaning
            continue
        numbers = fit.problem.layout.numbers(fit.theta, index)
        columns = [
            column
            for name in _LAWS
            for column in case.unit_columns(
                law_of_main(name, fit.model.mechanism), p.path, p.sensitivity, numbers
            )
        ]
        rows = project(np.concatenate([np.stack(columns, axis=1), (case.data.z - p.rows)[:, None]], axis=1))
        slow = slow_responses(case.data, p)
        basis = orthonormal(project(np.concatenate([p.jacobian, slow], axis=1)), _RANK)
        size = np.linalg.norm(rows[:, :-1], axis=0)
        rows = orthogonal_to(basis, rows)
        response, residual = rows[:, :-1], rows[:, -1]
        # a torque that is already in the model leaves only rounding errors after the projection
        response[:, np.linalg.norm(response, axis=0) < _RANK * size] = 0.0
        turns = float(np.ptp(case.data.measured_angle)) / (2 * math.pi)
        covariance = np.linalg.pinv(response.T @ response, hermitian=True)
        gamma = covariance @ (response.T @ residual)
        found.append(AngleHarmonics(case.data.record.label, np.asarray(gamma), np.asarray(covariance), turns))
    return found
