"""Which candidates are refitted, ordered, added, dropped and kept: small cases on either side of each rule."""

import math
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import oscillators
import pytest

from fitting import (
    LIBRARY,
    Candidate,
    Criteria,
    Estimate,
    EstimationError,
    SimulationError,
    effect_name,
    improve,
)
from fitting._criteria import DEFAULT
from fitting.discovery import _select as module
from fitting.discovery._score import Score
from fitting.discovery._select import (
    Step,
    applicable_effects,
    best,
    equivalence_classes,
    found_starts,
    needed_drives,
    needed_evidence,
    needs_search,
    ordered,
    rank,
    ranked_at_noise,
    reason_undetermined,
    select,
    separate_values,
)
from fitting.effects._library import START
from fitting.effects._user import resolve

DRAG, LAMINAR, STEP = (LIBRARY[n] for n in ("casing.air.quadratic", "casing.air.laminar", "touchpoint.step"))
PERIODIC, SPRING = LIBRARY["casing.precession"], LIBRARY["casing.spring.linear"]


def estimate(value=1.0, stderr=0.1, unit="N m"):
    return Estimate(value, stderr, unit, at_bound=False)


@dataclass(frozen=True, eq=False)
class Model:
    effects: tuple = ()
    restoring: bool = False

    @property
    def names(self):
        return tuple(e.name for e in self.effects)

    def with_effect(self, effect):
        return replace(self, effects=(*self.effects, effect))

    def without(self, name):
        return replace(self, effects=tuple(e for e in self.effects if e.name != name))


def data(
    *,
    oscillation=None,
    parts=("casing", "rotor"),
    tracked=False,
    is_angle=True,
    measured_angle=None,
    inputs=(),
    constant=(),
):
    """A recording; `inputs` are units by name, of which the `constant` ones do not vary."""
    recorded = [SimpleNamespace(name=name, unit=unit) for name, unit in dict(inputs).items()]
    return SimpleNamespace(
        motion=oscillators.stub(oscillation),
        is_angle=is_angle,
        measured_angle=measured_angle,
        has_noise_of=lambda _: True,
        record=SimpleNamespace(
            parts=frozenset(parts),
            tracked=tracked,
            inputs=recorded,
            driving=[i for i in recorded if i.name not in constant],
        ),
    )


@dataclass(frozen=True, eq=False)
class Found:
    """A fit, as far as a decision depends on it."""

    @staticmethod
    def name(effect):
        return effect_name(getattr(effect, "name", effect))

    bic: float = 100.0
    deviance: float = 100.0
    model: Model = field(default_factory=Model)
    estimates: dict = field(default_factory=dict)
    noise: tuple = ()
    converged: bool = True
    wrong: bool = False
    problem: object = field(
        default_factory=lambda: SimpleNamespace(data=[data()], cases=[1], layout=SimpleNamespace(records=[1]))
    )
    values: dict = field(default_factory=dict)
    held_out_of_first_casing: float = 1.0
    criteria: Criteria = DEFAULT
    lacks_restoring_torque: bool = False

    def fails(self, criteria):
        assert isinstance(criteria, Criteria)
        return self.wrong


def score(
    effect=DRAG, value=50.0, *, columns=1, own_phase=False, absorbed=False, shape=({},), direction=(1.0, 0.0)
):
    return Score(
        effect, value, np.ones(columns), shape, columns, 1, absorbed=absorbed, direction=np.array(direction),
        null=np.zeros(3), own_phase=own_phase,
    )  # fmt: skip


def candidate(
    effect=DRAG, bic=-40.0, *, p=1e-3, fit="own", value=50.0, significant=None, alike=(), **options
):
    found = Found(100.0 + bic, 100.0 - value) if fit == "own" else fit
    return Candidate(
        effect, value, bic, p, 0.0, alike, {}, p < 0.03 if significant is None else significant,
        score(effect, value, **options), found,
    )  # fmt: skip


class TestCandidate:
    def test_physics_and_phases(self):
        assert candidate(DRAG).physical
        assert not candidate(LIBRARY["setup.inertia"]).physical
        own = {"casing.precession.k@a": estimate()}
        assert replace(candidate(PERIODIC), estimates=own).own_phase
        assert not replace(candidate(PERIODIC), estimates={"casing.precession.k": estimate()}).own_phase
        assert not replace(candidate(STEP), estimates={"touchpoint.step.k@a": estimate()}).own_phase

    def test_classes_have_letters_in_their_order(self):
        found = equivalence_classes(
            [
                candidate(DRAG, alike=("casing.air.laminar",)),
                candidate(STEP),
                candidate(LAMINAR, alike=("casing.air.quadratic",)),
                candidate(PERIODIC, alike=("casing.unbalance",)),
            ]
        )
        assert found == {
            "casing.air.quadratic": "A", "casing.air.laminar": "A",
            "casing.precession": "B", "casing.unbalance": "B",
        }  # fmt: skip


class TestApplicable:
    def names(self, *, bearing=True, extra=(), **options):
        effects = (LIBRARY["bearing.linear"],) if bearing else (DRAG,)
        base = Found(model=Model(effects), problem=SimpleNamespace(data=[data(**options)]))
        return {e.name for e in applicable_effects(base, extra)}

    def test_effects_of_the_model_and_of_every_fit_are_not_candidates(self):
        found = self.names()
        assert "bearing.linear" not in found
        assert "camera.centre" not in found
        assert {"casing.air.quadratic", "camera.clock", "bearing.heating", "rotor.air.linear"} <= found
        assert "rotor.support" not in found  # it is not searched

    def test_a_body_alone_has_no_laws_of_two_bodies(self):
        found = self.names(parts=["casing"])
        assert "casing.air.quadratic" in found
        assert not found & {"rotor.air.linear", "bearing.quadratic", "casing.windage"}

    def test_laws_of_reversals_need_an_oscillation(self):
        reversing = {"casing.spring.linear", "casing.gravity", "casing.friction.presliding"}
        assert not self.names() & reversing
        oscillation = SimpleNamespace(deflection=np.array([-0.6, 0.6]))
        assert reversing <= self.names(oscillation=oscillation)

    @pytest.mark.parametrize(("range_", "applies"), [(0.99, False), (1.01, True)])
    def test_a_harmonic_of_the_angle_needs_a_range_of_one_radian(self, range_, applies):
        oscillation = SimpleNamespace(deflection=np.array([-range_ / 2, range_ / 2]))
        assert ("casing.unbalance" in self.names(oscillation=oscillation)) is applies
        assert "casing.air.quadratic" in self.names(oscillation=oscillation)
        assert "casing.unbalance" in self.names()

    @pytest.mark.parametrize(("turns", "applies"), [(0.99, False), (1.01, True)])
    def test_a_harmonic_of_the_angle_needs_a_whole_turn(self, turns, applies):
        angle = np.array([0.0, 2 * np.pi * turns])
        assert ("casing.unbalance" in self.names(measured_angle=angle)) is applies
        assert "casing.air.quadratic" in self.names(measured_angle=angle)
        # of a user it is always tested
        own = replace(LIBRARY["casing.unbalance"], name="my.unbalance")
        assert "my.unbalance" in self.names(measured_angle=angle, extra=[own])

    def test_errors_of_a_camera_need_angles(self):
        assert "camera.clock" in self.names()
        assert "camera.clock" not in self.names(is_angle=False)

    def test_a_factor_of_the_bearing_needs_a_bearing(self):
        assert "bearing.drift" in self.names()
        assert "bearing.drift" not in self.names(bearing=False)

    def test_effects_of_the_user_are_candidates(self):
        own = replace(DRAG, name="my.drag")
        assert "my.drag" in self.names(extra=[own])


