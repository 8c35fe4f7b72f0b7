"""Torques that are any function of a speed, or of time: piecewise linear between knots."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fitting.discovery.columns import CaseColumns
from fitting.discovery.scoring import free_score
from fitting.discovery.stage import Stage
from fitting.estimation import Fit
from fitting.estimation.case_model import Prediction
from fitting.estimation.lack import block_diagonal
from fitting.simulation import Sampler

Array = NDArray[np.float64]

KNOTS = (4, 8)


def speeds(times: Array, prediction: Prediction) -> Array:
    """Return the speeds of casing, rotor and bearing, shape (3, times) [rad/s]."""
    y = Sampler(prediction.path.mesh, times).value(prediction.path.y)
    return np.stack([y[:, 1], y[:, 0], y[:, 0] - y[:, 1]])


def hats(speed: Array, knots: Array) -> Array:
    """Return the functions that are 1 at one knot and 0 at the others, at some speeds, shape (speeds, knots)."""
    return np.stack([np.interp(speed, knots, row) for row in np.eye(len(knots))], axis=1)


def any_law_of_the_casing(fit: Fit) -> float:
    """Return the fall of the deviance by a torque on the casing that follows its speed in whatever way.

    The law is the same in all cases. It is scored as a candidate is, without a refit.
    """
    return _fall(fit, lambda case, p: speeds(case.response.centres, p)[0])


def any_slow_torque(fit: Fit, *, apart: bool = False) -> float:
    """Return the fall of the deviance by a torque on the casing that changes slowly in time, scored in the same way.

    It is the same in all cases, or each has one of its own (`apart`).
    """
    return _fall(fit, lambda case, _: case.response.centres, apart=apart)


def _fall(fit: Fit, followed: Callable[[CaseColumns, Prediction], Array], *, apart: bool = False) -> float:
    cases = [CaseColumns(fit, i) for i in range(len(fit.predictions))]
    stage = Stage(fit, 1)
    own = [followed(c, p) for c, p in zip(cases, fit.predictions, strict=True)]
    least, most = min(float(x.min()) for x in own), max(float(x.max()) for x in own)
    found = []
    for count in KNOTS:
        knots = np.linspace(least, most, count)
        rows = [_rows(c, c.response.casing @ hats(x, knots)) for c, x in zip(cases, own, strict=True)]
        found.append(free_score(stage, block_diagonal(rows) if apart else np.concatenate(rows)))
    return max(found)


def _rows(case: CaseColumns, smooth: Array) -> Array:
    rows = np.zeros((len(case.case.data.z), smooth.shape[1]))
    rows[: len(smooth)] = smooth
    return rows
