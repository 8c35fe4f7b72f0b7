"""Which laws of friction a motion separates: limits that follow from the laws, and models solved by hand."""

import math
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import Case, EstimationError, fit
from fitting.effects._library import find
from fitting.planning import _friction
from fitting.planning._friction import FrictionPlan, Motion, Pair, friction_plan, torque_along

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
        found = list(_friction._trials(effect))
        amplitudes = {p.symbol for p in effect.parameters if p.role == "amplitude"}
        assert all(v[a] == 1.0 for v in found for a in amplitudes)
        count = 1
        for symbol, p in shapes.items():
            wanted = {*p.grid, p.start} | ({0.0} if p.lower == 0 else set())
            assert {v[symbol] for v in found} == wanted
            count *= len(wanted)
        assert len(found) == count
        typical = _friction._typical(effect)
        assert typical == {s: p.start for s, p in shapes.items()} | dict.fromkeys(amplitudes, 1.0)


def test_the_evidence_is_the_least_square_left_after_rival_and_simple_laws(monkeypatch):
    one, other = find(DAHL), find(LUGRE)
    rng = np.random.default_rng(0)
    starts, rows = rng.normal(size=(20, 2)), {}

    def of(effect, values, motion):
        key = effect.name, tuple(sorted(values.items()))
        return rows.setdefault(key, rng.normal(size=20))

    made = _friction._Responses.__new__(_friction._Responses)
    made._starts = starts
    monkeypatch.setattr(_friction._Responses, "of", lambda self, *given: of(*given))
    found = made.evidence(one, other, motion_of([1.0]), 3.0)
    target = 3.0 * rows[one.name, tuple(sorted(_friction._typical(one).items()))]
    simple = [rows[n, tuple(sorted(_friction._typical(find(n)).items()))] for n in _friction._ALWAYS]
    assert len(simple) == 2
    least = []
    for values in _friction._trials(other):
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
    assert _friction._ALWAYS[0] == "touchpoint.constant"
    assert _friction._strength(_fit(estimates, [1.0, -7.0])) == pytest.approx(strength)


def test_without_a_torque_there_is_no_strength():
    with pytest.raises(EstimationError, match="no torque"):
        _friction._strength(_fit({}, [0.0, 0.0]))


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
    monkeypatch.setattr(_friction, "_Responses", Responses)
    monkeypatch.setattr(_friction, "_strength", lambda _: 0.3)
    monkeypatch.setattr(_friction, "scales_of", lambda _: (1.0, 1.0))
    monkeypatch.setattr(
        _friction, "Sampler", lambda mesh, times: SimpleNamespace(value=lambda y: speeds(times))
    )
    path = SimpleNamespace(mesh=None, y=np.zeros((1, 2)), states=("phi", "omega_c"))
    fit = SimpleNamespace(
        problem=SimpleNamespace(layout=SimpleNamespace(records=())),
        predictions=[SimpleNamespace(path=path)],
        torque_unit="N m",
    )
    effects = {n: find(n) for n in _friction.FRICTION}
    contacts = [n for n, e in effects.items() if e.contact]
    assert len(contacts) > 1

    def scaled(name):
        # the largest pre-sliding angle of a contact is 0.02 rad
        start = 0.02 / (1 + contacts.index(name)) if name in contacts else 0.5
        parameters = [SimpleNamespace(symbol="s", role="shape", start=start)]
        return SimpleNamespace(name=name, contact=name in contacts, parameters_at=lambda *_: parameters)

    monkeypatch.setattr(_friction, "find", scaled)
    monkeypatch.setattr(
        _friction, "replace", lambda e, parameters: SimpleNamespace(**{**vars(e), "parameters": parameters})
    )
    plan = _friction.friction_plan(fit, criteria=SimpleNamespace(equivalence_width=7.5))
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
    count = len(_friction.FRICTION) - 2
    assert len(plan.pairs) == count * (count - 1)
    assert all(p.first != p.second for p in plan.pairs)
