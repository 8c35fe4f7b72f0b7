"""Parts of the fusion of markers against linear algebra and small cases on either side of each rule."""

import math
from dataclasses import fields, is_dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack._smoothing import TimeBase
from gyrotrack.tracking import _fusion as module
from gyrotrack.tracking._fusion import (
    FAST,
    KNOTS,
    TURN,
    Residuals,
    Weights,
    closed_curve,
    curve_at,
    errors_by_neighbour,
    errors_by_place,
    errors_of_view,
    join,
    mount_angles,
    once_a_turn,
    place_error,
    places_passed,
    scatter_over_turns,
    turning_frames,
    variance_left,
    weights_about,
    without_common_motion,
    without_time_scatter,
    wrapped,
)
from gyrotrack.tracking._marker_tracker import Candidate
from gyrotrack.tracking._orbit import CELL

N = 400
KNOT = TURN * np.arange(KNOTS) / KNOTS


def state(off=None, *, rate=0.3, fps=1000.0, mounts=(0.0, 2.0), n=N, scatter=None, time_base=None, good=None):
    """Residuals of markers about a uniform motion; `off` are errors of their angles [rad]."""
    path = rate * np.arange(n)
    candidates = {}
    for k, mount in enumerate(mounts):
        error = 0.0 if off is None else off[k]
        candidates[f"m{k}"] = Candidate(
            wrapped(path + mount + error), np.ones(n, dtype=bool) if good is None else good[k], np.ones(n, dtype=bool),
            np.ones(n), np.zeros(n), mount,
        )  # fmt: skip
    return changed(Residuals.of(path.copy(), candidates, fps, time_base), scatter=scatter or {})


def changed(found, **parts):
    """Return residuals with other parts, constant or (n,): of all markers, or by the names of some."""
    n, one = len(found.path), {"turning": found.turning, "fast": found.fast} | parts

    def columns(old, key):
        return old | {name: np.broadcast_to(value, n) for name, value in parts.get(key, {}).items()}

    weights, place = found.weights, found.place
    candidates = {
        name: replace(
            c, **{key: np.broadcast_to(parts[key][name], n) for key in ("open", "angle") if name in parts.get(key, {})}
        )
        for name, c in found.candidates.items()
    }  # fmt: skip
    return replace(
        found,
        candidates=candidates,
        turning=np.broadcast_to(one["turning"], n),
        fast=np.broadcast_to(one["fast"], n),
        weights=Weights(
            weights.scatter | parts.get("scatter", {}),
            columns(weights.weak, "weak"),
            columns(weights.use, "use"),
        ),
        place=replace(
            place,
            error=columns(place.error, "by_place"),
            leverage=columns(place.leverage, "absorbed"),
            size=parts.get("size", place.size),
            common_kept=parts.get("common_kept", place.common_kept),
        ),
        neighbour=replace(found.neighbour, error=columns(found.neighbour.error, "by_neighbour")),
    )


def leaves(record, at=""):
    """Yield the path and value of everything in a record."""
    if is_dataclass(record):
        record = {f.name: getattr(record, f.name) for f in fields(record)}
    if isinstance(record, dict):
        for name, value in record.items():
            yield from leaves(value, f"{at}.{name}")
    else:
        yield at, record


