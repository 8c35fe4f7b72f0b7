"""Covariance of the rows of a case, and the level of random torque in the residuals of a model.

Rows in units of the white noise of the angles have the covariance C(s) = 1 + s^2 K. K is the covariance of their
response to independent Ornstein-Uhlenbeck torques of rms 1 N m, on the casing and between the bodies (on the main body
and in each joint), with the correlation time of the process noise of the recording. The row of a harmonic of the angle
responds only to the torque at its frequency and has a separate variance.

Two levels matter. The *pure* level is a property of the recording (`fitting.inference._process_noise`): it does not
depend on a model, and chi-square and cross-validation errors of every fit of the recording use it. The *level* of a fit
is the maximum of the restricted likelihood of its residuals. It is larger than the pure level if the model has a lack
of fit. It is smaller if the recording alone does not exclude a random torque, but the model describes the data without
it. Parameters are estimated, and rival models are compared, at this level. Otherwise an interval with residuals of a
thousand standard deviations would dominate the fit. Tests of a fit use the smaller of the two levels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fitting.dynamics._sensitivities import LinearMotion
from fitting.effects._mechanism import MAIN
from fitting.inference._case_data import CaseData
from fitting.inference._process_noise import ProcessNoise

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Whitener:
    """Turns rows with covariance C = 1 + s^2 K into rows with covariance 1 by the symmetric root of C^-1."""

    vectors: Array  # (m, m): eigenvectors of K for the first m rows
    # (n >= m,): eigenvalues of K, then variances of further rows that are independent; the other rows are white
    values: Array
    level: float = 0.0  # s [N m]

    def __call__(self, rows: Array) -> Array:
        """Return C^(-1/2) rows."""
        m, n = len(self.vectors), len(self.values)
        if self.level == 0 or n == 0:
            return rows
        rotated = self.rotated(rows)
        gain = 1 / np.sqrt(1 + self.level**2 * self.values)
        rotated[:n] *= gain if rows.ndim == 1 else gain[:, None]
        rotated[:m] = self.vectors @ rotated[:m]
        return rotated

    def coloured(self, white: Array) -> Array:
        """Return C^(1/2) times white rows."""
        m, n = len(self.vectors), len(self.values)
        rows = self.rotated(white)
        scale = np.sqrt(1 + self.level**2 * self.values)
        rows[:n] *= scale if rows.ndim == 1 else scale[:, None]
        rows[:m] = self.vectors @ rows[:m]
        return rows

    def rotated(self, rows: Array) -> Array:
        """Return the components of rows along the principal axes of K."""
        m = len(self.vectors)
        return np.concatenate([self.vectors.T @ rows[:m], rows[m:]])

    def share(self, rows: Array) -> float:
        """Return the share of the random torque in the variance along orthonormal columns of whitened rows."""
        n = len(self.values)
        if not n or not rows.size:
            return 0.0
        torque = self.level**2 * self.values
        square = np.sum(self.rotated(rows)[:n] ** 2, axis=1)
        return float(square @ (torque / (1 + torque)) / np.sum(rows**2))

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
    """Noise of one case, and the random torque in the residuals of a model."""

    scale: float  # white noise of the casing's samples, divided by their stated sigma
    # rms of the process noise of the recording [N m], equal on the main body and in each joint, and its standard
    # uncertainty
    pure: float
    pure_u: float
    level: float  # rms of the random torque in the residuals of the fitted model [N m]
    time: float  # correlation time of process noise and random torque [s]
    whitener: Whitener = field(repr=False)  # whitener of the rows at `level`
    process: ProcessNoise = field(repr=False)  # the process noise as an acceleration
    # twice the log-likelihood ratio of the most likely level to no random torque
    excess: float = 0.0
    # rms of the random torque that the residuals do not exclude [N m]; it is used if `level` is not significant and the
    # angle noise is correlated
    unresolved: float = 0.0
    # whether `level` is at the upper limit of the estimate; the model may then need a larger level
    limited: bool = False
    # whether all cases of a joint fit have the same level, because the model describes each case alone
    common: bool = False
    # variables of the motion about which the response of the rows is linearised, by their names in the fit
    about: Mapping[str, float] = field(default_factory=dict, repr=False)

    def at(self, level: float) -> Noise:
        """Return the noise at another level of the random torque [N m]."""
        return replace(self, level=level, whitener=self.whitener.at(level))

    @property
    def with_unresolved(self) -> Noise:
        """The noise including `unresolved`, from which the uncertainties of parameters are computed."""
        return self.at(max(self.level, self.unresolved))

    @property
    def tested(self) -> float:
        """The level at which residuals are tested [N m]: the smaller of the levels of the recording and of the fit.

        The level of the recording alone may be so large that it hides a lack of fit.
        """
        return self.pure if self.limited else min(self.pure, self.level)

    @property
    def least(self) -> float:
        """The lowest level of process noise that the recording allows [N m]."""
        return self.pure * self.process.least / self.process.level

    @property
    def raised(self) -> bool:
        """Whether the model may need more random torque than the recording contains."""
        return self.level > _MORE * self.least


@dataclass(frozen=True)
class TorqueNoise:
    """A random torque: rms [N m], equal on the main body and in each joint, and correlation time [s]."""

    rms: float
    time: float


def tail_probability(chi2: float | Array, dof: int, noise: Sequence[Noise], shares: Sequence[float]) -> Array:
    """Return the probability of a larger chi-square, with the uncertain process noise of the cases integrated out.

    `noise` is empty for white noise alone. `shares` are the fractions of the variance due to the process noise of each
    case.
    """
    from scipy.special import chdtrc

    scales, weights = possible_scales(noise, shares)
    x = np.maximum(np.asarray(chi2, dtype=float), 0.0)
    return np.asarray(chdtrc(dof, x[..., None] / scales) @ weights)


def possible_scales(noise: Sequence[Noise], shares: Sequence[float]) -> tuple[Array, Array]:
    """Return possible ratios of the true to the assumed variance in a sum of squares, and their probabilities.

    The process noise of each case is known with an uncertainty (see `tail_probability`); cases have equal weights.
    """
    if not noise:
        return np.ones(1), np.ones(1)
    scales = [1 - share + share * n.process.ratios for n, share in zip(noise, shares, strict=True)]
    weights = np.concatenate([n.process.weights for n in noise])
    return np.concatenate(scales), weights / weights.sum()


def variance_factor(chi2: float, dof: int) -> float:
    """Return the expected ratio of the variance of residuals to the variance of the noise.

    Noise alone (factor 1) and a lack of fit (factor above 1) have equal prior probabilities. For a lack of fit, the
    reciprocal of the factor has a uniform prior between 0 and 1. If chi-square is consistent with the noise, the
    standard errors hardly change. If chi-square is significantly larger, the factor approaches chi2/dof (R. T. Birge,
    Phys. Rev. 40, 207 (1932)).
    """
    from scipy.special import gammainc, gammaln

    half, a = 0.5 * chi2, 0.5 * dof
    mass = float(gammainc(a + 1, half)) if dof > 0 else 0.0
    if mass == 0:
        return 1.0
    log_odds = gammaln(a + 1) + np.log(mass) - (a + 1) * np.log(half) + half
    probability = 1 / (1 + np.exp(-log_odds))
    return float(1 + probability * (half / a * gammainc(a, half) / mass - 1))


_LEAST_SHARE = 0.1
"""Lowest trial level, divided by the level at which the response of the most sensitive row equals the white noise [1].
Chosen: a lower level changes no row noticeably; with a higher one, the gap between zero and the lowest trial is too
large."""
_EVIDENCE = 2.7
"""Twice the log-likelihood ratio above which residuals show a random torque [1]. Derived: without a random torque it is
larger in 5 % of the recordings (half of chi-square with one degree of freedom; S. Self, K.-Y. Liang, J. Am. Stat.
Assoc. 82, 605 (1987))."""
_LARGEST_SHARE = 3e5
"""Highest trial level, divided by the level at which the response of the median row equals the white noise [1]. Chosen:
far above the level that any lack of fit needs; with a lower limit, the most likely level may be at this limit."""
_PER_DECADE = 8
"""Number of trial levels per decade [1]. Chosen: a coarser grid rounds the level, a finer one costs time."""
_ROUNDING = 1e-20
"""A row counts as not responding if its response, as a share of the largest response, is below this value [1]. Chosen:
rows of a casing at rest contain only rounding errors; a larger value excludes slow rows, a smaller one includes rows at
rest."""
_MORE = 1.5
"""Smallest ratio of a raised level to the lowest level that the recording allows [1]. Chosen: a smaller value takes the
uncertainty of the level for a lack of fit, a larger one overlooks a raised level."""
_LEAST_RESPONSE = 0.1
"""Lowest trial value of an unresolved level, divided by the level at which the response of the most sensitive row
equals the white noise [1]. Chosen: a lower level changes nothing; with a higher one, the gap between zero and the
lowest trial is too large."""
_LEAST_EXPECTED = 0.03
"""Lowest trial value of an unresolved level, divided by the expected level [1]. Chosen: a smaller value changes
nothing; with a larger one, the gap between zero and the lowest trial is too large."""
_MOST_EXPECTED = 4.0
"""Highest trial value of an unresolved level, divided by the expected level [1]. Chosen: a normal prior has a
probability of 6e-5 beyond it; a smaller value cuts the prior, a larger one makes the grid coarser."""
_UNRESOLVED_LEVELS = 16
"""Number of trial values of an unresolved level [1]. Chosen: a smaller number makes the posterior mean coarse, a larger
one costs time."""


def remaining_level(whitener: Whitener, residual: Array, free: Array) -> tuple[float, float]:
    """Return the most likely level of random torque, and twice the log-likelihood ratio against no random torque.

    The likelihood is restricted: the columns `free` (rows, columns), derivatives with respect to parameters and
    nuisance parameters, are integrated out. The level is set to zero unless its evidence exceeds `_EVIDENCE`. White
    noise alone exceeds this value in only 1 of 20 recordings. An insignificant level would double the standard errors
    of all parameters that act like a slow torque.
    """
    rotated, values = _rotated(whitener, residual, free)
    # rows of a casing at rest do not respond to a torque
    smooth = values[: len(whitener.vectors)]
    responding = smooth[smooth > _ROUNDING * smooth.max(initial=0.0)]
    levels = _trial_levels(responding) if len(responding) else np.zeros(1)
    deviances = [_deviance(rotated, 1 + s**2 * values) for s in levels]
    best = int(np.argmin(deviances))
    excess = deviances[0] - deviances[best]
    return (_peak(levels, -np.array(deviances)) if excess > _EVIDENCE else 0.0), excess


def _trial_levels(responses: Array) -> Array:
    """Return zero, and levels from a level that hardly changes any row up to a level far above any misfit."""
    first, last = _LEAST_SHARE / np.sqrt(responses.max()), _LARGEST_SHARE / np.sqrt(np.median(responses))
    count = int(np.ceil(_PER_DECADE * np.log10(last / first))) + 1
    return np.concatenate([[0.0], np.geomspace(first, last, count)])


def unresolved_level(whitener: Whitener, residual: Array, free: Array, expected: float) -> float:
    """Return the rms random torque that residuals do not exclude [N m]: the root of the posterior mean of s^2.

    In a short record, or for slow torques, the most likely level is often zero although larger levels are nearly as
    likely. The standard errors of parameters would not include these levels. The prior has probability 1/2 for no
    random torque, and 1/2 for a half-normal distribution of the rms with standard deviation `expected` [N m]. The
    expected level is the level of the recording, a posterior mean that already contains the heavy tail of its
    distribution. If the residuals contain no information, the mean of s^2 is half of `expected`^2. If the residuals
    exclude most levels, the hypothesis of no random torque becomes far more probable.
    """
    rotated, values = _rotated(whitener, residual, free)
    largest = values.max(initial=0.0)
    if not (largest > 0 and expected > 0):
        return 0.0
    first = min(_LEAST_RESPONSE / np.sqrt(largest), _LEAST_EXPECTED * expected)
    s = np.geomspace(first, _MOST_EXPECTED * expected, _UNRESOLVED_LEVELS)
    deviance = np.array([_deviance(rotated, 1 + x**2 * values) for x in (0.0, *s)])
    none, *likelihood = np.exp(0.5 * (deviance.min() - deviance))
    prior = np.sqrt(2 / np.pi) * np.exp(-0.5 * (s / expected) ** 2) / expected
    weight = np.array(likelihood) * prior * np.gradient(s)
    return float(np.sqrt(weight @ s**2 / (none + weight.sum())))


def _rotated(whitener: Whitener, residual: Array, free: Array) -> tuple[Array, Array]:
    """Return scaled free columns and residual along the principal axes of K, and the eigenvalues of all rows."""
    size = np.linalg.norm(free, axis=0)
    columns = np.concatenate([free[:, size > 0] / size[size > 0], residual[:, None]], axis=1)
    values = np.concatenate([whitener.values, np.zeros(len(residual) - len(whitener.values))])
    return whitener.rotated(columns), values


def _peak(levels: Array, likelihood: Array) -> float:
    """Return the level of the highest likelihood, interpolated by a parabola in the logarithm of the level."""
    i = int(np.argmax(likelihood))
    if not 1 <= i < len(levels) - 1 or levels[i - 1] <= 0:
        return float(levels[i])
    x = np.log(levels[i - 1 : i + 2])
    (a, b), y = x[[0, 2]] - x[1], likelihood[i - 1 : i + 2] - likelihood[i]
    # maximum of the parabola through three points, the middle one of which is the highest
    curvature = (y[0] / a - y[2] / b) / (a - b)
    if not curvature < 0:
        return float(levels[i])
    return float(np.exp(x[1] + np.clip(-(y[0] / a - curvature * a) / (2 * curvature), a, b)))


def _deviance(rotated: Array, variance: Array) -> float:
    white = rotated / np.sqrt(variance)[:, None]
    r = np.abs(np.diag(np.linalg.qr(white, mode="r")))
    # the last entry is the part of the residual that is orthogonal to all free columns
    return float(np.log(variance).sum() + 2 * np.log(np.maximum(r[:-1], 1e-12)).sum() + r[-1] ** 2)


_CELLS_PER_ROW = 2.5
"""Number of cells of the random torque per row [1]. Chosen: equal to `_CELLS_PER_ROW` of
`fitting.inference._process_noise`; a smaller number blurs the response of the highest row, a larger one costs time."""
_GROUPS = 8
"""Number of groups of cells; the product for a group omits the rows that precede its first response [1]. Chosen:
another value costs time and does not change the result."""


class TorqueResponse:
    """Response of the smooth rows of a case to random torques on its bodies and in its joints.

    `bodies` (smooth rows, cells) are the responses to a torque of 1 N m on one body in each cell.
    """

    def __init__(self, data: CaseData, motion: LinearMotion) -> None:
        self.data, self._motion = data, motion
        self._smooth = data.slices["smooth"]
        count = int(_CELLS_PER_ROW * self._smooth.stop)
        self.edges = np.linspace(*data.record.span, count + 1)
        self.mechanism = data.record.mechanism
        directions = np.diag(1 / np.array(data.record.inertias))
        states = [w.samples.state for w in data.rotor]
        found = (_impulses(data, motion, self.edges, d, states)[self._smooth] for d in directions)
        self.bodies = dict(zip(self.mechanism.bodies, found, strict=True))

    @property
    def casing(self) -> Array:
        """The response to a torque on the main body."""
        return self.bodies[self.mechanism.main]

    @property
    def rotor(self) -> Array:
        """The response to a torque on the first body of the mechanism."""
        return self.bodies[self.mechanism.bodies[0]]

    def of(self, site: str) -> Array:
        """Return the response to a torque on a body or in a joint."""
        joint = self.mechanism.joints.get(site)
        return self.bodies[site] if joint is None else self.bodies[joint.second] - self.bodies[joint.first]

    @property
    def random(self) -> tuple[Array, ...]:
        """The responses to the independent random torques: on the main body and in each joint."""
        return tuple(self.of(site) for site in (self.mechanism.main, *self.mechanism.joints))

    @property
    def centres(self) -> Array:
        """Middle of each cell [s]."""
        return np.asarray(0.5 * (self.edges[1:] + self.edges[:-1]))

    def covariance(self, time: float) -> Array:
        """Return the covariance K of the smooth rows for torques of rms 1 N m."""
        decay = float(np.exp(-(self.edges[1] - self.edges[0]) / time))
        total = np.zeros((self._smooth.stop, self._smooth.stop))
        order, starts, responses = self._by_time
        for w in responses:
            # R = U' D U with the upper triangle U_kl = decay^(l-k) and D = diag(1, 1 - decay^2, ...): the sum of
            # decaying responses to independent impulses; X'X costs half of a product X'Y
            root = decaying_sums(w, decay)
            root[1:] *= np.sqrt(1 - decay**2)
            for first, run in starts:
                part = root[run, first:]
                total[first:, first:] += part.T @ part
        place = np.argsort(order)
        return np.asarray(total[np.ix_(place, place)])

    @cached_property
    def _by_time(self) -> tuple[NDArray[np.intp], list[tuple[int, slice]], list[Array]]:
        """Return the rows ordered by the last cell that affects them, the groups of cells, and the responses.

        A torque does not affect earlier rows: a group of cells affects only its row `first` and later rows.
        """
        responses = [w.T for w in self.random]
        changed = np.any([w != 0 for w in responses], axis=0)
        last = np.where(changed.any(axis=0), len(changed) - np.argmax(changed[::-1], axis=0), 0)
        order = np.argsort(last, kind="stable")
        edges = np.linspace(0, len(changed), _GROUPS + 1).astype(int)
        starts = [
            (int(np.searchsorted(last[order], a, side="right")), slice(a, b)) for a, b in pairwise(edges)
        ]
        return order, starts, [np.ascontiguousarray(w[:, order]) for w in responses]

    def whitener(self, noise: TorqueNoise) -> Whitener:
        """Return the whitener of rows with this noise."""
        values, vectors = np.linalg.eigh(self.covariance(noise.time))
        values = np.concatenate(
            [np.maximum(values, 0.0), self._harmonic_variances(noise.time, self._directions)]
        )
        return Whitener(vectors, values, noise.rms)

    @cached_property
    def _directions(self) -> list[Array]:
        """The accelerations of all bodies due to each of the random torques of 1 N m [rad/s2]."""
        sites = (self.mechanism.main, *self.mechanism.joints)
        return [np.array(self.mechanism.shares(site)) / self.data.record.inertias for site in sites]

    def _harmonic_variances(self, time: float, directions: Sequence[Array] | None = None) -> Array:
        """Return the variances of the rows of harmonics for torques of rms 1 N m, by default those of a gyroscope.

        A row of harmonic m responds to the torque at its frequency, m times the speed. This torque is independent in
        neighbouring blocks.
        """
        record = self.data.record
        if directions is None:
            casing, rotor = 1 / record.I_casing, 1 / record.I_rotor
            directions = [np.array([0.0, casing]), np.array([-rotor, casing])]
        square = sum(float(self._motion.accelerations(d)[MAIN] ** 2) for d in directions)
        response, frequency = self.data.harmonic_row_responses
        return np.asarray(square * response * 2 * time / (1 + (frequency * time) ** 2))


def _impulses(
    data: CaseData, motion: LinearMotion, cells: Array, direction: Array, states: Sequence[int] = ()
) -> Array:
    """Return the response of the rows to a unit torque in each cell, by variation of constants.

    `states` are the indices in the state of the bodies of the windows, by default of the first body.
    """
    centres = 0.5 * (cells[1:] + cells[:-1])
    impulses = motion.impulses(centres, direction) * np.diff(cells)[:, None]
    before = motion.integrated(centres)
    parts = []
    places = (MAIN, *(states or [0] * len(data.rotor)))
    for state, compressed in zip(places, (data.casing, *data.rotor), strict=True):
        times = compressed.node_times
        if data.is_angle:
            response = motion.integrated(times)[:, state] @ impulses.T - np.einsum(
                "cm,cm->c", before[:, state], impulses
            )
        else:
            response = motion.fundamental(times)[:, state] @ impulses.T
        response = np.where(times[:, None] > centres, response, 0.0)
        # a row whose time is within a cell responds only to the earlier part of the cell
        cell = np.clip(np.searchsorted(cells, times, side="right") - 1, 0, len(centres) - 1)
        since = times - cells[cell]
        acceleration = motion.accelerations(direction)[state]
        acceleration = acceleration * (motion.moving(times) if state == MAIN else 1.0)
        response[np.arange(len(times)), cell] = acceleration * (0.5 * since**2 if data.is_angle else since)
        parts.append(response)
    return data.rows(parts[0], parts[1:])


def decaying_sums(w: Array, decay: float) -> Array:
    """Return the sums over l >= k of decay^(l-k) w_l, one row per cell."""
    sums = w.copy()
    for k in range(len(sums) - 2, -1, -1):
        sums[k] += decay * sums[k + 1]
    return sums
