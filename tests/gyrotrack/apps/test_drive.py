"""A driven body: recognised, its first-order response with uncertainties, and never a law of friction."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import Input
from fitting._criteria import DEFAULT
from gyrotrack import Series
from gyrotrack.apps import _drive, _spindown
from gyrotrack.apps._drive import drive_from_rest, drive_of
from gyrotrack.apps._motion import motion_of_speeds
from gyrotrack.apps.cli._app import run
from gyrotrack.io.readers._motion_table import Driver

CASES = Path(__file__).parents[4] / "shared" / "cases" / "tables"


def series(time, omega, sigma):
    step = np.diff(time)
    angle = np.concatenate([[0.0], np.cumsum((omega[1:] + omega[:-1]) / 2 * step)])
    return Series(
        time,
        angle,
        np.full(len(time), 1e-3),
        omega,
        np.full(len(time), sigma),
        np.zeros(len(time), dtype=np.int64),
    )


def response(time, voltage, tau, gain, delay=0.0):
    """Exact speed of tau omega' = gain u(t - delay) - omega for one step of u at t = 1."""
    since = np.clip(time - 1.0 - delay, 0, None)
    return gain * (voltage[0] + (voltage[-1] - voltage[0]) * (1 - np.exp(-since / tau)))


TIME = np.arange(2000) / 400
STEP = np.where(TIME < 1.0, 2.0, 12.0)


@pytest.mark.slow
def test_the_response_to_a_step_of_a_voltage():
    pulls = []
    for seed in range(8):
        noise = np.random.default_rng(seed).normal(0, 0.5, len(TIME))
        made = series(TIME, response(TIME, STEP, 0.2, 8.0, 0.03) + noise, 0.5)
        found = drive_of(made, "omega", [Driver("voltage", "V", STEP)]).response
        assert found.explained > 0.99
        assert found.gain.value == pytest.approx(8.0, abs=5 * found.gain.stderr)
        assert found.final.value == pytest.approx(96.0, abs=5 * found.final.stderr)
        assert found.delay.value == pytest.approx(0.03, abs=5 * found.delay.stderr)
        pulls.append((found.time_constant.value - 0.2) / found.time_constant.stderr)
    assert 0.4 < np.sqrt(np.mean(np.square(pulls))) < 1.8  # chi of 8


def test_a_spin_up_by_a_constant_drive():
    noise = np.random.default_rng(1).normal(0, 0.1, len(TIME))
    made = series(TIME, 60 * (1 - np.exp(-TIME / 0.8)) + noise, 0.1)
    found = drive_of(made, "omega", [])
    assert found.reason == "its speed rises 1 time"
    assert found.response.time_constant.value == pytest.approx(0.8, rel=0.02)
    assert found.response.gain is None
    assert found.response.final.value == pytest.approx(60, rel=0.01)


@pytest.mark.parametrize("quantity", ["omega", "angle"])
def test_a_constant_drive_that_begins_within_the_record(quantity):
    """Smoothed speeds are not known at the ends of a record of angles."""
    omega = response(TIME, [0.0, 1.0], 0.2, 60.0)
    noise = np.random.default_rng(2).normal(0, 0.1, len(TIME))
    made = series(TIME, omega + noise, 0.1)
    if quantity == "angle":
        made.omega[:9] = made.omega[-9:] = made.omega_sigma[:9] = made.omega_sigma[-9:] = np.nan
    found = drive_of(made, quantity, [])
    assert found.response.explained > 0.999
    assert found.response.time_constant.value == pytest.approx(0.2, rel=0.02)
    turns = found.omega["last"], found.omega_u["last"]
    assert abs(turns[0] - 60.0) < 4 * turns[1]
    assert turns[1] < 0.2


def test_the_ends_of_a_driven_motion_have_the_uncertainty_of_their_mean():
    """Of angles: the difference of two, each with 1 mrad, over the time of a turn."""
    made = series(TIME, 60 * (1 - np.exp(-TIME / 0.8)), 0.1)
    found = drive_of(made, "angle", [])
    turn = 2 * np.pi / found.omega["last"]
    assert found.omega_u["last"] == pytest.approx(np.sqrt(2) * 1e-3 / turn, rel=0.1)


@pytest.mark.parametrize(
    ("size", "noise", "begin"),
    [(1.0, 1e-3, 1199), (1.0, 0.2, 0), (0.021, 1e-3, 399), (0.019, 1e-3, 1199)],
    ids=["rest", "noise of a sixth", "above a fiftieth", "below a fiftieth"],
)
def test_where_a_rest_ends(size, noise, begin):
    """A change of `size` at sample 400 or, with a small one, of 1 at sample 1200."""
    omega = np.where(TIME < 1.0, 0.0, size if size < 1 else 0.0)
    omega[1200:] = 1.0
    made = series(TIME, omega, noise)
    made.omega[:9] = np.nan
    assert _drive._end_of_rest(made) == begin


def test_without_known_speeds_there_is_no_rest():
    nothing = series(TIME, np.full(len(TIME), np.nan), 1e-3)
    assert _drive._end_of_rest(nothing) == 0


@pytest.mark.parametrize(("rise", "driven"), [(0.03, False), (0.08, True)])
def test_the_smallest_rise_of_a_driven_body(rise, driven):
    omega = 60 * np.exp(-TIME / 10) + 60 * rise * np.exp(-(((TIME - 3) / 0.3) ** 2)) * 1.5
    assert (drive_of(series(TIME, omega, 1e-3), "omega", []) is not None) is driven


def test_the_ripple_of_an_unbalance_within_a_turn_is_not_a_drive():
    omega = 30 * np.exp(-TIME / 10)
    turned = np.concatenate([[0.0], np.cumsum(omega[1:] / 400)])
    assert drive_of(series(TIME, omega + 3 * np.cos(turned), 1e-3), "omega", []) is None


