"""What a case file may contain: the same checks when it is written, read, described and fitted."""

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from fitting import RecordError
from fitting import _case_format as layout
from fitting._case_checks import defect_of_clock
from fitting._stored_case import read_stored_case
from fitting.inference._case_file import read_record
from gyrotrack import DatasetError, UsageError, read_case, write_case, write_recording
from gyrotrack.apps.cli._app import run
from gyrotrack.io import _contents as contents
from gyrotrack.io._contents import inspect_file
from gyrotrack.io._records import Input, no_series
from gyrotrack.io._tables import READER
from gyrotrack.io.readers._motion_table import ReadOptions
from gyrotrack.io.readers._registry import read_motion


def written(path, case):
    return write_case(path, case, command="", settings={})


@pytest.fixture
def file(case_file_with_mode, tmp_path):
    return Path(shutil.copy(case_file_with_mode, tmp_path / "case.h5"))


def wheel(case, **changes):
    stated = {"bodies": "one", "body_name": "wheel", "I_rotor": 1.0, "rotor": no_series(), "placements": {}}
    return replace(case, rotor_generated=None, **(stated | changes))


def bodies_alone(path):
    """Leave what layout 2 alone has."""
    with h5py.File(path, "r+") as f:
        for name in {"casing", "rotor", "rotor_generated", "recording"} & set(f):
            del f[name]
        for name in ("I_rotor", "I_casing", "bodies", "body_name", "per_inertia", "quantity"):
            f.attrs.pop(name, None)
    return path


def changed(path, change):
    with h5py.File(path, "r+") as f:
        change(f)
    return path


def message_of_both(path):
    """Return the sentence of `info`, which is that of a fit; empty if both read the file."""
    messages = []
    for read, error in ((inspect_file, DatasetError), (read_record, RecordError)):
        try:
            read(path)
            messages.append("")
        except error as caught:
            messages.append(caught.message.removesuffix("."))
    assert messages[0] == messages[1]
    return messages[0]


# ----------------------------------------------------------------------------------------------------- numbers


def run_info(path, capsys):
    code = run(["info", str(path)])
    said = capsys.readouterr()
    assert "Traceback" not in said.err
    return code, said.out + said.err


@pytest.mark.parametrize(
    ("delay", "words"), [(0.25, "acts 0.25 s later"), (np.nan, "'delay' is nan, not a finite")]
)
def test_info_of_an_input_with_a_delay(case, tmp_path, capsys, delay, words):
    current = Input("current", case.casing.time, case.casing.time, np.full(400, np.nan), "A")
    path = written(tmp_path / "c.h5", wheel(case, inputs=(current,), recordings={}))
    code, text = run_info(changed(path, lambda f: f["input/current"].attrs.modify("delay", delay)), capsys)
    assert (code == 0) is math.isfinite(delay)
    assert words in text.replace("\n", " ")


@pytest.mark.parametrize(
    ("rate", "words"), [(500.0, "500 fps"), (np.nan, "'capture_fps' is nan, not"), (np.inf, "is inf, not")]
)
def test_info_of_a_recording_with_a_rate(recording, tmp_path, capsys, rate, words):
    path = write_recording(tmp_path / "r.h5", recording, command="", settings={})
    code, text = run_info(changed(path, lambda f: f.attrs.modify("capture_fps", rate)), capsys)
    assert (code == 0) is math.isfinite(rate)
    assert words in text.replace("\n", " ")


def test_a_film_may_declare_no_rate(recording, tmp_path):
    """Its recording could not be read before."""
    path = write_recording(
        tmp_path / "r.h5", replace(recording, container_fps=math.nan), command="", settings={}
    )
    assert inspect_file(path).problems == ()


def test_a_summary_in_memory_has_every_required_attribute(recording):
    assert math.isnan(contents.describe_recording(replace(recording, capture_fps=math.nan))["capture_fps"])


@pytest.mark.parametrize(
    ("dtype", "value", "words"),
    [
        ("f8", 2.0**62, ""),
        ("f8", 1e30, "integers outside the range -9223372036854775808 to 9223372036854775807"),
        ("f8", 2.0**63, "integers outside"),
        ("u8", 2**63 - 1, ""),
        ("u8", 2**63, "integers outside"),
    ],
)  # fmt: skip
def test_segments_are_64_bit_integers(file, dtype, value, words):
    def change(f):
        fused = f["body/rotor/series/fused"]
        del fused["segment"]
        fused["segment"] = np.array([0] * 200 + [value] * 200, dtype=dtype)

    message = message_of_both(changed(bodies_alone(file), change))
    assert words in message
    assert bool(words) is bool(message)


