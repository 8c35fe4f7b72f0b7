"""From observations to bodies: which frames, centres, orbits and bodies are used, on either side of each rule."""

import math
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.tracking import _body_angles as module
from gyrotrack.tracking._body_angles import (
    BORROWED_NU,
    DEPTH,
    HEIGHT,
    LUMA_SHIFT,
    BodyView,
    correct_view,
    followed_path,
    join_bodies,
    trusted_times,
    usual_error_by_place,
    usual_error_of_harmonic,
    view,
)
from gyrotrack.tracking._film_tracker import BATCH
from gyrotrack.tracking._fusion import BodyAngles, MarkerAngles
from gyrotrack.tracking._harmonics import harmonic_error
from gyrotrack.tracking._hub import LEAST_SIGMA, CentrePath
from gyrotrack.tracking._orbit import NO_FLATTENING, Flattening
from gyrotrack.video._time_base import FrameTimes
from tests.gyrotrack.tracking.test_body_angles import CENTRE, body, markers_of, path


class TestView:
    def test_positions_are_about_the_centre_with_y_up(self):
        seen = markers_of("rotor", (50.0,), offset=3 + 4j)
        found = seen.place("rotor0", path().centre)
        z = 3 + 4j + 50.0 * np.exp(0.05j * np.arange(400))
        assert found == pytest.approx(np.stack([z.real, z.imag], axis=1), abs=1e-6)

    def test_radii_are_less_their_median_in_trusted_frames(self):
        seen = markers_of("rotor", (50.0,))
        seen.whole["rotor0"][:7] = False
        seen.observations["rotor0"].radius[20] += 2.0
        (one,) = seen.radii(path().centre, NO_FLATTENING)
        assert np.isnan(one.excess[:7]).all()
        assert one.excess[20] == pytest.approx(2.0)
        assert one.excess[30] == pytest.approx(0.0, abs=1e-9)
        assert one.direction[30] == pytest.approx(np.angle(np.exp(1j * 0.05 * 30)))

    def test_a_flattened_orbit_is_levelled(self):
        """(1 + p) x and (1 - p) y, about an offset."""
        seen = markers_of("rotor", (50.0,))
        flat = Flattening({"rotor0": (2.0, 0.0)}, 0.1, 0.0)
        (one,) = seen.radii(path().centre, flat)
        z = 50.0 * np.exp(0.05j * np.arange(400))
        level = (z.real - 2.0) / 1.1 + 1j * z.imag / 0.9
        assert one.excess == pytest.approx(np.abs(level) - np.median(np.abs(level)), abs=1e-6)
        candidates = seen.candidates(path(), flat)
        assert candidates["rotor0"].angle == pytest.approx(np.angle(level), abs=1e-9)

    def test_coloured_markers_show_the_offset(self):
        seen = markers_of("rotor", (50.0, 60.0, 70.0), colours=("white", "red", "white"))
        assert seen.coloured == ("rotor1",)
        every = Flattening({f"rotor{k}": (float(k), 0.0) for k in range(3)}, 0.0, 0.0)
        assert seen.reference(every) == ["rotor1"]
        white = replace(every, offset={"rotor0": (0.0, 0.0), "rotor2": (0.0, 0.0)})
        assert seen.reference(white) == ["rotor0", "rotor2"]

    @pytest.mark.parametrize(
        ("own", "common", "expected"),
        [
            ({"rotor1": (1.0, 0.0)}, {"rotor1": (9.0, 9.0)}, {"rotor1": (1.0, 0.0)}),
            ({"rotor0": (1.0, 0.0)}, {"rotor1": (2.0, 0.0)}, {"rotor0": (1.0, 0.0), "rotor1": (2.0, 0.0)}),
            ({"rotor0": (1.0, 0.0)}, {}, {"rotor0": (1.0, 0.0)}),
        ],
    )
    def test_coloured_markers_that_cover_arcs_have_a_common_offset(self, monkeypatch, own, common, expected):
        seen = markers_of("rotor", (50.0, 60.0), colours=("white", "red"))
        monkeypatch.setattr(module, "fit_flattening", lambda orbits: Flattening(own, 0.01, 0.0))
        monkeypatch.setattr(module, "fit_common_offset", lambda orbits: Flattening(common, 0.02, 0.0))
        found = seen.flattening(path().centre)
        assert found.offset == expected
        assert found.p == (0.02 if "rotor1" not in own and common else 0.01)

    def test_a_marker_at_the_border_is_not_inside(self):
        seen = markers_of("rotor", (239.0,))
        assert not seen.inside["rotor0"].all()
        assert markers_of("rotor", (200.0,)).inside["rotor0"].all()

    def test_an_absent_offset_is_expected_to_be_that_of_the_others(self, monkeypatch):
        asked = []

        def of_arc(flat, arcs, shift, size, usual):
            asked.append((set(arcs), shift.tolist(), size, usual))
            return SimpleNamespace(offset={"rotor1": (7.0, 7.0)}, offset_covariance={"rotor1": np.eye(2)})

        monkeypatch.setattr(module, "flattening_of_arc", of_arc)
        seen = markers_of("rotor", (50.0, 70.0))
        flat = Flattening({"rotor0": (1.0, 2.0)}, 0.01, 0.0)
        found = seen.with_arcs(flat, path().centre)
        assert found.offset == {"rotor0": (1.0, 2.0), "rotor1": (7.0, 7.0)}
        size = math.hypot(HEIGHT * flat.tilt * 60.0, LUMA_SHIFT)
        assert asked == [({"rotor1"}, [1.0, 2.0], pytest.approx(size), usual_error_by_place(seen))]
        assert seen.with_arcs(found, path().centre) is found


