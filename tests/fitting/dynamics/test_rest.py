"""A casing that stops, is held, reverses and starts again, against formulas and SciPy's event location."""

import numpy as np
import pytest
from reference import I_C, INERTIA, PAPER, integrate_through_rest

from fitting import Model
from fitting.dynamics._collocation import Mesh, Sampler
from fitting.dynamics._events import solve
from fitting.dynamics._model import Dynamics
from fitting.dynamics._sensitivities import LinearMotion, angles, sensitivities

START = (900.0, 5.0)
# what happens, parameters beside the paper's, start, length [s]
CASES = {
    "stops": ({"touchpoint.constant.b1": 1.2e-4}, START, 200.0),
    "stops early": ({"touchpoint.constant.b1": 2.2e-4}, START, 60.0),
    "sharp end": (
        {"touchpoint.constant.b1": 9e-5, "touchpoint.stribeck.k": 6e-5, "touchpoint.stribeck.w": 2.0},
        START,
        200.0,
    ),
    "freed by time": (
        {"touchpoint.constant.b1": 2.6e-4, "touchpoint.drift.k": -1.1e-6},
        START,
        200.0,
    ),
    "freed by a step": (
        {"touchpoint.constant.b1": 1.5e-4, "touchpoint.step.k": -9e-5, "touchpoint.step.t0": 150.25},
        START,
        200.0,
    ),
    "stopped by a step": (
        {"touchpoint.step.k": 3e-4, "touchpoint.step.t0": 61.237},
        START,
        90.0,
    ),
    "turned round": ({"touchpoint.constant.b1": 2e-5}, (900.0, -40.0), 60.0),
    "from rest": ({"touchpoint.constant.b1": 2e-5}, (900.0, 0.0), 60.0),
    "held and heated": (
        {"touchpoint.constant.b1": 1.2e-4, "bearing.heating.k": 0.06, "bearing.heating.tau_T": 40.0},
        START,
        150.0,
    ),
    "curved drag": ({"touchpoint.constant.b1": 1.2e-4, "casing.air.laminar.k": 2e-8}, START, 200.0),
    "everything backwards": ({"touchpoint.constant.b1": 1.2e-4}, (-900.0, -5.0), 200.0),
}
ANGLES = {
    # a bowl-like torque: the casing swings to and fro and is caught by friction
    "rocking": (
        {"touchpoint.constant.b1": 1.2e-4, "casing.unbalance.k": 3e-4, "casing.unbalance.phi": 0.4},
        (300.0, 9.0),
        12.0,
    ),
}


def solved(name):
    own, start, span = (CASES | ANGLES)[name]
    p = PAPER | own
    model = Model.of(dict.fromkeys(k.rpartition(".")[0] for k in p))
    dynamics = Dynamics(model, angles=name in ANGLES)
    numbers = {**p, **INERTIA, **dynamics.constants}
    first = np.array([*start, *dynamics.start, *((0.0, 0.0) if name in ANGLES else ())])
    return p, start, span, dynamics, numbers, solve(dynamics, numbers, first, Mesh.uniform(0.0, span, 12))


@pytest.mark.parametrize("name", [*CASES, *ANGLES])
def test_speeds_angles_and_events_agree_with_scipy(name):
    p, start, span, _, _, path = solved(name)
    times = np.linspace(0, span, 1501)
    exact, events = integrate_through_rest(p, start, times)
    jumps = [t for t in path.kinks if t != p.get("touchpoint.step.t0")]
    expected = [t for t, _ in events if 0 < t != p.get("touchpoint.step.t0")]
    assert events
    np.testing.assert_allclose(jumps, expected, atol=1e-7)
    sampler = Sampler(path.mesh, times)
    found = sampler.value(path.y)
    for i, state in enumerate(("omega_r", "omega_c")):
        assert np.abs(found[:, i] - exact[i]).max() < 1e-6
        assert np.abs(sampler.integral(*path.angle(state)) - exact[3 + i]).max() < 1e-5
    held = exact[1] == 0
    assert (found[held & (times > 0), 1] == 0).all()


@pytest.mark.parametrize("b1", [2e-6, 3.7e-5])
@pytest.mark.parametrize("start", [5.0, -140.0])
def test_dry_friction_alone_stops_at_the_time_of_the_formula(b1, start):
    """omega_c = w - b1 t / I_c until t = I_c w / b1, and rest from then on."""
    dynamics = Dynamics(Model.of(["touchpoint.constant"]))
    stop = I_C * abs(start) / b1
    numbers = {"touchpoint.constant.b1": b1, **INERTIA}
    path = solve(dynamics, numbers, np.array([900.0, start]), Mesh.uniform(0.0, 1.4 * stop, 7))
    assert path.kinks == pytest.approx((stop,), rel=1e-12)
    assert path.angle("omega_c")[0][-1] == pytest.approx(0.5 * start * stop, rel=1e-12)
    assert (path.edges[:, 0] == 900.0).all()
    # the angle at rest is I_c w^2 / (2 b1): its derivatives follow
    found = sensitivities(dynamics, numbers, path)
    sampler = Sampler(path.mesh, np.array([1.3 * stop]))
    turned = angles(sampler, path, 1, found.nodes)[0]
    turn = 0.5 * I_C * start * abs(start) / b1
    assert turned[0] == pytest.approx(-turn / b1, rel=1e-9)
    assert turned[2] == pytest.approx(I_C * abs(start) / b1, rel=1e-9)


