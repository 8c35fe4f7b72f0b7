"""Detection limits, upper limits, rivals, the next run, and descriptions of recordings."""

import itertools
import math
from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace

import cases
import numpy as np
import pytest
import twobody
from scipy.stats import norm

from fitting import LIBRARY, REDUCED, EstimationError, Model, make_record, plan, simulate
from fitting._criteria import DEFAULT
from fitting.discovery import _next_run
from fitting.discovery._information import Information, Rival, Run, rivals, schur, simulated
from fitting.discovery._next_run import Bounds, next_run, separating_run
from fitting.discovery._power import Search, ShiftedToBound, delta_of_power, largest_hidden, upper_limit
from fitting.dynamics._collocation import Sampler
from fitting.inference._fit import fit
from fitting.planning._plan import read_planned

DRAG = LIBRARY["casing.air.quadratic"]
NOISE = 1e-7


@lru_cache(maxsize=2)
def base():
    return cases.fitted(seed=0, ou=NOISE, few=True)


@lru_cache(maxsize=1)
@lru_cache(maxsize=1)
def search():
    return Search(base())


@lru_cache(maxsize=1)
def drag():
    return search().limits(DRAG, 1e-6)


PLAN = """
model = "reduced"
[inertia]
rotor = 5.54e-5
casing = 2.06e-5
[parameters]
"rotor.air.quadratic.a2" = 9.97e-11
"touchpoint.constant.b1" = 2.88e-06
"casing.air.linear.b2" = 8.28e-07
"bearing.linear.d" = 1.57e-07
"bearing.power.f" = 1.26e-08
"bearing.power.g" = 1.32
[noise]
angle = 1e-3
torque = 1e-7
torque_time = 1.0
[[run]]
omega_rotor = 900.0
omega_casing = 5.0
duration = 60.0
casing_fps = 60.0
rotor_fps = 250.0
windows = [2.0, 30.0, 50.0]
window_length = 3.0
"""


@pytest.fixture
def described(tmp_path):
    """Write a description with one change."""

    def write(old="", new=""):
        assert old in PLAN
        path = tmp_path / "plan.toml"
        path.write_text(PLAN.replace(old, new, 1) if old else PLAN)
        return path

    return write


class TestUpperLimit:
    def test_upper_limit_of_a_signed_strength_has_95_percent_coverage(self):
        random = np.random.default_rng(1)
        for true in (0.0, 0.5, 3.0):
            limits = [
                upper_limit(np.array([true + e]), one_sided=False) for e in random.standard_normal(4000)
            ]
            assert np.mean(np.array(limits) >= true) >= 0.95 - 3 * math.sqrt(0.05 * 0.95 / 4000)

    def test_upper_limit_of_a_friction_is_the_one_sided_normal_limit(self):
        assert upper_limit(np.array([2.0]), one_sided=True) == pytest.approx(2.0 + norm.ppf(0.95))
        assert upper_limit(np.array([-2.0]), one_sided=True) == pytest.approx(norm.ppf(0.95))

    def test_upper_limit_of_an_amplitude_with_a_phase_has_95_percent_coverage(self):
        random = np.random.default_rng(2)
        for true in (1.0, 4.0):
            draws = random.standard_normal((1500, 2)) + np.array([true, 0.0])
            covered = np.mean([upper_limit(d, one_sided=False) >= true for d in draws])
            assert covered >= 0.95 - 3 * math.sqrt(0.05 * 0.95 / 1500)
            assert covered < 0.99 or true < 2


def test_the_noncentrality_of_90_percent_power():
    delta = np.linspace(0, 10, 21)
    curve = np.stack([delta, norm.cdf(delta - 3.0)], axis=1)
    assert delta_of_power(curve) == pytest.approx(3.0 + norm.ppf(0.9), abs=0.02)
    assert delta_of_power(np.stack([delta, np.full(21, 0.5)], axis=1)) == np.inf


