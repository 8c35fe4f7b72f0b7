"""Robust losses.

An M-estimate makes sum psi(r_i / s) J_i vanish instead of sum r_i J_i. It is found by least squares on pseudo-values

    y*_i = m_i + s psi(r_i / s) / <psi'>,

with the model m and the measured scale s, until they no longer change (P. J. Huber, Robust Statistics, 7.8). Their
noise has variance s^2 <psi^2> / <psi'>^2, which is the asymptotic variance of the M-estimate; so a fit of the
pseudo-values, which measures its noise as always, gives the right covariance with no correction.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitting._errors import EstimationError
from fitting.dynamics._mesh import Sampler
from fitting.dynamics._model import Model
from fitting.inference._case_data import CaseData, camera_columns
from fitting.inference._fit import fit
from fitting.inference._record import Record, Samples
from fitting.inference._result import Fit

Array = NDArray[np.float64]
Psi = Callable[[Array], tuple[Array, Array]]

# 95 % of the efficiency of least squares where the noise is normal
_HUBER, _CAUCHY = 1.345, 2.385
_ROUNDS = 12
_STILL = 0.01


def huber(x: Array) -> tuple[Array, Array]:
    """Return psi and its slope: linear up to 1.345 standard deviations, constant beyond."""
    inside = np.abs(x) <= _HUBER
    return np.clip(x, -_HUBER, _HUBER), inside.astype(float)


def cauchy(x: Array) -> tuple[Array, Array]:
    """Return psi and its slope: x / (1 + (x / 2.385)^2), which forgets what lies far out."""
    q = (x / _CAUCHY) ** 2
    return x / (1 + q), (1 - q) / (1 + q) ** 2


_LOSSES: dict[str, tuple[Psi, ...]] = {"linear": (), "huber": (huber,), "cauchy": (huber, cauchy)}


def robust_fit(model: Model, cases: Sequence[Record | CaseData], loss: str = "linear", **options: Any) -> Fit:
    """Fit a model with a loss that outliers do not rule.

    Parameters
    ----------
    model : Model
        The model.
    cases : sequence of Record or CaseData
        As for `fit`.
    loss : {"linear", "huber", "cauchy"}
        "linear" is least squares; "huber" limits the pull of a sample; "cauchy" forgets outliers, and starts from
        "huber".
    **options
        Passed on to `fit`.

    Returns
    -------
    Fit
        R2, rmse and energy are of the data as measured; chi-square and held-out error of the pseudo-values.

    Raises
    ------
    EstimationError
        If the loss is not known.
    """
    if loss not in _LOSSES:
        raise EstimationError(f"there is no loss named {str(loss)[:40]!r}", "take linear, huber or cauchy")
    if loss != "linear" and (model.angle_dependent or model.measurement):
        raise EstimationError(
            "a robust loss goes with neither laws that follow an angle nor effects of a camera",
            "fit without them, or with --loss linear",
        )
    found = fit(model, cases, **options)
    data = found.problem.data
    for psi in _LOSSES[loss]:
        for _ in range(_ROUNDS):
            pseudo = [_pseudo(d, case, found, psi) for case, d in enumerate(data)]
            before = found.theta
            again: Mapping[str, Any] = options | {"start": {k: e.value for k, e in found.estimates.items()}}
            found = fit(model, pseudo, **again)
            errors = np.sqrt(np.diag(found.covariance))
            moved = np.abs(found.theta - before) > _STILL * errors
            if not np.any(moved & (errors > 0)):
                break
    return found


def _pseudo(data: CaseData, case: int, found: Fit, psi: Psi) -> CaseData:
    """Return the case with pseudo-values about a fit; its record stays what was measured."""
    values = []
    for samples, model in zip(
        (data.record.casing, *data.record.rotor), _predicted(data, case, found), strict=True
    ):
        x = (samples.value - model) / samples.sigma
        scale = 1.4826 * float(np.median(np.abs(x)))
        pull, slope = psi(x / scale)
        values.append(model + samples.sigma * scale * pull / max(float(slope.mean()), 0.1))
    runs = [
        Samples(s.time, v, s.sigma)
        for s, v in zip((data.record.casing, *data.record.rotor), values, strict=True)
    ]
    made = CaseData.of(replace(data.record, casing=runs[0], rotor=tuple(runs[1:])))
    return CaseData(data.record, made.casing, made.rotor)


def _predicted(data: CaseData, case: int, found: Fit) -> Iterator[Array]:
    """Yield what the model with its nuisances says at every sample: of the casing, then of each window."""
    record, prediction = data.record, found.predictions[case]
    path = prediction.path
    project = found.problem.projections[case]
    own = found.problem.data[case]
    # the nuisances as generalised least squares sees them
    white = project.whitener(np.concatenate([own.nuisance, (own.z - prediction.rows)[:, None]], axis=1))
    size = np.linalg.norm(white[:, :-1], axis=0)
    size[size == 0] = np.inf
    coefficients = np.linalg.lstsq(white[:, :-1] / size, white[:, -1], rcond=1e-7)[0] / size
    for i, samples in enumerate((record.casing, *record.rotor)):
        state = "omega_r" if i else "omega_c"
        sampler = Sampler(path.mesh, samples.time)
        if not data.is_angle:
            yield sampler.value(path.y[..., path.states.index(state)])
            continue
        angle = sampler.integral(*path.angle(state)) + coefficients[i]
        if i == 0:
            angle = angle + camera_columns(own.casing.samples) @ coefficients[1 + len(record.rotor) :]
        yield angle
