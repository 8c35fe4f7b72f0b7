"""Which laws of an oscillator are fitted exactly, and which are chosen."""

from types import SimpleNamespace

import oscillators
import pytest

from fitting import EstimationError
from fitting._criteria import DEFAULT
from fitting.discovery import _oscillator
from fitting.discovery._oscillator import LawSet, OscillatorLaws, fit_oscillator

GRAVITY, SPRING, BOTH = ("casing.gravity",), ("casing.spring.linear",), ("spring", "cubic")
DRY, WET, ALL = ("touchpoint.constant",), ("casing.air.linear",), ("touchpoint.constant", "casing.air.linear")


def laws(*sets, damping=(DRY, WET)):
    kept = tuple(LawSet(r, d, {"of": f"{r}{d}"}) for r, d in sets)
    first = kept[0]
    return OscillatorLaws(first.restoring, first.damping, (first.restoring,), damping, first.parameters, kept)


def decide(monkeypatch, found, bic, reversals=10):
    """Return the chosen laws, the exact fit and the names of all fits; `bic` maps the names to a BIC or None."""
    fitted = []

    def fit(model, _):
        fitted.append(model)
        if bic[model] is None:
            raise EstimationError("not this one")
        return SimpleNamespace(bic=bic[model], model=SimpleNamespace(effects=model))

    monkeypatch.setattr(_oscillator, "fit", fit)
    data = SimpleNamespace(motion=oscillators.stub(SimpleNamespace(reversals=[0.0] * reversals)))
    chosen, exact = fit_oscillator(found, tuple, data)
    return chosen, exact, fitted


def test_the_damping_is_decided_first_and_then_the_restoring_torque(monkeypatch):
    found = laws((GRAVITY, DRY), (GRAVITY, WET), (SPRING, DRY), (SPRING, WET))
    bic = {(*GRAVITY, *DRY): 50.0, (*GRAVITY, *WET): 20.0, (*SPRING, *WET): 0.0}
    chosen, exact, fitted = decide(monkeypatch, found, bic)
    assert fitted == list(bic)  # the spring with dry friction is not fitted
    assert (chosen.restoring, chosen.damping, exact.bic) == (SPRING, WET, 0.0)
    assert chosen.parameters == {"of": f"{SPRING}{WET}"}
    assert (chosen.restoring_classes, chosen.damping_classes) == ((SPRING,), (WET,))


@pytest.mark.parametrize(("excess", "smaller"), [(0.9, True), (1.1, False)])
def test_the_smallest_set_that_the_data_do_not_separate_is_chosen(monkeypatch, excess, smaller):
    found = laws((GRAVITY, ALL), (GRAVITY, DRY), damping=(ALL, DRY))
    bic = {(*GRAVITY, *ALL): 0.0, (*GRAVITY, *DRY): excess * DEFAULT.equivalence_width}
    chosen, _, _ = decide(monkeypatch, found, bic)
    assert chosen.damping == (DRY if smaller else ALL)
    assert chosen.damping_classes == ((ALL, DRY) if smaller else (ALL,))


def test_a_set_that_cannot_be_fitted_is_skipped(monkeypatch):
    found = laws((GRAVITY, DRY), (GRAVITY, WET))
    chosen, _, _ = decide(monkeypatch, found, {(*GRAVITY, *DRY): None, (*GRAVITY, *WET): 3.0})
    assert chosen.damping == WET
    with pytest.raises(EstimationError, match="not this one"):
        decide(monkeypatch, found, {(*GRAVITY, *DRY): None, (*GRAVITY, *WET): None})


@pytest.mark.parametrize("more", [False, True])
def test_through_many_reversals_the_chosen_set_alone_is_fitted(monkeypatch, more):
    """500 reversals are integrated for four candidates: 125 of each."""
    found = laws((GRAVITY, DRY), (GRAVITY, WET))
    bic = {(*GRAVITY, *DRY): 9.0, (*GRAVITY, *WET): 0.0}
    few = DEFAULT.refit_reversals // DEFAULT.refit_least
    chosen, _, fitted = decide(monkeypatch, found, bic, few + more)
    assert len(fitted) == (1 if more else 2)
    assert chosen.damping == (DRY if more else WET)
