"""Formulas and limits of the tracker of a point: matching, alignment, layers, and the choice of a body."""

import math
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from gyrotrack import TrackingError
from gyrotrack.tracking import _point_tracker as module
from gyrotrack.tracking._silhouettes import Spot

RNG = np.random.default_rng(0)
TEXTURE = cv2.GaussianBlur(RNG.normal(0.0, 1.0, (120, 160)), (0, 0), 2.0)
TEXTURE = (128.0 + 30.0 * TEXTURE / TEXTURE.std()).astype(np.float32)


def _disc(radius):
    half = math.ceil(radius)
    v, u = np.ogrid[-half : half + 1, -half : half + 1]
    return (np.hypot(u, v) <= radius).astype(np.uint8)


def test_a_reduced_picture_has_the_means_of_squares():
    film = SimpleNamespace(
        frames=lambda first=0, stop=None: iter([picture]), some=lambda _: [picture], path="film"
    )
    picture = np.arange(7 * 11).reshape(7, 11).astype(np.uint8)
    small = module._Reduced(film, 3)
    expected = np.rint(picture[:6, :9].reshape(2, 3, 3, 3).mean(axis=(1, 3)))
    np.testing.assert_array_equal(next(small.frames()), expected)
    np.testing.assert_array_equal(small.some(np.zeros(1))[0], expected)
    # the middle of the first square is at (1, 1) px
    np.testing.assert_allclose(small.seen(np.array([[0.0, 0.0], [2.0, 1.0]])), [[1.0, 1.0], [7.0, 4.0]])


def test_a_spot_is_reduced_about_its_middle():
    spot = Spot((31.0, 22.0), 12.0, _disc(12.0))
    found = module._Reduced(None, 3).spot(spot)
    assert found.place == pytest.approx((10.0, 7.0))
    assert found.radius == 4.0
    v, u = np.ogrid[-4:5, -4:5]
    np.testing.assert_array_equal(found.mask, np.hypot(u, v) <= 4.0)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.3, -0.2), (-0.4, 0.4)])
def test_the_best_match_is_found_within_a_pixel(shift):
    mask = _disc(6.0).astype(np.float32)
    y, x = np.mgrid[0:40, 0:50].astype(float)
    bell = lambda u, v: (200.0 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / 50.0)).astype(np.float32)  # noqa: E731
    template = np.ascontiguousarray(bell(25.0, 20.0)[14:27, 19:32])
    picture = bell(30.0 + shift[0], 18.0 + shift[1])
    changed = np.full(picture.shape, 100.0, np.float32)
    place, miss = module._matched(picture, changed, template, mask, 50.0)
    assert place == pytest.approx((30.0 + shift[0], 18.0 + shift[1]), abs=0.06)
    expected = np.mean((picture[12:25, 24:37] - template)[mask > 0] ** 2)
    assert miss == pytest.approx(expected, abs=0.5)
    # a place that shows the background adds the missing difference, here 50 - 20
    _, miss = module._matched(picture, np.full(picture.shape, 20.0, np.float32), template, mask, 50.0)
    assert miss == pytest.approx(expected + 30.0, abs=0.5)


def test_a_window_about_a_place_is_searched():
    mask = _disc(5.0).astype(np.float32)
    template = np.ascontiguousarray(TEXTURE[35:46, 55:66])
    changed = np.full(TEXTURE.shape, 1e4, np.float32)
    for near in ((63.0, 42.0), (57.0, 39.0)):
        place, miss = module._in_window(TEXTURE, changed, np.array(near), 4.0, template, mask, 0.0)
        assert place == pytest.approx((60.0, 40.0), abs=0.1)
        assert miss < 0.5
    for far in ((65.0, 40.0), (60.0, 45.0), (55.0, 40.0), (60.0, 35.0)):
        assert module._in_window(TEXTURE, changed, np.array(far), 4.0, template, mask, 0.0)[1] > 20.0
    assert (
        module._in_window(TEXTURE, changed, np.array([-20.0, 40.0]), 4.0, template, mask, 0.0)[1] == math.inf
    )
    corner = np.ascontiguousarray(TEXTURE[:11, :11])
    place, miss = module._in_window(TEXTURE, changed, np.array([6.0, 6.0]), 4.0, corner, mask, 0.0)
    assert place == pytest.approx((5.0, 5.0), abs=0.1)


