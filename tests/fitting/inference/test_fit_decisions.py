"""When a fit searches again, at which noise, from which values, and which of several minima it keeps."""

import math
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import oscillators
import pytest
from linearised import covariance, gyroscope, least_squares

from fitting import LIBRARY, Estimate, EstimationError, Model, SimulationError
from fitting.effects._mechanism import GYROSCOPE
from fitting.effects._user import resolve
from fitting.inference import _fit as module
from fitting.inference import _optimisation as optimisation
from fitting.inference._fit import cauchy, deviance_at_noise_of, fit, huber
from fitting.inference._optimisation import is_far
from fitting.inference._parameters import ParameterLayout, PowerLaw
from fitting.inference._record import Samples


class Level(SimpleNamespace):
    """Process noise; `log_determinant` grows with its level."""

    def at(self, level):
        return Level(**(vars(self) | {"level": level}))

    @property
    def raised(self):
        return self.level > 1.5 * self.least

    @property
    def whitener(self):
        return SimpleNamespace(log_determinant=100.0 * self.level)


def noise(level=1.0, least=1.0, pure=1.0, excess=0.0):
    return Level(level=level, least=least, pure=pure, excess=excess)


def body(speed, time=None, *, oscillation=None, parts=("casing", "rotor"), label="run"):
    speed = np.asarray(speed, dtype=float)
    time = np.linspace(0.0, 10.0, len(speed)) if time is None else time
    record = SimpleNamespace(label=label, parts=frozenset(parts))
    return SimpleNamespace(
        initial_speeds=(time, np.column_stack([10 * speed, speed])),
        motion=oscillators.stub(oscillation),
        record=record,
    )


class TestRest:
    @pytest.mark.parametrize(
        ("slowest", "at", "rests"),
        [(0.9, 60, True), (1.1, 60, False), (-0.9, 60, True), (0.0, 3, False), (0.0, 6, True)],
    )
    def test_a_casing_slower_than_a_hundredth_is_at_rest_after_the_start(self, slowest, at, rests):
        speed = np.full(100, 100.0)
        speed[at] = slowest
        path = SimpleNamespace(path=SimpleNamespace(jumps={}))
        problem = SimpleNamespace(data=[body(np.full(100, 5.0)), body(speed)], predict=lambda theta: [path])
        assert module._comes_to_rest(problem, None) is rests

    def test_a_model_that_reverses_comes_to_rest(self):
        paths = [SimpleNamespace(path=SimpleNamespace(jumps=j)) for j in ({}, {3: "matrix"})]
        problem = SimpleNamespace(data=[body(np.full(100, 5.0))], predict=lambda theta: paths)
        assert module._comes_to_rest(problem, None)

    @pytest.mark.parametrize("fails", [False, True])
    def test_a_stop_is_passed_without_process_noise(self, monkeypatch, fails):
        def search(problem, theta, *, quick, max_iterations):
            assert (problem, quick, max_iterations) == ("white", True, 60)
            if fails:
                raise EstimationError("it diverges", "")
            return SimpleNamespace(theta="moved", active="active")

        monkeypatch.setattr(module, "search", search)
        monkeypatch.setattr(module, "first_noise", lambda problem, theta: ("noise about", theta))
        problem = SimpleNamespace(with_white_noise=lambda: "white", with_noise=lambda noise: noise)
        expected = "start" if fails else "moved"
        found = module._past_stops(problem, "start")
        assert found == (("noise about", expected), expected, None if fails else "active")


class TestLessNoise:
    def levels(self, noises, *, rests=False, at_bound=False):
        path = SimpleNamespace(path=SimpleNamespace(sense=np.array([1.0, 0.0 if rests else 1.0])))
        problem = SimpleNamespace(
            predict=lambda theta: [path],
            layout=SimpleNamespace(at_bound=lambda theta: np.array([False, at_bound])),
        )
        return list(module._lower_levels(problem, None, noises))

    def test_levels_with_which_a_search_may_end_elsewhere(self):
        one = [noise(9.0, least=0.5)]
        assert self.levels(one) == []
        assert self.levels(one, rests=True) == self.levels(one, at_bound=True) == [(0.5,), (0.0,)]
        quiet = [noise(0.6, least=0.5)]
        assert self.levels(quiet, rests=True, at_bound=True) == []

    def test_a_case_that_the_model_does_not_describe_keeps_its_level(self):
        cases = [
            noise(9.0, least=0.5, excess=10.0),
            noise(8.0, least=0.4, excess=30.0),
            noise(0.1, least=0.3),
        ]
        assert self.levels(cases) == [(0.5, 8.0, 0.3)]
        assert self.levels([cases[0], cases[2]]) == []
        zero = [noise(9.0, least=0.0), noise(0.0, least=0.0)]
        assert self.levels(zero, rests=True) == [(0.0, 0.0)]  # once

    @pytest.mark.parametrize(
        ("deviances", "kept"), [((100.0, 90.0, 95.0), 1), ((80.0, 90.0, 95.0), 0), ((100.0, None, 70.0), 2)]
    )
    def test_the_least_deviance_is_kept(self, monkeypatch, deviances, kept):
        def search(trial, theta, *, quick, active):
            asked.append((trial, active))
            k = len(asked)
            if deviances[k] is None:
                raise SimulationError("it diverges", "")
            return SimpleNamespace(theta=k, active=f"active {k}")

        asked = []
        monkeypatch.setattr(module, "search", search)
        monkeypatch.setattr(module, "_lower_levels", lambda *_: iter([(0.5,), (0.0,)]))
        monkeypatch.setattr(module, "measure_noise", lambda trial, theta: ("noise", theta))
        monkeypatch.setattr(module, "_deviance", lambda problem, theta, noise: deviances[theta])
        problem = SimpleNamespace(with_noise=lambda noise: [n.level for n in noise])
        first = SimpleNamespace(theta=0, active="first")
        found, measured = module._with_less_noise(problem, first, (noise(9.0),), quick=True)
        assert [levels for levels, _ in asked] == [[0.5], [0.0]]
        assert asked[1][1] == ("first" if deviances[1] is None else "active 1")
        assert found.theta == kept
        assert measured == ((noise(9.0),) if kept == 0 else ("noise", kept))

    @pytest.mark.parametrize(
        ("first", "last", "given", "found", "again"),
        [
            ((False, False), (True, False), 1.0, 2.0, True),
            ((True, False), (True, False), 1.0, 2.0, False),  # it started there
            ((False, True), (True, False), 1.0, 2.0, True),
            ((False, False), (True, False), 1.0, 1.4, False),  # no more noise than the recording has
            ((False, False), (True, False), 2.0, 2.0, False),  # as much as was given
            ((False, False), (False, False), 1.0, 2.0, False),
        ],
    )
    def test_a_search_that_ends_at_a_bound_with_more_noise(self, first, last, given, found, again):
        layout = SimpleNamespace(at_bound=np.array)
        assert (
            module._ends_at_a_bound_with_more_noise(
                SimpleNamespace(layout=layout), first, last, [noise(given)], [noise(found)]
            )
            is again
        )


