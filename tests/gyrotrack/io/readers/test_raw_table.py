"""Headers, units, cells and lines of text tables; small files that expand to more than memory holds are refused."""

import io
import json
import math
import struct
import time
import tracemalloc
import wave
import zipfile
import zlib
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from gyrotrack import DatasetError
from gyrotrack.io.readers import _raw_table
from gyrotrack.io.readers._motion_table import ReadOptions
from gyrotrack.io.readers._raw_table import (
    RawTable,
    factor,
    header_of,
    is_acceleration,
    is_input,
    is_unit,
    number_of,
    refuse_long_names,
    refuse_size,
    role_of,
    table_of,
)
from gyrotrack.io.readers._registry import read_motion
from gyrotrack.io.readers._text_table import content_lines, delimiter_of, read_text, split

PATH = Path("a.csv")
TURN = 2 * math.pi


def read(text):
    content = text if isinstance(text, bytes) else text.encode()
    return read_text(PATH, *content_lines(PATH, content))


def values(raw):
    return [raw.numbers(i).tolist() for i in range(len(raw.columns))]


ROWS = "".join(f"{k},{10 * k}\n" for k in range(8))
ANGLES = [10.0 * k for k in range(8)]


@pytest.mark.parametrize(
    ("role", "unit", "expected"),
    [
        ("t", "s", 1), ("t", "ms", 1e-3), ("t", "us", 1e-6), ("t", "µs", 1e-6), ("t", "ns", 1e-9), ("t", "min", 60),
        ("t", "h", 3600), ("angle", "rad", 1), ("angle", "mrad", 1e-3), ("angle", "urad", 1e-6),
        ("angle", "deg", TURN / 360), ("angle", "Degrees", TURN / 360), ("angle", "gon", TURN / 400),
        ("angle", "turns", TURN), ("omega", "rad/s", 1), ("omega", "rad s^-1", 1), ("omega", "mrad/s", 1e-3),
        ("omega", "deg/s", TURN / 360), ("omega", "dps", TURN / 360), ("omega", "rpm", TURN / 60),
        ("omega", "RPM", TURN / 60), ("omega", "u/min", TURN / 60), ("omega", "rev/s", TURN), ("omega", "Hz", TURN),
        ("", "rpm", TURN / 60), ("angle", "grad", None), ("", "grad", None), ("", "furlong", None),
    ],
)  # fmt: skip
def test_factors_of_units(role, unit, expected):
    assert factor(role, unit) == (None if expected is None else pytest.approx(expected))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("t [s]", ("t", "s")), ("t (ms)", ("t", "ms")), ("t / s", ("t", "s")), ("t_ms", ("t", "ms")),
        ("angle_deg", ("angle", "deg")), ("omega_rad_s", ("omega", "rad/s")), ("rpm", ("rpm", "rpm")),
        ("RPM", ("RPM", "rpm")), ("millis", ("millis", "ms")), ("micros", ("micros", "us")), ("psi", ("psi", "")),
        ("/imu/gyro [deg/s]", ("/imu/gyro", "deg/s")), ("/imu/gyro (deg/s)", ("/imu/gyro", "deg/s")),
        ("s", ("s", "")), ("angle_240fps_deg", ("angle", "deg")), ("my_angle", ("my_angle", "")),
    ],
)  # fmt: skip
def test_headers_are_split_in_name_and_unit(text, expected):
    assert header_of(text) == expected


