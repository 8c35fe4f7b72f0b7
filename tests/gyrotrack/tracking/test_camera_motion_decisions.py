"""Motion of the camera: which features are the background, and what their displacements determine."""

import math

import cv2
import numpy as np
import pytest

from gyrotrack.tracking import _camera_motion as camera
from gyrotrack.tracking._camera_motion import Shake

SHAPE = (300, 400)


def shake(shift, roll=None, centre=(0.0, 0.0), sigma=0.0):
    shift = np.asarray(shift, dtype=np.float64)
    return Shake(shift, np.zeros(len(shift)) if roll is None else np.asarray(roll), centre, 9, sigma, 0.0)


class TestShake:
    def test_the_rms_is_that_of_both_coordinates_about_their_mean(self):
        # deviations of 3 px in x and of 4 px in y
        assert shake([[7.0, 1.0], [13.0, 9.0]]).rms == pytest.approx(5.0)

    @pytest.mark.parametrize(
        ("rms", "sigma", "moves"), [(0.14, 0, 0), (0.16, 0, 1), (0.9, 0.2, 0), (1.1, 0.2, 1)]
    )
    def test_a_significant_motion_exceeds_0_15_px_and_five_standard_uncertainties(self, rms, sigma, moves):
        assert shake([[rms, 0.0], [-rms, 0.0]], sigma=sigma).significant == bool(moves)

    @pytest.mark.parametrize(
        ("shift", "roll", "margin"),
        [
            ([[0.0, 0.0], [2.5, 0.0]], [0.0, 0.0], 4),
            ([[0.0, 0.0], [0.0, -2.5]], [0.0, 0.0], 4),
            ([[0.0, 0.0], [0.0, 0.0]], [0.0, -0.021], 6),  # half of 400 px
            ([[1.0, 0.0], [0.0, -2.9]], [0.011, 0.0], 7),
        ],
    )
    def test_the_margin_contains_the_largest_displacement_and_the_roll(self, shift, roll, margin):
        assert shake(shift, roll).margin(SHAPE) == margin
        assert shake(shift, roll).margin(SHAPE[::-1]) == margin

    def test_a_point_of_the_picture_rolls_clockwise_and_is_displaced(self):
        moved = shake([[10.0, 20.0]], [0.5 * np.pi], centre=(5.0, 6.0))
        # y is downwards: clockwise from x to y
        np.testing.assert_allclose(moved.seen(np.array([8.0, 6.0])), [[15.0, 29.0]])
        np.testing.assert_allclose(moved.still(np.array([[15.0, 29.0]])), [[8.0, 6.0]])

    def test_a_stabilised_picture_shows_each_point_at_its_place_in_the_reference(self):
        rng = np.random.default_rng(0)
        picture = rng.integers(0, 255, (20, 30)).astype(np.uint8)
        # a quarter of a turn about (9, 8), then a displacement by whole pixels
        moved = shake([[0.0, 0.0], [2.0, -3.0]], [0.0, 0.5 * np.pi], centre=(9.0, 8.0))
        found = moved.stabilised(picture, 1)
        for x, y in ((9, 8), (12, 8), (9, 11), (11, 13)):
            ((sx, sy),) = moved.seen(np.array([[x, y]] * 2))[1:]
            assert found[y, x] == picture[round(sy), round(sx)]
        np.testing.assert_array_equal(moved.stabilised(picture, 0), picture)
        outside = shake([[40.0, 0.0]]).stabilised(picture, 0)
        np.testing.assert_array_equal(outside, np.tile(picture[:, -1:], (1, 30)))  # the border is replicated


