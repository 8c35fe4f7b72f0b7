"""Held-out error: how well a fit predicts stretches of time that it has not seen.

For a linear model with noise covariance C, leaving out the rows h changes the prediction so that the error is

    e_h = (G_hh)^-1 (G r)_h,   cov(e_h) = (G_hh)^-1,   G = C^-1 - C^-1 X (X' C^-1 X)^-1 X' C^-1,

with the residuals r of the full fit and the columns X of parameters and nuisances: the exact result of
refitting without them, without refitting (leave-block-out; O. Dubrule, Math. Geol. 15, 687 (1983)).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fitting.case_data import CaseData
from fitting.estimation.case_model import Prediction
from fitting.estimation.problem import Projection

Array = NDArray[np.float64]

FOLDS = 6


def held_out(data: CaseData, project: Projection, prediction: Prediction) -> dict[str, float]:
    """Return the rms error of held-out stretches over their noise, for each body.

    Parameters
    ----------
    data : CaseData
        The case.
    project : Projection
        Its noise and nuisances.
    prediction : Prediction
        The fitted model.

    Returns
    -------
    dict
        ``casing``: each of six stretches of time predicted from the others; ``rotor``: each
        window predicted from all else. 1 means as good as the noise allows.
    """
    jacobian = project(prediction.columns)
    size = np.linalg.norm(jacobian, axis=0)
    used = np.concatenate([project.basis, np.linalg.qr(jacobian[:, size > 0] / size[size > 0])[0]], axis=1)
    residual = project(prediction.rows - data.z)
    residual = residual - used @ (used.T @ residual)
    weighted = project.whitener(residual)
    result = {}
    for body, folds, rest, count in (
        ("casing", _casing_folds(data), data.casing.rest, data.casing.n_effective),
        (
            "rotor",
            _rotor_folds(data),
            sum(w.rest for w in data.rotor),
            sum(w.n_effective for w in data.rotor),
        ),
    ):
        total = rest + sum(_error(project, used, weighted, fold) for fold in folds)
        result[body] = float(np.sqrt(total / max(count, 1.0)))
    return result


def _error(project: Projection, used: Array, weighted: Array, fold: Array) -> float:
    columns = np.zeros((len(weighted), len(fold)))
    columns[fold, np.arange(len(fold))] = 1.0
    white = project.whitener(columns)
    inner = used.T @ white
    values, vectors = np.linalg.eigh(white.T @ white - inner.T @ inner)
    keep = values > 1e-9 * values[-1]
    seen = vectors[:, keep].T @ weighted[fold]
    return float(np.sum(seen**2 / values[keep]))


def _casing_folds(data: CaseData) -> list[Array]:
    blocks, k, _ = data.casing.lift.shape
    harmonics = len(data.casing.harmonic) // blocks
    first = data.slices["harmonic"].start
    folds = []
    for part in np.array_split(np.arange(blocks), min(FOLDS, blocks)):
        rows = (part[:, None] * k + np.arange(k)).ravel()
        tail = first + (part[:, None] * harmonics + np.arange(harmonics)).ravel()
        folds.append(np.concatenate([rows, tail]))
    return folds


def _rotor_folds(data: CaseData) -> list[Array]:
    ends = data.slices["rotor"].start + np.cumsum([0, *(len(w.z) for w in data.rotor)])
    return [np.arange(a, b) for a, b in pairwise(ends)]
