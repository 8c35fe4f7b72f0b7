"""Smoothing in time where frames are spaced unevenly."""

import numpy as np
import pytest

from gyrotrack._smoothing import TimeBase, jitter_is_real, local_parabola


@pytest.fixture
def place():
    rng = np.random.default_rng(1)
    return np.delete(np.sort(np.arange(500) + rng.uniform(-0.4, 0.4, 500)), slice(200, 215))


def test_a_parabola_in_time_is_found_exactly(place):
    value, slope = local_parabola(place, 0.3 + 0.7 * place - 4e-4 * place**2)
    np.testing.assert_allclose(value, 0.3 + 0.7 * place - 4e-4 * place**2, atol=1e-6)
    np.testing.assert_allclose(slope, 0.7 - 8e-4 * place, atol=1e-6)


def test_departures_are_smoothed_in_time(place):
    rng = np.random.default_rng(2)
    time_base = TimeBase(place)
    time = place - place[0]
    truth = 0.5 * time + 1e-4 * time**2 + 3e-4 * np.sin(time / 40.0)
    coarse = truth + rng.normal(0.0, 4e-3, len(time))
    coarse[50:60] = np.nan
    path, even = time_base.path(coarse)
    assert np.isnan(path[50:60]).all()
    known = np.isfinite(path)
    assert np.abs(path - truth)[known].max() < 8e-3  # in frames the jitter alone would be 0.2
    off = truth + rng.normal(0.0, 1e-3, len(time)) - path
    bend = even - np.linspace(even[0], even[-1], len(even))
    smooth, leverage = time_base.smooth(off, known.astype(float), bend, 60, 3)
    assert np.std((path + smooth - truth)[known]) < 4e-4
    assert 0.0 < np.nanmedian(leverage) < 0.1


def test_a_speed_is_that_in_time(place):
    time_base = TimeBase(place)
    np.testing.assert_allclose(time_base.speed(0.25 * time_base.place), 0.25)


@pytest.mark.parametrize(("late", "real"), [(1.0, True), (0.0, False)])
def test_a_body_shows_whether_frames_were_late(late, real):
    rng = np.random.default_rng(3)
    even = np.arange(600.0)
    stamped = even + rng.uniform(-0.2, 0.2, 600)
    angle = 0.23 * (even + late * (stamped - even)) + rng.normal(0.0, 4e-3, 600)
    angle[rng.random(600) < 0.05] = np.nan
    angle[100] += 0.5
    assert jitter_is_real(stamped, even, angle) is real


def test_a_body_at_rest_tells_nothing():
    rng = np.random.default_rng(4)
    even = np.arange(300.0)
    assert jitter_is_real(even + rng.uniform(-0.2, 0.2, 300), even, rng.normal(0.0, 1e-3, 300))


@pytest.mark.parametrize(("jump", "followed"), [(0.25, True), (0.4, False)])
def test_a_coarse_angle_beside_the_smooth_path_is_kept(jump, followed):
    """The parabola about the frame itself is 0.93 of the jump away from it."""
    place = np.arange(60.0)
    coarse = 0.1 * place
    coarse[30] += jump
    path, _ = TimeBase(place).path(coarse)
    smooth, _ = local_parabola(place, coarse)
    assert (abs(smooth[30] - coarse[30]) < 0.3) == followed
    assert path[30] == pytest.approx(smooth[30] if followed else coarse[30], abs=1e-9)