class TestLimits:
    @pytest.mark.slow
    def test_the_standard_error_is_that_of_a_fit_with_the_effect(self):
        found = fit(base().model.with_effect(DRAG), base().problem.data, noise=base().noise)
        stderr = found.estimates["casing.air.quadratic.k"].stderr
        assert drag().stderr == pytest.approx(stderr, rel=0.1)
        assert drag().unit == "N m s2"

    @pytest.mark.slow
    def test_the_torque_is_the_rms_along_the_motion(self):
        path = base().predictions[0].path
        t = np.linspace(*base().problem.data[0].record.span, 3000)
        omega_c = Sampler(path.mesh, t).value(path.y[..., 1])
        assert drag().torque == pytest.approx(np.sqrt(np.mean(omega_c**4)), rel=0.01)
        assert drag().detection_torque == pytest.approx(drag().detection_limit * drag().torque)

    @pytest.mark.slow
    def test_the_detection_limit_has_90_percent_power_and_the_false_alarm_rate_is_the_significance(self):
        power = search().power(DRAG, 0, np.array([0.0, drag().detection_limit]))
        assert power[1] == pytest.approx(0.9, abs=0.03)
        assert power[0] <= DEFAULT.significance + 3 * math.sqrt(0.03 / 600)

    @pytest.mark.slow
    def test_detection_limit_contains_the_correction_for_many_candidates(self):
        """A single candidate at the same significance has a smaller detection limit."""
        alone = norm.ppf(1 - DEFAULT.significance) + norm.ppf(0.9)
        assert drag().detection_limit / drag().stderr > alone + 0.5

    @pytest.mark.slow
    def test_twice_the_size_needs_a_quarter_of_the_runs(self):
        small, large = (search().limits(DRAG, s * drag().detection_torque) for s in (0.1, 0.2))
        # BIC asks for a little more in more rows
        assert 100 <= small.runs_needed <= 160
        assert 25 <= large.runs_needed <= 40
        assert small.power < large.power < 0.5

    @pytest.mark.slow
    def test_no_number_of_runs_finds_an_effect_whose_power_never_reaches_90_percent(self):
        flat = np.stack([np.linspace(0.0, 14.0, 20), np.full(20, 0.3)], axis=1)
        assert delta_of_power(flat) == math.inf
        assert search()._runs(DRAG, 3.0, math.inf) == math.inf

    @pytest.mark.slow
    def test_absorbed_effects_have_no_limit(self):
        constant = search().limits(LIBRARY["external.constant"])
        assert constant.absorbed
        assert math.isinf(constant.detection_limit)
        assert math.isinf(constant.upper_limit)

    @pytest.mark.slow
    def test_windage_and_bearing_load_are_indistinguishable(self):
        assert "bearing.load" in search().limits(LIBRARY["casing.windage"], 1e-6).indistinguishable_from

    @pytest.mark.slow
    def test_upper_limit_of_planned_data_is_the_expected_one(self):
        expected = search().limits(DRAG, planned=True)
        assert expected.upper_limit == pytest.approx(norm.ppf(0.95) * expected.stderr)


@pytest.mark.slow
@pytest.mark.release
def test_an_effect_that_shifts_a_parameter_to_its_bound_has_a_smaller_detection_limit(described):
    """Drift of the bearing shifts the exponent g; held at its bound of 1.4, g no longer absorbs the drift."""
    few, usual = "casing_fps = 60.0\nrotor_fps = 250.0", "casing_fps = 260.0\nrotor_fps = 1000.0"
    recordings = read_planned(described(few, usual))
    found = recordings.fit()
    looked = Search(found, truth=recordings.numbers)
    drift = LIBRARY["bearing.drift"]
    limit = looked.limits(drift)
    assert limit.detection_limit < 3 * limit.stderr
    strength = 1.5 * limit.detection_limit
    record = simulate(
        Model.of([*REDUCED, "bearing.drift"]),
        recordings.numbers | {"bearing.drift.k": strength},
        recordings.experiments[0],
        inertia_rotor=5.54e-5,
        inertia_casing=2.06e-5,
        seed=11,
    )
    wrong = fit(Model.of(REDUCED), [record])
    assert wrong.estimates["bearing.power.g"].at_bound
    scored = Search(wrong).scores()["bearing.drift"]
    assert scored.score > scored.threshold


@pytest.mark.slow
def test_a_less_certain_process_noise_needs_a_higher_score_and_has_less_power():
    process = base().noise[0].process
    known = replace(process, ratios=np.ones(1), weights=np.ones(1))
    # with a probability of 10 % the variance of slow rows is eightfold
    wide = replace(process, ratios=np.array([1.0, 8.0]), weights=np.array([0.9, 0.1]))

    def of(*estimates):
        return Search(replace_noise(base(), estimates[0]), draws=150, process=[(p,) for p in estimates[1:]])

    both = of(known, wide)
    (test,) = both._tests[DRAG.name]
    assert test.thresholds.shape == (2,)
    assert 2 * test.thresholds[0] < test.thresholds[1] < 9 * test.thresholds[0]
    powers = [x.limits(DRAG, planned=True).curve for x in (of(known), both, of(wide))]
    assert delta_of_power(powers[0]) < delta_of_power(powers[1]) <= delta_of_power(powers[2])
    # half of the data sets have each threshold
    half = np.interp(3.8, *powers[1].T)
    assert half == pytest.approx(0.5 * (np.interp(3.8, *powers[0].T) + np.interp(3.8, *powers[2].T)), abs=0.1)


