"""Thresholds and closed formulas of circles and ellipses through markers."""

from itertools import permutations

import numpy as np
import pytest

from gyrotrack.tracking import _orbit
from gyrotrack.tracking._orbit import (
    NO_FLATTENING,
    Flattening,
    circumcentre,
    common_centre,
    covered_angle,
    fit_common_offset,
    fit_flattening,
    flattening_of_arc,
    higher_harmonics,
    mixture,
    orbits_about,
)

CENTRE = np.array([100.0, 80.0])


def _at(radius, angle):
    """Pixels at an angle that is counter-clockwise as seen."""
    return CENTRE + np.reshape(radius, (-1, 1)) * np.stack([np.cos(angle), -np.sin(angle)], axis=-1)


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_three_points_determine_a_circle_if_their_longest_side_is_four_pixels(order):
    shape = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.3]])[list(order)]
    assert circumcentre(3.9 * shape) is None
    # equal distances: 0.25 + y^2 = (0.3 - y)^2
    y = (0.09 - 0.25) / 0.6
    np.testing.assert_allclose(circumcentre(4.1 * shape), [4.1 * 0.5, 4.1 * y])


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_three_points_determine_a_circle_if_their_height_is_a_twentieth_of_the_longest_side(order):
    for height, found in ((0.45, False), (0.55, True), (-0.45, False), (-0.55, True)):
        triple = np.array([[0.0, 0.0], [10.0, 0.0], [5.0, height]])[list(order)]
        centre = circumcentre(triple)
        assert (centre is not None) == found
        if found:
            np.testing.assert_allclose(centre, [5.0, (height**2 - 25.0) / (2.0 * height)], rtol=1e-9)


@pytest.mark.parametrize(("count", "found"), [(4, False), (5, True)])
def test_five_blobs_determine_a_common_centre(count, found):
    orbit = common_centre(_at(50.0, 0.1 + np.arange(count) * 1.2), np.zeros(count, dtype=int), trials=60)
    assert (orbit is not None) == found
    if found:
        np.testing.assert_allclose(orbit.centre, CENTRE, atol=1e-6)
        assert orbit.radii == pytest.approx({0: 50.0})
        assert orbit.inliers == 5
        assert orbit.spread == pytest.approx(4.8)


@pytest.mark.parametrize(("count", "found"), [(4, False), (5, True)])
def test_five_directions_determine_a_common_centre(count, found):
    angle = np.repeat(0.1 + np.arange(count) * 1.2, 6)
    orbit = common_centre(_at(50.0, angle), np.zeros(len(angle), dtype=int), trials=60)
    assert (orbit is not None) == found


@pytest.mark.parametrize(("cover", "found"), [(1.4, False), (1.6, True)])
def test_a_common_centre_needs_inliers_over_a_quarter_of_a_turn(cover, found):
    orbit = common_centre(_at(90.0, np.linspace(0.3, 0.3 + cover, 40)), np.zeros(40, dtype=int), trials=60)
    assert (orbit is not None) == found


@pytest.mark.parametrize(("count", "found"), [(4, False), (5, True)])
def test_a_known_hub_needs_five_inliers(count, found):
    points = _at(np.linspace(49.5, 50.3, count), np.linspace(2.0, 3.0, count))
    orbit = orbits_about(points, np.zeros(count, dtype=int), (100.0, 80.0))
    assert (orbit is not None) == found
    if found:
        assert orbit.radii == pytest.approx({0: np.median(np.linspace(49.5, 50.3, count))})
        assert (orbit.inliers, orbit.spread) == (5, pytest.approx(1.0))


def test_no_points_have_no_orbit_about_a_hub():
    assert orbits_about(np.zeros((0, 2)), np.zeros(0, dtype=int), (100.0, 80.0)) is None