class TestInputs:
    """Laws of the inputs of recordings, and which of them a driven body needs."""

    VOLTAGE, CURRENT = {"voltage": "V"}, {"current": "A"}
    MOTOR = resolve("casing: c*voltage", VOLTAGE)

    def names(self, *cases, effects=(), extra=()):
        base = Found(model=Model(effects), problem=SimpleNamespace(data=list(cases)))
        return {e.name for e in applicable_effects(base, extra)}

    @pytest.mark.parametrize(
        ("first", "second", "tested"),
        [
            (VOLTAGE, VOLTAGE, {"voltage"}),
            (VOLTAGE | CURRENT, VOLTAGE, {"voltage"}),
            (VOLTAGE, CURRENT, set()),
            (VOLTAGE, {"voltage": "mV"}, set()),
        ],
    )
    def test_an_input_of_all_recordings_is_tested(self, first, second, tested):
        found = self.names(data(inputs=first), data(inputs=second))
        assert {n.rpartition(".")[2] for n in found if n.startswith("rotor.input.")} == tested

    @pytest.mark.parametrize(("constant", "tested"), [((), True), (("voltage",), False)])
    def test_an_input_that_never_varies_is_not_tested(self, constant, tested):
        assert ("casing.input.voltage" in self.names(data(inputs=self.VOLTAGE, constant=constant))) is tested

    @pytest.mark.parametrize(
        ("law", "tested"),
        [
            ("casing: c*voltage", {"rotor", "bearing"}),
            ("rotor: c*voltage", {"casing", "bearing"}),
            ("casing: c*voltage**2", {"casing", "rotor", "bearing"}),
            ("casing: c*current", {"casing", "rotor", "bearing"}),
        ],
    )
    def test_a_law_of_the_model_under_another_name_is_not_tested_again(self, law, tested):
        both = self.VOLTAGE | self.CURRENT
        found = self.names(data(inputs=both), effects=(resolve(law, both),))
        assert {n.partition(".")[0] for n in found if n.endswith(".input.voltage")} == tested

    def test_a_law_of_another_unit_is_another_law(self):
        other = replace(self.MOTOR, inputs=(("voltage", "mV"),))
        assert not module._same_law(self.MOTOR, other)
        assert module._same_law(self.MOTOR, LIBRARY_OF_INPUTS["casing.input.voltage"])

    def test_a_dead_time_needs_a_law_of_its_input(self):
        recording = data(inputs=self.VOLTAGE | self.CURRENT)
        found = self.names(recording, effects=(self.MOTOR,))
        assert {n for n in found if n.endswith(".delay")} == {"input.voltage.delay"}
        assert not {n for n in self.names(recording) if n.endswith(".delay")}

    @pytest.mark.parametrize(
        ("effects", "constant", "tested"),
        [
            ((), (), True),
            (("motor",), (), False),
            (("motor",), ("voltage",), True),
            (("motor", "input.voltage.delay"), (), True),
        ],
    )
    def test_a_torque_that_sets_in_is_tested_after_the_dead_time(self, effects, constant, tested):
        known = LIBRARY_OF_INPUTS | {"motor": self.MOTOR}
        recording = data(inputs=self.VOLTAGE, constant=constant)
        found = self.names(recording, effects=tuple(known[n] for n in effects))
        assert (STEP.name in found) is tested

    def test_an_effect_that_is_not_searched_is_tested_on_request(self):
        support = LIBRARY["rotor.support"]
        assert support.name not in self.names(data())
        assert support.name in self.names(data(), extra=[support])

    @pytest.mark.parametrize(
        ("errors", "needed"),
        [
            ({"casing": 0.98, "rotor": 1.02, "bearing": 3.0}, {"casing"}),
            ({"casing": 1.5, "rotor": 1.02, "bearing": None}, set()),
            ({"casing": 0.11, "rotor": 0.9, "bearing": 1.9}, {"casing", "rotor"}),
        ],
    )
    def test_an_input_that_halves_the_residual_speed_drives_the_body(self, monkeypatch, errors, needed):
        fitted = []

        def from_scratch(base, effect):
            fitted.append(effect.name)
            error = errors[effect.joint]
            return None if error is None else SimpleNamespace(rmse_casing=error)

        monkeypatch.setattr(module, "fit_from_scratch", from_scratch)
        base = Found()
        object.__setattr__(base, "rmse_casing", 2.0)
        found = needed_drives(base, [DRAG, *LIBRARY_OF_INPUTS.values()])
        assert found == {f"{joint}.input.voltage" for joint in needed}
        # a dead time alone is no torque
        assert sorted(fitted) == [f"{joint}.input.voltage" for joint in ("bearing", "casing", "rotor")]
        driven = Found(model=Model((self.MOTOR,)))
        assert needed_drives(driven, list(LIBRARY_OF_INPUTS.values())) == set()


LIBRARY_OF_INPUTS = {
    n: resolve(n, {"voltage": "V"})
    for n in ("rotor.input.voltage", "casing.input.voltage", "bearing.input.voltage", "input.voltage.delay")
}


class TestToRefit:
    """Which candidates are refitted: four in any case, promising ones up to fourteen, and faults."""

    def refitted(self, *candidates):
        return module._to_refit(candidates, DEFAULT)

    def test_promising_ones_are_refitted_up_to_a_limit(self):
        count = DEFAULT.refit_most
        assert self.refitted(*[candidate() for _ in range(count + 3)]) == [True] * count + [False] * 3

    @pytest.mark.parametrize(
        ("value", "p", "chosen"),
        [
            (11.0, 0.49, True),
            (11.0, 0.51, False),
            (9.0, 0.01, False),  # less than a tenth of the best score
        ],
    )
    def test_a_promising_one_has_a_small_p_value_and_a_large_score(self, value, p, chosen):
        first = [candidate(value=100.0) for _ in range(DEFAULT.refit_least)]
        assert self.refitted(*first, candidate(value=value, p=p)) == [True] * 4 + [chosen]

    @pytest.mark.parametrize(("p", "chosen"), [(0.01, True), (0.9, False)])
    def test_faults_of_the_measurement_are_refitted_if_anything_is_significant(self, p, chosen):
        first = [candidate(p=p) for _ in range(DEFAULT.refit_least)]
        fault = candidate(LIBRARY["setup.inertia"], value=0.1, p=1.0)
        assert self.refitted(*first, fault, candidate(value=0.1, p=1.0)) == [True] * 4 + [chosen, False]

    def test_absorbed_ones_are_neither_refitted_nor_counted(self):
        lost = [candidate(value=1e6, absorbed=True)] * 3
        assert self.refitted(*lost, *[candidate(p=0.9)] * 5) == [False] * 3 + [True] * 4 + [False]
        # nor is their score that of the best
        assert self.refitted(*lost, *[candidate(value=100.0)] * 4, candidate(value=11.0))[-1]


