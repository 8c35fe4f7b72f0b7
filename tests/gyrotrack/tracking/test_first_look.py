"""Silhouettes of a few frames: a ball on a string, a long body about a tilted axis, and films that are neither."""

from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import TrackingError
from gyrotrack.tracking import _first_look, _silhouettes
from gyrotrack.tracking._first_look import FirstLook, follow_long_body, hub_of
from gyrotrack.tracking._hub_search import Motion
from gyrotrack.tracking._silhouettes import (
    CompactBody,
    LongBody,
    Spot,
    axes_meet,
    compact_body,
    long_tilted_body,
    median_picture,
)

SHAPE = (120, 160)
Y, X = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(float)


def _noisy(picture, k):
    noise = np.random.default_rng(k).normal(0, 1.0, SHAPE)
    return np.clip(picture + noise, 0, 255).round().astype(np.uint8)


def _discs(places, radius=8.0):
    """Draw a dark disc at each place before a grey background."""
    covers = [np.clip(radius - np.hypot(X - x, Y - y) + 0.5, 0, 1) for x, y in places]
    return [_noisy(150.0 - 90.0 * c, k) for k, c in enumerate(covers)]


def _rods(angles, tilt, middle=(80.0, 60.0)):
    """Draw a light rod of 80 px that turns about an axis with a tilt [rad], before its shadow."""
    found = []
    for k, a in enumerate(angles):
        u = np.array([np.cos(a), np.sin(a) * np.cos(tilt)])
        length = float(np.hypot(*u))
        e = u / length
        picture = np.full(SHAPE, 120.0)
        for shift, level in ((8.0, 100.0), (0.0, 180.0)):
            along = (X - middle[0]) * e[0] + (Y - middle[1] - shift) * e[1]
            across = -(X - middle[0]) * e[1] + (Y - middle[1] - shift) * e[0]
            cover = np.clip(40.0 * length - np.abs(along) + 0.5, 0, 1) * np.clip(3.0 - np.abs(across), 0, 1)
            picture += cover * (level - picture)
        found.append(_noisy(picture, k))
    return found


def _arc(hub, length, amplitude, count=30):
    a = amplitude * np.cos(np.linspace(0.0, 9.0, count))
    return np.array(hub) + length * np.stack([np.sin(a), np.cos(a)], axis=1)


def test_a_ball_on_a_string_is_a_compact_body_on_an_open_arc():
    place = _arc((80.0, -120.0), 180.0, 0.3)
    frames = _discs(place)
    body = compact_body(frames, median_picture(frames), 1.0)
    assert body.radius == pytest.approx(8.0, rel=0.15)
    assert body.alone > 0.8
    look = FirstLook(SHAPE, body)
    assert body.pivot == pytest.approx((80.0, -120.0), abs=15.0)
    assert look.pendulum
    assert not FirstLook(SHAPE).pendulum


def test_the_pivot_may_be_in_the_picture():
    look = FirstLook(SHAPE, _body(_arc((80.0, 20.0), 60.0, 0.7)))
    assert look.compact.pivot == pytest.approx((80.0, 20.0), abs=3.0)
    assert look.pendulum


def _body(place, radius=8.0, alone=0.9):
    return CompactBody(radius, np.asarray(place), alone)


@pytest.mark.parametrize(("alone", "seen"), [(0.45, False), (0.55, True)])
def test_most_of_what_moves_is_the_body(alone, seen):
    assert (_body(_arc((80.0, -120.0), 180.0, 0.3), alone=alone).pivot is not None) == seen


@pytest.mark.parametrize(("radius", "seen"), [(45.0, True), (60.0, False)])
def test_the_body_leaves_its_place(radius, seen):
    """The arc is 106 px wide: 2 radii at least."""
    assert (_body(_arc((80.0, -120.0), 180.0, 0.3), radius).pivot is not None) == seen


