"""Which refit is kept, from which initial values it starts, and when the search for a changepoint ends."""

import math
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import oscillators
import pytest

from fitting import LIBRARY, Case, Criteria, Estimate, EstimationError, Model, SimulationError, diagnose, fit
from fitting._criteria import DEFAULT
from fitting.discovery import _refine as module
from fitting.discovery._refine import (
    at_lowest_noise,
    distant_changepoints,
    has_less_process_noise,
    has_model_noise,
    initial_values_of,
    local_changepoints,
    refined,
    refit,
    refitted_at,
    replaced_laws,
    restarted_from,
    with_candidate,
    with_common_phase,
    with_common_values,
    with_free_shape,
    with_shape_parameter,
    with_values_per_case,
)
from fitting.discovery._score import Score
from fitting.effects._effect import State
from fitting.effects._expression import Tape
from fitting.effects._user import resolve

STEP, DRAG = LIBRARY["touchpoint.step"], LIBRARY["casing.air.quadratic"]
PERIODIC = LIBRARY["casing.precession"]


class Level(SimpleNamespace):
    """A noise of some level, `least` allowed by the recording."""

    def at(self, level):
        return Level(**{**vars(self), "level": level})


def noise(level=1.0, *, raised=False, least=0.5):
    return Level(level=level, raised=raised, least=least)


@dataclass(frozen=True)
class Found:
    """A fit, as far as a decision depends on it."""

    deviance: float = 100.0
    noise: tuple = (noise(),)
    bic: float = 100.0
    values: dict = field(default_factory=lambda: {"a.k": 1.0, "b.k": 2.0})
    model: object = None
    problem: object = field(
        default_factory=lambda: SimpleNamespace(data=[SimpleNamespace(motion=oscillators.stub())])
    )
    estimates: dict = field(default_factory=dict)


def score(effect=DRAG, value=50.0, gamma=(3.0,), shape=({},), *, own_phase=False):
    none = np.zeros(0)
    return Score(
        effect, value, np.array(gamma), shape, len(gamma), 1, absorbed=False, direction=none, null=none,
        own_phase=own_phase,
    )  # fmt: skip


class TestScoresOfDrivenBodies:
    """About a driven body whose model fails, laws with small scores are fitted from scratch."""

    @pytest.mark.parametrize(
        ("inputs", "fails", "restoring", "mislead"),
        [
            ((), True, False, False),
            (("voltage",), False, False, False),
            (("voltage",), True, False, True),
            (("voltage",), True, True, False),
        ],
    )
    def test_scores_mislead_if_the_model_of_a_driven_body_fails(self, inputs, fails, restoring, mislead):
        effects = [SimpleNamespace(inputs=()), SimpleNamespace(inputs=inputs)]
        model = SimpleNamespace(effects=effects, restoring=restoring)
        base = SimpleNamespace(model=model, fails=lambda criteria: fails)
        assert module.scores_mislead(base, DEFAULT) is mislead


class TestNoise:
    @pytest.mark.parametrize(
        ("before", "after", "less"),
        [
            ((1.0,), (0.79,), True),
            ((1.0,), (0.81,), False),
            ((1.0, 1.0), (1.0, 0.7), True),  # one case suffices
            ((1.0, 2.0), (1.2, 1.9), False),
            ((2.0,), (1.5,), True),
            ((0.5,), (0.45,), False),
        ],
    )
    def test_a_fifth_less_process_noise_counts_as_less(self, before, after, less):
        old, new = (Found(noise=tuple(map(noise, levels))) for levels in (before, after))
        assert has_less_process_noise(new, old, DEFAULT) is less

    def test_one_raised_level_is_noise_of_the_model(self):
        assert has_model_noise(Found(noise=(noise(), noise(raised=True))))
        assert not has_model_noise(Found(noise=(noise(), noise())))

    @pytest.mark.parametrize(
        ("raised", "oscillation", "deviance", "taken"),
        [
            (True, None, 100.0 - DEFAULT.evidence - 0.1, True),
            (True, None, 100.0 - DEFAULT.evidence + 0.1, False),
            (True, SimpleNamespace(), 10.0, False),
            (False, None, 10.0, False),
            (True, None, None, False),
        ],
    )
    def test_the_fit_at_the_lowest_noise_needs_evidence(
        self, monkeypatch, raised, oscillation, deviance, taken
    ):
        asked = []

        def fit(model, base, *, start, noise):
            asked.append((start, [n.level for n in noise]))
            if deviance is None:
                raise EstimationError("it diverges", "")
            return Found(deviance)

        monkeypatch.setattr(module, "fit", fit)
        problem = SimpleNamespace(data=[SimpleNamespace(motion=oscillators.stub(oscillation))])
        found = Found(noise=(noise(9.0, raised=raised, least=0.25), noise(3.0)), problem=problem)
        assert at_lowest_noise(found, DEFAULT).deviance == (deviance if taken else 100.0)
        if asked:
            assert asked == [(found.values, [0.25, 0.5])]
        assert bool(asked) is (raised and oscillation is None)