class TestDeviance:
    def test_it_is_that_of_generalised_least_squares(self):
        """Chi-square with the nuisance parameters free, plus the logarithm of the determinant of the covariance."""
        rows = np.random.default_rng(1).standard_normal(len(gyroscope().predictions[0].rows))
        base = gyroscope(level=2e-7, residual=[rows])
        c = covariance(base, 2e-7)
        chi2, _ = least_squares(base.problem.data[0].nuisance, rows, c)
        found = module._deviance(base.problem, base.theta, base.noise)
        assert found == pytest.approx(chi2 + np.linalg.slogdet(c)[1], rel=1e-6)

    @pytest.mark.parametrize(
        ("own", "other", "lower", "expected", "levels"),
        [
            ((3.0,), (4.0,), 10.0, 100.0, None),  # the other has more noise
            ((3.0,), (2.0,), 90.0, 90.0, [2.0]),
            ((3.0,), (2.0,), 110.0, 100.0, [2.0]),
            ((3.0,), (2.0,), None, 100.0, [2.0]),
            ((3.0, 1.0), (2.0, 5.0), 90.0, 90.0, [2.0, 1.0]),  # of each case the lower one
        ],
    )
    def test_a_lower_level_of_another_fit_may_describe_the_base_better(
        self, monkeypatch, own, other, lower, expected, levels
    ):
        asked = []

        def search(problem, theta):
            if lower is None:
                raise SimulationError("it diverges", "")
            return SimpleNamespace(theta=theta)

        monkeypatch.setattr(module, "search", search)
        monkeypatch.setattr(module, "_deviance", lambda problem, theta, noise: lower)
        problem = SimpleNamespace(with_noise=lambda noise: asked.append([n.level for n in noise]))
        base = SimpleNamespace(noise=[noise(x) for x in own], deviance=100.0, problem=problem, theta=0)
        assert deviance_at_noise_of(base, SimpleNamespace(noise=[noise(x) for x in other])) == expected
        assert asked == ([] if levels is None else [levels])


