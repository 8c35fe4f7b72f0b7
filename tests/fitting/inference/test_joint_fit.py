"""Joint fits: shared parameters, parameters of each case, and their uncertainties."""

from dataclasses import replace

import pytest
import twobody
from cases import case, data, pulls

from fitting import GENERAL, LINEAR, REDUCED, EstimationError, Model, make_record
from fitting.inference._case_data import CaseData
from fitting.inference._fit import fit
from fitting.inference._initial_values import initial_values
from fitting.inference._parameters import ParameterLayout
from fitting.inference._problem import Problem


@pytest.mark.slow
def test_joint_fit_of_two_surfaces_recovers_the_parameters():
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
    assert result.verdict == "no_lack_of_fit"
    assert [c.label for c in result.cases] == ["glass", "steel"]
    alone = fit(Model.of(REDUCED), both[:1])
    for key in ("bearing.linear.d", "bearing.power.g", "rotor.air.quadratic.a2"):
        assert result.estimates[key].stderr < alone.estimates[key].stderr
    # what the surfaces do not share is not shared; asked to share it, the model must fail
    shared = fit(Model.of(REDUCED), both, share=["touchpoint.constant", "b2"])
    assert "touchpoint.constant.b1" in shared.estimates
    assert shared.verdict != "no_lack_of_fit"


@pytest.mark.parametrize("free", [["d"], pytest.param(["d", "f", "g"], marks=pytest.mark.slow)])
@pytest.mark.slow
def test_a_bearing_with_per_case_parameters_is_fitted(free):
    """Two bearings: each has its transformed variables."""
    other = {"d": 1.3e-7, "f": 1.0e-8, "g": 1.34} if len(free) > 1 else {"d": 1.4e-7}
    both = [case({}, 21, "glass"), case(other, 22, "steel", start=(850.0, 9.0))]
    result = fit(Model.of(REDUCED), both, per_case=free)
    assert len(result.problem.power_laws) == 2
    assert result.verdict == "no_lack_of_fit"
    true = {twobody.KEYS[k]: v for k, v in twobody.PAPER.items() if k not in free}
    for k in free:
        true |= {f"{twobody.KEYS[k]}@glass": twobody.PAPER[k], f"{twobody.KEYS[k]}@steel": other[k]}
    found = pulls(result, true)
    assert set(true) - set(found) == {"touchpoint.constant.b1", "casing.air.linear.b2"}
    assert max(map(abs, found.values())) < 4


@pytest.mark.slow
@pytest.mark.release
def test_start_values_do_not_depend_on_how_many_cases_share_them():
    record = data(seed=0).record
    starts = []
    for count in (1, 4):
        cases = [CaseData.of(replace(record, label=f"r{i}")) for i in range(count)]
        layout = ParameterLayout.of(Model.of(REDUCED), [c.record for c in cases], share=["b1", "b2"])
        starts.append(dict(zip(layout.names, initial_values(Problem.of(layout, cases), None), strict=True)))
    for name in Model.of(REDUCED).free:
        assert starts[1][name] == pytest.approx(starts[0][name], rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [71, 81])
@pytest.mark.release
def test_a_case_with_a_lack_of_fit_does_not_bias_the_other(seed):
    """Process noise in both cases would allow a compromise, with b1 of the good case wrong by 40 %."""
    drag = twobody.Hidden(casing=lambda t, wr, wc, pr, pc: -3e-5 * (wc / 100) ** 2)
    cameras = twobody.Cameras(span=40.0, windows=(2.0, 18.0, 34.0), window_length=2.0)
    both = []
    for label, par, start, hidden in (
        ("failed", {}, (900.0, 5.0), drag),
        ("sound", {"b1": 20e-6}, (850.0, 9.0), None),
    ):
        own = seed + len(both)
        motion = twobody.simulate({**twobody.PAPER, **par}, start, span=40.0, seed=own, hidden=hidden)
        both.append(make_record(**twobody.film(motion, seed=own, cameras=cameras, label=label)))
    found = fit(Model.of(GENERAL), both)
    assert found.verdict == "lack_of_fit"
    failed, sound = found.noise
    assert failed.level > 10 * sound.level
    assert found.estimates["rotor.air.quadratic.a2"].value == pytest.approx(9.97e-11, rel=0.02)
    assert found.estimates["touchpoint.constant.b1@sound"].value == pytest.approx(20e-6, rel=0.05)


def test_cases_need_labels_of_their_own():
    with pytest.raises(EstimationError, match="different labels"):
        fit(Model.of(LINEAR), [data(seed=0), data(seed=0)])
    with pytest.raises(EstimationError):
        fit(Model.of(LINEAR), [])
