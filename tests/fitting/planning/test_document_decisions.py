"""The numbers of a plan in its document: torques are strengths by their torque, separations are square roots."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from fitting.discovery._information import Run
from fitting.discovery._next_run import Bounds, NextRun
from fitting.discovery._power import EffectLimits
from fitting.effects._library import find
from fitting.planning._documents import plan_document
from fitting.planning._plan import Plan


def limits(name, **change):
    given = {
        "effect": find(name),
        "strength": "k",
        "unit": "N m",
        "shape": {"w": 3.0},
        "stderr": 0.1,
        "torque": 4.0,
        "detection_limit": 0.5,
        "detection_range": (1.0, 3.0),
        "upper_limit": 0.7,
        "power": 0.8,
        "size": 0.25,
        "runs_needed": 6.0,
        "indistinguishable_from": ("x",),
        "curve": np.zeros((2, 2)),
    }
    return EffectLimits(**{**given, **change})


def planned(found, run=None):
    fit = SimpleNamespace(name=lambda effect: SimpleNamespace(words=f"words of {effect.name}"))
    return plan_document(Plan(fit, False, 2.0, tuple(found), (("a", "b"),), run, "careful"))


def test_limits_are_strengths_and_torques():
    document = planned([limits("casing.air.linear")])
    (one,) = document["effects"]
    assert (one["detection_limit"], one["upper_limit"], one["size"], one["stderr"]) == (0.5, 0.7, 0.25, 0.1)
    assert (one["torque_Nm"], one["upper_torque_Nm"], one["size_Nm"]) == pytest.approx((2.0, 2.8, 1.0))
    assert one["detection_range_Nm"] == (1.0, 3.0)
    assert (one["effect"], one["words"], one["symbol"]) == (
        "casing.air.linear",
        "words of casing.air.linear",
        "k",
    )
    assert (one["kind"], one["absorbed"], one["power"], one["runs_needed"]) == ("physical", False, 0.8, 6.0)
    assert (one["indistinguishable_from"], one["shape"]) == (("x",), {"w": 3.0})
    assert document["next_run"] is None
    assert (document["size_Nm"], document["warning"], document["classes"]) == (2.0, "careful", (("a", "b"),))
    assert (document["power_wanted"], document["confidence"]) == (0.9, 0.95)


def test_an_effect_of_the_camera_has_no_torque():
    (one,) = planned([limits("camera.tilt", torque=math.nan, stderr=math.inf)])["effects"]
    assert all(math.isnan(v) for v in one["detection_range_Nm"])
    assert math.isnan(one["torque_Nm"])
    assert (one["absorbed"], one["kind"]) == (True, "measurement")


@pytest.mark.parametrize(
    ("squares", "sigmas"), [((9.0, 4.0, 16.0), (3.0, 2.0, 4.0)), ((-1.0, 0.0, 2.25), (0.0, 0.0, 1.5))]
)
def test_the_next_run_states_separations_in_standard_uncertainties(squares, sigmas):
    run = Run(400.0, -20.0, 60.0, (1.0, 30.0), 2.0, 1.5, 0.5)
    bounds = Bounds((100.0, 400.0), (-30.0, 30.0), (30.0, 120.0), reversible=False)
    separation, present, repeated = squares
    found = NextRun(
        run, bounds, (("a",), ("b", "c")), separation, present, repeated, {"a": 0.5},
        np.zeros(2), np.ones(2), np.ones(2),
        (("a", "d"),), "sentence",
    )  # fmt: skip
    one = planned([], found)["next_run"]
    assert (one["separation_sigma"], one["present_sigma"], one["repeated_sigma"]) == sigmas
    assert (one["omega_rotor"], one["omega_casing"], one["duration"]) == (400.0, -20.0, 60.0)
    assert (one["windows"], one["window_length"]) == ((1.0, 30.0), 2.0)
    assert (one["inertia_casing_ratio"], one["touchpoint_ratio"]) == (1.5, 0.5)
    assert one["detection_limit_ratio"] == {"a": 0.5}
    assert one["bounds"]["omega_rotor"] == (100.0, 400.0)
    assert one["bounds"]["reversible"] is False
    assert (one["rivals"], one["inseparable"], one["sentence"]) == (
        (("a",), ("b", "c")),
        (("a", "d"),),
        "sentence",
    )