@pytest.mark.parametrize(
    ("value", "words"), [(4.0, ""), (127.0, ""), (128.0, "outside the range -128 to 127"), (300.0, "outside")]
)
def test_a_status_is_an_8_bit_integer(recording, tmp_path, value, words):
    path = write_recording(tmp_path / "r.h5", recording, command="", settings={})

    def change(f):
        del f["marker/red/status"]
        f["marker/red/status"] = np.full(300, value)

    changed(path, change)
    if words:
        with pytest.raises(DatasetError, match=words):
            inspect_file(path)
    else:
        assert (inspect_file(path).problems == ()) is (value == 4.0)


# ------------------------------------------------------------------------------------------------- error modes


def set_mode(basis=None, covariance=None):
    def change(f):
        mode = f["body/casing/series/fused/error/tilt"]
        for name, values in (("basis", basis), ("covariance", covariance)):
            if values is not None:
                del mode[name]
                mode[name] = values

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (set_mode(), ""),
        (set_mode(covariance=np.diag([4e-6, -9e-6])), "negative variance"),
        (set_mode(covariance=np.array([[1.0, 1.1], [1.1, 1.0]])), "negative variance"),
        (set_mode(covariance=np.array([[0.0, 1e10], [1e10, 0.0]])), "negative variance"),
        (set_mode(basis=np.full((400, 2), np.nan)), "basis has values that are not finite"),
        (set_mode(basis=np.ones((400, 400)), covariance=np.eye(400)), ""),
        (set_mode(basis=np.ones((400, 401)), covariance=np.eye(401)), "401 amplitudes; at most 400"),
        (set_mode(basis=np.ones((400, 0)), covariance=np.ones((0, 0))), "shape (400, 0) for 400 samples"),
    ],
)
def test_info_and_fit_agree_on_error_modes(file, change, words):
    message = message_of_both(changed(file, change))
    assert words in message
    assert bool(words) is bool(message)


def test_an_error_may_be_unknown_where_the_angle_is(file):
    """Missing values are NaN."""

    def change(f):
        f["casing/angle"][7] = np.nan
        f["body/casing/series/fused/error/tilt/basis"][7] = np.nan

    assert message_of_both(changed(file, change)) == ""


# ---------------------------------------------------------------------------------------------------- inertias


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"I_rotor": -1.0}, "inertia of the rotor is -1, not positive"),
        ({"I_casing": math.inf}, "'I_casing' is inf, not a finite number"),
        ({"per_inertia": 1}, "an inertia is missing"),
        ({"I_rotor": math.nan}, "'I_rotor' is missing"),
        ({"I_casing_u": -1e-9}, "uncertainty of the moment of inertia of the casing is -1e-09"),
        ({"I_casing_u": math.inf}, "uncertainty of the moment of inertia of the casing is inf"),
        ({"I_casing_u": 0.0}, ""),
        ({"clock_offset_sigma": math.inf}, "'clock_offset_sigma' is inf"),
        ({"clock_rate_sigma": math.inf}, "'clock_rate_sigma' is inf"),
        ({"clock_rate_sigma": math.nan}, "'clock_rate_sigma' is nan"),
        ({"clock_rate_sigma": 0.0}, ""),
    ],
)
def test_what_cannot_be_read_is_not_written(case, tmp_path, change, words):
    of_clock = {k: v for k, v in change.items() if k.startswith("clock")}
    made = replace(
        case,
        placements={n: replace(p, **of_clock) for n, p in case.placements.items()},
        **{k: v for k, v in change.items() if k not in of_clock},
    )
    path = tmp_path / "new.h5"
    if words:
        with pytest.raises(UsageError) as caught:
            written(path, made)
        assert words in caught.value.message
        assert not list(tmp_path.glob("new*"))
    else:
        assert message_of_both(written(path, made)) == ""


@pytest.mark.parametrize(
    ("covariance", "right"),
    [
        (np.diag([1e-10, 0.0]), True),
        (np.diag([-1e-10, 1e-12]), False),
        (np.diag([1e-10, -1e-12]), False),
        (np.diag([1e-10, np.inf]), False),
    ],
)
def test_a_clock_has_a_covariance(covariance, right):
    assert (defect_of_clock(covariance) is None) is right


