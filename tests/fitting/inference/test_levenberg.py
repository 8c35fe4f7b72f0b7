"""The least-squares solver on problems with certified solutions, at bounds and in undefined regions."""

from types import SimpleNamespace

import numpy as np
import pytest
from nist import PROBLEMS
from scipy.optimize import lsq_linear

from fitting import EstimationError, SimulationError
from fitting.effects._expression import Tape, derivative, parse
from fitting.inference import _optimisation
from fitting.inference._optimisation import minimise, search
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
