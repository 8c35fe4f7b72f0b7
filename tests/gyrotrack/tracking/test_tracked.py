"""The white part of a series of angles, evenly and unevenly sampled."""

import numpy as np
import pytest

from gyrotrack.tracking._tracked import white_noise


@pytest.mark.parametrize("share", [1.0, 0.7])
def test_noise_of_a_smooth_motion_with_missing_frames(share):
    rng = np.random.default_rng(3)
    frame = np.flatnonzero(rng.random(6000) < share)
    angle = 3.0 * np.sin(frame / 40.0) + 0.2 * frame + rng.normal(0, 2e-3, frame.size)
    assert white_noise(angle, frame) == pytest.approx(2e-3, rel=0.1)


def test_missing_frames_are_no_noise():
    frame = np.flatnonzero(np.random.default_rng(4).random(3000) < 0.5)
    angle = 0.3 * frame
    assert white_noise(angle, frame) < 1e-9
    assert white_noise(angle) > 0.01