@pytest.mark.parametrize("alone", [False, True])
def test_the_inertia_of_a_wheel_is_named_by_the_wheel(case, tmp_path, alone):
    path = written(tmp_path / "c.h5", wheel(case))

    def change(f):
        f["body/wheel"].attrs["inertia"] = f.attrs["I_casing"] = -1.0

    changed(path, change)
    with pytest.raises(DatasetError) as caught:
        read_case(bodies_alone(path) if alone else path)
    assert "inertia of the wheel is -1, not positive" in caught.value.message
    # only a body of layout 2 may be without one
    assert ("or none" in caught.value.hint) is alone


def test_two_bodies_alone_may_not_be_without_an_inertia(file):
    path = changed(bodies_alone(file), lambda f: f["body/rotor"].attrs.modify("inertia", -1.0))
    with pytest.raises(DatasetError, match="inertia of the rotor is -1") as caught:
        read_case(path)
    assert "or none" not in caught.value.hint


@pytest.mark.parametrize(("u", "words"), [(0.0, ""), (-1e-7, "rotor is -1e-07"), (np.inf, "rotor is inf")])
def test_the_uncertainty_of_an_inertia_is_finite_and_not_negative(file, u, words):
    path = changed(bodies_alone(file), lambda f: f["body/rotor"].attrs.update({"inertia_u": u}))
    message = message_of_both(path)
    assert words in message
    assert bool(words) is bool(message)


def test_a_file_without_the_inertia_of_the_rotor_lacks_it(file):
    assert "the attribute 'I_rotor' is missing" in message_of_both(
        changed(file, lambda f: f.attrs.pop("I_rotor"))
    )


# ------------------------------------------------------------------------------------------------------ words


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: None, ""),
        (lambda f: f["body/rotor/series/fused"].attrs.pop("clock"), ""),
        (lambda f: f["body/rotor/series/fused"].attrs.modify("clock", "rotor_0"), "'clock' is 'rotor_0'"),
        (lambda f: f["body/rotor/series/fused"].attrs.modify("sigma_source", "calibrated"), ""),
        (lambda f: f["body/rotor"].attrs.modify("role", "wheel"), "'role' is 'wheel'"),
        (lambda f: f["clock/rotor_0"].attrs.update({"offset": "late"}), "'offset' is not a number"),
        (lambda f: f["clock/rotor_0"].attrs.pop("offset"), ""),
    ],
)
def test_words_of_bodies_alone(file, change, words):
    message = message_of_both(changed(bodies_alone(file), change))
    assert words in message
    assert bool(words) is bool(message)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("bodies", ["rotor", "ground"], ""),
        ("bodies", [b"rotor", b"ground"], ""),
        ("bodies", [1.0, 2.0], "'bodies' is not a list of strings"),
        ("kind", "weld", "'kind' is 'weld'"),
    ],
)
def test_joints_are_readable(file, name, value, words):
    with h5py.File(changed(file, lambda f: f["joint/bearing"].attrs.update({name: value}))) as f:
        if words:
            with pytest.raises(DatasetError, match=words):
                READER.attributes(f["joint/bearing"], layout.JOINT_ATTRIBUTES)
        else:
            found = READER.attributes(f["joint/bearing"], layout.JOINT_ATTRIBUTES)
            assert found == {"bodies": ["rotor", "ground"], "kind": "bearing", "place": 0}


@pytest.mark.parametrize(
    ("value", "kind", "expected"),
    [
        (7, int, 7),
        (np.array([7]), int, 7),
        (2.5, float, 2.5),
        (np.array([2.5]), float, 2.5),
        ("PVC", str, "PVC"),
        (b"PVC", str, "PVC"),
        (np.array([1.0, 2.0]), float, None),
        (np.array([[2.5]]), float, None),
        ("2.5", float, None),
        (2.5, str, None),
        (np.array([[1.0, 2.0], [3.0, 4.0]]), tuple, ((1.0, 2.0), (3.0, 4.0))),
        (np.array([[1.0, math.nan]]), tuple, None),
        (np.array([[1.0, 2.0, 3.0]]), tuple, None),
        (np.array([1.0, 2.0]), tuple, None),
        (["a", "b"], list, ["a", "b"]),
        ("a", list, ["a"]),
        ([1.0], list, None),
    ],
)
def test_attributes_are_of_one_kind(tmp_path, value, kind, expected):
    with h5py.File(tmp_path / "a.h5", "w") as f:
        f.attrs["x"] = value
        if expected is None:
            with pytest.raises(DatasetError, match="the attribute 'x' is not"):
                READER.attribute(f, "x", kind)
        else:
            found = READER.attribute(f, "x", kind)
            assert (found, type(found)) == (expected, kind)
        assert READER.attribute(f, "y", kind, expected or 0) == (expected or 0)
        with pytest.raises(DatasetError, match="lacks the attribute 'y'"):
            READER.attribute(f, "y", kind)


