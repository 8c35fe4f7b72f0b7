"""The parts of a population of runs one by one, against regressions, dense matrices and quantiles."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from fitting import Estimate, Model
from fitting.comparison import _comparison
from fitting.comparison import _population as module
from fitting.comparison._comparison import Repeat, compare
from fitting.comparison._population import compared_parameters, population, population_of

ALL = np.ones(12, dtype=bool)
TIMES = np.array([0.0, 1, 2, 4, 5, 7, 8, 10, 13, 14, 15, 20])


def noise(seed=0, n=12):
    return np.random.default_rng(seed).standard_normal(n)


class TestColumns:
    def test_a_constant_has_one_column(self):
        assert module._columns("", 0, TIMES, ALL).tolist() == [[1.0]] * 12

    def test_drift_and_step_are_centred_on_the_runs_inside(self):
        inside = ALL.copy()
        inside[[0, 3, 11]] = False
        drift = module._columns("drift", 0, TIMES, inside)
        assert drift[:, 1] == pytest.approx(TIMES - TIMES[inside].mean())
        step = module._columns("step", 6, TIMES, inside)
        # nine runs are inside, and five of them (6 to 10) are after the step
        assert step[:, 1] == pytest.approx(np.where(np.arange(12) >= 6, 1.0, 0.0) - 5 / 9)
        assert (step[:, 0] == 1).all()

    def test_undetermined_values_have_the_mean_and_no_weight(self):
        y = np.array([[1.0, 5.0], [3.0, np.nan], [np.nan, 9.0]])
        c = np.tile(np.array([[0.1, 0.05], [0.05, 0.2]]), (3, 1, 1))
        c[1, 1, :] = c[1, :, 1] = np.nan
        filled, cov = module._filled(y, c, np.isfinite(y))
        assert filled.tolist() == [[1.0, 5.0], [3.0, 7.0], [2.0, 9.0]]
        assert cov[0].tolist() == [[0.1, 0.05], [0.05, 0.2]]
        assert cov[1].tolist() == [[0.1, 0.0], [0.0, 1e10]]
        assert cov[2].tolist() == [[1e10, 0.0], [0.0, 0.2]]
        assert np.isnan(c[1, 1, 1])

    def test_the_median_is_over_seven_neighbours_on_each_side(self):
        y = np.arange(30.0) ** 2
        found = module._running_median(y)
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
        assert module._coefficient(y, w, design) == pytest.approx((beta[1], math.sqrt(gram[1, 1]), 10))
        # a scatter above the uncertainties counts
        large = module._coefficient(10 * y, w, design)
        assert large == pytest.approx((10 * beta[1], math.sqrt(100 * chi2 * gram[1, 1]), 10))
        assert 100 * chi2 > 1

    def test_the_spread_of_equal_weights_is_the_sample_variance_less_that_of_the_fit(self):
        y, u2 = noise(2), np.full(12, 0.2)
        w, spread = module._weights(y, u2, np.ones((12, 1)))
        assert spread == pytest.approx(np.var(y, ddof=1) - 0.2, rel=5e-3)
        assert w == pytest.approx(1 / (0.2 + spread))
        design = np.column_stack([np.ones(12), TIMES])
        rest = y - design @ np.linalg.lstsq(design, y, rcond=None)[0]
        assert module._weights(y, u2, design)[1] == pytest.approx(rest @ rest / 10 - 0.2, rel=1e-2)

    def test_scatter_below_the_uncertainties_adds_nothing(self):
        w, spread = module._weights(0.1 * noise(2), np.full(12, 1.0), np.ones((12, 1)))
        assert spread < 1e-4
        assert w == pytest.approx(np.ones(12), rel=1e-3)

    def test_the_deviance_is_that_of_normal_variables(self):
        y, u2 = noise(3), np.linspace(0.1, 0.3, 12)
        design = np.ones((12, 1))
        w, _ = module._weights(y, u2, design)
        mean = w @ y / w.sum()
        expected = -2 * stats.norm.logpdf(y, mean, w**-0.5).sum() - 12 * math.log(2 * math.pi)
        assert module._deviance(y, u2, design) == pytest.approx(expected)


class TestStep:
    def test_weighted_statistics_are_ratios_of_sums_of_squares(self):
        y, w = noise(4), np.linspace(1.0, 3.0, 12)
        f, largest = module._step_statistics(y, w)
        assert len(f) == 7
        whole = np.sum(w * (y - w @ y / w.sum()) ** 2)
        for k, value in enumerate(f):
            parts = (slice(0, k + 3), slice(k + 3, 12))
            rest = sum(np.sum(w[p] * (y[p] - w[p] @ y[p] / w[p].sum()) ** 2) for p in parts)
            assert value == pytest.approx((whole - rest) / (rest / 10))
        assert largest == f.max()
        many, most = module._step_statistics(np.stack([y, 2 * y + 5]), w)
        assert many[1] == pytest.approx(f)
        assert most == pytest.approx(np.full(2, largest))

    def test_the_probability_counts_larger_simulated_steps(self, monkeypatch):
        monkeypatch.setattr(module, "_SETS", 50)
        largest = iter([np.arange(30.0), np.arange(20.0)])
        monkeypatch.setattr(module, "_AT_A_TIME", 12 * 30)
        monkeypatch.setattr(module, "_step_statistics", lambda sets, w: (None, next(largest)))
        # 5 of 30 and none of 20 are at least 25
        assert module._p_step(25.0, np.ones(12), np.random.default_rng(0)) == pytest.approx(6 / 51)
        largest = iter([np.arange(30.0), np.arange(20.0)])
        assert module._p_step(40.0, np.ones(12), np.random.default_rng(0)) == pytest.approx(
            min(1 / 51, 7 * stats.f.sf(40.0, 1, 10))
        )
        largest = iter([np.arange(30.0), np.arange(20.0)])
        monkeypatch.setattr(module, "_ENOUGH", 4)
        assert module._p_step(25.0, np.ones(12), np.random.default_rng(0)) == pytest.approx(6 / 31)
        largest = iter([np.arange(30.0), np.arange(20.0)])
        monkeypatch.setattr(module, "_ENOUGH", 5)
        assert module._p_step(25.0, np.ones(12), np.random.default_rng(0)) == pytest.approx(6 / 51)

    def test_adjusted_probabilities_grow_with_the_rank_and_end_at_one(self):
        assert module._holm(np.array([0.5, 0.001, 0.4, 0.02])) == pytest.approx([0.8, 0.004, 0.8, 0.06])
        assert module._holm(np.array([0.9, 0.8])) == pytest.approx([1.0, 1.0])

    @pytest.mark.parametrize(
        ("shape", "kind"),
        [(np.zeros(12), ""), (TIMES / 4, "drift"), (np.where(np.arange(12) >= 5, 3.0, 0.0), "step")],
    )
    def test_the_mean_model_of_least_bic_is_chosen(self, shape, kind):
        y, u2 = shape + 0.1 * noise(6), np.full(12, 0.01)
        chosen = module._best(y, u2, TIMES, ALL)
        assert chosen == (kind, 5 if kind == "step" else 0)

    def test_bic_counts_drift_and_step_with_one_and_two_parameters(self, monkeypatch):
        n = math.log(12)

        def chosen(constant, step, drift):
            monkeypatch.setattr(
                module,
                "_deviance",
                lambda y, u2, design: (
                    constant if design.shape[1] == 1 else step if len(set(design[:, 1])) == 2 else drift
                ),
            )
            return module._best(noise(1), np.ones(12), TIMES, ALL)[0]

        assert chosen(0.0, -1.9 * n, -0.9 * n) == ""
        assert chosen(0.0, -1.9 * n, -1.1 * n) == "drift"
        assert chosen(0.0, -2.1 * n, -0.9 * n) == "step"
        assert chosen(0.0, -3.1 * n, -2.0 * n) == "step"
        assert chosen(0.0, -2.9 * n, -2.0 * n) == "drift"

    def test_runs_at_the_same_time_do_not_drift(self):
        y, u2 = np.where(np.arange(12) >= 5, 3.0, 0.0) + 0.1 * noise(6), np.full(12, 0.01)
        assert module._best(y, u2, np.ones(12), ALL) == ("step", 5)
        found = module._tests(y, u2, np.ones(12), ALL, np.random.default_rng(0))
        assert (found.p_drift, found.slope, found.slope_u, found.kind) == (1.0, 0.0, 0.0, "step")

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_a_drift_has_the_probability_of_student(self, sign):
        y, u2 = sign * noise(8), np.full(12, 1e-12)
        found = module._tests(y, u2, TIMES, ALL, np.random.default_rng(0))
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
        monkeypatch.setattr(module, "_p_step", lambda *a: 0.5)
        monkeypatch.setattr(
            module, "_deviance", lambda y, u2, design: delta - n if len(set(design[:, 1])) == 2 else 0.0
        )
        found = module._tests(y, np.full(12, 0.01), TIMES, ALL, np.random.default_rng(0))
        assert (found.kind, found.label, found.place) == (kind, label, 5)
        assert found.delta_bic == pytest.approx(delta)
        assert found.size == pytest.approx(y[5:].mean() - y[:5].mean(), rel=1e-3)


class TestOutlying:
    def data(self, size, n=20, p=1):
        y = np.random.default_rng(9).standard_normal((n, p))
        y[4] = size
        return y, np.tile(1e-6 * np.eye(p), (n, 1, 1)), np.arange(float(n)), np.ones((n, p), dtype=bool)

    def test_the_distance_of_a_run_has_the_distribution_of_hotelling(self, monkeypatch):
        monkeypatch.setattr(module, "_best", lambda *a: ("", 0))
        y, c, times, known = self.data([3.6, -3.0], p=2)
        out, chosen, p = module._left_out(y, c, times, known)
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
        out, _, p = module._left_out(y, c, times, known)
        assert np.flatnonzero(out).tolist() == [5, 9, 12, 16]
        assert (p[out] < 1e-3).all()
        assert (p[~out] > 0.01).all()
        out, _, _ = module._left_out(y[:19], c[:19], times[:19], known[:19])
        assert out.sum() <= 3


class TestSpread:
    def test_one_parameter_has_the_closed_form(self):
        y, c = noise(5)[:, None], np.full((12, 1, 1), 0.1)
        t, errors, beta = module._reml(y, c, [np.ones((12, 1))])
        s2 = np.var(y, ddof=1)
        assert t[0, 0] == pytest.approx(s2 - 0.1, rel=1e-3)
        assert (errors[0][0], beta[0][0]) == pytest.approx((math.sqrt(s2 / 12), y.mean()), rel=1e-3)
        design = module._columns("drift", 0, TIMES, ALL)
        t, errors, beta = module._reml(y, c, [design])
        line = stats.linregress(TIMES, y[:, 0])
        assert beta[0][1] == pytest.approx(line.slope, rel=1e-4)
        assert errors[0][1] == pytest.approx(line.stderr, rel=1e-3)

    def test_the_uncertainty_is_that_of_the_expected_information(self):
        t = np.array([[4.0]])
        assert module._spread_u(np.full((50, 1, 1), 1.0), t) == pytest.approx([5.0 * math.sqrt(2 / 50) / 4.0])
        # near zero, it is the root of the uncertainty of the square
        small = np.array([[0.01]])
        assert module._spread_u(np.full((50, 1, 1), 1.0), small) == pytest.approx(
            [math.sqrt(1.01 * math.sqrt(2 / 50))]
        )

    def test_two_parameters_have_the_information_of_their_covariance(self):
        t = np.array([[4.0, 1.0], [1.0, 3.0]])
        v = t + 0.5 * np.eye(2)
        found = module._spread_u(np.tile(0.5 * np.eye(2), (40, 1, 1)), t)
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
        monkeypatch.setattr(module, "_SETS", 200)
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
        monkeypatch.setattr(module, "_SETS", 200)
        got = self.found(np.full((9, 1), 7e-9), np.full((9, 1, 1), 4e-22))
        (p,) = got.parameters
        assert p.mean == pytest.approx(7e-9)
        assert p.mean_u == pytest.approx(2e-11 / 3, rel=1e-2)
        assert p.change is None

    def test_correlations_are_those_of_spreads_above_zero(self, monkeypatch):
        monkeypatch.setattr(module, "_SETS", 200)
        x = np.random.default_rng(7).standard_normal((20, 2))
        y = np.stack([x[:, 0], x[:, 0] + 0.5 * x[:, 1]], axis=1)
        got = self.found(y, np.tile(1e-6 * np.eye(2), (20, 1, 1)))
        assert got.correlation == pytest.approx(np.corrcoef(y.T), abs=0.01)

    def test_an_outlying_run_is_not_the_run_before_a_step(self, monkeypatch):
        monkeypatch.setattr(module, "_SETS", 2000)
        y = 0.1 * np.random.default_rng(7).standard_normal((24, 1))
        y[12:] += 2.0
        y[11] = 30.0
        got = self.found(y, np.full((24, 1, 1), 1e-4))
        assert [name for name, _ in got.outlying] == ["r11"]
        c = got.parameters[0].change
        assert (c.kind, c.before, c.after, c.time) == ("step", "r10", "r12", 11.0)
        assert got.parameters[0].runs == 23

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

        monkeypatch.setattr(module, "population", kept)
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
