"""Archives, workbooks, MATLAB files, sound and chains: small contents on both sides of each limit."""

import io
import struct
import zipfile
import zlib
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from gyrotrack import DatasetError, UsageError, import_chain
from gyrotrack.apps import _api
from gyrotrack.io._records import Inertia
from gyrotrack.io.readers import _archives, _matlab, _matlab_process, _spreadsheets
from gyrotrack.io.readers._archives import read_zip
from gyrotrack.io.readers._import_chain import read_bodies, read_inertias, read_joints
from gyrotrack.io.readers._matlab import read_matlab_hdf5, table_of_arrays
from gyrotrack.io.readers._matlab_process import description
from gyrotrack.io.readers._motion_table import ReadOptions
from gyrotrack.io.readers._reading import Reading, Taken, reading_of, units_of_file
from gyrotrack.io.readers._sound import read_wav

PATH = Path("a")


def zipped(**files):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return stream.getvalue()


def table(head, count=8):
    return f"{head}\n" + "".join(f"{k},{10 * k}\n" for k in range(count))


@pytest.fixture(autouse=True)
def no_further_units(monkeypatch):
    monkeypatch.setattr("gyrotrack.io.readers._raw_table._by_pint", lambda *_: None)  # its import is slow


# ---- archives


def test_the_table_of_the_motion_is_read_from_an_archive():
    def names(options=None, **files):
        return read_zip(PATH, zipped(**files), options or ReadOptions()).names

    assert names(**{"b.csv": table("t,z")}) == ("t", "z")
    assert names(**{"b.csv": table("t,z"), "meta/c.csv": table("t,angle")}) == ("t", "z")
    assert names(**{"b.csv": table("t,z"), "c.TXT": table("t,angle")}) == ("t", "angle")
    assert names(**{"b.csv": table("t,z"), "c.tsv": table("t,x [rad/s]")}) == ("t", "x [rad/s]")
    assert names(ReadOptions(marker="b"), **{"b.csv": table("t,z"), "c.csv": table("t,u")}) == ("t", "z")
    for files in (
        {"b.csv": table("t,z"), "c.csv": table("t,u")},
        {"b.csv": table("t,angle"), "c.csv": table("t,omega")},
        {"b.dat": ""},
    ):
        with pytest.raises((DatasetError, UsageError)):
            names(**files)
    long = "t,angle\n" + "".join(f"{k},{k}.12345678\n" for k in range(3000))
    assert names(**{"b.csv": long, "c.csv": table("t,z")}) == ("t", "angle")
    with pytest.raises(DatasetError, match="damaged"):
        read_zip(PATH, zipped(**{"b.csv": table("t,z")})[:-30], ReadOptions())


def test_limits_of_archives(monkeypatch):
    content = zipped(**{f"b{k}.csv": table("t,angle") for k in range(3)})
    size = 3 * len(table("t,angle"))
    options = ReadOptions(marker="b1")
    monkeypatch.setattr(_archives, "MAX_BYTES", size)
    monkeypatch.setattr(_archives, "_MOST_TABLES", 3)
    assert read_zip(PATH, content, options).names == ("t", "angle")
    monkeypatch.setattr(_archives, "MAX_BYTES", size - 1)
    with pytest.raises(DatasetError, match="unpacked"):
        read_zip(PATH, content, options)
    monkeypatch.setattr(_archives, "MAX_BYTES", size)
    monkeypatch.setattr(_archives, "_MOST_TABLES", 2)
    with pytest.raises(DatasetError, match="3 tables"):
        read_zip(PATH, content, options)


# ---- workbooks


def sheet_of(*sheets, marker=None):
    named = {f"Run{i}": rows for i, rows in enumerate(sheets, 1)}
    return _spreadsheets._sheet_of_samples(PATH, named, ReadOptions(marker=marker))


def test_first_sheet_with_a_row_of_numbers():
    rows = [["title"], ["t", None, "a"], [0, "x", 5], [None, None, None], [1, None], [2, "y", 7, 8]]
    raw = sheet_of([["only", "text"]], rows)
    assert raw.names == ("t", "", "a", "")
    assert raw.columns[0] == ["0", "1", "2"]
    assert raw.columns[1] == ["x", "", "y"]
    assert raw.columns[3] == ["", "", "8"]
    assert raw.line.tolist() == [3, 5, 6]
    assert raw.header_line == 2
    assert sheet_of([[1, 2], [3, 4]]).names == ("", "")
    assert sheet_of([[1, 2], [3, 4]]).header_line == 1
    assert sheet_of([["a", "b", 1], [1, 2, "c"]]).names == ("a", "b", "1")
    assert len(sheet_of([["a", 1, None, None], [1, 2, 3, 4]]).line) == 2
    for sheets in ([], [["a"]], [[None, None]]):
        with pytest.raises(DatasetError, match="no sheet"):
            sheet_of(sheets)


