"""Polar grids, colours of a profile, and samples of a scene: formulas and limits on small pictures."""

from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import VideoError
from gyrotrack.tracking import _polar as polar
from gyrotrack.tracking import _scene as module
from gyrotrack.tracking._film import reduced
from gyrotrack.tracking._polar import Grid, Ring, Score, Windows, boxed, ring_for, unroll
from gyrotrack.tracking._profile import chroma_direction, colour_name, find_blobs, hue_score, nearest_colour
from gyrotrack.tracking._scene import Marker, Samples, Scene
from gyrotrack.video._container import Frame, Packets

RING = Ring((30.0, 20.0), 5.0, 11.0, 4, 8)


def test_a_polar_grid_has_rows_of_radii_and_columns_of_angles():
    assert RING.radii.tolist() == [5.0, 7.0, 9.0, 11.0]
    assert RING.step == pytest.approx(np.pi / 4)
    x, y = RING.maps(chroma=False, beyond=3)
    assert x.shape == (4, 11)
    angle = np.arange(11) * np.pi / 4
    np.testing.assert_allclose(x[1], 30.0 + 7.0 * np.cos(angle), rtol=1e-6)
    np.testing.assert_allclose(y[1], 20.0 - 7.0 * np.sin(angle), rtol=1e-6)
    x, y = RING.maps(chroma=True)
    np.testing.assert_allclose(x[3], (30.0 + 11.0 * np.cos(angle[:8])) / 2.0, rtol=1e-6)
    np.testing.assert_allclose(y[3], (20.0 - 11.0 * np.sin(angle[:8]) - 0.5) / 2.0, rtol=1e-6)
    moved = RING.moved((1.0, 2.0))
    assert (moved.centre, moved.inner, moved.outer, moved.rows, moved.columns) == (
        (1.0, 2.0),
        5.0,
        11.0,
        4,
        8,
    )


@pytest.mark.parametrize(
    ("inner", "outer", "pixel", "rows", "columns"),
    [
        (20.0, 40.0, 2.0, 11, 132),
        (20.0, 41.5, 1.0, 23, 271),
        (5.0, 9.0, 2.0, 6, 128),
        (100.0, 400.0, 1.0, 32, 1024),
    ],
)
def test_a_ring_has_1_4_samples_per_pixel_at_its_middle(inner, outer, pixel, rows, columns):
    ring = ring_for((0.0, 0.0), inner, outer, pixel)
    assert (ring.inner, ring.outer, ring.rows, ring.columns) == (inner, outer, rows, columns)


def test_a_plane_is_sampled_between_its_pixels_and_beyond_its_border():
    plane = np.tile(np.arange(0, 200, 10, dtype=np.uint8), (9, 1))
    x, y = np.array([[2.5, 0.0, -4.0, 30.0]], np.float32), np.full((1, 4), 4.0, np.float32)
    assert unroll(plane, (x, y)).tolist() == [[25, 0, 0, 190]]


@pytest.mark.parametrize("half", [1, 2])
def test_a_moving_average_is_cyclic(half):
    profile = np.random.default_rng(0).normal(0.0, 1.0, (2, 9))
    expected = np.mean([np.roll(profile, k, axis=1) for k in range(-half, half + 1)], axis=0)
    np.testing.assert_allclose(boxed(profile, half), expected)


def _frame(white=False):
    rng = np.random.default_rng(1)
    y = rng.integers(0, 255, (48, 64)).astype(np.uint8)
    u, v = (rng.integers(0, 255, (24, 32)).astype(np.uint8) for _ in range(2))
    return Frame(0, 0, y, u, v)


def _sampled(plane, x, y):
    x, y = np.clip(x.astype(float), 0, plane.shape[1] - 1), np.clip(y.astype(float), 0, plane.shape[0] - 1)
    left, top = np.minimum(x.astype(int), plane.shape[1] - 2), np.minimum(y.astype(int), plane.shape[0] - 2)
    a, b = x - left, y - top
    p = plane.astype(float)
    return (
        (1 - a) * (1 - b) * p[top, left]
        + a * (1 - b) * p[top, left + 1]
        + (1 - a) * b * p[top + 1, left]
        + a * b * p[top + 1, left + 1]
    )


