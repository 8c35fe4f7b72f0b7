"""The residual angle is what the measured angles differ by from the integral of the modelled speed."""

from types import SimpleNamespace

import numpy as np
import pytest
from cases import fitted
from scipy.integrate import cumulative_simpson

from fitting import EstimationError
from fitting.inference._angle_residuals import angle_residuals
from fitting.inference._result import outcome
from fitting.inference._speed_residuals import CASING, ROTOR


def integrated(found, run, body):
    """Return measured minus modelled angle of the samples of a run, without its mean by weights."""
    omega, _ = found.modelled_speed(0, body, run.time)
    rest = run.value - cumulative_simpson(omega, x=run.time, initial=0.0)
    return rest - np.average(rest, weights=run.sigma**-2)


@pytest.mark.parametrize("window", [None, 0])
def test_they_are_those_of_the_integrated_speed(window):
    found = fitted()
    record = found.problem.data[0].record
    run, body, index = (record.casing, CASING, 0) if window is None else (record.rotor[0], ROTOR, 1)
    value, sigma = found.angle_residuals(0)[index].at(run.time)
    direct = integrated(found, run, body)
    value = value - np.average(value, weights=run.sigma**-2)
    # what differs is the noise of the single angles
    assert np.std(direct - value) == pytest.approx(np.median(run.sigma), rel=0.1)
    assert abs(np.corrcoef(direct - value, value)[0, 1]) < 0.15
    assert (sigma > 0).all()
    assert np.sqrt(np.mean((value / sigma) ** 2)) < 3


def test_a_wrong_parameter_pulls_the_model_away():
    """With another drag of the casing the residual is many standard deviations, with the sign of the measured angle."""
    known = fitted()
    layout = known.problem.layout
    theta = known.theta + np.where(np.array(layout.names) == "casing.air.linear.b2", 1.0, 0.0) * 0.05
    found = outcome(known.problem, theta, known.noise, converged=True)
    residual = found.angle_residuals(0)[0]
    run = found.problem.data[0].record.casing
    value, _ = residual.at(run.time)
    assert np.abs(residual.value / residual.sigma).max() > 20
    assert np.corrcoef(integrated(found, run, CASING), value)[0, 1] > 0.99


def test_outside_of_the_run_there_is_none():
    residual = fitted().angle_residuals(0)[1]
    value, sigma = residual.at(np.array([residual.time[0] - 0.1, residual.time[-1] + 0.1]))
    assert np.isnan(value).all()
    assert np.isnan(sigma).all()


def test_speeds_have_no_angle():
    data = SimpleNamespace(is_angle=False, record=SimpleNamespace(label="a"))
    with pytest.raises(EstimationError, match="a was fitted by its speeds"):
        angle_residuals(SimpleNamespace(problem=SimpleNamespace(data=[data]), noise=[None]), 0)
