"""Spectral lines with frequency and amplitude, none in noise; lines and responses against generalised least squares."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

from fitting import make_record
from fitting._criteria import DEFAULT
from fitting.inference import _spectral_lines as _spectral_lines
from fitting.inference._case_data import CaseData
from fitting.inference._spectral_lines import (
    false_alarm_probability,
    line_rows,
    p_value_of_response,
    spectral_lines,
)

SPAN, RATE = 60.0, 40.0
FRICTION, NOISE, TIME = 0.3, 0.01, 0.3


def recording(seed, *, amplitude=0.0, frequency=4.3, jump=0.0, noise=NOISE, tracked=False, sigma=4e-4):
    """One body that slows down by 0.3 rad/s2, with a random acceleration and a sinusoidal one [rad/s2]."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, SPAN, 1 / RATE)
    keep = np.exp(-1 / RATE / TIME)
    kicks = noise * np.sqrt(1 - keep**2) * random.standard_normal(len(t))
    push = lfilter([1.0], [1.0, -keep], kicks) - jump * (t > 0.6 * SPAN)
    angle = 60.0 * t - 0.5 * FRICTION * t**2 + np.cumsum(np.cumsum(push)) / RATE**2
    angle -= amplitude / frequency**2 * np.cos(frequency * t + 0.4)
    angle += sigma * random.standard_normal(len(t))
    casing = (t, angle, np.full(len(t), sigma))
    return CaseData.of(
        make_record(casing=casing, rotor=[], I_rotor=1.0, I_casing=1.0, single=True, tracked=tracked)
    )


@pytest.mark.slow
def test_a_spectral_line_is_found_and_is_not_process_noise():
    data = recording(1, amplitude=0.05)
    (line,) = data.spectral_lines
    assert line.rate == pytest.approx(4.3, abs=0.3 / SPAN)
    assert line.amplitude == pytest.approx(0.05 / 4.3**2, rel=0.15)
    found = data.process_noise
    # slow rows see s^2 T
    assert found.level * np.sqrt(found.time) == pytest.approx(NOISE * np.sqrt(TIME), rel=0.4)
    assert data.angle_noise.sigma == 0


def test_two_lines_are_found():
    t = np.arange(0.0, SPAN, 1 / RATE)
    first = recording(2, amplitude=0.05)
    casing = (t, first.record.casing.value - 0.08 / 6.1**2 * np.cos(6.1 * t), first.record.casing.sigma)
    data = CaseData.of(make_record(casing=casing, rotor=[], I_rotor=1.0, I_casing=1.0, single=True))
    assert sorted(line.rate for line in data.spectral_lines) == pytest.approx([4.3, 6.1], abs=0.3 / SPAN)


@pytest.mark.slow
def test_noise_and_jumps_are_not_spectral_lines():
    """One in a thousand recordings may have one; a jump of the friction has a broad spectrum in one stretch."""
    assert not any(recording(seed).spectral_lines for seed in range(10, 22))
    assert not any(recording(seed, noise=0.1).spectral_lines for seed in range(22, 28))
    assert not any(recording(seed, noise=0.0).spectral_lines for seed in range(28, 32))
    assert not recording(40, jump=0.2, noise=1e-4).spectral_lines


def test_on_film_a_line_below_the_angle_noise_counts_as_noise():
    amplitude = 0.3e-3 * 4.3**2
    assert recording(3, amplitude=amplitude, noise=0.0).spectral_lines
    assert not recording(3, amplitude=amplitude, noise=0.0, tracked=True).spectral_lines


SCALES = (1.0, 0.5, 0.25, 0.12, 0.06)


class Stretch:
    """Rows of white noise; at each level the rows are divided by the level, and the deviance is given."""

    def __init__(self, rows, data, deviances):
        self.rows, self.projected, self._deviances = rows, data, deviances

    def project(self, columns):
        return columns.copy()

    def whitenings_at(self, times, shares):
        assert shares == SCALES
        n = len(self.projected)
        return [(np.eye(n) * s, d) for s, d in zip((1.0, 0.9, 0.8, 0.7, 0.6), self._deviances, strict=True)]


