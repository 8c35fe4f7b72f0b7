"""A slow random torque as the alternative to an effect: its likelihood, and effects that are hints only."""

import math
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import oscillators
import pytest
from cases import data, fitted
from linearised import BEGIN, SPAN, gyroscope
from scipy.special import chdtri

from fitting import LIBRARY, LINEAR, Estimate, diagnose
from fitting._criteria import DEFAULT
from fitting.discovery import _random_torque, _verdict
from fitting.discovery._random_torque import (
    RandomTorque,
    describes,
    inflation,
    is_established,
    with_random_torque,
)
from fitting.discovery._select import Selection
from fitting.discovery._verdict import _undecided, _undetermined
from fitting.dynamics._collocation import Sampler
from fitting.inference import _random_torque as likelihood
from fitting.inference._noise import TorqueNoise, TorqueResponse
from fitting.inference._random_torque import _deviance

ROWS = 500


def alternative(deviance, *, raised=True, log_determinant=0.0, parameters=8):
    noise = SimpleNamespace(raised=raised, whitener=SimpleNamespace(log_determinant=log_determinant))
    fit = SimpleNamespace(noise=(noise,), rows=ROWS, theta=np.zeros(parameters))
    return RandomTorque(fit, deviance, 1e-4)


@pytest.mark.parametrize(
    ("deviance", "raised", "log_determinant", "expected"),
    [
        (0.99 * DEFAULT.reduced_chi2 * ROWS, True, 0.0, True),
        (1.01 * DEFAULT.reduced_chi2 * ROWS, True, 0.0, False),
        (1.01 * DEFAULT.reduced_chi2 * ROWS, True, 0.05 * ROWS, True),
        (0.5 * ROWS, False, 0.0, True),
    ],
)
def test_a_random_torque_describes_residuals_of_unit_variance(deviance, raised, log_determinant, expected):
    found = alternative(deviance, raised=raised, log_determinant=log_determinant)
    assert describes(found, DEFAULT) == expected


def screened(columns=1, trials=1):
    """Return a score with `trials` independent choices of its shape."""
    random = np.random.default_rng(0)
    draws = (random.standard_normal((trials, columns, 4000)) ** 2).sum(axis=1).max(axis=0)
    return SimpleNamespace(columns=columns, null=draws, noise=(), shares=())


def established(monkeypatch, fall, *, more=1, tests=1, factor=1.0, at_own_noise=0.0, **choices):
    """Return whether a fall of the deviance is accepted whose mean under the null hypothesis is `factor`.

    `at_own_noise` is the fall without a random torque beside the effect.
    """
    monkeypatch.setattr(
        _random_torque, "with_random_torque", lambda *_: SimpleNamespace(deviance=600.0 - fall)
    )
    monkeypatch.setattr(_random_torque, "inflation", lambda *_: factor)
    named = SimpleNamespace(theta=np.zeros(8 + more), rows=ROWS, deviance=600.0 - at_own_noise)
    return is_established(alternative(600.0), screened(**choices), named, tests, DEFAULT)


@pytest.mark.parametrize(("margin", "expected"), [(0.1, True), (-0.1, False)])
@pytest.mark.parametrize("more", [0, 1, 2])
def test_an_effect_is_established_by_its_evidence_beside_any_random_torque(
    monkeypatch, margin, expected, more
):
    least = more * np.log(ROWS) + DEFAULT.evidence
    assert established(monkeypatch, least + margin, more=more) == expected


def test_more_tests_need_a_larger_fall(monkeypatch):
    # p = 5e-4 for one test
    assert established(monkeypatch, 12.0, tests=10)
    assert not established(monkeypatch, 12.0, tests=1000)


def test_more_choices_of_a_shape_need_a_larger_fall(monkeypatch):
    assert established(monkeypatch, 12.0, tests=10, trials=1)
    assert not established(monkeypatch, 12.0, tests=10, trials=40)


