"""Pulses in the sampled signal of a photodiode: the angle is that of the motion, within its uncertainty."""

import numpy as np
import pytest

from gyrotrack import DatasetError, UsageError
from gyrotrack.io.readers._motion_table import ReadOptions
from gyrotrack.io.readers._registry import read_motion

OPTIONS = ReadOptions(pulses_per_turn=3)


def angle_at(t, fastest=40.0, deceleration=0.6):
    return fastest * t - 0.5 * deceleration * t**2


def table(path, t, columns):
    names = ",".join(["time (s)", *columns])
    np.savetxt(
        path, np.column_stack([t, *columns.values()]), fmt="%.7g", delimiter=",", header=names, comments=""
    )
    return path


def voltage(angle, t, noise=0.05, seed=1):
    """A smooth square wave three times per turn on a slow drift of the ambient light."""
    wave = np.tanh(4 * np.sin(3 * angle))
    drift = 2.0 * np.sin(2 * np.pi * t / 90)
    return wave + drift + noise * np.random.default_rng(seed).standard_normal(len(t))


@pytest.mark.parametrize(("rate", "noise"), [(400.0, 0.03), (1000.0, 0.1)])
def test_the_angle_is_that_of_the_motion(tmp_path, rate, noise):
    t = np.arange(0, 30, 1 / rate)
    found = read_motion(table(tmp_path / "v.csv", t, {"light [V]": voltage(angle_at(t), t, noise)}), OPTIONS)
    turned = angle_at(30.0) - angle_at(0.0)
    assert len(found.time) == pytest.approx(3 * turned / (2 * np.pi), abs=1.5)
    error = found.value - angle_at(found.time)
    error -= error.mean()
    assert np.std(error) < 0.02
    assert 0.6 < np.std(error / found.sigma) < 1.6


def test_what_is_sampled_too_slowly_is_excluded(tmp_path):
    t = np.arange(0, 60, 1 / 60)
    found = read_motion(table(tmp_path / "v.csv", t, {"brightness": voltage(angle_at(t), t)}), OPTIONS)
    # four samples per pulse at 2 pi 60 / 12 rad/s
    reached = (40.0 - 2 * np.pi * 60 / 12) / 0.6
    assert reached - 4 < found.time[0] < reached + 4
    assert any("samples per pulse" in note for note in found.notes)
    error = found.value - angle_at(found.time)
    assert np.std(error) < 0.1
    with pytest.raises(DatasetError, match="samples per pulse"):
        read_motion(table(tmp_path / "fast.csv", t, {"brightness": voltage(60 * t, t)}), OPTIONS)


def test_times_of_events_beside_another_quantity_stay_events(tmp_path):
    t = 0.1 * np.arange(300.0)
    temperature = 20 + np.random.default_rng(2).standard_normal(len(t))
    columns = {"number": np.arange(300.0), "temperature": temperature}
    found = read_motion(table(tmp_path / "events.csv", t, columns), OPTIONS)
    assert len(found.time) == 300
    assert any("each row is taken for a pulse" in note for note in found.notes)
    assert np.allclose(np.diff(found.value), 2 * np.pi / 3)


@pytest.mark.slow
def test_of_two_signals_one_is_chosen(tmp_path):
    t = np.arange(0, 20, 1 / 400)
    light = voltage(angle_at(t), t)
    noise = np.random.default_rng(3).standard_normal(len(t))
    alone = read_motion(table(tmp_path / "n.csv", t, {"light": light, "noise": noise}), OPTIONS)
    assert np.std(alone.value - angle_at(alone.time)) < 0.02
    path = table(tmp_path / "v.csv", t, {"light": light, "motor": np.sin(9 * t)})
    with pytest.raises(UsageError, match="'light', 'motor'"):
        read_motion(path, OPTIONS)
    chosen = read_motion(path, ReadOptions(pulses_per_turn=3, marker="light"))
    assert np.std(chosen.value - angle_at(chosen.time)) < 0.02
