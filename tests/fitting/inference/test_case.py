"""A case from arrays, its parameters and reports, compared with SciPy and with closed forms."""

import math
import pickle
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from cases import data
from scipy.optimize import curve_fit

import fitting
from fitting import Case, EffectError, EstimationError, FittingError, Input, Params, RecordError, fit
from fitting.inference._case import inward, outward

A, B, W0, U = 0.4, 0.05, 20.0, 0.05
T = np.linspace(0.0, 24.0, 240)


def speed(t, a, b, w0):
    """Spin-down by dry and viscous friction, d(omega)/dt = -a - b omega."""
    return (w0 + a / b) * np.exp(-b * t) - a / b


OMEGA = speed(T, A, B, W0) + U * np.random.default_rng(0).standard_normal(len(T))


@pytest.fixture(scope="module")
def case():
    return Case.from_arrays(wheel={"t": T, "omega": OMEGA, "u": U}, label="run 7")


@pytest.fixture(scope="module")
def found(case):
    return fit("support.constant + air.linear", case)


@pytest.fixture(scope="module")
def scipys():
    return curve_fit(speed, T, OMEGA, p0=(0.3, 0.1, 19.0), sigma=np.full(len(T), U), absolute_sigma=True)


def test_values_and_correlations_are_those_of_scipy(found, scipys):
    value, covariance = scipys
    names = ("b1", "b2", "initial.omega")
    error = np.sqrt(np.diag(covariance))
    for name, v, e in zip(names, value, error, strict=True):
        assert found.params[name].value == pytest.approx(v, abs=1e-4 * e)
    # this package estimates the noise from the data, scipy takes the stated one
    scale = found.problem.data[0].casing.scale
    np.testing.assert_allclose([found.params[n].stderr for n in names], scale * error, rtol=0.06)
    size = np.outer(error, error)
    full = [found.params.full_name(n) for n in names]
    correlations = {frozenset(pair): c for *pair, c in found.correlations()}
    for i, j in ((0, 1), (0, 2), (1, 2)):
        assert correlations[frozenset((full[i], full[j]))] == pytest.approx(
            (covariance / size)[i, j], abs=1e-3
        )


def test_curve_and_residuals_are_those_of_scipy(found, scipys):
    best = speed(T, *scipys[0])
    np.testing.assert_allclose(found.eval(), best, atol=1e-6)
    np.testing.assert_allclose(found.eval([3.0, 5.0]), speed(np.array([3.0, 5.0]), *scipys[0]), atol=1e-6)
    np.testing.assert_allclose(found.residual, (OMEGA - best) / U, atol=1e-4)
    with pytest.raises(EstimationError, match="not within the record"):
        found.eval(25.0)
    with pytest.raises(EstimationError, match="no start angle"):
        found.eval(quantity="angle")


def test_angles_are_evaluated_with_their_start():
    angle = 3.0 + (W0 + A / B) / B * (1 - np.exp(-B * T)) - A / B * T
    noise = 1e-3 * np.random.default_rng(1).standard_normal(len(T))
    found = fit(
        "support.constant + air.linear", Case.from_arrays(disc={"t": T, "angle": angle + noise, "u": 1e-3})
    )
    np.testing.assert_allclose(found.eval(), angle, atol=5e-4)
    np.testing.assert_allclose(found.eval([1.0], quantity="omega"), speed(1.0, A, B, W0), atol=1e-3)
    assert np.std(found.residual) == pytest.approx(np.std(noise) / 1e-3, rel=0.05)


def test_names_of_a_body_alone(found):
    assert list(found.params) == ["wheel.support.constant.b1", "wheel.air.linear.b2", "initial.omega"]
    assert found.params["linear.b2"] is found.params["wheel.air.linear.b2"]
    assert "b2" in found.params
    assert "b3" not in found.params
    assert 3 not in found.params
    with pytest.raises(EffectError, match="no parameter 'b3'"):
        found.params["b3"]
    assert found.params.valuesdict()["initial.omega"] == found.params["omega"].value


