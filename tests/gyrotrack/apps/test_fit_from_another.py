"""From which initial values a modified fit starts, and when it is repeated without them."""

from types import SimpleNamespace

import pytest

from fitting import EstimationError
from gyrotrack import FitRequest

START = {"casing.air.linear.b2": 12.0}


def fitted(monkeypatch, *, inputs, fails, deviances, start=START):
    """Return the deviance of the result, and the initial values of each search."""
    tried = []

    def robust_fit(model, data, loss, start=None, **options):
        tried.append(start)
        deviance = deviances[len(tried) - 1]
        if deviance is None:
            raise EstimationError("it does not converge")
        return SimpleNamespace(deviance=deviance, fails=lambda: fails)

    monkeypatch.setattr("fitting.inference._fit.robust_fit", robust_fit)
    wanted = SimpleNamespace(effects=[SimpleNamespace(inputs=()), SimpleNamespace(inputs=inputs)])
    return FitRequest()._fitted((), wanted, start, {}).deviance, tried


@pytest.mark.parametrize(
    ("inputs", "fails", "deviances", "expected"),
    [
        (("drive",), True, (1e6, 300.0), (300.0, 2)),
        (("drive",), True, (1e6, 2e6), (1e6, 2)),
        (("drive",), False, (300.0,), (300.0, 1)),
        ((), True, (1e6,), (1e6, 1)),
        ((), False, (None, 300.0), (300.0, 2)),
    ],
    ids=["better", "worse", "adequate", "not driven", "not converged"],
)
def test_a_failing_fit_of_a_driven_body_is_repeated_without_the_values_of_the_last_one(
    monkeypatch, inputs, fails, deviances, expected
):
    deviance, tried = fitted(monkeypatch, inputs=inputs, fails=fails, deviances=deviances)
    assert (deviance, len(tried)) == expected
    assert tried == [START, None][: len(tried)]


def test_without_an_earlier_fit_there_is_one_search(monkeypatch):
    found = fitted(monkeypatch, inputs=("drive",), fails=True, deviances=(1e6,), start=None)
    assert found == (1e6, [None])
    with pytest.raises(EstimationError):
        fitted(monkeypatch, inputs=(), fails=True, deviances=(None,), start=None)
