"""Independent equations of motion for SciPy: y = (omega_r, omega_c, state of an effect, psi_r, psi_c)."""

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


def right_hand_side(p, after_step, sense=None):
    """Return dy/dt; with a sense the friction is that of a casing that turns this way, or is held (0)."""
    get = p.get

    def rates(t, y):
        wr, wc, own, _, pc = y
        way = np.sign(wc) if sense is None else sense
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
        casing = tau - p["touchpoint.constant.b1"] * way - p["casing.air.linear.b2"] * wc
        casing -= get("touchpoint.drift.k", 0) * t * way
        casing -= get("touchpoint.stribeck.k", 0) * math.exp(-abs(wc) / get("touchpoint.stribeck.w", 1)) * way
        casing -= after_step * get("touchpoint.step.k", 0) * way
        casing -= get("casing.air.quadratic.k", 0) * wc * abs(wc) + get("casing.air.laminar.k", 0) * abs(
            wc
        ) ** 1.5 * np.sign(wc)
        casing += get("casing.windage.k", 0) * wr**2
        if "casing.precession.k" in p:
            rate = p["casing.precession.m"] / wr
            casing += p["casing.precession.k"] * math.cos(own + p["casing.precession.phi"])
        if "casing.unbalance.k" in p:
            casing += p["casing.unbalance.k"] * math.sin(pc - p["casing.unbalance.phi"])
        casing += get("external.constant.k", 0)
        return [rotor / I_R, 0.0 if sense == 0 else casing / I_C, rate, wr, wc]

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


def _acceleration(rates):
    return lambda t, y: rates(t, y)[1]


def integrate_through_rest(p, start, times, rtol=1e-11):
    """Return states at the times (5, times) and a list of (time, new sense), stopping at each event."""
    jump = p.get("touchpoint.step.t0", np.inf)
    y, now, sense = [*start, 0.0, 0.0, 0.0], 0.0, float(np.sign(start[1]))
    out, events = np.full((5, len(times)), np.nan), []
    while now < times[-1]:
        after = float(now >= jump)
        end = jump if now < jump < times[-1] else times[-1]
        forward, backward = (right_hand_side(p, after, s) for s in (1.0, -1.0))
        if sense == 0:
            marks = [_acceleration(forward), _acceleration(backward)]
            marks[0].direction, marks[1].direction = 1, -1
            if marks[0](now, y) > 0 or marks[1](now, y) < 0:
                sense = 1.0 if marks[0](now, y) > 0 else -1.0
                events.append((now, sense))
                continue
        else:
            marks = [lambda t, y: y[1]]
            marks[0].direction = -sense
        for mark in marks:
            mark.terminal = True
        s = solve_ivp(
            right_hand_side(p, after, sense), (now, end), y, method="DOP853", rtol=rtol, atol=1e-13,
            dense_output=True, events=marks, max_step=1.0,
        )  # fmt: skip
        assert s.success
        here = (times >= now) & (times <= s.t[-1])
        out[:, here] = s.sol(times[here])
        y, now = s.y[:, -1].tolist(), float(s.t[-1])
        if s.status == 1:
            if sense == 0:
                sense = 1.0 if len(s.t_events[0]) else -1.0
            else:
                y[1] = 0.0
                sense = -sense if sense * right_hand_side(p, after, -sense)(now, y)[1] < 0 else 0.0
            events.append((now, sense))
    return out, events