@pytest.mark.parametrize(("fall", "expected"), [(15.0, True), (14.0, False)])
def test_a_fall_is_divided_by_its_inflation(monkeypatch, fall, expected):
    # BIC asks for 8.2
    assert established(monkeypatch, fall, factor=1.75) == expected


def test_a_fall_that_no_inflation_explains_needs_no_simulation(monkeypatch):
    assert established(monkeypatch, 25.0, factor=np.nan)
    assert not established(monkeypatch, 24.0, factor=np.nan)


@pytest.mark.parametrize(("fall", "expected"), [(25.0, True), (24.0, False)])
def test_a_fall_without_a_random_torque_beside_the_effect_may_be_enough(monkeypatch, fall, expected):
    assert established(monkeypatch, 0.0, at_own_noise=fall) is expected
    assert not established(monkeypatch, 0.0, at_own_noise=fall, more=0)


@pytest.fixture(scope="module")
def slow():
    """A fit of a recording with a random torque of 2e-7 N m and a correlation time of 2 s."""
    from fitting import Experiment, Model, simulate
    from fitting.inference._fit import fit

    numbers = {"touchpoint.constant.b1": 2e-5, "casing.air.linear.b2": 8e-7, "bearing.linear.d": 1.5e-7}
    model = Model.of([n.rpartition(".")[0] for n in numbers])
    experiment = Experiment(
        duration=30.0, windows=(5.0,), casing_fps=60.0, rotor_fps=250.0, sigma=5e-4,
        torque_noise=2e-7, torque_time=2.0,
    )  # fmt: skip
    record = simulate(model, numbers, experiment, inertia_rotor=5.54e-5, inertia_casing=2.06e-5, seed=3)
    return fit(model, [record])


def test_the_most_likely_random_torque_is_found_between_the_points_of_a_grid(slow):
    """No other level or time near it describes the data better."""
    found = with_random_torque(slow, DEFAULT)
    noise = found.noise
    (data,), (p,) = slow.problem.data, slow.predictions
    response = TorqueResponse(data, p.motion)
    for time in (0.8, 1.0, 1.25):
        whitener = response.whitener(TorqueNoise(0.0, time * noise.time))
        for level in (0.9, 1.0, 1.1):
            other = noise.at(noise.level)
            other = replace(other, whitener=whitener.at(level * noise.level))
            moving = ~slow.problem.layout.at_bound(slow.theta)
            assert _deviance(slow.problem, slow.predictions, (other,), moving) > found.deviance - 0.5
    assert 0.6e-7 < noise.level < 6e-7


def test_the_inflation_of_a_fall_is_its_mean_beside_a_free_random_torque(slow, monkeypatch):
    """Of one column the fall at a known random torque is 1; the best of many torques is never worse."""
    monkeypatch.setattr(_random_torque, "_NEAR_TIMES", 3)
    monkeypatch.setattr(_random_torque, "_NEAR_LEVELS", 5)
    without = with_random_torque(slow, DEFAULT)
    (data,), (p,) = slow.problem.data, slow.predictions
    half = p.columns.shape[1] // 2
    column = p.columns[:, half : half + 1]
    others = np.delete(p.columns, half, axis=1)
    random = np.random.default_rng(0)
    found = _random_torque._mean_fall(data, p, others, column, without.noise, DEFAULT, random)
    assert 1.0 < found < 2.0
    # twice the same column determines no more than one
    twice = np.concatenate([column, column], axis=1)
    random = np.random.default_rng(0)
    assert _random_torque._mean_fall(data, p, others, twice, without.noise, DEFAULT, random) == pytest.approx(
        found
    )


