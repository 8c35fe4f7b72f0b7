"""The data as the paper takes them: smoothed angular velocities, and one rotor curve through all windows.

The default is neither: angles are fitted as measured, and the rotor in its windows only.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fitting.compression import ROTOR_DEGREE, compress
from fitting.errors import RecordError
from fitting.estimation.levenberg import minimise
from fitting.record import Record, Samples
from fitting.rough_speeds import hermite
from fitting.smoothing import WIDTH, speeds

Array = NDArray[np.float64]

_POINTS = 2000
_STEPS = 400
# slopes guide the curve between the windows; through the windows it has to go
_SLOPES = 0.01
# standard error of a median over that of a mean, for normal noise
_MEDIAN = float(np.sqrt(np.pi / 2))


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

    Their sigma is that of a gradient of the angles over the points among which the median picks; as everywhere it
    only weighs samples against each other, and the level of the noise is measured.
    """
    if record.quantity == "omega":
        return record
    runs = [_velocities(s) for s in (record.casing, *record.rotor)]
    return replace(record, casing=runs[0], rotor=tuple(runs[1:]), quantity="omega", digest="")


def _velocities(samples: Samples) -> Samples:
    time, omega = speeds(samples, "angle")
    width = min(WIDTH, len(samples))
    step = np.gradient(samples.time)
    noise = np.hypot(*(np.roll(samples.sigma, k) for k in (-1, 1))) / (2 * step)
    noise = np.interp(time, samples.time, noise)
    # a median picks among the points whose values overlap: where the speed changes fast these are few
    change = np.abs(np.gradient(np.convolve(omega, np.full(width, 1 / width), mode="same"), time))
    among = np.clip(2 * noise / np.maximum(change * np.median(step), 1e-300), 1, width)
    return Samples(time, omega, noise * np.where(among > 1, _MEDIAN, 1.0) / np.sqrt(among))


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
        for w, c in (
            (w, compress(w, degree=min(ROTOR_DEGREE, (len(w) - 1) // 2), harmonics=False, blocks=1))
            for w in record.rotor
        )
    )
    curve = Samples(times, omega, np.full(len(times), float(np.sqrt(len(times) / weight))))
    return replace(record, rotor=(curve,), generated=True, digest="")


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