@pytest.mark.parametrize("shrink", [1.0, 2.0])
def test_a_patch_is_found_in_the_whole_frame(shrink):
    mask = _disc(10.0).astype(np.float32)
    template = np.ascontiguousarray(TEXTURE[30:51, 90:111])
    changed = np.full(TEXTURE.shape, 1e4, np.float32)
    place, miss = module._in_whole(TEXTURE, changed, shrink, template, mask, 0.0, 300.0)
    assert place == pytest.approx((100.0, 40.0), abs=0.1)
    assert miss < 0.5
    other = np.ascontiguousarray(255.0 - template)
    assert module._in_whole(TEXTURE, changed, shrink, other, mask, 0.0, 50.0)[1] == math.inf


def test_a_patch_is_cut_about_a_place_and_turned():
    size, place, turn = 15, np.array([70.0, 50.0]), 0.5 * math.pi
    np.testing.assert_allclose(module._cut(TEXTURE, place, size), TEXTURE[43:58, 63:78], atol=0.2)
    # the x axis of the patch points down in the picture
    turned = module._cut(TEXTURE, place, size, turn)
    np.testing.assert_allclose(turned, np.rot90(TEXTURE[43:58, 63:78]), atol=0.2)
    np.testing.assert_allclose(module._turned(turned, turn), TEXTURE[43:58, 63:78], atol=0.3)
    assert module._turned(turned, 0.0) is turned


@pytest.mark.parametrize(
    ("shift", "turn"), [((0.6, -0.4), 0.0), ((0.0, 0.0), 0.08), ((-0.5, 0.3), -0.07), ((0.4, 0.5), 1.06)]
)
def test_a_template_is_aligned_by_place_and_rotation(shift, turn):
    mask = _disc(9.0).astype(np.float32)
    place = np.array([70.0, 50.0])
    template = module._cut(TEXTURE, place + shift, 19, turn) + 12.0  # another brightness does not matter
    start = 1.0 if turn > 1.0 else 0.0
    found = module._Aligned.of(TEXTURE, place, start, template, mask)
    np.testing.assert_allclose(found.place, place + shift, atol=0.05)
    assert found.turn == pytest.approx(turn, abs=0.01)
    assert found.residual < 4.0
    v, u = np.mgrid[-9:10, -9:10][:, module._interior(mask)]
    by_v, by_u = (g[module._interior(mask)] for g in np.gradient(template))
    slope = np.stack([by_u, by_v, u * by_v - v * by_u, np.ones(len(u))])
    expected = math.sqrt((found.residual + 1.0) * np.linalg.inv(slope @ slope.T)[2, 2])
    assert found.sigma == pytest.approx(expected, rel=1e-3)


def test_the_interior_of_a_round_patch_is_three_pixels_from_its_edge():
    inside = module._interior(_disc(9.0).astype(np.float32))
    assert inside[9, 9]
    assert np.flatnonzero(inside[9]).tolist() == list(range(4, 15))
    small = _disc(7.0).astype(np.float32)
    np.testing.assert_array_equal(module._interior(small), small > 0.5)


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ([], (0.0, 0.0)),
        ([(3.0, 1.0)], (3.0, 1.0)),
        ([(1.0, 1.6), (5.0, 0.0)], (5.0, 0.0)),  # a step below 2 px has no direction
        ([(3.0, 0.0), (0.0, 3.0)], (-3.0, 0.0)),
        ([(3.0, 0.0), (0.0, 4.0)], (-4.0, 0.0)),
        ([(2.0, 0.0), (4.0, 4.0)], (0.0, math.sqrt(32.0))),
    ],
)
def test_the_next_step_turns_as_the_last_one(steps, expected):
    np.testing.assert_allclose(module._next_step([np.array(s) for s in steps]), expected, atol=1e-9)


