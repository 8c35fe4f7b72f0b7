"""The same record with another unit of time or of inertia has the same numbers in these units."""

from types import SimpleNamespace

import numpy as np
import pytest

from fitting import LIBRARY, Model, fit, make_record
from fitting.inference._problem import reference_speed

TIME = np.linspace(0.0, 20.0, 801)
NOISE = 2e-3 * np.random.default_rng(4).standard_normal(len(TIME))


def fitted(scale=1.0, inertia=1.0):
    """Return the fit of a wheel with dry friction and air drag whose times are multiplied by `scale`."""
    turned = np.log(1 + 20.0 * 0.02 * TIME) / 0.02
    run = TIME * scale, turned + NOISE, np.full(len(TIME), 2e-3)
    record = make_record(casing=run, rotor=[], I_rotor=1.0, I_casing=inertia, label="wheel")
    return fit(Model.of(["casing.air.quadratic"]), [record])


@pytest.mark.parametrize(("scale", "inertia"), [(60.0, 1.0), (1000.0, 1.0), (1.0, 1e-4), (1.0, 1e4)])
def test_a_fit_does_not_depend_on_the_units(scale, inertia):
    here, there = fitted(), fitted(scale, inertia)
    assert there.values["casing.air.quadratic.k"] == pytest.approx(
        inertia * here.values["casing.air.quadratic.k"], rel=2e-4
    )
    # of the polynomials that measure the noise, some are hardly independent: rounding changes its level by 1 %
    assert there.deviance == pytest.approx(here.deviance, rel=0.03)


@pytest.mark.parametrize(("speed", "reference"), [(1e-9, 9e-9), (5.0, 45.0), (0.0, 1.0)])
def test_the_reference_speed_has_no_limit_but_zero(speed, reference):
    speeds = np.full(10, speed)
    data = [SimpleNamespace(initial_speeds=(np.arange(10.0), np.column_stack([10 * speeds, speeds])))]
    assert reference_speed(data) == pytest.approx(reference)


@pytest.mark.parametrize("rate", [1e-6, 0.5, 2.0, 2e5])
def test_a_precession_of_any_rate_is_within_its_bounds(rate):
    """With a limit, a slow rotor gave a chirp of thousands of periods, whose integration took minutes."""
    (m,) = (p for p in LIBRARY["casing.precession"].parameters if p.symbol == "m")
    assert m.lower < rate < m.upper
