"""Exported numbers are those of the file, to the last digit, whoever reads them."""

import csv
import io
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gyrotrack import (
    DatasetError,
    OutputError,
    UsageError,
    export_file,
    read_case,
    read_recording,
    write_case,
    write_recording,
)
from gyrotrack.apps.cli._app import run
from gyrotrack.io import _contents as contents
from gyrotrack.io._contents import columns, plain_cell

pd = pytest.importorskip("pandas")
xr = pytest.importorskip("xarray")
DOCS = Path(__file__).parents[3] / "docs"


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("export") / "case1.h5"
    assert run(["simulate", "-o", str(path), "--duration", "20", "--window-length", "1"]) == 0
    return path


def test_csv_gives_every_digit_back(file, tmp_path):
    held = export_file(file, tmp_path / "a.csv")
    case = read_case(file)
    with (tmp_path / "a.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert held["rows"] == len(rows) == len(case.casing.time) + len(case.rotor.time)
    casing = [r for r in rows if r["body"] == "casing"]
    for name, unit in (("time", " [s]"), ("angle", " [rad]"), ("omega", " [rad/s]"), ("turn", "")):
        values = [float(r[name + unit]) if r[name + unit] else np.nan for r in casing]
        np.testing.assert_array_equal(values, getattr(case.casing, name))
    assert {r["window"] for r in rows if r["body"] == "rotor"} == {"0", "1", "2"}


def test_parquet_has_the_same_numbers_with_units(file, tmp_path):
    pq = pytest.importorskip("pyarrow.parquet")
    export_file(file, tmp_path / "a.parquet")
    table = pq.read_table(tmp_path / "a.parquet")
    pd.testing.assert_frame_equal(table.to_pandas(), read_case(file).to_dataframe(), check_dtype=False)
    assert table.schema.field("omega").metadata == {b"units": b"rad s-1"}


@pytest.mark.slow
def test_netcdf_is_the_whole_tree(file, tmp_path):
    export_file(file, tmp_path / "a.nc")
    with (
        xr.open_datatree(file, engine="h5netcdf") as ours,
        xr.open_datatree(tmp_path / "a.nc", engine="h5netcdf") as theirs,
    ):
        xr.testing.assert_identical(ours.load(), theirs.load())


def test_xarray_opens_our_files_by_itself(file):
    with xr.open_datatree(file, engine="h5netcdf") as tree:
        assert tree["casing/omega"].attrs["units"] == "rad s-1"
        assert tree["casing/omega"].dims == ("time",)
        np.testing.assert_array_equal(tree["casing/time"].values, read_case(file).casing.time)


def test_tables_of_a_recording(recording, tmp_path):
    path = write_recording(tmp_path / "r.h5", recording, command="", settings={})
    markers = read_recording(path).to_dataframe("markers")
    assert len(markers) == 2 * len(recording.time)
    red = markers[markers.marker == "red"]
    np.testing.assert_array_equal(red["corner_1_y"], recording.markers["red"].corner[:, 1, 1])
    assert set(red.status) == {"ok", "occluded"}
    frames = recording.to_dataframe("frames")
    np.testing.assert_array_equal(frames.centre_x, recording.centre[:, 0])
    assert frames.attrs["units"]["centre_x"] == "px"


def test_what_is_not_there_is_reported(file, tmp_path):
    with pytest.raises(UsageError, match="no table 'markers'"):
        export_file(file, tmp_path / "a.csv", table="markers")
    with pytest.raises(UsageError, match="suffix"):
        export_file(file, tmp_path / "a.xlsx")
    with pytest.raises(DatasetError, match="does not exist"):
        export_file(tmp_path / "no.h5", tmp_path / "a.csv")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".csv", ".json", ".parquet", ".nc"])
def test_an_existing_file_is_not_replaced(file, tmp_path, suffix):
    target = tmp_path / f"a{suffix}"
    target.write_bytes(b"mine")
    with pytest.raises(OutputError, match="exists"):
        export_file(file, target)
    assert target.read_bytes() == b"mine"


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1"])
def test_no_word_becomes_a_formula(text, case, tmp_path):
    cell = "'" + text.replace("\r", "\n")
    assert plain_cell(text) == cell
    clip = replace(next(iter(case.recordings.values())), source=text)
    assert columns(clip, "frames")[0].values[0] == text
    path = write_case(tmp_path / "c.h5", replace(case, recordings={"x": clip}), command="", settings={})
    export_file(path, tmp_path / "a.csv", table="frames")
    stream = io.BytesIO()
    contents._csv(columns(clip, "frames"), stream)
    _, first, *_ = csv.reader(io.StringIO(stream.getvalue().decode(), newline=""))
    assert first[0] == cell


def test_cells_of_numbers_and_words():
    made = {"a": [1.5, np.nan, -2e-9], "b": [3, -4, 5], "c": np.array(["u", "-v", "w\r=1"], dtype=object)}
    stream = io.BytesIO()
    contents._csv([SimpleNamespace(heading=k, values=np.asarray(v)) for k, v in made.items()], stream)
    assert stream.getvalue().decode() == 'a,b,c\n1.5,3,u\n,-4,\'-v\n-2e-09,5,"w\n=1"\n'


@pytest.mark.slow
def test_the_notebook_runs(file, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(file.parent)
    blocks = re.findall(r"^```python\n(.*?)^```$", (DOCS / "how-to/notebook.md").read_text(), re.S | re.M)
    assert len(blocks) == 4
    scope = {}
    for block in blocks:
        exec(compile(block, "notebook.md", "exec"), scope)  # noqa: S102 - our own page
    said = capsys.readouterr().out
    assert "rad s-1" in said
    assert "bearing.linear.d" in said
    scope["tree"].close()


@pytest.mark.parametrize("rows", [1, 3, 4, 7])
def test_every_row_is_written_in_blocks(monkeypatch, rows):
    """Of three rows."""
    monkeypatch.setattr(contents, "_BLOCK", 3)
    stream, values = io.BytesIO(), np.arange(float(rows))
    contents._csv([SimpleNamespace(heading=name, values=values) for name in "ab"], stream)
    assert stream.getvalue().decode().split() == ["a,b", *(f"{x},{x}" for x in values.tolist())]
