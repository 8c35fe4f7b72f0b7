"""Occluded and implausible markers, slips and illumination: which frames and samples are used, on either side."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.tracking import _marker_tracker as tracker
from gyrotrack.tracking import _marker_window as windows
from gyrotrack.tracking._association import Motion, Prediction, follow
from gyrotrack.tracking._marker_tracker import (
    MarkerObservations,
    Match,
    candidate,
    excess_misfit,
    flat_top,
    mean_profile,
    plausible,
)
from gyrotrack.tracking._marker_window import AngleMap, Occlusion, even_light, open_columns
from gyrotrack.tracking._polar import cyclic_sum

TURN = 2 * math.pi


def observed(n=101, **columns):
    """A marker of 50 px at the angle 0 in each frame; heights of 1, misfits between 0.015 and 0.025."""
    usual = {
        "angle": np.zeros(n), "radius": np.full(n, 50.0), "corner_angle": np.zeros((n, 2)),
        "corner_radius": np.zeros((n, 2)), "gain": np.ones(n), "misfit": 0.02 + 0.005 * (np.arange(n) % 3 - 1),
        "weakness": np.full(n, 2.0), "open": np.ones(n, dtype=bool), "centre": np.tile([320.0, 240.0], (n, 1)),
    }  # fmt: skip
    return MarkerObservations(**usual | columns)


def at_first(value, usual=1.0, n=101):
    return np.where(np.arange(n) == 0, value, usual)


class TestPlausible:
    @pytest.mark.parametrize(
        ("gain", "good"), [(0.51, True), (0.49, False), (1.99, True), (2.01, False), (np.nan, False)]
    )
    def test_a_height_is_between_half_and_twice_the_usual_one(self, gain, good):
        assert plausible(observed(gain=3.0 * at_first(gain)))[0] == good
        assert plausible(observed(gain=3.0 * at_first(gain)))[1:].all()

    @pytest.mark.parametrize(("weakness", "good"), [(7.9, True), (8.1, False)])
    def test_a_hidden_marker_has_at_most_four_times_the_usual_uncertainty(self, weakness, good):
        assert plausible(observed(weakness=at_first(weakness, 2.0)))[0] == good

    @pytest.mark.parametrize(("misfit", "good"), [(0.119, True), (0.121, False)])
    def test_light_causes_a_misfit_of_twelve_percent(self, misfit, good):
        assert plausible(observed(misfit=at_first(misfit, observed().misfit)))[0] == good

    @pytest.mark.parametrize(("sigmas", "good"), [(5.9, True), (6.1, False)])
    def test_a_misfit_is_within_six_standard_deviations_of_the_usual_one(self, sigmas, good):
        """Of 0.2 +- 1.4826 0.05."""
        spread = 0.05 * (np.arange(101) % 3 - 1)
        misfit = at_first(0.2 + sigmas * 1.4826 * 0.05, 0.2 + spread)
        assert plausible(observed(misfit=misfit))[0] == good

    def test_the_usual_values_are_those_of_unoccluded_frames(self):
        open_ = np.arange(101) < 40
        gain = np.where(open_, 1.0, 0.4)
        assert np.flatnonzero(plausible(observed(gain=gain, open=open_))).tolist() == list(range(40))
        assert plausible(observed(gain=np.where(open_, 1.0, 0.6), open=open_)).all()
        assert not plausible(observed(open=np.zeros(101, dtype=bool))).any()

    def test_the_excess_of_a_squared_misfit_is_limited(self):
        found = excess_misfit(np.array([0.01, 0.02, 0.04, 0.2, np.nan]), 0.02)
        assert found == pytest.approx([0.0, 0.0, 3.0, 24.0, 0.0])

    @pytest.mark.parametrize(("count", "known"), [(29, False), (30, True)])
    def test_thirty_frames_show_how_a_misfit_matters(self, count, known):
        """Residuals of a variance of 1 + 0.5 x; others have no angle."""
        excess = np.where(np.arange(60) % 2, 20.0, 0.0)
        off = np.sqrt(1.0 + 0.5 * excess) * np.where(np.arange(60) // 2 % 2, 1.0, -1.0)
        off[count:] = np.nan
        found = tracker.variance_inflation(off, excess)
        assert (found > 0.1) is known
        assert found < 1.0

    def test_faults_beyond_five_standard_deviations_do_not_raise_the_share(self):
        """A share of 0.1; in one of a hundred frames of a large misfit the residual is twelve."""
        excess, found = np.where(np.arange(2000) % 2, 20.0, 0.0), []
        for seed in range(4):
            off = np.random.default_rng(seed).standard_normal(2000) * np.sqrt(1.0 + 0.1 * excess)
            off[1::100] = 12.0
            found.append(tracker.variance_inflation(off, excess))
        assert np.mean(found) == pytest.approx(0.1, abs=0.05)

    def test_a_candidate_is_relative_to_the_usual_frames(self):
        open_ = np.arange(101) > 50
        seen = observed(weakness=np.where(open_, 2.0, 6.0), misfit=np.where(open_, 0.02, 0.04), open=open_)
        found = candidate(seen, np.zeros(101), np.ones(101, dtype=bool), 0.7)
        assert (found.weak[0], found.weak[60], found.mount) == (3.0, 1.0, 0.7)
        assert found.misfit_excess[0] == pytest.approx(3.0)


class TestPlace:
    @pytest.mark.parametrize(
        ("angle", "radius", "outside"),
        [
            (0.0, 319.0, False), (0.0, 319.6, True), (math.pi, 319.9, False), (math.pi, 320.6, True),
            (math.pi / 2, 239.9, False), (math.pi / 2, 240.6, True), (-math.pi / 2, 239.0, False),
            (-math.pi / 2, 239.6, True),
        ],
    )  # fmt: skip
    def test_a_marker_beyond_the_border_is_outside(self, angle, radius, outside):
        """A picture of 640 by 480 px about (320, 240), y down."""
        seen = observed(1, angle=np.array([angle]))
        assert seen.outside(10.0, radius, 1e-3, (640, 480)).tolist() == [outside]
        assert seen.outside(radius, 10.0, 1e-3, (640, 480)).tolist() == [outside]

    def test_both_sides_of_a_marker_are_inside(self):
        """0.1 rad beside the direction of the corner of the picture."""
        seen = observed(2, angle=np.array([0.1, -0.1]) + math.pi / 2)
        assert seen.outside(10.0, 240.5, 0.1, (640, 480)).tolist() == [True, True]
        assert seen.outside(10.0, 240.5, 0.01, (640, 480)).tolist() == [False, False]

    @pytest.mark.parametrize("white", [True, False])
    def test_of_a_white_marker_the_brightness_is_averaged_and_not_the_height(self, white):
        """A brightness of 1 at every angle, above a ground that varies."""
        ground = np.linspace(0.1, 0.5, 40)
        strip = SimpleNamespace(white=white, ground=ground, ring=SimpleNamespace(columns=40))
        light = tracker.MarkerTracker(SimpleNamespace(), strip).light
        light.learn(0, np.arange(40), np.ones(40), 1.0 - ground)
        ((*height,),) = light.heights(3)
        assert (np.ptp(height / (1.0 - ground)) < 1e-9) == white

    def test_a_position_is_at_the_median_radius_where_it_is_not_known(self):
        seen = observed(4, angle=np.full(4, math.pi / 2), radius=np.array([50.0, 52.0, 54.0, 99.0]))
        found = seen.position(np.array([True, True, True, False]))
        assert found[:, 0] == pytest.approx(np.full(4, 320.0))
        assert found[:, 1] == pytest.approx([190.0, 188.0, 186.0, 188.0])


def matches(n=20, **columns):
    usual = {
        "shift": np.zeros(n), "gain": np.ones(n), "offset": np.zeros(n), "misfit": np.full(n, 0.05),
        "weakness": np.ones(n),
    }  # fmt: skip
    return Match(**usual | columns)


class TestTemplate:
    def good(self, whole=None, known=None, **columns):
        n = 20
        whole = np.ones(n, dtype=bool) if whole is None else whole
        known = np.ones(n, dtype=bool) if known is None else known
        return tracker._good(matches(n, **columns), whole, known)

    @pytest.mark.parametrize(
        ("column", "value", "usual", "good"),
        [
            ("gain", 0.26, 0.3, True), ("gain", 0.24, 0.3, False), ("gain", 3.9, 3.0, True), ("gain", 4.1, 3.0, False),
            ("weakness", 3.9, 1.0, True), ("weakness", 4.1, 1.0, False), ("gain", 0.61, 1.0, True),
            ("gain", 0.59, 1.0, False), ("misfit", 0.0605, 0.05, True), ("misfit", 0.0615, 0.05, False),
        ],
    )  # fmt: skip
    def test_profiles_of_usual_height_and_misfit_enter(self, column, value, usual, good):
        """1.2 times the median misfit and 0.001."""
        found = self.good(**{column: at_first(value, usual, 20)})
        assert found[0] == good
        assert found[1:].all()

    @pytest.mark.parametrize(("count", "others"), [(6, False), (5, True)])
    def test_six_unoccluded_profiles_are_enough(self, count, others):
        whole = np.arange(20) < count
        found = self.good(whole=whole, known=np.arange(20) < 15)
        assert found[:count].all()
        assert found[count:15].any() == found[count:15].all() == others
        assert not found[15:].any()
        assert not self.good(known=np.zeros(20, dtype=bool)).any()

    @pytest.mark.parametrize(("most", "chosen"), [(10, 20), (20, 20), (5, 5), (3, 4)])
    def test_frames_in_use_are_thinned_evenly(self, most, chosen):
        """20 frames in use; every fourth and every sixth one of them for five and three."""
        use = np.repeat([True, False], 20)
        found = tracker._some(use, most)
        assert not (found & ~use).any()
        steps = np.diff(np.flatnonzero(found))
        assert len(np.unique(steps)) == 1
        assert found.sum() == {10: 10}.get(most, chosen)

    @pytest.mark.parametrize(("size", "kept"), [(2.4, True), (2.6, False)])
    def test_a_mean_is_without_samples_beyond_two_and_a_half_standard_deviations(self, size, kept):
        """Of 1000 samples of +-1, the last one is far."""
        values = np.where(np.arange(1000) % 2, 1.0, -1.0)[:, None].copy()
        values[-1] = size
        found = tracker._clipped_mean(values, np.ones((1000, 1), dtype=bool))[0]
        expected = values.mean() if kept else values[:-1].mean()
        assert found == pytest.approx(expected)

    def test_occluded_samples_do_not_enter_a_mean(self):
        values = np.array([[1.0, 9.0], [3.0, 9.0], [9.0, 9.0]])
        seen = np.array([[True, False], [True, False], [False, False]])
        found = tracker._clipped_mean(values, seen)
        assert found[0] == 2.0
        assert np.isnan(found[1])

    def test_a_mean_profile_is_of_height_one_and_symmetric(self):
        x = np.arange(21.0)
        shape = np.exp(-(((x - 10.0) / 4.0) ** 2)) + 0.02 * (x - 10.0)
        found = matches(4, gain=np.full(4, 2.0), offset=np.full(4, 0.3))
        profile, every = np.tile(2.0 * shape + 0.3, (4, 1)), np.ones((4, 21), dtype=bool)
        use = np.ones(4, dtype=bool)
        mean = mean_profile(profile, found, use, every, symmetric=True)
        pure = np.exp(-(((x - 10.0) / 4.0) ** 2))
        assert mean == pytest.approx((pure - pure[0]) / (1.0 - pure[0]), abs=1e-9)
        one_sided = mean_profile(profile, found, use, every, symmetric=False)
        assert one_sided == pytest.approx((shape - shape.min()) / np.ptp(shape), abs=1e-9)
        assert mean_profile(profile, found, np.arange(4) < 2, every, symmetric=True) is None

    def test_a_mean_profile_is_that_of_the_open_samples(self):
        """A frame of its own background and displacement, the left side of which is hidden by something brighter."""
        x = np.arange(41.0)

        def shape(shift):
            return np.exp(-(((x - 20.0 - shift) / 6.0) ** 2))

        profile = np.stack([shape(0.5) + 0.4, *[shape(0.0)] * 3])
        seen = np.ones((4, 41), dtype=bool)
        seen[0, :12] = False
        profile[0, :12] += 0.5
        found = matches(4, shift=np.array([0.5, 0.0, 0.0, 0.0]), offset=np.array([0.4, 0.0, 0.0, 0.0]))
        mean = mean_profile(profile, found, np.ones(4, dtype=bool), seen, symmetric=False)
        assert np.abs(mean - shape(0.0)).max() < 0.02

    def test_a_flat_top_falls_over_three_samples(self):
        found = flat_top(5.0, 21)
        assert found[[10, 13, 14, 15, 16, 17, 18]] == pytest.approx(
            [1.0, 1.0, 2.5 / 3, 0.5, 0.5 / 3, 0.0, 0.0]
        )
        assert found == pytest.approx(found[::-1])

    @pytest.mark.parametrize(
        ("middle", "half", "radius", "likely"),
        [
            (0.0, 0.2, 60.0, True), (0.059, 0.2, 60.0, True), (0.061, 0.2, 60.0, False), (-0.061, 0.2, 60.0, False),
            (0.0, 0.259, 60.0, True), (0.0, 0.261, 60.0, False), (0.0, 0.139, 60.0, False), (0.0, 0.141, 60.0, True),
            (0.0, 0.2, 69.9, True), (0.0, 0.2, 70.1, False), (0.0, 0.2, 49.9, False),
        ],
    )  # fmt: skip
    def test_corners_are_at_the_place_and_width_of_the_marker(self, middle, half, radius, likely):
        """A quarter of 0.2 rad and 0.01; three tenths of it; 8 px, 0.35 of the length, and 2 px from the near edge."""
        n = 9
        angle = 0.05 + np.tile([-0.2, 0.2], (n, 1))
        radii = np.full((n, 2), 60.0)
        angle[0], radii[0] = [0.05 + middle - half, 0.05 + middle + half], radius
        given = SimpleNamespace(marker=SimpleNamespace(inner=60.0, outer=60.0 + 8.0 / 0.35))
        found = tracker.MarkerTracker._likely(given, radii, angle, np.full(n, 0.05))[:, 0]
        assert found[0] == likely
        assert found[1:].all()


class TestMeasured:
    """One marker of a half width of 0.1 rad in windows of 61 columns of 0.01 rad."""

    X = np.arange(-30, 31)

    def profile(self, shift=0.0):
        return np.interp(self.X - shift, self.X, flat_top(8.0, 61))

    def test_a_curve_is_displaced_towards_larger_columns(self):
        curve = np.array([0.0, 0.0, 1.0, 0.0, 0.0])
        found = tracker.displaced(curve, np.array([1.0, -0.5]))
        assert found == pytest.approx(np.array([[0.0, 0.0, 0.0, 1.0, 0.0], [0.0, 0.5, 0.5, 0.0, 0.0]]))

    def test_a_misfit_is_relative_to_the_height(self):
        noise = 0.02 * np.random.default_rng(0).standard_normal((200, 61))
        every = np.ones((200, 61), dtype=bool)
        for gain in (1.0, 2.0):
            found = tracker.match(gain * self.profile() + noise, self.profile(), np.zeros(200), every)
            assert np.sqrt(np.mean(found.misfit**2)) == pytest.approx(
                0.02 / gain * math.sqrt(58 / 61), rel=0.03
            )
            assert np.median(found.weakness) == pytest.approx(1.0 / gain, rel=0.03)

    @pytest.mark.parametrize(("foot", "reach"), [(None, 13), (7, 11), (15, 16)])
    def test_the_extent_of_a_marker_is_that_of_its_template(self, foot, reach):
        """1.15 half widths and two columns without one; an eighth of its height, at least the half width, and one."""
        across = None if foot is None else np.where(np.abs(self.X) <= foot, 0.13, 0.11)
        strip = SimpleNamespace(ring=SimpleNamespace(step=0.01), half=30)
        given = SimpleNamespace(strip=strip, marker=SimpleNamespace(half_width=0.1), _across=across)
        found = tracker.MarkerTracker._matters(given, SimpleNamespace(fraction=np.array([0.0, 3.0])))
        assert self.X[found[0]].tolist() == list(range(-reach, reach + 1))
        assert self.X[found[1]].tolist() == list(range(3 - reach, 4 + reach))

    @pytest.mark.parametrize(
        ("body", "place", "corrected"), [("casing", 16, True), ("rotor", 16, False), ("casing", 2, False)]
    )
    def test_what_is_beside_a_marker_of_the_casing_does_not_displace_it(self, body, place, corrected):
        """A bright object over ten columns from `place` on; the marker reaches to column 12."""
        profile = np.tile(self.profile(0.7), (2, 1))
        profile[1, 30 + place : 40 + place] += 0.8
        every = np.ones((2, 61), dtype=bool)
        found = tracker.match(profile, self.profile(), np.zeros(2), every)
        assert (found.misfit > 0.12).tolist() == [False, True]
        before = found.misfit[1]
        given = SimpleNamespace(
            marker=SimpleNamespace(body=body),
            template=lambda count: self.profile(),
            _matters=lambda window: np.tile(np.abs(self.X) <= 12, (2, 1)),
        )
        window = SimpleNamespace(known=np.ones(2, dtype=bool), profile=profile)
        again = tracker.MarkerTracker._without_neighbours(given, window, found, every)
        assert again.shift[0] == pytest.approx(0.7, abs=0.02)
        if corrected:
            assert again.shift[1] == pytest.approx(0.7, abs=0.02)
            assert again.misfit[1] < 0.1 * before
        else:
            assert again.misfit[1] > 0.5 * before

    @pytest.mark.parametrize(("height", "excluded"), [(0.2, False), (0.36, True)])
    def test_a_disturbance_beside_a_marker_is_twice_the_largest_misfit(self, height, excluded):
        """An object over six columns; a quarter of the height of the marker."""
        profile = self.profile()[None].copy()
        profile[0, 48:54] += height
        every = np.ones((1, 61), dtype=bool)
        found = tracker.match(profile, self.profile(), np.zeros(1), every)
        before = found.misfit[0]
        found.misfit[0] = 0.2
        given = SimpleNamespace(
            marker=SimpleNamespace(body="casing"),
            template=lambda count: self.profile(),
            _matters=lambda window: (np.abs(self.X) <= 12)[None],
        )
        window = SimpleNamespace(known=np.ones(1, dtype=bool), profile=profile)
        again = tracker.MarkerTracker._without_neighbours(given, window, found, every)
        assert again.misfit[0] == pytest.approx(0.0 if excluded else before, abs=1e-3)

    def test_light_is_learnt_where_a_marker_covers_two_fifths_of_a_sample(self):
        learnt = []
        given = SimpleNamespace(
            strip=SimpleNamespace(ring=SimpleNamespace(columns=628)),
            light=SimpleNamespace(learn=lambda *passages: learnt.append(passages)),
        )
        window = SimpleNamespace(column=lambda count: count, raw=np.array([[0.5, 0.5, 0.5, 0.5]]))
        use = np.array([[True, True, True, False]])
        expected = np.array([[0.39, 0.41, 1.0, 1.0]])
        tracker.MarkerTracker._learn_light(given, window, expected, np.array([0.2]), use)
        ((layer, column, height, value),) = learnt
        assert (layer, column, height.tolist()) == (0, 628, [[0.0, 0.41, 1.0, 0.0]])
        assert value == pytest.approx(np.full((1, 4), 0.3))

    def test_the_radial_profile_is_the_mean_over_the_inner_half_of_the_width(self, monkeypatch):
        asked = []
        monkeypatch.setattr(tracker, "match", lambda *given: given[1])
        given = SimpleNamespace(
            strip=SimpleNamespace(ring=SimpleNamespace(step=0.01), half=30),
            marker=SimpleNamespace(half_width=0.1), _along="known",
        )  # fmt: skip
        window = SimpleNamespace(
            scores=np.zeros((2, 5, 61)), along=lambda weight: asked.append(weight) or np.zeros((2, 5))
        )
        found = matches(2, shift=np.array([0.0, 3.0]))
        assert tracker.MarkerTracker._matched_along(given, window, found, np.ones(2, dtype=bool)) == "known"
        (weight,) = asked
        for row, middle in zip(weight, (0, 3), strict=True):
            assert row == pytest.approx(np.clip(5.5 - np.abs(self.X - middle), 0.0, 1.0) / 10)

    def test_the_first_radial_template_extends_over_the_marker(self, monkeypatch):
        """From 103 to 109 px in a strip from 100 to 120 px, with edges of three samples."""
        tried = []
        monkeypatch.setattr(tracker, "match", lambda *given: tried.append(given[1]) or matches(2))
        monkeypatch.setattr(tracker, "mean_profile", lambda *_, **__: None)
        radii = np.linspace(100.0, 120.0, 41)
        given = SimpleNamespace(
            strip=SimpleNamespace(ring=SimpleNamespace(step=0.01, radii=radii), half=30), _along=None,
            marker=SimpleNamespace(half_width=0.1, inner=103.0, outer=109.0, radius=106.0),
        )  # fmt: skip
        window = SimpleNamespace(scores=np.zeros((2, 5, 61)), along=lambda weight: np.zeros((2, 41)))
        tracker.MarkerTracker._matched_along(given, window, matches(2), np.ones(2, dtype=bool))
        (template,) = tried
        edge = np.clip((7.5 - 2.0 * np.abs(radii - 106.0)) / 3.0, 0.0, 1.0)
        assert template == pytest.approx(edge)

    @pytest.mark.parametrize(("before", "rounds", "after"), [(0.2, 1, 0.3), (None, 3, 0.4)])
    def test_a_known_template_moves_half_way_to_that_of_a_batch(self, monkeypatch, before, rounds, after):
        fitted, reaches = [], set()
        monkeypatch.setattr(tracker, "even_light", lambda _, reach: reaches.add(reach) or np.ones(4))
        monkeypatch.setattr(
            tracker, "match", lambda profile, template, start, seen: fitted.append(template) or matches(9)
        )
        monkeypatch.setattr(tracker, "mean_profile", lambda *_, **__: np.full(5, 0.4))
        given = SimpleNamespace(
            _across=None if before is None else np.full(5, before), light=None, marker=SimpleNamespace(half_width=0.1),
            strip=SimpleNamespace(ring=SimpleNamespace(step=0.01, columns=628)), _learn_light=lambda *_: None,
        )  # fmt: skip
        given.template = lambda count: np.zeros(count) if given._across is None else given._across
        window = SimpleNamespace(
            start=np.zeros(9, dtype=int), known=np.ones(9, dtype=bool), profile=np.zeros((9, 5)),
            fraction=np.zeros(9), apply_light=lambda light: None,
        )  # fmt: skip
        every = np.ones(9, dtype=bool)
        tracker.MarkerTracker._matched_across(given, window, np.ones((9, 5), dtype=bool), every)
        assert reaches == {10}
        assert given._across == pytest.approx(np.full(5, after))
        assert len(fitted) == 1 + rounds
        assert fitted[-1] == pytest.approx(np.full(5, after))

    def measured(self, monkeypatch, open_, clear=None):
        """Measure three frames, the last one without the body; the marker extends over the columns 1 and 2 of four."""
        asked = []
        monkeypatch.setattr(tracker, "shaded_columns", lambda light: np.array([False]))
        n = len(open_)
        found = matches(n, shift=np.full(n, 2.0), gain=np.full(n, 0.9))

        def matched(window, usable, whole):
            asked.append((usable.tolist(), whole.tolist()))
            return found

        given = SimpleNamespace(
            light=None, marker=SimpleNamespace(radius=70.0),
            strip=SimpleNamespace(ring=SimpleNamespace(radii=np.array([60.0, 62.0]), step=0.01, centre=(3.0, 4.0))),
            _matters=lambda window: np.tile([False, True, True, False], (n, 1)),
            _matched_across=matched, _without_neighbours=lambda window, one, usable: one,
            _matched_along=lambda window, one, whole: matches(n, shift=np.full(n, 0.5)),
            _corners=lambda window, one, whole: (np.full((n, 2), 61.0), np.full((n, 2), 0.02)),
        )  # fmt: skip
        window = SimpleNamespace(known=np.arange(n) < 2, start=np.full(n, 30))
        return tracker.MarkerTracker.measure(given, window, np.array(open_), clear), asked[0]

    def test_a_marker_is_whole_if_nothing_hides_a_part_of_its_extent(self, monkeypatch):
        seen, (usable, whole) = self.measured(
            monkeypatch, [[False, True, True, False], [True, True, False, True], [True] * 4]
        )
        assert seen.open.tolist() == whole == [True, False, False]
        assert usable[1] == [True, True, False, True]
        assert seen.angle[:2] == pytest.approx([0.32, 0.32])
        assert seen.radius[0] == 71.0
        assert np.isnan(seen.radius[1:]).all()
        assert np.isnan([seen.angle[2], seen.gain[2], seen.misfit[2], seen.weakness[2]]).all()
        assert seen.corner_angle[0] == pytest.approx([0.32, 0.32])
        assert seen.centre[1].tolist() == [3.0, 4.0]

    def test_samples_in_shadows_are_not_used_of_a_whole_marker(self, monkeypatch):
        clear = np.array([[True, True, False, True]] * 3)
        _, (usable, _) = self.measured(
            monkeypatch, [[True] * 4, [True, False, True, True], [True] * 4], clear
        )
        assert usable[0] == [True, True, False, True]
        assert usable[1] == [True, False, True, True]  # partly hidden: its shadow is not excluded

    def test_corners_are_those_of_whole_markers_of_some_height(self, monkeypatch):
        seen = []
        monkeypatch.setattr(
            tracker, "near_corners", lambda shaped, *_: (np.full((2, 2), 61.0), np.full((2, 2), 0.02))
        )
        given = SimpleNamespace(
            strip=SimpleNamespace(ring=SimpleNamespace(radii=None, step=0.01), half=30),
            marker=SimpleNamespace(inner=60.0, outer=80.0),
            _likely=lambda r, phi, fine: seen.append(fine.tolist()) or np.array([[True], [False]]),
        )
        window = SimpleNamespace(shaped=lambda use, gain, offset: seen.append(use.tolist()))
        found = matches(4, gain=np.array([1.0, 0.09, 0.11, 1.0]), shift=np.arange(4.0))
        radius, angle = tracker.MarkerTracker._corners(
            given, window, found, np.array([True, True, True, False])
        )
        assert seen == [[True, False, True, False], [0.0, 0.02]]
        assert radius[0].tolist() == [61.0, 61.0]
        assert np.isnan(radius[1:]).all()
        assert np.isnan(angle[1:]).all()


class TestLight:
    def map(self, heights, passages=3.0, ground=None):
        """A map of one layer with these heights, each of `passages` full passages."""
        made = AngleMap(1, len(heights), ground)
        column = np.arange(len(heights))
        for _ in range(int(passages)):
            made.learn(0, column, np.ones(len(heights)), np.asarray(heights, dtype=float))
        return made

    def test_heights_are_relative_to_their_upper_middle(self):
        """The 60 % quantile of eleven values is the seventh one."""
        values = np.arange(1.0, 12.0)
        assert self.map(values).heights(0)[0] == pytest.approx(values / 7.0)
        assert windows._upper_middle(np.array([1.0, 2.0])) == pytest.approx(1.6)

    def test_a_height_of_one_has_the_weight_of_the_prior(self):
        found = self.map([1.0, 1.0, 1.0, 0.2, 1.0]).heights(0, prior=4.0)[0]
        assert found == pytest.approx([1.0, 1.0, 1.0, (0.2 * 3 + 4) / 7, 1.0])

    def test_expected_heights_weigh_by_their_squares(self):
        """h = sum(a T p) / sum((a T)^2): 1 seen where 1 is expected, 0.1 where 0.5 is."""
        made = AngleMap(1, 2)
        made.learn(0, np.array([0, 0, 1, 1]), np.array([1.0, 0.5, 1.0, 0.0]), np.array([1.0, 0.1, 1.0, 9.0]))
        assert made._top[0] / made._bottom[0] == pytest.approx([1.05 / 1.25, 1.0])

    def test_the_light_beneath_a_marker_is_added_and_subtracted_again(self):
        """A marker of brightness 1 over a ground of 0.4: its height is 0.6; the mean is of the brightness."""
        ground = np.array([0.0, 0.4, 0.0, 0.0, 0.0, 0.0])
        found = self.map(1.0 - ground, ground=ground).heights(0)[0]
        assert found == pytest.approx(1.0 - ground)

    def test_neighbours_are_averaged_around_the_turn(self):
        rows = np.arange(6.0)[None]
        assert cyclic_sum(rows, 1)[0].tolist() == [6.0, 3.0, 6.0, 9.0, 12.0, 9.0]
        assert cyclic_sum(rows, 0).tolist() == rows.tolist()

    @pytest.mark.parametrize(("reach", "mean"), [(1, 2), (2, 2), (3, 3)])
    def test_the_light_is_between_0_55_and_2(self, reach, mean):
        """The mean is over at least a fifth of a turn to either side; unknown heights are those between."""
        asked = []
        heights = np.array([[1.0, 0.54, 0.56, 1.0, np.nan, 1.4, 1.99, 2.01, 1.0]])
        made = SimpleNamespace(columns=9, heights=lambda blur, prior: asked.append((blur, prior)) or heights)
        found = even_light(made, reach)
        assert found == pytest.approx([1.0, 0.55, 0.56, 1.0, 1.2, 1.4, 1.99, 2.0, 1.0])
        assert asked == [(mean, 4.0)]
        assert even_light(AngleMap(1, 8), 1).tolist() == [1.0] * 8

    @pytest.mark.parametrize(("height", "shaded"), [(0.5, False), (0.42, False), (0.3, True)])
    def test_a_shaded_column_is_below_0_55_with_its_prior(self, height, shaded):
        """9 passages and a prior of 4: (9 h + 4) / 13 < 0.55 for h < 0.35."""
        heights = np.ones(36)
        heights[10:13] = height
        found = windows.shaded_columns(self.map(heights, 3))
        assert found[11] == shaded
        assert not found[20:].any()
        assert not windows.shaded_columns(AngleMap(1, 36)).any()

    @pytest.mark.parametrize(("height", "hidden"), [(0.54, True), (0.56, False)])
    def test_what_hides_a_part_of_a_marker_hides_it_with_one_column_more(self, height, hidden):
        made = AngleMap(3, 60)
        every = np.ones((3, 60))
        every[1, 19:24] = height
        for layer in range(3):
            for _ in range(4):
                made.learn(layer, np.arange(60), np.ones(60), every[layer])
        found = open_columns(made, shadows=False)
        # means over three columns: 20 to 22 are dark, and one column on both sides is added
        assert np.flatnonzero(~found).tolist() == ([19, 20, 21, 22, 23] if hidden else [])

    @pytest.mark.parametrize(("dim", "reach"), [(0.94, 8), (0.96, 0)])
    def test_a_shadow_beside_what_hides_reaches_eight_columns_at_most(self, dim, reach):
        made, heights = AngleMap(1, 100), np.ones(100)
        heights[30:60] = dim
        heights[40:50] = 0.1
        for _ in range(4):
            made.learn(0, np.arange(100), np.ones(100), heights)
        hidden = np.flatnonzero(~open_columns(made, shadows=True))
        plain = np.flatnonzero(~open_columns(made, shadows=False))
        # a column of the mean beside the edge is dim in both cases
        assert plain[0] - hidden[0] == pytest.approx(max(reach, 1), abs=1)
        assert hidden[-1] - plain[-1] == plain[0] - hidden[0]

    def test_a_profile_is_divided_by_the_light(self):
        given = SimpleNamespace(raw=np.full((1, 3), 2.0), here=lambda around: around[None, :3])
        windows.MarkerWindow.apply_light(given, np.array([1.0, 2.0, 4.0, 9.0]))
        assert given.profile == pytest.approx(np.array([[2.0, 1.0, 0.5]]))

    def test_a_mean_along_the_radius_is_divided_by_the_light_too(self):
        scores = np.random.default_rng(0).uniform(size=(2, 3, 4)).astype(np.float32)
        weight, given = np.full((2, 4), 0.25), SimpleNamespace(scores=scores, _light=None)
        assert windows.MarkerWindow.along(given, weight) == pytest.approx(scores.mean(axis=2))
        given._light = np.array([[1.0, 2.0, 1.0, 0.5], [4.0, 1.0, 1.0, 1.0]])
        expected = (scores * given._light[:, None]).mean(axis=2)
        assert windows.MarkerWindow.along(given, weight) == pytest.approx(expected, rel=1e-5)


class TestOcclusion:
    """A map of the angle to the other body, in degrees."""

    STEP = TURN / 720

    def window(self, first, *, known=True, radius=50.0, layers=None, m=3):
        n = len(first)
        return SimpleNamespace(
            first=np.asarray(first), raw=np.zeros((n, m)), radius=radius, known=np.full(n, known),
            layers=np.ones((n, 3, m)) if layers is None else layers,
        )  # fmt: skip

    def test_columns_are_angles_relative_to_the_other_body(self):
        found = Occlusion(self.STEP)._relative(self.window([100, 700]), np.radians([0.2, 340.2]))
        # half degrees from 49.8 and from 9.8 on, rounded
        assert found.tolist() == [[50, 50, 51], [10, 10, 11]]

    @pytest.mark.parametrize(("offset", "expected"), [((5.0, 0.0), 84), ((0.0, 5.0), 90), ((0.0, 0.0), 90)])
    def test_a_ring_beside_the_axis_is_seen_from_the_axis(self, offset, expected):
        """A marker straight above the centre of its ring, 50 px: atan(50 / 5) = 84.3 degrees, y down."""
        found = Occlusion(self.STEP, offset)._relative(self.window([180], m=1), np.zeros(1))
        assert found.item() == expected
        aside = Occlusion(self.STEP, (0.0, 5.0))._relative(self.window([0], m=1), np.zeros(1))
        assert aside.item() == 354  # below the axis

    def test_samples_well_inside_a_marker_are_learnt(self):
        made = Occlusion(self.STEP)
        layers = np.ones((1, 3, 3))
        layers[0, 1] = [9.0, -9.0, 0.4]
        expected = np.array([[0.71, 0.8, 0.69]])
        made.learn(self.window([100], layers=layers), expected, np.zeros(1))
        top, bottom = made.map._top[1], made.map._bottom[1]
        assert bottom[50] == pytest.approx(0.71**2 + 0.8**2)
        assert bottom[51] == 0.0
        assert top[50] == pytest.approx(0.71 * 1.5 - 0.8 * 0.2)  # heights between -0.2 and 1.5
        made.learn(self.window([200], known=False), expected, np.zeros(1))
        made.learn(self.window([200]), expected, np.full(1, np.nan))
        assert not made.map._bottom[:, 100:102].any()

    def test_an_unknown_body_hides_nothing(self, monkeypatch):
        monkeypatch.setattr(windows, "open_columns", lambda cover, *, shadows: np.arange(360) != 50)
        made, window = Occlusion(self.STEP), self.window([100, 100])
        assert made.open(window, np.array([0.0, np.nan])).tolist() == [[False, False, True], [True] * 3]
        assert made.open(window, None).all()


class TestFollowing:
    """A body in 256 columns."""

    def score(self, angle, seen):
        column = np.arange(256) * TURN / 256
        off = np.angle(np.exp(1j * (column[None] - angle[:, None])))
        return np.where(seen[:, None], np.exp(-(off**2) / 0.02), 0.0)

    @pytest.mark.parametrize(("ahead", "found"), [(0.3, True), (0.45, False), (-0.3, True), (-0.45, False)])
    def test_it_is_searched_within_0_35_rad(self, ahead, found):
        angle, seen, motion = follow(
            self.score(np.array([1.0 + ahead]), np.ones(1, dtype=bool)), Motion(1.0, 0.0), 0.4
        )
        assert seen[0] == found
        assert angle[0] == pytest.approx(1.0 + (ahead if found else 0.0), abs=0.01)
        assert motion.missed == (not found)

    @pytest.mark.parametrize(("missed", "found"), [(0, False), (20, True)])
    def test_the_search_widens_while_it_is_hidden(self, missed, found):
        """By 0.01 rad a frame."""
        score = self.score(np.array([1.45]), np.ones(1, dtype=bool))
        assert follow(score, Motion(1.0, 0.0, missed), 0.4)[1][0] == found

    @pytest.mark.parametrize(("missed", "lost"), [(40, False), (41, True)])
    def test_after_forty_hidden_frames_it_is_lost(self, missed, lost):
        score = self.score(np.array([1.0]), np.zeros(1, dtype=bool))
        assert np.isnan(follow(score, Motion(1.0, 0.2, missed), 0.4)[0][0]) == lost

    def test_a_prediction_advances_by_the_periods_of_the_camera(self):
        score = self.score(np.zeros(3), np.zeros(3, dtype=bool))
        angle, _, motion = follow(score, Motion(1.0, 0.2), 0.4, np.array([1.0, 2.5, 0.0]))
        assert angle == pytest.approx([1.0, 1.2, 1.7])
        assert (motion.angle, motion.missed) == (pytest.approx(1.7), 3)

    @pytest.mark.parametrize(("count", "known"), [(15, False), (16, True)])
    def test_a_motion_is_predicted_from_sixteen_angles(self, count, known):
        frame = np.arange(float(count))
        found = Prediction()
        found.add(frame, 0.3 * frame, np.ones(count, dtype=bool))
        assert (found.at(np.array([20.0])) is not None) == known

    def test_the_uncertainty_of_a_prediction_is_that_of_its_scatter(self):
        """A parabola through 100 angles of a body that is seen face-on, 20 frames ahead."""
        frame, errors, stated = np.arange(100.0), [], []
        for seed in range(60):
            rng = np.random.default_rng(seed)
            found = Prediction()
            angle = 0.5 * frame - 1e-3 * frame**2 + 5e-3 * rng.standard_normal(100)
            found.add(frame, angle, np.ones(100, dtype=bool))
            (value,), u = found.at(np.array([119.0]))
            errors.append(value - (0.5 * 119 - 1e-3 * 119**2))
            stated.append(u)
        assert np.std(errors) == pytest.approx(np.mean(stated), rel=0.3)
        found.reset()
        assert found.at(np.array([119.0])) is None

    def test_an_oblique_view_has_a_prior_of_a_twentieth(self):
        """s sqrt(x' (X'X + P s^2)^-1 x) with P = 1 / 0.05^2 of four harmonics, over a third of a turn."""
        frame, found = np.arange(60.0), Prediction()
        angle = 2.0 * frame / 60 + 0.01 * np.where(np.arange(60) % 2, 1.0, -1.0)
        found.add(frame, angle, np.ones(60, dtype=bool))
        _, u = found.at(np.array([70.0]))
        s = 1.4826 * 0.01

        def rows(k):
            x, psi = (k - 59.0) / 59.0, 2.0 * k / 60
            return np.stack(
                [np.ones_like(x), x, x * x, np.cos(psi), np.sin(psi), np.cos(2 * psi), np.sin(2 * psi)],
                axis=-1,
            )

        prior = np.diag([0.0] * 3 + [1 / 0.05**2] * 4)
        inverse = np.linalg.inv(rows(frame).T @ rows(frame) + prior * s**2)
        ahead = rows(np.array([70.0]))[0]
        assert u == pytest.approx(s * math.sqrt(ahead @ inverse @ ahead), rel=0.05)

    def test_slips_do_not_change_a_prediction(self):
        """Four of 100 angles are wrong by 0.2 rad, with a scatter of 0.015 rad."""
        frame, found = np.arange(100.0), Prediction()
        angle = 0.3 * frame + 0.01 * np.where(np.arange(100) % 2, 1.0, -1.0)
        angle[90:98:2] += 0.2
        found.add(frame, angle, np.ones(100, dtype=bool))
        assert found.at(np.array([104.0]))[0][0] == pytest.approx(0.3 * 104, abs=0.02)

    @pytest.mark.parametrize(("ahead", "again"), [(130, False), (131, True)])
    def test_a_motion_is_fitted_again_after_130_frames(self, ahead, again):
        found, frame = Prediction(), np.arange(100.0)
        found.add(frame, 0.3 * frame, np.ones(100, dtype=bool))
        assert found.at(np.array([100.0]))[0][0] == pytest.approx(30.0, abs=1e-3)
        later = 100.0 + np.arange(129)
        found.add(later, 30.0 + 0.2 * (later - 100.0), np.ones(129, dtype=bool))
        value = found.at(np.array([99.0 + ahead]))[0][0]
        expected = 30.0 + 0.2 * (ahead - 1.0) if again else 0.3 * (99.0 + ahead)
        assert value == pytest.approx(expected, abs=0.1)


class TestStrip:
    """The ring about a marker: the background under it, its rows and its windows."""

    @staticmethod
    def strip(monkeypatch, *, outer=80.0, keep_out=10.0, foot=0.15, columns=360, margin=0.1, colour="blue"):
        monkeypatch.setattr(
            windows.MarkerStrip,
            "_background",
            lambda self, samples: np.zeros((self.ring.rows, 9), np.float32),
        )
        luma, chroma = np.zeros((240, 320), np.uint8), np.zeros((120, 160), np.uint8)
        samples = SimpleNamespace(frames=[SimpleNamespace(y=luma, u=chroma, v=chroma)])
        marker = SimpleNamespace(
            colour=colour,
            inner=60.0,
            outer=outer,
            radius=70.0,
            half_width=0.1,
            foot=foot,
            contrast=(3.0, -4.0),
        )
        return windows.MarkerStrip(marker, samples, (160.0, 120.0), keep_out, columns, margin, 5)

    @pytest.mark.parametrize(
        ("outer", "keep_out", "limits"),
        [(70.0, 10.0, (54.0, 76.0)), (100.0, 10.0, (48.0, 112.0)), (70.0, 57.0, (57.0, 76.0))],
    )
    def test_its_ring_extends_by_a_part_of_the_length_of_the_marker(
        self, monkeypatch, outer, keep_out, limits
    ):
        """Three tenths, 6 px at least, and not into the disc."""
        ring = self.strip(monkeypatch, outer=outer, keep_out=keep_out).ring
        assert (ring.inner, ring.outer) == limits

    @pytest.mark.parametrize(
        ("foot", "columns", "margin", "slack", "half"),
        [
            (0.15, 360, 0.1, 7, 20),  # 5.7 columns, and (0.15 + 4 columns) are 12.6
            (0.05, 360, 0.1, 7, 18),  # 1.1 half widths at least
            (0.3, 360, 0.1, 7, 23),  # 2 at most
            (0.15, 1000, 0.1, 17, 51),  # 0.06 rad are more than 4 columns
            (0.15, 360, 3.0, 173, 179),  # less than a turn
        ],
    )
    def test_its_windows_contain_the_blurred_marker_within_the_margin(
        self, monkeypatch, foot, columns, margin, slack, half
    ):
        found = self.strip(monkeypatch, foot=foot, columns=columns, margin=margin)
        assert (found.slack, found.half, found.width) == (slack, half, 2 * half + 1)
        assert found.windows.shape == (5, found.ring.rows, found.width)

    @pytest.mark.parametrize(("colour", "weights"), [("white", (1 / 3, 0.0)), ("blue", (3 / 25, -4 / 25))])
    def test_the_score_of_the_marker_itself_is_one(self, monkeypatch, colour, weights):
        found = self.strip(monkeypatch, colour=colour)._score
        assert found.weights == pytest.approx(weights)
        assert found.buffer.shape == ((240, 320) if colour == "white" else (120, 160))

    @pytest.mark.parametrize("count", [4, 5])
    @pytest.mark.parametrize("white", [True, False])
    def test_the_background_is_the_median_of_the_samples(self, white, count):
        """Of a coloured marker those from which the scene is determined."""
        frames = np.random.default_rng(count).normal(size=(count + 3, 6, 9)).astype(np.float32)
        chosen = list(range(count))
        samples = SimpleNamespace(frames=frames[:count] if white else frames, spread=chosen)
        grid = SimpleNamespace(around=lambda frame, rows: frame[rows])
        strip = SimpleNamespace(white=white, grid=grid, marker=SimpleNamespace(dwell=0.29))
        expected = np.median(frames[:count], axis=0)
        assert windows.MarkerStrip._background(strip, samples) == pytest.approx(expected)
        strip.marker.dwell = 0.31  # the marker itself is in the median of a pixel
        rows = np.repeat(np.median(expected, axis=1)[:, None], 9, axis=1)
        assert windows.MarkerStrip._background(strip, samples) == pytest.approx(rows)

    @pytest.mark.parametrize(
        ("inner", "outer", "rows"),
        [(50.0, 70.0, (52, 69)), (50.0, 60.0, (52, 59)), (50.3, 52.4, (51, 53)), (50.45, 50.7, (51, 52))],
    )
    def test_rows_well_inside_a_marker(self, inner, outer, rows):
        """Without 15 % of its length at both ends, 2 px at most; the nearest row to its middle if there is none."""
        strip = SimpleNamespace(
            marker=SimpleNamespace(inner=inner, outer=outer, radius=0.5 * (inner + outer))
        )
        ring = SimpleNamespace(radii=np.arange(100.0))
        assert windows.MarkerStrip._rows_on(strip, ring) == rows

    def test_windows_begin_half_a_width_before_the_expected_angle(self):
        cut = []
        ring = SimpleNamespace(step=TURN / 100, columns=100)
        grid = SimpleNamespace(ring=ring, cut=lambda *given: cut.append(given))
        strip = SimpleNamespace(
            grid=grid, half=7, starts=np.zeros(6, dtype=np.int64), windows=np.arange(6.0), _under="under",
            _used=False,
        )  # fmt: skip
        windows.MarkerStrip.take(strip, ["a", "b", "c"], 2, np.array([2.4, -3.4, 103.6]) * ring.step)
        assert strip.starts.tolist() == [0, 0, 2, -3, 104, 0]
        ((frames, first, under, out),) = cut
        assert (frames, first.tolist(), under, out.tolist()) == (
            ["a", "b", "c"],
            [95, 90, 97],
            "under",
            [2.0, 3.0, 4.0],
        )
        assert strip._used

    def test_the_columns_of_a_window_are_counted_over_a_full_turn(self):
        strip = SimpleNamespace(
            marker=SimpleNamespace(radius=50.0), half=2, rows=slice(1, 8), starts=np.array([1, 9, 4]),
            ring=SimpleNamespace(step=TURN / 10, columns=10),
            windows=np.random.default_rng(0).uniform(size=(3, 9, 5)).astype(np.float32),
        )  # fmt: skip
        found = windows.MarkerWindow(strip, np.array([1.3, 8.8, np.nan]) * TURN / 10)
        assert found.column(10).tolist() == [[9, 0, 1, 2, 3], [7, 8, 9, 0, 1], [2, 3, 4, 5, 6]]
        assert found.fraction == pytest.approx([0.3, -0.2, 0.0])
        assert found.known.tolist() == [True, True, False]
        # seven rows in layers of three, two and two
        parts = [strip.windows[:, a:b].mean(axis=1) for a, b in ((1, 4), (4, 6), (6, 8))]
        assert found.layers == pytest.approx(np.stack(parts, axis=1), rel=1e-5)
        assert found.raw == pytest.approx(strip.windows[:, 1:8].mean(axis=1), rel=1e-5)
        gain, offset = np.array([2.0, 0.5]), np.array([0.1, -0.3])
        for light in (np.ones(10), np.linspace(0.5, 2.0, 10)):
            found.apply_light(light)
            lit = strip.windows[:2] / light[found.column(10)[:2]][:, None]
            expected = (lit - offset[:, None, None]) / gain[:, None, None]
            shaped = found.shaped(found.known, gain, offset).bands(np.eye(9))
            assert shaped == pytest.approx(expected, rel=1e-5)
