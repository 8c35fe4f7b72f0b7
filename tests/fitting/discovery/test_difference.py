"""Dependence on variables against dense matrices; parameters that differ between recordings; smooth torques."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from fitting import Estimate
from fitting._criteria import DEFAULT
from fitting.discovery import _dependence, _difference
from fitting.discovery._dependence import Dependence, dependence
from fitting.discovery._difference import (
    DifferentParameter,
    SeparateValues,
    ValuesPerRecording,
    different_parameter,
    improves_on_difference,
    penalised,
)

RNG = np.random.default_rng(4)
TIME = np.linspace(0.0, 30.0, 40)
MOTION = {
    "t": TIME,
    "omega_r": 900.0 * np.exp(-TIME / 20.0),
    "omega_c": 60.0 * np.sin(TIME / 12.0),
    "delta": 900.0 * np.exp(-TIME / 20.0) - 60.0 * np.sin(TIME / 12.0),
}


class Case:
    """Forty cells; the rows of the casing and of the rotor respond differently, and a further row does not."""

    response = SimpleNamespace(casing=RNG.standard_normal((70, 40)), rotor=RNG.standard_normal((70, 40)))

    def __init__(self, names=("k", "phi")):
        self.laws, self.sizes = [], {}

    @staticmethod
    def along_motion(variable):
        return MOTION[variable]

    @staticmethod
    def padded(columns):
        return np.concatenate([columns, np.zeros((1, columns.shape[1]))])

    def trials(self, law):
        self.laws.append(law)
        n = int(law.name.rpartition(".")[2])
        return [SimpleNamespace(columns=np.full((3, 2), n) * [1.0, 10.0])]


def about(parts=("casing", "rotor"), angle=None):
    data = SimpleNamespace(record=SimpleNamespace(parts=frozenset(parts)), measured_angle=angle)
    return SimpleNamespace(problem=SimpleNamespace(data=[data]))


class TestFunctions:
    def test_each_body_has_its_variables_and_pairs(self):
        tests = list(_dependence._tests(about(), [Case(), Case()]))
        assert [(t.body, t.variables) for t in tests] == [
            ("casing", ("omega_c",)),
            ("casing", ("omega_r",)),
            ("casing", ("t",)),
            ("casing", ("omega_c", "omega_r")),
            ("casing", ("omega_c", "t")),
            ("bearing", ("delta",)),
            ("bearing", ("t",)),
            ("bearing", ("delta", "t")),
            ("bearing", ("delta", "omega_c")),
            ("rotor", ("omega_r",)),
            ("rotor", ("t",)),
        ]
        response = Case.response
        acting = {
            "casing": response.casing,
            "rotor": response.rotor,
            "bearing": response.casing - response.rotor,
        }
        for test in tests:
            w, values = acting[test.body], [MOTION[v] for v in test.variables]
            assert test.columns.shape[0] == 142
            assert not test.columns[[70, 141]].any()
            rows = test.columns[:70]
            assert (test.columns[71:141] == rows).all()
            # ten splines of one variable, four of each of two variables, 36 of a curve
            assert rows.shape[1] == (10 if len(values) == 1 else 16)
            assert test.fine.shape[1] == (36 if len(values) == 1 else 16)
            # the functions add up to 1, and a cubic of each variable is a sum of them
            assert rows.sum(axis=1) == pytest.approx(w.sum(axis=1))
            for f in (*values, *(v**3 for v in values), np.prod(values, axis=0)):
                rest = w @ f - rows @ np.linalg.lstsq(rows, w @ f, rcond=1e-12)[0]
                assert np.linalg.norm(rest) < 1e-6 * np.linalg.norm(w @ f)
            if len(values) == 2:
                assert (len(test.value), test.priors) == (0, ())
                assert test.fine is test.columns
                assert test.basis.shape == (0, rows.shape[1])
            else:
                (v,) = values
                assert test.value == pytest.approx(np.linspace(v.min(), v.max(), 120))
                assert test.basis.shape == (120, test.fine.shape[1])
                assert test.fine.shape[1] > rows.shape[1]
                c = np.linalg.lstsq(test.basis, test.value**2, rcond=None)[0]
                assert test.fine[:70] @ c == pytest.approx(
                    w @ v**2, rel=1e-6, abs=1e-6 * np.abs(w @ v**2).max()
                )
                assert len(test.priors) == 9

    def test_a_body_alone_has_no_rotor(self):
        tests = list(_dependence._tests(about(("casing",)), [Case()]))
        assert [(t.body, t.variables) for t in tests] == [
            ("casing", ("omega_c",)),
            ("casing", ("t",)),
            ("casing", ("omega_c", "t")),
        ]

    def test_the_prior_of_the_coefficients_is_that_of_matern(self):
        priors = _dependence._Axis(np.array([0.0, 8.0]), 12).priors()
        assert len(priors) == 9
        knots = np.concatenate([[0.0] * 3, np.linspace(0.0, 8.0, 10), [8.0] * 3])
        centres = np.array([knots[i + 1 : i + 4].mean() for i in range(12)])
        for length, prior in zip(np.geomspace(0.03, 3.0, 9) * 8.0, priors, strict=True):
            r = np.sqrt(3) * np.abs(centres[:, None] - centres) / length
            assert prior == pytest.approx((1 + r) * np.exp(-r))


class TestAngles:
    def test_the_angle_of_the_casing_has_a_curve_over_a_turn(self):
        cases = [Case(), Case()]
        test = _dependence._angle_test(cases, "casing", "psi_c", (1, 3))
        assert [e.name for e in cases[0].laws] == ["harmonic.1", "harmonic.3"]
        for law, n in zip(cases[0].laws, (1, 3), strict=True):
            assert law.joint == "casing"
            at = {"psi_c": 0.4, "phi": 0.3, "k": 2.0}
            assert module_value(law, at) == pytest.approx(2.0 * np.sin(n * 0.4 - 0.3))
        assert test.columns.tolist() == [[1.0, 10.0, 3.0, 30.0]] * 6
        assert test.fine is test.columns
        psi = np.linspace(0.0, 2 * np.pi, 120)
        assert test.value == pytest.approx(psi)
        expected = [np.sin(psi), np.sin(psi - np.pi / 2), np.sin(3 * psi), np.sin(3 * psi - np.pi / 2)]
        assert test.basis == pytest.approx(np.transpose(expected))
        ((prior),) = test.priors
        assert (prior == np.eye(4)).all()

    def test_each_recording_has_its_own_phase_of_the_rotor(self):
        test = _dependence._angle_test([Case(), Case()], "rotor", "psi_r", (2,))
        rows = [[2.0, 20.0, 0.0, 0.0]] * 3 + [[0.0, 0.0, 2.0, 20.0]] * 3
        assert test.columns.tolist() == rows
        assert (len(test.value), test.priors, test.basis.shape) == (0, (), (0, 4))

    def test_they_are_tested_where_the_angle_is_known(self, monkeypatch):
        monkeypatch.setattr(
            _dependence, "_orders", lambda found, angle: {"psi_c": (1, 2), "psi_r": ()}[angle]
        )
        tests = list(_dependence._tests(about(), [Case()]))
        angles = [(t.body, t.columns.shape[1]) for t in tests if t.variables == ("psi_c",)]
        assert angles == [("casing", 4)]
        assert not [t for t in tests if t.variables == ("psi_r",)]


def module_value(law, at):
    from fitting.effects._expression import Tape

    return float(Tape([law.expression])(at)[0])


class TestCurve:
    """A torque of five functions of which the base absorbs one direction."""

    ROWS, FINE = 40, 5

    def setting(self, noise, seed=0, weak=0.02):
        rng = np.random.default_rng(seed)
        fine = rng.standard_normal((self.ROWS, self.FINE)) * [30.0, 20.0, 10.0, 1.0, weak]
        gain = rng.uniform(0.5, 2.0, self.ROWS)
        basis = np.linalg.qr(rng.standard_normal((self.ROWS, 2)))[0]
        white = gain[:, None] * (2.0 * fine)
        response = white - basis @ (basis.T @ white)
        residual = response @ [1.0, -2.0, 0.5, 0.3, 0.0] + noise * rng.standard_normal(self.ROWS)
        residual = residual - basis @ (basis.T @ residual)
        value = np.linspace(0.0, 1.0, 7)
        shapes = np.stack([np.ones(7), value, value**2, value**3, value**4], axis=1)
        apart = np.abs(np.arange(5)[:, None] - np.arange(5))
        priors = (np.eye(5), np.exp(-apart / 2.0))
        context = SimpleNamespace(rotated=lambda x: 2.0 * x)
        level = SimpleNamespace(gain=gain, basis=basis, residual=residual)
        test = _dependence._Test("casing", ("t",), fine, fine, value, shapes, priors)
        return context, level, test, response

    def expected(self, level, test, response):
        free = np.linalg.qr(response)[0]
        rest = level.residual - free @ (free.T @ level.residual)
        scatter = max(1.0, rest @ rest / (self.ROWS - 2 - 5))
        best = None
        for prior in test.priors:
            root = np.linalg.cholesky(prior)
            a, r = response @ root / np.sqrt(scatter), level.residual / np.sqrt(scatter)
            u, s, vt = np.linalg.svd(a, full_matrices=False)
            unit = max(1.0, np.sqrt(np.mean((u.T @ r) ** 2))) / s[0]
            for strength in np.geomspace(1e-3, 1e5, 33) * unit:
                c = np.eye(self.ROWS) + strength**2 * a @ a.T
                deviance = np.linalg.slogdet(c)[1] + r @ np.linalg.solve(c, r)
                if best is None or deviance < best[0]:
                    known = strength**2 * s**2 > 1
                    back = test.basis @ root @ (vt[known].T / s[known]) @ u[:, known].T
                    best = deviance, back, back @ r, np.sqrt(scatter), known.sum()
        return best

    @pytest.mark.parametrize(
        ("noise", "weak", "rough"),
        [(1.0, 0.02, False), (0.2, 0.02, False), (6.0, 0.02, True), (1.0, 0.06, False)],
    )
    def test_it_is_the_determined_part_at_the_most_likely_strength(self, noise, weak, rough):
        context, level, test, response = self.setting(noise, weak=weak)
        _, back, torque, scatter, known = self.expected(level, test, response)
        assert known == (5 if weak > 0.02 else 4 if noise <= 1.0 else known)
        assert bool(scatter > 2.0) is rough
        found, sigma, identified = _dependence._curve(context, level, test)
        assert found == pytest.approx(torque, rel=1e-4)
        assert sigma == pytest.approx(np.linalg.norm(back, axis=1), rel=1e-4)
        # the part of another torque that these data would show
        other = np.array([3.0, -1.0, 2.0, 0.7, 1.0])
        shown = back @ (response @ other) / scatter
        assert identified @ (test.basis @ other) == pytest.approx(shown, rel=1e-4)

    def test_pairs_and_harmonics_of_the_rotor_have_none(self):
        context, level, test, _ = self.setting(1.0)
        for changed in (test._replace(value=np.zeros(0)), test._replace(priors=())):
            assert [x.shape for x in _dependence._curve(context, level, changed)] == [(0,), (0,), (0, 0)]


@pytest.mark.parametrize(("rest", "explained"), [(0.5, 1.0 - 2 / 200), (5.0, 198 / (200 + 15 * 25 - 15 - 2))])
def test_the_explained_share_is_that_of_the_excess_of_chi_square(rest, explained):
    """Of 20 rows with three free columns, two functions that fall by 200, and 15 rows of a residual."""
    residual = np.concatenate([np.zeros(3), [10.0, -10.0], np.full(15, rest)])
    level = SimpleNamespace(gain=np.ones(20), basis=np.eye(20)[:, :3], residual=residual, deviance=0.0)
    context = SimpleNamespace(levels=[level], draws=np.zeros((20, 7)), rotated=lambda c: c)
    test = _dependence._Test("casing", ("t", "delta"), np.eye(20)[:, [3, 4]], None, np.zeros(0), None, ())
    found, null = _dependence._tested(context, test)
    assert found.explained == pytest.approx(explained)
    assert (found.score, found.columns, found.variable, found.body) == (
        pytest.approx(200.0),
        2,
        "t*delta",
        "casing",
    )
    assert null.tolist() == [1.0] * 7


def test_functions_that_the_base_contains_are_not_tested():
    basis = np.eye(20)[:, :2]
    level = SimpleNamespace(gain=np.ones(20), basis=basis, residual=np.ones(20), deviance=0.0)
    context = SimpleNamespace(levels=[level], draws=np.ones((20, 7)), rotated=lambda c: c)
    test = _dependence._Test("casing", ("t",), basis @ np.ones((2, 3)), None, np.zeros(0), None, ())
    found, null = _dependence._tested(context, test)
    assert found is None
    assert null.tolist() == [1.0] * 7


def test_a_determined_part_is_that_of_its_projection():
    matrix = RNG.standard_normal((3, 3))
    found = _dependence.Dependence("t", "casing", 0.1, 0.5, 1.0, 2, *[np.zeros(3)] * 3, matrix)
    assert found.comparable(np.array([1.0, 2.0, 3.0])) == pytest.approx(matrix @ [1.0, 2.0, 3.0])


RANDOM = np.random.default_rng(8)


def estimate(value, stderr=0.1):
    return Estimate(value, stderr, "s", at_bound=False)


def fit(deviance, bic=None, *, fails=False, labels=("x", "y", "z"), noise="noise", **more):
    layout = SimpleNamespace(records=[SimpleNamespace(label=x) for x in labels])
    return SimpleNamespace(
        deviance=deviance, bic=deviance if bic is None else bic, fails=lambda c: fails, noise=noise,
        problem=SimpleNamespace(layout=layout, data="data"), **more,
    )  # fmt: skip


class TestValues:
    def test_a_difference_has_the_covariance_of_both_values(self):
        names = ("a.k@x", "b.k", "a.k@y", "a.k@z")
        index = {n: i for i, n in enumerate(names)}
        covariance = np.diag([4.0, 1.0, 9.0, 1.0])
        covariance[0, 2] = covariance[2, 0] = 2.0
        covariance[0, 3] = covariance[3, 0] = 2.5
        layout = SimpleNamespace(records=[SimpleNamespace(label=x) for x in "xyz"], index=index)
        found = SimpleNamespace(
            problem=SimpleNamespace(layout=layout),
            covariance=covariance,
            theta=np.array([5.0, 0.0, 8.0, 1.0]),
            estimates={n: estimate(7.0) for n in names},
        )
        values = _difference._values(found, "a.k")
        assert list(values.estimates) == ["x", "y", "z"]
        assert {k: (e.value, e.stderr) for k, e in values.differences.items()} == {
            "y": (3.0, 3.0),
            "z": (-4.0, 0.0),
        }
        assert values.largest == 1.0

    def test_the_largest_difference_is_in_standard_errors(self):
        def largest(*pairs):
            return ValuesPerRecording("k", {}, {str(i): estimate(*p) for i, p in enumerate(pairs)}).largest

        assert largest((3.0, 2.0), (-4.0, 1.0)) == 4.0
        assert largest((3.0, 0.0), (1.0, math.nan)) == 0.0
        assert largest() == 0.0

    def test_a_score_is_penalised_for_constants_and_length(self):
        s = SimpleNamespace(score=30.0, columns=2, shape=[{"a": 1, "b": 2}, {}])
        assert penalised(s, 5.0, math.e**2) == pytest.approx(30 - 4 * 2 - 5)


class TestOne:
    """Three recordings: a value for each has two more parameters."""

    def found(self, monkeypatch, base, trials, *, tests=4, rival=None):
        calls = []

        def per_recording(base, keys, *, start, noise):
            calls.append((tuple(keys), start, noise))
            return trials[keys[0]]

        monkeypatch.setattr(_difference, "_fit_per_recording", per_recording)
        monkeypatch.setattr(
            _difference, "refitted_at", lambda b, noise: fit(base.deviance - 1.0, base.bic - 1.0)
        )
        monkeypatch.setattr(_difference, "_values", lambda f, name: ValuesPerRecording(name, {}, {}))
        base.values = {"a": 1.0, "b": 2.0, "c": 3.0, "d": 4.0}
        found = _difference._one_that_differs(base, list(trials), tests, DEFAULT, rival)
        return found, calls

    def test_the_best_one_is_named_with_its_equals(self, monkeypatch):
        trials = {"a": fit(60.0), "b": fit(50.0), "c": fit(59.9), "d": fit(60.1)}
        found, calls = self.found(monkeypatch, fit(100.0), trials)
        assert found.parameter.name == "b"
        assert found.parameter.indistinguishable_from == ("c",)
        assert found.parameter.delta_bic == -50.0
        assert found.parameter.p_value == pytest.approx(4 * chi2.sf(50.0, 2))
        assert calls[0] == (
            ("a",),
            {"b": 2.0, "c": 3.0, "d": 4.0, "a@x": 1.0, "a@y": 1.0, "a@z": 1.0},
            "noise",
        )

    @pytest.mark.parametrize(("tests", "named"), [(4, True), (6, False)])
    def test_the_p_value_counts_all_scored_parameters(self, monkeypatch, tests, named):
        # chi-square 10.4 with two degrees of freedom has the probability 0.0055
        found, _ = self.found(monkeypatch, fit(100.0), {"a": fit(89.6, 50.0)}, tests=tests)
        assert (found is not None) is named

    @pytest.mark.parametrize(("change", "named"), [(-0.1, True), (0.1, False)])
    def test_bic_must_fall_by_the_evidence(self, monkeypatch, change, named):
        length = _difference.description_length(1)
        limit = 100.0 - DEFAULT.evidence - length
        found, _ = self.found(monkeypatch, fit(100.0), {"a": fit(50.0, limit + change)})
        assert (found is not None) is named

    @pytest.mark.parametrize(("change", "named"), [(-0.1, True), (0.1, False)])
    def test_beside_a_rival_it_must_be_within_the_width(self, monkeypatch, change, named):
        length = _difference.description_length(1)
        rival = (fit(0.0, noise="of the rival"), 70.0)
        limit = 70.0 + DEFAULT.equivalence_width - length
        found, calls = self.found(monkeypatch, fit(100.0), {"a": fit(50.0, limit + change)}, rival=rival)
        assert calls[0][2] == "of the rival"
        assert (found is not None) is named
        if named:
            assert found.parameter.p_value == pytest.approx(4 * chi2.sf(49.0, 2))
            assert found.parameter.delta_bic == pytest.approx(limit + change - 99.0)

    def test_without_trials_there_is_none(self, monkeypatch):
        assert self.found(monkeypatch, fit(100.0), {})[0] is None


class TestSeveral:
    def found(self, monkeypatch, results, *, largest, base=None):
        calls = []

        def per_recording(base, keys, *, start=None, noise=None):
            calls.append((tuple(keys), start))
            return results[tuple(keys)]

        monkeypatch.setattr(_difference, "_fit_per_recording", per_recording)
        one = {"x": estimate(1.0, 1.0), "y": estimate(4.0, 2.0)}
        monkeypatch.setattr(
            _difference,
            "_values",
            lambda f, name: ValuesPerRecording(name, one, {"y": estimate(largest[name], 1.0)}),
        )
        for f in results.values():
            f.values = {"a@x": 1.0, "b@x": 2.0, "c@x": 3.0, "d": 9.0}
        base = base or fit(500.0, labels=("x", "y"))
        return _difference._several_that_differ(base, ["a", "b", "c"], DEFAULT), calls

    def test_parameters_are_shared_again_in_the_order_of_their_difference(self, monkeypatch):
        results = {
            ("a", "b", "c"): fit(100.0, 120.0),
            ("a", "c"): fit(101.0, 115.0),
            ("c",): fit(102.0, 118.0),
            ("a",): fit(103.0, 119.0),
        }
        found, calls = self.found(monkeypatch, results, largest={"a": 3.0, "b": 1.0, "c": 9.0})
        assert found.fit is results["a", "c"]
        assert found.parameter.names == ("c", "a")
        # the mean with the weights 1 and 1 / 4
        assert calls[1][1] == {"a@x": 1.0, "c@x": 3.0, "d": 9.0, "b": pytest.approx(1.6)}
        assert found.parameter.p_value == pytest.approx(3 * chi2.sf(399.0, 2))
        assert found.parameter.delta_bic == pytest.approx(115.0 - 500.0)

    def test_each_further_recording_adds_a_constant(self, monkeypatch):
        pairs = [("b", "c"), ("a", "c"), ("b", "a"), ("a", "b"), ("c", "b"), ("c", "a")]
        worse = {k: fit(1.0, 999.0) for k in pairs}
        results = {("a", "b", "c"): fit(450.0, 120.0), **worse}
        base = fit(500.0, labels=("x", "y", "z"))
        found, _ = self.found(monkeypatch, results, largest={"a": 3.0, "b": 1.0, "c": 9.0}, base=base)
        assert found.parameter.p_value == pytest.approx(chi2.sf(50.0, 6))
        results["a", "b", "c"].deviance = 501.0
        assert self.found(monkeypatch, results, largest={"a": 3.0, "b": 1.0, "c": 9.0}, base=base)[0] is None

    def test_sharing_must_not_cause_a_lack_of_fit(self, monkeypatch):
        results = {
            ("a", "b", "c"): fit(100.0, 120.0),
            ("a", "c"): fit(101.0, 115.0, fails=True),
            ("c", "b"): fit(101.0, 115.0, fails=True),
            ("b", "c"): fit(101.0, 115.0, fails=True),
            ("b", "a"): fit(101.0, 115.0, fails=True),
        }
        found, _ = self.found(monkeypatch, results, largest={"a": 3.0, "b": 1.0, "c": 9.0})
        assert found.parameter.names == ("c", "a", "b")

    def test_all_parameters_together_must_describe_the_data(self, monkeypatch):
        results = {("a", "b", "c"): fit(100.0, 120.0, fails=True)}
        assert self.found(monkeypatch, results, largest={"a": 3.0, "b": 1.0, "c": 9.0})[0] is None

    @pytest.mark.parametrize(("change", "named"), [(0.1, True), (-0.1, False)])
    def test_bic_must_fall_by_the_evidence(self, monkeypatch, change, named):
        worse = dict.fromkeys(
            [("b", "c"), ("a", "c"), ("b", "a"), ("a", "b"), ("c", "b"), ("c", "a")], fit(1.0, 999.0)
        )
        results = {("a", "b", "c"): fit(100.0, 120.0), **worse}
        limit = 120.0 + DEFAULT.evidence + _difference.description_length(3)
        base = fit(500.0, limit + change, labels=("x", "y"))
        found, _ = self.found(monkeypatch, results, largest={"a": 3.0, "b": 1.0, "c": 9.0}, base=base)
        assert (found is not None) is named


class TestWhich:
    def run(
        self, monkeypatch, *, one=None, rival=None, least=0.0, keys=("a", "b", "c"), records=2, together=100.0
    ):
        made = {"a": 1.0, "b": 9.0, "c": 5.0}
        jacobian = np.arange(12.0).reshape(4, 3)
        layout = SimpleNamespace(
            per_case=("own",), records=["x", "y"][:records], index={k: i for i, k in enumerate("abc")}
        )
        base = SimpleNamespace(
            problem=SimpleNamespace(layout=layout, data=[SimpleNamespace(z=np.zeros(4))] * 2),
            model=SimpleNamespace(free=(*keys, "own")),
            predictions=[SimpleNamespace(jacobian=jacobian)] * 2,
        )
        seen = {}
        monkeypatch.setattr(_difference, "ScoreContext", lambda b, n: "context")

        def scored(context, columns):
            assert len(columns) == 8
            assert (columns[:4] == 0).all()
            if columns.shape[1] > 1:
                return together
            i = int(columns[4, 0])
            return made["abc"[i]]

        monkeypatch.setattr(_difference, "score_of_columns", scored)
        monkeypatch.setattr(
            _difference,
            "_one_that_differs",
            lambda b, keys, tests, criteria, rival: seen.update(keys=keys, tests=tests) or one,
        )
        monkeypatch.setattr(_difference, "_several_that_differ", lambda b, keys, criteria: "several")
        return different_parameter(base, DEFAULT, rival=rival, least=least), seen

    def test_the_two_largest_scores_are_refitted(self, monkeypatch):
        found, seen = self.run(monkeypatch)
        assert (found, seen) == ("several", {"keys": ["b", "c"], "tests": 3})
        assert self.run(monkeypatch, least=6.0)[1]["keys"] == ["b"]

    def test_several_are_tried_where_one_does_not_suffice(self, monkeypatch):
        enough = SimpleNamespace(fit=fit(0.0))
        poor = SimpleNamespace(fit=fit(0.0, fails=True))
        assert self.run(monkeypatch, one=enough)[0] is enough
        assert self.run(monkeypatch, one=poor)[0] == "several"
        assert self.run(monkeypatch, one=poor, rival=("fit", 1.0))[0] is poor
        assert self.run(monkeypatch, one=poor, least=8.0, together=7.0)[0] is poor
        assert self.run(monkeypatch, one=poor, keys=("a",))[0] is poor

    def test_a_single_recording_has_no_difference(self, monkeypatch):
        assert self.run(monkeypatch, records=1) == (None, {})
        assert self.run(monkeypatch, keys=()) == (None, {})

    def test_choices_of_the_layout_are_kept(self, monkeypatch):
        seen = {}
        monkeypatch.setattr(_difference, "fit", lambda model, data, **more: seen.update(more))
        base = SimpleNamespace(
            model=None,
            problem=SimpleNamespace(data=None, layout=SimpleNamespace(choices=(("a", "b"), ("c",)))),
        )
        _difference._fit_per_recording(base, ["a", "d"], start={"x": 1.0}, noise="n")
        assert seen == {"share": ["b"], "per_case": ["c", "a", "d"], "start": {"x": 1.0}, "noise": "n"}

    @pytest.mark.parametrize(("worth", "better"), [(1.1, True), (0.9, False)])
    def test_a_law_must_be_worth_more_than_the_difference(self, monkeypatch, worth, better):
        """Two parameters with values in three recordings: four more parameters than one value for each."""
        names = ("a.k@x", "b.k", "a.k@y", "a.k@z", "c.k@x", "c.k@y", "c.k@z")
        theta = np.array([1.0, 9.0, 2.0, 6.0, 5.0, 5.0, 8.0])
        jacobian = RANDOM.standard_normal((4, 7))
        about = SimpleNamespace(
            predictions=[SimpleNamespace(jacobian=jacobian)],
            problem=SimpleNamespace(layout=SimpleNamespace(names=names)),
            theta=theta,
            n_eff=math.e,
        )
        change = np.array([-2.0, 0.0, -1.0, 3.0, -1.0, -1.0, 2.0])
        seen = {}
        monkeypatch.setattr(_difference, "CaseColumns", lambda about, i: i)
        monkeypatch.setattr(
            _difference,
            "ScoreContext",
            lambda about, n, torque_rows, shared: seen.update(rows=torque_rows, shared=shared),
        )
        monkeypatch.setattr(_difference, "score_of_columns", lambda context, rows: 50.0)
        limit = 50.0 - _difference.description_length(2) - 4.0
        scores = [
            SimpleNamespace(score=limit + worth, columns=1, shape=[{}]),
            SimpleNamespace(score=limit + 5.5, columns=1, shape=[{"a": 1.0}]),
        ]
        monkeypatch.setattr(_difference, "score", lambda *a, **k: scores)
        parameter = SimpleNamespace(names=("a.k", "c.k"))
        separate = SimpleNamespace(fit=about, parameter=parameter)
        assert improves_on_difference(separate, ["e", "f"], [0.0, 4.0], DEFAULT) is better
        assert seen["rows"] == pytest.approx(jacobian @ change)
        assert seen["shared"] == ("a.k", "c.k")

    def test_the_penalty_is_that_of_all_names(self):
        parameter = DifferentParameter("a", {}, {}, (), 0.0, 0.0, (ValuesPerRecording("b", {}, {}),))
        assert parameter.names == ("a", "b")
        separate = SeparateValues(parameter, SimpleNamespace(bic=10.0))
        assert separate.penalised_bic == 10.0 + _difference.description_length(2)


class TestDependence:
    def test_splines_are_a_partition_of_unity_over_the_range(self):
        axis = _dependence._Axis(np.array([2.0, 5.0, 3.0]), 10)
        found = axis(np.array([1.0, 2.0, 3.3, 5.0, 9.0]))
        assert found.shape == (5, 10)
        assert found.sum(axis=1) == pytest.approx(np.ones(5))
        assert found[0] == pytest.approx(np.eye(10)[0])
        assert found[-1] == pytest.approx(np.eye(10)[9])
        assert (axis.low, axis.high) == (2.0, 5.0)
        assert _dependence._Axis(np.array([2.0, 2.0]), 10)(np.array([2.0])).shape == (1, 10)

    def test_products_are_those_of_all_pairs(self):
        a, b = RANDOM.standard_normal((3, 2)), RANDOM.standard_normal((3, 4))
        assert _dependence._product([a, b])[1] == pytest.approx(np.outer(a[1], b[1]).ravel())
        assert _dependence._product([a]) is a

    def test_a_torque_in_the_bearing_acts_on_both_bodies(self):
        case = SimpleNamespace(response=SimpleNamespace(casing=5.0, rotor=2.0))
        assert [_dependence._acting(case, b) for b in ("casing", "rotor", "bearing")] == [5.0, 2.0, 3.0]

    @pytest.mark.parametrize(("speed", "orders"), [(1.5, (1, 2)), (1.6, (1,)), (3.1, (1,)), (3.2, ())])
    def test_harmonics_of_the_rotor_are_resolved_by_the_frames(self, speed, orders):
        """Frames at intervals of 1 s."""
        data = [
            SimpleNamespace(
                measured_angle=1.0, record=SimpleNamespace(casing=SimpleNamespace(time=np.arange(9.0)))
            )
        ]
        y = np.zeros((2, 2, 2))
        y[..., 0] = [[-speed, 0.5], [0.1, 0.2]]
        about = SimpleNamespace(
            problem=SimpleNamespace(data=data), predictions=[SimpleNamespace(path=SimpleNamespace(y=y))]
        )
        assert _dependence._orders(about, "psi_r") == orders
        assert _dependence._orders(about, "psi_c") == (1, 2, 3, 4)
        data[0].measured_angle = None
        assert _dependence._orders(about, "psi_c") == ()

    def made(self, body, score_, columns, p):
        none = np.zeros(0)
        return Dependence("t", body, p, 0.5, score_, columns, none, none, none, none)

    def test_dependences_are_ordered_by_bic_and_calibrated_together(self, monkeypatch):
        found = {"a": self.made("a", 30.0, 5, 0.01), "b": self.made("b", 28.0, 2, 0.02), "c": None}
        nulls = {"a": np.full(1000, 0.5), "b": np.linspace(0.001, 1.0, 1000), "c": np.zeros(1000)}
        monkeypatch.setattr(_dependence, "CaseColumns", lambda about, i: i)
        monkeypatch.setattr(_dependence, "context_without", lambda *a, **k: None)
        monkeypatch.setattr(_dependence, "_tests", lambda about, cases: iter("abc"))
        monkeypatch.setattr(_dependence, "_tested", lambda context, test: (found[test], nulls[test]))
        monkeypatch.setattr(_dependence, "over_many_tests", lambda p, smallest: p + smallest.max())
        about = SimpleNamespace(
            model=SimpleNamespace(effects=(), refuse_chain=lambda *a: None),
            problem=SimpleNamespace(cases=[1]), n_eff=math.e,
        )  # fmt: skip
        assert [(d.body, d.p_value) for d in dependence(about)] == [("b", 0.52), ("a", 0.51)]

    def test_the_fall_of_chi_square_is_that_of_the_functions(self, monkeypatch):
        """White rows, one free column, and two levels of which the second one has more deviance."""
        monkeypatch.setattr(_dependence, "_curve", lambda context, level, test: (1.0, 2.0, 3.0))
        columns = RANDOM.standard_normal((30, 3))
        basis = np.linalg.qr(RANDOM.standard_normal((30, 1)))[0]
        residual = RANDOM.standard_normal(30) * 2.0
        residual = residual - basis @ (basis.T @ residual)
        level = SimpleNamespace(gain=np.ones(30), basis=basis, residual=residual, deviance=100.0)
        other = SimpleNamespace(gain=np.full(30, 0.5), basis=basis, residual=0.1 * residual, deviance=103.0)
        draws = RANDOM.standard_normal((30, 50))
        context = SimpleNamespace(levels=[level, other], draws=draws, rotated=lambda c: c)
        test = _dependence._Test("casing", ("t",), columns * [1.0, 7.0, 0.01], None, np.zeros(0), None, ())
        found, null = _dependence._tested(context, test)
        span = np.linalg.qr(columns - basis @ (basis.T @ columns))[0]
        fall = float(np.sum((span.T @ residual) ** 2))
        assert (found.score, found.columns) == (pytest.approx(fall), 3)
        assert found.p_value == pytest.approx(chi2.sf(fall, 3))
        excess = max(float(residual @ residual) - (30 - 1 - 3) - 3, fall)
        assert found.explained == pytest.approx(np.clip((fall - 3) / excess, 0.0, 1.0))
        assert null == pytest.approx(chi2.sf(np.sum((span.T @ draws) ** 2, axis=0), 3), rel=1e-6)
        assert (found.torque, found.sigma, found.identified) == (1.0, 2.0, 3.0)
        context.levels[0].deviance, context.levels[1].deviance = 900.0, 100.0
        assert _dependence._tested(context, test)[0].score == pytest.approx(0.01 * fall)


def test_a_difference_has_the_uncertainty_of_correlated_values():
    covariance = np.array(
        [[4.0, 0.0, 1.5, -1.0], [0.0, 9.0, 0.0, 0.0], [1.5, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 2.0]]
    )
    index = {"a.k@x": 0, "b.c": 1, "a.k@y": 2, "a.k@z": 3}
    theta = np.array([5.0, 0.0, 7.0, 1.0])
    estimates = {n: Estimate(float(theta[i]), 0.1, "s", at_bound=False) for n, i in index.items()}
    records = [SimpleNamespace(label=x) for x in "xyz"]
    layout = SimpleNamespace(records=records, index=index)
    fit = SimpleNamespace(
        problem=SimpleNamespace(layout=layout), estimates=estimates, covariance=covariance, theta=theta
    )
    found = _difference._values(fit, "a.k")
    assert found.name == "a.k"
    assert {k: e.value for k, e in found.estimates.items()} == {"x": 5.0, "y": 7.0, "z": 1.0}
    assert {k: (e.value, e.stderr, e.unit) for k, e in found.differences.items()} == {
        "y": (2.0, pytest.approx(math.sqrt(2.0)), "s"),
        "z": (-4.0, pytest.approx(math.sqrt(8.0)), "s"),
    }
    assert found.largest == pytest.approx(math.sqrt(2.0))


class TestShared:
    """Shared parameters of three recordings, of which the keys have given scores."""

    def found(
        self, monkeypatch, scores, *, labels=3, rival=None, one=None, several=None, least=0.0, per_case=()
    ):
        calls = []
        keys = tuple(scores)
        jacobian = [np.outer(np.arange(1.0, 3.0 + i), 10.0 ** np.arange(len(keys))) for i in range(labels)]

        def score_of_columns(context, columns):
            asked.append(columns)
            return list(scores.values())[len(asked) - 1] if len(asked) <= len(keys) else 7.0

        def one_that_differs(base, promising, tests, criteria, of_rival):
            calls.append((promising, tests, of_rival))
            return one

        asked = []
        monkeypatch.setattr(_difference, "ScoreContext", lambda base, draws: None)
        monkeypatch.setattr(_difference, "score_of_columns", score_of_columns)
        monkeypatch.setattr(_difference, "_one_that_differs", one_that_differs)
        monkeypatch.setattr(
            _difference, "_several_that_differ", lambda base, keys, criteria: several and (several, keys)
        )
        layout = SimpleNamespace(
            per_case=per_case, records=[1] * labels, index={k: i for i, k in enumerate(keys)}
        )
        base = SimpleNamespace(
            problem=SimpleNamespace(layout=layout, data=[SimpleNamespace(z=np.zeros(2 + i)) for i in range(labels)]),
            predictions=[SimpleNamespace(jacobian=j) for j in jacobian],
            model=SimpleNamespace(free=(*keys, *per_case)),
        )  # fmt: skip
        found = _difference.different_parameter(base, DEFAULT, rival=rival, least=least)
        return found, calls, asked

    def fit(self, fails):
        return SimpleNamespace(fit=SimpleNamespace(fails=lambda criteria: fails))

    def test_each_later_recording_has_its_own_column(self, monkeypatch):
        _, _, asked = self.found(monkeypatch, {"a": 5.0, "b": 9.0})
        for k, columns in enumerate(asked[:2]):
            # rows of 2, 3 and 4 samples
            expected = np.zeros((9, 2))
            expected[2:5, 0] = 10.0**k * np.arange(1, 4)
            expected[5:9, 1] = 10.0**k * np.arange(1, 5)
            assert columns.tolist() == expected.tolist()
        assert asked[2].tolist() == np.concatenate(asked[:2], axis=1).tolist()

    def test_the_best_scores_are_refitted(self, monkeypatch):
        scores = {k: float(v) for k, v in zip("abcdefgh", (3, 8, 1, 6, 7, 2, 5, 4), strict=True)}
        _, calls, _ = self.found(monkeypatch, scores, per_case=("z",))
        ((promising, tests, _),) = calls
        assert promising == list("bedghafc")[: _difference._REFITTED]
        assert tests == 8
        _, ((promising, *_),), _ = self.found(monkeypatch, scores, least=7.0)
        assert promising == ["b", "e"]

    def test_several_parameters_differ_if_one_does_not_suffice(self, monkeypatch):
        scores = {"a": 1.0, "b": 2.0}
        good, bad = self.fit(False), self.fit(True)
        assert self.found(monkeypatch, scores, one=good, several="many")[0] is good
        assert self.found(monkeypatch, scores, one=bad, several="many")[0] == ("many", ["a", "b"])
        assert self.found(monkeypatch, scores, one=bad)[0] is bad
        assert self.found(monkeypatch, scores, several="many")[0] == ("many", ["a", "b"])
        assert self.found(monkeypatch, scores)[0] is None
        # not beside a rival, for one parameter, or with all of them below the least score
        rival = ("fit", 3.0)
        found, calls, _ = self.found(monkeypatch, scores, one=bad, several="many", rival=rival)
        assert (found, calls[0][2]) == (bad, rival)
        assert self.found(monkeypatch, {"a": 1.0}, one=bad, several="many")[0] is bad
        assert self.found(monkeypatch, scores, one=bad, several="many", least=7.1)[0] is bad
        assert self.found(monkeypatch, scores, one=bad, several="many", least=6.9)[0] == ("many", ["a", "b"])

    def test_one_recording_shares_nothing(self, monkeypatch):
        assert self.found(monkeypatch, {"a": 1.0}, labels=1, one=self.fit(False)) == (None, [], [])
        assert self.found(monkeypatch, {}, per_case=("z",), one=self.fit(False)) == (None, [], [])
