"""Formulas and limits of the motion of a point: pivot, orbit, second link, and their uncertainties."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import TrackingError
from gyrotrack.tracking import _pivot
from gyrotrack.tracking import _point_motion as module
from gyrotrack.tracking._hub_search import FARTHEST
from gyrotrack.tracking._pivot import Arc, Orbit, angles_about, fit_arc, fit_orbit
from gyrotrack.tracking._point_motion import TrackedPoint, about_pivot, point_details, second_link
from gyrotrack.tracking._point_tracker import PointPath

HUB = np.array([160.0, 120.0])


def _on(angle, radius=90.0, hub=HUB):
    return hub + np.reshape(radius, (-1, 1)) * np.stack([np.cos(angle), -np.sin(angle)], axis=1)


def _path(place, formal=0.02, frame=None, radius=6.0, searched=None):
    count = len(place)
    frame = np.arange(count) if frame is None else frame
    covariance = np.tile(formal**2 * np.eye(2), (count, 1, 1))
    return PointPath(
        frame, place, covariance, radius, searched or count, turns=False, picture=np.zeros((9, 9))
    )


def _swinging(reach=0.4, count=60, radius=90.0, noise=0.02):
    angle = -0.5 * math.pi + reach * np.sin(np.linspace(0.0, 20.0, count))
    return _path(
        _on(angle, radius) + np.random.default_rng(0).normal(0.0, noise, (count, 2)), max(noise, 0.01)
    )


def _about(monkeypatch, path, pivot=None, tilt=None, **change):
    """The motion about a pivot, with a given arc."""
    arc = replace(Arc(HUB, 1e-6 * np.eye(2), 90.0, 1 / 90.0, 1e-7, 0.02, 0.0), **change)
    monkeypatch.setattr(module, "_tilted_orbit", lambda *_: None)
    monkeypatch.setattr(module, "fit_arc", lambda *_: arc)
    return about_pivot(path, "film", pivot, tilt)


ARC = Arc(HUB, np.diag([0.04, 0.09]), 90.0, 1 / 90.0, 1e-5, 0.02, 0.3)


def _point(place, **change):
    count = len(place)
    given = {
        "frame": np.arange(count),
        "place": place,
        "place_sigma": np.full((count, 2), 0.1),
        "angle": angles_about(HUB, place),
        "sigma": np.full(count, 1e-3),
        "hub": HUB,
        "hub_covariance": np.diag([0.04, 0.09]),
        "view": 0.1,
        "way": "test",
        "path": _path(place),
        "arc": ARC,
        "warnings": (),
    }
    return TrackedPoint(**{**given, **change})


def test_the_position_dependent_error_contains_the_perspective_of_a_tilted_camera():
    found = _point(_on(np.linspace(-0.5, 0.5, 21)))
    half = 0.5 * math.hypot(90.0 * (1 - math.cos(0.5)), 180.0 * math.sin(0.5))
    expected = math.hypot(half**3 * 0.35**2 / 640.0**2, 0.3) / 90.0
    assert found.error_by_place(640.0) == pytest.approx(expected)
    assert replace(found, view=0.0).error_by_place(640.0) == 0.0


def test_the_hub_is_displaced_by_one_sigma_along_each_axis():
    place = _on(np.linspace(0.0, 2.0, 9))
    # eigenvalues 4 and 1 along (1, 1) and (1, -1)
    covariance = np.array([[2.5, 1.5], [1.5, 2.5]])
    found = _point(place, hub_covariance=covariance).displaced()
    assert len(found) == 2
    options = {
        sigma: [angles_about(HUB + sign * sigma * np.array(axis) / math.sqrt(2.0), place) for sign in (1, -1)]
        for sigma, axis in ((1.0, (1.0, -1.0)), (2.0, (1.0, 1.0)))
    }
    for angle, both in zip(found, options.values(), strict=True):
        assert min(np.abs(angle - other).max() for other in both) < 1e-9


def test_the_orbit_about_a_tilted_axis_is_displaced_along_five_axes():
    orbit = Orbit(np.array([160.0, 120.0, 90.0, 0.1, 0.05]), np.diag([4.0, 1.0, 0.25, 1e-4, 9e-4]))
    place = _on(np.linspace(0.0, 6.0, 31))
    found = _point(place, orbit=orbit).displaced()
    assert len(found) == 5
    zero = angles_about(np.zeros(2), orbit.plane(place))
    sizes = sorted(float(np.std(angle - zero)) for angle in found)
    moved = []
    for k in range(5):
        value = orbit.value.copy()
        value[k] += math.sqrt(orbit.covariance[k, k])
        moved.append(
            float(np.std(angles_about(np.zeros(2), replace(orbit, value=value).plane(place)) - zero))
        )
    assert sizes == pytest.approx(sorted(moved), rel=0.15)


def test_the_noise_of_a_path_is_that_of_its_noisier_axis():
    rng = np.random.default_rng(2)
    noise = rng.normal(0.0, 1.0, (900, 2)) * [0.05, 0.3]
    path = _path(np.stack([np.linspace(0, 50, 900), np.linspace(0, 9, 900)], axis=1) + noise, 0.1)
    assert module._white_scale(path) == pytest.approx(3.0, rel=0.1)
    path.covariance[:, 1, 1] = 0.6**2
    assert module._white_scale(path) == 1.0


def test_a_patch_turns_clockwise_with_the_line_to_its_hub():
    angle = np.linspace(0.3, 2.3, 40)
    place = _on(angle)
    for hub in (tuple(HUB), None):
        np.testing.assert_allclose(module._turn_about(hub)(None, place), 0.3 - angle, atol=1e-6)
    straight = np.stack([np.linspace(0.0, 50.0, 40), np.zeros(40)], axis=1)
    straight[::2, 1] = 0.1
    assert module._turn_about(None)(None, straight) is None


def test_an_additional_error_of_position_acts_across_the_radius():
    place = HUB + np.array([[50.0, 0.0], [0.0, -25.0]])
    found = module._with_error(_point(place), np.tile(np.array([[0.16, 0.02], [0.02, 0.09]]), (2, 1, 1)))
    assert found.sigma == pytest.approx([math.hypot(1e-3, 0.3 / 50.0), math.hypot(1e-3, 0.4 / 25.0)])
    np.testing.assert_allclose(found.place_sigma, np.hypot(0.1, [[0.4, 0.3]] * 2))
    # along and across a radius that is not parallel to an axis
    oblique, along = HUB + np.array([[30.0, 40.0]]), np.array([[0.6, 0.8]])
    across = np.array([[-0.8, 0.6]])
    for direction, expected in ((along, 1e-3), (across, math.hypot(1e-3, 0.5 / 50.0))):
        shared = 0.25 * direction[:, :, None] * direction[:, None, :]
        assert module._with_error(_point(oblique), shared).sigma == pytest.approx([expected])
    np.testing.assert_allclose(found.path.covariance[0], [[0.16 + 4e-4, 0.02], [0.02, 0.09 + 4e-4]])


def _links(count=60, stretch=0.0, noise=0.0, beside=0.0):
    """Two links: angle of the joint about the hub, and direction of the second link; lengths 90 and 40 px."""
    t = np.linspace(0.0, 5.0, count)
    first, second = -1.5 + 0.8 * np.sin(2.0 * t), 0.3 + 2.4 * np.sin(3.1 * t)
    axis = _on(first)
    point = axis + beside * np.stack([np.cos(second), -np.sin(second)], axis=1)
    length = 40.0 * (1.0 + stretch * np.where(np.arange(count) % 2, 1.0, -1.0))
    rng = np.random.default_rng(0)
    end = axis + length[:, None] * np.stack([np.cos(second), -np.sin(second)], axis=1)
    return point + rng.normal(0, noise, (count, 2)), end + rng.normal(0, noise, (count, 2)), first, second


def test_the_second_link_points_from_the_joint_counter_clockwise():
    joint, end, first, second = _links(400)
    found = second_link(_point(joint, angle=first), _path(end, frame=np.arange(400)), "film")
    np.testing.assert_array_equal(found.frame, np.arange(400))
    np.testing.assert_allclose(found.angle, second, atol=1e-6)
    # 0.1 px of the joint and 0.02 px of the point across 40 px; no scatter enlarges them
    assert found.sigma == pytest.approx(np.hypot(math.hypot(0.1, 0.02) / 40.0, found.off_axis), rel=1e-3)
    least = math.sqrt(2.0) * 0.05 / 40.0
    np.testing.assert_allclose(found.off_axis, least, rtol=0.1)
    np.testing.assert_allclose(found.path.covariance, 4e-4 * np.tile(np.eye(2), (400, 1, 1)))


def test_the_scatter_of_the_distance_is_the_error_of_the_point():
    joint, end, first, _ = _links(400, noise=0.2)
    found = second_link(
        _point(joint, angle=first, place_sigma=np.full((400, 2), 0.2)),
        _path(end, 0.02, np.arange(400)),
        "film",
    )
    # the noise of either end is 0.2 px per axis
    assert np.sqrt(found.path.covariance[:, 0, 0]) == pytest.approx(np.full(400, 0.2), rel=0.1)
    own = np.sqrt(found.sigma**2 - found.off_axis**2)
    assert np.median(own) == pytest.approx(math.sqrt(2.0) * 0.2 / 40.0, rel=0.1)


def test_a_slow_error_of_the_distance_enlarges_the_uncertainty_of_the_point():
    joint, end, first, second = _links(400)
    slow = 0.2 * np.sin(np.linspace(0.0, 61.0, 400))  # 0.141 px rms along the link
    end = end + slow[:, None] * np.stack([np.cos(second), -np.sin(second)], axis=1)
    found = second_link(
        _point(joint, angle=first, place_sigma=np.full((400, 2), 0.05)), _path(end, 0.02), "film"
    )
    expected = math.sqrt(0.02 - 0.05**2)
    assert np.sqrt(found.path.covariance[:, 0, 0]) == pytest.approx(np.full(400, expected), rel=0.1)


@pytest.mark.parametrize(("common", "known"), [(6, False), (7, True)])
def test_a_second_link_is_measured_in_seven_common_frames(common, known):
    joint, end, first, _ = _links(20)
    path = _path(end, frame=np.arange(20) + 20 - common)
    if not known:
        with pytest.raises(TrackingError, match="together in only 6 frames"):
            second_link(_point(joint, angle=first), path, "film")
    else:
        assert (
            len(second_link(_point(_links(7)[0], angle=_links(7)[2]), _path(_links(7)[1]), "film").frame) == 7
        )


@pytest.mark.parametrize(("stretch", "rigid"), [(0.049, True), (0.051, False)])
def test_a_second_link_has_a_constant_length(stretch, rigid):
    joint, end, first, _ = _links(stretch=stretch)
    if rigid:
        second_link(_point(joint, angle=first), _path(end), "film")
    else:
        with pytest.raises(TrackingError, match="do not belong to a rigid body"):
            second_link(_point(joint, angle=first), _path(end), "film")


@pytest.mark.parametrize(("beside", "corrected"), [(2.0, True), (0.0, False)])
def test_a_joint_beside_its_axis_on_the_second_link_is_corrected(beside, corrected):
    joint, _, first, second = _links(60, noise=0.02, beside=beside)
    link = SimpleNamespace(frame=np.arange(60), angle=second)
    found = module._on_second_link(_point(joint, angle=first), link)
    assert (found is not None) == corrected
    if corrected:
        path, shared = found
        np.testing.assert_allclose(path.place, _on(first), atol=0.2)
        assert shared.shape == (60, 2, 2)
        assert 0.0 < np.trace(shared[0]) < 0.1


def test_a_prior_limits_the_first_two_parameters():
    t = np.linspace(0.0, 1.0, 400)
    rows = np.stack([np.cos(9 * t), np.sin(9 * t), np.ones(400)], axis=1)
    found, covariance, rest = module._with_prior(rows, rows @ [0.5, -0.3, 7.0], 2.0)
    np.testing.assert_allclose(found, [0.5, -0.3, 7.0], atol=1e-6)
    assert rest < 1e-6
    noise = 3.0 * np.random.default_rng(0).normal(0.0, 1.0, 400)
    found, covariance, rest = module._with_prior(rows, noise, 0.1)
    assert rest == pytest.approx(3.0, rel=0.1)
    expected = np.linalg.inv(rows.T @ rows / 9.0 + np.diag([100.0, 100.0, 0.0]))
    np.testing.assert_allclose(np.diag(covariance), np.diag(expected), rtol=0.2)
    assert np.abs(found[:2]).max() < 0.1


def test_correlated_residuals_are_fewer_independent_ones():
    rng = np.random.default_rng(1)
    noise = rng.normal(0.0, 1.0, 4000)
    for k in range(1, 4000):
        noise[k] = 0.6 * noise[k - 1] + 0.8 * noise[k]
    rows = np.stack([np.zeros(4000), np.zeros(4000), np.ones(4000)], axis=1)
    _, covariance, rest = module._with_prior(rows, noise, 1.0)
    assert covariance[2, 2] == pytest.approx(rest**2 * 1.6 / 0.4 / 4000, rel=0.1)


def test_a_displaced_point_appears_across_the_second_link():
    phi = np.linspace(-1.5, 1.5, 200)
    d = 0.8 - 0.4j
    length = 40.0 - np.real(d * np.exp(-1j * phi))
    shift, sigma, rest = module._beside_joint(length, phi, 1.0)
    np.testing.assert_allclose(shift, np.imag(d * np.exp(-1j * phi)), atol=1e-4)
    assert rest < 1e-4
    assert sigma.max() < 1e-3


def test_two_estimates_are_weighted_by_their_covariances():
    mean, covariance = module._combined(
        np.array([1.0, 2.0]), np.diag([1.0, 4.0]), np.array([4.0, -3.0]), np.diag([2.0, 1.0])
    )
    np.testing.assert_allclose(mean, [(1.0 / 1.0 + 4.0 / 2.0) / 1.5, (2.0 / 4.0 - 3.0) / 1.25])
    np.testing.assert_allclose(covariance, np.diag([1 / 1.5, 1 / 1.25]))


@pytest.mark.parametrize(
    ("tilt", "view"), [(None, math.sqrt(3.0) / 2.0 * 0.35**2), (0.5, 0.5 * math.tan(0.5) * 0.05)]
)
def test_the_unknown_tilt_scales_the_angles_of_an_arc(tilt, view, monkeypatch):
    found = _about(monkeypatch, _swinging(), tilt=tilt)
    assert found.view == pytest.approx(view)
    assert len(found.warnings) == 1
    assert (found.way, found.ambiguous) == ("arc of a point", False)
    assert found.hub == pytest.approx(HUB)
    assert _about(monkeypatch, _swinging(1.6), tilt=tilt).view == 0.0


@pytest.mark.parametrize(("reach", "wide"), [(1.5, False), (1.65, True)])
def test_half_a_turn_determines_the_view(reach, wide, monkeypatch):
    assert (_about(monkeypatch, _swinging(reach)).view == 0.0) == wide
    found = _about(monkeypatch, _swinging(reach), (160.5, 120.0))
    assert (found.way == "given and arc of a point") == wide


def test_a_given_hub_is_combined_with_the_arc_of_half_a_turn(monkeypatch):
    covariance = np.diag([1.5, 0.5])
    found = _about(monkeypatch, _swinging(1.9), (161.0, 119.0), covariance=covariance)
    distance = np.median(np.hypot(*(found.place - [161.0, 119.0]).T))
    prior = (1.0 + (0.02 * distance) ** 2) * np.eye(2)
    mean, both = module._combined(np.array([161.0, 119.0]), prior, HUB, covariance)
    np.testing.assert_allclose(found.hub, mean)
    np.testing.assert_allclose(found.hub_covariance, both)
    assert not found.ambiguous


@pytest.mark.parametrize(("off", "doubt"), [(5.9, False), (6.5, True)])
def test_a_given_hub_three_sigma_from_the_arc_is_doubted(off, doubt, monkeypatch):
    """The standard uncertainty is hypot(1, 0.02 * 90) = 2.06 px per axis."""
    assert _about(monkeypatch, _swinging(1.9), (160.0 + off, 120.0)).ambiguous == doubt


@pytest.mark.parametrize(("off", "doubt"), [(47.0, False), (53.0, True)])
def test_a_tilt_explains_a_hub_at_another_distance_along_a_short_arc(off, doubt, monkeypatch):
    """Three times hypot(0.2122 R, 1, 0.02 d) px; R is 90 px, and d the larger distance of the given hub."""
    distance = 90.0 + off
    limit = 3.0 * math.hypot(math.sqrt(3.0) * 0.35**2 * distance, 1.0, 0.02 * distance)
    path = _swinging()
    away = path.place.mean(axis=0) - HUB
    given = HUB - off * away / np.hypot(*away)
    assert (off > limit) == (off > 100.0)  # not reached on this side
    assert not _about(monkeypatch, path, tuple(given)).ambiguous
    # nearer to the path: the limit is that of the arc of 90 px
    near = HUB + (off + 8.0) * away / np.hypot(*away)
    limit = 3.0 * math.hypot(math.sqrt(3.0) * 0.35**2 * 90.0, 1.0, 0.02 * (82.0 - off))
    assert 47.0 + 8.0 < limit < 53.0 + 8.0
    assert _about(monkeypatch, path, tuple(near)).ambiguous == doubt


def test_hub_and_curvature_share_the_error_of_a_tilt(monkeypatch):
    path = _swinging(noise=0.0)
    given = HUB + np.array([0.0, 9.0])  # at 81 px
    found = _about(monkeypatch, path, tuple(given), curvature_u=0.02 / 90.0)
    distance = np.median(np.hypot(*(path.place - given).T))
    assert found.view == pytest.approx(math.hypot(0.5 * math.log(90.0 / distance), 0.01))
    assert found.way == "given, for a point"
    assert len(found.warnings) == 1
    np.testing.assert_allclose(found.hub_covariance, (1.0 + (0.02 * distance) ** 2) * np.eye(2))
    # log(90 / 81) = 0.105 is less than three times 4 %
    assert _about(monkeypatch, path, tuple(given), curvature_u=0.04 / 90.0).warnings == ()


@pytest.mark.parametrize(("times", "far"), [(99.0, False), (101.0, True)])
def test_a_hub_is_near_enough_to_be_measured(times, far, monkeypatch):
    path = _swinging()
    radius = times / 100.0 * FARTHEST * np.abs(path.place).max()
    direction = (path.place.mean(axis=0) - HUB) / np.hypot(*(path.place.mean(axis=0) - HUB))
    hub = path.place.mean(axis=0) - radius * direction
    # the path is not on this circle: all positions are accepted
    given = {"hub": hub, "radius": radius, "curvature": 1.0 / radius, "curvature_u": 1e-9, "by_place": 99.0}
    if far:
        with pytest.raises(TrackingError, match="straight within its uncertainty"):
            _about(monkeypatch, path, **given)
    else:
        assert _about(monkeypatch, path, **given).hub == pytest.approx(hub)


@pytest.mark.parametrize(("extent", "moves"), [(0.97, False), (1.03, True)])
def test_a_point_that_moves_by_a_pixel_is_measured(extent, moves, monkeypatch):
    path = _swinging(extent / 180.0, noise=1e-4)
    if moves:
        found = _about(monkeypatch, path, tuple(HUB), noise=1e-4)
        assert np.ptp(found.angle) == pytest.approx(extent / 90.0, rel=0.02)
        assert found.ambiguous  # it moves by less than the size of the patch
        assert not _about(monkeypatch, replace(path, radius=0.9), tuple(HUB), noise=1e-4).ambiguous
    else:
        with pytest.raises(TrackingError, match="does not move"):
            _about(monkeypatch, path, tuple(HUB), noise=1e-4)


@pytest.mark.parametrize(("times", "moves"), [(11.8, False), (12.2, True)])
def test_a_path_exceeds_twelve_times_its_noise(times, moves, monkeypatch):
    path = _swinging(noise=0.0)
    extent = np.hypot(*np.ptp(path.place, axis=0))
    if moves:
        _about(monkeypatch, path, noise=extent / times)
    else:
        with pytest.raises(TrackingError, match="does not move"):
            _about(monkeypatch, path, noise=extent / times)


@pytest.mark.parametrize(
    ("noise", "by_place", "limit"), [(0.01, 0.0, 0.5), (0.3, 0.4, 8.0 * 0.5), (0.5, 0.0, 8.0 * 0.5)]
)
def test_positions_off_the_arc_are_removed(noise, by_place, limit, monkeypatch):
    path = _swinging(noise=0.0)
    for off, count in ((0.95 * limit, 60), (1.05 * limit, 59)):
        place = path.place.copy()
        away = place[33] - HUB
        place[33] = HUB + away / np.hypot(*away) * (90.0 + off)
        found = _about(monkeypatch, replace(path, place=place), noise=noise, by_place=by_place)
        assert len(found.frame) == count


@pytest.mark.parametrize(
    ("wrong", "hub", "count"), [(12, None, 48), (13, None, 0), (13, tuple(HUB), 60), (12, tuple(HUB), 48)]
)
def test_four_fifths_of_the_positions_are_on_the_arc(wrong, hub, count, monkeypatch):
    path = _swinging(noise=0.0)
    path.place[:wrong] += 20.0
    if count:
        assert len(_about(monkeypatch, path, hub).frame) == count
    else:
        with pytest.raises(TrackingError, match="not an arc of a circle"):
            _about(monkeypatch, path, hub)


def test_the_noise_of_positions_is_that_across_and_along_the_path(monkeypatch):
    angle = np.linspace(0.0, 1.0, 400)
    rng = np.random.default_rng(3)
    path = _path(_on(angle + rng.normal(0.0, 0.3 / 90.0, 400)), 0.1)
    found = _about(monkeypatch, path, noise=0.25)
    # across the path 0.25 px from the arc, along the path 0.3 px from the scatter of the angles
    np.testing.assert_allclose(found.sigma, 0.3 / 90.0, rtol=0.1)
    outward = (path.place - HUB) / 90.0
    along = np.stack([-outward[:, 1], outward[:, 0]], axis=1)
    np.testing.assert_allclose(found.place_sigma, np.hypot(0.25 * outward, 0.3 * along), rtol=0.1)


def _ellipse(theta, value):
    x, y, r, p, q = value
    shape = np.array([[1 + p, q], [q, 1 - p]])
    return np.array([x, y]) + r * np.stack([np.cos(theta), np.sin(theta)], axis=1) @ shape.T


TILTED = np.array([160.0, 120.0, 90.0, 0.06, -0.08])


def test_an_orbit_is_fitted_exactly():
    theta = np.linspace(0.0, 6.2, 120)
    orbit = fit_orbit(_ellipse(theta, TILTED), np.full(120, 0.1))
    np.testing.assert_allclose(orbit.value, TILTED, atol=1e-5)
    np.testing.assert_allclose(orbit.plane(_ellipse(theta, TILTED)), _on(-theta, hub=np.zeros(2)), atol=1e-4)


def test_a_tilt_is_the_ratio_of_the_axes():
    # s = 0.1 and the long axis at half of the direction of (p, q); y is down
    orbit = Orbit(TILTED, np.diag([1.0, 1.0, 1.0, 1e-4, 4e-4]))
    tilt, short = orbit.tilt
    assert tilt == pytest.approx(math.acos(0.9 / 1.1))
    long = 0.5 * math.atan2(-0.08, 0.06)
    assert short == pytest.approx((-long - 0.5 * math.pi) % math.pi)
    # along (0.6, -0.8): 0.36 1e-4 + 0.64 4e-4; d tilt by s by finite differences
    u = math.sqrt(0.36 * 1e-4 + 0.64 * 4e-4)
    slope = (math.acos(0.8999 / 1.1001) - math.acos(0.9001 / 1.0999)) / 2e-4
    assert orbit.tilt_u == pytest.approx(slope * u, rel=1e-4)


def test_the_covariance_of_an_orbit_is_that_of_independent_radii():
    theta = np.linspace(0.0, 2.0 * np.pi, 240, endpoint=False)
    place = _on(theta) + 0.1 * np.where(np.arange(240) % 2, 1.0, -1.0)[:, None] * np.stack(
        [np.cos(theta), -np.sin(theta)], axis=1
    )
    covariance = fit_orbit(place, np.full(240, 0.1)).covariance
    # radial residuals: hub 2 s^2 / n, radius s^2 / n, stretch 2 s^2 / (n r^2)
    variance = 0.01 / 240
    np.testing.assert_allclose(
        np.diag(covariance), variance * np.array([2.0, 2.0, 1.0, 2.0 / 8100.0, 2.0 / 8100.0]), rtol=0.12
    )


@pytest.mark.parametrize(("least", "by_place"), [(0.0, 0.0), (0.5, 0.5)])
def test_the_covariance_of_a_circle_is_that_of_noise_and_of_twelve_places(least, by_place):
    theta = np.linspace(0.0, 2.0 * np.pi, 120, endpoint=False)
    radius = 90.0 + 0.1 * np.where(np.arange(120) % 2, 1.0, -1.0)
    arc = fit_arc(_on(theta, radius), np.full(120, 0.03), least)
    assert arc.hub == pytest.approx(HUB, abs=1e-3)
    assert arc.radius == pytest.approx(90.0, rel=1e-6)
    assert arc.curvature == pytest.approx(1.0 / 90.0, rel=1e-6)
    assert arc.noise == pytest.approx(0.1 * math.sqrt(120 / 108), rel=0.01)  # 12 means
    assert arc.by_place == pytest.approx(by_place)
    variance = 0.01 / 108 + by_place**2 / 12.0
    np.testing.assert_allclose(np.diag(arc.covariance), 2.0 * variance, rtol=0.1)
    assert arc.curvature_u == pytest.approx(math.sqrt(variance) / 8100.0, rel=0.1)


def test_the_covariance_of_an_orbit_does_not_depend_on_its_mean_position():
    """Some more positions on one side displace the mean position by 4.8 and 5.2 % of the radius."""
    found = []
    for share in (0.048, 0.052):
        k = np.arange(144)
        theta = 2.0 * np.pi * k / 144 - 2.0 * share * np.sin(2.0 * np.pi * k / 144)
        radius = 90.0 + 0.1 * np.where(k % 2, 1.0, -1.0)
        found.append(fit_arc(_on(theta, radius), np.full(144, 0.1), 0.05))
    one, two = found
    np.testing.assert_allclose(one.covariance, two.covariance, rtol=0.05, atol=1e-6)
    assert one.curvature_u == pytest.approx(two.curvature_u, rel=0.03)


def test_errors_of_a_place_are_those_beyond_noise():
    theta = np.linspace(0.0, 2.0 * np.pi, 240, endpoint=False)
    errors = 0.4 * np.where((np.arange(240) // 20) % 2, 1.0, -1.0)
    arc = fit_arc(_on(theta, 90.0 + errors), np.full(240, 0.03))
    # 12 means of +-0.4 px with 12 - 3 degrees of freedom
    assert arc.by_place == pytest.approx(0.4 * math.sqrt(12.0 / 9.0), rel=0.12)
    assert arc.noise < 0.2


def test_parts_of_an_arc_have_equal_angles_or_lengths():
    theta = np.linspace(-1.0, 1.0, 241)
    cell = _pivot._cell(np.cos(theta), np.sin(theta), np.zeros(2), straight=False)
    assert (len(np.bincount(cell)), set(np.bincount(cell))) == (12, {19, 20, 21})
    assert (np.diff(cell) >= 0).all() or (np.diff(cell) <= 0).all()
    x = np.linspace(0.0, 9.0, 121)
    cell = _pivot._cell(x, 2.0 * x, np.zeros(2), straight=True)
    assert sorted(np.bincount(cell).tolist()) == [10] * 11 + [11]


def _tilted(monkeypatch, place, noise=0.02, hub=None):
    monkeypatch.setattr(module, "fit_arc", lambda *_: ARC)
    path = _path(place, noise)
    orbit = Orbit(TILTED, np.diag([1e-4, 1e-4, 1e-4, 1e-8, 1e-8]))
    return module._about_tilted_axis(path, orbit, np.full(len(place), noise), 0.01, hub)


def test_angles_about_a_tilted_axis_are_in_the_plane_of_the_body(monkeypatch):
    theta = np.linspace(0.0, 12.0, 400)
    place = _ellipse(theta, TILTED) + np.random.default_rng(0).normal(0, 0.06, (400, 2))
    place[17] += (0.0, 9.0)
    found = _tilted(monkeypatch, place)
    assert found.way == "ellipse of a point"
    np.testing.assert_array_equal(found.frame, np.delete(np.arange(400), 17))
    assert np.std(found.angle + np.delete(theta, 17)) < 1.2e-3
    assert found.view == 0.0
    # the noise of 0.06 px is three times the formal one
    assert np.median(found.sigma) == pytest.approx(0.06 / 90.0, rel=0.1)
    assert found.place_sigma == pytest.approx(np.full((399, 2), 0.06), rel=0.15)
    np.testing.assert_array_equal(found.hub, [160.0, 120.0])
    np.testing.assert_allclose(found.hub_covariance, 1e-4 * np.eye(2))
    assert not found.ambiguous
    least = _tilted(monkeypatch, _ellipse(theta, TILTED), 0.5)
    # 0.5 px per axis of the picture, across the radius in the plane of the body
    back = np.linalg.inv(np.array([[1.06, -0.08], [-0.08, 0.94]]))
    across = np.stack([-np.sin(theta), np.cos(theta)], axis=1)
    np.testing.assert_allclose(least.sigma, 0.5 / 90.0 * np.hypot(*(across @ back).T), rtol=1e-6)


@pytest.mark.parametrize(("shift", "doubt"), [(2.9, False), (3.1, True)])
def test_a_given_hub_beside_the_centre_of_an_orbit_is_doubted(shift, doubt, monkeypatch):
    place = _ellipse(np.linspace(0.0, 12.0, 60), TILTED)
    assert _tilted(monkeypatch, place, hub=(160.0 + shift, 120.0)).ambiguous == doubt


def test_an_ellipse_is_used_without_a_given_tilt(monkeypatch):
    path = _path(_on(np.linspace(0.0, 6.0, 60)))
    assert _about(monkeypatch, path).orbit is None
    orbit = Orbit(np.array([160.0, 120.0, 90.0, 1e-6, 0.0]), np.diag([1e-4, 1e-4, 1e-4, 1e-8, 1e-8]))
    monkeypatch.setattr(module, "_tilted_orbit", lambda *_: orbit)
    assert about_pivot(path, "film").orbit is orbit
    assert about_pivot(path, "film", tilt=0.1).orbit is None


def _shows_a_tilt(monkeypatch, place, value=TILTED):
    """Whether an ellipse of given parameters is used instead of a circle of 90 px."""
    orbit = Orbit(np.asarray(value), np.diag([1e-4, 1e-4, 1e-4, 1e-8, 1e-8]))
    monkeypatch.setattr(module, "fit_orbit", lambda *_: orbit)
    monkeypatch.setattr(module, "fit_arc", lambda *_: ARC)
    return module._tilted_orbit(place, np.full(len(place), 0.02), 0.01) is not None


@pytest.mark.parametrize(("gap", "tilted"), [(1.5, True), (1.65, False)])
def test_an_orbit_with_a_gap_of_a_quarter_of_a_turn_shows_no_tilt(gap, tilted, monkeypatch):
    place = _ellipse(np.linspace(0.3, 0.3 + 2.0 * np.pi - gap, 120), TILTED)
    assert _shows_a_tilt(monkeypatch, place) == tilted


@pytest.mark.parametrize(("count", "tilted"), [(23, False), (24, True)])
def test_an_orbit_has_twenty_four_positions(count, tilted, monkeypatch):
    assert _shows_a_tilt(monkeypatch, _ellipse(np.linspace(0.0, 6.0, count), TILTED)) == tilted


@pytest.mark.parametrize(("size", "tilted"), [(0.59, True), (0.61, False)])
def test_an_orbit_is_tilted_by_less_than_75_degrees(size, tilted, monkeypatch):
    value = np.array([160.0, 120.0, 90.0, 0.6 * size, 0.8 * size])
    assert _shows_a_tilt(monkeypatch, _ellipse(np.linspace(0.0, 6.2, 120), value), value) == tilted


@pytest.mark.parametrize(("noise", "tilted"), [(2.6, True), (2.8, False)])
def test_an_orbit_deviates_from_an_ellipse_by_three_percent(noise, tilted, monkeypatch):
    radius = 90.0 + noise * np.where(np.arange(240) % 2, 1.0, -1.0)
    value = np.array([160.0, 120.0, 90.0, 0.12, -0.16])
    unit = _ellipse(np.linspace(0.0, 6.2, 240), [0.0, 0.0, 1.0, *value[3:]])
    assert _shows_a_tilt(monkeypatch, HUB + radius[:, None] * unit, value) == tilted


@pytest.mark.parametrize(("noise", "tilted"), [(0.5, True), (0.54, False)])
def test_an_ellipse_halves_the_deviation_from_a_circle(noise, tilted, monkeypatch):
    """A stretch s displaces radii by r s / sqrt(2) rms from a circle, 0.9 px, beside the noise."""
    theta = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    radius = 90.0 + noise * np.where(np.arange(720) % 2, 1.0, -1.0)
    value = np.array([160.0, 120.0, 90.0, 0.01 * math.sqrt(2.0), 0.0])
    place = HUB + radius[:, None] * _ellipse(theta, [0.0, 0.0, 1.0, *value[3:]])
    assert (noise < 0.5 * math.hypot(0.9, noise)) == tilted
    assert _shows_a_tilt(monkeypatch, place, value) == tilted


def _unselected(angle, searched=None, noise=0.02, by_place=0.0, frame=None):
    path = _path(_on(angle), frame=frame, searched=searched)
    found = SimpleNamespace(path=path, angle=angle, arc=SimpleNamespace(noise=noise, by_place=by_place))
    try:
        module._check_unselected(found, "film")
    except TrackingError:
        return False
    return True


def _pendulum(passes, reach=0.8):
    return 0.7 - reach * np.cos(np.linspace(0.0, np.pi * passes, 30 * passes + 1))


def test_an_unselected_point_passes_its_middle_three_times_or_turns():
    assert not _unselected(_pendulum(2))
    assert _unselected(_pendulum(3))
    assert not _unselected(np.linspace(0.0, 1.15 * 2 * np.pi, 99))
    assert _unselected(np.linspace(0.0, 1.25 * 2 * np.pi, 99))


def test_lost_frames_are_not_a_jump():
    kept = np.setdiff1d(np.arange(91), np.arange(42, 49))  # in the middle of the second passage
    assert _unselected(_pendulum(3)[kept], 91, frame=kept)
    assert not _unselected(_pendulum(3)[kept], 91)


@pytest.mark.parametrize(("searched", "accepted"), [(101, True), (102, False)])
def test_an_unselected_point_is_seen_in_nine_frames_of_ten(searched, accepted):
    assert len(_pendulum(3)) == 91
    assert _unselected(_pendulum(3), searched) == accepted


@pytest.mark.parametrize(("share", "accepted"), [(0.029, True), (0.031, False)])
def test_an_unselected_point_scatters_by_three_percent_of_its_path(share, accepted):
    extent = float(np.hypot(*np.ptp(_on(_pendulum(4)), axis=0)))
    assert _unselected(_pendulum(4), noise=0.6 * share * extent, by_place=0.8 * share * extent) == accepted


def test_the_details_of_a_point_are_plain_numbers():
    orbit = Orbit(TILTED, np.diag([1.0, 1.0, 1.0, 1e-4, 4e-4]))
    found = _point(_on(np.linspace(0.0, 1.0, 9)), orbit=orbit)
    details = point_details(found)
    assert details["hub_px"] == [160.0, 120.0]
    assert details["hub_covariance_px2"] == [[0.04, 0.0], [0.0, 0.09]]
    assert details["view_relative_u"] == 0.1
    assert details["arc_px"] == {"hub": [160.0, 120.0], "radius": 90.0, "noise": 0.02, "by_place": 0.3}
    assert details["tilt_rad"] == [*orbit.tilt, orbit.tilt_u]
    assert (details["patch_px"], details["patch_turns"]) == (6.0, False)
    assert point_details(replace(found, orbit=None))["tilt_rad"] is None


def test_a_jump_of_the_angle_is_not_a_turn():
    """Of 1.5 turns, 0.4 turns are one step."""
    smooth = np.linspace(0.0, 1.25 * 2 * np.pi, 120)
    assert _unselected(smooth)
    jump = np.where(np.arange(120) < 100, smooth, smooth + 0.4 * 2 * np.pi)
    assert _unselected(jump)
    short = np.linspace(0.0, 1.1 * 2 * np.pi, 120)
    assert not _unselected(np.where(np.arange(120) < 100, short, short + 0.4 * 2 * np.pi))


def test_residuals_that_are_all_alike_are_a_fortieth_of_independent_ones():
    rows = np.stack([np.zeros(4000), np.zeros(4000), np.ones(4000)], axis=1)
    found, covariance, rest = module._with_prior(rows, np.linspace(4.0, 6.0, 4000), 1.0)
    assert found[2] == pytest.approx(5.0)
    assert rest == pytest.approx(1.0 / math.sqrt(3.0), rel=1e-3)
    assert covariance[2, 2] == pytest.approx(1.0 / 3.0 * 1.95 / 0.05 / 4000, rel=1e-2)


@pytest.mark.parametrize("start", [None, (3.0, 4.0)])
@pytest.mark.parametrize("fits", [True, False])
def test_a_path_without_a_pivot_is_returned_with_its_noise(monkeypatch, start, fits):
    path = _path(_on(np.linspace(0.0, 1.0, 9)), 0.1)
    asked = []

    def of_path(film, given, first, hub):
        asked.append((film, given, first, hub))
        if not fits:
            raise TrackingError("straight", "")
        return "point"

    monkeypatch.setattr(module, "track_point", lambda film, first, turn, progress: path)
    monkeypatch.setattr(module, "_of_path", of_path)
    monkeypatch.setattr(module, "_white_scale", lambda _: 3.0)
    if start is None and not fits:
        with pytest.raises(TrackingError):
            module.follow_path("film", start, (1.0, 2.0))
        return
    found = module.follow_path("film", start, (1.0, 2.0))
    assert asked == [("film", path, start, (1.0, 2.0))]
    if fits:
        assert found == "point"
    else:
        np.testing.assert_allclose(found.covariance, np.tile(0.09 * np.eye(2), (9, 1, 1)))


@pytest.mark.parametrize("second", [True, False])
def test_another_rotation_about_the_pivot_is_searched_for_in_300_frames(monkeypatch, second):
    found = _point(_on(np.linspace(0.0, 3.0, 400)), frame=2 * np.arange(400))
    asked = []

    def second_rotation(frames, motion, hub, angle):
        asked.append((frames, motion, hub, angle))
        return SimpleNamespace(warning=lambda first: f"range {np.ptp(first):.6f}") if second else None

    film = SimpleNamespace(some=lambda index: index.tolist())
    monkeypatch.setattr(module, "second_rotation", second_rotation)
    monkeypatch.setattr(module.Motion, "of", staticmethod(lambda frames: ("motion", len(frames))))
    text = module._second_rotation(film, found)
    assert text == (f"range {np.ptp(found.angle[:300]):.6f}" if second else None)
    ((frames, motion, hub, angle),) = asked
    assert frames == (2 * np.arange(300)).tolist()
    assert (motion, hub) == (("motion", 300), (160.0, 120.0))
    np.testing.assert_array_equal(angle, -found.angle[:300])
    assert module._second_rotation(film, replace(found, orbit=Orbit(TILTED, np.eye(5)))) is None


@pytest.mark.parametrize(
    ("start", "searched", "keeps", "reach", "words"),
    [
        ((1.0, 2.0), 60, False, 1.0, []),
        ((1.0, 2.0), 63, False, 1.0, ["in 3 of 63"]),
        ((1.0, 2.0), 60, True, 3.2, ["keeps its orientation"]),
        ((1.0, 2.0), 60, True, 3.1, []),
        (None, 60, False, 1.0, ["followed as a point", "second body"]),
    ],
)
def test_doubts_about_a_followed_point_are_stated_in_order(monkeypatch, start, searched, keeps, reach, words):
    path = replace(_path(_on(np.linspace(0.0, reach, 60)), searched=searched), keeps=keeps)
    point = _point(path.place, path=path, warnings=("own",))
    asked = []

    def about(given, name, hub, tilt):
        asked.append((given, name, hub, tilt))
        return point

    monkeypatch.setattr(module, "about_pivot", about)
    monkeypatch.setattr(module, "_check_unselected", lambda *_: None)
    monkeypatch.setattr(module, "_second_rotation", lambda *_: "second body")
    film = SimpleNamespace(
        path=SimpleNamespace(name="name"), tilt=SimpleNamespace(angle=0.3), warnings=("film",)
    )
    found = module._of_path(film, path, start, (5.0, 6.0))
    assert asked == [(path, "name", (5.0, 6.0), 0.3)]
    first, *rest = found.warnings
    assert first == "film"
    assert rest.pop(-1 if start else -2) == "own"
    assert len(rest) == len(words)
    assert all(w in r for w, r in zip(words, rest, strict=True))
    assert found.ambiguous == (start is None)


@pytest.mark.parametrize(("first", "shift"), [(0, 3.0), (1, 0.0)])
@pytest.mark.parametrize("beside", [True, False])
def test_links_are_followed_from_their_joint(monkeypatch, first, shift, beside):
    """The point on the second link turns about the joint; the joint's patch may be beside the clicked place."""
    joint = _point(_on(np.linspace(0.0, 1.0, 9)), frame=np.arange(first, first + 9))
    start = tuple(joint.place[0] + [3.0, 0.0])
    film = SimpleNamespace(path=SimpleNamespace(name="name"))
    told = SimpleNamespace(turns=[], links=[], errors=[], paths=[])
    moved, shared = _path(joint.place + 1.0, frame=joint.frame), np.tile(9.0 * np.eye(2), (9, 1, 1))

    def track_point(given, start_, turn_of, progress):
        place = np.stack([np.interp(joint.frame, joint.frame, joint.place[:, i]) for i in (0, 1)], axis=1)
        away = 20.0 * np.stack([np.cos(2.0 + 0.3 * joint.frame), np.sin(2.0 + 0.3 * joint.frame)], axis=1)
        told.turns.append((start_, turn_of(joint.frame, place + away)))
        return "path"

    def second_link(one, path, name, off):
        told.links.append((one, path, name, off))
        return "second"

    def of_path(given, path, start_, hub):
        told.paths.append((path, start_, hub))
        return replace(joint, frame=joint.frame[2:])

    monkeypatch.setattr(module, "follow_point", lambda given, start_, hub, progress: joint)
    monkeypatch.setattr(module, "track_point", track_point)
    monkeypatch.setattr(module, "fresh_frames", lambda given: np.arange(20))
    monkeypatch.setattr(module, "second_link", second_link)
    monkeypatch.setattr(module, "_on_second_link", lambda *_: (moved, shared) if beside else None)
    monkeypatch.setattr(module, "_of_path", of_path)
    monkeypatch.setattr(module, "_with_error", lambda one, error: told.errors.append(error) or one)
    found, second = module.follow_links(film, (start, (7.0, 8.0)), (1.0, 2.0))
    assert second == "second"
    ((given, turn),) = told.turns
    assert given == (7.0, 8.0)
    np.testing.assert_allclose(turn, 0.3 * np.arange(9))
    off = math.hypot(1.0, shift)
    assert [link[1:] for link in told.links] == [("path", "name", pytest.approx(off))] * (1 + beside)
    assert told.links[0][0] is joint
    if beside:
        assert told.paths == [(moved, start, (1.0, 2.0))]
        np.testing.assert_array_equal(told.errors[0], shared[2:])
        assert len(found.frame) == 7
    np.testing.assert_allclose(told.errors[-1], np.tile(0.05**2 * np.eye(2), (len(found.frame), 1, 1)))
    assert len(told.errors) == 1 + beside
