"""The uncertainty budget against the fit's own errors, dimensions, refits, Monte Carlo and finite differences."""

import math
from dataclasses import asdict, replace
from types import SimpleNamespace

import linearised
import numpy as np
import oscillators
import pytest
from scipy.integrate import solve_ivp

from fitting import EstimationError, Experiment, Model, budget, fit, simulate
from fitting.dynamics._collocation import Mesh, Sampler
from fitting.effects._library import NUISANCE
from fitting.inference import _budget
from fitting.inference._budget import combined_uncertainties, propagated
from fitting.inference._case_data import CAMERA_COLUMNS, CaseData, with_free_inertia
from fitting.inference._case_model import CaseModel
from fitting.inference._fit import robust_fit
from fitting.inference._linear_algebra import covariance_of
from fitting.inference._noise import TorqueNoise, TorqueResponse, variance_factor
from fitting.inference._problem import Problem

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


LEVEL = 3e-6


@pytest.fixture(scope="module")
def noisy_budget():
    """A gyroscope with process noise, whose windows start within 1 ms."""
    base = linearised.gyroscope()
    (data,), (prediction,) = base.problem.data, base.predictions
    data = replace(data, record=replace(data.record, start_sigma=(1e-3, 2e-3), digest=""))
    problem = Problem.of(replace(base.problem.layout, records=(data.record,)), [data])
    prediction = problem.predict(base.theta)[0]
    white = TorqueResponse(data, prediction.motion).whitener(TorqueNoise(1.0, 1.0))
    noise = SimpleNamespace(with_unresolved=SimpleNamespace(whitener=white.at(LEVEL)))
    return SimpleNamespace(
        problem=problem, theta=base.theta, predictions=(prediction,), noise=(noise,), variance_factor=1.5
    )


def gain(noisy_budget, nuisances):
    """Return the covariance of generalised least squares, and the change of the variables per unit of each row."""
    data, prediction = noisy_budget.problem.data[0], noisy_budget.predictions[0]
    j = prediction.jacobian
    c = linearised.covariance(
        SimpleNamespace(
            noise=[n.with_unresolved for n in noisy_budget.noise], predictions=noisy_budget.predictions
        ),
        LEVEL,
    )
    first = data.nuisance.shape[1] - 8
    keep = [*range(first)] + [first + k for n in NUISANCE[:nuisances] for k in CAMERA_COLUMNS[n]]
    columns = data.nuisance[:, keep]
    columns = columns[:, np.linalg.norm(columns, axis=0) > 0]
    both = np.concatenate([j, columns], axis=1)
    both /= np.linalg.norm(both, axis=0)
    size = np.linalg.norm(np.concatenate([j, columns], axis=1), axis=0)[: j.shape[1]]
    root = np.linalg.cholesky(c)
    inverse = np.linalg.pinv(np.linalg.solve(root, both), rcond=1e-10)
    g = (inverse @ np.linalg.inv(root))[: j.shape[1]] / size[:, None]
    return g @ c @ g.T, g, c


class TestNoise:
    def test_contributions_are_those_of_generalised_least_squares(self, noisy_budget):
        linear = _budget._Linearised(noisy_budget)
        assert linear.free.all()
        variances = linear.noise_variances()
        assert list(variances) == ["angle noise", "process noise", "start times", *NUISANCE, "lack of fit"]
        base, g, c = gain(noisy_budget, 0)
        data = noisy_budget.problem.data[0]
        process = np.diag(g @ (c - np.eye(len(c))) @ g.T)
        assert variances["process noise"] == pytest.approx(process, rel=1e-3)
        # the rows are in units of their noise, of which the start time has the share size^2 / (1 + size^2)
        starts = np.zeros(len(base))
        for rows, direction, size in data.start_time_noise.parts:
            column = np.zeros(len(c))
            column[rows] = direction * size / math.sqrt(1 + size**2)
            starts += (g @ data.with_white_angles(column)) ** 2
        assert starts.max() > 0
        assert variances["start times"] == pytest.approx(starts, rel=1e-3)
        total = variances["angle noise"] + variances["process noise"] + variances["start times"]
        assert total == pytest.approx(np.diag(base), rel=1e-3)
        for k, name in enumerate(NUISANCE, 1):
            total = total + variances[name]
            assert total == pytest.approx(np.diag(gain(noisy_budget, k)[0]), rel=1e-3)
        assert variances["lack of fit"] == pytest.approx(0.5 * total)

    def test_the_covariance_is_that_of_all_nuisance_parameters(self, noisy_budget):
        linear = _budget._Linearised(noisy_budget)
        assert np.diag(linear.covariance) == pytest.approx(
            np.diag(gain(noisy_budget, len(NUISANCE))[0]), rel=1e-3
        )


