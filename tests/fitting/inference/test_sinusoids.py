"""A periodic torque is found from strength zero although the initial speed is correlated with it."""

import math

import numpy as np
import pytest
import twobody

from fitting import LIBRARY, REDUCED, Model, fit, make_record
from fitting.effects._user import resolve
from fitting.inference._case_data import CaseData
from fitting.inference._parameters import ParameterLayout, Sinusoid, find_sinusoids, from_polar, to_polar

STRENGTH, PHASE = 6e-6, 4.1
HIDDEN = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: STRENGTH * math.sin(pc - PHASE))


@pytest.fixture(scope="module")
def unbalanced():
    motion = twobody.simulate(hidden=HIDDEN, span=100.0, step=0.005, seed=2)
    return CaseData.of(
        make_record(**twobody.film(motion, 2, twobody.Cameras(span=100.0, windows=(5.0, 60.0))))
    )


@pytest.mark.slow
@pytest.mark.parametrize("start", [{}, {"casing.unbalance.k": 1e-6, "casing.unbalance.phi": PHASE + math.pi}])
@pytest.mark.release
def test_a_strong_unbalance_is_found_from_zero_and_from_the_opposite_phase(unbalanced, start):
    found = fit(Model.of((*REDUCED, "casing.unbalance")), [unbalanced], start=start)
    k, phi = (found.estimates[f"casing.unbalance.{s}"] for s in ("k", "phi"))
    assert found.verdict == "no_lack_of_fit"
    assert k.stderr < 0.05 * STRENGTH
    assert k.value == pytest.approx(STRENGTH, abs=4 * k.stderr)
    assert math.remainder(phi.value - PHASE, 2 * math.pi) == pytest.approx(0.0, abs=4 * phi.stderr)


def layout(*effects, cases=1, **more):
    film = twobody.film(twobody.simulate(span=12.0), 0, twobody.Cameras(span=12.0, windows=(2.0, 7.0)))
    records = [make_record(**film | {"label": f"case{i}"}) for i in range(cases)]
    return ParameterLayout.of(Model((*Model.of(REDUCED).effects, *effects)), records, **more)


def test_laws_with_free_strength_and_phase_have_linear_variables():
    unbalance, swing = LIBRARY["casing.unbalance"], resolve("casing: k*cos(3*t + phi)")
    place = layout(unbalance).index
    assert find_sinusoids(layout(unbalance)) == (
        Sinusoid(place["casing.unbalance.k"], place["casing.unbalance.phi"]),
    )
    assert len(find_sinusoids(layout(unbalance, swing))) == 2
    assert len(find_sinusoids(layout(unbalance, cases=2, per_case=["casing.unbalance"]))) == 2
    assert find_sinusoids(layout(unbalance, cases=2, per_case=["casing.unbalance.k"])) == ()
    assert find_sinusoids(layout(LIBRARY["casing.precession"])) == ()
    assert find_sinusoids(layout()) == ()


@pytest.mark.parametrize("held", [{"casing.unbalance.phi": (1.0, 1.0)}, {"casing.unbalance.k": (0.0, 1e-6)}])
def test_held_or_bounded_laws_keep_strength_and_phase(held):
    assert find_sinusoids(layout(LIBRARY["casing.unbalance"], ranges=held)) == ()


def test_there_and_back_and_the_slope():
    waves = (Sinusoid(0, 2), Sinusoid(3, 1))
    u = np.array([2e-6, -3e-7, -1e-6, 4e-7, 900.0])
    theta, slope = to_polar(u, waves)
    assert from_polar(theta, waves) == pytest.approx(u, rel=1e-12)
    for i, step in enumerate(1e-6 * np.abs(u)):
        there, back = (to_polar(u + s * step * np.eye(5)[i], waves)[0] for s in (1, -1))
        assert slope[:, i] == pytest.approx((there - back) / (2 * step), rel=1e-6, abs=1e-12)


def test_zero_strength_keeps_a_phase():
    theta, slope = to_polar(np.zeros(2), (Sinusoid(0, 1),))
    assert 0 < theta[0] < 1e-20
    assert np.isfinite(slope).all()
