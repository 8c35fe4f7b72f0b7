"""Tests of a named law and of the moments of inertia: limits against closed formulas, choices on either side."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from linearised import BEGIN, SPAN, gyroscope
from scipy import stats

from fitting import LIBRARY, Candidate, Estimate, EstimationError, Model
from fitting._criteria import DEFAULT
from fitting.discovery import _named_effect as module
from fitting.discovery._named_effect import (
    INERTIA,
    FormTest,
    InertiaRival,
    form_test,
    inertia_within_uncertainty,
    relative_uncertainty,
    reselected,
    with_free_inertia,
)
from fitting.discovery._score import CaseColumns
from fitting.discovery._select import Selection
from fitting.effects._user import resolve

DRAG, LAMINAR, UNBALANCE = (
    LIBRARY[n] for n in ("casing.air.quadratic", "casing.air.laminar", "casing.unbalance")
)
DECAY = "k*exp(-t/w)"


class TestLaw:
    @pytest.mark.parametrize(
        ("law", "variable"),
        [
            ("casing: -k*omega_c**2", "omega_c"),
            ("casing: -k*omega_r**2", "omega_r"),
            ("bearing: -k*delta**2", "delta"),
            ("rotor: k", "omega_r"),
            ("casing: k", "omega_c"),
            ("bearing: k", "delta"),
            ("casing: -k*omega_c*omega_r", "t"),
            ("casing: k*t", "t"),
            ("casing: k*t*omega_c", "t"),
            ("casing: k*voltage*omega_c", "t"),
            ("bearing.heating", "t"),
            ("setup.inertia", "t"),
        ],
    )
    def test_the_only_variable_or_time(self, law, variable):
        assert module._variable(resolve(law, {"voltage": "V"})) == variable

    def test_a_factor_of_the_bearing_is_a_law_of_its_speed(self):
        constant = SimpleNamespace(
            expression=LIBRARY["casing.air.linear"].expression,
            parameters=[SimpleNamespace(symbol=s) for s in ("b2", "omega_c")],
            state=None,
            inputs=(),
            joint="factor",
        )
        assert module._variable(constant) == "delta"

    @pytest.mark.parametrize(
        ("law", "slow"),
        [
            ("bearing.heating", True),
            (f"casing: {DECAY}", True),
            ("casing: k*t", False),
            ("touchpoint.step", False),
            ("bearing.power", False),
            ("casing.air.quadratic", False),
        ],
    )
    def test_a_time_constant_is_a_shape_of_a_law_in_time(self, law, slow):
        assert module._has_time_constant(resolve(law)) is slow

    def test_splines_in_time_bend_at_five_times(self):
        t = np.linspace(3.0, 15.0, 400)
        basis = module._cubic_spline(t)
        assert basis.shape == (400, 9)

        def rest(y):
            return np.abs(basis @ np.linalg.lstsq(basis, y)[0] - y).max()

        assert rest(2.0 - t + 0.3 * t**2 - 0.1 * t**3) < 1e-8
        for place in range(1, 6):
            assert rest(np.maximum(t - 3.0 - 2.0 * place, 0.0) ** 3) < 1e-8
        assert rest(np.maximum(t - 4.0, 0.0) ** 3) > 1e-3


class TestLimit:
    """Responses of four knots, orthogonal and of equal size a: a deviation h has the noncentrality a^2 h'h."""

    def test_the_smooth_test_detects_it_with_ninety_percent(self):
        response = 7.0 * np.linalg.qr(np.random.default_rng(1).standard_normal((30, 4)))[0]
        limit = module._limit(response, 0.4, DEFAULT)
        # the mean square of the deviation is 0.4 h'h / 4
        noncentrality = 49.0 * 4 / 0.4 * limit**2
        threshold = stats.chi2.isf(DEFAULT.doubt_named, 4)
        assert stats.ncx2.sf(threshold, 4, noncentrality) == pytest.approx(0.9, abs=1e-4)

    def test_nine_in_ten_deviations_are_detected(self):
        """Two of four directions respond: their share of h'h is uniform, and above 0.1 in nine of ten."""
        response = np.zeros((30, 4))
        response[0, 0] = response[1, 1] = 7.0
        limit = module._limit(response, 0.4, DEFAULT)
        threshold = stats.chi2.isf(DEFAULT.doubt_named, 2)
        noncentrality = 0.1 * 49.0 * 4 / 0.4 * limit**2
        assert stats.ncx2.sf(threshold, 2, noncentrality) == pytest.approx(0.9, abs=0.04)

    def test_without_a_response_there_is_none(self):
        assert module._limit(np.zeros((30, 4)), 0.4, DEFAULT) == math.inf

    @pytest.mark.parametrize(
        ("limit", "bounds_p", "strong"),
        [(0.22, 0.011, True), (0.23, 0.011, False), (0.22, 0.009, False), (0.06, 1.0, True)],
    )
    def test_a_strong_test_detects_a_twentieth_of_the_mean_square(self, limit, bounds_p, strong):
        assert FormTest(limit, "t", (), bounds_p, any_in_time=False).is_strong(DEFAULT) is strong


