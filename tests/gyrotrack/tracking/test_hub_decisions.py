"""Formulas and limits of the path of the centre of rotation, and of the candidates for a hub."""

import math
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from gyrotrack.tracking import _hub as module
from gyrotrack.tracking import _hub_search as search
from gyrotrack.tracking._hub import (
    CentrePath,
    DiscWindow,
    Radii,
    fast_motion,
    refine_centre,
    wandering_centre,
)
from gyrotrack.tracking._hub_search import Motion, distance_from, fit_circle, orbit_hub, ring_for, similarity
from gyrotrack.tracking._registration import TURN
from gyrotrack.tracking._scene import Disc


@pytest.mark.parametrize(("radius", "half"), [(10.0, 11), (10.6, 11), (10.7, 12)])
def test_the_window_of_a_disc_is_wider_than_the_disc(radius, half):
    assert DiscWindow(Disc((0.0, 0.0), radius, (9.0, 0.0)), 4).half == half


@pytest.mark.parametrize("place", [(80.0, 60.5), (14.0, 12.5), (140.0, 100.5), (80.6, 61.3)])
def test_the_centre_of_a_disc_is_measured_in_luma_pixels(place):
    """Pixels of the chroma are means over squares; its first sample is at (0, 0.5) px of the luma."""
    window = DiscWindow(Disc(place, 10.0, (30.0, -20.0)), 3)
    y, x = np.mgrid[0:60, 0:80]
    away = np.hypot(2.0 * x - place[0], 2.0 * y + 0.5 - place[1])
    share = np.clip(0.5 * (11.0 - away), 0.0, 1.0)
    frame = SimpleNamespace(
        u=np.rint(128 + 30.0 * share).astype(np.uint8), v=np.rint(128 - 20.0 * share).astype(np.uint8)
    )
    window.centre_on((place[0] + 3.0, place[1] - 2.0), frame)
    window.take([frame, frame], 1)
    np.testing.assert_allclose(window.centres(3, 1), [place] * 2, atol=0.06)


def _line(n, slope=2.0):
    return slope * np.arange(n) * (1.0 - 0.5j)


def test_a_path_is_linear_in_a_gap_and_uncertain_by_its_change():
    known = np.ones(40, dtype=bool)
    known[10:15] = known[:3] = False
    found = module._bridged(_line(40), known, 0.3, 24)
    np.testing.assert_allclose(found.centre[3:, 0], 2.0 * np.arange(3, 40))
    np.testing.assert_allclose(found.centre[:3], [[6.0, -3.0]] * 3)
    # rms per axis of a change by (2, -1) px per frame, to the nearest known frame
    step = math.sqrt(0.5 * 5.0)
    np.testing.assert_allclose(found.sigma[10:15], np.hypot(0.3, step * np.array([1, 2, 3, 2, 1])))
    np.testing.assert_allclose(found.sigma[:3], np.hypot(0.3, step * np.array([3, 2, 1])))
    np.testing.assert_allclose(found.sigma[15:], 0.3)
    assert found.reach == 24
    far = module._bridged(_line(40), known, 0.3, 2)
    np.testing.assert_array_equal(np.isnan(far.sigma), np.isin(np.arange(40), [0, 12]))


def test_a_path_beyond_its_last_known_point_is_constant():
    known = np.arange(30) < 20
    found = module._bridged(_line(30), known, 0.3, 5)
    np.testing.assert_allclose(found.centre[20:, 0], 38.0)
    np.testing.assert_array_equal(np.isnan(found.sigma), np.arange(30) >= 25)


@pytest.mark.parametrize(("step", "kept"), [(5.95, True), (6.15, False)])
def test_a_disc_beside_a_gap_jumps_by_six_times_the_typical_step(step, kept):
    measured = np.stack([1.0 * np.arange(30), np.zeros(30)], axis=1)
    measured[10:14] = np.nan
    measured[14, 1] += math.sqrt(step**2 - 1.0)  # the last step before and the first one after the gap
    measured[9, 1] -= math.sqrt(step**2 - 1.0)
    known = np.isfinite(measured).all(axis=1)
    found = module._without_partial_views(measured, known)
    expected = known.copy()
    expected[[9, 14]] = kept
    np.testing.assert_array_equal(found, expected)