class TestRestart:
    @pytest.mark.parametrize("lower", [True, False])
    def test_a_refined_fit_may_be_at_the_lowest_noise(self, monkeypatch, lower):
        converged, least = Found(90.0), Found(80.0)
        monkeypatch.setattr(module, "refitted_at", lambda found, noise: converged)
        monkeypatch.setattr(
            module,
            "at_lowest_noise",
            lambda found, criteria: least if lower and found is converged else found,
        )
        assert refined(Found(), DEFAULT) is (least if lower else converged)

    def test_values_of_unknown_parameters_are_ignored(self, monkeypatch):
        monkeypatch.setattr(module, "fit", lambda model, base, *, start, noise: (start, noise))
        changed = refitted_at(Found(), "noise", {"b.k": 5.0, "c.k": 7.0})
        assert changed == ({"a.k": 1.0, "b.k": 5.0}, "noise")
        assert refitted_at(Found(), "noise") == ({"a.k": 1.0, "b.k": 2.0}, "noise")

    @pytest.mark.parametrize(("deviance", "taken"), [(99.9, True), (100.1, False), (None, False)])
    def test_the_better_minimum_is_kept(self, monkeypatch, deviance, taken):
        def fit(model, base, *, start, noise):
            assert (start, noise) == ({"a.k": 1.0, "b.k": 4.0}, base.noise)
            if deviance is None:
                raise EstimationError("it diverges", "")
            return Found(deviance)

        monkeypatch.setattr(module, "fit", fit)
        found, other = Found(), Found(values={"b.k": 4.0}, noise=(noise(7.0),))
        assert (restarted_from(found, other) is found) is not taken


class TestFarFromTheMotion:
    @pytest.mark.parametrize(
        ("holds", "joints", "law", "fails", "far"),
        [
            (True, (), "casing.air.linear", True, True),
            (True, (), "casing.air.linear", False, False),
            (False, (), "casing.air.linear", True, False),
            (False, ("bearing",), "casing.air.linear", True, True),
            (False, ("bearing",), "casing.air.linear", False, False),
            (False, ("bearing",), "bearing.power", True, False),
            (False, ("bearing", "belt"), "bearing.power", True, True),
        ],
    )
    def test_a_held_body_or_a_joint_without_a_law(self, monkeypatch, holds, joints, law, fails, far):
        monkeypatch.setattr(module, "holds_moving_body", lambda fit, case: holds and case == 1)
        data = [SimpleNamespace(record=SimpleNamespace(joints=joints))] * 2
        model = SimpleNamespace(effects=(LIBRARY[law],), restoring=False)
        base = SimpleNamespace(
            model=model,
            problem=SimpleNamespace(data=data),
            fails=lambda criteria: criteria is DEFAULT and fails,
        )
        assert module.is_far_from_the_motion(base, DEFAULT) is far
        model.restoring = True
        assert not module.is_far_from_the_motion(base, DEFAULT)


