"""A smooth torque against a random one, on either side of each limit."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from linearised import gyroscope
from scipy.special import chdtri

from fitting import Fit
from fitting._criteria import DEFAULT
from fitting.inference import _result
from fitting.inference import _smooth_torque as module
from fitting.inference._metrics import KNOTS, slow_responses
from fitting.inference._noise import Noise, TorqueNoise, TorqueResponse, Whitener
from fitting.inference._smooth_torque import SmoothTorque, smooth_torques

LEVEL, TIME = 2e-7, 0.5


def compared(torque=None, seed=0, which=0):
    """Compare the descriptions of white noise, and the response to a torque at the knots or to a random one [N m].

    `which` is 0 for the parabola, 1 for the sinusoid. The rows are those of a gyroscope of 12 s whose model has dry and
    quadratic friction.
    """
    base = gyroscope(level=LEVEL)
    data, prediction = base.problem.data[0], base.predictions[0]
    whitener = TorqueResponse(data, prediction.motion).whitener(TorqueNoise(LEVEL, TIME))
    noise = Noise(1.0, LEVEL, LEVEL, LEVEL, TIME, whitener, None)
    white = np.random.default_rng(seed).standard_normal(len(data.z))
    rows = whitener.coloured(white) if torque is None else white
    if callable(torque):
        response = TorqueResponse(data, prediction.motion)
        rows[: len(response.casing)] += response.casing @ torque(response.centres / response.centres[-1])
    elif torque is not None:
        rows = rows + slow_responses(data, prediction)[:, :KNOTS] @ torque
    seen = gyroscope(level=LEVEL, residual=[rows])
    free = np.concatenate([prediction.columns, data.nuisance], axis=1)
    return smooth_torques(seen.problem.data[0], prediction, noise, free, DEFAULT)[which]


def test_a_parabola_is_a_smooth_torque():
    found = compared(3e-6 * np.linspace(-1, 1, KNOTS) ** 2)
    assert 1 <= found.columns <= 6
    assert found.is_better(DEFAULT)


def test_white_noise_contains_no_smooth_torque():
    falls = [compared(np.zeros(KNOTS), seed).fall for seed in range(5)]
    assert max(falls) < 20.0
    # with more freedom the deviance does not rise
    assert min(falls) > -0.2


def test_a_random_torque_is_not_smooth():
    assert not any(compared(None, seed).is_better(DEFAULT) for seed in range(5))


def test_torques_that_are_the_same_count_once(monkeypatch):
    """Of a single body the torque on the casing is that of the bearing; each direction of white noise adds 1."""
    monkeypatch.setattr(module, "slow_responses", lambda *case: np.tile(slow_responses(*case)[:, :KNOTS], 2))
    found = [compared(np.zeros(KNOTS), seed) for seed in range(12)]
    assert {x.columns for x in found} <= {1, 2, 3}
    falls = [x.fall / x.columns for x in found]
    assert np.mean(falls) == pytest.approx(1.0, abs=0.5)


def test_an_alternating_torque_is_not_smooth():
    assert not compared(3e-6 * (-1.0) ** np.arange(KNOTS)).is_better(DEFAULT)


@pytest.mark.parametrize(
    ("periods", "chirp", "better"),
    [(5.0, 0.0, True), (8.1, 0.0, True), (8.0, 0.3, True), (8.0, -0.3, True), (2.5, 0.0, False)],
)
def test_a_sinusoid_of_several_periods_is_a_periodic_torque(periods, chirp, better):
    """Its frequency may change; fewer periods are those of a random torque."""

    def torque(x):
        return 1e-8 * periods**2 * np.cos(2 * np.pi * periods * (x + chirp * x * (x - 1)) + 0.7)

    found = compared(torque, which=1)
    # frequency and its change are searched for: 8 more periods, at 2 per period, with 4 changes
    assert (found.columns, found.searched, found.trials) == (2, 2, 64)
    assert found.is_better(DEFAULT) is better
    assert not compared(torque).is_better(DEFAULT)


def test_a_random_torque_is_not_periodic():
    assert not any(compared(None, seed, which=1).is_better(DEFAULT) for seed in range(5))


def test_parameters_that_are_searched_for_require_a_larger_fall():
    fall = 2 * math.log(1e4) + DEFAULT.random_torque_evidence + 5
    assert SmoothTorque(fall, 2, 10_000).is_better(DEFAULT)
    assert not SmoothTorque(fall, 2, 10_000, searched=1).is_better(DEFAULT)


def test_the_p_value_is_that_of_the_best_of_independent_trials():
    fall = chdtri(2, 1e-7)
    assert SmoothTorque(fall, 2, 5, trials=50).p_value == pytest.approx(5e-6)
    assert SmoothTorque(fall, 2, 5, trials=50).is_better(DEFAULT)
    assert not SmoothTorque(fall, 2, 5, trials=200).is_better(DEFAULT)
    assert SmoothTorque(1.0, 2, 5, trials=50).p_value == 1.0


@pytest.mark.parametrize(
    ("more", "better"),
    [(DEFAULT.random_torque_evidence + 0.1, True), (DEFAULT.random_torque_evidence - 0.1, False)],
)
def test_bic_requires_evidence(more, better):
    found = SmoothTorque(6 * math.log(1e4) + more, 6, 10_000)
    assert found.is_better(DEFAULT) is better


@pytest.mark.parametrize(("factor", "better"), [(1.02, True), (0.98, False)])
def test_the_fall_is_improbable_for_its_number_of_columns(factor, better):
    """Of few rows BIC requires little, and the p-value decides."""
    fall = factor * chdtri(6, DEFAULT.lack_of_fit)
    found = SmoothTorque(fall, 6, 20)
    assert found.fall > 6 * math.log(20) + DEFAULT.random_torque_evidence
    assert found.is_better(DEFAULT) is better
    assert (found.p_value < DEFAULT.lack_of_fit) is better


def test_without_columns_nothing_is_better():
    assert SmoothTorque(100.0, 0, 10).p_value == 1.0


@pytest.mark.parametrize(
    ("level", "excess", "smooth", "driven", "expected"),
    [
        (1.6, 10.1, True, False, True),
        (1.4, 10.1, True, False, False),
        (1.6, 9.9, True, False, False),
        (1.6, 10.1, False, False, False),
        (1.6, 10.1, True, True, False),
    ],
)
def test_only_a_random_torque_that_is_not_established_is_compared(
    monkeypatch, level, excess, smooth, driven, expected
):
    process = SimpleNamespace(level=4.0, least=2.0)
    noise = Noise(1.0, 2.0, 1.0, level, 1.0, Whitener(np.zeros((0, 0)), np.zeros(0)), process, excess)
    data = SimpleNamespace(motion=SimpleNamespace(is_smooth=smooth), driven=driven)
    prediction = SimpleNamespace()
    layout = SimpleNamespace(at_bound=lambda theta: np.array([False, False, True]))
    found = SimpleNamespace(
        criteria=DEFAULT,
        theta=np.zeros(3),
        noise=(noise,),
        predictions=(prediction,),
        problem=SimpleNamespace(layout=layout, data=(data,)),
    )
    compared = []

    def compare(*arguments):
        compared.append(arguments[3].tolist())
        return SmoothTorque(0.0, 6, 100), SmoothTorque(1e3, 2, 100)

    monkeypatch.setattr(_result, "smooth_torques", compare)
    monkeypatch.setattr(_result, "free_columns", lambda data, p, moving: moving)
    assert Fit.has_smooth_torque(found) is expected
    # the variable at its bound is not free
    assert compared == ([[True, True, False]] if expected else [])
