"""Predicted rows of a case and their derivatives; laws of an angle; trials and meshes with a solver of known reach."""

import math
from contextlib import suppress
from dataclasses import replace
from functools import cache
from time import perf_counter
from types import SimpleNamespace

import numpy as np
import oscillators
import pytest
import twobody
from cases import data, fitted

from fitting import LIBRARY, REDUCED, Model, SimulationError, make_record
from fitting.dynamics._collocation import Mesh, Sampler
from fitting.effects._library import find
from fitting.inference import _case_model
from fitting.inference._case_data import CaseData
from fitting.inference._case_model import CaseModel
from fitting.inference._initial_values import start_values
from fitting.inference._parameters import ParameterLayout
from fitting.inference._prior import Prior
from fitting.inference._problem import Problem
from fitting.inference._record import Samples

SIGMA = {"angle": 1e-3, "omega": 0.05}
EXTRA = {
    "touchpoint.step": {"k": 2e-6, "t0": 88.37},
    "touchpoint.stribeck": {"k": 8e-6, "w": 15.0},
    "bearing.heating": {"k": 2e-3, "tau_T": 40.0},
    "bearing.drift": {"k": 1e-4},
    "casing.precession": {"k": 2e-6, "m": 300.0, "phi": 0.6},
    "casing.unbalance": {"k": 5e-6, "phi": 0.9},
    "casing.asymmetry": {"k": 5e-6, "phi": -0.4},
    "camera.clock": {"eps": 1e-4},
    "camera.offset": {"dt": 1e-4},
    "camera.centre": {"eps": 2e-3, "phi": 0.3},
    "camera.tilt": {"eps": 2e-3, "phi": 1.3},
    "camera.shutter": {"k": 1e-5, "phi": 2.0},
    "camera.blur": {"k": 1e-7, "phi": 1.1},
}


@cache
def filmed(quantity):
    """Return the paper's run at 8 frames per second: 27 blocks."""
    cameras = twobody.Cameras(casing_rate=8.0, rotor_rate=200.0, quantity=quantity, sigma=SIGMA[quantity])
    return CaseData.of(make_record(**twobody.film(twobody.simulate(), cameras=cameras)))


def model_of(name, quantity="angle"):
    measured = filmed(quantity)
    layout = ParameterLayout.of(Model.of((*REDUCED, name)), [measured.record])
    values = twobody.truth() | {f"{name}.{k}": v for k, v in EXTRA[name].items()}
    return CaseModel(measured, layout, 0), layout, np.array([values[n] for n in layout.names])


@pytest.mark.parametrize("quantity", ["angle", "omega"])
@pytest.mark.parametrize("name", EXTRA)
def test_derivatives_match_differences(name, quantity):
    case, layout, theta = model_of(name, quantity)
    found = case.predict(theta)
    for i, key in enumerate(layout.names):
        if key == "touchpoint.step.t0" and quantity == "omega":
            continue  # a sample may fall between the two moments
        share = 1e-5 if "precession" in name else 1e-4
        step = np.zeros(len(theta))
        step[i] = {"phi": 1e-3, "t0": 1e-3, "g": 1e-5}.get(key.rpartition(".")[2], share * abs(theta[i]))
        more, less = (case.predict(theta + s).rows for s in (step, -step))
        slope = (more - less) / (2 * step[i])
        size = np.abs(slope).max()
        # what follows an angle is computed about the motion at hand, and its own derivative by others left out
        within = 2e-2 if layout.model.angle_dependent or layout.model.measurement else 2e-4
        assert np.abs(found.jacobian[:, i] - slope).max() < within * size + 1e-6, key


def test_residuals_of_the_true_parameters_are_noise():
    """Rows of the true model against the data: chi-square of 734 rows, with fitted nuisance parameters only."""
    measured = data(seed=0)
    layout = ParameterLayout.of(Model.of(REDUCED), [measured.record])
    values = twobody.truth()
    rows = CaseModel(measured, layout, 0).predict(np.array([values[n] for n in layout.names])).rows
    free = measured.nuisance
    residual = measured.z - rows
    basis = np.linalg.svd(free / np.maximum(np.linalg.norm(free, axis=0), 1e-300), full_matrices=False)[0]
    residual = residual - basis @ (basis.T @ residual)
    assert np.sum(residual**2) / len(residual) == pytest.approx(1.0, abs=0.15)


