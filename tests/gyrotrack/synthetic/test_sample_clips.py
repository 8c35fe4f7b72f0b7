"""The clips in the repository are those that their script draws."""

from __future__ import annotations

import importlib.util
import json
import tomllib
from pathlib import Path
from types import ModuleType

import av
import numpy as np
import pytest

from gyrotrack.synthetic._film import find_truth
from gyrotrack.synthetic._render import Renderer

FOLDER = Path(__file__).parents[3] / "sample_clips"


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_sample_clips", FOLDER / "make_sample_clips.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_together_they_stay_small() -> None:
    assert sum(path.stat().st_size for path in FOLDER.iterdir() if path.is_file()) < 25e6


def test_notes_and_truth_are_those_of_the_script(script: ModuleType) -> None:
    films, motion = script.clips(), script.run()
    truths = {name: find_truth(script.SCENE, motion, *film) for name, film in films.items()}
    assert (FOLDER / "study.toml").read_text() == script.study(films)
    assert tomllib.loads(script.study(films))["clip"][1] == {
        "file": "rotor_1.mp4",
        "body": "rotor",
        "capture_fps": 1000,
    }
    kept = json.loads((FOLDER / "truth.json").read_text())
    drawn = json.loads(json.dumps(script.answers(motion, truths)))
    assert kept["hidden_effect"] == drawn["hidden_effect"]
    for name, clip in drawn["clips"].items():
        for key, value in clip.items():
            assert kept["clips"][name][key] == pytest.approx(value, rel=1e-6, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["casing", "rotor_1", "rotor_2", "rotor_3"])
def test_first_frames_are_those_of_the_script(script: ModuleType, name: str) -> None:
    camera, frames = script.clips()[name]
    renderer = Renderer(script.SCENE, script.run(), camera, script.LIGHT)
    with av.open(str(FOLDER / f"{name}.mp4")) as container:
        stream = container.streams.video[0]
        assert stream.frames == frames
        assert stream.average_rate == (camera.container_fps or camera.fps)
        picture = next(container.decode(stream)).to_ndarray(format="gray").astype(float)
    drawn = renderer.frame(camera.start) @ np.array([0.2126, 0.7152, 0.0722])
    assert np.abs(picture - drawn).mean() < 3.0  # grey levels; the noise alone is 2
    assert np.abs(picture - drawn[:, ::-1]).mean() > 4.0
