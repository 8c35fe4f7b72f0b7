"""Laws of an oscillator: which are fitted exactly, BIC of averaged equations, jackknife, and effects of one kind."""

import math
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import oscillators
import pytest

from fitting import LIBRARY, Estimate, EstimationError
from fitting._criteria import DEFAULT
from fitting.discovery import _oscillator
from fitting.discovery._information import rivals
from fitting.discovery._oscillator import LawSet, OscillatorLaws, Strength, fit_oscillator, oscillator_laws

GRAVITY, SPRING, BOTH = ("casing.gravity",), ("casing.spring.linear",), ("spring", "cubic")
DRY, WET, ALL = ("touchpoint.constant",), ("casing.air.linear",), ("touchpoint.constant", "casing.air.linear")


def laws(*sets, damping=(DRY, WET)):
    kept = tuple(LawSet(r, d, {"of": f"{r}{d}"}) for r, d in sets)
    first = kept[0]
    return OscillatorLaws(first.restoring, first.damping, (first.restoring,), damping, first.parameters, kept)


def decide(monkeypatch, found, bic, reversals=10):
    """Return the chosen laws, the exact fit and the names of all fits; `bic` maps the names to a BIC or None."""
    fitted = []

    def fit(model, _):
        fitted.append(model)
        if bic[model] is None:
            raise EstimationError("not this one")
        return SimpleNamespace(bic=bic[model], model=SimpleNamespace(effects=model))

    monkeypatch.setattr(_oscillator, "fit", fit)
    data = SimpleNamespace(motion=oscillators.stub(SimpleNamespace(reversals=[0.0] * reversals)))
    chosen, exact = fit_oscillator(found, tuple, data)
    return chosen, exact, fitted


def test_the_damping_is_decided_first_and_then_the_restoring_torque(monkeypatch):
    found = laws((GRAVITY, DRY), (GRAVITY, WET), (SPRING, DRY), (SPRING, WET))
    bic = {(*GRAVITY, *DRY): 50.0, (*GRAVITY, *WET): 20.0, (*SPRING, *WET): 0.0}
    chosen, exact, fitted = decide(monkeypatch, found, bic)
    assert fitted == list(bic)  # the spring with dry friction is not fitted
    assert (chosen.restoring, chosen.damping, exact.bic) == (SPRING, WET, 0.0)
    assert chosen.parameters == {"of": f"{SPRING}{WET}"}
    assert (chosen.restoring_classes, chosen.damping_classes) == ((SPRING,), (WET,))


@pytest.mark.parametrize(("excess", "smaller"), [(0.9, True), (1.1, False)])
def test_the_smallest_set_that_the_data_do_not_separate_is_chosen(monkeypatch, excess, smaller):
    found = laws((GRAVITY, ALL), (GRAVITY, DRY), damping=(ALL, DRY))
    bic = {(*GRAVITY, *ALL): 0.0, (*GRAVITY, *DRY): excess * DEFAULT.equivalence_width}
    chosen, _, _ = decide(monkeypatch, found, bic)
    assert chosen.damping == (DRY if smaller else ALL)
    assert chosen.damping_classes == ((ALL, DRY) if smaller else (ALL,))


def test_a_set_that_cannot_be_fitted_is_skipped(monkeypatch):
    found = laws((GRAVITY, DRY), (GRAVITY, WET))
    chosen, _, _ = decide(monkeypatch, found, {(*GRAVITY, *DRY): None, (*GRAVITY, *WET): 3.0})
    assert chosen.damping == WET
    with pytest.raises(EstimationError, match="not this one"):
        decide(monkeypatch, found, {(*GRAVITY, *DRY): None, (*GRAVITY, *WET): None})


@pytest.mark.parametrize("more", [False, True])
def test_through_many_reversals_the_chosen_set_alone_is_fitted(monkeypatch, more):
    """500 reversals are integrated for four candidates: 125 of each."""
    found = laws((GRAVITY, DRY), (GRAVITY, WET))
    bic = {(*GRAVITY, *DRY): 9.0, (*GRAVITY, *WET): 0.0}
    few = DEFAULT.refit_reversals // DEFAULT.refit_least
    chosen, _, fitted = decide(monkeypatch, found, bic, few + more)
    assert len(fitted) == (1 if more else 2)
    assert chosen.damping == (DRY if more else WET)


