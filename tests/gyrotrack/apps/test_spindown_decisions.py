"""Which tracker a film gets, what a recording contains, which law is refused: with trackers and fits that are stubs."""

import math
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fitting import FittingError
from gyrotrack import DatasetError, TrackingError, UsageError, VideoError
from gyrotrack.apps import _points, _spindown
from gyrotrack.apps._motion import BodyMotion, Value
from gyrotrack.apps._spindown import SpindownOptions
from gyrotrack.io.readers._run import Limits
from gyrotrack.tracking._diagnosis import RefusedFilmError
from gyrotrack.tracking._film import Tilt
from gyrotrack.tracking._point_motion import TrackedPoint
from gyrotrack.tracking._point_tracker import PointPath

VALUE = Value(2.0, 0.1)


def motion(kind="spin-down", **changed):
    usual = {"turns": 5.0, "omega": {"first": 4.0, "last": -3.0}, "omega_mean": VALUE, "alpha": VALUE}
    return BodyMotion(kind, **(usual | changed))


class StubFilm:
    """A film of `count` frames at 50 per second; its frames are plain."""

    def __init__(self, folder=Path(), count=40, **info):
        usual = {
            "tag_fps": None,
            "container_fps": 50.0,
            "width": 120,
            "height": 90,
            "time_base": 0.001,
            "frames_declared": count + 1,
        }
        self.info = SimpleNamespace(**(usual | info))
        self.path = folder / "wheel.mp4"
        self.stamps = np.arange(count) / 50
        self.selected = np.ones(count, dtype=bool)
        self.warnings = ("film",)
        self.interlaced, self.stabilised, self.tilt = False, False, None
        if folder != Path():
            self.path.write_bytes(b"film")

    def __len__(self):
        return len(self.stamps)

    def levelled(self, place):
        return tuple(np.array(place) + 100)

    def seen(self, places):
        return places + 1000

    def frames(self, first, last):
        yield np.zeros((90, 120))


# ---- the capture rate and the limits


def test_capture_rate_is_the_option_or_the_tag_or_that_of_the_container():
    film = StubFilm()
    assert _spindown._rate(film, 240.0) == (240.0, "--capture-fps", [])
    assert _spindown._rate(film, None)[:2] == (50.0, "container")
    for fps, warned in ((99.0, True), (100.0, False), (120.0, False)):
        film.info.container_fps = fps
        assert bool(_spindown._rate(film, None)[2]) == warned
    film.info.tag_fps = 960.0
    assert _spindown._rate(film, None) == (960.0, "tag of the camera", [])
    film.interlaced = True
    fps, origin, (text,) = _spindown._rate(film, 25.0)
    assert (fps, origin) == (50.0, "--capture-fps")
    assert "50 fields" in text
    for wrong in (0.0, -1.0, math.inf, math.nan):
        with pytest.raises(VideoError, match="Invalid"):
            _spindown._rate(film, wrong)
    film.info.tag_fps, film.info.container_fps = None, math.nan
    with pytest.raises(VideoError, match="does not state"):
        _spindown._rate(film, None)


def test_frames_outside_the_limits_are_not_tracked():
    film = StubFilm()
    film.selected[10] = False
    _spindown._limit(film, SpindownOptions())
    assert film.selected.sum() == 39
    assert film.warnings == ("film",)
    _spindown._limit(film, SpindownOptions(limits=Limits(start=0.101, stop=0.7)))
    assert np.flatnonzero(film.selected).tolist() == [*range(6, 10), *range(11, 36)]
    assert film.warnings[0] == "film"
    assert "10 of 40" in film.warnings[1]
    fast = StubFilm()
    _spindown._limit(fast, SpindownOptions(capture_fps=100.0, limits=Limits(start=0.101)))
    assert fast.selected.sum() == 29
    for limits in (Limits(stop=0.2), Limits(cuts=((0.1, 0.7),))):
        film = StubFilm()
        _spindown._limit(film, SpindownOptions(limits=limits))
        assert film.selected.sum() == 11 if limits.stop else 0 < film.selected.sum() < 12


# ---- the order of the trackers


def refused(kind):
    return RefusedFilmError("No.", "Hint.", kind=kind, evidence={})


@pytest.fixture
def trackers(monkeypatch):
    """Stubs of all trackers; `state` has what each of them returns or raises, and `calls` their order."""
    calls, state = [], {"markers": None, "silhouette": None}

    def stub(name):
        def call(*args, **options):
            calls.append((name, args, options) if name != "look" else name)
            key = "free" if options.get("free") else name
            found = state[key]
            if isinstance(found, Exception):
                raise found
            return found

        return call

    state["look"] = SimpleNamespace(seen="seen", long=None, pendulum=False)
    for name, key in (
        ("first_look", "look"), ("film_recording", "film"), ("point_recording", "point"),
        ("_papers_markers", "markers"), ("_by_silhouette", "silhouette"), ("extract", "extract"),
    ):  # fmt: skip
        monkeypatch.setattr(_spindown, name, stub(key))
    film = StubFilm(tag_fps=30.0)
    monkeypatch.setattr(
        _spindown, "Film", lambda _, **options: (calls.append(("open", (), options)), film)[1]
    )
    state["names"] = lambda: [c if isinstance(c, str) else c[0] for c in calls]
    state["calls"], state["opened"] = calls, film
    return state


def tracked(x=10.0, y=20.0):
    return SimpleNamespace(width=120, height=90), SimpleNamespace(ring=SimpleNamespace(hub=(x, y)))


def run(**options):
    return _spindown._film(Path("a.mp4"), SpindownOptions(**options), None)


def test_a_point_or_a_colour_is_followed_at_once(trackers):
    trackers["point"] = ("recording", "point")
    for options in ({"point": (1.0, 2.0)}, {"colour": "red"}):
        trackers["calls"].clear()
        assert run(**options) == ("recording", (trackers["opened"], "point"))
        assert trackers["names"]() == ["open", "point"]
    assert trackers["calls"][0][2] == {"colour": "red", "tilt": None}


def test_a_profile_is_used_alone(trackers, monkeypatch):
    trackers["extract"] = "recording"
    monkeypatch.setattr(_spindown, "load", lambda path: path)
    assert run(profile=Path("p.toml")) == ("recording", None)
    assert trackers["names"]() == ["extract"]


def test_a_selected_body_of_the_paper_is_tried_first(trackers):
    trackers["markers"], trackers["film"] = "markers", tracked()
    assert run(body="rotor") == ("markers", None)
    assert trackers["names"]() == ["open", "markers"]
    assert run()[1][1] is trackers["film"][1]
    trackers["markers"] = None
    assert run(body="rotor")[1][1] is trackers["film"][1]


