"""Scatter, correlation, windows and smooth paths: hand-made series, on both sides of each limit."""

import math

import numpy as np
import pytest

from gyrotrack._smoothing import (
    TimeBase,
    angular_velocity,
    core_scatter,
    correlation_factor,
    excess,
    jitter_is_real,
    learning_window,
    line_through,
    local_fit,
    local_parabola,
    median_of,
    median_smooth,
    share_of_floor,
    smooth_path,
    smoothing_width,
    spread,
    tail_factor,
    whole_turns,
)

NAN = np.nan


def weighted_polynomial(x, y, weight, degree):
    """Return the coefficients, lowest power first, of a polynomial fitted with weights of the squares."""
    powers = x[:, None] ** np.arange(degree + 1)
    return np.linalg.lstsq(powers * np.sqrt(weight)[:, None], y * np.sqrt(weight), rcond=None)[0]


@pytest.mark.parametrize("degree", [2, 3])
def test_local_fit_is_a_weighted_polynomial(degree):
    rng = np.random.default_rng(degree)
    y, w, half = rng.normal(size=40), rng.uniform(0.5, 2, 40), 6
    smooth, leverage = local_fit(y, w, half, degree)
    for i in (0, 3, 20, 39):
        j = np.arange(max(i - half, 0), min(i + half, 39) + 1)
        weight = w[j] * (1 - ((j - i) / (half + 1)) ** 2)
        assert smooth[i] == pytest.approx(
            weighted_polynomial((j - i) / half, y[j], weight, degree)[0], rel=1e-4
        )
        unit = weighted_polynomial((j - i) / half, (j == i).astype(float), weight, degree)[0]
        assert leverage[i] * w[i] == pytest.approx(unit, rel=1e-4)


def test_median_and_spread_of_small_samples():
    assert median_of(np.array([5.0, 1.0, 3.0])) == 3.0
    assert median_of(np.array([5.0, 1.0, 3.0, 2.0])) == 2.5
    assert spread(np.array([-1.0, 2.0, -4.0, NAN])) == pytest.approx(1.4826 * 2)
    assert np.isnan(spread(np.array([NAN])))
    assert core_scatter(np.array([2.0] * 7 + [NAN]), 9.0) == 9.0
    assert core_scatter(np.array([2.0] * 8), 9.0) == pytest.approx(1.4826 * 2)
    assert core_scatter(np.zeros(8), 9.0) == 1e-5


def test_excess_is_the_clipped_rms():
    assert excess(np.array([2.0] * 7 + [NAN] * 9)) == 1.0
    assert excess(np.array([2.0, -2.0] * 4)) == pytest.approx(2.0)
    assert excess(np.full(8, 9.0)) == 3.0
    assert excess(np.full(8, 0.1)) == 0.5
    one = np.array([1.0] * 19 + [50.0])
    assert excess(one) == pytest.approx(np.sqrt((19 + (6 * 1.4826) ** 2) / 20))
    below = np.array([1.0] * 19 + [6.0])
    assert excess(below) == pytest.approx(np.sqrt((19 + 36) / 20))


def test_tail_factor_follows_the_kurtosis():
    assert (tail_factor(np.array([3.0] * 7 + [NAN])) == 1).all()
    off = np.array([0.8] * 40 + [3.0, -3.0, NAN])
    known = off[:-1]
    kurtosis = np.mean(known**4) / np.mean(known**2) ** 2 - 3
    nu = 4 + 6 / kurtosis
    assert 5 < nu < 12
    found = tail_factor(off)
    np.testing.assert_allclose(found[:-1], np.sqrt((nu - 2 + known**2) / (nu - 1)))
    assert found[-1] == 1
    long = np.array(
        [0.1] * 100 + [9.0]
    )  # nu is limited to 5; a residual counts up to six standard deviations
    np.testing.assert_allclose(tail_factor(long)[-1], np.sqrt((3 + 81) / 4))
    mild = np.array([0.0] * 50 + [1.0] * 10 + [6.0, 12.0])
    clipped = np.minimum(mild, 6)
    nu = np.clip(4 + 6 / (np.mean(clipped**4) / np.mean(clipped**2) ** 2 - 3), 5, 1000)
    np.testing.assert_allclose(tail_factor(mild)[-1], np.sqrt((nu - 2 + 144) / (nu - 1)))
    short = np.array([1.0, -1.0] * 10)  # a negative kurtosis: nu is 1000
    assert tail_factor(short * 3)[0] == pytest.approx(np.sqrt((998 + 9) / 999))


