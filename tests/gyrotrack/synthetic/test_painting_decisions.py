"""Paint, light and geometry of the renderer: a few pixels, each computed from its formula."""

import math

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.special import ndtr

from gyrotrack.synthetic import _film, _render
from gyrotrack.synthetic._film import find_truth, to_planes
from gyrotrack.synthetic._render import (
    FULL,
    Noise,
    PolarPicture,
    Renderer,
    cut_window,
    paint_casing,
    paint_rotor,
    paint_table,
)
from gyrotrack.synthetic._scene import BLUE, RED, Camera, Light, Marker, Motion, Scene, Wobble

SMALL = Camera(
    width=96, height=80, scale=1.2, psf=0.6, noise=0.0, tilt=0.2, tilt_azimuth=0.7, fps=100.0, exposure=2e-3
)
STILL = Motion.constant(0.0, 0.0)
STEP = 0.5  # largest error of a stored value


def polar(picture):
    rows, columns = picture.pixels.shape[:2]
    r = np.arange(rows)[:, None] / picture.per_mm
    theta = 2 * np.pi * np.arange(columns) / columns
    return r, np.broadcast_to(theta, (rows, columns))


def box(x, low, high, sigma):
    return ndtr((x - low) / sigma) - ndtr((x - high) / sigma)


def paper_cover(marker, r, theta, sigma):
    x, y = r * np.cos(theta - marker.mount) - marker.near, r * np.sin(theta - marker.mount)
    along = x * math.cos(marker.skew) + y * math.sin(marker.skew)
    across = y * math.cos(marker.skew) - x * math.sin(marker.skew)
    return box(along, 0, marker.length, sigma) * box(across, -marker.base / 2, marker.base / 2, sigma)


SCENE = Scene(
    markers=(
        Marker("a", "rotor", BLUE, 0.6, 12.0, 9.0, 6.0, 0.2),
        Marker("b", "casing", RED, 1.9, 16.0, 8.0, 5.0),
    )
)
SIGMA = 0.6 / 1.2


def test_paint_of_the_rotor():
    picture = paint_rotor(SCENE, SMALL)
    r, theta = polar(picture)
    assert picture.per_mm == pytest.approx(1.4 * 1.2)
    assert picture.columns == math.ceil(2 * math.pi * 31.5 * 1.2 * 1.4 / 8) * 8
    assert len(r) == math.ceil(35.5 * picture.per_mm) + 2
    lathe = 1 + 0.06 * (np.sin(3.1 * r) + 0.6 * np.sin(7.7 * r + 1))
    uneven = 0.06 * (0.5 * np.sin(5 * theta + 0.4) + 0.5 * np.sin(11 * theta + 2))
    metal = 0.2 * (lathe + uneven * np.minimum(r / 26, 1))
    disc = ndtr((26 - r) / SIGMA) * np.ones_like(theta)
    cover = paper_cover(SCENE.markers[0], r, theta, SIGMA)
    for k in range(3):
        light = disc * metal * (1, 1, 1.02)[k] + (1 - disc) * (0.02, 0.02, 0.022)[k]
        light = cover * BLUE[k] + (1 - cover) * light
        np.testing.assert_allclose(picture.pixels[..., k], light * FULL, atol=STEP)
    np.testing.assert_allclose(picture.pixels[..., 3], disc * (1 - cover) * FULL, atol=STEP)


