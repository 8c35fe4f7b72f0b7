from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.tracking._association import LONGEST_COAST, Motion, find_lock, follow
from gyrotrack.tracking._film_tracker import BodyTracker

COLUMNS = 256


def _score(angle, seen=None, rival=None, seed=0):
    rng = np.random.default_rng(seed)
    column = np.arange(COLUMNS) * 2 * np.pi / COLUMNS
    score = rng.normal(0, 0.05, (len(angle), COLUMNS))
    for k, a in enumerate(angle):
        if seen is None or seen[k]:
            score[k] += np.exp(-(np.angle(np.exp(1j * (column - a))) ** 2) / 0.02)
        if rival is not None:
            score[k] += 1.3 * np.exp(-(np.angle(np.exp(1j * (column - rival))) ** 2) / 0.02)
    return score


@pytest.mark.parametrize("step", [0.0, 0.01, -0.3, 0.9, -2.0, 2.9])
def test_a_lock_finds_angle_and_step(step):
    angle = 0.7 + step * np.arange(48)
    start, motion = find_lock(_score(angle), 0.4)
    assert np.angle(np.exp(1j * (motion.angle - angle[start]))) == pytest.approx(0, abs=0.03)
    assert motion.step == pytest.approx(step, abs=2e-3)


@pytest.mark.parametrize("hidden", [0, 12, 31])
@pytest.mark.parametrize("late", [0.0, 3.0])
def test_a_lock_begins_where_a_body_is_seen(hidden, late):
    """Of a body that appears late, the angle is that of the first frame of the lock."""
    angle = 0.7 + 0.9 * np.arange(72)
    seen = np.arange(72) >= hidden
    start, motion = find_lock(_score(angle, seen), 0.4, place=np.arange(72.0) + late)
    assert np.angle(np.exp(1j * (motion.angle - angle[start]))) == pytest.approx(0, abs=0.05)
    assert motion.step == pytest.approx(0.9, abs=2e-3)
    assert start % 6 == 0
    assert max(hidden - 42, 0) <= start <= hidden


def test_a_hint_chooses_among_whole_turns():
    angle = 0.7 + 3.1 * np.arange(48)
    assert find_lock(_score(angle), 0.4, hint=3.0)[1].step == pytest.approx(3.1, abs=5e-3)


def test_noise_gives_no_lock():
    rng = np.random.default_rng(2)
    assert find_lock(_score(rng.uniform(0, 6.28, 60)), 0.4) is None
    assert find_lock(_score(np.zeros(60), seen=np.zeros(60, dtype=bool)), 0.4) is None


def test_following_keeps_to_the_motion_past_a_brighter_rival():
    k = np.arange(300)
    truth = 0.2 + 0.35 * k + 2e-4 * k**2
    angle, seen, _ = follow(_score(truth, rival=2.0), Motion(truth[0], 0.35), 0.4)
    near = np.abs(np.angle(np.exp(1j * (truth - 2.0)))) < 0.5  # where the two cannot be told apart
    assert np.abs(angle - truth)[~near].max() < 0.1
    assert seen[~near].all()


def test_turns_are_counted_through_a_gap():
    k = np.arange(300)
    truth = 0.2 + 0.9 * k - 1e-4 * k**2
    shown = np.ones(300, dtype=bool)
    shown[120:150] = False
    angle, seen, motion = follow(_score(truth, shown), Motion(truth[0], 0.9), 0.4)
    assert np.abs(angle - truth).max() < 0.25
    assert not seen[121:149].any()
    assert motion.step == pytest.approx(0.9 - 2e-4 * 299, abs=5e-3)


def test_after_a_long_loss_it_gives_up():
    shown = np.arange(200) < 100
    angle, _, motion = follow(_score(0.1 * np.arange(200), shown), Motion(0.0, 0.1), 0.4)
    assert np.isnan(angle[100 + LONGEST_COAST + 1 :]).all()
    assert motion.missed > LONGEST_COAST


def test_a_search_of_whole_rings_begins_with_the_predicted_angle_and_speed():
    tracker = BodyTracker.__new__(BodyTracker)
    tracker._prediction = SimpleNamespace(at=lambda frame: (5.0 + 0.3 * frame - 0.01 * frame**2, 0.02))
    tracker._missed = 4
    motion = tracker._motion_at(10.0)
    assert (motion.angle, motion.step, motion.missed) == pytest.approx((7.0, 0.3 - 0.21, 4))
    assert tracker._motion_at(11.0) is None  # only once: the frames before were searched as a whole
    tracker._missed, tracker._prediction = 0, SimpleNamespace(at=lambda frame: None)
    assert tracker._motion_at(10.0) is None
