"""The data as the paper takes them: smoothed angular velocities, and one rotor curve through all windows.

The default is neither: angles are fitted as measured, and the rotor in its windows only.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.polynomial import hermite_e
from numpy.typing import NDArray

from fitting.case_data import SPEED_BLOCKS, SPEED_NOISE_ROWS
from fitting.compression import CASING_DEGREE, ROTOR_DEGREE, Compressed, compress
from fitting.errors import RecordError
from fitting.estimation.levenberg import minimise
from fitting.record import Record, Samples
from fitting.rough_speeds import hermite
from fitting.smoothing import median_width, speeds

Array = NDArray[np.float64]

_POINTS = 2000
_STEPS = 400
# slopes guide the curve between the windows; through the windows it has to go
_SLOPES = 0.01
_TERMS = 21


def prepared(record: Record, data: str | None = None, rotor: str = "windows") -> Record:
    """Return a record as it is to be fitted.

    Parameters
    ----------
    record : Record
        What was measured.
    data : {"angle", "velocity"}, optional
        What is fitted; what was measured, if not given.
    rotor : {"windows", "generated"}
        The rotor's windows as measured, or a generated curve, which is one of velocities.

    Raises
    ------
    RecordError
        If angles are asked for and velocities were measured, or a generated curve beside angles.
    """
    if data not in (None, "angle", "velocity") or rotor not in ("windows", "generated"):
        raise RecordError(
            f"data {data!r} or rotor {rotor!r} is not known", "angle or velocity; windows or generated"
        )
    if data == "angle" and record.quantity == "omega":
        raise RecordError(f"{record.label} holds velocities, no angles", "leave out --data angle")
    if rotor == "generated" and data == "angle":
        raise RecordError(
            "a generated rotor curve is one of velocities", "take --data velocity with --rotor generated"
        )
    if rotor == "generated" and record.single:
        raise RecordError(f"{record.label} has no rotor", "leave out --rotor generated")
    if data == "velocity" or rotor == "generated":
        record = as_velocities(record)
    return with_generated_rotor(record) if rotor == "generated" else record


def as_velocities(record: Record) -> Record:
    """Return the record with the paper's velocities in place of angles: median, gradient, median, ends dropped.

    Their sigma is that of independent samples which would leave as much slow noise (`median_noise`): neighbours share
    most of theirs, and the fit sees only what is slow.
    """
    if record.quantity == "omega":
        return record
    runs = [_velocities(record.casing, SPEED_BLOCKS), *(_velocities(s, 1) for s in record.rotor)]
    return replace(record, casing=runs[0], rotor=tuple(runs[1:]), quantity="omega", digest="")


def _velocities(samples: Samples, blocks: int) -> Samples:
    time, omega = speeds(samples, "angle")
    width = median_width(len(samples))
    step = np.gradient(samples.time)
    noise = np.hypot(*(np.roll(samples.sigma, k) for k in (-1, 1))) / (2 * step)
    noise = np.interp(time, samples.time, noise)
    rise = np.abs(np.gradient(np.convolve(omega, np.full(width, 1 / width), mode="same"), time))
    # the mean runs into nothing at both ends
    rise[: width // 2 + 1], rise[-width // 2 :] = rise[width // 2 + 1], rise[-width // 2 - 1]
    reach = 0.5 * width * float(np.median(step)) * rise / noise
    # a block of gradients e_(i+1) - e_(i-1) keeps the e of both its ends: on the Legendre polynomials of degree k, as
    # large there as (2 k + 1) / samples, mean (degree + 1) / samples
    ends = 2 * (CASING_DEGREE + 1) * blocks / len(samples)
    return Samples(time, omega, noise * np.sqrt(median_noise(reach) + ends))


def median_noise(reach: Array) -> Array:
    """Return the slow noise of a running median of gradients, as a variance over that of one gradient.

    Where the speed rises, sample j beside the middle counts as long as its noise does not lift it over the slope: in
    sums over many medians every gradient v counts as psi(v), cut off at c = slope x half the width. So the spectral
    density at frequency nothing is that of Huber's estimate,

        S = sum over lags of cov[psi(v_0), psi(v_k)] / P(|v| < c)^2,

    and gradients (e_(i+1) - e_(i-1)) / 2h of independent e correlate by -1/2 at lag 2 and at no other. By Hermite
    polynomials (Mehler's formula) cov = sum_k (2 phi(c) He_(k-2)(c))^2 (-1/2)^k / k! over odd k, the first term being
    P^2 / 2.

    Parameters
    ----------
    reach : ndarray
        c, in standard deviations of the noise of one gradient.
    """
    c = np.clip(reach, 0.02, 5.0)
    density = np.exp(-0.5 * c**2) / np.sqrt(2 * np.pi)
    inside = np.vectorize(math.erf, otypes=[float])(c / np.sqrt(2))
    variance = inside - 2 * c * density + c**2 * (1 - inside)
    opposed, factorial = 0.5 * inside**2, 1.0
    for k in range(3, _TERMS, 2):
        factorial *= (k - 1) * k
        polynomial = hermite_e.hermeval(c, np.eye(k - 1)[k - 2])
        opposed = opposed + (2 * density * polynomial) ** 2 * 0.5**k / factorial
    return np.asarray(np.maximum(variance - 2 * opposed, 0.0) / inside**2)


def with_generated_rotor(record: Record) -> Record:
    """Return the record with one curve of the rotor's speed in place of its windows.

    The curve solves d omega/dt = -(k0 + k1 omega + k2 omega^2), the decay of a rotor under dry, linear and
    quadratic friction, fitted to speed and slope of each window. Its samples together weigh as much as the
    measured ones did. As the paper says of its own curve, it has no noise: chi-square of the rotor means nothing.
    """
    record = as_velocities(record)
    seen = [_line(w) for w in record.rotor]
    start, stop = record.span
    grid = np.linspace(start, stop, _STEPS)
    found = _decay(np.array(seen), grid)
    times = np.linspace(start, stop, _POINTS)
    omega = hermite(grid, found, np.gradient(found, grid, edge_order=2), times)
    weight = sum(
        len(w) / (c.scale * float(np.median(w.sigma))) ** 2
        for w, c in ((w, _calibrated(w)) for w in record.rotor)
    )
    curve = Samples(times, omega, np.full(len(times), float(np.sqrt(len(times) / weight))))
    return replace(record, rotor=(curve,), generated=True, digest="")


def _calibrated(window: Samples) -> Compressed:
    degree = min(ROTOR_DEGREE, (len(window) - 1) // 2)
    return compress(window, degree=degree, harmonics=False, blocks=1, noise_rows=SPEED_NOISE_ROWS)


def _line(window: Samples) -> tuple[float, float, float]:
    """Return middle, speed and slope of a window (slope nan of a single sample)."""
    middle = float(window.time.mean())
    if len(window) < 2:
        return middle, float(window.value[0]), float("nan")
    slope, speed = np.polyfit(window.time - middle, window.value, 1)
    return middle, float(speed), float(slope)


def _decay(seen: Array, grid: Array) -> Array:
    """Return the speed on the grid; `seen` holds (time, speed, slope) of each window."""
    time, speed, slope = seen[np.argsort(seen[:, 0])].T
    scale = float(np.abs(speed).max())
    span = float(grid[-1] - grid[0])
    sloped = np.isfinite(slope)

    def curves(u: Array) -> tuple[Array, Array]:
        start, k = u[0], u[1:, ...]

        def rate(x: Array) -> Array:
            return np.asarray(-(k[0] + k[1] * x + k[2] * x**2) / span)

        h = grid[1] - grid[0]
        x = np.empty((len(grid), *np.shape(start)))
        x[0] = start
        for i in range(len(grid) - 1):
            a = rate(x[i])
            b = rate(x[i] + h / 2 * a)
            c = rate(x[i] + h / 2 * b)
            x[i + 1] = x[i] + h / 6 * (a + 2 * b + 2 * c + rate(x[i] + h * c))
        return x, rate(x)

    def residuals(u: Array) -> Array:
        x, v = curves(u)
        parts = [
            np.stack([np.interp(time, grid, column) for column in values.reshape(len(grid), -1).T], axis=-1)
            for values in (x, v)
        ]
        pulls = np.concatenate(
            [
                parts[0] - (speed / scale)[:, None],
                _SLOPES * span * (parts[1] - slope[:, None] / scale)[sloped],
            ]
        )
        # what the windows leave open stays small
        return np.concatenate([pulls, 1e-4 * u[1:].reshape(3, -1)])

    def problem(u: Array) -> tuple[Array, Array]:
        step = 1e-6
        moved = u[:, None] + step * np.concatenate([np.zeros((4, 1)), np.eye(4)], axis=1)
        r = residuals(moved)
        return r[:, 0], (r[:, 1:] - r[:, :1]) / step

    begin = np.array([speed[0] / scale, 0.0, 1.0, 0.0])
    lower = np.array([-np.inf, 0.0, 0.0, 0.0])
    best = minimise(problem, begin, lower, np.full(4, np.inf), tolerance=1e-12, absolute=1e-14)
    return np.asarray(scale * curves(best.x)[0])
