"""Formulas and thresholds of the motion of one body: waves, light gates, windows, stops and drives."""

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import DatasetError
from gyrotrack._correlated_noise import Estimate
from gyrotrack.apps import _drive, _motion
from gyrotrack.apps._motion import (
    BodyMotion,
    Value,
    end_of_motion,
    fluctuates,
    motion_of,
    motion_of_passages,
    motion_of_speeds,
    start_of_motion,
)
from gyrotrack.apps._points import with_differences
from gyrotrack.io.readers._pulses import Passages

SIGMA = 1e-3


def noisy(angle, seed=1, sigma=SIGMA):
    return angle + np.random.default_rng(seed).normal(0, sigma, len(angle)), np.full(len(angle), sigma)


@pytest.mark.parametrize(
    ("decay", "given"), [(Value(0.1, 0.09), True), (Value(0.1, 0.1), False), (Value(-0.1, 0.01), False)]
)
def test_quality_factor_needs_a_decay(decay, given):
    value = Value(1.0, 0.0)
    found = BodyMotion("oscillation", 1.0, {}, value, value, Value(2.0, 0.02), None, decay).quality_factor
    assert (found is not None) == given
    if given:
        assert found.value == pytest.approx(math.pi / 0.2)
        assert found.stderr == pytest.approx(found.value * math.hypot(0.9, 0.01))
    assert BodyMotion("oscillation", 1.0, {}, value, value, None, None, decay).quality_factor is None


@pytest.mark.parametrize(
    ("first", "last", "u", "alpha", "kind"),
    [
        (10.0, 8.0, 0.1, Value(-1, 0.1), "spin-down"),
        (-10.0, -8.0, 0.1, Value(1, 0.1), "spin-down"),
        (-8.0, -10.0, 0.1, Value(-1, 0.1), "spin-up"),
        (8.0, 10.0, 0.1, Value(1, 0.1), "spin-up"),
        (10.0, 9.91, 0.0, Value(-1, 0.1), "steady"),
        (10.0, 9.89, 0.0, Value(-1, 0.1), "spin-down"),
        (10.0, 9.0, 0.22, Value(-0.29, 0.1), "spin-down"),
        (10.0, 9.0, 0.25, Value(-0.29, 0.1), "steady"),
        (10.0, 9.0, 0.25, Value(-0.31, 0.1), "spin-down"),
    ],
)
def test_kind_of_a_rotation(first, last, u, alpha, kind):
    ends, ends_u = {"first": first, "last": last}, {"first": u, "last": u}
    assert _motion._kind(ends, ends_u, Value(10.0 * np.sign(first), 0.1), alpha) == kind


def gates(count, period=1.2, decay=0.05, offset=0.03, noise=0.0):
    k = np.arange(count)
    time = 3.0 + k * period / 2 + offset * (-1.0) ** k
    time += np.random.default_rng(0).normal(0, noise, count) if noise else 0.0
    return time, 0.02 * np.exp(decay * time)


def test_period_and_decay_of_a_pendulum_in_light_gates():
    time, duration = gates(60)
    found = motion_of_passages(Passages(Path("a"), time, duration, ()))
    assert found.kind == "oscillation"
    assert found.period.value == pytest.approx(1.2, rel=1e-6)
    assert found.decay.value == pytest.approx(0.05, rel=1e-6)
    assert math.isnan(found.turns)
    keep = ~np.isin(np.arange(60), [7, 20, 21, 40])  # missing passages
    found = motion_of_passages(Passages(Path("a"), time[keep], duration[keep], ()))
    assert found.period.value == pytest.approx(1.2, rel=1e-3)
    assert found.decay.value == pytest.approx(0.05, rel=1e-2)


def test_uncertainties_of_a_pendulum_in_light_gates():
    time, duration = gates(400, noise=1e-3)
    duration *= np.exp(np.random.default_rng(1).normal(0, 0.02, 400))
    found = motion_of_passages(Passages(Path("a"), time, duration, ()))
    pairs = 200
    spread = 2 * pairs / math.sqrt(12)  # standard deviation of the numbers of the passages
    u = 2 * 1e-3 / math.sqrt(2) / math.sqrt(pairs) / spread
    assert 0.8 * u < found.period.stderr < 1.4 * u
    assert abs(found.period.value - 1.2) < 4 * u
    u = 0.02 / math.sqrt(2) / math.sqrt(pairs) / (spread * 0.6)
    assert 0.8 * u < found.decay.stderr < 1.4 * u
    assert abs(found.decay.value - 0.05) < 4 * u


