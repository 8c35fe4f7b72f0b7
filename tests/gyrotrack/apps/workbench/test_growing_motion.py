"""The motion of a film grows by frames while it is tracked: from the tracker through the pipe to the charts."""

import io
import json
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack.apps.cli._output import Output
from gyrotrack.apps.workbench import _growing_motion as growing
from gyrotrack.apps.workbench import _processes
from gyrotrack.apps.workbench._motion_charts import motion_board
from gyrotrack.apps.workbench._processes import Job
from gyrotrack.io._atomic import CheckpointFile, checkpoint_path, written_records
from gyrotrack.tracking import _film_parts as film_parts
from gyrotrack.tracking._live_angles import FrameAngles, angles_sent_to, current_sink, report_angles

RATE, OMEGA = 100.0, 7.0


def _report(first, last, part=0, body="casing", begin=0.0):
    frame = np.arange(first, last)
    return {
        "part": part,
        "body": body,
        "frame": frame.tolist(),
        "angle": (OMEGA * frame / RATE - begin).tolist(),
    }


def _motion(*reports):
    found = growing.GrowingMotion()
    for report in reports:
        found.add(report)
    return found


class TestReports:
    """What trackers report, and what reaches the page."""

    def test_angles_reach_the_job_of_the_page_and_nothing_is_sent_without_a_sink(self, monkeypatch):
        monkeypatch.setenv("GYROTRACK_PROGRESS", "json")
        stream, job = io.StringIO(), Job(("extract",))
        monkeypatch.setattr("sys.stderr", stream)
        frame = np.arange(200)
        report_angles("casing", 0, frame, frame.astype(float))
        assert stream.getvalue() == ""
        with Output(as_json=True).progress("tracking") as progress:
            angle = np.where(frame == 3, np.nan, OMEGA * frame / RATE)
            report_angles("casing", 0, frame, angle)
            progress(200, 400)
        assert current_sink() is None
        lines = stream.getvalue().splitlines()
        assert max(map(len, lines)) < 4096  # what a pipe of POSIX takes at once from one of several processes
        _processes._listen(job, lines)
        assert (job.done, job.total, job.summary()["angles"]) == (200, 400, 199)
        ((time, angle, speed),) = growing.joined_motion(job.motion.parts(), RATE)["casing"]
        assert len(time) == 199
        assert angle == pytest.approx(OMEGA * time, abs=1e-4)
        assert speed == pytest.approx(OMEGA, abs=2e-3)

    def test_lines_of_another_form_are_skipped(self):
        job = Job(("extract",))
        lines = [
            '{"angles": 3}',
            '{"angles": {"part": 0}}',
            '{"angles": {',
            json.dumps({"angles": _report(0, 5)}),
        ]
        _processes._listen(job, lines)
        assert job.motion.reported == 5

    def test_frames_of_a_single_body_are_reported_some_together(self):
        found = []
        with angles_sent_to(lambda *report: found.append(report)):
            live = FrameAngles("single")
            for frame in range(35):
                live.add(2 * frame, 0.1 * frame)
        assert [len(r[2]) for r in found] == [16, 16]
        assert found[1][2][0] == 32
        assert found[1][3][0] == pytest.approx(1.6)

    def test_the_tracker_of_a_part_reports_every_time_that_it_takes_frames(self):
        frames = [SimpleNamespace(index=300 + k) for k in range(5)]
        coarse = np.arange(20.0)
        body = SimpleNamespace(coarse=lambda place, count: coarse[place : place + count])
        work = SimpleNamespace(held=frames, filled=7, bodies={"casing": body}, take=frames.clear)
        found = []
        with angles_sent_to(lambda *report: found.append(report)):
            film_parts._take(work, 260)
        ((name, part, frame, angle),) = found
        assert (name, part) == ("casing", 260)
        assert frame.tolist() == [300, 301, 302, 303, 304]
        assert angle.tolist() == [7, 8, 9, 10, 11]


