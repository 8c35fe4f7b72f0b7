"""A fit that is restored from a ledger has the numbers of the fit itself."""

import numpy as np
import oscillators
import pytest

from fitting import LIBRARY, Model
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit
from fitting.study._serialisation import restored_fit, stored_fit

SPRING, DRAG = "casing.spring.linear", "casing.air.linear"


@pytest.fixture(scope="module")
def pendulum():
    """A pendulum of 126 degrees fitted as a spring: the optimum is far from where its noise was measured."""
    t, angle, _ = oscillators.motion(lambda t, a, w: -25 * np.sin(a) - 0.05 * w, (2.2, 0.0), 12.0, 50.0)
    return fit(Model.of([SPRING, DRAG]), [CaseData.of(oscillators.record(t, angle, 1e-3, 1))])


def same(new, old):
    np.testing.assert_array_equal(new.theta, old.theta)
    assert (new.chi2, new.deviance) == pytest.approx((old.chi2, old.deviance), rel=1e-6)
    for k, e in old.estimates.items():
        assert new.estimates[k].stderr == pytest.approx(e.stderr, rel=1e-4, nan_ok=True)


@pytest.mark.slow
def test_a_model_that_fails_grossly_keeps_its_uncertainties(pendulum):
    stored = stored_fit(pendulum)
    assert pendulum.verdict == "lack_of_fit"
    same(restored_fit(stored, pendulum.model, pendulum.problem.data), pendulum)
    # a linearisation about the optimum gives other numbers: the noise has to say where it is linearised
    optimum = dict(zip(pendulum.problem.layout.names, pendulum.theta.tolist(), strict=True))
    moved = [n.model_copy(update={"about": optimum}) for n in stored.noise]
    other = restored_fit(stored.model_copy(update={"noise": moved}), pendulum.model, pendulum.problem.data)
    assert abs(other.chi2 / pendulum.chi2 - 1) > 0.1


@pytest.mark.slow
def test_a_candidate_keeps_the_noise_of_its_base(pendulum):
    model = pendulum.model.with_effect(LIBRARY["casing.air.quadratic"])
    found = fit(model, pendulum, start=pendulum.values, noise=pendulum.noise, quick=True)
    same(restored_fit(stored_fit(found), model, pendulum.problem.data), found)
