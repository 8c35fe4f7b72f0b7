"""A point about a pivot in rendered films: error and uncertainty, pivots, occlusion, refusals, and limits."""

import itertools
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import TrackingError, UsageError
from gyrotrack._column_store import StoredPictures
from gyrotrack.tracking import _diagnosis, _point_motion
from gyrotrack.tracking._diagnosis import MOSTLY_TRANSLATES, RefusedFilmError, refuse_moving_camera
from gyrotrack.tracking._point_motion import HUB_SHARE, TrackedPoint, about_pivot, follow_path, follow_point
from gyrotrack.tracking._point_tracker import PointPath


class Rendered:
    """Frames in memory with the interface of `Film`."""

    def __init__(self, frames):
        self._frames = frames
        self.path = Path("rendered.mp4")
        self.warnings, self.tilt = (), None
        self.changes = np.array([255.0] + [np.abs(b - a + 0.0).mean() for a, b in itertools.pairwise(frames)])
        self.selected = np.ones(len(frames), dtype=np.bool_)

    def __len__(self):
        return len(self._frames)

    def frames(self, first=0, stop=None):
        return iter(self._frames[first:stop])

    def some(self, index):
        return StoredPictures.of(len(index), (self._frames[i] for i in index))


def errors(found, film):
    """Error of the positions (n, 2) [px], apart from the place on the bob that was followed."""
    exact, angle = film.place[found.frame], film.angle(film.time)[found.frame]
    off = (found.place - exact).ravel(order="F")
    c, s = np.cos(angle), np.sin(angle)
    own = np.concatenate([np.stack([c, s], axis=1), np.stack([-s, c], axis=1)])
    return (off - own @ np.linalg.lstsq(own, off, rcond=None)[0]).reshape(2, -1).T


@pytest.mark.parametrize(
    "scene",
    [
        pytest.param({}, marks=pytest.mark.slow),
        {"hub": (80.0, 60.0), "length": 42.0, "speed": 3.0},
        pytest.param(
            {"hub": (80.0, 60.0), "length": 42.0, "speed": 45.0, "thread": False, "exposure": 0.05},
            marks=pytest.mark.slow,
        ),
        pytest.param({"noise": 6.0}, marks=pytest.mark.slow),
        pytest.param({"radius": 4.0}, marks=pytest.mark.slow),
    ],
    ids=["pivot outside", "turning", "0.9 rad a frame", "noise", "small"],
)
def test_positions_err_by_their_uncertainty_and_the_pivot_is_found(bob, scene):
    film = bob(**{"frames": 48} | scene)
    found = follow_point(Rendered(film.pictures()), tuple(film.place[0]))
    off = errors(found, film)
    assert len(found.frame) > 0.95 * film.frames
    assert 0.75 < float((off / found.place_sigma).std()) < 1.3
    bound = np.sqrt(np.trace(found.path.covariance, axis1=1, axis2=2).mean() / 2)
    assert off.std() < 1.5 * bound
    away = found.hub - np.array(film.hub)
    assert (
        away @ np.linalg.solve(found.hub_covariance, away) < 14
    )  # 3.3 standard deviations in two directions
    angle = found.angle - film.angle(film.time)[found.frame]
    assert angle.std() < 5e-3


@pytest.mark.slow
def test_the_bob_is_found_without_a_click_and_not_a_thrown_ball(bob):
    film = bob(frames=80)
    found = follow_point(Rendered(film.pictures()), None)
    assert "--point" in found.warnings[-2]
    assert errors(found, film).std() < 0.03

    class Thrown(bob):
        def angle(self, t):  # a single pass along the arc resembles a parabola
            return 0.3 - 0.25 * t

    with pytest.raises(TrackingError, match="No point that moves about a pivot"):
        follow_point(Rendered(Thrown(frames=60).pictures()), None)


