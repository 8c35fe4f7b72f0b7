"""Cases fitted together: what they share is one, what is their own is each one's, and the errors say so."""

import pytest
import twobody
from cases import case, data, pulls

from fitting.effects import LINEAR, REDUCED
from fitting.errors import EstimationError
from fitting.estimation import fit
from fitting.model import Model


def test_joint_fit_of_two_surfaces():
    rough = {"b1": 20e-6, "b2": 9.1e-7}
    both = [case({}, 21, "glass"), case(rough, 22, "steel", start=(850.0, 9.0))]
    result = fit(Model.of(REDUCED), both)
    true = {
        "rotor.air.quadratic.a2": 9.97e-11,
        "bearing.linear.d": 1.57e-7,
        "bearing.power.f": 1.26e-8,
        "bearing.power.g": 1.32,
        "touchpoint.constant.b1@glass": 2.88e-6,
        "touchpoint.constant.b1@steel": 20e-6,
        "casing.air.linear.b2@glass": 8.28e-7,
        "casing.air.linear.b2@steel": 9.1e-7,
        "initial.omega_r@glass": 900.0,
        "initial.omega_r@steel": 850.0,
        "initial.omega_c@glass": 5.0,
        "initial.omega_c@steel": 9.0,
    }
    assert set(result.estimates) == set(true)
    assert max(map(abs, pulls(result, true).values())) < 4
    assert result.verdict == "adequate"
    assert [c.label for c in result.cases] == ["glass", "steel"]
    alone = fit(Model.of(REDUCED), both[:1])
    for key in ("bearing.linear.d", "bearing.power.g", "rotor.air.quadratic.a2"):
        assert result.estimates[key].stderr < alone.estimates[key].stderr
    # what the surfaces do not share is not shared; asked to share it, the model must fail
    shared = fit(Model.of(REDUCED), both, share=["touchpoint.constant", "b2"])
    assert "touchpoint.constant.b1" in shared.estimates
    assert shared.verdict != "adequate"


@pytest.mark.parametrize("free", [["d"], pytest.param(["d", "f", "g"], marks=pytest.mark.slow)])
def test_a_bearing_of_its_own_in_each_case(free):
    """Two bearings: the straight variables are those of each."""
    other = {"d": 1.3e-7, "f": 1.0e-8, "g": 1.34} if len(free) > 1 else {"d": 1.4e-7}
    both = [case({}, 21, "glass"), case(other, 22, "steel", start=(850.0, 9.0))]
    result = fit(Model.of(REDUCED), both, per_case=free)
    assert len(result.problem.valleys) == 2
    assert result.verdict == "adequate"
    true = {twobody.KEYS[k]: v for k, v in twobody.PAPER.items() if k not in free}
    for k in free:
        true |= {f"{twobody.KEYS[k]}@glass": twobody.PAPER[k], f"{twobody.KEYS[k]}@steel": other[k]}
    found = pulls(result, true)
    assert set(true) - set(found) == {"touchpoint.constant.b1", "casing.air.linear.b2"}
    assert max(map(abs, found.values())) < 4


def test_cases_need_labels_of_their_own():
    with pytest.raises(EstimationError, match="different labels"):
        fit(Model.of(LINEAR), [data(seed=0), data(seed=1)])
    with pytest.raises(EstimationError):
        fit(Model.of(LINEAR), [])
