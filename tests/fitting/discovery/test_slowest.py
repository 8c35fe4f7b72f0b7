"""The amplitude of the speed by a torque of the angle is that at the smallest speed at which the body does not rest."""

from types import SimpleNamespace

import numpy as np
import pytest

from fitting.discovery import _residuals as module
from fitting.effects._mechanism import GYROSCOPE


@pytest.mark.parametrize("scale", [1.0, 1e-3])
@pytest.mark.parametrize(("slowest", "used"), [(2e-4, 2e-4), (0.5e-4, 1e-4)])
def test_the_smallest_speed_is_a_share_of_the_largest(monkeypatch, scale, slowest, used):
    speed = scale * np.linspace(1.0, slowest, 50)
    monkeypatch.setattr(module, "Sampler", lambda mesh, t: SimpleNamespace(value=lambda y: speed))
    casing = SimpleNamespace(time=np.linspace(0.0, 10.0, 50))
    record = SimpleNamespace(
        casing=casing, I_casing=1.0, body="casing", torque_unit="N m", mechanism=GYROSCOPE
    )
    fit = SimpleNamespace(
        labels=("a",),
        problem=SimpleNamespace(data=[SimpleNamespace(record=record)]),
        predictions=[SimpleNamespace(path=SimpleNamespace(mesh=None, y=np.zeros((50, 2))))],
    )
    amplitude = 1e-12 * scale**2
    found = SimpleNamespace(label="a", size=lambda n: (amplitude, 10.0))
    (failure,) = module._harmonic(fit, found, 1, 5.0)
    assert failure.residual_rad_s == pytest.approx(amplitude / (used * scale))