@pytest.mark.slow
def test_an_occluded_bob_is_omitted_and_found_again(bob):
    film = bob(frames=70, bar=(74.0, 92.0))
    found = follow_point(Rendered(film.pictures()), tuple(film.place[0]))
    hidden = np.abs(film.place[:, 0] - 82.5) < 4.0  # more than half of it
    assert not set(np.flatnonzero(hidden)) & set(found.frame.tolist())
    assert 0.6 * (~hidden).sum() < len(found.frame)
    clear = np.abs(film.place[found.frame, 0] - 82.5) > 22.0
    assert errors(found, film)[clear].std() < 0.05
    assert any("occluded, lost" in w for w in found.warnings)


def test_a_click_beside_the_bob_names_where_it_is(bob):
    film = bob(texture=0.0)
    x, y = film.place[0]
    with pytest.raises(TrackingError, match="no detail to follow") as raised:
        follow_point(Rendered(film.pictures()), (15.0, 100.0))
    u, v = (float(n) for n in raised.value.hint.split("--point ")[1].rstrip(".").split(","))
    assert np.hypot(u - x, v - y) < 2.0


def test_a_point_outside_the_picture_or_at_rest_is_refused(bob):
    film = Rendered(bob(frames=20).pictures())
    with pytest.raises(UsageError, match="outside the picture of 160 x 120"):
        follow_point(film, (160.0, 20.0))
    with pytest.raises(TrackingError, match="does not move"):
        follow_point(film, (20.0, 100.0), (0.0, 0.0))


@pytest.mark.slow
def test_two_bobs_are_reported(bob):
    one, two = (bob(hub=(x, -120.0), amplitude=0.1, frames=44, thread=False) for x in (40.0, 120.0))
    frames = [np.minimum(a, b) for a, b in zip(one.pictures(), two.pictures(), strict=True)]
    with pytest.raises(TrackingError, match="Several bodies move"):
        follow_point(Rendered(frames), None)
    found = follow_point(Rendered(frames), tuple(two.place[0]))
    assert abs(found.hub[0] - 120.0) < 1.0


@pytest.mark.parametrize(("shown", "message"), [(6, "at least one is at rest"), (0, "No point that moves")])
def test_a_spot_at_rest_that_vanishes_is_reported_as_at_rest(bob, shown, message):
    moving = bob(hub=(40.0, -120.0), amplitude=0.1, frames=32, thread=False)
    rests = bob(hub=(120.0, -120.0), amplitude=0.0, frames=32, thread=False).pictures()
    both = enumerate(zip(moving.pictures(), rests, strict=True))
    frames = [np.minimum(a, b) if k < shown else a for k, (a, b) in both]
    with pytest.raises(TrackingError, match=message):
        follow_point(Rendered(frames), None)


@pytest.mark.parametrize(
    ("start", "second", "doubt"), [(None, "two", True), (None, None, False), ((80, 80), "two", False)]
)
def test_an_unselected_point_beside_another_rotation_is_ambiguous(monkeypatch, start, second, doubt):
    path = drawn()
    monkeypatch.setattr(_point_motion, "_check_unselected", lambda *_: None)
    monkeypatch.setattr(_point_motion, "_second_rotation", lambda *_: second)
    film = SimpleNamespace(path=SimpleNamespace(name="film.mp4"), warnings=(), tilt=None)
    found = _point_motion._of_path(film, path, start, None)
    assert found.ambiguous == doubt
    assert (found.warnings[-1] == second) == doubt


def drawn(radius=300.0, reach=0.2, hub=(80.0, -180.0), flat=1.0, count=160):
    """A path with white noise of 0.02 px on an arc, flattened across its middle as by a tilted camera."""
    rng = np.random.default_rng(3)
    angle = reach * np.sin(np.linspace(0, 40, count))
    place = np.array(hub) + radius * np.stack([np.sin(angle), flat * np.cos(angle)], axis=1)
    place += rng.normal(0, 0.02, place.shape)
    covariance = np.broadcast_to(4e-4 * np.eye(2), (count, 2, 2))
    return PointPath(np.arange(count), place, covariance, 9.0, count, turns=False, picture=np.zeros((9, 9)))