@pytest.mark.parametrize("bar", [7.0, 0.0])
def test_paint_of_the_casing(bar):
    picture = paint_casing(
        Scene(markers=SCENE.markers, bar_width=bar, circle_radius=3.4 if bar else 0.0), SMALL
    )
    r, theta = polar(picture)
    y = r * np.sin(theta)
    bright = 1 + 0.06 * (np.sin(3 * theta + 1.3) + 0.7 * np.sin(8 * theta))
    bevel = np.where(r > 27.5, 1 + 0.25 * np.sin(np.pi * (r - 27.5) / 4), 1)
    layers = [(box(r, 27.5, 31.5, SIGMA) * np.ones_like(theta), 0.3 * bright * bevel, (1, 0.99, 0.97))]
    if bar:
        layers.append((box(y, -3.5, 3.5, SIGMA) * ndtr((29.5 - r) / SIGMA), 0.27, (1, 0.99, 0.97)))
        layers.append((ndtr((5 - r) / SIGMA), 0.33, (1, 0.99, 0.97)))
    layers.append((paper_cover(SCENE.markers[1], r, theta, SIGMA), 1.0, RED))
    if bar:
        layers.append((ndtr((3.4 - r) / SIGMA), 1.0, RED))
    colour, clear = np.zeros((*theta.shape, 3)), np.ones_like(theta)
    for cover, light, tone in layers:
        colour = colour * (1 - cover)[..., None] + (cover * light)[..., None] * np.array(tone)
        clear = clear * (1 - cover)
    np.testing.assert_allclose(picture.pixels[..., :3], colour * FULL, atol=STEP)
    np.testing.assert_allclose(picture.pixels[..., 3], (1 - clear) * FULL, atol=STEP)


@pytest.mark.parametrize("kind", ["grey", "white", "wood"])
def test_paint_of_the_table(kind):
    light = Light(level=0.9, gradient=(0.2, -0.3), vignette=0.1, shadow=0.4, shadow_offset=(0.8, -1.2))
    table = paint_table(Scene(table=kind), SMALL, light, seed=3)
    x, y = np.meshgrid(np.arange(96.0), np.arange(80.0))
    u, v = SMALL.unproject(x, y)
    if kind == "wood":
        plank = np.floor((v + 200) / 38)
        offset = (plank * 0.618) % 1
        bend = 0.8 * np.sin(0.045 * u + 9 * offset) + 0.3 * np.sin(0.11 * u + 4 * offset)
        rings = np.sin(1.9 * (v + 4 * bend) + 20 * offset) + 0.5 * np.sin(5.3 * (v + 3 * bend))
        joint = 1 - 0.5 * np.exp(-0.5 * (((v + 200) % 38 - 0.4) / 0.35) ** 2)
        grain = (0.9 + 0.25 * offset + 0.1 * rings) * joint
    else:
        rng = np.random.default_rng(3)
        waves = rng.uniform(0.2, 1.2, (6, 2)) * rng.choice([-1.0, 1.0], (6, 2))
        grain = 1 + 0.012 * sum(
            np.sin(a * u + b * v + p) for (a, b), p in zip(waves, rng.uniform(0, 2 * np.pi, 6), strict=True)
        )
    shade = 1 - 0.4 * ndtr((32.5 - np.hypot(u - 2.4, v + 3.6)) / 3)
    dx, dy = (x - 47.5) / 96, (y - 39.5) / 80
    field = 0.9 * (1 + 0.2 * dx - 0.3 * dy) * (1 - 0.2 * (dx**2 + dy**2))
    np.testing.assert_allclose(light.field(SMALL), field)
    tone = {"grey": (0.13, 0.13, 0.135), "white": (0.72, 0.72, 0.70), "wood": (0.30, 0.17, 0.08)}[kind]
    np.testing.assert_allclose(table, (grain * shade * field)[..., None] * np.array(tone), rtol=1e-9)
    assert (Light(gradient=(-9.0, 0.0)).field(SMALL) >= 0).all()