@pytest.mark.parametrize("superseded", [True, False])
def test_a_clock_that_layout_1_supersedes_is_not_read(file, superseded):
    def change(f):
        f["clock/rotor_0/covariance"][0, 0] = -1.0
        if not superseded:
            del f["recording/rotor_0"].attrs["clock_offset"]
            del f["recording/rotor_0"].attrs["clock_offset_sigma"]

    message = message_of_both(changed(file, change))
    assert ("no covariance of offset and rate" in message) is not superseded


# ------------------------------------------------------------------------------------------- the start of windows


@pytest.mark.parametrize(
    ("start_u", "expected"),
    [
        (2e-3, 2e-3),
        (0.0, 0.0),
        (-1e-3, math.nan),
        (math.nan, math.nan),
        (math.inf, math.nan),
        (None, math.nan),
    ],
)
@pytest.mark.parametrize("alone", [False, True])
def test_the_start_of_an_imported_case_reaches_the_fit(case, tmp_path, start_u, expected, alone):
    path = written(tmp_path / "c.h5", replace(case, recordings={}, placements={}))
    if start_u is not None:
        changed(path, lambda f: f.attrs.update({"start_u": start_u}))
    found = read_record(bodies_alone(path) if alone else path).start_sigma
    assert found == pytest.approx([expected] * 2, nan_ok=True)


def test_the_start_of_a_camera_takes_precedence(case, tmp_path):
    """The camera of the window without a stated uncertainty has none."""
    path = written(tmp_path / "c.h5", replace(case, start_u=2e-3))
    assert read_record(path).start_sigma == pytest.approx([1e-5, 0.0])


def test_every_attribute_of_a_case_is_read_from_bodies_alone(file, monkeypatch):
    path = changed(bodies_alone(file), lambda f: f.attrs.update({"place": "Bonn", "start_u": 1e-3}))
    added = layout.Attribute("place", str, "", "laboratory", "")
    monkeypatch.setattr(layout, "CASE_ATTRIBUTES", (*layout.CASE_ATTRIBUTES, added))
    with READER.open(path) as f:
        found = read_stored_case(f, READER).attributes
    assert {a.key for a in layout.CASE_ATTRIBUTES} == set(found)
    assert (found["place"], found["start_u"], found["surface"]) == ("Bonn", 1e-3, "PVC")


@pytest.mark.parametrize("third", [False, True])
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: None, ""),
        (lambda f: f["joint"].__delitem__("belt"), "no joint connects"),
        (lambda f: f["joint/belt"].attrs.modify("bodies", ["arm", "arm"]), "is between arm and arm"),
        (lambda f: f["joint/belt"].attrs.update({"bodies": ["arm"]}), "names 1 of two bodies"),
        (lambda f: f["body/arm"].attrs.__delitem__("inertia"), "arm has no inertia"),
        (lambda f: f["body/arm"].attrs.modify("inertia", -1.0), "is -1, not positive"),
        (lambda f: f["body/arm"].attrs.modify("place", 1), "two bodies of the same place"),
    ],
)
def test_several_bodies_have_an_inertia_and_are_connected(file, third, change, words):
    def chain(f):
        for name, old, place in (("wheel", "rotor", 1), ("arm", "casing", 0)):
            f["body"].move(old, name)
            f[f"body/{name}"].attrs.update({"role": "body", "place": place, "inertia": 1e-4})
        del f["joint/touchpoint"]
        f["joint"].move("bearing", "belt")
        f["joint/belt"].attrs["bodies"] = ["arm", "wheel"]
        if third:
            f["body"].copy("wheel", "drum")
            f["body/drum"].attrs["place"] = 2
            f["joint"].copy("belt", "hinge")
            f["joint/hinge"].attrs.update({"bodies": ["wheel", "drum"], "place": 1})
        change(f)

    with READER.open(changed(bodies_alone(file), chain)) as f:
        if words:
            with pytest.raises(DatasetError) as caught:
                read_stored_case(f, READER)
            assert words in caught.value.message
            return
        found = read_stored_case(f, READER)
    assert found.attributes["bodies"] == "chain"
    assert [s.name for s in (found.casing, *found.others)] == ["arm", "wheel", "drum"][: 2 + third]
    joints = {"belt": ("arm", "wheel")} | ({"hinge": ("wheel", "drum")} if third else {})
    assert (found.joints, found.casing.inertia[0]) == (joints, 1e-4)


