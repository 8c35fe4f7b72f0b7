"""The kind of a motion, its end, the degrees of its polynomials, and what pulses say about harmonics of the angle."""

import numpy as np
import pytest
from scipy.special import ellipj, ellipk

from fitting.discovery import _verdict
from gyrotrack._correlated_noise import Estimate
from gyrotrack.apps import _motion
from gyrotrack.apps._motion import Value, end_of_motion, motion_of, motion_of_speeds, start_of_motion

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


@pytest.mark.slow
def test_beats_are_neither_a_steady_rotation_nor_one_oscillation():
    """Two coupled pendulums exchange their energy: the sum of two normal modes."""
    t = np.arange(0, 100, 0.02)
    angle, sigma = noisy(0.05 * np.exp(-t / 300) * (np.cos(3.90 * t) + np.cos(4.05 * t)))
    motion = motion_of(t, angle, sigma)
    assert motion.kind == "oscillation"
    assert motion.period is None


@pytest.mark.slow
def test_a_steady_rotation_is_one_also_with_noise_and_a_displaced_hub():
    t = np.arange(0, 20, 0.2)
    for rate in (3e-3, 3.49):
        angle, sigma = noisy(rate * t + 0.01 * np.sin(rate * t))
        motion = motion_of(t, angle, sigma)
        assert motion.kind == "steady"
        assert abs(motion.omega_mean.value - rate) < 4 * motion.omega_mean.stderr


def _spin_down(seed, *, speeds):
    """Return true values, and the motion of one of many exponential and dry spin-downs, with white noise."""
    rng = np.random.default_rng([17, seed])
    duration, n, start = rng.uniform(5, 60), int(rng.integers(200, 800)), rng.uniform(5, 60)
    t = np.linspace(0, duration, n)
    tau, dry = rng.uniform(0.5, 3) * duration, rng.uniform(0, 0.3) * start / duration
    a = start + dry * tau
    omega, angle = a * np.exp(-t / tau) - dry * tau, a * tau * (1 - np.exp(-t / tau)) - dry * tau * t
    true = (omega[0], omega[-1], (angle[-1] - angle[0]) / duration, -a / tau * np.exp(-0.5 * duration / tau))
    if not speeds:
        sigma = 10 ** rng.uniform(-3.5, -2)
        return true, motion_of(t, angle + sigma * rng.standard_normal(n), np.full(n, sigma))
    sigma = 10 ** rng.uniform(-3, -1)
    return true, motion_of_speeds(t, omega + sigma * rng.standard_normal(n), np.full(n, sigma), angle)


@pytest.mark.parametrize("speeds", [False, True])
@pytest.mark.slow
def test_uncertainties_of_ends_mean_and_acceleration_are_those_of_the_errors(speeds):
    pulls = []
    for seed in range(12):
        true, found = _spin_down(seed, speeds=speeds)
        values = (found.omega["first"], found.omega["last"], found.omega_mean.value, found.alpha.value)
        errors = (
            found.omega_u["first"],
            found.omega_u["last"],
            found.omega_mean.stderr,
            found.alpha.stderr,
        )
        pulls.append([(v - x) / u for v, x, u in zip(values, true, errors, strict=True)])
    rms = np.sqrt(np.mean(np.square(pulls), axis=0))
    # the noise may be correlated, and further terms of the polynomial may be needed; here they are not
    assert ((rms > 0.35) & (rms < 1.6)).all(), rms


def test_models_are_averaged_by_their_criterion():
    """Two models 2 ln 3 apart have the weights 3/4 and 1/4; their difference is part of the uncertainty."""
    fits = [
        Estimate(np.array([v]), np.array([[u**2]]), -10 * c, c)
        for v, u, c in ((1.0, 0.1, 0.0), (2.0, 0.2, 2 * np.log(3)))
    ]
    found = _motion._averaged(fits, [np.ones(1)] * 2)
    assert found.value == pytest.approx(1.25)
    assert found.stderr**2 == pytest.approx(0.75 * (0.01 + 0.0625) + 0.25 * (0.04 + 0.5625))


