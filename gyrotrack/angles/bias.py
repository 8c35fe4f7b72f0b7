"""Errors of a marker's angle that repeat: with its place in the picture, and with what stands beside it.

Lamps that mirror in the metal pull a marker the same way whenever it passes the same place; the edge of the
bar and its shadow do so whenever it passes the bar. Such errors are curves over an angle, and are learnt
from how far the marker lies off its body's even motion, as a smooth closed curve: the c that minimises

    sum w (r - B c)^2 / s^2  +  |D2 c|^2 / bend^2  +  |c|^2 / size^2

with B hat functions on evenly spaced knots, s the scatter, D2 second differences round the circle.

What a body really does must not be taken for an error. An uneven weight or a sloping table changes the
motion once or twice a turn of the body, for all its markers together. A body that turns fast does not follow
such torques: a swing of its acceleration by A shows as A / omega^2 in its angle. Where there are fast
frames, curves are learnt from them and hold for all; where there are none, that part (orders 1 and 2 over
the body's angle) is left in (`without_common_motion`).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gyrotrack.dataset.columns import stretches

Floats = npt.NDArray[np.float64]

KNOTS = 72
_BEND, _SIZE = 4e-3, 3e-2


def closed_curve(angle: Floats, residual: Floats, weight: Floats) -> Floats:
    """Fit a smooth closed curve to residuals over an angle; return its values at the knots, (KNOTS,).

    Parameters
    ----------
    angle, residual : ndarray, shape (n,)
        In rad.
    weight : ndarray, shape (n,)
        1 / variance of each residual, 0 for those not to be used.
    """
    low_low, high_high, both = np.zeros((3, KNOTS))
    right = np.zeros(KNOTS)
    for some in stretches(len(angle)):
        use = (weight[some] > 0) & np.isfinite(residual[some])
        place = np.mod(angle[some][use], 2.0 * np.pi) * KNOTS / (2.0 * np.pi)
        low = np.floor(place).astype(np.int64) % KNOTS
        part = place - np.floor(place)
        high = (low + 1) % KNOTS
        w, r = weight[some][use], residual[some][use]
        low_low += np.bincount(low, w * (1 - part) ** 2, KNOTS)
        high_high += np.bincount(high, w * part**2, KNOTS)
        both += np.bincount(low, w * part * (1 - part), KNOTS)
        right += np.bincount(low, w * (1 - part) * r, KNOTS) + np.bincount(high, w * part * r, KNOTS)
    beside = np.roll(np.diag(both), 1, axis=1)
    normal = np.diag(low_low + high_high) + beside + beside.T
    eye = np.eye(KNOTS)
    second = np.roll(eye, 1, axis=1) + np.roll(eye, -1, axis=1) - 2.0 * eye
    normal += second.T @ second / _BEND**2 + eye / _SIZE**2
    return np.asarray(np.linalg.solve(normal, right))


def curve_at(curve: Floats, angle: Floats) -> Floats:
    """Evaluate a closed curve given at the knots."""
    place = np.mod(angle, 2.0 * np.pi) * KNOTS / (2.0 * np.pi)
    return np.asarray(np.interp(place, np.arange(KNOTS + 1), np.append(curve, curve[0])))


def without_common_motion(curves: dict[str, Floats], mounts: dict[str, float]) -> dict[str, Floats]:
    """Take out of the curves what all markers do together once or twice a turn of their body."""
    knots = np.arange(KNOTS) * 2.0 * np.pi / KNOTS
    together = np.mean([curve_at(curve, knots + mounts[name]) for name, curve in curves.items()], axis=0)
    spectrum = np.fft.rfft(together)
    spectrum[3:] = 0.0
    common = np.fft.irfft(spectrum, KNOTS)
    return {name: curve - curve_at(common, knots - mounts[name]) for name, curve in curves.items()}


def once_a_turn(curve: Floats) -> complex:
    """Return by how far the axis would have to lie beside the assumed one to make a curve: x + i y over the radius.

    A marker at v = e + r (cos a, sin a), y up, is seen about the axis assumed at 0 at the angle
    a + (e_y cos a - e_x sin a) / r.
    """
    first = complex(np.fft.rfft(curve)[1]) * 2.0 / KNOTS
    return complex(first.imag, first.real)