@pytest.mark.parametrize(
    ("hub", "inside"),
    [
        ((0, 0), True),
        ((119.9, 89.9), True),
        ((-0.1, 5), False),
        ((120, 5), False),
        ((5, -0.1), False),
        ((5, 90), False),
    ],
)
def test_a_point_is_followed_if_the_hub_is_outside_the_picture(trackers, hub, inside):
    trackers["film"], trackers["point"] = tracked(*hub), ("recording", "point")
    assert run()[1][1] == (trackers["film"][1] if inside else "point")
    trackers["point"] = TrackingError("no", "no")
    assert run()[1][1] is trackers["film"][1]


@pytest.mark.parametrize("kind", ["cut", "no motion", "two bodies", "two links"])
def test_films_that_no_method_tracks_are_refused_at_once(trackers, kind):
    trackers["film"] = refused(kind)
    with pytest.raises(RefusedFilmError):
        run()
    assert trackers["names"]() == ["open", "look", "silhouette", "film"]


def test_markers_then_a_point_then_a_moving_body_are_tried(trackers):
    error = TrackingError("none", "none")
    trackers["film"] = error
    trackers["markers"] = "markers"
    assert run() == ("markers", None)
    trackers["markers"], trackers["point"] = None, ("recording", "point")
    trackers["calls"].clear()
    assert run() == ("recording", (trackers["opened"], "point"))
    assert trackers["names"]() == ["open", "look", "silhouette", "film", "markers", "point"]
    assert trackers["calls"][-1][1][-1] == "seen"
    trackers["opened"].stabilised = True
    run()
    assert trackers["calls"][-1][1][-1] is None
    trackers["point"], trackers["free"] = TrackingError("other", "other"), ("free", "body")
    assert run() == ("free", (trackers["opened"], "body"))
    trackers["free"] = TrackingError("third", "third")
    with pytest.raises(TrackingError) as raised:
        run()
    assert raised.value is error
    trackers["point"] = refused("several")
    with pytest.raises(RefusedFilmError) as raised:
        run()
    assert raised.value is trackers["point"]
    # a selected body was searched before, and is not searched by its markers again
    trackers["calls"].clear()
    with pytest.raises(RefusedFilmError):
        run(body="rotor")
    assert trackers["names"]().count("markers") == 1


def test_a_moving_camera_is_only_tried_with_markers(trackers):
    trackers["film"] = refused("moving camera")
    with pytest.raises(RefusedFilmError):
        run()
    assert trackers["names"]()[-1] == "markers"
    trackers["markers"] = "markers"
    assert run() == ("markers", None)


def test_a_silhouette_is_followed_before_the_texture(trackers):
    trackers["silhouette"] = ("recording", "ball")
    assert run(tilt=Tilt(0.2, 0.1)) == ("recording", (trackers["opened"], "ball"))
    assert trackers["names"]() == ["open", "look", "silhouette"]
    assert trackers["calls"][0][2] == {"tilt": Tilt(0.2, 0.1)}


def test_silhouettes_of_balls_and_long_bodies(monkeypatch):
    def follow(film, long):
        if long == "bad":
            raise TrackingError("no", "no")
        return "long"

    monkeypatch.setattr(_spindown, "follow_long_body", follow)
    monkeypatch.setattr(_spindown, "_recording_of", lambda *_: "recording")
    monkeypatch.setattr(_spindown, "point_recording", lambda *a: ("pendulum", a[-1]))

    def found(long, pendulum, **options):
        look = SimpleNamespace(long=long, pendulum=pendulum, seen="seen")
        return _spindown._by_silhouette(StubFilm(), look, SpindownOptions(**options), None)

    assert found("rod", False) == ("recording", "long")
    assert found("rod", True) == ("recording", "long")
    assert found("rod", False, tilt=Tilt(0.1, 0.0)) is None
    assert found("bad", True) == ("pendulum", "seen")
    assert found("bad", False) is None
    assert found(None, False) is None


def test_the_papers_markers_are_those_of_a_body_that_turns(monkeypatch):
    def body(count, swing):
        return SimpleNamespace(time=np.arange(count), angle=swing * np.linspace(0, 1, count))

    def found(*bodies, coloured=True, corners=5, **options):
        rho = np.where(np.arange(100) < corners, 80.0, np.nan)
        markers = {"red": SimpleNamespace(rho=np.full(100, np.nan)), "blue": SimpleNamespace(rho=rho)}
        recording = replace(
            RECORDING, bodies={str(k): b for k, b in enumerate(bodies)}, markers=markers, warnings=("own",)
        )
        monkeypatch.setattr(_spindown, "is_coloured", lambda _: coloured)
        monkeypatch.setattr(_spindown, "extract", lambda *_, **__: recording)
        return _spindown._papers_markers(Path("a"), StubFilm(count=100), SpindownOptions(**options), None)

    least = _spindown.LEAST_TURN
    assert found(body(100, 1.1 * least)).warnings[-1] == "own"
    assert found(body(100, -1.1 * least)) is not None
    assert found(body(100, 0.9 * least)) is None
    assert found(body(81, 1.1 * least)) is not None
    assert found(body(80, 1.1 * least)) is None
    assert found(body(50, 9.0), body(100, 0.5 * least)) is None
    assert found(body(50, 9.0), body(100, 2 * least), body(100, 0.0)) is not None
    turns = body(100, 9.0)
    assert found(turns, coloured=False) is None
    assert found(turns, corners=4) is None
    assert found(turns, hub=(1.0, 2.0)) is None
    assert found(turns, tilt=Tilt(0.1, 0.0)) is None


# ---- recordings


def ring_track(sense=1, **changed):
    frame = np.arange(2, 38)
    usual = {
        "frame": frame,
        "angle": sense * 0.3 * frame,
        "sigma": np.full(36, 1e-3),
        "warnings": ("w1", "w2"),
        "ambiguous": False,
        "ring": SimpleNamespace(hub=(30.0, 40.0), stretch=(1.0, 0.0), inner=5.0, outer=20.0),
        "hub_path": np.stack([0.1 * frame, -0.2 * frame], axis=1),
        "explained": 0.9,
        "scale": 1.2,
        "correlated": 1e-4,
        "template": SimpleNamespace(hub_sigma=0.3),
        "way": "search",
    }
    return SimpleNamespace(**(usual | changed))


