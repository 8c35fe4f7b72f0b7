"""The linearised equations of motion on a mesh, solved for any right-hand sides.

With A at the nodes, the deviations dy_k in an interval of length h that starts with dy_0 fulfil

    dy_k - h/2 sum_j S_kj A_j dy_j = dy_0 + b_k:

one small dense system an interval, all of them in one batch, chained by their transfer matrices.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fitting.errors import SimulationError
from fitting.simulation.mesh import Mesh, rule

Array = NDArray[np.float64]

UNBOUNDED = "the equations of motion have no bounded solution for these numbers"
# fewer edges than this are chained one by one
_FEW = 24


class Propagator:
    """The linearised equations d(dy)/dt = A dy + b on a mesh.

    Parameters
    ----------
    mesh : Mesh
        The intervals.
    a : ndarray, shape (intervals, nodes, n, n)
        A at the nodes.
    jumps : mapping of int to ndarray, optional
        Matrices by which a deviation changes at some edges: there the torque jumps with the state.
    defect : ndarray, shape (intervals, nodes, n), optional
        One right-hand side that is known already: `response` is its `nodes`, at less cost.
    """

    def __init__(
        self, mesh: Mesh, a: Array, jumps: Mapping[int, Array] | None = None, defect: Array | None = None
    ) -> None:
        intervals, k, n = a.shape[:3]
        self._mesh, self._half, self._a, self._jumps = mesh, mesh.half, a, jumps or {}
        scaled = (-mesh.half[..., None, None] * a).transpose(0, 2, 1, 3)
        # G[(k,n),(j,m)] = delta - h/2 S_kj A_j[n,m]
        g = (rule().s[:, None, :, None] * scaled[:, None]).reshape(intervals, k * n, k * n)
        g.reshape(intervals, -1)[:, :: k * n + 1] += 1.0
        self._system = g
        right = np.empty((intervals, k * n, n + (defect is not None)))
        right[..., :n] = np.tile(np.eye(n), (k, 1))
        if defect is not None:
            right[..., n] = defect.reshape(intervals, k * n)
        try:
            solved = np.linalg.solve(g, right)
        except np.linalg.LinAlgError:
            raise SimulationError(UNBOUNDED) from None
        self.transfer: Array = np.asarray(solved[..., :n].reshape(intervals, k, n, n))
        self.response: Array = np.asarray(solved[..., n:].reshape(intervals, k, n, -1))
        self._step = np.eye(n) + self._gained(self.transfer)

    @cached_property
    def _inverse(self) -> Array:
        return np.asarray(np.linalg.inv(self._system))

    def _gained(self, deviation: Array) -> Array:
        """Return the integral of A dy over each interval."""
        rates = self._a @ deviation
        intervals, k, n, columns = rates.shape
        total = rule().w @ rates.reshape(intervals, k, n * columns)
        return np.asarray(self._half[..., None] * total.reshape(intervals, n, columns))

    def remembering(self, share: float) -> Propagator:
        """Return the same equations with jumps that keep a share of what they would wipe out."""
        if not self._jumps:
            return self
        other = copy(self)
        other._jumps = {  # noqa: SLF001
            i: m + share * np.diag((np.diag(m) == 0).astype(float)) for i, m in self._jumps.items()
        }
        return other

    def of_speeds(self) -> Propagator:
        """Return the equations of the first two states, the others held."""
        if self._a.shape[-1] == 2:
            return self
        return Propagator(self._mesh, self._a[..., :2, :2], {i: m[:2, :2] for i, m in self._jumps.items()})

    def nodes(self, defect: Array) -> Array:
        """Return the response at the nodes to right-hand sides (intervals, nodes, n, columns), edges held."""
        intervals, k, n, columns = defect.shape
        return np.asarray(self._inverse @ defect.reshape(intervals, k * n, columns)).reshape(defect.shape)

    def carried(self, edges: Array) -> Array:
        """Return what deviations at the edges (intervals + 1, n, columns) do at the nodes."""
        return np.asarray(self.transfer @ edges[:-1, None])

    def chain(self, response: Array, edge_defect: Array, first: Array | None = None) -> Array:
        """Return the deviations at all edges, (intervals + 1, n, columns), from the first edge on."""
        gain = edge_defect + self._gained(response)
        for i, jump in self._jumps.items():
            gain[i - 1] = jump @ gain[i - 1]
        step = self._steps()
        out = np.zeros((gain.shape[0] + 1, *gain.shape[1:]))
        if first is not None:
            out[0] = first
        _fill(out, step, gain)
        return out

    def back(self, last: Array) -> Array:
        """Return the deviations at all edges, (intervals + 1, n, columns), that end as `last`, without a right side."""
        try:
            undone: Array = np.asarray(np.linalg.inv(self._steps()))[::-1]
        except np.linalg.LinAlgError:
            raise SimulationError(UNBOUNDED) from None
        out = np.zeros((len(undone) + 1, *last.shape))
        out[0] = last
        _fill(out, undone, np.zeros_like(out[1:]))
        return out[::-1]

    def _steps(self) -> Array:
        """Return the matrices that carry a deviation from edge to edge."""
        if not self._jumps:
            return self._step
        step = self._step.copy()
        for i, jump in self._jumps.items():
            step[i - 1] = jump @ step[i - 1]
        return step


def _fill(out: Array, step: Array, gain: Array) -> None:
    """Fill out[i + 1] = step[i] out[i] + gain[i]: two steps at a time as one of twice the length."""
    if len(step) < _FEW:
        for i in range(len(step)):
            out[i + 1] = step[i] @ out[i] + gain[i]
        return
    pairs = len(step) // 2 * 2
    second = step[1:pairs:2]
    double = out[: pairs + 1 : 2]
    _fill(double, second @ step[0:pairs:2], second @ gain[0:pairs:2] + gain[1:pairs:2])
    alone = out[0 : len(step) : 2]
    out[1::2] = step[0::2] @ alone + gain[0::2]
