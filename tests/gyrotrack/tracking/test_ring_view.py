"""Centre, flattening and static light of a ring, on pictures drawn with a known view."""

from functools import lru_cache

import numpy as np
import pytest

from gyrotrack.tracking import _body_angles
from gyrotrack.tracking import _ring_view as ring_view
from gyrotrack.tracking import _texture as texture
from gyrotrack.tracking._body_angles import LEAST_PERIODIC, LEVEL, RING_ERROR, error_of_ring, periodic_error
from gyrotrack.tracking._film_tracker import BodyObservations
from gyrotrack.tracking._ring_view import View, ViewResponse, slope, static_light, without_light
from gyrotrack.tracking._texture import TextureObservations, TextureTracker

from .test_texture import HUB, OUTER, SIZE, frames_of, measured, picture

TURN = 2.0 * np.pi
COLUMNS = 360
THETA = np.arange(COLUMNS) * TURN / COLUMNS
RADIUS = np.linspace(20.0, 90.0, texture.ZONES * texture.ROWS)


@lru_cache(maxsize=256)
def spots(displacement=(0.0, 0.0), flattening=(0.0, 0.0), angle=0.0, light=0.0, near=(0.0, 0.0)):
    """Return the polar picture of a body of soft oblique spots, in its own coordinates, seen in a view."""
    a = THETA + angle
    r, a = np.meshgrid(RADIUS, a, indexing="ij")
    far = 1.0 - r * (near[0] * np.cos(a) + near[1] * np.sin(a)) / RADIUS[-1]
    x, y = far * r * np.cos(a) - displacement[0], far * r * np.sin(a) - displacement[1]
    p, q = flattening
    u, v = np.linalg.inv([[1 + p, q], [q, 1 - p]]) @ np.stack([x.ravel(), y.ravel()])
    c, s = np.cos(angle), np.sin(angle)
    along, across = c * u + s * v, c * v - s * u
    grey = np.full(r.size, 90.0)
    for k, (at, far) in enumerate(((0.3, 35.0), (1.9, 60.0), (3.0, 78.0), (4.4, 45.0), (5.5, 70.0))):
        du, dv = along - far * np.cos(at), across - far * np.sin(at)
        tilt = at + 0.6 + 0.5 * k
        long, short = np.cos(tilt) * du + np.sin(tilt) * dv, np.cos(tilt) * dv - np.sin(tilt) * du
        grey += 80.0 * np.exp(-0.5 * (long / 14.0) ** 2 - 0.5 * (short / 7.0) ** 2)
    return (grey.reshape(r.shape) + light * np.cos(a - 0.7)).astype(np.float32)


@lru_cache(maxsize=4)
def drawn(seed, first, last, count, **settings):
    """Return pictures at equidistant angles, with the grain of a camera unless the seed is None, for several tests."""
    grain = None if seed is None else np.random.default_rng(seed)
    return [picture(a, grain=grain, **settings) for a in np.linspace(first, last, count)]


def radial(picture):
    return np.gradient(picture.reshape(len(RADIUS), -1), RADIUS, axis=0)


def view_of(angles, displacement, flattening, light=0.0, *, known=None):
    strips = np.stack([spots(displacement, flattening, a, light) for a in angles])
    zones = texture._templates(strips, RADIUS)
    turned, _ = zones.fit(strips)
    response = zones.response(radial(zones.picture), RADIUS)
    left = zones.residuals(strips)
    use = np.isfinite(turned) if known is None else known
    return View.of(response, left, zones.weight, angles, use, 16.0), response, turned


class TestSlope:
    def test_it_is_the_derivative_with_respect_to_the_angle(self):
        waves = np.stack([np.cos(3.0 * THETA), np.sin(7.0 * THETA)])
        assert slope(waves) == pytest.approx(
            np.stack([-3.0 * np.sin(3.0 * THETA), 7.0 * np.cos(7.0 * THETA)]), abs=1e-3
        )