def test_window_around_the_gyroscope():
    light = Light(glint=0.5)
    wobbling = Scene(markers=SCENE.markers, wobble=Wobble(radius=1.0))
    camera = Camera(width=200, height=160, scale=1.5, psf=0.6, tilt=0.3, tilt_azimuth=0.0)
    table = np.ones((160, 200, 3))
    window = cut_window(wobbling, camera, light, table)
    reach = 31.5 + 1.0 + 5 * 0.6 / 1.5
    half = (reach * 1.5 * math.cos(0.3), reach * 1.5)
    assert abs(window.columns.start - (99.5 - half[0])) <= 1
    assert abs(window.columns.stop - (99.5 + half[0] + 1)) <= 1
    assert abs(window.rows.start - (79.5 - half[1])) <= 1
    assert abs(window.rows.stop - (79.5 + half[1] + 1)) <= 1
    assert window.shape == (window.rows.stop - window.rows.start, window.columns.stop - window.columns.start)
    x, y = np.meshgrid(
        np.arange(window.columns.start, window.columns.stop), np.arange(window.rows.start, window.rows.stop)
    )
    u, v = camera.unproject(x, y)
    r, angle = np.hypot(u, v), np.arctan2(v, u)
    np.testing.assert_allclose(window.u, u, atol=1e-4)
    np.testing.assert_allclose(window.v, v, atol=1e-4)
    inside = r < 29.5
    np.testing.assert_allclose(window.table[1], ~inside)
    np.testing.assert_allclose(window.lamps, 1 / FULL, rtol=1e-6)
    np.testing.assert_allclose(window.lamps_inside, inside / FULL, rtol=1e-6)
    np.testing.assert_array_equal(window.papers, (r > 12 - 2.5) & (r < 21 + 2.5))
    glint = sum(
        s * np.exp(-0.5 * (np.angle(np.exp(1j * (angle - a))) / w) ** 2)
        for a, s, w in ((0.6, 1.0, 0.10), (2.3, 0.7, 0.14), (3.9, 0.9, 0.09), (5.3, 0.6, 0.12))
    )
    np.testing.assert_allclose(
        window.glint, 0.5 / FULL * glint * np.minimum(r / 31.5, 1), atol=1e-9, rtol=1e-4
    )
    near = cut_window(SCENE, Camera(width=40, height=30, scale=1.5), light, np.ones((30, 40, 3)))
    assert (near.rows, near.columns) == (slice(0, 30), slice(0, 40))


@pytest.mark.parametrize("sense", [1, -1])
def test_a_sharp_frame_is_the_sum_of_its_layers(sense):
    camera = Camera(
        width=96, height=96, scale=1.2, noise=0.0, exposure=1e-6, sense=sense, gamma=2.0, centre=(48.0, 46.0)
    )
    light = Light(level=0.8, glint=0.3, shadow=0.4)
    motion = Motion.constant(3.0, 2.0, 0.7, -0.4)
    renderer = Renderer(SCENE, motion, camera, light)
    frame = renderer.frame(0.5)
    window = renderer._window
    rows, columns = window.rows, window.columns

    def sampled(picture, psi, offset=(0.0, 0.0)):
        u, v = window.u - offset[0], window.v - offset[1]
        angle = np.arctan2(sense * v, u)
        place = [np.hypot(u, v) * picture.per_mm, (angle - psi) % (2 * np.pi) * picture.per_rad]
        return [
            map_coordinates(np.pad(c, ((0, 0), (0, 1)), mode="wrap"), place, order=1) / FULL
            for c in picture.pixels.transpose(2, 0, 1).astype(float)
        ]

    rotor, casing = sampled(paint_rotor(SCENE, camera), 2.2), sampled(paint_casing(SCENE, camera), 0.6)
    clear = 1 - casing[3]
    dark = 1 - 0.4 * sampled(paint_casing(SCENE, camera), 0.6, (0.8, -1.2))[3]
    inside = np.hypot(window.u, window.v) < 29.5
    table = paint_table(SCENE, camera, light, 0)[rows, columns]
    glint = window.glint * FULL * (0.7 * casing[3] + rotor[3] * clear * dark)
    for k in range(3):
        total = (
            np.where(inside, 0, table[..., k]) * clear
            + inside * rotor[k] * clear * dark * 0.8
            + casing[k] * 0.8
            + glint
        )
        off = np.abs(255 * np.sqrt(total) - frame[rows, columns, k])
        assert np.median(off) < 0.6
        assert np.quantile(off, 0.97) < 4
    outside = np.ones((96, 96), bool)
    outside[rows, columns] = False
    whole = 255 * np.sqrt(paint_table(SCENE, camera, light, 0))
    assert np.abs(whole - frame)[outside].max() <= 0.51