@pytest.fixture
def recorded(tmp_path, monkeypatch):
    monkeypatch.setattr(_spindown, "fresh_frames", lambda film: np.arange(len(film)))
    monkeypatch.setattr(_spindown, "track_doubts", lambda name, body, count, inspect: [f"{name} {count}"])
    film = StubFilm(tmp_path)
    return lambda track, **options: _spindown._recording_of(film, SpindownOptions(**options), track)


@pytest.mark.parametrize("sense", [1, -1])
def test_recording_of_a_body(recorded, sense):
    found = recorded(ring_track(sense))
    assert found.sense == sense
    body = found.bodies["casing"]
    np.testing.assert_allclose(body.angle, 0.3 * np.arange(2, 38))
    np.testing.assert_allclose(body.time, np.arange(2, 38) / 50)
    np.testing.assert_allclose(found.time, np.arange(40) / 50)
    assert (body.n_markers == 1).all()
    assert (found.width, found.height, found.frames_declared, found.frames_decoded) == (120, 90, 41, 40)
    frame = np.arange(2, 38)
    np.testing.assert_allclose(found.centre[2:38], np.stack([1030 + 0.1 * frame, 1040 - 0.2 * frame], axis=1))
    assert np.isnan(found.centre[[0, 1, 38, 39]]).all()
    assert (found.capture_fps, found.container_fps) == (50.0, 50.0)
    assert found.warnings[1:] == ("w1", "w2", "body 36")
    assert "50 fps" in found.warnings[0]
    assert found.extra["doubts"] == ["body 36"]
    assert found.extra["times_from"] in ("frames", "stamps")
    assert found.extra["capture_rate_from"] == "container"
    assert found.extra["centre_from"] == "search"
    assert found.extra["tracking"]["ring_px"] == [5.0, 20.0]
    assert found.points == {}


def test_recording_of_an_ambiguous_body_states_the_last_warning_as_a_doubt(recorded):
    assert recorded(ring_track(ambiguous=True)).extra["doubts"] == ["w2", "body 36"]
    assert recorded(ring_track(angle=np.full(36, 1.0))).sense == 1
    found = recorded(ring_track(), capture_fps=100.0)
    np.testing.assert_allclose(found.time, np.arange(40) / 100)
    assert (found.capture_fps, found.container_fps) == (100.0, 50.0)


def path_of(frame, place):
    count = len(frame)
    covariance = np.tile(np.diag([0.04, 0.09]), (count, 1, 1))
    return PointPath(frame, place, covariance, 7.0, count, turns=False, picture=np.zeros((3, 3)))


def point_of(sense=1, frame=None):
    frame = np.arange(4, 36) if frame is None else frame
    angle = sense * 0.05 * frame
    hub = np.array([50.0, 60.0])
    place = hub + 20 * np.stack([np.cos(angle), -np.sin(angle)], axis=1)
    arc = SimpleNamespace(hub=hub, radius=20.0, noise=0.1, by_place=0.2)
    return TrackedPoint(
        frame, place, np.full((len(frame), 2), 0.1), angle, np.full(len(frame), 5e-3), hub,
        np.diag([0.04, 0.01]), 0.03, "circle", path_of(frame, place), arc, ("p1",),
    )  # fmt: skip


@pytest.mark.parametrize("sense", [1, -1])
def test_recording_of_a_point(recorded, sense):
    point = point_of(sense)
    found = recorded(point, scale=0.002)
    assert found.sense == sense
    assert found.bodies["casing"].harmonic_sigma == pytest.approx(point.error_by_place(120))
    np.testing.assert_allclose(found.bodies["casing"].angle, 0.05 * np.arange(4, 36))
    np.testing.assert_allclose(found.centre[4:36], np.tile([1050.0, 1060.0], (32, 1)))
    track = found.points["point"]
    np.testing.assert_allclose(np.stack([track.x, track.y], axis=1), point.place)
    np.testing.assert_array_equal(track.frame_number, np.arange(4, 36))
    assert (track.m_per_px, track.radius) == (0.002, 7.0)
    assert (track.sigma_x == 0.1).all()
    assert found.warnings[1:] == ("p1", "body 32")


def test_recording_of_a_path_has_no_body(recorded):
    frame = np.arange(5)
    found = recorded(path_of(frame, np.zeros((5, 2))))
    assert (found.bodies, found.sense, found.extra["centre_from"]) == ({}, 1, "none")
    assert found.warnings[1:] == ("film",)


def test_record_of_a_point_in_a_tilted_film():
    film = StubFilm()
    film.tilt = Tilt(math.radians(60), math.pi / 2)
    path = path_of(np.arange(3, 6), np.zeros((3, 2)))
    track = _points.point_track("p", path, np.arange(3) / 50, np.arange(40) + 7, film, None)
    np.testing.assert_allclose(track.x, 1000)
    np.testing.assert_array_equal(track.frame_number, [10, 11, 12])
    assert math.isnan(track.m_per_px)
    back = np.linalg.inv(film.tilt.matrix(120, 90)[:, :2])
    np.testing.assert_allclose(track.sigma_x, np.sqrt(back[0] ** 2 @ [0.04, 0.09]))
    np.testing.assert_allclose(track.sigma_y, np.sqrt(back[1] ** 2 @ [0.04, 0.09]))
    film.tilt = None
    track = _points.point_track("p", path, np.arange(3) / 50, np.arange(40), film, None)
    np.testing.assert_allclose([track.sigma_x[0], track.sigma_y[0]], [0.2, 0.3])


def test_recording_of_several_points(tmp_path, monkeypatch, recorded):
    free = path_of(np.arange(3, 20), np.ones((17, 2)))
    found = {(101.0, 101.0): free, (102.0, 102.0): point_of(), None: point_of(-1)}
    film = StubFilm(tmp_path)
    film.tilt = Tilt(0.0, 0.0)
    calls = []
    monkeypatch.setattr(
        _spindown, "follow_path", lambda f, start, hub, p: (calls.append(hub), found[start])[1]
    )
    starts = [(1.0, 1.0), (2.0, 2.0), None]
    recording = _spindown.points_recording(film, starts, SpindownOptions(hub=(5.0, 6.0)))
    assert list(recording.points) == ["point_1", "point_2", "point_3"]
    assert {tuple(map(float, hub)) for hub in calls} == {(105.0, 106.0)}
    assert recording.sense == 1
    np.testing.assert_allclose(recording.points["point_1"].time, np.arange(3, 20) / 50)
    assert sum("point_1" in w for w in recording.warnings) == 1
    assert not any("point_2" in w for w in recording.warnings)
    alone = _spindown.points_recording(film, starts[:1], SpindownOptions())
    assert list(alone.points) == ["point"]
    assert alone.bodies == {}
    other = replace(point_of(-1), warnings=("p1", "p2"))
    found[None] = other
    recording = _spindown.points_recording(film, starts, SpindownOptions())
    assert [w for w in recording.warnings if "point_3" in w] == ["point_3: p2"]


