"""Figures of merit of a fitted case: the paper's R2, and what the paper's do not show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting.case_data import CaseData
from fitting.estimation.case_model import CaseModel, Prediction
from fitting.estimation.energy import energy_balance
from fitting.estimation.problem import Projection
from fitting.estimation.validation import held_out
from fitting.simulation import Path, Sampler

Array = NDArray[np.float64]

_SPEED = {"casing": "omega_c", "rotor": "omega_r"}


@dataclass(frozen=True)
class BodyMetrics:
    """How well one body is described.

    Attributes
    ----------
    r2, rmse : float
        Of the angular velocity smoothed as in the paper [1, rad/s].
    reduced_chi2 : float
        Chi-square of what was fitted over the effective number of samples.
    held_out : float
        Rms error of held-out stretches over the noise; 1 is as good as can be.
    """

    r2: float
    rmse: float
    reduced_chi2: float
    held_out: float


@dataclass(frozen=True)
class CaseMetrics:
    """How well one case is described; `misfit` is chi2 per row of what a model can reach."""

    label: str
    casing: BodyMetrics
    rotor: BodyMetrics
    energy_drift: float
    misfit: float


def case_metrics(case: CaseModel, project: Projection, prediction: Prediction, theta: Array) -> CaseMetrics:
    """Return the figures of merit of one case."""
    data = case.data
    residual = project(prediction.rows - data.z)
    chi2 = {name: float(np.sum(residual[where] ** 2)) for name, where in data.slices.items()}
    outside = held_out(data, project, prediction)
    quality = {
        "casing": (chi2["casing"] + chi2["harmonic"] + data.casing.rest, data.casing.n_effective),
        "rotor": (chi2["rotor"] + sum(w.rest for w in data.rotor), sum(w.n_effective for w in data.rotor)),
    }
    bodies = {}
    for body in _SPEED:
        if body not in data.speeds:
            bodies[body] = BodyMetrics(*[float("nan")] * 4)
            continue
        r2, rmse = _speed_quality(data, prediction.path, body)
        total, count = quality[body]
        reduced = total / max(1.0, count)
        if body == "rotor" and data.record.generated:  # no noise to measure against
            reduced = outside[body] = float("nan")
        bodies[body] = BodyMetrics(r2, rmse, reduced, outside[body])
    rows = max(1, len(data.z) - project.basis.shape[1])
    return CaseMetrics(
        data.record.label,
        bodies["casing"],
        bodies["rotor"],
        energy_balance(case, theta, prediction.path).drift,
        float(np.sum(residual**2)) / rows,
    )


def _speed_quality(data: CaseData, path: Path, body: str) -> tuple[float, float]:
    t, y = data.speeds[body]
    error = y - Sampler(path.mesh, t).value(path.y[..., path.states.index(_SPEED[body])])
    spread = float(np.sum((y - y.mean()) ** 2))
    return 1 - float(error @ error) / spread if spread > 0 else 0.0, float(np.sqrt(np.mean(error**2)))