def squares(columns, rows):
    """Return the sum of squares that least squares leave."""
    rest = rows - columns @ np.linalg.lstsq(columns, rows)[0]
    return float(rest @ rest)


class TestRows:
    """Rows of a fit with three effects, of which the parameters `at` are at a bound."""

    NAMES = ("a.k", "b.k@x", "b.n", "c.k")

    def found(self, *at):
        layout = SimpleNamespace(
            names=self.NAMES, at_bound=lambda theta: np.array([n in at for n in self.NAMES])
        )
        return SimpleNamespace(theta=np.zeros(4), problem=SimpleNamespace(layout=layout))

    def rows(self):
        random = np.random.default_rng(5)
        free = random.standard_normal((40, 4)) + random.standard_normal((40, 1))
        return free, random.standard_normal(40) + 0.5 * free[:, 0]

    @pytest.mark.parametrize("at", [("a.k",), ("a.k", "c.k")])
    def test_beyond_a_bound_chi_square_falls_as_by_least_squares(self, at):
        free, residual = self.rows()
        held = np.array([n not in at for n in self.NAMES])
        fall = squares(free[:, held], residual) - squares(free, residual)
        names, p = module._active_bounds(self.found(*at), free, residual)
        assert names == at
        assert p / stats.chi2.sf(fall, len(at)) == pytest.approx(1.0)
        assert module._active_bounds(self.found(), free, residual) == ((), 1.0)

    @pytest.mark.parametrize("at", [(), ("c.k",), ("b.n",)])
    def test_a_spline_instead_of_an_effect_raises_chi_square_as_by_least_squares(self, at):
        free, residual = self.rows()
        random = np.random.default_rng(6)
        spline, torque = random.standard_normal((40, 3)), 2.0 * random.standard_normal(40)
        moving = np.array([n not in at for n in self.NAMES])
        others = moving & np.array([not n.startswith("b.") for n in self.NAMES])
        rise = squares(np.column_stack([free[:, others], spline]), residual + torque)
        rise -= squares(free[:, moving], residual)
        found = module._rise_with_spline(
            self.found(*at), SimpleNamespace(name="b"), spline, torque, free, residual
        )
        assert found == pytest.approx(rise)


