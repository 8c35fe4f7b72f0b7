"""What moves beside the body that is tracked, and how a refusal words two moving parts."""

import cv2
import numpy as np
import pytest

from gyrotrack.tracking import _any_body, _point_tracker
from gyrotrack.tracking._any_body import elsewhere
from gyrotrack.tracking._hub_search import Motion, Proposal, similarity_hubs
from gyrotrack.tracking._registration import Ring
from gyrotrack.tracking._silhouettes import Spot


def test_pixels_that_change_outside_of_the_ring_are_counted():
    moving = np.zeros((100, 200), dtype=bool)
    moving[40:60, 40:60] = True  # 400 px about the hub
    moving[40:50, 150:160] = True
    assert elsewhere(moving, Ring.about((50.0, 50.0), 3.0, 20.0, finest=48.0)) == pytest.approx(0.25)


@pytest.mark.parametrize(("width", "linked"), [(3, True), (14, False)])
def test_two_parts_are_linked_by_a_thin_rod_only(width, linked):
    """Two maxima of the width of one large region are no double pendulum."""
    region = np.zeros((60, 120), dtype=np.uint8)
    cv2.circle(region, (30, 30), 12, 1, -1)
    cv2.circle(region, (90, 30), 12, 1, -1)
    cv2.line(region, (30, 30), (90, 30), 1, width)
    spots = [Spot((x, 30.0), 12.0, np.ones((1, 1), np.uint8)) for x in (30.0, 90.0)]
    assert _point_tracker._linked(region, *spots) == linked


def test_two_parts_that_touch_nowhere_are_not_linked():
    region = np.zeros((60, 120), dtype=np.uint8)
    for x in (30, 90):
        cv2.circle(region, (x, 30), 12, 1, -1)
    spots = [Spot((x, 30.0), 12.0, np.ones((1, 1), np.uint8)) for x in (30.0, 90.0)]
    assert not _point_tracker._linked(region, *spots)


def test_a_hub_is_proposed_from_fewer_frames_than_the_longest_distance_of_two():
    rng = np.random.default_rng(0)
    picture = cv2.GaussianBlur(rng.integers(0, 255, (80, 80)).astype(np.float32), (0, 0), 1.5)
    picture = cv2.normalize(picture, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    frames = [
        cv2.warpAffine(picture, cv2.getRotationMatrix2D((42.0, 38.0), 3.0 * k, 1.0), (80, 80))
        for k in range(12)
    ]
    near, _ = similarity_hubs(frames, Motion.of(frames, 0))
    assert near == pytest.approx((42.0, 38.0), abs=1.0)


@pytest.mark.parametrize(
    ("own", "outer", "second"), [(20.0, 40.0, True), (20.0, 70.0, False), (70.0, 20.0, False)]
)
def test_the_hub_of_a_second_body_is_outside_the_best_ring_and_the_best_hub_outside_its_ring(
    monkeypatch, own, outer, second
):
    """The hubs are 60 px apart."""
    frames = [np.zeros((120, 240), np.uint8)] * 2
    motion = Motion.of(frames)
    motion.moving[40:60, 30:50] = motion.moving[40:60, 180:200] = True
    best, other = (
        _any_body._Trial(
            Ring.about((x, 50.0), 3.0, r), "edges", "low", True, np.linspace(0.0, 3.0, 12), 0.6, True
        )
        for x, r in ((40.0, own), (100.0, outer))
    )
    monkeypatch.setattr(_any_body, "propose_hubs", lambda *_: [Proposal(other.ring.hub, "edges")])
    monkeypatch.setattr(_any_body, "_trials", lambda *_: [other])
    monkeypatch.setattr(_any_body, "_refined_trial", lambda trial, *_, **__: trial)
    assert _any_body._second_body(frames, motion, best) is (other if second else None)
