"""One film with its answers: draw, encode, and hand back the truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrotrack.errors import OutputError
from gyrotrack.synthetic.film import Film, write_film
from gyrotrack.synthetic.motion import Motion
from gyrotrack.synthetic.optics import Camera, Light
from gyrotrack.synthetic.render import Renderer
from gyrotrack.synthetic.scene import Scene
from gyrotrack.synthetic.truth import Truth, find_truth

Progress = Callable[[int, int | None], None]


def render_clip(
    path: Path,
    scene: Scene,
    motion: Motion,
    camera: Camera,
    light: Light | None = None,
    *,
    frames: int,
    film: Film | None = None,
    seed: int = 0,
    truth: Path | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> Truth:
    """Draw a film of a scene with a known motion, and return what a perfect tracker would find in it.

    Parameters
    ----------
    path : Path
        The mp4 file to write.
    scene, motion, camera, light
        What is drawn: see `Scene`, `Motion`, `Camera`, `Light`.
    frames : int
        Length of the film; ``camera.start`` is the true time of its first frame.
    film : Film, optional
        Quality and kind of the compression.
    seed : int
        The same seed draws the same film.
    truth : Path, optional
        Where to write the truth as well (.npz or .json). Without it the truth is only returned.
    force : bool
        Replace existing files.
    progress : callable, optional
        Called with (frames drawn, frames in all).

    Raises
    ------
    OutputError
        If a file exists already or cannot be written.
    ValueError
        If the motion is not known over the whole film.

    Examples
    --------
    >>> from pathlib import Path
    >>> from gyrotrack.synthetic import Camera, Motion, Scene, render_clip
    >>> motion = Motion.constant(omega_rotor=400.0, omega_casing=60.0)
    >>> truth = render_clip(Path("casing.mp4"), Scene(), motion, Camera(), frames=260)  # doctest: +SKIP
    """
    if truth is not None and Path(truth).exists() and not force:
        raise OutputError(f"{truth} exists already.", "Give another name, or ask for it to be replaced.")
    renderer = Renderer(scene, motion, camera, light, seed=seed)
    write_film(
        path,
        _counted(renderer.frames(frames), frames, progress),
        width=camera.width,
        height=camera.height,
        fps=camera.fps,
        container_fps=camera.container_fps,
        film=film,
        force=force,
    )
    answers = find_truth(scene, motion, camera, frames)
    if truth is not None:
        answers.save(Path(truth))
    return answers


def _counted(
    pictures: Iterator[NDArray[np.uint8]], total: int, progress: Progress | None
) -> Iterator[NDArray[np.uint8]]:
    """Pass pictures on and tell how many."""
    for done, picture in enumerate(pictures, start=1):
        yield picture
        if progress is not None:
            progress(done, total)
