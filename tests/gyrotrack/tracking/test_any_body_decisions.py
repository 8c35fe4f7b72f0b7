"""Rules and formulas of the tracking of any body: candidates, the refinement of a hub, and the final angles."""

import math
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from gyrotrack import TrackingError
from gyrotrack._column_store import StoredPictures
from gyrotrack.tracking import _any_body as module
from gyrotrack.tracking._any_body import calmer, ring_step
from gyrotrack.tracking._hub_search import Motion, Proposal
from gyrotrack.tracking._registration import TURN, Pose, Ring, Template

RING = Ring.about((60.0, 50.0), 4.0, 40.0, finest=48.0)
ANGLE = np.linspace(0.0, 3.0, 31)


def _trial(score=0.6, angle=ANGLE, ring=RING, **change):
    given = {"way": "edges", "band": "low", "static": False, "separate": False} | change
    return module._Trial(ring=ring, angle=np.asarray(angle, dtype=float), score=score, **given)


@pytest.mark.parametrize(("before", "after", "expected"), [(3, 2, True), (2, 3, False), (2, 2, False)])
def test_frames_are_calmer_if_they_change_less_inside_the_margin(before, after, expected):
    def frames(change):
        some = np.full((4, 20, 30), 100, dtype=np.uint8)
        some[1::2, 5, 7] += change
        return list(some)

    sample, still = frames(before), frames(after)
    still[1][2, 7] = still[1][5, 2] = still[1][17, 7] = still[1][5, 27] = 250  # in the margin of 3 px
    assert calmer(sample, still, 3) == expected


def test_the_uncertainty_of_a_compensated_camera_is_that_of_shift_and_roll():
    tracked = SimpleNamespace(
        ring=Ring.about((0.0, 0.0), 20.0, 60.0), sigma=np.array([0.01]), warnings=("doubt",)
    )
    shake = SimpleNamespace(rms=1.0, roll=np.zeros(3), features=9, shift_sigma=0.2, roll_sigma=0.002)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "replace", lambda old, **new: SimpleNamespace(**{**vars(old), **new}))
        found = module._with_shake(tracked, shake)
    # 0.2 px at the middle radius of 40 px
    assert found.sigma == pytest.approx([math.sqrt(0.01**2 + 0.005**2 + 0.002**2)])
    assert found.warnings[-1] == "doubt"
    assert len(found.warnings) == 2


@pytest.mark.parametrize(
    ("hub", "given", "off"),
    [
        ((60.0, 50.0), None, False),
        ((-1.0, 50.0), None, True),
        ((-1.0, 50.0), (-1.0, 50.0), False),
        ((60.0, -1.0), None, True),
        ((120.0, 50.0), None, True),
        ((60.0, 100.0), None, True),
        ((3.0, 50.0), None, False),  # half of the ring is inside
        ((1.0, 1.0), None, True),  # a quarter
    ],
)
def test_a_hub_outside_the_picture_or_with_a_third_of_its_ring_inside_is_off(hub, given, off):
    motion = SimpleNamespace(mean=np.zeros((100, 120)), area=(0, 0, 120, 100))
    assert module._off_picture(replace(RING, hub=hub), motion, given) == off


def test_three_candidates_with_different_motions_are_kept():
    first = _trial(0.8, ANGLE)
    same = _trial(0.7, 1.09 * ANGLE + 5.0)
    other, third, fourth = (_trial(0.6, c * ANGLE) for c in (1.12, -1.0, 3.0))
    weak = _trial(0.23, 2.0 * ANGLE)  # below 0.3 of 0.8
    found = module._distinct([first, same, weak, other, third, fourth])
    assert [id(t) for t in found] == [id(t) for t in (first, other, third)]
    assert len(module._distinct([first, _trial(0.25, 2.0 * ANGLE)])) == 2


def test_the_steadiness_is_the_share_of_frames_without_a_jump():
    step = RING.step
    # steps of 10 columns; two of them are 19 and 21 columns larger
    steps = np.full(40, 10.0) * step
    assert module._steadiness(_trial(angle=np.cumsum(steps))) == 1.0
    for jump, bends in ((9.0, 0), (11.0, 2)):
        some = steps.copy()
        some[[10, 20]] += jump * step
        assert module._steadiness(_trial(angle=np.cumsum(some))) == pytest.approx(1.0 - 2 * bends / 38)
    # at rest, a jump is three columns
    for jump, bends in ((2.9, 0), (3.1, 2)):
        some = np.zeros(40)
        some[10] = jump * step
        assert module._steadiness(_trial(angle=np.cumsum(some))) == pytest.approx(1.0 - bends / 38)
    assert module._steadiness(_trial(angle=[0.0, 1.0])) == 1.0


