"""The fitted curve at the samples and at any time, with the fitted nuisance parameters."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fitting._arguments import TEXT, require
from fitting._errors import EstimationError
from fitting.dynamics._collocation import Sampler
from fitting.inference._case_data import CaseData
from fitting.inference._case_model import Prediction
from fitting.inference._problem import Problem

Array = NDArray[np.float64]

_CASING = 1
"""Place of the casing in a state [1]. Derived: a state begins with omega_r and omega_c."""


class Solved(Protocol):
    """The attributes of a `Fit` that its curve follows from."""

    @property
    def problem(self) -> Problem: ...
    @property
    def predictions(self) -> tuple[Prediction, ...]: ...


def _nuisance(case: int, found: Solved) -> Array:
    """Return the nuisance parameters of a case by generalised least squares: start angles, then those of cameras."""
    prediction, fitted = found.predictions[case], found.problem.data[case]
    rows = np.concatenate([fitted.nuisance, (fitted.z - prediction.rows)[:, None]], axis=1)
    white = found.problem.projections[case].whitener(rows)
    size = np.linalg.norm(white[:, :-1], axis=0)
    size[size == 0] = np.inf
    return np.asarray(np.linalg.lstsq(white[:, :-1] / size, white[:, -1], rcond=1e-7)[0] / size)


def predicted_samples(data: CaseData, case: int, found: Solved) -> Iterator[Array]:
    """Yield the prediction with fitted nuisance parameters at every sample, of the casing, then of each window."""
    record, fitted = data.record, found.problem.data[case]
    path = found.predictions[case].path
    coefficients = _nuisance(case, found)
    # initial angles come first, then the amplitudes of error modes
    angles = 1 + len(record.rotor) if data.is_angle else 0
    columns = (fitted.mode_columns[0], *fitted.mode_columns[1])
    for i, samples in enumerate((record.casing, *record.rotor)):
        state = "omega_r" if i else "omega_c"
        sampler = Sampler(path.mesh, samples.time)
        modes = columns[i] @ coefficients[angles : angles + columns[i].shape[1]]
        if not data.is_angle:
            yield sampler.value(path.y[..., path.states.index(state)]) + modes
            continue
        angle = sampler.integral(*path.angle(state)) + coefficients[i] + modes
        if i == 0 and fitted.has_camera_prior:
            angle = angle + fitted.camera_columns @ coefficients[-fitted.camera_columns.shape[1] :]
        yield angle


def residuals_of(found: Solved) -> Array:
    """Return measured minus fitted values of all samples over their stated standard uncertainties."""
    parts = []
    for case, data in enumerate(found.problem.data):
        runs = (data.record.casing, *data.record.rotor)
        for samples, model in zip(runs, predicted_samples(data, case, found), strict=True):
            parts.append((samples.value - model) / samples.sigma)
    return np.concatenate(parts)


def evaluate(found: Solved, time: Any, body: int, case: int, quantity: str | None) -> Array:
    """Return the fitted angle [rad] or speed [rad/s] of a body (0 is the rotor, 1 the casing) at some times [s]."""
    data = found.problem.data[case]
    measured = data.record.quantity
    require("quantity", quantity, TEXT.optional)
    chosen = measured if quantity is None else quantity
    if chosen not in ("angle", "omega"):
        raise EstimationError(f"the quantity is {str(chosen)[:20]!r}", "use angle or omega")
    if chosen == "angle" and measured == "omega":
        raise EstimationError("speeds were measured, which have no start angle", 'use quantity="omega"')
    runs = (data.record.casing,) if body == _CASING else data.record.rotor
    first, last = data.record.span
    try:
        at = np.concatenate([r.time for r in runs]) if time is None else np.asarray(time, dtype=np.float64)
    except (TypeError, ValueError):
        raise EstimationError("the times are not numbers", "use a NumPy array [s]") from None
    flat = np.atleast_1d(at).ravel()
    if not ((flat >= first) & (flat <= last)).all():
        raise EstimationError(
            "a time is not within the record", f"give times from {first:.6g} to {last:.6g} s"
        )
    state = "omega_c" if body == _CASING else "omega_r"
    path = found.predictions[case].path
    sampler = Sampler(path.mesh, flat)
    if chosen == "omega":
        return np.asarray(sampler.value(path.y[..., path.states.index(state)])).reshape(at.shape)
    start = _nuisance(case, found)[: 1 + len(data.record.rotor)]
    angle = sampler.integral(*path.angle(state))
    if body == _CASING:
        return np.asarray(angle + start[0]).reshape(at.shape)
    # the start angle differs between the windows
    begins = np.array([w.time[0] for w in data.record.rotor])
    window = np.clip(np.searchsorted(begins, flat, side="right") - 1, 0, len(begins) - 1)
    return np.asarray(angle + start[1:][window]).reshape(at.shape)
