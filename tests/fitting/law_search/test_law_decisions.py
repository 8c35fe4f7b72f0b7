"""Which laws a search refits, keeps and names: the decisions with stand-ins for fits."""

import math
from collections import namedtuple
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import EffectError, Estimate, Model
from fitting._criteria import DEFAULT
from fitting.effects._user import read_effects, resolve
from fitting.law_search import _documents
from fitting.law_search import _laws as module
from fitting.law_search._documents import check_name, save_law
from fitting.law_search._laws import Law, Laws, formula_of, laws

LAG = SimpleNamespace(symbol="lag", rate="(omega_c - lag)/tau")


def form(name, length=0.0, *, state=None, form=""):
    return SimpleNamespace(
        effect=SimpleNamespace(name=name, state=state, per_case=False),
        description_length=length,
        form=form or name,
    )


def score(value, columns=1, shapes=0, *, absorbed=False, name=""):
    return SimpleNamespace(
        score=value,
        columns=columns,
        shape=[{f"s{i}": 1.0 for i in range(shapes)}],
        absorbed=absorbed,
        effect=SimpleNamespace(name=name),
    )


def fit(bic=0.0, *, fails=False, at_bound=False, deviance=None, **more):
    layout = SimpleNamespace(at_bound=lambda theta: np.array([False, at_bound]))
    return SimpleNamespace(
        bic=bic,
        deviance=bic if deviance is None else deviance,
        fails=lambda criteria: fails,
        noise=("noise",),
        theta=np.zeros(2),
        problem=SimpleNamespace(layout=layout),
        **more,
    )


def search(base=None, forms=(), n_eff=math.e):
    """A search without data; with this number of samples, each constant costs 1."""
    made = object.__new__(module._Search)
    made.base = base or fit(100.0)
    made.base.n_eff = n_eff
    made.criteria, made.workers, made.forms, made.trials = DEFAULT, None, list(forms), 0
    made.steps = module._Steps(None)
    return made


class TestPromising:
    def chosen(self, forms, scores, most=9, **more):
        scored = SimpleNamespace(scores=scores)
        found = search(forms=forms)._promising(scored, most, **more)
        assert all(c.scored is scored for c in found)
        return [c.law.effect.name for c in found]

    def test_laws_are_ordered_by_their_score_less_constants_and_length(self):
        forms = [form("a", 3.0), form("b"), form("c"), form("d")]
        scores = [score(10.0), score(7.5), score(9.0, columns=2), score(9.5, shapes=2)]
        # worth 6, 6.5, 7 and 6.5 less nothing
        assert self.chosen(forms, scores) == ["c", "b", "d", "a"]
        assert self.chosen(forms, scores, 2) == ["c", "b"]

    def test_absorbed_known_and_useless_laws_are_left_out(self):
        forms = [form("a"), form("b"), form("c"), form("d", state=LAG)]
        scores = [score(5.0, absorbed=True), score(0.0), score(3.0), score(4.0)]
        assert self.chosen(forms, scores) == ["d", "c"]
        assert self.chosen(forms, scores, stateless=True) == ["c"]
        assert self.chosen(forms, scores, about=SimpleNamespace(terms=[form("c")])) == ["d"]

    def test_joined_lists_have_each_law_once(self):
        a, b, c = (module._Chosen(form(n), None, None) for n in "abc")
        assert module._without_repetition([a, b], [b, c, a]) == [a, b, c]


class TestSecondTerm:
    def test_it_is_searched_for_beside_a_single_term(self):
        made = search()
        seen = {}
        made._scored = lambda about, removed: seen.update(about=about, removed=removed) or "scored"
        made._promising = lambda scored, most, **more: seen.update(most=most, **more) or ["chosen"]
        two = module._Refitted((form("b"),), "fit of both")
        asked = []
        made._refits = lambda *given: asked.append(given) or [two]
        of_one = fit(1.0)
        best = module._Refitted((form("a", state=LAG),), of_one)
        (found,) = made._with_second_term(best)
        assert [t.effect.name for t in found.terms] == ["a", "b"]
        assert found.fit == "fit of both"
        assert asked == [(["chosen"], of_one, ("noise",))]
        assert (seen["stateless"], seen["removed"], seen["most"]) == (True, (), 5)
        made._with_second_term(module._Refitted((form("a"),), of_one))
        assert seen["stateless"] is False
        assert made._with_second_term(module._Refitted((form("a"), form("b")), of_one)) == []


