"""Rough speeds against SciPy: the curve through the rotor's windows, and into how many pieces a window is divided."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from fitting.inference._record import Samples, _pieces, hermite


def test_cubics_agree_with_scipy():
    t, v, s = np.array([0.0, 1.5, 2.0, 7.0]), np.array([3.0, 1.0, 2.0, -4.0]), np.array([0.5, -2.0, 1.0, 0.0])
    times = np.linspace(0, 7, 113)
    np.testing.assert_allclose(hermite(t, v, s, times), CubicHermiteSpline(t, v, s)(times), atol=1e-13)


@pytest.mark.parametrize(
    ("share", "samples", "pieces"),
    [(0.6, 1201, 60), (0.6, 361, 30), (0.52, 1201, 52), (0.48, 1201, 1), (0.6, 720, 60), (0.6, 719, 59)],
)
def test_a_window_of_more_than_half_of_the_run_is_divided_like_the_run(share, samples, pieces):
    """A run of 10 s with a hundred points; each piece has at least twelve samples."""
    time = np.linspace(1.0, 1.0 + 10.0 * share, samples)
    window = Samples(time, time, np.ones(samples))
    assert _pieces(window, SimpleNamespace(span=(0.0, 10.0)), 100, 12) == pieces
