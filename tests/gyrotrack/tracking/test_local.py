import numpy as np
import pytest

from gyrotrack._column_store import BLOCK_ROWS
from gyrotrack._smoothing import local_fit, spread


def test_a_parabola_is_reproduced_also_across_gaps():
    k = np.arange(300.0)
    value = 3 + 0.2 * k - 0.001 * k**2
    weight = np.ones(300)
    weight[100:112] = 0
    value_seen = np.where(weight > 0, value, np.nan)
    smooth, _ = local_fit(value_seen, weight, 20)
    np.testing.assert_allclose(smooth, value, atol=1e-5)


def test_the_leverage_is_the_share_of_the_own_point():
    weight = np.ones(101)
    bump = np.zeros(101)
    bump[50] = 1.0
    smooth, leverage = local_fit(bump, weight, 15)
    assert leverage[50] == pytest.approx(smooth[50], abs=1e-9)


def test_a_hole_leaves_the_point_itself_out():
    bump = np.zeros(101)
    bump[50] = 1.0
    assert local_fit(bump, np.ones(101), 15, hole=3)[0][50] == pytest.approx(0.0, abs=1e-9)


def test_too_few_points_give_nothing():
    weight = np.zeros(50)
    weight[:2] = 1
    assert np.isnan(local_fit(np.zeros(50), weight, 5)[0]).all()


def test_spread_is_the_core_of_a_sample():
    rng = np.random.default_rng(0)
    sample = rng.normal(0, 2.0, 20000)
    sample[:500] = 1e3
    assert spread(sample) == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize(("half", "degree"), [(20, 2), (60, 3)])
def test_no_stretch_shows_in_a_long_series(half, degree):
    rng = np.random.default_rng(1)
    n = 2 * BLOCK_ROWS + 30
    value, weight = rng.normal(0.0, 1.0, n).cumsum(), rng.uniform(0.5, 2.0, n)
    weight[rng.random(n) < 0.2] = 0.0
    smooth, _ = local_fit(value, weight, half, degree)
    for i in (
        0,
        7,
        half,
        BLOCK_ROWS - half,
        BLOCK_ROWS - 1,
        BLOCK_ROWS,
        BLOCK_ROWS + half,
        2 * BLOCK_ROWS,
        n - 9,
        n - 1,
    ):
        window = np.arange(max(i - half, 0), min(i + half + 1, n))
        x = (window - i) / (half + 1)
        root = np.sqrt((1.0 - x**2) * weight[window])  # polyfit squares its weights
        assert smooth[i] == pytest.approx(np.polyfit(x, value[window], degree, w=root)[-1], abs=1e-4)