@pytest.mark.parametrize(
    ("radius", "off", "inlier"),
    [
        (20.0, 1.4, True),
        (20.0, 1.6, False),
        (20.0, -1.4, True),
        (20.0, -1.6, False),
        (80.0, 3.9, True),
        (80.0, 4.1, False),
        (80.0, -3.9, True),
        (80.0, -4.1, False),
    ],
)
def test_an_inlier_is_within_one_and_a_half_pixels_or_five_percent_of_its_radius(radius, off, inlier):
    points = _at([*[radius] * 9, radius + off], np.linspace(0.0, 3.0, 10))
    found = _orbit._agreeing(points, np.full(10, 2), CENTRE)  # no point has the labels 0 and 1
    np.testing.assert_array_equal(found, [True] * 9 + [inlier])


@pytest.mark.parametrize(
    ("radius", "cover", "found"),
    [(5.9, 3.0, False), (6.1, 3.0, True), (40.0, 0.47, False), (40.0, 0.53, True)],
)
def test_an_orbit_has_a_radius_of_six_pixels_and_covers_half_a_radian(radius, cover, found):
    other = _at(60.0, np.linspace(0.0, 3.0, 7))
    points = np.concatenate([_at(radius, np.linspace(1.0, 1.0 + cover, 9)), other])
    inlier = _orbit._agreeing(points, np.repeat([0, 1], [9, 7]), CENTRE)
    np.testing.assert_array_equal(inlier, [found] * 9 + [True] * 7)


def test_directions_are_sectors_of_ten_degrees_for_each_group():
    angle = np.deg2rad([1.0, 9.0, 11.0, 19.0, 21.0, 185.0, -5.0, 355.0, 1.0])
    group = np.array([0, 0, 0, 0, 0, 0, 0, 0, 1])
    inlier = np.ones(9, dtype=bool)
    assert _orbit._directions(_at(50.0, angle), group, CENTRE, inlier) == 6
    inlier[[5, 8]] = False
    assert _orbit._directions(_at(50.0, angle), group, CENTRE, inlier) == 4


@pytest.mark.parametrize(
    ("values", "middle"),
    [
        ([0.0, 1.0, 3.0, 10.0, 20.0], 1.0),
        ([20.0, 0.0, 17.0, 10.0, 19.0], 19.0),
        ([0.0, 10.0, 11.0, 30.0], 10.5),
        ([0.0, 1.0, 2.0, 5.0, 20.0, 30.0, 40.0], 1.5),
        ([7.0], 7.0),
    ],
)
def test_the_mode_is_the_median_of_the_densest_half(values, middle):
    assert _orbit._mode(np.array(values)) == middle


def test_the_covered_angle_leaves_out_the_gap_across_the_zero():
    assert covered_angle(np.array([1.0, 5.0, 3.0])) == pytest.approx(4.0)
    assert covered_angle(np.array([0.5, 6.0, 1.5])) == pytest.approx(1.5 + 2 * np.pi - 6.0)


def _ellipse(theta, rho, e, p, q):
    shape = np.array([[1.0 + p, q], [q, 1.0 - p]])
    return np.asarray(e) + rho * np.stack([np.cos(theta), np.sin(theta)], axis=1) @ shape.T


SHAPE = Flattening({"a": (2.0, -1.0), "b": (4.0, 3.0)}, 0.03, -0.04, error=0.01)


def test_a_flattening_is_removed_exactly():
    theta = np.linspace(0.0, 6.0, 7)
    level = SHAPE.level("a", _ellipse(theta, 50.0, (2.0, -1.0), 0.03, -0.04))
    np.testing.assert_allclose(level, 50.0 * np.stack([np.cos(theta), np.sin(theta)], axis=1), atol=1e-9)
    level = SHAPE.level("unknown", _ellipse(theta, 50.0, (0.0, 0.0), 0.03, -0.04))
    np.testing.assert_allclose(np.hypot(*level.T), 50.0)


