"""Tables as they come, and each bad one refused by file and line."""

import re
from pathlib import Path

import numpy as np
import pytest

from gyrotrack import DatasetError
from gyrotrack.io.readers import _text_table
from gyrotrack.io.readers._motion_table import (
    MotionTable,
    ReadOptions,
    in_order,
    is_wrapped,
    pieces,
    read_names,
    without_spikes,
)
from gyrotrack.io.readers._registry import read_motion
from gyrotrack.io.readers._text_table import content_lines, read_text

ROWS = [(0.1 * k, 1.5 * k, 0.01) for k in range(12)]


def table(tmp_path, text, encoding="utf-8"):
    path = tmp_path / "t.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
    return path


def text(header="t,angle,sigma", separator=",", rows=ROWS, decimal="."):
    width = re.sub('"[^"]*"', "", header).count(separator) + 1
    lines = [separator.join(f"{x:.6g}".replace(".", decimal) for x in row[:width]) for row in rows]
    return "\n".join([header, *lines]) + "\n"


@pytest.mark.parametrize(
    "content",
    [
        text(),
        text().replace("\n", "\r\n"),
        "\ufeff" + text(),
        "# a comment\n\n" + text(),
        text().replace("\n0.5", "\n# another\n\n0.5"),
        text("t ; angle ; sigma", " ; ", decimal=","),
        text("Time\tPsi\tError", "\t", decimal=","),
        text("t angle sigma", " "),
        text('"t [s]","angle [rad]","sigma [rad]"'),
        text('"t","bar, angle (rad)","sigma"'),
        text("t (s),angle (rad),angle_err"),
        text("t / s,angle / rad,sigma"),
        "t,angle,sigma,remark\n" + "".join(f"{t},{a},{s},good\n" for t, a, s in ROWS),
    ],
)
def test_forms_that_are_understood(tmp_path, content):
    read = read_motion(table(tmp_path, content))
    assert read.quantity == "angle"
    np.testing.assert_allclose(read.time, [row[0] for row in ROWS], rtol=1e-6)
    np.testing.assert_allclose(read.value, [row[1] for row in ROWS], rtol=1e-5)
    np.testing.assert_allclose(read.sigma, 0.01)


def test_other_encodings(tmp_path):
    assert len(read_motion(table(tmp_path, text(), "utf-16")).time) == 12
    assert len(read_motion(table(tmp_path, "# Drehwinkel für Fall 1\n" + text(), "latin-1")).time) == 12


@pytest.mark.parametrize(
    ("header", "factor"),
    [
        ("t [ms],angle", (1e-3, 1)),
        ("t,angle [deg]", (1, np.pi / 180)),
        ("t,omega [rpm]", (1, np.pi / 30)),
        ("t,ω [rad/s]", (1, 1)),
    ],
)
def test_units_in_the_header_are_obeyed(tmp_path, header, factor):
    read = read_motion(table(tmp_path, text(header)))
    np.testing.assert_allclose(read.time[3], 0.3 * factor[0], rtol=1e-6)
    np.testing.assert_allclose(read.value[3], 4.5 * factor[1], rtol=1e-6)


@pytest.mark.parametrize(
    ("header", "column", "unit"),
    [
        ("Time,Wheel Speed", "omega=Wheel Speed [rpm]", np.pi / 30),
        ("Time,Winkel", "angle=Winkel [deg]", np.pi / 180),
    ],
)
def test_a_unit_that_is_not_stated_must_be_stated(tmp_path, header, column, unit):
    path = table(tmp_path, text(header))
    with pytest.raises(DatasetError, match="is not stated") as caught:
        read_motion(path)
    assert f"--column '{column}'" in str(caught.value)
    read = read_motion(path, ReadOptions(names=read_names([column])))
    np.testing.assert_allclose(read.value[3], 4.5 * unit, rtol=1e-6)


@pytest.mark.parametrize("header", ["Time,Wheel Speed [rpm]", "time,theta", "t,omega"])
def test_a_stated_unit_or_a_symbol_is_enough(tmp_path, header):
    assert read_motion(table(tmp_path, text(header))).reading.taken[1].unit in {"rpm", "rad", "rad/s"}


@pytest.mark.parametrize(
    ("step", "match"), [(10, "the unit of 'Time' is not stated"), (1, "'Time' numbers the rows")]
)
def test_whole_times_without_a_unit_must_be_confirmed(tmp_path, step, match):
    rows = [(step * k, 1.5 * k) for k in range(12)]
    with pytest.raises(DatasetError, match=match):
        read_motion(table(tmp_path, text("Time,angle", rows=rows)))


def test_a_title_with_as_many_words_as_columns_is_not_a_header(tmp_path):
    samples = text("t angle sigma", " ").partition("\n")[2]
    with pytest.raises(DatasetError, match="the 3 columns have no header"):
        read_motion(table(tmp_path, "Schwingungsfrequenz ohne Kopplung\n\n" + samples))


