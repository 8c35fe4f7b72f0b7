"""Simulated recordings of two bodies with viscous drag, whose motion and noise have closed forms."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import Experiment, Model, SimulationError, simulate
from fitting.dynamics._collocation import Mesh
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


def test_a_run_of_the_paper_is_filmed_by_default():
    one = Experiment()
    assert (one.omega_rotor, one.omega_casing, one.duration) == (900.0, 5.0, 200.0)
    assert (one.casing_fps, one.rotor_fps, one.sigma) == (260.0, 1000.0, 1e-3)
    assert (one.windows, one.window_length) == ((5.0, 70.0, 150.0), 3.0)
    assert (one.torque_noise, one.torque_time, one.centre_offset) == (0.0, 1.0, 0.0)


@pytest.mark.parametrize(
    "name", ["duration", "casing_fps", "rotor_fps", "window_length", "torque_time", "sigma"]
)
def test_lengths_and_rates_of_an_experiment_are_positive(name):
    for value in (0.0, -1.0, math.nan):
        if name == "sigma" and value == 0:
            assert Experiment(sigma=0.0).sigma == 0.0
            continue
        with pytest.raises(Exception, match=name):
            Experiment(**{name: value})
    if name in ("rotor_fps", "window_length"):
        assert Experiment(windows=(), **{name: 0.0}).windows == ()


@pytest.mark.parametrize("name", ["omega_rotor", "omega_casing", "torque_noise", "centre_offset"])
def test_speeds_and_errors_of_an_experiment_are_finite(name):
    assert getattr(Experiment(**{name: -2.0}), name) == -2.0
    with pytest.raises(Exception, match=name):
        Experiment(**{name: math.inf})


@pytest.mark.parametrize(("start", "within"), [(-0.1, False), (0.0, True), (4.5, True), (4.6, False)])
def test_a_window_is_within_the_recording(start, within):
    if within:
        assert recording(windows=(1.0, start)).rotor[1].time[0] == pytest.approx(start)
    else:
        with pytest.raises(SimulationError, match="outside the recording"):
            recording(windows=(1.0, start))


def test_a_parameter_without_a_value_is_named():
    with pytest.raises(SimulationError, match=r"rotor\.air\.linear\.a1"):
        recording(numbers={"casing.air.linear.b2": 4e-6})


class TestPaths:
    """A solver that notes the initial states and the intervals, and returns a casing that turns back and forth."""

    def solved(self, monkeypatch, *, angle_dependent=(), restoring=False, own=(7.0,), fails=()):
        calls = []

        def dynamics(model, *, angles=False, inputs=()):
            count = 2 + restoring + len(own) + 2 * angles
            return SimpleNamespace(
                model=model, free_starts=2 + restoring, start=own, states=("state",) * count, inputs=inputs
            )

        def solve(system, numbers, first, mesh):
            calls.append((system.model, numbers, first.tolist(), mesh.edges))
            if len(calls) in fails:
                raise SimulationError("no motion")
            return SimpleNamespace(
                angle=lambda state: (np.array([0.0, 40.4, -60.0]) * np.pi, None), number=len(calls)
            )

        monkeypatch.setattr(module, "Dynamics", dynamics)
        monkeypatch.setattr(module, "solve", solve)
        model = SimpleNamespace(angle_dependent=angle_dependent, smooth="smooth")
        _, path = module.simulate_path(
            model, {"k": 1.0}, Experiment(omega_rotor=8.0, omega_casing=3.0, duration=6.0)
        )
        assert path.number == len(calls)
        return calls

    def test_a_smooth_motion_has_twelve_intervals(self, monkeypatch):
        ((model, numbers, first, edges),) = self.solved(monkeypatch)
        assert (model, numbers, first) == ("smooth", {"k": 1.0}, [8.0, 3.0, 7.0])
        assert edges == pytest.approx(np.linspace(0.0, 6.0, 13))

    def test_a_deflection_is_zero_before_the_states_of_effects(self, monkeypatch):
        ((_, _, first, _),) = self.solved(monkeypatch, restoring=True, own=(7.0, 9.0))
        assert first == [8.0, 3.0, 0.0, 7.0, 9.0]

    def test_a_turn_of_the_casing_has_two_intervals(self, monkeypatch):
        """From -30 to 20 turns: twenty intervals and two for each of them."""
        (smooth, whole) = self.solved(monkeypatch, angle_dependent=("law",))
        assert smooth[2] == [8.0, 3.0, 7.0]
        assert whole[2] == [8.0, 3.0, 7.0, 0.0, 0.0]
        assert whole[3] == pytest.approx(np.linspace(0.0, 6.0, 121))

    def test_a_boundary_layer_has_short_intervals_at_the_start(self, monkeypatch):
        (_, (*_, edges)) = self.solved(monkeypatch, fails=(1,))
        assert len(edges) == 61
        assert edges[:2].tolist() == [0.0, pytest.approx(6e-6)]
        assert edges[-1] == pytest.approx(6.0)
        assert edges[2:] / edges[1:-1] == pytest.approx(np.full(59, 1e6 ** (1 / 59)))
        with pytest.raises(SimulationError):
            self.solved(monkeypatch, fails=(1, 2))


def test_random_torques_are_steps_of_a_fiftieth_of_a_second(monkeypatch):
    """The last one ends with the motion; after it the change of the angle is interpolated."""
    drawn, motions = [], []

    class Motion:
        def __init__(self, path, propagator):
            pass

        def driven(self, times, nodes, direction):
            motions.append((times, nodes, direction))
            return lambda torque: (None, np.stack([3.0 * times, 5.0 * times])[..., None] * torque[0, 0, 0])

    monkeypatch.setattr(module, "LinearMotion", Motion)
    monkeypatch.setattr(module, "sensitivities", lambda *_: SimpleNamespace(propagator=None))
    torques = iter((2.0, 0.1))
    monkeypatch.setattr(
        module, "_ornstein_uhlenbeck", lambda n, *_: drawn.append(n) or np.full(n, next(torques))
    )
    values = {module.INERTIA_ROTOR: 4.0, module.INERTIA_CASING: 0.5}
    path = SimpleNamespace(mesh=Mesh.uniform(0.0, 1.0, 2))
    made = module._RandomTorque(None, path, values, Experiment(duration=1.0, torque_noise=1.0), None)
    time = np.array([0.0, 0.33, 1.0])
    assert made(time, 0) == pytest.approx(2.1 * 3.0 * time)
    assert made(time, 1) == pytest.approx(2.1 * 5.0 * time)
    (times, nodes, own), (_, _, bearing) = motions[:2]
    assert (own.tolist(), bearing.tolist(), nodes) == ([0.0, 2.0], [-0.25, 2.0], 1)
    assert times[:-1] == pytest.approx(0.02 * np.arange(len(times) - 1))
    assert times[-1] <= 1.0 + 1e-12
    assert drawn == [len(times) - 1] * 2
