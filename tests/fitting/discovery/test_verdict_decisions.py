"""From a selection to a verdict: tables of small cases with the answer, its words, and what is asked on the way."""

import math
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import oscillators
import pytest

from fitting import LIBRARY, Candidate, Criteria, Estimate, diagnose, effect_name
from fitting._criteria import DEFAULT
from fitting._workers import WorkerPool
from fitting.discovery import _verdict as module
from fitting.discovery._lack_of_fit import (
    UNKNOWN_IN_TIME,
    UNKNOWN_LAWS,
    HarmonicTest,
)
from fitting.discovery._power import HiddenEffects
from fitting.discovery._remainder import Grade, Nuisance, Remainder
from fitting.discovery._select import Selection
from fitting.discovery._verdict import slipped
from fitting.effects._library import SLIP, START
from fitting.inference._periodogram import PeriodogramPeak
from fitting.inference._smooth_test import SmoothTest

DRAG, LAMINAR, UNBALANCE = "casing.air.quadratic", "casing.air.laminar", "casing.unbalance"
NAMED = f"quadratic air drag of the casing ({DRAG})"
BOTH = f"{NAMED}; laminar disc drag of the casing ({LAMINAR})"
LEFT = Remainder(1e-6, 0.03, 1e-5, "Remainder 1 uN m rms.")


def estimate(value=4e-8, stderr=1e-9, unit="N m s2", *, at_bound=False):
    return Estimate(value, stderr, unit, at_bound=at_bound)


def data(*, oscillation=None, lines=(), slips=(), label="run"):
    samples = SimpleNamespace(sigma=np.full(3, 1e-3))
    return SimpleNamespace(
        motion=oscillators.stub(oscillation), spectral_lines=lines, slips=slips, has_noise_of=lambda _: True,
        casing=SimpleNamespace(scale=2.0, samples=samples), rotor=(),
        record=SimpleNamespace(label=label, inputs=()),
    )  # fmt: skip


def problem(*cases):
    return SimpleNamespace(data=list(cases), layout=SimpleNamespace(index={}))


def named(*effects):
    return SimpleNamespace(names=tuple(effects))


@dataclass(frozen=True, eq=False)
class Found:
    """A fit, as far as an answer depends on it."""

    @staticmethod
    def name(effect):
        return effect_name(getattr(effect, "name", effect))

    model: Any = field(default_factory=named)
    wrong: bool = False
    noisy: bool = False
    needs_random: bool = False
    smooth: bool = False
    bic: float = 100.0
    lack_of_fit: bool = True
    findings: tuple = ()
    noise: tuple = (SimpleNamespace(level=2e-6, pure=1e-6),)
    torque_unit: str = "N m"
    converged: bool = True
    undetermined: tuple = ()
    criteria: Criteria = DEFAULT
    estimates: dict = field(default_factory=dict)
    lacks_restoring_torque: bool = False
    rows: int = 500
    problem: Any = field(default_factory=lambda: problem(data()))

    def fails(self, criteria):
        return self.wrong

    def undetermined_at(self, criteria):
        return self.undetermined

    def has_excess_noise(self, criteria):
        return self.noisy

    def needs_random_torque(self, criteria):
        return self.needs_random

    def has_smooth_torque(self, criteria):
        return self.smooth

    def has_lack_of_fit(self, criteria):
        return self.lack_of_fit


def candidate(name=DRAG, *, alike=(), significant=True, fit=Found(), estimates=None, effect=None, score=50.0):
    effect = LIBRARY[name] if effect is None else effect
    return Candidate(
        effect, score, -40.0, 1e-6, 0.0, tuple(alike), estimates or {}, significant, SimpleNamespace(), fit
    )


def selection(chosen=None, *, named=None, final=None, others=()):
    return Selection(
        ([chosen] if chosen else []) + list(others), chosen, named or Found(), final or named or Found()
    )


class Answer:
    """`diagnose` with the results of its steps given."""

    @pytest.fixture(autouse=True)
    def steps(self, monkeypatch):
        self.given = {
            "rank": [], "separate_values": None, "select": selection(), "with_free_inertia": None,
            "contradiction": None, "significant_peak": None, "grade": Grade(None, None, None),
            "inertia_within_uncertainty": "", "with_random_torque": None, "describes": False,
            "is_established": True, "smooth_test": SmoothTest("casing", 0.5), "nonparametric_rivals": (),
            "nuisance_parameters": [], "unrecorded_drive": "", "largest_hidden": HiddenEffects(), "find_failures": [],
            "separating_run": "next run", "whiteness": [], "residual_torques": [], "angle_harmonics": [],
            "combined_uncertainties": {},
            "reselected": None,
        }  # fmt: skip
        self.asked, self.arguments = [], {}

        def step(name):
            def run(*args, **options):
                self.asked.append(name)
                self.arguments[name] = (args, options)
                return self.given[name]

            return run

        of_a_fit = {
            "significant_peak": step("significant_peak"),
            "smooth_test": property(step("smooth_test")),
        }
        for name, value in of_a_fit.items():
            monkeypatch.setattr(Found, name, value, raising=False)
        for name in self.given.keys() - of_a_fit:
            monkeypatch.setattr(module, name, step(name))

    def answer(self, fit=None, *, brief=True, **given):
        self.given |= given
        self.asked.clear()
        return diagnose(Found(wrong=True) if fit is None else fit, brief=brief)


COMPLETE = Grade("exact", 1.0, None)


def random_torque(*, is_raised=True, level=1e-6):
    words, noise = "a random torque of 1 uN m rms", SimpleNamespace(level=level)
    return SimpleNamespace(fit=Found(), words=words, is_raised=is_raised, noise=noise)


