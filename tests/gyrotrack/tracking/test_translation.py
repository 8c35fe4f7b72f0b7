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


class TestTranslation:
    def test_a_rotation_keeps_its_hub_and_turns_from_x_to_y(self):
        move = _translation._rotation((30.0, 50.0), 0.5 * np.pi)
        assert move @ [30.0, 50.0, 1.0] == pytest.approx([30.0, 50.0], abs=1e-4)
        assert move @ [40.0, 50.0, 1.0] == pytest.approx([30.0, 60.0], abs=1e-4)
        assert _translation._rotation((30.0, 50.0), 0.3) @ [30.0, 60.0, 1.0] == pytest.approx(
            [30.0 - 10.0 * np.sin(0.3), 50.0 + 10.0 * np.cos(0.3)], abs=1e-4
        )

    def test_the_residual_is_the_variance_of_the_pixels_of_pictures_moved_back(self):
        picture = np.random.default_rng(0).integers(0, 255, (20, 30)).astype(np.uint8)
        moved = np.roll(picture, (2, 5), axis=(0, 1))
        swept = np.zeros((20, 30), dtype=np.uint8)
        swept[4:12, 6:20] = 1
        still, right = np.eye(2, 3, dtype=np.float32), np.float32([[1, 0, 5], [0, 1, 2]])
        assert _translation.residual([picture, moved], [still, right], swept) == pytest.approx(0.0, abs=1e-6)
        pair = np.stack([picture, moved]).astype(float)[:, 4:12, 6:20]
        assert _translation.residual([picture, moved], [still, still], swept) == pytest.approx(
            float(np.mean(0.25 * (pair[0] - pair[1]) ** 2)), rel=1e-5
        )

    @pytest.mark.parametrize(("size", "told"), [((5, 6), True), ((5, 5), False)])
    def test_thirty_pixels_within_the_ring_are_compared(self, monkeypatch, size, told):
        asked = iter([0.1, 1.0])
        monkeypatch.setattr(_translation, "residual", lambda *_: next(asked))
        pictures = [np.full((60, 80), 10 * k, dtype=np.uint8) for k in range(3)]
        moving = np.zeros((60, 80), dtype=bool)
        moving[20 : 20 + size[0], 30 : 30 + size[1]] = True
        moving[50:, 60:] = True  # out of reach
        angle = np.array([0.0, 0.2, 0.5])
        assert _translation.translates(pictures, moving, (32.0, 22.0), 20.0, angle) == told

    def test_a_single_picture_does_not_translate(self, monkeypatch):
        monkeypatch.setattr(_translation, "residual", lambda *_: pytest.fail("compared"))
        moving = np.ones((60, 80), dtype=bool)
        picture = [np.zeros((60, 80), dtype=np.uint8)]
        assert not _translation.translates(picture, moving, (32.0, 22.0), 20.0, np.zeros(1))
        assert not _translation.translates([], moving, (32.0, 22.0), 20.0, np.zeros(0))

    def test_two_pictures_are_compared(self, monkeypatch):
        asked = iter([0.1, 1.0])
        monkeypatch.setattr(_translation, "residual", lambda *_: next(asked))
        moving = np.ones((60, 80), dtype=bool)
        pictures = [np.full((60, 80), 10 * k, dtype=np.uint8) for k in range(2)]
        assert _translation.translates(pictures, moving, (32.0, 22.0), 20.0, np.array([0.0, 0.2]))

    def test_the_rough_translation_is_that_of_the_middle_of_the_body(self, monkeypatch):
        """The reference is the picture in the middle of the range of angles."""
        asked = []

        def align(picture, reference, swept, start):
            asked.append((int(picture[0, 0]), int(reference[0, 0]), start))
            return np.eye(2, 3, dtype=np.float32)

        told = []
        monkeypatch.setattr(_translation, "_translation", align)
        monkeypatch.setattr(_translation, "residual", lambda p, m, s: told.append(m) or 0.0)
        angle = np.linspace(0.0, 0.9, 40) ** 2
        pictures = [np.full((60, 80), k, dtype=np.uint8) for k in range(40)]
        for k, picture in enumerate(pictures):
            picture[30:34, 50:58] = 200 + k % 2
        moving = np.zeros((60, 80), dtype=bool)
        moving[26:38, 48:60] = True
        hub = (20.0, 31.5)
        assert not _translation.translates(pictures, moving, hub, 50.0, angle)
        use = np.unique(np.linspace(0, 39, 24).astype(int))
        assert [k for k, *_ in asked] == use.tolist()
        middle = use[np.argmin(np.abs(angle[use] - 0.405))]
        assert {r for _, r, _ in asked} == {middle}
        y, x = np.nonzero(moving)
        weight = np.abs(pictures[middle] - np.mean([pictures[k] for k in use], axis=0))[y, x]
        px, py = np.average(x, weights=weight) - hub[0], np.average(y, weights=weight) - hub[1]
        for k, _, start in asked:
            turn = angle[k] - angle[middle]
            cos, sin = np.cos(turn), np.sin(turn)
            assert start == pytest.approx([cos * px - sin * py - px, sin * px + cos * py - py], abs=1e-3)
        turned = told[1]
        assert turned[0] == pytest.approx(_translation._rotation(hub, angle[0] - angle[middle]))

    @pytest.mark.parametrize("shift", [(2.0, -1.0), (-3.5, 2.5)])
    def test_a_translation_is_aligned_from_a_rough_one(self, shift):
        y, x = np.mgrid[0:60, 0:80]

        def bob(at):
            return np.clip(
                40 + 180 * np.exp(-((x - at[0]) ** 2 + 2 * (y - at[1]) ** 2) / 60.0), 0, 255
            ).astype(np.uint8)

        reference, picture = bob((40.0, 30.0)), bob((40.0 + shift[0], 30.0 + shift[1]))
        swept = np.zeros((60, 80), dtype=np.uint8)
        swept[15:45, 20:60] = 1
        found = _translation._translation(picture, reference, swept, np.array(shift) + 0.8)
        assert found[:, :2] == pytest.approx(np.eye(2))
        assert found[:, 2] == pytest.approx(shift, abs=0.05)
        plain = _translation._translation(
            np.full((60, 80), 9, dtype=np.uint8), reference, swept, np.array(shift)
        )
        assert plain[:, 2] == pytest.approx(shift)
