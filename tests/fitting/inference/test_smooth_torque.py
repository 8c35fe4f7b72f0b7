"""A smooth torque against a random one, on either side of each limit."""

import math
from dataclasses import replace
from functools import cache
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


@cache
def reference():
    """Return data, prediction, response and whitener of the gyroscope without residuals."""
    base = gyroscope(level=LEVEL)
    data, prediction = base.problem.data[0], base.predictions[0]
    response = TorqueResponse(data, prediction.motion)
    return data, prediction, response, response.whitener(TorqueNoise(LEVEL, TIME))


def compared(torque=None, seed=0, which=0):
    """Compare the descriptions of white noise, and the response to a torque at the knots or to a random one [N m].

    `which` is 0 for the parabola, 1 for the sinusoid. The rows are those of a gyroscope of 12 s whose model has dry and
    quadratic friction.
    """
    data, prediction, response, whitener = reference()
    noise = Noise(1.0, LEVEL, LEVEL, LEVEL, TIME, whitener, None)
    white = np.random.default_rng(seed).standard_normal(len(data.z))
    rows = whitener.coloured(white) if torque is None else white
    if callable(torque):
        rows[: len(response.casing)] += response.casing @ torque(response.centres / response.centres[-1])
    elif torque is not None:
        rows = rows + slow_responses(data, prediction)[:, :KNOTS] @ torque
    seen = gyroscope(residual=[rows])
    free = np.concatenate([prediction.columns, data.nuisance], axis=1)
    return smooth_torques(seen.problem.data[0], prediction, noise, free, DEFAULT)[which]


def test_a_parabola_is_a_smooth_torque():
    found = compared(3e-6 * np.linspace(-1, 1, KNOTS) ** 2)
    assert 1 <= found.columns <= 6
    assert found.is_better(DEFAULT)


def test_white_noise_contains_no_smooth_torque():
    falls = [compared(np.zeros(KNOTS), seed).fall for seed in range(4)]
    assert max(falls) < 20.0
    # with more freedom the deviance does not rise
    assert min(falls) > -0.2


def test_a_random_torque_is_not_smooth():
    assert not any(compared(None, seed).is_better(DEFAULT) for seed in range(3))


@pytest.mark.slow
def test_torques_that_are_the_same_count_once(monkeypatch):
    """Of a single body the torque on the casing is that of the bearing; each direction of white noise adds 1."""
    monkeypatch.setattr(module, "slow_responses", lambda *case: np.tile(slow_responses(*case)[:, :KNOTS], 2))
    found = [compared(np.zeros(KNOTS), seed) for seed in range(6)]
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
    assert not any(compared(None, seed, which=1).is_better(DEFAULT) for seed in range(3))


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


class TestSinusoid:
    """Of a body whose rows are the torques of 240 cells themselves."""

    X = np.linspace(0.0, 1.0, 240)

    def wave(self, periods, chirp):
        return np.cos(2 * np.pi * periods * (self.X + chirp * self.X * (self.X - 1)) + 0.4)

    def found(self, residual, *, free=None, values=None, tested=0.0):
        response = SimpleNamespace(centres=3.0 + 10.0 * self.X, casing=np.eye(240))
        values = np.zeros(240) if values is None else values
        noise = SimpleNamespace(whitener=Whitener(np.zeros((0, 0)), values, 50.0), tested=tested)
        alone = np.column_stack([*([] if free is None else [free]), residual])
        return module._sinusoid(response, alone, noise)

    def explained(self, columns, residual):
        fitted = columns @ np.linalg.lstsq(columns, residual, rcond=None)[0]
        return float(fitted @ residual / (residual @ residual))

    @pytest.mark.parametrize(("periods", "chirp"), [(4.0, 0.0), (7.25, 0.2), (7.25, -0.3), (12.0, 0.4)])
    def test_its_frequency_and_its_change_are_found(self, periods, chirp):
        wave = self.wave(periods, chirp)
        columns = self.found(wave)
        assert columns.shape == (240, 2)
        assert self.explained(columns, wave) == pytest.approx(1.0)

    @pytest.mark.parametrize("periods", [2.5, 16.0])
    def test_fewer_than_four_or_more_than_twelve_periods_are_not_tried(self, periods):
        assert self.explained(self.found(self.wave(periods, 0.0)), self.wave(periods, 0.0)) < 0.6

    def test_what_free_columns_explain_is_not_a_sinusoid(self):
        """The larger one of two sinusoids is that of a parameter."""
        one, other = self.wave(5.0, 0.0), self.wave(10.0, 0.0)
        columns = self.found(3.0 * one + other, free=one)
        assert self.explained(columns, other) > 0.99

    @pytest.mark.parametrize(("tested", "periods"), [(0.0, 5.0), (100.0, 10.0)])
    def test_rows_count_at_the_level_of_tests(self, tested, periods):
        """The first half of the rows responds to the random torque, the second half does not."""
        early = self.X < 0.5
        residual = np.where(early, 3.0 * self.wave(5.0, 0.0), self.wave(10.0, 0.0))
        columns = self.found(residual, values=np.where(early, 1.0, 0.0), tested=tested)
        part = early if periods == 5.0 else ~early
        assert self.explained(columns[part], self.wave(periods, 0.0)[part]) > 0.9


