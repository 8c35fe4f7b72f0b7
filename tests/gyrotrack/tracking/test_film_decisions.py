"""The frames of a film and the motion of the camera: formulas and limits on small arrays."""

import math
from dataclasses import dataclass
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from gyrotrack.tracking import _camera_motion as camera
from gyrotrack.tracking import _film as module
from gyrotrack.tracking import _translation as translation
from gyrotrack.tracking._camera_motion import Shake, background, camera_shake
from gyrotrack.tracking._coaxial import differs_from, enough
from gyrotrack.tracking._film import Film, Tilt, fresh_frames


@pytest.mark.parametrize(
    ("angle", "azimuth", "matrix"),
    [
        (0.0, 0.3, [[1.0, 0.0], [0.0, 1.0]]),
        (
            math.pi / 3,
            math.pi / 2,
            [[0.5, 0.0], [0.0, 1.0]],
        ),  # the short axis is vertical: the width is halved
        (math.pi / 3, 0.0, [[1.0, 0.0], [0.0, 0.5]]),
        (math.pi / 3, math.pi / 4, [[0.75, -0.25], [-0.25, 0.75]]),  # up and to the right is (1, -1)
    ],
)
def test_a_tilt_shortens_the_long_axis_about_the_middle(angle, azimuth, matrix):
    found = Tilt(angle, azimuth).matrix(101, 51)
    np.testing.assert_allclose(found[:, :2], matrix, atol=1e-12)
    np.testing.assert_allclose(found @ [50.0, 25.0, 1.0], [50.0, 25.0])


def test_places_are_converted_to_the_corrected_picture_and_back():
    film = object.__new__(Film)
    film.tilt, film.info = Tilt(math.pi / 3), SimpleNamespace(width=101, height=51)
    assert film.levelled((70.0, 40.0)) == pytest.approx((60.0, 40.0))
    np.testing.assert_allclose(
        film.seen(np.array([[60.0, 40.0], [50.0, 25.0]])), [[70.0, 40.0], [50.0, 25.0]]
    )
    film.tilt = None
    assert film.levelled((70.0, 40.0)) == (70.0, 40.0)


def test_a_colour_is_the_chroma_along_its_direction():
    film = object.__new__(Film)
    film.tilt = None
    y = np.arange(24, dtype=np.uint8).reshape(4, 6)
    u, v = np.full((2, 3), 148, np.uint8), np.full((2, 3), 118, np.uint8)
    frame = SimpleNamespace(y=y, u=u, v=v)
    film._direction = (0.6, -0.8)
    assert film._plane(frame).tolist() == [[148] * 6] * 4  # 128 + 0.6 * 20 + 0.8 * 10
    film._direction = (-0.6, 0.8)
    assert film._plane(frame).tolist() == [[108] * 6] * 4
    film._direction = None
    np.testing.assert_array_equal(film._plane(frame), y)


def test_fields_have_half_of_the_period():
    film = object.__new__(Film)
    film.stamps, film.warnings = np.array([0.0, 0.04, 0.08]), ()
    film.info = Info(25.0, 3, 0.01)
    film._count_fields(6)
    np.testing.assert_allclose(film.stamps, 0.02 * np.arange(6))
    assert (film.info.container_fps, film.info.frames_declared, film.info.time_base) == (50.0, 6, 0.005)
    assert len(film.warnings) == 1


@dataclass(frozen=True)
class Info:
    container_fps: float
    frames_declared: int
    time_base: float


def test_the_two_fields_of_a_frame_come_in_their_order():
    film = object.__new__(Film)
    film.tilt, film._direction = None, None
    y = np.zeros((8, 4), np.uint8)
    y[1::2] = 200
    frames = [SimpleNamespace(y=y, index=k) for k in range(2)]
    for first in (0, 1):
        film._first_field = first
        found = [(int(plane.mean()), index) for plane, index in film._pictures(frames)]
        assert [index for _, index in found] == [0, 1, 2, 3]
        assert [value > 100 for value, _ in found] == [first == 1, first == 0] * 2
    film._first_field = None
    assert [index for _, index in film._pictures(frames)] == [0, 1]


