"""Simulated recordings of two bodies with viscous drag, whose motion and noise have closed forms."""

import math

import numpy as np
import pytest

from fitting import Experiment, Model, simulate
from fitting.inference import _simulation as module

MODEL = Model.of(["casing.air.linear", "rotor.air.linear"])
I_ROTOR, I_CASING = 5e-5, 2e-5
NUMBERS = {"casing.air.linear.b2": 4e-6, "rotor.air.linear.a1": 5e-6}
QUIET = {"duration": 6.0, "casing_fps": 20.0, "rotor_fps": 50.0, "sigma": 0.0}
QUIET |= {"windows": (1.0, 4.0), "window_length": 1.5}


def recording(model=MODEL, numbers=NUMBERS, seed=3, **changed):
    filmed = Experiment(**QUIET | changed)
    return simulate(model, numbers, filmed, inertia_rotor=I_ROTOR, inertia_casing=I_CASING, seed=seed)


def angle(t, omega, rate):
    return omega * (1 - np.exp(-rate * t)) / rate


def test_angles_are_those_of_the_motion_at_the_frames():
    made = recording()
    t = np.arange(120) / 20.0
    assert made.casing.time == pytest.approx(t)
    assert made.casing.value == pytest.approx(angle(t, 5.0, 0.2), abs=1e-6)
    assert (made.casing.sigma == 1e-9).all()
    for run, start in zip(made.rotor, (1.0, 4.0), strict=True):
        t = start + np.arange(75) / 50.0
        assert run.time == pytest.approx(t)
        turned = angle(t, 900.0, 0.1)
        assert run.value - run.value[0] == pytest.approx(turned - turned[0], abs=1e-4)
        assert 0 < run.value[0] < 2 * math.pi
    assert made.rotor[0].value[0] != made.rotor[1].value[0]
    assert (made.I_rotor, made.I_casing) == (I_ROTOR, I_CASING)


def test_noise_has_its_standard_deviation():
    made, quiet = recording(sigma=0.02, casing_fps=200.0), recording(casing_fps=200.0)
    noise = made.casing.value - quiet.casing.value
    assert np.std(noise) == pytest.approx(0.02, rel=0.1)
    assert (made.casing.sigma == 0.02).all()
    assert np.corrcoef(noise[1:], noise[:-1])[0, 1] == pytest.approx(0.0, abs=0.1)
    other = recording(sigma=0.02, casing_fps=200.0, seed=4).casing.value
    assert np.abs(other - made.casing.value).max() > 0.02
    assert recording(sigma=0.02, casing_fps=200.0).casing.value.tolist() == made.casing.value.tolist()


def test_an_offset_of_the_centre_is_an_error_once_a_turn():
    t = np.arange(120) / 20.0
    psi = angle(t, 5.0, 0.2)
    assert recording(centre_offset=0.01).casing.value == pytest.approx(
        psi + 0.01 * np.sin(psi - 0.7), abs=1e-6
    )


def test_a_constant_torque_acts_on_casing_and_bearing(monkeypatch):
    """Of 2 micronewton metres on the casing and of 3 in the bearing."""
    torques = iter((2e-6, 3e-6))
    monkeypatch.setattr(
        module, "_ornstein_uhlenbeck", lambda n, experiment, random: np.full(n, next(torques))
    )
    made, quiet = recording(torque_noise=1.0), recording()
    t = quiet.casing.time

    def pushed(torque, inertia, rate, t):
        return torque / inertia / rate * (t - (1 - np.exp(-rate * t)) / rate)

    assert made.casing.value - quiet.casing.value == pytest.approx(pushed(5e-6, I_CASING, 0.2, t), abs=1e-4)
    for run, plain in zip(made.rotor, quiet.rotor, strict=True):
        push = pushed(-3e-6, I_ROTOR, 0.1, run.time)
        change = run.value - plain.value
        assert change - change[0] == pytest.approx(push - push[0], abs=1e-4)


@pytest.mark.parametrize("time", [0.1, 0.5])
def test_a_random_torque_has_its_rms_and_correlation_time(time):
    experiment = Experiment(torque_noise=3e-7, torque_time=time)
    torque = module._ornstein_uhlenbeck(30000, experiment, np.random.default_rng(1))
    assert np.std(torque) == pytest.approx(3e-7, rel=0.08)
    for lag in (1, 5, 20):
        expected = math.exp(-0.02 * lag / time)
        assert np.corrcoef(torque[lag:], torque[:-lag])[0, 1] == pytest.approx(expected, abs=0.08)
    firsts = [module._ornstein_uhlenbeck(1, experiment, np.random.default_rng(i))[0] for i in range(300)]
    assert np.std(firsts) == pytest.approx(3e-7, rel=0.15)


def test_a_pendulum_starts_without_a_deflection():
    model = Model.of(["casing.spring.linear", "rotor.air.linear"])
    (key,) = (k for k in model.free if k.startswith("casing.spring"))
    numbers = {key: I_CASING * 4.0, "rotor.air.linear.a1": 5e-6}
    t = np.arange(120) / 20.0
    assert recording(model, numbers, omega_casing=0.4).casing.value == pytest.approx(
        0.2 * np.sin(2 * t), abs=1e-5
    )


def test_a_random_torque_acts_on_the_smooth_motion_of_a_law_of_the_angle(monkeypatch):
    model = Model.of(["casing.air.linear", "rotor.air.linear", "casing.unbalance"])
    strength, phase = (
        next(f"casing.unbalance.{p.symbol}" for p in model.effects[-1].parameters if p.role == role)
        for role in ("amplitude", "phase")
    )
    seen = []

    class Random:
        def __init__(self, dynamics, path, values, experiment, random):
            seen.append((tuple(dynamics.states), path.mesh.edges[-1]))

        def __call__(self, time, state):
            return np.full(len(time), 0.5)

    numbers = NUMBERS | {strength: 1e-9, phase: 0.0}
    plain = recording(model, numbers)
    monkeypatch.setattr(module, "_RandomTorque", Random)
    moved = recording(model, numbers)
    assert seen == [(("omega_r", "omega_c"), 6.0)]
    assert moved.casing.value - plain.casing.value == pytest.approx(np.full(120, 0.5), abs=1e-9)
    # a weak unbalance hardly changes the motion
    assert plain.casing.value == pytest.approx(angle(plain.casing.time, 5.0, 0.2), abs=1e-2)
