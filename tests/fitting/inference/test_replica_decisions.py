"""The parts of a new recording, with random numbers and processes that are known."""

from dataclasses import replace
from types import SimpleNamespace

import linearised
import numpy as np
import pytest

from fitting import EstimationError
from fitting.dynamics._collocation import Sampler
from fitting.inference import _replica as module
from fitting.inference._angle_noise import AngleNoise
from fitting.inference._record import Samples

T = np.linspace(0.0, 4.0, 41)


class Drawn:
    """Random numbers: those of a list, then ones."""

    def __init__(self, *values):
        self.values = list(values)

    def standard_normal(self, size=None):
        count = 1 if size is None else int(np.prod(size))
        found = np.array([self.values.pop(0) if self.values else 1.0 for _ in range(count)])
        return float(found[0]) if size is None else found.reshape(size)

    def normal(self, mean, u):
        return mean + u * self.standard_normal()


def samples(t=T, value=None, sigma=0.5, **more):
    return Samples(t, np.zeros(len(t)) if value is None else value, np.full(len(t), sigma), **more)


@pytest.fixture
def process(monkeypatch):
    """A process of random numbers that is 1 plus its correlation time at all times."""
    monkeypatch.setattr(
        module, "_ornstein_uhlenbeck", lambda times, time, random: np.full(len(times), 1.0 + time)
    )


class TestSlowError:
    def test_each_part_has_its_level_time_and_shape(self, process):
        run = samples(value=3.0 * T)
        found = module._slow_error(run, AngleNoise(2.0, 0.5, 3.0), Drawn(1.0))
        assert found == pytest.approx(np.full(41, 2.5 * 4.0))
        found = module._slow_error(
            run, AngleNoise(turn_sigma=3.0, turn_sigma_u=0.2, turn_time=1.0), Drawn(-2.0)
        )
        assert found == pytest.approx(2.6 * 2.0 * (np.cos(3 * T) + np.sin(3 * T)))
        both = AngleNoise(2.0, 0.5, 3.0, turn_sigma=3.0, turn_sigma_u=0.2, turn_time=1.0)
        assert module._slow_error(run, both, Drawn(1.0, -2.0)) == pytest.approx(10.0 + found)

    def test_a_level_below_zero_is_that_above_it(self, process):
        found = module._slow_error(samples(), AngleNoise(2.0, 1.0, 3.0), Drawn(-5.0))
        assert found == pytest.approx(np.full(41, 12.0))
        turning = AngleNoise(turn_sigma=2.0, turn_sigma_u=1.0, turn_time=3.0)
        assert module._slow_error(samples(), turning, Drawn(-5.0)) == pytest.approx(np.full(41, 12.0))

    def test_white_noise_has_none(self):
        assert not module._slow_error(samples(), AngleNoise(), Drawn()).any()


class TestStatedError:
    def data(self, correlated, profile=(), value=None):
        run = samples(value=value)
        record = SimpleNamespace(casing=run, correlated=correlated, correlated_profile=profile)
        return SimpleNamespace(
            record=record, casing=SimpleNamespace(samples=run, operators=[(slice(0, 41), None)])
        )

    def test_its_size_is_constant_or_follows_its_profile(self, process):
        known = self.data((0.5, 2.0, 0.0, 0.0))
        assert module._stated_error(known, Drawn()) == pytest.approx(np.full(41, 1.5))
        grows = self.data((0.5, 2.0, 0.0, 0.0), ((0.0, 1.0), (4.0, 3.0)))
        assert module._stated_error(grows, Drawn()) == pytest.approx(3.0 * (1.0 + 0.5 * T))

    def test_a_periodic_part_alone_has_the_first_two_orders(self, process):
        known = self.data((0.0, 2.0, 0.3, 0.0), value=2.0 * T)
        found = module._stated_error(known, Drawn(1.0, 0.0, 0.0, 1.0))
        psi = 2.0 * T
        # orders from 3 on have the harmonic amplitude, zero, whatever is drawn
        orders = list(dict.fromkeys([*module.HARMONICS, 1, 2]))
        drawn = [1.0, 0.0, 0.0, 1.0] + [1.0] * 40
        expected = sum(
            0.3 * (order <= 2) * (drawn[2 * i] * np.cos(order * psi) + drawn[2 * i + 1] * np.sin(order * psi))
            for i, order in enumerate(orders)
        )
        assert found == pytest.approx(expected)


