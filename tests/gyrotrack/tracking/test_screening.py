"""Cheap evidence against a film comes before the slow steps, and decides only where these would refuse it, too."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from gyrotrack._column_store import StoredPictures
from gyrotrack.tracking import _any_body, _hub_search, _moving_hub
from gyrotrack.tracking._film import reduced
from gyrotrack.tracking._hub_search import Motion, similarity_hubs
from gyrotrack.tracking._moving_hub import Path, may_be_loose
from gyrotrack.tracking._registration import Ring, every
from gyrotrack.tracking._silhouettes import median_picture


def test_pixels_of_a_reduced_frame_are_means_of_squares():
    frame = np.arange(7 * 9, dtype=np.uint8).reshape(7, 9)
    assert reduced(frame, 3).tolist() == frame[:6].reshape(2, 3, 3, 3).mean(axis=(1, 3)).tolist()


def _still(height, width, area):
    motion = Motion.of([np.zeros((height, width), np.uint8)] * 2)
    motion.moving.ravel()[:area] = True
    return motion


@pytest.mark.parametrize(
    ("width", "area", "screened"), [(640, 4000, True), (639, 4000, False), (640, 3999, False)]
)
def test_films_of_large_pictures_with_enough_that_moves_are_screened(width, area, screened):
    """From 640 px on, frames are reduced to 320 px; 1000 px2 must move there."""
    motion = _still(24, width, area)
    frames = [np.zeros((24, width), np.uint8)] * 3
    film = SimpleNamespace(frames=lambda: iter(frames))
    small = _any_body._Reduced.of(film, np.array([0, 2]), frames, motion, margin=3)
    assert (small is not None) == screened
    if small is not None:
        assert len(small.frames) == 2
        assert small.frames[0].shape == (12, 320)
        assert small.motion.area == (2, 2, 318, 10)  # the margin covers whole pixels
        assert small.reduced((9.5, 3.5)) == (4.5, 1.5)
        ring = Ring.about((4.5, 1.5), 10.0, 40.0)
        there = small.seen(_any_body._Trial(ring, "edges", "low", True, np.zeros(2), 0.1, True)).ring
        assert (there.hub, there.inner, there.outer) == ((9.5, 3.5), 20.0, 80.0)


@pytest.mark.parametrize(("score", "kept"), [(0.16, True), (0.14, False)])
def test_a_screened_candidate_reaches_three_quarters_of_what_is_required(monkeypatch, score, kept):
    """20 % must be explained before the refinement, 15 % in reduced frames."""
    ring = Ring.about((160.0, 90.0), 10.0, 80.0)
    trial = _any_body._Trial(ring, "edges", "low", True, np.linspace(0.0, 3.0, 12), score, True)
    monkeypatch.setattr(_any_body, "propose_hubs", lambda *_: [_hub_search.Proposal(ring.hub, "edges")])
    monkeypatch.setattr(_any_body, "tilted_outline", lambda *_: None)
    monkeypatch.setattr(_any_body, "_trials", lambda *_: [trial])
    refined = SimpleNamespace(score=0.27, ring=ring)  # 85 % of 40 % are required, 25.5 % in reduced frames
    monkeypatch.setattr(_any_body, "_quickly_refined", lambda *_, **__: refined)
    motion = _still(180, 320, 100)
    assert bool(_any_body._candidates((), motion, None, share=_any_body._SCREENED).kept) == kept
    full = _any_body._candidates((), motion, None)
    assert not full.kept
    assert full.best is trial
    refined.score = 0.25
    assert not _any_body._candidates((), motion, None, share=_any_body._SCREENED).kept


def test_the_picture_of_a_trial_is_learned_from_some_frames_with_the_angles_of_these(monkeypatch):
    given = {}
    monkeypatch.setattr(_any_body, "every", lambda count: 3)
    monkeypatch.setattr(
        _any_body,
        "learn",
        lambda polars, angle, *_, **__: given.update(zip(polars, angle, strict=True)) or "it",
    )
    monkeypatch.setattr(_any_body, "explained", lambda *compared: compared)
    polars, angle = [f"frame {k}" for k in range(10)], 0.1 * np.arange(10)
    compared = _any_body._score(polars, angle, np.ones(1, bool), None, separate=True)
    assert given == {f"frame {k}": pytest.approx(0.1 * k) for k in (0, 3, 6, 9)}
    assert compared[0] is polars
    assert compared[1] is angle
    assert compared[2] == "it"


@pytest.mark.parametrize(("angles", "loose"), [(0.0051, True), (0.0049, False), (1.99, True), (2.01, False)])
def test_a_loose_body_turns_measurably_in_reduced_frames(monkeypatch, angles, loose):
    turn = np.exp(1j * np.linspace(0.0, angles, 30))
    place = 60.0 + 40.0j
    found = (turn, place * (1.0 - turn), np.zeros(30, dtype=int))
    monkeypatch.setattr(_moving_hub, "follow_features", lambda *_: found)
    motion = _still(80, 120, 0)
    motion.moving[20:60, 40:80] = True
    assert may_be_loose((), motion) == loose


@pytest.mark.parametrize(("travel", "loose"), [(1.8, True), (2.2, False)])
def test_a_loose_body_travels_less_than_twice_the_arcs_of_its_rim_in_reduced_frames(
    monkeypatch, travel, loose
):
    theta = 0.05 * np.sin(np.linspace(0.0, 12.0, 60))
    # at a right angle to each other in time, translation is not rotation about another place
    shift = 0.05 * np.cos(np.linspace(0.0, 12.0, 60))
    motion = _still(80, 120, 0)
    motion.moving[20:60, 40:80] = True
    outer = _moving_hub.ring_for((60.0, 40.0), motion, 48.0).outer
    path = 60.0 + 40.0j + travel * outer * theta.std() * (shift - shift.mean()) / shift.std()
    turn = np.exp(1j * theta)
    monkeypatch.setattr(_moving_hub, "still_point", lambda *_: (60.0, 40.0))
    found = (turn, path - turn * (60.0 + 40.0j), np.zeros(60, dtype=int))
    monkeypatch.setattr(_moving_hub, "follow_features", lambda *_: found)
    assert may_be_loose((), motion) == loose


@pytest.mark.parametrize(("share", "registered"), [(0.49, False), (0.51, True)])
def test_a_free_body_is_registered_if_rough_angles_explain_half(monkeypatch, share, registered):
    rng = np.random.default_rng(0)
    frames = [rng.integers(0, 255, (60, 90)).astype(np.uint8) for _ in range(20)]
    film = SimpleNamespace(frames=lambda: iter(frames))
    place = np.stack([30.0 + 1.5 * np.arange(20), np.full(20, 30.0)], axis=1)
    monkeypatch.setattr(_moving_hub, "explained", lambda *_: (share, None))
    found = _moving_hub._rotation(film, Path(np.arange(20), place, 12.0), 1.0)
    assert (found is not None) == registered


def _turning(count, noise):
    """Similarities about the hub (50, 40), with a noise of the displacement relative to it."""
    rng = np.random.default_rng(1)
    a = np.exp(0.02j * (1.0 + 0.2 * rng.normal(size=count)))
    middle = 70.0 + 40.0j
    shift = (1.0 - a) * (50.0 + 40.0j - middle)
    shift = shift + noise * np.median(np.abs(shift)) * np.exp(2j * np.pi * rng.uniform(size=count))
    return [(x, complex(d + (1.0 - x) * middle), middle) for x, d in zip(a, shift, strict=True)]


@pytest.mark.parametrize(("noise", "every_pair"), [(0.5, True), (8.0, False)])
def test_all_pairs_are_compared_only_if_the_first_ones_have_a_common_hub(monkeypatch, noise, every_pair):
    compared = []
    known = iter(_turning(200, noise))

    def similarity(*_):
        compared.append(next(known))
        return compared[-1]

    monkeypatch.setattr(_hub_search, "similarity", similarity)
    motion = _still(80, 120, 4000)
    similarity_hubs([np.zeros((80, 120), np.uint8)] * 100, motion)
    assert len(compared) == (120 if every_pair else 24)
    unexplained = _hub_search._CommonHub.of(compared[:24]).unexplained
    assert (unexplained < _hub_search._NO_COMMON_HUB) == every_pair


def test_all_pairs_are_compared_if_the_first_ones_are_too_few_for_a_hub(monkeypatch):
    """Features are matched in every tenth pair only: 3 of the first 24, 12 of all 120."""
    known, compared = iter(_turning(200, 0.1)), []

    def similarity(*_):
        compared.append(next(known) if len(compared) % 10 == 9 else None)
        return compared[-1]

    monkeypatch.setattr(_hub_search, "similarity", similarity)
    near, _ = similarity_hubs([np.zeros((80, 120), np.uint8)] * 100, _still(80, 120, 4000))
    assert len(compared) == 120
    assert near == pytest.approx((50.0, 40.0), abs=4.0)


def test_fewer_than_four_pairs_have_no_hub():
    assert _hub_search._CommonHub.of(_turning(3, 0.1)) is None
    assert _hub_search._CommonHub.of([*_turning(4, 0.1), None]).hub == pytest.approx(50.0 + 40.0j, abs=4.0)


def test_features_are_followed_until_they_turn_too_far():
    rng = np.random.default_rng(0)
    picture = cv2.GaussianBlur(rng.integers(0, 255, (100, 100)).astype(np.float32), (0, 0), 1.5)
    picture = cv2.normalize(picture, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    frames = [
        cv2.warpAffine(picture, cv2.getRotationMatrix2D((50.0, 50.0), 3.0 * k, 1.0), (100, 100))
        for k in range(12)
    ]
    motion = Motion.of(frames)
    turn, *_ = _hub_search.follow_features(iter(frames), motion, 0.6)
    assert np.ptp(np.unwrap(np.angle(turn))) == pytest.approx(np.radians(33.0), rel=0.05)
    rest = iter(frames)
    assert _hub_search.follow_features(rest, motion, 0.3) is None
    assert len(list(rest)) == 5  # 7 frames turn by 18 degrees


@pytest.mark.parametrize(("rate", "speed"), [(0.05, 6.0 + 2.0j), (-0.06, 5.0 + 6.0j)])
def test_new_features_continue_the_motion_of_those_that_are_lost(rate, speed):
    """A texture that turns about a place and travels through the picture, which is 100 px wide."""
    rng = np.random.default_rng(0)
    texture = cv2.GaussianBlur(rng.integers(0, 255, (400, 400)).astype(np.float32), (0, 0), 1.5)
    texture = cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    steps = np.arange(14)
    a = np.exp(1j * rate * steps)
    b = 50.0 + 50.0j + speed * steps - a * (200.0 + 200.0j)
    frames = [
        cv2.warpAffine(texture, np.array([[x.real, -x.imag, y.real], [x.imag, x.real, y.imag]]), (100, 100))
        for x, y in zip(a, b, strict=True)
    ]
    moving = np.ones((100, 100), bool)
    motion = SimpleNamespace(deviation=rng.uniform(1.0, 2.0, moving.shape).astype(np.float32), moving=moving)
    turn, moved, since = _hub_search.follow_features(iter(frames), motion, 9.0)
    assert turn == pytest.approx(a, abs=0.02)
    assert moved == pytest.approx(b - a * b[0], abs=1.0)
    chosen = np.unique(since)
    assert 1 < len(chosen) < 5
    assert all(since[k - 1] < k <= since[k + 1] for k in chosen[1:])
    assert _hub_search.follow_features(iter([frames[0], texture[:100, :100]]), motion, 9.0) is None
    assert _hub_search.follow_features(iter([np.zeros((100, 100), np.uint8)] * 2), motion, 9.0) is None


class TestMotion:
    """A still texture of 70 by 100 px, with bars of 4, 9, 2 and 6 px at its sides."""

    @staticmethod
    def frames(change=0):
        picture = np.full((70, 100), 16, np.uint8)
        picture[2:64, 4:91] = np.random.default_rng(0).integers(60, 200, (62, 87))
        frames = [picture.copy() for _ in range(6)]
        for frame in frames[::2]:
            frame[20:36, 40:60] += np.uint8(change)
        return frames

    def test_uniform_bars_are_left_out_of_the_area(self):
        assert Motion.of(self.frames()).area == (4, 2, 91, 64)
        assert Motion.of(self.frames(), 3).area == (7, 5, 88, 61)

    @pytest.mark.parametrize(("change", "moves"), [(3, False), (5, True)])
    def test_what_changes_by_four_times_the_noise_moves(self, change, moves):
        """Its standard deviation is half of the change; the noise is half a grey level at least."""
        found = Motion.of(self.frames(change))
        assert found.noise == 0.5
        assert found.deviation[28, 50] == pytest.approx(0.5 * change)
        assert found.moving[22:34, 42:58].all() == found.moving.any() == moves
        assert not found.moving[:19].any()


@pytest.mark.parametrize(("count", "step"), [(100, 1), (101, 2), (200, 2), (201, 3)])
def test_at_most_a_hundred_frames_are_compared(count, step):
    assert every(count) == step


@pytest.mark.parametrize("count", [7, 8])
def test_the_median_of_frames(count):
    frames = np.random.default_rng(count).integers(0, 256, (count, 70, 20)).astype(np.uint8)
    stored = StoredPictures.of(count, iter(frames))
    np.testing.assert_array_equal(median_picture(stored), np.median(frames, axis=0))
