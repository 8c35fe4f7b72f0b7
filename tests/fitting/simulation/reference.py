"""Equations of motion by hand, for SciPy to integrate: y = (omega_r, omega_c, own state, psi_r, psi_c)."""

import math

import numpy as np
from scipy.integrate import solve_ivp

I_R, I_C = 5.54e-5, 2.06e-5
INERTIA = {"inertia.rotor": I_R, "inertia.casing": I_C}
PAPER = {
    "rotor.air.quadratic.a2": 9.97e-11,
    "touchpoint.constant.b1": 2.88e-6,
    "casing.air.linear.b2": 8.28e-7,
    "bearing.linear.d": 1.57e-7,
    "bearing.power.f": 0.126e-7,
    "bearing.power.g": 1.32,
}
EXTRA = {
    "none": {},
    "general": {"rotor.air.linear.a1": 3e-9, "bearing.constant.c": 2e-6, "bearing.quadratic.e": 4e-11},
    "stribeck": {"touchpoint.stribeck.k": 4e-5, "touchpoint.stribeck.w": 2.0},
    "step": {"touchpoint.step.k": 8e-6, "touchpoint.step.t0": 61.237},
    "heating": {"bearing.heating.k": 0.06, "bearing.heating.tau_T": 40.0},
    "precession": {"casing.precession.k": 6e-6, "casing.precession.m": 700.0, "casing.precession.phi": 0.8},
    "drift": {"bearing.drift.k": 8e-4, "touchpoint.drift.k": 1e-8},
    "air": {"casing.air.quadratic.k": 2e-10, "casing.air.laminar.k": 3e-9, "casing.windage.k": 5e-12},
    "unbalance": {"casing.unbalance.k": 2e-5, "casing.unbalance.phi": 0.4},
}


def right_hand_side(p, after_step):
    get = p.get

    def rates(t, y):
        wr, wc, own, _, pc = y
        diff = wr - wc
        tau = p["bearing.linear.d"] * diff + p["bearing.power.f"] * abs(diff) ** p[
            "bearing.power.g"
        ] * np.sign(diff)
        tau += get("bearing.constant.c", 0) * np.sign(diff) + get("bearing.quadratic.e", 0) * diff * abs(diff)
        rate = 0.0
        if "bearing.heating.k" in p:
            tau *= math.exp(-p["bearing.heating.k"] * own)
            rate = tau * diff / 1.0 - own / p["bearing.heating.tau_T"]
        if "bearing.drift.k" in p:
            drifting = tau * (1 + p["bearing.drift.k"] * t)
            tau = drifting
        rotor = -tau - p["rotor.air.quadratic.a2"] * wr * abs(wr) - get("rotor.air.linear.a1", 0) * wr
        casing = tau - p["touchpoint.constant.b1"] * np.sign(wc) - p["casing.air.linear.b2"] * wc
        casing -= get("touchpoint.drift.k", 0) * t * np.sign(wc)
        casing -= (
            get("touchpoint.stribeck.k", 0)
            * math.exp(-abs(wc) / get("touchpoint.stribeck.w", 1))
            * np.sign(wc)
        )
        casing -= after_step * get("touchpoint.step.k", 0) * np.sign(wc)
        casing -= get("casing.air.quadratic.k", 0) * wc * abs(wc) + get("casing.air.laminar.k", 0) * wc**1.5
        casing += get("casing.windage.k", 0) * wr**2
        if "casing.precession.k" in p:
            rate = p["casing.precession.m"] / wr
            casing += p["casing.precession.k"] * math.cos(own + p["casing.precession.phi"])
        if "casing.unbalance.k" in p:
            casing += p["casing.unbalance.k"] * math.sin(pc - p["casing.unbalance.phi"])
        return [rotor / I_R, casing / I_C, rate, wr, wc]

    return rates


def integrate(p, start, times, rtol=1e-11, max_step=np.inf):
    """Return the states at the times, (5, times), integrated stretch by stretch between jumps."""
    jump = p.get("touchpoint.step.t0", np.inf)
    y, out, begin = [*start, 0.0, 0.0, 0.0], [], 0.0
    for end, after in ((min(jump, times[-1]), 0.0), (times[-1], 1.0)):
        inside = times[(times >= begin) & (times < end)] if end < times[-1] else times[times >= begin]
        if end > begin:
            grid = np.unique(np.append(inside, end))
            s = solve_ivp(
                right_hand_side(p, after),
                (begin, end),
                y,
                method="DOP853",
                rtol=rtol,
                atol=1e-12,
                t_eval=grid,
            )
            assert s.success
            out.append(s.y[:, np.searchsorted(grid, inside)])
            y, begin = s.y[:, -1], end
        if end == times[-1]:
            break
    return np.concatenate(out, axis=1)
