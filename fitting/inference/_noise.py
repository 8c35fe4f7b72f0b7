"""The noise model of a recording: white measurement noise and process noise.

The level s is estimated stretch by stretch with a *saturated* model: in each stretch the start and any slow
torque are free, so that a missing effect cannot pass for noise. The likelihood is restricted.
A stretch that is far noisier than the others holds an event (a kink, a jump) and is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.dynamics._sensitivities import LinearMotion
from fitting.inference._case_data import CaseData

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Whitener:
    """Turns rows with covariance C = 1 + s^2 K into rows with covariance 1 by the symmetric root of C^-1.

    Attributes
    ----------
    vectors, values : ndarray
        Eigenvectors (m, m) and eigenvalues (m,) of K for the first m rows; the others are white.
    level : float
        s [N m].
    """

    vectors: Array
    values: Array
    level: float = 0.0

    def __call__(self, rows: Array) -> Array:
        """Return C^(-1/2) rows."""
        m = len(self.values)
        if self.level == 0 or m == 0:
            return rows
        gain = 1 / np.sqrt(1 + self.level**2 * self.values)
        inner = self.vectors.T @ rows[:m]
        inner = inner * (gain if rows.ndim == 1 else gain[:, None])
        return np.concatenate([self.vectors @ inner, rows[m:]])

    @property
    def log_determinant(self) -> float:
        """Return log det C."""
        return float(np.log1p(self.level**2 * self.values).sum())

    def at(self, level: float) -> Whitener:
        """Return the whitener for another level of the random torque."""
        return Whitener(self.vectors, self.values, level)


WHITE = Whitener(np.zeros((0, 0)), np.zeros(0))


@dataclass(frozen=True)
class Noise:
    """What was measured about the noise of one case.

    Attributes
    ----------
    scale : float
        Measured noise of the casing's samples over the sigma that came with them.
    pure, level : float
        Rms of the random torque [N m] on the casing and between the bodies, each: what no slow
        torque explains, and what the fitted model leaves.
    time : float
        Its correlation time [s].
    excess : float
        Twice the log-likelihood by which `level` beats `pure`.
    whitener : Whitener
        At `level`.
    """

    scale: float
    pure: float
    level: float
    time: float
    whitener: Whitener = field(repr=False)
    excess: float = 0.0

    def at(self, level: float) -> Noise:
        """Return the noise at another level of the random torque [N m]."""
        return replace(self, level=level, whitener=self.whitener.at(level))


@dataclass(frozen=True)
class TorqueNoise:
    """A random torque: rms [N m] on the casing and between the bodies, each, and correlation time [s]."""

    rms: float
    time: float


LEVELS = np.concatenate([[0.0], np.geomspace(0.03, 3e5, 57)])
# a casing at rest answers to no torque
_FELT = 1e-12
_ROUNDING = 1e-20


def unit_level(variances: Array) -> float:
    """Return the level of torque that is as large as the noise of the angles in half of the rows that feel it."""
    felt = variances[variances > _FELT * variances.max(initial=0.0)]
    return float(1 / np.sqrt(np.median(felt) + 1e-300)) if len(felt) else 1.0


def remaining_level(whitener: Whitener, residual: Array, free: Array, least: float) -> tuple[float, float]:
    """Return the level of random torque that a model leaves, and twice the log-likelihood it gains over `least`.

    The likelihood is restricted: what is free is integrated out.

    Parameters
    ----------
    whitener : Whitener
        Eigenvectors and eigenvalues of K.
    residual : ndarray, shape (rows,)
        Measured minus predicted.
    free : ndarray, shape (rows, columns)
        What is free: derivatives by the parameters, and nuisances.
    least : float
        The pure level, below which no model gets [N m].
    """
    m = len(whitener.values)
    size = np.linalg.norm(free, axis=0)
    columns = np.concatenate([free[:, size > 0] / size[size > 0], residual[:, None]], axis=1)
    rotated = np.concatenate([whitener.vectors.T @ columns[:m], columns[m:]])
    values = np.concatenate([whitener.values, np.zeros(len(residual) - m)])
    # rows of a casing that is held answer to no torque
    answering = whitener.values > _ROUNDING * whitener.values.max(initial=0.0)
    unit = 1 / np.sqrt(np.median(whitener.values[answering]) + 1e-300) if answering.any() else 0.0
    levels = np.concatenate([[least], (LEVELS * unit)[LEVELS * unit > least]])
    deviances = [_deviance(rotated, 1 + s**2 * values) for s in levels]
    best = int(np.argmin(deviances))
    return peak(levels, -np.array(deviances)), deviances[0] - deviances[best]


def peak(levels: Array, likelihood: Array) -> float:
    """Return the level of the highest likelihood, between the levels of the grid by a parabola in its logarithm."""
    i = int(np.argmax(likelihood))
    if not 1 <= i < len(levels) - 1 or levels[i - 1] <= 0:
        return float(levels[i])
    x = np.log(levels[i - 1 : i + 2])
    (a, b), y = x[[0, 2]] - x[1], likelihood[i - 1 : i + 2] - likelihood[i]
    # of the parabola through three points, the middle one highest
    bend = (y[0] / a - y[2] / b) / (a - b)
    if not bend < 0:
        return float(levels[i])
    return float(np.exp(x[1] + np.clip(-(y[0] / a - bend * a) / (2 * bend), a, b)))


def _deviance(rotated: Array, variance: Array) -> float:
    white = rotated / np.sqrt(variance)[:, None]
    r = np.abs(np.diag(np.linalg.qr(white, mode="r")))
    # the last entry is the residual's part beyond all free columns
    return float(np.log(variance).sum() + 2 * np.log(np.maximum(r[:-1], 1e-12)).sum() + r[-1] ** 2)


_CELLS_PER_ROW = 2.5
_RUNS = 8
# of the record
_DEFAULT_TIME = 1 / 200


class TorqueResponse:
    """How the smooth rows of a case answer to a random torque on the casing and in the bearing.

    Parameters
    ----------
    data : CaseData
        The rows.
    motion : LinearMotion
        Small motions about the solution.

    Attributes
    ----------
    rotor, casing : ndarray, shape (smooth rows, cells)
        Response to a torque of 1 N m on one body in each cell.
    """

    def __init__(self, data: CaseData, motion: LinearMotion) -> None:
        self.data = data
        self._smooth = data.slices["smooth"]
        count = int(_CELLS_PER_ROW * self._smooth.stop)
        self.edges = np.linspace(*data.record.span, count + 1)
        inertia = data.record.I_rotor, data.record.I_casing
        self._known: dict[float, Array] = {}
        self.rotor = _impulses(data, motion, self.edges, np.array([1 / inertia[0], 0.0]))[self._smooth]
        self.casing = _impulses(data, motion, self.edges, np.array([0.0, 1 / inertia[1]]))[self._smooth]

    @property
    def centres(self) -> Array:
        """Middle of each cell [s]."""
        return np.asarray(0.5 * (self.edges[1:] + self.edges[:-1]))

    @property
    def default_time(self) -> float:
        """A middling correlation time [s]."""
        return float((self.edges[-1] - self.edges[0]) * _DEFAULT_TIME)

    def covariance(self, time: float) -> Array:
        """Return the covariance K of the smooth rows for torques of rms 1 N m."""
        if time not in self._known:
            # the time that is chosen is asked for twice, no other
            self._known = {time: self._covariance(time)}
        return self._known[time]

    def _covariance(self, time: float) -> Array:
        decay = float(np.exp(-(self.edges[1] - self.edges[0]) / time))
        total = np.zeros((self._smooth.stop, self._smooth.stop))
        order, starts, responses = self._by_time
        for w in responses:
            # R = U' D U with the upper triangle U_kl = decay^(l-k) and D = diag(1, 1 - decay^2, ...): a random torque
            # as what independent kicks leave behind; a product with itself costs half of one with another
            kicked = decaying_sums(w, decay)
            kicked[1:] *= np.sqrt(1 - decay**2)
            for first, run in starts:
                part = kicked[run, first:]
                total[first:, first:] += part.T @ part
        place = np.argsort(order)
        return np.asarray(total[np.ix_(place, place)])

    @cached_property
    def _by_time(self) -> tuple[NDArray[np.intp], list[tuple[int, slice]], list[Array]]:
        """Return the rows in the order in which torques reach them, runs of cells, and both responses.

        No torque moves what was seen before it: a run of cells touches the rows from its `first` on only.
        """
        responses = [self.casing.T, (self.casing - self.rotor).T]
        touched = np.any([w != 0 for w in responses], axis=0)
        last = np.where(touched.any(axis=0), len(touched) - np.argmax(touched[::-1], axis=0), 0)
        order = np.argsort(last, kind="stable")
        edges = np.linspace(0, len(touched), _RUNS + 1).astype(int)
        starts = [
            (int(np.searchsorted(last[order], a, side="right")), slice(a, b)) for a, b in pairwise(edges)
        ]
        return order, starts, [np.ascontiguousarray(w[:, order]) for w in responses]

    def whitener(self, noise: TorqueNoise) -> Whitener:
        """Return what whitens rows with this noise."""
        values, vectors = np.linalg.eigh(self.covariance(noise.time))
        return Whitener(vectors, np.maximum(values, 0.0), noise.rms)


def _impulses(data: CaseData, motion: LinearMotion, cells: Array, direction: Array) -> Array:
    """Return the rows' response to a unit torque in each cell, by variation of constants."""
    centres = 0.5 * (cells[1:] + cells[:-1])
    kicks = motion.kicks(centres, direction) * np.diff(cells)[:, None]
    before = motion.integrated(centres)
    parts = []
    for state, compressed in ((1, data.casing), *((0, w) for w in data.rotor)):
        times = compressed.node_times
        if data.is_angle:
            answer = motion.integrated(times)[:, state] @ kicks.T - np.einsum(
                "cm,cm->c", before[:, state], kicks
            )
        else:
            answer = motion.fundamental(times)[:, state] @ kicks.T
        answer = np.where(times[:, None] > centres, answer, 0.0)
        # within its own cell a torque has acted for a part of the cell only
        cell = np.clip(np.searchsorted(cells, times, side="right") - 1, 0, len(centres) - 1)
        since = times - cells[cell]
        answers = direction[state] * (motion.moving(times) if state else 1.0)
        answer[np.arange(len(times)), cell] = answers * (0.5 * since**2 if data.is_angle else since)
        parts.append(answer)
    return data.rows(parts[0], parts[1:])


