"""Draw one good and five poor films of the same rotor: `python docs/make_film_guide.py`.

The picture is shown by the start page of the workbench and by docs/how-to/film-an-experiment.md.

Each film is rendered with one fault, tracked, and compared with the angle that was rendered. The text of a panel states
the standard deviation of the error of the rotor's angle, without its constant, and the share of frames that have one.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np

import gyrotrack
from gyrotrack.synthetic._film import find_truth, render_clip
from gyrotrack.synthetic._render import Renderer
from gyrotrack.synthetic._scene import PAPERS, Camera, Light, Motion, Scene

TARGET = Path(__file__).parents[1] / "gyrotrack" / "apps" / "workbench" / "filming.jpg"
FRAMES = 600
MOTION = Motion.constant(omega_rotor=300.0, omega_casing=15.0)
SCENE, LIGHT = Scene(table="grey"), Light(shadow=0.2)
CAMERA = Camera(width=480, height=360, fps=1000.0, exposure=2.0e-4, scale=4.9, noise=2.0, start=0.1)
PANELS: tuple[tuple[str, Scene, Camera, Light], ...] = (
    ("As it should be: 1/5000 s, bright, no reflections", SCENE, CAMERA, LIGHT),
    ("Exposure 1/1000 s: motion blur over 17°", SCENE, replace(CAMERA, exposure=1.0e-3), LIGHT),
    ("Too dark: the sensor's noise dominates", SCENE, replace(CAMERA, noise=9.0), replace(LIGHT, level=0.12)),
    ("A lamp is reflected by the metal", SCENE, CAMERA, replace(LIGHT, glint=0.7)),
    ("Camera near and tilted by 20°", SCENE, replace(CAMERA, tilt=0.35, perspective=1.0 / 250.0), LIGHT),
    (
        "Markers half as large and near the axis",
        replace(SCENE, markers=tuple(replace(p, near=8.0, length=4.5, base=3.0) for p in PAPERS)),
        CAMERA,
        LIGHT,
    ),
)


def measured(folder: Path, number: int, scene: Scene, camera: Camera, light: Light) -> str:
    """Return the result of tracking a film: standard deviation of the error, share of frames with an angle."""
    path = folder / f"{number}.mp4"
    truth = render_clip(path, scene, MOTION, camera, light, frames=FRAMES, seed=number)
    try:
        recording = gyrotrack.extract(path, capture_fps=camera.fps)
    except gyrotrack.GyrotrackError as error:
        return error.message
    if "rotor" not in recording.bodies:
        return "the rotor is not found"
    body = recording.bodies["rotor"]
    error = body.angle - np.interp(body.time, truth.clip_time, truth.angle["rotor"])
    return f"error {1e3 * error.std():.1f} mrad, {100 * len(error) / FRAMES:.0f} % of the frames"


def draw() -> None:
    """Render, track and draw all panels."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    truth = find_truth(SCENE, MOTION, CAMERA, FRAMES)
    shown = truth.time[np.argmax(np.min(list(truth.visible.values()), axis=0))]
    figure, axes = plt.subplots(2, 3, figsize=(10.5, 6.0), layout="constrained")
    with tempfile.TemporaryDirectory() as place:
        for number, (axis, (title, scene, camera, light)) in enumerate(zip(axes.flat, PANELS, strict=True)):
            axis.imshow(Renderer(scene, MOTION, camera, light, seed=number).frame(shown))
            axis.set_title(title, fontsize=10)
            axis.set_xlabel(measured(Path(place), number, scene, camera, light), fontsize=10)
            axis.set(xticks=[], yticks=[])
    figure.savefig(TARGET, dpi=100, pil_kwargs={"quality": 80})


if __name__ == "__main__":
    draw()
