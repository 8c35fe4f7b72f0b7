"""Dissipated energies: sum, sign and uncertainty."""

from dataclasses import replace

import numpy as np
import pytest

from fitting import REDUCED, Model, make_record
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit as fit_model
from gyrotrack.apps.report._tables import CONSERVATIVE, UNPHYSICAL, plausibility_rows

ADDED = "casing.air.quadratic"


def _number(text):
    """Return value and uncertainty of (a ± b) × 10ⁿ or a ± b."""
    raised = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
    text = text.replace("\u2212", "-").replace("(", "").replace(")", "")
    body, _, power = text.partition(" × 10")
    value, _, sigma = body.partition(" ± ")
    factor = 10.0 ** int((power or "⁰").translate(raised).split()[0])
    return float(value) * factor, float(sigma or "nan") * factor


@pytest.fixture(scope="module")
def fit(record_of):
    """The fit of the true model."""
    return fit_model(Model.of([*REDUCED, ADDED]), [CaseData.of(record_of(1))])


@pytest.mark.slow
def test_all_dissipation_is_the_loss_of_kinetic_energy(fit):
    path, record = fit.predictions[0].path, fit.problem.data[0].record
    inertia = np.array([record.I_rotor, record.I_casing])
    kinetic = [0.5 * float(np.sum(inertia * y[:2] ** 2)) for y in (path.y[0, 0], path.y[-1, -1])]
    total = sum(_number(row.energy)[0] for row in plausibility_rows(fit))
    assert total == pytest.approx(kinetic[0] - kinetic[1], rel=1e-2)


@pytest.mark.slow
def test_the_uncertainty_is_that_of_the_amplitude(fit):
    (row,) = [r for r in plausibility_rows(fit) if r.key == ADDED]
    energy, sigma = _number(row.energy)
    k = fit.estimates[f"{ADDED}.k"]
    assert sigma / energy == pytest.approx(k.stderr / k.value, rel=0.3)
    assert row.judgement == "dissipates"


def test_a_negative_friction_is_called_unphysical(fit):
    theta = fit.theta.copy()
    at = fit.problem.layout.names.index(f"{ADDED}.k")
    theta[at] = -theta[at]
    (row,) = [r for r in plausibility_rows(replace(fit, theta=theta)) if r.key == ADDED]
    assert row.is_unphysical
    assert row.judgement == UNPHYSICAL == "negative dissipation: unphysical"
    assert row.energy.startswith(("−", "(−"))
    # within its uncertainty it is not
    covariance = fit.covariance.copy()
    covariance[at, at] = (10 * theta[at]) ** 2
    (row,) = [
        r for r in plausibility_rows(replace(fit, theta=theta, covariance=covariance)) if r.key == ADDED
    ]
    assert row.judgement == "not distinguished from zero"


@pytest.mark.parametrize("quarter", [0.0, pytest.param(0.25, marks=pytest.mark.slow)])
def test_a_spring_stores_energy_and_dissipates_none(quarter):
    """Damping takes all energy, whether the record ends at the equilibrium or at the largest deflection."""
    t = np.arange(0, 20.5 + quarter, 0.02)
    angle = 0.6 * np.exp(-0.02 * t) * np.cos(2 * np.pi * t)
    noise = np.random.default_rng(1).normal(0, 1e-3, len(t))
    record = make_record(
        casing=(t, angle + noise, np.full(len(t), 1e-3)), rotor=[], I_rotor=1, I_casing=1, single=True
    )
    found = fit_model(Model.of(["casing.spring.linear", "casing.air.linear"]), [record])
    spring, drag = plausibility_rows(found)
    assert (spring.judgement, spring.share, spring.is_unphysical) == (CONSERVATIVE, "–", False)
    assert (drag.judgement, drag.share) == ("dissipates", "100.0 %")