def test_a_motion_beyond_any_number_is_not_a_perfect_fit():
    """Sums of squares that overflow are an error; they were taken for rows that the nuisance parameters explain."""
    found = fitted(seed=0)
    assert np.linalg.norm(found.problem.residuals(found.predictions)[0]) > 1
    with pytest.raises(SimulationError):
        found.problem.residuals([replace(p, rows=p.rows * 1e160) for p in found.predictions])


@pytest.mark.slow
def test_response_to_a_harmonic_torque_agrees_with_the_oracle():
    """Difference of two simulated casings, one with gravity on an unbalance, against the column of the model."""

    def gravity(t, wr, wc, pr, pc):
        return 2e-6 * np.sin(pc - 0.9)

    cameras = twobody.Cameras(span=20.0, windows=(2.0, 9.0, 16.0), casing_rate=130.0)
    calm, shaken = (
        twobody.simulate(span=20.0, step=0.004, hidden=h)
        for h in (twobody.Hidden(), twobody.Hidden(casing=gravity))
    )
    measured = CaseData.of(make_record(**twobody.film(shaken, seed=3, cameras=cameras)))
    layout = ParameterLayout.of(Model.of((*REDUCED, "casing.unbalance")), [measured.record])
    values = twobody.truth() | {"casing.unbalance.k": 0.0, "casing.unbalance.phi": 0.9}
    theta = np.array([values[n] for n in layout.names])
    column = CaseModel(measured, layout, 0).predict(theta).jacobian[:, layout.index["casing.unbalance.k"]]
    times = measured.record.casing.time
    difference = (shaken.at(times, 1)[0] - calm.at(times, 1)[0])[:, None] / 2e-6
    expected = measured.casing_rows(difference)[:, 0]
    windows = [(shaken.at(w.node_times, 0)[0] - calm.at(w.node_times, 0)[0]) / 2e-6 for w in measured.rotor]
    expected += measured.rows(np.zeros(len(measured.casing.node_times)), windows)
    # the noise of the angle that the law is given, 1e-3, and the oracle's own grid leave this
    free = np.linalg.qr(measured.nuisance)[0]
    left = column - expected
    left, expected = (v - free @ (free.T @ v) for v in (left, expected))
    for part, share in (("casing", 0.01), ("harmonic", 0.01), ("rotor", 0.01)):
        where = measured.slices[part]
        assert np.linalg.norm(left[where]) < share * np.linalg.norm(expected[where]), part


def test_a_change_of_the_phase_changes_the_argument_of_the_law():
    """The column against simulated casings: the torque of second order has a mean, of 8 % of the response."""
    strength, phase, change = 2e-5, 0.9, 0.03

    def moved(phi):
        hidden = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: strength * math.sin(pc - phi))
        return twobody.simulate(span=6.0, step=0.02, hidden=hidden)

    cameras = twobody.Cameras(span=6.0, windows=(2.0,), window_length=2.0, casing_rate=65.0, rotor_rate=200.0)
    measured = CaseData.of(make_record(**twobody.film(moved(phase), seed=3, cameras=cameras)))
    layout = ParameterLayout.of(Model.of((*REDUCED, "casing.unbalance")), [measured.record])
    values = twobody.truth() | {"casing.unbalance.k": strength, "casing.unbalance.phi": phase}
    theta = np.array([values[n] for n in layout.names])
    column = CaseModel(measured, layout, 0).predict(theta).jacobian[:, layout.index["casing.unbalance.phi"]]
    later, earlier = moved(phase + change), moved(phase - change)

    def slope(times, body):
        return (later.at(times, body)[0] - earlier.at(times, body)[0]) / (2 * change)

    expected = measured.casing_rows(slope(measured.record.casing.time, 1)[:, None])[:, 0]
    windows = [slope(w.node_times, 0) for w in measured.rotor]
    expected += measured.rows(np.zeros(len(measured.casing.node_times)), windows)
    free = np.linalg.qr(measured.nuisance)[0]
    left = column - expected
    left, expected = (v - free @ (free.T @ v) for v in (left, expected))
    for part in ("casing", "harmonic"):
        where = measured.slices[part]
        assert np.linalg.norm(left[where]) < 0.01 * np.linalg.norm(expected[where]), part


