"""What the page foresees is what then happens."""

import numpy as np
import pytest

from fitting.discovery._score import CaseColumns
from fitting.discovery._select import rank
from fitting.inference._fit import fit
from gyrotrack import UsageError, open_study
from gyrotrack.apps.cli._app import run
from gyrotrack.apps.workbench._processes import Prediction


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    """The reduced model fitted to a case with a small quadratic drag on the casing."""
    path = tmp_path_factory.mktemp("case") / "case.h5"
    options = "--duration 30 --casing-fps 60 --rotor-fps 250 --window 3 --window 20 --sigma 5e-4 --seed 1"
    words = f"--add casing.air.quadratic --set casing.air.quadratic.k=1e-10 {options} --json -q"
    assert run(["simulate", "-o", str(path), *words.split()]) == 0
    data = open_study([path], None)
    return fit(
        data.model(("rotor.air.quadratic", "touchpoint.constant", "casing.air.linear", "bearing.power")),
        data.data,
    )


@pytest.fixture
def prediction(base):
    return Prediction(base)


@pytest.mark.slow
def test_slopes_are_the_derivatives_of_the_exact_residual(base, prediction):
    document = prediction.sliders()
    for k, p in enumerate(document["parameters"]):
        step = 0.02 * (p["high"] - p["low"])
        for sign in (1, -1):  # away from a bound
            if p["low"] <= p["value"] + sign * step <= p["high"]:
                break
        moved = prediction.moved({p["name"]: p["value"] + sign * step})["value"]
        for run_, (before, after) in enumerate(zip(document["value"], moved, strict=True)):
            change = np.array(after) - np.array(before)
            linear = sign * step * np.array(document["slope"][run_][k])
            assert np.allclose(change, linear, rtol=0.1, atol=0.05 * np.abs(linear).max() + 1e-9), p["name"]


def test_at_the_fitted_values_the_residual_is_that_of_the_fit(base, prediction):
    casing, rotor = base.speed_residuals(0)
    found = prediction.moved({})
    # the equations of motion are solved anew, to a small part of the noise
    assert np.allclose(found["value"][0], casing.value, rtol=0, atol=0.02 * casing.sigma.min())
    assert np.allclose(found["value"][2], rotor[1].value, rtol=0, atol=0.02 * rotor[1].sigma.min())
    # the one measure of misfit is that of the history of fits
    assert found["misfit"] == pytest.approx(base.misfit, rel=1e-3)
    assert prediction.misfit == pytest.approx(base.misfit, rel=1e-9)
    name = base.problem.layout.names[0]
    with pytest.raises(UsageError, match="outside its bounds"):
        prediction.moved({name: -1.0})
    with pytest.raises(UsageError, match="no parameter"):
        prediction.moved({"evil": 1.0})


@pytest.mark.slow
def test_a_candidate_is_foreseen_to_first_order_and_after_its_refit(base, prediction):
    columns = CaseColumns(base, 0)
    found = {c.effect.name: c for c in rank(base, refitting=False)}
    candidate = found["casing.air.quadratic"]
    assert candidate.fit is None
    foreseen = prediction.with_candidate(candidate, columns)
    model = base.model.with_effect(candidate.effect)
    start = {k: e.value for k, e in base.estimates.items()}
    start |= {k: e.value for k, e in candidate.estimates.items()}
    truth = fit(model, base.problem.data, start=start, noise=base.noise).speed_residuals(0)[0].value
    before = base.speed_residuals(0)[0].value
    # the law removes nearly all of the residual, and so does its prediction
    assert np.sqrt(np.mean(truth**2)) < 0.3 * np.sqrt(np.mean(before**2))
    assert np.sqrt(np.mean((np.array(foreseen["value"][0]) - truth) ** 2)) < 0.3 * np.sqrt(np.mean(before**2))
    # nearly all of the excess over the noise limit, in mean square
    assert foreseen["misfit"] ** 2 - 1.0 < 0.3 * (prediction.misfit**2 - 1.0)
    assert foreseen["torque"] is None