@pytest.mark.parametrize(
    ("shown", "inner"),
    [
        ("wheel.air.quadratic", "casing.air.quadratic"),
        ("wheel.support.constant.b1", "touchpoint.constant.b1"),
        ("wheel: -k*omega**3", "casing: -k*omega_c**3"),
        ("initial.omega@run", "initial.omega_c@run"),
        ("wheel.input.current", "casing.input.current"),
        ("camera.centre.eps", "camera.centre.eps"),
    ],
)
def test_names_go_both_ways(shown, inner):
    assert outward(inner, "wheel") == shown
    assert inward(shown, "wheel") == inner
    assert (outward(inner, ""), inward(inner, "")) == (inner, inner)


def test_short_names_of_a_case_of_one_body():
    assert inward("air.quadratic", "wheel") == "casing.air.quadratic"
    assert inward("support.constant", "wheel") == "touchpoint.constant"
    # omega is a whole word
    assert inward("wheel: -k*omega_c", "wheel") == "casing: -k*omega_c"
    assert inward("camera.clock", "wheel") == "camera.clock"


def test_a_report_shows_values_relative_errors_and_correlations(found):
    lines = found.fit_report().splitlines()
    assert lines[:2] == ["[[Model]]", "    wheel.support.constant + wheel.air.linear"]
    assert any(x.split() == ["variables", "=", "3"] for x in lines)
    row = next(x for x in lines if "air.linear.b2:" in x)
    e = found.params["b2"]
    assert f"({100 * e.stderr / e.value:.2f}%)" in row
    assert "0.0501 +- 0.0001" in row or "+-" in row
    assert sum(x.lstrip().startswith("C(") for x in lines) == 3
    assert not any(x.lstrip().startswith("C(") for x in found.fit_report(0.99).splitlines())
    assert found.aic == pytest.approx(found.deviance + 6)


def test_a_held_parameter_leaves_the_curvature_of_the_others(case, found):
    held = fit("support.constant + air.linear", case, params={"b2": {"value": 0.05, "vary": False}})
    assert held.params["b2"].vary is False
    assert held.params["b2"].value == 0.05
    assert held.params["b1"].stderr < 0.5 * found.params["b1"].stderr


def test_a_bound_is_kept(case):
    low = fit("support.constant + air.linear", case, params={"b2": {"min": 0.051, "max": 1.0}})
    assert low.params["b2"].value == pytest.approx(0.051)
    assert low.params["b2"].at_bound
    free = fit("support.constant + air.linear", case, params={"b2": {"min": 0.049, "max": 0.051}})
    assert not free.params["b2"].at_bound


def test_a_tied_parameter_follows_its_expression(case, found):
    """Against least squares of SciPy in the two variables that are left, b1 = 8 b2."""
    tied = fit("support.constant + air.linear", case, params={"b1": {"expr": "8*b2"}})
    value, covariance = curve_fit(
        lambda t, b, w0: speed(t, 8 * b, b, w0),
        T,
        OMEGA,
        p0=(0.1, 19.0),
        sigma=np.full(len(T), U),
        absolute_sigma=True,
    )
    b, u = value[0], math.sqrt(covariance[0, 0])
    assert tied.params["b2"].value == pytest.approx(b, abs=1e-3 * u)
    assert tied.params["b1"].value == pytest.approx(8 * tied.params["b2"].value, rel=1e-12)
    assert tied.params["b1"].stderr == pytest.approx(8 * tied.params["b2"].stderr, rel=1e-9)
    assert tied.params["b2"].stderr == pytest.approx(tied.problem.data[0].casing.scale * u, rel=0.06)
    assert tied.params["b1"].expr == "8*b2"
    assert "(= 8*b2)" in repr(tied.params)
    # two free parameters instead of three
    assert tied.aic == pytest.approx(tied.deviance + 4)
    fewer = (found.bic - found.deviance) - (tied.bic - tied.deviance)
    assert fewer == pytest.approx(math.log(tied.rows))
    assert tied.conf_interval().keys() == {"wheel.air.linear.b2"}


