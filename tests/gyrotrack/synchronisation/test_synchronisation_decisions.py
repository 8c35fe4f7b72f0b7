"""Search, calibration and choice of the start of a clip: references by linear algebra, and both sides of each rule."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import UsageError
from gyrotrack.synchronisation import _decision as decision
from gyrotrack.synchronisation import _matching as matching
from gyrotrack.synchronisation._decision import Match, Motion, Rival, Survey, candidates, motion
from gyrotrack.synchronisation._matching import (
    TURN,
    Curve,
    Pair,
    Solution,
    Start,
    casing_around,
    casing_curve,
    harmonics,
    normal,
    solve,
)
from tests.gyrotrack.synchronisation.conftest import body, recording
from tests.gyrotrack.synchronisation.test_matching_formulas import clip_of, curve, psi, start_at


class TestMotion:
    def test_it_is_the_fit_of_a_cubic_with_harmonics(self):
        """With harmonics of 0.02 +- 0.02 rad; scatter beyond the stated one counts per degree of freedom."""
        s, sigma = np.linspace(-0.7, 0.9, 30), 1e-3
        angle = psi(4.0 + s) + 3 * sigma * np.random.default_rng(2).standard_normal(30)
        found = motion(Curve(4.0 + s, angle, np.full(30, sigma)), 4.0)
        design = np.column_stack([np.ones(30), s, s**2 / 2, s**3 / 6, harmonics(angle)])
        normal = design.T @ design / sigma**2 + np.diag([0.0] * 4 + [1 / 0.02**2] * 4)
        fitted = np.linalg.solve(normal, design.T @ (angle - angle.mean()) / sigma**2)
        rest = (angle - angle.mean() - design @ fitted) / sigma
        chi2 = rest @ rest + np.sum((fitted[4:] / 0.02) ** 2)
        assert chi2 > 2 * (30 - 8)
        assert found.value == pytest.approx(fitted[1:4], rel=1e-6)
        assert found.covariance == pytest.approx(np.linalg.inv(normal)[1:4, 1:4] * chi2 / (30 - 8), rel=1e-5)

    def test_harmonics_of_a_casing_that_hardly_turns_are_not_known(self):
        """Each of four harmonics of 0.02 rad adds k omega 0.02 rad to the speed: sqrt(1 + 4) omega 0.02 rad."""
        found = motion(curve(0.0, 2.0, 400.0, sigma=1e-4, angle=lambda t: 0.05 * t), 1.0)
        assert math.sqrt(found.covariance[0, 0]) == pytest.approx(math.sqrt(5) * 0.05 * 0.02, rel=0.1)

    def test_samples_at_three_times_determine_no_cubic(self):
        t = np.repeat([0.0, 0.5, 1.0], 8)
        assert motion(Curve(t, psi(t), np.full(24, 1e-3)), 0.5) is None

    @pytest.mark.parametrize(("moments", "enough"), [(3, False), (4, True)])
    def test_a_survey_of_four_times_is_needed(self, moments, enough):
        known = motion(clip_of(4.0, 0.0, 0.0), 1.0)
        record = Survey(1.0, np.arange(float(moments)), (known,) * moments)
        assert bool(candidates(record, clip_of(4.0, 0.0, 0.0))) is enough

    def test_the_clip_and_the_record_are_both_uncertain(self, monkeypatch):
        """A difference of the speeds with the variances 3, 1 and 0.02^2, and that of the rate, 0.1^2."""
        value, shift, seen = np.array([100.0, 0.0, 0.0]), np.array([2.0, 0.0, 0.0]), []
        monkeypatch.setattr(decision, "motion", lambda *_: Motion(value + shift, np.eye(3) * 3.0))
        monkeypatch.setattr(decision, "_minima", lambda distance: seen.append(distance) or [])
        record = Survey(1.0, np.arange(6.0), (Motion(value, np.eye(3)),) * 6)
        candidates(record, clip_of(4.0, 0.0, 0.0))
        assert seen[0] == pytest.approx(np.full(len(seen[0]), 4.0 / (3.0 + 1.0 + 0.02**2 + 0.1**2)))


class TestCalibration:
    """Noise by the residuals of the most flexible spline."""

    @pytest.mark.parametrize(
        ("intervals", "left"), [(8, 0.8), (44, 0.5), (100, 0.1)], ids=["24", "60", "116 of 120"]
    )
    def test_parameters_and_correlation_enlarge_the_variance(self, monkeypatch, intervals, left):
        """16 parameters and one for each interval are fitted to 60 + 60 samples; at least a tenth remains."""
        casing = curve(0.0, 0.6, 100.0, sigma=1e-3)
        clip = curve(0.0, 0.6, 100.0, sigma=1e-3)
        normal = SimpleNamespace(
            residual_casing=np.tile([2.0, -2.0], 30), residual_clip=np.tile([3.0, -3.0], 30)
        )
        monkeypatch.setattr(decision, "_residuals", lambda *_: normal)
        monkeypatch.setattr(
            decision, "correlation_factor", lambda residual: {2.0: 5.0, 3.0: 7.0}[float(residual[0])]
        )
        found, rejected = decision._with_calibrated_noise(Pair(casing, clip, intervals), Start(0.0, 0.0, 0.0))
        assert rejected == 0
        assert found.casing.sigma == pytest.approx(1e-3 * math.sqrt(4.0 * 5.0 / left))
        assert found.clip.sigma == pytest.approx(1e-3 * math.sqrt(9.0 * 7.0 / left))

    @pytest.mark.parametrize(("variance", "intervals"), [(0.9, 2), (0.8, 4), (0.05, 4)])
    def test_two_more_intervals_must_lower_the_misfit_by_their_penalty(
        self, monkeypatch, variance, intervals
    ):
        """60 block means: 60 ln v falls by more than 2 ln 60 = 8.2 for v < 0.872."""

        def residuals(pair, start):
            means = math.sqrt(variance if pair.intervals >= 4 else 1.0) * np.tile([1.0, -1.0], 15)
            return SimpleNamespace(residual_clip=np.repeat(means, 4), residual_casing=np.repeat(means, 4))

        monkeypatch.setattr(decision, "_residuals", residuals)
        monkeypatch.setattr(decision, "_with_calibrated_noise", lambda pair, start: (pair, 0))
        monkeypatch.setattr(decision, "_with_slow_noise", lambda pair, start: pair)
        pair, _ = decision._calibrated(Pair(None, None, 4), None)
        assert pair.intervals == 2 * intervals

    def test_slow_errors_are_those_beside_motion_start_and_harmonics(self, monkeypatch):
        """What the fit of the clip can absorb, in units of its sigma."""
        asked = []
        monkeypatch.setattr(
            decision, "slow_variance", lambda time, rows, residual, period: asked.append(rows) or 1.0
        )
        casing, clip = curve(0.0, 10.0, 260.0, seed=1), clip_of(4.0, 0.0, 0.7, seed=2)
        pair, start = Pair(casing, clip, 8), Start(4.0, 0.0, 0.7)
        decision._with_slow_noise(pair, start)
        of_casing, of_clip = asked
        around = casing_around(pair, start)
        assert of_casing is not of_clip
        assert of_casing == pytest.approx(around.rows)
        speed = around.speed(clip.time + 4.0)
        absorbed = (
            np.column_stack(
                [
                    speed,
                    speed * clip.time,
                    np.ones(len(speed)),
                    harmonics(clip.angle),
                    around.design(clip.time + 4.0),
                ]
            )
            / clip.sigma[:, None]
        )
        left = absorbed - of_clip @ np.linalg.lstsq(of_clip, absorbed, rcond=None)[0]
        assert np.abs(left).max() < 1e-6 * np.abs(absorbed).max()
        assert of_clip.shape == absorbed.shape


class TestClipsOfOneCamera:
    def matched(self, monkeypatch, covariance, rivals=()):
        """Two clips at 1 s and 5 s whose joint solution has this covariance, (6, 6)."""
        starts = (Start(1.0, 0.0, 0.0), Start(5.0, 0.0, 0.0))
        best = Solution(starts, covariance, 100.0, True, starts)
        monkeypatch.setattr(decision, "_solve", lambda *_, **__: best)
        monkeypatch.setattr(decision, "_rivals", lambda *_: list(rivals))
        monkeypatch.setattr(
            decision, "_next_turns", lambda *_: [Rival(1.3, 12.0, "turn"), Rival(0.7, 40.0, "turn")]
        )
        monkeypatch.setattr(decision, "_common_direction", lambda *_, **__: ([0, None], best))
        clips = [
            SimpleNamespace(name=n, pair=None, solutions=(start_at(o),), misfit=0.0, rejected=0)
            for n, o in (("a", 1.0), ("b", 5.0))
        ]
        return decision._match_camera(clips)

    def test_each_has_its_own_covariance(self, monkeypatch):
        covariance = np.diag([1.0, 4.0, 9.0, 16.0, 25.0, 36.0]) * 1e-8
        covariance[3, 5] = covariance[5, 3] = 7e-8
        first, second = self.matched(monkeypatch, covariance)
        assert first.covariance == pytest.approx(covariance[:3, :3])
        assert second.covariance == pytest.approx(covariance[3:, 3:])
        assert [second.offset_sigma, second.rate_sigma, second.angle_sigma] == pytest.approx(
            [4e-4, 5e-4, 6e-4]
        )

    def test_rivals_are_sorted_and_turns_are_those_of_a_common_direction(self, monkeypatch):
        first, second = self.matched(
            monkeypatch, np.eye(6) * 1e-8, [Rival(8.0, 20.0, "stretch"), Rival(9.0, 50.0, "stretch")]
        )
        assert [(r.offset, r.delta_chi2) for r in first.rivals] == [
            (1.3, 12.0), (8.0, 20.0), (0.7, 40.0), (9.0, 50.0),
        ]  # fmt: skip
        assert [r.offset for r in second.rivals] == [8.0, 9.0]
        assert (first.common_direction, second.common_direction) == (True, False)

    @pytest.mark.parametrize(
        ("rates", "sigmas", "two"),
        [
            ((0.0, 5.9e-4), (1e-5, 1e-4), False),  # 2e-4 + 4 x 1.005e-4 = 6.02e-4
            ((0.0, 6.1e-4), (1e-5, 1e-4), True),
            ((6.1e-4, 0.0), (1e-4, 1e-5), True),
            ((0.0, 7.5e-4), (1e-4, 1e-4), False),  # 2e-4 + 4 x 1.414e-4 = 7.66e-4
            ((0.0, 0.0, 3e-4), (1e-6, 1e-6, 1e-5), True),  # one of three is enough
            ((0.0, 3e-4, 9e-4), (1e-3, 1e-5, 1e-4), False),  # about the best known one
            ((0.0, 3e-4, 9.1e-4), (1e-3, 1e-5, 1e-4), True),
        ],
    )
    def test_clocks_differ_from_the_best_known_one(self, rates, sigmas, two):
        starts = tuple(Start(float(k), eps, 0.0) for k, eps in enumerate(rates))
        covariance = np.diag(
            np.column_stack([np.ones_like(sigmas), sigmas, np.ones_like(sigmas)]).ravel() ** 2
        )
        assert decision._are_two_clocks(Solution(starts, covariance, 0.0, True, starts)) is two

    @pytest.mark.parametrize(("rise", "common"), [(18.3, True), (18.5, False)])
    def test_the_rates_of_three_clips_have_two_degrees_of_freedom(self, monkeypatch, rise, common):
        """exp(-x / 2) = 1e-4 at x = 18.42; half of the rise enlarges the variances."""

        def solved(pairs, starts, *, common_rate, turns=None, windows=None):
            eps = (0.0, 0.0, 0.0) if common_rate else (0.0, 1e-2, 2e-2)
            starts = tuple(replace(s, eps=e) for s, e in zip(starts, eps, strict=True))
            return Solution(starts, np.eye(9) * 1e-8, 100.0 + rise * common_rate, True, starts)

        monkeypatch.setattr(decision, "_solve", solved)
        monkeypatch.setattr(decision, "_common_direction", lambda pairs, best, **_: ([None] * 3, best))
        clips = [
            SimpleNamespace(name=str(k), pair=None, solutions=(start_at(9.0 * k),), misfit=0.0, rejected=0)
            for k in range(3)
        ]
        found = decision._match_camera(clips)
        assert [m.common_rate for m in found] == [common] * 3
        assert found[2].offset_sigma == pytest.approx(1e-4 * math.sqrt(rise / 2 if common else 1.0))

    def test_an_uncertain_start_has_no_rival_within_a_tenth_of_its_uncertainty(self):
        """1 ms + 50 ms / 10."""
        best = start_at(1.0, 100.0, sigma=0.05)
        fits = [best, start_at(1.0059, 101.0), start_at(0.9941, 101.0), start_at(1.0161, 102.0)]
        assert [r.offset for r in decision._rivals(fits, best, 0)] == [1.0161]

    def test_rivals_within_a_hundredth_of_a_second_are_one(self):
        best = start_at(1.0, 100.0)
        fits = [best, start_at(2.0, 103.0), start_at(2.001, 102.0), start_at(2.02, 104.0)]
        assert [r.offset for r in decision._rivals(fits, best, 0)] == [2.001, 2.02]

    def test_chances_of_several_directions_are_multiplied(self, monkeypatch):
        """Each of two agrees by chance with a probability of 8 u / 2 pi = 0.0204: together 4.2e-4."""
        u = 0.016
        starts = tuple(Start(float(k), 0.0, 0.0) for k in range(3))
        variances = np.array([1e-6, u, u])
        covariance = np.diag(np.column_stack([np.ones(3), np.ones(3), variances]).ravel() ** 2)
        best = Solution(starts, covariance, 0.0, True, starts)
        monkeypatch.setattr(decision, "_solve", lambda *_, **__: best)
        assert decision._common_direction([None] * 3, best, common_rate=True)[0] == [0, 0, 0]
        two = Solution(starts[:2], covariance[:6, :6], 0.0, True, starts[:2])
        assert decision._common_direction([None] * 2, two, common_rate=True)[0] == [None, None]

    def test_the_speed_of_a_turn_is_that_at_the_middle_of_the_clip(self):
        """80 rad/s in the clip from 5 s to 7 s, at 6 s, and slower before and after."""
        casing = curve(0.0, 12.0, 260.0, angle=lambda t: 80.0 * t - 2.0 * (t - 6.0) ** 3)
        clip = curve(0.0, 2.0, 500.0)
        found = decision._next_turns(Pair(casing, clip, 4), start_at(5.0), start_at(5.0), 0)
        assert [r.offset for r in found] == pytest.approx([5.0 - TURN / 80.0, 5.0 + TURN / 80.0], abs=1e-3)


class TestSolution:
    """One clip, or two of one camera, in the window of the casing."""

    def pair(self, seed=3, offset=4.0, eps=1e-4):
        return Pair(curve(0.0, 10.0, 260.0, seed=1), clip_of(offset, eps, 0.7, seed=seed), 8)

    def test_a_clip_is_fitted_together_with_the_casing(self):
        """One least-squares problem of spline, harmonics of both cameras and their priors, without elimination."""
        pair, start = self.pair(), Start(4.0, 1e-4, 0.7)
        clip = replace(pair.clip, angle=pair.clip.angle + 4e-3 * np.sin(3.0 * pair.clip.angle))
        casing = casing_around(pair, start)
        record = pair.casing.between(*matching.window(*start.casing_times(clip.time[[0, -1]])))
        moment = start.casing_times(clip.time)
        splines, at_clip = casing.design(record.time), casing.design(moment)
        n, size = len(record.time), splines.shape[1]
        rows = np.zeros((n + len(moment), size + 8))
        rows[:n, :size], rows[n:, :size] = splines, at_clip
        rows[:n, size : size + 4], rows[n:, size + 4 :] = harmonics(record.angle), harmonics(clip.angle)
        rows[:n] /= record.sigma[:, None]
        rows[n:] /= clip.sigma[:, None]
        aim = np.concatenate(
            [
                (record.angle - casing.reference(record.time)) / record.sigma,
                (clip.angle + start.angle - casing.reference(moment)) / clip.sigma,
            ]
        )
        prior = np.diag(1 / np.array([1.0] * size + [0.02] * 8))

        def fitted(rows, aim):
            rows, aim = np.vstack([rows, prior]), np.append(aim, np.zeros(len(prior)))
            return aim - rows @ np.linalg.lstsq(rows, aim, rcond=None)[0]

        both, alone = fitted(rows, aim), fitted(rows[:n], aim[:n])
        found = normal(clip, start, casing)
        assert found.residual_casing == pytest.approx(both[:n], abs=1e-4)
        assert found.residual_clip == pytest.approx(both[n : len(aim)], abs=1e-4)
        assert found.chi2 == pytest.approx(both @ both - alone @ alone, rel=1e-4)
        assert np.abs(both[:n] - alone[:n]).max() > 0.05

    def test_the_covariance_is_the_inverse_of_the_curvature_with_priors(self):
        """1 / (5 s)^2 of the start and 1 / 1e-3^2 of the rate."""
        pair = self.pair()
        found = solve([pair], [Start(4.01, 0.0, 0.4)], rate_sigma=1e-3)
        curvature = normal(pair.clip, found.starts[0], casing_around(pair, found.windows[0])).matrix
        expected = np.linalg.inv(curvature + np.diag([1 / 25.0, 1e6, 0.0]))
        assert found.covariance == pytest.approx(expected, rel=0.02)

    def test_a_common_rate_is_equal_whatever_the_starts_are(self):
        pairs = [self.pair(seed=3, offset=3.0), self.pair(seed=4, offset=5.0)]
        starts = [Start(3.0, 3e-4, 0.7), Start(5.0, -2e-4, 0.7)]
        one = solve(pairs, starts, rate_sigma=1e-3)
        assert one.starts[0].eps == one.starts[1].eps
        two = solve(pairs, starts, rate_sigma=1e-3, common_rate=False)
        assert two.starts[0].eps != two.starts[1].eps
        assert two.chi2 < one.chi2 + 10.0

    def test_windows_are_those_that_are_given(self):
        pair, centre = self.pair(), (Start(4.05, 0.0, 0.0),)
        found = solve([pair], [Start(4.0, 1e-4, 0.7)], rate_sigma=1e-3, windows=centre)
        assert found.windows == centre
        away = (found.starts[0].offset - 4.05) / 5.0
        own = normal(pair.clip, found.starts[0], casing_around(pair, centre[0])).chi2
        assert found.chi2 == pytest.approx(own + away**2 + (found.starts[0].eps / 1e-3) ** 2, rel=1e-6)

    @pytest.mark.parametrize(("decrease", "converged"), [(0.99e-3, True), (1.01e-3, False)])
    def test_it_has_converged_if_chi_square_would_fall_by_less_than_a_thousandth(
        self, monkeypatch, decrease, converged
    ):
        here = matching._Combined(np.eye(3), np.array([math.sqrt(decrease), 0.0, 0.0]), 7.0)
        monkeypatch.setattr(matching, "_combined", lambda *_: here)
        monkeypatch.setattr(matching, "_line_search", lambda *_: None)
        found = solve([self.pair()], [Start(4.0, 0.0, 0.7)], rate_sigma=1e-3)
        assert (found.converged, found.chi2) == (converged, 7.0)

    def test_the_speed_is_that_of_a_motion_that_no_quartic_describes(self):
        casing = curve(0.0, 8.0, 260.0, angle=lambda t: 30.0 * t + 0.3 * np.sin(2.0 * t))
        fitted = matching.fit_casing(casing, (1.0, 7.0), 24)
        t = np.linspace(1.5, 6.5, 40)
        assert fitted.speed(t) == pytest.approx(30.0 + 0.6 * np.cos(2.0 * t), abs=0.02)


def test_a_jump_of_the_casing_is_left_out_of_its_curve():
    t = np.arange(300) / 100
    angle = psi(t) + 1e-4 * np.random.default_rng(0).standard_normal(300)
    angle[77] += 0.05
    found = casing_curve(recording("clip.mp4", 100.0, {"casing": body("casing", t, angle)}), "clip")
    assert t[77] not in found.time
    assert len(found.time) > 290


class TestSynchronise:
    def test_clips_are_matched_by_camera_and_returned_in_their_order(self, monkeypatch):
        grouped, told, halves = [], [], []
        clips = [curve(0.0, d, 100.0) for d in (1.0, 2.0, 1.0)]
        monkeypatch.setattr(decision, "survey", lambda casing, half: halves.append(half) or half)
        monkeypatch.setattr(decision, "prepare", lambda casing, record, clip, name: (name, record))
        monkeypatch.setattr(decision, "_match_camera", lambda members: grouped.append(members) or members)
        found = decision.match_clips(
            None, clips, ["a", "b", "c"], [1, 2, 1], lambda done, total: told.append((done, total))
        )
        assert grouped == [[("a", 0.5), ("c", 0.5)], [("b", 1.0)]]
        assert found == [("a", 0.5), ("b", 1.0), ("c", 0.5)]
        assert sorted(halves) == [0.5, 1.0]
        assert told == [(1, 3), (2, 3), (3, 3)]

    def test_clips_are_in_the_order_of_their_starts(self, monkeypatch):
        """The same size at another rate is another camera."""
        t, asked = np.arange(0.0, 2.0, 0.01), []

        def film(name, fps):
            return recording(
                name, fps, {"casing": body("casing", t, 30.0 * t), "rotor": body("rotor", t, 90.0 * t)}
            )

        def matched(casing, clips, names, cameras, progress):
            asked.extend(cameras)
            return [
                Match(n, Start(o, 0.0, 0.0), 1e-4, 1e-5, 1e-3, (), 0.0, 0, True, False, np.eye(3) * o)
                for n, o in zip(names, (9.0, 3.0), strict=True)
            ]

        monkeypatch.setattr(decision, "match_clips", matched)
        films = [film("casing.mp4", 260.0), film("late.mp4", 1000.0), film("early.mp4", 500.0)]
        found = decision.synchronise(films[0], films[1:], ["c", "l", "e"], I_rotor=1e-5, I_casing=1e-5)
        assert asked == [(1000.0, 640, 480), (500.0, 640, 480)]
        assert [m.name for m in found.matches] == ["l", "e"]
        assert [r.source for r in found.case.recordings.values()] == ["casing.mp4", "early.mp4", "late.mp4"]
        assert found.case.rotor.time[0] == pytest.approx(3.0)
        assert found.case.placements["rotor_1"].clock_offset == 9.0
        assert found.case.extra["sync_covariance"]["rotor_0"][0][0] == 3.0

    def test_without_a_clip_there_is_no_case(self):
        with pytest.raises(UsageError, match="no rotor clip"):
            decision.synchronise(None, [], [], I_rotor=1.0, I_casing=1.0)