@pytest.mark.parametrize(("formal", "factor"), [(0.05, 2.0), (0.4, 1.0)])
def test_a_path_without_a_pivot_has_the_larger_of_bound_and_scatter(formal, factor):
    """White noise of 0.1 px beside a parabola."""
    t = np.linspace(0.0, 1.0, 600)
    place = np.stack([90.0 * t, 40.0 * t**2], axis=1) + np.random.default_rng(1).normal(0.0, 0.1, (600, 2))
    covariance = np.tile(formal**2 * np.eye(2), (600, 1, 1))
    path = PointPath(np.arange(600), place, covariance, 9.0, 600, turns=False, picture=np.zeros((9, 9)))
    assert _point_motion._white_scale(path) == pytest.approx(factor, rel=0.1)


@pytest.mark.parametrize("formal", [0.01, 0.1])
def test_positions_and_angles_have_the_uncertainty_of_their_scatter(formal):
    """White noise of 0.1 px at 90 px; the Cramer-Rao bound may be smaller."""
    rng = np.random.default_rng(1)
    true = np.linspace(0.0, 12.0, 400)
    exact = np.array([160.0, 120.0]) + 90.0 * np.stack([np.cos(true), -np.sin(true)], axis=1)
    covariance = np.tile(formal**2 * np.eye(2), (400, 1, 1))
    place = exact + rng.normal(0.0, 0.1, (400, 2))
    path = PointPath(np.arange(400), place, covariance, 9.0, 400, turns=False, picture=np.zeros((9, 9)))
    found = about_pivot(path, "film")
    assert found.place_sigma == pytest.approx(np.full((400, 2), 0.1), rel=0.15)
    assert found.sigma == pytest.approx(np.full(400, 0.1 / 90.0), rel=0.15)


def test_a_given_hub_near_the_centre_of_the_path_is_kept():
    found = about_pivot(drawn(), "film", (80.0, -180.0))
    assert not found.ambiguous
    assert found.hub.tolist() == [80.0, -180.0]
    # of a hub that is given, the distance is known within 2 % and scales all angles alike
    assert found.hub_covariance[1, 1] == pytest.approx(1.0 + (HUB_SHARE * 300.0) ** 2, rel=0.01)
    assert np.median(found.sigma) < 1e-4
    half = np.ptp(found.displaced()[1]) / np.ptp(found.angle)
    assert half == pytest.approx(1.0, abs=0.03)
    assert half != 1.0


@pytest.mark.parametrize(("y", "doubt"), [(-180.0, False), (-120.0, False), (50.0, True)])
def test_a_hub_that_the_path_contradicts_is_reported_with_both_answers(y, doubt):
    """A tilted camera explains a hub at 0.8 of the radius of curvature, and not one at a quarter of it."""
    found = about_pivot(drawn(), "film", (80.0, y))
    assert found.ambiguous == doubt
    if doubt:
        (text,) = found.warnings
        assert "Two pivots" in text
        assert "0.39" in text or "0.4 rad" in text  # 2 x 0.2 rad about the centre of the path
        assert "--hub" not in text


def test_a_tilted_camera_is_recognised_by_hub_and_path():
    """cos(tilt) = 0.8: the hub is at 0.8 of the length, the radius of curvature 1.25 of it."""
    path = drawn(flat=0.8)
    found = about_pivot(path, "film", (80.0, -180.0))
    assert not found.ambiguous
    assert "tilted by 37 degrees" in found.warnings[0]
    assert found.view == pytest.approx(-np.log(0.8), rel=0.05)
    assert abs(np.ptp(found.angle) / 2 - 0.2) < 3 * found.view * 0.2