def test_params_of_a_fit_are_settings_of_the_next(case, found):
    params = found.params.set("b1", expr="8*b2")
    assert found.params["b1"].expr is None
    tied = fit("support.constant + air.linear", case, params=params)
    assert tied.params["b1"].value == pytest.approx(8 * tied.params["b2"].value)
    freed = fit("support.constant + air.linear", case, params=tied.params.set("b1", expr=None))
    assert freed.params["b1"].value == pytest.approx(found.params["b1"].value, rel=1e-6)
    held = fit("support.constant + air.linear", case, params=found.params.set("b2", value=0.06, vary=False))
    assert held.params["b2"].value == 0.06
    # parameters of another model are ignored
    other = fit("air.linear", case, params=found.params)
    assert list(other.params) == ["wheel.air.linear.b2", "initial.omega"]


def test_a_saved_tie_is_fitted_again(case, tmp_path):
    tied = fit("support.constant + air.linear", case, params={"b1": {"expr": "8*b2"}})
    tied.save(tmp_path / "fit.json")
    again = fitting.load_fit(tmp_path / "fit.json")
    assert again.estimates["touchpoint.constant.b1"].expr == "8*b2"
    assert again.params["b1"].value == tied.params["b1"].value
    refit = again.refit([case.record])
    assert refit.estimates["touchpoint.constant.b1"].value == pytest.approx(tied.params["b1"].value, rel=1e-6)


def test_intervals_at_several_levels(found):
    """Of a problem that is nearly linear they are those of the normal distribution."""
    e = found.params["b2"]
    ((name, several),) = found.conf_interval("b2", level=[0.6827, 0.9545]).items()
    assert name == "b2"
    for level, z in ((0.6827, 1.0), (0.9545, 2.0)):
        assert several[level].upper - several[level].lower == pytest.approx(2 * z * e.stderr, rel=0.05)


def test_laws_of_a_body_with_an_input():
    """Current of a motor and viscous friction: omega of a step is i k / b (1 - exp(-b t))."""
    t = np.linspace(0.0, 60.0, 600)
    omega = 2.0 * 3.0 / 0.2 * (1 - np.exp(-0.2 * t)) + 0.5
    noise = 0.01 * np.random.default_rng(2).standard_normal(len(t))
    current = {"t": [0.0, 60.0], "value": [3.0, 3.0], "unit": "A"}
    case = Case.from_arrays(motor={"t": t, "omega": omega + noise, "u": 0.01}, inputs={"current": current})
    assert case.inputs[0].unit == "A"
    model = case.model("motor: k*current", "motor: -b*(omega - 0.5)")
    found = fit(model, case)
    assert found.params["k"].value == pytest.approx(2.0, abs=4 * found.params["k"].stderr)
    assert found.params["b"].value == pytest.approx(0.2, abs=4 * found.params["b"].stderr)


def test_a_gyroscope_keeps_its_names(case):
    record = data(seed=0).record
    runs = [{"t": w.time, "angle": w.value, "u": w.sigma, "inertia": record.I_rotor} for w in record.rotor]
    casing = {"t": record.casing.time, "angle": record.casing.value, "u": record.casing.sigma}
    again = Case.from_arrays(casing=casing | {"inertia": record.I_casing}, rotor=runs, label=record.label)
    assert again.record.digest == record.digest
    assert again.bodies == ("casing", "rotor")
    assert case.bodies == ("wheel",)
    assert case.torque_unit == "rad/s2"


def test_repr_of_a_case(case):
    assert repr(case).splitlines() == [
        "Case 'run 7': angular velocities, 0 to 24 s",
        "  wheel: 240 samples",
        "  torques are per unit of inertia",
    ]


