"""Formulas of the circle and the ellipse of a path: parameters, covariance, parts with an error of their own."""

import math

import numpy as np
import pytest

from gyrotrack.tracking import _pivot as pivot
from gyrotrack.tracking._pivot import Orbit, fit_arc, fit_orbit

CENTRE = np.array([120.0, 90.0])


def ellipse(angle, value):
    x, y, radius, p, q = value
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.array([x, y]) + radius * unit @ np.array([[1 + p, q], [q, 1 - p]])


def scatter(count, size):
    """Return errors of two signs without a mean or a trend, with the variance `size`^2."""
    return size * np.tile([1.0, -1.0, -1.0, 1.0], count // 4)


class TestOrbit:
    @pytest.mark.parametrize("long", [0.3, 1.2, 2.5])
    def test_the_tilt_is_that_of_the_ratio_of_the_axes(self, long):
        """The direction of the long axis is given in the picture, with y downwards."""
        tilt = 0.8
        s = (1 - math.cos(tilt)) / (1 + math.cos(tilt))
        orbit = Orbit(np.array([0, 0, 50.0, s * math.cos(2 * long), s * math.sin(2 * long)]), np.eye(5))
        short = (0.5 * math.pi - long) % math.pi
        assert orbit.tilt == pytest.approx((tilt, short))
        seen = ellipse(np.linspace(0, 7, 400), orbit.value)
        away = np.hypot(*seen.T)
        assert away.min() / away.max() == pytest.approx(math.cos(tilt), abs=1e-3)
        x, y = seen[np.argmax(away)]
        assert math.atan2(y, x) % math.pi == pytest.approx(long, abs=0.02)

    def test_the_uncertainty_of_the_tilt_is_that_of_the_length_of_the_stretch(self):
        covariance = np.zeros((5, 5))
        covariance[3:, 3:] = [[4e-4, 1e-4], [1e-4, 9e-4]]
        orbit = Orbit(np.array([0, 0, 50.0, 0.12, 0.16]), covariance)
        u = math.sqrt(0.36 * 4e-4 + 2 * 0.48 * 1e-4 + 0.64 * 9e-4)
        tilt = lambda s: math.acos((1 - s) / (1 + s))  # noqa: E731
        assert orbit.tilt_u == pytest.approx(u * (tilt(0.2 + 1e-6) - tilt(0.2 - 1e-6)) / 2e-6, rel=1e-5)

    def test_positions_in_the_plane_are_on_a_circle(self):
        angle = np.linspace(0.0, 5.0, 9)
        value = np.array([120.0, 90.0, 50.0, 0.2, -0.1])
        found = Orbit(value, np.eye(5)).plane(ellipse(angle, value))
        np.testing.assert_allclose(found, 50.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1), atol=1e-9)

    def test_an_ellipse_is_fitted_with_the_covariance_of_its_noise(self):
        angle = np.linspace(0.0, 2 * np.pi, 480, endpoint=False)
        unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        place = CENTRE + (50.0 + scatter(480, 0.1))[:, None] * unit
        found = fit_orbit(place, np.full(480, 0.3))
        np.testing.assert_allclose(found.value, [120.0, 90.0, 50.0, 0.0, 0.0], atol=0.01)
        noise = 0.1**2 / 480 * 40 / 39
        # displacements are u dx, radii are dr, and the stretch is r (p cos 2a + q sin 2a)
        expected = noise * np.array([2.0, 2.0, 1.0, 2.0 / 2500, 2.0 / 2500])
        np.testing.assert_allclose(np.diag(found.covariance), expected, rtol=0.03)
        # errors of 12 independent places of 0.2 px
        placed = fit_orbit(place, np.full(480, 0.3), 0.2)
        # a part of 30 degrees averages a wave of order k over sin(15 k) / (15 k)
        one, two = (np.sinc(k / 12) ** 2 for k in (1, 2))
        more = 0.2**2 / 12 * np.array([2 * one, 2 * one, 1.0, 2 * two / 2500, 2 * two / 2500])
        np.testing.assert_allclose(np.diag(placed.covariance), expected + more, rtol=0.03)

    @pytest.mark.parametrize("stretch", [(0.2, -0.1), (-0.25, 0.05), (0.0, 0.3)])
    def test_a_tilted_orbit_is_found_despite_outliers(self, stretch):
        value = np.array([120.0, 90.0, 50.0, *stretch])
        place = ellipse(np.linspace(0.0, 6.0, 120), value)
        found = fit_orbit(place, np.full(120, 0.1))
        np.testing.assert_allclose(found.value, value, rtol=1e-5, atol=1e-5)