@pytest.mark.parametrize(
    ("value", "stderr", "exact", "exact_stderr", "contradicts"),
    [
        (1.0, 0.01, 1.19, 0.0, False),  # a fifth
        (1.0, 0.01, 1.21, 0.0, True),
        (1.0, 0.01, 0.81, 0.0, False),
        (1.0, 0.01, 0.79, 0.0, True),
        (-1.0, 0.01, -1.19, 0.0, False),
        (0.1, 0.03, 0.34, 0.04, False),  # five times 0.03 and 0.04 in quadrature
        (0.1, 0.03, 0.36, 0.04, True),
        (0.1, 0.03, -0.16, 0.04, True),
        (0.1, 0.04, 0.29, math.inf, False),  # at its bound
        (0.1, 0.04, 0.31, math.inf, True),
    ],
)
def test_strengths_that_contradict_each_other(value, stderr, exact, exact_stderr, contradicts):
    other = Strength(exact, exact_stderr, "N m", approximate=False)
    assert Strength(value, stderr, "N m").contradicts(other) is contradicts


class TestExactFit:
    """Laws by the averaged equations beside an exact fit; the data leave spring or gravity, dry or wet damping."""

    LINEAR, PENDULUM = ("casing.spring.linear",), ("casing.gravity",)

    def combined(self, effects, estimates, **changes):
        laws = OscillatorLaws(
            self.LINEAR,
            DRY,
            (self.LINEAR, self.PENDULUM),
            changes.get("damping_classes", (DRY, WET)),
            {
                "casing.spring.linear.k": Strength(1.0, 0.01, "N m"),
                "touchpoint.constant.b1": Strength(2.0, 0.01, "N m"),
            },
        )
        fit = SimpleNamespace(
            model=SimpleNamespace(effects=[SimpleNamespace(name=n) for n in effects]),
            estimates={k: Estimate(x, 0.02, "N m", at_bound=False) for k, x in estimates.items()},
        )
        return laws, *laws.with_fit(fit)

    def test_its_values_take_the_place_of_the_approximate_ones(self):
        exact = {"casing.spring.linear.k": 1.1, "initial.omega_c": 7.0}
        _, found, sentence = self.combined((*self.LINEAR, *DRY), exact)
        assert sentence == ""
        assert {k: (x.value, x.approximate) for k, x in found.parameters.items()} == {
            "casing.spring.linear.k": (1.1, False), "touchpoint.constant.b1": (2.0, True),
        }  # fmt: skip

    @pytest.mark.parametrize(
        ("effects", "restoring", "damping"),
        [
            (PENDULUM + WET, PENDULUM, WET),
            (PENDULUM + ALL, PENDULUM, DRY),  # this damping is not left by the data
            (LINEAR + DRY, LINEAR, DRY),
        ],
    )
    def test_its_laws_are_taken_where_the_data_leave_them(self, effects, restoring, damping):
        exact = {f"{n}.k": 1.0 for n in effects}
        _, found, sentence = self.combined(effects, exact)
        assert (found.restoring, found.damping, sentence) == (restoring, damping, "")
        assert {k.rpartition(".")[0] for k in found.parameters} == {*restoring, *damping}

    def test_a_contradiction_is_stated_and_changes_nothing(self):
        other, found, sentence = self.combined((*self.LINEAR, "casing.spring.cubic"), {})
        assert found is other
        assert (
            "restoring torque of the fitted model is casing.spring.linear + casing.spring.cubic" in sentence
        )
        other, found, sentence = self.combined(self.LINEAR, {"casing.spring.linear.k": 1.3})
        assert found is other
        assert "The exact fit gives casing.spring.linear.k = 1.3 N m" in sentence


