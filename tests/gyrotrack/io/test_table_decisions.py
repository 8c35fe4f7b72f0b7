"""How tables, attributes and projects are stored: chunks, scales, units and positions, and a disk that fails."""

import io
import math
import re
from dataclasses import replace
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from fitting._case_format import INDICES, Attribute, Field, Table
from gyrotrack import ErrorMode, UsageError, write_case
from gyrotrack.io import _bodies as bodies
from gyrotrack.io._hdf5 import WriteBuffer
from gyrotrack.io._records import no_series
from gyrotrack.io._tables import create_dataset, to_json, valid, write_attributes, write_table
from gyrotrack.io._tracker_project import write_project


@pytest.fixture
def file():
    with h5py.File("memory", "w", driver="core", backing_store=False) as opened:
        yield opened


@pytest.mark.parametrize(
    ("shape", "chunks"),
    [
        ((8191,), (8191,)),
        ((8192,), (8192,)),
        ((9000,), (8192,)),
        ((3, 2), (3, 2)),
        ((9000, 2, 2), (8192, 2, 2)),
        ((0,), (1,)),
        ((0, 2), (1, 2)),
    ],
)
def test_datasets_have_chunks_of_at_most_8192_rows(file, shape, chunks):
    found = create_dataset(file, "x", np.arange(np.prod(shape), dtype=float).reshape(shape))
    assert found.chunks == chunks
    assert found.maxshape == (shape if np.prod(shape) else (None, *shape[1:]))
    assert (found.compression, found.shuffle, found.fletcher32) == ("gzip", True, True)
    assert found.shape == shape


def field_of(name, dims, units="m", **attributes):
    return Field(name, dims, units, f"long {name}", **attributes)


def test_a_table_has_scales_units_and_the_axes_of_its_signal(file):
    table = Table(
        (field_of("time", ("time",), "s"), field_of("value", ("time",)), field_of("u", ("time",))),
        signal="value",
    )
    group = file.create_group("g")
    record = SimpleNamespace(time=np.arange(4.0), value=np.ones(4))
    write_table(group, table, record, u=np.full(4, 2.0))
    assert group["u"][:].tolist() == [2.0] * 4
    assert [group[n].attrs["units"] for n in ("time", "value")] == ["s", "m"]
    assert group["value"].attrs["long_name"] == "long value"
    assert (group.attrs["NX_class"], group.attrs["signal"]) == ("NXdata", "value")
    assert list(group.attrs["axes"]) == ["time"]
    assert group["time"].is_scale
    assert not group["value"].is_scale
    for name in ("value", "u"):
        assert group[name].dims[0][0] == group["time"]
    assert len(group["time"].dims[0]) == 0


def test_a_dimension_without_a_column_has_an_index(file):
    index = next(iter(INDICES))
    table = Table((field_of("x", (index, f"other_{index}")), field_of("y", ("time", index))))
    group, clock = file.create_group("g"), file.create_group("clock")
    time = create_dataset(clock, "time", np.arange(3.0))
    time.make_scale("time")
    write_table(group, table, SimpleNamespace(x=np.zeros((2, 2)), y=np.zeros((3, 2))), {"time": time})
    assert group[index][:].tolist() == [0, 1]
    assert group[f"other_{index}"][:].tolist() == [0, 1]
    assert group[index].attrs["units"] == "1"
    assert group[f"other_{index}"].attrs["long_name"] == INDICES[index]
    assert group[index].is_scale
    assert group["y"].dims[0][0] == time
    assert group["y"].dims[1][0] == group[index]
    assert group["x"].dims[1][0] == group[f"other_{index}"]
    assert "time" not in group
    assert "signal" not in group.attrs


@pytest.mark.parametrize(
    ("value", "default", "written"),
    [(2.0, math.nan, True), (math.nan, math.nan, False), (math.inf, math.nan, True), (math.inf, 1.0, None)],
)
def test_attributes_are_finite_unless_they_may_be_unknown(file, value, default, written):
    one = Attribute("mass", float, "kg", "a mass", default=default)
    record = SimpleNamespace(mass=value)
    if written is None:
        with pytest.raises(UsageError, match="not a finite number"):
            write_attributes(file, (one,), record)
        return
    write_attributes(file, (one,), record)
    assert ("mass" in file.attrs) == written
    assert (file.attrs.get("mass_units") == "kg") == written


