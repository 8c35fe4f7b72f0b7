"""Sensitivities and linearised motions against differences of SciPy's solutions."""

import numpy as np
import pytest
from reference import EXTRA, INERTIA, PAPER, integrate
from scipy.integrate import solve_ivp

from fitting import Model
from fitting.dynamics._collocation import Mesh, Sampler, rule
from fitting.dynamics._events import solve
from fitting.dynamics._model import Dynamics
from fitting.dynamics._sensitivities import LinearMotion, angles, sensitivities

TIMES = np.linspace(0, 150, 301)
START = (900.0, 5.0)


def solved(p, span=150.0, follow=False):
    model = Model.of(dict.fromkeys(k.rpartition(".")[0] for k in p))
    dynamics = Dynamics(model, angles=follow)
    numbers = {**p, **INERTIA, **dynamics.constants}
    first = np.array([*START, *dynamics.start, *((0.0, 0.0) if follow else ())])
    return dynamics, numbers, solve(dynamics, numbers, first, Mesh.uniform(0.0, span, 12))


def difference(p, key, times):
    """Return the derivative of all states by a parameter or a start speed, by fourth-order differences."""
    # what oscillates changes its phase by many times the change of a parameter
    share = 3e-4 if "precession" in str(p) else 2e-5 if "unbalance" in str(p) else 3e-3
    step = share * abs(p.get(key, 10.0))
    if key.endswith((".t0", ".phi")):
        step = 0.02

    def at(shift):
        start, changed = list(START), dict(p)
        if key.startswith("start"):
            start[int(key[-1])] += shift
        else:
            changed[key] += shift
        return integrate(changed, start, times, rtol=1e-13, max_step=0.5)

    return (8 * (at(step) - at(-step)) - (at(2 * step) - at(-2 * step))) / (12 * step)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["none", "general", "stribeck", "step", "heating", "precession", "drift"])
@pytest.mark.release
def test_sensitivities_match_differences(name):
    p = PAPER | EXTRA[name]
    dynamics, numbers, path = solved(p)
    found = sensitivities(dynamics, numbers, path)
    # a difference across the jump itself is no derivative
    times = TIMES[np.abs(TIMES - p.get("touchpoint.step.t0", -1)) > 0.05]
    times = times[times <= (50 if name == "precession" else 150)]
    sampler = Sampler(path.mesh, times)
    speeds = sampler.value(found.nodes)
    keys = [*dynamics.parameters, "start0", "start1"]
    assert speeds.shape[2] == len(keys)
    for j, key in enumerate(keys):
        exact = difference(p, key, times)
        for body in (0, 1):
            size = np.abs(exact[body]).max()
            np.testing.assert_allclose(speeds[:, body, j], exact[body], atol=1e-6 * size + 1e-9, err_msg=key)
            turned = angles(sampler, path, body, found.nodes)[:, j]
            np.testing.assert_allclose(
                turned, exact[3 + body], atol=1e-6 * np.abs(exact[3 + body]).max() + 1e-9
            )


@pytest.mark.slow
def test_sensitivities_of_a_law_that_follows_the_angle():
    p = PAPER | EXTRA["unbalance"]
    dynamics, numbers, path = solved(p, span=4.0, follow=True)
    found = sensitivities(dynamics, numbers, path)
    times = np.linspace(0, 4, 201)
    speeds = Sampler(path.mesh, times).value(found.nodes)
    for key in ("casing.unbalance.k", "casing.unbalance.phi", "bearing.linear.d"):
        exact = difference(p, key, times)[1]
        got = speeds[:, 1, dynamics.parameters.index(key)]
        np.testing.assert_allclose(got, exact, atol=1e-5 * np.abs(exact).max())


def test_derivative_with_respect_to_the_time_of_a_jump_is_the_jump_of_the_rate():
    """Right after the jump, d omega_c / d t0 = k / I_c: a later jump brakes the casing later."""
    p = PAPER | EXTRA["step"]
    dynamics, numbers, path = solved(p)
    found = sensitivities(dynamics, numbers, path)
    j = dynamics.parameters.index("touchpoint.step.t0")
    edge = int(np.searchsorted(path.mesh.edges, p["touchpoint.step.t0"]))
    assert found.edges[edge][1, j] == pytest.approx(
        p["touchpoint.step.k"] / INERTIA["inertia.casing"], rel=1e-9
    )
    assert np.abs(found.edges[:edge, :, j]).max() == 0


def jacobian(p, wr, wc):
    """The linearised speeds, by hand."""
    i_r, i_c = INERTIA["inertia.rotor"], INERTIA["inertia.casing"]
    diff = wr - wc
    stiff = p["bearing.linear.d"] + p["bearing.power.f"] * p["bearing.power.g"] * diff ** (
        p["bearing.power.g"] - 1
    )
    rotor = [(-stiff - 2 * p["rotor.air.quadratic.a2"] * wr) / i_r, stiff / i_r]
    return np.array([rotor, [stiff / i_c, (-stiff - p["casing.air.linear.b2"]) / i_c]])


def directly(p, path, torque, direction, times):
    """Integrate d(dy)/dt = A dy + b u by SciPy; return speeds and angles, (times, 4)."""
    knots = np.linspace(0, 150, 15_001)
    wr, wc = Sampler(path.mesh, knots).value(path.y)[:, :2].T

    def rates(t, y):
        a = jacobian(p, np.interp(t, knots, wr), np.interp(t, knots, wc))
        return [*(a @ y[:2] + direction * torque(t)), y[0], y[1]]

    return solve_ivp(
        rates,
        (0, times[-1]),
        np.zeros(4),
        method="DOP853",
        rtol=1e-9,
        atol=1e-14,
        t_eval=times,
        max_step=0.1,
    ).y.T