class TestAveraged:
    """All sets of three restoring and eight damping torques, with the BIC and the error of the phase of each given."""

    DAMPING = ("touchpoint.constant", "casing.air.linear", "casing.air.quadratic")
    RESTORING = (
        ("casing.spring.linear",),
        ("casing.gravity",),
        ("casing.spring.linear", "casing.spring.cubic"),
    )

    def laws(self, monkeypatch, bic, wrong=(), *, general=True):
        self.asked = []

        def averaged(names, data, scales=None):
            assert data == ["data"]
            if len(names) == 5 and scales is None:
                return SimpleNamespace(scales="scales") if general else None
            assert scales == "scales"
            self.asked.append(names)
            error = _oscillator.LARGEST_PHASE_ERROR * (1.01 if names in wrong else 0.99)
            return SimpleNamespace(names=names, phase_error=error)

        monkeypatch.setattr(_oscillator, "Model", SimpleNamespace(of=tuple))
        monkeypatch.setattr(_oscillator, "averaged_fit", averaged)
        monkeypatch.setattr(_oscillator, "_information", lambda general: "shares")
        monkeypatch.setattr(_oscillator, "_bic", lambda fitted, shares: bic.get(fitted.names, 500.0))
        monkeypatch.setattr(_oscillator, "_strengths", lambda fitted, shares, data: {"of": fitted.names})
        return oscillator_laws("data")

    def test_every_set_is_tried(self, monkeypatch):
        found = self.laws(monkeypatch, {})
        subsets = [c for n in range(4) for c in combinations(self.DAMPING, n)]
        assert sorted(self.asked) == sorted((*r, *d) for r in self.RESTORING for d in subsets)
        assert len(found.sets) == 24

    def test_the_smallest_set_within_the_width_is_chosen(self, monkeypatch):
        spring, gravity, cubic = self.RESTORING
        bic = {(*cubic, *DRY): 100.0, (*gravity, *ALL): 105.0, (*spring, *DRY): 109.0, spring: 111.0}
        found = self.laws(monkeypatch, bic)
        assert (found.restoring, found.damping, found.parameters) == (spring, DRY, {"of": (*spring, *DRY)})
        assert (found.restoring_classes, found.damping_classes) == ((cubic, gravity, spring), (DRY, ALL))
        assert [(s.restoring, s.damping) for s in found.sets[:4]] == [
            (cubic, DRY), (gravity, ALL), (spring, DRY), (spring, ()),
        ]  # fmt: skip

    def test_a_set_that_loses_the_phase_is_left_out(self, monkeypatch):
        spring, gravity, _ = self.RESTORING
        bic = {(*spring, *DRY): 100.0, (*gravity, *DRY): 200.0}
        found = self.laws(monkeypatch, bic, wrong=[(*spring, *DRY)])
        assert (found.restoring, len(found.sets)) == (gravity, 23)
        every = [(*r, *d) for r in self.RESTORING for n in range(4) for d in combinations(self.DAMPING, n)]
        assert self.laws(monkeypatch, bic, wrong=every) is None
        assert self.laws(monkeypatch, bic, general=False) is None


