"""What a file contains, in one description; exported numbers are those of the file, to the last digit."""

import csv
import dataclasses
import io
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import h5py
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
from gyrotrack.io import _contents
from gyrotrack.io._contents import columns, describe_case, describe_motion, inspect_file, plain_cell
from gyrotrack.io._records import Input, PointTrack, no_series


def test_recording_in_numbers(tmp_path, recording):
    found = inspect_file(write_recording(tmp_path / "r.h5", recording, command="c", settings={"a": 1}))
    assert found.kind == "recording"
    assert found.problems == ()
    assert found.summary["frames"] == 300
    assert found.summary["markers"]["red"]["ok"] == 299
    assert found.summary["markers"]["red"]["occluded"] == 1
    assert found.summary["bodies"]["rotor"]["samples"] == 299
    assert found.summary["bodies"]["rotor"]["omega_max"] == 30.0
    assert found.provenance["settings"] == {"a": 1}
    assert found.warnings == recording.warnings


def test_case_in_numbers(tmp_path, case):
    found = inspect_file(write_case(tmp_path / "c.h5", case, command="c", settings={}))
    assert found.problems == ()
    assert [w["samples"] for w in found.summary["rotor"]["windows"]] == [200, 200]
    assert found.summary["recordings"]["rotor_0"]["placement"]["clock_offset"] == 3.5
    assert (found.summary["I_rotor"], found.summary["quantity"]) == (5.54e-5, "angle")
    assert "I_rotor_u" not in found.summary
    stated = dataclasses.replace(case, I_rotor_u=6e-7)
    found = inspect_file(write_case(tmp_path / "u.h5", stated, command="c", settings={}))
    assert found.summary["I_rotor_u"] == 6e-7


@pytest.mark.parametrize(("bodies", "per_inertia"), [("two", 0), ("one", 0), ("one", 1), ("chain", 0)])
def test_only_known_moments_of_inertia_are_shown(case, bodies, per_inertia):
    given = dataclasses.replace(case, bodies=bodies, per_inertia=per_inertia)
    shown = describe_case(given)
    assert shown["I_casing"] == (None if per_inertia else case.I_casing)
    assert shown.get("I_rotor") == (case.I_rotor if bodies == "two" else None)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"casing.sigma": lambda x: 0 * x}, "positive uncertainty"),
        ({"casing.time": lambda x: x[::-1]}, "not strictly increasing"),
        ({"casing.time": lambda x: x * np.nan}, "lacks some times"),
        ({"casing.angle": lambda x: x * np.nan}, "no angles"),
        ({"rotor.sigma": lambda x: -x}, "rotor window 0"),
    ],
)
def test_problems_are_named(tmp_path, case, change, match):
    for name, value in change.items():
        part, _, column = name.partition(".")
        if column:
            series = getattr(case, part)
            case = dataclasses.replace(
                case, **{part: dataclasses.replace(series, **{column: value(getattr(series, column))})}
            )
        else:
            case = dataclasses.replace(case, **{name: value})
    found = inspect_file(write_case(tmp_path / "c.h5", case, command="c", settings={}))
    assert any(match in problem for problem in found.problems)


@pytest.mark.parametrize(
    ("time", "sample"),
    [([0.0, 1.0, 1.0, 2.0], 3), ([0.0, 1.0, 2.0, 1.9], 4), ([0.0, 1e-9, 1.0], None), ([], None)],
)
def test_the_first_sample_that_is_not_later_is_named(time, sample):
    words = [f"the times of it are not strictly increasing (sample {sample})"] if sample else []
    assert _contents._time_problems("it", np.array(time)) == words


def test_the_summary_of_a_motion_has_the_extremes_and_the_middle():
    values = {
        "time": [1.0, 2.0, 4.0, 8.0],
        "omega": [3.0, np.nan, -7.0, 5.0],
        "sigma": [0.1, 0.4, np.nan, 0.3],
    }
    track = SimpleNamespace(**{k: np.array(v) for k, v in values.items()}, omega_sigma=np.full(4, 9.0))
    assert describe_motion(track) == {
        "samples": 4, "t_start": 1.0, "t_stop": 8.0, "omega_min": -7.0, "omega_max": 5.0, "median_sigma": 0.3,
    }  # fmt: skip
    first = describe_motion(track, slice(0, 2), "omega_sigma")
    assert (first["samples"], first["t_stop"], first["omega_min"], first["median_sigma"]) == (
        2,
        2.0,
        3.0,
        9.0,
    )
    nothing = describe_motion(track, slice(0, 0))
    assert nothing == {**dict.fromkeys(nothing), "samples": 0}


