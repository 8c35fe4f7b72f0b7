"""Candidates for a hub: the moving part of a film, rings, edges, spots and features, with results known in advance."""

import math

import cv2
import numpy as np
import pytest

from gyrotrack.tracking import _hub_search as search
from gyrotrack.tracking._hub_search import Motion, distance_from, ring_for
from gyrotrack.tracking._registration import TURN


def motion_of(moving, mean=None, deviation=None, noise=1.0):
    still = np.zeros(moving.shape, np.float32)
    area = (0, 0, moving.shape[1], moving.shape[0])
    mean, deviation = (still if p is None else p.astype(np.float32) for p in (mean, deviation))
    return Motion(mean, deviation, noise, moving, area)


def flickering(change, rows, columns, count=8):
    """Return frames of 40 x 60 px with bars of 5 and 3 px at the sides, and a block that changes by +-`change` / 2."""
    y, x = np.mgrid[0:40, 0:60]
    base = 60.0 + x + 2.0 * y
    frames = []
    for k in range(count):
        frame = base.copy()
        frame[rows, columns] += change * (k % 2)
        frame[:, :5] = frame[:, 57:] = 16.0
        frames.append(frame.astype(np.uint8))
    return frames


class TestMotion:
    @pytest.mark.parametrize(("change", "moves"), [(3, False), (5, True)])
    def test_the_moving_part_changes_by_four_times_the_least_noise(self, change, moves):
        frames = flickering(change, slice(10, 20), slice(20, 40))
        found = Motion.of(frames)
        assert found.noise == 0.5
        np.testing.assert_allclose(found.mean, np.mean(frames, axis=0), rtol=1e-6)
        np.testing.assert_allclose(found.deviation, np.std(frames, axis=0), atol=1e-5)
        assert found.moving.any() == moves
        if moves:  # the mean over 3 x 3 px at the border of the block is two thirds of its change
            y, x = np.nonzero(found.moving)
            assert (np.ptp(x) + 1, np.ptp(y) + 1, len(x)) == (18, 8, 18 * 8)
            assert (x.min(), y.min()) == pytest.approx((21, 11), abs=1)
        assert found.area == (5, 0, 57, 40)

    def test_a_line_of_one_pixel_does_not_move(self):
        # its mean over 3 x 3 px exceeds the limit in one column only
        assert not Motion.of(flickering(5, slice(10, 30), slice(20, 23))).moving.any()
        assert Motion.of(flickering(5, slice(10, 30), slice(20, 24))).moving.any()

    def test_margins_and_bars_are_excluded_at_all_sides(self):
        frames = flickering(40, slice(0, 40), slice(0, 60))
        found = Motion.of(frames, margin=2)
        assert found.area == (7, 2, 55, 38)
        y, x = np.nonzero(found.moving)
        assert (x.min(), y.min(), x.max(), y.max()) == (7, 2, 54, 37)
        turned = Motion.of([np.ascontiguousarray(f.T) for f in frames], margin=2)
        assert turned.area == (2, 7, 38, 55)
        np.testing.assert_array_equal(turned.moving, found.moving.T)

    def test_the_noise_is_the_smaller_of_its_estimates(self):
        rng = np.random.default_rng(0)
        noisy = rng.normal(0.0, 3.0, (8, 60, 80))
        # uniform flicker is no noise of single frames, and a texture at rest is no noise in time
        flicker = [(120 + 20 * (k % 2) + one).astype(np.uint8) for k, one in enumerate(noisy)]
        assert Motion.of(flicker).noise == pytest.approx(3.0, rel=0.1)
        texture = rng.normal(0.0, 20.0, (60, 80))
        still = [(120 + texture + one).astype(np.uint8) for one in noisy]
        assert Motion.of(still).noise == pytest.approx(np.quantile(np.std(still, axis=0), 0.3), rel=1e-4)
        assert Motion.of(still).noise == pytest.approx(2.4, abs=0.4)

    @pytest.mark.parametrize(
        ("level", "spread", "change", "ends"),
        [
            (0.0, 0.0, 0.0, (4, 9)),
            (1.4, 1.4, 1.4, (4, 9)),
            (1.6, 0.0, 0.0, (2, 9)),
            (0.0, 1.6, 0.0, (2, 9)),
            (0.0, 0.0, 1.6, (2, 9)),
        ],
    )
    def test_a_bar_is_uniform_and_constant(self, level, spread, change, ends):
        sign = np.where(np.arange(10) % 2 == 0, 1.0, -1.0)[:, None]
        mean, deviation = 90.0 + 20.0 * sign * np.ones(12), np.full((10, 12), 5.0)
        mean[:, :4] = mean[:, 9:] = 16.0
        deviation[:, :4] = deviation[:, 9:] = 0.0
        mean[:, 2:4] = 16.0 + level + spread * sign
        deviation[:, 2:4] = change
        assert search._without_bars(mean, deviation) == ends

    def test_a_uniform_picture_has_no_bars(self):
        assert search._without_bars(np.full((5, 9), 16.0), np.zeros((5, 9))) == (0, 9)