class TestRank:
    """The ranking of three candidates with given scores; p is 10 / score."""

    def ranked(self, monkeypatch, base, scores, **options):
        refits, self.afresh = {}, {}
        if "mislead" in options:
            monkeypatch.setattr(module, "scores_mislead", lambda base, criteria: options["mislead"])

        class Null:
            weights = np.ones(1)

            def __init__(self, scored):
                self.scored = scored

            def __call__(self, value):
                return np.array([10.0 / max(value, 1e-9)])

        def refit(base, promising):
            refits[promising.candidate.effect.name] = promising.thorough
            self.afresh[promising.candidate.effect.name] = promising.afresh
            return promising.candidate

        monkeypatch.setattr(module, "applicable_effects", lambda *_: list(scores))
        monkeypatch.setattr(module, "CaseColumns", lambda *_: None)
        monkeypatch.setattr(
            module, "score", lambda base, effects, cases, criteria: [score(e, scores[e]) for e in effects]
        )
        monkeypatch.setattr(module, "NullDistribution", Null)
        monkeypatch.setattr(
            module, "FamilywiseNull", lambda nulls: lambda p, weights: min(float(p @ weights), 1.0)
        )
        monkeypatch.setattr(module, "_refit_candidate", refit)
        monkeypatch.setattr(module, "starts_are_unknown", lambda data: options.get("unknown", False))
        monkeypatch.setattr(
            module,
            "_start_candidate",
            lambda base, family, criteria: candidate(START, -5.0, significant=False),
        )
        found = rank(base, refitting=options.get("refitting", True))
        return found, refits

    def test_poor_refits_are_repeated_for_rivals_of_the_best(self, monkeypatch):
        half = 1000.0 * DEFAULT.rival_share
        found, refits = self.ranked(monkeypatch, Found(), {DRAG: half + 1, LAMINAR: 1000.0, STEP: half - 1})
        assert refits == {"casing.air.laminar": True, "casing.air.quadratic": True, "touchpoint.step": False}
        assert [c.effect.name for c in found] == [
            "casing.air.laminar",
            "casing.air.quadratic",
            "touchpoint.step",
        ]
        assert [c.p_value for c in found] == pytest.approx([0.01, 10 / (half + 1), 10 / (half - 1)])
        assert all(c.significant for c in found)

    @pytest.mark.parametrize("mislead", [True, False])
    def test_laws_with_small_scores_are_fitted_from_scratch_if_scores_mislead(self, monkeypatch, mislead):
        """One law leads, five are refitted in any case; the others have small scores."""
        names = [n for n, e in LIBRARY.items() if e.mechanical and not e.depends_on_angle and not e.inputs][
            :9
        ]
        scores = {LIBRARY[n]: 1e6 if i == 0 else 1.0 / (1 + i) for i, n in enumerate(names)}
        scores |= {LIBRARY["casing.unbalance"]: 0.01, LIBRARY["camera.clock"]: 0.01}
        _, refits = self.ranked(monkeypatch, Found(), scores, mislead=mislead)
        small = [n for n in names if n not in {k for k, v in self.afresh.items() if not v}]
        assert small == names[DEFAULT.refit_least :]
        assert {k for k, v in self.afresh.items() if v} == (set(small) if mislead else set())
        assert ("casing.unbalance" in refits) is False
        assert {k for k, v in self.afresh.items() if not v} == set(names[: DEFAULT.refit_least]) | (
            {"camera.clock"} & set(refits)
        )

    @pytest.mark.parametrize("far", [True, False])
    def test_far_from_the_motion_the_equations_of_motion_choose(self, monkeypatch, far):
        """The scores would choose other laws."""
        names = [f"law{i}" for i in range(DEFAULT.refit_most + 2)]
        asked = []

        def nearest(base, effects, criteria):
            asked.extend(e.name for e in effects)
            return ["bearing.power", *names]

        monkeypatch.setattr(module, "is_far_from_the_motion", lambda base, criteria: far)
        monkeypatch.setattr(module, "_nearest", nearest)
        others = ("casing.air.linear", "casing.air.quadratic", "touchpoint.constant", "camera.clock")
        scores = {LIBRARY[n]: 1e6 for n in others} | {LIBRARY["bearing.power"]: 0.0}
        scores |= {
            replace(DRAG, name=names[i]): 0.0 for i in (0, DEFAULT.refit_most - 2, DEFAULT.refit_most - 1)
        }
        self.ranked(monkeypatch, Found(), scores)
        if far:
            assert self.afresh == {"bearing.power": True, "law0": True, names[DEFAULT.refit_most - 2]: True}
            assert "camera.clock" not in asked
            assert {"bearing.power", "casing.air.linear"} <= {*asked}
        else:
            assert asked == []
            assert {*others} <= {*self.afresh}
            assert not any(self.afresh.values())

    @pytest.mark.parametrize("share", [0.99, 1.01])
    def test_the_nearest_laws_have_three_times_the_least_error_of_the_equations(self, monkeypatch, share):
        errors = {DRAG.name: 0.2 * DEFAULT.equation_error * share, LAMINAR.name: 0.2, STEP.name: 5.0}
        monkeypatch.setattr(module, "equation_error", lambda model, data: errors[model.names[-1]])
        found = module._nearest(Found(), (DRAG, STEP, LAMINAR), DEFAULT)
        assert found == ([LAMINAR.name, DRAG.name] if share < 1 else [LAMINAR.name])

    def test_a_rival_with_more_process_noise_is_searched_again(self, monkeypatch):
        rival, asked = candidate(LAMINAR, -60.0), []

        def again(base, promising):
            asked.append(promising.candidate.effect)
            return replace(rival, delta_bic=-99.0)

        monkeypatch.setattr(module, "_noisier_rivals", lambda found, criteria: [rival])
        monkeypatch.setattr(module, "_at_lowest_noise", again)
        found, _ = self.ranked(monkeypatch, Found(), {DRAG: 900.0, LAMINAR: 1000.0})
        assert asked == [LAMINAR]
        assert next(c for c in found if c.effect is LAMINAR).delta_bic == -99.0

    def test_of_a_driven_body_the_needed_laws_alone_are_ranked(self, monkeypatch):
        monkeypatch.setattr(module, "needed_drives", lambda base, effects: {STEP.name})
        found, refits = self.ranked(monkeypatch, Found(), {DRAG: 1000.0, LAMINAR: 500.0, STEP: 0.1})
        assert [c.effect.name for c in found] == [STEP.name]
        assert set(refits) == {STEP.name}

    @pytest.mark.parametrize(("value", "significant"), [(334.0, True), (333.0, False)])
    def test_a_probability_of_three_percent_is_significant(self, monkeypatch, value, significant):
        (found,), _ = self.ranked(monkeypatch, Found(), {DRAG: value})
        assert found.significant is significant

    def test_without_refits(self, monkeypatch):
        found, refits = self.ranked(
            monkeypatch, Found(), {DRAG: 500.0, LAMINAR: 1000.0}, refitting=False, unknown=True
        )
        assert refits == {}
        assert [c.effect.name for c in found] == ["casing.air.laminar", "casing.air.quadratic"]

    @pytest.mark.parametrize("unknown", [True, False])
    def test_starts_about_which_nothing_is_stated_are_a_candidate(self, monkeypatch, unknown):
        found, _ = self.ranked(monkeypatch, Found(), {DRAG: 500.0}, unknown=unknown)
        assert (START in [c.effect for c in found]) is unknown

    @pytest.mark.parametrize(
        ("scores", "reversals", "refitted"),
        [
            (
                {DRAG: 1000.0, LAMINAR: 101.0, STEP: 500.0},
                10,
                ["casing.air.quadratic", "touchpoint.step", "casing.air.laminar"],
            ),
            ({DRAG: 1000.0, LAMINAR: 101.0, STEP: 99.0}, 10, ["casing.air.quadratic", "casing.air.laminar"]),
            ({DRAG: 200.0, LAMINAR: 99.0, STEP: 20.0}, 10, ["casing.air.quadratic"]),  # p is below 0.1
            (
                {DRAG: 1000.0, LAMINAR: 600.0, STEP: 500.0},
                240,
                ["casing.air.quadratic", "casing.air.laminar"],
            ),
            ({DRAG: 5000.0, LAMINAR: 501.0, STEP: 499.0}, 10, ["casing.air.quadratic", "casing.air.laminar"]),
            (
                {DRAG: 1000.0, LAMINAR: 600.0, STEP: 500.0},
                None,
                ["casing.air.quadratic", "casing.air.laminar", "touchpoint.step"],
            ),
        ],
    )
    def test_through_many_reversals_few_candidates_are_refitted(
        self, monkeypatch, scores, reversals, refitted
    ):
        oscillation = None if reversals is None else SimpleNamespace(reversals=np.zeros(reversals))
        base = Found(
            model=Model(restoring=True),
            problem=SimpleNamespace(data=[data(oscillation=oscillation)], cases=[1]),
        )
        _, refits = self.ranked(monkeypatch, base, scores)
        assert set(refits) == set(refitted)

    def test_a_body_that_oscillates_needs_a_restoring_torque(self, monkeypatch):
        base = Found(lacks_restoring_torque=True)
        cubic, gravity = LIBRARY["casing.spring.cubic"], LIBRARY["casing.gravity"]
        monkeypatch.setattr(module, "possible_restoring", lambda *_: {"casing.gravity"})
        found, refits = self.ranked(monkeypatch, base, {DRAG: 2000.0, SPRING: 1000.0, gravity: 600.0})
        assert refits == {"casing.gravity": True}
        by_name = {c.effect.name: c for c in found}
        assert set(by_name) == {"casing.spring.linear", "casing.gravity"}
        assert by_name["casing.gravity"].significant
        other = by_name["casing.spring.linear"]
        assert (other.score, other.p_value, other.significant) == (0.0, 1.0, False)
        # without averaged equations the error of the equations decides, up to three times the least
        monkeypatch.setattr(module, "possible_restoring", lambda *_: None)
        errors = {SPRING.name: 0.1, cubic.name: 0.29, gravity.name: 0.31}
        monkeypatch.setattr(module, "equation_error", lambda model, data: errors[model.names[-1]])
        _, refits = self.ranked(monkeypatch, base, {SPRING: 1000.0, cubic: 500.0, gravity: 600.0})
        assert set(refits) == {"casing.spring.linear", "casing.spring.cubic"}

    @pytest.mark.parametrize(("p", "refitted"), [(0.02, True), (0.04, False)])
    def test_errors_of_starts_as_a_candidate(self, monkeypatch, p, refitted):
        starts = SimpleNamespace(
            p_value=p, fall=12.0, evidence=9.0, estimates={"camera.start.dt": estimate()}, score=score(START, 12.0),
            refit=lambda: ("refitted", SimpleNamespace(estimates={"camera.start.dt": estimate(2.0)})),
            evidence_of={"refitted": 14.0}.get,
        )  # fmt: skip
        monkeypatch.setattr(module, "StartErrors", lambda base, criteria: starts)
        found = module._start_candidate(None, lambda p, weights: float(p @ weights), DEFAULT)
        assert (found.effect, found.score, found.p_value) == (START, 12.0, p)
        assert found.delta_bic == (-14.0 if refitted else -9.0)
        assert (found.estimates["camera.start.dt"].value == 2.0) is refitted
        assert (found.fit, found.significant) == ("refitted" if refitted else None, refitted)
        starts.fall = -3.0
        found = module._start_candidate(None, lambda p, weights: float(p @ weights), DEFAULT)
        assert found.score == 0.0


class Null:
    """Null data whose p-value is exp(-score / 10); one with fewer strengths is half of that."""

    weights = np.ones(1)

    def __call__(self, value):
        return np.array([math.exp(-max(value, 0.0) / 10)])

    def of(self, value, columns):
        assert columns == 1
        return 0.5 * self(value)


class TestRefitted:
    """The candidate after its refit; the base has a BIC and a deviance of 100."""

    def refitted(self, monkeypatch, found, *, common=None, at_noise=100.0, effect=DRAG, **options):
        monkeypatch.setattr(module, "refit", lambda base, scored, criteria, *, thorough: found(scored))
        monkeypatch.setattr(module, "with_common_values", lambda *_: common)
        monkeypatch.setattr(module, "deviance_at_noise_of", lambda base, other: at_noise)
        screened = candidate(effect, fit=None, **options)
        family = lambda p, weights: float(p @ weights)  # noqa: E731 - a single candidate
        problem = SimpleNamespace(layout=SimpleNamespace(records=[1, 2]))
        base = Found(problem=problem, held_out_of_first_casing=4.0)
        return screened, module._refit_candidate(
            base, module._Promising(screened, Null(), family, DEFAULT, True)
        )

    def test_score_evidence_and_prediction_are_falls(self, monkeypatch):
        own = {f"{DRAG.name}.k": estimate(), "other.k": estimate()}
        found = Found(70.0, 60.0, estimates=own, held_out_of_first_casing=1.5)
        _, c = self.refitted(monkeypatch, lambda _: found)
        assert (c.score, c.delta_bic, c.held_out_gain, c.fit) == (40.0, -30.0, 2.5, found)
        assert c.p_value == pytest.approx(math.exp(-4.0))
        assert c.significant
        assert set(c.estimates) == {f"{DRAG.name}.k"}

    @pytest.mark.parametrize(("deviance", "significant"), [(64.0, True), (66.0, False)])
    def test_significance_is_that_of_the_refit(self, monkeypatch, deviance, significant):
        """exp(-3.5) = 0.03."""
        _, c = self.refitted(monkeypatch, lambda _: Found(70.0, deviance))
        assert c.significant is significant

    def test_without_a_refit_the_score_remains(self, monkeypatch):
        screened, c = self.refitted(monkeypatch, lambda _: None)
        assert c is screened

    @pytest.mark.parametrize(("common", "taken"), [(69.0, "common"), (71.0, "own")])
    def test_a_common_phase_is_taken_where_its_evidence_is_larger(self, monkeypatch, common, taken):
        fits = {True: Found(70.0, 60.0), False: Found(common, 65.0)}
        _, c = self.refitted(
            monkeypatch, lambda s: fits[s.own_phase], effect=PERIODIC, own_phase=True, columns=4
        )
        assert c.fit is fits[taken == "own"]

    def test_common_values_of_all_cases_count_one_parameter(self, monkeypatch):
        found, common = Found(70.0, 60.0), Found(68.0, 61.0)
        _, c = self.refitted(monkeypatch, lambda _: found, common=common, columns=2)
        assert (c.fit, c.score, c.delta_bic) == (found, 40.0, -32.0)
        # twice the p-value of a fall of 39 with half the strengths, or that of a fall of 40
        assert c.p_value == pytest.approx(math.exp(-4.0))
        _, c = self.refitted(monkeypatch, lambda _: found, common=Found(75.0, 61.0), columns=2)
        assert c.delta_bic == -30.0

    def test_a_probability_is_at_most_one(self, monkeypatch):
        _, c = self.refitted(
            monkeypatch, lambda _: Found(99.5, 99.0), common=Found(99.6, 99.1), columns=2, at_noise=None
        )
        # that of its own fall of 1, as twice the one of the common fall of 0.9 is larger
        assert c.p_value == pytest.approx(math.exp(-0.1))

    def test_a_fit_with_values_per_case_that_is_worse_than_a_common_one_is_repeated(self, monkeypatch):
        again = Found(55.0, 40.0)
        monkeypatch.setattr(module, "with_values_per_case", lambda base, screened, found, common: again)
        _, c = self.refitted(monkeypatch, lambda _: Found(70.0, 60.0), common=Found(68.0, 50.0), columns=2)
        assert (c.fit, c.score, c.delta_bic) == (again, 60.0, -45.0)
        assert c.p_value == pytest.approx(math.exp(-6.0))

    def test_the_improvement_of_the_noise_is_not_that_of_the_effect(self, monkeypatch):
        _, c = self.refitted(monkeypatch, lambda _: Found(50.0, 40.0), at_noise=85.0)
        assert (c.score, c.delta_bic) == (45.0, -35.0)
        assert c.p_value == pytest.approx(math.exp(-4.5))
        # of an insignificant effect it is not asked for
        _, c = self.refitted(monkeypatch, lambda _: Found(95.0, 90.0), at_noise=5.0)
        assert c.score == 10.0