def replace_noise(found, process):
    """Return a fit with another estimate of the process noise."""
    return replace(found, noise=tuple(replace(n, process=process) for n in found.noise))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_the_upper_limit_is_that_of_a_fit_with_the_effect(seed):
    """Recording by recording: the coverage of such fits is tested in test_coverage.py, that of a limit above."""
    true = 5e-11  # N m s2: three standard errors
    hidden = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -true * wc**2)
    motion = twobody.simulate(seed=seed, ou=NOISE, hidden=hidden)
    base = fit(Model.of(REDUCED), [make_record(**twobody.film(motion, seed, twobody.FEWER_FRAMES))])
    limits = Search(base, draws=1).limits(DRAG)
    k = fit(base.model.with_effect(DRAG), base.problem.data, noise=base.noise).estimates[f"{DRAG.name}.k"]
    assert limits.stderr == pytest.approx(k.stderr, rel=0.05)
    assert abs(k.value - true) < 3 * k.stderr
    assert limits.upper_limit == pytest.approx(k.value + norm.ppf(0.95) * k.stderr, abs=0.1 * k.stderr)


class TestHidden:
    @pytest.mark.slow
    def test_hidden_effects_are_sorted_by_torque(self):
        found = largest_hidden(base(), (), DEFAULT).limits
        torques = [u.torque_Nm for u in found]
        assert len(found) == 5
        assert torques == sorted(torques, reverse=True)
        assert all(LIBRARY[u.effect].kind == "physical" for u in found)


@lru_cache(maxsize=1)
def information():
    names = ("casing.air.quadratic", "casing.windage", "bearing.load", "bearing.quadratic", "touchpoint.load")
    return Information(base(), [(LIBRARY[n], {}) for n in names])


class TestInformation:
    @pytest.mark.slow
    def test_information_and_search_give_the_same_standard_error(self):
        info = information()
        places = info.places(0)
        left = schur(info.present, places, range(info.parameters))
        assert 1 / math.sqrt(left[0, 0]) == pytest.approx(drag().stderr, rel=1e-3)

    @pytest.mark.slow
    def test_information_of_a_planned_run_is_that_of_the_measured_run(self):
        """The present run, planned again: the coarse simulation has the same information about a torque within 10 %."""
        info = information()
        e = base().estimates
        label = base().labels[0]
        record = base().problem.data[0].record
        run = Run(
            e[f"initial.omega_r@{label}"].value,
            e[f"initial.omega_c@{label}"].value,
            record.span[1] - record.span[0],
            tuple(float(w.time[0]) for w in record.rotor),
            float(record.rotor[0].time[-1] - record.rotor[0].time[0]),
        )
        added, _ = info.of_run(run)
        made, planned = (
            schur(total, info.places(0), range(info.parameters))[0, 0] for total in (info.present, added)
        )
        assert planned == pytest.approx(made, rel=0.2)

    @pytest.mark.slow
    def test_twice_the_inertia_halves_the_acceleration_of_the_casing(self):
        run = Run(800.0, 5.0, 60.0, (1.0, 20.0, 50.0), 3.0)
        gained = []
        for r in (run, replace(run, ring=2.0)):
            path = simulated(base(), r).predictions[0].path
            gained.append(float(np.diff(Sampler(path.mesh, np.array([0.0, 0.3])).value(path.y)[:, 1])[0]))
        assert gained[1] == pytest.approx(0.5 * gained[0], rel=0.03)


class Hill(_next_run._RunSearch):
    """A search whose value falls with the distance of the settings from known ones; nothing is simulated."""

    def __init__(self, best, evaluations):
        self.best, self._evaluations, self._count = np.array(best), evaluations, 0
        self.tried = [SimpleNamespace(x=np.full(len(best), 0.1), sense=1.0, value=-math.inf)]

    def _keep(self, x, sense):
        self._count += 1
        self.tried.append(SimpleNamespace(x=x, sense=sense, value=-float(np.abs(x - self.best).sum())))


class Survey(_next_run._RunSearch):
    """A search whose first runs are listed; the separation of each pair of rivals in each run is given."""

    def __init__(self, separations=(), evaluations=60, windows=3, start=45.0, *, reversible=True):
        self._bounds = SimpleNamespace(omega_casing=(20.0, 70.0), reversible=reversible)
        self._start, self._evaluations, self._windows = start, evaluations, windows
        self._rivals, self._criteria, self.tried, self.runs = tuple(separations[:1]), DEFAULT, [], []
        self._information = SimpleNamespace(present=100)
        self._inseparable, self._separations = [], separations
        self._criterion = SimpleNamespace(pairs=lambda total: separations[total - 100])

    def _keep(self, x, sense):
        self.runs.append((x, sense))
        if len(self.tried) < len(self._separations):
            self.tried.append(_next_run._Tried(math.nan, x, sense, None, len(self.tried), None))