class TestForm:
    """What is tested of a law along the motion of a gyroscope whose parameters are known."""

    MODEL = Model.of(["rotor.air.quadratic", "touchpoint.constant", "bearing.linear"])

    def form(self, monkeypatch, effect, *, values=None, rise=0.0, cases=("case",)):
        asked = {}
        own = module.piecewise_linear

        def limit(response, square, criteria):
            asked["limit"] = response, square
            return 0.1

        def with_spline(found, effect, spline, torque, free, residual):
            asked["spline"] = spline, torque
            return rise

        monkeypatch.setattr(module, "_limit", limit)
        monkeypatch.setattr(module, "_rise_with_spline", with_spline)
        monkeypatch.setattr(
            module, "piecewise_linear", lambda v, knots: asked.setdefault("knots", knots) * 0 + own(v, knots)
        )
        base = gyroscope(
            self.MODEL.with_effect(effect),
            {f"{effect.name}.k": 2e-7} | (values or {}),
            cases=cases,
            level=1e-7,
        )
        for n in base.noise:
            n.tested = n.level
        base.estimates = {}
        return asked, base, form_test(base, effect, DEFAULT)

    def test_the_knots_span_the_speeds_of_all_cases(self, monkeypatch):
        values = {"initial.omega_c@a": 20.0, "initial.omega_c@b": 60.0}
        asked, base, found = self.form(monkeypatch, DRAG, values=values, cases=("a", "b"))
        speeds = np.concatenate([CaseColumns(base, i).along_motion("omega_c") for i in (0, 1)])
        assert found.variable == "omega_c"
        assert asked["knots"] == pytest.approx(np.linspace(speeds.min(), speeds.max(), 4))

    @pytest.mark.parametrize("law", ["casing.air.quadratic", "bearing: k*delta**2"])
    def test_deviations_are_weighted_by_the_square_of_the_torque(self, monkeypatch, law):
        effect = resolve(law)
        asked, base, found = self.form(monkeypatch, effect, values={f"{effect.name}.k": 1e-10})
        speed = CaseColumns(base, 0).along_motion(found.variable)
        hats = np.maximum(1 - np.abs(speed[:, None] - asked["knots"]) / np.diff(asked["knots"])[0], 0.0)
        response, square = asked["limit"]
        assert square == pytest.approx(np.sum(hats**2 * speed[:, None] ** 4) / np.sum(speed**4))
        # the same deviation at all knots is another strength, which is free
        assert np.abs(response.sum(axis=1)).max() < 1e-4 * np.abs(response).max()
        assert "spline" not in asked
        assert not found.any_in_time

    @pytest.mark.parametrize("joint", ["rotor", "casing", "bearing"])
    def test_a_slow_torque_is_a_spline_on_the_same_bodies(self, monkeypatch, joint):
        effect = resolve(f"{joint}: {DECAY}")
        values = {f"{effect.name}.w": SPAN}
        asked, _, _ = self.form(monkeypatch, effect, values=values)
        spline, torque = asked["spline"]
        assert spline.shape[1] == 9
        size = np.linalg.norm(spline, axis=0)
        assert squares(spline / size, torque) < 1e-6 * float(torque @ torque)

    @pytest.mark.parametrize(("per_case", "columns"), [(False, 9), (True, 18)])
    def test_a_law_of_each_case_is_compared_with_a_spline_in_each(self, monkeypatch, per_case, columns):
        effect = resolve(f"casing: {DECAY}")
        object.__setattr__(effect, "per_case", per_case)
        values = {f"{effect.name}.{k}@{c}": x for k, x in (("k", 2e-7), ("w", 9.0)) for c in "ab"}
        values |= {f"{effect.name}.w": 9.0}
        asked, _, _ = self.form(monkeypatch, effect, values=values, cases=("a", "b"))
        assert asked["spline"][0].shape[1] == columns

    @pytest.mark.parametrize(("rise", "any_in_time"), [(9.9, True), (10.1, False)])
    def test_a_spline_that_is_worse_by_less_than_ten_describes_as_well(self, monkeypatch, rise, any_in_time):
        effect = resolve(f"casing: {DECAY}")
        values = {f"{effect.name}.w": BEGIN}
        _, _, found = self.form(monkeypatch, effect, values=values, rise=rise)
        assert found.any_in_time is any_in_time


def record(casing=math.nan, rotor=math.nan):
    """A recording whose moments of inertia have these relative uncertainties."""
    return SimpleNamespace(
        I_casing=2e-5, I_rotor=5e-5, I_casing_u=casing * 2e-5, I_rotor_u=rotor * 5e-5,
        parts=frozenset({"rotor", "casing"}),
    )  # fmt: skip


def recordings(*records):
    return SimpleNamespace(problem=SimpleNamespace(data=[SimpleNamespace(record=r) for r in records]))


@pytest.mark.parametrize(
    ("relative", "u"),
    [
        ([(0.03, 0.04)], 0.05),
        ([(0.03, math.nan)], 0.03),
        ([(math.nan, 0.04)], 0.04),
        ([(math.nan, math.nan)], 0.0),
        ([(0.03, 0.04), (0.02, math.nan)], 0.02),
    ],
)
def test_relative_uncertainties_add_in_quadrature(relative, u):
    assert relative_uncertainty(recordings(*(record(*r) for r in relative))) == pytest.approx(u)


def share(value, stderr=1e-3):
    return Estimate(value, stderr, "1", at_bound=False)


