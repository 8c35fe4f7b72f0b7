"""The slow part of the difference between the angles of texture and markers, and the scatter of batches about it."""

from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.tracking._body_angles import _averages_better, _scatter_of_batches, _slow_part

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


def angles(sigma, error=0.0, seed=0):
    noise = sigma * np.random.default_rng(seed).standard_normal(N)
    return SimpleNamespace(angle=noise + error, sigma=np.full(N, sigma))


# a neighbour that passes once in 130 frames, in step with the frames: 0.5 s at 260 fps
BESIDE = 1e-3 * np.sin(2 * np.pi * np.arange(N) / 130)


@pytest.mark.parametrize(
    ("ring", "error", "better"),
    [
        (0.97e-3, 0.0, True),  # less noise, and no error beside a neighbour
        (1.15e-3, 0.0, False),
        (1.7e-3, BESIDE, True),  # an average of 26 frames errs by 0.3 mrad for 0.7 mrad
        (1.7e-3, 0.2 * BESIDE, False),  # 0.3 mrad for 0.24 mrad
        (2.1e-3, BESIDE, False),  # more than twice the noise
    ],
)
def test_the_angle_whose_averages_err_less_is_used(ring, error, better):
    assert _averages_better(angles(ring, seed=1), angles(1e-3, error), 260.0) == better


def test_a_ring_without_angles_is_not_used():
    none = SimpleNamespace(angle=np.full(N, np.nan), sigma=np.full(N, 1e-6))
    assert not _averages_better(none, angles(1e-3), 260.0)
