"""The motions against answers on paper."""

from __future__ import annotations

import numpy as np
import pytest

from gyrotrack.synthetic._scene import Friction, Motion, two_body_motion

TIME = np.linspace(0.0, 4.0, 41)
INERTIA = {"inertia_rotor": 5.0e-6, "inertia_casing": 2.0e-6}


def test_constant_speed() -> None:
    motion = Motion.constant(300.0, 20.0, 1.0, 2.0)
    assert np.allclose(motion.psi_rotor(TIME), 1.0 + 300.0 * TIME)
    assert np.allclose(motion.psi_casing(TIME), 2.0 + 20.0 * TIME)
    assert motion.omega_rotor(0.5) == 300.0


def test_angles_are_the_exact_integral_of_speeds() -> None:
    time = np.linspace(0.0, 5.0, 2001)
    motion = Motion.from_speeds(time, 400.0 + 3.0 * np.sin(7.0 * time), 50.0 - 2.0 * time, 0.3, 0.1)
    assert np.allclose(
        motion.psi_rotor(TIME), 0.3 + 400.0 * TIME + 3.0 / 7.0 * (1.0 - np.cos(7.0 * TIME)), atol=1e-8
    )
    assert np.allclose(motion.psi_casing(TIME), 0.1 + 50.0 * TIME - TIME**2, atol=1e-9)
    again = Motion.from_angles(time, motion.psi_rotor(time), motion.psi_casing(time))
    assert np.allclose(again.omega_rotor(TIME), motion.omega_rotor(TIME), atol=1e-4)


def test_nothing_is_known_outside() -> None:
    motion = Motion.from_speeds(np.linspace(0.0, 1.0, 9), np.ones(9), np.ones(9))
    assert (motion.start, motion.stop) == (0.0, 1.0)
    assert np.isnan(motion.psi_rotor(1.1))


def test_quadratic_air_drag_of_the_rotor() -> None:
    motion = two_body_motion(
        Friction(a2=1.0e-10), omega_rotor=500.0, omega_casing=1.0, duration=4.0, **INERTIA
    )
    rate = 1.0e-10 * 500.0 / 5.0e-6
    assert np.allclose(motion.omega_rotor(TIME), 500.0 / (1.0 + rate * TIME), rtol=1e-9)
    assert np.allclose(motion.psi_rotor(TIME), 500.0 / rate * np.log1p(rate * TIME), rtol=1e-9)


def test_linear_drag_of_the_casing_and_its_constant() -> None:
    friction = Friction(b1=2.0e-6, b2=4.0e-7)
    motion = two_body_motion(friction, omega_rotor=100.0, omega_casing=60.0, duration=4.0, **INERTIA)
    end = -2.0e-6 / 4.0e-7
    expected = end + (60.0 - end) * np.exp(-4.0e-7 / 2.0e-6 * TIME)
    assert np.allclose(motion.omega_casing(TIME), expected, rtol=1e-9)
    assert np.allclose(motion.omega_rotor(TIME), 100.0)


@pytest.mark.parametrize(
    "friction", [Friction(c=1e-5), Friction(d=4e-8), Friction(e=1e-10), Friction(f=7e-7, g=0.6)]
)
def test_the_bearing_keeps_the_angular_momentum(friction: Friction) -> None:
    motion = two_body_motion(
        friction,
        omega_rotor=500.0,
        omega_casing=5.0,
        duration=4.0,
        extra_bearing=lambda t, w_r, w_c, p_r, p_c: (
            1e-6 * np.cos(p_c) + 1e-9 * (w_r - w_c) + 1e-7 * np.sin(p_r) * t
        ),
        **INERTIA,
    )
    momentum = 5.0e-6 * motion.omega_rotor(TIME) + 2.0e-6 * motion.omega_casing(TIME)
    assert np.allclose(momentum, momentum[0], rtol=1e-9)
    assert motion.omega_casing(4.0) > 10.0


def test_extra_torques_act_where_they_should() -> None:
    motion = two_body_motion(
        Friction(),
        omega_rotor=500.0,
        omega_casing=5.0,
        duration=4.0,
        extra_rotor=lambda *_: -1.0e-5,
        extra_casing=lambda t, *_: 2.0e-6 * t,
        **INERTIA,
    )
    assert np.allclose(motion.omega_rotor(TIME), 500.0 - 2.0 * TIME)
    assert np.allclose(motion.omega_casing(TIME), 5.0 + 0.5 * TIME**2)


def test_the_run_ends_when_the_casing_rests() -> None:
    motion = two_body_motion(
        Friction(b1=4.0e-6), omega_rotor=100.0, omega_casing=3.0, duration=4.0, **INERTIA
    )
    assert motion.stop == pytest.approx(1.5, rel=1e-6)