def test_twelve_pairs_of_passages_are_needed():
    time, duration = gates(24)
    assert motion_of_passages(Passages(Path("a"), time, duration, ())).period.value == pytest.approx(1.2)
    with pytest.raises(DatasetError, match="11 pairs"):
        motion_of_passages(Passages(Path("a"), time[:23], duration[:23], ()))


@pytest.mark.parametrize("orders", [(1, 1), (3, 2), (2, 4)])
def test_slopes_of_a_wave_are_its_derivatives(orders):
    wave = _motion._Wave(4.0, *orders)
    t = np.linspace(-4, 4, 9)
    c = np.array([0.3, 0.05, 1.0, -0.5, 0.2, 0.1, *np.linspace(0.1, 0.4, wave.size - 6)])
    phase = 2 * np.pi * 0.3 * t + sum(c[4 + k] * (t / 4) ** k for k in range(2, orders[0] + 1))
    first = 6 + orders[0] - 1
    decay = 0.05 * t + sum(c[first + k - 2] * (t / 4) ** k for k in range(2, orders[1] + 1))
    expected = np.exp(-decay) * (np.cos(phase) - 0.5 * np.sin(phase)) + 0.2 + 0.1 * t
    np.testing.assert_allclose(wave(c, t), expected)
    slopes = [(wave(c + e, t) - wave(c - e, t)) / 2e-6 for e in 1e-6 * np.eye(wave.size)]
    np.testing.assert_allclose(wave.jacobian(c, t), np.stack(slopes, axis=1), atol=1e-7)
    for other in ((1, 1), (5, 3), (2, 2)):
        larger = _motion._Wave(4.0, *other)
        moved = larger.extended(c, wave)
        assert len(moved) == larger.size
        same = [min(a, b) for a, b in zip(orders, other, strict=True)]
        np.testing.assert_allclose(moved[:6], c[:6])
        np.testing.assert_allclose(moved[6 : 5 + same[0]], c[6 : 5 + same[0]])
        np.testing.assert_allclose(moved[5 + other[0] :][: same[1] - 1], c[5 + orders[0] :][: same[1] - 1])
        assert np.count_nonzero(moved[6:]) == sum(same) - 2
    large = np.array([0.3, -100.0, 1.0, 0, 0, 0, *np.zeros(wave.size - 6)])
    assert np.abs(wave(large, t)).max() <= math.exp(50)


@pytest.mark.parametrize("periods", [6, 30])
def test_uncertainties_of_an_oscillation_are_those_of_its_noise(periods):
    """In white noise, close to the Cramer-Rao bound; the record has few or many windows of whole periods."""
    wave = _motion._Wave(10.0, 1, 1)
    t = np.linspace(-10, 10, 900)
    c = np.array([periods / 20, 0.02, 0.6, 0.3, 0.1, 0.0])
    rest, sigma = noisy(np.zeros(900), 3, 0.02)
    criterion, errors = wave.errors(c, t, rest, 5 * sigma)  # only relative uncertainties are used
    jacobian = wave.jacobian(c, t) / 0.02
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    along = np.array([0, 0, 0.6, 0.3, 0, 0]) / math.hypot(0.6, 0.3)
    bounds = [math.sqrt(covariance[0, 0]), math.sqrt(covariance[1, 1]), math.sqrt(along @ covariance @ along)]
    assert np.isfinite(criterion)
    for error, bound in zip(errors, bounds, strict=True):
        assert 0.9 * bound < error < 1.9 * bound


def test_rival_models_widen_an_uncertainty():
    value = Value(1.0, 0.3)
    assert _motion._with_rivals(value, [value, Value(1.7, 0.2), Value(0.5, 0.3)]).stderr == pytest.approx(
        math.hypot(0.3, 0.3)
    )
    assert _motion._with_rivals(value, [value, Value(0.2, 0.2)]).stderr == pytest.approx(math.hypot(0.3, 0.4))
    assert _motion._with_rivals(value, [value, Value(1.7, 0.4)]) == value