class TestRefit:
    """The refit of a candidate with a score of 50, from a base with a deviance of 100."""

    def refitted(self, monkeypatch, falls, value=50.0, *, raised=True, thorough=True, lowest=0.0):
        calls = []

        def together(base, scored, start=None, *, hold_strength=False):
            calls.append(hold_strength)
            fall = falls[hold_strength]
            return None if fall is None else Found(base.deviance - fall, noise=base.noise)

        def at_lowest(found, criteria):
            calls.append("lowest")
            return Found(found.deviance - lowest)

        monkeypatch.setattr(module, "fit_together", together)
        monkeypatch.setattr(module, "at_lowest_noise", at_lowest)
        base = Found(noise=(noise(raised=raised),))
        found = refit(base, score(value=value), DEFAULT, thorough=thorough)
        return calls, None if found is None else base.deviance - found.deviance

    @pytest.mark.parametrize(
        ("fall", "raised", "thorough", "calls"),
        [
            (50.0 - DEFAULT.refit_shortfall + 0.1, True, True, [False]),
            (50.0 - DEFAULT.refit_shortfall - 0.1, True, True, [False, True, "lowest"]),
            (1.0, False, True, [False]),
            (1.0, True, False, [False]),
            (None, True, True, [False]),
        ],
    )
    def test_a_refit_that_falls_short_is_repeated(self, monkeypatch, fall, raised, thorough, calls):
        found, gain = self.refitted(monkeypatch, {False: fall, True: 0.0}, raised=raised, thorough=thorough)
        assert found == calls
        assert gain == (None if fall is None else pytest.approx(fall))

    def test_the_repeated_refit_ends_the_search_where_it_suffices(self, monkeypatch):
        calls, gain = self.refitted(monkeypatch, {False: 1.0, True: 45.0})
        assert (calls, gain) == ([False, True], pytest.approx(45.0))
        calls, gain = self.refitted(monkeypatch, {False: 1.0, True: 5.0}, lowest=20.0)
        assert (calls, gain) == ([False, True, "lowest"], pytest.approx(25.0))
        calls, gain = self.refitted(monkeypatch, {False: 3.0, True: None}, lowest=0.0)
        assert gain == pytest.approx(3.0)

    @pytest.mark.parametrize(("deviance", "found"), [(40.0, True), (math.nan, False), (None, False)])
    def test_a_restoring_torque_is_fitted_from_scratch(self, monkeypatch, deviance, found):
        def fit(model, data, *, quick):
            assert (model, data, quick) == ("with it", "data", True)
            if deviance is None:
                raise SimulationError("it diverges", "")
            return Found(deviance)

        monkeypatch.setattr(module, "fit", fit)
        effect = SimpleNamespace(restoring=True, breakpoint="", name="spring", equivalent=())
        model = SimpleNamespace(restoring=False, with_effect=lambda e: "with it" if e is effect else "")
        base = Found(model=model, problem=SimpleNamespace(data="data"))
        assert (refit(base, SimpleNamespace(effect=effect, score=1.0), DEFAULT) is not None) is found

    @pytest.mark.parametrize(
        ("effect", "own", "restoring", "scratch"),
        [
            ("casing.spring.linear", (), False, True),
            ("casing.spring.linear", (), True, False),
            ("casing: c*voltage", (), False, True),
            ("casing: c*voltage", ("voltage",), False, False),
            ("casing.air.quadratic", (), False, False),
        ],
    )
    def test_what_the_base_knows_nothing_of_is_fitted_from_scratch(
        self, monkeypatch, effect, own, restoring, scratch
    ):
        monkeypatch.setattr(module, "fit_from_scratch", lambda base, effect: "from scratch")
        monkeypatch.setattr(module, "fit_together", lambda base, scored: None)
        law = resolve(effect, {"voltage": "V"})
        model = SimpleNamespace(restoring=restoring, effects=[SimpleNamespace(inputs=own)])
        found = refit(Found(model=model, noise=(noise(raised=False),)), score(law), DEFAULT)
        assert found == ("from scratch" if scratch else None)

    @pytest.mark.parametrize(
        ("gains", "raised", "searches"),
        [
            ([0.0, 0.0, 0.0], True, 1),  # nothing better was found
            ([5.0, 5.0, 5.0, 5.0], True, 3),
            ([5.0, 5.0], False, 1),  # the model needs no noise any more
        ],
    )
    def test_changepoints_are_searched_until_nothing_better_is_found(
        self, monkeypatch, gains, raised, searches
    ):
        remaining, asked = list(gains), []

        def together(base, scored, start=None, *, hold_strength=False):
            if start is None:
                return Found(90.0, noise=(noise(raised=raised),))
            asked.append(start)
            gain = remaining.pop(0)
            return Found(asked_from[-1] - gain, noise=(noise(raised=raised),))

        asked_from = []

        def distant(fit, effect, criteria):
            asked_from.append(fit.deviance)
            return {"t0": 1.0}

        monkeypatch.setattr(module, "fit_together", together)
        monkeypatch.setattr(module, "distant_changepoints", distant)
        monkeypatch.setattr(module, "local_changepoints", lambda *_: {})
        found = refit(Found(), score(STEP, 5.0), DEFAULT)
        assert len(asked) == searches
        assert found.deviance == 90.0 - sum(gains[:searches])

    def test_a_search_near_the_changepoint_starts_at_the_better_fit(self, monkeypatch):
        def together(base, scored, start=None, *, hold_strength=False):
            return Found({None: 90.0, 1.0: 95.0, 2.0: 80.0}[start and start["t0"]])

        monkeypatch.setattr(module, "fit_together", together)
        monkeypatch.setattr(module, "distant_changepoints", lambda *_: {"t0": 1.0})
        monkeypatch.setattr(module, "local_changepoints", lambda fit, _: {"t0": 2.0})
        assert refit(Found(), score(STEP, 5.0), DEFAULT).deviance == 80.0