@pytest.mark.parametrize(
    ("span", "turned", "given", "free"),
    [
        (TURN, 3.1, False, [0, 1, 2, 3]),
        (TURN, 2.9, False, [0, 1]),
        (TURN, 3.1, True, [2, 3]),
        (TURN, 2.9, True, []),
        (6.0, 9.0, False, [0, 1]),
    ],
)
def test_a_ring_is_stretched_if_its_body_turns_half_a_turn(span, turned, given, free):
    assert module._free(replace(RING, span=span), np.array([0.0, turned]), given=given) == free


def _pose(angle=0.0, misfit=1.0, shift=(0.0, 0.0), shift_sigma=0.1, formal=1e-3):
    return Pose(angle, formal, shift, shift_sigma, 0.0, misfit)


def test_good_frames_have_less_than_three_times_the_median_misfit():
    poses = [_pose(misfit=m) for m in (1.0, 2.0, 2.0, 5.9, 6.1)]
    np.testing.assert_array_equal(module._good(poses), [1.0, 1.0, 1.0, 1.0, 0.0])


@pytest.mark.parametrize(
    ("misfit", "shift", "sigma", "size"),
    [
        (0.79, 1.0, 0.1, 1.4826),
        (0.81, 1.0, 0.1, 0.0),
        (0.5, 1.0, 0.49, 1.4826),
        (0.5, 1.0, 0.50, 0.0),
    ],
)
def test_a_hub_moves_if_its_displacement_is_significant_and_explains_the_misfit(
    misfit, shift, sigma, size, monkeypatch
):
    def register(picture, template, angle, *, move=False):
        return _pose(angle, misfit, (shift, -shift), sigma) if move else _pose(angle)

    monkeypatch.setattr(module, "register", register)
    polars = StoredPictures.of(5, iter(np.zeros((5, 2, 3), dtype=np.uint8)))
    assert module._hub_motion(polars, np.zeros(5), None) == pytest.approx(size)


def _path_of(theta, distance, monkeypatch, towards=0.7, radius=120.0):
    """A body whose distance from the hub is given for each angle of its path."""
    ring = Ring.about((10.0, 20.0), 100.0, 140.0, start=towards - 0.5, span=1.0)
    column = int(np.argmin(np.abs(ring.angle - towards)))
    picture = np.zeros((ring.rows, ring.columns), dtype=np.float32)
    picture[:, column - 6 : column + 7] = np.hanning(13)
    known = np.zeros(ring.rows)
    known[np.argmin(np.abs(ring.radius - radius))] = 2.0
    picture[known == 0] = np.roll(picture[known == 0], 25, axis=1)  # rows without information do not count
    radius = ring.radius[known > 0].item()
    towards = ring.angle[column]
    template = SimpleNamespace(ring=ring, body=picture, information=lambda: known)
    found = iter(zip(theta, distance(radius), strict=True))

    def displaced(*_):
        turn, away = next(found)
        shift = (away - radius) * np.exp(1j * (towards + turn))
        return turn, np.array([shift.real, shift.imag])

    monkeypatch.setattr(module, "displaced", displaced)
    return module._BodyPath.of([None] * len(theta), np.zeros(len(theta)), template), towards, radius


@pytest.mark.parametrize("centre", [0.0, 0.15])
def test_the_path_of_a_body_shows_the_displacement_of_its_hub(centre, monkeypatch):
    theta = np.linspace(-0.3, 0.3, 21)
    distance = lambda r: r + 12.0 * (1.0 - np.cos(theta)) - 5.0 * np.sin(theta)  # noqa: E731
    path, towards, radius = _path_of(theta + centre, distance, monkeypatch)
    assert path.middle == pytest.approx(towards + centre)
    assert path.radius == pytest.approx(radius)
    np.testing.assert_allclose(path.theta, theta, atol=1e-9)
    assert (path.bend, path.across) == pytest.approx((12.0, -5.0))
    # only the position-dependent error of 0.1 px remains
    assert path.bend_sigma == pytest.approx(0.1 / (1.0 - math.cos(0.3)))


