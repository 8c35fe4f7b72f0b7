import importlib.util
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrotrack.tracking._body_angles import (
    about_rotor,
    axis_offset,
    correct_view,
    followed_path,
    join_bodies,
    view,
)
from gyrotrack.tracking._fusion import BodyAngles
from gyrotrack.tracking._hub import CentrePath, fast_motion, marked_paths, smooth_path
from gyrotrack.tracking._marker_tracker import MarkerObservations
from gyrotrack.tracking._profile import PAPER
from gyrotrack.tracking._scene import Marker

_spec = importlib.util.spec_from_file_location("measured", Path(__file__).with_name("measured.py"))
measured = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(measured)


def _error(path, truth):
    return float(np.sqrt(np.mean((path - truth) ** 2)))


def _slow(n):
    k = np.arange(n)
    return np.stack([300 + 0.6 * np.cos(k / 40), 200 + 0.6 * np.sin(k / 40)], axis=1)


def test_noise_that_hangs_together_is_smoothed_away():
    rng = np.random.default_rng(2)
    truth = _slow(1500)
    noise = np.stack(
        [np.convolve(rng.normal(0, 1, 1510), np.ones(6), "valid")[:1500] for _ in (0, 1)], axis=1
    )
    noise *= 0.1 / noise.std()
    path = smooth_path(truth + noise)
    assert _error(path.centre, truth) < 0.06  # a third less than what was measured, 0.1
    assert path.sigma[0] == pytest.approx(_error(path.centre, truth), rel=0.6)


def test_a_fast_regular_wobble_is_kept():
    rng = np.random.default_rng(3)
    k = np.arange(1500)
    truth = _slow(1500) + 0.8 * np.stack([np.cos(0.55 * k), np.sin(0.55 * k)], axis=1)
    path = smooth_path(truth + rng.normal(0, 0.08, truth.shape))
    assert _error(path.centre, truth) < 0.1


def test_gaps_are_bridged_and_long_ones_have_no_uncertainty():
    truth = _slow(1200)
    seen = truth.copy()
    seen[100:105] = np.nan
    seen[500:900] = np.nan
    path = smooth_path(seen)
    assert _error(path.centre[95:110], truth[95:110]) < 0.05
    assert np.isfinite(path.centre).all()
    assert np.isnan(path.sigma[700])


def test_a_clip_of_a_few_frames_takes_the_mean():
    path = smooth_path(np.array([[10.0, 20.0], [10.2, 20.0], [9.8, 20.0]]))
    np.testing.assert_allclose(path.centre, [[10, 20]] * 3)


def test_nothing_measured_is_nothing_known():
    path = smooth_path(np.full((20, 2), np.nan))
    assert np.isnan(path.sigma).all()


def _views(truth, radii=(80.0, 60.0), noise=0.3):
    """Markers on circles about the true centre, with errors of their radii that do not depend on the disc."""
    rng = np.random.default_rng(5)
    n = len(truth)
    found = {}
    for name, r in zip(("casing", "rotor"), radii, strict=True):
        theta = (0.05 if name == "casing" else 0.4) * np.arange(n)
        reach = r + rng.normal(0, noise, n)
        place = truth + reach[:, None] * np.stack([np.cos(theta), -np.sin(theta)], axis=1)
        about = truth.mean(axis=0)  # the ring does not follow the hub
        x, y = place[:, 0] - about[0], about[1] - place[:, 1]
        marker = Marker(name, name, "red", r - 9, r + 9, 0.1, (20.0, 20.0), 0.15)
        seen = _observed(np.arctan2(y, x), np.hypot(x, y), about, np.ones(n, dtype=bool))
        found[name] = view((marker,), {name: seen}, (640, 480))
    return found


def _correlated(n, size):
    rng = np.random.default_rng(6)
    noise = [np.convolve(rng.normal(0, 1, n + 5), np.ones(6), "valid") for _ in (0, 1)]
    return np.stack(noise, axis=1) * size / np.std(noise)


