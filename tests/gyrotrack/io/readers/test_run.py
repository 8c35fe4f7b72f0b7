"""What belongs to a run: the start of an oscillation that a hand holds, pushes or releases."""

from pathlib import Path

import numpy as np
import pytest

from gyrotrack import UsageError, import_body
from gyrotrack.io.readers._clock import MIN_SAMPLES
from gyrotrack.io.readers._motion_table import MotionTable
from gyrotrack.io.readers._run import Limits, enough_within, run_of, start_of_oscillation


def swing(t, period, decay):
    return np.exp(-decay * t) * np.cos(2 * np.pi * t / period + 1.0)


@pytest.mark.parametrize("seed", range(6))
def test_a_free_oscillation_is_not_cut(seed):
    random = np.random.default_rng(seed)
    t = np.arange(0, 40, 0.02)
    size = random.uniform(0.05, 2)
    value = size * swing(t, random.uniform(0.5, 2.5), random.uniform(0, 0.1)) + random.uniform(-3, 3)
    value += random.normal(0, 10 ** random.uniform(-4, -1.5) * size, len(t))
    assert start_of_oscillation(t, value) == 0


def held_and_pushed(dt=0.02):
    """A body at rest for 2 s, pushed in three swings of other periods, then free from 5.5 s on."""
    t = np.arange(0, 60, dt)
    phase = 2 * np.pi * np.cumsum(np.where(t < 5.5, 1.15, 1.0) * (t >= 2.0)) * dt / 1.2
    size = np.where(t < 2, 0, np.where(t < 5.5, 0.3 + 0.2 * (t - 2), np.exp(-0.02 * (t - 5.5))))
    return t, size * np.sin(phase)


def test_rest_and_pushes_before_an_oscillation_are_left_out(tmp_path):
    t, angle = held_and_pushed()
    angle = angle + np.random.default_rng(1).normal(0, 2e-3, len(t))
    first = t[start_of_oscillation(t, angle)]
    assert 5.0 < first < 8.0
    path = tmp_path / "pushed.csv"
    np.savetxt(path, np.c_[t, angle], delimiter=",", header="t [s],angle [rad]", comments="")
    case = import_body(path, 1.0)
    assert case.casing.time[0] == pytest.approx(first, abs=0.03)
    assert any("is held or moved" in w for w in case.warnings)
    whole = import_body(path, 1.0, limits=Limits(keep_all=True))
    assert whole.casing.time[0] == 0.0


def test_rest_alone_before_a_release_is_left_out():
    t = np.arange(0, 60, 0.02)
    angle = np.where(t < 4, 0.0, np.exp(-0.02 * (t - 4)) * np.sin(2 * np.pi * (t - 4) / 1.2))
    first = t[start_of_oscillation(t, angle + np.random.default_rng(2).normal(0, 1e-3, len(t)))]
    assert 4.0 <= first < 6.5


@pytest.mark.parametrize("quantity", ["omega", "angle"])
@pytest.mark.parametrize(
    "shape", [lambda u: 1.0, lambda u: np.pi / 2 * np.sin(np.pi * u)], ids=["ramp", "push"]
)
@pytest.mark.parametrize("seed", range(5))
def test_no_part_of_a_drive_by_hand_is_left(quantity, shape, seed):
    """A body at rest, driven to a speed in a few seconds, then slowed down by a law of the speed."""
    random = np.random.default_rng(seed)
    t = np.arange(0, random.uniform(30, 200), 0.02)
    begin, lasting, top = random.uniform(0.2, 5), random.uniform(0.5, 6), 10 ** random.uniform(0.5, 1.8)
    drag = random.uniform(0.1, 1, 3) * top / t[-1]
    omega = np.zeros(len(t))
    for i in range(1, len(t)):
        u, v = (t[i] - begin) / lasting, omega[i - 1]
        free = -(drag[0] + drag[1] * v / top + drag[2] * (v / top) ** 2)
        rate = 0.0 if u < 0 else top / lasting * shape(u) if u < 1 else free
        omega[i] = max(0.0, v + 0.02 * rate)
    value = omega if quantity == "omega" else np.cumsum(omega) * 0.02
    value = value + random.normal(0, 1e-3 * (top if quantity == "omega" else 1), len(t))
    table = MotionTable(Path("wheel.csv"), "", quantity, t, value, None, np.arange(len(t)), ())
    run, _ = run_of(table, value, Limits())
    # the last 2 % of a push are less than 0.1 % of it
    assert -0.02 * lasting < run.time[0] - (begin + lasting) < 0.05 * t[-1]


@pytest.mark.parametrize(("stop", "enough"), [(MIN_SAMPLES - 1, True), (MIN_SAMPLES - 2, False)])
def test_as_many_samples_as_a_table_needs_remain_within_the_limits(stop, enough):
    time = np.arange(4.0 * MIN_SAMPLES)
    if enough:
        assert enough_within(time, Limits(stop=stop)).sum() == MIN_SAMPLES
    else:
        with pytest.raises(UsageError, match=f"wheel: {MIN_SAMPLES - 1} samples remain"):
            enough_within(time, Limits(stop=stop), "wheel: ")
