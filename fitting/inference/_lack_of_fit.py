"""Test of lack of fit against any slow torque.

Slow torques on the casing and in the bearing, piecewise linear in time with knots a twentieth of the record apart, are
added to the fitted model all at once. With the whitened response S to them, beside all that is free,

    chi2 = r'S (S'S)^-1 S'r   with rank(S) degrees of freedom

if the model is right: the test of lack of fit against pure error (N. Draper, H. Smith, Applied Regression
Analysis, Wiley (1998), 1.5), which does not depend on which law is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting.inference._case_data import CaseData
from fitting.inference._case_model import Prediction
from fitting.inference._noise import Noise, TorqueResponse, tail_probability
from fitting.inference._problem import Problem, Projection, r_factor

Array = NDArray[np.float64]

_KNOTS = 21
_RANK = 1e-4
_RANK_FREE = 1e-7
# cases from which on they are looked at one by one
_MANY = 4


@dataclass(frozen=True)
class LackOfFit:
    """Chi-square that slow torques take away, its degrees of freedom, and the probability of as much by noise.

    The process noise is known with an uncertainty, which is integrated out.
    """

    chi2: float
    dof: int
    p_value: float


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
    slow, free, residual, shares = [], [], [], []
    for data, p, n in zip(problem.data, predictions, noise, strict=True):
        rows = slow_responses(data, p)
        project = Projection(data, n.whitener.at(n.pure))
        white = project(np.concatenate([rows, p.columns, (data.z - p.rows)[:, None]], axis=1))
        shares.append(project.whitener.share(orthonormal(white[:, : rows.shape[1]], _RANK)))
        few = r_factor(white)
        slow.append(few[:, : rows.shape[1]])
        free.append(np.zeros((len(few), p.count)))
        free[-1][:, p.places] = few[:, rows.shape[1] : -1]
        residual.append(few[:, -1])
    # the parameters are common to all cases, so the cases are tested together
    chi2, dof = (_case_by_case if len(slow) > _MANY else _together)(slow, free, residual)
    p_value = float(tail_probability(chi2, dof, noise, shares)) if dof else 1.0
    return LackOfFit(chi2, dof, p_value)


def _together(slow: Sequence[Array], free: Sequence[Array], residual: Sequence[Array]) -> tuple[float, int]:
    basis, r, s = (
        orthonormal(np.concatenate(free), _RANK_FREE),
        np.concatenate(residual),
        block_diagonal(slow),
    )
    r = r - basis @ (basis.T @ r)
    span = orthonormal(s - basis @ (basis.T @ s), _RANK)
    return float(np.sum((span.T @ r) ** 2)), span.shape[1]


def _case_by_case(
    slow: Sequence[Array], free: Sequence[Array], residual: Sequence[Array]
) -> tuple[float, int]:
    """Return the lack of fit of many cases: P(S, B) - P(B), with each case's S projected out first.

    The same but for the ranks, which are decided case by case; its cost does not grow with the cube of the cases.
    """
    total, rank, left = 0.0, 0, []
    for s, b, r in zip(slow, free, residual, strict=True):
        span = orthonormal(s, _RANK)
        total += float(np.sum((span.T @ r) ** 2))
        rank += span.shape[1]
        left.append(np.concatenate([b, r[:, None]], axis=1) - span @ (span.T @ np.column_stack([b, r])))
    both = np.concatenate(left)
    # what is left of a parameter beside slow torques, beside what there was of it
    size = np.linalg.norm(np.concatenate(free), axis=0)
    for rows, sign in ((both, 1), (np.column_stack([np.concatenate(free), np.concatenate(residual)]), -1)):
        u, value, _ = np.linalg.svd(rows[:, :-1][:, size > 0] / size[size > 0], full_matrices=False)
        u = u[:, value > (_RANK if sign > 0 else _RANK_FREE) * value[0]]
        total += sign * float(np.sum((u.T @ rows[:, -1]) ** 2))
        rank += sign * u.shape[1]
    return max(total, 0.0), max(rank, 0)


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
