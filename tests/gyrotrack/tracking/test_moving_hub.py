"""Bodies that move across the picture, against an independent renderer: angle, claimed uncertainty, refusals."""

import itertools
import json
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import av
import cv2
import numpy as np
import pytest

from gyrotrack import TrackingError
from gyrotrack._column_store import StoredPictures
from gyrotrack.apps.cli._app import run
from gyrotrack.tracking import _any_body, _moving_hub
from gyrotrack.tracking._any_body import track_body
from gyrotrack.tracking._hub_search import Motion, Proposal, Ring
from gyrotrack.tracking._moving_hub import Path as BodyPath
from gyrotrack.tracking._moving_hub import track_free_body

HEIGHT, WIDTH, UP = 150, 300, 4


class Rendered:
    """Frames in memory with the interface of `Film`."""

    def __init__(self, frames):
        self._frames = frames
        self.path = Path("rendered.mp4")
        self.warnings = ()
        self.changes = np.array([255.0] + [np.abs(b - a + 0.0).mean() for a, b in itertools.pairwise(frames)])
        self.selected = np.ones(len(frames), dtype=np.bool_)

    def __len__(self):
        return len(self._frames)

    def frames(self, first=0, stop=None):
        return iter(self._frames[first:stop])

    def some(self, index):
        return StoredPictures.of(len(index), (self._frames[i] for i in index))


def disc(radius, marks):
    """Return picture and coverage of a bright disc with two dark dots of different size, `UP` times enlarged."""
    n = round(2.4 * radius * UP)
    y, x = (np.indices((n, n)) - (n - 1) / 2) / UP
    bright = np.full((n, n), 190.0)
    if marks:
        bright[np.hypot(x - 0.55 * radius, y) < 0.22 * radius] = 50.0
        bright[np.hypot(x + 0.5 * radius, y - 0.1 * radius) < 0.16 * radius] = 70.0
    return bright.astype(np.float32), (np.hypot(x, y) < radius).astype(np.float32)


def table(rng):
    coarse = cv2.GaussianBlur(rng.normal(0, 1, (HEIGHT, WIDTH)), (0, 0), 4)
    return 60 + 12 * coarse / coarse.std()


def film(path, angle, *, radius=14.0, marks=True, noise=2.0, seed=0, second=None, size=None):
    """Draw a disc at places (n, 2) [px] and angles (n,) [rad], counter-clockwise as seen, and with sizes (n,) [1]."""
    rng = np.random.default_rng(seed)
    background = table(rng)
    bright, cover = disc(radius, marks)
    n = len(bright)
    frames = []
    for k, theta in enumerate(angle):
        picture = background.copy()
        bodies = [(path[k], theta)] + ([(second, 0.3)] if second is not None else [])
        for place, turn in bodies:
            zoom = 1.0 if size is None else size[k]
            c, s = zoom * np.cos(-turn), zoom * np.sin(-turn)
            move = np.array([[c, -s, 0], [s, c, 0]])
            # pixel centres of both scales: x_large = (x_small + 0.5) UP - 0.5
            large = (np.asarray(place) + 0.5) * UP - 0.5
            move[:, 2] = large - move[:, :2] @ [(n - 1) / 2, (n - 1) / 2]
            wide = round(1.2 * radius * zoom) + 3  # the body is drawn in its own window
            x, y = (max(int(p) - wide, 0) for p in place)
            right, below = min(x + 2 * wide, WIDTH), min(y + 2 * wide, HEIGHT)
            move[:, 2] -= np.array([x, y]) * UP
            window = ((right - x) * UP, (below - y) * UP)
            over, mask = (cv2.warpAffine(p, move, window, flags=cv2.INTER_LINEAR) for p in (bright, cover))
            over, mask = (
                cv2.resize(p, (right - x, below - y), interpolation=cv2.INTER_AREA)
                for p in (over * mask, mask)
            )
            window = picture[y:below, x:right]
            window[:] = window * (1 - mask) + over
        frames.append(np.clip(picture + rng.normal(0, noise, picture.shape), 0, 255).astype(np.uint8))
    return Rendered(frames)


def sliding(count=90, turns=3.0):
    """Return a path that ends at rest and an angle that does so too, as dry friction makes them."""
    left = 1.0 - np.linspace(0, 1, count)
    path = np.stack([40 + 210 * (1 - left**2), 50 + 55 * (1 - left**2)], axis=1)
    return path, turns * (1 - left**2)