@pytest.mark.parametrize("alike", [0.0, 0.6, -0.5])
def test_correlated_residuals_increase_the_uncertainty_of_a_path(alike, monkeypatch):
    theta = np.linspace(-0.8, 0.8, 4001)
    rng = np.random.default_rng(1)
    noise = rng.normal(0.0, 3.0, 4001)
    for k in range(1, 4001):
        noise[k] = alike * noise[k - 1] + math.sqrt(1.0 - alike**2) * noise[k]
    path, *_ = _path_of(theta, lambda r: r + noise, monkeypatch)
    rows = np.stack([1.0 - np.cos(theta), np.sin(theta), np.ones_like(theta)], axis=1)
    q = max(alike, 0.0)
    variance = 9.0 * (1.0 + q) / (1.0 - q) * np.linalg.inv(rows.T @ rows)[0, 0]
    expected = math.hypot(math.sqrt(variance), 0.1 / (1.0 - math.cos(0.8)))
    assert path.bend_sigma == pytest.approx(expected, rel=0.07)


def _far_ring():
    return Ring.about((10.0, 20.0), 100.0, 140.0, start=0.2, span=1.0)


def _settled(paths, monkeypatch):
    given, plain = iter(paths), []

    def learn(*_, plain, **__):
        plains.append(plain)

    plains = plain
    monkeypatch.setattr(module, "learn", learn)
    monkeypatch.setattr(module._BodyPath, "of", classmethod(lambda *_: next(given)))
    pictures = [np.zeros((200, 300), dtype=np.uint8)] * 2
    found = module._at_distance_of_path(_far_ring(), pictures, np.zeros(2), (0, 0, 300, 200), separate=False)
    return found, plains


def _path(bend, sigma=1.0, across=0.0, theta=(-0.3, 0.3)):
    return module._BodyPath(0.7, 120.0, np.array(theta), bend, sigma, across)


def test_a_hub_stays_if_the_path_agrees_within_three_sigma(monkeypatch):
    (ring, angle, distance), plains = _settled([_path(2.9)], monkeypatch)
    assert ring == _far_ring()
    np.testing.assert_array_equal(angle, 0.0)
    assert distance == 0.0
    assert plains == [True]


def test_a_hub_moves_to_the_distance_that_the_path_gives(monkeypatch):
    (ring, angle, distance), plains = _settled(
        [_path(30.0, across=4.0), _path(0.5, 2.4), _path(0.5, 3.6)], monkeypatch
    )
    # 120 px / (1 - 30 / 120) = 160 px: the hub moves by 40 px away from the body and by 4 px across
    move = (-40.0 + 4.0j) * np.exp(0.7j)
    assert ring.hub == pytest.approx((10.0 + move.real, 20.0 + move.imag))
    assert (ring.inner, ring.outer) == pytest.approx((140.0, 180.0))
    assert (ring.start, ring.span) == pytest.approx((0.7 - 0.5 * 0.75, 0.75))
    np.testing.assert_allclose(angle, [-0.225, 0.225])
    assert distance == pytest.approx(3.6 / 120.0)
    assert plains == [True, True, False]  # the variances of the samples are used about the true hub


@pytest.mark.parametrize(
    ("bend", "straight"), [(120.0 * (1 - 120.0 / 1e7), True), (130.0, True), (60.0, False)]
)
def test_a_straight_path_has_no_hub(bend, straight, monkeypatch):
    (_, _, distance), _ = _settled([_path(bend), _path(0.0), _path(0.0)], monkeypatch)
    assert math.isinf(distance) == straight


def _finished(
    monkeypatch,
    poses,
    rough=None,
    *,
    correlated=0.0,
    apart=None,
    distance=0.0,
    way="edges",
    selected=None,
    ring=RING,
):
    count = len(poses)
    monkeypatch.setattr(module, "hub_error", lambda *_: correlated)
    monkeypatch.setattr(module, "apart_beyond_harmonics", lambda *_: apart)
    monkeypatch.setattr(module, "white_noise", lambda *_: 2e-3)
    film = SimpleNamespace(
        warnings=("of the film",),
        selected=np.ones(selected or count, dtype=bool),
        path=SimpleNamespace(name="film"),
    )
    rough = np.array([p.angle for p in poses]) if rough is None else rough
    still = np.zeros((RING.rows, RING.columns), np.float32)
    template = Template(RING, still, still, still, still, 1.0, still == 0)
    return module._finish(
        film,
        np.arange(count),
        ring,
        template,
        (None, None),
        poses,
        np.zeros((2, count)),
        _trial(way=way),
        rough,
        distance,
    )


def _turning(**change):
    return [_pose(0.1 * k, **change) for k in range(20)]