def test_a_header_whose_names_are_numbers_by_half_is_a_header(tmp_path):
    read = read_motion(table(tmp_path, text("t,7")), ReadOptions(names=read_names(["t=t", "angle=7 [rad]"])))
    np.testing.assert_allclose(read.value, [row[1] for row in ROWS], rtol=1e-5)


def test_a_header_of_more_words_than_columns_is_refused_with_their_number(tmp_path):
    """Words with units in brackets are five, but without a name for each column every word counts."""
    samples = text("t angle sigma", " ").partition("\n")[2]
    with pytest.raises(DatasetError, match="line 2: 3 cells where the header has 7"):
        read_motion(table(tmp_path, "time of day [s] angle [rad] sigma\n" + samples))


def test_sigma_shares_the_unit_of_the_angle(tmp_path):
    read = read_motion(table(tmp_path, text("t,angle [deg],sigma")))
    np.testing.assert_allclose(read.sigma, 0.01 * np.pi / 180)


def test_rows_without_a_value_are_left_out_and_told(tmp_path):
    read = read_motion(table(tmp_path, text().replace(",4.5,", ",,").replace(",6,", ",NaN,")))
    assert len(read.time) == 10
    assert any("2 rows" in note for note in read.notes)


def test_a_column_that_is_ignored_is_reported(tmp_path):
    read = read_motion(table(tmp_path, "t,angle,omega\n" + "".join(f"{t},{a},7\n" for t, a, _ in ROWS)))
    assert read.quantity == "angle"
    assert read.reading.lines()[1].endswith("unused columns: 'omega'.")


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"", "is empty"),
        (b"\n\n# nothing\n", "is empty"),
        ("t,angle\n", "no rows"),
        (text(rows=ROWS[:5]), "5 samples"),
        (b"\x00\x01\x02\x03", "not a table"),
        ("0,1\n0.1,2\n", "line 1: the 2 columns have no header"),
        ("time\n0\n1\n", "line 1: there is no column for the angle or omega"),
        ("angle,sigma\n0,1\n", "line 1: there is no column for the time"),
        ("t,angle,psi\n0,1,1\n", "2 columns for 'angle'"),
        ("t,angle [furlong]\n0,1\n", "unknown unit 'furlong'"),
        (text().replace("0.3,4.5", "0.3,fast"), "line 5: 'fast' in the column 'angle' is not a number"),
        (text().replace("0.3,4.5", "0.3,4_5"), "line 5: '4_5'"),
        (text().replace("4.5,0.01", "4.5,-0.01"), "line 5: the sigma is not positive"),
        (text().replace("4.5,0.01", "4.5,0"), "line 5: the sigma is not positive"),
        (text().replace("4.5,0.01", "4.5,"), "line 5: the sigma is missing"),
        (text().replace("4.5,0.01", "4.5"), "line 5: 2 cells"),
        (text(decimal=","), "line 2: . cells where the header has 3"),
        (text().replace("0.3,4.5", "0.3,4.5,1"), "line 5: 4 cells"),
        ("# c\n" + text().replace("0.3,4.5", "x,4.5"), "line 6: 'x' in the column 't'"),
    ],
)
def test_bad_tables_are_refused_by_file_and_line(tmp_path, content, match):
    path = table(tmp_path, content)
    with pytest.raises(DatasetError, match=match) as caught:
        read_motion(path)
    assert str(path) in caught.value.message
    assert "\n" not in caught.value.message


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(DatasetError, match="does not exist"):
        read_motion(tmp_path / "no.csv")
    with pytest.raises(DatasetError, match="is a folder"):
        read_motion(tmp_path)


def excluded(value):
    notes = []
    cleared = without_spikes(np.asarray(value, dtype=float), "angle", notes)
    return np.flatnonzero(np.isnan(cleared)).tolist(), notes


def test_single_samples_far_from_both_neighbours_are_excluded():
    smooth = np.linspace(0, 300, 400) + np.random.default_rng(0).normal(0, 1e-2, 400)
    wrapped = np.mod(smooth, 2 * np.pi)
    for value in (smooth, wrapped, smooth[:30], np.round(smooth)):
        assert excluded(value) == ([], [])
        spoiled = value.copy()
        spoiled[17] = 1e9
        rows, (note,) = excluded(spoiled)
        assert rows == [17]
        assert "1 values of 'angle' far from both neighbours" in note


def test_motion_after_rest_and_rare_steps_of_the_resolution_are_not_outliers():
    rest_then_run = np.concatenate([np.zeros(900), 5.0 * np.arange(100)])
    toggles = np.zeros(2000)
    toggles[[100, 700, 701, 1500]] = 0.088
    assert excluded(rest_then_run) == ([], [])
    assert excluded(toggles) == ([], [])