def test_derivatives_of_a_parabola_are_exact():
    y, x = np.mgrid[-6:7, -6:7].astype(float)
    picture = 1.0 + 2.0 * x - 3.0 * y + 0.5 * x * x + 0.25 * x * y - 0.75 * y * y
    found = module._derivatives(picture)[:, 2:-2, 2:-2]
    x, y = x[2:-2, 2:-2], y[2:-2, 2:-2]
    expected = [2.0 + x + 0.25 * y, -3.0 + 0.25 * x - 1.5 * y, 1.0 + 0 * x, 0.25 + 0 * x, -1.5 + 0 * x]
    np.testing.assert_allclose(found, expected, atol=1e-9)


def _grid(half):
    v, u = np.mgrid[-half : half + 1, -half : half + 1].astype(float)
    return np.stack([u, v])


@pytest.mark.parametrize(
    ("place", "corner", "shape"),
    [
        ((70.4, 49.6), (49, 29), (43, 43)),
        ((3.0, 50.0), (0, 29), (43, 25)),
        ((157.0, 118.0), (136, 97), (23, 24)),
    ],
)
def test_a_frame_is_cropped_to_one_and_a_half_times_the_patch(place, corner, shape):
    # 1.5 * 12 + 3 = 21 px
    (left, top), part = module._crop(TEXTURE, np.array(place), _grid(12))
    assert ((left, top), part.shape) == (corner, shape)
    np.testing.assert_array_equal(part, TEXTURE[top : top + shape[0], left : left + shape[1]])


def test_a_patch_outside_the_frame_is_lost():
    assert module._crop(TEXTURE, np.array([-17.5, 50.0]), _grid(12)) is None
    assert module._crop(TEXTURE, np.array([-16.0, 50.0]), _grid(12)) is not None
    assert module._crop(TEXTURE, np.array([70.0, 300.0]), _grid(12)) is None


def _layers(half=10, s=0.0, variance=4.0, turn_sigma=0.0):
    grid = _grid(half)
    q = (60.0 * np.exp(-0.5 * ((grid[0] - 1.0) / 3.0) ** 2 - 0.5 * (grid[1] / 2.0) ** 2)).astype(np.float32)
    full = np.full(q.shape, 1.0, np.float32)
    return module._Layers(
        grid, s * full, q, variance * full, np.full((120, 160), 90.0, np.float32), turn_sigma
    )


def _picture(place, turn=0.0, s=0.0):
    y, x = np.mgrid[0:120, 0:160].astype(float)
    c, w = math.cos(turn), math.sin(turn)
    dx, dy = x - place[0], y - place[1]
    u, v = c * dx + w * dy, c * dy - w * dx
    return (s * 90.0 + 60.0 * np.exp(-0.5 * ((u - 1.0) / 3.0) ** 2 - 0.5 * (v / 2.0) ** 2)).astype(np.float32)


def test_a_patch_is_sampled_in_its_own_axes():
    layers = _layers(4)
    x, y, outside = layers._pixels((120, 160), np.array([70.0, 50.0]), 0.5 * math.pi)
    np.testing.assert_allclose(x, 70.0 - layers.grid[1], atol=1e-4)
    np.testing.assert_allclose(y, 50.0 + layers.grid[0], atol=1e-4)
    assert not outside.any()
    for place, count in (
        ((3.0, 50.0), 9),
        ((156.0, 50.0), 9),
        ((70.0, 3.0), 9),
        ((70.0, 116.0), 9),
        ((4.0, 115.0), 0),
    ):
        assert np.isnan(layers.sampled(TEXTURE, np.array(place), 0.0)).sum() == count