@pytest.mark.parametrize(
    ("value", "stated", "stderr", "allowed"),
    [
        (0.019, 0.01, 1e-4, True),
        (0.021, 0.01, 1e-4, False),
        (-0.019, 0.01, 1e-4, True),
        (-0.021, 0.01, 1e-4, False),
        (0.049, 0.015, 0.02, True),  # 1.5 % and 2 % in quadrature, twice
        (0.051, 0.015, 0.02, False),
        (0.001, 0.0, 1.0, False),
    ],
)
def test_an_error_of_inertia_is_allowed_up_to_twice_its_uncertainty(value, stated, stderr, allowed):
    rival = InertiaRival(share(value, stderr), stated, DRAG.name, None, better=True)
    assert rival.is_allowed(DEFAULT) is allowed
    named = [SimpleNamespace(effect=LIBRARY[INERTIA], estimates={"setup.inertia.eps": share(value, stderr)})]
    told = inertia_within_uncertainty(recordings(record(stated or math.nan)), named, DEFAULT)
    assert bool(told) is allowed


def candidate(effect=DRAG, value=50.0, *, significant=True, absorbed=False, alike=(), fit=None):
    screened = SimpleNamespace(score=value, absorbed=absorbed, effect=effect)
    return Candidate(effect, value, -40.0, 1e-6, 0.0, alike, {}, significant, screened, fit)


class TestFreeInertia:
    """The ranking with a free ratio of the moments of inertia; the BIC of the selected fit is 100."""

    def rival(
        self, monkeypatch, bics, *, eps=0.01, stderr=1e-3, stated=math.nan, chosen=DRAG, ranked=None,
        names=(), parts=("rotor", "casing"), fails=False,
    ):  # fmt: skip
        self.refitted = []
        ranked = [candidate(LIBRARY[n]) for n in bics] if ranked is None else ranked

        def fit(model, base, *, start, noise):
            assert (model, start, noise) == (("with", INERTIA), "values", "noise")
            if fails:
                raise EstimationError("it diverges", "")
            return "freed"

        def rank(freed, extra, *, criteria, refitting):
            assert (freed, extra, refitting) == ("freed", ("own",), False)
            return ranked

        def refit(freed, screened, criteria):
            name = screened.effect.name
            self.refitted.append(name)
            if bics.get(name) is None:
                return None
            estimates = {f"{INERTIA}.eps": share(eps, stderr), f"{name}.k": share(1.0)}
            return SimpleNamespace(bic=bics[name], estimates=estimates)

        monkeypatch.setattr(module, "fit", fit)
        monkeypatch.setattr(module, "rank", rank)
        monkeypatch.setattr(module, "refit", refit)
        base = recordings(record(stated))
        base.problem.data[0].record.parts = frozenset(parts)
        base.model = SimpleNamespace(with_effect=lambda e: ("with", e.name))
        base.values, base.noise = "values", "noise"
        final = SimpleNamespace(bic=100.0, model=SimpleNamespace(names=names))
        selected = candidate(chosen) if chosen else None
        return with_free_inertia(base, Selection([], selected, None, final), ("own",), DEFAULT)

    @pytest.mark.parametrize(
        "change",
        [
            {"chosen": None},
            {"chosen": LIBRARY[INERTIA]},
            {"chosen": UNBALANCE},
            {"names": (INERTIA,)},
            {"parts": ("casing",)},
            {"fails": True},
            {"ranked": []},
        ],
    )
    def test_when_none_is_sought(self, monkeypatch, change):
        assert self.rival(monkeypatch, {DRAG.name: 50.0}) is not None
        assert self.rival(monkeypatch, {DRAG.name: 50.0}, **change) is None

    def test_which_candidates_are_refitted(self, monkeypatch):
        """Significant physics that is not absorbed, within ten of the best score."""
        ranked = [
            candidate(LIBRARY["camera.clock"], 99.0),
            candidate(LIBRARY["casing.air.linear"], 80.0, absorbed=True),
            candidate(LIBRARY["casing.windage"], 70.0, significant=False),
            candidate(DRAG, 50.0),
            candidate(LAMINAR, 40.1),
            candidate(LIBRARY["touchpoint.drift"], 39.9),
        ]
        self.rival(monkeypatch, {}, ranked=ranked)
        assert self.refitted == [DRAG.name, LAMINAR.name]
        self.rival(monkeypatch, {}, ranked=[candidate(DRAG)] * 9)
        assert len(self.refitted) == 5

    @pytest.mark.parametrize(
        ("bics", "effect", "better"),
        [
            ({DRAG.name: 89.9}, DRAG.name, True),
            ({DRAG.name: 90.1}, None, None),
            ({LAMINAR.name: 109.9}, LAMINAR.name, False),
            ({LAMINAR.name: 110.1}, None, None),
            ({LAMINAR.name: 90.1}, LAMINAR.name, False),
            ({LAMINAR.name: 89.9}, LAMINAR.name, True),
            ({DRAG.name: 80.0, LAMINAR.name: 70.0}, LAMINAR.name, True),
            ({DRAG.name: 70.0, LAMINAR.name: 80.0}, DRAG.name, True),
            ({DRAG.name: None, LAMINAR.name: 80.0}, LAMINAR.name, True),
        ],
    )
    def test_the_same_effect_needs_evidence_and_another_one_describes_as_well(
        self, monkeypatch, bics, effect, better
    ):
        found = self.rival(monkeypatch, bics)
        assert (found and found.effect, found and found.better) == (effect, better)
        if found is not None:
            assert (found.share.value, found.stated, found.fit.bic) == (0.01, 0.0, bics[effect])

    @pytest.mark.parametrize(
        ("eps", "stderr", "stated", "credible"),
        [
            (0.049, 1e-5, math.nan, True),  # 5 % where nothing is stated
            (0.051, 1e-5, math.nan, False),
            (-0.051, 1e-5, math.nan, False),
            (0.069, 0.01, math.nan, True),  # and twice its own uncertainty
            (0.071, 0.01, math.nan, False),
            (0.019, 1e-5, 0.01, True),
            (0.021, 1e-5, 0.01, False),
            (0.079, 1e-5, 0.04, True),
        ],
    )
    def test_the_error_is_credible(self, monkeypatch, eps, stderr, stated, credible):
        found = self.rival(monkeypatch, {DRAG.name: 50.0}, eps=eps, stderr=stderr, stated=stated)
        assert (found is not None) is credible


