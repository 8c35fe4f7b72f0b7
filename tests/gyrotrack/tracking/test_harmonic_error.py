"""Errors that repeat several times per turn, and their share in the covariance of a fit."""

import numpy as np
import pytest

from fitting.inference._angle_noise import stated_error_rows
from fitting.inference._compression import compress
from fitting.inference._record import Samples
from gyrotrack.tracking import _harmonics
from gyrotrack.tracking._fusion import FAST, LEAST_FAST
from gyrotrack.tracking._harmonics import change_with_speed, harmonic_error

FPS, SIGMA = 260.0, 1e-3


def turning(amplitude=0.0, order=8, omega=100.0, count=20 * 512, seed=0):
    """Return angles of a body that slows down, with an error of a phase that changes from batch to batch."""
    rng = np.random.default_rng(seed)
    t = np.arange(count) / FPS
    psi = omega * t - 0.3 * t**2
    phase = np.repeat(rng.uniform(0, 2 * np.pi, count // 512), 512)
    return psi + amplitude * np.sin(order * psi + phase) + SIGMA * rng.standard_normal(count)


@pytest.mark.parametrize("order", [3, 8, 12])
def test_its_size_is_that_of_the_amplitudes(order):
    # an amplitude A of any phase: the standard deviation of each of its two parts is A / sqrt(2)
    assert harmonic_error(turning(1e-3, order)) == pytest.approx(1e-3 / np.sqrt(2), rel=0.1)


@pytest.mark.parametrize("order", [1, 2])
def test_so_it_is_of_the_orders_of_the_camera_where_they_follow_no_law_of_the_speed(order):
    assert harmonic_error(turning(1e-3, order)) == pytest.approx(1e-3 / np.sqrt(2), rel=0.35)


def test_noise_and_higher_orders_are_not_error():
    assert all(harmonic_error(turning(seed=seed)) < 0.1e-3 for seed in range(5))
    assert harmonic_error(turning(1e-3, 13)) < 0.15e-3


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("power", [0.0, 1.0, 2.0, -2.0, 8.0, -6.0])
def test_centre_shutter_blur_and_unbalance_are_not_an_error_of_orders_1_and_2(order, power):
    """While the speed falls from 100 to 40 rad/s the amplitude follows a power of it, 1 mrad on average."""
    t = np.arange(20 * 512) / FPS
    psi = 100.0 * t - 0.76 * t**2
    speed = 100.0 - 1.52 * t
    law = speed ** float(power) / np.mean(speed ** float(power))
    noisy = (
        psi
        + 1e-3 * law * np.sin(order * psi)
        + 0.2 * SIGMA * np.random.default_rng(0).standard_normal(len(t))
    )
    described = order < 3 and power in {0.0, 1.0, 2.0, -2.0}
    assert (harmonic_error(noisy) < 0.02e-3) == described


@pytest.mark.parametrize(("batches", "known"), [(6, False), (7, True)])
def test_four_laws_of_the_speed_need_four_batches_more(batches, known):
    assert (harmonic_error(turning(2e-3, 1, count=batches * 512)) > 0.0) == known


def test_an_order_in_step_with_the_frames_is_left_out():
    """At a twelfth of a turn per frame the twelfth harmonic is a constant, and orders 5 and 7 are the same."""
    t = np.arange(20 * 512) / FPS
    psi = 2 * np.pi * FPS / 12 * t + SIGMA * np.random.default_rng(0).standard_normal(len(t))
    assert harmonic_error(psi) < 0.1e-3
    assert harmonic_error(psi + 1e-3 * np.sin(12 * psi)) < 0.1e-3


@pytest.mark.parametrize(("turns", "left_out"), [(2.4, True), (2.7, False)])
def test_an_order_with_twice_the_variance_resembles_the_motion(turns, left_out):
    """In a batch the twelfth harmonic passes `turns` periods of the frames, beside a polynomial of degree 5."""
    k = np.arange(512)
    wave = 2 * np.pi * turns * k / 512
    design = np.column_stack(
        [np.polynomial.legendre.legvander(np.linspace(-1, 1, 512), 5), np.cos(wave), np.sin(wave)]
    )
    variance = np.diag(np.linalg.inv(design.T @ design))[-2:].max() / (2 / 512)
    assert (variance > 2.0) == left_out
    found = _harmonics._amplitudes(
        (2 * np.pi + wave[1]) / 12 * k + SIGMA * np.random.default_rng(0).standard_normal(512)
    )
    assert len(found[12]) == (not left_out)
    assert len(found[3]) == 1


def test_the_noise_of_an_amplitude_is_that_of_the_residuals():
    """2 s^2 / n for an even rotation, of 40 batches: s^2 by 512 - 30 degrees of freedom each is known within 1 %."""
    noise = _harmonics._amplitudes(turning(count=40 * 512))[8][:, 2]
    assert len(noise) == 40
    assert noise.mean() == pytest.approx(2 * SIGMA**2 / 512, rel=0.035)


def test_few_batches_say_nothing():
    assert harmonic_error(turning(1e-3, count=2 * 512)) == 0.0
    assert harmonic_error(turning(1e-3, count=3 * 512)) > 0.5e-3
    assert harmonic_error(np.full(6 * 512, np.nan)) == 0.0


@pytest.mark.parametrize(
    ("omega", "in_step"), [(2 * np.pi * FPS / 11, True), (2 * np.pi * FPS / 26.7, False)]
)
def test_the_rows_know_where_an_order_is_in_step_with_the_frames(omega, in_step):
    """The eleventh harmonic is constant in one run; no order is a multiple of the frame rate in the other."""
    t = np.arange(0, 4, 1 / FPS)
    noise = SIGMA * np.random.default_rng(0).standard_normal(len(t))
    run = compress(Samples(t, omega * t + noise, np.full(len(t), SIGMA)), degree=4, blocks=1)
    rows = stated_error_rows(run, 0.0, 0.0, harmonic=1e-3)
    largest = float(np.linalg.norm(rows, axis=1).max()) if rows.size else 0.0
    # a constant error of one sigma in 1040 samples is sqrt(1040) = 32 in a row of unit variance
    assert (largest > 25) == in_step
    if in_step:
        again = stated_error_rows(run, 0.0, 0.0, harmonic=0.5e-3)
        assert float(np.linalg.norm(again, axis=1).max()) == pytest.approx(largest / 2, rel=0.05)


@pytest.mark.parametrize(
    ("power", "described"), [(0, True), (1, True), (2, True), (-2, True), (3, False), (-1, False)]
)
def test_amplitudes_follow_four_powers_of_the_speed(power, described):
    speed = np.linspace(20.0, 100.0, 12)
    left = _harmonics._beside_laws_of_speed(
        np.stack([speed ** float(power), -2 * speed ** float(power)]) / np.mean(speed ** float(power)), speed
    )
    assert (np.abs(left).max() < 1e-9) == described


class TestChangeWithSpeed:
    """A body that spins up from 15 to 110 rad/s, with an error once per turn that grows with its blur."""

    COUNT = 12 * 512

    def seen(self, change, *, order=1, constant=0.0, torque=0.0, seed=0, count=COUNT, slow=15.0, top=110.0):
        """Return the angle [rad], the speed [rad/s], and the error due to `change` [rad per 100 rad/s]."""
        rng = np.random.default_rng(seed)
        t = np.arange(count) / FPS
        speed = slow + (top - slow) * np.sin(0.5 * np.pi * t / t[-1])
        psi = np.cumsum(speed) / FPS
        wave = np.cos(order * psi - 0.6)
        error = change * speed / 100.0 * wave
        torque = torque / speed**2 * np.sin(order * psi)
        return psi + error + constant * wave + torque + SIGMA * rng.standard_normal(count), speed, wave

    def left(self, change, **other):
        """Return the largest amplitude [rad] of what is left of `change`, relative to fast frames, and its claim."""
        angle, speed, wave = self.seen(change, **other)
        fast = speed > FAST
        found = change_with_speed(angle, FPS, fast)
        true = change * (speed - speed[fast].mean()) / 100.0 * wave
        parts = [slice(k, k + 512) for k in range(0, len(angle), 512)]
        return max(np.sqrt(2.0) * np.std((found.angle - true)[part]) for part in parts), found.error

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_it_is_found(self, sign):
        assert self.left(sign * 1.5e-3)[0] < 0.3e-3

    def test_it_is_not_that_of_a_constant_error_or_of_an_unbalance(self):
        assert self.left(0.0)[0] < 0.3e-3
        assert self.left(0.0, constant=5e-3)[0] < 0.3e-3
        assert self.left(0.0, torque=10.0)[0] < 0.3e-3  # 44 mrad at 15 rad/s, 0.8 mrad at 110
        assert self.left(1.5e-3, constant=-3e-3, torque=5.0)[0] < 0.3e-3

    def test_its_uncertainty_is_that_of_the_amplitudes(self):
        found = [self.left(1e-3, seed=seed) for seed in range(20)]
        off = np.array([amplitude for amplitude, _ in found])
        # two parts; noise of 0.06 mrad beside the scatter of 0.1 mrad
        ratio = np.sqrt(np.mean(off**2) / 2.0) / np.mean([error for _, error in found])
        assert ratio == pytest.approx(0.0625 / np.hypot(0.0625, 0.1), rel=0.2)

    def test_a_narrow_range_of_speeds_leaves_the_stated_uncertainty(self):
        """From 99 to 101 rad/s: 2 mrad per 100 rad/s."""
        angle, speed, _ = self.seen(0.0, slow=99.0, top=101.0)
        found = change_with_speed(angle, FPS, speed > FAST)
        assert found.error == pytest.approx(2e-3 * np.abs(speed - speed.mean()).max() / 100.0, rel=0.03)

    def test_a_law_that_does_not_fit_makes_it_uncertain(self):
        angle, speed, wave = self.seen(0.0)
        wrong = angle + 1e-3 * np.sign(np.sin(np.arange(self.COUNT) / 500.0)) * wave
        assert change_with_speed(wrong, FPS, speed > FAST).error > 3.0 * self.left(0.0)[1]

    def test_a_torque_follows_its_law_within_a_tenth(self):
        """89 mrad at 15 rad/s, a tenth more below 40 rad/s: what is left is within the stated error, 0.8 mrad."""
        angle, speed, _ = self.seen(0.0)
        psi = np.cumsum(speed) / FPS
        angle += 20.0 / speed**2 * (1 + 0.1 * (speed < 40.0)) * np.sin(psi)
        found = change_with_speed(angle, FPS, speed > FAST)
        parts = found.angle.reshape(-1, 512)
        assert np.sqrt(2.0) * parts.std(axis=1).max() < found.error < 1.1e-3

    @pytest.mark.parametrize(("batches", "known"), [(4, False), (5, True)])
    def test_it_needs_five_batches(self, batches, known):
        angle, speed, _ = self.seen(2e-3, count=batches * 512)
        found = change_with_speed(angle, FPS, speed > FAST)
        assert (np.abs(found.angle).max() > 0.3e-3) == known

    @pytest.mark.parametrize(("share", "known"), [(LEAST_FAST, False), (1.02 * LEAST_FAST, True)])
    def test_without_fast_frames_there_is_none(self, share, known):
        angle, _, _ = self.seen(2e-3)
        found = change_with_speed(angle, FPS, np.arange(self.COUNT) >= self.COUNT - int(share * self.COUNT))
        assert bool(found.angle.any()) == known
        assert (found.error > 0.0) == known

    def test_lost_frames_have_a_finite_error(self):
        angle, speed, _ = self.seen(1.5e-3)
        whole = change_with_speed(angle, FPS, speed > FAST)
        angle[3000:3100] = np.nan
        found = change_with_speed(angle, FPS, speed > FAST)
        assert np.isfinite(found.angle).all()
        assert np.abs(found.angle - whole.angle).max() < 0.5e-3

    def test_a_lost_frame_in_each_slow_batch_leaves_the_result(self):
        """Slow batches determine the change: without them, its uncertainty would be several times larger."""
        angle, speed, _ = self.seen(1.5e-3)
        whole = change_with_speed(angle, FPS, speed > FAST)
        angle[100 : 5 * 512 : 512] = np.nan
        found = change_with_speed(angle, FPS, speed > FAST)
        assert found.error == pytest.approx(whole.error, rel=0.1)
        assert np.abs(found.angle - whole.angle).max() < 0.1e-3

    @pytest.mark.parametrize("order", [2, 3])
    def test_higher_orders_do_not_count(self, order):
        angle, speed, _ = self.seen(3e-3, order=order)
        assert np.abs(change_with_speed(angle, FPS, speed > FAST).angle).max() < 0.3e-3


class TestLimits:
    """Amplitudes are given; their noise has a variance of 1."""

    def error(self, monkeypatch, amplitudes, *, variance=1.0):
        """Return the error for amplitudes (2, batches) of each order."""
        found = {}
        for order, each in amplitudes.items():
            count = each.shape[1]
            rows = [*each, np.full(count, variance), np.linspace(40.0, 100.0, count)]
            found[order] = np.stack(rows, axis=1)
        monkeypatch.setattr(_harmonics, "_amplitudes", lambda _: found)
        return harmonic_error(np.zeros(1))

    def with_mean(self, mean, count):
        """Return amplitudes whose halved squared length exceeds the noise by a mean per batch."""
        size = np.sqrt(2.0 * (1.0 + mean) / 1.25)
        return size * np.stack([np.ones(count), 0.5 * np.ones(count)])

    @pytest.mark.parametrize(("mean", "stated"), [(0.95, False), (1.05, True)])
    def test_an_error_exceeds_three_standard_deviations_of_the_noise(self, monkeypatch, mean, stated):
        """In nine batches, three times 1 / sqrt(9)."""
        found = self.error(monkeypatch, {3: self.with_mean(mean, 9)})
        assert found == pytest.approx(np.sqrt(mean) if stated else 0.0)

    def test_the_largest_error_of_all_orders_is_stated(self, monkeypatch):
        amplitudes = {5: self.with_mean(2.0, 9), 3: self.with_mean(4.0, 9), 7: self.with_mean(0.1, 9)}
        assert self.error(monkeypatch, amplitudes) == pytest.approx(2.0)

    @pytest.mark.parametrize(
        ("order", "batches", "known"), [(3, 2, 0), (3, 3, 1), (2, 6, 0), (2, 7, 1), (1, 6, 0)]
    )
    def test_three_batches_beyond_the_laws_of_the_speed_are_needed(self, monkeypatch, order, batches, known):
        wave = 90.0 * np.stack([np.tile([1.0, -1.0], 4)[:batches]] * 2)
        assert (self.error(monkeypatch, {order: wave}) > 0.0) == bool(known)

    @pytest.mark.parametrize(("mean", "stated"), [(1.15, False), (1.25, True)])
    def test_the_residuals_of_four_laws_have_four_degrees_of_freedom_less(self, monkeypatch, mean, stated):
        """In 13 batches, the limit is 3 sqrt(13) / 9 = 1.20."""
        speed = np.linspace(0.4, 1.0, 13)
        laws = np.stack([speed**power for power in (0.0, 1.0, 2.0, -2.0)], axis=1)
        beside = np.linalg.qr(np.column_stack([laws, speed**5.0]))[0][:, 4]
        wave = np.sqrt(9.0 * (1.0 + mean)) * np.stack([beside, beside]) + 30.0 * laws[:, 2]
        found = self.error(monkeypatch, {1: wave})
        assert found == pytest.approx(np.sqrt(mean) if stated else 0.0, rel=1e-3)


@pytest.mark.parametrize(("lost", "used"), [(1, 6), (153, 6), (154, 5)])
def test_a_batch_with_seven_tenths_of_its_angles_counts(lost, used):
    angle = turning(1e-3, count=6 * 512)
    angle[3 * 512 + 100 : 3 * 512 + 100 + lost] = np.nan
    found = _harmonics._amplitudes(angle)
    assert all(len(each) == used for each in found.values())
    assert np.isfinite(np.concatenate(list(found.values()))).all()
    # whole batches only
    assert len(_harmonics._amplitudes(turning(count=3 * 512)[:-1])[3]) == 2


def test_amplitudes_and_turn_of_a_batch_are_the_same_without_some_of_its_angles():
    psi = 0.37 * np.arange(512)
    angle = psi + 2e-3 * np.cos(5 * psi) + 1e-4 * np.random.default_rng(2).standard_normal(512)
    whole = _harmonics._amplitudes(angle)[5][0]
    angle[:60] = np.nan
    angle[500:] = np.nan
    part = _harmonics._amplitudes(angle)[5][0]
    assert part[:2] == pytest.approx(whole[:2], abs=4e-5)
    assert part[2] == pytest.approx(whole[2] * 512 / 440, rel=0.3)
    assert part[3] == pytest.approx(whole[3], rel=1e-4)


def test_amplitudes_are_those_of_cosine_and_sine_with_the_turn_of_the_batch():
    psi = 0.37 * np.arange(512)
    found = _harmonics._amplitudes(psi + 2e-3 * np.cos(5 * psi) - 1e-3 * np.sin(5 * psi))[5]
    np.testing.assert_allclose(found[0, :2], [2e-3, -1e-3], rtol=0.02)
    assert found[0, 3] == pytest.approx(0.37 * 511, rel=1e-3)
    assert _harmonics._amplitudes(-psi)[5][0, 3] == pytest.approx(0.37 * 511)
