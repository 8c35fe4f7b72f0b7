"""Preparation of the data as in the paper: smoothed velocities, and one generated rotor curve through all windows.

By default, fits do not use this preparation: they use the measured angles, and the rotor only in its windows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fitting._errors import RecordError
from fitting.inference._case_data import SPEED_NOISE_ROWS
from fitting.inference._compression import ROTOR_DEGREE, Compressed, compress
from fitting.inference._fit import fit
from fitting.inference._metrics import as_velocities
from fitting.inference._optimisation import minimise
from fitting.inference._record import Record, Samples, hermite
from fitting.inference._result import Fit

Array = NDArray[np.float64]

_POINTS = 2000
"""Number of points of the generated rotor curve [1]. Chosen: a smooth curve needs few points; a smaller number blurs
the start, a larger one costs time."""
_STEPS = 400
"""Number of steps of the integration of the rotor curve [1]. Chosen: with fewer, the curve is inaccurate; with more, it
takes longer."""
_SLOPES = 0.01
"""Weight of the slopes of the windows relative to their speeds [1]. Chosen: a smaller value lets the curve oscillate
between windows, a larger one follows the noise of the slopes."""


def with_generated_rotor(record: Record) -> Record:
    """Return a record of velocities in which one curve of the rotor speed replaces the rotor windows.

    The curve solves d omega/dt = -(k0 + k1 omega + k2 omega^2), the decay of a rotor under dry, linear and quadratic
    friction. It is fitted to the speed and the slope of each window. Its samples have the same total weight as the
    measured samples. Like the curve of the paper, it has no noise, so chi-square of the rotor has no meaning.
    """
    lines = [_line(w) for w in record.rotor]
    start, stop = record.span
    grid = np.linspace(start, stop, _STEPS)
    found = _decay(np.array(lines), grid)
    times = np.linspace(start, stop, _POINTS)
    omega = hermite(grid, found, np.gradient(found, grid, edge_order=2), times)
    weight = sum(
        len(w) / (c.scale * float(np.median(w.sigma))) ** 2
        for w, c in ((w, _calibrated(w)) for w in record.rotor)
    )
    curve = Samples(times, omega, np.full(len(times), float(np.sqrt(len(times) / weight))))
    # errors of the rotor's tracking are dropped, because they are unknown where the curve extends beyond the windows
    modes = tuple(m for m in record.modes if m.body != "rotor")
    return replace(
        record, rotor=(curve,), windows=record.rotor, generated=True, start_sigma=(), modes=modes, digest=""
    )


@dataclass(frozen=True)
class CurveBias:
    """The value of a parameter from a generated curve and from the rotor windows, with standard errors."""

    generated: float  # value from the curve
    claimed: float  # standard error of `generated`, without the error of the curve
    measured: float  # value from the windows
    stderr: float  # standard error of `measured`

    @property
    def errors(self) -> float:
        """Shift of the parameter due to the curve, divided by the standard error from the curve.

        At a bound, the standard error from the windows is used.
        """
        known = self.claimed if np.isfinite(self.claimed) and self.claimed > 0 else self.stderr
        return abs(self.generated - self.measured) / known if known > 0 else float("nan")


def curve_bias(found: Fit) -> dict[str, CurveBias]:
    """Return the shift of each parameter due to a generated rotor curve, relative to a fit of the model to the windows.

    The shift has two reasons: the law of the curve differs from the model, and the values of the curve between the
    windows are not measured. The largest shift comes first. The result is empty if no rotor curve was generated.
    """
    layout = found.problem.layout
    if not any(r.generated for r in layout.records):
        return {}
    records = [
        replace(r, rotor=r.windows, windows=(), generated=False, digest="") if r.generated else r
        for r in layout.records
    ]
    own = [k for k in layout.model.free if k in layout.per_case]
    shared = [k for k in layout.model.free if k not in own] if len(records) > 1 else []
    true = fit(layout.model, records, share=shared, per_case=own, ranges=layout.ranges)
    bias = {
        name: CurveBias(e.value, e.stderr, true.estimates[name].value, true.estimates[name].stderr)
        for name, e in found.estimates.items()
        if name not in layout.model.constants and not name.startswith("initial.")
    }
    return dict(sorted(bias.items(), key=lambda item: -np.nan_to_num(item[1].errors)))


def _calibrated(window: Samples) -> Compressed:
    degree = min(ROTOR_DEGREE, (len(window) - 1) // 2)
    return compress(window, degree=degree, blocks=1, noise_rows=SPEED_NOISE_ROWS)


def _line(window: Samples) -> tuple[float, float, float]:
    """Return mean time [s], speed [rad/s] and slope [rad/s2] of a window; the slope of a single sample is NaN."""
    middle = float(window.time.mean())
    if len(window) < 2:
        return middle, float(window.value[0]), float("nan")
    slope, speed = np.polyfit(window.time - middle, window.value, 1)
    return middle, float(speed), float(slope)


def _decay(lines: Array, grid: Array) -> Array:
    """Return the speed of the fitted curve at times `grid`; `lines` contains (time, speed, slope) of each window."""
    time, speed, slope = lines[np.argsort(lines[:, 0])].T
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
        errors = np.concatenate(
            [
                parts[0] - (speed / scale)[:, None],
                _SLOPES * span * (parts[1] - slope[:, None] / scale)[sloped],
            ]
        )
        # weak regularisation of coefficients that the windows do not determine
        return np.concatenate([errors, 1e-4 * u[1:].reshape(3, -1)])

    def problem(u: Array) -> tuple[Array, Array]:
        step = 1e-6
        moved = u[:, None] + step * np.concatenate([np.zeros((4, 1)), np.eye(4)], axis=1)
        r = residuals(moved)
        return r[:, 0], (r[:, 1:] - r[:, :1]) / step

    begin = np.array([speed[0] / scale, 0.0, 1.0, 0.0])
    lower = np.array([-np.inf, 0.0, 0.0, 0.0])
    best = minimise(problem, begin, lower, np.full(4, np.inf), tolerance=1e-12, absolute=1e-14)
    return np.asarray(scale * curves(best.x)[0])


def prepared(record: Record, data: str | None = None, rotor: str = "windows") -> Record:
    """Return a record with the quantity and the rotor data that are to be fitted.

    `data` is "angle" or "velocity", by default the measured quantity. `rotor` is "windows" (as measured) or
    "generated", a curve of velocities. A RecordError is raised for another value, for angles if velocities were
    measured, for a generated curve together with angles, and for a generated curve without a rotor.
    """
    if data not in (None, "angle", "velocity") or rotor not in ("windows", "generated"):
        raise RecordError(
            f"unknown data {data!r} or rotor {rotor!r}",
            "data: angle or velocity; rotor: windows or generated",
        )
    if data == "angle" and record.quantity == "omega":
        raise RecordError(f"{record.label} contains velocities, not angles", "omit --data angle")
    if rotor == "generated" and data == "angle":
        raise RecordError(
            "a generated rotor curve consists of velocities", "use --data velocity with --rotor generated"
        )
    if rotor == "generated" and (not record.rotor or record.is_chain):
        raise RecordError(f"{record.label} contains no rotor", "omit --rotor generated")
    if data == "velocity" or rotor == "generated":
        record = as_velocities(record)
    return with_generated_rotor(record) if rotor == "generated" else record
