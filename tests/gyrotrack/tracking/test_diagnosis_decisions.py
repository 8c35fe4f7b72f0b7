"""Limits of the reasons why a film cannot be tracked, and of the paths of bodies whose hub moves."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import TrackingError
from gyrotrack.tracking import _diagnosis as module
from gyrotrack.tracking import _moving_hub as moving
from gyrotrack.tracking._diagnosis import (
    Pair,
    RefusedFilmError,
    TwoMotions,
    camera_motion,
    cut_at,
    detail,
    two_motions,
)
from gyrotrack.tracking._moving_hub import Path
from gyrotrack.tracking._registration import Ring

RNG = np.random.default_rng(0)
PLACE = RNG.uniform(0.0, 200.0, 60) + 1j * RNG.uniform(0.0, 150.0, 60)


def _pair(*parts, lag=1):
    """Features that turn about hubs: (places, hub, angle, shift)."""
    place = np.concatenate([p[0] for p in parts])
    step = np.concatenate([(np.exp(1j * a) - 1.0) * (z - h) + s for z, h, a, s in parts])
    return Pair(lag, place, step)


def test_the_rigid_motion_of_most_features_is_found():
    pair = _pair((PLACE[:40], 80 + 60j, 0.1, 0.0), (PLACE[40:], 10 + 10j, -0.2, 9.0))
    found = pair.motion(np.ones(60, dtype=bool))
    assert found.turn == pytest.approx(0.1)
    assert found.b / (1.0 - found.a) == pytest.approx(80 + 60j)
    np.testing.assert_array_equal(found.members, np.arange(60) < 40)
    some = np.arange(60) >= 40
    assert pair.motion(some).turn == pytest.approx(-0.2)


@pytest.mark.parametrize(("count", "found"), [(11, False), (12, True)])
def test_twelve_features_have_a_motion(count, found):
    pair = _pair((PLACE, 80 + 60j, 0.1, 0.0))
    assert (pair.motion(np.arange(60) < count) is not None) == found


@pytest.mark.parametrize(("off", "member"), [(0.75, True), (0.85, False)])
def test_a_feature_is_within_four_fifths_of_a_pixel_of_its_motion(off, member):
    pair = _pair((PLACE, 80 + 60j, 0.1, 0.0))
    pair.step[7] += off
    found = pair.motion(np.ones(60, dtype=bool))
    assert bool(found.members[7]) == member
    assert found.members.sum() >= 59


@pytest.mark.parametrize(("scale", "found"), [(1.08, True), (1.13, False), (0.92, True), (0.87, False)])
def test_a_picture_that_is_scaled_is_not_rigid(scale, found):
    small = 80 + 60j + 0.02 * (PLACE - 80 - 60j)  # residuals stay small
    pair = Pair(1, small, (scale - 1.0) * (small - 80 - 60j) + 5.0)
    assert (pair.motion(np.ones(60, dtype=bool)) is not None) == found


def _pictures(monkeypatch, steps, count=40):
    """`tracked` returns displacements of each later frame; features are at fixed places."""
    places = np.stack([PLACE.real[:count], PLACE.imag[:count]], axis=1).astype(np.float32)
    monkeypatch.setattr(module, "features_of", lambda _: places)
    monkeypatch.setattr(module, "tracked", lambda first, at, second: second)
    return [np.stack([np.asarray(s, dtype=float) * np.ones(count), np.zeros(count)], axis=1) for s in steps]


@pytest.mark.parametrize(
    ("steps", "lag"),
    [
        ((1.1, 2.2, 4.4, 8.8), 1),
        ((0.9, 1.8, 3.6, 7.2), 2),
        ((0.1, 0.2, 0.4, 0.8), 8),
        ((0.0, 0.0, 0.0, 0.0), 8),
    ],
)
def test_features_are_compared_at_the_first_lag_at_which_they_move_a_pixel(steps, lag, monkeypatch):
    assert module.pair_of(None, *_pictures(monkeypatch, steps)).lag == lag


@pytest.mark.parametrize(("slow", "lag"), [(0.11, 2), (0.14, 4)])
def test_a_slow_common_motion_must_be_measurable(slow, lag, monkeypatch):
    # 15 of 40 features move by more than a pixel; the others by less than an eighth of a pixel per frame, or more
    one = np.where(np.arange(40) < 15, 3.0, slow)
    later = _pictures(monkeypatch, [one * k for k in (1, 2, 4, 8)])
    expected = 1 if slow < 0.125 else 8
    assert module.pair_of(None, *later).lag == expected
    assert lag


def test_few_features_have_no_pair(monkeypatch):
    later = _pictures(monkeypatch, (3.0,) * 4, 12)
    assert module.pair_of(None, *later) is not None
    for shown in later:
        shown[0] = np.nan
    assert module.pair_of(None, *later) is None
    assert module.pair_of(None, *_pictures(monkeypatch, (3.0,) * 4, 11)) is None


def test_pairs_are_spread_over_the_film(monkeypatch):
    asked = []
    monkeypatch.setattr(
        module, "pair_of", lambda *frames: asked.append([int(f[0]) for f in frames]) or asked[-1][0]
    )
    film = SimpleNamespace(some=lambda index: [np.array([i]) for i in index])
    usable = 10 * np.arange(100)
    found = module.pairs_of(film, usable)
    assert len(found) == 16
    assert asked[0] == [0, 10, 20, 40, 80]
    assert asked[-1] == [910, 920, 930, 950, 990]
    assert module.pairs_of(film, usable[:8]) == []
    assert module.pairs_of(film, usable[:9]) is not None


class Cut:
    """A film with given changes of its frames, and a mean picture that differs before and after a frame."""

    def __init__(self, changes, at, apart):
        self.changes, self.at, self.apart = np.asarray(changes, float), at, apart

    def some(self, index):
        return [np.full((4, 5), 100.0 + self.apart * (i >= self.at)) for i in index]


@pytest.mark.parametrize(
    ("change", "other", "apart", "at", "count", "cut"),
    [
        (20.0, 7.9, 11.0, 30, 60, True),
        (20.0, 8.1, 11.0, 30, 60, False),  # 2.5 times the largest other change
        (6.1, 0.1, 4.0, 30, 60, True),
        (5.9, 0.1, 4.0, 30, 60, False),
        (20.0, 1.0, 10.1, 30, 60, True),
        (20.0, 1.0, 9.9, 30, 60, False),  # half of the change remains
        (20.0, 1.0, 19.0, 12, 60, True),
        (20.0, 1.0, 19.0, 11, 60, False),
        (20.0, 1.0, 19.0, 48, 60, True),
        (20.0, 1.0, 19.0, 49, 60, False),
        (20.0, 1.0, 19.0, 12, 24, True),
        (20.0, 1.0, 19.0, 12, 23, False),
    ],
)
def test_a_cut_changes_the_picture_more_than_its_neighbours_and_for_good(
    change, other, apart, at, count, cut
):
    changes = np.full(count, other)
    changes[0] = 255.0
    changes[at] = change
    found = cut_at(Cut(changes, at, apart), np.arange(count))
    assert found == ((at, change, other) if cut else None)


@pytest.mark.parametrize(("distance", "cut"), [(12, False), (13, True)])
def test_other_changes_within_twelve_frames_count(distance, cut):
    changes = np.full(80, 1.0)
    changes[40], changes[40 + distance] = 20.0, 12.0
    assert (cut_at(Cut(changes, 40, 19.0), np.arange(80)) is not None) == cut


@pytest.mark.parametrize(("frame", "option", "time"), [(30, "--from", 0.300), (50, "--to", 0.490)])
def test_the_hint_selects_the_longer_shot(frame, option, time):
    changes = np.full(80, 1.0)
    changes[frame] = 20.0
    film = Cut(changes, frame, 19.0)
    film.stamps, film.path = 5.0 + np.arange(80) / 100.0, SimpleNamespace(name="film")
    Cut.__len__ = lambda self: len(self.changes)
    with pytest.raises(RefusedFilmError) as error:
        module.refuse_cut(film, np.arange(80))
    assert f"{option} {time:.3f}" in error.value.hint
    assert error.value.evidence == {"frame": frame, "change": 20.0, "other": 1.0}
    assert len(error.value.frames) == 2


SHAPE = (150, 200)


def _pan(step=3.0, turn=0.0, share=1.0, lag=1, jitter=0.0, still=0.0):
    place = PLACE
    count = round(share * 60)
    shift = np.full(60, step + 0j)
    shift[count:] += 7.0 * (1.0 + np.arange(60 - count))
    rotation = (np.exp(1j * turn) - 1.0) * (place - 100 - 75j)
    return Pair(lag, place, shift + rotation + jitter)


def test_a_camera_that_pans_moves_the_whole_picture():
    step, share, off = camera_motion([_pan(6.0, lag=2)] * 8, SHAPE)
    assert (step, share) == (pytest.approx(3.0), 1.0)
    assert off == pytest.approx(1.0)
    assert camera_motion([_pan(0.0, 0.05)] * 8, SHAPE) is None  # turns about the middle
    corner = [_pair((PLACE, 10 + 20j, turn, 0.0)) for turn in (0.05, -0.04, 0.08)]
    assert camera_motion(corner * 3, SHAPE) is None


@pytest.mark.parametrize(("share", "moves"), [(0.69, False), (0.72, True)])
def test_the_camera_moves_seven_tenths_of_the_features(share, moves):
    assert (camera_motion([_pan(share=share)] * 8, SHAPE) is not None) == moves


@pytest.mark.parametrize(("step", "moves"), [(0.95, False), (1.05, True)])
def test_the_camera_moves_by_a_pixel(step, moves):
    assert (camera_motion([_pan(step)] * 8, SHAPE) is not None) == moves


@pytest.mark.parametrize(("resting", "moves"), [(2, True), (3, False)])
def test_three_quarters_of_the_pairs_show_the_camera(resting, moves):
    pairs = [_pan()] * 6 + [Pair(1, PLACE, np.full(60, 0.29 + 0j))] * resting
    assert (camera_motion(pairs, SHAPE) is not None) == moves
    # pairs with parallax count neither as motion nor as rest
    pairs = [_pan()] * 6 + [Pair(1, PLACE, np.full(60, 0.31 + 0j))] * resting
    assert camera_motion(pairs, SHAPE) is not None


@pytest.mark.parametrize(("parallax", "moves"), [(3, True), (4, False)])
def test_half_of_all_pairs_and_three_show_the_camera(parallax, moves):
    pairs = [_pan()] * 3 + [Pair(1, PLACE, np.full(60, 0.5 + 0j))] * parallax
    assert (camera_motion(pairs, SHAPE) is not None) == moves
    assert camera_motion([_pan()] * 2, SHAPE) is None


@pytest.mark.parametrize(("ratio", "moves"), [(0.28, False), (0.33, True)])
def test_a_picture_that_turns_about_a_hub_is_not_a_moving_camera(ratio, moves):
    """Displacements of +-s remain beside a rotation of the reach of a quarter of both sides."""
    middle = PLACE.mean()
    turn = 0.05
    rim = abs(np.exp(1j * turn) - 1.0) * 0.25 * sum(SHAPE)
    size = ratio / math.sqrt(1.0 - ratio**2) * rim
    pairs = []
    for k in range(8):
        step = (np.exp(1j * turn) - 1.0) * (PLACE - middle) + size * (-1) ** k
        pairs.append(Pair(1, PLACE, step))
    found = camera_motion(pairs, SHAPE)
    assert (found is not None) == moves
    if moves:
        assert found[2] == pytest.approx(ratio, rel=0.02)


@pytest.mark.parametrize(("share", "covers"), [(0.38, False), (0.42, True)])
def test_features_cover_two_fifths_of_the_picture(share, covers):
    x, y = 200.0 * math.sqrt(share), 150.0 * math.sqrt(share)
    assert module._covers(np.array([0.0, x, 1j * y, x + 1j * y]), SHAPE) == covers
    assert not module._covers(np.array([0.0, 200.0]), SHAPE)


def _two(**change):
    given = {
        "hubs": (0j, 100j),
        "spread": (1.0, 1.0),
        "places": (40 + 0j, 60 + 100j),
        "shares": (0.6, 0.4),
        "ratio": 2.0,
    }
    return TwoMotions(**{**given, **change})


@pytest.mark.parametrize(("spread", "count"), [((1.0, 14.9), 0), ((1.0, 15.1), 1), ((15.1, 16.0), 2)])
def test_a_hub_moves_by_a_quarter_of_the_reach(spread, count):
    assert _two(spread=spread).moving == count
    assert _two(spread=spread, joined=True).linked == (count == 1)
    assert not _two(spread=spread).linked
    assert _two(spread=spread, places=(60 + 0j, 40 + 100j)).moving == count


def test_the_reach_of_features_is_at_least_a_pixel():
    assert _two(places=(0.1 + 0j, 100.1j), spread=(0.2, 0.3)).moving == 1


@pytest.mark.parametrize(("apart", "coaxial"), [(8.9, True), (9.1, False)])
def test_two_hubs_within_15_percent_of_the_reach_are_coaxial(apart, coaxial):
    assert _two(hubs=(0j, apart + 0j), places=(40 + 0j, 60.0 + apart + 0j)).coaxial == coaxial
    assert _two(hubs=(0j, apart + 0j), places=(60 + 0j, 40.0 + apart + 0j)).coaxial == coaxial


A, B = PLACE[:40] * 0.4, 120 + 80j + PLACE[40:] * 0.3


def _bodies(one=0.2, two=-0.1, count=40):
    return [_pair((A[:count], 40 + 30j, one, 0.0), (B, 150 + 100j, two, 0.0))] * 4


def test_two_bodies_turn_about_two_hubs():
    found = two_motions(_bodies())
    assert found.hubs == (pytest.approx(40 + 30j), pytest.approx(150 + 100j))
    assert found.ratio == pytest.approx(-0.5)
    assert found.spread == pytest.approx((0.0, 0.0), abs=1e-6)
    moves = np.abs(_bodies()[0].step) > 1.0
    assert found.shares == pytest.approx(
        (moves[:40].mean() * 40 / moves.sum(), moves[40:].sum() / moves.sum())
    )
    assert found.places[0] == pytest.approx(A[moves[:40]].mean(), abs=1.5)
    assert two_motions(_bodies()[:2]) is None  # three pairs are needed


@pytest.mark.parametrize(("two", "differ"), [(0.2 * 0.72, False), (0.2 * 0.68, True), (-0.2, True)])
def test_the_turns_of_two_bodies_differ_by_three_tenths(two, differ):
    assert (two_motions(_bodies(0.2, two)) is not None) == differ


@pytest.mark.parametrize(("good", "found"), [(6, True), (5, False)])
def test_most_pairs_show_two_bodies(good, found):
    pairs = _bodies() * 2
    pairs = pairs[:good] + [_pair((A, 40 + 30j, 0.2, 0.0))] * (8 - good)
    assert (two_motions(pairs) is not None) == found


@pytest.mark.parametrize(
    ("along", "across", "noise", "change", "share"),
    [(0.0, 8.0, 0.0, None, 0.0), (6.0, 6.0, 0.0, None, 1.0)],
)
def test_the_detail_of_a_ring_is_its_gradient_along_and_across(along, across, noise, change, share):
    ring = Ring.about((60.0, 60.0), 20.0, 50.0)
    radius, angle = ring.radius[:, None], ring.angle[None, :]
    # sinusoidal pictures; along the circles with a constant number of waves
    waves = 18
    picture = 100.0 + across * np.sin(2.0 * np.pi * radius / 10.0) + along * np.sin(waves * angle)
    polars = [picture, picture + 4.0]
    stub = SimpleNamespace(
        unwrap=lambda k: polars[k], inner=20.0, outer=50.0, rows=ring.rows, radius=ring.radius, step=ring.step
    )
    found, ratio = detail(stub, [0, 1], 0.5)
    assert found == pytest.approx(2.0 / 0.5)
    step, mean = (50.0 - 20.0) / ring.rows, float(np.mean(ring.radius))
    of_across = across * 2.0 * np.sin(np.pi * step / 10.0) / step / math.sqrt(2.0)
    each = along * 2.0 * np.sin(waves * ring.step / 2.0) / (ring.radius * ring.step) / math.sqrt(2.0)
    of_along = math.sqrt(max(np.mean(each**2) - 0.25 / (mean * ring.step) ** 2, 0.0))
    expected = of_along / math.sqrt(of_across**2 - 0.25 / step**2)
    assert ratio == pytest.approx(expected, rel=0.12, abs=1e-9)
    assert (share == 0.0) == (ratio == 0.0)


@pytest.mark.parametrize(
    ("change", "share", "refused"), [(3.1, 0.13, False), (2.9, 0.13, True), (3.1, 0.11, True)]
)
def test_a_blurred_body_has_little_detail_along_its_circles(change, share, refused, monkeypatch):
    monkeypatch.setattr(module, "detail", lambda *_: (change, share))
    film, ring = SimpleNamespace(path=SimpleNamespace(name="film")), SimpleNamespace(hub=(1.0, 2.0))
    if refused:
        with pytest.raises(RefusedFilmError, match="too blurred") as error:
            module.refuse_blurred(film, list(range(9)), ring, 1.0)
        assert error.value.evidence == {"change_sigma": change, "detail": share}
        assert error.value.frames == (0, 2, 5, 8)
    else:
        module.refuse_blurred(film, list(range(9)), ring, 1.0)


def _outline(x, y=50.0, area=100.0):
    return moving._Outline(np.array([x, y], float), area)


def test_a_body_is_expected_with_the_velocity_of_its_last_steps():
    link = moving._Link([3, 5], [_outline(10.0), _outline(14.0)])
    assert link.expected(6).tolist() == [14.0, 50.0]
    link = moving._Link([1, 3, 5, 6], [_outline(0.0), _outline(10.0), _outline(14.0), _outline(19.0, 56.0)])
    assert link.expected(8).tolist() == [19.0 + 2 * 3.0, 56.0 + 2 * 2.0]
    areas = [*[9.0] * 6, *[100.0 + k for k in range(10)]]
    assert moving._Link(list(range(16)), [_outline(0.0, area=a) for a in areas]).area() == 104.5


@pytest.mark.parametrize(
    ("x", "area", "joined"),
    [
        (9.8, 100.0, True),
        (9.99, 100.0, False),
        (3.0, 129.0, True),
        (3.0, 131.0, False),
        (3.0, 71.0, True),
        (3.0, 69.0, False),
    ],
)
def test_an_outline_continues_the_path_of_a_near_body_of_its_size(x, area, joined):
    # 0.7 diameters of the circle of 100 px2 and 2 px are 9.9 px
    links = [moving._Link([0], [_outline(0.0)])]
    moving._link(links, 1, [_outline(x, area=area)])
    assert [len(link.frame) for link in links] == ([2] if joined else [1, 1])


def test_outlines_are_assigned_in_the_order_of_distance():
    links = [moving._Link([0], [_outline(0.0)]), moving._Link([0], [_outline(8.0)])]
    moving._link(links, 1, [_outline(6.0), _outline(3.0), _outline(80.0)])
    assert [link.outline[-1].place[0] for link in links] == [3.0, 6.0, 80.0]
    assert [link.frame for link in links] == [[0, 1], [0, 1], [1]]
    # near its expected or its last place
    fast = moving._Link([0, 1, 2], [_outline(0.0), _outline(20.0), _outline(40.0)])
    links = [fast]
    moving._link(links, 3, [_outline(60.0)])
    assert len(links) == 1


def test_outlines_touch_no_border_and_have_24_square_pixels():
    region = np.zeros((60, 80), dtype=bool)
    region[10:16, 10:16] = True  # 25 px2 within the contour
    region[30:35, 30:36] = True  # 20 px2
    region[0:8, 40:48] = region[20:28, 0:8] = region[52:60, 60:68] = region[20:28, 72:80] = True
    region[40:46, 72:78] = True
    found = moving._outlines(region)
    assert sorted((o.place.tolist(), o.area) for o in found) == [([12.5, 12.5], 25.0), ([74.5, 42.5], 25.0)]


def _film(frames):
    return SimpleNamespace(
        frames=lambda: iter(frames),
        some=lambda index: [frames[i] for i in index],
        path=SimpleNamespace(name="film"),
        warnings=(),
    )


def _puck(places, side=9):
    frames = []
    for x in places:
        frame = np.full((40, 120), 60, np.uint8)
        frame[15 : 15 + side, x : x + side] = 200
        frames.append(frame)
    return frames


def test_the_changed_area_is_that_of_frames_four_apart():
    frames = _puck([10 + 20 * (k >= 6) for k in range(12)])
    found = moving._changed(_film(frames), np.arange(12), 69.9)
    # after blurring, half of the contrast is exceeded in the squares without their corners
    assert found[:6].tolist() == [0.0] * 6
    assert found[6:10].tolist() == [2 * 77.0] * 4
    assert found[10:].tolist() == [0.0] * 2


@pytest.mark.parametrize(("step", "count", "paths"), [(2, 20, 1), (2, 11, 0), (0, 20, 0)])
def test_a_body_that_moves_across_the_picture_has_a_path(step, count, paths):
    rest = [np.full((40, 120), 60, np.uint8)] * 14
    frames = rest + _puck([20 + step * k for k in range(count)]) + rest
    found = moving.find_paths(_film(frames), np.arange(len(frames)), 1.0)
    assert len(found) == paths
    if paths:
        (path,) = found
        np.testing.assert_array_equal(path.frame, 14 + np.arange(20))
        np.testing.assert_allclose(path.place[:, 0], 24.0 + 2.0 * np.arange(20), atol=0.1)
        assert path.radius == pytest.approx(math.sqrt(64.0 / math.pi), rel=0.02)
        assert 0.8 < path.share <= 1.0


def _free(monkeypatch, *, explained=0.8, angle=None, sigma=1e-3, halves=None, near=None, share=0.5):
    angle = np.linspace(0.0, 2.0, 30) if angle is None else angle
    count = len(angle)
    place = np.stack([np.linspace(0.0, 80.0, count), np.full(count, 20.0)], axis=1)
    tracked = SimpleNamespace(
        explained=explained, angle=angle, sigma=np.full(count, sigma), frame=np.arange(count), warnings=(),
        halves=np.zeros((2, count)) if halves is None else halves,
    )  # fmt: skip
    path = Path(np.arange(count), place, 9.0, share)
    monkeypatch.setattr(moving, "fresh_frames", lambda _: np.arange(count))
    monkeypatch.setattr(moving, "spatial_noise", lambda _: 1.0)
    monkeypatch.setattr(moving, "find_paths", lambda *_: [path])
    monkeypatch.setattr(moving, "_rotation", lambda *_: (path, None, angle, None))
    monkeypatch.setattr(moving, "_along_path", lambda *_: tracked)
    monkeypatch.setattr(moving, "replace", lambda old, **new: SimpleNamespace(**{**vars(old), **new}))
    film = _film([None] * count)

    class Sized(SimpleNamespace):
        def __len__(self):
            return count

    return moving.track_free_body(Sized(**vars(film)), near)


@pytest.mark.parametrize(
    ("change", "accepted"),
    [
        ({"explained": 0.71}, True),
        ({"explained": 0.69}, False),
        ({"sigma": 0.11}, True),  # five times 0.11 rad is less than the standard deviation of 0.6 rad
        ({"sigma": 0.13}, False),
        ({"angle": np.linspace(0.0, 1.5 * 29, 30)}, True),
        ({"angle": np.linspace(0.0, 1.6 * 29, 30)}, False),  # a quarter of a turn per frame
        ({"angle": np.linspace(0.0, 2.0, 30) + 0.60 * (np.arange(30) > 12)}, True),
        (
            {"angle": np.linspace(0.0, 2.0, 30) + 0.66 * (np.arange(30) > 12)},
            False,
        ),  # a tenth of a turn in one frame
        ({"share": 0.26}, True),
        ({"share": 0.24}, False),
        ({"share": 0.1, "near": (40.0, 37.0)}, True),
        ({"share": 0.1, "near": (40.0, 39.0)}, False),  # beyond two radii
    ],
)
def test_a_free_body_turns_as_one_rigid_body(change, accepted, monkeypatch):
    if accepted:
        found = _free(monkeypatch, **change)
        assert found.ambiguous
        assert found.way == "outline"
    else:
        with pytest.raises(TrackingError, match="No body that turns while it moves"):
            _free(monkeypatch, **change)


def test_the_halves_of_a_free_body_differ_by_a_correlated_error(monkeypatch):
    monkeypatch.setattr(moving, "white_noise", lambda *_: 3e-3)
    apart = 5e-3 * np.where(np.arange(30) % 2, 1.0, -1.0)
    found = _free(monkeypatch, halves=np.stack([apart, np.zeros(30)]))
    assert found.correlated == pytest.approx(0.5 * 4e-3)
    np.testing.assert_allclose(found.sigma, np.hypot(1e-3, 2e-3))


@pytest.mark.parametrize(
    ("range_", "wander", "hub", "loose"),
    [
        (0.011, 0.0, 100.0, True),
        (0.009, 0.0, 100.0, False),
        (1.95, 0.0, 100.0, True),
        (2.05, 0.0, 100.0, False),
        (0.5, 0.95, 100.0, True),
        (0.5, 1.05, 100.0, False),  # the hub moves more than the rim
        (0.5, 0.0, 201.0, False),
    ],
)
def test_a_loose_body_turns_and_its_hub_moves_less_than_its_rim(range_, wander, hub, loose, monkeypatch):
    theta = 0.5 * range_ * np.sin(np.linspace(0.0, 4.0 * np.pi, 81))
    turn = np.exp(1j * theta)
    off = np.tile([2.0, -1.0, -1.0], 27) / np.sqrt(2.0)
    ring = Ring.about((hub, 60.0), 5.0, 50.0)
    shift = wander * theta.std() * 50.0 * off
    moved = (hub + 60j) * (1.0 - turn) + shift
    monkeypatch.setattr(moving, "follow_features", lambda *_: (turn, moved, np.zeros(81, int)))
    monkeypatch.setattr(moving, "still_point", lambda *_: (hub, 60.0))
    monkeypatch.setattr(moving, "ring_for", lambda *_: ring)
    found = moving._loose_motion(None, SimpleNamespace(moving=np.zeros((120, 200), bool)))
    assert (found is not None) == loose
    if loose:
        np.testing.assert_allclose(found[0], theta, atol=1e-9)
        np.testing.assert_allclose(found[1], hub + 60j + shift, atol=1e-9)
    monkeypatch.setattr(moving, "ring_for", lambda *_: None)
    assert moving._loose_motion(None, SimpleNamespace(moving=np.zeros((120, 200), bool))) is None


def _rotating(monkeypatch, change, slide=0.0, share=0.6, noise=1.0):
    """A body whose picture changes by `change` grey levels (rms) in four frames, in frames 20 to 40 of 64."""
    ramp = np.clip(np.arange(64) - 20.0, 0.0, 20.0)
    pattern = np.where(np.arange(64) % 2, 1.0, -1.0)
    value = iter(ramp * change / 4.0)
    monkeypatch.setattr(
        Ring,
        "unwrap",
        lambda self, frame, shift: np.tile(100.0 + next(value) * pattern, (4, 1)).astype(np.float32),
    )
    monkeypatch.setattr(moving, "follow", lambda polars, *_, band: np.full(len(polars), len(band) + 0.0))
    monkeypatch.setattr(moving, "learn", lambda *_, **__: None)
    # the shares of the bands low, middle and high
    monkeypatch.setattr(
        moving, "explained", lambda polars, angle, _: ({3: 0.1, 6: share, 4: 0.2}[int(angle[0])], None)
    )
    place = np.stack([50.0 + ramp * slide / 4.0, np.full(64, 40.0)], axis=1)
    return moving._rotation(_film([None] * 70), Path(np.arange(64) + 3, place, 10.0), noise)


@pytest.mark.parametrize(
    ("change", "slide", "share", "noise", "found"),
    [
        (3.1, 0.0, 0.6, 1.0, True),
        (2.9, 0.0, 0.6, 1.0, False),  # three times the noise
        (2.9, 1.1, 0.6, 1.0, True),
        (2.9, 0.9, 0.6, 1.0, False),
        (9.0, 0.0, 0.51, 1.0, True),
        (9.0, 0.0, 0.49, 1.0, False),
    ],
)
def test_a_body_rotates_in_the_frames_in_which_its_picture_changes(
    change, slide, share, noise, found, monkeypatch
):
    result = _rotating(monkeypatch, change, slide, share, noise)
    assert (result is not None) == found
    if found:
        path, ring, angle, shift = result
        # from four frames before a change is measured to four frames after
        first, last = path.frame[0] - 3, path.frame[-1] - 3
        assert 15 <= first <= 20
        assert 40 <= last <= 45
        assert len(angle) == len(shift) == len(path.place) == len(path.frame) == last - first + 1
        np.testing.assert_allclose(angle, 6.0)  # the best band is the middle one
        assert (ring.inner, ring.outer) == (1.0, 9.0)
        np.testing.assert_allclose(shift, path.place - [ring.hub[0], ring.hub[1]])


def _featured(monkeypatch, *, path=None, share=0.5, registered=0.5, selected=30):
    """Track a body by its features; all slow steps are replaced by given results."""
    theta = 0.2 * np.sin(np.arange(30) / 3.0)
    path = np.full(30, 100.0 + 50.0j) + np.where(np.arange(30) % 2, 5.0, 0.0) if path is None else path
    ring = Ring.about((100.0, 50.0), 5.0, 30.0)
    monkeypatch.setattr(moving, "_loose_motion", lambda *_: (theta, path, np.repeat([0, 9], 15), ring))
    monkeypatch.setattr(Ring, "unwrap", lambda *_: None)
    monkeypatch.setattr(moving, "learn", lambda *_, **__: None)
    monkeypatch.setattr(moving, "explained", lambda *_: (share, np.ones(ring.rows)))
    off = np.where(np.arange(30) < 15, 0.5, -0.3) + 0.01 * np.where(np.arange(30) % 2, 1.0, -1.0)
    tracked = SimpleNamespace(
        explained=registered, frame=np.arange(30), angle=off - theta, sigma=np.full(30, 0.0), warnings=()
    )

    def along_path(film, usable, ring, angle, shift, *_):
        np.testing.assert_allclose(
            shift, np.stack([(path - path.mean()).real, (path - path.mean()).imag], axis=1)
        )
        return tracked

    monkeypatch.setattr(moving, "_along_path", along_path)
    monkeypatch.setattr(moving, "replace", lambda old, **new: SimpleNamespace(**{**vars(old), **new}))
    film = SimpleNamespace(
        frames=lambda: iter([None] * 30),
        some=lambda index: [None] * len(index),
        selected=np.ones(selected, bool),
        warnings=(),
    )
    return moving.track_by_features(film, np.arange(30), SimpleNamespace(area=(0, 0, 200, 100)))


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({}, True),
        ({"share": 0.41}, True),
        ({"share": 0.39}, False),
        ({"registered": 0.41}, True),
        ({"registered": 0.39}, False),
        (
            {"path": np.full(30, 100.0 + 50.0j) + 0.3 * np.exp(1j * np.arange(30))},
            False,
        ),  # the hub hardly moves
        ({"path": np.full(30, 100.0 + 50.0j) + 2.2 * np.exp(1j * 2 * np.pi * np.arange(30) / 30)}, True),
    ],
)
def test_a_body_without_an_axle_is_explained_by_the_rotation_about_its_path(change, found, monkeypatch):
    result = _featured(monkeypatch, **change)
    assert (result is not None) == found
    if found:
        # features that are selected together share an error; only their other differences count
        assert result.correlated == pytest.approx(0.01, rel=0.01)
        assert result.way == "features"
        assert len(result.warnings) == 1
    assert len(_featured(monkeypatch, selected=33).warnings) == 2


def _film_of(count):
    return SimpleNamespace(
        some=lambda index: [int(i) for i in index],
        path=SimpleNamespace(name="film"),
        __len__=lambda self: count,
    )


@pytest.mark.parametrize(
    ("off", "least", "refused"), [(0.5, 0.49, True), (0.5, 0.5, True), (0.5, 0.51, False), (None, 0.1, False)]
)
def test_a_camera_that_moves_is_refused_from_a_residual_on(off, least, refused, monkeypatch):
    monkeypatch.setattr(module, "camera_motion", lambda *_: off and (3.0, 0.8, off))
    usable = 10 * np.arange(31)
    if not refused:
        module.refuse_moving_camera(_film_of(400), usable, [], SHAPE, least)
        return
    with pytest.raises(RefusedFilmError, match=r"80 % of the features move together by 3\.0 px") as error:
        module.refuse_moving_camera(_film_of(400), usable, [], SHAPE, least)
    assert error.value.evidence == {"step_px": 3.0, "share": 0.8, "no_hub": 0.5}
    assert error.value.frames == (0, 100, 200, 300)
    assert error.value.kind == "moving camera"


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        ({}, "two bodies"),
        ({"hubs": (0j, 5 + 0j), "places": (40 + 0j, 65 + 0j)}, None),  # coaxial
        ({"spread": (1.0, 20.0)}, None),  # a hub moves
        ({"spread": (1.0, 20.0), "joined": True}, "two links"),
        ({"spread": (20.0, 20.0), "joined": True}, None),
        ({"joined": True}, "two bodies"),
    ],
)
def test_two_bodies_are_refused_unless_they_share_a_hub_or_one_hub_moves(change, kind, monkeypatch):
    monkeypatch.setattr(module, "two_motions", lambda _: _two(**change))
    if kind is None:
        module.refuse_two_motions("film", [], [1, 2])
        return
    with pytest.raises(RefusedFilmError) as error:
        module.refuse_two_motions("film", [], [1, 2])
    assert (error.value.kind, error.value.hub, error.value.frames) == (kind, (0.0, 0.0), (1, 2))
    assert error.value.evidence == {"share": 0.6, "other_share": 0.4, "ratio": 2.0}
    assert ("--hub 0,0 or --hub 0,100" in error.value.hint) == (kind == "two bodies")
    monkeypatch.setattr(module, "two_motions", lambda _: None)
    module.refuse_two_motions("film", [], [])


def test_a_hint_is_added_to_the_message():
    error = RefusedFilmError("What.", "First.", kind="cut", evidence={})
    error.add_hint("Second.")
    assert error.hint == "First. Second."
    assert str(error) == "What. First. Second."
    assert (error.frames, error.hub) == ((), None)


def test_a_film_has_enough_different_frames_of_one_shot(monkeypatch):
    refused = []
    monkeypatch.setattr(module, "refuse_cut", lambda *given: refused.append(given[1]))
    for count in (module.FEWEST_FRAMES - 1, module.FEWEST_FRAMES):
        usable = np.arange(count)
        monkeypatch.setattr(module, "fresh_frames", lambda _, usable=usable: usable)
        if count < module.FEWEST_FRAMES:
            with pytest.raises(TrackingError, match=f"only {count} different frames"):
                module.frames_of_one_shot(_film_of(count))
        else:
            assert module.frames_of_one_shot(_film_of(count)) is usable
    assert len(refused) == 1


FAR = 20.0 * np.exp(1j * np.arange(80.0)) * (1.0 + np.arange(80) / 80.0)


def _shares(first, second, strays=0):
    """Features of two bodies, 20 to 40 px from their hubs, and others that move on their own."""
    one, two = 60 + 60j + FAR[:first], 200 + 60j + FAR[:second]
    own = [(np.array([300.0 + 9 * k + 0j]), 0j, 0.0, (5.0 + 9.0 * k) * 1j) for k in range(strays)]
    return [_pair((one, 60 + 60j, 0.2, 0.0), (two, 200 + 60j, -0.15, 0.0), *own)] * 4


@pytest.mark.parametrize(
    ("pairs", "found"),
    [
        (_shares(48, 15), False),  # 24 % of the features
        (_shares(48, 17), True),
        (_shares(40, 15, 17), False),  # less than half of the others
        (_shares(40, 17, 15), True),
    ],
)
def test_a_second_body_has_a_quarter_of_the_features_and_half_of_the_others(pairs, found):
    result = two_motions(pairs)
    assert (result is not None) == found
    if found:
        assert result.hubs == (pytest.approx(60 + 60j, abs=0.1), pytest.approx(200 + 60j, abs=0.1))
        moves = len(pairs[0].place)
        assert result.shares == pytest.approx(
            (len([z for z in pairs[0].place if z.real < 110]) / moves, 17 / moves)
        )


@pytest.mark.parametrize(("turn", "found"), [(0.0018, False), (0.0022, True), (-0.0022, True)])
def test_each_of_two_bodies_turns_by_two_milliradians(turn, found):
    far = 60.0 * FAR[:30]  # 1200 px and more
    pairs = [_pair((far, 0j, 0.1, 0.0), (5000 + far, 5000 + 0j, turn, 0.0))] * 3
    assert (two_motions(pairs) is not None) == found


def test_a_joint_is_searched_from_the_hub_that_moves_less(monkeypatch):
    asked = []
    monkeypatch.setattr(module, "share_a_joint", lambda *given: asked.append(given) or True)
    pairs = []
    for k in range(4):
        moved = 200 + 60j + 9.0 * k
        pairs.append(_pair((60 + 60j + FAR[:40], 60 + 60j, 0.2, 0.0), (moved + FAR[:30], moved, -0.15, 0.0)))
    for _ in range(2):
        assert two_motions(pairs).joined
        hub, first, second = asked.pop()
        assert hub == pytest.approx(60 + 60j, abs=0.1)
        np.testing.assert_allclose(np.angle(first[:, 0]), 0.2, atol=1e-3)
        np.testing.assert_allclose(np.angle(second[:, 0]), -0.15, atol=1e-3)
        np.testing.assert_allclose(
            second[:, 1] / (1 - second[:, 0]), 200 + 60j + 9.0 * np.arange(4), atol=0.1
        )
        # the moving body may have most of the features
        pairs = [
            _pair(
                (200 + 60j + 9.0 * k + FAR[:40], 200 + 60j + 9.0 * k, -0.15, 0.0),
                (60 + 60j + FAR[:30], 60 + 60j, 0.2, 0.0),
            )
            for k in range(4)
        ]