def test_frames_that_do_not_match_are_omitted(monkeypatch):
    poses = _turning()
    poses[4] = replace(poses[4], misfit=5.9)
    poses[9] = replace(poses[9], misfit=6.1)
    rough = np.array([p.angle for p in poses])
    limit = 4 * RING.step + 0.1
    rough[12] += 0.99 * limit
    rough[15] -= 1.01 * limit
    found = _finished(monkeypatch, poses, rough)
    kept = [k for k in range(20) if k not in (9, 15)]
    np.testing.assert_array_equal(found.frame, kept)
    np.testing.assert_allclose(found.angle, -0.1 * np.array(kept))
    assert found.scale == pytest.approx(2.0)  # the scatter of 2 mrad, divided by the formal 1 mrad
    expected = np.full(18, 2e-3)
    expected[4] *= math.sqrt(5.9)
    np.testing.assert_allclose(found.sigma, expected)
    assert found.warnings[0] == "of the film"
    assert len(found.warnings) == 2
    assert "2 of 20 frames" in found.warnings[1]


def test_the_uncertainty_is_at_least_the_formal_one(monkeypatch):
    found = _finished(monkeypatch, _turning(formal=5e-3))
    assert found.scale == 1.0
    np.testing.assert_allclose(found.sigma, 5e-3)
    assert found.warnings == ("of the film",)


def test_repeated_frames_are_counted(monkeypatch):
    found = _finished(monkeypatch, _turning(), selected=27)
    assert "7 of 27 frames" in found.warnings[1]


@pytest.mark.parametrize(
    ("correlated", "apart", "distance", "expected", "warned"),
    [
        (0.0, None, 0.0, 0.0, False),
        (1.9e-3, None, 0.0, 1.9e-3, False),
        (2.1e-3, None, 0.0, 2.1e-3, True),
        (1e-3, 7e-3, 0.0, 7e-3, True),
        (8e-3, 7e-3, 0.0, 8e-3, True),
        (1e-3, 7e-3, 0.1, 0.1 * np.std(0.1 * np.arange(20)), True),
        (0.1, None, 0.1, 0.1, True),
    ],
)
def test_the_largest_correlated_error_is_part_of_the_uncertainty(
    correlated, apart, distance, expected, warned, monkeypatch
):
    found = _finished(monkeypatch, _turning(), correlated=correlated, apart=apart, distance=distance)
    assert found.correlated == pytest.approx(expected)
    np.testing.assert_allclose(found.sigma, np.hypot(2e-3, expected))
    assert (len(found.warnings) == 2) == warned
    assert found.distance_error == distance


@pytest.mark.parametrize(
    ("share", "way", "refused"), [(0.24, "edges", False), (0.26, "edges", True), (0.26, "given", False)]
)
def test_an_undetermined_hub_is_refused(share, way, refused, monkeypatch):
    correlated = share * np.std(0.1 * np.arange(20))
    if refused:
        with pytest.raises(TrackingError, match="not determined"):
            _finished(monkeypatch, _turning(), correlated=correlated, way=way)
    else:
        assert _finished(monkeypatch, _turning(), correlated=correlated, way=way).correlated == correlated


@pytest.mark.parametrize(("steps", "refused"), [(3, True), (5, False)])
def test_a_body_turns_in_four_steps(steps, refused, monkeypatch):
    angle = np.minimum(np.arange(20), steps) * 0.3
    poses = [_pose(a) for a in angle]
    if refused:
        with pytest.raises(TrackingError, match="not rotating"):
            _finished(monkeypatch, poses)
    else:
        assert len(_finished(monkeypatch, poses).frame) == 20


@pytest.mark.parametrize(("tilt", "stated"), [(0.34, False), (0.36, True)])
def test_a_tilt_of_a_third_of_a_radian_is_stated(tilt, stated, monkeypatch):
    size = (1.0 - math.cos(tilt)) / (1.0 + math.cos(tilt))
    found = _finished(monkeypatch, _turning(), ring=replace(RING, stretch=(0.6 * size, 0.8 * size)))
    assert any("tilted by" in text for text in found.warnings) == stated


def _spinning(hub, stretch=(0.0, 0.0), count=8):
    """Smooth pictures of 120 x 100 px of a body that turns about a hub, seen with a stretch."""
    p, q = stretch
    y, x = np.mgrid[0:100, 0:120].astype(float)
    matrix = np.linalg.inv(np.array([[1 + p, q], [q, 1 - p]]))
    u = matrix[0, 0] * (x - hub[0]) + matrix[0, 1] * (y - hub[1])
    v = matrix[1, 0] * (x - hub[0]) + matrix[1, 1] * (y - hub[1])
    angle = np.linspace(0.0, 5.6, count)
    frames = []
    for a in angle:
        s, t = np.cos(a) * u + np.sin(a) * v, np.cos(a) * v - np.sin(a) * u
        bright = 120 + 40 * np.cos(0.22 * s + 0.3) * np.sin(0.19 * t + 1.0) + 30 * np.sin(0.13 * (s + t))
        frames.append(np.clip(np.rint(bright), 0, 255).astype(np.uint8))
    return frames, angle


