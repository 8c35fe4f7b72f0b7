"""Rules of the tracker of a film: predictions, repeated frames, the moving hub, and the mean of the markers."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.tracking import _film_tracker as module
from gyrotrack.tracking._association import Motion
from gyrotrack.tracking._film_tracker import BodyTracker, FilmTracker


def _body(**attributes):
    body = object.__new__(BodyTracker)
    given = {"_step": 0.01, "_frame": 0.0, "step": math.inf, "_motion": None, "_missed": None, "markers": {}}
    vars(body).update({**given, **attributes})
    return body


class Strip:
    """A coloured marker at a displacement [columns] and with a height from the expected angle."""

    def __init__(self, off, height, mount=0.0):
        self.off, self.height = np.asarray(off, float), np.asarray(height, float)
        self.marker = SimpleNamespace(mount=mount, half_width=0.03)
        self.asked = []
        self.ring = SimpleNamespace(columns=64)

    def locate(self, angle, place):
        self.asked.append((angle, place))
        return self.off, self.height


def test_coarse_angles_are_refined_by_the_markers_with_weights_of_their_height():
    one = Strip([2.0, 2.0, 2.0, 2.0], [1.0, 1.0, 0.39, 2.0])
    two = Strip([4.0, 4.0, 4.0, 4.0], [1.0, 0.41, 0.39, 1.0], mount=0.5)
    body = _body(_coloured=[one, two])
    coarse = np.array([1.0, 1.0, 1.0, 1.0])
    angle, seen = body._refined(coarse, slice(3, 7))
    low, high = 0.41**8, 1.2**8
    expected = [3.0, (2.0 + low * 4.0) / (1.0 + low), 0.0, (high * 2.0 + 4.0) / (high + 1.0)]
    np.testing.assert_allclose(angle, 1.0 + 0.01 * np.array(expected), rtol=1e-6)
    assert seen.tolist() == [True, True, False, True]
    np.testing.assert_allclose(two.asked[0][0], 1.5)
    assert two.asked[0][1] == slice(3, 7)
    angle, seen = body._refined(np.array([np.nan, 1.0, 1.0, 1.0]), slice(3, 7))
    assert np.isnan(angle[0])
    assert not seen[0]


class Ahead:
    def __init__(self, sigma, slope=0.1, known=True):
        self.sigma, self.slope, self.known, self.added = sigma, slope, known, []

    def at(self, number):
        return (self.slope * number, self.sigma) if self.known else None

    def add(self, number, angle, seen):
        self.added.append((number, angle, seen))

    def reset(self):
        self.added.append("reset")


@pytest.mark.parametrize(
    ("sigma", "known", "seen", "used"),
    [
        (0.016, True, [True, True, False], True),
        (0.017, True, [True, True, True], False),  # three times this exceeds 0.05 rad
        (0.001, False, [True, True, True], False),
        (0.001, True, [True, False, False], False),
    ],
)
def test_a_body_is_searched_for_near_a_certain_prediction(sigma, known, seen, used, monkeypatch):
    body = _body(_prediction=Ahead(sigma, known=known))
    cuts = []
    monkeypatch.setattr(BodyTracker, "_cut", lambda self, frames, place, angle: cuts.append(angle))
    off = np.array([0.01, 0.03, 0.5])
    monkeypatch.setattr(BodyTracker, "_refined", lambda self, coarse, place: (coarse + off, np.array(seen)))
    number = np.arange(10.0, 15.0)
    found = body._predicted([None] * 5, 7, number)
    assert (found is not None) == used
    if used:
        angle, mask = found
        np.testing.assert_allclose(angle, 0.1 * number + 0.02)  # the median of the two that are seen
        assert mask.tolist() == [True, True, True, True, False]
        np.testing.assert_array_equal(body._prediction.added[0][0], number[::2])
        np.testing.assert_allclose(cuts[0], 0.1 * number)


def test_the_motion_after_predicted_frames_is_that_of_the_prediction():
    body = _body(_prediction=Ahead(0.01, 0.3), _missed=4)
    motion = body._motion_at(20.0)
    assert (motion.angle, motion.step, motion.missed) == (pytest.approx(6.0), pytest.approx(0.3), 4)
    assert body._motion_at(20.0) is None
    body = _body(_prediction=Ahead(0.01, known=False), _missed=4)
    assert body._motion_at(20.0) is None


def test_a_batch_is_tracked_by_prediction_or_by_search(monkeypatch):
    body = _body(_prediction=Ahead(0.01), _coarse=np.full(20, np.nan), _frame=100.0)
    monkeypatch.setattr(
        BodyTracker,
        "_predicted",
        lambda self, frames, place, number: (0.2 * number, np.array([True, True, False])),
    )
    body.take([None] * 3, 5, np.array([1.0, 1.0, 2.0]))
    np.testing.assert_allclose(body._coarse[5:8], 0.2 * np.array([101.0, 102.0, 104.0]))
    np.testing.assert_array_equal(body.coarse(5, 3), body._coarse[5:8])
    assert (body._frame, body._missed) == (104.0, 1)
    assert body.step == pytest.approx(0.3)
    # a search: the last motion is extrapolated to the first frame
    followed = []
    monkeypatch.setattr(BodyTracker, "_predicted", lambda *_: None)
    monkeypatch.setattr(BodyTracker, "_searched", lambda self, frames: np.zeros((len(frames), 8)))
    monkeypatch.setattr(BodyTracker, "_cut", lambda *_: None)
    monkeypatch.setattr(BodyTracker, "_refined", lambda self, coarse, place: (coarse, np.isfinite(coarse)))

    def follow(self, score, advance):
        followed.append((self._motion, advance.tolist()))
        return np.array([1.0, np.nan, 1.4])

    monkeypatch.setattr(BodyTracker, "_follow", follow)
    body._motion, body._missed = Motion(1.0, 0.5, 3), None
    body.take([None] * 3, 8, np.array([2.0, 1.0, 1.0]))
    motion, advance = followed[0]
    assert (motion.angle, motion.step, motion.missed) == (2.0, 0.5, 3)
    assert advance == [1.0, 1.0, 0.0]
    assert body._prediction.added[0] == "reset"
    np.testing.assert_array_equal(body._prediction.added[1][0], [106.0, 107.0, 108.0])
    assert body.step == math.inf


def test_the_scores_of_the_markers_are_added_at_the_angle_of_the_body():
    one, two = Strip(0, 0), Strip(0, 0, mount=0.1)
    for strip, column, height in ((one, 20, 1.0), (two, 30, 5.0)):
        score = np.full((2, 64), -9.0)
        score[0, column - 3 : column + 4] = height
        strip.whole = lambda frames, score=score: score
    total = _body(_coloured=[one, two])._searched([None, None])
    assert total.shape == (2, 64)
    # three columns to both sides are averaged; the scores are limited to -0.2 and 1.3
    assert total[0, 20] == pytest.approx(1.0 + 1.3)
    assert int(np.argmax(total[0])) == 20
    np.testing.assert_allclose(total[1], -0.4)
    assert total[0, 21] == pytest.approx((6 * 2.3 - 0.4) / 7)


def test_a_lost_body_is_extrapolated_and_found_again_backwards(monkeypatch):
    old = Motion(2.0, 0.5, 1)
    body = _body(_motion=old)
    coarse = np.full(8, np.nan)
    advance = np.ones(8)
    monkeypatch.setattr(module, "find_lock", lambda *_: None)
    assert body._lock(np.zeros((6, 4)), 2, advance, coarse) == 6
    assert body._motion == Motion(2.0 + 6 * 0.5, 0.5, 7)
    # found in frame 5; the number of turns is that of the extrapolated motion
    body._motion = Motion(20.0, 2.0, 0)
    asked = []
    monkeypatch.setattr(module, "find_lock", lambda *given: asked.append(given[2:]) or (3, Motion(1.0, 1.9)))

    def follow(score, motion, least, steps):
        asked.append((motion, steps.tolist()))
        return np.array([5.0, 4.0, 3.0]), np.array([True, False, True]), None

    monkeypatch.setattr(module, "follow", follow)
    assert body._lock(np.zeros((6, 4)), 2, advance, coarse) == 5
    assert asked[0][0] == 2.0
    np.testing.assert_array_equal(asked[0][1], np.arange(6.0))
    ahead = 20.0 + 3 * 2.0
    turns = 2.0 * math.pi * round((ahead - 1.0) / (2.0 * math.pi))
    assert body._motion.angle == pytest.approx(1.0 + turns)
    back, steps = asked[1]
    assert (back.angle, back.step) == (pytest.approx(1.0 + turns - 1.9), -1.9)
    assert steps == [1.0, 1.0, 0.0]
    np.testing.assert_array_equal(coarse, [np.nan, np.nan, 3.0, np.nan, 5.0, np.nan, np.nan, np.nan])


@pytest.mark.parametrize(("missed", "locks"), [(module.LONGEST_COAST, 0), (module.LONGEST_COAST + 1, 1)])
def test_a_body_that_is_missed_for_long_is_searched_for(missed, locks, monkeypatch):
    body = _body(_motion=Motion(0.0, 0.1, missed))
    calls = []
    monkeypatch.setattr(
        BodyTracker, "_lock", lambda self, score, begin, advance, coarse: calls.append(begin) or begin
    )
    monkeypatch.setattr(
        module, "follow", lambda score, motion, least, advance: (np.arange(float(len(score))), None, motion)
    )
    found = body._follow(np.zeros((4, 8)), np.ones(4))
    assert len(calls) == locks
    assert found.tolist() == [0.0, 1.0, 2.0, 3.0]


def test_the_usual_step_is_the_mean_of_known_steps():
    assert module._usual_step(np.array([1.0, 1.2, np.nan, 3.0, 2.6])) == pytest.approx(0.3)
    assert module._usual_step(np.array([1.0, np.nan])) == math.inf
    assert module._moved(None, 3.0) is None
    assert module._run_on(Motion(1.0, 0.2, 1), 2.4) == Motion(pytest.approx(1.48), 0.2, 3)


def _film(**attributes):
    film = object.__new__(FilmTracker)
    given = {
        "bodies": {"rotor": SimpleNamespace(step=1.0)},
        "again": np.zeros(40, bool),
        "filled": 3,
        "held": [],
        "steps": [],
        "pending_step": 0.0,
        "repeats": None,
        "hold": 10,
        "textures": {},
        "disc": None,
        "centre": (50.0, 40.0),
    }
    vars(film).update({**given, **attributes})
    return film


@pytest.mark.parametrize(
    ("regular", "stamped", "moving", "steps"),
    [
        (False, False, True, [1.0, 0.0, 2.0, 1.0]),  # the step of a repeat is added to that of the next frame
        (True, False, True, [1.0, 0.0, 1.0, 1.0]),  # a repeat that was inserted has no step
        (True, True, True, [1.0, 0.0, 2.0, 1.0]),
        (False, False, False, [1.0, 1.0, 1.0, 1.0]),  # nothing turns: frames are equal anyway
    ],
)
def test_a_repeated_frame_shows_the_same_moment(regular, stamped, moving, steps):
    repeats = SimpleNamespace(same=lambda frame: frame == 1, regular=regular)
    step = module.SLOW * (1.1 if moving else 0.9)
    film = _film(
        repeats=repeats, bodies={"casing": SimpleNamespace(step=0.0), "rotor": SimpleNamespace(step=step)}
    )
    for frame in range(4):
        film.keep(frame, 1.0, stamped=stamped)
    assert film.steps == steps
    assert film.held == [0, 1, 2, 3]
    assert film.again[3:8].tolist() == [False, moving, False, False, False]


@pytest.mark.parametrize(
    ("filled", "held", "full"), [(3, 9, False), (3, 10, True), (508, 3, False), (508, 4, True)]
)
def test_frames_are_tracked_if_enough_of_them_are_held(filled, held, full):
    assert _film(filled=filled, held=[None] * held).full == full


def test_the_hub_displacement_is_linear_where_the_disc_is_hidden(monkeypatch):
    centres = np.array([[52.0, 40.0], [np.nan, np.nan], [56.0, 37.0], [50.0, 40.0]])
    asked = []
    disc = SimpleNamespace(centres=lambda *given: asked.append(given) or centres)
    film = _film(disc=disc, held=[None] * 4)
    np.testing.assert_allclose(film._hub_displacement(), [[2.0, 0.0], [4.0, -1.5], [6.0, -3.0], [0.0, 0.0]])
    assert asked == [(7, 3)]
    monkeypatch.setattr(module, "moves_fast", lambda _: False)
    assert film._hub_displacement() is None
    assert _film()._hub_displacement() is None


@pytest.mark.parametrize(("off", "count", "moved"), [(0.61, 8, True), (0.59, 8, False), (9.0, 7, False)])
def test_rings_follow_a_disc_that_moves_far(off, count, moved):
    asked = []
    body = SimpleNamespace(centre_on=asked.append)
    texture = SimpleNamespace(centre=None)
    film = _film(bodies={"casing": body}, textures={"casing": texture}, _offsets={"casing": (2.0, -1.0)})
    centres = np.full((60, 2), np.nan)
    centres[20 : 20 + count] = [50.0, 40.0 + off]
    film._move(centres)
    expected = (50.0, 40.0 + off)
    assert film.centre == (pytest.approx(expected) if moved else (50.0, 40.0))
    assert asked == ([(pytest.approx(52.0), pytest.approx(39.0 + off))] if moved else [])
    if moved:
        assert texture.centre == asked[0]
        centres[28:60] = [80.0, 40.0]  # the last 32 frames decide
        film._move(centres)
        assert film.centre == (80.0, 40.0)


def test_the_angle_of_a_ring_is_the_mean_of_the_open_markers():
    n = 6
    coarse = np.linspace(0.0, 1.0, n)
    about = np.tile([50.0, 40.0], (n, 1))

    def marker(ahead, mount, open_):
        angle = coarse + ahead + mount
        place = 50.0 + 30.0 * np.cos(angle), 40.0 - 30.0 * np.sin(angle)
        return SimpleNamespace(
            open=np.array(open_), angle=angle, position=lambda here: np.stack(place, axis=1)
        )

    seen = {
        "a": marker(0.02, 1.0, [True] * 6),
        "b": marker(0.04, -2.5, [True, True, False, True, True, True]),
    }
    seen["a"].angle[4] = np.nan
    body = SimpleNamespace(
        markers={m: SimpleNamespace(marker=SimpleNamespace(mount=v)) for m, v in (("a", 1.0), ("b", -2.5))}
    )
    found = module._by_markers(coarse, seen, body, about)
    np.testing.assert_allclose(found - coarse, [0.03, 0.03, 0.02, 0.03, 0.04, 0.03], atol=1e-9)
    far = {"a": marker(1.05 * module.REACH, 1.0, [True] * 6)}
    np.testing.assert_allclose(module._by_markers(coarse, far, body, about), coarse)
    near = {"a": marker(-0.95 * module.REACH, 1.0, [True] * 6)}
    np.testing.assert_allclose(module._by_markers(coarse, near, body, about), coarse - 0.95 * module.REACH)


@pytest.mark.parametrize(("disc", "keep_out"), [(None, 0.0), (8.0, 11.0)])
@pytest.mark.parametrize(("size", "hold"), [((100, 100), 64), ((1000, 1000), 16), ((4000, 3000), 8)])
def test_rings_are_outside_the_disc_and_about_the_axis_of_each_body(disc, keep_out, size, hold, monkeypatch):
    made = []
    monkeypatch.setattr(module, "BodyTracker", lambda *given: made.append(given) or SimpleNamespace(maps=[1]))
    monkeypatch.setattr(module, "TextureTracker", lambda *given: given)
    monkeypatch.setattr(module, "DiscWindow", lambda *given: given)
    marker = SimpleNamespace(outer=70.0)
    scene = SimpleNamespace(
        disc=disc and SimpleNamespace(radius=disc),
        centre=(50.0, 40.0),
        bodies=("casing", "rotor"),
        offsets={"rotor": (3.0, -4.0)},
        of=lambda body: (marker, SimpleNamespace(outer=60.0)),
        axis=lambda body: {"casing": (50.0, 40.0), "rotor": (53.0, 36.0)}[body],
    )
    frame = SimpleNamespace(y=np.zeros(size, np.uint8))
    film = FilmTracker(scene, SimpleNamespace(size=size[::-1], frames=[frame]))
    casing, rotor = made
    assert (casing[0], casing[3], casing[4], casing[6]) == ("casing", (50.0, 40.0), keep_out, (0.0, 0.0))
    # the disc is about the hub, 5 px from the axis of the rotor
    assert (rotor[0], rotor[3], rotor[4], rotor[6]) == ("rotor", (53.0, 36.0), keep_out + 5.0, (3.0, -4.0))
    assert list(film.textures) == ["casing"]
    assert film.textures["casing"][:3] == ((50.0, 40.0), 70.0, size[::-1])
    assert film.hold == hold  # 24 MB of frames with one and a half bytes per pixel
    assert (film.pending_step, film.filled, film.held, film.maps) == (0.0, 0, [], [1, 1])
    assert (film.disc is None) == (disc is None)


@pytest.mark.parametrize(("filled", "new"), [(0, True), (0, False), (7, True)])
def test_a_batch_begins_with_the_disc_at_its_place(filled, new, monkeypatch):
    calls = []
    disc = SimpleNamespace(
        centre_on=lambda *given: calls.append(("centre on", *given)),
        take=lambda frames, place: calls.append(("disc", len(frames), place)),
        centres=lambda *given: np.zeros((2, 2)),
    )
    body = SimpleNamespace(
        take=lambda frames, place, advance: calls.append(("body", place, advance.tolist())),
        coarse=lambda place, count: np.arange(place, place + count),
    )
    texture = SimpleNamespace(
        take=lambda frames, place, coarse, shift: calls.append(("texture", place, coarse.tolist()))
    )
    monkeypatch.setattr(FilmTracker, "_move", lambda self, centres: calls.append("move"))
    monkeypatch.setattr(FilmTracker, "_hub_displacement", lambda self: None)
    film = _film(
        filled=filled,
        disc=disc,
        bodies={"casing": body},
        textures={"casing": texture},
        held=["a", "b"],
        steps=[1.0, 2.0],
        _new=new,
    )
    film.take()
    begins = [("centre on", (50.0, 40.0), "a")] if filled == 0 else []
    first = [("disc", 2, 0), "move"] if filled == 0 and new else []
    assert calls == [
        *begins,
        *first,
        ("body", filled, [1.0, 2.0]),
        ("disc", 2, filled),
        ("texture", filled, [filled, filled + 1]),
    ]
    assert (film.filled, film.held, film.steps, film._new) == (filled + 2, [], [], False)


@pytest.mark.parametrize("fresh", [True, False])
def test_the_first_frames_are_measured_twice_and_the_casing_occludes_the_rotor(fresh):
    calls = []

    def body(name):
        def measure(count, casing, *, again):
            calls.append((name, count, None if casing is None else casing.tolist(), again))
            return np.full(count, 1.0 if name == "casing" else 2.0), {}

        return SimpleNamespace(measure_batch=measure)

    film = _film(
        bodies={"casing": body("casing"), "rotor": body("rotor")}, filled=3, _fresh=fresh, _again=False
    )
    film.again[1] = True
    rows = film.measure_batch()
    once = [("casing", 3, None, False), ("rotor", 3, [1.0] * 3, False)]
    again = [("casing", 3, None, True), ("rotor", 3, [1.0] * 3, True)]
    assert calls == (once + again if fresh else once)
    assert rows["again"].tolist() == [False, True, False]
    assert rows["rotor/coarse"].tolist() == [2.0] * 3
    assert (film.filled, film._again, film._fresh) == (0, False, False)