def path():
    """Speeds of 3 + 2 t (rotor) and 10 - 2 t + t^2 (casing) from 1 to 5 s."""
    mesh = Mesh.uniform(1.0, 5.0, 4)
    t = mesh.times
    return SimpleNamespace(mesh=mesh, y=np.stack([3 + 2 * t, 10 - 2 * t + t**2], axis=-1))


def measured(is_angle, gradients=False):
    casing = SimpleNamespace(samples=SimpleNamespace(time=np.linspace(1.0, 5.0, 801)))
    window = SimpleNamespace(samples=SimpleNamespace(time=np.linspace(2.0, 3.0, 21), state=0))
    return SimpleNamespace(
        is_angle=is_angle,
        record=SimpleNamespace(span=(1.0, 5.0), gradients=gradients),
        casing=casing,
        rotor=[window],
        sample_rows=lambda own, rotor: np.concatenate([own, *rotor]),
    )


class TestClock:
    T, W = np.linspace(1.0, 5.0, 801), np.linspace(2.0, 3.0, 21)

    def rows(self, **kind):
        made = _budget._clock_rows(measured(**kind), SimpleNamespace(path=path()))
        return made[2:799], made[803:-2]

    def test_angles_are_read_later_by_the_time_since_the_begin(self):
        casing, rotor = self.rows(is_angle=True)
        t, w = self.T[2:-2], self.W[2:-2]
        assert casing == pytest.approx((t - 1.0) * (10 - 2 * t + t**2))
        assert rotor == pytest.approx((w - 1.0) * (3 + 2 * w))

    @pytest.mark.parametrize("gradients", [False, True])
    def test_speeds_change_by_the_acceleration_and_gradients_with_the_clock(self, gradients):
        casing, rotor = self.rows(is_angle=False, gradients=gradients)
        t, w = self.T[2:-2], self.W[2:-2]
        assert casing == pytest.approx((t - 1.0) * (2 * t - 2) + gradients * (10 - 2 * t + t**2))
        assert rotor == pytest.approx((w - 1.0) * 2 + gradients * (3 + 2 * w))

    def test_rows_of_a_scale_are_the_speeds(self):
        made = _budget._speed_rows(measured(is_angle=False), SimpleNamespace(path=path()))
        assert made == pytest.approx(np.concatenate([10 - 2 * self.T + self.T**2, 3 + 2 * self.W]))


@pytest.mark.parametrize(("body", "value"), [("rotor", 5.5e-5), ("casing", 2e-5)])
def test_an_inertia_changes_the_rows_as_in_a_motion_with_the_same_torques(noisy_budget, body, value):
    case, prediction, theta = noisy_budget.problem.cases[0], noisy_budget.predictions[0], noisy_budget.theta
    rows = _budget._inertia_rows(case, prediction, theta, body, value)
    layout, eps = noisy_budget.problem.layout, 1e-3
    other = replace(case.data.record, **{f"I_{body}": value * (1 + eps)})
    moved = CaseModel(case.data, replace(layout, records=(other,)), 0).predict(theta).rows
    expected = (moved - prediction.rows) / eps
    assert np.linalg.norm(rows - expected) < 0.02 * np.linalg.norm(expected)
    assert not _budget._inertia_rows(case, prediction, theta, body, 1.1 * value).any()


def test_an_input_acts_on_each_body_by_its_uncertainty(noisy_budget, monkeypatch):
    """Two inputs, of which one is asked for; its law accelerates rotor and casing by 2 y and -3 y rad/s2 per unit."""
    case, prediction = noisy_budget.problem.cases[0], noisy_budget.predictions[0]
    rotor, casing = np.arange(6.0).reshape(3, 2), np.array([[1.0, -2.0], [0.5, 3.0], [7.0, 1.0]])
    centres = np.array([4.0, 10.0])
    response = SimpleNamespace(centres=centres, bodies={"rotor": rotor, "casing": casing}, casing=casing)
    monkeypatch.setattr(_budget, "TorqueResponse", lambda data, motion: response)
    y = Sampler(prediction.path.mesh, centres).value(prediction.path.y)
    seen = []

    def by_input(i, t, speeds, numbers):
        seen.append(i.name)
        return speeds[:, :2] * [2.0, -3.0]

    inputs = [SimpleNamespace(name=n, uncertainty=lambda t: 0.1 * t) for n in ("torque", "current")]
    driven = SimpleNamespace(
        data=case.data, layout=case.layout, case=0,
        dynamics=SimpleNamespace(inputs=inputs, by_input=by_input, mechanism=case.dynamics.mechanism),
    )  # fmt: skip
    rows = _budget._input_rows(driven, prediction, noisy_budget.theta, "current")
    assert seen == ["current"]
    u = 0.1 * centres
    expected = rotor @ (2.0 * y[:, 0] * u * 5.5e-5) + casing @ (-3.0 * y[:, 1] * u * 2e-5)
    assert rows[:3] == pytest.approx(expected)
    assert not rows[3:].any()