class TestErrors:
    """Uncertainties of two strengths from 240 residuals of amplitude and as many of phase."""

    COUNT = 240

    def rows(self, size):
        random = np.random.default_rng(2)
        design = random.standard_normal((2 * self.COUNT, 2)) * [30.0, 50.0]
        return design, size * random.standard_normal(2 * self.COUNT)

    def strengths(self, monkeypatch, size, jackknife):
        design, rest = self.rows(size)
        keys = ("a.k", "b.k")
        layout = SimpleNamespace(names=("start", *keys), unit=lambda key: f"unit of {key}")
        monkeypatch.setattr(_oscillator, "ParameterLayout", SimpleNamespace(of=lambda model, records: layout))
        monkeypatch.setattr(_oscillator, "Model", SimpleNamespace(of=tuple))
        monkeypatch.setattr(_oscillator, "_jackknife", lambda design, rest, scale: np.array(jackknife))
        best = SimpleNamespace(
            rows=[(keys, design, rest)], scales=[np.ones(2 * self.COUNT)], theta=[9.0, 2.0, -3.0]
        )
        found = _oscillator._strengths(best, np.array([0.5, 0.25]), SimpleNamespace(record=None))
        assert {k: (s.value, s.unit) for k, s in found.items()} == {
            "a.k": (2.0, "unit of a.k"),
            "b.k": (-3.0, "unit of b.k"),
        }
        return [s.stderr for s in found.values()]

    @pytest.mark.parametrize("size", [3.0, 0.1])
    def test_they_are_those_of_weighted_least_squares_and_of_the_averaging(self, monkeypatch, size):
        """Weights 1/2 and 1/4; errors that the residuals show to be larger are scaled up, and not down."""
        design, rest = self.rows(size)
        weight = np.repeat([0.5, 0.25], self.COUNT)
        covariance = np.linalg.inv(design.T @ (weight[:, None] * design))
        scale = max(float(weight @ rest**2) / (0.75 * self.COUNT - 4), 1.0)
        expected = np.sqrt(scale * np.diag(covariance) + (5e-3 * np.array([2.0, 3.0])) ** 2)
        assert self.strengths(monkeypatch, size, [0.0, 0.0]) == pytest.approx(expected)
        larger = self.strengths(monkeypatch, size, [7.0, 0.0])
        assert larger == pytest.approx([math.hypot(7.0, 0.01), expected[1]])

    def test_the_jackknife_omits_twelve_parts_of_the_record_in_turn(self):
        """With levels of amplitude and phase, in units of their scales, free."""
        design, rest = self.rows(3.0)
        scale = np.repeat([2.0, 5.0], self.COUNT)
        half = np.repeat([0, 1], self.COUNT)
        columns = np.column_stack([design, (half == 0) / 2.0, (half == 1) / 5.0])
        part = np.arange(2 * self.COUNT) % self.COUNT // (self.COUNT // 12)
        kept = [part != b for b in range(12)]
        each = np.array(
            [np.linalg.solve(columns[k].T @ columns[k], columns[k].T @ rest[k])[:2] for k in kept]
        )
        expected = np.sqrt(11 / 12 * ((each - each.mean(axis=0)) ** 2).sum(axis=0))
        assert _oscillator._jackknife(design, rest, scale) == pytest.approx(expected)

    def test_slow_residuals_keep_a_hundredth_of_their_information(self):
        rest = np.concatenate([np.ones(4000), -np.ones(4000)])
        shares = _oscillator._information(SimpleNamespace(rows=[((), None, rest)]))
        assert shares == pytest.approx([0.02 / 1.98] * 2)


def equations(rest, keys=("a.k", "b.k"), design=None, theta=(3.0, 5.0), scales=None):
    rows = ((list(keys), design, np.asarray(rest)),)
    return SimpleNamespace(rows=rows, theta=np.array(theta), scales=(scales,), phase_error=0.1)


@pytest.mark.parametrize(
    ("rest", "shares"),
    [
        # correlations of 1/2 (of products 1 and squares 2), of 0 and of less than 0
        ([1.0, 1.0, 0.0, 1.0, 0.0, 1.0], ((1 - 0.5) / 1.5, 1.0)),
        ([1.0, -1.0, 0.0, 1.0, 1.0, 1.0], (1.0, (1 - 2 / 3) / (1 + 2 / 3))),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 0.0], (1.0, 1.0)),
    ],
)
def test_shares_of_independent_residuals_follow_from_their_correlation(rest, shares):
    assert _oscillator._information(equations(rest)) == pytest.approx(shares)


def test_a_correlation_has_a_limit():
    r = _oscillator._MOST_CORRELATED
    found = _oscillator._information(equations(np.ones(4000)))
    assert found == pytest.approx([(1 - r) / (1 + r)] * 2)