def test_draws_have_the_covariance_of_the_fit(found):
    from fitting.inference._posterior import draws

    drawn = draws(found, 4000, 2, "linearised", 1)
    assert drawn.shape == (2, 4000, len(found.theta))
    flat = drawn.reshape(-1, drawn.shape[-1])
    free = np.diag(found.covariance) > 0
    expected = found.covariance[np.ix_(free, free)]
    error = np.sqrt(np.diag(expected))
    assert np.abs((flat[:, free].mean(axis=0) - found.theta[free]) / error).max() < 5 / math.sqrt(8000)
    size = np.outer(error, error)
    np.testing.assert_allclose(np.cov(flat[:, free].T) / size, expected / size, atol=0.05)
    assert (flat[:, ~free] == found.theta[~free]).all()


@pytest.mark.parametrize(("version", "posterior"), [("0.23.4", False), ("1.3.0", True)])
def test_arviz_has_two_ways_of_taking_draws(found, monkeypatch, version, posterior):
    taken = []
    from_dict = lambda *args, **kwargs: taken.append((args, kwargs))  # noqa: E731
    monkeypatch.setitem(sys.modules, "arviz", SimpleNamespace(__version__=version, from_dict=from_dict))
    found.to_arviz(5, chains=2)
    ((args, kwargs),) = taken
    groups = args[0] if posterior else kwargs
    assert set(groups["posterior"]) == set(found.params)
    assert groups["posterior"]["initial.omega"].shape == (2, 5)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_posterior_for_arviz(found):
    pytest.importorskip("arviz")
    posterior = found.to_arviz(200, chains=2).posterior
    assert posterior["wheel.air.linear.b2"].shape == (2, 200)
    assert float(posterior["wheel.air.linear.b2"].std()) == pytest.approx(found.params["b2"].stderr, rel=0.2)


@pytest.mark.parametrize(("module", "method"), [("arviz", "linearised"), ("emcee", "emcee")])
def test_absent_packages_are_named(found, monkeypatch, module, method):
    monkeypatch.setitem(sys.modules, "arviz", SimpleNamespace())
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(EstimationError, match=f"needs {module}, which is not installed") as fault:
        found.to_arviz(10, method=method)
    assert fault.value.hint == 'pip install "gyrotrack[bayes]"'


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_sampling_agrees_with_the_linearised_posterior(found):
    pytest.importorskip("emcee")
    from fitting.inference._posterior import draws

    sampled = draws(found, 150, 8, "emcee", 3)
    index = found.problem.layout.index
    for key, e in found.estimates.items():
        values = sampled[..., index[key]]
        assert values.std() == pytest.approx(e.stderr, rel=0.25)
        assert values.mean() == pytest.approx(e.value, abs=0.3 * e.stderr)


ARRAYS = {"t": T, "omega": OMEGA}