class TestParabola:
    def test_both_bodies_have_a_constant_a_trend_and_a_parabola(self, monkeypatch):
        monkeypatch.setattr(module, "slow_responses", lambda *_: np.eye(2 * KNOTS))
        found = module._parabolas(None, None)
        x = np.linspace(-1.0, 1.0, KNOTS)
        shapes = np.column_stack([np.ones(KNOTS), x, 1.5 * x**2 - 0.5])
        nothing = np.zeros_like(shapes)
        assert found == pytest.approx(np.block([[shapes, nothing], [nothing, shapes]]))

    @pytest.mark.parametrize(("difference", "count"), [(3e-4, 2), (3e-5, 1)])
    def test_torques_that_are_nearly_the_same_count_once(self, difference, count):
        one, other, free = np.eye(6)[:3]
        columns = np.column_stack([one, one + difference * other, free])
        noise = SimpleNamespace(whitener=Whitener(np.zeros((0, 0)), np.zeros(0)))
        found = module._beside(np.column_stack([free, np.ones(6)]), columns, noise)
        assert found.shape == (6, count)

    def test_free_columns_are_compared_with_them_as_the_noise_weights_both(self):
        """The first row responds so strongly that it has no weight: without it the torque is the free column."""
        whitener = Whitener(np.zeros((0, 0)), np.array([1.0, 0.0, 0.0]), 1e9)
        free, torque = np.array([5.0, 1.0, 2.0]), np.array([0.0, 2.0, 4.0])
        alone = np.column_stack([free, np.ones(3)])
        both = np.column_stack([torque, np.array([0.0, 1.0, 0.0])])
        assert module._beside(alone, both, SimpleNamespace(whitener=whitener)).shape == (3, 1)


@pytest.mark.parametrize(("longest", "last"), [(1.0, 1.0), (100.0, 2.0)])
def test_the_descriptions_are_compared_at_their_most_likely_times(monkeypatch, longest, last):
    """A record of 12 s: from the shortest time of the criteria to a sixth of it at most, and that of the fit."""
    criteria = replace(DEFAULT, random_torque_shortest=0.25, random_torque_longest=longest)
    asked, residuals = [], []
    # deviance without a random torque, and at its most likely level, by the number of torques beside it
    deviances = {0: (90.0, 80.0), 1: (50.0, 60.0), 2: (70.0, 30.0)}

    class Response:
        casing = None

        def __init__(self, *_):
            pass

        def whitener(self, noise):
            asked.append((noise.rms, noise.time))
            return noise.time

    class Profile:
        def __init__(self, time, both):
            self._time, self._count = time, both.shape[1] - 2
            residuals.append(both[:, -1].tolist())

        def __call__(self, level):
            assert level == 0.0
            return deviances[self._count][0] + (5.0 + self._count if self._time != 0.5 else 0.0)

        def least(self, levels):
            assert levels == pytest.approx(3.0 * np.geomspace(0.01, 4.0, 12))
            return 1.0, deviances[self._count][1] + (5.0 + self._count if self._time != 0.5 else 0.0)

    monkeypatch.setattr(module, "TorqueResponse", Response)
    monkeypatch.setattr(module, "LevelProfile", Profile)
    monkeypatch.setattr(module, "_beside", lambda alone, columns, noise: columns)
    monkeypatch.setattr(module, "_parabolas", lambda *_: np.ones((4, 1)))
    monkeypatch.setattr(module, "_sinusoid", lambda *_: np.ones((4, 2)))
    data = SimpleNamespace(z=np.array([3.0, 1.0, 0.0, 0.0]), record=SimpleNamespace(span=(5.0, 17.0)))
    prediction = SimpleNamespace(rows=np.array([1.0, 2.0, 0.0, 0.0]), motion=None)
    noise = SimpleNamespace(time=0.5, level=3.0)
    parabola, sinusoid = smooth_torques(data, prediction, noise, np.ones((4, 1)), criteria)
    assert asked == [(0.0, t) for t in (0.5, *(pytest.approx(x) for x in np.geomspace(0.25, last, 5)))]
    assert (parabola.fall, parabola.columns, parabola.rows, parabola.searched) == (30.0, 1, 4, 0)
    assert (sinusoid.fall, sinusoid.columns, sinusoid.rows, sinusoid.searched) == (50.0, 2, 4, 2)
    assert all(r == [2.0, -1.0, 0.0, 0.0] for r in residuals)
