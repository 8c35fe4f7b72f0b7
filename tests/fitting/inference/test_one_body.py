"""One body that spins down, against an independent integration of its equation of motion."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fitting import REDUCED, Case, EstimationError, Model, diagnose, fit, improve, make_record
from fitting.effects._user import formula, resolve

INERTIA = 2e-3
DRY, LINEAR, SQUARE = 2e-4, 3e-5, 4e-7
TIME = np.arange(0, 60, 0.04)
BASE = Model.of(REDUCED).of_bodies({"casing"})


def wheel(square=0.0, quantity="omega", seed=0, label="wheel"):
    """I dw/dt = -b1 - b2 w - k w^2, by SciPy's Runge-Kutta, with white noise."""
    solution = solve_ivp(
        lambda _, w: -(DRY + LINEAR * w + square * w * np.abs(w)) / INERTIA,
        (0, TIME[-1]),
        [80.0],
        rtol=1e-10,
        atol=1e-10,
        dense_output=True,
    )
    rng = np.random.default_rng(seed)
    sigma = 0.05 if quantity == "omega" else 1e-3
    if quantity == "omega":
        value = solution.sol(TIME)[0]
    else:  # Simpson's rule on steps of 0.04 s is exact far below the noise
        fine = solution.sol(np.linspace(0, TIME[-1], 2 * len(TIME) - 1))[0]
        steps = (fine[:-2:2] + 4 * fine[1:-1:2] + fine[2::2]) * 0.04 / 6
        value = np.concatenate([[0.0], np.cumsum(steps)])
    value = value + rng.normal(0, sigma, len(TIME))
    return make_record(
        casing=(TIME, value, np.full(len(TIME), sigma)),
        rotor=[],
        I_rotor=INERTIA,
        I_casing=INERTIA,
        quantity=quantity,
        single=True,
        label=label,
    )


def pull(found, name, truth):
    e = found.estimates[name]
    return (e.value - truth) / e.stderr


@pytest.mark.parametrize("quantity", ["omega", pytest.param("angle", marks=pytest.mark.slow)])
def test_parameters_and_errors(quantity):
    pulls = []
    for seed in range(2):
        found = fit(BASE, [wheel(quantity=quantity, seed=seed)])
        assert found.verdict == "no_lack_of_fit"
        pulls += [pull(found, "touchpoint.constant.b1", DRY), pull(found, "casing.air.linear.b2", LINEAR)]
    assert np.abs(pulls).max() < 4