def _flicker(gains, noise=0.5, black=0.0, moving=False):
    rng = np.random.default_rng(0)
    base = rng.uniform(60.0, 180.0, (30, 40))
    flicker = module._Flicker()
    for k, gain in enumerate(gains):
        picture = black + gain * (base - black) + rng.normal(0.0, noise, base.shape)
        if moving:
            picture[:, 3 * k : 3 * k + 3] = 50.0
        flicker.add(picture.astype(np.float32))
    return flicker.gain


@pytest.mark.parametrize("black", [0.0, 16.0])
def test_the_gain_of_flicker_is_measured_from_black(black):
    gains = np.array([1.0, 1.1, 0.9, 1.05, 0.95, 1.2])
    level, found = _flicker(gains, black=black, moving=True)
    assert level == black
    np.testing.assert_allclose(found, gains / gains.mean(), rtol=3e-3)


@pytest.mark.parametrize(("size", "found"), [(0.009, False), (0.015, True)])
def test_flicker_exceeds_the_noise(size, found):
    """Noise of 1 grey level and a flicker s of pixels of 120 grey levels: hypot(1, 120 s) > 1.5 for s > 0.93 %."""
    gains = 1.0 + size * np.where(np.arange(40) % 2, 1.0, -1.0)
    gains[0] = 1.0
    assert (_flicker(gains, noise=1.0) is not None) == found


@pytest.mark.parametrize(("pixels", "known"), [(50, False), (51, True)])
@pytest.mark.parametrize(("level", "used"), [(33.0, True), (31.0, False), (233.0, True), (236.0, False)])
def test_pixels_between_black_and_white_show_the_gain(pixels, known, level, used):
    flicker = module._Flicker()
    picture = np.full((1, 60), 10.0, np.float32)
    picture[0, :pixels] = level
    flicker.add(picture)
    flicker.add((picture * np.float32(1.005)).astype(np.float32))
    expected = 1.005 if known and used else 1.0
    assert flicker._gain[0.0] == pytest.approx([1.0, expected])


def test_the_change_of_a_picture_ignores_its_brightness():
    before = np.array([[100.0, 50.0], [20.0, 30.0]], np.float32)
    assert module._change(before, 1.5 * before) == pytest.approx(0.0, abs=1e-5)
    assert module._change(before, before[:, ::-1].copy()) == pytest.approx((50 + 50 + 10 + 10) / 4)
    assert module._change(np.zeros((2, 2), np.float32), before) == pytest.approx(50.0)


@pytest.mark.parametrize(
    ("changes", "repeats"),
    [
        ([10.0] * 5 + [0.9] + [10.0] * 5, [5]),
        ([10.0] * 5 + [1.1] + [10.0] * 5, []),
        ([10.0] * 5 + [0.5, 0.5] + [10.0] * 5, [5, 6]),
        ([10.0] * 6 + [8.0, 4.0, 2.0, 0.5, 2.0, 4.0, 8.0] + [10.0] * 6, []),  # a reversal
        ([0.5], []),
    ],
)
def test_a_repeated_frame_changes_by_a_tenth_of_its_neighbours(changes, repeats):
    change = np.array([255.0, *changes])
    film = SimpleNamespace(changes=change, selected=np.ones(len(change), bool))
    found = fresh_frames(film)
    missing = sorted(set(range(len(change))) - set(found.tolist()))
    assert missing == [k + 1 for k in repeats]
    film.selected[2:4] = False
    assert not {2, 3} & set(fresh_frames(film).tolist())


@pytest.mark.parametrize(
    ("lengths", "repeated"),
    [
        ([25] * 10, True),
        ([12, 13] * 5, True),
        ([25] * 8, False),
        ([12, 14] * 5, False),
        ([1, 2] * 10, False),
        ([1] * 30 + [25], False),
    ],
)
def test_frames_that_are_repeated_many_times_are_omitted(lengths, repeated):
    """A body that is drawn at rest once is not a repeat; neither is a body that pauses irregularly."""
    change = np.zeros(sum(lengths) + 20)
    new = np.cumsum(lengths)
    change[new] = 5.0
    film = object.__new__(Film)
    film.changes, film.selected = change, np.ones(len(change), dtype=bool)
    found = set(fresh_frames(film).tolist())
    assert (found == {0, *new.tolist()}) == repeated