def criterion(rivals=(), ignored=()):
    """Of two parameters and two candidates, one with a phase; the information of the present runs is diagonal."""
    places = [[2], [3, 4]]
    known = SimpleNamespace(parameters=2, candidates=places, present=PRESENT, places=lambda i: places[i])
    return _next_run._Criterion(known, rivals, DEFAULT, ignored)


PRESENT = np.diag([1.0, 1.0, 4.0, 6.0, 10.0])
TWO_RIVALS = (Rival(("a",), (2,), np.array([2.0])), Rival(("b",), (3,), np.array([3.0])))


class TestCriterion:
    def test_the_information_about_a_candidate_is_the_mean_of_its_columns_with_free_parameters(self):
        coupled = PRESENT.copy()
        coupled[0, 2] = coupled[2, 0] = 1.0
        assert criterion().limits(PRESENT) == pytest.approx([4.0, 8.0])
        assert criterion().limits(coupled) == pytest.approx([3.0, 8.0])

    @pytest.mark.parametrize(("power", "value"), [(3.0, 2.0), (-1.0, 0.0), (120.0, 25.5)])
    def test_without_rivals_a_run_has_the_mean_logarithm_of_its_gains(self, power, value):
        """One candidate gains a factor e, the other a power of it, of which at most the fiftieth counts."""
        total = PRESENT @ np.diag(np.exp([0.0, 0.0, 1.0, power, power]))
        assert criterion()(total) == pytest.approx(value)

    @pytest.mark.parametrize(
        ("factor", "then"), [(2.0, 32.0), (0.5, 8.0), (6.0, 96.0), (7.0, 100.0), (90.0, 100.0)]
    )
    def test_the_separation_of_rivals_counts_up_to_four_times_the_wanted_one(self, factor, then):
        """Four times 5^2; the closest pair has a separation of 16 now."""
        total = PRESENT @ np.diag([1.0, 1.0, factor, factor, factor])
        expected = math.log(factor) + math.log((1 + then) / 17.0)
        assert criterion(TWO_RIVALS)(total) == pytest.approx(expected)

    def test_separations_are_those_of_the_strengths_of_each_rival_beside_the_other(self):
        assert criterion(TWO_RIVALS).pairs(PRESENT) == pytest.approx({(0, 1): 16.0, (1, 0): 54.0})
        assert criterion(TWO_RIVALS, [(0, 1)]).separation(PRESENT) == pytest.approx(54.0)
        assert math.isnan(criterion(TWO_RIVALS, [(0, 1), (1, 0)]).separation(PRESENT))
        assert criterion(TWO_RIVALS, [(0, 1), (1, 0)])(PRESENT) == 0.0

    def test_what_rivals_have_in_common_separates_nothing(self):
        coupled = PRESENT.copy()
        coupled[2, 3] = coupled[3, 2] = 2.0
        both = Rival(("a", "b"), (3, 2), np.array([3.0, 2.0]))
        found = criterion((both, TWO_RIVALS[1])).pairs(coupled)
        assert found == pytest.approx({(0, 1): 4.0 * (4.0 - 4.0 / 6.0)})


class Apparatus(Survey):
    """A search of one run, of given values with other rings and surfaces."""

    def __init__(self, gains):
        super().__init__()
        run = Run(500.0, 5.0, 60.0, (), 0.0)
        self._bounds = Bounds((0.0, 1.0), (0.0, 1.0), (1.0, 2.0), (1.0, 1.5), (0.5, 3.0))
        self.asked, self.gains = [], iter(gains)
        self.tried = [_next_run._Tried(1.0, "x", -1.0, run, None, None)]

    def _try(self, x, sense, run):
        self.asked.append((x, sense, run.ring, run.surface))
        gain = next(self.gains)
        return gain and _next_run._Tried(1.0 + math.log(gain), x, sense, run, None, None)