class TestVerdict(Answer):
    def test_without_a_lack_of_fit_a_model_is_adequate(self):
        found = self.answer(Found())
        assert (found.verdict, found.form, found.explained, found.failures) == ("adequate", None, None, ())
        assert "largest_hidden" not in self.asked  # not asked for in brief
        limit = SimpleNamespace(effect=DRAG, torque_Nm=3e-7)
        found = self.answer(Found(), brief=False, largest_hidden=HiddenEffects((limit,)))
        assert (found.upper_limits, found.without_limit) == ((limit,), ())
        assert found.sentence.endswith(f"95 % upper limits of the rms torque: {NAMED} 0.3 uN m.")

    def test_effects_without_a_limit_follow_the_limits(self):
        limit = SimpleNamespace(effect=DRAG, torque_Nm=3e-7)
        found = self.answer(Found(), brief=False, largest_hidden=HiddenEffects((limit,), (DRAG, DRAG)))
        assert found.without_limit == (DRAG, DRAG)
        assert found.sentence.endswith(f"{NAMED} 0.3 uN m. No useful limit: {NAMED}; {NAMED}.")
        found = self.answer(Found(), brief=False, largest_hidden=HiddenEffects((), (DRAG,)))
        assert found.sentence.endswith("too short or too noisy for a useful upper limit of another effect.")

    def test_effects_of_the_user_and_criteria_are_passed_on(self):
        own, strict = candidate().effect, Criteria(significance=0.001)
        base, workers = Found(wrong=True), WorkerPool(0)
        known, history = [candidate()], ["step"]
        diagnose(base, (own,), criteria=strict, workers=workers)
        assert self.arguments["rank"] == ((base, (own,)), {"criteria": strict, "workers": workers})
        diagnose(
            base, (own,), criteria=strict, candidates=known, history=history, workers=workers, brief=True
        )
        assert self.arguments["separate_values"] == ((base, known, (own,), strict), {})
        expected = (base, known, (own,), strict, workers, history)
        assert self.arguments["select"] == (expected, {"follow_up": False})
        final = self.given["select"]
        assert self.arguments["with_free_inertia"] == ((base, final, (own,), strict), {})
        assert self.arguments["grade"] == ((base, final, None, strict), {"misfit": False})
        assert self.arguments["contradiction"] == ((None, final.final, strict), {})
        self.answer(Found(), brief=False)
        assert self.arguments["largest_hidden"][0][1:] == ((), DEFAULT, [])
        self.answer(
            select=selection(candidate()), grade=COMPLETE, with_random_torque=random_torque(), describes=True
        )
        ((random, screened, named_fit, tests, _), _) = self.arguments["is_established"]
        assert random is self.given["with_random_torque"]
        assert (screened, named_fit, tests) == (
            self.given["select"].chosen.screened,
            self.given["select"].named,
            1,
        )

    def test_a_lack_of_fit_that_nothing_explains(self):
        found = self.answer(
            Found(), select=selection(final=Found(wrong=True)), find_failures=["at 2 s"], brief=False
        )
        assert found.verdict == "unexplained"
        assert found.sentence.startswith("Significant lack of fit: at 2 s.")
        assert "An unexplained torque of 2 uN m rms remains" in found.sentence
        assert found.failures == ("at 2 s",)

    def test_an_effect_that_suffices_is_missing(self):
        chosen = candidate(estimates={f"{DRAG}.k": estimate()})
        found = self.answer(select=selection(chosen), grade=COMPLETE)
        assert (found.verdict, found.form, found.explained) == ("missing_effect", "exact", 1.0)
        assert f"Missing: {NAMED}, k = " in found.sentence
        assert found.next_experiment == ""
        assert self.answer(brief=False).next_experiment == "next run"

    @pytest.mark.parametrize(
        ("lack_of_fit", "opening"),
        [
            (True, "Significant lack of fit. Missing"),
            (False, "No test of lack of fit is significant, but an added effect is (p = 1 × 10⁻⁶). Missing"),
        ],
    )
    def test_a_lack_of_fit_is_stated_only_if_the_fit_has_one(self, lack_of_fit, opening):
        chosen = candidate(estimates={f"{DRAG}.k": estimate()})
        base = Found(lack_of_fit=lack_of_fit)
        found = self.answer(base, select=selection(chosen), grade=COMPLETE)
        assert found.sentence.startswith(opening)
        found = self.answer(base, grade=Grade(None, 0.02, LEFT))
        assert found.verdict == "unexplained"
        assert found.sentence.startswith(opening.removesuffix(" Missing"))

    def test_a_test_that_contradicts_the_final_fit_counts(self):
        found = self.answer(Found(), contradiction=SmoothTest("casing", 1e-5))
        assert found.verdict == "unexplained"
        assert "depends on the speed of the casing (p = 1e-05)" in found.sentence
        # of a fit with a lack of fit no further test is asked for, but for a sinusoid in recordings with lines
        wrong = selection(final=Found(wrong=True))
        self.answer(select=wrong, contradiction=SmoothTest("casing", 1e-5))
        assert "contradiction" not in self.asked
        assert "significant_peak" not in self.asked
        lined = Found(wrong=True, problem=problem(data(), data(lines=(1,))))
        peak = PeriodogramPeak(2.0, 1e-6, 1e-4, "run", "casing", 1e-6, "casing: k*sin(2*t)")
        found = self.answer(lined, select=wrong, significant_peak=peak)
        assert 'add "casing: k*cos(2*t + phi)" as a hypothesis' in found.sentence

    def test_an_effect_that_does_not_explain_a_sinusoid_is_not_named(self):
        peak = PeriodogramPeak(2.0, 1e-6, 1e-4, "run", "casing", 1e-6, "law")
        chosen = candidate()
        found = self.answer(select=selection(chosen), contradiction=peak, significant_peak=peak)
        assert found.verdict == "unexplained"
        assert f"after {NAMED}" not in found.sentence
        found = self.answer(significant_peak=None)
        assert f"after {NAMED}" in found.sentence
        # with an approximate form the effect is part of the answer
        found = self.answer(grade=Grade("approximate", 0.97, LEFT), significant_peak=peak)
        assert found.verdict == "missing_effect"

    @pytest.mark.parametrize(
        ("unknown", "with_two", "effects", "bic", "wrong", "doubt", "verdict"),
        [
            ("omega_r", "", (DRAG, LAMINAR), 88.5, False, None, "missing_effect"),
            ("omega_r", "omega_r", (DRAG, LAMINAR), 88.5, False, None, "unexplained"),  # a better smooth law
            (
                "omega_r",
                "",
                (DRAG, LAMINAR),
                88.7,
                False,
                None,
                "unexplained",
            ),  # 10 + 2 ln 2 worse than the law
            ("omega_r", "", (DRAG,), 88.5, False, None, "unexplained"),
            ("omega_r", "", (DRAG, LAMINAR), 88.5, True, None, "unexplained"),
            ("omega_r", "", (DRAG, LAMINAR), 88.5, False, SmoothTest("casing", 1e-5), "unexplained"),
            ("", "", (DRAG, LAMINAR), 88.5, False, None, "unexplained"),
        ],
    )
    def test_two_effects_are_tried_before_a_law_outside_the_library(
        self, monkeypatch, unknown, with_two, effects, bic, wrong, doubt, verdict
    ):
        chosen, asked = candidate(), []
        alone = selection(chosen, named=Found(model=named(DRAG)))
        end = Found(model=named(*effects), bic=bic, wrong=wrong)
        both = selection(chosen, named=Found(model=named(DRAG)), final=end, others=[candidate(LAMINAR)])

        def select(*_, follow_up):
            asked.append(follow_up)
            return both if follow_up else alone

        grades = {
            id(alone): Grade(None, 0.3, LEFT, unknown=unknown, unknown_bic=100.0),
            id(both): Grade(None, 0.3, LEFT, unknown=with_two),
        }
        monkeypatch.setattr(module, "select", select)
        monkeypatch.setattr(module, "grade", lambda fit, found, *_, **__: grades[id(found)])
        monkeypatch.setattr(module, "contradiction", lambda _, fit, __: doubt if fit is end else None)
        assert self.answer().verdict == verdict
        assert asked == ([False, True] if unknown else [False])

    def test_a_second_effect_is_sought_once(self, monkeypatch):
        asked = []
        both = selection(candidate(), final=Found(model=named(DRAG, LAMINAR)))
        monkeypatch.setattr(module, "select", lambda *_, follow_up: asked.append(follow_up) or both)
        self.answer(grade=Grade(None, 0.3, LEFT, unknown="omega_r"))
        assert asked == [False]

    @pytest.mark.parametrize(
        ("score", "columns", "significant", "wrong", "oscillates", "tried"),
        [
            (16.3, 1, True, False, False, True),  # 10 + ln 500
            (16.1, 1, True, False, False, False),
            (22.5, 2, True, False, False, True),
            (22.3, 2, True, False, False, False),
            (99.0, 1, False, False, False, False),
            (99.0, 1, True, True, False, False),
            (99.0, 1, True, False, True, False),
        ],
    )
    def test_a_second_effect_with_a_high_score_is_tried(
        self, monkeypatch, score, columns, significant, wrong, oscillates, tried
    ):
        """Beside the first one; with it the answer has a BIC of 100, and the second one states the remainder."""
        recorded = problem(data(oscillation=SimpleNamespace() if oscillates else None))
        alone = selection(
            candidate(), named=Found(model=named(DRAG), wrong=wrong, problem=recorded), others=[]
        )
        end = Found(model=named(DRAG, LAMINAR), bic=88.5)
        both = selection(candidate(), named=Found(model=named(DRAG)), final=end, others=[candidate(LAMINAR)])
        asked = []
        monkeypatch.setattr(
            module, "select", lambda *_, follow_up: asked.append(follow_up) or (both if follow_up else alone)
        )
        next_one = replace(
            candidate(LAMINAR, score=score, significant=significant),
            screened=SimpleNamespace(columns=columns),
        )
        grades = {id(alone): COMPLETE, id(both): Grade(None, 0.7, LEFT)}
        monkeypatch.setattr(module, "grade", lambda fit, found, *_, **__: grades[id(found)])
        found = self.answer(rank=[next_one])
        assert asked == ([False, True] if tried else [False])
        assert (found.remainder is LEFT) is tried
        asked.clear()
        self.answer(Found(wrong=True, lack_of_fit=False), rank=[next_one])
        assert asked == [False]

    @pytest.mark.parametrize("bic", [88.5, 88.7])
    def test_a_second_effect_has_to_lower_bic_clearly(self, monkeypatch, bic):
        alone = selection(candidate(), named=Found(model=named(DRAG), bic=100.0))
        end = Found(model=named(DRAG, LAMINAR), bic=bic)
        both = selection(candidate(), named=Found(model=named(DRAG)), final=end, others=[candidate(LAMINAR)])
        monkeypatch.setattr(module, "select", lambda *_, follow_up: both if follow_up else alone)
        next_one = replace(candidate(LAMINAR, score=99.0), screened=SimpleNamespace(columns=1))
        grades = {id(alone): COMPLETE, id(both): Grade(None, 0.7, LEFT)}
        monkeypatch.setattr(module, "grade", lambda fit, found, *_, **__: grades[id(found)])
        assert (self.answer(rank=[next_one]).remainder is LEFT) is (bic < 100 - 10 - 2 * math.log(2))

    @pytest.mark.parametrize(
        ("bic", "lack_of_fit", "weak_too", "named_two"),
        [
            (88.5, True, False, True),
            (88.7, True, False, False),  # 10 + 2 ln 2 below 100
            (88.5, False, False, False),
            (88.5, True, True, False),
        ],
    )
    def test_two_effects_replace_one_whose_strength_is_not_determined(
        self, monkeypatch, bic, lack_of_fit, weak_too, named_two
    ):
        """The shape of the brake imitates drag and friction; the brake is no candidate of the second search."""
        brake = "casing.brake.eddy"
        weak = {f"{brake}.k": estimate(8e-8, 8e-8)}
        alone = Found(model=named(brake), estimates=weak)
        found = candidate(brake, fit=alone)
        first = selection(found, named=alone)
        drag = Found(model=named(DRAG), estimates={f"{DRAG}.k": estimate(2e-9, 1e-9 if weak_too else 1e-10)})
        end = Found(model=named(DRAG, LAMINAR), bic=bic)
        both = selection(candidate(), named=drag, final=end, others=[candidate(LAMINAR)])
        asked = []

        def select(fit, ranked, *_, follow_up):
            asked.append([c.effect.name for c in ranked])
            return both if follow_up else first

        monkeypatch.setattr(module, "select", select)
        grades = {id(first): COMPLETE, id(both): Grade(None, 0.7, LEFT)}
        monkeypatch.setattr(module, "grade", lambda fit, found, *_, **__: grades[id(found)])
        answer = self.answer(Found(lack_of_fit=lack_of_fit), rank=[found, candidate(LAMINAR, fit=None)])
        assert asked == [[brake, LAMINAR], [LAMINAR]][: 1 + lack_of_fit]
        assert (answer.verdict, answer.remainder is LEFT) == (
            ("missing_effect", True) if named_two else ("undecided", False)
        )

    @pytest.mark.parametrize("complete", [True, False])
    def test_the_strength_beside_a_second_effect_is_that_of_both_together(self, complete, monkeypatch):
        """The fit with one effect alone is biased; without a second effect, the candidate has its own values."""
        alone, beside = estimate(2e-9, 1e-10), estimate(5e-9, 3e-10)
        end = Found(
            model=named(DRAG, LAMINAR) if complete else named(DRAG),
            estimates={f"{DRAG}.k": beside, f"{LAMINAR}.k": estimate(1e-9)},
        )
        first = candidate(estimates={f"{DRAG}.k": alone})
        chosen = selection(first, named=Found(model=named(DRAG)), final=end, others=[candidate(LAMINAR)])
        monkeypatch.setattr(
            module, "combined_uncertainties", lambda fit: {f"{DRAG}.k": 4e-10 if fit is end else 2e-10}
        )
        found = self.answer(select=chosen, grade=Grade("exact", 1.0, None))
        assert found.candidates[0].estimates == {f"{DRAG}.k": beside if complete else alone}
        stated = "(5.0 +- 0.4) x 10^-9" if complete else "(2.00 +- 0.20) x 10^-9"
        assert stated in found.sentence
        # no values are known
        chosen = selection(first, named=Found(model=named(DRAG)), final=Found(model=named(DRAG, LAMINAR)))
        assert self.answer(select=chosen).candidates[0].estimates == {f"{DRAG}.k": alone}

    def test_without_an_effect_no_second_one_is_sought(self, monkeypatch):
        asked = []
        monkeypatch.setattr(module, "select", lambda *_, follow_up: asked.append(follow_up) or selection())
        next_one = replace(candidate(LAMINAR, score=99.0), screened=SimpleNamespace(columns=1))
        self.answer(rank=[next_one])
        assert asked == [False]

    @pytest.mark.parametrize(
        ("text", "verdict"), [("within its uncertainty", "adequate"), ("", "missing_effect")]
    )
    def test_an_inertia_within_its_uncertainty_is_not_a_missing_effect(self, text, verdict):
        chosen = candidate("setup.inertia")
        found = self.answer(select=selection(chosen), grade=COMPLETE, inertia_within_uncertainty=text)
        assert found.verdict == verdict
        assert not text or (found.sentence, found.explained, found.form) == (text, None, None)
        # of an effect with a remainder it is not asked for
        self.answer(grade=Grade("approximate", 0.97, LEFT))
        assert "inertia_within_uncertainty" not in self.asked

    def test_an_effect_that_is_not_determined_is_a_hint(self):
        weak = Found(estimates={f"{DRAG}.k": estimate(2e-9, 1e-9)})
        found = self.answer(select=selection(candidate(), named=weak), grade=COMPLETE)
        assert (found.verdict, found.form, found.explained) == ("undecided", None, None)
        assert f"so {NAMED} is a hint only." in found.sentence
        assert found.sentence.startswith(
            "Significant lack of fit, but no effect is established. The strength"
        )
        consistent = self.answer(
            Found(lack_of_fit=False), select=selection(candidate(), named=weak), grade=COMPLETE
        )
        assert consistent.sentence.startswith("Nothing is established. The strength")
        assert "with_random_torque" not in self.asked
        found = self.answer(select=selection(candidate(), named=weak, final=Found(wrong=True)))
        assert found.verdict == "unexplained"
        starts = candidate(effect=START, estimates={"camera.start.dt": estimate(3e-3, 1e-3, "s")})
        assert self.answer(select=selection(starts, named=weak)).verdict == "missing_effect"

    @pytest.mark.parametrize(
        ("established", "describes", "smooth_p", "verdict"),
        [
            (False, True, 0.0011, "undecided"),
            (False, True, 0.0009, "missing_effect"),
            (False, False, 0.5, "missing_effect"),
            (True, True, 0.5, "missing_effect"),
        ],
    )
    def test_a_random_torque_is_an_alternative(self, established, describes, smooth_p, verdict):
        found = self.answer(
            select=selection(candidate(alike=(LAMINAR,))), grade=COMPLETE, with_random_torque=random_torque(),
            describes=describes, is_established=established, smooth_test=SmoothTest("casing", smooth_p),
        )  # fmt: skip
        assert found.verdict == verdict
        if verdict == "undecided":
            assert f"A random torque of 1 uN m rms describes the data as well as {BOTH}" in found.sentence
            assert "Repeat the recording" in found.sentence

    @pytest.mark.parametrize(("level", "noise"), [(0.0, True), (1e-12, False)])
    def test_a_random_torque_of_level_zero_is_the_noise_of_the_angles(self, level, noise):
        random = random_torque(is_raised=False, level=level)
        given = {
            "select": selection(candidate()),
            "grade": COMPLETE,
            "smooth_test": SmoothTest("casing", 0.5),
        }
        found = self.answer(**given, with_random_torque=random, describes=True, is_established=False)
        assert found.verdict == "undecided"
        assert (
            f"The noise of the angles alone describes the data as well as {NAMED}." in found.sentence
        ) is noise
        assert ("random torque" in found.sentence) is not noise
        assert "a law returns with the same strength" in found.sentence

    def test_a_random_torque_that_describes_an_unexplained_lack_of_fit(self):
        wrong = selection(final=Found(wrong=True))
        found = self.answer(select=wrong, with_random_torque=random_torque(), describes=True)
        assert found.verdict == "undecided"
        assert "describes the data;" in found.sentence
        assert "Repeat" not in found.sentence

    @pytest.mark.parametrize(
        "change",
        [
            {"select": selection(candidate(effect=SLIP))},
            {"contradiction": HarmonicTest(3, 1e-5)},
        ],
    )
    def test_of_slips_and_periodic_residuals_there_is_no_random_alternative(self, change):
        given = {
            "select": selection(candidate()),
            "grade": COMPLETE,
            "describes": True,
            "is_established": False,
        }
        assert self.answer(**given, with_random_torque=random_torque()).verdict == "undecided"
        self.answer(**(given | change))
        assert "with_random_torque" not in self.asked

    @pytest.mark.parametrize("wrong", [False, True])
    def test_an_unrecorded_drive_excludes_a_random_torque(self, wrong):
        drive = "The speed rises."
        final = Found(wrong=wrong, needs_random=True)
        given = {"select": selection(final=final), "with_random_torque": random_torque(), "describes": True}
        found = self.answer(Found(wrong=wrong, needs_random=True), unrecorded_drive=drive, **given)
        assert found.verdict == ("unexplained" if wrong else "undecided")
        assert drive in found.sentence
        assert "with_random_torque" not in self.asked
        assert drive not in self.answer(Found(needs_random=True), unrecorded_drive="", **given).sentence

    def test_of_an_oscillation_there_is_no_random_alternative(self):
        swinging = Found(wrong=True, problem=problem(data(oscillation=SimpleNamespace())))
        self.answer(
            swinging, select=selection(candidate()), grade=COMPLETE, describes=True, is_established=False
        )
        assert "with_random_torque" not in self.asked

    @pytest.mark.parametrize(
        ("raised", "describes", "verdict"),
        [(True, True, "undecided"), (True, False, "unexplained"), (False, True, "unexplained")],
    )
    @pytest.mark.parametrize("needed", [Found(needs_random=True), Found(smooth=True)])
    def test_a_fit_that_needs_more_torque_is_not_adequate(self, needed, raised, describes, verdict):
        random = random_torque(is_raised=raised)
        found = self.answer(needed, with_random_torque=random, describes=describes)
        assert found.verdict == verdict

    def test_a_parameter_that_differs_between_recordings_ends_the_search(self):
        separate = SimpleNamespace(
            fit=Found(), parameter=SimpleNamespace(sentence="The recordings may differ in a.k.")
        )
        found = self.answer(separate_values=separate, find_failures=["at 2 s"])
        assert (found.verdict, found.differs) == ("unexplained", separate.parameter)
        assert found.sentence == "Significant lack of fit: at 2 s. The recordings may differ in a.k."
        assert "select" not in self.asked

    def test_the_sentence_of_a_free_inertia_is_added(self):
        told = {DEFAULT: "An error of inertia explains it as well."}
        rival = SimpleNamespace(better=False, sentence=lambda criteria: told[criteria])
        chosen = candidate()
        found = self.answer(
            select=selection(chosen), grade=COMPLETE, with_free_inertia=rival, reselected=selection(chosen)
        )
        assert found.sentence.endswith("An error of inertia explains it as well.")
        assert "reselected" in self.asked
        self.answer(with_free_inertia=None)
        assert "reselected" not in self.asked

    def test_camera_effects_are_stated_unless_the_body_oscillates(self):
        nuisance = [Nuisance("camera.centre", "run", 2e-3, 1e-5, "rad", 1e-9)]
        words = "Camera centre offset 2 mrad (nuisance parameter, fitted)."
        assert words in self.answer(Found(), nuisance_parameters=nuisance).sentence
        swinging = Found(problem=problem(data(oscillation=SimpleNamespace())))
        assert words not in self.answer(swinging).sentence

    @pytest.mark.parametrize("other", [True, False])
    def test_a_ranking_at_other_noise_is_not_used(self, monkeypatch, other):
        measured = Found(wrong=True)
        monkeypatch.setattr(module, "measured_with", lambda fit, criteria: measured if other else fit)
        base, known, history = Found(wrong=True), [candidate()], ["step"]
        diagnose(base, candidates=known, history=history, brief=True)
        fit, ranked, steps = (self.arguments["select"][0][i] for i in (0, 1, 5))
        assert fit is (measured if other else base)
        assert (ranked, list(steps)) == (([], []) if other else (known, history))

    def test_camera_effects_are_those_of_the_most_complete_fit(self):
        final = Found()
        self.answer(select=selection(candidate(), final=final), grade=COMPLETE)
        assert self.arguments["nuisance_parameters"] == ((final,), {})
        separate = SimpleNamespace(fit=Found(), parameter=SimpleNamespace(sentence="It differs."))
        self.answer(separate_values=separate)
        assert self.arguments["nuisance_parameters"] == ((separate.fit,), {})

    def test_an_inertia_within_its_uncertainty_is_an_answer_to_random_torque_as_well(self):
        chosen = selection(candidate("setup.inertia"))
        found = self.answer(
            Found(needs_random=True), select=chosen, grade=COMPLETE, inertia_within_uncertainty="within"
        )
        assert (found.verdict, found.sentence) == ("adequate", "within")

    def test_a_hint_that_a_test_contradicts_is_unexplained(self):
        weak = Found(estimates={f"{DRAG}.k": estimate(2e-9, 1e-9)})
        given = {"select": selection(candidate(), named=weak), "grade": COMPLETE}
        assert self.answer(**given).verdict == "undecided"
        assert self.answer(**given, contradiction=SmoothTest("casing", 1e-5)).verdict == "unexplained"

    @pytest.mark.parametrize("lacking", [True, False])
    def test_without_a_restoring_torque_no_unmodelled_torque_is_shown(self, lacking):
        given = {"residual_torques": ["curve"], "angle_harmonics": ["harmonic"]}
        base = Found(wrong=True, lacks_restoring_torque=lacking)
        found = self.answer(base, select=selection(final=Found(wrong=True)), brief=False, **given)
        assert (found.torques, found.ripples) == (() if lacking else ("curve",), ("harmonic",))
        assert self.arguments["find_failures"][0][1] == list(found.torques)
        self.answer(base)
        assert "find_failures" not in self.asked

    def test_an_answer_that_names_nothing_has_no_form(self):
        undetermined = Found(undetermined=(f"{DRAG}.k",))
        found = self.answer(select=selection(candidate(), named=undetermined), grade=COMPLETE)
        assert (found.verdict, found.form, found.explained) == ("unexplained", None, 1.0)

    def test_the_next_run_separates_members_of_the_class_with_a_fit(self):
        chosen = candidate(alike=(LAMINAR, UNBALANCE))
        others = [candidate(LAMINAR, fit=None), candidate(UNBALANCE)]
        self.answer(select=selection(chosen, others=others), grade=COMPLETE, brief=False)
        assert [name for name, _, _ in self.arguments["separating_run"][0][1]] == [DRAG, UNBALANCE]

    def test_errors_of_starts_are_neither_a_hint_nor_a_random_torque(self):
        starts = candidate(effect=START, estimates={"camera.start.dt": estimate(3e-3, 1e-3, "s")})
        given = {"grade": COMPLETE, "describes": True, "is_established": False}
        found = self.answer(
            select=selection(starts, named=Found(converged=False)),
            with_random_torque=random_torque(),
            **given,
        )
        assert found.verdict == "missing_effect"
        assert "with_random_torque" not in self.asked

    def test_the_noise_of_the_recording_does_not_explain_a_lack_of_fit(self):
        wrong = selection(final=Found(wrong=True))
        given = {"select": wrong, "describes": True}
        found = self.answer(with_random_torque=random_torque(is_raised=False), **given)
        assert found.verdict == "unexplained"

    def test_a_random_torque_is_compared_over_the_whole_list(self):
        chosen = selection(candidate(), named=Found(), final=Found(), others=[candidate(LAMINAR)] * 4)
        given = {"grade": COMPLETE, "describes": True, "with_random_torque": random_torque()}
        self.answer(select=chosen, **given)
        _, screened, fit, tests, _ = self.arguments["is_established"][0]
        assert (screened, fit, tests) == (chosen.chosen.screened, chosen.named, 5)

    @pytest.mark.parametrize(
        ("raised", "words"),
        [
            (True, "without the model the recording does not establish its level"),
            (False, "the recording shows this level without a model"),
        ],
    )
    def test_where_the_level_of_a_random_torque_comes_from(self, raised, words):
        given = {"grade": COMPLETE, "describes": True, "is_established": False}
        random = random_torque(is_raised=raised)
        found = self.answer(select=selection(candidate()), with_random_torque=random, **given)
        assert words in found.sentence

    def test_a_sinusoid_is_sought_in_the_most_complete_fit(self):
        final = Found(wrong=True)
        lined = Found(wrong=True, problem=problem(data(lines=(1,))))
        self.answer(lined, select=selection(final=final))
        assert self.arguments["significant_peak"][0][0] is final

    def test_bounds_are_those_of_the_fit_of_the_answer(self):
        layout = SimpleNamespace(index={"a.g": 0}, is_physical_bound=lambda name: False)
        cases = SimpleNamespace(data=[data()], layout=layout)
        final = Found(problem=cases, estimates={"a.g": estimate(1.5, at_bound=True)})
        base = replace(final, wrong=True, estimates={"a.g": estimate(2.5, at_bound=True)})
        found = self.answer(base, select=selection(candidate(), final=final), grade=COMPLETE)
        assert "a.g = 1.5" in found.sentence
        found = self.answer(base, select=selection(final=replace(final, wrong=True)))
        assert "a.g = 2.5" in found.sentence

    @pytest.mark.parametrize(("limit", "stated"), [(0.2, 0.2), (math.inf, None)])
    def test_the_limit_of_the_form_is_stated_where_it_is_finite(self, limit, stated):
        test = SimpleNamespace(limit=limit, is_strong=lambda _: True, any_in_time=False)
        size = replace(COMPLETE, test=test)
        assert self.answer(select=selection(candidate()), grade=size).form_limit == stated