@pytest.mark.parametrize(("amplitude", "open_arc"), [(1.4, True), (1.8, False)])
def test_an_open_arc_is_shorter_than_half_a_turn(amplitude, open_arc):
    place = _arc((80.0, 60.0), 50.0, amplitude, 60)
    assert (_body(place).pivot is not None) == open_arc


def test_a_straight_path_has_its_pivot_at_infinity():
    place = np.stack([80.0 + 60.0 * np.cos(np.linspace(0, 9, 30)), np.full(30, 60.0)], axis=1)
    place += np.random.default_rng(0).normal(0, 0.3, place.shape)
    look = FirstLook(SHAPE, _body(place))
    assert np.isinf(look.compact.pivot).all()
    assert look.pendulum


def test_a_scattered_path_is_not_an_arc():
    place = np.random.default_rng(0).uniform(20, 100, (30, 2))
    assert _body(place).pivot is None


def test_a_dot_that_turns_about_a_hub_in_the_picture_is_left_to_the_texture():
    a = np.linspace(0, 20, 30)
    frames = _discs(np.array((80.0, 60.0)) + 40.0 * np.stack([np.cos(a), np.sin(a)], axis=1))
    assert not FirstLook(SHAPE, compact_body(frames, median_picture(frames), 1.0)).pendulum


def test_a_film_in_which_a_body_is_seen_in_some_frames_only_has_no_compact_body():
    place = _arc((80.0, -120.0), 180.0, 0.3)
    frames = [*_discs(place[:10]), *[_noisy(np.full(SHAPE, 150.0), 99 + k) for k in range(20)]]
    assert compact_body(frames, median_picture(frames), 1.0) is None


@pytest.mark.parametrize(("tilt", "seen"), [(0.2, False), (0.7, True), (1.0, True)])
def test_a_rod_about_a_tilted_axis_is_a_long_body(tilt, seen):
    """A rod seen along its axis is left to the tracker of textures."""
    frames = _rods(np.linspace(0.1, 20.0, 30), tilt)
    body = long_tilted_body(frames, median_picture(frames), 1.0)
    assert (body is not None) == seen
    if seen:
        assert body.side == "light"


def test_the_angle_of_a_rod_about_a_tilted_axis_is_that_in_its_plane(monkeypatch):
    angle, tilt = 0.12 * np.arange(120), 1.0
    frames = _rods(angle, tilt)
    body = long_tilted_body(frames[::4], median_picture(frames[::4]), 1.0)
    monkeypatch.setattr(_first_look, "fresh_frames", lambda _: np.arange(120))
    film = SimpleNamespace(frames=lambda: iter(frames), path=SimpleNamespace(name="rod.mp4"), warnings=())
    found = follow_long_body(film, body)
    assert found.orbit.tilt[0] == pytest.approx(tilt, abs=0.03)
    error = -found.angle - angle[found.frame]
    assert np.std(error) < 0.02
    assert np.polyfit(found.frame, -found.angle, 1)[0] == pytest.approx(0.12, rel=1e-3)


def test_the_hub_of_a_body_is_where_its_centroid_is_displaced_from():
    a = np.linspace(0, 4, 40)
    half = 30.0 * np.stack([np.cos(a), 0.5 * np.sin(a)], axis=1)
    assert hub_of(np.array((50.0, 70.0)) + 0.4 * half, half) == pytest.approx((50.0, 70.0))


@pytest.mark.parametrize(("scatter", "seen"), [(3.0, True), (14.0, False)])
def test_the_scatter_about_an_arc_is_small_beside_its_extent(scatter, seen):
    """The arc is 106 px wide, and 6 % of its extent are allowed."""
    place = _arc((80.0, -120.0), 180.0, 0.3, 60)
    place[:, 1] += scatter * np.random.default_rng(1).standard_normal(60)
    assert (_body(place).pivot is not None) == seen


@pytest.mark.parametrize(("ratio", "seen"), [(1.25, True), (1.6, False)])
def test_one_body_has_alike_radii_in_most_frames(ratio, seen):
    place = _arc((80.0, -120.0), 180.0, 0.3)
    frames = [f for k, p in enumerate(place) for f in _discs([p], 8.0 * ratio if k % 3 == 0 else 8.0)]
    assert (compact_body(frames, median_picture(frames), 1.0) is not None) == seen


