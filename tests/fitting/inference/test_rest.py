"""A casing that comes to rest within the record, and one of the opposite sense of rotation."""

import numpy as np
import pytest
import reference
import twobody
from cases import pulls

from fitting import REDUCED, Model, fit, make_record


def with_rest(own, span=200.0, start=(900.0, 5.0), seed=0):
    """A record of SciPy's own integration with event location, filmed; and the events."""
    p = reference.PAPER | own
    rng = np.random.default_rng(seed)
    casing = np.arange(0, span, 1 / 260)
    windows = [w * span + np.arange(3000) / 1000 for w in (0.025, 0.35, 0.75)]
    every = np.unique(np.concatenate([casing, *windows]))
    y, events = reference.integrate_through_rest(p, start, every)

    def run(times, row):
        value = y[row][np.searchsorted(every, times)] - (row == 3) * y[3][np.searchsorted(every, times[0])]
        return times, value + 1e-3 * rng.standard_normal(len(times)), np.full(len(times), 1e-3)

    record = make_record(
        casing=run(casing, 4), rotor=[run(w, 3) for w in windows], label="case1",
        I_rotor=twobody.I_ROTOR, I_casing=twobody.I_CASING,
    )  # fmt: skip
    true = p | {"initial.omega_r@case1": start[0], "initial.omega_c@case1": start[1]}
    return record, true, events


RESTS = {
    "late": {"touchpoint.constant.b1": 1.2e-4},
    "early": {"touchpoint.constant.b1": 1.8e-4},
    "freed": {"touchpoint.constant.b1": 2.6e-4, "touchpoint.drift.k": -1.1e-6},
}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n == "early" else pytest.mark.slow) for n in RESTS]
)
@pytest.mark.slow
@pytest.mark.release
def test_a_casing_that_comes_to_rest_within_the_record_is_fitted(name):
    record, true, events = with_rest(RESTS[name])
    effects = dict.fromkeys([*REDUCED, *(k.rpartition(".")[0] for k in RESTS[name])])
    result = fit(Model.of(effects), [record])
    assert result.verdict == "no_lack_of_fit"
    assert max(map(abs, pulls(result, true).values())) < 4
    assert result.predictions[0].path.kinks == pytest.approx([t for t, _ in events], abs=0.01)
    # the moment at which it stops fixes the friction as nothing else does
    b1 = result.estimates["touchpoint.constant.b1"]
    assert b1.stderr < 1e-4 * b1.value
    assert 0.95 < result.reduced_chi2 < 1.05
    assert result.cases[0].energy_drift < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("start", [(-900.0, -5.0), (900.0, -20.0)])
def test_a_rotor_of_the_opposite_sense_is_fitted(start):
    """All laws of the reduced model follow the sense of the motion: the parameters are the same."""
    motion = twobody.simulate(start=start, seed=3)
    result = fit(Model.of(REDUCED), [make_record(**twobody.film(motion, seed=3))])
    assert result.verdict == "no_lack_of_fit"
    assert max(map(abs, pulls(result, twobody.truth(start=start)).values())) < 4


@pytest.mark.slow
def test_initial_values_with_many_stops_converge():
    """After many stops the fundamental matrix has no inverse."""
    par = {**twobody.PAPER, "b1": 4.5e-5, "b2": 9.5e-7}
    cameras = twobody.Cameras(span=180.0, windows=(4.0, 63.0, 135.0))
    motion = twobody.simulate(par, (950.0, 8.0), 180.0, ou=1e-7)
    record = make_record(**twobody.film(motion, cameras=cameras))
    true = twobody.truth(par, (950.0, 8.0))
    factors = dict(zip(twobody.PAPER, (2.0, 2.0, 2.0, 2.0, 0.5, 1.06), strict=True))
    start = {twobody.KEYS[k]: f * par[k] for k, f in factors.items()}
    found = fit(Model.of(REDUCED), [record], start=start)
    assert found.verdict == "no_lack_of_fit"
    for key, e in found.estimates.items():
        assert abs(e.value - true[key]) < 4 * e.stderr