class TestStarts:
    @pytest.mark.parametrize(("given", "expected"), [(None, [0.7, 1.35]), ({"a": 1.0}, ["usual", 0.7, 1.35])])
    def test_other_exponents_and_the_programs_own_values(self, monkeypatch, given, expected):
        monkeypatch.setattr(module, "initial_values", lambda problem, known: np.array([5.0, 1.2]))
        layout = SimpleNamespace(model=Model.of(["casing.air.linear"]))
        problem = SimpleNamespace(
            power_laws=[SimpleNamespace(g=1)],
            transformed=lambda theta: theta,
            physical=lambda u: u,
            layout=layout,
        )
        found = [t.tolist() for t in module._other_starts(problem, np.array([3.0, 1.1]), given)]
        first = 5.0 if given else 3.0
        wanted = [[5.0, 1.2]] if given else []
        assert found == [*wanted, [first, 0.7], [first, 1.35]]
        problem.power_laws = []
        assert [t.tolist() for t in module._other_starts(problem, np.array([3.0, 1.1]), given)] == wanted

    @pytest.mark.parametrize("given", [None, {"casing.air.linear.b2": 1.0}])
    def test_a_search_begins_also_without_dry_friction(self, monkeypatch, given):
        """Dry friction of the casing stops it too early; viscous friction and that of the bearing remain."""
        asked = []
        monkeypatch.setattr(
            module, "initial_values", lambda problem, known: asked.append(known) or np.zeros(2)
        )
        names = ["touchpoint.constant", "touchpoint.stribeck", "casing.air.linear", "bearing.linear"]
        problem = SimpleNamespace(power_laws=[], layout=SimpleNamespace(model=Model.of(names)))
        list(module._other_starts(problem, np.zeros(2), given))
        assert asked[-1] == {**(given or {}), "touchpoint.constant.b1": 0.0, "touchpoint.stribeck.k": 0.0}
        assert len(asked) == (1 if given is None else 2)

    def test_the_best_of_several_searches_is_kept(self, monkeypatch):
        def search(problem, begin, *, quick):
            assert quick
            if begin < 0:
                raise EstimationError("it fails", "")
            return SimpleNamespace(minimum=SimpleNamespace(cost=begin))

        monkeypatch.setattr(module, "search", search)
        first = SimpleNamespace(minimum=SimpleNamespace(cost=30.0))
        for others, cost in (([40.0, -1.0], 30.0), ([40.0, -1.0, 20.0, 25.0], 20.0), ([], 30.0)):
            found = module._from_other_starts(None, first, others, quick=True)
            assert found.minimum.cost == cost

    @pytest.mark.parametrize(
        ("cost", "far"), [(0.99 * optimisation._FAR * 50, False), (1.01 * optimisation._FAR * 50, True)]
    )
    def test_a_solution_is_far_from_the_data(self, cost, far):
        assert is_far(SimpleNamespace(rows=50), SimpleNamespace(minimum=SimpleNamespace(cost=cost))) is far

    def of(self, value, stderr):
        return Estimate(value, stderr, "N m", at_bound=False)

    def test_values_of_separate_fits_are_weighted(self):
        alone = [
            SimpleNamespace(labels=("a",), estimates={"x.k": self.of(1.0, 1.0), "y.k": self.of(4.0, 1.0)}),
            SimpleNamespace(labels=("b",), estimates={"x.k": self.of(6.0, 0.5), "y.k": self.of(9.0, 1.0)}),
        ]
        assert module._of_separate_fits("x.k", alone) == pytest.approx((1.0 + 4 * 6.0) / 5)
        assert module._of_separate_fits("y.k@b", alone) == 9.0
        alone[1].estimates["x.k"] = self.of(6.0, math.nan)
        assert module._of_separate_fits("x.k", alone) == 1.0
        alone[0].estimates["x.k"] = self.of(1.0, 0.0)
        assert module._of_separate_fits("x.k", alone) == 3.5  # the mean, where none is known

    @pytest.mark.parametrize(("deviance", "again"), [(90.0, True), (110.0, False)])
    def test_a_search_from_separate_fits_is_kept_where_it_is_better(self, monkeypatch, deviance, again):
        alone = SimpleNamespace(labels=("a",), estimates={"x.k": self.of(1.0, 1.0)}, noise=(noise(),))
        second, other = SimpleNamespace(theta="second"), (noise(2.0),)
        first, own = SimpleNamespace(theta="first"), (noise(3.0),)
        monkeypatch.setattr(module, "fit", lambda *_, **__: alone)
        monkeypatch.setattr(module, "initial_values", lambda problem, start: start)
        monkeypatch.setattr(
            module, "search_with_noise", lambda problem, theta, start, *, quick: (second, other)
        )
        deviances = {("first", 3.0): 100.0, ("second", 2.0): deviance}
        monkeypatch.setattr(module, "_deviance", lambda problem, theta, n: deviances[theta, n[0].level])
        problem = SimpleNamespace(data=[1, 2], layout=SimpleNamespace(model=None, names=("x.k",)))
        found = module._from_separate_fits(problem, first, own, quick=True)
        assert found == ((second, other) if again else (first, own))

    def test_a_separate_fit_that_fails_leaves_the_joint_one(self, monkeypatch):
        def failing(*_, **__):
            raise EstimationError("it diverges", "")

        monkeypatch.setattr(module, "fit", failing)
        problem = SimpleNamespace(data=[1, 2], layout=SimpleNamespace(model=None, names=()))
        assert module._from_separate_fits(problem, "found", "noise", quick=True) == ("found", "noise")


class TestShapes:
    def test_unknown_shapes_are_searched_and_held(self, monkeypatch):
        step = LIBRARY["touchpoint.step"]
        layout = SimpleNamespace(
            names=(
                "casing.air.linear.b2",
                "touchpoint.step.k@a",
                "touchpoint.step.t0@a",
                "touchpoint.step.t0@b",
            )
        )
        problem, asked = SimpleNamespace(layout=layout), []
        monkeypatch.setattr(
            module, "unknown_shapes", lambda layout, given: [step] if not given or "b" in given else []
        )
        monkeypatch.setattr(
            module, "initial_shapes",
            lambda problem, theta, effects, *, fitted, noise: asked.append((fitted, noise)) or ("found", "theta"),
        )  # fmt: skip
        held = ("touchpoint.step.t0@a", "touchpoint.step.t0@b")
        assert module.with_initial_shapes(problem, 0, None, "noise") == ("found", "theta", held)
        assert module.with_initial_shapes(problem, 0, {"casing.air.linear.b2": 1.0, "b": 1.0}) == (
            "found",
            "theta",
            held,
        )
        assert asked == [(False, "noise"), (True, None)]
        assert module.with_initial_shapes(problem, 0, {"c": 1.0}) == (problem, 0, ())


KNOWN = {"a.k": 1.0}