class Colours:
    def __init__(self, frames):
        self.frames = frames

    def __call__(self, _):
        return self

    def __enter__(self):
        return iter(self.frames)

    def __exit__(self, *_):
        return None


@pytest.mark.parametrize(
    ("chroma", "pixels", "at", "coloured"),
    [(25, 12, 0, True), (24, 12, 0, False), (25, 11, 0, False), (25, 12, 11, True), (25, 12, 12, False)],
)
def test_a_coloured_film_has_twelve_coloured_pixels_in_its_first_frames(
    chroma, pixels, at, coloured, monkeypatch
):
    frames = []
    for k in range(20):
        v = np.full((4, 6), 128, np.uint8)
        if k >= at:
            v.ravel()[:pixels] -= np.uint8(chroma)
        frames.append(SimpleNamespace(u=np.full((4, 6), 128, np.uint8), v=v))
    monkeypatch.setattr(module, "Reader", Colours(frames))
    assert module.is_coloured("film") == coloured
    assert module.is_coloured("film", at + 1) == (chroma == 25 and pixels == 12)
    assert not module.is_coloured("film", at)


def test_a_film_is_interlaced_only_if_all_frames_declare_it(monkeypatch):
    frames = [SimpleNamespace(y=np.full((2, 2), k), interlaced=True) for k in range(20)]
    seen = []
    monkeypatch.setattr(module, "first_field", lambda some: seen.append(len(some)) or 1)
    monkeypatch.setattr(module, "Reader", Colours(frames))
    assert module._interlacing("film") == 1
    assert seen == [12]
    frames[5].interlaced = False
    assert module._interlacing("film") is None


SHAKE = Shake(np.array([[2.0, -1.0], [0.0, 3.0]]), np.array([0.0, 0.5]), (50.0, 40.0), 9, 0.01, 1e-3)


def test_points_are_displaced_and_rolled_with_the_picture():
    place = np.array([[60.0, 40.0], [60.0, 40.0]])
    seen = SHAKE.seen(place)
    np.testing.assert_allclose(seen, [[62.0, 39.0], [50.0 + 10 * math.cos(0.5), 43.0 + 10 * math.sin(0.5)]])
    np.testing.assert_allclose(SHAKE.still(seen), place)


def test_a_shake_has_its_rms_and_margin():
    # both frames are (1, 2) px from their mean
    assert SHAKE.rms == pytest.approx(math.sqrt(5.0))
    # 3 px and 0.5 rad at half of 90 px, rounded up, and one more
    assert SHAKE.margin((60, 90)) == math.ceil(3.0 + 22.5) + 1


@pytest.mark.parametrize(
    ("size", "sigma", "significant"),
    [(0.16, 0.01, True), (0.14, 0.01, False), (0.51, 0.1, True), (0.49, 0.1, False)],
)
def test_a_shake_is_significant_beyond_five_sigma_and_the_least_displacement(size, sigma, significant):
    shift = size * np.array([[1.0, 0.0], [-1.0, 0.0]])
    assert Shake(shift, np.zeros(2), (0.0, 0.0), 9, sigma, 0.0).significant == significant


def test_a_frame_is_resampled_to_the_reference():
    y, x = np.mgrid[0:80, 0:100].astype(float)
    picture = lambda u, v: np.exp(-((x - u) ** 2) / 30.0 - (y - v) ** 2 / 30.0) * 200.0  # noqa: E731
    (u, v), _ = SHAKE.seen(np.array([[62.0, 35.0]] * 2))[1], None
    frame = np.rint(picture(u, v)).astype(np.uint8)
    still = SHAKE.stabilised(frame, 1).astype(float)
    assert (still * x).sum() / still.sum() == pytest.approx(62.0, abs=0.1)
    assert (still * y).sum() / still.sum() == pytest.approx(35.0, abs=0.1)


SHAPE = (100, 120)
GRID = (
    np.stack(np.meshgrid(np.linspace(5, 115, 6), np.linspace(5, 95, 5)), axis=-1)
    .reshape(-1, 2)
    .astype(np.float32)
)