def test_title_merged_cells_settings_and_units_above_the_samples_of_a_sheet():
    data = [[k / 10, 2.0 * k, 20] for k in range(6)]
    rows = [["Run 3", None, None], ["Mass", 2.5], ["Time", "Disc", None], [None, "Angle", "Heat"]]
    raw = sheet_of([*rows, ["[s]", "deg", "[degC]"], *data])
    assert raw.names == ("Time", "Angle", "Heat")
    assert raw.units == ("s", "deg", "degC")
    assert raw.line.tolist() == [6, 7, 8, 9, 10, 11]
    assert raw.header_line == 4
    # a single cell above the header is a title, which gives no name to a column
    assert sheet_of([["Time"], [None, "Angle", "Heat"], *data]).names == ("", "Angle", "Heat")
    # a block of half as many rows as the longest one contains samples; a shorter one contains settings
    settings = [["Mass", 2.5], ["Length", 0.3]]
    assert sheet_of([*settings, ["t", "angle"], *([k, k] for k in range(4))]).names == ("", "")
    assert sheet_of([*settings, ["t", "angle"], *([k, k] for k in range(5))]).names == ("t", "angle")


def test_the_sheet_with_samples_or_the_named_sheet_is_read():
    long = [["t", "a"], *([k, 10 * k] for k in range(6))]
    assert sheet_of([["Run", 3]], long).columns[1] == ["0", "10", "20", "30", "40", "50"]
    assert not sheet_of([["Run", 3]], long).notes
    half, short = long[:4], long[:3]
    found = sheet_of(half, long)
    assert len(found.line) == 3
    assert "the sheet 'Run1' was read; --marker NAME selects another sheet: 'Run2'" in found.notes[0]
    assert len(sheet_of(half, long, marker="run2").line) == 6
    assert len(sheet_of(short, long).line) == 6
    assert len(sheet_of(short, long, marker="run1").line) == 2
    for marker, named in (("run3", "no sheet"), ("run", "2 sheets")):
        with pytest.raises(UsageError, match=f"--marker {marker} names {named} of .*, and no column"):
            sheet_of(half, long, marker=marker)
        assert len(sheet_of(short, long, marker=marker).line) == 6  # one sheet of samples
    assert len(sheet_of([["t", "running a"], *half[1:]], long, marker="running").line) == 3
    eleven = {"Run1": half, "Run11": long}
    assert len(_spreadsheets._sheet_of_samples(PATH, eleven, ReadOptions(marker="Run1")).line) == 3


def test_markup_of_a_workbook_is_limited(monkeypatch):
    monkeypatch.setattr(_spreadsheets, "_MOST_CELLS", 10)
    for sheet, other, refused in ((50, 1, False), (51, 1, True), (50, 2, True)):
        content = zipped(
            **{
                "xl/worksheets/s.xml": "<" * (sheet - 10),
                "xl/sharedStrings.xml": "<" * 10,
                "b.xml": "<" * other,
            }
        )
        if refused:
            with pytest.raises(DatasetError, match="cells"):
                _spreadsheets._refuse_markup(PATH, content)
        else:
            _spreadsheets._refuse_markup(PATH, content)


# ---- MATLAB


def test_vectors_or_a_matrix_of_matlab():
    t, a = np.arange(5.0), np.arange(5)[:, None]
    raw = table_of_arrays(
        PATH,
        {
            "t": t,
            "a": a,
            "short": np.arange(4),
            "one": np.array([[3.0]]),
            "text": np.array(["x"] * 5),
            "long": np.zeros((6, 2)),
        },
    )
    assert raw.names == ("t", "a")
    assert raw.numbers(1).tolist() == list(range(5))
    assert table_of_arrays(PATH, {"a": a.T}).numbers(0).tolist() == list(range(5))
    matrix = np.arange(12.0).reshape(4, 3)
    raw = table_of_arrays(PATH, {"m": matrix, "one": np.array(1.0)})
    assert raw.names == ("", "", "")
    assert raw.numbers(2).tolist() == [2, 5, 8, 11]
    for arrays in ({"m": matrix, "n": matrix}, {}, {"z": np.zeros((2, 2, 2))}, {"c": np.zeros(5, complex)}):
        with pytest.raises(DatasetError, match="neither"):
            table_of_arrays(PATH, arrays)