@pytest.mark.parametrize(
    ("name", "role"),
    [
        ("t", "t"), ("Time", "t"), ("elapsed time", "t"), ("angle", "angle"), ("theta", "angle"), ("angle1", "angle"),
        ("angle.casing", "angle"), ("angular_velocity", "omega"), ("angular velocity z", "omega"), ("gyro_x", "omega"),
        ("rpm", "omega"), ("sigma", "sigma"), ("sigma_angle", "sigma"), ("angle_err", "sigma"), ("u_omega", "sigma"),
        ("angle error", "sigma"), ("frame", "frame"), ("interval", "interval"), ("counts", "revolutions"),
        ("accel_x", None), ("mag_angle", None), ("acceleration", None), ("voltage", None), ("x", None), ("w", "omega"),
        ("my sigma angle", "angle"),
    ],
)  # fmt: skip
def test_roles_of_names(name, role):
    assert role_of(name) == role


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("alpha_m_rad_s2", True), ("alpha [rad/s^2]", True), ("phi (deg/s²)", True), ("alpha / rad s-2", True),
        ("alpha", False), ("omega_rad_s", False), ("omega [rad/s] 2", False), ("angle_rad_2", False),
    ],
)  # fmt: skip
def test_units_of_angular_acceleration(name, expected):
    assert is_acceleration(name) is expected


def test_inputs_and_units_are_recognised():
    assert is_input("motor current")
    assert is_input("PWM-left")
    assert not is_input("currently")
    assert is_unit("rad/s")
    assert is_unit("px")
    assert not is_unit("angle")


@pytest.mark.parametrize(
    ("cell", "options", "expected"),
    [
        ("1.5", {}, 1.5), ("1,5", {"decimal_comma": True}, 1.5), ("1,5", {}, None), ("1_000", {}, None),
        ("abc", {}, None), ("12:30", {}, None), ("12:30", {"times": True}, 750.0),
        ("1:02:03.5", {"times": True}, 3723.5),
        ("1970-01-01T00:01:40", {"times": True}, 100.0), ("1970-01-01T01:00:00+01:00", {"times": True}, 0.0),
        ("a:b", {"times": True}, None), ("1e3", {}, 1000.0),
        ("1.234,5", {"decimal_comma": True}, 1234.5), ("-1,234.5", {}, -1234.5), ("1,234", {}, 1234.0),
        ("1.234.567", {"decimal_comma": True}, 1234567.0), ("1'234.5", {}, 1234.5),
        ("1\xa0234,5", {"decimal_comma": True}, 1234.5),
        # a single separator may be a decimal sign; groups have three digits
        ("1.234", {"decimal_comma": True}, 1.234), ("1,234", {"decimal_comma": True}, 1.234),
        ("1.23,4", {"decimal_comma": True}, None), ("1,2345", {}, None), ("1.234,5.6", {}, None),
    ],
)  # fmt: skip
def test_numbers_in_cells(cell, options, expected):
    assert number_of(cell, **options) == expected


@pytest.mark.parametrize(
    "cell", ["", "nan", "NaN", "NA", "n/a", "-", "None", "null", "#DIV/0!", "#N/A", "--", "n.a."]
)
def test_cells_without_a_value(cell):
    assert math.isnan(number_of(cell))


def test_thousands_are_separated_in_a_whole_column():
    cells = (["999,5", "1.000,5", "2.000"], ["999,5", "1,000", "2,000"])
    raw = RawTable(PATH, ("a", "b"), ("", ""), cells, np.array([3, 4, 5]), decimal_comma=True)
    assert raw.numbers(0).tolist() == [999.5, 1000.5, 2000.0]
    assert raw.numbers(1).tolist() == [999.5, 1.0, 2.0]


def test_columns_of_numbers():
    raw = RawTable(PATH, ("t", "a"), ("", ""), (["0:01", "0:02"], ["inf", "x"]), np.array([3, 4]))
    assert raw.numbers(0, times=True).tolist() == [1.0, 2.0]
    with pytest.raises(DatasetError, match="line 4: 'x'"):
        raw.numbers(1)
    assert raw.numeric(1) is None
    assert raw.headed
    raw = table_of(PATH, ["", ""], [[1.0, np.inf], [3, 4]])
    assert not raw.headed
    assert np.isnan(raw.numbers(0)[1])
    assert np.isinf(raw.numbers(0, infinite=True)[1])
    assert raw.line.tolist() == [1, 2]
    assert raw.header_place == "a.csv"


def test_limits_of_a_table():
    refuse_size(PATH, 5_000_000, 5_000)
    for size in ((5_000_001, 1), (1, 5_001)):
        with pytest.raises(DatasetError):
            refuse_size(PATH, *size)
    refuse_long_names(PATH, ["a" * 500])
    with pytest.raises(DatasetError):
        refuse_long_names(PATH, ["b", "a" * 501])