@pytest.mark.parametrize("name", ["camera.centre", "casing.unbalance"])
def test_a_strength_at_a_phase_is_a_sum_of_both_phases(name):
    case, layout, theta = model_of(name)
    found = case.predict(theta)
    sine, cosine = case.unit_columns(LIBRARY[name], found.path, found.sensitivity, layout.numbers(theta, 0))
    amplitude, phase = (layout.index[f"{name}.{symbol}"] for symbol in EXTRA[name])
    k, phi = theta[[amplitude, phase]]
    expected = np.cos(phi) * sine + np.sin(phi) * cosine
    assert found.jacobian[:, amplitude] == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())
    expected = k * (np.cos(phi) * cosine - np.sin(phi) * sine)
    assert found.jacobian[:, phase] == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


def test_the_clock_of_the_rotor_camera_counts_from_the_start_of_each_window():
    """The error of the angle is (t - t0) omega per unit of the error of the clock."""
    case, layout, theta = model_of("camera.clock")
    found, measured = case.predict(theta), case.data
    parts = []
    for window in measured.rotor:
        t = window.samples.time
        omega = Sampler(found.path.mesh, t).value(found.path.y)[:, 0]
        parts.append(window.at_samples(((t - t[0]) * omega)[:, None])[0][:, 0])
    rows = np.zeros(len(measured.z))
    rows[measured.slices["rotor"]] = np.concatenate(parts)
    free = np.linalg.qr(measured.nuisance)[0]
    column = found.jacobian[:, layout.index["camera.clock.eps"]]
    column, expected = (v - free @ (free.T @ v) for v in (column, measured.whitened(rows)))
    assert column == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("quantity", ["angle", "omega"])
def test_rough_speeds_agree_with_the_true_ones(quantity):
    times, speeds = filmed(quantity).initial_speeds
    motion = twobody.simulate(seed=0)
    assert np.abs(speeds[:, 1] - motion.at(times, 1)[1])[2:-2].max() < 2.0
    inside = (times > 5) & (times < 153)
    assert np.abs(speeds[:, 0] / motion.at(times, 0)[1] - 1)[inside].max() < 0.01


def test_initial_values_have_the_right_order_of_magnitude():
    problem = fitted(seed=0).problem
    theta = dict(
        zip(
            problem.layout.names,
            start_values(
                problem.layout,
                problem.reference,
                [problem.data[0].initial_speeds],
                [np.zeros(len(problem.data[0].initial_speeds[0]))],
            ),
            strict=True,
        )
    )
    true = twobody.truth()
    for key in ("rotor.air.quadratic.a2", "casing.air.linear.b2"):
        assert 0.3 < theta[key] / true[key] < 3
    reference = problem.reference

    def torque(v):
        return v["bearing.linear.d"] * reference + v["bearing.power.f"] * reference ** v["bearing.power.g"]

    assert torque(theta) == pytest.approx(torque(true), rel=0.2)
    assert theta["initial.omega_r@case1"] == pytest.approx(900, rel=0.02)
    assert theta["initial.omega_c@case1"] == pytest.approx(5, abs=10)  # the mean of the first second
    assert all(np.isfinite(list(theta.values())))


@pytest.mark.slow
def test_parameters_of_a_harmonic_law_may_be_held():
    """Strength or phase held at a value: the rows are those of the free law there, without its columns."""
    measured = data()
    model = Model.of((*REDUCED, "casing.unbalance"))
    values = {"casing.unbalance.k": 3e-6, "casing.unbalance.phi": 0.7}
    true = twobody.truth()

    def predicted(model):
        layout = ParameterLayout.of(model, [measured.record])
        numbers = {name: ({**true, **values})[name] for name in layout.names}
        return layout, CaseModel(measured, layout, 0).predict(np.array(list(numbers.values())))

    layout, free = predicted(model)
    for held in values:
        smaller, found = predicted(model.with_fixed({held: values[held]}))
        np.testing.assert_allclose(found.rows, free.rows, atol=1e-6)
        kept = free.jacobian[:, [layout.index[n] for n in smaller.names]]
        assert (np.abs(found.jacobian - kept).max(axis=0) < 1e-5 * np.abs(kept).max(axis=0)).all()


