"""Degrees of the polynomials of a rotation, and what pulses say about harmonics of the angle."""

import numpy as np
import pytest

from fitting.discovery import _verdict
from gyrotrack.apps import _motion
from gyrotrack.apps._motion import motion_of, motion_of_speeds


@pytest.mark.parametrize(("turns", "degree"), [(0.5, 5.0), (5.0, 5.0), (5.5, 5.5), (40.0, 40.0)])
def test_few_turns_have_few_degrees(turns, degree):
    assert _motion._free_degrees(turns) == degree


@pytest.mark.parametrize(("most", "order"), [(0.0, 2), (1.9, 2), (6.0, 6), (6.9, 6), (7.0, 7), (99.0, 16)])
def test_the_highest_degree_is_within_its_limits(most, order):
    assert _motion._highest(range(2, 17), most) == order


def test_derivatives_of_legendre_polynomials():
    assert _motion._derivatives(3, 1, 1.0) == pytest.approx([0.0, 1.0, 3.0, 6.0])
    assert _motion._derivatives(3, 1, -1.0) == pytest.approx([0.0, 1.0, -3.0, 6.0])
    assert _motion._derivatives(4, 2, 0.0) == pytest.approx([0.0, 0.0, 3.0, 0.0, -7.5])


@pytest.mark.parametrize(("turns", "highest"), [(3.0, 6), (8.5, 9), (60.0, 16)])
def test_a_rotation_has_polynomials_of_these_degrees(turns, highest, monkeypatch):
    fitted, seen = _motion.correlated_least_squares, []
    monkeypatch.setattr(
        _motion,
        "correlated_least_squares",
        lambda *given: seen.append(given[4]) or fitted(*given),
    )
    t = np.linspace(0.0, 10.0, 100)
    angle = 2 * np.pi * turns * (t / 10.0 - 0.01 * t**2 / 10.0) / 0.9
    motion_of(t, angle + np.random.default_rng(0).normal(0, 1e-3, len(t)), np.full(len(t), 1e-3))
    assert [len(m) - 6 - 1 for m in max(seen, key=len)] == list(range(2, highest + 1))
    seen.clear()
    speed = np.gradient(angle, t)
    motion_of_speeds(t, speed, np.full(len(t), 1e-3), angle)
    assert [len(m) - 1 for m in seen[-1]] == list(range(1, highest))


@pytest.mark.parametrize("per_turn", [1, 2, 3])
def test_pulses_at_whole_periods_of_a_harmonic_give_the_mean_speed(per_turn):
    """The speed is 53 / (1 + t / 16 s) rad/s, of quadratic drag; times of the pulses have a jitter of 1 us."""
    rng = np.random.default_rng(per_turn)
    angle = 2 * np.pi / per_turn * np.arange(127 * per_turn)
    exact = 16.0 * np.expm1(angle / (53.0 * 16.0))
    speed = 53.0 / (1 + exact / 16.0)
    found = motion_of(exact + rng.normal(0.0, 1e-6, len(angle)), angle, 1e-6 * speed)
    mean = (angle[-1] - angle[0]) / (exact[-1] - exact[0])
    assert found.omega_mean.value == pytest.approx(mean, abs=1e-5)
    assert found.omega_mean.stderr < 1e-5


@pytest.mark.parametrize(("unit", "factor"), [("rad", 1e3), ("s", 1e3), ("s2", 1e6)])
def test_amplitudes_of_the_camera_are_printed_in_milli_units(unit, factor):
    assert _verdict._PER_MILLI[unit] == factor
