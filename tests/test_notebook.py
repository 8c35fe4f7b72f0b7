"""The notebooks of the tutorial run as they stand, from the films to the effect."""

import json
from pathlib import Path
from typing import Any

import pytest

import gyrotrack

ROOT = Path(__file__).parents[1]
TUTORIAL = ROOT / "docs/tutorial"


def cells_of(name: str) -> list[dict[str, Any]]:
    """Return the code cells of a notebook."""
    notebook = json.loads((TUTORIAL / name).read_text(encoding="utf-8"))
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def run(name: str) -> dict[str, Any]:
    """Execute a notebook in the current folder and return its variables."""
    pytest.importorskip("matplotlib").use("agg")
    names: dict[str, Any] = {}
    for cell in cells_of(name):
        exec(compile("".join(cell["source"]), cell["id"], "exec"), names)  # noqa: S102 - our own notebook
    return names


@pytest.mark.parametrize("name", ["missing_effect.ipynb", "wheel.ipynb"])
def test_notebooks_are_stored_with_the_outputs_of_all_cells(name):
    outputs = [cell["outputs"] for cell in cells_of(name)]
    assert all(outputs)
    assert not [o for cell in outputs for o in cell if o["output_type"] == "error"]
    assert len(json.dumps(outputs)) < 220_000


@pytest.mark.slow
def test_the_notebook_names_the_hidden_effect(demo, tmp_path, monkeypatch):
    place = tmp_path / "docs" / "tutorial"
    place.mkdir(parents=True)
    (tmp_path / "sample_clips").symlink_to(ROOT / "sample_clips")
    monkeypatch.chdir(place)

    def tracked(film, capture_fps):
        """Return what the demo tracked in the same film with the same function."""
        assert film.is_file()
        recording = gyrotrack.read(demo[1] / f"{film.stem}.h5")
        assert recording.capture_fps == capture_fps
        return recording

    monkeypatch.setattr(gyrotrack, "extract", tracked)
    names = run("missing_effect.ipynb")
    truth = json.loads((ROOT / "sample_clips/truth.json").read_text(encoding="utf-8"))
    assert names["history"][-1].change == f"+{truth['hidden_effect']}"
    drag = names["final"].estimates["casing.air.quadratic.k"]
    assert abs(drag.value - truth["hidden_parameters"]["k"]) < 4 * drag.stderr


@pytest.mark.release
@pytest.mark.slow
def test_the_notebook_of_the_wheel_finds_the_law_that_was_drawn(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = run("wheel.ipynb")
    assert [step.change for step in names["history"]] == ["", "+casing.air.quadratic"]
    final = names["final"]
    for name, true in (("b1", 0.5), ("k", 0.004)):
        found = final.params[name]
        assert abs(found.value - true) < 4 * found.stderr
        assert found.stderr < 0.01 * true
    assert abs(names["ghost"].difference).max(axis=1) == pytest.approx([0.97, 0.0], abs=0.003)
