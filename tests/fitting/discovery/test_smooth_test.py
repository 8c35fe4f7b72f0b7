"""The smooth test rejects a named law whose residuals depend on a speed, and accepts the right one."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import twobody

from fitting import REDUCED, Model, diagnose, fit, make_record
from fitting.discovery._select import rank
from fitting.inference._case_data import CaseData

# a drag at one speed of the casing only: no law of the library
DIP = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -3.2e-7 * np.exp(-(((wc - 110) / 12) ** 2)))
DRAG = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -2e-10 * abs(wc) * wc)


@lru_cache(maxsize=2)
def filmed(seed, hidden):
    motion = twobody.simulate(hidden=hidden, ou=1e-7, seed=seed)
    return CaseData.of(make_record(**twobody.film(motion, seed)))


def found(seed, hidden, *more):
    return fit(Model.of((*REDUCED, *more)), [filmed(seed, hidden)])


@pytest.mark.slow
@pytest.mark.release
def test_smooth_test_rejects_a_law_of_the_wrong_shape_that_slow_torques_accept():
    named = found(5, DIP, "touchpoint.step")
    assert not named.fails()
    assert named.verdict == "lack_of_fit"
    assert named.smooth_test.p_value < 0.01
    assert named.smooth_test.body == "casing"


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_smooth_test_accepts_the_right_law(seed):
    assert found(seed, DRAG, "casing.air.quadratic").smooth_test.p_value > 0.01


@pytest.mark.slow
@pytest.mark.release
def test_a_rejected_effect_is_named_as_a_hypothesis():
    base = found(5, DIP)
    (step,) = (c for c in rank(base) if c.effect.name == "touchpoint.step")
    answer = diagnose(base, candidates=[replace(step, indistinguishable_from=())])
    assert answer.verdict == "unexplained"
    assert "depends on the speed of the casing" in answer.sentence
    assert "hypothesis" in answer.sentence


@pytest.mark.slow
def test_a_dependence_on_speed_is_reported_without_a_library_law():
    answer = diagnose(found(5, DIP), candidates=[])
    assert answer.verdict == "unexplained"
    assert "No effect of the library explains it" in answer.sentence
