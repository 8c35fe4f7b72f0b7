"""Velocities and the generated rotor curve, as in the paper; the bias of the curve in closed form."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import twobody

from fitting import REDUCED, Model, RecordError, fit, make_record
from fitting.inference._case_data import CaseData
from fitting.inference._metrics import as_velocities, median_noise
from fitting.inference._record import Samples, running_median
from fitting.study import _preparation
from fitting.study._preparation import CurveBias, curve_bias, prepared, with_generated_rotor


@pytest.fixture(scope="module")
def record():
    return make_record(**twobody.film(twobody.simulate(seed=1), seed=1))


def test_velocities_agree_with_the_motion(record):
    made = as_velocities(record)
    assert made.quantity == "omega"
    assert made.digest != record.digest
    for samples, body in ((made.casing, 1), *((w, 0) for w in made.rotor)):
        true = twobody.simulate(seed=1).at(samples.time, body)[1]
        assert np.abs(np.mean((samples.value - true) / samples.sigma)) < 0.1
    assert as_velocities(made) is made


def test_sigma_of_velocities_is_their_noise_at_low_frequencies(record):
    """The polynomials of low degree, which a fit uses, have the stated uncertainty."""
    data = CaseData.of(as_velocities(record))
    motion = twobody.simulate(seed=1)
    pulls = [data.casing.z - data.casing.at_nodes(motion.at(data.casing.node_times, 1)[1])]
    pulls += [w.z - w.at_nodes(motion.at(w.node_times, 0)[1]) for w in data.rotor]
    # 240 and 24 rows: within three standard deviations
    assert 0.85 < np.std(pulls[0]) < 1.16
    assert 0.6 < np.std(np.concatenate(pulls[1:])) < 1.5
    # neighbours share their noise
    assert data.casing.scale == pytest.approx(1.0, abs=0.1)
    assert 0.02 < data.n_effective / (len(record.casing) + 9000) < 0.5


@pytest.mark.parametrize("reach", [0.1, 0.5, 1.0, 1.5])
def test_noise_of_a_running_median_agrees_with_simulation(reach):
    """Means of 500 medians of simulated gradients on a slope, 2400 of them."""
    rng = np.random.default_rng(7)
    count, width = 500, 51
    slope = reach / (width / 2) * np.arange(40 * count)
    means = []
    for _ in range(60):
        e = rng.standard_normal(len(slope) + 2)
        omega = running_median((e[2:] - e[:-2]) / np.sqrt(2) + slope, width) - slope
        means.append(omega.reshape(-1, count)[1:-1].mean(axis=1))
    # the formula is that of a wide median and long means; 51 points leave a little less, ends of the means 4 / 500
    expected = float(median_noise(np.array([reach]))[0]) + 4 / count
    assert np.sqrt(count * np.var(np.concatenate(means)) / expected) == pytest.approx(0.95, abs=0.1)


@pytest.mark.slow
def test_the_method_of_the_paper_recovers_the_parameters(record):
    """Its uncertainties are much larger than those of angles, and are valid."""
    found = fit(Model.of(REDUCED), [CaseData.of(prepared(record, "velocity"))])
    angles = fit(Model.of(REDUCED), [CaseData.of(record)])
    truth = twobody.truth()
    for key in ("rotor.air.quadratic.a2", "casing.air.linear.b2"):
        e = found.estimates[key]
        assert e.value == pytest.approx(truth[key], rel=0.02)
        assert abs(e.value - truth[key]) < 5 * e.stderr
        assert e.stderr > 10 * angles.estimates[key].stderr
    assert found.cases[0].casing.r2 > 0.9999


def test_generated_curve_goes_through_its_windows(record):
    made = with_generated_rotor(as_velocities(record))
    (curve,) = made.rotor
    assert made.generated
    assert (curve.time[0], curve.time[-1]) == pytest.approx(as_velocities(record).span)
    assert (np.diff(curve.value) < 0).all()
    for window in as_velocities(record).rotor:
        middle = float(window.time.mean())
        seen = np.polyval(np.polyfit(window.time - middle, window.value, 1), 0.0)
        assert np.interp(middle, curve.time, curve.value) == pytest.approx(seen, abs=0.2)


def test_a_decay_with_the_law_of_the_curve_is_reproduced():
    grid = np.linspace(0, 200, 4001)
    omega = np.empty(len(grid))
    omega[0] = 900.0

    def rate(x):
        return -(0.2 + 1e-3 * x + 1.5e-6 * x**2)

    for i, h in enumerate(np.diff(grid)):
        half = omega[i] + 0.5 * h * rate(omega[i])
        omega[i + 1] = omega[i] + h * rate(half)
    times = np.array([6.5, 71.5, 151.5])
    speed = np.interp(times, grid, omega)
    found = _preparation._decay(np.stack([times, speed, rate(speed)], axis=1), grid[::10])
    assert np.abs(found - omega[::10]).max() < 0.5


@pytest.mark.slow
def test_a_fit_with_a_generated_rotor_is_marked(record):
    found = fit(Model.of(REDUCED), [CaseData.of(prepared(record, "velocity", "generated"))])
    (case,) = found.cases
    assert np.isnan(case.rotor.reduced_chi2)
    assert np.isnan(case.rotor.held_out)
    assert case.rotor.r2 > 0.999
    assert case.casing.r2 > 0.99
    assert found.verdict == "lack_of_fit"
    assert "generated, not measured" in repr(found)
    bias = curve_bias(found)
    assert set(bias) == set(Model.of(REDUCED).free)
    # the curve moves what the bodies share by tens of the errors that it claims; the windows hold the truth
    assert next(iter(bias.values())).errors == max(b.errors for b in bias.values()) > 5
    truth = twobody.truth()
    for name, b in bias.items():
        assert abs(b.measured - truth[name]) < 4 * b.stderr
    b = bias["rotor.air.quadratic.a2"]
    assert abs(b.generated - truth["rotor.air.quadratic.a2"]) > 5 * b.claimed
    assert not curve_bias(fit(Model.of(REDUCED), [CaseData.of(record)]))


def test_contradictory_options_are_refused(record):
    with pytest.raises(RecordError, match="consists of velocities"):
        prepared(record, "angle", "generated")
    with pytest.raises(RecordError, match="not angles"):
        prepared(as_velocities(record), "angle")
    with pytest.raises(RecordError, match="unknown data"):
        prepared(record, "speed")
    assert prepared(record) is record


class TestBias:
    @pytest.mark.parametrize(
        ("claimed", "stderr", "errors"),
        [(0.5, 2.0, 6.0), (math.nan, 2.0, 1.5), (0.0, 2.0, 1.5), (math.inf, 2.0, 1.5), (-1.0, 2.0, 1.5)],
    )
    def test_a_shift_is_counted_in_the_errors_that_are_known(self, claimed, stderr, errors):
        assert CurveBias(4.0, claimed, 7.0, stderr).errors == errors
        assert CurveBias(7.0, claimed, 4.0, stderr).errors == errors

    def test_without_an_error_the_shift_has_no_number(self):
        assert math.isnan(CurveBias(4.0, math.nan, 7.0, 0.0).errors)
        assert math.isnan(CurveBias(4.0, 0.0, 7.0, math.nan).errors)

    def test_the_windows_are_fitted_with_the_same_choices(self, monkeypatch):
        seen = {}
        monkeypatch.setattr(_preparation, "_STEPS", 20)
        record = self.record()
        curve = with_generated_rotor(record)
        values = {"a": (1.0, 0.5), "b": (9.0, 1.0), "c": (2.0, 1.0), "initial.x": (99.0, 1.0)}
        estimate = {k: SimpleNamespace(value=v, stderr=s) for k, (v, s) in values.items()}
        truth = {k: SimpleNamespace(value=1.0, stderr=2.0) for k in values}

        def fit(model, records, **options):
            seen.update(records=records, **options)
            return SimpleNamespace(estimates=truth)

        monkeypatch.setattr(_preparation, "fit", fit)

        def found(*records):
            model = SimpleNamespace(free=["a", "b"], constants=("c",))
            layout = SimpleNamespace(
                records=records, model=model, per_case=("b", "other"), ranges={"a": (0, 1)}
            )
            return SimpleNamespace(problem=SimpleNamespace(layout=layout), estimates=estimate)

        bias = curve_bias(found(curve, record))
        assert list(bias) == ["b", "a"]
        assert bias["b"] == CurveBias(9.0, 1.0, 1.0, 2.0)
        assert (seen["share"], seen["per_case"], seen["ranges"]) == (["a"], ["b"], {"a": (0, 1)})
        first, second = seen["records"]
        assert second is record
        assert (first.generated, first.windows) == (False, ())
        assert [w.value.tolist() for w in first.rotor] == [w.value.tolist() for w in record.rotor]
        curve_bias(found(curve))
        assert seen["share"] == []
        seen.clear()
        assert curve_bias(found(record, record)) == {}
        assert seen == {}

    def record(self):
        t = np.linspace(0.0, 20.0, 200)
        run = (t, 5.0 - 0.1 * t, np.full(200, 0.1))
        windows = []
        for a, b, count, sigma in ((2.0, 4.0, 60, 0.2), (12.0, 14.0, 90, 0.3)):
            w = np.linspace(a, b, count)
            windows.append((w, 100.0 - 2.0 * w, np.full(count, sigma)))
        return make_record(casing=run, rotor=windows, I_rotor=1.0, I_casing=0.5, quantity="omega")

    def test_the_curve_has_the_weight_of_the_windows(self, monkeypatch):
        monkeypatch.setattr(_preparation, "_STEPS", 40)
        scales = iter((1.5, 0.5))
        monkeypatch.setattr(_preparation, "_calibrated", lambda w: SimpleNamespace(scale=next(scales)))
        (curve,) = with_generated_rotor(self.record()).rotor
        weight = 60 / (1.5 * 0.2) ** 2 + 90 / (0.5 * 0.3) ** 2
        assert np.sum(curve.sigma**-2.0) == pytest.approx(weight, rel=1e-12)
        assert len(curve) == 2000
        assert (curve.time[0], curve.time[-1]) == (0.0, 20.0)
        # with a constant deceleration, the law of the curve is exact
        assert curve.value == pytest.approx(100.0 - 2.0 * curve.time, abs=0.02)

    @pytest.mark.parametrize(
        ("count", "degree"), [(3, 1), (4, 1), (5, 2), (7, 3), (1000, _preparation.ROTOR_DEGREE)]
    )
    def test_a_short_window_has_a_polynomial_of_half_its_samples(self, monkeypatch, count, degree):
        seen = {}
        monkeypatch.setattr(_preparation, "compress", lambda window, **more: seen.update(more))
        t = np.arange(count, dtype=float)
        _preparation._calibrated(Samples(t, t, np.ones(count)))
        assert (seen["degree"], seen["blocks"]) == (degree, 1)


class TestDecay:
    def test_the_line_of_a_window_is_about_its_middle(self):
        t = np.array([1.0, 2.0, 3.0, 6.0])
        assert _preparation._line(Samples(t, 50.0 - 4.0 * t, np.ones(4))) == pytest.approx((3.0, 38.0, -4.0))
        middle, speed, slope = _preparation._line(Samples(t[:1], np.array([7.0]), np.ones(1)))
        assert (middle, speed) == (1.0, 7.0)
        assert math.isnan(slope)
        assert _preparation._line(Samples(t[:2], 50.0 - 4.0 * t[:2], np.ones(2))) == pytest.approx(
            (1.5, 44.0, -4.0)
        )

    def test_an_exponential_decay_is_reproduced_from_speeds_alone(self):
        grid = np.linspace(0.0, 10.0, 101)
        times = np.array([8.0, 0.0, 4.0, 2.0, 6.0, 10.0])
        speed = 40.0 * np.exp(-0.12 * times)
        lines = np.stack([times, speed, np.full(6, np.nan)], axis=1)
        assert _preparation._decay(lines, grid) == pytest.approx(40.0 * np.exp(-0.12 * grid), rel=2e-3)

    def test_two_windows_with_slopes_determine_a_quadratic_decay(self):
        grid = np.linspace(0.0, 10.0, 201)
        true = 50.0 / (1 + 50.0 * 0.004 * grid)
        times = np.array([1.0, 9.0])
        speed = 50.0 / (1 + 0.2 * times)
        lines = np.stack([times, speed, -0.004 * speed**2], axis=1)
        found = _preparation._decay(lines, grid)
        assert found[[20, 180]] == pytest.approx(speed, rel=1e-3)
        assert found == pytest.approx(true, rel=0.05)


def test_data_are_prepared_as_requested(monkeypatch):
    monkeypatch.setattr(_preparation, "_STEPS", 20)
    t = np.linspace(0.0, 20.0, 200)
    run = (t, 5.0 - 0.1 * t, np.full(200, 0.1))
    speeds = make_record(casing=run, rotor=[], I_rotor=1.0, I_casing=0.5, quantity="omega")
    assert prepared(speeds) is speeds
    assert prepared(speeds, "velocity") is speeds
    for data, rotor in ((None, "generated"), ("angle", "windows"), ("angle", "generated"), (None, "other")):
        with pytest.raises(RecordError):
            prepared(speeds, data, rotor)
    gyroscope = TestBias().record()
    made = prepared(gyroscope, None, "generated")
    assert made.generated
    assert len(made.rotor) == 1
    assert len(made.windows) == 2
