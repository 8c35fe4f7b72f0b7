"""An error of a moment of inertia within its stated uncertainty is no missing effect."""

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
import twobody

from fitting import (
    LIBRARY,
    REDUCED,
    Criteria,
    Estimate,
    Experiment,
    Model,
    diagnose,
    fit,
    make_record,
    simulate,
)
from fitting.discovery import _verdict
from fitting.discovery._named_effect import (
    INERTIA,
    InertiaRival,
    inertia_within_uncertainty,
    with_free_inertia,
)


def said(share, casing_u, rotor_u=math.nan, effect="setup.inertia"):
    record = SimpleNamespace(
        I_casing=2e-5, I_rotor=5e-5, I_casing_u=casing_u * 2e-5, I_rotor_u=rotor_u * 5e-5
    )
    base = SimpleNamespace(problem=SimpleNamespace(data=[SimpleNamespace(record=record)]))
    found = Estimate(share, 1e-4, "1", at_bound=False)
    candidate = SimpleNamespace(effect=LIBRARY[effect], estimates={"setup.inertia.eps": found})
    return inertia_within_uncertainty(base, [candidate], Criteria())


def test_an_error_within_two_standard_uncertainties_is_allowed():
    assert "I_casing/I_rotor 1.000 +- 0.010 % larger than given" in said(0.01, 0.006)
    assert said(0.01, 0.004) == ""
    # 3 % and 4 % in quadrature
    assert said(0.09, 0.03, 0.04) != ""
    assert said(0.11, 0.03, 0.04) == ""


@pytest.mark.parametrize(
    ("share", "words"),
    [(-3.1e-3, "0.31 +- 0.10 % smaller"), (3.1e-3, "0.31 +- 0.10 % larger"), (-2.9e-3, "")],
)
def test_an_error_of_inertia_that_is_consistent_with_zero_is_not_told(share, words):
    rival = InertiaRival(Estimate(share, 1e-3, "1", at_bound=False), 0.0, "bearing.load", None, better=False)
    told = rival.sentence(Criteria())
    assert (words in told) if words else told == ""


def test_without_an_uncertainty_or_for_another_effect_nothing_is_allowed():
    assert said(0.001, math.nan) == ""
    assert said(0.001, 0.5, effect="touchpoint.load") == ""


@pytest.mark.slow
@pytest.mark.parametrize(("u", "verdict"), [(0.01, "adequate"), (0.001, "missing_effect")])
@pytest.mark.release
def test_a_casing_one_percent_too_light(u, verdict):
    film = twobody.film(twobody.simulate(seed=2), 2, twobody.FEWER_FRAMES)
    record = make_record(**film)
    stated = record.I_casing / 1.01
    base = fit(Model.of(REDUCED), [replace(record, I_casing=stated, I_casing_u=u * stated)])
    found = diagnose(base)
    assert found.verdict == verdict
    assert ("within the uncertainty of the moments of inertia" in found.sentence) == (verdict == "adequate")


@pytest.mark.slow
@pytest.mark.release
def test_a_wrong_inertia_is_reported_with_the_effect(monkeypatch):
    """Quadratic drag and I_casing wrong by 3 %: the name stays, and the error is found with its uncertainty."""
    model = Model.of(REDUCED).with_effect(LIBRARY["casing.air.quadratic"])
    numbers = {
        "rotor.air.quadratic.a2": 1.3e-10,
        "touchpoint.constant.b1": 4e-6,
        "casing.air.linear.b2": 5e-7,
        "bearing.linear.d": 6e-8,
        "bearing.power.f": 1.5e-7,
        "bearing.power.g": 1.1,
        "casing.air.quadratic.k": 1e-10,
    }
    experiment = Experiment(
        omega_rotor=620.0,
        duration=60.0,
        windows=(0.5, 24.0, 48.0),
        casing_fps=65.0,
        rotor_fps=250.0,
        sigma=5e-4,
    )
    record = simulate(model, numbers, experiment, seed=8, inertia_rotor=6.2e-5, inertia_casing=2.4e-5)
    base = fit(Model.of(REDUCED), [replace(record, I_casing=1.03 * record.I_casing)])
    seen = []

    def watched(*arguments):
        seen.append((arguments[1], with_free_inertia(*arguments)))
        return seen[-1][1]

    monkeypatch.setattr(_verdict, "with_free_inertia", watched)
    found = diagnose(base)
    ((selection, rival),) = seen
    assert found.verdict == "missing_effect"
    assert found.candidates[0].effect.name == "casing.air.quadratic"
    assert found.form != "exact"
    if INERTIA in selection.final.model.names:
        share = selection.final.estimates[f"{INERTIA}.eps"]
        assert "second effect error of the given inertia of the casing (setup.inertia)" in found.sentence
    else:
        share = rival.share
        assert "check the moments of inertia" in found.sentence
        assert not rival.is_allowed(Criteria())
    assert abs(share.value - (1 / 1.03 - 1)) < 4 * share.stderr
    assert share.stderr < 0.01


def test_an_error_of_inertia_is_allowed_only_by_a_stated_uncertainty():
    share = Estimate(0.03, 0.001, "1", at_bound=False)
    rival = InertiaRival(share, 0.0, "bearing.constant", None, better=True)
    assert not rival.is_allowed(Criteria())
    assert "(no uncertainty stated)" in rival.sentence(Criteria())
    assert "With I_casing/I_rotor 3.00 +- 0.10 % larger than given" in rival.sentence(Criteria())
    assert replace(rival, stated=0.02).is_allowed(Criteria())
    assert not replace(rival, stated=0.01).is_allowed(Criteria())
