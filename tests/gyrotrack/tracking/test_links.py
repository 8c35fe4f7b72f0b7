"""Two links are named only where a joint moves about a pivot, and the second body about the joint."""

import itertools

import cv2
import numpy as np
import pytest

from gyrotrack.tracking import _links
from gyrotrack.tracking import _silhouettes as module
from gyrotrack.tracking._links import carries_a_link, move_as_links, one_rests, paths_of, share_a_joint
from gyrotrack.tracking._registration import Ring
from gyrotrack.tracking._silhouettes import Foreground, Spot, differs, median_picture, spots_in

TIME = np.arange(60) / 30
FIRST = 0.7 * np.cos(4.0 * TIME)
SECOND = 0.9 * np.cos(6.5 * TIME + 1.0)
HUB = np.array([80.0, 12.0])


def _along(angle):
    return np.stack([np.sin(angle), np.cos(angle)], axis=1)


def _double_pendulum(stretch=0.0):
    joint = HUB + 50.0 * _along(FIRST)
    length = 40.0 * (1.0 + stretch * np.sqrt(2.0) * np.cos(9.0 * TIME))
    return np.stack([joint, joint + length[:, None] * _along(SECOND)], axis=1)


def test_a_double_pendulum_has_two_links_in_either_order():
    paths = _double_pendulum()
    assert move_as_links(paths, 5.0)
    assert move_as_links(paths[:, ::-1], 5.0)


def test_two_pendulums_on_one_pivot_are_not_links():
    paths = np.stack([HUB + 50.0 * _along(FIRST), HUB + 40.0 * _along(SECOND)], axis=1)
    assert not move_as_links(paths, 5.0)


def test_two_dots_of_one_body_are_not_links():
    paths = np.stack([HUB + 50.0 * _along(FIRST), HUB + 40.0 * _along(FIRST + 0.8)], axis=1)
    assert not move_as_links(paths, 5.0)


@pytest.mark.parametrize(("stretch", "linked"), [(0.04, True), (0.06, False)])
def test_the_distance_of_the_second_body_from_the_joint_is_constant_within_5_percent(stretch, linked):
    assert move_as_links(_double_pendulum(stretch), 5.0) == linked


@pytest.mark.parametrize(("count", "linked"), [(19, False), (20, True)])
def test_twenty_positions_show_links(count, linked):
    assert move_as_links(_double_pendulum()[:count], 2.0) == linked


def test_bodies_that_move_by_less_than_their_size_are_not_links():
    paths = _double_pendulum()
    extent = float(np.hypot(*np.ptp(paths, axis=0).T).min())
    assert move_as_links(paths, 0.49 * extent)
    assert not move_as_links(paths, 0.51 * extent)


def _drawn(paths, step=1):
    frames = []
    for joint, end in paths[::step]:
        frame = np.full((120, 160), 200, np.uint8)
        points = [tuple(round(16 * v) for v in p) for p in (HUB, joint, end)]
        for p, q in itertools.pairwise(points):
            cv2.line(frame, p, q, 60, 1, cv2.LINE_AA, 4)
        for p in points[1:]:
            cv2.circle(frame, p, 6 * 16, 40, -1, cv2.LINE_AA, 4)
        frames.append(frame)
    return frames


@pytest.mark.parametrize(("step", "all_of_it"), [(1, True), (6, False)])
def test_the_bodies_are_followed_until_they_move_too_far_in_one_frame(step, all_of_it):
    paths = _double_pendulum()
    frames = _drawn(paths, step)
    seen = Foreground(frames, median_picture(frames), 1.0)
    spots = spots_in(differs(frames[0], seen.background, 1.0), 0.35, 2)
    assert len(spots) == 2
    order = np.argsort([np.hypot(*(s.place - paths[0, 0])) for s in spots])
    found = paths_of(frames, seen, (spots[order[0]], spots[order[1]]))
    assert (len(found) == len(frames)) == all_of_it
    if all_of_it:
        assert np.abs(found - paths).max() < 1.5
        assert move_as_links(found, 6.0)


@pytest.mark.parametrize(("hidden", "followed"), [(2, True), (3, False)])
def test_a_body_may_be_hidden_in_two_frames_in_a_row(hidden, followed):
    frames = _drawn(_double_pendulum())
    background = median_picture(frames)
    seen = Foreground(frames, background, 1.0)
    first = spots_in(differs(frames[0], background, 1.0), 0.35, 2)
    for k in range(20, 20 + hidden):
        frames[k] = background
    found = paths_of(frames, seen, (first[0], first[1]))
    assert len(found) == (len(frames) - hidden if followed else 20)