def test_the_path_of_a_hand_held_camera_is_followed():
    """A broad band of fast motion, as of a hand, is no line in the spectrum; the radii of the markers show it."""
    rng = np.random.default_rng(8)
    bell = np.exp(-0.5 * (np.arange(-15, 16) / 4.0) ** 2)
    hand = np.stack([np.convolve(rng.normal(0, 1, 430), bell, "valid") for _ in (0, 1)], axis=1)
    truth = _slow(400) + hand / hand.std()
    measured = truth + np.random.default_rng(7).normal(0, 0.1, truth.shape)
    smooth, *_ = paths = marked_paths(measured)
    path = followed_path(paths, _views(truth))
    assert _error(smooth.centre, truth) > 0.25
    assert _error(path.centre, truth) < 0.08
    assert np.median(path.sigma) == pytest.approx(_error(path.centre, truth), rel=0.5)


def test_a_camera_that_shakes_from_frame_to_frame_is_followed_and_told():
    rng = np.random.default_rng(9)
    truth = _slow(60) + rng.normal(0, 1.5, (60, 2))
    measured = truth + rng.normal(0, 0.1, truth.shape)
    smooth, *_ = paths = marked_paths(measured)
    path = followed_path(paths, _views(truth))
    assert _error(smooth.centre, truth) > 1.0
    assert _error(path.centre, truth) < 0.2
    assert np.median(path.sigma) == pytest.approx(_error(path.centre, truth), rel=0.5)
    # two normal deviates of 1.5 px in each of two axes
    told = re.search(r"moves by (\S+) px rms from frame to frame", fast_motion(path, measured) or "")
    assert told is not None
    assert float(told[1]) == pytest.approx(3.0, rel=0.25)
    # without markers to select the path, the distance from the smooth one is told
    told = re.search(r"(\S+) px rms away from its smoothed path", fast_motion(smooth, measured) or "")
    assert told is not None
    assert float(told[1]) == pytest.approx(1.5 * np.sqrt(2), rel=0.25)
    assert fast_motion(marked_paths(_slow(60))[0], _slow(60)) is None


def test_errors_of_an_encoder_are_not_followed():
    truth = _slow(400)
    paths = marked_paths(truth + _correlated(400, 0.15))
    assert followed_path(paths, _views(truth)) is paths[0]


def test_a_path_of_a_few_frames_has_no_alternatives():
    paths = marked_paths(_slow(30))
    assert len(paths) == 1
    assert followed_path(paths, {}) is paths[0]


def test_what_covers_the_disc_does_not_displace_its_path():
    rng = np.random.default_rng(3)
    measured = np.array([270.0, 156.0]) + rng.normal(0, 0.02, (120, 2))
    measured[:7] = measured[60:66] = np.nan
    measured[7] += (-0.7, 0.9)  # a part of the disc is covered
    measured[66] += (0.5, -0.6)
    for path in marked_paths(measured):
        known = np.isfinite(path.sigma)
        assert np.abs(path.centre[known] - [270.0, 156.0]).max() < 0.08, path.reach


def test_the_uncertainty_in_a_gap_contains_the_motion_of_the_camera():
    rng = np.random.default_rng(4)
    pulls = []
    for _ in range(40):
        true = np.cumsum(rng.normal(0, 0.3, (300, 2)), axis=0)
        measured = true + rng.normal(0, 0.02, true.shape)
        measured[100:112] = np.nan
        path = min(marked_paths(measured), key=lambda p: p.reach if p.reach > 5 else np.inf)
        pulls.append((path.centre - true)[104:108] / path.sigma[104:108, None])
    assert 0.5 < np.sqrt(np.mean(np.square(pulls))) < 1.4