def test_frequency_is_that_of_the_largest_peak():
    t = np.linspace(-5, 5, 300)
    assert _motion._frequency(t, np.sin(2 * np.pi * 0.83 * t) + 0.5 * t) == pytest.approx(0.83, rel=0.03)
    uneven = 5 * np.sign(t) * np.abs(t / 5) ** 1.2
    assert _motion._frequency(uneven, np.sin(2 * np.pi * 1.3 * uneven)) == pytest.approx(1.3, rel=0.03)
    assert _motion._frequency(t, np.exp(t / 4)) >= 0.07
    c = _motion._sinusoid(
        0.83, t, 2 * np.cos(2 * np.pi * 0.83 * t) - 3 * np.sin(2 * np.pi * 0.83 * t) + 4 - t
    )
    np.testing.assert_allclose(c, [0.83, 0, 2, -3, 4, -1], atol=1e-9)


def test_a_curve_reverses_without_net_rotation():
    t = np.linspace(-1, 1, 101)
    there = np.where(t < 0, t, -t)
    assert _motion._reverses(t, there, 1.6)
    assert not _motion._reverses(t, there, 1.7)  # fewer than 1.2 periods
    for back, reverses in ((0.2, False), (0.3, True)):  # net rotation divided by the path: 0.67 and 0.54
        assert _motion._reverses(t, np.where(t < 0, t, -back * t), 1.0) == reverses
        assert _motion._reverses(t, -np.where(t < 0, t, -back * t), 1.0) == reverses


def test_windows_of_speed():
    t = 0.02 * np.arange(500)
    edges, speed, error = _motion.window_speeds(t, *noisy(5 * t))
    assert edges.tolist() == list(range(0, 500, 10))
    np.testing.assert_allclose(speed, 5.0, atol=6 * error)
    assert error == pytest.approx(1e-3 * math.sqrt(1.2) / 0.2, rel=0.15)
    assert (
        _motion.window_speeds(t, 5 * t, np.full(500, 1e-3))[2] < 1e-6
    )  # an error common to all angles cancels
    edges, _, error = _motion.window_speeds(t[:45], *noisy(5 * t[:45], 2))
    assert edges.tolist() == list(range(0, 45, 5))
    assert _motion.window_speeds(t[:39], *noisy(t[:39])) is None
    assert len(_motion.window_speeds(t[:40], *noisy(t[:40]))[0]) == 8


@pytest.mark.parametrize(
    ("speed", "error", "back"),
    [([5, -0.9], 0.1, False), ([5, -1.1], 0.1, True), ([-5, 1.1], 0.1, True), ([-5, 0.9], 0.1, False),
     ([5, -1.1], 0.23, False), ([5, 1], 0.1, False), ([-5, -1], 0.1, False)],
)  # fmt: skip
def test_a_body_turns_back_by_a_fifth_and_five_errors(speed, error, back):
    assert _motion._turns_back(np.array(speed, float), error) is back


def test_local_speed_and_mean_speed():
    t = 0.01 * np.arange(400)
    angle, _ = noisy(3 * t)
    for place in (0, -1):
        found = _motion._slope_at(t, angle, place)
        count = 20
        near = slice(0, count) if place == 0 else slice(-count, None)
        slope, offset = np.polyfit(t[near], angle[near], 1)
        variance = np.sum((angle[near] - slope * t[near] - offset) ** 2) / (count - 2)
        assert found.value == pytest.approx(slope)
        spread = np.sum((t[near] - t[near].mean()) ** 2)
        assert found.stderr == pytest.approx(math.sqrt(4 * variance / spread))
    short = _motion._slope_at(t[:40], angle[:40], 0)  # at least 12 samples
    assert short.value == pytest.approx(np.polyfit(t[:12], angle[:12], 1)[0])
    found = _motion._mean_speed(t, angle, np.linspace(0.03, 0.04, 400))
    assert found.value == pytest.approx((angle[-1] - angle[0]) / 3.99)
    assert found.stderr == pytest.approx(math.hypot(0.03, 0.04, math.sqrt(2) * 0.02) / 3.99)


