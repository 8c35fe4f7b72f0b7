"""The motions against answers on paper."""

from __future__ import annotations

import numpy as np

from gyrotrack.synthetic._scene import Motion

TIME = np.linspace(0.0, 4.0, 41)


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