class TestResiduals:
    def test_they_are_angles_less_path_mount_and_learnt_error(self):
        found = state([0.01, -0.02])
        assert found.residual("m0") == pytest.approx(np.full(N, 0.01), abs=1e-9)
        found = changed(found, by_place={"m1": 0.003}, by_neighbour={"m1": 0.004})
        assert found.bias("m1") == pytest.approx(np.full(N, 0.007))
        assert found.residual("m1") == pytest.approx(np.full(N, -0.027), abs=1e-9)

    @pytest.mark.parametrize(("fps", "fast"), [(230.0, False), (240.0, True)])
    def test_frames_are_fast_from_70_radians_per_second(self, fps, fast):
        """0.3 rad a frame."""
        assert FAST == 70.0
        found = state(fps=fps)
        assert found.fast.all() == found.fast.any() == fast
        assert module.speed(found.path, fps) == pytest.approx(np.full(N, 0.3 * fps))

    def test_the_mean_has_the_weights_of_the_scatters(self):
        found = state([0.01, -0.02], scatter={"m0": (1e-3, 9.0), "m1": (2e-3, 9.0)})
        mean, sigma, count = found.mean()
        assert mean == pytest.approx(np.full(N, (4 * 0.01 - 0.02) / 5), abs=1e-9)
        assert sigma == pytest.approx(np.full(N, 1e-3 / math.sqrt(1.25)))
        assert count.tolist() == [2] * N
        k = np.arange(N)
        found = changed(found, use={"m0": k >= 3, "m1": (k < 1) | (k >= 3)})
        mean, sigma, count = found.mean()
        assert (mean[0], count[0]) == (pytest.approx(-0.02), 1)
        assert np.isnan(mean[1:3]).all()
        assert np.isnan(sigma[1:3]).all()
        assert count[1] == 0

    def test_partly_occluded_and_weak_observations_are_less_certain(self):
        found = state(scatter={"m0": (1e-3, 4e-3), "m1": (1e-3, 4e-3)})
        k = np.arange(N)
        found = changed(found, open={"m0": k != 5}, weak={"m0": np.where(k == 7, 3.0, 1.0)})
        sigma = found.sigma("m0")
        assert (sigma[0], sigma[5], sigma[7]) == pytest.approx((1e-3, 4e-3, 3e-3))

    def test_the_mount_of_the_first_marker_is_fixed(self):
        found = state([0.01, -0.02])
        assert mount_angles(found, np.zeros(N)) == {"m0": 0.0, "m1": pytest.approx(2.0 - 0.03)}

    @pytest.mark.parametrize(("size", "used"), [(5.9, True), (6.1, False), (-6.1, False)])
    def test_outliers_are_beyond_six_scatters(self, size, used):
        rng = np.random.default_rng(1)
        error = 1e-3 * rng.standard_normal((2, N))
        clear = 1.4826 * np.median(np.abs(error[0]))
        error[0, 50] = size * clear + math.copysign(5e-4, size)
        weights = weights_about(state(error), np.zeros(N), np.zeros(N))
        assert weights.scatter["m0"][0] == pytest.approx(clear, rel=0.01)
        assert weights.use["m0"][50] == used
        assert weights.use["m0"].sum() >= N - 1

    @pytest.mark.parametrize(("size", "used"), [(29.0, True), (31.0, False), (-31.0, False)])
    def test_outliers_of_partly_occluded_ones_are_beyond_thirty_scatters_of_the_others(self, size, used):
        """However large their own scatter is."""
        error = 1e-3 * np.random.default_rng(1).standard_normal((2, N))
        clear = 1.4826 * np.median(np.abs(error[0, :300]))
        error[0, 300:] *= 12.0
        error[0, 350] = size * clear + math.copysign(5e-4, size)
        found = changed(state(error), open={"m0": np.arange(N) < 300})
        weights = weights_about(found, np.zeros(N), np.zeros(N))
        assert weights.scatter["m0"][0] == pytest.approx(clear, rel=0.01)
        assert weights.scatter["m0"][1] > 8.0 * clear
        assert weights.use["m0"][350] == used

    def test_the_scatter_of_partly_occluded_ones_is_at_least_that_of_the_others(self):
        rng = np.random.default_rng(1)
        error = 1e-3 * rng.standard_normal((2, N))
        error[0, 300:] *= 2.5
        found = changed(state(error), open={"m0": np.arange(N) < 300})
        weights = weights_about(found, np.zeros(N), np.zeros(N))
        clear, partly = weights.scatter["m0"]
        assert partly / clear == pytest.approx(2.5, rel=0.25)
        error[0, 300:] /= 10
        found = changed(state(error), open={"m0": np.arange(N) < 300})
        weights = weights_about(found, np.zeros(N), np.zeros(N))
        assert weights.scatter["m0"][0] == weights.scatter["m0"][1]

    def test_leverage_is_shared_by_the_markers(self):
        """A residual of which the curve has absorbed a share s is larger by 1 / sqrt(1 - s / markers)."""
        found = state([0.01, 0.01])
        leverage, once, twice = np.full(N, 0.4), np.ones(N), np.full(N, 2.0)
        assert found.standardised("m0", np.zeros(N), leverage, once) == pytest.approx(
            np.full(N, 0.01 / math.sqrt(0.8))
        )
        found = changed(found, absorbed={"m0": 0.3})
        assert found.standardised("m0", np.full(N, 0.004), leverage, twice) == pytest.approx(
            np.full(N, 0.003 / math.sqrt(0.5))
        )
        found = changed(found, absorbed={"m0": 5.0})
        assert found.standardised("m0", np.zeros(N), leverage, twice) == pytest.approx(
            np.full(N, 0.005 / math.sqrt(0.1))
        )

    def test_curves_by_place_and_by_the_neighbour_absorb_together(self):
        found = changed(state(), absorbed={"m0": 0.3})
        leverage = {"m0": np.full(N, 0.1), "m1": np.full(N, 0.2)}
        found = replace(found, neighbour=replace(found.neighbour, leverage=leverage))
        assert found.absorbed("m0") == pytest.approx(np.full(N, 0.4))
        assert found.absorbed("m1", slice(3)) == pytest.approx(np.full(3, 0.2))

    def test_errors_of_the_view_replace_those_by_place(self):
        found = changed(state([0.01, 0.01]), by_place={"m0": 3e-3}, by_neighbour={"m0": 1e-3})
        errors = {"m0": np.full(N, 5e-3), "m1": np.zeros(N)}
        found = replace(found, view=module.ViewErrors(errors, np.zeros(N)))
        assert found.bias("m0") == pytest.approx(np.full(N, 6e-3))
        assert replace(found, view=None).bias("m0") == pytest.approx(np.full(N, 4e-3))

    @pytest.mark.parametrize(("growth", "expected"), [(1.8, 1.8), (4.0, 2.5), (0.5, 1.0)])
    def test_the_scatter_about_a_long_curve_is_limited(self, growth, expected):
        rng = np.random.default_rng(1)
        found = state(1e-3 * rng.standard_normal((2, N)))
        short = weights_about(found, np.zeros(N), np.zeros(N)).scatter["m0"][0]
        found = changed(found, turning=True, scatter={"m0": (short / growth, short / growth)})
        assert scatter_over_turns(found, np.zeros(N), np.zeros(N))["m0"][0] == pytest.approx(
            expected * short / growth, rel=0.01
        )

    def test_the_scatter_of_the_times_is_subtracted(self):
        scatter = {"m0": (5e-3, 5e-3), "m1": (3.1e-3, 5e-3)}
        left = without_time_scatter(scatter, np.full(N, 3e-3))
        assert left["m0"] == pytest.approx((4e-3, 4e-3))
        assert left["m1"][0] == pytest.approx(math.sqrt(3.1**2 - 9) * 1e-3)
        assert without_time_scatter(left, np.full(N, 5e-3))["m0"][0] == pytest.approx(0.2 * 4e-3)

    def test_the_uncertainty_of_a_time_is_an_angle(self):
        assert state().time_sigma() == 0.0
        found = state(time_base=TimeBase(np.arange(float(N)), 0.05))
        assert found.time_sigma() == pytest.approx(np.full(N, 0.3 * 0.05))

    @pytest.mark.parametrize(("size", "whole"), [(11.9, True), (12.1, False)])
    def test_whole_turns_are_marked_where_both_curves_agree(self, size, whole):
        found = state(scatter={"m0": (2e-3, 2e-3), "m1": (1e-3, 1e-3)})
        smooth = np.zeros(N)
        smooth[200] = size * 1e-3  # of the smaller scatter
        turning = turning_frames(found, np.zeros(N), smooth, 30)
        assert turning[150]
        assert turning[200] == whole

    def test_weights_are_those_relative_to_the_median_uncertainty(self):
        found = module._weight(np.array([1.0, 2.0, 4.0, np.nan]))
        assert found == pytest.approx([4.0, 1.0, 0.25, 0.0])
        assert module._weight(np.full(3, np.nan)).tolist() == [0.0] * 3

    def test_angles_are_wrapped(self):
        assert wrapped(np.array([3.5, -3.5, 7.0])) == pytest.approx([3.5 - TURN, TURN - 3.5, 7.0 - TURN])


