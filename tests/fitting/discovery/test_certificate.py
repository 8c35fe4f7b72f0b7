"""An answer tested on simulated recordings: its rates and their limits, what is simulated, and what is stored."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cases import searched
from scipy.stats import binomtest

from fitting import Certificate, EstimationError, Ledger, certify
from fitting.discovery import _certificate as certificate
from fitting.discovery._certificate import Outcome, hypotheses, outcomes_of, planned
from fitting.study._serialisation import certificate_document

NAME = "casing.air.quadratic"
INERTIA, SIGMA = 2e-3, 1e-3
TIME = np.linspace(0.0, 30.0, 1200)


@pytest.fixture(scope="module")
def answer():
    return searched()[2]


@pytest.fixture(scope="module")
def adequate():
    return searched(0.0)[2]


def outcome(kind="null", number=0, verdict="adequate", named=(), score=1.0, effect="", inside=None):
    return Outcome(kind, effect, number, verdict, named, score, inside or {})


def made(*outcomes, named=(NAME,), score=50.0, verdict="missing_effect"):
    return Certificate(len(outcomes), verdict, named, score, outcomes)


class TestRates:
    @pytest.mark.parametrize(("count", "n"), [(0, 20), (3, 20), (20, 20), (1, 200)])
    def test_the_interval_is_that_of_clopper_and_pearson(self, count, n):
        exact = binomtest(count, n).proportion_ci(0.95, "exact")
        assert certificate.rate_interval(count, n) == pytest.approx((exact.low, exact.high), abs=1e-9)

    def test_named_unexplained_and_failed_are_alarms_undecided_is_none(self):
        verdicts = ("adequate", "undecided", "unexplained", "missing_effect", "failed")
        found = made(*(outcome(number=i, verdict=v) for i, v in enumerate(verdicts)))
        assert found.alarms == 3
        assert found.interval == certificate.rate_interval(3, 5)

    def test_outcomes_with_the_effect_are_not_false_alarms(self):
        found = made(outcome(), outcome("truth", verdict="missing_effect", named=(NAME,), effect=NAME))
        assert (found.alarms, found.names) == (0, {})

    @pytest.mark.parametrize(
        ("scores", "p"), [((49.9, 1, 2), 1 / 4), ((50.0, 1, 2), 2 / 4), ((60, 70, 80), 1.0)]
    )
    def test_the_empirical_p_value_counts_scores_as_high_as_that_of_the_answer(self, scores, p):
        found = made(*(outcome(number=i, score=s) for i, s in enumerate(scores)))
        assert found.p_empirical == p

    def test_a_failed_analysis_has_no_score(self):
        assert made(outcome(score=math.nan, verdict="failed")).p_empirical == 1 / 2

    def test_first_and_in_the_class(self):
        named = [(NAME,), ("casing.windage", NAME), ("casing.windage",), ()]
        found = made(*(outcome("truth", i, named=n, effect=NAME) for i, n in enumerate(named)))
        assert (found.right_first, found.in_class) == (1 / 4, 2 / 4)
        assert made(outcome()).right_first is None
        assert made(outcome()).in_class is None

    def test_coverage_is_the_share_of_intervals_that_contain_the_value(self):
        inside = [{"k": True, "b": True}, {"k": False}, {"k": True}, {"k": True}]
        found = made(*(outcome("truth", i, effect=NAME, inside=x) for i, x in enumerate(inside)))
        assert found.coverage("truth") == {"k": 3 / 4, "b": 1.0}
        assert found.coverage("null") == {}

    def test_rivals_are_counted_by_what_they_are_named(self):
        other = "casing.windage"
        found = made(
            outcome("rival", 0, named=(other,), effect=other),
            outcome("rival", 1, named=(NAME, other), effect=other),
            outcome("rival", 2, verdict="adequate", effect=other),
        )
        assert found.rivals == {other: {other: 1, NAME: 1, "adequate": 1}}

    def test_the_document_has_the_keys_of_the_contract(self):
        found = made(outcome(), outcome("truth", effect=NAME, named=(NAME,), inside={"k": True}))
        document = json.loads(json.dumps(certificate_document(found, "f1")))
        assert {"n", "null", "p_empirical", "truth", "rivals", "film"} <= document.keys()
        assert {"alarms", "rate", "interval", "names"} <= document["null"].keys()
        assert document["truth"]["coverage"] == {"k": 1.0}
        assert document["film"] is False
        assert certificate_document(made(outcome()), "f1")["truth"] is None

    def test_the_sentence_tells_rate_p_value_and_shares(self):
        text = made(outcome(), outcome("truth", effect=NAME, named=(NAME,))).sentence
        drag = "quadratic air drag of the casing (casing.air.quadratic)"
        assert f"Of 1 simulated recordings without the {drag}, 0 end in a false alarm" in text
        assert "p-value of this answer is 0.5" in text
        assert "100 % lead to an answer that names it first" in text
        assert "named" not in made(outcome(), named=(), verdict="adequate").sentence


class TestHypotheses:
    def test_a_named_effect_is_simulated_without_with_and_as_its_rivals(self, answer):
        assert (answer.verdict, answer.candidates[0].effect.name) == ("missing_effect", NAME)
        null, truth, *rivals = hypotheses(answer)
        assert (null.kind, null.fit.model.names) == ("null", answer.fit.model.names)
        assert (truth.kind, truth.effect) == ("truth", NAME)
        assert truth.fit.model.names == (*answer.fit.model.names, NAME)
        assert 1 <= len(rivals) <= 3
        assert {w.kind for w in rivals} == {"rival"}
        assert NAME not in {w.effect for w in rivals}

    def test_all_hypotheses_have_the_random_torque_of_the_answer(self, answer):
        null, truth, *rivals = hypotheses(answer)
        assert {w.fit.noise[0].level for w in (null, *rivals)} == {truth.fit.noise[0].level}
        assert answer.fit.noise[0].level > truth.fit.noise[0].level

    @pytest.mark.parametrize("verdict", ["adequate", "unexplained", "undecided"])
    def test_without_a_named_effect_only_the_model_is_simulated(self, answer, verdict):
        assert [w.kind for w in hypotheses(replace(answer, verdict=verdict))] == ["null"]

    def test_a_quarter_for_each_rival_and_at_least_four(self, answer):
        for n, each in ((40, 10), (12, 4), (2, 2)):
            counts = {}
            for kind, effect, _ in planned(answer, n):
                counts[kind, effect] = counts.get((kind, effect), 0) + 1
            assert counts["null", ""] == counts["truth", NAME] == n
            assert {c for (kind, _), c in counts.items() if kind == "rival"} == {each}

    @pytest.mark.parametrize("verdict", ["missing_effect", "undecided", "adequate"])
    def test_only_an_answer_with_a_missing_effect_names_it(self, answer, verdict):
        best = answer.candidates[0]
        tested = Certificate.of_answer(replace(answer, verdict=verdict), (), 1)
        assert tested.named == ((NAME, *best.indistinguishable_from) if verdict == "missing_effect" else ())
        assert tested.score == best.score

    def test_an_interrupted_run_has_some_of_every_hypothesis(self, answer):
        first = planned(answer, 10)[: len(hypotheses(answer))]
        assert len({item[:2] for item in first}) == len(first)

    def test_recordings_that_are_not_planned_are_refused(self, adequate):
        with pytest.raises(EstimationError, match="has changed"):
            outcomes_of(adequate, [("truth", NAME, 0)])


class TestRuns:
    @pytest.mark.slow
    @pytest.mark.release
    def test_the_truth_is_found_and_the_null_is_not(self, answer):
        truth, null = outcomes_of(answer, [("truth", NAME, 0), ("null", "", 0)])
        assert truth.named[0] == NAME
        assert truth.inside.keys() >= {f"{NAME}.k", "touchpoint.constant.b1"}
        assert (null.verdict, null.named) == ("adequate", ())
        assert null.inside.keys() >= {"touchpoint.constant.b1"}
        assert f"{NAME}.k" not in null.inside
        assert null.score < 0.1 * answer.candidates[0].score

    def test_known_outcomes_are_not_repeated(self, adequate, monkeypatch):
        simulated = []

        def pretended(_, item):
            simulated.append(item)
            return Outcome(*item, "adequate", (), 0.0, {})

        monkeypatch.setattr(certificate, "_outcome", pretended)
        known = [outcome(number=k, verdict="unexplained") for k in (0, 2)]
        told = []
        found = certify(adequate, 4, known=known, keep=lambda o, total: told.append((len(o), total)))
        assert simulated == [("null", "", 1), ("null", "", 3)]
        assert [o.verdict for o in found.outcomes] == ["unexplained", "adequate", "unexplained", "adequate"]
        assert told == [(3, 4), (4, 4)]
        assert certify(adequate, 2, known=found.outcomes).n == 2
        assert len(certify(adequate, 2, known=found.outcomes).outcomes) == 2

    def test_each_recording_of_each_effect_has_its_own_seed(self, monkeypatch):
        items = [
            ("null", "", 0),
            ("null", "", 1),
            ("rival", "bearing.load", 0),
            ("rival", "casing.windage", 0),
        ]
        hypotheses_ = {item[:2]: SimpleNamespace(fit=item[:2]) for item in items}
        drawn = []
        monkeypatch.setattr(certificate, "replica", lambda *given: drawn.append(given) or "records")
        monkeypatch.setattr(certificate, "_analysed", lambda _, *given: given)
        for seed in (7, 8):
            work = SimpleNamespace(seed=seed, hypotheses=hypotheses_)
            assert [certificate._outcome(work, item) for item in items] == [(i, "records") for i in items]
        assert [fit for fit, _ in drawn] == [item[:2] for item in items] * 2
        assert len({seed for _, seed in drawn}) == 8

    def test_an_analysis_that_fails_is_counted(self, adequate, monkeypatch):
        def fails(*_, **__):
            raise EstimationError("nothing")

        monkeypatch.setattr(certificate, "fit_model", fails)
        (found,) = outcomes_of(adequate, [("null", "", 0)])
        assert (found.verdict, found.named) == ("failed", ())

    @pytest.mark.parametrize(("away", "inside"), [(1.9, True), (2.0, False)])
    def test_an_interval_of_95_percent(self, away, inside, monkeypatch):
        monkeypatch.setattr(certificate, "combined_uncertainties", lambda _: {"k": 1.0})
        found = SimpleNamespace(converged=True, estimates={"k": SimpleNamespace(value=away, stderr=0.5)})
        truth = SimpleNamespace(estimates={"k": SimpleNamespace(value=0.0)})
        assert certificate._inside(found, truth) == {"k": inside}
        found.converged = False
        assert certificate._inside(found, truth) == {}


class TestStored:
    def test_a_ledger_keeps_the_test_of_the_same_answer_and_seed(self, adequate, tmp_path):
        ledger = Ledger(tmp_path / "case.fits.json")
        entry = ledger.add(adequate.fit)
        done = Certificate.of_answer(adequate, [outcome(score=3.0, inside={"b": True})], 1, seed=7)
        ledger.keep_certificate(entry.fit_id, done)
        again = Ledger(ledger.path).find(entry.fit_id)
        assert again.certificate(adequate, 7) == done
        assert again.certificate(adequate) == done
        assert again.certificate(adequate, 8) is None
        assert again.certificate(replace(adequate, verdict="unexplained")) is None

    def test_one_from_films_and_one_from_data_do_not_replace_each_other(self, adequate, tmp_path):
        ledger = Ledger(tmp_path / "case.fits.json")
        entry = ledger.add(adequate.fit)
        of_data = Certificate.of_answer(adequate, [outcome(score=3.0)], 1)
        of_films = Certificate.of_answer(adequate, [outcome(score=5.0)], 1, film=True)
        ledger.keep_certificate(entry.fit_id, of_films)
        ledger.keep_certificate(entry.fit_id, of_data)
        stored = Ledger(ledger.path).find(entry.fit_id)
        assert stored.certificate(adequate, film=False) == of_data
        assert stored.certificate(adequate, film=True) == of_films
        assert stored.certificate(adequate) == of_films
        stored.document["certificate_of_films"] = {"damaged": True}
        assert stored.certificate(adequate) == of_data
        assert stored.certificate(adequate, film=True) is None

    @pytest.mark.parametrize("change", [{"code": "older"}, {"outcomes": "x"}, {"n": "many"}])
    def test_one_of_other_code_or_damaged_is_none(self, adequate, tmp_path, change):
        ledger = Ledger(tmp_path / "case.fits.json")
        entry = ledger.add(adequate.fit)
        ledger.keep_certificate(entry.fit_id, Certificate.of_answer(adequate, [outcome()], 1))
        stored = ledger.find(entry.fit_id)
        stored.document["certificate"] |= change
        assert stored.certificate(adequate) is None


def test_the_answers_are_drawn_on_given_axes():
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("agg")
    from matplotlib.figure import Figure

    found = made(
        outcome(),
        outcome(),
        outcome("truth", effect=NAME, named=(NAME,)),
        outcome("rival", effect="bearing.drift"),
    )
    figure = Figure()
    ax = figure.subplots()
    assert found.plot(ax) is figure
    assert [t.get_text() for t in ax.get_yticklabels()] == [
        "no effect (2)", "quadratic air drag of the casing (1)", "drift of the bearing friction (1)",
    ]  # fmt: skip
    # each bar has 100 %
    assert sum(p.get_width() for p in ax.patches) == pytest.approx(300)
    assert found.plot() is not figure
