"""The next experiment that separates rival explanations.

For each experiment that the user could do, each rival that fits the present data predicts a recording; the
recordings of two rivals differ by so many sigma after everything that is free has been refitted. The
experiment with the largest separation of the worst pair is recommended.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting._errors import SimulationError
from fitting.discovery._criteria import Criteria
from fitting.dynamics._events import solve
from fitting.dynamics._mesh import Mesh, Sampler
from fitting.dynamics._sensitivities import angles, sensitivities
from fitting.inference._result import Fit

if TYPE_CHECKING:
    from fitting.discovery._select import Candidate


Array = NDArray[np.float64]

_POINTS = 240
_SIGMA = 1e-3


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


def next_experiment(fit: Fit, rivals: Sequence[Candidate], criteria: Criteria) -> str:
    """Return the experiment that separates the rivals best, in words with its sigma; empty for fewer than two.

    Parameters
    ----------
    fit : Fit
        The base.
    rivals : sequence of Candidate
        Refitted candidates that the present data cannot separate.
    criteria : Criteria
        `experiment_sigma`.
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
            runs = [(name, _run(f, np.array([rotor, casing]), span)) for name, f in fits]
        except SimulationError:
            continue
        size, names = min(
            (_separation(a, b), (x, y)) for i, (x, a) in enumerate(runs) for y, b in runs[i + 1 :]
        )
        if size > best_size:
            best, best_size, pair = text, size, names
    if best_size < criteria.experiment_sigma:
        return (
            f"No run of this gyroscope with other initial speeds or of other length separates {fits[0][0]} from "
            f"{fits[1][0]}: change what only one of them depends on (air pressure, surface, lubricant)."
        )
    return f"To separate {pair[0]} from {pair[1]}: {best} ({best_size:.0f} sigma)."


class _Run(NamedTuple):
    """The casing's angle in a run, its free columns (orthonormal), and the noise of each point."""

    angle: Array
    free: Array
    sigma: float


def _separation(a: _Run, b: _Run) -> float:
    """Return the distance of b's prediction from all that a can reproduce in a new run [sigma]."""
    difference = b.angle - a.angle
    left = difference - a.free @ (a.free.T @ difference)
    return float(np.linalg.norm(left) / a.sigma)


def _run(fit: Fit, start: Array, span: tuple[float, float]) -> _Run:
    t = np.linspace(*span, _POINTS)
    case = fit.problem.cases[0]
    numbers = fit.problem.layout.numbers(fit.theta, 0)
    path = solve(case.dynamics, numbers, np.array([*start, *case.dynamics.start]), Mesh.uniform(*span, 12))
    sampler = Sampler(path.mesh, t)
    nodes = sensitivities(case.dynamics, numbers, path).nodes
    # the start angle and the start speed of the new run are free as well
    columns = np.concatenate(
        [angles(sampler, path, 1, nodes), np.ones((len(t), 1)), (t - t[0])[:, None]], axis=1
    )
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    sigma = _SIGMA / np.sqrt(fit.problem.data[0].n_effective / _POINTS)
    return _Run(sampler.integral(*path.angle("omega_c")), np.linalg.qr(columns)[0], sigma)