@dataclass(frozen=True)
class Asked:
    """A problem that remembers the noise at which it is searched, and what is held."""

    calls: list
    layout: object
    data: tuple = ()
    noise: object = "white"
    held: tuple = ()
    rows: int = 100

    def with_noise(self, noise):
        return replace(self, noise=noise)

    def holding(self, names, theta):
        return replace(self, held=tuple(names))


class TestFit:
    """The searches of a fit with the noise of each, in order."""

    def fitted(
        self,
        monkeypatch,
        *,
        cost=100.0,
        given=None,
        start=None,
        steady=(),
        quick=False,
        bound=False,
        own="measured",
        cases=1,
        oscillation=None,
        restoring=False,
        unknown=(),
    ):
        calls = []
        data = [body([1.0, 2.0], label=f"run{i}", oscillation=oscillation) for i in range(cases)]
        layout = SimpleNamespace(tied=(), names=("a.k",), absent=())
        problem = Asked(calls, layout, tuple(data))

        def search(problem, theta, *, quick=False, active=None):
            calls.append((problem.noise, problem.held, quick, active))
            minimum = SimpleNamespace(cost=cost, converged=True)
            return SimpleNamespace(theta=theta + 1, active=f"active {len(calls)}", minimum=minimum)

        def with_noise(problem, theta, given, *, quick):
            calls.append("search_with_noise")
            return SimpleNamespace(theta=theta + 1, active="first"), own

        def refine(problem, theta, noise, *, fixed=False):
            return f"{noise}{'!' if fixed else '+'}"

        def separate(problem, found, noise, *, quick):
            calls.append("separate")
            return found, "separate"

        def less(problem, found, noise, *, quick):
            calls.append("less noise")
            return found, "less"

        monkeypatch.setattr(module, "Problem", SimpleNamespace(of=lambda *_: problem))
        monkeypatch.setattr(module, "ParameterLayout", SimpleNamespace(of=lambda *_: layout))
        monkeypatch.setattr(module, "CaseData", SimpleNamespace)
        monkeypatch.setattr(module, "_check", lambda *_: None)
        monkeypatch.setattr(module, "initial_values", lambda *_: 0)
        monkeypatch.setattr(module, "search", search)
        monkeypatch.setattr(module, "search_with_noise", with_noise)
        monkeypatch.setattr(module, "refine_level", refine)
        monkeypatch.setattr(module, "raised_noise", lambda problem, theta, noise: f"raised {noise}")
        monkeypatch.setattr(
            module, "with_initial_shapes", lambda problem, theta, start, noise: (problem, theta, unknown)
        )
        monkeypatch.setattr(module, "_ends_at_a_bound_with_more_noise", lambda *_: bound)
        monkeypatch.setattr(module, "_with_less_noise", less)
        monkeypatch.setattr(module, "_from_separate_fits", separate)
        monkeypatch.setattr(
            module, "outcome", lambda problem, theta, noise, *, converged: (theta, noise, problem.noise)
        )
        model = SimpleNamespace(restoring=restoring)
        found = fit(model, data, noise=given, start=start, steady=steady, quick=quick)
        return calls, found

    def test_choices_and_ranges_reach_the_layout(self, monkeypatch):
        layouts = []
        self.fitted(monkeypatch, given="given", start=KNOWN)
        monkeypatch.setattr(
            module,
            "ParameterLayout",
            SimpleNamespace(
                of=lambda *args: layouts.append(args) or SimpleNamespace(names=("a.k",), tied=(), absent=())
            ),
        )
        model = SimpleNamespace(restoring=False, free=("a.k", "b.k"))
        data = [body([1.0, 2.0])]
        options = {"ranges": {"a.k": (0.0, 1.0)}, "ties": {"b.k": "a.k"}}
        fit(model, data, share=["s"], per_case=["p"], noise="given", start=KNOWN, **options)
        assert layouts[0] == (model, [data[0].record], ["s"], ["p"], {"a.k": (0.0, 1.0)}, {"b.k": "a.k"})

    def test_noise_of_an_earlier_fit_is_refined_once(self, monkeypatch):
        calls, found = self.fitted(monkeypatch, given="given", start=KNOWN)
        assert calls == [("given", (), False, None), ("given+", (), False, "active 1")]
        assert found == (2, "given+", "given+")

    @pytest.mark.parametrize(("cost", "count"), [(149.0, 2), (151.0, 3)])
    def test_a_large_chi_square_refines_the_noise_with_fixed_variables(self, monkeypatch, cost, count):
        calls, found = self.fitted(monkeypatch, given="given", start=KNOWN, cost=cost)
        assert len(calls) == count
        assert found[1] == ("given+" if count == 2 else "given+!")

    def test_far_from_the_minimum_the_search_begins_at_a_raised_noise(self, monkeypatch):
        calls, _ = self.fitted(monkeypatch, given="given", start={}, unknown=("b.w",))
        assert calls[:2] == [("raised given", ("b.w",), True, None), ("given+", (), False, "active 1")]

    def test_held_parameters_are_freed_at_a_refined_noise(self, monkeypatch):
        calls, _ = self.fitted(monkeypatch, given="given", start=KNOWN, steady=["a.k"])
        assert calls[:2] == [("given", ("a.k",), True, None), ("given+", (), False, "active 1")]

    @pytest.mark.parametrize(
        ("given", "bound", "again"), [("given", True, True), ("given", False, False), (None, True, False)]
    )
    def test_a_new_bound_with_more_noise_is_searched_again(self, monkeypatch, given, bound, again):
        own = (noise(1.0),)
        monkeypatch.setattr(module, "_GIVEN_UP", 30.0)
        calls, found = self.fitted(monkeypatch, given=given, start=KNOWN, bound=bound, own=own)
        assert ("less noise" in calls) is again
        assert not again or found[1:] == ("less", "less")

    @pytest.mark.parametrize(
        ("level", "cases", "separate"), [(31.0, 2, True), (29.0, 2, False), (31.0, 1, False)]
    )
    def test_cases_are_fitted_alone_where_one_is_not_described(self, monkeypatch, level, cases, separate):
        calls, _ = self.fitted(monkeypatch, own=(noise(1.0), noise(level)), cases=cases)
        assert ("separate" in calls) is separate

    @pytest.mark.parametrize(
        ("oscillation", "restoring", "quick"),
        [(SimpleNamespace(), False, True), (SimpleNamespace(), True, False), (None, False, False)],
    )
    def test_an_oscillation_without_a_restoring_torque_is_fitted_quickly(
        self, monkeypatch, oscillation, restoring, quick
    ):
        calls, _ = self.fitted(
            monkeypatch, given="given", start=KNOWN, oscillation=oscillation, restoring=restoring
        )
        assert {c[2] for c in calls} == {quick}