@pytest.mark.parametrize(("swing", "seen"), [(1.0, False), (2.2, True)])
def test_the_orbit_of_a_long_body_has_no_gap_of_a_quarter_turn(swing, seen):
    """Both ends count: a swing of 1 rad leaves gaps of 2.1 rad, one of 2.2 rad gaps of 0.9 rad at most."""
    frames = _rods(np.linspace(-0.5, 0.5, 30) * swing + 0.5 * np.pi, 0.7)
    assert (long_tilted_body(frames, median_picture(frames), 1.0) is not None) == seen


def test_the_axis_of_a_rod_has_its_half_length():
    body = LongBody("light", np.full(SHAPE, 120.0, dtype=np.float32), 3.0)
    centroid, half, width = body.axis(_rods([0.0], 0.0)[0])
    assert np.abs(half) == pytest.approx((40.0, 0.0), abs=1.5)
    assert centroid == pytest.approx((80.0, 60.0), abs=0.5)
    assert 3.0 < width < 8.0


def test_two_discs_are_not_a_long_body():
    """Their axis is long, but most of the ellipse of the same moments is empty."""
    cover = [np.clip(6.5 - np.hypot(X - x, Y - 60.0), 0, 1) for x in (40.0, 120.0)]
    body = LongBody("light", np.full(SHAPE, 120.0, dtype=np.float32), 3.0)
    assert body.axis(_noisy(120.0 + 60.0 * (cover[0] + cover[1]), 0)) is None


def _lines(ends, directions, length=45.0):
    """Draw a dark line of 1.5 px from each end (x, y) in each direction [rad]."""
    found = []
    for k, ((x, y), a) in enumerate(zip(ends, directions, strict=True)):
        along = (X - x) * np.cos(a) + (Y - y) * np.sin(a)
        across = -(X - x) * np.sin(a) + (Y - y) * np.cos(a)
        inside = np.clip(along + 0.5, 0, 1) * np.clip(length + 0.5 - along, 0, 1)
        found.append(_noisy(230.0 - 180.0 * inside * np.clip(1.25 - np.abs(across), 0, 1), k))
    return found


@pytest.mark.parametrize("at_rest", [0, 30])
def test_the_axes_of_a_thin_line_meet_in_its_hub(at_rest):
    """Also if it is at rest for half of the film, where the mean picture shows it."""
    angle = np.concatenate([np.full(at_rest, -1.5), np.linspace(-1.5, 1.0, 30)])
    frames = _lines([(70.0, 60.0)] * len(angle), angle)
    assert axes_meet(frames, Motion.of(frames)) == pytest.approx((70.0, 60.0), abs=0.5)


@pytest.mark.parametrize(("travel", "range_"), [(40.0, 1.0), (40.0, 0.0), (0.0, 0.1)])
def test_a_line_on_a_cart_or_of_one_direction_has_no_hub(travel, range_):
    """The limits are a distance of 3 % of the length, and a spread of the directions of 0.1 rad rms."""
    s = np.linspace(-1.0, 1.0, 40)
    ends = [(70.0 + 0.5 * travel * np.sin(9.0 * x), 90.0) for x in s]
    frames = _lines(ends, -1.5 + 0.5 * range_ * s)
    assert axes_meet(frames, Motion.of(frames)) is None


@pytest.mark.parametrize(("apart", "bodies"), [(7.0, 1), (9.0, 2)])
def test_two_parts_within_one_radius_are_one_body(apart, bodies, monkeypatch):
    """Radius 8 px: the centre of one must be outside the other."""
    region = np.hypot(X - 40, Y - 60) < 8
    region |= np.hypot(X - 110, Y - 60) < 8
    places = iter([(40.0, 60.0), (40.0 + apart, 60.0)])
    monkeypatch.setattr(
        _silhouettes, "spot_of", lambda *_: Spot(next(places), 8.0, np.ones((17, 17), np.uint8))
    )
    assert len(_silhouettes.spots_in(region.astype(np.uint8), 0.7, 3)) == bodies