def test_verify_reads_what_is_not_ours_too(tmp_path, recording):
    path = write_recording(tmp_path / "r.h5", recording, command="c", settings={})
    plain = inspect_file(path, verify=True)
    assert plain.datasets_verified == plain.chunks_verified > 30
    with h5py.File(path, "r+") as file:
        file.create_dataset("notes/mine", data=np.arange(5000.0), chunks=(1000,), fletcher32=True)
        file["notes/again"] = file["notes"]  # a loop
        place = file["notes/mine"].id.get_chunk_info(2)
    assert inspect_file(path, verify=True).datasets_verified == plain.datasets_verified + 1
    content = bytearray(path.read_bytes())
    content[place.byte_offset + 10] ^= 0xFF
    path.write_bytes(bytes(content))
    inspect_file(path)
    with pytest.raises(DatasetError, match="notes/mine cannot be read"):
        inspect_file(path, verify=True)


@pytest.mark.parametrize(
    ("change", "problems"),
    [
        ({}, []),
        ({"sense": 0}, ["the sense is 0, not +1 or -1"]),
        ({"sense": 1}, []),
        ({"frames_decoded": 301}, ["301 frames were decoded but 300 are stored"]),
        ({"bodies": {}}, ["no body has an angle"]),
        ({"sense": 2, "bodies": {}}, ["the sense is 2, not +1 or -1"]),
        ({"time": np.full(300, np.nan)}, ["the frames have times that are not numbers"]),
        ({"time": -np.arange(300.0)}, ["the times of the frames are not strictly increasing (sample 2)"]),
    ],
)
def test_problems_of_a_recording(recording, change, problems):
    assert _contents._recording_problems(dataclasses.replace(recording, **change)) == problems


def test_a_status_is_one_of_the_defined_ones(recording):
    status = recording.markers["red"].status.copy()
    status[7] = 99
    markers = recording.markers | {"red": dataclasses.replace(recording.markers["red"], status=status)}
    found = _contents._recording_problems(dataclasses.replace(recording, markers=markers))
    assert found == ["marker 'red' has a status that is not defined"]


@pytest.mark.parametrize(
    ("time", "value", "problem"),
    [
        ([0.0, 1.0], [1.0, 2.0], None),
        ([], [], "lacks some values"),
        ([0.0, 1.0], [1.0, np.nan], "lacks some values"),
        ([1.0, 1.0], [1.0, 2.0], "not strictly increasing"),
    ],
)
def test_inputs_have_values_at_increasing_times(case, time, value, problem):
    one = Input("current", np.array(time), np.array(value), np.full(len(time), np.nan), "A", delay=0.5)
    given = dataclasses.replace(case, inputs=(one,))
    found = _contents._case_problems(given)
    assert len(found) == (problem is not None)
    assert problem is None or problem in found[0]
    shown = describe_case(given)["inputs"]["current"]
    assert (shown["samples"], shown["unit"], shown["delay"], shown["median_u"]) == (len(time), "A", 0.5, None)
    assert (shown["t_start"], shown["t_stop"]) == ((time[0], time[-1]) if time else (None, None))
    assert (shown["min"], shown["max"]) == ((1.0, np.nanmax(value)) if time else (None, None))


def test_uncertainties_of_an_input_have_a_median(case):
    one = Input("current", np.arange(4.0), np.arange(4.0), np.array([0.1, np.nan, 0.5, 0.2]))
    assert describe_case(dataclasses.replace(case, inputs=(one,)))["inputs"]["current"]["median_u"] == 0.2


def test_a_rotor_without_samples_and_clips_with_problems_are_named(case, recording):
    none = dataclasses.replace(case, rotor=no_series())
    assert "the rotor has no samples" in _contents._case_problems(none)
    clips = {"rotor_0": dataclasses.replace(recording, sense=0)}
    assert _contents._case_problems(dataclasses.replace(case, recordings=clips)) == [
        "clip 'rotor_0': the sense is 0, not +1 or -1"
    ]


def test_points_of_a_recording_are_stored(tmp_path, recording):
    k = np.arange(5)
    point = PointTrack("bob", 0.1 * k, 2 * k, 3.0 * k, 4.0 * k, 0.5 + k, 0.7 + k, 6.0, 0.01)
    path = write_recording(
        tmp_path / "r.h5",
        dataclasses.replace(recording, points={"bob": point}, markers={}, bodies={}),
        command="",
        settings={},
    )
    read = read_recording(path).points["bob"]
    for f in dataclasses.fields(PointTrack):
        assert np.array_equal(getattr(read, f.name), getattr(point, f.name))


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
    _contents._csv(columns(clip, "frames"), stream)
    _, first, *_ = csv.reader(io.StringIO(stream.getvalue().decode(), newline=""))
    assert first[0] == cell


def test_cells_of_numbers_and_words():
    made = {"a": [1.5, np.nan, -2e-9], "b": [3, -4, 5], "c": np.array(["u", "-v", "w\r=1"], dtype=object)}
    stream = io.BytesIO()
    _contents._csv([SimpleNamespace(heading=k, values=np.asarray(v)) for k, v in made.items()], stream)
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
    monkeypatch.setattr(_contents, "_BLOCK", 3)
    stream, values = io.BytesIO(), np.arange(float(rows))
    _contents._csv([SimpleNamespace(heading=name, values=values) for name in "ab"], stream)
    assert stream.getvalue().decode().split() == ["a,b", *(f"{x},{x}" for x in values.tolist())]
