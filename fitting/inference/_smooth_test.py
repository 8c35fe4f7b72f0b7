"""Smooth test of lack of fit: whether the residual torque is a smooth function of a speed.

If a law has the wrong shape, the residual torque is a smooth function of the speed on which the true law
depends. This function is the same in all cases, and few numbers describe it. The model is extended by torques that are
piecewise linear in the speed of the casing, the rotor or the bearing, with 4 or 8 knots; they act on the casing or in
the bearing. Let S be the responses for one choice of speed, knots and body, orthogonal to the free columns. Then
chi-square falls by

    chi2 = r'S (S'S)^-1 S'r,

which has rank(S) degrees of freedom if no torque is missing. This is a smooth test at several resolutions (J. Hart,
Nonparametric Smoothing and Lack-of-Fit Tests, Springer (1997), ch. 5-7). The smallest p-value of all choices is
compared with the smallest p-values of null data that are tested with the same choices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from fitting.dynamics._collocation import Sampler
from fitting.effects._mechanism import GYROSCOPE, MAIN, Mechanism
from fitting.inference._case_model import Prediction
from fitting.inference._linear_algebra import orthogonal_to, orthonormal, piecewise_linear
from fitting.inference._metrics import FewRows
from fitting.inference._multiple_tests import over_many_tests
from fitting.inference._noise import Noise, TorqueResponse, tail_probability
from fitting.inference._problem import Problem

Array = NDArray[np.float64]

SPEED_KNOTS = (4, 8)
"""Numbers of knots of the piecewise linear torques of a speed, coarse and fine [1]. Chosen: smaller numbers overlook
narrow deviations, larger ones lower the power for broad deviations."""

_RANK = 1e-4
"""A direction is not tested if its singular value, divided by the largest, is below this value [1]. Chosen: a smaller
value tests rounding errors, a larger one omits deviations that are nearly absorbed."""
_RANK_FREE = 1e-7
"""A direction is not projected out if its singular value, divided by the largest, is below this value [1]. Chosen: a
smaller value projects out rounding errors, a larger one ignores some free columns."""
_TINY = 1e-300
"""Smallest norm that is used as a divisor of a column [1]. Derived: a division by zero is avoided, and any other norm
is larger."""
_DRAWS = 2000
"""Number of null data sets for the smallest of several p-values [1]. Chosen: a smaller number makes p-values coarser
than `Criteria.doubt_adequate`, a larger one costs time."""


@dataclass(frozen=True)
class SmoothTest:
    """The body or joint on whose speed the residual torque depends most clearly, and the p-value (an upper bound)."""

    body: str
    p_value: float

    @property
    def words(self) -> str:
        """The predicate of a sentence about the residual torque."""
        return f"depends on the speed of the {self.body}"


def speeds(times: Array, prediction: Prediction, mechanism: Mechanism = GYROSCOPE) -> Array:
    """Return the speeds of casing, rotor and bearing, or of all bodies and joints, shape (3, times) [rad/s]."""
    path = prediction.path
    motion = mechanism.motion(Sampler(path.mesh, times).value(path.y)[:, : path.speeds].T)
    main = mechanism.speeds[MAIN]
    return np.stack([motion[main], *(v for s, v in motion.items() if s != main)])


def smooth_test(problem: Problem, predictions: Sequence[Prediction], noise: Sequence[Noise]) -> SmoothTest:
    """Return the speed on which the residual torque depends most significantly; p = 1 if no torque can be tested."""
    named, tried, free, residual, shares = _smooth_rows(problem, predictions, noise)
    basis = orthonormal(free, _RANK_FREE)
    projected = orthogonal_to(basis, residual)
    columns = [(name, _orthogonal(s, basis)) for name, s in zip(named, tried, strict=True)]
    columns = [(name, s) for name, s in columns if s.size]
    if not columns:
        return SmoothTest("", 1.0)
    # the tested columns span a space of few dimensions, in which white noise remains white
    whole = orthonormal(np.concatenate([s for _, s in columns], axis=1), _RANK_FREE)
    tests = [s.T @ whole for _, s in columns]
    data = whole.T @ projected
    found = [float(tail_probability(np.sum((t @ data) ** 2), len(t), noise, shares)) for t in tests]
    null = _p_values(tests, np.random.default_rng(0).standard_normal((whole.shape[1], _DRAWS)))
    best = int(np.argmin(found))
    return SmoothTest(columns[best][0], over_many_tests(found[best], null.min(axis=0)))


def _orthogonal(columns: Array, basis: Array) -> Array:
    """Return an orthonormal basis of the components of columns that are orthogonal to `basis`."""
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), _TINY)
    columns = orthogonal_to(basis, columns)
    return orthonormal(columns[:, np.linalg.norm(columns, axis=0) > _RANK_FREE], _RANK)


def _p_values(tests: list[Array], rows: Array) -> Array:
    """Return the p-values, shape (tests, data sets)."""
    from scipy.special import chdtrc

    return np.array([chdtrc(len(test), np.sum((test @ rows) ** 2, axis=0)) for test in tests])


def _smooth_rows(
    problem: Problem, predictions: Sequence[Prediction], noise: Sequence[Noise]
) -> tuple[list[str], list[Array], Array, Array, list[float]]:
    """Return names, tested columns, free columns, residual, and shares of the process noise.

    The columns and the residual are whitened rows of all cases. Each name and its tested columns belong to one choice
    of speed, knots and body.
    """
    cases = list(zip(problem.data, predictions, noise, strict=True))
    record = problem.data[0].record
    responses = [TorqueResponse(data, p.motion) for data, p, _ in cases]
    values = [speeds(r.centres, p, record.mechanism) for r, (_, p, _) in zip(responses, cases, strict=True)]
    bodies = (*(b.name for b in record.bodies), *record.joints)
    choices = _choices(np.concatenate(values, axis=1)[: len(bodies)], len(responses[0].random))
    found, widths = [], np.cumsum([len(knots) for _, knots, _ in choices])[:-1]
    for response, speed, (data, p, n) in zip(responses, values, cases, strict=True):
        acting = response.random
        torques = [acting[body] @ piecewise_linear(speed[which], knots) for which, knots, body in choices]
        rows = np.zeros((len(data.z), sum(t.shape[1] for t in torques)))
        rows[: len(response.casing)] = np.concatenate(torques, axis=1)
        found.append(FewRows.of(data, p, n, rows))
    tried, free, residual, shares = zip(*found, strict=True)
    joined = np.split(np.concatenate(tried), widths, axis=1)
    names = [bodies[which] for which, _, _ in choices]
    return names, joined, np.concatenate(free), np.concatenate(residual), list(shares)


def _choices(values: Array, torques: int = 2) -> list[tuple[int, Array, int]]:
    """Return the index of the speed, the knots [rad/s], and where the torque acts: casing (0) or joint (from 1)."""
    return [
        (which, np.linspace(speed.min(), speed.max(), count), body)
        for (which, speed), count, body in product(enumerate(values), SPEED_KNOTS, range(torques))
    ]
