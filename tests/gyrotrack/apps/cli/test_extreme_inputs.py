"""Numbers and files at the edge of what a computer represents end in one sentence, within it in a result."""

import json
import os
import re

import h5py
import numpy as np
import pytest

from gyrotrack.apps.cli import _app

ROWS = 200
BODY = ["--inertia", "1e-5", "--json"]


def table(header, row):
    return header + "\n" + "".join(f"{row(k)}\n" for k in range(ROWS))


def angles(scale):
    return table("t,angle [rad]", lambda k: f"{0.01 * k},{scale * (0.1 * k - 1e-4 * k * k)}")


def times(scale):
    return table("t,angle", lambda k: f"{scale * k},{0.1 * k - 1e-4 * k * k}")


def objects(first):
    return (
        f'[{{"t": 0.0, "angle": {first}}}, '
        + json.dumps([{"t": 0.01 * k, "angle": 0.1 * k} for k in range(1, ROWS)])[1:]
    )


EXTREME = {
    "integer of 400 digits.json": objects("1" + 400 * "0"),
    "angles.csv": angles(1e305),
    "angles that overflow when squared.csv": angles(1e160),
    "short times.csv": times(1e-300),
    "subnormal times.csv": times(1e-310),
    "long times.csv": times(1e300),
    "sigma.csv": table("t,angle,sigma", lambda k: f"{0.01 * k},{0.1 * k},1e300"),
    "small sigma.csv": table("t,angle,sigma", lambda k: f"{0.01 * k},{0.1 * k},1e-300"),
}
USUAL = {
    "integer.json": objects("0"),
    "angles.csv": angles(1e6),
    "times.csv": times(1e-6),
    "cell.csv": "t,angle\n" + '0.001,"' + "1" * 140_000 + '"\n' + angles(1.0).partition("\n")[2],
}