class TestSteps:
    """No step modifies a record, even in part: all its arrays are read-only."""

    OTHER, ZERO = 1.0 + 0.38 * np.arange(N), np.zeros(N)

    @pytest.mark.parametrize("turning", [True, False])
    @pytest.mark.parametrize(
        "step",
        [
            lambda found, other, zero: found.smooth(30),
            lambda found, other, zero: mount_angles(found, zero),
            lambda found, other, zero: weights_about(found, zero, zero),
            lambda found, other, zero: scatter_over_turns(found, zero, zero),
            lambda found, other, zero: without_time_scatter(found.weights.scatter, zero),
            lambda found, other, zero: turning_frames(found, zero, zero, 30),
            lambda found, other, zero: errors_by_place(found, zero),
            lambda found, other, zero: errors_of_view(found, 1e-3, {"m0": np.eye(2) * 1e-4}),
            lambda found, other, zero: errors_by_neighbour(found, zero, other, (30, 2), above=True, last=False),
            lambda found, other, zero: errors_by_neighbour(found, zero, other, (30, 2), above=False, last=True),
            lambda found, other, zero: module._result(found, 30, 2, 1e-3, 1e-3, zero > 0.0),
        ],
    )  # fmt: skip
    def test_a_step_leaves_its_record_unchanged(self, step, turning):
        error = 3e-3 * np.random.default_rng(0).standard_normal((2, N))
        found = changed(
            state(error, rate=0.3 if turning else 0.005),
            turning=turning,
            size={"m0": 1e-3, "m1": 1e-3},
            absorbed={"m0": 0.1},
        )
        before = list(leaves(found))
        arrays = [(value, value.tobytes()) for _, value in before if isinstance(value, np.ndarray)]
        assert len(arrays) > 20
        for array, _ in arrays:
            array.flags.writeable = False
        step(found, self.OTHER, self.ZERO)
        after = list(leaves(found))
        assert [place for place, _ in after] == [place for place, _ in before]
        for (_, one), (_, other) in zip(before, after, strict=True):
            assert one is other
        assert all(array.tobytes() == values for array, values in arrays)

    def test_markers_are_joined_from_read_only_arrays(self):
        given = state(1e-3 * np.random.default_rng(0).standard_normal((2, N)))
        for _, value in leaves(given):
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
        body = join(given.path, given.candidates, 1000.0, self.OTHER)
        assert body.count.tolist() == [2] * N