@pytest.mark.parametrize("s", [0.0, 0.4])
@pytest.mark.parametrize(("shift", "turn"), [((0.7, -0.5), 0.0), ((-0.6, 0.3), 0.6)])
def test_a_patch_is_registered_with_its_covariance(s, shift, turn):
    layers = _layers(s=s)
    start = np.array([70.0, 50.0])
    found, covariance, misfit, kept = layers.register(_picture(start + shift, turn, s), start, turn)
    np.testing.assert_allclose(found, start + shift, atol=0.06)
    assert misfit < 0.1
    assert kept == turn
    # Cramer-Rao bound with second derivatives of a prior of 2.7 px2
    by = module._derivatives(layers.brightness.astype(float)).reshape(5, -1)
    information = by @ by.T / 4.0 + np.diag([0.0, 0.0, *[2.7**-2] * 3])
    c, w = math.cos(turn), math.sin(turn)
    rotation = np.array([[c, -w], [w, c]])
    expected = rotation @ np.linalg.inv(information)[:2, :2] @ rotation.T
    np.testing.assert_allclose(covariance, expected, rtol=0.08, atol=0.03 * expected[0, 0])


def test_a_rotation_is_followed_within_its_prior():
    start = np.array([70.0, 50.0])
    layers = replace(_layers(turn_sigma=0.05), brightness=module._cut(TEXTURE, start, 21, 0.04))
    found, _, _, turn = layers.register(TEXTURE, start, 0.0)
    assert turn == pytest.approx(0.04, abs=4e-3)
    _, _, _, tight = replace(layers, turn_sigma=1e-4).register(TEXTURE, start, 0.0)
    assert abs(tight) < 1e-3
    np.testing.assert_allclose(found, start, atol=0.03)


def test_a_displacement_by_half_of_the_patch_is_another_object():
    start = np.array([70.0, 50.0])
    assert _layers().register(_picture(start + np.array([4.0, 0.0])), start, 0.0)[2] < 1.0
    assert _layers(6).register(_picture(start + np.array([4.0, 0.0])), start, 0.0)[2] == math.inf
    assert _layers().register(_picture(start), np.array([-60.0, 50.0]), 0.0)[2] == math.inf
    flat = np.full((120, 160), 90.0, np.float32)
    blank = module._Layers(
        _grid(6), *[np.zeros((13, 13), np.float32)] * 2, np.ones((13, 13), np.float32), flat
    )
    assert blank.register(flat, start, 0.0)[2] == math.inf


def test_layers_are_a_regression_on_the_background():
    places = np.stack([np.linspace(30.0, 130.0, 40), np.linspace(40.0, 80.0, 40)], axis=1).round()
    grid = _grid(6)
    s = np.where(grid[0] < 0, 0.6, 0.0).astype(np.float32)
    q = np.where(grid[0] < 0, 20.0, 150.0).astype(np.float32)
    pictures = []
    for x, y in places.astype(int):
        picture = TEXTURE.copy()
        part = (slice(y - 6, y + 7), slice(x - 6, x + 7))
        picture[part] = s * picture[part] + q
        pictures.append(picture)
    empty = np.zeros(s.shape, np.float32)
    start = module._Layers(grid, empty, empty, empty, TEXTURE)
    kept = np.ones(40, dtype=bool)
    found = module._regressed(start, pictures, places, np.zeros(40), kept, 1.0)
    np.testing.assert_allclose(found.transparency, s, atol=0.02)
    np.testing.assert_allclose(found.brightness, q, atol=2.0)
    np.testing.assert_allclose(found.variance, 1.0)  # not below the noise
    pictures[3] += 90.0
    kept[3] = False
    np.testing.assert_array_equal(
        module._regressed(start, pictures, places, np.zeros(40), kept, 1.0).brightness.shape, q.shape
    )
    np.testing.assert_allclose(
        module._regressed(start, pictures, places, np.zeros(40), kept, 1.0).brightness, q, atol=2.0
    )


