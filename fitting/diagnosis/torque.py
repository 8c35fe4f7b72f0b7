"""The torque that a fitted model lacks, as a curve with a band, for each body.

Given the residual rows r = W_c u_c + W_r u_r + noise and a smooth random prior for the torques u on casing and rotor
(an Ornstein-Uhlenbeck process of long correlation time whose level is taken from the residuals themselves), the
posterior mean and its spread are those of a Gaussian process (C. Rasmussen, C. Williams, Gaussian
Processes for Machine Learning, 2.2); start angles and phases are free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting.case_data import CaseData
from fitting.estimation import Fit
from fitting.noise import TorqueNoise, TorqueResponse, remaining_level
from fitting.noise.response import decaying_sums

Array = NDArray[np.float64]

_SHARE = 1 / 30
_FLOOR = 3e-3


@dataclass(frozen=True)
class ResidualTorque:
    """What is missing on one body: time [s], torque and its standard deviation [N m], and both speeds there."""

    label: str
    body: str
    time: Array
    torque: Array
    sigma: Array
    omega_r: Array
    omega_c: Array


def residual_torques(fit: Fit) -> list[ResidualTorque]:
    """Return the residual torque of each body of each case of a fit."""
    curves = []
    for i in range(len(fit.problem.cases)):
        curves += _case(fit, i)
    return curves


def _case(fit: Fit, index: int) -> list[ResidualTorque]:
    from fitting.simulation import Sampler

    data, prediction, noise = fit.problem.data[index], fit.predictions[index], fit.noise[index]
    response = TorqueResponse(data, prediction.motion)
    smooth = data.slices["smooth"]
    residual = data.z - prediction.rows
    time = _SHARE * float(response.edges[-1] - response.edges[0])
    slow = response.whitener(TorqueNoise(0.0, time))
    level, _ = remaining_level(slow, residual, data.nuisance, noise.pure)
    floor = noise.pure**2 * response.covariance(noise.time) if noise.pure > 0 else 0.0
    covariance = np.eye(smooth.stop) + floor
    shaped = {
        "casing": _smear(response.casing, response, time),
        "rotor": _smear(response.rotor, response, time),
    }
    for name, w in (("casing", response.casing), ("rotor", response.rotor)):
        covariance = covariance + level**2 * shaped[name] @ w.T
    gain = _without_nuisance(covariance, data.nuisance[smooth])
    seen = gain @ residual[smooth]
    y = Sampler(prediction.path.mesh, response.centres).value(prediction.path.y)
    curves = []
    for body in ("casing",) if data.record.single else ("casing", "rotor"):
        mean = level**2 * shaped[body].T @ seen
        learned = level**4 * np.einsum("ic,ij,jc->c", shaped[body], gain, shaped[body], optimize=True)
        # rounding sets a floor where the data says almost everything
        sigma = np.sqrt(np.maximum(level**2 - learned, (_FLOOR * level) ** 2))
        seen_at = _seen(response.centres, data, body)
        curves.append(
            ResidualTorque(
                data.record.label,
                body,
                *(v[seen_at] for v in (response.centres, mean, sigma, y[:, 0], y[:, 1])),
            )
        )
    return curves


def _seen(times: Array, data: CaseData, body: str) -> NDArray[np.bool_]:
    """Return when a body was filmed; the rotor between its windows counts, before and after them does not."""
    runs = (data.casing,) if body == "casing" else data.rotor
    first = min(float(r.samples.time[0]) for r in runs)
    last = max(float(r.samples.time[-1]) for r in runs)
    return np.asarray((times >= first) & (times <= last))


def _smear(w: Array, response: TorqueResponse, time: float) -> Array:
    """Return W R for a unit Ornstein-Uhlenbeck process."""
    decay = float(np.exp(-(response.edges[1] - response.edges[0]) / time))
    later, earlier = decaying_sums(w.T, decay), decaying_sums(w.T[::-1], decay)[::-1]
    return np.asarray((later + earlier).T - w)


def _without_nuisance(covariance: Array, nuisance: Array) -> Array:
    """Return C^-1 with the columns of free nuisances projected out."""
    inverse = np.linalg.inv(0.5 * (covariance + covariance.T))
    size = np.linalg.norm(nuisance, axis=0)
    columns = nuisance[:, size > 0] / size[size > 0]
    weighted = inverse @ columns
    return np.asarray(inverse - weighted @ np.linalg.pinv(columns.T @ weighted, hermitian=True) @ weighted.T)
