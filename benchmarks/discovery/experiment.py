"""Recordings with a hidden effect, made by plain SciPy: not one line of `fitting` has a part in the physics.

Torques are written out here once more, from the physics, so that a mistake in the library shows as a miss.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp

I_ROTOR, I_CASING = 5.54e-5, 2.06e-5
BUDGET = 1.33e-4  # N m, the torque that 2e-6 N m are 1.5 % of
# what the strength of an effect refers to: its largest torque in the run
OMEGA_R, OMEGA_C, D = 900.0, 160.0, 890.0
CASES = (
    {
        "a2": 9.97e-11,
        "b1": 2.88e-6,
        "b2": 8.28e-7,
        "d": 1.57e-7,
        "f": 1.26e-8,
        "g": 1.32,
        "start": (900.0, 5.0),
        "span": 200.0,
    },
    {
        "a2": 9.97e-11,
        "b1": 2.4e-5,
        "b2": 8.1e-7,
        "d": 1.57e-7,
        "f": 1.26e-8,
        "g": 1.32,
        "start": (740.0, 12.0),
        "span": 160.0,
    },
)


@dataclass
class Hidden:
    """Extra torques of (t, omega_r, omega_c, psi_c), a factor on the bearing, heating, and camera faults."""

    rotor: Callable = lambda t, wr, wc, psi: 0.0
    casing: Callable = lambda t, wr, wc, psi: 0.0
    bearing: Callable = lambda t, wr, wc: 0.0
    factor: Callable = lambda t: 1.0
    heating: tuple[float, float] = (0.0, 1.0)  # k / C, cooling time
    centre: float = 0.0
    clock: float = 0.0
    inertia: float = 1.0
    ripples: bool = False
    truth: dict = field(default_factory=dict)


def hidden_effects(x: float, span: float, rng: np.random.Generator) -> dict[str, Hidden]:
    """Return every hidden effect at a torque of x newton metres where it is largest."""
    t0 = rng.uniform(0.25, 0.75) * span
    phi = rng.uniform(0, 2 * np.pi)
    w = rng.uniform(4, 20)
    tau_T = rng.uniform(20, 100)  # one bearing: the same in every recording
    m = rng.uniform(200, 900)
    # the bearing's torque is about 1.9e-4 N m at the start and 5e-5 in the tail
    return {
        "rotor.air.linear": Hidden(rotor=lambda t, wr, wc, psi: -x * wr / OMEGA_R),
        "rotor.air.disk": Hidden(rotor=lambda t, wr, wc, psi: -x * (wr / OMEGA_R) ** 1.5),
        "casing.air.quadratic": Hidden(casing=lambda t, wr, wc, psi: -x * (wc / OMEGA_C) ** 2),
        "casing.air.laminar": Hidden(casing=lambda t, wr, wc, psi: -x * (abs(wc) / OMEGA_C) ** 1.5),
        "casing.windage": Hidden(casing=lambda t, wr, wc, psi: x * (wr / OMEGA_R) ** 2),
        "bearing.constant": Hidden(bearing=lambda t, wr, wc: x),
        "bearing.quadratic": Hidden(bearing=lambda t, wr, wc: x * ((wr - wc) / D) ** 2),
        "bearing.load": Hidden(bearing=lambda t, wr, wc: x * (wr / OMEGA_R) ** 2),
        "bearing.load_viscous": Hidden(bearing=lambda t, wr, wc: x * (wr - wc) / D * (wr / OMEGA_R) ** 2),
        "bearing.drift": Hidden(factor=lambda t: 1 + x / 1.0e-4 * t / 200),
        "bearing.heating": Hidden(heating=(x / 1.9e-4 / (0.05 * tau_T), tau_T)),
        "touchpoint.stribeck": Hidden(casing=lambda t, wr, wc, psi: -x * np.exp(-abs(wc) / w)),
        "touchpoint.drift": Hidden(casing=lambda t, wr, wc, psi: -x * t / span),
        "touchpoint.load": Hidden(casing=lambda t, wr, wc, psi: -x * (wr / OMEGA_R) ** 2),
        "touchpoint.step": Hidden(casing=lambda t, wr, wc, psi: -x * (t > t0), truth={"t0": t0}),
        "casing.unbalance": Hidden(casing=lambda t, wr, wc, psi: x * np.sin(psi - phi), ripples=True),
        "casing.asymmetry": Hidden(casing=lambda t, wr, wc, psi: x * np.sin(2 * psi - phi), ripples=True),
        "casing.precession": Hidden(casing=None, truth={"m": m, "phi": phi, "x": x}),
    }


def outside(x: float, span: float, rng: np.random.Generator) -> dict[str, Hidden]:
    """Return effects that no library has."""
    t0, width = rng.uniform(0.3, 0.7) * span, 0.06 * span
    return {
        "casing: cube": Hidden(casing=lambda t, wr, wc, psi: -x * (wc / OMEGA_C) ** 3),
        "casing: bump in time": Hidden(casing=lambda t, wr, wc, psi: -x * np.exp(-(((t - t0) / width) ** 2))),
        "casing: resonance": Hidden(casing=lambda t, wr, wc, psi: -x * np.exp(-(((wc - 110) / 12) ** 2))),
        "bearing: logarithm": Hidden(bearing=lambda t, wr, wc: x * np.log((wr - wc) / 100) / 2.2),
    }


def record(
    case: dict,
    hidden: Hidden,
    *,
    torque_noise: float,
    sigma: float = 1e-3,
    rng: np.random.Generator,
    label: str,
) -> dict:
    """Integrate one run and film it; return arrays as `fitting.record.make_record` takes them."""
    span, step = case["span"], 0.02
    n = int(span / step) + 3
    shake = [_ornstein_uhlenbeck(n, step, torque_noise, rng) for _ in range(2)]
    stiff, cooling = hidden.heating
    chirp = hidden.truth if hidden.casing is None else None

    def rates(t, y):
        wr, wc, _, psi, heat, turn = y
        diff = wr - wc
        tau = case["d"] * diff + case["f"] * diff ** case["g"] + hidden.bearing(t, wr, wc)
        tau *= hidden.factor(t) * np.exp(-stiff * heat)
        i, u = min(int(t / step), n - 2), t / step - int(t / step)
        noisy = [s[i] * (1 - u) + s[i + 1] * u for s in shake]
        extra = chirp["x"] * np.cos(turn + chirp["phi"]) if chirp else hidden.casing(t, wr, wc, psi)
        on_rotor = -tau - noisy[1] - case["a2"] * wr * wr + hidden.rotor(t, wr, wc, psi)
        on_casing = tau + noisy[1] - case["b1"] - case["b2"] * wc + extra + noisy[0]
        return [
            on_rotor / I_ROTOR,
            on_casing / (I_CASING * hidden.inertia),
            wr,
            wc,
            tau * diff - heat / cooling,
            chirp["m"] / wr if chirp else 0.0,
        ]

    time = np.arange(0, span, 1 / 260)
    windows = [
        start + np.arange(3000) / 1000 for start in np.array([0.02, 0.35, 0.78]) * span + rng.uniform(0, 3, 3)
    ]
    every = np.unique(np.concatenate([time, *windows]))
    # a torque that follows the angle is felt only by steps that are short against a turn at 160 rad/s
    longest = 0.005 if hidden.ripples else 0.02 if hidden.truth.get("t0") else 0.1 if torque_noise else 1.0
    solution = solve_ivp(
        rates,
        (0, span),
        [*case["start"], 0, 0, 0, 0],
        method="DOP853",
        rtol=1e-9,
        atol=1e-9,
        t_eval=every,
        max_step=longest,
    )
    psi_r, psi_c = solution.y[2], solution.y[3][np.searchsorted(every, time)]
    psi_c = psi_c + hidden.centre * np.sin(psi_c - 1.1)
    rotor = []
    for w in windows:
        angle = psi_r[np.searchsorted(every, w)]
        seen = w[0] + (w - w[0]) * (1 + hidden.clock)
        rotor.append((seen, angle - angle[0] + sigma * rng.standard_normal(len(w)), np.full(len(w), sigma)))
    return {
        "casing": (time, psi_c + sigma * rng.standard_normal(len(time)), np.full(len(time), sigma)),
        "rotor": rotor,
        "I_rotor": I_ROTOR,
        "I_casing": I_CASING,
        "label": label,
    }


def _ornstein_uhlenbeck(n, step, rms, rng, time=1.0):
    if rms == 0:
        return np.zeros(n)
    keep = np.exp(-step / time)
    out = np.empty(n)
    out[0] = rms * rng.standard_normal()
    kicks = rms * np.sqrt(1 - keep**2) * rng.standard_normal(n)
    for i in range(1, n):
        out[i] = keep * out[i - 1] + kicks[i]
    return out
