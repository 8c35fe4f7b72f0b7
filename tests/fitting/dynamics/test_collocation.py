"""Collocation against SciPy and an exact solution; meshes and propagators; the first solution of Newton's method."""

import pickle

import numpy as np
import pytest
from reference import EXTRA, INERTIA, PAPER, integrate
from scipy.linalg import expm

from fitting import Model, SimulationError, effect
from fitting.dynamics import _collocation as module
from fitting.dynamics._collocation import (
    Mesh,
    Path,
    Propagator,
    Sampler,
    coarsened,
    newton,
    refine,
    rule,
    runge_kutta,
    transfer,
    truncation_error,
)
from fitting.dynamics._events import solve
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR, Dynamics
from fitting.inference import _case_model

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


RNG = np.random.default_rng(4)


def path(mesh, *functions, states=("omega_r", "omega_c"), kinks=(), jumps=None, least=0.0):
    y = np.stack([f(mesh.times) for f in functions], axis=-1)
    edges = np.stack([f(mesh.edges) for f in functions], axis=-1)
    return Path(mesh, y, edges, states, np.ones(len(y)), kinks, jumps or {}, least_scale=least)


class TestMesh:
    MESH = Mesh(np.array([0.0, 1.0, 2.5, 4.0]))

    def test_nodes_are_within_their_intervals(self):
        assert self.MESH.half[:, 0].tolist() == [0.5, 0.75, 0.75]
        x, _ = np.polynomial.legendre.leggauss(self.MESH.times.shape[1])
        assert self.MESH.times[1] == pytest.approx(1.75 + 0.75 * x)
        assert Mesh.uniform(1.0, 3.0, 4).edges.tolist() == [1.0, 1.5, 2.0, 2.5, 3.0]

    def test_a_part_has_the_edges_inside(self):
        assert self.MESH.between(0.5, 3.0).edges.tolist() == [0.5, 1.0, 2.5, 3.0]
        assert self.MESH.between(1.0, 2.5).edges.tolist() == [1.0, 2.5]
        assert self.MESH.between(1.0 - 1e-10, 2.5 + 1e-10).edges.tolist() == [1.0 - 1e-10, 2.5 + 1e-10]
        assert len(self.MESH.between(1.0 - 1e-8, 2.5).edges) == 3

    def test_breakpoints_inside_become_edges(self):
        assert self.MESH.with_breakpoints([2.0, 1.0, -1.0, 9.0]).edges.tolist() == [0.0, 1.0, 2.0, 2.5, 4.0]
        assert self.MESH.with_breakpoints([0.0, 4.0]) is self.MESH

    def test_a_mesh_is_stretched_between_anchors(self):
        assert self.MESH.moved([0.0, 2.5, 4.0], [0.0, 3.0, 4.0]).edges.tolist() == [0.0, 1.2, 3.0, 4.0]
        assert self.MESH.moved([0.0, 4.0], [0.0, 4.0]) is self.MESH


class TestSampler:
    @pytest.mark.parametrize("swapped", [(150, 320), (20, 150), (20, 320)])
    def test_times_in_any_order_have_their_own_values(self, swapped):
        mesh = Mesh(np.array([0.0, 1.0, 2.5, 4.0]))
        times = np.linspace(0.0, 4.0, 400)
        times[list(swapped)] = times[list(swapped[::-1])]
        assert Sampler(mesh, times).value(mesh.times[..., None])[:, 0] == pytest.approx(times)

    @pytest.mark.parametrize("count", [7, 400])
    def test_polynomials_and_their_integrals_are_exact(self, count):
        mesh = Mesh(np.array([0.0, 1.0, 2.5, 4.0]))
        times = np.linspace(0.0, 4.0, count)
        p = np.polynomial.Polynomial([1.0, -2.0, 0.5, 0.3])
        nodes = np.stack([p(mesh.times), 2 * p(mesh.times)], axis=-1)
        total = p.integ()
        starts = np.stack([total(mesh.edges), 2 * total(mesh.edges)], axis=-1)
        for order in (slice(None), slice(None, None, -1)):
            sampler = Sampler(mesh, times[order])
            assert sampler.value(nodes)[:, 1] == pytest.approx(2 * p(times[order]))
            assert sampler.integral(starts, nodes)[:, 0] == pytest.approx(total(times[order]), abs=1e-12)

    def test_the_angle_of_a_path_is_the_integral_of_its_speed(self):
        mesh = Mesh(np.array([0.0, 1.0, 2.5, 4.0]))
        made = path(mesh, lambda t: 0 * t, lambda t: 3 * t**2)
        edges, nodes = made.angle("omega_c")
        assert edges == pytest.approx(mesh.edges**3)
        assert nodes == pytest.approx(3 * mesh.times**2)