def test_files_are_limited_in_size(tmp_path, monkeypatch):
    monkeypatch.setattr(_raw_table, "MAX_BYTES", 4)
    (tmp_path / "a").write_bytes(b"1234")
    assert _raw_table.read_bytes(tmp_path / "a") == b"1234"
    (tmp_path / "b").write_bytes(b"12345")
    with pytest.raises(DatasetError, match="larger"):
        _raw_table.read_bytes(tmp_path / "b")
    with pytest.raises(DatasetError, match="does not exist"):
        _raw_table.read_bytes(tmp_path / "c")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"])
def test_text_in_all_encodings(encoding):
    text = "t,ψ\n" if encoding != "latin-1" else "t,µ\n"
    raw = read((text + ROWS).encode(encoding))
    assert raw.names == tuple(text.strip().split(","))
    assert values(raw)[1] == ANGLES
    assert raw.line.tolist() == list(range(2, 10))
    assert raw.header_line == 1
    with pytest.raises(DatasetError, match="not a table"):
        content_lines(PATH, b"\x00\x01\x02" * 50)


@pytest.mark.parametrize(
    ("separator", "comma", "expected"),
    [
        (",", ".", ","),
        (";", ".", ";"),
        (";", ",", ";"),
        ("\t", ",", "\t"),
        (" ", ".", None),
        ("  ", ",", None),
    ],
)
def test_separators_and_decimal_commas(separator, comma, expected):
    text = f"t{separator}angle\n" + "".join(f"{k}{comma}5{separator}{k}{comma}25\n" for k in range(8))
    raw = read(text)
    assert values(raw) == [[k + 0.5 for k in range(8)], [k + 0.25 for k in range(8)]]
    assert raw.decimal_comma == (separator != ",")
    assert delimiter_of(f"1{separator}2") == expected


def test_cells_of_a_line():
    assert split('"a,b", c ,"d"', ",") == ["a,b", "c", "d"]
    assert split("a  b\tc", None) == ["a", "b", "c"]
    assert split("a;;b;", ";") == ["a", "", "b", ""]
    assert delimiter_of('"a;b",c') == ","
    assert delimiter_of("1,5;2,5") == ";"
    assert delimiter_of("1,5\t2,5") == "\t"


def test_comments_and_empty_lines_are_excluded():
    text = "# made by hand\nt,angle\n\n ,, \n" + "".join(f"{k},{k} # note {k}\n" for k in range(8)) + "#end\n"
    raw = read(text)
    assert raw.names == ("t", "angle")
    assert raw.line.tolist() == list(range(5, 13))
    assert values(raw)[1] == list(range(8))
    raw = read("t,angle\n0,1\n1,#N/A\n2,3\n3,#div/0!\n4,5\n5,6\n6,7\n")
    assert len(raw.line) == 7
    assert np.isnan(raw.numbers(1)).tolist() == [False, True, False, True, False, False, False]


def test_repeated_headers_and_text_below_are_excluded():
    raw = read("t,angle\n" + ROWS + "t,angle\n" + "9,90\n10,100\nmean,of,all\nthe end\n")
    assert values(raw)[0] == [*range(8), 9, 10]
    assert any("line 10" in note for note in raw.notes)
    assert any("from line 13" in note for note in raw.notes)
    below = "".join(f"text {k}\n" for k in range(10))
    assert values(read("t,angle\n" + ROWS + below))[1] == ANGLES
    with pytest.raises(DatasetError):
        read("t,angle\n" + 4 * ROWS + below + "text\n")


