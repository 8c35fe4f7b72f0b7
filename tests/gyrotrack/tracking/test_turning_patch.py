"""The rotation of a patch that is followed, and what a click on a silhouette selects, against drawn pictures."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from gyrotrack.tracking import _point_motion, _point_tracker
from gyrotrack.tracking._point_motion import TrackedPoint
from gyrotrack.tracking._point_tracker import PointPath
from gyrotrack.tracking._silhouettes import Foreground, Spot

TIME = np.arange(40) / 40.0
TURNS = np.linspace(0.0, 7.0, 60)
FULL = np.full((120, 160), 90.0, np.float32)


def _pattern(seed=0, contrast=25.0):
    """A texture of 60 x 60 px about the centre of a body."""
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=(61, 61)), (0, 0), 2.0)
    return (140.0 + contrast * noise / noise.std()).astype(np.float32)


def _frame(pattern, place, turn, radius=9.0):
    """The disc of a pattern about a place, turned clockwise as seen."""
    y, x = np.mgrid[0:120, 0:160].astype(np.float32)
    c, s = np.cos(turn), np.sin(turn)
    dx, dy = x - place[0], y - place[1]
    shown = cv2.remap(
        pattern,
        (30 + c * dx + s * dy).astype(np.float32),
        (30 - s * dx + c * dy).astype(np.float32),
        cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REPLICATE,
    )
    cover = np.clip(radius + 0.5 - np.hypot(dx, dy), 0.0, 1.0)
    return (FULL + cover * (shown - FULL)).astype(np.float32)


def _spot(place, radius):
    half = int(radius) + 1
    v, u = np.ogrid[-half : half + 1, -half : half + 1]
    return Spot(place, radius, (np.hypot(u, v) <= radius).astype(np.uint8))


@pytest.mark.parametrize(("contrast", "seen"), [(25.0, True), (0.0, False)])
def test_the_rotation_of_a_patch_is_followed_where_its_picture_shows_it(contrast, seen):
    turn = 1.2 * np.sin(6.0 * TIME)
    place = np.stack([80 + 30 * np.sin(5 * TIME), 60 + 10 * TIME], axis=1)
    pattern = _pattern(contrast=contrast)
    frames = [np.rint(_frame(pattern, p, a)).astype(np.uint8) for p, a in zip(place, turn, strict=True)]
    film = SimpleNamespace(frames=lambda: iter(frames))
    there, turns, found = _point_tracker._follow(
        film, np.arange(len(frames)), _spot(tuple(place[0]), 8.0), FULL
    )
    assert found.all()
    assert np.abs(there - place).max() < 0.5
    assert np.abs(turns - (turn if seen else 0.0)).max() < 0.05


def test_a_patch_is_where_its_covariance_says():
    """A picture of known layers, with white noise of 5 grey levels."""
    v, u = np.mgrid[-12:13, -12:13].astype(np.float64)
    spot = 90.0 * np.exp(-0.5 * (np.hypot(u, v) / 3.0) ** 2)
    layers = _point_tracker._Layers(
        np.stack([u, v]),
        np.ones(u.shape, np.float32),
        spot.astype(np.float32),
        np.full(u.shape, 25.0, np.float32),
        FULL,
    )
    y, x = np.mgrid[0:120, 0:160]
    rng, error, claimed = np.random.default_rng(3), [], []
    for _ in range(60):
        at = np.array([80.0, 60.0]) + rng.uniform(-0.5, 0.5, 2)
        clean = FULL + 90.0 * np.exp(-0.5 * (np.hypot(x - at[0], y - at[1]) / 3.0) ** 2)
        frame = (clean + rng.normal(0.0, 5.0, clean.shape)).astype(np.float32)
        place, covariance, misfit, _ = layers.register(frame, np.array([80.0, 60.0]), 0.0)
        error.append(place - at)
        claimed.append(np.diag(covariance))
    assert misfit < 1.5
    assert np.std(error, axis=0) / np.sqrt(np.mean(claimed, axis=0)) == pytest.approx(1.0, abs=0.25)


def test_a_large_patch_is_followed_in_a_reduced_picture(monkeypatch):
    """Of means of 2 x 2 px: half of the noise, and half of all lengths."""
    covariance = 0.01**2 * np.eye(2)[None]
    small = PointPath(np.zeros(1), np.array([[10.0, 20.0]]), covariance, 12.0, 1, False, FULL)
    asked = []
    monkeypatch.setattr(_point_tracker, "_tracked", lambda *args, **_: asked.append(args) or small)
    seen = SimpleNamespace(noise=4.0, background=FULL)
    found = _point_tracker._track_spot(
        None, np.zeros(1), _spot((20.5, 40.5), 24.0), seen, None, None, (20.0, 40.0)
    )
    assert found.place == pytest.approx(np.array([[20.5, 40.5]]))
    assert found.covariance == pytest.approx(0.02**2 * np.eye(2)[None])
    assert found.radius == 24.0
    _, _, spot, background, noise, *_ = asked[0]
    assert (spot.place, spot.radius, noise) == ((10.0, 20.0), 12.0, 2.0)
    assert background.shape == (60, 80)


@pytest.mark.parametrize(("away", "caught"), [(0.8, True), (2.5, False)])
def test_a_rotation_is_caught_up_to_five_steps_at_the_edge_away(away, caught):
    """Five steps of 1.5 px at 8 px are 0.94 rad."""
    pattern = _pattern(1)
    picture = _frame(pattern, (80.0, 60.0), away)
    spot = _spot((80.0, 60.0), 8.0)
    template = _point_tracker._cut(
        _frame(pattern, (80.0, 60.0), 0.0), np.array([80.0, 60.0]), spot.mask.shape[0]
    )
    found = _point_tracker._best_turn(
        picture, np.array([80.0, 60.0]), 0.0, template, spot.mask.astype(np.float32), 0.0
    )
    assert (found is not None and abs(found.turn - away) < 0.02) == caught


def _seen(picture, noise=0.5):
    return Foreground([picture], FULL, noise)


@pytest.mark.parametrize(
    ("width", "length", "click", "body"),
    [
        (30, 45, (80.0, 60.0), True),  # compact
        (30, 90, (80.0, 60.0), False),  # three times as long as wide
        (30, 90, (110.0, 60.0), False),  # far from the centroid
    ],
)
def test_a_click_on_a_long_body_selects_the_place_and_on_a_compact_one_the_body(width, length, click, body):
    rng = np.random.default_rng(0)
    picture = FULL + rng.normal(0, 0.5, FULL.shape)
    rows, columns = (
        slice(60 - width // 2, 60 + width // 2),
        slice(80 - length // 2, 80 + length // 2),
    )
    picture[rows, columns] = (
        180 + cv2.GaussianBlur(rng.normal(0, 60, picture.shape), (0, 0), 2.0)[rows, columns]
    )
    spot = next(_point_tracker._clicked(picture.clip(0, 255).astype(np.uint8), _seen(picture), click))
    if body:
        assert spot.radius == pytest.approx(np.sqrt(width * length / np.pi), rel=0.15)
    else:
        assert spot.place == click
        assert spot.radius <= 15.0


def test_a_frame_with_less_noise_has_the_noise_of_the_film():
    """A difference of two grey levels is a body if the noise is small."""
    background = np.full(FULL.shape, 100.0)
    frame = background.astype(np.uint8)
    frame[50:70, 70:90] += 2
    spot = next(_point_tracker._clicked(frame, _seen(background, 5.0), (80.0, 60.0)))
    assert spot.place == pytest.approx((79.5, 59.5), abs=0.5)
    assert spot.radius == pytest.approx(np.sqrt(400 / np.pi), rel=0.1)
    with pytest.raises(_point_tracker.TrackingError, match="no detail to follow"):
        next(_point_tracker._clicked(frame, _seen(background, 10.0), (80.0, 60.0)))


def test_a_blank_long_body_is_followed_as_a_whole():
    picture = FULL.copy()
    picture[50:70, 40:120] = 180.0
    (spot,) = _point_tracker._clicked(picture.astype(np.uint8), _seen(picture), (80.0, 60.0))
    assert spot.place == pytest.approx((79.5, 59.5), abs=1.0)


def test_the_second_choice_is_tried_where_the_first_one_is_lost(monkeypatch):
    tried = []

    def lost(film, usable, spot, *rest):
        tried.append(spot)
        if len(tried) == 1:
            raise _point_tracker.TrackingError("lost", "")
        return spot

    monkeypatch.setattr(_point_tracker, "_track_spot", lost)
    monkeypatch.setattr(_point_tracker, "frames_of_one_shot", lambda _: np.arange(60))
    monkeypatch.setattr(_point_tracker, "_clicked", lambda *_: iter(["body", "patch", "more"]))
    film = SimpleNamespace(some=lambda _: [np.zeros((9, 9), np.uint8)])
    assert _point_tracker.track_point(film, (3.0, 3.0), lambda *_: None, seen=_seen(FULL)) == "patch"
    assert tried == ["body", "patch"]


@pytest.mark.parametrize(
    ("beside", "off", "found"),
    [((0.6, -0.4), 1.0, True), ((6.0, -4.0), 7.3, True), ((0.0, 0.0), 1.0, False)],
)
def test_a_point_beside_the_joint_on_the_second_link_is_corrected(beside, off, found):
    t = np.linspace(0.0, 12.0, 200)
    first, second = 0.7 * np.sin(t), 1.1 * np.sin(1.7 * t + 1.0)  # counter-clockwise
    joint = np.array([160.0, 80.0]) + 90.0 * np.stack([np.cos(first), -np.sin(first)], axis=1)
    c, s = np.cos(second), np.sin(second)
    away = np.stack([c * beside[0] + s * beside[1], -s * beside[0] + c * beside[1]], axis=1)
    noise = np.random.default_rng(0).normal(0, 0.05, joint.shape)
    path = PointPath(
        np.arange(200), joint + away + noise, np.tile(0.05**2 * np.eye(2), (200, 1, 1)), 9.0, 200, True, FULL
    )
    link = SimpleNamespace(frame=np.arange(200), angle=second)
    corrected = _point_motion._on_second_link(SimpleNamespace(path=path), link, off)
    assert (corrected is not None) == found
    if corrected is not None:
        moved, shared = corrected
        assert np.abs(moved.place - joint - noise).max() < 0.1
        assert np.all(np.linalg.eigvalsh(shared) > 0)


def test_the_error_of_a_displacement_on_the_second_link_is_in_the_first_angle():
    """The places of a joint share an error along x: of its angle on the right of the pivot it is no part."""
    theta = np.array([0.0, -np.pi / 2])
    place = 50.0 * np.stack([np.cos(theta), -np.sin(theta)], axis=1)
    size = np.full((2, 2), 0.1)
    path = PointPath(np.arange(2), place, np.zeros((2, 2, 2)), 9.0, 2, True, FULL)
    joint = TrackedPoint(
        np.arange(2), place, size, theta, size[0] / 50, np.zeros(2), np.eye(2), 0.0, "", path, None, ()
    )
    found = _point_motion._with_error(joint, np.tile(np.diag([0.3**2, 0.0]), (2, 1, 1)))
    assert found.sigma * 50 == pytest.approx([0.1, np.hypot(0.1, 0.3)])
    assert found.place_sigma == pytest.approx(np.array([[np.hypot(0.1, 0.3), 0.1]] * 2))


@pytest.mark.parametrize(("first", "off"), [(0, np.hypot(1.0, 5.0)), (3, 1.0)])
def test_a_click_is_compared_with_the_joint_in_the_first_frame_alone(monkeypatch, first, off):
    """The joint is 5 px beside the click in the first frame that shows it, which may be a later one."""
    seen = []
    joint = SimpleNamespace(frame=np.array([first]), place=np.array([[3.0, 4.0]]))
    monkeypatch.setattr(_point_motion, "follow_point", lambda *_: joint)
    monkeypatch.setattr(_point_motion, "track_point", lambda *_: None)
    monkeypatch.setattr(_point_motion, "fresh_frames", lambda _: np.arange(9))
    monkeypatch.setattr(_point_motion, "second_link", lambda *args: seen.append(args[-1]))
    monkeypatch.setattr(_point_motion, "_on_second_link", lambda *_: None)
    monkeypatch.setattr(_point_motion, "_with_error", lambda *_: None)
    _point_motion.follow_links(SimpleNamespace(path=SimpleNamespace(name="film.mp4")), ((0, 0), (9, 9)))
    assert seen == [pytest.approx(off)]


@pytest.mark.parametrize("size", [0.1, 0.4])
def test_errors_that_neighbouring_frames_share_count_along_the_path_as_across(size):
    """White noise of 0.1 px is seen along the path; the errors of a codec only across it, as residuals of the arc."""
    from gyrotrack.tracking._point_motion import about_pivot

    rng = np.random.default_rng(1)
    theta = 0.8 * np.sin(np.linspace(0, 20, 400))
    error = np.apply_along_axis(
        lambda v: np.convolve(v, np.ones(9) / 3.0, "same"), 0, rng.normal(0, size, (400, 2))
    )
    place = np.array([160.0, 60.0]) + 90.0 * np.stack([np.sin(theta), np.cos(theta)], axis=1) + error
    path = PointPath(np.arange(400), place, np.tile(0.01**2 * np.eye(2), (400, 1, 1)), 9.0, 400, True, FULL)
    found = about_pivot(path, "film.mp4", (160.0, 60.0))
    assert isinstance(found, TrackedPoint)
    z = (found.angle - theta - np.mean(found.angle - theta)) / found.sigma
    assert 0.7 < float(np.sqrt(np.mean(z**2))) < 1.4


@pytest.mark.parametrize(("rod", "body"), [(0.6, True), (0.8, False)])
def test_a_click_on_a_bob_on_rods_selects_the_bob_where_the_rods_are_narrower(rod, body):
    """The limit is a depth of 0.7 times the inscribed radius, 14 px, at 1.5 times this radius."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:120, 0:160]
    inside = (np.hypot(x - 110, y - 60) < 14.0) | ((np.abs(y - 60) < rod * 14.0) & (x < 110))
    texture = 180 + cv2.GaussianBlur(rng.normal(0, 60, FULL.shape), (0, 0), 2.0)
    picture = np.where(inside, texture, FULL).clip(0, 255)
    click = (115.0, 60.0)
    spot = next(_point_tracker._clicked(picture.astype(np.uint8), _seen(picture), click))
    assert (spot.place != click) == body


