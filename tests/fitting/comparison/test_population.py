"""Population of many runs: closed forms of balanced data, direct formulas, and simulated null sets."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from fitting import Estimate, EstimationError, Model
from fitting.comparison import _population
from fitting.comparison._comparison import compare
from fitting.comparison._population import FEWEST, population, population_of

RNG = np.random.default_rng(11)


def found(y, c, times=None, **options):
    n, p = y.shape
    at = np.arange(float(n)) if times is None else times
    return population(
        [f"p{j}" for j in range(p)], ["N m"] * p, [f"r{i}" for i in range(n)], at, y, c, **options
    )


def test_one_balanced_parameter_has_the_closed_form():
    """With equal u REML is s^2 = u^2 + tau^2, and the mean has the uncertainty s / sqrt(n)."""
    y = 5e-7 + 1e-8 * RNG.standard_normal((40, 1))
    s2 = float(np.var(y, ddof=1))
    u2 = 0.3 * s2
    (p,) = found(y, np.full((40, 1, 1), u2)).parameters
    assert p.mean == pytest.approx(float(y.mean()), rel=1e-9)
    assert p.spread == pytest.approx(math.sqrt(s2 - u2), rel=1e-3)
    assert p.mean_u == pytest.approx(math.sqrt(s2 / 40), rel=1e-3)
    # the variance of s^2 is 2 s^4 / (n - 1), here / n for the expected information
    assert p.spread_u == pytest.approx(math.sqrt(2 / 40) * s2 / (2 * math.sqrt(s2 - u2)), rel=0.02)


def test_two_balanced_parameters_have_the_sample_covariance():
    root = np.array([[2.0, 0.0], [1.0, 1.5]])
    y = RNG.standard_normal((60, 2)) @ root.T
    c = np.array([[0.5, -0.2], [-0.2, 0.4]])
    got = found(y, np.tile(c, (60, 1, 1)))
    t = np.cov(y.T) - c
    assert [p.spread for p in got.parameters] == pytest.approx(np.sqrt(np.diag(t)), rel=2e-3)
    assert got.correlation[0, 1] == pytest.approx(t[0, 1] / math.sqrt(t[0, 0] * t[1, 1]), rel=5e-3)


def test_scatter_within_the_uncertainties_adds_no_spread():
    y = np.linspace(-1, 1, 20)[RNG.permutation(20)][:, None]
    (p,) = found(y, np.full((20, 1, 1), 4.0)).parameters
    assert p.spread < 0.2 * p.spread_u
    assert p.mean_u == pytest.approx(math.sqrt(4.0 / 20), rel=1e-2)


def test_a_run_that_does_not_determine_a_parameter_counts_for_the_others():
    y = RNG.standard_normal((30, 2))
    c = np.tile(0.1 * np.eye(2), (30, 1, 1))
    y[4, 1] = np.nan
    got = found(y, c)
    without = found(np.delete(y, 4, axis=0), np.delete(c, 4, axis=0), np.delete(np.arange(30.0), 4))
    assert [p.runs for p in got.parameters] == [30, 29]
    assert got.parameters[1].mean == pytest.approx(without.parameters[1].mean, abs=5e-3)
    assert got.parameters[0].mean != pytest.approx(without.parameters[0].mean, abs=5e-3)


def test_parameters_that_few_runs_determine_are_not_tested():
    y = RNG.standard_normal((20, 2))
    y[:5, 1] = np.nan  # 15 of 20 are less than 80 %
    got = found(y, np.tile(0.1 * np.eye(2), (20, 1, 1)))
    assert [p.name for p in got.parameters] == ["p0"]
    assert got.untested == {"p1": 5}
    assert "p1 is not determined in 5 of 20 runs" in got.sentences[-1]
    y[4, 1] = 0.0
    assert found(y, np.tile(0.1 * np.eye(2), (20, 1, 1))).untested == {}


def test_a_drift_is_the_weighted_regression():
    n, t = 40, np.linspace(0.0, 8.0, 40)
    u = RNG.uniform(0.1, 0.3, n)
    y = 3.0 - 0.2 * t + u * np.random.default_rng(1).standard_normal(n)
    got = found(y[:, None], (u**2)[:, None, None], t, time_unit="h")
    (p,) = got.parameters
    slope = np.polyfit(t, y, 1, w=1 / u)[0]
    assert p.change.kind == "drift"
    assert p.change.slope == pytest.approx(slope, abs=0.2 * p.change.slope_u)
    assert p.change.slope_u == pytest.approx(math.sqrt(1 / np.sum((t - t.mean()) ** 2 / u**2)), rel=0.25)
    assert "drifts by" in got.sentences[0]
    assert "N m per h" in got.sentences[0]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_step_has_its_place_and_size(sign):
    n, place = 50, 30
    y = 0.1 * RNG.standard_normal(n)
    y[place:] += sign
    got = found(y[:, None], np.full((n, 1, 1), 0.01))
    c = got.parameters[0].change
    assert (c.kind, c.before, c.after) == ("step", "r29", "r30")
    assert c.time == 29.5
    assert c.size == pytest.approx(y[place:].mean() - y[:place].mean(), rel=1e-6)
    assert "between r29 and r30" in got.sentences[0]
    # runs are in the order of their times
    turned = found(y[::-1][:, None], np.full((n, 1, 1), 0.01), np.arange(n, dtype=float)[::-1])
    assert turned.parameters[0].change.size == pytest.approx(c.size)


def test_runs_without_the_parameter_do_not_move_its_step():
    n, place, unknown = 30, 20, [2, 4, 6, 8]
    y = 1e-2 * RNG.standard_normal((n, 1))
    y[place:] += 1.0
    c = np.full((n, 1, 1), 1e-4)
    y[unknown], c[unknown] = np.nan, np.nan
    got = found(y, c)
    (p,) = got.parameters
    assert (p.change.before, p.change.after, p.change.time) == ("r19", "r20", 19.5)
    # about the step, the spread is far smaller than the step
    assert p.spread < 0.02
    assert got.outlying == ()


def test_statistics_of_a_step_are_those_of_two_samples():
    y = RNG.standard_normal(12)
    f, largest = _population._step_statistics(y, np.ones(12))
    expected = [stats.ttest_ind(y[:k], y[k:]).statistic ** 2 for k in range(FEWEST, 13 - FEWEST)]
    np.testing.assert_allclose(f, expected, rtol=1e-9)
    assert largest == pytest.approx(max(expected))


@pytest.mark.parametrize("quantile", [0.5, 0.9])
def test_with_one_place_the_probability_of_a_step_is_that_of_f(quantile):
    largest = stats.f.ppf(quantile, 1, 4)
    p = _population._p_step(largest, np.array([1.0, 2.0, 1.0, 0.5, 1.0, 1.0]), np.random.default_rng(2))
    assert p == pytest.approx(1 - quantile, abs=0.03)


def test_beyond_the_simulated_sets_the_bound_of_bonferroni_holds():
    p = _population._p_step(400.0, np.ones(40), np.random.default_rng(3))
    assert p == pytest.approx(35 * stats.f.sf(400.0, 1, 38), rel=1e-6)


def test_adjusted_probabilities_are_those_of_holm():
    np.testing.assert_allclose(
        _population._holm(np.array([0.01, 0.04, 0.03, 0.005])), [0.03, 0.06, 0.06, 0.02]
    )


@pytest.mark.parametrize(("size", "named"), [(3.0, False), (9.0, True)])
def test_outlying_runs_are_named_and_left_out(size, named):
    y = np.random.default_rng(5).standard_normal((40, 2))
    mean = y[np.arange(40) != 17, 0].mean()
    y[17] = [size, 0.0]
    got = found(y, np.tile(0.01 * np.eye(2), (40, 1, 1)))
    assert [name for name, _ in got.outlying] == (["r17"] if named else [])
    assert ("Outlying runs, excluded: r17." in got.sentences) is named
    if named:
        assert got.parameters[0].mean == pytest.approx(mean, abs=0.03)


def test_runs_after_a_step_are_not_outlying():
    y = 0.1 * RNG.standard_normal((40, 1))
    y[35:] += 2.0
    got = found(y, np.full((40, 1, 1), 1e-4))
    assert not got.outlying
    assert got.parameters[0].change.after == "r35"


def fitted(value, u, bound=False):
    names = ("casing.air.linear.b2", "touchpoint.constant.b1")
    first, second = (Estimate(v, u, "N m", at_bound=False) for v in value)
    if bound:
        second = Estimate(value[1], math.nan, "N m", at_bound=True)
    estimates = dict(zip(names, (first, second), strict=True))
    return SimpleNamespace(
        model=Model.of(["casing.air.linear", "touchpoint.constant"]),
        estimates=estimates,
        variables=names,
        covariance=u**2 * np.array([[1.0, 0.8], [0.8, 1.0]]),
    )


def test_fits_give_their_covariances_and_bounds():
    rng = np.random.default_rng(6)
    root = np.linalg.cholesky(np.array([[1.0, 0.8], [0.8, 1.0]]))
    values = np.array([1.0, 2.0]) + 0.1 * rng.standard_normal((12, 2)) @ root.T
    fits = {f"run{i}": fitted(v, 0.1, i == 3) for i, v in enumerate(values)}
    got = population_of(fits)
    assert [p.runs for p in got.parameters] == [12, 11]
    assert np.isnan(got.values[3, 1])
    values[3, 1] = np.nan
    c = np.tile(0.01 * np.array([[1.0, 0.8], [0.8, 1.0]]), (12, 1, 1))
    again = found(values, c)
    assert [p.mean for p in got.parameters] == pytest.approx([p.mean for p in again.parameters], rel=1e-12)
    # a run without a value of the second parameter counts through the first one, with which it is correlated
    apart = found(values, c * np.eye(2))
    assert got.parameters[1].mean != pytest.approx(apart.parameters[1].mean, rel=1e-6)
    assert population_of(dict(list(fits.items())[:7])) is None
    document = compare(fits).document()["population"]
    assert set(document["parameters"]) == {"casing.air.linear.b2", "touchpoint.constant.b1"}
    assert document["times"]["run0"] == 1.0
    with pytest.raises(EstimationError, match="the run run4 has no time"):
        compare(fits, {k: 1.0 for k in fits if k != "run4"})


def test_few_runs_have_no_population():
    fits = {f"run{i}": fitted([1.0, 2.0], 0.1) for i in range(3)}
    assert compare(fits).document()["population"] is None


@pytest.mark.slow
@pytest.mark.release
def test_false_changes_are_as_rare_as_stated():
    """200 sets without a change: three parameters with correlated errors and unequal spread, 12 or 40 runs."""
    rng = np.random.default_rng(8)
    changes = outlying = 0
    base = np.array([[1.0, 0.9, 0.3], [0.9, 1.0, 0.2], [0.3, 0.2, 1.0]])
    for k in range(200):
        n = 12 if k % 2 else 40
        u = rng.uniform(0.5, 1.5, (n, 1, 1))
        c = u**2 * base
        y = np.einsum("ijk,ik->ij", np.linalg.cholesky(c), rng.standard_normal((n, 3)))
        y += np.array([1.0, 0.5, 0.0]) * rng.standard_normal((n, 3))
        got = found(y, c, seed=k)
        changes += bool(got.changed)
        outlying += bool(got.outlying)
    # 1 % of 200 sets: more than 7 have a probability of 0.001
    assert changes <= 7
    assert outlying <= 7