class TestTracking:
    def texture(self, seed=0):
        picture = cv2.GaussianBlur(np.random.default_rng(seed).normal(0.0, 1.0, (90, 120)), (0, 0), 2.0)
        return cv2.normalize(picture, None, 30, 220, cv2.NORM_MINMAX).astype(np.uint8)

    def test_features_move_by_the_displacement_of_the_picture(self):
        first = self.texture()
        places = camera.features_of(first)
        places = places[(np.abs(places - (60, 45)) < (40, 25)).all(axis=1)]
        assert len(places) > 5
        second = np.roll(np.roll(first, 3, axis=1), -2, axis=0)
        found = camera.tracked(first, places, second)
        np.testing.assert_allclose(found, np.tile([3.0, -2.0], (len(places), 1)), atol=0.05)

    def test_features_that_are_not_alike_are_lost(self):
        first = self.texture()
        places = camera.features_of(first)
        places = places[(np.abs(places - (60, 45)) < (40, 25)).all(axis=1)]
        brighter = lambda by: np.clip(first + float(by), 0, 255).astype(np.uint8)  # noqa: E731
        assert np.isfinite(camera.tracked(first, places, brighter(12))).all()
        assert np.isnan(camera.tracked(first, places, brighter(28))).mean() > 0.7
        assert len(camera.features_of(np.full((90, 120), 90, np.uint8))) == 0


def grid(wide=360.0, high=280.0, count=(6, 5)):
    x, y = np.meshgrid(np.linspace(0, wide, count[0]), np.linspace(0, high, count[1]))
    return np.stack([x.ravel() + 20, y.ravel() + 10], axis=1).astype(np.float32)


def rigid(places, shift, roll):
    """Return the displacements (frames, features, 2) of a picture that is displaced and rolls about its middle."""
    x, y = (places - places.mean(axis=0)).T.astype(float)
    cos, sin = np.cos(roll)[:, None], np.sin(roll)[:, None]
    turned = np.stack([cos * x - sin * y - x, sin * x + cos * y - y], axis=2)
    return turned + np.asarray(shift)[:, None]


class TestBackground:
    FRAMES = 20

    @pytest.mark.parametrize(("away", "rests"), [(0.34, True), (0.36, False)])
    def test_features_at_rest_are_within_0_35_px(self, away, rests):
        places = grid()
        moved = np.zeros((self.FRAMES, len(places), 2))
        # each feature in its own direction: no rigid motion
        direction = np.linspace(0, 40, len(places))
        moved[:] = away * np.stack([np.cos(direction), np.sin(direction)], axis=1)
        moved[:, :3] = 9.0
        found = camera.background(places, moved, SHAPE)
        assert not found[:3].any()
        if rests:
            assert found[3:].all()

    @pytest.mark.parametrize(("hidden", "kept"), [(3, True), (4, False)])
    def test_a_feature_is_seen_in_four_fifths_of_the_frames(self, hidden, kept):
        places = grid()
        for moved in (
            np.zeros((self.FRAMES, len(places), 2)),
            rigid(places, np.linspace(0, 9, 2 * self.FRAMES).reshape(-1, 2), np.zeros(self.FRAMES)),
        ):
            moved[:hidden, 7] = np.nan
            found = camera.background(places, moved, SHAPE)
            assert found[7] == kept
            assert np.delete(found, 7).all()

    @pytest.mark.parametrize(("roll", "background"), [(0.048, True), (0.052, False), (-0.052, False)])
    def test_the_background_rolls_by_a_twentieth_at_most(self, roll, background):
        places = grid()
        moved = rigid(places, np.zeros((self.FRAMES, 2)) + 2.0, np.full(self.FRAMES, roll))
        assert camera.background(places, moved, SHAPE).all() == background
        assert camera.background(places, moved, SHAPE).any() == background

    @pytest.mark.parametrize(("off", "member"), [(0.65, True), (0.75, False)])
    def test_a_feature_is_within_0_7_px_of_the_motion(self, off, member):
        places = grid()
        moved = rigid(places, np.zeros((self.FRAMES, 2)) + 2.0, np.linspace(-0.02, 0.02, self.FRAMES))
        moved[:, 12, 1] += off
        assert camera.background(places, moved, SHAPE)[12] == member

    def test_the_larger_of_two_motions_is_the_background(self):
        places = grid()
        roll = np.linspace(0.0, 0.03, self.FRAMES)
        moved = rigid(places, np.zeros((self.FRAMES, 2)) + 2.0, roll)
        other = rigid(places, np.zeros((self.FRAMES, 2)) - 2.0, -roll)
        own = np.arange(len(places)) % 3 == 0
        moved[:, own] = other[:, own]
        np.testing.assert_array_equal(camera.background(places, moved, SHAPE), ~own)

    @pytest.mark.parametrize(("apart", "found"), [(0.13, False), (0.2, True)])
    def test_two_features_determine_a_roll_from_0_15_of_the_picture_on(self, apart, found, monkeypatch):
        """All features are at two places; the area is not a limit here."""
        monkeypatch.setattr(camera, "_WIDEST_BODY", -1.0)
        places = np.zeros((8, 2), np.float32)
        places[4:, 0] = apart * 400
        moved = rigid(places, np.zeros((self.FRAMES, 2)) + 2.0, np.full(self.FRAMES, 0.01))
        assert camera.background(places, moved, SHAPE).any() == found

    @pytest.mark.parametrize(
        ("wide", "high", "count", "background"),
        [(80.0, 70.0, 3, False), (80.0, 80.0, 3, True), (300.0, 200.0, 2, False)],
    )
    def test_the_background_encloses_a_twentieth_of_the_picture(self, wide, high, count, background):
        """0.05 x 300 x 400 px = 6000 px2, with 6 features at least."""
        places = grid(wide, high, (count, 2) if count == 2 else (3, 3))
        for moved in (np.zeros((9, len(places), 2)), rigid(places, np.ones((9, 2)) * 2.0, np.zeros(9))):
            assert camera.background(places, moved, SHAPE).any() == background


