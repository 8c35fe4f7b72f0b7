"""Figures of merit against their definitions: cross-validation by refits, energy by integration."""

import numpy as np
import pytest
import twobody
from cases import fitted

from fitting.inference import _metrics
from fitting.inference._metrics import energy_balance
from fitting.inference._problem import Projection


def parts(result, level):
    """Return the case, its noise, its prediction, and the well determined directions of the fit."""
    problem = result.problem
    data, p = problem.data[0], result.predictions[0]
    project = Projection(data, result.noise[0].whitener.at(level))
    columns = project.whitener(np.concatenate([data.nuisance, p.jacobian], axis=1))
    size = np.linalg.norm(columns, axis=0)
    u, s, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    used = u[:, s > 1e-4]
    residual = project.whitener(p.rows - data.z)
    return data, project, used, residual - used @ (used.T @ residual)


# a random torque of 1e-9 N m already correlates the rows, of 1e-10 N m those of the rotor, whose windows have noise of
# their own; more would be beyond the digits of this plain algebra
@pytest.mark.slow
@pytest.mark.parametrize(
    ("body", "level"), [("rotor", 0.0), ("rotor", 1e-10), ("casing", 0.0), ("casing", 1e-9)]
)
def test_cross_validation_error_is_that_of_a_fit_without_the_fold(level, body):
    """Least squares on the other rows, prediction of the fold with its covariance, computed explicitly."""
    data, project, used, residual = parts(fitted(seed=0, ou=1e-7, few=True), level)
    n = len(data.z)
    root = project.whitener(np.eye(n))  # C^-1/2
    back = np.linalg.inv(root)
    covariance, columns = back @ back, back @ used  # the same columns, orthonormal once they are whitened
    y = back @ residual  # what the columns explain has no part in it: start angles of 1e5 rad are gone
    folds = _metrics._casing_folds(data) if body == "casing" else _metrics._rotor_folds(data)
    for fold in folds[1:2]:
        rest = np.setdiff1d(np.arange(n), fold)
        inverse = np.linalg.inv(covariance[np.ix_(rest, rest)])
        x = columns[rest]
        known, directions = np.linalg.eigh(x.T @ inverse @ x)
        # what only the fold determines (the phase of its window) is left wide open
        normal = (directions / np.maximum(known, 1e-11)) @ directions.T
        beta = normal @ (x.T @ (inverse @ y[rest]))
        gain = covariance[np.ix_(fold, rest)] @ inverse
        error = y[fold] - columns[fold] @ beta - gain @ (y[rest] - x @ beta)
        spread = columns[fold] - gain @ x
        variance = covariance[np.ix_(fold, fold)] - gain @ covariance[np.ix_(rest, fold)]
        values, vectors = np.linalg.eigh(variance + spread @ normal @ spread.T)
        seen = vectors.T @ error
        keep = values < 1e10
        assert (body == "rotor") <= (~keep).sum() <= 2
        expected = float(np.sum(seen[keep] ** 2 / values[keep]))
        found = _metrics._error(project, used, project.whitener(residual), fold)
        assert found == pytest.approx(expected, rel=2e-3)


@pytest.mark.slow
def test_cross_validation_error_is_one_for_the_right_model_only():
    right, wrong = fitted(seed=0), fitted(seed=0, hidden="step")
    assert right.cases[0].casing.held_out == pytest.approx(1.0, abs=0.04)
    assert wrong.cases[0].casing.held_out > 2
    assert wrong.held_out_of_first_casing == wrong.cases[0].casing.held_out


def test_folds_contain_every_row_once():
    data = fitted(seed=0, few=True).problem.data[0]
    rows = np.concatenate([*_metrics._casing_folds(data), *_metrics._rotor_folds(data)])
    assert sorted(rows.tolist()) == list(range(data.slices["harmonic"].stop))  # and no prior


def test_energy_balance_of_the_right_model_is_constant():
    result = fitted(seed=0)
    balance = energy_balance(result.problem.cases[0], result.theta, result.predictions[0].path)
    start = 0.5 * (twobody.I_ROTOR * 900**2 + twobody.I_CASING * 5**2)
    assert balance.energy[0] == pytest.approx(start, rel=5e-3)
    assert balance.drift < 2e-4
    assert balance.drift == pytest.approx(np.max(np.abs(balance.energy / balance.energy[0] - 1)))


def test_energy_balance_agrees_with_the_formula_of_the_paper():
    """K + integral of [tau D + a2 w_r^3 + (b1 + b2 w_c) w_c] dt is constant: every term is a loss."""
    motion, p = twobody.simulate(), twobody.PAPER
    wr, wc = motion.speed.T
    diff = wr - wc
    tau = p["d"] * diff + p["f"] * diff ** p["g"]
    power = tau * diff + p["a2"] * wr**3 + (p["b1"] + p["b2"] * wc) * wc
    step = motion.time[1]
    lost = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * step)])
    total = 0.5 * (twobody.I_ROTOR * wr**2 + twobody.I_CASING * wc**2) + lost
    assert np.abs(total / total[0] - 1).max() < 1e-6


@pytest.mark.slow
def test_a_missing_torque_makes_the_energy_balance_drift():
    right, wrong = (fitted(seed=0, hidden=h, few=True) for h in ("nothing", "step"))
    assert wrong.cases[0].energy_drift > 1.5 * right.cases[0].energy_drift
