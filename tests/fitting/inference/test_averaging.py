"""Averaged equations of an oscillation against the exact motion."""

import numpy as np
import oscillators
import pytest

from fitting import LIBRARY, Model
from fitting.inference._case_data import CaseData
from fitting.inference._initial_values import equation_error, initial_values
from fitting.inference._parameters import ParameterLayout
from fitting.inference._problem import Problem


def data_of(acceleration, start, duration, seed):
    t, angle, _ = oscillators.motion(acceleration, start, duration, 40.0)
    return [CaseData.of(oscillators.record(t, angle, 1e-3, seed))]


@pytest.mark.slow
def test_dry_viscous_and_quadratic_friction_of_a_spring_are_separated():
    """Forty periods: without averaging, an error of the spring of 1 % is a slip by a fifth of a period."""
    strengths = {
        "casing.spring.linear.k": 12.0,
        "touchpoint.constant.b1": 0.03,
        "casing.air.linear.b2": 0.02,
        "casing.air.quadratic.k": 0.01,
    }
    k, b1, b2, q = strengths.values()
    data = data_of(lambda t, a, w: -k * a - b1 * np.sign(w) - b2 * w - q * w * abs(w), (1.5, 0.0), 72.0, 1)
    model = Model(tuple(LIBRARY[name.rpartition(".")[0]] for name in strengths))
    problem = Problem.of(ParameterLayout.of(model, [d.record for d in data]), data)
    found = dict(zip(problem.layout.names, initial_values(problem, None), strict=True))
    for name, value in strengths.items():
        assert found[name] == pytest.approx(value, rel=0.03), name
    assert found["casing.spring.linear.k"] == pytest.approx(k, rel=3e-4)
    (predicted,) = problem.predict(np.array(list(found.values())))
    off, offset = data[0].z - predicted.rows, data[0].nuisance
    off -= offset @ np.linalg.lstsq(offset, off)[0]
    assert np.sqrt(np.mean(off**2)) < 60  # in a wrong period it is some thousands


def test_gravity_and_spring_differ_by_the_phase():
    data = data_of(lambda t, a, w: -20 * np.sin(a) - 0.03 * w, (0.7, 0.0), 60.0, 2)
    drag = LIBRARY["casing.air.linear"]
    gravity, spring = (
        equation_error(Model((drag, LIBRARY[name])), data)
        for name in ("casing.gravity", "casing.spring.linear")
    )
    assert gravity < 0.02
    assert spring > 10 * gravity


def test_the_slow_motion_of_a_damped_oscillator_is_exact():
    """Without noise the errors are those of the method: reversals are known to a sample only, 0.03 of a period."""
    t, angle, _ = oscillators.motion(lambda t, a, w: -12 * a - 0.03 * w, (1.1, 0.0), 40.0, 40.0)
    slow = CaseData.of(oscillators.record(t, angle, 1e-6, 0)).oscillation.slow_motion
    decay, rate = 0.015, np.sqrt(12 - 0.015**2)
    off = slow.phase - rate * slow.time
    assert np.abs(off - np.median(off)).max() < 2e-4
    np.testing.assert_allclose(slow.amplitude, 1.1 * np.exp(-decay * slow.time), rtol=3e-4)
