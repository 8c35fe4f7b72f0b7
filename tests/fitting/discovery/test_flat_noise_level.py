"""A restricted likelihood of the process noise that is flat from zero does not make an effect significant."""

import numpy as np
import pytest

from fitting import Model, diagnose, fit, make_record
from fitting.inference._fit import deviance_at_noise_of


def constant_torque(seed):
    """Fit precise angles of 1.7 turns with an acceleration of -1.1 rad/s2."""
    rng = np.random.default_rng(seed)
    t, sigma = np.arange(120) / 120, 2.2e-4
    angle = 0.4 + 11 * t - 0.55 * t**2 + rng.normal(0, sigma, len(t))
    record = make_record(
        casing=(t, angle, np.full(len(t), sigma)), rotor=[], I_rotor=1.0, I_casing=1.0, single=True
    )
    return fit(Model.of(["touchpoint.constant", "casing.air.linear"]), [record])


def test_the_deviance_at_the_noise_of_another_fit_is_the_lower_one():
    base = constant_torque(26)  # the first seed with a random torque in its fit
    assert base.noise[0].level > 0
    without = base.problem.with_noise([n.at(0.0) for n in base.noise])
    other = type("Other", (), {"noise": tuple(n.at(0.0) for n in base.noise)})()
    found = deviance_at_noise_of(base, other)
    r, _ = without.residuals(without.predict(base.theta))
    assert found < base.deviance - 10
    assert found <= float(r @ r)
    assert found < 3 * base.rows  # consistent with the noise of the angles alone
    assert deviance_at_noise_of(base, base) == base.deviance


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3, 26])
def test_a_constant_torque_is_adequate(seed):
    assert diagnose(constant_torque(seed)).verdict == "adequate"