def test_recording_of_two_links(tmp_path, monkeypatch, recorded):
    joint = replace(point_of(-1), warnings=("j",))
    second = SimpleNamespace(
        frame=np.arange(6, 36),
        angle=0.1 * np.arange(30.0),
        sigma=np.full(30, 0.02),
        path=path_of(np.arange(6, 36), np.zeros((30, 2))),
    )
    monkeypatch.setattr(_spindown, "follow_links", lambda *_: (joint, second))
    film = StubFilm(tmp_path)
    recording = _spindown.links_recording(film, [(1.0, 1.0), (2.0, 2.0)], SpindownOptions(scale=0.1))
    assert recording.sense == 1
    np.testing.assert_allclose(recording.bodies["casing"].angle, joint.angle)
    np.testing.assert_allclose(recording.bodies["casing"].sigma, joint.whole_sigma)
    np.testing.assert_allclose(recording.bodies["rotor"].angle, second.angle)
    np.testing.assert_allclose(recording.bodies["rotor"].time, np.arange(6, 36) / 50)
    assert recording.bodies["rotor"].name == "rotor"
    assert list(recording.points) == ["joint", "second_link"]
    assert recording.points["second_link"].m_per_px == 0.1
    assert recording.warnings.count("j") == 1
    assert f"{1e3 * _spindown.OFF_AXIS / 20:.2g} mrad" in recording.warnings[-1]
    for count in (1, 3):
        with pytest.raises(UsageError):
            _spindown.links_recording(film, [(1.0, 1.0)] * count, SpindownOptions())


RECORDING = None


def case_of(counts, named=None, main="casing"):
    bodies = {
        name: _spindown._body_of(np.arange(count) / 50, 0.1 * np.arange(count), np.full(count, 1e-3))
        for name, count in counts.items()
    }
    return _spindown._recording_case(replace(RECORDING, bodies=bodies, body=main, sense=-1), 0.5, named)


def test_body_of_a_recording_with_most_samples_is_analysed():
    assert len(case_of({"casing": 100, "rotor": 120}).casing.time) == 120
    assert (
        len(case_of({"casing": 110, "rotor": 120}).casing.time) == 110
    )  # its body, with nearly as many samples
    assert len(case_of({"casing": 110, "rotor": 120}, main="rotor").casing.time) == 120
    assert len(case_of({"casing": 110, "rotor": 120}, "rotor").casing.time) == 120
    case = case_of({"casing": 120, "rotor": 90})
    assert len(case.casing.time) == 120
    assert "--body rotor" in case.warnings[-1]
    assert (case.I_casing, case.I_rotor, case.extra["sense"], case.bodies) == (0.5, 0.5, -1, "one")
    assert case.placements["casing"].ambiguous is False
    assert case_of({"casing": 120}).warnings == RECORDING.warnings
    with pytest.raises(DatasetError, match="does not contain"):
        case_of({"casing": 120}, "rotor")
    with pytest.raises(DatasetError, match="no body"):
        case_of({})


@pytest.fixture(autouse=True)
def plain_recording(tmp_path):
    global RECORDING
    if RECORDING is None:
        (tmp_path / "plain").mkdir()
        path = path_of(np.arange(5), np.zeros((5, 2)))
        RECORDING = _spindown._recording_of(StubFilm(tmp_path / "plain"), SpindownOptions(), path)


# ---- uncertainties and refusals


@pytest.mark.parametrize(("turns", "leverage"), [(1.9, 3.0), (2.1, 0.5)])
def test_difference_of_the_halves_of_a_ring_widens_all_values(monkeypatch, turns, leverage):
    def half(shift):
        values = {name: Value(sign * (2.0 + shift), 0.0) for name, sign in (("omega_mean", 1), ("alpha", -1))}
        return motion(period=Value(1.0 + shift, 0), amplitude=Value(0.5 - shift, 0), decay=None, **values)

    halves = {0.0: half(0.01), 1.0: half(-0.03)}
    monkeypatch.setattr(_spindown, "motion_of", lambda t, angle, sigma: halves[angle[0]])
    time = np.arange(10) / 50
    series = SimpleNamespace(time=time[2:], sigma=np.ones(8))
    recording = SimpleNamespace(bodies={"casing": SimpleNamespace(time=time + 1e-12)})
    track = SimpleNamespace(
        halves=np.stack([np.zeros(10), np.ones(10)]), hub_leverage=3.0, distance_error=0.0
    )
    plain = motion(turns=turns, period=Value(1.0, 0.1), amplitude=Value(0.5, 0.1), decay=Value(0.2, 0.1))
    found = _spindown._with_view_errors(plain, series, recording, track)
    wide = math.hypot(0.1, leverage * 0.04)
    for name in ("omega_mean", "alpha", "period", "amplitude"):
        assert getattr(found, name).stderr == pytest.approx(wide)
        assert getattr(found, name).value == getattr(plain, name).value
    assert found.decay == Value(0.2, 0.1)
    track.distance_error, track.hub_leverage = 0.3, 0.1
    found = _spindown._with_view_errors(plain, series, recording, track)
    assert found.alpha.stderr == pytest.approx(math.hypot(0.1, 0.6))
    assert found.omega_mean.stderr == pytest.approx(math.hypot(0.1, 0.6))
    assert found.amplitude.stderr == pytest.approx(math.hypot(0.1, 0.15))
    assert found.period.stderr == pytest.approx(math.hypot(0.1, 0.02))
    backward = replace(plain, alpha=Value(-2.0, 0.1))
    assert _spindown._with_view_errors(backward, series, recording, track).alpha.stderr == pytest.approx(
        math.hypot(0.1, 0.6)
    )
    none = replace(plain, period=None, amplitude=None, decay=None)
    found = _spindown._with_view_errors(none, series, recording, track)
    assert (found.period, found.amplitude, found.decay) == (None, None, None)


