"""The analysis of one simulated recording, with stand-ins for the fit and the diagnosis."""

import math
from types import SimpleNamespace

import pytest

from fitting import EstimationError
from fitting.discovery import _certificate as module
from fitting.discovery._certificate import Outcome

ITEM = ("truth", "e", 3)


def candidate(name="e", indistinguishable=(), score=12.5, fit=None):
    return SimpleNamespace(
        effect=SimpleNamespace(name=name), indistinguishable_from=indistinguishable, score=score, fit=fit,
        estimates={"e.k": SimpleNamespace(value=7.0)},
    )  # fmt: skip


def fitted(*names, converged=True):
    return SimpleNamespace(model=SimpleNamespace(names=names), converged=converged)


class TestAnalysis:
    @pytest.fixture
    def analysed(self, monkeypatch):
        """Return the outcome of a diagnosis, for a simulated model of the effects a and e."""
        calls = {}

        def fit_model(model, data, **options):
            calls["fit"] = (model, data, options)
            if calls.get("fails"):
                raise EstimationError("no fit")
            return calls["again"]

        def diagnose(again, extra, *, criteria, brief):
            calls["diagnosis"] = (again, extra, criteria, brief)
            return calls["found"]

        monkeypatch.setattr(module, "fit_model", fit_model)
        monkeypatch.setattr(module, "diagnose", diagnose)
        monkeypatch.setattr(module.CaseData, "of", lambda record, criteria: (record, criteria))
        monkeypatch.setattr(module, "_inside", lambda final, truth: {final: truth})

        def run(verdict, *candidates, again=("a",), simulated=("e", "a"), fails=False):
            layout = SimpleNamespace(choices=(("a.k", "gone"), ("gone", "a.c")), ranges={"a.k": (0.0, 1.0)})
            calls["again"] = Known(again)
            calls["found"] = SimpleNamespace(verdict=verdict, candidates=candidates)
            calls["fails"] = fails
            base = SimpleNamespace(
                model=SimpleNamespace(free=("a.k", "a.c")), problem=SimpleNamespace(layout=layout)
            )
            hypothesis = SimpleNamespace(fit=Known(simulated))
            work = module._Work({ITEM[:2]: hypothesis}, base, ("own",), "criteria", 1)
            return module._analysed(work, ITEM, ["r1", "r2"]), calls, base

        return run

    def test_it_is_that_of_the_answer(self, analysed):
        _, calls, base = analysed("adequate")
        model, data, options = calls["fit"]
        assert model is base.model
        assert data == [("r1", "criteria"), ("r2", "criteria")]
        assert options == {"share": ["a.k"], "per_case": ["a.c"], "ranges": {"a.k": (0.0, 1.0)}}
        assert calls["diagnosis"] == (calls["again"], ("own",), "criteria", True)

    def test_an_effect_is_named_by_the_verdict_of_a_missing_effect_only(self, analysed):
        best = candidate("e", ("f", "g"), fit=Known(("a", "e")))
        found, *_ = analysed("missing_effect", best, candidate("h"))
        assert found == Outcome("truth", "e", 3, "missing_effect", ("e", "f", "g"), 12.5, found.inside)
        # the model of the best candidate is the simulated one, in another order
        assert [(f.names, t.names) for f, t in found.inside.items()] == [(("a", "e"), ("e", "a"))]
        found, *_ = analysed("undecided", best)
        assert (found.verdict, found.named, found.score, found.inside) == ("undecided", (), 12.5, {})

    def test_intervals_are_those_of_the_simulated_model(self, analysed):
        found, calls, _ = analysed("adequate", candidate(fit=Known(("a", "e"))), simulated=("a",))
        assert list(found.inside) == [calls["again"]]
        found, *_ = analysed("missing_effect", candidate(fit=Known(("a", "e"))), simulated=("a",))
        assert found.inside == {}
        found, *_ = analysed("missing_effect", candidate(fit=None))
        assert found.inside == {}

    def test_without_a_candidate_the_score_is_zero(self, analysed):
        found, *_ = analysed("adequate", simulated=("a",))
        assert (found.named, found.score, found.verdict) == ((), 0.0, "adequate")
        assert len(found.inside) == 1

    def test_an_error_is_a_failure(self, analysed):
        found, *_ = analysed("adequate", fails=True)
        assert (found.verdict, found.named, found.inside) == ("failed", (), {})
        assert math.isnan(found.score)
        assert (found.kind, found.effect, found.number) == ITEM


