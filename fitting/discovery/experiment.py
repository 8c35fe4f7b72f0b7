"""What to measure next, so that rival explanations part.

For each experiment that the user could do, each rival that fits the present data predicts a recording; the
recordings of two rivals differ by so many sigma after everything that is free has been refitted. The
experiment with the largest separation of the worst pair is recommended.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fitting.errors import SimulationError
from fitting.estimation import Fit
from fitting.simulation import Mesh, Sampler, sensitivities, solve
from fitting.simulation.sensitivity import angles

if TYPE_CHECKING:
    from fitting.discovery.ranking import Candidate

Array = NDArray[np.float64]

_POINTS = 240
_SIGMA = 1e-3
# sigma below which an experiment is not worth its while
_CLEAR = 5.0


def _options(omega_r: float, omega_c: float) -> dict[str, tuple[float, float, float]]:
    """Return experiments as (start of the rotor, start of the casing, length factor)."""
    return {
        "a run that starts with the rotor at half the speed": (0.5 * omega_r, omega_c, 1.0),
        "a run that starts with the rotor 30 % faster": (1.3 * omega_r, omega_c, 1.0),
        "a recording twice as long": (omega_r, omega_c, 2.0),
        "a run in which the casing is started by hand at high speed": (
            omega_r,
            max(20 * omega_c, 0.3 * omega_r),
            1.0,
        ),
        "a run with the rotor nearly at rest and the casing spun by hand": (
            0.1 * omega_r,
            0.3 * omega_r,
            0.5,
        ),
    }


def next_experiment(fit: Fit, rivals: Sequence[Candidate]) -> str:
    """Return the experiment that parts the rivals best, in words with its sigma; empty for fewer than two.

    Parameters
    ----------
    fit : Fit
        The base.
    rivals : sequence of Candidate
        Refitted candidates that the present data cannot tell apart.
    """
    fits = [(c.effect.name, c.fit) for c in rivals if c.fit is not None and not c.effect.depends_on_angle]
    if len(fits) < 2:
        return ""
    if fit.problem.data[0].record.single:
        return ""  # the options below are those of a rotor in its casing
    label = fit.labels[0]
    start = [fit.estimates[f"initial.omega_{b}@{label}"].value for b in ("r", "c")]
    first, last = fit.problem.data[0].record.span
    best, best_size, pair = "", 0.0, ("", "")
    for text, (rotor, casing, factor) in _options(*start).items():
        span = (first, first + factor * (last - first))
        try:
            separations = [
                (_separation(a, b, np.array([rotor, casing]), span), (x, y))
                for i, (x, a) in enumerate(fits)
                for y, b in fits[i + 1 :]
            ]
        except SimulationError:
            continue
        size, names = min(separations)
        if size > best_size:
            best, best_size, pair = text, size, names
    if best_size < _CLEAR:
        return (
            f"No run of this gyroscope with other start speeds or of other length would tell {fits[0][0]} from "
            f"{fits[1][0]}: change what only one of them depends on (the air's pressure, the surface, the oil)."
        )
    return f"To tell {pair[0]} from {pair[1]}: {best} would part them by {best_size:.0f} sigma."


def _separation(a: Fit, b: Fit, start: Array, span: tuple[float, float]) -> float:
    """Return how many sigma the predictions of b lie from all that a can mimic in a new run."""
    t = np.linspace(*span, _POINTS)
    angle_a, free = _angles(a, start, span, t, with_free=True)
    angle_b, _ = _angles(b, start, span, t, with_free=False)
    per_point = _SIGMA / np.sqrt(a.problem.data[0].n_effective / _POINTS)
    columns = np.concatenate([free, np.ones((len(t), 1)), (t - t[0])[:, None]], axis=1)
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    # the present data holds the parameters already: they move in the new run only within their errors
    difference = angle_b - angle_a
    q = np.linalg.qr(columns)[0]
    left = difference - q @ (q.T @ difference)
    return float(np.linalg.norm(left) / per_point)


def _angles(
    fit: Fit, start: Array, span: tuple[float, float], t: Array, *, with_free: bool
) -> tuple[Array, Array]:
    case = fit.problem.cases[0]
    numbers = fit.problem.layout.numbers(fit.theta, 0)
    y0 = np.array([*start, *case.dynamics.start])
    path = solve(case.dynamics, numbers, y0, Mesh.uniform(*span, 12))
    sampler = Sampler(path.mesh, t)
    angle = sampler.integral(*path.angle("omega_c"))
    if not with_free:
        return angle, np.zeros((len(t), 0))
    nodes = sensitivities(case.dynamics, numbers, path).nodes
    return angle, angles(sampler, path, 1, nodes)