def test_the_variance_of_a_pixel_is_that_of_its_residuals():
    places = np.tile([70.0, 50.0], (60, 1))
    rng = np.random.default_rng(1)
    pictures = [
        (TEXTURE + rng.normal(0.0, 6.0)).astype(np.float32) for _ in range(60)
    ]  # the same for all pixels
    empty = np.zeros((13, 13), np.float32)
    start = module._Layers(_grid(6), empty, empty, empty, TEXTURE)
    found = module._regressed(start, pictures, places, np.zeros(60), np.ones(60, dtype=bool), 2.0)
    np.testing.assert_allclose(found.variance, 36.0, rtol=0.3)
    np.testing.assert_allclose(found.transparency, 0.0, atol=1e-6)
    # a pixel that is inside the frame in a fifth of the pictures is known
    places[:47, 0] = 3.0
    found = module._regressed(start, pictures, places, np.zeros(60), np.ones(60, dtype=bool), 2.0)
    assert (found.variance[:, 0] < 1e3).all()
    places[:49, 0] = 3.0
    found = module._regressed(start, pictures, places, np.zeros(60), np.ones(60, dtype=bool), 2.0)
    assert (found.variance[:, 0] == 1e9).all()
    assert (found.variance[:, 6] < 1e3).all()


@pytest.mark.parametrize(("clear", "seen"), [(3, False), (4, True)])
def test_the_background_is_seen_where_the_patch_is_elsewhere(clear, seen):
    count = 20
    place = np.tile([70.0, 50.0], (count, 1))
    place[:clear, 0] = 100.0
    pictures = [np.full((120, 160), 40.0, np.float32)] * clear + [np.full((120, 160), 80.0, np.float32)] * (
        count - clear
    )
    kept = np.ones(count, dtype=bool)
    found = module._uncovered(_layers(), pictures, place, kept)
    assert found[50, 70] == (40.0 if seen else 90.0)
    assert found[50, 79] == (40.0 if seen else 90.0)  # 9 px are within the reach of 10 px
    assert found[50, 81] == pytest.approx((clear * 40.0 + (count - clear) * 80.0) / count)


def _measure(misfit, monkeypatch, turn=None):
    count = len(misfit)
    given = iter(misfit)

    def register(self, picture, place, angle):
        value = next(given)
        return place + 0.5, np.eye(2) if np.isfinite(value) else np.full((2, 2), np.nan), value, angle

    monkeypatch.setattr(module._Layers, "register", register)
    film = SimpleNamespace(frames=lambda: iter(range(count + 3)), path=SimpleNamespace(name="film"))
    learnt = module._Learnt(_layers(s=0.5), np.zeros((count, 2)), turn, 1.0)
    return module._measured(film, np.arange(count) + 2, learnt, 99, None)


def test_frames_with_six_times_the_usual_misfit_do_not_show_the_patch(monkeypatch):
    path = _measure([1.0] * 20 + [5.9, 6.1, math.inf], monkeypatch)
    np.testing.assert_array_equal(path.frame, np.arange(21) + 2)
    np.testing.assert_allclose(path.place, 0.5)
    np.testing.assert_allclose(path.covariance[0], np.eye(2))
    np.testing.assert_allclose(path.covariance[20], 5.9 * np.eye(2))
    assert (path.radius, path.searched, path.turns) == (10.0, 99, False)
    assert path.picture[10, 11] == pytest.approx(60.0 + 45.0)
    assert _measure([1.0] * 20, monkeypatch, np.zeros(20)).turns


def test_a_patch_matches_in_enough_frames(monkeypatch):
    few = module.FEWEST_FRAMES
    assert len(_measure([1.0] * few, monkeypatch).frame) == few
    with pytest.raises(TrackingError, match="matches its average picture in only"):
        _measure([1.0] * (few - 1), monkeypatch)


