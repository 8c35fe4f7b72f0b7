import numpy as np

from gyrotrack.tracking._fusion import KNOTS, closed_curve, curve_at, without_common_motion


def test_a_repeating_error_is_learnt():
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 2 * np.pi, 3000)
    error = 8e-3 * np.exp(-(np.angle(np.exp(1j * (angle - 2.0))) ** 2) / 0.08)
    curve = closed_curve(angle, error + rng.normal(0, 1e-3, 3000), np.full(3000, 1e6)).values
    assert np.std(curve_at(curve, angle) - error) < 4e-4


def test_without_data_the_curve_is_zero():
    curve = closed_curve(np.zeros(10), np.full(10, np.nan), np.zeros(10)).values
    assert np.abs(curve).max() == 0


def test_noise_alone_is_hardly_taken_up():
    rng = np.random.default_rng(1)
    angle, noise = rng.uniform(0, 2 * np.pi, 3000), rng.normal(0, 1e-3, 3000)
    curve = closed_curve(angle, noise, np.full(3000, 1e6)).values
    assert np.std(curve) < 2.5e-4


def test_what_all_markers_do_once_a_turn_is_motion_and_stays():
    knots = np.arange(KNOTS) * 2 * np.pi / KNOTS
    mounts = {"a": 0.0, "b": 2.0, "c": 4.3}
    motion = {m: 5e-3 * np.cos(knots - mount) for m, mount in mounts.items()}
    own = {"a": 3e-3 * np.cos(5 * knots), "b": np.zeros(KNOTS), "c": 2e-3 * np.sin(7 * knots)}
    cleaned = without_common_motion({m: motion[m] + own[m] for m in mounts}, mounts)
    for name in mounts:
        np.testing.assert_allclose(cleaned[name], own[name], atol=3e-4)