class TestGraded(Answer):
    """The form after what errors of inertia and random torque leave of it."""

    def graded(self, form, *, final=None, better=True, allowed=True, rival=True, **options):
        left = None if form == "exact" else LEFT
        self.given["grade"] = Grade(form, None if form is None else 0.97, left)
        other = SimpleNamespace(better=better, is_allowed=lambda criteria: allowed) if rival else None
        doubt, misfit = options.get("doubt"), options.get("misfit", False)
        chosen = selection(candidate(), final=final)
        return module._graded(Found(), chosen, doubt, other, DEFAULT, misfit=misfit)

    @pytest.mark.parametrize(
        ("form", "change", "found"),
        [
            ("exact", {}, "exact"),
            ("approximate", {}, "exact"),
            ("exact", {"allowed": False}, "approximate"),
            ("exact", {"misfit": True}, "approximate"),
            ("exact", {"doubt": SmoothTest("casing", 1e-5)}, "approximate"),
            ("approximate", {"better": False}, "approximate"),
            ("approximate", {"rival": False}, "approximate"),
            (None, {}, None),
            (None, {"allowed": False}, None),
        ],
    )
    def test_an_error_of_inertia_within_its_uncertainty_is_not_a_remainder(self, form, change, found):
        size = self.graded(form, **change)
        assert size.form == found
        if form == "approximate" and found == "exact":
            assert (size.explained, size.remainder) == (1.0, None)

    @pytest.mark.parametrize(
        ("form", "noisy", "found"),
        [
            ("exact", True, (None, True)),
            ("exact", False, ("exact", False)),
            ("approximate", True, ("approximate", False)),
        ],
    )
    def test_a_law_that_needs_more_noise_has_no_established_form(self, form, noisy, found):
        size = self.graded(form, rival=False, final=Found(noisy=noisy))
        assert (size.form, size.noisy) == found

    @pytest.mark.parametrize(
        ("form", "own", "others", "found"),
        [
            ("exact", (), (), ("exact", ())),
            ("exact", (), (UNKNOWN_IN_TIME,), (None, (UNKNOWN_IN_TIME,))),
            ("exact", (LAMINAR,), (UNKNOWN_IN_TIME,), (None, (LAMINAR, UNKNOWN_IN_TIME))),
            # an approximate law has rivals in the library; without one, laws outside of it are compared
            ("approximate", (LAMINAR,), (UNKNOWN_IN_TIME,), ("approximate", (LAMINAR,))),
            ("approximate", (), (UNKNOWN_IN_TIME,), ("approximate", (UNKNOWN_IN_TIME,))),
        ],
    )
    def test_a_form_that_has_rivals_is_not_established(self, form, own, others, found):
        self.given["nonparametric_rivals"] = others
        chosen, size = module._with_unknown_laws(
            None, selection(candidate()), None, Grade(form, 1.0, None, own), DEFAULT
        )
        assert (size.form, chosen.chosen.indistinguishable_from) == found


