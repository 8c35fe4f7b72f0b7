"""Projection there and back, and what the clocks of two cameras say."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gyrotrack.synthetic._film import Truth, find_truth
from gyrotrack.synthetic._scene import Camera, Motion, Scene

small = st.floats(-0.5, 0.5)
point = st.tuples(st.floats(-40.0, 40.0), st.floats(-40.0, 40.0))


def seen_angle(truth: Truth, name: str) -> np.ndarray:
    """Angle of a paper as the film shows it: the mean of its two near corners about the axis, as the sense goes."""
    away = truth.corners[name][:, :2] - truth.centre[:, None]
    return np.angle(np.exp(1j * truth.sense * np.arctan2(-away[..., 1], away[..., 0])).sum(axis=1))


@given(point, small, st.floats(-3.0, 3.0), st.floats(0.0, 1.0 / 120.0), st.floats(-3.0, 3.0))
def test_what_is_seen_is_found_again(
    place: tuple[float, float], tilt: float, azimuth: float, near: float, roll: float
) -> None:
    camera = Camera(tilt=tilt, tilt_azimuth=azimuth, perspective=near, roll=roll)
    x, y = camera.project(place)
    assert np.allclose(camera.unproject(x, y), place, atol=1e-9)


def test_up_on_the_table_is_up_in_the_picture() -> None:
    camera = Camera(scale=4.0, centre=(100.0, 50.0))
    assert np.allclose(camera.project([[2.0, 0.0], [0.0, 3.0]]), [[108.0, 50.0], [100.0, 38.0]])


def test_roll_adds_to_every_angle() -> None:
    motion, scene = Motion.constant(30.0, 7.0, 0.2, 0.4), Scene()
    straight = find_truth(scene, motion, Camera(), 40)
    rolled = find_truth(scene, motion, Camera(roll=0.3), 40)
    for marker in scene.markers:
        turned = seen_angle(rolled, marker.name) - seen_angle(straight, marker.name)
        assert np.allclose(np.exp(1j * turned), np.exp(-0.3j))


def test_marker_angle_is_body_angle_plus_mount() -> None:
    motion, scene = Motion.constant(30.0, 7.0, 0.2, 0.4), Scene()
    for sense in (-1, 1):
        truth = find_truth(scene, motion, Camera(sense=sense), 40)
        for marker in scene.markers:
            expected = truth.angle[marker.body] + marker.mount
            assert np.allclose(np.exp(1j * seen_angle(truth, marker.name)), np.exp(1j * expected))


def test_two_clocks() -> None:
    motion = Motion.constant(400.0, 60.0)
    slow = find_truth(Scene(), motion, Camera(fps=1000.0, start=3.25, rate=1.0 + 1e-4), 1001)
    assert slow.clip_time[-1] == 1.0
    assert slow.time[0] == 3.25
    assert slow.time[-1] == 3.25 + 1.0001
    assert np.allclose(slow.time, slow.clock_offset + slow.clock_rate * slow.clip_time)
    assert slow.angle["rotor"][-1] == motion.psi_rotor(4.2501)
