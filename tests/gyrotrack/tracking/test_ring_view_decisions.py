"""Formulas of the view of a ring, computed a second time sample by sample, and its limits."""

import numpy as np
import pytest

from gyrotrack.tracking import _ring_view as view
from gyrotrack.tracking._ring_view import VIEW_SIZE, View, ViewResponse

TURN = 2 * np.pi
ORDERS = (1, 2, 1, 1)  # of centre, flattening, shading and perspective


def rotation(angle):
    """Return the matrix that turns a view into coordinates of a body at an angle [rad]."""
    found = np.zeros((8, 8))
    for k, order in enumerate(ORDERS):
        cos, sin = np.cos(order * angle), np.sin(order * angle)
        found[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[cos, sin], [-sin, cos]]
    return found


def test_rotations_are_those_of_each_order():
    angle = np.array([0.0, 0.4, -2.0])
    np.testing.assert_allclose(view._rotations(angle), [rotation(a) for a in angle], atol=1e-15)


def response(zones=3, samples=12, seed=0):
    rng = np.random.default_rng(seed)
    change = rng.normal(size=(zones, samples, 8)).astype(np.float32)
    half = rng.normal(size=(zones, 8, 8))
    return ViewResponse(change, rng.normal(size=(zones, 8)), half @ half.transpose(0, 2, 1), 6)


@pytest.mark.parametrize("together", [1.0, 4.0])
def test_a_view_is_the_posterior_mean_over_frames_and_zones(together):
    rng = np.random.default_rng(1)
    own, angle = response(), np.linspace(0.0, 5.0, 9)
    residuals = [rng.normal(size=(9, 12)).astype(np.float32) for _ in range(3)]
    weight = rng.uniform(0.5, 2.0, (3, 12)).astype(np.float32)
    known = np.ones((3, 9), bool)
    known[0, 2:4] = False
    known[2] = False
    normal, right = np.zeros((3, 8, 8)), np.zeros((3, 8))
    for z in (0, 1):
        used = np.flatnonzero(known[z])
        mean = np.mean([rotation(angle[t]) for t in used], axis=0)
        for t in used:
            moved = rotation(angle[t]) - mean
            normal[z] += moved.T @ own.information[z] @ moved / together
            right[z] += moved.T @ (own.change[z].T @ (residuals[z][t] * weight[z])) / together
    prior = np.diag(1.0 / np.repeat([1.0, 0.01, 0.1, 0.02], 2) ** 2)
    covariance = np.linalg.inv(normal.sum(axis=0) + prior)
    value = covariance @ right.sum(axis=0)
    apart = [right[z] - normal[z] @ value for z in (0, 1)]
    spread = 2.0 * sum(np.outer(a, a) for a in apart)  # two zones: n / (n - 1)
    found = View.of(own, residuals, weight, angle, known, together)
    np.testing.assert_allclose(found.value, value, rtol=1e-4)
    np.testing.assert_allclose(
        found.covariance, covariance + covariance @ spread @ covariance, rtol=1e-3, atol=1e-12
    )


def test_the_error_of_a_view_is_the_rms_over_a_turn():
    rng = np.random.default_rng(2)
    sigma, turned = rng.uniform(0.1, 1.0, 8), rng.normal(size=8)
    found = View(np.zeros(8), np.diag(sigma**2)).error(turned)
    angle = np.linspace(0.0, TURN, 360, endpoint=False)
    squares = [np.sum((turned @ rotation(a)) ** 2 * sigma**2) for a in angle]
    assert found == pytest.approx(np.sqrt(np.mean(squares)))


def test_zones_turn_in_a_view_by_their_response():
    own, value = response(), np.random.default_rng(3).normal(size=VIEW_SIZE)
    angle = np.array([0.0, 0.7, 3.0])
    found = own.seen(value, angle)
    expected = np.stack([own.rotation @ rotation(a) @ value for a in angle], axis=1)
    np.testing.assert_allclose(found, expected)
    np.testing.assert_allclose(own.first, own.rotation[:, 1] + 1j * own.rotation[:, 0])
    np.testing.assert_allclose(own.second, own.rotation[:, 3] + 1j * own.rotation[:, 2])


@pytest.mark.parametrize(("share", "explained"), [(0.2, False), (0.4, True), (1.6, True), (1.8, False)])
def test_a_view_explains_a_row_if_half_of_its_static_power_goes(share, explained):
    """A pattern at rest of `1 / share` times the size that the view gives: (1 - share)^2 of its power remains."""
    columns, rows = 24, 2
    theta = np.arange(columns) * TURN / columns
    angle = np.linspace(0.0, TURN, 40, endpoint=False)
    change = np.zeros((1, rows * columns, 8))
    # a displacement to the right makes the body brighter on this side of the picture, in the first row alone
    change[0, :columns, 0], change[0, :columns, 1] = np.cos(theta), np.sin(theta)
    own = ViewResponse(change.astype(np.float32), np.zeros((1, 8)), np.zeros((1, 8, 8)), columns)
    value = np.zeros(8)
    value[0] = 3.0
    at_rest = np.stack([3.0 * np.cos(theta + a) for a in angle])
    other = np.stack([np.cos(2 * (theta + a)) for a in angle])
    seen = np.concatenate([at_rest / share, other], axis=1).astype(np.float32)
    assert own.explains(value, [seen], angle).tolist() == [explained, False]


def test_columns_of_angles_are_counted_over_a_turn():
    angle = np.array([0.0, 0.26, -0.26, TURN - 0.01, 100.0 * TURN + 1.0])
    assert view.columns_of(angle, 12).tolist() == [0, 0, 0, 0, 2]
    assert view.columns_of(angle, 36).tolist() == [0, 1, 35, 0, 6]


def test_static_light_is_subtracted_at_the_angle_of_the_body():
    """The light at the column k of the picture is below column 0 of a body at this angle."""
    light = np.arange(24.0, dtype=np.float32).reshape(2, 12)
    angle = np.array([0.0, TURN / 12, -3 * TURN / 12])
    found = view.without_light(np.full((3, 2, 12), 100.0, np.float32), light, angle)
    for k, strip in zip((0, 1, -3), found, strict=True):
        np.testing.assert_array_equal(strip, 100.0 - np.roll(light, -k, axis=1))


@pytest.mark.parametrize("lowest", [1, 3])
def test_static_light_has_orders_from_the_lowest_on(lowest):
    columns = 48
    theta = np.arange(columns) * TURN / columns
    light = np.stack(
        [5.0 * np.cos(theta) + 3.0 * np.sin(2 * theta) + 2.0 * np.cos(4 * theta), 7.0 * np.sin(5 * theta)]
    )
    body = np.stack([20.0 * np.cos(3 * theta), 9.0 * np.sin(theta)])
    k = np.arange(96) * 5
    strips = np.stack([body + np.roll(light, -int(a), axis=1) for a in k]).astype(np.float32)
    found = view.static_light(strips, k * TURN / columns, lowest)
    expected = light.copy()
    if lowest == 3:
        expected[0] = 2.0 * np.cos(4 * theta)
    np.testing.assert_allclose(found, expected, atol=0.02)


def test_a_slope_is_the_derivative_along_the_circles():
    theta = np.arange(64) * TURN / 64
    picture = np.stack([np.cos(3 * theta), 2.0 + np.sin(theta)])
    np.testing.assert_allclose(view.slope(picture), [-3 * np.sin(3 * theta), np.cos(theta)], atol=1e-5)
