import numpy as np
import pytest

from gyrotrack.tracking._orbit import (
    circumcentre,
    common_centre,
    covered_angle,
    fit_common_centre,
    orbits_about,
)

CENTRE = np.array([201.3, 148.7])


def _on_circle(radius, angle):
    return CENTRE + radius * np.stack([np.cos(angle), -np.sin(angle)], axis=-1)


def test_three_points_give_their_circle():
    np.testing.assert_allclose(circumcentre(_on_circle(50, np.array([0.1, 1.9, 4.0]))), CENTRE)


def test_points_on_a_line_give_none():
    assert circumcentre(np.array([[0.0, 0.0], [10.0, 10.0], [20.0, 20.0]])) is None


def test_concentric_circles_are_fitted_exactly():
    points = np.concatenate([_on_circle(40, np.linspace(0, 2, 9)), _on_circle(75, np.linspace(3, 5, 7))])
    centre, radii = fit_common_centre(points, np.repeat([0, 1], [9, 7]))
    np.testing.assert_allclose(centre, CENTRE, atol=1e-6)
    assert radii == pytest.approx({0: 40.0, 1: 75.0})


def test_the_common_centre_is_found_among_outliers_and_things_that_stand_still():
    rng = np.random.default_rng(5)
    turning = _on_circle(60, rng.uniform(0, 6.28, 30)) + rng.normal(0, 0.5, (30, 2))
    still = np.array([250.0, 60.0]) + rng.normal(0, 1.0, (40, 2))  # more often seen than what turns
    strewn = rng.uniform(0, 300, (15, 2))
    points = np.concatenate([turning, still, strewn])
    orbit = common_centre(points, np.array([0] * 30 + [1] * 40 + [0] * 15))
    assert orbit is not None
    np.testing.assert_allclose(orbit.centre, CENTRE, atol=0.6)
    assert orbit.radii[0] == pytest.approx(60, abs=0.6)


def test_what_does_not_go_round_has_no_centre():
    rng = np.random.default_rng(1)
    points = np.array([100.0, 80.0]) + rng.normal(0, 1.0, (50, 2))
    assert common_centre(points, np.zeros(50, dtype=int)) is None


def test_covered_angle_is_a_turn_less_the_largest_gap():
    assert covered_angle(np.array([0.0, 1.0, 2.0])) == pytest.approx(2.0)
    assert covered_angle(np.array([-0.2, 0.2])) == pytest.approx(0.4)


def test_circles_about_a_hub_that_is_given():
    rng = np.random.default_rng(0)
    points = np.concatenate([_on_circle(40, np.linspace(0, 2, 9)), _on_circle(75, np.linspace(3, 5, 7))])
    points = np.concatenate([points, rng.uniform(0, 400, (2, 2))])
    group = np.repeat([0, 1], [9, 9])
    found = orbits_about(points, group, (201.3, 148.7))
    assert found.centre == (201.3, 148.7)
    assert found.radii == pytest.approx({0: 40.0, 1: 75.0})
    assert orbits_about(points, group, (5.0, 5.0)) is None
