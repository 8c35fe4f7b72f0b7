"""The pure error of a lack-of-fit test: the random torque that no slow torque can explain.

The level s is estimated stretch by stretch with a *saturated* model: in each stretch the start and any slow
torque are free, so that a missing effect cannot pass for noise. The likelihood is restricted.
A stretch that is far noisier than the others holds an event (a kink, a jump) and is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.case_data import CaseData
from fitting.noise.level import LEVELS, peak, unit_level
from fitting.noise.response import TorqueResponse
from fitting.noise.whitener import TorqueNoise

Array = NDArray[np.float64]

_STRETCHES = 6
_SLOW_TORQUES = 4
_TIMES = (1 / 800, 1 / 400, 1 / 200, 1 / 100, 1 / 50, 1 / 20)
# standard deviations by which the correlation time is taken longer than its best value
_CAUTION = 0.5
# twice the logarithm of a likelihood ratio that pure angle noise hardly ever reaches
_SIGNIFICANT = 8.0
# twice the logarithm of a likelihood ratio that a true level reaches in one case of twenty
_ALLOWED = 4.0
_OUTLIER = 14.0
_MAX_OUTLIERS = 3
_FEWEST = 5


class LevelCurve(NamedTuple):
    """Levels of a random torque [N m] and the log-likelihood of each, the first level being none."""

    levels: Array
    likelihood: Array


def estimate_noise(responses: Sequence[TorqueResponse], residuals: Sequence[Array]) -> list[TorqueNoise]:
    """Estimate the random torque of some cases: a level each, and one correlation time for all.

    Parameters
    ----------
    responses : sequence of TorqueResponse
        One a case.
    residuals : sequence of ndarray
        Their rows: measured minus the path about which the response is linearised.
    """
    span = float(np.mean([r.edges[-1] - r.edges[0] for r in responses]))
    times = [span * share for share in _TIMES]
    searched = [likelihoods(r, x, times) for r, x in zip(responses, residuals, strict=True)]
    curves = [c for c, _ in searched]
    total = [sum(float(c[i].likelihood.max()) for c in curves) for i in range(len(times))]
    quiet = sum(float(c[0].likelihood[0]) for c in curves)
    # where there is no random torque its time is anything; what a model may leave is slow
    seen = 2 * (max(total) - quiet) > _SIGNIFICANT
    time = _cautious_time(times, total) if seen else max(times)
    chosen = [
        likelihoods(response, residual, [time], kept)[0][0]
        for response, residual, (_, kept) in zip(responses, residuals, searched, strict=True)
    ]
    heard = [c for c in chosen if _shows(c)]
    return [TorqueNoise(_level(c, heard), time) for c in chosen]


def _shows(curve: LevelCurve) -> bool:
    return 2 * float(curve.likelihood.max() - curve.likelihood[0]) > _SIGNIFICANT


def _level(curve: LevelCurve, heard: Sequence[LevelCurve]) -> float:
    """Return the level of a case: its own if it shows, else that of the cases where it does, if this one allows it.

    The same bodies turn in the same bearing: where a louder camera hides their random torque, it is there all the same,
    and its slow part would look like something missing.
    """
    if _shows(curve):
        return peak(curve.levels, curve.likelihood)
    if not heard:
        return 0.0
    levels = heard[0].levels[1:]
    each = [_at(c, levels) for c in (curve, *heard)]
    common = int(np.argmax(np.sum(each, axis=0)))
    allowed = 2 * (curve.likelihood.max() - each[0][common]) < _ALLOWED
    return peak(levels, np.sum(each, axis=0)) if allowed else 0.0


def _at(curve: LevelCurve, levels: Array) -> Array:
    return np.interp(
        np.log(levels), np.log(curve.levels[1:]), curve.likelihood[1:], left=float(curve.likelihood[0])
    )


def _cautious_time(times: Sequence[float], likelihood: Sequence[float]) -> float:
    """Return the correlation time: the top of a parabola in its logarithm, and half its standard deviation more.

    What lasts longer than a few seconds is told by its fast tail only: any longer time fits as well then,
    and stands for far more of the slow torque that a missing effect would be mistaken for.
    """
    x, y = np.log(np.array(times)), np.array(likelihood)
    i = int(np.clip(np.argmax(y), 1, len(x) - 2))
    near = slice(i - 1, i + 2)
    bend, slope, _ = np.polyfit(x[near] - x[i], y[near], 2)
    if bend >= 0:
        return float(times[int(np.argmax(y))])
    top, spread = -slope / (2 * bend), np.sqrt(-0.5 / bend)
    return float(np.exp(np.clip(x[i] + top + _CAUTION * spread, x[0], x[-1])))


def likelihoods(
    response: TorqueResponse, residual: Array, times: Sequence[float], kept: NDArray[np.bool_] | None = None
) -> tuple[list[LevelCurve], NDArray[np.bool_]]:
    """Return the restricted likelihood of each level for each correlation time, and the stretches behind it.

    Parameters
    ----------
    response : TorqueResponse
        Of one case.
    residual : ndarray
        Rows: measured minus the path about which the response is linearised.
    times : sequence of float
        Correlation times [s].
    kept : ndarray of bool, optional
        Which stretches count; without it those that are no outliers.
    """
    stretches = _stretches(response.data)
    tables, units = [], []
    for time in times:
        covariance = response.covariance(time)
        units.append(unit_level(np.diag(covariance)))
        tables.append(
            np.array([_likelihoods(s, residual, covariance, LEVELS * units[-1]) for s in stretches])
        )
    # one choice of stretches for all correlation times, or their likelihoods could not be compared
    if kept is None:
        kept = np.all([_ordinary(table) for table in tables], axis=0)
    curves = [LevelCurve(LEVELS * u, t[kept].sum(axis=0)) for u, t in zip(units, tables, strict=True)]
    return curves, kept


def _stretches(data: CaseData) -> list[tuple[Array, Array]]:
    """Return the rows of each stretch and the columns that are free in it."""
    blocks, k, _ = data.casing.lift.shape
    stretches = []
    for part in np.array_split(np.arange(blocks), max(1, min(_STRETCHES, blocks // 4))):
        rows = (part[:, None] * k + np.arange(k)).ravel()
        nodes = data.casing.node_times.reshape(blocks, k)[part]
        x = 2 * (nodes - nodes.min()) / (nodes.max() - nodes.min()) - 1
        powers = np.polynomial.legendre.legvander(x.ravel(), _SLOW_TORQUES + 2).reshape(*x.shape, -1)
        free = (data.casing.lift[part] @ powers).reshape(len(rows), -1)
        stretches.append((rows, np.concatenate([free, data.nuisance[rows]], axis=1)))
    first = len(data.casing.z)
    # a generated curve has no noise
    for window in () if data.record.generated else data.rotor:
        t = window.node_times - window.node_times.mean()
        rows = first + np.arange(len(t))
        first += len(t)
        stretches.append((rows, window.at_nodes(np.stack([np.ones_like(t), t, t**2], axis=1))))
    return stretches


def _likelihoods(stretch: tuple[Array, Array], residual: Array, covariance: Array, levels: Array) -> Array:
    """Return the restricted log-likelihood of a stretch for each level."""
    rows, free = stretch
    size = np.linalg.norm(free, axis=0)
    u, s, _ = np.linalg.svd(free[:, size > 0] / size[size > 0], full_matrices=True)
    outside = u[:, int((s > 1e-7 * s[0]).sum()) :]
    values, vectors = np.linalg.eigh(outside.T @ covariance[np.ix_(rows, rows)] @ outside)
    seen = vectors.T @ (outside.T @ residual[rows])
    variance = 1 + levels[:, None] ** 2 * np.maximum(values, 0.0)
    return np.asarray(-0.5 * (np.log(variance) + seen**2 / variance).sum(axis=1))


def _ordinary(table: Array) -> NDArray[np.bool_]:
    """Return which stretches (rows) are about as noisy as the others; levels are the columns."""
    kept = np.ones(len(table), dtype=bool)
    number = np.arange(len(table))
    for _ in range(_MAX_OUTLIERS):
        if kept.sum() <= _FEWEST:
            break
        without = [int(np.argmax(table[kept & (number != i)].sum(axis=0))) for i in number]
        # a stretch in which the level of the others is far too small
        excess = np.array([
            2 * (row.max() - row[w]) if int(np.argmax(row)) > w else 0.0 for row, w in zip(table, without, strict=True)
        ])  # fmt: skip
        excess[~kept] = 0.0
        if excess.max() < _OUTLIER:
            break
        kept[int(np.argmax(excess))] = False
    return kept