@pytest.mark.parametrize(
    ("free", "true"),
    [
        ([0, 1], (0.6, -0.5, 0.0, 0.0)),
        ([2, 3], (0.0, 0.0, 0.010, -0.014)),
        ([0, 1, 2, 3], (0.5, 0.6, -0.012, 0.008)),
    ],
)
def test_a_step_finds_hub_and_stretch_of_a_ring(free, true):
    frames, angle = _spinning((60.0 + true[0], 50.0 + true[1]), true[2:])
    found = ring_step(RING, frames, angle, free, (0, 0, 120, 100), separate=False)
    np.testing.assert_allclose(found, np.array(true)[free], rtol=0.2, atol=0.1 * np.abs(true).max())


def test_a_step_is_limited_to_a_twentieth_of_the_radius():
    frames, angle = _spinning((65.0, 50.0))
    found = ring_step(RING, frames, angle, [0, 1], (0, 0, 120, 100), separate=False)
    assert np.abs(found).max() == pytest.approx(0.05 * 40.0)
    assert found[0] > 0


SMALL = Ring.about((60.0, 50.0), 6.0, 24.0, finest=12.0)


def test_a_search_moves_a_ring_to_the_hub():
    frames, angle = _spinning((61.0, 49.2), count=6)
    few = StoredPictures.of(len(frames), iter(frames))
    area = (0, 0, 120, 100)
    ring, found, share = module._search(SMALL, angle, few, area, separate=False, keep=False, steps=1)
    assert ring.hub == pytest.approx((61.0, 49.2), abs=0.2)
    np.testing.assert_allclose(np.diff(found), np.diff(angle), atol=5e-3)
    assert share > 0.99
    same, _, less = module._search(SMALL, angle, few, area, separate=False, keep=True, steps=0)
    assert same.hub == SMALL.hub
    assert less < share - 0.01


def test_a_candidate_is_refined_on_its_frames(monkeypatch):
    monkeypatch.setattr(module, "_STEPS", 1)
    frames, angle = _spinning((60.8, 49.5), count=6)
    block = StoredPictures.of(6, iter(frames))
    start = _trial(0.1, angle + 0.02, SMALL)
    found = module._refined_trial(start, block, (0, 0, 120, 100), keep=False)
    assert found.ring.hub == pytest.approx((60.8, 49.5), abs=0.2)
    assert found.score > 0.9
    assert (found.way, found.band) == (start.way, start.band)
    np.testing.assert_allclose(np.diff(found.angle), np.diff(angle), atol=0.02)


@pytest.mark.parametrize(("gain", "separate"), [(0.019, False), (0.021, True)])
def test_a_fixed_picture_has_to_explain_clearly_more(monkeypatch, gain, separate):
    """Of a body that turns by half a radian, a fixed picture is not resolved with certainty."""
    scores = {False: 0.5, True: 0.5 + gain}
    monkeypatch.setattr(module, "_COARSE", 20.0)
    monkeypatch.setattr(module, "follow", lambda *_, **__: np.linspace(0.0, 0.5, 4))
    monkeypatch.setattr(module, "_score", lambda *_, separate: (scores[separate], None))
    blank = np.zeros((100, 120), np.float32)
    moving = np.zeros((100, 120), dtype=bool)
    moving[12:88, 22:98] = True
    motion = Motion(blank, blank, 1.0, moving, (0, 0, 120, 100))
    found = module._trials(Proposal((60.0, 50.0), "edges"), [blank] * 4, motion)
    assert len(found) == 5
    assert {t.separate for t in found} == {separate}
    assert {t.score for t in found} == {scores[separate]}