def error_of(tracked, angle):
    """Return the deviations from the truth, without their mean."""
    off = tracked.angle - angle[tracked.frame]
    return off - off.mean()


@pytest.mark.parametrize("turns", [pytest.param(3.0, marks=pytest.mark.slow), -0.8])
def test_the_angle_of_a_puck_is_that_of_the_renderer_within_its_uncertainty(turns):
    path, angle = sliding(turns=turns)
    tracked = track_free_body(film(path, angle))
    off = error_of(tracked, angle)
    assert len(tracked.frame) > 75
    assert np.std(off) < 0.01
    assert 0.6 < np.sqrt(np.mean((off / tracked.sigma) ** 2)) < 1.4
    place = np.array(tracked.ring.hub) + tracked.hub_path
    assert np.abs(place - path[tracked.frame]).max() < 0.5
    assert tracked.way == "outline"
    assert tracked.ambiguous
    assert "does not turn about a fixed axis" in tracked.warnings[-1]


def test_a_body_that_rests_for_most_of_the_film_is_not_a_background():
    path, angle = sliding(60)
    rest = 140
    path = np.concatenate([path, np.repeat(path[-1:], rest, axis=0)])
    angle = np.concatenate([angle, np.full(rest, angle[-1])])
    tracked = track_free_body(film(path, angle))
    assert np.ptp(tracked.angle) == pytest.approx(np.ptp(angle), abs=0.1)
    assert np.std(error_of(tracked, angle)) < 0.01


def test_frames_in_which_the_body_is_hidden_are_left_out():
    path, angle = sliding()
    cover = (176.0, 83.0)
    tracked = track_free_body(film(path, angle, second=cover))
    assert np.hypot(*(path[tracked.frame] - cover).T).min() > 14.0
    assert np.std(error_of(tracked, angle)) < 0.02


def test_a_body_that_moves_away_from_the_camera_is_followed_while_it_becomes_smaller():
    count = 90
    size = np.geomspace(2.6, 0.9, count)
    path = np.stack([np.linspace(110, 220, count), np.linspace(70, 85, count)], axis=1)
    angle = np.linspace(0.0, 18.0, count)
    tracked = track_free_body(film(path, angle, size=size))
    off = error_of(tracked, angle)
    assert len(tracked.frame) > 80
    assert np.std(off) < 0.01
    assert 0.5 < np.sqrt(np.mean((off / tracked.sigma) ** 2)) < 1.5
    place = np.array(tracked.ring.hub) + tracked.hub_path
    assert np.abs(place - path[tracked.frame]).max() < 0.5
    assert any("its size in the picture changes by a factor of 2.9" in w for w in tracked.warnings)
    outer = [tracked.ring_at(k).outer for k in range(len(tracked.frame))]
    assert outer == pytest.approx(0.9 * 14.0 * size[tracked.frame], rel=0.03)


def test_a_body_that_turns_in_one_place_for_most_of_the_film_is_not_a_background():
    """A light bar covers the same part of the picture in most frames; its centroid is that of the bar alone."""
    count = 90
    path, _ = sliding(count)
    path = 0.15 * path + 0.85 * path[-1]
    path[:20] = np.linspace((50.0, 40.0), path[20], 20)
    angle = np.linspace(0.0, 12.0, count)
    shown = film(path, angle)
    (found,) = _moving_hub.find_paths(shown, np.arange(count), 2.0)
    assert len(found.frame) > 80
    assert np.abs(found.place - path[found.frame]).max() < 1.0
    assert found.scale is None