class TestHarmonics:
    """Of a block of 9 rad and one of 30 rad; three turns are 18.8 rad."""

    VALUE = np.concatenate([np.linspace(0.0, 9.0, 20), np.linspace(9.0, 39.0, 21)])

    def run(self):
        blocks = [(slice(0, 20), None), (slice(20, 41), None)]
        return SimpleNamespace(samples=samples(value=self.VALUE), operators=blocks)

    @pytest.mark.parametrize(("block", "periodic"), [(slice(0, 20), 0.4), (slice(20, 41), 0.0)])
    def test_slow_blocks_have_a_larger_first_and_second_order(self, block, periodic):
        found = module._harmonics(self.run(), 0.3, Drawn(), 0.4)
        psi = self.VALUE[block]
        size = dict.fromkeys(range(3, 13), 0.3) | dict.fromkeys((1, 2), np.hypot(0.3, periodic))
        expected = sum(a * (np.cos(n * psi) + np.sin(n * psi)) for n, a in size.items())
        assert found[block] == pytest.approx(expected)

    def test_without_any_amplitude_nothing_is_drawn(self):
        random = Drawn(5.0)
        assert not module._harmonics(self.run(), 0.0, random).any()
        assert random.values == [5.0]
        assert module._harmonics(self.run(), 0.1, random).any()

    def test_blocks_are_independent(self):
        random = Drawn(*[0.0] * 24, *[2.0] * 24)
        found = module._harmonics(self.run(), 0.1, random)
        assert not found[:20].any()
        assert np.abs(found[20:]).max() > 0.5


class Motion:
    """Expected values of 10 t for the casing and 100 t for a rotor's window."""

    def __init__(self, data):
        self.data = data

    def values(self):
        record = self.data.record
        return [10.0 * record.casing.time, *(100.0 * w.time for w in record.rotor)]

    def expected_of(self, state, times, path=None):
        return (100.0, 10.0)[state] * times


class TestRecording:
    @pytest.fixture
    def parts(self, monkeypatch):
        """Changes by other inertias, the random torque, and slow, stated and harmonic errors."""
        monkeypatch.setattr(module, "_other_inertias", lambda motion, random: [1.0, 2.0])
        monkeypatch.setattr(module, "_random_torque", lambda motion, random: [10.0, 20.0])
        monkeypatch.setattr(module, "_slow_error", lambda run, noise, random: noise)
        monkeypatch.setattr(module, "_stated_error", lambda data, random: 1000.0)
        monkeypatch.setattr(module, "_harmonics", lambda run, harmonic, random: harmonic)

    def recording(self, *, angle=True, smooth=True, start=(0.25,), modes=0.0):
        casing, window = samples(sigma=0.5), samples(T[:11], sigma=0.2, harmonic=7e4)
        record = linearised.data().record
        record = replace(record, casing=casing, rotor=(window,), start_sigma=start, digest="abc")
        data = SimpleNamespace(
            record=record, is_angle=angle, motion=SimpleNamespace(is_smooth=smooth),
            casing=SimpleNamespace(scale=2.0, samples=casing), rotor=[SimpleNamespace(scale=3.0, samples=window)],
            angle_noise=100.0, rotor_angle_noise=200.0,
            mode_columns=(np.full((41, 2), modes), [np.full((11, 2), 2 * modes)]),
        )  # fmt: skip
        made = module._recording(Motion(data), Drawn())
        assert made.digest != "abc"
        assert made.label == record.label
        assert (made.casing.time == T).all()
        assert (made.casing.sigma == 0.5).all()
        return made.casing.value - 10.0 * T, made.rotor[0].value - 100.0 * T[:11]

    def test_of_angles_of_a_smooth_motion(self, parts):
        casing, window = self.recording()
        # white noise, inertia and torque, slow error, stated error
        assert casing == pytest.approx(np.full(41, 2.0 * 0.5 + 11.0 + 100.0 + 1000.0))
        # and 0.25 s at 100 rad/s
        assert window == pytest.approx(np.full(11, 3.0 * 0.2 + 22.0 + 200.0 + 25.0 + 7e4))

    def test_of_an_oscillation(self, parts):
        casing, window = self.recording(smooth=False)
        assert casing == pytest.approx(np.full(41, 112.0))
        assert window == pytest.approx(np.full(11, 247.6))

    def test_of_speeds(self, parts):
        casing, window = self.recording(angle=False)
        assert casing == pytest.approx(np.full(41, 12.0))
        assert window == pytest.approx(np.full(11, 47.6))

    @pytest.mark.parametrize("start", [(), (0.0,), (np.nan,)])
    def test_of_known_or_unstated_starts(self, parts, start):
        casing, window = self.recording(start=start)
        assert casing == pytest.approx(np.full(41, 1112.0))
        assert window == pytest.approx(np.full(11, 222.6 + 7e4))

    def test_error_modes_of_all_runs_have_the_same_amplitudes(self, parts):
        casing, window = self.recording(modes=0.125)
        assert casing == pytest.approx(np.full(41, 1112.25))
        assert window == pytest.approx(np.full(11, 247.6 + 7e4 + 0.5))


@pytest.mark.parametrize(
    ("generated", "gradients", "refused"),
    [(False, False, False), (True, False, True), (False, True, True), (True, True, True)],
)
def test_curves_made_from_data_are_not_measured(monkeypatch, generated, gradients, refused):
    monkeypatch.setattr(module, "_recording", lambda motion, random: motion.case)
    record = SimpleNamespace(generated=generated, gradients=gradients, label="run")
    usual = SimpleNamespace(generated=False, gradients=False, label="other")
    data = [SimpleNamespace(record=r) for r in (usual, record)]
    fit = SimpleNamespace(problem=SimpleNamespace(data=data))
    if refused:
        with pytest.raises(EstimationError, match="run: only measured"):
            module.replica(fit, 1)
    else:
        assert module.replica(fit, 1) == [0, 1]