class TestResponse:
    def p_value(self, monkeypatch, *, deviances, noise=0.5):
        rng = np.random.default_rng(5)
        n, waves = 40, 12
        smooth = rng.standard_normal((n, 3)) * [1.0, 1e3, 0.0]
        wave = rng.standard_normal((waves, 3)) * [1.0, 1e3, 0.0]
        camera = rng.standard_normal((waves, 2))
        data, harmonic = rng.standard_normal(n) + smooth[:, 0], noise * rng.standard_normal(waves)
        stretches = [
            Stretch(slice(0, 25), data[:25], deviances), Stretch(slice(25, 40), data[25:], [0.5 * d for d in deviances])
        ]  # fmt: skip
        monkeypatch.setattr(_spectral_lines, "split_into_stretches", lambda run, free: stretches)
        run = SimpleNamespace(
            at_samples=lambda responses: (smooth, wave), harmonic=harmonic, harmonic_exists=np.ones(waves, dtype=bool),
            samples=SimpleNamespace(time=np.array([0.0, 9.0])), lift=np.zeros(3),
        )  # fmt: skip
        basis = np.linalg.qr(camera)[0]
        rest = np.eye(waves) - basis @ basis.T
        w, h = rest @ wave[:, :2], rest @ harmonic
        left = h - w @ np.linalg.lstsq(w, h, rcond=None)[0]
        scale = math.sqrt(max(1.0, float(left @ left) / (waves - 4)))
        falls = [0.0]
        total = 1.5 * np.array(deviances)
        for weight, deviance in zip((1.0, 0.9, 0.8, 0.7, 0.6), total - total.min(), strict=True):
            columns = np.concatenate([weight * smooth[:, :2], w / scale])
            values = np.concatenate([weight * data, h / scale])
            span = np.linalg.qr(columns / np.linalg.norm(columns, axis=0))[0]
            falls.append(float(np.sum((span.T @ values) ** 2)) - deviance)
        return p_value_of_response(run, None, camera, None), float(chi2.sf(max(falls), 2)), scale

    def test_the_fall_is_that_of_least_squares_at_the_best_level(self, monkeypatch):
        found, expected, scale = self.p_value(monkeypatch, deviances=[0.0, 1.0, 2.0, 3.0, 4.0])
        assert scale == 1.0
        assert found == pytest.approx(expected, rel=1e-6)
        found, expected, _ = self.p_value(monkeypatch, deviances=[30.0, 20.0, 9.0, 8.0, 9.0])
        assert found == pytest.approx(expected, rel=1e-6)

    def test_harmonics_that_scatter_more_than_the_samples_count_less(self, monkeypatch):
        found, expected, scale = self.p_value(monkeypatch, deviances=[0.0] * 5, noise=4.0)
        assert scale > 2.0
        assert found == pytest.approx(expected, rel=1e-6)

    def test_a_response_that_is_far_too_unlikely_at_every_level_has_no_significance(self, monkeypatch):
        assert self.p_value(monkeypatch, deviances=[0.0, 1e3, 1e3, 1e3, 1e3])[0] < 1e-3