class TestSizes:
    """The area of an outline and its moment, which changes if the body is not seen as a whole."""

    DISC = 1 / (2 * np.pi)

    def sizes(self, area, moment=None):
        moment = np.full(len(area), self.DISC) if moment is None else moment
        return _moving_hub._sizes(np.asarray(area), moment)

    @pytest.mark.parametrize(
        ("ratio", "complete"), [(1.29, True), (1.31, False), (0.71, True), (0.69, False)]
    )
    def test_a_few_other_areas_are_those_of_an_incomplete_body(self, ratio, complete):
        area = np.full(60, 500.0)
        area[30:33] *= ratio
        whole, scale = self.sizes(area)
        assert whole.tolist() == [complete or not 30 <= k < 33 for k in range(60)]
        assert scale is None

    def test_the_size_is_the_root_of_the_area(self):
        size = np.geomspace(3.0, 1.0, 101)
        whole, scale = self.sizes(80.0 * size**2)
        assert whole.all()
        assert scale[8:-8] == pytest.approx(size[8:-8] / size[50])
        assert scale.max() / scale.min() == pytest.approx(3.0, rel=0.02)

    @pytest.mark.parametrize(
        ("change", "complete"), [(1.24, True), (1.26, False), (0.76, True), (0.74, False)]
    )
    def test_the_moment_of_a_body_that_moves_away_stays(self, change, complete):
        moment = np.full(101, self.DISC)
        moment[40:46] *= change
        whole, _ = self.sizes(80.0 * np.geomspace(3.0, 1.0, 101) ** 2, moment)
        assert whole.tolist() == [complete or not 40 <= k < 46 for k in range(101)]

    @pytest.mark.parametrize(("share", "followed"), [(0.08, False), (0.12, True)])
    def test_the_size_is_followed_if_it_changes_in_a_tenth_of_the_frames(self, share, followed):
        area = np.full(200, 500.0)
        count = round(200 * share)
        area[:count] = 500.0 * np.linspace(2.0, 1.5, count)
        whole, scale = self.sizes(area)
        assert whole.all() == followed
        assert (scale is not None) == followed


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("covered", "passed", "found"),
    [
        (20, 3, True),  # 42 differences of the sign of the body, 10 of the other
        (20, 2, False),  # 28 and 10
        (25, 3, True),
        (26, 3, False),  # the background is seen in fewer than 15 % of the frames
    ],
)
def test_the_background_is_found_where_a_body_covers_it(sign, covered, passed, found):
    """In 30 frames, a body covers the first pixel for a time, and `passed` other pixels in 14 frames each."""
    behind, body = 128 - sign * 60, 128
    frames = np.full((30, 1, 9), behind, dtype=np.uint8)
    frames[:covered, 0, 0] = body
    frames[:14, 0, 2 : 2 + passed] = body
    background = _moving_hub.median_picture(list(frames))
    assert background[0].tolist() == [body] + 8 * [behind]
    uncovered = _moving_hub._uncovered(background, list(frames), 20.0)
    assert uncovered[0].tolist() == [behind if found else body] + 8 * [behind]
    assert _moving_hub._uncovered(background, list(frames), 61.0) is background


@pytest.mark.slow
def test_a_point_on_its_path_chooses_a_body():
    path, angle = sliding()
    shown = film(path, angle)
    assert len(track_free_body(shown, near=tuple(path[30])).frame) > 75
    with pytest.raises(TrackingError, match="No body that turns"):
        track_free_body(shown, near=(20.0, 130.0))


@pytest.mark.parametrize("marks", [True, False])
def test_a_body_that_slides_without_turning_is_refused(marks):
    path, angle = sliding(turns=0.0)
    with pytest.raises(TrackingError, match="No body that turns"):
        track_free_body(film(path, angle, marks=marks))


def test_a_blank_disc_that_turns_is_refused():
    path, angle = sliding()
    with pytest.raises(TrackingError, match="No body that turns"):
        track_free_body(film(path, angle, marks=False))


@pytest.mark.slow
def test_a_picture_that_turns_by_a_third_of_a_turn_in_one_step_is_not_a_rigid_body():
    """A glare on a record that turns under a lamp: its outline moves, and another orientation fits it suddenly."""
    path, angle = sliding(turns=0.8)
    angle[45:] += 2.0
    with pytest.raises(TrackingError, match="No body that turns"):
        track_free_body(film(path, angle))


@pytest.mark.slow
def test_an_outline_whose_picture_is_not_rigid_is_not_a_body():
    """Such as a wave, or wires that trail behind a puck: marks that turn to both sides."""
    path, angle = sliding(turns=0.8)
    one, other = (film(path, turn).frames() for turn in (angle, -angle))
    blend = [cv2.addWeighted(a, 0.6, b, 0.4, 0.0) for a, b in zip(one, other, strict=True)]
    with pytest.raises(TrackingError, match="No body that turns"):
        track_free_body(Rendered(blend))


