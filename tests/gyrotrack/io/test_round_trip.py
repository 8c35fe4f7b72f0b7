"""What is written is read back, and a plain HDF5 reader finds units, meanings and dimensions."""

import dataclasses
import json
import shutil
import subprocess

import h5py
import numpy as np
import pytest

from fitting.inference._case_file import read_record
from gyrotrack import DatasetError, read_case, read_recording, write_case, write_recording
from gyrotrack.io._hdf5 import read_kind
from gyrotrack.io._records import series_of
from gyrotrack.io._schema import STATUS


def assert_same(a, b, where="root"):
    if dataclasses.is_dataclass(a):
        for field in dataclasses.fields(a):
            assert_same(getattr(a, field.name), getattr(b, field.name), f"{where}.{field.name}")
    elif isinstance(a, dict):
        assert a.keys() == b.keys(), where
        for key in a:
            assert_same(a[key], b[key], f"{where}[{key}]")
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype, where
        np.testing.assert_array_equal(a, b, err_msg=where)
    else:
        assert a == b or (a != a and b != b), where


def test_recording_comes_back(tmp_path, recording):
    path = write_recording(
        tmp_path / "r.h5", recording, command="gyrotrack extract", settings={"a": np.arange(2)}
    )
    assert read_kind(path) == "recording"
    assert_same(recording, read_recording(path))


def test_case_comes_back(tmp_path, case):
    path = write_case(tmp_path / "c.h5", case, command="gyrotrack sync", settings={})
    assert read_kind(path) == "case"
    assert_same(case, read_case(path))


def test_uncertainties_of_the_inertias_reach_the_fit(tmp_path, case):
    case = dataclasses.replace(
        case, I_rotor_u=3e-7, casing=long_series(case.casing), rotor=long_series(case.rotor)
    )
    path = write_case(tmp_path / "c.h5", case, command="", settings={})
    with h5py.File(path) as file:
        assert file.attrs["I_rotor_u_units"] == "kg m2"
        assert "I_casing_u" not in file.attrs
    assert read_case(path).I_rotor_u == 3e-7
    record = read_record(path)
    assert record.I_rotor_u == 3e-7
    assert np.isnan(record.I_casing_u)


def test_the_profile_of_an_error_reaches_the_fit(tmp_path, recording, case):
    pairs = ((0.5, 2e-4), (1.5, 1e-4))
    stated = {"correlated_sigma": 1e-4, "correlated_time": 2.0, "correlated_profile": pairs}
    bodies = {k: dataclasses.replace(b, **stated) for k, b in recording.bodies.items()}
    made = dataclasses.replace(recording, bodies=bodies)
    path = write_recording(tmp_path / "r.h5", made, command="", settings={})
    assert_same(made, read_recording(path))
    assert series_of([made.bodies["casing"]]).correlated_profile == pairs
    assert series_of([made.bodies["rotor"]] * 2).correlated_profile == ()
    whole = dataclasses.replace(case, casing=dataclasses.replace(case.casing, **stated))
    path = write_case(tmp_path / "case.h5", whole, command="", settings={})
    assert_same(whole, read_case(path))
    assert read_record(path).correlated_profile == pairs
    with h5py.File(path, "r+") as file:
        for name in ("casing", "body/casing/series/fused"):
            if name in file and "correlated_profile" in file[name].attrs:
                file[name].attrs["correlated_profile"] = [1.0, 2.0]
    with pytest.raises(DatasetError, match="'correlated_profile' is not a table of pairs"):
        read_case(path)


def test_a_case_without_a_profile_has_no_such_attribute(tmp_path, case):
    with h5py.File(write_case(tmp_path / "case.h5", case, command="", settings={})) as file:
        assert "correlated_profile" not in file["casing"].attrs
    assert read_record(tmp_path / "case.h5").correlated_profile == ()


def long_series(series):
    n = 80
    columns = {"time": np.arange(n) / 100, "angle": np.arange(n) / 10, "sigma": np.full(n, 1e-3)}
    columns |= {
        "omega": np.full(n, 10.0),
        "omega_sigma": np.full(n, 0.1),
        "turn": np.zeros(n, dtype=np.int64),
    }
    window = None if series.window is None else np.zeros(n, dtype=np.int64)
    return dataclasses.replace(series, **columns, window=window)