class TestClosedCurve:
    def basis(self, angle):
        """Linear hat functions on the knots."""
        place = np.mod(angle, TURN) * KNOTS / TURN
        apart = np.abs((place[:, None] - np.arange(KNOTS) + KNOTS / 2) % KNOTS - KNOTS / 2)
        return np.maximum(1 - apart, 0.0)

    def data(self):
        rng = np.random.default_rng(3)
        angle = rng.uniform(-20.0, 20.0, 900)
        return (
            angle,
            5e-3 * np.cos(angle - 0.4) + 1e-3 * rng.standard_normal(900),
            rng.uniform(0.5e6, 2e6, 900),
        )

    def test_it_has_72_knots(self):
        assert KNOTS == 72

    def test_it_minimises_the_penalised_sum(self):
        """sum w (r - B c)^2 + |D2 c|^2 / 4e-3^2 + |c|^2 / 3e-2^2."""
        angle, residual, weight = self.data()
        found = closed_curve(angle, residual, weight)
        b = self.basis(angle)
        second = np.roll(np.eye(KNOTS), 1, axis=1) + np.roll(np.eye(KNOTS), -1, axis=1) - 2 * np.eye(KNOTS)
        inner = b.T @ (weight[:, None] * b) + second.T @ second / 4e-3**2 + np.eye(KNOTS) / 3e-2**2
        assert found.covariance == pytest.approx(np.linalg.inv(inner))
        assert found.values == pytest.approx(np.linalg.solve(inner, b.T @ (weight * residual)))
        leverage = weight * np.einsum("ni,ij,nj->n", b, found.covariance, b)
        assert found.leverage(angle, weight) == pytest.approx(leverage)
        assert curve_at(found.values, angle) == pytest.approx(b @ found.values)
        assert found.size == pytest.approx(5e-3 * math.sqrt(KNOTS / 8 / 2), rel=0.05)

    def test_unknown_residuals_do_not_count(self):
        angle, residual, weight = self.data()
        spoiled, less = residual.copy(), weight.copy()
        spoiled[:100], less[100:200] = np.nan, 0.0
        kept = slice(200, None)
        assert closed_curve(angle, spoiled, less).values == pytest.approx(
            closed_curve(angle[kept], residual[kept], weight[kept]).values
        )

    def test_its_size_is_at_most_that_of_the_prior(self):
        angle = np.linspace(0, 50, 2000)
        assert closed_curve(angle, 0.1 * np.cos(angle), np.full(2000, 1e6)).size == 3e-2

    def test_common_harmonics_of_orders_one_and_two_are_removed(self):
        """Equal in the angle of the body, that is shifted by the mount in the angle of the marker."""
        mounts = {"a": 0.0, "b": 2.0}
        own = {"a": 1e-3 * np.cos(2 * KNOT + 0.3), "b": -1e-3 * np.cos(2 * (KNOT - 2.0) + 0.3)}
        third = 2e-3 * np.cos(3 * KNOT)
        curves = {}
        for name, mount in mounts.items():
            common = 4e-3 * np.cos(KNOT - mount - 0.7) + 3e-3 * np.sin(2 * (KNOT - mount))
            curves[name] = common + own[name] + (third if name == "a" else 0.0)
        found = without_common_motion(curves, mounts)
        assert found["a"] == pytest.approx(own["a"] + third, abs=1e-4)
        assert found["b"] == pytest.approx(own["b"], abs=1e-4)
        matrix = module._without_common(mounts)
        both = matrix @ np.concatenate([curves["a"], curves["b"]])
        assert both == pytest.approx(np.concatenate([found["a"], found["b"]]))

    def test_an_axis_is_the_first_harmonic(self):
        """About an axis e a marker has the angle a + (e_y cos a - e_x sin a) / r."""
        e = 0.03 - 0.02j
        assert once_a_turn(e.imag * np.cos(KNOT) - e.real * np.sin(KNOT)) == pytest.approx(e)