@pytest.mark.parametrize("gamma", [1.0, 2.0, 3.0])
def test_grey_levels_and_flicker(gamma):
    camera = Camera(width=96, height=80, scale=1.2, noise=0.0, gamma=gamma, exposure=2e-3)
    light = Light(flicker=0.3, flicker_hz=120.0, flicker_phase=0.5)
    renderer = Renderer(SCENE, STILL, camera, light)
    assert renderer._levels(np.array([[0.25, -1.0, 4.0]], np.float32), 0.5).tolist() == [
        [pytest.approx(255 * 0.125 ** (1 / gamma), abs=0.6), 0, 255]
    ]
    time = 0.0031
    pulse = 1 + 0.3 * math.sin(math.pi * 0.24) / (math.pi * 0.24) * math.sin(2 * math.pi * 120 * time + 0.5)
    assert float(light.pulse(time, 2e-3)) == pytest.approx(pulse)
    corner = 255 * (pulse * paint_table(SCENE, camera, light, 0)[0, 0]) ** (1 / gamma)
    assert np.abs(renderer.frame(time)[0, 0] - corner).max() <= 1.1
    rolling = Camera(width=96, height=80, scale=1.2, noise=0.0, gamma=gamma, exposure=2e-3, readout=0.008)
    frame = Renderer(SCENE, STILL, rolling, light).frame(time)
    table = paint_table(SCENE, camera, light, 0)
    for row in (0, 79):
        late = 0.008 * (row - 39.5) / 79
        assert float(rolling.row_delay(row)) == pytest.approx(late)
        bright = float(light.pulse(time + late, 2e-3))
        assert np.abs(frame[row, 0] - 255 * (bright * table[row, 0]) ** (1 / gamma)).max() <= 1.1
    edge = frame[20:60, 48].astype(float)
    plain = Renderer(SCENE, STILL, camera).frame(time)[20:60, 48].astype(float)
    ratio = np.array([float(light.pulse(time + 0.008 * (r - 39.5) / 79, 2e-3)) for r in range(20, 60)]) ** (
        1 / gamma
    )
    assert np.abs(edge - (plain * ratio[:, None]).clip(max=255)).max() <= 2


@pytest.mark.parametrize("width", [1.0, 1.5, 2.0, 3.0, 4.75, 7.0])
def test_blur_is_a_box_of_any_width(width):
    pixels = np.random.default_rng(0).integers(0, 40000, (3, 40, 2)).astype(np.uint16)
    fine = np.repeat(pixels.astype(float), 16, axis=1)
    half = round(width * 8)
    expected = np.stack(
        [
            np.roll(fine, -16 * k - 8, axis=1)[:, -half:].sum(axis=1)
            + np.roll(fine, -16 * k - 8, axis=1)[:, :half].sum(axis=1)
            for k in range(40)
        ],
        axis=1,
    ) / (2 * half)
    np.testing.assert_allclose(_render._box(pixels, width), expected, atol=2)
    picture = PolarPicture(pixels, 1.0)
    twice = picture.blurred(-width / picture.per_rad)
    assert twice.shape == (3, 81, 2)
    np.testing.assert_allclose(twice[:, 20:60], expected, atol=2)
    np.testing.assert_allclose(twice[:, :20], expected[:, 20:], atol=2)
    np.testing.assert_allclose(twice[:, 60:], expected[:, :21], atol=2)
    assert picture.per_rad == pytest.approx(40 / (2 * np.pi))


def test_frames_need_a_known_motion():
    motion = Motion(lambda t: 0 * t, lambda t: 0 * t, lambda t: 0 * t, lambda t: 0 * t, 0.0, 0.1)
    for start, count, readout, known in (
        (0.001, 10, 0.0, True), (0.0009, 1, 0.0, False), (0.009, 10, 0.0, True), (0.0095, 10, 0.0, False),
        (0.003, 1, 0.002, True), (0.0029, 1, 0.002, False),
    ):  # fmt: skip
        camera = Camera(
            width=16, height=16, scale=0.15, fps=100.0, exposure=2e-3, start=start, readout=readout
        )
        renderer = Renderer(SCENE, motion, camera)
        if known:
            assert len(list(renderer.frames(count))) == count
        else:
            with pytest.raises(ValueError, match="known"):
                next(renderer.frames(count))


