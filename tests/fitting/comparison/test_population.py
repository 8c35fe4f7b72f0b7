"""Population of many runs: closed forms of balanced data, regressions, dense matrices, and simulated null sets."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from fitting import Estimate, EstimationError, Model
from fitting.comparison import _comparison, _population
from fitting.comparison._comparison import Repeat, compare
from fitting.comparison._population import FEWEST, compared_parameters, population, population_of

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


ALL = np.ones(12, dtype=bool)
TIMES = np.array([0.0, 1, 2, 4, 5, 7, 8, 10, 13, 14, 15, 20])


def noise(seed=0, n=12):
    return np.random.default_rng(seed).standard_normal(n)


class TestColumns:
    def test_a_constant_has_one_column(self):
        assert _population._columns("", 0, TIMES, ALL).tolist() == [[1.0]] * 12

    def test_drift_and_step_are_centred_on_the_runs_inside(self):
        inside = ALL.copy()
        inside[[0, 3, 11]] = False
        drift = _population._columns("drift", 0, TIMES, inside)
        assert drift[:, 1] == pytest.approx(TIMES - TIMES[inside].mean())
        step = _population._columns("step", 6, TIMES, inside)
        # nine runs are inside, and five of them (6 to 10) are after the step
        assert step[:, 1] == pytest.approx(np.where(np.arange(12) >= 6, 1.0, 0.0) - 5 / 9)
        assert (step[:, 0] == 1).all()

    def test_undetermined_values_have_the_mean_and_no_weight(self):
        y = np.array([[1.0, 5.0], [3.0, np.nan], [np.nan, 9.0]])
        c = np.tile(np.array([[0.1, 0.05], [0.05, 0.2]]), (3, 1, 1))
        c[1, 1, :] = c[1, :, 1] = np.nan
        filled, cov = _population._filled(y, c, np.isfinite(y))
        assert filled.tolist() == [[1.0, 5.0], [3.0, 7.0], [2.0, 9.0]]
        assert cov[0].tolist() == [[0.1, 0.05], [0.05, 0.2]]
        assert cov[1].tolist() == [[0.1, 0.0], [0.0, 1e10]]
        assert cov[2].tolist() == [[1e10, 0.0], [0.0, 0.2]]
        assert np.isnan(c[1, 1, 1])

    def test_the_median_is_over_seven_neighbours_on_each_side(self):
        y = np.arange(30.0) ** 2
        found = _population._running_median(y)
        assert found[15] == y[15]
        assert found[0] == np.median(y[:8])
        assert found[3] == np.median(y[:11])
        assert found[7] == np.median(y[:15])
        assert found[29] == np.median(y[22:])


class TestRegression:
    def test_the_last_coefficient_is_that_of_weighted_least_squares(self):
        y, w = 0.3 * noise(1), 1 / (0.5 + TIMES / 10) ** 2
        design = np.column_stack([np.ones(12), TIMES])
        gram = np.linalg.inv(design.T @ np.diag(w) @ design)
        beta = gram @ design.T @ (w * y)
        chi2 = np.sum(w * (y - design @ beta) ** 2) / 10
        assert chi2 < 1
        assert _population._coefficient(y, w, design) == pytest.approx((beta[1], math.sqrt(gram[1, 1]), 10))
        # a scatter above the uncertainties counts
        large = _population._coefficient(10 * y, w, design)
        assert large == pytest.approx((10 * beta[1], math.sqrt(100 * chi2 * gram[1, 1]), 10))
        assert 100 * chi2 > 1

    def test_the_spread_of_equal_weights_is_the_sample_variance_less_that_of_the_fit(self):
        y, u2 = noise(2), np.full(12, 0.2)
        w, spread = _population._weights(y, u2, np.ones((12, 1)))
        assert spread == pytest.approx(np.var(y, ddof=1) - 0.2, rel=5e-3)
        assert w == pytest.approx(1 / (0.2 + spread))
        design = np.column_stack([np.ones(12), TIMES])
        rest = y - design @ np.linalg.lstsq(design, y, rcond=None)[0]
        assert _population._weights(y, u2, design)[1] == pytest.approx(rest @ rest / 10 - 0.2, rel=1e-2)

    def test_scatter_below_the_uncertainties_adds_nothing(self):
        w, spread = _population._weights(0.1 * noise(2), np.full(12, 1.0), np.ones((12, 1)))
        assert spread < 1e-4
        assert w == pytest.approx(np.ones(12), rel=1e-3)

    def test_the_deviance_is_that_of_normal_variables(self):
        y, u2 = noise(3), np.linspace(0.1, 0.3, 12)
        design = np.ones((12, 1))
        w, _ = _population._weights(y, u2, design)
        mean = w @ y / w.sum()
        expected = -2 * stats.norm.logpdf(y, mean, w**-0.5).sum() - 12 * math.log(2 * math.pi)
        assert _population._deviance(y, u2, design) == pytest.approx(expected)


class TestStep:
    def test_weighted_statistics_are_ratios_of_sums_of_squares(self):
        y, w = noise(4), np.linspace(1.0, 3.0, 12)
        f, largest = _population._step_statistics(y, w)
        assert len(f) == 7
        whole = np.sum(w * (y - w @ y / w.sum()) ** 2)
        for k, value in enumerate(f):
            parts = (slice(0, k + 3), slice(k + 3, 12))
            rest = sum(np.sum(w[p] * (y[p] - w[p] @ y[p] / w[p].sum()) ** 2) for p in parts)
            assert value == pytest.approx((whole - rest) / (rest / 10))
        assert largest == f.max()
        many, most = _population._step_statistics(np.stack([y, 2 * y + 5]), w)
        assert many[1] == pytest.approx(f)
        assert most == pytest.approx(np.full(2, largest))

    def test_the_probability_counts_larger_simulated_steps(self, monkeypatch):
        monkeypatch.setattr(_population, "_SETS", 50)
        largest = iter([np.arange(30.0), np.arange(20.0)])
        monkeypatch.setattr(_population, "_AT_A_TIME", 12 * 30)
        monkeypatch.setattr(_population, "_step_statistics", lambda sets, w: (None, next(largest)))
        # 5 of 30 and none of 20 are at least 25
        assert _population._p_step(25.0, np.ones(12), np.random.default_rng(0)) == pytest.approx(6 / 51)
        largest = iter([np.arange(30.0), np.arange(20.0)])
        assert _population._p_step(40.0, np.ones(12), np.random.default_rng(0)) == pytest.approx(
            min(1 / 51, 7 * stats.f.sf(40.0, 1, 10))
        )
        largest = iter([np.arange(30.0), np.arange(20.0)])
        monkeypatch.setattr(_population, "_ENOUGH", 4)
        assert _population._p_step(25.0, np.ones(12), np.random.default_rng(0)) == pytest.approx(6 / 31)
        largest = iter([np.arange(30.0), np.arange(20.0)])
        monkeypatch.setattr(_population, "_ENOUGH", 5)
        assert _population._p_step(25.0, np.ones(12), np.random.default_rng(0)) == pytest.approx(6 / 51)

    def test_adjusted_probabilities_grow_with_the_rank_and_end_at_one(self):
        assert _population._holm(np.array([0.5, 0.001, 0.4, 0.02])) == pytest.approx([0.8, 0.004, 0.8, 0.06])
        assert _population._holm(np.array([0.9, 0.8])) == pytest.approx([1.0, 1.0])

    @pytest.mark.parametrize(
        ("shape", "kind"),
        [(np.zeros(12), ""), (TIMES / 4, "drift"), (np.where(np.arange(12) >= 5, 3.0, 0.0), "step")],
    )
    def test_the_mean_model_of_least_bic_is_chosen(self, shape, kind):
        y, u2 = shape + 0.1 * noise(6), np.full(12, 0.01)
        chosen = _population._best(y, u2, TIMES, ALL)
        assert chosen == (kind, 5 if kind == "step" else 0)

    def test_bic_counts_drift_and_step_with_one_and_two_parameters(self, monkeypatch):
        n = math.log(12)

        def chosen(constant, step, drift):
            monkeypatch.setattr(
                _population,
                "_deviance",
                lambda y, u2, design: (
                    constant if design.shape[1] == 1 else step if len(set(design[:, 1])) == 2 else drift
                ),
            )
            return _population._best(noise(1), np.ones(12), TIMES, ALL)[0]

        assert chosen(0.0, -1.9 * n, -0.9 * n) == ""
        assert chosen(0.0, -1.9 * n, -1.1 * n) == "drift"
        assert chosen(0.0, -2.1 * n, -0.9 * n) == "step"
        assert chosen(0.0, -3.1 * n, -2.0 * n) == "step"
        assert chosen(0.0, -2.9 * n, -2.0 * n) == "drift"

    def test_runs_at_the_same_time_do_not_drift(self):
        y, u2 = np.where(np.arange(12) >= 5, 3.0, 0.0) + 0.1 * noise(6), np.full(12, 0.01)
        assert _population._best(y, u2, np.ones(12), ALL) == ("step", 5)
        found = _population._tests(y, u2, np.ones(12), ALL, np.random.default_rng(0))
        assert (found.p_drift, found.slope, found.slope_u, found.kind) == (1.0, 0.0, 0.0, "step")

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_a_drift_has_the_probability_of_student(self, sign):
        y, u2 = sign * noise(8), np.full(12, 1e-12)
        found = _population._tests(y, u2, TIMES, ALL, np.random.default_rng(0))
        line = stats.linregress(TIMES, y)
        assert found.slope == pytest.approx(line.slope, rel=1e-6)
        assert found.slope_u == pytest.approx(line.stderr, rel=1e-2)
        assert found.p_drift == pytest.approx(line.pvalue, rel=0.03)
        assert 0.001 < line.pvalue < 0.2

    @pytest.mark.parametrize(
        ("delta", "kind", "label"),
        [
            (2.1, "drift", "drift"),
            (1.9, "drift", "drift or step"),
            (-1.9, "step", "drift or step"),
            (-2.1, "step", "step"),
        ],
    )
    def test_a_difference_of_two_prefers_a_kind_of_change(self, monkeypatch, delta, kind, label):
        y = np.where(np.arange(12) >= 5, 3.0, 0.0) + 0.1 * noise(6)
        n = math.log(12)
        monkeypatch.setattr(_population, "_p_step", lambda *a: 0.5)
        monkeypatch.setattr(
            _population, "_deviance", lambda y, u2, design: delta - n if len(set(design[:, 1])) == 2 else 0.0
        )
        found = _population._tests(y, np.full(12, 0.01), TIMES, ALL, np.random.default_rng(0))
        assert (found.kind, found.label, found.place) == (kind, label, 5)
        assert found.delta_bic == pytest.approx(delta)
        assert found.size == pytest.approx(y[5:].mean() - y[:5].mean(), rel=1e-3)


class TestOutlying:
    def data(self, size, n=20, p=1):
        y = np.random.default_rng(9).standard_normal((n, p))
        y[4] = size
        return y, np.tile(1e-6 * np.eye(p), (n, 1, 1)), np.arange(float(n)), np.ones((n, p), dtype=bool)

    def test_the_distance_of_a_run_has_the_distribution_of_hotelling(self, monkeypatch):
        monkeypatch.setattr(_population, "_best", lambda *a: ("", 0))
        y, c, times, known = self.data([3.6, -3.0], p=2)
        out, chosen, p = _population._left_out(y, c, times, known)
        assert not out.any()
        assert chosen == [("", 0)] * 2
        t = np.cov(y.T)
        r = y - y.mean(axis=0)
        distance = np.einsum("ij,jk,ik->i", r, np.linalg.inv(t), r)
        expected = np.minimum(20 * stats.f.sf(distance * 18 / (2 * 19), 2, 18), 1.0)
        assert p == pytest.approx(expected, rel=0.02)
        assert expected.min() < 0.9

    def test_at_most_a_fifth_of_the_runs_is_left_out(self):
        y, c, times, known = self.data(0.0)
        y *= 0.01
        y[[5, 9, 12, 16]] = [[-31.0], [32.0], [-33.0], [34.0]]
        out, _, p = _population._left_out(y, c, times, known)
        assert np.flatnonzero(out).tolist() == [5, 9, 12, 16]
        assert (p[out] < 1e-3).all()
        assert (p[~out] > 0.01).all()
        out, _, _ = _population._left_out(y[:19], c[:19], times[:19], known[:19])
        assert out.sum() <= 3


class TestSpread:
    def test_one_parameter_has_the_closed_form(self):
        y, c = noise(5)[:, None], np.full((12, 1, 1), 0.1)
        t, errors, beta = _population._reml(y, c, [np.ones((12, 1))])
        s2 = np.var(y, ddof=1)
        assert t[0, 0] == pytest.approx(s2 - 0.1, rel=1e-3)
        assert (errors[0][0], beta[0][0]) == pytest.approx((math.sqrt(s2 / 12), y.mean()), rel=1e-3)
        design = _population._columns("drift", 0, TIMES, ALL)
        t, errors, beta = _population._reml(y, c, [design])
        line = stats.linregress(TIMES, y[:, 0])
        assert beta[0][1] == pytest.approx(line.slope, rel=1e-4)
        assert errors[0][1] == pytest.approx(line.stderr, rel=1e-3)

    def test_the_uncertainty_is_that_of_the_expected_information(self):
        t = np.array([[4.0]])
        assert _population._spread_u(np.full((50, 1, 1), 1.0), t) == pytest.approx(
            [5.0 * math.sqrt(2 / 50) / 4.0]
        )
        # near zero, it is the root of the uncertainty of the square
        small = np.array([[0.01]])
        assert _population._spread_u(np.full((50, 1, 1), 1.0), small) == pytest.approx(
            [math.sqrt(1.01 * math.sqrt(2 / 50))]
        )

    def test_two_parameters_have_the_information_of_their_covariance(self):
        t = np.array([[4.0, 1.0], [1.0, 3.0]])
        v = t + 0.5 * np.eye(2)
        found = _population._spread_u(np.tile(0.5 * np.eye(2), (40, 1, 1)), t)
        expected = [math.sqrt(2 / 40) * v[j, j] / (2 * math.sqrt(t[j, j])) for j in range(2)]
        assert found == pytest.approx(expected)


class TestPopulation:
    def found(self, y, c, **more):
        n, p = y.shape
        return population(
            [f"p{j}" for j in range(p)],
            ["s"] * p,
            [f"r{i}" for i in range(n)],
            np.arange(float(n)),
            y,
            c,
            **more,
        )

    @pytest.mark.parametrize(
        ("n", "missing", "tested"), [(8, 0, True), (9, 2, False), (9, 1, True), (20, 4, True), (20, 5, False)]
    )
    def test_a_parameter_needs_eight_runs_and_four_fifths_of_all(self, monkeypatch, n, missing, tested):
        monkeypatch.setattr(_population, "_SETS", 200)
        y = np.random.default_rng(1).standard_normal((n, 1))
        c = np.full((n, 1, 1), 0.1)
        c[:missing] = np.inf
        got = self.found(y, c)
        assert got.untested == ({} if tested else {"p0": missing})
        assert [p.runs for p in got.parameters] == ([n - missing] if tested else [])
        if tested:
            assert np.isnan(got.stderr[:, 0]).sum() == missing
            assert got.stderr[missing:, 0] == pytest.approx(math.sqrt(0.1))
            assert got.parameters[0].mean == pytest.approx(y[missing:].mean(), rel=1e-3, abs=1e-3)

    def test_equal_values_are_scaled_by_their_uncertainty(self, monkeypatch):
        monkeypatch.setattr(_population, "_SETS", 200)
        got = self.found(np.full((9, 1), 7e-9), np.full((9, 1, 1), 4e-22))
        (p,) = got.parameters
        assert p.mean == pytest.approx(7e-9)
        assert p.mean_u == pytest.approx(2e-11 / 3, rel=1e-2)
        assert p.change is None

    def test_correlations_are_those_of_spreads_above_zero(self, monkeypatch):
        monkeypatch.setattr(_population, "_SETS", 200)
        x = np.random.default_rng(7).standard_normal((20, 2))
        y = np.stack([x[:, 0], x[:, 0] + 0.5 * x[:, 1]], axis=1)
        got = self.found(y, np.tile(1e-6 * np.eye(2), (20, 1, 1)))
        assert got.correlation == pytest.approx(np.corrcoef(y.T), abs=0.01)

    def test_an_outlying_run_is_not_the_run_before_a_step(self, monkeypatch):
        monkeypatch.setattr(_population, "_SETS", 2000)
        y = 0.1 * np.random.default_rng(7).standard_normal((24, 1))
        y[12:] += 2.0
        y[11] = 30.0
        got = self.found(y, np.full((24, 1, 1), 1e-4))
        assert [name for name, _ in got.outlying] == ["r11"]
        c = got.parameters[0].change
        assert (c.kind, c.before, c.after, c.time) == ("step", "r10", "r12", 11.0)
        assert got.parameters[0].runs == 23

    @pytest.mark.parametrize(
        ("p_values", "adjusted", "changed"),
        [
            # Holm: the smallest of four is multiplied by 4, the next one by 3, and so on
            ([(0.001, 0.9), (0.9, 0.01)], (0.004, 0.03), (True, True)),
            ([(0.9, 0.002), (0.9, 0.03)], (0.008, 0.09), (True, False)),
            ([(0.9, 0.9), (0.013, 0.9)], (1.0, 0.052), (False, False)),
            ([(0.9, 0.9), (0.012, 0.9)], (1.0, 0.048), (False, True)),
        ],
    )
    def test_the_more_significant_test_of_a_parameter_counts(self, monkeypatch, p_values, adjusted, changed):
        given = iter(p_values)

        def tests(y, u2, times, used, rng):
            drift, step = next(given)
            return _population._Tests(drift, step, "step", "step", 10, 0.1, 0.2, 0.3, 0.4, 5.0)

        monkeypatch.setattr(_population, "_tests", tests)
        y = np.random.default_rng(3).standard_normal((20, 2))
        got = self.found(y, np.tile(0.1 * np.eye(2), (20, 1, 1)), level=0.05)
        scale = y.std(axis=0)
        assert [p.p_adjusted for p in got.parameters] == pytest.approx(adjusted)
        assert [(p.p_drift, p.p_step) for p in got.parameters] == p_values
        assert [p.change is not None for p in got.parameters] == list(changed)
        assert got.changed == tuple(p for p, c in zip(got.parameters, changed, strict=True) if c)
        for p, s in zip(got.parameters, scale, strict=True):
            if p.change is not None:
                c = p.change
                assert (c.slope, c.slope_u, c.size, c.size_u) == pytest.approx(
                    (0.1 * s, 0.2 * s, 0.3 * s, 0.4 * s)
                )
                assert (c.time, c.before, c.after, c.delta_bic) == (9.5, "r9", "r10", 5.0)

    def test_runs_are_in_the_order_of_their_times(self, monkeypatch):
        monkeypatch.setattr(_population, "_SETS", 200)
        y = np.random.default_rng(5).standard_normal((9, 1))
        times = np.array([3.0, 1, 2, 9, 8, 7, 4, 5, 6])
        c = 0.1 + 0.01 * np.arange(9.0)[:, None, None]
        got = population(["p"], ["s"], [f"r{i}" for i in range(9)], times, y, c, time_unit="h")
        order = np.argsort(times)
        assert got.runs == tuple(f"r{i}" for i in order)
        assert got.times.tolist() == sorted(times)
        assert got.values[:, 0] == pytest.approx(y[order, 0])
        assert got.stderr[:, 0] == pytest.approx(np.sqrt(c[order, 0, 0]))
        assert got.time_unit == "h"

    def test_without_parameters_there_is_only_the_list_of_runs(self):
        got = self.found(np.full((9, 1), np.nan), np.ones((9, 1, 1)))
        assert (got.parameters, got.untested, len(got.runs)) == ((), {"p0": 9}, 9)


class TestOfFits:
    def fit(self, **estimates):
        made = {k.replace("__", "."): Estimate(*e) for k, e in estimates.items()}
        return SimpleNamespace(model=Model.of(["casing.air.linear"]), estimates=made)

    def test_parameters_of_cases_belong_to_their_runs(self):
        one = self.fit(**{"a@x": (1.0, 0.1, "s", False), "a@y": (1.0, 0.1, "s", False)})
        two = self.fit(a=(1.0, 0.1, "s", False), initial__omega_c=(1.0, 0.1, "s", False))
        assert list(compared_parameters({"m": one, "n": two})) == [
            ("m", "m:x", "a", "a@x"),
            ("m", "m:y", "a", "a@y"),
            ("n", "n", "a", "a"),
        ]

    def test_values_and_covariances_are_those_of_the_runs(self, monkeypatch):
        seen = {}

        def kept(names, units, runs, times, values, covariances, **more):
            seen.update(names=names, times=times, values=values, c=covariances, runs=runs, **more)

        monkeypatch.setattr(_population, "population", kept)
        fits = {}
        for i in range(8):
            f = self.fit(a=(1.0 + i, 0.1, "s", False), b=(2.0, 0.2, "m", False))
            f.variables, f.covariance = ["b", "a"], [[0.04, 0.003], [0.003, 0.01]]
            fits[f"r{i}"] = f
        fits["r1"].estimates["b"] = Estimate(2.0, 0.2, "m", at_bound=True)
        fits["r2"].estimates["b"] = Estimate(2.0, 0.0, "m", at_bound=False)
        fits["r3"].estimates["b"] = Estimate(2.0, math.inf, "m", at_bound=False)
        del fits["r4"].estimates["b"]
        fits["r5"].variables = ["a"]
        population_of(fits, level=0.05)
        assert seen["times"].tolist() == [1.0, 2, 3, 4, 5, 6, 7, 8]
        assert (seen["names"], seen["level"]) == (["a", "b"], 0.05)
        assert seen["values"][:, 0].tolist() == [1.0, 2, 3, 4, 5, 6, 7, 8]
        assert np.isfinite(seen["values"][:, 1]).tolist() == [
            True,
            False,
            False,
            False,
            False,
            True,
            True,
            True,
        ]
        assert seen["c"][0] == pytest.approx(np.array([[0.01, 0.003], [0.003, 0.04]]))
        assert seen["c"][5] == pytest.approx(np.array([[0.01, 0.0], [0.0, 0.04]]))
        population_of(fits, {f"r{i}": 10.0 - i for i in range(8)})
        assert seen["times"].tolist() == [10.0, 9, 8, 7, 6, 5, 4, 3]
        del fits["r0"]
        assert population_of(fits) is None


class TestSpreadOfFew:
    X, U = np.array([1.0, 2.0, 4.0]), np.array([0.1, 0.2, 0.4])

    def test_the_sum_of_squares_is_weighted_with_the_spread(self):
        w = 1 / (self.U**2 + 0.25)
        assert _comparison._q(self.X, self.U, 0.5) == pytest.approx(
            np.sum(w * (self.X - np.average(self.X, weights=w)) ** 2)
        )

    @pytest.mark.parametrize("target", [0.001, 2.0, 20.0])
    def test_at_the_spread_it_is_the_target(self, target):
        assert _comparison._q(self.X, self.U, _comparison._spread(self.X, self.U, target)) == pytest.approx(
            target
        )

    def test_above_its_largest_value_there_is_no_spread(self):
        largest = _comparison._q(self.X, self.U, 0.0)
        assert _comparison._spread(self.X, self.U, 1.01 * largest) == 0.0
        assert _comparison._spread(self.X, self.U, 0.99 * largest) > 0.0

    def test_a_comparison_follows_from_the_runs(self):
        runs = [Repeat(f"r{i}", x, u) for i, (x, u) in enumerate(zip(self.X, self.U, strict=True))]
        p = _comparison._compared("a", "s", runs)
        assert p.difference_sigma is None
        assert p.p_value == pytest.approx(stats.chi2.sf(_comparison._q(self.X, self.U, 0.0), 2))
        assert _comparison._q(self.X, self.U, p.spread) == pytest.approx(2.0)
        one_sigma = math.erf(math.sqrt(0.5))
        for spread, tail in zip(p.spread_interval, ((1 + one_sigma) / 2, (1 - one_sigma) / 2), strict=True):
            assert stats.chi2.cdf(_comparison._q(self.X, self.U, spread), 2) == pytest.approx(tail, abs=1e-3)
        w = 1 / (self.U**2 + p.spread**2)
        assert (p.mean, p.mean_u) == pytest.approx((np.average(self.X, weights=w), w.sum() ** -0.5))
        assert p.total(runs[1]) == pytest.approx(math.hypot(0.2, p.spread))

    @pytest.mark.parametrize(("count", "differs"), [(1, True), (2, False)])
    def test_significance_is_corrected_for_the_number_of_parameters(self, count, differs):
        # 2.7 standard uncertainties have the probability 0.0069
        def fit(shift):
            names = ["a", "b"][:count]
            made = {n: Estimate(1.0 + (shift if n == "a" else 0.0), 1.0, "s", at_bound=False) for n in names}
            return SimpleNamespace(model=Model.of(["casing.air.linear"]), estimates=made)

        found = compare({"x": fit(0.0), "y": fit(2.7 * math.sqrt(2))})
        assert [p.name for p in found.parameters] == ["a", "b"][:count]
        assert ("differs between the runs" in found.sentences[0]) is differs

    def test_twelve_runs_are_listed(self):
        assert _comparison._listed([str(i) for i in range(12)]).count(",") == 11
        assert "more" not in _comparison._listed([str(i) for i in range(12)])
        assert _comparison._listed([str(i) for i in range(14)]).endswith("11 and 2 more")
