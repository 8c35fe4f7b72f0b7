"""Intervals of unmodelled torque, harmonics, and torques of a measured motion; their units and places in sentences."""

import math
from types import SimpleNamespace

import cases
import numpy as np
import pytest
from scipy.stats import chi2

from fitting._criteria import DEFAULT
from fitting._numbers import per_inertia, percentage, plain
from fitting.discovery import _residuals
from fitting.discovery._residuals import Failure, ResidualTorque, find_failures, format_torque, whiteness
from fitting.effects._mechanism import GYROSCOPE
from fitting.inference._record import Samples

N = 400


def curve(torque, sigma=1.0, omega=None, body="casing"):
    t = np.linspace(0.0, 100.0, N)
    speed = np.linspace(50.0, 10.0, N) if omega is None else omega
    return ResidualTorque("x", body, t, torque, np.full(N, sigma), 9 * speed, speed)


@pytest.fixture
def fit(monkeypatch):
    monkeypatch.setattr(_residuals, "_largest_speed_residual", lambda fit, curve, a, b: 0.7)
    record = SimpleNamespace(
        body="disc", mechanism=SimpleNamespace(main="casing"), torque_unit="N m", I_casing=2.0,
        casing=SimpleNamespace(time=np.linspace(0.0, 8.0, 50)),
    )  # fmt: skip
    return SimpleNamespace(labels=("x",), problem=SimpleNamespace(data=[SimpleNamespace(record=record)]))


def pulse(first, last, height):
    torque = np.zeros(N)
    torque[first:last] = height
    return torque


class TestIntervals:
    @pytest.mark.parametrize(("height", "count"), [(4.9, 0), (5.1, 1), (-5.1, 1), (-4.9, 0)])
    def test_an_interval_is_significant_beyond_the_limit(self, fit, height, count):
        found = _residuals._intervals(fit, curve(pulse(100, 150, height)), 5.0)
        assert len(found) == count
        if count:
            (f,) = found
            t = np.linspace(0.0, 100.0, N)
            assert (f.t_start, f.t_stop) == (t[100], t[149])
            assert f.kind == ("gains torque" if height > 0 else "loses torque")
            assert f.size_sigma == pytest.approx(abs(height))
            assert f.residual_torque_Nm == pytest.approx(height)
            assert f.torque_sigma_Nm == pytest.approx(1.0)
            assert (f.called, f.unit, f.residual_rad_s, f.body) == ("disc", "N m", 0.7, "casing")
            speed = np.linspace(50.0, 10.0, N)
            assert f.omega_c == (speed[149], speed[100])

    def test_it_ends_where_the_band_is_entered_or_the_sign_changes(self, fit):
        torque = pulse(100, 150, 8.0) + pulse(150, 200, -9.0) + pulse(200, 250, -1.9) + pulse(250, 300, -2.0)
        torque[270] = -6.0
        found = _residuals._intervals(fit, curve(torque), 5.0)
        assert [(round(f.t_start * 3.99), round(f.t_stop * 3.99)) for f in found] == [
            (100, 149),
            (150, 199),
            (250, 299),
        ]

    @pytest.mark.parametrize(("length", "count"), [(4, 0), (5, 1)])
    def test_it_lasts_a_hundredth_of_the_record(self, fit, length, count):
        assert len(_residuals._intervals(fit, curve(pulse(100, 100 + length, 9.0)), 5.0)) == count

    def test_its_torque_is_weighted_by_the_variances(self, fit):
        sigma = np.ones(N)
        sigma[100:120] = 0.5
        made = curve(pulse(100, 150, 9.0))
        made = ResidualTorque(
            "x", "rotor", made.time, np.where(sigma < 1, 12.0, made.torque), sigma, made.omega_r, made.omega_c
        )
        (f,) = _residuals._intervals(fit, made, 5.0)
        assert f.residual_torque_Nm == pytest.approx((20 * 4 * 12 + 30 * 9) / (20 * 4 + 30))
        assert f.torque_sigma_Nm == pytest.approx((20 * 2 + 30) / (20 * 4 + 30))
        assert (f.size_sigma, f.called) == (24.0, "rotor")

    def test_the_six_most_significant_are_listed(self, fit):
        torque = sum(pulse(50 * i, 50 * i + 20, 10.0 + i) for i in range(8))
        found = find_failures(fit, [curve(torque)])
        assert [f.size_sigma for f in found] == [17.0, 16.0, 15.0, 14.0, 13.0, 12.0]

    @pytest.mark.parametrize(("size", "listed"), [(11.9, False), (12.1, True)])
    def test_a_harmonic_must_exceed_every_interval_of_its_case(self, fit, monkeypatch, size, listed):
        ripple = SimpleNamespace(label="x", size_sigma=size)
        monkeypatch.setattr(_residuals, "_harmonic", lambda fit, h, n, least: [ripple] if n == 2 else [])
        found = find_failures(fit, [curve(pulse(100, 150, 12.0))], ["harmonics"], DEFAULT)
        assert (ripple in found) is listed
        other = SimpleNamespace(label="y", size_sigma=1.0)
        monkeypatch.setattr(_residuals, "_harmonic", lambda fit, h, n, least: [other] if n == 1 else [])
        assert find_failures(fit, [curve(pulse(100, 150, 12.0))], ["harmonics"], DEFAULT)[-1] is other