class TestStaticLight:
    ANGLES = np.linspace(0.0, 3.0 * TURN, 90, endpoint=False)

    def test_it_is_what_does_not_turn(self):
        strips = np.stack([spots(angle=a, light=6.0) for a in self.ANGLES])
        found = static_light(strips, self.ANGLES)
        assert found == pytest.approx(np.tile(6.0 * np.cos(THETA - 0.7), (len(RADIUS), 1)), abs=0.3)

    def test_a_body_that_rests_for_half_of_the_time_shows_it(self):
        angles = np.concatenate([np.zeros(60), np.linspace(0.0, TURN, 60)])
        strips = np.stack([spots(angle=a, light=6.0) for a in angles])
        found = static_light(strips, angles)
        assert 2.0 * np.abs(np.fft.rfft(found, axis=1)[:, 1]).mean() / COLUMNS == pytest.approx(6.0, abs=0.3)

    @pytest.mark.parametrize("rest", [0.0, 1.3, 4.0])
    def test_it_is_known_at_whatever_angle_the_body_rests(self, rest):
        angles = np.concatenate([np.full(30, rest), rest + np.linspace(0.0, TURN, 60, endpoint=False)])
        strips = np.stack([spots(angle=a, light=6.0) for a in angles])
        found = static_light(strips, angles)
        assert found == pytest.approx(np.tile(6.0 * np.cos(THETA - 0.7), (len(RADIUS), 1)), abs=1.0)

    def test_without_it_the_pictures_are_those_of_the_body(self):
        strips = np.stack([spots(angle=a, light=6.0) for a in self.ANGLES])
        found = without_light(strips, static_light(strips, self.ANGLES), self.ANGLES)
        assert np.abs(found - spots()).max() < 0.5

    def test_a_body_without_light_keeps_its_picture(self):
        strips = np.stack([spots(angle=a) for a in self.ANGLES])
        assert np.abs(static_light(strips, self.ANGLES)).max() < 0.2


class TestResponse:
    @pytest.mark.parametrize(
        ("displacement", "flattening", "near"),
        [
            ((0.3, 0.0), (0.0, 0.0), (0.0, 0.0)),
            ((0.0, 0.3), (0.0, 0.0), (0.0, 0.0)),
            ((0.0, 0.0), (4e-3, 0.0), (0.0, 0.0)),
            ((0.0, 0.0), (0.0, 4e-3), (0.0, 0.0)),
            ((0.0, 0.0), (0.0, 0.0), (1e-2, 0.0)),
            ((0.0, 0.0), (0.0, 0.0), (0.0, 1e-2)),
        ],
    )
    def test_a_view_turns_a_zone_as_it_says(self, displacement, flattening, near):
        weight = np.ones((texture.ZONES, texture.ROWS * COLUMNS), dtype=np.float32)
        body = spots().reshape(texture.ZONES, -1)
        basis = np.stack([texture._basis(body[z], weight[z]) for z in range(texture.ZONES)])
        response = ViewResponse.of(body, radial(body), basis, weight, RADIUS)
        angles = np.array([0.4, 2.0, 3.7])
        expected = response.seen(np.array([*displacement, *flattening, 0.0, 0.0, *near]), angles)
        for k, angle in enumerate(angles):
            seen = spots(displacement, flattening, angle, near=near).reshape(texture.ZONES, -1)
            for z in range(2, texture.ZONES):
                strip = seen[z].reshape(1, texture.ROWS, COLUMNS)
                turned = texture._fitted(strip, 0, body[z], basis[z], weight[z])[0][0, 0]
                assert turned == pytest.approx(expected[z, k], abs=7e-4)
        assert np.abs(expected[2:]).max() > 2e-3

    def test_edges_along_the_radius_respond_by_the_mean_of_their_directions(self):
        narrow = np.exp(-0.5 * ((THETA - 1.0) / 0.1) ** 2)
        body = np.tile(100.0 * narrow, (len(RADIUS), 1)).astype(np.float32).reshape(texture.ZONES, -1)
        weight = np.ones_like(body)
        basis = np.stack([texture._basis(body[z], weight[z]) for z in range(texture.ZONES)])
        response = ViewResponse.of(body, radial(body), basis, weight, RADIUS)
        rows = RADIUS.reshape(texture.ZONES, texture.ROWS)
        assert response.first == pytest.approx(np.exp(-1j) * (1.0 / rows).mean(axis=1), rel=0.03)
        assert response.second == pytest.approx(np.full(texture.ZONES, np.exp(-2j)), abs=0.05)