class TestOrbits:
    def test_the_error_of_a_harmonic_is_estimated_with_the_usual_one(self, monkeypatch):
        """Two estimates of one variance: four degrees of freedom of the usual one, and those that are seen."""
        monkeypatch.setattr(
            module, "higher_harmonics", lambda direction, excess: np.array([0.3, -0.4, 0.5, 0.1])
        )
        seen = markers_of("rotor", (50.0, 60.0))
        flat = Flattening({"rotor0": (0.0, 0.0)}, 0.0, 0.0)
        usual = usual_error_of_harmonic(seen)
        expected = math.sqrt((BORROWED_NU * usual**2 + 0.51) / (BORROWED_NU + 4))
        assert module._error_of_harmonic(path(), seen, flat) == pytest.approx(expected)
        assert module._error_of_harmonic(path(), seen, NO_FLATTENING) == usual

    @pytest.mark.parametrize(("arc", "known"), [(3.5, True), (3.1, False)])
    def test_fourteen_places_show_the_error(self, monkeypatch, arc, known):
        """Sectors of a twelfth of a half turn."""
        monkeypatch.setattr(module, "higher_harmonics", lambda direction, excess: np.ones(4))
        seen = markers_of("rotor", (50.0,), rate=arc / 400)
        flat = Flattening({"rotor0": (0.0, 0.0)}, 0.0, 0.0)
        found = module._error_of_harmonic(path(), seen, flat)
        assert (found != usual_error_of_harmonic(seen)) is known

    @dataclass(frozen=True)
    class Given(BodyView):
        """A view whose flattening is given, and that remembers what is asked about arcs."""

        own: Flattening = NO_FLATTENING
        asked: list = None

        def flattening(self, centre):
            return self.own

        def with_arcs(self, flat, centre):
            return flat

        def flattening_of_arc(self, centre, reference, shift, size):
            self.asked.append((shift, size))
            return replace(reference, p=9.0)

    def given(self, name, own, radius, asked):
        seen = markers_of(name, (radius,))
        return self.Given(seen.markers, seen.observations, seen.inside, seen.whole, own, asked)

    def test_a_body_that_covers_an_arc_has_the_tilt_of_another_one(self, monkeypatch):
        monkeypatch.setattr(
            module, "_error_of_harmonic", lambda centre, body_view, flat: 0.07 * body_view.radius / 70
        )
        monkeypatch.setattr(
            module,
            "_common_tilt",
            lambda flat, views, error: complex(-0.01, 0.002) if error == pytest.approx(1e-3) else None,
        )
        asked = []
        views = {
            "rotor": self.given("rotor", Flattening({"rotor0": (6.0, 0.0)}, -0.02, 0.0), 70.0, asked),
            "casing": self.given("casing", NO_FLATTENING, 90.0, asked),
        }
        found = module._flattening(path(), views)
        rotor = found["rotor"]
        assert (rotor.p, rotor.q, rotor.error) == (-0.01, 0.002, pytest.approx(1e-3))
        error = usual_error_of_harmonic(views["rotor"], 1)
        shrunk = 6.0 * (1 - 2 * error**2 / 36.0)
        ((shift, size),) = asked
        assert shift == pytest.approx(np.array([[0.0, 0.0], [shrunk, 0.0]]), abs=1e-6)
        # its height above the hub's disc, by the larger of both tilts
        tilt = max(rotor.tilt, 6.0 / (DEPTH * 70.0))
        assert size == pytest.approx(math.hypot(HEIGHT * tilt * 90.0, LEAST_SIGMA))
        assert found["casing"].p == 9.0
        # a rotor below a casing: it may be at any depth
        asked.clear()
        views = {
            "casing": self.given("casing", Flattening({"casing0": (6.0, 0.0)}, -0.02, 0.0), 90.0, asked),
            "rotor": self.given("rotor", NO_FLATTENING, 70.0, asked),
        }
        monkeypatch.setattr(module, "_common_tilt", lambda *_: complex(-0.01, 0.0))
        module._flattening(path(), views)
        ((shift, size),) = asked
        assert shift.shape == (2,)
        assert size == pytest.approx(math.hypot(DEPTH * 0.2 * 70.0, LEAST_SIGMA))
        assert module._flattening(path(), {"rotor": self.given("rotor", NO_FLATTENING, 70.0, [])}) == {
            "rotor": NO_FLATTENING
        }

    @pytest.mark.parametrize(
        ("correction", "marked", "fits"), [(True, True, 2), (True, False, 1), (False, True, 0)]
    )
    def test_a_marked_centre_is_corrected_by_the_radii(self, monkeypatch, correction, marked, fits):
        asked = []
        monkeypatch.setattr(
            module, "_flattening", lambda centre, views: asked.append(centre) or {"rotor": NO_FLATTENING}
        )
        better = path(sigma=0.01)
        monkeypatch.setattr(
            module, "refine_centre", lambda centre, radii: better if len(list(radii)) == 1 else None
        )
        one = path()
        found, flat = correct_view(
            one,
            {"rotor": markers_of("rotor", (50.0,))},
            SimpleNamespace(tilt_correction=correction),
            marked=marked,
        )
        assert len(asked) == fits
        assert found is (better if correction and marked else one)
        assert flat == {"rotor": NO_FLATTENING}

    def test_the_path_about_which_the_radii_vary_least(self, monkeypatch):
        """The first one, unless another is significantly better than all before it."""
        monkeypatch.setattr(module, "_flattening", lambda *_: {})
        paths = [path(sigma=s) for s in (1.0, 2.0, 3.0)]
        squares = {1.0: 5.0, 2.0: 4.0, 3.0: 4.5}
        monkeypatch.setattr(module, "_squares", lambda one, views, flat: squares[one.sigma[0]])
        monkeypatch.setattr(module, "_is_better", lambda before, after: before > after + 0.2)
        assert followed_path(paths, {}) is paths[1]
        squares[2.0] = 4.9
        assert followed_path(paths, {}) is paths[2]
        squares[3.0] = 4.9
        assert followed_path(paths, {}) is paths[0]

    def test_squares_are_those_of_the_radii_where_the_centre_is_known(self):
        seen = {"rotor": markers_of("rotor", (50.0,))}
        seen["rotor"].observations["rotor0"].radius[20] += 2.0
        one = path()
        one.sigma[5] = np.nan
        (found,) = module._squares(one, seen, {"rotor": NO_FLATTENING})
        assert np.isnan(found[5])
        assert (found[20], found[30]) == pytest.approx((4.0, 0.0), abs=1e-9)


