"""The most likely random torque of a case against a direct evaluation of its likelihood."""

import math
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from linearised import BEGIN, SPAN, gyroscope
from scipy.special import chdtri

from fitting._criteria import DEFAULT
from fitting.discovery._random_torque import RandomTorque, is_established, mean_torque, with_random_torque
from fitting.dynamics._collocation import Sampler
from fitting.inference._noise import TorqueNoise, TorqueResponse


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


def seen(residual, level=1e-9, deviance=1e9):
    base = gyroscope(level=level, residual=[residual])
    noise = tuple(Level(n.level, n.pure, 1.0, n.least, n.whitener) for n in base.noise)
    return Seen(base.problem, base.theta, base.predictions, noise, deviance)


def whitened(base, level, time):
    prediction = base.predictions[0]
    response = TorqueResponse(base.problem.data[0], prediction.motion)
    return response.whitener(TorqueNoise(level, time))


def deviance(base, whitener):
    """log det C and the least chi-square, by the normal equations."""
    data, prediction = base.problem.data[0], base.predictions[0]
    columns = whitener(np.concatenate([prediction.jacobian, data.nuisance], axis=1))
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
    monkeypatch.setattr("fitting.discovery._random_torque.mean_torque", lambda *_: 0.0)
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


def alternative(*levels, raised=(False,)):
    noise = tuple(
        SimpleNamespace(level=x, time=2.0, raised=r)
        for x, r in zip(levels, (*raised, False, False), strict=False)
    )
    return RandomTorque(SimpleNamespace(noise=noise, torque_unit="N m", theta=np.zeros(3)), 10.0, 5e-5)


def test_the_words_are_those_of_the_case_with_the_largest_one():
    found = alternative(1e-7, 5e-7, 2e-7)
    assert found.noise.level == 5e-7
    assert (
        found.words
        == "a random torque of 0.5 uN m rms (1 % of the mean torque) with a correlation time of 2 s"
    )


def test_one_raised_level_is_raised():
    assert alternative(1e-7, 2e-7, raised=(False, True)).is_raised
    assert not alternative(1e-7, 2e-7).is_raised


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
    assert is_established(alternative(1e-7), screened, named, 2000, DEFAULT) is established