def test_the_inflation_is_per_column(slow, monkeypatch):
    """Two independent columns lower the deviance by twice as much as one."""
    monkeypatch.setattr(_random_torque, "_NEAR_TIMES", 1)
    monkeypatch.setattr(_random_torque, "_NEAR_LEVELS", 1)
    monkeypatch.setattr(_random_torque, "_RANGE", 1.0)
    (data,), (p,) = slow.problem.data, slow.predictions
    columns, others = np.random.default_rng(1).standard_normal((len(data.z), 6)), p.columns[:, :0]
    found = _random_torque._mean_fall(
        data, p, others, columns, slow.noise[0].at(1e-7), DEFAULT, np.random.default_rng(0)
    )
    assert found == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize(("falls", "expected"), [((1.3, 1.6), 1.6), ((1.6, 1.3), 1.6), ((0.8, 0.9), 1.0)])
def test_the_largest_inflation_of_all_cases_counts_and_is_at_least_one(monkeypatch, falls, expected):
    """Columns of the effect, 10 and 20, are apart from those of the base; one at its bound (99) is in neither."""
    asked = []

    def mean_fall(data, p, free, columns, *_):
        asked.append((free[0].tolist(), columns[0].tolist()))
        return falls[len(asked) - 1]

    monkeypatch.setattr(_random_torque, "_mean_fall", mean_fall)
    names = ["a.k", "b.k", "c.k", "new.k", "new.t0"]
    held = np.array([False, False, True, False, False])
    data = SimpleNamespace(nuisance=np.full((3, 1), 7.0))
    prediction = SimpleNamespace(places=np.arange(5), columns=np.tile([1.0, 2.0, 99.0, 10.0, 20.0], (3, 1)))
    named = SimpleNamespace(
        problem=SimpleNamespace(
            data=[data] * 2, layout=SimpleNamespace(names=names, at_bound=lambda theta: held)
        ),
        predictions=[prediction] * 2, theta=np.zeros(5),
    )  # fmt: skip
    base = SimpleNamespace(
        problem=SimpleNamespace(layout=SimpleNamespace(names=names[:3])),
        noise=[SimpleNamespace(level=1e-7)] * 2,
    )
    assert inflation(RandomTorque(base, 0.0, 1e-4), named, DEFAULT) == expected
    assert asked == [([1.0, 2.0, 7.0], [10.0, 20.0])] * 2
    base.noise = [SimpleNamespace(level=0.0)] * 2  # white noise needs no simulation
    assert inflation(RandomTorque(base, 0.0, 1e-4), named, DEFAULT) == 1.0


def test_coloured_rows_have_the_covariance_that_is_whitened(slow):
    whitener = slow.noise[0].whitener.at(3e-7)
    rows = np.random.default_rng(0).standard_normal((len(slow.problem.data[0].z), 3))
    assert whitener(whitener.coloured(rows)) == pytest.approx(rows, abs=1e-9)
    assert whitener.coloured(rows[:, 0]) == pytest.approx(whitener.coloured(rows)[:, 0])


@pytest.mark.parametrize(
    ("value", "stderr", "converged", "hint"),
    [
        (3.1, 1.0, True, ""),
        (-3.1, 1.0, True, ""),
        (2.9, 1.0, True, "is not determined"),
        (9.0, 1.0, False, "did not"),
    ],
)
def test_an_effect_of_less_than_three_standard_uncertainties_is_a_hint(value, stderr, converged, hint):
    effect = LIBRARY["bearing.drift"]
    (strength,) = effect.parameters
    estimates = {f"bearing.drift.{strength.symbol}": Estimate(value, stderr, "s-1", at_bound=False)}
    named = SimpleNamespace(converged=converged, estimates=estimates, name=lambda e: e.name)
    found = _undetermined(Selection((), SimpleNamespace(effect=effect, screened=None), named, named), DEFAULT)
    assert (hint in found) if hint else found == ""


@pytest.mark.slow
def test_the_most_likely_random_torque_is_never_above_its_ceiling():
    found = with_random_torque(fitted(hidden="drag"), DEFAULT)
    assert found.noise.level <= DEFAULT.random_torque * found.mean_torque * (1 + 1e-9)
    assert found.deviance <= fitted(hidden="drag").deviance