def test_a_text_that_hdf5_cannot_store_is_changed():
    assert valid("a\0b") == "a?b"
    assert valid("é\ud800") == "é?"
    assert to_json({"a": np.arange(2), "b": np.float64(0.5)}) == '{"a": [0, 1], "b": 0.5}'


class Disk(io.BytesIO):
    """Accepts some bytes at a time and fails beyond a size."""

    def __init__(self, content, size, at_once):
        super().__init__(content)
        self.size, self.at_once = size, at_once

    def write(self, data):
        if self.tell() + len(data[: self.at_once]) > self.size:
            raise OSError("full")
        return super().write(bytes(data[: self.at_once]))


@pytest.mark.parametrize(("size", "at_once"), [(100, 100), (100, 2), (8, 100), (8, 2), (0, 1)])
def test_a_write_is_complete_on_a_disk_and_in_memory(size, at_once):
    buffer = WriteBuffer(Disk(b"01234", size, at_once))
    assert buffer.seek(2) == 2
    assert buffer.write(b"abcdef") == 6
    assert buffer.write(b"gh") == 2
    assert buffer.tell() == 10
    assert buffer.seek(-3, 2) == 7
    assert buffer.read(2) == b"fg"
    assert buffer.seek(-4, 1) == 5
    assert buffer.read() == b"defgh"
    assert buffer.seek(0) == 0
    assert buffer.read() == b"01abcdefgh"
    assert (buffer.error is None) == (size == 100)
    assert buffer.truncate(4) == 4
    buffer.seek(0)
    assert buffer.read() == b"01ab"


@pytest.mark.parametrize(("bodies_", "quantity"), [("two", "omega"), ("one", "angle")])
def test_an_angle_that_is_an_integral_is_marked(case, tmp_path, bodies_, quantity):
    one = bodies_ == "one"
    some = replace(case, quantity=quantity)
    if one:
        some = replace(
            some, bodies="one", rotor=no_series(), rotor_generated=None, placements={}, recordings={}
        )
    path = write_case(tmp_path / "case.h5", some, command="", settings={})
    with h5py.File(path) as opened:
        assert opened.attrs["default"] == "casing"
        for name in ("casing", "rotor"):
            assert ("comment" in opened[f"{name}/angle"].attrs) == (quantity == "omega")
        name = next(iter(opened["body"]))
        series = opened[f"body/{name}/series/fused"]
        assert series["value"] == opened["casing/omega" if quantity == "omega" else "casing/angle"]
        assert ("segment" in opened["body/rotor/series/fused"]) if not one else True


def test_clocks_keep_the_correlation_of_the_synchronisation(case, file):
    """The variances are the stated ones."""
    placement = case.placements["rotor_0"]
    a, b = placement.clock_offset_sigma, placement.clock_rate_sigma
    for known, correlation in (([[4.0, 1.0, 7.0], [1.0, 9.0, 7.0], [7.0, 7.0, 7.0]], 1 / 6), (None, 0.0)):
        if "clock" in file:
            del file["clock"]
        extra = {} if known is None else {"sync_covariance": {"rotor_0": known}}
        bodies._write_clocks(file, replace(case, extra=extra))
        found = file["clock/rotor_0/covariance"][()]
        np.testing.assert_allclose(
            found, [[a * a, correlation * a * b], [correlation * a * b, b * b]], rtol=1e-9
        )