@pytest.mark.slow
def test_an_arc_alone_has_the_uncertainty_of_the_view_and_a_full_circle_has_not():
    assert about_pivot(drawn(), "film").view == pytest.approx(0.106, rel=0.01)
    assert about_pivot(drawn(reach=3.2), "film").view == 0.0
    full = about_pivot(drawn(reach=3.2), "film", (81.0, -180.0))
    assert full.hub_covariance[0, 0] < 1e-3  # given and measured: the measured one is far better


def test_a_straight_path_asks_for_the_hub_and_takes_it():
    path = drawn(radius=1e5, reach=3e-4, hub=(80.0, -99900.0))
    with pytest.raises(TrackingError, match="straight within its uncertainty") as raised:
        about_pivot(path, "film")
    assert "--hub X,Y" in raised.value.hint
    assert not about_pivot(path, "film", (80.0, -400.0)).ambiguous


def test_a_path_without_a_pivot_is_still_a_path(bob):
    class Sliding(bob):
        def angle(self, t):
            return (0.25 - 0.3 * t) * 1e-3

    film = Sliding(hub=(80.0, -190000.0), length=190060.0, frames=48)
    found = follow_path(Rendered(film.pictures()), tuple(film.place[0]))
    assert isinstance(found, PointPath)
    assert (found.place - film.place[found.frame]).std(axis=0).max() < 0.05


@pytest.mark.parametrize(("off", "refused"), [(0.15, False), (0.3, True)])
def test_a_path_is_an_arc_if_four_fifths_of_it_are(off, refused):
    path = drawn()
    wrong = np.arange(len(path.place)) < off * len(path.place)
    path.place[wrong] += (0.0, 25.0)
    if refused:
        with pytest.raises(TrackingError, match="not an arc of a circle: 30 %"):
            about_pivot(path, "film")
    else:
        assert len(about_pivot(path, "film").frame) == (~wrong).sum()


@pytest.mark.parametrize(("extent", "doubt"), [(30.0, True), (60.0, False)])
def test_a_body_that_hides_its_own_background_is_doubted(extent, doubt):
    path = drawn(reach=extent / 600.0)
    path = PointPath(path.frame, path.place, path.covariance, 45.0, path.searched, path.turns, path.picture)
    assert about_pivot(path, "film").ambiguous == doubt


def _refusal(*, expected):
    return (
        pytest.raises(TrackingError, match="No point that moves about a pivot") if expected else nullcontext()
    )


@pytest.mark.parametrize(("count", "refused"), [(22, True), (60, False)])
def test_an_unselected_point_must_retrace_its_path(count, refused):
    """sin(x) over 40 rad in 160 samples: 22 samples turn back once, 60 four times."""
    path = drawn()
    some = PointPath(
        path.frame[:count], path.place[:count], path.covariance[:count], 9.0, count, False, path.picture
    )
    found = about_pivot(some, "film")
    with _refusal(expected=refused):
        _point_motion._check_unselected(found, "film")


@pytest.mark.parametrize("rest", [0.0, 0.6, 0.75])
def test_a_pendulum_that_rests_for_most_of_a_film_retraces_its_path(rest):
    """The noise of a bob at rest is no measure of its pace."""
    swing = np.clip((np.arange(160) - 160 * rest) / 40.0, 0.0, None)
    angle = 0.6 * np.sin(2 * np.pi * swing)
    place = np.array([80.0, 120.0]) + 60.0 * np.stack([np.sin(angle), -np.cos(angle)], axis=1)
    place += np.random.default_rng(0).normal(0, 0.02, place.shape)
    some = drawn()
    path = PointPath(some.frame, place, some.covariance, 6.0, 160, False, some.picture)
    _point_motion._check_unselected(about_pivot(path, "film"), "film")