class TestBestSet:
    """A search with scripted results: the first refits, then those of the later searches."""

    def run(self, monkeypatch, first, *later, base=None, p=0.001, second=(), law_p=0.001):
        made = search(base or fit(100.0))
        self.log = []
        scored = SimpleNamespace(scores=[SimpleNamespace(effect=SimpleNamespace(name="x"), p=p)])

        def scored_about(about, removed, release=False):
            self.log.append(("scored", about.bic, tuple(e.name for e in removed), release))
            return scored

        made._scored = scored_about
        made._promising = lambda s, most, about=None: [module._Chosen(form(f"{most}"), None, None)]
        made._p = lambda s: s.p
        results = iter([first, *later])

        def refits(chosen, about, noise, replaced=()):
            self.log.append(("refits", len(chosen), about.bic, [t.effect.name for t in replaced]))
            return list(next(results, []))

        made._refits = refits
        made._with_second_term = lambda best: self.log.append(("second", best.fit.bic)) or list(second)
        made._law = lambda r: SimpleNamespace(
            name="+".join(t.effect.name for t in r.terms),
            penalised=r.penalised,
            p_value=law_p.get(r.terms[0].effect.name, 0.9) if isinstance(law_p, dict) else law_p,
        )
        monkeypatch.setattr(module, "NullDistribution", lambda s: None)
        monkeypatch.setattr(module, "FamilywiseNull", lambda nulls: None)
        monkeypatch.setattr(module, "refined", lambda f, criteria: f)
        return [x.name for x in made.best_set()]

    def refit(self, name, bic, length=0.0, **more):
        return module._Refitted((form(name, length),), fit(bic, **more))

    @pytest.mark.parametrize(
        ("p", "fails", "goes_on"), [(0.029, False, True), (0.031, False, False), (0.9, True, True)]
    )
    def test_a_search_needs_a_significant_score_or_a_lack_of_fit(self, monkeypatch, p, fails, goes_on):
        found = self.run(monkeypatch, [self.refit("a", 50.0)], base=fit(100.0, fails=fails), p=p)
        assert bool(found) is goes_on
        assert any(x[0] == "refits" for x in self.log) is goes_on

    def test_without_refits_there_is_no_law(self, monkeypatch):
        assert self.run(monkeypatch, []) == []

    def test_each_later_search_is_about_the_best_fit_without_its_law(self, monkeypatch):
        found = self.run(
            monkeypatch, [self.refit("a", 50.0)], [self.refit("b", 40.0)], [self.refit("c", 30.0)]
        )
        assert found[0] == "c"
        assert [x[1:3] for x in self.log if x[0] == "scored"] == [(100.0, ()), (50.0, ("a",)), (40.0, ("b",))]
        assert [x[3] for x in self.log if x[0] == "refits"] == [[], ["a"], ["b"]]

    @pytest.mark.parametrize(("gain", "goes_on"), [(1.9, False), (2.1, True)])
    def test_a_search_ends_where_another_law_gains_no_evidence(self, monkeypatch, gain, goes_on):
        self.run(
            monkeypatch, [self.refit("a", 50.0)], [self.refit("b", 50.0 - gain)], [self.refit("c", 60.0)]
        )
        assert sum(x[0] == "refits" for x in self.log) == 2 + goes_on

    def test_a_better_fit_of_the_same_law_ends_the_search(self, monkeypatch):
        a = self.refit("a", 50.0)
        self.run(monkeypatch, [a], [a._replace(fit=fit(30.0))], [self.refit("c", 10.0)])
        assert sum(x[0] == "refits" for x in self.log) == 2

    @pytest.mark.parametrize(("bic", "found"), [(97.9, ["a"]), (98.1, [])])
    def test_a_law_needs_a_fall_of_bic(self, monkeypatch, bic, found):
        assert self.run(monkeypatch, [self.refit("a", bic)]) == found

    def test_the_answer_has_significant_and_equivalent_laws_in_order(self, monkeypatch):
        laws = [
            self.refit("a", 50.0, 1.0),
            self.refit("b", 52.0, 8.9),
            self.refit("c", 52.0, 9.1),
            self.refit("d", 70.0),
            self.refit("e", 50.0, 0.5),
        ]
        known = {"e": 0.001, "d": 0.02}
        assert self.run(monkeypatch, laws, laws, law_p=known) == ["e", "a", "d"][:2] + (
            ["b"] if 60.9 < 60.5 else []
        ) + ["d"]
        assert self.run(monkeypatch, laws, laws, law_p={"a": 0.031}) == []
        assert self.run(monkeypatch, laws, laws, law_p={"d": 0.029})[-1] == "d"

    @pytest.mark.parametrize(
        ("fails", "bic", "named"), [(True, 47.9, ["a+b", "a"]), (True, 48.1, ["a"]), (False, 40.0, ["a"])]
    )
    def test_a_second_term_needs_a_lack_of_fit_and_evidence(self, monkeypatch, fails, bic, named):
        second = module._Refitted((form("a"), form("b")), fit(bic))
        assert self.run(monkeypatch, [self.refit("a", 50.0, fails=fails)], second=[second]) == named

    def test_at_a_bound_the_parameters_are_also_released(self, monkeypatch):
        self.run(monkeypatch, [self.refit("a", 50.0)], base=fit(100.0, at_bound=True))
        assert [x[3] for x in self.log if x[0] == "scored" and x[1] == 100.0] == [False, True]
        self.run(monkeypatch, [self.refit("a", 50.0, at_bound=True)])
        assert [x[3] for x in self.log if x[0] == "scored"] == [False, False, True]