@pytest.mark.parametrize(("reversals", "integrated"), [(4, True), (200, False)])
def test_a_trial_that_reverses_much_more_often_than_the_body_is_given_up(reversals, integrated):
    """A coasting body is tried with a spring; each of its reversals would be integrated by itself."""
    t = np.linspace(0.0, 20.0, 200)
    data = CaseData.of(oscillators.record(t, 2.0 * t - 0.03 * t**2, 1e-3, 0))
    assert data.oscillation is None
    model = Model.of(["touchpoint.constant", "casing.spring.linear"])
    problem = Problem.of(ParameterLayout.of(model, [data.record]), [data])
    values = {
        "touchpoint.constant.b1": 1e-4,
        "casing.spring.linear.k": (np.pi * reversals / t[-1]) ** 2,
        "initial.omega_c@body": 2.0,
    }
    theta = np.array([values.get(n, 0.0) for n in problem.layout.names])
    if integrated:
        (found,) = problem.predict(theta)
        assert len(found.path.jumps) == pytest.approx(reversals, abs=1)
    else:
        with pytest.raises(SimulationError):
            problem.predict(theta)


def slowing(samples):
    """A body that slows down evenly, in ten seconds."""
    t = np.linspace(0.0, 10.0, samples)
    return make_record(
        casing=(t, 5.0 - 0.1 * t, np.full(samples, 1e-3)),
        rotor=[],
        I_rotor=1.0,
        I_casing=1.0,
        label="x",
        quantity="omega",
        single=True,
    )


@pytest.mark.parametrize(("samples", "most"), [(100, 600), (1000, 2000), (30_000, 40_000)])
def test_a_solution_has_as_many_intervals_as_the_samples_resolve(samples, most, monkeypatch):
    record = slowing(samples)
    layout = ParameterLayout.of(Model.of(("casing.air.linear",)), [record])
    given = []

    def noted(*_, intervals, **__):
        given.append(intervals)
        raise SimulationError("enough")

    monkeypatch.setattr(_case_model, "solve", noted)
    with pytest.raises(SimulationError):
        CaseModel(CaseData.of(record), layout, 0).solve(np.ones(len(layout.names)))
    assert given == [most]


def test_a_trial_that_is_too_stiff_for_its_samples_fails_soon():
    """A hundred samples do not show a decay within 1e-18 s."""
    record = slowing(100)
    layout = ParameterLayout.of(Model.of(("casing.air.linear", "touchpoint.constant")), [record])
    model = CaseModel(CaseData.of(record), layout, 0)
    values = {"casing.air.linear.b2": 5e17, "touchpoint.constant.b1": 5e21}
    theta = np.array([values.get(n, 5.0) for n in layout.names])
    begin = perf_counter()
    with suppress(SimulationError):
        model.solve(theta)
    assert perf_counter() - begin < 2.0


@pytest.mark.parametrize("is_angle", [True, False])
def test_windows_have_the_slow_response_of_their_own_body_within_the_times_of_the_casing(is_angle):
    """Three bodies with angles (i + 1) t^3; the windows are of the first and the third one."""
    t, nodes = np.linspace(0.0, 4.0, 30), np.array([-1.0, 0.5, 2.2, 5.0])
    size = np.array([1.0, 2.0, 3.0])[:, None, None]
    angle, speed = size * t[:, None] ** 3, size * 3.0 * t[:, None] ** 2
    windows = [SimpleNamespace(samples=SimpleNamespace(state=i), node_times=nodes) for i in (0, 2)]
    measured = SimpleNamespace(
        record=SimpleNamespace(casing=SimpleNamespace(time=t)), casing=SimpleNamespace(node_times=t),
        rotor=windows, is_angle=is_angle, rows=lambda own, rotor: (own, rotor),
    )  # fmt: skip
    own, rotor = _case_model._rotor_rows(measured, speed, angle)
    within = np.clip(nodes, 0.0, 4.0)
    expected = within**3 if is_angle else 3.0 * within**2
    assert not own.any()
    for found, factor in zip(rotor, (1.0, 3.0), strict=True):
        np.testing.assert_allclose(found[:, 0], factor * expected, atol=1e-9)