@pytest.mark.parametrize("turned", [0.8, 5.0])
def test_trials_follow_a_body_with_and_without_a_fixed_picture(turned, monkeypatch):
    monkeypatch.setattr(module, "_COARSE", 20.0)
    frames, _ = _spinning((60.0, 50.0), count=2)
    base = frames[0]
    angle = np.linspace(0.0, turned, 8)
    frames = [
        cv2.warpAffine(base, cv2.getRotationMatrix2D((60.0, 50.0), -np.degrees(a), 1.0), (120, 100))
        for a in angle
    ]
    moving = np.zeros((100, 120), dtype=bool)
    moving[12:88, 22:98] = True
    motion = Motion(
        np.zeros((100, 120), np.float32), np.zeros((100, 120), np.float32), 1.0, moving, (0, 0, 120, 100)
    )
    found = module._trials(Proposal((60.0, 50.0), "edges"), frames, motion)
    assert {(t.static, t.band) for t in found} >= {(False, "low"), (False, "high")}
    best = max(found, key=lambda t: t.score)
    assert best.score > 0.9
    assert np.ptp(best.angle) == pytest.approx(turned, rel=0.03)
    assert best.angle[-1] > best.angle[0]
    assert {t.separate for t in found if np.ptp(t.angle) > 1.0} <= {True}
    assert module._trials(Proposal((60.0, 50.0), "edges"), [base] * 8, motion) == []


@pytest.mark.parametrize(
    ("score", "quick", "asked", "kept"),
    [
        (0.19, 0.9, 0, 0),  # below half of 0.4
        (0.21, 0.9, 1, 1),
        (0.59, 0.33, 1, 0),  # below 0.85 of 0.4
        (0.59, 0.35, 1, 1),
        (0.61, 0.0, 0, 1),  # is refined immediately
    ],
)
def test_candidates_are_refined_cheaply_before_they_are_kept(score, quick, asked, kept, monkeypatch):
    calls = []
    trial = _trial(score)

    def quickly(t, *_, keep):
        calls.append(keep)
        return replace(t, score=quick)

    monkeypatch.setattr(module, "propose_hubs", lambda *_: [Proposal(RING.hub, "edges")])
    monkeypatch.setattr(module, "tilted_outline", lambda *_: None)
    monkeypatch.setattr(module, "axes_meet", lambda *_: None)
    monkeypatch.setattr(module, "_trials", lambda *_: [trial])
    monkeypatch.setattr(module, "_quickly_refined", quickly)
    motion = SimpleNamespace(mean=np.zeros((100, 120)), area=(0, 0, 120, 100))
    found = module._candidates(None, motion, None)
    assert (len(calls), len(found.kept)) == (asked, kept)
    assert found.needed == 0.4
    assert not any(calls)
    given = module._candidates(None, motion, RING.hub)
    assert len(given.kept) == kept
    assert all(calls[asked:])


@pytest.mark.parametrize(
    ("first", "outline", "axes"),
    [(0.86, False, False), (0.84, True, False), (0.41, True, False), (0.39, True, True)],
)
def test_more_candidates_are_tried_if_the_first_ones_explain_little(first, outline, axes, monkeypatch):
    asked = []
    monkeypatch.setattr(module, "propose_hubs", lambda *_: [Proposal((1.0, 1.0), "edges")])
    monkeypatch.setattr(module, "tilted_outline", lambda *_: Proposal((2.0, 2.0), "outline"))
    monkeypatch.setattr(module, "axes_meet", lambda *_: (3.0, 3.0))
    monkeypatch.setattr(module, "_quickly_refined", lambda t, *_, keep: t)

    def trials(proposal, *_):
        asked.append(proposal.hub)
        return [_trial(first if proposal.hub == (1.0, 1.0) else 0.1)]

    monkeypatch.setattr(module, "_trials", trials)
    motion = SimpleNamespace(mean=np.zeros((100, 120)), area=(0, 0, 120, 100))
    module._candidates(None, motion, None)
    assert asked == [(1.0, 1.0), *([(2.0, 2.0)] if outline else []), *([(3.0, 3.0)] if axes else [])]
    asked.clear()
    module._candidates(None, motion, (1.0, 1.0))
    assert (3.0, 3.0) not in asked


@pytest.mark.parametrize(
    ("share", "linked", "refused"), [(0.19, True, False), (0.21, True, True), (0.21, False, False)]
)
def test_a_second_link_beside_the_ring_is_refused(share, linked, refused, monkeypatch):
    monkeypatch.setattr(module, "elsewhere", lambda *_: share)
    monkeypatch.setattr(module, "carries_a_link", lambda *_: linked)
    block = StoredPictures.of(31, iter(np.zeros((31, 2, 3), dtype=np.uint8)))
    given = "film", block, SimpleNamespace(moving=None, noise=1.0), _trial()
    if refused:
        with pytest.raises(module.RefusedFilmError, match="Two linked bodies") as error:
            module.refuse_link(*given)
        assert error.value.evidence == {"explained": 0.6, "elsewhere": share}
        assert len(error.value.frames) == 4
    else:
        module.refuse_link(*given)