@pytest.mark.slow
def test_an_oscillation_states_no_uncertainty_of_its_end_speeds():
    t = np.linspace(0, 20, 2000)
    found = motion_of(t, 0.3 * np.cos(2 * np.pi * t / 1.7), np.full(len(t), 1e-3))
    assert found.kind == "oscillation"
    assert np.isnan(list(found.omega_u.values())).all()


def test_a_body_that_speeds_up_spins_up():
    t = np.arange(0, 10, 0.1)
    for sign in (1, -1):
        motion = motion_of(t, *noisy(sign * (5.0 * t + 0.3 * t**2)))
        assert motion.kind == "spin-up"
        assert motion_of(t, *noisy(sign * (11.0 * t - 0.3 * t**2))).kind == "spin-down"


def test_over_three_turns_correlated_noise_does_not_fluctuate():
    """There harmonics of the angle with a changing amplitude resemble the motion."""
    t = np.arange(300) / 60
    noise = np.random.default_rng(0).standard_normal(330)
    smoothed = np.convolve(noise, np.exp(-np.arange(31) / 8), "valid")
    angle = 4 * t - 0.1 * t**2 + 3e-3 * smoothed / smoothed.std()
    assert motion_of(t, angle, np.full(300, 1e-3)).kind == "spin-down"


@pytest.mark.parametrize(("wave", "kind"), [(0.03, "spin-down"), (0.3, "fluctuating")])
def test_a_speed_that_rises_repeatedly_fluctuates(wave, kind):
    """A motor whose speed of 12 to 8 rad/s waves five times, by 1.5 % and by 15 % to each side."""
    t = np.arange(0, 10, 0.01)
    angle = 12 * t - 0.2 * t**2 + 0.5 * wave * 10 / np.pi * np.sin(np.pi * t + 0.3)
    motion = motion_of(t, *noisy(angle))
    assert motion.kind == kind
    if kind == "fluctuating":
        speed = 12 - 0.4 * t + 5 * wave * np.cos(np.pi * t + 0.3)
        assert abs(motion.omega["first"] - speed[:50].mean()) < 3 * motion.omega_u["first"]
        assert abs(motion.omega["last"] - speed[-50:].mean()) < 3 * motion.omega_u["last"]
        assert motion.omega_mean.value == pytest.approx((angle[-1] - angle[0]) / t[-1], abs=1e-3)


@pytest.mark.parametrize(("once", "twice"), [(0.05, 0.02), (0.0, 0.1)])
def test_an_unbalance_or_a_tilted_view_does_not_fluctuate(once, twice):
    """Within each turn the speed rises and falls by up to 20 %, as a harmonic of the angle."""
    t = np.arange(0, 10, 0.005)
    angle = 12 * t - 0.3 * t**2
    angle = angle + once * np.sin(angle) + twice * np.sin(2 * angle + 1)
    assert motion_of(t, *noisy(angle)).kind == "spin-down"


def push(stop=5.4, end=1.4):
    """At rest to 1 s, pushed to `end`, free to `stop`, then stopped; at 60 Hz."""
    t = np.arange(390) / 60
    pushed = np.clip(t - 1.0, 0, end - 1.0)
    free = np.clip(t - end, 0, stop - end)
    fast = 30.0 * (end - 1.0)
    angle = 15.0 * pushed**2 + fast / 0.24 * (1 - np.exp(-0.24 * free))
    return t, angle + np.random.default_rng(2).normal(0, 1e-4, len(t)), np.full(len(t), 1e-4)


@pytest.mark.parametrize("end", [1.4, 1.43, 1.47])
def test_a_push_and_a_stop_are_found_to_the_frame(end):
    t, angle, sigma = push(end=end)
    assert t[start_of_motion(t, angle, sigma)] == pytest.approx(end, abs=1.6 / 60)
    assert t[end_of_motion(t, angle, sigma) - 1] == pytest.approx(5.4, abs=1.6 / 60)


