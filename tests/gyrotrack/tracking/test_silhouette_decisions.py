"""Silhouettes of bodies in front of the background, and links: formulas and limits on small drawn pictures."""

import math
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from gyrotrack.tracking import _silhouettes as module
from gyrotrack.tracking._first_look import FirstLook, hub_of
from gyrotrack.tracking._pivot import Arc
from gyrotrack.tracking._silhouettes import (
    CompactBody,
    LongBody,
    Spot,
    median_picture,
    parts_of,
    spot_of,
    spots_in,
)


def _drawn(*discs, lines=()):
    region = np.zeros((80, 160), np.uint8)
    for x, y, radius in discs:
        cv2.circle(region, (x, y), radius, 1, -1)
    for start, end, width in lines:
        cv2.line(region, start, end, 1, width)
    return region


@pytest.mark.parametrize("count", [1, 2, 5, 8])
def test_the_median_of_frames_is_that_of_numpy(count):
    frames = np.random.default_rng(count).integers(0, 256, (count, 70, 9)).astype(np.uint8)
    np.testing.assert_array_equal(median_picture(list(frames)), np.median(frames, axis=0))


def test_a_spot_is_the_compact_part_of_a_body_without_its_string():
    region = _drawn((60, 40, 10), lines=[((60, 40), (60, 0), 3)])
    spot = spot_of(parts_of(region), (60, 40))
    assert spot.place == pytest.approx((60.0, 40.0), abs=0.6)
    assert spot.radius == pytest.approx(10.0, abs=0.4)
    middle = spot.mask.shape[0] // 2
    assert spot.mask[middle, middle] == 1
    assert spot.mask.sum() == pytest.approx(math.pi * spot.radius**2, rel=1e-6)
    assert spot.mask.shape[0] < 2 * 16
    assert spot_of(parts_of(region), (10, 10)) is None


