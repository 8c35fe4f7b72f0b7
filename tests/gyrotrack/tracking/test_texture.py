"""The angle of a body from the texture of its ring, on pictures drawn with a known rotation."""

import math
from functools import lru_cache

import cv2
import numpy as np
import pytest

from gyrotrack.tracking import _texture as texture
from gyrotrack.tracking._texture import TextureObservations, TextureTracker, zone_weights
from gyrotrack.video._container import Frame

SIZE, HUB, OUTER = (240, 220), (118.0, 107.0), 70.0
TURN = 2.0 * np.pi
SHIFT = 0.3  # px


def soft(distance):
    """Return an edge, as of a lens: the logistic function."""
    return 0.5 + 0.5 * np.tanh(distance / np.float32(1.6))


@lru_cache(maxsize=32)
def still(hub, stretch):
    """Return what does not depend on the angle: places in the plane, visible share of the disc, light of the rim."""
    x, y = np.meshgrid(np.arange(SIZE[0]) - hub[0], hub[1] - np.arange(SIZE[1]))
    p, q = stretch
    u, v = np.linalg.inv([[1 + p, q], [q, 1 - p]]) @ np.stack([x.ravel(), y.ravel()])
    u, v = (w.reshape(x.shape).astype(np.float32) for w in (u, v))
    r, theta = np.hypot(u, v), np.arctan2(v, u)
    rim, outside = soft(r - 74.0) * soft(90.0 - r), soft(r - 92.0)
    teeth = [40.0 * rim * (1.0 - outside) * f(5.0 * theta) for f in (np.cos, np.sin)]
    return u, v, theta, (1.0 - rim) * (1.0 - outside), 150.0 * rim * (1.0 - outside) + 90.0 * outside, teeth


def picture(angle, *, hub=HUB, stretch=(0.0, 0.0), below=None, grain=None, arms=2):
    """Return a disc with a bar and screws, turned counter-clockwise by `angle`, in grey levels."""
    angle = float(angle)
    u, v, theta, disc, fixed, teeth = still(tuple(hub), tuple(stretch))
    c, s = math.cos(angle), math.sin(angle)
    along, across = c * u + s * v, np.abs(c * v - s * u)
    light = 60.0 if below is None else 60.0 + 40.0 * np.cos(3.0 * (theta - float(below)))
    bar = soft(9.0 - across) if arms == 2 else soft(9.0 - across) * soft(along)
    light = light + bar * (170.0 - light)
    light = light - 90.0 * soft(6.0 - across) * soft(18.0 - np.abs(along - 48.0))
    # the rim with its five teeth, and what is outside it, cover the disc
    light = light * disc + fixed + math.cos(5.0 * angle) * teeth[0] + math.sin(5.0 * angle) * teeth[1]
    return light if grain is None else light + grain.standard_normal(light.shape, np.float32) * 2.0


def frames_of(pictures):
    grey = np.zeros((1, 1), np.uint8)
    levels = (np.clip(np.rint(p), 0, 255).astype(np.uint8) for p in pictures)
    return [Frame(k, k, p, grey, grey) for k, p in enumerate(levels)]