class TestMotion:
    """The rigid motion of features: which frames and features determine it."""

    PLACES = grid()

    def moved(self, count=20):
        k = np.arange(count)
        return rigid(self.PLACES, np.stack([0.2 * k, -0.1 * k], axis=1), 1e-4 * k)

    def test_features_beyond_three_times_the_usual_residual_do_not_count(self):
        moved = self.moved()
        rng = np.random.default_rng(0)
        angle = rng.uniform(0, 7, moved.shape[:2])
        moved += 0.1 * np.stack([np.cos(angle), np.sin(angle)], axis=2)
        before = camera._rigid(self.PLACES, moved)
        moved[:, 4] += 40.0
        after = camera._rigid(self.PLACES, moved)
        assert np.abs(after.shift - before.shift).max() < 0.03
        assert np.abs(after.roll - before.roll).max() < 3e-4

    @pytest.mark.parametrize(("lost", "known"), [(2, True), (3, False)])
    def test_nine_tenths_of_the_frames_are_measured_and_gaps_are_linear(self, lost, known):
        moved = self.moved()
        moved[5 : 5 + lost] = np.nan
        found = camera._rigid(self.PLACES, moved)
        assert (found is not None) is known
        if known:
            np.testing.assert_allclose(found.shift, np.arange(20)[:, None] * [0.2, -0.1], atol=2e-3)
            np.testing.assert_allclose(found.roll, 1e-4 * np.arange(20), rtol=1e-3)
            assert found.features == 30
            assert found.centre == pytest.approx((200.0, 150.0))

    @pytest.mark.parametrize(("seen", "known"), [(2, False), (3, True)])
    def test_three_features_show_the_motion_of_a_frame(self, seen, known):
        whole = self.moved()
        moved = np.full(whole.shape, np.nan)
        moved[3:, :seen] = whole[3:, [0, 14, 29][:seen]]
        places = self.PLACES.copy()
        places[:seen] = self.PLACES[[0, 14, 29][:seen]]
        moved[:3] = rigid(places, np.zeros((3, 2)), np.zeros(3))
        assert (camera._rigid(places, moved) is not None) is known

    @pytest.mark.parametrize(("share", "rolls"), [(0.9, False), (1.1, True)])
    def test_a_roll_is_significant_beyond_five_standard_uncertainties(self, share, rolls):
        roll = share * 5e-3 * np.where(np.arange(20) % 2, 1.0, -1.0)
        found, sigma = camera._significant_roll(roll, 1e-3)
        assert found.any() == rolls
        assert sigma == pytest.approx(1e-3 if rolls else math.sqrt((share * 5e-3) ** 2 - 1e-6))
        assert camera._significant_roll(roll * 0.1, 1e-3)[1] == 0.0

    def camera_shake(self, monkeypatch, *, size=1.0, places=None, count=60, body=None):
        """Return the motion of frames that are numbers; the displacement oscillates with the number."""
        places = self.PLACES if places is None else places
        asked = []

        def tracked(reference, places, frame):
            asked.append(int(frame[0, 0]))
            k = int(frame[0, 0])
            return rigid(places, [[size * math.sin(k), size * math.cos(k)]], np.zeros(1))[0]

        monkeypatch.setattr(camera, "features_of", lambda _: places)
        monkeypatch.setattr(camera, "tracked", tracked)
        frames = [np.full((2, 2), k, np.uint8) for k in range(count)]
        monkeypatch.setattr(
            camera, "background", lambda at, moved, _: np.ones(len(at), bool) & (at[:, 1] < 200.0)
        )
        return camera.camera_shake(frames, frames[:7], body), asked

    def test_forty_samples_decide_and_all_frames_are_measured(self, monkeypatch):
        found, asked = self.camera_shake(monkeypatch)
        assert len(asked) == 40 + 7
        assert (asked[0], asked[39], asked[40:]) == (0, 59, list(range(7)))
        k = np.arange(7)
        np.testing.assert_allclose(found.shift, np.stack([np.sin(k), np.cos(k)], axis=1), atol=1e-6)
        assert found.features == 18  # those of the background

    def test_a_camera_at_rest_is_not_measured(self, monkeypatch):
        found, asked = self.camera_shake(monkeypatch, size=0.1)
        assert found is None
        assert len(asked) == 40

    @pytest.mark.parametrize(("radius", "features"), [(60.0, 17), (71.0, 15), (-1.0, 18)])
    def test_features_of_the_body_do_not_count(self, monkeypatch, radius, features):
        x, y = self.PLACES[8]
        found, _ = self.camera_shake(monkeypatch, body=(float(x), float(y), radius))
        assert found.features == features

    @pytest.mark.parametrize(("count", "known"), [(5, False), (6, True)])
    def test_six_features_show_a_background(self, monkeypatch, count, known):
        found, _ = self.camera_shake(monkeypatch, places=self.PLACES[:count])
        assert (found is not None) is known