def _rigidly(places, shift, roll):
    centre = places.mean(axis=0)
    c, s = math.cos(roll), math.sin(roll)
    return (places - centre) @ np.array([[c, s], [-s, c]]) + centre + shift - places


@pytest.mark.parametrize(("size", "still"), [(0.34, True), (0.36, False)])
def test_features_at_rest_are_the_background(size, still):
    moved = np.zeros((10, 30, 2))
    moved[:, :20] = 0.2
    moved[:, 20:, 0] = np.linspace(0.0, 30.0, 10)[:, None] * np.linspace(1.0, 2.0, 10)
    moved[:, 7] = 0.0
    moved[1:, 7, 0] = size
    found = background(GRID, moved, SHAPE)
    assert found[:7].all()
    assert not found[20:].any()
    assert bool(found[7]) == still


@pytest.mark.parametrize(("often", "member"), [(8, False), (9, True)])
def test_a_feature_of_the_background_is_at_rest_in_most_frames(often, member):
    moved = np.zeros((10, 30, 2))
    moved[often:, 7, 0] = 9.0
    moved[0, 8] = np.nan
    found = background(GRID, moved, SHAPE)
    assert bool(found[7]) == member
    assert found[8]


@pytest.mark.parametrize(("roll", "found"), [(0.045, True), (0.055, False)])
def test_a_shaking_background_moves_as_a_rigid_picture(roll, found):
    rng = np.random.default_rng(1)
    moved = np.stack([_rigidly(GRID, rng.normal(0, 4.0, 2), roll * (-1) ** k) for k in range(10)])
    moved[:, 21:] = rng.normal(0.0, 6.0, (10, 9, 2))
    members = background(GRID, moved, SHAPE)
    if not found:
        assert not members.any()
        return
    np.testing.assert_array_equal(members, np.arange(30) < 21)
    moved[:, 3, 0] += 0.6
    moved[:, 4, 0] += 1.4
    members = background(GRID, moved, SHAPE)
    assert not members[4]


@pytest.mark.parametrize(
    ("count", "share", "wide"), [(5, 0.5, False), (6, 0.5, True), (6, 0.045, False), (6, 0.055, True)]
)
def test_a_background_has_six_features_in_a_twentieth_of_the_picture(count, share, wide):
    x, y = 120.0 * math.sqrt(share), 100.0 * math.sqrt(share)
    places = np.array([[0, 0], [x, 0], [0, y], [x, y], [x / 2, y / 2], [x / 3, y / 3]], np.float32)[:count]
    assert camera._wide(places, SHAPE) == wide


def test_displacement_and_roll_are_fitted_without_outliers():
    rng = np.random.default_rng(2)
    shifts, rolls = rng.normal(0.0, 3.0, (20, 2)), rng.normal(0.0, 2e-3, 20)
    moved = np.stack([_rigidly(GRID, s, r) for s, r in zip(shifts, rolls, strict=True)])
    moved[:, 4] += 9.0
    moved[3, 10:20] = np.nan
    moved[7] = np.nan
    found = camera._rigid(GRID, moved)
    kept = np.arange(20) != 7
    np.testing.assert_allclose(found.shift[kept], shifts[kept], atol=2e-3)
    np.testing.assert_allclose(found.roll[kept], rolls[kept], atol=1e-5)
    np.testing.assert_allclose(found.shift[7], 0.5 * (shifts[6] + shifts[8]), atol=2e-3)
    assert found.centre == pytest.approx((60.0, 50.0))
    assert found.features == 30
    moved[8:10] = np.nan
    assert camera._rigid(GRID, moved) is None  # 17 of 20 frames


def test_the_uncertainty_of_a_displacement_is_that_of_a_mean():
    off = np.where(np.arange(30) % 2, 1.0, -1.0)[:, None] * [0.3, 0.4]
    moved = np.stack([_rigidly(GRID, np.zeros(2), 0.02 * (-1) ** k) + off for k in range(10)])
    found = camera._rigid(GRID, moved)
    assert found.shift_sigma == pytest.approx(0.5 / math.sqrt(30), rel=0.25)
    inertia = float(np.sum((GRID - GRID.mean(axis=0)) ** 2))
    assert found.roll_sigma == pytest.approx(0.5 / math.sqrt(inertia), rel=0.25)