def test_the_best_refit_of_each_law_is_kept():
    def refit(bic, length, *names):
        return module._Refitted(tuple(form(n, length) for n in names), fit(bic))

    a, b, ab = refit(5.0, 1.0, "a"), refit(4.5, 2.0, "a"), refit(9.0, 1.0, "a", "b")
    assert module._best_of_each_law([b, a, ab]) == [a, ab]
    assert module._best_of_each_law([a, b]) == [a]
    assert ab.penalised == 11.0
    assert ab.length == 2.0


class TestLibrary:
    def test_an_effect_is_named_if_a_law_is_not_clearly_better(self, monkeypatch):
        made = search(forms=[form("a"), form("b", 4.0)])
        made.base.theta = np.zeros(2)
        known = SimpleNamespace(fit=SimpleNamespace(theta=np.zeros(4)), physical=True, effect="effect")
        monkeypatch.setattr(module, "torque_rows", lambda effects, cases: np.zeros(3))
        monkeypatch.setattr(module, "score_of_columns", lambda context, rows: 30.0)

        def improves(first, second):
            made._scored = lambda about, removed: SimpleNamespace(
                scores=[score(first), score(second)], context=None, cases=None
            )
            return made.improves_on(known)

        # the effect is worth 30 less 2; a law costs one constant and its length, and needs 10 more
        assert not improves(38.9, 10.0)
        assert improves(39.1, 10.0)
        assert not improves(10.0, 42.9)
        assert improves(10.0, 43.1)
        known.physical = False
        assert not improves(99.0, 99.0)
        known.physical, known.fit = True, None
        assert not improves(99.0, 99.0)

    @pytest.mark.parametrize(
        ("score_", "bic", "change", "named"),
        [
            (81.0, 59.0, {}, True),
            (79.0, 59.0, {}, False),
            (81.0, 61.0, {}, False),
            (81.0, 0.0, {"physical": False}, False),
            (81.0, 0.0, {"significant": False}, False),
            (81.0, 0.0, {"fit": None}, False),
        ],
    )
    def test_an_equivalent_effect_has_a_similar_score_and_bic(self, monkeypatch, score_, bic, change, named):
        monkeypatch.setattr(module, "refitted_at", lambda f, noise: SimpleNamespace(bic=bic))
        Given = namedtuple("Given", "fit physical significant score")
        candidate = Given(**{"fit": "fit", "physical": True, "significant": True, "score": score_, **change})
        monkeypatch.setattr(module, "replace", lambda c, fit: c._replace(fit=fit))
        best = SimpleNamespace(score=100.0, penalised=50.0, fit=SimpleNamespace(noise=()))
        found = module._equivalent_effect([candidate], best, DEFAULT)
        assert (found is not None) is named
        assert found is None or found.fit.bic == bic

    @pytest.mark.parametrize(
        ("chosen", "failing", "refined_fails", "suffices"),
        [
            ("a", {"a": True, "b": True, "c": False}, True, False),
            ("a", {"a": False, "b": True, "c": True}, True, True),
            ("a", {"a": True, "b": False, "c": True}, True, True),
            ("a", {"a": True, "b": True, "c": True}, False, True),
            (None, {"a": False, "b": False, "c": False}, False, False),
        ],
    )
    def test_an_effect_may_suffice_if_its_class_has_no_lack_of_fit(
        self, monkeypatch, chosen, failing, refined_fails, suffices
    ):
        """The classes are (a, b) and (c)."""
        candidates = [
            SimpleNamespace(
                effect=SimpleNamespace(name=n),
                indistinguishable_from=("b",) if n == "a" else (),
                fit=fit(fails=f),
            )
            for n, f in failing.items()
        ]
        monkeypatch.setattr(
            module,
            "best_candidate",
            lambda c, criteria: next((x for x in c if x.effect.name == chosen), None),
        )
        monkeypatch.setattr(module, "refined", lambda f, criteria: fit(fails=refined_fails))
        assert module._may_suffice(candidates, DEFAULT) is suffices
        candidates[0].fit = candidates[1].fit = None
        assert module._may_suffice(candidates, DEFAULT) is False