class TestRing:
    def with_share(self, share, inner, outer, also=None):
        """Return a motion in which a share of the pixels of each circle about (100, 80) moves."""
        bins = distance_from((100.0, 80.0), (160, 200)).astype(int)
        moving = np.zeros(bins.size, bool)
        for r in range(inner, outer):
            own = np.flatnonzero(bins.ravel() == r)
            moving[own[: round(share * len(own))]] = True
        if also is not None:
            moving |= (bins.ravel() >= also[0]) & (bins.ravel() < also[1])
        return motion_of(moving.reshape(bins.shape))

    @pytest.mark.parametrize(("share", "outer"), [(0.15, 42.0), (0.25, 62.0)])
    def test_radii_with_a_fifth_of_the_usual_motion_belong_to_the_ring(self, share, outer):
        found = ring_for((100.0, 80.0), self.with_share(share, 40, 61, also=(20, 40)), 48.0)
        assert found.outer == pytest.approx(outer, abs=1.1)

    @pytest.mark.parametrize(("share", "known"), [(0.0085, False), (0.0115, True)])
    def test_a_hundredth_of_a_circle_moves(self, share, known):
        assert (ring_for((100.0, 80.0), self.with_share(share, 40, 60), 48.0) is not None) is known

    @pytest.mark.parametrize(("radius", "known"), [(6, False), (7, True)])
    def test_a_ring_is_wider_than_five_pixels(self, radius, known):
        moving = distance_from((100.0, 80.0), (160, 200)) < radius
        found = ring_for((100.0, 80.0), motion_of(moving), 48.0)
        assert (found is not None) is known
        if known:
            assert (found.inner, found.outer) == (3.0, 9.0)

    def test_a_picture_of_few_pixels_has_no_ring(self):
        assert ring_for((1.0, 1.0), motion_of(np.ones((3, 4), bool)), 48.0) is None

    @pytest.mark.parametrize(
        ("hub", "full"),
        [
            ((0.0, 40.0), True),
            ((-1.0, 40.0), False),
            ((79.0, 40.0), True),
            ((80.0, 40.0), False),
            ((40.0, 0.0), True),
            ((40.0, -1.0), False),
            ((40.0, 59.0), True),
            ((40.0, 60.0), False),
        ],
    )
    def test_a_hub_outside_the_picture_has_an_arc(self, hub, full):
        away = distance_from(hub, (60, 80))
        y, x = np.mgrid[0:60, 0:80]
        direction, towards = np.arctan2(y - hub[1], x - hub[0]), np.arctan2(30 - hub[1], 40 - hub[0])
        inwards = np.abs(np.angle(np.exp(1j * (direction - towards))))
        found = ring_for(hub, motion_of((away > 20) & (away < 36) & (inwards < 0.5)), 48.0)
        assert (found.span == TURN) is full
        if not full:
            assert found.span == pytest.approx(2.2, rel=0.08)
            centre = found.start + 0.5 * found.span
            assert np.angle(np.exp(1j * (centre - towards))) == pytest.approx(0.0, abs=0.05)

    def test_a_ring_about_a_tilted_axis_keeps_the_stretch(self):
        away = distance_from((100.0, 80.0), (160, 200), (0.2, 0.1))
        found = ring_for((100.0, 80.0), motion_of((away > 20) & (away < 50)), 48.0, (0.2, 0.1))
        assert found.stretch == (0.2, 0.1)
        assert (found.inner, found.outer) == pytest.approx((18.0, 52.0), abs=1.1)