@pytest.mark.parametrize(
    ("names", "added"), [(("t", "current"), True), (("angle", "current"), True), (("t", "angle"), False)]
)
def test_columns_of_a_matrix_of_matlab_beside_vectors(names, added):
    """The columns of a matrix are read if the vectors beside it do not describe a motion."""
    arrays = {name: np.arange(5.0) for name in names} | {"data": np.arange(10.0).reshape(5, 2)}
    raw = table_of_arrays(PATH, arrays)
    assert raw.names == (*names, *(("data 1", "data 2") if added else ()))
    if added:
        assert raw.numbers(3).tolist() == [1, 3, 5, 7, 9]


def test_files_of_matlab_7_3(tmp_path):
    path = tmp_path / "a.mat"
    with h5py.File(path, "w") as file:
        file["t"] = np.arange(6.0)[None]
        file["s/angle"] = np.arange(6.0)[:, None]
        file["#refs#/b"] = np.arange(6.0)
        file["text"] = np.array([b"abcdef"] * 6)
        file["empty"] = np.arange(6)
        file["empty"].attrs["MATLAB_empty"] = 1
    raw = read_matlab_hdf5(path, b"", None)
    assert sorted(raw.names) == ["angle", "t"]
    with h5py.File(path, "w") as file:
        file["m"] = np.arange(12.0).reshape(3, 4)
    assert read_matlab_hdf5(path, b"", None).numbers(1).tolist() == [4, 5, 6, 7]
    path.write_bytes(b"no")
    with pytest.raises(DatasetError, match="not a readable"):
        read_matlab_hdf5(path, b"", None)


@pytest.mark.parametrize("order", ["little", "big"])
def test_arrays_without_their_items_are_refused(order):
    def content(kind, sizes, filler, packed):
        number = "<I" if order == "little" else ">I"
        flags = bytes([kind, 0, 0, 0]) if order == "little" else bytes([0, 0, 0, kind])
        element = b"".join(struct.pack(number, n) for n in (6, 8)) + flags + bytes(4)
        element += b"".join(struct.pack(number, n) for n in (5, 4 * len(sizes), *sizes)) + bytes(filler)
        if packed:
            element = zlib.compress(element)
        head = bytes(126) + (b"IM" if order == "little" else b"MI")
        return head + struct.pack(number, 15 if packed else 14) + struct.pack(number, len(element)) + element

    for packed in (True, False):
        _matlab._refuse_inflation(PATH, content(1, (3, 4), 64, packed))
        for kind in (1, 2, 3):
            with pytest.raises(DatasetError, match="13 items"):
                _matlab._refuse_inflation(PATH, content(kind, (13, 1), 64, packed))
        _matlab._refuse_inflation(PATH, content(6, (13, 1), 64, packed))


def test_expanded_files_of_matlab_are_limited(monkeypatch):
    element = zlib.compress(bytes(1000))
    content = bytes(128) + 2 * (struct.pack("<II", 15, len(element)) + element)
    monkeypatch.setattr(_matlab, "MAX_BYTES", 2000)
    _matlab._refuse_inflation(PATH, content)
    monkeypatch.setattr(_matlab, "MAX_BYTES", 1999)
    with pytest.raises(DatasetError, match="expanded"):
        _matlab._refuse_inflation(PATH, content)


def test_captures_of_dspace():
    assert description(np.zeros((2, 3))) == "2 x 3 numbers"
    assert description(np.array(1.0)) == "scalar numbers"
    assert description(np.array(["a"])) == "1 text"
    assert description(np.array([None])) == "1 cell"
    assert description(np.zeros(2, [("a", "f8")])) == "2 struct"
    times = np.empty((1, 1), [("Data", object)])
    times[0, 0] = (np.arange(3.0),)
    signals = np.empty((1, 4), [("Name", object), ("Data", object)])
    names = ['"Model Root"/"Plant"/"angle"/"Out1"', "Plant/angle/Out1", "", "omega"]
    for k, name in enumerate(names):
        signals[0, k] = (np.array([name]), np.arange(3.0) + k)
    found = _matlab_process._capture({"X": times, "Y": signals})
    assert list(found) == ["t", "angle", "angle 2", "Y3", "omega"]
    assert found["angle 2"].tolist() == [1, 2, 3]
    assert found["t"].tolist() == [0, 1, 2]
    for fields in (
        {"X": times},
        {"Y": signals},
        {"X": times, "Y": np.zeros(2)},
        {"X": np.zeros(2), "Y": signals},
    ):
        assert _matlab_process._capture(fields) == {}


# ---- sound


