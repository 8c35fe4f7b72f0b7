"""The drawn frames agree with the answers given beside them, to a few hundredths of a pixel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrotrack.synthetic._film import find_truth
from gyrotrack.synthetic._render import Renderer
from gyrotrack.synthetic._scene import Camera, Light, Marker, Motion, Scene, Wobble

Array = NDArray[np.float64]

# Linear grey levels and no noise: what is measured on the frames is then a plain integral.
EXACT = Camera(width=240, height=240, scale=3.4, exposure=0.0, gamma=1.0, noise=0.0)
PAPER = Marker("paper", "rotor", (0.9, 0.9, 0.9), 0.0, 12.0, 8.0, 6.5)
BARE = Scene(markers=(PAPER,), bar_width=0.0, hub_radius=0.0, circle_radius=0.0, structure=0.0, metal=0.1)


def standing(psi_rotor: float = 0.0, psi_casing: float = 0.0) -> Motion:
    return Motion.constant(0.0, 0.0, psi_rotor, psi_casing)


def weights(scene: Scene, motion: Motion, camera: Camera, times: Array) -> list[Array]:
    """How much light the papers add to each pixel: the frames with them less the frames without."""
    with_papers = Renderer(scene, motion, camera)
    without = Renderer(replace(scene, markers=()), motion, camera)
    return [(with_papers.frame(t).astype(float) - without.frame(t)).sum(axis=2) for t in np.atleast_1d(times)]


def weight(scene: Scene, motion: Motion, camera: Camera) -> Array:
    return weights(scene, motion, camera, np.zeros(1))[0]


def at_angles(angles: Array, camera: Camera) -> tuple[Motion, Camera, Array]:
    """A motion, a camera and times with the rotor at these evenly spaced angles, all standing still."""
    camera = replace(camera, exposure=0.0, fps=1.0 / (angles[1] - angles[0]))
    return Motion.constant(1.0, 0.0, psi_rotor=angles[0]), camera, camera.times(angles.size)


def centroid(image: Array) -> Array:
    y, x = np.indices(image.shape)
    return np.array([(image * x).sum(), (image * y).sum()]) / image.sum()


def circular_mean(image: Array, centre: Array, sense: int) -> float:
    y, x = np.indices(image.shape)
    angle = sense * np.arctan2(-(y - centre[1]), x - centre[0])
    return float(np.angle((image * np.exp(1j * angle)).sum()))


@pytest.mark.parametrize("sense", [-1, 1])
def test_centroid_is_exact_at_every_angle(sense: int) -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 25)[:-1]
    motion, camera, times = at_angles(angles, replace(EXACT, sense=sense, centre=(119.8, 120.3)))
    corners = find_truth(BARE, motion, camera, 24).corners["paper"]
    found = np.array([centroid(image) for image in weights(BARE, motion, camera, times)])
    error = found - corners.mean(axis=1)
    assert np.abs(error).max() < 0.02  # px
    assert np.abs(error.mean(axis=0)).max() < 0.003  # px: no bias towards the pixel grid


def test_angle_has_no_bias_over_fine_steps() -> None:
    angles = np.linspace(0.3, 0.4, 21)
    motion, camera, times = at_angles(angles, EXACT)
    images = weights(BARE, motion, camera, times)
    error = [circular_mean(image, np.array(camera.rest), camera.sense) for image in images] - angles
    assert np.abs(error).max() < 4e-4  # rad, 0.02 px at 15 mm
    assert np.std(error) < 2e-4


def test_edges_stand_where_they_should() -> None:
    from scipy.ndimage import map_coordinates

    motion = standing(0.77)
    image = weight(BARE, motion, EXACT)
    corners = find_truth(BARE, motion, EXACT, 1).corners["paper"][0]
    across = corners[1] - corners[0]
    middle, outward = corners[:2].mean(axis=0), corners[2] - corners[1]
    for start, direction in ((middle, outward), (corners[0] + 0.5 * outward, across)):
        unit = direction / np.hypot(*direction)
        reach = np.linspace(-3.0, 3.0, 601)
        line = start + reach[:, None] * unit
        profile = map_coordinates(image, [line[:, 1], line[:, 0]], order=3)
        level = 0.5 * (profile[-1] + profile[0])
        place = np.interp(level, profile, reach)
        assert abs(place) < 0.03  # px


@pytest.mark.parametrize("smear", [0.05, pytest.param(0.3, marks=pytest.mark.slow), 0.7])
def test_smeared_paper_has_the_angle_of_mid_exposure(smear: float) -> None:
    exposure = 1.0e-3
    motion = Motion.constant(smear / exposure, 0.0, psi_rotor=1.234)
    camera = replace(EXACT, exposure=exposure)
    times = np.array([0.0, 0.0137, 0.271])
    still = weights(BARE, motion, EXACT, times)[0]
    for time, image in zip(times, weights(BARE, motion, camera, times), strict=True):
        seen = circular_mean(image, np.array(camera.rest), camera.sense)
        off = np.angle(np.exp(1j * (seen - float(motion.psi_rotor(time)))))
        assert abs(off) < 5e-4
        assert image.sum() == pytest.approx(still.sum(), rel=5e-3)


def test_smear_spreads_as_a_box() -> None:
    camera = replace(EXACT, exposure=1.0e-3)
    y, x = np.indices((240, 240))
    angle = np.arctan2(-(y - camera.rest[1]), x - camera.rest[0])
    moments = []
    for speed in (0.0, 600.0):
        image = weight(BARE, Motion.constant(speed, 0.0), camera)
        moments.append(abs((image * np.exp(1j * angle)).sum() / image.sum()))
    assert moments[1] / moments[0] == pytest.approx(np.sinc(0.6 / 2.0 / np.pi), rel=1e-3)


@pytest.mark.slow
def test_long_exposure_is_the_mean_of_short_ones() -> None:
    """Bar and papers move through each other: nothing but summing knows the answer."""
    exposure, parts = 1.5e-3, 30
    scene = replace(Scene(), structure=0.0)
    camera = replace(EXACT, exposure=exposure)
    motion = Motion.constant(400.0, 90.0, psi_rotor=0.5, psi_casing=2.3)
    short = Renderer(scene, motion, replace(camera, exposure=exposure / parts))
    time = 0.0123
    late = ((np.arange(parts) + 0.5) / parts - 0.5) * exposure
    expected = np.mean([short.frame(time + t).astype(np.float64) for t in late], axis=0)
    difference = np.abs(Renderer(scene, motion, camera).frame(time) - expected)
    assert difference.max() < 4.0  # of 255, where edges cross
    assert difference.mean() < 0.3  # rounding


@pytest.mark.slow
def test_visible_share_is_what_is_seen() -> None:
    scene = replace(Scene(), markers=(PAPER,), structure=0.0)
    camera = replace(EXACT, exposure=0.5e-3)
    full = weight(replace(BARE, metal=scene.metal), standing(), camera).sum()
    motion = Motion.constant(300.0, 20.0)  # psi_r - psi_c = 280 t
    camera = replace(camera, fps=280.0 * 24.0 / np.pi)
    truth = find_truth(scene, motion, camera, 25)
    seen = [image.sum() / full for image in weights(scene, motion, camera, truth.time)]
    share = truth.visible["paper"]
    assert share.min() < 0.1
    assert share.max() == pytest.approx(1.0)
    assert np.allclose(seen, share, atol=0.012)


def test_paper_outside_the_picture_is_not_seen() -> None:
    camera = replace(EXACT, centre=(119.5 + 65.0, 119.5))
    truth = find_truth(BARE, standing(0.0), camera, 1)
    x = truth.corners["paper"][0][:, 0]
    expected = (239.5 - x.min()) / (x.max() - x.min())
    assert truth.visible["paper"][0] == pytest.approx(expected, abs=1e-3)


def test_tilt_makes_an_ellipse() -> None:
    camera = replace(EXACT, tilt=0.3, tilt_azimuth=0.9)
    angles = np.linspace(0.0, 2.0 * np.pi, 25)[:-1]
    motion, camera, times = at_angles(angles, camera)
    expected = find_truth(BARE, motion, camera, 24).corners["paper"].mean(axis=1)
    centres = np.array([centroid(image) for image in weights(BARE, motion, camera, times)])
    assert np.abs(centres - expected).max() < 0.03
    spread = np.linalg.svd(centres - centres.mean(axis=0), compute_uv=False)
    assert spread[1] / spread[0] == pytest.approx(np.cos(0.3), abs=1e-3)


def test_perspective_agrees_with_the_projected_corners() -> None:
    camera = replace(EXACT, tilt=0.4, perspective=1.0 / 150.0)
    motion = standing(2.0)
    corners = find_truth(BARE, motion, camera, 1).corners["paper"][0]
    x, y = corners.T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    area = cross.sum() / 2.0
    middle = [((v + np.roll(v, -1)) * cross).sum() / (6.0 * area) for v in (x, y)]
    assert np.abs(centroid(weight(BARE, motion, camera)) - middle).max() < 0.03


def test_wobble_moves_the_centre() -> None:
    scene = replace(Scene(), structure=0.0, wobble=Wobble(0.4, 5.0, 0.3))
    none = replace(scene, circle_colour=(scene.ring_metal * 1.1,) * 3)
    truth = find_truth(scene, standing(), replace(EXACT, fps=50.0), 6)
    assert np.ptp(truth.centre) > 2.0
    red, grey = Renderer(scene, standing(), EXACT), Renderer(none, standing(), EXACT)
    for time, centre in zip(truth.time, truth.centre, strict=True):
        circle = red.frame(time)[:, :, 0].astype(float) - grey.frame(time)[:, :, 0]
        assert np.abs(centroid(circle) - centre).max() < 0.02


def test_rolling_shutter_delays_rows() -> None:
    camera = replace(EXACT, readout=3.0e-3, sense=1)
    motion = Motion.constant(50.0, 0.0, psi_rotor=np.pi / 2)
    seen = circular_mean(weight(BARE, motion, camera), np.array(camera.rest), 1)
    # The paper stands straight above the centre, about 16 mm or 54 of 239 rows earlier.
    expected = np.pi / 2 + 50.0 * 3.0e-3 * (-16.0 * 3.4 / 239.0)
    assert seen == pytest.approx(expected, abs=2e-3)


def test_flicker_is_averaged_over_the_exposure() -> None:
    light = Light(flicker=0.2, flicker_hz=100.0)
    camera = replace(EXACT, exposure=4.0e-3, fps=900.0)
    renderer = Renderer(replace(BARE, table="white"), standing(), camera, light)
    times = camera.times(27)
    brightness = np.array([renderer.frame(t)[:20].mean() for t in times])
    design = np.stack([np.ones(27), np.sin(2 * np.pi * 100 * times), np.cos(2 * np.pi * 100 * times)], axis=1)
    mean, sine, cosine = np.linalg.lstsq(design, brightness, rcond=None)[0]
    assert np.hypot(sine, cosine) / mean == pytest.approx(0.2 * np.sinc(0.4), rel=0.01)


def test_noise_has_the_given_deviation_and_the_seed_repeats_it() -> None:
    camera = replace(EXACT, noise=3.0)
    clean = Renderer(BARE, standing(), EXACT, seed=5).frame(0.0).astype(float)
    first, second = (list(Renderer(BARE, standing(), camera, seed=5).frames(3)) for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))
    assert not np.array_equal(first[0], first[1])
    noise = np.array(first) - clean
    assert noise.std() == pytest.approx(np.hypot(3.0, 12**-0.5), rel=0.02)
    assert abs(noise.mean()) < 0.05


def test_shadow_and_glint_only_change_brightness_not_places() -> None:
    light = Light(shadow=0.4, glint=0.1, gradient=(0.2, -0.1), vignette=0.2)
    scene = replace(
        Scene(), structure=0.0, markers=(Marker("red", "casing", (0.9, 0.1, 0.1), 0.4, 16.0, 9.0, 6.0),)
    )
    frame = Renderer(scene, standing(0.0, 0.3), EXACT, light).frame(0.0).astype(float)
    share = frame[:, :, 0] - frame[:, :, 1]
    y, x = np.indices(share.shape)
    share[np.hypot(x - 119.5, y - 119.5) < 14.0 * 3.4] = 0.0
    share[share < 10.0] = 0.0
    expected = find_truth(scene, standing(0.0, 0.3), EXACT, 1).corners["red"][0].mean(axis=0)
    assert np.abs(centroid(share) - expected).max() < 0.3  # uneven light tilts the weight a little


def test_motion_must_cover_the_film() -> None:
    time = np.linspace(0.0, 0.1, 50)
    motion = Motion.from_speeds(time, np.full(50, 100.0), np.full(50, 10.0))
    with pytest.raises(ValueError, match="known from"):
        list(Renderer(BARE, motion, replace(EXACT, start=-0.05)).frames(2))


def test_sense_and_size_are_checked() -> None:
    with pytest.raises(ValueError, match="clockwise"):
        Camera(sense=0)
    with pytest.raises(ValueError, match="even"):
        Camera(width=321)