def test_a_short_clip_has_the_mean_as_its_path():
    rng = np.random.default_rng(0)
    measured = np.array([50.0, 60.0]) + rng.normal(0.0, 0.4, (71, 2))
    found = module.smooth_path(measured)
    np.testing.assert_allclose(found.centre, np.tile(measured.mean(axis=0), (71, 1)))
    scatter = math.sqrt(0.5 * np.var(measured, axis=0).sum())
    np.testing.assert_allclose(found.sigma, scatter)
    assert found.reach == 71
    still = module.smooth_path(np.tile([50.0, 60.0], (20, 1)))
    np.testing.assert_allclose(still.sigma, 0.05)
    assert module.smooth_path(np.concatenate([measured, measured[:1]])).reach == 24


def test_a_parabola_is_followed_over_windows_of_each_width():
    k = np.arange(120.0)
    exact = np.stack([50.0 + 0.1 * k + 1e-3 * k**2, 60.0 - 0.05 * k], axis=1)
    paths = module.marked_paths(exact)
    assert [path.reach for path in paths[1:]] == [2, 6, 12, 0]
    assert paths[0].reach in (24, 48)  # a third of the film is the widest
    for path in paths:
        np.testing.assert_allclose(path.centre, exact, atol=1e-3)
    np.testing.assert_allclose(paths[-1].sigma, 0.1)


@pytest.mark.parametrize(("known", "count"), [(47, 1), (48, 5)])
def test_forty_eight_positions_have_alternatives(known, count):
    measured = np.random.default_rng(0).normal(0.0, 1.0, (60, 2))
    measured[known:] = np.nan
    assert len(module.marked_paths(measured)) == count


def test_white_noise_is_averaged_over_the_window():
    left = np.random.default_rng(1).normal(0.0, 2.0, (4000, 2)) @ np.array([1.0, 1j])
    assert module._path_sigma(left, 24) == pytest.approx(2.0 / math.sqrt(1.1 * 24), rel=0.05)
    assert module._path_sigma(1e-3 * left, 24) == 0.05


def test_correlated_noise_is_averaged_less():
    rng = np.random.default_rng(1)
    left = rng.normal(0.0, 2.0, (20000, 2)) @ np.array([1.0, 1j])
    for k in range(1, len(left)):
        left[k] = 0.8 * left[k - 1] + 0.6 * left[k]
    # correlations 0.8^k above 0.1: k up to 10
    length = 1.0 + 2.0 * sum(0.8**k for k in range(1, 11))
    assert module._path_sigma(left, 24) == pytest.approx(2.0 * math.sqrt(length / (1.1 * 24)), rel=0.06)
    assert module._path_sigma(left, 2) == pytest.approx(2.0, rel=0.05)


def test_the_prediction_error_is_trimmed():
    z = np.zeros(200, dtype=complex)
    z[::40] = 9.0
    assert module._prediction_error(z, np.ones(200), 24) < 1.0
    z = np.random.default_rng(0).normal(0.0, 1.0, (1000, 2)) @ np.array([1.0, 1j])
    # the mean of the smallest 95 % of an exponential variable is 1 + 0.05 ln(0.05) / 0.95 = 0.84
    assert module._prediction_error(z, np.ones(1000), 96) == pytest.approx(2.0 * 0.84, rel=0.12)