class TestShown(Answer):
    """What a diagnosis shows of its curves, candidates and words."""

    def test_curves_and_failures_of_one_case(self, monkeypatch):
        drawn = {}
        monkeypatch.setattr(
            module, "draw_torque", lambda ax, curves, spans, unit: drawn.setdefault("torque", (curves, spans))
        )
        monkeypatch.setattr(
            module, "draw_candidates", lambda ax, names, scores, **marks: drawn.setdefault("scores", scores)
        )
        curves = [
            SimpleNamespace(label=label, body=body, time=label, torque=1, sigma=2)
            for label in ("run", "other")
            for body in ("casing", "rotor")
        ]
        failures = [SimpleNamespace(label=x, t_start=i, t_stop=i + 1) for i, x in enumerate(("other", "run"))]
        record = SimpleNamespace(label="run", body="platter")
        base = Found(problem=problem(SimpleNamespace(record=record)))
        found = replace(
            self.answer(),
            fit=base,
            torques=tuple(curves),
            failures=tuple(failures),
            candidates=(candidate(), candidate(LAMINAR, score=0.0)),
        )
        found._draw_torque(SimpleNamespace(set_title=len, legend=lambda **_: None), "run")
        assert drawn["torque"] == ([("platter", "run", 1, 2), ("rotor", "run", 1, 2)], [(1, 2)])
        replace(found, torques=()).plot()
        assert drawn["scores"] == [50.0]

    @pytest.mark.parametrize("case", [0, 1])
    def test_on_given_axes_one_case_is_drawn(self, monkeypatch, case):
        curves = [SimpleNamespace(label=x) for x in ("run", "run", "other")]
        drawn = []
        monkeypatch.setattr(
            module.Diagnosis, "_draw_torque", lambda own, ax, label: drawn.append((ax, label))
        )
        ax = SimpleNamespace(figure="figure")
        monkeypatch.setattr(module, "figure_of", lambda a: a.figure)
        found = replace(self.answer(), torques=tuple(curves))
        assert found.plot(ax, case=case) == "figure"
        assert drawn == [(ax, ("run", "other")[case])]

    @pytest.mark.parametrize(("scores", "shown"), [((50.0, 0.0, -1.0), 1), ((), 0), ((9.0,) * 40, None)])
    def test_a_new_figure_has_all_cases_and_the_candidates(self, monkeypatch, scores, shown):
        curves = [SimpleNamespace(label=x) for x in ("run", "run", "other")]
        drawn, named = [], []
        monkeypatch.setattr(module.Diagnosis, "_draw_torque", lambda own, ax, label: drawn.append(label))
        monkeypatch.setattr(module, "draw_candidates", lambda ax, names, values, **marks: named.append(marks))
        candidates = tuple(candidate(score=s) for s in scores)
        found = replace(self.answer(), fit=Found(), torques=tuple(curves), candidates=candidates)
        figure = found.plot()
        assert drawn == ["run", "other"]
        shown = module._MOST_CANDIDATES if shown is None else shown
        assert len(figure.axes) == 2 + bool(shown)
        assert [len(m["significant"]) for m in named] == ([shown] if shown else [])
        assert figure.get_size_inches().tolist() == pytest.approx([9.0, 6.4 + 0.35 * shown])

    def test_a_long_sentence_is_cut_after_eight_lines(self):
        line = "word " * 19 + "word"
        words = [" ".join([line] * count) for count in (8, 9)]
        shown = [repr(replace(self.answer(), sentence=w, candidates=())).splitlines() for w in words]
        assert [len(lines) for lines in shown] == [9, 9]
        assert [lines[-1] for lines in shown] == [line, "..."]