class TestLaw:
    def test_a_score_follows_from_the_fall_of_the_deviance(self, monkeypatch):
        made = search(fit(100.0, deviance=90.0))
        made._nulls = {"one": type("Null", (), {"weights": "w", "__call__": lambda self, s: s / 100})()}
        made._family = lambda p, weights: p * 2 if weights == "w" else None
        effect = resolve("casing: -k*omega_c**3")
        one = SimpleNamespace(effect=effect, description_length=3.0, form="cubic")
        made._nulls[effect.name] = made._nulls["one"]
        estimates = {
            f"{effect.name}.k@x": Estimate(-2.0, 0.1, "N m", at_bound=False),
            f"{effect.name}.k@y": Estimate(-3.0, 0.1, "N m", at_bound=False),
            "casing.air.linear.b2": Estimate(7.0, 0.1, "N m", at_bound=False),
        }
        monkeypatch.setattr(module, "_torque_rms", lambda f, effects: 5.0 if effects == [effect] else 0.0)
        law = made._law(module._Refitted((one,), fit(60.0, deviance=40.0, estimates=estimates)))
        assert (law.score, law.delta_bic, law.p_value, law.description_length) == (50.0, -40.0, 1.0, 3.0)
        assert law.formula == f"casing: -{effect.law}"
        assert law.penalised == 63.0
        assert [e.value for e in law.estimates.values()] == [2.0, 3.0]
        assert (law.form, law.torque_rms_Nm, law.body) == ("cubic", 5.0, "casing")

    @pytest.mark.parametrize(
        ("values", "turned"),
        [([-1.0, -2.0], True), ([-1.0, 2.0], False), ([1.0, 2.0], False), ([], False), ([-1.0], True)],
    )
    def test_a_law_is_turned_where_its_strength_is_negative_in_all_recordings(self, values, turned):
        effect = resolve("casing: -k*omega_c**3")
        found = SimpleNamespace(
            estimates={f"{effect.name}.k@{i}": SimpleNamespace(value=v) for i, v in enumerate(values)}
            | {"other.k": SimpleNamespace(value=5.0)}
        )
        assert (module._with_positive_strength(effect, found).law == f"-{effect.law}") is turned

    def test_a_formula_states_the_equation_of_its_state(self):
        plain = SimpleNamespace(joint="casing", law="-k*omega_c", state=None)
        assert formula_of(plain) == "casing: -k*omega_c"
        plain.state = LAG
        assert formula_of(plain) == "casing: -k*omega_c, d(lag)/dt = (omega_c - lag)/tau"

    def test_the_largest_difference_has_its_interval_and_speeds(self, monkeypatch):
        """Two cases; in the second one the difference is larger, a triangle on the rotor from 2 to 6 s."""
        t = np.linspace(0.0, 10.0, 1001)
        monkeypatch.setattr(module, "_POINTS", 1001)
        bump = np.maximum(0.0, 4.0 - 2.0 * np.abs(t - 4.0))
        curves = {0: np.stack([np.full(1001, 0.5), np.zeros(1001)]), 1: np.stack([-bump, 0.1 * bump])}
        monkeypatch.setattr(
            module,
            "net_torques",
            lambda f, along, case, times: curves[case] if f == "other" else 0 * curves[case],
        )
        monkeypatch.setattr(
            module,
            "Sampler",
            lambda mesh, times: SimpleNamespace(value=lambda y: np.stack([100 - times, 10 + times], axis=1)),
        )
        record = SimpleNamespace(span=(0.0, 10.0))
        data = [SimpleNamespace(record=SimpleNamespace(label=x, span=record.span)) for x in ("x", "y")]
        path = SimpleNamespace(path=SimpleNamespace(mesh=None, y=None))
        one = SimpleNamespace(
            fit=SimpleNamespace(problem=SimpleNamespace(data=data), predictions=[path, path])
        )
        found = module._difference(one, SimpleNamespace(fit="other", formula="f"))
        assert (found.formula, found.label, found.torque_Nm) == ("f", "y", pytest.approx(4.0))
        assert (found.t_start, found.t_stop) == pytest.approx((3.01, 4.99))
        assert found.omega_c == pytest.approx((13.01, 14.99))
        assert found.omega_r == pytest.approx((95.01, 96.99))
        curves[1] *= 0.1
        assert module._difference(one, SimpleNamespace(fit="other", formula="f")).label == "x"
        assert module._difference(one, SimpleNamespace(fit="other", formula="f")).t_stop == 10.0

    def test_a_variable_of_the_law_is_named_if_it_explains_as_much(self):
        def depends(variable, explained, p=1e-9):
            return SimpleNamespace(
                body="casing", variable=variable, explained=explained, p_value=p, words=f"the {variable}"
            )

        effect = SimpleNamespace(joint="casing", expression=resolve("casing: -k*omega_c**3").expression)
        law = SimpleNamespace(
            effects=[effect], formula="f", form="g", torque_rms_Nm=1e-6, fit=SimpleNamespace(torque_unit="N m"),
            delta_bic=-70.0,
        )  # fmt: skip

        def said(*found, groups=((1,),)):
            return module._sentence(
                SimpleNamespace(differs=None, library=None, laws=[law], depends_on=found, torques=groups),
                DEFAULT,
            )

        assert "on the omega_c" in said(depends("t", 0.905), depends("omega_c", 0.9))
        assert "on the t" in said(depends("t", 0.92), depends("omega_c", 0.9))
        assert "depends" not in said(depends("t", 0.92, p=0.031))
        assert "depends" in said(depends("t", 0.92, p=0.029))
        assert "1 other formula has" in said(groups=((1, 2),))
        assert "2 other formulas have" in said(groups=((1, 2, 3), (4,)))
        assert "1 law with a different" in said(groups=((1, 2, 3), (4,)))
        assert "2 laws with a different" in said(groups=((1,), (4, 5), (6,)))