def test_displaced_pivots_widen_all_values(monkeypatch):
    def other(shift):
        values = {
            "omega_mean": Value(-2 - shift, 0),
            "alpha": Value(2 + shift, 0),
            "period": Value(1 + shift, 0),
        }
        return motion(omega={"first": 4 + shift, "last": -3 - shift}, **values)

    seen = []

    def stub(t, angle, sigma):
        seen.append(angle.copy())
        return other(0.3 if len(seen) % 2 else -0.4)

    monkeypatch.setattr(_points, "motion_of", stub)
    point = SimpleNamespace(displaced=lambda: [np.arange(10.0), -np.arange(10.0)], view=0.1)
    time = np.arange(10) / 50
    series = SimpleNamespace(time=time[3:], sigma=np.ones(7))
    recording = SimpleNamespace(bodies={"casing": SimpleNamespace(time=time)}, sense=-1)
    plain = motion(
        period=Value(1.0, 0.1),
        amplitude=Value(0.5, 0.1),
        decay=Value(0.2, 0.1),
        omega_u={"first": 0.2, "last": 0.0},
    )
    found = _points.with_pivot_errors(plain, series, recording, point)
    np.testing.assert_array_equal(seen[0], -np.arange(3.0, 10))
    assert found.alpha.stderr == pytest.approx(math.sqrt(0.01 + 0.04 + 0.25))
    assert found.omega_mean.stderr == pytest.approx(math.sqrt(0.01 + 0.04 + 0.25))
    assert found.period.stderr == pytest.approx(math.sqrt(0.01 + 0.25))
    assert found.amplitude.stderr == pytest.approx(math.sqrt(0.01 + 0.0025))
    assert found.decay.stderr == pytest.approx(0.1)
    assert found.omega_u["first"] == pytest.approx(math.sqrt(0.04 + 0.16 + 0.25))
    assert found.omega_u["last"] == pytest.approx(math.sqrt(0.09 + 0.25))
    none = _points.with_pivot_errors(motion(), series, recording, point)
    assert (none.period, none.amplitude, none.decay) == (None, None, None)


def fit_with(reversals=3, restoring=True):
    data = [SimpleNamespace(motion=SimpleNamespace(reversals=[1.0] * reversals))]
    return SimpleNamespace(problem=SimpleNamespace(data=data), model=SimpleNamespace(restoring=restoring))


@pytest.mark.parametrize(
    ("kind", "changed", "fit", "final", "allowed"),
    [
        ("steady", {"alpha": Value(0.29, 0.1)}, {}, False, False),
        ("steady", {"alpha": Value(-0.29, 0.1)}, {}, False, False),
        ("steady", {"alpha": Value(0.31, 0.1)}, {}, False, True),
        ("steady", {"alpha": Value(-0.31, 0.1)}, {}, False, True),
        ("spin-down", {"alpha": Value(0.0, 0.1)}, {"reversals": 0, "restoring": False}, True, True),
        ("reversing", {}, {}, False, False),
        ("oscillation", {"period": None}, {}, False, False),
        ("oscillation", {"period": VALUE}, {}, True, True),
        ("oscillation", {"period": VALUE}, {"reversals": 1}, False, True),
        ("oscillation", {"period": VALUE}, {"reversals": 0}, False, False),
        ("oscillation", {"period": VALUE}, {"restoring": False}, True, False),
        ("oscillation", {"period": VALUE}, {"restoring": False}, False, True),
    ],
)
def test_laws_that_a_motion_does_not_support_are_refused(kind, changed, fit, final, allowed):
    if allowed:
        _spindown._check_law(motion(kind, **changed), fit_with(**fit), final=final)
    else:
        with pytest.raises(FittingError):
            _spindown._check_law(motion(kind, **changed), fit_with(**fit), final=final)


def test_temperatures_are_not_drives():
    inputs = [SimpleNamespace(unit=u) for u in ("K", "A", "1")]
    assert _spindown.drives_of(SimpleNamespace(inputs=inputs)) == tuple(inputs[1:])


# ---- tables and files


def table_of(path, angle, dt=0.01, head="t [s],angle [rad]"):
    rows = "".join(f"{dt * k:.4f},{a:.7f}\n" for k, a in enumerate(angle))
    path.write_text(f"{head}\n{rows}")
    return path


def test_options_of_films_and_tables_are_separate(tmp_path):
    table = table_of(tmp_path / "t.csv", np.arange(40.0))
    for options in ({"point": (1.0, 1.0)}, {"colour": "red"}, {"scale": 0.1}, {"tilt": Tilt(0.1, 0.0)}):
        with pytest.raises(UsageError, match="apply to films"):
            _spindown.read_source(table, SpindownOptions(**options))
    film = tmp_path / "a.mp4"
    film.write_bytes(b"")
    for options in ({"columns": ("t=1",)}, {"marker": "a"}, {"centre": "b"}):
        with pytest.raises(UsageError, match="not to a film"):
            _spindown.read_source(film, SpindownOptions(**options))
    with pytest.raises(UsageError, match="--input"):
        _spindown.read_source(film, SpindownOptions(inputs=("u=2",)))
    with pytest.raises(DatasetError, match="no file"):
        _spindown.read_source(tmp_path / "none.csv", SpindownOptions())
    with pytest.raises(DatasetError, match="folder"):
        _spindown.read_source(tmp_path, SpindownOptions())
    with pytest.raises(DatasetError, match="no file"):
        _spindown.read_source(tmp_path / "none.mp4", SpindownOptions())
    assert _spindown.picture_path(film, tmp_path / "b.h5") == tmp_path / "b.png"
    assert _spindown.picture_path(table, tmp_path / "b.h5") is None


def test_inertia_and_names_of_a_case(tmp_path):
    t = 0.01 * np.arange(100)
    table = table_of(tmp_path / "wheel.csv", 9 * t - t**2)
    plain = _spindown.read_source(table, SpindownOptions()).case
    assert (plain.I_casing, plain.per_inertia, plain.label) == (1.0, 1, "wheel")
    assert math.isnan(plain.I_casing_u)
    assert any("per unit of inertia" in w for w in plain.warnings)
    options = SpindownOptions(inertia="0.2 +- 0.01", label="name", body_name="disc")
    given = _spindown.read_source(table, options)
    assert (given.case.I_casing, given.case.per_inertia, given.case.label) == (0.2, 0, "name")
    assert given.case.I_casing_u == pytest.approx(0.01)
    assert given.case.body_name == "disc"
    assert not any("per unit of inertia" in w for w in given.case.warnings)
    assert given.table is not None