class TestOutline:
    @pytest.mark.parametrize(("size", "known"), [((4, 12), False), ((5, 10), True), ((10, 5), True)])
    def test_fifty_pixels_show_an_ellipse(self, size, known):
        moving = np.zeros((60, 80), bool)
        moving[20 : 20 + size[0], 30 : 30 + size[1]] = True
        found = search.tilted_outline(motion_of(moving))
        assert (found is not None) is known
        if known:
            assert found.way == "outline of the moving area"
            assert found.hub == (30 + (size[1] - 1) / 2, 20 + (size[0] - 1) / 2)
            ratio = math.sqrt(24 / 99)  # the variances of 5 and 10 pixels
            p = (1 - ratio) / (1 + ratio) * (1 if size[1] > size[0] else -1)
            assert found.stretch == pytest.approx((p, 0.0), abs=1e-6)

    def test_the_largest_area_counts_and_a_given_hub_is_kept(self):
        moving = np.zeros((80, 120), bool)
        moving[5:25, 80:88] = True
        moving[40:55, 10:40] = True
        found = search.tilted_outline(motion_of(moving), (7.0, 9.0))
        assert (found.hub, found.way) == ((7.0, 9.0), "given")
        assert found.stretch[0] > 0.3  # the other area has its long axis along y
        assert search.tilted_outline(motion_of(moving)).hub == (24.5, 47.0)
        assert search.tilted_outline(motion_of(np.zeros((80, 120), bool))) is None


class TestEdges:
    def cone(self, slope, radius=99.0, size=(64, 80)):
        away = distance_from((33.3, 28.6), size)
        return motion_of(away < radius, mean=slope * away)

    @pytest.mark.parametrize(("slope", "known"), [(0.4, False), (0.6, True), (3.0, True)])
    def test_gradients_of_half_a_grey_level_converge(self, slope, known):
        found = search.edge_hub(self.cone(slope))
        assert (found is not None) is known
        if known:
            assert found == pytest.approx((33.3, 28.6), abs=0.02)

    def test_fifty_edges_in_the_moving_area_determine_a_hub(self):
        # the area grows by 1 px at each side
        for side, known in ((4, False), (6, True)):
            moving = np.zeros((64, 80), bool)
            moving[10 : 10 + side, 40 : 40 + side] = True
            found = search.edge_hub(motion_of(moving, mean=self.cone(2.0).mean))
            assert (found is not None) is known

    def test_a_straight_edge_does_not_displace_the_hub(self):
        shown = self.cone(2.0)
        mean = shown.mean.copy()
        mean[:, 66:] += 60.0
        assert search.edge_hub(motion_of(shown.moving, mean=mean)) == pytest.approx((33.3, 28.6), abs=0.1)


class TestSpots:
    def film(self, contrast, size=(3, 3), other=None):
        frames = []
        for k in range(14):
            frame = np.full((80, 100), 60, dtype=np.uint8)
            x, y = round(50 + 22 * math.cos(0.5 * k)), round(40 + 22 * math.sin(0.5 * k))
            frame[y - 1 : y - 1 + size[0], x - 1 : x - 1 + size[1]] += contrast
            if other:
                frame[2 : 2 + other[0], 3 + 5 * k : 3 + 5 * k + other[1]] = 250
            frames.append(frame)
        return frames

    def hub(self, frames, deviation=1.0):
        flat = np.full((80, 100), 60.0)
        changes = np.full((80, 100), deviation)
        return search.orbit_hub(frames, motion_of(flat > 99, flat, changes, noise=1.0))

    @pytest.mark.parametrize(
        ("contrast", "deviation", "known"),
        [(9, 1.0, False), (10, 1.0, True), (20, 40.0, False), (22, 40.0, True)],
    )
    def test_a_spot_exceeds_noise_and_change(self, contrast, deviation, known):
        """By 9 standard deviations of the noise, and by 0.525 of the largest change."""
        assert (self.hub(self.film(contrast), deviation) is not None) is known

    @pytest.mark.parametrize(("size", "known"), [((1, 5), False), ((2, 3), True)])
    def test_a_spot_has_six_pixels(self, size, known):
        assert (self.hub(self.film(100, size)) is not None) is known

    def test_the_largest_spot_is_followed(self):
        found = self.hub(self.film(100, other=(2, 4)))
        assert found == pytest.approx((50.0, 40.0), abs=0.3)
        assert self.hub(self.film(100, size=(2, 2), other=(2, 4))) is None  # a straight line

    def test_dark_spots_count_and_few_frames_are_a_sample(self):
        frames = [np.uint8(120) - f for f in self.film(100 - 60)]
        assert self.hub(frames) == pytest.approx((50.0, 40.0), abs=0.3)
        # of 400 frames each second one is used
        many = [f for pair in zip(self.film(100), self.film(0), strict=True) for f in pair] * 15
        assert self.hub(many) == pytest.approx((50.0, 40.0), abs=0.3)