class TestShapes:
    @pytest.mark.parametrize(
        ("value", "ratio"),
        [(1.0, 2.0), (1.5, 2.0), (2.0, 2.0), (2.1, 5.0), (10.0, 5.0), (50.0, 5.0), (0.1, 2.0), (-3.0, 5.0)],
    )
    def test_the_ratio_is_that_of_the_enclosing_points(self, value, ratio):
        assert module._ratio((10.0, 0.0, 1.0, -2.0), value) == ratio

    def test_few_or_equal_points_have_a_small_ratio(self):
        assert module._ratio((0.0, 3.0), 3.0) == 1.5
        assert module._ratio((3.0, 3.0), 3.0) == 1.02

    def test_two_shapes_are_refined_between_the_points_of_their_grids(self, monkeypatch):
        P = namedtuple("P", "symbol role lower upper grid")
        shapes = [
            P("a", "shape", 0.0, 9.0, (1.0, 2.0, 4.0)),
            P("b", "shape", 0.0, 3.5, (1.0, 3.0)),
            P("k", "amplitude", 0, 9, ()),
        ]
        S = namedtuple("S", "score shape effect absorbed null trials")
        effect = SimpleNamespace(per_case=False)
        case = SimpleNamespace(parameters=lambda e: shapes, trials=lambda e, choices: choices)
        monkeypatch.setattr(module, "replace", lambda s, **more: s._replace(**more))
        monkeypatch.setattr(module, "stacked", lambda trials, per_case: trials[0])
        tried = []

        def best(context, e, groups, levels, null):
            tried.append(groups)
            top = min(groups, key=lambda g: abs(math.log(g["a"] / 1.7)) + abs(math.log(g["b"] / 3.3)))
            return S(50 - abs(top["a"] - 1.7) - abs(top["b"] - 3.3), [top], e, False, "later", 9)

        monkeypatch.setattr(module, "best_group", best)
        first = S(10.0, [{"a": 2.0, "b": 3.0}], effect, False, "null", 5)
        found = module._refined_shapes(SimpleNamespace(levels=()), first, [case])
        assert len(tried) == 4
        assert [len(g) for g in tried] == [25] * 4
        assert sorted({g["a"] for g in tried[0]}) == pytest.approx([1.0, 2**0.5, 2.0, 2**1.5, 4.0])
        assert max(g["b"] for g in tried[0]) == 3.5
        assert found.shape[0]["a"] == pytest.approx(1.7, rel=0.03)
        assert found.shape[0]["b"] == pytest.approx(3.3, rel=0.03)
        assert (found.null, found.trials) == ("null", 5)
        for other in (first._replace(absorbed=True), first._replace(score=0.0)):
            assert module._refined_shapes(None, other, [case]) is other
        assert (
            module._refined_shapes(SimpleNamespace(levels=()), first._replace(score=99.0), [case]).score
            == 99.0
        )
        shapes.pop(0)
        assert module._refined_shapes(None, first, [case]) is first

    def test_a_refit_starts_where_the_law_moves_the_other_parameters(self, monkeypatch):
        monkeypatch.setattr(module, "stacked", lambda trials, per_case: [(None, np.eye(2)[:, :1])])
        case = SimpleNamespace(trials=lambda e, shapes: shapes)
        context = SimpleNamespace(base_change=lambda rows: 10.0 * rows)
        layout = SimpleNamespace(bounds=lambda: (np.zeros(2), np.full(2, 25.0)), names=("p", "q"))
        about = SimpleNamespace(problem=SimpleNamespace(layout=layout), theta=np.array([1.0, 2.0]))
        effect = SimpleNamespace(per_case=False)
        scored = module._Scored([], context, [case])

        def start(*gamma):
            s = SimpleNamespace(effect=effect, shape=[{}], own_phase=False, gamma=np.array(gamma))
            return scored.start(about, s)

        assert start(2.0) == {"p": 21.0, "q": 2.0}
        assert start(9.0) == {"p": 25.0, "q": 2.0}
        assert start(-9.0) == {"p": 0.0, "q": 2.0}
        assert start(2.0, 3.0) == {"p": 1.0, "q": 2.0}