class Stepping:
    """Rows of a case that are `strength` after a changepoint, with a free level; for both parameters' derivatives."""

    time = np.linspace(0.0, 10.0, 2001)

    def __init__(self, truth, level=0.3, span=(0.0, 10.0), fails_after=np.inf):
        rows = level + 1.5 * (self.time > truth)
        self.data = SimpleNamespace(record=SimpleNamespace(span=span), z=rows)
        self._fails_after = fails_after

    def predict(self, theta):
        if theta[0] > self._fails_after:
            raise SimulationError("it diverges", "")
        rows = theta[1] * (self.time > theta[0])
        return SimpleNamespace(rows=rows)


def stepping(truth, now, **options):
    """A fit whose changepoint is at another time; its level, with an error, is free."""
    case = Stepping(truth, **options)
    jacobian = np.stack([np.zeros(2001), case.time > now, np.ones(2001)], axis=1).astype(float)
    layout = SimpleNamespace(
        names=("touchpoint.step.t0", "touchpoint.step.k", "level"),
        places=lambda index, keys: [{"touchpoint.step.t0": 0, "touchpoint.step.k": 1}[k] for k in keys],
    )
    problem = SimpleNamespace(cases=[case], layout=layout, projections=[lambda rows: rows])
    return SimpleNamespace(
        theta=np.array([now, 1.5, 0.0]), problem=problem, noise=(noise(raised=True),),
        predictions=[SimpleNamespace(jacobian=jacobian)],
    )  # fmt: skip


class TestChangepoint:
    """A step in a record of 10 s: the neighbourhood is 0.4 s to both sides, the trials are 17 ms apart."""

    @pytest.mark.parametrize("truth", [4.7, 5.3])
    def test_a_nearby_time_is_found(self, truth):
        found = local_changepoints(stepping(truth, 5.0), STEP)
        assert found["touchpoint.step.t0"] == pytest.approx(truth, abs=0.02)
        assert (found["touchpoint.step.k"], found["level"]) == (1.5, 0.0)

    @pytest.mark.parametrize(("truth", "edge"), [(4.3, 4.6), (5.7, 5.4)])
    def test_a_distant_time_is_approached(self, truth, edge):
        found = local_changepoints(stepping(truth, 5.0), STEP)
        assert found["touchpoint.step.t0"] == pytest.approx(edge)

    def test_the_best_time_stays(self):
        assert local_changepoints(stepping(5.0, 5.0), STEP) == {}

    @pytest.mark.parametrize(("truth", "now"), [(0.05, 0.2), (9.95, 9.8)])
    def test_trials_are_within_the_record(self, truth, now):
        tried = []
        fit = stepping(truth, now, span=(0.1, 9.9))
        (case,) = fit.problem.cases
        own = case.predict
        case.predict = lambda theta: tried.append(theta[0]) or own(theta)
        local_changepoints(fit, STEP)
        assert 0.1 <= min(tried) < max(tried) <= 9.9
        assert len(tried) == 48 + 1  # and the present one

    def test_times_without_a_solution_are_left_out(self):
        found = local_changepoints(stepping(5.3, 5.0, fails_after=5.2), STEP)
        assert found["touchpoint.step.t0"] == pytest.approx(5.2, abs=0.02)

    def test_what_is_free_or_a_nuisance_hides_no_changepoint(self):
        """Drifts of a nuisance and of a free parameter, many times larger than the step."""
        fit = stepping(5.3, 5.0)
        (case,) = fit.problem.cases
        drift = case.time / np.linalg.norm(case.time)
        case.data.z += 400.0 * drift + 3.0 * case.time**2
        fit.predictions[0].jacobian[:, 1] = case.time**2
        fit.problem.projections = [
            lambda rows: rows - np.multiply.outer(drift, drift @ rows).reshape(rows.shape)
        ]
        assert local_changepoints(fit, STEP)["touchpoint.step.t0"] == pytest.approx(5.3, abs=0.02)

    def test_its_own_derivative_is_not_free(self):
        """It would describe the rest of the step beyond the neighbourhood."""
        fit = stepping(5.7, 5.0)
        (case,) = fit.problem.cases
        fit.predictions[0].jacobian[:, 0] = (case.time > 5.0) & (case.time <= 5.7)
        assert local_changepoints(fit, STEP)["touchpoint.step.t0"] == pytest.approx(5.4)

    def test_each_case_has_its_own(self):
        one, two = stepping(4.7, 5.0), stepping(5.3, 5.0)
        places = {0: {"touchpoint.step.t0": 0}, 1: {"touchpoint.step.t0": 3}}
        both = SimpleNamespace(
            theta=np.concatenate([one.theta, two.theta]),
            problem=SimpleNamespace(
                cases=[*one.problem.cases, *two.problem.cases],
                layout=SimpleNamespace(
                    names=tuple(range(6)), places=lambda index, keys: [places[index][k] for k in keys]
                ),
                projections=one.problem.projections * 2,
            ),
            predictions=[
                SimpleNamespace(jacobian=np.hstack([one.predictions[0].jacobian, np.zeros((2001, 3))])),
                SimpleNamespace(jacobian=np.hstack([np.zeros((2001, 3)), two.predictions[0].jacobian])),
            ],
        )
        own = two.problem.cases[0].predict
        two.problem.cases[0].predict = lambda theta: own(theta[3:])
        found = local_changepoints(both, STEP)
        assert (found[0], found[3]) == (pytest.approx(4.7, abs=0.02), pytest.approx(5.3, abs=0.02))

    def test_a_distant_changepoint_is_that_of_the_noisy_case(self, monkeypatch):
        fit = stepping(2.0, 5.0)
        fit.noise = (noise(), noise(raised=True))
        fit.theta = np.array([5.0, 1.5, 6.0, 2.5])
        keys = ["touchpoint.step.t0", "touchpoint.step.k"]
        fit.problem.layout = SimpleNamespace(
            names=tuple("abcd"), places=lambda index, asked: [2 * index + keys.index(k) for k in asked]
        )
        asked = []
        monkeypatch.setattr(module, "ScoreContext", lambda fit, draws: None)
        monkeypatch.setattr(
            module, "CaseColumns", lambda fit, index: SimpleNamespace(trials=lambda effect: f"of {index}")
        )

        def scored(context, effect, trials, index):
            asked.append((trials, index))
            return score(STEP, 99.0, (0.7,), ({"t0": 2.0},))

        monkeypatch.setattr(module, "score_in_case", scored)
        assert distant_changepoints(fit, STEP, DEFAULT) == {"a": 5.0, "b": 1.5, "c": 2.0, "d": 0.7}
        assert asked == [("of 1", 1)]

    @pytest.mark.parametrize(
        ("value", "raised", "moved"),
        [
            (DEFAULT.changepoint_score + 0.1, True, True),
            (DEFAULT.changepoint_score - 0.1, True, False),
            (1e3, False, False),
        ],
    )
    def test_a_significant_score_moves_a_changepoint_far_away(self, monkeypatch, value, raised, moved):
        fit = stepping(2.0, 5.0)
        fit.noise = (noise(raised=raised),)
        monkeypatch.setattr(module, "ScoreContext", lambda fit, draws: None)
        columns = SimpleNamespace(trials=lambda effect: [])
        monkeypatch.setattr(module, "CaseColumns", lambda fit, index: columns)
        scored = score(STEP, value, (0.7,), ({"t0": 2.0},))
        monkeypatch.setattr(module, "score_in_case", lambda *_: scored)
        found = distant_changepoints(fit, STEP, DEFAULT)
        expected = {"touchpoint.step.t0": 2.0, "touchpoint.step.k": 0.7, "level": 0.0}
        assert found == (expected if moved else {})


