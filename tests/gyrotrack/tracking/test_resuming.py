"""A run that was stopped anywhere goes on and ends with the same numbers; memory does not grow with the film."""

import dataclasses
import errno
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import av
import h5py
import numpy as np
import pytest

from gyrotrack.apps.cli._app import run
from gyrotrack.io._atomic import CheckpointFile, checkpoint_path
from gyrotrack.tracking import _film_parts
from gyrotrack.tracking._extract import extract, run_facts
from gyrotrack.tracking._film_parts import frames_done, split, turns_between
from gyrotrack.tracking._live_angles import angles_sent_to
from gyrotrack.tracking._profile import PAPER
from gyrotrack.video._container import Packets
from gyrotrack.video._decoder import Part


def stopping(at):
    def progress(done, total):
        if done >= at:
            raise KeyboardInterrupt

    return progress


def content(path):
    found = {}

    def keep(name, item):
        if isinstance(item, h5py.Dataset):
            found[name] = item[()].tobytes()

    with h5py.File(path) as file:
        file.visititems(keep)
        found |= {k: str(v) for k, v in file.attrs.items() if k not in {"created", "command"}}
    return found


@pytest.fixture
def short_parts(monkeypatch):
    monkeypatch.setattr("gyrotrack.tracking._film_parts.PART", 260)
    monkeypatch.setattr("gyrotrack.tracking._film_parts.LEAST_PART", 200)


@pytest.mark.slow
def test_a_stopped_run_ends_with_the_same_numbers(short_parts, long_film, tmp_path):
    film = long_film(4)
    whole = extract(film)
    facts = run_facts(film, PAPER, None)
    with pytest.raises(KeyboardInterrupt), CheckpointFile(tmp_path / "o.h5", facts) as journal:
        extract(film, progress=stopping(700), journal=journal)
    with CheckpointFile(tmp_path / "o.h5", facts, resume=True) as journal:
        kept = frames_done(journal)
        assert 260 <= kept < 1040
        done = []
        again = extract(film, progress=lambda n, _: done.append(n), journal=journal)
    assert done[0] == kept  # what was done is not done again
    assert done[-1] == 1040
    same(again, whole)


@pytest.mark.slow
def test_angles_that_are_shown_while_tracking_change_nothing(short_parts, long_film, tmp_path):
    film, seen = long_film(4), []
    whole = extract(film)

    def sink(*report):
        seen.append(report)

    with angles_sent_to(sink):
        again = extract(film)
    same(again, whole)
    parts = {part for _, part, _, _ in seen}
    assert len(parts) == 4
    assert len(seen) > 4 * len(parts)  # they grow by frames, not by parts
    assert _frames_of_casing(seen) == set(range(1040))
    # a run that continues from a checkpoint shows its parts, too
    seen.clear()
    facts = run_facts(film, PAPER, None)
    with pytest.raises(KeyboardInterrupt), CheckpointFile(tmp_path / "o.h5", facts) as journal:
        extract(film, progress=stopping(700), journal=journal)
    assert seen == []
    with CheckpointFile(tmp_path / "o.h5", facts, resume=True) as journal, angles_sent_to(sink):
        same(extract(film, journal=journal), whole)
    assert _frames_of_casing(seen) == set(range(1040))


def _frames_of_casing(seen):
    return {frame for body, _, frames, _ in seen if body == "casing" for frame in frames.tolist()}


def same(again, whole):
    for name, body in whole.bodies.items():
        for column in ("time", "angle", "sigma", "omega", "n_markers"):
            np.testing.assert_array_equal(getattr(again.bodies[name], column), getattr(body, column))
    for name, marker in whole.markers.items():
        np.testing.assert_array_equal(again.markers[name].corner, marker.corner)
        np.testing.assert_array_equal(again.markers[name].status, marker.status)
    np.testing.assert_array_equal(again.pts_time, whole.pts_time)
    assert again.warnings == whole.warnings


@pytest.mark.slow
def test_the_command_goes_on_and_knows_when_it_is_done(short_parts, long_film, tmp_path, capsys):
    film, target = long_film(4), tmp_path / "o.h5"
    words = ["extract", str(film), "-o", str(target), "--workers", "1"]
    assert run([*words, "-q"]) == 0
    whole = content(target)
    target.unlink()
    facts = run_facts(film, PAPER, None)
    with pytest.raises(KeyboardInterrupt), CheckpointFile(target, facts) as journal:
        extract(film, progress=stopping(700), journal=journal)
    assert checkpoint_path(target).exists()
    capsys.readouterr()
    assert run(words) == 0
    assert "of an earlier run are used" in capsys.readouterr().err
    assert content(target) == whole
    assert sorted(path.name for path in tmp_path.iterdir()) == ["4.mp4", "o.h5"]
    assert run([*words, "--resume"]) == 0
    assert "already complete" in capsys.readouterr().err
    assert run([*words, "--resume", "--body", "casing"]) == 1  # not the same run
    assert "--force" in capsys.readouterr().err
    assert content(target) == whole