def test_the_bar_has_eight_steps_and_ends_at_the_last():
    seen = []
    steps = module._Steps(lambda done, total: seen.append((done, total)))
    for _ in range(10):
        steps.next()
    steps.done()
    assert seen == [(0, 8), *((min(i, 7), 8) for i in range(1, 11)), (8, 8)]


class TestFile:
    def law(self, text, values, *, second=None):
        effects = tuple(resolve(x) for x in ([text] if second is None else [text, second]))
        estimates = {
            f"{e.name}.{p.symbol}": Estimate(values[p.symbol], 0.1, "1", at_bound=False)
            for e in effects
            for p in e.parameters
            if p.symbol in values
        }
        record = SimpleNamespace(
            largest_speeds={"omega_c": 30.0, "omega_r": 300.0, "delta": 300.0}, span=(0.0, 9.0)
        )
        found = SimpleNamespace(problem=SimpleNamespace(layout=SimpleNamespace(records=(record,))))
        return Law("", "a form", effects, 0.0, 0.0, 0.0, 0.0, 0.0, estimates, (), (), (), found)

    def test_a_saved_law_has_its_values_and_trials_around_them(self, tmp_path):
        path = tmp_path / "lab.toml"
        save_law(self.law("casing: -k*omega_c**n", {"k": 2e-6, "n": 1.5}), "lab.one", path, "a run")
        (effect,) = read_effects(path)
        assert (effect.name, effect.joint, effect.law) == ("lab.one", "casing", "-k*omega_c**n")
        k, n = (next(p for p in effect.parameters if p.symbol == s) for s in "kn")
        assert (k.start, n.start, n.role) == (2e-6, 1.5, "shape")
        own = next(p for p in resolve("casing: -k*omega_c**n").parameters if p.symbol == "n")
        wanted = [1.5 * q for q in (0.5, 0.7, 1.0, 1.4, 2.0)]
        assert list(n.grid) == pytest.approx([x for x in wanted if own.lower <= x <= own.upper])
        assert (n.lower, n.upper) == (own.lower, own.upper)
        save_law(
            self.law("casing: -k*omega_c**3", {"k": 1.0}, second="rotor: -q*omega_r**3"), "lab.two", path, "x"
        )
        assert [e.name for e in read_effects(path)] == ["lab.one", "lab.two", "lab.two.second"]
        before = path.read_text()
        for taken in ("lab.one", "lab.two", "lab.two.second"):
            with pytest.raises(EffectError, match="already"):
                check_name(taken, path)
        check_name("lab.three", path, 2)
        save_law(self.law("casing: -k*omega_c**3", {"k": 1.0}), "lab.four.second", path, "x")
        check_name("lab.four", path, 1)
        with pytest.raises(EffectError, match="already"):
            check_name("lab.four", path, 2)
        assert path.read_text().startswith(before.rstrip())

    @pytest.mark.parametrize(
        ("name", "valid"), [("a", True), ("a" * 61, True), ("a" * 62, False), ("_a", False), ("", False)]
    )
    def test_a_name_has_up_to_61_characters(self, tmp_path, name, valid):
        if valid:
            check_name(name, tmp_path / "lab.toml")
        else:
            with pytest.raises(EffectError):
                check_name(name, tmp_path / "lab.toml")

    @pytest.mark.parametrize(("variable", "unit"), [("t", "s"), ("psi_c", "rad"), ("omega_c", "rad/s")])
    def test_a_curve_has_the_unit_of_its_variable(self, variable, unit):
        x = np.arange(3.0)
        d = SimpleNamespace(variable=variable, value=x, torque=2 * x, sigma=3 * x)
        curve = _documents._curve(d)
        assert curve["unit"] == unit
        assert (curve["value"], curve["torque_Nm"], curve["sigma_Nm"]) == ([0, 1, 2], [0, 2, 4], [0, 3, 6])
        d.value = np.zeros(0)
        assert _documents._curve(d) is None