class TestLearning:
    def test_position_dependent_errors_are_learnt_without_their_mean(self):
        rng = np.random.default_rng(2)
        turn = 0.3 * np.arange(N)
        error = [4e-3 * np.cos(3 * (turn + m)) + 1e-3 + 3e-4 * rng.standard_normal(N) for m in (0.0, 2.0)]
        found = state(error, scatter=dict.fromkeys(("m0", "m1"), (0.0003, 0.0003)))
        learnt = errors_by_place(changed(found, turning=True), np.zeros(N))
        assert learnt.error["m1"] == pytest.approx(4e-3 * np.cos(3 * (turn + 2.0)), abs=6e-4)
        assert learnt.common_kept is False
        assert (learnt.leverage["m0"] > 0).all()
        assert learnt.leverage["m0"].sum() < KNOTS

    @pytest.mark.parametrize(("share", "geometry"), [(0.19, False), (0.21, True)])
    def test_curves_are_learnt_from_fast_frames_if_there_are_enough(self, share, geometry):
        """From these the first harmonic is an axis; otherwise it may be a motion."""
        turn = 0.3 * np.arange(N)
        e = 2e-3 + 1e-3j
        error = [e.imag * np.cos(turn + m) - e.real * np.sin(turn + m) for m in (0.0, 2.0)]
        found = state(error, scatter=dict.fromkeys(("m0", "m1"), (0.0001, 0.0001)))
        found = changed(found, turning=True, fast=np.arange(N) < share * N)
        learnt = errors_by_place(found, np.zeros(N))
        assert learnt.common_kept is not geometry
        assert (set(learnt.axis_off) == {"m0", "m1"}) is geometry
        if geometry:
            assert learnt.axis_off["m0"] == pytest.approx(e, rel=0.1)

    def passed(self, *, above, other_rate, last=False):
        turn, other = 0.3 * np.arange(N), 1.0 + other_rate * np.arange(N)
        error = [3e-3 * np.cos(2 * (turn + m - other)) for m in (0.0, 2.0)]
        found = state(error, scatter=dict.fromkeys(("m0", "m1"), (0.0002, 0.0002)))
        found = changed(found, turning=True)
        return errors_by_neighbour(found, np.zeros(N), other, (30, 2), above=above, last=last), error

    @pytest.mark.parametrize(
        ("above", "other_rate", "learnt"),
        [(True, 0.38, True), (True, 0.36, False), (False, 0.38, True), (False, 0.36, False)],
    )
    def test_errors_beside_another_body_are_learnt_where_it_passes_fast(self, above, other_rate, learnt):
        """80 and 60 rad/s beside 300 rad/s; below it, of partly occluded markers at any speed."""
        found, error = self.passed(above=above, other_rate=other_rate)
        learnt_ = found.error["m1"]
        if learnt and not above:
            assert learnt_ == pytest.approx(error[1], abs=5e-4)
        assert learnt_.any() == learnt
        assert found.leverage["m1"].any() == learnt

    @pytest.mark.parametrize("hidden", [0.0, 0.4])
    def test_a_level_of_the_errors_beside_another_body_is_a_mount_angle(self, hidden):
        """The errors of unoccluded frames have the mean 0; hidden frames are displaced from them by 5 mrad."""
        turn, other = 0.3 * np.arange(N), 1.0 + 0.38 * np.arange(N)
        covered = np.mod(turn - other, TURN) < TURN * hidden
        error = 3e-3 * np.cos(2 * (turn - other)) + 4e-3 + 5e-3 * covered
        found = changed(
            state([error, error], mounts=(0.0, 0.0), scatter=dict.fromkeys(("m0", "m1"), (0.0002, 0.0002))),
            turning=True, open=dict.fromkeys(("m0", "m1"), ~covered),
        )  # fmt: skip
        learnt = errors_by_neighbour(found, np.zeros(N), other, (30, 2), above=False, last=False).error["m0"]
        assert learnt[~covered].mean() == pytest.approx(0.0, abs=1e-9)
        edges = np.mod((turn - other)[:, None] / TURN - [0.0, hidden] + 0.5, 1.0) - 0.5
        clear = np.abs(edges).min(axis=1) > 0.06
        usual = error - error[~covered].mean()
        assert learnt[clear] == pytest.approx(usual[clear], abs=1.5e-3)

    @pytest.mark.parametrize("above", [False, True])
    def test_the_last_curve_is_reduced_by_its_noise(self, monkeypatch, above):
        whole, _ = self.passed(above=above, other_rate=0.38)
        monkeypatch.setattr(module, "_shown_share", lambda *_: 0.25)
        monkeypatch.setattr(module, "local_fit", lambda value, *_: (np.zeros(len(value)), None))
        whole, _ = self.passed(above=above, other_rate=0.38)
        last, _ = self.passed(above=above, other_rate=0.38, last=True)
        assert last.error["m0"] == pytest.approx(0.25 * whole.error["m0"])
        assert last.leverage["m0"] == pytest.approx(0.25 * whole.leverage["m0"])

    def test_the_slow_part_of_an_error_from_above_is_motion(self, monkeypatch):
        windows = []

        def slow(value, weight, *window):
            windows.append(window)
            return np.full(len(value), size), None

        monkeypatch.setattr(module, "local_fit", slow)
        size = 0.0
        whole, error = self.passed(above=True, other_rate=0.38)
        assert whole.error["m0"] == pytest.approx(error[0], abs=5e-4)
        size = 1e-3
        rest, _ = self.passed(above=True, other_rate=0.38)
        assert whole.error["m0"] - rest.error["m0"] == pytest.approx(np.full(N, 1e-3))
        assert set(windows) == {(30, 2)}

    def test_the_shown_share_is_that_beyond_the_noise(self):
        curve = module.ClosedCurve(np.full(KNOTS, 2e-3), np.eye(KNOTS) * 1e-6, 1e-3)
        every = np.ones(3, dtype=bool)
        assert module._shown_share(curve, KNOT[:3], every) == pytest.approx(1 - 1e-6 / 4e-6)
        assert (
            module._shown_share(module.ClosedCurve(np.zeros(KNOTS), np.eye(KNOTS), 0.0), KNOT[:3], every)
            == 0.0
        )
        assert module._shown_share(curve, KNOT[:3], ~every) == 0.0

    def test_the_position_dependent_error_is_that_of_the_better_marker_without_noise(self):
        """Of 4 and 3 mrad rms, with a noise of 0.6 times 2 mrad: sqrt(9 - 2.4)."""
        sign = np.where(np.arange(N) % 2, 1, -1)
        found = changed(
            state(scatter=dict.fromkeys(("m0", "m1"), (0.002, 0.002))),
            turning=True,
            by_place={"m0": 4e-3 * sign, "m1": 3e-3 * sign},
            absorbed=dict.fromkeys(("m0", "m1"), 0.6),
        )
        assert place_error(found) == pytest.approx(math.sqrt(9 - 2.4) * 1e-3)
        found = changed(found, by_place={"m1": 3e-4 * sign})
        assert place_error(found) == 0.0
        for share, known in ((0.51, True), (0.49, False)):
            part = changed(found, turning=np.arange(N) < share * N)
            assert math.isnan(place_error(part)) is not known

    def test_places_outside_whole_turns(self):
        found = changed(state(), turning=np.arange(N) >= 100)
        assert places_passed(found) == pytest.approx(99 * 0.3 / CELL)
        assert places_passed(changed(found, turning=True)) == 0.0


