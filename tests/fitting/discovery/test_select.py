"""Steps of `improve`: the history after a failed fit, and backward elimination of unnecessary effects."""

import numpy as np
import oscillators
import pytest
import twobody
from sinusoidal import APART, records, unbalance

from fitting import REDUCED, Criteria, Model, SimulationError, make_record
from fitting.discovery import _select
from fitting.discovery._select import Step
from fitting.inference._fit import fit

DRAG = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -4e-10 * abs(wc) * wc)


@pytest.mark.slow
@pytest.mark.release
def test_effects_that_imitated_the_newest_are_dropped():
    record = make_record(**twobody.film(twobody.simulate(hidden=DRAG, ou=5e-8, seed=3), 3))
    base = fit(Model.of(REDUCED), [record])
    vain = ("touchpoint.drift", "bearing.drift")
    full = fit(Model.of((*REDUCED, *vain, "casing.air.quadratic")), [record])
    rung = _select._backward([Step("", base, ()), Step("+casing.air.quadratic", full, ())], Criteria())
    assert set(rung.fit.model.names) == {*REDUCED, "casing.air.quadratic"}
    assert all(f"-{name}" in rung.change for name in vain)


@pytest.mark.slow
@pytest.mark.release
def test_per_case_phases_remain_when_another_effect_is_dropped():
    data = records(unbalance, APART)
    base = fit(Model.of(REDUCED), data)
    own = ["casing.unbalance.k", "casing.unbalance.phi"]
    full = fit(Model.of((*REDUCED, "bearing.drift", "casing.unbalance")), data, per_case=own)
    rung = _select._backward([Step("", base, ()), Step("+casing.unbalance", full, ())], Criteria())
    assert rung.change == "+casing.unbalance -bearing.drift"
    assert "casing.unbalance.phi@case2" in rung.fit.estimates


@pytest.mark.slow
def test_a_failed_step_keeps_the_previous_steps(monkeypatch):
    t = np.arange(0, 6, 0.02)
    slowed = 20 / 0.3 * (1 - np.exp(-0.3 * t))
    base = fit(Model.of(["touchpoint.constant"]), [oscillators.record(t, slowed, 1e-3, 1)])
    ranked = _select.rank(base)

    def failing(fit, *_args, **_kwargs):
        raise SimulationError("the casing stops and starts too often to be followed")

    monkeypatch.setattr(_select, "rank", failing)
    kept = []
    history = _select.improve(base, first=ranked, keep=kept.append)
    assert len(history) == 2
    assert kept == history[1:]
    assert history[1].fit.deviance < base.deviance
    assert "too often" in history.stopped
