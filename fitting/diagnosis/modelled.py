"""A modelled speed with the error that the parameters' errors give it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fitting.estimation.layout import START_CASING, START_ROTOR
from fitting.simulation import Sampler

if TYPE_CHECKING:
    from fitting.estimation import Fit

Array = NDArray[np.float64]

ROTOR, CASING = 0, 1


def modelled_speed(fit: Fit, case: int, body: int, time: Array) -> tuple[Array, Array]:
    """Return the speed of a body and its standard deviation, sqrt(s' C s) with the sensitivities s [rad/s].

    Parameters
    ----------
    fit : Fit
        The fit.
    case : int
        Which of its cases.
    body : int
        `ROTOR` or `CASING`.
    time : ndarray, shape (n,)
        Times within the run [s].
    """
    prediction, model = fit.predictions[case], fit.problem.cases[case]
    sampler = Sampler(prediction.path.mesh, time)
    places = fit.problem.layout.places(case, (*model.dynamics.parameters, START_ROTOR, START_CASING))
    slope = sampler.value(prediction.sensitivity.nodes[:, :, body])
    covariance = fit.covariance[np.ix_(places, places)]
    # a parameter that moves nothing has no finite variance and does not matter here
    covariance = np.where(np.isfinite(covariance), covariance, 0.0)
    variance = np.einsum("tp,pq,tq->t", slope, covariance, slope)
    return sampler.value(prediction.path.y[..., body]), np.sqrt(np.maximum(variance, 0.0))