def test_empty_body_comes_back(tmp_path, recording):
    body = recording.bodies["rotor"]
    empty = {
        f.name: getattr(body, f.name)[:0]
        for f in dataclasses.fields(body)
        if isinstance(getattr(body, f.name), np.ndarray)
    }
    bare = dataclasses.replace(recording, bodies={"rotor": dataclasses.replace(body, **empty)})
    path = write_recording(tmp_path / "r.h5", bare, command="", settings={})
    assert len(read_recording(path).bodies["rotor"].time) == 0


def test_missing_is_nan_not_zero(tmp_path, recording):
    path = write_recording(tmp_path / "r.h5", recording, command="", settings={})
    with h5py.File(path) as file:
        assert np.isnan(file["marker/red/angle"][5])


def test_every_dataset_says_what_it_is_and_is_checksummed(tmp_path, case):
    path = write_case(tmp_path / "c.h5", case, command="x", settings={})
    seen = []

    def check(name, item):
        if not isinstance(item, h5py.Dataset):
            return
        seen.append(name)
        assert item.attrs["units"], name
        assert item.attrs["long_name"], name
        assert all(len(dim) for dim in item.dims) or item.is_scale, name
        assert item.fletcher32, name
        assert item.compression == "gzip", name

    with h5py.File(path) as file:
        file.visititems(check)
        assert file["casing/omega"].attrs["units"] == "rad s-1"
        assert file["casing"].attrs["signal"] == "omega"
        status = file["recording/rotor_0/marker/red/status"]
        assert list(status.attrs["flag_values"]) == list(STATUS.values())
        assert status.attrs["flag_meanings"].split() == list(STATUS)
    assert len(seen) > 60


def test_root_tells_where_the_file_comes_from(tmp_path, recording):
    path = write_recording(
        tmp_path / "r.h5", recording, command="gyrotrack extract a.mp4", settings={"k": 0.5}
    )
    with h5py.File(path) as file:
        assert file.attrs["format"] == "gyrotrack"
        assert file.attrs["format_version"] == "2.0"
        assert file.attrs["command"] == "gyrotrack extract a.mp4"
        assert json.loads(file.attrs["settings"]) == {"k": 0.5}
        assert file.attrs["created"].endswith("+00:00")
        assert file.libver == ("v110", "v110") or file.libver[1] in {"v110", "latest", "v114", "v200"}


def test_large_settings_fit(tmp_path, recording):
    path = write_recording(tmp_path / "r.h5", recording, command="", settings={"long": "x" * 300_000})
    assert read_kind(path) == "recording"


@pytest.mark.parametrize(("reader", "wrong"), [(read_case, "recording"), (read_recording, "case")])
def test_the_other_kind_is_refused(tmp_path, recording, case, reader, wrong):
    path = tmp_path / "file.h5"
    write = {"recording": (write_recording, recording), "case": (write_case, case)}[wrong]
    write[0](path, write[1], command="", settings={})
    with pytest.raises(DatasetError, match=f"is a {wrong}, not a"):
        reader(path)


@pytest.mark.slow
def test_xarray_opens_it_with_dimensions_and_units(tmp_path, case):
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    path = write_case(tmp_path / "c.h5", case, command="", settings={})
    with xarray.open_datatree(path, engine="h5netcdf") as tree:
        assert tree["casing/omega"].dims == ("time",)
        assert tree["casing/omega"].attrs["units"] == "rad s-1"
        corner = tree["recording/rotor_0/marker/red/corner"]
        assert corner.dims == ("frame", "side", "xy")
        np.testing.assert_array_equal(tree["rotor/angle"].values, case.rotor.angle)


@pytest.mark.skipif(shutil.which("h5dump") is None, reason="the HDF5 tools are not installed")
def test_the_hdf5_tools_read_it(tmp_path, case):
    path = write_case(tmp_path / "c.h5", case, command="", settings={})
    subprocess.run(["h5dump", "-H", str(path)], check=True, capture_output=True)
