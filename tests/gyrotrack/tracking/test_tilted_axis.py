"""A tilted axis, found by the ellipse of an orbit or of what moves, against analytic projections."""

import math
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import TrackingError
from gyrotrack.tracking._hub_search import distance_from, tilted_outline
from gyrotrack.tracking._pivot import fit_orbit
from gyrotrack.tracking._point_motion import SecondLink, about_pivot, second_link
from gyrotrack.tracking._point_tracker import PointPath
from gyrotrack.tracking._registration import Ring

TURNS = np.linspace(0.3, 0.3 + 4 * math.pi, 160)


def _seen(theta, tilt, short, radius=80.0, hub=(160.0, 120.0)):
    """The circle of a point (counter-clockwise, y down), short by cos(tilt) along the direction `short`."""
    x, y = radius * np.cos(theta), -radius * np.sin(theta)
    a = np.array([math.cos(short), -math.sin(short)])
    along, across = (x * a[0] + y * a[1]) * math.cos(tilt), -x * a[1] + y * a[0]
    return np.stack([along * a[0] - across * a[1], along * a[1] + across * a[0]], axis=1) + hub


def _path(place, sigma=0.05, seed=0):
    noise = np.random.default_rng(seed).normal(0, sigma, place.shape)
    covariance = np.tile(sigma**2 * np.eye(2), (len(place), 1, 1))
    return PointPath(
        np.arange(len(place)), place + noise, covariance, 5.0, len(place), False, np.zeros((3, 3))
    )


@pytest.mark.parametrize(
    ("degrees", "short"),
    [*(pytest.param(*p, marks=pytest.mark.slow) for p in ((20.0, 0.4), (40.0, 1.5))), (60.0, 2.6)],
)
def test_the_angles_are_those_in_the_plane_of_the_body(degrees, short):
    tilt, z, of_tilt = math.radians(degrees), [], []
    for seed in range(3):
        found = about_pivot(_path(_seen(TURNS, tilt, short), seed=seed), "film.mp4")
        assert found.orbit is not None
        assert found.orbit.tilt[1] == pytest.approx(short, abs=0.01)
        of_tilt.append((found.orbit.tilt[0] - tilt) / found.orbit.tilt_u)
        error = found.angle - TURNS[found.frame]
        z.append((error - error.mean()) / found.sigma)
        # the bound of a position error of 0.05 px, which the projection enlarges by up to 1 / cos(tilt)
        assert np.std(error) < 1.5 * 0.05 / 80.0 / math.sqrt(math.cos(tilt))
        assert f"tilted by {degrees:.0f}." in found.warnings[0]
        assert "does not show which side is nearer" in found.warnings[0]
    assert 0.8 < np.std(z) < 1.25
    assert np.sqrt(np.mean(np.square(of_tilt))) < 2.0


def test_positions_on_an_ellipse_have_the_uncertainty_of_their_scatter():
    found = about_pivot(_path(_seen(TURNS, 0.4, 1.0)), "film.mp4")
    assert found.orbit is not None
    assert found.place_sigma == pytest.approx(np.full((len(found.frame), 2), 0.05), rel=0.2)


@pytest.mark.parametrize("formal", [0.01, 0.05])
def test_a_second_link_has_the_uncertainty_of_both_its_ends(formal):
    """Errors of 0.05 px at both ends, 70 px apart; the Cramer-Rao bound of the end may be smaller."""
    first, second = 0.5 * np.sin(TURNS) - 1.4, 0.9 * np.sin(1.3 * TURNS) - 1.2
    joint = _seen(first, 0.0, 0.0, 90.0)
    end = _path(joint + 70.0 * np.stack([np.cos(second), -np.sin(second)], axis=1), seed=1)
    end = replace(end, covariance=(formal / 0.05) ** 2 * end.covariance)
    found = second_link(about_pivot(_path(joint), "film.mp4"), end, "film.mp4")
    white = np.sqrt(found.sigma**2 - found.off_axis**2)
    assert np.median(white) == pytest.approx(np.hypot(0.05, 0.05) / 70.0, rel=0.3)
    assert np.sqrt(found.path.covariance[:, 0, 0]) == pytest.approx(0.05, rel=0.3)


def test_a_circle_and_a_short_arc_show_no_tilt():
    assert about_pivot(_path(_seen(TURNS, 0.0, 0.0)), "film.mp4").orbit is None
    arc = _path(_seen(1.3 + 0.4 * np.sin(TURNS), 0.7, 1.5))
    assert about_pivot(arc, "film.mp4").orbit is None
    with pytest.raises(ValueError, match="do not determine an ellipse"):
        fit_orbit(arc.place, np.full(len(TURNS), 0.05))


def test_angles_of_displaced_orbits_differ_by_the_uncertainty_of_the_tilt():
    found = about_pivot(_path(_seen(TURNS, 0.8, 1.0), sigma=0.5), "film.mp4")
    apart = [np.std(other - found.angle) for other in found.displaced()]
    assert len(apart) == 5
    # a tilt that is wrong by u changes the angles by u tan(tilt) / 2 sin(2 theta)
    expected = 0.5 * math.tan(0.8) * found.orbit.tilt_u / math.sqrt(2.0)
    assert max(apart) == pytest.approx(expected, rel=0.6)