class TestChecks:
    @pytest.mark.parametrize(
        ("cases", "words"),
        [
            ([], "different labels"),
            ([body([1.0]), body([1.0])], "different labels"),
            ([body([1.0], label="a"), body([1.0], label="b", parts=["casing"])], "cannot be fitted together"),
        ],
    )
    def test_cases_that_cannot_be_fitted(self, cases, words):
        with pytest.raises(EstimationError, match=words):
            module._check(Model.of(["casing.air.linear"]), cases)

    def test_a_body_alone_has_laws_of_one_body(self):
        module._check(Model.of(["casing.air.linear"]), [body([1.0], parts=["casing"])])
        with pytest.raises(EstimationError, match=r"bearing\.linear needs rotor data"):
            module._check(Model.of(["bearing.linear"]), [body([1.0], parts=["casing"])])

    @pytest.mark.parametrize(
        ("law", "speeds", "singular"),
        [
            ("casing: -k/(omega_c - 5)", (3.0, 7.0), True),
            ("casing: -k/(omega_c - 5)", (6.0, 9.0), False),
            ("casing: -k/(omega_c - 5)", (5.2, 9.0), True),  # within a tenth of the range
            ("casing: -k/(omega_c - 5)", (5.5, 9.0), False),
            ("casing: -k/omega_c", (0.1, 9.0), False),  # the range is not extended beyond zero
            ("casing: -k/omega_c", (-0.1, 9.0), True),
            ("casing: -k/(omega_c - w)", (3.0, 7.0), False),  # a parameter may move it
            ("casing: -k/(omega_r - 50)", (3.0, 7.0), True),
            ("casing: -k/(delta - 45)", (3.0, 7.0), True),  # delta is nine times the speed
            ("casing: -k/(t - 5)", (3.0, 7.0), True),
            ("casing: -k/(t + 5)", (3.0, 7.0), False),
        ],
    )
    def test_laws_that_are_singular_along_the_motion(self, law, speeds, singular):
        data = [body(np.linspace(*speeds, 50))]
        model = Model.of(["casing.air.linear"]).with_effect(resolve(law))
        if singular:
            with pytest.raises(EstimationError, match="is singular"):
                module._check(model, data)
        else:
            module._check(model, data)

    @pytest.mark.parametrize(
        ("parts", "absent"), [(["casing"], {"initial.omega_r@run"}), (["casing", "rotor"], set())]
    )
    def test_the_rotor_of_a_body_alone_is_not_a_variable(self, parts, absent):
        record = body([1.0], parts=parts).record
        layout = ParameterLayout(Model.of(["casing.air.linear"]), (record,), ())
        assert module._free_names(SimpleNamespace(layout=layout)) == {*layout.names} - absent
        assert {*layout.names} >= absent