class TestWhatAViewExplains:
    """Rows of circular edges that are displaced, beside a static pattern that no view explains."""

    @pytest.mark.parametrize(("share", "explained"), [(0.45, True), (0.55, False)])
    def test_a_row_counts_if_a_view_explains_most_of_what_is_static(self, share, explained):
        angles = np.linspace(0.0, 0.8 * TURN, 40)
        weight = np.ones((texture.ZONES, texture.ROWS * COLUMNS), dtype=np.float32)
        body = spots().reshape(texture.ZONES, -1)
        basis = np.stack([texture._basis(body[z], weight[z]) for z in range(texture.ZONES)])
        edge = radial(body) + 20.0  # of a circular edge
        response = ViewResponse.of(body, edge, basis, weight, RADIUS)
        view = np.array([0.2, -0.1, 2e-3, 1e-3, 0.0, 0.0, 0.0, 0.0])
        turn = ring_view._rotations(angles)
        moved = ((turn - turn.mean(axis=0)) @ view).astype(np.float32)
        caused = [moved @ change.T for change in response.change]
        assert response.explains(view, caused, angles).all()
        assert not response.explains(np.zeros(8), caused, angles).any()
        # with t times what the view causes, (t - 1)^2 of t^2 is left
        times = 1.0 / (1.0 - np.sqrt(share))
        assert (response.explains(view, [times * c for c in caused], angles) == explained).all()

    def test_only_orders_of_a_view_that_do_not_turn_are_compared(self):
        """A pattern on the body or with three periods in the picture is no lack of a displaced edge."""
        angles = np.linspace(0.0, TURN, 24, endpoint=False)
        change = np.zeros((1, COLUMNS, ring_view.VIEW_SIZE), np.float32)
        change[0, :, :2] = np.stack([np.cos(THETA), np.sin(THETA)], axis=1)  # of a circular edge
        response = ViewResponse(change, np.zeros((1, 8)), np.zeros((1, 8, 8)), COLUMNS)
        view = np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        a = THETA + angles[:, None]
        edge = 2.0 * np.cos(a)
        added = {
            "third": 30.0 * np.cos(3.0 * a),
            "body": 30.0 * np.cos(THETA + 0.0 * a),
            "shadow": 4.0 * np.sin(2.0 * a),
        }
        found = {k: response.explains(view, [edge + v], angles).tolist() for k, v in added.items()}
        assert found == {"third": [True], "body": [True], "shadow": [False]}

    def test_the_template_of_a_short_arc_contains_the_mean_of_a_view(self):
        """Over 0.45 turns the mean of exp(i psi) is 0.7: half of what is static is in the template."""
        angles = np.linspace(0.0, 0.45 * TURN, 40)
        change = np.zeros((1, COLUMNS, ring_view.VIEW_SIZE), np.float32)
        change[0, :, :2] = np.stack([np.cos(THETA), np.sin(THETA)], axis=1)
        response = ViewResponse(change, np.zeros((1, 8)), np.zeros((1, 8, 8)), COLUMNS)
        edge = 2.0 * np.cos(THETA + angles[:, None])
        view = np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        assert response.explains(view, [edge - edge.mean(axis=0)], angles).all()


class TestViewOfARing:
    def test_displacement_and_flattening_are_found(self):
        angles = np.linspace(0.0, 1.6 * TURN, 80)
        view, _, _ = view_of(angles, (0.35, -0.2), (3e-3, -2e-3))
        assert view.value[:2] == pytest.approx([0.35, -0.2], abs=0.08)
        assert view.value[2:4] == pytest.approx([3e-3, -2e-3], abs=1.2e-3)

    def test_a_zone_that_is_not_known_does_not_count(self):
        angles = np.linspace(0.0, 1.6 * TURN, 80)
        nothing = np.zeros((texture.ZONES, len(angles)), dtype=bool)
        view, _, _ = view_of(angles, (0.35, -0.2), (0.0, 0.0), known=nothing)
        assert view.value == pytest.approx(np.zeros(ring_view.VIEW_SIZE))
        assert np.sqrt(np.diag(view.covariance)) == pytest.approx(
            np.repeat(
                [getattr(ring_view, n) for n in ("DISPLACEMENT", "FLATTENING", "SHADING", "PERSPECTIVE")], 2
            )
        )

    @pytest.mark.parametrize("turns", [0.8, 1.6])
    def test_its_covariance_is_that_of_repeated_measurements(self, turns):
        """The template contains the mean view: of less than a turn, little is left of a displacement."""
        rng = np.random.default_rng(8)
        angles = np.linspace(0.0, turns * TURN, 40)
        strips = np.stack([spots(angle=a) for a in angles])
        zones = texture._templates(strips + 2.0 * rng.standard_normal(strips.shape, np.float32), RADIUS)
        response = zones.response(radial(zones.picture), RADIUS)
        known = np.ones((texture.ZONES, len(angles)), dtype=bool)
        found, claimed = [], []
        for _ in range(15):
            left = [
                2.0 * rng.standard_normal((len(angles), texture.ROWS * COLUMNS), np.float32)
                for _ in range(texture.ZONES)
            ]
            left = [one - one.mean(axis=0) for one in left]
            view = View.of(response, left, zones.weight, angles, known, 1.0)
            found.append(view.value)
            claimed.append(np.sqrt(np.diag(view.covariance)))
        ratio = np.std(found, axis=0) / np.mean(claimed, axis=0)
        assert (ratio > 0.3).all()
        assert (ratio < 1.3).all()

    def test_frames_that_count_together_have_a_larger_uncertainty(self):
        angles = np.linspace(0.0, 1.6 * TURN, 80)
        zero = [np.zeros((80, texture.ROWS * COLUMNS), np.float32)] * texture.ZONES
        _, response, _ = view_of(angles, (0.0, 0.0), (0.0, 0.0))
        weight = np.ones((texture.ZONES, texture.ROWS * COLUMNS), np.float32)
        known = np.ones((texture.ZONES, 80), dtype=bool)
        one, many = (View.of(response, zero, weight, angles, known, n).covariance for n in (1.0, 16.0))
        assert many[0, 0] == pytest.approx(16.0 * one[0, 0], rel=0.02)

    def test_zones_that_disagree_have_a_larger_uncertainty(self):
        angles = np.linspace(0.0, 1.6 * TURN, 80)
        alike, _, _ = view_of(angles, (0.0, 0.0), (0.0, 0.0))
        apart, _, _ = view_of(angles, (0.0, 0.0), (0.0, 0.0), light=20.0)
        assert apart.covariance[0, 0] > 2.0 * alike.covariance[0, 0]

    def test_its_error_is_the_rms_over_a_turn(self):
        view = View(np.zeros(8), np.diag([0.04, 0.01, 1e-6, 3e-6, 4e-4, 1e-4, 3e-4, 2e-4]))
        rng = np.random.default_rng(1)
        drawn = rng.standard_normal((20_000, 8)) * np.sqrt(np.diag(view.covariance))
        psi = rng.uniform(0.0, TURN, len(drawn))
        rotation = np.array([0.003, 0.004, -0.4, 0.2, 0.02, 0.03, -0.01, 0.02])
        m1, m2, m3, m4 = rotation[1::2] + 1j * rotation[0::2]
        turned = (m1 * (drawn[:, 0] + 1j * drawn[:, 1]) * np.exp(-1j * psi)).imag
        turned += (m2 * (drawn[:, 2] + 1j * drawn[:, 3]) * np.exp(-2j * psi)).imag
        turned += (m3 * (drawn[:, 4] + 1j * drawn[:, 5]) * np.exp(-1j * psi)).imag
        turned += (m4 * (drawn[:, 6] + 1j * drawn[:, 7]) * np.exp(-1j * psi)).imag
        assert view.error(rotation) == pytest.approx(turned.std(), rel=0.03)


