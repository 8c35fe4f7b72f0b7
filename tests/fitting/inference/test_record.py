"""Case files, written according to the layout; errors for invalid ones."""

import h5py
import numpy as np
import pytest

from fitting import RecordError, make_record
from fitting.inference._case_file import read_record

N = 700


def series(seed, start=0.0, n=N, rate=100.0):
    rng = np.random.default_rng(seed)
    time = start + np.arange(n) / rate
    angle = 30 * time + 1e-3 * rng.normal(size=n)
    return time, angle, np.full(n, 1e-3), np.full(n, 30.0) + 0.01 * rng.normal(size=n), np.full(n, 0.01)


def write_case(path, *, quantity=None, attributes=None, n=N):
    """Write a case by the layout: root attributes, /casing, /rotor with windows."""
    with h5py.File(path, "w") as file:
        file.attrs.update(
            {
                "format": "gyrotrack",
                "format_version": "1.0",
                "kind": "case",
                "I_rotor": 5.54e-5,
                "I_casing": 2.06e-5,
                "label": "case 7",
                "surface": "glass",
            }
        )
        if quantity:
            file.attrs["quantity"] = quantity
        for key, value in (attributes or {}).items():
            if value is None:
                del file.attrs[key]
            else:
                file.attrs[key] = value
        names = ("time", "angle", "sigma", "omega", "omega_sigma")
        for name, column in zip(names, series(1, n=n), strict=True):
            file.create_dataset(f"casing/{name}", data=column)
        windows = [series(2, 0.5), series(3, 3.0), series(4, 9.0, n=40)]
        for name, *columns in zip(names, *windows, strict=True):
            file.create_dataset(f"rotor/{name}", data=np.concatenate(columns))
        file.create_dataset("rotor/window", data=np.repeat([0, 2, 5], [N, N, 40]))
    return path


@pytest.fixture
def case(tmp_path):
    return write_case(tmp_path / "case.h5")


def test_a_valid_case_is_read(case):
    record = read_record(case)
    assert (record.label, record.surface, record.quantity) == ("case 7", "glass", "angle")
    assert (record.I_rotor, record.I_casing) == (5.54e-5, 2.06e-5)
    assert record.source == str(case)
    time, angle, sigma, _, _ = series(1)
    np.testing.assert_array_equal(record.casing.time, time)
    np.testing.assert_array_equal(record.casing.value, angle)
    np.testing.assert_array_equal(record.casing.sigma, sigma)
    assert [len(w) for w in record.rotor] == [N, N, 40]
    np.testing.assert_array_equal(record.rotor[1].value, series(3, 3.0)[1])
    assert record.span == (0.0, pytest.approx(9.99))


def test_speeds_are_read_where_speeds_were_measured(tmp_path):
    record = read_record(write_case(tmp_path / "speeds.h5", quantity="omega"))
    assert record.quantity == "omega"
    np.testing.assert_array_equal(record.casing.value, series(1)[3])
    np.testing.assert_array_equal(record.casing.sigma, series(1)[4])


def test_the_digest_depends_on_the_numbers_only(case, tmp_path):
    first = read_record(case)
    renamed = read_record(write_case(tmp_path / "b.h5", attributes={"label": "other", "surface": "steel"}))
    assert first.digest == renamed.digest
    with h5py.File(case, "r+") as file:
        file["casing/angle"][17] += 1e-9
    assert read_record(case).digest != first.digest
    heavier = read_record(write_case(tmp_path / "c.h5", attributes={"I_casing": 2.07e-5}))
    assert heavier.digest != first.digest


def test_the_default_label_is_the_file_name(tmp_path):
    assert read_record(write_case(tmp_path / "run3.h5", attributes={"label": ""})).label == "run3"


def refusal(path):
    with pytest.raises(RecordError) as caught:
        read_record(path)
    message = caught.value.message
    assert str(path) in message or "case" in message
    assert "\n" not in message
    assert "Traceback" not in message
    return message