@pytest.mark.parametrize(
    ("extent", "noise", "by_place", "accepted"),
    [(100.0, 3.6, 4.7, True), (100.0, 3.6, 4.9, False), (10.0, 0.99, 0.0, True), (10.0, 1.01, 0.0, False)],
)
def test_a_rough_path_is_near_a_circle(extent, noise, by_place, accepted, monkeypatch):
    monkeypatch.setattr(module, "fit_arc", lambda *_: SimpleNamespace(noise=noise, by_place=by_place))
    place = np.array([[0.0, 0.0], [0.6 * extent, 0.8 * extent]])
    if accepted:
        module._retraced(place, "film")
    else:
        with pytest.raises(TrackingError, match="deviates from"):
            module._retraced(place, "film")


@pytest.mark.parametrize(("count", "found", "accepted"), [(100, 59, False), (100, 61, True)])
def test_a_patch_is_followed_through_most_frames(count, found, accepted, monkeypatch):
    mask = np.arange(count) < found
    place = np.zeros((count, 2))
    monkeypatch.setattr(module, "_follow", lambda *_: (place, np.zeros(count), mask))
    monkeypatch.setattr(module, "_learnt", lambda *_: module._Learnt(None, place[mask], None, 1.0))
    path = _path = SimpleNamespace
    monkeypatch.setattr(module, "_measured", lambda *_: path())
    monkeypatch.setattr(module, "replace", lambda old, **new: SimpleNamespace(**new))
    film = SimpleNamespace(path=SimpleNamespace(name="film"))
    spot = Spot((10.0, 10.0), 5.0, _disc(5.0))
    given = film, np.arange(count), spot, None, 1.0, lambda *_: None, None
    if accepted:
        assert module._tracked(*given, where=(1.0, 1.0), unselected=False).keeps is False
    else:
        with pytest.raises(TrackingError, match="59 of 100 frames only"):
            module._tracked(*given, where=(1.0, 1.0), unselected=False)


@pytest.mark.parametrize(
    ("followed", "other", "about", "turns"),
    [
        (0.5, 0.94, None, True),  # a followed rotation explains the patch by 5 % better
        (0.5, 0.96, None, False),
        (0.1, 0.5, None, False),  # it turns by less than 1 px at the edge
        (0.0, 9.0, 0.94, True),
        (0.0, 9.0, 0.96, False),
        (0.5, 0.90, 0.94, True),  # a followed rotation contains noise
        (0.5, 0.90, 0.96, "followed"),
    ],
)
def test_a_patch_turns_if_this_explains_its_picture(followed, other, about, turns, monkeypatch):
    count = 30
    place = np.zeros((count, 2))
    turn = np.linspace(0.0, followed, count)
    monkeypatch.setattr(module, "_follow", lambda *_: (place, turn, np.ones(count, dtype=bool)))
    hub = np.full(count, 7.0)

    def learnt(film, frame, where, angle, turn_sigma, *_):
        residual = 1.0 if angle is None else about if angle is hub else other
        assert turn_sigma == (0.05 if angle is not None and angle is not hub else 0.0)
        return module._Learnt(None, place, angle, residual)

    monkeypatch.setattr(module, "_learnt", learnt)
    monkeypatch.setattr(module, "_measured", lambda film, frame, best, *_: SimpleNamespace(turn=best.turn))
    monkeypatch.setattr(module, "replace", lambda old, **new: old)
    film = SimpleNamespace(path=SimpleNamespace(name="film"))
    given = film, np.arange(count), Spot((10.0, 10.0), 5.0, _disc(5.0)), None, 1.0
    found = module._tracked(
        *given, lambda *_: None if about is None else hub, None, where=(1.0, 1.0), unselected=False
    ).turn
    if turns == "followed":
        assert found is not None
        assert found is not hub
    elif about is not None:
        assert (found is hub) == turns
    else:
        assert (found is not None) == turns


def _bodies(*spots):
    frame = np.zeros((80, 160), dtype=np.uint8)
    for x, radius in spots:
        cv2.circle(frame, (x, 40), radius, 200, -1)
    return frame


def _only(frames, body, monkeypatch):
    monkeypatch.setattr(module, "_several", lambda *_: TrackingError("several"))
    monkeypatch.setattr(module, "differs", lambda frame, *_: (frame > 100).astype(np.uint8))
    film = SimpleNamespace(some=lambda index: [frames[i] for i in index], path=SimpleNamespace(name="film"))
    seen = SimpleNamespace(body=body, background=None, noise=1.0)
    return module._only_spot(film, np.arange(len(frames)), seen)


