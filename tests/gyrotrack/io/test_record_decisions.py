"""Series, warnings, inertias, tables, summaries, checkpoints and TOML: small contents whose result is known."""

import io
import json
import math
import struct
import zlib
from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from pydantic import BaseModel

from gyrotrack import Case, ChainBody, ConfigurationError, ErrorMode, OutputError, UsageError, _column_store
from gyrotrack._toml import line_of, read_document
from gyrotrack.io import _bodies, _contents, _tracker_project
from gyrotrack.io._atomic import CheckpointFile, checkpoint_path, new_file, refuse_existing, written_records
from gyrotrack.io._command_end import marking, marks, unmarked
from gyrotrack.io._hdf5 import WriteBuffer
from gyrotrack.io._outputs import new_outputs
from gyrotrack.io._records import (
    Column,
    Inertia,
    Input,
    Piece,
    PointTrack,
    columns,
    from_speeds,
    no_series,
    series_of,
    speed_warnings,
    windows_of,
)
from gyrotrack.io._tables import to_json, valid


def series(time, angle, **options):
    sigma = np.full(len(time), 0.1)
    piece = Piece(time, angle, sigma, np.gradient(angle, time), sigma)
    return replace(series_of([piece]), **options)


# ---- series


def test_series_of_several_windows():
    a = SimpleNamespace(time=np.arange(2.0), angle=np.array([1.0, 13.0]), sigma=np.ones(2), omega=np.ones(2),
                        omega_sigma=np.full(2, 3.0), correlated_sigma=0.1, correlated_time=5.0,
                        correlated_profile=((0.0, 0.1),), periodic_sigma=0.3, harmonic_sigma=0.2)  # fmt: skip
    b = Piece(*(np.arange(3.0) for _ in range(5)))
    found = series_of([a, b], -1, "given")
    assert found.angle.tolist() == [-1, -13, 0, -1, -2]
    assert found.omega.tolist() == [-1, -1, 0, -1, -2]
    assert found.sigma.tolist() == [1, 1, 0, 1, 2]
    assert found.omega_sigma.tolist() == [3, 3, 0, 1, 2]
    assert found.turn.tolist() == [-1, -3, 0, -1, -1]
    assert found.window.tolist() == [0, 0, 1, 1, 1]
    assert (found.correlated_sigma, found.correlated_time, found.periodic_sigma, found.harmonic_sigma) == (
        0.1,
        5,
        0.3,
        0.2,
    )
    assert found.correlated_profile == ()
    assert series_of([a]).correlated_profile == ((0.0, 0.1),)
    assert found.sigma_source == "given"
    assert series_of([b]).harmonic_sigma == series_of([b]).correlated_sigma == 0.0
    assert windows_of(replace(found, window=None)).tolist() == [0] * 5
    assert len(no_series().time) == len(no_series().window) == 0
    plain = Piece(*[np.zeros(1)] * 5)
    assert plain.smoothing_width == 1
    for name in ("correlated_sigma", "correlated_time", "periodic_sigma", "harmonic_sigma"):
        assert getattr(no_series(), name) == 0.0


def test_angles_are_the_integral_of_speeds():
    time, omega = np.array([0.0, 1.0, 3.0, 4.0]), np.array([1.0, 3.0, 5.0, 1.0])
    found = from_speeds(time, omega, np.array([0.1, 0.2, 0.3, 0.4]))
    assert found.angle.tolist() == [0, 2, 10, 13]
    np.testing.assert_allclose(found.sigma, np.sqrt(np.cumsum(np.array([0.1, 0.2, 0.6, 0.4]) ** 2)))
    np.testing.assert_array_equal(found.omega, omega)
    assert from_speeds(time[:1], omega[:1], np.array([0.1])).sigma.tolist() == [0.1]