def test_a_motor_that_is_faster_again_later_is_not_pushed_by_hand():
    """Without the second rise, the first one is a drive by hand."""
    t = np.arange(0, 10, 0.01)
    for again, driven in ((0.0, True), (1.0, False)):
        speed = 10 - 6 * np.exp(-3 * t) - 0.3 * t + again * 3.0 * np.exp(-((t - 7) ** 2))
        angle, sigma = noisy(np.cumsum(speed) * 0.01)
        assert (start_of_motion(t, angle, sigma) > 0) == driven


@pytest.mark.parametrize(("off", "found"), [(5.0, 30), (12.0, 28)])
def test_the_sample_that_leaves_the_motion_is_found_beside_many_that_do_not(off, found):
    """From all samples before it, a sample is predicted better than from the first ones alone."""
    time = np.arange(30) / 60
    angle = 12.0 * time - 0.9 * time**2 + np.random.default_rng(4).normal(0, 1e-4, 30)
    angle[28:] += off * 1e-4
    assert _motion._joins(time, angle, 21) == found


@pytest.mark.slow
def test_ends_contain_what_the_highest_degree_leaves():
    """A wheel with quadratic drag over six turns: its speed needs more degrees than harmonics of the angle leave."""
    t = np.linspace(0, 10, 400)
    first, k = 6.0, (1 / 0.4 - 1) / 10
    z = []
    for seed in range(4):
        noise = 3e-4 * np.random.default_rng(seed).standard_normal(len(t))
        found = motion_of(t, first / k * np.log1p(k * t) + noise, np.full(len(t), 3e-4))
        z.append((found.omega["first"] - first) / found.omega_u["first"])
    # without it 4.9
    assert 0.3 < np.sqrt(np.mean(np.square(z))) < 2.0


@pytest.mark.parametrize(
    ("criteria", "last", "expected"),
    [
        ((9.0, 8.0), (0.4, 0.2), 0.1),
        ((9.0, 8.0), (0.4, -0.2), 0.1),
        ((9.0, 8.0), (0.1, 0.2), 0.2),
        ((9.0, 8.0), (0.0, 0.2), 0.2),
        ((8.0, 9.0), (0.4, 0.2), 0.0),
    ],
)
def test_a_further_term_is_needed_if_the_highest_degree_is_the_best(criteria, last, expected):
    fits = [Estimate(np.array([7.0, *last]), np.eye(3), -c, c) for c in criteria]
    assert _motion._next_coefficient(fits) == pytest.approx(expected)
    assert _motion._next_coefficient(fits[-1:]) == 0.0


@pytest.mark.parametrize("start", [0.2, pytest.param(1.57, marks=pytest.mark.slow), 2.2])
def test_the_amplitude_of_a_pendulum_is_that_of_its_turning_points(start):
    """The first harmonic of a pendulum that is released at 90 degrees is 1.7 % larger than its deflection."""
    t = np.arange(0, 20, 1 / 30)
    k = np.sin(start / 2)
    sn = ellipj(3.13 * t + ellipk(k**2), k**2)[0]
    found = motion_of(t, *noisy(2 * np.arcsin(k * sn)))
    assert found.amplitude.value == pytest.approx(start, rel=0.003)


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


def test_a_period_that_drifts_has_the_difference_of_the_models_in_its_uncertainty():
    same = _motion._with_rivals(Value(10.0, 0.1), [Value(10.0, 0.1), Value(10.5, 0.3)])
    assert same.stderr == pytest.approx(0.1)
    other = _motion._with_rivals(Value(10.0, 0.1), [Value(10.0, 0.1), Value(12.0, 0.3)])
    assert other.stderr == pytest.approx(np.hypot(0.1, 1.4))
