"""Whole turns that slipped: found, corrected, and never angle noise."""

import math
from dataclasses import replace

import numpy as np
import pytest
import twobody

from fitting import make_record
from fitting._criteria import DEFAULT
from fitting.inference._case_data import CaseData
from fitting.inference._record import Samples
from fitting.inference._slips import Slip, as_measured, slipped_turns, without_slips

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


@pytest.mark.slow
def test_the_corrected_record_is_the_one_without_slip():
    motion = twobody.simulate(span=40.0)
    cameras = twobody.Cameras(span=40.0, windows=(5.0, 18.0, 34.0), casing_rate=50.0, rotor_rate=400.0)
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


@pytest.mark.parametrize(("count", "found"), [(32, [(16, 1)]), (31, [])])
def test_a_local_speed_needs_31_steps(count, found):
    assert slipped_turns(stepped(turning(5.0, count=count), 16, 1)) == found


@pytest.mark.parametrize(("step", "found"), [(0.49, True), (-0.49, True), (0.51, False), (-0.51, False)])
def test_a_slip_is_known_below_half_a_turn_per_sample(step, found):
    """In turns from one sample to the next."""
    time = np.arange(200.0)
    samples = Samples(time, TURN * step * time, np.full(200, 1e-3))
    assert slipped_turns(stepped(samples, 80, 2)) == ([(80, 2)] if found else [])


@pytest.mark.parametrize("turns", [1, -1])
@pytest.mark.parametrize("first", [1, 2, 198, 199])
def test_a_slip_beside_the_first_or_the_last_sample_is_found(first, turns):
    assert slipped_turns(stepped(turning(5.0, count=200), first, turns)) == [(first, turns)]


@pytest.mark.parametrize(("share", "found"), [(0.9, True), (-0.9, True), (1.1, False), (-1.1, False)])
def test_a_slip_is_a_whole_turn_up_to_the_tolerance(share, found):
    samples = turning(5.0, sigma=1e-5, count=200)
    turns = 1 + share * DEFAULT.slip_tolerance
    assert slipped_turns(stepped(samples, 80, turns)) == ([(80, 1)] if found else [])


class TestRecords:
    """A casing and two windows, of which one series or the other slipped."""

    def plain(self, quantity="angle"):
        runs = [
            (run.time, run.value, run.sigma) for run in (turning(20.0, count=400, seed=k) for k in range(3))
        ]
        return make_record(casing=runs[0], rotor=runs[1:], I_rotor=1.0, I_casing=1.0, quantity=quantity)

    def slipped(self, **changes):
        plain = self.plain(**changes)
        rotor = (plain.rotor[0], stepped(stepped(plain.rotor[1], 100, -1), 300, 2))
        return replace(plain, casing=stepped(plain.casing, 200, 1), rotor=rotor)

    def test_corrected_angles_become_the_measured_ones_again(self):
        measured = self.slipped()
        corrected, slips = without_slips(measured)
        time = measured.casing.time
        assert slips == (
            Slip("casing", None, time[200], 1), Slip("rotor", 2, time[100], -1), Slip("rotor", 2, time[300], 2),
        )  # fmt: skip
        again = as_measured(corrected, slips)
        for found, known in ((corrected, self.plain()), (again, measured)):
            for one, other in zip((found.casing, *found.rotor), (known.casing, *known.rotor), strict=True):
                assert one.value == pytest.approx(other.value, abs=1e-9)

    def test_only_measured_angles_slip(self):
        speeds, generated = self.slipped(quantity="omega"), replace(self.slipped(), generated=True)
        for record in (speeds, generated):
            assert without_slips(record) == (record, ())


@pytest.mark.parametrize(
    ("slip", "sentence"),
    [
        (Slip("casing", None, 1.0, -1), "a whole turn slipped in the casing at 1.000 s (-1)"),
        (Slip("rotor", 2, 1.5, 1), "a whole turn slipped in rotor window 2 at 1.500 s (+1)"),
        (Slip("rotor", 1, 1.5, -3), "3 whole turns slipped in rotor window 1 at 1.500 s (-3)"),
    ],
)
def test_a_slip_says_where_and_by_how_much(slip, sentence):
    assert slip.sentence == sentence
