"""Laws with a shape constant on a gyroscope with another bearing than that of the paper."""

import math
from functools import lru_cache

import pytest
import twobody
from cases import case

from fitting import REDUCED, Model, diagnose, make_record
from fitting.discovery._select import rank
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit

GYROSCOPE = {"a2": 1.97e-10, "b1": 3e-6, "b2": 3.7e-7, "d": 3.2e-8, "f": 4.86e-7, "g": 0.62}
SOFTENING, COOLING = 1.3e-3, 28.0


@lru_cache(maxsize=4)
def filmed(seed=0, hidden=None, span=160.0):
    motion = twobody.simulate(GYROSCOPE, start=(566.0, 25.0), span=span, hidden=hidden, seed=seed)
    windows = tuple(share * span for share in (0.03, 0.3, 0.7))
    # the information of 260 and 1000 Hz with 3 mrad
    cameras = twobody.Cameras(span, 65.0, windows, rotor_rate=250.0, sigma=1.5e-3)
    return CaseData.of(make_record(**twobody.film(motion, seed=seed, cameras=cameras)))


HEATED = twobody.Hidden(softening=SOFTENING, cooling=COOLING)


@pytest.mark.slow
@pytest.mark.parametrize("known", [False, True], ids=["from nothing", "on top of the reduced model"])
def test_the_time_constant_of_a_heated_bearing_is_found(known):
    """With the process noise of a model without heating, any time constant is consistent with the data."""
    data = [filmed(1, HEATED)]
    start = {k: e.value for k, e in fit(Model.of(REDUCED), data).estimates.items()} if known else None
    found = fit(Model.of((*REDUCED, "bearing.heating")), data, start=start)
    assert found.verdict == "no_lack_of_fit"
    for key, true in {"k": SOFTENING, "tau_T": COOLING}.items():
        e = found.estimates[f"bearing.heating.{key}"]
        assert e.stderr < 0.1 * true
        assert abs(e.value - true) < 4 * e.stderr


@lru_cache(maxsize=1)
def ranked():
    base = fit(Model.of(REDUCED), [filmed(0, HEATED)])
    return base, rank(base)


@pytest.mark.slow
@pytest.mark.release
def test_a_heated_bearing_is_ranked_first_and_its_refit_lowers_the_deviance_by_at_least_its_score():
    base, candidates = ranked()
    heating = candidates[0]
    assert heating.effect.name == "bearing.heating"
    assert heating.p_value < 1e-6
    assert heating.fit is not None
    assert base.deviance - heating.fit.deviance > 0.95 * heating.screened.score
    assert heating.estimates["bearing.heating.tau_T"].value == pytest.approx(COOLING, rel=0.25)


@pytest.mark.release
@pytest.mark.slow
def test_no_refit_is_worse_than_its_base():
    base, candidates = ranked()
    refits = [c.fit for c in candidates if c.fit is not None]
    assert len(refits) >= 4
    # a search ends within a small part of a standard deviation
    assert all(f.deviance < base.deviance + 0.1 for f in refits)


@pytest.mark.slow
@pytest.mark.release
def test_rivals_are_separated_at_the_noise_of_the_better_one():
    """Friction that rises sharply at low speed: with process noise of that size, several laws seem to explain it."""
    rise = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -2e-6 * math.exp(-abs(wc) / 6.0))
    found = diagnose(fit(Model.of(REDUCED), [filmed(0, rise)]))
    assert found.verdict == "missing_effect"
    best = found.candidates[0]
    assert best.effect.name == "touchpoint.stribeck"
    # heating beside a wrong moment of inertia, which is not stated, describes the data as well
    assert set(best.indistinguishable_from) <= {"bearing.heating"}
    assert best.fit.verdict == "no_lack_of_fit"


@pytest.mark.slow
def test_an_exponent_at_its_bound_is_reported():
    steep = {"f": 1.2e-9, "g": 1.65, "d": 3e-8}
    base = fit(Model.of(REDUCED), [case(steep, 3, "case1")])
    assert base.verdict != "no_lack_of_fit"
    assert "Active bound: bearing.power.g = 1.4" in diagnose(base, candidates=[]).sentence