@pytest.mark.parametrize("count", [95, 96, 500, 1500])
def test_spectral_lines_are_kept_and_noise_is_not(count):
    rng = np.random.default_rng(0)
    k = np.arange(count)
    line = 3.0 * np.exp(1j * (2.0 * np.pi * k / 8.0 + 0.4))
    noise = rng.normal(0.0, 0.2, (count, 2)) @ np.array([1.0, 1j])
    found = module._lines(line + noise)
    if count < 96:
        np.testing.assert_array_equal(found, 0.0)
        return
    inner = slice(count // 4, -count // 4)
    assert np.abs(found - line)[inner].max() < 0.4
    assert np.sqrt(np.mean(np.abs(module._lines(noise)[inner]) ** 2)) < 0.4 * 0.2 * math.sqrt(2.0)


def test_the_floor_of_a_spectrum_is_a_running_median():
    power = np.ones(64)
    power[20:28] = 50.0
    np.testing.assert_allclose(module._floor(power), 1.0 / math.log(2.0))
    power[20:29] = 50.0
    assert module._floor(power)[24] == pytest.approx(50.0 / math.log(2.0))
    assert module._floor(np.arange(64.0))[0] == pytest.approx(8.0 / math.log(2.0), abs=1.0)


def test_the_rms_of_vectors_is_that_of_a_normal_distribution():
    assert module.robust_rms(np.array([[3.0, 4.0]] * 3 + [[90.0, 0.0]])) == pytest.approx(
        5.0 / math.sqrt(math.log(2.0))
    )


@pytest.mark.parametrize(
    ("reach", "steps", "rest", "warned"),
    [
        (6, 0.51, 0.0, "followed"),
        (6, 0.49, 0.0, None),
        (24, 0.9, 0.0, None),
        (24, 0.0, 0.51, "no background"),
        (24, 0.0, 0.49, None),
        (0, 0.51, 0.9, "followed"),
    ],
)
def test_a_disc_that_moves_fast_suggests_camera_shake(reach, steps, rest, warned):
    unit = math.sqrt(math.log(2.0))  # equal lengths have the median of their squares
    centre = np.stack([steps * unit * (np.arange(20) % 2), np.zeros(20)], axis=1)
    measured = centre + np.array([0.0, rest * unit])
    found = fast_motion(CentrePath(centre, np.full(20, 0.1), reach), measured)
    assert (warned is None and found is None) or warned in found
    assert fast_motion(CentrePath(centre, np.full(20, np.nan), reach), measured) is None


@pytest.mark.parametrize(("turns", "knots"), [(2.9, 1), (3.1, 3), (7.9, 7), (500.0, 400)])
def test_a_path_has_a_knot_for_each_turn(turns, knots):
    angle = np.linspace(0.0, turns * TURN, 4000)
    v = 50.0 * np.stack([np.cos(angle), -np.sin(angle)], axis=1)
    assert module._knots(v, np.ones(4000, dtype=bool)) == knots


@pytest.mark.parametrize(("n", "knots"), [(50, 4), (31, 3), (7, 1), (11, 11)])
def test_a_path_between_knots_is_linear(n, knots):
    values = np.random.default_rng(0).normal(0.0, 1.0, (knots, 2))
    path = np.full((n, 2), np.nan)
    for part, ends, share in module._spans(n, knots):
        path[part] = module._between(values, ends, share)
    at = np.linspace(0.0, n - 1.0, knots) if knots > 1 else [0.0]
    expected = np.stack([np.interp(np.arange(n), at, values[:, k]) for k in (0, 1)], axis=1)
    np.testing.assert_allclose(path, expected, atol=1e-12)


def _marker(count, turns, drift, p=0.0, q=0.0, noise=0.0):
    theta = np.linspace(0.3, 0.3 + turns * TURN, count)
    share = np.linspace(0.0, 1.0, count)[:, None]
    centre = np.array([100.0, 80.0]) + share * drift
    radius = 50.0 * (1.0 + p * np.cos(2 * theta) + q * np.sin(2 * theta))
    radius += np.random.default_rng(0).normal(0.0, noise, count)
    return centre + radius[:, None] * np.stack([np.cos(theta), -np.sin(theta)], axis=1), centre


@pytest.mark.parametrize("still", [False, True])
def test_a_wandering_centre_is_found_from_the_places_of_a_marker(still):
    place, centre = _marker(240, 5.0, (0.0, 0.0) if still else (6.0, -4.0), 0.01, -0.02)
    place[::30] += 9.0
    found = wandering_centre(place, np.ones(240, dtype=bool), np.array([101.5, 79.0]), still=still)
    np.testing.assert_allclose(found.centre, centre, atol=0.05)
    assert found.sigma[0] < 0.1
    assert found.reach == (240 if still else 240 // 4)


def test_the_uncertainty_of_a_wandering_centre_is_the_scatter_of_the_radius():
    place, _ = _marker(400, 5.0, (0.0, 0.0), noise=0.3)
    found = wandering_centre(place, np.ones(400, dtype=bool), np.array([100.0, 80.0]), still=True, rounds=4)
    np.testing.assert_allclose(found.sigma, 0.3, rtol=0.1)
    place, _ = _marker(400, 5.0, (0.0, 0.0))
    found = wandering_centre(place, np.ones(400, dtype=bool), np.array([100.0, 80.0]), still=True, rounds=4)
    np.testing.assert_allclose(found.sigma, 1e-3)


@pytest.mark.parametrize(("count", "known"), [(11, False), (12, True)])
def test_twelve_places_determine_a_centre(count, known):
    place, _ = _marker(30, 2.0, (0.0, 0.0))
    use = np.zeros(30, dtype=bool)
    use[:: 30 // 12][:count] = True
    found = wandering_centre(place, use, np.array([101.0, 80.0]), still=True)
    assert np.isfinite(found.sigma).all() == known


def _radii(count, n, scatter, noise=0.0):
    theta = 0.7 * np.arange(count)
    excess = -(n[0] * np.cos(theta) - n[1] * np.sin(theta))
    return Radii(theta, excess + scatter * np.where(np.arange(count) % 2, 1.0, -1.0))


def test_a_centre_is_corrected_by_the_radii_within_its_prior():
    n, scatter, count = np.array([0.02, -0.03]), 0.4, 400
    path = CentrePath(np.tile([100.0, 80.0], (count, 1)), np.full(count, 0.2), 24)
    marker = _radii(count, n, scatter)
    found = refine_centre(path, [marker])
    s = 1.4826 * np.median(np.abs(marker.excess))
    bell = 1.0 - (np.arange(-18, 19) / 19.0) ** 2
    information = 0.5 * bell.sum() / s**2  # of each axis, over many directions
    gain = information / (information + 100.0)
    inner = slice(40, -40)
    np.testing.assert_allclose(found.centre[inner], path.centre[inner] - gain * n, atol=0.25 * gain * 0.036)
    np.testing.assert_allclose(
        found.sigma[inner], math.hypot(1.0 / math.sqrt(information + 100.0), 0.02), rtol=0.05
    )
    assert found.reach == 24
    both = refine_centre(path, [marker, marker])
    np.testing.assert_allclose(
        both.sigma[inner], math.hypot(1.0 / math.sqrt(2 * information + 100.0), 0.02), rtol=0.05
    )


def test_precise_radii_have_a_least_scatter():
    count = 200
    path = CentrePath(np.tile([100.0, 80.0], (count, 1)), np.full(count, 0.2), 24)
    found = refine_centre(path, [_radii(count, (0.0, 0.0), 0.0)])
    information = 0.5 * (1.0 - (np.arange(-18, 19) / 19.0) ** 2).sum() / 0.02**2
    np.testing.assert_allclose(
        found.sigma[60:-60], math.hypot(1.0 / math.sqrt(information + 100.0), 0.02), rtol=0.02
    )


def test_a_correction_does_not_increase_the_uncertainty():
    path = CentrePath(np.tile([100.0, 80.0], (60, 1)), np.full(60, 0.01), 24)
    path.sigma[7] = np.nan
    found = refine_centre(path, [_radii(60, (0.1, 0.0), 0.4)])
    np.testing.assert_array_equal(found.sigma, path.sigma)
    np.testing.assert_array_equal(refine_centre(path, []).centre, path.centre)


@pytest.mark.parametrize(("known", "used"), [(19, False), (20, True)])
def test_twenty_radii_of_a_marker_are_used(known, used):
    path = CentrePath(np.tile([100.0, 80.0], (60, 1)), np.full(60, 0.2), 24)
    marker = _radii(60, (0.05, 0.0), 0.1)
    marker.excess[known:] = np.nan
    assert (refine_centre(path, [marker]).centre[5] != path.centre[5]).any() == used


def test_outliers_of_radii_are_clipped_at_four_sigma():
    excess = np.tile([1.0, -1.0], 10)
    assert module._limits(excess) == pytest.approx((-4 * 1.4826, 4 * 1.4826))


def test_the_noise_of_a_frame_is_found_without_its_content():
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:100, 0:120]
    frames = [
        np.clip(np.rint(60 + 0.5 * x + 0.3 * y + rng.normal(0, 5.0, x.shape)), 0, 255).astype(np.uint8)
    ] * 3
    assert search.spatial_noise(frames) == pytest.approx(5.0, rel=0.05)


def _motion(moving):
    still = np.zeros(moving.shape, np.float32)
    return Motion(still, still, 1.0, moving, (0, 0, moving.shape[1], moving.shape[0]))


@pytest.mark.parametrize(
    ("inner", "outer", "ring"), [(0, 30, (3.0, 32.0)), (20, 30, (17.0, 32.0)), (0, 60, (3.72, 62.0))]
)
def test_a_ring_contains_the_moving_radii_about_a_hub(inner, outer, ring):
    away = distance_from((100.0, 80.0), (160, 200))
    found = ring_for((100.0, 80.0), _motion((away >= inner) & (away < outer)), 48.0)
    assert (found.inner, found.outer) == pytest.approx(ring)
    assert (found.start, found.span, found.hub) == (0.0, TURN, (100.0, 80.0))


def test_narrow_or_absent_motion_has_no_ring():
    away = distance_from((100.0, 80.0), (160, 200))
    assert ring_for((100.0, 80.0), _motion(away < 0), 48.0) is None
    assert ring_for((100.0, 80.0), _motion(away < 4), 48.0) is None


def test_the_ring_about_a_hub_outside_the_picture_is_an_arc():
    hub = (100.0, -60.0)
    away = distance_from(hub, (160, 200))
    y, x = np.mgrid[0:160, 0:200]
    direction = np.arctan2(y - hub[1], x - hub[0])
    moving = (away > 100) & (away < 140) & (np.abs(direction - 0.5 * np.pi - 0.1) < 0.2)
    found = ring_for(hub, _motion(moving), 48.0)
    assert (found.inner, found.outer) == pytest.approx((97.0, 142.0), abs=1.1)
    # 0.4 rad, and 0.6 of it on either side
    assert found.span == pytest.approx(2.2 * 0.4, rel=0.03)
    assert found.start == pytest.approx(0.5 * np.pi + 0.1 - 0.2 - 0.24, abs=0.02)


def test_circles_about_a_tilted_axis_are_ellipses():
    p, q = 0.2, -0.1
    found = distance_from((30.5, 20.25), (40, 60), (p, q))
    y, x = np.mgrid[0:40, 0:60]
    back = np.linalg.inv(np.array([[1 + p, q], [q, 1 - p]]))
    u, v = np.tensordot(back, np.stack([x - 30.5, y - 20.25]), axes=1)
    np.testing.assert_allclose(found, np.hypot(u, v), rtol=1e-5)


def test_hubs_are_proposed_by_each_method_if_they_are_new(monkeypatch):
    monkeypatch.setattr(
        search, "similarity_hubs", lambda *_: ((100.0, 100.0), (103.9, 100.0))
    )  # 0.4 % are 4 px
    monkeypatch.setattr(search, "edge_hub", lambda *_: (100.0, 104.1))
    monkeypatch.setattr(search, "orbit_hub", lambda *_: (500.0 + 6.05e3, 300.0))  # six pictures are 6000 px
    monkeypatch.setattr(search, "_middle", lambda *_: (500.0 + 5.95e3, 300.0))
    found = search.propose_hubs([], _motion(np.zeros((600, 1000), bool)))
    assert [p.way for p in found] == ["features", "edges", "middle of the moving area"]
    monkeypatch.setattr(search, "similarity_hubs", lambda *_: (None, (float("nan"), 1.0)))
    assert [p.way for p in search.propose_hubs([], _motion(np.zeros((600, 1000), bool)))] == [
        "edges",
        "middle of the moving area",
    ]


def test_the_orbit_of_a_spot_has_a_centre():
    frames = []
    for k in range(14):
        frame = np.full((80, 100), 60, dtype=np.uint8)
        x, y = round(50 + 22 * math.cos(0.5 * k)), round(40 + 22 * math.sin(0.5 * k))
        frame[y - 1 : y + 2, x - 1 : x + 2] = 200
        frames.append(frame)
    mean = np.full((80, 100), 60, np.float32)
    deviation = np.full((80, 100), 1.0, np.float32)
    motion = Motion(mean, deviation, 1.0, deviation > 9, (0, 0, 100, 80))
    assert orbit_hub(frames, motion) == pytest.approx((50.0, 40.0), abs=0.3)


@pytest.mark.parametrize(
    ("count", "radius", "stray", "found"),
    [(7, 20.0, 0, False), (8, 20.0, 0, True), (9, 1.3, 0, False), (12, 20.0, 20, False)],
)
def test_a_circle_has_eight_points_and_two_fifths_of_all(count, radius, stray, found):
    angle = np.linspace(0.0, 5.5, count)
    rng = np.random.default_rng(0)
    x = np.concatenate([50 + radius * np.cos(angle), rng.uniform(0, 900, stray)])
    y = np.concatenate([40 + radius * np.sin(angle), rng.uniform(0, 900, stray)])
    centre = fit_circle(x, y)
    assert (centre is not None) == found
    if found:
        assert centre == pytest.approx((50.0, 40.0), abs=1e-6)


def _pairs(hub, angles, centroids):
    a = np.exp(1j * np.array(angles))
    return [(complex(t), complex((1 - t) * hub), complex(c)) for t, c in zip(a, centroids, strict=True)]


def test_similarities_have_a_common_hub():
    hub = 70.0 + 40.0j
    pairs = _pairs(hub, [0.1, 0.2, -0.15, 0.3, 0.12], [80 + 40j, 70 + 60j, 75 + 45j, 60 + 30j, 71 + 44j])
    pairs[2] = (pairs[2][0], pairs[2][1] + 3.0, pairs[2][2])
    found = search._CommonHub.of([None, *pairs])
    assert found.hub == pytest.approx(hub, abs=0.02)
    assert found.unexplained < 0.01
    np.testing.assert_allclose(found.left[0], 1.0 - np.exp(0.1j))
    # the centroid c moves by (a - 1)(c - h)
    np.testing.assert_allclose(found.shift[1], (np.exp(0.2j) - 1.0) * (70 + 60j - hub))
    np.testing.assert_allclose(found.centroid, [p[2] for p in pairs])
    assert search._CommonHub.of(pairs[:3]) is None
    assert search._CommonHub.of(pairs[:4]) is not None


def test_small_rotations_do_not_determine_the_hub():
    pairs = _pairs(70.0 + 40.0j, [0.2, 0.2, 0.2, 0.09], [80 + 40j] * 4)
    pairs[3] = (pairs[3][0], pairs[3][1] + 500.0, pairs[3][2])  # below half of the median
    assert search._CommonHub.of(pairs).hub == pytest.approx(70.0 + 40.0j, abs=1e-6)


def _texture():
    rng = np.random.default_rng(0)
    picture = cv2.GaussianBlur(rng.normal(0.0, 1.0, (110, 130)), (0, 0), 2.0)
    return cv2.normalize(picture, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


@pytest.mark.parametrize(
    ("degrees", "scale", "found"),
    [(4.0, 1.0, True), (-4.0, 1.02, True), (4.0, 1.045, False), (4.0, 0.96, False), (0.0, 1.0, False)],
)
def test_a_similarity_is_a_rotation_between_two_frames(degrees, scale, found):
    picture = _texture()
    mask = np.ones(picture.shape, np.uint8)
    matrix = cv2.getRotationMatrix2D((60.0, 50.0), -degrees, scale)  # from x to y
    result = similarity(
        picture, cv2.warpAffine(picture, matrix, (130, 110), borderMode=cv2.BORDER_REFLECT), mask
    )
    assert (result is not None) == found
    if found:
        a, b, _ = result
        assert abs(a) == pytest.approx(1.0)
        assert np.angle(a) == pytest.approx(math.radians(degrees), abs=2e-3)
        if scale == 1.0:
            assert b / (1.0 - a) == pytest.approx(60.0 + 50.0j, abs=1.0)


def test_the_point_that_moves_least_is_the_hub():
    turn = np.exp(1j * np.linspace(0.0, 2.0, 30))
    place = search.still_point(turn, (70.0 + 40.0j) * (1.0 - turn) + 3.0)
    # a constant displacement of all frames does not matter
    assert place == pytest.approx((70.0, 40.0))


@pytest.mark.parametrize(("count", "known"), [(50, False), (51, True)])
def test_the_middle_of_the_moving_area_is_its_median(count, known):
    moving = np.zeros((20, 200), dtype=bool)
    moving[7, 10 : 10 + count] = True
    assert search._middle(_motion(moving)) == ((35.0, 7.0) if known else None)


@pytest.mark.parametrize(("ratio", "proposed"), [(0.24, False), (0.27, True), (0.94, True), (0.96, False)])
def test_an_ellipse_of_the_moving_area_shows_a_tilt(ratio, proposed):
    y, x = np.mgrid[0:240, 0:320]
    u, v = x - 160.0, y - 120.0
    along, across = 0.8 * u + 0.6 * v, 0.8 * v - 0.6 * u
    found = search.tilted_outline(_motion(np.hypot(along / 100.0, across / (100.0 * ratio)) < 1.0))
    assert (found is not None) == proposed
    if proposed:
        size = (1.0 - ratio) / (1.0 + ratio)
        # the long axis has the direction (0.8, 0.6): twice its angle has (0.28, 0.96)
        assert found.stretch == pytest.approx((0.28 * size, 0.96 * size), abs=0.01)
        assert found.hub == pytest.approx((160.0, 120.0), abs=0.5)


def test_a_correction_is_the_fit_of_the_radii_in_a_window_about_each_frame():
    """Computed frame by frame: weights 1 - (k / 19)^2, outliers limited to four standard deviations, and the prior."""
    rng = np.random.default_rng(0)
    count = 70
    frame = np.arange(count)
    markers = []
    for noise, first in ((0.3, 0.0), (0.6, 2.0)):
        excess = noise * rng.standard_normal(count)
        excess[11] += 5.0
        excess[40:43] = np.nan
        markers.append(Radii(first + 0.2 * frame, excess))
    before = CentrePath(np.tile([100.0, 50.0], (count, 1)) + 0.1 * frame[:, None], np.full(count, 0.09), 7)
    before.sigma[5], before.sigma[60] = np.nan, 0.03
    found = refine_centre(before, markers)
    centre, sigma = np.empty((count, 2)), np.empty(count)
    for t in frame:
        normal, right = np.eye(2) / 0.1**2, np.zeros(2)
        for one in markers:
            known = np.isfinite(one.excess)
            scatter = 1.4826 * np.median(np.abs(one.excess[known]))
            for k in frame[known & (np.abs(frame - t) <= 18)]:
                outwards = np.array([np.cos(one.direction[k]), -np.sin(one.direction[k])])
                weight = (1.0 - ((k - t) / 19.0) ** 2) / scatter**2
                normal += weight * np.outer(outwards, outwards)
                right -= weight * np.clip(one.excess[k], -4 * scatter, 4 * scatter) * outwards
        centre[t] = before.centre[t] - np.linalg.solve(normal, right)
        sigma[t] = min(np.hypot(np.sqrt(0.5 * np.trace(np.linalg.inv(normal))), 0.4 * 0.05), before.sigma[t])
    np.testing.assert_allclose(found.centre, centre, atol=1e-6)
    np.testing.assert_allclose(np.delete(found.sigma, 5), np.delete(sigma, 5), rtol=1e-6)
    assert np.isnan(found.sigma[5])
    assert found.reach == 7


def test_a_wandering_centre_has_the_knots_of_its_linear_model():
    """Displacements that are linear between knots a turn apart, and a flattening, are found again."""
    count, turns = 400, 8.5
    theta = np.linspace(0.0, turns * TURN, count)
    knots = np.random.default_rng(2).normal(0.0, 0.4, (8, 2))
    at = np.linspace(0, count - 1, 8)
    path = np.stack([np.interp(np.arange(count), at, k) for k in knots.T], axis=1) + np.array([100.0, 80.0])
    radius = 50.0 * (1.0 + 0.004 * np.cos(2 * theta) - 0.003 * np.sin(2 * theta))
    place = path + radius[:, None] * np.stack([np.cos(theta), -np.sin(theta)], axis=1)
    found = wandering_centre(place, np.ones(count, bool), np.array([100.5, 79.5]))
    assert np.abs(found.centre - path).max() < 0.02
    assert found.reach == 400 // 7
    still = wandering_centre(place, np.ones(count, bool), np.array([100.5, 79.5]), still=True)
    assert np.ptp(still.centre, axis=0).max() == 0.0
    assert still.sigma[0] > 10 * found.sigma[0]
    assert still.reach == 400