def estimate(value, stderr, unit="s-1"):
    return SimpleNamespace(value=value, stderr=stderr, unit=unit)


def asked(*, angle=(True,), gradients=(False,)):
    """A fit with parameters a, b, c, of which c is at a bound, and a variable without an estimate."""
    data = [
        SimpleNamespace(is_angle=a, record=SimpleNamespace(gradients=g), z=np.zeros(2))
        for a, g in zip(angle, gradients, strict=True)
    ]
    names = ("a", "absent", "b", "c")
    return SimpleNamespace(
        problem=SimpleNamespace(data=data, layout=SimpleNamespace(names=names), cases=data),
        predictions=["p"] * len(data),
        estimates={"a": estimate(7.0, 0.1, "m"), "b": estimate(5.0, 0.2), "c": estimate(0.0, math.nan)},
        covariance=np.diag([0.25, 1.0, 0.04, 0.0]),
    )


@pytest.fixture
def linear(monkeypatch):
    """Type A: noise 4 and -1e-9 (rounding) of a, 9 of b; inertia 2 of a; one calibration; a clock of slope -50, 20."""
    asked_for = []

    class Linearised:
        def __init__(self, fit):
            self.fit = fit

        def noise_variances(self):
            return {
                "angle noise": np.array([4.0, 1.0, 9.0, 1.0]),
                "start times": np.array([-1e-9, 1.0, 0.0, 1.0]),
            }

        def sensitivity(self, rows):
            asked_for.append([np.asarray(r).tolist() for r in rows])
            return np.array([-50.0, 1.0, 20.0, 1.0])

    monkeypatch.setattr(_budget, "_Linearised", Linearised)
    monkeypatch.setattr(
        _budget, "_inertia_contributions", lambda fit: {"inertia": (np.array([2.0, 9, 0, 9]), np.ones(4) * 8)}
    )
    monkeypatch.setattr(
        _budget, "_calibrations", lambda linear: iter([("torque", np.array([-1.0, 9.0, 1e-13, 9.0]))])
    )
    monkeypatch.setattr(_budget, "_clock_rows", lambda d, p: [1.0, 2.0])
    monkeypatch.setattr(_budget, "_speed_rows", lambda d, p: [3.0, 4.0])
    return asked_for


class TestBudget:
    def test_contributions_are_sorted_and_have_their_shares(self, linear):
        budgets = _budget.budget(asked(), clock_rate_u=0.1)
        assert list(budgets) == ["a", "b"]
        a, b = budgets["a"], budgets["b"]
        total = 4.0 + 25.0 + 4.0 + 1.0
        assert (a.value, a.unit, a.u) == (7.0, "m", pytest.approx(math.sqrt(total)))
        assert [c.source for c in a.contributions] == [
            "clock rate",
            "angle noise",
            "inertia",
            "calibration of torque",
        ]
        assert [c.type for c in a.contributions] == ["B", "A", "B", "B"]
        assert [c.u for c in a.contributions] == pytest.approx([5.0, 2.0, 2.0, 1.0])
        assert [c.sensitivity for c in a.contributions] == [-50.0, None, 8.0, None]
        assert [c.share for c in a.contributions] == pytest.approx(
            [25 / total, 4 / total, 4 / total, 1 / total]
        )
        # contributions of a millionth of a millionth are rounding errors
        assert [c.source for c in b.contributions] == ["angle noise", "clock rate"]
        assert b.u == pytest.approx(math.hypot(3.0, 2.0))
        assert linear == [[[1.0, 2.0]]]

    def test_an_exact_clock_does_not_contribute(self, linear):
        sources = {c.source for c in _budget.budget(asked(), clock_rate_u=0.0)["a"].contributions}
        assert "clock rate" not in sources
        assert linear == []

    def test_a_crystal_has_fifty_parts_per_million(self, linear):
        parts = {c.source: c.u for c in _budget.budget(asked())["a"].contributions}
        assert parts["clock rate"] == pytest.approx(50 * 50e-6 / math.sqrt(3))

    def test_the_scale_counts_for_measured_speeds_alone(self, linear):
        """Of four recordings, of angles, of gradients of angles, and two of speeds."""
        known = asked(angle=(True, False, False, False), gradients=(False, True, False, False))
        parts = {
            c.source: c
            for c in _budget.budget(known, clock_rate_u=0.0, speed_scale_u=0.02)["a"].contributions
        }
        assert (parts["speed scale"].u, parts["speed scale"].sensitivity) == (pytest.approx(1.0), -50.0)
        assert linear == [[[0.0, 0.0], [0.0, 0.0], [3.0, 4.0], [3.0, 4.0]]]

    @pytest.mark.parametrize(("angle", "gradients"), [(True, False), (False, True)])
    def test_angles_have_no_scale(self, linear, angle, gradients):
        with pytest.raises(EstimationError):
            _budget.budget(asked(angle=(angle,), gradients=(gradients,)), speed_scale_u=0.01)
        assert _budget.budget(asked(angle=(angle,), gradients=(gradients,)), speed_scale_u=0.0)


