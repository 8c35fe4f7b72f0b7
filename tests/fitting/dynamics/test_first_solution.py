"""The rough solution from which Newton's method starts: stable steps, few steps in short intervals."""

import numpy as np
import pytest

from fitting import Model, SimulationError, effect
from fitting.dynamics import _collocation as module
from fitting.dynamics._collocation import Mesh, newton, runge_kutta
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR, Dynamics
from fitting.inference import _case_model

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