class TestPath:
    MESH = Mesh.uniform(0.0, 4.0, 4)

    def test_errors_are_relative_to_the_largest_state(self):
        made = path(self.MESH, lambda t: -2.0 + 0 * t, lambda t: 1e-3 + 0 * t, lambda t: 1e-3 + 0 * t,
                    states=("omega_r", "omega_c", "deflection"), least=0.5)  # fmt: skip
        assert made.scale() == pytest.approx([2.0, 0.5, 1e-3])
        assert made.speeds == 2

    def test_stretches_end_where_the_casing_stops(self):
        jumps = {1: np.eye(2), 3: np.eye(2)}
        made = path(self.MESH, np.sin, np.cos, kinks=(1.0, 2.0, 3.0, 3.5), jumps=jumps)
        assert made.breaks == (2.0, 3.5)
        pieces = made.pieces()
        assert [p.mesh.edges.tolist() for p in pieces] == [[0.0, 1.0], [1.0, 2.0, 3.0], [3.0, 4.0]]
        assert [p.kinks for p in pieces] == [(), (2.0,), (3.5,)]
        assert np.concatenate([p.y for p in pieces]) == pytest.approx(made.y)
        assert pieces[1].edges == pytest.approx(made.edges[1:4])
        assert all(not p.jumps for p in pieces)

    def test_the_last_coefficients_show_the_truncation(self):
        k = len(rule().x)
        mesh = Mesh.uniform(0.0, 2.0, 2)
        legendre = np.polynomial.legendre.legval
        y = np.zeros((2, k, 2))
        y[0, :, 0] = 4.0
        y[0, :, 1] = legendre(rule().x, [1.0] + [0.0] * (k - 3) + [1e-3])
        y[1, :, 0] = legendre(rule().x, [0.0] * (k - 1) + [2e-3])
        made = Path(mesh, y, np.zeros((3, 2)), ("omega_r", "omega_c"), np.ones(2))
        scale = np.abs(y).max(axis=(0, 1))
        assert truncation_error(made) == pytest.approx([1e-3 / scale[1], 2e-3 / scale[0]])

    @pytest.mark.parametrize(("kinks", "count"), [((), 14), ((1.0,), 15)])
    def test_resolved_pairs_of_equal_intervals_are_joined(self, kinks, count):
        made = path(Mesh.uniform(0.0, 28.0, 28), lambda t: 1 + t, lambda t: t**2, kinks=kinks)
        coarse = coarsened(made)
        assert len(coarse.y) == count
        assert coarse.edges[-1] == pytest.approx([29.0, 784.0])
        assert coarse.kinks == kinks
        assert (set(kinks) <= set(coarse.mesh.edges)) or not kinks

    def test_few_or_rough_intervals_are_kept(self):
        few = path(Mesh.uniform(0.0, 22.0, 22), lambda t: 1 + t, lambda t: t**2)
        assert coarsened(few) is few
        rough = path(Mesh.uniform(0.0, 28.0, 28), lambda t: 1 + t, lambda t: np.sin(3 * t))
        assert coarsened(rough) is rough
        edges = np.cumsum(np.tile([1.0, 3.0], 15))
        unequal = path(Mesh(edges), lambda t: 1 + t, lambda t: t**2)
        assert coarsened(unequal) is unequal

    def test_a_path_is_known_on_another_mesh(self):
        made = path(Mesh.uniform(0.0, 4.0, 3), lambda t: 1 + t, lambda t: t**2, least=0.25)
        other = transfer(made, Mesh.uniform(0.0, 2.0, 5), np.array([7.0, 8.0]), -1.0)
        assert other.y[..., 1] == pytest.approx(other.mesh.times**2)
        assert other.edges[1:, 1] == pytest.approx(other.mesh.edges[1:] ** 2)
        assert other.edges[0].tolist() == [7.0, 8.0]
        assert (other.sense == -1).all()
        assert other.least_scale == 0.25


