"""A body on an axle keeps its hub; what translates or consists of several things does not."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from gyrotrack.tracking import _any_body
from gyrotrack.tracking._any_body import calmer
from gyrotrack.tracking._coaxial import SecondRotation
from gyrotrack.tracking._fixed_hub import drift, fallen, halves_differ, hub_doubt
from gyrotrack.tracking._registration import Ring
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
