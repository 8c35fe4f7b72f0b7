"""The oracle of the tests against SciPy."""

import numpy as np
import pytest
import twobody
from scipy.integrate import solve_ivp


@pytest.mark.parametrize(
    "hidden",
    [
        twobody.Hidden(),
        twobody.Hidden(softening=2e-3, cooling=40.0),
        twobody.Hidden(casing=lambda t, a, b, p, q: -1e-6 * (b / 100) ** 2, factor=lambda t: 1 + 2e-4 * t),
    ],
    ids=["paper", "heating", "drag and drift"],
)
def test_motion_agrees_with_scipy(hidden):
    motion = twobody.simulate(span=60.0, hidden=hidden)
    times = np.linspace(0.013, 59.9, 777)
    exact = solve_ivp(
        lambda t, y: twobody.rates(twobody.PAPER, hidden, t, y),
        (0, 60),
        (900.0, 5.0, 0.0, 0.0, 0.0),
        method="DOP853",
        rtol=1e-12,
        atol=1e-12,
        t_eval=times,
    ).y
    for body in (0, 1):
        angle, speed = motion.at(times, body)
        np.testing.assert_allclose(angle, exact[2 + body], rtol=1e-9, atol=1e-6)
        np.testing.assert_allclose(speed, exact[body], rtol=1e-9)


def test_a_jump_acts_from_its_moment_on():
    calm, pushed = (twobody.simulate(span=20.0, hidden=twobody.Hidden(jump=(10.02, k))) for k in (0.0, -2e-6))
    times = np.array([9.9, 10.02, 10.04, 10.06])
    change = pushed.at(times, 1)[1] - calm.at(times, 1)[1]
    assert change[0] == 0
    expected = -2e-6 / twobody.I_CASING * (times[2:] - 10.02)
    np.testing.assert_allclose(change[2:], expected, rtol=2e-3)


def test_random_torque_has_its_rms_and_correlation_time():
    series = twobody.ornstein_uhlenbeck(np.random.default_rng(1), 400_000, 0.02, 3e-7, 1.0)
    assert np.std(series) == pytest.approx(3e-7, rel=0.05)
    lag = np.mean(series[:-50] * series[50:]) / np.mean(series**2)
    assert lag == pytest.approx(np.exp(-1.0), abs=0.05)


def test_a_random_torque_acts_on_both_bodies():
    calm, shaken = twobody.simulate(span=20.0), twobody.simulate(span=20.0, ou=1e-6, seed=3)
    difference = shaken.speed - calm.speed
    # a torque of 1e-6 N m over seconds: tenths of rad/s on the casing, less on the heavier rotor
    assert 0.01 < np.abs(difference[:, 1]).max() < 3
    assert 0.003 < np.abs(difference[:, 0]).max() < 1
