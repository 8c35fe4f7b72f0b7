"""The slow part of the difference between the angles of texture and markers, and the scatter of batches about it."""

import numpy as np
import pytest

from gyrotrack.tracking._body_angles import _scatter_of_batches, _slow_part

N = 15_360
DRIFT = 1e-3 * np.linspace(-1.0, 1.0, N) ** 2


def differences(seed=0):
    return DRIFT + 1.5e-3 * np.random.default_rng(seed).standard_normal(N)


def test_it_follows_a_drift_and_not_a_neighbour_in_step_with_the_frames():
    off = differences()
    off[7000:7300] += 6e-3
    slow, _ = _slow_part(off, parabolas=True)
    assert np.abs(slow - DRIFT).max() < 0.15e-3


def test_over_few_turns_it_is_constant():
    slow, _ = _slow_part(differences(), parabolas=False)
    assert np.ptp(slow) == 0.0
    assert slow[0] == pytest.approx(np.median(DRIFT), abs=0.1e-3)


def test_the_scatter_is_that_of_the_batches():
    rng = np.random.default_rng(1)
    batches = np.repeat(2e-4 * rng.standard_normal(200), 8)
    assert _scatter_of_batches(batches) == pytest.approx(2e-4, rel=0.25)
    assert _scatter_of_batches(batches[: 4 * 8]) == 0.0
    assert _scatter_of_batches(batches[: 5 * 8]) > 0.0
