"""Tests of the form of a law: the detection limit against simulation, and what prevents an exact answer."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import twobody
from linearised import gyroscope

from fitting import LIBRARY, REDUCED, Experiment, Model, diagnose, make_record, simulate
from fitting._criteria import DEFAULT
from fitting.discovery._lack_of_fit import UNKNOWN_IN_TIME
from fitting.discovery._named_effect import FormTest, form_test
from fitting.effects._user import resolve
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit

DRAG = LIBRARY["casing.air.quadratic"]


@cache
def drag(torque):
    hidden = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -torque * (wc / 160) ** 2)
    film = twobody.film(twobody.simulate(hidden=hidden, seed=6), 6, twobody.FEWER_FRAMES)
    return fit(Model.of(REDUCED).with_effect(DRAG), [CaseData.of(make_record(**film))])


@pytest.mark.slow
def test_the_limit_is_inversely_proportional_to_the_torque():
    strong, weak = (form_test(drag(k), DRAG, DEFAULT) for k in (2e-6, 2e-7))
    assert strong.variable == "omega_c"
    assert strong.limit < math.sqrt(1 - DEFAULT.explained)
    assert weak.limit / strong.limit == pytest.approx(10, rel=0.2)


@pytest.mark.slow
def test_the_form_of_a_strong_drag_is_established():
    found = form_test(drag(2e-6), DRAG, DEFAULT)
    assert not found.any_in_time
    assert found.bounds_p > 0.01
    assert found.is_strong(DEFAULT)


@pytest.mark.slow
def test_a_significant_active_bound_is_reported():
    """The range of b2 is below its value: chi-square would fall above the bound."""
    base = drag(2e-6)
    b2 = base.estimates["casing.air.linear.b2"].value
    held = fit(base.model, base.problem.data, ranges={"casing.air.linear.b2": (0.5 * b2, 0.8 * b2)})
    found = form_test(held, DRAG, DEFAULT)
    assert "casing.air.linear.b2" in found.bounds
    assert found.bounds_p < 1e-6
    assert not found.is_strong(DEFAULT)


def test_the_limit_is_that_at_the_level_of_the_recording():
    """A deviation raises the level of the model to that of the recording, at which it is tested, and not beyond."""
    names = ("rotor.air.quadratic", "touchpoint.constant", "bearing.linear", DRAG.name)
    strength = {f"{DRAG.name}.k": 2e-7}

    def limit(level, pure):
        base = gyroscope(names, strength, level=level)
        base.noise[0].pure, base.noise[0].tested = pure, min(level, pure)
        base.estimates = {}
        return form_test(base, DRAG, DEFAULT).limit

    assert limit(1e-9, 1e-6) == pytest.approx(limit(1e-6, 1e-6))
    assert limit(1e-9, 1e-6) > 1.2 * limit(1e-9, 1e-9)


def test_a_weak_test_or_an_active_bound_is_not_strong():
    good = FormTest(0.1, "t", (), 1.0, any_in_time=False)
    assert good.is_strong(DEFAULT)
    assert not replace(good, limit=0.3).is_strong(DEFAULT)
    assert not replace(good, bounds=("bearing.power.g",), bounds_p=1e-3).is_strong(DEFAULT)


@pytest.mark.slow
@pytest.mark.release
def test_a_torque_that_decays_in_time_is_not_named_heating_only():
    """A heated bearing and one that is run in give the same motion here: the answer is a class."""
    law = resolve("bearing: k*exp(-t/9)")
    model = Model.of(REDUCED).with_effect(law)
    numbers = {
        "rotor.air.quadratic.a2": 1.1e-10,
        "touchpoint.constant.b1": 9e-6,
        "casing.air.linear.b2": 4e-7,
        "bearing.linear.d": 2.2e-8,
        "bearing.power.f": 1.1e-6,
        "bearing.power.g": 0.72,
        f"{law.name}.k": 2e-6,
    }
    experiment = Experiment(omega_rotor=430.0, duration=45.0, windows=(0.5, 18.0, 36.0))
    record = simulate(model, numbers, experiment, seed=3, inertia_rotor=8.1e-5, inertia_casing=3.3e-5)
    base = fit(Model.of(REDUCED), [record])
    answer = diagnose(base)
    chosen = answer.candidates[0]
    assert chosen.effect.name == "bearing.heating"
    assert UNKNOWN_IN_TIME in chosen.indistinguishable_from
    assert f"or {UNKNOWN_IN_TIME}; these data cannot separate them" in answer.sentence


@pytest.mark.slow
@pytest.mark.release
def test_nine_in_ten_deviations_of_the_limit_are_detected():
    """Rows of the linear theory itself: random smooth deviations of twice the limit, put through the smooth test."""

    limit = form_test(drag(2e-6), DRAG, DEFAULT).limit
    random, hits = np.random.default_rng(1), 0
    for seed in range(6):
        h = random.standard_normal(4)
        h *= 2 * limit / math.sqrt(np.mean(h**2))

        def law(t, wr, wc, pr, pc, h=h):
            share = np.interp(wc, np.linspace(0, 170, 4), h)
            return -2e-6 * (wc / 160) ** 2 * (1 + share)

        motion = twobody.simulate(hidden=twobody.Hidden(casing=law), seed=seed)
        film = twobody.film(motion, seed, twobody.FEWER_FRAMES)
        deviating = fit(Model.of(REDUCED).with_effect(DRAG), [CaseData.of(make_record(**film))])
        hits += deviating.smooth_test.p_value < DEFAULT.doubt_named
    assert hits >= 4