@pytest.mark.slow
def test_a_journal_that_does_not_fit_the_film_is_started_anew(short_parts, long_film, rotor_clip, tmp_path):
    output = tmp_path / "o.h5"
    with pytest.raises(KeyboardInterrupt), CheckpointFile(output, {"film": "x"}) as journal:
        extract(long_film(4), progress=stopping(700), journal=journal)
    with CheckpointFile(
        output, {"film": "x"}, resume=True
    ) as journal:  # as if the film had been changed behind our back
        again = extract(rotor_clip[0], journal=journal)
    np.testing.assert_array_equal(again.bodies["rotor"].angle, extract(rotor_clip[0]).bodies["rotor"].angle)


@pytest.mark.slow
def test_an_interrupted_command_says_how_to_go_on(short_parts, long_film, tmp_path, capsys, monkeypatch):
    film, whole = long_film(4), extract

    def interrupted(*words, **settings):
        return whole(*words, **{**settings, "workers": 1, "progress": stopping(700)})

    monkeypatch.setattr("gyrotrack.tracking._extract.extract", interrupted)
    assert run(["extract", str(film), "-o", str(tmp_path / "o.h5")]) == 130
    assert "frames are stored. Continue with the same command." in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["4.mp4", "o.h5.unfinished"]


@pytest.mark.slow
def test_any_number_of_workers_gives_the_same_bits(long_film):
    film = long_film(20)  # 5,200 frames, four parts
    alone, two, three = (extract(film, workers=n) for n in (1, 2, 3))
    same(two, alone)
    same(three, alone)


@pytest.mark.slow
def test_parts_join_without_a_step(long_film, monkeypatch):
    film = long_film(4)
    whole = extract(film)
    monkeypatch.setattr("gyrotrack.tracking._film_parts.PART", 260)
    monkeypatch.setattr("gyrotrack.tracking._film_parts.LEAST_PART", 200)
    parts = extract(film)
    for name, body in whole.bodies.items():
        assert len(parts.bodies[name].angle) == len(body.angle) == 1040
        apart = parts.bodies[name].angle - body.angle
        assert np.abs(apart).max() < 8 * np.median(body.sigma)
        # the zero of the angle is free: a step is a difference between parts
        steps = np.diff(apart.reshape(4, 260).mean(axis=1))
        assert np.abs(steps).max() < 0.1 * np.median(body.sigma)
        assert np.abs(apart.mean()) < 0.5 * np.median(body.sigma)

    def full_disk(**_):
        raise OSError(errno.ENOSPC, "No space left on device")

    # the first frames of each part are then decoded a second time
    monkeypatch.setattr("gyrotrack.tracking._film_parts.scratch_folder", full_disk)
    same(extract(film), parts)


def packets(count, keys):
    flags = np.zeros(count, dtype=np.bool_)
    flags[list(keys)] = True
    return Packets(100 + 10 * np.arange(count), np.full(count, 900), flags, complete=True)


def test_parts_depend_on_the_film_alone():
    parts = split(packets(10_000, range(0, 10_000, 250)))
    assert [p.first for p in parts] == [0, 2500, 5000, 7500]
    assert [p.start for p in parts] == [None, 25_100, 50_100, 75_100]
    assert [p.stop for p in parts] == [25_740, 50_740, 75_740, None]  # 64 frames into the next one
    assert len(split(packets(3000, range(0, 3000, 250)))) == 2
    assert split(packets(700, range(0, 700, 50))) == (Part(),)
    assert split(packets(9000, [0])) == (Part(),)
    assert split(dataclasses.replace(packets(9000, range(0, 9000, 250)), complete=False)) == (Part(),)


def test_a_part_continues_at_the_last_key_frame_of_its_first_batch():
    def continues(every, *part):
        return _film_parts._second_start(packets(3000, range(0, 3000, every)), Part(*part))

    assert [continues(every) for every in (30, 250, 256, 300, 512)] == [510, 500, 512, 300, 512]
    assert continues(600) is None
    assert continues(250, 1500, 15_100) == 2000
    assert continues(300, 0, None, 100 + 10 * 290) is None  # beyond the part


def test_turns_between_parts():
    turn = 2 * np.pi
    frame = np.arange(200.0)
    angle = 0.4 * frame
    late = frame[100:]
    # seen by both in 40 frames, two turns apart
    added = turns_between(frame[:140], angle[:140], late, angle[100:] - 2 * turn)
    np.testing.assert_allclose(added, 2 * turn)
    # one of them took the motion for one turn a frame less
    added = turns_between(frame[:140], angle[:140], late, angle[100:] - 3 * turn - turn * (late - 100))
    np.testing.assert_allclose(added, 3 * turn + turn * (late - 100))
    # lost where they meet: it runs on
    lost = np.where(frame[:140] < 90, angle[:140], np.nan)
    hidden = np.where(late > 130, angle[100:] - 5 * turn, np.nan)
    np.testing.assert_allclose(turns_between(frame[:140], lost, late, hidden), 5 * turn)


