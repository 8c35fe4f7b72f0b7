"""The motion of two bodies: exact angles at any time.

Angles are in rad, unwrapped, and increase in the sense of rotation; times are in s on the true clock. This module
shares no code with `fitting`, so that tests do not repeat its errors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Curve = Callable[[ArrayLike], Array]
Torque = Callable[[float, float, float, float, float], float]
"""``torque(t, omega_r, omega_c, psi_r, psi_c)`` in N m."""


@dataclass(frozen=True)
class Motion:
    """The angles and speeds of both bodies as functions of the true time.

    Attributes
    ----------
    psi_rotor, psi_casing : callable
        Angle in rad, unwrapped, at times in s (scalar or array).
    omega_rotor, omega_casing : callable
        Angular velocity in rad/s.
    start, stop : float
        Limits of the time in which the motion is known [s].
    """

    psi_rotor: Curve
    psi_casing: Curve
    omega_rotor: Curve
    omega_casing: Curve
    start: float = -np.inf
    stop: float = np.inf

    @classmethod
    def constant(
        cls,
        omega_rotor: float,
        omega_casing: float,
        psi_rotor: float = 0.0,
        psi_casing: float = 0.0,
    ) -> Motion:
        """Both bodies at constant speed: psi = psi_0 + omega t."""

        def line(offset: float, slope: float) -> Curve:
            return lambda t: offset + slope * np.asarray(t, dtype=np.float64)

        return cls(
            line(psi_rotor, omega_rotor),
            line(psi_casing, omega_casing),
            line(omega_rotor, 0.0),
            line(omega_casing, 0.0),
        )

    @classmethod
    def from_speeds(
        cls,
        time: ArrayLike,
        omega_rotor: ArrayLike,
        omega_casing: ArrayLike,
        psi_rotor: float = 0.0,
        psi_casing: float = 0.0,
    ) -> Motion:
        """Angles from speeds: a cubic spline through omega(t), integrated exactly.

        Parameters
        ----------
        time : (n,) array
            Increasing times in s, n >= 4.
        omega_rotor, omega_casing : (n,) array
            Speeds in rad/s.
        psi_rotor, psi_casing : float
            Angles in rad at ``time[0]``.
        """
        from scipy.interpolate import CubicSpline

        t = np.asarray(time, dtype=np.float64)
        rotor = CubicSpline(t, np.asarray(omega_rotor, dtype=np.float64), extrapolate=False)
        casing = CubicSpline(t, np.asarray(omega_casing, dtype=np.float64), extrapolate=False)
        rotor_angle, casing_angle = rotor.antiderivative(), casing.antiderivative()
        return cls(
            _curve(rotor_angle, psi_rotor),
            _curve(casing_angle, psi_casing),
            _curve(rotor),
            _curve(casing),
            float(t[0]),
            float(t[-1]),
        )

    @classmethod
    def from_angles(cls, time: ArrayLike, psi_rotor: ArrayLike, psi_casing: ArrayLike) -> Motion:
        """Speeds from unwrapped angles: cubic splines through psi(t) and their derivatives."""
        from scipy.interpolate import CubicSpline

        t = np.asarray(time, dtype=np.float64)
        rotor = CubicSpline(t, np.asarray(psi_rotor, dtype=np.float64), extrapolate=False)
        casing = CubicSpline(t, np.asarray(psi_casing, dtype=np.float64), extrapolate=False)
        return cls(
            _curve(rotor),
            _curve(casing),
            _curve(rotor.derivative()),
            _curve(casing.derivative()),
            float(t[0]),
            float(t[-1]),
        )


def _curve(spline: Callable[[Array], Array], offset: float = 0.0) -> Curve:
    return lambda t: np.asarray(offset + spline(np.asarray(t, dtype=np.float64)))


@dataclass(frozen=True)
class Friction:
    """The coefficients of the torques of the paper, in SI units.

    ``tau = c + d D + e D^2 + f D^g`` with ``D = |omega_r - omega_c|`` acts between the bodies,
    ``a1 omega_r + a2 omega_r^2`` on the rotor alone, ``b1 + b2 omega_c`` on the casing alone.
    """

    a1: float = 0.0
    a2: float = 0.0
    b1: float = 0.0
    b2: float = 0.0
    c: float = 0.0
    d: float = 0.0
    e: float = 0.0
    f: float = 0.0
    g: float = 0.5

    def torques(self, omega_r: float, omega_c: float, internal: float = 0.0) -> tuple[float, float]:
        """Return the torques on rotor and casing [N m], with an additional `internal` torque between them."""
        slip = abs(omega_r - omega_c)
        power = self.f * slip**self.g if slip > 0.0 else 0.0
        tau = (self.c + self.d * slip + self.e * slip**2 + power) * np.sign(omega_r - omega_c) + internal
        on_rotor = -tau - self.a1 * omega_r - self.a2 * omega_r * abs(omega_r)
        on_casing = tau - self.b1 * np.sign(omega_c) - self.b2 * omega_c
        return float(on_rotor), float(on_casing)


def two_body_motion(
    friction: Friction,
    *,
    inertia_rotor: float,
    inertia_casing: float,
    omega_rotor: float,
    omega_casing: float,
    duration: float,
    psi_rotor: float = 0.0,
    psi_casing: float = 0.0,
    extra_rotor: Torque | None = None,
    extra_casing: Torque | None = None,
    extra_bearing: Torque | None = None,
    sample_rate: float = 2000.0,
) -> Motion:
    r"""Integrate the motion of the two bodies of the paper, with additional torques.

    .. math::
        I_r \dot\omega_r = -\tau - a_1\omega_r - a_2\omega_r|\omega_r| + T_r - T_b, \qquad
        I_c \dot\omega_c = +\tau - b_1\,\mathrm{sign}\,\omega_c - b_2\omega_c + T_c + T_b

    Parameters
    ----------
    friction : Friction
        Coefficients of the known torques.
    inertia_rotor, inertia_casing : float
        Moments of inertia in kg m2.
    omega_rotor, omega_casing, psi_rotor, psi_casing : float
        Speeds in rad/s and angles in rad at t = 0.
    duration : float
        Duration in s; the motion ends earlier if the casing comes to rest.
    extra_rotor, extra_casing, extra_bearing : callable, optional
        Additional torques in N m, ``torque(t, omega_r, omega_c, psi_r, psi_c)``; the last one acts on the casing, and
        with the opposite sign on the rotor.
    sample_rate : float
        Sample rate in Hz of the splines.

    Notes
    -----
    DOP853 of SciPy with a relative tolerance of 1e-11. Near a discontinuity of a torque the error control reduces the
    step size.
    """
    from scipy.integrate import solve_ivp

    def rate(t: float, y: Array) -> list[float]:
        w_r, w_c, p_r, p_c = (float(v) for v in y)
        internal = extra_bearing(t, w_r, w_c, p_r, p_c) if extra_bearing else 0.0
        on_rotor, on_casing = friction.torques(w_r, w_c, internal)
        on_rotor += extra_rotor(t, w_r, w_c, p_r, p_c) if extra_rotor else 0.0
        on_casing += extra_casing(t, w_r, w_c, p_r, p_c) if extra_casing else 0.0
        return [on_rotor / inertia_rotor, on_casing / inertia_casing, w_r, w_c]

    def at_rest(_t: float, y: Array) -> float:
        return float(y[1])

    at_rest.terminal = True  # type: ignore[attr-defined]
    at_rest.direction = -1.0  # type: ignore[attr-defined]
    result = solve_ivp(
        rate,
        (0.0, duration),
        np.array([omega_rotor, omega_casing, psi_rotor, psi_casing]),
        method="DOP853",
        rtol=1e-11,
        atol=1e-12,
        max_step=0.05,
        dense_output=True,
        events=at_rest,
    )
    if result.status < 0 or result.sol is None:
        raise ValueError(f"The motion could not be integrated: {result.message}")
    end = float(result.t[-1])
    time = np.linspace(0.0, end, max(round(end * sample_rate) + 1, 8))
    state = result.sol(time)
    return Motion.from_speeds(time, state[0], state[1], psi_rotor, psi_casing)