@pytest.mark.parametrize("name", EXTREME)
def test_numbers_beyond_arithmetic_are_one_sentence(gyrotrack, tmp_path, name):
    (tmp_path / name).write_text(EXTREME[name])
    said = gyrotrack("import", "--body", tmp_path / name, "-o", tmp_path / "case.h5", *BODY)
    assert said.code == 1
    assert said.error["code"] == "dataset"
    said = gyrotrack("spindown", tmp_path / name, "-o", tmp_path / "case.h5", "--json")
    assert said.code == 1
    assert said.error["code"] == "dataset"
    assert [p.name for p in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", USUAL)
def test_large_numbers_are_read(gyrotrack, tmp_path, name):
    (tmp_path / name).write_text(USUAL[name])
    said = gyrotrack("import", "--body", tmp_path / name, "-o", tmp_path / "case.h5", *BODY)
    assert said.code == 0, said.out
    assert "error" not in said.json


@pytest.mark.parametrize("sigma", ["", pytest.param(",1e-3", marks=pytest.mark.slow)])
def test_angles_without_any_acceleration_are_fitted(gyrotrack, tmp_path, sigma):
    path, case = tmp_path / "steady.csv", tmp_path / "steady.h5"
    path.write_text(
        table(
            "t,angle [rad],sigma" if sigma else "t,angle [rad]",
            lambda k: f"{k / 128},{1000 * k / 128}{sigma}",
        )
    )
    assert gyrotrack("import", "--body", path, "-o", case, *BODY).code == 0
    for command in ("fit", "diagnose"):
        said = gyrotrack(command, case, "--json")
        assert said.code in {0, 3}, said.out
        assert "error" not in said.json


@pytest.mark.parametrize("command", ["import", "spindown"])
@pytest.mark.parametrize("number", ["0", "-1", "nan", "inf", "1e-300", "1e300"])
def test_a_number_of_pulses_that_is_none_is_not_ignored(gyrotrack, tmp_path, command, number):
    path = tmp_path / "pulses.csv"
    path.write_text(table("t", lambda k: f"{0.01 * k + 1e-5 * k * k}"))
    words = ["import", "--body", path] if command == "import" else ["spindown", path]
    said = gyrotrack(*words, f"--pulses-per-turn={number}", "-o", tmp_path / "case.h5", *BODY)
    assert said.code == 2
    assert said.error["message"].startswith(f"--pulses-per-turn {float(number):g} is not between")
    assert [p.name for p in tmp_path.iterdir()] == ["pulses.csv"]


def test_a_file_that_is_open_elsewhere_is_not_called_damaged(gyrotrack, case):
    path = case("plain")
    with h5py.File(path, "r+"):
        for command, code in (("info", "dataset"), ("fit", "record")):
            said = gyrotrack(command, path, "--json")
            assert said.code == 1
            assert said.error["code"] == code
            assert "is open in another program" in said.error["message"]
    assert gyrotrack("info", path, "--json").json["sound"]


@pytest.mark.slow
def test_a_model_without_free_strengths_is_fitted(gyrotrack, case):
    strengths = {
        "bearing.linear.d": 1e-7,
        "bearing.power.f": 1e-8,
        "rotor.air.quadratic.a2": 1e-10,
        "touchpoint.constant.b1": 3e-6,
        "casing.air.linear.b2": 8e-7,
    }
    words = [w for name, value in strengths.items() for w in ("--fix", f"{name}={value}")]
    said = gyrotrack("fit", case("plain"), *words, "--json")
    assert said.code in {0, 3}
    found = said.json["parameters"]
    assert {name: found[name]["value"] for name in strengths} == strengths
    assert {name for name in found if name not in strengths} == {
        "bearing.power.g",
        "initial.omega_r@plain",
        "initial.omega_c@plain",
    }


@pytest.mark.parametrize("command", ["extract", "profile", "spindown"])
def test_a_folder_is_not_a_film(gyrotrack, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "film.mp4").mkdir()
    said = gyrotrack(command, "film.mp4", "--json")
    assert said.code == 1
    assert re.match(
        r"film\.mp4 (is a folder, not a regular file|contains no numbered pictures)\.", said.error["message"]
    )
    assert [p.name for p in tmp_path.iterdir()] == ["film.mp4"]


@pytest.mark.parametrize(
    "words", [["fit", "@"], ["ladder", "@"], ["laws", "@"], ["info", "@"], ["spindown", "@"]]
)
def test_a_name_that_is_too_long_is_not_a_bug(gyrotrack, words):
    said = gyrotrack(*(w.replace("@", 5000 * "x" + ".h5") for w in words), "--json")
    assert said.code in {1, 2}
    assert said.error["code"] != "bug"
    assert len(said.error["message"]) < 6000


@pytest.mark.skipif(os.name == "nt", reason="needs links")
def test_an_output_that_is_a_link_to_itself_is_not_a_bug(gyrotrack, tmp_path):
    (tmp_path / "t.csv").write_text(angles(1.0))
    (tmp_path / "c.h5").symlink_to("c.h5")
    for force in ([], ["--force"]):
        said = gyrotrack("spindown", tmp_path / "t.csv", "-o", tmp_path / "c.h5", *force, "--json")
        assert said.code == 1
        assert said.error["code"] != "bug"


@pytest.mark.parametrize(
    ("raised", "code"),
    [
        (np.linalg.LinAlgError("Singular matrix"), "numerical"),
        (FileNotFoundError(2, "No such file or directory"), "file"),
        (PermissionError(13, "Permission denied", "x"), "file"),
        (RuntimeError("Symlink loop from 'x'"), "file"),
        (RuntimeError("Something else"), "bug"),
        (KeyError("x"), "bug"),
        (OSError("no number"), "bug"),
    ],
)
def test_an_error_of_the_data_or_of_a_file_is_distinguished_from_a_bug(gyrotrack, monkeypatch, raised, code):
    def fails(_):
        raise raised

    monkeypatch.setattr(_app, "_with_settings", fails)
    said = gyrotrack("effects", "--json")
    assert said.code == 1
    assert said.error["code"] == code
