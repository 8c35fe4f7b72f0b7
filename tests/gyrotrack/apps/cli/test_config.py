"""A flag beats the file, the file beats the default, and the program says which holds."""

import json
import re

import h5py
import pytest

from gyrotrack import _versions
from gyrotrack.apps.cli import _settings as settings
from gyrotrack.apps.cli._app import COMMANDS
from gyrotrack.apps.cli._settings import load


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty folder to work in, without settings of the user's."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "user"))
    monkeypatch.delenv(settings.VARIABLE, raising=False)
    return tmp_path


def held(gyrotrack, *words):
    return gyrotrack(*words, "config", "simulate", "--json").json["settings"]["simulate"]["duration"]


def test_which_file_holds(gyrotrack, here, monkeypatch):
    assert held(gyrotrack) == {"value": 200.0, "from": "default"}
    (here / "user" / "gyrotrack").mkdir(parents=True)
    (here / "user" / "gyrotrack" / "gyrotrack.toml").write_text("[simulate]\nduration = 11\n")
    assert held(gyrotrack)["value"] == 11
    (here / "gyrotrack.toml").write_text("# mine\n[simulate]\nduration = 12\n")
    assert held(gyrotrack) == {"value": 12.0, "from": "file", "line": 3}
    (here / "other.toml").write_text("[simulate]\nduration = 13\n")
    monkeypatch.setenv(settings.VARIABLE, "other.toml")
    assert held(gyrotrack)["value"] == 13
    (here / "asked.toml").write_text("[simulate]\nduration = 14\n")
    assert held(gyrotrack, "--config", "asked.toml")["value"] == 14
    assert held(gyrotrack, "--config=none")["value"] == 200


def test_file_beats_default_and_flag_beats_file(gyrotrack, here):
    (here / "gyrotrack.toml").write_text(
        '[simulate]\nduration = 12\nwindow_length = 1\nsurface = "ice"\nseed = 3\n'
    )
    assert gyrotrack("simulate", "-o", "a.h5").code == 0
    assert gyrotrack("simulate", "-o", "b.h5", "--surface", "felt").code == 0
    with h5py.File("a.h5") as a, h5py.File("b.h5") as b:
        assert (a.attrs["surface"], b.attrs["surface"]) == ("ice", "felt")
        assert json.loads(a.attrs["settings"])["experiment"]["duration"] == 12


def test_paths_are_taken_from_the_folder_of_the_file(gyrotrack, here):
    (here / "lab").mkdir()
    (here / "lab" / "gyrotrack.toml").write_text('[extract]\nprofile = "p.toml"\n')
    said = gyrotrack("--config", "lab/gyrotrack.toml", "extract", "no.mp4")
    assert f"There is no profile {here / 'lab' / 'p.toml'}" in said.err


def test_every_fault_is_named_with_its_line(gyrotrack, here):
    (here / "gyrotrack.toml").write_text('[extract]\ncapture_fsp = 3\n\n[sync]\nquiet = "a"\n[fitt]\n')
    for words in (["config"], ["effects"]):
        said = gyrotrack(*words)
        assert said.code == 1
        for place in ("line 2, extract.capture_fsp", "line 5, sync.quiet", "line 6, fitt"):
            assert place in said.err
    said = gyrotrack("--config", "no.toml", "effects", "--json")
    assert said.error["code"] == "configuration"


def test_the_keys_are_the_options(gyrotrack, here):
    """Every option that a command's help shows is a key, under its first long name."""
    for entry in COMMANDS:
        keys = set(settings.options_of(entry).values())
        names = [[o for o in p.opts if o.startswith("--")] for p in load(entry).params]
        shown = {n[0].lstrip("-").replace("-", "_") for n in names if n} - {"help"}
        assert keys == shown, entry.name


@pytest.mark.slow
def test_a_batch_takes_its_settings_along(gyrotrack, here, simulated):
    """Settings reach the steps as words, so that they count when it is seen whether a step was done."""
    (here / "m.toml").write_text(f'[[case]]\ndata = "{simulated / "plain.h5"}"\n')
    (here / "gyrotrack.toml").write_text('[fit]\nadd = ["casing.air.quadratic"]\n')
    assert gyrotrack("batch", "m.toml", "--until", "fit", "--json").json["steps"]["done"] == 1
    document = json.loads(next(here.glob("gyrotrack_batch/*/case.fits.json")).read_text())
    assert "casing.air.quadratic" in document["fits"][-1]["model"]
    assert gyrotrack("batch", "m.toml", "--until", "fit", "--json").json["steps"]["kept"] == 1
    (here / "gyrotrack.toml").unlink()
    assert gyrotrack("batch", "m.toml", "--until", "fit", "--json").json["steps"]["done"] == 1


def test_versions(gyrotrack):
    lines = gyrotrack("--version").out.splitlines()
    assert lines[0] == f"gyrotrack {_versions.__version__}"
    assert {"python", "numpy", "scipy", "h5py", "av"} <= {line.split()[0] for line in lines}
    assert all(re.search(r"\d", line) or line.startswith(("platform", "kernels")) for line in lines)


def test_a_file_says_what_made_it(gyrotrack, here):
    gyrotrack("simulate", "-o", "a.h5", "--duration", "12", "--window-length", "1")
    with h5py.File("a.h5") as file:
        environment = json.loads(file.attrs["environment"])
        assert file.attrs["command"].startswith("gyrotrack simulate -o a.h5")
    assert {"gyrotrack", "python", "platform", "numpy", "h5py"} <= set(environment)


@pytest.mark.slow
def test_numbers_of_tracking(gyrotrack, here):
    said = gyrotrack("config", "--tracking")
    assert said.code == 0
    assert "gyrotrack.tracking._film_tracker\n" in said.out
    assert "  BATCH = 512 [frames]\n    Number of frames that are measured together\n    chosen: " in said.out
    rows = gyrotrack("config", "--tracking", "--json").json["tracking"]
    batch = next(r for r in rows if r["name"] == "BATCH")
    assert (batch["module"], batch["value"], batch["unit"]) == (
        "gyrotrack.tracking._film_tracker",
        512,
        "frames",
    )
    for words in (["extract"], ["--all"]):
        said = gyrotrack("config", "--tracking", *words)
        assert said.code == 2
        assert "--tracking shows no options of commands." in said.err


@pytest.mark.slow
def test_numbers_of_fitting(gyrotrack, here):
    said = gyrotrack("config", "--fitting")
    assert said.code == 0
    assert "fitting.inference._metrics\n" in said.out
    assert "  FOLDS = 6 [1]\n    Number of folds of the cross-validation\n    chosen: " in said.out
    both = gyrotrack("config", "--fitting", "--tracking", "--json").json
    rows = {r["name"]: r for r in both["fitting"]}
    assert (rows["Criteria.start_u"]["value"], rows["Criteria.start_u"]["unit"]) == (0.003, "s")
    assert both.keys() == {"tracking", "fitting"}
    said = gyrotrack("config", "--fitting", "--all")
    assert said.code == 2
    assert "--fitting shows no options of commands." in said.err
