"""Turning points, phases and spectral lines of made series; laws of an angle; draws of a posterior."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import EstimationError, Input, Record
from fitting.effects._library import find
from fitting.inference import _case_model, _oscillation, _posterior, _spectral_lines
from fitting.inference._case_model import CaseModel
from fitting.inference._oscillation import ROTATION, Oscillation, find_oscillation, motion_of, turning_points
from fitting.inference._posterior import draws
from fitting.inference._record import Samples
from fitting.inference._spectral_lines import false_alarm_probability, line_rows, spectral_lines

T = np.arange(0.0, 20.0, 0.02)


def record(value, quantity="angle", sigma=1e-4, t=T, **more):
    return Record("x", 1.0, 1.0, Samples(t, value, np.full(len(t), sigma)), (), quantity, **more)


class TestTurningPoints:
    def test_reversals_beyond_the_hysteresis_count(self):
        curve = np.array([0.0, 2.0, 5.0, 4.5, 6.0, 3.0, 4.0, 1.0, 9.0, 0.0])
        assert turning_points(curve, 0.9).tolist() == [4, 5, 6, 7, 8]
        assert turning_points(curve, 1.1).tolist() == [4, 7, 8]
        assert turning_points(-curve, 1.1).tolist() == [4, 7, 8]
        assert turning_points(curve, 0.4).tolist() == [2, 3, 4, 5, 6, 7, 8]
        assert turning_points(curve, 20.0).tolist() == []

    def test_the_first_sense_is_that_of_the_first_large_change(self):
        assert turning_points(np.array([0.0, -0.5, 0.4, -0.4, 3.0, 0.0]), 2.0).tolist() == [4]
        assert turning_points(np.array([0.0, 0.5, -0.4, 0.4, -3.0, 0.0]), 2.0).tolist() == [4]

    def test_a_speed_changes_its_sign_between_significant_samples(self):
        speed = np.array([3.0, 0.1, -0.1, 0.1, -1.0, -4.0, 0.2, 4.0])
        assert _oscillation._sign_changes(speed, 0.5).tolist() == [3, 6]
        assert _oscillation._sign_changes(speed, 0.15).tolist() == [3, 6]
        assert len(_oscillation._sign_changes(speed, 0.05)) == 4
        assert _oscillation._sign_changes(speed, 5.0).tolist() == []


class TestOscillation:
    def test_a_decaying_oscillation_has_its_period_and_equilibrium(self):
        angle = 0.7 + 1.5 * np.exp(-0.02 * T) * np.cos(2.5 * T)
        found = find_oscillation(record(angle))
        assert found.period == pytest.approx(2 * math.pi / 2.5, rel=0.01)
        assert found.deflection == pytest.approx(angle - 0.7, abs=0.01)
        assert found.periods == pytest.approx(19.98 / found.period)
        assert found.amplitude == pytest.approx(0.5 * np.ptp(angle))
        assert len(found.reversals) == int(20.0 * 2.5 / math.pi)
        assert found.phase(found.reversals) == pytest.approx(
            math.pi * np.arange(len(found.reversals)), abs=0.06
        )

    def test_measured_speeds_oscillate_beside_a_drift(self):
        speed = 0.05 + 1.5 * np.cos(2.5 * T)
        found = find_oscillation(record(speed, "omega"))
        assert found.period == pytest.approx(2 * math.pi / 2.5, rel=0.02)
        assert found.deflection == pytest.approx(0.6 * np.sin(2.5 * T), abs=0.03)

    @pytest.mark.parametrize(("reversals", "found"), [(2, False), (3, True), (4, True)])
    def test_it_has_at_least_three_reversals(self, reversals, found):
        t = T[(reversals + 0.4) * math.pi / 2.5 > T]
        assert (find_oscillation(record(np.sin(2.5 * t - 1.2), t=t)) is not None) is found

    @pytest.mark.parametrize(("drift", "found"), [(0.95, True), (1.15, False)])
    def test_a_body_with_a_net_rotation_does_not_oscillate(self, drift, found):
        """The extremes of sin(2.5 t) + drift t advance by the drift; the share of the path is 0.6 at about 1.05."""
        angle = np.sin(2.5 * T) + drift * T
        turns = turning_points(angle, 0.01 * np.ptp(angle))
        extreme = angle[turns]
        share = abs(extreme[-1] - extreme[0]) / np.abs(np.diff(extreme)).sum()
        assert bool(share < 0.6) is found
        assert (find_oscillation(record(angle)) is not None) is found
        assert (find_oscillation(record(-angle)) is not None) is found

    @pytest.mark.parametrize(("sigma", "found"), [(0.24, True), (0.26, False)])
    def test_noise_hides_reversals(self, sigma, found):
        """The range is 2; reversals by less than 8 sigma do not count."""
        assert (find_oscillation(record(np.cos(2.5 * T), sigma=sigma)) is not None) is found
        speed = record(np.cos(2.5 * T), "omega", sigma=sigma / 2)
        assert (find_oscillation(speed) is not None) is found

    def test_the_middle_of_angles_is_fixed_and_that_of_integrated_speeds_drifts(self):
        """Of three extremes about the equilibrium e, the sum e1 + 2 e2 + e3 is 4 e."""
        angle = np.cos(2.5 * T) + 0.02 * T
        found = find_oscillation(record(angle))
        rest = angle - found.deflection
        assert rest == pytest.approx(np.full(len(T), rest[0]))
        assert rest[0] == pytest.approx(0.2, abs=0.03)
        speed = -2.5 * np.sin(2.5 * T) + 0.02
        drifting = find_oscillation(record(speed, "omega"))
        assert drifting.deflection == pytest.approx(np.cos(2.5 * T), abs=0.03)
        short = T[4.5 * math.pi / 2.5 > T]
        few = find_oscillation(record(-2.5 * np.sin(2.5 * short) + 0.02, "omega", t=short))
        assert len(few.reversals) == 4
        integral = np.cos(2.5 * short) - 1.0 + 0.02 * short
        assert np.ptp(integral - few.deflection) < 2e-3

    def test_windows_follow_a_motion_with_a_third_harmonic(self):
        t = np.arange(0.0, 60.0, 0.02)
        phase = 3.0 * t
        angle = np.cos(phase) + 0.2 * np.cos(3 * phase + 0.5)
        swing = Oscillation(np.arange(1, 57) * math.pi / 3.0, 2 * math.pi / 3.0, t, angle)
        assert swing.slow_motion.amplitude == pytest.approx(np.ones(20), abs=1e-3)

    def test_a_driven_body_or_one_with_a_joint_rotates(self):
        angle = np.cos(2.5 * T)
        assert isinstance(motion_of(record(angle)), Oscillation)
        u = Input("u", T[[0, -1]], np.array([0.0, 1.0]), "A")
        assert motion_of(record(angle, inputs=(u,))) is ROTATION
        both = Record("x", 1.0, 1.0, record(angle).casing, (record(90 * T).casing,))
        assert motion_of(both) is ROTATION

    def test_windows_follow_amplitude_and_phase(self):
        t = np.arange(0.0, 60.0, 0.02)
        amplitude, phase = 1.5 * np.exp(-0.02 * t), 6.0 * t - 0.01 * t**2
        found = find_oscillation(record(0.3 + amplitude * np.cos(phase), t=t)).slow_motion
        assert len(found.time) == 20
        assert found.amplitude == pytest.approx(1.5 * np.exp(-0.02 * found.time), rel=2e-3)
        change = found.phase - (6.0 * found.time - 0.01 * found.time**2)
        assert change - 2 * math.pi * np.round(change / (2 * math.pi)) == pytest.approx(
            np.zeros(20), abs=5e-3
        )

    @pytest.mark.parametrize(
        ("periods", "windows"), [(2.7, None), (3.5, 3), (12.0, 11), (45.0, 20), (90.0, 29)]
    )
    def test_the_number_of_windows_grows_with_the_periods(self, periods, windows):
        t = np.linspace(0.0, periods * 2 * math.pi, 4000)
        found = Oscillation(np.arange(1, int(2 * periods)) * math.pi, 2 * math.pi, t, np.cos(t)).slow_motion
        assert (None if found is None else len(found.time)) in {
            windows,
            None if windows is None else windows + 1,
        }

    def test_windows_need_ten_samples(self):
        t = np.linspace(0.0, 40 * math.pi, 180)
        assert Oscillation(np.arange(1, 40) * math.pi, 2 * math.pi, t, np.cos(t)).slow_motion is None
        t = np.linspace(0.0, 40 * math.pi, 230)
        assert Oscillation(np.arange(1, 40) * math.pi, 2 * math.pi, t, np.cos(t)).slow_motion is not None

    def test_a_phase_is_continued_linearly(self):
        at = np.linspace(2.0, 6.0, 9)
        phase = 1.0 + 3.0 * at - 0.2 * at**2
        found = _oscillation._smooth_phase(at, phase, np.array([1.0, 2.0, 5.0, 6.0, 8.0]))
        assert found == pytest.approx([6.2 - 2.2, 6.2, 11.0, 11.8, 11.8 + 2 * 0.6])
        few = _oscillation._smooth_phase(at[:3], phase[:3], at[:3])
        assert few == pytest.approx(np.polyval(np.polyfit(at[:3], phase[:3], 1), at[:3]))

    def test_harmonics_are_products_with_powers_of_time(self):
        t = np.linspace(0.0, 10.0, 300)
        swing = Oscillation(np.arange(1, 6) * 1.7, 3.4, t, np.cos(t))
        columns = swing.harmonics(300)
        assert columns.shape == (300, 24)
        x = t / 5 - 1
        assert columns[:, 0] == pytest.approx(np.cos(swing.phase(t)))
        assert columns[:, 5] == pytest.approx(np.sin(swing.phase(t)) * x)
        assert columns[:, 22] == pytest.approx(np.sin(3 * swing.phase(t)) * (1.5 * x**2 - 0.5))


class TestLines:
    def test_a_false_alarm_is_that_of_baluev(self):
        for chi2, band, span in ((40.0, 2.0, 50.0), (60.0, 0.5, 300.0)):
            z = chi2 / 2
            bound = math.exp(-z) * (1 + band * span * math.sqrt(math.pi / 3) * math.sqrt(z))
            assert false_alarm_probability(chi2, band, span) == pytest.approx(bound)
        assert false_alarm_probability(1.0, 2.0, 50.0) == 1.0
        assert false_alarm_probability(0.0, 0.0, 50.0) == 1.0

    def test_rows_of_a_line_count_from_the_first_sample(self):
        operator = np.array([[1.0, 2.0], [0.0, 3.0]])
        run = SimpleNamespace(
            z=np.zeros(2), samples=SimpleNamespace(time=np.array([5.0, 9.0])), lift=np.zeros((2, 1, 1)),
            binned_operators=[(np.array([5.5, 6.0]), operator)],
        )  # fmt: skip
        phase = np.array([[0.5], [1.0]]) * [2.0, 3.0]
        assert line_rows(run, [2.0, 3.0]) == pytest.approx(
            operator @ np.hstack([np.cos(phase), np.sin(phase)])
        )
        assert line_rows(run, []).shape == (2, 0)
        assert _spectral_lines._noise_times(run) == pytest.approx((0.06, 0.6, 2.0))

    def test_at_most_four_lines_are_found_each_beside_the_earlier_ones(self, monkeypatch):
        seen = []
        monkeypatch.setattr(
            _spectral_lines, "line_rows", lambda run, rates: np.full((3, 2 * len(rates)), 2.0)
        )
        monkeypatch.setattr(_spectral_lines, "split_into_stretches", lambda run, free: seen.append(free))
        lines = iter([SimpleNamespace(rate=float(i)) for i in range(9)])
        monkeypatch.setattr(_spectral_lines, "_strongest", lambda *given: next(lines))
        found = spectral_lines(None, np.ones((3, 1)))
        assert [x.rate for x in found] == [0.0, 1.0, 2.0, 3.0]
        assert [f.shape[1] for f in seen] == [1, 3, 5, 7]
        assert (seen[1][:, 1:] == 2.0 * _spectral_lines.FLAT_PRIOR_SIGMA).all()
        monkeypatch.setattr(_spectral_lines, "_strongest", lambda *given: None)
        assert spectral_lines(None, np.ones((3, 1))) == ()


class TestLawsOfAnAngle:
    def test_both_phases_have_the_present_strength(self):
        effect = find("casing.unbalance")
        laws, strength = _case_model._unit_laws(
            effect, {"casing.unbalance.k": 3.0, "casing.unbalance.phi": 0.4}
        )
        assert [law["phi"] for law in laws] == [0.0, math.pi / 2]
        assert [law["k"] for law in laws] == [1.0, 1.0]
        assert strength == pytest.approx([3 * math.cos(0.4), 3 * math.sin(0.4)])
        assert _case_model._unit_laws(effect, {})[1] == pytest.approx([0.0, 0.0])

    def test_the_derivative_follows_strength_and_phase(self):
        effect = find("casing.unbalance")
        made = object.__new__(CaseModel)
        sine, cosine = np.array([1.0, 2.0]), np.array([-3.0, 5.0])
        strength = np.array([0.3, 0.2])
        known = SimpleNamespace(
            columns=np.stack([sine, cosine], axis=1), strength=strength, value=np.array([7.0, 8.0])
        )
        made._columns = {effect.name: known}
        made.case, made._own = 0, {4: 0, 9: 1}
        places = {"casing.unbalance.k": 4, "casing.unbalance.phi": 9}
        made.layout = SimpleNamespace(places=lambda case, keys: np.array([places[keys[0]]]))

        def at(k, phi):
            rows, columns = np.zeros(2), np.zeros((2, 2))
            made._add(effect, {"casing.unbalance.k": k, "casing.unbalance.phi": phi}, rows, columns)
            return rows, columns

        rows, columns = at(2.0, 0.7)
        expected = (
            known.value - 0.3 * sine - 0.2 * cosine + 2.0 * (math.cos(0.7) * sine + math.sin(0.7) * cosine)
        )
        assert rows == pytest.approx(expected)
        assert columns[:, 0] == pytest.approx(
            (at(2.0 + 1e-6, 0.7)[0] - at(2.0 - 1e-6, 0.7)[0]) / 2e-6, rel=1e-6
        )
        assert columns[:, 1] == pytest.approx(
            (at(2.0, 0.7 + 1e-6)[0] - at(2.0, 0.7 - 1e-6)[0]) / 2e-6, rel=1e-6
        )

    def test_a_linear_iteration_ends_after_as_many_steps_as_it_has_dimensions(self):
        matrix, b = np.array([[0.9, 0.3], [-0.2, 1.4]]), np.array([1.0, 2.0])
        search, x = _case_model._FixedPoint(), np.zeros(2)
        for _ in range(4):
            x = search.next(x, matrix @ x + b)
        assert x == pytest.approx(np.linalg.solve(np.eye(2) - matrix, b))

    def test_the_error_of_a_mean_is_that_of_weights(self):
        assert _case_model._unit_error(Samples(T[:2], T[:2], np.array([0.3, 0.4]))) == pytest.approx(0.24)


class TestPosterior:
    def fit(self, covariance, free=(True, True, True), tied=()):
        layout = SimpleNamespace(is_free=np.array(free), tied=tied)
        return SimpleNamespace(
            problem=SimpleNamespace(layout=layout),
            theta=np.array([1.0, 2.0, 3.0]),
            covariance=np.array(covariance),
        )

    def test_draws_have_mean_and_covariance_and_hold_the_others(self):
        covariance = np.array([[4.0, -1e-3, 0.0], [-1e-3, 1e-6, 0.0], [0.0, 0.0, np.inf]])
        found = draws(self.fit(covariance), 4000, 2, "linearised", 1)
        assert found.shape == (2, 4000, 3)
        assert (found[..., 2] == 3.0).all()
        flat = found[..., :2].reshape(-1, 2)
        assert np.cov(flat.T) == pytest.approx(covariance[:2, :2], rel=0.06)
        assert flat.mean(axis=0) == pytest.approx([1.0, 2.0], abs=0.07)
        held = draws(self.fit(covariance, free=(False, True, True)), 10, 1, "linearised", 1)
        assert (held[..., 0] == 1.0).all()
        assert np.ptp(held[..., 1]) > 0

    def test_without_an_uncertainty_there_are_no_draws(self):
        for covariance in (np.zeros((3, 3)), np.diag([np.inf] * 3)):
            with pytest.raises(EstimationError, match="no parameter"):
                draws(self.fit(covariance), 10, 1, "linearised", 1)
        with pytest.raises(EstimationError, match="no method"):
            draws(self.fit(np.eye(3)), 10, 1, "other", 1)

    def test_a_root_gives_the_covariance_even_if_it_is_singular(self):
        v = np.array([2.0, 1e-6])
        for covariance in (np.outer(v, v), np.array([[4.0, 1e-6], [1e-6, 1e-12]])):
            root = _posterior._root(covariance)
            assert root @ root.T == pytest.approx(covariance, rel=1e-6)

    def test_tied_parameters_follow_each_draw(self, monkeypatch):
        monkeypatch.setattr(_posterior, "follow", lambda row, tied: np.array([row[0], row[1], 2 * row[0]]))
        found = draws(self.fit(np.eye(3), tied=("x",)), 5, 2, "linearised", 1)
        assert found[..., 2] == pytest.approx(2 * found[..., 0])
