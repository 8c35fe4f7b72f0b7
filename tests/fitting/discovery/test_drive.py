"""A rise of the speed that the model does not contain is a drive, and no effect is then established."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from fitting.discovery._drive import unrecorded_drive
from fitting.effects._mechanism import MAIN
from fitting.inference._record import Samples

TIME = np.linspace(0.0, 24.0, 2401)
TURN = 2 * math.pi


def angle_of(speed):
    """Return the angle by the trapezoidal rule."""
    return np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(TIME))])


def fit_of(
    monkeypatch,
    measured,
    modelled,
    *,
    sigma=1e-3,
    angle=True,
    driving=(),
    smooth=True,
    restoring=False,
    windows=None,
):
    """Return a fit of one body, or of a rotor in windows beside a casing at rest, with the given speeds."""
    value, model = (angle_of(v) if angle else v for v in (measured, modelled))
    runs = [Samples(TIME, value, np.full(len(TIME), sigma))]
    models, rotor, state = [model], [], MAIN
    if windows is not None:
        still = np.zeros(len(TIME))
        state = 0
        rotor = [Samples(TIME[a:b], value[a:b], np.full(b - a, sigma), state=state) for a, b in windows]
        runs = [Samples(TIME, still, np.full(len(TIME), sigma))]
        models = [still, *(model[a:b] for a, b in windows)]
    record = SimpleNamespace(
        casing=runs[0], rotor=rotor, driving=driving, spun=SimpleNamespace(state=state, name="wheel")
    )
    data = SimpleNamespace(record=record, motion=SimpleNamespace(is_smooth=smooth), is_angle=angle)
    monkeypatch.setattr("fitting.discovery._drive.predicted_samples", lambda *_: iter(models))
    return SimpleNamespace(problem=SimpleNamespace(data=[data]), model=SimpleNamespace(restoring=restoring))


def ramp(rise, level=20.0):
    """Return a speed that falls by 10 until 12 s and rises by `rise` afterwards."""
    return level - 10 * np.minimum(TIME, 12.0) / 12 + rise * np.maximum(TIME - 12.0, 0.0) / 12


SLOWED = ramp(-5.0)


@pytest.mark.parametrize("angle", [True, False])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_rise_of_the_speed_is_a_drive_in_either_sense(monkeypatch, angle, sign):
    found = unrecorded_drive(fit_of(monkeypatch, sign * ramp(8.0), sign * SLOWED, angle=angle))
    # in the middle of parts of one second: 8 (23.5 - 12.5) / 12 = 7.33
    assert found.startswith("The speed of the wheel rises by 7.34 rad/s from 12.5 s to 23.5 s; no torque")
    assert "--input" in found
    assert "--from" in found


def test_the_rise_begins_before_it_ends(monkeypatch):
    """From 20 rad/s down to 10 at 8 s, up to 15 at 12 s, and down to 2 at 24 s."""
    speed = np.interp(TIME, [0, 8, 12, 24], [20.0, 10.0, 15.0, 2.0])
    found = unrecorded_drive(fit_of(monkeypatch, speed, np.interp(TIME, [0, 24], [20.0, 2.0])))
    # the means of parts of one second: 10 + 5 / 8 and 15 - 13 / 24 rad/s
    assert "rises by 3.85 rad/s from 8.5 s to 12.5 s" in found


@pytest.mark.parametrize(("rise", "found"), [(2.3, True), (2.0, False)])
def test_a_tenth_of_the_largest_speed_is_a_rise(monkeypatch, rise, found):
    assert bool(unrecorded_drive(fit_of(monkeypatch, ramp(rise), SLOWED))) is found


@pytest.mark.parametrize(("share", "found"), [(0.4, True), (0.6, False), (1.0, False)])
def test_a_model_with_half_of_the_rise_contains_the_drive(monkeypatch, share, found):
    assert bool(unrecorded_drive(fit_of(monkeypatch, ramp(8.0), ramp(8.0 * share)))) is found


@pytest.mark.parametrize(("sigma", "found"), [(0.72, True), (0.82, False)])
def test_an_angle_rises_beyond_five_standard_uncertainties(monkeypatch, sigma, found):
    # 7.8 rad/s; the uncertainty of the difference of two mean speeds over 0.99 s is 2.02 sigma
    assert bool(unrecorded_drive(fit_of(monkeypatch, ramp(8.5), SLOWED, sigma=sigma))) is found


@pytest.mark.parametrize(("sigma", "found"), [(10.0, True), (10.8, False)])
def test_a_speed_rises_beyond_five_standard_uncertainties(monkeypatch, sigma, found):
    # 7.3 rad/s; means of 100 speeds, whose difference has the uncertainty sigma sqrt(2) / 10
    assert bool(unrecorded_drive(fit_of(monkeypatch, ramp(8.0), SLOWED, sigma=sigma, angle=False))) is found


@pytest.mark.parametrize(
    "options", [{"driving": ("voltage",)}, {"smooth": False}, {"restoring": True}], ids=str
)
def test_a_recorded_drive_and_oscillations_are_not_examined(monkeypatch, options):
    assert unrecorded_drive(fit_of(monkeypatch, ramp(8.0), SLOWED))
    assert unrecorded_drive(fit_of(monkeypatch, ramp(8.0), SLOWED, **options)) == ""


def test_variations_of_the_speed_within_a_turn_do_not_count(monkeypatch):
    # an unbalanced wheel near rest: 3 rad/s, by 1 rad/s faster and slower once per turn
    speed = 3.0 + np.cos(3.0 * TIME)
    assert unrecorded_drive(fit_of(monkeypatch, speed, np.full(len(TIME), 3.0))) == ""


def test_the_rotor_decides_between_its_windows(monkeypatch):
    windows = [(0, 300), (1000, 1300), (2101, 2401)]
    assert unrecorded_drive(fit_of(monkeypatch, ramp(8.0), SLOWED, windows=windows))
    assert unrecorded_drive(fit_of(monkeypatch, SLOWED, SLOWED, windows=windows)) == ""
    # in the wrong order of the windows, a falling speed would rise
    assert unrecorded_drive(fit_of(monkeypatch, SLOWED, SLOWED, windows=windows[::-1])) == ""


def test_a_slow_body_has_one_part(monkeypatch):
    assert unrecorded_drive(fit_of(monkeypatch, np.full(len(TIME), 0.1), np.full(len(TIME), 0.1))) == ""
