"""Harmonics of the unmodelled torque in the angle of the casing, with their uncertainty band."""

import numpy as np
import pytest
import twobody

from fitting import REDUCED, Experiment, Model, fit, make_record, simulate
from fitting.discovery._residuals import find_failures, residual_torques
from fitting.inference._angle_harmonics import angle_harmonics
from fitting.inference._case_data import CaseData

AMPLITUDE, PHASE = 4e-6, 0.9


@pytest.mark.slow
@pytest.mark.parametrize("order", [0, 1])
def test_harmonics_of_the_residual_torque_contain_an_unbalance(order):
    hidden = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: order * AMPLITUDE * np.sin(pc - PHASE))
    cameras = twobody.Cameras(span=60.0, windows=(2.0, 25.0, 55.0))
    motion = twobody.simulate(span=60.0, step=0.002, hidden=hidden, seed=4)
    found = fit(
        Model.of(REDUCED), [CaseData.of(make_record(**twobody.film(motion, seed=4, cameras=cameras)))]
    )
    (ripple,) = angle_harmonics(found)
    once, sigma_once = ripple.size(1)
    _, sigma_twice = ripple.size(2)
    assert sigma_twice < 4
    if not order:
        assert sigma_once < 4
        assert [f for f in find_failures(found, (), [ripple]) if f.kind == "ripple"] == []
        return
    truth = AMPLITUDE * np.array([np.cos(PHASE), np.sin(PHASE)])
    pull = np.linalg.solve(np.linalg.cholesky(ripple.covariance[:2, :2]), ripple.gamma[:2] - truth)
    assert np.abs(pull).max() < 4
    assert sigma_once > 6
    assert ripple.torque.max() == pytest.approx(once, rel=0.3)
    (failure,) = [f for f in find_failures(found, (), [ripple]) if f.kind == "ripple"]
    assert failure.where == "once a turn"
    assert "unmodelled torque on the casing once a turn" in str(failure)


@pytest.mark.slow
@pytest.mark.parametrize(("centre", "width"), [(10, 3), (12, 1), (30, 3)])  # rad/s
@pytest.mark.release
def test_a_lack_of_fit_elsewhere_is_not_a_harmonic(centre, width):
    hidden = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -8e-6 * np.exp(-(((wc - centre) / width) ** 2)))
    cameras = twobody.Cameras(span=60.0, windows=(2.0, 25.0, 55.0))
    motion = twobody.simulate(span=60.0, step=0.002, hidden=hidden, seed=4)
    found = fit(
        Model.of(REDUCED), [CaseData.of(make_record(**twobody.film(motion, seed=4, cameras=cameras)))]
    )
    assert found.verdict == "lack_of_fit"
    kinds = [f.kind for f in find_failures(found, residual_torques(found), angle_harmonics(found))]
    assert kinds
    assert "ripple" not in kinds


@pytest.mark.slow
@pytest.mark.release
def test_a_strong_unbalance_leaves_no_torque_on_the_rotor():
    """Angles of 4,000 turns: rounding of their constant was a torque of 3,300 uN m on the rotor, 370 on the casing."""
    strength = 3.6e-5
    truth = {
        "rotor.air.quadratic.a2": 1e-10,
        "touchpoint.constant.b1": 2.9e-6,
        "casing.air.linear.b2": 8.3e-7,
        "bearing.linear.d": 1.6e-7,
        "bearing.power.f": 1.3e-8,
        "bearing.power.g": 1.3,
        "casing.unbalance.k": strength,
        "casing.unbalance.phi": 0.0,
    }
    record = simulate(
        Model.of([*REDUCED, "casing.unbalance"]),
        truth,
        Experiment(),
        inertia_rotor=twobody.I_ROTOR,
        inertia_casing=twobody.I_CASING,
        seed=2,
    )
    found = fit(Model.of(REDUCED), [record])
    casing, rotor = residual_torques(found)
    assert np.abs(rotor.torque).max() < 0.1 * strength
    assert np.abs(casing.torque).max() < 1.6 * strength
    (first, *_) = find_failures(found, [casing, rotor], angle_harmonics(found))
    assert first.where == "once a turn"
    assert first.residual_torque_Nm == pytest.approx(strength, abs=4 * first.torque_sigma_Nm)