def test_few_features_have_no_motion():
    moved = np.zeros((10, 30, 2))
    moved[:, 3:] = np.nan
    assert camera._rigid(GRID, moved) is not None
    moved[:, 2:] = np.nan
    assert camera._rigid(GRID, moved) is None


@pytest.mark.parametrize(("size", "kept"), [(5.1, True), (4.9, False)])
def test_a_roll_is_significant_beyond_five_sigma(size, kept):
    roll = size * np.where(np.arange(10) % 2, 1.0, -1.0)
    found, sigma = camera._significant_roll(roll, 1.0)
    if kept:
        assert found is roll
        assert sigma == 1.0
    else:
        np.testing.assert_array_equal(found, 0.0)
        assert sigma == pytest.approx(math.sqrt(size**2 - 1.0))


def test_halves_of_the_background_are_patches_outside_the_body():
    whole, odd, even = camera._halves((200, 300), (150.0, 100.0, 50.0))
    np.testing.assert_array_equal(whole, odd + even)
    assert whole[100, 99] == 1
    assert whole[100, 101] == whole[149, 150] == 0
    assert (even[0, 0], odd[0, 69], odd[0, 70], odd[70, 0], even[70, 70]) == (1, 0, 1, 1, 1)


def test_a_shake_is_measured_outside_the_bodies(monkeypatch):
    asked = []
    monkeypatch.setattr(camera, "features_of", lambda _: GRID)
    monkeypatch.setattr(
        camera, "tracked", lambda reference, places, frame: np.zeros((len(places), 2)) + frame
    )
    monkeypatch.setattr(
        camera, "background", lambda places, *_: asked.append(places) or np.ones(len(places), bool)
    )
    samples = [np.full((1, 1), 3.0 * (-1) ** k) for k in range(9)]
    found = camera_shake(samples, samples, (5.0, 5.0, 30.0))
    assert len(asked[0]) == 30 - np.count_nonzero(np.hypot(*(GRID - 5.0).T) <= 30.0)
    assert len(found.shift) == 9
    assert camera_shake([np.zeros((1, 1))] * 9, samples) is None  # at rest
    monkeypatch.setattr(camera, "features_of", lambda _: GRID[:5])
    assert camera_shake(samples, samples) is None


@pytest.mark.parametrize(
    ("of_rest", "of_all", "found"),
    [
        (0.41, 0.06, True),
        (0.39, 0.06, False),
        (0.41, 0.04, False),
        (0.21, 0.11, True),
        (0.19, 0.11, False),
        (0.21, 0.09, False),
    ],
)
def test_a_second_rotation_explains_enough(of_rest, of_all, found):
    assert enough(of_rest, of_all) == found


@pytest.mark.parametrize(
    ("factor", "differs"), [(1.19, False), (1.3, True), (0.82, False), (0.78, True), (-1.0, True)]
)
def test_two_angles_differ_by_a_fifth(factor, differs):
    angle = np.linspace(0.0, 2.0, 50)
    # relative to the larger one: (1.3 - 1) / 1.3 = 0.23
    assert differs_from(angle, factor * angle + 7.0) == differs


def test_a_rotation_about_a_hub_is_clockwise_as_seen():
    matrix = translation._rotation((50.0, 40.0), 0.5)
    np.testing.assert_allclose(
        matrix @ [60.0, 40.0, 1.0], [50 + 10 * math.cos(0.5), 40 + 10 * math.sin(0.5)], rtol=1e-6
    )
    np.testing.assert_allclose(matrix @ [50.0, 40.0, 1.0], [50.0, 40.0], rtol=1e-6)


