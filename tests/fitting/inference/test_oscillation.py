"""Oscillators fitted without initial values, against integration and analytic solutions; turning points and phases."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import oscillators
import pytest

from fitting import LIBRARY, EstimationError, Input, Model, Record, SimulationError, diagnose, improve, plan
from fitting._criteria import DEFAULT
from fitting.discovery._remainder import Torques
from fitting.dynamics._collocation import Mesh, Sampler
from fitting.dynamics._events import solve
from fitting.dynamics._model import INERTIA_CASING, INERTIA_ROTOR, Dynamics
from fitting.effects._user import resolve
from fitting.inference import _oscillation, _problem
from fitting.inference._case_data import CaseData
from fitting.inference._case_model import CaseModel
from fitting.inference._fit import fit
from fitting.inference._oscillation import (
    ROTATION,
    Oscillation,
    are_smooth,
    find_oscillation,
    motion_of,
    turning_points,
)
from fitting.inference._parameters import ParameterLayout
from fitting.inference._record import Samples
from fitting.inference._speed_residuals import SpeedMap

SPRING, DRAG = "casing.spring.linear", "casing.air.linear"


def analytic(t, k, drag, angle):
    """A damped oscillator of unit inertia, released at rest."""
    decay = drag / 2
    rate = np.sqrt(k - decay**2)
    return angle * np.exp(-decay * t) * (np.cos(rate * t) + decay / rate * np.sin(rate * t))


def within(result, truth, sigmas=4.0):
    for name, value in truth.items():
        found = result.estimates[name]
        assert abs(found.value - value) < sigmas * found.stderr, (name, found, value)


@pytest.mark.parametrize("quantity", ["angle", "omega"])
def test_a_damped_oscillator_is_fitted_without_initial_values(quantity):
    t = np.arange(0, 30, 0.01)
    angle = analytic(t, 12.0, 0.08, 1.2)
    rate = np.sqrt(12.0 - 0.04**2)
    value = angle if quantity == "angle" else -1.2 * 12.0 / rate * np.exp(-0.04 * t) * np.sin(rate * t)
    found = fit(Model.of([SPRING, DRAG]), [oscillators.record(t, value, 2e-3, 0, quantity)])
    within(found, {f"{SPRING}.k": 12.0, f"{DRAG}.b2": 0.08, "initial.deflection@body": 1.2})
    # Cramer-Rao: sigma_k = 2 w sigma_w, with the phase of N samples spread over the record
    assert found.estimates[f"{SPRING}.k"].stderr < 2e-3
    assert found.estimates["initial.deflection@body"].unit == "rad"
    assert found.verdict == "no_lack_of_fit"


@pytest.mark.parametrize("bias", [0.05, -0.3])
def test_the_bias_of_a_gyroscope_changes_no_parameter(bias):
    t, _, omega = oscillators.motion(lambda t, a, w: -9.0 * a - 0.05 * w, (1.0, 0.3), 30.0, 50.0)
    found = fit(Model.of([SPRING, DRAG]), [oscillators.record(t, omega + bias, 0.01, 3, "omega")])
    assert found.verdict == "no_lack_of_fit"
    within(
        found,
        {f"{SPRING}.k": 9.0, f"{DRAG}.b2": 0.05, "initial.omega_c@body": 0.3, "initial.deflection@body": 1.0},
    )


@pytest.mark.slow
def test_a_pendulum_of_large_amplitude_is_fitted():
    t, angle, _ = oscillators.motion(lambda t, a, w: -25 * np.sin(a) - 0.05 * w, (2.2, 0.0), 20.0)
    found = fit(Model.of(["casing.gravity", DRAG]), [oscillators.record(t, angle + 0.4, 1e-3, 1)])
    within(found, {"casing.gravity.k": 25.0, f"{DRAG}.b2": 0.05, "initial.deflection@body": 2.2})


@pytest.mark.parametrize("dry", [0.0, pytest.param(0.03, marks=pytest.mark.slow)])
def test_an_eccentric_torsion_pendulum_is_fitted_over_many_periods(dry):
    """An unbalance shifts the frequency: through 10 periods by more than a response of first order describes."""
    t, angle, _ = oscillators.motion(
        lambda t, a, w: -12 * a - 0.03 * w + 0.7 * np.sin(a - 2.2), (1.6, 1.0), 18.0, 30.0, dry
    )
    dropped = {"touchpoint.constant.b1": dry} if dry else {}
    model = Model.of([SPRING, DRAG, "casing.unbalance", *(["touchpoint.constant"] if dry else [])])
    found = fit(model, [oscillators.record(t, angle, 2e-3, 4)])
    truth = {f"{SPRING}.k": 12.0, f"{DRAG}.b2": 0.03, "casing.unbalance.k": 0.7, "casing.unbalance.phi": 2.2}
    within(found, truth | dropped)
    assert found.verdict == "no_lack_of_fit"


@pytest.mark.parametrize("dry", [0.0, 0.02])
def test_the_motion_of_a_body_released_at_rest_does_not_depend_on_the_sign_of_its_speed(dry):
    """One reversal more or less at the very start: the trials of a search pass from one sign to the other."""
    t, angle, _ = oscillators.motion(lambda t, a, w: -12 * a - 0.03 * w, (1.2, 0.0), 12.0, 30.0, dry)
    model = Model.of([SPRING, DRAG, "touchpoint.constant"])
    found = fit(model, [oscillators.record(t, angle, 1e-3, 5)])
    within(found, {f"{SPRING}.k": 12.0, f"{DRAG}.b2": 0.03, "initial.omega_c@body": 0.0})
    (case,), place = found.problem.cases, found.problem.layout.index["initial.omega_c@body"]
    rows = []
    for speed in (0.0, 1e-6, -1e-6, 3e-3, -3e-3, 0.05, -0.05, 0.0):
        theta = found.theta.copy()
        theta[place] = speed
        rows.append(case.predict(theta).rows)
    assert np.abs(rows[0] - rows[-1]).max() < 1e-6
    assert np.abs(rows[1] - rows[2]).max() < 1e-2
    middle = 0.5 * (rows[3] + rows[4])
    assert np.abs(middle - rows[0]).max() < 0.01 * np.abs(rows[3] - rows[0]).max()


@pytest.mark.slow
@pytest.mark.release
def test_quadratic_drag_of_a_pendulum_released_at_rest_is_the_second_effect():
    t, angle, _ = oscillators.motion(
        lambda t, a, w: -12 * np.sin(a) - 0.01 * w - 0.008 * w * abs(w), (1.3, 0.0), 25.0, 50.0
    )
    history = improve(fit(Model.of(["touchpoint.constant", DRAG]), [oscillators.record(t, angle, 2e-3, 6)]))
    assert [s.change for s in history[1:3]] == ["+casing.gravity", "+casing.air.quadratic"]
    within(history[2].fit, {"casing.gravity.k": 12.0, f"{DRAG}.b2": 0.01, "casing.air.quadratic.k": 0.008})
    assert {c.effect.name for c in history[0].candidates} <= {n for n, e in LIBRARY.items() if e.restoring}


@pytest.mark.slow
@pytest.mark.parametrize("amplitude", [0.3, 0.03])
def test_the_view_of_a_camera_does_not_explain_an_oscillation_on_film(amplitude):
    """Over a part of a turn a displaced hub is a change of scale: one of minus one would explain any motion."""
    t, angle, _ = oscillators.motion(lambda t, a, w: -25.6 * a - 0.02 * w, (amplitude, 0.0), 10.0, 30.0)
    record = replace(oscillators.record(t, angle, 6e-4, 8), tracked=True)
    base = fit(Model.of(["touchpoint.constant", DRAG]), [record])
    assert base.verdict == "lack_of_fit"
    assert base.lacks_restoring_torque
    found = fit(Model.of([SPRING, "touchpoint.constant", DRAG]), [record])
    within(found, {f"{SPRING}.k": 25.6, "initial.deflection@body": amplitude})
    assert found.verdict in {"no_lack_of_fit", "not_determined"}
    with pytest.raises(EstimationError, match="oscillates"):
        plan(found)


@pytest.mark.slow
def test_small_oscillations_separate_no_restoring_torques_and_a_larger_release_would():
    t, angle, _ = oscillators.motion(lambda t, a, w: -25.6 * a - 0.02 * w, (0.03, 0.0), 20.0, 30.0)
    base = fit(Model.of(["touchpoint.constant", DRAG]), [oscillators.record(t, angle, 6e-4, 8)])
    found = diagnose(base)
    first = found.candidates[0]
    assert {first.effect.name, *first.indistinguishable_from} == {SPRING, "casing.gravity"}
    assert "larger angle" in found.next_experiment
    assert found.failures == ()


@pytest.mark.slow
def test_torques_are_compared_about_the_equilibrium_of_each_fit():
    def acceleration(t, a, w):
        return 1.5 - 12 * np.sin(a) - 0.05 * w

    t, angle, _ = oscillators.motion(acceleration, (1.0, 0.0), 15.0, 40.0)
    data = [CaseData.of(oscillators.record(t, angle, 1e-3, 6))]
    base, named, end = (
        fit(Model.of([DRAG, *more]), data)
        for more in ([], ["casing.gravity"], ["casing.gravity", "external.constant"])
    )
    within(end, {"casing.gravity.k": 12.0, "external.constant.k": 1.5})
    # the constant torque shifts the equilibrium by 0.125 rad; along the motion it changes the torque by little
    assert Torques(base, end, residual=False).remaining(named)[0] < 5e-3


def test_a_spring_is_not_a_power_of_a_speed():
    t, angle, _ = oscillators.motion(lambda t, a, w: -12 * a - 0.03 * w, (1.2, 0.3), 6.0, 40.0)
    power = resolve("casing: -k*abs(omega_c)**n*sign(omega_c)")
    found = fit(Model.of([SPRING]).with_effect(power), [oscillators.record(t, angle, 1e-3, 7)])
    assert found.estimates[f"{SPRING}.k"].value == pytest.approx(12.0, abs=0.05)


@pytest.mark.slow
def test_a_distant_trial_is_refused_and_a_near_one_is_continued():
    t, angle, _ = oscillators.motion(lambda t, a, w: -12 * a - 0.03 * w, (1.2, 0.5), 40.0, 40.0, 0.02)
    found = fit(Model.of([SPRING, DRAG, "touchpoint.constant"]), [oscillators.record(t, angle, 2e-3, 5)])
    (case,), k = found.problem.cases, found.problem.layout.index[f"{SPRING}.k"]
    before = case.solve(found.theta)
    for change in (1e-3, 4e-3):  # through 22 periods the latter is 0.3 rad of phase
        theta = found.theta.copy()
        theta[k] *= 1 + change
        path = case.solve(theta)
        assert len(path.jumps) == pytest.approx(len(before.jumps), abs=1)
        case.solve(found.theta)
    theta[k] = 40.0
    with pytest.raises(SimulationError):
        case.solve(theta)
    np.testing.assert_allclose(case.solve(found.theta).edges[-1], before.edges[-1], atol=1e-7)


def test_dry_friction_with_reversals_until_rest_is_solved():
    t, angle, _ = oscillators.motion(lambda t, a, w: -10 * a - 0.05 * w, (1.0, 0.0), 25.0, dry=0.15)
    found = fit(Model.of([SPRING, DRAG, "touchpoint.constant"]), [oscillators.record(t, angle, 1e-3, 2)])
    within(found, {f"{SPRING}.k": 10.0, f"{DRAG}.b2": 0.05, "touchpoint.constant.b1": 0.15})


def test_reversals_solved_jointly_agree_with_sequential_ones():
    dynamics = Dynamics(Model.of([SPRING, DRAG, "touchpoint.constant"]))
    numbers = {f"{SPRING}.k": 10.0, f"{DRAG}.b2": 0.02, "touchpoint.constant.b1": 0.3}
    numbers |= {INERTIA_ROTOR: 1.0, INERTIA_CASING: 1.0}
    start, mesh = np.array([0.0, 1.0, -1.0]), Mesh.uniform(0.0, 30.0, 90)
    near = solve(dynamics, numbers, start, mesh)
    moved = numbers | {"touchpoint.constant.b1": 0.28, f"{SPRING}.k": 10.1}
    together, alone = solve(dynamics, moved, start, mesh, near), solve(dynamics, moved, start, mesh)
    t = np.linspace(0, 30, 400)
    states = [Sampler(p.mesh, t).value(p.y) for p in (together, alone)]
    np.testing.assert_allclose(states[0], states[1], atol=1e-10)
    assert len(together.jumps) == len(alone.jumps) != len(near.jumps)


@pytest.mark.parametrize(
    "excess", [1e-12, pytest.param(1e-10, marks=pytest.mark.slow), pytest.param(1e-8, marks=pytest.mark.slow)]
)
def test_a_body_that_friction_hardly_holds_is_solved(excess):
    """All torques but this share of the friction cancel: its speed is rounding."""
    dynamics = Dynamics(Model.of(["casing.gravity", DRAG, "touchpoint.constant", "external.constant"]))
    numbers = {"casing.gravity.k": 7.0, f"{DRAG}.b2": 1e-4, "touchpoint.constant.b1": 0.012}
    numbers |= {"external.constant.k": 0.0, INERTIA_ROTOR: 1.0, INERTIA_CASING: 1.0}
    mesh = Mesh.uniform(0.0, 40.0, 160)
    near = solve(dynamics, numbers, np.array([0.0, 0.3, 0.25]), mesh)
    drive = 7.0 * np.sin(-0.25) + 0.012 * (1 + excess)
    path = solve(dynamics, numbers | {"external.constant.k": drive}, np.array([0.0, 0.0, -0.25]), mesh, near)
    assert len(path.y) < 1000
    np.testing.assert_allclose(path.edges[:, 2], -0.25, atol=1e-6)
    assert np.abs(path.edges[:, 1]).max() < 0.012 * excess


@pytest.mark.slow
def test_the_derivative_with_respect_to_dry_friction_is_right_after_reversals():
    from fitting.dynamics._sensitivities import sensitivities

    dynamics = Dynamics(Model.of([SPRING, "touchpoint.constant"]))
    numbers = {f"{SPRING}.k": 10.0, "touchpoint.constant.b1": 0.1, INERTIA_ROTOR: 1.0, INERTIA_CASING: 1.0}
    start, mesh = np.array([0.0, 0.5, -1.0]), Mesh.uniform(0.0, 8.0, 30)
    path = solve(dynamics, numbers, start, mesh)
    slope = sensitivities(dynamics, numbers, path).edges[-1]
    for column, key in enumerate(dynamics.parameters):
        ends = [
            solve(dynamics, numbers | {key: numbers[key] + step}, start, mesh).edges[-1]
            for step in (1e-5, -1e-5)
        ]
        np.testing.assert_allclose(slope[:, column], (ends[0] - ends[1]) / 2e-5, atol=1e-6)
    up, down = (solve(dynamics, numbers, start + np.array([0, 0, h]), mesh).edges[-1] for h in (1e-5, -1e-5))
    np.testing.assert_allclose(slope[:, -1], (up - down) / 2e-5, atol=1e-6)


def test_turning_points_exceed_the_noise():
    t = np.linspace(0, 4 * np.pi, 400)
    assert len(turning_points(np.sin(t), 0.1)) == 4
    assert len(turning_points(0.04 * np.sin(t), 0.1)) == 0


def test_a_body_that_turns_in_one_sense_does_not_oscillate():
    t = np.arange(0, 20, 0.01)
    assert find_oscillation(oscillators.record(t, 30 * t - 0.7 * t**2, 1e-3, 0)) is None
    swing = find_oscillation(oscillators.record(t, 3.0 + analytic(t, 10.0, 0.1, 1.0), 1e-3, 0))
    assert swing is not None
    assert swing.period == pytest.approx(2 * np.pi / np.sqrt(10.0 - 0.05**2), rel=5e-3)
    assert np.abs(swing.deflection - analytic(t, 10.0, 0.1, 1.0)).max() < 0.02


def test_a_step_of_friction_between_reversals_is_solved():
    dynamics = Dynamics(Model.of([SPRING, "touchpoint.constant", "touchpoint.step"]))
    numbers = {f"{SPRING}.k": 10.0, "touchpoint.constant.b1": 0.1, "touchpoint.step.k": 0.1}
    numbers |= {"touchpoint.step.t0": 4.1, INERTIA_ROTOR: 1.0, INERTIA_CASING: 1.0}
    start, mesh = np.array([0.0, 0.5, -1.0]), Mesh.uniform(0.0, 8.0, 30)
    near = solve(dynamics, numbers, start, mesh)
    for t0 in (4.2, 5.6):
        moved = numbers | {"touchpoint.step.t0": t0}
        ends = [solve(dynamics, moved, start, mesh, guess).edges[-1] for guess in (near, None)]
        np.testing.assert_allclose(*ends, atol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "law"),
    [
        (SPRING, lambda t, a, w: -12 * a - 0.1 * w),
        ("casing.gravity", lambda t, a, w: -12 * np.sin(a) - 0.1 * w),
        ("casing.spring.cubic", lambda t, a, w: -12 * a**3 - 0.1 * w),
    ],
)
@pytest.mark.release
def test_a_missing_restoring_torque_is_found(name, law):
    """From dry friction and drag, the model with which every study of a single body begins."""
    t, angle, _ = oscillators.motion(law, (1.3, 0.0), 15.0, rate=50.0)
    base = fit(Model.of(["touchpoint.constant", DRAG]), [oscillators.record(t, angle, 2e-3, 4)])
    steps = improve(base, max_steps=1)
    assert steps[-1].change == f"+{name}"
    within(steps[-1].fit, {f"{name}.k": 12.0})
    assert steps[-1].fit.verdict == "no_lack_of_fit"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "law", "dry"),
    [
        ([SPRING, DRAG], lambda t, a, w: -12 * a - 0.1 * w, 0.0),
        (["casing.gravity", DRAG], lambda t, a, w: -12 * np.sin(a) - 0.1 * w, 0.0),
        ([SPRING, "touchpoint.constant"], lambda t, a, w: -12 * a, 0.1),
    ],
)
@pytest.mark.release
def test_95_percent_intervals_contain_the_truth(model, law, dry):
    t, angle, _ = oscillators.motion(law, (1.0, 0.0), 10.0, rate=40.0, dry=dry)
    truth = {f"{model[0]}.k": 12.0, "initial.deflection@body": 1.0}
    truth |= {"touchpoint.constant.b1": 0.1} if dry else {f"{DRAG}.b2": 0.1}
    inside = []
    for seed in range(30):
        found = fit(Model.of(model), [oscillators.record(t, angle, 2e-3, seed)]).estimates
        inside += [abs(found[k].value - v) < 1.96 * found[k].stderr for k, v in truth.items()]
    # 90 intervals, three of each fit correlated: 0.95 within 2 and at most 3 standard deviations
    assert np.mean(inside) > 0.88
    scatter = [abs(found[k].value - v) / found[k].stderr for k, v in truth.items()]
    assert max(scatter) < 5


@pytest.mark.parametrize("frequency", [2.0, 3.0])
def test_a_record_may_end_with_a_reversal(frequency):
    """Sampled about twice a period: with 3 rad/s the last sample is a turning point."""
    t = np.arange(60.0)
    body = oscillators.record(t, np.sin(frequency * t), 1e-3, 1, "omega")
    assert (CaseData.of(body).oscillation.reversals[-1] == t[-1]) == (frequency == 3.0)
    model = Model.of((DRAG, SPRING, "touchpoint.constant"))
    layout = ParameterLayout.of(model, [body])
    path = CaseModel(CaseData.of(body), layout, 0)._measured(np.ones(len(layout.names)))
    assert 0 < min(path.jumps) < max(path.jumps) < len(path.y)


def test_a_spring_on_a_body_that_turns_in_one_sense_is_fitted():
    t = np.arange(0.0, 20.0, 0.05)
    body = oscillators.record(t, 30.0 * t - 0.2 * t**2, 1e-3, 1)
    found = fit(Model.of((DRAG, SPRING, "touchpoint.constant")), [body], quick=True)
    assert np.isfinite(found.theta).all()


@pytest.mark.parametrize(
    ("duration", "periods"),
    [(30.0, 1), pytest.param(90.0, 4, marks=pytest.mark.slow)],
    ids=["48 periods", "200 periods"],
)
def test_the_residual_speed_of_an_oscillation_is_resolved_within_a_period(duration, periods):
    """A wrong spring changes the phase, a wrong deflection the amplitude: residual speeds in quadrature."""
    t = np.arange(0, duration, 0.04)
    record = oscillators.record(t, analytic(t, 12.0, 0.02, 1.2), 1e-3, 0)
    found = fit(Model.of([SPRING, DRAG]), [record])
    data, to_speeds = found.problem.data[0], SpeedMap(found.problem, found.noise[0], 0)
    _, time, width, _ = to_speeds.parts[0]
    period = 2 * np.pi / np.sqrt(12.0)
    assert np.median(width) == pytest.approx(period / 8, rel=0.1)
    assert len(data.casing.operators) == round(data.oscillation.periods / periods)
    names = f"{SPRING}.k", f"{DRAG}.b2", "initial.deflection@body"
    values = np.array([found.values[n] for n in names])
    inside = time[:, None] + 0.5 * width[:, None] * np.linspace(-1, 1, 101)
    for name in (names[0], names[2]):
        step = 0.01 * np.array([n == name for n in names])
        theta = found.theta.copy()
        theta[found.problem.layout.names.index(name)] += 0.01
        rows = found.problem.predict(theta)[0].rows - found.predictions[0].rows
        change = analytic(inside, *(values + step)) - analytic(inside, *values)
        slope = [np.polyfit(x - x.mean(), y, 1)[0] for x, y in zip(inside, change, strict=True)]
        # the polynomials of a block follow the fundamental
        assert to_speeds(rows)[0] == pytest.approx(np.array(slope), abs=0.05 * np.abs(slope).max())


class TestMotion:
    """A rotation has what an oscillation has, as nothing, zero or without a limit."""

    t = np.arange(0.0, 20.0, 0.05)

    def both(self):
        swing = motion_of(oscillators.record(self.t, analytic(self.t, 10.0, 0.1, 1.0), 1e-3, 0))
        return motion_of(oscillators.record(self.t, 30 * self.t - 0.7 * self.t**2, 1e-3, 0)), swing

    def test_of_a_record(self):
        turning, swinging = self.both()
        assert (turning.is_smooth, swinging.is_smooth) == (True, False)
        assert are_smooth([turning, turning])
        assert not are_smooth([turning, swinging])
        assert (len(turning.reversals), turning.periods, turning.slow_motion) == (0, 0.0, None)
        assert (turning.period, turning.amplitude) == (np.inf, np.inf)
        assert turning.phase(self.t[:3]).tolist() == [0.0, 0.0, 0.0]
        assert swinging.amplitude == pytest.approx(0.5 * np.ptp(swinging.deflection))

    def test_functions_beside_the_motion(self):
        turning, swinging = self.both()
        assert [m.harmonics(len(self.t)).shape[1] for m in (turning, swinging)] == [0, 24]
        assert [m.offsets(5).shape for m in (turning, swinging)] == [(5, 0), (5, 1)]
        assert [m.samples_per_period(400) > 399 for m in (turning, swinging)] == [True, False]
        columns = np.stack([self.t, self.t**2], axis=1)
        assert turning.beyond_motion(columns, self.t) is columns
        rest = swinging.beyond_motion(columns, self.t)
        assert np.abs(rest[:, 0]).max() < 1e-9
        assert np.abs(rest[:, 1]).max() > 1.0

    def test_numbers_of_rough_speeds(self):
        turning, swinging = self.both()
        assert turning.rough == ()
        assert swinging.rough == (int(np.ceil(24 * swinging.periods)), 3)


@pytest.mark.parametrize(
    ("samples", "width"), [(16.0 * 60, 51), (16.0 * 48.5, 49), (16.0 * 3.5, 3), (16.0 * 1.9, 1)]
)
def test_speeds_are_smoothed_over_a_sixteenth_of_a_period_at_most(samples, width):
    data = SimpleNamespace(
        motion=SimpleNamespace(samples_per_period=lambda n: samples * n), record=SimpleNamespace(casing=[0.0])
    )
    assert CaseData.smoothing_width.fget(data) == width


def test_the_largest_torque_of_an_oscillation_is_that_of_sixteenths_of_its_period():
    """The second difference of a sinusoid over parts of length d is smaller by [sin(w d) / (w d)]^2 than w^2 A."""
    t = np.arange(0.0, 60.0, 1e-3)
    run = SimpleNamespace(samples=Samples(t, 0.3 * np.sin(2 * np.pi * t), np.ones_like(t)))
    data = SimpleNamespace(
        record=SimpleNamespace(I_casing=2.0, I_rotor=1.0),
        casing=run,
        rotor=(),
        motion=SimpleNamespace(period=1.0),
        is_angle=True,
    )
    x = 2 * np.pi / 16
    expected = 2.0 * 0.3 * (2 * np.pi) ** 2 * (np.sin(x) / x) ** 2
    assert CaseData.largest_torque.func(data) == pytest.approx(expected, rel=1e-3)


class TestGrossMisfit:
    """White noise of the torque changes the phase by sqrt(s^2 tau t / (1 + w^2 tau^2)) / (a w I) rms."""

    PERIOD, PERIODS, TAU, INERTIA = 0.8, 25.0, 0.3, 2e-3

    def fails(self, monkeypatch, share, *, slow=True):
        w = 2 * np.pi / self.PERIOD
        duration = self.PERIOD * self.PERIODS
        # the root of the mean square of the amplitudes is 0.25 rad
        most = DEFAULT.gross_misfit * 0.25 * w * self.INERTIA
        level = share * most * np.sqrt((1 + (w * self.TAU) ** 2) / (self.TAU * duration))
        seen = []
        monkeypatch.setattr(_problem, "remaining_level", lambda *given: seen.append(given) or (level, 0.0))
        motion = SimpleNamespace(
            period=self.PERIOD,
            periods=self.PERIODS,
            slow_motion=SimpleNamespace(amplitude=np.array([0.15, 0.05, np.sqrt(0.1625)])) if slow else None,
        )
        data = SimpleNamespace(
            motion=motion, z=np.array([5.0, 7.0]), nuisance=np.array([[3.0], [4.0]]), criteria=DEFAULT,
            record=SimpleNamespace(I_casing=self.INERTIA),
        )  # fmt: skip
        prediction = SimpleNamespace(rows=np.array([4.0, 5.0]), columns=np.array([[1.0], [2.0]]))
        found = _problem.fails_grossly(data, prediction, SimpleNamespace(whitener="white", time=self.TAU))
        return found, seen

    @pytest.mark.parametrize(("share", "gross"), [(0.95, False), (1.05, True)])
    def test_the_phase_is_random_beyond_its_criterion(self, monkeypatch, share, gross):
        found, ((whitener, residual, columns),) = self.fails(monkeypatch, share)
        assert found is gross
        assert (whitener, residual.tolist()) == ("white", [1.0, 2.0])
        assert columns.tolist() == [[1.0, 3.0], [2.0, 4.0]]

    def test_few_periods_have_no_random_phase(self, monkeypatch):
        assert self.fails(monkeypatch, 9.0, slow=False) == (False, [])


@pytest.mark.parametrize(("level", "expected"), [(0.05, 0.06), (0.07, 0.07)])
def test_a_search_far_from_the_minimum_has_a_hundredth_of_the_torque_on_the_other_bodies(level, expected):
    """Moments of inertia 2, 5 and 3, median accelerations 1.5, 9 and 2; the second body is the main one."""
    rates = np.array([[1.0, 9.0, -2.0], [-1.5, 9.0, 2.0], [7.0, -9.0, -8.0]])
    case = SimpleNamespace(
        case=0,
        dynamics=SimpleNamespace(rates=lambda *_: rates),
        data=SimpleNamespace(record=SimpleNamespace(inertias=(2.0, 5.0, 3.0))),
    )
    path = SimpleNamespace(mesh=SimpleNamespace(times=None), y=None)
    problem = SimpleNamespace(
        cases=[case],
        predict=lambda theta: [SimpleNamespace(path=path)],
        layout=SimpleNamespace(numbers=lambda theta, case: {}),
    )
    known = SimpleNamespace(level=level, at=lambda raised: raised)
    assert _problem.raised_noise(problem, None, [known]) == (pytest.approx(expected),)


T = np.arange(0.0, 20.0, 0.02)


def record(value, quantity="angle", sigma=1e-4, t=T, **more):
    return Record("x", 1.0, 1.0, Samples(t, value, np.full(len(t), sigma)), (), quantity, **more)


class TestTurningPoints:
    def test_reversals_beyond_the_hysteresis_count(self):
        curve = np.array([0.0, 2.0, 5.0, 4.5, 6.0, 3.0, 4.0, 1.0, 9.0, 0.0])
        assert turning_points(curve, 0.9).tolist() == [4, 5, 6, 7, 8]
        assert turning_points(curve, 1.1).tolist() == [4, 7, 8]
        assert turning_points(-curve, 1.1).tolist() == [4, 7, 8]
        assert turning_points(curve, 0.4).tolist() == [2, 3, 4, 5, 6, 7, 8]
        assert turning_points(curve, 20.0).tolist() == []

    def test_the_first_sense_is_that_of_the_first_large_change(self):
        assert turning_points(np.array([0.0, -0.5, 0.4, -0.4, 3.0, 0.0]), 2.0).tolist() == [4]
        assert turning_points(np.array([0.0, 0.5, -0.4, 0.4, -3.0, 0.0]), 2.0).tolist() == [4]

    def test_a_speed_changes_its_sign_between_significant_samples(self):
        speed = np.array([3.0, 0.1, -0.1, 0.1, -1.0, -4.0, 0.2, 4.0])
        assert _oscillation._sign_changes(speed, 0.5).tolist() == [3, 6]
        assert _oscillation._sign_changes(speed, 0.15).tolist() == [3, 6]
        assert len(_oscillation._sign_changes(speed, 0.05)) == 4
        assert _oscillation._sign_changes(speed, 5.0).tolist() == []


class TestOscillation:
    def test_a_decaying_oscillation_has_its_period_and_equilibrium(self):
        angle = 0.7 + 1.5 * np.exp(-0.02 * T) * np.cos(2.5 * T)
        found = find_oscillation(record(angle))
        assert found.period == pytest.approx(2 * math.pi / 2.5, rel=0.01)
        assert found.deflection == pytest.approx(angle - 0.7, abs=0.01)
        assert found.periods == pytest.approx(19.98 / found.period)
        assert found.amplitude == pytest.approx(0.5 * np.ptp(angle))
        assert len(found.reversals) == int(20.0 * 2.5 / math.pi)
        assert found.phase(found.reversals) == pytest.approx(
            math.pi * np.arange(len(found.reversals)), abs=0.06
        )

    def test_measured_speeds_oscillate_beside_a_drift(self):
        speed = 0.05 + 1.5 * np.cos(2.5 * T)
        found = find_oscillation(record(speed, "omega"))
        assert found.period == pytest.approx(2 * math.pi / 2.5, rel=0.02)
        assert found.deflection == pytest.approx(0.6 * np.sin(2.5 * T), abs=0.03)

    @pytest.mark.parametrize(("reversals", "found"), [(2, False), (3, True), (4, True)])
    def test_it_has_at_least_three_reversals(self, reversals, found):
        t = T[(reversals + 0.4) * math.pi / 2.5 > T]
        assert (find_oscillation(record(np.sin(2.5 * t - 1.2), t=t)) is not None) is found

    @pytest.mark.parametrize(("drift", "found"), [(0.95, True), (1.15, False)])
    def test_a_body_with_a_net_rotation_does_not_oscillate(self, drift, found):
        """The extremes of sin(2.5 t) + drift t advance by the drift; the share of the path is 0.6 at about 1.05."""
        angle = np.sin(2.5 * T) + drift * T
        turns = turning_points(angle, 0.01 * np.ptp(angle))
        extreme = angle[turns]
        share = abs(extreme[-1] - extreme[0]) / np.abs(np.diff(extreme)).sum()
        assert bool(share < 0.6) is found
        assert (find_oscillation(record(angle)) is not None) is found
        assert (find_oscillation(record(-angle)) is not None) is found

    @pytest.mark.parametrize(("sigma", "found"), [(0.24, True), (0.26, False)])
    def test_noise_hides_reversals(self, sigma, found):
        """The range is 2; reversals by less than 8 sigma do not count."""
        assert (find_oscillation(record(np.cos(2.5 * T), sigma=sigma)) is not None) is found
        speed = record(np.cos(2.5 * T), "omega", sigma=sigma / 2)
        assert (find_oscillation(speed) is not None) is found

    def test_the_middle_of_angles_is_fixed_and_that_of_integrated_speeds_drifts(self):
        """Of three extremes about the equilibrium e, the sum e1 + 2 e2 + e3 is 4 e."""
        angle = np.cos(2.5 * T) + 0.02 * T
        found = find_oscillation(record(angle))
        rest = angle - found.deflection
        assert rest == pytest.approx(np.full(len(T), rest[0]))
        assert rest[0] == pytest.approx(0.2, abs=0.03)
        speed = -2.5 * np.sin(2.5 * T) + 0.02
        drifting = find_oscillation(record(speed, "omega"))
        assert drifting.deflection == pytest.approx(np.cos(2.5 * T), abs=0.03)
        short = T[4.5 * math.pi / 2.5 > T]
        few = find_oscillation(record(-2.5 * np.sin(2.5 * short) + 0.02, "omega", t=short))
        assert len(few.reversals) == 4
        integral = np.cos(2.5 * short) - 1.0 + 0.02 * short
        assert np.ptp(integral - few.deflection) < 2e-3

    def test_windows_follow_a_motion_with_a_third_harmonic(self):
        t = np.arange(0.0, 60.0, 0.02)
        phase = 3.0 * t
        angle = np.cos(phase) + 0.2 * np.cos(3 * phase + 0.5)
        swing = Oscillation(np.arange(1, 57) * math.pi / 3.0, 2 * math.pi / 3.0, t, angle)
        assert swing.slow_motion.amplitude == pytest.approx(np.ones(20), abs=1e-3)

    def test_a_driven_body_or_one_with_a_joint_rotates(self):
        angle = np.cos(2.5 * T)
        assert isinstance(motion_of(record(angle)), Oscillation)
        u = Input("u", T[[0, -1]], np.array([0.0, 1.0]), "A")
        assert motion_of(record(angle, inputs=(u,))) is ROTATION
        both = Record("x", 1.0, 1.0, record(angle).casing, (record(90 * T).casing,))
        assert motion_of(both) is ROTATION

    def test_windows_follow_amplitude_and_phase(self):
        t = np.arange(0.0, 60.0, 0.02)
        amplitude, phase = 1.5 * np.exp(-0.02 * t), 6.0 * t - 0.01 * t**2
        found = find_oscillation(record(0.3 + amplitude * np.cos(phase), t=t)).slow_motion
        assert len(found.time) == 20
        assert found.amplitude == pytest.approx(1.5 * np.exp(-0.02 * found.time), rel=2e-3)
        change = found.phase - (6.0 * found.time - 0.01 * found.time**2)
        assert change - 2 * math.pi * np.round(change / (2 * math.pi)) == pytest.approx(
            np.zeros(20), abs=5e-3
        )

    @pytest.mark.parametrize(
        ("periods", "windows"), [(2.7, None), (3.5, 3), (12.0, 11), (45.0, 20), (90.0, 29)]
    )
    def test_the_number_of_windows_grows_with_the_periods(self, periods, windows):
        t = np.linspace(0.0, periods * 2 * math.pi, 4000)
        found = Oscillation(np.arange(1, int(2 * periods)) * math.pi, 2 * math.pi, t, np.cos(t)).slow_motion
        assert (None if found is None else len(found.time)) in {
            windows,
            None if windows is None else windows + 1,
        }

    def test_windows_need_ten_samples(self):
        t = np.linspace(0.0, 40 * math.pi, 180)
        assert Oscillation(np.arange(1, 40) * math.pi, 2 * math.pi, t, np.cos(t)).slow_motion is None
        t = np.linspace(0.0, 40 * math.pi, 230)
        assert Oscillation(np.arange(1, 40) * math.pi, 2 * math.pi, t, np.cos(t)).slow_motion is not None

    def test_a_phase_is_continued_linearly(self):
        at = np.linspace(2.0, 6.0, 9)
        phase = 1.0 + 3.0 * at - 0.2 * at**2
        found = _oscillation._smooth_phase(at, phase, np.array([1.0, 2.0, 5.0, 6.0, 8.0]))
        assert found == pytest.approx([6.2 - 2.2, 6.2, 11.0, 11.8, 11.8 + 2 * 0.6])
        few = _oscillation._smooth_phase(at[:3], phase[:3], at[:3])
        assert few == pytest.approx(np.polyval(np.polyfit(at[:3], phase[:3], 1), at[:3]))

    def test_harmonics_are_products_with_powers_of_time(self):
        t = np.linspace(0.0, 10.0, 300)
        swing = Oscillation(np.arange(1, 6) * 1.7, 3.4, t, np.cos(t))
        columns = swing.harmonics(300)
        assert columns.shape == (300, 24)
        x = t / 5 - 1
        assert columns[:, 0] == pytest.approx(np.cos(swing.phase(t)))
        assert columns[:, 5] == pytest.approx(np.sin(swing.phase(t)) * x)
        assert columns[:, 22] == pytest.approx(np.sin(3 * swing.phase(t)) * (1.5 * x**2 - 0.5))