class TestMemory:
    """A long film is thinned evenly; a part that begins anew replaces what was reported."""

    @pytest.mark.parametrize(("most", "kept"), [(100, 100), (99, 50), (49, 25)])
    def test_the_number_of_samples_is_bounded(self, monkeypatch, most, kept):
        monkeypatch.setattr(growing, "MOST", most)
        found = _motion(*(_report(k, k + 10) for k in range(0, 100, 10)))
        ((frame, angle),) = (p["casing"] for p in found.parts())
        assert len(frame) == kept
        assert np.ptp(np.diff(frame)) == 0
        assert angle == pytest.approx(OMEGA * frame / RATE)
        assert found.reported == 100

    def test_a_part_that_is_decoded_again_is_shown_once(self):
        found = _motion(_report(0, 30), _report(30, 40))
        assert len(found.parts()[0]["casing"][0]) == 40
        found.add(_report(39, 50))
        assert found.parts()[0]["casing"][0].tolist() == list(range(39, 50))

    def test_a_checkpoint_is_thinned_too(self, monkeypatch):
        arrays = {
            "stamps": 512 * np.arange(100),
            "rotor/coarse": np.arange(100.0),
            "rotor/red/angle": np.zeros(100),
        }
        record = SimpleNamespace(facts={"part": 0}, arrays=arrays)
        ((frame, angle),) = (p["rotor"] for p in growing.stored_parts([record]))
        assert frame.tolist() == angle.tolist() == list(range(100))
        monkeypatch.setattr(growing, "MOST", 99)
        ((frame, angle),) = (p["rotor"] for p in growing.stored_parts([record]))
        assert frame.tolist() == angle.tolist() == list(range(0, 100, 2))


class TestParts:
    """Parts that are tracked at the same time are joined as in the recording."""

    @pytest.mark.parametrize("turns", [0, 3, -2])
    def test_angles_continue_from_one_part_to_the_next(self, turns):
        # the second part, which overlaps the first one, is further than its end
        first = _report(0, 210, begin=2.5)
        parts = _motion(first, _report(200, 400, part=200, begin=2.5 + 2 * np.pi * turns)).parts()
        found = growing.joined_motion(parts, RATE)["casing"]
        assert len(found) == 2
        for time, angle, speed in found:
            assert angle == pytest.approx(OMEGA * time, abs=1e-9)
            assert speed == pytest.approx(np.full(len(speed), OMEGA), abs=1e-9)

    @pytest.mark.parametrize(("body", "sign"), [("casing", 1), ("rotor", 1), ("single", -1)])
    def test_marked_bodies_turn_forwards_and_a_single_one_as_it_is_seen(self, body, sign):
        report = _report(0, 100, body=body)
        report["angle"] = [-a for a in report["angle"]]
        ((_, angle, speed),) = growing.joined_motion(_motion(report).parts(), RATE)[body]
        assert np.sign(angle[-1]) == sign
        assert np.sign(speed[0]) == sign

    @pytest.mark.parametrize(("samples", "pieces"), [(9, 0), (10, 1)])
    def test_a_speed_needs_more_samples_than_its_median(self, samples, pieces):
        found = growing.joined_motion(_motion(_report(0, samples)).parts(), RATE)
        assert len(found.get("casing", [])) == pieces

    def test_the_parts_of_a_checkpoint_are_shown_after_an_interruption(self, tmp_path):
        path = tmp_path / "a.h5"
        assert written_records(checkpoint_path(path)) == []
        with CheckpointFile(path, {"film": "x"}) as journal:
            for part, (first, last) in enumerate(((0, 210), (200, 400))):
                frame = np.arange(first, last)
                arrays = {"stamps": 512 * frame, "casing/coarse": OMEGA * frame / RATE - 6 * np.pi * part}
                journal.append({"part": part, "parts": 3, "frames": len(frame)}, arrays)
                found = growing.joined_motion(growing.stored_parts(written_records(journal.path)), RATE)
                assert len(found["casing"]) == part + 1
                for time, angle, _ in found["casing"]:
                    assert angle == pytest.approx(OMEGA * time, abs=1e-9)
            content = journal.path.read_bytes()
            journal.path.write_bytes(content[:-5])  # a record that is being written is not shown yet
            assert len(written_records(journal.path)) == 1
            journal.path.write_bytes(content)


def test_the_charts_show_what_a_running_command_has_found(tmp_path):
    source = SimpleNamespace(
        key="1", file="a.mp4", kind="film", body="casing", capture_fps=RATE, output="a.h5"
    )
    job = SimpleNamespace(is_active=True, motion=growing.GrowingMotion())
    project = SimpleNamespace(
        folder=tmp_path,
        state=SimpleNamespace(sources=[source], match={}),
        jobs=SimpleNamespace(get={"track:1": job}.get),
        document=lambda: {"is_matched": False},
        is_tracked=lambda _: True,  # with its earlier result, while it is tracked again
    )
    assert motion_board(project)["charts"] == []
    lengths = []
    for first in (0, 64, 128):
        job.motion.add(_report(first, first + 64))
        speed, angle = motion_board(project)["charts"]
        assert (speed["name"], angle["name"]) == ("speed", "angle")
        lengths.append(angle["traces"][0]["x"]["count"])
    assert lengths == [64, 128, 192]
    job.is_active = False
    project.is_tracked = lambda _: False
    assert motion_board(project)["charts"] == []  # there is no checkpoint