def test_a_flattening_has_a_tilt_and_offsets_that_can_be_moved():
    assert SHAPE.tilt == pytest.approx(2.0 * np.sqrt(0.05))
    assert SHAPE.moved(np.array([1.0, -5.0])).offset == {"a": (3.0, -6.0), "b": (5.0, -2.0)}
    np.testing.assert_allclose(SHAPE.shift(["a", "b", "c"]), [3.0, 1.0])
    np.testing.assert_allclose(SHAPE.shift(["b"]), [4.0, 3.0])


def test_the_uncertainty_of_an_offset_acts_along_the_orbit():
    shape = Flattening({"a": (0.0, 0.0)}, 0.0, 0.0, {"a": np.array([[4.0, 1.0], [1.0, 9.0]])})
    angle = np.array(
        [0.0, 0.5 * np.pi, np.pi, 1.5 * np.pi]
    )  # tangents (0, 1), (-1, 0), (0, -1), (1, 0): mean 0
    np.testing.assert_allclose(shape.tangential_sigma("a", angle), [3.0, 2.0, 3.0, 2.0])
    # the mean of the tangents (0, 1) and (-1, 0) is (-1/2, 1/2): half of (1, 1) and of (-1, -1) remain
    expected = [np.sqrt(4.0 + 9.0 + 2.0) / 2.0] * 2
    np.testing.assert_allclose(
        shape.tangential_sigma("a", np.array([0.0, 0.5 * np.pi, np.nan]))[:2], expected
    )
    np.testing.assert_array_equal(shape.tangential_sigma("b", angle), 0.0)
    np.testing.assert_array_equal(shape.tangential_sigma("a", np.full(3, np.nan)), 0.0)


def test_the_uncertainty_of_a_tilt_acts_twice_per_turn():
    np.testing.assert_allclose(SHAPE.tilt_sigma(np.arange(4) * np.pi / 4.0), 0.01)
    # the vectors (0, 1) and (0, -1) of the angles 0 and pi/2 have the mean 0; those of 0 and pi are equal
    np.testing.assert_allclose(SHAPE.tilt_sigma(np.array([0.0, np.pi])), 0.0, atol=1e-12)
    np.testing.assert_allclose(SHAPE.tilt_sigma(np.array([0.0, np.pi / 4.0])), 0.01 / np.sqrt(2.0))
    np.testing.assert_array_equal(SHAPE.tilt_sigma(np.full(3, np.nan)), 0.0)


@pytest.mark.parametrize("fit", [fit_flattening, fit_common_offset])
def test_a_fit_recovers_the_parameters_of_ellipses_with_outliers(fit):
    theta = np.linspace(0.0, 2.0 * np.pi, 240, endpoint=False)
    # the fit does not distinguish p from a change of A by 1 + O(p^2)
    seen = {
        "a": _ellipse(theta, 60.0, (2.0, -1.0), 0.004, -0.003),
        "b": _ellipse(theta, 90.0, (2.0, -1.0), 0.004, -0.003),
    }
    seen["a"][::24] *= 1.5
    found = fit(seen)
    assert (found.p, found.q) == (pytest.approx(0.004, rel=1e-3), pytest.approx(-0.003, rel=1e-3))
    for name in seen:
        np.testing.assert_allclose(found.offset[name], (2.0, -1.0), rtol=1e-3)


def test_each_marker_has_its_own_offset():
    theta = np.linspace(0.0, 2.0 * np.pi, 240, endpoint=False)
    offsets = {"a": (2.0, -1.0), "b": (-0.5, 1.5), "c": (0.3, 0.7)}
    found = fit_flattening({name: _ellipse(theta, 60.0, e, 0.004, -0.003) for name, e in offsets.items()})
    for name, e in offsets.items():
        np.testing.assert_allclose(found.offset[name], e, rtol=1e-3)


@pytest.mark.parametrize("fit", [fit_flattening, fit_common_offset])
@pytest.mark.parametrize(
    ("count", "cover", "found"), [(30, 5.5, True), (29, 5.5, False), (60, 4.9, False), (60, 5.1, True)]
)
def test_a_fit_needs_thirty_positions_over_five_radians(fit, count, cover, found):
    theta = np.linspace(1.0, 1.0 + cover, count)
    assert (fit({"a": _ellipse(theta, 60.0, (2.0, 1.0), 0.0, 0.0)}) != NO_FLATTENING) == found