def test_ten_samples_are_needed():
    t = np.arange(10.0)
    assert motion_of(t, *noisy(0.5 * t)).kind == "steady"
    with pytest.raises(DatasetError, match="9 samples"):
        motion_of(t[:9], *noisy(0.5 * t[:9]))


def test_local_speed_of_a_curved_motion():
    t = np.linspace(-5, 5, 2000)
    angle, sigma = noisy(20 * t + 3 * np.exp(-(t + 5) / 0.15), 4)
    first = _motion._speed_at(t, angle, sigma, 0)
    assert first.value == pytest.approx(0.0, abs=max(4 * first.stderr, 0.3))
    last = _motion._speed_at(t, angle, sigma, -1)
    assert last.value == pytest.approx(20.0, abs=4 * last.stderr)
    assert last.stderr < 0.02


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("rise", "start"),
    [(0.04, 0), (0.08, 300)],  # of the largest speed
)
def test_a_drive_raises_the_speed_by_five_percent(rise, start, sign):
    t = 0.01 * np.arange(1500)
    speed = np.where(t < 3, 20 * (1 - rise) + 20 * rise * t / 3, 20 - 1.0 * (t - 3))
    angle = np.concatenate([[0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * 0.01)])
    found = start_of_motion(t, *noisy(sign * angle, 6, 1e-5))
    assert abs(found - start) <= (60 if start else 0)


def test_a_drive_in_the_second_half_is_not_a_push():
    t = 0.01 * np.arange(1500)
    for top, driven in ((6.0, True), (9.0, False)):
        speed = np.where(t < top, 10 + t, 10 + top - 1.5 * (t - top))
        angle = np.cumsum(speed) * 0.01
        assert bool(start_of_motion(t, *noisy(angle, 7, 1e-5))) == driven
    for slope, driven in ((0.3, True), (0.01, False)):  # a constant speed after the rise is that of a motor
        speed = np.where(t < 3, 10 + t, 13 - slope * (t - 3))
        assert bool(start_of_motion(t, *noisy(np.cumsum(speed) * 0.01, 8, 1e-5))) == driven
    assert start_of_motion(t[:39], *noisy(t[:39])) == 0


@pytest.mark.parametrize(("rest", "found"), [(0.02, False), (0.06, True)])
def test_rest_of_a_twentieth_of_the_record_is_excluded(rest, found):
    t = np.linspace(0, 1, 2000)
    stop = 1 - rest
    moving = np.minimum(t, stop)
    angle, sigma = noisy(200 * (moving - moving**2 / (2 * stop)), 9, 1e-4)
    end = end_of_motion(t, angle, sigma)
    assert (end < 2000) == found
    if found:
        assert abs(t[end - 1] - stop) < 0.04


def test_a_slow_motion_of_three_percent_is_not_rest():
    t = np.linspace(0, 10, 2000)
    for slow, rest in ((0.01, True), (0.03, False)):
        speed = np.maximum(20 - 5 * t, 20 * slow)
        assert (end_of_motion(t, *noisy(np.cumsum(speed) * t[1], 2, 1e-5)) < 2000) == rest
    assert end_of_motion(t[:39], *noisy(t[:39])) == 39


def test_a_stopped_body_is_free_until_the_stop():
    t = np.linspace(0, 10, 2000)
    speed = np.where(t < 6.13, 20 - 1.0 * t, 0.0)
    end = end_of_motion(t, *noisy(np.cumsum(speed) * t[1], 3, 1e-5))
    assert abs(t[end - 1] - 6.13) < 0.02


@pytest.mark.parametrize(("height", "count"), [(0.04, False), (0.07, True)])
def test_two_rises_of_five_percent_fluctuate(height, count):
    t = np.linspace(0, 20, 1500)
    speed = 10 * (1 - height + height * np.abs(((t / 10 + 0.5) % 1) * 2 - 1))
    angle = np.cumsum(speed) * t[1]
    assert fluctuates(t, *noisy(angle, 5, 1e-5)) == count
    scaled = angle * (2 * np.pi * 1.9 / np.ptp(angle))
    assert not fluctuates(t, *noisy(scaled, 5, 1e-5))  # fewer than two turns