@pytest.mark.parametrize(
    ("bodies", "message"),
    [
        ({}, "a case needs a body"),
        ({"wheel": ARRAYS, "drum": ARRAYS}, "a case has one body, or the casing and the rotor"),
        ({"rotor": ARRAYS}, "'rotor' cannot be the name of a single body"),
        ({"a b": ARRAYS}, "'a b' cannot be the name"),
        ({"wheel": T}, "wheel is a ndarray, not a mapping"),
        ({"wheel": [ARRAYS, ARRAYS]}, "wheel is a list, not a mapping"),
        ({"wheel": {"t": T}}, "needs its times t and one of omega and angle"),
        ({"wheel": ARRAYS | {"angle": OMEGA}}, "one of omega and angle"),
        ({"wheel": ARRAYS | {"speed": OMEGA}}, "unknown entry 'speed'"),
        ({"wheel": ARRAYS | {"u": 0.0}}, "an uncertainty of wheel is not positive"),
        ({"wheel": ARRAYS | {"u": T[:5] + 1}}, r"the shapes \(240,\), \(240,\) and \(5,\)"),
        ({"wheel": ARRAYS | {"t": ["x"] * 240}}, "t of wheel holds no numbers"),
        ({"wheel": ARRAYS | {"inertia": -1.0}}, "the inertia of wheel is -1.0"),
        ({"wheel": ARRAYS | {"inertia": "heavy"}}, "inertia of wheel is a str"),
        ({"casing": ARRAYS, "rotor": ARRAYS}, "needs the inertia of both bodies"),
        ({"casing": ARRAYS, "rotor": []}, "rotor has no window"),
        (
            {"wheel": ARRAYS, "inputs": {"current": {"t": T}}},
            "the input current needs its times t and its values",
        ),
        ({"wheel": ARRAYS, "label": 3}, "the label is a int, not a string"),
        ({"wheel": {"t": T[::-1], "omega": OMEGA}}, "the times of the wheel|times of the body"),
    ],
)
def test_wrong_arrays_are_one_sentence(bodies, message):
    with pytest.raises(RecordError, match=message):
        Case.from_arrays(**bodies)


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ([1.0], "params is a list"),
        ({"b7": {"value": 1.0}}, "no parameter 'b7'"),
        ({"b1": {"valu": 1.0}}, "no setting 'valu'"),
        ({"b1": 3.0}, "the settings of b1 are a float"),
        ({"b1": {"vary": False}}, "is held without a value"),
        ({"b1": {"vary": 1}}, "vary of b1 is '1'"),
        ({"b1": {"value": math.nan}}, "the value of b1 is nan"),
        ({"b1": {"min": 1.0, "max": 0.5}}, "the range of touchpoint.constant.b1 is 1 to 0.5"),
        ({"b1": {"expr": "2*b9"}}, "no parameter 'b9'"),
        ({"b1": {"expr": "2*"}}, "2"),
        ({"b1": {"expr": "2*b2"}, "b2": {"expr": "b1/2"}}, "are circular"),
        ({"b1": {"expr": "b1 + 1"}}, "are circular"),
    ],
)
def test_wrong_settings_are_one_sentence(case, params, message):
    with pytest.raises(FittingError, match=message):
        fit("support.constant + air.linear", case, params=params)


def test_a_tie_between_shared_and_own_parameters_is_refused(case):
    other = Case.from_arrays(wheel=ARRAYS | {"u": U}, label="run 8")
    model = "air.quadratic + support.constant"
    with pytest.raises(EffectError, match="has one value for all cases"):
        fit(model, [case, other], params={"air.quadratic.k": {"expr": "0.01*b1"}})


def test_a_range_of_ties_per_case(case):
    """Each case has its own value of a tied parameter, which follows that of the same case."""
    omega = OMEGA + speed(T, 0.2, B, W0) - speed(T, A, B, W0)
    other = Case.from_arrays(wheel={"t": T, "omega": omega, "u": U}, label="run 8")
    both = fit("support.constant + air.linear", [case, other], params={"b2": {"expr": "b1/8"}})
    for label in ("run 7", "run 8"):
        own = {k: e for k, e in both.estimates.items() if k.endswith(f"@{label}")}
        assert own[f"casing.air.linear.b2@{label}"].value == pytest.approx(
            own[f"touchpoint.constant.b1@{label}"].value / 8
        )


def test_public_functions_are_pickled_by_name():
    assert pickle.loads(pickle.dumps(fitting.diagnose)) is fitting.diagnose  # noqa: S301 - our own


def test_params_print_within_a_screen(found):
    many = Params({f"p{i}": found.params["b1"] for i in range(50)})
    lines = repr(many).splitlines()
    assert len(lines) == 20
    assert lines[-1] == "  ... 32 more"


def test_inputs_may_be_given_as_such():
    current = Input("current", T, T, "A")
    assert Case.from_arrays(wheel=ARRAYS, inputs=[current]).inputs[0].name == "current"
    with pytest.raises(RecordError, match="unknown entry 'units'"):
        Case.from_arrays(wheel=ARRAYS, inputs={"current": {"t": T, "value": T, "units": "A"}})