class TestRuns:
    @pytest.mark.parametrize(
        ("share", "duration", "starts", "length"),
        [
            (0.25, 20.0, (1.4, 9.0, 16.6), 2.0),
            (0.0, 10.0, (0.4, 4.0, 7.6), 2.0),
            (-0.125, 5.0, (0, 5 / 3, 10 / 3), 5 / 3),
        ],
    )
    def test_a_point_of_the_search_is_a_run_within_the_bounds(self, share, duration, starts, length):
        """Windows do not overlap, and are shorter if the run is short."""
        search = Survey()
        search._bounds = SimpleNamespace(
            omega_rotor=(300.0, 900.0), omega_casing=(20.0, 70.0), duration=(10.0, 50.0)
        )
        search._length = 2.0
        run = search._run(np.array([0.5, 0.2, share, 0.9, 0.1, 0.5]), -1.0)
        assert (run.omega_rotor, run.omega_casing, run.duration) == pytest.approx((-600.0, 30.0, duration))
        assert run.windows == pytest.approx(starts)
        assert run.window_length == pytest.approx(length)
        assert (run.ring, run.surface) == (1.0, 1.0)

    def test_another_apparatus_must_gain_half_as_much_again(self):
        search = Apparatus([1.49, 1.51, None])
        search.vary_apparatus()
        assert search.asked == [("x", -1.0, 1.5, 1.0), ("x", -1.0, 1.0, 0.5), ("x", -1.0, 1.0, 3.0)]
        assert [(t.run.ring, t.run.surface) for t in search.tried] == [(1.0, 1.0), (1.0, 0.5)]

    def test_the_result_compares_the_run_with_none_and_with_a_repetition(self, monkeypatch):
        search = Apparatus([])
        path = SimpleNamespace(mesh="mesh", y="y")
        planned = SimpleNamespace(predictions=[SimpleNamespace(path=path)])
        search.tried = [search.tried[0]._replace(added=5.0, planned=planned)]
        candidates = [(SimpleNamespace(name=n), {}) for n in ("a", "b")]
        fitted = SimpleNamespace(problem=SimpleNamespace(cases=["one", "two"]))
        search._information = SimpleNamespace(present=10.0, candidates=candidates, fit=fitted)
        search._rivals = [SimpleNamespace(names=n) for n in (("a",), ("a", "b"))]
        search._inseparable = [(1, 0), (0, 1)]
        search._criterion = SimpleNamespace(
            limits=lambda x: np.array([x**2, 0.0]), separation=lambda x: 100.0 + x
        )
        monkeypatch.setattr(
            _next_run,
            "Sampler",
            lambda mesh, times: SimpleNamespace(value=lambda y: np.stack([times, -times], axis=1)),
        )
        monkeypatch.setattr(_next_run, "_sentence", lambda *_: "in words")
        found = search.result()
        assert (found.separation, found.present, found.repeated) == (115.0, 110.0, 115.0)
        assert found.gains["a"] == pytest.approx(10.0 / 15.0)
        assert math.isnan(found.gains["b"])
        assert found.inseparable == (("a", "a + b"),)
        assert (found.omega_rotor[-1], found.omega_casing[-1], found.sentence) == (60.0, -60.0, "in words")


def words(run, rivals=("a", "b"), separation=36.0, gains=None, inseparable=()):
    """The sentence about a run of a gyroscope whose casing starts at 20 rad/s."""
    bodies = [SimpleNamespace(role="casing"), SimpleNamespace(role="rotor")]
    data = SimpleNamespace(
        record=SimpleNamespace(bodies=bodies, body="casing"),
        initial_speeds=(None, np.array([[600.0, -20.0]])),
    )
    found = SimpleNamespace(
        run=run, rivals=rivals, separation=separation, present=1.0, repeated=4.0, gains=gains or {},
        inseparable=inseparable,
    )  # fmt: skip
    return _next_run._sentence(found, SimpleNamespace(problem=SimpleNamespace(data=[data])), DEFAULT)


class TestSentence:
    @pytest.mark.parametrize(
        ("rotor", "casing", "told"),
        [
            (500.0, 30.9, "start the casing at 30.9 rad/s"), (500.0, -30.9, "start the casing at -30.9 rad/s"),
            (500.0, 31.1, "spin the casing by hand to 31 rad/s with the rotor"),
            (500.0, -31.1, "spin the casing by hand to 31 rad/s against the rotor"),
            (-500.0, -31.1, "spin the casing by hand to 31 rad/s with the rotor"),
        ],
    )  # fmt: skip
    def test_a_casing_that_is_much_faster_than_usual_is_spun_by_hand(self, rotor, casing, told):
        """1.5 times the usual speed and 1 rad/s."""
        sense = " in the other sense of rotation" if rotor < 0 else ""
        text = words(Run(rotor, casing, 60.0, (1.0, 20.0), 2.5))
        assert text.startswith(f"Start the rotor at 500 rad/s{sense}; {told}; record for 60 s; ")
        assert "film the rotor for 2.5 s from 1 s, 20 s" in text

    def test_another_apparatus_is_described(self):
        run = Run(500.0, 5.0, 60.0, (), 0.0)
        assert "times" not in words(run)
        assert "fix a ring to the casing that makes its moment of inertia 1.5 times" in words(
            replace(run, ring=1.5)
        )
        assert "use a surface with 0.5 times the friction" in words(replace(run, surface=0.5))

    @pytest.mark.parametrize(("separation", "enough"), [(24.9, False), (25.1, True)])
    def test_a_separation_below_five_sigma_is_reported(self, separation, enough):
        text = words(Run(500.0, 5.0, 60.0, (), 0.0), separation=separation)
        assert "closest rivals 5.0 sigma (now 1.0; 2.0 after a repetition)" in text
        assert ("This is less than 5 sigma: repeat the run" in text) != enough

    def test_rivals_that_are_not_separated_and_limits_without_rivals(self):
        run = Run(500.0, 5.0, 60.0, (), 0.0)
        assert "No run within the bounds separates a from b + c." in words(run, inseparable=[("a", "b + c")])
        assert words(run, separation=math.nan).startswith("No run within the bounds separates the rivals")
        limits = words(run, (), gains={"a": 0.25, "b": 1.0, "c": math.nan})
        assert limits.endswith("lowers the detection limits to 50 % (geometric mean).")

    def test_a_law_with_a_phase_has_a_cosine_and_a_sine(self):
        role = {"amplitude": "k", "phase": "phi"}
        parameters = [SimpleNamespace(role=r, symbol=x) for r, x in role.items()]
        values = {"k": 2.0, "phi": math.pi / 6}
        both, one = (SimpleNamespace(parameters=p) for p in (parameters, parameters[:1]))
        assert _next_run._strengths(both, values) == pytest.approx([math.sqrt(3.0), 1.0])
        assert _next_run._strengths(one, values) == [2.0]

    @pytest.mark.parametrize(("restoring", "larger"), [(0, False), (1, False), (2, True)])
    def test_restoring_torques_of_an_oscillation_differ_at_larger_angles(self, restoring, larger):
        laws = [SimpleNamespace(depends_on_angle=False, restoring=i < restoring) for i in range(3)]
        data = SimpleNamespace(motion=SimpleNamespace(reversals=[1.0]))
        found = separating_run(
            SimpleNamespace(problem=SimpleNamespace(data=[data])), [("law", [e], {}) for e in laws], DEFAULT
        )
        assert found.startswith("Release the body from a larger angle") == larger
        assert bool(found) == larger


