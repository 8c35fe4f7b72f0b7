import numpy as np
import pytest

from gyrotrack.tracking._hub import smooth_path


def _error(path, truth):
    return float(np.sqrt(np.mean((path - truth) ** 2)))


def _slow(n):
    k = np.arange(n)
    return np.stack([300 + 0.6 * np.cos(k / 40), 200 + 0.6 * np.sin(k / 40)], axis=1)


def test_noise_that_hangs_together_is_smoothed_away():
    rng = np.random.default_rng(2)
    truth = _slow(1500)
    noise = np.stack(
        [np.convolve(rng.normal(0, 1, 1510), np.ones(6), "valid")[:1500] for _ in (0, 1)], axis=1
    )
    noise *= 0.1 / noise.std()
    path = smooth_path(truth + noise)
    assert _error(path.centre, truth) < 0.06  # a third less than what was measured, 0.1
    assert path.sigma[0] == pytest.approx(_error(path.centre, truth), rel=0.6)


def test_a_fast_regular_wobble_is_kept():
    rng = np.random.default_rng(3)
    k = np.arange(1500)
    truth = _slow(1500) + 0.8 * np.stack([np.cos(0.55 * k), np.sin(0.55 * k)], axis=1)
    path = smooth_path(truth + rng.normal(0, 0.08, truth.shape))
    assert _error(path.centre, truth) < 0.1


def test_gaps_are_bridged_and_long_ones_have_no_uncertainty():
    truth = _slow(1200)
    seen = truth.copy()
    seen[100:105] = np.nan
    seen[500:900] = np.nan
    path = smooth_path(seen)
    assert _error(path.centre[95:110], truth[95:110]) < 0.05
    assert np.isfinite(path.centre).all()
    assert np.isnan(path.sigma[700])


def test_a_clip_of_a_few_frames_takes_the_mean():
    path = smooth_path(np.array([[10.0, 20.0], [10.2, 20.0], [9.8, 20.0]]))
    np.testing.assert_allclose(path.centre, [[10, 20]] * 3)


def test_nothing_measured_is_nothing_known():
    path = smooth_path(np.full((20, 2), np.nan))
    assert np.isnan(path.sigma).all()
