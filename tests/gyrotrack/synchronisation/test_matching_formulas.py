"""Least squares for the start of a clip: exact curves, derivatives by differences, each threshold of the decision."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import block_diag

from gyrotrack import SyncError, UsageError
from gyrotrack.synchronisation import _decision as decision
from gyrotrack.synchronisation import _matching as matching
from gyrotrack.synchronisation._decision import Match, Motion, Rival, Survey, candidates, motion
from gyrotrack.synchronisation._matching import (
    TURN,
    CasingFit,
    Curve,
    Pair,
    Solution,
    Start,
    block_means,
    casing_around,
    casing_curve,
    harmonics,
    inliers,
    link_matrix,
    normal,
    solve,
    window,
    with_common_direction,
    without_outliers,
)
from tests.gyrotrack.synchronisation.conftest import body, recording


def psi(t):
    return 30.0 * t - 0.4 * t**2 + 0.02 * t**3


def curve(start, stop, rate, *, sigma=1e-3, angle=psi, seed=None):
    t = np.arange(start, stop, 1 / rate)
    noise = 0.0 if seed is None else sigma * np.random.default_rng(seed).standard_normal(len(t))
    return Curve(t, angle(t) + noise, np.full(len(t), sigma))


def clip_of(offset, eps, direction, *, duration=2.0, rate=500.0, seed=None):
    """A clip whose clock is t_A = offset + (1 + eps) t_B, and whose direction is psi_A = psi_B + direction."""
    return curve(0.0, duration, rate, angle=lambda s: psi(offset + (1 + eps) * s) - direction, seed=seed)


class TestCurves:
    def test_samples_between_two_times(self):
        found = curve(0.0, 1.0, 10.0).between(0.2, 0.5)
        assert found.time == pytest.approx([0.2, 0.3, 0.4, 0.5])
        assert found.duration == pytest.approx(0.3)
        assert found.scaled(3.0).sigma == pytest.approx(np.full(4, 3e-3))
        assert found.keep(np.array([True, False, False, True])).time == pytest.approx([0.2, 0.5])

    def test_selected_samples_keep_their_own_sigma(self):
        given = Curve(np.arange(4.0), 10.0 + np.arange(4.0), np.array([0.1, 0.2, 0.3, 0.4]))
        kept = given.keep(np.array([False, True, False, True]))
        assert [kept.time.tolist(), kept.angle.tolist()] == [[1.0, 3.0], [11.0, 13.0]]
        assert kept.sigma.tolist() == [0.2, 0.4]

    def test_the_clock_of_a_clip(self):
        assert Start(10.0, 0.5, 0.0).casing_times(np.array([0.0, 2.0])).tolist() == [10.0, 13.0]

    def test_harmonics_are_sines_and_cosines_of_one_and_two_turns(self):
        a = np.array([0.3, 2.0])
        assert harmonics(a) == pytest.approx(
            np.column_stack([np.sin(a), np.cos(a), np.sin(2 * a), np.cos(2 * a)])
        )

    @pytest.mark.parametrize(("size", "kept"), [(5.9, True), (6.1, False), (-5.9, True), (-6.1, False)])
    def test_outliers_are_beyond_six_robust_standard_deviations(self, size, kept):
        residual = np.append(np.tile([-1.0, 1.0], 50), size * 1.4826)
        assert inliers(residual)[-1] == kept
        assert inliers(residual)[:-1].all()

    @pytest.mark.parametrize(
        ("count", "blocks", "length"), [(600, 60, 10), (659, 65, 10), (90, 45, 2), (661, 60, 11)]
    )
    def test_means_of_blocks(self, count, blocks, length):
        means, found = block_means(np.arange(float(count)))
        assert (len(means), found) == (blocks, length)
        assert means[1] == pytest.approx(length + (length - 1) / 2)

    @pytest.mark.parametrize("size", [-0.05, 0.05])
    def test_a_jump_of_one_frame_is_left_out(self, size):
        t = np.arange(200) / 100
        angle = psi(t) + 1e-4 * np.random.default_rng(0).standard_normal(200)
        angle[77] += size
        found = without_outliers(Curve(t, angle, np.full(200, 1e-3)))
        assert t[77] not in found.time
        assert len(found.time) > 190
        exact = Curve(t, 3.0 * t, np.full(200, 1e-3))
        assert len(without_outliers(exact).time) >= 195

    @pytest.mark.parametrize(("size", "kept"), [(4.0, True), (-4.0, True), (9.0, False), (-9.0, False)])
    def test_a_jump_counts_in_standard_deviations_of_the_noise(self, size, kept):
        """Six of them about a running median, whose own error is one or two."""
        t, sigma = np.arange(400) / 100, 1e-4
        angle = 3.0 * t + sigma * np.random.default_rng(1).standard_normal(400)
        angle[177] = 3.0 * t[177] + size * sigma
        found = without_outliers(Curve(t, angle, np.full(400, sigma)))
        assert (t[177] in found.time) is kept

    @pytest.mark.parametrize(
        ("frames", "rate", "words"),
        [
            (59, 100.0, "in only 59 frames"),
            (60, 100.0, None),
            (60, 296.0, "in only 60 frames"),
            (60, 290.0, None),
        ],
    )
    def test_a_casing_needs_sixty_frames_and_a_fifth_of_a_second(self, frames, rate, words):
        t = np.arange(frames) / rate
        seen = recording("clip.mp4", rate, {"casing": body("casing", t, psi(t))})
        if words is None:
            assert len(casing_curve(seen, "clip").time) > 50
        else:
            with pytest.raises(SyncError, match=words):
                casing_curve(seen, "clip")

    def test_frames_without_angle_do_not_count(self):
        t = np.arange(70) / 100
        angle = psi(t)
        angle[:5] = np.nan
        track = replace(body("casing", t, angle), sigma=np.where(np.arange(70) < 15, 0.0, 1e-3))
        with pytest.raises(SyncError, match="in only 55 frames"):
            casing_curve(recording("clip.mp4", 100.0, {"casing": track}), "clip")
        with pytest.raises(SyncError, match="does not show the casing"):
            casing_curve(recording("clip.mp4", 100.0, {"rotor": track}), "clip")


class TestDirections:
    def test_clips_with_turns_have_a_common_direction(self):
        starts = [Start(0.0, 0.0, 1.0), Start(1.0, 0.0, 9.0), Start(2.0, 0.0, 5.0)]
        found = with_common_direction(starts, [1, None, 0])
        assert [s.angle for s in found] == pytest.approx([1.0, 9.0, 1.0 - TURN])

    def test_a_step_moves_every_clip(self):
        found = matching.moved([Start(1.0, 2.0, 3.0), Start(4.0, 5.0, 6.0)], np.arange(6.0) / 10)
        assert found == [Start(1.0, 2.1, 3.2), Start(4.3, 5.4, 6.5)]

    @pytest.mark.parametrize(
        ("common", "shared", "columns"),
        [
            (False, [False, False], 6),
            (True, [False, False], 5),
            (True, [True, True], 4),
            (False, [True, False], 6),
        ],
    )
    def test_common_parameters_have_one_column(self, common, shared, columns):
        link = link_matrix(common_rate=common, shared_angle=shared)
        assert link.shape == (6, columns)
        assert (link.sum(axis=1) == 1).all()
        assert (link[1] == link[4]).all() == common
        assert (link[2] == link[5]).all() == all(shared)
        assert (link[0] != link[3]).any()


class TestWindow:
    def test_it_reaches_a_clip_beyond_both_ends(self):
        assert window(10.0, 12.0) == (8.0, 14.0)

    def test_spline_and_speed_follow_the_casing(self):
        fitted = matching.fit_casing(curve(0.0, 8.0, 260.0), (1.0, 7.0), 8)
        t = np.linspace(1.0, 7.0, 50)
        size = len(fitted.best) - matching.HARMONICS
        found = fitted.design(t) @ fitted.best[:size] + fitted.reference(t)
        assert found == pytest.approx(psi(t), abs=2e-4)
        assert fitted.speed(t) == pytest.approx(30.0 - 0.8 * t + 0.06 * t**2, abs=5e-3)
        assert np.abs(fitted.residual).max() < 0.2
        for outside in (0.99, 7.01):
            with pytest.raises(np.linalg.LinAlgError):
                fitted.design(np.sort(np.array([3.0, outside])))

    @pytest.mark.parametrize(("count", "enough"), [(10, True), (9, False)])
    def test_a_spline_needs_ten_samples(self, count, enough):
        few = curve(0.0, 8.0, 260.0).between(3.0, 3.0 + (count - 0.5) / 260.0)
        assert len(few.time) == count
        if enough:
            matching.fit_casing(few, (3.0, 3.2), 1)
        else:
            with pytest.raises(np.linalg.LinAlgError, match="too few"):
                matching.fit_casing(few, (3.0, 3.2), 1)

    def test_harmonics_have_a_prior_of_a_fiftieth_and_the_spline_of_one(self):
        casing = curve(0.0, 8.0, 260.0)
        fitted = matching.fit_casing(casing, (1.0, 7.0), 8)
        free = fitted.rows.T @ fitted.rows
        prior = np.diag(fitted.information - free)
        assert prior == pytest.approx([1.0] * (len(prior) - 4) + [2500.0] * 4, rel=1e-4)


class TestNormal:
    """chi2 of one clip and its derivatives."""

    def pair(self, seed=3):
        return Pair(curve(0.0, 10.0, 260.0, seed=1), clip_of(4.0, 1e-4, 0.7, seed=seed), 8)

    @pytest.mark.parametrize("place", [0, 1, 2])
    def test_the_gradient_is_that_of_chi_square(self, place):
        pair = self.pair()
        start = Start(4.0 + 2e-4, 0.0, 0.7 - 1e-3)
        casing = casing_around(pair, start)
        step = np.zeros(3)
        step[place] = (1e-5, 1e-5, 1e-5)[place]
        values = [
            normal(pair.clip, matching.moved([start], sign * step)[0], casing).chi2 for sign in (1, 0, -1)
        ]
        here = normal(pair.clip, start, casing)
        slope = (values[0] - values[2]) / (2 * step[place])
        assert here.gradient[place] == pytest.approx(-0.5 * slope, rel=2e-3)
        curvature = (values[0] - 2 * values[1] + values[2]) / step[place] ** 2
        assert here.matrix[place, place] == pytest.approx(0.5 * curvature, rel=0.02)

    def test_spline_and_harmonics_are_fitted_jointly_with_their_priors(self):
        """A clip with errors once a turn that exceed their prior of a fiftieth."""
        pair, start = self.pair(), Start(4.0, 1e-4, 0.7)
        clip = replace(pair.clip, angle=pair.clip.angle + 0.1 * np.sin(pair.clip.angle))
        casing = casing_around(pair, start)
        moment = start.casing_times(clip.time)
        design = casing.design(moment)
        size = design.shape[1]
        left = clip.angle + start.angle - casing.reference(moment) - design @ casing.best[:size]
        rows = np.hstack([design, np.zeros((len(left), 4)), harmonics(clip.angle)]) / clip.sigma[:, None]
        information = np.linalg.cholesky(casing.information).T
        stacked = np.vstack([rows, block_diag(information, np.eye(4) / 0.02)])
        aim = np.concatenate([left / clip.sigma, np.zeros(len(stacked) - len(left))])
        best = np.linalg.lstsq(stacked, aim, rcond=None)[0]
        found = normal(clip, start, casing)
        assert found.chi2 == pytest.approx(np.sum((aim - stacked @ best) ** 2))
        assert found.residual_clip == pytest.approx((aim - stacked @ best)[: len(left)], abs=1e-4)
        assert found.chi2 > len(left) + 4.0

    def test_residuals_are_those_of_the_joint_fit(self):
        pair = self.pair()
        casing = casing_around(pair, Start(4.0, 1e-4, 0.7))
        found = normal(pair.clip, Start(4.0, 1e-4, 0.7), casing)
        for residual in (found.residual_clip, found.residual_casing):
            assert np.sqrt(np.mean(residual**2)) == pytest.approx(1.0, abs=0.1)
        assert found.chi2 == pytest.approx(len(pair.clip.time), rel=0.15)

    @pytest.mark.parametrize(("offset", "eps", "direction"), [(4.0, 1e-4, 0.7), (3.0, -3e-4, -2.0)])
    def test_the_solution_is_that_of_the_truth(self, offset, eps, direction):
        clip = clip_of(offset, eps, direction, seed=5)
        pair = Pair(curve(0.0, 10.0, 260.0, seed=1), clip, 8)
        found = solve([pair], [Start(offset + 0.01, 0.0, direction - 0.3)], rate_sigma=1e-3)
        assert found.converged
        (start,), sigma = found.starts, found.sigma(0)
        for value, true, u in zip(
            (start.offset, start.eps, start.angle), (offset, eps, direction), sigma, strict=True
        ):
            assert abs(value - true) < 4 * u
        assert sigma[0] < 5e-3

    def test_a_prior_of_the_rate_and_of_the_start(self):
        """chi2 of the priors alone: eps^2 / s^2 once for a common rate, the start within 5 s of its window."""
        pair = self.pair()
        starts = [Start(4.0, 2e-3, 0.7), Start(4.1, 2e-3, 0.7)]
        parts = [
            matching._Part(pair.clip, casing_around(pair, s), replace(s, offset=s.offset - 0.5))
            for s in starts
        ]
        own = [normal(p.clip, s, p.casing) for p, s in zip(parts, starts, strict=True)]
        for common, count in ((True, 1), (False, 2)):
            link = link_matrix(common_rate=common, shared_angle=[False, False])
            found = matching._combined(parts, starts, 1e-3, link)
            prior = found.chi2 - sum(n.chi2 for n in own)
            assert prior == pytest.approx(count * 4.0 + 2 * 0.01, abs=1e-5)
            # half of the derivative of -(eps / s)^2 and of -(0.5 / 5)^2, and half of the second one of their negatives
            share = count / 2
            prior = np.tile([-0.5 / 25.0, -share * 2e-3 * 1e6, 0.0], 2)
            gradient = link.T @ (np.concatenate([n.gradient for n in own]) + prior)
            assert found.gradient == pytest.approx(gradient)
            curvature = np.diag(np.tile([1 / 25.0, share * 1e6, 0.0], 2))
            matrix = link.T @ (block_diag(*(n.matrix for n in own)) + curvature) @ link
            assert found.matrix == pytest.approx(matrix)

    def test_unknown_variances_are_infinite(self):
        covariance = np.diag([4.0, 0.0, -1.0, 9.0, 16.0, 25.0])
        found = Solution((), covariance, 0.0, True, ())
        assert found.sigma(0).tolist() == [2.0, math.inf, math.inf]
        assert found.sigma(1).tolist() == [3.0, 4.0, 5.0]

    @pytest.mark.parametrize(("fails", "length"), [(0, 1.0), (1, 1 / 3), (5, 3.0**-5), (6, None)])
    def test_a_step_is_reduced_until_chi_square_falls(self, monkeypatch, fails, length):
        tried = []

        def combined(parts, point, rate_sigma, link):
            tried.append(point[0].offset)
            if len(tried) <= fails:
                if len(tried) % 2:
                    raise np.linalg.LinAlgError
                return SimpleNamespace(chi2=11.0)
            return SimpleNamespace(chi2=9.0)

        monkeypatch.setattr(matching, "_combined", combined)
        found = matching._line_search([], [Start(0.0, 0.0, 0.0)], np.array([0.1, 0.0, 0.0]), 10.0, 1e-3, None)
        assert (found is None) is (length is None)
        if length is not None:
            assert found[0][0].offset == pytest.approx(0.1 * length)

    def test_a_step_is_at_most_three_tenths_of_a_second(self, monkeypatch):
        monkeypatch.setattr(matching, "_combined", lambda *_: SimpleNamespace(chi2=0.0))
        point = [Start(0.0, 0.0, 0.0), Start(1.0, 0.0, 0.0)]
        step = np.array([0.1, 0.0, 2.0, -0.6, 0.0, 0.0])
        (first, second), _ = matching._line_search([], point, step, 1.0, 1e-3, None)
        assert (first.offset, first.angle, second.offset) == pytest.approx((0.05, 1.0, 0.7))


class TestMotion:
    def test_speed_acceleration_and_jerk(self):
        found = motion(curve(3.0, 5.0, 400.0, sigma=1e-4), 4.0)
        assert found.value == pytest.approx([30.0 - 3.2 + 0.96, -0.8 + 0.48, 0.12], abs=2e-3)
        errors = np.sqrt(np.diag(found.covariance))
        # of a cubic over 2 s with 800 samples of 0.1 mrad: sqrt(75 / 4 N) s for the speed at the middle
        assert errors[0] == pytest.approx(math.sqrt(18.75 / 800) * 1e-4, rel=0.1)

    @pytest.mark.parametrize(("count", "enough"), [(24, True), (23, False)])
    def test_it_needs_24_samples(self, count, enough):
        t = np.linspace(0.0, 1.0, count)
        assert (motion(Curve(t, psi(t), np.full(count, 1e-3)), 0.5) is not None) is enough

    def test_excess_scatter_enlarges_the_covariance(self):
        noisy, quiet = (curve(3.0, 5.0, 400.0, sigma=s, seed=2) for s in (1e-3, 1e-3))
        large = replace(noisy, angle=psi(noisy.time) + 3 * (noisy.angle - psi(noisy.time)))
        ratio = np.diag(motion(large, 4.0).covariance) / np.diag(motion(quiet, 4.0).covariance)
        assert ratio == pytest.approx(np.full(3, 9.0), rel=0.2)

    @pytest.mark.parametrize(("duration", "half"), [(2.0, 1.0), (2.44, 1.2), (9.0, 1.5), (0.06, 0.03)])
    def test_half_the_length_of_a_clip(self, duration, half):
        t = np.linspace(0.0, duration, 10)
        assert decision.half_length(Curve(t, t, t)) == pytest.approx(half)

    def test_the_start_is_where_the_motion_is_the_same(self):
        casing, clip = curve(0.0, 20.0, 260.0), clip_of(7.3, 0.0, 0.4)
        survey = decision.survey(casing, 1.0)
        assert np.diff(survey.moments) == pytest.approx(np.full(len(survey.moments) - 1, 0.1))
        assert candidates(survey, clip)[0] == pytest.approx(7.3, abs=0.03)

    def test_a_survey_leaves_out_gaps(self):
        casing = curve(0.0, 20.0, 260.0)
        gap = casing.keep((casing.time < 8.0) | (casing.time > 12.0))
        moments = decision.survey(gap, 0.5).moments
        assert not ((moments > 8.1) & (moments < 11.9)).any()
        assert ((moments > 7.0) & (moments < 8.0)).any()

    def test_clock_rates_widen_the_match_by_their_powers(self):
        """A clip whose clock is off by r has a speed of r, an acceleration of r^2, a jerk of r^3."""
        moments = np.arange(0.0, 4.0, 0.5)
        tiny = np.eye(3) * 1e-20
        theirs = tuple(Motion(np.array([100.0, 40.0, 30.0]) + 0.0 * m, tiny) for m in moments)
        record = Survey(1.0, moments, theirs)
        away = np.array([0.1, 0.08, 0.09])  # exactly one standard deviation of the rate

        def distance(difference):
            mine = Motion(theirs[0].value + difference, tiny)
            seen = []
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(decision, "motion", lambda *_: mine)
                patch.setattr(decision, "_minima", lambda d: seen.append(d) or [])
                candidates(record, curve(0.0, 1.0, 100.0))
            return seen[0][0]

        rate = 1e-3 * np.array([100.0, 80.0, 90.0])
        covariance = np.diag([0.02, 0.02, 0.05]) ** 2 + np.outer(rate, rate)
        for difference in (away, -away, np.array([0.0, 0.1, 0.0])):
            assert distance(difference) == pytest.approx(
                difference @ np.linalg.solve(covariance, difference), rel=1e-6
            )


class TestMinima:
    def found(self, *values):
        return decision._minima(np.array(values, dtype=float))

    def test_lowest_first_within_the_threshold(self):
        far = [500.0] * 70
        assert self.found(5.0, *far, 1.0, *far, 100.9, *far, 101.1, *far) == [71, 0, 142]

    def test_neighbours_are_one_minimum(self):
        """0.3 s are 60 steps of 5 ms."""
        for apart, count in ((60, 1), (61, 2)):
            values = np.full(200, 500.0)
            values[20], values[20 + apart] = 1.0, 2.0
            assert len(decision._minima(values)) == count

    def test_there_are_at_most_five(self):
        values = np.full(1000, 50.0)
        values[50::100] = np.arange(10.0, 20.0)
        assert decision._minima(values) == [50, 150, 250, 350, 450]

    def test_ends_and_plateaus(self):
        assert self.found(1.0, 2.0, 3.0) == [0]
        assert self.found(3.0, 2.0, 1.0) == [2]
        assert self.found(5.0, 1.0, 1.0, 5.0) == [2]


def start_at(offset, chi2=0.0, sigma=1e-4, eps=0.0, angle=0.0):
    covariance = np.diag([sigma, 1e-5, 1e-3]) ** 2
    return Solution((Start(offset, eps, angle),), covariance, chi2, True, ())


class TestDistinct:
    def found(self, monkeypatch, solutions, *, clip=100):
        remaining = iter(solutions)
        monkeypatch.setattr(decision, "_is_covered", lambda pair, start: True)
        monkeypatch.setattr(decision, "_refine", lambda pair, start, limit: next(remaining))
        pair = SimpleNamespace(clip=SimpleNamespace(time=np.zeros(clip)))
        return [s.starts[0].offset for s in decision._distinct(pair, [None] * len(solutions))]

    def test_equal_starts_are_one_and_the_best_is_first(self, monkeypatch):
        """Within 1 ms and a tenth of the uncertainty."""
        solutions = [
            start_at(1.0, 50.0),
            start_at(2.0, 10.0),
            None,
            start_at(2.0009, 11.0),
            start_at(2.0012, 12.0),
        ]
        assert self.found(monkeypatch, solutions) == [2.0, 2.0012, 1.0]
        wide = [start_at(2.0, 10.0, sigma=0.01), start_at(2.0019, 11.0), start_at(2.0021, 12.0)]
        assert self.found(monkeypatch, wide) == [2.0, 2.0021]

    @pytest.mark.parametrize("limit", [None, 0.3])
    def test_the_limit_of_the_rate_is_passed_on(self, monkeypatch, limit):
        limits = []
        monkeypatch.setattr(decision, "_is_covered", lambda pair, start: True)
        monkeypatch.setattr(decision, "_refine", lambda pair, start, limit: limits.append(limit))
        pair = SimpleNamespace(clip=SimpleNamespace(time=np.zeros(9)))
        decision._distinct(pair, [None], *(() if limit is None else (limit,)))
        assert limits == [5e-3 if limit is None else limit]

    @pytest.mark.parametrize(("chi2", "kept"), [(219.0, True), (221.0, False)])
    def test_poor_solutions_are_dropped(self, monkeypatch, chi2, kept):
        """100 (1 + 60 / 100) + 60 = 220."""
        assert len(self.found(monkeypatch, [start_at(1.0, 100.0), start_at(5.0, chi2)])) == 1 + kept

    @pytest.mark.parametrize(
        ("eps", "finite", "covered", "kept"),
        [
            (4.9e-3, True, True, True),
            (-5.1e-3, True, True, False),
            (5.1e-3, True, True, False),
            (0.0, False, True, False),
            (0.0, True, False, False),
        ],
    )
    def test_a_solution_is_within_the_record_with_a_possible_rate(
        self, monkeypatch, eps, finite, covered, kept
    ):
        found = start_at(1.0, eps=eps)
        if not finite:
            found = replace(found, covariance=np.full((3, 3), np.nan))
        monkeypatch.setattr(decision, "solve", lambda *_, **__: found)
        monkeypatch.setattr(decision, "_is_covered", lambda *_: covered)
        assert (decision._refine(None, None, decision.RATE_LIMIT) is not None) is kept

    def test_a_solution_outside_of_the_record_is_none(self, monkeypatch):
        def failing(*_, **__):
            raise np.linalg.LinAlgError

        monkeypatch.setattr(decision, "solve", failing)
        assert decision._refine(None, None, 1.0) is None

    @pytest.mark.parametrize(("first", "covered"), [(-0.9, True), (-1.1, False), (9.1, False), (8.9, True)])
    def test_half_of_a_clip_must_be_in_the_record(self, first, covered):
        pair = Pair(curve(0.0, 10.0, 200.0), curve(0.0, 2.0, 500.0), 4)
        assert decision._is_covered(pair, Start(first, 0.0, 0.0)) is covered

    def test_the_initial_direction_is_the_difference_at_the_middle(self):
        found = decision._initial_value(curve(0.0, 10.0, 260.0), clip_of(4.0, 0.0, 0.7), 4.0)
        assert (found.offset, found.eps) == (4.0, 0.0)
        assert found.angle == pytest.approx(0.7, abs=1e-3)


class TestPrepared:
    def prepared(self, monkeypatch, *, misfit=0.0, first=1, later=1):
        calls = []

        def distinct(pair, starts, rate_limit=None):
            calls.append(rate_limit)
            return [start_at(1.0)] * (first if len(calls) == 1 else later)

        monkeypatch.setattr(decision, "candidates", lambda *_: [1.0])
        monkeypatch.setattr(decision, "_initial_value", lambda *_: None)
        monkeypatch.setattr(decision, "_is_covered", lambda *_: True)
        monkeypatch.setattr(decision, "_distinct", distinct)
        monkeypatch.setattr(decision, "_calibrated", lambda pair, start: (pair, 3))
        monkeypatch.setattr(decision, "_residuals", lambda *_: None)
        monkeypatch.setattr(decision, "_misfit", lambda *_: misfit)
        both = curve(0.0, 2.0, 100.0)
        return calls, decision.prepare(both, None, both, "clip")

    def test_noise_is_calibrated_twice(self, monkeypatch):
        calls, found = self.prepared(monkeypatch)
        assert found.rejected == 6
        assert len(calls) == 3
        assert calls[0] == pytest.approx(0.05)  # a coarse first search
        assert calls[1:] == [None, None]

    @pytest.mark.parametrize(("misfit", "refused"), [(0.0149, False), (0.0151, True)])
    def test_cameras_that_differ_are_of_two_runs(self, monkeypatch, misfit, refused):
        if refused:
            with pytest.raises(SyncError, match="differs by 15 mrad"):
                self.prepared(monkeypatch, misfit=misfit)
        else:
            assert self.prepared(monkeypatch, misfit=misfit)[1].misfit == misfit

    @pytest.mark.parametrize("lost", [{"first": 0}, {"later": 0}])
    def test_without_a_start_the_clip_is_refused(self, monkeypatch, lost):
        with pytest.raises(SyncError, match="no part of the record"):
            self.prepared(monkeypatch, **lost)


def test_the_misfit_is_the_rms_of_means_beyond_their_noise():
    """Blocks of ten with means of +-2 and a scatter of 1: 4 + 1/10 - (4 + 1) / 10, of each camera."""
    rng = np.random.default_rng(0)
    white = rng.standard_normal((60, 10))
    white = (white - white.mean(axis=1, keepdims=True)) / white.std(axis=1, keepdims=True)
    residual = (white + 2.0 * np.where(np.arange(60) % 2, 1, -1)[:, None]).ravel()
    left = SimpleNamespace(residual_casing=residual, residual_clip=np.tile([1.0, -1.0], 300))
    pair = SimpleNamespace(
        casing=SimpleNamespace(sigma=np.full(3, 1e-3)), clip=SimpleNamespace(sigma=np.full(3, 2e-3))
    )
    expected = (4.0 - 0.5) * 1e-6 + (0.0 - 0.1) * 4e-6
    assert decision._misfit(left, pair) == pytest.approx(math.sqrt(expected))
    left.residual_casing = np.tile([1.0, -1.0], 300)
    assert decision._misfit(left, pair) == 0.0


class TestCalibration:
    def test_sigmas_become_those_of_the_residuals(self):
        """The casing's noise is twice, the clip's half of what is stated."""
        casing, clip = curve(0.0, 10.0, 260.0, sigma=2e-3, seed=1), clip_of(4.0, 0.0, 0.7, seed=2)
        pair = Pair(replace(casing, sigma=casing.sigma / 2), replace(clip, sigma=2 * clip.sigma), 8)
        found, rejected = decision._with_calibrated_noise(pair, Start(4.0, 0.0, 0.7))
        assert rejected == 0
        assert np.median(found.casing.sigma) == pytest.approx(2e-3, rel=0.08)
        assert np.median(found.clip.sigma) == pytest.approx(1e-3, rel=0.08)

    def test_slow_errors_enlarge_the_sigmas_by_the_root_of_their_variance(self, monkeypatch):
        asked = []

        def slow(time, rows, residual, period):
            asked.append((len(time), len(rows), len(residual), period))
            return (9.0, 4.0)[len(asked) - 1]

        monkeypatch.setattr(decision, "slow_variance", slow)
        casing, clip = curve(0.0, 10.0, 260.0, seed=1), clip_of(4.0, 0.0, 0.7, seed=2)
        found = decision._with_slow_noise(Pair(casing, clip, 8), Start(4.0, 0.0, 0.7))
        assert found.casing.sigma == pytest.approx(3 * casing.sigma)
        assert found.clip.sigma == pytest.approx(2 * clip.sigma)
        edges = window(4.0, 4.0 + clip.duration)
        count = len(casing.between(*edges).time)
        assert asked == [(count,) * 3 + (clip.duration,), (len(clip.time),) * 3 + (clip.duration,)]

    def test_outliers_of_both_cameras_are_left_out(self):
        casing, clip = curve(0.0, 10.0, 260.0, seed=1), clip_of(4.0, 0.0, 0.7, seed=2)
        casing.angle[1100] += 0.02
        casing.angle[100] += 0.02  # outside of the window
        clip.angle[[10, 500]] -= 0.02
        found, rejected = decision._with_calibrated_noise(Pair(casing, clip, 8), Start(4.0, 0.0, 0.7))
        assert rejected == 3
        assert casing.time[1100] not in found.casing.time
        assert casing.time[100] in found.casing.time
        assert len(found.clip.time) == len(clip.time) - 2

    def test_the_spline_has_twice_the_intervals_of_least_bic(self, monkeypatch):
        """Block means of variance 1 up to eight intervals, and of 1 / 4 from there on."""

        def residuals(pair, start):
            size = 1.0 if pair.intervals < 8 else 0.5
            means = size * np.tile([1.0, -1.0], 15)
            return SimpleNamespace(residual_clip=np.repeat(means, 4), residual_casing=np.repeat(means, 4))

        monkeypatch.setattr(decision, "_residuals", residuals)
        monkeypatch.setattr(decision, "_with_calibrated_noise", lambda pair, start: (pair, 2))
        monkeypatch.setattr(decision, "_with_slow_noise", lambda pair, start: pair)
        pair, rejected = decision._calibrated(Pair(None, None, 4), None)
        assert (pair.intervals, rejected) == (16, 2)


class TestRivals:
    def match(self, sigma=5e-4, rivals=()):
        return Match(
            "clip", Start(1.0, 1e-4, 7.0), sigma, 1e-5, 1e-3, tuple(rivals), 0.0, 0, True, False, np.eye(3)
        )

    @pytest.mark.parametrize(
        ("sigma", "delta", "ambiguous"),
        [(0.9e-3, 26.0, False), (1.1e-3, 26.0, True), (0.9e-3, 24.0, True)],
    )
    def test_a_start_is_ambiguous_with_a_rival_or_a_large_uncertainty(self, sigma, delta, ambiguous):
        assert (
            self.match(sigma, [Rival(2.0, 99.0, "stretch"), Rival(3.0, delta, "turn")]).ambiguous is ambiguous
        )

    def test_the_method_says_what_is_common(self):
        assert self.match().method == "casing angle in both cameras, one clock rate for all clips"
        both = replace(self.match(), common_rate=False, common_direction=True)
        assert both.method == "casing angle in both cameras, one direction for all clips"

    def test_rivals_are_other_starts_with_their_rise_of_chi_square(self):
        best = start_at(1.0, 100.0)
        fits = [
            best,
            start_at(1.0009, 101.0),
            start_at(1.5, 130.0),
            start_at(1.503, 120.0),
            start_at(0.4, 110.0),
        ]
        found = decision._rivals(fits, best, 0)
        assert [(r.offset, r.delta_chi2, r.kind) for r in found] == [
            (0.4, 10.0, "stretch"),
            (1.503, 20.0, "stretch"),
        ]

    def test_combinations_are_sorted_and_limited(self):
        def clip(*chi2):
            return SimpleNamespace(solutions=[start_at(10 * i, c) for i, c in enumerate(chi2)])

        found = decision._combinations([clip(0.0, 5.0, 61.0), clip(0.0, 3.0)])
        assert [tuple(s.offset for s in combo) for combo in found] == [(0, 0), (0, 10), (10, 0), (10, 10)]
        many = [clip(*np.arange(5.0)) for _ in range(3)]
        assert len(decision._combinations(many)) == 64

    def test_the_next_turns_are_a_period_away(self):
        """At 20 rad/s a turn takes 0.314 s; the fit without common direction is at 5.002 s, with 10 ms."""
        casing = curve(0.0, 10.0, 260.0, angle=lambda t: -20.0 * t)
        clip = curve(0.0, 2.0, 500.0)
        best, locked = start_at(5.002, sigma=0.01), start_at(5.0)
        found = decision._next_turns(Pair(casing, clip, 4), best, locked, 0)
        period = TURN / 20.0
        assert [r.offset for r in found] == pytest.approx([5.0 - period, 5.0 + period])
        expected = [((x - 0.002) ** 2 - 0.002**2) / 1e-4 for x in (-period, period)]
        assert [r.delta_chi2 for r in found] == pytest.approx(expected, rel=1e-6)
        assert {r.kind for r in found} == {"turn"}


class TestCommonDirection:
    def decided(self, monkeypatch, angles, sigmas, *, converged=True):
        """Clips with these directions [rad] and uncertainties; the locked solution keeps them."""
        count = len(angles)
        covariance = np.zeros((3 * count, 3 * count))
        for k, s in enumerate(sigmas):
            covariance[3 * k + 2, 3 * k + 2] = s**2
        starts = tuple(Start(float(k), 0.0, a) for k, a in enumerate(angles))
        best = Solution(starts, covariance, 0.0, True, ())
        asked = []

        def again(pairs, starts, *, common_rate, turns):
            asked.append(list(turns))
            return replace(best, converged=converged)

        monkeypatch.setattr(decision, "_solve", again)
        turns, solution = decision._common_direction([None] * count, best, common_rate=True)
        return turns, solution is best, asked

    def test_directions_that_agree_are_locked(self, monkeypatch):
        turns, own, asked = self.decided(
            monkeypatch, [0.5, 0.5 + 3 * TURN, 0.5005 - TURN], [1e-4, 2e-4, 1e-3]
        )
        assert turns == [0, 3, -1]
        assert not own
        assert asked == [[0, 3, None], [0, 3, -1]]  # the better known one first

    @pytest.mark.parametrize(("sigmas", "locked"), [(3.9, True), (4.1, False)])
    def test_a_difference_of_four_standard_uncertainties_is_another_direction(
        self, monkeypatch, sigmas, locked
    ):
        u = 1e-4 * math.sqrt(2)
        turns, _, _ = self.decided(monkeypatch, [0.0, TURN + sigmas * u, TURN], [1e-4, 1e-4, 1e-4])
        assert (turns[1] == 1) is locked
        assert turns[2] == 1

    @pytest.mark.parametrize(("u", "known"), [(0.62, True), (0.64, False)])
    def test_an_uncertain_direction_does_not_identify_the_turn(self, monkeypatch, u, known):
        turns, _, _ = self.decided(monkeypatch, [0.0, 0.0, 0.1], [1e-5, 1e-5, u])
        assert (turns[2] == 0) is known

    @pytest.mark.parametrize(("u", "locked"), [(7.7e-4, True), (8.0e-4, False)])
    def test_an_agreement_by_chance_is_not_taken(self, monkeypatch, u, locked):
        """The probability that two directions agree within 4 u is 8 u / 2 pi: 0.001 at 0.785 mrad."""
        turns, own, _ = self.decided(monkeypatch, [0.0, 0.0], [u / 10, u * math.sqrt(0.99)])
        assert (turns == [0, 0]) is locked
        assert own is not locked
        assert locked or turns == [None, None]

    def test_without_convergence_nothing_is_locked(self, monkeypatch):
        turns, own, _ = self.decided(monkeypatch, [0.0, 0.0], [1e-5, 1e-5], converged=False)
        assert (turns, own) == ([None, None], True)

    def test_the_difference_of_two_directions(self):
        covariance = np.zeros((6, 6))
        covariance[2, 2], covariance[5, 5], covariance[2, 5], covariance[5, 2] = 4.0, 9.0, 3.0, 3.0
        solution = Solution((Start(0.0, 0.0, 1.0), Start(0.0, 0.0, 3.5)), covariance, 0.0, True, ())
        assert decision._difference(solution, 1, 0) == pytest.approx((2.5, math.sqrt(7.0)))


class TestCommonRate:
    @pytest.mark.parametrize(
        ("rise", "rate", "common"),
        [
            (15.0, 1e-3, True),
            (15.3, 1e-3, False),
            (15.3, 7.6e-4, True),
            (15.3, 7.7e-4, False),
            (0.5, 0.0, True),
        ],
    )
    def test_clocks_that_differ_significantly_have_their_own_rates(self, monkeypatch, rise, rate, common):
        """p = 1e-4 of one degree of freedom is 15.14; the rates, each +- 1e-4, must differ by 2e-4 + 4 u = 7.66e-4."""

        def solved(pairs, starts, *, common_rate, turns=None, windows=None):
            asked.append((common_rate, windows))
            chi2 = 100.0 + (rise if common_rate else 0.0)
            if not common_rate and len(starts) > 1:
                starts = [starts[0], replace(starts[1], eps=starts[0].eps + rate)]
            return Solution(tuple(starts), np.eye(3 * len(starts)) * 1e-8, chi2, True, tuple(starts))

        asked = []
        monkeypatch.setattr(decision, "_solve", solved)
        monkeypatch.setattr(
            decision, "_common_direction", lambda pairs, best, *, common_rate: ([None, None], best)
        )
        clips = [
            SimpleNamespace(name=n, pair=None, solutions=(start_at(o),), misfit=0.0, rejected=0)
            for n, o in (("a", 1.0), ("b", 5.0))
        ]
        found = decision._match_camera(clips)
        assert [m.common_rate for m in found] == [common] * 2
        # chi2 of the free rates is compared in the same windows
        assert asked[1] == (False, tuple(c.solutions[0].starts[0] for c in clips))
        assert [m.start.offset for m in found] == [1.0, 5.0]
        # what separate rates would describe better is in the uncertainties of a common rate
        widened = rise if common and rise > 1 else 1.0
        assert found[0].offset_sigma == pytest.approx(1e-4 * math.sqrt(widened))
        assert found[0].covariance == pytest.approx(1e-8 * widened * np.eye(3))
        (alone,) = decision._match_camera(clips[:1])
        assert not alone.common_rate


def test_a_joint_solution_has_the_prior_of_the_rate(monkeypatch):
    asked = []
    monkeypatch.setattr(decision, "solve", lambda *args, **options: asked.append((args, options)))
    decision._solve("pairs", "starts", common_rate=True, turns=[1], windows="windows")
    options = {"rate_sigma": 1e-3, "common_rate": True, "turns": [1], "windows": "windows"}
    assert asked == [(("pairs", "starts"), options)]


class TestCase:
    """What the rotor of a clip is on the clock of the casing, and what is doubtful."""

    def matched(self, name, start, *, sigma=5e-4, rivals=()):
        return Match(name, start, sigma, 1e-5, 1e-3, tuple(rivals), 0.0, 0, True, False, np.eye(3))

    def test_times_and_speeds_follow_the_clock(self):
        t = np.arange(0.0, 2.0, 0.01)
        track = body("rotor", t, 5.0 * t, omega=np.full(200, 5.0))
        track = replace(track, correlated_time=0.4, correlated_profile=((1.0, 2e-4),))
        found = decision._on_clock(track, self.matched("a", Start(10.0, 0.25, 1.0 + 2 * TURN)))
        assert found.correlated_time == pytest.approx(0.5)
        assert found.correlated_profile == ((11.25, 2e-4),)
        assert found.time == pytest.approx(10.0 + 1.25 * t)
        assert found.angle == pytest.approx(5.0 * t + 1.0)
        assert found.omega == pytest.approx(np.full(200, 4.0))
        assert found.omega_sigma == pytest.approx(track.omega_sigma / 1.25)

    def test_the_placement_of_a_clip(self):
        found = decision._placement("rotor_0", self.matched("a", Start(10.0, 1e-4, -1.0)))
        assert (found.clock_offset, found.clock_rate) == (10.0, 1.0001)
        assert found.angle_offset == pytest.approx(TURN - 1.0)
        assert (found.clock_offset_sigma, found.clock_rate_sigma, found.ambiguous) == (5e-4, 1e-5, False)

    def warned(self, *clips):
        matches = [m for m, _ in clips]
        return decision._warnings(matches, [b for _, b in clips], range(len(clips)))

    def clip(self, name, offset, omega, **options):
        t = np.arange(0.0, 2.0, 0.01)
        return self.matched(name, Start(offset, 0.0, 0.0), **options), body(
            "rotor", t, omega * t, omega=np.full(200, omega)
        )

    @pytest.mark.parametrize(
        ("later", "omega", "words"),
        [
            (3.0, 90.0, None),
            (3.0, 101.9, None),
            (3.0, 102.1, "faster in the later clip"),
            (1.9, 90.0, "overlap in time"),
            (2.0, 90.0, None),
        ],
    )
    def test_clips_that_overlap_or_speed_up(self, later, omega, words):
        found = self.warned(self.clip("a", 0.0, 100.0), self.clip("b", later, omega))
        assert len(found) == (words is not None)
        assert words is None or words in found[0]

    def test_uncertain_starts(self):
        rivals = [Rival(4.0, 24.0, "turn"), Rival(5.0, 26.0, "stretch")]
        (text,) = self.warned(self.clip("a", 0.0, 100.0, rivals=rivals))
        assert text == "a: ambiguous start, 0.000 s or 4.000 s (one turn of the casing away)"
        (text,) = self.warned(self.clip("a", 0.0, 100.0, sigma=2e-3))
        assert "the uncertainty of the start is 2.0 ms" in text
        assert self.warned(self.clip("a", 0.0, 100.0, sigma=0.9e-3)) == []

    @pytest.mark.parametrize(("rotor", "casing"), [(0.0, 1.0), (1.0, 0.0), (-1.0, 1.0)])
    def test_moments_of_inertia_are_positive(self, rotor, casing):
        with pytest.raises(UsageError, match="must be positive"):
            decision.synchronise(None, [None], [], I_rotor=rotor, I_casing=casing)

    def test_a_film_is_given_once(self):
        t = np.arange(100) / 100
        one = recording("a.mp4", 100.0, {"casing": body("casing", t, t)})
        with pytest.raises(SyncError, match="come from the same film"):
            decision._check_distinct_films([one, one], ["a", "b"])
        unknown = replace(one, source_sha256="")
        decision._check_distinct_films([unknown, unknown], ["a", "b"])


def test_a_design_outside_of_the_knots_is_refused():
    fitted = CasingFit(np.array([0.0, 1.0]), None, np.zeros(0), np.zeros((0, 0)), np.zeros(0), np.zeros(0))
    with pytest.raises(np.linalg.LinAlgError):
        fitted.design(np.array([-0.1, 0.5]))


@pytest.mark.parametrize("lost", ["angle", "time", "sigma"])
def test_samples_without_a_number_or_an_uncertainty_are_left_out(lost):
    time = 0.01 * np.arange(600)
    body = SimpleNamespace(time=time.copy(), angle=3.0 * time + 0.1 * np.sin(time), sigma=np.full(600, 1e-3))
    getattr(body, lost)[[10, 300]] = 0.0 if lost == "sigma" else np.nan
    found = casing_curve(SimpleNamespace(bodies={"casing": body}), "clip")
    assert len(found.time) == 598
    assert not np.isin(time[[10, 300]], found.time).any()
    assert np.isfinite([found.time, found.angle, found.sigma]).all()
