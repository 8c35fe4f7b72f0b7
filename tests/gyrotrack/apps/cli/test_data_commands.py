"""`import` and `info` as a user runs them; `sync` is in test_sync.py."""

import json

import numpy as np
import pytest

from gyrotrack import read_case
from gyrotrack.apps.cli._app import run


@pytest.fixture
def tables(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    time = np.arange(0, 10, 1 / 260)
    rows = [f"{t:.6f},{30 * t + 1e-3 * np.sin(1e4 * t):.6f}" for t in time]
    (tmp_path / "casing.csv").write_text("\n".join(["t,angle", *rows]))
    time = np.arange(2, 4, 1 / 1000)
    rows = [f"{t:.6f},{800 * t:.6f},0.002" for t in time]
    (tmp_path / "r1.csv").write_text("\n".join(["t,angle,sigma", *rows]))
    return tmp_path


INERTIAS = ["--inertia-rotor", "5.54e-5", "--inertia-casing", "2.06e-5"]
IMPORT = ["import", "--casing", "casing.csv", "--rotor", "r1.csv", "-o", "case.h5", *INERTIAS]


def test_import_writes_a_case(tables, capsys):
    assert run([*IMPORT, "--label", "one", "--surface", "PVC", "--inertia-rotor", "6e-5"]) == 0
    said = capsys.readouterr()
    assert "written: case.h5" in said.out
    assert "estimated from the scatter" in said.err
    case = read_case(tables / "case.h5")
    assert (case.label, case.surface, case.I_rotor, case.I_casing) == ("one", "PVC", 6e-5, 2.06e-5)


def test_import_json(tables, capsys):
    assert run([*IMPORT, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["output"] == "case.h5"
    assert said["casing"]["samples"] == 2600
    assert said["casing"]["quantity"] == "angle"
    assert said["casing"]["sigma_source"] == "estimated"
    assert said["rotor"]["windows"][0]["t_start"] == 2.0
    assert len(said["warnings"]) == 1
    assert read_case(tables / "case.h5").label == "case"


def test_existing_case_is_kept_without_force(tables, capsys):
    (tables / "case.h5").write_bytes(b"old")
    assert run(IMPORT) == 1
    assert "already exists" in capsys.readouterr().err
    assert (tables / "case.h5").read_bytes() == b"old"
    assert run([*IMPORT, "--force"]) == 0


def test_bad_table_writes_nothing(tables, capsys):
    (tables / "r1.csv").write_text("t,angle\n0,1\n0.1,x\n")
    assert run([*IMPORT, "--json"]) == 1
    error = json.loads(capsys.readouterr().out)["error"]
    assert error["code"] == "dataset"
    assert "r1.csv, line 3" in error["message"]
    assert not list(tables.glob("case*"))


def test_info_of_a_case(tables, capsys):
    run(IMPORT)
    capsys.readouterr()
    assert run(["info", "case.h5", "--verify"]) == 0
    said = capsys.readouterr().out
    assert "a case, sound" in said
    assert "rotor 0" in said
    assert "verified:" in said
    assert max(len(line) for line in said.splitlines() if not line.startswith("command")) <= 100
    assert run(["info", "case.h5", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["kind"] == "case"
    assert document["sound"] is True
    assert document["rotor"]["windows"][0]["samples"] == 2000
    assert document["command"].startswith("gyrotrack import --casing casing.csv --rotor r1.csv -o case.h5")


def test_info_of_something_else(tables, capsys):
    assert run(["info", "casing.csv"]) == 1
    assert "not an HDF5 file" in capsys.readouterr().err
