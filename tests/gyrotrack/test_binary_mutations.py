"""Binary files that were changed at random are read or refused in one sentence, within 10 s and 1 GB."""

import io
import json
import random
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="measures memory by /proc"),
]
CHANGES = 40  # of each kind of file
LIMIT_S, LIMIT_MB = 10.0, 1000.0
COLUMNS = {"t": np.arange(60) / 100, "angle": np.arange(60) / 7}


def _matlab(path):
    import scipy.io

    scipy.io.savemat(path, COLUMNS, do_compression=path.stem == "packed")


def _workbook(path):
    import openpyxl

    book = openpyxl.Workbook()
    for row in [tuple(COLUMNS), *zip(*(c.tolist() for c in COLUMNS.values()), strict=True)]:
        book.active.append(row)
    book.save(path)


def _parquet(path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table(COLUMNS), path)


def _archive(path):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.csv", "t,angle\n" + "".join(f"{k / 100},{k / 7}\n" for k in range(60)))


def _wav(path):
    from scipy.io import wavfile

    wavfile.write(path, 8000, (1000 * np.sin(np.arange(2000) / 5)).astype(np.int16))


def _hdf5(path):
    from gyrotrack import import_body, write_case

    table = path.with_suffix(".csv")
    table.write_text("t,angle\n" + "".join(f"{k / 100},{k / 7}\n" for k in range(60)))
    write_case(path, import_body(table, 1e-5), command="x", settings={})


def _film(path):
    import av

    with av.open(str(path), "w") as film:
        stream = film.add_stream("mjpeg" if path.suffix == ".avi" else "mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = (
            32,
            32,
            "yuvj420p" if path.suffix == ".avi" else "yuv420p",
        )
        for k in range(12):
            film.mux(stream.encode(av.VideoFrame.from_ndarray(np.full((32, 32, 3), 20 * k, np.uint8))))
        film.mux(stream.encode())


KINDS = {
    "plain.mat": _matlab,
    "packed.mat": _matlab,
    "a.xlsx": _workbook,
    "a.parquet": _parquet,
    "a.zip": _archive,
    "a.npz": lambda path: np.savez(path, **COLUMNS),
    "a.wav": _wav,
    "a.h5": _hdf5,
    "a.avi": _film,
    "a.mp4": _film,
}


def changed(content, chance):
    """Return a content with a few bytes replaced, removed, doubled or set to extreme numbers."""
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(content))
        piece = content[at : at + chance.randint(1, 40)]
        put = chance.choice(
            (b"", bytes(len(piece)), b"\xff" * 4, b"\0\0\0\x80", piece * 2, chance.randbytes(4))
        )
        content = content[:at] + put + content[at + len(piece) :]
    return content


def inside(content, chance):
    """Return an archive with a change within one of its members, under a right checksum."""
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as source, zipfile.ZipFile(made, "w") as target:
        chosen = chance.choice(source.namelist())
        for name in source.namelist():
            held = source.read(name)
            target.writestr(name, changed(held, chance) if name == chosen else held)
    return made.getvalue()


@pytest.mark.release
@pytest.mark.parametrize("name", list(KINDS))
def test_a_changed_binary_file_is_read_or_refused_within_limits(tmp_path, name):
    path = tmp_path / name
    KINDS[name](path)
    content, chance, wrong = path.read_bytes(), random.Random(name), []  # noqa: S311
    program = [sys.executable, str(Path(__file__).with_name("limited_reader.py"))]
    with subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as reader:
        for k in range(CHANGES):
            deep = zipfile.is_zipfile(io.BytesIO(content)) and k % 2
            spoiled = inside(content, chance) if deep else changed(content, chance)
            path.write_bytes(spoiled)
            reader.stdin.write(f"{path}\n")
            reader.stdin.flush()
            found = json.loads(reader.stdout.readline())
            beyond = found["seconds"] > LIMIT_S or found["megabytes"] > LIMIT_MB
            if found["how"] not in {"read", "refused"} or beyond:
                wrong.append((k, found))
        reader.stdin.close()
    assert wrong == []
