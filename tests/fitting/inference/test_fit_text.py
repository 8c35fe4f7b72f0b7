"""What a fit says of a random torque that its model needs."""

from dataclasses import replace

import numpy as np
import pytest

from fitting import Model, fit, make_record
from fitting.inference._result import merit_lines

TOLD = "the recording does not establish this random torque"


@pytest.fixture(scope="module")
def found():
    t = np.arange(0.0, 20.0, 0.01)
    angle = 120.0 * t - 0.5 * t**2 + 1e-3 * np.random.default_rng(2).standard_normal(len(t))
    run = t, angle, np.full(len(t), 1e-3)
    return fit(
        Model.of(["touchpoint.constant"]), [make_record(casing=run, rotor=[], I_rotor=1.0, I_casing=1.0)]
    )


@pytest.mark.parametrize(("excess", "told"), [(10.1, True), (9.9, False)])
def test_fit_reports_a_random_torque_beyond_the_recording(found, excess, told):
    noise = replace(found.noise[0].at(2 * found.noise[0].least), excess=excess)
    changed = replace(found, noise=(noise,))
    assert changed.verdict == "no_lack_of_fit"
    assert (TOLD in "\n".join(merit_lines(changed))) is told


def test_a_lack_of_fit_says_enough(found, monkeypatch):
    noise = replace(found.noise[0].at(2 * found.noise[0].least), excess=50.0)
    changed = replace(found, noise=(noise,))
    monkeypatch.setattr(type(changed), "has_torque_of_the_angle", lambda _: True)
    assert changed.verdict == "lack_of_fit"
    assert TOLD not in "\n".join(merit_lines(changed))
