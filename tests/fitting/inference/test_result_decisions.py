"""Verdicts and figures of merit of a fit as functions of their parts, on either side of each threshold."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import Estimate, EstimationError, Fit
from fitting._criteria import DEFAULT
from fitting.inference import _result as module
from fitting.inference._angle_noise import AngleNoise
from fitting.inference._problem import degenerate_directions, surely_at_bound
from fitting.inference._result import FitSummary, not_determined


def case(**metrics):
    return SimpleNamespace(
        casing=SimpleNamespace(**metrics), fails=lambda criteria: metrics.get("fails", False)
    )


class TestMerits:
    def test_the_misfit_weights_cases_by_their_rows(self):
        cases = [SimpleNamespace(rows=10, chi2_per_row=4.0), SimpleNamespace(rows=30, chi2_per_row=1.0)]
        assert FitSummary.misfit.fget(SimpleNamespace(cases=cases)) == pytest.approx(math.sqrt(70 / 40))

    @pytest.mark.parametrize(
        ("units", "unit"),
        [(["s", "N m s"], "N m"), (["N m", "N m s"], "N m"), (["rad/s2", "s"], "rad/s2"), ([], "rad/s2")],
    )
    def test_the_torque_unit_is_that_of_any_parameter(self, units, unit):
        estimates = {str(i): SimpleNamespace(unit=u) for i, u in enumerate(units)}
        assert FitSummary.torque_unit.fget(SimpleNamespace(estimates=estimates)) == unit

    def test_aic_counts_the_parameters_that_were_fitted(self):
        estimates = {str(i): SimpleNamespace(vary=v) for i, v in enumerate((True, False, True, True))}
        assert FitSummary.aic.fget(SimpleNamespace(deviance=10.0, estimates=estimates)) == 16.0

    def test_correlations_are_ordered_by_their_size(self):
        names = ("a", "b", "c", "d", "e")
        covariance = np.diag([4.0, 9.0, 1.0, np.inf, 0.0])
        covariance[0, 1] = covariance[1, 0] = 0.6
        covariance[0, 2] = covariance[2, 0] = -1.8
        covariance[1, 2] = covariance[2, 1] = 1.5
        found = SimpleNamespace(
            variables=names,
            covariance=covariance,
            estimates=dict.fromkeys(names),
            shown_name=lambda k: k.upper(),
        )
        assert FitSummary.correlations(found) == [
            ("A", "C", pytest.approx(-0.9)),
            ("B", "C", pytest.approx(0.5)),
            ("A", "B", pytest.approx(0.1)),
        ]
        del found.estimates["c"]
        assert [p[:2] for p in FitSummary.correlations(found)] == [("A", "B")]

    @pytest.mark.parametrize(
        ("name", "value", "stderr", "weak"),
        [
            ("a", 2.0, 1.9, False),
            ("a", 2.0, 2.1, True),
            ("a", -2.0, 2.1, True),
            ("a", -2.0, 1.9, False),
            ("a", 0.0, 1e-9, True),
            ("a", 2.0, math.inf, False),
            ("a", 2.0, math.nan, False),
            ("initial.omega_c", 1.0, 9.0, False),
        ],
    )
    def test_a_parameter_within_its_uncertainty_of_zero_is_not_determined(self, name, value, stderr, weak):
        estimates = {name: SimpleNamespace(value=value, stderr=stderr)}
        assert not_determined(estimates) == ([name] if weak else [])
        if math.isfinite(stderr):
            doubled = {name: SimpleNamespace(value=value, stderr=2 * stderr)}
            assert not_determined(doubled, 2.0) == ([name] if weak else [])

    def test_parameters_with_a_prior_and_phases_are_not_among_the_undetermined(self):
        names = ("a.k@x", "b.k", "c.phi")
        estimates = {n: SimpleNamespace(value=1.0, stderr=101.0) for n in names}
        prior = SimpleNamespace(names=("a.k",))
        data = [SimpleNamespace(prior=None), SimpleNamespace(prior=prior)]
        layout = SimpleNamespace(
            parameter=lambda k: SimpleNamespace(role="phase" if k == "c.phi" else "shape")
        )
        found = SimpleNamespace(estimates=estimates, problem=SimpleNamespace(data=data, layout=layout))
        assert Fit.undetermined_at(found, DEFAULT) == ["b.k"]
        assert Fit.undetermined_at(found, replace(DEFAULT, undetermined=102.0)) == []
        data[1].prior = None
        assert Fit.undetermined_at(found, DEFAULT) == ["a.k@x", "b.k"]

    def test_figures_of_all_cases(self):
        def record(casing, *rotor, prior=None, generated=False):
            return SimpleNamespace(
                casing=range(casing), rotor=[range(n) for n in rotor], prior=prior, generated=generated
            )

        data = [
            SimpleNamespace(record=record(5, 3, 2), casing=SimpleNamespace(n_effective=10.0)),
            SimpleNamespace(
                record=record(7, prior="p", generated=True), casing=SimpleNamespace(n_effective=30.0)
            ),
        ]
        cases = [
            case(reduced_chi2=2.0, rmse=3.0, held_out=6.0),
            case(reduced_chi2=1.0, rmse=4.0, held_out=8.0),
        ]
        found = SimpleNamespace(
            cases=cases,
            problem=SimpleNamespace(data=data),
            noise=[SimpleNamespace(level=2.0), SimpleNamespace(level=5.0)],
            predictions=[SimpleNamespace(path=0.3), SimpleNamespace(path=0.4)],
        )
        assert Fit.reduced_chi2.fget(found) == pytest.approx(50 / 40)
        assert Fit.rmse_casing.fget(found) == pytest.approx(math.sqrt(12.5))
        assert Fit.held_out.fget(found) == pytest.approx(math.sqrt(50.0))
        assert Fit.samples.fget(found) == 17
        assert Fit.torque_noise.fget(found) == 5.0
        assert Fit.prior.fget(found) == "p"
        assert Fit.generated.fget(found)
        data.pop()
        assert Fit.prior.fget(found) is None
        assert not Fit.generated.fget(found)

    def test_noise_alone_has_its_bic_and_rms(self, monkeypatch):
        def whitener(level):
            return SimpleNamespace(log_determinant=10.0 * level)

        free = np.array([True, True, False, True])
        found = SimpleNamespace(
            noise=[SimpleNamespace(whitener=SimpleNamespace(at=whitener), tested=t) for t in (1.0, 2.0)],
            rows=100,
            problem=SimpleNamespace(layout=SimpleNamespace(is_free=free), data=("x", "y")),
            predictions=[SimpleNamespace(path=3.0), SimpleNamespace(path=4.0)],
        )
        assert Fit.bic_noise.fget(found) == pytest.approx(30.0 + 97 + 3 * math.log(100))
        monkeypatch.setattr(module, "smoothing_noise", lambda data, path: path)
        assert Fit.rmse_noise.func(found) == pytest.approx(math.sqrt(12.5))

    def test_the_variance_factor_counts_free_parameters_within_their_bounds(self, monkeypatch):
        monkeypatch.setattr(module, "variance_factor", lambda chi2, dof: (chi2, dof))
        layout = SimpleNamespace(
            at_bound=lambda theta: np.array([True, False, False, False]),
            is_free=np.array([True, True, False, True]),
        )
        found = SimpleNamespace(problem=SimpleNamespace(layout=layout), theta=None, chi2=7.0, rows=50)
        assert Fit.variance_factor.fget(found) == (7.0, 48)


class TestVerdict:
    def fit(self, **changed):
        known = {
            "lacks_restoring_torque": False,
            "converged": True,
            "has_lack_of_fit": lambda: False,
            "undetermined": [],
        }
        return SimpleNamespace(**known | changed)

    @pytest.mark.parametrize(
        ("changed", "verdict"),
        [
            ({}, "no_lack_of_fit"),
            ({"undetermined": ["a"]}, "not_determined"),
            ({"has_lack_of_fit": lambda: True, "undetermined": ["a"]}, "lack_of_fit"),
            ({"converged": False, "has_lack_of_fit": lambda: True}, "not_converged"),
            ({"converged": False, "lacks_restoring_torque": True}, "lack_of_fit"),
        ],
    )
    def test_the_first_reason_decides(self, changed, verdict):
        assert Fit.verdict.func(self.fit(**changed)) == verdict

    @pytest.mark.parametrize("which", range(7))
    def test_any_test_shows_a_lack_of_fit(self, which):
        tests = (
            "fails",
            "needs_random_torque",
            "has_torque_of_the_angle",
            "has_smooth_law",
            "has_smooth_torque",
        )
        found = {name: lambda criteria, i=i: i == which for i, name in enumerate(tests)}
        found["significant_peak"] = lambda criteria: "a peak" if which == 5 else None
        assert Fit.has_lack_of_fit(SimpleNamespace(criteria=DEFAULT, **found)) is (which != 6)

    @pytest.mark.parametrize(
        ("converged", "p", "failing", "fails"),
        [
            (True, 0.9, (False, False), False),
            (True, 0.9, (False, True), True),
            (True, 0.9 * DEFAULT.lack_of_fit, (False, False), True),
            (True, 1.1 * DEFAULT.lack_of_fit, (False, False), False),
            (False, 0.0, (True, True), False),
        ],
    )
    def test_a_converged_fit_fails_by_slow_torques_or_a_case(self, converged, p, failing, fails):
        found = SimpleNamespace(
            converged=converged,
            criteria=DEFAULT,
            lack_of_fit=SimpleNamespace(p_value=p),
            cases=[case(fails=f) for f in failing],
        )
        assert Fit.fails(found) is fails

    @pytest.mark.parametrize(("share", "found"), [(0.9, True), (1.1, False)])
    def test_a_peak_counts_below_the_limit(self, share, found):
        peak = SimpleNamespace(p_value=share * DEFAULT.doubt_adequate)
        fit = SimpleNamespace(periodogram_peak=peak, criteria=DEFAULT)
        assert (Fit.significant_peak(fit) is peak) is found
        assert Fit.significant_peak(SimpleNamespace(periodogram_peak=None, criteria=DEFAULT)) is None

    @pytest.mark.parametrize(
        ("level", "excess", "many", "excessive", "random", "raised"),
        [
            (1.01, 11.0, False, True, True, True),
            (0.99, 11.0, False, False, False, True),
            (1.01, 9.0, False, True, False, False),
            (1.01, 11.0, True, True, False, True),
        ],
    )
    def test_process_noise_above_that_of_the_recording(self, level, excess, many, excessive, random, raised):
        """Levels in units of the largest one that the recording may have."""
        noise = SimpleNamespace(
            level=level * (2.0 + DEFAULT.excess_noise * 0.5), pure=2.0, pure_u=0.5,
            excess=excess / 10 * DEFAULT.random_torque_evidence, raised=True,
        )  # fmt: skip
        found = SimpleNamespace(noise=(noise,) * (1 + many), criteria=DEFAULT)
        assert Fit.has_excess_noise(found) is excessive
        assert bool(Fit.needs_random_torque(found)) is random
        assert Fit.needs_unestablished_torque(found) is raised
        noise.raised = False
        assert not Fit.needs_unestablished_torque(found)

    @pytest.mark.parametrize(
        ("sizes", "turns", "counts"),
        [
            ((1.01, 0.0), 5.1, True),
            ((0.0, 1.01), 5.1, True),
            ((0.99, 0.99), 5.1, False),
            ((9.0, 9.0), 4.9, False),
        ],
    )
    def test_a_harmonic_of_either_order_counts_after_five_turns(self, sizes, turns, counts):
        sigma = DEFAULT.harmonic_sigma
        harmonics = SimpleNamespace(size=lambda n: (99.0, sigma * sizes[n - 1]), turns=turns)
        none = SimpleNamespace(size=lambda n: (99.0, 0.0), turns=99.0)
        found = SimpleNamespace(angle_harmonics=(none, harmonics), criteria=DEFAULT)
        assert Fit.has_torque_of_the_angle(found) is counts

    @pytest.mark.parametrize(
        ("smooth", "restoring", "lacks"),
        [(True, (), False), (False, (), True), (False, ("a",), False), (True, ("a",), False)],
    )
    def test_an_oscillation_needs_a_restoring_torque(self, smooth, restoring, lacks):
        data = [SimpleNamespace(motion=SimpleNamespace(is_smooth=smooth))]
        found = SimpleNamespace(
            problem=SimpleNamespace(data=data), model=SimpleNamespace(restoring=restoring)
        )
        assert Fit.lacks_restoring_torque.fget(found) is lacks


class TestCovariance:
    def test_slow_residuals_enlarge_the_variances_of_a_driven_body(self):
        """Newey and West with Bartlett weights over three lags, of 20 blocks with 2 rows each, and 4 other rows."""
        rng = np.random.default_rng(2)
        jacobian = rng.standard_normal((44, 3)) * [1.0, 100.0, 1.0]
        jacobian[:, 2] = 0.0
        residual = np.repeat(rng.standard_normal(11), 4) * 3.0
        data = SimpleNamespace(
            z=np.zeros(44), casing=SimpleNamespace(z=np.zeros(40), lift=np.zeros((20, 2, 2)))
        )

        class Project:
            def __call__(self, rows):
                return rows

            def unexplained(self, rows):
                return rows

        problem = SimpleNamespace(data=[data], projections=[Project()])
        prediction = SimpleNamespace(jacobian=jacobian, rows=residual)
        information = jacobian[:, :2].T @ jacobian[:, :2]
        covariance = np.zeros((3, 3))
        covariance[:2, :2] = np.linalg.inv(information)
        covariance[2, 2] = np.inf
        scores = jacobian[:, :2] * residual[:, None]
        blocks = scores[:40].reshape(20, 2, 2).sum(axis=1)
        scatter = blocks.T @ blocks + scores[40:].T @ scores[40:]
        for lag in (1, 2, 3):
            product = sum(np.outer(blocks[i], blocks[i + lag]) for i in range(20 - lag))
            scatter = scatter + (1 - lag / 4) * (product + product.T)
        slow = np.linalg.inv(information) @ scatter @ np.linalg.inv(information)
        factor = np.sqrt(np.maximum(np.diag(slow) / np.diag(covariance)[:2], 1.0))
        assert (factor > 1.1).any()
        found = module._with_slow_residuals(problem, [prediction], covariance)
        assert found[:2, :2] == pytest.approx(covariance[:2, :2] * np.outer(factor, factor))
        # small residuals leave the covariance as it is
        prediction.rows = 0.1 * residual
        assert module._with_slow_residuals(problem, [prediction], covariance)[:2, :2] == pytest.approx(
            covariance[:2, :2]
        )

    def test_integration_errors_shift_the_parameters(self):
        rng = np.random.default_rng(3)
        columns, errors = rng.standard_normal((6, 2)), rng.standard_normal((6, 1))

        class Project:
            def __call__(self, rows):
                return 3.0 * rows

            def unexplained(self, rows):
                return 2.0 * rows

        problem = SimpleNamespace(
            cases=[SimpleNamespace(integration_errors=lambda p, theta: errors)], projections=[Project()]
        )
        covariance = np.diag([1.0, 4.0, np.inf])
        covariance[0, 1] = covariance[1, 0] = 0.5
        prediction = SimpleNamespace(places=np.array([1, 0]), columns=columns)
        found = module._by_integration_errors(problem, np.zeros(3), [prediction], covariance)
        gradient = np.zeros((3, 1))
        gradient[[1, 0]] = 6.0 * columns.T @ errors
        shift = np.array([[1.0, 0.5, 0.0], [0.5, 4.0, 0.0], [0.0, 0.0, 0.0]]) @ gradient
        assert found == pytest.approx(shift @ shift.T)

    @pytest.mark.parametrize(
        ("excess", "white", "tried"), [(5.9, False, True), (6.1, False, False), (5.9, True, False)]
    )
    def test_a_torque_may_hide_in_correlated_angle_noise_only(self, monkeypatch, excess, white, tried):
        seen = []
        monkeypatch.setattr(module, "replace", lambda n, unresolved: unresolved)
        monkeypatch.setattr(
            module, "unresolved_level", lambda w, rows, columns, pure: seen.append((rows, columns)) or 7.0
        )
        data = SimpleNamespace(
            angle_noise=SimpleNamespace(is_white=white),
            z=np.array([5.0, 7.0]),
            nuisance=np.array([[1.0], [2.0]]),
        )
        p = SimpleNamespace(
            columns=np.array([[3.0, 4.0], [5.0, 6.0]]), places=np.array([2, 0]), rows=np.array([1.0, 1.0])
        )
        noise = SimpleNamespace(excess=excess, whitener=None, pure=1.0)
        problem = SimpleNamespace(data=[data])
        assert list(module._with_unresolved(problem, [p], [noise], np.array([True, False, False]))) == [
            7.0 if tried else 0.0
        ]
        if tried:
            assert seen[0][0].tolist() == [4.0, 6.0]
            assert seen[0][1].tolist() == [[3.0, 1.0], [5.0, 2.0]]

    def test_estimates_are_marked_held_tied_or_at_their_bound(self):
        layout = SimpleNamespace(
            bounds=lambda: (np.array([0.0, 1.0, 2.0, 3.0]), np.array([9.0, 8.0, 7.0, 6.0])),
            names=("a.k", "b.k@x", "c.k", "gone@x"),
            ties={"a.k": "2*b"},
            model=SimpleNamespace(free=("a.k", "b.k", "c.k"), constants={"d.k": 5.0}),
            absent=("gone",),
            unit=lambda name: f"unit of {name}",
        )
        found = module._estimates(
            layout,
            np.array([1.0, 2.0, 3.0, 4.0]),
            np.array([0.1, 0.2, 0.3, 0.4]),
            np.array([0, 1, 0, 0], dtype=bool),
        )
        assert list(found) == ["a.k", "b.k@x", "c.k", "d.k"]
        assert found["a.k"] == Estimate(1.0, 0.1, "unit of a.k", False, False, 0.0, 9.0, "2*b")
        assert found["c.k"] == Estimate(3.0, 0.3, "unit of c.k", False, True, 2.0, 7.0, None)
        assert (found["b.k@x"].at_bound, found["b.k@x"].value, found["b.k@x"].vary) == (True, 2.0, True)
        assert math.isnan(found["b.k@x"].stderr)
        assert (found["d.k"].value, found["d.k"].vary, found["d.k"].at_bound) == (5.0, False, False)


class TestBounds:
    @pytest.mark.parametrize(
        ("beyond", "at_bound", "physical", "sure"),
        [
            (9.0, True, True, True),
            (0.5, True, True, False),
            (9.0, False, True, False),
            (9.0, True, False, False),
        ],
    )
    def test_only_a_physical_bound_far_from_the_optimum_is_known(self, beyond, at_bound, physical, sure):
        layout = SimpleNamespace(names=("a", "b", "c"), is_physical_bound=lambda n: physical)
        j = np.array([[2.0, 0.0, 0.0], [0.0, 5.0, 0.0]])
        r = np.array([beyond, 0.0])
        found = surely_at_bound(layout, np.array([at_bound, False, False]), r, j)
        assert found.tolist() == [sure, False, True]

    def test_parameters_that_only_a_combination_determines(self):
        """The relative sum is known to 1e-3, the relative difference to 1."""
        sum_, difference = np.array([1.0, 1.0]) / math.sqrt(2), np.array([1.0, -1.0]) / math.sqrt(2)
        relative = 2e-6 * np.outer(sum_, sum_) + 2 * 4.0 * np.outer(difference, difference)
        theta = np.array([3.0, -2.0, 5.0])
        covariance = np.zeros((3, 3))
        covariance[:2, :2] = relative * np.outer(theta[:2], theta[:2])
        covariance[2, 2] = 1e-6
        (found,) = degenerate_directions(["a", "b", "c"], theta, covariance)
        assert set(found) == {"a", "b"}
        assert sorted(found.values()) == pytest.approx([-1.0, 1.0], rel=1e-3)
        assert degenerate_directions(["a"], np.array([1.0]), np.array([[9.0]])) == []

    @pytest.mark.parametrize(("variance", "count"), [(0.99, 0), (1.01, 1)])
    def test_a_combination_is_undetermined_beyond_its_own_size(self, variance, count):
        v = np.array([1.0, 0.25, 0.15])
        v /= np.linalg.norm(v)
        theta = np.array([2.0, 3.0, 4.0])
        covariance = (variance * np.outer(v, v) + 1e-8 * np.eye(3)) * np.outer(theta, theta)
        found = degenerate_directions(["a", "b", "c"], theta, covariance)
        assert [set(d) for d in found] == [{"a", "b"}] * count
        if found:
            assert found[0] == pytest.approx({"a": 1.0, "b": 0.25}, rel=1e-3)


class TestLines:
    def test_lines_of_a_summary_fit_into_80_columns(self, monkeypatch):
        monkeypatch.setattr(module, "merit_lines", lambda fit: ["merits"])
        weak = {f"casing.law.number{i}": Estimate(1.0, 5.0, "s", at_bound=False) for i in range(12)}
        shown = SimpleNamespace(
            estimates=weak, verdict="lack_of_fit", generated=True, model=SimpleNamespace(constants={})
        )
        lines = module.summary_lines(shown)
        assert max(map(len, lines)) in range(70, 80)
        text = " ".join(lines)
        assert text.count("number11") == 2
        shown.estimates, shown.generated = {"a": Estimate(1.0, 0.5, "s", at_bound=False)}, False
        assert len(module.summary_lines(shown)) == 3

    @pytest.mark.parametrize(("length", "rows"), [(31, 1), (32, 2)])
    def test_a_long_name_has_its_own_line(self, monkeypatch, length, rows):
        monkeypatch.setattr(module, "merit_lines", lambda fit: [])
        estimates = {"n" * length: Estimate(1.0, 0.5, "s", at_bound=False)}
        shown = SimpleNamespace(
            estimates=estimates, verdict="lack_of_fit", model=SimpleNamespace(constants={})
        )
        assert len(module.summary_lines(shown)) == 1 + rows

    def merits(self, **changed):
        body = SimpleNamespace(r2=0.9, rmse=0.1, held_out=1.0)
        cases = [
            SimpleNamespace(label=x, bodies=(body, body), energy_drift=d) for x, d in (("a", 0.1), ("b", 0.3))
        ]
        noise = SimpleNamespace(pure=1.0, pure_u=0.1, level=2.0, unresolved=0.0)
        known = {
            "cases": cases, "misfit": 1.1, "n_eff": 50.0, "bic": 3.0, "noise": [noise] * 9, "torque_unit": "N m",
            "findings": ["word " * 40],
        }  # fmt: skip
        return module.merit_lines(SimpleNamespace(**known | changed))

    def test_lines_of_merit_fit_into_80_columns(self):
        lines = self.merits()
        assert max(map(len, lines)) in range(70, 80)
        assert [x.split()[:2] for x in lines[1:5]] == [
            ["a", "casing"],
            ["a", "rotor"],
            ["b", "casing"],
            ["b", "rotor"],
        ]
        assert "0.3," in lines[6]

    @pytest.mark.parametrize(("unresolved", "stated"), [(1.9, False), (2.1, True)])
    def test_a_torque_below_the_angle_noise_is_stated_if_it_is_larger(self, unresolved, stated):
        noise = [SimpleNamespace(pure=1.0, pure_u=0.1, level=2.0, unresolved=u) for u in (0.0, unresolved)]
        text = " ".join(self.merits(noise=noise))
        assert ("not separable" in text) is stated
        assert ("2, 2.1 N m" in text) is stated
        assert "not separable" not in " ".join(self.merits(noise=()))

    def test_correlated_angle_noise_is_stated_of_each_camera_that_shows_it(self, monkeypatch):
        """Of two recordings; the first has none in its windows, the second has both parts of the casing's."""
        silent = AngleNoise(2e-3, 1e-4, 0.5, gain=9.9, needed=10.0)
        slow = AngleNoise(2e-3, 1e-4, 0.5, gain=10.0, needed=10.0)
        both = AngleNoise(3e-3, 1e-4, 0.25, 7e-3, 1e-3, 4.0, gain=90.0, needed=10.0)
        turning = AngleNoise(turn_sigma=7e-3, turn_sigma_u=1e-3, turn_time=4.0, gain=90.0, needed=10.0)
        data = [
            SimpleNamespace(record=SimpleNamespace(label=x), angle_noise=own, rotor_angle_noise=other)
            for x, own, other in (("one", slow, silent), ("two", both, turning))
        ]
        shown = object.__new__(Fit)
        object.__setattr__(shown, "problem", SimpleNamespace(data=data))
        lines = module.angle_noise_lines(shown)
        assert [x.partition(":")[0] for x in lines] == [
            "correlated angle noise of one",
            "correlated angle noise of two",
            "correlated angle noise of two in the rotor's windows",
        ]
        slow_part, turn_part = [x.partition(": ")[2].split("; ") for x in (lines[0], lines[2])]
        assert len(slow_part) == len(turn_part) == 1
        assert "mrad" in slow_part[0]
        assert slow_part == ["2.00 +- 0.10 mrad, correlation time 0.5 s"]
        assert turn_part == ["7.0 +- 1.0 mrad that repeats with the turn, changing in 4 s"]
        assert lines[1].partition(": ")[2].split("; ") == [
            "3.00 +- 0.10 mrad, correlation time 0.25 s",
            *turn_part,
        ]
        object.__setattr__(shown, "problem", SimpleNamespace(data=data[:1]))
        assert module.angle_noise_lines(shown) == [lines[0].replace(" of one", "")]
        assert module.angle_noise_lines(SimpleNamespace()) == []