class TestNoisierRivals:
    """The leader has a score of 100 and a noise level of 1."""

    @pytest.mark.parametrize(
        ("value", "level", "significant", "noisier"),
        [
            (100 * DEFAULT.rival_share + 1, 1.01 / DEFAULT.quieter, True, True),
            (100 * DEFAULT.rival_share - 1, 1.01 / DEFAULT.quieter, True, False),
            (100 * DEFAULT.rival_share + 1, 0.99 / DEFAULT.quieter, True, False),
            (100 * DEFAULT.rival_share + 1, 1.01 / DEFAULT.quieter, False, False),
        ],
    )
    def test_a_rival_of_similar_score_with_more_noise(self, value, level, significant, noisier):
        leader, rival = (Found(noise=(SimpleNamespace(level=x),)) for x in (1.0, level))
        first = candidate(DRAG, -80.0, value=100.0, fit=leader)
        second = candidate(LAMINAR, -40.0, value=value, fit=rival, significant=significant)
        unknown = candidate(STEP, -90.0, value=200.0, fit=None)
        assert module._noisier_rivals([second, unknown, first], DEFAULT) == ([second] if noisier else [])

    def test_without_a_significant_refit_there_is_no_leader(self):
        assert module._noisier_rivals([candidate(fit=None), candidate(significant=False)], DEFAULT) == []

    @pytest.mark.parametrize("better", [True, False])
    def test_the_better_refit_counts(self, monkeypatch, better):
        problem = SimpleNamespace(layout=SimpleNamespace(records=[1, 2]))
        base, before, quiet = Found(problem=problem), Found(80.0, 70.0), Found(50.0, 40.0)
        monkeypatch.setattr(module, "at_lowest_noise", lambda found, criteria: quiet if better else found)
        monkeypatch.setattr(module, "with_common_values", lambda *_: None)
        monkeypatch.setattr(module, "deviance_at_noise_of", lambda base, other: 100.0)
        known = candidate(fit=before, bic=-20.0, value=30.0)
        family = lambda p, weights: float(p @ weights)  # noqa: E731 - a single candidate
        found = module._at_lowest_noise(base, module._Promising(known, Null(), family, DEFAULT))
        assert (found is known) is not better
        assert (found.score, found.delta_bic) == ((60.0, -50.0) if better else (30.0, -20.0))


class TestOrder:
    @pytest.mark.parametrize(("behind", "first"), [(0.01, "touchpoint.constant"), (0.2, "external.constant")])
    def test_of_equal_laws_the_first_in_the_library_leads(self, behind, first):
        friction, torque = LIBRARY["touchpoint.constant"], LIBRARY["external.constant"]
        found = [candidate(torque, -40.02), candidate(friction, -40.02 + behind)]
        assert ordered(found, DEFAULT)[0].effect.name == first
        assert ordered(found[::-1], DEFAULT)[0].effect.name == first

    def names(self, *candidates):
        return [c.effect.name for c in ordered(candidates, DEFAULT)]

    def test_significant_ones_are_first_then_by_evidence(self):
        a, b, c = candidate(DRAG, -20.0), candidate(LAMINAR, -30.0), candidate(STEP, -90.0, significant=False)
        assert self.names(a, b, c) == ["casing.air.laminar", "casing.air.quadratic", "touchpoint.step"]

    @pytest.mark.parametrize(("value", "first"), [(59.0, "refitted"), (61.0, "scored")])
    def test_without_a_refit_each_strength_and_shape_costs_the_width(self, value, first):
        """A step has a strength and a time: 2 x 10."""
        refitted = candidate(DRAG, -40.0)
        scored = candidate(STEP, math.nan, value=value, fit=None, shape=({"t0": 1.0},))
        assert self.names(refitted, scored)[0] == (DRAG.name if first == "refitted" else STEP.name)

    @pytest.mark.parametrize(
        ("start_bic", "significant", "refitted", "first"),
        [
            (-35.0, True, True, True),  # within ten of the best
            (-25.0, True, True, False),
            (-35.0, False, True, False),
            (-35.0, True, False, False),
        ],
    )
    def test_errors_of_starts_are_excluded_first(self, start_bic, significant, refitted, first):
        starts = candidate(START, start_bic, significant=significant, fit="own" if refitted else None)
        assert (self.names(candidate(DRAG, -40.0), starts)[0] == START.name) is first

    @pytest.mark.parametrize(("bic", "first"), [(-43.1, DRAG.name), (-43.3, "setup.inertia")])
    def test_a_fault_of_the_measurement_needs_more_evidence_than_physics(self, bic, first):
        assert self.names(candidate(LIBRARY["setup.inertia"], bic), candidate(DRAG, -40.0))[0] == first

    def alike(self, *pair):
        first, second = ordered(pair, DEFAULT)
        assert bool(first.indistinguishable_from) is bool(second.indistinguishable_from)
        return bool(first.indistinguishable_from)

    @pytest.mark.parametrize(
        ("direction", "alike"),
        [
            ((1.0, 0.0), True),
            ((-1.0, 0.0), True),  # of the other sign
            ((math.cos(0.0140), math.sin(0.0140)), True),
            ((math.cos(0.0142), math.sin(0.0142)), False),
            ((0.0, 1.0), False),
        ],
    )
    @pytest.mark.parametrize("fit", ["own", None])
    def test_without_a_refit_the_directions_decide(self, direction, alike, fit):
        scored = candidate(LAMINAR, math.nan, value=1.0, fit=None, direction=direction)
        assert self.alike(candidate(DRAG, fit=fit), scored) is alike

    @pytest.mark.parametrize(
        ("bic", "value", "alike"),
        [(-49.0, 90.0, True), (-90.0, 59.0, True), (-51.0, 61.0, False), (-29.0, 39.0, False)],
    )
    def test_with_refits_evidence_or_score_within_ten_is_alike(self, bic, value, alike):
        direction = (0.0, 1.0)
        other = candidate(LAMINAR, bic, value=value, direction=direction)
        assert self.alike(candidate(DRAG, -40.0, value=50.0), other) is alike
        weak = replace(other, significant=False)
        assert not self.alike(candidate(DRAG, -40.0, value=50.0), weak)

    def test_absorbed_candidates_are_alike_to_none(self):
        pair = [candidate(DRAG), candidate(LAMINAR, absorbed=True)]
        assert not any(c.indistinguishable_from for c in ordered(pair, DEFAULT))