def times(number, **more):
    return FrameTimes(np.asarray(number), **more)


class TestFrames:
    def observed(self, number, **more):
        picked = SimpleNamespace
        bodies = {
            "rotor": picked(
                spread_out=lambda index, count: ("spread", index.tolist(), count),
                picked=lambda index: ("picked", index.tolist()),
            )
        }
        from gyrotrack.tracking._film_tracker import FilmObservations

        n = len(number)
        return FilmObservations(
            bodies,
            np.arange(2.0 * n).reshape(n, 2),
            np.zeros(n),
            times(number, **more),
            (),
            (640, 480),
            np.zeros(n, dtype=bool),
        )

    def test_missing_frames_are_gaps_of_the_grid(self):
        seen = self.observed([0, 1, 3])
        found = module._with_gaps(seen, seen.times.number)
        assert found.bodies["rotor"] == ("spread", [0, 1, 3], 4)
        assert found.disc[[0, 1, 3]].tolist() == seen.disc.tolist()
        assert np.isnan(found.disc[2]).all()
        whole = self.observed([0, 1, 2])
        assert module._with_gaps(whole, whole.times.number) is whole

    def test_angles_of_gaps_are_left_out_again(self, monkeypatch):
        def even(seen, scene, profile, fps, base):
            asked.append(base)
            n = 5
            found = BodyAngles(np.arange(5.0), np.ones(5), np.ones(5, dtype=np.int64), {})
            return module.TrackedBodies(
                CentrePath(np.arange(10.0).reshape(5, 2), np.arange(5.0), n), {"rotor": found}, {}, 1, ()
            )

        asked = []
        monkeypatch.setattr(module, "_join_even", even)
        monkeypatch.setattr(module, "_with_gaps", lambda seen, index: seen)
        found = module._join_fresh(self.observed([0, 2, 4]), None, None, 100.0)
        assert found.bodies["rotor"].angle.tolist() == [0.0, 2.0, 4.0]
        assert found.centre.sigma.tolist() == [0.0, 2.0, 4.0]
        assert asked == [None]
        module._join_fresh(
            self.observed([0, 2, 4], place=np.array([0.0, 2.2, 4.0]), sigma=0.1), None, None, 100.0
        )
        base = asked[1]
        assert base.place == pytest.approx([0.0, 1.1, 2.2, 3.1, 4.0])
        assert base.sigma == 0.1

    def test_repeated_frames_have_no_angle_and_the_centre_of_their_origin(self, monkeypatch):
        def fresh(seen, scene, profile, fps):
            assert seen.bodies["rotor"] == ("picked", [0, 2, 3])
            found = BodyAngles(np.array([1.0, 2.0, 3.0]), np.ones(3), np.ones(3, dtype=np.int64), {})
            centre = CentrePath(np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]), np.array([0.1, 0.2, 0.3]), 4)
            return module.TrackedBodies(centre, {"rotor": found}, {}, 1, ())

        monkeypatch.setattr(module, "_join_fresh", fresh)
        again = np.array([False, True, False, False])
        found = join_bodies(self.observed([0, 0, 1, 2], again=again), None, None, 100.0)
        assert found.bodies["rotor"].angle[[0, 2, 3]].tolist() == [1.0, 2.0, 3.0]
        assert np.isnan(found.bodies["rotor"].angle[1])
        assert found.centre.sigma.tolist() == [0.1, 0.1, 0.2, 0.3]
        assert found.centre.reach == 4

    @pytest.mark.parametrize(("real", "smoothed"), [(True, False), (False, True)])
    def test_stamps_are_smoothed_unless_a_body_follows_their_jitter(self, monkeypatch, real, smoothed):
        monkeypatch.setattr(module, "turning_most", lambda seen: "rotor")
        monkeypatch.setattr(
            module, "seen_angle", lambda seen, scene, name: "angle" if name == "rotor" else None
        )
        monkeypatch.setattr(
            module, "jitter_is_real", lambda place, smooth, angle: real if angle == "angle" else None
        )
        place, smooth = np.array([0.0, 1.1, 2.0]), np.array([0.0, 1.0, 2.0])
        seen = self.observed([0, 1, 2], place=place, smooth=smooth)
        found = trusted_times(seen, None)
        assert (found.place is smooth) is smoothed
        assert trusted_times(self.observed([0, 1, 2]), None).place is None
        assert trusted_times(replace(seen, bodies={}), None) is seen.times


