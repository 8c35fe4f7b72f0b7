"""A run that was stopped anywhere goes on and ends with the same numbers; memory does not grow with the film."""

import signal
import subprocess
import sys
from pathlib import Path

import av
import h5py
import numpy as np
import pytest

from gyrotrack.apps.cli._app import run
from gyrotrack.io._checkpoint import CheckpointFile, checkpoint_path
from gyrotrack.tracking._extract import extract, run_facts
from gyrotrack.tracking._film_tracker import frames_done
from gyrotrack.tracking._profile import PAPER


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
def every_batch(monkeypatch):
    monkeypatch.setattr("gyrotrack.tracking._film_tracker.BATCHES", 1)
    monkeypatch.setattr("gyrotrack.tracking._film_tracker.BATCH", 128)


@pytest.mark.slow
@pytest.mark.parametrize(("clip", "at"), [("casing_clip", 128), ("rotor_clip", 256)])
def test_a_stopped_run_ends_with_the_same_numbers(every_batch, clip, at, request, tmp_path):
    film, _ = request.getfixturevalue(clip)
    whole = extract(film)
    facts = run_facts(film, PAPER, None)
    with pytest.raises(KeyboardInterrupt), CheckpointFile(tmp_path / "o.h5", facts) as journal:
        extract(film, progress=stopping(at), journal=journal)
    with CheckpointFile(tmp_path / "o.h5", facts, resume=True) as journal:
        assert frames_done(journal) == at
        done = []
        again = extract(film, progress=lambda n, _: done.append(n), journal=journal)
    assert done[0] == at  # what was done is not done again
    for name, body in whole.bodies.items():
        for column in ("time", "angle", "sigma", "omega", "n_markers"):
            np.testing.assert_array_equal(getattr(again.bodies[name], column), getattr(body, column))
    for name, marker in whole.markers.items():
        np.testing.assert_array_equal(again.markers[name].corner, marker.corner)
        np.testing.assert_array_equal(again.markers[name].status, marker.status)
    np.testing.assert_array_equal(again.pts_time, whole.pts_time)
    assert again.warnings == whole.warnings


@pytest.mark.slow
def test_the_command_goes_on_and_knows_when_it_is_done(every_batch, casing_clip, tmp_path, capsys):
    film, target = str(casing_clip[0]), tmp_path / "o.h5"
    assert run(["extract", film, "-o", str(target), "-q"]) == 0
    whole = content(target)
    target.unlink()
    facts = run_facts(casing_clip[0], PAPER, None)
    with pytest.raises(KeyboardInterrupt), CheckpointFile(target, facts) as journal:
        extract(casing_clip[0], progress=stopping(128), journal=journal)
    assert checkpoint_path(target).exists()
    capsys.readouterr()
    assert run(["extract", film, "-o", str(target), "--resume"]) == 0
    assert "after frame 127" in capsys.readouterr().err
    assert content(target) == whole
    assert [path.name for path in tmp_path.iterdir()] == ["o.h5"]
    assert run(["extract", film, "-o", str(target), "--resume"]) == 0
    assert "complete already" in capsys.readouterr().err
    assert run(["extract", film, "-o", str(target), "--resume", "--body", "casing"]) == 1  # not the same run
    assert "--force" in capsys.readouterr().err
    assert content(target) == whole


@pytest.mark.slow
def test_a_journal_that_does_not_fit_the_film_is_started_anew(every_batch, casing_clip, rotor_clip, tmp_path):
    output = tmp_path / "o.h5"
    with pytest.raises(KeyboardInterrupt), CheckpointFile(output, {"film": "x"}) as journal:
        extract(casing_clip[0], progress=stopping(128), journal=journal)
    with CheckpointFile(
        output, {"film": "x"}, resume=True
    ) as journal:  # as if the film had been changed behind our back
        again = extract(rotor_clip[0], journal=journal)
    np.testing.assert_array_equal(again.bodies["rotor"].angle, extract(rotor_clip[0]).bodies["rotor"].angle)


def test_an_interrupted_command_says_how_to_go_on(every_batch, casing_clip, tmp_path, capsys, monkeypatch):
    whole = extract

    def interrupted(*words, **settings):
        return whole(*words, **{**settings, "progress": stopping(256)})

    monkeypatch.setattr("gyrotrack.tracking._extract.extract", interrupted)
    assert run(["extract", str(casing_clip[0]), "-o", str(tmp_path / "o.h5")]) == 130
    assert "256 frames are kept; the same command with --resume" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["o.h5.unfinished"]


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


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL")
def test_killed_at_random_moments_it_ends_with_the_same_numbers(long_film, tmp_path):
    film, target = long_film(8), tmp_path / "o.h5"
    words = [sys.executable, "-m", "gyrotrack", "extract", str(film), "-o", str(target), "-q"]
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    whole = content(target)
    rng = np.random.default_rng(0)
    kills = kept = 0
    while kills < 12:
        target.unlink()
        while True:
            with subprocess.Popen([*words, "--resume"], stdout=subprocess.DEVNULL) as process:
                try:
                    assert process.wait(rng.uniform(0.3, 5.0)) == 0
                    break
                except subprocess.TimeoutExpired:
                    process.send_signal(signal.SIGKILL)
            kills += 1
            kept += checkpoint_path(target).exists()
        assert content(target) == whole
        assert not checkpoint_path(target).exists()
    assert kept > 2


# A child's `ru_maxrss` starts at what its parent held when it was started; VmHWM is its own.
_PEAK = """
import sys
from pathlib import Path
from gyrotrack.apps.cli._app import run
assert run(["extract", sys.argv[1], "-o", sys.argv[2], "-q", "--force"]) == 0
lines = Path("/proc/self/status").read_text().splitlines()
print(next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="counts memory as Linux does")
def test_memory_is_the_same_for_ten_times_as_many_frames(long_film, tmp_path):
    peak = {}
    for rounds in (8, 80):  # 2,080 and 20,800 frames
        words = [sys.executable, "-c", _PEAK, str(long_film(rounds)), str(tmp_path / "o.h5")]
        peak[rounds] = float(subprocess.run(words, check=True, capture_output=True).stdout.split()[-1])
    assert peak[80] < 300
    assert peak[80] - peak[8] < 25  # MB