def test_the_motion_of_a_repetition_has_no_errors_of_a_measurement(monkeypatch):
    """It is that of the fit, beginning at the measured zero, with all changes that a random error causes."""
    base = linearised.gyroscope()
    data = base.problem.data[0]
    path = base.predictions[0].path
    casing = data.record.casing
    own = Sampler(path.mesh, casing.time).integral(*path.angle("omega_c"))
    shifted = replace(data, record=replace(data.record, casing=replace(casing, value=own + 0.7), digest=""))
    times = np.linspace(4.0, 14.0, 30)
    seen = []

    def change(size):
        def of(motion, random):
            runs = (motion.data.record.casing, *motion.data.record.rotor)
            seen.append([r.time.tolist() == times.tolist() for r in runs])
            return [np.full(30, size), np.full(30, 2 * size)]

        return of

    monkeypatch.setattr(module, "_other_inertias", change(0.01))
    monkeypatch.setattr(module, "_random_torque", change(0.1))
    effect = object()
    monkeypatch.setattr(
        module.FittedMotion, "angle_response",
        lambda self, law, zero: [np.full(30, zero + (law is effect)), np.full(30, 100.0)],
    )  # fmt: skip
    fit = SimpleNamespace(
        problem=SimpleNamespace(data=[shifted]), predictions=base.predictions, theta=base.theta,
        model=SimpleNamespace(angle_dependent=(effect,)), noise=None,
    )  # fmt: skip
    found = module.motion_of(fit, 0, times, 3)
    expected = [Sampler(path.mesh, times).integral(*path.angle(s)) for s in ("omega_c", "omega_r")]
    assert found[0] == pytest.approx(expected[0] + 0.7 + 0.11 + 1.7, abs=1e-6)
    assert found[1] == pytest.approx(expected[1] + 0.22 + 100.0, abs=1e-6)
    assert seen == [[True, True]] * 2


class TestRandomTorque:
    @pytest.mark.parametrize(
        ("time", "cells"), [(10.0, 400), (0.15, 400), (0.1, 600), (0.002, 30000), (0.001, 40000)]
    )
    def test_a_correlation_time_has_five_cells(self, monkeypatch, time, cells):
        """Of a record of 12 s, between 400 and 40000."""
        lengths = []

        def process(times, correlation, random):
            lengths.append((len(times), correlation, times[0]))
            raise EstimationError("enough")

        monkeypatch.setattr(module, "_ornstein_uhlenbeck", process)
        known = SimpleNamespace(level=1e-6, time=time)
        record = linearised.data().record
        motion = SimpleNamespace(
            fit=SimpleNamespace(noise=[SimpleNamespace(with_unresolved=known)]), case=0,
            data=SimpleNamespace(record=record),
        )  # fmt: skip
        with pytest.raises(EstimationError):
            module._random_torque(motion, None)
        assert lengths == [(cells, time, 3.0)]

    @pytest.mark.parametrize("level", [0.0, np.nan])
    def test_without_a_level_there_is_none(self, level):
        record = linearised.data().record
        noise = [SimpleNamespace(with_unresolved=SimpleNamespace(level=level, time=1.0))]
        motion = SimpleNamespace(
            fit=SimpleNamespace(noise=noise), case=0, data=SimpleNamespace(record=record)
        )
        found = module._random_torque(motion, None)
        assert [len(f) for f in found] == [600, 100, 100]
        assert not any(f.any() for f in found)


def test_an_inertia_that_is_heavier_slows_down_less():
    """Drawn at one standard uncertainty above the stated value; the torques are those of the fit."""
    base = linearised.gyroscope(["casing.air.linear", "rotor.air.linear"], {"rotor.air.linear.a1": 2e-6})
    data = base.problem.data[0]
    record = replace(data.record, I_casing_u=2e-7, I_rotor_u=0.0, digest="")
    motion = module.FittedMotion(base, 0, replace(data, record=record))
    casing, *windows = module._other_inertias(motion, Drawn())
    t = record.casing.time - 3.0
    omega, rate = 20.0, 1e-6 / 2e-5

    def angle(rate):
        return omega * (1 - np.exp(-rate * t)) / rate

    assert casing == pytest.approx(angle(rate / 1.01) - angle(rate), abs=1e-5)
    assert all(np.abs(w).max() < 1e-6 for w in windows)
    lighter = module._other_inertias(motion, Drawn(-1.0))[0]
    assert lighter == pytest.approx(angle(rate / 0.99) - angle(rate), abs=1e-5)
    known = module.FittedMotion(base, 0, replace(data, record=replace(record, I_casing_u=0.0)))
    assert not any(c.any() for c in module._other_inertias(known, Drawn()))