@pytest.mark.parametrize(
    ("best", "start", "refined", "found"),
    [
        (0.9, 0.5, 0.73, True),
        (0.9, 0.5, 0.71, False),  # 0.8 of 0.9 is required
        (0.45, 0.5, 0.41, True),
        (0.45, 0.5, 0.39, False),
        (0.9, 0.22, 0.9, True),
        (0.9, 0.21, 0.9, False),  # 0.3 of 0.72
    ],
)
def test_a_second_body_explains_as_much_as_the_first(best, start, refined, found, monkeypatch):
    other = replace(RING, hub=(300.0, 50.0))
    monkeypatch.setattr(module, "propose_hubs", lambda *_: [Proposal(other.hub, "edges")])
    monkeypatch.setattr(module, "_trials", lambda *_: [_trial(start, ring=other), _trial(0.0, ring=RING)])
    monkeypatch.setattr(module, "_refined_trial", lambda t, *_, keep: replace(t, score=refined))
    moving = np.zeros((100, 400), dtype=bool)
    moving[40:60, 50:70] = moving[40:60, 290:310] = True
    motion = Motion(moving * 1.0, moving * 1.0, 1.0, moving, (0, 0, 400, 100))
    assert (module._second_body(None, motion, _trial(best)) is not None) == found


def _still(height, width):
    """A textured picture without uniform bars at its sides."""
    return (30 + np.add.outer(9 * (np.arange(height) % 5), 9 * (np.arange(width) % 7))).astype(np.uint8)


def _tracked(monkeypatch, hub=None, frames=None, **change):
    """Track a film; all slow steps are replaced by given results."""
    frames = [np.full((40, 60), 50 + 40 * (k % 2), np.uint8) for k in range(24)] if frames is None else frames
    best = _trial(0.9, ring=Ring.about((30.0, 20.0), 3.0, 15.0, finest=48.0))
    found = SimpleNamespace(
        warnings=("of the film",),
        ambiguous=False,
        explained=0.9,
        ring=best.ring,
        correlated=0.0,
        sigma=np.full(24, 1e-3),
        angle=np.linspace(0.0, 1.0, 24),
    )
    given = {
        "pairs_of": [],
        "refuse_moving_camera": None,
        "track_by_features": None,
        "may_be_loose": True,
        "_candidates": module._Candidates([best], best, 0.4),
        "_refined_trial": best,
        "_refuse_translation": None,
        "refuse_link": None,
        "_second_body": None,
        "second_rotation": None,
        "_measure": found,
        "elsewhere": 0.0,
        "drift": (0.0, 1.0),
        "_doubt_of_hub": None,
        "rival_hub": None,
        "hub_doubt": None,
        "halves_differ": None,
    }
    for name, value in {**given, **change}.items():
        monkeypatch.setattr(module, name, lambda *_, value=value, **__: value)
    monkeypatch.setattr(module, "replace", lambda old, **new: SimpleNamespace(**{**vars(old), **new}))
    film = SimpleNamespace(path=SimpleNamespace(name="film"), some=lambda index: [frames[i] for i in index])
    return module._track(film, np.arange(len(frames)), frames, hub, None)


def test_a_film_without_doubts_has_only_its_own_warnings(monkeypatch):
    found = _tracked(monkeypatch)
    assert (found.warnings, found.ambiguous) == (("of the film",), False)


@pytest.mark.parametrize(
    ("change", "hub", "doubt"),
    [
        ({"drift": (1.1, 1.0)}, None, "The hub moves by 1.1 px"),
        ({"hub_doubt": "the hub may move"}, None, "the hub may move"),
        ({"rival_hub": "two hubs"}, None, "two hubs"),
        ({"_doubt_of_hub": "another hub"}, (30.0, 20.0), "another hub"),
        ({"drift": (0.9, 1.0)}, None, None),
        ({"rival_hub": "two hubs"}, (30.0, 20.0), None),
        ({"_doubt_of_hub": "another hub"}, None, None),
        ({"hub_doubt": "the hub may move", "drift": (9.0, 1.0)}, (30.0, 20.0), None),
    ],
)
def test_a_doubt_makes_the_result_ambiguous(change, hub, doubt, monkeypatch):
    found = _tracked(monkeypatch, hub, **change)
    assert found.ambiguous == (doubt is not None)
    assert found.warnings[0] == "of the film"
    if doubt:
        assert doubt in found.warnings[1]