def _observed(angle, radius, centre, open_):
    """A marker as measured about a fixed centre, (2,) in px, at angles and radii about it (n,)."""
    n = len(angle)
    return MarkerObservations(
        angle=np.angle(np.exp(1j * angle)),
        radius=radius,
        corner_angle=np.zeros((n, 2)),
        corner_radius=np.zeros((n, 2)),
        gain=np.ones(n),
        misfit=np.full(n, 0.02),
        weakness=np.ones(n),
        open=open_,
        centre=np.tile(centre, (n, 1)),
    )


@pytest.mark.parametrize("sways", [False, True])
def test_a_disc_beside_the_axis_of_the_rotor_circles_it_with_the_casing(sways):
    """The disc is 0.8 px off the axis of the rotor, or the whole gyroscope sways as much with the casing."""
    n, centre, rng = 500, np.array([320.0, 240.0]), np.random.default_rng(9)
    casing = 0.4 + 0.011 * np.arange(n)
    circle = 0.8 * np.exp(1j * (casing + 0.3))
    axis = circle if sways else np.zeros(n)
    markers, seen, truth = {"casing": [], "rotor": []}, {"casing": {}, "rotor": {}}, {}
    for body, name, radius, mount in (
        ("casing", "red", 90.0, 0.0),
        ("rotor", "blue", 75.0, 0.5),
        ("rotor", "green", 75.0, 2.6),
        ("rotor", "white", 75.0, 4.7),
    ):
        theta = casing if body == "casing" else mount + 0.12 * np.arange(n)
        about = circle if body == "casing" else axis  # the disc and the marker of the casing are on one body
        z = about + (radius + rng.normal(0.0, 0.25, n)) * np.exp(1j * (theta + rng.normal(0.0, 3e-3, n)))
        markers[body].append(Marker(name, body, name, radius - 9, radius + 9, 0.1, (20.0, 20.0), 0.15, mount))
        seen[body][name] = _observed(np.angle(z), np.abs(z), centre, np.ones(n, dtype=bool))
        truth[name] = theta
    views = {body: view(tuple(markers[body]), seen[body], (640, 480)) for body in seen}
    disc = centre + np.stack([circle.real, -circle.imag], axis=1)
    path = about_rotor(CentrePath(disc, np.full(n, 0.05), 0), views)
    assert np.array_equal(path.centre, disc) == sways
    true_path = centre + np.stack([axis.real, -axis.imag], axis=1)
    assert _error(path.centre - path.centre.mean(axis=0), true_path - true_path.mean(axis=0)) < 0.06
    flat = {body: one.flattening(path.centre) for body, one in views.items()}
    for body, one in views.items():
        for name, found in one.candidates(path, flat[body]).items():
            error = np.angle(np.exp(1j * (found.angle - truth[name])))
            assert np.std(error) < 3.3e-3, name  # 8 mrad with a disc that is taken for the axis


def test_coloured_markers_with_gaps_in_their_orbits_are_followed_about_the_same_point_as_the_white_one():
    """A bar and its shadow hide a coloured marker for a quarter of a turn, but never the white one."""
    offset, radius, centre, n = np.array([-3.7, 6.5]), 64.0, np.array([320.0, 240.0]), 150
    rng = np.random.default_rng(12)
    markers, observations, truth = [], {}, {}
    for name, mount, hidden in (("blue", 0.0, 1.6), ("green", 2.1, 1.6), ("white", 4.2, 0.0)):
        truth[name] = theta = mount + 2.0 * np.pi * np.arange(n) / n
        x, y = offset[:, None] + (radius + rng.normal(0.0, 0.2, n)) * np.stack([np.cos(theta), np.sin(theta)])
        markers.append(Marker(name, "rotor", name, radius - 9, radius + 9, 0.1, (20.0, 20.0), 0.15, mount))
        open_ = np.mod(theta - 1.0, 2.0 * np.pi) >= hidden
        observations[name] = _observed(np.arctan2(y, x), np.hypot(x, y), centre, open_)
    views = {"rotor": view(tuple(markers), observations, (640, 480))}
    path = CentrePath(np.tile(centre, (n, 1)), np.full(n, 0.05), 0)
    _, flat = correct_view(path, views, PAPER, marked=True)
    for name, found in views["rotor"].candidates(path, flat["rotor"]).items():
        error = np.angle(np.exp(1j * (found.angle - truth[name])))[found.open]
        assert np.std(error) < 3e-3, name  # 0.1 rad about the disc