def learnt(strips, angles):
    return texture._OwnView.learn(strips, angles, RADIUS, radial(strips.mean(axis=0)))


class TestLearning:
    """A body over an arc, from a centre that is displaced."""

    ANGLES = np.linspace(0.0, 0.8 * TURN, 40)

    def strips(self):
        return np.stack([spots((0.5, -0.3), (0.0, 0.0), a) for a in self.ANGLES])

    def test_the_zones_are_weighted_by_their_rotations_without_the_view(self, monkeypatch):
        given = []
        weighted = texture._Zones.weighted
        monkeypatch.setattr(
            texture._Zones, "weighted", lambda zones, *a: given.append(a) or weighted(zones, *a)
        )
        found = learnt(self.strips(), self.ANGLES)
        ((angle, turned, _),) = given
        assert angle == pytest.approx(self.ANGLES + turned, nan_ok=True)
        caused = found.response.seen(found.view.value, self.ANGLES)
        assert turned[2:].std() < 0.3 * (caused - caused.mean(axis=1, keepdims=True))[2:].std()

    def test_circular_edges_count_in_rows_that_a_view_explains(self, monkeypatch):
        clear = np.arange(len(RADIUS)) % 3 == 0
        given = []
        response = texture._Zones.response
        monkeypatch.setattr(ViewResponse, "explains", lambda *_: clear)
        monkeypatch.setattr(
            texture._Zones, "response", lambda zones, *a: given.append(a[0]) or response(zones, *a)
        )
        edges = radial(spots()) + 20.0
        texture._OwnView.learn(self.strips(), self.ANGLES, RADIUS, edges)
        assert given[0] == pytest.approx(edges)
        assert given[1][clear] == pytest.approx(edges[clear])
        assert given[1][~clear].mean(axis=1) == pytest.approx(np.zeros((~clear).sum()), abs=1e-3)


def both(angle, start, pictures):
    """Return the observations of one batch about the view of the markers and about the own view."""
    tracker = TextureTracker(HUB, OUTER, SIZE, len(angle))
    tracker.take(frames_of(pictures), 0, start + 0.02)
    return tracker.measure(len(angle), start)


def arc(turns, count=70):
    angle = np.linspace(0.0, turns * TURN, count)
    return angle + 0.05 * np.sin(np.linspace(0.0, 3.0, count))


