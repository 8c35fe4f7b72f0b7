"""An error of a moment of inertia within its stated uncertainty is no missing effect."""

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
import twobody

from fitting.discovery._criteria import Criteria
from fitting.discovery._verdict import diagnose, inertia_within_uncertainty
from fitting.dynamics._model import Model
from fitting.effects._library import LIBRARY, REDUCED
from fitting.inference._fit import fit
from fitting.inference._record import make_record
from fitting.inference._result import Estimate


def said(share, casing_u, rotor_u=math.nan, effect="setup.inertia"):
    record = SimpleNamespace(
        I_casing=2e-5, I_rotor=5e-5, I_casing_u=casing_u * 2e-5, I_rotor_u=rotor_u * 5e-5
    )
    base = SimpleNamespace(problem=SimpleNamespace(data=[SimpleNamespace(record=record)]))
    found = Estimate(share, 1e-4, "1", at_bound=False)
    candidate = SimpleNamespace(effect=LIBRARY[effect], estimates={"setup.inertia.eps": found})
    return inertia_within_uncertainty(base, [candidate], Criteria())


def test_an_error_within_two_standard_uncertainties_is_allowed():
    assert "larger by 1.000 +- 0.010 %" in said(0.01, 0.006)
    assert said(0.01, 0.004) == ""
    # 3 % and 4 % in quadrature
    assert said(0.09, 0.03, 0.04) != ""
    assert said(0.11, 0.03, 0.04) == ""


def test_without_an_uncertainty_or_for_another_effect_nothing_is_allowed():
    assert said(0.001, math.nan) == ""
    assert said(0.001, 0.5, effect="touchpoint.load") == ""


@pytest.mark.slow
@pytest.mark.parametrize(("u", "verdict"), [(0.01, "adequate"), (0.001, "missing_effect")])
def test_a_casing_one_percent_too_light(u, verdict):
    film = twobody.film(twobody.simulate(seed=2), 2)
    record = make_record(**film)
    stated = record.I_casing / 1.01
    base = fit(Model.of(REDUCED), [replace(record, I_casing=stated, I_casing_u=u * stated)])
    found = diagnose(base)
    assert found.verdict == verdict
    assert ("within the uncertainty of the moments of inertia" in found.sentence) == (verdict == "adequate")