def test_noise_is_white_and_rounded():
    noise = Noise(40, 50, 3.0, np.random.default_rng(1))
    grey = np.full((40, 50, 3), 100, np.uint8)
    a, b = noise.on(grey).astype(float), noise.on(grey).astype(float)
    assert a.std() == pytest.approx(math.sqrt(9 + 1 / 12), rel=0.05)
    assert abs(a.mean() - 100) < 0.15
    assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 0.05
    assert abs(np.corrcoef(a[..., 0].ravel(), a[..., 1].ravel())[0, 1]) < 0.06
    assert Noise(4, 5, 0.0, np.random.default_rng(1)).on(grey) is grey


# ---- scene and truth


def test_markers_of_the_scene():
    marker = Marker("m", "casing", RED, 0.5, 10.0, 4.0, 2.0, 0.3)
    corners = marker.corners()
    along, across = marker.local(*corners.T)
    np.testing.assert_allclose(along, [0, 0, 4, 4], atol=1e-12)
    np.testing.assert_allclose(across, [-1, 1, 1, -1], atol=1e-12)
    middle = 0.5 * (corners[0] + corners[1])
    np.testing.assert_allclose(middle, 10 * np.array([math.cos(0.5), math.sin(0.5)]))
    scene = Scene(markers=(marker, SCENE.markers[0]))
    assert scene.on("casing") == (marker,)
    points = {
        (0.0, 4.9): True, (0.0, 5.1): False, (10.0, 3.4): True, (10.0, 3.6): False, (-31.0, 0.0): True,
        (0.0, 27.4): False,
        (0.0, 27.6): True,
        (0.0, 31.4): True, (0.0, 31.6): False, (31.6, 0.0): False, tuple(corners.mean(axis=0)): True,
        tuple(corners[2] + 0.05 * (corners[2] - corners[0])): False,
    }  # fmt: skip
    for (x, y), covered in points.items():
        assert bool(scene.casing_covers(np.array(x), np.array(y))) is covered
    np.testing.assert_allclose(
        Wobble(2.0, 3.0, 0.4).shift(np.array(0.1)),
        2 * np.array([math.cos(0.6 * math.pi + 0.4), math.sin(0.6 * math.pi + 0.4)]),
    )


def test_perspective_and_tilt_of_the_camera():
    camera = Camera(
        scale=2.0, tilt=0.4, tilt_azimuth=0.0, perspective=0.01, centre=(100.0, 80.0), width=200, height=160
    )
    far = 1 + 0.01 * math.sin(0.4) * 5
    np.testing.assert_allclose(
        camera.project([5.0, 3.0]), [100 + 2 * 5 * math.cos(0.4) / far, 80 - 2 * 3 / far]
    )
    turned = Camera(scale=2.0, tilt=0.4, tilt_azimuth=1.1, roll=0.3, perspective=0.01, width=200, height=160)
    points = np.random.default_rng(0).uniform(-20, 20, (9, 2))
    place = turned.project(points)
    np.testing.assert_allclose(np.stack(turned.unproject(*place.T), axis=1), points)
    upright = Camera(scale=2.0, roll=0.5 * math.pi, centre=(0.0, 0.0))
    np.testing.assert_allclose(upright.project([3.0, 0.0]), [0, -6], atol=1e-12)
    for sense in (1, -1):
        found = Camera(sense=sense).turn([[2.0, 0.0], [0.0, 1.0]], [0.5])
        np.testing.assert_allclose(
            found[0],
            [[2 * math.cos(0.5), 2 * sense * math.sin(0.5)], [-math.sin(0.5), sense * math.cos(0.5)]],
        )
    assert Camera(width=10, height=20).rest == (4.5, 9.5)


