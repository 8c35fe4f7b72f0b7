"""The white part of a series of angles, evenly and unevenly sampled; doubts about a track."""

import numpy as np
import pytest

from gyrotrack import BodyTrack
from gyrotrack.tracking._extract import track_doubts
from gyrotrack.tracking._tracked import white_noise


@pytest.mark.parametrize("share", [1.0, 0.7])
def test_noise_of_a_smooth_motion_with_missing_frames(share):
    rng = np.random.default_rng(3)
    frame = np.flatnonzero(rng.random(6000) < share)
    angle = 3.0 * np.sin(frame / 40.0) + 0.2 * frame + rng.normal(0, 2e-3, frame.size)
    assert white_noise(angle, frame) == pytest.approx(2e-3, rel=0.1)


def test_missing_frames_are_not_noise():
    frame = np.flatnonzero(np.random.default_rng(4).random(3000) < 0.5)
    angle = 0.3 * frame
    assert white_noise(angle, frame) < 1e-9
    assert white_noise(angle) > 0.01


def track_of(time, angle):
    """A track of one body with the angles of some frames."""
    nothing = np.zeros(len(time))
    return BodyTrack(
        "casing", time, angle, nothing, nothing, np.ones(len(time), np.int64), nothing, nothing, 3
    )


def test_a_track_with_lost_frames_or_a_gap_that_may_hide_a_turn_is_doubted():
    time = np.arange(300) / 60
    angle = 3.0 * time
    assert track_doubts("body", track_of(time, angle), 300, "it") == []
    few = np.flatnonzero((np.arange(300) < 100) | (np.arange(300) > 180))
    (lost,) = track_doubts("body", track_of(time[few], angle[few]), 300, "it")
    assert "219 of 300 frames (73%)" in lost
    # 8 rad/s before and -8 rad/s after a gap of 0.5 s: up to 4 rad in either sense
    late = time > 0.25
    turns = 8.0 * np.where(time < 2.0, time, 4.0 - time)
    seen = late & ((time < 1.75) | (time > 2.25))
    doubts = track_doubts("body", track_of(time[seen], turns[seen]), int(late.sum()), "it")
    assert len(doubts) == 1
    assert "not determined in 1 gap(s), the first of 0.533 s" in doubts[0]
