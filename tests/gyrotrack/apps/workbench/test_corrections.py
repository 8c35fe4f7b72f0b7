"""A marker that a person corrects in one frame."""

import numpy as np
import pytest

from gyrotrack import UsageError, read_recording, write_recording
from gyrotrack.apps.workbench._corrections import (
    CLICK_SIGMA,
    JUMP,
    corrected,
    corrections,
    jump,
    without_correction,
)
from gyrotrack.apps.workbench._films import copy_excerpt
from gyrotrack.io._schema import STATUS
from gyrotrack.tracking._extract import extract

from .test_project import CLIPS


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    film = tmp_path_factory.mktemp("film") / "rotor.mp4"
    copy_excerpt(CLIPS / "rotor_1.mp4", film, 120)
    return extract(film, capture_fps=1000.0)


def _place(recording, marker, frame):
    """Return a place [px] in the direction in which tracking saw the marker."""
    angle = recording.sense * recording.markers[marker].angle_fine[frame]
    return recording.centre[frame] + 60 * np.array([np.cos(angle), -np.sin(angle)])


@pytest.mark.slow
@pytest.mark.parametrize("marker", ["red", "blue"])
def test_a_click_on_the_marker_gives_the_angle_that_tracking_gives(recording, marker):
    body = recording.markers[marker].body
    before = recording.bodies[body]
    k = 100
    found = corrected(recording, marker, k, _place(recording, marker, k))
    after = found.bodies[body]
    assert len(after.time) == len(before.time)
    # the body's angle is that of all its markers; the clicked one agrees within its own errors
    assert after.angle[k] == pytest.approx(before.angle[k], abs=0.02)
    assert after.sigma[k] == pytest.approx(CLICK_SIGMA / 60)
    assert np.array_equal(np.delete(after.angle, k), np.delete(before.angle, k))


def test_a_wrong_click_moves_the_angle_with_its_sign_and_is_kept_with_its_origin(recording, tmp_path):
    k = int(np.flatnonzero(np.isfinite(recording.markers["blue"].angle_fine))[40])
    x, y = _place(recording, "blue", k) - recording.centre[k]
    turn = 0.3  # counter-clockwise as seen
    moved = recording.centre[k] + [x * np.cos(turn) + y * np.sin(turn), -x * np.sin(turn) + y * np.cos(turn)]
    found = corrected(recording, "blue", k, moved)
    change = (
        found.bodies["rotor"].angle[k]
        - corrected(recording, "blue", k, _place(recording, "blue", k)).bodies["rotor"].angle[k]
    )
    assert change == pytest.approx(0.3 * recording.sense, abs=1e-9)
    write_recording(tmp_path / "r.h5", found, command="test", settings={})
    again = read_recording(tmp_path / "r.h5")
    (note,) = again.extra["corrections"]
    assert (note["marker"], note["frame"], note["by"]) == ("blue", k, "hand")
    assert note["previous_angle_rad"] == pytest.approx(recording.markers["blue"].angle_fine[k])
    assert "1 frame is corrected by hand." in again.warnings
    assert np.isnan(again.markers["blue"].corner[k]).all()


def test_a_marker_that_is_not_visible_leaves_the_body_without_an_angle(recording):
    found = corrected(recording, "red", 7, None)
    assert found.markers["red"].status[7] == STATUS["lost"]
    assert len(found.bodies["casing"].time) == len(recording.bodies["casing"].time) - 1
    back = corrected(found, "red", 7, _place(recording, "red", 7))
    assert back.bodies["casing"].time[7] == recording.time[7]
    assert len(back.extra["corrections"]) == 1
    for frame, marker, place in ((999, "red", None), (7, "pink", None), (7, "red", recording.centre[7])):
        with pytest.raises(UsageError):
            corrected(recording, marker, frame, place)


def test_a_deleted_correction_leaves_the_frame_as_it_was_tracked(recording, tmp_path):
    k = 60
    once = corrected(recording, "blue", k, _place(recording, "blue", k) + np.array([20, 5]))
    twice = corrected(once, "blue", k, _place(recording, "blue", k) - np.array([20, 5]))
    both = corrected(twice, "green", k, _place(recording, "green", k) + np.array([3, 3]))
    write_recording(tmp_path / "r.h5", both, command="test", settings={})
    stored = read_recording(tmp_path / "r.h5")
    assert [(c["marker"], c["frame"]) for c in corrections(stored)] == [("blue", k), ("green", k)]
    only_blue = without_correction(stored, "green", k)
    # the angle of the body is again that of the remaining correction
    assert only_blue.bodies["rotor"].angle[k] == pytest.approx(twice.bodies["rotor"].angle[k], abs=1e-9)
    back = without_correction(only_blue, "blue", k)
    assert corrections(back) == []
    assert back.warnings == recording.warnings
    for name in ("angle", "sigma", "sigma_paper", "n_markers", "omega"):
        found, expected = (getattr(r.bodies["rotor"], name) for r in (back, recording))
        assert np.allclose(found, expected, equal_nan=True, atol=1e-12)
    for marker in ("blue", "green"):
        for name in ("corner", "rho", "angle_fine", "sigma_calibrated", "status"):
            found, expected = (getattr(r.markers[marker], name)[k] for r in (back, recording))
            assert np.allclose(found, expected, equal_nan=True)
    with pytest.raises(UsageError, match="no such correction"):
        without_correction(back, "blue", k)


def test_a_correction_of_an_earlier_version_is_not_deleted_without_its_content(recording):
    found = corrected(recording, "red", 7, None)
    for note in found.extra["corrections"]:
        del note["previous"]
    with pytest.raises(UsageError, match="earlier version"):
        without_correction(found, "red", 7)


@pytest.mark.parametrize("turn", [130.0, -130.0, 180.0])
def test_a_click_far_from_the_neighbouring_frames_is_doubted(recording, turn):
    k, angle = 80, np.radians(turn)
    x, y = _place(recording, "blue", k) - recording.centre[k]
    moved = recording.centre[k] + [
        x * np.cos(angle) + y * np.sin(angle),
        -x * np.sin(angle) + y * np.cos(angle),
    ]
    assert np.degrees(abs(jump(recording, "blue", k, moved))) == pytest.approx(abs(turn), abs=3)
    assert jump(recording, "blue", k, _place(recording, "blue", k)) is None


def test_a_click_is_doubted_from_five_standard_uncertainties_on(recording):
    body, k = recording.bodies["casing"], 50
    time = recording.time[k]
    others = np.abs(body.time - time) > 1e-9
    expected = np.interp(time, body.time[others], body.angle[others])
    middle = 0.5 * (body.angle[:-2] + body.angle[2:])
    u = np.hypot(CLICK_SIGMA / 60, np.median(np.abs(body.angle[1:-1] - middle)) / 0.6745)
    for factor, doubted in ((0.95, False), (1.05, True)):
        a = recording.sense * (expected + recording.markers["red"].mount_angle + factor * JUMP * u)
        place = recording.centre[k] + 60 * np.array([np.cos(a), -np.sin(a)])
        assert (jump(recording, "red", k, place) is not None) is doubted
