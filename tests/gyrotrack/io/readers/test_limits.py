"""Small files that expand to far more than memory holds are refused with one sentence."""

import io
import json
import struct
import time
import tracemalloc
import wave
import zipfile
import zlib
from contextlib import nullcontext

import numpy as np
import pytest

from gyrotrack import DatasetError
from gyrotrack.io.readers import _raw_table as limits
from gyrotrack.io.readers._motion_table import ReadOptions
from gyrotrack.io.readers._registry import read_motion


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
    "rows": (lambda: b"0\n" * (limits.MAX_ROWS + 1), "at most 5,000,000"),
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
    many = pa.table({"t": pa.array(np.zeros(limits.MAX_ROWS + 1))})
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
    monkeypatch.setattr(limits, "MAX_ROWS", 60)
    path = tmp_path / "a.csv"
    path.write_bytes(b"t,angle\r\n" + b"".join(b"%.2f,%d\r\n" % (k / 100, 2 * k) for k in range(50)))
    assert len(read_motion(path).time) == 50
