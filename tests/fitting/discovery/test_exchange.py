"""A law exchanged for two others: whole fits, and the first order against least squares of all combinations."""

import itertools
import math
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from cases import shared
from scipy.integrate import solve_ivp

from fitting import LIBRARY, Case, Criteria, Effect, Model, Parameter, SimulationError, fit, improve
from fitting._criteria import DEFAULT
from fitting.discovery import _exchange
from fitting.discovery import _select as module
from fitting.discovery._exchange import exchanges
from fitting.discovery._refine import with_shape_parameter
from fitting.discovery._score import CaseColumns, Score
from fitting.discovery._select import History, Step
from fitting.effects._words import change_name
from fitting.inference._case_data import CaseData
from fitting.study._serialisation import step_document

INERTIA = 2e-3
# torque of each law at the initial speed of 100 rad/s [N m]; the exponents of the speed are 0, 1 and 2
STRENGTHS = {"touchpoint.constant": 3e-3, "casing.air.linear": 4e-3, "casing.air.quadratic": 5e-3}
CONSTANT, LINEAR, QUADRATIC = STRENGTHS
STRIBECK, COOLING, EDDY = "touchpoint.stribeck", "casing.seal.cooling", "casing.brake.eddy"


def slowed(u=0.1, seed=1, label="case"):
    """Return a body that all laws slow down from 100 rad/s, as measured with the uncertainty `u` [rad/s]."""

    def rate(_, y):
        return [-sum(k * (y[0] / 100.0) ** n for n, k in enumerate(STRENGTHS.values())) / INERTIA]

    t = np.linspace(0.0, 20.0, 1000)
    exact = solve_ivp(rate, (0.0, 20.0), [100.0], t_eval=t, rtol=1e-10, atol=1e-9).y[0]
    noise = u * np.random.default_rng(seed).standard_normal(len(t))
    return Case.from_arrays(wheel={"t": t, "omega": exact + noise, "u": u, "inertia": INERTIA}, label=label)


@cache
def measured(u):
    """Return the data of `slowed` with their noise, which is estimated once."""
    return CaseData.of(slowed(u=u).record)


@shared
def fitted(laws, u=0.1, free=""):
    """Return the fit of some laws; the shape constant of the law `free` is a parameter."""
    known = [LIBRARY[n] for n in laws]
    return fit(Model(tuple(with_shape_parameter(e) if e.name == free else e for e in known)), measured(u))


def history(first, last, **options):
    """Return the first and the last model of a search as its steps."""
    return [Step("", fitted(first, u=options.get("u", 0.1)), ()), Step("+a", fitted(last, **options), ())]


def exchanged(first, last, criteria=DEFAULT, **options):
    """Return the next exchange."""
    return module._exchanged(history(first, last, **options), (), criteria)


def exchanges_of(current, name, criteria=DEFAULT):
    """Return the exchanges of a law of a fit, to first order."""
    effects = [e for e in module.applicable_effects(current, ()) if module._is_friction(e)]
    cases = [CaseColumns(current, i) for i in range(len(current.problem.cases))]
    found = exchanges(current, LIBRARY[name], effects, cases, criteria)
    return sorted(found, key=lambda x: x.delta_bic)


ALL = tuple(STRENGTHS)


@pytest.mark.parametrize("u", [pytest.param(0.1, marks=pytest.mark.slow), 1.0])
def test_a_law_that_replaces_two_is_exchanged_for_them(u):
    found = exchanged((LINEAR,), (LINEAR, STRIBECK), u=u)
    assert found.change == f"+{QUADRATIC} +{CONSTANT} instead of {STRIBECK}"
    assert found.is_exchange
    assert set(found.fit.model.names) == set(ALL)
    assert found.fit.converged
    assert found.fit.bic == pytest.approx(fitted(ALL, u=u).bic, abs=0.05)


@pytest.mark.parametrize(("evidence", "taken"), [(4.0, True), (4.8, False)])
def test_an_exchange_needs_evidence(evidence, taken):
    # BIC falls by 4.4
    found = exchanged((LINEAR, QUADRATIC), (LINEAR, QUADRATIC, COOLING), Criteria(evidence=evidence), u=1.0)
    assert (found is not None) is taken
    if taken:
        assert found.change == f"+{CONSTANT} instead of {COOLING}"