@pytest.mark.parametrize(
    ("share", "near", "kept"), [(0.2, None, False), (0.3, None, True), (0.2, (9.0, 5.0), True)]
)
def test_a_free_body_is_that_of_a_quarter_of_the_change_or_selected(share, near, kept, monkeypatch):
    """A few frames of a thin line that turns about a pivot are not the motion of the film."""
    shown = Rendered([np.full((20, 30), 90 + k, dtype=np.uint8) for k in range(12)])
    path = BodyPath(np.arange(12), np.stack([np.arange(12.0), np.full(12, 5.0)], axis=1), 4.0, share)
    tried = []
    monkeypatch.setattr(_moving_hub, "find_paths", lambda *_: [path])
    monkeypatch.setattr(_moving_hub, "_rotation", lambda *words: tried.append(words))
    with pytest.raises(TrackingError, match="No body that turns"):
        track_free_body(shown, near=near)
    assert bool(tried) == kept


def test_the_share_of_a_path_is_that_of_the_change_in_its_frames():
    """A disc that crosses the picture, then another one at another place: half of the change each."""
    path, _ = sliding(40, turns=0.0)
    frames = [
        *film(path, np.zeros(40), noise=0.0).frames(),
        *film(path[::-1] + np.array([20.0, 30.0]), np.zeros(40), noise=0.0).frames(),
    ]
    shown = Rendered(frames)
    found = _moving_hub.find_paths(shown, np.arange(80), 1.0)
    assert [p.share for p in found[:2]] == pytest.approx([0.5, 0.5], abs=0.12)


def test_a_film_in_which_nothing_moves_is_refused():
    path, _ = sliding()
    with pytest.raises(TrackingError):
        track_free_body(film(np.repeat(path[:1], 60, axis=0), np.zeros(60)))


