"""The uncertainty budget against the fit's own errors, dimensions, refits and Monte Carlo (GUM Supplement 1)."""

import math
from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import oscillators
import pytest
from scipy.integrate import solve_ivp

from fitting import EstimationError, Experiment, Model, budget, fit, simulate
from fitting.inference import _budget
from fitting.inference._budget import combined_uncertainties, propagated
from fitting.inference._case_data import CaseData, with_free_inertia
from fitting.inference._fit import robust_fit
from fitting.inference._linear_algebra import covariance_of
from fitting.inference._noise import variance_factor

MODEL = Model.of("linear")
NUMBERS = {
    "rotor.air.quadratic.a2": 9.97e-11,
    "touchpoint.constant.b1": 2.88e-6,
    "casing.air.linear.b2": 8.28e-7,
    "bearing.linear.d": 1.57e-7,
}
SHORT = Experiment(duration=40.0, casing_fps=30.0, rotor_fps=100.0, windows=(3.0, 18.0, 34.0), sigma=3e-3)
I_ROTOR, I_CASING = 5.54e-5, 2.06e-5
U_ROTOR, U_CASING = 1.2e-8, 6e-9
CLOCK = 3e-4


def record(seed):
    return simulate(
        MODEL, NUMBERS, SHORT, inertia_rotor=I_ROTOR, inertia_casing=I_CASING, seed=seed, label="run"
    )


@pytest.fixture(scope="module")
def found():
    known = replace(record(0), I_rotor_u=U_ROTOR, I_casing_u=U_CASING)
    result = fit(MODEL, [known])
    return result, budget(result, clock_rate_u=CLOCK)


@pytest.mark.slow
@pytest.mark.parametrize(("rotor", "casing"), [(1.0, 1.5), (2.0, 2.0)])
def test_data_with_other_moments_of_inertia_have_the_noise_of_a_new_recording(rotor, casing):
    """That of the rotor's windows depends on the ratio; the other noise is kept."""
    known = CaseData.of(record(0))
    assert known.whitened(known.z).any()
    kept = known.with_inertia(rotor * I_ROTOR, casing * I_CASING)
    new = CaseData.of(replace(record(0), I_rotor=rotor * I_ROTOR, I_casing=casing * I_CASING, digest=""))
    assert kept.process_noise is known.process_noise
    assert (kept.rotor_angle_noise is known.rotor_angle_noise) == (rotor == casing)
    np.testing.assert_allclose(kept.z, new.z, rtol=1e-9)


@pytest.fixture(scope="module")
def plain():
    return fit(MODEL, [record(0)])


def part(b, source):
    return next(c for c in b.contributions if c.source == source)


def test_contributions_of_type_a_are_the_standard_error(found):
    result, budgets = found
    assert set(budgets) == set(result.estimates)
    for name, b in budgets.items():
        noise = math.sqrt(sum(c.u**2 for c in b.contributions if c.type == "A"))
        assert noise == pytest.approx(result.estimates[name].stderr, rel=1e-9)
        assert b.u == pytest.approx(math.sqrt(sum(c.u**2 for c in b.contributions)))
        assert sum(c.share for c in b.contributions) == pytest.approx(1.0)
        assert {"angle noise", "clock rate", "inertia.rotor", "inertia.casing"} <= {
            c.source for c in b.contributions
        } | {"clock rate"}


def test_sensitivity_to_the_clock_follows_from_the_unit(found):
    """Times that are 1 + eps too long: a value in s^n is (1 + eps)^n too large."""
    result, budgets = found
    for name, power in {
        "touchpoint.constant.b1": -2,
        "casing.air.linear.b2": -1,
        "bearing.linear.d": -1,
    }.items():
        c = part(budgets[name], "clock rate")
        assert c.sensitivity == pytest.approx(power * result.estimates[name].value, rel=1e-3)
        assert c.u == pytest.approx(abs(c.sensitivity) * CLOCK)
    assert part(budgets["initial.omega_r@run"], "clock rate").sensitivity == pytest.approx(-900, rel=1e-3)
    # a2 [N m s2 = kg m2] has no time in it
    assert abs(part_or_zero(budgets["rotor.air.quadratic.a2"], "clock rate")) < 1e-3


def part_or_zero(b, source):
    return next((c.sensitivity / b.value for c in b.contributions if c.source == source), 0.0)


def test_torques_are_in_proportion_to_both_inertias_together(found):
    """Only ratios of torque to inertia are observable: I_r dk/dI_r + I_c dk/dI_c = k."""
    result, budgets = found
    for name in NUMBERS:
        rotor, casing = (part(budgets[name], f"inertia.{b}").sensitivity for b in ("rotor", "casing"))
        value = result.estimates[name].value
        assert rotor * I_ROTOR + casing * I_CASING == pytest.approx(value, rel=0.02)


@pytest.mark.slow
def test_the_uncertainties_of_a_sentence_are_those_of_the_budget(found):
    """There the moments of inertia are propagated by refits, here by the derivatives of the motion."""
    result, _ = found
    budgets = budget(result)
    total = combined_uncertainties(result)
    for name in NUMBERS:
        assert total[name] == pytest.approx(budgets[name].u, rel=0.02)
    assert total["casing.air.linear.b2"] > 1.3 * result.estimates["casing.air.linear.b2"].stderr