def test_series_of_bodies_alone_are_in_the_order_of_their_segments():
    time = np.concatenate([np.arange(40) / 100, 5.0 + np.arange(50) / 100])
    order = np.concatenate([np.arange(40, 90), np.arange(40)])
    basis = np.arange(90.0)[:, None]
    stored = SimpleNamespace(
        columns={},
        stated={"sigma_source": "given"},
        time=time[order],
        value=3.0 * time[order],
        u=np.full(90, 1e-3) + 1e-5 * order,
        segment=np.repeat([7, 2], [50, 40]),
        modes=(SimpleNamespace(**vars(ErrorMode("a", basis[order], np.eye(1)))),),
    )
    found = bodies.series_from(stored, "angle")
    assert found.time == pytest.approx(time)
    assert found.angle == pytest.approx(3.0 * time)
    assert found.sigma == pytest.approx(1e-3 + 1e-5 * np.arange(90))
    assert found.window.tolist() == [2] * 40 + [7] * 50
    assert found.modes[0].basis[:, 0].tolist() == list(range(90))
    assert found.sigma_source == "given"
    speeds = bodies.series_from(replace_of(stored, value=np.full(90, 3.0)), "omega")
    assert speeds.omega == pytest.approx(np.full(90, 3.0))
    assert np.diff(speeds.angle[:40]) == pytest.approx(np.full(39, 0.03), rel=1e-3)


def replace_of(stored, **changes):
    return SimpleNamespace(**{**vars(stored), **changes})


class TestProject:
    def text(self, *motions):
        stream = io.BytesIO()
        write_project(stream, motions)
        return stream.getvalue().decode()

    def values(self, text, name):
        return [
            float(v) for v in re.findall(rf'name="{re.escape(name)}" type="(?:double|int)">([^<]+)<', text)
        ]

    def test_a_body_is_a_point_on_a_circle_in_its_frames(self):
        """200 px about (320, 240); y is down."""
        time = 3.5 + np.array([0.0, 1.0, 2.0, 5.0]) / 50
        angle = np.array([0.0, 0.5 * np.pi, np.nan, np.pi])
        text = self.text(("wheel & <1>", time, angle), ("late", time[1:3], np.zeros(2)))
        assert self.values(text, "n") == [0, 1, 5, 1, 2]
        assert self.values(text, "x") == pytest.approx([520.0, 320.0, 120.0, 520.0, 520.0])
        assert self.values(text, "y") == pytest.approx([240.0, 40.0, 240.0, 240.0, 240.0])
        assert self.values(text, "delta_t") == pytest.approx([20.0])
        assert self.values(text, "starttime") == pytest.approx([3500.0])
        assert self.values(text, "stepcount") == [6]
        assert self.values(text, "startframe") == [0]
        assert self.values(text, "stepsize") == [1]
        assert self.values(text, "xorigin") == [320.0]
        assert self.values(text, "yorigin") == [240.0]
        assert self.values(text, "xscale") == self.values(text, "yscale") == [200.0]
        assert self.values(text, "xangle") == [0.0]
        assert self.values(text, "mass") == [1.0, 1.0]
        assert "wheel &amp; &lt;1&gt;" in text

    def test_the_interval_is_the_mean_of_the_record(self):
        """Times in units of 10 us of a film of 30 frames/s."""
        time = np.round(np.arange(900) / 30, 5)
        text = self.text(("a", time, time))
        assert self.values(text, "delta_t") == pytest.approx([1000 / 30], rel=1e-5)
        assert self.values(text, "n")[-1] == 899

    @pytest.mark.parametrize(("off", "refused"), [(0.04, False), (0.06, True), (-0.06, True)])
    def test_a_time_is_within_a_twentieth_of_the_grid(self, off, refused):
        time = np.arange(50.0)
        time[20] += off
        if refused:
            with pytest.raises(UsageError, match="needs times at equal intervals"):
                self.text(("a", time, time))
        else:
            assert len(self.values(self.text(("a", time, time)), "n")) == 50

    @pytest.mark.parametrize(("last", "refused"), [(1_000_000.0, False), (1_000_001.0, True)])
    def test_a_project_has_at_most_a_million_frames(self, last, refused):
        time = np.array([0.0, 1.0, 2.0, 3.0, last])
        if refused:
            with pytest.raises(UsageError):
                self.text(("a", time, time))
        else:
            assert self.values(self.text(("a", time, time)), "stepcount") == [1_000_001]

    def test_a_single_time_is_refused(self):
        with pytest.raises(UsageError):
            self.text(("a", np.ones(1), np.ones(1)))
