"""Measured, modelled and residual speeds of a fit, with their standard uncertainties.

The rows of a fit are r = z - m: the projections of the measured angles of a block on polynomials, minus the projections
of the modelled angles. The rows of a block are the coefficients of a polynomial. The mean slope of this polynomial in a
part of the block is the residual of the speed in this part. It is a linear function D r of the rows. With the noise
covariance C of the rows and the columns X of all free parameters, the covariance of r is C - X (X' C^-1 X)^-1 X'. The
uncertainty band follows from this covariance. It contains the effects of angle noise and random torque that the fit
does not absorb.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from fitting._numbers import span_of
from fitting.dynamics._collocation import Sampler
from fitting.inference._case_model import Prediction
from fitting.inference._compression import Compressed
from fitting.inference._noise import Noise, Whitener
from fitting.inference._problem import Problem
from fitting.inference._record import median_width, running_median

Array = NDArray[np.float64]

ROTOR = 0
"""Number of the rotor in arrays of bodies [1]. Derived: a state begins with omega_r and omega_c."""
CASING = 1
"""Number of the casing in arrays of bodies [1]. Derived: a state begins with omega_r and omega_c."""


class Fitted(Protocol):
    """The state of a `Fit`, on which all speeds depend."""

    @property
    def problem(self) -> Problem: ...
    @property
    def predictions(self) -> tuple[Prediction, ...]: ...
    @property
    def noise(self) -> tuple[Noise, ...]: ...
    @property
    def theta(self) -> Array: ...
    @property
    def covariance(self) -> Array: ...


def modelled_speed(fit: Fitted, case: int, body: int, time: Array) -> tuple[Array, Array]:
    """Return the modelled speed of a body and its uncertainty sqrt(s' C s) [rad/s].

    C is the covariance of the parameters, and s are the sensitivities of the speed. The response to laws of an angle is
    smoothed like the measured speeds.
    """
    prediction, model = fit.predictions[case], fit.problem.cases[case]
    sampler = Sampler(prediction.path.mesh, time)
    places = fit.problem.layout.places(case, (*model.dynamics.parameters, *fit.problem.layout.starts))
    slope = sampler.value(prediction.sensitivity.nodes[:, :, body])
    covariance = fit.covariance[np.ix_(places, places)]
    # a parameter without influence has no finite variance, but zero sensitivity
    covariance = np.where(np.isfinite(covariance), covariance, 0.0)
    variance = np.einsum("tp,pq,tq->t", slope, covariance, slope)
    value, response = (
        sampler.value(prediction.path.y[..., body]),
        model.response_to_angles(prediction, fit.theta),
    )
    if response is not None:
        width = median_width(response.shape[-1], model.data.smoothing_width)
        value = value + np.interp(
            time, model.data.record.casing.time, running_median(response[0, body], width)
        )
    return value, np.sqrt(np.maximum(variance, 0.0))


_MOVES = 0.01
"""A measured body counts as moving if its speed, as a share of the largest speed, exceeds this value [1]. Chosen: a
smaller value takes noise at rest for a motion, a larger one overlooks a slow motion that the model excludes."""
_HELD = 0.01
"""A model counts as far from the motion if friction holds a moving body at rest in more than this share of the times
[1]. Chosen: a smaller value excludes a rest that begins a little too early, a larger one accepts a wrong rest."""


def holds_moving_body(fit: Fitted, case: int) -> bool:
    """Return whether friction holds the main body in a model for a part of the record in which the body moves.

    The motion of such a model has no linear response to a torque, so its scores and unmodelled torques are meaningless.
    """
    times, speeds = fit.problem.data[case].initial_speeds
    speed = np.abs(speeds[:, CASING])
    held = fit.predictions[case].motion.moving(times) == 0
    return bool(np.mean(held & (speed > _MOVES * speed.max())) > _HELD)


_PARTS = {"casing": 2, "rotor": 5}
"""Number of parts of a block over which a residual speed is averaged, by body [1]. Chosen: with fewer, residuals are
blurred; with more, they are noisy; a window of the rotor is one block."""
_PERIOD_PARTS = 8
"""Number of parts of a period of an oscillation over which a residual speed is averaged [1]. Chosen: errors of the
amplitude and of the phase are both visible; with fewer, errors of the phase are hidden; with more, each residual is
noisy."""
_POINTS = 40
"""Number of points of the mean over a block [1]. Chosen: a smaller number makes the mean coarse, a larger one costs
time."""


@dataclass(frozen=True, repr=False)
class SpeedResidual:
    """Measured minus modelled speed of a run, averaged over parts of it."""

    # shape (n,); middle and length of each part [s]
    time: Array
    width: Array
    value: Array  # mean residual of the speed in each part [rad/s]
    sigma: Array  # standard deviation of `value` due to noise alone [rad/s]

    def __repr__(self) -> str:
        return f"SpeedResidual: {span_of('speed', self.value, 'rad/s')}"


class SpeedMap:
    """The linear map from the residual rows of a case, without nuisance columns, to its residual speeds."""

    def __init__(self, problem: Problem, noise: Noise, case: int) -> None:
        data = problem.data[case]
        self._unwhitened, self._whitener = data.unwhitened, noise.whitener
        size = np.linalg.norm(data.nuisance, axis=0)
        self._nuisance = data.nuisance[:, size > 0] / size[size > 0]
        self._estimator = np.linalg.pinv(noise.whitener(self._nuisance), rcond=1e-10)
        self.parts: list[tuple[slice, Array, Array, Array]] = []
        periods = data.motion.periods / len(data.casing.operators)
        parts = dict(_PARTS) | {"casing": max(_PARTS["casing"], round(_PERIOD_PARTS * periods))}
        first = 0
        for body, run in (("casing", data.casing), *(("rotor", w) for w in data.rotor)):
            rows = slice(first, first + len(run.z))
            first = rows.stop
            several = len(run.operators) > 1
            count = parts["casing" if several and data.record.is_chain else body]
            self.parts.append((rows, *_slopes(run, count, is_angle=data.is_angle)))

    def without_nuisance(self, rows: Array) -> Array:
        """Return rows without the part that the nuisance columns explain; the rows are not whitened."""
        return self._unwhitened(rows - self._nuisance @ (self._estimator @ self._whitener(rows)))

    def __call__(self, rows: Array) -> list[Array]:
        """Return the mean residual speed in each part of the casing, and of each rotor window [rad/s]."""
        found = self.without_nuisance(rows)
        return [d @ found[where] for where, _, _, d in self.parts]


def speed_residuals(fit: Fitted, case: int) -> tuple[SpeedResidual, tuple[SpeedResidual, ...]]:
    """Return the residual speed of the casing, and of the rotor in each of its windows."""
    data, to_speeds = fit.problem.data[case], SpeedMap(fit.problem, fit.noise[case], case)
    values = to_speeds(data.z - fit.predictions[case].rows)
    spread = spread_of_rows(fit, case)
    found = [
        SpeedResidual(time, width, value, np.linalg.norm(d @ spread[rows], axis=1))
        for value, (rows, time, width, d) in zip(values, to_speeds.parts, strict=True)
    ]
    return found[0], tuple(found[1:])


def spread_of_rows(fit: Fitted, case: int) -> Array:
    """Return a root of the covariance of the residual rows of a case before whitening, (rows, rows)."""
    data, noise = fit.problem.data[case], fit.noise[case]
    moving = ~fit.problem.layout.at_bound(fit.theta)
    free = np.concatenate([fit.predictions[case].jacobian[:, moving], data.nuisance], axis=1)
    return data.unwhitened(_spread(noise.whitener.at(noise.pure), free))


def _spread(whitener: Whitener, free: Array) -> Array:
    """Return a root of the covariance of the residual rows: C^(1/2) (1 - Q Q')."""
    size = np.linalg.norm(free, axis=0)
    u, s, _ = np.linalg.svd(whitener(free[:, size > 0] / size[size > 0]), full_matrices=False)
    q = u[:, s > 1e-10 * s[0]]
    inner = np.eye(len(q)) - q @ q.T
    m, n = len(whitener.vectors), len(whitener.values)
    if whitener.level == 0 or n == 0:
        return np.asarray(inner)
    rotated = whitener.rotated(inner)
    rotated[:n] *= np.sqrt(1 + whitener.level**2 * whitener.values)[:, None]
    rotated[:m] = whitener.vectors @ rotated[:m]
    return rotated


def _slopes(run: Compressed, parts: int, *, is_angle: bool) -> tuple[Array, Array, Array]:
    """Return middles, lengths and the operator D (parts of all blocks, rows)."""
    blocks, k, _ = run.lift.shape
    nodes = run.node_times.reshape(blocks, k)
    times = run.samples.time
    operator = np.zeros((blocks * parts, blocks * k))
    middles, lengths = np.zeros(blocks * parts), np.zeros(blocks * parts)
    for i, (where, _) in enumerate(run.operators):
        inside = times[where]
        edges = np.linspace(inside[0], inside[-1], parts + 1)
        centre, half = 0.5 * (edges[0] + edges[-1]), 0.5 * (edges[-1] - edges[0])
        to_coefficients = np.linalg.inv(run.lift[i] @ legendre.legvander((nodes[i] - centre) / half, k - 1))
        for j in range(parts):
            t = np.linspace(edges[j], edges[j + 1], _POINTS)
            weight = t - t.mean()
            weight = weight / (weight @ weight) if is_angle else np.full(_POINTS, 1 / _POINTS)
            row = i * parts + j
            operator[row, i * k : (i + 1) * k] = (
                weight @ legendre.legvander((t - centre) / half, k - 1) @ to_coefficients
            )
            middles[row], lengths[row] = t.mean(), t[-1] - t[0]
    return middles, lengths, operator