@pytest.mark.parametrize(
    ("rotor", "word"),
    [((10.0,), ""), ((10.04,), ""), ((10.02,), "same motion"), ((9.98,), "same motion"), ((9.9,), "faster"),
     ((9.0, 12.0), ""), ((9.0, 9.9), "faster"), ((10.01, 10.5), ""), ((-10.01,), "same motion")],
)  # fmt: skip
def test_casing_that_is_faster_than_the_rotor(rotor, word):
    time = np.linspace(0, 10, 101)
    rotor = (rotor[0] * (4 if word == "" and len(rotor) == 1 and rotor[0] == 10.0 else 1), *rotor[1:])
    casing = series(time, 10 * time, window=None)
    windows = [
        Piece(*[v] * 1, speed * v, *[v] * 3)
        for k, speed in enumerate(rotor)
        for v in [time[10 + 40 * k : 40 + 40 * k]]
    ]
    found = speed_warnings(casing, series_of(windows), "do it")
    assert len(found) == bool(word)
    if word:
        assert word in found[0]
        assert f"10.0 and {abs(rotor[0]):.1f} rad/s" in found[0]
    assert speed_warnings(casing, no_series(), "do it") == []


# ---- inertias


@pytest.mark.parametrize(
    ("text", "value", "u"),
    [
        ("5.54e-5", 5.54e-5, None), ("5.54e-5 +- 0.06e-5", 5.54e-5, 6e-7), ("554 g cm2", 5.54e-5, None),
        ("(554 +- 6) g cm2", 5.54e-5, 6e-7), ("554 g cm2 +- 6", 5.54e-5, 6e-7), ("554 g cm2 +- 2 %", 5.54e-5, 1.108e-6),
        ("554 +- 2 % g cm^2", 5.54e-5, 1.108e-6), ("554 g cm2 +- 6 g cm2", 5.54e-5, 6e-7), ("2 kg m2", 2.0, None),
        ("3 kg*cm**2", 3e-4, None), ("4 mg mm²", 4e-12, None), ("5 g·mm2", 5e-9, None), ("1 ± 0.5", 1.0, 0.5),
        (0.25, 0.25, None),
        ("1e5", 1e5, None), ("1e-12", 1e-12, None),
    ],
)  # fmt: skip
def test_moments_of_inertia(text, value, u):
    found = Inertia.of(text)
    assert found.value == value
    assert math.isnan(found.u) if u is None else found.u == pytest.approx(u, rel=1e-12)
    assert Inertia.of(found) is found
    assert Inertia.required(text, "rotor").value == value


@pytest.mark.parametrize(
    "text",
    [
        "",
        "abc",
        "-1",
        "1.1e5",
        "0.9e-12",
        "0",
        "1 +- 1",
        "1 +- 1.5",
        "1 lb ft2",
        "1 g cm3",
        "554 g cm2 +- 6 kg m2",
        "1 +-",
        "nan",
    ],
)
def test_other_texts_for_a_moment_of_inertia_are_refused(text):
    with pytest.raises(UsageError):
        Inertia.of(text)


def test_a_required_moment_of_inertia():
    with pytest.raises(UsageError, match="--inertia-rotor"):
        Inertia.required(None, "rotor")


# ---- tables


def case_of(**options):
    time = np.linspace(0, 10, 11)
    usual = {"I_rotor": 1.0, "I_casing": 2.0, "label": "a", "surface": "",
             "casing": series(time, 3 * time, window=None),
             "rotor": series(time, 9 * time)}  # fmt: skip
    return Case(**(usual | options))


def test_bodies_of_a_case():
    time = np.linspace(0, 10, 11)
    case = case_of(I_casing_u=0.1)
    assert (case.main_body, [name for name, _ in case.motions]) == ("casing", ["casing", "rotor"])
    assert list(case.inertias) == ["rotor", "casing"]
    assert case.inertias["casing"] == (2.0, 0.1)
    one = replace(case, bodies="one")
    assert (one.main_body, [name for name, _ in one.motions], list(one.inertias)) == (
        "body",
        ["body"],
        ["body"],
    )
    assert replace(one, body_name="wheel").main_body == "wheel"
    chain = replace(
        case, bodies="chain", body_name="p", further=(ChainBody("q", series(time, time), 5.0, 0.2),)
    )
    assert [name for name, _ in chain.motions] == ["p", "q"]
    assert chain.inertias["q"] == (5.0, 0.2)
    text = repr(case)
    assert "11 samples, 0 to 10 s, 1 window" in text
    assert "I_rotor 1, I_casing 2 kg m2" in text


