"""Which frames show the picture of the one before them, by a few of their rows; a rhythm in them, by the packets."""

import numpy as np
import pytest

from gyrotrack.video._container import Frame, Packets
from gyrotrack.video._decoder import RepeatDetector

N = 260
NONE = np.zeros((1, 1), dtype=np.uint8)
NOTHING = Packets(np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros(0, dtype=bool), True)


def _packets(repeated, *, key=None, seed=0):
    size = np.random.default_rng(seed).integers(900, 1500, N)
    key = np.arange(N) == 0 if key is None else key
    for k in repeated:
        size[k] = size[k - 1] if key.all() else 30
    return Packets(512 * np.arange(N), size, key, True)


def _frames(show, noise=3.0, speed=0.2, copied=0.3, seed=1):
    """Frames of a bright bar that moves; a repeated one differs by what an encoder adds."""
    rng = np.random.default_rng(seed)
    column = np.arange(160)
    for k, number in enumerate(show):
        if k == 0 or number != show[k - 1]:
            bar = 120.0 * np.exp(-((column - (30.0 * speed * number) % 160.0) ** 2) / 50.0)
            picture = 80.0 + bar + rng.normal(0.0, noise, (120, 160))
        shown = picture + copied * rng.normal(0.0, 1.0, picture.shape)
        yield Frame(k, 512 * k, np.clip(np.rint(shown), 0, 255).astype(np.uint8), NONE, NONE)


def _found(show, repeats=None, **kind):
    repeats = repeats or RepeatDetector(NOTHING)
    return [frame.index for frame in _frames(show, **kind) if repeats.same(frame)], repeats


def _repeating(repeated):
    show = np.arange(N)
    for k in repeated:
        show[k] = show[k - 1]
    return show


def test_repeated_frames_are_found():
    repeated = [20, 77, 78, 79, 100, 200]
    found, repeats = _found(_repeating(repeated))
    assert found == repeated
    assert not repeats.regular


def test_frames_that_come_twice_are_found_though_the_first_ones_are():
    found, repeats = _found(np.repeat(np.arange(N // 2), 2))
    assert found == list(range(5, N, 2))
    assert repeats.regular


def test_a_scene_at_rest_with_noise_repeats_nothing():
    assert _found(np.arange(N), speed=0.0)[0] == []


def test_a_flash_makes_no_repetition():
    repeats = RepeatDetector(NOTHING)
    for frame in _frames(np.arange(N)):
        frame.y[:] = np.minimum(frame.y, 200) + 50 * (frame.index == 90)
        assert not repeats.same(frame)


def test_it_goes_on_without_the_memory_of_the_last_frame():
    repeats = RepeatDetector(NOTHING)
    found = []
    for frame in _frames(_repeating([50])):
        if repeats.same(frame):
            found.append(frame.index)
        if frame.index == 49:
            repeats.copy_last()
            frame.y[:] = 0
    assert found == [50]


@pytest.mark.parametrize("key", [None, np.ones(N, dtype=bool)], ids=["differences", "whole pictures"])
@pytest.mark.parametrize(
    ("repeated", "regular"),
    [
        (np.arange(5, N, 13), True),
        (np.arange(1, N, 2), True),
        (np.flatnonzero(np.arange(N) % 4), True),  # each frame four times
        ([40, 41, 42, 43, 44, 45, 46, 47, 130, 220], False),
        ([12, 31, 77, 90, 171, 180, 230], False),
    ],
)
def test_a_conversion_is_recognised_by_the_rhythm_of_its_packets(repeated, regular, key):
    assert RepeatDetector(_packets(repeated, key=key)).regular is regular


def test_a_rhythm_is_learnt_from_the_frames_if_packets_do_not_show_it():
    repeats = RepeatDetector(_packets([]))
    assert not repeats.regular
    found, repeats = _found(np.floor(np.arange(N) * 12 / 13 + 0.3).astype(int), repeats)
    assert len(found) == N // 13
    assert repeats.regular


@pytest.mark.parametrize("at", [0, 1, 100])
def test_a_cut_makes_no_frame_a_repetition(at):
    """As from a still before the film: by far the largest difference of all, and the others are small beside it."""
    repeats, found = RepeatDetector(NOTHING), []
    for frame in _frames(np.arange(N), noise=1.0):
        shown = 255 - frame.y if frame.index <= at else frame.y
        if repeats.same(Frame(frame.index, frame.pts, shown, NONE, NONE)):
            found.append(frame.index)
    assert found == []


def test_equal_brightness_beside_frames_that_flicker_is_not_a_repetition():
    """Of lamps at 100 Hz in a film of 260 frames/s, two neighbours in thirteen are of equal brightness."""
    detector = RepeatDetector(NOTHING)
    found = []
    for frame in _frames(np.arange(N), speed=0.05):
        gain = 1.0 + 0.2 * np.sin(2.0 * np.pi * 100.0 * frame.index / 260.0)
        lit = np.clip(np.rint(gain * frame.y), 0, 255).astype(np.uint8)
        if detector.same(Frame(frame.index, frame.pts, lit, NONE, NONE)):
            found.append(frame.index)
    assert found == []