def test_a_recording_of_one_turn_is_fitted():
    """Its nuisance parameters describe all rows: the noise cannot be estimated."""
    time = np.arange(50) / 25
    angle = 3.4 * time + np.random.default_rng(0).normal(0, 4e-4, 50)
    record = make_record(
        casing=(time, angle, np.full(50, 4e-4)),
        rotor=[],
        I_rotor=1.0,
        I_casing=1.0,
        single=True,
        tracked=True,
    )
    found = fit(BASE, [record])
    assert found.estimates["initial.omega_c@case"].value == pytest.approx(3.4, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("quantity", ["omega", "angle"])
@pytest.mark.release
def test_uncertainties_agree_with_the_scatter_of_many_wheels(quantity):
    fits = [fit(BASE, [wheel(quantity=quantity, seed=seed)]) for seed in range(100, 116)]
    pulls = [pull(f, "casing.air.linear.b2", LINEAR) for f in fits]
    # the rms of 16 unit normals has a spread of 0.18
    assert 0.46 < np.sqrt(np.mean(np.square(pulls))) < 1.54


@pytest.mark.slow
def test_a_missing_effect_of_a_single_body_is_found():
    base = fit(BASE, [wheel(SQUARE)])
    assert base.verdict == "lack_of_fit"
    found = diagnose(base)
    assert found.verdict == "missing_effect"
    assert found.candidates[0].effect.name == "casing.air.quadratic"
    assert all(c.effect.bodies <= {"casing"} for c in found.candidates)
    assert {f.body for f in found.failures} == {"casing"}
    last = improve(base, first=found.candidates)[-1].fit
    assert last.verdict == "no_lack_of_fit"
    assert abs(pull(last, "casing.air.quadratic.k", SQUARE)) < 4
    assert np.isnan(last.cases[0].rotor.rmse)
    assert not any(name.startswith("initial.omega_r") for name in last.estimates)


@pytest.mark.slow
def test_residuals_of_a_wrong_law_depend_on_the_speed():
    measured = wheel(SQUARE, quantity="angle")
    cubic = fit(BASE.with_effect(resolve("casing: -k*omega_c**3")), [measured])
    assert cubic.smooth_test.body == "body"
    assert cubic.smooth_test.p_value < 1e-3
    right = fit(BASE.with_effect(resolve("casing: -k*omega_c*abs(omega_c)")), [measured])
    assert right.smooth_test.p_value > 1e-3


def test_a_user_law_of_a_single_body_is_fitted():
    found = fit(BASE.with_effect(resolve("casing: -k*omega_c*abs(omega_c)")), [wheel(SQUARE)])
    (name,) = [n for n in found.estimates if n.endswith(".k")]
    assert abs(pull(found, name, SQUARE)) < 4


@pytest.mark.slow
def test_a_degenerate_law_is_never_adequate():
    """Only the product of k and w1 enters: the fit is good, and neither is determined."""
    law = formula("own", "casing", "-k*w1*omega_c", {"w1": {"unit": "1", "start": 1.0}})
    found = fit(Model.of(["touchpoint.constant"]).with_effect(law), [wheel()])
    assert found.undetermined == ["own.k", "own.w1"]
    assert found.verdict == "not_determined"
    whole = fit(BASE, [wheel()])
    assert whole.undetermined == []
    assert whole.verdict == "no_lack_of_fit"


def test_laws_that_need_rotor_data_are_refused():
    for model in (Model.of(REDUCED), BASE.with_effect(resolve("casing: -k*omega_r"))):
        with pytest.raises(EstimationError, match="needs rotor data"):
            fit(model, [wheel()])


@pytest.mark.slow
def test_single_bodies_are_fitted_jointly_but_not_with_a_gyroscope():
    both = fit(BASE, [wheel(seed=1, label="a"), wheel(seed=2, label="b")])
    assert abs(pull(both, "touchpoint.constant.b1@b", DRY)) < 4
    w = wheel()
    run = (w.casing.time, w.casing.value, w.casing.sigma)
    gyroscope = make_record(casing=run, rotor=[run], I_rotor=1e-5, I_casing=1e-5, quantity="omega", label="g")
    with pytest.raises(EstimationError, match="cannot be fitted together"):
        fit(BASE, [w, gyroscope])


def test_presliding_friction_is_not_a_candidate_of_a_body_that_never_reverses():
    from fitting.discovery._select import applicable_effects

    names = {e.name for e in applicable_effects(fit(BASE, [wheel()]), [])}
    assert "casing.friction.presliding" not in names
    assert "casing.brake.eddy" in names


def test_rms_error_of_pulses_is_that_of_their_times():
    """One pulse per turn: the angles are exact, the times are not, and the intervals grow twentyfold."""
    rate, jitter = 0.05, 7e-5
    turns = np.arange(1, 240)
    exact = -np.log(1 - 2 * np.pi * turns * rate / 80.0) / rate  # psi = 80 (1 - exp(-rate t)) / rate
    time = exact + np.random.default_rng(2).normal(0, jitter, len(exact))
    pulses = make_record(
        casing=(time, 2 * np.pi * turns, 80 * np.exp(-rate * exact) * jitter),
        rotor=[],
        I_rotor=1.0,
        I_casing=1.0,
        quantity="angle",
        single=True,
    )
    result = fit(Model.of(["casing.air.linear"]), [pulses])
    assert result.cases[0].casing.rmse == pytest.approx(result.rmse_noise, rel=0.25)


@pytest.mark.slow
@pytest.mark.release
def test_eddy_currents_on_a_wheel_are_named_although_its_base_model_is_far_from_the_motion():
    """The search of dry and viscous friction ended in a minimum with 50 times the deviance; no law was named."""
    inertia, time = 2e-3, np.arange(0.0, 30.0, 0.01)
    slow = solve_ivp(
        lambda t, y: [y[1], -(1e-4 + 8e-4 / (1.0 + (y[1] / 10.0) ** 2)) * y[1] / inertia],
        (0.0, 30.0), [0.0, 40.0], t_eval=time, rtol=1e-9, atol=1e-9,
    )  # fmt: skip
    angle = slow.y[0] + 1e-3 * np.random.default_rng(5).standard_normal(len(time))
    case = Case.from_arrays(wheel={"t": time, "angle": angle, "u": 1e-3, "inertia": inertia})
    laws = ["touchpoint.constant", "casing.air.linear"]
    base = fit(laws, case)
    near = fit(laws, case, params={"casing.air.linear.b2": {"value": 1e-4}})
    assert base.deviance < 1.01 * near.deviance
    found = diagnose(base)
    assert found.candidates[0].effect.name == "casing.brake.eddy"
    assert found.verdict == "missing_effect"
    estimates = found.candidates[0].estimates
    assert estimates["casing.brake.eddy.k"].value == pytest.approx(8e-4, rel=1e-3)
    assert estimates["casing.brake.eddy.w"].value == pytest.approx(10.0, rel=1e-3)
