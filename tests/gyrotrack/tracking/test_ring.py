import numpy as np
import pytest

from gyrotrack.tracking._polar import CHROMA_SHIFT, Ring, boxed, ring_for, unroll


def test_columns_are_angles_counter_clockwise_as_seen():
    y, x = np.mgrid[:200, :300]
    angle = np.arctan2(-(y - 90.3), x - 140.7)
    plane = (np.mod(angle, 2 * np.pi) * 40).astype(np.uint8)
    ring = Ring((140.7, 90.3), 40.0, 60.0, 5, 360)
    strip = unroll(plane, ring.maps(chroma=False))
    expected = np.arange(360) * ring.step * 40
    np.testing.assert_allclose(strip[2, 5:-5], expected[5:-5], atol=2.0)


def test_rows_are_radii_and_chroma_agrees_with_luma():
    y, x = np.mgrid[:200, :300]
    luma = np.hypot(x - 140.7, y - 90.3).astype(np.uint8)
    yc, xc = np.mgrid[:100, :150]
    chroma = np.hypot(2 * xc + CHROMA_SHIFT[0] - 140.7, 2 * yc + CHROMA_SHIFT[1] - 90.3).astype(np.uint8)
    ring = Ring((140.7, 90.3), 30.0, 80.0, 11, 128)
    for strip in (unroll(luma, ring.maps(chroma=False)), unroll(chroma, ring.maps(chroma=True))):
        np.testing.assert_allclose(strip.mean(axis=1), ring.radii - 0.5, atol=0.6)  # uint8 cuts off


@pytest.mark.parametrize(("inner", "outer"), [(15.0, 30.0), (60.0, 90.0), (200.0, 300.0)])
def test_a_ring_samples_about_every_pixel(inner, outer):
    ring = ring_for((0.0, 0.0), inner, outer, 2.0)
    assert 0.4 < ring.step * 0.5 * (inner + outer) / 2.0 <= 1.1 or ring.columns in (128, 1024)
    assert ring.rows >= 6


def test_boxed_is_a_circular_mean():
    profile = np.zeros((1, 12))
    profile[0, 0] = 5.0
    np.testing.assert_allclose(boxed(profile, 2)[0], [1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 1, 1])
