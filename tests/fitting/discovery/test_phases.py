"""Periodic effects with another phase in each recording."""

import math

import pytest
from sinusoidal import ALIKE, APART, RATE, STRENGTH, precession, records, unbalance

from fitting import LIBRARY, REDUCED, Model, diagnose
from fitting.discovery._information import Information
from fitting.discovery._select import found_starts, rank
from fitting.inference._fit import fit


def off(estimate, phi):
    return math.remainder(estimate.value - phi, 2 * math.pi) / estimate.stderr


@pytest.mark.slow
@pytest.mark.release
def test_per_case_phases_are_found():
    name = "casing.precession"
    answer = diagnose(fit(Model.of(REDUCED), records(precession, APART)))
    assert answer.verdict == "missing_effect"
    best = answer.candidates[0]
    assert best.effect.name == name
    assert best.own_phase
    assert "Each case has its own strength and phase" in answer.sentence
    for i, phi in enumerate(APART, 1):
        k = best.estimates[f"{name}.k@case{i}"]
        assert k.value == pytest.approx(STRENGTH, abs=4 * k.stderr)
        assert abs(off(best.estimates[f"{name}.phi@case{i}"], phi)) < 4
    assert f"{name}.m" in best.estimates


@pytest.mark.slow
@pytest.mark.release
def test_a_common_phase_is_found_as_common():
    (best, *_) = (c for c in rank(fit(Model.of(REDUCED), records(unbalance, ALIKE))) if c.fit is not None)
    assert best.effect.name == "casing.unbalance"
    assert not best.own_phase
    k, phi = (best.estimates[f"casing.unbalance.{s}"] for s in ("k", "phi"))
    assert k.value == pytest.approx(STRENGTH, abs=4 * k.stderr)
    assert abs(off(phi, ALIKE[0])) < 4


@pytest.mark.slow
@pytest.mark.release
def test_an_effect_added_by_the_user_may_have_per_case_phases():
    data = records(precession, APART)
    base = fit(Model.of(REDUCED), data)
    own = ["casing.precession.k", "casing.precession.phi"]
    start = {name: e.value for name, e in base.estimates.items()}
    start |= found_starts(base, [LIBRARY["casing.precession"]])
    found = fit(Model.of((*REDUCED, "casing.precession")), data, start=start, per_case=own)
    assert found.verdict == "no_lack_of_fit"
    assert found.estimates["casing.precession.m"].value == pytest.approx(RATE, rel=1e-3)
    # a strength of its own in each recording is no shared parameter of a planned run
    assert Information(found, []).added() == {}