@pytest.mark.slow
@pytest.mark.release
def test_drag_is_named_with_a_random_torque():
    """A torque of 1e-6 N m is established beside a random one of 1e-7 N m with a correlation time of 1 s."""
    found = diagnose(fitted(ou=1e-7, hidden="drag"))
    assert found.verdict == "missing_effect"
    assert found.candidates[0].effect.name == "casing.air.quadratic"
    assert data(ou=1e-7, hidden="drag").findings == ()


@pytest.mark.parametrize("name", ["casing.precession", "bearing.drift", "camera.clock", "setup.inertia"])
@pytest.mark.parametrize(("established", "alternative"), [(True, False), (False, True)])
def test_every_effect_must_be_established_with_a_random_torque(monkeypatch, name, established, alternative):
    fit = SimpleNamespace(problem=SimpleNamespace(data=[SimpleNamespace(motion=oscillators.stub())]))
    fit.smooth_test = SimpleNamespace(p_value=0.5)
    random = SimpleNamespace(fit=fit, is_raised=False)
    monkeypatch.setattr(_verdict, "with_random_torque", lambda *_: random)
    monkeypatch.setattr(_verdict, "describes", lambda *_: True)
    monkeypatch.setattr(_verdict, "is_established", lambda *_: established)
    chosen = SimpleNamespace(effect=LIBRARY[name], screened=None, physical=LIBRARY[name].kind == "physical")
    selection = Selection([], chosen, None, None)
    found = _verdict._random_alternative(fit, selection, "missing_effect", None, DEFAULT)
    assert (found is random) == alternative


@pytest.mark.parametrize(("raised", "alternative"), [(True, True), (False, False)])
def test_without_an_effect_the_random_torque_must_be_larger_than_that_of_the_recording(
    monkeypatch, raised, alternative
):
    fit = SimpleNamespace(problem=SimpleNamespace(data=[SimpleNamespace(motion=oscillators.stub())]))
    fit.smooth_test = SimpleNamespace(p_value=0.5)
    random = SimpleNamespace(fit=fit, is_raised=raised)
    monkeypatch.setattr(_verdict, "with_random_torque", lambda *_: random)
    monkeypatch.setattr(_verdict, "describes", lambda *_: True)
    found = _verdict._random_alternative(fit, Selection([], None, None, None), "unexplained", None, DEFAULT)
    assert (found is random) == alternative


@pytest.mark.parametrize(("raised", "words"), [(True, "does not establish"), (False, "shows this level")])
def test_the_answer_says_whether_the_recording_shows_the_random_torque(raised, words):
    noise = SimpleNamespace(level=2e-7)
    random = SimpleNamespace(words="a random torque of 2e-7 N m", is_raised=raised, noise=noise)
    chosen = SimpleNamespace(effect=LIBRARY["bearing.drift"], screened=None, indistinguishable_from=())
    final = SimpleNamespace(name=lambda e: e.name)
    assert words in _undecided(Selection([], chosen, None, final), random, "", [], DEFAULT)


def test_starts_and_slips_are_found_without_a_model():
    fit = SimpleNamespace(problem=SimpleNamespace(data=[SimpleNamespace(motion=oscillators.stub())]))
    for effect in (_verdict.START, _verdict.SLIP):
        selection = Selection([], SimpleNamespace(effect=effect, screened=None), None, None)
        assert _verdict._random_alternative(fit, selection, "missing_effect", None, DEFAULT) is None


@dataclass(frozen=True, eq=False)
class Seen:
    """A gyroscope at known parameters, with what the likelihood of a random torque depends on."""

    problem: Any
    theta: Any
    predictions: Any
    noise: Any
    deviance: float
    torque_unit: str = "N m"
    rows: int = 500


@dataclass(frozen=True, eq=False)
class Level:
    level: float
    pure: float
    time: float
    least: float
    whitener: Any
    process: Any = None

    raised = False

    def at(self, level):
        return replace(self, level=level, whitener=self.whitener.at(level))


