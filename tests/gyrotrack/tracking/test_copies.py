"""Copies of trackers for other processes: large buffers without frames are not copied, settings and frames are."""

import pickle
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.tracking._hub import DiscWindow
from gyrotrack.tracking._polar import Score
from gyrotrack.tracking._scene import Disc
from gyrotrack.tracking._texture import COLUMNS, MARGIN, ROWS, ZONES, TextureTracker


def copied(tracker, limit):
    """Return a copy, whose stored form has a limited size [bytes]."""
    text = pickle.dumps(tracker)
    assert len(text) < limit
    return pickle.loads(text)  # noqa: S301 - own data


def test_a_copy_of_a_score_has_a_buffer_of_the_same_size():
    score = Score(white=False, weights=(0.3, -0.4), shape=(300, 400))
    score.buffer[:] = 7.0
    found = copied(score, 2000)
    assert (found.white, found.weights) == (False, (0.3, -0.4))
    assert (found.buffer.shape, found.buffer.dtype) == ((300, 400), np.float32)
    assert not found.buffer.any()


def test_a_copy_of_a_disc_window_has_its_frames_if_there_are_any():
    disc = Disc((40.0, 30.5), 10.0, (30.0, -20.0))
    window = DiscWindow(disc, 40)
    found = copied(window, 2000)
    frame = SimpleNamespace(u=np.full((60, 80), 150, np.uint8), v=np.full((60, 80), 110, np.uint8))
    for one in (found, window):
        one.centre_on((40.0, 30.5), frame)
        one.take([frame], 2)
    again = copied(window, 10**6)
    for one in (found, again):
        assert (one.disc, one.half) == (disc, 11)
        np.testing.assert_array_equal(one._pixels, window._pixels)
    assert window._pixels[2, 0].min() == 150
    assert window._pixels[2, 1].max() == 110
    assert not window._pixels[[1, 3]].any()


@pytest.mark.parametrize("moved", [True, False])
def test_a_copy_of_a_texture_has_its_pictures_if_there_are_any(moved):
    texture = TextureTracker((60.0, 50.0), 40.0, (120, 100), 6)
    found = copied(texture, 5000)
    assert found._strips.shape == (6, ZONES * ROWS, COLUMNS + 2 * MARGIN)
    frame = SimpleNamespace(y=np.tile(2 * np.arange(120), (100, 1)).astype(np.uint8))
    displacement = np.array([[1.0, 2.0], [3.0, -1.0]]) if moved else None
    for one in (found, texture):
        one.take([frame, frame], 1, np.array([0.3, np.nan]), displacement)
    again = copied(texture, 10**7)
    for one in (found, again):
        np.testing.assert_array_equal(one._strips, texture._strips)
    # a body at an angle a shows at its column 0 what is at the angle a of the picture
    strip = texture._strips[1].astype(float)
    direction = 0.3 + (np.arange(strip.shape[1]) - MARGIN) * 2 * np.pi / COLUMNS
    expected = 2.0 * (60.0 + moved + np.outer(texture._radius, np.cos(direction)))
    assert np.abs(strip - expected).max() < 1.5
    assert not texture._strips[2].any()  # the body is lost
    expected = [[0, 0], [61, 52], [63, 49]] if moved else [[0, 0], [60, 50], [60, 50]]
    assert texture.centres(3).tolist() == expected