@pytest.mark.parametrize("body", [0, 1], ids=["rotor", "casing"])
def test_driven_motion_matches_direct_integration(body):
    """A fast torque of 3 to 40 rad/s on the casing, and the response of both bodies."""
    dynamics, numbers, path = solved(PAPER)
    motion = LinearMotion(path, sensitivities(dynamics, numbers, path).propagator)

    def torque(t):
        return 1e-5 * np.sin(3 * t + 0.2 * t * t) + 2e-6

    times = np.arange(0, 40.0, 1 / 50)
    direction = np.array([-1 / INERTIA["inertia.rotor"], 1 / INERTIA["inertia.casing"]])
    gauss, half = rule(3), 0.5 * np.diff(times)
    inner = (times[:-1] + half)[:, None] + half[:, None] * gauss.x
    both = np.stack([torque(inner), np.ones_like(inner) * 1e-6], axis=-1)
    speed, angle = (v[body] for v in motion.driven(times, both.shape[1], direction)(both))
    exact = directly(PAPER, path, torque, direction, times)
    np.testing.assert_allclose(speed[:, 0], exact[:, body], atol=1e-5 * np.abs(exact[:, body]).max())
    np.testing.assert_allclose(angle[:, 0], exact[:, 2 + body], atol=1e-5 * np.abs(exact[:, 2 + body]).max())
    steady = directly(PAPER, path, lambda t: 1e-6, direction, times)
    np.testing.assert_allclose(speed[:, 1], steady[:, body], atol=1e-6 * np.abs(steady[:, body]).max())
    np.testing.assert_allclose(
        angle[:, 1], steady[:, 2 + body], atol=1e-6 * np.abs(steady[:, 2 + body]).max()
    )


def test_the_fundamental_matrix_is_the_derivative_with_respect_to_initial_values():
    dynamics, numbers, path = solved(PAPER)
    found = sensitivities(dynamics, numbers, path)
    motion = LinearMotion(path, found.propagator)
    np.testing.assert_allclose(motion.fundamental(np.array([0.0]))[0], np.eye(2), atol=1e-8)
    np.testing.assert_allclose(
        motion.fundamental(TIMES), Sampler(path.mesh, TIMES).value(found.nodes)[:, :2, -2:], atol=1e-12
    )
    np.testing.assert_allclose(motion.integrated(np.array([0.0]))[0], 0, atol=1e-10)


@pytest.mark.parametrize("name", ["heating", "precession"])
def test_driven_motion_contains_the_states_of_effects(name):
    """A temperature, or the phase of a sinusoidal torque, is coupled with the speeds."""
    p = PAPER | EXTRA[name] | {"external.constant.k": 1e-9}
    dynamics, numbers, path = solved(p)
    found = sensitivities(dynamics, numbers, path)
    motion = LinearMotion(path, found.propagator)
    times = np.arange(0, 150.0, 1 / 50)
    unit = np.ones((len(times) - 1, 3, 1))
    speed, _ = motion.driven(times, unit.shape[1], np.array([0.0, 1 / INERTIA["inertia.casing"]]))(unit)
    exact = Sampler(path.mesh, times).value(
        found.nodes[..., dynamics.parameters.index("external.constant.k")]
    )
    for body in (0, 1):
        size = np.abs(exact[:, body]).max()
        np.testing.assert_allclose(speed[body, :, 0], exact[:, body], atol=1e-5 * size)


def test_a_state_that_decays_fast_is_held():
    p = PAPER | EXTRA["heating"] | {"bearing.heating.tau_T": 0.5}
    dynamics, numbers, path = solved(p)
    motion = LinearMotion(path, sensitivities(dynamics, numbers, path).propagator)
    impulses = motion.impulses(TIMES, np.array([0.0, 1 / INERTIA["inertia.casing"]]))
    assert impulses.shape == (len(TIMES), 2)
    assert np.isfinite(impulses).all()


@pytest.mark.parametrize("name", ["none", "heating"])
def test_driven_motion_of_a_light_casing_is_accurate_until_the_end(name):
    """After forty relaxation times of the casing, the response to a torque is that of the derivative by it."""
    p = PAPER | EXTRA[name] | {"external.constant.k": 1e-9}
    dynamics = Dynamics(Model.of(dict.fromkeys(k.rpartition(".")[0] for k in p)))
    light = INERTIA | {"inertia.casing": 4e-6}
    numbers = {**p, **light, **dynamics.constants}
    path = solve(dynamics, numbers, np.array([*START, *dynamics.start]), Mesh.uniform(0.0, 150.0, 12))
    found = sensitivities(dynamics, numbers, path)
    motion = LinearMotion(path, found.propagator)
    times = np.arange(0, 150.0, 1 / 50)
    unit = np.ones((len(times) - 1, 3, 1))
    speed, angle = motion.driven(times, unit.shape[1], np.array([0.0, 1 / light["inertia.casing"]]))(unit)
    sampler = Sampler(path.mesh, times)
    column = dynamics.parameters.index("external.constant.k")
    exact = sampler.value(found.nodes[..., column])[:, 1]
    turned = angles(sampler, path, 1, found.nodes)[:, column]
    # a warmth that is held does not delay the answer
    near = 1e-3 if name == "none" else 0.05
    np.testing.assert_allclose(speed[1, :, 0], exact, atol=near * np.abs(exact).max())
    np.testing.assert_allclose(angle[1, :, 0], turned, atol=near * np.abs(turned).max())