@pytest.mark.parametrize(
    ("attributes", "words"),
    [
        ({"kind": "recording"}, "is a recording, not a case"),
        ({"kind": None}, "lacks the attribute 'kind'"),
        ({"format": "nexus"}, "was not written by gyrotrack"),
        ({"format": None}, "was not written by gyrotrack"),
        ({"format_version": "3.0"}, "has the layout 3.0; the newest supported layout is 2.0"),
        ({"format_version": "new"}, "no valid format version ('new')"),
        ({"I_rotor": -1.0}, "not positive"),
        ({"I_rotor": np.nan}, "the attribute 'I_rotor' is missing"),
        ({"I_casing": 0.0}, "not positive"),
        ({"I_casing": None}, "lacks the attribute 'I_casing'"),
        ({"I_casing": "heavy"}, "'I_casing' is not a number"),
        ({"I_casing": [1.0, 2.0]}, "'I_casing' is not a number"),
    ],
)
def test_wrong_attributes_are_refused(tmp_path, attributes, words):
    assert words in refusal(write_case(tmp_path / "case.h5", attributes=attributes))


def test_minor_versions_are_read(tmp_path):
    assert (
        read_record(write_case(tmp_path / "case.h5", attributes={"format_version": "1.7"})).label == "case 7"
    )


def test_other_files_are_refused_as_cases(tmp_path):
    assert "does not exist" in refusal(tmp_path / "nothing.h5")
    assert "not a regular file" in refusal(tmp_path)
    text = tmp_path / "text.h5"
    text.write_text("t,angle\n0,1\n", encoding="utf-8")
    assert "not an HDF5 file" in refusal(text)
    empty = tmp_path / "empty.h5"
    empty.touch()
    assert "is empty" in refusal(empty)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.999])
def test_truncated_files_are_refused(case, share):
    data = case.read_bytes()
    case.write_bytes(data[: int(share * len(data))])
    refusal(case)


def test_no_damaged_byte_crashes_the_reader(case):
    """Every outcome but a record or a sentence would be a traceback for the user."""
    data, rng = case.read_bytes(), np.random.default_rng(0)
    refused = 0
    for _ in range(60):
        damaged = bytearray(data)
        for place in rng.integers(0, min(len(data), 6000), 6):
            damaged[place] = rng.integers(256)
        case.write_bytes(bytes(damaged))
        try:
            read_record(case)
        except RecordError:
            refused += 1
    assert refused > 10


def replace(path, name, make):
    with h5py.File(path, "r+") as file:
        del file[name]
        make(file)
    return path


@pytest.mark.parametrize("name", ["casing", "casing/angle", "casing/time", "rotor/sigma", "rotor/window"])
def test_missing_parts_are_named(case, name):
    assert f"lacks '{name.rpartition('/')[2]}'" in refusal(replace(case, name, lambda file: None))


@pytest.mark.parametrize("name", ["casing", "casing/angle", "rotor"])
@pytest.mark.parametrize("kind", ["external", "soft"])
def test_links_are_not_followed(case, tmp_path, name, kind):
    other = write_case(tmp_path / "other.h5")
    link = h5py.ExternalLink(str(other), f"/{name}") if kind == "external" else h5py.SoftLink("/rotor/time")
    message = refusal(replace(case, name, lambda file: file.__setitem__(name, link)))
    assert f"has a link, '{name.rpartition('/')[2]}'" in message


def test_external_data_are_not_read(case, tmp_path):
    raw = tmp_path / "raw.bin"
    raw.write_bytes(np.arange(N, dtype=float).tobytes())

    def outside(file):
        file.create_dataset("casing/angle", (N,), dtype=float, external=[(str(raw), 0, 8 * N)])

    assert "casing/angle stores its data in another file" in refusal(replace(case, "casing/angle", outside))

    def virtual(file):
        layout = h5py.VirtualLayout((N,), dtype=float)
        layout[:] = h5py.VirtualSource(str(raw), "angle", shape=(N,))
        file.create_virtual_dataset("casing/angle", layout)

    assert "stores its data in another file" in refusal(replace(case, "casing/angle", virtual))


