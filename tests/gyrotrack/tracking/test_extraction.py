"""Films by a foreign renderer, with known angles, through the whole of `extract`."""

import numpy as np
import pytest

from gyrotrack import TrackingError, UsageError, VideoError
from gyrotrack.io._schema import STATUS
from gyrotrack.tracking._extract import extract
from gyrotrack.tracking._profile import parse

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