class TestPropagator:
    A = np.array([[-0.5, 0.3], [0.2, -0.1]])
    MESH = Mesh(np.array([0.0, 1.0, 1.5, 3.0]))

    def made(self, **more):
        a = np.tile(self.A, (3, len(rule().x), 1, 1))
        return Propagator(self.MESH, a, **more)

    def test_steps_are_exponentials_of_the_matrix(self):
        steps = self.made().steps()
        for step, h in zip(steps, (1.0, 0.5, 1.5), strict=True):
            assert step == pytest.approx(expm(self.A * h), rel=1e-9)
        carried = self.made().carried(np.tile(np.eye(2), (4, 1, 1)))
        for i in range(3):
            for k, t in enumerate(self.MESH.times[i]):
                assert carried[i, k] == pytest.approx(expm(self.A * (t - self.MESH.edges[i])), rel=1e-8)

    def test_a_constant_force_gives_the_integral_of_the_exponential(self):
        b = np.array([1.0, 2.0])
        gauss, half = rule(), self.MESH.half
        rates = np.tile(b, (3, len(gauss.x), 1))
        node = (half[..., None] * (gauss.s @ rates))[..., None]
        edge = (half * (gauss.w @ rates))[..., None]
        made = self.made(defect=node)
        assert made.response == pytest.approx(made.nodes(node))
        found = made.chain(made.response, edge, np.array([[5.0], [6.0]]))[..., 0]
        inverse = np.linalg.inv(self.A)
        for t, y in zip(self.MESH.edges, found, strict=True):
            expected = expm(self.A * t) @ [5.0, 6.0] + inverse @ (expm(self.A * t) - np.eye(2)) @ b
            assert y == pytest.approx(expected, rel=1e-8)

    def test_jumps_multiply_and_additions_follow_them(self):
        jump = np.diag([1.0, 0.0])
        made = self.made(jumps={2: jump})
        zero = np.zeros((3, len(rule().x), 2, 1))
        first = np.array([[1.0], [1.0]])
        found = made.chain(zero, zero[:, 0], first, {2: np.array([[0.0], [3.0]])})
        at_two = jump @ expm(self.A * 1.5) @ first + [[0.0], [3.0]]
        assert found[2] == pytest.approx(at_two, rel=1e-8)
        assert found[3] == pytest.approx(expm(self.A * 1.5) @ at_two, rel=1e-8)
        kept = made.with_regular_jumps(0.01)
        assert kept.steps()[1] == pytest.approx(np.diag([1.0, 0.01]) @ expm(self.A * 0.5), rel=1e-8)
        assert made.steps()[1] == pytest.approx(jump @ expm(self.A * 0.5), rel=1e-8)
        assert self.made().with_regular_jumps(0.01).steps()[1] == pytest.approx(expm(self.A * 0.5), rel=1e-8)

    def test_other_states_are_held_fixed(self):
        made = self.made(jumps={2: np.array([[0.5, 0.1], [0.2, 0.3]])})
        alone = made.of_speeds(1)
        assert alone.steps()[:, 0, 0] == pytest.approx(
            [np.exp(-0.5), 0.5 * np.exp(-0.25), np.exp(-0.75)], rel=1e-8
        )
        assert made.of_speeds(2) is made

    @pytest.mark.parametrize("count", [5, 23, 24, 25, 60, 101])
    def test_many_steps_are_combined_without_another_result(self, count):
        step, gain = RNG.standard_normal((count, 2, 2)) / 2, RNG.standard_normal((count, 2, 1))
        out = np.zeros((count + 1, 2, 1))
        out[0] = [[1.0], [2.0]]
        expected = out.copy()
        for i in range(count):
            expected[i + 1] = step[i] @ expected[i] + gain[i]
        module._fill(out, step, gain)
        assert out == pytest.approx(expected)


