"""Decisions and factors between the observations of markers and the angles of bodies, one small case on either side."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.tracking import _body_angles as module
from gyrotrack.tracking._body_angles import (
    BLOCK_ERROR,
    HEIGHT,
    LIGHT_ERROR,
    RING_ERROR,
    about_rotor,
    axis_offset,
    by_texture,
    error_by_place,
    offset_uncertainty,
    separate_perspective,
    usual_error_by_place,
    usual_error_of_harmonic,
    view,
)
from gyrotrack.tracking._fusion import FAST, BodyAngles, MarkerAngles
from gyrotrack.tracking._hub import LEAST_SIGMA, CentrePath, Radii
from gyrotrack.tracking._marker_tracker import MarkerObservations
from gyrotrack.tracking._orbit import Flattening
from gyrotrack.tracking._scene import Marker
from gyrotrack.tracking._texture import CENTRE_ERROR, TextureObservations

TURN = 2.0 * np.pi
CENTRE = np.array([320.0, 240.0])


def body(angle, sigma=1e-3, **more):
    angle = np.asarray(angle, dtype=np.float64)
    return BodyAngles(angle, np.full(len(angle), sigma), np.ones(len(angle), dtype=np.int64), {}, **more)


def markers_of(name, radii, colours=("red", "green", "blue"), n=400, offset=0j, rate=0.05):
    """The view of a body whose markers circle `offset` (x + i y, y up) about the centre."""
    markers, seen = [], {}
    for k, radius in enumerate(radii):
        z = offset + radius * np.exp(1j * (2.0 * k + rate * np.arange(n)))
        label = f"{name}{k}"
        markers.append(
            Marker(label, name, colours[k], radius - 9, radius + 9, 0.1, (20.0, 20.0), 0.15, 2.0 * k)
        )
        seen[label] = MarkerObservations(
            angle=np.angle(z), radius=np.abs(z), corner_angle=np.zeros((n, 2)), corner_radius=np.zeros((n, 2)),
            gain=np.ones(n), misfit=np.full(n, 0.02), weakness=np.ones(n), open=np.ones(n, dtype=bool),
            centre=np.tile(CENTRE, (n, 1)),
        )  # fmt: skip
    return view(tuple(markers), seen, (640, 480))


def path(n=400, sigma=0.05):
    return CentrePath(np.tile(CENTRE, (n, 1)), np.full(n, sigma), 0)


class TestPositionDependentErrors:
    def test_blocks_average_over_the_markers_and_light_does_not(self):
        seen = markers_of("rotor", (60.0, 100.0))
        assert seen.radius == 80.0
        light = LIGHT_ERROR * 80.0
        assert usual_error_by_place(seen) == pytest.approx(np.hypot(BLOCK_ERROR, light))
        assert usual_error_by_place(seen, 4) == pytest.approx(np.hypot(BLOCK_ERROR / 2.0, light))

    def test_six_equal_harmonics_have_the_error_together(self):
        seen = markers_of("rotor", (60.0,))
        assert usual_error_of_harmonic(seen, 2) * np.sqrt(6.0) == pytest.approx(usual_error_by_place(seen, 2))

    @pytest.mark.parametrize(
        ("learnt", "offset", "expected"),
        [
            (0.5, 0.0, 0.5),  # px
            # the first harmonic of an amplitude has half its square as variance
            (0.5, 0.4, np.sqrt(0.5**2 - 0.5 * 0.4**2)),
            (0.3, 0.42, "usual"),  # at least the typical error
            (0.02, 0.03, 0.02),  # but not more than was learnt
        ],
    )
    def test_perspective_is_not_an_position_dependent_error(self, monkeypatch, learnt, offset, expected):
        seen = markers_of("rotor", (50.0,))
        monkeypatch.setattr(module, "axis_offset", lambda *_: np.array([0.0, offset]))
        found = error_by_place(seen, Flattening({}, 0.0, 0.0), body([0.0], place_error=learnt / 50.0))
        assert found == pytest.approx(usual_error_by_place(seen) if expected == "usual" else expected)

    def test_an_axis_is_shrunk_by_its_uncertainty_and_never_inverted(self):
        shrunk = module._shrunk
        np.testing.assert_allclose(
            shrunk(np.array([3.0, 4.0]), 1.0), np.array([3.0, 4.0]) * (1 - 2 / 25), rtol=1e-6
        )
        assert not shrunk(np.array([0.1, 0.0]), 1.0).any()
        seen = markers_of("rotor", (50.0,))
        flat = Flattening({"rotor0": (0.0, 0.0)}, 0.0, 0.0)
        found = axis_offset(seen, flat, body([0.0], axis_off={"rotor0": (0.3 - 0.4j) / 50.0}))
        error = np.sqrt(2.0) * usual_error_of_harmonic(seen)
        np.testing.assert_allclose(found, np.array([0.3, -0.4]) * (1 - 2 * error**2 / 0.25), rtol=1e-6)
        assert not axis_offset(seen, flat, body([0.0])).any()


class TestUncertaintyOfTheView:
    def test_the_height_of_the_disc_counts_by_the_tilt(self):
        seen = markers_of("rotor", (50.0,))
        tilted = Flattening({"rotor0": (0.0, 0.0)}, 0.1**2 / 4, 0.0)
        assert tilted.tilt == pytest.approx(0.1)
        expected = np.hypot(HEIGHT * 0.1 * 90.0, LEAST_SIGMA)
        assert module._height_error(tilted, seen, 90.0) == pytest.approx(expected)
        # an offset of 10 px at a depth of half a radius of 50 px shows a tilt of 0.4 rad
        shifted = Flattening({"rotor0": (6.0, 8.0)}, 0.1**2 / 4, 0.0)
        expected = np.hypot(HEIGHT * 0.4 * 90.0, LEAST_SIGMA)
        assert module._height_error(shifted, seen, 90.0) == pytest.approx(expected)

    def test_offsets_and_tilt_are_the_rms_over_the_markers(self):
        angle = np.linspace(0.0, TURN, 400, endpoint=False)
        seen = {name: SimpleNamespace(angle=angle) for name in ("a", "b")}
        flat = Flattening({}, 0.0, 0.0, {"a": 0.04 * np.eye(2)}, error=0.003)
        assert offset_uncertainty(seen, flat) == pytest.approx(np.full(400, 0.2 / np.sqrt(2.0)))
        assert module._tilt_uncertainty(seen, flat) == pytest.approx(np.full(400, 0.003))

    def test_a_tilt_is_positive_along_its_axis_and_has_no_part_across(self):
        seen = {"rotor": markers_of("rotor", (70.0,))}
        flat = {"rotor": Flattening({"rotor0": (0.0, 0.0)}, -0.01, 0.0)}
        strong = module._common_tilt(flat, seen, 1e-4)
        assert strong == pytest.approx(-0.01, rel=1e-3)
        # at zero the posterior mean of a half normal distribution, at most of the size of its error
        weak = module._common_tilt({"rotor": replace(flat["rotor"], p=-1e-9)}, seen, 1e-3)
        assert abs(weak) == pytest.approx(1e-3 * np.sqrt(2 / np.pi), rel=1e-3)

    def test_bodies_count_by_their_markers(self):
        seen = {"rotor": markers_of("rotor", (70.0, 70.0, 70.0)), "casing": markers_of("casing", (70.0,))}
        flat = {
            "rotor": Flattening({f"rotor{k}": (0.0, 0.0) for k in range(3)}, -0.02, 0.0),
            "casing": Flattening({"casing0": (0.0, 0.0)}, -0.01, 0.0),
        }
        assert module._common_tilt(flat, seen, 1e-5) == pytest.approx(-0.0175, rel=1e-3)

    @pytest.mark.parametrize(
        ("p", "offset", "azimuth"),
        [(-0.01, (0.0, 0.0), 0.0), (0.01, (0.0, 0.0), np.pi / 2), (-1e-9, (3.0, 3.0), np.pi / 4)],
    )
    def test_ellipse_and_offset_show_the_azimuth(self, p, offset, azimuth):
        seen = {"rotor": markers_of("rotor", (70.0,))}
        flat = {"rotor": Flattening({"rotor0": offset}, p, 0.0)}
        found = module._azimuth(complex(p, 0.0), 1e-3, flat, seen)
        assert abs(np.sin(found - azimuth)) < 1e-6  # a line, without a sense

    def test_the_one_with_less_variance_decides_the_azimuth(self):
        """An ellipse along x and an offset along y, with variances of which one is nine times the other."""
        seen = {"rotor": markers_of("rotor", (70.0,))}
        own = usual_error_of_harmonic(seen["rotor"])
        for ratio, azimuth in ((3.0, 0.0), (1.0 / 3.0, np.pi / 2)):
            flat = {"rotor": Flattening({"rotor0": (0.0, own * 2.0 / ratio)}, -0.01, 0.0)}
            found = module._azimuth(-0.01 + 0j, 0.01, flat, seen)
            assert abs(np.sin(found - azimuth)) < 1e-6


class TestPathOfTheHub:
    def test_a_change_has_to_be_significant(self):
        rng = np.random.default_rng(0)
        before = rng.chisquare(1, (2, 1600))
        assert not module._is_better(before, before)
        assert not module._is_better(before, rng.chisquare(1, (2, 1600)))
        assert module._is_better(1.5 * before, before)
        assert not module._is_better(before, 1.5 * before)

    def test_the_threshold_is_four_standard_errors_of_groups(self):
        """Groups of 16 frames whose gains have a known mean and standard deviation."""
        after = np.ones((1, 1600))
        for mean, better in ((0.35, False), (0.45, True)):
            gain = mean + np.where(np.arange(100) % 2, 1.0, -1.0)  # standard error 1 / sqrt(99) = 0.1005
            before = after + np.repeat(gain, 16)
            assert module._is_better(before, after) is better

    def test_one_outlier_and_two_groups_decide_nothing(self):
        after = np.ones((1, 1600))
        before = after.copy()
        before[0, 100] = 1e9
        assert not module._is_better(before, after)
        assert not module._is_better(2.0 * after[:, :32], after[:, :32])

    @pytest.mark.parametrize("outlier", [5.0, -5.0])
    def test_an_offset_on_the_casing_is_recovered_from_radii(self, outlier):
        rng = np.random.default_rng(1)
        direction = np.angle(np.exp(1j * 0.37 * np.arange(2000)))
        casing = 0.01 * np.arange(2000)
        d = np.array([0.6, -0.3])
        relative = direction - casing
        excess = -(d[0] * np.cos(relative) + d[1] * np.sin(relative)) + 0.05 * rng.standard_normal(2000)
        excess += (
            0.4 * np.cos(direction) - 0.2 * np.sin(2 * direction) + 0.7
        )  # offset and flattening of the orbit
        excess[::97] += outlier
        normal, right = module._offset_on_casing(Radii(direction, excess), casing)
        np.testing.assert_allclose(np.linalg.solve(normal, right), d, atol=0.01)
        # the normal equations are in units of the variance: their inverse is the covariance, 0.05^2 / (n / 2)
        used = min(2000, module.MOST_OBSERVATIONS)
        np.testing.assert_allclose(
            np.linalg.inv(normal), np.eye(2) * 0.05**2 * 2 / used, atol=0.6 * 0.05**2 * 2 / used
        )

    def test_a_casing_that_covers_a_short_arc_determines_nothing(self):
        n = 400
        seen = {"casing": markers_of("casing", (90.0,), rate=0.9 / n), "rotor": markers_of("rotor", (70.0,))}
        one = path(n)
        assert about_rotor(one, seen) is one


class TestBodies:
    @pytest.mark.parametrize(
        ("spread", "other", "rest"),
        [(0.04, 1.1, True), (0.06, 1.1, False), (0.04, 0.9, False), (0.0, 2.0, True)],
    )
    def test_a_body_is_at_rest_beside_one_that_turns(self, spread, other, rest):
        still, turning = body(np.linspace(0.0, spread, 9)), body(np.linspace(0.0, other, 9))
        assert module._at_rest(still, turning) is rest

    @pytest.mark.parametrize(
        ("known", "sigma", "credible"),
        [(6, 0.1, True), (4, 0.1, False), (6, 0.19, True), (6, 0.21, False), (100, 0.1, True)],
    )
    def test_a_credible_body_is_known_in_a_twentieth_of_the_frames(self, known, sigma, credible):
        angle = np.full(100, np.nan)
        angle[:known] = 1.0
        assert module._credible(body(angle, sigma)) is credible
        assert not module._credible(body(angle[:2] if known > 1 else angle, sigma))

    @pytest.mark.parametrize("sense", [1, -1])
    def test_mount_angles_of_the_profile_shift_the_zero(self, sense):
        marker = {
            "red": MarkerAngles(np.zeros(3), np.zeros(3), 0.4),
            "green": MarkerAngles(np.zeros(3), np.zeros(3), 1.0),
        }
        seen = replace(body([2.0, 2.1, 2.2]), markers=marker)
        profile = SimpleNamespace(
            marker=[SimpleNamespace(name="red", mount_angle=0.9), SimpleNamespace(name="x", mount_angle=3.0)]
        )
        found = module._zeroed(seen, profile, sense)
        assert found.markers["red"].mount == pytest.approx(sense * 0.9)
        assert found.markers["green"].mount - found.markers["red"].mount == pytest.approx(0.6)
        # a marker stays where it is: mount and angle change oppositely
        assert found.angle + found.markers["red"].mount == pytest.approx(seen.angle + 0.4)

    @pytest.mark.parametrize(
        ("casing", "given", "unaliased"),
        [(0.0, None, True), (0.49, None, True), (-0.51, None, False), (9.0, None, False), (0.0, 1, False)],
    )
    def test_a_rotor_that_speeds_up_turns_the_other_way_unless_the_sense_is_known(
        self, casing, given, unaliased
    ):
        """By 234 degrees per frame and less, seen as 126 degrees backwards and more."""
        frame = np.arange(200.0)
        true = TURN * (0.65 * frame - 2e-4 * frame**2)
        bodies = {"rotor": body(true - TURN * frame), "casing": body(np.linspace(0.0, casing, 200))}
        warnings = module._unalias(bodies, given)
        assert bool(warnings) is unaliased
        expected = true if unaliased else true - TURN * frame
        assert bodies["rotor"].angle == pytest.approx(expected)

    def test_a_body_that_speeds_up_is_doubted(self):
        frame = np.arange(200.0)
        slows = TURN * (0.65 * frame - 2e-4 * frame**2)
        assert not module._undecided({"rotor": body(slows)})
        (text,) = module._undecided({"rotor": body(slows - TURN * frame)})
        assert text.startswith("The rotor: ")


class TestPerspective:
    """The offset of a casing's orbit below a marked hub, with the axis of the rotor by angles and by radii."""

    def seen(self, offset, axis, tilt=0.1):
        views = {"casing": markers_of("casing", (90.0,)), "rotor": markers_of("rotor", (60.0,))}
        p = -(tilt**2) / 4
        flat = {
            "casing": Flattening({"casing0": offset}, p, 0.0, error=1e-5),
            "rotor": Flattening({"rotor0": axis}, p, 0.0, error=1e-5),
        }
        return views, flat

    def test_without_perspective_an_offset_near_zero_is_hardly_changed(self):
        views, flat = self.seen((0.05, 0.0), (0.0, 0.0))
        rotor = body([0.0], axis_off={"rotor0": 0j})
        found = separate_perspective(path(), views, flat, rotor)
        assert 0.0 < found.offset["casing0"][0] < 0.05
        size = module._height_error(flat["rotor"], views["rotor"], 90.0)
        noise = found.offset_covariance["casing0"][0, 0]
        assert 0.0 < noise < size**2

    def test_perspective_grows_with_the_square_of_the_radius_and_is_subtracted(self):
        """The angles of the rotor are about e, its radii about e - 1 px: perspective of the casing 2.25 px."""
        views, flat = self.seen((-2.25, 0.0), (-1.0, 0.0))
        rotor = body([0.0], axis_off={"rotor0": 1.0 / 60.0})
        found = separate_perspective(path(), views, flat, rotor)
        np.testing.assert_allclose(found.offset["casing0"], (0.0, 0.0), atol=0.1)
        views, flat = self.seen((2.25, 0.0), (1.0, 0.0))
        rotor = body([0.0], axis_off={"rotor0": -1.0 / 60.0})
        found = separate_perspective(path(), views, flat, rotor)
        np.testing.assert_allclose(found.offset["casing0"], (0.0, 0.0), atol=0.1)

    @pytest.mark.parametrize("offset", [0.2, 0.45, 0.55, 0.8])
    def test_the_offset_is_a_mixture_of_both_expected_ones(self, offset):
        """Zero and that of the rotor, each within the uncertainty of its height; no perspective."""
        views, flat = self.seen((offset, 0.0), (1.0, 0.0))
        rotor = body([0.0], axis_off={"rotor0": 0j})
        nu = module.BORROWED_NU
        variance = module.usual_error_of_harmonic(views["rotor"]) ** 2 * nu / (nu + 1.0)
        axis = 1.0 - 2.0 * variance
        assert 0.5 < axis < 1.0
        noise = variance * (1.0 + (90.0 / 60.0) ** 4)
        size = module._height_error(flat["rotor"], views["rotor"], 90.0) ** 2
        weights = np.exp([-0.5 * (offset - e) ** 2 / (size + noise) for e in (0.0, axis)])
        means = np.array([e + size / (size + noise) * (offset - e) for e in (0.0, axis)])
        expected = float(weights @ means / weights.sum())
        found = separate_perspective(path(), views, flat, rotor)
        assert found.offset["casing0"] == pytest.approx((expected, 0.0), abs=1e-6)
        along = size * noise / (size + noise) + float(weights @ (means - expected) ** 2 / weights.sum())
        assert found.offset_covariance["casing0"][0, 0] == pytest.approx(along)

    def test_orbits_without_offsets_are_left_alone(self):
        views, flat = self.seen((0.5, 0.0), (1.0, 0.0))
        for name in flat:
            without = flat | {name: replace(flat[name], offset={})}
            assert separate_perspective(path(), views, without, body([0.0])) is without["casing"]