@pytest.mark.parametrize("prior", [False, True])
def test_combined_uncertainties_add_all_inputs_in_quadrature(linear, monkeypatch, prior):
    """With a prior of the ratio of the inertias, an error of the rotor's moves that of the casing, too."""
    known = asked(angle=(True, True), gradients=(False, False))
    known.theta = None
    for case, name in zip(known.problem.cases, "xy", strict=True):
        case.data = SimpleNamespace(record=SimpleNamespace(I_casing=name))
    # the second recording has another rotor
    rows = {("rotor", "x"): 1.0, ("rotor", "y"): 0.0, ("casing", "x"): 10.0, ("casing", "y"): 100.0}
    monkeypatch.setattr(
        _budget, "_inertia_rows",
        lambda c, p, theta, body, value: np.array([rows[body, c.data.record.I_casing]] * 2),
    )  # fmt: skip
    monkeypatch.setattr(
        _budget, "_inertias", lambda fit: iter([("i", "rotor", 4.0, 0.2), ("j", "casing", 2.0, 0.2)])
    )
    monkeypatch.setattr(_budget, "_ratio_has_prior", lambda fit: prior)
    noisy_budget = _budget.combined_uncertainties(known)
    clock = 50e-6 / math.sqrt(3)
    shares = clock**2 + 0.05**2 + 0.1**2
    assert noisy_budget == pytest.approx(
        {
            "a": math.sqrt(0.25 + 2500 * shares + 1.0),
            "absent": math.sqrt(1.0 + shares + 81.0),
            "b": math.sqrt(0.04 + 400 * shares),
            "c": math.sqrt(shares + 81.0),
        }
    )
    first = 11.0 if prior else 1.0
    assert linear == [
        [[1.0, 2.0], [1.0, 2.0]],
        [[first] * 2, [0.0] * 2],
        [[10.0] * 2, [100.0] * 2],
    ]


class TestRefit:
    def known(self, prior=False):
        made = []

        def data(label, rotor, casing):
            mechanism = SimpleNamespace(bodies=("rotor", "casing", "arm"))
            record = SimpleNamespace(
                mechanism=mechanism, inertias=(rotor, casing, 9.0), I_rotor=rotor, I_casing=casing
            )
            names = (_budget.INERTIA_RATIO,) if prior else ("other",)
            return SimpleNamespace(
                record=record,
                prior=SimpleNamespace(names=names),
                with_inertia=lambda *moments: made.append((label, *moments)) or label,
            )

        layout = SimpleNamespace(choices=(("s",), ("p",)), names=("a", "b"), ranges={"a": (0.0, 1.0)})
        problem = SimpleNamespace(layout=layout, data=[data("x", 2.0, 3.0), data("y", 4.0, 3.0)])
        return SimpleNamespace(problem=problem, model="model", theta=np.array([1.5, 2.5])), made

    @pytest.mark.parametrize(("prior", "moved"), [(False, 3.0), (True, 3.3)])
    def test_the_same_model_is_fitted_to_the_moved_inertias(self, monkeypatch, prior, moved):
        calls = []

        def refit(model, data, **options):
            calls.append((model, data, options))
            return SimpleNamespace(theta="again")

        monkeypatch.setattr(_budget, "refit", refit)
        fit, made = self.known(prior)
        assert _budget._refitted(fit, {("rotor", 2.0): 2.2, ("arm", 9.0): 8.0}) == "again"
        assert made == [
            ("x", 2.2, pytest.approx(moved), [8.0]),
            ("y", 4.0, 3.0, [8.0]),
        ]
        options = {
            "share": ("s",),
            "per_case": ("p",),
            "start": {"a": 1.5, "b": 2.5},
            "ranges": {"a": (0.0, 1.0)},
        }
        assert calls == [("model", ["x", "y"], options)]

    def test_the_present_inertias_need_no_fit(self, monkeypatch):
        monkeypatch.setattr(_budget, "refit", None)
        fit, _ = self.known()
        assert _budget._refitted(fit, {("rotor", 2.0): 2.0, ("casing", 3.0): 3.0}) is fit.theta
