"""Which laws of friction a motion separates: limits that follow from the laws."""

import math

import numpy as np
import pytest

from fitting import Case, fit
from fitting.effects._library import find
from fitting.planning import _friction
from fitting.planning._friction import Motion, friction_plan, torque_along

DAHL, LUGRE, GMS = (f"casing.friction.{n}" for n in ("presliding", "lugre", "gms"))


@pytest.fixture(scope="module")
def plan():
    a, b, w0 = 0.4, 0.05, 30.0
    t = np.arange(0, 26.0, 0.25)
    angle = (w0 + a / b) / b * (1 - np.exp(-b * t)) - a / b * t
    noisy = angle + 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    found = fit("support.constant + air.linear", Case.from_arrays(disc={"t": t, "angle": noisy, "u": 1e-3}))
    return friction_plan(found)


def evidence(plan, one, other):
    return next(p for p in plan.pairs if (p.first, p.second) == (one, other)).evidence


def test_a_body_that_does_not_reverse_does_not_show_how_a_contact_yields(plan):
    for rival in ("touchpoint.stribeck", "casing.friction.starvation", LUGRE, GMS):
        assert evidence(plan, DAHL, rival)["recording"] < 0.3 * plan.width
    assert evidence(plan, LUGRE, GMS)["recording"] < 0.3 * plan.width


def test_reversals_separate_hysteresis_from_functions_of_the_speed(plan):
    for law in (DAHL, LUGRE, GMS):
        for rival in ("touchpoint.stribeck", "casing.friction.starvation"):
            assert evidence(plan, law, rival)["reversals"] > 100 * plan.width


def test_reversals_show_the_second_element(plan):
    """A body that turns in one sense shows one friction; a run of reversals shows two stiffnesses."""
    for rival in (DAHL, LUGRE):
        assert evidence(plan, GMS, rival)["reversals"] > plan.width
    assert any(x.startswith("A run of 10 reversals") and f"{GMS} from" in x for x in plan.sentences)


def test_a_law_contains_its_limits(plan):
    """LuGre without excess is Dahl: no run separates Dahl from it, and reversals separate it from Dahl."""
    for motion in ("recording", "reversals", "ramp"):
        assert evidence(plan, DAHL, LUGRE)[motion] < plan.width
    assert evidence(plan, LUGRE, DAHL)["recording"] > plan.width
    assert {"r": 0.0} in [{"r": v["r"]} for v in _friction._trials(find(LUGRE))]


def test_sentences_name_the_runs(plan):
    lines = plan.sentences
    assert lines[0].startswith("This recording separates")
    assert any(
        x.startswith("A run of 10 reversals") and f"{DAHL} from touchpoint.stribeck" in x for x in lines
    )
    assert any(x.startswith("None of these runs separates") and LUGRE in x for x in lines)
    document = plan.document()
    pair = next(p for p in document["pairs"] if (p["law"], p["rival"]) == (DAHL, "touchpoint.stribeck"))
    assert "reversals" in pair["separated_by"]
    assert "recording" not in pair["separated_by"]
    assert repr(plan).count("\n") < 20


def test_the_strain_along_a_motion_is_that_of_dahl():
    """From rest at constant speed: 1 - exp(-x / s); the mean over a cell."""
    time = (np.arange(1600) + 0.5) * 1e-3
    motion = Motion("x", time, np.full(1600, 0.2))
    torque = torque_along(find(DAHL), {"k": 1.0, "s": 0.05}, motion)
    expected = -(1 - np.exp(-0.2 * (time - time[0]) / 0.05)).reshape(-1, 16).mean(axis=1)
    np.testing.assert_allclose(torque, expected, atol=1e-9)


def test_without_dry_friction_a_tenth_of_the_torque_is_taken():
    t = np.arange(0, 20.0, 0.25)
    omega = 20 * np.exp(-0.1 * t)
    found = fit("air.linear", Case.from_arrays(disc={"t": t, "omega": omega, "u": 0.01}))
    assert friction_plan(found).strength == pytest.approx(
        0.1 * 2.0 * math.sqrt((1 - math.exp(-4)) / 4), rel=0.02
    )