def seen(residual, level=1e-9, deviance=1e9, values=None):
    base = gyroscope(values=values, level=level, residual=[residual])
    noise = tuple(Level(n.level, n.pure, 1.0, n.least, n.whitener) for n in base.noise)
    return Seen(base.problem, base.theta, base.predictions, noise, deviance)


def mean_torque(base, case):
    return likelihood.mean_torque(base.problem, base.predictions, base.theta, case)


def whitened(base, level, time):
    prediction = base.predictions[0]
    response = TorqueResponse(base.problem.data[0], prediction.motion)
    return response.whitener(TorqueNoise(level, time))


def deviance(base, whitener, held=()):
    """log det C and the least chi-square, by the normal equations; some parameters are held."""
    data, prediction = base.problem.data[0], base.predictions[0]
    moving = [i for i, n in enumerate(base.problem.layout.names) if n.partition("@")[0] not in held]
    columns = whitener(np.concatenate([prediction.jacobian[:, moving], data.nuisance], axis=1))
    rows = whitener(data.z - prediction.rows)
    size = np.linalg.norm(columns, axis=0)
    size[size == 0] = 1.0
    found = np.linalg.lstsq(columns / size, rows, rcond=1e-10)[0]
    rest = rows - columns / size @ found
    return float(rest @ rest) + whitener.log_determinant


def rows_of(level, time, seed=5):
    """Rows of white noise and a random torque of this rms [N m] and correlation time [s]."""
    base = gyroscope(level=1e-9)
    rng = np.random.default_rng(seed)
    whitener = TorqueResponse(base.problem.data[0], base.predictions[0].motion).whitener(
        TorqueNoise(level, time)
    )
    m, n = len(whitener.vectors), len(whitener.values)
    white = rng.standard_normal(len(base.predictions[0].rows))
    white[:n] *= np.sqrt(1 + level**2 * whitener.values)
    white[:m] = whitener.vectors @ white[:m]
    return white


def test_the_mean_torque_is_that_of_the_body_with_the_larger_one():
    base = gyroscope()
    (path,) = (p.path for p in base.predictions)
    t = np.linspace(BEGIN, BEGIN + SPAN, 4000)
    omega_r, omega_c = Sampler(path.mesh, t).value(path.y)[:, :2].T
    bearing = 2e-7 * (omega_r - omega_c)
    rotor, casing = -bearing - 1e-9 * omega_r**2, bearing - 1e-5 - 1e-6 * omega_c
    expected = max(np.abs(rotor).mean(), np.abs(casing).mean())
    assert mean_torque(base, 0) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("time", [0.3, 1.5])
def test_level_and_time_are_the_most_likely_ones(time):
    base = seen(rows_of(4e-7, time), level=1e-9)
    found = with_random_torque(base, DEFAULT)
    ceiling = DEFAULT.random_torque * mean_torque(base, 0)
    assert 2e-7 < found.noise.level <= ceiling
    assert 0.2 < found.noise.time / time < 5.0
    best = deviance(base, whitened(base, found.noise.level, found.noise.time))
    assert found.deviance == pytest.approx(best, rel=1e-6)
    # no other level or time of a coarse grid is more likely by more than the grid is fine
    for other_time in np.geomspace(DEFAULT.random_torque_shortest, SPAN / 6, 4):
        for level in np.geomspace(1e-3, 1.0, 7) * ceiling:
            assert best < deviance(base, whitened(base, level, other_time)) + 1.0
    assert found.mean_torque == mean_torque(base, 0)
    assert found.noise.pure <= found.noise.level


def test_a_random_torque_is_limited_to_a_share_of_the_mean_torque():
    base = seen(rows_of(1e-5, 1.0))
    found = with_random_torque(base, DEFAULT)
    assert found.noise.level == pytest.approx(DEFAULT.random_torque * mean_torque(base, 0))
    assert found.deviance < deviance(base, whitened(base, 1e-9, 1.0))


