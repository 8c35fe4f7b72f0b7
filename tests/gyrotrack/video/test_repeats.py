"""Which frames show the picture of the one before them, by their packets and a few of their rows."""

import numpy as np
import pytest

from gyrotrack.video.packets import Packets
from gyrotrack.video.planes import Frame
from gyrotrack.video.repeats import Repeats

N = 260
NONE = np.zeros((1, 1), dtype=np.uint8)


def _packets(repeated, *, key=None, complete=True, seed=0):
    size = np.random.default_rng(seed).integers(900, 1500, N)
    size[repeated] = 30
    key = np.arange(N) % 100 == 0 if key is None else key
    return Packets(512 * np.arange(N), np.where(key & (size > 30), 6 * size, size), key, complete)


def _frames(show, noise=3.0, speed=0.2, copied=0.3, seed=1):
    """Frames of a bright bar that moves; a repeated one differs by what an encoder adds."""
    rng = np.random.default_rng(seed)
    column = np.arange(160)
    for k, number in enumerate(show):
        if k == 0 or number != show[k - 1]:
            bar = 120.0 * np.exp(-((column - 80 - 60 * np.sin(speed * number)) ** 2) / 50.0)
            picture = 80.0 + bar + rng.normal(0.0, noise, (120, 160))
        shown = picture + copied * rng.normal(0.0, 1.0, picture.shape)
        yield Frame(k, 512 * k, np.clip(np.rint(shown), 0, 255).astype(np.uint8), NONE, NONE)


def _found(packets, show, **kind):
    repeats = Repeats(packets)
    return [frame.index for frame in _frames(show, **kind) if repeats.same(frame)], repeats


def _repeating(repeated):
    show = np.arange(N)
    for k in repeated:
        show[k] = show[k - 1]
    return show


@pytest.mark.parametrize("key", [None, np.ones(N, dtype=bool)], ids=["small packets", "whole pictures"])
def test_repeated_frames_are_found(key):
    repeated = [20, 77, 78, 79, 100, 200]
    found, repeats = _found(_packets(repeated, key=key), _repeating(repeated))
    assert found == repeated
    assert not repeats.regular


def test_where_packets_have_no_stamps_all_frames_are_looked_at():
    repeated = [20, 77, 200]
    found, repeats = _found(_packets([], complete=False), _repeating(repeated))
    assert found == repeated
    assert repeats.suspects is None


def test_a_small_packet_alone_is_no_repetition():
    found, repeats = _found(_packets([50, 120]), np.arange(N))
    assert found == []
    assert repeats.suspects == {512 * k for k in (0, 50, 51, 100, 120, 121, 200)}


def test_a_scene_at_rest_with_noise_repeats_nothing():
    found, _ = _found(_packets([], complete=False), np.arange(N), speed=0.0)
    assert found == []


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
def test_a_conversion_is_told_by_its_rhythm(repeated, regular):
    assert Repeats(_packets(repeated, key=np.arange(N) == 0)).regular is regular
