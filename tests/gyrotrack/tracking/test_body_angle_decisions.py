"""Axis of the rotor, errors that bodies are joined with, and rings of texture: hand-computed cases on either side."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.tracking import _body_angles as module
from gyrotrack.tracking._body_angles import (
    BLOCK_ERROR,
    BORROWED_NU,
    LEAST_PERIODIC,
    LIGHT_ERROR,
    RING_ERROR,
    about_rotor,
    axis_offset,
    error_of_ring,
    periodic_error,
    separate_perspective,
    usual_error_of_harmonic,
    view,
)
from gyrotrack.tracking._hub import CentrePath, Radii
from gyrotrack.tracking._orbit import NO_FLATTENING, Flattening
from gyrotrack.tracking._texture import CENTRE_ERROR, TextureObservations
from tests.gyrotrack.tracking import test_body_decisions as decisions
from tests.gyrotrack.tracking.test_body_angles import CENTRE, TURN, body, markers_of, path

N = 400


class TestMarkers:
    def test_only_trusted_frames_show_an_orbit(self):
        seen = markers_of("rotor", (50.0,))
        seen.whole["rotor0"][:7] = False
        seen.observations["rotor0"].radius[:7] = 90.0
        orbit = seen._trusted("rotor0", path().centre)
        assert np.hypot(*orbit.T) == pytest.approx(np.full(N - 7, 50.0))

    def test_a_marker_that_leaves_the_picture_has_no_angle(self):
        seen = markers_of("rotor", (50.0,))
        seen.inside["rotor0"][3] = False
        good = seen.candidates(path(), NO_FLATTENING)["rotor0"].good
        assert np.flatnonzero(~good).tolist() == [3]

    @pytest.mark.parametrize(("outer", "inside"), [(240.05, True), (240.2, False)])
    def test_a_marker_ends_at_seven_tenths_of_its_blurred_half_width(self, outer, inside):
        """At pi / 2 - 0.1 rad, with a half width of 0.1 rad, 240 px below the border: 240.05 cos 0.03 = 239.94."""
        seen = markers_of("rotor", (231.0,))
        seen.observations["rotor0"].angle[:] = 0.5 * np.pi - 0.1
        marker = replace(seen.markers[0], outer=outer)
        found = view((marker,), seen.observations, (640, 480))
        assert found.inside["rotor0"].all() == found.inside["rotor0"].any() == inside


class TestAxisOfTheRotor:
    """A disc that is fixed to the casing beside the axis of the rotor."""

    def film(self, offset, *, casing=(90.0,), rate=0.02):
        """Return the path of the disc and the views; the axis stays at CENTRE."""
        circle = offset * np.exp(1j * rate * np.arange(N))
        centre = CENTRE + np.stack([circle.real, -circle.imag], axis=1)
        views = {
            "casing": markers_of("casing", casing, rate=rate),
            "rotor": markers_of("rotor", (60.0, 70.0), rate=0.31),
        }
        return CentrePath(centre, np.full(N, 0.05), 0), views

    @pytest.mark.parametrize("offset", [1.0 + 0.0j, -0.4 + 0.7j])
    def test_its_circle_is_subtracted(self, offset):
        seen, views = self.film(offset)
        found = about_rotor(seen, views)
        assert np.abs(found.centre - CENTRE).max() < 0.1
        assert np.abs(seen.centre - CENTRE).max() > 0.6

    @pytest.mark.parametrize(("rate", "corrected"), [(1.05 / N, True), (0.95 / N, False)])
    def test_the_casing_turns_by_a_radian(self, rate, corrected):
        seen, views = self.film(1.0, rate=rate)
        assert (about_rotor(seen, views) is not seen) is corrected

    @pytest.mark.parametrize(("size", "corrected"), [(3.2, True), (2.8, False)])
    def test_an_offset_has_three_times_the_error_of_a_harmonic(self, monkeypatch, size, corrected):
        monkeypatch.setattr(module, "_error_of_harmonic", lambda *_: 0.3)
        seen, views = self.film(size * 0.3)
        assert (about_rotor(seen, views) is not seen) is corrected

    def test_the_radii_must_vary_less(self, monkeypatch):
        seen, views = self.film(1.0)
        monkeypatch.setattr(module, "_is_better", lambda before, after: False)
        assert about_rotor(seen, views) is seen

    def test_all_markers_of_the_rotor_and_the_best_seen_one_of_the_casing_count(self):
        seen, views = self.film(1.0, casing=(90.0, 95.0))
        views["casing"].whole["casing1"][:-5] = False
        views["rotor"].whole["rotor1"][:] = False
        assert np.abs(about_rotor(seen, views).centre - CENTRE).max() < 0.1

    @pytest.mark.parametrize(("size", "used"), [(3.0, True), (10.0, False)])
    def test_radii_within_four_standard_deviations_count(self, size, used):
        """Of a tenth of a pixel: the outliers are in phase with the offset that they imitate."""
        direction = np.angle(np.exp(1j * 0.37 * np.arange(2000)))
        casing = 0.01 * np.arange(2000)
        excess = 0.1 * np.random.default_rng(1).standard_normal(2000)
        wave = -np.cos(direction - casing)
        chosen = np.flatnonzero(wave > 0.9)[::3]
        excess[chosen] = size * 0.1
        normal, right = module._offset_on_casing(Radii(direction, excess), casing)
        found = np.linalg.solve(normal, right)[0]
        assert (found > 0.012) == used

    def test_an_outlier_of_a_small_residual_counts_fifty_times_the_usual_one(self):
        """Squares of 0.01 px^2 that fall to 0.008; one marker is mistaken for another one in a frame."""
        before, after = np.full((1, 1600), 0.01), np.full((1, 1600), 0.008)
        before[0, ::2] *= 1.1
        assert module._is_better(before, after)
        after[0, 100] = 100.0
        assert module._is_better(before, after)


class TestViews:
    def test_the_body_of_the_larger_error_determines_that_of_the_tilt(self, monkeypatch):
        errors = {70.0: 0.07, 90.0: 0.27}
        monkeypatch.setattr(
            module, "_error_of_harmonic", lambda centre, body_view, flat: errors[body_view.radius]
        )
        given = decisions.TestOrbits().given
        views = {
            "rotor": given("rotor", Flattening({"rotor0": (1.0, 0.0)}, -0.02, 0.0), 70.0, []),
            "casing": given("casing", Flattening({"casing0": (1.0, 0.0)}, -0.02, 0.0), 90.0, []),
        }
        found = module._flattening(path(), views)
        assert [found[name].error for name in views] == pytest.approx([3e-3, 3e-3])

    @pytest.mark.parametrize(("size", "azimuth"), [(1.9, 0.0), (2.1, np.pi / 2)])
    @pytest.mark.parametrize("count", [1, 3])
    def test_half_an_offset_weighs_as_much_as_a_flattening(self, size, azimuth, count):
        """(shift / 2)^2 / u^2 against p^2 / u^2; several coloured markers average the errors of their blocks."""
        seen = markers_of("rotor", (70.0,) * count)
        own = math.hypot(BLOCK_ERROR / math.sqrt(count), LIGHT_ERROR * 70.0) / math.sqrt(6.0)
        flat = Flattening({f"rotor{k}": (0.0, size * own) for k in range(count)}, -0.01, 0.0)
        found = module._azimuth(-0.01 + 0j, 0.01, {"rotor": flat}, {"rotor": seen})
        assert abs(np.sin(found - azimuth)) < 1e-6

    def test_the_axis_of_several_markers_is_known_better(self, monkeypatch):
        seen, asked = markers_of("rotor", (70.0, 70.0, 70.0)), []
        monkeypatch.setattr(module, "_shrunk", lambda found, error: asked.append((found.tolist(), error)))
        flat = Flattening({f"rotor{k}": (0.0, 0.0) for k in range(3)}, 0.0, 0.0)
        axis_offset(seen, flat, body([0.0], axis_off={f"rotor{k}": (k - 2j) / 70.0 for k in range(3)}))
        error = math.hypot(BLOCK_ERROR / math.sqrt(3.0), LIGHT_ERROR * 70.0) / math.sqrt(6.0)
        assert asked == [(pytest.approx([1.0, -2.0]), pytest.approx(math.sqrt(2.0) * error))]


class TestPerspective:
    def views(self, casing, rotor, p=-0.0025, q=0.0):
        seen = {"casing": markers_of("casing", (90.0,)), "rotor": markers_of("rotor", (60.0,))}
        return seen, {
            "casing": Flattening({"casing0": casing}, p, q, error=1e-5),
            "rotor": Flattening({"rotor0": rotor}, p, q, error=1e-5),
        }

    @pytest.mark.parametrize(
        ("axis", "across"), [(0.2 + 0.2j, 0.0), (0.2 - 0.2j, 0.08), (-0.3 + 0.0j, 0.045), (0.0 + 0.3j, 0.045)]
    )
    def test_the_axis_across_the_tilt_is_an_error(self, monkeypatch, axis, across):
        """The tilt has an azimuth of 45 degrees; the squares of the component across it, in px^2."""
        asked = []
        monkeypatch.setattr(module, "_shrunk", lambda found, error: asked.append(error) or found)
        views, flat = self.views((0.5, 0.0), (0.0, 0.0), 0.0, -0.0025)
        separate_perspective(path(), views, flat, body([0.0], axis_off={"rotor0": axis / 60.0}))
        usual = usual_error_of_harmonic(views["rotor"])
        expected = math.sqrt((BORROWED_NU * usual**2 + across) / (BORROWED_NU + 1.0))
        assert asked == pytest.approx([math.sqrt(2.0) * expected, expected])

    @pytest.mark.parametrize("offset", [0.2, 0.8])
    def test_without_a_fast_rotor_perspective_is_an_error(self, offset):
        """Of a twentieth of the tilt times the radius."""
        views, flat = self.views((offset, 0.0), (1.0, 0.0))
        error = usual_error_of_harmonic(views["rotor"]) ** 2
        noise = error * (1.0 + (90.0 / 60.0) ** 4) + (0.05 * 0.1 * 90.0) ** 2
        size = module._height_error(flat["rotor"], views["rotor"], 90.0) ** 2
        expected = (0.0, 1.0 - 2.0 * error)
        weights = np.exp([-0.5 * (offset - e) ** 2 / (size + noise) for e in expected])
        means = np.array([e + size / (size + noise) * (offset - e) for e in expected])
        found = separate_perspective(path(), views, flat, body([0.0]))
        assert found.offset["casing0"] == pytest.approx((weights @ means / weights.sum(), 0.0), abs=1e-6)

    def test_an_arc_is_fitted_about_the_expected_offsets_with_perspective(self, monkeypatch):
        """The axis by angles is 1 px from that by radii: (90 / 60)^2 px at the casing."""
        monkeypatch.setattr(module, "_shrunk", lambda found, error: found)
        views, flat = self.views((0.5, 0.0), (2.0, 0.0))
        asked = []

        def of_arc(centre, reference, expected, size):
            asked.append((reference.p, expected, size))
            return Flattening({"casing0": (7.0, 1.0)}, 0.0, 0.0)

        views["casing"] = SimpleNamespace(radius=90.0, flattening_of_arc=of_arc)
        flat["casing"] = replace(flat["casing"], p=-0.003, offset_covariance={"casing0": np.eye(2)})
        found = separate_perspective(path(), views, flat, body([0.0], axis_off={"rotor0": 1.0 / 60.0}))
        ((p, expected, size),) = asked
        assert p == -0.003
        assert expected == pytest.approx(np.array([[-2.25, 0.0], [3.0 - 2.25, 0.0]]), abs=1e-9)
        assert size == module._height_error(flat["rotor"], views["rotor"], 90.0)
        assert found.offset["casing0"] == pytest.approx((9.25, 1.0))


class TestFollowed:
    """What the markers of a rotor of 70 px are joined with."""

    def joined(self, monkeypatch, flat, *, sigma=0.05, reach=100, texture=None):
        asked = []

        def join(coarse, candidates, fps, other, floor, axis, orbit, **options):
            asked.append((axis, orbit, options["arcs"]))
            return body(np.linspace(0.0, 9.0, N))

        monkeypatch.setattr(module, "join", join)
        seen = SimpleNamespace(
            bodies={"rotor": SimpleNamespace(coarse=np.linspace(0.0, 9.0, N), texture=texture)}, disc=None
        )
        centre = CentrePath(np.tile(CENTRE, (N, 1)), np.full(N, sigma), reach)
        views = {"rotor": markers_of("rotor", (70.0,), rate=4 * TURN / N)}
        bodies, _ = module._followed(seen, views, centre, {"rotor": flat}, 100.0, None)
        return bodies["rotor"], asked[0]

    def test_an_error_of_the_centre_counts_beside_its_mean_in_each_part(self, monkeypatch):
        """In four parts of a hundred frames, over which it is constant."""
        _, (axis, _, _) = self.joined(monkeypatch, NO_FLATTENING)
        parts = np.array_split(np.exp(1j * np.linspace(0.0, 9.0, N)), 4)
        left = 1.0 - sum(abs(part.sum()) ** 2 for part in parts) / N**2
        assert 0.5 < left < 0.95
        assert axis == pytest.approx(np.full(N, 0.05 * math.sqrt(left) / 70.0))
        _, (axis, _, _) = self.joined(monkeypatch, NO_FLATTENING, sigma=np.nan)
        assert not axis.any()

    def test_errors_of_offset_and_tilt_are_angles(self, monkeypatch):
        flat = Flattening({"rotor0": (0.0, 0.0)}, 0.0, 0.0, {"rotor0": 0.04 * np.eye(2)}, error=3e-3)
        _, (_, orbit, arcs) = self.joined(monkeypatch, flat)
        assert orbit == pytest.approx(np.full(N, math.hypot(0.2 / 70.0, 3e-3)))
        assert arcs["rotor0"] == pytest.approx(0.04 / 70.0**2 * np.eye(2))

    def test_a_ring_replaces_the_angles_and_has_a_harmonic_error(self, monkeypatch):
        asked = []

        def by_texture(found, texture, centre, flat, coarse, fps, usual, radius, time_base, others):
            asked.append((texture, fps, radius, others))
            return replace(found, angle=found.angle + 1.0)

        monkeypatch.setattr(module, "by_texture", by_texture)
        monkeypatch.setattr(module, "_best_ring", lambda seen, flattening: ("ring", flattening))
        monkeypatch.setattr(module, "harmonic_error", lambda angle: float(angle[0]))
        found, _ = self.joined(monkeypatch, Flattening({}, 0.003, 0.004), texture="ring")
        assert asked == [(("ring", pytest.approx(0.005)), 100.0, 70.0, [])]
        assert (found.angle[0], found.harmonic) == (1.0, 1.0)


def ring(n, *, own=0.0, angle=None, first=(0.0, 0.0), second=(0.0, 0.0)):
    column = np.ones(n)
    return TextureObservations(
        np.zeros(n) if angle is None else angle, 1e-3 * column, 1e-4 * column, column, np.tile(CENTRE, (n, 1)),
        np.broadcast_to(first, (n, 2)).copy(), np.broadcast_to(second, (n, 2)).copy(), own * column,
    )  # fmt: skip


class TestRings:
    @pytest.mark.parametrize(("own", "error"), [(94, 0.3), (96, RING_ERROR)])
    def test_nineteen_in_twenty_frames_about_its_own_view(self, own, error):
        """Of a hundred frames with an angle."""
        angle = np.where(np.arange(150) < 100, 0.0, np.nan)
        assert error_of_ring(ring(150, own=np.arange(150) < own, angle=angle), 0.3) == error

    @pytest.mark.parametrize(
        ("known", "flattening", "own"),
        [(96, 0.004, True), (94, 0.004, False), (96, 0.006, False), (94, 0.006, False)],
    )
    def test_a_level_ring_about_its_own_view_is_best(self, known, flattening, own):
        texture = ring(100)
        aligned = ring(100, angle=np.where(np.arange(100) < known, 0.0, np.nan))
        found = module._best_ring(SimpleNamespace(texture=texture, aligned=aligned), flattening)
        assert found is (aligned if own else texture)
        assert module._best_ring(SimpleNamespace(texture=texture, aligned=None), flattening) is texture

    def test_a_periodic_error_is_that_beside_the_learnt_one(self):
        """Moments of 3 and 5 per px for the centre, 0.2 and 0.6 for the flattening; those of own views do not count."""
        n = 60
        late = (np.arange(n) >= 20)[:, None]
        seen = ring(
            n, first=np.where(late, [5e-3, 0.0], [3e-3, 0.0]), second=np.where(late, [0.0, 0.6], [0.0, 0.2])
        )
        learnt, centre = np.arange(n) < 20, np.full(n, 0.04)
        of_centre, of_view = math.hypot(0.04, CENTRE_ERROR) * 2e-3, 2e-3 * 0.4
        found = periodic_error(seen, centre, 2e-3, learnt)
        assert found == pytest.approx(math.hypot(of_centre, of_view, LEAST_PERIODIC))
        nothing = periodic_error(seen, centre, 2e-3, np.zeros(n, dtype=bool))
        assert nothing == pytest.approx(math.hypot(math.hypot(0.04, CENTRE_ERROR) * 5e-3, 2e-3 * 0.6))
        own = replace(seen, own_view=late[:, 0].astype(float))
        assert periodic_error(own, centre, 2e-3, learnt) == pytest.approx(LEAST_PERIODIC)

    def given(self, monkeypatch, seen, *, usual=1e-6, error=2e-3, coarse=None, better=True, others=()):
        """Return what a ring is joined with, and the body of it and of markers at 0, with a centre of +-0.04 px."""
        asked = []

        def join(coarse, candidates, fps, **options):
            asked.append((candidates["texture"], options))
            return body(np.full(N, 0.5), 1e-4)

        monkeypatch.setattr(module, "join", join)
        monkeypatch.setattr(module, "_averages_better", lambda *_: better)
        monkeypatch.setattr(module, "scatter_of_templates", lambda off, template: 0.3)
        marker, flat = body(np.zeros(N)), Flattening({}, 0.0, 0.0, error=error)
        coarse = np.zeros(N) if coarse is None else coarse
        found = module.by_texture(
            marker, seen, path(N, 0.04), flat, coarse, 250.0, usual, 100.0, None, others
        )
        return asked[0], found, marker

    def test_a_frame_of_a_ring_is_as_certain_as_its_zones_and_its_misfit(self, monkeypatch):
        few = np.where(np.arange(N) < 150, 3e-3, 1e-3)
        seen = replace(ring(N), sigma=few, misfit=np.where(np.arange(N) < 20, 4.0, 1.0))
        (candidate, _), found, _ = self.given(monkeypatch, seen)
        assert candidate.weak == pytest.approx(few / 1e-3)
        assert candidate.misfit_excess == pytest.approx(np.where(np.arange(N) < 20, 3.0, 0.0))
        # the zero of few turns is uncertain by the scatter of the templates
        assert found.slow == (pytest.approx(0.3), module.BATCH)
        assert found.angle.tolist() == [0.5] * N

    def test_errors_of_a_ring_are_learnt_beside_the_other_body_as_above_it(self, monkeypatch):
        other = np.linspace(0.0, 9.0, N)
        (_, options), _, _ = self.given(monkeypatch, ring(N), others=[other])
        assert options["other"] is other
        assert options["above"] is True
        (_, options), _, _ = self.given(monkeypatch, ring(N))
        assert options["other"] is None

    def test_harmonics_that_change_with_the_template_are_corrected(self, monkeypatch):
        """In a body of many turns, with the angles of the markers about the zeros of the templates."""
        turn, given = np.linspace(0.0, 80.0, N), []
        zeros = module.TemplateZeros(np.full(N, 0.2), np.zeros(N))
        monkeypatch.setattr(module, "template_zeros", lambda *_: zeros)
        monkeypatch.setattr(
            module, "change_of_harmonics", lambda *args: given.append(args) or (np.full(N, 0.03), 4e-3)
        )
        asked = []
        monkeypatch.setattr(
            module, "join", lambda coarse, seen, fps, **_: asked.append(seen) or body(turn, 1e-4)
        )
        monkeypatch.setattr(module, "_averages_better", lambda *_: True)
        seen = ring(N, angle=turn - 0.25)
        found = module.by_texture(
            body(turn), seen, path(N, 0.04), Flattening({}, 0.0, 0.0), turn, 250.0, 1e-6, 100.0
        )
        assert found.periodic == pytest.approx(4e-3)  # the zeros and the moments of this ring are certain
        ((off, _, angles),) = given
        assert off == pytest.approx(np.full(N, 0.05))
        assert angles[0] == pytest.approx(turn)
        assert asked[0]["texture"].angle == pytest.approx(module.wrapped(turn - 0.25 + 0.03 + 0.2))

    def test_a_ring_that_is_not_better_leaves_the_markers(self, monkeypatch):
        _, found, marker = self.given(monkeypatch, ring(N), better=False)
        assert found is marker

    @pytest.mark.parametrize(
        ("own", "usual", "floor"),
        [(0.0, 1e-6, 1e-3), (0.0, 0.5, 5e-3), (1.0, 1e-6, 5e-3)],
        ids=["median", "by place", "own views"],
    )
    def test_slow_errors_are_those_of_most_frames_or_of_all_own_views(self, monkeypatch, own, usual, floor):
        """1 and 7 mrad in one half each, the smaller one in a frame more; 0.5 px of 100 px."""
        slow = np.where(np.arange(N) < N // 2 - 1, 7e-3, 1e-3)
        (_, options), _, _ = self.given(monkeypatch, replace(ring(N, own=own), slow=slow), usual=usual)
        assert options["floor"] == pytest.approx(floor, rel=5e-3)

    @pytest.mark.parametrize("own", [0.0, 1.0])
    def test_an_error_of_the_view_counts_by_the_moments_of_the_zones(self, monkeypatch, own):
        """Beside its mean over two radians; about its own view, errors of centre and flattening are slow errors."""
        coarse = np.linspace(0.0, 2.0, N)
        seen = ring(N, own=own, first=(3e-3, 4e-3), second=(0.0, 0.6))
        (_, options), _, _ = self.given(monkeypatch, seen, coarse=coarse)
        left = 1.0 - 0.5 * sum(abs(np.mean(np.exp(1j * k * coarse))) ** 2 for k in (1, 2))
        of_centre = math.hypot(0.04, 0.0 if own else CENTRE_ERROR) * 5e-3
        of_view = 0.0 if own else 2e-3 * 0.6
        assert options["axis"] == pytest.approx(np.full(N, math.hypot(of_centre, of_view) * math.sqrt(left)))

    @pytest.mark.parametrize(
        ("size", "sigma", "count", "better"),
        [
            (0.0, 0.9, 40, True),
            (0.0, 1.1, 40, False),
            (0.40, 1.5, 40, False),  # 25 (0.16 - 0.13) = 0.75 of 1.25
            (0.45, 1.5, 40, True),  # 25 (0.2025 - 0.13) = 1.81
            (0.45, 1.5, 12, True),
            (0.45, 1.5, 10, False),  # too few averages
            (9.0, 1.9, 40, True),
            (9.0, 2.1, 40, False),
        ],
    )
    def test_averages_over_a_tenth_of_a_second_have_the_smaller_error(self, size, sigma, count, better):
        """Of 25 frames: markers of 1 mrad, and a ring of `sigma` from which they differ by +-`size`, in mrad."""
        slow = 1e-3 * size * np.where(np.arange(count * 25) // 25 % 2, 1.0, -1.0)
        marker, texture = body(slow, 1e-3), body(np.full(count * 25, 0.3), sigma * 1e-3)
        assert module._averages_better(texture, marker, 250.0) is better
        assert not module._averages_better(texture, body(np.full(count * 25, np.nan)), 250.0)
