"""The lack of fit of a short record: chi2 of few rows is large by chance."""

import math

import numpy as np
import pytest
from scipy.stats import chi2

from fitting import Model, fit, make_record
from fitting._criteria import DEFAULT
from fitting.inference._metrics import BodyMetrics, CaseMetrics


def metrics(misfit, rows):
    body = BodyMetrics(1.0, 0.0, 1.0, 1.0)
    return CaseMetrics("case", body, body, 0.0, misfit, rows)


@pytest.mark.parametrize(("rows", "limit"), [(12, 3.7563), (60, 1.9764), (1000, 1.4)])
def test_a_misfit_is_improbable_and_above_its_limit(rows, limit):
    """The upper 1e-5 quantile of chi2 / dof for few rows, `reduced_chi2` for many."""
    assert max(DEFAULT.reduced_chi2, chi2.isf(DEFAULT.lack_of_fit, rows) / rows) == pytest.approx(
        limit, rel=1e-3
    )
    assert metrics(1.001 * limit, rows).fails(DEFAULT)
    assert not metrics(0.999 * limit, rows).fails(DEFAULT)


@pytest.mark.slow
def test_short_records_of_the_model_do_not_fail():
    """20 spin-downs with dry and viscous friction, 60 angles each."""
    t = np.linspace(0, 20, 60)
    angle = (60.0 + 2.0) / 0.05 * (1 - np.exp(-0.05 * t)) - 2.0 * t
    failed = 0
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(0, 2e-3, len(t))
        record = make_record(
            casing=(t, angle + noise, np.full(len(t), 2e-3)), rotor=[], I_rotor=1.0, I_casing=1.0, single=True
        )
        found = fit(Model.of(["touchpoint.constant", "casing.air.linear"]), [record])
        failed += found.fails()
        assert math.isfinite(found.chi2)
    assert failed == 0