def test_the_only_body_has_the_size_of_most_frames(monkeypatch):
    body = Spot((0.0, 0.0), 10.0, _disc(10.0))
    hand, both, alone = _bodies((60, 30)), _bodies((50, 10), (120, 10)), _bodies((50, 10))
    skipped, spot = _only([hand, alone] + [alone] * 28, body, monkeypatch)
    assert skipped == 1
    assert spot.place == pytest.approx((50.0, 40.0), abs=0.2)
    with pytest.raises(TrackingError, match="No compact body"):
        _only([hand] * 3 + [alone] * 27, body, monkeypatch)
    with pytest.raises(TrackingError, match="several"):
        _only([both] * 20, body, monkeypatch)
    with pytest.raises(TrackingError, match="No compact body"):
        _only([_bodies()] + [alone] * 29, None, monkeypatch)


@pytest.mark.parametrize(
    ("rests", "linked", "moves", "kind"),
    [
        (True, True, True, None),
        (False, True, True, "two links"),
        (False, True, False, "two bodies"),
        (False, False, True, "two bodies"),
    ],
)
def test_several_bodies_are_links_if_a_rod_joins_them(rests, linked, moves, kind, monkeypatch):
    asked = []
    monkeypatch.setattr(module, "_linked", lambda *_: linked)
    monkeypatch.setattr(module, "differs", lambda *_: None)
    monkeypatch.setattr(module, "paths_of", lambda *_: None)
    monkeypatch.setattr(module, "one_rests", lambda _: rests)
    monkeypatch.setattr(module, "move_as_links", lambda _, size: asked.append(size) or moves)
    counts = []
    film = SimpleNamespace(some=lambda index: counts.append(len(index)), path=SimpleNamespace(name="film"))
    spots = [Spot((10.0, 10.0), 5.0, _disc(5.0)), Spot((40.0, 10.0), 7.0, _disc(7.0))]
    error = module._several(film, np.arange(200), SimpleNamespace(background=None, noise=1.0), None, spots)
    assert getattr(error, "kind", None) == kind
    assert counts == [90 if linked else 45]
    assert all(size == 7.0 for size in asked)


@pytest.mark.parametrize(("noise", "radius"), [(0.5, 6.0), (9.0, 8.0), (500.0, None)])
def test_a_patch_is_as_small_as_its_detail_permits(noise, radius, monkeypatch):
    monkeypatch.setattr(module, "differs", lambda frame, *_: np.zeros(frame.shape, np.uint8))
    monkeypatch.setattr(module, "depth_of", lambda region: np.zeros(region.shape))
    monkeypatch.setattr(module, "_moving", lambda *_: None)
    frame = np.full((100, 120), 90, np.uint8)
    cv2.circle(frame, (60, 50), 6, 180, -1)
    if radius is None:
        with pytest.raises(TrackingError, match="no detail to follow"):
            module._patch_at(frame, None, noise, (60.0, 50.0))
        return
    spot = module._patch_at(frame, None, noise, (60.0, 50.0))
    smooth = cv2.GaussianBlur(frame.astype(np.float32), (0, 0), 1.0)
    by_y, by_x = np.gradient(smooth)
    y, x = np.mgrid[0:100, 0:120]
    fine = []
    for r in (6.0, 8.0, 11.0, 15.0, 20.0, 28.0):
        g = np.stack([by_x, by_y])[:, np.hypot(x - 60, y - 50) <= r]
        least = np.linalg.eigvalsh(g @ g.T)[0] - 0.04 * noise**2 * g.shape[1]
        fine += [r] if least > 0 and noise / math.sqrt(least) < 0.05 else []
    assert spot.radius == min(fine) == radius
    np.testing.assert_array_equal(spot.mask, _disc(radius))