@pytest.mark.parametrize(
    ("first", "last", "u"),
    [
        ((LINEAR,), ALL, 0.1),
        ((LINEAR, QUADRATIC), (LINEAR, QUADRATIC, COOLING), 0.1),  # BIC falls by 1.9
        ((CONSTANT,), (CONSTANT, "casing.air.laminar"), 1.0),  # BIC rises
        ((LINEAR, STRIBECK), (LINEAR, STRIBECK), 0.1),  # a law of the user
    ],
)
def test_a_law_is_kept(first, last, u):
    assert exchanged(first, last, u=u) is None


@pytest.mark.parametrize(("u", "taken"), [(1.0, True), (0.03, False)])
def test_a_law_that_is_not_needed_is_removed(u, taken):
    # at the larger noise the linear drag is at its bound and leaves it when the drift is removed
    last = fitted((*ALL, "touchpoint.drift"), u=u)
    assert last.estimates[f"{LINEAR}.b2"].at_bound is (u == 1.0)
    found = exchanged(ALL, (*ALL, "touchpoint.drift"), u=u)
    assert (found is not None) is taken
    if taken:
        assert found.change == "-touchpoint.drift"
        assert set(found.fit.model.names) == set(ALL)


@pytest.mark.parametrize("equal", [_exchange._EQUAL, 1.0])
def test_a_free_exponent_is_fixed_again(monkeypatch, equal):
    # the torque of the same law with its usual exponent is nearly equal
    monkeypatch.setattr(_exchange, "_EQUAL", equal)
    found = exchanged((LINEAR, CONSTANT), ALL, u=1.0, free=QUADRATIC)
    assert found.change == f"-{QUADRATIC}.n"
    assert f"{QUADRATIC}.n" not in found.fit.estimates
    assert found.fit.bic == pytest.approx(fitted(ALL, u=1.0).bic, abs=0.05)


def test_the_first_order_is_that_of_the_refits():
    current = fitted((LINEAR, QUADRATIC, COOLING), u=1.0)
    first, *_ = exchanges_of(current, COOLING)
    assert [e.name for e in first.laws] == [CONSTANT]
    assert first.refit(current).bic - current.bic == pytest.approx(first.delta_bic, abs=0.1)
    # the levels of noise are those of restricted likelihoods, and the first order takes the most likely ones
    for x in exchanges_of(current, COOLING, Criteria(evidence=0.0)):
        assert x.refit(current).bic - current.bic > x.delta_bic - 0.1


def test_equal_laws_do_not_replace_each_other():
    # a constant torque on a body that does not reverse is a dry friction
    found = exchanges_of(fitted((LINEAR, CONSTANT)), CONSTANT)
    assert found
    assert "external.constant" not in {e.name for x in found for e in x.laws}


def test_a_law_is_exchanged_for_a_simpler_one_that_it_equals():
    """At a high critical speed the braking torque of eddy currents is proportional to the speed."""
    start = fitted(ALL).values
    start |= {f"{EDDY}.k": start[f"{LINEAR}.b2"], f"{EDDY}.w": 9e4}
    current = fit(Model.of((QUADRATIC, CONSTANT, EDDY)), measured(0.1), start=start)
    assert current.estimates[f"{EDDY}.w"].value > 5e4
    (found,) = (x for x in exchanges_of(current, EDDY) if [e.name for e in x.laws] == [LINEAR])
    assert found.delta_bic == pytest.approx(-np.log(current.rows), abs=0.1)


def test_two_laws_are_better_than_an_added_one():
    # with quadratic drag added, BIC falls by 8.5
    current = fitted((LINEAR, CONSTANT), u=1.0)
    assert fitted(ALL, u=1.0).bic < current.bic - 8
    assert all(len(x.laws) < 2 for x in exchanges_of(current, CONSTANT))
    assert any(len(x.laws) == 2 for x in exchanges_of(fitted((LINEAR, STRIBECK), u=1.0), STRIBECK))


