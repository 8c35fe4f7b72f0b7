"""The pivot of a path: its uncertainty against its error, straight paths, errors that repeat with the place."""

import dataclasses

import numpy as np
import pytest

from gyrotrack.tracking._pivot import STRAIGHT, Arc, Orbit, angles_about, fit_arc

HUB = np.array([40.0, -170.0])


def path(radius, reach, count=200, noise=0.02, seed=0, by_place=0.0):
    """Positions on an arc of `reach` rad to both sides of the vertical, with white noise and an error by place."""
    rng = np.random.default_rng(seed)
    angle = reach * np.sin(np.linspace(0, 40, count))
    out = radius + by_place * np.cos(9.0 * angle / reach)
    exact = HUB + out[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=1)
    return exact + rng.normal(0, noise, (count, 2))


@pytest.mark.parametrize(
    "reach", [0.15, pytest.param(0.8, marks=pytest.mark.slow), pytest.param(np.pi, marks=pytest.mark.slow)]
)
def test_the_uncertainty_of_the_pivot_is_that_of_its_error(reach):
    """Over 20 paths, curvature and pivot scatter by their uncertainties: rms z within 0.8 and 1.25."""
    z, chi2 = [], []
    for seed in range(20):
        arc = fit_arc(path(300.0, reach, noise=0.06, seed=seed), np.full(200, 0.06))
        z.append((arc.curvature - 1 / 300.0) / arc.curvature_u)
        off = arc.hub - HUB
        chi2.append(off @ np.linalg.solve(arc.covariance, off) / 2)
    assert 0.8 < np.sqrt(np.mean(np.square(z))) < 1.25
    # the hub of a short arc is not normal: its distance is the inverse of the curvature
    assert 0.7 < np.sqrt(np.mean(chi2)) < 1.3


def test_position_dependent_errors_enlarge_the_uncertainty():
    """A view or a lens that displaces the path by 0.1 px rms, 14 times the noise of a mean of 200 positions."""
    plain, curved = (fit_arc(path(300.0, 0.3, by_place=b), np.full(200, 0.02)) for b in (0.0, 0.14))
    assert curved.by_place > 0.05 > plain.by_place
    assert curved.curvature_u > 5 * plain.curvature_u
    assert abs(curved.curvature - 1 / 300.0) < 3 * curved.curvature_u


def test_the_least_position_dependent_error_is_kept():
    arcs = [fit_arc(path(300.0, 0.3), np.full(200, 0.02), least) for least in (0.0, 0.03)]
    assert [arc.by_place for arc in arcs] == pytest.approx([0.0, 0.03])
    # noise of a mean 0.02 / sqrt(200 / 12) = 0.005 px
    assert arcs[1].curvature_u > 4 * arcs[0].curvature_u


def test_a_straight_path_has_no_pivot():
    t = np.linspace(-1, 1, 100)
    rng = np.random.default_rng(1)
    straight = np.stack([40 + 30 * t, 60 + 5 * t], axis=1) + rng.normal(0, 0.05, (100, 2))
    assert not fit_arc(straight, np.full(100, 0.05)).determined


def test_a_pivot_is_determined_from_four_standard_uncertainties_of_the_curvature():
    arc = Arc(np.zeros(2), np.eye(2), 100.0, 0.01, 0.01, 0.1, 0.0)
    for sigmas in (1.05, 0.95):
        assert dataclasses.replace(arc, curvature=sigmas * STRAIGHT * 0.01).determined == (sigmas > 1)


def test_an_orbit_is_flattened_from_four_standard_uncertainties_of_the_stretch():
    covariance = np.diag([9.0, 9.0, 9.0, 0.01**2, 0.02**2])
    for stretch, sigmas in ((np.array([0.01, 0.0]), 1.0), (np.array([0.01, -0.02]), np.sqrt(2))):
        for factor in (1.05, 0.95):
            value = np.array([40.0, 60.0, 50.0, *(factor * STRAIGHT / sigmas * stretch)])
            assert Orbit(value, covariance).flattened == (factor > 1)


def test_outliers_do_not_move_the_pivot():
    positions = path(300.0, 0.5)
    positions[::10] += (0.0, 30.0)
    arc = fit_arc(positions, np.full(200, 0.02))
    assert np.hypot(*(arc.hub - HUB)) < 1.0


def test_angles_increase_counter_clockwise_as_seen():
    quarter = np.array([[10.0, 0.0], [0.0, -10.0], [-10.0, 0.0]])  # right, up, left of the pivot; y is down
    assert angles_about(np.zeros(2), quarter) == pytest.approx([0, np.pi / 2, np.pi])