def table(case, name="motion"):
    return {c.name: c for c in columns(case, name)}


def test_table_of_the_motion():
    found = table(case_of(rotor=series(np.linspace(0, 1, 3), np.zeros(3))))
    assert found["body"].values.tolist() == ["casing"] * 11 + ["rotor"] * 3
    assert found["window"].values.tolist() == [0] * 14
    assert found["angle"].values[:11].tolist() == (3 * np.linspace(0, 10, 11)).tolist()
    assert found["angle"].heading == "angle [rad]"
    assert found["omega"].heading == "omega [rad/s]"
    assert found["window"].heading == "window"
    assert found["body"].heading == "body"
    assert "rotor" not in table(case_of(rotor=no_series()))["body"].values
    with pytest.raises(UsageError, match="Unknown table"):
        columns(case_of(), "motions")
    for name in ("markers", "frames", "inputs", "points", "errors"):
        with pytest.raises(UsageError, match=f"no table '{name}'"):
            columns(case_of(), name)


def test_table_of_inputs():
    i = Input("u", np.arange(3.0), np.arange(3.0) + 5, np.full(3, 0.1), "A", "hold", 0.2)
    found = table(case_of(inputs=(i,)), "inputs")
    assert found["value"].values.tolist() == [5, 6, 7]
    assert found["delay"].values.tolist() == [0.2] * 3
    assert found["input"].values.tolist() == ["u"] * 3
    assert found["interpolation"].values.tolist() == ["hold"] * 3


def test_table_of_points_is_in_metres_if_the_scale_is_known(recording):
    t = np.arange(3.0)

    def point(name, scale):
        return PointTrack(name, t, np.arange(3), t + 1, t + 2, t + 3, t + 4, 5.0, scale)

    found = table(replace(recording, points={"a": point("a", 0.5)}), "points")
    assert (found["x"].values.tolist(), found["x"].unit) == ([0.5, 1.0, 1.5], "m")
    assert (found["sigma_y"].values.tolist(), found["time"].values.tolist()) == ([2.0, 2.5, 3.0], [0, 1, 2])
    found = table(replace(recording, points={"a": point("a", math.nan)}), "points")
    assert (found["y"].values.tolist(), found["y"].unit) == ([2, 3, 4], "px")
    assert found["point"].values.tolist() == ["a"] * 3


def test_tables_of_markers_and_frames(recording):
    found = table(recording, "markers")
    assert len(found["angle"].values) == 600
    assert found["marker"].values[[0, 299, 300]].tolist() == ["red", "red", "blue"]
    assert found["status"].values[[4, 5]].tolist() == ["ok", "occluded"]
    np.testing.assert_array_equal(found["corner_1_x"].values[:300], recording.markers["red"].corner[:, 1, 0])
    np.testing.assert_array_equal(found["corner_0_y"].values[300:], recording.markers["blue"].corner[:, 0, 1])
    found = table(recording, "frames")
    np.testing.assert_array_equal(found["centre_y"].values, recording.centre[:, 1])
    np.testing.assert_array_equal(found["index"].values, recording.frame_index)