def test_rest_has_no_repeated_events():
    path = solved("stops")[-1]
    assert len(path.mesh.edges) < 40
    assert list(np.unique(path.sense)) == [0.0, 1.0]
    assert len(path.kinks) == 1


def test_a_casing_held_by_friction_remains_at_rest():
    dynamics = Dynamics(Model.of(["touchpoint.constant", "bearing.linear"]))
    numbers = {"touchpoint.constant.b1": 2e-4, "bearing.linear.d": 1.57e-7, **INERTIA}
    path = solve(dynamics, numbers, np.array([900.0, 0.0]), Mesh.uniform(0.0, 100.0, 5))
    assert (path.y[..., 1] == 0).all()
    # the rotor alone: omega_r = 900 exp(-d t / I_r)
    assert path.edges[-1, 0] == pytest.approx(
        900 * np.exp(-1.57e-7 * 100 / INERTIA["inertia.rotor"]), rel=1e-10
    )


def difference(name, key, times):
    own, start, _ = (CASES | ANGLES)[name]
    p = PAPER | own
    step = (1e-4 if name in ANGLES else 1e-3) * abs(p.get(key, 10.0))

    def at(shift):
        begin, changed = list(start), dict(p)
        if key.startswith("start"):
            begin[int(key[-1])] += shift
        else:
            changed[key] += shift
        return integrate_through_rest(changed, begin, times, rtol=1e-13)[0]

    return (8 * (at(step) - at(-step)) - (at(2 * step) - at(-2 * step))) / (12 * step)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["stops", "freed by time", "turned round", "stopped by a step", "held and heated"]
)
@pytest.mark.release
def test_sensitivities_match_differences_across_events(name):
    _, _, span, dynamics, numbers, path = solved(name)
    found = sensitivities(dynamics, numbers, path)
    times = np.linspace(0.5, span, 60)
    # the difference across an event is no derivative
    for kink in path.kinks:
        times = times[np.abs(times - kink) > 1.0]
    sampler = Sampler(path.mesh, times)
    speeds = sampler.value(found.nodes)
    keys = [*dynamics.parameters, "start0", "start1"]
    for j, key in enumerate(keys):
        exact = difference(name, key, times)
        for body in (0, 1):
            size = np.abs(exact[body]).max()
            np.testing.assert_allclose(speeds[:, body, j], exact[body], atol=3e-5 * size + 1e-9, err_msg=key)
            size = np.abs(exact[3 + body]).max()
            turned = angles(sampler, path, body, found.nodes)[:, j]
            np.testing.assert_allclose(turned, exact[3 + body], atol=3e-5 * size + 1e-9, err_msg=key)


def test_small_torques_act_on_a_moving_casing_only():
    """A torque on the casing acts before and after, not while friction holds it."""
    p, start, _, dynamics, numbers, path = solved("freed by time")
    stop, go = path.kinks
    times = np.linspace(0, 200, 20_001)
    push = 2e-8
    found = sensitivities(dynamics, numbers, path)
    motion = LinearMotion(path, found.propagator)
    more, less = (
        integrate_through_rest(p | {"external.constant.k": k}, start, times, rtol=1e-13)[0]
        for k in (push, -push)
    )
    exact = (more - less) / (2 * push)
    half = 0.5 * np.diff(times)
    unit = np.ones((len(half), 3, 1))
    driven, turned = (v[1] for v in motion.driven(times, unit.shape[1], np.array([0.0, 1 / I_C]))(unit))
    away = (np.abs(times - stop) > 2) & (np.abs(times - go) > 2)
    size = np.abs(exact[1]).max()
    np.testing.assert_allclose(driven[away, 0], exact[1][away], atol=2e-3 * size)
    np.testing.assert_allclose(turned[away, 0], exact[4][away], atol=2e-3 * np.abs(exact[4]).max())
    resting = (times > stop + 2) & (times < go - 2)
    assert np.abs(driven[resting]).max() < 1e-4 * size
    assert (motion.moving(times[resting]) == 0).all()


@pytest.mark.parametrize(
    "name", ["stops", "freed by time", "stopped by a step", "held and heated", "turned round"]
)
def test_the_solution_does_not_depend_on_a_known_motion(name):
    """From the solution for other numbers, with other times of stop and jump, and from one that never stops."""
    p, start, span, dynamics, numbers, path = solved(name)
    mesh, first = Mesh.uniform(0.0, span, 12), np.array([*start, *dynamics.start])
    times = np.linspace(0, span, 701)
    exact = Sampler(path.mesh, times).value(path.y)
    changed = {k: v * (1.04 if k.endswith((".b1", ".t0")) else 0.97) for k, v in p.items()}
    free = {k: 0.0 if k.startswith("touchpoint") and not k.endswith("t0") else v for k, v in p.items()}
    for other in (changed, free):
        guess = solve(dynamics, numbers | other, first, mesh)
        found = solve(dynamics, numbers, first, mesh, guess)
        np.testing.assert_allclose(found.kinks, path.kinks, atol=1e-8)
        # a law set in or a casing stopped in between: there a sampler takes one side or the other
        away = np.abs(times[:, None] - np.array(path.kinks)).min(axis=1) > 1e-6
        scale = np.abs(exact).max(axis=0)
        assert (np.abs(Sampler(found.mesh, times).value(found.y) - exact)[away] < 1e-9 * scale).all()