@pytest.mark.parametrize("mean", [0.0, 100.0])
def test_correlation_factor_is_the_initial_positive_sum(mean):
    rng = np.random.default_rng(1)
    white = rng.normal(size=600)
    assert correlation_factor(white + mean) == 1.0
    residual = np.convolve(white, np.ones(5), mode="valid")
    off = residual - residual.mean()
    size = len(off)
    rho = [np.sum(off[k:] * off[: size - k]) / np.sum(off**2) for k in range(1, size)]
    total, k = 0.0, 0
    while k + 1 < len(rho) and rho[k] + rho[k + 1] > 0:
        total += rho[k] + rho[k + 1]
        k += 2
    assert 1 + 2 * total > 2
    assert correlation_factor(residual + mean) == pytest.approx(1 + 2 * total)
    assert correlation_factor(np.full(20, mean)) == 1.0


def test_a_weak_correlation_is_ignored():
    """The estimates on both sides of 1 + 7 / sqrt(n), for averages over neighbours with a small weight."""
    white = np.random.default_rng(2).normal(size=900)
    seen = set()
    for share in np.linspace(0.05, 0.4, 30):
        x = white[1:] + share * white[:-1]
        off, size = x - x.mean(), len(x)
        rho = np.array([np.sum(off[k:] * off[: size - k]) / np.sum(off**2) for k in range(1, 31)])
        pairs = rho.reshape(-1, 2).sum(axis=1)
        factor = 1 + 2 * pairs[: np.argmax(pairs <= 0)].sum()
        if abs(factor - 1 - 7 / np.sqrt(size)) > 0.004:
            strong = factor > 1 + 7 / np.sqrt(size)
            seen.add(bool(strong))
            assert correlation_factor(x) == pytest.approx(factor if strong else 1.0)
    assert seen == {True, False}


def test_share_of_the_repeatable_errors():
    off, sigma = np.array([3.0, -3.0] * 4), np.full(8, 1.0)
    assert share_of_floor(off, sigma, 4.0, 6.0) == pytest.approx(np.sqrt((4 + 6 * 8 / 16) / 10))
    assert share_of_floor(off, sigma, 2.0, 6.0) == 1.0
    assert share_of_floor(off, 4 * sigma, 4.0, 6.0) == pytest.approx(np.sqrt(0.4))
    assert share_of_floor(off[:7], sigma[:7], 4.0, 6.0) == 1.0
    assert share_of_floor(off, np.where(np.arange(8) == 3, NAN, sigma), 4.0, 6.0) == 1.0
    assert share_of_floor(off, sigma, 0.0, 6.0) == 1.0
    assert share_of_floor(off, sigma, 4.0, 0.0) == 1.0
    outlier = np.array([0.0] * 8 + [900.0])
    limit = 36 * (0.01 + 1.0)
    seen = limit / 9 - 0.01
    assert share_of_floor(outlier, np.full(9, 0.1), 1.0, 0.1) == pytest.approx(
        min(np.sqrt((4 + 0.1 * seen) / 4.1), 1)
    )
    limit = 36 * (0.01 + 100.0)  # twenty points: the mean square of one clipped outlier
    outlier = np.append(np.zeros(99), 900.0)
    expected = np.sqrt((4 + 50 * (limit / 100 - 0.01) / 100) / 54)
    assert expected < 1
    assert share_of_floor(outlier, np.full(100, 0.1), 10.0, 50.0) == pytest.approx(expected)


