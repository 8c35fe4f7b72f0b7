"""Bodies, error modes, clocks and joints of a case in its file (layout 2)."""

import shutil
from dataclasses import replace

import h5py
import numpy as np
import pytest

from fitting import RecordError
from fitting._case_checks import defect_of_joints, is_body_name
from fitting.inference._case_file import read_record
from gyrotrack import DatasetError, ErrorMode, UsageError, read_case, write_case
from gyrotrack.io._records import Input, columns, no_series
from tests.gyrotrack.io.conftest import make_case, make_recording

COVARIANCE = np.array([[4e-6, 1e-6], [1e-6, 9e-6]])


@pytest.fixture(scope="module")
def stated():
    """A case whose bodies share the tilt of the camera."""
    case = make_case(make_recording())
    basis = np.stack([np.cos(case.casing.angle), np.sin(case.casing.angle)], axis=1)
    tilt = ErrorMode("tilt", basis, COVARIANCE, group="tilt", origin="tilt", long_name="tilt of the camera")
    own = ErrorMode("rate", case.rotor.time[:, None], np.array([[1e-8]]), origin="rate")
    extra = {"sync_covariance": {"rotor_0": [[4e-10, 1e-11, 0.0], [1e-11, 1e-12, 0.0], [0.0, 0.0, 1e-6]]}}
    return replace(
        case,
        casing=replace(case.casing, modes=(tilt,)),
        rotor=replace(case.rotor, modes=(tilt, own)),
        extra=extra,
        I_casing_u=1e-7,
    )


@pytest.fixture(scope="module")
def written(stated, tmp_path_factory):
    return write_case(tmp_path_factory.mktemp("bodies") / "case.h5", stated, command="", settings={})


@pytest.fixture
def file(written, tmp_path):
    return shutil.copy(written, tmp_path / "case.h5")


def alone(case, **changes):
    """A wheel without a moment of inertia."""
    return replace(
        case, bodies="one", body_name="wheel", per_inertia=1, rotor=no_series(), rotor_generated=None, placements={},
        **changes,
    )  # fmt: skip


def without_old_groups(path, *, roles=("casing", "rotor")):
    """Leave what layout 2 alone has."""
    with h5py.File(path, "r+") as f:
        for name in ("casing", "rotor", "rotor_generated", "recording"):
            if name in f:
                del f[name]
        for name in ("I_rotor", "I_casing", "I_casing_u", "bodies", "body_name", "per_inertia", "quantity"):
            if name in f.attrs:
                del f.attrs[name]
    return path


def test_series_are_those_of_casing_and_rotor(file, stated):
    with h5py.File(file) as f:
        for name, series in (("casing", stated.casing), ("rotor", stated.rotor)):
            fused = f[f"body/{name}/series/fused"]
            assert f["casing/time"] != f["rotor/time"]
            for column, old in (("time", "time"), ("value", "angle"), ("u", "sigma")):
                assert fused[column] == f[f"{name}/{old}"]
            assert fused.attrs["quantity"] == "angle"
            assert f[f"body/{name}"].attrs["role"] == name
            np.testing.assert_array_equal(fused["value"], series.angle)
        assert f["body/rotor/series/fused/segment"] == f["rotor/window"]
        assert "segment" not in f["body/casing/series/fused"]
        assert f["body/casing"].attrs["inertia"] == 2.06e-5
        assert f["body/casing"].attrs["inertia_u"] == 1e-7
        assert f["body/rotor"].attrs["inertia"] == 5.54e-5
        assert "inertia_u" not in f["body/rotor"].attrs


def test_joints_connect_the_bodies(file):
    with h5py.File(file) as f:
        joints = {n: (list(g.attrs["bodies"]), g.attrs["kind"]) for n, g in f["joint"].items()}
    assert joints == {
        "bearing": (["rotor", "casing"], "bearing"),
        "touchpoint": (["casing", "ground"], "contact"),
    }


def test_a_clock_has_the_covariance_of_offset_and_rate(file):
    """The variances are those of the placement, the correlation that of the synchronisation."""
    with h5py.File(file) as f:
        clock = f["clock/rotor_0"]
        assert clock.attrs["offset"] == 3.5
        assert clock.attrs["rate"] == 1.00002
        assert clock["covariance"][()] == pytest.approx(
            np.array([[1e-10, 0.5e-11], [0.5e-11, 1e-12]]), rel=1e-9
        )


