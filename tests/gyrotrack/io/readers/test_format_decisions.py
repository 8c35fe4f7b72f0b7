"""Which format and which columns of a file are read, and what is implausible: contents on both sides of each rule."""

from pathlib import Path

import numpy as np
import pytest

from gyrotrack import DatasetError
from gyrotrack.io.readers._plausibility import (
    are_intervals,
    counts_rows,
    doubt_of_rad,
    may_be_intervals,
    ratio_of_units,
    row_numbers,
    wrapping_unit,
)
from gyrotrack.io.readers._raw_table import table_of
from gyrotrack.io.readers._registry import FORMATS, names, read_motion

PATH = Path("a.csv")


@pytest.mark.parametrize(
    ("content", "name"),
    [
        (b"\x89HDF\r\n", "HDF5"), (b"PK\x03\x04", "ARCHIVE"),
        (b"\xd0\xcf\x11\xe0..", "EXCEL_97"), (b"MATLAB 7.3 MAT", "MATLAB_7_3"),
        (b"MATLAB 5.0 MAT", "MATLAB"), (b"PAR1..", "PARQUET"), (b"RIFF....WAVE", "WAV"), (b"RIFF....AVI ", "TEXT"),
        (b"XXXX....WAVE", "TEXT"),
        (b' \r\n{"t": 1}', "JSON"), (b"\xef\xbb\xbf[1]", "JSON"), (b"t,angle", "TEXT"), (b"", "TEXT"),
        (b" <a>" + b" " * 4970 + b"cabrillo.tracker", "TRACKER"), (b"<a>" + b" " * 5000 + b"cabrillo.tracker", "TEXT"),
        (b"a<cabrillo.tracker", "TEXT"),
    ],
)  # fmt: skip
def test_formats_are_recognised_by_their_content(content, name):
    found = next(f for f in FORMATS if f.matches(content))
    assert found.name == getattr(names, name)


def written(tmp_path, text):
    path = tmp_path / "a.csv"
    path.write_text(text)
    return path


def test_columns_of_a_table_are_read(tmp_path):
    rows = "".join(f"{0.01 * k:.2f},{0.05 * k:.4f}\n" for k in range(200))
    found = read_motion(written(tmp_path, "t [s],angle [rad]\n" + rows))
    np.testing.assert_allclose(found.value, 0.05 * np.arange(200))
    assert found.quantity == "angle"
    assert found.reading.format
    with pytest.raises(DatasetError, match="is empty"):
        read_motion(written(tmp_path, "\n\n"))
    turns = "t [s],revolutions\n" + "".join(f"{0.01 * k * k + k:.4f},{k}\n" for k in range(60))
    counter = read_motion(written(tmp_path, turns))
    assert counter.counted
    np.testing.assert_allclose(np.diff(counter.value), 2 * np.pi)


def test_numbers_of_rows():
    assert counts_rows(np.arange(8.0) + 5)
    assert not counts_rows(np.arange(7.0))
    assert not counts_rows(np.arange(8.0) + 0.5)
    assert not counts_rows(2 * np.arange(8.0))
    raw = table_of(PATH, ["a", "b", "c"], [np.arange(9), np.arange(9) / 2, np.arange(9) + 3])
    assert row_numbers(raw) == [0, 2]


def test_columns_of_intervals():
    values = np.ones(101)
    values[::2] += 0.1
    values[3::2] = np.arange(49) + 2.0
    for backward, expected in ((5, False), (6, True)):  # of 100 steps
        values = np.arange(101.0) + 10
        values[10 : 10 + 8 * backward : 8] -= 1.5
        assert are_intervals(values) is expected
    falling = np.linspace(2, 1, 8)
    assert are_intervals(falling)
    assert not are_intervals(falling[:7])
    assert not are_intervals(falling - 1)
    slow = 1 / (1 - 0.5 * np.linspace(0, 1, 40))  # viscous friction: the step grows with the square
    assert may_be_intervals(slow)
    assert not may_be_intervals(slow[:15])
    assert not may_be_intervals(-slow)
    assert not may_be_intervals(slow[::-1])
    assert not may_be_intervals(np.exp(np.linspace(0, 1, 40)))  # an exponent of 1


@pytest.mark.parametrize(
    ("period", "unit"),
    [
        (2 * np.pi, "rad"),
        (360, "deg"),
        (1, "turns"),
        (400, "gon"),
        (2e3 * np.pi, "mrad"),
        (380, ""),
        (50, ""),
    ],
)
@pytest.mark.parametrize("sign", [1, -1])
def test_units_of_wrapping_angles(period, unit, sign):
    angle = (sign * 0.07 * period * np.arange(200)) % period
    assert wrapping_unit(angle) == unit
    assert wrapping_unit(angle - period / 2) == unit
    assert wrapping_unit(np.abs(angle - period / 2)) == ""
    assert wrapping_unit(angle[:7]) == ""


@pytest.mark.parametrize(("size", "doubt"), [(2 * np.pi * 0.48, ""), (2 * np.pi * 0.53, "oscillate")])
def test_oscillations_of_half_a_turn_are_not_in_rad(size, doubt):
    wave = size * np.sin(0.1 * np.arange(200))
    assert (doubt in doubt_of_rad(wave)) if doubt else doubt_of_rad(wave) == ""
    assert doubt_of_rad(wave[:60]) == ""  # two passages


def test_steps_of_half_a_turn_are_not_in_rad():
    for step, doubt in ((3.1, False), (3.2, True)):
        assert bool(doubt_of_rad(step * np.arange(20))) is doubt
        assert bool(doubt_of_rad(-step * np.arange(20))) is doubt
    assert doubt_of_rad(9.0 * np.arange(7)) == ""


@pytest.mark.parametrize(
    ("factor", "text"),
    [
        (1.0, False),
        (1.025, False),
        (1.035, False),
        (180 / np.pi, True),
        (1 / (2 * np.pi), True),
        (6.0, True),
        (1e-3, True),
    ],
)
def test_ratio_of_an_angle_and_its_speed(factor, text):
    time = 0.01 * np.arange(400)
    speed = 10 - time
    angle = 10 * time - 0.5 * time**2
    ratio, words = ratio_of_units(time, factor * angle, speed)
    assert ratio == pytest.approx(factor, rel=1e-3)
    assert bool(words) is text
    assert ratio_of_units(time, -factor * angle, speed)[0] == pytest.approx(-factor, rel=1e-3)
    for changed in (
        (time[:31], angle[:31], speed[:31]),
        (time[::-1], angle, speed),
        (time, angle, 0 * speed),
        (time, 0 * angle, speed),
    ):
        assert np.isnan(ratio_of_units(*changed)[0])
    assert np.isfinite(ratio_of_units(time[:32], angle[:32], speed[:32])[0])
