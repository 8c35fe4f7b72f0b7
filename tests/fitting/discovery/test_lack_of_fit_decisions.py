"""Lack-of-fit tests against least squares of the same columns, and what contradicts or rivals an answer."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from linearised import covariance, gyroscope
from scipy import stats

from fitting import LIBRARY, Candidate, Estimate, EstimationError, Fit
from fitting._criteria import DEFAULT
from fitting.discovery import _lack_of_fit as module
from fitting.discovery._lack_of_fit import (
    UNKNOWN_IN_TIME,
    UNKNOWN_LAWS,
    HarmonicTest,
    contradiction,
    harmonic_test,
    nonparametric_law,
    nonparametric_rivals,
)
from fitting.discovery._score import CaseColumns
from fitting.effects._mechanism import GYROSCOPE
from fitting.inference import _periodogram as periodogram_module
from fitting.inference import _smooth_test as smooth_module
from fitting.inference._periodogram import PeriodogramPeak, periodogram_peak
from fitting.inference._smooth_test import SmoothTest, smooth_test, speeds
from fitting.inference._spectral_lines import false_alarm_probability

DRAG, UNBALANCE = LIBRARY["casing.air.quadratic"], LIBRARY["casing.unbalance"]
ACTING = {"rotor": (1.0, 0.0), "casing": (0.0, 1.0), "bearing": (-1.0, 1.0)}
SPEED = {"rotor": "omega_r", "casing": "omega_c", "bearing": "delta"}


def hats(values, low, high, count):
    """Return the functions that are 1 at one of equidistant knots and 0 at the others."""
    knots = np.linspace(low, high, count)
    return np.maximum(1 - np.abs(values[:, None] - knots) / (knots[1] - knots[0]), 0.0)


def scaled(columns):
    size = np.linalg.norm(columns, axis=0)
    return columns / np.where(size > 0, size, 1.0)


def rest(columns, rows):
    """Return what least squares leave of rows, without directions of rounding."""
    u, s, _ = np.linalg.svd(scaled(columns), full_matrices=False)
    basis = u[:, s > 1e-9 * s[0]]
    return rows - basis @ (basis.T @ rows)


def free_columns(base):
    return np.concatenate([base.predictions[0].jacobian, base.problem.data[0].nuisance], axis=1)


@pytest.fixture(scope="module")
def noisy():
    """A base whose residuals are white, with whitened free columns and residuals."""
    rows = np.random.default_rng(3).standard_normal(len(gyroscope().predictions[0].rows))
    base = gyroscope(level=1e-7, residual=[rows])
    base.noise[0].tested = 1e-7
    root = np.linalg.cholesky(covariance(base, 1e-7))
    return base, root, np.linalg.solve(root, free_columns(base)), np.linalg.solve(root, rows)


def test_speeds_are_those_of_casing_rotor_and_bearing():
    base = gyroscope()
    columns = CaseColumns(base, 0)
    found = speeds(columns.response.centres, base.predictions[0])
    for own, name in zip(found, ("omega_c", "omega_r", "delta"), strict=True):
        assert own == pytest.approx(columns.along_motion(name))


class TestNonparametricLaw:
    @pytest.mark.parametrize("joint", list(ACTING))
    def test_its_gain_is_that_of_least_squares_with_four_or_eight_knots(self, noisy, joint):
        base, root, free, rows = noisy
        columns = CaseColumns(base, 0)
        speed = columns.along_motion(SPEED[joint])
        gains = []
        for count in (4, 8):
            torque = hats(speed, speed.min(), speed.max(), count)
            rotor, casing = (share * torque for share in ACTING[joint])
            response = np.linalg.solve(root, columns.torque_rows(rotor, casing))
            own = scaled(np.column_stack([rest(free, c) for c in response.T]))
            u, s, _ = np.linalg.svd(own, full_matrices=False)
            gains.append(np.sum((u[:, s**2 > 1e-9 * s[0] ** 2].T @ rest(free, rows)) ** 2))
        assert nonparametric_law(base, joint, SPEED[joint]) == pytest.approx(max(gains), rel=2e-2)

    def test_the_knots_span_the_speeds_of_all_cases(self, monkeypatch):
        base = gyroscope(
            values={"initial.omega_c@a": 20.0, "initial.omega_c@b": 60.0}, cases=("a", "b"), level=1e-7
        )
        every = np.concatenate([CaseColumns(base, i).along_motion("omega_c") for i in (0, 1)])
        asked = []
        own = module.piecewise_linear
        monkeypatch.setattr(module, "piecewise_linear", lambda v, knots: asked.append(knots) or own(v, knots))
        monkeypatch.setattr(module, "score_of_columns", lambda context, columns: columns.shape[1])
        assert nonparametric_law(base, "casing", "omega_c") == 8
        assert {len(k) for k in asked} == {4, 8}
        assert all((k[0], k[-1]) == (every.min(), every.max()) for k in asked)


class TestSmooth:
    """Choices of columns beside two free columns, in 40 rows of unit variance."""

    RANDOM = np.random.default_rng(8)
    FREE = RANDOM.standard_normal((40, 2))
    ROWS = RANDOM.standard_normal(40)
    FIRST, SECOND = RANDOM.standard_normal((40, 3)), RANDOM.standard_normal((40, 5))

    def run(self, monkeypatch, choices, rows):
        names, columns = zip(*choices, strict=True)
        monkeypatch.setattr(
            smooth_module, "_smooth_rows", lambda *_: (list(names), list(columns), self.FREE, rows, ["share"])
        )

        def tail(chi2, dof, noise, shares):
            assert (noise, shares) == ("noise", ["share"])
            return stats.chi2.sf(chi2, dof)

        monkeypatch.setattr(smooth_module, "tail_probability", tail)
        return smooth_test("problem", "predictions", "noise")

    def single(self, columns, rows):
        before, after = rest(self.FREE, rows), rest(np.column_stack([self.FREE, columns]), rows)
        return stats.chi2.sf(before @ before - after @ after, columns.shape[1])

    def test_of_one_choice_it_is_the_chi_square_of_least_squares(self, monkeypatch):
        rows = self.ROWS + self.FIRST[:, 0] * 0.5 + 50.0 * self.FREE[:, 0]
        found = self.run(monkeypatch, [("casing", self.FIRST * [1.0, 1e6, 1e-6])], rows)
        assert found.body == "casing"
        assert found.p_value == pytest.approx(self.single(self.FIRST, rows), rel=0.15)

    def test_of_several_choices_the_smallest_counts_for_all(self, monkeypatch):
        rows = self.ROWS + 0.8 * self.SECOND[:, 1]
        choices = [("casing", self.FIRST), ("rotor", self.SECOND)]
        p = self.single(self.SECOND, rows)
        assert p < 0.5 * self.single(self.FIRST, rows)
        found = self.run(monkeypatch, choices, rows)
        assert found.body == "rotor"
        assert found.p_value == pytest.approx(-math.expm1(2 * math.log1p(-p)), rel=0.15)
        # the same choice twice is one test
        found = self.run(monkeypatch, [choices[1]] * 2, rows)
        assert found.p_value == pytest.approx(p, rel=0.15)

    def test_what_the_free_columns_absorb_is_not_tested(self, monkeypatch):
        absorbed = self.FREE @ np.ones((2, 3))
        found = self.run(monkeypatch, [("casing", absorbed)], self.ROWS)
        assert (found.body, found.p_value) == ("", 1.0)
        both = self.run(monkeypatch, [("casing", absorbed), ("rotor", self.FIRST)], self.ROWS)
        assert both.body == "rotor"

    def test_torques_of_each_speed_act_on_the_casing_or_in_the_bearing(self, monkeypatch):
        base = gyroscope(level=1e-7)
        monkeypatch.setattr(
            smooth_module,
            "FewRows",
            SimpleNamespace(
                of=lambda data, p, noise, rows: (rows, np.zeros((len(rows), 1)), rows[:, 0], 0.5)
            ),
        )
        names, tried, free, residual, shares = smooth_module._smooth_rows(
            base.problem, base.predictions, base.noise
        )
        assert names == [n for n in ("casing", "rotor", "bearing") for _ in range(4)]
        columns = CaseColumns(base, 0)
        for i, found in enumerate(tried):
            speed = columns.along_motion(SPEED[names[i]])
            torque = hats(speed, speed.min(), speed.max(), (4, 8)[i // 2 % 2])
            acting = -torque if i % 2 else 0 * torque
            assert found == pytest.approx(columns.torque_rows(acting, torque), abs=1e-3)
        assert (free.shape[1], len(residual), shares) == (1, len(tried[0]), [0.5])


class TestPeriodogram:
    def test_chi_square_and_amplitude_are_those_of_least_squares(self, noisy):
        base, root, free, rows = noisy
        (data,), (prediction,) = base.problem.data, base.predictions
        # a level that a lack of fit has raised
        (noise,) = gyroscope(level=3e-7).noise
        noise.tested = 1e-7
        periodogram = periodogram_module._Periodogram(data, prediction, noise)
        rates = np.array([6.0, 9.5])
        power, torque = periodogram(rates)
        columns = CaseColumns(base, 0)
        t = columns.response.centres
        for rate, found, amplitude in zip(rates, power, torque, strict=True):
            waves = np.stack([np.cos(rate * t), np.sin(rate * t)], axis=1)
            response = np.linalg.solve(root, columns.torque_rows(np.zeros_like(waves), waves))
            own = np.column_stack([rest(free, c) for c in response.T])
            strengths = np.linalg.lstsq(own, rest(free, rows))[0]
            assert found == pytest.approx(rest(free, rows) @ own @ strengths, rel=1e-3)
            assert amplitude == pytest.approx(np.hypot(*strengths), rel=1e-3)

    def test_frequencies_have_ten_periods_and_a_radian_per_cell(self, noisy):
        (base, *_), span = noisy, 12.0
        periodogram = periodogram_module._Periodogram(
            base.problem.data[0], base.predictions[0], base.noise[0]
        )
        assert periodogram.span == pytest.approx(span, rel=0.01)
        low, high, step = periodogram.band
        cell = np.diff(CaseColumns(base, 0).response.edges)[0]
        assert (low * periodogram.span, step * periodogram.span) == pytest.approx((20 * np.pi, np.pi))
        assert high * cell == pytest.approx(1.0)
        assert 0.0 < periodogram.share(10.0) < 1.0

    @pytest.mark.parametrize(("own", "power"), [(0.04, 4.0 + 9.0), (0.025, 0.0)])
    def test_a_torque_that_is_all_but_absorbed_has_no_power(self, own, power):
        found = periodogram_module._Periodogram.__new__(periodogram_module._Periodogram)
        found._basis = np.eye(6)[:, :2]
        found._residual = np.array([0.0, 0.0, 2.0, 3.0, 5.0, 0.0])
        columns = np.zeros((6, 2))
        columns[0, 0] = columns[1, 1] = 1.0
        columns[2, 0] = columns[3, 1] = own
        found._response_to = lambda rates: columns
        chi2, torque = found(np.array([1.0]))
        assert chi2 == pytest.approx([power])
        if power:
            assert torque == pytest.approx([math.hypot(2.0, 3.0) / own])

    def test_a_cosine_and_a_sine_that_are_not_orthogonal(self):
        found = periodogram_module._Periodogram.__new__(periodogram_module._Periodogram)
        found._basis = np.eye(6)[:, :2]
        found._residual = np.array([0.0, 0.0, 2.0, 3.0, 5.0, 0.0])
        columns = np.zeros((6, 2))
        columns[2:4] = [[1.0, 0.6], [0.0, 0.8]]
        found._response_to = lambda rates: columns
        chi2, torque = found(np.array([1.0]))
        assert chi2 == pytest.approx([13.0])
        # 3 / 0.8 of the sine, and 2 - 0.6 of that of the cosine
        assert torque == pytest.approx([math.hypot(3.75, 2.0 - 0.6 * 3.75)])


class TestNoiseLevels:
    def test_the_level_is_that_of_the_neighbours_and_at_least_one(self):
        k = np.arange(400)
        # smooth spectra: the median of chi2 is 2 ln 2 times the level
        chi2 = 2 * math.log(2) * np.where(k < 200, 0.5, 6.0)
        levels = periodogram_module._noise_levels(chi2)
        assert levels[:130] == pytest.approx(1.0)
        assert levels[270:] == pytest.approx(6.0)
        chi2[[5, 250, 395]] = 500.0
        assert periodogram_module._noise_levels(chi2)[[5, 250, 395]] == pytest.approx([1.0, 6.0, 6.0])

    def test_a_sinusoid_does_not_raise_its_own_level(self):
        # with 120 neighbours, 52 raised values change the median only if the four nearest ones count
        chi2 = np.arange(400) * 0.1
        own = periodogram_module._noise_levels(chi2)[200]
        chi2[196:205] = 1e6
        assert periodogram_module._noise_levels(chi2)[200] == own
        chi2[195] = chi2[205] = 1e6
        assert periodogram_module._noise_levels(chi2)[200] > own

    @pytest.mark.parametrize(("count", "level"), [(119, 1.0), (120, 5.0)])
    def test_few_frequencies_do_not_determine_a_level(self, count, level):
        chi2 = np.full(count, 10 * math.log(2))
        assert periodogram_module._noise_levels(chi2) == pytest.approx(level)


class Peak:
    """A periodogram with a peak of 60 at 2.34 rad/s; its amplitude is largest at another frequency."""

    span, band = 100.0, (1.0, 5.0, 0.1)

    def __init__(self, data, prediction, noise):
        pass

    def __call__(self, rates):
        return 60.0 * np.exp(-(((rates - 2.34) / 0.1) ** 2)), 3e-6 * (1 + rates)

    def share(self, rate):
        return 0.3


class TestHighestPeak:
    def peak(self, monkeypatch, *, period=math.inf, amplitude=math.inf, tracked=False, cases=1, **changes):
        monkeypatch.setattr(periodogram_module, "_Periodogram", type("Other", (Peak,), changes))
        sigma = np.array([1e-9, 0.09, 1.0])
        record = SimpleNamespace(
            mechanism=GYROSCOPE,
            I_casing=2e-5, tracked=tracked, casing=SimpleNamespace(sigma=sigma), label="run", body="casing",
            torque_unit="N m",
        )  # fmt: skip
        data = SimpleNamespace(motion=SimpleNamespace(period=period, amplitude=amplitude), record=record)
        process = SimpleNamespace(ratios=np.array([1.0, 4.0]), weights=np.array([0.75, 0.25]))
        return periodogram_module._highest_peak(data, None, SimpleNamespace(process=process), cases)

    def test_frequency_amplitude_and_probability(self, monkeypatch):
        found = self.peak(monkeypatch, cases=3)
        assert found.rate == pytest.approx(2.34, abs=0.1 / 16)
        assert found.torque == pytest.approx(3e-6 * (1 + found.rate))
        assert found.angle == pytest.approx(found.torque / (2e-5 * found.rate**2))
        power = 60.0 * math.exp(-(((found.rate - 2.34) / 0.1) ** 2))
        one, other = (
            false_alarm_probability(power / (0.7 + 0.3 * x), 4.0 / (2 * math.pi), 100.0) for x in (1.0, 4.0)
        )
        assert found.p_value / (3 * (0.75 * one + 0.25 * other)) == pytest.approx(1.0)
        assert (found.label, found.body) == ("run", "casing")

    def test_the_highest_peak_above_the_noise_near_it(self, monkeypatch):
        """Noise that rises with the frequency has the largest chi2; the peak at 2.34 rad/s exceeds its own noise."""

        def coloured(self, rates):
            return Peak.__call__(self, rates)[0] + np.maximum(5 * (rates - 12), 0.0), 3e-6 * (1 + rates)

        found = self.peak(monkeypatch, band=(1.0, 25.0, 0.1), __call__=coloured)
        assert found.rate == pytest.approx(2.34, abs=0.1 / 16)
        assert found.p_value < 1e-4
        loud = self.peak(
            monkeypatch, band=(1.0, 25.0, 0.1), __call__=lambda self, r: (np.full(len(r), 60.0), 1e-6 * r)
        )
        assert loud.p_value > 0.1

    @pytest.mark.parametrize("at", [2.27, 2.3, 2.34])
    def test_it_is_found_on_either_side_of_a_trial_frequency(self, monkeypatch, at):
        def call(self, rates):
            return 60.0 * np.exp(-(((rates - at) / 0.1) ** 2)), 3e-6 * np.ones(len(rates))

        assert self.peak(monkeypatch, __call__=call).rate == pytest.approx(at, abs=0.1 / 16)

    @pytest.mark.parametrize("own", [1.5, 4.0, 2.34])
    def test_the_angle_of_an_oscillator_is_that_off_resonance(self, monkeypatch, own):
        found = self.peak(monkeypatch, period=2 * math.pi / own)
        least = max(abs(own**2 - found.rate**2), 0.01 * own**2)
        assert found.angle == pytest.approx(found.torque / (2e-5 * least))

    @pytest.mark.parametrize(
        ("tracked", "amplitude", "size", "credible"),
        [
            (True, math.inf, 1.0, True),  # an angle of 91 mrad, beside noise of 90 mrad
            (True, math.inf, 0.95, False),
            (False, math.inf, 0.95, True),
            (False, 0.1, 1.0, True),
            (False, 0.08, 1.0, False),  # larger than the motion
        ],
    )
    def test_an_angle_below_the_noise_of_a_film_is_not_credible(
        self, monkeypatch, tracked, amplitude, size, credible
    ):
        def call(self, rates):
            return 60.0 * np.exp(-(((rates - 2.34) / 0.1) ** 2)), size * 1e-5 * np.ones(len(rates))

        found = self.peak(monkeypatch, tracked=tracked, amplitude=amplitude, __call__=call)
        assert found.angle == pytest.approx(size * 0.0915, rel=0.01)
        assert (found.p_value < 1e-4) is credible
        assert credible or found.p_value == 1.0

    def test_a_short_record_has_none(self, monkeypatch):
        assert self.peak(monkeypatch, band=(5.0, 5.0, 0.1)) is None
        weak = self.peak(monkeypatch, __call__=lambda self, rates: (0 * rates + 0.1, 0 * rates + 1e-6))
        assert weak.p_value == 1.0

    @pytest.mark.parametrize(("p", "significant"), [(0.0009, True), (0.0011, False)])
    def test_the_clearest_peak_of_all_cases_counts(self, monkeypatch, p, significant):
        peaks = {"a": p, "b": 0.5, "c": None}

        def highest(data, prediction, noise, cases):
            assert cases == 3
            value = peaks[data]
            return None if value is None else PeriodogramPeak(2.0, 1e-6, 1e-4, data, "casing", value)

        monkeypatch.setattr(periodogram_module, "_highest_peak", highest)

        def peak(*labels):
            return periodogram_peak(SimpleNamespace(data=labels), labels, labels)

        found = peak("b", "a", "c")
        assert (found.label, found.p_value) == ("a", p)
        base = SimpleNamespace(periodogram_peak=found)
        assert (Fit.significant_peak(base, DEFAULT) is not None) is significant
        monkeypatch.setattr(periodogram_module, "_highest_peak", lambda *_: None)
        assert peak("c") is None
        assert Fit.significant_peak(SimpleNamespace(periodogram_peak=None), DEFAULT) is None

    def test_its_words(self):
        found = PeriodogramPeak(4.0, 2e-6, 3e-3, "run", "casing", 1e-6)
        assert "sinusoidal with a period of 1.571 s in run: a torque of 2 uN m" in found.words
        assert "or 3 mrad of its angle" in found.words
        assert found.law == "casing: k*cos(4*t + phi)"


class TestHarmonic:
    """Harmonics of three to six periods per turn, with columns of 30 rows and one free column."""

    RANDOM = np.random.default_rng(5)
    COLUMNS = RANDOM.standard_normal((7, 2, 2, 30))  # order, case, sine and cosine
    FREE = RANDOM.standard_normal((2, 30, 1))
    NOISE = 0.3 * RANDOM.standard_normal((2, 30))

    def rows(self, order, case, strength, phase):
        sine, cosine = self.COLUMNS[order, case]
        signal = strength * (math.cos(phase) * sine + math.sin(phase) * cosine)
        return self.NOISE[case] + signal + 7.0 * self.FREE[case, :, 0]

    def run(self, monkeypatch, rows, *, angles=None, typical=50.0, effects=(), estimates=None, fitted=None):
        asked = self.asked = {"tail": [], "fit": []}
        angles = angles or [True] * len(rows)

        def tail(chi2, count, noise, shares):
            asked["tail"].append((chi2, count, shares))
            return stats.chi2.sf(chi2, count)

        class Identity:
            def __init__(self, data, level):
                assert level == "tested"
                self.whitener = SimpleNamespace(share=lambda basis: 0.25)

            def __call__(self, columns):
                return columns

        def fit(model, base, *, start, noise, quick):
            asked["fit"].append((model, start, noise, quick))
            if fitted is None:
                raise EstimationError("it diverges", "")
            return SimpleNamespace(estimates={"harmonic.k": Estimate(*fitted, "N m", at_bound=False)})

        monkeypatch.setattr(module, "tail_probability", tail)
        monkeypatch.setattr(module, "Projection", Identity)
        monkeypatch.setattr(module, "fit_model", fit)
        monkeypatch.setattr(
            module, "CaseColumns", lambda fit, i: SimpleNamespace(typical_torque=np.array([1.0, -typical]))
        )

        def columns(case):
            def of(law, *_):
                order = int(law.law.partition("(")[2].partition("*")[0])
                return self.COLUMNS[order, case]

            return SimpleNamespace(unit_columns=of)

        base = SimpleNamespace(
            problem=SimpleNamespace(
                data=[
                    SimpleNamespace(measured_angle=1 if a else None, z=z)
                    for a, z in zip(angles, rows, strict=True)
                ],
                cases=[columns(i) for i in range(len(rows))],
                layout=SimpleNamespace(numbers=lambda theta, index: {}),
            ),
            predictions=[
                SimpleNamespace(columns=self.FREE[i], rows=np.zeros(30), path=None, sensitivity=None)
                for i in range(len(rows))
            ],
            noise=[SimpleNamespace(tested="tested", whitener=SimpleNamespace(at=lambda x: x))] * len(rows),
            model=SimpleNamespace(effects=effects, with_effect=lambda e: e.law, mechanism=GYROSCOPE),
            theta=None, values={"a.k": 2.0}, estimates=estimates or {}, torque_unit="N m",
        )  # fmt: skip
        return harmonic_test(base, DEFAULT)

    def fall(self, order, case, rows):
        free = self.FREE[case]
        before = rest(free, rows)
        after = rest(np.column_stack([free, *self.COLUMNS[order, case]]), rows)
        return before @ before - after @ after

    @pytest.mark.parametrize("order", [3, 4, 5, 6])
    def test_the_clearest_order_has_the_chi_square_of_least_squares(self, monkeypatch, order):
        rows = [self.rows(order, i, 2.0, 0.4) for i in (0, 1)]
        found = self.run(monkeypatch, rows)
        assert (found.order, len(self.asked["tail"])) == (order, 4)
        chi2, count, shares = self.asked["tail"][order - 3]
        assert chi2 == pytest.approx(sum(self.fall(order, i, rows[i]) for i in (0, 1)))
        assert (count, shares) == (4, [0.25, 0.25])
        assert found.p_value / (4 * stats.chi2.sf(chi2, 4)) == pytest.approx(1.0)

    def test_a_case_without_angles_is_left_out(self, monkeypatch):
        rows = [self.rows(4, i, 2.0, 0.4) for i in (0, 1)]
        self.run(monkeypatch, rows, angles=[False, True])
        chi2, count, shares = self.asked["tail"][1]
        assert chi2 == pytest.approx(self.fall(4, 1, rows[1]))
        assert (count, shares) == (2, [0.0, 0.25])
        assert self.run(monkeypatch, rows, angles=[False, False]).p_value == 1.0

    @pytest.mark.parametrize("phase", [0.4, 2.0, -1.0])
    def test_the_fit_starts_at_a_small_amplitude_and_the_phase(self, monkeypatch, phase):
        found = self.run(monkeypatch, [self.rows(5, 0, 2.0, phase)], fitted=(3.0, 1.0))
        ((law, start, _, quick),) = self.asked["fit"]
        assert (law, quick) == ("k*sin(5*psi_c - phi)", True)
        assert (start["harmonic.k"], start["a.k"]) == (0.5, 2.0)
        assert start["harmonic.phi"] == pytest.approx(phase, abs=0.2)
        assert "contains harmonic 5 of psi_c, amplitude 3" in found.words
        self.run(monkeypatch, [self.rows(5, 0, 2.0, phase)], typical=1000.0, fitted=(3.0, 1.0))
        assert self.asked["fit"][0][1]["harmonic.k"] == pytest.approx(2.0, abs=0.3)

    @pytest.mark.parametrize(
        ("fitted", "determined"),
        [
            ((2.1, 1.0), True),
            ((-2.1, 1.0), True),
            ((1.9, 1.0), False),
            ((49.0, 1.0), True),
            ((51.0, 1.0), False),  # above all other torques
            (None, False),
        ],
    )
    def test_the_amplitude_is_that_of_the_fit_if_it_is_determined(self, monkeypatch, fitted, determined):
        found = self.run(monkeypatch, [self.rows(3, 0, 2.0, 0.4)], fitted=fitted)
        assert (found.fit is not None) is determined
        assert ("of undetermined amplitude" in found.words) is not determined
        if determined:
            assert "amplitude -" not in found.words

    def test_without_a_significant_one_nothing_is_fitted(self, monkeypatch):
        for strength in (0.05, 0.2, 0.4, 0.8, 2.0):
            found = self.run(monkeypatch, [self.rows(3, 0, strength, 0.4)], fitted=(3.0, 1.0))
            assert bool(self.asked["fit"]) is (found.p_value < DEFAULT.doubt_adequate)

    def test_a_harmonic_above_all_other_torques_is_not_one(self, monkeypatch):
        rows = [self.rows(3, 0, 2.0, 0.4)]
        assert self.run(monkeypatch, rows, typical=1.2).order != 3
        # nor does that of a law of the angle in the model
        known = {f"{UNBALANCE.name}.k@a": Estimate(-9.0, 1.0, "N m", at_bound=False)}
        with_law = self.run(monkeypatch, rows, typical=1.2, effects=(DRAG, UNBALANCE), estimates=known)
        assert with_law.order == 3
        drag = {f"{DRAG.name}.k": Estimate(-9.0, 1.0, "N m", at_bound=False)}
        assert self.run(monkeypatch, rows, typical=1.2, effects=(DRAG,), estimates=drag).order != 3
        weak = {f"{UNBALANCE.name}.k": Estimate(0.1, 1.0, "N m", at_bound=False)}
        assert self.run(monkeypatch, rows, effects=(UNBALANCE,), estimates=weak).order == 3


def candidate(effect=DRAG, value=50.0, screened=40.0, alike=()):
    return Candidate(effect, value, -40.0, 1e-6, 0.0, tuple(alike), {}, True, SimpleNamespace(score=screened))


class TestContradiction:
    @pytest.mark.parametrize(
        ("chosen", "peak", "harmonic", "smooth", "found"),
        [
            (None, None, 1e-9, 0.0009, "smooth"),
            (None, None, 1e-9, 0.0011, None),
            (candidate(), None, 1e-9, 0.009, "smooth"),  # a named law
            (candidate(), None, 1e-9, 0.011, None),
            (candidate(alike=("other",)), None, 1e-9, 0.0009, "smooth"),
            (candidate(alike=("other",)), None, 1e-9, 0.0011, None),
            (candidate(UNBALANCE), None, 0.0009, 1.0, "harmonic"),
            (candidate(UNBALANCE), None, 0.0011, 0.009, "smooth"),
            (candidate(UNBALANCE), None, 0.0011, 1.0, None),
            (candidate(UNBALANCE), "peak", 1e-9, 1e-9, "peak"),
            (None, "peak", 1.0, 1.0, "peak"),
        ],
    )
    def test_which_test_contradicts_an_answer(self, monkeypatch, chosen, peak, harmonic, smooth, found):
        results = {
            "peak": peak,
            "harmonic": HarmonicTest(3, harmonic),
            "smooth": SmoothTest("casing", smooth),
        }
        monkeypatch.setattr(module, "harmonic_test", lambda fit, criteria: results["harmonic"])
        end = SimpleNamespace(
            significant_peak=lambda criteria: results["peak"], smooth_test=results["smooth"]
        )
        assert contradiction(chosen, end, DEFAULT) is (results[found] if found else None)


class TestRivals:
    def rivals(self, monkeypatch, chosen, gains, *, test=None, parts=("casing", "rotor")):
        self.asked = []

        def gain(fit, joint, speed):
            self.asked.append((joint, speed))
            return gains.get(speed, 0.0)

        monkeypatch.setattr(module, "nonparametric_law", gain)
        record = SimpleNamespace(parts=frozenset(parts))
        fit = SimpleNamespace(problem=SimpleNamespace(data=[SimpleNamespace(record=record)]))
        return nonparametric_rivals(fit, chosen, test, DEFAULT)

    @pytest.mark.parametrize(
        ("value", "screened", "gain", "rival"),
        [
            (50.0, 40.0, 40.1, True),
            (50.0, 40.0, 39.9, False),
            (40.0, 50.0, 40.1, True),
            (40.0, 50.0, 39.9, False),
        ],
    )
    def test_a_law_within_ten_of_the_score_is_a_rival(self, monkeypatch, value, screened, gain, rival):
        found = self.rivals(monkeypatch, candidate(DRAG, value, screened), {"omega_r": gain})
        assert found == ((UNKNOWN_LAWS["omega_r"],) if rival else ())

    @pytest.mark.parametrize(
        ("effect", "parts", "asked"),
        [
            ("casing.air.quadratic", ("casing", "rotor"), ["omega_r", "delta"]),
            ("casing.windage", ("casing", "rotor"), ["omega_c", "omega_r", "delta"]),
            ("rotor.air.linear", ("casing", "rotor"), ["omega_c", "delta"]),
            ("bearing.quadratic", ("casing", "rotor"), ["omega_c", "omega_r"]),
            ("touchpoint.drift", ("casing", "rotor"), ["omega_c", "omega_r", "delta"]),
            ("casing.air.quadratic", ("casing",), []),
            ("touchpoint.drift", ("casing",), ["omega_c"]),
        ],
    )
    def test_its_own_speed_is_not_tried(self, monkeypatch, effect, parts, asked):
        self.rivals(monkeypatch, candidate(LIBRARY[effect]), {}, parts=parts)
        assert [speed for _, speed in self.asked] == asked

    @pytest.mark.parametrize(("any_in_time", "found"), [(True, (UNKNOWN_IN_TIME,)), (False, ())])
    def test_any_torque_in_time_is_one(self, monkeypatch, any_in_time, found):
        test = SimpleNamespace(any_in_time=any_in_time)
        assert self.rivals(monkeypatch, candidate(), {}, test=test) == found

    def test_without_physics_there_is_none(self, monkeypatch):
        assert self.rivals(monkeypatch, None, {"omega_r": 99.0}) == ()
        fault = candidate(LIBRARY["setup.inertia"])
        assert self.rivals(monkeypatch, fault, {"omega_r": 99.0}) == ()
