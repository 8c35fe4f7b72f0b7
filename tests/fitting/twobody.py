"""An oracle of its own: rotor, casing and cameras in plain Python and NumPy, with nothing of `fitting`.

Classical Runge-Kutta steps on a fixed grid, on which the random torque is piecewise linear; angles between
the grid points by quintic Hermite interpolation from angle, speed and acceleration at both ends. That the
oracle is right is tested against SciPy in test_twobody.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np

I_ROTOR, I_CASING = 5.54e-5, 2.06e-5
PAPER = {"a2": 9.97e-11, "b1": 2.88e-6, "b2": 8.28e-7, "d": 1.57e-7, "f": 0.126e-7, "g": 1.32}
KEYS = {
    "a2": "rotor.air.quadratic.a2",
    "b1": "touchpoint.constant.b1",
    "b2": "casing.air.linear.b2",
    "d": "bearing.linear.d",
    "f": "bearing.power.f",
    "g": "bearing.power.g",
}
Torque = Callable[[float, float, float, float, float], float]


def nothing(t, omega_r, omega_c, psi_r, psi_c):
    return 0.0


@dataclass(frozen=True)
class Hidden:
    """What the paper's model lacks: torques (t, omega_r, omega_c, psi_r, psi_c) -> N m, and bearing heat."""

    rotor: Torque = nothing
    casing: Torque = nothing
    bearing: Torque = nothing
    factor: Callable[[float], float] = lambda t: 1.0
    softening: float = 0.0  # k / C [1/J]
    cooling: float = 30.0  # [s]
    jump: tuple[float, float] = (0.0, 0.0)  # a torque on the casing [N m] from a grid point of time on [s]


@dataclass(frozen=True)
class Motion:
    """Angles, speeds and accelerations of both bodies on the grid; columns rotor, casing."""

    time: np.ndarray
    angle: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray

    def at(self, times, body):
        """Return angle and speed of a body (0 rotor, 1 casing) at any times."""
        h = self.time[1] - self.time[0]
        i = np.clip(((times - self.time[0]) / h).astype(int), 0, len(self.time) - 2)
        u = (times - self.time[i]) / h
        p, v, a = self.angle[:, body], self.speed[:, body], self.acceleration[:, body]
        p0, v0, a0 = p[i], v[i] * h, 0.5 * a[i] * h * h
        rest = p[i + 1] - p0 - v0 - a0
        slope = v[i + 1] * h - v0 - 2 * a0
        bend = 0.5 * a[i + 1] * h * h - a0
        c3, c4, c5 = (
            10 * rest - 4 * slope + bend,
            -15 * rest + 7 * slope - 2 * bend,
            6 * rest - 3 * slope + bend,
        )
        angle = p0 + u * (v0 + u * (a0 + u * (c3 + u * (c4 + u * c5))))
        speed = (v0 + u * (2 * a0 + u * (3 * c3 + u * (4 * c4 + u * 5 * c5)))) / h
        return angle, speed


def ornstein_uhlenbeck(rng, n, step, rms, time):
    """Return a stationary Gaussian series with covariance rms^2 exp(-|dt| / time)."""
    if rms == 0:
        return np.zeros(n)
    decay = math.exp(-step / time)
    kicks = rng.standard_normal(n) * rms * math.sqrt(1 - decay**2)
    kicks[0] = rng.standard_normal() * rms
    out = np.empty(n)
    last = 0.0
    for i in range(n):
        last = decay * last + kicks[i]
        out[i] = last
    return out


def rates(par, hidden, t, state, noise_casing=0.0, noise_bearing=0.0):
    """Return the rates of (omega_r, omega_c, psi_r, psi_c, temperature)."""
    wr, wc, pr, pc, heat = state
    diff = wr - wc
    tau = par["d"] * diff + par["f"] * math.copysign(abs(diff) ** par["g"], diff)
    tau += hidden.bearing(t, wr, wc, pr, pc)
    tau *= hidden.factor(t) * math.exp(-hidden.softening * heat)
    warming = tau * diff - heat / hidden.cooling
    tau += noise_bearing
    on_rotor = -tau - par["a2"] * wr * abs(wr) + hidden.rotor(t, wr, wc, pr, pc)
    on_casing = tau - par["b1"] * math.copysign(1.0, wc) - par["b2"] * wc + hidden.casing(t, wr, wc, pr, pc)
    return on_rotor / I_ROTOR, (on_casing + noise_casing) / I_CASING, wr, wc, warming


def calm_rates(par):
    """Return `rates` of parameters without anything hidden, with the same results in a third of the time."""
    a2, b1, b2, d, f, g = (par[k] for k in ("a2", "b1", "b2", "d", "f", "g"))
    cooling, copysign = Hidden().cooling, math.copysign

    def of(t, state, noise_casing=0.0, noise_bearing=0.0):
        wr, wc, _, _, heat = state
        diff = wr - wc
        tau = d * diff + f * copysign(abs(diff) ** g, diff)
        warming = tau * diff - heat / cooling
        tau += noise_bearing
        on_casing = tau - b1 * copysign(1.0, wc) - b2 * wc
        return (-tau - a2 * wr * abs(wr)) / I_ROTOR, (on_casing + noise_casing) / I_CASING, wr, wc, warming

    return of