class TestNextRun:
    @pytest.mark.parametrize(("evaluations", "count"), [(3, 4), (30, 10), (60, 20), (90, 20)])
    def test_usual_runs_come_first_and_then_a_third_as_many_as_are_evaluated(self, evaluations, count):
        search = Survey(evaluations=evaluations)
        search.explore()
        assert [x[:3].tolist() for x, _ in search.runs[:4]] == [
            [1.0, 0.5, 0.5], [0.5, 0.5, 0.5], [1.0, 1.0, 0.5], [1.0, 0.0, 0.5]
        ]  # fmt: skip
        assert len(search.runs) == 4 + count
        assert all(x[3:].tolist() == pytest.approx([0.03, 0.5, 0.97]) for x, _ in search.runs)
        assert all(0.0 <= v <= 1.0 for x, _ in search.runs for v in x)

    @pytest.mark.parametrize(("start", "share"), [(10.0, 0.0), (30.0, 0.2), (80.0, 1.0)])
    def test_the_usual_speed_of_the_casing_is_that_of_the_recording_within_the_bounds(self, start, share):
        search = Survey(start=start, windows=1)
        search.explore()
        assert search.runs[0][0].tolist() == pytest.approx([1.0, share, 0.5, 0.03])

    @pytest.mark.parametrize("reversible", [True, False])
    def test_every_third_of_the_further_runs_is_reversed_where_that_is_possible(self, reversible):
        search = Survey(reversible=reversible)
        search.explore()
        backward = [i for i, (_, sense) in enumerate(search.runs) if sense < 0]
        assert backward == ([5, 8, 11, 14, 17, 20, 23] if reversible else [])

    def test_rivals_that_no_run_separates_are_ignored(self, monkeypatch):
        """By a difference of deviance of 1 in one run at least."""
        monkeypatch.setattr(_next_run, "_Criterion", lambda *given: lambda total: (total, given[-1]))
        search = Survey([{(0, 1): 0.2, (1, 0): 0.9}, {(0, 1): 1.1, (1, 0): 0.8}])
        search.explore()
        assert search._inseparable == [(1, 0)]
        assert [t.value for t in search.tried] == [(100, [(1, 0)]), (101, [(1, 0)])]

    @pytest.mark.parametrize("best", [(0.77, 0.3), (0.0, 1.0), (0.1, 0.1)])
    def test_steps_are_halved_only_when_no_setting_is_better(self, best):
        """They begin at a quarter of the range and end at a fiftieth: the last ones are 1 / 32."""
        search = Hill(best, 200)
        search.refine()
        assert search._best.x == pytest.approx(best, abs=1 / 32)
        assert search._count < 200
        few = Hill(best, 3)
        few.refine()
        assert few._count == 3

    @pytest.mark.slow
    def test_next_run_separates_windage_from_bearing_load_better_than_a_repetition(self):
        info = information()
        found = rivals_of(info, "casing.windage", "bearing.load", 3e-12)
        chosen = next_run(info, found, DEFAULT, Bounds.of(base()), evaluations=24)
        assert chosen.separation > 1.5 * chosen.repeated
        assert chosen.repeated >= chosen.present - 1e-3
        low, high = chosen.bounds.omega_rotor
        assert low <= abs(chosen.run.omega_rotor) <= high * (1 + 1e-9)
        for a, b in zip(chosen.run.windows, chosen.run.windows[1:], strict=False):
            assert b - a >= chosen.run.window_length - 1e-9
        assert chosen.run.windows[-1] + chosen.run.window_length <= chosen.run.duration + 1e-9

    @pytest.mark.slow
    def test_next_run_without_rivals_lowers_the_detection_limits(self):
        chosen = next_run(information(), [], DEFAULT, Bounds.of(base()), evaluations=16)
        assert all(g <= 1 + 1e-9 for g in chosen.gains.values())
        assert min(chosen.gains.values()) < 0.7
        assert chosen.rivals == ()
        assert "rad/s" in chosen.sentence

    def test_a_single_body_has_a_next_run_without_films_of_a_rotor(self):
        t = np.arange(0.0, 6.0, 0.02)
        angle = 40 * t - 0.4 * t**2 + 2e-3 * np.random.default_rng(1).standard_normal(len(t))
        record = make_record(
            casing=(t, angle, np.full(len(t), 2e-3)),
            rotor=[],
            single=True,
            per_inertia=True,
            I_rotor=1,
            I_casing=1,
        )
        found = fit(Model.of(["touchpoint.constant"]), [record])
        info = Information(found, [(LIBRARY["casing.air.quadratic"], {})])
        chosen = next_run(info, [], DEFAULT, Bounds.of(found), evaluations=4)
        assert chosen.run.windows == ()
        low, high = chosen.bounds.omega_casing
        assert low <= chosen.run.omega_casing <= high
        assert "surface" not in chosen.sentence

    def test_a_single_candidate_has_no_rival(self):
        assert separating_run(base(), [], DEFAULT) == ""