class TestContinuation:
    """A solver that reaches 1.0 beyond the path that it begins with."""

    def model(self, monkeypatch, *, last, jumps, reach=1.0):
        calls = []

        def solve(dynamics, numbers, first, mesh, known, *, intervals, most):
            calls.append((float(first[0]), known.at, most))
            assert (numbers, first[1], mesh, intervals) == ("numbers", 7.0, "mesh", 99)
            if abs(first[0] - known.at) > reach:
                raise SimulationError("too far")
            return SimpleNamespace(at=float(first[0]), jumps=[0] * jumps)

        monkeypatch.setattr(_case_model, "solve", solve)
        model = object.__new__(CaseModel)
        layout = SimpleNamespace(start=lambda theta, case: theta, numbers=lambda theta, case: "numbers")
        measured = SimpleNamespace(at=0.0, jumps=[0] * jumps)
        vars(model).update(
            layout=layout, case=0, dynamics=SimpleNamespace(start=(7.0,)), _mesh="mesh", _most=99, _most_events=20,
            _measured=lambda theta: measured,
            _last=None if last is None else (np.array([last]), SimpleNamespace(at=last, jumps=[0] * jumps)),
        )  # fmt: skip
        return model, calls

    def test_the_first_trial_begins_with_the_measured_motion(self, monkeypatch):
        model, calls = self.model(monkeypatch, last=None, jumps=9)
        theta = np.array([0.5])
        assert model.solve(theta).at == 0.5
        assert calls == [(0.5, 0.0, 20)]
        theta[0] = 8.0
        assert model._last[0].tolist() == [0.5]
        with pytest.raises(SimulationError):
            self.model(monkeypatch, last=None, jumps=9)[0].solve(np.array([2.0]))

    @pytest.mark.parametrize(("jumps", "most"), [(3, 40), (49, 41), (50, 42), (2, 20)])
    def test_with_many_reversals_few_stretches_are_integrated_alone(self, monkeypatch, jumps, most):
        model, calls = self.model(monkeypatch, last=1.0, jumps=jumps)
        assert model.solve(np.array([1.5])).at == 1.5
        assert calls == [(1.5, 1.0, most)]
        assert model._last[1].at == 1.5

    @pytest.mark.parametrize(
        ("target", "tried"),
        [
            (1.9, [1.9]),
            (2.8, [2.8, 1.9, 2.8]),
            (4.6, [4.6, 2.8, 1.9, 2.8, 4.6, 3.7, 4.6]),
        ],
    )
    def test_a_far_trial_is_reached_in_halved_steps(self, monkeypatch, target, tried):
        model, calls = self.model(monkeypatch, last=1.0, jumps=3)
        assert model.solve(np.array([target])).at == target
        assert [round(c[0], 6) for c in calls] == tried
        assert model._last[0].tolist() == [target]

    def test_a_trial_beyond_short_steps_leaves_the_last_solution(self, monkeypatch):
        model, calls = self.model(monkeypatch, last=1.0, jumps=3)
        before = model._last
        with pytest.raises(SimulationError):
            model.solve(np.array([5.4]))
        assert model._last is before
        # in quarters of the whole step at the least
        assert min(c[0] for c in calls) == pytest.approx(2.1)

    def test_with_few_reversals_no_steps_are_halved(self, monkeypatch):
        model, calls = self.model(monkeypatch, last=1.0, jumps=2)
        with pytest.raises(SimulationError):
            model.solve(np.array([2.5]))
        assert len(calls) == 1


class TestLimits:
    def limits(self, speed, reversals=(), samples=(100, 50)):
        model = object.__new__(CaseModel)
        runs = [np.zeros(n) for n in samples]
        speeds = np.stack([np.ones(len(speed)), speed], axis=1)
        model.data = SimpleNamespace(
            initial_speeds=(None, speeds), motion=SimpleNamespace(reversals=reversals),
            record=SimpleNamespace(casing=runs[0], rotor=runs[1:]),
        )  # fmt: skip
        return model

    def test_events_are_twice_those_of_the_measured_motion(self):
        assert self.limits([1.0, 2.0, 3.0])._most_events == 20
        assert self.limits([1.0, -2.0, 3.0])._most_events == 24
        assert self.limits([1.0, -2.0, 3.0], reversals=[1.0] * 5)._most_events == 30
        assert self.limits([1.0, -2.0, 3.0], reversals=[1.0])._most_events == 24

    @pytest.mark.parametrize(
        ("samples", "most"),
        [((100, 50), 600), ((200, 100, 1), 602), ((15000, 5000), 40000), ((30000,), 40000)],
    )
    def test_intervals_are_two_per_sample(self, samples, most):
        assert self.limits([1.0], samples=samples)._most == most


