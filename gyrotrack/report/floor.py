"""What the noise of the samples alone makes of the paper's rms error of a speed.

The paper's smoothing of a noisy angle has an error of its own, which no model can lower. It is found by
putting the modelled angle, with noise as strong as that of the data, through the same smoothing. The noise is
that of the fastest changes, which no motion makes: third differences of white noise of rms s have an rms of
s sqrt(20).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from fitting.estimation import Fit

Array = NDArray[np.float64]

_SEED = 1
_NORMAL = 0.6745  # median of the absolute value of a standard normal variable
_THIRD = 20.0  # 1 + 9 + 9 + 1


def smoothing_floor(fit: Fit) -> float:
    """Return the rms error of the casing's speed that noise alone leaves, over all cases [rad/s]."""
    return float(np.sqrt(np.mean([_floor(fit, i) ** 2 for i in range(len(fit.problem.data))])))


def _floor(fit: Fit, case: int) -> float:
    from fitting.record import Samples
    from fitting.simulation import Sampler
    from fitting.smoothing import speeds

    record, path = fit.problem.data[case].record, fit.predictions[case].path
    measured = record.casing
    noise = float(np.median(np.abs(np.diff(measured.value, 3)))) / _NORMAL / np.sqrt(_THIRD)
    sampler = Sampler(path.mesh, measured.time)
    omega = sampler.value(path.y[..., 1])
    exact = sampler.integral(*path.angle(path.states[1])) if record.quantity == "angle" else omega
    # the seed is fixed so that a report does not change from run to run
    shaken = exact + noise * np.random.default_rng(_SEED).standard_normal(len(exact))
    time, seen = speeds(Samples(measured.time, shaken, measured.sigma), record.quantity)
    return float(np.sqrt(np.mean((seen - np.interp(time, measured.time, omega)) ** 2)))