class TestArc:
    @pytest.mark.parametrize("reach", [1.0, 3.3, 5.0, 6.0, 2 * np.pi * 479 / 480])
    def test_hub_and_radius_have_the_covariance_of_their_linear_model(self, reach):
        """A residual is u dh + dr, with the unit vector u from the hub; also where the positions surround the hub."""
        angle = 0.7 + np.linspace(0.0, reach, 480)
        unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        place = CENTRE + (50.0 + scatter(480, 0.1))[:, None] * unit
        found = fit_arc(place, np.full(480, 0.3))
        np.testing.assert_allclose(found.hub, CENTRE, atol=0.05)
        assert found.radius == pytest.approx(50.0, abs=0.05)
        assert found.curvature == pytest.approx(1 / found.radius)
        assert found.noise == pytest.approx(0.1 * math.sqrt(40 / 39), rel=0.02)
        assert found.by_place == 0.0
        model = np.column_stack([unit, np.ones(480)])
        expected = 0.1**2 * 40 / 39 * np.linalg.inv(model.T @ model)
        np.testing.assert_allclose(found.covariance, expected[:2, :2], rtol=0.05, atol=0.02 * expected[0, 0])
        assert found.curvature_u == pytest.approx(math.sqrt(expected[2, 2]) / 2500.0, rel=0.05)

    @pytest.mark.parametrize("radius", [4000.0, -4000.0, 1e9])
    def test_a_nearly_straight_path_has_the_curvature_of_a_parabola(self, radius):
        x = np.linspace(-100.0, 100.0, 480)
        y = 0.5 * x**2 / radius + scatter(480, 0.1)
        found = fit_arc(np.stack([300 + x, 50 + y], axis=1), np.full(480, 0.05))
        model = np.stack([np.ones(480), x, 0.5 * x**2], axis=1)
        u = math.sqrt(0.1**2 * 40 / 39 * np.linalg.inv(model.T @ model)[2, 2])
        assert found.curvature_u == pytest.approx(u, rel=0.05)
        assert found.curvature == pytest.approx(1 / abs(radius), abs=0.3 * u)
        if abs(radius) < 1e6:
            assert found.hub[0] == pytest.approx(300.0, abs=2.0)
            assert found.hub[1] == pytest.approx(50.0 + radius, rel=0.03)
            assert math.sqrt(found.covariance[1, 1]) == pytest.approx(u * found.radius**2, rel=0.06)

    @pytest.mark.parametrize(("off", "kept"), [(4.5, True), (5.6, False), (-4.5, True), (-5.6, False)])
    def test_an_outlier_is_beyond_five_robust_standard_deviations(self, off, kept):
        angle = np.linspace(0.0, 6.0, 240)
        radius = 50.0 + scatter(240, 0.1)
        radius[100] = 50.0 + off * 1.4826 * 0.1
        place = CENTRE + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        found, without = (
            fit_arc(p, np.full(len(p), 0.1)).hub for p in (place, np.delete(place, 100, axis=0))
        )
        assert (np.hypot(*(found - without)) > 1e-4) is np.bool_(kept)

    def test_the_least_error_of_a_place_is_given_in_pixels(self):
        angle = np.linspace(0.0, 6.0, 480)
        place = CENTRE + (50.0 + scatter(480, 0.1))[:, None] * np.stack(
            [np.cos(angle), np.sin(angle)], axis=1
        )
        assert fit_arc(place, np.full(480, 0.1), 0.07).by_place == pytest.approx(0.07)