def test_speeds_of_a_rotation_and_their_uncertainties():
    t = np.linspace(0, 10, 400)
    omega, sigma = noisy(12 - 0.5 * t, 3, 0.05)
    found = motion_of_speeds(t, omega, sigma, np.cumsum(omega) * t[1])
    assert found.kind == "spin-down"
    u = 0.05 / math.sqrt(400)
    for value, truth, least in (
        (found.omega_mean, 9.5, u), (found.alpha, -0.5, u / (10 / math.sqrt(12))),
        (Value(found.omega["first"], found.omega_u["first"]), 12.0, 2 * u),
        (Value(found.omega["last"], found.omega_u["last"]), 7.0, 2 * u),
    ):  # fmt: skip
        assert value.value == pytest.approx(truth, abs=4 * value.stderr)
        assert 0.8 * least < value.stderr < 2.5 * least
    assert found.turns == pytest.approx(95 / (2 * np.pi), rel=0.02)


def test_a_term_beyond_the_highest_degree_widens_each_value(monkeypatch):
    """The rotation of two turns has degrees up to 6, in the angle; the speeds up to 5."""
    t = np.linspace(-3, 3, 40)
    angle, sigma = noisy(2 * t + 0.1 * t**2)
    monkeypatch.setattr(_motion, "_next_coefficient", lambda fits: 0.0)
    plain, speeds = _motion._rotation(t, angle, sigma), motion_of_speeds(t, angle, sigma, angle)
    monkeypatch.setattr(_motion, "_next_coefficient", lambda fits: 0.01)
    wide, wider = _motion._rotation(t, angle, sigma), motion_of_speeds(t, angle, sigma, angle)
    last = np.polynomial.Legendre.basis(7)
    for value, other, row in (
        (plain[2], wide[2], (last(1) - last(-1)) / 6), (plain[3], wide[3], last.deriv(2)(0) / 9),
    ):  # fmt: skip
        assert other.stderr == pytest.approx(math.hypot(value.stderr, 0.01 * row))
    last = np.polynomial.Legendre.basis(6)
    assert wider.alpha.stderr == pytest.approx(math.hypot(speeds.alpha.stderr, 0.01 * last.deriv()(0) / 3))
    assert wider.omega_mean.stderr == pytest.approx(speeds.omega_mean.stderr)
    for end, place in (("first", -1), ("last", 1)):
        u = math.hypot(speeds.omega_u[end], 0.01 * last(place))
        assert wider.omega_u[end] == pytest.approx(u)


def test_a_local_speed_replaces_a_different_polynomial(monkeypatch):
    t = np.linspace(-3, 3, 40)
    angle, sigma = noisy(2 * t)
    monkeypatch.setattr(_motion, "_speed_at", lambda t, angle, sigma, place: Value(2.0, 0.1))
    near = _motion._rotation(t, angle, sigma)
    assert near[0].value != 2.0
    assert near[0].value == pytest.approx(2.0, abs=0.01)
    for off, replaced in ((0.28, False), (0.32, True), (-0.32, True)):
        monkeypatch.setattr(_motion, "_speed_at", lambda *_, off=off: Value(2.0 + off, 0.1))
        found = _motion._rotation(t, angle, sigma)
        for k in (0, 1):
            expected = Value(2 + off, math.hypot(0.1, near[k].stderr)) if replaced else near[k]
            assert found[k].value == pytest.approx(expected.value)
            assert found[k].stderr == pytest.approx(expected.stderr)


@pytest.mark.parametrize(
    ("bend", "counts"), [(2.9, [100]), (3.1, [100, 50, 25, 12]), (-3.1, [100, 50, 25, 12])]
)
def test_the_end_of_a_record_is_shortened_while_a_quartic_is_better(monkeypatch, bend, counts):
    seen = []

    def fits(x, design, y, sigma, models, free):
        seen.append((len(x), y[0]))
        one = Estimate(np.array([0.0, 1.0, 0.0, 0.0]), np.eye(4), 0.0, 0.0)
        return [one, Estimate(np.array([0.0, 0, 0, 0, bend]), np.eye(5), 0.0, 0.0)]

    monkeypatch.setattr(_motion, "correlated_least_squares", fits)
    t = np.linspace(-5, 5, 2000)
    for place in (0, -1):
        seen.clear()
        found = _motion._speed_at(t, t**2, np.ones(2000), place)
        assert [count for count, _ in seen] == counts
        assert [first for _, first in seen] == [0.0] * len(counts)
        half = 0.5 * (counts[-1] - 1) * 10 / 1999
        assert found.value == pytest.approx(1 / half)
        rows = np.array([np.polynomial.Legendre.basis(k).deriv()(1.0 if place else -1.0) for k in range(4)])
        assert found.stderr == pytest.approx(np.linalg.norm(rows) / half)