class TestPlace:
    RISING = np.concatenate([np.linspace(1.0, 50.0, 200), np.linspace(50.0, 5.0, 200)])

    @pytest.mark.parametrize(
        ("a", "b", "where"),
        [
            (0, 400, "throughout"),
            (10, 199, "while speeding up"),
            (10, 200, "around the peak"),
            (190, 210, "near the peak"),
            (150, 250, "around the peak"),
            (200, 250, "while slowing down"),
        ],
    )
    def test_an_interval_is_before_at_or_after_the_peak(self, a, b, where):
        rising = self.RISING.copy()
        rising[199] = 51.0
        assert _residuals._place(curve(np.zeros(N), omega=rising), a, b) == where
        assert _residuals._place(curve(np.zeros(N), omega=-rising), a, b) == where

    @pytest.mark.parametrize(
        ("peak", "a", "where"),
        [
            (0, 0, "at the start"),
            (0, 1, "in the middle"),
            (0, 200, "in the middle"),
            (0, 201, "while slowing down"),
            (7, 7, "at the start"),
            (7, 8, "in the middle"),
            (8, 20, "while slowing down"),
        ],
    )
    def test_a_body_that_only_slows_down_has_a_start_and_a_middle(self, peak, a, where):
        omega = np.linspace(50.0, 10.0, N)
        omega[peak] = 60.0
        assert _residuals._place(curve(np.zeros(N), omega=omega), a, a + 30) == where


class TestHarmonics:
    def made(self, fit, monkeypatch, *, size=9.0, amplitude=0.8, speeds=(-20.0, -2.0), n=2):
        omega = np.linspace(*speeds, 50)
        monkeypatch.setattr(_residuals, "Sampler", lambda mesh, t: SimpleNamespace(value=lambda y: omega))
        fit.predictions = [SimpleNamespace(path=SimpleNamespace(mesh=None, y=np.zeros((1, 1, 2))))]
        return _residuals._harmonic(fit, SimpleNamespace(label="x", size=lambda n: (amplitude, size)), n, 5.0)

    def test_its_speed_is_that_where_the_casing_is_slowest(self, fit, monkeypatch):
        (f,) = self.made(fit, monkeypatch)
        assert f.residual_rad_s == pytest.approx(0.8 / (2.0 * 2 * 2.0))
        assert (f.residual_torque_Nm, f.torque_sigma_Nm, f.where) == (
            0.8,
            pytest.approx(0.8 / 9),
            "twice a turn",
        )
        assert (f.t_start, f.t_stop, f.omega_c, f.kind) == (0.0, 8.0, (2.0, 20.0), "ripple")
        assert self.made(fit, monkeypatch, n=1)[0].residual_rad_s == pytest.approx(0.8 / (2.0 * 2.0))

    def test_near_rest_the_torque_limits_the_speed(self, fit, monkeypatch):
        (f,) = self.made(fit, monkeypatch, speeds=(20.0, 0.1))
        assert f.residual_rad_s == pytest.approx(0.8 / (4.0 * math.sqrt(0.4)))
        (f,) = self.made(fit, monkeypatch, speeds=(20.0, 0.0), amplitude=1e-9)
        assert f.residual_rad_s == pytest.approx(1e-9 / (4.0 * 2e-3))

    @pytest.mark.parametrize(("size", "count"), [(4.9, 0), (5.1, 1)])
    def test_it_is_significant_beyond_the_limit(self, fit, monkeypatch, size, count):
        assert len(self.made(fit, monkeypatch, size=size)) == count


