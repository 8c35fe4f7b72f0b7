"""Evidence for adding an effect: on tracked angles, periodic laws need more because of tracking errors."""

from dataclasses import replace
from functools import cache

import pytest
import twobody

from fitting import LIBRARY, REDUCED, Model, fit, make_record
from fitting.discovery._select import best, rank
from fitting.inference._case_data import CaseData


@cache
def ranking(tracked):
    hidden = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -2e-6 * (wc / 160) ** 2)
    motion = twobody.simulate(hidden=hidden, seed=1, span=60.0)
    arrays = twobody.film(motion, 1, twobody.Cameras(60.0, windows=(2.0, 20.0, 45.0)))
    record = make_record(**{**arrays, "tracked": tracked})
    return rank(fit(Model.of(REDUCED), [CaseData.of(record)]))


def named(tracked, effect, delta_bic):
    drag = next(c for c in ranking(tracked) if c.effect.name == "casing.air.quadratic")
    candidate = replace(drag, effect=LIBRARY[effect], delta_bic=delta_bic, p_value=0.01)
    return best([candidate]) is not None


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["casing.precession", "casing.unbalance"])
def test_periodic_laws_need_stronger_evidence_on_film(effect):
    assert not named(True, effect, -5.0)
    assert named(True, effect, -11.0)
    assert named(False, effect, -5.0)


@pytest.mark.slow
def test_other_laws_need_the_usual_evidence():
    assert named(True, "casing.air.quadratic", -5.0)
    assert not named(True, "casing.air.quadratic", -1.0)