def test_beats_about_any_mean_are_an_oscillation_without_period():
    t = np.linspace(0, 12, 120)
    for mean in (50.0,):
        found = motion_of(t, *noisy(mean + np.cos(3.9 * t) + np.cos(4.7 * t)))
        assert (found.kind, found.period) == ("oscillation", None)


# ---- driven bodies


@pytest.mark.parametrize(
    ("value", "drives"),
    [([0, 0, 0, 0.06, 0.06, 1], True), ([0, 0, 1, 0.04, 0.04, 0.04], False), ([1, 1, 1, 0, 0, 0], False),
     ([0, 0, 0, -1, -1, -1], True), ([0, 0, 0, 0], False), ([np.nan], False), ([0, np.nan, 0, 1, 1], True)],
)  # fmt: skip
def test_an_input_drives_in_the_later_half(value, drives):
    assert _drive._drives(np.array(value, float)) is drives


def series(angle, time, sigma=1e-3, omega=None):
    nothing = np.full(len(time), np.nan)
    return SimpleNamespace(
        time=time, angle=angle, sigma=np.full(len(time), sigma),
        omega=nothing if omega is None else omega, omega_sigma=np.full(len(time), 0.02),
    )  # fmt: skip


@pytest.mark.parametrize("sense", [1, -1])
def test_speeds_over_whole_turns(sense):
    time = 0.01 * np.arange(1000)
    angle = 2 * np.pi * 10.001 * time / time[-1]
    speed, error = _drive._speed_of_turns(series(sense * angle, time), "angle")
    np.testing.assert_allclose(speed, angle[-1] / time[-1])
    assert len(speed) == 10
    np.testing.assert_allclose(error, math.sqrt(2) * 1e-3 / (time[-1] / 10), rtol=0.02)
    speed, error = _drive._speed_of_turns(series(sense * angle, time), "omega")
    np.testing.assert_allclose(error, 0.02 / math.sqrt(100), rtol=0.02)
    assert _drive._speed_of_turns(series(angle * 0.79, time), "angle") is None
    assert _drive._speed_of_turns(series(angle * 0.85, time), "angle") is not None
    many = _drive._speed_of_turns(series(angle * 15, time), "angle")[0]
    assert len(many) == 75  # 150 turns in pairs


def test_delay_integral_and_correlations():
    value = np.array([1.0, 2.0, 4.0, 8.0, 16.0])
    np.testing.assert_allclose(_drive._delayed(value, 0.0), value)
    np.testing.assert_allclose(_drive._delayed(value, 2.0), [1, 1, 1, 2, 4])
    np.testing.assert_allclose(_drive._delayed(value, 1.25), [1, 1, 1.75, 3.5, 7])
    np.testing.assert_allclose(
        _drive._integrated(np.array([0.0, 1.0, 3.0]), np.array([1.0, 3.0, 5.0])), [0, 2, 10]
    )
    assert _drive._inflation(np.array([1.0, -2.0, 1.0])) == 1.0
    rest = np.array([1.0, 2.0, 2.0, -1.0, -3.0])
    rho = [np.dot(rest[k:], rest[: 5 - k]) / 19 for k in range(1, 5)]
    assert rho[0] > 0
    assert rho[1] < 0
    assert _drive._inflation(rest) == pytest.approx(1 + 2 * rho[0])
    assert _drive._inflation(np.zeros(4)) == 1.0
    assert _drive._inflation(np.array([2.0, 1.0])) == pytest.approx(1 + 2 * 2 / 5)