def measured(angle, start, pictures, *, batches=1, centre=HUB, kind=0):
    """Track frames whose angles are known roughly (`start`), in equal batches; `kind` 1: about the own view."""
    tracker = TextureTracker(centre, OUTER, SIZE, len(angle) // batches)
    frames, found = frames_of(pictures), []
    for part in np.array_split(np.arange(len(angle)), batches):
        tracker.take(frames[part[0] : part[-1] + 1], 0, start[part] + 0.02)
        found.append(tracker.measure(len(part), start[part])[kind])
    return TextureObservations(*(np.concatenate([getattr(f, n) for f in found]) for n in vars(found[0])))


@pytest.fixture(scope="module")
def spun():
    """A disc above another one that turns three times as fast; the rough angles err by 3 mrad with the faster one."""
    rng = np.random.default_rng(3)
    angle = 0.19 * np.arange(192) + 1e-5 * np.arange(192) ** 2
    below = 3.1 * angle
    start = angle + 3e-3 * np.cos(3.0 * (below - angle)) + 1e-3 * rng.standard_normal(192)
    pictures = [picture(a, below=b, grain=rng) for a, b in zip(angle, below, strict=True)]
    return angle, start, measured(angle, start, pictures), below


class TestAngle:
    def test_it_grows_counter_clockwise_and_is_right(self, spun):
        angle, start, found, _ = spun
        error = found.angle - angle
        error -= error.mean()
        assert error.std() < 0.6e-3 < 2e-3 < (start - angle).std()

    def test_a_faster_body_below_causes_no_errors(self, spun):
        angle, _, found, below = spun
        error = found.angle - angle
        for k in range(1, 13):
            wave = np.exp(1j * k * (below - angle))
            assert 2.0 * abs(np.mean((error - error.mean()) * wave)) < 0.25e-3

    def test_errors_of_the_rough_angles_do_not_remain(self):
        rng = np.random.default_rng(4)
        angle = 0.19 * np.arange(128)
        off = 3e-3 * rng.standard_normal(128)
        found = measured(angle, angle + off, [picture(a, grain=rng) for a in angle])
        assert abs(np.polyfit(off, found.angle - angle, 1)[0]) < 0.02

    def test_its_uncertainty_is_of_the_size_of_the_error(self, spun):
        angle, _, found, _ = spun
        error = found.angle - angle
        assert 0.4 < (error - error.mean()).std() / np.median(found.sigma) < 1.6

    @pytest.mark.slow
    def test_batches_have_one_zero(self):
        rng = np.random.default_rng(5)
        angle = 0.19 * np.arange(512)
        start = angle + np.where(
            np.arange(512) < 256, 0.0, 4e-3
        )  # the rough angles of the second batch are off
        found = measured(angle, start, [picture(a, grain=rng) for a in angle], batches=2)
        error = found.angle - angle
        assert abs(error[:256].mean() - error[256:].mean()) < 0.2e-3

    def test_a_short_last_batch_is_measured_with_the_templates_of_the_one_before(self):
        rng = np.random.default_rng(6)
        angle = 0.19 * np.arange(300)
        pictures = [picture(a, grain=rng) for a in angle]
        tracker = TextureTracker(HUB, OUTER, SIZE, 260)
        frames = frames_of(pictures)
        tracker.take(frames[:260], 0, angle[:260])
        first, _ = tracker.measure(260, angle[:260])
        tracker.take(frames[260:], 0, angle[260:])
        last, _ = tracker.measure(40, angle[260:])
        assert np.isfinite(last.angle).all()
        assert abs(np.mean(last.angle - angle[260:]) - np.mean(first.angle - angle[:260])) < 0.3e-3

    def test_too_few_frames_have_no_angle(self):
        angle = 0.19 * np.arange(texture.FEWEST - 1)
        assert np.isnan(measured(angle, angle, [picture(a) for a in angle]).angle).all()

    def test_a_covered_ring_has_no_angle(self):
        rng = np.random.default_rng(7)
        angle = 0.19 * np.arange(128)
        pictures = [picture(a, grain=rng) for a in angle]
        for k in range(40, 44):
            pictures[k] = np.full_like(pictures[k], 210.0)
        found = measured(angle, angle, pictures)
        assert np.isnan(found.angle[40:44]).all()
        assert np.isfinite(np.delete(found.angle, slice(40, 44))).all()


class TestView:
    @pytest.mark.parametrize("move", [(3.0, 0.0), (0.0, -3.0)])
    def test_a_displaced_centre_is_corrected(self, move):
        angle = 0.19 * np.arange(128)
        wrong = (HUB[0] + move[0], HUB[1] + move[1])
        rng = np.random.default_rng(8)
        found = measured(angle, angle, [picture(a, grain=rng, arms=1) for a in angle], centre=wrong)
        raw = found.angle - angle
        better = found.levelled(np.tile(HUB, (128, 1)), 0.0, 0.0) - angle
        once = lambda e: abs(np.mean((e - e.mean()) * np.exp(1j * angle)))  # noqa: E731
        assert once(raw) > 0.5e-3
        assert once(better) < 0.35 * once(raw)

    @pytest.mark.parametrize("stretch", [(0.01, 0.0), (0.0, 0.01)])
    def test_an_oblique_view_is_corrected(self, stretch):
        angle = 0.19 * np.arange(128)
        rng = np.random.default_rng(9)
        pictures = [picture(a, stretch=stretch, grain=rng) for a in angle]
        found = measured(angle, angle, pictures)
        raw = found.angle - angle
        better = found.levelled(np.tile(HUB, (128, 1)), *stretch) - angle
        twice = lambda e: abs(np.mean((e - e.mean()) * np.exp(2j * angle)))  # noqa: E731
        assert twice(raw) > 2e-3
        assert twice(better) < 0.35 * twice(raw)


class TestWeights:
    def test_the_weights_are_those_of_independent_errors(self):
        rng = np.random.default_rng(0)
        sigma = np.array([1.0, 2.0, 4.0, 8.0])
        motion = 50.0 * np.linspace(-1.0, 1.0, 4000) ** 3
        angle = 1e-3 * (motion + sigma[:, None] * rng.standard_normal((4, 4000)))
        weights, uncertainty = zone_weights(angle, np.zeros(4, dtype=complex), SHIFT)
        assert weights == pytest.approx(sigma**-2.0 / np.sum(sigma**-2.0), abs=0.05)
        # single frames and means of frames both count, so that slow errors weigh more
        assert uncertainty == pytest.approx(1e-3 * np.sum(sigma**-2.0) ** -0.5 * np.sqrt(2.1), rel=0.1)

    def test_a_zone_whose_error_is_slow_has_less_weight(self):
        rng = np.random.default_rng(1)
        noise = 1e-3 * rng.standard_normal((4, 4096))
        slow = np.repeat(1e-3 * rng.standard_normal(128), 32)
        noise[0] = slow
        weights, _ = zone_weights(noise, np.zeros(4, dtype=complex), SHIFT)
        assert weights[0] < 0.2 * weights[1]

    def test_two_zones_with_the_same_error_count_once(self):
        rng = np.random.default_rng(2)
        noise = 1e-3 * rng.standard_normal((4, 4096))
        noise[1] = noise[0]
        weights, _ = zone_weights(noise, np.zeros(4, dtype=complex), SHIFT)
        assert weights[0] + weights[1] == pytest.approx(weights[2], rel=0.15)

    def test_a_centre_that_is_uncertain_is_avoided(self):
        rng = np.random.default_rng(4)
        noise = 1e-3 * rng.standard_normal((3, 4096))
        first = np.array([0.02, 0.0, 0.0], dtype=complex)
        weights, _ = zone_weights(noise, first, SHIFT)
        assert weights[0] < 0.2 * weights[1]
        # a variance of the centre as large as that of noise, in single frames and in means: half of the weight
        first = np.array([np.sqrt(2.0) * 1e-3 / SHIFT, 0.0, 0.0], dtype=complex)
        weights, _ = zone_weights(noise, first, SHIFT)
        assert weights[0] == pytest.approx(0.5 * weights[1], rel=0.1)

    @pytest.mark.parametrize(("share", "used"), [(0.02, True), (-0.02, False)])
    def test_a_zone_that_is_often_lost_is_not_used(self, share, used):
        rng = np.random.default_rng(6)
        noise = 1e-3 * rng.standard_normal((3, 4096))
        noise[:, :1000] = np.nan  # a hand on all of them
        lost = round((1.0 - texture.LEAST_KNOWN - share) * 3096)
        noise[0, 1000 : 1000 + lost] = np.nan
        weights, _ = zone_weights(noise, np.zeros(3, dtype=complex), SHIFT)
        assert (weights[0] > 0.0) == used
        assert weights.sum() == pytest.approx(1.0)

    def test_it_is_used_beside_only_one_other(self):
        rng = np.random.default_rng(7)
        noise = 1e-3 * rng.standard_normal((2, 4096))
        noise[0, :1500] = np.nan
        weights, _ = zone_weights(noise, np.zeros(2, dtype=complex), SHIFT)
        assert (weights > 0.0).all()

    def test_no_weight_is_negative(self):
        rng = np.random.default_rng(5)
        common, other = rng.standard_normal((2, 4096))
        angle = 1e-3 * np.stack(
            [common, 3.0 * common + 0.1 * other, other + rng.standard_normal(4096), other]
        )
        weights, _ = zone_weights(angle, np.zeros(4, dtype=complex), SHIFT)
        assert (weights >= 0.0).all()
        assert weights.sum() == pytest.approx(1.0)

    def test_one_zone_is_too_few(self):
        weights, uncertainty = zone_weights(np.zeros((1, 500)), np.zeros(1, dtype=complex), SHIFT)
        assert not weights.any()
        assert np.isnan(uncertainty)


def test_a_faint_edge_is_displaced_by_a_part_of_a_grey_level():
    """Strips are interpolated in floats: rounded to grey levels, small displacements of smooth edges are lost."""
    angle = 0.19 * np.arange(192)
    smooth = [cv2.GaussianBlur(picture(a), (0, 0), 6.0) for a in angle]
    off = 2e-3 * np.random.default_rng(0).standard_normal(192)
    found = measured(angle, angle + off, smooth)
    error = found.angle - angle
    assert abs(np.polyfit(off, error, 1)[0]) < 0.1


def test_the_template_of_a_zone_ignores_frames_that_differ():
    rng = np.random.default_rng(11)
    theta = np.arange(texture.COLUMNS) * TURN / texture.COLUMNS
    rows = texture.ZONES * texture.ROWS
    base = (100.0 + 40.0 * np.cos(4.0 * theta))[None, None].repeat(100, 0).repeat(rows, 1)
    strips = (base + 2.0 * rng.standard_normal(base.shape)).astype(np.float32)
    strips[:10] = 250.0 * (theta < 1.0)
    zones = texture._templates(strips, np.linspace(20.0, 90.0, rows))
    turned, _ = zones.fit(strips)
    similar = np.corrcoef(zones.picture.ravel(), base[0].ravel())[0, 1]
    assert similar > 0.999
    assert np.isnan(turned[:, :10]).all()


class TestLargestRotation:
    @staticmethod
    def known(scatter, last):
        """Return whether zones are known in the last of some frames, whose rotations have a scatter [rad]."""
        rng = np.random.default_rng(1)
        theta = np.arange(texture.COLUMNS) * TURN / texture.COLUMNS
        turned = np.append(scatter * rng.standard_normal(80), last)
        rows = texture.ZONES * texture.ROWS
        strips = np.stack([np.tile(100.0 + 40.0 * np.cos(3.0 * (theta - d)), (rows, 1)) for d in turned])
        strips += 2.0 * rng.standard_normal(strips.shape)
        zones = texture._templates(strips.astype(np.float32), np.linspace(20.0, 90.0, rows))
        return np.isfinite(zones.fit(strips.astype(np.float32))[0][:, -1])

    @pytest.mark.parametrize(("share", "inside"), [(0.8, True), (1.3, False)])
    def test_a_sharp_zone_has_no_angle_far_from_the_rough_one(self, share, inside):
        assert (self.known(1e-3, share * texture.LARGEST_TURN) == inside).all()

    def test_a_noisy_zone_has_one_within_its_scatter(self):
        assert self.known(10e-3, 1.5 * texture.LARGEST_TURN).all()
        assert not self.known(10e-3, 4.0 * texture.LARGEST_TURN).any()

    @pytest.mark.parametrize(("scatter", "turns"), [(0.8, True), (2.5, False)])
    def test_a_zone_that_scatters_more_does_not_turn_with_the_body(self, scatter, turns):
        found = self.known(scatter * texture.REACH / texture.FAR, 1.5 * texture.LARGEST_TURN)
        assert (found == turns).all()


class TestTwoZones:
    def test_their_errors_are_at_most_that_of_their_difference(self):
        rng = np.random.default_rng(2)
        turned = np.full((texture.ZONES, 2000), np.nan)
        turned[5:7] = 1e-3 * np.array([[3.0], [4.0]]) * rng.standard_normal((2, 2000))
        found = texture._zone_variances(turned)
        assert found[5:7] == pytest.approx([25e-6, 25e-6], rel=0.1)
        assert np.isinf(np.delete(found, [5, 6])).all()

    def test_three_adjacent_zones_have_finite_errors(self):
        turned = np.full((texture.ZONES, 2000), np.nan)
        turned[3:6] = 1e-3 * np.random.default_rng(4).standard_normal((3, 2000))
        found = texture._zone_variances(turned)
        assert found[3:6] == pytest.approx([1e-6, 2e-6, 1e-6], rel=0.3)

    def test_a_slow_error_that_cannot_be_measured_is_that_of_single_frames(self, monkeypatch):
        rng = np.random.default_rng(5)
        theta = np.arange(texture.COLUMNS) * TURN / texture.COLUMNS
        strips = np.tile(100.0 + 40.0 * np.cos(3.0 * theta), (60, texture.ZONES * texture.ROWS, 1))
        strips = (strips + rng.standard_normal(strips.shape)).astype(np.float32)
        zones = texture._templates(strips, np.linspace(20.0, 90.0, texture.ZONES * texture.ROWS))
        turned = 1e-3 * rng.standard_normal((texture.ZONES, 60))
        monkeypatch.setattr(texture, "_zone_variances", lambda turned: np.full(texture.ZONES, np.inf))
        found = zones.weighted(turned, turned, SHIFT)
        assert found.slow == pytest.approx(found.sigma * np.sqrt(np.sum(found.share**2)))

    def test_they_have_weights(self):
        rng = np.random.default_rng(3)
        angle = 1e-3 * np.array([[1.0], [3.0]]) * rng.standard_normal((2, 2000))
        weights, _ = zone_weights(angle, np.zeros(2, dtype=complex), SHIFT)
        assert weights == pytest.approx([0.9, 0.1], abs=0.04)


class TestBodyAtRestWithoutNoise:
    def test_it_has_an_angle_and_finite_weights(self):
        angle = np.full(64, 0.3)
        found = measured(angle, angle, [picture(0.3)] * 64)
        assert found.angle - found.angle[0] == pytest.approx(np.zeros(64), abs=1e-9)
        assert np.isfinite(found.sigma).all()

    def test_its_scatter_is_at_least_the_rounding_error(self):
        weights, sigma = zone_weights(np.zeros((4, 400)), np.zeros(4, dtype=complex), 0.0)
        assert weights == pytest.approx(np.full(4, 0.25))
        assert sigma == pytest.approx(texture.FINEST * np.sqrt(texture.SHRINKAGE / 4.0))

    def test_a_typical_residual_is_at_least_a_hundredth_of_a_grey_level(self):
        theta = np.arange(texture.COLUMNS) * TURN / texture.COLUMNS
        rows = texture.ZONES * texture.ROWS
        strips = np.tile(100.0 + 40.0 * np.cos(3.0 * theta), (60, rows, 1)).astype(np.float32)
        zones = texture._templates(strips, np.linspace(20.0, 90.0, rows))
        # the weight of a sample is at most 1 / LEAST_VARIANCE, times its area
        most = texture.ROWS * texture.COLUMNS / texture.LEAST_VARIANCE
        assert zones.usual.mean() == pytest.approx(texture.LEAST_RESIDUAL**2 * most, rel=1e-3)
        assert np.isfinite(zones.fit(strips)[0]).all()


def test_blocks_of_frames_have_the_same_angles_as_all_together():
    rng = np.random.default_rng(8)
    theta = np.arange(texture.COLUMNS) * TURN / texture.COLUMNS
    rows = texture.ZONES * texture.ROWS
    turned = 1e-3 * rng.standard_normal(70)
    strips = np.stack([np.tile(100.0 + 40.0 * np.cos(3.0 * (theta - d)), (rows, 1)) for d in turned])
    strips = (strips + 2.0 * rng.standard_normal(strips.shape)).astype(np.float32)
    zones = texture._templates(strips, np.linspace(20.0, 90.0, rows))
    whole, parts = zones.fit(strips), zones.fit_blocks(np.split(strips, [16, 32, 61]))
    assert parts[0] == pytest.approx(whole[0], abs=1e-12)
    assert parts[1] == pytest.approx(whole[1], rel=1e-12)


def test_a_residual_is_what_is_left_of_a_fit():
    """The sum of squares follows from the sums of the fit, without the residuals themselves."""
    rng = np.random.default_rng(9)
    theta = np.arange(texture.COLUMNS) * TURN / texture.COLUMNS
    rows = texture.ZONES * texture.ROWS
    base = np.tile(100.0 + 40.0 * np.cos(3.0 * theta) + 30.0 * np.sin(5.0 * theta), (rows, 1))
    strips = base * (1.0 + 0.03 * rng.standard_normal((60, 1, 1))) + 4.0 * rng.standard_normal((60, 1, 1))
    strips = (strips + 2.0 * rng.standard_normal((60, *base.shape))).astype(np.float32)
    strips[:5] += 30.0 * (theta < 0.5)  # a hand
    zones = texture._templates(strips, np.linspace(20.0, 90.0, rows))
    _, misfit = zones.fit(strips)
    left = np.stack(zones.residuals(strips))
    expected = np.einsum("zns,zs->zn", left.astype(np.float64) ** 2, zones.weight) / zones.usual[:, None]
    assert misfit == pytest.approx(expected, rel=1e-4)
    # mean and mean square of the residuals of the undisturbed frames
    picture = left[:, 5:].mean(axis=1)
    assert np.sqrt(np.mean(picture**2)) < 0.05
    assert zones.variance == pytest.approx(
        (left[:, 5:].astype(np.float64) ** 2).mean(axis=1), rel=0.02, abs=0.02
    )