def test_a_model_without_torque_has_no_random_torque(monkeypatch):
    monkeypatch.setattr(likelihood, "mean_torque", lambda *_: 0.0)
    assert with_random_torque(seen(rows_of(4e-7, 1.0)), DEFAULT).noise.level == 0.0


def test_it_is_not_a_worse_than_the_fit():
    base = seen(rows_of(0.0, 1.0), deviance=-1e9)
    found = with_random_torque(base, DEFAULT)
    assert (found.deviance, found.noise) == (-1e9, base.noise[0])


@pytest.mark.parametrize(("margin", "taken"), [(0.5, True), (-0.5, False)])
def test_it_is_taken_where_it_is_more_likely_than_the_fit(margin, taken):
    likely = with_random_torque(seen(rows_of(4e-7, 1.0)), DEFAULT)
    base = seen(rows_of(4e-7, 1.0), deviance=likely.deviance + margin)
    found = with_random_torque(base, DEFAULT)
    assert (found.noise is not base.noise[0]) is taken
    assert found.deviance == pytest.approx(min(likely.deviance, base.deviance))


def test_correlation_times_are_at_most_a_sixth_of_the_record():
    found = with_random_torque(seen(rows_of(4e-7, 30.0)), DEFAULT)
    assert found.noise.time <= SPAN / 6 * (1 + 1e-9)


@pytest.mark.parametrize("noisy", [0, 1])
def test_the_mean_torque_is_that_of_the_case_with_the_largest_random_torque(noisy):
    rows = [rows_of(4e-7 if i == noisy else 0.0, 1.0, seed=5 + i) for i in (0, 1)]
    friction = {"touchpoint.constant.b1@a": 1e-5, "touchpoint.constant.b1@b": 4e-5}
    base = gyroscope(values=friction, cases=("a", "b"), level=1e-9, residual=rows)
    noise = tuple(Level(n.level, n.pure, 1.0, n.least, n.whitener) for n in base.noise)
    torques = [mean_torque(base, i) for i in (0, 1)]
    assert abs(torques[0] / torques[1] - 1) > 0.01
    found = with_random_torque(Seen(base.problem, base.theta, base.predictions, noise, 1e9), DEFAULT)
    assert found.noise is found.fit.noise[noisy]
    assert found.mean_torque == torques[noisy]


def test_white_noise_has_the_level_of_the_recording():
    base = seen(rows_of(0.0, 1.0), level=1e-12)
    found = with_random_torque(base, DEFAULT)
    assert found.noise.level < 1e-7


def alternative_of(*levels, raised=(False,)):
    noise = tuple(
        SimpleNamespace(level=x, time=2.0, raised=r)
        for x, r in zip(levels, (*raised, False, False), strict=False)
    )
    return RandomTorque(SimpleNamespace(noise=noise, torque_unit="N m", theta=np.zeros(3)), 10.0, 5e-5)


def test_the_words_are_those_of_the_case_with_the_largest_one():
    found = alternative_of(1e-7, 5e-7, 2e-7)
    assert found.noise.level == 5e-7
    assert (
        found.words
        == "a random torque of 0.5 uN m rms (1 % of the mean torque) with a correlation time of 2 s"
    )


def test_one_raised_level_is_raised():
    assert alternative_of(1e-7, 2e-7, raised=(False, True)).is_raised
    assert not alternative_of(1e-7, 2e-7).is_raised


