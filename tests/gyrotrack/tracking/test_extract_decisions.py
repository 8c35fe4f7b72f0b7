"""Records of markers and bodies, and the parts of an extraction, from small arrays; nothing is tracked."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import DatasetError, UsageError
from gyrotrack.io._schema import STATUS
from gyrotrack.tracking import _extract as extraction
from gyrotrack.tracking._fusion import BodyAngles, MarkerAngles
from gyrotrack.tracking._marker_tracker import MarkerObservations
from gyrotrack.tracking._scene import Marker

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
