"""The least-squares solver: certified solutions, bounds, undefined regions, and small problems of known solution."""

from types import SimpleNamespace

import numpy as np
import pytest
from nist import PROBLEMS
from scipy.optimize import lsq_linear

from fitting import EstimationError, SimulationError
from fitting.effects._expression import Tape, derivative, parse
from fitting.inference import _optimisation
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
from fitting.inference._problem import covariance_of


def problem_of(certified):
    """Residuals in units of their certified standard deviation, with derivatives from our own formulas."""
    law = parse(certified.formula)
    names = [f"b{i + 1}" for i in range(len(certified.values))]
    tape = Tape([law, *(derivative(law, n) for n in names)])
    x, y = certified.x, certified.y
    sigma = np.sqrt(certified.rss / (len(x) - len(names)))

    def problem(b):
        with np.errstate(all="ignore"):
            value, *slopes = tape({"x": x} | dict(zip(names, b, strict=True)))
        r = (value - y) / sigma
        if not np.isfinite(r).all():
            raise SimulationError("no value here")
        return r, np.stack([s * np.ones(len(x)) for s in slopes], axis=1) / sigma

    return problem


# BoxBOD from its first start: the first full step leads to where b2 no longer matters, a known trap.
TRAPS = {("BoxBOD", 0)}


@pytest.mark.parametrize(("name", "start"), [(n, s) for n in PROBLEMS for s in (0, 1) if (n, s) not in TRAPS])
def test_certified_values_and_errors(name, start):
    certified = PROBLEMS[name]
    free = np.full(len(certified.values), np.inf)
    minimum = minimise(
        problem_of(certified),
        np.array(certified.starts[start], dtype=float),
        -free,
        free,
        tolerance=1e-14,
        absolute=1e-14,
        max_iterations=500,
    )
    assert minimum.converged
    np.testing.assert_allclose(minimum.x, certified.values, rtol=2e-6)
    dof = len(certified.x) - len(certified.values)
    assert minimum.cost == pytest.approx(dof, rel=1e-8)
    errors = np.sqrt(np.diag(covariance_of(minimum.jacobian, np.ones(len(minimum.x), dtype=bool))))
    np.testing.assert_allclose(errors, certified.errors, rtol=1e-5)


def test_a_difficult_start_ends_without_a_worse_fit():
    certified = PROBLEMS["BoxBOD"]
    free = np.full(2, np.inf)
    problem, start = problem_of(certified), np.array(certified.starts[0], dtype=float)
    minimum = minimise(problem, start, -free, free, max_iterations=500)
    assert minimum.cost <= float(np.sum(problem(start)[0] ** 2))


@pytest.mark.parametrize("name", ["Misra1a", "Thurber", "Rat42"])
def test_default_tolerance_is_a_thousandth_of_a_standard_error(name):
    certified = PROBLEMS[name]
    free = np.full(len(certified.values), np.inf)
    minimum = minimise(problem_of(certified), np.array(certified.starts[1], dtype=float), -free, free)
    assert minimum.converged
    assert minimum.iterations < 40
    assert np.abs((minimum.x - certified.values) / certified.errors).max() < 1e-3


@pytest.mark.parametrize("seed", range(20))
def test_bounds_agree_with_scipy_where_the_problem_is_linear(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 7))
    scale = 10.0 ** rng.uniform(-9, 6, n)  # variables of units as different as ours
    a = rng.normal(size=(30, n)) + rng.normal(size=(30, 1))
    b = 20 * rng.normal(size=30)
    lower, upper = -rng.uniform(0, 2, n), rng.uniform(0, 2, n)
    exact = lsq_linear(a, b, (lower, upper), tol=1e-14)
    minimum = minimise(
        lambda x: (a @ (x / scale) - b, a / scale), np.zeros(n), lower * scale, upper * scale, tolerance=1e-13
    )
    assert minimum.converged
    assert minimum.cost == pytest.approx(2 * exact.cost, rel=1e-6)
    np.testing.assert_allclose(minimum.x / scale, exact.x, atol=1e-4)
    assert (minimum.x >= lower * scale).all()
    assert (minimum.x <= upper * scale).all()
    np.testing.assert_array_equal(
        minimum.at_bound, (minimum.x == lower * scale) | (minimum.x == upper * scale)
    )