@pytest.mark.parametrize(("excess", "taken"), [(1.9, True), (2.9, False)])
def test_a_fall_that_the_noise_causes_does_not_count(monkeypatch, excess, taken):
    # BIC falls by 4.4
    monkeypatch.setattr(module, "deviance_at_noise_of", lambda old, _: old.deviance - excess)
    found = exchanged((LINEAR, QUADRATIC), (LINEAR, QUADRATIC, COOLING), u=1.0)
    assert (found is not None) is taken


@pytest.mark.parametrize(("u", "asked"), [(1.0, True), (0.03, False)])
def test_a_random_torque_is_an_alternative_without_a_lack_of_fit(monkeypatch, u, asked):
    steps = history((LINEAR,), (LINEAR, STRIBECK), u=u)
    assert steps[-1].fit.fails(DEFAULT) == (not asked)
    fall = steps[-1].fit.bic - fitted(ALL, u=u).bic
    for left, taken in ((2.5, True), (1.5, not asked)):
        # the random torque of the old model lowers the deviance, so that BIC falls by `left`
        less = {STRIBECK: fall - left}
        monkeypatch.setattr(
            module,
            "with_random_torque",
            lambda f, _, less=less: SimpleNamespace(deviance=f.deviance - less.get(f.model.names[-1], 0.0)),
        )
        assert (module._exchanged(steps, (), DEFAULT) is not None) is taken


@pytest.mark.slow
def test_a_law_per_recording_counts_for_each():
    both = [CaseData.of(slowed(u=1.0, seed=s, label=str(s)).record) for s in (1, 2)]
    old, new = (fit(Model.of([QUADRATIC, LINEAR, law]), both) for law in (COOLING, CONSTANT))
    assert f"{CONSTANT}.b1@2" in new.estimates
    single = next(
        x for x in exchanges_of(old, COOLING, Criteria(evidence=0.0)) if x.laws == (LIBRARY[CONSTANT],)
    )
    assert single.delta_bic == pytest.approx(new.bic - old.bic, abs=0.2)


def test_an_oscillation_takes_no_part():
    stub = SimpleNamespace(model=SimpleNamespace(effects=(LIBRARY[LINEAR],), names=(LINEAR,), restoring=True))
    base = SimpleNamespace(model=SimpleNamespace(effects=(), names=()))
    assert module._exchanged([Step("", base, ()), Step("+a", stub, ())], (), DEFAULT) is None


class TestImprove:
    def improved(self, monkeypatch, exchanges, fails=False, **options):
        base, kept = fitted((LINEAR,)), []
        steps = [Step(f"-{i}", base, (), is_exchange=True) for i in range(exchanges)]
        monkeypatch.setattr(module, "_improved", lambda *_: History([Step("", base, ())]))

        def next_one(*_):
            if not steps and fails:
                raise SimulationError("the wheel stops and starts too often to be followed")
            return steps.pop(0) if steps else None

        monkeypatch.setattr(module, "_exchanged", next_one)
        found = improve(base, keep=kept.append, **options)
        assert kept == found[1:]
        return [s.change for s in found]

    def test_exchanges_end_the_history(self, monkeypatch):
        assert self.improved(monkeypatch, 0) == [""]
        assert self.improved(monkeypatch, 2) == ["", "-0", "-1"]
        assert self.improved(monkeypatch, 2, exchange=False) == [""]
        assert self.improved(monkeypatch, 1, fails=True) == ["", "-0"]
        assert len(self.improved(monkeypatch, 99)) == 1 + DEFAULT.max_steps

    @pytest.mark.parametrize(
        ("exchanges", "fails", "kept"), [(0, False, True), (1, False, False), (1, True, True)]
    )
    def test_the_reason_of_an_early_end_does_not_apply_after_an_exchange_without_lack_of_fit(
        self, monkeypatch, exchanges, fails, kept
    ):
        base = fitted((LINEAR,))
        stopped = History([Step("", base, ())])
        stopped.stopped = "a random torque"
        steps = [Step("-0", base, (), is_exchange=True)] * exchanges
        monkeypatch.setattr(module, "_improved", lambda *_: stopped)
        monkeypatch.setattr(module, "_exchanged", lambda *_: steps.pop() if steps else None)
        monkeypatch.setattr(type(base), "fails", lambda *_: fails)
        assert improve(base).stopped == ("a random torque" if kept else "")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            f"+{LINEAR} instead of {QUADRATIC}",
            "+ linear air drag of the wheel instead of quadratic air drag of the wheel",
        ),
        (
            f"+bearing.linear +{LINEAR} instead of casing: -k*omega_c",
            "+ viscous friction of the bearing + linear air drag of the wheel instead of law -k*omega_c on the wheel",
        ),
    ],
)  # fmt: skip
def test_an_exchange_is_stated_in_words(change, words):
    assert change_name(change, "wheel") == words
    document = step_document(fitted((LINEAR,)), "f2", change, None)
    assert (document["added"], document["words"]) == (change, words)