def test_contradicting_units_constant_angles_and_two_angles_are_refused(tmp_path):
    rows = "".join(f"{0.1 * k:.1f},{k}\n" for k in range(12))
    for content, match in (
        ("t [ms],angle\ns,rad\n" + rows, "the unit of 't \\[ms\\]' is 's' in the next line"),
        ("t,angle\n" + "".join(f"{k / 2},2\n" for k in range(12)), "all 12 angles are 2 rad"),
        ("t,angle1,angle2\n" + "".join(f"{k},{k},{k}\n" for k in range(12)), "2 columns for 'angle'"),
    ):
        with pytest.raises(DatasetError, match=match):
            read_motion(table(tmp_path, content))


def test_a_unit_is_stated_behind_a_header_with_a_separate_unit(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("Time ( s ),Voltage ( V )\n" + "".join(f"{k / 10},{60 - k}\n" for k in range(50)))
    assert read_names(["omega=Voltage ( V ) [rpm]"])["voltage ( v )"] == ("omega", "rpm")
    table = read_motion(path, ReadOptions(names=read_names(["omega=Voltage ( V ) [rpm]"])))
    np.testing.assert_allclose(table.value[0], 2 * np.pi)
    assert table.quantity == "omega"


@pytest.mark.parametrize(
    ("given", "read"),
    [
        ("angle=phi [deg]", {"phi [deg]": ("angle", ""), "phi": ("angle", "deg")}),
        ("t=1 (us)", {"1 (us)": ("t", ""), "1": ("t", "us")}),
        ("angle=phi", {"phi": ("angle", "")}),
        ("omega=w [ rad/s ]", {"w [ rad/s ]": ("omega", ""), "w": ("omega", "rad/s")}),
    ],
)
def test_names_and_units_of_columns(given, read):
    assert read_names([given]) == read


def test_samples_of_one_time_are_averaged_with_the_uncertainty_of_their_mean():
    time, row = np.arange(12.0), np.arange(12)
    time[5] = 4.0
    sigma = np.where(row == 5, 0.4, 0.3)
    notes = []
    given = MotionTable(Path("a.csv"), "", "omega", time, 10.0 * row, sigma, row + 2, ())
    found = in_order(given, notes)
    assert found.time.tolist() == [*range(5), *range(6, 12)]
    assert found.value[3:6].tolist() == [30.0, 45.0, 60.0]
    assert found.sigma[3:6] == pytest.approx([0.3, 0.25, 0.3])
    assert found.line.tolist() == [*range(2, 7), *range(8, 14)]
    assert notes == ["a.csv: 1 repeated times (first: line 7); their values were averaged"]


@pytest.mark.parametrize(
    ("share", "step", "wrapped"),
    [(1.04, 1.04, True), (1.06, 1.06, False), (0.9, 0.51, True), (0.9, 0.49, False)],
)
def test_wrapped_angles_are_within_a_turn_and_have_a_step_of_more_than_half(share, step, wrapped):
    assert is_wrapped(2 * np.pi * np.array([0.0, step, share])) == wrapped


def test_a_usual_interval_among_short_ones_is_not_a_gap():
    """The interval is compared with the median of the eleven around it."""
    steps = [1.0] * 20 + [0.04, 0.04, 1.0, 0.04, 0.04] + [1.0] * 20
    assert pieces(np.cumsum(steps)) == [slice(0, 45)]


@pytest.mark.parametrize(
    ("cells", "units"),
    [
        (["s", "deg", "front", "back"], True),
        (["s", "front", "back"], False),
        (["[s]", "", ""], True),
        ([""], False),
    ],
)
def test_a_line_of_units_has_units_in_half_of_its_cells(cells, units):
    assert _text_table._are_units(cells) is units


@pytest.mark.parametrize(
    ("above", "names", "line"),
    [(["time,angle", "t,phi"], ["t", "phi"], 2), (["t,phi", "front,back"], ["t", "phi"], 1)],
)
def test_the_header_is_the_last_line_of_the_most_known_names(above, names, line):
    assert _text_table._header(list(enumerate(above, start=1)), ",", 2) == (names, [], line)


PATH = Path("a.csv")


def read(text):
    content = text if isinstance(text, bytes) else text.encode()
    return read_text(PATH, *content_lines(PATH, content))


NUMBERS = "".join(f"{k},{10 * k}\n" for k in range(8))


def test_cells_of_text_are_limited(monkeypatch):
    monkeypatch.setattr(_text_table, "MAX_CELLS", 18)
    text = "t,angle\n" + NUMBERS
    read(text + "8,x\n")
    with pytest.raises(DatasetError, match="cells"):
        read(text + "8,x\n9,90\n")
    read(text + "8,80\n9,90\n")


def test_an_angular_acceleration_is_not_an_angle(tmp_path):
    rows = [(0.1 * k, 5.0, 0.5 * k, 0.025 * k**2) for k in range(12)]
    path = table(tmp_path, text("time_s,alpha_m_rad_s2,omega_m_rad_s,theta_m_rad", rows=rows))
    found = read_motion(path)
    assert found.quantity == "angle"
    assert np.ptp(found.value) == pytest.approx(0.025 * 11**2, rel=1e-4)