class TestVariances:
    def test_the_share_without_the_mean(self):
        angle = np.linspace(0.0, 1.0, 3000)
        exact = 1 - abs(np.mean(np.exp(1j * angle))) ** 2
        assert variance_left(angle, range(1, 2)) == pytest.approx(exact)
        two = 1 - 0.5 * sum(abs(np.mean(np.exp(1j * k * angle))) ** 2 for k in (1, 2))
        assert variance_left(angle, range(1, 3)) == pytest.approx(two)
        pieces = np.array_split(angle, 3)
        parts = sum(abs(np.sum(np.exp(1j * p))) ** 2 for p in pieces)
        assert variance_left(angle, range(1, 2), 1000) == pytest.approx(1 - parts / 3000**2)

    def test_cubic_splines_sum_to_one_and_follow_a_cubic(self):
        b = module._cubic_splines(50, 7)
        assert b.sum(axis=1) == pytest.approx(np.ones(50))
        x = np.linspace(0, 1, 50)
        cubic = 1 - 2 * x + 3 * x**3
        assert b @ np.linalg.lstsq(b, cubic, rcond=None)[0] == pytest.approx(cubic)

    @pytest.mark.parametrize(("turns", "known"), [(29.0, True), (31.0, False)])
    def test_after_thirty_turns_curves_are_known(self, turns, known):
        n = 260
        found = state(n=n, rate=turns * TURN / n, scatter=dict.fromkeys(("m0", "m1"), (0.001, 0.001)))
        found = changed(found, turning=True, size={"m0": 1e-3, "m1": 1e-3})
        error, left = module._variance_shares(found, 6)
        assert (error != 1.0).any() == known
        assert (left < 1.0).any() == known

    def test_without_whole_turns_nothing_is_learnt(self):
        error, left = module._variance_shares(state(), 6)
        assert error.tolist() == left.tolist() == [1.0] * N

    def test_motion_and_curves_are_one_linear_model(self):
        """The variance of the angle after both are fitted, by the inverse of the whole normal matrix."""
        n, motion, size = 150, 5, 2e-3
        found = state(n=n, rate=2.5 * TURN / n, mounts=(0.0,), scatter={"m0": (1e-3, 1e-3)})
        found = changed(found, turning=True, common_kept=False, size={"m0": size})
        error, left = module._variance_shares(found, motion)
        spline = module._cubic_splines(n, motion)
        hats = TestClosedCurve().basis(found.candidates["m0"].angle)
        rows = np.concatenate([spline, hats], axis=1)
        normal = rows.T @ rows * 1e6
        normal[motion:, motion:] += module._precision(size)
        covariance = np.linalg.inv(normal + 1e-9 * np.trace(normal) / len(normal) * np.eye(len(normal)))
        assert left == pytest.approx(
            np.clip(1 - np.einsum("ni,ij,nj->n", rows, covariance, rows) * 1e6, 0.1, 1), rel=1e-3
        )
        # the angle less the curves b x has the error e - b dx with cov(e, dx) = C a var(e); its mean is arbitrary
        curves = rows.copy()
        curves[:, :motion] = 0.0

        def variance():
            return (
                1e-6
                + np.einsum("ni,ij,nj->n", curves, covariance, curves)
                - 2 * np.einsum("ni,ij,nj->n", rows, covariance, curves)
            )

        for _ in range(2):
            curves -= np.average(curves, axis=0, weights=1 / np.maximum(variance(), 1e-7))
        assert error == pytest.approx(np.maximum(variance() * 1e6, 0.1), rel=1e-3)