class TestAnswer:
    """`_laws` with scripted parts: what is named, and when the search ends early."""

    def answer(
        self, monkeypatch, *, separate=None, known=None, beyond=False, found=(), library=None, rival=None
    ):
        self.calls = []

        class Search:
            trials = 7

            def __init__(self, *given):
                pass

            def improves_on_difference(self, separate, extra):
                return separate.beaten

            def improves_on(self, named):
                return named.beaten

            def best_set(self_):  # noqa: N805
                self.calls.append("search")
                return list(found)

        def patch(**more):
            for name, value in more.items():
                monkeypatch.setattr(module, name, value)

        patch(
            _Search=Search,
            different_parameter=lambda base, criteria, rival_=None, **more: rival if more else separate,
            dependence=lambda *a, **k: [],
            rank=lambda *a, **k: ["candidate"],
            _may_suffice=lambda candidates, criteria: known is not None,
            diagnose=lambda *a, **k: SimpleNamespace(candidates=("c",)),
            library_answer=lambda d, criteria: known,
            _equivalent_effect=lambda c, best, criteria: library,
            with_classes=lambda f, criteria: tuple(f),
            _sentence=lambda a, criteria: "laws",
            separating_run=lambda base, rivals, criteria: "next",
        )
        record = SimpleNamespace(body="casing")
        base = SimpleNamespace(
            model=Model.of(["casing.air.linear"]),
            name=str,
            problem=SimpleNamespace(data=[SimpleNamespace(record=record)]),
        )
        return module._laws(base, (), None, DEFAULT, None, None, beyond_library=beyond)

    def parameter(self, *, fails=False, beaten=False, bic=0.0):
        return SimpleNamespace(
            fit=fit(fails=fails),
            beaten=beaten,
            parameter=SimpleNamespace(sentence="differs"),
            penalised_bic=bic,
        )

    def law(self, penalised):
        none = {"effects": (), "estimates": {}, "indistinguishable_from": (), "same_torque_as": ()}
        return SimpleNamespace(fit="fit", penalised=penalised, formula="f", **none)

    def test_a_parameter_that_differs_and_explains_all_ends_the_search(self, monkeypatch):
        found = self.answer(monkeypatch, separate=self.parameter())
        assert (found.verdict, found.sentence, found.trials, self.calls) == ("parameter", "differs", 7, [])
        for separate, beyond in (
            (self.parameter(fails=True), False),
            (self.parameter(beaten=True), False),
            (self.parameter(), True),
        ):
            found = self.answer(monkeypatch, separate=separate, beyond=beyond)
            assert (found.verdict, self.calls) == ("parameter", ["search"])
            assert found.differs is separate.parameter

    def test_an_effect_of_the_library_that_suffices_ends_the_search(self, monkeypatch):
        named = SimpleNamespace(beaten=False, effect="an effect", indistinguishable_from=("another",))
        found = self.answer(monkeypatch, known=named)
        assert (found.verdict, found.library, self.calls) == ("library", named, [])
        assert found.sentence.startswith("An effect or another explains")
        assert self.answer(monkeypatch, known=named, beyond=True).verdict == "none"
        named.beaten = True
        assert self.answer(monkeypatch, known=named).verdict == "none"
        assert self.calls == ["search"]

    @pytest.mark.parametrize(
        ("rival", "library", "verdict"),
        [
            (None, None, "law"),
            (None, "effect", "library"),
            (-11.0, None, "parameter"),
            (-9.0, None, "law"),
            (-11.0, "effect", "library"),
        ],
    )
    def test_the_verdict_names_what_describes_the_data(self, monkeypatch, rival, library, verdict):
        other = None if rival is None else self.parameter(bic=rival)
        found = self.answer(monkeypatch, found=[self.law(0.0)], library=library, rival=other)
        assert (found.verdict, found.sentence, found.next_experiment) == (verdict, "laws", "next")
        assert (found.differs is not None) is (rival is not None)


