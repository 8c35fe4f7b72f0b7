"""The notebook of the tutorial runs as it stands, from the films to the effect."""

import json
from pathlib import Path

import pytest

import gyrotrack

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
def test_the_notebook_names_the_hidden_effect(demo, tmp_path, monkeypatch):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("agg")
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
    notebook = json.loads((ROOT / "docs/tutorial/missing_effect.ipynb").read_text(encoding="utf-8"))
    names: dict = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), cell["id"], "exec"), names)  # noqa: S102 - our own notebook
    truth = json.loads((ROOT / "sample_clips/truth.json").read_text(encoding="utf-8"))
    assert names["history"][-1].change == f"+{truth['hidden_effect']}"
    drag = names["final"].estimates["casing.air.quadratic.k"]
    assert abs(drag.value - truth["hidden_parameters"]["k"]) < 4 * drag.stderr
    assert all(cell.get("outputs") != [] for cell in notebook["cells"][3:] if cell["cell_type"] == "code")
