"""Exchanges of a law to first order, against least squares of every combination of columns."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest

from fitting.discovery import _exchange as module
from fitting.discovery._score import Score
from fitting.effects._effect import Effect, Parameter

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
        monkeypatch.setattr(module, "context_without", lambda about, removed, cases: context)
        monkeypatch.setattr(module, "torque_rows", lambda removed, cases: self.own[:, 0])
        monkeypatch.setattr(module, "best_group", lambda *_, **__: self.own_score)
        monkeypatch.setattr(module, "score", lambda *_, **__: laws)
        monkeypatch.setattr(module, "_columns", lambda s, cases: self.columns[s.effect.name])
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
        found = module.exchanges(self.about, law("old"), [], [], SimpleNamespace(evidence=evidence))
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
        assert [module._parameters(s) for s in laws] == [4, 2]


def test_columns_of_a_law_per_recording_are_apart(monkeypatch):
    seen = []

    def stacked(trials, *, per_case):
        seen.append((trials, per_case))
        return [("shape", "columns")]

    monkeypatch.setattr(module, "stacked", stacked)
    cases = [SimpleNamespace(trials=lambda e, shapes, i=i: (i, e.name, shapes)) for i in (1, 2)]
    for per_case, count, apart in ((True, 2, True), (False, 2, False), (True, 1, False)):
        s = scored(law("x", shape=True, per_case=per_case), NONE, cases=count)
        assert module._columns(s, cases[:count]) == "columns"
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

    monkeypatch.setattr(module, "fit", fit)
    monkeypatch.setattr(
        module, "initial_values_of", lambda about, s: {f"{s.effect.name}.k@1": 5.0, f"{s.effect.name}.n": 1.5}
    )
    about = SimpleNamespace(
        model=Known(("old", "b")),
        noise="noise",
        values={"old.k": 1.0, "older.k": 3.0, "b.k": 2.0, "initial": 9.0},
    )
    change = module.Exchange(law("old"), (scored(law("x", shape=True), NONE), scored(law("y"), NONE)), -5.0)
    found = change.refit(about)
    assert (found is not None) is math.isfinite(deviance)
    ((names, options),) = calls
    assert names == ("b", "x", "y")
    start = {"older.k": 3.0, "b.k": 2.0, "initial": 9.0, "x.k@1": 5.0, "x.n": 1.5, "y.k@1": 5.0, "y.n": 1.5}
    assert options == {"start": start, "noise": "noise", "steady": ["x.n"], "quick": True}