class TestBest:
    @pytest.mark.parametrize(("margin", "found"), [(0.1, True), (-0.1, False)])
    def test_evidence_is_needed(self, margin, found):
        assert (best([candidate(bic=-DEFAULT.evidence - margin)]) is not None) is found

    @pytest.mark.parametrize(
        ("value", "stderr", "converged", "determined"),
        [
            (3.01, 1.0, True, True),
            (-3.01, 1.0, True, True),
            (2.99, 1.0, True, False),
            (9.0, 1.0, False, False),
            (0.0, math.inf, True, True),
        ],
    )
    def test_a_strength_is_determined_from_three_standard_uncertainties(
        self, value, stderr, converged, determined
    ):
        fit = Found(
            converged=converged,
            estimates={f"{DRAG.name}.k@a": estimate(value, stderr), f"{DRAG.name}.w": estimate(0.0, 1.0)},
        )
        assert (reason_undetermined(DRAG, fit, DEFAULT) == "") is determined

    @pytest.mark.parametrize(
        ("alike", "second", "found"),
        [
            ((LAMINAR.name,), 4.0, LAMINAR),
            ((LAMINAR.name,), 2.0, DRAG),  # neither is determined
            ((), 4.0, DRAG),
            ((STEP.name,), 4.0, DRAG),
        ],
    )
    def test_a_determined_one_of_the_class_is_preferred(self, alike, second, found):
        fits = [
            Found(estimates={f"{e.name}.k": estimate(sigma, 1.0)})
            for e, sigma in ((DRAG, 2.0), (LAMINAR, second))
        ]
        ranked = [candidate(DRAG, fit=fits[0], alike=alike), candidate(LAMINAR, fit=fits[1])]
        assert best(ranked).effect is found

    @pytest.mark.parametrize(
        ("effect", "tracked", "more"),
        [
            (PERIODIC, (True,), True),
            (PERIODIC, (False, True), True),
            (PERIODIC, (False,), False),
            (DRAG, (True,), False),
            (LIBRARY["camera.centre"], (True,), False),
        ],
    )
    def test_on_film_a_periodic_law_needs_more_evidence(self, effect, tracked, more):
        fit = Found(problem=SimpleNamespace(data=[data(tracked=t) for t in tracked]))
        assert LIBRARY["camera.centre"].periodic
        needed = DEFAULT.evidence_periodic if more else DEFAULT.evidence
        assert needed_evidence(effect, fit, DEFAULT) == needed


class TestAtNoise:
    def refitted(self, monkeypatch, bics):
        def again(found, noise):
            assert noise == "lower"
            value = bics[found.label]
            if value is None:
                raise SimulationError("it diverges", "")
            return Found(value, value - 10.0, estimates={f"{DRAG.name}.k": estimate()})

        monkeypatch.setattr(module, "refitted_at", again)
        made = []
        for effect, alike in ((DRAG, ("casing.air.laminar",)), (LAMINAR, ()), (STEP, ())):
            c = candidate(effect, alike=alike)
            object.__setattr__(c.fit, "label", effect.name)
            made.append(c)
        base = Found()
        object.__setattr__(base, "label", "base")
        return made, ranked_at_noise(base, made, made[0], "lower", DEFAULT)

    def test_a_class_is_compared_at_one_noise(self, monkeypatch):
        _, found = self.refitted(
            monkeypatch, {"base": 80.0, DRAG.name: 50.0, LAMINAR.name: 30.0, STEP.name: 0.0}
        )
        by_name = {c.effect.name: c for c in found}
        assert (by_name[DRAG.name].delta_bic, by_name[DRAG.name].score) == (-30.0, 30.0)
        assert (by_name[LAMINAR.name].delta_bic, by_name[LAMINAR.name].score) == (-50.0, 50.0)
        assert by_name[STEP.name].delta_bic == -40.0  # not a member
        assert [c.effect.name for c in found] == [LAMINAR.name, STEP.name, DRAG.name]
        assert set(by_name[DRAG.name].estimates) == {f"{DRAG.name}.k"}

    def test_a_member_that_diverges_has_no_fit(self, monkeypatch):
        _, found = self.refitted(monkeypatch, {"base": 80.0, DRAG.name: 50.0, LAMINAR.name: None})
        (lost,) = (c for c in found if c.effect is LAMINAR)
        assert lost.fit is None
        assert math.isnan(lost.delta_bic)

    def test_without_the_base_nothing_changes(self, monkeypatch):
        made, found = self.refitted(monkeypatch, {"base": None})
        assert found == made


class TestSelect:
    """What is refined, compared at lower noise, and completed by `improve`."""

    def selected(
        self,
        monkeypatch,
        *,
        quieter=False,
        wrong=False,
        alike=(),
        at_noise=None,
        improved=(),
        follow_up=False,
        general=None,
        known=(),
        first=None,
        restoring=False,
        noise=(),
    ):
        calls = []
        chosen = candidate(DRAG, alike=alike) if first is None else first
        end = Found(50.0, 40.0, model=Model((DRAG,), restoring=restoring), wrong=wrong, noise=noise)
        monkeypatch.setattr(module, "refined", lambda found, criteria: end)
        monkeypatch.setattr(module, "has_less_process_noise", lambda *_: quieter)

        def ranked(base, candidates, chosen, noise, criteria):
            calls.append("ranked")
            return list(at_noise if at_noise is not None else candidates)

        def improve(base, extra, **options):
            calls.append(("improve", options["max_steps"], [c.effect.name for c in options["first"]]))
            return list(improved)

        monkeypatch.setattr(module, "ranked_at_noise", ranked)
        monkeypatch.setattr(module, "improve", improve)
        monkeypatch.setattr(module, "with_free_shape", lambda found, effect, criteria: general)
        monkeypatch.setattr(module, "restarted_from", lambda named, end: calls.append("restarted") or named)
        other = candidate(LAMINAR, -39.0)
        found = select(Found(), [chosen, other], (), DEFAULT, None, known, follow_up=follow_up)
        return calls, end, found

    def test_without_a_candidate_the_base_remains(self, monkeypatch):
        _, _, found = self.selected(monkeypatch, first=candidate(DRAG, significant=False))
        assert found.chosen.effect is LAMINAR
        none = select(base := Found(), [candidate(significant=False)], (), DEFAULT, None)
        assert (none.chosen, none.named, none.final) == (None, base, base)

    def test_one_effect_that_suffices(self, monkeypatch):
        calls, end, found = self.selected(monkeypatch)
        assert calls == []
        assert (found.named, found.final, found.chosen.effect) == (end, end, DRAG)

    def test_errors_of_starts_are_not_refined(self, monkeypatch):
        starts = candidate(START, -90.0)
        calls, _, found = self.selected(monkeypatch, first=starts)
        assert (found.chosen, found.named, found.final) == (starts, starts.fit, starts.fit)
        assert calls == []

    def test_a_free_shape_is_the_final_fit(self, monkeypatch):
        general = Found(20.0)
        calls, end, found = self.selected(monkeypatch, general=general)
        assert (found.named, found.final) == (end, general)
        assert calls == ["restarted"]
        calls, _, _ = self.selected(monkeypatch, general=general, restoring=True)
        assert calls == []

    def test_a_second_effect_is_added_where_one_does_not_suffice(self, monkeypatch):
        steps = [Step("", Found(), ()), Step("+a", Found(40.0), ()), Step("+b", Found(10.0), ())]
        calls, _, found = self.selected(monkeypatch, wrong=True, improved=steps)
        assert calls[0] == ("improve", 1 + DEFAULT.follow_up, [DRAG.name, LAMINAR.name])
        assert (found.named, found.final) == (steps[1].fit, steps[2].fit)
        calls, end, found = self.selected(monkeypatch, wrong=True, improved=steps[:1])
        assert (found.named, found.final) == (end, end)
        # or where the caller asks for it
        _, _, found = self.selected(monkeypatch, improved=steps, follow_up=True)
        assert (found.named, found.final) == (steps[1].fit, steps[2].fit)

    @pytest.mark.parametrize(
        ("left", "superseded"),
        [((LAMINAR,), True), ((DRAG,), False), ((DRAG, LAMINAR), False), ((STEP,), False), ((), False)],
    )
    def test_an_effect_that_is_left_alone_supersedes_the_first_one(self, monkeypatch, left, superseded):
        """The first one was dropped, because the second one describes the data without it."""
        last = Found(10.0, 12.0, model=Model(left), held_out_of_first_casing=0.4)
        first = Found(40.0, model=Model((DRAG,)))
        steps = [Step("", Found(), ()), Step("+a", first, ()), Step("+b -a", last, ())]
        _, _, found = self.selected(monkeypatch, wrong=True, improved=steps)
        assert found.final is last
        assert (found.chosen.effect is LAMINAR) is superseded
        if not superseded:
            assert found.named is steps[1].fit
            return
        assert found.named is last
        assert found.candidates[0] is found.chosen
        assert [c.effect for c in found.candidates] == [LAMINAR, DRAG]
        of_it = found.chosen
        assert (of_it.delta_bic, of_it.score, of_it.held_out_gain) == pytest.approx((-90.0, 88.0, 0.6))
        assert of_it.significant
        assert of_it.indistinguishable_from == ()
        assert of_it.fit is last

    def test_of_several_effects_the_first_that_was_alone_supersedes(self, monkeypatch):
        alone = Found(20.0, model=Model((LAMINAR,)))
        both = Found(10.0, model=Model((LAMINAR, STEP)))
        fits = [Found(), Found(40.0, model=Model((DRAG,))), alone, both]
        steps = [Step(c, f, ()) for c, f in zip(("", "+a", "+b -a", "+c"), fits, strict=True)]
        _, _, found = self.selected(monkeypatch, wrong=True, improved=steps)
        assert (found.chosen.effect, found.named, found.final) == (LAMINAR, alone, both)
        # an effect that was dropped as well is not named
        steps[-1] = Step("+c", Found(10.0, model=Model((STEP,))), ())
        _, _, found = self.selected(monkeypatch, wrong=True, improved=steps)
        assert (found.chosen.effect, found.named) == (DRAG, fits[1])

    @pytest.mark.parametrize(
        ("change", "adds"),
        [
            (f"+{DRAG.name}", True),
            (f"+{DRAG.name} -touchpoint.constant", True),
            (f"+{DRAG.name}.n", False),
            (f"+b -{DRAG.name}", False),
        ],
    )
    def test_the_effect_that_a_step_adds(self, change, adds):
        assert Step(change, Found(), ()).adds(DRAG) is adds

    @pytest.mark.parametrize(("change", "taken"), [(f"+{DRAG.name}", True), ("+casing.air.laminar", False)])
    def test_an_earlier_history_of_the_same_effect_is_taken_over(self, monkeypatch, change, taken):
        known = [Step(c, Found(90.0 - 10 * i), ()) for i, c in enumerate(("", change, "+b", "+c"))]
        calls, end, found = self.selected(monkeypatch, wrong=True, known=known)
        assert (found.named, found.final) == ((known[1].fit, known[2].fit) if taken else (end, end))
        assert (calls[:1] == ["restarted"]) is taken

    def test_exchanges_of_an_earlier_history_are_ignored(self, monkeypatch):
        known = [Step("", Found(), ()), Step(f"+{DRAG.name}", Found(80.0), ())]
        known.append(Step("+b instead of a", Found(70.0), (), is_exchange=True))
        _, _, found = self.selected(monkeypatch, wrong=True, known=known)
        assert (found.named, found.final) == (known[1].fit, known[1].fit)

    def test_less_noise_compares_the_class_again(self, monkeypatch):
        better = candidate(LAMINAR, -80.0)
        steps = [Step("", Found(), ()), Step("+a", Found(40.0), ())]
        calls, _, found = self.selected(monkeypatch, quieter=True, at_noise=[better], improved=steps)
        assert calls[:2] == ["ranked", ("improve", 1 + DEFAULT.follow_up, [LAMINAR.name])]
        assert found.chosen is better
        # nothing is significant at the lower noise: the first choice remains
        calls, _, found = self.selected(
            monkeypatch, quieter=True, at_noise=[candidate(LAMINAR, significant=False)], improved=steps
        )
        assert found.chosen.effect is DRAG

    @pytest.mark.parametrize(
        ("alike", "first", "calls"),
        [
            (("casing.air.laminar",), DRAG, ["restarted", "ranked"]),
            (("casing.air.laminar",), LAMINAR, ["restarted", "ranked"]),
            ((), DRAG, ["restarted"]),
        ],
    )
    def test_the_noise_of_the_final_fit_may_separate_a_class(self, monkeypatch, alike, first, calls):
        separated = [candidate(first, -99.0)]
        asked, _, found = self.selected(monkeypatch, alike=alike, general=Found(20.0), at_noise=separated)
        assert asked == calls
        kept = len(calls) == 2 and first is DRAG
        assert (found.chosen.delta_bic == -99.0) is kept
        assert ([c.delta_bic for c in found.candidates] == [-99.0]) is kept


