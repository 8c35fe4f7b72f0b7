"""Single samples that no smooth motion contains, against steps, kinks and noise."""

from pathlib import Path

import numpy as np
import pytest

from gyrotrack import ErrorMode, import_body
from gyrotrack.io.readers._motion_table import Driver, MotionTable
from gyrotrack.io.readers._outliers import outliers, without_outliers
from gyrotrack.io.readers._run import Limits

N, SIGMA = 400, 1e-3
T = np.arange(N) / 50
# the error of a prediction by 3 a - 3 b + c, beside that of the sample itself: sqrt(1 + 19)
ERROR = SIGMA * np.sqrt(20)


def found(value, sigma=SIGMA, time=T):
    return outliers(time, value, np.full(len(value), sigma)).tolist()


def motion():
    return 20 * T - 0.4 * T**2


@pytest.mark.parametrize(("size", "seen"), [(9.9, False), (10.1, True), (-10.1, True), (300.0, True)])
def test_an_outlier_deviates_by_ten_standard_errors(size, seen):
    value = motion()
    value[100] += size * ERROR
    assert found(value) == ([100] if seen else [])


@pytest.mark.parametrize(("step", "seen"), [(0.49, True), (0.51, False)])
def test_both_deviations_are_alike(step, seen):
    """A step of the motion beside the outlier: the two deviations are 1 and 1 + step."""
    value = motion()
    value[100] += 30 * ERROR
    value[:100] -= step * 30 * ERROR
    assert found(value) == ([100] if seen else [])


def test_steps_kinks_and_oscillations_are_motion():
    step, kink = motion(), motion()
    step[200:] += 1.0
    kink[200:] += 5.0 * (T[200:] - T[200])
    assert found(step) == found(kink) == []
    assert found(np.cos(2 * np.pi * T * 3.0)) == []  # 17 samples a period


def test_noise_has_no_outliers():
    value = np.random.default_rng(0).normal(0, SIGMA, 200_000)
    assert found(value, time=np.arange(len(value)) / 50) == []


def test_uneven_times_are_extrapolated():
    time = np.cumsum(np.random.default_rng(1).uniform(0.01, 0.03, N))
    value = 20 * time - 0.4 * time**2
    assert found(value, time=time) == []
    value[300] += 1.0
    assert found(value, time=time) == [300]


def written(path, spoiled, head="t,theta"):
    value = motion() + np.random.default_rng(3).normal(0, SIGMA, N)
    value[spoiled] += 1.0
    path.write_text(head + "\n" + "".join(f"{a},{b}\n" for a, b in zip(T, value, strict=True)))
    return path


@pytest.mark.parametrize(("count", "excluded"), [(8, True), (9, False)])
def test_two_in_a_hundred_samples_are_outliers_and_more_are_noise(tmp_path, count, excluded):
    path = written(tmp_path / "a.csv", 20 + 40 * np.arange(count))
    case = import_body(path, 1.0)
    said = [w for w in case.warnings if "outlier" in w]
    assert bool(said) == excluded
    assert len(case.casing.time) == N - count * excluded
    if excluded:
        assert said[0].startswith("a.csv: 8 outliers (first: line 22) far from")
        assert np.median(case.casing.sigma) == pytest.approx(SIGMA, rel=0.15)
    assert len(import_body(path, 1.0, limits=Limits(keep_all=True)).casing.time) == N


@pytest.mark.parametrize(
    ("changes", "excluded"),
    [({}, True), ({"counted": True}, False), ({"least_sigma": 0.025}, False), ({"least_sigma": 0.02}, True)],
)
def test_counts_and_steps_of_the_resolution_are_kept(changes, excluded):
    """Ten standard errors are 10 sqrt(20) u = 1 for u = 0.0224."""
    value = motion()
    value[100] += 1.0
    table = MotionTable(Path("a.csv"), "", "angle", T, value, np.full(N, SIGMA), np.arange(N), (), **changes)
    notes = []
    _, kept = without_outliers(table, value, notes)
    assert (len(kept) < N) == bool(notes) == excluded


@pytest.mark.parametrize("chosen", [np.array([3, 0]), np.arange(5) % 2 == 0])
def test_everything_that_belongs_to_a_sample_is_selected_with_it(chosen):
    row = np.arange(5.0)
    mode = ErrorMode("tilt", np.stack([row, -row], axis=1), np.eye(2), "", "tilt", "tilt of the axis")
    table = MotionTable(
        Path("a.csv"), "", "angle", row, 10 * row, 0.1 * row, np.arange(5) + 2, ("first",),
        drivers=(Driver("u", "V", 3 * row),), modes=(mode,),
    )  # fmt: skip
    found = table.only(chosen, "second")
    kept = row[chosen]
    assert found.time.tolist() == kept.tolist()
    assert found.value.tolist() == (10 * kept).tolist()
    assert found.sigma.tolist() == (0.1 * kept).tolist()
    assert found.line.tolist() == (kept + 2).tolist()
    assert found.drivers[0].value.tolist() == (3 * kept).tolist()
    assert found.modes[0].basis.tolist() == np.stack([kept, -kept], axis=1).tolist()
    assert found.notes == ("first", "second")
