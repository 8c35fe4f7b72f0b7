"""Rough speeds against SciPy: the curve through the rotor's windows, and into how many pieces a window is divided."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq

from fitting import make_record
from fitting.inference import _record
from fitting.inference._record import PiecewiseCubics, Samples, hermite


def test_cubics_agree_with_scipy():
    t, v, s = np.array([0.0, 1.5, 2.0, 7.0]), np.array([3.0, 1.0, 2.0, -4.0]), np.array([0.5, -2.0, 1.0, 0.0])
    times = np.linspace(0, 7, 113)
    np.testing.assert_allclose(hermite(t, v, s, times), CubicHermiteSpline(t, v, s)(times), atol=1e-13)


@pytest.mark.parametrize(
    ("share", "samples", "pieces"),
    [(0.6, 1201, 60), (0.6, 361, 30), (0.52, 1201, 52), (0.48, 1201, 1), (0.6, 720, 60), (0.6, 719, 59)],
)
def test_a_window_of_more_than_half_of_the_run_is_divided_like_the_run(share, samples, pieces):
    """A run of 10 s with a hundred points; each piece has at least twelve samples."""
    time = np.linspace(1.0, 1.0 + 10.0 * share, samples)
    window = Samples(time, time, np.ones(samples))
    assert _record._pieces(window, SimpleNamespace(span=(0.0, 10.0)), 100, 12) == pieces


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_the_rotor_continues_at_its_slopes_and_does_not_reverse(sense):
    """Beyond the windows by their slopes, not below a twentieth of its slowest speed."""
    windows = np.array([[20.0, sense * 80.0, sense * -1.0], [10.0, sense * 100.0, sense * -2.0]])
    curve = sense * _record._rotor_curve(windows, np.array([5.0, 10.0, 20.0, 25.0, 500.0]))
    assert curve == pytest.approx([110.0, 100.0, 80.0, 75.0, 4.0])
    single = sense * _record._rotor_curve(windows[1:], np.array([0.0, 10.0, 57.0, 58.0]))
    assert single == pytest.approx([120.0, 100.0, 6.0, 5.0])


def test_an_unknown_slope_is_that_between_the_windows():
    windows = np.array([[10.0, 100.0, np.nan], [20.0, 80.0, np.nan]])
    assert _record._rotor_curve(windows, np.array([5.0, 15.0, 25.0])) == pytest.approx([110.0, 90.0, 70.0])


@pytest.mark.parametrize("is_angle", [True, False])
def test_pieces_have_speed_and_acceleration_at_their_middle(is_angle):
    """A body of 50 rad/s that slows down by 4 rad/s2."""
    time = np.linspace(1.0, 5.0, 41)
    value = 7.0 + 50.0 * time - 2.0 * time**2 if is_angle else 50.0 - 4.0 * time
    found = _record._local(Samples(time, value, np.ones(41)), 3, is_angle)
    middle = np.array([time[p].mean() for p in np.array_split(np.arange(41), 3)])
    assert found == pytest.approx(np.stack([middle, 50.0 - 4.0 * middle, np.full(3, -4.0)], axis=1))


@pytest.mark.parametrize(("gain", "pieces"), [(3.2, 1), (4.8, 2)])
def test_a_further_piece_must_explain_more_than_its_four_coefficients(gain, pieces):
    """A curve with a step: in two pieces the sum of squares decreases by the factor N^(-gain / N)."""
    n = 30
    cubics, noise = PiecewiseCubics(np.linspace(-1.0, 1.0, n)), np.random.default_rng(1).normal(size=n)

    def squares(values, count):
        return np.sum((values - cubics.smooth(values, count)) ** 2)

    step = np.repeat([-1.0, 1.0], n // 2)

    def excess(size):
        values = noise + size * step
        return n * np.log(squares(values, 1) / squares(values, 2)) - gain * np.log(n)

    assert cubics.needed(noise + brentq(excess, 1e-3, 50.0) * step) == pieces


def test_the_largest_speed_of_a_body_at_rest_is_that_of_the_fastest():
    time = np.linspace(0.0, 10.0, 400)
    runs = [(time, speed * time, np.full(400, 1e-3)) for speed in (0.0, 50.0)]
    record = make_record(casing=runs[0], rotor=[runs[1]], I_rotor=1.0, I_casing=1.0)
    assert record.largest_speeds == {"omega_r": pytest.approx(50.0), "omega_c": pytest.approx(50.0)}