@pytest.mark.parametrize(("side", "found"), [(1, False), (3, True)])
def test_a_spot_has_a_radius_of_one_and_a_half_pixels(side, found):
    region = np.zeros((20, 20), np.uint8)
    region[8 : 8 + side, 8 : 8 + side] = 1
    assert (spot_of(parts_of(region), (8 + side // 2, 8 + side // 2)) is not None) == found


@pytest.mark.parametrize(
    ("radii", "least", "most", "count"),
    [((12, 9), 0.7, 3, 2), ((12, 7), 0.7, 3, 1), ((12, 12, 12), 0.7, 2, 2), ((12, 7, 5), 0.35, 3, 3)],
)
def test_large_parts_of_a_region_are_spots(radii, least, most, count):
    region = _drawn(*((25 + 50 * k, 40, radius) for k, radius in enumerate(radii)))
    found = spots_in(region, least, most)
    assert len(found) == count
    assert [s.radius for s in found] == sorted((s.radius for s in found), reverse=True)


def _body(place, radius=5.0, alone=0.9):
    return CompactBody(radius, np.asarray(place, float), alone)


def _swing(reach, extent=60.0):
    angle = reach * np.sin(np.linspace(0.0, 12.0, 60))
    place = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    return 100.0 + place * extent / np.hypot(*np.ptp(place, axis=0))


@pytest.mark.parametrize(
    ("radius", "alone", "reach", "arc", "pendulum"),
    [
        (5.0, 0.51, 0.5, {}, True),
        (5.0, 0.49, 0.5, {}, False),
        (29.0, 0.9, 0.5, {}, True),
        (31.0, 0.9, 0.5, {}, False),  # a path of 60 px is shorter than two radii
        (5.0, 0.9, 0.5, {"noise": 2.1, "by_place": 2.8}, True),
        (5.0, 0.9, 0.5, {"noise": 2.2, "by_place": 2.9}, False),  # 6 % of 60 px
        (5.0, 0.9, 1.5, {}, True),
        (5.0, 0.9, 1.65, {}, False),  # more than half a turn
    ],
)
def test_a_bob_moves_on_an_open_arc(radius, alone, reach, arc, pendulum, monkeypatch):
    given = {"noise": 0.1, "by_place": 0.0} | arc
    hub = np.array([100.0, 100.0])
    monkeypatch.setattr(module, "fit_arc", lambda *_: Arc(hub, np.eye(2), 50.0, 0.02, 1e-5, **given))
    pivot = _body(_swing(reach), radius, alone).pivot
    assert (pivot is not None) == pendulum


def test_a_straight_path_has_its_pivot_at_infinity(monkeypatch):
    monkeypatch.setattr(module, "fit_arc", lambda *_: Arc(np.zeros(2), np.eye(2), 1e9, 1e-9, 1e-5, 0.1, 0.0))
    assert np.isinf(_body(_swing(0.5)).pivot).all()


def _compact(radii, monkeypatch, area=400):
    """Frames with spots of given radii; None: no spot."""
    frames = iter(radii)

    def spots(*_):
        given = next(frames)
        if given is None:
            return []
        mask = np.ones((10, 10), np.uint8)
        return [Spot((float(k), 0.0), r, mask) for k, r in enumerate(np.atleast_1d(given))]

    monkeypatch.setattr(module, "spots_in", spots)
    monkeypatch.setattr(module, "differs", lambda *_: np.ones(area, np.uint8))
    return module.compact_body([None] * len(radii), None, 1.0)


@pytest.mark.parametrize(
    ("radii", "seen"),
    [
        ([8.0] * 8 + [None] * 2, True),
        ([8.0] * 7 + [None] * 3, False),
        ([8.0] * 8 + [11.1] * 2, True),
        ([8.0] * 7 + [11.3] * 3, False),  # 1.4 times 8 px is 11.2 px
        ([8.0] * 7 + [5.8] * 3, True),
        ([8.0] * 7 + [5.6] * 3, False),
        ([8.0] * 7 + [[30.0, 8.0]] * 3, True),  # beside a hand
    ],
)
def test_a_compact_body_has_one_size_in_most_frames(radii, seen, monkeypatch):
    found = _compact(radii, monkeypatch)
    assert (found is not None) == seen
    if seen:
        assert found.radius == 8.0
        assert found.alone == 100 / 400
        assert len(found.place) >= 8
        assert found.place[-1].tolist() == ([1.0, 0.0] if radii[-1] == [30.0, 8.0] else [0.0, 0.0])


def _bar(length, width, angle=0.4, level=60.0):
    y, x = np.mgrid[0:120, 0:160].astype(float)
    u = (x - 80.0) * math.cos(angle) + (y - 60.0) * math.sin(angle)
    v = (y - 60.0) * math.cos(angle) - (x - 80.0) * math.sin(angle)
    cover = np.clip(0.5 * length + 0.5 - np.abs(u), 0, 1) * np.clip(0.5 * width + 0.5 - np.abs(v), 0, 1)
    return np.rint(120.0 + level * cover).astype(np.uint8)


GREY = np.full((120, 160), 120.0, np.float32)


@pytest.mark.parametrize(("side", "level"), [("light", 60.0), ("dark", -60.0)])
def test_the_axis_of_a_bar_has_its_direction_and_half_of_its_length(side, level):
    centre, half, width = LongBody(side, GREY, 5.0).axis(_bar(80.0, 9.0, 0.4, level))
    assert centre == pytest.approx((80.0, 60.0), abs=0.1)
    assert np.hypot(*half) == pytest.approx(40.5, abs=1.2)
    assert abs(half @ [-math.sin(0.4), math.cos(0.4)]) < 0.3
    assert width == pytest.approx(9.5, abs=1.0)
    assert (
        LongBody("dark" if side == "light" else "light", GREY, 5.0).axis(_bar(80.0, 9.0, 0.4, level)) is None
    )


@pytest.mark.parametrize(("ratio", "long"), [(1.8, False), (2.3, True)])
def test_a_long_body_is_twice_as_long_as_wide(ratio, long):
    assert (LongBody("light", GREY, 5.0).axis(_bar(24.0 * ratio, 24.0)) is not None) == long


def test_a_faint_bar_is_not_seen():
    assert LongBody("light", GREY, 5.0).axis(_bar(80.0, 9.0, 0.4, 4.0)) is None
    assert LongBody("light", GREY, 5.0).axis(_bar(80.0, 9.0, 0.4, 8.0)) is not None


def test_the_axes_of_a_rod_meet_in_its_hub(monkeypatch):
    hub, angle = np.array([70.0, 50.0]), np.linspace(-0.4, 0.4, 12)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    frames = list(zip(hub + 30.0 * along, 30.0 * along, strict=True))
    motion = SimpleNamespace(mean=GREY, noise=1.0)

    def meet(some):
        monkeypatch.setattr(
            LongBody, "axis", lambda self, frame: None if self.side == "light" else (*frame, 3.0)
        )
        return module.axes_meet(some, motion)

    assert meet(frames) == pytest.approx(tuple(hub))
    assert meet(frames[:8]) == pytest.approx(tuple(hub))
    assert meet(frames[:7]) is None
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    sign = np.where(np.arange(12) % 2, 1.0, -1.0)[:, None]
    # 3 % of a length of 60 px
    for off, found in ((1.6, True), (2.1, False)):
        moved = [(c + o, h) for (c, h), o in zip(frames, off * sign * normal, strict=True)]
        assert (meet(moved) is not None) == found
    narrow = np.linspace(-0.15, 0.15, 12)  # the mean square of the sine is below 0.01
    along = np.stack([np.cos(narrow), np.sin(narrow)], axis=1)
    assert meet(list(zip(hub + 30.0 * along, 30.0 * along, strict=True))) is None


def test_a_hub_is_a_fixed_fraction_of_the_axis_from_the_centroid():
    angle = np.linspace(0.0, 3.0, 30)
    half = 20.0 * np.stack([np.cos(angle), 0.6 * np.sin(angle)], axis=1)
    np.testing.assert_allclose(hub_of(np.array([50.0, 40.0]) - 0.3 * half, half), [50.0, 40.0])
    assert not FirstLook((9, 9)).pendulum


def _pieces(*parts, level=100.0):
    """Draw horizontal bars of 9 px about the row 60, each from and to a column, with a level."""
    frame = np.full((120, 160), 120.0)
    for first, last, *own in parts:
        frame[56:65, first:last] = 120.0 + (own[0] if own else level)
    return np.rint(frame).astype(np.uint8)


def _axis(*parts):
    return LongBody("light", GREY, 5.0).axis(_pieces(*parts))


@pytest.mark.parametrize(("gap", "long"), [(14, True), (22, False)])
def test_the_parts_of_a_long_body_fill_most_of_its_ellipse(gap, long):
    """A bar of 100 x 9 px without 15 px in the middle has a ratio of 1.34, without 20 px a ratio of 1.46."""
    found = _axis((30, 80 - gap // 2), (80 + gap // 2, 130))
    assert (found is not None) == long
    if long:
        assert found[0] == pytest.approx((79.5, 60.0), abs=0.5)
        assert np.abs(found[1]) == pytest.approx((math.sqrt((100**3 - 14**3) / (4 * 86)), 0.0), abs=0.6)


@pytest.mark.parametrize(("length", "used"), [(10, False), (17, True)])
def test_a_piece_has_a_fifth_of_the_area_of_the_largest(length, used):
    centre, half, _ = _axis((20, 85), (90, 90 + length))
    assert centre[0] == pytest.approx(52.0 + 0.5 * (5 + length) * used, abs=4.0)
    assert (np.abs(half[0]) > 38.0) == used


@pytest.mark.parametrize(("level", "used"), [(45.0, False), (55.0, True)])
def test_a_silhouette_is_brighter_than_half_of_the_body(level, used):
    centre, half, width = _axis((30, 90), (90, 110, level))
    # the blurred edge of the fainter part is below the limit
    assert np.abs(half[0]) == pytest.approx(38.5 if used else 30.0, abs=1.0)
    assert centre[0] == pytest.approx(68.0 if used else 59.5, abs=1.0)
    assert width == pytest.approx(9.0, abs=0.9)


def test_twenty_pixels_show_a_long_body():
    # after blurring, 15, 21 and 27 pixels differ, and 9, 15 and 21 belong to the body
    for length, seen in ((3.0, False), (5.0, False), (6.0, True)):
        assert (LongBody("light", GREY, 5.0).axis(_bar(length, 1.0, 0.0, 120.0)) is not None) == seen


def _tilted(monkeypatch, *, tilt=0.8, scatter=0.0, range_=3.0, seen=1.0, side="dark"):
    """Return the long body of 20 frames whose half axes are on an ellipse; one side shows nothing."""
    angle = np.linspace(0.0, range_, 20)
    away = 30.0 * (1.0 + scatter * np.tile([1.0, -1.0, -1.0, 1.0], 5))
    half = away[:, None] * np.stack([np.cos(angle), math.cos(tilt) * np.sin(angle)], axis=1)
    shown = range(round(20 * seen))
    monkeypatch.setattr(
        LongBody,
        "axis",
        lambda self, k: (np.zeros(2), half[k], 3.0) if self.side == side and k in shown else None,
    )
    return module.long_tilted_body(range(20), GREY, 1.5)


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({}, True),
        ({"side": "light"}, True),
        ({"tilt": 0.42}, True),
        ({"tilt": 0.38}, False),
        ({"scatter": 0.057}, True),
        ({"scatter": 0.063}, False),
        ({"seen": 0.8, "range_": 3.7}, True),
        ({"seen": 0.75, "range_": 3.9}, False),
        # a range of the ends of 1.65 rad leaves a gap of 1.49 rad, one of 1.5 rad leaves 1.64 rad
        ({"range_": 1.65, "tilt": 0.45}, True),
        ({"range_": 1.45, "tilt": 0.45}, False),
    ],
)
def test_the_ends_of_a_tilted_body_are_on_an_ellipse(change, found, monkeypatch):
    body = _tilted(monkeypatch, **change)
    assert (body is not None) == found
    if found:
        assert (body.side, body.limit) == (change.get("side", "dark"), 3.0)  # twice the noise


@pytest.mark.parametrize(("half_width", "removed"), [(9, True), (14, False)])
def test_a_rod_thinner_than_three_fifths_of_a_bob_is_removed(half_width, removed):
    region = np.zeros((120, 160), np.uint8)
    cv2.circle(region, (60, 60), 20, 1, -1)
    region[60 - half_width : 61 + half_width, 60:140] = 1
    spot = spot_of(parts_of(region), (60, 60))
    assert (spot.radius < 23.0) == removed


@pytest.mark.parametrize("place", [(33, 27), (8, 9), (60, 41)])
def test_the_mask_of_a_spot_shows_its_pixels_about_its_centre(place):
    x, y = place
    region = _drawn((x, y, 9), (140, 20, 5))
    spot = spot_of(parts_of(region), (x, y))
    half = spot.mask.shape[0] // 2
    assert 9 < half < 13
    around = np.pad(region, 20)[y + 20 - half : y + 21 + half, x + 20 - half : x + 21 + half]
    assert np.abs(spot.mask.astype(int) - around).sum() <= 8  # an opening removes single pixels
    assert spot.place == pytest.approx(place, abs=0.1)


def test_spots_joined_by_a_rod_are_separated():
    region = _drawn((30, 40, 12), (110, 40, 10), lines=[((30, 40), (110, 40), 5)])
    found = spots_in(region, 0.7, 3)
    assert [s.place for s in found] == [pytest.approx((30, 40), abs=0.7), pytest.approx((110, 40), abs=0.7)]
    # a rod as wide as the bodies is one body with them
    assert len(spots_in(_drawn((30, 40, 12), (110, 40, 10), lines=[((30, 40), (110, 40), 21)]), 0.7, 3)) == 1


def test_thin_lines_are_not_spots():
    region = _drawn(lines=[((20, 40), (90, 40), 1), ((20, 60), (90, 60), 1)])
    assert spots_in(region, 0.7, 3) == []
    assert spots_in(np.zeros((80, 160), np.uint8), 0.7, 3) == []


def test_axes_meet_with_the_weights_of_their_robust_fit(monkeypatch):
    """The fixed point of the weights 1 / (1 + (d / m)^2)^2, with m = 3 % of the median length."""
    rng = np.random.default_rng(0)
    angle = np.linspace(-0.6, 0.7, 24)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    off = rng.normal(0.0, 0.8, 24)
    off[::6] += 4.0
    centre = np.array([70.0, 50.0]) + 30.0 * along + off[:, None] * normal
    frames = list(zip(centre, 30.0 * along, strict=True))
    monkeypatch.setattr(LongBody, "axis", lambda self, frame: None if self.side == "light" else (*frame, 3.0))
    hub = np.array(module.axes_meet(frames, SimpleNamespace(mean=GREY, noise=1.0)))
    apart = np.sum(normal * (centre - hub), axis=1)
    weight = 1.0 / (1.0 + (apart / (0.03 * 60.0)) ** 2) ** 2
    step = np.linalg.solve((normal * weight[:, None]).T @ normal, (normal * weight[:, None]).T @ apart)
    assert np.abs(step).max() < 2e-3
    assert hub == pytest.approx((70.0, 50.0), abs=0.8)
