"""A second part of the picture that turns about the hub of a body is found; one body alone is not two."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from gyrotrack.tracking import _coaxial as coaxial
from gyrotrack.tracking._coaxial import differs_from, enough, second_rotation
from gyrotrack.tracking._hub_search import Motion

SIZE, HUB = 96, (47.5, 47.5)
TIME = np.arange(40) / 20
FIRST, SECOND = 2.0 * TIME, -3.1 * TIME


def _texture(seed, contrast):
    rng = np.random.default_rng(seed)
    smooth = cv2.GaussianBlur(rng.normal(size=(SIZE, SIZE)), (0, 0), 2.5)
    return (120.0 + contrast * smooth / smooth.std()).astype(np.float32)


def _frames(inner, contrast=30.0, lamp=0.0):
    """An outer ring that turns by FIRST and an inner disc that turns by `inner`, clockwise as seen."""
    y, x = np.indices((SIZE, SIZE))
    distance = np.hypot(x - HUB[0], y - HUB[1])
    rng = np.random.default_rng(5)
    light = 1.0 + lamp * np.exp(-((x - 65.0) ** 2 + (y - 35.0) ** 2) / 400.0)
    frames = []
    for a, b in zip(FIRST, inner, strict=True):
        picture = np.full((SIZE, SIZE), 120.0)
        for turn, texture, part in (
            (a, _texture(1, 30.0), (distance >= 28) & (distance < 44)),
            (b, _texture(2, contrast), distance < 26),
        ):
            move = cv2.getRotationMatrix2D(HUB, -np.degrees(turn), 1.0)
            picture[part] = cv2.warpAffine(texture, move, (SIZE, SIZE))[part]
        picture = picture * light + rng.normal(0, 1.0, picture.shape)
        frames.append(np.clip(picture, 0, 255).astype(np.uint8))
    return frames


def _second(frames):
    return second_rotation(frames, Motion.of(frames), HUB, FIRST)


def test_a_disc_in_a_ring_turns_differently():
    found = _second(_frames(SECOND))
    assert np.ptp(found.angle) == pytest.approx(np.ptp(SECOND), rel=0.02)
    text = found.warning(FIRST)
    assert f"by {np.ptp(FIRST):.3g} rad" in text
    assert "--point X,Y" in text


@pytest.mark.parametrize("lamp", [0.0, 0.4])
def test_one_body_is_not_two(lamp):
    """Light that is fixed in the image changes the picture of a body as it turns."""
    assert _second(_frames(FIRST, lamp=lamp)) is None


@pytest.mark.parametrize(
    ("of_rest", "of_all", "told"),
    [(0.41, 0.06, True), (0.39, 0.06, False), (0.41, 0.04, False), (0.21, 0.11, True), (0.19, 0.11, False)],
)
def test_a_second_rotation_explains_much_of_the_rest_or_of_the_whole(of_rest, of_all, told):
    """Single bodies have at most 0.2 of the rest and 0.03 of the whole; a rendered gyroscope 0.22 and 0.13."""
    assert enough(of_rest, of_all) == told


@pytest.mark.parametrize(("contrast", "seen"), [(18.0, True), (4.0, False)])
def test_a_second_rotation_explains_5_percent_of_the_change(contrast, seen):
    assert (_second(_frames(SECOND, contrast)) is not None) == seen


def test_a_second_part_that_does_not_turn_as_one_body_is_none():
    """What changes at random is not explained by a rotation: 40 % are required."""
    rng = np.random.default_rng(3)
    frames = _frames(rng.uniform(-np.pi, np.pi, len(TIME)))
    mixed = [f.copy() for f in frames]
    for k, frame in enumerate(mixed):
        frame[22:74, 22:74] = _texture(10 + k, 30.0)[22:74, 22:74].clip(0, 255)
    assert _second(mixed) is None


@pytest.mark.parametrize(("share", "differs"), [(0.15, False), (0.25, True)])
def test_two_motions_differ_by_a_fifth(share, differs):
    """The standard deviation of the difference is compared with that of the larger motion."""
    angle = np.linspace(0.0, 10.0, 200)
    assert differs_from(angle, (1.0 - share) * angle) == differs


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