@pytest.mark.parametrize(("p", "established"), [(0.029, True), (0.031, False)])
def test_an_effect_must_be_significant_in_the_whole_list(monkeypatch, p, established):
    """One more parameter and 2000 tests: the fall of the deviance is large enough for BIC."""
    fall = float(chdtri(1, p / 2000))
    assert fall > math.log(500) + DEFAULT.evidence
    monkeypatch.setattr(
        "fitting.discovery._random_torque.with_random_torque",
        lambda *_: SimpleNamespace(deviance=10.0 - fall),
    )
    monkeypatch.setattr("fitting.discovery._random_torque.inflation", lambda *_: 1.0)
    named = SimpleNamespace(theta=np.zeros(4), rows=500, deviance=10.0)
    # null scores of one column without a choice of shapes, at equal steps of probability
    null = chdtri(1, (np.arange(2001) + 0.5) / 2001)
    screened = SimpleNamespace(columns=1, null=null, noise=(), shares=())
    assert is_established(alternative_of(1e-7), screened, named, 2000, DEFAULT) is established


def test_a_parameter_at_its_bound_is_held_with_a_random_torque():
    drag = "casing.air.linear.b2"
    rows = rows_of(4e-7, 1.0)
    base = seen(rows, values={drag: 0.0})
    # what the drag alone would describe
    place = base.problem.layout.index[drag]
    column = base.predictions[0].jacobian[:, place]
    base = seen(rows + 30.0 * column / np.linalg.norm(column), values={drag: 0.0})
    found = with_random_torque(base, DEFAULT)
    whitener = whitened(base, found.noise.level, found.noise.time)
    held = deviance(base, whitener, held=[drag])
    assert held > deviance(base, whitener) + 0.1
    assert found.deviance == pytest.approx(held, rel=1e-6)


def test_a_parameter_at_its_bound_absorbs_no_random_torque(monkeypatch):
    base = seen(rows_of(4e-7, 1.0), values={"casing.air.linear.b2": 0.0})
    asked = []

    def most_likely(data, prediction, columns, noise, ceiling, criteria):
        asked.append((columns, ceiling))
        return noise

    monkeypatch.setattr(likelihood, "_most_likely", most_likely)
    with_random_torque(base, DEFAULT)
    ((columns, ceiling),) = asked
    jacobian = np.delete(
        base.predictions[0].jacobian, base.problem.layout.index["casing.air.linear.b2"], axis=1
    )
    assert columns == pytest.approx(np.concatenate([jacobian, base.problem.data[0].nuisance], axis=1))
    assert ceiling == pytest.approx(DEFAULT.random_torque * mean_torque(base, 0))


def test_the_correlation_time_is_found_between_the_trial_times():
    """Trial times are apart by a factor of 1.7; a time next to the one that is found is not more likely."""
    base = seen(rows_of(2e-7, 0.38))
    found = with_random_torque(base, DEFAULT).noise
    ceiling = DEFAULT.random_torque * mean_torque(base, 0)
    assert found.level < 0.9 * ceiling
    best = deviance(base, whitened(base, found.level, found.time))
    for factor in (0.8, 0.9, 1.1, 1.25):
        response = whitened(base, 0.0, factor * found.time)
        each = [deviance(base, response.at(x * found.level)) for x in (0.8, 1.0, 1.25)]
        assert best < min(each) + 0.01


@pytest.mark.parametrize("level", [1e-4, 1e-9])
def test_a_level_above_the_ceiling_is_lowered_to_it(level):
    base = seen(rows_of(1e-5, 1.0), level=level)
    found = with_random_torque(base, DEFAULT)
    ceiling = DEFAULT.random_torque * mean_torque(base, 0)
    assert found.noise.level <= ceiling * (1 + 1e-9)
    assert found.noise.pure <= found.noise.level * (1 + 1e-9)
    assert found.noise.pure == pytest.approx(min(level, found.noise.level))


