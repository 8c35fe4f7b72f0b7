"""Errors of an angle that repeat in each turn, determined from the amplitudes of their harmonics in batches of frames.

In each batch, a polynomial and harmonics of the angle psi are fitted to psi. Harmonics caused by the camera (centre,
tilt) have constant amplitudes. The shadow of a body is displaced from the body by a constant vector and merges with the
blurred edges of the body. The shadow causes an amplitude of order 1 that grows with the blur, in proportion to the
speed. A torque that repeats in each turn, for example due to an unbalance, causes the amplitude A / omega^2, where A is
the amplitude of the angular acceleration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gyrotrack._arrays import Bools, Floats
from gyrotrack.tracking._film_tracker import BATCH
from gyrotrack.tracking._fusion import LEAST_FAST

_HARMONICS = range(1, 13)
"""Orders of the harmonics of the error that are measured [periods per turn]. Chosen: higher orders average out within a
marker's width; a smaller number ignores errors of several equal marks."""
_FIRST_STATED = 3
"""Smallest order of a harmonic that the camera does not cause [periods per turn]. Derived: offset and tilt of the
camera cause orders 1 and 2, which fits estimate."""
_LAWS_OF_SPEED = 4
"""Number of powers of the speed that describe an amplitude of order 1 or 2 [1]. Derived: powers 0, 1, 2 and -2 in
`_beside_laws_of_speed`."""
_DEGREE = 5
"""Degree of the slow change of the angle in a batch [1]. Chosen: a smaller value leaves motion in the harmonics, a
larger one absorbs harmonics of slow bodies."""
_FEWEST_BATCHES = 3
"""A variance of the amplitudes needs at least this number of batches in excess of the number of free constants [1].
Chosen: the six amplitudes of three batches determine the error to 30 %; a smaller number gives an uncertain variance, a
larger one leaves the error of short films unstated."""
_FEWEST_OF_CHANGE = 5
"""Smallest number of batches for a change with the speed [1]. Chosen: a smaller number does not separate the change
from a torque, a larger one leaves the error in short films."""
_LEAST_KNOWN = 0.7
"""Smallest share of known angles of a batch that is used [1]. Chosen: a smaller value fits harmonics across long gaps,
a larger one discards batches for a few frames, among them the first ones, whose speeds differ most."""
_RESEMBLES_MOTION = 2.0
"""An order resembles the motion if the variance of its amplitude, divided by the variance for a complete set of angles,
exceeds this value [1]. Chosen: a smaller value discards batches, a larger one takes motion for error."""
_FAR_FROM_NOISE = 3.0
"""Smallest mean square of an error that is stated, in standard deviations of the noise [1]. Chosen: a smaller value
states noise as an error, a larger one hides small errors."""


def _amplitudes(angle: Floats) -> dict[int, Floats]:
    """Return amplitudes of cos and sin [rad], their variance [rad^2] and the turn [rad] per batch, (batches, 4).

    The turn between the first and the last known angle is extrapolated to a complete batch.
    """
    found: dict[int, list[Floats]] = {order: [] for order in _HARMONICS}
    for first in range(0, len(angle) - BATCH + 1, BATCH):
        known = np.isfinite(angle[first : first + BATCH])
        if known.sum() < _LEAST_KNOWN * BATCH:
            continue
        psi = angle[first : first + BATCH][known]
        x = np.linspace(-1.0, 1.0, BATCH)[known]
        powers = np.polynomial.legendre.legvander(x, _DEGREE)
        waves = np.stack([f(order * psi) for order in _HARMONICS for f in (np.cos, np.sin)], axis=1)
        a = np.concatenate([powers, waves], axis=1)
        covariance = np.linalg.pinv(a.T @ a, hermitian=True)
        fitted = covariance @ (a.T @ (psi - psi.mean()))
        rest = psi - psi.mean() - a @ fitted
        s2 = float(rest @ rest) / (len(psi) - a.shape[1])
        for order in found:
            own = _DEGREE + 1 + 2 * (order - 1) + np.arange(2)
            variance = covariance[own, own]
            if variance.max() < _RESEMBLES_MOTION * 2.0 / len(psi):
                turn = abs(psi[-1] - psi[0]) * 2.0 / (x[-1] - x[0])
                found[order].append(np.array([*fitted[own], s2 * variance.mean(), turn]))
    return {order: np.array(each).reshape(-1, 4) for order, each in found.items()}


