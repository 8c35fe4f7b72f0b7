"""Torques of friction laws along a motion, and their comparison, by small models that can be solved by hand."""

import math
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import EstimationError
from fitting.effects._library import find
from fitting.planning import _friction as module
from fitting.planning._friction import FrictionPlan, Motion, Pair, torque_along

DAHL, LUGRE = "casing.friction.presliding", "casing.friction.lugre"


def motion_of(omega, step=1e-3):
    omega = np.asarray(omega, dtype=float)
    return Motion("x", step * (np.arange(len(omega)) + 0.5), omega)


def test_the_strain_of_a_reversing_motion_is_the_solution_of_its_equation():
    """dz/dt = (omega - |omega| z) / s from rest, by many small steps."""
    time = (np.arange(480) + 0.5) * 2e-3
    omega = 0.3 * np.cos(9.0 * time)
    found = torque_along(find(DAHL), {"k": 2.0, "s": 0.05}, Motion("x", time, omega))
    z, strain, fine = 0.0, [0.0], 40
    for a, b in pairwise(omega):
        for k in range(fine):
            w = a + (b - a) * (k + 0.5) / fine
            z += (w - abs(w) * z) / 0.05 * 2e-3 / fine
        strain.append(z)
    expected = -2.0 * np.array(strain).reshape(-1, 16).mean(axis=1)
    np.testing.assert_allclose(found, expected, atol=2e-3)
    assert np.ptp(expected) > 1.0


def test_a_body_at_rest_does_not_strain_the_contact():
    assert torque_along(find(DAHL), {"k": 1.0, "s": 0.05}, motion_of(np.zeros(32))).tolist() == [0.0, 0.0]


def test_a_law_of_the_speed_is_averaged_over_sixteen_times():
    omega = np.linspace(1.0, 5.0, 48)
    found = torque_along(find("casing.air.linear"), {"b2": 0.5}, motion_of(omega))
    assert found == pytest.approx(-0.5 * omega.reshape(3, 16).mean(axis=1))


def test_trial_shapes_are_the_grid_the_start_and_the_bound_of_zero():
    for name in (DAHL, LUGRE, "touchpoint.stribeck"):
        effect = find(name)
        shapes = {p.symbol: p for p in effect.parameters if p.role == "shape"}
        found = list(module._trials(effect))
        amplitudes = {p.symbol for p in effect.parameters if p.role == "amplitude"}
        assert all(v[a] == 1.0 for v in found for a in amplitudes)
        count = 1
        for symbol, p in shapes.items():
            wanted = {*p.grid, p.start} | ({0.0} if p.lower == 0 else set())
            assert {v[symbol] for v in found} == wanted
            count *= len(wanted)
        assert len(found) == count
        typical = module._typical(effect)
        assert typical == {s: p.start for s, p in shapes.items()} | dict.fromkeys(amplitudes, 1.0)


def test_the_evidence_is_the_least_square_left_after_rival_and_simple_laws(monkeypatch):
    one, other = find(DAHL), find(LUGRE)
    rng = np.random.default_rng(0)
    starts, rows = rng.normal(size=(20, 2)), {}

    def of(effect, values, motion):
        key = effect.name, tuple(sorted(values.items()))
        return rows.setdefault(key, rng.normal(size=20))

    made = module._Responses.__new__(module._Responses)
    made._starts = starts
    monkeypatch.setattr(module._Responses, "of", lambda self, *given: of(*given))
    found = made.evidence(one, other, motion_of([1.0]), 3.0)
    target = 3.0 * rows[one.name, tuple(sorted(module._typical(one).items()))]
    simple = [rows[n, tuple(sorted(module._typical(find(n)).items()))] for n in module._ALWAYS]
    assert len(simple) == 2
    least = []
    for values in module._trials(other):
        columns = np.column_stack([starts, *simple, rows[other.name, tuple(sorted(values.items()))]])
        least.append(np.linalg.lstsq(columns, target, rcond=None)[1][0])
    assert found == pytest.approx(min(least))
    assert len(least) > 3


def _fit(estimates, torque, inertia=2.0):
    """A fit whose casing has the given net torque at each time."""
    rates = np.stack([np.full(len(torque), 9.0), np.asarray(torque) / inertia], axis=1)
    case = SimpleNamespace(
        dynamics=SimpleNamespace(rates=lambda times, y, numbers: rates),
        data=SimpleNamespace(record=SimpleNamespace(I_casing=inertia)),
    )
    prediction = SimpleNamespace(path=SimpleNamespace(mesh=SimpleNamespace(times=None), y=None))
    problem = SimpleNamespace(cases=[case], layout=SimpleNamespace(numbers=lambda theta, k: None))
    found = {k: SimpleNamespace(value=v) for k, v in estimates.items()}
    return SimpleNamespace(estimates=found, problem=problem, predictions=[prediction], theta=None)


@pytest.mark.parametrize(
    ("estimates", "strength"),
    [
        ({"touchpoint.constant.k": 0.7}, 0.7),
        ({"touchpoint.constant.k": 0.0}, 0.5),
        ({"touchpoint.constant.k": -1.0}, 0.5),
        ({"casing.air.linear.b2": 0.7}, 0.5),
        ({}, 0.5),
    ],
)
def test_the_strength_is_the_dry_friction_or_a_tenth_of_the_torque(estimates, strength):
    assert module._ALWAYS[0] == "touchpoint.constant"
    assert module._strength(_fit(estimates, [1.0, -7.0])) == pytest.approx(strength)