class TestBodies:
    def followed(self, monkeypatch, *, rotor=None, casing=None, disc=True, better=None, rings=False):
        """The joins of both bodies; `better` is that of the casing with the rotor known."""
        joined = []
        results = {"rotor": rotor, "casing": casing}

        def join(coarse, candidates, fps, other=None, floor=0.0, axis=0.0, orbit=0.0, **options):
            name = "rotor" if "rotor0" in candidates else "casing"
            joined.append((name, other is not None, options["above"], floor))
            return better if options["above"] and better is not None else results[name]

        monkeypatch.setattr(module, "join", join)
        perspective = []
        monkeypatch.setattr(module, "separate_perspective", lambda *_: perspective.append(1) or NO_FLATTENING)
        views = {"casing": markers_of("casing", (90.0,)), "rotor": markers_of("rotor", (70.0,))}
        views = {name: views[name] for name in views if results[name] is not None}
        coarse = np.linspace(0.0, 9.0, 400)
        seen = SimpleNamespace(
            bodies={name: SimpleNamespace(coarse=coarse, texture=name if rings else None) for name in views},
            disc=np.zeros((400, 2)) if disc else None,
        )
        bodies, warnings = module._followed(
            seen, views, path(), dict.fromkeys(views, NO_FLATTENING), 100.0, None
        )
        return bodies, warnings, joined, len(perspective)

    def test_the_harmonics_of_all_bodies_are_measured(self, monkeypatch):
        turning, still = body(np.linspace(0, 40, 400)), body(np.linspace(0, 20, 400))
        monkeypatch.setattr(module, "harmonic_error", lambda angle: float(angle[-1]))
        bodies, *_ = self.followed(monkeypatch, rotor=turning, casing=still)
        assert {name: b.harmonic for name, b in bodies.items()} == {"rotor": 40.0, "casing": 20.0}

    def test_a_ring_beside_a_blurred_body_knows_its_coarse_angle(self, monkeypatch):
        """The rotor is too fast for its markers in the first 100 frames."""
        rotor = np.linspace(0, 40, 400)
        rotor[:100] = np.nan
        told = []

        def by_texture(body, texture, *rest):
            told.append((texture, rest[-1]))
            return body

        monkeypatch.setattr(
            module, "_best_ring", lambda seen, flattening: "ring" if seen.texture == "casing" else None
        )
        monkeypatch.setattr(module, "by_texture", by_texture)
        casing = body(np.linspace(0, 20, 400))
        self.followed(monkeypatch, rotor=body(rotor), casing=casing, rings=True)
        ((texture, (other,)),) = told
        assert texture == "ring"
        np.testing.assert_allclose(other[:100], np.linspace(0.0, 9.0, 400)[:100])
        np.testing.assert_allclose(other[100:], rotor[100:])

    def test_the_casing_is_joined_again_with_the_rotor_beneath(self, monkeypatch):
        turning, still = body(np.linspace(0, 40, 400)), body(np.linspace(0, 20, 400))
        better = body(np.linspace(0, 20, 400), sigma=5e-4)
        bodies, warnings, joined, perspective = self.followed(
            monkeypatch, rotor=turning, casing=still, better=better
        )
        assert [j[:3] for j in joined] == [
            ("casing", False, False),
            ("rotor", True, False),
            ("casing", True, True),
        ]
        assert (bodies["casing"], bodies["rotor"], warnings, perspective) == (better, turning, [], 1)
        bodies, _, _, perspective = self.followed(
            monkeypatch, rotor=turning, casing=still, better=body(np.full(400, np.nan)), disc=False
        )
        assert bodies["casing"].angle is still.angle  # the second one is not credible
        assert perspective == 0

    def test_position_dependent_errors_are_those_of_both_bodies(self, monkeypatch):
        """The rms of the typical ones and of those that the other body has learnt, over the radius."""
        learnt = body(np.linspace(0, 20, 400), place_error=2e-3)
        _, _, joined, _ = self.followed(monkeypatch, rotor=body(np.linspace(0, 40, 400)), casing=learnt)
        own, other = usual_error_by_place(markers_of("rotor", (70.0,))), markers_of("casing", (90.0,))
        error = module.error_by_place(other, NO_FLATTENING, learnt)
        assert joined[1][3] == pytest.approx(math.sqrt((own**2 + error**2) / 2) / 70.0)
        assert joined[0][3] == pytest.approx(usual_error_by_place(other) / 90.0)

    def test_a_rotor_at_rest_beside_a_casing_that_turns_is_background(self, monkeypatch):
        bodies, (text,), _, _ = self.followed(
            monkeypatch, rotor=body(np.zeros(400)), casing=body(np.linspace(0, 9, 400))
        )
        assert set(bodies) == {"casing"}
        assert "part of the background" in text

    def test_a_body_without_angles_is_omitted(self, monkeypatch):
        bodies, (text,), joined, _ = self.followed(
            monkeypatch, rotor=body(np.full(400, np.nan)), casing=body(np.linspace(0, 9, 400))
        )
        assert set(bodies) == {"casing"}
        assert "markers of the rotor cannot be tracked" in text
        assert len(joined) == 2

    @pytest.mark.parametrize(
        ("wander", "reach", "moves"),
        [(None, 3.6, True), (None, 3.4, False), (True, 0.1, True), (False, 9.0, False)],
    )
    def test_a_centre_moves_if_its_range_is_a_twentieth_of_the_radius(
        self, monkeypatch, wander, reach, moves
    ):
        """Of an orbit of 70 px, without a disc."""

        def wandering(place, good, first, *, still=False):
            centre = np.tile(CENTRE, (400, 1))
            centre[0, 0] += 0.0 if still else reach
            return CentrePath(centre, np.full(400, 1.0 if still else 2.0), 0)

        monkeypatch.setattr(module, "wandering_centre", wandering)
        seen = markers_of("rotor", (70.0,))
        observed = SimpleNamespace(disc=None, bodies={"rotor": SimpleNamespace(markers=seen.observations)})
        found = module._centre(observed, {}, SimpleNamespace(centre=CENTRE), SimpleNamespace(wander=wander))
        assert found.sigma[0] == (2.0 if moves else 1.0)

    @pytest.mark.parametrize(
        ("given", "unfolded", "doubted"), [(None, True, True), (1, True, False), (None, False, True)]
    )
    def test_what_is_assumed_is_said(self, monkeypatch, given, unfolded, doubted):
        found = body(np.linspace(0, 9, 400))
        monkeypatch.setattr(module, "view", lambda *_: None)
        monkeypatch.setattr(module, "_centre", lambda *_: path())
        monkeypatch.setattr(module, "about_rotor", lambda one, views: one)
        monkeypatch.setattr(
            module, "correct_view", lambda axis, views, profile, *, marked: (axis, {"rotor": NO_FLATTENING})
        )
        monkeypatch.setattr(module, "_followed", lambda *_: ({"rotor": found}, ["first"]))
        monkeypatch.setattr(module, "fast_motion", lambda path, disc: "shakes")
        monkeypatch.setattr(module, "_unalias", lambda bodies, sense: ["alias"])
        monkeypatch.setattr(module, "_undecided", lambda bodies: ["undecided"])
        monkeypatch.setattr(
            module,
            "find_rotation_sense",
            lambda turns, sense: -1 if turns["rotor"] == pytest.approx(9.0) else 0,
        )
        monkeypatch.setattr(
            module, "unfold", lambda angle, sense: (-angle, unfolded) if sense == -1 else None
        )
        monkeypatch.setattr(module, "_zeroed", lambda one, profile, sense: one)
        observed = SimpleNamespace(
            disc=np.zeros((400, 2)), bodies={"rotor": SimpleNamespace(markers=None)}, size=None
        )
        scene = SimpleNamespace(of=lambda name: ())
        result = module._join_even(observed, scene, SimpleNamespace(sense=given), 100.0)
        assert result.sense == -1
        assert result.warnings[:2] == ("first", "shakes")
        assert len(result.warnings) == 2 + unfolded
        assert (result.bodies["rotor"].angle[-1] == -9.0) == unfolded
        assert result.doubts == (("alias", "undecided") if doubted else ("alias",))


