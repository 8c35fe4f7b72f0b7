"""A body that moves across the picture without turning is not one that swings about a hub."""

import cv2
import numpy as np
import pytest

from gyrotrack.tracking import _translation
from gyrotrack.tracking._translation import WIDEST, translates

HUB, REACH = (100.0, 40.0), 110.0
BLOCK = np.random.default_rng(0).integers(60, 200, (9, 9)).astype(np.uint8)


def _frames(turns, *, turning):
    """A block of 36 px on an arc about the hub, which turns with its direction or keeps its orientation."""
    patch = cv2.resize(BLOCK, (36, 36), interpolation=cv2.INTER_CUBIC)
    frames = []
    for a in turns:
        x, y = HUB[0] - 80.0 * np.sin(a), HUB[1] + 80.0 * np.cos(a)
        own = a if turning else 0.0
        c, s = np.cos(own), np.sin(own)
        move = np.array([[c, -s, x - 18.0 * c + 18.0 * s], [s, c, y - 18.0 * s - 18.0 * c]])
        frames.append(cv2.warpAffine(patch, move, (200, 160), borderMode=cv2.BORDER_CONSTANT, borderValue=30))
    return frames


def _translates(turns, *, turning):
    frames = _frames(turns, turning=turning)
    moving = np.std(frames, axis=0) > 4.0
    return translates(frames, moving, HUB, REACH, turns)


SWING = 0.4 * np.sin(np.linspace(0.0, 6.0, 16))


@pytest.mark.parametrize("turning", [True, False])
def test_a_body_that_keeps_its_orientation_does_not_turn(turning):
    assert _translates(SWING, turning=turning) != turning


def test_a_round_body_without_detail_may_turn():
    """Its picture shows neither: rotation and translation explain it equally well."""
    frames = []
    for a in SWING:
        x, y = HUB[0] - 80.0 * np.sin(a), HUB[1] + 80.0 * np.cos(a)
        v, u = np.mgrid[0:160, 0:200]
        frames.append(np.clip(30 + 150 * (18.5 - np.hypot(u - x, v - y)).clip(0, 1), 0, 255).astype(np.uint8))
    assert not translates(frames, np.std(frames, axis=0) > 4.0, HUB, REACH, SWING)


@pytest.mark.parametrize(("span", "told"), [(0.95 * WIDEST, True), (1.05 * WIDEST, False)])
def test_a_large_rotation_is_not_compared(span, told):
    assert _translates(np.linspace(-0.5, 0.5, 16) * span, turning=False) == told


@pytest.mark.parametrize(("share", "told"), [(0.49, True), (0.51, False)])
def test_translation_explains_the_frames_twice_as_well(monkeypatch, share, told):
    residuals = iter([share, 1.0])  # of translation, and of rotation
    monkeypatch.setattr(_translation, "residual", lambda *_: next(residuals))
    assert _translates(SWING, turning=True) == told
