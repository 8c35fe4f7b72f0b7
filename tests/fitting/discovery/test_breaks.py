"""The time of a step is found although the search slid into the wrong hollow."""

from dataclasses import replace

import pytest
import twobody

from fitting.case_data import CaseData
from fitting.discovery.breaks import better_breaks, distant_breaks
from fitting.effects import LIBRARY, REDUCED
from fitting.estimation import fit
from fitting.model import Model
from fitting.record import make_record

T0 = 88.0


def test_the_right_hollow():
    hidden = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -1.5e-6 if t >= T0 else 0.0)
    motion = twobody.simulate(hidden=hidden, ou=1e-7, seed=2)
    data = [CaseData.of(make_record(**twobody.film(motion, 2)))]
    model = Model.of((*REDUCED, "touchpoint.step"))
    near = fit(model, data, start={"touchpoint.step.t0": T0 + 0.3, "touchpoint.step.k": 1e-6})
    assert abs(near.estimates["touchpoint.step.t0"].value - T0) < 0.2
    theta = near.theta.copy()
    theta[near.problem.layout.index["touchpoint.step.t0"]] = T0 + 3.0
    lost = replace(near, theta=theta, predictions=tuple(near.problem.predict(theta)))
    found = better_breaks(lost, LIBRARY["touchpoint.step"])
    assert abs(found["touchpoint.step.t0"] - T0) < 0.3
    assert better_breaks(near, LIBRARY["touchpoint.step"]).get("touchpoint.step.t0", T0) < T0 + 0.3
    assert set(found) == set(near.problem.layout.names)


def test_a_step_far_off_is_found_by_what_it_leaves():
    hidden = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -1.5e-6 if t >= T0 else 0.0)
    data = [CaseData.of(make_record(**twobody.film(twobody.simulate(hidden=hidden, ou=1e-7, seed=2), 2)))]
    far = fit(
        Model.of((*REDUCED, "touchpoint.step")),
        data,
        start={"touchpoint.step.t0": T0 + 60, "touchpoint.step.k": 1e-8},
    )
    assert far.verdict == "misfit"
    assert abs(far.estimates["touchpoint.step.t0"].value - T0) > 10  # beyond the reach of the near search
    found = distant_breaks(far, LIBRARY["touchpoint.step"])
    assert abs(found["touchpoint.step.t0"] - T0) < 4
    assert found["touchpoint.step.k"] == pytest.approx(1.5e-6, rel=0.3)
    quiet = replace(far, noise=tuple(replace(n, level=n.pure) for n in far.noise))
    assert distant_breaks(quiet, LIBRARY["touchpoint.step"]) == {}
