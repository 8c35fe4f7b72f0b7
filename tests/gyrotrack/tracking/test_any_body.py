"""A body on an axle: its hub and rival hubs, a moving camera, other moving parts, and cheap evidence against a film."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from gyrotrack._column_store import StoredPictures
from gyrotrack.tracking import _any_body, _hub_search, _moving_hub, _point_tracker
from gyrotrack.tracking._any_body import calmer, elsewhere, rival_hub
from gyrotrack.tracking._coaxial import SecondRotation
from gyrotrack.tracking._diagnosis import MOSTLY_TRANSLATES
from gyrotrack.tracking._film import reduced
from gyrotrack.tracking._fixed_hub import drift, fallen, halves_differ, hub_doubt
from gyrotrack.tracking._hub_search import Motion, Proposal, similarity_hubs
from gyrotrack.tracking._moving_hub import Path, may_be_loose
from gyrotrack.tracking._registration import Ring, every
from gyrotrack.tracking._silhouettes import Spot, median_picture
from gyrotrack.tracking._tracked import apart_beyond_harmonics

SIZE, HUB = 112, np.array([55.0, 55.0])
ANGLE = np.linspace(0.0, 9.0, 24)
RING = Ring.about((55.0, 55.0), 6.0, 42.0, finest=48.0)


def _frames(wobble):
    """A textured disc whose hub moves by `wobble` [px] along x and y."""
    rng = np.random.default_rng(2)
    smooth = cv2.GaussianBlur(rng.normal(size=(SIZE, SIZE)), (0, 0), 3.0)
    texture = 120.0 + 40.0 * smooth / smooth.std()
    frames = []
    for k, angle in enumerate(ANGLE):
        move = cv2.getRotationMatrix2D(HUB.tolist(), -np.degrees(angle), 1.0)
        move[:, 2] += wobble * np.array([np.sin(1.3 * k), np.cos(2.1 * k)])
        frame = cv2.warpAffine(texture, move, (SIZE, SIZE), borderMode=cv2.BORDER_REFLECT)
        frames.append(np.clip(frame + rng.normal(0, 1.0, frame.shape), 0, 255).astype(np.uint8))
    return frames


@pytest.mark.parametrize(("wobble", "moves"), [(0.0, False), (1.0, False), (5.0, True)])
def test_a_hub_that_wobbles_by_a_pixel_is_on_an_axle(wobble, moves):
    """The limit is 2.3 px; the displacement is up to 1.41 times the amplitude along each axis."""
    found, limit = drift(RING, _frames(wobble), ANGLE, (0, 0, SIZE, SIZE), separate=False)
    assert limit == pytest.approx(2.3)
    assert (found > limit) == moves
    assert 0.9 * wobble < found < 1.41 * wobble + 0.2


def test_a_larger_ring_allows_a_larger_displacement():
    large = Ring.about((160.0, 160.0), 100.0, 300.0, finest=48.0)
    frames = [np.random.default_rng(0).integers(0, 255, (320, 320)).astype(np.uint8)] * 4
    assert drift(large, frames, np.zeros(4), (0, 0, 320, 320), separate=False)[1] == pytest.approx(3.0)


@pytest.mark.slow
def test_the_middle_of_a_body_far_from_its_hub_counts():
    """A round bob on an arc may turn about itself: the angle of a small bob is not precise, its place is."""
    hub = (80.0, -160.0)
    turns = 0.12 * np.sin(np.linspace(0.0, 9.0, 24))
    rng = np.random.default_rng(1)
    v, u = np.mgrid[0:100, 0:160]

    def frame(angle, radius):
        x, y = hub[0] - radius * np.sin(angle), hub[1] + radius * np.cos(angle)
        disc = np.clip(10.5 - np.hypot(u - x, v - y), 0.0, 1.0)
        return np.clip(60.0 + 140.0 * disc + rng.normal(0, 2.0, u.shape), 0, 255).astype(np.uint8)

    arc = Ring.about(hub, 190.0, 230.0, finest=48.0, start=0.5 * np.pi - 0.3, span=0.6)
    steady = [frame(a, 210.0) for a in turns]
    moving = [frame(a, 210.0 + 6.0 * np.sin(1.7 * k)) for k, a in enumerate(turns)]
    found = [drift(arc, f, turns, (0, 0, 160, 100), separate=False) for f in (steady, moving)]
    assert found[0][0] < 0.5
    assert found[1][0] > found[1][1]


def test_a_compensation_that_does_not_calm_the_picture_is_discarded():
    rng = np.random.default_rng(0)
    picture = cv2.GaussianBlur(rng.integers(0, 255, (60, 80)).astype(np.float32), (0, 0), 2.0)
    still = [picture.astype(np.uint8)] * 3
    moved = [np.roll(picture, k, axis=1).astype(np.uint8) for k in (0, 2, 4)]
    assert calmer(moved, still, 5)
    assert not calmer(still, moved, 5)
    assert not calmer(moved, still, 30)  # nothing is left of the picture


@pytest.mark.parametrize(("share", "refused"), [(0.15, False), (0.25, True)])
def test_a_second_link_moves_outside_of_the_ring(share, refused, monkeypatch):
    """Below 20 % of the pixels of the ring, what moves elsewhere is no second link, whatever its silhouette."""
    monkeypatch.setattr(_any_body, "elsewhere", lambda *_: share)
    monkeypatch.setattr(_any_body, "carries_a_link", lambda *_: True)
    frames = _any_body.StoredPictures.of(24, iter(_frames(0.0)))
    trial = _any_body._Trial(RING, "features", "low", True, ANGLE, 0.9, False)
    motion = _any_body.Motion.of(_frames(0.0))
    if refused:
        with pytest.raises(_any_body.RefusedFilmError, match="Two linked bodies turn") as error:
            _any_body.refuse_link("film", frames, motion, trial)
        assert "extract --links" in error.value.hint
    else:
        _any_body.refuse_link("film", frames, motion, trial)


@pytest.mark.parametrize(("share", "told"), [(0.015, False), (0.025, True)])
def test_both_halves_of_a_rigid_body_turn_alike(share, told):
    """The limit is 2 % of the standard deviation of the angle."""
    angle = 0.4 * np.sin(np.linspace(0.0, 40.0, 400))
    assert (halves_differ(angle, share * float(np.std(angle))) is not None) == told


@pytest.mark.parametrize(
    ("swing", "turns", "error"), [(8e-3, 5.0, 2.8e-3), (5e-3, 5.0, None), (8e-3, 2.9, None)]
)
def test_a_relative_oscillation_of_the_halves_is_seen_over_many_turns(swing, turns, error):
    """The limit is 5 standard uncertainties of the angle, here 1 mrad; harmonics and a trend are of the view."""
    time = np.linspace(0.0, 1.0, 400)
    angle = 2 * np.pi * turns * time
    apart = swing * np.sin(40.0 * time + 1.0) + 0.02 * np.sin(angle) + 0.01 * np.cos(2 * angle) + 0.03 * time
    noise = np.random.default_rng(0).normal(0, 1e-3, 400)
    found = apart_beyond_harmonics(angle, np.stack([apart + noise, np.zeros(400)]), np.arange(400), 1e-3)
    assert found == (None if error is None else pytest.approx(error, rel=0.1))


@pytest.mark.parametrize(("film", "refused"), [(0.71, False), (0.69, True)])
def test_a_rotation_that_explains_a_part_of_the_film_falls_by_a_fifth(film, refused):
    """A pole on a cart falls by 0.23."""
    assert fallen(0.9, film) == refused


TRIAL = SimpleNamespace(ring=Ring.about((20.0, 30.0), 5.0, 15.0), score=0.9)


@pytest.mark.parametrize(("share", "words"), [(0.69, "69 %"), (-0.2, "0 %")])
def test_a_rotation_that_explains_a_part_of_the_film_only_is_refused_with_both_shares(share, words):
    film = SimpleNamespace(path=SimpleNamespace(name="film"), some=lambda index: index.tolist())
    with pytest.raises(_any_body.RefusedFilmError, match=rf"explains 90 % .* {words} in the whole") as error:
        _any_body._refuse_fallen(film, 10 * np.arange(9), TRIAL, share)
    assert "--from and --to" in error.value.hint
    assert "about (20, 30) px" in str(error.value)
    assert error.value.evidence == {"explained": 0.9, "in_film": share}
    assert error.value.frames == (0, 20, 50, 80)
    assert (error.value.kind, error.value.hub) == ("no rotation", (20.0, 30.0))


def test_a_hub_that_moves_is_refused_with_its_displacement():
    with pytest.raises(_any_body.RefusedFilmError, match=r"moves by 3\.1 px; at most 1\.4 px") as error:
        _any_body._refuse_loose("film", list(range(10)), TRIAL, 3.1, 1.4)
    assert error.value.evidence == {"explained": 0.9, "hub_moves_px": 3.1}
    assert error.value.frames == (0, 3, 6, 9)
    assert error.value.hub == (20.0, 30.0)


@pytest.mark.parametrize(("span", "blurred"), [(2 * np.pi, True), (6.2, False), (None, False)])
def test_a_film_without_a_rotation_is_refused_with_the_best_candidate(monkeypatch, span, blurred):
    """Only of a whole ring blurred pictures are the reason."""
    asked = []
    monkeypatch.setattr(_any_body, "refuse_two_motions", lambda *given: asked.append(("motions", given[2])))
    monkeypatch.setattr(_any_body, "refuse_blurred", lambda film, block, *_: asked.append(("blurred", block)))
    best = span and SimpleNamespace(ring=SimpleNamespace(span=span, hub=(20.0, 30.0)), score=0.123)
    film, block = SimpleNamespace(path=SimpleNamespace(name="film")), list(range(65))
    with pytest.raises(_any_body.RefusedFilmError, match="No body that turns about it") as error:
        _any_body._refuse(film, (), block, SimpleNamespace(noise=1.0), best, "about it", "a hint", 0.4)
    some = (0, 21, 42, 64)
    assert asked == [("motions", some), *([("blurred", block[::2])] if blurred else [])]
    assert (
        "the best candidate explains 12 % of the change of brightness; 40 % are required" in str(error.value)
    ) is (best is not None)
    assert error.value.evidence == {"explained": 0.123 if best else 0.0, "needed": 0.4}
    assert (error.value.frames, error.value.hint) == (some, "a hint")
    assert error.value.hub == ((20.0, 30.0) if best else None)


@pytest.mark.parametrize(("film", "told"), [(0.69, False), (0.67, True), (0.95, False)])
def test_rotation_about_one_hub_explains_the_whole_film_as_its_first_frames(film, told):
    """The limit is a fall by 0.15; a pole on a cart falls from 0.83 to 0.60."""
    text = hub_doubt(0.83, film)
    assert (text is not None) == told
    assert text is None or f"{100 * film:.0f} % in the whole film" in text


@pytest.mark.parametrize(("share", "doubted"), [(0.5, False), (0.6, True)])
def test_motion_outside_of_the_ring_is_doubted_from_55_percent_of_its_pixels(share, doubted, monkeypatch):
    """Below it, a warning alone; real single bodies have up to 0.47, double pendulums 0.64 and more."""
    tracked = _tracked_with(share, monkeypatch)
    assert tracked.ambiguous == doubted
    assert "Other parts of the picture move as well" in tracked.warnings[-1 if doubted else 0]


@pytest.mark.parametrize(("moved", "refused"), [(1.9, False), (2.1, True)])
def test_a_hub_that_moves_by_twice_the_limit_is_refused(moved, refused, monkeypatch):
    """Between the limit and twice the limit, it is doubted."""
    monkeypatch.setattr(_any_body, "drift", lambda *_, **__: (moved, 1.0))
    if refused:
        with pytest.raises(_any_body.RefusedFilmError, match=r"moves by 2\.1 px; at most 1\.0 px"):
            _tracked_with(0.0, monkeypatch)
    else:
        assert "The hub moves by 1.9 px" in _tracked_with(0.0, monkeypatch).warnings[-1]


def test_a_second_body_on_the_hub_makes_the_answer_ambiguous(monkeypatch):
    second = SecondRotation(2.0 * ANGLE, 0.5, 0.1)
    tracked = _tracked_with(0.0, monkeypatch, second)
    assert tracked.ambiguous
    assert tracked.warnings[-1] == second.warning(ANGLE)
    assert not _tracked_with(0.0, monkeypatch).ambiguous


def _tracked_with(share, monkeypatch, second=None):
    """Track with a given share of motion outside of the ring; all slow steps are replaced by constants."""
    frames = _any_body.StoredPictures.of(24, iter(_frames(0.0)))
    trial = _any_body._Trial(RING, "features", "low", True, ANGLE, 0.9, False)
    found = SimpleNamespace(
        warnings=(), ambiguous=False, explained=0.9, ring=RING, correlated=0.0, sigma=np.ones(24), angle=ANGLE
    )
    given = {
        "pairs_of": [],
        "refuse_moving_camera": None,
        "track_by_features": None,
        "_candidates": _any_body._Candidates([trial], trial, 0.4),
        "_refined_trial": trial,
        "_refuse_translation": None,
        "refuse_link": None,
        "_second_body": None,
        "second_rotation": second,
        "_measure": found,
        "elsewhere": share,
    }
    for name, value in given.items():
        monkeypatch.setattr(_any_body, name, lambda *_, value=value, **__: value)
    monkeypatch.setattr(_any_body, "replace", lambda old, **new: SimpleNamespace(**{**vars(old), **new}))
    film = SimpleNamespace(path=SimpleNamespace(name="film"), some=lambda index: frames)
    return _any_body._track(film, np.arange(24), frames, None, None)


class CameraError(Exception):
    """Raised by the test of the camera."""


class SearchedError(Exception):
    """Raised by the search for a hub."""


def raises(error):
    def given(*_, **__):
        raise error

    return given


@pytest.mark.parametrize(
    ("hub", "margin", "error"),
    [(None, 0, CameraError), (None, 3, SearchedError), ((5.0, 5.0), 0, SearchedError)],
)
def test_the_camera_is_tested_without_hub_or_compensation(hub, margin, error, monkeypatch):
    track(monkeypatch, loose=None)
    with pytest.raises(error):
        _any_body._track(FILM, np.arange(30), [], hub, None, margin=margin)


def test_a_body_without_an_axle_is_found_before_a_picture_that_turns_about_no_hub_is_refused(monkeypatch):
    """Before, a camera is refused only if the picture mostly translates."""
    found, limits = SimpleNamespace(), []
    track(monkeypatch, loose=found)
    monkeypatch.setattr(_any_body, "refuse_moving_camera", lambda *words: limits.append(words[4:]))
    assert _any_body._track(FILM, np.arange(30), [], None, None) is found
    assert limits == [(MOSTLY_TRANSLATES,)]


FILM = SimpleNamespace(some=lambda frames: [], path=SimpleNamespace(name="film"))


def track(monkeypatch, loose):
    motion = SimpleNamespace(moving=np.ones((4, 4)), mean=np.zeros((4, 4)))
    monkeypatch.setattr(_any_body.Motion, "of", lambda *_: motion)
    monkeypatch.setattr(_any_body, "pairs_of", lambda *_: [])
    monkeypatch.setattr(_any_body, "track_by_features", lambda *_: loose)
    monkeypatch.setattr(_any_body, "refuse_moving_camera", raises(CameraError))
    for name in ("propose_hubs", "_trials"):
        monkeypatch.setattr(_any_body, name, raises(SearchedError))


def test_pixels_that_change_outside_of_the_ring_are_counted():
    moving = np.zeros((100, 200), dtype=bool)
    moving[40:60, 40:60] = True  # 400 px about the hub
    moving[40:50, 150:160] = True
    assert elsewhere(moving, Ring.about((50.0, 50.0), 3.0, 20.0, finest=48.0)) == pytest.approx(0.25)


@pytest.mark.parametrize(("width", "linked"), [(3, True), (14, False)])
def test_two_parts_are_linked_by_a_thin_rod_only(width, linked):
    """Two maxima of the width of one large region are no double pendulum."""
    region = np.zeros((60, 120), dtype=np.uint8)
    cv2.circle(region, (30, 30), 12, 1, -1)
    cv2.circle(region, (90, 30), 12, 1, -1)
    cv2.line(region, (30, 30), (90, 30), 1, width)
    spots = [Spot((x, 30.0), 12.0, np.ones((1, 1), np.uint8)) for x in (30.0, 90.0)]
    assert _point_tracker._linked(region, *spots) == linked


def test_two_parts_that_touch_nowhere_are_not_linked():
    region = np.zeros((60, 120), dtype=np.uint8)
    for x in (30, 90):
        cv2.circle(region, (x, 30), 12, 1, -1)
    spots = [Spot((x, 30.0), 12.0, np.ones((1, 1), np.uint8)) for x in (30.0, 90.0)]
    assert not _point_tracker._linked(region, *spots)


def test_a_hub_is_proposed_from_fewer_frames_than_the_longest_distance_of_two():
    rng = np.random.default_rng(0)
    picture = cv2.GaussianBlur(rng.integers(0, 255, (80, 80)).astype(np.float32), (0, 0), 1.5)
    picture = cv2.normalize(picture, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    frames = [
        cv2.warpAffine(picture, cv2.getRotationMatrix2D((42.0, 38.0), 3.0 * k, 1.0), (80, 80))
        for k in range(12)
    ]
    near, _ = similarity_hubs(frames, Motion.of(frames, 0))
    assert near == pytest.approx((42.0, 38.0), abs=1.0)


@pytest.mark.parametrize(
    ("own", "outer", "second"), [(20.0, 40.0, True), (20.0, 70.0, False), (70.0, 20.0, False)]
)
def test_the_hub_of_a_second_body_is_outside_the_best_ring_and_the_best_hub_outside_its_ring(
    monkeypatch, own, outer, second
):
    """The hubs are 60 px apart."""
    frames = [np.zeros((120, 240), np.uint8)] * 2
    motion = Motion.of(frames)
    motion.moving[40:60, 30:50] = motion.moving[40:60, 180:200] = True
    best, other = (
        _any_body._Trial(
            Ring.about((x, 50.0), 3.0, r), "edges", "low", True, np.linspace(0.0, 3.0, 12), 0.6, True
        )
        for x, r in ((40.0, own), (100.0, outer))
    )
    monkeypatch.setattr(_any_body, "propose_hubs", lambda *_: [Proposal(other.ring.hub, "edges")])
    monkeypatch.setattr(_any_body, "_trials", lambda *_: [other])
    monkeypatch.setattr(_any_body, "_refined_trial", lambda trial, *_, **__: trial)
    assert _any_body._second_body(frames, motion, best) is (other if second else None)


SMALL_ANGLE = np.linspace(0.0, 0.4, 50)


@pytest.mark.parametrize(
    ("hub", "angle", "share", "told"),
    [
        ((130.0, 100.0), 1.3 * SMALL_ANGLE, 0.90, True),
        ((130.0, 100.0), 1.3 * SMALL_ANGLE, 0.891, True),  # 0.109 unexplained for 0.100
        ((130.0, 100.0), 1.3 * SMALL_ANGLE, 0.889, False),
        ((130.0, 100.0), 1.06 * SMALL_ANGLE, 0.90, True),
        ((130.0, 100.0), 1.04 * SMALL_ANGLE, 0.90, False),  # the same answer
        ((106.0, 100.0), 1.3 * SMALL_ANGLE, 0.90, True),
        ((104.0, 100.0), 1.3 * SMALL_ANGLE, 0.90, False),  # the same hub within 5 % of the radius
    ],
)
def test_another_hub_is_reported_if_it_explains_as_much_and_answers_differently(hub, angle, share, told):
    found = [((100.0, 100.0), 100.0, SMALL_ANGLE, 0.90), (hub, 100.0, angle, share)]
    text = rival_hub(found, 0)
    assert (text is not None) == told
    if told:
        assert f"{np.ptp(angle):.3g} rad" in text
        assert "0.4 rad" in text


def trial(hub, score):
    return SimpleNamespace(ring=SimpleNamespace(hub=hub, outer=100.0), score=score)


@pytest.mark.parametrize(
    ("score", "proposed", "told"),
    [
        (0.79, (40.0, 0.0), True),
        (0.81, (40.0, 0.0), False),  # near enough for a local search, which stays at the given hub
        (0.79, (51.0, 0.0), False),  # farther than half of the radius
    ],
)
def test_another_hub_is_proposed_where_a_given_one_explains_little(monkeypatch, score, proposed, told):
    given, better = trial((0.0, 0.0), score), trial(proposed, 0.95)
    monkeypatch.setattr(_any_body, "propose_hubs", lambda *_: [SimpleNamespace(hub=proposed)])
    monkeypatch.setattr(_any_body, "_trials", lambda *_: [better])
    monkeypatch.setattr(_any_body, "_refined_trial", lambda t, *_, keep: t)
    text = _any_body._doubt_of_hub(given, given, None, SimpleNamespace(area=None))
    assert (text is not None) == told


@pytest.mark.parametrize(
    ("away", "score", "told"),
    [(9.0, 0.96, True), (9.0, 0.94, False), (0.9 * 100 * _any_body._DISPLACED, 0.96, False)],
)
def test_a_given_hub_is_doubted_if_another_one_halves_what_it_leaves(monkeypatch, away, score, told):
    monkeypatch.setattr(_any_body, "_refined_trial", lambda *_, keep: trial((away, 0.0), score))
    given = trial((0.0, 0.0), 0.9)
    text = _any_body._doubt_of_hub(given, given, None, SimpleNamespace(area=None))
    assert (text is not None) == told


def test_pixels_of_a_reduced_frame_are_means_of_squares():
    frame = np.arange(7 * 9, dtype=np.uint8).reshape(7, 9)
    assert reduced(frame, 3).tolist() == frame[:6].reshape(2, 3, 3, 3).mean(axis=(1, 3)).tolist()


def _still(height, width, area):
    motion = Motion.of([np.zeros((height, width), np.uint8)] * 2)
    motion.moving.ravel()[:area] = True
    return motion


@pytest.mark.parametrize(
    ("width", "area", "screened"), [(640, 4000, True), (639, 4000, False), (640, 3999, False)]
)
def test_films_of_large_pictures_with_enough_that_moves_are_screened(width, area, screened):
    """From 640 px on, frames are reduced to 320 px; 1000 px2 must move there."""
    motion = _still(24, width, area)
    frames = [np.zeros((24, width), np.uint8)] * 3
    film = SimpleNamespace(frames=lambda: iter(frames))
    small = _any_body._Reduced.of(film, np.array([0, 2]), frames, motion, margin=3)
    assert (small is not None) == screened
    if small is not None:
        assert len(small.frames) == 2
        assert small.frames[0].shape == (12, 320)
        assert small.motion.area == (2, 2, 318, 10)  # the margin covers whole pixels
        assert small.reduced((9.5, 3.5)) == (4.5, 1.5)
        ring = Ring.about((4.5, 1.5), 10.0, 40.0)
        there = small.seen(_any_body._Trial(ring, "edges", "low", True, np.zeros(2), 0.1, True)).ring
        assert (there.hub, there.inner, there.outer) == ((9.5, 3.5), 20.0, 80.0)


@pytest.mark.parametrize(("score", "kept"), [(0.16, True), (0.14, False)])
def test_a_screened_candidate_reaches_three_quarters_of_what_is_required(monkeypatch, score, kept):
    """20 % must be explained before the refinement, 15 % in reduced frames."""
    ring = Ring.about((160.0, 90.0), 10.0, 80.0)
    trial = _any_body._Trial(ring, "edges", "low", True, np.linspace(0.0, 3.0, 12), score, True)
    monkeypatch.setattr(_any_body, "propose_hubs", lambda *_: [_hub_search.Proposal(ring.hub, "edges")])
    monkeypatch.setattr(_any_body, "tilted_outline", lambda *_: None)
    monkeypatch.setattr(_any_body, "_trials", lambda *_: [trial])
    refined = SimpleNamespace(score=0.27, ring=ring)  # 85 % of 40 % are required, 25.5 % in reduced frames
    monkeypatch.setattr(_any_body, "_quickly_refined", lambda *_, **__: refined)
    motion = _still(180, 320, 100)
    assert bool(_any_body._candidates((), motion, None, share=_any_body._SCREENED).kept) == kept
    full = _any_body._candidates((), motion, None)
    assert not full.kept
    assert full.best is trial
    refined.score = 0.25
    assert not _any_body._candidates((), motion, None, share=_any_body._SCREENED).kept


def test_the_picture_of_a_trial_is_learned_from_some_frames_with_the_angles_of_these(monkeypatch):
    given = {}
    monkeypatch.setattr(_any_body, "every", lambda count: 3)
    monkeypatch.setattr(
        _any_body,
        "learn",
        lambda polars, angle, *_, **__: given.update(zip(polars, angle, strict=True)) or "it",
    )
    monkeypatch.setattr(_any_body, "explained", lambda *compared: compared)
    polars, angle = [f"frame {k}" for k in range(10)], 0.1 * np.arange(10)
    compared = _any_body._score(polars, angle, np.ones(1, bool), None, separate=True)
    assert given == {f"frame {k}": pytest.approx(0.1 * k) for k in (0, 3, 6, 9)}
    assert compared[0] is polars
    assert compared[1] is angle
    assert compared[2] == "it"


@pytest.mark.parametrize(("angles", "loose"), [(0.0051, True), (0.0049, False), (1.99, True), (2.01, False)])
def test_a_loose_body_turns_measurably_in_reduced_frames(monkeypatch, angles, loose):
    turn = np.exp(1j * np.linspace(0.0, angles, 30))
    place = 60.0 + 40.0j
    found = (turn, place * (1.0 - turn), np.zeros(30, dtype=int))
    monkeypatch.setattr(_moving_hub, "follow_features", lambda *_: found)
    motion = _still(80, 120, 0)
    motion.moving[20:60, 40:80] = True
    assert may_be_loose((), motion) == loose


@pytest.mark.parametrize(("travel", "loose"), [(1.8, True), (2.2, False)])
def test_a_loose_body_travels_less_than_twice_the_arcs_of_its_rim_in_reduced_frames(
    monkeypatch, travel, loose
):
    theta = 0.05 * np.sin(np.linspace(0.0, 12.0, 60))
    # at a right angle to each other in time, translation is not rotation about another place
    shift = 0.05 * np.cos(np.linspace(0.0, 12.0, 60))
    motion = _still(80, 120, 0)
    motion.moving[20:60, 40:80] = True
    outer = _moving_hub.ring_for((60.0, 40.0), motion, 48.0).outer
    path = 60.0 + 40.0j + travel * outer * theta.std() * (shift - shift.mean()) / shift.std()
    turn = np.exp(1j * theta)
    monkeypatch.setattr(_moving_hub, "still_point", lambda *_: (60.0, 40.0))
    found = (turn, path - turn * (60.0 + 40.0j), np.zeros(60, dtype=int))
    monkeypatch.setattr(_moving_hub, "follow_features", lambda *_: found)
    assert may_be_loose((), motion) == loose


@pytest.mark.parametrize(("share", "registered"), [(0.49, False), (0.51, True)])
def test_a_free_body_is_registered_if_rough_angles_explain_half(monkeypatch, share, registered):
    rng = np.random.default_rng(0)
    frames = [rng.integers(0, 255, (60, 90)).astype(np.uint8) for _ in range(20)]
    film = SimpleNamespace(frames=lambda: iter(frames))
    place = np.stack([30.0 + 1.5 * np.arange(20), np.full(20, 30.0)], axis=1)
    monkeypatch.setattr(_moving_hub, "explained", lambda *_: (share, None))
    found = _moving_hub._rotation(film, Path(np.arange(20), place, 12.0), 1.0)
    assert (found is not None) == registered


def _turning(count, noise):
    """Similarities about the hub (50, 40), with a noise of the displacement relative to it."""
    rng = np.random.default_rng(1)
    a = np.exp(0.02j * (1.0 + 0.2 * rng.normal(size=count)))
    middle = 70.0 + 40.0j
    shift = (1.0 - a) * (50.0 + 40.0j - middle)
    shift = shift + noise * np.median(np.abs(shift)) * np.exp(2j * np.pi * rng.uniform(size=count))
    return [(x, complex(d + (1.0 - x) * middle), middle) for x, d in zip(a, shift, strict=True)]


@pytest.mark.parametrize(("noise", "every_pair"), [(0.5, True), (8.0, False)])
def test_all_pairs_are_compared_only_if_the_first_ones_have_a_common_hub(monkeypatch, noise, every_pair):
    compared = []
    known = iter(_turning(200, noise))

    def similarity(*_):
        compared.append(next(known))
        return compared[-1]

    monkeypatch.setattr(_hub_search, "similarity", similarity)
    motion = _still(80, 120, 4000)
    similarity_hubs([np.zeros((80, 120), np.uint8)] * 100, motion)
    assert len(compared) == (120 if every_pair else 24)
    unexplained = _hub_search._CommonHub.of(compared[:24]).unexplained
    assert (unexplained < _hub_search._NO_COMMON_HUB) == every_pair


def test_all_pairs_are_compared_if_the_first_ones_are_too_few_for_a_hub(monkeypatch):
    """Features are matched in every tenth pair only: 3 of the first 24, 12 of all 120."""
    known, compared = iter(_turning(200, 0.1)), []

    def similarity(*_):
        compared.append(next(known) if len(compared) % 10 == 9 else None)
        return compared[-1]

    monkeypatch.setattr(_hub_search, "similarity", similarity)
    near, _ = similarity_hubs([np.zeros((80, 120), np.uint8)] * 100, _still(80, 120, 4000))
    assert len(compared) == 120
    assert near == pytest.approx((50.0, 40.0), abs=4.0)


def test_fewer_than_four_pairs_have_no_hub():
    assert _hub_search._CommonHub.of(_turning(3, 0.1)) is None
    assert _hub_search._CommonHub.of([*_turning(4, 0.1), None]).hub == pytest.approx(50.0 + 40.0j, abs=4.0)


def test_features_are_followed_until_they_turn_too_far():
    rng = np.random.default_rng(0)
    picture = cv2.GaussianBlur(rng.integers(0, 255, (100, 100)).astype(np.float32), (0, 0), 1.5)
    picture = cv2.normalize(picture, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    frames = [
        cv2.warpAffine(picture, cv2.getRotationMatrix2D((50.0, 50.0), 3.0 * k, 1.0), (100, 100))
        for k in range(12)
    ]
    motion = Motion.of(frames)
    turn, *_ = _hub_search.follow_features(iter(frames), motion, 0.6)
    assert np.ptp(np.unwrap(np.angle(turn))) == pytest.approx(np.radians(33.0), rel=0.05)
    rest = iter(frames)
    assert _hub_search.follow_features(rest, motion, 0.3) is None
    assert len(list(rest)) == 5  # 7 frames turn by 18 degrees


@pytest.mark.parametrize(("rate", "speed"), [(0.05, 6.0 + 2.0j), (-0.06, 5.0 + 6.0j)])
def test_new_features_continue_the_motion_of_those_that_are_lost(rate, speed):
    """A texture that turns about a place and travels through the picture, which is 100 px wide."""
    rng = np.random.default_rng(0)
    texture = cv2.GaussianBlur(rng.integers(0, 255, (400, 400)).astype(np.float32), (0, 0), 1.5)
    texture = cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    steps = np.arange(14)
    a = np.exp(1j * rate * steps)
    b = 50.0 + 50.0j + speed * steps - a * (200.0 + 200.0j)
    frames = [
        cv2.warpAffine(texture, np.array([[x.real, -x.imag, y.real], [x.imag, x.real, y.imag]]), (100, 100))
        for x, y in zip(a, b, strict=True)
    ]
    moving = np.ones((100, 100), bool)
    motion = SimpleNamespace(deviation=rng.uniform(1.0, 2.0, moving.shape).astype(np.float32), moving=moving)
    turn, moved, since = _hub_search.follow_features(iter(frames), motion, 9.0)
    assert turn == pytest.approx(a, abs=0.02)
    assert moved == pytest.approx(b - a * b[0], abs=1.0)
    chosen = np.unique(since)
    assert 1 < len(chosen) < 5
    assert all(since[k - 1] < k <= since[k + 1] for k in chosen[1:])
    assert _hub_search.follow_features(iter([frames[0], texture[:100, :100]]), motion, 9.0) is None
    assert _hub_search.follow_features(iter([np.zeros((100, 100), np.uint8)] * 2), motion, 9.0) is None


class TestMotion:
    """A still texture of 70 by 100 px, with bars of 4, 9, 2 and 6 px at its sides."""

    @staticmethod
    def frames(change=0):
        picture = np.full((70, 100), 16, np.uint8)
        picture[2:64, 4:91] = np.random.default_rng(0).integers(60, 200, (62, 87))
        frames = [picture.copy() for _ in range(6)]
        for frame in frames[::2]:
            frame[20:36, 40:60] += np.uint8(change)
        return frames

    def test_uniform_bars_are_left_out_of_the_area(self):
        assert Motion.of(self.frames()).area == (4, 2, 91, 64)
        assert Motion.of(self.frames(), 3).area == (7, 5, 88, 61)

    @pytest.mark.parametrize(("change", "moves"), [(3, False), (5, True)])
    def test_what_changes_by_four_times_the_noise_moves(self, change, moves):
        """Its standard deviation is half of the change; the noise is half a grey level at least."""
        found = Motion.of(self.frames(change))
        assert found.noise == 0.5
        assert found.deviation[28, 50] == pytest.approx(0.5 * change)
        assert found.moving[22:34, 42:58].all() == found.moving.any() == moves
        assert not found.moving[:19].any()


@pytest.mark.parametrize(("count", "step"), [(100, 1), (101, 2), (200, 2), (201, 3)])
def test_at_most_a_hundred_frames_are_compared(count, step):
    assert every(count) == step


@pytest.mark.parametrize("count", [7, 8])
def test_the_median_of_frames(count):
    frames = np.random.default_rng(count).integers(0, 256, (count, 70, 20)).astype(np.uint8)
    stored = StoredPictures.of(count, iter(frames))
    np.testing.assert_array_equal(median_picture(stored), np.median(frames, axis=0))