class TestBodies:
    """A recording of a wheel (the main body) and of an arm with two runs, and a second case."""

    def fit(self):
        mechanism = SimpleNamespace(bodies=("arm", "wheel", "hub"), main="wheel")
        runs = [
            SimpleNamespace(state=0, name="a"),
            SimpleNamespace(state=2, name="h"),
            SimpleNamespace(state=0, name="b"),
        ]
        record = SimpleNamespace(
            bodies=[SimpleNamespace(name="disc", state=0), SimpleNamespace(name="rim", state=1)],
            mechanism=mechanism, casing="wheel run", rotor=runs, quantity="angle", harmonic=0.0,
        )  # fmt: skip
        data = SimpleNamespace(record=record, smoothing_width=7)
        shown = object.__new__(Fit)
        layout = SimpleNamespace(model=SimpleNamespace(mechanism=mechanism))
        problem = SimpleNamespace(data=[data, data], layout=layout)
        for name, value in {"problem": problem, "labels": ("x", "y")}.items():
            object.__setattr__(shown, name, value)
        return shown

    def test_speeds_are_those_of_all_runs_of_the_body(self, monkeypatch):
        monkeypatch.setattr(module, "speeds", lambda run, quantity, width: (run, quantity, width))
        shown = self.fit()
        runs = shown.problem.data[0].record.rotor
        assert shown.measured_speeds(1, 1) == [("wheel run", "angle", 7)]
        assert shown.measured_speeds(0, 0) == [(runs[0], "angle", 7), (runs[2], "angle", 7)]
        assert shown.measured_speeds(0, 2) == [(runs[1], "angle", 7)]
        for case, body in ((2, 0), (-1, 0), (0, 3), (0, -1), (0.5, 1), (0, 1.5)):
            with pytest.raises(EstimationError):
                shown.measured_speeds(case, body)

    def test_a_body_is_found_by_its_name_and_the_main_one_by_default(self):
        shown = self.fit()
        places = {name: shown._place(name, 0) for name in (None, "disc", "rim", "wheel")}
        assert places == {None: 1, "disc": 0, "rim": 1, "wheel": 1}
        with pytest.raises(EstimationError, match="no body"):
            shown._place("hub", 0)
        with pytest.raises(EstimationError, match="no case"):
            shown._place("disc", 2)

    @pytest.mark.parametrize("case", [0, 1])
    def test_the_curve_is_that_of_body_and_case(self, monkeypatch, case):
        monkeypatch.setattr(module, "evaluate", lambda *asked: asked)
        shown = self.fit()
        assert shown.eval([1.0], body="disc", case=case, quantity="omega") == (shown, [1.0], 0, case, "omega")
        assert shown.eval() == (shown, None, 1, 0, None)

    def test_intervals_are_those_of_the_named_free_parameters(self, monkeypatch):
        from fitting.inference import _profile

        monkeypatch.setattr(_profile, "profile", lambda fit, key, level: (key, level))
        shown = self.fit()
        names = ("a.k", "b.c", "initial.omega_r", "tied.d", "absent.e")
        free = np.array([True, True, True, False, True])
        shown.problem.layout.names, shown.problem.layout.is_free = names, free
        known = {n: None for n in names if n != "absent.e"}
        for name, value in {"estimates": known, "labels": ("x",)}.items():
            object.__setattr__(shown, name, value)
        monkeypatch.setattr(Fit, "body_name", "")
        assert shown.conf_interval() == {"a.k": ("a.k", 0.95), "b.c": ("b.c", 0.95)}
        assert shown.conf_interval("k", level=0.5) == {"k": ("a.k", 0.5)}
        assert shown.conf_interval("b.c", level=[0.5, 1]) == {"b.c": {0.5: ("b.c", 0.5), 1.0: ("b.c", 1.0)}}
        with pytest.raises(Exception, match="d"):
            shown.conf_interval("tied.d")

    def test_energy_is_that_of_a_label(self, monkeypatch):
        monkeypatch.setattr(module, "energy_balance", lambda case, theta, path: (case, theta, path))
        shown = self.fit()
        shown.problem.cases = ["first", "second"]
        for name, value in {"theta": "theta", "predictions": [SimpleNamespace(path=p) for p in "pq"]}.items():
            object.__setattr__(shown, name, value)
        assert shown.energy() == ("first", "theta", "p")
        assert shown.energy("x") == ("first", "theta", "p")
        assert shown.energy("y") == ("second", "theta", "q")
        with pytest.raises(EstimationError, match="no case"):
            shown.energy("z")