class TestFindings(Answer):
    """Slipped turns, which the data show without a model, are a candidate."""

    slip = SimpleNamespace(turns=2, where="the casing", time=3.5)

    def of(self, *slips):
        return Found(findings=("Two turns slipped.",), problem=problem(data(slips=slips)))

    def test_slipped_turns_are_the_missing_effect_of_an_adequate_fit(self):
        found = self.answer(self.of(self.slip))
        assert (found.verdict, found.form, found.explained) == ("missing_effect", "exact", 1.0)
        assert found.candidates[0].effect is SLIP
        assert found.sentence.startswith("Two turns slipped. ")
        assert "nothing else is missing" in found.sentence

    def test_slipped_turns_are_listed_before_candidates_with_a_larger_score(self):
        other = candidate(score=1e12)
        found = self.answer(self.of(self.slip), select=selection(other))
        assert [c.effect for c in found.candidates] == [SLIP, other.effect]

    def test_another_verdict_remains(self):
        found = self.answer(self.of(self.slip), select=selection(final=Found(wrong=True)))
        assert (found.verdict, found.form) == ("unexplained", None)
        assert found.candidates[0].effect is SLIP

    def test_another_fault_of_the_recording_is_unexplained(self):
        assert self.answer(self.of()).verdict == "unexplained"

    def test_it_is_compared_with_the_least_noise_of_all_series(self):
        """A slip of one turn in angles of 2 rad and of 4 rad: (2 pi / 2)^2 / 2, less one parameter."""
        samples = SimpleNamespace(sigma=np.array([1.0, 2.0, 9.0]))
        case = data(slips=[self.slip])
        case.casing = SimpleNamespace(scale=2.0, samples=samples)
        case.rotor = (SimpleNamespace(scale=1.0, samples=samples),)
        slips = [SimpleNamespace(turns=1, where="the casing", time=t) for t in (1.0, 2.0)]
        found = slipped(Found(rows=100, problem=problem(case)), slips)
        assert found.score == pytest.approx(math.pi**2)
        assert found.delta_bic == pytest.approx(2 * math.log(100) - math.pi**2)

    def test_its_score_is_the_chi_square_of_the_steps(self):
        """Of two turns, with 2 mrad of noise: (4 pi / 2e-3)^2 / 2."""
        found = slipped(self.of(self.slip), [self.slip])
        score = (4 * math.pi / 2e-3) ** 2 / 2
        assert found.score == pytest.approx(score)
        assert found.delta_bic == pytest.approx(math.log(500) - score)
        assert (found.significant, found.p_value) == (True, 0.0)
        both = slipped(self.of(self.slip), [self.slip] * 2)
        assert both.score == pytest.approx(2 * score)
        assert both.delta_bic == pytest.approx(2 * math.log(500) - 2 * score)


