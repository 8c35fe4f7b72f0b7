"""The energy balance: what is left of the start's kinetic energy, plus all losses, must stay what it was.

    K(t) + integral_0^t [ tau_cr D + (a1 w_r + a2 w_r^2) w_r + (b1 + b2 w_c) w_c ] dt = K(0),

every friction term a loss; for any model the loss is minus the power of its torques on both bodies,
-(tau_r w_r + tau_c w_c). As in the paper, the casing's *measured* speed enters, so that a model that
misses a torque does not balance; the rotor's speed is the model's, held to its windows by the fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting.dynamics import INERTIA_CASING, INERTIA_ROTOR
from fitting.estimation.case_model import CaseModel
from fitting.simulation import Path, Sampler

Array = NDArray[np.float64]

_POINTS = 2000


@dataclass(frozen=True)
class EnergyBalance:
    """Time [s], balance K + losses [J] (constant for a right model), and its largest relative drift."""

    time: Array
    energy: Array
    drift: float


def energy_balance(case: CaseModel, theta: Array, path: Path) -> EnergyBalance:
    """Return the energy balance of a fitted case.

    Parameters
    ----------
    case : CaseModel
        The case.
    theta : ndarray
        Variables of the fit.
    path : Path
        Its solution.

    Returns
    -------
    EnergyBalance
    """
    time, omega = case.data.speeds["casing"]
    t = np.linspace(time[0], time[-1], min(_POINTS, len(time)))
    state = Sampler(path.mesh, t).value(path.y)
    state[:, 1] = np.interp(t, time, omega)
    numbers = case.layout.numbers(theta, case.case)
    rates = case.dynamics.rates(t, state, numbers)
    inertia = np.array([numbers[INERTIA_ROTOR], numbers[INERTIA_CASING]])
    kinetic = 0.5 * (state[:, :2] ** 2) @ inertia
    power = -np.sum(rates[:, :2] * inertia * state[:, :2], axis=1)
    lost = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(t))])
    energy = kinetic + lost
    return EnergyBalance(t, energy, float(np.max(np.abs(energy / energy[0] - 1))))
