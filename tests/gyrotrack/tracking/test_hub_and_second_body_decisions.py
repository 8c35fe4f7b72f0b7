"""Tests of one fixed hub, of a second body on the hub, and of the error of a displaced hub, by hand-made pictures."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.tracking import _coaxial as coaxial
from gyrotrack.tracking import _fixed_hub as hub
from gyrotrack.tracking import _tracked as tracked
from gyrotrack.tracking import _translation as translation
from gyrotrack.tracking._registration import Ring

TURN = 2 * np.pi


class TestFixedHub:
    @pytest.mark.parametrize("hidden", [False, True])
    def test_the_middle_of_a_body_is_weighted_by_its_details(self, hidden):
        """A single bright sample has four neighbours with equal slopes; the weight contains the area."""
        ring = Ring((0.0, 0.0), 10.0, 22.0, 6, 8)
        body, allowed = np.zeros((6, 8)), np.ones((6, 8), dtype=bool)
        body[2, 4] = 50.0
        allowed[1, 4] = not hidden
        r, phi = ring.radius, ring.angle
        samples = [(2, 3), (2, 5), (3, 4)] + ([] if hidden else [(1, 4)])
        total = sum(r[i] ** 2 * np.exp(1j * phi[k]) for i, k in samples) / sum(r[i] for i, _ in samples)
        place = hub._middle_of(SimpleNamespace(ring=ring, body=body, allowed=allowed))
        for angle in (0.0, 0.7):
            turned = total * np.exp(1j * angle)
            assert place(angle) == pytest.approx([turned.real, turned.imag])

    @pytest.mark.parametrize(
        ("steps", "options", "shift", "angle", "count"),
        [
            ([(5.0, -3.0), (0.5, 0.04), (-0.04, 0.04), (9.0, 9.0)], {}, (2.46, -1.92), 3.0, 3),
            ([(0.06, 0.0), (0.04, 0.0)], {}, (0.1, 0.0), 2.0, 2),
            ([(0.06, 0.0), (0.04, 0.0)], {"step": 0.1}, (0.06, 0.0), 1.0, 1),
            ([(0.01, -0.3), (0.0, 0.0)], {"step": 0.2}, (0.01, -0.3), 2.0, 2),
            ([(-9.0, 1.0)] * 20, {}, (-16.0, 8.0), 8.0, 8),
        ],
    )
    def test_a_hub_is_displaced_in_steps_of_two_pixels(
        self, monkeypatch, steps, options, shift, angle, count
    ):
        seen, begun = [], []

        def register(polar, template, start, *, move):
            seen.append(polar)
            begun.append(start)
            assert move
            return SimpleNamespace(shift=np.array(steps[len(seen) - 1]), angle=float(len(seen)))

        monkeypatch.setattr(hub, "register", register)
        template = SimpleNamespace(ring=SimpleNamespace(unwrap=lambda picture, at: at))
        found, moved = hub.displaced(None, template, 0.3, **options)
        assert (found, len(seen)) == (angle, count)
        assert moved == pytest.approx(shift)
        assert begun == [0.3, *np.arange(1.0, count)]
        at = np.cumsum(np.clip(steps[:count], -2.0, 2.0), axis=0)
        assert np.array(seen[1:]) == pytest.approx(at[:-1]) if count > 1 else seen == [(0.0, 0.0)]

    def test_the_drift_is_that_of_the_middle_of_the_body_in_four_frames_of_five(self, monkeypatch):
        """Of 118 frames every third is used; the displacement grows from frame to frame."""
        angle = 0.01 * np.arange(118.0)
        learnt = []

        def displaced(picture, template, start):
            return start + 0.1, np.array([0.0, 0.2 * picture])

        monkeypatch.setattr(hub, "learn", lambda *given, **how: learnt.append((given, how)) or "template")
        monkeypatch.setattr(hub, "displaced", displaced)
        monkeypatch.setattr(hub, "_middle_of", lambda _: lambda a: np.array([30.0 * a, 0.0]))
        ring = SimpleNamespace(inner=100.0, outer=300.0, unwrap=lambda p: -p, inside=lambda area: area)
        found, limit = hub.drift(ring, list(range(118)), angle, "area", separate=True)
        shift = 0.2 * np.arange(0, 118, 3)  # along y; along x 3 px in all frames
        assert found == pytest.approx(np.quantile(np.abs(shift - np.median(shift)), 0.8))
        assert limit == pytest.approx(0.015 * 200.0)
        ((given, how),) = learnt
        assert given[0] == [-k for k in range(0, 118, 3)]
        assert given[1] == pytest.approx(angle[::3])
        assert given[2:] == ("area", ring)
        assert how == {"separate": True, "plain": True}

    def test_the_drift_contains_the_rotation_of_the_middle(self, monkeypatch):
        monkeypatch.setattr(hub, "learn", lambda *_, **__: None)
        monkeypatch.setattr(hub, "displaced", lambda p, _, start: (start + (0.5 if p else 0.0), np.zeros(2)))
        monkeypatch.setattr(hub, "_middle_of", lambda _: lambda a: np.array([10.0 * a, 0.0]))
        ring = SimpleNamespace(inner=10.0, outer=20.0, unwrap=lambda p: p, inside=lambda _: None)
        # in two frames of five the middle is 5 px beside its place
        found, limit = hub.drift(ring, [0, 0, 0, 1, 1], np.arange(5.0), None, separate=False)
        assert (found, limit) == (pytest.approx(5.0), 2.3)
        assert hub.drift(ring, [0, 0, 0, 0, 1], np.arange(5.0), None, separate=False)[0] == pytest.approx(
            np.quantile([0.0, 0.0, 0.0, 0.0, 5.0], 0.8)
        )

    @pytest.mark.parametrize(("error", "share"), [(0.019, None), (0.021, 0.021), (0.5, 0.5)])
    def test_halves_differ_by_two_percent_of_the_standard_deviation(self, error, share):
        angle = 3.0 * np.array([1.0, -1.0] * 20)
        found = hub.halves_differ(angle, 3.0 * error)
        assert found == (None if share is None else pytest.approx(share))


class TestSecondRotation:
    """Pictures of 2 x 8 samples; registration is replaced, its arguments are compared."""

    BODY = np.array([[1.0, 0, 0, 0, 0, 0, 0, 0], [0, 0, 4.0, 0, 0, 0, 0, 0]], dtype=np.float32)

    def found(self, monkeypatch, *, share=0.5, low=0.3, high=0.45, ranges=(1.0, 1.0), ring=True):
        rng = np.random.default_rng(0)
        self.frames = [rng.integers(0, 99, (2, 8)).astype(np.float32) for _ in range(6)]
        self.angle = 0.1 * np.array([0.0, 1, 3, 2, 5, 4])
        self.fixed = np.full((2, 8), 7.0, dtype=np.float32)
        self.allowed = np.ones((2, 8), dtype=bool)
        self.allowed[0, 3] = False
        self.told = {"learn": [], "follow": [], "explained": [], "ring": []}
        # bands differ in the sign of the angle
        others = {
            "low": -ranges[0] * np.linspace(0.0, 1.0, 6),
            "high": -ranges[1] * np.linspace(0.0, 1.0, 6) - 3.0,
        }
        made = SimpleNamespace(
            inside=lambda area: self.allowed if area == "area" else None,
            unwrap=lambda frame: frame,
            step=0.1,
            area=np.array([[1.0], [3.0]]),
        )

        def ring_for(*given):
            self.told["ring"].append(given)
            return made if ring else None

        def learn(polars, angle, allowed, ring, **how):
            self.told["learn"].append((polars, angle, how))
            assert allowed is self.allowed
            return SimpleNamespace(fixed=self.fixed, body=self.BODY, of=float(angle[0]))

        def explained(polars, angle, body):
            self.told["explained"].append((polars, angle))
            first = len(self.told["explained"]) == 1
            return (share if first else low if angle is others["low"] else high), None

        def follow(rest, weight, fixed, ring, *, band):
            self.told["follow"].append((rest, weight, fixed, band))
            return others[band]

        for name, what in (
            ("ring_for", ring_for),
            ("learn", learn),
            ("explained", explained),
            ("follow", follow),
        ):
            monkeypatch.setattr(coaxial, name, what)
        monkeypatch.setattr(coaxial, "every", lambda count: 2 if count == 6 else 1)
        motion = SimpleNamespace(area="area")
        return coaxial.second_rotation(
            self.frames, motion, (3.0, 4.0), self.angle, stretch=(0.1, 0.0), separate=False
        )

    def test_the_rest_is_what_the_first_body_and_its_background_do_not_show(self, monkeypatch):
        found = self.found(monkeypatch)
        assert (found.of_rest, found.of_all) == (0.45, pytest.approx(0.225))
        assert found.angle[0] == -3.0  # from the high orders, which explain more
        ((given_hub, _, finest, stretch),) = self.told["ring"]
        assert (given_hub, finest, stretch) == ((3.0, 4.0), 48.0, (0.1, 0.0))
        for rest, weight, fixed, _ in self.told["follow"]:
            for p, r, k in zip(self.frames, rest, (0, 1, 3, 2, 5, 4), strict=True):
                assert r == pytest.approx(p - 7.0 - np.roll(self.BODY, k, axis=1), abs=1e-4)
            assert fixed == pytest.approx(np.mean(rest, axis=0))
            assert weight == pytest.approx(np.array([[1.0], [3.0]]) * self.allowed)
        assert [band for *_, band in self.told["follow"]] == ["low", "high"]
        (polars, angle, how), *others = self.told["learn"]
        assert [p is f for p, f in zip(polars, self.frames[::2], strict=True)] == [True] * 3
        assert angle == pytest.approx(self.angle[::2])
        assert how == {"separate": False, "plain": True}
        assert [(len(p), len(a), h["separate"]) for p, a, h in others] == [(3, 3, True)] * 2
        assert [len(p) for p, _ in self.told["explained"]] == [6, 6, 6]

    @pytest.mark.parametrize(
        ("given", "of_rest"),
        [
            ({"share": 0.94, "high": 0.9}, 0.9),
            ({"share": 0.96, "high": 0.9}, None),
            ({"low": 0.6, "high": 0.5}, 0.6),
            ({"low": 0.6, "high": 0.5, "ranges": (1.9e-3, 1.0)}, 0.5),
            ({"low": 0.6, "high": 0.5, "ranges": (1.9e-3, 1.9e-3)}, None),
            ({"share": 0.4, "high": 0.25}, 0.3),
            ({"low": 0.1, "high": 0.19}, None),
            ({"ring": False}, None),
        ],
    )
    def test_the_rotation_that_explains_most_is_returned_if_it_explains_enough(
        self, monkeypatch, given, of_rest
    ):
        found = self.found(monkeypatch, **given)
        assert (found and found.of_rest) == of_rest

    def test_a_second_rotation_that_is_the_first_one_is_none(self, monkeypatch):
        monkeypatch.setattr(coaxial, "differs_from", lambda *_: False)
        assert self.found(monkeypatch) is None

    @pytest.mark.parametrize(("ratio", "differs"), [(1.24, False), (1.26, True), (0.81, False), (0.79, True)])
    @pytest.mark.parametrize("exchanged", [False, True])
    def test_motions_differ_by_a_fifth_of_the_larger_one(self, ratio, differs, exchanged):
        angle = np.linspace(0.0, 3.0, 50)
        pair = (ratio * angle, angle) if exchanged else (angle, ratio * angle)
        assert coaxial.differs_from(*pair) == differs


class TestHubError:
    @pytest.mark.parametrize(("trend", "order", "factor"), [
        (0, 2, 4 / math.sqrt(6)),
        (1, 2, 4 / math.sqrt(6)),
        (2, 3, 8 / math.sqrt(20)),
        (3, 4, 16 / math.sqrt(70)),
        (5, 6, 64 / math.sqrt(924)),
    ])  # fmt: skip
    def test_the_white_noise_of_alternating_values_is_that_of_the_lowest_order_without_the_trend(
        self, trend, order, factor
    ):
        x = np.arange(40.0)
        values = np.where(x % 2, 1e-2, -1e-2)
        assert tracked.white_noise(values + x**trend) == pytest.approx(1.4826e-2 * factor, rel=1e-5)
        places = np.delete(x, 17)
        found = tracked.white_noise(np.delete(values + x**trend, 17), places)
        assert found == pytest.approx(1.4826e-2 * factor, rel=1e-5)

    def test_an_order_needs_three_times_as_many_values(self):
        x = np.arange(30.0)
        values = np.where(x % 2, 1.0, -1.0) + 1e3 * x**5
        known = 1.4826 * 64 / math.sqrt(924)
        assert tracked.white_noise(values[:19]) == pytest.approx(known, rel=1e-3)
        assert tracked.white_noise(values[:18]) > 10 * known
        assert math.isnan(tracked.white_noise(values[:6]))
        assert tracked.white_noise(np.where(x[:7] % 2, 1.0, -1.0)) == pytest.approx(1.4826 * 4 / math.sqrt(6))

    def test_the_halves_show_a_displaced_hub_by_a_harmonic_of_the_angle(self, monkeypatch):
        """Less mean and trend; the leverage multiplies it."""
        parts = []
        monkeypatch.setattr(tracked, "hub_leverage", lambda p: parts.append(p) or 2.5)
        for turns in (0.6, 1.0, 2.9):
            angle = 1.0 + TURN * turns * np.linspace(0.0, 1.0, 300) ** 2
            view = 0.01 * np.cos(angle) + 0.02 * np.sin(angle)
            one = 0.4 * np.sin(7.0 * angle)
            halves = np.stack([one + view + 0.5 + 0.3 * np.linspace(0.0, 1.0, 300), one])
            assert tracked.hub_error(angle, halves, "parts") == pytest.approx(2.5 * np.std(view), rel=1e-6)
        assert parts == ["parts"] * 3
        angle = TURN * 3.1 * np.linspace(0.0, 1.0, 300)
        assert tracked.hub_error(angle, np.stack([np.cos(angle), np.zeros(300)]), "parts") == 0.0

    def test_over_less_than_half_a_turn_the_halves_differ_by_a_multiple_of_the_angle(self, monkeypatch):
        monkeypatch.setattr(tracked, "hub_leverage", lambda _: 2.5)
        angle = 1.0 + 1.5 * np.sin(np.linspace(0.0, 20.0, 300))
        halves = np.stack([0.97 * angle + 0.2, angle - 0.1 * np.linspace(0.0, 1.0, 300)])
        assert tracked.hub_error(angle, halves, None) == pytest.approx(2.5 * 0.03 * np.std(angle), rel=1e-6)

    @pytest.mark.parametrize(("times", "known"), [(2.9, False), (3.1, True)])
    def test_a_difference_below_three_standard_errors_is_none(self, monkeypatch, times, known):
        """Over one turn the variances of cosine and sine are 2 / n each."""
        monkeypatch.setattr(tracked, "hub_leverage", lambda _: 1.0)
        angle = TURN * np.arange(400) / 400
        noise = 0.01 * np.where(np.arange(400) % 2, 1.0, -1.0)
        rows = np.stack([np.cos(angle), np.sin(angle), np.ones(400), np.linspace(-1.0, 1.0, 400)], axis=1)
        error = 0.01 * math.sqrt(np.trace(np.linalg.inv(rows.T @ rows)[:2, :2]))
        apart = times * error * np.cos(angle + 0.7) + noise
        found = tracked.hub_error(angle, np.stack([apart, np.zeros(400)]), None)
        assert (found > 0.0) == known
        assert not known or found == pytest.approx(times * error / math.sqrt(2.0), rel=0.05)

    def test_the_leverage_is_the_inverse_radius_by_its_difference(self):
        """Radii are weighted by the information of the rows."""

        def part(information, whole=None):
            ring = SimpleNamespace(radius=np.array([10.0, 20.0, 40.0]))
            return SimpleNamespace(ring=ring, information=lambda: np.array(information), whole=lambda: whole)

        inner, outer = part([3.0, 1.0, 0.0], part([3.0, 1.0, 4.0])), part([0.0, 0.0, 4.0])
        r1, r2, r = 12.5, 40.0, (30.0 + 20.0 + 160.0) / 8.0
        assert tracked.hub_leverage((inner, outer)) == pytest.approx(1 / r / (1 / r1 - 1 / r2))
        assert tracked.hub_leverage(
            (part([0.0, 0.0, 4.0], part([3.0, 1.0, 4.0])), part([3.0, 1.0, 0.0]))
        ) == (pytest.approx(1 / r / (1 / r1 - 1 / r2)))


class TestTranslation:
    def test_a_rotation_keeps_its_hub_and_turns_from_x_to_y(self):
        move = translation._rotation((30.0, 50.0), 0.5 * np.pi)
        assert move @ [30.0, 50.0, 1.0] == pytest.approx([30.0, 50.0], abs=1e-4)
        assert move @ [40.0, 50.0, 1.0] == pytest.approx([30.0, 60.0], abs=1e-4)
        assert translation._rotation((30.0, 50.0), 0.3) @ [30.0, 60.0, 1.0] == pytest.approx(
            [30.0 - 10.0 * np.sin(0.3), 50.0 + 10.0 * np.cos(0.3)], abs=1e-4
        )

    def test_the_residual_is_the_variance_of_the_pixels_of_pictures_moved_back(self):
        picture = np.random.default_rng(0).integers(0, 255, (20, 30)).astype(np.uint8)
        moved = np.roll(picture, (2, 5), axis=(0, 1))
        swept = np.zeros((20, 30), dtype=np.uint8)
        swept[4:12, 6:20] = 1
        still, right = np.eye(2, 3, dtype=np.float32), np.float32([[1, 0, 5], [0, 1, 2]])
        assert translation.residual([picture, moved], [still, right], swept) == pytest.approx(0.0, abs=1e-6)
        pair = np.stack([picture, moved]).astype(float)[:, 4:12, 6:20]
        assert translation.residual([picture, moved], [still, still], swept) == pytest.approx(
            float(np.mean(0.25 * (pair[0] - pair[1]) ** 2)), rel=1e-5
        )

    @pytest.mark.parametrize(("size", "told"), [((5, 6), True), ((5, 5), False)])
    def test_thirty_pixels_within_the_ring_are_compared(self, monkeypatch, size, told):
        asked = iter([0.1, 1.0])
        monkeypatch.setattr(translation, "residual", lambda *_: next(asked))
        pictures = [np.full((60, 80), 10 * k, dtype=np.uint8) for k in range(3)]
        moving = np.zeros((60, 80), dtype=bool)
        moving[20 : 20 + size[0], 30 : 30 + size[1]] = True
        moving[50:, 60:] = True  # out of reach
        angle = np.array([0.0, 0.2, 0.5])
        assert translation.translates(pictures, moving, (32.0, 22.0), 20.0, angle) == told

    def test_a_single_picture_does_not_translate(self, monkeypatch):
        monkeypatch.setattr(translation, "residual", lambda *_: pytest.fail("compared"))
        moving = np.ones((60, 80), dtype=bool)
        picture = [np.zeros((60, 80), dtype=np.uint8)]
        assert not translation.translates(picture, moving, (32.0, 22.0), 20.0, np.zeros(1))
        assert not translation.translates([], moving, (32.0, 22.0), 20.0, np.zeros(0))

    def test_two_pictures_are_compared(self, monkeypatch):
        asked = iter([0.1, 1.0])
        monkeypatch.setattr(translation, "residual", lambda *_: next(asked))
        moving = np.ones((60, 80), dtype=bool)
        pictures = [np.full((60, 80), 10 * k, dtype=np.uint8) for k in range(2)]
        assert translation.translates(pictures, moving, (32.0, 22.0), 20.0, np.array([0.0, 0.2]))

    def test_the_rough_translation_is_that_of_the_middle_of_the_body(self, monkeypatch):
        """The reference is the picture in the middle of the range of angles."""
        asked = []

        def align(picture, reference, swept, start):
            asked.append((int(picture[0, 0]), int(reference[0, 0]), start))
            return np.eye(2, 3, dtype=np.float32)

        told = []
        monkeypatch.setattr(translation, "_translation", align)
        monkeypatch.setattr(translation, "residual", lambda p, m, s: told.append(m) or 0.0)
        angle = np.linspace(0.0, 0.9, 40) ** 2
        pictures = [np.full((60, 80), k, dtype=np.uint8) for k in range(40)]
        for k, picture in enumerate(pictures):
            picture[30:34, 50:58] = 200 + k % 2
        moving = np.zeros((60, 80), dtype=bool)
        moving[26:38, 48:60] = True
        hub = (20.0, 31.5)
        assert not translation.translates(pictures, moving, hub, 50.0, angle)
        use = np.unique(np.linspace(0, 39, 24).astype(int))
        assert [k for k, *_ in asked] == use.tolist()
        middle = use[np.argmin(np.abs(angle[use] - 0.405))]
        assert {r for _, r, _ in asked} == {middle}
        y, x = np.nonzero(moving)
        weight = np.abs(pictures[middle] - np.mean([pictures[k] for k in use], axis=0))[y, x]
        px, py = np.average(x, weights=weight) - hub[0], np.average(y, weights=weight) - hub[1]
        for k, _, start in asked:
            turn = angle[k] - angle[middle]
            cos, sin = np.cos(turn), np.sin(turn)
            assert start == pytest.approx([cos * px - sin * py - px, sin * px + cos * py - py], abs=1e-3)
        turned = told[1]
        assert turned[0] == pytest.approx(translation._rotation(hub, angle[0] - angle[middle]))

    @pytest.mark.parametrize("shift", [(2.0, -1.0), (-3.5, 2.5)])
    def test_a_translation_is_aligned_from_a_rough_one(self, shift):
        y, x = np.mgrid[0:60, 0:80]

        def bob(at):
            return np.clip(
                40 + 180 * np.exp(-((x - at[0]) ** 2 + 2 * (y - at[1]) ** 2) / 60.0), 0, 255
            ).astype(np.uint8)

        reference, picture = bob((40.0, 30.0)), bob((40.0 + shift[0], 30.0 + shift[1]))
        swept = np.zeros((60, 80), dtype=np.uint8)
        swept[15:45, 20:60] = 1
        found = translation._translation(picture, reference, swept, np.array(shift) + 0.8)
        assert found[:, :2] == pytest.approx(np.eye(2))
        assert found[:, 2] == pytest.approx(shift, abs=0.05)
        plain = translation._translation(
            np.full((60, 80), 9, dtype=np.uint8), reference, swept, np.array(shift)
        )
        assert plain[:, 2] == pytest.approx(shift)
