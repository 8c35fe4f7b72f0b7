import numpy as np
import pytest

from gyrotrack.tracking._profile import find_blobs


def test_blobs_have_their_centroids_and_come_strongest_first():
    score = np.zeros((60, 80), dtype=np.float32)
    y, x = np.mgrid[:60, :80]
    score[np.hypot(x - 20, y - 30) < 6] = 10.0
    score[10:14, 50:70] = 30.0
    first, second = find_blobs(score, 5.0)
    assert (first.x, first.y, first.area) == (59.5, 11.5, 80)
    assert (second.x, second.y) == pytest.approx((20, 30))
    assert second.fill > 0.8 > 0.4 > first.fill


def test_specks_are_passed_over():
    score = np.zeros((20, 20), dtype=np.float32)
    score[5, 5] = 100.0
    assert find_blobs(score, 1.0) == []