def test_end_of_rest_is_the_last_sample_before_the_change():
    omega = np.array([np.nan, 0, 0, 0, 0.1, 0.3, 5.0, 10.0, np.nan])
    record = SimpleNamespace(omega=omega, omega_sigma=np.full(9, 1e-3))
    assert _drive._end_of_rest(record) == 4  # 0.3 exceeds 2 % of the change
    record.omega_sigma = np.full(9, 0.05)
    assert _drive._end_of_rest(record) == 5  # six uncertainties of a difference are 0.42
    record.omega_sigma = np.full(9, 0.03)
    assert _drive._end_of_rest(record) == 4  # 0.25
    assert _drive._end_of_rest(SimpleNamespace(omega=-omega, omega_sigma=np.full(9, 1e-3))) == 4
    assert _drive._end_of_rest(SimpleNamespace(omega=np.ones(4), omega_sigma=np.ones(4))) == 0


@pytest.mark.parametrize("quantity", ["omega", "angle"])
@pytest.mark.parametrize("step", [True, False])
def test_response_to_a_drive(quantity, step):
    """Time constant 1.5 s, gain 4, offset 1, delay 0.2 s; without a step a constant drive from 2 to 10 rad/s."""
    time = 0.02 * np.arange(400)
    late = np.clip(time - 2.2, 0, None)
    exact = (2 + 8 * (1 - np.exp(-late / 1.5))) if step else 10 - 8 * np.exp(-time / 1.5)
    angle = np.concatenate([[0], np.cumsum(0.5 * (exact[1:] + exact[:-1]) * 0.02)])
    rng = np.random.default_rng(1)
    omega, noise = exact + rng.normal(0, 0.02, 400), rng.normal(0, 2e-3, 400)
    # an input of 0.25 gives the initial speed 2, and 2.25 gives 10
    cause = SimpleNamespace(name="u", unit="V", value=np.where(time < 2.0, 0.25, 2.25)) if step else None
    record = series(angle + noise, time, 2e-3, omega)
    found = _drive._response(record, quantity, cause)
    for value, truth in ((found.time_constant, 1.5), (found.final, 10.0)):
        assert value.value == pytest.approx(truth, abs=max(4 * value.stderr, 0.02))
        assert 0 < value.stderr < 0.08
    if step:
        assert found.gain.value == pytest.approx(4.0, abs=max(4 * found.gain.stderr, 0.01))
        assert found.delay.value == pytest.approx(0.2, abs=max(4 * found.delay.stderr, 0.02))
        assert (found.input, found.unit) == ("u", "V")
    else:
        assert (found.gain, found.delay, found.input, found.unit) == (None, None, "", "")
    assert found.explained > 0.99
    if quantity == "omega" and not step:
        columns = np.stack(
            [np.exp(-time / 1.5), 1 - np.exp(-time / 1.5), -8 * np.exp(-time / 1.5) * time / 1.5**2], axis=1
        )
        u = 0.02 * np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))
        assert 0.7 * u[2] < found.time_constant.stderr < 1.6 * u[2]
        assert 0.7 * u[1] < found.final.stderr < 1.6 * u[1]
    few = slice(0, 11)
    assert _drive._response(series(angle[few], time[few], 1e-3, omega[few]), quantity, cause) is None


def test_an_error_that_scales_all_angles_scales_amplitude_and_speeds():
    time = np.arange(400) / 20
    angle, sigma = noisy(0.3 * np.cos(2 * np.pi * time / 1.7))
    motion, larger = (motion_of(time, a, sigma) for a in (angle, 1.05 * angle))
    widened = with_differences(motion, [larger])
    assert widened.amplitude.value == motion.amplitude.value
    assert widened.amplitude.stderr == pytest.approx(0.05 * 0.3, rel=0.1)
    assert widened.period.stderr == pytest.approx(motion.period.stderr, rel=0.01)


@pytest.mark.parametrize(
    ("back", "slowest", "reverses"), [(1.1, -4.0, True), (0.9, -4.0, False), (1.1, -0.5, False)]
)
def test_a_slow_return_counts_if_it_is_more_than_a_turn(back, slowest, reverses):
    """A twentieth of the largest speed, 20 rad/s, is 1 rad/s; the return begins after five turns."""
    turns = np.concatenate([np.linspace(0.0, 5.0, 50), np.linspace(5.0, 5.0 - back, 20)])
    for sense in (1.0, -1.0):
        speed = sense * np.array([20.0, 10.0, slowest])
        assert _motion._turns_back_by_a_turn(sense * 2 * np.pi * turns, speed, 0.01) is reverses
