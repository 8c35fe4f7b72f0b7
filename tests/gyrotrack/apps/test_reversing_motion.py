"""A motion that turns back is neither a spin-up nor a spin-down, and not every one is a damped oscillation."""

import numpy as np
import pytest

from gyrotrack.apps._motion import motion_of

SIGMA = 2e-3


def _motion(time, angle, sigma=SIGMA):
    noise = np.random.default_rng(3).normal(0.0, sigma, len(time))
    return motion_of(time, angle + noise, np.full(len(time), sigma))


@pytest.mark.parametrize(("periods", "kind"), [(1.0, "reversing"), (1.5, "oscillation")])
def test_one_period_of_a_pendulum_is_a_reversing_motion(periods, kind):
    """1.2 periods are required for a period: through fewer, a motion with two stops may be any other."""
    time = np.linspace(0.0, 2.0 * periods, 60)
    found = _motion(time, 0.8 * np.cos(np.pi * time))
    assert found.kind == kind
    assert (found.period is not None) == (kind == "oscillation")


@pytest.mark.parametrize(("back", "kind"), [(0.1, "spin-down"), (0.6, "reversing")])
def test_a_body_that_turns_back_does_not_spin_down(back, kind):
    """A body turns back if its speed in the other sense exceeds a fifth of the largest one."""
    time = np.linspace(0.0, 4.0, 60)
    speed = np.linspace(5.0, -5.0 * back, 60)
    assert _motion(time, np.cumsum(speed) * (time[1] - time[0])).kind == kind


@pytest.mark.parametrize("count", [12, 38])
def test_a_reversal_is_seen_in_few_samples(count):
    """Few samples have few windows, but two windows show a reversal."""
    time = np.linspace(0.0, 2.6, count)
    noise = np.random.default_rng(0).normal(0.0, 3e-3, count)
    swing, slowing = 0.46 * np.sin(np.pi * time / 2.6), 0.3 * time - 0.05 * time**2
    kinds = [motion_of(time, angle + noise, np.full(count, 3e-3)).kind for angle in (swing, slowing)]
    assert kinds == ["reversing", "spin-down"]


@pytest.mark.parametrize(("speed", "reversing"), [(-1.5, True), (-0.5, False), (0.0, False)])
def test_a_body_that_turns_back_by_more_than_a_turn_is_not_steady(speed, reversing):
    """A motor at 13.8 rad/s, at rest, and slowly backwards; 0.5 rad/s is less than 5 % of the largest speed."""
    time = np.arange(4000) / 100
    speeds = np.select([time < 12, time < 24], [13.8, 0.0], speed)
    assert (_motion(time, np.cumsum(speeds) / 100).kind == "reversing") == reversing


@pytest.mark.parametrize(("share", "period"), [(0.15, True), (0.35, False)])
def test_a_motion_that_no_damped_oscillation_explains_has_no_period(share, period):
    """A second mode of 2 % of the variance may be harmonics of a large amplitude; one of 12 % is another body."""
    time = np.linspace(0.0, 6.0, 80)
    angle = np.cos(np.pi * time) + share * np.cos(2.7 * np.pi * time + 1.0)
    assert (_motion(time, angle).period is not None) == period


@pytest.mark.parametrize(("sigma", "kind"), [(0.1, "spin-up"), (0.3, "steady")])
def test_the_kind_does_not_contradict_the_speeds_at_the_ends(sigma, kind):
    """A speed that rises in the last part alone has no acceleration at the middle of the record."""
    time = np.linspace(0.0, 10.0, 120)
    late = np.clip(time - 7.0, 0.0, None)
    found = _motion(time, 3.0 * time + 2.0 / 27.0 * late**3, sigma)
    assert abs(found.alpha.value) < 2.0 * found.alpha.stderr
    assert found.kind == kind


def test_speeds_at_the_ends_contain_no_harmonics_of_the_angle():
    """An axis that is not quite corrected for its tilt causes two waves per turn, of the size of the prior."""
    time = np.linspace(0.0, 10.0, 120)
    found = _motion(time, 3.0 * time + 0.02 * np.sin(6.0 * time))
    for end in ("first", "last"):
        assert found.omega[end] == pytest.approx(3.0, abs=max(3.0 * found.omega_u[end], 0.005))
        assert found.omega_u[end] < 0.02


@pytest.mark.parametrize(
    ("periods", "second", "given"),
    [(3.8, 0.35, False), (4.3, 0.35, True), (4.3, 0.65, False), (3.8, 0.1, True)],
)
def test_a_disturbed_oscillation_of_several_periods_has_a_period(periods, second, given):
    """A second tone leaves 0.11, 0.3 and 0.01 of the variance; 0.04 are allowed, and 0.2 from four periods on."""
    t = np.arange(0, periods * 2.0, 0.08)
    angle = np.cos(np.pi * t) + second * np.cos(np.pi * t * 2.7 + 1.0)
    noisy = angle + np.random.default_rng(1).normal(0, 1e-3, len(t))
    assert (motion_of(t, noisy, np.full(len(t), 1e-3)).period is not None) == given
