"""Spectral lines are found with frequency and amplitude; there are none in noise."""

import numpy as np
import pytest
from scipy.signal import lfilter

from fitting import make_record
from fitting.inference._case_data import CaseData

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