def test_table_of_errors():
    time = np.linspace(0, 10, 11)
    mode = ErrorMode("tilt", np.outer(time, [1.0, 2.0]), np.array([[4.0, 1.0], [1.0, 9.0]]), "g", "axis")
    both = series(
        time, time, window=None, modes=(mode,), correlated_sigma=0.2, periodic_sigma=0.3, harmonic_sigma=0.1
    )
    found = table(case_of(casing=both), "errors")
    assert found["mode"].values[::11].tolist() == ["tilt", "zero", "periodic", "harmonic"]
    u = found["u"].values.reshape(4, 11)
    np.testing.assert_allclose(u[0], time * math.sqrt(4 + 36 + 4))
    np.testing.assert_allclose(u[1], 0.2)
    np.testing.assert_allclose(u[2], 0.3 * math.sqrt(2))
    np.testing.assert_allclose(u[3], 0.1 * math.sqrt(12))
    assert found["u"].unit == "rad"
    assert found["group"].values[[0, 11]].tolist() == ["g", ""]
    profile = replace(both, correlated_profile=((0.0, 0.1), (10.0, 0.3)))
    np.testing.assert_allclose(table(case_of(casing=profile), "errors")["u"].values[11:22], 0.1 + 0.02 * time)
    assert table(case_of(casing=both, quantity="omega"), "errors")["u"].unit == "rad s-1"


# ---- summaries and problems


def test_summary_of_windows_and_inputs():
    time = np.arange(6.0)
    two = replace(
        series(time, time),
        omega=np.array([np.nan, 2, 1, 5, 4, 3.0]),
        sigma=np.array([1, 2, 3, np.nan, 9, 8.0]),
        window=np.repeat([0, 2], 3),
    )
    first, second = _contents.describe_windows(two, "sigma")
    assert first == {
        "window": 0,
        "samples": 3,
        "t_start": 0,
        "t_stop": 2,
        "omega_min": 1,
        "omega_max": 2,
        "median_sigma": 2,
    }
    assert second == {
        "window": 2,
        "samples": 3,
        "t_start": 3,
        "t_stop": 5,
        "omega_min": 3,
        "omega_max": 5,
        "median_sigma": 8.5,
    }
    empty = _contents.describe_motion(no_series())
    assert (empty["samples"], empty["t_start"], empty["omega_max"], empty["median_sigma"]) == (
        0,
        None,
        None,
        None,
    )
    i = Input("u", time, time[::-1] + 5, np.array([np.nan, 1, 2, 4, np.nan, np.nan]), "A")
    found = _contents._describe_input(i)
    assert (
        found["samples"],
        found["t_start"],
        found["t_stop"],
        found["min"],
        found["max"],
        found["median_u"],
    ) == (6, 0, 5, 5, 10, 2)


def test_problems_of_a_case(recording):
    time = np.linspace(0, 10, 11)

    def problems(**options):
        return _contents._case_problems(case_of(**options))

    assert problems() == []
    back = series(time, time, window=None)
    assert problems(casing=replace(back, time=np.where(time == 5, 4.0, time))) == [
        "the times of casing are not strictly increasing (sample 6)"
    ]
    assert problems(casing=replace(back, sigma=np.where(time == 5, 0.0, 0.1))) == [
        "casing has angles without a positive uncertainty"
    ]
    unknown = replace(back, sigma=np.where(time == 5, 0.0, 0.1), angle=np.where(time == 5, np.nan, time))
    assert problems(casing=unknown) == []
    assert problems(casing=replace(back, angle=time * np.nan)) == ["casing has no angles"]
    assert problems(casing=replace(back, time=time * np.nan)) == ["casing lacks some times"]
    assert problems(rotor=no_series()) == ["the rotor has no samples"]
    assert problems(rotor=no_series(), bodies="one") == []
    again = replace(series(time, time), time=time % 5, window=(time >= 5).astype(int) + (time >= 10))
    assert problems(rotor=again) == []
    bad = Input("u", time, np.where(time == 5, np.nan, 1.0), time)
    assert problems(inputs=(bad,)) == ["the input 'u' lacks some values"]
    clip = replace(recording, frames_decoded=299, sense=2)
    assert [p.startswith("clip 'c'") for p in problems(recordings={"c": clip})] == [True, True]
    assert _contents._recording_problems(recording) == []
    assert _contents._recording_problems(replace(recording, bodies={})) == ["no body has an angle"]
    marker = recording.markers["red"]
    odd = replace(marker, status=np.where(np.arange(300) == 3, 5, 0).astype(np.int8))
    assert len(_contents._recording_problems(replace(recording, markers={"red": odd}))) == 1
    assert _contents.marker_counts(marker.status)["occluded"] == 1
    assert _contents.marker_counts(marker.status)["ok"] == 299
    summary = _contents.describe_recording(recording)
    assert summary["duration_s"] == pytest.approx(0.299)
    assert summary["frames"] == 300