def test_drive_and_rest_of_a_film_are_excluded(monkeypatch, recorded):
    case = case_of({"casing": 200})
    monkeypatch.setattr(_spindown, "is_film", lambda _: True)
    monkeypatch.setattr(_spindown, "_film", lambda *_: (None, None))
    monkeypatch.setattr(_spindown, "_recording_case", lambda *_: case)
    monkeypatch.setattr(_spindown, "start_of_motion", lambda *_: 30)
    monkeypatch.setattr(_spindown, "end_of_motion", lambda *_: 150)

    def read(**options):
        return _spindown.read_source(Path(__file__), SpindownOptions(**options)).case

    found = read()
    assert found.casing.time.tolist() == case.casing.time[30:150].tolist()
    assert len(found.casing.omega) == len(found.casing.sigma) == 120
    assert any("until 0.600 s" in w and "30 samples before" in w for w in found.warnings)
    assert any("after 2.980 s" in w and "50 samples after" in w for w in found.warnings)
    kept = read(limits=Limits(keep_all=True))
    assert len(kept.casing.time) == 200
    assert len(kept.warnings) == len(found.warnings) - 2
    monkeypatch.setattr(_spindown, "start_of_motion", lambda *_: 0)
    monkeypatch.setattr(_spindown, "end_of_motion", lambda *_: len(case.casing.time))
    assert len(read().warnings) == len(kept.warnings)
    within = read(limits=Limits(start=0.1, keep_all=True))
    assert len(within.casing.time) == 195
    assert any("5 samples" in w for w in within.warnings)


@pytest.mark.parametrize("share", [0.8, 1.2])
def test_a_range_of_ten_uncertainties_is_a_rotation(tmp_path, monkeypatch, share):
    """Of a film, the uncertainty is the smaller one of the stated value and the white noise of the angles."""
    count = 60
    t = np.arange(count) / 50
    noise = 1e-3 * np.random.default_rng(0).choice([-1.0, 1.0], count)
    angle = share * 0.0115 * t / t[-1] + noise
    usual = min(2e-3, _spindown.white_noise(angle, t))
    case = case_of({"casing": count})
    series = replace(case.casing, time=t, angle=angle, sigma=np.full(count, 2e-3))
    angle_range = float(np.ptp(angle))
    monkeypatch.setattr(_spindown, "read_source", lambda *_: _spindown.Source(replace(case, casing=series)))
    scale = share * 10 * usual / angle_range
    monkeypatch.setattr(
        _spindown, "motion_of", lambda *_: motion("steady", turns=angle_range * scale / (2 * np.pi))
    )

    class WrittenError(Exception):
        pass

    def written(*_, **__):
        raise WrittenError

    monkeypatch.setattr(_spindown, "write_case", written)
    with pytest.raises(TrackingError if share < 1 else WrittenError):
        _spindown._analysed(
            Path("a.csv"), tmp_path / "a.h5", None, SpindownOptions(), command="", force=False, progress=None
        )


# ---- the course of the analysis


@pytest.fixture
def analysis(monkeypatch, tmp_path):
    """Return a function that analyses stubs: (document, calls) for a motion, a drive and a film."""
    calls = []

    def note(name, result):
        def call(*args, **options):
            calls.append((name, args, options))
            return result

        return call

    def analyse(
        found,
        drive=None,
        *,
        film=None,
        inputs=(),
        quantity="angle",
        reversals=3,
        laws=None,
        stopped="",
        verdict="adequate",
        **extra,
    ):
        calls.clear()
        case = case_of({"casing": 60})
        window = np.ones(60, dtype=int) if extra.pop("windows", False) else None
        series = replace(case.casing, angle=0.1 * np.arange(60), window=window)
        case = replace(
            case,
            casing=series,
            inputs=inputs,
            quantity=quantity,
            extra=extra,
            warnings=("w",),
            recordings={"casing": RECORDING},
        )
        data = SimpleNamespace(
            motion=SimpleNamespace(reversals=[1.0] * reversals), record=SimpleNamespace(inputs=inputs)
        )
        base = SimpleNamespace(
            name="base",
            problem=SimpleNamespace(data=[data]),
            model=SimpleNamespace(restoring=True),
            verdict="ok",
        )
        last = SimpleNamespace(**vars(base) | {"name": "last"})

        class History(list):
            pass

        history = History([SimpleNamespace(fit=base, candidates="c"), SimpleNamespace(fit=last)])
        history.stopped = stopped
        ledger = SimpleNamespace(add=note("add", SimpleNamespace(fit_id="f1")), path="ledger")
        recorder = SimpleNamespace(entries=[SimpleNamespace(document={"rung": k}) for k in range(2)])
        study = SimpleNamespace(
            data=[data], model=note("model", "model"), ledger=ledger, recorder=note("recorder", recorder),
            keep_diagnosis=note("keep", None), steps_to=note("steps", "steps"),
        )  # fmt: skip
        patches = {
            "gyrotrack.apps._spindown": {
                "read_source": note("read", _spindown.Source(case, film, extra.pop("table", None))),
                "motion_of": note("motion", found),
                "motion_of_speeds": note("speeds", found),
                "_drive": note("drive", drive),
                "write_case": note("write", None),
                "open_study": note("study", study),
                "with_pivot_errors": note("pivot", found),
                "_with_view_errors": note("view", found),
                "write_point_picture": note("point picture", None),
                "write_body_picture": note("body picture", None),
                "laws_of_body": lambda fit: (fit.name,),
                "write_report": note("report", None),
                "read_case": note("read case", "case"),
                "_first_order_fit": note("first order fit", base),
                "white_noise": lambda *_: 1e-3,
            },
            "fitting.inference._fit": {"fit": note("fit", base)},
            "fitting._workers": {"WorkerPool": nullcontext},
            "fitting.discovery._oscillator": {
                "oscillator_laws": note("laws", laws),
                "fit_oscillator": note("oscillator", (laws, base)),
            },
            "fitting.discovery._select": {
                "improve": note("improve", history),
                "rank": note("rank", "ranked"),
            },
            "fitting.discovery._verdict": {"diagnose": note("diagnose", SimpleNamespace(verdict=verdict))},
            "fitting.inference._first_order": {"first_order": lambda fit: [SimpleNamespace(label="r")]},
            "fitting.study._serialisation": {"diagnosis_document": note("document", "diagnosis")},
        }
        for module, names in patches.items():
            for name, stub in names.items():
                monkeypatch.setattr(f"{module}.{name}", stub)
        report = tmp_path / "r.html" if extra.get("report") else None
        source = tmp_path / ("a.mp4" if film else "a.csv")
        document = _spindown._analysed(
            source, tmp_path / "a.h5", report, SpindownOptions(), command="c", force=True, progress=None
        )
        return (
            document,
            [name for name, *_ in calls],
            {name: (args, options) for name, args, options in calls},
        )

    return analyse