class TestView:
    """Errors of the axis of two markers, within less than a turn."""

    def learnt(self, e, *, floor=2e-3, turning=False, arcs=None, mounts=(0.0, 2.0), frames=300, noise=2e-4):
        rng = np.random.default_rng(4)
        turn = 3.5 * np.arange(frames) / frames
        error = [
            e.imag * np.cos(turn + m) - e.real * np.sin(turn + m) + noise * rng.standard_normal(frames)
            for m in mounts
        ]
        names = [f"m{k}" for k in range(len(mounts))]
        found = state(
            error, rate=3.5 / frames, n=frames, mounts=mounts, scatter=dict.fromkeys(names, (noise, noise))
        )
        return found, error, errors_of_view(changed(found, turning=turning), floor, arcs or {})

    @pytest.mark.parametrize("change", [{"mounts": (0.0,)}, {"floor": 0.0}, {"turning": True}])
    def test_it_needs_two_markers_that_cover_less_than_a_turn(self, change):
        _, _, view = self.learnt(0.02 + 0.01j, **change)
        assert view is None

    def test_markers_that_disagree_show_the_axis(self):
        """The mean motion of both is not known; their difference is."""
        _, error, view = self.learnt(0.02 - 0.01j)
        true = error[0] - error[1]
        known = view.error["m0"] - view.error["m1"]
        assert np.std(true - known) < 0.1 * np.std(true)
        assert np.median(view.sigma) > 0.0
        # the error of the mean of both is what is left after the motion
        mean = 0.5 * (error[0] + error[1]) - 0.5 * (view.error["m0"] + view.error["m1"])
        mean -= mean.mean()
        assert np.sqrt(np.mean((mean / view.sigma) ** 2)) < 2.5

    def test_an_offset_of_an_arc_turns_by_a_quarter(self):
        """An offset e displaces a marker at the angle a by e_y cos a - e_x sin a: errors of e_x are of the sine."""
        wide = {"m0": np.diag([1e-2, 1e-12])}
        found, error, _ = self.learnt(0.0 + 0.0j, floor=1e-6, arcs=wide, noise=1e-5)
        _, _, narrow = self.learnt(0.0 + 0.0j, floor=1e-6, noise=1e-5)
        assert narrow is not None
        sine = 5e-3 * np.sin(found.candidates["m0"].angle)
        moved = state(
            [error[0] + sine, error[1]],
            rate=3.5 / 300,
            n=300,
            scatter=dict.fromkeys(("m0", "m1"), (1e-05, 1e-05)),
        )
        view = errors_of_view(moved, 1e-6, wide)
        a = found.candidates["m0"].angle
        wave = np.linalg.lstsq(
            np.column_stack([np.sin(a), np.cos(a), np.ones(300)]), view.error["m0"], rcond=None
        )[0]
        assert wave[0] == pytest.approx(5e-3, rel=0.1)
        assert abs(wave[1]) < 5e-4


