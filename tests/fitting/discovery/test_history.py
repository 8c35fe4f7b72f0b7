"""The history of `improve`: a fit that fails ends it, and the previous steps remain."""

import numpy as np
import oscillators
import pytest

from fitting import Model, SimulationError
from fitting.discovery import _select
from fitting.inference._fit import fit


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
