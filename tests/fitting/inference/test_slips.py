"""Whole turns that slipped: found, corrected, and never angle noise."""

import math
from dataclasses import replace

import numpy as np
import pytest
import twobody

from fitting import make_record
from fitting.inference._case_data import CaseData
from fitting.inference._record import Samples
from fitting.inference._slips import slipped_turns, without_slips

TURN = 2 * math.pi


def turning(speed=800.0, fps=1000.0, sigma=4e-3, seed=0, count=3000):
    t = np.arange(count) / fps
    y = speed * t - 2.5 * t**2 + sigma * np.random.default_rng(seed).standard_normal(count)
    return Samples(t, y, np.full(count, sigma))


def stepped(samples, first, turns):
    value = samples.value.copy()
    value[first:] += TURN * turns
    return Samples(samples.time, value, samples.sigma)


@pytest.mark.parametrize("turns", [1, -1, 2])
@pytest.mark.parametrize("speed", [800.0, 5.0])
def test_a_slip_is_found_at_its_sample(speed, turns):
    assert slipped_turns(stepped(turning(speed), 1234, turns)) == [(1234, turns)]


def test_two_slips_and_a_slip_in_a_gap_are_found():
    samples = stepped(stepped(turning(), 500, 1), 2000, -1)
    kept = np.delete(np.arange(3000), np.arange(495, 500))
    gap = Samples(samples.time[kept], samples.value[kept], samples.sigma[kept])
    assert slipped_turns(gap) == [(495, 1), (1995, -1)]


@pytest.mark.parametrize("step", [0.4 * TURN, 0.8 * TURN, 1.2 * TURN])
def test_a_step_that_is_not_a_whole_turn_is_not_a_slip(step):
    samples = turning()
    value = samples.value.copy()
    value[1500:] += step
    assert slipped_turns(Samples(samples.time, value, samples.sigma)) == []


def test_noise_of_a_tenth_of_a_turn_hides_a_slip():
    assert slipped_turns(stepped(turning(sigma=0.3), 1500, 1)) == []
    assert slipped_turns(turning(sigma=0.3)) == []


def test_the_corrected_record_is_the_one_without_slip():
    motion = twobody.simulate(span=40.0)
    cameras = twobody.Cameras(span=40.0, windows=(5.0, 18.0, 34.0), casing_rate=50.0)
    plain = make_record(**twobody.film(motion, cameras=cameras))
    windows = list(plain.rotor)
    windows[1] = stepped(windows[1], 700, 1)
    casing = stepped(plain.casing, 900, -1)
    measured = replace(plain, casing=casing, rotor=tuple(windows), digest="")
    found, slips = without_slips(measured)
    assert [(s.body, s.window, s.turns) for s in slips] == [("casing", None, -1), ("rotor", 2, 1)]
    assert slips[1].time == windows[1].time[700]
    assert found.digest == measured.digest
    for a, b in zip((found.casing, *found.rotor), (plain.casing, *plain.rotor), strict=True):
        np.testing.assert_allclose(a.value, b.value, atol=1e-8)
    corrected = CaseData.of(measured)
    assert corrected.rotor_angle_noise.sigma < 1e-3
    assert "a whole turn slipped in rotor window 2" in " ".join(corrected.findings).lower()
    assert CaseData.of(plain).findings == ()