class TestMesh:
    def mesh(self, *, reversals=(), relaxation="", settling=0.5):
        model = object.__new__(CaseModel)
        model.data = SimpleNamespace(
            record=SimpleNamespace(span=(2.0, 26.0)), motion=SimpleNamespace(reversals=np.array(reversals))
        )
        model.dynamics = SimpleNamespace(relaxation=relaxation)
        model.layout = SimpleNamespace(model=SimpleNamespace(constants={"T": settling}))
        return model._mesh.edges

    def test_a_run_has_twelve_intervals(self):
        assert self.mesh() == pytest.approx(np.linspace(2.0, 26.0, 13))

    def test_a_fast_start_has_intervals_that_double(self):
        """Those of a tenth of a second and twice, four, ... times as much, up to the first interval of 2 s."""
        expected = sorted({*np.linspace(2.0, 26.0, 13), *(2.0 + 0.1 * 2.0 ** np.arange(-1, 5))})
        assert self.mesh(relaxation="T", settling=0.1) == pytest.approx(expected)
        slow = self.mesh(relaxation="T", settling=8.0)
        assert slow == pytest.approx(np.linspace(2.0, 26.0, 13))

    def test_an_oscillation_has_five_intervals_between_reversals(self):
        """Reversals at the ends of the record are no ends of a swing."""
        edges = self.mesh(reversals=(2.0, 7.0, 17.0, 26.0))
        assert edges == pytest.approx([2, 3, 4, 5, 6, 7, 9, 11, 13, 15, 17, 18.8, 20.6, 22.4, 24.2, 26])


class TestIntegratedAngle:
    """Speeds with a noise of twice 0.1 rad/s, every quarter of a second from 3 to 8 s, in two laws of the angle."""

    T = np.linspace(3.0, 8.0, 21)

    def errors(self, monkeypatch, *, is_angle=False, angle=True, laws=("a", "b")):
        grid = np.linspace(3.0, 8.0, 501)

        def rows(data, effect, path, motion, numbers, error):
            assert (path, motion, numbers) == ("path", "motion", "numbers")
            gain = {"a": 1.0, "b": 10.0}[effect]
            return SimpleNamespace(value=gain * (5.0 + (0.0 if error is None else error(grid))))

        monkeypatch.setattr(_case_model, "angle_dependent_rows", rows)
        model = object.__new__(CaseModel)
        model.data = SimpleNamespace(
            is_angle=is_angle, measured_angle=1.0 if angle else None,
            casing=SimpleNamespace(scale=2.0, samples=SimpleNamespace(time=self.T, sigma=np.full(21, 0.1))),
        )  # fmt: skip
        model.layout = SimpleNamespace(
            model=SimpleNamespace(angle_dependent=laws), numbers=lambda theta, case: "numbers"
        )
        model.case = 0
        prediction = SimpleNamespace(rows=np.zeros(501), path="path", motion="motion")
        return grid, model.integration_errors(prediction, None)

    def test_it_has_the_parts_of_a_random_walk(self, monkeypatch):
        """Each is an eigenfunction of the covariance min(s, t) v / T, of the size of its root."""
        t, found = self.errors(monkeypatch)
        assert found.shape == (501, 6)
        variance = 21 * (2.0 * 0.1 * 0.25) ** 2
        step = 5.0 / 500
        walk = variance / 5.0 * np.minimum(t[:, None] - 3.0, t - 3.0)
        weights = np.full(501, step)
        weights[[0, -1]] = step / 2
        for k, column in enumerate((found / 11.0).T):
            value = column @ (weights * column)
            assert walk @ (weights * column) == pytest.approx(
                value * column, abs=1e-4 * value * np.abs(column).max()
            )
            assert value == pytest.approx(variance * 5.0 / ((k + 0.5) * np.pi) ** 2, rel=1e-4)

    def test_angles_and_models_without_a_law_of_the_angle_have_none(self, monkeypatch):
        for changed in ({"is_angle": True}, {"angle": False}, {"laws": ()}):
            assert self.errors(monkeypatch, **changed)[1].shape == (501, 0)