class TestSlowBody:
    def test_large_errors_of_the_rough_angles_do_not_remain(self):
        rng = np.random.default_rng(2)
        angle = arc(1.5)
        start = angle + 16e-3 * np.sin(angle)
        pictures = [picture(a, grain=rng) for a in angle]
        plain, aligned = (found.angle - angle for found in both(angle, start, pictures))
        assert (aligned - aligned.mean()).std() < 0.45e-3 < 0.8 * (plain - plain.mean()).std()

    @pytest.mark.parametrize("move", [(0.6, 0.0), (0.0, -0.6)])
    def test_a_displaced_centre_and_a_flattening_need_no_correction(self, move):
        rng = np.random.default_rng(3)
        angle = arc(1.5)
        hub = HUB[0] + move[0], HUB[1] + move[1]
        pictures = [picture(a, hub=hub, stretch=(4e-3, 3e-3), grain=rng, arms=1) for a in angle]
        found = measured(angle, angle, pictures, kind=1)
        error = found.levelled(found.centre, 0.0, 0.0) - angle
        assert (error - error.mean()).std() < 0.5e-3
        wrong = found.levelled(found.centre + 5.0, 0.05, 0.05) - angle  # what the markers say does not matter
        assert wrong == pytest.approx(error, abs=1e-9)

    def test_a_centre_that_moves_is_followed(self):
        angle = arc(1.5)
        found = measured(angle, angle, [picture(a, arms=1) for a in angle], kind=1)
        shift = np.stack([np.linspace(-0.5, 0.5, len(angle)), np.zeros(len(angle))], axis=1)
        change = found.levelled(found.centre + shift, 0.0, 0.0) - found.angle
        m1 = complex(*found.first[0])
        assert change == pytest.approx(-(m1 * shift[:, 0] * np.exp(-1j * found.angle)).imag, abs=1e-12)

    def test_its_zones_have_the_response_to_both_slopes(self):
        angles = np.linspace(0.0, 1.2 * TURN, 60)
        own = learnt(np.stack([spots(angle=a) for a in angles]), angles)
        assert own.zones.first == pytest.approx(own.response.first)
        assert own.zones.second == pytest.approx(own.response.second)
        along_the_orbit = texture._templates(np.stack([spots(angle=a) for a in angles]), RADIUS)
        assert np.abs(own.response.first - along_the_orbit.first).max() > 2e-3

    def test_each_view_contains_its_own_mean_place(self):
        """Two templates of two batches each: a constant displacement of each batch is part of its view."""
        ring = TextureObservations.unknown(np.zeros((8, 2)))
        ring.angle[:] = 0.3
        ring.first[:] = (5e-3, 2e-3)
        ring.first[4:] = (4e-3, 2e-3)
        ring.own_view[:] = (1, 1, 2, 2, 1, 1, 2, 2)
        centre = np.repeat([[1.0, 0.0], [-2.0, 1.0], [0.5, 3.0], [4.0, -1.0]], 2, axis=0)
        assert ring.levelled(centre, 0.0, 0.0) == pytest.approx(np.full(8, 0.3), abs=1e-12)

    def test_zones_that_a_shadow_displaces_have_less_weight(self, monkeypatch):
        angles = np.linspace(0.0, 1.2 * TURN, 60)
        strips = np.stack([spots(angle=a) for a in angles])
        strips += np.random.default_rng(7).standard_normal(strips.shape, np.float32)
        response = []
        for size in (0.0, texture.SHADOW_ERROR, 3.0):
            monkeypatch.setattr(texture, "SHADOW_ERROR", size)
            zones = learnt(strips, angles).zones
            response.append(abs(zones.share @ zones.first))
        assert response[0] > 1.05 * response[1] > 1.1 * response[2]

    @pytest.mark.parametrize(("share", "known"), [(0.98, False), (1.02, True)])
    def test_an_arc_shows_the_view(self, share, known):
        angle = np.linspace(0.0, share * ring_view.LEAST_ARC * TURN, 60)
        found = measured(angle, angle, [picture(a) for a in angle], kind=1)
        assert np.isfinite(found.angle).all()
        assert ((found.own_view > 0.0) == known).all()

    @pytest.mark.parametrize(
        "turns", [pytest.param(0.5, marks=pytest.mark.slow), pytest.param(0.8, marks=pytest.mark.slow), 1.2]
    )
    @pytest.mark.parametrize("across", [False, True])
    def test_shading_does_not_turn_the_ring(self, turns, across):
        angle = np.linspace(0.0, turns * TURN, 70)
        x, y = np.meshgrid(np.arange(SIZE[0]) - HUB[0], HUB[1] - np.arange(SIZE[1]))
        shade = 1.0 + 0.1 * (y if across else x) / 75.0
        start = angle + 2e-3 * np.sin(angle + 1.0)
        pictures = [p * shade for p in drawn(5, 0.0, turns * TURN, 70)]
        plain, own = (f.levelled(f.centre, 0.0, 0.0) - angle for f in both(angle, start, pictures))
        assert (own - own.mean()).std() < min(0.4e-3, 0.7 * (plain - plain.mean()).std())

    @pytest.mark.parametrize(
        ("arms", "turns"),
        [(1, 0.8), (2, 1.5), *(pytest.param(*p, marks=pytest.mark.slow) for p in ((1, 1.5), (2, 0.8)))],
    )
    def test_an_ellipse_is_found_and_does_not_turn_the_ring(self, monkeypatch, turns, arms):
        """Edges are narrower than the distance of the rows, and those of the rim are circles."""
        views, learn = [], texture._OwnView.learn
        monkeypatch.setattr(texture._OwnView, "learn", lambda *a: views.append(learn(*a)) or views[-1])
        rng = np.random.default_rng(1)
        angle = np.linspace(0.0, turns * TURN, 90)
        pictures = [picture(a, stretch=(4e-3, 3e-3), grain=rng, arms=arms) for a in angle]
        found = measured(angle, angle - 4e-3 * np.sin(2.0 * angle), pictures, kind=1)
        assert views[-1].view.value[2:4] == pytest.approx([4e-3, 3e-3], abs=4e-4)
        assert np.std(found.angle - angle) < 0.3e-3

    @pytest.mark.parametrize(
        ("every", "known"), [pytest.param(8, True, marks=pytest.mark.slow), (31, True), (42, False)]
    )
    def test_four_frames_determine_the_slopes_along_the_radius(self, monkeypatch, every, known):
        monkeypatch.setattr(texture, "_SLOPE_EVERY", every)
        views, learn = [], texture._OwnView.learn
        monkeypatch.setattr(texture._OwnView, "learn", lambda *a: views.append(learn(*a)) or views[-1])
        angle = np.linspace(0.0, 0.8 * TURN, 124)
        measured(angle, angle, drawn(None, 0.0, 0.8 * TURN, 124, stretch=(4e-3, 3e-3)), kind=1)
        assert (abs(views[-1].view.value[2] - 4e-3) < 4e-4) == known

    def test_perspective_is_found(self):
        angles = np.linspace(0.0, 0.9 * TURN, 60)
        strips = np.stack([spots(angle=a, near=(4e-3, -6e-3)) for a in angles])
        assert learnt(strips, angles).view.value[6:] == pytest.approx([4e-3, -6e-3], abs=1.5e-3)

    @pytest.mark.parametrize("depth", [pytest.param(0.0, marks=pytest.mark.slow), 40.0])
    def test_a_shadow_beside_the_rim_is_not_a_displacement(self, depth):
        """It darkens one side of the gap between the disc and the rim, and is static."""
        angle = np.linspace(0.0, 0.8 * TURN, 70)
        x, y = np.meshgrid(np.arange(SIZE[0]) - HUB[0], HUB[1] - np.arange(SIZE[1]))
        r, a = np.hypot(x, y), np.arctan2(y, x)
        shadow = depth * np.exp(-0.5 * ((r - 71.0) / 2.0) ** 2) * np.clip(np.cos(a - 0.5), 0.0, None)
        found = measured(angle, angle, [p - shadow for p in drawn(9, 0.0, 0.8 * TURN, 70)], kind=1)
        assert np.std(found.angle - angle) < 0.3e-3

    def test_the_shading_is_found(self):
        angles = np.linspace(0.0, 0.9 * TURN, 60)
        x, y = (RADIUS[:, None] * f(THETA + angles[:, None, None]) for f in (np.cos, np.sin))
        strips = np.stack([spots(angle=a) for a in angles]) * (1.0 + (0.06 * x - 0.04 * y) / RADIUS[-1])
        found = learnt(strips.astype(np.float32), angles)
        assert found.view.value[4:6] == pytest.approx([0.06, -0.04], abs=0.015)

    @pytest.mark.slow
    def test_the_error_of_the_view_is_part_of_the_slow_error(self, monkeypatch):
        angle = arc(1.5)
        pictures = [picture(a) for a in angle]
        small = measured(angle, angle, pictures, kind=1)
        monkeypatch.setattr(View, "error", lambda *_: 2e-3)
        large = measured(angle, angle, pictures, kind=1)
        assert large.slow == pytest.approx(np.hypot(small.slow, 2e-3), rel=0.2)

    def test_batches_have_one_zero_and_views_that_differ(self, monkeypatch):
        monkeypatch.setattr(texture, "LEARNT", 60)
        rng = np.random.default_rng(6)
        angle = np.linspace(0.0, 3.6 * TURN, 200)
        tracker = TextureTracker(HUB, OUTER, SIZE, 90)
        x = np.arange(SIZE[0]) - HUB[0]
        frames = frames_of([picture(a, grain=rng, arms=1) * (1.0 + 0.05 * x / 75.0) for a in angle])
        found, learnt, learn = [], [], texture._OwnView.learn
        monkeypatch.setattr(texture._OwnView, "learn", lambda *a: learnt.append(len(a[0])) or learn(*a))
        for first, last, move in ((0, 80, 0.0), (80, 160, 0.6), (160, 200, 0.6)):
            tracker.centre = HUB[0] + move, HUB[1]
            start = angle[first:last] + 4e-3 * move
            tracker.take(frames[first:last], 0, start)
            found.append(tracker.measure(last - first, start)[1])
        ring = TextureObservations(*(np.concatenate([getattr(f, n) for f in found]) for n in vars(found[0])))
        error = ring.levelled(np.tile(HUB, (200, 1)), 0.0, 0.0) - angle
        means = [float(error[part].mean()) for part in (slice(0, 80), slice(80, 160), slice(160, 200))]
        assert np.ptp(means) < 0.4e-3
        assert (error - error.mean()).std() < 0.6e-3
        assert len(np.unique(ring.own_view)) == 3
        assert set(learnt) == {80}  # not from the short batch

    def test_a_fast_batch_between_slow_ones_keeps_their_zero(self, monkeypatch):
        monkeypatch.setattr(texture, "LEARNT", 60)
        rng = np.random.default_rng(7)
        slow = np.linspace(0.0, 1.3 * TURN, 64)
        fast = slow[-1] + np.linspace(0.02, 5.0 * TURN, 64)
        angle = np.concatenate([slow, fast, fast[-1] + slow + 0.02])
        tracker = TextureTracker(HUB, OUTER, SIZE, 64)
        frames = frames_of([picture(a, grain=rng) for a in angle])
        found = []
        for k in range(3):
            part = slice(64 * k, 64 * k + 64)
            start = angle[part] + (0.0, 0.0, 4e-3)[k]
            tracker.take(frames[part], 0, start)
            found.append(tracker.measure(64, start)[1].angle - angle[part])
        assert np.isnan(found[1]).all()
        assert found[2].mean() == pytest.approx(found[0].mean(), abs=0.4e-3)

    @pytest.mark.parametrize(("turns", "slow"), [(2.95, True), (3.05, False)])
    def test_a_fast_body_is_measured_about_the_view_of_the_markers(self, turns, slow):
        angle = np.linspace(0.0, turns * TURN, 60)
        pictures = [picture(a) for a in angle]
        plain, own = both(angle, angle, pictures)
        assert np.isfinite(own.angle).all() if slow else np.isnan(own.angle).all()
        assert np.isfinite(plain.angle).all()