class Decay:
    """omega' = -rate (omega - limit) for two bodies; dry friction if `dry`."""

    relaxation, states, speeds = "", ("omega_r", "omega_c"), 2

    def __init__(self, rate=0.5, limit=0.0, *, dry=False):
        self.rate, self.limit, self.dry = rate, limit, dry

    def rates(self, t, y, numbers, sense=None):
        return -self.rate * (y - self.limit)

    def tangent(self, t, y, numbers, sense=None):
        return self.rates(t, y, numbers), np.broadcast_to(-self.rate * np.eye(2), (*y.shape, 2))


class TestFirstSolution:
    START = np.array([9.0, 4.0])

    @pytest.mark.parametrize("intervals", [10, 410])
    def test_it_follows_the_motion(self, intervals):
        mesh = Mesh.uniform(0.0, 2.0, intervals)
        found = runge_kutta(Decay(), {}, self.START, mesh, 1.0)
        assert found.edges == pytest.approx(np.exp(-0.5 * mesh.edges)[:, None] * self.START, rel=1e-6)
        assert found.y == pytest.approx(np.exp(-0.5 * mesh.times)[..., None] * self.START, rel=1e-5)

    @pytest.mark.parametrize("intervals", [10, 410])
    def test_it_ends_with_the_interval_in_which_the_casing_stops(self, intervals):
        """The speed 4 falls to -1 and vanishes at 2 ln 5 s."""
        mesh = Mesh.uniform(0.0, 9.0, intervals)
        found = runge_kutta(Decay(limit=-1.0, dry=True), {}, self.START, mesh, 1.0)
        stop = int(np.searchsorted(mesh.edges, 2 * np.log(5.0)))
        assert found.mesh.edges.tolist() == mesh.edges[: stop + 1].tolist()
        whole = runge_kutta(Decay(limit=-1.0), {}, self.START, mesh, 1.0)
        assert len(whole.mesh.edges) == intervals + 1
        turned = runge_kutta(Decay(limit=1.0, dry=True), {}, -self.START, mesh, -1.0)
        assert turned.mesh.edges.tolist() == found.mesh.edges.tolist()

    def test_steps_are_divided_until_they_are_stable(self, monkeypatch):
        seen = []
        stepped = module._stepped
        monkeypatch.setattr(module, "_stepped", lambda *given: seen.append(given[-1]) or stepped(*given))
        mesh = Mesh.uniform(0.0, 1.0, 1)
        longest = np.diff(np.append(np.append(0.0, mesh.times[0]), 1.0)).max()
        for parts, after in ((1, 4), (4, 16), (16, 64)):
            for share, expected in ((0.99, parts), (1.01, after)):
                runge_kutta(Decay(share * 2.5 * parts / longest), {}, self.START, mesh, 1.0)
                assert seen[-1] == expected
        with pytest.raises(SimulationError):
            runge_kutta(Decay(1.01 * 2.5 * 64 / longest), {}, self.START, mesh, 1.0)

    def test_intervals_are_halved_where_they_are_rough(self, monkeypatch):
        monkeypatch.setattr(module, "newton", lambda d, n, p, pivot: p)
        rough = iter(([False, True, False], [False, False, False, True], [False] * 5))
        monkeypatch.setattr(
            module, "truncation_error", lambda p: np.where(next(rough), 2.0, 0.5) * module.TOLERANCE
        )
        made = path(Mesh.uniform(0.0, 3.0, 3), lambda t: 1 + t, lambda t: t)
        found = refine(None, {}, made, most=6)
        assert found.mesh.edges.tolist() == [0.0, 1.0, 1.5, 2.0, 2.5, 3.0]
        monkeypatch.setattr(module, "truncation_error", lambda p: np.full(len(p.y), 2.0) * module.TOLERANCE)
        with pytest.raises(SimulationError):
            refine(None, {}, made, most=5)

    @pytest.mark.parametrize(("most", "enough"), [(7, True), (6, False)])
    def test_the_number_of_edges_is_limited(self, monkeypatch, most, enough):
        """Four edges, and one more in each of three rough intervals."""
        monkeypatch.setattr(module, "newton", lambda d, n, p, pivot: p)
        rough = iter((2.0, 0.5))
        monkeypatch.setattr(
            module, "truncation_error", lambda p: np.full(len(p.y), next(rough)) * module.TOLERANCE
        )
        made = path(Mesh.uniform(0.0, 3.0, 3), lambda t: 1 + t, lambda t: t)
        if enough:
            assert len(refine(None, {}, made, most=most).mesh.edges) == 7
        else:
            with pytest.raises(SimulationError):
                refine(None, {}, made, most=most)

    def test_a_mesh_is_stretched_to_the_time_of_rest(self):
        """The speed 2.2 - t vanishes 0.2 s after the end; intervals from 1 s on are stretched."""
        mesh = Mesh(np.array([0.0, 1.0, 1.5, 2.0]))
        made = path(mesh, lambda t: 0 * t + 5.0, lambda t: 2.2 - t)
        f = np.zeros_like(made.y)
        f[..., 1] = -1.0
        y, edges = made.y.copy(), made.edges.copy()
        new, share = module._stretched(mesh, y, edges, f, 1.0)
        assert new.edges == pytest.approx([0.0, 1.0, 1.6, 2.2])
        assert share == pytest.approx(0.2)
        assert y[..., 1] == pytest.approx(2.2 - new.times)
        assert edges[:, 1] == pytest.approx(2.2 - new.edges)
        for speed in (2.49, 1.51):
            ends = edges * 0 + [[5.0, speed - 2.0]]
            assert module._stretched(mesh, made.y.copy(), ends, f, 1.0)[1] == pytest.approx(0.49)
        for speed in (2.51, 1.49):
            ends = edges * 0 + [[5.0, speed - 2.0]]
            with pytest.raises(SimulationError):
                module._stretched(mesh, made.y.copy(), ends, f, 1.0)


