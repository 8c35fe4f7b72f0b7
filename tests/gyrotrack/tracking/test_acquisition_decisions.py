"""Decisions and formulas of the acquisition of a scene, on small strips with known markers."""

from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import Profile, TrackingError
from gyrotrack.tracking import _acquisition as module
from gyrotrack.tracking._acquisition import (
    Extent,
    Rings,
    SampledMarker,
    acquire,
    aligned,
    extent_of,
    find_coloured,
    find_disc,
    find_white,
    half_maximum,
    is_marker_sized,
    orbit_offset,
    placed,
    places_of,
    search_ring,
    share_together,
)
from gyrotrack.tracking._orbit import Orbit, common_centre
from gyrotrack.tracking._polar import Ring
from gyrotrack.tracking._profile import PAPER, Blob, MarkerProfile
from gyrotrack.tracking._scene import Disc, Marker

RING = Ring((100.0, 80.0), 30.0, 50.0, 21, 256)  # 1 px from row to row
STEP = RING.step
ORBIT = Orbit((100.0, 80.0), {0: 60.0, 1: 40.0}, 20, 6.0)
WHITE = MarkerProfile(name="w", colour="white", body="rotor")


def _seen(angle, clear=None, name="x", body="rotor", contrast=(30.0, 40.0), **marker):
    angle = np.asarray(angle, dtype=float)
    clear = np.ones(len(angle), dtype=bool) if clear is None else np.asarray(clear)
    own = {"inner": 35.0, "outer": 45.0, "half_width": 0.1, "foot": 0.15, "dwell": 0.1} | marker
    return SampledMarker(Marker(name, body, "red", contrast=contrast, **own), angle, clear)