def test_smooth_path_keeps_distant_values():
    t = np.arange(60.0)
    path = 0.5 * t + 1e-4 * (t - 30) ** 2
    coarse = path.copy()
    coarse[30] += 2.0
    coarse[10] = NAN
    smooth = smooth_path(coarse)
    assert np.isnan(smooth[10])
    assert smooth[30] == coarse[30]
    coarse[30] = path[30] + 0.25
    assert abs(smooth_path(coarse)[30] - path[30]) < 0.05
    clean = np.where(np.arange(60) == 10, NAN, path)
    np.testing.assert_allclose(smooth_path(clean), clean, atol=1e-7)
    few = np.array([0.0, 1.0, 5.0, 2.0, 3.0, 9.0, 1.0, NAN])
    np.testing.assert_array_equal(smooth_path(few), few)
    np.testing.assert_allclose(smooth_path(t[:8] ** 3)[3], 27 + 8 * 0.0, atol=3)
    assert smooth_path(t[:8] ** 3 / 100)[3] != 0.27


@pytest.mark.parametrize(
    ("step", "half"), [(0.001, 120), (0.08, 94), (0.0628, 120), (0.1, 75), (-0.1, 75), (0.13, 60), (1.0, 60)]
)
def test_window_for_repeatable_errors_holds_a_turn_to_both_sides(step, half):
    path = step * np.arange(50.0)
    path[20] = NAN
    assert learning_window(path) == (half, 3)
    assert learning_window(np.array([0.0])) == (120, 3)


def test_frames_with_a_whole_turn_around_them():
    step = 0.1
    path = step * np.arange(200.0)
    assert whole_turns(path, 32).all()  # 2 x 32 x 0.1 = 6.4 > 2 pi
    assert not whole_turns(path, 31).any()
    assert not whole_turns(path[:126], 32).any()  # below two turns
    assert whole_turns(path[:127], 32).all()
    path[100] = NAN
    mask = whole_turns(path, 32)
    assert np.flatnonzero(~mask).tolist() == [68, 132]
    bent = np.where(np.arange(200) < 100, 0.0, step * (np.arange(200.0) - 100))
    bent[150:] = bent[150] + 0.2 * np.arange(50)
    swept = [
        2 * abs(bent[i + 32] - bent[i]) if i < 32
        else 2 * abs(bent[i] - bent[i - 32]) if i >= 168
        else abs(bent[i + 32] - bent[i - 32])
        for i in range(200)
    ]  # fmt: skip
    np.testing.assert_array_equal(whole_turns(bent, 32), np.array(swept) > 2 * np.pi)
    assert len(whole_turns(np.full(5, NAN), 2)) == 5


def test_line_through_a_path():
    path = np.array([1.0, NAN, 5.0, 7.0])
    np.testing.assert_allclose(line_through(path), [1, 3, 5, 7])
    np.testing.assert_allclose(line_through(np.array([NAN, 1.0, 4.0])), [-2, 1, 4])
    assert (line_through(np.array([NAN, 5.0, NAN])) == 0).all()


def test_running_median_keeps_missing_values():
    x = np.array([1.0, 9.0, NAN, 2.0, 3.0, 8.0])
    np.testing.assert_array_equal(median_smooth(x, 3), [1, 2, NAN, 3, 3, 8])
    np.testing.assert_array_equal(median_smooth(x, 1), x)
    for width in (0, 2, -1):
        with pytest.raises(ValueError, match="odd"):
            median_smooth(x, width)


def sigma_of_median(trend):
    """Return the uncertainty of a median of five differences of unit uncertainty with a trend."""
    u = trend * np.arange(-2, 3)
    density = np.exp(-(u**2) / 2) / np.sqrt(2 * np.pi)
    p = np.array([0.5 * math.erfc(-x / math.sqrt(2)) for x in u])
    a, b = u[2:], u[:-2]
    shared = np.sum((-1 / 2 + a * b / 8 - (a**2 - 1) * (b**2 - 1) / 48) * density[2:] * density[:-2])
    return math.sqrt(np.sum(p * (1 - p)) + 2 * shared) / density.sum()