class Known:
    """A fit of a model with these effects."""

    def __init__(self, names):
        self.names, self.model = names, SimpleNamespace(names=names)


def test_records_of_a_film_are_analysed_unless_their_measurement_failed(monkeypatch):
    works = []
    monkeypatch.setattr(module, "hypotheses", lambda found: [])
    monkeypatch.setattr(
        module, "_analysed", lambda work, item, records: works.append(work) or (item, records)
    )
    found = SimpleNamespace(fit=SimpleNamespace(criteria="of the fit"))
    assert module.outcome_of_records(found, ITEM, ["r"], extra=["own"]) == (ITEM, ["r"])
    assert module.outcome_of_records(found, ITEM, ["r"], criteria="others") == (ITEM, ["r"])
    assert [(w.extra, w.criteria, w.base) for w in works] == [
        (("own",), "of the fit", found.fit),
        ((), "others", found.fit),
    ]
    failed = module.outcome_of_records(found, ITEM, [])
    assert (failed.kind, failed.effect, failed.number, failed.verdict) == (*ITEM, "failed")
    assert (failed.named, failed.inside) == ((), {})
    assert math.isnan(failed.score)


class TestWithEffect:
    @pytest.fixture
    def calls(self, monkeypatch):
        made = []

        def fit_model(model, base, *, start):
            made.append((model, start))
            if model == "fails":
                raise EstimationError("no fit")
            return fitted("a", "e", converged=model != "ends early")

        monkeypatch.setattr(module, "fit_model", fit_model)
        return made

    def base(self, monkeypatch, kind="works"):
        model = type("Model", (str,), {"names": ("a", "e")})(kind)
        monkeypatch.setattr(module, "with_candidate", lambda base, effect: model)
        return SimpleNamespace(estimates={"a.k": SimpleNamespace(value=2.0), "e.k": SimpleNamespace(value=5.0)})

    @pytest.mark.parametrize("converged", [True, False])
    def test_the_fit_of_the_candidate_is_used(self, calls, monkeypatch, converged):
        known = fitted("e", "a", converged=converged)
        found = module._with_effect(self.base(monkeypatch), candidate(fit=known))
        assert found is (known if converged else None)
        assert calls == []

    @pytest.mark.parametrize("known", [None, fitted("a", "other")])
    def test_another_model_is_fitted_from_the_values_of_the_candidate(self, calls, monkeypatch, known):
        found = module._with_effect(self.base(monkeypatch), candidate(fit=known))
        assert found.model.names == ("a", "e")
        assert calls == [("works", {"a.k": 2.0, "e.k": 7.0})]

    @pytest.mark.parametrize("kind", ["fails", "ends early"])
    def test_a_fit_that_ends_without_a_minimum_is_none(self, calls, monkeypatch, kind):
        assert module._with_effect(self.base(monkeypatch, kind), candidate()) is None


def test_a_pair_of_hypotheses_has_its_row_of_counted_answers():
    def outcome(kind, effect, verdict, named=()):
        return Outcome(kind, effect, 0, verdict, named, 1.0, {})

    name = "casing.air.linear"
    outcomes = (
        outcome("null", "", "adequate"), outcome("null", "", "undecided"), outcome("null", "", "adequate"),
        outcome("truth", name, "missing_effect", (name,)),
    )  # fmt: skip
    found = module.Certificate(3, "missing_effect", (name,), 1.0, outcomes)
    words = found.in_words(name)
    assert found.rows == [("none", "3", "no effect 2; undecided 1"), (words, "1", f"{words} 1")]