def test_a_residual_is_the_variance_of_pictures_transformed_back():
    _, x = np.mgrid[0:40, 0:60]
    pictures = [np.rint(100 + 2.0 * (x - k)).clip(0, 255).astype(np.uint8) for k in (0, 4, 8)]
    swept = np.zeros((40, 60), np.uint8)
    swept[10:30, 15:40] = 1
    still = np.eye(2, 3, dtype=np.float32)
    assert translation.residual(pictures, [still] * 3, swept) == pytest.approx(np.var([0.0, 8.0, 16.0]))
    moves = [np.float32([[1, 0, k], [0, 1, 0]]) for k in (0, 4, 8)]
    assert translation.residual(pictures, moves, swept) == pytest.approx(0.0, abs=1e-6)


def test_a_body_is_aligned_by_translation():
    rng = np.random.default_rng(0)
    base = cv2.GaussianBlur(rng.normal(0.0, 1.0, (60, 80)), (0, 0), 3.0)
    base = np.rint(128 + 60 * base / np.abs(base).max()).astype(np.uint8)
    shown = np.roll(base, (2, -3), axis=(0, 1))
    swept = np.zeros((60, 80), np.uint8)
    swept[15:45, 20:60] = 1
    found = translation._translation(shown, base, swept, np.array([-2.0, 1.0]))
    np.testing.assert_allclose(found, [[1, 0, -3], [0, 1, 2]], atol=0.1)


@pytest.mark.parametrize(
    ("first", "stop", "expected"), [(0, None, range(9)), (3, 6, (3, 4, 5)), (7, 40, (7, 8)), (4, 4, ())]
)
def test_frames_of_a_large_film_are_decoded_again(first, stop, expected, monkeypatch):
    frames = [SimpleNamespace(y=np.full((2, 2), k, np.uint8), index=k) for k in range(9)]

    class Reader(Colours):
        def __call__(self, *_):
            return self

    monkeypatch.setattr(module, "Reader", Reader(frames))
    film = object.__new__(Film)
    film._files, film.count, film.path, film._threads = [], 9, "film", 1
    film._first_field = film.tilt = film._direction = film._gain = film._shake = None
    assert [int(f[0, 0]) for f in film.frames(first, stop)] == list(expected)
    assert len(film) == 9
    # stored in two files of five frames
    film._files = [np.stack([f.y for f in frames[:5]]), np.stack([f.y for f in [*frames[5:], frames[0]]])]
    assert [int(f[0, 0]) for f in film.frames(first, stop)] == list(expected)
    assert [int(f[0, 0]) for f in film.some([6, 2, 4])] == [2, 4, 6]


def test_flicker_is_compensated_about_the_black_level():
    film = object.__new__(Film)
    film._gain, film._shake = (16.0, np.array([1.0, 1.25])), None
    plane = np.array([[16, 116]], np.uint8)
    assert film._still(plane, 1).tolist() == [[16, 96]]
    assert film._still(plane, 0).tolist() == [[16, 116]]
    assert not film.stabilised
    film.stabilise(SimpleNamespace(stabilised=lambda plane, index: plane + np.uint8(index)))
    assert film._still(plane, 1).tolist() == [[17, 97]]