class TestHidden:
    @pytest.mark.parametrize(("size", "hidden"), [(9.9, False), (10.1, True)])
    def test_a_frame_ten_times_less_certain_than_its_neighbours(self, size, hidden):
        sigma = np.full(300, 1e-3)
        sigma[[0, 150]] = size * 1e-3
        assert module._mostly_hidden(sigma)[[0, 150]].tolist() == [hidden] * 2

    def test_frames_are_placed_in_a_film_and_picked(self):
        index = np.array([1, 3])
        marker = module.MarkerAngles(np.array([1.0, 2.0]), np.array([0.1, 0.2]), 0.5)
        body = module.BodyAngles(np.array([3.0, 4.0]), np.array([0.3, 0.4]), np.array([1, 2]), {"m": marker})
        wide = body.spread_out(index, 5)
        assert wide.count.tolist() == [0, 1, 0, 2, 0]
        assert wide.angle[[1, 3]].tolist() == [3.0, 4.0]
        assert np.isnan(wide.angle[[0, 2, 4]]).all()
        assert wide.markers["m"].sigma[3] == 0.2
        again = wide.at(index)
        assert (again.angle.tolist(), again.count.tolist(), again.markers["m"].angle.tolist()) == (
            [3.0, 4.0], [1, 2], [1.0, 2.0],
        )  # fmt: skip
        assert SimpleNamespace(**vars(again)).sigma.tolist() == [0.3, 0.4]


class TestJoin:
    @pytest.mark.parametrize("above", [False, True])
    def test_the_other_body_is_followed_in_each_round(self, monkeypatch, above):
        """The errors near its markers are learnt in windows of the curve, and for good in the last pass."""
        seen = []
        changes = iter([1.0] * 6 + [1.9e-3])
        monkeypatch.setattr(module, "change_of_bias", lambda before, after: next(changes))

        def learn(state, smooth, other, window, *, above, last):
            seen.append((other, window, above, last))
            return state.neighbour

        monkeypatch.setattr(module, "errors_by_neighbour", learn)
        given, other = state(), np.linspace(0.0, 9.0, N)
        found = join(given.path, given.candidates, 1000.0, other, above=above)
        window = module.learning_window(given.path)
        assert [s[1:] for s in seen] == [(window, above, last) for last in [False] * 7 + [True]]
        assert all(s[0] is other for s in seen)
        assert found.angle - found.angle[0] == pytest.approx(given.path, abs=1e-9)
        seen.clear()
        monkeypatch.setattr(module, "change_of_bias", lambda before, after: 0.0)
        join(given.path, given.candidates, 1000.0)
        assert seen == []

    @pytest.mark.parametrize(("change", "passes"), [(0.0, 5), (1.9e-3, 5), (2.1e-3, 60)])
    def test_passes_end_when_the_curves_change_by_less_than_a_five_hundredth(
        self, monkeypatch, change, passes
    ):
        """Mount angles, weights and whole turns are estimated in five passes, and the weights at last."""
        seen, asked = [], []

        def counted(name, own):
            return lambda *given: asked.append(name) or own(*given)

        for name in ("mount_angles", "weights_about", "turning_frames"):
            monkeypatch.setattr(module, name, counted(name, getattr(module, name)))
        monkeypatch.setattr(
            module, "errors_by_neighbour", lambda state, *_, **last: seen.append(last) or state.neighbour
        )
        monkeypatch.setattr(module, "change_of_bias", lambda before, after: change)
        given = state()
        join(given.path, given.candidates, 1000.0, np.linspace(0.0, 9.0, N))
        assert [each["last"] for each in seen] == [False] * (passes - 1) + [True]
        assert asked == ["mount_angles", "weights_about", "turning_frames"] * 5 + ["weights_about"]

    def test_a_change_of_errors_is_relative_to_the_scatter_of_a_marker(self):
        """3 mrad in used frames of the first marker of +-10 mrad; 3 mrad of +-2 mrad, by place and by neighbour."""
        used = np.arange(N) < 100
        before = changed(state(), scatter={"m0": (10e-3, 0.1), "m1": (2e-3, 0.1)}, use={"m0": used})
        after = changed(before, by_place={"m0": np.where(used, 3e-3, 9.0)})
        assert module.change_of_bias(before, after) == pytest.approx(0.3)
        after = changed(before, by_place={"m1": 2e-3}, by_neighbour={"m1": 1e-3})
        assert module.change_of_bias(before, after) == pytest.approx(1.5)
        after = changed(before, by_place={"m1": np.where(np.arange(N) % 4 == 0, -3e-3, 0.0)})
        assert module.change_of_bias(before, after) == pytest.approx(0.75)
        assert module.change_of_bias(before, before) == 0.0