class TestInflation:
    """The simulated falls by a drag, beside the friction of the base."""

    DRAG = "casing.air.quadratic"

    def asked(self, monkeypatch, ratio, *, level=3e-7, strength=4e-8):
        calls = []

        def mean_fall(data, prediction, free, columns, noise, criteria, random):
            calls.append((free, columns, noise))
            return ratio

        monkeypatch.setattr(_random_torque, "_mean_fall", mean_fall)
        without = SimpleNamespace(fit=gyroscope(level=max(level, 1e-9)))
        without.fit.noise[0].level = level
        named = gyroscope((*LINEAR, self.DRAG), {f"{self.DRAG}.k": strength, "casing.air.linear.b2": 0.0})
        return inflation(without, named, DEFAULT), calls, named

    @pytest.mark.parametrize(("ratio", "found"), [(1.7, 1.7), (0.6, 1.0)])
    def test_the_columns_of_the_effect_are_added_to_those_of_the_base(self, monkeypatch, ratio, found):
        inflated, ((free, columns, noise),), named = self.asked(monkeypatch, ratio)
        assert (inflated, noise.level) == (found, 3e-7)
        names = [n.partition("@")[0] for n in named.problem.layout.names]
        jacobian = named.predictions[0].jacobian
        own = names.index(f"{self.DRAG}.k")
        assert columns == pytest.approx(jacobian[:, [own]])
        held = names.index("casing.air.linear.b2")
        expected = np.concatenate(
            [np.delete(jacobian, [own, held], axis=1), named.problem.data[0].nuisance], axis=1
        )
        assert free == pytest.approx(expected)

    @pytest.mark.parametrize("change", [{"level": 0.0}, {"strength": 0.0}])
    def test_without_a_random_torque_or_a_free_strength_there_is_none(self, monkeypatch, change):
        inflated, calls, _ = self.asked(monkeypatch, 1.7, **change)
        assert (inflated, calls) == (1.0, [])

    def fall(self, monkeypatch, columns, *, time=1.0, spread=1.0, level=3e-7, free=None):
        self.times = []
        own = _random_torque.TorqueNoise
        monkeypatch.setattr(
            _random_torque, "TorqueNoise", lambda *args: self.times.append(args[1]) or own(*args)
        )
        monkeypatch.setattr(_random_torque, "_RANGE", spread)
        base = gyroscope(level=level)
        whitener = whitened(base, level, time)
        noise = SimpleNamespace(level=level, time=time, whitener=whitener)
        data, prediction = base.problem.data[0], base.predictions[0]
        free = np.concatenate([prediction.jacobian, data.nuisance], axis=1) if free is None else free
        random = np.random.default_rng(1)
        return _random_torque._mean_fall(data, prediction, free, columns, noise, DEFAULT, random)

    @pytest.mark.parametrize("count", [1, 3])
    def test_at_a_known_random_torque_it_is_one_for_each_column(self, monkeypatch, count):
        """The mean of 200 chi-squares over their degrees of freedom."""
        size = len(gyroscope().predictions[0].rows)
        columns = np.random.default_rng(2).standard_normal((size, count))
        found = self.fall(monkeypatch, columns)
        assert found == pytest.approx(1.0, abs=4 * math.sqrt(2 / (200 * count)))

    def test_at_an_unknown_random_torque_it_is_larger(self, monkeypatch):
        base = gyroscope((*LINEAR, self.DRAG), {f"{self.DRAG}.k": 4e-8})
        names = [n.partition("@")[0] for n in base.problem.layout.names]
        column = base.predictions[0].jacobian[:, [names.index(f"{self.DRAG}.k")]]
        known, unknown = (self.fall(monkeypatch, column, spread=x, level=1e-6) for x in (1.0, 4.0))
        assert 0.0 < known < unknown < 4.0

    @pytest.mark.parametrize("time", [0.1, 1.0, 5.0])
    def test_trial_times_are_those_of_the_criteria(self, monkeypatch, time):
        monkeypatch.setattr(_random_torque, "_NEAR_LEVELS", 1)
        column = np.random.default_rng(2).standard_normal((len(gyroscope().predictions[0].rows), 1))
        self.fall(monkeypatch, column, time=time, spread=4.0)
        every = time * 4.0 ** np.linspace(-1.0, 1.0, 7)
        inside = [t for t in every if 0.05 <= t <= 10.0]
        assert self.times == pytest.approx([time, *inside])
        assert len(inside) == (7 if time == 1.0 else 5)