def test_a_free_body_is_fitted_and_improved(analysis):
    document, names, calls = analysis(motion(alpha=Value(1.0, 0.1)))
    assert names[:2] == ["read", "motion"]
    assert "oscillator" not in names
    assert "laws" not in names
    assert calls["recorder"][0][0] == "f1"
    assert calls["improve"][1]["max_steps"] is None
    assert calls["improve"][1]["first"] is None
    assert calls["diagnose"][1]["candidates"] == "c"
    assert (document["laws"], document["ladder"], document["diagnosis"], document["report"]) == (
        ("last",),
        [0, 1],
        "diagnosis",
        None,
    )
    assert document["first_order"] == [{"label": "r"}]
    assert document["warnings"] == ["w"]
    assert (document["response"], document["oscillator"], document["picture"], document["ambiguous"]) == (
        None,
        None,
        None,
        False,
    )
    for verdict, law in (("undecided", "base"), ("unexplained", "base"), ("missing_effect", "last")):
        assert analysis(motion(), verdict=verdict)[0]["laws"] == (law,)
    document, names, calls = analysis(motion(), report=True, doubts=["d"], stopped="early")
    assert document["report"].name == "r.html"
    assert calls["report"][1]["recordings"] == ["case"]
    assert document["ambiguous"] is True
    assert document["warnings"] == ["w", "The search stopped: early"]


def test_a_motion_of_measured_speeds_is_described_by_them(analysis):
    assert "speeds" in analysis(motion(), quantity="omega")[1]
    assert "motion" in analysis(motion(), quantity="omega", windows=True)[1]
    assert "motion" in analysis(motion(), quantity="angle")[1]


def test_a_driven_body_without_a_recorded_drive_has_no_law(analysis):
    drive = _spindown.Drive(
        "its speed rises once", {"first": 1.0, "last": 2.0}, {"first": 0.1, "last": 0.1}, "response"
    )
    document, names, _ = analysis(motion(period=VALUE), drive)
    assert "fit" not in names
    found = document["motion"]
    assert (found.kind, found.period, found.omega, found.omega_u) == (
        "driven",
        None,
        drive.omega,
        drive.omega_u,
    )
    assert document["response"] == "response"
    assert (document["laws"], document["ladder"], document["diagnosis"]) == ([], [], None)
    assert "(its speed rises once)" in document["warnings"][-1]
    assert "--input" not in document["warnings"][-1]
    plain = _spindown.Drive("reason", None, None, "response")
    document, *_ = analysis(motion(), plain)
    assert document["motion"].omega == motion().omega
    assert "--input" in analysis(motion(), plain, table=SimpleNamespace(changes=None))[0]["warnings"][-1]
    for each in (None, plain):
        document, names, _ = analysis(motion("fluctuating"), each)
        assert (document["motion"].kind, document["response"]) == ("fluctuating", None)
        assert "(its speed rises and falls repeatedly)" in document["warnings"][-1]
        assert "fit" not in names
    _, names, _ = analysis(motion("oscillation", period=VALUE), plain, laws=oscillator())
    assert "drive" not in names


def test_a_recorded_drive_is_fitted(analysis):
    drive = _spindown.Drive("reason", None, None, "response")
    current = SimpleNamespace(name="i", unit="A")
    for given in (None, drive):
        document, names, calls = analysis(motion(period=VALUE), given, inputs=(current,))
        assert calls["first order fit"][0][1] == ["i"]
        assert "fit" not in names
        assert (document["motion"].kind, document["motion"].period, document["response"]) == (
            "driven",
            None,
            None,
        )
        assert document["laws"] == ("last",)
    _, names, _ = analysis(motion("oscillation", period=VALUE), None, inputs=(current,))
    assert "drive" in names
    document, names, _ = analysis(motion("fluctuating"), drive, inputs=(current,))
    assert "first order fit" in names
    warm = SimpleNamespace(name="T", unit="K")
    assert "fit" in analysis(motion(), None, inputs=(warm,))[1]


def oscillator(disagreements=("", ""), wrong_period=""):
    names = dict(zip(("last", "base"), disagreements, strict=True))
    return SimpleNamespace(
        with_fit=lambda fit: (fit.name, names[fit.name]), wrong_period=lambda fit: wrong_period
    )


def test_an_oscillation_is_fitted_with_its_laws(analysis):
    kind = motion("oscillation", period=VALUE)
    for disagreements, name, count in (
        (("", ""), "last", 1),
        (("no", ""), "base", 1),
        (("no", "nor"), "base", 2),
    ):
        document, names, calls = analysis(kind, laws=oscillator(disagreements))
        assert "oscillator" in names
        assert "fit" not in names
        assert "rank" not in names
        assert (document["oscillator"], len(document["warnings"])) == (name, count)
    for verdict, name in (("undecided", "base"), ("unexplained", "base"), ("missing_effect", "last")):
        document, *_ = analysis(kind, laws=oscillator(), verdict=verdict)
        assert (document["oscillator"], document["laws"]) == (name, (name,))
        assert not document["ambiguous"]
    document, names, _ = analysis(kind, laws=oscillator(wrong_period="it gives k = 1059"))
    assert "improve" not in names
    assert (list(document["laws"]), document["ladder"], document["diagnosis"]) == ([], [], None)
    assert "it gives k = 1059" in document["warnings"][-1]
    assert document["ambiguous"]
    many = 4000
    document, names, calls = analysis(kind, laws=oscillator(), reversals=many)
    assert calls["rank"][1] == {"refitting": False}
    assert (calls["improve"][1]["max_steps"], calls["improve"][1]["first"]) == (0, "ranked")
    assert f"{many} reversals: no law" in document["warnings"][1]
    document, names, calls = analysis(kind, laws=None, reversals=many)
    assert "rank" not in names
    assert (calls["improve"][1]["max_steps"], calls["improve"][1]["first"]) == (1, None)
    assert f"{many} reversals: one effect" in document["warnings"][1]
    document, *_ = analysis(motion("oscillation"))
    assert document["warnings"][-1].startswith("No torque law: ")
    assert document["ladder"] == []