def test_two_motions_share_a_joint_at_a_fixed_distance_from_the_hub():
    hub, turn, other = 90 + 120j, np.exp(0.06j), np.exp(-0.1j)
    rng = np.random.default_rng(0)
    # about 5 % as a standard deviation, which is 3.4 % as a median deviation
    for spread, linked in ((0.02, True), (0.065, False), (0.2, False)):
        joint = hub + 60.0 * (1.0 + spread * rng.normal(size=12)) * np.exp(0.5j * np.arange(12))
        first = np.stack([np.full(12, turn), np.full(12, (1 - turn) * hub)], axis=1)
        after = hub + turn * (joint - hub)
        second = np.stack([np.full(12, other), after - other * joint], axis=1)
        assert share_a_joint(hub, first, second) == linked


def _drawn_links(second, offset=None):
    """Frames of a rod about the hub, and of a second one at its end or about another place."""
    rng = np.random.default_rng(0)
    hub, frames = np.array([80.0, 60.0]), []
    for one, two in zip(FIRST, second, strict=True):
        joint = hub + 30.0 * _along(np.array([one]))[0]
        start = joint if offset is None else hub + offset
        end = start + 28.0 * _along(np.array([two]))[0]
        frame = rng.normal(120.0, 2.0, (130, 170)).clip(0, 255).astype(np.uint8)
        for a, b in ((hub, joint), (start, end)):
            cv2.line(frame, *(tuple(np.round(p).astype(int).tolist()) for p in (a, b)), 230, 4)
        frames.append(frame)
    return frames


@pytest.mark.parametrize(
    ("second", "offset", "linked"),
    [
        (2.0 * SECOND, None, True),
        (FIRST, None, False),
        (2.0 * SECOND, (60.0, 0.0), False),
    ],
    ids=["second link", "one rod", "apart"],
)
def test_a_link_extends_beyond_the_body_and_turns_differently(second, offset, linked):
    ring = Ring.about((80.0, 60.0), 3.0, 32.0, finest=48.0)
    assert carries_a_link(ring, _drawn_links(second, offset), -FIRST, 2.0) == linked


@pytest.mark.parametrize(("count", "extent", "rests"), [(4, 2.9, True), (3, 2.9, False), (4, 3.1, False)])
def test_parts_that_appear_and_stay_are_not_moving_bodies(count, extent, rests):
    paths = np.zeros((count, 2, 2))
    paths[:, 0, 0] = np.linspace(0.0, 20.0, count)
    paths[:, 1, 1] = np.linspace(0.0, extent, count)
    assert one_rests(paths) == rests


def _followed(monkeypatch, places, radii=(5.0, 5.0)):
    """Return the paths of two bodies; `places` are those of the parts of each frame (x of the row 10)."""
    shown = iter(places[1:])
    monkeypatch.setattr(_links, "differs", lambda *_: None)
    monkeypatch.setattr(
        _links,
        "spots_in",
        lambda *_: [Spot((float(x), 10.0), 5.0, np.ones((3, 3), np.uint8)) for x in next(shown)],
    )
    spots = tuple(
        Spot((float(x), 10.0), r, np.ones((3, 3), np.uint8)) for x, r in zip(places[0], radii, strict=True)
    )
    return _links.paths_of(places, Foreground([], None, 1.0), spots)[..., 0]


@pytest.mark.parametrize(
    ("places", "found"),
    [
        # within two radii of the extrapolation of the last step
        ([(0, 100), (9.9, 100), (29.7, 100)], [(0, 100), (9.9, 100), (29.7, 100)]),
        ([(0, 100), (10.1, 100)], [(0, 100)]),
        ([(0, 100), (9.9, 100), (9.7, 100)], [(0, 100), (9.9, 100)]),
        ([(0, 100), (100, 9.0)], [(0, 100), (9, 100)]),
        ([(0, 100), (4, 92), (8, 84)], [(0, 100), (4, 92), (8, 84)]),
        # the reach grows by two radii with each frame; after a gap, the step is that of one frame
        ([(0, 100), (4, 100), (), (31.9, 100)], [(0, 100), (4, 100), (31.9, 100)]),
        ([(0, 100), (4, 100), (50,), (32.1, 100)], [(0, 100), (4, 100)]),
        ([(0, 100), (4, 100), (), (12, 100), (25.9, 100)], [(0, 100), (4, 100), (12, 100), (25.9, 100)]),
        ([(0, 100), (4, 100), (), (12, 100), (26.1, 100)], [(0, 100), (4, 100), (12, 100)]),
        ([(0, 100), (4, 100), (), (), (16, 100)], [(0, 100), (4, 100), (16, 100)]),
        ([(0, 100), (4, 100), (), (), (), (4, 100)], [(0, 100), (4, 100)]),
    ],
)
def test_bodies_are_near_the_extrapolation_of_their_last_step(places, found, monkeypatch):
    np.testing.assert_allclose(_followed(monkeypatch, places), found)