@pytest.mark.parametrize(
    ("form", "explained", "remainder", "significant", "verdict"),
    [
        ("exact", 1.0, None, False, "missing_effect"),
        ("approximate", 0.97, LEFT, True, "missing_effect"),
        (None, 1.0, None, False, "missing_effect"),
        (None, 1.0, None, True, "unexplained"),
        (None, 0.7, LEFT, True, "unexplained"),
        (None, 0.7, LEFT, False, "unexplained"),  # nothing was added to the effect
    ],
)
def test_size_and_significance_make_the_verdict(form, explained, remainder, significant, verdict):
    chosen = selection(candidate(), named=Found(named(DRAG)))
    assert (
        module._verdict(chosen, Grade(form, explained, remainder), DEFAULT, significant=significant)
        == verdict
    )


@pytest.mark.parametrize(
    ("explained", "final", "significant", "verdict"),
    [
        (0.5, (DRAG, LAMINAR), False, "missing_effect"),
        (0.06, (DRAG, LAMINAR), False, "missing_effect"),
        (0.04, (DRAG, LAMINAR), False, "unexplained"),
        (0.5, (DRAG, LAMINAR), True, "unexplained"),
        (0.5, (DRAG,), False, "unexplained"),
    ],
)
def test_a_second_effect_completes_an_answer(explained, final, significant, verdict):
    chosen = selection(candidate(), named=Found(named(DRAG)), final=Found(named(*final)))
    size = Grade(None, explained, LEFT)
    assert module._verdict(chosen, size, DEFAULT, significant=significant) == verdict


