"""The public names, one by one: adding or removing one is a decision, not an accident."""

import subprocess
import sys

import numpy as np
import pytest

import gyrotrack
from gyrotrack import UsageError, VideoError
from gyrotrack.apps.cli._app import run

NAMES = set(
    """
BodyTrack Case ChainBody ConfigurationError DatasetError ErrorMode FitRequest Ghost GyrotrackError MarkerTrack
OutputError Profile ProfileError Proposal Recording Series SimulatedRun Study SyncError TrackingError UsageError
VideoError export_file extract ghosts import_body import_case import_chain open_study propose read read_case
read_recording sync write_case write_recording write_report
""".split()  # noqa: SIM905
)


def test_the_names():
    assert set(gyrotrack.__all__) == NAMES
    assert gyrotrack.__all__ == sorted(gyrotrack.__all__)
    assert len(gyrotrack.__all__) <= 40
    for name in gyrotrack.__all__:
        assert getattr(gyrotrack, name).__doc__, name
    with pytest.raises(AttributeError, match="nothing"):
        gyrotrack.nothing  # noqa: B018
    code = "import sys, gyrotrack; print({'numpy', 'cv2', 'h5py', 'typer'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_the_hint_is_in_the_text_of_an_error():
    error = VideoError("The film is empty.", "Copy it again.")
    assert str(error) == "The film is empty. Copy it again."
    assert (error.message, error.hint, str(VideoError("Empty."))) == (
        "The film is empty.",
        "Copy it again.",
        "Empty.",
    )


def test_from_film_to_recording_and_back(casing_clip, tmp_path):
    film, output = casing_clip[0], tmp_path / "casing.h5"
    seen = []
    made = gyrotrack.extract(film, output, capture_fps=260, progress=lambda done, total: seen.append(done))
    assert seen
    again = gyrotrack.read(output)
    np.testing.assert_array_equal(made.bodies["casing"].angle, again.bodies["casing"].angle)
    assert len(gyrotrack.extract(film, output, capture_fps=260, resume=True).time) == len(made.time)
    with pytest.raises(gyrotrack.OutputError, match="--force"):
        gyrotrack.extract(film, output, capture_fps=260)
    with pytest.raises(UsageError, match="not possible for the rotor"):
        gyrotrack.sync(made, [made], inertia_rotor=0.0, inertia_casing=1e-5)
    with pytest.raises(TypeError, match="inertia_rotor"):
        gyrotrack.sync(made, [made])


def test_a_case_is_read(tmp_path):
    assert run(["simulate", "-o", str(tmp_path / "c.h5"), "--duration", "12", "--window-length", "1"]) == 0
    case = gyrotrack.read(tmp_path / "c.h5")
    assert isinstance(case, gyrotrack.Case)
    assert case.I_rotor == 5.54e-5