def decaying_sums(w: Array, decay: float) -> Array:
    """Return the sums over l >= k of decay^(l-k) w_l, one row a cell."""
    sums = w.copy()
    for k in range(len(sums) - 2, -1, -1):
        sums[k] += decay * sums[k + 1]
    return sums


_STRETCHES = 6
_SLOW_TORQUES = 4
# free harmonics of an oscillation, and powers of time of each
_HARMONICS, _MODULATION = 3, 4
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
    swing = data.oscillation
    stretches = []
    for part in np.array_split(np.arange(blocks), max(1, min(_STRETCHES, blocks // 4))):
        rows = (part[:, None] * k + np.arange(k)).ravel()
        nodes = data.casing.node_times.reshape(blocks, k)[part]
        x = 2 * (nodes - nodes.min()) / (nodes.max() - nodes.min()) - 1
        powers = np.polynomial.legendre.legvander(x.ravel(), _SLOW_TORQUES + 2).reshape(*x.shape, -1)
        width = powers.shape[-1] + (0 if swing is None else 2 * _HARMONICS * _MODULATION)
        values = np.zeros((blocks, k, width))
        values[part] = powers if swing is None else _modulated(powers, swing.phase(nodes))
        free = data.rows(values.reshape(blocks * k, -1), _nothing(data, values.shape[-1]))[rows]
        stretches.append((rows, np.concatenate([free, data.nuisance[rows]], axis=1)))
    first = len(data.casing.z)
    # a generated curve has no noise
    for i, window in enumerate(() if data.record.generated else data.rotor):
        t = window.node_times - window.node_times.mean()
        rows = first + np.arange(len(t))
        first += len(t)
        parabola = _nothing(data, 3)
        parabola[i] = np.stack([np.ones_like(t), t, t**2], axis=1)
        stretches.append((rows, data.rows(np.zeros((len(data.casing.node_times), 3)), parabola)[rows]))
    return stretches


def _modulated(powers: Array, phase: Array) -> Array:
    """Return slow torques, and with them an oscillation whose harmonics have any slowly varying amplitude and phase."""
    slow = powers[..., :_MODULATION]
    waves = [f(m * phase)[..., None] * slow for m in range(1, _HARMONICS + 1) for f in (np.cos, np.sin)]
    return np.concatenate([powers, *waves], axis=-1)


def _nothing(data: CaseData, columns: int) -> list[Array]:
    return [np.zeros((len(w.node_times), columns)) for w in data.rotor]


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
