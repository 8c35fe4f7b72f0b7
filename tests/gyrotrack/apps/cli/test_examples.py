"""The example that each command's help shows does what it says."""

import inspect
import re
import shlex
import shutil
from pathlib import Path

import pytest

from gyrotrack.apps.cli._app import COMMANDS
from gyrotrack.apps.cli._settings import function_of

CLIPS = Path(__file__).parents[4] / "sample_clips"
LONG = {
    "demo",
    "spindown",
    "extract",
    "sync",
    "batch",
    "profile",
    "scan",
    "diagnose",
    "improve",
    "figures",
    "laws",
    "plan",
    "certify",
}  # minutes, or films; test_study.py, test_paper.py, test_laws.py, test_plan.py and test_certify.py run the last six
SERVED = {"view"}  # runs until it is stopped; it has tests of its own


def example(entry):
    """Return the words of the example in a command's help."""
    (lines,) = re.findall(r"Example: gyrotrack (.*(?:\n.+)*)", inspect.getdoc(function_of(entry)))
    return shlex.split(lines)


@pytest.fixture(scope="module")
def lab(tmp_path_factory, simulated, program):
    """A folder with all that the examples name: cases, tables, a seal."""

    folder = tmp_path_factory.mktemp("lab")
    for name, kind, again in (("case1", "drag", "left"), ("case2", "other", "right")):
        shutil.copy(simulated / f"{kind}.h5", folder / f"{name}.h5")
        assert program(["fit", str(folder / f"{name}.h5"), "-q"]) == 0
        for suffix in (".h5", ".fits.json"):
            shutil.copy(folder / f"{name}{suffix}", folder / f"{again}{suffix}")
    words = ["simulate", "-o", str(folder / "case.h5"), "--hide", "--duration", "30", "--window-length", "1"]
    assert program(words) == 0
    assert program(["fit", str(folder / "case.h5"), "-q"]) == 0
    rows = "".join(f"{i / 100},{3 * i / 100}\n" for i in range(300))
    for name in ("casing.csv", "r1.csv", "r2.csv"):
        (folder / name).write_text("t,angle\n" + rows)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("entry", [e for e in COMMANDS if e.name not in LONG | SERVED], ids=lambda e: e.name)
@pytest.mark.release
def test_the_example_runs(gyrotrack, lab, tmp_path, monkeypatch, entry):
    shutil.copytree(lab, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    words = example(entry)
    output = Path(words[words.index("-o") + 1]) if "-o" in words else None
    if output is not None and output.exists():
        output.unlink()
    said = gyrotrack(*words)
    assert said.code == 0, said.err
    assert output is None or output.stat().st_size > 0


@pytest.mark.slow
@pytest.mark.release
def test_the_example_of_scan_runs(gyrotrack, lab, tmp_path, monkeypatch):
    shutil.copytree(lab, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    (entry,) = [e for e in COMMANDS if e.name == "scan"]
    said = gyrotrack(*example(entry))
    assert said.code in {0, 3}, said.err  # 3: done, but on this short case a run of the tables is marked


@pytest.mark.slow
@pytest.mark.release
def test_the_examples_with_films_run(gyrotrack, demo, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    entries = {e.name: e for e in COMMANDS}
    assert example(entries["demo"]) == ["demo", "-o", "gyrotrack_demo"]  # which the fixture runs
    shutil.copy(CLIPS / "rotor_1.mp4", tmp_path)
    for name in ("extract", "profile"):
        said = gyrotrack(*example(entries[name]))
        assert said.code == 0, said.err
    for name in ("casing", "rotor_2"):
        shutil.copy(demo[1] / f"{name}.h5", tmp_path)
    assert gyrotrack(*example(entries["sync"])).code == 0
    films = tmp_path / "films"
    films.mkdir()
    shutil.copy(CLIPS / "rotor_1.mp4", films)
    assert gyrotrack(*example(entries["batch"]), "--until", "extract").code == 0