def test_truth_of_a_film():
    camera = Camera(width=200, height=160, scale=2.0, fps=50.0, start=1.0, rate=1.1, exposure=1e-4, sense=1)
    motion = Motion.constant(4.0, 1.0, 0.3, 0.2)
    scene = Scene(markers=SCENE.markers, wobble=Wobble(1.0, 2.0, 0.0))
    truth = find_truth(scene, motion, camera, 3)
    np.testing.assert_allclose(truth.time, 1 + 1.1 * np.arange(3) / 50)
    np.testing.assert_allclose(truth.clip_time, np.arange(3) / 50)
    np.testing.assert_allclose(truth.angle["rotor"], 0.3 + 4 * truth.time)
    np.testing.assert_allclose(truth.omega["casing"], 1.0)
    shift = scene.wobble.shift(truth.time)
    np.testing.assert_allclose(truth.centre, camera.project(shift))
    for marker in scene.markers:
        for k in range(3):
            psi = truth.angle[marker.body][k]
            turn = np.array([[math.cos(psi), -math.sin(psi)], [math.sin(psi), math.cos(psi)]])
            np.testing.assert_allclose(
                truth.corners[marker.name][k], camera.project(marker.corners() @ turn.T + shift[k])
            )
    assert (truth.visible["b"] == 1).all()
    marker = scene.markers[0]
    for k in range(3):
        grid = np.linspace(0.005, 0.995, 100)
        c = marker.corners()
        points = c[0] + grid[:, None, None] * (c[1] - c[0]) + grid[None, :, None] * (c[3] - c[0])
        relative = truth.angle["rotor"][k] - truth.angle["casing"][k]
        x = math.cos(relative) * points[..., 0] - math.sin(relative) * points[..., 1]
        y = math.sin(relative) * points[..., 0] + math.cos(relative) * points[..., 1]
        assert truth.visible["a"][k] == pytest.approx(1 - scene.casing_covers(x, y).mean(), abs=0.02)


def test_visible_fraction_is_averaged_over_the_exposure(monkeypatch):
    share = _film._visible_fraction(SCENE, SCENE.markers[0])
    monkeypatch.setattr(_film, "_visible_fraction", lambda *_: share)

    def visible(exposure, angle):
        camera = Camera(width=200, height=160, scale=2.0, exposure=exposure, fps=10.0)
        return _film._uncovered(
            SCENE, SCENE.markers[0], Motion.constant(30.0, 0.0), camera, np.asarray(angle) / 30
        )

    for middle in (0.0, 2.4, 5.0):
        short = visible(1e-5, middle + np.linspace(-0.6, 0.6, 241))
        assert np.ptp(short) > 0.05
        assert visible(0.04, [middle])[0] == pytest.approx(np.trapezoid(short, dx=0.005) / 1.2, abs=2e-3)
        nearest = share[
            np.rint((middle + np.linspace(-0.6, 0.6, 241)) / (2 * np.pi) * 4096).astype(int) % 4096
        ]
        assert np.abs(short - nearest).max() < 0.02
    assert (_film._uncovered(SCENE, SCENE.markers[1], STILL, SMALL, np.zeros(2)) == 1).all()


def test_fraction_of_a_marker_in_the_picture():
    square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    camera = Camera(width=10, height=8)
    places = np.array(
        [square, square - [2.5, 0], square - [-7.5, 0], square - [0, -4.5], square - [2.5, 2.5], square + 20]
    )
    np.testing.assert_allclose(_film._inside_picture(places, camera), [1, 0.5, 0.5, 0.75, 0.25, 0], atol=1e-5)


def test_planes_of_a_film():
    picture = np.random.default_rng(0).integers(0, 256, (4, 6, 3)).astype(np.uint8)
    luma, blue, red = to_planes(picture)
    weights = np.array([0.2126, 0.7152, 0.0722])
    np.testing.assert_allclose(luma, 16 + 219 / 255 * (picture @ weights), atol=0.51)
    smooth = np.repeat(
        np.repeat(np.random.default_rng(1).integers(0, 256, (2, 1, 3)), 2, axis=0), 6, axis=1
    ).astype(np.uint8)
    _, blue, red = to_planes(smooth)
    grey = smooth[::2, :3] @ weights
    np.testing.assert_allclose(
        blue, 128 + 224 / 255 * (smooth[::2, :3, 2] - grey) / (2 * (1 - 0.0722)), atol=1.1
    )
    np.testing.assert_allclose(
        red, 128 + 224 / 255 * (smooth[::2, :3, 0] - grey) / (2 * (1 - 0.2126)), atol=1.1
    )