def test_a_start_outside_the_bounds_is_moved_inside():
    minimum = minimise(lambda x: (x - 5.0, np.eye(1)), np.array([99.0]), np.array([0.0]), np.array([3.0]))
    assert minimum.x == pytest.approx([3.0])
    assert minimum.at_bound.all()


def test_steps_into_undefined_regions_are_shortened():
    def problem(x):
        if x[0] < 0.5:
            raise SimulationError("off the cliff")
        return np.array([10 * np.log(x[0]), x[0] - 1.3]), np.array([[10 / x[0]], [1.0]])

    minimum = minimise(problem, np.array([8.0]), np.array([-np.inf]), np.array([np.inf]))
    assert minimum.converged
    assert 0.9 < minimum.x[0] < 1.1


def test_an_undefined_start_is_an_error():
    def problem(x):
        raise SimulationError("no bounded solution")

    with pytest.raises(EstimationError, match="initial values: no bounded solution"):
        minimise(problem, np.zeros(1), np.array([-1.0]), np.array([1.0]))


def test_too_few_iterations_are_reported_as_not_converged():
    certified = PROBLEMS["Lanczos3"]
    free = np.full(6, np.inf)
    start = np.array(certified.starts[0], dtype=float)
    assert not minimise(problem_of(certified), start, -free, free, max_iterations=2).converged


def test_undetermined_directions_have_large_standard_errors():
    j = np.array([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]])
    errors = np.sqrt(np.diag(covariance_of(j, np.ones(2, dtype=bool))))
    assert errors.min() > 1e8
    held = covariance_of(j, np.array([True, False]))
    assert held[0, 0] == pytest.approx(1 / 14)
    assert held[1, 1] == 0


@pytest.mark.parametrize(
    ("theta", "alone", "broken"),
    [
        ((0.0, 2.0, 1.2), False, False),
        ((-0.1, 1.0, 1.2), False, True),
        ((3.1, 1.0, 1.2), False, True),
        ((1.0, -0.1, 1.2), False, True),
        ((1.0, 2.1, 1.2), False, True),
        ((-0.1, 1.0, 1.2), True, False),
        ((-0.1, 2.1, 1.2), True, True),
    ],
)
def test_strengths_of_power_laws_are_checked_against_both_bounds(theta, alone, broken):
    """A straight law of 0 to 3 beside a power law of 0 to 2, or the power law alone."""
    law = PowerLaw(None if alone else 0, 1, 2, 10.0)
    found = _optimisation._out_of_bounds(
        (law,), np.array(theta), np.array([0.0, 0.0, 0.3]), np.array([3.0, 2.0, 1.4])
    )
    assert found == [law] * broken


@pytest.mark.parametrize(("laws", "found"), [(("a law",), 1.5), ((), 1.0)])
def test_responses_to_laws_of_an_angle_are_computed_again_at_the_minimum(laws, found):
    """Residuals x - 1 - x0 / 2, with the x0 at which the response was computed: 1 after one pass, 1.5 after two."""

    class Problem:
        power_laws = ()
        layout = SimpleNamespace(
            bounds=lambda: (np.array([-9.0]), np.array([9.0])),
            model=SimpleNamespace(angle_dependent=laws, measurement=()),
        )

        def __init__(self):
            self.response = None
            self.cases = [self]

        def forget_columns(self):
            self.response = None

        def __call__(self, x):
            if self.response is None:
                self.response = 1.0 + 0.5 * x
            return x - self.response, np.eye(1)

        @staticmethod
        def transformed(theta):
            return theta

        @staticmethod
        def physical(x):
            return x

        @staticmethod
        def transformed_bounds(*limits):
            return limits

    assert search(Problem(), np.zeros(1)).theta == pytest.approx([found], abs=1e-3)


FREE = np.full(2, np.inf)


