import cv2
import numpy as np
import pytest

from gyrotrack.tracking._corners import near_corners
from gyrotrack.tracking._polar import Ring, Windows

CENTRE = (150.0, 150.0)


def _unrolled(near, length, base, psi, skew, ground=0.0, blur=1.0):
    """A rectangle drawn eight times too large, scaled down, unrolled: ring, score, true near corners."""
    u = (
        near
        + np.array([0, 0, length, length]) * np.cos(skew)
        - np.array([-0.5, 0.5, 0.5, -0.5]) * base * np.sin(skew)
    )
    v = np.array([0, 0, length, length]) * np.sin(skew) + np.array([-0.5, 0.5, 0.5, -0.5]) * base * np.cos(
        skew
    )
    x = CENTRE[0] + np.cos(psi) * u - np.sin(psi) * v
    y = CENTRE[1] - (np.sin(psi) * u + np.cos(psi) * v)
    big = np.full((2400, 2400), ground, dtype=np.float32)
    points = np.stack([8 * x + 3.5, 8 * y + 3.5], axis=1)
    cv2.fillPoly(big, [np.rint(points * 16).astype(np.int32)], 1.0, cv2.LINE_8, 4)
    image = cv2.GaussianBlur(cv2.resize(big, (300, 300), interpolation=cv2.INTER_AREA), (0, 0), blur)
    ring = Ring(CENTRE, near - 15, near + length + 10, 45, 512)
    angle = np.arange(512) * ring.step
    radius = ring.radii[:, None]
    mx = (CENTRE[0] + radius * np.cos(angle)).astype(np.float32)
    my = (CENTRE[1] - radius * np.sin(angle)).astype(np.float32)
    strip = cv2.remap(image, mx, my, cv2.INTER_LINEAR)
    start = round(psi / ring.step)
    window = strip[:, (start + np.arange(-60, 61)) % 512]
    true = np.hypot(u[:2], v[:2]), np.arctan2(v[:2], u[:2]) + psi - start * ring.step
    return ring, window.astype(np.float64), true


@pytest.mark.parametrize("psi", [0.3, 1.7, 2.9, 4.4, 5.8])
@pytest.mark.parametrize("skew", [0.0, 0.06])
def test_corners_of_a_drawn_rectangle(psi, skew):
    ring, window, (radius, angle) = _unrolled(60.0, 30.0, 22.0, psi, skew)
    r, phi = near_corners(Windows.plain(window[None]), ring.radii, np.arange(-60, 61) * ring.step, 60.0, 90.0)
    np.testing.assert_allclose(r[0], radius, atol=0.6)
    np.testing.assert_allclose(phi[0], angle, atol=0.006)


def test_a_coloured_bar_under_the_marker_does_not_move_the_corners():
    ring, window, (radius, angle) = _unrolled(60.0, 30.0, 22.0, 1.1, 0.0, ground=0.35)
    r, phi = near_corners(Windows.plain(window[None]), ring.radii, np.arange(-60, 61) * ring.step, 60.0, 90.0)
    np.testing.assert_allclose(r[0], radius, atol=0.6)
    np.testing.assert_allclose(phi[0], angle, atol=0.006)


def test_nothing_there_gives_nothing():
    ring, window, _ = _unrolled(60.0, 30.0, 22.0, 1.1, 0.0)
    r, phi = near_corners(
        Windows.plain(np.zeros((3, *window.shape))), ring.radii, np.arange(-60, 61) * ring.step, 60.0, 90.0
    )
    assert np.isnan(r).all()
    assert np.isnan(phi).all()