class TestWholeBackground:
    BODY = (60.0, 40.0, 10.0)

    def roll(self, monkeypatch, rolls, *, halves=None, shape=(80, 100), body=BODY, lost=()):
        """Return the roll from given rolls per frame; every sixteenth frame compares the halves."""
        count = len(rolls)
        halves = np.zeros((count, 2)) if halves is None else halves
        plan = []
        for k in range(count):
            plan.append((k, rolls[k]))
            if k % 16 == 0:
                plan += [(k, h) for h in halves[k]]
        plan = iter(plan)
        asked = []

        def registered(reference, small, warp, *rest):
            k, turn = next(plan)
            asked.append((k, small.shape, rest[2]))
            if k in lost:
                raise cv2.error("no correlation")
            return 1.0, np.array(
                [[math.cos(turn), -math.sin(turn), 0.0], [math.sin(turn), math.cos(turn), 0.0]]
            )

        monkeypatch.setattr(cv2, "findTransformECC", registered)
        return camera.background_roll((np.zeros(shape, np.uint8) for _ in range(count)), body), asked

    def test_the_roll_is_that_of_each_frame(self, monkeypatch):
        rolls = 0.01 * np.sin(np.arange(96))
        found, asked = self.roll(monkeypatch, rolls)
        np.testing.assert_allclose(found.roll, rolls, atol=1e-7)
        assert found.centre == self.BODY[:2]
        assert not found.shift.any()
        assert len(asked) == 96 + 2 * 6
        covered = [np.count_nonzero(mask) for *_, mask in asked[:3]]
        assert covered[0] == covered[1] + covered[2]

    @pytest.mark.parametrize(("count", "known"), [(80, False), (81, True)])
    def test_six_comparisons_of_the_halves_are_needed(self, monkeypatch, count, known):
        assert (self.roll(monkeypatch, np.zeros(count))[0] is not None) is known

    @pytest.mark.parametrize(("wrong", "known"), [(9, True), (11, False)])
    @pytest.mark.parametrize("kind", ["far", "lost"])
    def test_the_roll_is_small_and_known_in_nine_tenths_of_the_frames(self, monkeypatch, wrong, known, kind):
        rolls = 0.01 * np.sin(0.01 * np.arange(100))
        chosen = 1 + np.arange(wrong)
        given = rolls.copy()
        given[chosen] = 0.052 if kind == "far" else given[chosen]
        found, _ = self.roll(monkeypatch, given, lost=chosen.tolist() if kind == "lost" else ())
        assert (found is not None) is known
        if known:  # linear in the gap
            np.testing.assert_allclose(found.roll, rolls, atol=2e-6)

    def test_rolls_below_a_twentieth_are_kept(self, monkeypatch):
        found, _ = self.roll(monkeypatch, 0.048 * np.where(np.arange(96) % 2, 1.0, -1.0))
        assert np.abs(found.roll).min() == pytest.approx(0.048, rel=1e-4)

    def test_the_uncertainty_is_half_the_robust_difference_of_the_halves(self, monkeypatch):
        halves = np.zeros((112, 2))
        halves[::16, 0] = [1e-3, -1e-3, 2e-3, -2e-3, 3e-3, -3e-3, 9e-3]
        found, _ = self.roll(monkeypatch, 0.04 * np.where(np.arange(112) % 2, 1.0, -1.0), halves=halves)
        # half the differences, in mrad, are 0.5 -0.5 1 -1 1.5 -1.5 4.5: deviations from 0.5 have the median 1
        assert found.roll_sigma == pytest.approx(1.4826e-3, rel=1e-3)

    def test_large_pictures_are_reduced_with_their_body(self, monkeypatch):
        _, asked = self.roll(monkeypatch, np.zeros(2), shape=(100, 641), body=(300.0, 50.0, 30.0))
        (_, shape, mask), *_ = asked
        assert shape == (50, 320)
        y, x = np.nonzero(mask == 0)
        assert (x.min(), x.max(), y.min(), y.max()) == (135, 165, 10, 40)
        assert self.roll(monkeypatch, np.zeros(2), shape=(100, 640))[1][0][1] == (100, 640)

    @pytest.mark.parametrize(("radius", "asks"), [(53.0, True), (62.0, False)])
    def test_a_twentieth_of_the_picture_is_background(self, monkeypatch, radius, asks):
        """The corners outside a circle of 53 px about the middle of 100 x 80 px cover 10 %, outside of 62 px 0.3 %."""
        _, asked = self.roll(monkeypatch, np.zeros(2), body=(49.5, 39.5, radius))
        assert bool(asked) is asks

    def test_the_halves_are_patches_in_turn(self):
        whole, one, other = camera._halves((150, 220), (100.0, 80.0, 20.0))
        y, x = np.mgrid[:150, :220]
        outside = (x - 100.0) ** 2 + (y - 80.0) ** 2 > 400.0
        np.testing.assert_array_equal(whole, outside)
        np.testing.assert_array_equal(one + other, outside)
        assert one[10, 80] == 1
        assert one[80, 10] == 1
        assert one[71, 69] == 1
        assert other[10, 10] == other[69, 69] == other[75, 139] == other[10, 141] == 1