# -------------------------------------------------------------------------------------------- import of a case


@pytest.mark.parametrize("quantity", ["angle", "omega"])
@pytest.mark.parametrize("alone", [False, True])
def test_a_body_of_a_case_is_imported(case, tmp_path, quantity, alone):
    case = replace(case, quantity=quantity, casing=replace(case.casing, omega=20 - case.casing.time))
    path = written(tmp_path / "c.h5", case)
    bodies = {
        name: read_motion(bodies_alone(path) if alone else path, ReadOptions(body=name))
        for name in ("", "casing")
    }
    for found in bodies.values():
        assert found.quantity == quantity
        np.testing.assert_array_equal(found.time, case.casing.time)
        np.testing.assert_array_equal(found.value, getattr(case.casing, quantity))


def test_what_cannot_be_fitted_is_not_imported(file):
    path = changed(
        bodies_alone(file), lambda f: f["body/rotor/series/fused"].attrs.modify("clock", "rotor_0")
    )
    with pytest.raises(DatasetError, match="'clock' is 'rotor_0'"):
        read_motion(path, ReadOptions(body="casing"))


def test_a_case_of_one_body_has_no_rotor(case, tmp_path):
    path = written(tmp_path / "c.h5", wheel(case))
    with pytest.raises(DatasetError, match="no series 'rotor'") as caught:
        read_motion(path, ReadOptions(body="rotor"))
    assert "casing, wheel" in caught.value.hint


@pytest.mark.parametrize("name", ["wheel", "rotor", ""])
def test_a_single_body_is_imported_by_its_name(case, tmp_path, name):
    path = written(tmp_path / "c.h5", wheel(case, body_name=name))
    for body in (name, "casing"):
        assert len(read_motion(path, ReadOptions(body=body)).time) == 400


def test_a_recording_is_not_imported(recording, tmp_path):
    path = write_recording(tmp_path / "r.h5", recording, command="", settings={})
    with pytest.raises(DatasetError, match="is a recording, not a case") as caught:
        read_motion(path, ReadOptions(body="casing"))
    assert "gyrotrack sync" in caught.value.hint


# ------------------------------------------------------------------------------------------- faults of the program


@pytest.mark.parametrize("error", [TypeError, KeyError, ValueError])
def test_an_error_of_the_program_is_not_damage_of_the_file(file, monkeypatch, error):
    def fail(*_, **__):
        raise error("a fault")

    monkeypatch.setattr(contents, "describe_case", fail)
    monkeypatch.setattr("gyrotrack.io._hdf5.series_from", fail)
    monkeypatch.setattr("fitting.inference._case_file.make_record", fail)
    for read in (inspect_file, read_case, read_record):
        with pytest.raises(error, match="a fault"):
            read(file)


@pytest.mark.parametrize(("error", "words"), [(MemoryError, "needs more memory"), (OSError, "is damaged")])
def test_too_little_memory_is_not_damage(file, monkeypatch, error, words):
    def fail(*_, **__):
        raise error("no room")

    monkeypatch.setattr("fitting._dataset.Reader.load", fail)
    assert words in message_of_both(file)


@pytest.mark.parametrize(
    ("version", "words"),
    [("9" * 20, "newest supported"), ("9" * 5000, "no valid format version"), ("2.7", "")],
)
def test_a_version_of_many_digits_is_none(file, version, words):
    message = message_of_both(changed(file, lambda f: f.attrs.modify("format_version", version)))
    assert words in message
    assert len(message) < 300


@pytest.mark.parametrize("quantity", ["angle", "omega"])
@pytest.mark.parametrize("samples", [0, 1, 2])
def test_short_series_of_bodies_alone(case, tmp_path, quantity, samples, capsys):
    path = bodies_alone(written(tmp_path / "c.h5", wheel(case, quantity=quantity, recordings={})))

    def cut(f):
        fused = f["body/wheel/series/fused"]
        for name in ("time", "value", "u"):
            values = fused[name][:samples]
            del fused[name]
            fused[name] = values

    code, text = run_info(changed(path, cut), capsys)
    assert ("casing has no angles" in text) is (samples == 0)
    assert (code == 0) is (samples > 0)
    assert run(["info", str(path), "--json"]) == code
    assert json.loads(capsys.readouterr().out)["casing"]["samples"] == samples
