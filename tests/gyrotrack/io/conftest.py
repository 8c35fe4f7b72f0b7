from dataclasses import replace

import numpy as np
import pytest

from gyrotrack import BodyTrack, Case, ErrorMode, MarkerTrack, Recording, Series, write_case
from gyrotrack.io._records import GeneratedCurve, Placement


def make_recording(frames=300, seed=0):
    rng = np.random.default_rng(seed)
    time = np.arange(frames) / 1000

    def noise(*shape):
        return rng.normal(size=(frames, *shape))

    def marker(name, body):
        angle = noise()
        angle[5] = np.nan
        status = np.zeros(frames, dtype=np.int8)
        status[5] = 2
        sigma = 1e-3 + np.abs(noise())
        return MarkerTrack(
            name, body, 0.5, noise(2, 2), noise(), noise(), noise(), angle, sigma, noise(), noise(), noise(),
            status, noise(), sigma,
        )  # fmt: skip

    def body(name):
        seen = np.arange(frames) != 5
        sigma = np.full(seen.sum(), 1e-3)
        angle = 30 * time[seen]
        omega = np.full(seen.sum(), 30.0)
        omega[:50] = np.nan
        return BodyTrack(
            name, time[seen], angle, sigma, 2 * sigma, np.ones(seen.sum(), dtype=np.int64), omega, sigma, 51
        )

    return Recording(
        source="clip one.mp4",
        source_sha256="ab" * 32,
        width=640,
        height=480,
        capture_fps=1000.0,
        container_fps=25.0,
        frames_declared=frames + 1,
        frames_decoded=frames,
        sense=-1,
        body="both",
        frame_index=np.arange(frames),
        time=time,
        pts_time=40 * time,
        centre=noise(2),
        centre_sigma=np.full(frames, 0.1),
        markers={"red": marker("red", "casing"), "blue": marker("blue", "rotor")},
        bodies={"casing": body("casing"), "rotor": body("rotor")},
        warnings=("one frame is missing",),
        extra={"profile": {"hue": [1, 2]}},
    )


@pytest.fixture
def recording():
    return make_recording()


def make_case(recording):
    time = np.arange(400) / 260
    angle = 20 * time
    sigma = np.full(400, 1e-3)
    series = Series(time, angle, sigma, np.full(400, 20.0), sigma, (angle // (2 * np.pi)).astype(np.int64))
    rotor = Series(
        time,
        40 * angle,
        sigma,
        series.omega,
        sigma,
        series.turn,
        window=np.repeat([0, 1], 200),
        sigma_source="given",
    )
    return Case(
        I_rotor=5.54e-5,
        I_casing=2.06e-5,
        label="case 1",
        surface="PVC",
        casing=series,
        rotor=rotor,
        recordings={"rotor_0": recording},
        placements={
            "rotor_0": Placement("rotor_0", 3.5, 1e-5, 1.00002, 1e-6, 0.7, ambiguous=True, method="casing")
        },
        rotor_generated=GeneratedCurve(time, series.omega, "a curve"),
        warnings=("careful",),
        extra={"sense": -1},
    )


@pytest.fixture
def case(recording):
    return make_case(recording)


@pytest.fixture(scope="session")
def case_file(tmp_path_factory):
    """The case as a file, written once."""
    path = tmp_path_factory.mktemp("case") / "case.h5"
    return write_case(path, make_case(make_recording()), command="", settings={})


@pytest.fixture(scope="session")
def case_file_with_mode(tmp_path_factory):
    """The case with an error mode of the casing as a file, written once."""
    case = make_case(make_recording())
    basis = np.stack([np.cos(case.casing.time), np.sin(case.casing.time)], axis=1)
    tilt = ErrorMode("tilt", basis, np.diag([4e-6, 9e-6]))
    path = tmp_path_factory.mktemp("tilt") / "case.h5"
    case = replace(case, casing=replace(case.casing, modes=(tilt,)))
    return write_case(path, case, command="", settings={})
