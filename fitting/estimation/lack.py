"""Lack of fit: how much of the misfit any slow torque would take away, against what noise alone would give it.

Slow torques on the casing and in the bearing, piecewise linear in time with knots a twentieth of the record apart, are
given to the fitted model all at once. With the whitened response S to them, beside all that is free,

    chi2 = r'S (S'S)^-1 S'r   with rank(S) degrees of freedom

if the model is right: the test of lack of fit against pure error (N. Draper, H. Smith, Applied Regression
Analysis, Wiley (1998), 1.5), blind to which law is missing and so able to object to every one that is named.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting.case_data import CaseData
from fitting.estimation.case_model import Prediction
from fitting.estimation.noise_levels import Noise
from fitting.estimation.problem import Problem, Projection
from fitting.noise import TorqueResponse

Array = NDArray[np.float64]

_KNOTS = 21
_RANK = 1e-4
_RANK_FREE = 1e-7


@dataclass(frozen=True)
class LackOfFit:
    """Chi-square that slow torques take away, its degrees of freedom, and the probability of as much by noise."""

    chi2: float
    dof: int

    @property
    def p_value(self) -> float:
        """Probability of such a chi-square if nothing is missing.

        Its cube root is nearly normal (E. Wilson, M. Hilferty, Proc. Natl. Acad. Sci. 17, 684 (1931)); far out, where
        the approximation is off by a factor, nobody needs the factor.
        """
        if self.dof == 0:
            return 1.0
        spread = 2 / (9 * self.dof)
        z = ((self.chi2 / self.dof) ** (1 / 3) - (1 - spread)) / math.sqrt(spread)
        return 0.5 * math.erfc(z / math.sqrt(2))


def lack_of_fit(problem: Problem, predictions: Sequence[Prediction], noise: Sequence[Noise]) -> LackOfFit:
    """Return the lack of fit of a fitted model, at the pure noise of its cases.

    Parameters
    ----------
    problem : Problem
        The cases.
    predictions : sequence of Prediction
        What the fitted model predicts for each.
    noise : sequence of Noise
        Their noise.
    """
    slow, free, residual = [], [], []
    for data, p, n in zip(problem.data, predictions, noise, strict=True):
        rows = slow_responses(data, p)
        project = Projection(data, n.whitener.at(n.pure))
        white = project(np.concatenate([rows, p.jacobian, (data.z - p.rows)[:, None]], axis=1))
        slow.append(white[:, : rows.shape[1]])
        free.append(white[:, rows.shape[1] : -1])
        residual.append(white[:, -1])
    # the parameters are common to all cases, so the cases are tested together
    basis, r, s = (
        orthonormal(np.concatenate(free), _RANK_FREE),
        np.concatenate(residual),
        block_diagonal(slow),
    )
    r = r - basis @ (basis.T @ r)
    span = orthonormal(s - basis @ (basis.T @ s), _RANK)
    return LackOfFit(float(np.sum((span.T @ r) ** 2)), span.shape[1])


def slow_responses(data: CaseData, prediction: Prediction) -> Array:
    """Return the responses of a case's rows to slow torques of 1 N m, on the casing and in the bearing.

    One column for each knot of each, shape (rows, 42); between the knots, a twentieth of the record apart, a torque
    is linear.
    """
    response = TorqueResponse(data, prediction.motion)
    hats = _hats(response.centres)
    columns = np.concatenate([response.casing @ hats, (response.casing - response.rotor) @ hats], axis=1)
    rows = np.zeros((len(data.z), columns.shape[1]))
    rows[: len(columns)] = columns
    return rows


def block_diagonal(parts: Sequence[Array]) -> Array:
    """Return a block-diagonal matrix of these parts."""
    rows, columns = sum(len(p) for p in parts), sum(p.shape[1] for p in parts)
    out = np.zeros((rows, columns))
    i = j = 0
    for p in parts:
        out[i : i + len(p), j : j + p.shape[1]] = p
        i, j = i + len(p), j + p.shape[1]
    return out


def _hats(times: Array) -> Array:
    knots = np.linspace(times[0], times[-1], _KNOTS)
    return np.stack([np.interp(times, knots, row) for row in np.eye(_KNOTS)], axis=1)


def orthonormal(columns: Array, smallest: float) -> Array:
    """Return an orthonormal basis of scaled columns, without directions whose singular value is a share this small."""
    size = np.linalg.norm(columns, axis=0)
    if not (size > 0).any():
        return np.zeros((len(columns), 0))
    u, s, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    return np.asarray(u[:, s > smallest * s[0]])