class TestRobust:
    def test_the_influence_of_a_sample(self):
        x = np.array([-3.0, -1.345, 0.5, 2.0])
        assert huber(x)[0] == pytest.approx([-1.345, -1.345, 0.5, 1.345])
        assert huber(x)[1].tolist() == [0.0, 1.0, 1.0, 0.0]
        assert cauchy(x)[0] == pytest.approx(x / (1 + (x / 2.385) ** 2))

    def test_pseudo_values_are_predictions_plus_scaled_influence(self, monkeypatch):
        """Scale 1.4826 times the median deviation; the influence is divided by the mean slope, at least a tenth."""
        t = np.arange(5.0)
        value, sigma = np.array([1.0, -1.0, 2.0, -2.0, 50.0]), np.full(5, 0.5)
        model = np.zeros(5)
        run = Samples(t, value, sigma)

        @dataclass(frozen=True)
        class Record:
            casing: Samples
            rotor: tuple = ()

        made = []

        class Data(SimpleNamespace):
            def __init__(self, record, casing, rotor, free_inertia, criteria):
                made.append(record)

            @staticmethod
            def of(record, criteria):
                made.append(record.casing)
                return SimpleNamespace(casing=None, rotor=None)

        monkeypatch.setattr(module, "CaseData", Data)
        monkeypatch.setattr(module, "predicted_samples", lambda *_: iter([model]))
        original = Record(run)
        for psi, floor in ((huber, False), (lambda x: (x, np.zeros(5)), True)):
            made.clear()
            module._pseudo(SimpleNamespace(record=original, free_inertia=False, criteria=None), 0, None, psi)
            scale = 1.4826 * 2.0 / 0.5
            influence, slope = psi(value / sigma / scale)
            expected = model + sigma * scale * influence / (0.1 if floor else slope.mean())
            assert made[0].value == pytest.approx(expected)
            assert made[1] is original  # the measured data remain in the record

    def test_samples_are_predicted_with_their_nuisance_parameters(self):
        """Rows of a constant angle and of a camera error are found again at the samples."""
        plain = gyroscope(level=1e-9)
        data = plain.problem.data[0]
        coefficients = np.zeros(data.nuisance.shape[1])
        coefficients[:3] = (0.3, -0.2, 0.1)  # the zeros of casing and windows
        coefficients[3] = 2e-3
        base = gyroscope(level=1e-9, residual=[data.nuisance @ coefficients])
        base.problem = base.problem.with_noise(base.noise)
        casing, *windows = module.predicted_samples(base.problem.data[0], 0, base)
        plain.problem = plain.problem.with_noise(plain.noise)
        without = gyroscope(level=1e-9, residual=[np.zeros(len(data.nuisance))])
        without.problem = without.problem.with_noise(without.noise)
        still, *others = module.predicted_samples(without.problem.data[0], 0, without)
        assert casing - still == pytest.approx(0.3 + data.camera_columns[:, 0] * 2e-3, abs=1e-6)
        for window, other, zero in zip(windows, others, (-0.2, 0.1), strict=True):
            assert window - other == pytest.approx(np.full(len(window), zero), abs=1e-6)


class TestSearchWithNoise:
    """The order of a fit without known noise."""

    def searched(self, monkeypatch, *, oscillates=False, rests=False, held=()):
        calls = []

        def named(name, result):
            def run(*args, **options):
                calls.append(name)
                return result(*args)

            return run

        solution = SimpleNamespace(theta="wide", active="end")
        steps = {
            "first_noise": lambda problem, theta: "first",
            "with_initial_shapes": lambda problem, theta, given: (problem, theta, held),
            "_comes_to_rest": lambda *_: rests,
            "_past_stops": lambda problem, theta: (problem, "past", "stop"),
            "search": lambda problem, theta: SimpleNamespace(theta="held", active="held"),
            "measure_noise": lambda problem, theta: f"about {theta}",
            "_other_starts": lambda problem, theta, given: theta,
            "search_widely": lambda problem, theta, others: solution,
            "_with_less_noise": lambda problem, found, noise: ("less", noise),
        }
        for name, result in steps.items():
            monkeypatch.setattr(module, name, named(name, result))
        data = [body([1.0]), body([1.0], oscillation=SimpleNamespace() if oscillates else None)]
        problem = Asked(calls, None, tuple(data))
        found, measured = module.search_with_noise(problem, "start", None, quick=False)
        return calls, found, measured

    def test_of_a_motion_in_one_sense(self, monkeypatch):
        calls, found, measured = self.searched(monkeypatch)
        assert calls == [
            "first_noise", "with_initial_shapes", "_comes_to_rest", "_other_starts", "search_widely", "measure_noise",
            "_with_less_noise",
        ]  # fmt: skip
        assert (found, measured) == ("less", "about wide")

    def test_of_a_motion_that_ends(self, monkeypatch):
        assert "_past_stops" in self.searched(monkeypatch, rests=True)[0]

    def test_of_an_oscillation(self, monkeypatch):
        calls, found, _ = self.searched(monkeypatch, oscillates=True, rests=True)
        assert not {"_past_stops", "_with_less_noise"} & set(calls)
        assert found.theta == "wide"

    def test_new_shapes_are_held_first(self, monkeypatch):
        calls, _, _ = self.searched(monkeypatch, held=("a.w",))
        assert calls[3:6] == ["search", "measure_noise", "_other_starts"]
        assert "search" not in self.searched(monkeypatch)[0]


@pytest.mark.parametrize(
    ("same", "repeated"), [((True, True), False), ((True, False), True), ((False, False), True)]
)
def test_one_recording_with_other_noise_repeats_the_fit(monkeypatch, same, repeated):
    def recording(name, has_noise):
        return SimpleNamespace(
            has_noise_of=lambda criteria: has_noise, with_criteria=lambda criteria: (name, criteria)
        )

    def fitted(model, data, *, share, per_case, ranges, ties):
        return model.name, data, share, per_case, ranges, ties

    monkeypatch.setattr(module, "fit", fitted)
    layout = SimpleNamespace(choices=(("x.k", "gone.k"), ("y.k",)), ranges="ranges", ties="ties")
    data = [recording(name, has_noise) for name, has_noise in zip("ab", same, strict=True)]
    problem = SimpleNamespace(data=data, layout=layout)
    found = SimpleNamespace(problem=problem, model=SimpleNamespace(name="model", free=("x.k", "y.k")))
    again = "model", [("a", "other"), ("b", "other")], ["x.k"], ["y.k"], "ranges", "ties"
    assert module.measured_with(found, "other") == (again if repeated else found)


