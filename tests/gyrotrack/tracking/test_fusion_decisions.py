"""Uncertainties of fused markers by hand-computed cases, frames without one, and markers of known scatter."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.tracking import _fusion as _fusion
from gyrotrack.tracking._fusion import KNOTS, TURN, join, place_error, variance_left, wrapped
from gyrotrack.tracking._marker_tracker import Candidate
from gyrotrack.tracking._orbit import CELL
from tests.gyrotrack.tracking.test_fusion_formulas import N, changed, state

S = 2e-3
BOTH = dict.fromkeys(("m0", "m1"), (S, S))


def share_left(angle):
    """Return the share of the variance of six equal harmonics that is left without their means."""
    means = [abs(np.mean(np.exp(1j * k * angle))) ** 2 for k in range(1, 7)]
    return 1.0 - np.mean(means)


class TestResult:
    """Two markers of equal scatter: sigma of their mean is S / sqrt(2)."""

    def result(
        self, monkeypatch, found, *, smooth=0.0, floor=0.0, axis=0.0, leverage=0.0, shares=(1.0, 1.0), alike=1.0,
        scale=1.0, tail=1.0, kept=1.0, alone=None,
    ):  # fmt: skip
        """Return the body, the residuals by which it was scaled, and what the share of the floor was asked for."""
        seen = SimpleNamespace(residuals=[], floors=[], tails=[])
        n = len(found.path)
        levers = np.broadcast_to(leverage, n).astype(float)
        monkeypatch.setattr(
            _fusion.Residuals, "smooth", lambda self, half, degree: (np.full(n, smooth), levers)
        )
        monkeypatch.setattr(_fusion, "scatter_over_turns", lambda given, *_: given.weights.scatter)
        monkeypatch.setattr(
            _fusion, "_variance_shares", lambda *_: (np.full(n, shares[0]), np.full(n, shares[1]))
        )
        monkeypatch.setattr(_fusion, "correlation_factor", lambda off: alike)
        monkeypatch.setattr(_fusion, "excess", lambda off: seen.residuals.append(off) or scale)
        monkeypatch.setattr(
            _fusion, "tail_factor", lambda off: seen.tails.append(off) or np.full(len(off), tail)
        )
        monkeypatch.setattr(_fusion, "share_of_floor", lambda *args: seen.floors.append(args) or kept)
        alone = np.zeros(n, dtype=bool) if alone is None else alone
        return _fusion._result(found, 30, 2, floor, axis, alone), seen

    @pytest.mark.parametrize(("rate", "least"), [(0.003, False), (1e-5, True)])
    def test_errors_that_no_turn_shows_are_added(self, monkeypatch, rate, least):
        """Errors by place without their mean over the arc, at least that over one place, and the axis."""
        found = state([0.01, 0.01], rate=rate, scatter=BOTH)
        body, seen = self.result(
            monkeypatch, found, smooth=1e-3, floor=6e-3, axis=2e-3, leverage=0.01, kept=0.5
        )
        own, of_place = share_left(found.path), share_left(np.linspace(0.0, CELL, KNOTS))
        assert (own < of_place) == least
        floor = 6e-3 * 0.5 * math.sqrt(max(own, of_place))
        assert body.sigma == pytest.approx(np.full(N, math.sqrt(S**2 / 2 + floor**2 + 4e-6)))
        assert body.markers["m1"].sigma == pytest.approx(np.full(N, math.sqrt(S**2 + floor**2 + 4e-6)))
        ((off, sigma, asked, places),) = seen.floors
        assert off == pytest.approx(np.full(N, 9e-3))
        assert sigma == pytest.approx(np.full(N, S / math.sqrt(2)))
        assert asked == 6e-3
        assert places == pytest.approx((N - 1) * rate / CELL - 0.01 * N)

    def test_leverages_beyond_one_and_frames_without_markers_absorb_no_place(self, monkeypatch):
        found = state(rate=0.003, scatter=BOTH)
        found = changed(found, use=dict.fromkeys(BOTH, np.arange(N) >= 10))
        levers = np.full(N, 0.01)
        levers[:20] = 5.0
        _, seen = self.result(monkeypatch, found, floor=6e-3, leverage=levers)
        assert seen.floors[0][3] == pytest.approx((N - 1) * 0.003 / CELL - 10 - 0.01 * (N - 20))

    def test_within_whole_turns_position_dependent_errors_are_known(self, monkeypatch):
        found = state([0.01, 0.01], rate=0.003, scatter=BOTH)
        found = changed(found, turning=np.arange(N) >= 100)
        body, seen = self.result(monkeypatch, found, floor=6e-3, axis=2e-3)
        assert body.sigma[100:] == pytest.approx(np.full(N - 100, S / math.sqrt(2)))
        assert (body.sigma[:100] > 2e-3).all()
        off = seen.floors[0][0]
        assert np.isnan(off[100:]).all()
        assert np.isfinite(off[:100]).all()

    def test_the_uncertainty_is_scaled_to_what_the_curves_leave_of_the_residuals(self, monkeypatch):
        """0.8 is left of the variance; the long curve absorbs (2 - 1) 0.1 more of correlated errors."""
        found = state([5e-3, 5e-3], rate=0.3, scatter=BOTH)
        found = changed(found, turning=True)
        body, seen = self.result(
            monkeypatch, found, smooth=1e-3, leverage=0.1, shares=(4.0, 0.8), alike=2.0, scale=1.5, tail=1.2
        )
        of_body, *of_markers = seen.residuals
        ratio = 4e-3 / S
        assert of_body == pytest.approx(np.full(N, ratio * math.sqrt(2) / math.sqrt(0.8 - 0.1)))
        for off in of_markers:
            assert off == pytest.approx(np.full(N, ratio / math.sqrt(0.8 - 0.1 / 2)))
        assert seen.tails[0] == pytest.approx(of_body / 1.5)
        # twice the error of the mean, times 1.5 and 1.2
        assert body.sigma == pytest.approx(np.full(N, 2.0 * S / math.sqrt(2) * 1.5 * 1.2))
        assert body.markers["m0"].sigma == pytest.approx(np.full(N, 2.0 * S * 1.5 * 1.2))

    @pytest.mark.parametrize(("share", "left"), [(0.9, 0.9), (0.2, 0.3), (1.4, 1.0)])
    def test_at_least_three_tenths_of_a_residual_are_left(self, monkeypatch, share, left):
        found = state([4e-3, 4e-3], rate=0.3, scatter=BOTH)
        found = changed(found, turning=True)
        _, seen = self.result(monkeypatch, found, shares=(1.0, share))
        assert seen.residuals[1] == pytest.approx(np.full(N, 2.0 / math.sqrt(left)))

    def test_residuals_outside_whole_turns_do_not_scale(self, monkeypatch):
        found = state([4e-3, 4e-3], rate=0.3, scatter=BOTH)
        found = changed(found, turning=np.arange(N) >= 50)
        _, seen = self.result(monkeypatch, found)
        assert np.isnan(seen.residuals[0][:50]).all()
        assert np.isfinite(seen.residuals[0][50:]).all()

    def test_the_times_are_common_to_the_markers(self, monkeypatch):
        """0.3 rad a frame and 0.01 frames: of a scatter of 5 mrad 4 mrad are left, which the mean reduces."""
        found = state(rate=0.3, scatter=dict.fromkeys(BOTH, (5e-3, 5e-3)))
        found = changed(
            replace(found, time_base=SimpleNamespace(sigma=0.01, speed=np.gradient)), turning=True
        )
        body, _ = self.result(monkeypatch, found)
        assert body.sigma == pytest.approx(np.full(N, math.hypot(4e-3 / math.sqrt(2), 3e-3)))
        assert body.markers["m0"].sigma == pytest.approx(np.full(N, 5e-3))

    def test_learnt_errors_are_not_in_the_angles_of_the_markers(self, monkeypatch):
        found = state([0.01, 0.0], rate=0.3, scatter=BOTH)
        found = changed(found, by_place={"m0": 7e-3}, by_neighbour={"m0": 1e-3})
        body, _ = self.result(monkeypatch, found)
        true = 0.3 * np.arange(N)
        assert wrapped(body.markers["m0"].angle - true) == pytest.approx(np.full(N, 2e-3), abs=1e-9)
        assert body.angle - true == pytest.approx(np.full(N, 1e-3), abs=1e-9)
        assert (body.markers["m1"].mount, body.count.tolist()) == (2.0, [2] * N)

    def test_frames_that_one_marker_or_a_poor_one_shows_have_no_angle(self, monkeypatch):
        """Three of which nothing confirms the angle; in the second both markers are seen."""
        found = state(rate=0.3, scatter=BOTH)
        k = np.arange(N)
        weak = dict.fromkeys(BOTH, np.where(k == 20, 20.0, 1.0))
        found = changed(found, use={"m0": ~np.isin(k, [5, 7, 9])}, weak=weak)
        alone = np.zeros(N, dtype=bool)
        alone[[5, 6, 7]] = True
        body, _ = self.result(monkeypatch, found, alone=alone)
        lost = [5, 7, 20]
        assert np.flatnonzero(np.isnan(body.angle)).tolist() == lost
        assert np.flatnonzero(np.isnan(body.sigma)).tolist() == lost
        assert np.flatnonzero(body.count == 0).tolist() == lost
        assert np.isnan(body.markers["m0"].angle[[5, 7, 9]]).all()


class TestRounds:
    def joined(self, monkeypatch, view, leverage=None, **options):
        """Return what the result is asked for, and the arguments of the fits of the view."""
        given, asked, views = state(), [], []
        view = view and _fusion.ViewErrors(dict.fromkeys(BOTH, np.zeros(N)), np.full(N, view))
        monkeypatch.setattr(_fusion, "errors_of_view", lambda found, *args: views.append(args) or view)
        monkeypatch.setattr(_fusion, "_result", lambda found, *args: asked.append((found, *args)))
        if leverage is not None:
            smooth = _fusion.Residuals.smooth
            monkeypatch.setattr(
                _fusion.Residuals,
                "smooth",
                lambda self, *window: (
                    smooth(self, *window)[0],
                    leverage if len(window) == 1 else leverage * 0.0,
                ),
            )
        join(given.path, given.candidates, 1000.0, **options)
        return asked[0], views

    @pytest.mark.parametrize(("view", "axis"), [(None, 0.05), (0.4, math.hypot(0.03, 0.4))])
    def test_errors_of_the_view_replace_those_of_the_orbits(self, monkeypatch, view, axis):
        arcs = {"m0": np.eye(2)}
        asked, views = self.joined(monkeypatch, view, floor=0.01, axis=0.03, orbit=0.04, arcs=arcs)
        assert asked[3:5] == (0.01, pytest.approx(axis))
        assert views == [(0.01, arcs)] * 6  # in five passes, and at last

    def test_frames_are_confirmed_by_others_up_to_nine_tenths(self, monkeypatch):
        leverage = np.full(N, 0.5)
        leverage[:3] = 0.89, 0.91, np.nan
        asked, _ = self.joined(monkeypatch, None, leverage)
        assert np.flatnonzero(asked[5]).tolist() == [1, 2]

    def test_a_large_misfit_makes_a_marker_less_certain(self, monkeypatch):
        """By sqrt(1 + share x); unoccluded and partly occluded observations have their own share."""
        found = state(1e-3 * np.random.default_rng(1).standard_normal((2, N)))
        c = found.candidates["m0"]
        excess, open_ = np.where(np.arange(N) % 3 == 0, 8.0, 0.0), np.arange(N) < 300
        c = replace(c, misfit_excess=excess, open=open_, weak=np.full(N, 2.0))
        found = replace(found, candidates=found.candidates | {"m0": c})
        shares = {300: 0.375, 100: 1.875}
        monkeypatch.setattr(_fusion, "variance_inflation", lambda off, excess: shares.get(len(off), 0.0))
        weights = _fusion.weights_about(found, np.zeros(N), np.zeros(N))
        expected = np.where(excess > 0, np.where(open_, 4.0, 8.0), 2.0)
        assert weights.weak["m0"] == pytest.approx(expected)

    def test_mounts_follow_the_residuals(self):
        found = state([0.01, -0.02])
        found = replace(found, mounts=_fusion.mount_angles(found, np.zeros(N)))
        assert found.residual("m1") == pytest.approx(found.residual("m0"), abs=1e-9)

    def test_the_curve_of_a_bent_path_is_that_of_its_angle(self):
        """A motion of which the path follows a part only: path and difference are the motion."""
        k = np.arange(N)
        motion = 0.3 * k + 2e-2 * np.sin(k / 25.0)
        found = state(rate=0.3, scatter=BOTH)
        path = 0.3 * k + 1e-2 * np.sin(k / 25.0)
        angle = {name: wrapped(motion + mount) for name, mount in found.mounts.items()}
        found = changed(replace(found, path=path, bend=path - 0.3 * k), angle=angle)
        fitted, _ = found.smooth(12)
        assert (found.path + fitted)[20:-20] == pytest.approx(motion[20:-20], abs=2e-4)


class TestLearning:
    """Errors by place of 4 mrad at three periods a turn, and beside another body at two periods."""

    def test_partly_occluded_observations_show_no_position_dependent_error(self):
        turn = 0.3 * np.arange(N)
        error = np.array([4e-3 * np.cos(3 * (turn + m)) for m in (0.0, 2.0)])
        hidden = np.arange(N) % 3 == 0
        found = state(error + 0.02 * hidden * np.sin(turn), scatter=dict.fromkeys(BOTH, (3e-4, 3e-4)))
        found = changed(found, open=dict.fromkeys(BOTH, ~hidden), turning=True)
        assert _fusion.errors_by_place(found, np.zeros(N)).error["m1"] == pytest.approx(error[1], abs=6e-4)

    @pytest.mark.parametrize(("other_rate", "fast"), [(0.38, True), (0.36, False)])
    def test_beside_a_slow_body_only_partly_occluded_observations_are_corrected(self, other_rate, fast):
        """80 and 60 rad/s beside 300 rad/s."""
        turn, other = 0.3 * np.arange(N), 1.0 + other_rate * np.arange(N)
        error = np.array([3e-3 * np.cos(2 * (turn + m - other)) for m in (0.0, 2.0)])
        found = state(error, scatter=dict.fromkeys(BOTH, (2e-4, 2e-4)))
        hidden = np.arange(N) % 3 == 0
        found = changed(found, open=dict.fromkeys(BOTH, ~hidden), turning=True)
        learnt = _fusion.errors_by_neighbour(
            found, np.zeros(N), other, (30, 2), above=False, last=False
        ).error["m1"]
        assert learnt[hidden] == pytest.approx(error[1][hidden], abs=5e-4)
        assert (np.abs(learnt[~hidden]).max() > 1e-3) is np.bool_(fast)

    @pytest.mark.parametrize(("last", "share"), [(False, 1.0), (True, 0.3)])
    def test_what_is_shown_counts_in_the_last_round(self, monkeypatch, last, share):
        turn, other = 0.3 * np.arange(N), 1.0 + 0.38 * np.arange(N)
        error = np.array([3e-3 * np.cos(2 * (turn + m - other)) for m in (0.0, 2.0)])
        found = state(error, scatter=dict.fromkeys(BOTH, (2e-4, 2e-4)))
        found = changed(found, turning=True)
        monkeypatch.setattr(_fusion, "_shown_share", lambda *_: 0.3)
        learnt = _fusion.errors_by_neighbour(found, np.zeros(N), other, (30, 2), above=False, last=last)
        assert learnt.error["m1"] == pytest.approx(share * error[1], abs=4e-4)


class TestVariances:
    @pytest.mark.parametrize("common_kept", [True, False])
    def test_what_markers_have_in_common_is_kept_in_the_angle(self, common_kept):
        """Two markers, motion and two curves: e - b dx with cov(e, dx) = C a var(e), b without the common harmonics."""
        n, motion, size = 150, 5, 2e-3
        found = state(n=n, rate=2.5 * TURN / n, scatter=dict.fromkeys(BOTH, (1e-3, 1e-3)))
        found = changed(found, turning=True, common_kept=common_kept, size=dict.fromkeys(BOTH, size))
        error, left = _fusion._variance_shares(found, motion)
        spline = _fusion._cubic_splines(n, motion)
        each = []
        for k, c in enumerate(found.candidates.values()):
            place = np.mod(c.angle, TURN) * KNOTS / TURN
            apart = np.abs((place[:, None] - np.arange(KNOTS) + KNOTS / 2) % KNOTS - KNOTS / 2)
            hats = np.zeros((n, 2 * KNOTS))
            hats[:, k * KNOTS : (k + 1) * KNOTS] = np.maximum(1 - apart, 0.0)
            each.append(np.hstack([spline, hats]))
        normal = sum(rows.T @ rows for rows in each) * 1e6
        normal[motion:, motion:] += np.kron(np.eye(2), _fusion._precision(size))
        covariance = np.linalg.inv(normal + 1e-9 * np.trace(normal) / len(normal) * np.eye(len(normal)))
        rows, noise = np.mean(each, axis=0), 0.5e-6
        absorbed = np.einsum("ni,ij,nj->n", rows, covariance, rows)
        assert left == pytest.approx(np.clip(1 - absorbed / noise, 0.1, 1), rel=1e-3)
        curves = np.hstack([np.zeros((n, motion)), rows[:, motion:]])
        if common_kept:
            curves[:, motion:] = curves[:, motion:] @ _fusion._without_common(found.mounts)

        def variance():
            return noise + np.einsum("ni,ij,nj->n", curves - 2 * rows, covariance, curves)

        for _ in range(2):
            curves -= np.average(curves, axis=0, weights=1 / np.maximum(variance(), 0.1 * noise))
        assert error == pytest.approx(np.maximum(variance() / noise, 0.1), rel=1e-3)


class TestView:
    """Errors of axis and tilt by the disagreement of two markers, as one linear model with a free motion."""

    def film(self, size, n=60):
        """Return markers over 1.5 rad with errors of axis and tilt, the second one twice as noisy and seen later."""
        k = np.arange(n)
        turn = 1.5 * k / n
        rng = np.random.default_rng(4)
        error = [
            size * (np.cos(turn + m) - 0.4 * np.sin(2 * (turn + m))) * sign + s * rng.standard_normal(n)
            for m, s, sign in ((0.0, 3e-4, 1.0), (2.0, 6e-4, -0.5))
        ]
        scatter = {"m0": (3e-4, 3e-4), "m1": (6e-4, 6e-4)}
        found = state(error, rate=1.5 / n, n=n, scatter=scatter)
        return changed(found, use={"m1": k >= 5}, by_neighbour={"m0": 1e-3 * np.sin(5.0 * turn)})

    def reference(self, found, floor, arcs):
        """Return the errors of the markers and the uncertainty of their mean, the motion being one unknown a frame."""
        names, n = list(found.candidates), len(found.path)
        alike = n / max(np.ptp(found.path) / CELL, 1.0)
        normal, right = np.zeros((n + 10, n + 10)), np.zeros(n + 10)
        normal[n + 8 :, n + 8 :] = np.eye(2)
        waves, weights = [], []
        for k, name in enumerate(names):
            a = found.candidates[name].angle
            waves.append(np.stack([np.cos(a), np.sin(a), np.cos(2 * a), np.sin(2 * a)], axis=1))
            rows = np.hstack([np.eye(n), np.zeros((n, 10))])
            rows[:, n + 4 * k : n + 4 * k + 4], rows[:, n + 8 + k] = waves[k], 1.0
            sigma = found.weights.scatter[name][0]
            y = wrapped(a - found.path - found.mounts[name] - found.neighbour.error[name])
            weight = found.weights.use[name] / (sigma**2 + alike * floor**2)
            normal += rows.T @ (weight[:, None] * rows)
            right += rows.T @ (weight * y)
            weights.append(found.weights.use[name] / sigma**2)
        offsets, unit = np.zeros((8, 8)), floor / math.sqrt(6.0)
        for k, name in enumerate(names):
            if name in arcs:
                (xx, xy), (_, yy) = arcs[name]
                # cos: e_y, sin: -e_x
                offsets[4 * k : 4 * k + 2, 4 * k : 4 * k + 2] = [[yy, -xy], [-xy, xx]]
        best = (-math.inf, None)
        for common in 2.0 ** np.arange(6):
            for own in 2.0 ** np.arange(6):
                sizes = (own * unit) ** 2 * np.eye(2) + (common * unit) ** 2
                prior = np.linalg.inv(np.kron(sizes, np.eye(4)) + offsets)
                full = normal.copy()
                full[n : n + 8, n : n + 8] += prior
                fit = right @ np.linalg.solve(full, right)
                evidence = 0.5 * (fit + np.linalg.slogdet(prior)[1] - np.linalg.slogdet(full)[1])
                best = max(best, (evidence, full), key=lambda one: one[0])
        covariance = np.linalg.inv(best[1])
        x = (covariance @ right)[n : n + 8]
        effect = np.hstack([w[:, None] * b for w, b in zip(weights, waves, strict=True)])
        effect /= sum(weights)[:, None]
        effect -= effect.mean(axis=0)
        own = covariance[n : n + 8, n : n + 8]
        return (
            [b @ x[4 * k : 4 * k + 4] for k, b in enumerate(waves)],
            np.sqrt(np.einsum("ni,ij,nj->n", effect, own, effect)),
        )

    @pytest.mark.parametrize(
        ("size", "arcs"),
        [
            (2e-3, {}),
            (20e-3, {}),
            (20e-3, {"m1": np.array([[4e-4, 1e-4], [1e-4, 1e-6]])}),
        ],
        ids=["small errors", "large errors", "an arc"],
    )
    def test_the_most_likely_sizes_of_errors_are_those_of_all_data(self, size, arcs):
        found = self.film(size)
        errors, uncertainty = self.reference(found, 1e-3, arcs)
        view = _fusion.errors_of_view(found, 1e-3, arcs)
        for name, expected in zip(found.candidates, errors, strict=True):
            assert view.error[name] == pytest.approx(expected, abs=2e-2 * np.abs(expected).max())
        assert view.sigma == pytest.approx(uncertainty, rel=2e-2, abs=1e-6)


class TestPlaces:
    @pytest.mark.parametrize(("places", "known"), [(35, False), (36, True)])
    def test_a_marker_must_be_seen_at_half_of_the_knots(self, places, known):
        found = state(rate=TURN / places, scatter=BOTH, mounts=(0.0,))
        error = 4e-3 * np.where(np.arange(N) % 2, 1, -1)
        angle = wrapped(TURN / KNOTS * (np.arange(N) % places))
        found = changed(found, angle={"m0": angle}, turning=True, by_place={"m0": error})
        assert math.isfinite(place_error(found)) is known

    def test_large_errors_at_few_places_are_not_those_of_the_others(self):
        """One of ten frames errs by 50 mrad, the others by 3 mrad: 1.4826 times their median."""
        found = state(scatter=BOTH, mounts=(0.0,))
        error = 3e-3 * np.where(np.arange(N) % 2, 1, -1)
        error[::10] = 0.05
        found = changed(found, turning=True, by_place={"m0": error})
        assert place_error(found) == pytest.approx(1.4826 * 3e-3, rel=0.1)


def test_markers_are_joined_with_the_times_of_their_frames(monkeypatch):
    class StoppedError(Exception):
        pass

    def of(*given):
        raise StoppedError(*given)

    monkeypatch.setattr(_fusion.Residuals, "of", of)
    coarse = np.zeros(5)
    with pytest.raises(StoppedError) as error:
        join(coarse, {"red": 1}, 50.0, time_base="times")
    assert error.value.args == (coarse, {"red": 1}, 50.0, "times")


FRAMES = 1500
MOUNTS = {"blue": 0.0, "white": 2.1, "green": -2.0}
SCATTER = {"blue": 2e-3, "white": 1e-3, "green": 4e-3}


def _scene(seed, bias=0.0, wrong=0.0, share=0.8):
    """Three markers of a rotor at 0.5 rad a frame, each seen in a share of the frames."""
    rng = np.random.default_rng(seed)
    k = np.arange(FRAMES)
    truth = 1.0 + 0.5 * k - 2e-5 * k**2
    markers = {}
    for name, mount in MOUNTS.items():
        angle = truth + mount + rng.normal(0, SCATTER[name], FRAMES)
        angle = angle + bias * np.cos(4 * (truth + mount))
        good = rng.uniform(size=FRAMES) < share
        angle = angle + np.where(rng.uniform(size=FRAMES) < wrong, 0.05, 0.0)
        markers[name] = Candidate(
            np.angle(np.exp(1j * angle)),
            good,
            np.ones(FRAMES, dtype=bool),
            np.ones(FRAMES),
            np.zeros(FRAMES),
            mount + 0.01,
        )
    coarse = truth + 0.01 + rng.normal(0, 0.01, FRAMES)
    return truth, coarse, markers


def test_the_angle_is_right_and_so_is_its_uncertainty():
    z = []
    for seed in range(6):
        truth, coarse, markers = _scene(seed)
        body = join(coarse, markers, 1000.0)
        error = body.angle - truth
        error -= np.nanmean(error)
        assert np.nanstd(error) < 1.45e-3  # ideal weights give 1.3e-3
        z.append(error / body.sigma)
    assert np.nanstd(np.concatenate(z)) == pytest.approx(1.0, abs=0.12)


def test_places_on_the_body_are_measured():
    _, coarse, markers = _scene(1)
    body = join(coarse, markers, 1000.0)
    first = body.markers["blue"].mount
    assert body.markers["white"].mount - first == pytest.approx(2.1, abs=3e-4)
    assert body.markers["green"].mount - first == pytest.approx(-2.0, abs=5e-4)


def test_faults_are_left_out():
    truth, coarse, markers = _scene(2, wrong=0.03)
    body = join(coarse, markers, 1000.0)
    error = body.angle - truth
    assert np.nanmax(np.abs(error - np.nanmedian(error))) < 0.02
    assert (np.abs(error - np.nanmedian(error)) > 5 * body.sigma).mean() < 2e-3


def test_position_dependent_errors_are_learnt():
    truth, coarse, markers = _scene(3, bias=6e-3)
    body = join(coarse, markers, 1000.0)
    assert np.nanstd(body.angle - truth) < 1.5e-3


def test_frames_with_no_marker_have_no_angle():
    truth, coarse, markers = _scene(4)
    for name, c in markers.items():
        good = c.good.copy()
        good[700:720] = False
        markers[name] = Candidate(c.angle, good, c.open, c.weak, c.misfit_excess, c.mount)
    body = join(coarse, markers, 1000.0)
    assert np.isnan(body.angle[700:720]).all()
    assert (body.count[700:720] == 0).all()
    error = body.angle - truth
    assert abs(np.nanmean(error[720:]) - np.nanmean(error[:700])) < 1e-3  # no slipped turn


def test_a_slow_oscillation_with_the_turn_is_motion_not_error():
    """A single marker on an unbalanced wheel at 20 rad/s: the swing once a turn is real and must stay."""
    rng = np.random.default_rng(5)
    k = np.arange(1200)
    turn = 0.07 * k
    truth = turn + 8e-3 * np.sin(turn)
    angle = np.angle(np.exp(1j * (truth + rng.normal(0, 1e-3, 1200))))
    always = np.ones(1200, dtype=bool)
    one = Candidate(angle, always, always, np.ones(1200), np.zeros(1200), 0.0)
    body = join(truth + rng.normal(0, 0.01, 1200), {"tape": one}, 300.0)
    swing = np.abs(np.mean((body.angle - turn - np.mean(body.angle - turn)) * np.exp(-1j * turn))) * 2
    assert swing == pytest.approx(8e-3, rel=0.1)


@pytest.mark.parametrize(("speed", "learnt"), [(0.5, True), (0.13, False)])
def test_errors_by_what_passes_are_learnt_only_where_it_passes_fast(speed, learnt):
    """At 430 rad/s relative to the casing a swing with their angle cannot be motion; at 60 rad/s it can."""
    rng = np.random.default_rng(6)
    k = np.arange(1200)
    truth, other = 0.07 * k, 2.0 + speed * k
    angle = truth + 4e-3 * np.cos(3 * (truth - other)) + rng.normal(0, 1e-3, 1200)
    always = np.ones(1200, dtype=bool)
    one = Candidate(np.angle(np.exp(1j * angle)), always, always, np.ones(1200), np.zeros(1200), 0.0)
    coarse = truth + rng.normal(0, 0.01, 1200)
    for above in (True, False):
        error = join(coarse, {"red": one}, 1000.0, other, above=above).angle - truth
        assert bool(np.std(error) < 1.2e-3) == learnt
        assert bool(np.std(error) > 2.5e-3) != learnt


@pytest.mark.slow
def test_markers_that_pass_nearly_in_step_with_the_frames_move_nothing():
    """Six passages a turn, creeping: a curve over their angle could follow any slow motion, or make one."""
    z, slow = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        k = np.arange(240)
        truth, other = 0.077 * k, 0.4 + 1.13 * k
        noise = rng.normal(0, 1e-3, 240)
        for j in range(1, 240):
            noise[j] = 0.6 * noise[j - 1] + 0.8 * noise[j]
        always = np.ones(240, dtype=bool)
        angle = np.angle(np.exp(1j * (truth + noise)))
        one = Candidate(angle, always, always, np.ones(240), np.zeros(240), 0.0)
        body = join(truth + rng.normal(0, 0.01, 240), {"red": one}, 260.0, other, above=True)
        error = body.angle - truth
        error -= np.median(error)
        z.append(error / body.sigma)
        slow.append(
            np.polyval(np.polyfit(k, error, 3), k).std() / np.polyval(np.polyfit(k, noise, 3), k).std()
        )
    assert np.mean(slow) < 1.3
    assert 0.8 < np.concatenate(z).std() < 1.25


def _few_turns(seed, turns=3.4, frames=250, rho=0.0, sizes=(1.3e-3,)):
    """Markers of a slow body: errors of so many rad by place, noise of 0.7 mrad that lasts."""
    rng = np.random.default_rng(seed)
    truth = 1.0 + 2 * np.pi * turns * np.arange(frames) / frames
    order = np.arange(1, 9)
    every = np.ones(frames, dtype=bool)
    markers = {}
    for k, by_place in enumerate(sizes):
        size = rng.normal(size=(2, 8)) / np.sqrt(order)
        size *= by_place * np.sqrt(2) / np.sqrt((size**2).sum())
        place = np.cos(np.outer(truth, order)) @ size[0] + np.sin(np.outer(truth, order)) @ size[1]
        noise = rng.normal(0, 0.7e-3, frames)
        for j in range(1, frames):
            noise[j] = rho * noise[j - 1] + np.sqrt(1 - rho**2) * noise[j]
        angle = np.angle(np.exp(1j * (truth + place + noise)))
        markers[f"marker {k}"] = Candidate(angle, every, every, np.ones(frames), np.zeros(frames), 0.0)
    return truth, join(truth + rng.normal(0, 0.01, frames), markers, 1000.0)


@pytest.mark.parametrize("rho", [0.0, pytest.param(0.5, marks=pytest.mark.slow), 0.7])
def test_errors_that_last_for_some_frames_are_not_taken_for_motion(rho):
    z = []
    for seed in range(20):
        truth, body = _few_turns(seed, rho=rho)
        error = body.angle - truth
        z.append((error - np.median(error)) / body.sigma)
    assert np.std(np.concatenate(z)) == pytest.approx(1.0, abs=0.05)


def test_motion_and_position_dependent_errors_of_two_turns_are_distinguished_as_badly_as_claimed():
    """At the ends of the film, a curve over the angle and a motion can be exchanged; the noise alone says 1.3 there."""
    z, ends = [], []
    for seed in range(16):
        truth, body = _few_turns(seed, turns=2.2, frames=120, sizes=(5e-3,))
        error = body.angle - truth
        z.append((error - np.median(error)) / body.sigma)
        ends.append(np.concatenate([z[-1][:8], z[-1][-8:]]))
    assert np.std(np.concatenate(z)) == pytest.approx(1.0, abs=0.05)
    assert np.std(np.concatenate(ends)) == pytest.approx(1.0, abs=0.12)


def _seen_beside_the_axis(seed, common, own, turns=1.6, frames=150):
    """Three markers, each hidden for a third of every turn, about an axis that is off by so much of their radius."""
    rng = np.random.default_rng(seed)
    truth = 1.0 + 2 * np.pi * turns * np.arange(frames) / frames
    axis = rng.normal(0.0, common, 2)
    markers = {}
    for name, mount in MOUNTS.items():
        e, place = axis + rng.normal(0.0, own, 2), truth + mount
        angle = place + e[1] * np.cos(place) - e[0] * np.sin(place) + rng.normal(0.0, 1e-3, frames)
        good = np.mod(place - 0.5, 2 * np.pi) > 2.1
        markers[name] = Candidate(
            wrapped(angle), good, np.ones(frames, dtype=bool), np.ones(frames), np.zeros(frames), mount
        )
    body = join(truth + rng.normal(0, 0.01, frames), markers, 1000.0, floor=1e-3)
    error = body.angle - truth
    error -= np.nanmedian(error)
    return error, error / body.sigma


@pytest.mark.parametrize(
    ("common", "own"), [(0.0, 0.0), pytest.param(12e-3, 0.5e-3, marks=pytest.mark.slow), (6e-3, 3e-3)]
)
def test_markers_of_a_body_show_together_where_its_axis_is(common, own):
    """In less than two turns: what one marker shows as motion, three show as an axis beside the one assumed."""
    errors, z = zip(*(_seen_beside_the_axis(seed, common, own) for seed in range(8)), strict=True)
    # errors of its own of each marker move the mean of the markers like a motion
    assert np.nanstd(errors) < 1.0e-3 + 0.8 * own  # 13 mrad about the axis assumed, with common = 12 mrad
    assert 0.7 < np.nanstd(z) < 1.25


def test_an_error_that_hardly_changes_along_an_arc_is_a_zero():
    turn = np.linspace(0.0, 2 * np.pi, 200, endpoint=False)
    assert variance_left(turn, range(1, 7)) == pytest.approx(1.0, abs=1e-9)
    short = np.linspace(0.0, 0.2, 200)
    assert variance_left(short, range(1, 2)) == pytest.approx(0.2**2 / 12, rel=0.02)
    assert variance_left(short, range(1, 2), 20) == pytest.approx(0.9, abs=0.01)  # ten independent errors


def test_position_dependent_errors_are_known_only_of_a_body_that_turns_round():
    assert _few_turns(1)[1].place_error == pytest.approx(1.3e-3, rel=0.2)
    assert np.isnan(_few_turns(1, turns=1.5)[1].place_error)


def test_the_marker_with_the_smallest_error_shows_how_large_position_dependent_errors_are():
    assert _few_turns(2, sizes=(6e-3, 1.5e-3, 4e-3))[1].place_error == pytest.approx(1.5e-3, rel=0.3)


def test_frames_that_hardly_show_a_body_have_no_angle():
    sigma = np.full(400, 1e-3)
    sigma[200:] = 8e-3  # a blurred part of the film is as good as its surroundings
    sigma[[0, 1, 150, 300]] = 2e-2, np.nan, 2e-2, 2e-2
    assert np.flatnonzero(_fusion._mostly_hidden(sigma)).tolist() == [0, 150]


def test_an_angle_of_one_marker_that_no_other_frame_confirms_is_left_out():
    """A hand covers the markers in frames 1 to 24; what is taken for a marker in frame 0 cannot be checked."""
    n = 200
    path = 0.1 * np.arange(n) + np.random.default_rng(3).normal(0.0, 1e-3, n)
    seen = np.ones(n, dtype=bool)
    seen[1:25] = False
    coarse = np.where(seen, path, np.nan)
    coarse[0] += 0.3
    one = Candidate(wrapped(coarse), seen, seen, np.ones(n), np.zeros(n), 0.0)
    found = join(coarse, {"red": one}, 260.0)
    assert np.isnan(found.angle[0])
    assert np.isfinite(found.angle[25:]).all()
    both = join(coarse, {"red": one, "blue": replace(one)}, 260.0)
    assert np.isfinite(both.angle[0])