def test_the_covariance_of_an_orbit_is_that_of_its_scatter():
    place = _seen(TURNS, 0.9, 1.0)
    many = [fit_orbit(place + np.random.default_rng(k).normal(0, 0.3, place.shape), np.full(len(place), 0.3))
            for k in range(40)]  # fmt: skip
    scatter = np.std([o.value for o in many], axis=0)
    stated = np.mean([np.sqrt(np.diag(o.covariance)) for o in many], axis=0)
    np.testing.assert_allclose(stated, scatter, rtol=0.5)


def test_a_given_hub_beside_the_centre_of_the_orbit_is_doubted():
    path = _path(_seen(TURNS, 0.8, 1.0))
    near = about_pivot(path, "film.mp4", (160.5, 120.0))
    assert not near.ambiguous
    far = about_pivot(path, "film.mp4", (170.0, 120.0))
    assert far.ambiguous
    assert "10.0 px away" in far.warnings[-1]


@pytest.mark.parametrize(("tilt", "short"), [(0.5, 0.6), (1.0, 2.4)])
def test_what_moves_shows_the_stretch_of_the_rings(tilt, short):
    y, x = np.mgrid[0:240, 0:320].astype(float)
    a = np.array([math.cos(short), -math.sin(short)])
    along, across = (x - 160) * a[0] + (y - 120) * a[1], -(x - 160) * a[1] + (y - 120) * a[0]
    moving = np.hypot(along / math.cos(tilt), across) < 80
    found = tilted_outline(SimpleNamespace(moving=moving))
    assert found.hub == pytest.approx((160.0, 120.0), abs=0.2)
    ring = Ring.about(found.hub, 10.0, 80.0, stretch=found.stretch)
    assert ring.tilt[0] == pytest.approx(tilt, abs=0.01)
    assert ring.tilt[1] == pytest.approx(short, abs=0.01)
    # the ring's circles are those of the outline, up to their common scale
    radius = distance_from(found.hub, moving.shape, found.stretch)
    size = math.hypot(*found.stretch)
    np.testing.assert_array_equal(radius < 80 / (1 + size) - 1, (radius < 80 / (1 + size) - 1) & moving)
    assert not (moving & (radius > 80 / (1 + size) + 1)).any()
    assert tilted_outline(SimpleNamespace(moving=moving), (150.0, 120.0)).hub == (150.0, 120.0)


def test_a_round_outline_shows_no_tilt_and_an_arc_of_a_ring_has_none():
    y, x = np.mgrid[0:240, 0:320]
    assert tilted_outline(SimpleNamespace(moving=np.hypot(x - 160, y - 120) < 80)) is None
    assert tilted_outline(SimpleNamespace(moving=np.zeros((240, 320), bool))) is None
    assert Ring.about((0.0, 0.0), 10.0, 80.0, span=1.0).tilt is None


def test_a_trimmed_ring_keeps_its_stretch():
    ring = Ring.about((160.0, 120.0), 10.0, 80.0, stretch=(0.2, 0.1))
    assert ring.trimmed(np.linspace(0, 1, ring.rows), finest=100.0).stretch == (0.2, 0.1)


@pytest.mark.parametrize(("count", "enough"), [(6, False), (7, True)])
def test_a_second_link_needs_enough_frames_for_its_noise(count, enough):
    first, second = 0.5 * np.sin(TURNS) - 1.4, 0.9 * np.sin(1.3 * TURNS) - 1.2
    joint = _seen(first, 0.0, 0.0, 90.0)
    end = _path(joint + 70.0 * np.stack([np.cos(second), -np.sin(second)], axis=1), seed=1)
    few = replace(
        end,
        **{
            f.name: v[:count]
            for f in fields(end)
            if len(v := np.atleast_1d(getattr(end, f.name))) == len(end.frame)
        },
    )
    about = about_pivot(_path(joint), "film.mp4")
    if enough:
        assert np.isfinite(second_link(about, few, "film.mp4").sigma).all()
    else:
        with pytest.raises(TrackingError, match="seen together in only 6 frames"):
            second_link(about, few, "film.mp4")


def test_the_direction_of_a_second_link():
    first, second = 0.5 * np.sin(TURNS) - 1.4, 0.9 * np.sin(1.3 * TURNS) - 1.2
    joint = _seen(first, 0.0, 0.0, 90.0)
    end = joint + 70.0 * np.stack([np.cos(second), -np.sin(second)], axis=1)
    about = about_pivot(_path(joint), "film.mp4")
    found = second_link(about, _path(end, seed=1), "film.mp4")
    assert isinstance(found, SecondLink)
    assert np.std(found.angle - second[found.frame]) < 0.2 / 70
    # a point 1 px beside the joint, on the first link: its error of the direction, without the mean, agrees with sigma
    beside = np.stack([np.cos(first), -np.sin(first)], axis=1)
    about = replace(about, place=about.place + beside[about.frame])
    moved = second_link(about, _path(end, seed=1), "film.mp4")
    error = moved.angle - second[moved.frame]
    error -= error.mean()
    assert float(np.std(error)) < 0.4 * 1.0 / 70
    assert 0.3 < float(np.sqrt(np.mean((error / moved.sigma) ** 2))) < 1.7
    elastic = joint + (70.0 + 8.0 * np.sin(3 * TURNS))[:, None] * (end - joint) / 70.0
    with pytest.raises(TrackingError, match="do not belong to a rigid body"):
        second_link(about, _path(elastic, seed=1), "film.mp4")