class TestPassedOn:
    """Effects of the user, criteria and workers reach every step."""

    OWN = (DRAG,)

    def test_by_rank(self, monkeypatch):
        base, asked = Found(), []
        monkeypatch.setattr(module, "applicable_effects", lambda *args: asked.append(args) or [])
        monkeypatch.setattr(module, "CaseColumns", lambda *_: None)
        monkeypatch.setattr(module, "score", lambda *args: asked.append(args) or [score()])
        monkeypatch.setattr(module, "NullDistribution", lambda scored: Null())
        monkeypatch.setattr(module, "FamilywiseNull", lambda nulls: lambda p, weights: float(p @ weights))
        monkeypatch.setattr(module, "starts_are_unknown", lambda data: False)
        strict = Criteria(significance=0.001)
        used = []
        workers = SimpleNamespace(map=lambda *args: used.append(args) or [(candidate(), [])])
        rank(base, self.OWN, criteria=strict, workers=workers)
        assert asked == [(base, self.OWN), (base, [], [None], strict)]
        ((_, fit, ((function, promising),), _),) = used
        assert (function, fit, promising.criteria) == (module._refit_candidate, base, strict)

    def test_by_select_and_improve(self, monkeypatch):
        asked = []

        def recorded(*args, **options):
            asked.append((args, options))
            return []

        strict, base, first = Criteria(crowded=9), Found(), [candidate()]
        monkeypatch.setattr(module, "refined", lambda found, criteria: Found(wrong=True))
        monkeypatch.setattr(module, "has_less_process_noise", lambda *_: False)
        monkeypatch.setattr(module, "improve", recorded)
        select(base, first, self.OWN, strict, "workers")
        assert asked == [
            (
                (base, self.OWN),
                {"criteria": strict, "max_steps": 2, "first": first, "workers": "workers", "exchange": False},
            )
        ]
        asked.clear()
        monkeypatch.setattr(module, "rank", recorded)
        monkeypatch.setattr(module, "separate_values", lambda *args: asked.append(args))
        improve(base, self.OWN, criteria=strict, workers="workers")
        assert asked == [
            ((base, self.OWN), {"criteria": strict, "workers": "workers"}), (base, [], self.OWN, strict),
        ]  # fmt: skip
        asked.clear()
        monkeypatch.setattr(module, "separate_values", lambda *args: None)
        monkeypatch.setattr(module, "_steps", lambda *args: asked.append(args[3:]) or iter(()))
        improve(base, self.OWN, criteria=strict, workers="workers", first=first)
        assert asked == [(self.OWN, strict, "workers")]

    def test_by_a_parameter_that_differs(self, monkeypatch):
        asked = []
        separate = SimpleNamespace(fit=Found(), penalised_bic=0.0)
        monkeypatch.setattr(module, "different_parameter", lambda base, criteria, *, least: separate)
        monkeypatch.setattr(module, "applicable_effects", lambda *args: asked.append(args) or [DRAG, STEP])
        monkeypatch.setattr(module, "improves_on_difference", lambda *args: asked.append(args))
        base, strict = Found(wrong=True), Criteria(crowded=9)
        separate_values(base, [], self.OWN, strict)
        assert asked == [(base, self.OWN), (separate, [DRAG, STEP], [0.0, 0.0], strict)]


class TestFreeShape:
    @pytest.mark.parametrize(("rival", "free"), [(None, True), (19.0, False), (21.0, True)])
    def test_a_free_shape_has_less_bic_than_another_effect(self, monkeypatch, rival, free):
        general = Found(20.0)
        monkeypatch.setattr(module, "with_free_shape", lambda *_: general)
        monkeypatch.setattr(module, "refined", lambda found, criteria: Found(rival))
        following = [] if rival is None else [candidate(STEP, -30.0)]
        found = Found(model=Model((DRAG,)))
        assert (module._with_free_shape(found, candidate(DRAG), following, DEFAULT) is general) is free

    def test_without_the_effect_or_a_shape_there_is_none(self, monkeypatch):
        monkeypatch.setattr(module, "with_free_shape", lambda *_: None)
        assert module._with_free_shape(Found(model=Model((DRAG,))), candidate(DRAG), (), DEFAULT) is None
        monkeypatch.setattr(module, "with_free_shape", lambda *_: Found())
        assert module._with_free_shape(Found(model=Model((STEP,))), candidate(DRAG), (), DEFAULT) is None


class TestSeparateValues:
    def found(
        self, monkeypatch, *, wrong=True, bic=70.0, still_wrong=False, rival=90.0, improves=False, none=False
    ):
        asked = []
        separate = SimpleNamespace(fit=Found(bic, wrong=still_wrong), penalised_bic=bic + 5.0)

        def different(base, criteria, *, least):
            asked.append(least)
            return None if none else separate

        monkeypatch.setattr(module, "different_parameter", different)
        monkeypatch.setattr(module, "applicable_effects", lambda *_: [DRAG])
        monkeypatch.setattr(module, "improves_on_difference", lambda *_: improves)
        c = [
            candidate(DRAG, value=40.0, fit=Found(rival)),
            candidate(LAMINAR, value=30.0, fit=None),
            candidate(LIBRARY["setup.inertia"], value=900.0, fit=None),
        ]
        found = separate_values(Found(wrong=wrong), c, (), DEFAULT)
        return asked, found is separate

    def test_its_score_is_at_least_half_of_that_of_a_law(self, monkeypatch):
        assert self.found(monkeypatch) == ([40.0 * DEFAULT.rival_share], True)

    @pytest.mark.parametrize(
        "change",
        [{"wrong": False}, {"still_wrong": True}, {"rival": 74.0}, {"improves": True}, {"none": True}],
    )
    def test_when_it_is_not_an_answer(self, monkeypatch, change):
        assert not self.found(monkeypatch, **change)[1]

    def test_without_a_law_of_physics_any_score_counts(self, monkeypatch):
        asked = []
        monkeypatch.setattr(
            module, "different_parameter", lambda base, criteria, *, least: asked.append(least)
        )
        separate_values(Found(wrong=True), [candidate(LIBRARY["setup.inertia"], value=900.0)], (), DEFAULT)
        assert asked == [0.0]

    def test_a_rival_within_the_penalty_is_worse(self, monkeypatch):
        assert self.found(monkeypatch, rival=76.0)[1]


