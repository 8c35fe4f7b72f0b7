"""A slow casing seen from a slant: its rotor tells the tilt on an arc, and perspective from an axis beside."""

from dataclasses import replace

import numpy as np
import pytest

from gyrotrack.synthetic._film import render_clip
from gyrotrack.synthetic._scene import Camera, Light, Motion, Scene, Wobble
from gyrotrack.tracking._extract import extract

CAMERA = Camera(320, 240, 1000.0, exposure=0.4e-3, scale=3.4, tilt=0.25, tilt_azimuth=0.7, noise=3.0)
LIGHT = Light(gradient=(0.2, -0.1), flicker=0.04, shadow=0.3)
NEAR = 1.0 / 250.0
"""A camera at 25 cm, eight times as far as the gyroscope is wide."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("turn", "fps", "perspective"), [(1.2, 1000.0, 0.0), (3.0, 1000.0, NEAR), (20.0, 260.0, NEAR)]
)
def test_a_slow_casing_is_as_exact_as_seen_from_above(tmp_path, turn, fps, perspective):
    frames, errors = 240, {}
    camera = replace(CAMERA, fps=fps, perspective=perspective)
    motion = Motion.constant(330.0, turn * fps / frames, 0.3, 0.9)
    scene = Scene(wobble=Wobble(0.08, 3.0))
    for seed in (3, 4):  # the centre of an arc is one draw in each film
        film = tmp_path / f"film_{seed}.mp4"
        truth = render_clip(film, scene, motion, camera, LIGHT, frames=frames, seed=seed)
        recording = extract(film, capture_fps=fps, threads=1)
        for body, track in recording.bodies.items():
            error = track.angle - truth.angle[body][np.rint(track.time * fps).astype(int)]
            error -= np.median(error)
            assert 0.4 < np.std(error / track.sigma) < 1.5, body
            errors.setdefault(body, []).append(np.std(error))
    for body, each in errors.items():
        assert np.sqrt(np.mean(np.square(each))) < 2.2e-3, body
