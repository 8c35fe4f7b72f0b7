"""The kind of a motion, and its end: a body that comes to rest, turns on, or swings."""

import numpy as np

from gyrotrack.apps._motion import end_of_motion, motion_of

SIGMA = 1e-3


def noisy(angle):
    return angle + np.random.default_rng(5).normal(0, SIGMA, len(angle)), np.full(len(angle), SIGMA)


def test_rest_after_dry_friction_is_found():
    t = np.arange(0, 10, 0.005)
    stop = 4.0
    angle = 12.0 * np.minimum(t, stop) - 1.5 * np.minimum(t, stop) ** 2
    for sign in (1, -1):
        assert abs(t[end_of_motion(t, *noisy(sign * angle))] - stop) < 0.4


def test_a_body_that_turns_on_is_kept():
    t = np.arange(0, 10, 0.005)
    assert end_of_motion(t, *noisy(12.0 * t - 0.5 * t**2)) == len(t)


def test_an_oscillation_is_kept():
    t = np.arange(0, 10, 0.005)
    assert end_of_motion(t, *noisy(0.4 * np.exp(-0.5 * t) * np.sin(8 * t))) == len(t)


def test_a_common_uncertainty_of_all_angles_hides_no_oscillation():
    """The ball of a pendulum in 10 s of film: noise of SIGMA, and 11 mrad for the distance of the hub."""
    t = np.arange(305) / 29.75
    angle, _ = noisy(0.168 * np.exp(-0.03 * t) * np.cos(2.39 * t))
    assert end_of_motion(t, angle, np.full(len(t), 0.011)) == len(t)


def test_beats_are_neither_a_steady_rotation_nor_one_oscillation():
    """Two coupled pendulums exchange their energy: the sum of two normal modes."""
    t = np.arange(0, 100, 0.02)
    angle, sigma = noisy(0.05 * np.exp(-t / 300) * (np.cos(3.90 * t) + np.cos(4.05 * t)))
    motion = motion_of(t, angle, sigma)
    assert motion.kind == "oscillation"
    assert motion.period is None


def test_a_steady_rotation_is_one_also_with_noise_and_a_displaced_hub():
    t = np.arange(0, 20, 0.02)
    for rate in (3e-3, 3.49):
        angle, sigma = noisy(rate * t + 0.01 * np.sin(rate * t))
        motion = motion_of(t, angle, sigma)
        assert motion.kind == "steady"
        assert abs(motion.omega_mean.value - rate) < 4 * motion.omega_mean.stderr