def harmonic_error(angle: Floats) -> float:
    """Return the standard deviation of the amplitudes of an error of 1 to 12 periods per turn [rad]; 0 without one.

    In each batch of frames a polynomial and harmonics of the angle are fitted. With residuals of variance s^2 and the
    design matrix A, the coefficients have the covariance s^2 (A'A)^-1. The mean over batches of (a_cos^2 + a_sin^2) / 2
    exceeds the variance of a_cos by the variance of the error. The result is the largest error of all orders, because
    other orders may be as large at other speeds. An order is omitted in batches in which it resembles the motion: the
    frames are in step with the error there, so the error varies slowly.

    Amplitudes of orders 1 and 2 have known causes. They may be constant (centre, tilt), or proportional to the speed
    (rolling shutter), to its square (motion blur) or to its inverse square (a torque that depends on the angle, for
    example due to an unbalance). The residuals of a fit of these four terms are the error of these orders. `angle` (n,)
    is the unwrapped angle of each frame [rad], NaN where it is not known.
    """
    found = _amplitudes(angle)
    largest = 0.0
    for order, each in found.items():
        free = 0 if order >= _FIRST_STATED else _LAWS_OF_SPEED
        if len(each) < _FEWEST_BATCHES + free:
            continue
        *amplitudes, noise, speed = each.T
        left = _beside_laws_of_speed(np.stack(amplitudes), speed) if free else np.stack(amplitudes)
        mean = 0.5 * float(np.sum(left**2)) / (len(each) - free) - float(noise.mean())
        # the variance of the mean square of two amplitudes is the square of its expectation
        limit = _FAR_FROM_NOISE * math.sqrt(float(np.sum(noise**2))) / (len(each) - free)
        largest = max(largest, mean if mean > limit else 0.0)
    return math.sqrt(largest)


def _beside_laws_of_speed(amplitudes: Floats, speed: Floats) -> Floats:
    """Return residuals of amplitudes, (2, batches), after a fit of the powers 0, 1, 2 and -2 of the speed."""
    relative = speed / speed.max()
    laws = np.stack([relative**power for power in (0.0, 1.0, 2.0, -2.0)], axis=1)
    return np.asarray(amplitudes - (laws @ np.linalg.lstsq(laws, amplitudes.T, rcond=None)[0]).T)


_REFERENCE_SPEED = 100.0
"""Reference speed of the standard deviations below [rad/s]. Derived: a casing in the experiment of the paper (V.
Tanrıverdi and A. Erbasan, arXiv:2605.06700)."""
_CHANGE_SIGMA = 2e-3
"""Prior standard deviation of the change of an amplitude per `_REFERENCE_SPEED` [rad]. Measured: 1.5
mrad in a rendered film with a shadow of 16 %; a smaller value keeps the error, a larger one amplifies noise."""
_WIDE_SIGMA = 20e-3
"""Prior standard deviation of a constant amplitude, and of the amplitude due to a torque at `_REFERENCE_SPEED` [rad].
Derived: wide enough to contain no information; an angular acceleration of 200 rad/s2 causes 20 mrad."""
_BATCH_SIGMA = 0.1e-3
"""Standard deviation of an amplitude in a batch that is not due to noise [rad]. Chosen: a smaller value understates the
uncertainty of a result from few batches."""
_LAW_ERROR = 0.1
"""Relative error of the law A / omega^2 for the amplitude due to a torque [1]. Chosen: a smaller value lets slow
batches determine the change with the blur, a larger one ignores these batches."""


@dataclass(frozen=True)
class ChangeWithSpeed:
    """Part of the error once per turn that is proportional to the speed, relative to fast frames."""

    angle: Floats  # shape (n,), error of each frame [rad]
    error: float  # largest standard uncertainty of its amplitudes [rad]


def change_with_speed(angle: Floats, fps: float, fast: Bools) -> ChangeWithSpeed:
    """Fit c_0 + c_1 omega + c_2 / omega^2 to the amplitudes of order 1, and return the error caused by c_1.

    `angle` (n,) is the unwrapped angle of each frame [rad], NaN where it is not known. The constant error is learnt in
    the frames `fast` (n,): at their mean speed, the change is 0. The change is 0 at all speeds if the share of these
    frames is below `LEAST_FAST`.
    """
    known = np.flatnonzero(np.isfinite(angle))
    rows = _amplitudes(angle)[1]
    if fast[known].sum() <= LEAST_FAST * len(known) or len(rows) < _FEWEST_OF_CHANGE:
        return ChangeWithSpeed(np.zeros(len(angle)), 0.0)
    path = np.interp(np.arange(len(angle)), known, angle[known])
    ends = np.clip(np.arange(len(angle))[:, None] + np.array([-1, 1]) * BATCH // 4, 0, len(angle) - 1)
    speed = np.abs(np.diff(path[ends], axis=1)[:, 0]) / np.diff(ends, axis=1)[:, 0] * fps / _REFERENCE_SPEED
    faster = speed - speed[fast].mean()
    v = rows[:, 3] / (BATCH - 1) * fps / _REFERENCE_SPEED
    laws = np.stack([np.ones_like(v), v - speed[fast].mean(), v**-2.0], axis=1)
    prior = np.diag([_WIDE_SIGMA**-2, _CHANGE_SIGMA**-2, _WIDE_SIGMA**-2])
    torque = np.zeros_like(v)
    for _ in range(2):
        variance = rows[:, 2] + _BATCH_SIGMA**2 + (_LAW_ERROR * torque) ** 2
        weighted = laws.T / variance
        covariance = np.linalg.inv(weighted @ laws + prior)
        fitted = covariance @ (weighted @ rows[:, :2])
        torque = np.hypot(*(laws[:, 2:] @ fitted[2:]).T)
    left = rows[:, :2] - laws @ fitted
    excess = max(float(np.sum(left**2 / variance[:, None])) / max(2 * len(v) - 6, 1), 1.0)
    found = faster * (fitted[1, 0] * np.cos(path) + fitted[1, 1] * np.sin(path))
    error = math.sqrt(excess * covariance[1, 1]) * float(np.abs(faster[known]).max())
    return ChangeWithSpeed(found, error)
