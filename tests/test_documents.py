"""Pages that are made from the program must be as the program would make them now."""

import importlib.util
import shutil
import subprocess
from pathlib import Path

import h5py
import pytest

from fitting import LIBRARY
from gyrotrack.apps.cli._app import run
from gyrotrack.io.readers._format_names import ALL

DOCS = Path(__file__).parents[1] / "docs"
MADE = ["make_command_line", "make_effects", "make_format", "make_import", "make_json"]
FORMS = [*sorted((DOCS.parent / ".github").rglob("*.yml")), DOCS.parent / "CITATION.cff"]


def maker(name):
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", MADE)
def test_a_made_page_is_up_to_date(name):
    module = maker(name)
    assert module.TARGET.read_text(encoding="utf-8") == module.page(), f"run python docs/{name}.py"


@pytest.mark.slow
def test_the_pages_of_settings_are_up_to_date():
    for target, text in maker("make_settings").pages().items():
        assert target.read_text(encoding="utf-8") == text, "run python docs/make_settings.py"


def test_no_effect_is_left_out():
    rows = (DOCS / "reference/effects.md").read_text(encoding="utf-8").splitlines()
    for name in LIBRARY:
        assert sum(row.startswith(f"| {name} | {LIBRARY[name].words} | `") for row in rows) == 1, name


def test_the_manual_says_how_each_format_is_imported():
    assert {name for use in maker("make_import").USES for name in use.formats} == set(ALL)


def test_the_tables_of_the_format_are_those_of_a_real_file(tmp_path):
    """What `simulate` writes has exactly the datasets, units and dimensions that the page lists."""
    path = tmp_path / "case.h5"
    words = ["simulate", "-o", path, "--duration", "12", "--window-length", "1"]
    assert run([str(w) for w in words]) == 0
    text = (DOCS / "reference/format.md").read_text(encoding="utf-8")
    with h5py.File(path) as file:
        for group, title in (("casing", "### `/casing` of a case"), ("rotor", "### `/rotor` of a case")):
            section = text.split(title, 1)[1].split("###", 1)[0].split("| attribute |")[0]
            rows = [
                [c.strip() for c in r.split("|")[1:-1]] for r in section.splitlines() if r.startswith("| ")
            ]
            listed = {r[0]: (r[2], r[3]) for r in rows if r[0] != "dataset"}
            held = {n: (d.dtype.str[1:], d.attrs["units"]) for n, d in file[group].items()}
            assert held == listed
        for name in (
            "format",
            "format_version",
            "kind",
            "software_version",
            "created",
            "command",
            "settings",
        ):
            assert name in file.attrs
            assert f"{name}" in text


@pytest.mark.parametrize("path", FORMS, ids=lambda p: p.name)
def test_workflows_and_forms_are_valid(path):
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed")
    document = yaml.safe_load(path.read_text(encoding="utf-8"))
    if path.parent.name == "ISSUE_TEMPLATE":
        assert all(part["attributes"]["label"] for part in document["body"])
    elif path.parent.name == "workflows":
        assert all(job["steps"] for job in document["jobs"].values())


def test_the_top_level_has_nothing_else():
    root = DOCS.parent
    if not (root / ".git").exists() or shutil.which("git") is None:
        pytest.skip("not a checkout")
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("git does not read this checkout")
    named = {name.partition("/")[0] for name in listed.stdout.split("\0") if name}
    folders = {"benchmarks", "docs", "fitting", "gyrotrack", "sample_clips", "tests"}
    files = {"CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "LICENSE", "README.md", "pyproject.toml"}
    assert {name for name in named if not name.startswith(".")} == folders | files
