"""Rough speeds against SciPy: the curve through the rotor's windows."""

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from fitting.inference._record import hermite


def test_cubics_agree_with_scipy():
    t, v, s = np.array([0.0, 1.5, 2.0, 7.0]), np.array([3.0, 1.0, 2.0, -4.0]), np.array([0.5, -2.0, 1.0, 0.0])
    times = np.linspace(0, 7, 113)
    np.testing.assert_allclose(hermite(t, v, s, times), CubicHermiteSpline(t, v, s)(times), atol=1e-13)