def rivals_of(info, a, b, strength):
    from fitting.discovery._information import Rival

    index = {e.name: i for i, (e, _) in enumerate(info.candidates)}
    return [Rival((n,), tuple(info.places(index[n])), np.array([strength])) for n in (a, b)]


@pytest.mark.slow
def test_rivals_are_the_effects_that_the_data_do_not_separate():
    hidden = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: 2e-11 * wr**2)
    motion = twobody.simulate(seed=1, ou=NOISE, hidden=hidden)
    found = fit(Model.of(REDUCED), [make_record(**twobody.film(motion, 1, twobody.FEWER_FRAMES))])
    looked = Search(found)
    scores = looked.scores()
    info = Information(found, [(e, scores[e.name].shape) for e in looked.effects])
    named = {n for r in rivals(info, [s.threshold for s in scores.values()], DEFAULT) for n in r.names}
    assert {"casing.windage", "bearing.load"} <= named


def test_an_adequate_model_has_no_rivals():
    thresholds = [s.threshold for s in search().scores().values()]
    assert rivals(information(), thresholds, DEFAULT) == []


class TestDescription:
    @pytest.mark.slow
    def test_a_plan_is_read_and_simulated_with_its_noise(self, described):
        found = read_planned(described()).fit()
        record = found.problem.data[0].record
        assert record.I_casing == 2.06e-5
        assert len(record.casing) == pytest.approx(60 * 60, abs=1)
        assert record.rotor[1].time[0] == 30.0
        assert found.problem.data[0].casing.scale == pytest.approx(1.0, abs=0.05)
        assert found.noise[0].pure == pytest.approx(NOISE, rel=0.4)

    @pytest.mark.parametrize(("casing", "limit"), [(5.0, 135.0), (-134.0, 135.0), (-136.0, 136.0)])
    def test_bounds_of_the_next_run_are_those_of_the_planned_runs(self, described, casing, limit):
        """The casing reaches 15 % of the speed of the rotor, or what is planned if that is faster."""
        bounds = read_planned(described("omega_casing = 5.0", f"omega_casing = {casing}")).bounds
        assert bounds.omega_rotor == pytest.approx((300.0, 900.0))
        assert bounds.omega_casing == pytest.approx((-limit, limit))
        assert bounds.duration == pytest.approx((30.0, 120.0))

    def test_bounds_in_the_file_replace_the_usual_ones(self, described):
        found = read_planned(described("[[run]]", "[bounds]\nduration = [3, 9]\n[[run]]")).bounds
        assert found.duration == (3.0, 9.0)
        assert found.omega_rotor == pytest.approx((300.0, 900.0))

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            ("casing = 2.06e-5", "", "inertia.casing is missing"),
            ("rotor = 5.54e-5", "rotor = -1", "inertia.rotor: input should be greater than 0"),
            ("rotor = 5.54e-5", 'rotor = "heavy"', "inertia.rotor: input should be a valid number"),
            ("angle = 1e-3", "", "noise.angle is missing"),
            ("angle = 1e-3", "angle = nan", "noise.angle: input should be a finite number"),
            ("angle = 1e-3", "angel = 1e-3", "noise.angle is missing"),
            ("[[run]]", "[[run]]\nspeed = 1", "run.1.speed is an unknown key"),
            ('"bearing.power.g" = 1.32', "", "parameters: no value of bearing.power.g"),
            (
                '"bearing.power.g" = 1.32',
                '"bearing.power.g" = 1.32\n"bearing.h" = 1',
                "'bearing.h' is not a parameter",
            ),
            (
                '"bearing.power.g" = 1.32',
                '"bearing.power.g" = 9',
                "bearing.power.g = 9 is outside 0.3 to 1.4",
            ),
            ('model = "reduced"', 'model = "redused"', "there is no model named 'redused'"),
            ("windows = [2.0, 30.0, 50.0]", "windows = [2.0, 58.0]", "ends after the recording (60 s)"),
            ("windows = [2.0, 30.0, 50.0]", "windows = []", "run.1.windows"),
            ("[noise]", "[noise", "is not valid TOML"),
            ("[[run]]", "[bounds]\nduration = [9, 3]\n[[run]]", "bounds.duration: 9 is larger than 3"),
            ("casing_fps = 60.0", "casing_fps = 1e9", "more than 10 million frames"),
        ],
    )
    def test_errors_of_a_plan_are_explained_in_one_sentence(self, described, old, new, message):
        with pytest.raises(EstimationError) as fault:
            read_planned(described(old, new))
        assert message in fault.value.message
        assert "plan.toml" in fault.value.message
        assert "\n" not in fault.value.message

    def test_a_missing_plan_is_an_error(self, tmp_path):
        with pytest.raises(EstimationError, match="cannot be read"):
            read_planned(tmp_path / "no.toml")


