"""Every decision threshold is a documented field of one record, and results depend on it."""

import math
import re
from dataclasses import FrozenInstanceError, fields, replace
from functools import cache

import pytest
from cases import wheel
from scipy.stats import chi2, norm

import fitting
from fitting import Criteria, diagnose


@cache
def diagnosed():
    return diagnose(wheel())


def test_criteria_print_the_meaning_of_every_field():
    lines = str(fitting.Criteria()).splitlines()
    assert len(lines) == 1 + len(fields(Criteria)) <= 50
    assert max(map(len, lines)) <= 112
    assert all(
        re.fullmatch(rf"{f.name} +\d\S*  [A-Z].+", line)
        for f, line in zip(fields(Criteria), lines[1:], strict=True)
    )
    assert lines[1].endswith(
        "0.03  Family-wise p-value below which a candidate is significant (Westfall & Young 1993)"
    )
    assert "0.01* " in str(replace(Criteria(), significance=0.01))  # a changed value is marked


def test_criteria_are_immutable_and_validated():
    with pytest.raises(FrozenInstanceError):
        Criteria().evidence = 3.0
    for wrong in (
        {"significance": 2.0},
        {"evidence": float("nan")},
        {"refit_most": -1},
        {"explained": "half"},
    ):
        with pytest.raises(fitting.EstimationError, match=next(iter(wrong))):
            Criteria(**wrong)


@pytest.mark.slow
@pytest.mark.release
def test_significance_decides_the_verdict():
    assert diagnosed().verdict == "missing_effect"
    none = diagnose(wheel(), criteria=Criteria(significance=0.0), brief=True)
    assert not any(c.significant for c in none.candidates)
    assert none.verdict != "missing_effect"


@pytest.mark.slow
def test_equivalence_width_decides_membership_of_a_class():
    wide = diagnose(wheel(), criteria=Criteria(equivalence_width=1e6), brief=True)
    of_default = diagnosed().candidates[0].indistinguishable_from
    assert len(wide.candidates[0].indistinguishable_from) > len(of_default)


@pytest.mark.slow
def test_failure_sigma_decides_what_is_reported():
    found = diagnosed()
    assert found.failures
    strict = Criteria(failure_sigma=1e6, harmonic_sigma=1e6)
    assert not diagnose(wheel(), criteria=strict, candidates=found.candidates).failures


def test_the_number_of_refits_falls_with_the_reversals_of_an_oscillation():
    criteria = Criteria()
    assert [criteria.refits_through(n) for n in (0, 20, 125, 180, 251, 10_000)] == [4, 4, 4, 2, 1, 1]


def test_thresholds_with_a_source_have_the_value_of_the_source():
    """Kass and Raftery 1995, prior odds of one to five, and the probabilities that the fields state."""
    found = Criteria()
    assert (found.evidence, found.evidence_periodic, found.shape_evidence) == (2.0, 10.0, 10.0)
    assert (found.equivalence_width, found.refit_shortfall, found.own_phase) == (10.0, 10.0, 10.0)
    assert found.measurement_penalty == pytest.approx(2 * math.log(5), abs=0.05)
    assert found.essential_sigma == pytest.approx(norm.isf(0.001 / 2), abs=0.05)
    assert found.harmonic_sigma == pytest.approx(math.sqrt(chi2.isf(1e-4, 2)), abs=0.05)
    assert found.changepoint_score == 5.0**2
    # a random torque of two degrees of freedom has such a deviance in one recording in fifty
    assert chi2.sf(found.correlated_noise, 2) == pytest.approx(0.02, abs=0.003)
    # an answer is named at 3 %, and contradicted by what noise shows in one recording in a thousand
    assert found.significance == 0.03
    assert found.doubt_adequate == found.spectral_line == found.periodic_torque == 0.001
    assert found.doubt_adequate < found.doubt_named < found.significance
