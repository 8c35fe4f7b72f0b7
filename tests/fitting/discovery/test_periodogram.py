"""A sinusoidal torque in time is distinguished from a random one, with frequency and amplitude."""

import math

import numpy as np
import pytest
import twobody
from oscillators import motion, record
from scipy import stats

from fitting import REDUCED, Model, diagnose, fit, make_record
from fitting.effects._user import resolve
from fitting.inference._spectral_lines import false_alarm_probability

TORQUE, RATE, PHASE = 8e-7, 2.3, 0.7
SHAKEN = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: TORQUE * math.cos(RATE * t + PHASE))
NOISE = 1e-7
BASE = Model.of(REDUCED)


def found(hidden, seed, model=BASE, **record):
    film = twobody.film(twobody.simulate(hidden=hidden, ou=NOISE, seed=seed), seed)
    return fit(model, [make_record(**film, **record)])


@pytest.fixture(scope="module")
def shaken():
    return found(SHAKEN, 3)


@pytest.mark.slow
def test_a_sinusoidal_torque_is_found_and_is_not_process_noise(shaken):
    assert shaken.verdict == "lack_of_fit"
    assert shaken.noise[0].pure == pytest.approx(NOISE, rel=0.5)
    line = shaken.periodogram_peak
    assert line.p_value < 1e-6
    span = shaken.problem.data[0].record.span
    assert line.rate == pytest.approx(RATE, abs=0.3 / (span[1] - span[0]))
    assert line.torque == pytest.approx(TORQUE, rel=0.1)
    assert line.angle == pytest.approx(TORQUE / (twobody.I_CASING * RATE**2), rel=0.1)


@pytest.mark.slow
def test_amplitude_of_a_driven_oscillator_is_that_of_the_formula():
    """Off resonance the amplitude is k / |kappa - I rate^2|; an amplitude larger than the motion does not count."""
    own, rate, drive = 25.0, 2.0, 0.2
    t, angle, _ = motion(lambda t, x, v: -own * x - 0.02 * v + drive * math.cos(rate * t), (0.3, 0.0), 60.0)
    data = record(t, angle, 2e-4, 1)
    line = fit(Model.of(["casing.spring.linear", "casing.air.linear"]), [data]).periodogram_peak
    assert line.rate == pytest.approx(rate, abs=0.05)
    assert line.angle == pytest.approx(drive / (own - rate**2), rel=0.1)
    assert line.p_value < 1e-6


@pytest.mark.slow
def test_diagnosis_names_the_sinusoid_and_its_law_fits(shaken):
    answer = diagnose(shaken, candidates=[])
    line = shaken.periodogram_peak
    assert answer.verdict == "unexplained"
    assert f"is sinusoidal with a period of {2 * math.pi / line.rate:.4g} s" in answer.sentence
    assert f'"{line.law}"' in answer.sentence
    mended = found(SHAKEN, 3, BASE.with_effect(resolve(line.law)))
    k = next(e for name, e in mended.estimates.items() if name.endswith(".k"))
    phi = next(e for name, e in mended.estimates.items() if name.endswith(".phi"))
    assert abs(k.value) == pytest.approx(TORQUE, abs=4 * k.stderr)
    assert math.cos(phi.value - PHASE) * np.sign(k.value) == pytest.approx(1.0, abs=0.01)
    assert mended.noise[0].level < 2 * NOISE
    assert mended.periodogram_peak.p_value > 1e-3


@pytest.mark.slow
def test_on_film_a_sinusoid_below_the_angle_noise_is_not_an_evidence():
    faint = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: 0.1 * SHAKEN.casing(t, wr, wc, pr, pc))
    told, filmed = (found(faint, 4, tracked=tracked).periodogram_peak for tracked in (False, True))
    assert told.p_value < 0.01
    assert filmed.p_value == 1.0
    assert (filmed.rate, filmed.label) == (told.rate, told.label)
    assert filmed.torque == pytest.approx(told.torque, rel=0.01)


def test_false_alarm_probability_agrees_with_simulated_noise():
    """Against periodograms of white noise, evenly sampled, with as fine a grid."""
    n, span = 600, 200.0
    rng = np.random.default_rng(0)
    t = (np.arange(n) + 0.5) * span / n
    rates = np.arange(0.4, 4.0, math.pi / span)
    waves = np.concatenate([np.cos(np.outer(rates, t)), np.sin(np.outer(rates, t))])
    power = (waves @ rng.standard_normal((n, 1500))) ** 2 * 2 / n
    largest = (power[: len(rates)] + power[len(rates) :]).max(axis=0)
    band = 3.6 / (2 * math.pi)
    for level in (0.1, 0.02):
        beyond = np.sum([false_alarm_probability(chi2, band, span) < level for chi2 in largest])
        assert stats.binom.ppf(1e-4, len(largest), 0.4 * level) <= beyond
        assert beyond <= stats.binom.ppf(1 - 1e-4, len(largest), level)