def test_bic_counts_independent_residuals():
    rest = [1.0, 2.0, 3.0, 1.0, 1.0, 2.0]
    shares = np.array([0.5, 0.25])
    expected = 0.5 * 14 + 0.25 * 6 + 2 * math.log(0.75 * 3)
    assert _oscillator._bic(equations(rest), shares) == pytest.approx(expected)
    # of less than two there is at least the logarithm of two
    assert _oscillator._bic(equations(rest), shares / 10) == pytest.approx(0.7 + 0.15 + 2 * math.log(2.0))


class TestPossible:
    def possible(self, monkeypatch, fits, *, general=True, cases=1):
        asked = []

        def averaged(model, data, errors=None):
            if model == "general":
                return SimpleNamespace(scales="scales") if general else None
            asked.append(errors)
            return fits[model]

        monkeypatch.setattr(_oscillator, "averaged_fit", averaged)
        monkeypatch.setattr(_oscillator, "Model", SimpleNamespace(of=lambda names: "general"))
        monkeypatch.setattr(_oscillator, "_information", lambda general: "shares")
        monkeypatch.setattr(_oscillator, "_bic", lambda fitted, shares: fitted.bic)
        model = SimpleNamespace(with_effect=lambda e: e.name)
        effects = [SimpleNamespace(name=n) for n in fits]
        criteria = SimpleNamespace(equivalence_width=6.0)
        found = _oscillator.possible_restoring(model, effects, [None] * cases, criteria)
        assert set(asked) <= {"scales"}
        return found

    def fitted(self, bic, error=0.1):
        return SimpleNamespace(bic=bic, phase_error=error)

    def test_effects_within_the_width_of_the_best_are_possible(self, monkeypatch):
        fits = {
            "a": self.fitted(10.0),
            "b": self.fitted(15.9),
            "c": self.fitted(16.1),
            "d": self.fitted(5.0, 0.71),
            "e": None,
        }
        assert self.possible(monkeypatch, fits) == {"a", "b"}

    def test_without_an_answer_there_is_none(self, monkeypatch):
        assert self.possible(monkeypatch, {"a": self.fitted(1.0, 0.7)}) is None
        assert self.possible(monkeypatch, {"a": self.fitted(1.0)}, general=False) is None
        assert self.possible(monkeypatch, {"a": self.fitted(1.0)}, cases=2) is None


RNG = np.random.default_rng(3)


class TestOscillation:
    def test_correlated_residuals_have_less_information(self):
        """Shares (1 - r) / (1 + r) with the correlation r of neighbours, not negative."""
        smooth = np.sin(np.arange(400) / 3.0)
        opposite = np.where(np.arange(400) % 2, 1.0, -1.0)
        rest = np.concatenate([smooth, opposite])
        shares = _oscillator._information(SimpleNamespace(rows=[((), None, rest)]))
        r = math.cos(1 / 3.0)
        assert shares == pytest.approx([(1 - r) / (1 + r), 1.0], rel=0.05)

    def test_bic_counts_independent_residuals(self):
        rest = RNG.standard_normal(60)
        fitted = SimpleNamespace(rows=[(("a.k", "b.k"), None, rest)])
        shares = np.array([0.5, 0.25])
        expected = 0.5 * np.sum(rest[:30] ** 2) + 0.25 * np.sum(rest[30:] ** 2) + 2 * math.log(0.75 * 30)
        assert _oscillator._bic(fitted, shares) == pytest.approx(expected)

    def test_the_jackknife_gives_the_standard_error_of_least_squares(self):
        """Independent residuals of unit variance: errors of the inverse normal matrix, within the scatter of blocks."""
        count = 2000
        design = RNG.standard_normal((2 * count, 2))
        found = np.mean(
            [
                _oscillator._jackknife(design, RNG.standard_normal(2 * count), np.ones(2 * count))
                for _ in range(8)
            ],
            axis=0,
        )
        assert found == pytest.approx(np.sqrt(np.diag(np.linalg.inv(design.T @ design))), rel=0.25)

    @pytest.mark.parametrize(("apart", "both"), [(9.0, True), (11.0, False)])
    def test_springs_within_the_width_of_the_best_bic_are_possible(self, monkeypatch, apart, both):
        bic = {"a": 100.0, "b": 100.0 + apart}

        def averaged(model, data, scales=None):
            return SimpleNamespace(scales=None, phase_error=0.0, name=model)

        monkeypatch.setattr(_oscillator, "averaged_fit", averaged)
        monkeypatch.setattr(_oscillator, "_information", lambda _: None)
        monkeypatch.setattr(_oscillator, "_bic", lambda fitted, _: bic[fitted.name])
        model = SimpleNamespace(with_effect=lambda effect: effect.name)
        effects = [SimpleNamespace(name=n) for n in bic]
        found = _oscillator.possible_restoring(model, effects, [None], DEFAULT)
        assert found == ({"a", "b"} if both else {"a"})
        assert _oscillator.possible_restoring(model, effects, [None, None], DEFAULT) is None

        def lost(model, data, scales=None):
            error = 2.0 * _oscillator.LARGEST_PHASE_ERROR if isinstance(model, str) else 0.0
            return SimpleNamespace(scales=None, phase_error=error, name=model)

        monkeypatch.setattr(_oscillator, "averaged_fit", lost)
        assert _oscillator.possible_restoring(model, effects, [None], DEFAULT) is None