def simulate(
    par=PAPER, start=(900.0, 5.0), span=200.0, hidden=None, ou=0.0, ou_time=1.0, seed=0, step=0.02
) -> Motion:
    """Return the motion; `ou` is the rms of a random torque on the casing and of one in the bearing."""
    return _simulated(tuple(par.items()), start, span, hidden or Hidden(), ou, ou_time, seed, step)


def along(state, step, slope):
    """Return a state of five numbers, moved along a slope."""
    a, b, c, d, e = state
    p, q, r, s, t = slope
    return a + step * p, b + step * q, c + step * r, d + step * s, e + step * t


@lru_cache(maxsize=16)
def _simulated(par, start, span, hidden, ou, ou_time, seed, step):
    par = dict(par)
    rng = np.random.default_rng(seed)
    n = round(span / step) + 2
    casing, bearing = (ornstein_uhlenbeck(rng, n, step, ou, ou_time).tolist() for _ in range(2))
    y = (*start, 0.0, 0.0, 0.0)
    rows, slopes = [y], []
    rate = calm_rates(par) if replace(hidden, jump=(0.0, 0.0)) == Hidden() else partial(rates, par, hidden)
    half, sixth = step / 2, step / 6
    for i in range(n - 1):
        t = i * step
        push = hidden.jump[1] if t > hidden.jump[0] - 0.5 * step else 0.0
        middle = push + 0.5 * (casing[i] + casing[i + 1]), 0.5 * (bearing[i] + bearing[i + 1])
        k1 = rate(t, y, push + casing[i], bearing[i])
        k2 = rate(t + half, along(y, half, k1), *middle)
        k3 = rate(t + half, along(y, half, k2), *middle)
        k4 = rate(t + step, along(y, step, k3), push + casing[i + 1], bearing[i + 1])
        y = along(y, sixth, [p + 2 * q + 2 * r + s for p, q, r, s in zip(k1, k2, k3, k4, strict=True)])
        rows.append(y)
        slopes.append(k1[:2])
    slopes.append(rate((n - 1) * step, y, casing[-1], bearing[-1])[:2])
    states = np.array(rows)
    return Motion(step * np.arange(n), states[:, 2:4], states[:, :2], np.array(slopes))


@dataclass(frozen=True)
class Cameras:
    """How the motion is filmed; the defaults are the paper's."""

    span: float = 200.0
    casing_rate: float = 260.0
    windows: tuple[float, ...] = (5.0, 70.0, 150.0)
    window_length: float = 3.0
    rotor_rate: float = 1000.0
    sigma: float = 1e-3
    quantity: str = "angle"
    centre: tuple[float, float] = (0.0, 0.0)  # amplitude [rad] and phase of an offset centre


# the information of the paper's films in a fifth of their samples, and half of the rows of a fit: standard errors
# agree within 5 %. Less than a frame per turn of the casing: not for laws of its angle
FEWER_FRAMES = Cameras(casing_rate=10.0, rotor_rate=300.0, sigma=3e-4)
# the same information where a harmonic of the angle counts: more than two frames per turn of the casing
FRAMES_OF_A_HARMONIC = Cameras(casing_rate=65.0, rotor_rate=250.0, sigma=5e-4)


def film(motion, seed=0, cameras=None, **more):
    """Return the measured arrays as keywords of `fitting.inference._record.make_record`."""
    cameras = cameras or Cameras()
    rng = np.random.default_rng(1000 + seed)
    which = 0 if cameras.quantity == "angle" else 1

    def run(times, body):
        value = motion.at(times, body)[which].copy()
        if which == 0 and body == 1:
            value += cameras.centre[0] * np.sin(value - cameras.centre[1])
        if which == 0 and body == 0:
            value += rng.uniform(0, 2 * np.pi) - value[0]
        return (
            times,
            value + cameras.sigma * rng.standard_normal(len(times)),
            np.full(len(times), cameras.sigma),
        )

    casing = run(np.arange(0, cameras.span, 1 / cameras.casing_rate), 1)
    ticks = np.arange(round(cameras.window_length * cameras.rotor_rate)) / cameras.rotor_rate
    rotor = [run(w + ticks, 0) for w in cameras.windows]
    return {
        "casing": casing,
        "rotor": rotor,
        "I_rotor": I_ROTOR,
        "I_casing": I_CASING,
        "quantity": cameras.quantity,
        "label": "case1",
        **more,
    }


def truth(par=PAPER, start=(900.0, 5.0), label="case1"):
    """Return the true parameters by the names that a fit of the reduced model uses."""
    named = {KEYS[k]: v for k, v in par.items()}
    return named | {f"initial.omega_r@{label}": start[0], f"initial.omega_c@{label}": start[1]}