@pytest.mark.parametrize(("significant", "verdict"), [(True, "unexplained"), (False, "adequate")])
def test_without_an_effect_significance_makes_the_verdict(significant, verdict):
    assert module._verdict(selection(), Grade(None, None, None), DEFAULT, significant=significant) == verdict


@pytest.mark.parametrize(
    ("undetermined", "verdict"), [((f"{DRAG}.k",), "unexplained"), (("other.k",), "missing_effect")]
)
def test_an_effect_of_undetermined_strength_is_not_an_answer(undetermined, verdict):
    chosen = selection(candidate(), named=Found(undetermined=undetermined))
    assert module._verdict(chosen, COMPLETE, DEFAULT, significant=False) == verdict


class TestWords:
    def unexplained(self, chosen=None, size=None, doubt=None, final=None):
        final = final or Found()
        return " ".join(
            module._unexplained(
                selection(chosen, final=final), doubt, size or Grade(None, None, None), DEFAULT
            )
        )

    @pytest.mark.parametrize(
        ("explained", "words"),
        [
            (0.04, "No effect of the library explains more than 5 % of it."),
            (0.06, f"the closest, {NAMED}, explains 6 % of the mean square unmodelled torque."),
        ],
    )
    def test_the_closest_effect_is_a_hypothesis_from_five_percent(self, explained, words):
        assert words in self.unexplained(candidate(), Grade(None, explained, LEFT))

    def test_a_law_of_another_speed_explains_more(self):
        text = self.unexplained(candidate(), Grade(None, 0.7, LEFT, unknown="omega_r"))
        assert f"a smooth law of omega_r explains more than the closest one, {NAMED}, with 70 %" in text

    def test_a_form_with_an_undetermined_strength(self):
        text = self.unexplained(candidate(), Grade("approximate", 0.97, LEFT))
        assert "but with an undetermined strength" in text
        assert "undetermined" not in self.unexplained(candidate(), Grade(None, 0.9, LEFT))

    @pytest.mark.parametrize(
        ("levels", "words"),
        [
            ((1e-6, 3e-6), "An unexplained torque of 3 uN m rms remains"),
            ((0.0,), "and no random torque describes it."),
            ((), "and no random torque describes it."),
        ],
    )
    def test_a_torque_without_a_name_has_its_largest_size(self, levels, words):
        noise = tuple(SimpleNamespace(level=x) for x in levels)
        assert words in self.unexplained(final=Found(noise=noise))

    def test_candidates_that_were_not_fitted(self):
        waiting = [candidate(fit=None, score=10.0), candidate(LAMINAR, fit=None, score=20.0)]
        text = module._nothing_explains(Selection(waiting, None, None, Found()))
        assert f"begins with laminar disc drag of the casing ({LAMINAR})" in text
        assert module._nothing_explains(Selection([*waiting, candidate()], None, None, None)) == (
            "No effect of the library explains it"
        )
        none = [candidate(fit=None, significant=False)]
        assert "explains it" in module._nothing_explains(Selection(none, None, None, None))

    def missing(self, chosen, size=COMPLETE, final=None):
        return " ".join(module._missing(selection(chosen, final=final or Found()), size, DEFAULT))

    def test_names_of_one_effect_and_of_a_class(self, monkeypatch):
        monkeypatch.setattr(module, "combined_uncertainties", lambda fit: {})
        assert self.missing(None) == ""
        assert self.missing(candidate()) == f"Missing: {NAMED}."
        assert self.missing(candidate("setup.inertia")).startswith("Fault of the measurement: ")
        approximate = Grade("approximate", 0.97, LEFT)
        assert self.missing(candidate(), approximate).startswith(f"Missing: a law close to {NAMED}.")
        both = candidate(alike=(LAMINAR,))
        assert (
            self.missing(both) == f"Missing: one of these effects, which these data cannot separate: {BOTH}."
        )
        assert self.missing(both, approximate).startswith(
            f"Missing: a law close to one of these effects, which these data cannot separate: {BOTH}."
        )
        unknown = (UNKNOWN_IN_TIME, next(iter(UNKNOWN_LAWS.values())))
        text = self.missing(candidate(alike=unknown))
        assert text.startswith(f"Missing: {NAMED}, or {unknown[0]}, or {unknown[1]};")
        assert self.missing(candidate(alike=(*unknown, LAMINAR))).startswith("Missing: one of these effects")

    def test_the_remainder_the_noise_or_the_test_is_stated(self, monkeypatch):
        monkeypatch.setattr(module, "combined_uncertainties", lambda fit: {})
        assert self.missing(candidate(), Grade("approximate", 0.97, LEFT)).endswith(LEFT.sentence)
        most = (SimpleNamespace(level=5e-6, pure=4e-6), SimpleNamespace(level=3e-6, pure=1e-6))
        noisy = self.missing(candidate(), Grade(None, 1.0, None, noisy=True), Found(noise=most))
        assert "needs a random torque of 3 uN m rms, the recording shows 1 uN m" in noisy
        weak = SimpleNamespace(limit=0.5, bounds=(), bounds_p=1.0, is_strong=lambda _: False)
        assert "above 50 % of the torque of the law" in self.missing(
            candidate(), Grade(None, 1.0, None, test=weak)
        )
        assert "torque" not in self.missing(candidate(), Grade("exact", 1.0, None, test=weak))

    def test_phases_of_each_case_have_an_option(self, monkeypatch):
        monkeypatch.setattr(module, "combined_uncertainties", lambda fit: {})
        own = {f"{UNBALANCE}.{k}@{c}": estimate() for k in ("k", "phi") for c in ("a", "b")}
        text = self.missing(candidate(UNBALANCE, estimates=own))
        assert f"--per-case {UNBALANCE}.k --per-case {UNBALANCE}.phi" in text

    def test_errors_of_starts_have_an_rms(self):
        own = {f"camera.start.dt@{i}": estimate(x, 1e-3, "s") for i, x in enumerate((3e-3, -4e-3))}
        text = self.missing(candidate(effect=START, estimates=own))
        assert "of 3.5 ms rms" in text
        assert "cannot separate" not in text
        assert f"No effect is established; these data cannot separate them from: {NAMED}." in self.missing(
            candidate(effect=START, estimates=own, alike=(DRAG,))
        )

    @pytest.mark.parametrize(
        ("total", "text"),
        [(1.04e-9, "4.00e-08 +- 0.10e-08"), (2e-9, "(statistical part 1e-09 N m s2)")],
    )
    def test_a_strength_has_its_combined_uncertainty(self, monkeypatch, total, text):
        monkeypatch.setattr(module, "combined_uncertainties", lambda fit: {f"{DRAG}.k": total})
        c = candidate(estimates={f"{DRAG}.k": estimate(), f"{DRAG}.n": estimate()})
        found = module._strength(c, c.fit)
        assert found.startswith(", k = ")
        assert ("statistical" in found) is (total > 1.05e-9)
        assert found.count("+-") == 1

    @pytest.mark.parametrize(("total", "both"), [(1.04e-9, False), (1.06e-9, True), (1.4e-9, True)])
    def test_the_statistical_part_is_stated_from_five_percent(self, total, both):
        assert ("statistical part" in module._with_both(estimate(), total)) is both

    @pytest.mark.parametrize(
        ("limit", "bounds_p", "strong", "words"),
        [
            (0.5, 0.011, False, "only a deviation above 50 % of the torque of the law would be detected"),
            (0.5, 0.009, False, "the fit prefers a.k outside its bounds"),
            (0.5, 1e-4, False, "the fit prefers a.k outside its bounds"),
            (0.99, 1.0, False, "only a deviation above 99 % of the torque of the law"),
            (1.01, 1.0, False, "any law of similar size and shape would fit equally well"),
            (math.inf, 1.0, False, "the other parameters absorb every deviation"),
            (0.5, 1.0, True, ""),
        ],
    )
    def test_why_a_form_is_not_established(self, limit, bounds_p, strong, words):
        test = SimpleNamespace(
            limit=limit, bounds=("a.k",), bounds_p=bounds_p, is_strong=lambda criteria: strong
        )
        told = module._untested(test, DEFAULT)
        assert (words in told[0]) if words else (told == [])

    @pytest.mark.parametrize(
        ("name", "count", "p", "stated"),
        [
            (None, 1, 0.029, True),
            (None, 1, 0.031, False),
            (None, 3, 0.009, True),
            (None, 3, 0.011, False),  # the least of three
            (DRAG, 1, 0.029, True),
            (UNBALANCE, 1, 0.029, False),  # a torque of the angle looks like it
        ],
    )
    def test_a_significant_camera_effect_is_stated(self, name, count, p, stated):
        found = [Nuisance("camera.centre", "run", 2e-3, 1e-5, "rad", p)] * count
        chosen = None if name is None else candidate(name)
        assert bool(module._nuisance(chosen, found, DEFAULT)) is stated

    @pytest.mark.parametrize(("unit", "words"), [("rad", "2 mrad"), ("s", "2 ms"), ("s2", "2e+03 ms2")])
    def test_camera_effects_are_stated_in_thousandths(self, unit, words):
        found = [Nuisance("camera.centre", "run", 2e-3, 1e-5, unit, 1e-9)]
        assert words in module._nuisance(None, found, DEFAULT)[0]

    @pytest.mark.parametrize(
        ("effect", "film", "words"),
        [
            ("camera.centre", True, "Camera centre offset 2 mrad"),
            ("camera.centre", False, "Once-per-turn error of the angle 2 mrad"),
            ("camera.tilt", False, "Twice-per-turn error of the angle 2 mrad"),
            ("camera.shutter", False, "Once-per-turn variation of the delay of the angle 2 mrad"),
        ],
    )
    def test_a_camera_is_stated_only_for_films(self, effect, film, words):
        found = [Nuisance(effect, "run", 2e-3, 1e-5, "rad", 1e-9, film=film)]
        assert module._nuisance(None, found, DEFAULT) == [f"{words} (nuisance parameter, fitted)."]

    def test_active_bounds_that_are_not_physical_are_stated(self):
        layout = SimpleNamespace(index={"a.g": 0, "a.k": 1}, is_physical_bound=lambda name: name == "a.k")
        both = {
            "a.g": estimate(1.4, at_bound=True),
            "a.k": estimate(0.0, at_bound=True),
            "b.k": estimate(at_bound=True),
        }
        fit = Found(estimates=both, problem=SimpleNamespace(layout=layout))
        assert module._active_bounds(fit) == ["Active bound: a.g = 1.4; outside it, another law may act."]
        assert module._active_bounds(replace(fit, estimates={"a.k": both["a.k"]})) == []


