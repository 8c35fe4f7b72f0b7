"""A sinusoidal torque counts as process noise until it is named; then smaller effects are found."""

import math

import numpy as np
import pytest
import twobody

from fitting import LIBRARY, REDUCED, Model, diagnose, improve, make_record
from fitting.discovery._select import found_starts, needs_search
from fitting.inference._fit import fit

STRENGTH, RATE, PHASE = 4e-6, 530.0, 1.3
UNBALANCE, TURNED = 8e-6, 0.4
NOISE = 1e-7


def motion(*laws, seed=5):
    """Return a motion with laws on the casing, of (t, phase of the precession, angle of the casing)."""
    plain = twobody.simulate(ou=NOISE, seed=seed, step=0.01)
    step = plain.time[1]
    # the swing hardly moves the rotor: its phase is that of the same motion without it
    phase = np.concatenate([[0.0], np.cumsum(step * RATE / plain.speed[:-1, 0])])

    def casing(t, wr, wc, pr, pc):
        i = min(int(t / step), len(phase) - 2)
        turned = phase[i] + (phase[i + 1] - phase[i]) * (t / step - i)
        return sum(law(turned, pc) for law in laws)

    return twobody.simulate(ou=NOISE, seed=seed, step=0.01, hidden=twobody.Hidden(casing=casing))


def swing(phase, angle):
    return STRENGTH * math.cos(phase + PHASE)


def unbalance(phase, angle):
    return UNBALANCE * math.sin(angle - TURNED)


def test_laws_with_frequency_or_changepoint_need_a_search():
    assert [e.name for e in LIBRARY.values() if needs_search(e)] == ["touchpoint.step", "casing.precession"]


@pytest.fixture(scope="module")
def base():
    return fit(Model.of(REDUCED), [make_record(**twobody.film(motion(swing)))])


@pytest.mark.slow
def test_an_added_effect_starts_at_the_optimum_of_the_score(base):
    assert base.torque_noise > 10 * NOISE
    effect = LIBRARY["casing.precession"]
    start = {k: e.value for k, e in base.estimates.items()} | found_starts(base, [effect])
    found = fit(base.model.with_effect(effect), base.problem.data, start=start)
    assert found.verdict == "no_lack_of_fit"
    assert found.torque_noise == pytest.approx(NOISE, rel=0.6)
    m = found.estimates["casing.precession.m"]
    assert abs(m.value - RATE) < 4 * m.stderr
    assert m.stderr < 1.0


@pytest.mark.slow
@pytest.mark.release
def test_a_second_effect_is_found_after_a_sinusoidal_one():
    fitted = fit(Model.of(REDUCED), [make_record(**twobody.film(motion(swing, unbalance)))])
    rungs = improve(fitted)
    assert {r.change for r in rungs[1:]} == {"+casing.precession", "+casing.unbalance"}
    assert rungs[-1].fit.torque_noise == pytest.approx(NOISE, rel=0.6)
    answer = diagnose(fitted, candidates=rungs[0].candidates, history=rungs)
    assert answer.verdict == "missing_effect"
    assert "second effect unbalance of the casing (casing.unbalance)" in answer.sentence