class TestTexture:
    """The choice between the angles of texture and markers, n frames of a body that turns fast."""

    N = 6400

    def both(self, marker_sigma, texture_sigma, seed=0, periodic=0.0):
        rng = np.random.default_rng(seed)
        n = self.N
        true = 0.19 * np.arange(n)
        marker = body(true + marker_sigma * rng.standard_normal(n), marker_sigma)
        column = np.ones(n)
        texture = TextureObservations(
            true - 0.3 + texture_sigma * rng.standard_normal(n),
            texture_sigma * column, 0.1 * texture_sigma * column, column,
            np.tile(CENTRE, (n, 1)), np.tile([periodic, 0.0], (n, 1)), self.moments(n), 0.0 * column,
        )  # fmt: skip
        flat = Flattening({}, 0.0, 0.0)
        return true, marker, by_texture(marker, texture, path(n, 0.0), flat, true, 250.0, 1e-3, 100.0)

    def moments(self, n):
        """Moments of which those of each template differ."""
        return np.stack([1e-9 * (np.arange(n) // module.BATCH), np.zeros(n)], axis=1)

    def test_the_more_precise_angle_is_taken_with_the_zero_of_the_markers(self):
        true, _, found = self.both(2e-3, 5e-4)
        error = found.angle - true
        assert error.std() < 0.7e-3
        assert abs(error.mean()) < 0.15e-3
        assert np.median(found.sigma) == pytest.approx(5e-4, rel=0.3)
        assert found.slow[1] == module.BATCH

    def test_a_less_precise_one_is_not(self):
        _, marker, found = self.both(5e-4, 2e-3)
        assert found is marker

    def test_the_centre_is_uncertain_by_its_error_over_the_radius(self):
        _, _, found = self.both(2e-3, 5e-4, periodic=0.002)
        # equal templates share their harmonics, which the markers determine from all frames
        of_templates = 2e-3 * math.sqrt(2.0 / self.N)
        assert found.periodic == pytest.approx(math.hypot(0.002 * CENTRE_ERROR, of_templates), rel=1e-3)
        assert found.slow[0] > 0.0
        middle, size = found.slow_parts.T
        assert middle[:2] == pytest.approx([0.5 * (module.BATCH - 1), 1.5 * module.BATCH - 0.5])
        assert np.all(np.diff(middle) > 0)
        assert np.sqrt(np.mean(size**2)) == pytest.approx(found.slow[0], rel=0.2)

    def arc(self, *, own, slow=1e-4, first=0.0, second=0.0, flat=0.0, usual=RING_ERROR):
        """Return the uncertainty of a body over an arc of 1.5 turns, by a ring about its own view or another one."""
        n = 300
        true = np.linspace(0.0, 3.0 * np.pi, n)
        rng = np.random.default_rng(1)
        marker = body(true + 4e-3 * rng.standard_normal(n), 4e-3)
        column = np.ones(n)
        ring = TextureObservations(
            true - 0.3 + 2e-4 * rng.standard_normal(n), 2e-4 * column, slow * column, column,
            np.tile(CENTRE, (n, 1)), np.tile([first, 0.0], (n, 1)), np.tile([second, 0.0], (n, 1)), own * column,
        )  # fmt: skip
        view = Flattening({}, 0.0, 0.0, error=flat)
        return float(np.median(by_texture(marker, ring, path(n, 0.0), view, true, 250.0, usual, 200.0).sigma))

    def test_the_error_of_its_own_view_is_not_counted_again(self):
        alone = self.arc(own=0.0)
        assert self.arc(own=1.0, first=4e-3, second=1.0, flat=1e-3) == pytest.approx(alone, rel=0.05)
        assert self.arc(own=0.0, first=4e-3) > 2.0 * alone
        assert self.arc(own=0.0, second=1.0, flat=1e-3) > 2.0 * alone

    def test_views_with_large_errors_count(self):
        few = np.where(np.arange(300) < 120, 3e-3, 1e-4)
        assert self.arc(own=1.0, slow=few) > 2.5 * self.arc(own=1.0)

    def test_its_own_view_has_the_error_of_a_ring(self):
        assert self.arc(own=1.0, usual=0.6) == pytest.approx(self.arc(own=1.0), rel=0.01)
        assert self.arc(own=0.0, usual=0.6) > 3.0 * self.arc(own=1.0)

    @pytest.mark.parametrize(
        ("rate", "share", "learnt"), [(0.9, 1.0, False), (1.1, 0.1, False), (1.1, 0.5, True)]
    )
    def test_fast_frames_show_the_errors_once_per_turn(self, rate, share, learnt):
        """In the slow frames, the template responds to the centre, and in the fast ones it does not."""
        n = self.N
        fast = np.arange(n) >= n * (1.0 - share)
        true = np.cumsum(np.where(fast, rate, 0.8) * FAST / 250.0)
        rng = np.random.default_rng(2)
        marker = body(true + 2e-3 * rng.standard_normal(n), 2e-3)
        column = np.ones(n)
        first = np.stack([np.where(fast, 1e-3, 3e-3), np.zeros(n)], axis=1)
        ring = TextureObservations(
            true + 5e-4 * rng.standard_normal(n), 5e-4 * column, 5e-5 * column, column,
            np.tile(CENTRE, (n, 1)), first, self.moments(n), 0.0 * column,
        )  # fmt: skip
        found = by_texture(marker, ring, path(n, 0.0), Flattening({}, 0.0, 0.0), true, 250.0, 1e-3, 100.0)
        largest = 1e-3 if share == 1.0 else 3e-3
        expected = (
            math.hypot(2e-3 * CENTRE_ERROR, module.LEAST_PERIODIC) if learnt else largest * CENTRE_ERROR
        )
        changes = module.change_with_speed(ring.angle, 250.0, fast & (rate > 1.0)).error
        assert (changes > 0.0) == learnt
        of_templates = 2e-3 * math.sqrt(2.0 / n)
        assert found.periodic == pytest.approx(math.hypot(expected, changes, of_templates), rel=0.01)

    def test_an_error_that_grows_with_the_speed_is_removed(self):
        n = 6 * 512
        speed = np.linspace(0.3, 1.7, n) * FAST
        true = np.cumsum(speed) / 250.0
        rng = np.random.default_rng(2)
        marker, column = body(true + 2e-3 * rng.standard_normal(n), 2e-3), np.ones(n)
        ring = TextureObservations(
            true + 3e-3 * speed / 100.0 * np.sin(true) + 5e-4 * rng.standard_normal(n), 5e-4 * column,
            5e-5 * column, column, np.tile(CENTRE, (n, 1)), np.zeros((n, 2)), np.zeros((n, 2)), 0.0 * column,
        )  # fmt: skip
        found = by_texture(marker, ring, path(n, 0.0), Flattening({}, 0.0, 0.0), true, 250.0, 1e-3, 100.0)
        slow = (found.angle - true)[:1000]
        assert 2.0 * abs(np.mean((slow - slow.mean()) * np.exp(-1j * true[:1000]))) < 0.4e-3

    def test_frames_without_texture_keep_the_angle_of_the_markers(self):
        true, marker, _ = self.both(2e-3, 5e-4)
        column = np.ones(self.N)
        seen = np.where(np.arange(self.N) < 500, np.nan, true - 0.3)
        texture = TextureObservations(
            seen, 5e-4 * column, 5e-5 * column, column,
            np.tile(CENTRE, (self.N, 1)), np.zeros((self.N, 2)), np.zeros((self.N, 2)), 0.0 * column,
        )  # fmt: skip
        found = by_texture(
            marker, texture, path(self.N, 0.0), Flattening({}, 0.0, 0.0), true, 250.0, 1e-3, 100.0
        )
        assert (found.angle[:500] == marker.angle[:500]).all()
        assert np.abs(found.angle[600:] - true[600:]).max() < 1e-3