@pytest.mark.parametrize("thrown", [True, False])
def test_a_ball_that_is_thrown_repeatedly_does_not_retrace_its_path(thrown):
    """Each throw passes the same arc in the same sense; a pendulum passes it in both."""
    phase = np.arange(160) / 30.0
    phase = phase % 1.0 if thrown else np.abs(phase % 2.0 - 1.0)
    angle = 2.4 * (phase - 0.5)
    place = np.array([80.0, 120.0]) + 60.0 * np.stack([np.sin(angle), -np.cos(angle)], axis=1)
    place += np.random.default_rng(0).normal(0, 0.05, place.shape)
    some = drawn()
    path = PointPath(some.frame, place, some.covariance, 6.0, 160, False, some.picture)
    found = about_pivot(path, "film")
    with _refusal(expected=thrown):
        _point_motion._check_unselected(found, "film")


@pytest.mark.parametrize("beside", [1.0 + 0.5j, -0.8 + 1.0j])
def test_a_point_beside_the_joint_is_corrected_by_the_distances(beside):
    """Two links in the complex plane; the point of the joint is displaced by a constant of the first link."""
    t = np.linspace(0.0, 6.0, 200)
    first, second = 0.8 * np.sin(2.0 * t), 2.5 * np.sin(3.1 * t + 0.4)
    away = 60.0 * np.exp(1j * second) - beside * np.exp(1j * first)
    length = np.abs(away) + np.random.default_rng(0).normal(0, 0.02, len(t))
    measured = np.unwrap(np.angle(away))
    shift, u, rest = _point_motion._beside_joint(length, measured - first)
    before, after = measured - second, measured + shift / length - second
    assert np.std(after) < 0.1 * np.std(before)
    assert np.abs(after).max() < 1e-3
    assert rest == pytest.approx(0.02, rel=0.15)
    assert 1e-3 < np.median(u) < rest


@pytest.mark.parametrize(("steps", "retraces"), [(4, True), (6, False)])
def test_a_step_of_five_times_the_median_is_a_jump(steps, retraces):
    """A ball is thrown again and again: only a return in small steps retraces the path."""
    angle = np.tile(np.linspace(0.0, 1.0, steps + 1), 8)
    place = 100.0 * np.stack([np.cos(angle), -np.sin(angle)], axis=1)
    path = SimpleNamespace(place=place, frame=np.arange(len(angle)), searched=len(angle))
    found = SimpleNamespace(path=path, angle=angle, arc=SimpleNamespace(noise=0.1, by_place=0.0))
    if retraces:
        _point_motion._check_unselected(found, "film")
    else:
        with pytest.raises(TrackingError, match="No point that moves about a pivot"):
            _point_motion._check_unselected(found, "film")


@pytest.mark.parametrize(("off", "refused"), [(0.69, False), (0.71, True)])
def test_a_picture_that_mostly_translates_is_not_a_suspended_body(off, refused, monkeypatch):
    """The limit is an rms residual of 70 % from the displacements about the best hub."""
    monkeypatch.setattr(_diagnosis, "camera_motion", lambda *_: (2.0, 0.9, off))
    film = SimpleNamespace(path=SimpleNamespace(name="film"), some=lambda index: [None] * len(index))
    if refused:
        with pytest.raises(RefusedFilmError, match="residual 71 %"):
            refuse_moving_camera(film, np.arange(9), [], (9, 9), MOSTLY_TRANSLATES)
    else:
        refuse_moving_camera(film, np.arange(9), [], (9, 9), MOSTLY_TRANSLATES)


def test_the_angles_of_a_link_share_the_errors_of_pivot_and_place():
    """At 50 px, sqrt(0.4^2 + (0.8^2 + 0.6^2) / 2) px = 0.812 px are 16.2 mrad, beside 10 mrad."""
    place = np.array([[60.0, 10.0], [10.0, 60.0]])
    found = SimpleNamespace(
        place=place,
        hub=np.array([10.0, 10.0]),
        hub_covariance=np.diag([0.64, 0.36]),
        arc=SimpleNamespace(by_place=0.4),
        sigma=np.array([0.01, 0.01]),
    )
    sigma = TrackedPoint.whole_sigma.fget(found)
    assert sigma == pytest.approx([np.hypot(0.01, np.sqrt(0.66) / 50.0)] * 2)