@pytest.mark.parametrize(("level", "driven"), [(0.02, False), (0.1, True)])
def test_an_input_that_stays_on_is_a_drive(level, driven):
    current = np.where(TIME < 0.1, 1.0, level)
    omega = 60 * np.exp(-TIME / 10)
    found = drive_of(series(TIME, omega, 1e-3), "omega", [Driver("current", "A", current)])
    assert (found is not None) is driven


@pytest.mark.slow
def test_speeds_are_fitted_as_speeds():
    """The errors of mean speed and acceleration are those of white noise of the speeds, not of their integral."""
    time = np.arange(80) / 10
    pulls = []
    for seed in range(6):
        omega = 12 * np.exp(-time / 4) + np.random.default_rng(seed).normal(0, 0.04, len(time))
        made = series(time, omega, 0.04)
        found = motion_of_speeds(time, omega, made.omega_sigma, made.angle)
        mean = 12 * 4 * (1 - np.exp(-time[-1] / 4)) / time[-1]
        alpha = -3 * np.exp(-time[-1] / 8)
        pulls.append((found.omega_mean.value - mean) / found.omega_mean.stderr)
        pulls.append((found.alpha.value - alpha) / found.alpha.stderr)
    assert 0.6 < np.sqrt(np.mean(np.square(pulls))) < 1.5


def spindown(capsys, tmp_path, name, *options):
    path = CASES / name
    if not path.is_file():
        pytest.skip("the shared cases are not here")
    code = run(["spindown", str(path), "-o", str(tmp_path / "a.h5"), "--json", *options])
    return code, json.loads(capsys.readouterr().out)


def test_the_step_of_a_real_motor(capsys, tmp_path):
    code, found = spindown(capsys, tmp_path, "motor_step.csv")
    assert code == 0
    assert found["motion"]["kind"] == "driven"
    assert found["diagnosis"] is None
    assert found["response"]["input"] == "Commanded_PWM"
    assert found["response"]["time_constant"]["value"] == pytest.approx(25.2e-3, abs=1e-3)


@pytest.mark.parametrize("name", ["pulse_intervals_short.csv", "pulse_intervals_long.csv"])
def test_a_rowing_flywheel_is_not_a_coast_down(capsys, tmp_path, name):
    code, found = spindown(capsys, tmp_path, name, "--pulses-per-turn", "3")
    assert code == 3
    assert found["motion"]["kind"] == "driven"
    assert found["diagnosis"] is None
    assert found["reading"][0]["columns"][0]["quantity"] == "intervals between pulses"


@pytest.mark.parametrize(
    ("gain", "converged", "late"), [(0.1, True, True), (-0.1, True, False), (50.0, False, False)]
)
def test_a_dead_time_needs_evidence_and_a_fit_that_converged(monkeypatch, gain, converged, late):
    """Beside viscous friction and the drive, the only laws of the first-order fit."""
    asked = []

    def fit(model, data):
        asked.append(model.names)
        first = len(asked) == 1
        bic = 100.0 if first else 100.0 - DEFAULT.evidence - gain
        return SimpleNamespace(model=model, bic=bic, converged=first or converged, criteria=DEFAULT)

    monkeypatch.setattr("fitting.inference._fit.fit", fit)
    pwm = Input("pwm", np.arange(3.0), np.arange(3.0), "V", interpolation="hold")
    found = _spindown._first_order_fit([SimpleNamespace(record=SimpleNamespace(inputs=(pwm,)))], ["pwm"])
    assert asked[0] == ("casing.air.linear", "casing.input.pwm")
    assert asked[1] == (*asked[0], "input.pwm.delay")
    assert ("input.pwm.delay" in found.model.names) is late


@pytest.mark.parametrize(
    ("first", "back", "driven"), [(0.0, 0.0, True), (0.04, 0.0, True), (0.06, 0.0, False), (0.0, -0.1, False)]
)
def test_a_body_at_rest_that_turns_less_than_a_turn_is_driven(first, back, driven):
    """Trapezoid of a controller: the speed is equal at both ends, but not constant (all as shares of the top)."""
    time = np.arange(400) / 100
    shape = np.interp(time, [0, 0.3, 1.2, 2.5, 3.4, 4.0], [first, first, 1, 1, back, back])
    made = series(time, 2.0 * shape, 1e-4)
    assert drive_of(made, "omega", []) is None
    found = drive_from_rest(made, "omega")
    assert (found is not None) is driven
    if found is not None:
        assert found.reason == "its speed rises from rest"
        assert found.response is None


@pytest.mark.parametrize(("top", "driven"), [(13.0, True), (11.0, False)])
def test_a_speed_from_rest_exceeds_twelve_standard_errors(monkeypatch, top, driven):
    speed = np.array([0.0, *np.full(9, top)])
    monkeypatch.setattr(_drive, "window_speeds", lambda *_: (np.arange(10), speed, 1.0))
    assert (drive_from_rest(series(TIME[:50], np.ones(50), 1e-3), "angle") is not None) is driven
    monkeypatch.setattr(_drive, "window_speeds", lambda *_: None)
    assert drive_from_rest(series(TIME[:50], np.ones(50), 1e-3), "angle") is None


def test_a_constant_drive_from_rest_in_few_turns_has_a_response():
    time = np.arange(400) / 100
    omega = 5 * (1 - np.exp(-np.clip(time - 0.5, 0, None) / 0.4))
    found = drive_from_rest(series(time, omega, 1e-3), "omega")
    assert found.response.time_constant.value == pytest.approx(0.4, rel=0.02)
    assert found.omega is None