def test_units_may_be_in_a_line_below_the_names():
    raw = read("t,angle\n[s],[deg]\n" + ROWS)
    assert (raw.names, raw.units, raw.header_line) == (("t", "angle"), ("s", "deg"), 1)
    raw = read("Symbol,psi\nt,angle\n" + ROWS)
    assert (raw.names, raw.units) == (("t", "angle"), ("", ""))
    raw = read("t,angle\nfirst,second\n" + ROWS)
    assert (raw.names, raw.header_line) == (("t", "angle"), 1)
    raw = read("one,two\nthree,four\n" + ROWS)
    assert (raw.names, raw.header_line) == (("three", "four"), 2)
    raw = read("My experiment\nt,angle\n" + ROWS)
    assert (raw.names, raw.header_line) == (("t", "angle"), 2)
    raw = read(ROWS)
    assert (raw.names, raw.header_line, raw.headed) == (("", ""), 1, False)


def test_names_with_blanks():
    rows = "".join(f"{k} {10 * k}\n" for k in range(8))
    assert read("t [s] angle [rad]\n" + rows).names == ("t [s]", "angle [rad]")
    assert read("t angle\n" + rows).names == ("t", "angle")
    assert read("two words\n\n" + rows).names == ("", "")
    assert read("t angle\n\n" + rows).names == ("t", "angle")


def test_a_short_row_before_the_last_one_is_an_error():
    with pytest.raises(DatasetError, match="1 cells where the header has 2"):
        read("t,angle\n" + ROWS + "8\n9,90\n")


def test_rows_of_unequal_length():
    raw = read("t,angle\n" + ROWS + "8")
    assert values(raw)[1] == ANGLES
    assert any("truncated" in note for note in raw.notes)
    raw = read("t,angle\n" + ROWS.replace("\n", ",\n"))
    assert values(raw)[1] == ANGLES
    for odd in ("1,2,3\n", "4\n"):
        with pytest.raises(DatasetError, match="line 4"):
            read("t,angle\n0,0\n1,10\n" + odd + ROWS)
    raw = read("t,angle\n" + "".join(f"{k},5,{k},25\n" for k in range(8)))
    assert values(raw) == [[k + 0.5 for k in range(8)], [k + 0.25 for k in range(8)]]
    with pytest.raises(DatasetError, match="no rows"):
        read("t,angle\n")


@pytest.mark.parametrize("lines", [1, 10])
def test_settings_above_the_samples_are_ignored(lines):
    raw = read("".join(f"{k},1,2\n" for k in range(lines)) + 2 * ROWS)
    assert values(raw)[1] == 2 * ANGLES
    assert any(f"before line {lines + 1}" in note for note in raw.notes)
    with pytest.raises(DatasetError):
        read("".join(f"{k},1,2\n" for k in range(11)) + ROWS * 2)


@pytest.mark.parametrize(("rows", "transposed"), [(5, True), (6, False)])
def test_a_table_of_few_rows_is_transposed(rows, transposed):
    text = "".join(",".join(str(100 * r + c) for c in range(40)) + "\n" for r in range(rows))
    raw = read(text)
    assert len(raw.columns) == (rows if transposed else 40)
    if transposed:
        assert raw.numbers(1).tolist() == list(range(100, 140))
    narrow = "".join(",".join(str(100 * r + c) for c in range(25)) + "\n" for r in range(4))
    assert len(read(narrow).columns) == 25
    wide = "".join(",".join(str(100 * r + c) for c in range(26)) + "\n" for r in range(4))
    assert len(read(wide).columns) == 4


def zipped(name, parts):
    stream = io.BytesIO()
    with (
        zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open(name, "w") as out,
    ):
        for part in parts:
            out.write(part)
    return stream.getvalue()


def zipped_names(names):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name in names:
            archive.writestr(name, "0,0\n")
    return stream.getvalue()


def matlab(size):
    """A MATLAB file whose only element claims to be compressed, and expands to `size` bytes."""
    packer = zlib.compressobj(1)
    first, other = (packer.compress(bytes(2**20)) + packer.flush(zlib.Z_FULL_FLUSH) for _ in range(2))
    body = first + other * ((size >> 20) - 1)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    return head + (15).to_bytes(4, "little") + len(body).to_bytes(4, "little") + body