class TestStoredFilm:
    """Pictures of 4 x 6 px; a file has five of them, and at most twelve are stored."""

    def film(self, monkeypatch, count, *, most=None, fields=None, gain=None, tilt=None):
        frames = [
            SimpleNamespace(y=np.full((4, 6), 10 * k, np.uint8), index=k, interlaced=False)
            for k in range(count)
        ]
        added = []

        class Reader(Colours):
            info = Info(25.0, count, 0.04)
            warnings = ("own",)

            def __call__(self, *_):
                return self

            def __enter__(self):
                return self

            def __iter__(self):
                return iter(self.frames)

            def pts_seconds(self):
                return 0.04 * np.arange(count)

        flicker = SimpleNamespace(add=lambda small: added.append(small.shape), gain=gain)
        monkeypatch.setattr(module, "Reader", Reader(frames))
        monkeypatch.setattr(module, "_interlacing", lambda _: fields)
        monkeypatch.setattr(module, "_Flicker", lambda: flicker)
        monkeypatch.setattr(module, "_FILE", 5 * 24 + 10)
        monkeypatch.setattr(module, "_HELD", 12 * 24)
        return Film("film", most=most, tilt=tilt), added

    @pytest.mark.parametrize(
        ("count", "most", "length", "files"),
        [
            (12, None, 12, 3),
            (13, None, 13, 0),
            (20, 12, 12, 3),
            (5, None, 5, 1),
            (6, None, 6, 2),
            (0, None, 0, 0),
        ],
    )
    def test_small_films_are_stored_in_files_of_some_pictures(self, monkeypatch, count, most, length, files):
        film, added = self.film(monkeypatch, count, most=most)
        assert (len(film), len(film._files)) == (length, files)
        assert all(f.shape == (5, 4, 6) for f in film._files)
        if files:
            assert [int(f[0, 0]) for f in film.frames()] == [10 * k for k in range(length)]
        assert added == [(1, 2)] * length
        assert film.selected.tolist() == [True] * length
        assert film.warnings == ("own",)
        assert film._gain is None
        # the first picture changes by the whole range; later ones only in brightness, which is flicker
        expected = [255.0, *[10.0 * (k == 1) for k in range(1, length)]][:length]
        assert film.changes.tolist() == pytest.approx(expected, abs=1e-4)

    def test_an_interlaced_film_has_two_pictures_per_frame(self, monkeypatch):
        film, _ = self.film(monkeypatch, 4, fields=1)
        assert (len(film), film.interlaced) == (8, True)
        assert film.stamps == pytest.approx(0.02 * np.arange(8))
        assert "its 8 fields" in film.warnings[-1]

    def test_flicker_and_tilt_are_stated(self, monkeypatch):
        gain = (16.0, np.array([1.1, 0.9, 1.1, 0.9]))
        film, _ = self.film(monkeypatch, 4, gain=gain, tilt=Tilt(0.3))
        assert film._gain is gain
        assert "10 % rms" in film.warnings[1]
        assert "17.2 degrees" in film.warnings[2]


@pytest.mark.parametrize("factor", [1, 2, 3])
def test_a_reduced_picture_has_the_means_of_whole_squares(factor):
    picture = np.random.default_rng(0).integers(0, 255, (7, 11)).astype(np.uint8)
    found = module.reduced(picture, factor)
    height, width = 7 // factor, 11 // factor
    whole = picture[: height * factor, : width * factor].astype(float)
    expected = whole.reshape(height, factor, width, factor).mean(axis=(1, 3))
    assert found.shape == (height, width)
    assert np.abs(found - expected).max() <= 0.51


def test_the_gain_is_measured_in_a_coarser_grid_of_a_large_picture(monkeypatch):
    """Every second pixel of a picture of more than 8000 pixels."""
    added = []
    frame = SimpleNamespace(y=np.zeros((400, 400), np.uint8), index=0, interlaced=False)

    class Reader(Colours):
        info, warnings = Info(25.0, 1, 0.04), ()

        def __call__(self, *_):
            return self

        def __enter__(self):
            return self

        def __iter__(self):
            return iter(self.frames)

        def pts_seconds(self):
            return np.zeros(1)

    monkeypatch.setattr(module, "Reader", Reader([frame]))
    monkeypatch.setattr(module, "_interlacing", lambda _: None)
    monkeypatch.setattr(
        module, "_Flicker", lambda: SimpleNamespace(add=lambda s: added.append(s.shape), gain=None)
    )
    Film("film")
    assert added == [(50, 50)]


@pytest.mark.parametrize("azimuth", [math.pi / 2, 0.3])
def test_a_picture_is_corrected_for_the_tilt(azimuth):
    """A small spot is displaced like its place."""
    film = object.__new__(Film)
    film.tilt, film.info = Tilt(0.9, azimuth), SimpleNamespace(width=101, height=71)
    y, x = np.mgrid[0:71, 0:101]
    plane = np.rint(200.0 * np.exp(-((x - 70.0) ** 2 + (y - 50.0) ** 2) / 18.0)).astype(np.uint8)
    shown = film._level(plane).astype(float)
    assert shown.shape == (71, 101)
    middle = [float((v * shown).sum() / shown.sum()) for v in (x, y)]
    assert middle == pytest.approx(film.levelled((70.0, 50.0)), abs=0.1)
    assert abs(middle[0] - 70.0) + abs(middle[1] - 50.0) > 2.0