@pytest.mark.parametrize(
    ("span", "correlated", "hub", "doubted"),
    [
        (TURN, 2e-3, None, True),
        (TURN, 0.5e-3, None, False),
        (6.0, 2e-3, None, False),
        (TURN, 2e-3, (30.0, 20.0), False),
    ],
)
def test_halves_that_turn_differently_are_doubted_for_a_whole_ring(
    span, correlated, hub, doubted, monkeypatch
):
    ring = replace(RING, span=span)
    measured = SimpleNamespace(
        warnings=(),
        ambiguous=False,
        explained=0.9,
        ring=ring,
        correlated=correlated,
        sigma=np.full(24, 1e-3),
        angle=ANGLE,
    )
    found = _tracked(monkeypatch, hub, _measure=measured, halves_differ=0.03)
    assert found.ambiguous == doubted


def test_the_last_warning_is_the_doubt_about_an_ambiguous_result(monkeypatch):
    measured = SimpleNamespace(
        warnings=("first", "an alias"),
        ambiguous=True,
        explained=0.9,
        ring=RING,
        correlated=0.0,
        sigma=np.ones(24),
        angle=ANGLE,
    )
    found = _tracked(monkeypatch, _measure=measured, rival_hub="two hubs", drift=(1.5, 1.0))
    assert found.warnings == ("first", "an alias two hubs")  # the hub may move because of the alias


@pytest.mark.parametrize(
    ("score", "hub", "needed"),
    [(0.41, (30.0, 20.0), None), (0.39, (30.0, 20.0), 0.4), (0.84, None, 0.85), (0.86, None, None)],
)
def test_a_hub_outside_the_picture_must_explain_more(score, hub, needed, monkeypatch):
    place = (-5.0, 20.0) if hub is None else (30.0, 20.0)
    best = _trial(score, ring=Ring.about(place, 3.0, 25.0, finest=48.0))
    asked = []

    def refuse(*given):
        asked.append(given[-1])
        raise TrackingError("refused")

    frames = [_still(40, 60) for _ in range(24)]
    for k, frame in enumerate(frames):
        frame[10:30, 10:30] += np.uint8(40 * (k % 2))
    monkeypatch.setattr(module, "_refuse", refuse)
    if needed is None:
        _tracked(
            monkeypatch, hub, frames, _refined_trial=best, _candidates=module._Candidates([best], best, 0.4)
        )
    else:
        with pytest.raises(TrackingError, match="refused"):
            _tracked(
                monkeypatch,
                hub,
                frames,
                _refined_trial=best,
                _candidates=module._Candidates([best], best, 0.4),
            )
    assert asked == ([] if needed is None else [needed])


def test_a_picture_that_moves_as_a_whole_about_a_hub_outside_is_a_moving_camera(monkeypatch):
    best = _trial(0.9, ring=Ring.about((-5.0, 20.0), 3.0, 25.0, finest=48.0))
    with pytest.raises(TrackingError, match="All of the picture moves"):
        _tracked(monkeypatch, _refined_trial=best, _candidates=module._Candidates([best], best, 0.4))


@pytest.mark.parametrize(("hub", "loose"), [(None, True), ((44.0, 20.0), True), ((46.0, 20.0), False)])
def test_a_loose_body_is_tracked_by_its_features_near_a_given_hub(hub, loose, monkeypatch):
    body = SimpleNamespace(ring=Ring.about((30.0, 20.0), 3.0, 15.0, finest=48.0))
    assert (_tracked(monkeypatch, hub, track_by_features=body) is body) == loose


@pytest.mark.parametrize("hub", [(math.nan, 20.0), (20.0, math.inf)])
def test_a_hub_has_finite_coordinates(hub, monkeypatch):
    with pytest.raises(module.UsageError, match="not finite"):
        _tracked(monkeypatch, hub)


def test_two_bodies_are_reported_with_both_hubs(monkeypatch):
    other = _trial(0.7, ring=replace(RING, hub=(90.0, 12.0)))
    with pytest.raises(module.RefusedFilmError, match="Two bodies turn") as error:
        _tracked(monkeypatch, _second_body=other)
    assert error.value.evidence == {"explained": 0.9, "other_explained": 0.7}
    assert not _tracked(monkeypatch, (30.0, 20.0), _second_body=other).ambiguous


@pytest.mark.parametrize(("pixels", "moves"), [(1, False), (40, True)])
def test_a_film_in_which_few_pixels_change_shows_no_motion(pixels, moves, monkeypatch):
    frames = [_still(100, 100) for _ in range(24)]
    for k, frame in enumerate(frames):
        frame[40 : 40 + pixels, 50 : 50 + pixels] += np.uint8(100 * (k % 2) * (pixels > 1))
    if moves:
        _tracked(monkeypatch, frames=frames)
    else:
        with pytest.raises(module.NothingMovesError):
            _tracked(monkeypatch, frames=frames)
