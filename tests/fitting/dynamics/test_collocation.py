"""Collocation against SciPy at a hundred times tighter tolerance, and against an exact solution."""

import pickle

import numpy as np
import pytest
from reference import EXTRA, INERTIA, PAPER, integrate
from scipy.linalg import expm

from fitting import Model, SimulationError
from fitting.dynamics._collocation import Mesh, Sampler, rule
from fitting.dynamics._events import solve
from fitting.dynamics._model import Dynamics

TIMES = np.linspace(0, 200, 1501)


def model_of(p):
    return Model.of(dict.fromkeys(k.rpartition(".")[0] for k in p))


def path_of(p, start=(900.0, 5.0), span=200.0, intervals=12, angles=False):
    dynamics = Dynamics(model_of(p), angles=angles)
    first = np.array([*start, *dynamics.start, *((0.0, 0.0) if angles else ())])
    return solve(dynamics, {**p, **INERTIA}, first, Mesh.uniform(0.0, span, intervals))


def check(p, path, times, start=(900.0, 5.0), tolerance=1e-6):
    exact = integrate(p, start, times)
    sampler = Sampler(path.mesh, times)
    found = sampler.value(path.y)
    for i, body in enumerate(("rotor", "casing")):
        error = np.abs(found[:, i] - exact[i]).max()
        assert error < tolerance, f"{body}: {error:.1e} rad/s"
        angle = sampler.integral(*path.angle(path.states[i]))
        assert np.abs(angle - exact[3 + i]).max() < 1e-5


@pytest.mark.parametrize(
    "name", ["none", "general", "stribeck", "step", "heating", "precession", "drift", "air"]
)
def test_speeds_and_angles_agree_with_scipy(name):
    p = PAPER | EXTRA[name]
    path = path_of(p)
    check(p, path, TIMES)
    own = [s for s in path.states if s not in {"omega_r", "omega_c"}]
    if own:
        exact = integrate(p, (900.0, 5.0), TIMES)[2]
        found = Sampler(path.mesh, TIMES).value(path.y)[:, 2]
        assert np.abs(found - exact).max() < 1e-7 * np.abs(exact).max()


@pytest.mark.parametrize("name", ["unbalance", "none"])
def test_models_of_an_angle_agree_with_scipy(name):
    p = PAPER | EXTRA[name]
    times = np.linspace(0, 12, 2001)
    path = path_of(p, start=(900.0, 30.0), span=12.0, angles=True)
    check(p, path, times, start=(900.0, 30.0))
    exact = integrate(p, (900.0, 30.0), times)
    found = Sampler(path.mesh, times).value(path.y)
    assert np.abs(found[:, path.states.index("psi_c")] - exact[4]).max() < 1e-6


def test_a_sharp_law_gets_more_intervals_where_it_is_sharp():
    calm, sharp = path_of(PAPER), path_of(PAPER | EXTRA["stribeck"])
    assert len(sharp.mesh.edges) > len(calm.mesh.edges)
    new = np.setdiff1d(sharp.mesh.edges, calm.mesh.edges)
    speed = Sampler(sharp.mesh, new).value(sharp.y)[:, 1]
    assert np.median(speed) < 60


@pytest.mark.parametrize("intervals", [1, 3, 40])
def test_the_first_mesh_does_not_matter(intervals):
    p = PAPER | EXTRA["stribeck"]
    check(p, path_of(p, intervals=intervals), TIMES)


def test_a_jump_is_at_an_edge():
    path = path_of(PAPER | EXTRA["step"])
    assert 61.237 in path.mesh.edges
    assert path.kinks == (61.237,)


def test_a_jump_outside_the_record_is_not_an_edge():
    path = path_of(PAPER | EXTRA["step"] | {"touchpoint.step.t0": 300.0})
    assert path.kinks == ()
    check(PAPER, path, TIMES)


def test_the_initial_solution_does_not_change_the_solution():
    dynamics = Dynamics(model_of(PAPER))
    numbers = {**PAPER, **INERTIA}
    mesh, first = Mesh.uniform(0.0, 200.0, 12), np.array([900.0, 5.0])
    guess = solve(dynamics, {**numbers, "bearing.linear.d": 2e-7}, np.array([850.0, 9.0]), mesh)
    check(PAPER, solve(dynamics, numbers, first, mesh, guess), TIMES)