class TestMatrices:
    def test_rows_times_a_covariance_are_those_of_the_dense_matrix(self):
        w = np.random.default_rng(0).standard_normal((3, 12))
        response = SimpleNamespace(edges=np.linspace(0.0, 6.0, 13))
        t = np.arange(12) * 0.5
        dense = np.exp(-np.abs(t[:, None] - t) / 2.0)
        assert _residuals._times_covariance(w, response, 2.0) == pytest.approx(w @ dense)

    def test_nuisance_columns_have_no_weight(self):
        rng = np.random.default_rng(1)
        root = rng.standard_normal((6, 6))
        covariance = root @ root.T + np.eye(6)
        nuisance = np.concatenate([rng.standard_normal((6, 2)) * [1.0, 1e8], np.zeros((6, 1))], axis=1)
        found = _residuals._inverse_without_nuisance(covariance, nuisance)
        inverse = np.linalg.inv(covariance)
        n = nuisance[:, :2] / np.linalg.norm(nuisance[:, :2], axis=0)
        expected = inverse - inverse @ n @ np.linalg.inv(n.T @ inverse @ n) @ n.T @ inverse
        assert found == pytest.approx(expected)
        assert found @ n == pytest.approx(np.zeros((6, 2)), abs=1e-9)

    def test_a_body_is_filmed_from_its_first_window_to_its_last(self):
        runs = [SimpleNamespace(time=np.array([4.0, 5.0])), SimpleNamespace(time=np.array([1.0, 2.0]))]
        bodies = [SimpleNamespace(part="rotor", series=runs)]
        data = SimpleNamespace(record=SimpleNamespace(bodies=bodies))
        assert _residuals._is_filmed(np.array([0.9, 1.0, 3.0, 5.0, 5.1]), data, "rotor").tolist() == [
            False,
            True,
            True,
            True,
            False,
        ]