@pytest.mark.slow
def test_unknown_inputs_do_not_contribute(plain):
    sources = {c.source for b in budget(plain, clock_rate_u=0.0).values() for c in b.contributions}
    assert sources <= {
        "angle noise",
        "process noise",
        "lack of fit",
        "camera.centre",
        "camera.tilt",
        "camera.shutter",
        "camera.blur",
    }
    first = asdict(next(iter(budget(plain).values())))
    assert set(first) == {"value", "u", "unit", "contributions"}
    assert set(first["contributions"][0]) == {"source", "type", "u", "sensitivity", "share"}


def test_an_oscillation_measured_by_an_encoder_has_no_camera_contribution():
    motion = oscillators.motion(lambda t, x, v: -4 * x - 0.05 * v, (0.5, 0.0), 40.0)
    model = Model.of(("casing.spring.linear", "casing.air.linear"))
    result = fit(model, [oscillators.record(*motion[:2], 1e-3, 1)])
    for name, b in budget(result, clock_rate_u=0.0).items():
        assert {c.source for c in b.contributions} <= {"angle noise", "process noise", "lack of fit"}
        assert b.u == pytest.approx(result.estimates[name].stderr, rel=1e-9)


def test_sensitivity_to_the_scale_of_measured_speeds(plain):
    """Speeds that are 1 + eps too large: dry friction is 1 + eps too large, a drag linear in the speed right, and the
    quadratic one 1 + eps too small."""
    inertia, t = 2e-3, np.arange(0, 60, 0.02)
    laws = {
        "touchpoint.constant.b1": (2e-4, -1),
        "casing.air.linear.b2": (3e-5, 0),
        "casing.air.quadratic.k": (4e-7, 1),
    }
    b1, b2, k = (value for value, _ in laws.values())
    turn = solve_ivp(
        lambda _, w: -(b1 + b2 * w + k * w**2) / inertia, (0, 60), [80.0], t_eval=t, rtol=1e-10, atol=1e-10
    )
    speeds = turn.y[0] + np.random.default_rng(0).normal(0, 0.05, len(t))
    run = oscillators.record(t, speeds, 0.05, 0, quantity="omega")
    model = Model.of(tuple(n.rpartition(".")[0] for n in laws)).of_bodies({"casing"})
    result = fit(model, [replace(run, I_rotor=inertia, I_casing=inertia)])
    budgets = budget(result, speed_scale_u=0.01)
    for name, (_, power) in laws.items():
        scale = next((c for c in budgets[name].contributions if c.source == "speed scale"), None)
        slope = 0.0 if scale is None else scale.sensitivity / result.estimates[name].value
        assert slope == pytest.approx(power, abs=0.02)
        if power:
            assert (scale.type, scale.u) == ("B", pytest.approx(0.01 * abs(scale.sensitivity)))
    assert part(budgets["initial.omega_c@body"], "speed scale").sensitivity == pytest.approx(-80, rel=1e-3)
    with pytest.raises(EstimationError, match="contain angles"):
        budget(plain, speed_scale_u=0.01)


NODES = np.sqrt(3) * np.array([-1.0, 0.0, 1.0])


def test_propagation_agrees_with_example_h1_of_the_gum():
    """End gauge, l = l_s + d - l_s (delta_alpha theta + alpha_s delta_theta): H.1.3 and, of second order, H.1.7."""
    length = 50.000623e6  # nm
    difference = {"expansion": (0.0, 0.58e-6), "temperature": (-0.1, 0.41)}
    standard = {"expansion": (11.5e-6, 1.2e-6), "temperature": (0.0, 0.029)}
    found = []
    for inputs in (difference, standard):
        (x, u), (y, v) = inputs.values()
        values = -length * np.multiply.outer(x + u * NODES, y + v * NODES)[..., None]
        parts = propagated(values, [(k, w) for k, (_, w) in inputs.items()])
        found.append([float(part[0]) for part, _ in parts.values()])
    (of_expansion, of_temperature, both), (of_standard, of_bath, second) = found
    assert [of_expansion, of_bath] == pytest.approx([2.9, 16.6], abs=0.1)
    assert [both, second] == pytest.approx([11.7, 1.7], abs=0.2)
    assert max(of_temperature, of_standard) < 1e-6
    first_order = math.hypot(25, 9.7, of_expansion, of_bath)
    assert first_order == pytest.approx(32, abs=0.5)
    assert math.hypot(first_order, both, second) == pytest.approx(34, abs=0.5)