@pytest.mark.parametrize("count", [1, 2, 4, 8, 11])
def test_aligned_strips_are_averaged_over_their_middle_quarter(count):
    rng = np.random.default_rng(count)
    score = rng.normal(0.0, 1.0, (count + 2, 3, 20)).astype(np.float32)
    column = rng.integers(0, 20, count + 2)
    use = np.ones(count + 2, dtype=bool)
    use[[0, -1]] = False
    rolled = np.stack([np.roll(score[k], 5 - column[k], axis=1)[:, :11] for k in np.flatnonzero(use)])
    order = np.sort(rolled, axis=0).astype(float)
    middle = order[3 * count // 8 : count - 3 * count // 8]
    np.testing.assert_allclose(aligned(score, column, use, 5), middle.mean(axis=0), rtol=1e-5)
    # 1.2 rad of a turn of 20 columns are 3.8 columns
    assert aligned(score, column, use).shape == (3, 7)


@pytest.mark.parametrize(
    ("curve", "start", "part", "expected"),
    [
        ([0, 1, 2, 3, 4, 3, 2, 1, 0], 4, 0.5, (2.0, 6.0)),
        ([0, 1, 2, 3, 4, 3, 2, 1, 0], 4, 0.1, (0.4, 7.6)),
        ([0, 0, 4, 4, 4, 3, 1, 0], 3, 0.5, (1.5, 5.5)),
        ([0, 1, 3, 4, 4, 0], 2, 0.5, (1.5, 4.5)),
        ([3, 3, 4, 3, 3, 3], 2, 0.5, (0.0, 5.0)),
        ([4, 0, 0], 0, 0.5, (0.0, 0.5)),
    ],
)
def test_a_curve_falls_to_a_part_of_its_maximum(curve, start, part, expected):
    assert half_maximum(np.array(curve, dtype=float), start, part) == pytest.approx(expected)


def _patch(lean=0.0, flat=6.0, ramp=10.0, background=0.0, rows=(10, 14), columns=79):
    x = np.arange(columns) - columns // 2
    across = np.clip((flat + ramp - np.abs(x - lean)) / ramp, 0.0, 1.0) + background
    along = np.zeros(21)
    along[rows[0] : rows[1] + 1] = 8.0
    along[rows[0] - 1], along[rows[1] + 1] = 2.0, 2.0
    return along[:, None] * across[None, :]


@pytest.mark.parametrize(("lean", "background"), [(0.0, 0.0), (4.0, 0.0), (-4.0, 0.2)])
def test_the_extent_of_a_patch_is_its_region_above_half_of_the_maximum(lean, background):
    extent = extent_of(_patch(lean, background=background), RING)
    # half of 8 is between 2 and 8, a third of the way
    np.testing.assert_allclose([extent.inner, extent.outer], [30.0 + 9.0 + 1 / 3, 30.0 + 15.0 - 1 / 3])
    np.testing.assert_array_equal(np.flatnonzero(extent.rows), np.arange(10, 15))
    assert extent.half_width == pytest.approx(11.0 * STEP)
    assert extent.lean == lean
    assert extent.foot == pytest.approx(15.0 * STEP)


def test_a_background_above_three_tenths_of_the_maximum_is_part_of_the_patch():
    # the level is 0.3 of (1 + 1) below: half of 1.4 above it is 0.3 of the trapezoid
    extent = extent_of(_patch(background=1.0), RING)
    assert extent.half_width == pytest.approx((6.0 + 10.0 * 0.7) * STEP)


def test_a_patch_without_a_positive_score_has_no_extent():
    assert extent_of(-_patch(), RING) is None
    assert extent_of(0.0 * _patch(), RING) is None


def test_a_single_row_is_the_extent_of_a_narrow_patch():
    patch = np.zeros((21, 31))
    patch[7, 15] = 9.0
    extent = extent_of(patch, RING)
    np.testing.assert_array_equal(np.flatnonzero(extent.rows), [7])
    assert (extent.inner, extent.outer) == pytest.approx((36.5, 37.5))
    assert extent.half_width == pytest.approx(0.5 * STEP)


def test_the_core_of_an_extent_is_six_tenths_of_its_width():
    rows = np.array([False, True, True, False])
    core = Extent(rows, 1.0, 2.0, 10.0 * STEP, 3).core(41, STEP)
    np.testing.assert_array_equal(core.any(axis=1), rows)
    np.testing.assert_array_equal(np.flatnonzero(core[1]), np.arange(20 + 3 - 5, 20 + 3 + 6))


def test_the_largest_score_of_a_sample_is_clear_above_half_of_the_typical_one():
    profile = np.zeros((10, 32), dtype=np.float32)
    height = np.array([49.0, 51.0, 60.0, 80.0, 100.0, 100.0, 100.0, 300.0, 300.0, 300.0])
    for k in range(10):
        profile[k, (3 * k - 1 + np.arange(3)) % 32] = height[k]
    column, clear = module._brightest(profile, 1)
    np.testing.assert_array_equal(column, 3 * np.arange(10))
    np.testing.assert_array_equal(clear, [False] + [True] * 9)  # the 0.6 quantile is 100


def test_the_dwell_is_the_largest_share_at_one_angle():
    angle = np.array([0.1, 0.15, -0.05, 2.0, 2.1, 4.0, 6.2, 5.0])
    assert module._dwell(angle, 0.21) == pytest.approx(4 / 8)  # 0.1, 0.15, -0.05 and 6.2
    assert module._dwell(angle, 0.11) == pytest.approx(2 / 8)


@pytest.mark.parametrize("place", [40.0, 40.3, 40.75, 0.2, 255.7])
def test_a_coarse_angle_is_refined_to_the_centroid(place):
    x = (np.arange(256) - place + 128) % 256 - 128
    # the window extends by ceil(1.5 * 4) + 1 = 7 columns; a bell of 2 columns sigma is within it
    profile = 5.0 + 20.0 * np.exp(-0.5 * (x / 2.0) ** 2)
    profile[np.abs(x) > 8.5] = 90.0
    found = module._refined(
        profile[None].astype(np.float32), np.array([round(place) * STEP]), 4.0 * STEP, RING
    )
    assert found[0] / STEP == pytest.approx(place, abs=0.03)


def _rings(angle, inner=34, outer=44, half=8, shade=(20.0, -30.0), ground=128):
    strips = np.full((2, len(angle), 21, 256), ground, dtype=np.uint8)
    for k, a in enumerate(angle):
        columns = (round(a / STEP) + np.arange(-half, half + 1)) % 256
        for c in range(2):
            strips[c, k, inner - 30 : outer - 30 + 1, columns] = ground + shade[c]
    return Rings(strips, RING)


TURNING = (0.4 + 0.7 * np.arange(18)) % (2 * np.pi)
BLUEISH = MarkerProfile(name="b", colour="blue", body="rotor", hue=310.0)


def test_a_coloured_marker_is_located_and_measured():
    seen = find_coloured(_rings(TURNING), BLUEISH)
    assert (seen.marker.inner, seen.marker.outer) == pytest.approx((33.5, 44.5))
    assert seen.marker.half_width == pytest.approx(8.5 * STEP, rel=0.01)
    assert seen.marker.contrast == pytest.approx((20.0, -30.0))
    assert (seen.marker.name, seen.marker.body, seen.marker.colour) == ("b", "rotor", "blue")
    assert seen.clear.all()
    off = np.angle(np.exp(1j * (seen.angle - np.rint(TURNING / STEP) * STEP)))
    np.testing.assert_allclose(off, 0.0, atol=1e-6)
    # within 1.3 half widths of 0.21 rad: 0.4 + 9 * 0.7 is 0.4 + 0.017 rad after a turn
    assert seen.marker.dwell == pytest.approx(2 / 18)


@pytest.mark.parametrize(("shade", "found"), [((3.0, -5.0), False), ((3.0, -6.0), True)])
def test_a_marker_has_a_contrast_of_six_grey_levels(shade, found):
    assert (find_coloured(_rings(TURNING, shade=shade), BLUEISH) is not None) == found


@pytest.mark.parametrize(("clear", "found"), [(1, False), (3, True)])
def test_a_marker_is_clear_in_a_tenth_of_the_samples(clear, found, monkeypatch):
    plain = module._brightest
    seen = np.arange(18) < clear
    monkeypatch.setattr(module, "_brightest", lambda *given: (plain(*given)[0], seen))
    assert (find_coloured(_rings(TURNING), BLUEISH) is not None) == found


def test_a_marker_at_rest_is_found_relative_to_its_row():
    seen = find_coloured(_rings(np.full(18, 1.3)), BLUEISH)
    assert seen.marker.contrast == pytest.approx((20.0, -30.0))
    assert seen.marker.dwell == 1.0
    np.testing.assert_allclose(seen.angle, round(1.3 / STEP) * STEP, atol=1e-6)
    assert find_coloured(_rings(np.full(18, 1.3), shade=(0.0, 0.0)), BLUEISH) is None


@pytest.mark.parametrize(
    ("dwell", "sized", "by_ring"), [(0.29, True, False), (0.31, True, True), (0.29, False, True)]
)
def test_the_row_is_the_background_of_markers_that_dwell_or_have_no_size(dwell, sized, by_ring, monkeypatch):
    one, two = _seen([0.0], dwell=dwell), _seen([1.0])
    rings = SimpleNamespace(foreground="foreground", ring_difference="row", ring=RING)
    monkeypatch.setattr(module, "is_marker_sized", lambda _: sized)
    monkeypatch.setattr(module, "_locate", lambda difference, *_: {"foreground": one, "row": two}[difference])
    assert find_coloured(rings, WHITE) is (two if by_ring else one)
    monkeypatch.setattr(
        module, "_locate", lambda difference, *_: {"foreground": one, "row": None}[difference]
    )
    assert find_coloured(rings, WHITE) is one
    monkeypatch.setattr(
        module, "_locate", lambda difference, *_: {"foreground": None, "row": two}[difference]
    )
    assert find_coloured(rings, WHITE) is two


def test_rings_have_a_background_over_samples_and_along_rows():
    strips = np.random.default_rng(0).integers(0, 256, (2, 5, 3, 8)).astype(np.uint8)
    rings = Rings(strips, RING)
    whole = strips.astype(float)
    np.testing.assert_array_equal(rings.foreground, whole - np.median(whole, axis=1, keepdims=True))
    np.testing.assert_array_equal(rings.ring_difference, whole - np.median(whole, axis=3, keepdims=True))


def test_the_angle_of_a_body_is_the_mean_of_its_clear_markers():
    one = _seen([0.1, 0.2, 0.3, 9.0], [True, True, False, True])
    two = _seen([1.2, 1.1, 1.3, 9.0], [True, False, False, True], mount=1.0)
    found = module._body_angles([one, two], 3)
    np.testing.assert_allclose(found, [0.15, 0.2, np.nan])
    # markers that disagree by 2.7 rad leave a sum of 2 cos 1.35 = 0.44, by 2.5 rad of 0.63
    assert np.isnan(module._body_angles([_seen([0.0]), _seen([2.7])], 1)).all()
    np.testing.assert_allclose(module._body_angles([_seen([0.0]), _seen([2.5])], 1), 1.25)


def test_a_marker_is_blanked_within_one_and_six_tenths_of_its_half_width():
    turned = np.ones((21, 256))
    module._blank(turned, RING, _seen([0.0], mount=-3.0 * STEP, half_width=5.0 * STEP).marker)
    np.testing.assert_array_equal(np.flatnonzero(turned[0] == 0), np.sort((np.arange(-7, 8) - 3) % 256))
    np.testing.assert_array_equal(turned, np.broadcast_to(turned[0], turned.shape))


def _turned(column=100, half=8, height=40.0, noise=1.0, rows=(4, 15)):
    rng = np.random.default_rng(3)
    turned = rng.normal(0.0, noise, (21, 256))
    turned[rows[0] : rows[1], (column + np.arange(-half, half + 1)) % 256] += height
    return turned


def test_the_brightest_place_at_the_radii_of_the_others_is_the_white_marker():
    others = [_seen([0.0], half_width=8 * STEP), _seen([0.0], half_width=9 * STEP, inner=38.0, outer=42.0)]
    marker = module._brightest_place(_turned(), RING, WHITE, others, 6.0)
    assert marker.mount == pytest.approx(100 * STEP)
    assert marker.contrast == (pytest.approx(40.0, rel=0.03), 0.0)
    assert marker.half_width == pytest.approx(8.5 * STEP, rel=0.05)
    assert (marker.inner, marker.outer) == pytest.approx((33.5, 44.5), abs=0.1)
    # brighter, but at no radius of another marker
    turned = _turned()
    turned[17:, 20:40] += 90.0
    turned[:3, 200:220] += 90.0
    assert module._brightest_place(turned, RING, WHITE, others, 6.0).mount == pytest.approx(100 * STEP)
    far = [_seen([0.0], inner=60.0, outer=70.0)]
    assert module._brightest_place(_turned(), RING, WHITE, far, 6.0) is None


@pytest.mark.parametrize(("height", "found"), [(5.5, False), (6.5, True)])
def test_a_white_marker_has_the_least_contrast(height, found):
    others = [_seen([0.0], half_width=8 * STEP)]
    assert (
        module._brightest_place(_turned(height=height, noise=0.1), RING, WHITE, others, 6.0) is not None
    ) == found


@pytest.mark.parametrize(
    ("width", "found"), [(2.5 * 4 + 0.05 / STEP - 1, True), (2.5 * 4 + 0.05 / STEP + 1, False)]
)
def test_a_white_marker_is_two_and_a_half_times_as_wide_as_the_others(width, found):
    others = [_seen([0.0], half_width=4 * STEP)]
    turned = _turned(half=int(width), noise=0.0)
    assert (module._brightest_place(turned, RING, WHITE, others, 6.0) is not None) == found


@pytest.mark.parametrize(("times", "found"), [(4.6, False), (5.4, True)])
def test_a_white_marker_exceeds_five_standard_deviations_of_its_ring(times, found):
    others = [_seen([0.0], half_width=8 * STEP)]
    # 1.4826 times the median absolute value of a ring with the two values +-a; a is alike over the window
    turned = np.tile(np.where(np.arange(256) < 128, 10.0, -10.0), (21, 1))
    turned[4:17, 192 - 8 : 192 + 9] = times * 14.826
    assert (module._brightest_place(turned, RING, WHITE, others, 6.0) is not None) == found


def _white_film(count, hidden=0, jump=8):
    """A white marker 1.5 rad after a coloured one, on a table with a bright fixed lamp."""
    angle = np.arange(count) * jump * STEP
    luma = np.full((count, 21, 256), 60, dtype=np.uint8)
    luma[:, :, 77:90] = 200
    for k in range(count):
        luma[k, 5:15, (jump * k + 61 + np.arange(-6, 7)) % 256] = 120
    clear = np.arange(count) >= hidden
    samples = SimpleNamespace(luma_strips=lambda ring, frames: luma[list(frames)])
    return samples, [_seen(angle, clear, half_width=6 * STEP)]


@pytest.mark.parametrize(("count", "hidden", "found"), [(12, 4, True), (12, 5, False), (24, 0, True)])
def test_a_white_marker_is_found_in_eight_frames_rotated_back(count, hidden, found):
    samples, others = _white_film(count, hidden, jump=20)
    marker = find_white(samples, range(count), RING, WHITE, others)
    assert (marker is not None) == found
    if found:
        assert marker.mount == pytest.approx(61 * STEP)
        assert marker.contrast[0] == pytest.approx(60.0, rel=0.02)
        assert marker.half_width == pytest.approx(6.5 * STEP, rel=0.02)


def test_markers_are_placed_relative_to_the_first_of_their_body():
    frame = np.arange(10.0)
    first = _seen(0.3 * frame, frame < 6)
    second = _seen(0.3 * frame + 2.0 + (frame >= 6), frame > 2)
    sparse = _seen(0.3 * frame - 1.0, frame > 3)  # two common samples: all samples decide
    mounts = [seen.marker.mount for seen in placed([first, second, sparse])]
    assert mounts == pytest.approx([0.0, 2.0, -1.0])


@pytest.mark.parametrize(("common", "mount"), [(2, -1.0), (3, 1.0)])
def test_three_common_samples_determine_a_mount_angle(common, mount):
    frame = np.arange(10.0)
    first = _seen(0.3 * frame, frame < common)
    other = _seen(0.3 * frame - 1.0 + 2.0 * (frame < common))
    assert placed([first, other])[1].marker.mount == pytest.approx(mount)


@pytest.mark.parametrize(
    ("angle", "mode"),
    [
        ([1.0, 1.1, 1.05, 4.0], 1.05),
        ([1.0, 1.0, 1.14, 4.0, 4.0], (1.0 + 1.0 + 1.14) / 3),
        ([1.0, 1.0, 1.16, 4.0], 1.0),
        ([-3.1, 3.1, 3.12], np.angle(np.mean(np.exp(1j * np.array([-3.1, 3.1, 3.12]))))),
    ],
)
def test_the_mode_of_angles_is_the_mean_of_the_neighbours(angle, mode):
    assert module._circular_mode(np.array(angle)) == pytest.approx(mode, abs=1e-3)


@pytest.mark.parametrize(("common", "share"), [(7, None), (8, 1.0)])
def test_two_markers_are_compared_in_eight_common_samples(common, share):
    frame = np.arange(20)
    found = share_together(_seen(0.3 * frame), _seen(0.3 * frame + 2.0, frame < common))
    assert np.isnan(found) if share is None else found == share


@pytest.mark.parametrize(("off", "share"), [(0.19, 1.0), (0.21, 0.7), (6.2, 1.0)])
def test_two_markers_move_together_within_a_fifth_of_a_radian(off, share):
    frame = np.arange(10)
    assert share_together(_seen(0.3 * frame), _seen(0.3 * frame + 2.0 + off * (frame < 3))) == pytest.approx(
        share
    )


def test_a_marker_that_turns_with_the_other_body_is_omitted():
    frame = np.arange(20)
    slow, fast = 0.1 * frame, 0.8 * frame
    rotor = {name: _seen(fast + k, name=name) for k, name in enumerate(["blue", "green", "cyan"])}
    red = _seen(slow, name="red", body="casing")
    wrong = _seen(fast + 2.0, name="wrong", body="casing")
    assert module._on_other_body({"red": red, "wrong": wrong, **rotor}, "film") == ["wrong"]
    assert module._on_other_body({"red": red, **rotor}, "film") == []
    on_casing = _seen(slow + 1.0, name="odd")
    other = _seen(slow + 2.0, name="red two", body="casing")
    assert module._on_other_body({"red": red, "other": other, "odd": on_casing, **rotor}, "film") == ["odd"]
    with pytest.raises(TrackingError):
        module._on_other_body({"red": red, "odd": on_casing}, "film")


@pytest.mark.parametrize(("cover", "raises"), [(0.48, False), (0.52, True)])
def test_markers_at_rest_are_not_compared(cover, raises):
    angle = np.linspace(0.0, cover, 20)
    found = {"a": _seen(angle, name="a", body="casing"), "b": _seen(angle + 1.0, name="b")}
    if raises:
        with pytest.raises(TrackingError):
            module._on_other_body(found, "film")
    else:
        assert module._on_other_body(found, "film") == []


def test_a_marker_has_an_eighth_of_the_contrast_of_the_strongest():
    found = {"a": _seen([0.0], contrast=(60.0, 80.0)), "b": _seen([0.0], contrast=(12.1, 0.0))}
    found |= {"c": _seen([0.0], contrast=(0.0, 11.9))}
    assert set(module._strong(found)) == {"a", "b"}
    assert module._strong({}) == {}


@pytest.mark.parametrize(
    ("inner", "outer", "half_width", "sized"),
    [
        (30.0, 34.6, 0.3, True),
        (30.0, 34.4, 0.3, False),
        (30.0, 50.0, 0.79, True),
        (30.0, 50.0, 0.81, False),
        (30.0, 50.0, np.arctan(4.6 / 80.0), True),
        (30.0, 50.0, np.arctan(4.4 / 80.0), False),
    ],
)
def test_a_marker_has_sides_of_four_and_a_half_pixels_and_a_limited_width(inner, outer, half_width, sized):
    marker = _seen([0.0], inner=inner, outer=outer, half_width=half_width).marker
    assert is_marker_sized(marker) == sized


@pytest.mark.parametrize(
    ("centre", "disc", "radius", "inner", "outer", "rows"),
    [
        ((100.0, 80.0), 10.0, 30.0, 13.5, 57.0, 22),
        ((100.0, 80.0), None, 30.0, 9.0, 57.0, 25),
        (
            (100.0, 80.0),
            None,
            90.0,
            27.0,
            80.0,
            27,
        ),  # the farthest horizontal border is at 139 px, the vertical at 80
        ((100.0, 80.0), 60.0, 30.0, 0.8 * 57.0, 57.0, 8),
        ((100.0, 80.0), None, None, 0.3 * 79.0, 80.0, 29),
        ((-5.0, 80.0), None, None, 2.4, 80.0, 39),
        ((230.0, 80.0), None, None, 2.7, 80.0, 39),
        ((100.0, -900.0), None, 300.0, 90.0, 139.0, 25),
    ],
)
def test_the_search_ring_extends_from_the_disc_beyond_the_orbits(centre, disc, radius, inner, outer, rows):
    samples = SimpleNamespace(size=(240, 160))
    found = search_ring(samples, centre, disc and Disc(centre, disc, (9.0, 0.0)), radius)
    assert (found.inner, found.outer) == pytest.approx((inner, outer))
    assert (found.rows, found.columns, found.centre) == (rows, 512, centre)
    assert search_ring(SimpleNamespace(size=(2000, 2000)), (900.0, 900.0), None, 500.0).rows == 96


def _offset_of(monkeypatch, e, angle, noise=0.0, outlier=0.0, use=slice(None)):
    markers = [_seen(np.array(angle)[use]), _seen(np.array(angle)[use] + 0.3)]
    errors = noise * np.where(np.arange(len(markers[0].angle)) % 2, 1.0, -1.0)

    def radii(_, seen):
        rho = 40.0 if seen is markers[0] else 47.0
        r = rho + e[0] * np.cos(seen.angle) - e[1] * np.sin(seen.angle) + errors
        r[0] += outlier
        return r

    monkeypatch.setattr(module, "_radii", radii)
    return orbit_offset(None, markers)


def test_the_offset_of_the_orbits_is_fitted_to_the_radii(monkeypatch):
    angle = np.linspace(0.0, 6.0, 24)
    assert _offset_of(monkeypatch, (3.0, -2.0), angle) == pytest.approx((3.0, -2.0))
    assert _offset_of(monkeypatch, (3.0, -2.0), angle, outlier=9.0) == pytest.approx((3.0, -2.0))
    assert _offset_of(monkeypatch, (0.95, 0.0), angle) is None
    assert _offset_of(monkeypatch, (0.0, 1.05), angle) == pytest.approx((0.0, 1.05))


def test_an_offset_exceeds_three_standard_errors(monkeypatch):
    """With n radii over the turn, the trace of the covariance is 4 s^2 / n."""
    angle = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
    limit = 3.0 * 1.4826 * 4.0 * np.sqrt(4.0 / 64.0)
    assert _offset_of(monkeypatch, (0.95 * limit, 0.0), angle, noise=4.0) is None
    assert _offset_of(monkeypatch, (1.05 * limit, 0.0), angle, noise=4.0) is not None


@pytest.mark.parametrize(
    ("cover", "count", "found"), [(3.65, 20, False), (3.75, 20, True), (5.5, 5, False), (5.5, 6, True)]
)
def test_an_offset_needs_four_radians_and_twelve_radii(cover, count, found, monkeypatch):
    # the two markers are 0.3 rad apart
    assert (_offset_of(monkeypatch, (3.0, -2.0), np.linspace(0.0, cover, count)) is not None) == found


def test_an_offset_needs_markers():
    assert orbit_offset(None, []) is None


@pytest.mark.parametrize("dwell", [0.1, 0.4])
def test_the_radius_of_a_marker_is_the_middle_between_its_edges(dwell):
    angle = TURNING if dwell < 0.3 else np.full(18, 1.3)
    rings = _rings(angle, inner=34, outer=45)
    rings.strips[:, 3, :, :] = np.roll(rings.strips[:, 3, :, :], 2, axis=1)
    rings.strips[:, 4, :, :] = np.roll(rings.strips[:, 4, :, :], -4, axis=1)  # at the inner border
    seen = _seen(np.rint(angle / STEP) * STEP, contrast=(20.0, -30.0), half_width=8 * STEP, dwell=dwell)
    radius = module._radii(rings, seen)
    assert np.isnan(radius[4])
    assert radius[3] == pytest.approx(41.5)
    np.testing.assert_allclose(radius[5:], 39.5)


def test_blobs_keep_their_colour_and_move_to_the_luma_plane():
    samples = SimpleNamespace(to_luma=lambda x, y: (2 * x + 0.5, 2 * y + 0.5))
    blob = lambda x, y: Blob(x, y, 9, 9.0, 1.0)  # noqa: E731
    place, label = places_of(samples, [[[blob(1, 2), blob(3, 4)], []], [[], [blob(5, 6)]]])
    np.testing.assert_array_equal(place, [[2.5, 4.5], [6.5, 8.5], [10.5, 12.5]])
    np.testing.assert_array_equal(label, [0, 0, 1])


@pytest.mark.parametrize(
    ("noise", "peaks", "height", "found"),
    [
        (0.0, 7.0, 5.9, 0),
        (0.0, 7.0, 6.1, 1),
        (5.0, 30.0, 19.9, 0),
        (5.0, 30.0, 20.1, 1),
        (0.0, 100.0, 39.0, 0),
        (0.0, 100.0, 41.0, 1),
    ],
)
def test_blobs_exceed_the_noise_and_a_part_of_the_typical_peak(noise, peaks, height, found):
    scores = [np.full((40, 40), noise, dtype=np.float32) for _ in range(4)]
    for score in scores[:3]:
        score[10:14, 10:14] = peaks
    scores[3][10:14, 10:14] = height
    assert [len(b) for b in module._blobs_in(scores, 2)] == [1, 1, 1, found]


def _disc_samples(level, radius=5, x=50, y=40, ground=128, shape=(80, 100)):
    still = np.full((2, *shape), ground, dtype=np.float32)
    row, column = np.ogrid[: shape[0], : shape[1]]
    still[0][(column - x) ** 2 + (row - y) ** 2 <= radius**2 + 0.1] += level
    return SimpleNamespace(still=still, scale=2, to_luma=lambda x, y: (2 * x + 0.5, 2 * y + 0.5))


@pytest.mark.parametrize(("level", "found"), [(9.8, False), (10.2, True)])
@pytest.mark.parametrize("orbit", [None, Orbit((100.5, 80.5), {0: 60.0}, 20, 6.0)])
def test_a_disc_has_a_score_of_ten_grey_levels(level, found, orbit):
    disc = find_disc(_disc_samples(level), (1.0, 0.0), orbit)
    assert (disc is not None) == found
    if found:
        assert disc.centre == pytest.approx((100.5, 80.5))
        assert disc.radius == pytest.approx(2.0 * np.sqrt(81 / np.pi))  # 81 pixels are within 5 px
        assert disc.chroma == pytest.approx((level, 0.0), rel=1e-4)


@pytest.mark.parametrize(("x", "found"), [(62, True), (65, False)])
def test_a_disc_is_within_0_45_of_the_largest_radius(x, found):
    # 0.45 * 60 px are 13.5 px of the chroma plane
    disc = find_disc(
        _disc_samples(40.0, radius=1, x=x), (1.0, 0.0), Orbit((100.5, 80.5), {0: 60.0, 1: 30.0}, 20, 6.0)
    )
    assert (disc is not None) == found


def test_a_rectangle_is_a_disc_only_at_the_centre_of_an_orbit():
    samples = _disc_samples(0.0)
    samples.still[0][38:43, 45:56] += 40.0  # 5 by 11 px: 55 / (pi / 4 121) = 0.58
    assert find_disc(samples, (1.0, 0.0), None) is None
    assert find_disc(samples, (1.0, 0.0), Orbit((100.5, 80.5), {0: 60.0}, 20, 6.0)) is not None
    square = _disc_samples(0.0)
    square.still[0][38:45, 46:55] += 40.0  # 7 by 9 px: 63 / (pi / 4 81) = 0.99
    assert find_disc(square, (1.0, 0.0), None) is not None


def test_the_roundest_strong_patch_is_the_disc():
    samples = _disc_samples(40.0)
    samples.still[0][5:9, 5:45] += 40.0  # more pixels, but fill = 160 / (pi / 4 1600) = 0.13
    disc = find_disc(samples, (1.0, 0.0), Orbit((100.5, 80.5), {0: 900.0}, 20, 6.0))
    assert disc.centre == pytest.approx((100.5, 80.5))


def test_the_neutral_chroma_is_the_median_near_the_centre():
    samples = _disc_samples(0.0)
    samples.still[0][:, :20] = 150.0
    near = Orbit((10.0, 80.0), {0: 30.0}, 20, 6.0)
    assert module._neutral(samples.still[0], samples, None) == 128.0
    assert module._neutral(samples.still[0], samples, near) == 150.0
    assert module._neutral(samples.still[0], samples, Orbit((-900.0, 80.0), {0: 30.0}, 20, 6.0)) == 128.0


@pytest.mark.parametrize(("scale", "shift"), [(2, 0.5), (4, 1.5)])
def test_pixels_near_the_centre_are_in_luma_pixels(scale, shift):
    samples = SimpleNamespace(scale=scale)
    near = module._near(
        (30, 40), samples, Orbit((scale * 12 + shift, scale * 9 + shift), {0: 30.0, 1: 10.0}, 20, 6.0)
    )
    row, column = np.ogrid[:30, :40]
    np.testing.assert_array_equal(near > 0, np.hypot(column - 12, row - 9) < 13.5 / scale)


@pytest.mark.parametrize(
    ("distance", "inliers", "spread", "refused"),
    [
        (200.0, 30, 6.0, True),
        (200.0, 10, 6.0, False),  # 10 of 20 samples
        (200.0, 11, 6.0, True),
        (200.0, 30, 3.9, False),
        (200.0, 30, 4.1, True),
        (79.0, 30, 6.0, False),  # 60 px and half of 40 px
        (81.0, 30, 6.0, True),
    ],
)
def test_a_second_body_turns_beside_the_outer_orbit(distance, inliers, spread, refused, monkeypatch):
    place = np.array([[100.0, 80.0 + 65.0], [100.0 + 67.0, 80.0], [100.0, 80.0 - 67.0]])
    other = Orbit((100.0, 80.0 + distance), {0: 40.0, 1: 20.0}, inliers, spread)
    given = []
    monkeypatch.setattr(module, "common_centre", lambda *points: given.append(points) or other)
    arguments = ORBIT, place, np.array([0, 1, 2]), 20, "film"
    if refused:
        with pytest.raises(TrackingError, match="Two bodies"):
            module._refuse_second_body(*arguments)
    else:
        module._refuse_second_body(*arguments)
    # only blobs beyond 66 px
    np.testing.assert_array_equal(given[0][0], place[1:])
    np.testing.assert_array_equal(given[0][1], [1, 2])
    monkeypatch.setattr(module, "common_centre", lambda *_: None)
    module._refuse_second_body(*arguments)


def _colour_film(count, shape=(80, 100)):
    """A red blob on a circle of 40 px in the luma plane."""
    chroma = np.full((2, count, *shape), 128, dtype=np.uint8)
    for k in range(count):
        x, y = round(50 + 20 * np.cos(0.5 * k)), round(40 - 20 * np.sin(0.5 * k))
        chroma[0, k, y - 1 : y + 2, x - 1 : x + 2] = 128 - 15
        chroma[1, k, y - 1 : y + 2, x - 1 : x + 2] = 128 + 47
    still = np.median(chroma, axis=1).astype(np.float32)
    return SimpleNamespace(chroma=chroma, still=still, to_luma=lambda x, y: (2 * x + 0.5, 2 * y + 0.5))


RED_ONLY = Profile(marker=(MarkerProfile(name="red", colour="red", body="rotor"),))


@pytest.mark.parametrize("hub", [None, (100.5, 80.5)])
def test_the_orbit_is_that_of_the_blobs_in_the_colours_of_the_profile(hub, monkeypatch):
    monkeypatch.setattr(module, "common_centre", lambda p, g: common_centre(p, g, trials=40))
    orbit = module._find_orbit(_colour_film(12), RED_ONLY.model_copy(update={"hub": hub}), "film")
    np.testing.assert_allclose(orbit.centre, (100.5, 80.5), atol=0.5)
    assert orbit.radii[0] == pytest.approx(40.0, abs=0.5)
    assert orbit.inliers == 12


@pytest.mark.parametrize(("inliers", "found"), [(4, False), (5, True)])
def test_a_third_of_the_blobs_and_samples_agree_with_an_orbit(inliers, found, monkeypatch):
    orbit = Orbit((100.5, 80.5), {0: 40.0}, inliers, 6.0)
    monkeypatch.setattr(module, "common_centre", lambda *_: orbit)
    monkeypatch.setattr(module, "_refuse_second_body", lambda *_: None)
    assert (module._find_orbit(_colour_film(12), RED_ONLY, "film") is not None) == found
    monkeypatch.setattr(module, "common_centre", lambda *_: None)
    assert module._find_orbit(_colour_film(12), RED_ONLY, "film") is None
    green = Profile(marker=(MarkerProfile(name="g", colour="green", body="rotor"),))
    assert module._find_orbit(_colour_film(12), green, "film") is None


def _acquired(monkeypatch, profile, orbit, disc, found):
    asked = []
    monkeypatch.setattr(module, "_find_orbit", lambda *_: orbit)
    monkeypatch.setattr(module, "find_disc", lambda *_: disc)

    def find_markers(_, __, centre, disc, radius, ___):
        asked.append((centre, disc, radius))
        return found, {}, ()

    monkeypatch.setattr(module, "find_markers", find_markers)
    return acquire(None, profile, "film"), asked


def test_the_scene_has_its_centre_at_the_disc_or_at_the_orbit(monkeypatch):
    disc = Disc((102.0, 81.0), 5.0, (9.0, 0.0))
    red = {"red": _seen([0.0]).marker}
    scene, asked = _acquired(monkeypatch, PAPER, ORBIT, disc, red)
    assert (scene.centre, scene.disc, asked) == ((102.0, 81.0), disc, [((102.0, 81.0), disc, 60.0)])
    assert scene.missing == ("blue", "white", "green")
    assert scene.warnings == ()
    assert scene.body_of == {"red": "casing", "blue": "rotor", "white": "rotor", "green": "rotor"}
    scene, asked = _acquired(monkeypatch, PAPER, ORBIT, None, red)
    assert (scene.centre, len(scene.warnings)) == ((100.0, 80.0), 1)
    scene, asked = _acquired(monkeypatch, PAPER, None, disc, red)
    assert asked == [((102.0, 81.0), disc, None)]
    for change in ({"centre": "orbit"}, {"hub": (1.0, 2.0)}):
        scene, asked = _acquired(monkeypatch, PAPER.model_copy(update=change), ORBIT, disc, red)
        assert (scene.centre, scene.disc, scene.warnings) == ((100.0, 80.0), None, ())
    with pytest.raises(TrackingError):
        _acquired(monkeypatch, PAPER, None, None, red)
    with pytest.raises(TrackingError):
        _acquired(monkeypatch, PAPER, ORBIT, disc, {})


def _marker_samples():
    """Strips about the given centre: a red casing marker and a blue rotor marker; the picture is not used."""
    red = _rings(0.4 + 0.1 * np.arange(18) * 3.7, shade=(-15, 47)).strips.astype(int)
    blue = _rings(TURNING + 2.0, shade=(40, -20)).strips
    strips = np.where(blue != 128, blue, red).astype(np.uint8)
    luma = np.full((18, 21, 256), 60, dtype=np.uint8)
    return SimpleNamespace(
        spread=range(18),
        size=(300, 300),
        strips=lambda ring, frames: strips,
        luma_strips=lambda ring, frames: luma,
    )


def test_the_markers_of_each_body_are_found_with_their_offsets(monkeypatch):
    monkeypatch.setattr(module, "search_ring", lambda *_: RING)
    moves = iter([(2.0, -1.0), (0.5, 0.25), None])
    monkeypatch.setattr(module, "orbit_offset", lambda *_: next(moves))
    markers, offsets, doubts = module.find_markers(
        _marker_samples(), PAPER, (100.0, 80.0), None, 40.0, "film"
    )
    assert list(markers) == ["red", "blue"]
    assert offsets == {"casing": (2.5, -0.75)}
    assert doubts == ()
    assert markers["red"].contrast == pytest.approx((-15.0, 47.0))
    assert markers["blue"].contrast == pytest.approx((40.0, -20.0))


@pytest.mark.parametrize(
    ("noise", "outlier", "kept"),
    [
        (0.4, 2.8, True),
        (0.4, 3.2, False),
        (0.4, -2.8, True),
        (0.4, -3.2, False),
        (0.0, 2.8, True),  # of the least scatter, 0.2 px
        (0.0, 3.2, False),
    ],
)
def test_outliers_of_radii_are_beyond_three_standard_deviations(monkeypatch, noise, outlier, kept):
    """The residuals of 80 radii have the median absolute value of the noise; one is displaced."""
    angle = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    errors = noise * np.where(np.arange(40) // 2 % 2, 1.0, -1.0)
    scatter = max(1.4826 * noise, 0.2)
    radii = [r + 3.0 * np.cos(angle) + 2.0 * np.sin(angle) + errors for r in (40.0, 47.0)]
    radii[0][7] = 40.0 + 3.0 * np.cos(angle[7]) + 2.0 * np.sin(angle[7]) + 1.07 * outlier * scatter
    markers = [_seen(angle.copy()), _seen(angle.copy())]
    monkeypatch.setattr(module, "_radii", lambda _, seen: radii[0] if seen is markers[0] else radii[1])
    rows = np.zeros((80, 4))
    rows[:, 0], rows[:, 1] = np.tile(np.cos(angle), 2), np.tile(np.sin(angle), 2)
    rows[:40, 2] = rows[40:, 3] = 1.0
    use = np.ones(80, bool)
    use[7] = kept
    x, y, *_ = np.linalg.lstsq(rows[use], np.concatenate(radii)[use], rcond=None)[0]
    assert orbit_offset(None, markers) == pytest.approx((x, -y), abs=1e-9)
