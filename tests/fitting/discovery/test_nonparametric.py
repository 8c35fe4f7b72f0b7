"""Nonparametric laws of a speed, or of time, as rivals of named effects."""

import math
from dataclasses import replace
from functools import cache

import pytest
import twobody

from fitting import LIBRARY, REDUCED, Model, diagnose, make_record
from fitting._criteria import DEFAULT
from fitting.discovery._lack_of_fit import (
    UNKNOWN_LAWS,
    nonparametric_law,
)
from fitting.discovery._named_effect import form_test
from fitting.discovery._select import rank
from fitting.effects._user import resolve
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit

RESONANCE = "casing: -k*exp(-((omega_c - 110)/30)**2)"
HIDDEN = {
    "resonance": twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -4e-7 * math.exp(-(((wc - 110) / 30) ** 2))),
    "wear": twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -1.5e-6 * (t / 200) ** 2),
    "swing": twobody.Hidden(casing=lambda t, wr, wc, pr, pc: 4e-7 * math.cos(0.5 * t)),
    "step": twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -6e-7 if t >= 88.0 else 0.0),
}


@cache
def base(name):
    motion = twobody.simulate(hidden=HIDDEN[name], ou=1e-7, seed=5)
    # changes in time need short blocks
    cameras = twobody.FEWER_FRAMES if name in {"resonance", "step"} else None
    return fit(Model.of(REDUCED), [CaseData.of(make_record(**twobody.film(motion, 5, cameras)))])


@cache
def ranked(name):
    return rank(base(name))


def gain(name, effect, **start):
    found = fit(base(name).model.with_effect(effect), base(name).problem.data, start=start or None)
    return base(name).deviance - found.deviance


@pytest.mark.slow
def test_a_nonparametric_law_describes_the_data_as_well_as_the_true_one():
    truth = gain("resonance", resolve(RESONANCE))
    assert truth > 30
    assert nonparametric_law(base("resonance"), "casing", "omega_c") == pytest.approx(truth, rel=0.2)


@pytest.mark.slow
@pytest.mark.release
def test_a_step_in_time_is_not_a_law_of_the_speed():
    step = gain("step", LIBRARY["touchpoint.step"], **{"touchpoint.step.t0": 88.0})
    assert nonparametric_law(base("step"), "casing", "omega_c") < 0.6 * step
    assert diagnose(base("step"), candidates=ranked("step")).candidates[0].indistinguishable_from == ()


@pytest.mark.slow
@pytest.mark.release
def test_a_sinusoid_of_many_periods_is_not_a_slow_torque():
    """Sixteen periods: a spline with five knots in time does not resolve them."""
    effect = LIBRARY["casing.precession"]
    (found,) = (c for c in ranked("swing") if c.effect.name == effect.name)
    assert not form_test(found.fit, effect, DEFAULT).any_in_time


@pytest.mark.slow
@pytest.mark.release
def test_a_sinusoid_of_less_than_a_period_is_not_named():
    """Amplitude and phase of less than a period are degenerate: nothing of them is determined."""
    found = base("wear")
    (slow,) = (c for c in ranked("wear") if c.effect.name == "casing.precession")
    answer = diagnose(found, candidates=[replace(slow, indistinguishable_from=())])
    assert answer.verdict == "unexplained"
    assert "precession" not in answer.sentence


@pytest.mark.slow
def test_a_periodic_candidate_may_have_an_unknown_law_as_rival(monkeypatch):
    """Where any law of the casing's speed describes the data as well, it is named as a rival."""
    found = base("step")
    monkeypatch.setattr(
        "fitting.discovery._lack_of_fit.nonparametric_law",
        lambda _, joint, speed: 1e4 if joint == "casing" else 0.0,
    )
    doubtful = diagnose(found, candidates=ranked("step"))
    assert doubtful.verdict == "missing_effect"
    assert doubtful.candidates[0].indistinguishable_from == (UNKNOWN_LAWS["omega_c"],)
    assert f"or {UNKNOWN_LAWS['omega_c']}; these data cannot separate them" in doubtful.sentence
