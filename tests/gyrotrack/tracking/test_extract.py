"""The whole of `extract` on films by a foreign renderer, and its parts with records from small arrays."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import DatasetError, TrackingError, UsageError, VideoError
from gyrotrack.io._schema import STATUS
from gyrotrack.tracking import _extract as extraction
from gyrotrack.tracking._extract import extract
from gyrotrack.tracking._fusion import BodyAngles, MarkerAngles
from gyrotrack.tracking._marker_tracker import MarkerObservations
from gyrotrack.tracking._profile import parse
from gyrotrack.tracking._scene import Marker

SMALL = {"width": 320, "height": 240, "radius": 105.0, "frames": 120}


def _error(track, truth):
    """Error of an unwrapped angle: slips would show as multiples of 2 pi."""
    error = track.angle - truth(track.time)
    return error - np.median(error)


def _marker_error(marker, truth, time):
    ok = marker.status == STATUS["ok"]
    turn = np.exp(1j * (marker.angle - truth(time)))
    return np.angle(turn / np.mean(turn[ok]))[ok]


def _linear(rate):
    return lambda t: 0.5 + rate * t


@pytest.fixture(scope="module")
def casing(casing_clip):
    path, film = casing_clip
    return extract(path), film


@pytest.fixture(scope="module")
def rotor(rotor_clip):
    path, film = rotor_clip
    return extract(path), film


class TestCasingClip:
    def test_the_angle_is_right_and_grows(self, casing):
        recording, film = casing
        assert recording.sense == -1  # the film turns clockwise as seen
        assert len(recording.bodies["casing"].time) == film.frames
        assert np.std(_error(recording.bodies["casing"], film.casing)) < 3e-3

    def test_the_uncertainty_is_true(self, casing):
        recording, film = casing
        for body, truth in (("casing", film.casing), ("rotor", film.rotor)):
            track = recording.bodies[body]
            z = _error(track, truth) / track.sigma
            assert (
                0.6 < np.std(z) < 1.4
            )  # one short film: the spread of z itself is uncertain by a few tenths
            assert np.abs(z).max() < 6

    def test_the_papers_quantities_are_those_of_the_drawing(self, casing):
        recording, film = casing
        red = recording.markers["red"]
        ok = red.status == STATUS["ok"]
        assert ok.mean() > 0.95
        assert np.mean(red.rho[ok]) == pytest.approx(0.6 * film.radius, rel=0.01)
        assert np.mean(red.delta[ok]) == pytest.approx(0.18 * film.radius, rel=0.06)
        assert np.mean(red.beta[ok]) == pytest.approx(np.pi / 2, abs=0.02)
        formula = np.sqrt((30 * red.u_r) ** 2 + (150 * red.u_1) ** 2 + (150 * red.u_2) ** 2)
        np.testing.assert_allclose(red.sigma[ok], formula[ok])
        assert np.std(_marker_error(red, film.casing, recording.time)) < 8e-3

    def test_the_centre_is_where_it_was_drawn(self, casing):
        recording, film = casing
        turn = 2 * np.pi * film.wobble_hz * film.time
        wobble = film.wobble * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        off = recording.centre - wobble - np.array([film.width / 2 - 0.5, film.height / 2 - 0.5])
        assert np.abs(off.mean(axis=0)).max() < 0.6  # half a px is where the chroma samples lie
        assert off.std(axis=0).max() < 0.15

    def test_counts_and_clock(self, casing):
        recording, film = casing
        assert recording.frames_decoded == recording.frames_declared == film.frames
        np.testing.assert_allclose(recording.time, np.arange(film.frames) / 260.0)
        np.testing.assert_allclose(recording.pts_time, recording.time, atol=1e-4)
        assert recording.warnings == ()
        assert (recording.width, recording.height) == (film.width, film.height)


class TestRotorClip:
    def test_both_bodies_without_a_slipped_turn(self, rotor):
        recording, film = rotor
        assert recording.body == "both"
        assert recording.capture_fps == 1000.0
        for body, truth, limit in (("casing", film.casing, 3e-3), ("rotor", film.rotor, 5e-3)):
            error = _error(recording.bodies[body], truth)
            assert len(error) > 0.97 * film.frames
            assert np.std(error) < limit
            assert np.abs(error).max() < 0.05

    def test_where_the_markers_sit_is_measured(self, rotor):
        recording, film = rotor
        mount = {m: recording.markers[m].mount_angle for m in ("blue", "white", "green")}
        for name, drawn in zip(("blue", "white", "green"), film.mounts, strict=True):
            apart = mount[name] - mount["blue"] - (drawn - film.mounts[0])
            assert np.angle(np.exp(1j * apart)) == pytest.approx(0, abs=0.01)

    def test_a_marker_half_under_the_bar_is_never_silently_wrong(self, rotor):
        recording, film = rotor
        for name, drawn in zip(("blue", "white", "green"), film.mounts, strict=True):
            marker = recording.markers[name]
            ok = marker.status == STATUS["ok"]
            beside = np.mod(film.rotor(recording.time) + drawn - film.casing(recording.time), np.pi)
            beside = np.minimum(beside, np.pi - beside)  # angle between the marker's and the bar's middle
            reach = np.arcsin(0.5 * film.bar / 0.5) + 0.5 * 0.2 / 0.5  # half the bar and half the paper
            assert not ok[beside < 0.8 * reach].any()
            assert (marker.status[beside < 0.5 * reach] == STATUS["occluded"]).all()
            assert np.abs(_marker_error(marker, film.rotor, recording.time)).max() < 0.12
            assert np.isnan(marker.angle[~ok]).all()


VARIANTS = {
    "dark red, uneven light": ({"red": (105, 15, 20), "disc": (105, 15, 20), "gradient": 0.35}, 6e-3),
    "orange-red on wood": ({"red": (225, 75, 25), "disc": (225, 75, 25), "table": "wood"}, 6e-3),
    "brass bar on a white table": ({"bar_metal": (190, 150, 70), "table": "white"}, 6e-3),
    "tilt 0.2, disc above the papers": ({"tilt": 0.2, "lift": 0.15}, 8e-3),
    "noise and flicker": ({"noise": 9.0, "flicker": 0.25}, 6e-3),
    "fast wobble": ({"wobble": 2.0, "wobble_hz": 15.0}, 8e-3),
    "no disc": ({"disc": None}, 15e-3),
    "small": ({"width": 160, "height": 120, "radius": 42.0}, 15e-3),
    "hardly turning": ({"casing": _linear(1.0)}, 8e-3),
    "160 rad/s": ({"casing": _linear(160.0), "exposure": 1.0e-3}, 8e-3),
    "counter-clockwise": ({"sense": 1}, 6e-3),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", VARIANTS)
def test_casing_angle_in_scenes_of_all_kinds(draw, name):
    settings, limit = VARIANTS[name]
    path, film = draw(**{**SMALL, "casing": _linear(70.0), "rotor": _linear(66.0), **settings})
    recording = extract(path)
    track = recording.bodies["casing"]
    error = _error(track, film.casing)
    assert len(error) > 0.9 * film.frames
    assert np.std(error) < limit
    assert np.abs(error).max() < 5 * limit
    assert recording.sense == film.sense
    assert any("disc" in text for text in recording.warnings) == (name == "no disc")


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        {"blue": (25, 140, 200), "green": (140, 190, 50), "table": "wood"},
        {"table": "white", "bar": 0.3},
        {"size": 0.7, "bar": 0.1, "tilt": 0.15},
    ],
    ids=["cyan and yellow-green on wood", "white table, wide bar", "small papers, narrow bar"],
)
def test_rotor_angle_in_scenes_of_all_kinds(draw, settings):
    path, film = draw(
        **{
            **SMALL,
            "frames": 160,
            "fps": 1000.0,
            "exposure": 0.35e-3,
            "casing": _linear(83.0),
            "rotor": _linear(757.0),
            **settings,
        }
    )
    recording = extract(path)
    error = _error(recording.bodies["rotor"], film.rotor)
    assert len(error) > 0.9 * film.frames
    assert np.std(error) < 10e-3
    assert np.abs(error).max() < 0.08


@pytest.mark.slow
def test_a_film_in_which_nothing_turns_has_a_constant_angle(draw):
    path, _ = draw(**{**SMALL, "frames": 60, "casing": _linear(0.0), "rotor_papers": False, "wobble": 0.0})
    recording = extract(path)
    assert "Nothing turns" in recording.warnings[0]
    track = recording.bodies["casing"]
    assert np.ptp(track.angle) < 8e-3
    assert track.sigma.min() > 0.5e-3  # that it repeats itself does not make it certain


@pytest.mark.slow
def test_papers_that_are_not_there_are_not_found(draw):
    path, _ = draw(**{**SMALL, "frames": 80, "casing": _linear(70.0), "rotor_papers": False})
    recording = extract(path)
    assert recording.body == "casing"
    assert set(recording.markers) == {"red"}
    with pytest.raises(TrackingError, match="The rotor is not visible"):
        extract(path, body="rotor")


@pytest.mark.slow
def test_only_the_casing_when_that_must_be_stated(casing_clip):
    recording = extract(casing_clip[0], body="casing")
    assert set(recording.bodies) == {"casing"}
    with pytest.raises(UsageError):
        extract(casing_clip[0], body="wheel")


def test_a_film_without_markers_is_refused(draw):
    path, _ = draw(**{**SMALL, "frames": 30, "disc": None, "rotor_papers": False, "casing_paper": False})
    with pytest.raises(TrackingError, match="No markers found") as caught:
        extract(path)
    assert path.name in caught.value.message


def test_an_unknown_capture_rate_is_refused_before_tracking(draw):
    path, _ = draw(**{**SMALL, "frames": 10, "container_fps": 30.0})
    with pytest.raises(VideoError, match="does not state at what rate"):
        extract(path)


@pytest.mark.slow
def test_turns_are_counted_through_a_long_blackout(draw):
    def black(k, picture):
        return 0 * picture + 20 if 50 <= k < 110 else picture

    path, film = draw(
        key="black", edit=black, **{**SMALL, "frames": 160, "casing": _linear(70.0), "rotor_papers": False}
    )
    recording = extract(path)
    track = recording.bodies["casing"]
    assert 96 <= len(track.time) <= 100  # a few frames pass before the body is found again
    assert np.abs(_error(track, film.casing)).max() < 0.03  # a slipped turn would be 6.28
    assert (recording.markers["red"].status[50:110] == STATUS["lost"]).all()


@pytest.mark.slow
def test_frames_missing_in_the_file_are_missing_in_time(draw):
    def dropped(k, picture):
        return None if k in (40, 41, 90) else picture

    path, film = draw(
        key="dropped", edit=dropped, **{**SMALL, "casing": _linear(70.0), "rotor_papers": False}
    )
    recording = extract(path)
    track = recording.bodies["casing"]
    np.testing.assert_array_equal(recording.frame_index, np.delete(np.arange(120), [40, 41, 90]))
    np.testing.assert_allclose(recording.time, recording.frame_index / film.fps)
    # the encoder does not draw the same film every time, and a frame may be hard to read
    assert len(track.time) >= 115
    assert np.abs(_error(track, film.casing)).max() < 0.03
    assert any("3 missing frames" in text for text in recording.warnings)


@pytest.mark.slow
def test_a_marker_that_leaves_the_picture_is_flagged(draw):
    path, film = draw(**{**SMALL, "centre": (230.0, 119.5), "casing": _linear(70.0), "rotor_papers": False})
    red = extract(path).markers["red"]
    angle = -film.casing(film.time)
    right = 230.0 + 0.86 * 105.0 * np.cos(angle)  # where its far end is
    assert (red.status[right > 322] == STATUS["out_of_frame"]).all()
    assert (red.status[right < 312] == STATUS["ok"]).mean() > 0.95


@pytest.mark.slow
def test_more_than_half_a_turn_a_frame_is_distinguished_from_the_casings_sense(draw):
    path, film = draw(
        **{**SMALL, "fps": 1000.0, "exposure": 2e-5, "casing": _linear(90.0), "rotor": _linear(4000.0)}
    )
    recording = extract(path)
    track = recording.bodies["rotor"]
    assert np.abs(_error(track, film.rotor)).max() < 0.05
    assert any("half a turn" in text for text in recording.warnings)


def test_a_few_frames_are_too_few(draw):
    path, _ = draw(**{**SMALL, "frames": 3, "rotor_papers": False})
    with pytest.raises(VideoError, match="only 3 frames"):
        extract(path)


@pytest.mark.slow
def test_a_mount_angle_in_the_profile_fixes_the_zero(casing_clip):
    path, _ = casing_clip
    marker = {"name": "red", "colour": "red", "body": "casing"}
    plain = extract(path, parse({"marker": [marker]}, "p")).bodies["casing"].angle
    moved = extract(path, parse({"marker": [{**marker, "mount_angle": 0.5}]}, "p"))
    shift = plain - moved.bodies["casing"].angle
    np.testing.assert_allclose(np.angle(np.exp(1j * (shift - 0.5))), 0, atol=1e-6)
    assert moved.markers["red"].mount_angle == pytest.approx(0.5)


@pytest.mark.slow
def test_any_number_of_threads_gives_the_same_numbers(casing, casing_clip):
    other = extract(casing_clip[0], threads=2)
    np.testing.assert_array_equal(other.bodies["casing"].angle, casing[0].bodies["casing"].angle)


@pytest.mark.slow
def test_a_film_of_which_less_is_left_than_its_samples_promise(casing_clip, monkeypatch):
    """As after damage that one way of decoding survives and the other does not."""
    from dataclasses import replace

    from gyrotrack.tracking import _extract as extraction

    watched = extraction.track_film

    def damaged(*args):
        seen = watched(*args)
        return replace(seen, pts_time=seen.pts_time[:1])

    monkeypatch.setattr(extraction, "track_film", damaged)
    with pytest.raises(VideoError, match="Only 1 frames of"):
        extract(casing_clip[0])


RED = Marker("red", "casing", "red", 20.0, 30.0, 0.2, (40.0, 0.0), 0.3)
SIZE = (100, 80)


def observed(angle, corner_angle=None, corner_radius=None, open_=True, centre=(50.0, 40.0)):
    """Return observations about a centre; corners at the inner end, 0.1 rad on either side of the angle."""
    angle = np.asarray(angle, dtype=np.float64)
    n = len(angle)
    if corner_angle is None:
        corner_angle = angle[:, None] + np.array([-0.1, 0.1])
    if corner_radius is None:
        corner_radius = np.full((n, 2), 20.0)
    one = np.ones(n)
    return MarkerObservations(
        angle, 25 * one, np.asarray(corner_angle, float), np.asarray(corner_radius, float), one, 0 * one, one,
        np.broadcast_to(open_, n).copy(), np.broadcast_to(centre, (n, 2)).astype(float),
    )  # fmt: skip


def test_corners_are_points_of_the_picture_with_y_downwards():
    seen = observed([0.0, 0.0], [[0.0, 0.5 * np.pi], [np.pi, -0.5 * np.pi]], [[10.0, 20.0], [5.0, 8.0]])
    expected = [[[60.0, 40.0], [50.0, 20.0]], [[45.0, 40.0], [50.0, 48.0]]]
    np.testing.assert_allclose(extraction._corners(seen), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("angle", "whole", "used", "corners", "status"),
    [
        (0.3, True, True, 2, "ok"),
        (0.3, True, True, 1, "blurred"),
        (0.3, True, True, 0, "blurred"),
        (0.3, True, False, 2, "lost"),
        (0.3, False, True, 2, "occluded"),
        (0.3, False, False, 2, "occluded"),
        (np.nan, False, False, 0, "lost"),
        (np.nan, True, False, 0, "lost"),
    ],
)
def test_a_status_states_how_a_marker_is_seen(angle, whole, used, corners, status):
    at = [[0.2 if corners > k else np.nan for k in (0, 1)]]
    seen = observed([angle], at, open_=whole)
    assert extraction._status(RED, seen, np.array([used]), SIZE).tolist() == [STATUS[status]]


@pytest.mark.parametrize(
    ("angle", "x", "y", "outside"),
    [
        (0.0, 68.9, 40.0, False),  # the right edge is at 99 px, the outer end of the marker at 29.7 px
        (0.0, 70.5, 40.0, True),
        (np.pi, 30.3, 40.0, False),
        (np.pi, 28.5, 40.0, True),
        (0.5 * np.pi, 50.0, 30.3, False),
        (0.5 * np.pi, 50.0, 28.5, True),
        (-0.5 * np.pi, 50.0, 48.9, False),
        (-0.5 * np.pi, 50.0, 50.5, True),
        # at this angle, the right end is within 0.7 half widths: 30 px * cos(0.6 - 0.14) = 26.9 px
        (0.6, 71.9, 40.0, False),
        (0.6, 72.4, 40.0, True),
    ],
)
def test_a_marker_is_out_of_the_frame_if_a_part_of_it_is(angle, x, y, outside):
    status = extraction._status(RED, observed([angle], centre=(x, y)), np.array([True]), SIZE)
    assert bool(status[0] == STATUS["out_of_frame"]) is outside


@pytest.mark.parametrize("sense", [1, -1])
def test_the_record_of_a_marker_has_the_sense_of_the_rotation(sense):
    angle = np.array([0.3, 2.0, 3.0, -1.2])
    whole = np.array([True, True, True, False])
    sigma = np.array([1e-3, 2e-3, 3e-3, np.nan])
    used = np.where(whole, angle + 0.01, np.nan)
    body = BodyAngles(angle, sigma, np.ones(4, int), {"red": MarkerAngles(used, sigma, 2.5)})
    found = extraction.marker_track(
        RED, observed(angle, open_=whole), body, np.full((4, 2), (50.0, 40.0)), sense, SIZE
    )
    assert (found.name, found.body, found.mount_angle) == ("red", "casing", pytest.approx(sense * 2.5))
    np.testing.assert_allclose(found.angle_fine, sense * used)
    np.testing.assert_allclose(found.angle[:3], sense * angle[:3], atol=1e-9)
    assert np.isnan(found.angle[3])
    assert found.status.tolist() == [STATUS[s] for s in ("ok", "ok", "ok", "occluded")]
    np.testing.assert_array_equal(found.sigma_calibrated, sigma)
    assert np.isnan(found.corner[3]).all()
    # the corner with the lower angle, in the sense of the rotation, is the first
    expected = 50.0 + 20.0 * np.cos(angle[:3, None] + sense * np.array([-0.1, 0.1]))
    np.testing.assert_allclose(found.corner[:3, :, 0], expected)
    expected = 40.0 - 20.0 * np.sin(angle[:3, None] + sense * np.array([-0.1, 0.1]))
    np.testing.assert_allclose(found.corner[:3, :, 1], expected)
    np.testing.assert_allclose(found.rho[:3], 20.0 * np.cos(0.1))
    np.testing.assert_allclose(found.delta[:3], 40.0 * np.sin(0.1))


@pytest.mark.parametrize("sense", [1, -1])
def test_the_record_of_a_body_omits_frames_without_an_angle(sense):
    time = 0.01 * np.arange(300)
    angle = 3.0 * time
    angle[[4, 9]] = np.nan
    sigma, paper = np.full(300, 2e-3), np.full(300, 5e-3)
    paper[7] = np.nan
    body = BodyAngles(
        angle, sigma, np.arange(300), {"red": MarkerAngles(angle, sigma, 0.0)}, slow=(3e-3, 50.0),
        slow_parts=np.array([[10.0, 1e-3], [30.0, 4e-3]]), periodic=6e-3, harmonic=7e-3,
    )  # fmt: skip
    records = {"red": SimpleNamespace(sigma=paper), "blue": SimpleNamespace(sigma=9 * paper)}
    found = extraction.body_track("casing", body, records, time, sense, 100.0)
    kept = np.isfinite(angle)
    assert found.name == "casing"
    np.testing.assert_array_equal(found.time, time[kept])
    np.testing.assert_array_equal(found.angle, sense * angle[kept])
    np.testing.assert_array_equal(found.sigma, sigma[kept])
    np.testing.assert_array_equal(found.n_markers, np.arange(300)[kept])
    np.testing.assert_array_equal(found.sigma_paper, paper[kept])
    np.testing.assert_allclose(found.omega[120:-120], sense * 3.0)
    assert (found.correlated_sigma, found.correlated_time) == (3e-3, 0.5)
    assert (found.periodic_sigma, found.harmonic_sigma) == (6e-3, 7e-3)
    assert np.array(found.correlated_profile) == pytest.approx(np.array([[0.1, 1e-3], [0.3, 4e-3]]))


def test_frames_are_counted_from_one():
    told = []
    assert list(extraction._counted(["a", "b", "c"], 5, lambda *given: told.append(given))) == ["a", "b", "c"]
    assert told == [(1, 5), (2, 5), (3, 5)]
    assert list(extraction._counted(["a"], 5, None)) == ["a"]


@pytest.mark.parametrize(
    ("shaken", "disc", "fast", "rolls", "length"),
    [
        (True, True, True, False, 7),
        (False, True, True, True, 7),
        (False, False, True, False, 7),
        (False, True, False, False, 7),
        (True, True, True, False, 6),
        (False, True, True, True, 6),
    ],
)
def test_the_motion_of_a_camera_is_measured_by_features_else_by_its_roll(
    monkeypatch, shaken, disc, fast, rolls, length
):
    asked = {}

    def measured(name, known):
        def measure(*given):
            asked[name] = given[-1]
            return SimpleNamespace(roll=np.zeros(length), way=name) if known else None

        return measure

    scene = SimpleNamespace(
        centre=(4.0, 5.0), markers=(RED, Marker("b", "rotor", "b", 5.0, 40.0, 0.1, (1, 1), 0.2))
    )
    seen = SimpleNamespace(disc=np.zeros((7, 2)) if disc else None, pts_time=np.zeros(7))
    fakes = {
        "PartWorkers": lambda *_: nullcontext(), "single_threaded": nullcontext, "Reader": lambda *_: nullcontext([]),
        "take_samples": lambda *_: SimpleNamespace(frames=[]), "acquire": lambda *_: scene,
        "FilmTracker": lambda *_: None, "track_film": lambda *_: seen, "moves_fast": lambda _: fast,
        "camera_shake": measured("features", shaken), "background_roll": measured("roll", True),
    }  # fmt: skip
    for name, fake in fakes.items():
        monkeypatch.setattr(extraction, name, fake)
    *found, shake = extraction._observe(Path("film.mp4"), None, 2, 1, None, None, None)
    assert found == [scene, seen]
    assert asked["features"] == (4.0, 5.0, 60.0)  # 1.5 times the largest marker
    assert asked.get("roll") == ((4.0, 5.0, 60.0) if rolls else None)
    # a motion of the camera is used if it is known in all frames
    assert (shake is not None) is ((shaken or rolls) and length == 7)
    if shake:
        assert shake.way == ("features" if shaken else "roll")


def test_only_markers_of_the_casing_are_kept():
    class Profile:
        name = "P"

        def of(self, body):
            return self.marks if body == "casing" else ("wrong",)

        def model_copy(self, update):
            return update

    profile = Profile()
    profile.marks = ("red",)
    assert extraction._only_casing(profile) == {"marker": ("red",)}
    profile.marks = ()
    with pytest.raises(UsageError, match="no marker on the casing"):
        extraction._only_casing(profile)


class TestJob:
    JOB = extraction.ExtractionJob(
        Path("film.mp4"),
        Path("out.h5"),
        SimpleNamespace(model_dump=lambda **_: "profile"),
        250.0,
        "both",
        "stamps",
        3,
    )

    def test_settings_determine_the_result(self):
        assert self.JOB.settings == {
            "video": Path("film.mp4"), "capture_fps": 250.0, "body": "both", "times": "stamps", "profile": "profile",
        }  # fmt: skip

    @pytest.mark.parametrize(
        ("change", "film", "kept"),
        [
            ({}, "sum", True),
            ({"video": "moved"}, "sum", True),
            ({"times": "auto"}, "sum", False),
            ({}, "x", False),
        ],
    )
    def test_an_earlier_output_has_the_same_film_and_settings(self, monkeypatch, change, film, kept):
        discarded = []
        output = SimpleNamespace(source_sha256="sum")
        journal = SimpleNamespace(discard=lambda: discarded.append(1))
        monkeypatch.setattr(extraction, "probe", lambda _: None)
        monkeypatch.setattr(extraction, "read_settings", lambda _: self.JOB.settings | change)
        monkeypatch.setattr(extraction, "read_recording", lambda _: output)
        monkeypatch.setattr(extraction, "file_sha256", lambda _: film)
        monkeypatch.setattr(extraction, "CheckpointFile", lambda *_: nullcontext(journal))
        assert self.JOB.earlier() is (output if kept else None)
        assert len(discarded) == kept

        def damaged(_):
            raise DatasetError("damaged", "remove it")

        monkeypatch.setattr(extraction, "read_settings", damaged)
        assert self.JOB.earlier() is None

    def run(self, monkeypatch, *, done=30, other=False, limit="", resume=False, stop=False):
        told, written = [], {}
        journal = SimpleNamespace(
            other=other, path=Path("x.part"), discard=lambda: written.update(discarded=True)
        )

        def extract(*given, **options):
            written["options"] = options
            if stop:
                raise KeyboardInterrupt
            return SimpleNamespace(frames_decoded=130)

        monkeypatch.setattr(extraction, "run_facts", lambda *given: given[1:])
        monkeypatch.setattr(extraction, "CheckpointFile", lambda *_, **__: nullcontext(journal))
        monkeypatch.setattr(extraction, "frames_done", lambda _: done)
        monkeypatch.setattr(extraction, "extract", extract)
        monkeypatch.setattr(extraction, "write_recording", lambda *_, **given: written.update(given))
        monkeypatch.setattr(extraction, "perf_counter", iter([10.0, 14.0]).__next__)
        monkeypatch.setattr(extraction.ExtractionJob, "_limit_of_processes", lambda _: limit)
        with pytest.raises(KeyboardInterrupt) if stop else nullcontext():
            written["rate"] = self.JOB.run(
                command="c", bar=lambda: nullcontext("bar"), tell=told.append, resume=resume, force=True
            )[1]
        return told, written

    def test_the_rate_counts_only_frames_tracked_now(self, monkeypatch):
        told, written = self.run(monkeypatch, limit="a limit")
        assert written["rate"] == 25.0  # 100 frames in 4 s
        assert written["discarded"]
        assert (written["command"], written["force"], written["settings"]) == ("c", True, self.JOB.settings)
        wanted = {"capture_fps": 250.0, "body": "both", "times": "stamps", "workers": 3, "progress": "bar"}
        assert written["options"].items() >= wanted.items()
        assert told == ["30 frames of an earlier run are used.", "a limit"]

    @pytest.mark.parametrize(("other", "messages"), [(True, 1), (False, 0)])
    def test_a_checkpoint_of_another_film_is_reported(self, monkeypatch, other, messages):
        told, _ = self.run(monkeypatch, done=0, other=other)
        assert len(told) == messages

    @pytest.mark.parametrize(
        ("done", "resume", "last"), [(0, False, None), (30, False, True), (30, True, False)]
    )
    def test_an_interrupted_run_states_how_to_continue(self, monkeypatch, done, resume, last):
        told, written = self.run(monkeypatch, done=done, resume=resume, stop=True)
        assert "discarded" not in written
        assert "command" not in written
        assert len(told) == (0 if last is None else 2)
        if last is not None:
            assert told[-1].startswith("30 frames are stored")
            assert ("--resume" in told[-1]) is last
