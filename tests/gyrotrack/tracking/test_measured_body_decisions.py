"""The measurement of a body through a whole film: on a small drawn film, and its decisions with replaced steps."""

import math
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from gyrotrack import TrackingError
from gyrotrack._column_store import StoredPictures
from gyrotrack.tracking import _any_body as module
from gyrotrack.tracking._diagnosis import RefusedFilmError
from gyrotrack.tracking._hub_search import Motion
from gyrotrack.tracking._registration import TURN, Pose, Ring, rolled

HUB = (31.5, 28.25)


class Drawn:
    """Pictures in memory with the interface of a film; some of them repeat the previous one."""

    warnings = ()
    path = SimpleNamespace(name="drawn")

    def __init__(self, frames):
        self._frames = frames
        self.selected = np.ones(len(frames), bool)

    def __len__(self):
        return len(self._frames)

    def frames(self):
        return iter(self._frames)

    def some(self, index):
        return StoredPictures.of(len(index), (self._frames[i] for i in index))


def turning(angles, noise=1.0):
    """Draw a disc with a soft texture that turns about `HUB`, clockwise as seen for increasing angles."""
    rng = np.random.default_rng(3)
    grain = cv2.GaussianBlur(rng.normal(0.0, 1.0, (58, 64)), (0, 0), 2.5)
    grain = 120.0 + 45.0 * grain / grain.std()
    y, x = np.mgrid[0:58, 0:64]
    cover = np.clip(25.0 - np.hypot(x - HUB[0], y - HUB[1]), 0.0, 1.0)
    frames = []
    for a in angles:
        move = cv2.getRotationMatrix2D(HUB, -math.degrees(a), 1.0)
        body = cv2.warpAffine(grain, move, (64, 58), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        frames.append(
            np.clip(90.0 + cover * (body - 90.0) + rng.normal(0, noise, cover.shape), 0, 255).astype(np.uint8)
        )
    return frames


def test_the_angles_of_a_small_film_are_those_drawn():
    """The candidate was found in the frames from the tenth on; a hub that is off by a pixel is refined."""
    first, off = 9, 1.0
    angles = 0.25 * np.arange(16) + 0.1 * np.sin(np.arange(16) / 4.0)
    film = Drawn(turning(angles))
    usable = np.delete(np.arange(16), 7)
    motion = Motion.of(list(film.frames()))
    ring = Ring.about((HUB[0] + off, HUB[1] - off), 3.0, 24.0, finest=24.0)
    best = module._Trial(ring, "edges", "low", True, angles, 0.9, False)
    told = []
    found = module._measure(film, usable, first, best, motion, lambda *given: told.append(given))
    np.testing.assert_array_equal(found.frame, usable)
    error = found.angle + angles[usable]  # counter-clockwise as seen
    assert np.std(error) < 4e-3
    assert np.abs(found.halves + angles[usable] - error.mean()).max() < 0.03
    assert found.ring.hub == pytest.approx(HUB, abs=0.15)
    assert found.explained > 0.85
    assert (found.way, found.ambiguous, found.distance_error) == ("edges", False, 0.0)
    assert told == [(k + 1, 15) for k in range(15)]
    assert found.warnings[0] == "1 of 16 frames repeat the previous frame and are omitted."


RING = Ring.about((30.0, 25.0), 4.0, 20.0, finest=12.0)
ARC = Ring.about((30.0, -25.0), 30.0, 70.0, finest=12.0, start=1.0, span=0.8)
USABLE = np.arange(5, 45)
RATES = {"low": 0.01, "middle": 0.02, "high": 0.03}


@dataclass
class Learnt:
    hub_sigma: float = 0.0

    def halves(self):
        return ("inner", "outer")


@dataclass
class Finished:
    given: tuple
    warnings: tuple = ("own",)
    ambiguous: bool = False
    asked: dict = field(default_factory=dict)


def measure(monkeypatch, *, first=0, ring=RING, way="edges", score=0.6, band="low", static=True, shares=None,
            share=0.7, alias=None, fell=False, moved=0.0, distance=0.0, progress=None):  # fmt: skip
    """Measure a film of blank pictures; each step is replaced and recorded. `shares`: explained by each band."""
    shares = {"low": 0.55, "middle": 0.5, "high": 0.45} if shares is None else shares
    asked = {"bands": [], "register": [], "learn": [], "steps": 0}

    def follow(polars, weight, fixed, ring, *, band):
        asked["bands"].append((band, bool(np.any(fixed)), len(polars), bool(weight.all())))
        return RATES[band] * np.arange(len(polars))

    def scored(polars, angle, allowed, ring, *, separate):
        if "settled" in asked:
            return share, None
        rate = abs(angle[-1] - angle[first]) / (len(angle) - 1 - first)
        return shares[min(RATES, key=lambda b: abs(RATES[b] - rate))], None

    def settle(polars, angle, allowed, ring, *, separate):
        asked["settled"] = angle.copy()
        return angle

    def register(polar, template, start):
        part = template if isinstance(template, str) else "whole"
        asked["register"].append(part)
        about = start + {"inner": 0.2, "outer": -0.3, "whole": 0.0}[part]
        return Pose(about, 1e-3, (0.0, 0.0), math.inf, 0.0, 1.0)

    def step(ring, pictures, angle, free, area, *, separate):
        asked["steps"] += 1
        return np.array([0.5, -0.25, 0.0, 0.0])[list(free)]

    def at_distance(ring, pictures, angle, area, *, separate):
        asked["distance"] = len(pictures)
        return ring, 1.5 * np.asarray(angle) + 0.1, distance

    def learned(polars, angle, allowed, ring, *, separate, plain=False, counted=None):
        asked["learn"].append((len(polars), plain, counted))
        return Learnt()

    def refuse(name):
        def refused(*given):
            raise RefusedFilmError(name, "", kind=name, evidence={})

        return refused

    fakes = {
        "follow": follow, "_score": scored, "_settle": settle, "register": register, "ring_step": step,
        "_at_distance_of_path": at_distance, "learn": learned,
        "unaliased": lambda angle, *_: SimpleNamespace(angle=angle, warning=alias),
        "without_slips": lambda polars, angle, *_: np.array(angle),
        "fallen": lambda before, now: asked.update(fallen=(before, now)) or fell,
        "drift": lambda *_, **__: asked.update(drift=1) or (moved, 1.0),
        "_refuse_fallen": refuse("fallen"), "_refuse_loose": refuse("loose"), "_refuse_translation": lambda *_: None,
        "_hub_motion": lambda *_: 0.37,
        "_finish": lambda *given: Finished(given),
    }  # fmt: skip
    for name, fake in fakes.items():
        monkeypatch.setattr(module, name, fake)
    frames = [np.full((50, 60), 100, np.uint8) for _ in range(50)]
    for k, frame in enumerate(frames):
        frame[:, :30] += np.uint8(k)  # one half changes
    film = Drawn(frames)
    blank = np.zeros((50, 60), np.float32)
    motion = Motion(blank, blank, 1.0, blank > 1, (0, 0, 60, 50))
    best = module._Trial(ring, way, band, static, np.zeros(9), score, False)
    found = module._measure(film, USABLE, first, best, motion, progress)
    names = ("film", "usable", "ring", "template", "parts", "poses", "halves", "best", "angle", "distance")
    return SimpleNamespace(**dict(zip(names, found.given, strict=True)), result=found, asked=asked)


def test_a_body_is_followed_forwards_and_backwards_from_the_first_frame_of_its_block(monkeypatch):
    found = measure(monkeypatch, first=12)
    np.testing.assert_allclose(found.asked["settled"], 0.01 * np.abs(np.arange(40) - 12))
    assert found.asked["bands"] == [("low", True, 28, True), ("low", True, 13, True)]
    assert len(measure(monkeypatch).asked["bands"]) == 1


def test_other_bands_are_tried_until_one_explains_nearly_as_much_as_the_candidate(monkeypatch):
    """By 85 % of 0.6, which is 0.51; the best one is used."""
    found = measure(monkeypatch, shares={"low": 0.50, "middle": 0.52, "high": 0.4})
    assert [b for b, *_ in found.asked["bands"]] == ["low", "high", "middle"]
    np.testing.assert_allclose(found.asked["settled"], 0.02 * np.arange(40))
    found = measure(
        monkeypatch, shares={"low": 0.45, "middle": 0.44, "high": 0.5}, band="middle", static=False
    )
    # the own band without the fixed picture; then all others
    order = [(b, fixed) for b, fixed, *_ in found.asked["bands"]]
    assert order == [
        ("middle", False),
        ("high", True),
        ("middle", True),
        ("low", True),
        ("high", False),
        ("low", False),
    ]
    np.testing.assert_allclose(found.asked["settled"], 0.03 * np.arange(40))
    # without the fixed picture, only samples that change have a weight
    assert [whole for *_, whole in found.asked["bands"]] == [False, True, True, True, False, False]


@pytest.mark.parametrize(
    ("share", "way", "tracked"), [(0.39, "edges", 0), (0.41, "edges", 1), (0.39, "given", 0)]
)
def test_a_motion_explains_two_fifths_of_the_film(monkeypatch, share, way, tracked):
    if tracked:
        assert measure(monkeypatch, share=share, way=way).best.score == share
        return
    with pytest.raises(
        TrackingError, match="through a part of the film only: tracking quality 39 %; 40 %"
    ) as error:
        measure(monkeypatch, share=share, way=way)
    assert ("Check --hub" in error.value.hint) == (way == "given")


def test_a_hub_that_explains_less_of_the_whole_film_is_refused_unless_it_is_given(monkeypatch):
    with pytest.raises(RefusedFilmError, match="fallen"):
        measure(monkeypatch, fell=True)
    assert measure(monkeypatch).asked["fallen"] == (0.6, 0.7)
    assert "fallen" not in measure(monkeypatch, fell=True, way="given").asked


@pytest.mark.parametrize(
    ("moved", "way", "alias", "doubts", "refused"),
    [
        (0.9, "edges", None, 0, False),
        (1.1, "edges", None, 1, False),
        (module.REFUSED - 0.1, "edges", None, 1, False),
        (module.REFUSED + 0.1, "edges", None, 0, True),
        (module.REFUSED + 0.1, "given", None, 0, False),
        (0.9, "edges", "alias", 1, False),
        (1.1, "edges", "alias", 2, False),
    ],
)
def test_a_hub_that_moves_or_another_rotation_is_a_doubt(monkeypatch, moved, way, alias, doubts, refused):
    if refused:
        with pytest.raises(RefusedFilmError, match="loose"):
            measure(monkeypatch, moved=moved, way=way, alias=alias)
        return
    found = measure(monkeypatch, moved=moved, way=way, alias=alias).result
    assert found.ambiguous == (doubts > 0)
    assert len(found.warnings) == 1 + (doubts > 0)
    assert found.warnings[0] == "own"
    assert ("alias" in found.warnings[-1]) == (alias is not None)
    if doubts == 2:
        assert len(found.warnings[-1]) > len("alias ")


def test_hub_and_angles_are_refined_twice_on_a_fine_ring(monkeypatch):
    found = measure(monkeypatch)
    assert found.asked["steps"] == 2
    assert found.ring.hub == pytest.approx((31.0, 24.5))
    assert found.ring.rows == Ring.about((30.0, 25.0), 4.0, 20.0, finest=200.0).rows
    assert found.template.hub_sigma == 0.37
    assert found.parts == ("inner", "outer")
    given = measure(monkeypatch, way="given")
    assert given.asked["steps"] == 0
    assert "drift" not in given.asked
    assert given.template.hub_sigma == 0.0


def test_all_frames_are_registered_in_both_halves(monkeypatch):
    told = []
    found = measure(monkeypatch, progress=lambda *given: told.append(given))
    assert told == [(k + 1, 40) for k in range(40)]
    np.testing.assert_array_equal(found.usable, USABLE)
    np.testing.assert_allclose([p.angle for p in found.poses], 0.01 * np.arange(40))
    # counter-clockwise as seen
    np.testing.assert_allclose(found.halves, -0.01 * np.arange(40) + np.array([[-0.2], [0.3]]))
    assert found.asked["register"].count("inner") == found.asked["register"].count("outer") == 40
    *_, last = found.asked["learn"]
    assert last[1] is False
    np.testing.assert_array_equal(last[2], 1.0)


@pytest.mark.parametrize(
    ("ring", "way", "moves"), [(ARC, "edges", True), (ARC, "given", False), (RING, "edges", False)]
)
def test_the_distance_of_a_hub_outside_the_picture_is_that_of_its_path(monkeypatch, ring, way, moves):
    found = measure(monkeypatch, ring=ring, way=way, distance=0.03)
    assert ("distance" in found.asked) == moves
    assert found.distance == (0.03 if moves else 0.0)
    expected = 0.01 * np.arange(40)
    np.testing.assert_allclose([p.angle for p in found.poses], 1.5 * expected + 0.1 if moves else expected)
    if moves:
        with pytest.raises(TrackingError, match="moves along a straight line"):
            measure(monkeypatch, ring=ring, distance=math.inf)


@pytest.mark.parametrize(("translated", "refused"), [(True, True), (False, False)])
def test_a_body_that_only_translates_is_refused(monkeypatch, translated, refused):
    asked = []
    monkeypatch.setattr(module, "translates", lambda *given: asked.append(given) or translated)
    block = StoredPictures.of(90, (np.full((4, 5), k, np.uint8) for k in range(90)))
    motion = SimpleNamespace(moving="moving")
    best = module._Trial(RING, "edges", "low", True, np.arange(90.0), 0.6, False)
    if refused:
        with pytest.raises(RefusedFilmError, match="does not turn") as error:
            module._refuse_translation("film", block, motion, best)
        assert [int(f[0, 0]) for f in error.value.frames] == [0, 29, 59, 89]
        assert (error.value.hub, error.value.evidence) == ((30.0, 25.0), {"explained": 0.6})
        assert error.value.kind == "no rotation"
    else:
        module._refuse_translation("film", block, motion, best)
    ((pictures, moving, hub, outer, angle),) = asked
    assert (moving, hub, outer, len(pictures), len(angle)) == ("moving", (30.0, 25.0), 20.0, 60, 60)
    assert [int(p[0, 0]) for p in pictures] == angle.tolist()


def test_rough_angles_settle_on_the_template_of_the_film():
    ring = Ring.about((20.0, 20.0), 4.0, 16.0, finest=48.0)
    rng = np.random.default_rng(0)
    body = cv2.GaussianBlur(rng.normal(0.0, 1.0, (ring.rows, 3 * ring.columns)), (0, 0), 2.0)
    body = (40.0 * body[:, ring.columns : 2 * ring.columns] / body.std()).astype(np.float32)
    true = 0.2 * np.arange(24)
    polars = StoredPictures.of(24, (100 + rolled(body, a / ring.step) for a in true))
    allowed = np.ones(body.shape, bool)
    rough = true + 0.06 * rng.standard_normal(24)
    found = module._settle(polars, rough, allowed, ring, separate=False)
    error = found - true
    assert error.std() < 0.3 * np.std(rough - true)


def test_a_candidate_is_refined_quickly_on_twelve_frames(monkeypatch):
    asked = {}

    def search(ring, angle, few, area, **options):
        asked.update(options, angle=angle.tolist(), frames=[int(f[0, 0]) for f in few], area=area)
        return ARC, angle + 9.0, 0.83

    monkeypatch.setattr(module, "_search", search)
    block = StoredPictures.of(45, (np.full((4, 5), k, np.uint8) for k in range(45)))
    trial = module._Trial(RING, "edges", "low", True, np.arange(45.0), 0.6, True)
    found = module._quickly_refined(trial, block, (0, 0, 5, 4), keep=True)
    assert (found.ring, found.score, found.way) == (ARC, 0.83, "edges")
    np.testing.assert_array_equal(found.angle, np.arange(45.0))  # the angles are not changed
    assert asked["frames"] == [4 * k for k in range(12)] == asked["angle"]
    assert (asked["separate"], asked["keep"], asked["steps"], asked["area"]) == (True, True, 3, (0, 0, 5, 4))


class TestCamera:
    SHAKE = SimpleNamespace(rms=2.0, roll=np.array([0.001, -0.001]), margin=lambda _: 3)

    def track(self, monkeypatch, *, shake=True, calmer=True, stabilised=None, hub=None):
        """Return the result and what was done; `stabilised` is raised if the film is compensated."""
        done = []
        shake = self.SHAKE if shake else None
        film = SimpleNamespace(
            some=lambda index: done.append(len(index)) or [np.zeros((4, 5), np.uint8)], frames=list,
            stabilise=lambda given: done.append(given), path=SimpleNamespace(name="film"),
        )  # fmt: skip

        def tracked(film, usable, sample, hub, progress, margin=0):
            done.append(("track", margin))
            if margin and stabilised is not None:
                raise stabilised
            return "tracked"

        monkeypatch.setattr(module, "frames_of_one_shot", lambda _: np.arange(200))
        monkeypatch.setattr(module, "camera_shake", lambda *_: shake)
        monkeypatch.setattr(module, "calmer", lambda *_: calmer)
        monkeypatch.setattr(module, "_track", tracked)
        monkeypatch.setattr(module, "_with_shake", lambda found, shake: (found, shake))
        return module.track_body(film, hub), done

    def test_a_camera_at_rest_is_not_compensated(self, monkeypatch):
        assert self.track(monkeypatch, shake=False) == ("tracked", [120, ("track", 0)])

    def test_a_moving_camera_is_compensated_if_the_picture_is_calmer(self, monkeypatch):
        found, done = self.track(monkeypatch)
        assert found == ("tracked", self.SHAKE)
        assert done == [120, self.SHAKE, 120, ("track", 3)]
        found, done = self.track(monkeypatch, calmer=False)
        assert found == "tracked"
        assert done == [120, self.SHAKE, 120, None, ("track", 0)]

    def test_a_body_that_was_mistaken_for_the_background_is_tracked(self, monkeypatch):
        nothing = module.NothingMovesError("", "", kind="no motion", evidence={})
        found, done = self.track(monkeypatch, stabilised=nothing)
        assert found == "tracked"
        assert done[-3:] == [("track", 3), None, ("track", 0)]

    @pytest.mark.parametrize(
        ("kind", "hub", "named"),
        [
            ("no rotation", None, "moving camera"),
            ("no rotation", (1.0, 2.0), "no rotation"),
            ("cut", None, "cut"),
        ],
    )
    def test_without_a_body_the_camera_is_named(self, monkeypatch, kind, hub, named):
        error = RefusedFilmError("what", "", kind=kind, evidence={"explained": 0.1}, hub=(7.0, 8.0))
        with pytest.raises(RefusedFilmError) as raised:
            self.track(monkeypatch, stabilised=error, hub=hub)
        assert raised.value.kind == named
        assert raised.value.hub == (7.0, 8.0)
        expected = {"explained": 0.1} | ({"shake_px": 2.0} if named == "moving camera" else {})
        assert raised.value.evidence == expected

    @pytest.mark.parametrize(("first", "second", "found"), [(1, 1, "body"), (0, 1, "free"), (0, 0, None)])
    def test_an_excerpt_shows_a_body_about_a_hub_or_a_free_one(self, monkeypatch, first, second, found):
        def tracker(name, works):
            def track(film, hub, progress):
                if not works:
                    raise TrackingError("what", "hint")
                return name, hub

            return track

        monkeypatch.setattr(module, "track_body", tracker("body", first))
        monkeypatch.setattr(module, "track_free_body", tracker("free", second))
        monkeypatch.setattr(module, "Film", lambda path, most: (path, most))
        result = module.read_excerpt("film.mp4", (1.0, 2.0))
        assert result == (None if found is None else (("film.mp4", 300), (found, (1.0, 2.0))))


BLANK = np.zeros((50, 60), np.float32)
MOTION = Motion(BLANK, BLANK, 1.0, BLANK < 1, (0, 0, 60, 50))


def _trial(score=0.6, hub=(30.0, 25.0), **change):
    given = {
        "way": "edges",
        "band": "low",
        "static": True,
        "angle": np.arange(9.0),
        "separate": False,
    } | change
    return module._Trial(ring=Ring.about(hub, 4.0, 20.0, finest=12.0), score=score, **given)


class TestSearch:
    """The order of a search, with replaced steps: which frames and candidates are used."""

    def track(self, monkeypatch, count=40, *, hub=None, margin=0, small=None, loose=True, candidates=None, refined=None,
              share=0.0, second=None, moved=0.0, steadiness=None, body=None):  # fmt: skip
        asked = {"camera": [], "candidates": [], "refined": []}
        chosen = [_trial()] if candidates is None else candidates
        steadiness = {} if steadiness is None else steadiness
        found = SimpleNamespace(
            warnings=("own",), ambiguous=False, explained=0.9, ring=RING, correlated=0.0, sigma=np.ones(9),
            angle=np.arange(9.0),
        )  # fmt: skip

        def searched(block, motion, hub, share=1.0):
            asked["candidates"].append((len(block), int(block[0][0, 0]), hub, share))
            return module._Candidates(chosen, chosen[0] if chosen else None, 0.4)

        def refine(trial, block, area, *, keep):
            asked["refined"].append(keep)
            return trial if refined is None else replace(trial, score=refined[trial.way])

        def refuse(film, pairs, block, motion, best, where, hint, needed):
            asked["refused"] = (best and best.way, needed, where)
            raise TrackingError("refused")

        fakes = {
            "pairs_of": lambda *_: [],
            "refuse_moving_camera": lambda film, usable, pairs, shape, *least: asked["camera"].append(least),
            "may_be_loose": lambda *_: loose, "track_by_features": lambda *_: asked.update(features=1) or body,
            "_candidates": searched, "_refined_trial": refine, "_refuse": refuse,
            "_steadiness": lambda t: steadiness.get(t.way, 1.0),
            "_refuse_translation": lambda *_: None, "refuse_link": lambda *given: asked.update(link=given[-1]),
            "_second_body": lambda *_: None,
            "second_rotation": lambda *_, **__: second,
            "drift": lambda *_, **__: (moved, 1.0),
            "_refuse_loose": refuse_loose,
            "elsewhere": lambda *_: share,
            "_measure": lambda film, usable, first, best, *_: asked.update(measured=(first, best.way)) or found,
            "hub_doubt": lambda *_: None, "halves_differ": lambda *_: None, "rival_hub": lambda *_: None,
            "_doubt_of_hub": lambda *_: None,
        }  # fmt: skip
        for name, fake in fakes.items():
            monkeypatch.setattr(module, name, fake)
        monkeypatch.setattr(module, "replace", lambda old, **new: type(old)(**{**vars(old), **new}))
        monkeypatch.setattr(module.Motion, "of", lambda sample, margin: asked.update(margin=margin) or MOTION)
        monkeypatch.setattr(module._Reduced, "of", lambda *_: small)
        film = Drawn([np.full((2, 2), k % 256, np.uint8) for k in range(count)])
        return module._track(film, np.arange(count), [BLANK], hub, None, margin), asked

    @pytest.mark.parametrize(("count", "first"), [(60, 0), (61, 0), (310, 10), (340, 34), (700, 70)])
    def test_the_search_begins_after_a_tenth_of_a_film(self, monkeypatch, count, first):
        """Later frames are not searched, but the block has 300 frames if the film has."""
        _, asked = self.track(monkeypatch, count)
        assert asked["candidates"] == [(min(count, 300), first, None, 1.0)]
        assert asked["measured"] == (first, "edges")

    @pytest.mark.parametrize(("hub", "margin", "checks"), [(None, 0, 2), ((3.0, 4.0), 0, 0), (None, 5, 0)])
    def test_a_moving_camera_is_refused_unless_it_is_compensated_or_a_hub_is_given(
        self, monkeypatch, hub, margin, checks
    ):
        _, asked = self.track(monkeypatch, hub=hub, margin=margin)
        assert asked["camera"] == [(module.MOSTLY_TRANSLATES,), ()][:checks]
        assert asked["margin"] == margin
        assert asked["candidates"][0][2] == hub
        assert asked["refined"] == [hub is not None]
        assert ("link" in asked) == (hub is None)

    def test_features_are_followed_if_reduced_frames_suggest_it(self, monkeypatch):
        small = SimpleNamespace(
            frames=[np.full((2, 2), k, np.uint8) for k in range(40)], motion="small",
            reduced=lambda hub: ("r", *hub), seen=lambda t: t,
        )  # fmt: skip
        assert "features" in self.track(monkeypatch)[1]
        assert "features" in self.track(monkeypatch, small=small)[1]
        _, asked = self.track(monkeypatch, small=small, loose=False, hub=(3.0, 4.0))
        assert "features" not in asked
        # reduced frames are searched first, with a smaller share
        assert [given[2:] for given in asked["candidates"]] == [(("r", 3.0, 4.0), 0.75), ((3.0, 4.0), 1.0)]
        with pytest.raises(TrackingError, match="refused"):
            self.track(monkeypatch, small=small, candidates=[])

    def test_the_best_candidate_is_steady(self, monkeypatch):
        """0.6 x 1.0 is more than 0.9 x 0.5."""
        two = [_trial(way="jumps"), _trial(way="steady")]
        _, asked = self.track(
            monkeypatch, candidates=two, refined={"jumps": 0.9, "steady": 0.6}, steadiness={"jumps": 0.5}
        )
        assert asked["measured"][1] == "steady"
        _, asked = self.track(
            monkeypatch, candidates=two, refined={"jumps": 0.9, "steady": 0.44}, steadiness={"jumps": 0.5}
        )
        assert asked["measured"][1] == "jumps"

    @pytest.mark.parametrize(("score", "tracked"), [(0.39, False), (0.41, True)])
    def test_a_refined_candidate_explains_two_fifths(self, monkeypatch, score, tracked):
        if tracked:
            assert "measured" in self.track(monkeypatch, refined={"edges": score})[1]
        else:
            with pytest.raises(TrackingError, match="refused"):
                self.track(monkeypatch, refined={"edges": score})

    @pytest.mark.parametrize(
        ("share", "hub", "warnings", "doubt"),
        [
            (0.19, None, 1, False),
            (0.21, None, 2, False),
            (0.54, None, 2, False),
            (0.56, None, 2, True),
            (0.56, (3.0, 4.0), 2, False),
        ],
    )
    def test_other_parts_that_move_are_stated_or_doubted(self, monkeypatch, share, hub, warnings, doubt):
        found, _ = self.track(monkeypatch, share=share, hub=hub)
        assert (len(found.warnings), found.ambiguous) == (warnings, doubt)
        if warnings == 2:
            assert f"{100 * share:.0f} % as many pixels" in found.warnings[-1 if doubt else 0]

    def test_a_second_rotation_about_the_hub_is_a_doubt(self, monkeypatch):
        second = SimpleNamespace(warning=lambda angle: f"second {len(angle)}")
        found, _ = self.track(monkeypatch, second=second)
        assert (found.warnings, found.ambiguous) == (("own", "second 9"), True)

    @pytest.mark.parametrize(
        ("moved", "hub", "outcome"),
        [
            (0.9, None, "sure"),
            (1.1, None, "doubt"),
            (module.REFUSED + 0.1, None, "refused"),
            (9.0, (3.0, 4.0), "sure"),
        ],
    )
    def test_a_hub_that_moves_far_is_refused(self, monkeypatch, moved, hub, outcome):
        if outcome == "refused":
            with pytest.raises(RefusedFilmError, match="loose"):
                self.track(monkeypatch, moved=moved, hub=hub)
        else:
            assert self.track(monkeypatch, moved=moved, hub=hub)[0].ambiguous == (outcome == "doubt")


def refuse_loose(*given):
    raise RefusedFilmError("loose", "", kind="no rotation", evidence={})


class TestRefusals:
    BLOCK = StoredPictures.of(61, (np.full((4, 5), k, np.uint8) for k in range(61)))

    @pytest.mark.parametrize(
        ("best", "blurred"), [(_trial(0.3), True), (replace(_trial(0.3), ring=ARC), False), (None, False)]
    )
    def test_a_film_without_a_rotation_is_examined_for_two_bodies_and_blur(self, monkeypatch, best, blurred):
        asked = []
        monkeypatch.setattr(module, "refuse_two_motions", lambda *given: asked.append(("two", len(given[2]))))
        monkeypatch.setattr(
            module, "refuse_blurred", lambda *given: asked.append(("blurred", len(given[1]), given[3]))
        )
        with pytest.raises(RefusedFilmError) as error:
            module._refuse(Drawn([]), [], self.BLOCK, MOTION, best, "about a hub", "hint", 0.4)
        assert asked == [("two", 4)] + ([("blurred", 31, 1.0)] if blurred else [])
        assert error.value.evidence == {"explained": 0.3 if best else 0.0, "needed": 0.4}
        assert [int(f[0, 0]) for f in error.value.frames] == [0, 20, 40, 60]
        assert error.value.hub == (best.ring.hub if best else None)
        assert ("explains 30 %" in error.value.message) == (best is not None)

    def test_a_loose_and_a_fallen_body_are_refused_with_their_numbers(self):
        with pytest.raises(RefusedFilmError, match=r"moves by 7\.2 px; at most 2\.4 px") as error:
            module._refuse_loose("film", self.BLOCK, _trial(0.7), 7.2, 2.4)
        assert error.value.evidence == {"explained": 0.7, "hub_moves_px": 7.2}
        film = Drawn([np.full((4, 5), k, np.uint8) for k in range(70)])
        with pytest.raises(RefusedFilmError, match=r"explains 70 % .*, and 20 % in the whole film") as error:
            module._refuse_fallen(film, np.arange(61) + 5, _trial(0.7), 0.2)
        assert error.value.evidence == {"explained": 0.7, "in_film": 0.2}
        assert [int(f[0, 0]) for f in error.value.frames] == [5, 25, 45, 65]

    @pytest.mark.parametrize(
        ("given", "near", "found", "away", "doubted"),
        [
            # the unexplained share must be halved, at a twentieth of the outer radius of 20 px and beyond
            (0.85, None, 0.93, 2.0, True),
            (0.85, None, 0.92, 2.0, False),
            (0.85, None, 0.93, 1.1, True),
            (0.85, None, 0.93, 0.9, False),
            # a candidate of the film is refined as well if the given hub explains little
            (0.79, 9.0, 0.95, 9.0, True),
            (0.81, 9.0, 0.95, 9.0, False),
            (0.79, 11.0, 0.95, 11.0, False),
        ],
    )
    def test_a_given_hub_is_doubted_if_another_explains_much_more(
        self, monkeypatch, given, near, found, away, doubted
    ):
        def refined(trial, block, area, *, keep):
            assert not keep
            better = near is None or trial.way == "near"
            ring = Ring.about((30.0 + away if better else 30.0, 25.0), 4.0, 20.0, finest=12.0)
            return replace(trial, ring=ring, score=found if better else given)

        proposals = [] if near is None else [SimpleNamespace(hub=(30.0 + near, 25.0))]
        monkeypatch.setattr(module, "propose_hubs", lambda *_: proposals)
        monkeypatch.setattr(
            module, "_trials", lambda p, *_: [_trial(0.3, way="weak"), _trial(0.5, p.hub, way="near")]
        )
        monkeypatch.setattr(module, "_refined_trial", refined)
        text = module._doubt_of_hub(_trial(given, way="given"), _trial(given, way="given"), None, MOTION)
        assert (text is not None) is doubted
        if doubted:
            assert f"({30 + away:.0f}, 25) px, {away:.0f} px from" in text
            assert f"{100 * found:.0f} %" in text

    def test_pixels_elsewhere_are_counted_relative_to_those_in_the_ring(self):
        ring = Ring.about((30.0, 25.0), 4.0, 10.0)
        y, x = np.mgrid[0:50, 0:60]
        away = np.hypot(x - 30.0, y - 25.0)
        inside, outside = away <= 11.0, away > 11.0  # 1.1 radii
        moving = inside | (outside & (x > 50))
        np.testing.assert_array_equal(module._outside(moving, ring), outside & (x > 50))
        assert module.elsewhere(moving, ring) == pytest.approx((outside & (x > 50)).sum() / inside.sum())
        assert module.elsewhere(outside & (x > 50), ring) == (outside & (x > 50)).sum()


class TestReduced:
    @pytest.mark.parametrize(
        ("width", "moving", "factor"),
        [
            (639, 10**6, None),
            (640, 4000, 2),
            (640, 3999, None),
            (959, 4000, 2),
            (960, 9000, 3),
            (960, 8999, None),
        ],
    )
    def test_large_pictures_with_a_large_moving_area_are_reduced(self, monkeypatch, width, moving, factor):
        asked = []
        blank = np.zeros((8, width), np.float32)
        motion = SimpleNamespace(mean=blank, moving=np.ones(moving, bool))
        monkeypatch.setattr(
            module, "reduced", lambda f, n: asked.append(n) or np.full((2, 2), f[0, 0], np.uint8)
        )
        monkeypatch.setattr(module.Motion, "of", lambda few, margin: (len(few), margin))
        film = Drawn([np.full((2, 2), k, np.uint8) for k in range(12)])
        found = module._Reduced.of(film, np.array([2, 3, 7]), list(film.frames())[:4], motion, 5)
        if factor is None:
            assert found is None
            return
        assert (found.factor, set(asked)) == (factor, {factor})
        assert [int(f[0, 0]) for f in found.frames] == [2, 3, 7]
        assert found.motion == (4, -(-5 // factor))

    def test_places_and_rings_are_those_of_the_full_frames(self):
        """The pixel 0 of reduced frames is the mean of the pixels 0, 1 and 2: its middle is at 1."""
        small = module._Reduced(3, None, None)
        assert small.reduced((1.0, 4.0)) == pytest.approx((0.0, 1.0))
        seen = small.seen(_trial(hub=(0.0, 1.0)))
        assert seen.ring.hub == pytest.approx((1.0, 4.0))
        assert (seen.ring.inner, seen.ring.outer, seen.ring.span) == (12.0, 60.0, TURN)
        assert small.seen(None) is None
        arc = small.seen(replace(_trial(), ring=ARC)).ring
        assert (arc.start, arc.span, arc.stretch) == (ARC.start, ARC.span, ARC.stretch)


class Explained:
    """A ring that explains less with the square of its distance from (33, 25), and leaves the picture beyond `edge`."""

    span, step, area = TURN, 0.1, np.ones((2, 50))

    def __init__(self, place=(30.0, 25.0, 0.0, 0.0), edge=math.inf):
        self.place, self.edge = np.asarray(place, dtype=float), edge
        self.hub, self.stretch = tuple(self.place[:2]), tuple(self.place[2:])

    def inside(self, area):
        found = np.ones((2, 50), bool)
        if self.hub[0] > self.edge:
            found[:, :16] = False  # 68 % are left
        return found

    def unwrap(self, frame):
        # of frames of +-1 and the mean m, 1 - sum p^2 / sum (p - mean)^2 is -m^2
        return np.float32(frame) + np.float32(np.hypot(self.hub[0] - 33.0, self.hub[1] - 25.0)) * np.ones(
            (2, 50), np.float32
        )


def _searched(monkeypatch, steps, *, edge=math.inf, keep=False, rounds=1, turned=2.0):
    asked = []
    given = iter(steps)

    def step(ring, few, angles, free, area, *, separate):
        asked.append(list(free))
        return np.array(next(given))[: len(free)]

    monkeypatch.setattr(module, "_placed", lambda ring, place: Explained(place, edge))
    monkeypatch.setattr(module, "learn", lambda *_, **__: SimpleNamespace(fixed=0.0, body=None))
    monkeypatch.setattr(module, "rolled", lambda *_: np.zeros((2, 50), np.float32))
    monkeypatch.setattr(module, "register", lambda polar, template, start: SimpleNamespace(angle=start + 0.1))
    monkeypatch.setattr(module, "ring_step", step)
    frames = [np.ones((2, 50), np.float32), -np.ones((2, 50), np.float32)]
    found = module._search(
        Explained(edge=edge),
        np.array([0.0, turned]),
        frames,
        (0, 0, 9, 9),
        separate=False,
        keep=keep,
        steps=rounds,
    )
    return found, asked


@pytest.mark.parametrize(
    ("steps", "rounds", "edge", "x"),
    [
        ([(1.0, 0.0)], 1, math.inf, 32.89),  # lengthened twice, by 1.7
        ([(1.0, 0.0)] * 2, 2, math.inf, 32.98),  # then shortened twice, by 0.3
        ([(1.0, 0.0)], 1, 32.0, 31.7),  # a longer step leaves the picture
        ([(-1.0, 0.0)], 1, math.inf, 30.0),  # no step of a fifth or more improves the fit
        ([(7.0, 0.0)], 1, math.inf, 33.57),  # 7 px are too far, 2.1 px and then 3.57 px are not
    ],
)
def test_steps_of_a_search_are_lengthened_while_the_fit_improves(monkeypatch, steps, rounds, edge, x):
    (ring, angles, share), asked = _searched(monkeypatch, steps, edge=edge, rounds=rounds)
    assert ring.hub == pytest.approx((x, 25.0))
    assert share == pytest.approx(-((x - 33.0) ** 2), abs=1e-5)
    assert asked == [[0, 1]] * rounds
    # each accepted trial registers the frames twice
    assert angles[0] == pytest.approx(0.2 * round(angles[0] / 0.2))


@pytest.mark.parametrize(("gain", "rounds"), [(0.9e-4, 1), (1.1e-4, 2)])
def test_a_search_ends_when_a_step_improves_little(monkeypatch, gain, rounds):
    """A step of x improves the fit by 6 x, from a distance of 3 px; longer ones are beyond the edge."""
    step = gain / 6.0
    _, asked = _searched(monkeypatch, [(step, 0.0)] * 2, edge=30.0 + 1.5 * step, rounds=2)
    assert len(asked) == rounds


def test_a_given_hub_and_a_short_motion_leave_nothing_to_search(monkeypatch):
    (ring, angles, _), asked = _searched(monkeypatch, [], keep=True, rounds=3)
    assert (ring.hub, asked) == ((30.0, 25.0), [])
    assert angles == pytest.approx([0.2, 2.2])
    # over a longer motion, the stretch is searched
    _, asked = _searched(monkeypatch, [(0.0, 0.0)], keep=True, rounds=1, turned=3.1)
    assert asked == [[2, 3]]