def pendulums(periods, phases, count=120, fps=30.0):
    """Draw two pendulums before a table; return the film and their angles (2, n)."""
    rng = np.random.default_rng(3)
    background = cv2.resize(table(rng), None, fx=UP, fy=UP, interpolation=cv2.INTER_LINEAR)
    time = np.arange(count) / fps
    angles = np.array([0.3 * np.cos(2 * np.pi * time / t + p) for t, p in zip(periods, phases, strict=True)])
    frames = []
    for both in angles.T:
        picture = background.copy()
        for x, theta in zip((105.0, 195.0), both, strict=True):
            hub, end = (x, 15.0), (x + 100 * np.sin(theta), 15.0 + 100 * np.cos(theta))
            dot = (end[0] + 3 * np.cos(theta), end[1] - 3 * np.sin(theta))
            near, far, mark = (tuple(round(16 * UP * v) for v in place) for place in (hub, end, dot))
            cv2.line(picture, near, far, 160, 2 * UP, cv2.LINE_AA, 4)
            cv2.circle(picture, far, 16 * 9 * UP, 190, -1, cv2.LINE_AA, 4)
            cv2.circle(picture, mark, 16 * 3 * UP, 40, -1, cv2.LINE_AA, 4)
        picture = cv2.resize(picture, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
        frames.append(np.clip(picture + rng.normal(0, 2, picture.shape), 0, 255).astype(np.uint8))
    return Rendered(frames), angles


@pytest.mark.release
@pytest.mark.slow
def test_two_pendulums_are_never_one_body():
    """The features of both move as one rigid picture about a hub far away: such an angle is refused."""
    film, angles = pendulums((1.0, 1.0), (0.0, 0.0), count=60)
    try:
        tracked = track_body(film)
    except TrackingError:
        return
    off = [np.std(tracked.angle - sign * one[tracked.frame]) for one in angles for sign in (1, -1)]
    assert min(off) < 3 * np.median(tracked.sigma) + 0.02 * angles.std()


@pytest.mark.release
@pytest.mark.slow
def test_a_camera_that_turns_about_a_point_outside_the_picture_is_not_a_body():
    """The hub must be given for a body that fills the picture: the film does not differ from that of a camera."""
    rng, hub = np.random.default_rng(5), np.array([-150.0, 60.0])
    floor = cv2.GaussianBlur(rng.normal(0, 1, (700, 700)), (0, 0), 3)
    angle = 0.25 * np.sin(2.2 * np.linspace(0, 1, 40))
    frames = []
    for c, s in zip(np.cos(angle), np.sin(angle), strict=True):
        move = np.array([[c, s, 0.0], [-s, c, 0.0]])
        move[:, 2] = hub - move[:, :2] @ (hub + 250)
        picture = 110 + 35 * cv2.warpAffine(floor / floor.std(), move, (160, 120), flags=cv2.INTER_CUBIC)
        frames.append(np.clip(picture + rng.normal(0, 2, picture.shape), 0, 255).astype(np.uint8))
    shown = Rendered(frames)
    with pytest.raises(TrackingError, match="the camera moves, or the body fills the picture"):
        track_body(shown)
    tracked = track_body(shown, tuple(hub))
    assert np.std(error_of(tracked, angle)) < 2e-3


@pytest.mark.release
@pytest.mark.slow
@pytest.mark.parametrize(("share", "wrong"), [(1.0, False), (0.6, False), (1.0, True)])
def test_the_distance_of_a_hub_outside_the_picture_is_checked_by_the_path(monkeypatch, share, wrong):
    """A ball on a thread of 900 px that need not turn with it; `wrong`: a distance of 1125 px that is not refined."""
    angle = 0.08 * np.cos(2 * np.pi * np.arange(90) / 40)
    path = np.stack([150 + 900 * np.sin(angle), 900 * np.cos(angle) - 825], axis=1)
    if wrong:
        monkeypatch.setattr(_any_body, "propose_hubs", lambda *_: [Proposal((150.0, -1050.0), "test")])
        monkeypatch.setattr(_any_body, "ring_step", lambda *_, **__: np.zeros(2))
    tracked = track_body(film(path, share * angle, radius=28.0))
    factor = np.polyfit(angle[tracked.frame], tracked.angle, 1)[0]
    claimed = tracked.correlated / tracked.angle.std()
    assert abs(factor - 1.0) < 1.5 * claimed + 0.02
    assert claimed < (0.4 if wrong else 0.05)
    assert any("distance of the hub" in w for w in tracked.warnings) or not wrong


def test_a_hopeless_second_body_is_not_refined(monkeypatch):
    """Its refinement took 40 % of the time of a film of a record player."""
    hub = Proposal((150.0, 75.0), "test")
    still = np.zeros((150, 300), dtype=np.float32)
    moving = np.zeros((150, 300), dtype=bool)
    moving[:, :100] = True
    motion = Motion(still, still, 1.0, moving, (0, 0, 300, 150))
    ring = Ring.about((250.0, 75.0), 5.0, 40.0)
    best, weak = (_any_body._Trial(ring, "test", "low", True, np.zeros(3), s, False) for s in (0.9, 0.1))
    monkeypatch.setattr(_any_body, "propose_hubs", lambda *_: [hub])
    monkeypatch.setattr(_any_body, "_trials", lambda *_: [weak])
    monkeypatch.setattr(_any_body, "_refined_trial", lambda *_, **__: pytest.fail("refined"))
    assert _any_body._second_body(None, motion, best) is None


@pytest.mark.release
@pytest.mark.slow
@pytest.mark.parametrize(("off", "doubt"), [(0.3, False), (12.0, True)])
def test_a_given_hub_that_is_not_the_centre_is_doubted(off, doubt):
    """12 px off, the angles were wrong by 370 mrad with a sigma of 3 mrad."""
    angle = 0.1 * np.arange(60)
    tracked = track_body(film(np.full((60, 2), (150.0, 75.0)), angle, radius=55.0), (150.0 + off, 75.0))
    assert tracked.ambiguous == doubt
    assert not doubt or "Rotation about (150, 75) px" in tracked.warnings[-1]
    assert doubt or np.std(error_of(tracked, angle)) < 0.01


@pytest.mark.slow
def test_a_given_hub_of_a_suspended_table_may_move():
    """Its angles were those about a fixed hub, with errors as large as a quarter of the swing."""
    rng = np.random.default_rng(4)
    grain = cv2.GaussianBlur(rng.normal(0, 1, (240, 240)), (0, 0), 3)
    grain, disc = 120 + 40 * grain / grain.std(), np.hypot(*(np.indices((240, 240)) - 119.5)) < 65
    step = np.arange(70)
    angle, sway = 0.08 * np.sin(0.35 * step), 5.0 * np.sin(0.21 * step)
    frames = []
    for c, s, x in zip(np.cos(angle), np.sin(angle), sway, strict=True):
        move = np.array([[c, s, 0.0], [-s, c, 0.0]])
        move[:, 2] = [150 + x, 75 + 0.3 * x] - move[:, :2] @ [119.5, 119.5]
        shown, mask = (
            cv2.warpAffine(p, move, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
            for p in (grain, disc.astype(float))
        )
        frames.append(
            np.clip(60 + (shown - 60) * mask + rng.normal(0, 2, mask.shape), 0, 255).astype(np.uint8)
        )
    tracked = track_body(Rendered(frames), (151.0, 74.0))
    off = error_of(tracked, angle)
    assert np.std(off) < 0.02 * np.std(angle)
    assert np.std(off) < 2.0 * np.median(tracked.sigma)


@pytest.mark.slow
@pytest.mark.parametrize("back", [30, 22])
def test_a_picture_that_changes_between_few_frames_is_not_a_rotation(back):
    """Such as two places of a thing in a film of few frames; the angles before and after had sigmas of 20 urad."""
    angle = np.where((np.arange(30) < 14) | (np.arange(30) >= back), 0.0, 0.24)
    with pytest.raises(TrackingError, match="changes between a few frames"):
        track_body(film(np.full((30, 2), (150.0, 75.0)), angle, radius=40.0), (150.0, 75.0))


@pytest.mark.slow
def test_a_puck_that_slides_straight_does_not_turn_about_a_hub_far_away():
    """Its small rotation alone determines the distance of a hub, about which its path would be curved."""
    angle = 0.14 * np.linspace(0, 1, 40)
    path = np.stack([np.linspace(50, 250, 40), np.full(40, 75.0)], axis=1)
    with pytest.raises(TrackingError, match="straight line"):
        track_body(film(path, angle, radius=20.0))


@pytest.fixture(scope="module")
def puck(tmp_path_factory):
    """A file with the film of a puck."""
    target = tmp_path_factory.mktemp("puck") / "puck.mp4"
    path, angle = sliding()
    with av.open(str(target), "w") as container:
        stream = container.add_stream("libx264", rate=240)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for picture in film(path, angle).frames():
            frame = av.VideoFrame.from_ndarray(picture, format="gray")
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return target, angle


@pytest.mark.slow
def test_spindown_measures_a_puck(puck, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    source, angle = puck
    assert run(["spindown", str(source), "--capture-fps", "240", "--json"]) in (0, 3)
    document = json.loads(capsys.readouterr().out)
    assert document["motion"]["kind"] == "spin-down"
    assert document["motion"]["turns"] == pytest.approx(np.ptp(angle) / (2 * np.pi), rel=0.12)  # rest is cut
    assert any("moves across the picture" in w for w in document["warnings"])
    assert Path(document["picture"]).is_file()


@pytest.mark.slow
def test_profile_shows_a_body_where_there_are_no_markers(puck, tmp_path, capsys):
    target, picture = tmp_path / "puck.toml", tmp_path / "puck.png"
    assert run(["profile", str(puck[0]), "-o", str(target), "--picture", str(picture), "--json"]) == 3
    document = json.loads(capsys.readouterr().out)
    assert document["verdict"] == "no_markers"
    assert document["readings"][0]["hub_from"] == "outline"
    assert cv2.imread(str(picture)).shape[1] == 1600
    assert not target.exists()


@pytest.mark.parametrize(
    ("circle", "excursion", "moves"),
    [(0.45, 0.0, False), (0.55, 0.0, True), (0.1, 1.9, False), (0.1, 2.1, True)],
)
def test_a_hub_that_circles_or_is_displaced_once_moves(monkeypatch, circle, excursion, moves):
    """The distance of a circling hub from its mean position is constant."""

    class Moves(Exception):  # noqa: N818 - not an error
        pass

    def some(frames):
        raise Moves

    path = 60.0 + 50.0j + circle * np.exp(2j * np.pi * np.arange(400) / 400)
    path[[0, 200]] = 60.0 + 50.0j + np.array([1, -1]) * max(excursion, circle)
    found = np.zeros(400), path, np.zeros(400, dtype=int), None
    monkeypatch.setattr(_moving_hub, "_loose_motion", lambda *_: found)
    film = SimpleNamespace(frames=list, some=some)
    with pytest.raises(Moves) if moves else nullcontext():
        assert _moving_hub.track_by_features(film, np.arange(400), None) is None