@pytest.mark.parametrize("channels", [1, 2])
def test_times_and_channels_of_a_sound(channels):
    values = np.arange(12, dtype="<i2")
    data = values.tobytes()
    head = struct.pack(
        "<4sI4s4sIHHIIHH4sI",
        b"RIFF",
        36 + len(data),
        b"WAVE",
        b"fmt ",
        16,
        1,
        channels,
        50,
        100 * channels,
        2 * channels,
        16,
        b"data",
        len(data),
    )
    raw = read_wav(PATH, head + data, None)
    assert raw.names == ("t", "channel 1", "channel 2")[: channels + 1]
    assert raw.numbers(0).tolist() == [k / 50 for k in range(12 // channels)]
    for k in range(channels):
        assert raw.numbers(k + 1).tolist() == values[k::channels].tolist()
    with pytest.raises(DatasetError, match="WAV"):
        read_wav(PATH, head[:20], None)


# ---- what was read


def test_units_of_a_file():
    def document(*columns):
        return {"columns": [dict(zip(("quantity", "unit"), c, strict=True)) for c in columns]}

    degree = np.pi / 180
    found = units_of_file(document(("time", "ms"), ("angle", "deg")))
    assert {k: v[0] for k, v in found.items()} == {"angle": "deg", "omega": "deg/s", "alpha": "deg/s2"}
    assert [v[1] for v in found.values()] == pytest.approx([degree] * 3)
    found = units_of_file(document(("omega", "rpm"), ("angle", "deg")))
    assert {k: v[0] for k, v in found.items()} == {"omega": "rpm", "alpha": "rpm/s"}
    assert [v[1] for v in found.values()] == pytest.approx([np.pi / 30] * 2)
    assert units_of_file(document(("angle", "rad"), ("omega", ""), ("time", "ms"))) == {}
    reading = Reading(
        "f",
        "CSV",
        9,
        (Taken("'a'", "angle", "deg", "why"), Taken("2", "time", "", "w")),
        tuple(f"c{k}" for k in range(13)),
    )
    first, second = reading.lines()
    assert first == "f (CSV, 9 rows): angle from 'a' [deg] (why); time from 2 (w)."
    assert second.endswith("c11, 1 more.")
    assert reading_of(reading.document()) == reading


# ---- chains


def test_arguments_of_chains(tmp_path):
    assert read_bodies(["a=x.csv", " a = y.csv", "b=z.csv"]) == {
        "a": [Path("x.csv"), Path("y.csv")],
        "b": [Path("z.csv")],
    }
    assert read_bodies(["x.csv"]) == {"": [Path("x.csv")]}
    odd = tmp_path / "a=b.csv"
    odd.write_text("")
    assert read_bodies([str(odd)]) == {"": [odd]}
    for given in (["a=x", "y"], ["a=x", "a=y"], ["x", "y"]):
        with pytest.raises(UsageError):
            read_bodies(given)
    assert read_joints(["p=a,b", "q = b , c"]) == {"p": ("a", "b"), "q": ("b", "c")}
    for given in (["p=a"], ["p=a,b,c"], ["p=a,"], ["p=a,b", "p=b,c"], ["p"]):
        with pytest.raises(UsageError):
            read_joints(given)
    assert read_inertias(["a=1", "b=2 +- 0.5"], ["a", "b"]) == {"a": Inertia.of("1"), "b": Inertia(2.0, 0.5)}
    assert read_inertias(["3 +- 1"], [""]) == {"": Inertia(3.0, 1.0)}
    assert read_inertias(["a=3 +- 1"], ["a"]) == {"a": Inertia(3.0, 1.0)}
    for given, bodies in (
        (["1"], ["a", "b"]),
        (["c=1"], ["a", "b"]),
        (["a=1", "a=2"], ["a", "b"]),
        (["c=1"], ["a"]),
    ):
        with pytest.raises(UsageError):
            read_inertias(given, bodies)


@pytest.mark.parametrize(("first", "second", "sense"), [(1, 1, 1), (-1, -1, -1), (-1, 1, 1)])
def test_case_of_a_chain(tmp_path, first, second, sense):
    time = 0.01 * np.arange(200)
    for name, speed in (("a", first * 5), ("b1", second * 9), ("b2", second * 9)):
        part = time if name == "a" else time[:80] if name == "b1" else time[100:]
        np.savetxt(
            tmp_path / f"{name}.csv",
            np.c_[part, speed * part + 100.0],  # the angle never changes its sign
            delimiter=",",
            header="t [s],angle [rad]",
            comments="",
            fmt="%.6f",
        )
    case = import_chain(
        {"a": [tmp_path / "a.csv"], "b": [tmp_path / "b2.csv", tmp_path / "b1.csv"]}, {"j": ("a", "b")},
        {"a": 2.0, "b": Inertia(3.0, 0.1)}, label="l", surface="s",
    )  # fmt: skip
    assert (case.bodies, case.body_name, case.I_casing, case.joints) == ("chain", "a", 2.0, {"j": ("a", "b")})
    (other,) = case.further
    assert (other.name, other.inertia, other.inertia_u) == ("b", 3.0, 0.1)
    assert np.bincount(other.series.window).tolist() == [80, 100]
    assert (np.diff(other.series.time) > 0).all()
    assert np.sign(case.casing.angle[-1] - case.casing.angle[0]) == first * sense
    assert case.extra["sense"] == sense
    assert case.casing.window is None
    with pytest.raises(UsageError):
        import_chain({"a": [tmp_path / "a.csv"], "b": [tmp_path / "b1.csv"]}, {"j": ("a", "b")}, {"a": 2.0})


# ---- functions for scripts


def test_extraction_without_an_output_writes_nothing(monkeypatch, tmp_path):
    monkeypatch.setattr(_api, "track", lambda *a, **k: ("tracked", a[1], k["body"]))
    assert _api.extract("a.mp4", body="rotor") == ("tracked", _api.PAPER, "rotor")
    calls = []

    class Job:
        def __init__(self, video, target, *rest):
            self.video, self.target = video, target

        def earlier(self):
            return complete

        def run(self, **options):
            calls.append(options)
            return "made", None

    monkeypatch.setattr(_api, "ExtractionJob", Job)
    complete = "earlier"
    out = tmp_path / "o.h5"
    assert _api.extract("a.mp4", out, resume=True) == "earlier"
    assert _api.extract("a.mp4", out, resume=True, force=True) == "made"
    assert _api.extract("a.mp4", out) == "made"
    complete = None
    assert _api.extract("a.mp4", out, resume=True) == "made"
    assert [(c["resume"], c["force"]) for c in calls] == [(True, True), (False, False), (True, False)]


def test_recordings_are_named_by_source_or_file(monkeypatch):
    seen = {}

    def synchronise(casing, rotors, names, **options):
        seen.update(options, names=names)
        return SimpleNamespace(case=case, matches="m")

    case = _api.Case(1.0, 1.0, "", "", None, None)
    monkeypatch.setattr(_api, "synchronise", synchronise)
    monkeypatch.setattr(_api, "read_recording", lambda path: f"read {path}")
    recording = _api.Recording(*["x", "", 1, 1, 1.0, 1.0, 1, 1, 1, ""], *[np.zeros(1)] * 5, {}, {})
    found = _api.sync("c.h5", recording, inertia_rotor="2 +- 0.1", inertia_casing=3.0)
    assert seen["names"] == ["c.h5", "x"]
    assert (seen["I_rotor"], seen["I_casing"]) == (2.0, 3.0)
    assert found.I_rotor_u == 0.1
    assert np.isnan(found.I_casing_u)
    monkeypatch.setattr(_api, "read_kind", lambda path: {"a": "case", "b": "recording"}[path.name])
    monkeypatch.setattr(_api, "read_case", lambda path: "case")
    assert (_api.read("a"), _api.read("b")) == ("case", "read b")


@pytest.mark.parametrize("force", [True, False])
def test_a_case_is_written_with_its_inertias(monkeypatch, tmp_path, force):
    written, refused = [], []
    case = _api.Case(1.0, 1.0, "", "", None, None)
    monkeypatch.setattr(
        _api, "synchronise", lambda casing, rotors, names, **_: SimpleNamespace(case=case, matches="m")
    )
    monkeypatch.setattr(_api, "read_recording", lambda path: f"read {path}")
    monkeypatch.setattr(_api, "write_case", lambda path, case, **more: written.append((path, case, more)))
    monkeypatch.setattr(_api, "refuse_existing", lambda path, **more: refused.append((path, more)))
    out = tmp_path / "case.h5"
    found = _api.sync("c.h5", "r.h5", out, inertia_rotor="2 +- 0.1", inertia_casing=3.0, force=force)
    ((path, stored, more),) = written
    assert (path, stored) == (out, found)
    assert more == {
        "command": "gyrotrack.sync",
        "settings": {"I_rotor": 2.0, "I_casing": 3.0},
        "force": force,
    }
    # the inputs must not be replaced
    assert refused == [(out, {"force": force, "reads": [Path("c.h5"), Path("r.h5")]})]
    assert (found.I_rotor_u, np.isnan(found.I_casing_u)) == (0.1, True)
    _api.sync("c.h5", ["r.h5"], inertia_rotor=2.0, inertia_casing=3.0)
    assert (len(written), len(refused)) == (1, 1)
