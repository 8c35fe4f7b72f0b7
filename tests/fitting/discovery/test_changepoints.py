"""The changepoint of a step is found although the search ended in a wrong minimum."""

from dataclasses import replace

import pytest
import twobody

from fitting import LIBRARY, REDUCED, Criteria, Model, make_record
from fitting.discovery._refine import distant_changepoints, local_changepoints
from fitting.discovery._score import CaseColumns, score
from fitting.discovery._select import found_starts
from fitting.effects._user import resolve
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit

T0 = 88.0


@pytest.mark.slow
def test_the_local_scan_finds_a_nearby_changepoint():
    hidden = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -1.5e-6 if t >= T0 else 0.0)
    motion = twobody.simulate(hidden=hidden, ou=1e-7, seed=2)
    data = [CaseData.of(make_record(**twobody.film(motion, 2, twobody.FEWER_FRAMES)))]
    model = Model.of((*REDUCED, "touchpoint.step"))
    near = fit(model, data, start={"touchpoint.step.t0": T0 + 0.3, "touchpoint.step.k": 1e-6})
    assert abs(near.estimates["touchpoint.step.t0"].value - T0) < 0.2
    theta = near.theta.copy()
    theta[near.problem.layout.index["touchpoint.step.t0"]] = T0 + 3.0
    lost = replace(near, theta=theta, predictions=tuple(near.problem.predict(theta)))
    found = local_changepoints(lost, LIBRARY["touchpoint.step"])
    assert abs(found["touchpoint.step.t0"] - T0) < 0.3
    assert local_changepoints(near, LIBRARY["touchpoint.step"]).get("touchpoint.step.t0", T0) < T0 + 0.3
    assert set(found) == set(near.problem.layout.names)


@pytest.mark.slow
def test_a_distant_changepoint_is_found_from_the_residual_torque():
    hidden = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -1.5e-6 if t >= T0 else 0.0)
    data = [CaseData.of(make_record(**twobody.film(twobody.simulate(hidden=hidden, ou=1e-7, seed=2), 2)))]
    far = fit(
        Model.of((*REDUCED, "touchpoint.step")),
        data,
        start={"touchpoint.step.t0": T0 + 60, "touchpoint.step.k": 1e-8},
    )
    assert far.verdict == "lack_of_fit"
    assert abs(far.estimates["touchpoint.step.t0"].value - T0) > 10  # beyond the reach of the near search
    found = distant_changepoints(far, LIBRARY["touchpoint.step"], Criteria())
    assert abs(found["touchpoint.step.t0"] - T0) < 4
    assert found["touchpoint.step.k"] == pytest.approx(1.5e-6, rel=0.3)
    quiet = replace(far, noise=tuple(replace(n, level=n.pure) for n in far.noise))
    assert distant_changepoints(quiet, LIBRARY["touchpoint.step"], Criteria()) == {}


@pytest.mark.slow
@pytest.mark.parametrize("at", [0.35, 0.57, 0.61])
@pytest.mark.release
def test_a_strong_step_is_found_in_its_narrow_minimum(at):
    par = {**twobody.PAPER, "a2": 1.97e-10, "b1": 3e-6, "b2": 3.7e-7, "d": 3.2e-8, "f": 4.86e-7, "g": 0.62}
    span = 60.0
    hidden = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -4e-6 if t >= at * span else 0.0)
    motion = twobody.simulate(par, (566.0, 25.0), span, hidden=hidden, seed=1, step=0.01)
    cameras = twobody.Cameras(span, windows=tuple(w * span for w in (0.08, 0.32, 0.8)), window_length=1.5)
    base = fit(Model.of(REDUCED), [CaseData.of(make_record(**twobody.film(motion, 1, cameras)))])
    step = LIBRARY["touchpoint.step"]
    (seen,) = score(base, [step], [CaseColumns(base, 0)], Criteria())
    assert seen.score > 100
    assert seen.shape[0]["t0"] == pytest.approx(at * span, abs=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["touchpoint.step", "casing: -k*heaviside(t - t0)"])
@pytest.mark.release
def test_a_changepoint_that_is_added_to_a_fit_is_searched_first(name):
    hidden = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -1.2e-5 if t >= 126.4 else 0.0)
    data = [CaseData.of(make_record(**twobody.film(twobody.simulate(hidden=hidden, ou=1e-7, seed=4), 4)))]
    base = fit(Model.of(REDUCED), data)
    step = resolve(name)
    parent = {name: e.value for name, e in base.estimates.items()}
    found = fit(base.model.with_effect(step), data, start=parent | found_starts(base, [step]))
    assert found.verdict == "no_lack_of_fit"
    t0, k = (found.estimates[f"{name}.{s}"] for s in ("t0", "k"))
    assert t0.value == pytest.approx(126.4, abs=0.1)
    assert k.value == pytest.approx(1.2e-5, abs=4 * k.stderr)
    # from the parent's values alone the search stays in another hollow
    assert fit(base.model.with_effect(step), data, start=parent).verdict == "lack_of_fit"
