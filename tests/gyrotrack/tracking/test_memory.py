"""Memory does not grow with the length of a film: what grows lies in files, and is worked on in stretches."""

import importlib.util
import subprocess
import sys
import tracemalloc
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import _column_store as columns
from gyrotrack.tracking import _extract
from gyrotrack.tracking import _film as film
from gyrotrack.tracking._body_angles import join_bodies
from gyrotrack.tracking._profile import PAPER

_spec = importlib.util.spec_from_file_location("measured", Path(__file__).with_name("measured.py"))
measured = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(measured)


def recording(seen, scene):
    """Return what the dataset keeps of these measurements."""
    joint = join_bodies(seen, scene, PAPER, measured.FPS)
    info = SimpleNamespace(
        path=Path("film.mp4"), container_fps=measured.FPS, frames_declared=len(seen.times.number)
    )
    rate = SimpleNamespace(fps=measured.FPS, source="", warnings=())
    return _extract._recording(info, "", rate, scene, seen, joint)


def peak(frames):
    """Return the most memory in bytes that all takes which comes after the pass through a film."""
    seen, scene = measured.watched(frames), measured.scene()
    tracemalloc.start(1)
    try:
        found = recording(seen, scene)
        assert set(found.bodies) == {"casing", "rotor"}
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="long columns are kept in mapped files on Linux")
def test_a_longer_film_takes_hardly_more_memory():
    recording(measured.watched(1000), measured.scene())  # imports what is imported late
    short, long = (peak(n) for n in (6000, 24_000))
    assert (long - short) / 18_000 < 240.0  # bytes a frame: some dozen numbers, not hundreds


@pytest.mark.slow
def test_columns_in_files_give_what_columns_in_memory_give(monkeypatch):
    found = []
    for least in (0, 1 << 40):
        monkeypatch.setattr(columns, "LEAST_BYTES", least)
        found.append(recording(measured.watched(3000), measured.scene()))
    for name, body in found[0].bodies.items():
        assert np.array_equal(body.angle, found[1].bodies[name].angle)
        assert np.array_equal(body.sigma, found[1].bodies[name].sigma)
        assert np.array_equal(body.omega, found[1].bodies[name].omega, equal_nan=True)
    for name, marker in found[0].markers.items():
        assert np.array_equal(marker.corner, found[1].markers[name].corner, equal_nan=True)
        assert np.array_equal(marker.sigma, found[1].markers[name].sigma, equal_nan=True)


_WRITE = """
import sys
from pathlib import Path
import numpy as np
from gyrotrack.io._hdf5 import new_hdf5

def most():
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024

values = np.random.default_rng(0).random(500_000)
with new_hdf5(Path(sys.argv[1]) / "warm.h5") as file:
    file["x"] = values[:1000]
before = most()
with new_hdf5(Path(sys.argv[1]) / "long.h5") as file:
    for k in range(10):
        file.create_dataset(f"x{k}", data=values, chunks=(8192,), compression="gzip", fletcher32=True)
print(most() - before)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_large_file_is_not_held_in_memory(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", _WRITE, str(tmp_path)], capture_output=True, text=True, check=True
    )
    assert (tmp_path / "long.h5").stat().st_size > 35e6
    assert float(done.stdout) < 12.0  # MB


def test_stored_pictures_are_those_that_were_given():
    rng = np.random.default_rng(1)
    given = rng.integers(0, 255, (90, 400, 600), dtype=np.uint8)  # 21.6 MB: pages are released between
    stored = columns.StoredPictures.of(100, iter(given))
    assert len(stored) == len(given)
    assert all(np.array_equal(a, b) for a, b in zip(stored, given, strict=True))
    assert np.array_equal(stored[10::7][3], given[31])
    assert np.array_equal(stored.at([80, 3])[1], given[3])
    assert np.array_equal(stored[-1], given[-1])
    assert len(columns.StoredPictures.of(5, iter(()))) == 0


def test_frames_of_a_film_that_is_not_kept_are_decoded_again(monkeypatch):
    clip = Path(__file__).parents[3] / "sample_clips" / "rotor_1.mp4"
    kept = film.Film(clip, most=40)
    monkeypatch.setattr(film, "_HELD", 10**6)
    passing = film.Film(clip, most=40)
    assert len(kept) == len(passing) == 40
    for a, b in zip(kept.frames(3, 9), passing.frames(3, 9), strict=True):
        assert np.array_equal(a, b)
    for a, b in zip(kept.some([2, 30]), passing.some([2, 30]), strict=True):
        assert np.array_equal(a, b)