def test_a_straight_line_agrees_with_example_h3_of_the_gum():
    """Calibration of a thermometer: the scatter about the line is the noise, which was not known before."""
    t = np.array(
        [21.521, 22.012, 22.512, 23.003, 23.507, 23.999, 24.513, 25.002, 25.503, 26.010, 26.511]
    )  # deg C
    b = -1e-3 * np.array([171, 169, 166, 159, 164, 165, 156, 157, 159, 161, 160])
    assumed = 1e-5
    design = np.stack([np.ones(11), t - 20], axis=1)
    y = np.linalg.lstsq(design, b, rcond=None)[0]
    chi2 = float(np.sum((b - design @ y) ** 2)) / assumed**2
    covariance = covariance_of(design / assumed, np.ones(2, dtype=bool)) * variance_factor(chi2, 9)
    assert y == pytest.approx([-0.1712, 0.00218], abs=5e-5)
    assert np.sqrt(np.diag(covariance)) == pytest.approx([0.0029, 0.00067], abs=5e-5)
    assert covariance[0, 1] / np.sqrt(np.prod(np.diag(covariance))) == pytest.approx(-0.930, abs=5e-4)
    at_30 = np.array([1.0, 10.0])
    assert at_30 @ y == pytest.approx(-0.1494, abs=5e-5)
    assert math.sqrt(at_30 @ covariance @ at_30) == pytest.approx(0.0041, abs=5e-5)


@pytest.mark.slow
def test_uncertainties_agree_with_monte_carlo(found):
    """Noise, inertias and clock drawn anew: six fits scatter as the combined uncertainties say.

    The pulls of a fit are correlated, so their mean square has about 12 degrees of freedom.
    `benchmarks/fitting/budget.py` has more draws.
    """
    _, budgets = found
    rng = np.random.default_rng(5)
    pulls = []
    for i in range(6):
        rate = 1 + CLOCK * rng.standard_normal()
        r = record(1000 + i)
        casing, *rotor = (replace(s, time=s.time * rate) for s in (r.casing, *r.rotor))
        inertias = I_ROTOR + U_ROTOR * rng.standard_normal(), I_CASING + U_CASING * rng.standard_normal()
        r = replace(
            r, casing=casing, rotor=tuple(rotor), I_rotor=inertias[0], I_casing=inertias[1], digest=""
        )
        estimates = fit(MODEL, [r]).estimates
        pulls.append([(estimates[k].value - truth) / budgets[k].u for k, truth in NUMBERS.items()])
    assert 0.3 < np.mean(np.square(pulls)) < 2.5


def test_stated_uncertainty_of_an_inertia_is_the_prior_of_its_error():
    """A wrong inertia changes neither the parameters nor chi-square if its error is a parameter; torques scale."""
    model = MODEL + "setup.inertia"
    fits, share = {}, 0.03
    for error in (0.0, 0.03):
        wrong = I_CASING * (1 + error)
        known = replace(
            record(0), I_casing=wrong, I_casing_u=share * wrong, I_rotor_u=0.01 * I_ROTOR, digest=""
        )
        fits[error] = robust_fit(model, [known])
    true = fits[0.0]
    assert true.estimates["setup.inertia.eps"].stderr < share
    for error, found in fits.items():
        eps = found.estimates["setup.inertia.eps"]
        assert eps.value == pytest.approx(1 / (1 + error) - 1, abs=4 * eps.stderr)
        assert found.chi2 == pytest.approx(true.chi2, rel=0.02)
        for name in NUMBERS:
            expected = true.estimates[name]
            assert found.estimates[name].value == pytest.approx(expected.value, abs=0.2 * expected.stderr)
    # the ratio is known from the data, so an error of the rotor's inertia is one of both
    budgets, combined = budget(true), combined_uncertainties(true)
    for name in ("touchpoint.constant.b1", "bearing.linear.d"):
        sources = {c.source: c for c in budgets[name].contributions}
        assert "inertia.casing" not in sources
        assert sources["inertia.rotor"].u == pytest.approx(0.01 * true.estimates[name].value, rel=0.02)
        assert combined[name] == pytest.approx(budgets[name].u, rel=0.05)


def test_prior_of_an_inertia_needs_a_stated_uncertainty():
    assert with_free_inertia([CaseData.of(record(0))], (MODEL + "setup.inertia").names)[0].prior is None
    stated = replace(record(0), I_casing_u=0.03 * I_CASING)
    assert with_free_inertia([CaseData.of(stated)], MODEL.names)[0].prior is None


def test_the_calibration_of_each_input_counts_in_every_recording(monkeypatch):
    """The second recording alone has the voltage; a current of unknown uncertainty does not contribute."""
    inputs = {
        "one": [SimpleNamespace(name="torque", u=0.1)],
        "two": [
            SimpleNamespace(name="current", u=None),
            SimpleNamespace(name="voltage", u=0.2),
            SimpleNamespace(name="torque", u=None),
        ],
    }
    cases = [SimpleNamespace(label=k, dynamics=SimpleNamespace(inputs=v)) for k, v in inputs.items()]
    fit = SimpleNamespace(problem=SimpleNamespace(cases=cases), predictions=[1, 2], theta="theta")
    monkeypatch.setattr(_budget, "_input_rows", lambda case, p, theta, name: (case.label, p, theta, name))
    found = dict(_budget._calibrations(SimpleNamespace(fit=fit, sensitivity=lambda rows: rows)))
    assert found == {
        name: [("one", 1, "theta", name), ("two", 2, "theta", name)] for name in ("torque", "voltage")
    }