def test_error_modes_come_back(file, stated):
    found = read_case(file)
    for a, b in ((found.casing, stated.casing), (found.rotor, stated.rotor)):
        assert {m.name for m in a.modes} == {m.name for m in b.modes}
        for mode in b.modes:
            back = next(m for m in a.modes if m.name == mode.name)
            np.testing.assert_array_equal(back.basis, mode.basis)
            np.testing.assert_array_equal(back.covariance, mode.covariance)
            assert (back.group, back.origin, back.long_name) == (mode.group, mode.origin, mode.long_name)


def test_a_file_of_bodies_alone_is_read(file, stated):
    found = read_case(without_old_groups(file))
    np.testing.assert_array_equal(found.casing.angle, stated.casing.angle)
    np.testing.assert_array_equal(found.rotor.window, stated.rotor.window)
    assert (found.I_rotor, found.I_casing, found.I_casing_u) == (5.54e-5, 2.06e-5, 1e-7)
    assert (found.bodies, found.quantity, found.per_inertia) == ("two", "angle", 0)
    assert [m.name for m in found.casing.modes] == ["tilt"]
    # speeds follow from the angles: 20 rad/s
    assert np.nanmedian(found.casing.omega) == pytest.approx(20.0)
    assert found.recordings == {}
    again = read_case(write_case(file.with_name("again.h5"), found, command="", settings={}))
    assert again.casing.window is None
    np.testing.assert_array_equal(again.rotor.window, stated.rotor.window)


@pytest.mark.parametrize("quantity", ["angle", "omega"])
def test_a_single_body_has_its_name(case, tmp_path, quantity):
    path = write_case(tmp_path / "case.h5", alone(case, quantity=quantity), command="", settings={})
    with h5py.File(path) as f:
        assert list(f["body"]) == ["wheel"]
        assert f["body/wheel"].attrs["role"] == "body"
        assert "inertia" not in f["body/wheel"].attrs
        fused = f["body/wheel/series/fused"]
        assert fused.attrs["quantity"] == {"angle": "angle", "omega": "speed"}[quantity]
        assert fused["value"] == f["casing/angle" if quantity == "angle" else "casing/omega"]
        assert list(f["joint"]) == ["support"]
    found = read_case(without_old_groups(path))
    assert (found.bodies, found.body_name, found.per_inertia, found.quantity) == ("one", "wheel", 1, quantity)
    assert found.casing.omega[60] == pytest.approx(20.0)
    assert found.casing.angle[-1] - found.casing.angle[0] == pytest.approx(20 * 399 / 260)
    assert len(found.rotor.time) == 0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda f: f["body"].move("rotor", "third") or f["body/third"].attrs.modify("role", "body"),
            "of the roles",
        ),
        (
            lambda f: (
                f["body/casing/series"].copy("fused", "left")
                or f["body/casing/series"].move("fused", "right")
            ),
            "2 series",
        ),
        (
            lambda f: f["body/casing/series/fused"].attrs.modify("quantity", "counts"),
            "of the quantity 'counts'",
        ),
        (lambda f: f["body/rotor"].attrs.__delitem__("inertia"), "an inertia is missing"),
        (lambda f: f["body/rotor"].attrs.modify("inertia", -1.0), "is -1, not positive"),
        (lambda f: f["body/rotor/series/fused"].attrs.modify("quantity", "speed"), "speeds of one body"),
        (lambda f: f["body"].copy("rotor", "third"), "of the roles"),
        (lambda f: f["body/casing/series/fused/error/tilt"].__delitem__("covariance"), "lacks 'covariance'"),
    ],
)
def test_bodies_that_do_not_fit_are_refused(file, change, words):
    with h5py.File(without_old_groups(file), "r+") as f:
        change(f)
    with pytest.raises(DatasetError) as caught:
        read_case(file)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"I_rotor": -1.0}, "inertia of the rotor is -1, not positive"),
        ({"I_casing": 0.0}, "inertia of the casing is 0, not positive"),
        ({"I_casing": np.inf}, "the attribute 'I_casing' is inf, not a finite number"),
        ({"per_inertia": 1}, "an inertia is missing"),
        ({"I_rotor": np.nan}, "the attribute 'I_rotor' is missing"),
        ({"I_rotor_u": -1e-7}, "uncertainty of the moment of inertia of the rotor is -1e-07"),
        ({"I_casing_u": np.inf}, "uncertainty of the moment of inertia of the casing is inf"),
        ({"I_casing": np.nan}, "the attribute 'I_casing' is nan, not a finite number"),
        ({"bodies": "three"}, "'bodies' is 'three'"),
        ({"quantity": "counts"}, "'quantity' is 'counts'"),
    ],
)
def test_attributes_that_do_not_fit_are_refused_by_both_packages(file, change, words):
    with h5py.File(file, "r+") as f:
        f.attrs.update(change)
    for read, error in ((read_case, DatasetError), (read_record, RecordError)):
        with pytest.raises(error) as caught:
            read(file)
        assert words in caught.value.message