def test_the_linear_model_agrees_with_the_matrix_exponential():
    a1, b1, b2, d = 4e-8, 2.88e-6, 8.28e-7, 1.9e-7
    p = {
        "rotor.air.linear.a1": a1,
        "touchpoint.constant.b1": b1,
        "casing.air.linear.b2": b2,
        "bearing.linear.d": d,
    }
    path = path_of(p)
    i_r, i_c = INERTIA["inertia.rotor"], INERTIA["inertia.casing"]
    matrix = np.array([[-(d + a1) / i_r, d / i_r], [d / i_c, -(d + b2) / i_c]])
    rest = np.linalg.solve(matrix, [0.0, b1 / i_c])
    exact = np.array([rest + expm(matrix * t) @ (np.array([900.0, 5.0]) - rest) for t in TIMES[::50]])
    assert exact[:, 1].min() > 0
    found = Sampler(path.mesh, TIMES[::50]).value(path.y)
    np.testing.assert_allclose(found, exact, rtol=1e-9)
    # and its integral: psi = rest t + A^-1 (exp(A t) - 1) (y0 - rest)
    swing = np.array(
        [np.linalg.solve(matrix, (expm(matrix * t) - np.eye(2)) @ ([900.0, 5.0] - rest)) for t in TIMES[::50]]
    )
    for i, state in enumerate(("omega_r", "omega_c")):
        angle = Sampler(path.mesh, TIMES[::50]).integral(*path.angle(state))
        np.testing.assert_allclose(angle, rest[i] * TIMES[::50] + swing[:, i], rtol=1e-9, atol=1e-8)


def test_order_of_the_rule():
    gauss = rule(10)
    for power in range(20):
        exact = (1 - (-1) ** (power + 1)) / (power + 1)
        assert gauss.w @ gauss.x**power == pytest.approx(exact, abs=1e-14)
    for power in range(10):
        exact = (gauss.x ** (power + 1) - (-1) ** (power + 1)) / (power + 1)
        np.testing.assert_allclose(gauss.s @ gauss.x**power, exact, atol=1e-14)


def test_sampler_is_exact_for_polynomials():
    mesh = Mesh.uniform(2.0, 7.0, 4).with_breakpoints([3.3])
    assert len(mesh.edges) == 6
    coefficients = np.random.default_rng(0).normal(size=9)
    poly = np.polynomial.Polynomial(coefficients, domain=[2, 7])
    times = np.linspace(2, 7, 101)
    sampler = Sampler(mesh, times)
    np.testing.assert_allclose(sampler.value(poly(mesh.times)), poly(times), rtol=1e-10, atol=1e-12)
    integral = poly.integ(lbnd=2.0)
    np.testing.assert_allclose(
        sampler.integral(integral(mesh.edges), poly(mesh.times)), integral(times), rtol=1e-10, atol=1e-11
    )


def test_motion_without_bound_is_an_error_and_no_crash():
    p = PAPER | {"casing.air.quadratic.k": -1e-5}
    with pytest.raises(SimulationError):
        path_of(p)


def test_a_mesh_that_had_to_be_fine_becomes_coarse_again():
    """From the solution of a sharp law to that of a smooth one: unnecessary edges are removed."""
    p = PAPER | EXTRA["stribeck"] | {"touchpoint.stribeck.w": 0.5}
    dynamics = Dynamics(model_of(p))
    first, mesh = np.array([900.0, 5.0]), Mesh.uniform(0.0, 200.0, 12)
    path = solve(dynamics, {**p, **INERTIA}, first, mesh)
    fine = len(path.y)
    smooth = PAPER | {"touchpoint.stribeck.k": 0.0, "touchpoint.stribeck.w": 0.5}
    for _ in range(6):
        path = solve(dynamics, {**smooth, **INERTIA}, first, mesh, path)
    assert len(path.y) <= 1 + len(path_of(PAPER).y) < fine
    check(PAPER, path, TIMES)


@pytest.mark.parametrize(("intervals", "solved"), [(14, False), (200, True)])
def test_a_solution_has_at_most_the_stated_number_of_intervals(intervals, solved):
    """A speed that decays within two seconds of two hundred needs more than the twelve intervals of the mesh."""
    p = {"casing.air.linear.b2": 0.5 * INERTIA["inertia.casing"]}
    dynamics, mesh = Dynamics(model_of(p)), Mesh.uniform(0.0, 200.0, 12)
    if solved:
        path = solve(dynamics, {**p, **INERTIA}, np.array([900.0, 5.0]), mesh, intervals=intervals)
        assert 14 < len(path.y) <= intervals
    else:
        with pytest.raises(SimulationError, match="too sharply"):
            solve(dynamics, {**p, **INERTIA}, np.array([900.0, 5.0]), mesh, intervals=intervals)


def test_a_mesh_keeps_the_sampler_of_an_array_of_times():
    mesh, times = Mesh.uniform(0.0, 1.0, 4), np.linspace(0.0, 1.0, 9)
    nodes = mesh.times[..., None] ** 3
    assert mesh.sampler(times) is mesh.sampler(times)
    np.testing.assert_allclose(mesh.sampler(times).value(nodes)[:, 0], times**3, atol=1e-12)
    np.testing.assert_allclose(mesh.sampler(times[::2]).value(nodes)[:, 0], times[::2] ** 3, atol=1e-12)
    assert pickle.loads(pickle.dumps(mesh)).__dict__.keys() == {"edges"}  # noqa: S301 - written here
