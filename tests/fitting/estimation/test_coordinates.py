import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from fitting.estimation.coordinates import Valley, from_physical, to_physical

VALLEYS = (Valley(1, 3, 2, 400.0),)


@given(st.floats(1e-9, 1e-6), st.floats(1e-10, 1e-6), st.floats(0.3, 1.4))
def test_there_and_back(d, f, g):
    assume(abs(g - 1) > 0.01)
    theta = np.array([7.0, d, g, f, -3.0])
    back, _ = to_physical(from_physical(theta, VALLEYS), VALLEYS)
    np.testing.assert_allclose(back, theta, rtol=1e-6, atol=1e-13)


@given(st.floats(0.3, 1.4), st.floats(-1e-4, 1e-4), st.floats(1e-6, 2e-4), st.floats(10, 900))
def test_torque_is_the_one_of_the_formula(g, curvature, at_reference, speed):
    """T1 x + K (x^g - x)/(g - 1) with x = D / 400, and its limit T1 x + K x log x at g = 1."""
    u = np.array([0.0, at_reference, g, curvature, 0.0])
    theta, _ = to_physical(u, VALLEYS)
    torque = theta[1] * speed + theta[3] * speed ** theta[2]
    x = speed / 400.0
    bend = np.expm1((g - 1) * np.log(x)) / (g - 1) if g != 1 else np.log(x)
    # closer to 1 than 0.003 the exponent is held there
    assert torque == pytest.approx(
        at_reference * x + curvature * x * bend, rel=1e-6, abs=2.5e-2 * abs(curvature)
    )


@pytest.mark.parametrize("g", [0.3, 0.7, 0.99, 1.01, 1.2, 1.4])
def test_slopes_match_differences(g):
    u = np.array([2.0, 1e-4, g, 2e-5, 5.0])
    _, slope = to_physical(u, VALLEYS)
    for i in range(5):
        step = np.zeros(5)
        step[i] = 1e-6 * max(abs(u[i]), 1e-4)
        rise = (to_physical(u + step, VALLEYS)[0] - to_physical(u - step, VALLEYS)[0]) / (2 * step[i])
        np.testing.assert_allclose(slope[:, i], rise, rtol=1e-5, atol=1e-9 * np.abs(slope[:, i]).max())


ALONE = (Valley(None, 3, 2, 400.0),)


@given(st.floats(1e-10, 1e-6), st.floats(0.3, 1.4))
def test_a_power_law_alone_there_and_back(f, g):
    theta = np.array([7.0, 1.0, g, f, -3.0])
    u = from_physical(theta, ALONE)
    assert u[3] == pytest.approx(f * 400.0**g)
    back, slope = to_physical(u, ALONE)
    np.testing.assert_allclose(back, theta, rtol=1e-12)
    for i in (2, 3):
        step = np.zeros(5)
        step[i] = 1e-6 * u[i]
        rise = (to_physical(u + step, ALONE)[0] - to_physical(u - step, ALONE)[0]) / (2 * step[i])
        np.testing.assert_allclose(slope[:, i], rise, rtol=1e-5)


def test_without_a_valley_nothing_changes():
    theta = np.array([1.0, 2.0])
    np.testing.assert_array_equal(from_physical(theta, ()), theta)
    same, slope = to_physical(theta, ())
    np.testing.assert_array_equal(same, theta)
    np.testing.assert_array_equal(slope, np.eye(2))