def test_each_body_has_its_own_reach(monkeypatch):
    assert len(_followed(monkeypatch, [(0, 100), (9, 100)], (4.0, 9.0))) == 1
    assert len(_followed(monkeypatch, [(0, 100), (0, 109)], (4.0, 5.0))) == 2


def test_equal_parts_are_one_part(monkeypatch):
    """Both bodies nearest to one of two parts."""
    assert len(_followed(monkeypatch, [(0, 8), (4, 100)])) == 1


GREY = np.full((120, 160), 120.0, np.float32)


@pytest.mark.parametrize(("count", "step"), [(61, 2), (60, 2), (59, 1), (90, 3)])
def test_thirty_frames_are_compared_with_the_background(count, step):
    assert len(module.Foreground(range(count), GREY, 1.0).few) == len(range(0, count, step))


@pytest.mark.parametrize(("count", "extent", "rests"), [(4, 2.9, True), (4, 3.1, False), (3, 2.9, False)])
def test_a_body_rests_if_it_moves_by_less_than_three_pixels(count, extent, rests):
    paths = np.zeros((count, 2, 2))
    paths[:, 0, 0] = np.linspace(0.0, 40.0, count)
    paths[:, 1] = np.linspace(0.0, 1.0, count)[:, None] * extent * np.array([0.6, 0.8])
    assert _links.one_rests(paths) == rests
    assert _links.one_rests(paths[:, ::-1]) == rests


@pytest.mark.parametrize(("scatter", "shared"), [(1.6, True), (1.8, False)])
def test_a_shared_joint_has_a_constant_distance_from_the_hub(scatter, shared):
    """1.4826 times a median deviation s is below 5 % of 50 px for s < 1.69 px."""
    count = 40
    hub = 20.0 + 30.0j
    turn, other = 0.1 + 0.05 * np.arange(count) / count, -0.2 - 0.02 * np.arange(count)
    off = scatter * np.where(np.arange(count) % 2, 1.0, -1.0)
    joint = hub + (50.0 + off) * np.exp(1j * np.linspace(0.0, 2.0, count))
    first = np.stack([np.exp(1j * turn), (1.0 - np.exp(1j * turn)) * hub], axis=1)
    # the second motion displaces the joint in the same way
    moved = first[:, 0] * joint + first[:, 1]
    second = np.stack([np.exp(1j * other), moved - np.exp(1j * other) * joint], axis=1)
    assert _links.share_a_joint(hub, first, second) == shared


def _with_link(share, own, monkeypatch):
    """A link is seen in a share of the frames, and in one direction of the body in a share `own` of these."""
    count, ring = 40, Ring.about((80.0, 60.0), 5.0, 30.0)
    seen = round(share * count)
    alike = round(own * seen)
    frames = []
    beyond = Ring.about(ring.hub, 1.3 * 30.0, 1.5 * 30.0)
    angle = np.linspace(0.0, 6.0, count)
    for k in range(count):
        there = np.zeros(beyond.columns, bool)
        if k < seen:
            direction = angle[k] if k < alike else angle[k] + 0.5 + 5.0 * (k - alike) / max(seen - alike, 1)
            there[round(direction / beyond.step) % beyond.columns] = True
        frames.append(there)
    given = iter(frames)
    monkeypatch.setattr(_links, "median_picture", lambda _: None)
    monkeypatch.setattr(_links, "differs", lambda *_: None)
    monkeypatch.setattr(_links, "_joined", lambda *_: next(given))
    return _links.carries_a_link(ring, frames, angle, 1.0)


@pytest.mark.parametrize(
    ("share", "own", "link"), [(0.65, 0.3, True), (0.55, 0.3, False), (1.0, 0.45, True), (1.0, 0.9, False)]
)
def test_a_link_is_seen_in_most_frames_and_turns_differently(share, own, link, monkeypatch):
    assert _with_link(share, own, monkeypatch) == link


def test_a_part_beyond_the_body_is_joined_if_it_is_connected():
    body, beyond = Ring.about((80.0, 40.0), 16.0, 20.0), Ring.about((80.0, 40.0), 26.0, 30.0)
    region = np.zeros((80, 160), np.uint8)
    region[39:42, 80:118] = 1  # to the right, from the hub
    region[66:70, 78:83] = 1  # below, beyond the body only
    found = _links._joined(region, body, beyond)
    angle = np.angle(np.exp(1j * beyond.angle))[found]
    assert len(angle) > 0
    assert np.abs(angle).max() < 0.12


def test_labels_outside_the_picture_are_none():
    label = np.arange(1, 201, dtype=np.int32).reshape(10, 20)
    ring = Ring((18.0, 5.0), 2.0, 4.0, 1, 4)  # 3 px right, down, left and up
    assert _links._labels(label, ring)[0].tolist() == [0, label[8, 18], label[5, 15], label[2, 18]]
