"""Start values against SciPy: curves through the rotor's windows, and the bounded regression."""

import numpy as np
from cases import data, fitted
from scipy.interpolate import CubicHermiteSpline

from fitting.effects import REDUCED
from fitting.estimation.layout import Layout
from fitting.estimation.start import _hermite, start_values
from fitting.model import Model


def test_cubics_are_scipys():
    t, v, s = np.array([0.0, 1.5, 2.0, 7.0]), np.array([3.0, 1.0, 2.0, -4.0]), np.array([0.5, -2.0, 1.0, 0.0])
    times = np.linspace(0, 7, 113)
    np.testing.assert_allclose(_hermite(t, v, s, times), CubicHermiteSpline(t, v, s)(times), atol=1e-13)


def test_starts_are_near_the_answer():
    layout = Layout.of(Model.of(REDUCED), [data(seed=0).record])
    theta = dict(zip(layout.names, start_values(layout, 400.0), strict=True))
    best = fitted(seed=0).estimates
    for name in ("rotor.air.quadratic.a2", "casing.air.linear.b2"):
        assert 0.7 < theta[name] / best[name].value < 1.4
    torque = theta["bearing.linear.d"] * 400 + theta["bearing.power.f"] * 400 ** theta["bearing.power.g"]
    true = 1.57e-7 * 400 + 1.26e-8 * 400**1.32
    assert 0.9 < torque / true < 1.1