class TestHarmonics:
    @pytest.mark.parametrize(("batches", "stated"), [(3, True), (2, False)])
    def test_an_error_of_eight_periods_per_turn_needs_three_batches(self, batches, stated):
        """0.2 rad a frame, with an amplitude of 2 mrad: each of cosine and sine has half of its square."""
        turn = 0.2 * np.arange(batches * BATCH)
        angle = turn + 2e-3 * np.cos(8 * turn) + 1e-4 * np.random.default_rng(0).standard_normal(len(turn))
        found = harmonic_error(angle)
        assert (found > 0.0) is stated
        assert not stated or found == pytest.approx(2e-3 / math.sqrt(2), rel=0.05)

    @pytest.mark.parametrize(("lost", "stated"), [(2, True), (BATCH // 2, False)])
    def test_batches_with_large_gaps_do_not_count(self, lost, stated):
        turn = 0.2 * np.arange(4 * BATCH)
        angle = turn + 2e-3 * np.cos(8 * turn) + 1e-4 * np.random.default_rng(0).standard_normal(len(turn))
        for batch in range(2):
            angle[batch * BATCH + 10 : batch * BATCH + 10 + lost] = np.nan
        assert (harmonic_error(angle) > 0.0) is stated

    def test_orders_one_and_two_are_those_of_the_camera(self):
        turn = 0.2 * np.arange(6 * BATCH)
        noise = 1e-4 * np.random.default_rng(0).standard_normal(len(turn))
        for order, found in ((1, False), (2, False), (3, True), (12, True), (13, False)):
            assert (harmonic_error(turn + 2e-3 * np.cos(order * turn) + noise) > 3e-4) is found


def test_mounts_and_angles_share_a_zero():
    """A profile with a mount angle of 0.5 rad for a marker that is at 2.0 as seen."""
    marker = MarkerAngles(np.zeros(2), np.ones(2), 2.0)
    found = BodyAngles(np.array([1.0, 2.0]), np.ones(2), np.ones(2, dtype=np.int64), {"red": marker})
    profile = SimpleNamespace(
        marker=[SimpleNamespace(name="red", mount_angle=0.5), SimpleNamespace(name="x", mount_angle=1.0)]
    )
    for sense in (1, -1):
        zeroed = module._zeroed(found, profile, sense)
        shift = found.angle[0] - zeroed.angle[0]
        assert zeroed.markers["red"].mount - 2.0 == pytest.approx(shift)
        assert np.exp(1j * zeroed.markers["red"].mount) == pytest.approx(np.exp(1j * sense * 0.5))
    assert module._zeroed(found, SimpleNamespace(marker=[]), 1) is found


def test_a_view_knows_which_markers_are_whole():
    seen = markers_of("rotor", (50.0,))
    seen.observations["rotor0"].open[3] = False
    again = view(seen.markers, seen.observations, (640, 480))
    assert not again.whole["rotor0"][3]
    assert again.inside["rotor0"][3]


def test_typical_errors_have_their_stated_sizes():
    """0.09 px of an encoder and 0.8 mrad of the light; a millimetre of height, half a pixel between luma and chroma."""
    seen = markers_of("rotor", (60.0, 100.0))
    assert usual_error_by_place(seen, 4) == pytest.approx(math.hypot(0.045, 0.8e-3 * 80.0))
    assert usual_error_of_harmonic(seen, 4) == pytest.approx(usual_error_by_place(seen, 4) / math.sqrt(6.0))
    assert (HEIGHT, LUMA_SHIFT, DEPTH, module.PERSPECTIVE) == (0.03, 0.5, 0.5, 0.05)


@pytest.mark.parametrize(("turns", "varies"), [(9.9, False), (10.1, True), (-10.1, True)])
def test_the_zero_of_a_texture_varies_after_ten_turns(monkeypatch, turns, varies):
    asked = []

    def stopped(kind):
        def stop(off, template, *angles):
            asked.append((kind, [a.tolist() for a in angles[0]] if angles else []))
            raise StopIteration

        return stop

    monkeypatch.setattr(module, "template_zeros", stopped("each"))
    monkeypatch.setattr(module, "scatter_of_templates", stopped("one"))
    found = body(np.linspace(0.0, turns * 2 * np.pi, 400))
    other = np.linspace(0.0, 60.0, 400)
    texture = SimpleNamespace(levelled=lambda centre, p, q: found.angle, template=np.zeros(400, dtype=int))
    with pytest.raises(StopIteration):
        module.by_texture(
            found, texture, path(), NO_FLATTENING, found.angle, 100.0, 1e-1, 100.0, others=[other]
        )
    # a marker errs with its own angle and with that to the other body
    angles = [found.angle.tolist(), (other - found.angle).tolist()]
    assert asked == [("each", angles) if varies else ("one", [])]
