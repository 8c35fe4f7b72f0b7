"""Passages of light gates: a pendulum and a rotation are told apart, period and decay are those of the motion."""

import numpy as np
import pytest

from gyrotrack import UsageError
from gyrotrack.apps._motion import motion_of_passages
from gyrotrack.io.readers._motion_table import ReadOptions
from gyrotrack.io.readers._registry import read_motion, read_passages

PERIOD, DECAY = 1.37, 0.004


def states(path, t, inside):
    """Write the times at which gates change their state."""
    changed = np.flatnonzero((np.diff(np.stack(inside), axis=1) != 0).any(axis=0)) + 1
    header = ",".join(["Time (s)", *(f"State at {name}" for name in "AB"[: len(inside)])])
    rows = [",".join([f"{t[i]:.6f}", *(str(int(gate[i])) for gate in inside)]) for i in changed]
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


@pytest.fixture(scope="module")
def pendulum():
    t = np.arange(0, 200, 1e-4)
    return t, 0.5 * np.exp(-DECAY * t) * np.sin(2 * np.pi * t / PERIOD + 0.3)


@pytest.mark.parametrize("gates", [(0.0,), (-0.02, 0.03), (0.05, 0.09)])
def test_period_and_decay_of_a_pendulum(tmp_path, pendulum, gates):
    t, angle = pendulum
    path = states(tmp_path / "gate.csv", t, [np.abs(angle - place) < 0.01 for place in gates])
    found = motion_of_passages(read_passages(path, ReadOptions()))
    assert found.kind == "oscillation"
    assert found.period.value == pytest.approx(PERIOD, rel=2e-4)
    assert found.decay.value == pytest.approx(DECAY, rel=0.05)
    assert found.quality_factor.value == pytest.approx(np.pi / (DECAY * PERIOD), rel=0.05)
    with pytest.raises(UsageError, match="pendulum"):
        read_motion(path, ReadOptions(pulses_per_turn=2))


def test_a_wheel_that_slows_down_is_not_a_pendulum(tmp_path):
    t = np.arange(0, 100, 1e-4)
    angle = 500 * (1 - np.exp(-t / 60))
    gates = [np.abs(np.angle(np.exp(1j * (angle - place)))) < 0.05 for place in (0.0, 0.5)]
    for inside in (gates[:1], gates):
        path = states(tmp_path / "wheel.csv", t, inside)
        assert read_passages(path, ReadOptions()) is None
        table = read_motion(path, ReadOptions(pulses_per_turn=1))
        turned = table.value[-1] - table.value[0]
        assert turned == pytest.approx(
            np.interp(table.time[-1], t, angle) - np.interp(table.time[0], t, angle), abs=0.1
        )