class TestImprove:
    def improved(self, monkeypatch, ranking, steps, separate=None, **options):
        """`ranking` holds the candidates of each rank in turn; `steps` makes the following steps of a candidate."""
        remaining = list(ranking)
        monkeypatch.setattr(module, "separate_values", lambda *_: separate)
        monkeypatch.setattr(module, "rank", lambda *_, **__: remaining.pop(0))
        monkeypatch.setattr(module, "_steps", steps)
        kept, counted = [], []
        found = improve(
            Found(), keep=kept.append, progress=lambda done, whole: counted.append((done, whole)), **options
        )
        assert kept == found[1:]
        return found, counted

    def always(self, history, chosen, found, *_):
        yield Step(f"+{chosen.effect.name}", found, (candidate(DRAG),))

    @pytest.mark.parametrize(
        ("first", "wrong", "oscillation", "describes", "established", "random"),
        [
            (False, False, None, True, False, True),
            (False, False, None, True, True, False),  # better than any random torque
            (False, False, None, False, False, False),  # which does not describe the residuals
            (False, True, None, True, False, False),  # a lack of fit
            (False, False, SimpleNamespace(), True, False, False),
            (True, False, None, True, False, False),  # the first effect is tested by the diagnosis
        ],
    )
    def test_a_further_effect_is_better_than_a_random_torque(
        self, monkeypatch, first, wrong, oscillation, describes, established, random
    ):
        asked = []
        monkeypatch.setattr(module, "with_random_torque", lambda found, criteria: ("random", found.bic))
        monkeypatch.setattr(module, "describes", lambda *_: describes)
        monkeypatch.setattr(module, "is_established", lambda *args: asked.append(args) or established)
        problem = SimpleNamespace(data=[SimpleNamespace(motion=oscillators.stub(oscillation))])
        before = Found(60.0, wrong=wrong, problem=problem, model=Model(() if first else (LAMINAR,)))
        # a value for each recording is a step that adds no effect
        history = [Step("", Found(100.0), ()), Step("+a", before, (candidate(), candidate(STEP)))]
        chosen, found = candidate(DRAG), Found(50.0, model=Model((DRAG,)))
        assert module._may_be_random(history, chosen, found, DEFAULT) is random
        if random or established:
            assert asked == [(("random", 60.0), chosen.screened, found, 2, DEFAULT)]

    @pytest.mark.parametrize(
        ("bic", "names", "second", "replaced"),
        [
            (
                50.0,
                True,
                True,
                True,
            ),  # BIC of the two effects; of the one whose strength is not determined: 50
            (50.1, True, True, False),
            (40.0, False, True, False),  # its strength is determined
            (40.0, True, False, False),  # a single effect is no sum that the one could imitate
        ],
    )
    def test_two_effects_are_added_instead_of_one_whose_strength_is_not_determined(
        self, monkeypatch, bic, names, second, replaced
    ):
        monkeypatch.setattr(module, "_may_be_random", lambda *_: False)
        monkeypatch.setattr(
            module,
            "reason_undetermined",
            lambda effect, found, criteria: "undetermined" if names and effect is STEP else "",
        )
        two = [candidate(LAMINAR, -60.0, fit=Found(bic))] if second else []

        def steps(history, chosen, found, *_):
            yield Step(f"+{chosen.effect.name}", found, {DRAG: tuple(two)}.get(chosen.effect, ()))

        ranking = [candidate(STEP, -70.0, fit=Found(50.0)), candidate(DRAG, -40.0, fit=Found(60.0))]
        found, _ = self.improved(monkeypatch, [ranking], steps)
        expected = [DRAG.name, LAMINAR.name] if replaced else [STEP.name]
        assert [step.change for step in found[1:]] == [f"+{name}" for name in expected]

    def test_a_random_torque_that_describes_the_remainder_ends_the_search_with_a_reason(self, monkeypatch):
        monkeypatch.setattr(module, "_may_be_random", lambda history, *_: len(history) > 1)
        found, counted = self.improved(monkeypatch, [[candidate()]], self.always)
        assert [s.change for s in found] == ["", f"+{DRAG.name}"]
        assert (
            found.stopped
            == f"a random torque describes the remainder as well as {DRAG.name}, which is not added"
        )
        assert counted == [(1, None)]

    def test_effects_are_added_up_to_the_most(self, monkeypatch):
        monkeypatch.setattr(module, "_may_be_random", lambda *_: False)
        found, counted = self.improved(monkeypatch, [[candidate()]], self.always)
        assert len(found) == 1 + DEFAULT.max_steps
        assert counted == [(i + 1, None) for i in range(DEFAULT.max_steps)]
        found, _ = self.improved(monkeypatch, [[candidate()]], self.always, max_steps=2)
        assert len(found) == 3
        assert found.stopped == ""

    def test_a_step_that_fails_ends_it_and_keeps_those_before(self, monkeypatch):
        def failing(history, chosen, found, *_):
            yield Step(f"+{chosen.effect.name}", found, ())
            raise SimulationError("the casing stops and starts too often to be followed")

        found, counted = self.improved(monkeypatch, [[candidate()]], failing)
        assert [s.change for s in found] == ["", f"+{DRAG.name}"]
        assert found.stopped == f"{DRAG.name}: the casing stops and starts too often to be followed"
        assert counted == []

    def test_nothing_is_added_without_a_candidate(self, monkeypatch):
        found, _ = self.improved(monkeypatch, [[candidate(significant=False)]], self.always)
        assert [s.change for s in found] == [""]
        found, _ = self.improved(monkeypatch, [], self.always, first=[candidate(significant=False)])
        assert len(found) == 1

    def test_errors_of_starts_end_it(self, monkeypatch):
        found, _ = self.improved(monkeypatch, [[candidate(START)]], self.always)
        assert len(found) == 1
        assert "--start-u" in found.stopped

    def test_a_candidate_that_is_not_an_improvement_ends_it(self, monkeypatch):
        found, counted = self.improved(monkeypatch, [[candidate()]], lambda *_: iter(()))
        assert (len(found), counted) == (1, [])

    def test_parameters_that_differ_are_the_first_step(self, monkeypatch):
        separate = SimpleNamespace(parameter=SimpleNamespace(names=("a.k", "b.k")), fit=Found(50.0))
        found, _ = self.improved(
            monkeypatch, [[candidate()], [candidate(significant=False)]], self.always, separate
        )
        assert [s.change for s in found] == ["", "+a.k, b.k per recording"]
        assert found[1].fit is separate.fit

    def test_candidates_of_the_first_step_are_ranked_with_its_fit(self, monkeypatch):
        separate = SimpleNamespace(parameter=SimpleNamespace(names=("a.k",)), fit=Found(50.0))
        ranked, asked, base = [], [], Found()

        def rank(fit, extra, *, criteria, workers):
            ranked.append((fit, extra, criteria, workers))
            return [candidate(significant=False, bic=-len(ranked))]

        def separated(fit, known, extra, criteria):
            asked.append((fit, [c.delta_bic for c in known], extra, criteria))
            return separate

        monkeypatch.setattr(module, "rank", rank)
        monkeypatch.setattr(module, "separate_values", separated)
        found = improve(base, (STEP,), workers="workers")
        assert ranked == [(f, (STEP,), DEFAULT, "workers") for f in (base, separate.fit)]
        assert asked == [(base, [-1], (STEP,), DEFAULT)]
        assert [s.candidates[0].delta_bic for s in found] == [-1, -2]
        found = improve(base, (STEP,), workers="workers", first=[candidate(significant=False, bic=-9)])
        assert [fit for fit, *_ in ranked[2:]] == [separate.fit]
        assert [s.candidates[0].delta_bic for s in found] == [-9, -3]


class TestSteps:
    def steps(self, monkeypatch, *, refined=None, refit=50.0, base=100.0, general=None, ranking=None):
        def refine(found, criteria):
            if refined is None:
                raise EstimationError("it diverges", "")
            return Found(refined, model=found.model)

        def rank(fit, extra, **_):
            if ranking is None:
                return [candidate()]
            raise ranking

        monkeypatch.setattr(module, "refined", refine)
        monkeypatch.setattr(module, "rank", rank)
        monkeypatch.setattr(module, "with_free_shape", lambda *_: general)
        history = [Step("", Found(base), ())]
        found = Found(refit, model=Model((DRAG,)))
        return module._steps(history, candidate(DRAG), found, (), DEFAULT, None)

    @pytest.mark.parametrize(("refined", "taken"), [(51.9, 51.9), (52.1, 50.0), (30.0, 30.0), (None, 50.0)])
    def test_a_refined_fit_in_a_worse_minimum_is_not_taken(self, monkeypatch, refined, taken):
        (step,) = self.steps(monkeypatch, refined=refined)
        assert (step.change, step.fit.bic, len(step.candidates)) == (f"+{DRAG.name}", taken, 1)

    @pytest.mark.parametrize(("base", "count"), [(52.1, 1), (51.9, 0)])
    def test_a_step_needs_evidence(self, monkeypatch, base, count):
        assert len(list(self.steps(monkeypatch, refined=50.0, base=base))) == count

    def test_a_free_shape_is_a_separate_step(self, monkeypatch):
        law = module.with_free_shape.__globals__["with_shape_parameter"](DRAG)
        general = Found(20.0, model=Model((STEP, law)))
        first, second = self.steps(monkeypatch, refined=50.0, general=general)
        assert (first.change, second.change) == (f"+{DRAG.name}", f"+{DRAG.name}.n")
        assert second.fit is general

    def test_a_ranking_that_fails_keeps_the_step(self, monkeypatch):
        steps = self.steps(monkeypatch, refined=50.0, ranking=EstimationError("no", ""))
        assert next(steps).candidates == ()
        with pytest.raises(EstimationError):
            next(steps)


