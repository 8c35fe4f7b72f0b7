"""Recordings with something hidden, made in plain Python: not one line of `fitting` has a part in the physics."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

I_ROTOR, I_CASING = 5.54e-5, 2.06e-5
BUDGET = 1.33e-4  # N m, the torque that 2e-6 N m are 1.5 % of
# how it is filmed: frames per second of both cameras, where in the run the rotor's begins and how long it goes on
# [s], and the noise of an angle [rad]
_FILMED = {"rates": (260, 1000), "windows": (0.02, 0.35, 0.78), "window": 3.0, "sigma": 1e-3}
_PAPER: dict[str, Any] = {
    "a2": 9.97e-11, "d": 1.57e-7, "f": 1.26e-8, "g": 1.32, "I_rotor": I_ROTOR, "I_casing": I_CASING, **_FILMED
}  # fmt: skip
CASES: tuple[dict[str, Any], ...] = (
    {**_PAPER, "b1": 2.88e-6, "b2": 8.28e-7, "start": (900.0, 5.0), "span": 200.0},
    {**_PAPER, "b1": 2.4e-5, "b2": 8.1e-7, "start": (740.0, 12.0), "span": 160.0},
)
# a light, fast gyroscope whose whole run fits into a film of half a minute
LIGHT: dict[str, Any] = {
    "a2": 3.2e-11,
    "d": 7e-8,
    "f": 9.5e-7,
    "g": 0.62,
    "I_rotor": 4.2e-6,
    "I_casing": 1.6e-6,
    "b1": 6e-6,
    "b2": 3.6e-7,
    "start": (540.0, 4.0),
    "span": 30.0,
    **_FILMED,
}
# a casing slower than this [rad/s] that slows down is about to stop: the recording ends
_SLOWEST = 3.0
_STEP = 0.02  # s
# a casing slower than this [rad/s] reverses
_TINY = 1e-7

Torque = Callable[[float, float, float, float], float]  # of t, omega_r, omega_c, psi_c, in N m
Shake = tuple[float, list[float], list[float]]  # step [s], torques [N m] on the casing and between the bodies


@dataclass(frozen=True)
class Hidden:
    """What the base does not know about one recording.

    Torques on the bodies and between them; factors on the whole bearing torque; what heats the bearing (k / C,
    cooling time); a chirp (k, m, phi); other constants of the gyroscope; what the cameras do; and the truth.

    Attributes
    ----------
    truth : dict
        The values of the effect's parameters, by the symbols of the library.
    law : str
        The formula of an effect that no library has, with its numbers.
    """

    rotor: tuple[Torque, ...] = ()
    casing: tuple[Torque, ...] = ()
    bearing: tuple[Torque, ...] = ()
    factor: tuple[Callable[[float], float], ...] = ()
    heating: tuple[tuple[float, float], ...] = ()
    chirp: tuple[tuple[float, float, float], ...] = ()
    breaks: tuple[float, ...] = ()
    ripples: bool = False
    constants: dict[str, float] = field(default_factory=dict)
    inertia: float = 0.0  # share by which the casing's true inertia is larger than the one told
    clock: float = 0.0  # share by which the rotor camera's clock is slow
    offset: float = 0.0  # s by which the rotor's windows are told too early
    centre: tuple[float, float] = (0.0, 0.0)  # rad, phase
    tilt: tuple[float, float] = (0.0, 0.0)  # rad, phase
    shutter: tuple[float, float] = (0.0, 0.0)  # s, phase
    truth: dict[str, float] = field(default_factory=dict)
    law: str = ""


def together(parts: Iterable[Hidden]) -> Hidden:
    """Return several hidden things as one; camera faults and constants of the later ones win."""
    total: dict[str, Any] = {}
    for part in parts:
        for f in fields(Hidden):
            value, blank = getattr(part, f.name), getattr(Hidden(), f.name)
            if f.name in ("centre", "tilt", "shutter"):
                total[f.name] = value if value != blank else total.get(f.name, blank)
            elif isinstance(value, tuple):
                total[f.name] = (*total.get(f.name, ()), *value)
            elif isinstance(value, dict):
                total[f.name] = total.get(f.name, {}) | value
            else:
                total[f.name] = value or total.get(f.name, blank)
    return Hidden(**total)


@dataclass(frozen=True)
class Run:
    """True angles [rad] of the casing and, window by window, of the rotor, at true times [s]."""

    time: np.ndarray
    casing: np.ndarray
    speed: np.ndarray
    windows: list[np.ndarray]
    rotor: list[np.ndarray]


def run(
    case: dict[str, Any],
    hidden: Hidden,
    *,
    torque_noise: float,
    torque_time: float = 1.0,
    rng: np.random.Generator,
) -> Run:
    """Integrate one run; it ends before the casing stops."""
    case = case | hidden.constants
    motion = integrate(case, hidden, shake(case["span"], torque_noise, torque_time, rng))
    span = min(case["span"], np.floor(motion.time[-1]))
    casing_rate, rotor_rate = case["rates"]
    time = np.arange(0, span, 1 / casing_rate)
    ticks = np.arange(round(case["window"] * rotor_rate)) / rotor_rate
    places = np.array(case["windows"]) * span + rng.uniform(0, case["window"], len(case["windows"]))
    # in a short run the last window ends with it
    places = np.minimum(places, span - case["window"])
    windows = [t + ticks for t in places]
    speed = np.interp(time, motion.time, motion.speed[:, 1])
    return Run(time, motion.angle(time, 1), speed, windows, [motion.angle(w, 0) for w in windows])


def record(
    case: dict[str, Any],
    hidden: Hidden,
    *,
    torque_noise: float,
    torque_time: float = 1.0,
    rng: np.random.Generator,
    label: str,
) -> dict[str, Any]:
    """Integrate and film one run; return what `fitting.inference._record.make_record` takes."""
    made = run(case, hidden, torque_noise=torque_noise, torque_time=torque_time, rng=rng)
    psi, sigma = made.casing, case["sigma"]
    seen = (
        psi
        + hidden.centre[0] * np.sin(psi - hidden.centre[1])
        + hidden.tilt[0] * np.sin(2 * psi - hidden.tilt[1])
        - hidden.shutter[0] * made.speed * np.sin(psi - hidden.shutter[1])
    )
    rotor = []
    for w, angle in zip(made.windows, made.rotor, strict=True):
        told = w[0] - hidden.offset + (w - w[0]) / (1 + hidden.clock)
        rotor.append((told, angle - angle[0] + _noise(sigma, len(w), rng), np.full(len(w), sigma)))
    return {
        "casing": (made.time, seen + _noise(sigma, len(psi), rng), np.full(len(psi), sigma)),
        "rotor": rotor,
        "I_rotor": case["I_rotor"],
        "I_casing": case["I_casing"],
        "label": label,
    }


def _noise(sigma: float, n: int, rng: np.random.Generator) -> np.ndarray:
    return sigma * rng.standard_normal(n)


@dataclass(frozen=True)
class Motion:
    """Speeds, accelerations and angles of rotor and casing (columns) at the steps of the integration."""

    time: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    turned: np.ndarray

    def angle(self, times: np.ndarray, body: int) -> np.ndarray:
        """Return the angle of a body at any times: quintic Hermite interpolation."""
        i = np.clip(np.searchsorted(self.time, times, side="right") - 1, 0, len(self.time) - 2)
        h = self.time[i + 1] - self.time[i]
        u = (times - self.time[i]) / h
        p, v, a = self.turned[:, body], self.speed[:, body], self.acceleration[:, body]
        v0, a0 = v[i] * h, 0.5 * a[i] * h * h
        rest = p[i + 1] - p[i] - v0 - a0
        slope = v[i + 1] * h - v0 - 2 * a0
        bend = 0.5 * a[i + 1] * h * h - a0
        high = (
            10 * rest
            - 4 * slope
            + bend
            + u * (7 * slope - 15 * rest - 2 * bend + u * (6 * rest - 3 * slope + bend))
        )
        return np.asarray(p[i] + u * (v0 + u * (a0 + u * high)))


def integrate(case: dict[str, Any], hidden: Hidden, torques: Shake) -> Motion:
    """Integrate by classical Runge-Kutta steps that end where the random torque or a hidden one has a kink.

    A step also ends where the casing, spun against the rotor at the start, reverses: dry friction jumps there.

    A test compares it with SciPy's DOP853, which needs half a minute where the torque is random.
    """
    # a torque that follows the angle is felt only by steps that are short against a turn at 160 rad/s
    grid = np.arange(0, case["span"] + _STEP, _STEP / 4 if hidden.ripples else _STEP)
    grid = np.unique(np.concatenate([grid, hidden.breaks]))
    y = [*case["start"], 0.0, 0.0] + [0.0] * (len(hidden.heating) + len(hidden.chirp))
    rates = equations(case, hidden, torques)
    times, states, slopes = [float(grid[0])], [y], []
    for begin, late in itertools.pairwise(grid.tolist()):
        t = begin
        while t < late:
            # a casing that turns against the rotor comes to rest at the end of a step
            slope = rates(t, y)[1] if y[1] < 0 else 0.0
            end = min(late, t - y[1] / slope) if slope > 0 else late
            k1, k4, new = _step(rates, t, end, y)
            if y[1] < 0 and new[1] > -_TINY and end < late:
                new[1] = 0.0
            t, y = end, new
            times.append(t)
            slopes.append(k1)
            states.append(y)
        if y[1] < _SLOWEST and k4[1] < 0:
            break
    slopes.append(k4)
    all_states = np.array(states)
    return Motion(np.array(times), all_states[:, :2], np.array(slopes)[:, :2], all_states[:, 2:4])


def _step(
    rates: Callable[[float, Sequence[float]], list[float]], t: float, late: float, y: Sequence[float]
) -> tuple[list[float], list[float], list[float]]:
    """Return the rates at the begin and at the end of a step, and the state at its end."""
    h = late - t
    # within a step the laws are those after its begin and before its end
    k1 = rates(t + 1e-9 * h, y)
    k2 = rates(t + h / 2, [a + h / 2 * k for a, k in zip(y, k1, strict=True)])
    k3 = rates(t + h / 2, [a + h / 2 * k for a, k in zip(y, k2, strict=True)])
    k4 = rates(late - 1e-9 * h, [a + h * k for a, k in zip(y, k3, strict=True)])
    new = [a + h / 6 * (p + 2 * q + 2 * r + s) for a, p, q, r, s in zip(y, k1, k2, k3, k4, strict=True)]
    return k1, k4, new


def equations(
    case: dict[str, Any], hidden: Hidden, torques: Shake
) -> Callable[[float, Sequence[float]], list[float]]:
    """Return the rates of (omega_r, omega_c, psi_r, psi_c, heats, phases of chirps)."""
    a2, b1, b2, d, f, g = (case[k] for k in ("a2", "b1", "b2", "d", "f", "g"))
    step, on_case, between = torques
    last, warm = len(on_case) - 2, len(hidden.heating)
    inertias = case["I_rotor"], case["I_casing"] * (1 + hidden.inertia)

    def rates(t: float, state: Sequence[float]) -> list[float]:
        wr, wc, _, psi, *more = state
        diff = wr - wc
        tau = d * diff + f * diff**g + sum(law(t, wr, wc, psi) for law in hidden.bearing)
        for law in hidden.factor:
            tau *= law(t)
        for (stiff, _), heat in zip(hidden.heating, more, strict=False):
            tau *= math.exp(-stiff * heat)
        extra = [tau * diff - heat / cool for (_, cool), heat in zip(hidden.heating, more, strict=False)]
        extra += [m / wr for _, m, _ in hidden.chirp]
        i = min(int(t / step), last)
        u = t / step - i
        tau += between[i] * (1 - u) + between[i + 1] * u
        on_casing = tau - math.copysign(b1, wc) - b2 * wc + on_case[i] * (1 - u) + on_case[i + 1] * u
        on_casing += sum(law(t, wr, wc, psi) for law in hidden.casing)
        for (k, _, phi), turn in zip(hidden.chirp, more[warm:], strict=True):
            on_casing += k * math.cos(turn + phi)
        on_rotor = -tau - a2 * wr * wr + sum(law(t, wr, wc, psi) for law in hidden.rotor)
        return [on_rotor / inertias[0], on_casing / inertias[1], wr, wc, *extra]

    return rates


def shake(span: float, rms: float, time: float, rng: np.random.Generator) -> Shake:
    """Return two Ornstein-Uhlenbeck torques, straight between the steps: on the casing, and between the bodies."""
    n = int(span / _STEP) + 3
    keep = math.exp(-_STEP / time)
    both = []
    for _ in range(2):
        kicks = rms * math.sqrt(1 - keep**2) * rng.standard_normal(n)
        kicks[0] = rms * rng.standard_normal()
        both.append(list(itertools.accumulate(kicks.tolist(), lambda last, kick: keep * last + kick)))
    return _STEP, *both
