"""Correlated angle noise of short records: motion of few blocks is not called noise."""

import numpy as np
import pytest

from fitting.inference._angle_noise import estimate_angle_noise
from fitting.inference._compression import compress
from fitting.inference._record import Samples

T = np.linspace(0.0, 20.0, 400)
SIGMA = 5e-3


def noise_of(angle, blocks):
    t = T[:: len(T) // len(angle)]
    run = compress(Samples(t, angle, np.full(len(t), SIGMA)), degree=7, angle=angle, blocks=blocks)
    return estimate_angle_noise(run, np.zeros((len(run.z), 0)))


def white(seed=1):
    return SIGMA * np.random.default_rng(seed).standard_normal(len(T))


@pytest.mark.parametrize("samples", [100, 400])
def test_quadratic_drag_is_not_called_noise(samples):
    """11.3 / (1 + 0.048 t) rad/s: a cubic does not describe the angle of the whole record within 5 mrad."""
    angle = (np.log1p(0.00426 * 11.3 * T) / 0.00426 + white())[:: len(T) // samples]
    assert noise_of(angle, 1).is_white


@pytest.mark.parametrize(("blocks", "found"), [(3, False), (4, True)])
def test_noise_is_found_from_four_blocks_on(blocks, found):
    rng, slow = np.random.default_rng(2), np.zeros(len(T))
    keep = np.exp(-(T[1] - T[0]) / 0.5)
    for k in range(1, len(T)):
        slow[k] = keep * slow[k - 1] + 0.03 * np.sqrt(1 - keep**2) * rng.standard_normal()
    assert noise_of(11.3 * T - 0.1 * T**2 + white() + slow, blocks).is_white != found