T = np.arange(0.0, 20.0, 0.02)


class TestLawsOfAnAngle:
    def test_both_phases_have_the_present_strength(self):
        effect = find("casing.unbalance")
        laws, strength = _case_model._unit_laws(
            effect, {"casing.unbalance.k": 3.0, "casing.unbalance.phi": 0.4}
        )
        assert [law["phi"] for law in laws] == [0.0, math.pi / 2]
        assert [law["k"] for law in laws] == [1.0, 1.0]
        assert strength == pytest.approx([3 * math.cos(0.4), 3 * math.sin(0.4)])
        assert _case_model._unit_laws(effect, {})[1] == pytest.approx([0.0, 0.0])

    def test_the_derivative_follows_strength_and_phase(self):
        effect = find("casing.unbalance")
        made = object.__new__(CaseModel)
        sine, cosine = np.array([1.0, 2.0]), np.array([-3.0, 5.0])
        strength = np.array([0.3, 0.2])
        known = SimpleNamespace(
            columns=np.stack([sine, cosine], axis=1), strength=strength, value=np.array([7.0, 8.0])
        )
        made._columns = {effect.name: known}
        made.case, made._own = 0, {4: 0, 9: 1}
        places = {"casing.unbalance.k": 4, "casing.unbalance.phi": 9}
        made.layout = SimpleNamespace(places=lambda case, keys: np.array([places[keys[0]]]))

        def at(k, phi):
            rows, columns = np.zeros(2), np.zeros((2, 2))
            made._add(effect, {"casing.unbalance.k": k, "casing.unbalance.phi": phi}, rows, columns)
            return rows, columns

        rows, columns = at(2.0, 0.7)
        expected = (
            known.value - 0.3 * sine - 0.2 * cosine + 2.0 * (math.cos(0.7) * sine + math.sin(0.7) * cosine)
        )
        assert rows == pytest.approx(expected)
        assert columns[:, 0] == pytest.approx(
            (at(2.0 + 1e-6, 0.7)[0] - at(2.0 - 1e-6, 0.7)[0]) / 2e-6, rel=1e-6
        )
        assert columns[:, 1] == pytest.approx(
            (at(2.0, 0.7 + 1e-6)[0] - at(2.0, 0.7 - 1e-6)[0]) / 2e-6, rel=1e-6
        )

    def test_a_linear_iteration_ends_after_as_many_steps_as_it_has_dimensions(self):
        matrix, b = np.array([[0.9, 0.3], [-0.2, 1.4]]), np.array([1.0, 2.0])
        search, x = _case_model._FixedPoint(), np.zeros(2)
        for _ in range(4):
            x = search.next(x, matrix @ x + b)
        assert x == pytest.approx(np.linalg.solve(np.eye(2) - matrix, b))

    def test_the_error_of_a_mean_is_that_of_weights(self):
        assert _case_model._unit_error(Samples(T[:2], T[:2], np.array([0.3, 0.4]))) == pytest.approx(0.24)


class TestPrior:
    """A strength that two runs share, and its prior."""

    PRIOR = Prior(("touchpoint.constant.b1",), (2e-6,), ((4e-14,),))

    def of(self, *, share, prior=PRIOR):
        records = [replace(data(seed=0).record, label=x) for x in ("first", "second")]
        layout = ParameterLayout.of(
            Model.of(["touchpoint.constant"]),
            records,
            **({"share": ["touchpoint.constant.b1"]} if share else {"per_case": ["touchpoint.constant.b1"]}),
        )
        cases = [SimpleNamespace(record=r, prior=prior) for r in records]
        return [CaseModel(c, layout, i)._prior for i, c in enumerate(cases)]

    def test_a_shared_parameter_has_it_in_the_first_case_only(self):
        first, second = self.of(share=True)
        assert (first[0], second[0]) == (("touchpoint.constant.b1",), ())
        assert first[1].tolist() == [2e-6]
        assert first[2] == pytest.approx(np.array([[1 / 2e-7]]))

    def test_a_parameter_with_a_value_for_each_case_has_it_in_each(self):
        assert [p[0] for p in self.of(share=False)] == [
            (f"touchpoint.constant.b1@{x}",) for x in ("first", "second")
        ]

    def test_without_a_prior_there_is_none(self):
        assert self.of(share=True, prior=None) == [None, None]