class TestRivals:
    """Three candidates with one column each, beside one parameter of the model; scores by least squares."""

    ROWS = 400

    def rivals(
        self,
        strengths,
        cosine=0.0,
        threshold=12.0,
        names=("casing.air.quadratic", "touchpoint.step", "bearing.heating"),
    ):
        base, *others = np.linalg.qr(RNG.standard_normal((self.ROWS, 4)))[0].T
        first, second, third = others
        second = cosine * first + math.sqrt(1 - cosine**2) * second
        columns = np.stack([base, first, second, third], axis=1)
        data = columns[:, 1:] @ np.array(strengths) + 5.0 * base
        candidates = [(SimpleNamespace(**self.effect(n)), None) for n in names]
        information = SimpleNamespace(
            added=dict, candidates=candidates, places=lambda i: [i + 1], parameters=1,
            present=columns.T @ columns, right=columns.T @ data,
            fit=SimpleNamespace(problem=SimpleNamespace(rows=self.ROWS)),
        )  # fmt: skip
        return rivals(information, [threshold] * 3, DEFAULT)

    @staticmethod
    def effect(name):
        e = LIBRARY[name]
        return {"name": name, "free": e.parameters[:1], "amplitude": e.amplitude, "kind": e.kind}

    def test_one_clear_effect_has_no_rival(self):
        assert self.rivals((10.0, 0.0, 0.0)) == []

    def test_nearly_equal_responses_are_rivals_by_their_likelihood(self):
        first, second = self.rivals((10.0, 0.0, 0.0), cosine=0.98)
        assert (first.names, second.names) == (("casing.air.quadratic",), ("touchpoint.step",))
        assert first.weight == 1.0
        assert second.weight == pytest.approx(math.exp(-0.5 * 100.0 * (1 - 0.98**2)))
        assert first.strengths == pytest.approx([10.0])
        assert second.strengths == pytest.approx([9.8])
        assert (first.columns, second.columns) == ((1,), (2,))

    @pytest.mark.parametrize(("apart", "kept"), [(9.0, True), (11.0, False)])
    def test_the_width_decides(self, apart, kept):
        found = self.rivals((20.0, 0.0, 0.0), cosine=math.sqrt(1 - apart / 400.0))
        assert bool(found) is kept

    def test_friction_is_not_negative(self):
        found = self.rivals((-10.0, 0.0, 0.0), cosine=0.98)
        assert not any("casing.air.quadratic" in r.names for r in found)

    @pytest.mark.parametrize(("threshold", "found"), [(99.0, True), (101.0, False)])
    def test_the_best_one_is_significant(self, threshold, found):
        assert bool(self.rivals((10.0, 0.0, 0.0), cosine=0.98, threshold=threshold)) is found