def test_markers_without_positions_have_no_common_offset():
    assert fit_common_offset({}) == NO_FLATTENING
    assert fit_common_offset({"a": np.zeros((0, 2))}) == NO_FLATTENING


@pytest.mark.parametrize("count", [700, 9000])
def test_higher_harmonics_are_the_amplitudes_of_orders_three_to_six(count):
    theta = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    expected = np.array([0.8, -0.3, 0.5, 0.2, -0.4, 0.1, 0.25, 0.6])
    radius = (
        70.0 + 2.0 * np.cos(theta) - 1.5 * np.sin(theta) + 1.2 * np.cos(2 * theta) + 0.7 * np.sin(2 * theta)
    )
    for k in range(3, 7):
        radius += expected[2 * k - 6] * np.cos(k * theta) + expected[2 * k - 5] * np.sin(k * theta)
    radius[::50] += 3.0
    np.testing.assert_allclose(higher_harmonics(theta, radius), expected, atol=2e-3)


def test_a_mixture_has_the_mean_and_covariance_of_its_parts():
    means = [np.array([1.0, 2.0]), np.array([4.0, -2.0])]
    covariances = [np.diag([1.0, 2.0]), np.array([[3.0, 1.0], [1.0, 4.0]])]
    mean, covariance = mixture(means, covariances, [-2000.0, -2000.0 + np.log(3.0)])  # weights 1/4 and 3/4
    assert mean == pytest.approx((3.25, -1.0))
    second = [c + np.outer(m, m) for c, m in zip(covariances, means, strict=True)]
    np.testing.assert_allclose(covariance, 0.25 * second[0] + 0.75 * second[1] - np.outer(mean, mean))


def test_a_full_circle_determines_its_offset_by_its_twelve_independent_places():
    theta = np.linspace(0.0, 2.0 * np.pi, 1200, endpoint=False)
    e, size, usual = np.array([0.3, -0.2]), 0.6, 0.5
    v = (100.0 + np.cos(theta) * e[0] + np.sin(theta) * e[1])[:, None] * np.stack(
        [np.cos(theta), np.sin(theta)], axis=1
    )
    variance = 4.0 * usual**2 / (4.0 + 12.0 - 3.0)  # no residuals, but four degrees of freedom from `usual`
    information = 12.0 / 2.0 / variance
    gain = information / (information + size**-2)
    offset, covariance, evidence = _orbit._arc(v, size, usual)
    np.testing.assert_allclose(offset, gain * e, rtol=2e-3)
    np.testing.assert_allclose(covariance, np.eye(2) / (information + size**-2), rtol=2e-3, atol=1e-5)
    misfit = information * (1.0 - gain) ** 2 * (e @ e)
    assert evidence == pytest.approx(-0.5 * (misfit + gain**2 * (e @ e) / size**2), rel=2e-3)


def test_residuals_of_an_arc_increase_its_uncertainty():
    theta = np.linspace(0.0, 2.0 * np.pi, 1200, endpoint=False)
    # residuals of +-0.8 px: 1.4826 times their median absolute value
    rho = 100.0 + 0.8 * np.where(np.arange(1200) % 2, 1.0, -1.0)
    rho[::99] += 40.0  # outliers
    _, covariance, _ = _orbit._arc(rho[:, None] * np.stack([np.cos(theta), np.sin(theta)], axis=1), 9.0, 0.5)
    variance = (4.0 * 0.5**2 + 12.0 * (1.4826 * 0.8) ** 2) / (4.0 + 9.0)
    kept = 12.0 * (1187 / 1200)
    np.testing.assert_allclose(np.diag(covariance), 1.0 / (kept / 2.0 / variance + 1.0 / 81.0), rtol=0.01)