ROWS = 30
NONE = np.zeros(0)


def law(name, lower=-9.0, upper=9.0, *, shape=False, per_case=False):
    parameters = (Parameter("k", "N m", lower=lower, upper=upper),)
    parameters += (Parameter("n", "1", "shape", 0.0, 3.0),) * shape
    return Effect(name, "casing", "k*omega_c**n" if shape else "k*omega_c", parameters, per_case=per_case)


def scored(effect, direction, *, absorbed=False, columns=1, cases=1):
    symbols = {"n": 1.0} if len(effect.parameters) > 1 else {}
    return Score(
        effect,
        0.0,
        np.zeros(columns),
        (symbols,) * cases,
        columns,
        1,
        absorbed=absorbed,
        direction=direction,
        null=NONE,
    )


class Setting:
    """The law `old` beside others in 30 rows, with a variable at a bound, at one or two levels of noise."""

    def __init__(self, monkeypatch, laws, *, true, held=0.0, gains=(1.0,), bounds=(2.0, 9.0), seed=3):
        rng = np.random.default_rng(seed)
        self.laws, self.bounds = laws, bounds
        self.own, self.held = 1e7 * rng.standard_normal((ROWS, 1)), rng.standard_normal((ROWS, 1))
        self.columns = {s.effect.name: rng.standard_normal((ROWS, s.columns)) for s in laws}
        self.basis = np.linalg.qr(rng.standard_normal((ROWS, 2)))[0]
        rows = self.held[:, 0] * held + 0.3 * rng.standard_normal(ROWS)
        for name, strength in true.items():
            rows = rows + (self.own if name == "old" else self.columns[name]) @ np.atleast_1d(strength)
        self.levels = [
            SimpleNamespace(
                gain=np.full(ROWS, g), basis=self.basis, deviance=0.0,
                residual=g * (rows - self.basis @ (self.basis.T @ rows)),
            )
            for g in gains
        ]  # fmt: skip
        for level, g in zip(self.levels, gains, strict=True):
            level.deviance = float(level.residual @ level.residual) - 2 * ROWS * math.log(g)
        self.own_score = scored(law("old"), np.eye(ROWS)[0])
        context = SimpleNamespace(levels=self.levels, rotated=lambda x: x)
        monkeypatch.setattr(_exchange, "context_without", lambda about, removed, cases: context)
        monkeypatch.setattr(_exchange, "torque_rows", lambda removed, cases: self.own[:, 0])
        monkeypatch.setattr(_exchange, "best_group", lambda *_, **__: self.own_score)
        monkeypatch.setattr(_exchange, "score", lambda *_, **__: laws)
        monkeypatch.setattr(_exchange, "_columns", lambda s, cases: self.columns[s.effect.name])
        at = np.array([False, True, True])
        layout = SimpleNamespace(
            names=("a.k", "b.k", "old.k"), at_bound=lambda theta: at,
            bounds=lambda: (np.array([-9.0, bounds[0], 0.0]), np.array([9.0, bounds[1], 9.0])),
        )  # fmt: skip
        self.about = SimpleNamespace(
            problem=SimpleNamespace(layout=layout, rows=100), theta=np.array([1.0, 2.0, 0.0]), deviance=40.0,
            predictions=[SimpleNamespace(jacobian=np.concatenate([np.ones((ROWS, 1)), self.held, self.own], axis=1))],
        )  # fmt: skip

    def least(self, columns):
        """Return the least deviance over the levels, and the coefficients."""
        ends = []
        for level in self.levels:
            white = level.gain[:, None] * np.concatenate([*columns, np.zeros((ROWS, 0))], axis=1)
            white = white - self.basis @ (self.basis.T @ white)
            gamma = np.linalg.lstsq(white, level.residual, rcond=None)[0]
            fall = level.residual @ level.residual - np.sum((level.residual - white @ gamma) ** 2)
            ends.append((level.deviance - fall, gamma))
        return min(ends, key=lambda end: end[0])

    def expected(self, laws, evidence):
        """Return names and change of BIC of all exchanges; `laws` are those that take part."""
        every = [self.own_score, *laws]
        columns = [self.own, *(self.columns[s.effect.name] for s in laws)]
        number = [1] + [
            s.columns + len(s.shape[0]) * (len(s.shape) if s.effect.per_case else 1) for s in laws
        ]
        found, added = {}, 0.0
        for count in (0, 1, 2):
            for chosen in itertools.combinations(range(len(every)), count):
                own = [columns[i] for i in chosen]
                deviance, (change, *gammas) = self.least([self.held, *own])
                if not 0.0 <= change <= self.bounds[1] - self.bounds[0]:
                    deviance, gammas = self.least(own)
                delta = deviance - 40.0 + (sum(number[i] for i in chosen) - 1) * math.log(100)
                gammas = np.split(np.array(gammas), np.cumsum([columns[i].shape[1] for i in chosen]))
                limits = [every[i].effect.amplitude for i in chosen]
                if any(
                    ((g < a.lower) | (g > a.upper)).any()
                    for i, g, a in zip(chosen, gammas, limits, strict=False)
                    if i
                ):
                    continue
                if 0 in chosen:
                    added = min(added, delta)
                else:
                    found[tuple(every[i].effect.name for i in chosen)] = delta
        return {k: d for k, d in found.items() if d <= (added if len(k) == 2 else 0.0) - evidence}

    def found(self, evidence):
        found = _exchange.exchanges(self.about, law("old"), [], [], SimpleNamespace(evidence=evidence))
        for x in found:
            assert x.removed.name == "old"
            for s in x.scores:
                assert s.gamma.shape == (s.columns,)
        return {tuple(s.effect.name for s in x.scores): x.delta_bic for x in found}


