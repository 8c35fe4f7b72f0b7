"""The claimed uncertainty is the real one: z = error / sigma over many films of the package's own oracle."""

import numpy as np
import pytest

from gyrotrack.synthetic._film import render_clip
from gyrotrack.synthetic._scene import Camera, Light, Motion, Scene, Wobble
from gyrotrack.tracking._extract import extract

pytestmark = pytest.mark.slow

LIGHT = Light(gradient=(0.2, -0.1), vignette=0.15, flicker=0.04, glint=0.1, shadow=0.3)
SPAN = np.linspace(-0.1, 4.0, 60)


def _film(path, seed, camera, omega_rotor, omega_casing, frames):
    motion = Motion.from_speeds(
        SPAN, omega_rotor - 15 * SPAN, omega_casing + 5 * SPAN, 0.3 + seed, 0.7 * seed
    )
    scene = Scene(
        wobble=Wobble(0.08, 3.0 + 0.4 * seed, phase=seed), table=("grey", "white", "wood")[seed % 3]
    )
    return render_clip(path, scene, motion, camera, LIGHT, frames=frames, seed=seed)


def _z(recording, truth, body):
    track = recording.bodies[body]
    frame = np.rint(track.time * recording.capture_fps).astype(int)
    error = track.angle - truth.angle[body][frame]
    return (error - np.median(error)) / track.sigma, error - np.median(error)


NOISE = (1.0, 4.0, 1.0, 4.0)


@pytest.mark.release
def test_casing_clips(tmp_path):
    z, errors = [], []
    for seed, noise in enumerate(NOISE):
        camera = Camera(
            480, 360, 260.0, exposure=1e-3, scale=4.7, tilt=0.05 * seed, tilt_azimuth=seed, noise=noise
        )
        truth = _film(tmp_path / f"{seed}.mp4", seed, camera, 350.0, 40.0 + 25 * seed, 180)
        deviation, error = _z(extract(tmp_path / f"{seed}.mp4"), truth, "casing")
        z.append(deviation)
        errors.append(error)
    together = np.concatenate(z)
    # The spread of z of one film is itself uncertain by about a tenth: errors hang together over some frames.
    assert 0.8 < np.std(together) < 1.25
    assert (np.abs(together) > 5).mean() < 2e-3
    assert np.std(np.concatenate(errors)) < 2.5e-3


@pytest.mark.release
def test_rotor_clips(tmp_path):
    z = {"casing": [], "rotor": []}
    errors = []
    for seed, noise in enumerate(NOISE):
        camera = Camera(
            480, 360, 1000.0, exposure=0.6e-3, scale=4.9, tilt=0.04 * seed, tilt_azimuth=seed, noise=noise
        )
        truth = _film(tmp_path / f"{seed}.mp4", seed, camera, 310.0 + 97 * seed, 55.0 + 18 * seed, 200)
        recording = extract(tmp_path / f"{seed}.mp4")
        for body, found in z.items():
            deviation, error = _z(recording, truth, body)
            found.append(deviation)
            if body == "rotor":
                errors.append(error)
    for body, found in z.items():
        together = np.concatenate(found)
        assert 0.8 < np.std(together) < 1.25, body
        assert (np.abs(together) > 5).mean() < 2e-3, body
    assert np.std(np.concatenate(errors)) < 1.6e-3
