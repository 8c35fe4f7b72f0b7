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
        return SimpleNamespace(
            estimates={"a.k": SimpleNamespace(value=2.0), "e.k": SimpleNamespace(value=5.0)}
        )

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


class TestHypotheses:
    """The effect e is named; f and g are in its class, h to k follow, of which i is not significant."""

    def hypotheses(
        self, monkeypatch, verdict="missing_effect", *, fails=(), names="ehgfijk", others=("f", "g")
    ):
        def with_effect(base, c):
            assert base == "base"
            return (
                None
                if c.effect.name in fails
                else SimpleNamespace(name=c.effect.name, noise=f"noise {c.effect.name}")
            )

        monkeypatch.setattr(module, "_with_effect", with_effect)
        monkeypatch.setattr(module, "replace", lambda fit, noise: (getattr(fit, "name", fit), noise))
        candidates = [
            SimpleNamespace(
                effect=SimpleNamespace(name=n),
                significant=n != "i",
                indistinguishable_from=others if n == "e" else (),
            )
            for n in names
        ]
        found = SimpleNamespace(fit="base", verdict=verdict, candidates=candidates)
        return [(h.kind, h.effect, getattr(h.fit, "name", h.fit)) for h in module.hypotheses(found)]

    def test_rivals_of_the_class_come_first(self, monkeypatch):
        found = self.hypotheses(monkeypatch)
        assert found == [
            ("null", "", ("base", "noise e")),
            ("truth", "e", "e"),
            ("rival", "g", ("g", "noise e")),
            ("rival", "f", ("f", "noise e")),
            ("rival", "h", ("h", "noise e")),
        ]

    def test_a_rival_without_a_fit_leaves_its_place(self, monkeypatch):
        assert [e for _, e, _ in self.hypotheses(monkeypatch, fails="g")] == ["", "e", "f", "h", "j"]
        assert [e for _, e, _ in self.hypotheses(monkeypatch, fails="ghj")] == ["", "e", "f", "k"]
        assert [e for _, e, _ in self.hypotheses(monkeypatch, others=())] == ["", "e", "h", "g", "f"]

    def test_without_a_named_effect_or_its_fit_there_is_the_null_hypothesis(self, monkeypatch):
        null = [("null", "", "base")]
        assert self.hypotheses(monkeypatch, "undecided") == null
        assert self.hypotheses(monkeypatch, names="") == null
        assert self.hypotheses(monkeypatch, fails="e") == null


@pytest.mark.parametrize(
    ("n", "rival"), [(200, 50), (201, 51), (16, 4), (17, 5), (10, 4), (4, 4), (3, 3), (1, 1)]
)
def test_a_rival_has_a_quarter_of_the_recordings_and_four_at_the_least(n, rival):
    kinds = [module.Hypothesis(kind, kind, None) for kind in ("null", "truth", "rival")]
    items = module._planned(kinds, n)
    assert [sum(i[0] == kind for i in items) for kind in ("null", "truth", "rival")] == [n, n, rival]
    assert [i[2] for i in items] == sorted(i[2] for i in items)
    assert items[:3] == [(k, k, 0) for k in ("null", "truth", "rival")]


@pytest.mark.parametrize(
    ("processes", "rounds"), [(0, [1, 5, 9, 10]), (1, [2, 10]), (2, [3, 10]), (20, [10])]
)
def test_recordings_are_simulated_in_rounds_of_which_the_first_is_short(monkeypatch, processes, rounds):
    """Of twelve recordings, two are known."""
    monkeypatch.setattr(module, "hypotheses", lambda found: [module.Hypothesis("null", "", None)])
    monkeypatch.setattr(module.Certificate, "of_answer", lambda found, outcomes, n, seed: (outcomes, n, seed))

    class Workers:
        def __init__(self):
            self.processes, self.calls = processes, []

        def map(self, function, work, items):
            assert function is module._outcome
            assert (work.seed, work.criteria, work.extra) == (5, "of the fit", ("own",))
            self.calls.append(items)
            return [Outcome(*item, "adequate", (), 1.0, {}) for item in items]

    known = [Outcome("null", "", k, "known", (), 1.0, {}) for k in (3, 7, 99)]
    workers, kept = Workers(), []
    found = SimpleNamespace(fit=SimpleNamespace(criteria="of the fit"))
    outcomes, n, seed = module.certify(
        found, 12, seed=5, extra=["own"], known=known, workers=workers,
        keep=lambda done, total: kept.append((len(done), total)),
    )  # fmt: skip
    assert (n, seed) == (12, 5)
    assert [o.number for o in outcomes] == list(range(12))
    assert [o.number for o in outcomes if o.verdict == "known"] == [3, 7]
    assert kept == [(2 + k, 12) for k in rounds]
    assert [i[2] for part in workers.calls for i in part] == [k for k in range(12) if k not in (3, 7)]


@pytest.mark.parametrize(
    ("value", "stderr", "total", "inside"),
    [
        (1.195, 0.1, 0.0, True), (1.197, 0.1, 0.0, False), (0.805, 0.1, 0.0, True), (0.803, 0.1, 0.0, False),
        (1.39, 0.1, 0.2, True), (1.40, 0.1, 0.2, False), (1.1, 0.1, 0.01, True),
    ],
)  # fmt: skip
def test_an_interval_contains_the_simulated_value(monkeypatch, value, stderr, total, inside):
    monkeypatch.setattr(module, "combined_uncertainties", lambda found: {"k": total} if total else {})

    def fit(value, stderr, converged=True):
        known = {
            "k": SimpleNamespace(value=value, stderr=stderr),
            "held": SimpleNamespace(value=1.0, stderr=0.0),
        }
        known["bound"] = SimpleNamespace(value=1.0, stderr=math.nan)
        return SimpleNamespace(estimates=known, converged=converged)

    truth = fit(1.0, 0.3)
    truth.estimates["only there"] = None
    assert module._inside(fit(value, stderr), truth) == {"k": inside}
    assert module._inside(fit(value, stderr, converged=False), truth) == {}


@pytest.mark.parametrize(("criteria", "used"), [("strict", "strict"), (None, "of the fit")])
def test_a_part_of_a_test_has_the_seed_effects_and_criteria_of_the_whole(monkeypatch, criteria, used):
    asked = []
    work = SimpleNamespace(hypotheses={("null", ""): "h"})
    monkeypatch.setattr(module._Work, "of", lambda *given: asked.append(given) or work)
    monkeypatch.setattr(module, "_outcome", lambda given, item: (given is work, item))
    answer = SimpleNamespace(fit=SimpleNamespace(criteria="of the fit"))
    found = module.outcomes_of(answer, [("null", "", 4)], seed=7, extra=("own",), criteria=criteria)
    assert found == [(True, ("null", "", 4))]
    assert asked == [(answer, ("own",), used, 7)]