@pytest.mark.parametrize(("count", "fitted"), [(29, False), (30, True)])
def test_an_arc_of_thirty_positions_improves_the_expected_offset(count, fitted):
    theta = np.linspace(0.2, 3.0, count)
    v = _ellipse(theta, 80.0, (1.0, 0.5), 0.03, -0.04)
    found = flattening_of_arc(SHAPE, {"x": v}, np.array([0.8, 0.4]), 0.5, 0.1)
    assert (found.p, found.q, found.error) == (0.03, -0.04, 0.01)
    if not fitted:
        assert found.offset["x"] == pytest.approx((0.8, 0.4))
        np.testing.assert_allclose(found.offset_covariance["x"], 0.25 * np.eye(2))
        return
    more, covariance, _ = _orbit._arc(
        _ellipse(theta, 80.0, (0.0, 0.0), 0.0, 0.0) + _removed((0.2, 0.1)), 0.5, 0.1
    )
    assert found.offset["x"] == pytest.approx(np.array([0.8, 0.4]) + more)
    np.testing.assert_allclose(found.offset_covariance["x"], covariance)


def _removed(e):
    return np.linalg.solve(np.array([[1.03, -0.04], [-0.04, 0.97]]), e)


def test_an_arc_selects_between_two_expected_offsets():
    theta = np.linspace(0.2, 6.0, 400)
    v = _ellipse(theta, 80.0, (1.0, 0.5), 0.0, 0.0)
    found = flattening_of_arc(NO_FLATTENING, {"x": v}, np.array([[1.0, 0.5], [-4.0, 3.0]]), 0.3, 0.1)
    assert found.offset["x"] == pytest.approx((1.0, 0.5), abs=0.02)
    # two distant hypotheses without positions: their mean and half of their squared distance
    found = flattening_of_arc(NO_FLATTENING, {"x": v[:5]}, np.array([[1.0, 0.5], [-3.0, 0.5]]), 0.3, 0.1)
    assert found.offset["x"] == pytest.approx((-1.0, 0.5))
    np.testing.assert_allclose(found.offset_covariance["x"], [[4.09, 0.0], [0.0, 0.09]], atol=1e-12)


