"""The most likely random torque of a case against a direct evaluation of its likelihood."""

import math
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from linearised import BEGIN, SPAN, gyroscope
from scipy.special import chdtri

from fitting import LINEAR
from fitting._criteria import DEFAULT
from fitting.discovery import _random_torque as module
from fitting.discovery._random_torque import (
    RandomTorque,
    inflation,
    is_established,
    with_random_torque,
)
from fitting.dynamics._collocation import Sampler
from fitting.inference import _random_torque as likelihood
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

        monkeypatch.setattr(module, "_mean_fall", mean_fall)
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
        own = module.TorqueNoise
        monkeypatch.setattr(module, "TorqueNoise", lambda *args: self.times.append(args[1]) or own(*args))
        monkeypatch.setattr(module, "_RANGE", spread)
        base = gyroscope(level=level)
        whitener = whitened(base, level, time)
        noise = SimpleNamespace(level=level, time=time, whitener=whitener)
        data, prediction = base.problem.data[0], base.predictions[0]
        free = np.concatenate([prediction.jacobian, data.nuisance], axis=1) if free is None else free
        random = np.random.default_rng(1)
        return module._mean_fall(data, prediction, free, columns, noise, DEFAULT, random)

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
        monkeypatch.setattr(module, "_NEAR_LEVELS", 1)
        column = np.random.default_rng(2).standard_normal((len(gyroscope().predictions[0].rows), 1))
        self.fall(monkeypatch, column, time=time, spread=4.0)
        every = time * 4.0 ** np.linspace(-1.0, 1.0, 7)
        inside = [t for t in every if 0.05 <= t <= 10.0]
        assert self.times == pytest.approx([time, *inside])
        assert len(inside) == (7 if time == 1.0 else 5)