class TestSearch:
    def test_the_grammar_covers_the_longest_recording(self, monkeypatch):
        seen = {}
        monkeypatch.setattr(module, "ranges_of", lambda base: "ranges")
        monkeypatch.setattr(module, "grammar", lambda *given, **more: seen.update(given=given, **more) or [])
        records = [SimpleNamespace(span=s, parts={"casing"}) for s in ((0.0, 5.0), (2.0, 9.0), (1.0, 3.0))]
        data = [SimpleNamespace(record=r, is_angle=i == 0) for i, r in enumerate(records)]
        made = module._Search(
            SimpleNamespace(problem=SimpleNamespace(data=data)), DEFAULT, None, module._Steps(None)
        )
        assert seen == {"given": ("ranges", 7.0), "bodies": {"casing"}, "angles": True}
        assert made.trials == 0

    def test_effects_of_the_library_have_no_length(self, monkeypatch):
        made = search(forms=[form("a", 3.0), form("b", 4.0)])
        seen = {}
        monkeypatch.setattr(module, "applicable_effects", lambda base, extra: ["x", *extra])
        monkeypatch.setattr(
            module,
            "improves_on_difference",
            lambda separate, effects, lengths, criteria: (
                seen.update(effects=effects, lengths=lengths) or True
            ),
        )
        assert made.improves_on_difference("separate", ["y"])
        assert seen["lengths"] == [3.0, 4.0, 0.0, 0.0]
        assert seen["effects"][2:] == ["x", "y"]

    @pytest.mark.parametrize("same", [True, False])
    def test_options_are_passed_on_and_a_diagnosis_of_another_noise_is_not(self, monkeypatch, same):
        seen = {}

        def found(base, extra, diagnosis, criteria, pool, progress, *, beyond_library):
            seen.update(base=base, extra=extra, diagnosis=diagnosis, criteria=criteria, beyond=beyond_library)
            return Laws(base, "none", "", (), None, (), "", 0)

        monkeypatch.setattr(module, "_laws", found)
        base = SimpleNamespace(model=SimpleNamespace(refuse_chain=lambda *a: None), criteria="own")
        other = base if same else SimpleNamespace()
        monkeypatch.setattr(module, "measured_with", lambda f, criteria: other)
        laws(base, ["e"], diagnosis="known", beyond_library=True)
        assert seen == {
            "base": other, "extra": ["e"], "diagnosis": "known" if same else None, "criteria": "own", "beyond": True,
        }  # fmt: skip
        laws(base, criteria="given")
        assert (seen["criteria"], seen["beyond"]) == ("given", False)

    def test_a_law_replaces_terms_of_the_model(self, monkeypatch):
        made = search()
        seen = {}
        monkeypatch.setattr(
            module,
            "recorded_map",
            lambda workers, work, common, trials, shared: seen.update(trials=trials) or [None, "fit"],
        )
        model = Model.of(["casing.air.linear", "casing.air.quadratic"])
        about = SimpleNamespace(model=model)
        scored = SimpleNamespace(start=lambda about, s: {"k": s})
        chosen = [module._Chosen(form("a"), 1.0, scored), module._Chosen(form("b"), 2.0, scored)]
        (found,) = made._refits(chosen, about, ("noise",), [form("casing.air.quadratic")])
        assert (found.terms[0].effect.name, found.fit) == ("b", "fit")
        assert [t.start for t in seen["trials"]] == [{"k": 1.0}, {"k": 2.0}]
        assert all(t.model.names == ("casing.air.linear",) for t in seen["trials"])

    @pytest.mark.parametrize(("deviance", "kept"), [(1.0, True), (math.inf, False), (math.nan, False)])
    def test_a_refit_without_a_likelihood_is_none(self, monkeypatch, deviance, kept):
        seen = {}

        def fitted(model, base, **more):
            seen.update(more, model=model)
            return SimpleNamespace(deviance=deviance, bic=0.0, converged=True)

        monkeypatch.setattr(module, "fit", fitted)
        monkeypatch.setattr(module, "initial_values_of", lambda base, s: {"k": 2.0})
        trial = SimpleNamespace(
            law=SimpleNamespace(effect="law"), score=None, start={"k": 1.0, "a": 5.0},
            model=SimpleNamespace(with_effect=lambda e: f"model and {e}"),
        )  # fmt: skip
        found = module._refit(SimpleNamespace(base="base", noise="noise"), trial)
        assert (found is not None) is kept
        assert seen == {
            "start": {"k": 2.0, "a": 5.0},
            "noise": "noise",
            "quick": True,
            "model": "model and law",
        }


def test_a_repr_shows_six_laws():
    law = SimpleNamespace(formula="f")
    shown = [repr(Laws(None, "law", "found", (law,) * n, None, (), "", 0)) for n in (6, 8)]
    assert "more" not in shown[0]
    assert "... 2 more" in shown[1]