class TestStrongest:
    """60 rows over 60 s in three stretches."""

    T = np.arange(60) + 0.5

    def run(
        self, monkeypatch, data, *, deviances=(0.0, 9.0, 9.0, 9.0, 9.0), parts=((0, 20), (20, 40), (40, 60))
    ):
        def rows(run, rates):
            phase = np.outer(self.T, rates)
            return np.concatenate([np.cos(phase), np.sin(phase)], axis=1)

        monkeypatch.setattr(_spectral_lines, "line_rows", rows)
        run = SimpleNamespace(
            z=np.zeros(60), samples=SimpleNamespace(time=np.array([0.0, 60.0])), lift=np.zeros(3)
        )
        stretches = [Stretch(slice(a, b), data[a:b], list(deviances)) for a, b in parts]
        return _spectral_lines._strongest(run, stretches, DEFAULT)

    def line(self, rate, amplitude, first=0, last=60):
        inside = (np.arange(60) >= first) & (np.arange(60) < last)
        noise = np.random.default_rng(0).standard_normal(60)
        return noise + inside * amplitude * np.cos(rate * self.T + 0.3)

    @pytest.mark.parametrize("rate", [1.3, 1.37, 2.2])
    def test_a_line_has_its_frequency_and_amplitude(self, monkeypatch, rate):
        found = self.run(monkeypatch, self.line(rate, 4.0))
        assert found.rate == pytest.approx(rate, abs=0.01)
        assert found.amplitude == pytest.approx(4.0, abs=0.5)

    @pytest.mark.parametrize("rate", [0.9, 2.7])
    def test_slower_and_faster_ones_are_not_tried(self, monkeypatch, rate):
        """Ten periods in 60 s have 1.05 rad/s; the fastest have 2.5."""
        found = self.run(monkeypatch, self.line(rate, 4.0))
        assert found is None or abs(found.rate - rate) > 0.1

    def test_noise_has_no_line(self, monkeypatch):
        assert self.run(monkeypatch, self.line(1.3, 0.0)) is None

    def test_a_line_must_not_depend_on_one_stretch(self, monkeypatch):
        assert self.run(monkeypatch, self.line(1.3, 5.0, 0, 20)) is None
        assert self.run(monkeypatch, self.line(1.3, 5.0, 0, 40)) is not None

    def test_the_p_value_is_that_of_the_weakest_combination(self, monkeypatch):
        data = self.line(1.3, 2.6)
        seen = []
        monkeypatch.setattr(
            _spectral_lines,
            "false_alarm_probability",
            lambda *g: seen.append(g) or false_alarm_probability(*g),
        )
        self.run(monkeypatch, data)
        ((fall, band, span),) = seen
        rate = np.linspace(1.25, 1.35, 201)

        def gain(keep, w):
            phase = np.outer(self.T[keep], [w])
            columns = np.concatenate([np.cos(phase), np.sin(phase)], axis=1)
            span_ = np.linalg.qr(columns)[0]
            return float(np.sum((span_.T @ data[keep]) ** 2))

        every = np.arange(60)
        least = [min(gain(every[(every < a) | (every >= a + 20)], w) for a in (0, 20, 40)) for w in rate]
        assert fall == pytest.approx(max(least), rel=5e-3)
        assert band == pytest.approx((2.5 - 2 * math.pi / 6) / (2 * math.pi))
        assert span == 60.0

    def test_a_level_with_more_deviance_counts_less(self, monkeypatch):
        data = self.line(1.3, 4.0)
        falls = []
        monkeypatch.setattr(
            _spectral_lines, "false_alarm_probability", lambda fall, *g: falls.append(fall) or 0.0
        )
        for deviances in (
            (0.0, 99.0, 99.0, 99.0, 99.0),
            (20.0, 99.0, 99.0, 99.0, 0.0),
            (99.0, 0.0, 99.0, 99.0, 99.0),
        ):
            self.run(monkeypatch, data, deviances=deviances)
        assert falls[2] == pytest.approx(0.81 * falls[0], rel=1e-6)
        # at the last level, the square is 0.36 times as large; two stretches have 40 more at the first level
        assert falls[1] == pytest.approx(max(0.36 * falls[0], falls[0] - 40.0), rel=1e-6)


class TestLines:
    def test_a_false_alarm_is_that_of_baluev(self):
        for statistic, band, span in ((40.0, 2.0, 50.0), (60.0, 0.5, 300.0)):
            z = statistic / 2
            bound = math.exp(-z) * (1 + band * span * math.sqrt(math.pi / 3) * math.sqrt(z))
            assert false_alarm_probability(statistic, band, span) == pytest.approx(bound)
        assert false_alarm_probability(1.0, 2.0, 50.0) == 1.0
        assert false_alarm_probability(0.0, 0.0, 50.0) == 1.0

    def test_rows_of_a_line_count_from_the_first_sample(self):
        operator = np.array([[1.0, 2.0], [0.0, 3.0]])
        run = SimpleNamespace(
            z=np.zeros(2), samples=SimpleNamespace(time=np.array([5.0, 9.0])), lift=np.zeros((2, 1, 1)),
            binned_operators=[(np.array([5.5, 6.0]), operator)],
        )  # fmt: skip
        phase = np.array([[0.5], [1.0]]) * [2.0, 3.0]
        assert line_rows(run, [2.0, 3.0]) == pytest.approx(
            operator @ np.hstack([np.cos(phase), np.sin(phase)])
        )
        assert line_rows(run, []).shape == (2, 0)
        assert _spectral_lines._noise_times(run) == pytest.approx((0.06, 0.6, 2.0))

    def test_at_most_four_lines_are_found_each_beside_the_earlier_ones(self, monkeypatch):
        seen = []
        monkeypatch.setattr(
            _spectral_lines, "line_rows", lambda run, rates: np.full((3, 2 * len(rates)), 2.0)
        )
        monkeypatch.setattr(_spectral_lines, "split_into_stretches", lambda run, free: seen.append(free))
        lines = iter([SimpleNamespace(rate=float(i)) for i in range(9)])
        monkeypatch.setattr(_spectral_lines, "_strongest", lambda *given: next(lines))
        found = spectral_lines(None, np.ones((3, 1)))
        assert [x.rate for x in found] == [0.0, 1.0, 2.0, 3.0]
        assert [f.shape[1] for f in seen] == [1, 3, 5, 7]
        assert (seen[1][:, 1:] == 2.0 * _spectral_lines.FLAT_PRIOR_SIGMA).all()
        monkeypatch.setattr(_spectral_lines, "_strongest", lambda *given: None)
        assert spectral_lines(None, np.ones((3, 1))) == ()