class TestStep:
    J = np.array([[1.0, 0.5], [0.2, 2.0], [0.3, 0.1]])
    R = np.array([1.0, -2.0, 0.5])

    def test_a_damped_step_solves_the_scaled_normal_equations(self):
        scale = np.array([2.0, 5.0])
        expected = np.linalg.solve(self.J.T @ self.J + 0.3 * np.diag(scale**2), -self.J.T @ self.R)
        assert _optimisation._step(self.R, self.J, scale, 0.3, -FREE, FREE) == pytest.approx(expected)

    @pytest.mark.parametrize("seed", range(6))
    def test_an_undamped_step_stays_within_its_bounds(self, seed):
        rng = np.random.default_rng(seed)
        # the columns are nearly orthogonal, so that the first bound that is reached is active at the minimum
        j, r = np.eye(6)[:, :2] + 0.1 * rng.standard_normal((6, 2)), rng.standard_normal(6)
        down, up = -0.2 * rng.random(2), 0.2 * rng.random(2)
        step = _optimisation._step(r, j, np.ones(2), 1e-20, down, up)
        best = lsq_linear(j, -r, (down, up)).x
        assert np.sum((r + j @ step) ** 2) == pytest.approx(np.sum((r + j @ best) ** 2), rel=0.02)
        assert ((step >= down) & (step <= up)).all()

    def test_a_variable_at_its_bound_moves_only_inward(self):
        r, j = np.array([1.0, 1.0]), np.eye(2)
        assert _optimisation._step(r, j, np.ones(2), 1e-20, np.array([0.0, -9.0]), FREE) == pytest.approx(
            [0.0, -1.0]
        )
        assert _optimisation._step(-r, j, np.ones(2), 1e-20, np.array([0.0, -9.0]), FREE) == pytest.approx(
            [1.0, 1.0]
        )
        assert _optimisation._step(-r, j, np.ones(2), 1e-20, -FREE, np.array([0.0, 9.0])) == pytest.approx(
            [0.0, 1.0]
        )
        assert _optimisation._step(r, j, np.ones(2), 1e-20, -FREE, np.array([0.0, 9.0])) == pytest.approx(
            [-1.0, -1.0]
        )

    def test_the_undamped_fall_is_that_of_the_linear_problem(self):
        rest = self.R - self.J @ np.linalg.lstsq(self.J, self.R, rcond=None)[0]
        assert _optimisation._undamped(self.R, self.J, np.ones(2), -FREE, FREE) == pytest.approx(
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

        monkeypatch.setattr(_optimisation, "search", search)
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

        monkeypatch.setattr(_optimisation, "minimise", fake)
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


class TestSearchAlongBounds:
    """A law d x + f x^g whose free minimum has d = -1, below its bound 0; each side holds another variable."""

    FREE_END = np.array([-1.0, 2.0, 1.3])

    def run(self, monkeypatch, ends, *, converged=True, cost=2.0, last=None):
        """Search with the results `ends` (cost, d) of each side; return the solution and the searches along bounds."""
        law = PowerLaw(0, 1, 2, 10.0)
        sides = {(k + 1,): end for k, end in enumerate(ends)}
        calls = []

        def along(problem, theta, active, enough, most):
            calls.append((active.held, theta[0], enough, most))
            end = last if last is not None and enough == 1e-5 else sides.get(active.held)
            if end is None:
                return None
            return Solution(np.array([end[1], 2.0, 1.3]), minimum(end[0]), active)

        def choices(active, theta, lower, upper):
            if active.held:  # the second bound of a side whose end is out of bounds
                return iter([(ActiveBounds((), (9,)), np.array([8.0, 2.0, 1.3]))])
            return iter(
                [(ActiveBounds((law,), (k + 1,)), np.array([k + 1.0, 2.0, 1.3])) for k in range(len(ends))]
            )

        sides[9,] = (0.5, 0.0)
        free = minimum(cost, converged=converged)
        monkeypatch.setattr(_optimisation, "minimise", lambda *_, **__: free)
        monkeypatch.setattr(_optimisation, "_minimum_at_bounds", along)
        monkeypatch.setattr(_optimisation, "_choices_of_bound", choices)
        model = SimpleNamespace(angle_dependent=(), measurement=())
        bounds = (np.zeros(3), np.full(3, 5.0))
        problem = SimpleNamespace(
            layout=SimpleNamespace(bounds=lambda: bounds, model=model), cases=(), power_laws=(law,), rows=1,
            transformed_bounds=lambda a, b: (a, b), transformed=lambda x: x, physical=lambda x: self.FREE_END,
        )  # fmt: skip
        return search(problem, np.ones(3)), calls

    def test_the_side_of_the_lowest_end_is_continued_to_convergence(self, monkeypatch):
        found, calls = self.run(monkeypatch, [(3.0, 0.1), (1.0, 0.2), None, (2.0, 0.3)])
        assert [c[0] for c in calls] == [(1,), (2,), (3,), (4,), (2,)]
        assert {c[2:] for c in calls[:4]} == {(3e-3, 40)}
        assert calls[4] == ((2,), 0.2, 1e-5, 200)
        assert (found.active.held, found.minimum.cost, found.minimum.converged) == ((2,), 1.0, True)

    def test_an_end_out_of_bounds_is_continued_along_a_second_bound(self, monkeypatch):
        found, calls = self.run(monkeypatch, [(0.1, -0.2), (1.0, 0.2)])
        assert [c[0] for c in calls] == [(1,), (9,), (2,), (9,)]
        assert (found.active.held, found.minimum.cost) == ((9,), 0.5)

    @pytest.mark.parametrize(("ends", "last"), [([None, None], None), ([(1.0, 0.2)], (1.0, -0.2))])
    def test_without_an_end_within_the_bounds_the_search_has_not_converged(self, monkeypatch, ends, last):
        found, _ = self.run(monkeypatch, ends, last=last)
        assert found.active is None
        assert not found.minimum.converged
        assert found.theta.tolist() == [0.2 if last else 0.0, 2.0, 1.3]

    @pytest.mark.parametrize(
        ("converged", "cost", "tried"), [(False, 11.0, False), (False, 9.0, True), (True, 11.0, True)]
    )
    def test_bounds_are_not_tried_far_from_the_data_without_convergence(
        self, monkeypatch, converged, cost, tried
    ):
        found, calls = self.run(monkeypatch, [(1.0, 0.2)], converged=converged, cost=cost)
        assert bool(calls) is tried
        assert found.theta[0] == (0.2 if tried else 0.0)


class TestHeldVariables:
    """Residuals of three variables, the first one held at one of its bounds -1 and 1."""

    def minimum_at(self, place, slope, held=(0,)):
        j = np.array([[0.6, 0.8, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
        r = np.array([0.0, 0.0, 7.0, slope])
        layout = SimpleNamespace(bounds=lambda: (-np.ones(3), np.ones(3)))
        problem = SimpleNamespace(layout=layout, residuals=lambda p: (r, j), predict=lambda t: None)
        return _optimisation._is_minimum(problem, np.array([place, 0.0, 0.0]), held, 0.01)

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
            _optimisation._choices_of_bound(
                ActiveBounds((law,), held), np.array(theta), self.LOWER, self.UPPER
            )
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
        found = list(
            _optimisation._choices_of_bound(ActiveBounds((law,)), np.array([-1.0, 0.5, 2.0]), lower, upper)
        )
        assert [(a.held, t[a.held[0]]) for a, t in found] == [((0,), 0.0), ((1,), 0.0)]
        assert found[1][1].tolist() == [4.0, 0.0, 2.0]

    def test_a_strength_above_the_whole_torque_leaves_a_thousandth(self):
        found = self.choices((9.0, -0.6, 2.0), PowerLaw(0, 1, 2, 10.0))
        (begin,) = (t for a, t in found if a.held == (0,) and t[0] == 3.0)
        # the torque is 30, all of it from d = 3
        assert begin[1] * 10 ** begin[2] == pytest.approx(0.03)