def test_pictures_and_errors_follow_the_tracker(analysis):
    document, names, _ = analysis(motion(), film=("film", point_of()))
    assert {"pivot", "point picture"} <= set(names)
    assert not {"view", "body picture"} & set(names)
    assert document["picture"].name == "a.png"
    _, names, _ = analysis(motion(), film=("film", SimpleNamespace()))
    assert {"view", "body picture"} <= set(names)
    assert not {"pivot", "point picture"} & set(names)


def test_settings_of_a_case_are_stored(analysis):
    _, _, calls = analysis(motion())
    (target, _), options = calls["write"]
    assert (target.name, options["force"], options["command"]) == ("a.h5", True, "c")
    assert options["settings"]["inputs"] == []
    assert options["settings"]["tilt"] is None


def test_passages_are_read_only_from_tables(tmp_path, monkeypatch):
    found = SimpleNamespace(time=np.arange(40.0), duration=np.ones(40), notes=("n",))
    monkeypatch.setattr(_spindown, "read_passages", lambda *_: found)
    monkeypatch.setattr(
        _spindown, "replace", lambda found, **changed: SimpleNamespace(**vars(found) | changed)
    )
    monkeypatch.setattr(_spindown, "motion_of_passages", lambda found: len(found.time))
    for name in ("a.mp4", "a.h5", "a.HDF5", "none.csv"):
        if name != "none.csv":
            (tmp_path / name).write_bytes(b"")
        assert _spindown._passages(tmp_path / name, SpindownOptions()) is None
    (tmp_path / "a.csv").write_text("")
    document = _spindown._passages(tmp_path / "a.csv", SpindownOptions())
    assert (document["motion"], document["case"], document["reading"], document["ambiguous"]) == (
        40,
        None,
        [],
        False,
    )
    assert (document["laws"], document["warnings"][0], len(document["warnings"])) == ([], "n", 2)
    assert _spindown._passages(tmp_path / "a.csv", SpindownOptions(limits=Limits(start=10.0)))["motion"] == 30
    with pytest.raises(UsageError, match="inputs"):
        _spindown._passages(tmp_path / "a.csv", SpindownOptions(inputs=("u=2",)))
    monkeypatch.setattr(_spindown, "read_passages", lambda *_: None)
    assert _spindown._passages(tmp_path / "a.csv", SpindownOptions()) is None


def test_recordings_and_cases_are_read(tmp_path, monkeypatch):
    case = case_of({"casing": 120})
    path = tmp_path / "a.h5"
    monkeypatch.setattr(_spindown, "read_recording", lambda _: case.recordings["casing"])
    path.write_bytes(b"")
    options = SpindownOptions(limits=Limits(keep_all=True))
    assert len(_spindown.read_source(path, options).case.casing.time) == 120
    assert _spindown.read_source(path, options).table is None
    _spindown.write_case(path, case, command="", settings={}, force=True)

    def refused(_):
        raise DatasetError("a case")

    monkeypatch.setattr(_spindown, "read_recording", refused)
    found = _spindown.read_source(path, options)
    assert len(found.case.casing.time) == 120
    assert found.table is not None


def test_drive_of_a_table_has_inputs_at_the_times_of_the_samples(monkeypatch):
    seen = {}
    monkeypatch.setattr(
        _spindown,
        "drive_of",
        lambda series, quantity, inputs, *, pulses: seen.update(inputs=inputs, pulses=pulses),
    )
    driver = _spindown.Driver("u", "A", np.arange(5.0))
    warm = _spindown.Driver("T", "degC", np.arange(5.0))
    table = SimpleNamespace(time=np.arange(5.0), drivers=(driver, warm), counted=True)
    case = SimpleNamespace(
        casing=SimpleNamespace(time=np.array([-1.0, 0.0, 1.5, 2.0, 9.0])), quantity="angle"
    )
    _spindown._drive(SimpleNamespace(case=case, table=table))
    (only,) = seen["inputs"]
    assert (only.name, only.value.tolist(), seen["pulses"]) == ("u", [0, 0, 1, 2, 4], True)
    _spindown._drive(SimpleNamespace(case=case, table=None))
    assert (seen["inputs"], seen["pulses"]) == ((), False)


def test_a_body_is_tracked_about_a_hub_or_free(monkeypatch):
    monkeypatch.setattr(_spindown, "track_body", lambda film, hub, progress: ("hub", hub))
    monkeypatch.setattr(_spindown, "track_free_body", lambda film, hub, progress: ("free", hub))
    monkeypatch.setattr(
        _spindown, "follow_point", lambda film, point, hub, progress, seen: (point, hub, seen)
    )
    monkeypatch.setattr(_spindown, "_recording_of", lambda film, options, tracked: "recording")
    film, options = StubFilm(), SpindownOptions(hub=(1.0, 2.0), point=(3.0, 4.0))
    assert _spindown.film_recording(film, options) == ("recording", ("hub", (1.0, 2.0)))
    assert _spindown.film_recording(film, options, free=True) == ("recording", ("free", (1.0, 2.0)))
    film.tilt = Tilt(0.1, 0.0)
    assert _spindown.film_recording(film, options)[1] == ("hub", (101.0, 102.0))
    assert _spindown.film_recording(film, SpindownOptions())[1] == ("hub", None)
    assert _spindown.point_recording(film, options, None, "seen")[1] == (
        (103.0, 104.0),
        (101.0, 102.0),
        "seen",
    )


@pytest.mark.parametrize(("stretch", "u"), [(0.01, 0.01), (0.05, 0.03)])
def test_the_error_due_to_a_tilt_is_the_fitted_stretch_up_to_three_per_cent(stretch, u):
    tracked = SimpleNamespace(
        ring=SimpleNamespace(stretch=(0.6 * stretch, -0.8 * stretch)), angle=np.linspace(0.0, 6.0, 50)
    )
    (mode,) = _spindown._tilt_mode(tracked)
    assert mode.covariance == pytest.approx(u**2 * np.eye(2))


@pytest.mark.parametrize(
    ("evidence", "named"),
    [
        ({"explained": 0.86, "hub_moves_px": 7.3}, "one rotation"),
        ({"explained": 0.84, "hub_moves_px": 7.3}, "several bodies"),
        ({"explained": 0.86}, "several bodies"),
    ],
)
def test_the_blades_of_a_rotation_whose_hub_moves_are_not_several_bodies(trackers, evidence, named):
    trackers["film"] = RefusedFilmError("one rotation", "", kind="no rotation", evidence=evidence)
    trackers["point"] = RefusedFilmError("several bodies", "", kind="two bodies", evidence={})
    trackers["free"] = TrackingError("no free body", "")
    with pytest.raises(RefusedFilmError, match=named):
        run()