class TestReselected:
    FIT = SimpleNamespace(estimates={f"{LAMINAR.name}.k": share(1.0), f"{INERTIA}.eps": share(0.01)})

    def selection(self, *others, alike=()):
        chosen = candidate(DRAG, alike=alike)
        return Selection([chosen, *others], chosen, "named", "final")

    def rival(self, effect=LAMINAR, *, better=True):
        return InertiaRival(share(0.01), 0.0, effect.name, self.FIT, better)

    def test_of_the_same_effect_the_fit_is_the_final_one(self):
        before = self.selection()
        found = reselected(before, self.rival(DRAG))
        assert (found.candidates, found.chosen, found.named, found.final) == (
            before.candidates, before.chosen, "named", self.FIT,
        )  # fmt: skip

    def test_an_effect_that_is_not_better_joins_the_class(self):
        for alike in (("other",), ("other", LAMINAR.name)):
            found = reselected(self.selection(alike=alike), self.rival(better=False))
            assert found.chosen.indistinguishable_from == ("other", LAMINAR.name)
            assert (found.candidates, found.named, found.final) == ([found.chosen], "named", "final")

    def test_a_better_effect_is_first_and_the_other_in_its_class(self):
        third = candidate(UNBALANCE)
        old = candidate(LAMINAR, significant=False)
        before = self.selection(third, old, alike=("other", LAMINAR.name))
        found = reselected(before, self.rival())
        first = found.chosen
        assert first.indistinguishable_from == (DRAG.name, "other")
        assert (first.fit, first.significant, set(first.estimates)) == (self.FIT, True, {f"{LAMINAR.name}.k"})
        assert found.candidates == [first, before.chosen, third]
        assert (found.named, found.final) == (self.FIT, self.FIT)

    def test_an_effect_that_is_not_in_the_list_changes_nothing(self):
        before = self.selection()
        assert reselected(before, self.rival()) is before
        empty = Selection([], None, "named", "final")
        assert reselected(empty, self.rival()).final is self.FIT
