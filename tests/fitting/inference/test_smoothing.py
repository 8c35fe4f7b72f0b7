import numpy as np
import pytest
from scipy.ndimage import median_filter

from fitting.inference._record import Samples, running_median, speeds


def run(n=2000, rate=260.0, noise=0.0, omega=40.0, fall=-2.0):
    t = np.arange(n) / rate
    rng = np.random.default_rng(0)
    angle = omega * t + 0.5 * fall * t**2 + noise * rng.standard_normal(n)
    return Samples(t, angle, np.full(n, 1e-3)), omega + fall * t


def test_noiseless_speed_is_the_derivative():
    samples, omega = run()
    t, found = speeds(samples, "angle")
    np.testing.assert_allclose(found, omega[50:-50], atol=1e-9)
    np.testing.assert_array_equal(t, samples.time[50:-50])


def test_smoothing_reduces_noise_as_in_the_paper():
    """Gradient of angles of 1e-3 rad at 260 Hz: 0.18 rad/s; the median over 51 points leaves a tenth."""
    samples, omega = run(n=20_000, noise=1e-3, fall=-0.2)
    _, found = speeds(samples, "angle")
    assert 0.01 < np.std(found - omega[50:-50]) < 0.03


def test_outliers_do_not_change_smoothed_speeds():
    samples, omega = run()
    value = samples.value.copy()
    value[500] += 3.0
    _, found = speeds(Samples(samples.time, value, samples.sigma), "angle")
    assert np.abs(found - omega[50:-50]).max() < 0.3


def test_measured_speeds_are_only_smoothed():
    samples, omega = run()
    spiked = omega.copy()
    spiked[700] += 100
    _, found = speeds(Samples(samples.time, spiked, samples.sigma), "omega")
    np.testing.assert_allclose(found, omega[50:-50], atol=0.01)


@pytest.mark.parametrize("n", [12, 60, 101, 300])
def test_short_runs_keep_most_of_their_points(n):
    samples, omega = run(n=n)
    t, found = speeds(samples, "angle")
    assert len(t) == len(found) == n - 2 * min(50, n // 10)
    np.testing.assert_allclose(found[2:-2], np.interp(t, samples.time, omega)[2:-2], atol=0.2)


@pytest.mark.parametrize(("n", "width"), [(5, 3), (60, 51), (3000, 51), (1025, 7)])
def test_running_median_agrees_with_scipy(n, width):
    value = np.random.default_rng(n).standard_normal(n)
    np.testing.assert_array_equal(running_median(value, width), median_filter(value, width, mode="nearest"))
