"""Profile likelihood, against the parabola of a linear problem and against separate fits."""

import numpy as np
import pytest
import twobody
from cases import data, fitted
from scipy.optimize import least_squares

from fitting import GENERAL, REDUCED, EffectError, EstimationError, Model, fit
from fitting.inference._problem import degenerate_directions
from fitting.inference._profile import profile, weakly_determined

TRUTH = twobody.truth()


@pytest.mark.parametrize(
    "name", ["initial.omega_c@case1", pytest.param("touchpoint.constant.b1", marks=pytest.mark.slow)]
)
def test_the_profile_of_a_linear_problem_gives_the_standard_error(name):
    result = fitted(seed=0, ou=1e-7, few=True)
    e, interval = result.estimates[name], profile(result, name)
    assert (e.value - interval.lower) / e.stderr == pytest.approx(1.96, abs=0.03)
    assert (interval.upper - e.value) / e.stderr == pytest.approx(1.96, abs=0.03)
    assert not interval.lower_open
    assert not interval.upper_open


@pytest.mark.slow
def test_at_the_ends_of_the_interval_the_deviance_has_the_stated_rise():
    """f is skewed by its power. With f held at either end, SciPy's least squares over all else ends 3.84 higher."""
    result = fitted(seed=0, ou=1e-7, few=True)
    interval = profile(result, "bearing.power.f")
    problem = result.problem
    place = problem.layout.index["bearing.power.f"]
    others = np.arange(len(result.theta)) != place
    for end in (interval.lower, interval.upper):
        unit = np.abs(result.theta)

        def residuals(x, end=end, unit=unit):
            theta = np.full(len(result.theta), end)
            theta[others] = x * unit[others]
            r, j = problem.residuals(problem.predict(theta))
            return r, (j * unit)[:, others]

        # from where the straight valley leads, f being held
        step = -result.covariance[:, place] / result.covariance[place, place] * (result.theta[place] - end)
        begin = (result.theta + step)[others] / unit[others]
        solved = least_squares(
            lambda x: residuals(x)[0], begin, lambda x: residuals(x)[1], method="lm", xtol=1e-14, ftol=1e-12
        )
        assert 2 * solved.cost - result.chi2 == pytest.approx(3.84, abs=0.15)
    e = result.estimates["bearing.power.f"]
    assert interval.upper - e.value > 1.1 * (e.value - interval.lower)


def test_an_absent_friction_has_an_upper_limit():
    result = fit(Model.of((*REDUCED, "casing.air.quadratic")), [data(seed=0, few=True)])
    name = "casing.air.quadratic.k"
    assert name in weakly_determined(result)
    interval = profile(result, name)
    assert interval.lower_open
    assert interval.lower == 0
    assert not interval.upper_open
    # the torque that could hide at 160 rad/s is a part in a thousand of the drag there
    assert 0 < interval.upper * 160**2 < 1e-3 * 8.28e-7 * 160


def test_only_free_parameters_have_a_profile():
    with pytest.raises(EffectError, match="not a free parameter"):
        profile(fitted(seed=0), "bearing.heating.C")


def test_well_determined_parameters_need_no_profile():
    assert weakly_determined(fitted(seed=0)) == []


@pytest.mark.slow
def test_intervals_of_the_general_model_contain_the_truth():
    result = fit(Model.of(GENERAL), [data(seed=0)])
    for name in weakly_determined(result):
        interval = profile(result, name)
        assert interval.lower <= TRUTH.get(name, 0.0) <= interval.upper


def test_degenerate_parameters_are_named():
    """Two columns that are nearly one: their sum is known to 1 %, their difference is not."""
    j = np.array([[100.0, 100.0, 0.0], [0.3, -0.3, 0.0], [0.0, 0.0, 50.0]])
    theta = np.array([1.0, 1.0, 2.0])
    (direction,) = degenerate_directions(["d", "f", "b"], theta, np.linalg.inv(j.T @ j))
    assert set(direction) == {"d", "f"}
    assert direction["d"] == pytest.approx(-direction["f"], rel=1e-6)
    assert degenerate_directions(["d", "f", "b"], theta, 1e-6 * np.eye(3)) == []
    # one that is known badly by itself is no combination
    assert degenerate_directions(["d", "f", "b"], theta, np.diag([9.0, 1e-6, 1e-6])) == []


@pytest.mark.parametrize(("variance", "degenerate"), [(0.95, False), (1.05, True)])
def test_a_direction_is_degenerate_beyond_one_relative_standard_error(variance, degenerate):
    """Its relative changes are 1, -0.6, 0.21 and 0.19, of which the last is too small."""
    change, theta = np.array([1.0, -0.6, 0.21, 0.19]), np.array([2.0, -5.0, 1e-6, 3.0])
    relative = variance * np.outer(change, change) / (change @ change) + 1e-6 * np.eye(4)
    found = degenerate_directions("abcd", theta, relative * np.outer(theta, theta))
    assert len(found) == degenerate
    if degenerate:
        assert found[0] == pytest.approx({"a": 1.0, "b": -0.6, "c": 0.21}, rel=1e-3)


def test_another_level_gives_another_width():
    result = fitted(seed=0, ou=1e-7, few=True)
    name = "touchpoint.constant.b1"
    e, interval = result.estimates[name], result.conf_interval(name, level=0.6827)[name]
    assert (interval.upper - interval.lower) / (2 * e.stderr) == pytest.approx(1.0, abs=0.03)
    with pytest.raises(EstimationError, match="level"):
        result.conf_interval(name, level=95)


def test_estimates_contain_bounds_and_held_parameters():
    result = fit(Model.of(REDUCED).with_fixed({"bearing.power.g": 1.32}), [data(seed=0, ou=1e-7, few=True)])
    held, drag = result.estimates["bearing.power.g"], result.estimates["casing.air.linear.b2"]
    assert not held.vary
    assert drag.vary
    assert (drag.min, drag.max) == (0.0, np.inf)