def test_rivals_join_the_class_of_the_chosen_effect():
    chosen = candidate(alike=(LAMINAR,))
    found = module._with_rivals(
        selection(chosen, others=[candidate(LAMINAR)]), (UNKNOWN_IN_TIME, LAMINAR, DRAG)
    )
    assert found.chosen.indistinguishable_from == (LAMINAR, UNKNOWN_IN_TIME)
    assert found.candidates[0] is found.chosen
    assert [c.effect.name for c in module._class_of(found)] == [DRAG, LAMINAR]
    same = selection(chosen)
    assert module._with_rivals(same, ()) is same
    assert module._class_of(selection()) == []


@pytest.mark.parametrize(("same", "asked"), [(True, "as given"), (False, "chosen")])
def test_laws_outside_the_library_are_compared_with_the_effect_as_given(monkeypatch, same, asked):
    """With a free inertia its score is another one."""
    chosen = candidate(score=20.0)
    given = candidate(DRAG if same else LAMINAR, score=90.0)
    scores = []
    monkeypatch.setattr(
        module, "nonparametric_rivals", lambda fit, c, test, criteria: scores.append(c.score) or ()
    )
    module._with_unknown_laws(None, selection(chosen), given, COMPLETE, DEFAULT)
    assert scores == [90.0 if asked == "as given" else 20.0]