class TestActiveBounds:
    """A search whose minimum is beyond the bounds 0 and 1 of its only variable."""

    def searched(self, monkeypatch, sides, along, *, active=None, model=(), **minimum):
        found = {"x": np.array([2.0]), "converged": True, "cost": 1.0, **minimum}
        asked = []

        @dataclass
        class Found:
            x: Any
            converged: bool
            cost: float

        def minimise(problem, start, *_, **__):
            asked.append("free")
            return Found(**found)

        def out_of_bounds(laws, theta, *_):
            return [1] if theta > 1 else []

        def choices(bounds, theta, *_):
            asked.append(bounds.held)
            return iter(sides[bounds.held])

        def at_bounds(problem, theta, bounds, *_):
            end = along[bounds.held]
            return end and optimisation.Solution(np.array([end.theta]), end, bounds)

        for name, stub in (
            ("minimise", minimise), ("_out_of_bounds", out_of_bounds), ("_choices_of_bound", choices),
            ("_minimum_at_bounds", at_bounds), ("_is_minimum", lambda *_: along[active.held].is_minimum),
        ):  # fmt: skip
            monkeypatch.setattr(optimisation, name, stub)
        layout = SimpleNamespace(
            bounds=lambda: (np.zeros(1), np.ones(1)),
            model=SimpleNamespace(angle_dependent=model, measurement=()),
        )
        problem = SimpleNamespace(
            layout=layout, power_laws=(), rows=10, transformed_bounds=lambda *limits: limits,
            cases=[SimpleNamespace(forget_columns=lambda: asked.append("forget"))],
            transformed=lambda theta: theta, physical=lambda x: x,
        )  # fmt: skip
        return asked, optimisation.search(problem, np.array([0.5]), active=active)

    def end(self, theta, cost=1.0, *, converged=True, is_minimum=True):
        return SimpleNamespace(theta=theta, cost=cost, converged=converged, is_minimum=is_minimum)

    def side(self, *held):
        return optimisation.ActiveBounds((), held), np.array([0.5])

    @pytest.mark.parametrize("best", [0, 1, 2])
    def test_the_bound_of_the_smallest_chi_square_is_kept(self, monkeypatch, best):
        along = {(i,): self.end(0.1 * i, 3.0 if i == best else 5.0 + i) for i in range(3)}
        _, found = self.searched(monkeypatch, {(): [self.side(i) for i in range(3)]}, along)
        assert found.active.held == (best,)
        assert found.theta.tolist() == [0.1 * best]

    def test_bounds_of_a_second_law_follow_those_of_the_first(self, monkeypatch):
        sides = {(): [self.side(0), self.side(1)], (0,): [self.side(0, 2)]}
        along = {(0,): self.end(1.5, 1.0), (0, 2): self.end(0.3, 2.0), (1,): self.end(0.4, 3.0)}
        _, found = self.searched(monkeypatch, sides, along)
        assert (found.active.held, found.theta.tolist()) == ((0, 2), [0.3])

    def test_without_a_model_at_any_bound_the_search_has_not_converged(self, monkeypatch):
        _, found = self.searched(monkeypatch, {(): [self.side(0)]}, {(0,): None})
        assert (found.theta.tolist(), found.minimum.converged, found.active) == ([1.0], False, None)

    @pytest.mark.parametrize(
        ("converged", "cost", "tried"), [(False, 1.1, False), (False, 0.9, True), (True, 1.1, True)]
    )
    def test_bounds_are_not_searched_far_from_the_data(self, monkeypatch, converged, cost, tried):
        asked, found = self.searched(
            monkeypatch,
            {(): [self.side(0)]},
            {(0,): self.end(0.3)},
            converged=converged,
            cost=10 * optimisation._FAR * cost,
        )
        assert asked == ["forget", "free", *([()] if tried else [])]
        assert found.theta.tolist() == [0.3 if tried else 1.0]

    @pytest.mark.parametrize(("model", "rounds"), [((), 1), (("casing.unbalance",), 2)])
    def test_responses_to_the_angle_are_computed_again_at_the_minimum(self, monkeypatch, model, rounds):
        asked, _ = self.searched(monkeypatch, {}, {}, model=model, x=np.array([0.7]))
        assert asked == ["forget", "free"] * rounds

    @pytest.mark.parametrize(
        ("end", "kept"),
        [
            ({}, True), ({"theta": 1.5}, False), ({"converged": False}, False), ({"is_minimum": False}, False),
        ],
    )  # fmt: skip
    def test_bounds_of_an_earlier_solution_are_kept_at_a_minimum(self, monkeypatch, end, kept):
        along = {(0,): self.end(**{"theta": 0.3, **end})}
        active, _ = self.side(0)
        asked, found = self.searched(monkeypatch, {}, along, active=active, x=np.array([0.7]))
        assert asked == ([] if kept else ["forget", "free"])
        assert found.theta.tolist() == [0.3 if kept else 0.7]

    @pytest.mark.parametrize(
        ("at", "residual", "minimum"),
        [
            (0.0, 1.0, True), (0.0, -1.0, False), (1.0, 1.0, False), (1.0, -1.0, True),
            (0.0, -0.19, True), (0.0, -0.21, False), (1.0, 0.19, True), (1.0, 0.21, False),
        ],
    )  # fmt: skip
    def test_chi_square_falls_inwards_by_more_than_the_tolerance(self, at, residual, minimum):
        """By the square of the residual along the column, whose length is 3; the tolerance is 0.04."""
        j = np.array([[3.0, 0.0], [0.0, 1.0]])
        problem = SimpleNamespace(
            layout=SimpleNamespace(bounds=lambda: (np.array([0.0, -9.0]), np.array([1.0, 9.0]))),
            predict=lambda theta: theta, residuals=lambda theta: (np.array([residual, 5.0]), j),
        )  # fmt: skip
        assert optimisation._is_minimum(problem, np.array([at, 0.5]), (0,), 0.04) is minimum

    @pytest.mark.parametrize(
        ("theta", "broken"),
        [((0.1, 0.1), 0), ((-0.1, 0.1), 1), ((2.1, 0.1), 1), ((0.1, -0.1), 1), ((0.1, 2.1), 1)],
    )
    def test_a_law_is_out_of_either_bound_of_d_or_f(self, theta, broken):
        laws, limits = (PowerLaw(0, 1, 2, 10.0),), (np.zeros(3), np.full(3, 2.0))
        assert len(optimisation._out_of_bounds(laws, np.array([*theta, 9.0]), *limits)) == broken

    @pytest.mark.parametrize(("held", "place"), [("d", 1), ("f", 0)])
    def test_with_one_of_d_and_f_at_a_bound_the_other_is_held_too(self, held, place):
        law, theta = PowerLaw(0, 1, 2, 10.0, held=held), np.array([-1.0, -2.0, 1.6])
        active = optimisation.ActiveBounds((law,), (7,))
        ((side, begin),) = optimisation._choices_of_bound(active, theta, np.zeros(3), np.full(3, 2.0))
        assert (side.power_laws, side.held) == ((), (7, place))
        assert begin.tolist() == [0.0 if i == place else x for i, x in enumerate(theta)]

    def test_a_bound_of_d_above_the_torque_leaves_a_thousandth_of_it_to_f(self):
        law, theta = PowerLaw(0, 1, 2, 10.0), np.array([0.01, 0.02, 1.6])
        lower, upper = np.array([0.2, -np.inf, 0.3]), np.array([np.inf, np.inf, 2.5])
        ((_, begin),) = optimisation._choices_of_bound(optimisation.ActiveBounds((law,)), theta, lower, upper)
        torque = 0.01 * 10.0 + 0.02 * 10.0**1.6
        assert begin.tolist() == [0.2, pytest.approx(1e-3 * torque / 10.0**2.5), 2.5]


