"""A slow random torque as the alternative to an effect, and effects that are hints only."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import oscillators
import pytest
from cases import data, fitted

from fitting import LIBRARY, Estimate, diagnose
from fitting._criteria import DEFAULT
from fitting.discovery import _random_torque
from fitting.discovery._random_torque import (
    RandomTorque,
    describes,
    inflation,
    is_established,
    with_random_torque,
)
from fitting.discovery._select import Selection
from fitting.discovery._verdict import _undetermined
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
    from fitting.discovery import _verdict

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
    from fitting.discovery import _verdict

    fit = SimpleNamespace(problem=SimpleNamespace(data=[SimpleNamespace(motion=oscillators.stub())]))
    fit.smooth_test = SimpleNamespace(p_value=0.5)
    random = SimpleNamespace(fit=fit, is_raised=raised)
    monkeypatch.setattr(_verdict, "with_random_torque", lambda *_: random)
    monkeypatch.setattr(_verdict, "describes", lambda *_: True)
    found = _verdict._random_alternative(fit, Selection([], None, None, None), "unexplained", None, DEFAULT)
    assert (found is random) == alternative


@pytest.mark.parametrize(("raised", "words"), [(True, "does not establish"), (False, "shows this level")])
def test_the_answer_says_whether_the_recording_shows_the_random_torque(raised, words):
    from fitting.discovery._verdict import _undecided

    noise = SimpleNamespace(level=2e-7)
    random = SimpleNamespace(words="a random torque of 2e-7 N m", is_raised=raised, noise=noise)
    chosen = SimpleNamespace(effect=LIBRARY["bearing.drift"], screened=None, indistinguishable_from=())
    final = SimpleNamespace(name=lambda e: e.name)
    assert words in _undecided(Selection([], chosen, None, final), random, "", [], DEFAULT)


def test_starts_and_slips_are_found_without_a_model():
    from fitting.discovery import _verdict

    fit = SimpleNamespace(problem=SimpleNamespace(data=[SimpleNamespace(motion=oscillators.stub())]))
    for effect in (_verdict.START, _verdict.SLIP):
        selection = Selection([], SimpleNamespace(effect=effect, screened=None), None, None)
        assert _verdict._random_alternative(fit, selection, "missing_effect", None, DEFAULT) is None