def directions(count):
    return np.eye(ROWS)[1 : count + 1]


class TestExchanges:
    @pytest.mark.parametrize("held", [3.0, 12.0, -4.0])
    @pytest.mark.parametrize("gains", [(1.0,), (1.0, 0.4)])
    def test_each_combination_has_the_bic_of_least_squares(self, monkeypatch, held, gains):
        """The variable at its bound of 2 may grow to 9 when the law is removed, and not fall."""
        laws = [
            scored(law("a"), directions(3)[0]),
            scored(law("b", shape=True), directions(3)[1]),
            scored(law("c"), directions(3)[2], columns=2),
        ]
        setting = Setting(
            monkeypatch,
            laws,
            true={"old": 2e-8, "a": 2.0, "b": -1.5, "c": [1.0, 0.5]},
            held=held,
            gains=gains,
        )
        for evidence in (-1e6, 2.0, 10.0):
            found, expected = setting.found(evidence), setting.expected(laws, evidence)
            assert found == pytest.approx(expected)
        assert len(setting.found(-1e6)) == 7

    def test_a_strength_beyond_its_bounds_is_not_taken(self, monkeypatch):
        laws = [
            scored(law(name, lower, upper), directions(3)[i])
            for i, (name, lower, upper) in enumerate([("a", 1.0, 9.0), ("b", 0.0, 2.0), ("c", -9.0, 9.0)])
        ]
        for a, b, taken in (
            (1.3, 1.7, {"a", "b", "c"}),
            (0.7, 1.7, {"b", "c"}),
            (1.3, 2.4, {"a", "c"}),
            (-5.0, -1.0, {"c"}),
        ):
            setting = Setting(monkeypatch, laws, true={"a": a, "b": b, "c": 1.0})
            # in the model of both, each strength is near its true value
            both = {k for k in setting.found(-1e6) if len(k) == 2}
            assert (("a", "b") in both) is ({"a", "b"} <= taken)
            assert setting.found(-1e6) == pytest.approx(setting.expected(laws, -1e6))

    def test_equal_and_absorbed_laws_take_no_part(self, monkeypatch):
        first, second = directions(2)
        laws = [
            scored(law("a"), first),
            scored(law("same"), -first),
            scored(law("nearly"), first * (1 - 0.7e-9)),
            scored(law("other"), first * (1 - 1.4e-9)),
            scored(law("absorbed"), second, absorbed=True),
            scored(law("old", shape=True), np.eye(ROWS)[0]),
            scored(law("of the removed"), np.eye(ROWS)[0]),
        ]
        setting = Setting(monkeypatch, laws, true={"a": 2.0})
        kept = [laws[0], laws[3], laws[5]]
        assert setting.found(-1e6) == pytest.approx(setting.expected(kept, -1e6))
        assert {k[0] for k in setting.found(-1e6) if len(k) == 1} == {"a", "other", "old"}

    def test_parameters_of_each_recording_count(self, monkeypatch):
        laws = [
            scored(law("own", shape=True, per_case=True), directions(2)[0], columns=2, cases=2),
            scored(law("shared", shape=True), directions(2)[1], columns=1, cases=2),
        ]
        setting = Setting(monkeypatch, laws, true={"own": [1.0, 2.0]})
        found = setting.found(-1e6)
        assert found == pytest.approx(setting.expected(laws, -1e6))
        assert [_exchange._parameters(s) for s in laws] == [4, 2]