def empty_structs():
    """A MATLAB file with a struct array of 2^28 items without content."""

    def part(kind, data):
        return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)

    parts = (
        (6, struct.pack("<II", 2, 0)),
        (5, struct.pack("<ii", 2**28, 1)),
        (1, b"a"),
        (5, struct.pack("<i", 8)),
    )
    body = zlib.compress(part(14, b"".join(part(*p) for p in (*parts, (1, b"abcdefg\0")))))
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + struct.pack("<II", 15, len(body)) + body


@pytest.mark.parametrize(
    ("line", "delimiter", "cells"),
    [
        ("a, b ,c", ",", ["a", "b", "c"]),
        ('"a" , " b " ,"c"', ",", ["a", "b", "c"]),
        ('"a, b",c', ",", ["a, b", "c"]),
        ('"1,5";"2,5"', ";", ["1,5", "2,5"]),
        ('"a;b";c', ";", ["a;b", "c"]),
        ('1.0  "x"\t2', None, ["1.0", "x", "2"]),
        ("a,,", ",", ["a", "", ""]),
    ],
)
def test_cells_have_no_quotes_and_no_blanks_around_them(line, delimiter, cells):
    assert split(line, delimiter) == cells


BOMBS = {
    "elements": (
        lambda: zipped("a.trk", [b"<object>", *[b"<a/>" * 250_000] * 13, b"</object>"]),
        "larger than any Tracker project",
    ),
    "carriage returns": (lambda: zipped("a.csv", [b"0\r" * 2**19] * 11), "at most 5,000,000"),
    "a line": (lambda: zipped("a.csv", [b"0," * 2**19] * 17), "a line has 17,825,792 characters"),
    "tables": (lambda: zipped_names(f"{k}.csv" for k in range(101)), "contains 101 tables of text"),
    "rows of a workbook": (
        lambda: zipped("[Content_Types].xml", [b"<row/>" * 2**18]),
        "more than 2,000,000 cells",
    ),
    "structs": (empty_structs, "declares an array of 268,435,456 items"),
    "zip": (lambda: zipped("a.csv", [b"0,0\n" * 2**18] * 257), "larger than 256 MiB when unpacked"),
    "matlab": (lambda: matlab(2**28 + 2**20), "larger than 256 MiB when expanded"),
    "rows": (lambda: b"0\n" * (_raw_table.MAX_ROWS + 1), "at most 5,000,000"),
    "columns": (
        lambda: b",".join([b"0"] * 6000) + b"\n" + b"\n".join([b",".join([b"1"] * 6000)] * 12),
        "6,000 columns",
    ),
    "header": (lambda: b"t,angle" + b"(" * 100_000 + b"\n" + b"0,1\n" * 20, "a cell of the header has"),
    "json": (lambda: json.dumps({"t": [0] * 10}).encode().ljust(2**25 + 1), "larger than 32 MiB"),
    "nested": (lambda: b"[" * 200_000, "not a JSON table"),
}


@pytest.mark.parametrize("kind", BOMBS)
def test_a_bomb_is_refused(tmp_path, kind):
    make, match = BOMBS[kind]
    path = tmp_path / "a"
    path.write_bytes(make())
    begin = time.process_time()
    with pytest.raises(DatasetError, match=match):
        read_motion(path)
    assert time.process_time() - begin < 5.0  # the first use of memory costs time