class TestWhiteness:
    def fit(self, rows):
        blocks, k = rows.shape
        data = SimpleNamespace(
            casing=SimpleNamespace(lift=np.zeros((blocks, k, 1))), z=np.zeros(blocks * k),
            slices={"casing": slice(0, blocks * k)}, record=SimpleNamespace(label="x"),
        )  # fmt: skip
        noise = SimpleNamespace(whitener=SimpleNamespace(at=lambda level: level), tested=1.0)
        return SimpleNamespace(
            problem=SimpleNamespace(data=[data]),
            noise=[noise],
            predictions=[SimpleNamespace(rows=rows.ravel())],
        )

    @pytest.mark.parametrize(("blocks", "k"), [(60, 4), (40, 6), (20, 5)])
    def test_it_is_the_statistic_of_ljung_and_box(self, monkeypatch, blocks, k):
        monkeypatch.setattr(_residuals, "Projection", lambda data, whitener: lambda rows: rows)
        rows = np.random.default_rng(blocks).standard_normal((blocks, k))
        (found,) = whiteness(self.fit(rows))
        own = rows[:, :4] - rows[:, :4].mean(axis=0)
        lags = min(12, blocks // 4)
        r = [np.sum(own[:-j] * own[j:]) / np.sum(own**2) for j in range(1, lags + 1)]
        width = own.shape[1]
        q = blocks * (blocks + 2) * width * sum(x**2 / (blocks - j) for j, x in enumerate(r, 1))
        assert found.label == "x"
        assert found.p_value == pytest.approx(chi2.sf(q, lags), rel=1e-6)


class TestMeasuredMotion:
    @pytest.mark.parametrize("quantity", ["angle", "omega"])
    def test_torque_is_inertia_times_the_acceleration_without_the_model(self, quantity):
        """An acceleration of -0.6 t rad/s2 beside a model of -0.5 omega."""
        t = np.linspace(0.0, 10.0, 2001)
        omega = 40.0 - 0.3 * t**2
        value = 40.0 * t - 0.1 * t**3 if quantity == "angle" else omega
        noise = 1e-4 * np.random.default_rng(0).standard_normal(len(t))
        record = SimpleNamespace(
            casing=Samples(t, value + noise, np.full(len(t), 1e-4)), inertias=(9.0, 2.0), quantity=quantity
        )
        dynamics = SimpleNamespace(rates=lambda t, y, numbers: -0.5 * y)
        problem = SimpleNamespace(
            cases=[SimpleNamespace(dynamics=dynamics)], data=[SimpleNamespace(record=record)],
            layout=SimpleNamespace(numbers=lambda theta, i: {}),
        )  # fmt: skip
        at = np.array([0.0, 3.0, 10.0])
        fit = SimpleNamespace(problem=problem, theta=None)
        speed, torque, u = _residuals._of_the_measured_motion(fit, 0, at, np.zeros((3, 2)), 2.0)
        true = 2.0 * (-0.6 * at + 0.5 * (40.0 - 0.3 * at**2))
        assert speed == pytest.approx(40.0 - 0.3 * at**2, abs=2e-3)
        assert torque == pytest.approx(true, abs=2e-2)
        assert (np.abs(torque - true) < 4 * u + 1e-9).all()
        # the standard error of the derivative of a polynomial in the middle of 401 samples within 1 s
        x = np.linspace(-1.0, 1.0, 401)
        powers = np.vander(x, 4 if quantity == "angle" else 3, increasing=True)
        error = np.sqrt(np.diag(np.linalg.inv(powers.T @ powers))) * 1e-4
        expected = 2.0 * (2 * error[2] if quantity == "angle" else error[1])
        assert u[1] == pytest.approx(expected, rel=0.35)


@pytest.mark.parametrize(
    ("low", "high", "other", "worst"),
    [
        (-3.0, 1.0, 0.0, -3.0),
        (-1.0, 3.0, 0.0, 3.0),
        (-1.0, 1.5, -2.0, -2.0),
        (-1.0, 1.5, 2.5, 2.5),
        (0.0, 0.0, 0.0, 0.0),
    ],
)
def test_the_largest_speed_residual_is_that_of_all_windows_within_the_interval(
    monkeypatch, low, high, other, worst
):
    """A tenth of the samples of the first window have each of two residuals; outside of the interval it is 99."""
    t = np.linspace(20.0, 29.9, 100)
    first = np.where(
        t < 25.0, np.where(np.arange(100) % 5 == 0, low, 0.0), np.where(np.arange(100) % 5 == 0, high, 0.0)
    )
    runs = {
        "one": (np.concatenate([[9.0], t, [71.0]]), np.concatenate([[99.0], first, [99.0]])),
        "two": (np.linspace(40.0, 50.0, 30), np.full(30, other)),
        "outside": (np.linspace(80.0, 90.0, 30), np.full(30, 99.0)),
    }
    monkeypatch.setattr(_residuals, "speeds", lambda run, quantity, width: (runs[run][0], runs[run][1] + 5.0))
    monkeypatch.setattr(
        _residuals, "modelled_speed", lambda fit, index, state, time: (np.full(len(time), 5.0), None)
    )
    bodies = [
        SimpleNamespace(part="casing", series=(), state=1),
        SimpleNamespace(part="rotor", series=runs, state=0),
    ]
    data = SimpleNamespace(record=SimpleNamespace(bodies=bodies, quantity="angle"), smoothing_width=3)
    fit = SimpleNamespace(labels=("other", "x"), problem=SimpleNamespace(data=[None, data]))
    found = _residuals._largest_speed_residual(fit, curve(np.zeros(N), body="rotor"), 40, 280)
    assert found == pytest.approx(worst)


@pytest.mark.parametrize("scale", [1.0, 1e-3])
@pytest.mark.parametrize(("slowest", "used"), [(2e-4, 2e-4), (0.5e-4, 1e-4)])
def test_the_smallest_speed_is_a_share_of_the_largest(monkeypatch, scale, slowest, used):
    speed = scale * np.linspace(1.0, slowest, 50)
    monkeypatch.setattr(_residuals, "Sampler", lambda mesh, t: SimpleNamespace(value=lambda y: speed))
    casing = SimpleNamespace(time=np.linspace(0.0, 10.0, 50))
    record = SimpleNamespace(
        casing=casing, I_casing=1.0, body="casing", torque_unit="N m", mechanism=GYROSCOPE
    )
    fit = SimpleNamespace(
        labels=("a",),
        problem=SimpleNamespace(data=[SimpleNamespace(record=record)]),
        predictions=[SimpleNamespace(path=SimpleNamespace(mesh=None, y=np.zeros((50, 2))))],
    )
    amplitude = 1e-12 * scale**2
    found = SimpleNamespace(label="a", size=lambda n: (amplitude, 10.0))
    (failure,) = _residuals._harmonic(fit, found, 1, 5.0)
    assert failure.residual_rad_s == pytest.approx(amplitude / (used * scale))


@pytest.mark.parametrize(
    ("unit", "divided"),
    [
        ("N m", "rad/s2"),
        ("N m s", "s-1"),
        ("N m s2", "1"),
        ("N m s1.5", "s-0.5"),
        ("N m s-1", "rad/s3"),
        ("N m s3", "s"),
        ("N m s^g", "s^(g-2)"),
        ("rad s-1", "rad s-1"),
        ("1", "1"),
    ],
)
def test_units_per_unit_of_inertia(unit, divided):
    assert per_inertia(unit) == divided


def test_torques_per_unit_of_inertia():
    assert format_torque(-0.41, 0.02, "rad/s2") == "-0.410 +- 0.020 rad/s2"
    assert format_torque(4.1e-3, unit="rad/s2") == "4.1 mrad/s2"
    assert format_torque(4.1e-5, unit="rad/s2") == "41 urad/s2"


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [
        (-4.1e-7, 2e-8, "-0.410 +- 0.020 uN m"),
        (3.84e-9, 0.0, "3.84 nN m"),
        (5.36e-4, 0.0, "536 uN m"),
        (-2.5e-3, 3e-4, "-2.5 +- 0.3 mN m"),
        (214.0, 0.0, "214 N m"),
        (float("nan"), float("nan"), "nan nN m"),
    ],
)
def test_the_prefix_follows_the_size(value, sigma, text):
    assert format_torque(value, sigma) == text