def _three_markers(radius, excess, offset, n=400):
    """Views of a rotor whose markers circle `offset`, (x, y) in px, at radii with errors by place, and their centre."""
    rng, centre = np.random.default_rng(3), np.array([320.0, 240.0])
    markers, observations = [], {}
    for name, mount in (("blue", 0.0), ("green", 2.1), ("white", 4.2)):
        theta = mount + 0.11 * np.arange(n)
        r = radius + excess(theta) + rng.normal(0.0, 0.15, n)
        x, y = offset[0] + r * np.cos(theta), offset[1] + r * np.sin(theta)
        markers.append(Marker(name, "rotor", name, radius - 9, radius + 9, 0.1, (20.0, 20.0), 0.15, mount))
        every = np.ones(n, dtype=bool)
        observations[name] = _observed(np.arctan2(y, x), np.hypot(x, y), centre, every)
    path = CentrePath(np.tile(centre, (n, 1)), np.full(n, 0.05), 0)
    return {"rotor": view(tuple(markers), observations, (640, 480))}, path


@pytest.mark.parametrize("size", [0.03, 0.3])
def test_shadows_that_displace_the_edges_of_markers_make_the_tilt_as_uncertain_as_claimed(size):
    """Errors by place of the radii, of all orders and equal for all markers; the camera is tilted by 0.1 rad."""
    z = []
    for seed in range(12):
        parts = np.random.default_rng(seed).normal(0.0, size, (2, 6))

        def excess(theta, parts=parts):
            k = np.outer(theta, np.arange(1, 7))
            return np.cos(k) @ parts[0] + np.sin(k) @ parts[1] - 70.0 * 0.1**2 / 4 * np.cos(2.0 * theta)

        views, path = _three_markers(70.0, excess, (3.0, 0.0))
        _, flat = correct_view(path, views, PAPER, marked=True)
        z.append(abs(complex(flat["rotor"].p + 0.1**2 / 4, flat["rotor"].q)) / flat["rotor"].error)
    assert 0.4 < np.sqrt(np.mean(np.square(z))) < 1.6


def test_the_axis_of_a_rotor_is_that_of_its_coloured_markers():
    """Glare displaces a white marker; axes by angles less those by radii, in radii of the orbit."""
    views, path = _three_markers(70.0, np.zeros_like, (3.0, 0.0))
    _, flat = correct_view(path, views, PAPER, marked=True)
    nothing = np.zeros(1)
    off = {"blue": 0.5 / 70.0, "green": 0.5 / 70.0, "white": -1.0j / 70.0}
    rotor = BodyAngles(nothing, nothing, nothing, {}, axis_off=off)
    np.testing.assert_allclose(axis_offset(views["rotor"], flat["rotor"], rotor), [0.5, 0.0], atol=0.02)


@pytest.mark.slow
def test_a_disc_that_circles_the_axis_is_not_a_camera_that_shakes():
    seen = measured.watched(800)
    circle = 1.2 * np.exp(1j * np.nan_to_num(seen.bodies["casing"].coarse))
    beside = replace(seen, disc=seen.disc + np.stack([circle.real, -circle.imag], axis=1))
    for one in (seen, beside):
        joint = join_bodies(one, measured.scene(), PAPER, measured.FPS)
        assert not any("shakes" in text for text in joint.warnings)
    moved = joint.centre.centre - beside.disc
    assert np.std(moved) == pytest.approx(1.2 / np.sqrt(2), rel=0.1)