def test_cells_for_spreadsheets():
    for text in ("=1", "+1", "-1", "@a", "\ta", "\ra"):
        assert _contents.plain_cell(text) == ("'" + text).replace("\r", "\n")
    assert _contents.plain_cell("a=1") == "a=1"
    made = [
        Column("a", "s", np.array([0.1, np.nan])),
        Column("b", "", np.array(["=x", "y"], dtype=object)),
        Column("c", "1", np.array([1, 2])),
    ]
    stream = io.BytesIO()
    _contents._csv(made, stream)
    assert stream.getvalue().decode() == "a [s],b,c\n0.1,'=x,1\n,y,2\n"
    stream = io.BytesIO()
    _contents._json(made, stream)
    assert json.loads(stream.getvalue()) == {
        "columns": {"a": [0.1, None], "b": ["=x", "y"], "c": [1, 2]},
        "units": {"a": "s", "c": "1"},
    }


def test_text_for_tracker():
    made = [
        Column("body", "", np.array(["a", "a", "b"], dtype=object)), Column("time", "s", np.array([0.0, 1.0, 0.5])),
        Column("angle", "rad", np.array([0.0, np.pi / 2, np.pi])),
    ]  # fmt: skip
    stream = io.BytesIO()
    _contents._tracker(made, stream)
    lines = [line.split("\t") for line in stream.getvalue().decode().splitlines()]
    assert lines[0] == ["", "a", "", "b", "", "origin", ""]
    assert lines[1] == ["t", "x", "y", "x", "y", "x", "y"]
    assert lines[2] == ["0.0", "1.0", "0.0", "", "", "0.0", "0.0"]
    assert [float(v) for v in lines[3] if v] == pytest.approx([0.5, -1, 0, 0, 0], abs=1e-12)
    assert [float(v) for v in lines[4] if v] == pytest.approx([1, 0, 1, 0, 0], abs=1e-12)
    with pytest.raises(UsageError):
        _contents._tracker(made[1:], io.BytesIO())


@pytest.mark.parametrize(("off", "refused"), [(0.04, False), (0.06, True)])
def test_frames_of_a_project(off, refused):
    time = 3 + 0.5 * np.delete(np.arange(9.0), 4)
    shifted = time.copy()
    shifted[3] += 0.5 * off
    body = [("a", shifted, np.where(time == 3, np.nan, np.pi / 2))]
    if refused:
        with pytest.raises(UsageError):
            _tracker_project._document(body)
    else:
        text = _tracker_project._document(body)
        for part in ('"stepcount" type="int">9<', '"starttime" type="double">3000.0<', '"delta_t" type="double">500.0<',
                     'name="[8]"', 'name="[3]"', '"y" type="double">40.0<'):  # fmt: skip
            assert part in text
        assert (
            'name="[4]" type="object"><object class="org.opensourcephysics.cabrillo.tracker.PointMass'
            not in text
        )
    with pytest.raises(UsageError):
        _tracker_project._document([("a", time[:1], time[:1])])


# ---- files


