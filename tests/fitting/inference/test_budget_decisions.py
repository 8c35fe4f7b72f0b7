"""The budget of a gyroscope at known parameters, against generalised least squares and finite differences."""

import math
from dataclasses import replace
from types import SimpleNamespace

import linearised
import numpy as np
import pytest

from fitting import EstimationError
from fitting.dynamics._collocation import Mesh, Sampler
from fitting.effects._library import NUISANCE
from fitting.inference import _budget as module
from fitting.inference._case_data import CAMERA_COLUMNS
from fitting.inference._case_model import CaseModel
from fitting.inference._noise import TorqueNoise, TorqueResponse
from fitting.inference._problem import Problem

LEVEL = 3e-6


@pytest.fixture(scope="module")
def found():
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


def gain(found, nuisances):
    """Return the covariance of generalised least squares, and the change of the variables per unit of each row."""
    data, prediction = found.problem.data[0], found.predictions[0]
    j = prediction.jacobian
    c = linearised.covariance(
        SimpleNamespace(noise=[n.with_unresolved for n in found.noise], predictions=found.predictions), LEVEL
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
    def test_contributions_are_those_of_generalised_least_squares(self, found):
        linear = module._Linearised(found)
        assert linear.free.all()
        variances = linear.noise_variances()
        assert list(variances) == ["angle noise", "process noise", "start times", *NUISANCE, "lack of fit"]
        base, g, c = gain(found, 0)
        data = found.problem.data[0]
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
            assert total == pytest.approx(np.diag(gain(found, k)[0]), rel=1e-3)
        assert variances["lack of fit"] == pytest.approx(0.5 * total)

    def test_the_covariance_is_that_of_all_nuisance_parameters(self, found):
        linear = module._Linearised(found)
        assert np.diag(linear.covariance) == pytest.approx(np.diag(gain(found, len(NUISANCE))[0]), rel=1e-3)


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
        made = module._clock_rows(measured(**kind), SimpleNamespace(path=path()))
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
        made = module._speed_rows(measured(is_angle=False), SimpleNamespace(path=path()))
        assert made == pytest.approx(np.concatenate([10 - 2 * self.T + self.T**2, 3 + 2 * self.W]))


@pytest.mark.parametrize(("body", "value"), [("rotor", 5.5e-5), ("casing", 2e-5)])
def test_an_inertia_changes_the_rows_as_in_a_motion_with_the_same_torques(found, body, value):
    case, prediction, theta = found.problem.cases[0], found.predictions[0], found.theta
    rows = module._inertia_rows(case, prediction, theta, body, value)
    layout, eps = found.problem.layout, 1e-3
    other = replace(case.data.record, **{f"I_{body}": value * (1 + eps)})
    moved = CaseModel(case.data, replace(layout, records=(other,)), 0).predict(theta).rows
    expected = (moved - prediction.rows) / eps
    assert np.linalg.norm(rows - expected) < 0.02 * np.linalg.norm(expected)
    assert not module._inertia_rows(case, prediction, theta, body, 1.1 * value).any()


def test_an_input_acts_on_each_body_by_its_uncertainty(found, monkeypatch):
    """Two inputs, of which one is asked for; its law accelerates rotor and casing by 2 y and -3 y rad/s2 per unit."""
    case, prediction = found.problem.cases[0], found.predictions[0]
    rotor, casing = np.arange(6.0).reshape(3, 2), np.array([[1.0, -2.0], [0.5, 3.0], [7.0, 1.0]])
    centres = np.array([4.0, 10.0])
    response = SimpleNamespace(centres=centres, bodies={"rotor": rotor, "casing": casing}, casing=casing)
    monkeypatch.setattr(module, "TorqueResponse", lambda data, motion: response)
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
    rows = module._input_rows(driven, prediction, found.theta, "current")
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

    monkeypatch.setattr(module, "_Linearised", Linearised)
    monkeypatch.setattr(
        module, "_inertia_contributions", lambda fit: {"inertia": (np.array([2.0, 9, 0, 9]), np.ones(4) * 8)}
    )
    monkeypatch.setattr(
        module, "_calibrations", lambda linear: iter([("torque", np.array([-1.0, 9.0, 1e-13, 9.0]))])
    )
    monkeypatch.setattr(module, "_clock_rows", lambda d, p: [1.0, 2.0])
    monkeypatch.setattr(module, "_speed_rows", lambda d, p: [3.0, 4.0])
    return asked_for


class TestBudget:
    def test_contributions_are_sorted_and_have_their_shares(self, linear):
        budgets = module.budget(asked(), clock_rate_u=0.1)
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
        sources = {c.source for c in module.budget(asked(), clock_rate_u=0.0)["a"].contributions}
        assert "clock rate" not in sources
        assert linear == []

    def test_a_crystal_has_fifty_parts_per_million(self, linear):
        parts = {c.source: c.u for c in module.budget(asked())["a"].contributions}
        assert parts["clock rate"] == pytest.approx(50 * 50e-6 / math.sqrt(3))

    def test_the_scale_counts_for_measured_speeds_alone(self, linear):
        """Of four recordings, of angles, of gradients of angles, and two of speeds."""
        known = asked(angle=(True, False, False, False), gradients=(False, True, False, False))
        parts = {
            c.source: c for c in module.budget(known, clock_rate_u=0.0, speed_scale_u=0.02)["a"].contributions
        }
        assert (parts["speed scale"].u, parts["speed scale"].sensitivity) == (pytest.approx(1.0), -50.0)
        assert linear == [[[0.0, 0.0], [0.0, 0.0], [3.0, 4.0], [3.0, 4.0]]]

    @pytest.mark.parametrize(("angle", "gradients"), [(True, False), (False, True)])
    def test_angles_have_no_scale(self, linear, angle, gradients):
        with pytest.raises(EstimationError):
            module.budget(asked(angle=(angle,), gradients=(gradients,)), speed_scale_u=0.01)
        assert module.budget(asked(angle=(angle,), gradients=(gradients,)), speed_scale_u=0.0)


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
        module, "_inertia_rows",
        lambda c, p, theta, body, value: np.array([rows[body, c.data.record.I_casing]] * 2),
    )  # fmt: skip
    monkeypatch.setattr(
        module, "_inertias", lambda fit: iter([("i", "rotor", 4.0, 0.2), ("j", "casing", 2.0, 0.2)])
    )
    monkeypatch.setattr(module, "_ratio_has_prior", lambda fit: prior)
    found = module.combined_uncertainties(known)
    clock = 50e-6 / math.sqrt(3)
    shares = clock**2 + 0.05**2 + 0.1**2
    assert found == pytest.approx(
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
            names = (module.INERTIA_RATIO,) if prior else ("other",)
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

        monkeypatch.setattr(module, "refit", refit)
        fit, made = self.known(prior)
        assert module._refitted(fit, {("rotor", 2.0): 2.2, ("arm", 9.0): 8.0}) == "again"
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
        monkeypatch.setattr(module, "refit", None)
        fit, _ = self.known()
        assert module._refitted(fit, {("rotor", 2.0): 2.0, ("casing", 3.0): 3.0}) is fit.theta