@pytest.mark.parametrize("centre", [(30.0, 22.0), (5.0, 4.0), (60.0, 44.0)])  # also beyond the border
@pytest.mark.parametrize("white", [False, True])
def test_windows_and_turns_of_a_ring_are_sampled_from_the_score(white, centre):
    frame = _frame()
    weights = (0.5, 0.0) if white else (0.3, -0.4)
    plane = 0.5 * frame.y.astype(float) if white else 0.3 * frame.u.astype(float) - 0.4 * frame.v
    ring = Ring(centre, 6.0, 16.0, 5, 40)
    score = Score(white, weights, frame.y.shape if white else frame.u.shape)
    grid = Grid(ring, 7, score)
    x, y = ring.maps(chroma=not white, beyond=7)
    whole = _sampled(plane, x, y)
    np.testing.assert_allclose(grid.around(frame, slice(1, 4)), whole[1:4], atol=4.0)  # cv2 rounds to 1/32 px
    np.testing.assert_allclose(grid.turns([frame, frame], slice(0, 5, 2))[1], whole[::2], atol=0.01)
    ground = np.random.default_rng(2).normal(0.0, 1.0, whole.shape).astype(np.float32)
    windows = np.zeros((2, 5, 7), np.float32)
    grid.cut([frame, frame], np.array([3, 38]), ground, windows)
    for found, first in zip(windows, (3, 38), strict=True):
        np.testing.assert_allclose(found, (whole - ground)[:, first : first + 7], atol=0.01)


def test_the_box_of_a_window_contains_all_of_its_samples():
    place = np.array([[3.2, 9.0, 5.0, 4.0], [2.1, 8.5, 6.9, 4.0]], np.float32)
    assert polar._reach(place, 2, 20).tolist() == [[2, 10], [5, 10], [4, 8]]
    # at least two pixels within the plane
    assert polar._reach(np.array([[-3.0, 40.0]], np.float32), 1, 20).tolist() == [[0, 2], [18, 20]]


def test_windows_are_averaged_over_rows_and_columns_after_a_transformation():
    rng = np.random.default_rng(3)
    scores = rng.normal(0.0, 1.0, (4, 3, 5)).astype(np.float32)
    light, offset, scale = rng.uniform(0.5, 2.0, (2, 5)), np.array([0.1, -0.2]), np.array([2.0, 0.5])
    windows = Windows(scores, np.array([3, 1]), light, offset, scale)
    plain = (light[:, None, :] * scores[[3, 1]] - offset[:, None, None]) * scale[:, None, None]
    rows, columns = np.array([[0.25, 0.75, 0.0], [0.0, 0.5, 0.5]]), np.array([[0.2] * 5])
    np.testing.assert_allclose(
        windows.bands(rows), np.einsum("br,nrc->nbc", rows, plain), rtol=1e-4, atol=1e-5
    )
    np.testing.assert_allclose(
        windows.bands(columns, across=True), np.einsum("bc,nrc->nbr", columns, plain), rtol=1e-4, atol=1e-5
    )
    np.testing.assert_allclose(
        Windows.plain(scores).bands(rows), np.einsum("br,nrc->nbc", rows, scores), rtol=1e-4, atol=1e-5
    )


@pytest.mark.parametrize(
    ("colour", "degrees"),
    [
        ("red", 108),
        ("orange", 138),
        ("yellow", 171),
        ("green", 228),
        ("cyan", 289),
        ("blue", 333),
        ("magenta", 52),
    ],
)
def test_a_colour_is_a_direction_in_the_chroma_plane(colour, degrees):
    angle = np.deg2rad(degrees)
    assert chroma_direction(colour) == pytest.approx((np.cos(angle), np.sin(angle)))
    assert chroma_direction(colour, 20.0) == pytest.approx((np.cos(np.deg2rad(20)), np.sin(np.deg2rad(20))))
    assert nearest_colour(float(degrees)) == colour
    assert nearest_colour(degrees + 360.0 - 8.0) == colour
    assert chroma_direction("white", 20.0) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("hue", "colour"),
    [(12.4, "blue"), (12.6, "magenta"), (122.9, "red"), (123.1, "orange"), (258.4, "green"), (258.6, "cyan")],
)
def test_the_nearest_colour_changes_half_way(hue, colour):
    assert nearest_colour(hue) == colour