def test_variables_of_the_motion_come_first():
    """The derivatives by the parameters of the motion are integrated; those of the camera are added to the rows."""
    model, layout, _ = model_of("camera.tilt")
    names = [layout.names[k] for k in model.places]
    assert names[model._moving :] == ["camera.tilt.eps", "camera.tilt.phi"]
    assert set(names) == set(layout.names)
    assert [model._own[k] for k in model.places] == list(range(len(names)))


class TestReversals:
    """An oscillation from 2 s to 26 s, measured as cos(pi t / 5): it reverses at 5, 10, 15 ... s."""

    def model(self, *, deflection=True, reversals=(2.0, 5.0, 10.0, 15.0, 26.0), sign=1.0):
        t = np.linspace(0.0, 30.0, 3001)
        model = object.__new__(CaseModel)
        model.dynamics = SimpleNamespace(
            states=("omega_r", "omega_c", *(["deflection"] if deflection else [])), start=[0.0] * deflection
        )
        motion = SimpleNamespace(
            reversals=np.array(reversals), time=t, deflection=sign * np.cos(0.2 * np.pi * t)
        )
        model.data = SimpleNamespace(
            motion=motion, initial_speeds=(np.array([0.0, 30.0]), np.array([[9.0, 1.0], [6.0, 4.0]]))
        )
        model._mesh = Mesh.uniform(2.0, 26.0, 12)
        model.layout = SimpleNamespace(start=lambda theta, case: [300.0, theta[0]])
        model.case = 0
        return model

    @pytest.mark.parametrize(("sign", "first"), [(1.0, -1.0), (-1.0, 1.0)])
    @pytest.mark.parametrize("speed", [0.0, 3.0, -3.0])
    def test_the_sense_changes_at_each_reversal(self, sign, first, speed):
        """Before 5 s the angle falls; the initial speed may have either sign."""
        mesh, jumps, sense = self.model(sign=sign)._reversals(
            Mesh.uniform(2.0, 26.0, 12), np.array([300.0, speed, 0.0])
        )
        middle = 0.5 * (mesh.edges[1:] + mesh.edges[:-1])
        turns = (middle > 5.0).astype(int) + (middle > 10.0) + (middle > 15.0)
        assert sense == pytest.approx(first * (-1.0) ** turns)
        assert [mesh.edges[i] for i in jumps] == [5.0, 10.0, 15.0]  # not at the ends of the record
        assert all((j == np.eye(3)).all() for j in jumps.values())

    @pytest.mark.parametrize(("speed", "sense"), [(3.0, 1.0), (-3.0, -1.0), (0.0, 1.0)])
    def test_a_rotation_keeps_the_sense_of_its_initial_speed(self, speed, sense):
        mesh, jumps, found = self.model(deflection=False)._reversals(
            Mesh.uniform(2.0, 26.0, 12), np.array([300.0, speed])
        )
        assert (len(mesh.edges), jumps, set(found)) == (13, {}, {sense})

    @pytest.mark.parametrize("deflection", [True, False])
    def test_the_first_solution_is_the_measured_motion(self, deflection):
        model = self.model(deflection=deflection)
        path = model._measured(np.array([2.0]))
        assert path.edges[[0, -1], 0] == pytest.approx([8.8, 6.4])  # between 9 and 6 rad/s
        assert path.edges[[0, -1], 1] == pytest.approx([1.2, 3.6])
        assert path.y[..., 1] == pytest.approx(1.0 + 0.1 * path.mesh.times)
        assert path.states == ("omega_r", "omega_c", "deflection")[: 2 + deflection]
        if deflection:
            assert path.y[..., 2] == pytest.approx(np.cos(0.2 * np.pi * path.mesh.times), abs=1e-3)
        assert not path.exact