@pytest.mark.parametrize(("noise", "brightest", "limit"), [(6.0, 0.0, 12.0), (0.6, 200.0, 30.0)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_frame_differs_beyond_the_noise_and_a_part_of_the_largest_difference(noise, brightest, limit, sign):
    """Of averages over nine pixels, whose noise is a third: six times that, and 15 % of the largest."""
    background = np.full((60, 80), 100.0, np.float32)
    frame = background.copy()
    frame[40:50, 60:70] += sign * brightest
    for column, share in ((10, 0.95), (30, 1.05)):
        frame[10:20, column : column + 10] += sign * share * limit
    found = _silhouettes.differs(frame, background, noise)
    assert not found[:, :25].any()
    assert found[11:19, 31:39].all()
    assert not found[:, 41:55].any()
    assert found[41:49, 61:69].all() == (brightest > 0)


def test_the_depth_of_a_region_is_the_distance_from_its_edge():
    """The edge of the picture is one."""
    y, x = np.mgrid[0:9, 0:14]
    region = ((y >= 2) & (y <= 6) & (x >= 3) & (x <= 12)).astype(np.uint8)
    expected = np.maximum(np.minimum.reduce([y - 1, 7 - y, x - 2, 13 - x]), 0)
    assert _silhouettes.depth_of(region) == pytest.approx(expected, abs=1e-3)
    whole = np.minimum.reduce([y + 1, 9 - y, x + 1, 14 - x])
    assert _silhouettes.depth_of(np.ones((9, 14), np.uint8)) == pytest.approx(whole, abs=1e-3)


@pytest.mark.parametrize(("count", "step"), [(29, 1), (59, 1), (60, 2)])
def test_every_second_frame_of_a_full_sample_is_compared(count, step):
    seen = _silhouettes.Foreground(range(count), np.zeros((1, 1)), 1.0)
    assert list(seen.few) == list(range(0, count, step))


@pytest.mark.parametrize(("measured", "noise"), [(0.7, 0.7), (0.3, 0.5)])
def test_the_background_is_the_median_of_sixty_usable_frames(monkeypatch, measured, noise):
    asked = []
    monkeypatch.setattr(_silhouettes, "spatial_noise", lambda frames: asked.append(len(frames)) or measured)
    film = SimpleNamespace(some=lambda index: [np.full((40, 3), k % 256, np.uint8) for k in index])
    found = _silhouettes.Foreground.of(film, np.arange(5, 125))
    assert [int(f[0, 0]) for f in found.sample] == [int(5 + 119 * k / 59) for k in range(60)]
    assert (asked, found.noise) == ([9], noise)
    assert found.background == pytest.approx(np.full((40, 3), np.median([f[0, 0] for f in found.sample])))
    few = _silhouettes.Foreground.of(film, np.arange(7))
    assert (len(few.sample), asked) == (7, [9, 7])


@pytest.mark.parametrize(("count", "met"), [(7, False), (8, True)])
def test_eight_axes_show_where_they_meet(count, met):
    frames = _lines([(70.0, 60.0)] * count, np.linspace(-1.5, 1.0, count))
    assert (axes_meet(frames, Motion.of(frames)) is not None) == met


def test_a_few_displaced_axes_do_not_move_the_point_in_which_the_others_meet():
    ends = [(70.0, 60.0 + 4.0 * (k % 4 == 0)) for k in range(30)]
    frames = _lines(ends, np.linspace(-1.5, 1.0, 30))
    assert axes_meet(frames, Motion.of(frames)) == pytest.approx((70.0, 60.0), abs=0.3)


def test_three_parts_from_a_third_of_the_radius_of_the_largest_may_be_the_body(monkeypatch):
    asked, whole = [], _silhouettes.spots_in
    monkeypatch.setattr(_silhouettes, "spots_in", lambda *given: asked.append(given[1:]) or whole(*given))
    frames = _discs(_arc((80.0, -120.0), 180.0, 0.3, 5))
    assert compact_body(frames, np.full(SHAPE, 150.0, np.float32), 1.0) is not None
    assert asked == [(pytest.approx(0.35), 3)] * 5


@pytest.mark.parametrize(("missing", "looked"), [(1, False), (0, True)])
def test_a_film_of_enough_frames_is_looked_at(monkeypatch, missing, looked):
    asked = []
    seen = SimpleNamespace(background=np.zeros((30, 40)), few="few", noise=1.5, body="body")
    usable = np.arange(_first_look.FEWEST_FRAMES - missing)
    monkeypatch.setattr(_first_look, "fresh_frames", lambda _: usable)
    monkeypatch.setattr(_first_look.Foreground, "of", lambda film, index: asked.append((film, index)) or seen)
    monkeypatch.setattr(_first_look, "long_tilted_body", lambda *given: given)
    found = _first_look.first_look("film")
    if looked:
        ((film, index),) = asked
        assert (film, len(index)) == ("film", len(usable))
        assert (found.shape, found.compact, found.seen) == ((30, 40), "body", seen)
        assert (found.long[0], found.long[2]) == ("few", 1.5)
        assert found.long[1] is seen.background
    else:
        assert found == FirstLook((0, 0))
        assert asked == []


def _followed(monkeypatch, *, shown=1.0, orbit=True):
    """Follow a long body whose axis changes its sense from frame to frame; return what is fitted and the result."""
    count = 50
    angle = 0.1 * np.arange(count)
    half = 30.0 * np.stack([np.cos(angle), 0.6 * np.sin(angle)], axis=1)
    sense = np.where(np.arange(count) % 3 == 1, -1.0, 1.0)
    centroid = np.array([70.0, 50.0]) + 0.2 * half
    asked = []

    def axis(k):
        return (centroid[k], sense[k] * half[k], 6.0 + (k % 3)) if k < shown * count else None

    def about_pivot(path, name):
        asked.append(path)
        return found

    found = SimpleNamespace(orbit="orbit" if orbit else None, warnings=("own",), way="")
    monkeypatch.setattr(_first_look, "fresh_frames", lambda _: np.arange(count) + 5)
    monkeypatch.setattr(_first_look, "about_pivot", about_pivot)
    monkeypatch.setattr(_first_look, "replace", lambda old, **new: SimpleNamespace(**{**vars(old), **new}))
    film = SimpleNamespace(
        frames=lambda: iter(range(-5, count)), path=SimpleNamespace(name="rod.mp4"), warnings=("film",)
    )
    return follow_long_body(film, SimpleNamespace(axis=axis)), asked[0], half


def test_the_end_of_a_long_body_is_followed_although_its_axis_has_no_sense(monkeypatch):
    found, path, half = _followed(monkeypatch)
    np.testing.assert_allclose(path.place, np.array([70.0, 50.0]) + half, atol=1e-9)
    np.testing.assert_array_equal(path.frame, 5 + np.arange(50))
    np.testing.assert_allclose(path.covariance, np.tile(0.09 * np.eye(2), (50, 1, 1)))
    assert (path.radius, path.searched, path.turns) == (3.5, 50, True)
    assert found.warnings[:2] == ("film", "own")
    assert len(found.warnings) == 3


@pytest.mark.parametrize(("shown", "refused"), [(0.78, True), (0.8, False)])
def test_a_long_body_is_seen_in_four_fifths_of_the_frames(monkeypatch, shown, refused):
    if refused:
        with pytest.raises(TrackingError, match="seen in 39 of 50 frames only"):
            _followed(monkeypatch, shown=shown)
    else:
        assert len(_followed(monkeypatch, shown=shown)[1].frame) == 40


def test_the_ends_of_a_long_body_must_be_on_an_ellipse(monkeypatch):
    with pytest.raises(TrackingError, match="not on one ellipse"):
        _followed(monkeypatch, orbit=False)