DRAG = "casing.air.linear"
START = np.array([0.0, 3.0])


@pytest.fixture
def steps(monkeypatch):
    """The number of times and of parts between them of each attempt."""
    made, original = [], module._stepped

    def recorded(dynamics, numbers, start, times, sense, width, parts):
        made.append((len(times), parts))
        return original(dynamics, numbers, start, times, sense, width, parts)

    monkeypatch.setattr(module, "_stepped", recorded)
    return made


def first(decay, mesh):
    numbers = {f"{DRAG}.b2": decay, INERTIA_ROTOR: 1.0, INERTIA_CASING: 1.0}
    dynamics = Dynamics(Model.of([DRAG]))
    return dynamics, numbers, runge_kutta(dynamics, numbers, START, mesh, 1.0)


@pytest.mark.parametrize(("share", "parts"), [(0.99, 1), (1.01, 4), (4.01, 16), (16.01, 64)])
def test_steps_are_stable(steps, share, parts):
    """The longest step between nodes is `share` times the stable one: decay and step give 2.5."""
    mesh = Mesh(np.array([0.0, 1.0]))
    nodes = np.array([0.0, *mesh.times.ravel(), 1.0])
    decay = share * 2.5 / np.diff(nodes).max()
    dynamics, numbers, found = first(decay, mesh)
    assert steps == [(len(nodes), parts)]
    # steps of 2.5 times of decay damp by a factor of 1 - 2.5 + 3.1 - 2.6 + 1.6 = 0.65 at least
    assert abs(found.edges[-1, 1]) < START[1]
    if share < 1:
        solved = newton(dynamics, numbers, found)
        assert solved.y[0, :, 1] == pytest.approx(3 * np.exp(-decay * mesh.times[0]), abs=5e-3)


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e4])
def test_the_number_of_steps_does_not_depend_on_the_unit_of_time(steps, unit):
    """With the angle as a state, its derivative by the speed is 1 in any unit."""
    numbers = {f"{DRAG}.b2": 0.3 / unit, INERTIA_ROTOR: 1.0, INERTIA_CASING: 1.0}
    dynamics = Dynamics(Model.of([DRAG]), angles=True)
    start = np.array([0.0, 3.0 / unit, 0.0, 0.0])
    runge_kutta(dynamics, numbers, start, Mesh(np.linspace(0.0, 10.0 * unit, 5)), 1.0)
    assert [parts for _, parts in steps] == [1]