def test_velocity_of_uniform_acceleration_on_a_known_time_base():
    t = 0.02 * np.arange(40)
    angle = 3 * t + 2 * t**2
    omega, u = angular_velocity(t, angle, np.full(40, 0.01), 5)
    known = np.isfinite(omega)
    assert np.flatnonzero(known).tolist() == list(range(4, 36))
    np.testing.assert_array_equal(np.isfinite(u), known)
    np.testing.assert_allclose(omega[known], 3 + 4 * t[known], rtol=1e-9)
    difference = 0.01 * np.sqrt(2) / 0.04  # uncertainty of one central difference
    np.testing.assert_allclose(u[known], difference * sigma_of_median(4 * 0.02 / difference), rtol=1e-4)
    _, u = angular_velocity(t, 3 * t, np.full(40, 0.01), 5)
    np.testing.assert_allclose(u[known], difference * sigma_of_median(0.0), rtol=1e-6)
    assert np.isnan(angular_velocity(t[:8], angle[:8], np.ones(8), 5)[0]).all()
    assert np.isfinite(angular_velocity(t[:9], angle[:9], np.ones(9), 5)[0]).sum() == 1


def test_width_of_an_oscillation_is_halved_until_the_motion_is_kept():
    t = np.arange(1000.0)
    sigma = np.full(1000, 1e-6)
    for period in (12.0, 40.0, 150.0, 300.0, 600.0):
        angle = np.sin(2 * np.pi * t / period)
        width = 51
        while width > 3:
            padded = np.pad(angle, width // 2, mode="edge")
            median = np.median(np.lib.stride_tricks.sliding_window_view(padded, width), axis=1)
            if np.sqrt(np.mean((median - angle)[width:-width] ** 2)) < 0.02 * np.std(angle):
                break
            width = max(3, (width // 2) | 1)
        assert smoothing_width(angle, sigma) == width
    assert smoothing_width(np.sin(t[:102] / 2), sigma[:102]) == 51
    assert smoothing_width(np.sin(t[:103] / 2), sigma[:103]) < 51


def test_width_depends_on_the_noise_and_on_the_return():
    t = np.arange(1000.0)
    angle = np.sin(2 * np.pi * t / 20)
    deviation = np.std(angle)
    assert smoothing_width(angle, np.full(1000, deviation / 5.2)) < 51
    assert smoothing_width(angle, np.full(1000, deviation / 4.8)) == 51
    # 2 sigma permits what 2 % of the motion does not
    small = 2 * np.pi * t / 60
    assert smoothing_width(np.sin(small), np.full(1000, 1e-6)) < smoothing_width(
        np.sin(small), np.full(1000, 0.1)
    )
    there = np.concatenate([np.linspace(0, 1, 500), np.linspace(1, 0.3, 500)])  # 0.3 of a path of 1.7
    wave = there + 0.02 * np.sin(t)
    assert smoothing_width(wave, np.full(1000, 1e-9)) < 51
    assert smoothing_width(t * 0.01 + 0.001 * np.sin(t), np.full(1000, 1e-9)) == 51


@pytest.mark.parametrize(("back", "kept"), [(0.2, True), (0.3, False)])
def test_width_of_a_body_that_turns_back_a_little(back, kept):
    """The net rotation divided by the path is (1 - b) / (1 + b): 0.67 and 0.54, on both sides of 0.6."""
    rise = np.linspace(0, 1, 800)
    angle = np.concatenate([rise, 1 - np.linspace(0, back, 200)])
    angle[300] += 40  # no median of five shows it
    assert (smoothing_width(angle, np.full(1000, 1e-9)) == 51) == kept


def test_local_parabola_is_a_weighted_fit_in_time():
    rng = np.random.default_rng(3)
    place = np.cumsum(rng.uniform(0.5, 1.5, 90))
    value = rng.normal(size=90)
    fitted, slope = local_parabola(place, value)
    for i in (0, 7, 45, 89):
        j = np.arange(max(i - 20, 0), min(i + 20, 89) + 1)
        weight = 1 - ((j - i) / 21) ** 2
        c = weighted_polynomial(place[j] - place[i], value[j], weight, 2)
        assert fitted[i] == pytest.approx(c[0], rel=1e-5, abs=1e-6)
        assert slope[i] == pytest.approx(c[1], rel=1e-5, abs=1e-6)


def test_local_parabola_at_equal_times_is_finite():
    fitted, slope = local_parabola(np.zeros(5), np.arange(5.0))
    assert np.isfinite(fitted).all()
    assert np.isfinite(slope).all()


def test_path_on_a_time_base_with_gaps():
    place = np.delete(np.arange(80.0), [20, 21, 50]) + 7
    base = TimeBase(place)
    path = 0.3 * base.place - 1e-3 * base.place**2
    coarse = path.copy()
    coarse[5] = NAN
    smooth, even = base.path(coarse)
    grid = np.arange(80.0)
    assert np.isnan(smooth[5])
    np.testing.assert_allclose(np.delete(smooth, 5), np.delete(path, 5), atol=1e-6)
    np.testing.assert_allclose(even, 0.3 * grid - 1e-3 * grid**2, atol=1e-6)
    coarse[40] += 1.0
    assert base.path(coarse)[0][40] == coarse[40]
    speed = base.speed(np.where(np.arange(77) == 5, NAN, path))
    assert np.isnan(speed[5])
    np.testing.assert_allclose(np.delete(speed, 5), np.delete(0.3 - 2e-3 * base.place, 5), atol=2e-3)
    assert np.isnan(base.speed(np.where(np.arange(77) == 5, 1.0, NAN))).all()
    few = np.where(np.arange(77) < 5, path, NAN)
    assert base.path(few)[0] is few
    assert (base.path(few)[1] == np.zeros(80)).all()
    six = np.where(np.arange(77) < 6, path, NAN)
    filled = base.path(six)[1]
    np.testing.assert_allclose(filled[:6], path[:6], atol=1e-6)
    np.testing.assert_allclose(filled[6:], path[5], atol=1e-6)


def test_residuals_on_a_time_base_are_smoothed_with_the_path():
    place = np.sort(np.append(np.arange(30.0), [4.2, 11.1]))
    base = TimeBase(place)
    slot = np.rint(place).astype(int)
    rng = np.random.default_rng(4)
    off, weight = rng.normal(size=32), rng.uniform(0.5, 2, 32)
    weight[9], off[9] = 0.0, NAN
    bend = 0.01 * np.arange(30.0) ** 2
    total = np.array([weight[slot == k].sum() for k in range(30)])
    mean = np.array([
        np.nansum((off * weight)[slot == k]) / total[k] if total[k] else 0.0 for k in range(30)
    ])  # fmt: skip
    smooth, leverage = local_fit(mean + bend, total, 5, 2)
    found, weights = base.smooth(off, weight, bend, 5, 2)
    np.testing.assert_allclose(found, np.interp(place, np.arange(30), smooth - bend))
    np.testing.assert_allclose(weights, leverage[slot])


@pytest.mark.parametrize(
    ("share", "noise", "real"),
    [
        (1.0, 1e-4, True),
        (0.0, 1e-4, False),
        (0.6, 1e-4, True),
        (0.4, 1e-4, False),
        (0.0, 0.08, True),  # the uncertainty of the share is above 0.2
        (0.0, 0.03, False),
    ],
)
def test_jitter_is_real_if_the_angle_follows_it(share, noise, real):
    """Of 101 frames with a jitter of 0.3 periods, an uncertainty of 0.2 needs noise of 0.06 rad."""
    rng = np.random.default_rng(5)
    smooth = np.arange(101.0)
    jitter = 0.3 * rng.permutation(np.tile([-1.0, 1.0], 51))[:101]
    angle = 0.1 * (smooth + share * jitter) + noise * rng.normal(size=101)
    assert jitter_is_real(smooth + jitter, smooth, angle) == real
    angle[50] += 0.6  # an outlier is not used
    assert jitter_is_real(smooth + jitter, smooth, angle) == real
    assert jitter_is_real(smooth + jitter, smooth, np.where(smooth < 39, angle, NAN))
