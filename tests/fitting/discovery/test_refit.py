"""A refit reaches the deviance of its score despite the process noise of its base."""

import pytest
import twobody

from fitting import LIBRARY, REDUCED, Criteria, Model, make_record
from fitting.discovery._refine import has_model_noise, refit
from fitting.discovery._score import CaseColumns, score
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit

# a gyroscope whose bearing is all but linear: its power law takes the linear term over, and nearly fits
PAR = {"a2": 1.683e-10, "b1": 1.531e-6, "b2": 1.806e-7, "d": 5.07e-9, "f": 1.39e-8, "g": 1.146}


@pytest.fixture(scope="module")
def base():
    motion = twobody.simulate(PAR, (423.3, 17.96), 221.6)
    cameras = twobody.Cameras(
        221.6, windows=(18.0, 85.4, 144.9), window_length=1.5, rotor_rate=500.0, sigma=9.4e-4
    )
    data = [CaseData.of(make_record(**twobody.film(motion, 3, cameras)))]
    return fit(Model.of([n for n in REDUCED if n != "bearing.linear"]), data)


@pytest.mark.slow
def test_a_refit_that_falls_short_of_its_score_is_repeated(base):
    assert has_model_noise(base)
    (scored,) = score(base, [LIBRARY["bearing.linear"]], [CaseColumns(base, 0)], Criteria())
    found = refit(base, scored, Criteria())
    assert base.deviance - found.deviance > scored.score
    assert found.verdict == "no_lack_of_fit"
    estimate = found.estimates["bearing.linear.d"]
    assert abs(estimate.value - PAR["d"]) < 4 * estimate.stderr