def test_checkpoints_are_continued_only_with_equal_facts(tmp_path):
    out = tmp_path / "a.h5"
    arrays = {"x": np.arange(6, dtype="i4").reshape(2, 3), "y": np.array([1.5])}
    with CheckpointFile(out, {"film": 1}, resume=True) as file:
        assert (len(file), file.other) == (0, False)
        file.append({"k": 1}, arrays)
        file.append({"k": 2}, {})
        assert [r.facts["k"] for r in written_records(file.path)] == [1, 2]
    assert checkpoint_path(out).name == "a.h5.unfinished"
    with CheckpointFile(out, {"film": 1}, resume=True) as file:
        assert len(file) == 2
        np.testing.assert_array_equal(file.record(0).arrays["x"], arrays["x"])
        assert [r.facts for r in file.records()] == [{"k": 1}, {"k": 2}]
        file.append({"k": 3}, arrays)
        assert file.record(2).arrays["y"].tolist() == [1.5]
    for cut in (1, 5):  # a truncated record is dropped
        with file.path.open("r+b") as stream:
            stream.truncate(file.path.stat().st_size - cut)
        with CheckpointFile(out, {"film": 1}, resume=True) as file:
            assert len(file) == 2
            file.append({"k": 4}, {})
    with CheckpointFile(out, {"film": 2}, resume=True) as file:
        assert (len(file), file.other) == (0, True)
        file.append({"k": 9}, {})
    with CheckpointFile(out, {"film": 2}) as file:
        assert len(file) == 0
    assert not file.path.exists()
    with CheckpointFile(out, {"film": 2}) as file:
        file.append({}, {})
        file.restart()
        assert len(file) == 0
        file.append({}, {})
    assert file.path.exists()
    with pytest.raises(UsageError), CheckpointFile(out, {"film": 2}, resume=True) as file:
        raise UsageError("a")
    assert not file.path.exists()
    with suppress(OutputError), CheckpointFile(out, {"film": 2}) as file:
        file.append({}, {})
        raise OutputError("a")
    assert file.path.exists()


def test_records_with_a_wrong_checksum_or_type_are_dropped(tmp_path):
    out = tmp_path / "a"
    with CheckpointFile(out, {"a": 1}) as file:
        for k in range(3):
            file.append({"k": k}, {"x": np.arange(3.0)})
    content = bytearray(file.path.read_bytes())
    content[-30] ^= 1
    file.path.write_bytes(content)
    assert [r.facts["k"] for r in written_records(file.path)] == [0, 1]
    with CheckpointFile(out, {"a": 1}, resume=True) as file:
        assert len(file) == 2
    manifest = json.dumps({"facts": {}, "arrays": [["x", "<c16", [1]]]}).encode()
    body = struct.pack("<I", len(manifest)) + manifest + b"\0" * 16
    with file.path.open("ab") as stream:
        stream.write(struct.pack("<QI", len(body), zlib.crc32(body)) + body)
    assert len(written_records(file.path)) in (0, 2)
    with CheckpointFile(out, {"a": 1}, resume=True) as file:
        assert len(file) == 2
    assert written_records(tmp_path / "none") == []


def test_outputs_of_a_failed_command_are_removed(tmp_path):
    a, b, old = tmp_path / "a", tmp_path / "b", tmp_path / "old"
    old.write_text("old")
    with pytest.raises(UsageError, match="two outputs"), new_outputs(a, tmp_path / "." / "a", force=False):
        pass
    with pytest.raises(OutputError, match="exists"), new_outputs(a, old, force=False):
        pass
    with pytest.raises(OutputError, match="input"), new_outputs(a, old, force=True, reads=[None, old]):
        pass
    with suppress(KeyError), new_outputs(a, None, b, old, force=True):
        with new_file(a) as stream:
            stream.write(b"1")
        raise KeyError
    assert not a.exists()
    assert old.exists()
    with new_outputs(a, b, force=False), new_file(a) as stream:
        stream.write(b"1")
    assert a.read_bytes() == b"1"
    with pytest.raises(KeyError), new_outputs(a, force=True):
        raise KeyError
    assert a.exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "old"]


def test_existing_files_are_refused(tmp_path):
    new, old, link = tmp_path / "new", tmp_path / "old", tmp_path / "link"
    old.write_text("1")
    refuse_existing(new, force=False)
    refuse_existing(old, force=True)
    refuse_existing(new, force=False, reads=[old, None, tmp_path / "none"])
    link.symlink_to(tmp_path / "nothing")
    for path, options in (
        (old, {"force": False}),
        (link, {"force": False}),
        (tmp_path / "x" / "y", {"force": True}),
    ):
        with pytest.raises(OutputError):
            refuse_existing(path, **options)