@pytest.mark.parametrize(
    "make",
    [
        lambda file: file.create_group("casing/angle"),
        lambda file: file.create_dataset("casing/angle", data=np.zeros((N, 2))),
        lambda file: file.create_dataset("casing/angle", data=3.0),
        lambda file: file.create_dataset("casing/angle", data=["x"] * N),
        lambda file: file.create_dataset("casing/angle", data=np.zeros(N, dtype=[("a", float)])),
        lambda file: file.create_dataset("casing/angle", data=np.zeros(N - 5)),
        lambda file: file.create_dataset("casing/angle", (10**12,), dtype=float, chunks=(1000,)),
        lambda file: file.create_dataset("casing/angle", data=np.zeros(N, dtype=complex)),
        lambda file: file.create_dataset("casing/angle", dtype=float, shape=None),
    ],
    ids=["group", "table", "number", "text", "compound", "shorter", "a million million", "complex", "empty"],
)
def test_columns_of_another_shape_are_refused(case, make):
    refusal(replace(case, "casing/angle", make))


def test_windows_that_do_not_match_the_samples_are_refused(case):
    short = replace(case, "rotor/window", lambda file: file.create_dataset("rotor/window", data=np.zeros(N)))
    assert "rotor/window has the shape (700,), not (1440,)" in refusal(short)


def test_too_few_samples_are_refused(tmp_path):
    assert "the casing has 23 usable samples" in refusal(write_case(tmp_path / "short.h5", n=23))
    path = write_case(tmp_path / "case.h5")
    with h5py.File(path, "r+") as file:
        file["rotor/angle"][:] = np.nan
    assert "no rotor window with at least 8 usable samples" in refusal(path)


def test_a_rotor_without_samples_is_refused(tmp_path):
    path = write_case(tmp_path / "case.h5")
    with h5py.File(path, "r+") as file:
        for name in list(file["rotor"]):
            del file[f"rotor/{name}"]
            file.create_dataset(f"rotor/{name}", shape=(0,), dtype=int if name == "window" else float)
    assert "no rotor window with at least 8 usable samples" in refusal(path)


@pytest.mark.parametrize(("rows", "refused"), [(49, False), (50, True)])
def test_the_number_of_rows_is_limited(tmp_path, monkeypatch, rows, refused):
    monkeypatch.setattr("fitting._dataset._MOST_ROWS", 49)
    message = refusal(write_case(tmp_path / "case.h5", n=rows))
    assert ("has 50 rows; at most 49 are read" in message) == refused


def arrays(n=100):
    time = np.arange(n) / 10
    return time, 3 * time, np.full(n, 1e-3)


def made(casing=None, rotor=None, **more):
    return make_record(
        casing=casing or arrays(), rotor=rotor or [arrays(20)], I_rotor=1e-5, I_casing=2e-5, **more
    )


def test_missing_values_are_left_out():
    time, value, sigma = arrays()
    value[[3, 50]] = np.nan
    time = time.copy()
    time[7] = np.inf
    record = made((time, value, sigma))
    assert len(record.casing) == 97
    assert np.isfinite(record.casing.value).all()


def test_unknown_uncertainties_take_the_usual_one():
    time, value, sigma = arrays()
    sigma[:] = 2e-3
    sigma[[1, 2, 3]] = np.nan, 0.0, -1.0
    assert (made((time, value, sigma)).casing.sigma == 2e-3).all()
    assert np.isfinite(made((time, value, np.full(100, np.nan))).casing.sigma).all()


@pytest.mark.parametrize("what", ["casing", "rotor"])
def test_times_that_are_not_increasing_are_refused(what):
    time, value, sigma = arrays()
    time = time.copy()
    time[40] = time[39]
    with pytest.raises(RecordError, match=f"times of the {what} are not strictly increasing"):
        made(**{what: (time, value, sigma) if what == "casing" else [(time, value, sigma)]})


def test_windows_too_short_to_use_are_left_out():
    assert len(made(rotor=[arrays(7), arrays(8), arrays(30)]).rotor) == 2
    with pytest.raises(RecordError, match="no rotor window"):
        made(rotor=[arrays(7)])


def test_a_single_measured_speed_is_a_window():
    assert len(made(rotor=[arrays(1), arrays(30)], quantity="omega").rotor) == 2
    with pytest.raises(RecordError, match="no rotor window"):
        made(rotor=[arrays(0)], quantity="omega")
