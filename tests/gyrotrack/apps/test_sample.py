"""The sample study of the installed package: the films of the checkout."""

from pathlib import Path

import pytest

from gyrotrack.apps import _sample
from gyrotrack.apps.cli import _simulation
from gyrotrack.apps.cli._app import run
from gyrotrack.apps.workbench._project import Project

CHECKOUT = Path(__file__).parents[3] / "sample_clips"


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """The package as it is without a checkout around it."""
    package = tmp_path / "site-packages" / "gyrotrack"
    (package / "apps").mkdir(parents=True)
    (package / "sample_clips").symlink_to(CHECKOUT)
    monkeypatch.setattr(_sample, "__file__", str(package / "apps" / "_sample.py"))
    monkeypatch.chdir(tmp_path)
    return package / "sample_clips"


def test_a_wheel_contains_them():
    """The build installs what the study lists; an editable installation finds the checkout."""
    rules = (CHECKOUT.parent / "gyrotrack" / "_native" / "CMakeLists.txt").read_text("utf-8")
    block = rules[rules.index("install(") : rules.index("endif()")]
    assert "../../sample_clips/" in block
    assert "DESTINATION gyrotrack/sample_clips" in block
    assert _sample.sample_folder() == CHECKOUT


def test_page_and_demo_find_them_without_a_checkout(installed, tmp_path):
    assert _sample.sample_folder() == installed
    folder = tmp_path / "work"
    folder.mkdir()
    project = Project(folder)
    project.add_samples()
    assert [x.capture_fps for x in project.state.sources] == [260.0, 1000.0, 1000.0, 1000.0]
    assert project.document()["missing"]["track"] == []
    project.close()


def test_the_demo_analyses_the_films_of_the_package(installed, monkeypatch):
    """`demo` itself runs in the tests of the examples."""
    seen = []

    def tracked(_, folder, *given, **settings):
        seen.append(folder)
        raise KeyboardInterrupt

    monkeypatch.setattr(_simulation, "_extract", tracked)
    assert run(["demo", "-o", "out", "-q"]) == 130
    assert seen == [installed]