class TestBackward:
    """A base and a fit with some added effects; the BIC without each of them is given."""

    def dropped(self, monkeypatch, names, without, *, sigma=9.0, newest=DRAG.name):
        def fit(model, base, *, start, noise):
            if model.names not in without:
                raise SimulationError("the motion diverges")
            return Found(without[model.names], model=model, estimates=strengths(model.names))

        def strengths(names):
            return {f"{n}.k": estimate(sigma, 1.0) for n in names}

        monkeypatch.setattr(module, "fit", fit)
        effects = tuple(LIBRARY[n] for n in names)
        full = Found(50.0, model=Model(effects), estimates=strengths(names))
        base = Found(model=Model(effects[:1]))
        return module._backward([Step("", base, ()), Step(f"+{newest}", full, ("kept",))], DEFAULT)

    FIRST = "touchpoint.constant"

    def test_a_weak_effect_that_bic_does_not_need_is_dropped(self, monkeypatch):
        names = (self.FIRST, STEP.name, DRAG.name)
        found = self.dropped(monkeypatch, names, {(self.FIRST, DRAG.name): 49.0}, sigma=3.0)
        assert found.change == f"+{DRAG.name} -{STEP.name}"
        assert (found.fit.bic, found.candidates) == (49.0, ())

    @pytest.mark.parametrize(("bic", "sigma"), [(51.0, 3.0), (49.0, 3.6)])
    def test_a_strong_or_needed_effect_stays(self, monkeypatch, bic, sigma):
        names = (self.FIRST, STEP.name, DRAG.name)
        found = self.dropped(monkeypatch, names, {(self.FIRST, DRAG.name): bic}, sigma=sigma)
        assert (found.change, found.fit.bic, found.candidates) == (f"+{DRAG.name}", 50.0, ("kept",))

    def test_an_effect_without_which_the_motion_cannot_be_computed_stays(self, monkeypatch):
        """In a crowd the drive of a body is tried as well."""
        names = (self.FIRST, STEP.name, "touchpoint.drift", DRAG.name)
        found = self.dropped(monkeypatch, names, {(self.FIRST, STEP.name, DRAG.name): 45.0})
        assert found.change == f"+{DRAG.name} -touchpoint.drift"
        found = self.dropped(monkeypatch, names, {})
        assert (found.change, found.fit.bic) == (f"+{DRAG.name}", 50.0)

    @pytest.mark.parametrize(
        ("errors", "essential"),
        [((1.0, 1.0), False), ((1.0, 0.1), True), ((math.inf, 1.0), True), ((math.nan, 1.0), True)],
    )
    def test_a_strength_is_essential_if_that_of_one_case_is(self, errors, essential):
        own = {f"{STEP.name}.k@{c}": estimate(1.0, u) for c, u in zip("ab", errors, strict=True)}
        fit = Found(estimates=own | {f"{STEP.name}.t0": estimate(9.0, 0.1)})
        assert module._is_essential(fit, STEP, DEFAULT) is essential

    def test_in_a_crowd_a_strong_effect_is_tried_as_well(self, monkeypatch):
        """Three were added; the newest and those of the base are never dropped."""
        names = (self.FIRST, STEP.name, "touchpoint.drift", DRAG.name)
        without = {
            (self.FIRST, "touchpoint.drift", DRAG.name): 55.0,
            (self.FIRST, STEP.name, DRAG.name): 45.0,
        }
        found = self.dropped(monkeypatch, names, without)
        assert found.change == f"+{DRAG.name} -touchpoint.drift"
        assert found.fit.bic == 45.0


@pytest.mark.parametrize(
    ("name", "searched"),
    [
        ("casing.precession", True),
        ("touchpoint.step", True),
        ("casing.unbalance", False),
        ("casing.air.quadratic", False),
        ("touchpoint.stribeck", False),
    ],
)
def test_frequencies_and_changepoints_need_a_search(name, searched):
    assert needs_search(LIBRARY[name]) is searched


class TestFoundStarts:
    def starts(self, monkeypatch, scored, refitted=None):
        monkeypatch.setattr(module, "CaseColumns", lambda *_: None)
        monkeypatch.setattr(module, "score", lambda *_, draws: [scored])
        monkeypatch.setattr(module, "refit", lambda base, s, criteria: refitted)
        monkeypatch.setattr(
            module,
            "initial_values_of",
            lambda base, s: {f"{s.effect.name}.{s.own_phase}": float(s.gamma.sum())},
        )
        return found_starts(Found(), [scored.effect])

    def test_of_a_law_without_a_changepoint(self, monkeypatch):
        assert self.starts(monkeypatch, score(DRAG)) == {f"{DRAG.name}.False": 1.0}
        assert self.starts(monkeypatch, score(DRAG, absorbed=True)) == {}

    def test_of_a_changepoint_they_are_those_of_its_refit(self, monkeypatch):
        refitted = Found(estimates={f"{STEP.name}.t0": estimate(7.0), "other.k": estimate()})
        assert self.starts(monkeypatch, score(STEP), refitted) == {f"{STEP.name}.t0": 7.0}
        assert self.starts(monkeypatch, score(STEP), None) == {f"{STEP.name}.False": 1.0}

    def test_of_phases_common_and_own_values(self, monkeypatch):
        found = self.starts(monkeypatch, score(PERIODIC, columns=4, own_phase=True))
        assert found == {f"{PERIODIC.name}.False": 2.0, f"{PERIODIC.name}.True": 4.0}


class TestExchanged:
    """The laws a and b were added to the base; d is a law of the user whose own form is in the model."""

    def step(
        self,
        monkeypatch,
        refits,
        *,
        deltas=None,
        fails=True,
        restoring=False,
        quiet=0.0,
        added=("a", "b"),
        torque=(0.0, 0.0),
    ):
        def law(name, kind="physical"):
            return SimpleNamespace(name=name, kind=kind)

        class Exchanged:
            def __init__(self, change, delta):
                self.change, self.delta_bic = change, delta

            def refit(self, about):
                tried.append(self.change)
                bic = refits.get(self.change)
                return bic and SimpleNamespace(bic=bic, deviance=bic - 20.0, name=self.change)

        tried, asked = [], []
        current = SimpleNamespace(
            model=SimpleNamespace(effects=[law(n) for n in ("base", *added)], restoring=restoring),
            problem=SimpleNamespace(cases=[1, 2]), bic=100.0, deviance=70.0,
            fails=lambda criteria: fails, name="current",
        )  # fmt: skip
        first = SimpleNamespace(model=SimpleNamespace(names=("base",)))

        def exchanges(about, removed, effects, cases, criteria):
            asked.append((removed.name, [e.name for e in effects], cases))
            return [Exchanged(c, d) for c, d in (deltas or {}).items() if c.startswith(removed.name)]

        monkeypatch.setattr(module, "exchanges", exchanges)
        monkeypatch.setattr(module, "_is_friction", lambda e: e.kind == "physical")
        monkeypatch.setattr(
            module, "applicable_effects", lambda fit, extra: [law("x"), law("phase", "other"), law("y")]
        )
        monkeypatch.setattr(module, "laws_of", lambda mechanism: {"a": law("a"), "b": law("b", "changed")})
        monkeypatch.setattr(module, "mechanism_of", lambda effects: None)
        monkeypatch.setattr(module, "CaseColumns", lambda fit, i: i)
        monkeypatch.setattr(module, "_refined", lambda fit, criteria: fit)
        monkeypatch.setattr(module, "deviance_at_noise_of", lambda old, new: old.deviance - quiet)
        random = {"current": torque[0]}
        monkeypatch.setattr(
            module, "with_random_torque",
            lambda f, criteria: SimpleNamespace(deviance=f.deviance - random.get(f.name, torque[1])),
        )  # fmt: skip
        criteria = SimpleNamespace(evidence=6.0)
        found = module._exchanged([SimpleNamespace(fit=first), SimpleNamespace(fit=current)], (), criteria)
        assert found is None or found.is_exchange
        return found and found.change, tried, asked

    def test_three_exchanges_are_refitted_and_the_best_is_taken(self, monkeypatch):
        deltas = {"a1": -7.0, "a2": -30.0, "b1": -9.0, "b2": -8.0}
        found, tried, asked = self.step(
            monkeypatch, {"a2": 93.0, "b1": 91.0, "b2": 90.0, "a1": 1.0}, deltas=deltas
        )
        assert (found, tried) == ("b2", ["a2", "b1", "b2"])
        # of b, the library has another form
        assert asked == [("a", ["x", "y"], [0, 1]), ("b", ["b", "x", "y"], [0, 1])]

    def test_a_refit_that_fails_is_left_out(self, monkeypatch):
        assert self.step(monkeypatch, {"b1": 93.0}, deltas={"a1": -9.0, "b1": -8.0})[0] == "b1"
        assert self.step(monkeypatch, {}, deltas={"a1": -9.0})[0] is None

    @pytest.mark.parametrize(
        ("bic", "quiet", "fails", "torque", "taken"),
        [
            (93.9, 0.0, True, (0.0, 0.0), True), (94.1, 0.0, True, (0.0, 0.0), False),
            # a part of the fall is due to the noise of the new fit
            (92.0, 1.9, True, (0.0, 0.0), True), (92.0, 2.1, True, (0.0, 0.0), False),
            (94.1, -5.0, True, (0.0, 0.0), False),
            # a random torque describes the data of a model without a lack of fit as well
            (90.0, 0.0, False, (3.9, 0.0), True), (90.0, 0.0, False, (4.1, 0.0), False),
            (90.0, 0.0, True, (4.1, 0.0), True), (90.0, 0.0, False, (5.0, 1.2), True),
            (94.1, 0.0, False, (0.0, 9.0), False),
        ],
    )  # fmt: skip
    def test_bic_falls_by_more_than_noise_explains(self, monkeypatch, bic, quiet, fails, torque, taken):
        found, *_ = self.step(
            monkeypatch, {"a1": bic}, deltas={"a1": -20.0}, quiet=quiet, fails=fails, torque=torque
        )
        assert (found == "a1") is taken

    def test_oscillations_and_first_models_have_none(self, monkeypatch):
        assert self.step(monkeypatch, {"a1": 1.0}, deltas={"a1": -20.0}, restoring=True) == (None, [], [])
        assert self.step(monkeypatch, {"a1": 1.0}, deltas={"a1": -20.0}, added=()) == (None, [], [])
