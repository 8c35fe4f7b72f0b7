"""A slow random torque as the alternative to an effect, and effects that are hints only."""

from types import SimpleNamespace

import numpy as np
import pytest
from cases import data, fitted

from fitting._criteria import DEFAULT
from fitting.discovery import _random_torque
from fitting.discovery._random_torque import RandomTorque, describes, is_established, with_random_torque
from fitting.discovery._select import Selection
from fitting.discovery._verdict import _undetermined, diagnose
from fitting.effects._library import LIBRARY
from fitting.inference._result import Estimate

ROWS = 500


def alternative(deviance, *, raised=True, log_determinant=0.0, parameters=8):
    noise = SimpleNamespace(raised=raised, whitener=SimpleNamespace(log_determinant=log_determinant))
    fit = SimpleNamespace(noise=(noise,), rows=ROWS, theta=np.zeros(parameters))
    return RandomTorque(fit, deviance, 1e-4)


@pytest.mark.parametrize(
    ("deviance", "raised", "log_determinant", "expected"),
    [
        (0.99 * DEFAULT.reduced_chi2 * ROWS, True, 0.0, True),
        (1.01 * DEFAULT.reduced_chi2 * ROWS, True, 0.0, False),
        (1.01 * DEFAULT.reduced_chi2 * ROWS, True, 0.05 * ROWS, True),
        (0.5 * ROWS, False, 0.0, False),
    ],
)
def test_a_random_torque_describes_residuals_of_unit_variance(deviance, raised, log_determinant, expected):
    found = alternative(deviance, raised=raised, log_determinant=log_determinant)
    assert describes(found, DEFAULT) == expected


@pytest.mark.parametrize(("margin", "expected"), [(0.1, True), (-0.1, False)])
@pytest.mark.parametrize("more", [0, 1, 2])
def test_an_effect_is_established_by_its_evidence_beside_any_random_torque(
    monkeypatch, margin, expected, more
):
    least = more * np.log(ROWS) + DEFAULT.evidence
    monkeypatch.setattr(
        _random_torque, "with_random_torque", lambda *_: SimpleNamespace(deviance=600.0 - least - margin)
    )
    named = SimpleNamespace(theta=np.zeros(8 + more), rows=ROWS)
    assert is_established(alternative(600.0), named, 1, DEFAULT) == expected


def test_more_tests_need_a_larger_fall(monkeypatch):
    monkeypatch.setattr(_random_torque, "with_random_torque", lambda *_: SimpleNamespace(deviance=588.0))
    named = SimpleNamespace(theta=np.zeros(9), rows=ROWS)
    # p = 5e-4 for one test
    assert is_established(alternative(600.0), named, 10, DEFAULT)
    assert not is_established(alternative(600.0), named, 1000, DEFAULT)


@pytest.mark.parametrize(
    ("value", "stderr", "converged", "hint"),
    [
        (3.1, 1.0, True, ""),
        (-3.1, 1.0, True, ""),
        (2.9, 1.0, True, "is not determined"),
        (9.0, 1.0, False, "did not"),
    ],
)
def test_an_effect_of_less_than_three_standard_uncertainties_is_a_hint(value, stderr, converged, hint):
    effect = LIBRARY["bearing.drift"]
    (strength,) = effect.parameters
    estimates = {f"bearing.drift.{strength.symbol}": Estimate(value, stderr, "s-1", at_bound=False)}
    named = SimpleNamespace(converged=converged, estimates=estimates)
    found = _undetermined(Selection((), SimpleNamespace(effect=effect), named, named), DEFAULT)
    assert (hint in found) if hint else found == ""


@pytest.mark.slow
def test_the_most_likely_random_torque_is_never_above_its_ceiling():
    found = with_random_torque(fitted(hidden="drag"), DEFAULT)
    assert found.noise.level <= DEFAULT.random_torque * found.mean_torque * (1 + 1e-9)
    assert found.deviance <= fitted(hidden="drag").deviance


@pytest.mark.slow
def test_drag_is_named_beside_a_random_torque():
    """A torque of 1e-6 N m is established beside a random one of 1e-7 N m with a correlation time of 1 s."""
    found = diagnose(fitted(ou=1e-7, hidden="drag"))
    assert found.verdict == "missing_effect"
    assert found.candidates[0].effect.name == "casing.air.quadratic"
    assert data(ou=1e-7, hidden="drag").findings == ()


@pytest.mark.parametrize("name", ["casing.precession", "bearing.drift"])
@pytest.mark.parametrize(("established", "alternative"), [(True, False), (False, True)])
def test_a_periodic_law_must_be_established_beside_a_random_torque_too(
    monkeypatch, name, established, alternative
):
    from fitting.discovery import _verdict

    fit = SimpleNamespace(problem=SimpleNamespace(data=[SimpleNamespace(oscillation=None)]))
    random = SimpleNamespace(fit=fit)
    monkeypatch.setattr(_verdict, "with_random_torque", lambda *_: random)
    monkeypatch.setattr(_verdict, "describes", lambda *_: True)
    monkeypatch.setattr(_verdict, "is_established", lambda *_: established)
    monkeypatch.setattr(_verdict, "smooth_test", lambda _: SimpleNamespace(p_value=0.5))
    chosen = SimpleNamespace(effect=LIBRARY[name], physical=True)
    selection = Selection([], chosen, None, None)
    found = _verdict._random_alternative(fit, selection, "missing_effect", None, DEFAULT)
    assert (found is random) == alternative