def test_a_hue_scores_its_length_along_less_that_across():
    score = hue_score([5.0, 4.0, 4.0, -5.0, 3.0], [0.0, 1.0, -1.0, 0.0, 3.1], (1.0, 0.0))
    np.testing.assert_allclose(score, [5.0, 3.0, 3.0, 0.0, 0.0])
    np.testing.assert_allclose(hue_score(3.0, 4.0, (0.6, 0.8)), 5.0)
    np.testing.assert_allclose(hue_score(3.0, 4.0, (1.0, 0.0)), 0.0)


@pytest.mark.parametrize(
    ("rgb", "name"),
    [
        ((200, 30, 30), "red"),
        ((30, 30, 200), "blue"),
        ((30, 160, 40), "green"),
        ((110, 110, 110), "white"),
        ((109, 109, 109), ""),
        ((128, 108, 108), "white"),  # u = -3.4, v = 10.0; luma 114
        ((140, 108, 108), "red"),  # u = -5.4, v = 16.0
        ((90, 70, 70), ""),
    ],
)
def test_a_pixel_has_the_name_of_its_hue_or_is_grey(rgb, name):
    assert colour_name(*rgb) == name


def test_blobs_are_connected_patches_above_a_threshold():
    score = np.zeros((20, 30), np.float32)
    score[2, 2:4] = 9.0  # two pixels
    score[5, 5], score[6, 6], score[7, 7] = 5.0, 5.0, 10.0  # connected by corners
    score[12:16, 10:18] = 4.0
    score[15, 17] = 2.0  # not above the threshold
    found = find_blobs(score, 2.0)
    assert [(b.area, b.weight) for b in found] == [(31, 124.0), (3, 20.0)]
    assert (found[1].x, found[1].y) == pytest.approx((6.25, 6.25))
    assert found[0].fill == pytest.approx(4 * 31 / (np.pi * 64))
    assert found[1].fill == pytest.approx(4 * 3 / (np.pi * 9))
    assert len(find_blobs(score, 2.0, most=1)) == 1
    # of the four largest patches for each wanted one, the strongest
    score[18, 0:3] = 90.0
    assert find_blobs(score, 2.0, most=1)[0].weight == 270.0


def _marker(name, body):
    return Marker(name, body, "red", 40.0, 50.0, 0.1, (9.0, 0.0), 0.15)


def test_a_scene_knows_the_axis_and_the_markers_of_a_body():
    markers = (_marker("a", "rotor"), _marker("b", "casing"), _marker("c", "rotor"))
    scene = Scene((100.0, 80.0), None, markers, offsets={"rotor": (2.0, -3.0)})
    assert (scene.axis("rotor"), scene.axis("casing")) == ((102.0, 77.0), (100.0, 80.0))
    assert [m.name for m in scene.of("rotor")] == ["a", "c"]
    assert scene.bodies == ("casing", "rotor")
    assert Scene((0.0, 0.0), None, markers[:1]).bodies == ("rotor",)
    assert markers[0].radius == 45.0


def _frames(count, width=8):
    full = lambda value, height, side: np.full((height, side), value, np.uint8)  # noqa: E731
    return tuple(
        Frame(k, k, full(k, 4, 2 * width), full(k, 2, width), full(2 * k, 2, width)) for k in range(count)
    )


@pytest.mark.parametrize(
    ("head", "later", "chosen"),
    [(48, 20, 12), (48, 11, 37), (48, 12, 12), (48, 0, 48), (10, 20, 10), (30, 4, 30)],
)
def test_a_scene_is_determined_from_all_later_frames_and_some_of_the_head(head, later, chosen):
    spread = Samples(_frames(head + later), head).spread
    assert spread[len(spread) - later :] == tuple(range(head, head + later))
    assert len(spread) == chosen + later
    assert (spread[0], spread[chosen - 1]) == (0, head - 1)


def test_samples_have_chroma_in_small_pictures_and_half_of_it_in_large_ones():
    small = Samples(_frames(9), 9)
    assert (small.scale, small.size) == (2, (16, 4))
    assert small.chroma.shape == (2, 9, 2, 8)
    assert small.chroma[:, 3, 0, 0].tolist() == [3, 6]
    assert small.still[:, 0, 0].tolist() == [4.0, 8.0]
    assert small.to_luma(1.0, 2.0) == (2.5, 4.5)
    assert Samples(_frames(1, 400), 1).scale == 2
    large = Samples(_frames(1, 401), 1)
    assert large.scale == 4
    assert large.chroma.shape == (2, 1, 1, 200)
    assert large.to_luma(1.0, 2.0) == (5.5, 9.5)
    plane = np.array([[10, 20, 30, 40, 99], [50, 60, 70, 80, 99], [99] * 5], np.uint8)
    assert reduced(plane, 2).tolist() == [[35, 55]]