def _spiked(off):
    """Return 240 angles, and residuals of +-0.1 px of which one is `off` times their robust standard deviation."""
    theta = np.linspace(0.0, 2.0 * np.pi, 240, endpoint=False)
    noise = np.where(np.arange(240) // 2 % 2, 0.1, -0.1)
    noise[70] = off * 1.4826 * 0.1
    return theta, noise


@pytest.mark.parametrize(("off", "kept"), [(3.7, True), (4.3, False), (-3.7, True), (-4.3, False)])
def test_outliers_of_orbits_are_beyond_four_robust_standard_deviations(off, kept):
    theta, noise = _spiked(off)
    use = np.ones(240, dtype=bool)
    use[70] = kept
    design = np.stack(
        [np.ones(240), np.cos(theta), np.sin(theta), 50 * np.cos(2 * theta), 50 * np.sin(2 * theta)]
    )
    # the size of the offset itself does not matter
    value = noise + np.array([3.0, 2.0, -9.0, 0.01, 0.02]) @ design
    expected = np.linalg.lstsq(design[:, use].T, value[use], rcond=None)[0]
    found = _orbit._robust([(design, value)])
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    both = _orbit._robust([(design, value), (design, value + 1.0)], common=True)
    np.testing.assert_allclose(both, [expected[0], expected[0] + 1.0, *expected[1:]], rtol=1e-7)


@pytest.mark.parametrize(("off", "kept"), [(3.7, True), (4.3, False), (-3.7, True), (-4.3, False)])
def test_outliers_of_radii_are_beyond_four_robust_standard_deviations(off, kept):
    theta, noise = _spiked(off)
    use = np.ones(240, dtype=bool)
    use[70] = kept
    waves = [f(k * theta) for k in range(1, 7) for f in (np.cos, np.sin)]
    design = np.stack([np.ones(240), *waves], axis=1)
    radius = 70.0 + noise + 0.5 * np.cos(3 * theta)
    value = radius - np.median(radius)
    normal = design[use].T @ design[use] + 0.04 * np.eye(13)
    expected = np.linalg.solve(normal, design[use].T @ value[use])[5:]
    np.testing.assert_allclose(higher_harmonics(theta, radius), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("off", "kept"), [(3.8, True), (4.2, False)])
def test_outliers_of_an_arc_are_beyond_four_standard_deviations(off, kept):
    """Of the errors of its independent places, here of the usual error alone."""
    theta = np.linspace(0.0, 2.0 * np.pi, 1200, endpoint=False)
    rho = np.full(1200, 100.0)
    scatter = np.sqrt(4.0 * 0.5**2 / (4.0 + 12.0 - 3.0))
    rho[0] += off * scatter
    offset, covariance, evidence = _orbit._arc(
        rho[:, None] * np.stack([np.cos(theta), np.sin(theta)], axis=1), 0.6, 0.5
    )
    weight = 1.0 / (100.0 * scatter**2)
    pull = weight * off * scatter if kept else 0.0
    assert offset[0] == pytest.approx(pull / (600.0 * weight + 0.6**-2), rel=0.02, abs=1e-9)
    assert covariance[1, 1] == pytest.approx(1.0 / (600.0 * weight + 0.6**-2), rel=0.01)
    # the residual of an outlier is limited
    assert evidence == pytest.approx(-0.5 * weight * (min(off, 4.0) * scatter) ** 2, rel=0.02)


def test_long_series_are_thinned_before_a_fit():
    theta = np.linspace(0.0, 2.0 * np.pi, 6000, endpoint=False)
    seen = _ellipse(theta, 60.0, (2.0, -1.0), 0.0, 0.0)
    spoilt = seen.copy()
    spoilt[1::3] += 5.0  # every third position is used
    for fit in (fit_flattening, fit_common_offset):
        np.testing.assert_allclose(fit({"a": spoilt}).offset["a"], (2.0, -1.0), atol=1e-3)
    short = _ellipse(theta[::2], 60.0, (2.0, -1.0), 0.0, 0.0)
    short[1::3] += 5.0  # all of 3000 positions are used
    assert np.abs(np.array(fit_flattening({"a": short}).offset["a"]) - (2.0, -1.0)).max() > 0.05


@pytest.mark.parametrize(("cover", "found"), [(0.47, False), (0.53, True)])
def test_the_orbit_about_a_hub_has_the_radius_of_each_group(cover, found):
    points = np.concatenate(
        [_at(50.0, np.linspace(1.0, 1.0 + cover, 9)), _at(70.0, np.linspace(1.0, 1.0 + cover, 7))]
    )
    orbit = orbits_about(points, np.repeat([0, 3], [9, 7]), (100.0, 80.0))
    assert (orbit is not None) == found
    if found:
        assert orbit.radii == pytest.approx({0: 50.0, 3: 70.0})
        assert (orbit.inliers, orbit.centre) == (16, (100.0, 80.0))


def test_groups_of_two_points_do_not_determine_a_centre():
    angle = 0.1 + np.arange(5) * 1.2
    points = np.concatenate([_at(50.0, angle), [[3.0, 4.0], [9.0, 150.0]]])
    found = common_centre(points, np.array([1, 1, 1, 1, 1, 0, 0]), trials=60)
    np.testing.assert_allclose(found.centre, CENTRE, atol=1e-6)
    assert list(found.radii) == [1]
    assert found.inliers == 5


def test_concentric_circles_may_be_fitted_with_gaps_in_their_labels():
    points = np.concatenate([_at(50.0, np.linspace(0, 2, 8)), _at(30.0, np.linspace(3, 5, 6))])
    centre, radii = _orbit.fit_common_centre(points, np.repeat([4, 1], [8, 6]))
    np.testing.assert_allclose(centre, CENTRE)
    assert radii == pytest.approx({1: 30.0, 4: 50.0})