def layout(*labels):
    records = tuple(SimpleNamespace(label=x) for x in labels)
    return SimpleNamespace(problem=SimpleNamespace(layout=SimpleNamespace(records=records)))


class TestInitialValues:
    def test_a_strength_and_its_shape(self):
        found = initial_values_of(layout("a"), score(STEP, gamma=(-2.0,), shape=({"t0": 4.0},)))
        assert found == {"touchpoint.step.k": -2.0, "touchpoint.step.t0": 4.0}

    @pytest.mark.parametrize("phase", [0.3, 2.0, -2.5])
    def test_sine_and_cosine_make_strength_and_phase(self, phase):
        """k cos(phi) at phase 0 and k sin(phi) at a quarter period."""
        gamma = (2.0 * math.cos(phase), 2.0 * math.sin(phase))
        found = initial_values_of(layout("a"), score(PERIODIC, gamma=gamma, shape=({"m": 7.0},)))
        assert found == {
            "casing.precession.k": pytest.approx(2.0),
            "casing.precession.phi": pytest.approx(phase),
            "casing.precession.m": 7.0,
        }

    def test_each_case_has_its_own_strength_and_phase_but_one_shape(self):
        gamma = (2.0, 0.0, 0.0, 3.0)
        shape = ({"m": 7.0}, {"m": 7.0})
        found = initial_values_of(layout("a", "b"), score(PERIODIC, gamma=gamma, shape=shape, own_phase=True))
        assert found == {
            "casing.precession.k@a": pytest.approx(2.0),
            "casing.precession.phi@a": pytest.approx(0.0),
            "casing.precession.k@b": pytest.approx(3.0),
            "casing.precession.phi@b": pytest.approx(math.pi / 2),
            "casing.precession.m": 7.0,
        }
        common = initial_values_of(layout("a", "b"), score(PERIODIC, gamma=gamma[:2], shape=shape))
        assert set(common) == {"casing.precession.k", "casing.precession.phi", "casing.precession.m"}

    def test_a_law_of_each_case_has_all_its_values_per_case(self):
        found = initial_values_of(
            layout("a", "b"), score(STEP, gamma=(2.0, 5.0), shape=({"t0": 1.0}, {"t0": 6.0}))
        )
        assert STEP.per_case
        assert found == {
            "touchpoint.step.k@a": 2.0, "touchpoint.step.t0@a": 1.0,
            "touchpoint.step.k@b": 5.0, "touchpoint.step.t0@b": 6.0,
        }  # fmt: skip

    def test_a_common_phase_starts_at_the_mean(self):
        found = with_common_phase(score(PERIODIC, gamma=(2.0, 0.0, 4.0, 3.0), own_phase=True))
        assert found.gamma.tolist() == [3.0, 1.5]
        assert (found.columns, found.own_phase) == (2, False)


