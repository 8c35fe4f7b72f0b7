"""Averaged equations of motion of an oscillation, and the initial values of a fit that follow from them.

Over a period the deflection is A cos phi, with slowly varying amplitude A and frequency w. Let f be the angular
acceleration that the laws cause along this motion. Averages over a period, written <>, give (N. N. Bogoliubov, Y. A.
Mitropolsky, Asymptotic Methods in the Theory of Non-Linear Oscillations, 1961)

    A' = -<f sin phi> / w,      phi' = w / 2 - <f cos phi> / (w A).

Both equations are linear in the strengths of the laws. Therefore their integrals along the measured amplitude are
fitted to the measured amplitudes and phases by linear least squares. The phases of the whole record determine the
frequency accurately. A search from these values is therefore never wrong by whole periods.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.dynamics._model import Dynamics
from fitting.inference._case_data import CaseData
from fitting.inference._compression import integrated
from fitting.inference._oscillation import SlowMotion
from fitting.inference._parameters import START_CASING, START_DEFLECTION, START_ROTOR, ParameterLayout

Array = NDArray[np.float64]
Parts = Sequence[tuple[NDArray[np.intp], Array, Array]]

_ANGLES = 2 * np.pi * (np.arange(128) + 0.5) / 128
"""Phases of a period at which laws are averaged [rad]. Chosen: 128 equal steps; a smaller number blurs the jump of dry
friction, a larger one costs time."""
_STEPS = 3
"""Number of passes of the linear fit [1]. Chosen: each pass linearises the equations about the strengths of the
previous pass; with fewer passes, an error of second order remains; more passes cost time."""
_DEGREE = 5
"""Degree of the polynomial between averaged points [1]. Chosen: a smaller value blurs the decay, a larger one
oscillates at the ends."""
_NEGLIGIBLE = 1e-6
"""Smallest ratio of the averages of a torque to its harmonics; below it, the averages count as zero [1]. Chosen: a
smaller value fits rounding errors, a larger one drops weak laws."""
LARGEST_PHASE_ERROR = 0.7
"""If the rms error of the phase is at most this value, a search over the whole record does not converge to a motion
that is wrong by a period [rad]. Chosen: well below half a period; a larger value starts searches at a wrong period, a
smaller one refuses usable initial values."""


class Averaged(NamedTuple):
    """The fitted averaged equations."""

    theta: Array  # shape (variables,); values of all variables
    phase_error: float  # largest rms error of the phase [rad]
    # for each case, the strengths, their columns and the residuals; both in units of the errors, first rows of
    # amplitudes, then of phases
    rows: tuple[tuple[list[str], Array, Array], ...]
    scales: tuple[Array, ...]  # for each case, the errors of amplitudes and phases [rad]


def averaged(
    layout: ParameterLayout,
    data: Sequence[CaseData],
    theta: Array,
    linear: Callable[[ParameterLayout, Sequence[str]], list[str]],
    regress: Callable[[ParameterLayout, Parts], tuple[NDArray[np.intp], Array]],
    errors: Sequence[Array] | None = None,
) -> Averaged | None:
    """Fit the averaged equations of motion to the amplitudes and phases; None if a case has too few periods.

    `linear` selects the parameters in which the equations are linear. `regress` fits the strengths of all cases within
    their bounds. `errors` are `Averaged.scales` of another model; with the same errors, both models are comparable. By
    default, the errors follow from the residuals. A phase error above `LARGEST_PHASE_ERROR` shows that a law does not
    describe the frequency, or that the amplitude is so large that higher harmonics change it.
    """
    theta = theta.copy()
    found = [d.motion.slow_motion for d in data]
    slow = [m for m in found if m is not None]
    if len(slow) < len(found):
        return None
    scales = [np.ones(2 * len(m.time)) for m in slow] if errors is None else list(errors)
    phase_errors = [np.inf] * len(slow)
    rows: list[tuple[list[str], Array, Array]] = []
    for _ in range(_STEPS):
        equations = [_equations(layout, i, m, theta, linear) for i, m in enumerate(slow)]
        parts = []
        for case, (keys, design, target) in enumerate(equations):
            both = _without_level(np.column_stack([design, target]) / scales[case][:, None], 1 / scales[case])
            parts.append((layout.places(case, keys), both[:, :-1], both[:, -1]))
        places, values = regress(layout, parts)
        theta[places] = values
        rows = []
        for case, (keys, design, target) in enumerate(equations):
            rest = (target - design @ theta[layout.places(case, keys)]).reshape(2, -1)
            # the error of a phase is the error of the deflection divided by the amplitude
            relative = slow[case].amplitude / slow[case].amplitude.max()
            rest -= np.array([rest[0].mean(), np.average(rest[1], weights=relative**2)])[:, None]
            amplitude = max(float(np.sqrt(np.mean(rest[0] ** 2))), 1e-9)
            phase_errors[case] = max(float(np.sqrt(np.mean((relative * rest[1]) ** 2))), 1e-9)
            if errors is None:
                same = np.full(len(relative), amplitude)
                scales[case] = np.concatenate([same, phase_errors[case] / relative])
            size = scales[case]
            rows.append((keys, _without_level(design / size[:, None], 1 / size), rest.ravel() / size))
            first = {START_ROTOR: 0.0} | _first_state(data[case].record.span[0], slow[case], rest)
            theta[layout.places(case, layout.starts)] = [first[k] for k in layout.starts]
    return Averaged(theta, max(phase_errors), tuple(rows), tuple(scales))


def _equations(
    layout: ParameterLayout,
    case: int,
    motion: SlowMotion,
    theta: Array,
    linear: Callable[[ParameterLayout, Sequence[str]], list[str]],
) -> tuple[list[str], Array, Array]:
    """Return the strengths of one case, and the linear equations of its amplitudes, then of its phases."""
    dynamics = Dynamics(layout.model.smooth)
    numbers = layout.numbers(theta, case)
    keys = linear(layout, dynamics.parameters)
    t, amplitude = motion.time, motion.amplitude
    rate = np.gradient(motion.phase, t)
    state = np.zeros((len(t), len(_ANGLES), len(dynamics.states)))
    shrinkage, curvature = (_slope(t, amplitude, n) for n in (1, 2))
    state[..., 1] = shrinkage[:, None] * np.cos(_ANGLES) - (amplitude * rate)[:, None] * np.sin(_ANGLES)
    state[..., 2] = amplitude[:, None] * np.cos(_ANGLES)
    times = np.broadcast_to(t[:, None], state.shape[:-1])
    with np.errstate(all="ignore"):
        b = dynamics.linearised(times, state, numbers)[2][:, :, 1]
        harmonics = [np.abs(np.tensordot(b, f(_ANGLES), axes=(1, 0))) for f in (np.sin, np.cos)]
        acts = np.maximum(*harmonics).max(axis=0) > _NEGLIGIBLE * np.abs(b).max(axis=(0, 1))
        # a constant torque only shifts the equilibrium: its averages vanish, and its value in `theta` is kept
        keys = [k for k in keys if acts[dynamics.parameters.index(k)]]
        constant, _, b = dynamics.linearised(times, state, numbers | dict.fromkeys(keys, 0.0))
    columns = [dynamics.parameters.index(k) for k in keys]
    law = np.concatenate([b[:, :, 1, columns], constant[:, :, 1, None]], axis=2)
    shrinking = -np.tensordot(law, np.sin(_ANGLES), axes=(1, 0)) / len(_ANGLES) / rate[:, None]
    turning = -np.tensordot(law, np.cos(_ANGLES), axes=(1, 0)) / len(_ANGLES) / (rate * amplitude)[:, None]
    # x = a cos(phase): a'' - a phase'^2 and -2 a' phase' - a phase'' are the components of the torque along cos and sin
    turning[:, -1] += rate / 2 + curvature / (2 * rate * amplitude)
    shrinking[:, -1] -= amplitude * _slope(t, motion.phase, 2) / (2 * rate)
    sums = np.stack([integrated(t, np.nan_to_num(rates)) for rates in (shrinking, turning)])
    target = np.stack([amplitude, motion.phase]) - sums[..., -1]
    return keys, sums[..., :-1].reshape(2 * len(t), -1), target.ravel()


def _slope(t: Array, values: Array, order: int) -> Array:
    """Return a derivative of slowly varying values, from a polynomial in time."""
    degree = min(_DEGREE, len(t) - 2)
    smooth = np.polynomial.Chebyshev.fit(t, values, degree)
    return np.asarray(smooth.deriv(order)(t))


def _without_level(rows: Array, ones: Array) -> Array:
    """Return rows without their components along the initial amplitude and the initial phase."""
    parts = []
    for block, w in zip(np.split(rows, 2), np.split(ones, 2), strict=True):
        parts.append(block - np.outer(w, w @ block) / (w @ w))
    return np.concatenate(parts)


def _first_state(start: float, motion: SlowMotion, rest: Array) -> dict[str, float]:
    """Return speed [rad/s] and deflection [rad] at the first sample, from the fitted amplitude and phase."""
    slope = (np.array([motion.amplitude, motion.phase]) - rest)[:, :2]
    step = motion.time[1] - motion.time[0]
    rate = (slope[:, 1] - slope[:, 0]) / step
    a, phase = slope[:, 0] + rate * (start - motion.time[0])
    return {START_CASING: float(-a * rate[1] * np.sin(phase)), START_DEFLECTION: float(a * np.cos(phase))}