def test_columns_of_a_law_per_recording_are_apart(monkeypatch):
    seen = []

    def stacked(trials, *, per_case):
        seen.append((trials, per_case))
        return [("shape", "columns")]

    monkeypatch.setattr(_exchange, "stacked", stacked)
    cases = [SimpleNamespace(trials=lambda e, shapes, i=i: (i, e.name, shapes)) for i in (1, 2)]
    for per_case, count, apart in ((True, 2, True), (False, 2, False), (True, 1, False)):
        s = scored(law("x", shape=True, per_case=per_case), NONE, cases=count)
        assert _exchange._columns(s, cases[:count]) == "columns"
        assert seen.pop() == ([(i + 1, "x", [{"n": 1.0}]) for i in range(count)], apart)


@pytest.mark.parametrize("deviance", [50.0, math.nan, math.inf])
def test_a_refit_begins_with_the_strengths_of_first_order(monkeypatch, deviance):
    calls = []

    class Known:
        names = ("old", "b")

        def __init__(self, names):
            self.names = names

        def without(self, name):
            return Known(tuple(n for n in self.names if n != name))

        def with_effect(self, effect):
            return Known((*self.names, effect.name))

    def fit(model, about, **options):
        calls.append((model.names, options))
        return SimpleNamespace(deviance=deviance)

    monkeypatch.setattr(_exchange, "fit", fit)
    monkeypatch.setattr(
        _exchange,
        "initial_values_of",
        lambda about, s: {f"{s.effect.name}.k@1": 5.0, f"{s.effect.name}.n": 1.5},
    )
    about = SimpleNamespace(
        model=Known(("old", "b")),
        noise="noise",
        values={"old.k": 1.0, "older.k": 3.0, "b.k": 2.0, "initial": 9.0},
    )
    change = _exchange.Exchange(
        law("old"), (scored(law("x", shape=True), NONE), scored(law("y"), NONE)), -5.0
    )
    found = change.refit(about)
    assert (found is not None) is math.isfinite(deviance)
    ((names, options),) = calls
    assert names == ("b", "x", "y")
    start = {"older.k": 3.0, "b.k": 2.0, "initial": 9.0, "x.k@1": 5.0, "x.n": 1.5, "y.k@1": 5.0, "y.n": 1.5}
    assert options == {"start": start, "noise": "noise", "steady": ["x.n"], "quick": True}