def test_marks_end_with_the_outermost_command():
    mark = SimpleNamespace(calls=[])
    mark.discard, mark.close = (lambda: mark.calls.append("discard")), (lambda: mark.calls.append("close"))
    assert marks() is None
    with marking() as outer:
        with marking() as inner:
            assert inner is outer
            inner["a"] = mark
        assert mark.calls == []
        assert unmarked(marks)() is None
        assert marks() is outer
    assert mark.calls == ["discard", "close"]
    assert marks() is None


def test_writes_continue_in_memory_after_an_error():
    class Disk(io.BytesIO):
        full = False

        def write(self, data):
            if self.full:
                raise OSError(28, "full")
            return super().write(bytes(data)[:3])

        def truncate(self, size=None):
            if self.full:
                raise OSError(28, "full")
            return super().truncate(size)

    disk = Disk()
    buffer = WriteBuffer(disk)
    assert buffer.write(b"abcdefgh") == 8
    assert (disk.getvalue(), buffer.error) == (b"abcdefgh", None)
    buffer.seek(2)
    disk.full = True
    assert buffer.write(b"XYZ") == 3
    assert buffer.error.errno == 28
    assert buffer.tell() == 5
    buffer.seek(0)
    assert buffer.read() == b"abXYZfgh"
    assert buffer.truncate(4) == 4
    assert disk.getvalue() == b"abcdefgh"


def test_covariance_of_a_clock(monkeypatch):
    placement = SimpleNamespace(
        clock_offset=1.0, clock_offset_sigma=0.2, clock_rate=1.5, clock_rate_sigma=0.4
    )
    made = {}
    monkeypatch.setattr(
        "gyrotrack.io._bodies.write_table",
        lambda group, table, clock, covariance: made.update({group: (clock, covariance)}),
    )
    file = SimpleNamespace(create_group=lambda name: name)
    known = {"b": [[4.0, 1.0, 9.0], [1.0, 1.0, 9.0], [9.0, 9.0, 9.0]]}
    _bodies._write_clocks(
        file, SimpleNamespace(placements={"a": placement, "b": placement}, extra={"sync_covariance": known})
    )
    np.testing.assert_allclose(made["clock/a"][1], np.diag([0.04, 0.16]))
    np.testing.assert_allclose(made["clock/b"][1], [[0.04, 0.04], [0.04, 0.16]])
    assert (made["clock/a"][0].offset, made["clock/a"][0].rate) == (1.0, 1.5)


def test_texts_for_hdf5():
    assert valid("a\0b\udcff") == "a?b?"
    assert json.loads(to_json({"a": np.arange(2), "b": (1, np.float64(2.5))})) == {
        "a": [0, 1],
        "b": [1, 2.5],
    }


# ---- columns in files