@pytest.mark.parametrize("size", [0.0, -1e-6, math.nan, math.inf])
def test_an_effect_size_that_is_not_positive_is_refused(size):
    with pytest.raises(EstimationError, match="size"):
        plan(base(), size=size)


def test_an_upper_limit_respects_the_bound_of_a_correlated_parameter():
    # the response is nearly that of the only free parameter, which can give way by 2 down to its bound of zero
    alike, apart = np.array([10.0, 0.0, 0.0]), np.array([0.0, 0.01, 0.0])
    free = alike[:, None]
    bounds = ShiftedToBound(free, np.linalg.pinv(free), np.zeros((1, 1)), np.array([[-2.0], [np.inf]]))
    without = 1.6448536 / 0.01
    found = bounds.largest_strength(alike + apart, np.zeros(3), without, one_sided=True)
    # (10 (k - 2))^2 + (0.01 k)^2 = 1.645^2
    assert found == pytest.approx(2.16448, rel=2e-3)
    assert bounds.largest_strength(apart, np.zeros(3), without, one_sided=True) == without


def test_a_planned_run_has_the_moments_of_inertia_of_the_plan(described):
    """With viscous friction alone the angle of a body is w (I / k) (1 - exp(-k t / I))."""
    start, end = PLAN.index("[parameters]"), PLAN.index("[noise]")
    laws = '[parameters]\n"rotor.air.linear.a1" = 2e-6\n"casing.air.linear.b2" = 3e-6\n'
    plain = (PLAN[:start] + laws + PLAN[end:]).replace(
        '"reduced"', '["rotor.air.linear", "casing.air.linear"]'
    )
    path = described("", "")
    path.write_text(plain.replace("torque = 1e-7", "torque = 0.0"))
    (record,) = read_planned(path)._records(0)
    assert (record.I_rotor, record.I_casing) == (5.54e-5, 2.06e-5)
    for run, w, k, inertia in ((record.casing, 5.0, 3e-6, 2.06e-5), (record.rotor[2], 900.0, 2e-6, 5.54e-5)):
        angle = -w * inertia / k * np.exp(-k * run.time / inertia)
        assert np.ptp(run.value) == pytest.approx(np.ptp(angle), abs=0.01)


def test_each_run_of_each_simulation_has_its_own_noise(described):
    """Two equal runs, simulated twice."""
    short = PLAN.replace("= 60.0\ncasing", "= 5.0\ncasing").replace("2.0, 30.0, 50.0", "1.0")
    planned = read_planned(described(PLAN, short + short[short.index("[[run]]") :]))
    seen = [record.casing.value for k in (0, 1) for record in planned._records(k)]
    assert all(np.any(a != b) for a, b in itertools.combinations(seen, 2))
    assert np.array_equal(planned._records(0)[0].casing.value, seen[0])