def test_at_a_bound_of_d_the_torque_and_its_slope_at_the_reference_speed_are_those_beyond_it():
    """T = d x + f x^g with d below its bound, and then with f at its own bound, where only the torque is the same."""
    theta, reference = np.array([0.01, 0.02, 1.6]), 10.0
    lower, upper = np.array([0.02, 0.005, 0.3]), np.array([np.inf, np.inf, 2.5])

    def torque_and_slope(d, f, g):
        return d * reference + f * reference**g, d * reference + g * f * reference**g

    law = PowerLaw(0, 1, 2, reference)
    found = list(optimisation._choices_of_bound(optimisation.ActiveBounds((law,)), theta, lower, upper))
    assert [(side.held, side.power_laws[0].held) for side, _ in found] == [((0,), "d"), ((1,), "f")]
    (_, at_d), (_, at_f) = found
    assert at_d[0] == 0.02
    assert torque_and_slope(*at_d) == pytest.approx(torque_and_slope(*theta))
    assert at_f[1] == 0.005
    assert torque_and_slope(*at_f) == pytest.approx(torque_and_slope(*theta), rel=5e-3)


@pytest.mark.parametrize(
    ("speeds", "symbol", "reverses"),
    [
        ((-0.9, 50.0), "omega_r", True),
        ((-0.4, 50.0), "omega_r", False),
        ((0.0, 50.0), "omega_r", False),
        ((-50.0, 0.4), "omega_r", False),
        ((-50.0, 0.6), "omega_r", True),
        ((-50.0, -1.0), "omega_r", False),
        # against the casing at 2 rad/s, the bearing turns in one sense or in both
        ((1.0, 50.0), "delta", True),
        ((2.1, 50.0), "delta", False),
        ((-60.0, 1.9), "delta", False),
    ],
)
def test_a_speed_reverses_beyond_a_hundredth_of_its_largest_value(speeds, symbol, reverses):
    time = np.array([0.0, 1.0])
    record = SimpleNamespace(mechanism=GYROSCOPE, bodies=[SimpleNamespace(part="casing")])
    known = {"casing": (time, np.array([2.0, 2.0])), "rotor": (time, np.array(speeds))}
    data = SimpleNamespace(record=record, speeds=known)
    assert module._reverses(data, symbol) is reverses


def test_of_further_searches_the_best_is_taken(monkeypatch):
    ends = {"a": 8.0, "b": 12.0, "c": None, "d": 5.0}

    def search(problem, begin, *, quick):
        assert (problem, quick) == ("problem", True)
        if ends[begin] is None:
            raise EstimationError("no motion")
        return SimpleNamespace(minimum=SimpleNamespace(cost=ends[begin]), begin=begin)

    monkeypatch.setattr(module, "search", search)
    first = SimpleNamespace(minimum=SimpleNamespace(cost=10.0), begin="first")
    for others, best in (
        ("", "first"),
        ("b", "first"),
        ("ab", "a"),
        ("abcd", "d"),
        ("dab", "d"),
        ("c", "first"),
    ):
        assert module._from_other_starts("problem", first, others, quick=True).begin == best
