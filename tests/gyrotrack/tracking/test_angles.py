import numpy as np
import pytest

from gyrotrack._smoothing import angular_velocity, median_smooth


def test_median_is_the_middle_of_the_points_around():
    x = np.random.default_rng(0).normal(size=300)
    smooth = median_smooth(x, 51)
    assert smooth[100] == np.median(x[75:126])


def test_median_passes_over_what_is_missing():
    x = np.arange(100.0)
    x[40] = np.nan
    smooth = median_smooth(x, 5)
    assert np.isnan(smooth[40])
    assert smooth[41] == 41.0


@pytest.mark.parametrize("width", [0, 4, -3])
def test_even_width_is_refused(width):
    with pytest.raises(ValueError, match="odd"):
        median_smooth(np.arange(9.0), width)


def test_velocity_of_constant_acceleration_is_exact_and_ends_are_dropped():
    t = np.arange(400) / 260
    omega, sigma = angular_velocity(t, 3 + 20 * t + 4 * t**2, np.full_like(t, 1e-3))
    assert np.isnan(omega[:50]).all()
    assert np.isnan(omega[-50:]).all()
    np.testing.assert_allclose(omega[50:-50], (20 + 8 * t)[50:-50], rtol=1e-9)
    assert np.isfinite(sigma[50:-50]).all()


def test_too_short_a_piece_has_no_velocity():
    t = np.arange(100) / 260
    omega, _ = angular_velocity(t, t, t)
    assert np.isnan(omega).all()


@pytest.mark.parametrize(
    ("fps", "noise", "slope"), [(260, 1e-3, 0.0), (260, 1e-3, 10.0), (1000, 3e-3, -12.0)]
)
def test_claimed_uncertainty_is_the_real_one(fps, noise, slope):
    rng = np.random.default_rng(5)
    t = np.arange(1200) / fps
    z = []
    for _ in range(40):
        angle = 60 * t + slope * t**2 / 2 + rng.normal(size=t.size) * noise
        omega, sigma = angular_velocity(t, angle, np.full_like(t, noise))
        z.append(((omega - 60 - slope * t) / sigma)[50:-50:60])
    spread = np.std(z)
    assert 0.9 < spread < 1.2  # 760 values: sampling alone gives +- 0.03; the formula is good to 12 %