@pytest.mark.parametrize(
    ("asymmetry", "words"), [(0.95e-9, ""), (1.05e-9, "tilt: its covariance is not symmetric")]
)
def test_a_covariance_in_a_file_is_symmetric_but_for_rounding(file, asymmetry, words):
    with h5py.File(file, "r+") as f:
        # relative to the correlation, sigmas of 2e-3 and 3e-3
        tilt = f["body/casing/series/fused/error/tilt"]
        tilt["covariance"][0, 1] += 6e-6 * asymmetry
        tilt.attrs["group"] = "own"
    for read, error in ((read_case, DatasetError), (read_record, RecordError)):
        if words:
            with pytest.raises(error, match=words):
                read(file)
        else:
            read(file)


@pytest.mark.parametrize("change", [{"quantity": "counts"}, {"bodies": "three"}])
def test_values_that_cannot_be_read_again_are_not_written(case, tmp_path, change):
    with pytest.raises(UsageError, match=r"Use (angle or omega|two or one)"):
        write_case(tmp_path / "new.h5", replace(case, **change), command="", settings={})
    assert not list(tmp_path.glob("new*"))


@pytest.mark.parametrize(("segment", "words"), [(1.0, ""), (1.5, "integers"), (np.nan, "integers")])
def test_segments_may_be_whole_floating_point_numbers(file, segment, words):
    """MATLAB writes integers as floating-point numbers."""
    with h5py.File(without_old_groups(file), "r+") as f:
        fused = f["body/rotor/series/fused"]
        del fused["segment"]
        fused["segment"] = np.repeat([0.0, segment], 200)
    if words:
        with pytest.raises(DatasetError, match=words):
            read_case(file)
    else:
        assert read_case(file).rotor.window.tolist() == [0] * 200 + [1] * 200


def test_errors_are_exported_with_their_uncertainty(stated):
    table = {c.name: c for c in columns(stated, "errors")}
    n = len(stated.casing.time)
    assert table["mode"].values.tolist() == ["tilt"] * 2 * n + ["rate"] * n
    assert table["u"].unit == "rad"
    basis = stated.casing.modes[0].basis
    expected = [np.sqrt(b @ COVARIANCE @ b) for b in basis]
    assert table["u"].values[:n] == pytest.approx(np.array(expected))
    assert table["u"].values[2 * n :] == pytest.approx(1e-4 * stated.rotor.time)
    speeds = {c.name: c for c in columns(replace(stated, quantity="omega"), "errors")}
    assert speeds["u"].unit == "rad s-1"


def test_a_case_without_errors_has_no_such_table(case):
    with pytest.raises(UsageError, match="no table 'errors'"):
        columns(case, "errors")


def test_inputs_stay(case, tmp_path):
    current = Input("current", case.casing.time, case.casing.time, np.full(400, np.nan), "A")
    path = write_case(tmp_path / "c.h5", alone(case, inputs=(current,)), command="", settings={})
    assert read_case(without_old_groups(path)).inputs[0].unit == "A"


def test_segments_in_any_order_keep_their_errors_and_numbers(file, stated):
    with h5py.File(without_old_groups(file), "r+") as f:
        f["body/rotor/series/fused/segment"][...] = np.repeat([5, 3], 200)
    found = read_case(file).rotor
    assert np.unique(found.window).tolist() == [3, 5]
    rate = next(m for m in found.modes if m.name == "rate")
    np.testing.assert_array_equal(rate.basis[:, 0], found.time)


def test_a_segment_of_one_speed_is_read(case, tmp_path):
    path = write_case(tmp_path / "c.h5", replace(case, quantity="omega"), command="", settings={})
    with h5py.File(without_old_groups(path), "r+") as f:
        f["body/rotor/series/fused/segment"][...] = np.repeat([0, 1], [399, 1])
    assert read_case(path).rotor.window.tolist().count(1) == 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"basis": np.ones((5, 2))}, "for 400 samples"),
        ({"basis": np.ones(400)}, "for 400 samples"),
        ({"covariance": np.array([[1.0, 0.5], [0.4, 1.0]])}, "not symmetric"),
        ({"covariance": np.full((2, 2), np.nan)}, "covariance has values that are not finite"),
        ({"covariance": -COVARIANCE}, "negative variance"),
        ({"basis": np.full((400, 2), np.nan)}, "basis has values that are not finite"),
        ({"basis": np.ones((400, 401)), "covariance": np.eye(401)}, "401 amplitudes; at most 400"),
        ({"basis": np.ones((400, 0)), "covariance": np.ones((0, 0))}, r"shape \(400, 0\)"),
        ({"name": "a/b"}, "no unique name"),
    ],
)
def test_modes_that_cannot_be_read_again_are_not_written(stated, tmp_path, change, words):
    mode = replace(stated.casing.modes[0], **change)
    case = replace(stated, casing=replace(stated.casing, modes=(mode,)))
    with pytest.raises(UsageError, match=words):
        write_case(tmp_path / "new.h5", case, command="", settings={})
    assert not list(tmp_path.glob("new*"))