def test_samples_are_unrolled_along_a_ring():
    samples = Samples(_frames(3, 30), 3)
    ring = Ring((20.0, 2.0), 1.0, 2.0, 2, 8)
    assert samples.strips(ring, [2, 1]).shape == (2, 2, 2, 8)
    assert samples.strips(ring, [2, 1])[:, 0, 0, 0].tolist() == [2, 4]
    assert samples.luma_strips(ring, [2])[0].tolist() == [[2] * 8] * 2


class Store:
    def __call__(self, frame):
        return frame


@pytest.mark.parametrize(("count", "message"), [(0, "No frame"), (7, "only 7 frames"), (8, None), (60, None)])
def test_eight_frames_are_needed_and_48_are_the_head(count, message, monkeypatch):
    class Reader:
        def __init__(self, _):
            pass

        def __enter__(self):
            return iter(_frames(count))

        def __exit__(self, *_):
            return None

    monkeypatch.setattr(module, "Reader", Reader)
    other = Frame(0, 0, np.zeros((6, 16), np.uint8), *[np.zeros((3, 8), np.uint8)] * 2)
    monkeypatch.setattr(module, "_later", lambda path, head, pixels, threads: [_frames(1)[0], other])
    if message:
        with pytest.raises(VideoError, match=message):
            module.take_samples("film")
        return
    samples = module.take_samples("film")
    assert samples.head == min(count, 48)
    assert len(samples.frames) == samples.head + 1  # a frame of another size is omitted


@pytest.mark.parametrize(
    ("count", "every", "kind"), [(1000, 47, "keys"), (1000, 60, "spread"), (48, 5, "none"), (1000, 0, "none")]
)
def test_later_samples_are_key_frames_or_frames_between_them(count, every, kind, monkeypatch):
    key = np.arange(count) % every == 0 if every else np.zeros(count, bool)
    packets = Packets(10 * np.arange(count), np.ones(count, np.int64), key, True)
    monkeypatch.setattr(module, "read_packets", lambda _: packets)
    asked = []
    monkeypatch.setattr(
        module, "frames_at", lambda path, stamps, keep: asked.extend(stamps) or {s: s for s in stamps}
    )
    found = module._later("film", 48, 320 * 240, 2)
    if kind == "keys":
        places = np.linspace(0, key.sum() - 1, 20).astype(int)
        assert found == sorted(asked) == (470 * places).tolist()
    elif kind == "none":
        assert found == []
    else:
        wanted = np.unique(np.linspace(48, 999, 32).astype(int))
        assert found == sorted(asked) == (10 * wanted).tolist()


def test_large_frames_are_sampled_near_their_key_frames(monkeypatch):
    """Frames before the last wanted one of each group are decoded; their number is limited by the size."""
    key = np.arange(1000) % 100 == 0
    monkeypatch.setattr(
        module, "read_packets", lambda _: Packets(np.arange(1000), np.ones(1000, np.int64), key, True)
    )
    monkeypatch.setattr(module, "frames_at", lambda path, stamps, keep: {s: s for s in stamps})
    wanted = np.unique(np.linspace(48, 999, 32).astype(int))
    start = wanted // 100 * 100
    cost = sum((wanted - start)[start == k].max() for k in np.unique(start))
    for pixels in (1280 * 720, 1920 * 1080):
        share = min(240 * 1280 * 720 / pixels / cost, 1.0)
        expected = np.unique(start + ((wanted - start) * share).astype(int))
        assert module._later("film", 48, pixels, 1) == expected.tolist()


def test_stored_frames_are_independent_of_the_decoder():
    store = module.FrameStore()
    kept = [store(frame) for frame in _frames(19)]
    assert [int(f.y[0, 0]) for f in kept] == list(range(19))
    assert [int(f.v[1, 3]) for f in kept] == [2 * k for k in range(19)]
    wide = store(_frames(1, 12)[0])
    assert wide.y.shape == (4, 24)
    assert list(module.in_turn(kept)) == kept
    assert isinstance(kept[0], SimpleNamespace | Frame)