class TestFitOfBoth:
    """What is held, shared and given to the fit of base and candidate."""

    def asked(self, monkeypatch, scored, *args, deviance=5.0, **options):
        given = []

        def fit(model, base, **rest):
            given.append(rest)
            if deviance is None:
                raise EstimationError("it diverges", "")
            return Found(deviance)

        monkeypatch.setattr(module, "fit", fit)
        base = Found(
            model=SimpleNamespace(with_effect=lambda e: e),
            problem=SimpleNamespace(layout=SimpleNamespace(records=(SimpleNamespace(label="a"),) * 2)),
        )
        return module.fit_together(base, scored, *args, **options), given[0]

    def test_shape_constants_are_held_until_the_others_have_converged(self, monkeypatch):
        scored = score(PERIODIC, gamma=(2.0, 0.0), shape=({"m": 7.0},))
        _, asked = self.asked(monkeypatch, scored)
        assert asked["start"] == {
            "a.k": 1.0, "b.k": 2.0, "casing.precession.k": 2.0, "casing.precession.phi": 0.0,
            "casing.precession.m": 7.0,
        }  # fmt: skip
        assert asked["steady"] == ["casing.precession.m"]
        assert (asked["quick"], asked["per_case"], asked["share"]) == (True, [], ())
        _, asked = self.asked(monkeypatch, scored, hold_strength=True)
        assert {*asked["steady"]} == {"casing.precession.k", "casing.precession.phi", "casing.precession.m"}
        _, asked = self.asked(monkeypatch, scored, {"casing.precession.m": 9.0}, ["casing.precession.k"])
        assert asked["start"]["casing.precession.m"] == 9.0
        assert (asked["start"]["a.k"], asked["start"]["casing.precession.k"]) == (1.0, 2.0)
        assert (asked["steady"], asked["share"]) == ((), ["casing.precession.k"])

    def test_strength_and_phase_of_each_case(self, monkeypatch):
        scored = score(PERIODIC, gamma=(2.0, 0.0, 1.0, 0.0), shape=({"m": 7.0},) * 2, own_phase=True)
        _, asked = self.asked(monkeypatch, scored)
        assert asked["per_case"] == ["casing.precession.k", "casing.precession.phi"]

    @pytest.mark.parametrize("deviance", [math.inf, math.nan, None])
    def test_a_fit_without_a_finite_deviance_is_none(self, monkeypatch, deviance):
        assert self.asked(monkeypatch, score(), deviance=deviance)[0] is None

    def test_common_values_start_at_the_mean_of_the_cases(self, monkeypatch):
        asked = []
        monkeypatch.setattr(
            module, "fit_together", lambda base, scored, start, keys: asked.append((start, keys))
        )

        def estimate(value):
            return Estimate(value, 0.1, "N m", at_bound=False)

        found = SimpleNamespace(
            problem=SimpleNamespace(layout=SimpleNamespace(per_case=("touchpoint.step.k", "other.k"))),
            estimates={"touchpoint.step.k@a": estimate(1.0), "touchpoint.step.k@b": estimate(4.0)},
            values={"touchpoint.step.k@a": 1.0, "rest": 3.0},
        )
        with_common_values(None, score(STEP), found)
        assert asked == [
            ({"touchpoint.step.k@a": 1.0, "rest": 3.0, "touchpoint.step.k": 2.5}, ["touchpoint.step.k"])
        ]
        assert with_common_values(None, score(DRAG), found) is None
        assert len(asked) == 1

    def test_all_parameters_of_a_candidate_take_common_values(self, monkeypatch):
        asked = []
        monkeypatch.setattr(module, "fit_together", lambda *given: asked.append(given[2:]))
        keys = ("touchpoint.step.k", "touchpoint.step.t0")
        per_case = SimpleNamespace(per_case=("bearing.linear.d", *keys))
        values = {f"{k}@{label}": i + j for i, k in enumerate(keys) for j, label in enumerate("ab")}
        found = SimpleNamespace(
            problem=SimpleNamespace(layout=per_case),
            estimates={k: Estimate(float(v), 0.1, "1", at_bound=False) for k, v in values.items()},
            values={},
        )
        with_common_values(None, score(STEP), found)
        assert asked == [(dict(zip(keys, (0.5, 1.5), strict=True)), list(keys))]

    @pytest.mark.parametrize(("deviance", "taken"), [(99.0, True), (101.0, False)])
    def test_values_of_each_case_start_at_the_common_ones(self, monkeypatch, deviance, taken):
        asked = []
        monkeypatch.setattr(
            module, "fit_together", lambda base, scored, start: asked.append(start) or Found(deviance)
        )
        names = ("touchpoint.step.k@a", "touchpoint.step.k@b", "rest", "unknown")
        found = Found(problem=SimpleNamespace(layout=SimpleNamespace(names=names)))
        common = Found(values={"touchpoint.step.k": 2.5, "rest": 3.0})
        kept = with_values_per_case(None, score(STEP), found, common)
        assert asked == [{"touchpoint.step.k@a": 2.5, "touchpoint.step.k@b": 2.5, "rest": 3.0}]
        assert (kept is not found) is taken