def test_without_a_torque_there_is_no_strength():
    with pytest.raises(EstimationError, match="no torque"):
        module._strength(_fit({}, [0.0, 0.0]))


PAIRS = (
    Pair("a", "b", {"recording": 5.0, "reversals": 9.0, "ramp": 0.0}),
    Pair("a", "c", {"recording": 1.0, "reversals": 9.0, "ramp": 0.0}),
    Pair("b", "a", {"recording": 4.0, "reversals": 4.1, "ramp": 4.0}),
    Pair("b", "c", {"recording": 1.0, "reversals": 0.0, "ramp": 4.2}),
    Pair("c", "a", {"recording": 1.0, "reversals": 3.9, "ramp": 0.0}),
    Pair("c", "b", {"recording": 4.0, "reversals": 0.0, "ramp": 0.0}),
)


def test_pairs_are_separated_above_the_width():
    plan = FrictionPlan(0.25, "N m", PAIRS, 4.0, 0.5, 3.0)
    lines = plan.sentences
    assert lines[0] == "This recording separates 1 of 6 pairs of friction laws (dry friction 0.25 N m)."
    assert lines[1].endswith("separates a from c; b from a.")
    assert "10 reversals" in lines[1]
    assert "0.5 rad" in lines[1]
    assert lines[2].endswith("separates b from c.")
    assert "3 rad/s" in lines[2]
    assert lines[3].endswith("separates c from a, b.")
    assert len(lines) == 4
    document = plan.document()
    assert [p["separated_by"] for p in document["pairs"]] == [
        ["recording", "reversals"],
        ["reversals"],
        ["reversals"],
        ["ramp"],
        [],
        [],
    ]
    assert document["strength"] == {"value": 0.25, "unit": "N m"}
    assert (document["width"], document["pairs"][3]["law"], document["pairs"][3]["rival"]) == (4.0, "b", "c")


def test_motions_have_the_times_of_the_recording(monkeypatch):
    """Ten reversals of an amplitude of four pre-sliding angles, and a ramp to the median speed."""
    seen = {}

    class Responses:
        edges = np.array([2.0, 3.0, 5.0, 6.0])

        def __init__(self, fit):
            pass

        def evidence(self, one, other, motion, strength):
            seen[motion.name] = motion
            assert strength == 0.3
            return 1.0

    speeds = lambda t: -4.0 + t  # noqa: E731
    monkeypatch.setattr(module, "_Responses", Responses)
    monkeypatch.setattr(module, "_strength", lambda _: 0.3)
    monkeypatch.setattr(module, "scales_of", lambda _: (1.0, 1.0))
    monkeypatch.setattr(module, "Sampler", lambda mesh, times: SimpleNamespace(value=lambda y: speeds(times)))
    path = SimpleNamespace(mesh=None, y=np.zeros((1, 2)), states=("phi", "omega_c"))
    fit = SimpleNamespace(
        problem=SimpleNamespace(layout=SimpleNamespace(records=())),
        predictions=[SimpleNamespace(path=path)],
        torque_unit="N m",
    )
    effects = {n: find(n) for n in module.FRICTION}
    contacts = [n for n, e in effects.items() if e.contact]
    assert len(contacts) > 1

    def scaled(name):
        # the largest pre-sliding angle of a contact is 0.02 rad
        start = 0.02 / (1 + contacts.index(name)) if name in contacts else 0.5
        parameters = [SimpleNamespace(symbol="s", role="shape", start=start)]
        return SimpleNamespace(name=name, contact=name in contacts, parameters_at=lambda *_: parameters)

    monkeypatch.setattr(module, "find", scaled)
    monkeypatch.setattr(
        module, "replace", lambda e, parameters: SimpleNamespace(**{**vars(e), "parameters": parameters})
    )
    plan = module.friction_plan(fit, criteria=SimpleNamespace(equivalence_width=7.5))
    assert (plan.width, plan.strength, plan.unit) == (7.5, 0.3, "N m")
    time = seen["recording"].time
    assert len(time) == 48
    assert time[:2] == pytest.approx([2.0 + 1 / 32, 2.0 + 3 / 32])
    assert time[16:18] == pytest.approx([3.0 + 2 / 32, 3.0 + 6 / 32])
    assert seen["recording"].omega == pytest.approx(speeds(time))
    assert plan.amplitude == pytest.approx(0.08)
    assert plan.ramp == pytest.approx(float(np.median(np.abs(speeds(time)))))
    turning = 10.0 * math.pi / 4.0
    assert seen["reversals"].omega == pytest.approx(0.08 * turning * np.cos(turning * (time - 2.0)))
    assert seen["ramp"].omega == pytest.approx(plan.ramp * (time - 2.0) / 4.0)
    count = len(module.FRICTION) - 2
    assert len(plan.pairs) == count * (count - 1)
    assert all(p.first != p.second for p in plan.pairs)
