"""Formulas of the texture of a body: means of frames and zones, errors of zones, the motion in a batch, the view."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.tracking import _texture as texture
from gyrotrack.tracking._texture import COLUMNS, MARGIN, ROWS, TURN, ZONES, TextureObservations

EMPTY = {name: np.zeros((ZONES, ROWS * COLUMNS), np.float32) for name in ("picture", "variance", "weight")}


def zones(**change):
    given = {
        **EMPTY,
        "basis": np.zeros((ZONES, ROWS * COLUMNS, 3), np.float32),
        "usual": np.ones(ZONES),
        "first": np.zeros(ZONES, complex),
        "second": np.zeros(ZONES, complex),
        "share": np.full(ZONES, 1 / ZONES),
    }
    return texture._Zones(**{**given, **change})


class TestMeans:
    @pytest.mark.parametrize(("unknown", "known"), [(7, True), (8, False)])
    def test_a_mean_of_sixteen_frames_is_known_from_nine(self, unknown, known):
        turned = np.tile(np.arange(40.0), (2, 1))
        turned[1, :unknown] = np.nan
        found = texture._means(turned)
        assert found.shape == (2, 2)  # 32 of 40 frames
        assert found[0].tolist() == [7.5, 23.5]
        assert found[1, 0] == (pytest.approx((7 + 15) / 2) if known else pytest.approx(np.nan, nan_ok=True))
        assert found[1, 1] == 23.5

    @pytest.mark.parametrize(("lost", "known"), [(0.45, True), (0.55, False)])
    def test_a_mean_of_zones_needs_half_of_the_weight(self, lost, known):
        share = np.zeros(ZONES)
        share[[1, 4]] = lost, 1.0 - lost
        turned = np.full((ZONES, 2), 9.0)
        turned[1], turned[4] = 3.0, [5.0, 7.0]
        turned[1, 1] = np.nan
        mean, total = zones(share=share).mean(turned)
        assert mean[0] == pytest.approx(3.0 * lost + 5.0 * (1.0 - lost))
        assert mean[1] == pytest.approx(7.0 if known else np.nan, nan_ok=True)
        assert total == pytest.approx([1.0, 1.0 - lost if known else np.nan], nan_ok=True)

    def test_observations_are_the_weighted_means_of_the_zones(self):
        share = np.zeros(ZONES)
        share[[2, 5]] = 0.25, 0.75
        first, second = np.zeros((2, ZONES), complex)
        first[[2, 5]], second[[2, 5]] = [4.0 + 2.0j, 8.0j], [1.0 - 4.0j, 2.0]
        own = zones(share=share, first=first, second=second, sigma=0.01, slow=0.004)
        turned, misfit = np.zeros((ZONES, 3)), np.ones((ZONES, 3))
        turned[2], turned[5] = [0.1, 0.1, np.nan], 0.2
        misfit[2], misfit[5] = 3.0, 5.0
        seen = TextureObservations.unknown(np.zeros((6, 2)))
        seen.set(np.array([0, 2, 5]), own, np.array([1.0, 2.0, 3.0]), turned, misfit)
        np.testing.assert_allclose(seen.angle, [1.175, np.nan, 2.175, np.nan, np.nan, 3.2])
        np.testing.assert_allclose(seen.sigma[[0, 2, 5]], [0.01, 0.01, 0.01 / 0.75])
        np.testing.assert_allclose(seen.slow[[0, 2, 5]], [0.004, 0.004, 0.004 / 0.75])
        np.testing.assert_allclose(seen.misfit[[0, 2, 5]], [4.5, 4.5, 5.0])
        np.testing.assert_allclose(seen.first, np.tile([1.0, 6.5], (6, 1)))
        np.testing.assert_allclose(seen.second, np.tile([1.75, -1.0], (6, 1)))
        assert not seen.own_view.any()


class TestZones:
    def test_the_errors_of_zones_follow_from_their_differences(self):
        """Orthogonal patterns are uncorrelated exactly; zones 0 and 1 are adjacent and not compared."""
        rng = np.random.default_rng(0)
        size = np.array([1.0, 2.0, 0.5, 3.0, 1.5]) * 1e-3
        turned = size[:, None] * rng.standard_normal((5, 4000)) + np.arange(5)[:, None]
        turned[1] = turned[0] + 1.0  # an error that both share
        expected = size.copy()
        expected[1] = size[0]
        np.testing.assert_allclose(np.sqrt(texture._zone_variances(turned)), expected, rtol=0.25)

    @pytest.mark.parametrize(("share", "known"), [(0.45, False), (0.55, True)])
    def test_a_zone_that_is_rarely_known_has_no_error(self, share, known):
        rng = np.random.default_rng(0)
        turned = 1e-3 * rng.standard_normal((5, 1000))
        turned[4, round(share * 1000) :] = np.nan
        found = texture._zone_variances(turned)
        assert np.isfinite(found[4]) == known
        assert np.isfinite(found[:4]).all()

    def test_a_variance_is_a_tenth_of_that_of_the_least_difference_at_least(self):
        rng = np.random.default_rng(1)
        common = rng.standard_normal(4000)
        # the errors of 0 and 4 are opposite: without a limit, that of zone 2 would be negative
        turned = 1e-3 * np.stack([common, np.full(4000, np.nan), 0 * common, np.full(4000, np.nan), -common])
        found = texture._zone_variances(turned)
        assert found[2] == pytest.approx(0.1 * 1e-6, rel=0.1)
        assert found[0] == pytest.approx(found[4], rel=0.05)
        assert found[0] > 0.7e-6

    def test_the_rotation_between_batches_is_that_of_their_pictures(self):
        theta = np.arange(COLUMNS) * TURN / COLUMNS

        def learnt(turn, share):
            rows = np.stack([100 + 30 * np.cos(3 * (theta - turn) + k) for k in range(ROWS)]).ravel()
            every = np.tile(rows, (ZONES, 1)).astype(np.float32)
            return zones(picture=every, variance=np.ones_like(every), weight=np.ones_like(every), share=share)

        share = np.full(ZONES, 1 / ZONES)
        assert learnt(0.02, share).ahead_of(learnt(0.0, share)) == pytest.approx(0.02, rel=0.02)
        assert learnt(-0.01, share).ahead_of(learnt(0.01, share)) == pytest.approx(-0.02, rel=0.02)
        assert learnt(0.02, share).ahead_of(learnt(0.0, np.zeros(ZONES))) == 0.0
        # only zones with a weight in both batches count
        one, two = np.eye(ZONES)[3], np.eye(ZONES)[4]
        assert learnt(0.02, one).ahead_of(learnt(0.0, two)) == 0.0
        assert learnt(0.02, 0.5 * one + 0.5 * two).ahead_of(learnt(0.0, two)) == pytest.approx(0.02, rel=0.02)

    def test_the_slow_error_is_that_of_the_weighted_zones(self, monkeypatch):
        share = np.zeros(ZONES)
        share[[0, 3]] = 0.6, 0.4
        variance = np.full(ZONES, np.inf)
        variance[0], variance[5] = 4e-6, 9e-6
        monkeypatch.setattr(texture, "zone_weights", lambda angle, first, shift: (share, 0.007))
        monkeypatch.setattr(texture, "_zone_variances", lambda _: variance)
        found = zones().weighted(np.zeros((ZONES, 32)), np.zeros((ZONES, 32)), 0.3)
        assert found.sigma == 0.007
        # a zone of unknown error has the largest known one
        assert found.slow == pytest.approx(math.sqrt(0.36 * 4e-6 + 0.16 * 9e-6))


class TestMotion:
    PLACE = np.linspace(-1.0, 1.0, 512)

    @pytest.mark.parametrize(("degree", "columns"), [(2, 4), (3, 4), (5, 7), (6, 7), (9, 13), (20, 13)])
    def test_a_motion_is_described_by_the_first_sufficient_degree(self, degree, columns):
        motion = 2.0 * np.polynomial.legendre.legval(self.PLACE, np.eye(degree + 1)[degree])
        found = texture._smooth_motion(motion, self.PLACE, 1e-3)
        assert found.shape == (512, columns)
        assert found[:, 1] == pytest.approx(self.PLACE)

    @pytest.mark.parametrize(("factor", "columns"), [(0.5, 7), (2.0, 4)])
    def test_a_degree_suffices_if_its_residual_is_below_the_limit(self, factor, columns):
        rest = 0.01 * np.where(np.arange(512) // 2 % 2, 1.0, -1.0) * (np.abs(self.PLACE) < 2)
        wave = 0.5 * np.polynomial.legendre.legval(self.PLACE, [0, 0, 0, 0, 0, 1.0])
        residual = wave + 0.0 * rest
        scatter = 1.4826 * np.median(np.abs(residual - np.median(residual)))
        assert texture._smooth_motion(wave, self.PLACE, factor * scatter).shape[1] == columns

    @pytest.mark.parametrize(("turns", "columns"), [(2.9, 4), (3.1, 13 + 4)])
    def test_harmonics_are_removed_over_three_turns(self, turns, columns):
        angle = 0.5 * turns * TURN * self.PLACE
        found = texture._smooth_motion(angle, self.PLACE, 1e-3)
        assert found.shape[1] == columns
        if columns > 13:
            expected = np.stack([np.cos(angle), np.sin(angle), np.cos(2 * angle), np.sin(2 * angle)], axis=1)
            np.testing.assert_allclose(found[:, 13:], expected)

    def test_few_frames_have_a_low_degree(self):
        """One degree for twice sixteen frames."""
        place = np.linspace(-1.0, 1.0, 70)
        assert texture._smooth_motion(np.sin(9 * place), place, 1e-9).shape[1] == 3
        assert texture._smooth_motion(np.sin(9 * place[:20]), place[:20], 1e-9).shape[1] == 2

    def test_residuals_are_orthogonal_to_the_basis(self):
        basis = np.stack([np.ones(9), np.arange(9.0)], axis=1)
        values = np.stack([3.0 + 2.0 * np.arange(9.0), np.arange(9.0) ** 2], axis=1)
        found = texture._residual(values, basis)
        np.testing.assert_allclose(found[:, 0], 0.0, atol=1e-9)
        np.testing.assert_allclose(basis.T @ found, 0.0, atol=1e-9)
        assert found[4, 1] == pytest.approx(-20.0 / 3.0)


@pytest.mark.parametrize("ahead", [0.0, 2.0, -3.0, 1.5])
def test_a_strip_is_turned_by_columns_without_its_margins(ahead):
    strip = np.tile(np.arange(COLUMNS + 2 * MARGIN, dtype=np.float32) ** 1.0, (3, 1))
    found = texture._columns_ahead(strip, ahead)
    assert found.shape == (3, COLUMNS)
    np.testing.assert_allclose(found[1], np.arange(COLUMNS) + MARGIN + ahead, atol=1e-3)


@pytest.mark.parametrize(("known", "measured"), [(3, False), (4, True)])
def test_four_frames_show_the_derivative_along_the_radius(monkeypatch, known, measured):
    tracker = texture.TextureTracker((60.0, 50.0), 40.0, (120, 100), 20)
    slopes = {
        2 * k: np.full((ZONES * ROWS, COLUMNS + 2 * MARGIN), float(k), np.float32) for k in range(known)
    }
    tracker._slopes = slopes
    picture = np.broadcast_to(7.0 * tracker._radius[:, None], (ZONES * ROWS, COLUMNS))
    monkeypatch.setattr(tracker, "_turned", lambda use, ahead: np.stack([picture] * len(use)))
    found = tracker._radial_slope(np.arange(12), np.zeros(12))
    np.testing.assert_allclose(found, np.mean(range(known)) if measured else 7.0, rtol=1e-5)


class TestLevelled:
    ANGLE = np.array([0.0, 0.5 * np.pi, 2.0])

    def observed(self, own=0.0, centre=(0.0, 0.0)):
        first, second = np.tile([0.01, 0.02], (3, 1)), np.tile([0.3, -0.1], (3, 1))
        nothing = np.zeros(3)
        return TextureObservations(
            self.ANGLE.copy(), nothing, nothing, nothing, np.tile(centre, (3, 1)), first, second, np.full(3, own)
        )  # fmt: skip

    def test_a_displaced_centre_and_a_flattening_turn_the_ring(self):
        """The centre is 3 px to the right and 4 px below, y is upwards in the formula."""
        found = self.observed(centre=(10.0, 20.0)).levelled(np.tile([13.0, 24.0], (3, 1)), 0.02, -0.05)
        z, m1, f, m2 = 3.0 - 4.0j, 0.01 + 0.02j, 0.02 - 0.05j, 0.3 - 0.1j
        expected = (
            self.ANGLE
            - np.imag(z * m1 * np.exp(-1j * self.ANGLE))
            - np.imag(f * m2 * np.exp(-2j * self.ANGLE))
        )
        np.testing.assert_allclose(found, expected)
        # at the angle 0: z m1 = 0.11 + 0.02 i, f m2 = 0.001 - 0.017 i
        assert found[0] == pytest.approx(-0.02 + 0.017)

    def test_a_ring_about_its_own_view_needs_no_flattening_and_no_constant_displacement(self):
        seen = self.observed(own=1.0)
        np.testing.assert_allclose(seen.levelled(np.tile([3.0, 4.0], (3, 1)), 0.02, -0.05), self.ANGLE)
        moving = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 0.0]])
        z = np.array([-1.0, 2.0, -1.0])  # relative to the mean
        expected = self.ANGLE - np.imag(z * (0.01 + 0.02j) * np.exp(-1j * self.ANGLE))
        np.testing.assert_allclose(seen.levelled(moving, 0.02, -0.05), expected)

    def test_frames_are_placed_and_picked(self):
        seen = self.observed(centre=(10.0, 20.0))
        spread = seen.spread_out(np.array([1, 2, 4]), 6)
        np.testing.assert_allclose(spread.angle, [np.nan, *self.ANGLE[:2], np.nan, self.ANGLE[2], np.nan])
        again = spread.picked(np.array([1, 2, 4]))
        for name in ("angle", "centre", "first", "second", "own_view"):
            np.testing.assert_array_equal(getattr(again, name), getattr(seen, name))


@pytest.mark.parametrize(
    ("x", "outer", "useful", "largest"),
    [
        (60.0, 40.0, True, 48.0 - 0.0),
        (60.0, 20.0, True, 27.0),
        (31.0, 40.0, True, 29.0),
        (29.5, 40.0, False, 27.5),
    ],
)
def test_a_ring_is_within_the_picture_and_reaches_seven_tenths(x, outer, useful, largest):
    """From 0.15 to 1.35 of the outer end of the markers, and 2 px within the picture of 121 x 101 px."""
    tracker = texture.TextureTracker((x, 50.0), outer, (121, 101), 3)
    edges = np.linspace(0.15 * outer, largest, ZONES * ROWS + 1)
    np.testing.assert_allclose(tracker._radius, 0.5 * (edges[1:] + edges[:-1]))
    assert tracker._useful is np.bool_(useful) or tracker._useful == useful
    frame = SimpleNamespace(y=np.full((101, 121), 9, np.uint8))
    tracker.take([frame] * 3, 0, np.array([0.1, np.nan, 0.2]))
    assert tracker._strips[[0, 2]].all() == useful
    assert list(tracker._slopes) == ([0] if useful else [])


class TestBatches:
    """Which batches learn templates, and what their angles are relative to; pictures and fits are replaced."""

    class Zones:
        share, first, second = np.full(ZONES, 1 / ZONES), np.zeros(ZONES, complex), np.zeros(ZONES, complex)
        sigma, slow = 0.01, 0.004

        def fit_blocks(self, blocks):
            count = sum(len(b) for b in blocks)
            return np.full((ZONES, count), 0.002), np.ones((ZONES, count))

        def weighted(self, angle, turned, shift):
            return self

        def ahead_of(self, other):
            return 0.1

        def mean(self, turned):
            return turned.mean(axis=0), np.ones(turned.shape[1])

    def measure(self, monkeypatch, *counts, turns=0.5, known=True):
        """Measure batches of some frames each; return their observations, and the numbers of frames learnt from."""
        tracker = texture.TextureTracker((60.0, 50.0), 40.0, (120, 100), 600)
        learnt, lights = [], []
        own = SimpleNamespace(zones=self.Zones(), known=known, error=0.003)

        def templates(strips, radius):
            learnt.append(len(strips))
            return self.Zones()

        monkeypatch.setattr(texture, "_templates", templates)
        monkeypatch.setattr(
            texture, "static_light", lambda lit, angle, lowest: lights.append((len(lit), lowest)) or 1.0
        )
        monkeypatch.setattr(tracker, "_turned", lambda use, ahead, light=None: np.zeros((len(use), 1, 1)))
        monkeypatch.setattr(
            tracker,
            "_align",
            lambda use, rough, view: (
                own,
                rough,
                np.full((ZONES, len(use)), 0.005),
                np.ones((ZONES, len(use))),
            ),
        )
        found = []
        for count in counts:
            angle = np.linspace(0.0, turns * TURN, count)
            tracker._angle[:count] = angle
            found.append(tracker.measure(count, angle))
        return found, learnt, lights

    @pytest.mark.parametrize(
        ("counts", "learnt"),
        [
            ((47,), []),
            ((48,), [48]),
            ((48, 255), [48]),
            ((48, 256), [48, 256]),
            ((512, 30), [256]),
            ((600,), [200]),
        ],
    )
    def test_templates_are_learnt_first_from_48_frames_and_again_from_256(self, monkeypatch, counts, learnt):
        """From 256 frames of a batch at most, equally spaced."""
        assert self.measure(monkeypatch, *counts)[1] == learnt

    def test_angles_continue_from_the_zero_of_the_first_templates(self, monkeypatch):
        found, *_ = self.measure(monkeypatch, 300, 100, 300, 300)
        for (seen, aligned), zero in zip(found, (0.0, 0.0, 0.1, 0.2), strict=True):
            angle = np.linspace(0.0, 0.5 * TURN, len(seen.angle))
            np.testing.assert_allclose(seen.angle, angle + zero + 0.002, atol=1e-9)
            np.testing.assert_allclose(aligned.angle, angle + zero + 0.005, atol=1e-9)
            np.testing.assert_allclose(aligned.slow, np.hypot(0.004, 0.003))
            np.testing.assert_allclose(seen.slow, 0.004)
        assert [set(aligned.own_view.tolist()) for _, aligned in found] == [{1.0}, {2.0}, {3.0}, {4.0}]

    def test_an_unknown_view_is_that_of_the_markers(self, monkeypatch):
        ((_, aligned),), *_ = self.measure(monkeypatch, 300, known=False)
        assert not aligned.own_view.any()

    @pytest.mark.parametrize(
        ("turns", "slow", "lit"),
        [(2.9, True, False), (3.1, False, False), (9.9, False, False), (10.1, False, True)],
    )
    def test_slow_batches_have_their_own_view_and_fast_ones_no_static_light(
        self, monkeypatch, turns, slow, lit
    ):
        ((_, aligned),), _, lights = self.measure(monkeypatch, 300, turns=turns)
        assert np.isfinite(aligned.angle).all() == slow
        assert lights == ([(150, 3)] if lit else [])  # every second of 300 frames, from the order 3 on

    @pytest.mark.parametrize(("off", "known"), [(4.9, True), (5.1, False), (-4.9, True), (-5.1, False)])
    def test_frames_far_from_their_coarse_angle_are_not_measured(self, monkeypatch, off, known):
        tracker = texture.TextureTracker((60.0, 50.0), 40.0, (120, 100), 100)
        monkeypatch.setattr(texture, "_templates", lambda *_: self.Zones())
        monkeypatch.setattr(tracker, "_turned", lambda use, ahead, light=None: np.zeros((len(use), 1, 1)))
        angle = np.linspace(0.0, 4 * TURN, 100)
        tracker._angle[:100] = angle
        tracker._angle[7] += off * texture.STEP
        seen, _ = tracker.measure(100, angle)
        assert np.isfinite(seen.angle[7]) == known
        assert np.isfinite(np.delete(seen.angle, 7)).all()
        if known:  # the pictures are turned back by steps of 1/32 of a column
            assert seen.angle[7] == pytest.approx(angle[7] + 0.002, abs=0.5 / 32 * texture.STEP + 1e-9)


def test_the_derivative_along_the_radius_is_measured_in_each_eighth_frame():
    tracker = texture.TextureTracker((60.0, 50.0), 40.0, (120, 100), 40)
    frame = SimpleNamespace(y=np.tile(2 * np.arange(120), (100, 1)).astype(np.uint8))
    angle = 0.1 * np.arange(20)
    angle[10] = np.nan
    tracker.take([frame] * 20, 6, angle)
    assert sorted(tracker._slopes) == [8, 24]  # the body is lost in the frame 16
    for k, slopes in tracker._slopes.items():
        direction = angle[k - 6] + (np.arange(COLUMNS + 2 * MARGIN) - MARGIN) * TURN / COLUMNS
        # of 2 grey levels per px to the right; rounding of both samples
        assert np.abs(slopes.mean(axis=0) - 2.0 * np.cos(direction)).mean() < 0.25
        assert np.corrcoef(slopes.mean(axis=0), np.cos(direction))[0, 1] > 0.97


def test_a_single_zone_has_no_error():
    turned = np.full((ZONES, 40), np.nan)
    turned[3] = np.random.default_rng(0).standard_normal(40)
    assert np.isinf(texture._zone_variances(turned)).all()
    assert np.isinf(texture._zone_variances(np.full((ZONES, 40), np.nan))).all()


class TestFits:
    """The fit of a zone and the template, computed a second time with NumPy."""

    THETA = np.arange(COLUMNS) * TURN / COLUMNS

    def given(self, seed=0, count=7):
        rng = np.random.default_rng(seed)
        strips = rng.normal(100.0, 20.0, (count, ZONES * ROWS, COLUMNS)).astype(np.float32)
        picture = rng.normal(100.0, 20.0, ROWS * COLUMNS).astype(np.float32)
        basis = rng.normal(0.0, 9.0, (ROWS * COLUMNS, 3)).astype(np.float32)
        weight = rng.uniform(0.5, 2.0, ROWS * COLUMNS).astype(np.float32)
        return strips, picture, basis, weight

    def test_changes_are_those_of_a_weighted_fit(self):
        strips, picture, basis, weight = self.given()
        parts, square = texture._fitted(strips, 3, picture, basis, weight)
        root = np.sqrt(weight.astype(float))
        for strip, found, left in zip(strips, parts, square, strict=True):
            off = strip[3 * ROWS : 4 * ROWS].ravel().astype(float) - picture
            expected = np.linalg.lstsq(basis * root[:, None], off * root, rcond=None)[0]
            np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-4)
            assert left == pytest.approx(weight @ (off - basis @ expected) ** 2, rel=1e-4)

    def test_residuals_are_averaged_over_the_used_frames(self):
        strips, picture, basis, _ = self.given()
        parts = np.random.default_rng(1).normal(0.0, 1.0, (7, 3))
        used = np.array([True, False, True, True, False, True, True])
        mean, square = texture._mean_residual(strips, 5, picture, basis, parts, used)
        rest = strips[:, 5 * ROWS : 6 * ROWS].reshape(7, -1) - picture - parts @ basis.T
        np.testing.assert_allclose(mean, rest[used].mean(axis=0), atol=1e-2)
        np.testing.assert_allclose(square, (rest[used] ** 2).mean(axis=0), rtol=1e-3, atol=0.1)

    def test_the_changes_of_a_picture_are_rotation_offset_and_gain(self):
        picture = np.tile(50.0 + 30.0 * np.cos(2 * self.THETA), (ROWS, 1)).astype(np.float32)
        weight = np.tile(1.0 + 0.5 * np.cos(2 * self.THETA), ROWS).astype(np.float32)
        found = texture._basis(picture.ravel(), weight)
        np.testing.assert_allclose(found[:, 0], np.tile(60.0 * np.sin(2 * self.THETA), ROWS), atol=1e-3)
        np.testing.assert_array_equal(found[:, 1], 1.0)
        # the weighted mean is 50 + 30 / 4
        np.testing.assert_allclose(found[:, 2], picture.ravel() - 57.5, atol=1e-3)

    def test_templates_have_the_mean_the_variance_and_the_moments_of_the_pictures(self):
        rng = np.random.default_rng(2)
        radius = np.linspace(20.0, 90.0, ZONES * ROWS)
        base = (
            100.0
            + 30.0 * np.cos(3 * self.THETA)
            + 12.0 * np.cos(2 * self.THETA + 0.4)
            + 9.0 * np.sin(self.THETA)
        )
        strips = (base + rng.normal(0.0, 2.0, (60, len(radius), COLUMNS))).astype(np.float32)
        strips[3:6] += 60.0 * (self.THETA < 1.0)  # a hand
        found = texture._templates(strips, radius)
        for z in (0, 4, 7):
            r = radius[ROWS * z : ROWS * (z + 1), None]
            np.testing.assert_allclose(found.picture[z].reshape(ROWS, -1).mean(axis=0), base, atol=0.6)
            assert found.variance[z].mean() == pytest.approx(4.0, rel=0.08)
            # a weight is the area divided by the variance
            size = np.repeat(r[:, 0] / radius.mean(), COLUMNS)
            assert np.median(found.weight[z] * found.variance[z] / size) == pytest.approx(1.0, rel=0.1)
            # of the weighted squares of the slope, which contains the noise of the template
            information = (found.weight[z] * found.basis[z, :, 0] ** 2).reshape(ROWS, COLUMNS).astype(float)
            total = information.sum()
            first = np.sum(information / r * np.exp(-1j * self.THETA)) / total
            second = np.sum(information * np.exp(-2j * self.THETA)) / total
            assert found.first[z] == pytest.approx(first, rel=1e-4)
            assert found.second[z] == pytest.approx(second, rel=1e-4)
            # the typical weighted sum of squares is the number of samples, times their area
            assert found.usual[z] == pytest.approx(size.sum(), rel=0.2)
        assert not found.share.any()


def test_the_least_variance_is_relative_to_the_least_difference():
    common = 1e-3 * np.random.default_rng(1).standard_normal(4000)
    nothing = np.full(4000, np.nan)
    # the differences of zone 2 have the standard deviations 1 and 2 mrad, and its own error is 0
    found = texture._zone_variances(np.stack([common, nothing, 0 * common, nothing, -2.0 * common]))
    assert found[2] == pytest.approx(0.1 * 1e-6, rel=0.1)