class TestShapeParameter:
    """Laws whose exponent, or width of a step, can be a parameter."""

    @pytest.mark.parametrize(
        ("law", "lower", "upper"),
        [
            ("rotor.air.quadratic", 1.0, 3.0),
            ("casing.air.laminar", 0.5, 2.5),
            ("bearing.quadratic", 1.0, 3.0),
            ("bearing.load", 1.0, 3.0),
            ("touchpoint.load", 1.0, 3.0),
            ("casing: -k*abs(omega_c)**0.5*sign(omega_c)", 0.1, 1.5),
        ],
    )
    def test_at_its_exponent_a_power_is_the_law_of_the_library(self, law, lower, upper):
        effect = resolve(law)
        general = with_shape_parameter(effect)
        strength, exponent = general.parameters
        assert (exponent.lower, exponent.upper) == (lower, upper)
        assert exponent.start == upper - 1
        for speed in (-30.0, 2.0):
            known = {"omega_c": speed, "omega_r": 2 * speed, "delta": -3 * speed, strength.symbol: 1.5}
            old, new = (value_of(e, known | {"n": exponent.start}) for e in (effect, general))
            assert new == pytest.approx(old)
            steeper = value_of(general, known | {"n": exponent.start + 1})
            assert abs(steeper / new) in (pytest.approx(x * abs(speed)) for x in (1, 2, 3))

    def test_a_wide_step_rises_from_zero_to_its_strength(self):
        general = with_shape_parameter(STEP)
        width = general.parameters[-1]
        assert (width.symbol, width.lower, width.upper) == ("w", 1e-3, 1e3)
        assert (general.breakpoint, with_shape_parameter(general)) == ("", None)
        known = {"omega_c": 3.0, "k": 2.0, "t0": 7.0, "w": 0.5}
        values = [value_of(general, known | {"t": 7.0 + 0.5 * x}) for x in (-20.0, -1.0, 0.0, 1.0, 20.0)]
        expected = [0.0, 1 / (1 + math.exp(2.0)), 0.5, 1 / (1 + math.exp(-2.0)), 1.0]
        assert values == pytest.approx([-2.0 * x for x in expected], abs=1e-12)

    @pytest.mark.parametrize(
        "law",
        [
            "touchpoint.constant",
            "bearing.power",
            "casing.precession",
            "casing: -k*omega_c*omega_r**2",
            "casing: -k*omega_c**2*sign(omega_c)*t",
            "casing: -k*omega_c**2*sin(psi_c)",
            "casing: -k*omega_c**2*exp(-t/w)",
        ],
    )
    def test_of_other_laws_there_is_none(self, law):
        assert with_shape_parameter(resolve(law)) is None

    def test_a_law_with_a_state_has_none(self):
        warm = replace(resolve("casing: -k*omega_c**2"), state=State("T", "omega_c"))
        assert with_shape_parameter(warm) is None

    def test_a_step_with_a_second_shape_has_none(self):
        law = "-k*heaviside(t - t0)*sign(omega_c)*exp(-t/s)"
        (second,) = (p for p in resolve("casing: k*exp(-t/s)").parameters if p.role == "shape")
        assert with_shape_parameter(replace(STEP, law=law, parameters=(*STEP.parameters, second))) is None

    def test_the_other_effects_of_the_model_keep_their_laws(self, monkeypatch):
        models = []
        monkeypatch.setattr(module, "fit", lambda model, *_, **__: models.append(model) or Found(50.0))
        monkeypatch.setattr(module, "refined", lambda found, criteria: found)
        with_free_shape(Found(model=SimpleNamespace(effects=(STEP, DRAG))), DRAG, DEFAULT)
        assert models[0].effects == (STEP, with_shape_parameter(DRAG))