def repeated(source, target, times):
    """Write a film's packets over and over: as many frames as wanted, drawn once."""
    with av.open(str(source)) as film, av.open(str(target), "w") as longer:
        stream = film.streams.video[0]
        out = longer.add_stream_from_template(stream)
        packets = [(bytes(p), p.pts, p.dts, p.is_keyframe, p.duration) for p in film.demux(stream) if p.size]
        length = sum(p[4] for p in packets)
        for k in range(times):
            for data, pts, dts, key, duration in packets:
                packet = av.Packet(data)
                packet.pts, packet.dts, packet.duration = pts + k * length, dts + k * length, duration
                packet.time_base, packet.stream, packet.is_keyframe = stream.time_base, out, key
                longer.mux(packet)
    return target


@pytest.fixture
def long_film(draw, tmp_path):
    """Return a maker of films of 260 frames a round; every round joins on to the one before."""
    turn = 2 * np.pi
    film, _ = draw(
        key="round",
        width=320,
        height=240,
        radius=105.0,
        frames=260,
        casing=lambda t: 0.4 + 6 * turn * t,
        rotor=lambda t: 1.0 + 31 * turn * t,
    )
    return lambda rounds: repeated(film, tmp_path / f"{rounds}.mp4", rounds)


_KILLS = 4


@pytest.mark.release
@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL")
def test_killed_at_random_moments_it_ends_with_the_same_numbers(long_film, tmp_path):
    film, target = long_film(40), tmp_path / "o.h5"
    words = [sys.executable, "-m", "gyrotrack", "extract", str(film), "-o", str(target), "-q"]
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    whole = content(target)
    rng = np.random.default_rng(0)
    kills = kept = 0
    while kills < _KILLS:
        target.unlink()
        while True:
            with subprocess.Popen([*words, "--resume"], stdout=subprocess.DEVNULL) as process:
                try:
                    # a slow machine, which comes less far between two kills, is left alone at last
                    assert process.wait(rng.uniform(0.3, 5.0) if kills < _KILLS else None) == 0
                    break
                except subprocess.TimeoutExpired:
                    process.send_signal(signal.SIGKILL)
            kills += 1
            kept += checkpoint_path(target).exists()
        assert content(target) == whole
        assert not checkpoint_path(target).exists()
    assert kept > 1


# A child's `ru_maxrss` starts at what its parent held when it was started; VmHWM is its own.
_PEAK = """
import sys
from pathlib import Path
from types import SimpleNamespace
from gyrotrack.apps.cli._app import run
assert run(["extract", sys.argv[1], "-o", sys.argv[2], "-q", "--force"]) == 0
lines = Path("/proc/self/status").read_text().splitlines()
print(next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="counts memory as Linux does")
def test_memory_is_the_same_for_ten_times_as_many_frames(long_film, tmp_path):
    peak = {}
    for rounds in (3, 30):  # 780 and 7,800 frames
        words = [sys.executable, "-c", _PEAK, str(long_film(rounds)), str(tmp_path / "o.h5")]
        peak[rounds] = float(subprocess.run(words, check=True, capture_output=True).stdout.split()[-1])
    assert peak[30] < 300
    assert peak[30] - peak[3] < 25  # MB


_FACTS = {"part": 1, "parts": 2, "frames": 2, "bad_packets": 0, "corrupt": 0}
_ARRAYS = {"stamps": np.array([9, 10, 11]), "casing/coarse": np.zeros(3), "disc": np.zeros((3, 2))}
_COLUMNS = {"stamps": ((), "<i8"), "casing/coarse": ((), "<f8"), "disc": ((2,), "<f8")}


@pytest.mark.parametrize(
    ("facts", "arrays"),
    [
        ({"part": 2}, {}),
        ({"part": -1}, {}),
        ({"part": "1"}, {}),
        ({"part": None}, {}),
        ({"parts": 3}, {}),
        ({"frames": 3}, {}),
        ({"frames": 1e300}, {}),
        ({"bad_packets": []}, {}),
        ({"corrupt": -1}, {}),
        ({}, {"stamps": np.array([9, 10, 12])}),
        ({}, {"stamps": np.array([9.0, 10.0, 11.0])}),
        ({}, {"stamps": np.array(9)}),
        ({}, {"casing/coarse": np.zeros(2)}),
        ({}, {"casing/coarse": np.zeros(())}),
        ({}, {"casing/coarse": np.zeros(3, dtype=np.int64)}),
        ({}, {"disc": np.zeros((3, 3))}),
        ({}, {"more": np.zeros(3)}),
    ],
)
def test_a_record_of_another_form_is_not_taken_for_a_part(tmp_path, facts, arrays):
    parts = [SimpleNamespace(stop=10), SimpleNamespace(stop=None)]
    packets = SimpleNamespace(stamps=np.arange(12), complete=True)
    with CheckpointFile(tmp_path / "o.h5", {}) as journal:
        journal.append(_FACTS, _ARRAYS)
        assert frames_done(journal) == 2
        assert _film_parts._PartResults(parts, packets, journal, _COLUMNS).todo == [0]
        journal.append(_FACTS | facts, _ARRAYS | arrays)
        frames_done(journal)
        assert _film_parts._PartResults(parts, packets, journal, _COLUMNS).todo == [0, 1]
        assert len(journal) == 0
