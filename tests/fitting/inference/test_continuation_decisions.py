"""Trials, meshes and integrated angles of one case, with a solver whose reach is known."""

from types import SimpleNamespace

import numpy as np
import pytest

from fitting import SimulationError
from fitting.inference import _case_model as module
from fitting.inference._case_model import CaseModel


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

        monkeypatch.setattr(module, "solve", solve)
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

        monkeypatch.setattr(module, "angle_dependent_rows", rows)
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