@pytest.mark.parametrize(("width", "radius"), [(12, 6.0), (26, 11.0), (70, 15.0)])
def test_a_patch_on_a_silhouette_is_as_large_as_this_allows(width, radius):
    rng = np.random.default_rng(0)
    picture = FULL.copy()
    texture = 180 + cv2.GaussianBlur(rng.normal(0, 80, FULL.shape), (0, 0), 1.5)
    picture[60 - width // 2 : 60 + width // 2, 5:155] = texture[60 - width // 2 : 60 + width // 2, 5:155]
    frame = picture.clip(0, 255).astype(np.uint8)
    assert _point_tracker._patch_at(frame, FULL, 0.5, (80.0, 60.0)).radius == radius


@pytest.mark.parametrize(("long", "whole"), [(1.0, False), (0.5, True)])
def test_the_edge_of_a_round_patch_does_not_show_its_rotation(long, whole):
    v, u = np.mgrid[-12:13, -12:13]
    mask = (np.hypot(u, v / long) <= 12).astype(np.float32)
    assert (_point_tracker._interior(mask).sum() == mask.sum()) == whole


@pytest.mark.parametrize(("turned", "keeps"), [(1.0, False), (1.04, False), (1.07, True)])
def test_a_patch_certainly_keeps_its_orientation_if_it_fits_worse_when_turned(monkeypatch, turned, keeps):
    """A round bob of one shade fits alike; the limit is a residual of 0.95 times that of the turned patch."""
    place = 30.0 * np.stack([np.cos(TURNS), np.sin(TURNS)], axis=1)
    count = len(place)
    follow = place, np.zeros(count), np.ones(count, dtype=bool)
    monkeypatch.setattr(_point_tracker, "_follow", lambda *_: follow)

    def learnt(film, frame, place, turn, *_):
        return SimpleNamespace(place=place, turn=turn, residual=1.0 if turn is None else turned)

    def measured(film, frame, best, *_):
        return PointPath(frame, best.place, np.tile(np.eye(2), (count, 1, 1)), 9.0, count, False, FULL)

    monkeypatch.setattr(_point_tracker, "_learnt", learnt)
    monkeypatch.setattr(_point_tracker, "_measured", measured)
    film, spot = SimpleNamespace(path=SimpleNamespace(name="film.mp4")), SimpleNamespace(radius=9.0)
    path = _point_tracker._tracked(
        film, np.arange(count), spot, FULL, 1.0, lambda *_: TURNS, None, where=(0, 0), unselected=False
    )
    assert path.keeps == keeps


@pytest.mark.parametrize(
    ("keeps", "range_", "said"), [(True, 3.3, True), (True, 3.0, False), (False, 3.3, False)]
)
def test_a_body_that_keeps_its_orientation_is_reported_beyond_half_a_turn(keeps, range_, said):
    theta = np.linspace(0.0, range_, 200)
    place = 160.0 + 90.0 * np.stack([np.cos(theta), -np.sin(theta)], axis=1)
    place += np.random.default_rng(0).normal(0, 0.03, place.shape)
    path = PointPath(
        np.arange(200), place, np.tile(0.03**2 * np.eye(2), (200, 1, 1)), 9.0, 200, False, FULL, keeps
    )
    film = SimpleNamespace(path=SimpleNamespace(name="film.mp4"), tilt=None, warnings=())
    found = _point_motion._of_path(film, path, (250.0, 160.0), None)
    assert any("not the orientation of the body" in w for w in found.warnings) == said


def test_the_angles_of_a_joint_contain_the_error_by_rods_in_its_patch(monkeypatch):
    """0.05 px across a link of 50 px, beside 1 mrad."""
    place = 50.0 * np.stack([np.cos(TURNS), -np.sin(TURNS)], axis=1)
    count = len(place)
    none = np.zeros((count, 2, 2))
    path = PointPath(np.arange(count), place, none, 9.0, count, True, FULL)
    joint = TrackedPoint(
        np.arange(count),
        place,
        np.zeros((count, 2)),
        TURNS,
        np.full(count, 1e-3),
        np.zeros(2),
        np.zeros((2, 2)),
        0.0,
        "",
        path,
        None,
        (),
    )
    monkeypatch.setattr(_point_motion, "follow_point", lambda *_: joint)
    monkeypatch.setattr(_point_motion, "track_point", lambda *_: path)
    monkeypatch.setattr(_point_motion, "fresh_frames", lambda _: np.arange(count))
    monkeypatch.setattr(_point_motion, "second_link", lambda *_: None)
    monkeypatch.setattr(_point_motion, "_on_second_link", lambda *_: None)
    found, _ = _point_motion.follow_links(
        SimpleNamespace(path=SimpleNamespace(name="film.mp4")), ((0, 0), (9, 9))
    )
    assert found.sigma == pytest.approx(np.full(count, np.hypot(1e-3, 0.05 / 50)))


def test_a_patch_that_changes_is_matched_with_its_last_picture(monkeypatch):
    """A disc of 100 grey levels on a background: the limit of a match is 0.35 of 100^2 = 3500."""
    frame = np.full((120, 160), 60, np.uint8)
    v, u = np.mgrid[0:120, 0:160]
    frame[np.hypot(u - 80, v - 60) <= 13] = 160
    spot = _spot((80.0, 60.0), 8.0)
    half = spot.mask.shape[0] // 2
    wide = cv2.dilate(spot.mask, np.ones((5, 5), np.uint8)) > spot.mask
    assert wide.any()
    frame[np.hypot(u - 80, v - 60) > 8.6] = 60
    # by frame: results of the window with the first and with the last picture, and of the whole frame, in limits
    results = [
        [((90.0, 70.0), 0.6)],
        [((91.0, 71.0), 0.6), ((92.0, 72.0), 0.4)],
        [((93.0, 73.0), 0.6), ((94.0, 74.0), 0.7)],
        [((0.0, 0.0), 1.3), ((0.0, 0.0), 1.2), ((95.0, 75.0), 0.9)],
        [((0.0, 0.0), 1.3), ((0.0, 0.0), 1.2), ((0.0, 0.0), 1.1)],
        [((96.0, 76.0), 0.2)],
    ]
    asked, aligned = [], []

    limit = []

    def in_window(picture, changed, place, reach, template, mask, change):
        k = next(i for i, r in enumerate(results) if r)
        asked.append((k, "window", np.array(place) - half, reach, template))
        best, share = results[k].pop(0)
        return best, share * 3500.0

    def in_whole(picture, changed, shrink, template, mask, change, most):
        k = next(i for i, r in enumerate(results) if r)
        asked.append((k, "whole", None, None, template))
        limit.append((most, change, shrink))
        best, share = results[k].pop(0)
        return best, share * 3500.0

    def best_turn(picture, place, turn, template, mask, usual):
        aligned.append((place.tolist(), template, turn, usual))

    monkeypatch.setattr(_point_tracker, "_in_window", in_window)
    monkeypatch.setattr(_point_tracker, "_in_whole", in_whole)
    monkeypatch.setattr(_point_tracker, "_best_turn", best_turn)
    film = SimpleNamespace(frames=lambda: iter([frame] * 9))
    place, turns, found = _point_tracker._follow(
        film, np.array([0, 1, 2, 3, 5, 6, 8]), spot, np.full_like(frame, 60)
    )
    assert found.tolist() == [True, True, True, True, True, False, True]
    assert place[found] + half == pytest.approx(
        np.array([(80.0 + half, 60.0 + half), (90, 70), (92, 72), (93, 73), (95, 75), (96, 76)])
    )
    assert np.isnan(place[5]).all()
    assert not turns.any()
    assert [(k, kind) for k, kind, *_ in asked] == [
        (0, "window"), (1, "window"), (1, "window"), (2, "window"), (2, "window"),
        (3, "window"), (3, "window"), (3, "whole"), (4, "window"), (4, "window"), (4, "whole"), (5, "window"),
    ]  # fmt: skip
    anchor = asked[0][4]
    second, third = asked[2][4], asked[4][4]
    assert all(entry[4] is anchor for entry in (asked[1], asked[3], asked[5], asked[8], asked[11]))
    assert second is not anchor
    # a match of 0.4 of the limit renews nothing; the later ones of 0.6 and 0.9 do
    assert third is second
    assert asked[6][4] is not second
    assert asked[7][4] is asked[6][4]
    templates = [entry[1] for entry in aligned]
    assert [t is anchor for t in templates] == [True, False, True, False, True]
    assert templates[1] is second
    assert limit == [(pytest.approx(3500.0), pytest.approx(4000.0), pytest.approx(1.6))] * 2
    # 1.2 radii and twice the radius, or the last step; after a loss the last place without a step
    assert asked[0][3] == pytest.approx(1.2 * 8.0 + 2.0 * 8.0)
    assert asked[1][3] == pytest.approx(1.2 * 8.0 + np.hypot(10.0 - half, 10.0 - half))
    assert asked[11][2] + half == pytest.approx([95.0, 75.0])
    assert asked[11][3] == pytest.approx(1.2 * 8.0 + 2.0 * 8.0)