def value_of(effect, known):
    return float(Tape([effect.expression])(known)[0])


class TestFreeShape:
    """A quadratic drag whose exponent is freed; a step whose width is tried at four values."""

    def freed(self, monkeypatch, effect, deviances, bic):
        starts = []

        def fit(model, base, *, share, start, noise, quick):
            assert share == [next(k for k in start if k.endswith((".n", ".w")))]
            starts.append(start[share[0]])
            deviance = deviances[len(starts) - 1]
            if deviance is None:
                raise EstimationError("it diverges", "")
            return Found(deviance, bic=bic(deviance))

        monkeypatch.setattr(module, "fit", fit)
        monkeypatch.setattr(module, "refined", lambda found, criteria: found)
        found = Found(values={}, model=SimpleNamespace(effects=(effect,)))
        return with_free_shape(found, effect, DEFAULT), starts

    @pytest.mark.parametrize(("margin", "free"), [(0.1, True), (-0.1, False)])
    def test_a_constant_is_freed_by_its_evidence(self, monkeypatch, margin, free):
        bic = 100.0 - DEFAULT.shape_evidence - margin
        found, starts = self.freed(monkeypatch, DRAG, [50.0], lambda _: bic)
        assert (found is not None) is free
        assert starts == [2.0]

    def test_the_best_of_several_initial_widths_is_taken(self, monkeypatch):
        found, starts = self.freed(monkeypatch, STEP, [50.0, None, 30.0, 40.0], lambda d: d)
        assert starts == [0.02, 0.1, 0.5, 2.0]
        assert found.deviance == 30.0

    def test_without_a_fit_there_is_no_free_constant(self, monkeypatch):
        assert self.freed(monkeypatch, DRAG, [None], lambda d: d)[0] is None
        assert with_free_shape(Found(), LIBRARY["touchpoint.constant"], Criteria()) is None


class TestReplacedLaws:
    """A constant torque replaces the dry friction that is at its bound while the body does not turn back."""

    TORQUE = LIBRARY["external.constant"]

    def base(self, at_bound=True, reversals=0, cases=1):
        keys = [f"touchpoint.constant.b1{f'@{i}' if cases > 1 else ''}" for i in range(cases)]
        own = {k: SimpleNamespace(at_bound=at_bound or (cases > 1 and i > 0)) for i, k in enumerate(keys)}
        other = {"casing.air.linear.b2": SimpleNamespace(at_bound=True)}
        run = SimpleNamespace(motion=SimpleNamespace(reversals=np.zeros(reversals)))
        model = Model.of(["touchpoint.constant", "casing.air.linear"])
        return SimpleNamespace(
            model=model, estimates=own | other, problem=SimpleNamespace(data=[run] * cases)
        )

    @pytest.mark.parametrize(
        ("given", "replaced"),
        [
            ({}, True),
            ({"at_bound": False}, False),
            ({"reversals": 1}, False),
            ({"cases": 2}, True),
            ({"cases": 2, "at_bound": False}, False),
        ],
    )
    def test_a_law_at_its_bound_is_replaced_by_its_equivalent(self, given, replaced):
        base = self.base(**given)
        assert replaced_laws(base, self.TORQUE) == ["touchpoint.constant"] * replaced
        kept = () if replaced else ("touchpoint.constant",)
        assert with_candidate(base, self.TORQUE).names == (*kept, "casing.air.linear", "external.constant")

    def test_another_effect_replaces_nothing(self):
        assert replaced_laws(self.base(), DRAG) == []

    def test_the_torque_of_a_body_that_speeds_up_is_named_with_its_strength(self):
        """1.242e-4 N m on 2e-5 kg m2: 6.21 rad/s2. Beside a dry friction of any strength it was not determined."""
        t = np.arange(0.0, 2.3, 0.02)
        angle = 0.05 * t + 0.5 * 6.21 * t**2 + 1e-3 * np.random.default_rng(0).standard_normal(len(t))
        case = Case.from_arrays(wheel={"t": t, "angle": angle, "u": 1e-3, "inertia": 2e-5})
        found = diagnose(fit(["touchpoint.constant", "casing.air.linear"], case), brief=True)
        assert found.verdict == "missing_effect"
        assert found.candidates[0].effect.name == "external.constant"
        k = found.candidates[0].fit.estimates["external.constant.k"]
        assert k.value == pytest.approx(1.242e-4, abs=3 * k.stderr)
        assert k.stderr < 3e-7