class TestParts:
    def test_positions_along_an_arc_have_twelve_parts(self):
        """About a hub, across the direction pi, in any order."""
        angle = math.pi - 0.5 + (np.arange(24) + 0.01) / 24
        order = np.random.default_rng(0).permutation(24)
        x, y = 3.0 + 10 * np.cos(angle), 2.0 + 10 * np.sin(angle)
        found = pivot._cell(x[order], y[order], np.array([3.0, 2.0]), straight=False)
        expected = np.minimum(12 * np.arange(24) // 23, 11)
        np.testing.assert_array_equal(found, expected[order])

    def test_positions_along_a_line_have_twelve_parts(self):
        t = np.linspace(0.0, 1.0, 24)
        found = pivot._cell(2 - 3 * t, 5 * t, np.array([1e9, 0.0]), straight=True)
        expected = np.minimum(12 * np.arange(24) // 23, 11)
        assert found.tolist() in (expected.tolist(), expected[::-1].tolist())

    def covariance(self, means, size=0.1, count=5, floor=0.0, sigma=0.2):
        """Return the result for a common constant: residuals of `count` places in each part about given means."""
        own = np.array([1.0, -1.0, 0.0, 1.0, -1.0])[:count]
        rest = np.concatenate([m + size * (own - own.mean()) for m in means])
        cell = np.repeat(np.arange(len(means)), count)
        return pivot._covariance(np.ones((len(rest), 1)), rest, np.full(len(rest), sigma), cell, floor)

    def test_noise_is_the_scatter_within_the_parts(self):
        means = 0.001 * np.where(np.arange(12) % 2, 1.0, -1.0)
        noise, by_place, covariance = self.covariance(means)
        assert noise == pytest.approx(0.1)  # 4 squares of 0.1 with 4 degrees of freedom in each part
        assert by_place == 0.0
        assert covariance[0, 0] == pytest.approx(0.01 / 60)
        noise, by_place, covariance = self.covariance(means, floor=0.3)
        assert by_place == 0.3
        assert covariance[0, 0] == pytest.approx(0.01 / 60 + 0.09 / 12)

    @pytest.mark.parametrize(("share", "significant"), [(0.95, False), (1.05, True)])
    def test_an_error_of_the_places_exceeds_two_standard_deviations(self, share, significant):
        expected = 0.01 / 5
        squares = share * expected * (1 + 2 * math.sqrt(2 / 9))
        mean = math.sqrt(squares * 9 / 12)
        _, by_place, covariance = self.covariance(mean * np.where(np.arange(12) % 2, 1.0, -1.0))
        assert by_place == pytest.approx(math.sqrt(squares - expected) if significant else 0.0)
        assert covariance[0, 0] == pytest.approx(0.01 / 60 + by_place**2 / 12)

    @pytest.mark.parametrize(("parts", "count", "found"), [(5, 3, True), (4, 3, False), (5, 2, False)])
    def test_five_parts_of_three_positions_show_an_error(self, parts, count, found):
        means = 0.5 * np.where(np.arange(parts) % 2, 1.0, -1.0)
        noise, by_place, covariance = self.covariance(means, count=count)
        assert (by_place > 0.4) is found
        if not found:
            assert covariance[0, 0] == pytest.approx(noise**2 / (parts * count))
        if count == 2:  # without parts, noise is the scatter about the fit of three parameters
            rest = np.concatenate([m + np.array([0.1, -0.1]) for m in means])
            assert noise == pytest.approx(math.sqrt((rest**2).sum() / 7))

    def test_positions_weigh_by_their_uncertainties(self):
        rest = np.tile([0.1, -0.1, -0.1, 0.1], 6)
        sigma = np.repeat([0.1, 0.3], 12)
        _, _, covariance = pivot._covariance(np.ones((24, 1)), rest, sigma, np.repeat([0, 1, 2], 8), 0.0)
        chi2 = 0.01 * 24 / 21 / np.mean(sigma**2)
        assert covariance[0, 0] == pytest.approx(chi2 / (12 / 0.01 + 12 / 0.09))


@pytest.mark.parametrize(("reach", "share", "error"), [(1.0, 2, 0.01), (6.0, 3, 0.15)])
def test_many_wrong_positions_do_not_move_the_hub(reach, share, error):
    """Two or three of ten are displaced by 30 standard deviations; without weights the hub moves by 0.6 to 0.9 px."""
    angle = np.linspace(0.0, reach, 240)
    place = CENTRE + (50.0 + scatter(240, 0.1))[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    place[np.arange(240) % 10 < share, 0] += 3.0
    assert np.hypot(*(fit_arc(place, np.full(240, 0.1)).hub - CENTRE)) < error