def test_large_columns_are_stored_in_a_file():
    kinds = {"a": ((3,), "f8"), "b": ((), "i2")}
    least = _column_store.LEAST_BYTES
    rows = least // 24
    before = len(_column_store._files)
    large = _column_store.new_columns(rows, kinds)
    assert len(_column_store._files) == before + 1
    large["a"][...], large["b"][...] = 1.5, 7
    _column_store.release_pages()
    assert (large["a"] == 1.5).all()
    assert (large["b"] == 7).all()
    assert large["a"].shape == (rows, 3)
    assert large["b"].ctypes.data % 64 == 0
    small = _column_store.new_columns(rows // 2, kinds)
    assert len(_column_store._files) == before + 1
    assert small["a"].shape == (rows // 2, 3)
    exact = _column_store.new_columns(least // 8, {"a": ((), "f8")})
    assert len(_column_store._files) == before + 2
    assert exact["a"].nbytes == least
    copied = _column_store.in_file({"a": np.arange(4.0), "b": np.ones((4, 2))})
    assert copied["a"].tolist() == [0, 1, 2, 3]
    assert _column_store.in_file({}) == {}


def test_blocks_of_rows(monkeypatch):
    released = []
    monkeypatch.setattr(_column_store, "release_pages", lambda: released.append(1))
    blocks = list(_column_store.row_blocks(4096 * 16 + 5))
    assert [(b.start, b.stop) for b in blocks[:2]] == [(0, 4096), (4096, 8192)]
    assert (len(blocks), blocks[-1].stop, len(released)) == (17, 65541, 2)


def test_pictures_in_a_file(monkeypatch):
    pictures = [np.full((2, 3), k, np.uint8) for k in range(5)]
    stored = _column_store.StoredPictures.of(4, pictures)
    assert len(stored) == 4
    assert [int(stored[k][0, 0]) for k in range(4)] == [0, 1, 2, 3]
    assert [int(p[0, 0]) for p in stored[1:3]] == [1, 2]
    assert [int(p[0, 0]) for p in stored.at([3, 0])] == [3, 0]
    assert len(_column_store.StoredPictures.of(9, pictures)) == 5
    assert len(_column_store.StoredPictures.of(3, [])) == 0
    released = []
    monkeypatch.setattr(_column_store, "release_pages", lambda: released.append(1))
    monkeypatch.setattr(_column_store, "_LEAST_READ", 12)
    stored = stored[:]
    for _ in range(7):
        assert int(stored[1][0, 0]) == 1
    assert len(released) == 2


# ---- TOML

TOML = """a = 1
[run]
b.c = 2
"quoted key" = 3
[[clip]]
file = "x"
[[clip.part]]
n = 1
[[clip]]
file = "y"   # note
[[clip.part]]
n = 2
[[clip.part]]
n = 3
"""


@pytest.mark.parametrize(
    ("location", "line"),
    [
        (("a",), 1), (("run",), 2), (("run", "b", "c"), 3), (("run", "quoted key"), 4), (("run", "zz"), 2),
        (("clip", 0), 5),
        (("clip", 0, "file"), 6), (("clip", 1, "file"), 10), (("clip", 0, "part", 0, "n"), 8),
        (("clip", 1, "part", 0, "n"), 12),
        (("clip", 1, "part", 1, "n"), 14), (("clip", 1, "zz"), 9), (("zz",), None), ((), None), (("a", 3), 1),
    ],
)  # fmt: skip
def test_lines_of_keys(location, line):
    assert line_of(TOML, location) == line


class Settings(BaseModel, extra="forbid"):
    a: int = 0
    clip: list[dict[str, int]] = []


def test_documents_are_checked(tmp_path):
    path = tmp_path / "a.toml"

    def read(text):
        path.write_text(text)
        return read_document(path, Settings, what="study")

    assert read("a = 3\n").a == 3
    with pytest.raises(ConfigurationError, match="line 2, b: extra"):
        read("a = 3\nb = 1\n")
    with pytest.raises(ConfigurationError, match=r"line 1, clip\[2\]\.x: "):
        read('clip = [{x = 1}, {x = "z"}]\n')
    with pytest.raises(ConfigurationError, match="not valid TOML"):
        read("a = \n")
    text = "".join(f"k{n} = 1\n" for n in range(8))
    with pytest.raises(ConfigurationError) as error:
        read(text)
    assert "more" not in str(error.value)
    with pytest.raises(ConfigurationError, match="and 2 more"):
        read(text + "k8 = 1\nk9 = 1\n")
    for content, match in ((b"#" * (2**20 + 1), "too large"), (b"\xff\xfe", "cannot be read")):
        path.write_bytes(content)
        with pytest.raises(ConfigurationError, match=match):
            read_document(path, Settings, what="study")
    path.write_bytes(b"#" * 2**20)
    assert read_document(path, Settings, what="study").a == 0
    with pytest.raises(ConfigurationError, match="not a regular file"):
        read_document(tmp_path, Settings, what="study")
    with pytest.raises(ConfigurationError, match="no study"):
        read_document(tmp_path / "none", Settings, what="study")