class TestBestRing:
    @staticmethod
    def rings(share):
        count = 1000
        plain, aligned = (TextureObservations.unknown(np.zeros((count, 2))) for _ in range(2))
        plain.angle[:] = 0.0
        aligned.angle[: round(share * count)] = 0.0
        return BodyObservations(np.zeros(count), {}, plain, aligned)

    def test_a_body_that_is_always_slow_has_its_own_view(self):
        body = self.rings(_body_angles._ALMOST_ALL + 0.01)
        assert _body_angles._best_ring(body, 0.0) is body.aligned

    def test_a_body_that_is_sometimes_fast_has_that_of_the_markers(self):
        body = self.rings(_body_angles._ALMOST_ALL - 0.01)
        assert _body_angles._best_ring(body, 0.0) is body.texture

    @pytest.mark.parametrize(("share", "own"), [(0.9, True), (1.1, False)])
    def test_an_oblique_view_is_that_of_the_markers(self, share, own):
        body = self.rings(1.0)
        assert _body_angles._best_ring(body, share * LEVEL) is (body.aligned if own else body.texture)

    def test_a_body_without_a_ring_has_none(self):
        assert _body_angles._best_ring(BodyObservations(np.zeros(3), {}), 0.0) is None


class TestErrorOfARing:
    @pytest.mark.parametrize(("share", "error"), [(0.01, RING_ERROR), (-0.01, 0.1)])
    def test_a_ring_about_its_own_view_has_a_smaller_one(self, share, error):
        ring = TextureObservations.unknown(np.zeros((1200, 2)))
        ring.angle[:1000] = 0.0
        ring.own_view[: round((_body_angles._ALMOST_ALL + share) * 1000)] = 1.0
        ring.own_view[1000:] = np.nan
        assert error_of_ring(ring, 0.1) == error


