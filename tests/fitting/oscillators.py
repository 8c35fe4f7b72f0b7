"""Bodies that oscillate, integrated by scipy and recorded with noise; dry friction is an event at each reversal."""

from types import SimpleNamespace

import numpy as np
from scipy.integrate import solve_ivp

from fitting import make_record
from fitting.inference._oscillation import ROTATION


def motion(acceleration, start, span, rate=100.0, dry=0.0):
    """Return times, angles from equilibrium and speeds of a body; dry friction stops it where the rest is weaker.

    Parameters
    ----------
    acceleration : callable
        ``(t, angle, omega)`` without dry friction [rad/s2].
    start : (angle, omega)
        [rad], [rad/s].
    span, rate : float
        Length of the record [s], samples per second.
    dry : float
        Dry friction [rad/s2].
    """
    t = np.arange(0.0, span, 1 / rate)
    state = np.zeros((2, len(t)))
    begin, y = 0.0, list(start)
    sense = np.sign(y[1]) or np.sign(acceleration(0.0, y[0], 0.0))

    def stopped(t, y):
        return y[1]

    stopped.terminal = True
    while True:
        stopped.direction = -sense
        run = solve_ivp(
            lambda t, y, s=sense: [y[1], acceleration(t, y[0], y[1]) - s * dry],
            (begin, span),
            y,
            events=stopped if dry else None,
            method="DOP853",
            rtol=1e-11,
            atol=1e-13,
            dense_output=True,
        )
        here = (t >= begin) & (t <= run.t[-1])
        if here.any():
            state[:, here] = run.sol(t[here])
        if not dry or run.status != 1:
            return t, *state
        begin, y = run.t[-1], [run.y[0, -1], 0.0]
        if abs(acceleration(begin, y[0], 0.0)) <= dry:
            state[0, t > begin] = y[0]
            return t, *state
        sense = np.sign(acceleration(begin, y[0], 0.0))


def record(t, value, sigma, seed, quantity="angle", label="body"):
    """Return a recording of one body of unit inertia."""
    noisy = value + sigma * np.random.default_rng(seed).standard_normal(len(t))
    return make_record(
        casing=(t, noisy, np.full(len(t), sigma)),
        rotor=[],
        I_rotor=1.0,
        I_casing=1.0,
        label=label,
        quantity=quantity,
        single=True,
    )


def stub(oscillation=None):
    """Return the motion of a stub of a recording: a rotation, or an oscillation with these attributes."""
    if oscillation is None:
        return ROTATION
    return SimpleNamespace(
        **({"is_smooth": False, "reversals": [0.0], "slow_motion": None} | vars(oscillation))
    )