def test_a_law_may_have_an_infinite_derivative_at_the_start(steps):
    """The root of a speed, from rest, with a constant torque: the speed approaches (2 / 0.5)^2."""
    dynamics = Dynamics(
        Model.of(["external.constant"]) + effect("casing: -k*sqrt(abs(omega_c))*sign(omega_c)")
    )
    law = next(p for p in dynamics.parameters if p.startswith("casing:"))
    numbers = {"external.constant.k": 2.0, law: 0.5, INERTIA_ROTOR: 1.0, INERTIA_CASING: 1.0}
    found = runge_kutta(dynamics, numbers, np.zeros(2), Mesh(np.linspace(0.0, 100.0, 30)), 1.0)
    assert [parts for _, parts in steps] == [1]
    assert found.edges[-1, 1] == pytest.approx(16.0, rel=0.05)


def test_a_decay_that_no_step_follows_is_unbounded(steps):
    with pytest.raises(SimulationError, match="bounded"):
        first(1e9, Mesh(np.array([0.0, 1.0, 2.0])))
    assert steps == []


def test_a_motion_that_grows_without_bound_is_tried_once(steps):
    with pytest.raises(SimulationError, match="bounded"):
        first(-2000.0, Mesh(np.linspace(0.0, 10.0, 40)))
    assert len(steps) == 1


@pytest.mark.parametrize(("edges", "each"), [(400, "node"), (401, "edge")])
def test_one_step_crosses_a_short_interval(steps, edges, each):
    mesh = Mesh(np.linspace(0.0, 10.0, edges))
    dynamics, numbers, found = first(0.5, mesh)
    inside = mesh.times.shape[1] if each == "node" else 0
    assert steps == [((edges - 1) * (1 + inside) + 1, 1)]
    exact = 3 * np.exp(-0.5 * mesh.times)
    # linear within an interval h: (0.5 h)^2 / 8 of the speed
    assert found.y[..., 1] == pytest.approx(exact, rel=3e-5)
    assert newton(dynamics, numbers, found).y[..., 1] == pytest.approx(exact, rel=1e-10)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1.01e100])
def test_an_iteration_that_diverges_has_no_bounded_solution(value):
    search = _case_model._FixedPoint()
    assert search.next(np.zeros(2), np.full(2, 0.99e100)) == pytest.approx(0.99e100)
    with pytest.raises(SimulationError, match="bounded"):
        search.next(np.ones(2), np.array([1.0, value]))
