"""Steps, minima and bounds of a search, with problems of a few variables whose solution is known."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from fitting._errors import EstimationError
from fitting.inference import _optimisation as module
from fitting.inference._optimisation import (
    ActiveBounds,
    Minimum,
    Solution,
    is_far,
    minimise,
    search,
    search_widely,
)
from fitting.inference._parameters import PowerLaw

FREE = np.full(2, np.inf)


class TestStep:
    J = np.array([[1.0, 0.5], [0.2, 2.0], [0.3, 0.1]])
    R = np.array([1.0, -2.0, 0.5])

    def test_a_damped_step_solves_the_scaled_normal_equations(self):
        scale = np.array([2.0, 5.0])
        expected = np.linalg.solve(self.J.T @ self.J + 0.3 * np.diag(scale**2), -self.J.T @ self.R)
        assert module._step(self.R, self.J, scale, 0.3, -FREE, FREE) == pytest.approx(expected)

    @pytest.mark.parametrize("seed", range(6))
    def test_an_undamped_step_stays_within_its_bounds(self, seed):
        rng = np.random.default_rng(seed)
        # the columns are nearly orthogonal, so that the first bound that is reached is active at the minimum
        j, r = np.eye(6)[:, :2] + 0.1 * rng.standard_normal((6, 2)), rng.standard_normal(6)
        down, up = -0.2 * rng.random(2), 0.2 * rng.random(2)
        step = module._step(r, j, np.ones(2), 1e-20, down, up)
        best = lsq_linear(j, -r, (down, up)).x
        assert np.sum((r + j @ step) ** 2) == pytest.approx(np.sum((r + j @ best) ** 2), rel=0.02)
        assert ((step >= down) & (step <= up)).all()

    def test_a_variable_at_its_bound_moves_only_inward(self):
        r, j = np.array([1.0, 1.0]), np.eye(2)
        assert module._step(r, j, np.ones(2), 1e-20, np.array([0.0, -9.0]), FREE) == pytest.approx(
            [0.0, -1.0]
        )
        assert module._step(-r, j, np.ones(2), 1e-20, np.array([0.0, -9.0]), FREE) == pytest.approx(
            [1.0, 1.0]
        )
        assert module._step(-r, j, np.ones(2), 1e-20, -FREE, np.array([0.0, 9.0])) == pytest.approx(
            [0.0, 1.0]
        )
        assert module._step(r, j, np.ones(2), 1e-20, -FREE, np.array([0.0, 9.0])) == pytest.approx(
            [-1.0, -1.0]
        )

    def test_the_undamped_fall_is_that_of_the_linear_problem(self):
        rest = self.R - self.J @ np.linalg.lstsq(self.J, self.R, rcond=None)[0]
        assert module._undamped(self.R, self.J, np.ones(2), -FREE, FREE) == pytest.approx(
            self.R @ self.R - rest @ rest
        )


class TestMinimise:
    def test_bounds_are_marked_on_either_side(self):
        def problem(x):
            return x - np.array([3.0, -3.0, 0.5]), np.eye(3)

        found = minimise(problem, np.zeros(3), -np.ones(3), np.ones(3))
        assert found.x == pytest.approx([1.0, -1.0, 0.5])
        assert found.at_bound.tolist() == [True, True, False]
        assert found.cost == pytest.approx(8.0)
        assert found.converged
        assert found.residual == pytest.approx([-2.0, 2.0, 0.0], abs=1e-6)

    def test_a_narrow_valley_ends_at_its_minimum_within_few_steps(self):
        calls = []

        def rosenbrock(x):
            calls.append(x)
            return (
                np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]),
                np.array([[-20 * x[0], 10.0], [-1.0, 0.0]]),
            )

        found = minimise(rosenbrock, np.array([-1.2, 1.0]), -FREE, FREE)
        assert found.converged
        assert found.x == pytest.approx([1.0, 1.0], abs=1e-3)
        assert len(calls) < 40
        assert found.iterations < 60

    def test_the_absolute_tolerance_ends_a_search(self):
        def square(x):
            return np.array([1.0, x[0] ** 2]), np.array([[0.0], [2 * x[0]]])

        loose = minimise(square, np.array([1.0]), -FREE[:1], FREE[:1], absolute=0.1)
        tight = minimise(square, np.array([1.0]), -FREE[:1], FREE[:1], absolute=1e-9)
        assert loose.converged
        assert tight.converged
        assert loose.iterations < tight.iterations
        assert 1e-5 < loose.cost - 1 < 0.1
        assert tight.cost - 1 < 1e-8


def minimum(cost, converged=True):
    none = np.zeros(0)
    return Minimum(none, none, none, cost, converged, 1, none.astype(bool))


class TestWideSearch:
    """Starts whose searches end at given sums of squares; a model of 100 rows is far above 1000."""

    def run(self, monkeypatch, *costs):
        begun = []

        def search(problem, begin, **more):
            begun.append((int(begin), more.get("active")))
            cost = costs[int(begin)]
            if cost is None:
                raise EstimationError("no")
            converged = not isinstance(cost, str)
            return Solution(begin, minimum(float(cost), converged), active=f"a{int(begin)}")

        monkeypatch.setattr(module, "search", search)
        found = search_widely(
            SimpleNamespace(rows=100), np.array(0), [np.array(i) for i in range(1, len(costs))]
        )
        return int(found.theta), [b for b, _ in begun], [a for _, a in begun]

    def test_a_near_minimum_ends_the_search(self, monkeypatch):
        assert self.run(monkeypatch, 999.0, 5.0)[:2] == (0, [0])
        assert self.run(monkeypatch, 1000.0, 5.0, 1.0)[:2] == (1, [0, 1])

    def test_the_best_of_far_minima_is_returned(self, monkeypatch):
        assert self.run(monkeypatch, 5000.0, 9000.0, 3000.0, 4000.0)[:2] == (2, [0, 1, 2, 3])

    def test_a_search_that_has_not_converged_goes_on(self, monkeypatch):
        assert self.run(monkeypatch, "10", "20", 30.0, 1.0)[:2] == (0, [0, 1, 2])

    def test_the_same_minimum_from_two_starts_ends_the_search(self, monkeypatch):
        assert self.run(monkeypatch, 5000.0, 5004.0, 1.0)[:2] == (0, [0, 1])
        assert self.run(monkeypatch, 5000.0, 4996.0, 1.0)[:2] == (1, [0, 1])
        assert self.run(monkeypatch, 5000.0, 5006.0, 1.0)[:2] == (2, [0, 1, 2])
        assert self.run(monkeypatch, 5000.0, 4994.0, 1.0)[:2] == (2, [0, 1, 2])

    def test_a_failed_search_forgets_the_active_bounds(self, monkeypatch):
        assert self.run(monkeypatch, 5000.0, None, 4000.0) == (2, [0, 1, 2], [None, "a0", None])
        with pytest.raises(EstimationError):
            self.run(monkeypatch, None, None)

    @pytest.mark.parametrize(("cost", "far"), [(999.0, False), (1000.0, True), (1001.0, True)])
    def test_ten_per_row_is_far(self, cost, far):
        assert is_far(SimpleNamespace(rows=100), Solution(np.zeros(1), minimum(cost))) is far

    @pytest.mark.parametrize(
        ("quick", "most", "expected"),
        [(False, 200, (1e-5, 200)), (True, 200, (3e-3, 40)), (True, 7, (3e-3, 7)), (False, 60, (1e-5, 60))],
    )
    def test_a_quick_search_ends_earlier(self, monkeypatch, quick, most, expected):
        seen = {}

        def fake(problem, start, lower, upper, **more):
            seen.update(more)
            return minimum(1.0)

        monkeypatch.setattr(module, "minimise", fake)
        model = SimpleNamespace(angle_dependent=(), measurement=())
        problem = SimpleNamespace(
            layout=SimpleNamespace(bounds=lambda: (-FREE, FREE), model=model),
            cases=(),
            power_laws=(),
            transformed_bounds=lambda a, b: (a, b),
            transformed=lambda x: x,
            physical=lambda x: np.zeros(2),
        )
        search(problem, np.zeros(2), quick=quick, max_iterations=most)
        assert (seen["absolute"], seen["max_iterations"]) == expected


class TestHeldVariables:
    """Residuals of three variables, the first one held at one of its bounds -1 and 1."""

    def minimum_at(self, place, slope, held=(0,)):
        j = np.array([[0.6, 0.8, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
        r = np.array([0.0, 0.0, 7.0, slope])
        layout = SimpleNamespace(bounds=lambda: (-np.ones(3), np.ones(3)))
        problem = SimpleNamespace(layout=layout, residuals=lambda p: (r, j), predict=lambda t: None)
        return module._is_minimum(problem, np.array([place, 0.0, 0.0]), held, 0.01)

    def test_chi_square_rises_inward_at_a_minimum(self):
        assert self.minimum_at(-1.0, 1.0)
        assert not self.minimum_at(-1.0, -1.0)
        assert self.minimum_at(1.0, -1.0)
        assert not self.minimum_at(1.0, 1.0)

    @pytest.mark.parametrize(("factor", "found"), [(0.95, True), (1.05, False)])
    def test_a_small_fall_is_neglected(self, factor, found):
        # orthogonal to the second column, the first one is (0.6, 0, 0, 1) less its share
        column = np.array([0.6, 0.0, 0.0, 1.0]) - 0.48 / 1.64 * np.array([0.8, 1.0, 0.0, 0.0])
        slope = np.sqrt(0.01 * column @ column) * factor
        assert self.minimum_at(1.0, slope) is found
        assert self.minimum_at(-1.0, -slope) is found


class TestChoicesOfBounds:
    """A law d x + f x^g at the speed 10, with d within 0 to 3, f within 0 to 2 and g within 1.5 to 3."""

    LOWER, UPPER = np.array([0.0, 0.0, 1.5]), np.array([3.0, 2.0, 3.0])

    def choices(self, theta, law, held=()):
        return list(
            module._choices_of_bound(ActiveBounds((law,), held), np.array(theta), self.LOWER, self.UPPER)
        )

    def test_a_single_power_law_is_moved_into_its_range(self):
        law = PowerLaw(None, 1, 2, 10.0)
        ((active, theta),) = self.choices((1.0, 2.5, 2.0), law)
        assert theta.tolist() == [1.0, 2.0, 2.0]
        assert active == ActiveBounds(())

    @pytest.mark.parametrize(
        ("held", "theta", "place", "begin"),
        [("d", (0.0, -0.5, 2.0), 1, (0.0, 0.0, 2.0)), ("f", (3.5, 2.0, 2.0), 0, (3.0, 2.0, 2.0))],
    )
    def test_of_a_law_with_a_held_strength_the_other_one_is_held_as_well(self, held, theta, place, begin):
        law = PowerLaw(0, 1, 2, 10.0, held=held)
        ((active, found),) = self.choices(theta, law, (5,))
        assert found.tolist() == list(begin)
        assert active == ActiveBounds((), (5, place))

    def test_each_bound_keeps_the_torque_and_its_slope(self):
        law, theta = PowerLaw(0, 1, 2, 10.0), (-1.0, 0.5, 2.0)
        found = self.choices(theta, law)
        assert sorted(a.held for a, _ in found) == [(0,), (0,), (1,), (1,)]
        assert sorted(a.power_laws[0].held for a, _ in found) == ["d", "d", "f", "f"]
        torque, curvature = -1.0 * 10 + 0.5 * 100, 1.0 * 0.5 * 100
        by_d = {float(t[0]): t for a, t in found if a.held == (0,)}
        assert set(by_d) == {0.0, 3.0}
        for d, t in by_d.items():
            rest = torque - 10 * d
            g = np.clip(1 + curvature / rest, 1.5, 3.0)
            assert t[2] == pytest.approx(g)
            assert t[1] == pytest.approx(rest / 10**g)
        by_f = {float(t[1]): t for a, t in found if a.held == (1,)}
        assert set(by_f) == {0.0, 2.0}
        for f, t in by_f.items():
            powers = np.linspace(1.5, 3.0, 241)
            best = powers[np.argmin(np.abs((powers - 1) * f * 10**powers - curvature))]
            assert t[2] == pytest.approx(best)
            assert t[0] == pytest.approx((torque - f * 10**best) / 10)

    def test_a_law_beside_a_quadratic_one_keeps_them_too(self):
        law = PowerLaw(0, 1, 2, 10.0, order=2.0)
        found = self.choices((-0.1, 0.3, 2.5), law)
        torque, curvature = -10 + 0.3 * 10**2.5, 0.5 * 0.3 * 10**2.5
        (begin,) = (t for a, t in found if a.held == (0,) and t[0] == 0.0)
        assert begin[2] == pytest.approx(min(2 + curvature / torque, 3.0))
        assert begin[1] * 10 ** begin[2] == pytest.approx(torque)
        (other,) = (t for a, t in found if a.held == (1,) and t[1] == 2.0)
        assert other[0] * 100 + 2.0 * 10 ** other[2] == pytest.approx(torque)

    def test_infinite_bounds_are_not_chosen(self):
        law = PowerLaw(0, 1, 2, 10.0)
        lower, upper = np.array([0.0, 0.0, -np.inf]), np.array([np.inf, np.inf, np.inf])
        found = list(module._choices_of_bound(ActiveBounds((law,)), np.array([-1.0, 0.5, 2.0]), lower, upper))
        assert [(a.held, t[a.held[0]]) for a, t in found] == [((0,), 0.0), ((1,), 0.0)]
        assert found[1][1].tolist() == [4.0, 0.0, 2.0]

    def test_a_strength_above_the_whole_torque_leaves_a_thousandth(self):
        found = self.choices((9.0, -0.6, 2.0), PowerLaw(0, 1, 2, 10.0))
        (begin,) = (t for a, t in found if a.held == (0,) and t[0] == 3.0)
        # the torque is 30, all of it from d = 3
        assert begin[1] * 10 ** begin[2] == pytest.approx(0.03)
