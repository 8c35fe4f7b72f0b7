"""Projects of OSP Tracker: what is written is read as the same motion; times on no grid are refused."""

import io

import numpy as np
import pytest

from gyrotrack import UsageError
from gyrotrack.io._tracker_project import write_project
from gyrotrack.io.readers._motion_table import ReadOptions
from gyrotrack.io.readers._registry import read_motion

TIME = 3.5 + np.arange(400) / 120


def written(path, time, *, zipped):
    angle = 9 * time - 0.4 * time**2
    with path.open("wb") as stream:
        write_project(stream, [("wheel <1>", time, angle), ("other", time, -angle)], zipped=zipped)
    return angle


@pytest.mark.parametrize("suffix", [".trk", ".trz"])
@pytest.mark.parametrize("rows", [slice(None), np.r_[0:100, 120:400]])
def test_a_project_is_read_as_the_motion_that_was_written(tmp_path, suffix, rows):
    path, time = tmp_path / f"a{suffix}", TIME[rows]
    angle = written(path, time, zipped=suffix == ".trz")
    read = read_motion(path, ReadOptions(marker="wheel <1>", centre="origin"))
    np.testing.assert_allclose(read.time, time, atol=1e-9)
    turned = np.unwrap(read.value)
    np.testing.assert_allclose(turned - turned[0], angle - angle[0], atol=1e-9)


@pytest.mark.parametrize(("jitter", "refused"), [(0.02, False), (0.2, True)])
def test_times_on_no_grid_are_refused(tmp_path, jitter, refused):
    """In intervals; up to a twentieth is the rounding of a clock."""
    time = TIME + np.random.default_rng(0).uniform(-jitter, jitter, len(TIME)) / 120
    if refused:
        with pytest.raises(UsageError, match="needs times at equal intervals"):
            written(tmp_path / "a.trk", time, zipped=False)
    else:
        written(tmp_path / "a.trk", time, zipped=False)
        read = read_motion(tmp_path / "a.trk", ReadOptions(marker="wheel <1>", centre="origin"))
        assert np.abs(read.time - time).max() < 0.05 / 120


def test_the_same_content_makes_the_same_file():
    made = []
    for _ in range(2):
        stream = io.BytesIO()
        write_project(stream, [("a", TIME, TIME)], zipped=True)
        made.append(stream.getvalue())
    assert made[0] == made[1]
