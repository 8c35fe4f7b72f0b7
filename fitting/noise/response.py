"""How the rows of a case answer to a random torque in each of many short cells."""

from __future__ import annotations

from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fitting.case_data import CaseData
from fitting.noise.whitener import TorqueNoise, Whitener
from fitting.simulation.linear import LinearMotion

Array = NDArray[np.float64]

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