class TestFeatures:
    HUB = 70.0 + 40.0j

    def pairs(self, monkeypatch, count, found):
        """Return the result for numbered frames, and the pairs that were compared."""
        asked = []

        def similarity(first, second, mask):
            asked.append((second - first, first))
            assert mask.any()
            return found(first, second)

        monkeypatch.setattr(search, "similarity", similarity)
        moving = np.zeros((40, 60), bool)
        moving[10:20, 10:20] = True
        return search.similarity_hubs(range(count), motion_of(moving)), asked

    def turning(self, first, second):
        a = np.exp(0.05j * (second - first))
        return complex(a), complex((1 - a) * self.HUB), 75.0 + 44.0j + 3 * np.exp(1j * first)

    @pytest.mark.parametrize(
        ("count", "last"), [(16, []), (17, [(16, 0)]), (19, [(16, 0), (16, 1), (16, 2)])]
    )
    def test_pairs_have_three_lags(self, monkeypatch, count, last):
        hubs, asked = self.pairs(monkeypatch, count, self.turning)
        expected = [(lag, i) for lag in (1, 4) for i in range(count - lag)] + last
        assert sorted(asked) == expected
        assert hubs[0] == pytest.approx((70.0, 40.0))

    def test_forty_pairs_of_each_lag_are_enough(self, monkeypatch):
        _, asked = self.pairs(monkeypatch, 200, self.turning)
        assert [sum(lag == one for lag, _ in asked) for one in (1, 4, 16)] == [40, 40, 40]
        assert max(i + lag for lag, i in asked) == 199

    @pytest.mark.parametrize(("rest", "all_pairs"), [(0.6, True), (1.0, False)])
    def test_a_fifth_of_the_pairs_decides_whether_there_is_a_hub(self, monkeypatch, rest, all_pairs):
        """Displacements that no hub explains: without rotation, or with a part of it."""

        def drifting(first, second):
            a, _, c = self.turning(first, first + 1)
            off = rest * abs((1 - a) * (self.HUB - c)) * np.exp(2j * first)
            return a, (1 - a) * ((1 - rest) * self.HUB + rest * c) + 6 * off, c

        _, asked = self.pairs(monkeypatch, 60, drifting)
        unexplained = search._CommonHub.of([drifting(i, i + lag) for lag, i in asked[:24]]).unexplained
        assert (unexplained < 0.8) is (len(asked) > 24)

    def test_few_similarities_lead_to_all_pairs(self, monkeypatch):
        hubs, asked = self.pairs(monkeypatch, 20, lambda *_: None)
        assert hubs == (None, None)
        assert len(asked) == 19 + 16 + 4
        assert search.similarity_hubs(range(9), motion_of(np.zeros((40, 60), bool))) == (None, None)

    @pytest.mark.parametrize("bias", [0.7, 1.4])
    def test_a_distant_hub_is_found_from_displacements(self, bias):
        rng = np.random.default_rng(0)
        hub, angle = 60.0 - 900.0j, 0.06 * np.sin(0.3 * np.arange(40))
        centroid = hub + 980.0j * np.exp(1j * np.roll(angle, 3))
        # the displacement is precise, the rotation is not
        left = 1.0 - np.exp(1j * (angle + rng.normal(0, 1e-3, 40)))
        shift = (1.0 - np.exp(1j * angle)) * (hub - centroid)
        middle = complex(np.median(centroid.real), np.median(centroid.imag))
        found = search.distant_hub(middle + bias * (hub - middle), left, shift, centroid)
        assert found == pytest.approx((60.0, -900.0), abs=9.0)

    @pytest.mark.parametrize(("away", "known"), [(9.0, False), (11.0, True)])
    def test_a_hub_within_the_displacements_is_not_distant(self, away, known):
        centroid = np.array([-1.0, 0.0, 1.0, 0.5j]) + 50.0
        left = np.array([0.1j, 0.2j, -0.1j, 0.15j])
        shift = 50.0 * left  # at most 10 px
        assert (search.distant_hub(50.0 + away * 1j, left, shift, centroid) is not None) is known


