"""Whether what a named law leaves follows a speed: a sharper test than that of any slow torque.

A law of the wrong shape leaves a torque that is a smooth function of the speed which the true law depends on, the same
in all cases. Few numbers describe it, and noise has fewer ways to look like it than like any slow torque. The
model gets torques piecewise linear in the speed of the casing, the rotor or the bearing, on the casing or in the
bearing, with a few knots or with more. Each choice S, beside all that is free, takes

    chi2 = r'S (S'S)^-1 S'r   with rank(S) degrees of freedom

away if nothing is missing: a smooth test of the model at several resolutions (J. Hart, Nonparametric Smoothing and
Lack-of-Fit Tests, Springer (1997), ch. 5-7). The least of their p-values is set against that of noise put through the
same choices.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from fitting.discovery.any_law import KNOTS, hats, speeds
from fitting.discovery.chance import over_many
from fitting.estimation import Fit
from fitting.estimation.lack import orthonormal
from fitting.estimation.problem import Projection, turned
from fitting.noise import TorqueResponse

Array = NDArray[np.float64]

_RANK = 1e-4
_RANK_FREE = 1e-7
_TINY = 1e-300
_DRAWS = 2000


@dataclass(frozen=True)
class Objection:
    """Whose speed a remaining torque follows best, and the probability of as much by noise (at most)."""

    body: str
    p_value: float

    @property
    def words(self) -> str:
        """What the torque does, to be read behind the name of what leaves it."""
        return f"follows the speed of the {self.body}"


def objection(fit: Fit) -> Objection:
    """Return how clearly what a fit leaves follows a speed.

    Parameters
    ----------
    fit : Fit
        The fit with the law that was named.
    """
    named, tried, free, residual = _rows(fit)
    basis = orthonormal(free, _RANK_FREE)
    left = residual - basis @ (basis.T @ residual)
    looked = [(name, s) for name, s in zip(named, (_beside(s, basis) for s in tried), strict=True) if s.size]
    if not looked:
        return Objection("", 1.0)
    # all that is looked at lies in few dimensions, and noise is the same in each of them
    whole = orthonormal(np.concatenate([s for _, s in looked], axis=1), _RANK_FREE)
    looks = [s.T @ whole for _, s in looked]
    seen = _p_values(looks, (whole.T @ left)[:, None])[:, 0]
    empty = _p_values(looks, np.random.default_rng(0).standard_normal((whole.shape[1], _DRAWS)))
    best = int(np.argmin(seen))
    return Objection(looked[best][0], over_many(float(seen[best]), empty.min(axis=0)))


def _beside(columns: Array, basis: Array) -> Array:
    """Return an orthonormal basis of what columns do beside an orthonormal basis."""
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), _TINY)
    columns = columns - basis @ (basis.T @ columns)
    return orthonormal(columns[:, np.linalg.norm(columns, axis=0) > _RANK_FREE], _RANK)


def _p_values(looks: list[Array], rows: Array) -> Array:
    """Return the p-value of each look (rows) at each set of data (columns)."""
    from scipy.special import chdtrc

    return np.array([chdtrc(len(look), np.sum((look @ rows) ** 2, axis=0)) for look in looks])


def _rows(fit: Fit) -> tuple[list[str], list[Array], Array, Array]:
    """Return names, and as whitened rows of all cases: torques that follow a speed, what is free, the residual."""
    cases = list(zip(fit.problem.data, fit.predictions, fit.noise, strict=True))
    responses = [TorqueResponse(data, p.motion) for data, p, _ in cases]
    each = [speeds(r.centres, p) for r, (_, p, _) in zip(responses, cases, strict=True)]
    record = cases[0][0].record
    bodies = (record.body,) if record.single else (record.body, "rotor", "bearing")
    choices = _choices(np.concatenate(each, axis=1)[: len(bodies)])
    tried, free, residual = [], [], []
    for response, own, (data, p, noise) in zip(responses, each, cases, strict=True):
        acting = response.casing, response.casing - response.rotor
        torques = [acting[body] @ hats(own[which], knots) for which, knots, body in choices]
        rows = np.zeros((len(data.z), sum(t.shape[1] for t in torques)))
        rows[: len(response.casing)] = np.concatenate(torques, axis=1)
        project = Projection(data, noise.whitener.at(noise.pure))
        few = turned(project(np.concatenate([rows, p.columns, (data.z - p.rows)[:, None]], axis=1)))
        *parts, rest = np.split(few, np.cumsum([t.shape[1] for t in torques]), axis=1)
        tried.append(parts)
        free.append(np.zeros((len(few), p.count)))
        free[-1][:, p.places] = rest[:, :-1]
        residual.append(rest[:, -1])
    # a law is the same in all cases
    joined = [np.concatenate(parts) for parts in zip(*tried, strict=True)]
    return [bodies[which] for which, _, _ in choices], joined, np.concatenate(free), np.concatenate(residual)


def _choices(seen: Array) -> list[tuple[int, Array, int]]:
    """Return which speed, the knots in it [rad/s], and whether on the casing (0) or in the bearing (1)."""
    return [
        (which, np.linspace(speed.min(), speed.max(), count), body)
        for (which, speed), count, body in product(enumerate(seen), KNOTS, (0, 1))
    ]