@pytest.mark.parametrize(("lost", "refused"), [("angle", False), (None, True)])
def test_a_mode_is_finite_where_its_series_is_measured(stated, tmp_path, lost, refused):
    mode, angle = stated.casing.modes[0], stated.casing.angle.copy()
    basis = mode.basis.copy()
    basis[3] = np.nan
    if lost:
        angle[3] = np.nan
    series = replace(stated.casing, angle=angle, modes=(replace(mode, basis=basis),))
    case = replace(stated, casing=series)
    if refused:
        with pytest.raises(UsageError, match="not finite"):
            write_case(tmp_path / "new.h5", case, command="", settings={})
    else:
        path = write_case(tmp_path / "new.h5", case, command="", settings={})
        np.testing.assert_array_equal(read_case(path).casing.modes[0].basis, basis)


def test_two_modes_of_one_name_are_refused(stated, tmp_path):
    case = replace(stated, casing=replace(stated.casing, modes=stated.casing.modes * 2))
    with pytest.raises(UsageError, match="no unique name"):
        write_case(tmp_path / "new.h5", case, command="", settings={})


@pytest.mark.slow
def test_the_number_of_modes_is_limited(stated, tmp_path):
    modes = tuple(replace(stated.casing.modes[0], name=f"m{i}", group="") for i in range(64))
    case = replace(stated, casing=replace(stated.casing, modes=modes))
    path = write_case(tmp_path / "many.h5", case, command="", settings={})
    # two in two windows
    assert len(read_case(path).casing.modes) == len(read_record(path).modes) - 4 == 64
    with h5py.File(path, "r+") as f:
        f["body/casing/series/fused/error"].copy("m63", "m64")
    with pytest.raises(DatasetError, match="at most 64"):
        read_case(path)
    with pytest.raises(RecordError, match="at most 64"):
        read_record(path)


def test_errors_that_tracking_states_are_listed(recording, case):
    """The amplitudes of cosine and sine of n orders add up to sqrt(n) times their standard deviation."""
    stated = {
        "correlated_sigma": 1e-4,
        "correlated_time": 2.0,
        "correlated_profile": ((0.0, 3e-4), (1.0, 1e-4)),
        "periodic_sigma": 2e-4,
        "harmonic_sigma": 1e-5,
    }
    listed = {}
    whole = replace(case, casing=replace(case.casing, **stated))
    bodies = {"casing": replace(recording.bodies["casing"], **stated)}
    for content in (whole, replace(recording, bodies=bodies)):
        table = {c.name: c.values for c in columns(content, "errors")}
        assert set(table["origin"]) == {"tracking"}
        listed = {m: table["mode"] == m for m in ("zero", "periodic", "harmonic")}
        time = table["time"][listed["zero"]]
        expected = np.interp(time, [0.0, 1.0], [3e-4, 1e-4])
        assert table["u"][listed["zero"]] == pytest.approx(expected)
        assert table["u"][listed["periodic"]] == pytest.approx(np.sqrt(2) * 2e-4)
        assert table["u"][listed["harmonic"]] == pytest.approx(np.sqrt(12) * 1e-5)
    constant = replace(case, casing=replace(case.casing, correlated_sigma=1e-4, correlated_time=2.0))
    table = {c.name: c.values for c in columns(constant, "errors")}
    assert set(table["mode"]) == {"zero"}
    assert table["u"] == pytest.approx(1e-4)


@pytest.mark.parametrize("name", ["ground", "rotor", "bearing", "touchpoint", "1st", "a-b", "w" * 42])
def test_a_body_has_no_name_with_another_meaning(name):
    assert not is_body_name(name)
    for names, joints in (
        ([name, "wheel"], {"belt": (name, "wheel")}),
        (["a", "wheel"], {name: ("a", "wheel")}),
    ):
        assert defect_of_joints(names, joints).what.startswith(f"{name[:40]!r} cannot be the name")
    assert is_body_name("wheel")
    assert defect_of_joints(["a", "wheel"], {"belt": ("a", "wheel")}) is None