def texture(seed=0):
    picture = cv2.GaussianBlur(np.random.default_rng(seed).normal(0.0, 1.0, (110, 130)), (0, 0), 2.0)
    return cv2.normalize(picture, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


def turned(angles, hub=(60.0, 50.0)):
    matrices = [cv2.getRotationMatrix2D(hub, -math.degrees(a), 1.0) for a in angles]  # from x to y
    return [cv2.warpAffine(texture(), m, (130, 110), borderMode=cv2.BORDER_REFLECT) for m in matrices]


class TestFollowing:
    def disc(self, radius=40):
        away = distance_from((60.0, 50.0), (110, 130))
        return motion_of(away < radius, deviation=9.0 - 0.05 * away)

    def test_features_give_the_motion_since_the_first_frame(self):
        angles = [0.0, 0.03, 0.05, 0.02, -0.02]
        a, b, since = search.follow_features(turned(angles), self.disc(), 2.0)
        np.testing.assert_allclose(np.angle(a), angles, atol=1e-3)
        np.testing.assert_allclose(np.abs(a), 1.0)
        np.testing.assert_allclose((a * (60 + 50j) + b), 60 + 50j, atol=0.08)
        assert since[0] == 0
        assert len(since) == 5

    @pytest.mark.parametrize(("widest", "known"), [(0.06, False), (0.08, True)])
    def test_the_range_of_the_angles_is_limited(self, widest, known):
        found = search.follow_features(turned([0.0, 0.03, 0.05, 0.02, -0.02]), self.disc(), widest)
        assert (found is not None) is known

    def test_new_features_continue_the_motion(self):
        """A small body has so few features that they are renewed; angles still refer to the first frame."""
        angles = [0.04 * k for k in range(8)]
        a, b, since = search.follow_features(turned(angles), self.disc(30), 2.0)
        assert len(set(since.tolist())) > 1
        assert (np.diff(since) >= 0).all()
        assert (since < np.arange(1, 9)).all()
        np.testing.assert_allclose(np.angle(a), angles, atol=0.01)
        np.testing.assert_allclose(a * (60 + 50j) + b, 60 + 50j, atol=0.3)

    def test_features_that_vanish_end_the_motion(self):
        frames = turned([0.0, 0.03])
        assert search.follow_features([*frames, np.full((110, 130), 90, np.uint8)], self.disc(), 2.0) is None
        assert search.follow_features([np.full((110, 130), 90, np.uint8)] * 2, self.disc(), 2.0) is None
        assert search.follow_features(frames, self.disc(5), 2.0) is None
        assert search.follow_features(frames[:1], self.disc(5), 2.0) is None
        a, b, since = search.follow_features(frames[:1], self.disc(), 2.0)
        assert (a.tolist(), b.tolist(), since.tolist()) == ([1.0], [0.0], [0])


@pytest.mark.parametrize("shape", [(600, 1000), (1000, 600)])
@pytest.mark.parametrize("along", [0, 1])
@pytest.mark.parametrize(
    ("first", "second", "kept"),
    [
        (0.0, 3.9, 1),  # 0.4 % of 1000 px
        (0.0, 4.1, 2),
        (0.0, -3.9, 1),
        (0.0, -4.1, 2),
        (0.0, 5990.0, 2),  # six times 1000 px from the middle of the picture
        (0.0, 6010.0, 1),
        (0.0, -6010.0, 1),
        (6010.0, 5990.0, 1),
    ],
)
def test_new_hubs_near_the_picture_are_proposed(monkeypatch, shape, along, first, second, kept):
    middle = np.array([shape[1] / 2, shape[0] / 2])
    step = np.eye(2)[along]
    monkeypatch.setattr(search, "similarity_hubs", lambda *_: (tuple(middle + first * step), None))
    monkeypatch.setattr(search, "edge_hub", lambda *_: tuple(middle + second * step))
    monkeypatch.setattr(search, "orbit_hub", lambda *_: None)
    monkeypatch.setattr(search, "_middle", lambda *_: None)
    found = search.propose_hubs([], motion_of(np.zeros(shape, bool)))
    assert len(found) == kept
    assert {p.way for p in found} <= {"features", "edges"}
    assert {p.stretch for p in found} == {(0.0, 0.0)}


@pytest.mark.parametrize(("half_range", "whole"), [(1.35, False), (1.5, True)])
def test_an_arc_is_a_turn_at_most(half_range, whole):
    """0.6 of the range are added on either side: 2.2 times 2.86 rad is a turn."""
    hub = (-1.0, 30.0)
    away = distance_from(hub, (60, 80))
    y, x = np.mgrid[0:60, 0:80]
    direction = np.arctan2(y - hub[1], x - hub[0])
    found = ring_for(hub, motion_of((away > 8) & (away < 28) & (np.abs(direction) < half_range)), 48.0)
    assert (found.span == TURN) is whole
    assert found.span == pytest.approx(min(4.4 * half_range, TURN), rel=0.06)


def test_edges_have_the_weights_of_their_robust_fit():
    """The fixed point of the weights g / (1 + (d / 1.5 px)^2)^2, with gradients g up to 20 grey levels per px."""
    rng = np.random.default_rng(0)
    away = distance_from((33.3, 28.6), (64, 80))
    mean = (6.0 * away + 60.0 * np.sin(0.4 * away) + rng.normal(0.0, 3.0, away.shape)).astype(np.float32)
    mean[40:, 60:] += np.arange(20, dtype=np.float32) ** 2
    found = np.array(search.edge_hub(motion_of(away < 99, mean=mean)))
    across, down = (cv2.Sobel(mean, cv2.CV_32F, *order, scale=1 / 8) for order in ((1, 0), (0, 1)))
    size = np.hypot(across, down)
    y, x = np.nonzero(size > 0.5)
    across, down, size = across[y, x], down[y, x], size[y, x]
    # distance of the hub from the line through a pixel along its gradient
    apart = (across * (y - found[1]) - down * (x - found[0])) / size
    weight = np.minimum(size, 20.0) / (1.0 + (apart / 1.5) ** 2) ** 2
    direction = np.stack([-down, across], axis=1) / size[:, None]
    normal = (direction * weight[:, None]).T @ direction
    step = np.linalg.solve(normal, (direction * weight[:, None]).T @ apart)
    assert np.abs(step).max() < 2e-3
    assert found == pytest.approx((33.3, 28.6), abs=1.5)


def test_pairs_have_the_weights_of_their_robust_fit():
    """The fixed point of the weights 1 / (1 + (r / 2 s)^2), with s = 1.4826 times the median residual."""
    rng = np.random.default_rng(0)
    turn = np.exp(1j * rng.uniform(0.1, 0.3, 60))
    hub = 70.0 + 40.0j
    noise = rng.normal(0, 1.0, 60) + 1j * rng.normal(0, 1.0, 60)
    noise[::7] *= 12.0
    pairs = [(complex(a), complex((1 - a) * hub + e), 75.0 + 44.0j) for a, e in zip(turn, noise, strict=True)]
    found = search._CommonHub.of(pairs)
    left, moved = 1.0 - turn, (1.0 - turn) * hub + noise
    miss = np.abs(moved - left * found.hub)
    weight = 1.0 / (1.0 + (miss / (2.0 * 1.4826 * np.median(miss))) ** 2)
    weight[np.abs(left) <= 0.5 * np.median(np.abs(left))] = 0.0
    expected = np.sum(weight * left.conj() * moved) / np.sum(weight * np.abs(left) ** 2)
    assert found.hub == pytest.approx(expected, abs=1e-4)
    shift = moved - left * (75.0 + 44.0j)
    assert found.unexplained == pytest.approx(np.median(miss) / np.median(np.abs(shift)), rel=1e-6)
