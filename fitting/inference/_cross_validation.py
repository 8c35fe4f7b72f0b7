"""Cross-validation over recordings.

Parameters that the recordings share have the values of a fit of the other recordings. Only parameters that these do not
determine are free: the friction at the touch point (another surface) and the initial speeds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from fitting._errors import EstimationError
from fitting.dynamics._model import Model
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit
from fitting.inference._metrics import BodyMetrics
from fitting.inference._noise import Noise
from fitting.inference._result import Fit


@dataclass(frozen=True)
class Predicted:
    """One recording, predicted from the others."""

    label: str
    casing: float  # rms error over the noise; 1 = noise limit
    rotor: float
    r2: float  # of the casing's smoothed speed
    rmse: float  # of the casing's smoothed speed [rad/s]
    others: Fit  # the fit of the others, from which the shared parameters come


def predict_recordings(
    model: Model, data: Sequence[CaseData], noise: Sequence[Noise], *, alone: Sequence[Fit] = ()
) -> tuple[Predicted, ...]:
    """Predict each recording from a fit of the others.

    Parameters
    ----------
    model : Model
        The model.
    data : sequence of CaseData
        At least two recordings.
    noise : sequence of Noise
        Of each, from an earlier fit.
    alone : sequence of Fit
        Fits of the model to each recording alone, if they are known already (saves time for two recordings).

    Raises
    ------
    EstimationError
        If there is only one recording.
    """
    if len(data) < 2:
        raise EstimationError(
            "one recording cannot be predicted from others", "give several cases, or look at held-out times"
        )
    surface = {f"{e.name}.{p.symbol}" for e in model.effects if e.per_surface for p in e.free}
    shared = [key for key in model.free if key not in surface]
    found = []
    for i, held in enumerate(data):
        rest = [k for k in range(len(data)) if k != i]
        others = (
            alone[rest[0]]
            if len(rest) == 1 and alone
            else fit(
                model,
                [data[k] for k in rest],
                # a parameter with a value for each case has no value for another recording: all others share it
                share=shared,
                noise=[noise[k] for k in rest],
            )
        )
        held_values = {key: others.estimates[key].value for key in shared}
        free = fit(model.with_fixed(held_values), [held], noise=[noise[i]])
        (case,) = free.cases
        found.append(
            Predicted(
                held.record.label,
                _prediction_error(case.casing),
                _prediction_error(case.rotor),
                case.casing.r2,
                case.casing.rmse,
                others,
            )
        )
    return tuple(found)


def _prediction_error(body: BodyMetrics) -> float:
    return math.sqrt(body.reduced_chi2)