def test_a_workbook_whose_stated_size_is_a_million_columns_is_read(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in [("t", "angle"), *((k / 10, 2.0 * k) for k in range(20))]:
        book.active.append(row)
    stream = io.BytesIO()
    book.save(stream)
    spoiled = io.BytesIO()
    with zipfile.ZipFile(stream) as source, zipfile.ZipFile(spoiled, "w") as target:
        for name in source.namelist():
            target.writestr(name, source.read(name).replace(b'ref="A1:B21"', b'ref="A1:XFD1048576"'))
    path = tmp_path / "a.xlsx"
    path.write_bytes(spoiled.getvalue())
    tracemalloc.start()
    read = read_motion(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_allclose(read.value, 2.0 * np.arange(20))
    assert peak < 50e6


def test_a_parquet_file_of_a_repeated_long_text(tmp_path):
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    count = 100
    columns = {"t": np.arange(count) / 10, "angle": 2.0 * np.arange(count), "note": ["x" * 100_000] * count}
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table(columns), path)
    read = read_motion(path)
    np.testing.assert_allclose(read.value, columns["angle"])
    many = pa.table({"t": pa.array(np.zeros(_raw_table.MAX_ROWS + 1))})
    pq.write_table(many, path)
    with pytest.raises(DatasetError, match="at most 5,000,000"):
        read_motion(path)


@pytest.mark.parametrize(("most", "read"), [(300, True), (299, False)])
def test_the_numbers_of_a_parquet_file_are_limited(tmp_path, monkeypatch, most, read):
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    path = tmp_path / "a.parquet"
    columns = {"t": np.arange(100.0) / 10, "angle": np.arange(100.0), "other": np.zeros(100)}
    pq.write_table(pa.table(columns), path)
    monkeypatch.setattr("gyrotrack.io.readers._columnar._MOST_NUMBERS", most)
    with nullcontext() if read else pytest.raises(DatasetError, match=f"more than {most} cells"):
        np.testing.assert_allclose(read_motion(path).value, np.arange(100.0))


def test_numbers_are_read_without_a_text_for_each_cell(tmp_path):
    count = 50_000
    path = tmp_path / "a.csv"
    path.write_text("t,angle\n" + "".join(f"{k / 1000:.3f},{k / 7:.6f}\n" for k in range(count)))
    tracemalloc.start()
    read = read_motion(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(read.time) == count
    assert peak < 30e6  # 400 MB for a million rows, with the interpreter


def test_the_sound_of_a_pickup_is_pulses(tmp_path):
    rate = 4000
    t = np.arange(3 * rate) / rate
    angle = 60 * t - 3 * t**2
    path = tmp_path / "a.wav"
    with wave.open(str(path), "wb") as sound:
        sound.setparams((1, 2, rate, 0, "NONE", ""))
        sound.writeframes((8000 * np.cos(angle)).astype("<i2").tobytes())
    with pytest.raises(DatasetError, match="need --pulses-per-turn"):
        read_motion(path)
    read = read_motion(path, ReadOptions(pulses_per_turn=1.0))
    np.testing.assert_allclose(np.polyfit(read.time, read.value, 2)[:2], [-3, 60], rtol=1e-3)


def test_a_unit_is_not_computed(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t [s],angle [9**9**9**9]\n" + "".join(f"{k / 100},{k}\n" for k in range(50)))
    with pytest.raises(DatasetError, match="unknown unit"):
        read_motion(path)


def test_lines_with_two_characters_at_their_ends_count_once(tmp_path, monkeypatch):
    monkeypatch.setattr(_raw_table, "MAX_ROWS", 60)
    path = tmp_path / "a.csv"
    path.write_bytes(b"t,angle\r\n" + b"".join(b"%.2f,%d\r\n" % (k / 100, 2 * k) for k in range(50)))
    assert len(read_motion(path).time) == 50


@pytest.mark.parametrize(
    ("unit", "computed"),
    [("x" * 30, True), ("x" * 31, False), ("deg**2", True), ("deg**2**2", False), ("deg^2^2", False),
     ("100 deg", True), ("1000 deg", False)],
)  # fmt: skip
def test_long_units_and_powers_of_powers_are_not_computed(monkeypatch, unit, computed):
    asked = []

    class Registry:
        def Quantity(self, value, text):  # noqa: N802 - the name of pint
            asked.append(text)
            raise ValueError

    monkeypatch.setattr(_raw_table, "_unit_registry", Registry)
    assert _raw_table._by_pint("angle", unit) is None
    assert asked == ([unit] if computed else [])


def test_the_limits_of_a_table_are_those_of_the_manual():
    """About 1 GB of memory."""
    limits = _raw_table.MAX_BYTES, _raw_table.MAX_ROWS, _raw_table.MAX_COLUMNS, _raw_table.MAX_CELLS
    assert limits == (256 * 2**20, 5_000_000, 5_000, 10_000_000)
