"""The fitted curve of a gyroscope whose windows, camera errors and laws are known."""

from dataclasses import replace
from types import SimpleNamespace

import linearised
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fitting import EstimationError
from fitting.dynamics._collocation import Mesh, Sampler
from fitting.effects._expression import parse
from fitting.effects._mechanism import GYROSCOPE
from fitting.inference import _sampled as module
from fitting.inference._record import Samples
from fitting.inference._sampled import FittedMotion, evaluate, residuals_of

ZEROS = (0.3, -0.2, 0.1)


@pytest.fixture(scope="module")
def found():
    """Rows of the fitted motion, except that the casing and the windows begin at three angles."""
    base = linearised.gyroscope()
    data = base.problem.data[0]
    coefficients = np.zeros(data.nuisance.shape[1])
    coefficients[:3] = ZEROS
    return linearised.gyroscope(residual=[data.nuisance @ coefficients])


def motion_at(found, state, times):
    path = found.predictions[0].path
    return Sampler(path.mesh, times).integral(*path.angle(state))


def speed_at(found, body, times):
    path = found.predictions[0].path
    return Sampler(path.mesh, times).value(path.y[..., body])


class TestCurve:
    def test_a_window_has_its_own_start_angle(self, found):
        """Between the windows the angle is that of the earlier one; a window begins with its first sample."""
        times = np.array([3.0, 4.0, 4.5, 5.0, 11.999, 12.0, 12.5, 15.0])
        zero = np.array([-0.2] * 5 + [0.1] * 3)
        angle = evaluate(found, times, 0, 0, None)
        assert angle == pytest.approx(motion_at(found, "omega_r", times) + zero, abs=1e-6)
        casing = evaluate(found, times, 1, 0, "angle")
        assert casing == pytest.approx(motion_at(found, "omega_c", times) + 0.3, abs=1e-6)

    def test_speeds_need_no_start(self, found):
        times = np.array([3.0, 9.0, 15.0])
        for body in (0, 1):
            assert evaluate(found, times, body, 0, "omega") == pytest.approx(speed_at(found, body, times))

    def test_the_samples_are_the_default_times(self, found):
        record = found.problem.data[0].record
        joined = np.concatenate([w.time for w in record.rotor])
        assert evaluate(found, None, 0, 0, "omega") == pytest.approx(speed_at(found, 0, joined))
        assert evaluate(found, None, 1, 0, "omega") == pytest.approx(speed_at(found, 1, record.casing.time))

    def test_the_shape_is_that_of_the_times(self, found):
        for times in (5.0, [5.0], [[4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]):
            assert evaluate(found, times, 1, 0, None).shape == np.shape(times)
            assert evaluate(found, times, 1, 0, "omega").shape == np.shape(times)

    @pytest.mark.parametrize("times", [[2.999], [15.001], [4.0, np.nan], "noon"])
    def test_times_are_within_the_record(self, found, times):
        assert len(evaluate(found, [3.0, 15.0], 1, 0, None)) == 2
        with pytest.raises(EstimationError):
            evaluate(found, times, 1, 0, None)

    def test_an_angle_of_measured_speeds_is_refused(self, found):
        with pytest.raises(EstimationError, match="quantity"):
            evaluate(found, None, 1, 0, "turns")
        data = found.problem.data[0]
        speeds = SimpleNamespace(record=replace(data.record, quantity="omega", digest=""))
        fit = SimpleNamespace(problem=SimpleNamespace(data=[speeds]))
        with pytest.raises(EstimationError, match="no start angle"):
            evaluate(fit, None, 1, 0, "angle")

    def test_the_response_to_a_law_of_the_angle_is_added(self, found, monkeypatch):
        """Speeds of 2 and 3 rad/s, and angles that follow from them."""
        t = found.problem.data[0].record.casing.time
        slope = np.array([2.0, 3.0])
        response = np.stack([np.tile(slope[:, None], (1, len(t))), slope[:, None] * (t - 1.0)])
        case = type(found.problem.cases[0])
        monkeypatch.setattr(case, "response_to_angles", lambda self, prediction, theta: response)
        times = np.array([4.2, 9.0])
        for body, state, zero in ((0, "omega_r", -0.2), (1, "omega_c", 0.3)):
            speed = evaluate(found, times, body, 0, "omega")
            assert speed == pytest.approx(speed_at(found, body, times) + slope[body])
            angle = evaluate(found, times, body, 0, None)
            expected = motion_at(found, state, times) + slope[body] * (times - 1.0) + zero
            assert angle == pytest.approx(expected, abs=1e-6)


def test_residuals_are_in_units_of_the_stated_noise(monkeypatch, found):
    data = found.problem.data[0]
    values = [
        w.value - size * w.sigma
        for size, w in zip((1.0, -2.0, 5.0), (data.record.casing, *data.record.rotor), strict=True)
    ]
    monkeypatch.setattr(FittedMotion, "values", lambda self: values)
    expected = np.concatenate([np.full(600, 1.0), np.full(100, -2.0), np.full(100, 5.0)])
    assert residuals_of(found) == pytest.approx(expected)


class TestExpected:
    def motion(self, *, is_angle):
        """Speeds of 4 + 2 t (rotor) and 7 - t (casing) from 0 to 5 s."""
        mesh = Mesh.uniform(0.0, 5.0, 3)
        y = np.stack([4 + 2 * mesh.times, 7 - mesh.times], axis=-1)
        speeds = {"omega_r": y[..., 0], "omega_c": y[..., 1]}

        def angle(state):
            ends = mesh.edges
            return {"omega_r": 4 * ends + ends**2, "omega_c": 7 * ends - ends**2 / 2}[state], speeds[state]

        path = SimpleNamespace(mesh=mesh, y=y, states=("omega_r", "omega_c"), angle=angle)
        layout = SimpleNamespace(numbers=lambda theta, case: {"camera.x.k": 0.5, "other.c": 9.0})
        fit = SimpleNamespace(
            predictions=["other", SimpleNamespace(path=path)], theta=None,
            problem=SimpleNamespace(layout=layout),
        )  # fmt: skip
        return FittedMotion(fit, 1, SimpleNamespace(is_angle=is_angle))

    T = np.linspace(0.5, 4.5, 41)

    def test_it_is_the_measured_quantity_of_each_body(self):
        t = self.T
        angles, speeds = self.motion(is_angle=True), self.motion(is_angle=False)
        assert angles.expected(t, rotor=True) == pytest.approx(4 * t + t**2)
        assert angles.expected(t, rotor=False) == pytest.approx(7 * t - t**2 / 2)
        assert speeds.expected(t, rotor=True) == pytest.approx(4 + 2 * t)
        assert speeds.expected(t, rotor=False) == pytest.approx(7 - t)
        assert speeds.expected_of(1, t) == pytest.approx(7 - t)

    def test_values_follow_another_path(self):
        t, other = self.T, self.motion(is_angle=False).prediction.path
        for is_angle in (True, False):
            made = self.motion(is_angle=is_angle)
            known = made.fit.predictions[1]
            made.fit.predictions[1] = SimpleNamespace(path=None)
            for rotor, value in (
                (True, 4 * t + t**2 if is_angle else 4 + 2 * t),
                (False, 7 * t - t**2 / 2 if is_angle else 7 - t),
            ):
                assert made.expected(t, other, rotor=rotor) == pytest.approx(value)
            assert known.path is not None

    @pytest.mark.parametrize("is_angle", [True, False])
    def test_samples_are_predicted_with_error_modes_zeros_and_the_camera(self, monkeypatch, is_angle):
        """Of a casing and two windows; the coefficients are three zeros, two modes and two of the camera."""
        made = self.motion(is_angle=is_angle)
        times = [np.linspace(0.5, 4.5, 9), np.linspace(1.0, 2.0, 5), np.linspace(3.0, 4.0, 7)]
        runs = [Samples(t, t, t, state=0) for t in times]
        modes = [np.stack([t, 1 + t**2], axis=1) for t in times]
        camera = np.stack([np.cos(times[0]), np.sin(times[0])], axis=1)
        record = SimpleNamespace(casing=runs[0], rotor=(runs[1], runs[2]))
        coefficients = np.array([*((0.3, -0.2, 0.1) if is_angle else ()), 0.5, -0.7, 2.0, 3.0])
        monkeypatch.setattr(module, "_nuisance", lambda case, found: coefficients)
        fitted = SimpleNamespace(
            mode_columns=(modes[0], modes[1:]), has_camera_prior=is_angle, camera_columns=camera
        )
        made.fit.problem.data = ["other", fitted]
        data = SimpleNamespace(record=record, is_angle=is_angle)
        found = list(module.predicted_samples(data, 1, made.fit))
        for i, (t, value) in enumerate(zip(times, found, strict=True)):
            expected = modes[i] @ [0.5, -0.7]
            if is_angle:
                expected = expected + (4 * t + t**2 if i else 7 * t - t**2 / 2) + (0.3, -0.2, 0.1)[i]
                expected = expected + (0.0 if i else camera @ [2.0, 3.0])
            else:
                expected = expected + (4 + 2 * t if i else 7 - t)
            assert value == pytest.approx(expected)
        if is_angle:
            fitted.has_camera_prior = False
            (casing, *_) = module.predicted_samples(data, 1, made.fit)
            assert casing == pytest.approx(found[0] - camera @ [2.0, 3.0])

    @pytest.mark.parametrize("rotor", [True, False])
    @pytest.mark.parametrize("is_angle", [True, False])
    def test_an_error_of_a_camera_is_one_of_its_angle(self, rotor, is_angle):
        """k psi + c t + omega; times of the rotor's camera begin with the window, and c has its start of 3."""
        t = self.T
        parameters = [SimpleNamespace(symbol="k", start=0.0), SimpleNamespace(symbol="c", start=3.0)]
        effect = SimpleNamespace(
            name="camera.x", expression=parse("k*psi + c*t + omega"), parameters=parameters
        )
        value = 10.0 + t
        made = self.motion(is_angle=is_angle)._camera_error(effect, Samples(t, value, t), value, rotor=rotor)
        speed = 4 + 2 * t if rotor else 7 - t
        since = t - 0.5 if rotor else t
        if is_angle:
            assert made == pytest.approx(0.5 * value + 3.0 * since + speed)
        else:
            # the derivative of the error
            rate = 2.0 if rotor else -1.0
            assert made[1:-1] == pytest.approx((0.5 * speed + 3.0 + rate)[1:-1])


def test_values_contain_laws_of_an_angle_and_the_error_of_each_camera(monkeypatch):
    runs = [Samples(np.arange(5.0), np.zeros(5), np.ones(5)) for _ in range(3)]
    data = SimpleNamespace(record=SimpleNamespace(casing=runs[0], rotor=(runs[1], runs[2])))
    effects = [SimpleNamespace(camera="casing", size=0.25), SimpleNamespace(camera="rotor", size=0.5)]
    fit = SimpleNamespace(model=SimpleNamespace(angle_dependent=("law", "law"), measurement=effects))
    smooth = [np.array([4.0, 4.0, 9.0, 5.0, 5.0]), np.full(5, 10.0), np.full(5, 20.0)]
    monkeypatch.setattr(module, "predicted_samples", lambda data, case, fit: iter(smooth))

    class Motion(FittedMotion):
        def expected(self, times, path=None, *, rotor):
            return np.full(len(times), 3.0 + rotor)

        def angle_response(self, effect, zero):
            # the zero is the median of the casing's angles from the motion
            return [np.full(5, zero), np.full(5, 100.0), np.full(5, 200.0)]

        def _camera_error(self, effect, run, value, *, rotor):
            assert rotor == (effect.camera == "rotor")
            assert (
                run is runs[[10, 20].index(round(smooth[1 + (value[0] > 300)][0])) + 1] if rotor else runs[0]
            )
            return effect.size * value

    found = Motion(fit, 0, data).values()
    assert found[0] == pytest.approx(1.25 * (smooth[0] + 4.0))
    assert found[1] == pytest.approx(np.full(5, 1.5 * 210.0))
    assert found[2] == pytest.approx(np.full(5, 1.5 * 420.0))
    assert smooth[0][0] == 4.0


@pytest.fixture(scope="module")
def base():
    names = ["casing.air.linear", "rotor.air.linear"]
    return linearised.gyroscope(names, {"casing.air.linear.b2": 1e-6, "rotor.air.linear.a1": 2e-6})


class TestResponse:
    """A law of the angle in linear drag of 0.05 s-1 for the casing (20 rad/s) and the rotor."""

    def response(self, base, site, law, zero=0.4, windows=None):
        data = base.problem.data[0]
        if windows is not None:
            ends = (Samples(windows, np.zeros(len(windows)), np.ones(len(windows))),)
            data = replace(data, record=replace(data.record, rotor=ends, digest=""))
        effect = SimpleNamespace(
            name="law",
            site=site,
            mechanism=GYROSCOPE,
            expression=parse(law),
            parameters=[SimpleNamespace(symbol="k", start=4e-5)],
        )
        return FittedMotion(base, 0, data).angle_response(effect, zero)

    def exact(self, base, torque, shares, zero=0.4):
        rates, inertias = np.array([2e-6 / 5.5e-5, 1e-6 / 2e-5]), np.array([5.5e-5, 2e-5])

        def slope(t, y):
            push = 4e-5 * torque(t, y[2] + zero, y[3], y[1], y[0]) * np.array(shares) / inertias
            return [*(-rates * y[:2] + push), y[1], y[0]]

        t = base.problem.data[0].record.casing.time
        whole = solve_ivp(slope, (3.0, 15.0), [300.0, 20.0, 0.0, 0.0], t_eval=t, rtol=1e-8, atol=1e-9).y
        rotor, casing = (
            start * (1 - np.exp(-rate * (t - 3.0))) / rate
            for start, rate in zip((300.0, 20.0), rates, strict=True)
        )
        return t, whole[2] - casing, whole[3] - rotor

    @pytest.mark.parametrize(
        ("site", "law", "torque", "shares"),
        [
            ("casing", "k*sin(psi_c)", lambda t, p, q, w, r: np.sin(p), (0.0, 1.0)),
            ("casing", "k*cos(2*psi_c)", lambda t, p, q, w, r: np.cos(2 * p), (0.0, 1.0)),
            ("bearing", "k*sin(psi_c)*t/9", lambda t, p, q, w, r: np.sin(p) * t / 9, (-1.0, 1.0)),
            ("casing", "k*sin(psi_c)*omega_r/300", lambda t, p, q, w, r: np.sin(p) * r / 300, (0.0, 1.0)),
            ("casing", "-k/5", lambda t, p, q, w, r: -0.2, (0.0, 1.0)),
        ],
    )
    def test_it_is_that_of_the_equations_of_motion(self, base, site, law, torque, shares):
        t, casing, rotor = self.exact(base, torque, shares)
        found = self.response(base, site, law)
        assert np.abs(found[0] - casing).max() < 0.02 * np.abs(casing).max()
        for window, change in zip(base.problem.data[0].record.rotor, found[1:], strict=True):
            expected = np.interp(window.time, t, rotor)
            assert np.abs(change - expected).max() < max(0.01 * np.abs(rotor).max(), 1e-4)

    def test_before_and_after_the_casing_it_is_constant(self, base):
        """A window may begin before the first and end after the last frame of the casing."""
        last, outside = (
            self.response(base, "bearing", "k", windows=np.array(w))[1]
            for w in ([3.0, 9.0, 15.0], [2.9, 9.0, 15.2])
        )
        assert outside == pytest.approx(last)
        assert abs(last[2] - last[1]) > 0.3 * abs(last[2])
        t = base.problem.data[0].record.casing.time
        ends = self.response(base, "bearing", "k", windows=np.array([t[0], t[1], t[-2], t[-1]]))[1]
        assert ends[0] == 0.0
        assert np.diff(np.abs(ends)).min() > 0.0
