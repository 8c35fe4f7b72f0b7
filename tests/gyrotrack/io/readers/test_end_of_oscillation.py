"""Where an oscillation comes to rest: dry friction ends it, air drag does not."""

import numpy as np
import pytest

from gyrotrack.io.readers._run import end_of_oscillation

SIGMA = 2e-3
T = np.arange(0, 60, 0.02)


def noisy(angle, sigma=SIGMA, seed=2):
    return angle + np.random.default_rng(seed).normal(0, sigma, len(angle))


def stopping(stop, rest=0.004):
    """Amplitude 1 - t / stop with a period of 1.6 s, at rest beside the equilibrium from then on."""
    return np.where(stop > T, (1 - T / stop) * np.cos(2 * np.pi * T / 1.6), rest)


def end(angle, sigma=SIGMA):
    return end_of_oscillation(T, angle, np.full(len(T), sigma))


@pytest.mark.parametrize("stop", [20.0, 40.0])
def test_the_body_stops_where_it_stops(stop):
    """The last eighths of a period below 8 standard errors of their means count as rest."""
    found = end(noisy(stopping(stop)))
    assert -0.6 < T[found] - stop < 0.25


@pytest.mark.parametrize("stop", [2011, 2015, 2020])
def test_the_end_is_that_of_the_last_eighth_of_a_period_with_motion(stop):
    """Eighths of 10 samples, counted from the end of the record; the body is stopped halfway between two reversals."""
    angle = np.where(np.arange(len(T)) < stop, np.cos(2 * np.pi * T / 1.6), -1.0)
    assert end(angle, 1e-9) == 2020


@pytest.mark.parametrize(("rest", "cut"), [(1.4, False), (1.9, True)])
def test_rest_lasts_for_a_period(rest, cut):
    """1.6 s; with the last deflections below the noise it is 1.5 s after the stop at the latest."""
    angle = noisy(stopping(60.0 - rest), 1e-5)
    assert (end(angle, 1e-5) < len(T)) == cut


@pytest.mark.parametrize(("last", "cut"), [(2e-4, True), (4e-3, False), (2e-2, False)])
def test_an_oscillation_that_is_still_seen_is_motion(last, cut):
    """exp(-t / tau) to `last` at the end: means of 10 samples show a range of 8 x 2 mrad / sqrt(10)."""
    angle = noisy(np.exp(T / 60 * np.log(last)) * np.cos(2 * np.pi * T / 1.6))
    assert (end(angle) < len(T)) == cut


@pytest.mark.parametrize(("size", "cut"), [(0.8e-3, True), (1.3e-3, False)])
def test_what_is_left_is_compared_with_the_range(size, cut):
    """Without noise: 0.2 % of the range of 2 is an amplitude of 2 mrad, smeared by an eighth of a period."""
    angle = np.where(T < 40, np.cos(2 * np.pi * T / 1.6), 2 * size * np.cos(2 * np.pi * T / 1.6))
    assert (end(angle, 1e-9) < len(T)) == cut


def test_the_uncertainty_decides_what_noise_is():
    angle = noisy(np.exp(-T / 10) * np.cos(2 * np.pi * T / 1.6), 1e-5)
    assert T[end(angle, 5e-2)] < T[end(angle, 5e-3)]


def test_a_body_that_hardly_turns_back_is_left_alone():
    assert end(noisy(np.minimum(T, 20.0))) == len(T)