def test_typical_errors_have_their_stated_sizes():
    """A tilt of 0.2 rad flattens by a hundredth; 0.055 px of a ring, 0.3 mrad of shading, a view of 8 degrees."""
    assert pytest.approx(0.2**2 / 4.0) == ring_view.FLATTENING
    assert (ring_view.DISPLACEMENT, ring_view.SHADING) == (1.0, 0.1)
    assert (RING_ERROR, LEAST_PERIODIC) == (0.055, 0.3e-3)
    assert pytest.approx((np.radians(8.1) / 2.0) ** 2, rel=0.02) == LEVEL


class TestPeriodicError:
    CENTRE, FLAT = np.full(6, 0.4), 7e-4

    @staticmethod
    def ring():
        """A slow template of three frames, and a fast one of two; the last frame is not known."""
        ring = TextureObservations.unknown(np.zeros((6, 2)))
        ring.angle[:5] = 0.0
        ring.first[:3], ring.first[3:5] = (4e-3, 3e-3), (1e-3, -1e-3)
        ring.second[:3], ring.second[3:5] = (0.9, 0.0), (0.6, 0.4)
        return ring

    def test_without_fast_frames_it_is_that_of_the_whole_response(self):
        found = periodic_error(self.ring(), self.CENTRE, self.FLAT, np.zeros(6, dtype=bool))
        assert found == pytest.approx(np.hypot(5e-3 * np.hypot(0.4, texture.CENTRE_ERROR), 0.9 * self.FLAT))

    def test_what_fast_frames_show_is_known(self):
        learnt = np.array([False] * 3 + [True] * 2 + [False])
        found = periodic_error(self.ring(), self.CENTRE, self.FLAT, learnt)
        of_view = np.hypot(5e-3 * np.hypot(0.4, texture.CENTRE_ERROR), 0.5 * self.FLAT)
        assert found == pytest.approx(np.hypot(of_view, LEAST_PERIODIC))

    def test_a_ring_about_its_own_view_has_it_in_its_slow_error(self):
        ring = self.ring()
        ring.own_view[:] = 1.0
        assert periodic_error(ring, self.CENTRE, self.FLAT, np.zeros(6, dtype=bool)) == 0.0


