import numpy as np
import pytest

from gyrotrack.tracking._hub import CentrePath, Radii, refine_centre


def _scene(seed=0, noise=0.15):
    """A disc that an encoder holds in place for a while; three markers at 0.5 rad a frame about the true centre."""
    rng = np.random.default_rng(seed)
    k = np.arange(900)
    truth = np.stack([300 + 0.3 * np.cos(k / 15), 200 + 0.3 * np.sin(k / 15)], axis=1)
    held = truth[k // 12 * 12]
    markers = []
    for mount in (0.0, 2.0, 4.2):
        theta = 0.5 * k + mount
        place = truth + 80 * np.stack([np.cos(theta), -np.sin(theta)], axis=1)
        away = place - held
        excess = np.hypot(*away.T) - 80 + rng.normal(0, noise, 900)
        markers.append(Radii(np.arctan2(-away[:, 1], away[:, 0]), excess))
    return truth, CentrePath(held, np.full(900, 0.05), 24), markers


def _error(path, truth):
    return float(np.sqrt(np.mean((path.centre - truth) ** 2)))


def test_radii_tell_where_the_centre_is_while_the_disc_is_held():
    truth, path, markers = _scene()
    better = refine_centre(path, markers)
    assert _error(better, truth) < 0.6 * _error(path, truth)
    assert better.sigma[400] < path.sigma[400]


def test_faults_in_some_radii_do_little_harm():
    truth, path, markers = _scene(1)
    for marker in markers:
        marker.excess[::17] += 5.0
    assert _error(refine_centre(path, markers), truth) < 0.8 * _error(path, truth)


def test_without_markers_the_centre_stays():
    _, path, markers = _scene()
    nothing = [Radii(m.direction, np.full(900, np.nan)) for m in markers]
    np.testing.assert_array_equal(refine_centre(path, nothing).centre, path.centre)


def test_a_right_centre_is_left_alone():
    truth, _, markers = _scene()
    right = CentrePath(truth, np.full(900, 0.05), 24)
    rng = np.random.default_rng(2)
    quiet = [Radii(m.direction, rng.normal(0, 0.15, 900)) for m in markers]
    assert _error(refine_centre(right, quiet), truth) < 0.05


def test_what_stands_still_moves_the_centre_along_its_own_direction_only():
    path = CentrePath(np.zeros((100, 2)), np.full(100, 0.05), 24)
    marker = Radii(np.zeros(100), np.full(100, 0.05) + 1e-3 * np.arange(100) % 0.01)
    moved = refine_centre(path, [marker]).centre
    assert moved[50, 0] == pytest.approx(0.05, abs=0.02)
    assert np.abs(moved[:, 1]).max() == 0
