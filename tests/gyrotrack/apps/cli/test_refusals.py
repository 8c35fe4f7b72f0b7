"""Files that are not cases, and folders that cannot be written: one sentence, exit 1, nothing written."""

import os

import h5py
import numpy as np
import pytest

from gyrotrack.apps.cli._app import COMMANDS

STUDIES = ("fit", "diagnose", "improve", "ladder", "report")


@pytest.fixture
def wrong(tmp_path, simulated):
    """Make a file that is wrong in a certain way, and return its path."""

    def make(kind):
        path = tmp_path / "wrong.h5"
        if kind == "text":
            path.write_text("t,angle\n0,1\n")
        elif kind == "empty":
            path.write_bytes(b"")
        elif kind == "foreign":
            with h5py.File(path, "w") as file:
                file["entry/data"] = np.arange(10.0)
        elif kind == "cut":
            path.write_bytes((simulated / "plain.h5").read_bytes()[:50_000])
        elif kind == "folder":
            path.mkdir()
        elif kind == "recording":
            path.write_bytes((simulated / "plain.h5").read_bytes())
            with h5py.File(path, "r+") as file:
                file.attrs["kind"] = "recording"
        elif kind == "newer":
            path.write_bytes((simulated / "plain.h5").read_bytes())
            with h5py.File(path, "r+") as file:
                file.attrs["format_version"] = "9.0"
        elif kind == "without rotor":
            path.write_bytes((simulated / "plain.h5").read_bytes())
            with h5py.File(path, "r+") as file:
                del file["rotor"]
        return path

    return make


KINDS = ("missing", "text", "empty", "foreign", "cut", "folder", "recording", "newer", "without rotor")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("command", STUDIES)
def test_what_is_not_a_case(gyrotrack, wrong, tmp_path, command, kind):
    path = wrong(kind)
    before = sorted(tmp_path.iterdir())
    out = ["-o", tmp_path / "page.html"] if command == "report" else []
    said = gyrotrack(command, path, *out)
    assert said.code == 1
    assert said.out == ""
    assert said.err.startswith("error: ")
    assert "A bug" not in said.err
    assert "wrong.h5" in said.err
    assert len(said.err.splitlines()) <= 2
    as_json = gyrotrack(command, path, *out, "--json")
    assert as_json.code == 1
    assert as_json.err == ""
    assert set(as_json.error) == {"code", "message", "hint"}
    assert as_json.error["message"] in said.err
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("kind", ["recording", "text"])
def test_the_hint_says_how_to_make_a_case(gyrotrack, wrong, kind):
    assert "gyrotrack sync" in gyrotrack("fit", wrong(kind)).err


def test_the_second_of_two_cases_is_named(gyrotrack, case, wrong):
    said = gyrotrack("fit", case("plain"), wrong("foreign"), "--joint")
    assert said.code == 1
    assert "wrong.h5" in said.err


def test_a_folder_that_cannot_be_written(gyrotrack, case, tmp_path):
    said = gyrotrack("fit", case("plain"), "--ledger", tmp_path / "missing" / "fits.json")
    assert said.code == 1
    assert "cannot be written" in said.err


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_may_not_be_written(gyrotrack, case, tmp_path):
    path = case("plain")
    tmp_path.chmod(0o500)
    try:
        said = gyrotrack("fit", path)
    finally:
        tmp_path.chmod(0o700)
    assert said.code == 1
    assert "cannot be written" in said.err


@pytest.mark.slow
def test_a_folder_that_refuses_to_be_written(gyrotrack, case, tmp_path, monkeypatch):
    """As on a read-only disk, whoever runs it."""

    def refuse(self, *args, **kwargs):
        if {"w", "x"} & set(args[0] if args else kwargs.get("mode", "r")):
            raise PermissionError(13, "Permission denied", str(self))
        return opened(self, *args, **kwargs)

    opened = type(tmp_path).open
    path = case("plain")
    monkeypatch.setattr(type(tmp_path), "open", refuse)
    said = gyrotrack("fit", path, "--json")
    assert said.code == 1
    assert said.error["code"] == "ledger"
    assert "Permission denied" in said.error["message"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["plain.h5"]


@pytest.mark.parametrize(
    "text", ["", "not json", "[]", '{"format": "other"}', '{"format": "gyrotrack ledger", "version": 99}',
             '{"format": "gyrotrack ledger", "version": 1, "fits": [{"fit_id": "f1"}]}'],
)  # fmt: skip
def test_a_ledger_that_is_none(gyrotrack, case, tmp_path, text):
    path = case("plain")
    ledger = tmp_path / "plain.fits.json"
    ledger.write_text(text)
    said = gyrotrack("fit", path)
    assert said.code == 1
    assert "plain.fits.json" in said.err
    assert "A bug" not in said.err
    assert ledger.read_text() == text


@pytest.mark.parametrize("entry", COMMANDS, ids=lambda e: e.name)
def test_every_help_shows_an_example(gyrotrack, entry):
    said = gyrotrack(entry.name, "--help")
    assert said.code == 0
    assert f"Example: gyrotrack {entry.name}" in said.out