class TestFastBody:
    """A fast bar below a fixed pattern of four periods per turn, as of a rim whose edge is sampled on pixels."""

    ORDER = 4

    def error(self, turns, order=ORDER):
        """Return the amplitude of the error with `order` periods per turn [rad]."""
        angle = np.linspace(0.0, turns * TURN, 96)
        x, y = np.meshgrid(np.arange(SIZE[0]) - HUB[0], HUB[1] - np.arange(SIZE[1]))
        fixed = 10.0 * np.cos(order * np.arctan2(y, x) + 0.4)
        found = measured(angle, angle, [p + fixed for p in drawn(6, 0.0, turns * TURN, 96)])
        off = found.angle - angle
        waves = np.stack([np.ones_like(angle), np.cos(order * angle), np.sin(order * angle)], axis=1)
        return float(np.hypot(*np.linalg.lstsq(waves, off, rcond=None)[0][1:]))

    def test_a_fixed_pattern_does_not_turn_it(self, monkeypatch):
        after = self.error(40.3)
        monkeypatch.setattr(texture, "FAST_TURNS", 50.0)
        assert after < 0.2e-3 < 1e-3 < self.error(40.3)

    @pytest.mark.parametrize(("share", "subtracted"), [(0.98, False), (1.02, True)])
    def test_the_pattern_is_subtracted_from_fast_turns_on(self, share, subtracted):
        assert (self.error(share * texture.FAST_TURNS) < 0.2e-3) == subtracted

    def test_it_is_not_subtracted_from_a_slower_batch(self, monkeypatch):
        monkeypatch.setattr(texture, "LEARNT", 60)
        angle = np.concatenate([np.linspace(0.0, 20.0 * TURN, 80), 20.0 * TURN + np.linspace(0.0, TURN, 80)])
        tracker = TextureTracker(HUB, OUTER, SIZE, 80)
        frames, lights = frames_of([picture(a) for a in angle]), []
        for part in (slice(0, 80), slice(80, 160)):
            tracker.take(frames[part], 0, angle[part])
            tracker.measure(80, angle[part])
            lights.append(tracker._light)
        assert lights[0] is not None
        assert lights[1] is None

    def test_the_orders_of_centre_and_tilt_are_kept(self):
        angles = np.linspace(0.0, 12.0 * TURN, 120, endpoint=False)
        strips = np.stack([spots(angle=a, light=6.0) for a in angles])  # of order 1
        assert np.abs(static_light(strips, angles, texture.LOWEST_LIGHT_ORDER)).max() < 0.3
        strips += np.stack([np.roll(4.0 * np.cos(3.0 * THETA), -round(a * COLUMNS / TURN)) for a in angles])[
            :, None
        ]
        found = static_light(strips, angles, texture.LOWEST_LIGHT_ORDER)
        assert found == pytest.approx(np.tile(4.0 * np.cos(3.0 * THETA), (len(RADIUS), 1)), abs=0.4)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_ring_is_aligned_up_to_its_margin(sense):
    """The angle that the ring shows is beyond the margin, where no samples are; the rest is a rotation of zones."""
    step = sense * texture.STEP
    angle, odd = np.linspace(0.0, 0.8 * TURN, 64), np.arange(64) % 2 == 1
    tracker = TextureTracker(HUB, OUTER, SIZE, 64)
    coarse = angle - np.where(odd, texture.MARGIN - 0.6, 3.0) * step
    tracker.take(frames_of([picture(a) for a in angle]), 0, coarse)
    _, found = tracker.measure(64, angle + np.where(odd, -0.8, 0.8) * step)
    error = found.angle - angle
    assert np.isfinite(error).all()
    assert abs(error[odd].mean() - error[~odd].mean()) < 3e-3  # 28 mrad of the given angles