@pytest.mark.parametrize(
    ("torque", "sigma", "times", "text"),
    [
        # two digits of the uncertainty from 10 to 29, one above: nothing is quoted beyond it
        (
            -95110.0,
            12278.0,
            (0.1931, 0.2071),
            "-95000 +- 12000 rad/s2, 0.193 s to 0.207 s",
        ),
        (5030.0, 810.0, (0.0, 0.19), "+5000 +- 800 rad/s2, 0.00 s to 0.19 s"),
        (0.5, 0.1, (12.0, 31.26), "+0.50 +- 0.10 rad/s2, 12.0 s to 31.3 s"),
    ],
)
def test_a_lack_of_fit_in_words(torque, sigma, times, text):
    failure = Failure(
        "run",
        "casing",
        *times,
        "gains torque",
        "while slowing down",
        300.0,
        1.0,
        torque,
        (0.0, 1.0),
        "body",
        sigma,
        "rad/s2",
    )
    assert str(failure) == f"unmodelled torque on the body {text}, while slowing down (up to 300 sigma)"


def test_the_torque_of_an_interval_weighs_each_moment_by_its_variance():
    """A moment whose torque is hardly known does not hide the others: mean, uncertainty and distance agree."""
    fit = cases.fitted()
    time = np.linspace(*fit.problem.data[0].record.span, 200)
    inside = (np.arange(200) > 40) & (np.arange(200) < 60)
    torque, sigma = np.where(inside, 4.0, 0.0), np.where(inside, 0.1, 1.0)
    torque[inside.argmax()], sigma[inside.argmax()] = 40.0, 10.0
    curve = ResidualTorque(
        fit.labels[0], "casing", time, torque, sigma, np.zeros(200), np.linspace(10, 1, 200)
    )
    (found,) = find_failures(fit, [curve])
    assert found.residual_torque_Nm == pytest.approx(4.0, rel=0.01)
    assert found.size_sigma == pytest.approx(40.0)
    assert abs(found.residual_torque_Nm) / found.torque_sigma_Nm == pytest.approx(40.0, rel=0.05)


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (0.9998, "100 %"),
        (0.9968, "99.7 %"),
        (0.9, "90 %"),
        (0.05, "5 %"),
        (9.1e-7, "9.1 x 10^-5 %"),
        (0.0, "0 %"),
    ],
)
def test_shares_have_no_exponent_where_none_is_needed(share, text):
    assert percentage(share) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1928.0, "1930"),
        (95110.0, "95100"),
        (1.2e6, "1.2 x 10^6"),
        (0.0314159, "0.0314"),
        (99970.0, "1 x 10^5"),
    ],
)
def test_numbers_of_sentences(value, text):
    assert plain(value) == text


@pytest.mark.parametrize(
    ("a", "b", "where"), [(0, 10, "at the start"), (20, 40, "in the middle"), (70, 90, "while slowing down")]
)
def test_a_body_that_only_slows_down_has_no_peak(a, b, where):
    curve = SimpleNamespace(time=np.arange(100.0), omega_c=-50 * np.exp(-np.arange(100) / 30))
    assert _residuals._place(curve, a, b) == where


def test_a_speed_that_rises_and_falls_has_a_peak():
    time = np.arange(100.0)
    curve = SimpleNamespace(time=time, omega_c=time * (100 - time))
    assert [_residuals._place(curve, *ab) for ab in ((0, 20), (45, 55), (30, 70), (80, 100))] == [
        "while speeding up",
        "near the peak",
        "around the peak",
        "while slowing down",
    ]
